"""Starts the whole-body controller, its rigid plant and, optionally, the recorder.

ros2 launch dqwalk_ros whole_body.launch.py bag:=my_walk
ros2 topic pub --once /hand_target geometry_msgs/msg/PoseStamped '{pose: {position: {x: 1.2, y: -0.8, z: 0.9}}}'
ros2 topic pub --once /push geometry_msgs/msg/WrenchStamped '{wrench: {force: {y: 15.0}}}'
dqwalk report my_walk
"""

from launch import LaunchDescription
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch_ros.actions import Node

from dqwalk_ros.config import find_config
from dqwalk_ros.nodes.launching import description

ARGUMENTS = {
    "config": ("whole_body", "parameter file of all nodes, or the name of a shipped one; `dqwalk config` explains each "
               "key", None),
    "lockstep": ("false", "true: as fast as the machine allows; false: at most in real time", ["true", "false"]),
    "bag": ("", "record to this folder, which must not exist yet; empty: no recording", None),
}  # fmt: skip


def nodes(given: dict[str, str]) -> list[object]:
    values = {
        "node.end_with_parent": True,
        "node.wait_for_recorder": bool(given["bag"]),
        "plant.lockstep": given["lockstep"] == "true",
    }
    parameters = [str(find_config(given["config"])), values]

    def node(name: str, *arguments: str) -> Node:
        return Node(
            package="dqwalk_ros",
            executable=name,
            name=name,
            parameters=parameters,
            output="screen",
            arguments=arguments,
            ros_arguments=["--enclave", f"/dqwalk/{name}"],  # see docs/security.md; no effect without SROS 2
        )

    controller = node("whole_body_controller")
    over = EmitEvent(event=Shutdown(reason="the controller has ended"))
    recorder = [node("recorder", "--bag", given["bag"])] if given["bag"] else []
    ended = RegisterEventHandler(OnProcessExit(target_action=controller, on_exit=[over]))
    return [*recorder, node("rigid"), controller, ended]


def generate_launch_description() -> LaunchDescription:
    return description(ARGUMENTS, nodes)
