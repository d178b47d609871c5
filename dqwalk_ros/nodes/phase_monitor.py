"""Monitors a walk from its topics: rebuilds the phase and evaluates it with the same functions as the controller.

The monitor is not part of the control loop. It evaluates one state per period of `monitor.rate`, in the time of the
stamps, and skips the others without deserialising them: in lockstep states arrive several times faster than real time.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from collections import deque
from typing import Any

import numpy as np
from geometry_msgs.msg import Point32, PointStamped, PolygonStamped
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.fall_cause import FallCause
from dqwalk_ros.nodes.markers import markers
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import names_phase
from dqwalk_ros.report.metrics import support_polygon
from dqwalk_ros.report.verdict import Assessor
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import DqwalkError, StateError
from dqwalk_ros.support.topics import FALLEN, FINISHED

_TIMEOUT = 1.0
"""Time without a state after which the walk is reported as stale [s]."""
_RESEND = 4.0
"""In lockstep, and before the walk is known, a state is evaluated this long after its arrival [s]: on a busy machine
walk_config arrives after the first states, and a message with the start of a phase may be lost, which the middleware
may take 3 s to send again."""
_SETTLES = 0.5
"""Time after a fall for which the last messages of the walk are awaited [s]."""
_DEPTH = 5000
"""Depth of the queue of states: in lockstep a thousand arrive in the second that reading the URDF takes."""


class PhaseMonitor(WalkNode):
    """Monitor a walk: recompute every distance, error and margin from its topics.

    Subscribes to::

        joint_states, phase, phase_start, com_target, swing_target, walk_config, robot_description   as the
                                 controller publishes them; the parameters of the walk are read from walk_config,
                                 not from the parameters of this node
        imu                      sensor_msgs/Imu, if the plant has the sensor: the vertical
        joint_velocity_commands  sensor_msgs/JointState: with them, why the robot fell

    Publishes::

        /diagnostics             diagnostic_msgs/DiagnosticArray: OK, WARN or ERROR by the smallest distance
        com                      geometry_msgs/PointStamped, in the phase's base sole
        support_polygon          geometry_msgs/PolygonStamped
        walk_markers             visualization_msgs/MarkerArray: planes, cylinder, CoM, soles (RViz, Foxglove)

    Sections of the schema: monitor.

    Example::

        dqwalk_phase_monitor --ros-args --params-file config/paper.yaml -p monitor.rate:=20.0
    """

    pause = 0.01
    claims = "walk_markers"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("phase_monitor", options, **keywords)
        with contextlib.suppress(DqwalkError):  # compile the kinematics before the walk begins
            model = load_model(self.config.robot)
            Kinematics(model, np.zeros(model.n), Foot.LEFT)
        self._phases = PhaseLog(self)
        self._fall = FallCause(self, self._phases)
        self._fallen_at = math.inf  # time of receipt [s]
        self._cause = ""  # of the fall
        self._next = -1  # earliest stamp of the next one [ns]
        self._waiting: deque[tuple[float, int, JointState]] = deque()  # time of receipt [s], stamp [ns], message
        self._received = self.steady()
        self._rejected = 0
        self._pub = {
            "com": self.create_publisher(PointStamped, "com", 10),
            "support_polygon": self.create_publisher(PolygonStamped, "support_polygon", 10),
            "walk_markers": self.create_publisher(MarkerArray, "walk_markers", 10),
        }
        # in lockstep no state may be lost, and they arrive in bursts
        profile = _DEPTH if self.config.plant.lockstep else ros.best_effort(_DEPTH)
        self.listen(JointState, "joint_states", self._on_state, profile, raw=True)
        self.create_timer(0.1, self._check_timeout)
        self._timeout_published = 0.0  # steady time [s]
        self.get_logger().info("waiting for a walk")

    # ------------------------------------------------------------------ the states

    def _on_state(self, raw: bytes) -> None:
        try:
            stamp = ros.stamp_of(raw)
        except StateError as error:
            self.get_logger().error(f"joint_states rejected: {error}", **throttled())
            return
        self._fall.add_state(raw)
        if self._phases.newest <= stamp < self._next:
            self._received = self.steady()
            return
        try:
            msg = ros.deserialized(raw, JointState)
        except StateError as error:
            self._reject(stamp, error)
            return
        if self._phases.is_foreign(msg):
            return
        self._received = self.steady()
        match self._phases.register(stamp):
            case "wrong":
                return
            case "set back":
                self._fall.forget()
                self._waiting.clear()
        self._next = stamp + round(1e9 / self.config.monitor.rate)
        self._waiting.append((self._received, stamp, msg))
        self._evaluate_waiting()

    def _reject(self, stamp: int, error: StateError) -> None:
        self._rejected += 1
        text = f"joint_states rejected ({self._rejected} so far): {error}"
        self.get_logger().error(text, **throttled())
        self._publish_status(stamp, "ERROR", f"joint_states rejected: {error}", {})

    def _evaluate_waiting(self, *, all_of_them: bool = False) -> None:
        if not self.may_publish():
            return
        known = self._phases.reader is not None and not self._phases.lockstep
        until = self.steady() - (0.0 if known or all_of_them else _RESEND)
        while self._waiting and self._waiting[0][0] <= until:
            _, stamp, msg = self._waiting.popleft()
            self._evaluate(stamp, msg)

    def _evaluate(self, stamp: int, msg: JointState) -> None:
        phase_at = self._phases.at(stamp)
        if phase_at is None or self._phases.reader is None or self._phases.is_foreign(msg):
            return
        began, assess = phase_at
        try:
            state = self._phases.reader.state(msg)
        except StateError as error:
            self._reject(stamp, error)
            return
        kin = Kinematics.measured(assess.model, state.q, assess.phase.base, self._phases.up(stamp))
        found = assess(kin, 1e-9 * (stamp - began), self.config.monitor)
        over = not names_phase(self._phases.label) and not self._waiting
        message = f"{self._label}; {found.message}" if over else found.message
        self._publish_status(stamp, found.level, message, {"phase": assess.phase.name, **found.values})
        self._draw(stamp, assess, kin)

    def _draw(self, stamp: int, assess: Assessor, kin: Kinematics) -> None:
        """Publish CoM, support polygon and markers, each only if it has subscribers."""
        phase, model = assess.phase, assess.model
        frame = model.soles[phase.base].frame
        if self._pub["com"].get_subscription_count():
            self._pub["com"].publish(ros.point(stamp, frame, kin.com))
        if self._pub["support_polygon"].get_subscription_count():
            msg = PolygonStamped(header=ros.header(stamp, frame))
            vertices = support_polygon(model, phase.base, kin, double=phase.double).vertices
            msg.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in vertices]
            self._pub["support_polygon"].publish(msg)
        if self._pub["walk_markers"].get_subscription_count():
            self._pub["walk_markers"].publish(markers(stamp, assess.config, model, phase, kin))

    @property
    def _label(self) -> str:
        """The last message of `phase`, after a fall with its cause."""
        return f"{self._phases.label}; {self._cause}" if self._cause else self._phases.label

    def _look_for_the_cause(self, now: float) -> None:
        """Find and publish, once, why the robot has fallen."""
        if self._phases.label != FALLEN:
            self._fallen_at, self._cause = math.inf, ""
            return
        if self._fallen_at == math.inf:
            self._fallen_at = now
        if self._cause or now - self._fallen_at < _SETTLES or self._waiting:
            return
        self._cause = self._fall.find() or "the cause is not known"
        self.get_logger().error(f"the robot fell; {self._cause}")
        self._publish_status(max(self._phases.newest, 0), "ERROR", self._label, {})

    def _check_timeout(self) -> None:
        self._evaluate_waiting()
        self._look_for_the_cause(self.steady())
        now = self.steady()
        if min(now - self._received, 2.0 * (now - self._timeout_published)) > _TIMEOUT and not self._waiting:
            self._timeout_published = now
            label = f"{self._label}; " if self._phases.label else ""
            over = self._phases.label in (FINISHED, "idle", "paused")
            self._publish_status(max(self._phases.newest, 0), "OK" if over else "STALE", f"{label}no joint_states", {})

    def _publish_status(self, stamp: int, level: str, message: str, values: dict[str, object]) -> None:
        name = self._phases.model.name if self._phases.model else ""
        self.diagnose("walk", name, level, message, values, stamp)

    @property
    def lockstep(self) -> bool:
        """Whether the monitored walk is in lockstep, regardless of the parameters of this node."""
        return self._phases.lockstep

    def close(self) -> None:
        """Evaluate the states that are still waiting, as soon as the recorder receives what is published of them."""
        if self._waiting and not self.may_publish(self.patience):
            count = len(self._waiting)
            self.get_logger().warning(f"{count} states are not judged: no recorder has subscribed to /diagnostics")
        self._evaluate_waiting(all_of_them=True)
