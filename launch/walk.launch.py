"""Walk: controller, plant, monitor and, if asked for, recorder.

ros2 launch dqwalk_ros walk.launch.py lockstep:=true bag:=my_walk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import (
    EqualsSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    config = LaunchConfiguration("config")
    lockstep = LaunchConfiguration("lockstep")
    bag = LaunchConfiguration("bag")
    recorded = NotEqualsSubstitution(bag, "")

    arguments = [
        DeclareLaunchArgument(
            "config",
            default_value=PathJoinSubstitution([FindPackageShare("dqwalk_ros"), "config", "paper.yaml"]),
            description="parameter file of all nodes; `dqwalk config` explains each key",
        ),
        DeclareLaunchArgument(
            "plant",
            default_value="integrator",
            choices=["integrator"],
            description="what stands on the other side of the command: integrator, an ideal robot",
        ),
        DeclareLaunchArgument(
            "lockstep",
            default_value="false",
            choices=["true", "false"],
            description="true: each state waits for its command, exact and as fast as the machine, and everything "
            "ends with the walk; false: by the clock, and the robot is held still after the walk until Ctrl-C",
        ),
        DeclareLaunchArgument(
            "bag", default_value="", description="record to this folder, which must not be there yet; empty: do not"
        ),
    ]
    parameters = [
        config,
        {
            "plant.lockstep": lockstep,
            "node.exit_when_done": lockstep,
            "node.wait_for_recorder": recorded,
        },
    ]

    def node(name: str, **options: object) -> Node:
        return Node(package="dqwalk_ros", executable=name, name=name, parameters=parameters, output="screen", **options)

    controller = node("controller")
    return LaunchDescription(
        [
            *arguments,
            node("recorder", arguments=["--bag", bag], condition=IfCondition(recorded)),
            node("phase_monitor"),
            node("integrator", condition=IfCondition(EqualsSubstitution(LaunchConfiguration("plant"), "integrator"))),
            controller,
            # in lockstep the controller ends with the walk; without a controller there is nothing left to do
            RegisterEventHandler(
                OnProcessExit(
                    target_action=controller, on_exit=[EmitEvent(event=Shutdown(reason="the controller has ended"))]
                )
            ),
        ]
    )
