"""Walk: controller, plant, monitor and, if asked for, recorder.

ros2 launch dqwalk_ros walk.launch.py lockstep:=true bag:=my_walk
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import (
    EnvironmentVariable,
    EqualsSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    OrSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    config = LaunchConfiguration("config")
    plant = LaunchConfiguration("plant")
    in_physics = OrSubstitution(EqualsSubstitution(plant, "physics"), EqualsSubstitution(plant, "poppy_as_built"))
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
            choices=["integrator", "physics", "poppy_as_built", "poppy"],
            description="other side of the command: integrator, an ideal robot; physics, MuJoCo; "
            "poppy_as_built, the same with Poppy's own servos, delays and sensors; poppy, the real one; "
            "config/plants/NAME.yaml is what it asks of all nodes",
        ),
        DeclareLaunchArgument(
            "lockstep",
            default_value="false",
            choices=["true", "false"],
            description="true: each state waits for its command, exact and as fast as the machine, and everything "
            "ends with the walk; false: by the clock, and the robot is held still after the walk until Ctrl-C",
        ),
        DeclareLaunchArgument(
            "discovery",
            default_value=EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
            choices=["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"],
            description="who can see the nodes: LOCALHOST this machine only, SUBNET the network as well",
        ),
        DeclareLaunchArgument(
            "view",
            default_value="false",
            choices=["true", "false"],
            description="show the walk in the browser, on 127.0.0.1; the address is logged (needs viser)",
        ),
        DeclareLaunchArgument(
            "bag", default_value="", description="record to this folder, which must not be there yet; empty: do not"
        ),
    ]
    parameters = [
        config,
        [PathJoinSubstitution([FindPackageShare("dqwalk_ros"), "config", "plants", plant]), ".yaml"],
        {
            "plant.lockstep": lockstep,
            "node.exit_when_done": lockstep,
            "node.wait_for_recorder": recorded,
            "node.wait_for_monitor": lockstep,
        },
    ]

    def node(name: str, **options: object) -> Node:
        return Node(
            package="dqwalk_ros",
            executable=name,
            name=name,
            parameters=parameters,
            output="screen",
            ros_arguments=["--enclave", f"/dqwalk/{name}"],  # see docs/security.md; nothing without SROS 2
            **options,
        )

    controller = node("controller")
    return LaunchDescription(
        [
            *arguments,
            # nothing leaves this machine unless somebody asks for it
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery")),
            node("recorder", arguments=["--bag", bag], condition=IfCondition(recorded)),
            node("phase_monitor"),
            node("viewer", condition=IfCondition(LaunchConfiguration("view"))),
            node("integrator", condition=IfCondition(EqualsSubstitution(plant, "integrator"))),
            node("physics", condition=IfCondition(in_physics)),
            node("poppy_driver", condition=IfCondition(EqualsSubstitution(plant, "poppy"))),
            controller,
            # in lockstep the controller ends with the walk; without a controller there is nothing left to do
            RegisterEventHandler(
                OnProcessExit(
                    target_action=controller, on_exit=[EmitEvent(event=Shutdown(reason="the controller has ended"))]
                )
            ),
        ]
    )
