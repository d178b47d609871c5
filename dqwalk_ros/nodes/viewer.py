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
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import DqwalkError, StateError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import RobotModel
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.nodes.runtime import STEADY, Life, Throttle, Worker, run
from dqwalk_ros.phases import Phase
from dqwalk_ros.report.scene import Moment, Scene
from dqwalk_ros.report.viewer.page import FRAME, Page
from dqwalk_ros.topics import TOPICS

__all__ = ["ViewerNode", "main"]

Array = NDArray[np.float64]


class ViewerNode(Worker):
    """joint_states, phase, phase_start, com_target, swing_target, walk_config, robot_description -> a page.

    Where in odom the walk is, follows from the phases: each begins where the one before it has put its foot. Only
    once `base_pose` is asked, for a walk whose first phases nobody keeps any more.

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

    last_words = 0.0

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        Parameters(node, options.argv)
        self.page = Page(options.port)
        self._phases = PhaseLog(node.get_logger())
        self._shown: RobotModel | None = None
        self._label = ""
        self._phase: Phase | None = None
        self._index = -1
        self._began = -1  # [ns]
        self._origin = 0  # of the time shown: where the first phase seen began [ns]
        self._x_odom_base = DQ(1.0).vec8()
        self._raw: bytes | None = None
        self._newest = -1  # [ns]
        self._states: dict[int, Array] = {}  # by stamp [ns], until base_pose has told where in odom they are
        self._solver = ""
        self._warn_now = Throttle(2.0)
        for name, kind, callback in (
            ("walk_config", String, self._on_config),
            ("robot_description", String, self._on_description),
            ("phase", String, self._on_phase),
            ("phase_start", JointState, self._phases.add_start),
            ("com_target", PointStamped, self._phases.add_target),
            ("swing_target", PoseStamped, self._phases.add_target),
        ):
            node.create_subscription(kind, name, callback, ros.latched(TOPICS[name].depth))
        newest = ros.stream(1, reliable=False)
        node.create_subscription(JointState, "joint_states", self._on_state, newest, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, ros.stream(10))
        self._odometry: Any = node.create_subscription(PoseStamped, "base_pose", self._on_pose, ros.stream(1))
        node.create_timer(FRAME, self._show, clock=STEADY)
        node.get_logger().info(f"the page is {self.page.url}")

    # ------------------------------------------------------------------ what the walk is

    def _on_config(self, msg: String) -> None:
        self._phases.add_config(msg.data)
        self._load()

    def _on_description(self, msg: String) -> None:
        self._phases.add_description(msg.data)
        self._load()

    def _load(self) -> None:
        config, model = self._phases.config, self._phases.model
        if config is None or model is None or model is self._shown:
            return
        try:
            self.page.set_scene(Scene(config, model))
        except DqwalkError as error:
            self.node.get_logger().error(str(error))
            return
        self._shown = model
        self._restart()
        self.page.total_steps = 2 * config.gait.cycles

    def _on_phase(self, msg: String) -> None:
        self._label = msg.data

    def _restart(self) -> None:
        self._phase, self._index, self._began = None, -1, -1
        self._x_odom_base = DQ(1.0).vec8()

    def _follow(self, stamp: int) -> bool:
        """Enter the phase that a state [ns] is in, through those before it; tell whether it is known."""
        if stamp < self._newest:  # a plant that began again, or whose clock was set back
            self._phases.forget_after(stamp)
            self._restart()
        self._newest = stamp
        for began in self._phases.begun(self._began, stamp):
            found = self._phases.at(began)
            if found is None:
                return False
            self._enter(began, found[1].model, found[1].phase)
        return self._phase is not None

    def _enter(self, began: int, model: RobotModel, phase: Phase) -> None:
        self._index += 1
        if self._index == 0:
            self._origin = began
        if self._phase is not None and phase.base is not self._phase.base:
            # the world moves to the other sole, as that stood
            kin = Kinematics(model, phase.q_start, self._phase.base)
            self._x_odom_base = kernels.compose(self._x_odom_base, kin.pose(kin.swing))
        self._phase, self._began, self._states = phase, began, {}

    # ------------------------------------------------------------------ the states

    def _on_state(self, raw: bytes) -> None:
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
        model, reader = self._phases.model, self._phases.reader
        if raw is None or model is None or model is not self._shown or reader is None:
            return
        sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
        stamp = sec * 1_000_000_000 + nanosec
        if not self._follow(stamp) or self._phase is None:
            return
        try:
            q = reader.state(deserialize_message(raw, JointState)).q
        except StateError as error:
            if self._warn_now():
                self.node.get_logger().error(f"joint_states rejected: {error}")
            return
        if self._odometry is not None:
            pelvis = Kinematics(model, q, self._phase.base).pose(model.pelvis)
            self._states = {**dict(list(self._states.items())[-50:]), stamp: pelvis}
        self.page.show(
            Moment(
                time=1e-9 * (stamp - self._origin),
                q=q,
                phase=self._phase,
                index=self._index,
                began=1e-9 * (self._began - self._origin),
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
