"""Input of cmd_vel, which steers a walk, checked on arrival."""

from __future__ import annotations

import math

from geometry_msgs.msg import Twist, TwistStamped

from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.watchdog import Watchdog

_STILL = (0.0, 0.0, 0.0)


class Steering:
    """Steers a walk by cmd_vel; after a timeout the walk stops with the feet together.

    Parameters
    ----------
    controller : VelocityController
        Of a standing or dynamic walk with gait.steps: 0.
    """

    def __init__(self, node: WalkNode, controller: VelocityController) -> None:
        self._node, self._controller = node, controller
        self._watchdog = Watchdog(lambda: node.config.gait.cmd_vel_timeout, node.steady)
        self._asked = self._walked = _STILL
        self._receiving = False
        self.rejected = 0
        if node.config.node.stamped_cmd_vel:
            node.listen(TwistStamped, "cmd_vel", lambda msg: self._on_twist(msg.twist), 1)
        else:
            node.listen(Twist, "cmd_vel", self._on_twist, 1)

    def _on_twist(self, msg: Twist) -> None:
        asked = (msg.linear.x, msg.linear.y, msg.angular.z)
        if not all(map(math.isfinite, asked)):
            self.rejected += 1
            self._node.get_logger().error(f"cmd_vel rejected ({self.rejected} so far): not finite", **throttled())
            return
        self._asked = asked
        self._watchdog.feed()

    def apply(self) -> None:
        """Steer the walk by the last message; with zero velocity after a timeout."""
        silent = self._watchdog.silent
        if silent and self._receiving:
            self._node.get_logger().info("cmd_vel timed out: the feet are put together")
        self._receiving = not silent
        asked = _STILL if silent else self._asked
        walked = self._controller.steer(*asked)
        if walked != self._walked:
            self._walked = walked
            excess = max(abs(a - b) for a, b in zip(asked, walked, strict=True))
            cut = " (limited by the reach of the legs)" if excess > 1e-6 else ""
            x, y, turn = walked
            self._node.get_logger().info(f"steered: {x:.4f} m/s forward, {y:.4f} m/s left, {turn:.4f} rad/s{cut}")

    def values(self) -> dict[str, object]:
        """Return the values shown on /diagnostics."""
        names = ("forward", "left", "turn")
        asked = {f"cmd_vel/{name}": value for name, value in zip(names, self._asked, strict=True)}
        walked = {f"steered/{name}": value for name, value in zip(names, self._walked, strict=True)}
        return {**asked, **walked, "cmd_vel rejected": self.rejected}
