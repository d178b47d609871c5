"""What the node `drive` commands of a robot with controllers of its own, as the section ``output`` says."""

from __future__ import annotations

from dqwalk_ros.config import Config
from dqwalk_ros.plants.base import require_real_time
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import ConfigError


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
    joints = output.joints or own
    if missing := [name for name in own if name not in joints]:
        raise ConfigError(f"'output.joints' lacks {', '.join(missing)}, which the walk moves")
    if len(set(joints)) < len(joints):
        raise ConfigError("'output.joints' names a joint twice")
    return joints
