"""Watch a walk from outside: the phase is rebuilt from the topics, and judged by the core's own functions.

The monitor is never in the loop. It looks at one state per period of `monitor.rate`, in the walk's own time, and
passes over the rest without unpacking them: in lockstep states come several times faster than in reality.
"""

from __future__ import annotations

import contextlib
import struct
import sys
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped, PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from dqwalk_ros.assessment import Assessor, support_polygon
from dqwalk_ros.bag.reader import model_of
from dqwalk_ros.bag.topics import FINISHED
from dqwalk_ros.config import Config, from_yaml
from dqwalk_ros.exceptions import DqwalkError, StateError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel, load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.markers import markers
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import STEADY, Life, Throttle, run
from dqwalk_ros.phases import PhaseKind, make_phase

__all__ = ["PhaseMonitorNode", "main"]

_SILENT = 1.0
"""After this long without a state the walk is stale [s]."""


class PhaseMonitorNode:
    """joint_states, phase_start, com_target, swing_target, walk_config, robot_description -> /diagnostics, markers.

    A phase is known from where it began: the base sole is the frame of `phase_start`, and whichever of `com_target`
    and `swing_target` has the same stamp says whether it is double or single support.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.
    """

    rest, last_words = 0.01, 1.0

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        self._parameters = Parameters(node, options.argv)
        self._warm_up(self._parameters.config)
        self._config: Config | None = None
        self._model: RobotModel | None = None
        self._urdf = ""
        self._reader: ros.JointReader | None = None
        self._label = ""
        self._start: JointState | None = None
        self._targets: dict[PhaseKind, Any] = {}
        self._assess: Assessor | None = None
        self._began = 0  # stamp at which the phase began [ns]

        self.handled = 0
        self._next = -1  # stamp from which on a state is looked at [ns]
        self._newest = 0
        self._heard = time.monotonic()
        self._rejected = 0
        self._warn_now = Throttle(2.0)
        self._pub = {
            "diagnostics": ros.publisher(node, "diagnostics"),
            "com": node.create_publisher(PointStamped, "com", ros.stream(10)),
            "support_polygon": node.create_publisher(PolygonStamped, "support_polygon", ros.stream(10)),
            "walk_markers": node.create_publisher(MarkerArray, "walk_markers", ros.stream(10)),
        }
        latched: QoSProfile = ros.latched()
        for kind, topic, callback in (
            (String, "walk_config", self._on_config),
            (String, "robot_description", self._on_description),
            (String, "phase", self._on_phase),
            (JointState, "phase_start", self._on_start),
            (PointStamped, "com_target", self._on_com_target),
            (PoseStamped, "swing_target", self._on_swing_target),
        ):
            node.create_subscription(kind, topic, callback, latched)
        node.create_subscription(JointState, "joint_states", self._on_state, ros.stream(100, reliable=False), raw=True)
        node.create_timer(0.5 * _SILENT, self._watch, clock=STEADY)
        node.get_logger().info("waiting for a walk")

    def _warm_up(self, config: Config) -> None:
        """Have the kinematics compiled before the walk begins."""
        with contextlib.suppress(DqwalkError):
            model = load_model(config.robot)
            Kinematics(model, np.zeros(model.n), Foot.LEFT)

    # ------------------------------------------------------------------ what the walk is

    def _on_config(self, msg: String) -> None:
        try:
            self._config = from_yaml(msg.data, source="walk_config")
        except DqwalkError as error:
            self.node.get_logger().error(str(error))
        self._load()

    def _on_description(self, msg: String) -> None:
        self._urdf = msg.data
        self._load()

    def _load(self) -> None:
        if self._config is None or not self._urdf:
            return
        try:
            self._model = model_of(self._urdf, self._config.robot)
        except DqwalkError as error:
            self.node.get_logger().error(str(error))
            return
        self._reader = ros.JointReader(self._model.joint_names)
        self.node.get_logger().info(f"watching {self._model.name}, {self._model.n} joints")
        self._rebuild()

    def _on_phase(self, msg: String) -> None:
        self.handled += 1
        self._label = msg.data

    def _on_start(self, msg: JointState) -> None:
        self._start, self._assess = msg, None
        self._rebuild()

    def _on_com_target(self, msg: PointStamped) -> None:
        self._targets[PhaseKind.DOUBLE_SUPPORT] = msg
        self._rebuild()

    def _on_swing_target(self, msg: PoseStamped) -> None:
        self._targets[PhaseKind.SINGLE_SUPPORT] = msg
        self._rebuild()

    def _rebuild(self) -> None:
        """Make the phase once everything it is known from has come."""
        self.handled += 1
        if self._start is None or self._model is None or self._config is None or self._reader is None:
            return
        stamp = self._start.header.stamp
        kinds = [kind for kind, target in self._targets.items() if target.header.stamp == stamp]
        feet = {self._model.soles[foot].frame: foot for foot in Foot}
        base = feet.get(self._start.header.frame_id)
        if len(kinds) != 1 or base is None:
            return
        kind = kinds[0]
        single = kind is PhaseKind.SINGLE_SUPPORT
        try:
            q_start = self._reader.state(self._start).q
            target = ros.pose_dq(self._targets[kind]) if single else None
            phase = make_phase(self._config, self._model, kind, base if single else base.other, q_start, target)
            self._assess = Assessor(self._config, self._model, phase)
        except DqwalkError as error:
            self.node.get_logger().error(f"cannot rebuild the phase: {error}")
            return
        self._began = ros.nanoseconds(stamp)
        self._next = -1

    # ------------------------------------------------------------------ the states

    def _on_state(self, raw: bytes) -> None:
        self.handled += 1
        sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
        stamp = sec * 1_000_000_000 + nanosec
        self._heard = time.monotonic()
        back, self._newest = stamp < self._newest, stamp
        if (stamp < self._next and not back) or self._assess is None or self._reader is None or stamp < self._began:
            return
        self._next = stamp + round(1e9 / self._parameters.config.monitor.rate)
        try:
            state = self._reader.state(deserialize_message(raw, JointState))
        except StateError as error:
            self._rejected += 1
            if self._warn_now():
                self.node.get_logger().error(f"joint_states rejected ({self._rejected} so far): {error}")
            self._say(stamp, "ERROR", f"joint_states rejected: {error}", {})
            return
        phase, model = self._assess.phase, self._assess.model
        kin = Kinematics(model, state.q, phase.base)
        found = self._assess(kin, 1e-9 * (stamp - self._began), self._parameters.config.monitor)
        over = self._label in (FINISHED, "idle", "paused", "failed")
        message = f"{self._label}; {found.message}" if over else found.message
        self._say(stamp, found.level, message, {"phase": phase.name, **found.values})
        self._draw(stamp, kin)

    def _draw(self, stamp: int, kin: Kinematics) -> None:
        """Publish what is looked at, if anybody looks."""
        if self._assess is None:
            return
        phase, model = self._assess.phase, self._assess.model
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
            self._pub["walk_markers"].publish(markers(stamp, self._assess.config, model, phase, kin))

    def _watch(self) -> None:
        if time.monotonic() - self._heard > _SILENT:
            label = f"{self._label}; " if self._label else ""
            over = self._label in (FINISHED, "idle", "paused")
            self._say(self._newest, "OK" if over else "STALE", f"{label}no joint_states", {})

    def _say(self, stamp: int, level: str, message: str, values: dict[str, object]) -> None:
        name = self._model.name if self._model else ""
        entry_ = ros.status(f"{self.node.get_name()}: walk", name, level, message, values)
        self._pub["diagnostics"].publish(ros.diagnostics(stamp, entry_))

    def drained(self) -> bool:
        """Nothing to wait for."""
        return True

    def close(self) -> None:
        """Nothing to say."""


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("phase_monitor", sys.argv[1:] if argv is None else argv)
    return run("phase_monitor", lambda node, life: PhaseMonitorNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
