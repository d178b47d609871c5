"""Starts the whole-body controller, its rigid plant and, optionally, the recorder.

ros2 launch dqwalk_ros whole_body.launch.py bag:=my_walk
ros2 topic pub --once /hand_target geometry_msgs/PoseStamped '{pose: {position: {x: 1.2, y: -0.8, z: 0.9}}}'
ros2 topic pub --once /push geometry_msgs/WrenchStamped '{wrench: {force: {y: 15.0}}}'
dqwalk report my_walk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import (
    EnvironmentVariable,
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    bag = LaunchConfiguration("bag")
    recorded = NotEqualsSubstitution(bag, "")
    parameters = [
        LaunchConfiguration("config"),
        {"plant.lockstep": LaunchConfiguration("lockstep"), "node.wait_for_recorder": recorded},
    ]

    def node(name: str, **options: object) -> Node:
        return Node(
            package="dqwalk_ros",
            executable=name,
            name=name,
            parameters=parameters,
            output="screen",
            ros_arguments=["--enclave", f"/dqwalk/{name}"],  # see docs/security.md; no effect without SROS 2
            **options,
        )

    controller = node("whole_body_controller")
    over = EmitEvent(event=Shutdown(reason="the controller has ended"))
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare("dqwalk_ros"), "config", "whole_body.yaml"]),
                description="parameter file of all nodes; `dqwalk config` explains each key",
            ),
            DeclareLaunchArgument(
                "lockstep",
                default_value="false",
                choices=["true", "false"],
                description="true: as fast as the machine allows; false: at most in real time",
            ),
            DeclareLaunchArgument(
                "discovery",
                default_value=EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
                choices=["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"],
                description="which machines can discover the nodes: LOCALHOST only this one, SUBNET also the network",
            ),
            DeclareLaunchArgument(
                "bag",
                default_value="",
                description="record to this folder, which must not exist yet; empty: none",
            ),
            # by default the nodes are visible on this machine only
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery")),
            node("recorder", arguments=["--bag", bag], condition=IfCondition(recorded)),
            node("rigid"),
            controller,
            RegisterEventHandler(OnProcessExit(target_action=controller, on_exit=[over])),
        ]
    )
