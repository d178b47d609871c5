"""Steer a standing walk along a course, then have it stop with the feet together.

The course is measured in the walk's own time, that of the stamps of joint_states, so it is the same in lockstep. It
begins when the controller listens.
"""

from __future__ import annotations

import struct
import sys
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import STEADY, Life, Worker, run
from dqwalk_ros.standing.course import Course

__all__ = ["PilotNode", "main"]

_PERIOD = 0.1
"""Between two commands [s]."""


class PilotNode(Worker):
    """A course -> cmd_vel.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.

    Raises
    ------
    ConfigError
        If the course cannot be read.
    """

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        Parameters(node, options.argv)
        self._course = Course.parse(options.cmd_vel)
        self._begin = self._now = -1  # stamps [ns]
        self._asked: Future | None = None
        self._twists = node.create_publisher(Twist, "cmd_vel", ros.stream(1))
        self._stop = node.create_client(Trigger, "controller/stop")
        node.create_subscription(JointState, "joint_states", self._on_state, ros.stream(1, reliable=False), raw=True)
        node.create_timer(_PERIOD, self._steer, clock=STEADY)
        node.get_logger().info(f"a course of {self._course.duration:g} s in {len(self._course.legs)} leg(s)")

    def _on_state(self, raw: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
        self._now = sec * 1_000_000_000 + nanosec

    def _steer(self) -> None:
        if self._now < 0 or not self._twists.get_subscription_count():
            return
        if self._begin < 0:
            self._begin = self._now
        asked = self._course.at(1e-9 * (self._now - self._begin))
        msg = Twist()
        if asked is not None:
            msg.linear.x, msg.linear.y, msg.angular.z = map(float, asked)
        self._twists.publish(msg)
        if asked is None:
            self._end()

    def _end(self) -> None:
        """Ask the controller to stop, until it says yes."""
        if self._asked is None:
            if self._stop.service_is_ready():
                self._asked = self._stop.call_async(Trigger.Request())
            return
        if not self._asked.done():
            return
        answer, self._asked = self._asked.result(), None
        self.node.get_logger().info(f"the course is over; the controller says: {answer.message}")
        if answer.success:
            self.life.end(0)


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("pilot", sys.argv[1:] if argv is None else argv)
    return run("pilot", lambda node, life: PilotNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
