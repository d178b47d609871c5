r"""Starts Poppy's dynamic walk in MuJoCo under Nav2, with a map and without a sensor of the surroundings.

ros2 launch dqwalk_ros nav2.launch.py
ros2 action send_goal navigate_to_pose nav2_msgs/action/NavigateToPose \
    '{pose: {header: {frame_id: map}, pose: {position: {x: 0.5, y: 0.5}}}}'

For a real robot start its walk by walk.launch.py with gait.steps=0, and this with walk:=false, the map of the room, and
fixed:=false where a localization publishes map -> odom.
"""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch_ros.actions import Node

from dqwalk_ros.config import find_config, find_share
from dqwalk_ros.nodes.launching import description, included

ARGUMENTS = {
    "config": ("poppy_dynamic", "parameter file of a standing or dynamic walk, or the name of a shipped one", None),
    "plant": ("physics", "simulated robot: physics or poppy_as_built", ["physics", "poppy_as_built"]),
    "set": ("", "single parameters of the walk, applied last: 'KEY=VALUE KEY=VALUE'", None),
    "walk": ("true", "start the walk; false: only Nav2, for a walk that runs already", ["true", "false"]),
    "map": (str(find_share("config/nav2", "room.yaml")), "map of nav2_map_server", None),
    "nav2": (str(find_share("config/nav2", "nav2.yaml")), "parameter file of the nodes of Nav2", None),
    "fixed": ("true", "odometry alone: the robot begins at the origin of the map, and map -> odom is constant",
              ["true", "false"]),
    "view": ("true", "show the page", ["true", "false"]),
    "bag": ("", "record to this folder, which must not exist yet; empty: no recording", None),
}  # fmt: skip
SERVERS = {
    "map_server": "nav2_map_server",
    "planner_server": "nav2_planner",
    "controller_server": "nav2_controller",
    "behavior_server": "nav2_behaviors",
    "bt_navigator": "nav2_bt_navigator",
    "velocity_smoother": "nav2_velocity_smoother",
}
"""Package of each managed node of Nav2, in the order in which they start."""
WANTED = {"cmd_vel": "cmd_vel_nav"}
PASSED = {
    "controller_server": WANTED,
    "behavior_server": WANTED,
    "velocity_smoother": {**WANTED, "cmd_vel_smoothed": "cmd_vel"},
}
"""Topics of a node under another name: wanted velocities pass the smoother on their way to the walk."""


def nodes(given: dict[str, str]) -> list[object]:
    config = str(find_config(given["config"]))
    try:
        for package in SERVERS.values():
            get_package_prefix(package)
    except PackageNotFoundError as error:
        raise RuntimeError("Nav2 is not installed: sudo apt install ros-jazzy-navigation2") from error
    started: list[object] = []
    if given["walk"] == "true":
        passed = {name: given[name] for name in ("plant", "set", "view", "bag")}
        started.append(included("demo", {"config": config} | passed))
    for name, package in SERVERS.items():
        own = {"yaml_filename": given["map"]} if name == "map_server" else {}
        started.append(
            Node(package=package, executable=name, name=name, output="screen", parameters=[given["nav2"], own],
                 remappings=[*PASSED.get(name, {}).items()])
        )  # fmt: skip
    started.append(
        Node(package="nav2_lifecycle_manager", executable="lifecycle_manager", name="lifecycle_manager",
             output="screen", parameters=[{"autostart": True, "node_names": [*SERVERS]}])
    )  # fmt: skip
    if given["fixed"] == "true":
        frames = ["--frame-id", "map", "--child-frame-id", "odom"]
        started.append(Node(package="tf2_ros", executable="static_transform_publisher", name="map", arguments=frames))
    return started


def generate_launch_description() -> LaunchDescription:
    return description(ARGUMENTS, nodes, discovery=False)
