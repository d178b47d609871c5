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
        self._stamps, self._forces = [-math.inf, -math.inf], np.zeros(2)  # [ns], [N]
        for k, foot in enumerate(Foot):
            node.listen(WrenchStamped, f"{foot.value}_foot_wrench", partial(self._on_wrench, k), ros.best_effort(1))

    def _on_wrench(self, k: int, msg: WrenchStamped) -> None:
        force = msg.wrench.force
        if math.isfinite(norm := math.hypot(force.x, force.y, force.z)):
            self._stamps[k], self._forces[k] = ros.nanoseconds(msg.header.stamp), norm

    def at(self, stamp: int) -> Array | None:
        """Return the forces (2,) [N] for a state with a stamp [ns]; None if one is missing or too old."""
        self.warning, longest = "", self._node.config.plant.command_timeout
        for foot, one in zip(Foot, self._stamps, strict=True):
            if not (off := 1e-9 * abs(stamp - one)) <= longest:
                why = f"its stamp is {off:.3f} s away from the state's" if off < math.inf else "no message yet"
                self.warning = f"the forces of the feet are not used: {foot.value}_foot_wrench: {why}"
                self._node.get_logger().warning(self.warning, **throttled(10.0))
                return None
        return self._forces.copy()
