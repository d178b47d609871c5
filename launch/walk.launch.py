"""Starts a walk: controller, plant, monitor and, optionally, recorder, browser page and RViz.

ros2 launch dqwalk_ros walk.launch.py lockstep:=true bag:=my_walk
ros2 launch dqwalk_ros walk.launch.py plant:=physics rviz:=true namespace:=robot1
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.logging import get_logger
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from dqwalk_ros.config import find_share, load, overlaid, put_on, replaced
from dqwalk_ros.plants.table import PLANTS, entry
from dqwalk_ros.support.errors import ConfigError

TRUE_OR_FALSE = ["true", "false"]
ARGUMENTS = {
    "config": ("", "parameter file of all nodes, `dqwalk config` explains each key; empty: paper.yaml for "
               "the integrator, poppy.yaml for all other plants, where the robot must stand", None),
    "plant": ("integrator", "what executes the commands: " +
              "; ".join(f"{name}, {each.meaning}" for name, each in PLANTS.items()) +
              "; or MODULE:CLASS of your own. ros2_control.launch.py starts Poppy's controllers. config/plants/ has "
              "the parameters a plant requires of all nodes, which replace those of config", None),
    "params": ("", "further parameter file, applied after those of config and plant, such as that of `dqwalk identify`",
               None),
    "lockstep": ("false", "true: each state waits for its command, so the walk is reproducible and as fast as the "
                 "machine allows; all nodes stop after the walk, with an error if it failed; false: real time, until "
                 "Ctrl-C", TRUE_OR_FALSE),
    "namespace": ("", "namespace of all nodes and topics of this robot, including /tf", None),
    "use_sim_time": ("false", "use the time of /clock, which a simulated plant then publishes", TRUE_OR_FALSE),
    "autostart": ("", "start walking at the first state; empty: as configured, which is false for poppy and "
                  "ros2_control", None),
    "interface": ("", "with plant:=ros2_control: command interface of the joints, position or velocity; empty: as "
                  "configured by output.interface", None),
    "dummy": ("false", "with plant:=poppy: dummy motors instead of a robot", TRUE_OR_FALSE),
    "respawn": ("false", "restart controller and monitor when they exit; not in lockstep", TRUE_OR_FALSE),
    "log_level": ("info", "debug, info, warn, error or fatal", None),
    "rviz": ("false", "show the robot in RViz, with a robot_state_publisher", TRUE_OR_FALSE),
    "view": ("false", "show the walk in the browser, on 127.0.0.1; the address is logged (needs viser)", TRUE_OR_FALSE),
    "bag": ("", "record to this folder, which must not exist yet; empty: no recording", None),
}  # fmt: skip


def warn(config: str, plant: str, params: str) -> None:
    """Log which values of the configuration the file of the plant replaces."""
    if params and not Path(params).is_file():
        raise ConfigError(f"params: no parameter file '{params}'")
    try:
        own = load(config)
        used = put_on(overlaid(own, plant), [Path(params)] if params else [])
    except ConfigError:
        return  # the nodes report it; a file with parameters of other packages they accept
    if warning := replaced(own, plant, used, "params:=FILE, which is applied after it"):
        get_logger("walk.launch").warning(warning)


def nodes(context: LaunchContext) -> list[object]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    lockstep, rviz = given["lockstep"] == "true", given["rviz"] == "true"
    sim_time = given["use_sim_time"] == "true"
    plant = entry(given["plant"])
    config = given["config"] or str(
        find_share("config", "paper.yaml" if given["plant"] == "integrator" else "poppy.yaml")
    )
    values: dict[str, object] = {
        "plant.lockstep": lockstep,
        "node.exit_when_done": lockstep,
        "node.wait_for_recorder": bool(given["bag"]),
        "node.wait_for_monitor": lockstep,
    }
    if rviz:
        values["node.robot_description"] = False
    if given["autostart"]:
        values["node.autostart"] = given["autostart"] == "true"
    if given["interface"]:
        values["output.interface"] = given["interface"]
    if given["dummy"] == "true":
        values["poppy.dummy"] = True
    required = [str(find_share("config/plants", f"{plant.parameters}.yaml"))] if plant.parameters else []
    files = [config, *required, *filter(None, [given["params"]])]
    if required:
        warn(config, plant.parameters, given["params"])
    if plant.type:
        values["plant.name"] = given["plant"]
    remappings = [("/tf", "tf"), ("/tf_static", "tf_static")] if given["namespace"] else []
    if given["plant"] == "ros2_control":
        remappings.append(("imu", "imu_sensor_broadcaster/imu"))

    def node(name: str, package: str = "dqwalk_ros", **options: object) -> Node:
        own = options.pop("parameters", [*files, values])
        simulated = name == plant.node and plant.type
        time = {"plant.clock": True} if sim_time and simulated else {"use_sim_time": sim_time}
        return Node(
            package=package,
            executable=name,
            name=name,
            namespace=given["namespace"],
            parameters=[*own, time],
            remappings=remappings,
            output="screen",
            # see docs/security.md; no effect without SROS 2
            ros_arguments=["--enclave", f"/dqwalk/{name}", "--log-level", given["log_level"]],
            **options,
        )

    again = {"respawn": given["respawn"] == "true" and not lockstep, "respawn_delay": 2.0}
    controller = node("controller", **again)
    others = [node("phase_monitor", **again), node(plant.node)]
    if given["bag"]:
        others.append(node("recorder", arguments=["--bag", given["bag"]]))
    if given["view"] == "true":
        others.append(node("viewer"))
    if rviz:
        from dqwalk_ros.robot.model import load_model

        described = {"robot_description": load_model(put_on(load(config), map(Path, files[1:])).robot).urdf}
        shown = ["-d", str(find_share("config", "walk.rviz"))]
        others.append(node("robot_state_publisher", "robot_state_publisher", parameters=[described]))
        others.append(node("rviz2", "rviz2", parameters=[], arguments=shown))

    def end(event: object, _: LaunchContext) -> list[object]:
        """Stop the other nodes of this walk, but nothing else that was launched with it."""
        if event.returncode:
            raise RuntimeError(f"the walk failed: the controller ended with {event.returncode}")
        return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(other))) for other in others]

    # a real robot's driver keeps running after its controller, so that ~/compliant remains available
    handlers = [RegisterEventHandler(OnProcessExit(target_action=controller, on_exit=end))] if lockstep else []
    return [*others, controller, *handlers]


def generate_launch_description() -> LaunchDescription:
    arguments = []
    for name, (default, description, choices) in ARGUMENTS.items():
        arguments.append(DeclareLaunchArgument(name, default_value=default, description=description, choices=choices))
    discovery = DeclareLaunchArgument(
        "discovery",
        default_value=EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
        choices=["LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT"],
        description="which machines can discover the nodes: LOCALHOST only this one, SUBNET also the network",
    )
    # by default the nodes are visible on this machine only
    stays = SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery"))
    return LaunchDescription([*arguments, discovery, stays, OpaqueFunction(function=nodes)])
