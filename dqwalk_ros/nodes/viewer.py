"""Show a walk in the browser while it goes on.

The node only listens: it takes the newest state, as often as a picture is due, and rebuilds the phase from the topics.
Nobody waits for it.
"""

from __future__ import annotations

import struct
import sys
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from dqwalk_ros import kernels
from dqwalk_ros.bag.reader import model_of
from dqwalk_ros.config import Config, from_yaml
from dqwalk_ros.dq import DQ
from dqwalk_ros.exceptions import DqwalkError, StateError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import STEADY, Life, Throttle, Worker, run
from dqwalk_ros.phases import Phase, PhaseKind, make_phase
from dqwalk_ros.scene import Moment, Scene
from dqwalk_ros.viewer.page import FRAME, Page

__all__ = ["ViewerNode", "main"]

Array = NDArray[np.float64]


class ViewerNode(Worker):
    """joint_states, phase, phase_start, com_target, swing_target, walk_config, robot_description -> a page.

    Where in odom the walk is, follows from the phases: each begins where the one before it has put its foot. Only
    of the first phase that is seen `base_pose` is asked.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.

    Raises
    ------
    ViewerError
        If the page's port is taken.
    """

    rest, last_words = 0.0, 0.0

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        Parameters(node, options.argv)
        self.page = Page(options.port)
        self.handled = 0
        self._config: Config | None = None
        self._model: RobotModel | None = None
        self._urdf = ""
        self._reader: ros.JointReader | None = None
        self._label = ""
        self._start: JointState | None = None
        self._targets: dict[PhaseKind, Any] = {}
        self._phase: Phase | None = None
        self._index = -1
        self._began = 0  # [ns]
        self._x_odom_base = DQ(1.0).vec8()
        self._raw: bytes | None = None
        self._states: dict[int, Array] = {}  # by stamp [ns], until base_pose has told where in odom they are
        self._solver = ""
        self._warn_now = Throttle(2.0)
        latched = ros.latched()
        for kind, topic, callback in (
            (String, "walk_config", self._on_config),
            (String, "robot_description", self._on_description),
            (String, "phase", self._on_phase),
            (JointState, "phase_start", self._on_start),
            (PointStamped, "com_target", self._on_com_target),
            (PoseStamped, "swing_target", self._on_swing_target),
        ):
            node.create_subscription(kind, topic, callback, latched)
        newest = ros.stream(1, reliable=False)
        node.create_subscription(JointState, "joint_states", self._on_state, newest, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, ros.stream(10))
        self._odometry: Any = node.create_subscription(PoseStamped, "base_pose", self._on_pose, ros.stream(1))
        node.create_timer(FRAME, self._show, clock=STEADY)
        node.get_logger().info(f"the page is {self.page.url}")

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
            self.page.set_scene(Scene(self._config, self._model))
        except DqwalkError as error:
            self.node.get_logger().error(str(error))
            return
        self.page.total_steps = 2 * self._config.gait.cycles
        self._reader = ros.JointReader(self._model.joint_names)
        self._rebuild()

    def _on_phase(self, msg: String) -> None:
        self.handled += 1
        self._label = msg.data

    def _on_start(self, msg: JointState) -> None:
        self._start = msg
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
        base = {self._model.soles[foot].frame: foot for foot in Foot}.get(self._start.header.frame_id)
        began = ros.nanoseconds(stamp)
        if len(kinds) != 1 or base is None or (self._phase is not None and began == self._began):
            return
        single = kinds[0] is PhaseKind.SINGLE_SUPPORT
        try:
            q_start = self._reader.state(self._start).q
            target = ros.pose_dq(self._targets[kinds[0]]) if single else None
            phase = make_phase(self._config, self._model, kinds[0], base if single else base.other, q_start, target)
        except DqwalkError as error:
            self.node.get_logger().error(f"cannot rebuild the phase: {error}")
            return
        if self._phase is None or began < self._began:
            self._x_odom_base, self._index = DQ(1.0).vec8(), 0
        else:
            self._index += 1
            if base is not self._phase.base:  # the world moves to the other sole, as that stood
                kin = Kinematics(self._model, q_start, self._phase.base)
                self._x_odom_base = kernels.compose(self._x_odom_base, kin.pose(kin.swing))
        self._phase, self._began = phase, began

    # ------------------------------------------------------------------ the states

    def _on_state(self, raw: bytes) -> None:
        self.handled += 1
        self._raw = raw

    def _on_pose(self, msg: PoseStamped) -> None:
        """Find where the first phase seen stands in odom, from the pelvis at one of its states; then listen no more."""
        x = self._states.get(ros.nanoseconds(msg.header.stamp))
        if x is None or self._odometry is None:
            return
        self._x_odom_base = (DQ(ros.pose_dq(msg)) * DQ(x).conj()).vec8()
        self.node.destroy_subscription(self._odometry)
        self._odometry, self._states = None, {}

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name.startswith("controller:"):
                values = {pair.key: pair.value for pair in status.values}
                if "iterations" not in values:
                    self._solver = status.message
                    continue
                micro = 1e6 * float(values.get("solve time", "nan"))
                active = values.get("active rows", "") or "none"
                self._solver = f"{values['iterations']} iterations, {micro:.0f} µs; active: {active}"

    def _show(self) -> None:
        """Draw the newest state."""
        raw, self._raw = self._raw, None
        if raw is None or self._phase is None or self._reader is None or self._model is None:
            return
        sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
        stamp = sec * 1_000_000_000 + nanosec
        if stamp < self._began:
            return
        try:
            q = self._reader.state(deserialize_message(raw, JointState)).q
        except StateError as error:
            if self._warn_now():
                self.node.get_logger().error(f"joint_states rejected: {error}")
            return
        if self._odometry is not None:
            pelvis = Kinematics(self._model, q, self._phase.base).pose(self._model.pelvis)
            self._states = {**dict(list(self._states.items())[-50:]), stamp: pelvis}
        self.page.show(
            Moment(
                time=1e-9 * stamp,
                q=q,
                phase=self._phase,
                index=self._index,
                began=1e-9 * self._began,
                x_odom_base=self._x_odom_base,
                label=self._label,
                solver=self._solver,
            )
        )

    def close(self) -> None:
        """End the page."""
        self.page.close()


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("viewer", sys.argv[1:] if argv is None else argv)
    return run("viewer", lambda node, life: ViewerNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
