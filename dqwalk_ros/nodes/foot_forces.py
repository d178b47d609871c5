"""Input of force sensors in the feet."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from geometry_msgs.msg import WrenchStamped

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError

__all__ = ["FootForces"]


class FootForces:
    """The newest force of the ground on each sole, the norm of a wrench: sensors have any axes and either sign.

    Raises
    ------
    ConfigError
        In lockstep, where a walk must not depend on which message is the newest.
    """

    def __init__(self, node: WalkNode) -> None:
        if node.lockstep:
            raise ConfigError("'plant.foot_force' must be false in lockstep: sensors of the feet are read in real time")
        self._node = node
        self._stamps, self._forces = [-math.inf, -math.inf], np.zeros(2)  # [ns], [N]
        for k, foot in enumerate(Foot):
            node.listen(WrenchStamped, f"{foot.value}_foot_wrench", partial(self._on_wrench, k), ros.best_effort(1))

    def _on_wrench(self, k: int, msg: WrenchStamped) -> None:
        force = msg.wrench.force
        if math.isfinite(norm := math.hypot(force.x, force.y, force.z)):
            self._stamps[k], self._forces[k] = ros.nanoseconds(msg.header.stamp), norm

    def at(self, stamp: int) -> Array | None:
        """Return the forces (2,) [N] for a state with a stamp [ns]; None if one is missing or too old."""
        longest = 1e9 * self._node.config.plant.command_timeout
        return self._forces.copy() if all(abs(stamp - one) <= longest for one in self._stamps) else None
