"""Steers a walk along a course, then stops it with the feet together.

The time of the course is that of the stamps of the commands, which are those of the robot's states, so the course is
the same in lockstep. It begins when the controller has subscribed to cmd_vel.
"""

from __future__ import annotations

import argparse
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.watchdog import ClockSteps
from dqwalk_ros.support.topics import VELOCITY
from dqwalk_ros.walks.course import Course

_PERIOD = 0.1
"""Period of the commands [s]."""
_SILENT, _REPEATED = 20, 100
"""Periods after which the pilot says that it waits for a controller, and those after which it says so again."""
_LONGEST = 5_000_000_000
"""Longest time between two commands, above which a stamp is wrong, or a clock was set [ns]."""


class Pilot(WalkNode):
    """Steer a standing or dynamic walk along a course: velocities on cmd_vel, one after the other, then ~/stop.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState: its stamps are the time of the course

    Publishes::

        cmd_vel                  geometry_msgs/Twist, ten times a second

    Sections of the schema: gait, node.

    Example::

        dqwalk_pilot --cmd-vel 0.015,0,0,20 --cmd-vel 0,0,0.03,20 --ros-args --params-file config/poppy.yaml

    Raises
    ------
    ConfigError
        If the course is invalid.
    """

    has_diagnostics = False

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("pilot", options, **keywords)
        self._course = Course.parse(options.cmd_vel)
        self._begin = self._now = -1  # stamps [ns]
        self._steps = ClockSteps()
        self._waited = 0  # periods without a controller
        self._ended = 0  # periods since the end of the course
        self._stop_request: Future | None = None
        self._answered = ""  # what was logged of the last answer
        self._twists = self.create_publisher(Twist, "cmd_vel", 1)
        self._stopping = self.create_client(Trigger, "controller/stop")
        self.create_subscription(JointState, VELOCITY, self._on_command, ros.best_effort(1))
        self.create_timer(_PERIOD, self._steer)
        count = len(self._course.legs)
        legs = "1 leg" if count == 1 else f"{count} legs"
        self.get_logger().info(f"a course of {self._course.duration:g} s in {legs}")

    def _on_command(self, msg: JointState) -> None:
        stamp = ros.nanoseconds(msg.header.stamp)
        follows = self._now < 0 or 0 <= stamp - self._now <= _LONGEST
        if not self._steps.accepts(stamp, follows=follows):
            return
        if not follows and self._begin >= 0:
            self._begin += stamp - self._now  # the course goes on
        self._now = stamp

    def _steer(self) -> None:
        if self._now < 0 or not self._twists.get_subscription_count():
            self._waited += 1
            if self._waited % _REPEATED == _SILENT:
                self.get_logger().info("waiting for a controller")
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
        """Call ~/stop of the controller until it succeeds, every 2 s: an answer may be lost, a pause may end."""
        if (request := self._stop_request) is not None and request.done():
            self._stop_request, text = None, f"end of the course; the controller answers: {request.result().message}"
            if text != self._answered:
                self.get_logger().info(text)
            self._answered = text
            if request.result().success:
                self.stop(0)
                return
        if self._ended % _SILENT == 0 and self._stopping.service_is_ready():
            self._stop_request = self._stopping.call_async(Trigger.Request())
        self._ended += 1
