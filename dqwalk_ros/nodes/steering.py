"""cmd_vel: somebody steers the walk, and when he falls silent it stops with the feet together."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from geometry_msgs.msg import Twist
from rclpy.node import Node

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Controller
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.runtime import Throttle
from dqwalk_ros.safety import Watchdog

__all__ = ["Steering"]

_STILL = (0.0, 0.0, 0.0)


class Steering:
    """Passes cmd_vel on to a controller.

    Parameters
    ----------
    node : rclpy.node.Node
    config : Config
    controller : Controller
        Of a standing walk without a number of steps.
    clock : callable
        Steady time [s].
    """

    def __init__(
        self, node: Node, config: Config, controller: Controller, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._node, self._controller = node, controller
        self._watchdog = Watchdog(lambda: config.gait.cmd_vel_timeout, clock)
        self._asked = self._walked = _STILL
        self._heard = False
        self.rejected = 0
        self._warn_now = Throttle(2.0)
        node.create_subscription(Twist, "cmd_vel", self._on_twist, ros.stream(1))

    def _on_twist(self, msg: Twist) -> None:
        asked = (msg.linear.x, msg.linear.y, msg.angular.z)
        if not all(map(math.isfinite, asked)):
            self.rejected += 1
            if self._warn_now():
                self._node.get_logger().error(f"cmd_vel rejected ({self.rejected} so far): not finite")
            return
        self._asked = asked
        self._watchdog.feed()

    def apply(self) -> None:
        """Steer the walk by what came last, and not at all where that is too old."""
        silent = self._watchdog.silent
        if silent and self._heard:
            self._node.get_logger().info("cmd_vel fell silent: the feet are put together")
        self._heard = not silent
        asked = _STILL if silent else self._asked
        walked = self._controller.steer(*asked)
        if walked != self._walked:
            self._walked = walked
            off = max(abs(a - b) for a, b in zip(asked, walked, strict=True))
            cut = " (as far as the legs go)" if off > 1e-6 else ""
            x, y, turn = walked
            self._node.get_logger().info(f"steered: {x:.4f} m/s forward, {y:.4f} m/s left, {turn:.4f} rad/s{cut}")

    def values(self) -> dict[str, object]:
        """Return what there is to tell on /diagnostics."""
        names = ("forward", "left", "turn")
        asked = {f"cmd_vel/{name}": value for name, value in zip(names, self._asked, strict=True)}
        walked = {f"steered/{name}": value for name, value in zip(names, self._walked, strict=True)}
        return {**asked, **walked, "cmd_vel rejected": self.rejected}
