"""Package of dqwalk_ros, for colcon (ament_python) and for pip."""

import os
from glob import glob

from setuptools import find_packages, setup

NAME = "dqwalk_ros"
NODES = sorted(os.listdir("scripts"))
COLCON = "COLCON" in os.environ

# The wheels of ROS 2 Jazzy, for a machine without ROS (Linux, x86_64, Python 3.11 to 3.13). An extra, never a plain
# requirement: where ROS is installed they must not come beside it.
ROS = [
    "ros-jazzy-rclpy[fastrtps]>=7.1.5",
    "ros-jazzy-diagnostic-msgs>=5.3",
    "ros-jazzy-geometry-msgs>=5.3",
    "ros-jazzy-nav-msgs>=5.3",
    "ros-jazzy-rosgraph-msgs>=2.0",
    "ros-jazzy-sensor-msgs>=5.3",
    "ros-jazzy-std-srvs>=5.3",
    "ros-jazzy-trajectory-msgs>=5.3",
    "ros-jazzy-visualization-msgs>=5.3",
]
DAQP = ["daqp>=0.7"]
VIEW = ["viser>=1.1"]
STUDY = ["distributed>=2023.1", "pyarrow>=12"]
SIM = ["mujoco>=3.4"]
DRAKE = ["drake>=1.40"]
POPPY = ["dynamixel-sdk>=3.7", "pyserial>=3.5"]
TEST = [
    *DAQP,
    *(f"{each}; platform_machine == 'x86_64'" for each in DRAKE),
    *POPPY,
    *STUDY,
    *VIEW,
    *SIM,
    "hypothesis>=6.80",
    "pin>=2.7",
    "playwright>=1.40",
    "psutil>=5.9",
    "pytest>=7.4",
    "pytest-timeout>=2.1",
    "pytest-xdist>=3.3",
    "quadprog>=0.1.11",
]
# the dynamics and the solver of the whole-body controller
WHOLEBODY = ["daqp>=0.11", "pin>=2.7"]
# every command of dqwalk
COMMANDS = [*POPPY, *SIM, *STUDY, *VIEW, *WHOLEBODY]
DEV = [*VIEW, "mypy>=1.10", "ruff>=0.6", "types-PyYAML>=6.0", "types-psutil>=5.9"]

setup(
    name=NAME,
    version="0.1.0",
    description="Biped walking control with quadratic programming and vector-field inequalities, for ROS 2",
    author="dqwalk_ros",
    author_email="dqwalk@users.noreply.github.com",
    maintainer="dqwalk_ros",
    maintainer_email="dqwalk@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "report/html/*.css", "report/html/*.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/config/motors", sorted(glob("config/motors/*.yaml"))),
        (f"share/{NAME}/config/security", sorted(glob("config/security/*.xml"))),
        (f"share/{NAME}/config/nav2", sorted(glob("config/nav2/*"))),
        (f"share/{NAME}/config/plants", sorted(glob("config/plants/*.yaml"))),
        (f"share/{NAME}/config/overlays", sorted(glob("config/overlays/*.yaml"))),
        (f"share/{NAME}/config/ros2_control", sorted(glob("config/ros2_control/*.yaml"))),
        (f"share/{NAME}/urdf", sorted(glob("urdf/*.urdf*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        # `ros2 run dqwalk_ros controller` looks here. They are no console scripts, because pip would put such general
        # names on everybody's PATH; there the nodes are dqwalk_controller and so on.
        (f"lib/{NAME}", [f"scripts/{node}" for node in NODES]),
        # colcon installs the command dqwalk into lib/dqwalk_ros, and puts only bin/ on PATH
        *([("bin", ["bin/dqwalk"])] if COLCON else []),
    ],
    entry_points={
        "console_scripts": [
            "dqwalk = dqwalk_ros.programs:dqwalk",
            # beside the scripts of colcon, `ros2 run` would offer each node twice
            *(f"dqwalk_{node} = dqwalk_ros.programs:node" for node in NODES if not COLCON),
        ]
    },
    install_requires=[
        "setuptools",
        "clarabel>=0.9",
        "click>=8.1",
        "joblib>=1.4",
        "lz4>=4.0",
        "matplotlib>=3.6",
        "mcap>=1.1",
        "msgspec>=0.18",
        "numba>=0.58",
        "numpy>=1.26",
        "pyyaml>=6.0",
        "rosbags>=0.11",
        "scipy>=1.11",
        "pycollada>=0.8",
        "rich>=13.0",
        "tqdm>=4.60",
        "trimesh>=4.0",
        "xacro>=2.0",
        "yourdfpy>=0.0.56",
        "zstandard>=0.18",
    ],
    extras_require={
        "ros": ROS,
        "daqp": DAQP,
        "drake": DRAKE,
        "poppy": POPPY,
        "study": STUDY,
        "view": VIEW,
        "sim": SIM,
        "docs": ["mkdocs>=1.5"],
        "wholebody": WHOLEBODY,
        "commands": COMMANDS,
        "test": TEST,
        "dev": DEV,
    },
    tests_require=["pytest"],
    zip_safe=False,
    classifiers=[
        "License :: OSI Approved :: Apache Software License",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
    ],
)
