"""What the node `drive` commands of a robot with controllers of its own, as the section ``output`` says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dqwalk_ros.config import Config
from dqwalk_ros.plants.base import require_real_time
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.topics import TOPICS
from dqwalk_ros.support.wording import listed

_TOPICS = {
    ("float64_multi_array", "velocity"): "forward_velocity_controller/commands",
    ("float64_multi_array", "position"): "forward_position_controller/commands",
    ("joint_trajectory", "position"): "joint_trajectory_controller/joint_trajectory",
    ("joint_state", "velocity"): "joint_commands",
    ("joint_state", "position"): "joint_commands",
}
"""Default topics of ros2_control's controllers and of its joint_state_topic_hardware_interface."""
_RATE = 0.05
"""Largest relative error of the period of the controller_manager."""


def output_topic(config: Config) -> str:
    """Return the topic of the commands."""
    return config.output.topic or _TOPICS[config.output.type, config.output.interface]


def commanded_joints(config: Config, model: RobotModel) -> tuple[str, ...]:
    """Return the joints of the robot's controllers in their order; all of the model are among them.

    Raises
    ------
    ConfigError
        In lockstep, or if the section `output` does not fit the model.
    """
    require_real_time(config)
    output, own = config.output, model.joint_names
    if output.type == "joint_trajectory" and output.interface == "velocity":
        raise ConfigError("'output.type' joint_trajectory needs 'output.interface' position")
    if output_topic(config).removeprefix("/") in {*TOPICS, "plant_ready"}:
        raise ConfigError(
            f"'output.topic' {output_topic(config)} is a topic of the walk, not of the robot's controller"
        )
    joints = output.joints or own
    if missing := [name for name in own if name not in joints]:
        raise ConfigError(f"'output.joints' lacks {', '.join(missing)}, which the walk moves")
    if len(set(joints)) < len(joints):
        raise ConfigError("'output.joints' names a joint twice")
    return joints


def misunderstood(name: str, parameter: str, found: Sequence[str], expected: Sequence[str]) -> str:
    """Return how the parameter `joints` or `interface_name` of a controller differs from what it is sent, or ""."""
    if tuple(found) == tuple(expected):
        return ""
    if parameter == "joints":
        if missing := [joint for joint in expected if joint not in found]:
            return f"{name} lacks {listed(missing)} of output.joints: give it all joints that the walk moves"
        what = "its joints in another order" if len(found) == len(expected) else "more joints than output.joints"
        return f"{name} has {what}: set output.joints to [{', '.join(found)}]"
    return f"{name} takes {found[0]}, not {expected[0]}: set output.interface to that of output.topic"


def differences(config: Config, model: RobotModel, file: Path) -> Iterator[str]:
    """Yield in what the parameter file of a controller_manager does not fit a configuration.

    Raises
    ------
    ConfigError
        If the file cannot be read, or `commanded_joints` raises one.
    """
    tree = strict_yaml.read(strict_yaml.read_text(file), source=str(file))
    sections: dict[str, Mapping[str, Any]] = {}
    for key, section in (tree if isinstance(tree, dict) else {}).items():
        if isinstance(section, dict) and isinstance(own := section.get("ros__parameters"), dict):
            sections[str(key).rpartition("/")[2]] = own
    topic = output_topic(config)
    name = topic.rpartition("/")[0].rpartition("/")[2]
    if name and name not in sections:
        yield f"{file} has no '{name}', whose topic is output.topic ({topic}); it has {listed(sections)}"
    if config.output.type == "float64_multi_array":
        expected = {"joints": commanded_joints(config, model), "interface_name": (config.output.interface,)}
        for parameter, values in expected.items():
            found = sections.get(name, {}).get(parameter, ())
            found = [found] if isinstance(found, str) else [str(value) for value in found]
            if found and (text := misunderstood(name, parameter, found, values)):
                yield text
    rate = sections.get("controller_manager", {}).get("update_rate")
    if isinstance(rate, (int, float)) and rate > 0:
        ours = ("dt", config.dt, 1.0 / rate), ("servo.assumed_rate", config.servo.assumed_rate, float(rate))
        for key, value, wanted in ours:
            if value and abs(value / wanted - 1.0) > _RATE:
                yield f"the controller_manager updates at {rate:g} Hz, and {key} is {value:g}: set it to {wanted:.4g}"
    for broadcaster, own in sections.items():
        frame = own.get("frame_id") if "imu" in broadcaster else None
        if config.plant.imu and frame and frame != model.imu_link:
            yield f"{broadcaster} publishes in the frame '{frame}', and robot.imu is '{model.imu_link}'"
