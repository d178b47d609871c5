# Poppy walks in MuJoCo, and a page shows and steers it, on http://127.0.0.1:8080:
#   docker build -t dqwalk_ros . && docker run --rm -it --network host dqwalk_ros
# The lines are those of README, "On a machine with ROS 2 Jazzy"; the image exists for x86_64 and aarch64.
FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-c"]
WORKDIR /root/ws
COPY . src/dqwalk_ros
RUN apt-get update && apt-get install -y --no-install-recommends git python3-venv ros-dev-tools \
    && rosdep update && rosdep install --from-paths src -y --ignore-src --skip-keys rviz2 \
    && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv --system-site-packages .venv && touch .venv/COLCON_IGNORE \
    && echo 'export PYTHONPATH=$(echo $VIRTUAL_ENV/lib/python3*/site-packages)${PYTHONPATH:+:$PYTHONPATH}' >> .venv/bin/activate \
    && . .venv/bin/activate \
    && pip install --no-cache-dir clarabel mcap msgspec rosbags yourdfpy 'joblib>=1.4' mujoco viser \
    && . /opt/ros/jazzy/setup.bash \
    && python3 -m colcon build --packages-select dqwalk_ros
ENTRYPOINT ["/bin/bash", "-c", ". .venv/bin/activate && . install/setup.bash && exec \"$@\"", "-"]
CMD ["ros2", "launch", "dqwalk_ros", "demo.launch.py"]
