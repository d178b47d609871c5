"""Input of force sensors in the feet."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from geometry_msgs.msg import WrenchStamped

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError


class FootForces:
    """The newest force of the ground on each sole, the norm of a wrench: sensors have any axes and either sign.

    Attributes
    ----------
    warning : str
        Why the forces are not used at the last state; empty if they are.

    Raises
    ------
    ConfigError
        In lockstep, where a walk must not depend on which message is the newest.
    """

    def __init__(self, node: WalkNode) -> None:
        if node.lockstep:
            raise ConfigError("'plant.foot_force' must be false in lockstep: sensors of the feet are read in real time")
        self._node, self.warning = node, ""
        self._stamps, self._forces = [0, 0], np.zeros(2)  # [ns], [N]
        self._received = [-math.inf, -math.inf]  # [s]
        for k, foot in enumerate(Foot):
            node.listen(WrenchStamped, f"{foot.value}_foot_wrench", partial(self._on_wrench, k), ros.best_effort(1))

    def _on_wrench(self, k: int, msg: WrenchStamped) -> None:
        force = msg.wrench.force
        if math.isfinite(norm := math.hypot(force.x, force.y, force.z)):
            self._stamps[k], self._forces[k] = ros.nanoseconds(msg.header.stamp), norm
            self._received[k] = self._node.steady()

    def at(self, stamp: int) -> Array | None:
        """Return the forces (2,) [N] for a state with a stamp [ns]; None if one is missing or too old."""
        self.warning, longest = "", self._node.config.plant.command_timeout
        for foot, one, at in zip(Foot, self._stamps, self._received, strict=True):
            if why := ros.untimely(1e-9 * (stamp - one), self._node.steady() - at, longest):
                self.warning = f"the forces of the feet are not used: {foot.value}_foot_wrench: {why}"
                self._node.get_logger().warning(self.warning, **throttled(10.0))
                return None
        return self._forces.copy()
