"""Starts Poppy's dynamic walk in MuJoCo, with the page on which it is steered and pushed.

ros2 launch dqwalk_ros demo.launch.py
ros2 launch dqwalk_ros demo.launch.py config:=poppy set:='gait.cmd_vel_timeout=2.0'

The page is on 127.0.0.1; the node viewer logs its address. Further nodes may steer by cmd_vel, too, such as
`ros2 run teleop_twist_keyboard teleop_twist_keyboard`.
"""

from launch import LaunchDescription

from dqwalk_ros.config import find_config
from dqwalk_ros.nodes.launching import description, included

ARGUMENTS = {
    "config": ("poppy_dynamic", "parameter file of a standing or dynamic walk, or the name of a shipped one", None),
    "plant": ("physics", "simulated robot: physics or poppy_as_built", ["physics", "poppy_as_built"]),
    "set": ("", "single parameters, applied last: 'KEY=VALUE KEY=VALUE'", None),
    "view": ("true", "show the page", ["true", "false"]),
    "bag": ("", "record to this folder, which must not exist yet; empty: no recording", None),
}  # fmt: skip
STEERED = "gait.steps=0 gait.cmd_vel_timeout=1.0"  # a key that is held repeats after 0.66 s


def nodes(given: dict[str, str]) -> list[object]:
    own = {"config": str(find_config(given["config"])), "set": f"{STEERED} {given['set']}"}
    return [included("walk", given | own)]


def generate_launch_description() -> LaunchDescription:
    return description(ARGUMENTS, nodes, discovery=False)
