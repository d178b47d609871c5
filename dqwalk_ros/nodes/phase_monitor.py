"""Watch a walk from outside: the phase is rebuilt from the topics, and judged by the core's own functions.

The monitor is never in the loop. It looks at one state per period of `monitor.rate`, in the walk's own time, and
passes over the rest without unpacking them: in lockstep states come several times faster than in reality.
"""

from __future__ import annotations

import contextlib
import struct
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped, PoseStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from dqwalk_ros.config import Config
from dqwalk_ros.errors import DqwalkError, StateError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.markers import markers
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Throttle, Worker, run
from dqwalk_ros.report.assessment import Assessor, support_polygon
from dqwalk_ros.topics import FINISHED, TOPICS

__all__ = ["PhaseMonitorNode", "main"]

_SILENT = 1.0
"""After this long without a state the walk is stale [s]."""
_REPAIR = 4.0
"""In lockstep a state is judged this long after it came [s]: on a busy machine the start of its phase may have been
dropped on the way, and the middleware repairs that every 3 s."""
_DEPTH = 5000
"""States that may wait: in lockstep a thousand come in the second that reading the robot's description takes."""


class PhaseMonitorNode(Worker):
    """joint_states, phase_start, com_target, swing_target, walk_config, robot_description -> /diagnostics, markers.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.
    """

    rest = 0.01

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        self._parameters = Parameters(node, options.argv)
        self._warm_up(self._parameters.config)
        self._phases = PhaseLog(node.get_logger())
        self._label = ""
        self._next = -1  # stamp from which on a state is looked at [ns]
        self._newest = 0
        self._waiting: deque[tuple[float, int, bytes]] = deque()  # when it came [s], stamp [ns], message
        self._heard = time.monotonic()
        self._rejected = 0
        self._warn_now = Throttle(2.0)
        self._pub = {
            "diagnostics": ros.publisher(node, "diagnostics"),
            "com": node.create_publisher(PointStamped, "com", ros.stream(10)),
            "support_polygon": node.create_publisher(PolygonStamped, "support_polygon", ros.stream(10)),
            "walk_markers": node.create_publisher(MarkerArray, "walk_markers", ros.stream(10)),
        }
        for name, kind, callback in (
            ("walk_config", String, lambda msg: self._phases.add_config(msg.data)),
            ("robot_description", String, lambda msg: self._phases.add_description(msg.data)),
            ("phase", String, self._on_phase),
            ("phase_start", JointState, self._phases.add_start),
            ("com_target", PointStamped, self._phases.add_target),
            ("swing_target", PoseStamped, self._phases.add_target),
        ):
            node.create_subscription(kind, name, self._counted(callback), ros.latched(TOPICS[name].depth))
        node.create_subscription(
            JointState, "joint_states", self._counted(self._on_state), ros.stream(_DEPTH, reliable=False), raw=True
        )
        node.create_timer(0.1, self._watch, clock=STEADY)
        self._stale_now = Throttle(0.5 * _SILENT)
        node.get_logger().info("waiting for a walk")

    def _warm_up(self, config: Config) -> None:
        """Have the kinematics compiled before the walk begins."""
        with contextlib.suppress(DqwalkError):
            model = load_model(config.robot)
            Kinematics(model, np.zeros(model.n), Foot.LEFT)

    def _counted(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        def handle(msg: Any) -> None:
            self.handled += 1
            callback(msg)

        return handle

    def _on_phase(self, msg: String) -> None:
        self._label = msg.data

    # ------------------------------------------------------------------ the states

    def _on_state(self, raw: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
        stamp = sec * 1_000_000_000 + nanosec
        self._heard = time.monotonic()
        if stamp < self._newest:  # a plant that began again, or whose clock was set back
            self._phases.forget_after(stamp)
            self._waiting.clear()
            self._next = -1
        self._newest = stamp
        if stamp >= self._next:
            self._next = stamp + round(1e9 / self._parameters.config.monitor.rate)
            self._waiting.append((self._heard, stamp, raw))
            self._judge_waiting()

    def _judge_waiting(self, *, all_of_them: bool = False) -> None:
        until = time.monotonic() - (_REPAIR if self._phases.lockstep and not all_of_them else 0.0)
        while self._waiting and self._waiting[0][0] <= until:
            _, stamp, raw = self._waiting.popleft()
            self._judge(stamp, raw)

    def _judge(self, stamp: int, raw: bytes) -> None:
        phase_at = self._phases.at(stamp)
        if phase_at is None or self._phases.reader is None:
            return
        began, assess = phase_at
        try:
            state = self._phases.reader.state(deserialize_message(raw, JointState))
        except StateError as error:
            self._rejected += 1
            if self._warn_now():
                self.node.get_logger().error(f"joint_states rejected ({self._rejected} so far): {error}")
            self._say(stamp, "ERROR", f"joint_states rejected: {error}", {})
            return
        kin = Kinematics(assess.model, state.q, assess.phase.base)
        found = assess(kin, 1e-9 * (stamp - began), self._parameters.config.monitor)
        over = "/" not in self._label and not self._waiting
        message = f"{self._label}; {found.message}" if over else found.message
        self._say(stamp, found.level, message, {"phase": assess.phase.name, **found.values})
        self._draw(stamp, assess, kin)

    def _draw(self, stamp: int, assess: Assessor, kin: Kinematics) -> None:
        """Publish what is looked at, if anybody looks."""
        phase, model = assess.phase, assess.model
        frame = model.soles[phase.base].frame
        if self._pub["com"].get_subscription_count():
            self._pub["com"].publish(ros.point(stamp, frame, kin.com))
        if self._pub["support_polygon"].get_subscription_count():
            msg = PolygonStamped()
            msg.header.stamp, msg.header.frame_id = ros.time_msg(stamp), frame
            vertices = support_polygon(model, phase, kin).vertices
            msg.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in vertices]
            self._pub["support_polygon"].publish(msg)
        if self._pub["walk_markers"].get_subscription_count():
            self._pub["walk_markers"].publish(markers(stamp, assess.config, model, phase, kin))

    def _watch(self) -> None:
        self._judge_waiting()
        if time.monotonic() - self._heard > _SILENT and not self._waiting and self._stale_now():
            label = f"{self._label}; " if self._label else ""
            over = self._label in (FINISHED, "idle", "paused")
            self._say(self._newest, "OK" if over else "STALE", f"{label}no joint_states", {})

    def _say(self, stamp: int, level: str, message: str, values: dict[str, object]) -> None:
        name = self._phases.model.name if self._phases.model else ""
        entry_ = ros.status(f"{self.node.get_name()}: walk", name, level, message, values)
        self._pub["diagnostics"].publish(ros.diagnostics(stamp, entry_))

    def close(self) -> None:
        """Judge what is left."""
        self.last_words = LAST_WORDS[self._phases.lockstep]
        self._judge_waiting(all_of_them=True)


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("phase_monitor", sys.argv[1:] if argv is None else argv)
    return run("phase_monitor", lambda node, life: PhaseMonitorNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
