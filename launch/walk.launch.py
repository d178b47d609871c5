"""Starts a walk: controller, plant, monitor and, optionally, recorder, browser page and RViz.

ros2 launch dqwalk_ros walk.launch.py lockstep:=true bag:=my_walk
ros2 launch dqwalk_ros walk.launch.py plant:=physics rviz:=true namespace:=robot1
ros2 launch dqwalk_ros walk.launch.py plant:=physics config:=poppy_dynamic set:='gait.steps=40 gait.step_length=0.04'
"""

import shlex
from functools import partial
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.logging import get_logger
from launch_ros.actions import Node

from dqwalk_ros.cli.options import parse_overrides
from dqwalk_ros.config import Config, find_config, find_params, find_share, load, overlaid, replaced, with_files
from dqwalk_ros.nodes.launching import description
from dqwalk_ros.plants.table import PLANTS, entry
from dqwalk_ros.support.errors import ConfigError

CANNOT_START = 2
"""Exit code of a node whose arguments are invalid, or that is running already."""
TRUE_OR_FALSE = ["true", "false"]
ARGUMENTS = {
    "config": ("", "parameter file of all nodes, or the name of a shipped one such as poppy_dynamic; `dqwalk config` "
               "explains each key; empty: paper for the integrator, poppy for all other plants, where the robot must "
               "stand", None),
    "plant": ("integrator", "what executes the commands: " +
              "; ".join(f"{name}, {each.meaning}" for name, each in PLANTS.items()) +
              "; or MODULE:CLASS of your own. ros2_control.launch.py starts Poppy's controllers. config/plants/ has "
              "the parameters a plant requires of all nodes, which replace those of config", None),
    "params": ("", "further parameter file, applied after those of config and plant, such as that of `dqwalk "
               "identify`, or the name of one in config/overlays, such as rough", None),
    "set": ("", "single parameters, applied last: 'KEY=VALUE KEY=VALUE', such as set:='gait.steps=1'", None),
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


def warn(config: Path, plant: str, params: list[Path], changes: dict[str, object]) -> None:
    """Log which values of the configuration the file of the plant replaces."""
    try:
        own = load(config)
        used = with_files(overlaid(own, plant), params).updated(changes)
    except ConfigError:
        return  # the nodes report it; a file with parameters of other packages they accept
    if warning := replaced(own, plant, used, "params:=FILE or set:='KEY=VALUE', which are applied after it"):
        get_logger("walk.launch").warning(warning)


def typed(changes: dict[str, object]) -> dict[str, object]:
    """Return parameters as launch_ros passes them on, with the types of the schema; an empty list has no type."""
    flat = Config().updated(changes, source="set").flat()
    return {name: (list(flat[name]) or [""]) if isinstance(flat[name], tuple) else flat[name] for name in changes}


def nodes(given: dict[str, str]) -> list[object]:
    lockstep, rviz = given["lockstep"] == "true", given["rviz"] == "true"
    sim_time = given["use_sim_time"] == "true"
    plant = entry(given["plant"])
    # ros2 launch accepts a parameter file that is missing: the nodes would start with their defaults
    config = find_config(given["config"] or ("paper" if given["plant"] == "integrator" else "poppy"))
    params = [find_params(given["params"])] if given["params"] else []
    changes = typed(parse_overrides(shlex.split(given["set"])))
    values: dict[str, object] = {
        "node.end_with_parent": True,
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
    required = [find_share("config/plants", f"{plant.parameters}.yaml")] if plant.parameters else []
    files = [config, *required, *params]
    if required:
        warn(config, plant.parameters, params, changes)
    if plant.type:
        values["plant.name"] = given["plant"]
    values |= changes
    remappings = [("/tf", "tf"), ("/tf_static", "tf_static")] if given["namespace"] else []
    if given["plant"] == "ros2_control":
        remappings.append(("imu", "imu_sensor_broadcaster/imu"))

    started: dict[str, Node] = {}

    def node(name: str, package: str = "dqwalk_ros", **options: object) -> None:
        own = options.pop("parameters", [*map(str, files), values])
        simulated = name == plant.node and plant.type
        time = {"plant.clock": True} if sim_time and simulated else {"use_sim_time": sim_time}
        started[name] = Node(
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
    node("phase_monitor", **again)
    node(plant.node)
    if given["bag"]:
        node("recorder", arguments=["--bag", given["bag"]])
    if given["view"] == "true":
        node("viewer")
    if rviz:
        from dqwalk_ros.robot.model import load_model

        described = {"robot_description": load_model(with_files(load(config), files[1:]).updated(changes).robot).urdf}
        shown = ["-d", str(find_share("config", "walk.rviz"))]
        node("robot_state_publisher", "robot_state_publisher", parameters=[described])
        node("rviz2", "rviz2", parameters=[], arguments=shown)
    node("controller", **again)

    def end(event: object, _: LaunchContext, *, ended: str) -> list[object]:
        """Stop the nodes of this walk, but nothing else that was launched with it."""
        if event.returncode == CANNOT_START:
            raise RuntimeError(f"the walk did not start: see the message of {ended}")
        if not lockstep or ended != "controller":
            return []  # a real robot's driver keeps running after its controller, so that ~/compliant remains available
        if event.returncode:
            raise RuntimeError(f"the walk failed: the controller ended with {event.returncode}")
        others = [one for name, one in started.items() if name != ended]
        return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(other))) for other in others]

    exits = [OnProcessExit(target_action=one, on_exit=partial(end, ended=name)) for name, one in started.items()]
    return [*started.values(), *map(RegisterEventHandler, exits)]


def generate_launch_description() -> LaunchDescription:
    return description(ARGUMENTS, nodes)
