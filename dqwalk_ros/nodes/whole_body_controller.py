"""The whole-body controller on topics: a state of joints and base comes in, joint torques go out.

The state is three messages with one stamp, joint_states, base_pose and base_twist; the tick begins when all are there.
What a recorder needs to tell the walk again is published as well: the configuration, the robot, and from which state
on which target was in force.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from dqwalk_ros.config import to_yaml
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import DqwalkError, StateError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import THROTTLE, WalkNode
from dqwalk_ros.nodes.inputs import EFFORT
from dqwalk_ros.nodes.safety import BodyGate, FaultCounter
from dqwalk_ros.provenance import here, to_text
from dqwalk_ros.robot import load_model
from dqwalk_ros.topics import ODOM
from dqwalk_ros.whole_body import controller as core
from dqwalk_ros.whole_body.controller import BodyState

__all__ = ["WholeBodyController"]

Array = NDArray[np.float64]

_PARTS = 20
"""So many messages of each kind wait for the rest of their state."""


class WholeBodyController(WalkNode):
    """Walk where the hand wants to go, and keep able to stop: answer each state with joint torques.

    Subscribes to::

        joint_states, base_pose, base_twist   one state in three messages with one stamp [rad, rad/s, m, m/s]:
                                 sensor_msgs/JointState; geometry_msgs/PoseStamped of the root link in odom;
                                 geometry_msgs/TwistStamped of it in its own axes
        hand_target              geometry_msgs/PoseStamped: where the hand should be in odom; move it at any time

    Publishes::

        joint_effort_commands    sensor_msgs/JointState [N m]; stamp: that of the state it answers
        hand_target_applied      geometry_msgs/PoseStamped, latched; stamp: the first state that it holds for
        walk_config              std_msgs/String, latched: all parameters in force
        walk_origin              std_msgs/String, latched: versions and machine
        robot_description        std_msgs/String, latched: URDF
        /diagnostics             diagnostic_msgs/DiagnosticArray: WARN where it cannot stop within the preview

    Sections of the schema: dt, robot, gait, whole_body.

    Example::

        dqwalk_whole_body_controller --ros-args --params-file config/whole_body.yaml -p whole_body.friction:=0.4
    """

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("whole_body_controller", options, **keywords)
        model = load_model(self.config.robot)
        self._controller = core.WholeBodyController(self.config, model)
        safety = self.config.safety
        self._gate = BodyGate(
            model, self.config.dt, lambda: self.config.plant.command_timeout, outside=safety.outside, jumps=safety.jumps
        )
        self._failures = FaultCounter(safety.failures)
        self._most = np.minimum(model.effort_max, self.config.whole_body.effort)
        self._names = {name: i for i, name in enumerate(model.joint_names)}
        self._hardware = model.name
        self._begin: int | None = None  # stamp of the first state [ns]
        self._joints: dict[int, tuple[Array, Array]] = {}
        self._poses: dict[int, Array] = {}
        self._twists: dict[int, Array] = {}
        self._failed = ""
        self._counts = {"ticks": 0, "states rejected": 0, "targets rejected": 0, "capturability missed": 0}
        self._new_target: list[float] | None = None  # of which no state has been told yet
        latched = {
            "walk_config": to_yaml(self.config),
            "walk_origin": to_text(here()),
            "robot_description": model.urdf,
        }
        streams = (EFFORT, "hand_target_applied", *latched)
        self._pub = {name: self.advertise(name) for name in streams}
        for name, text in latched.items():
            self._pub[name].publish(String(data=text))
        self.create_subscription(JointState, "joint_states", self._on_joints, ros.stream(10))
        self.create_subscription(PoseStamped, "base_pose", self._on_pose, ros.stream(10))
        self.create_subscription(TwistStamped, "base_twist", self._on_twist, ros.stream(10))
        self.create_subscription(PoseStamped, "hand_target", self._on_target, ros.stream(10))
        self._every = max(round(1.0 / (self.config.monitor.rate * self.config.dt)), 1)
        self.get_logger().info(f"{model.name}: {model.n} joints, {model.mass:.1f} kg, no target yet")

    def _on_joints(self, msg: JointState) -> None:
        try:
            q, dq = self._read(msg)
        except StateError as error:
            self._reject(error)
            return
        self._joints[ros.nanoseconds(msg.header.stamp)] = q, dq
        self._tick(ros.nanoseconds(msg.header.stamp))

    def _on_pose(self, msg: PoseStamped) -> None:
        r = msg.pose.orientation
        norm = float(np.linalg.norm([r.w, r.x, r.y, r.z]))
        if not abs(norm - 1.0) < 1e-3:
            self._reject(StateError(f"base_pose has a quaternion of norm {norm:.3g}"))
            return
        self._poses[ros.nanoseconds(msg.header.stamp)] = DQ(ros.pose_dq(msg)).normalized().vec8()
        self._tick(ros.nanoseconds(msg.header.stamp))

    def _on_twist(self, msg: TwistStamped) -> None:
        v, w = msg.twist.linear, msg.twist.angular
        self._twists[ros.nanoseconds(msg.header.stamp)] = np.array([v.x, v.y, v.z, w.x, w.y, w.z])
        self._tick(ros.nanoseconds(msg.header.stamp))

    def _on_target(self, msg: PoseStamped) -> None:
        p = msg.pose.position
        try:
            self._controller.reach([p.x, p.y, p.z])
            self._new_target = [p.x, p.y, p.z]
        except StateError as error:
            self._counts["targets rejected"] += 1
            self.get_logger().error(f"hand_target rejected: {error}")

    def _read(self, msg: JointState) -> tuple[Array, Array]:
        """Return angles and velocities in the order of the model."""
        q, dq = np.full(len(self._names), np.nan), np.full(len(self._names), np.nan)
        if not len(msg.name) == len(msg.position) == len(msg.velocity):
            raise StateError("joint_states must have as many positions and velocities as names")
        if len(set(msg.name)) < len(msg.name):
            raise StateError("joint_states names a joint twice")
        for name, angle, speed in zip(msg.name, msg.position, msg.velocity, strict=True):
            if name in self._names:
                q[self._names[name]], dq[self._names[name]] = angle, speed
        missing = [name for name, i in self._names.items() if not np.isfinite(q[i] + dq[i])]
        if missing:
            raise StateError(f"joint_states has no finite angle and velocity of {', '.join(missing)}")
        return q, dq

    def _tick(self, stamp: int) -> None:
        """Answer the state with this stamp once it is complete."""
        for part in (self._joints, self._poses, self._twists):
            while len(part) > _PARTS:  # of states that never got complete
                del part[min(part)]
        if self._failed or not all(stamp in part for part in (self._joints, self._poses, self._twists)):
            return
        if not self._may_answer():
            return  # the plant asks again
        (q, dq), pose, twist = self._joints[stamp], self._poses[stamp], self._twists[stamp]
        for part in (self._joints, self._poses, self._twists):
            for old in [key for key in part if key <= stamp]:
                del part[old]
        begin = stamp if self._begin is None else self._begin
        state = BodyState(1e-9 * (stamp - begin), q, dq=dq, x_base=pose, v_base=twist)
        try:
            self._gate.accept_body(stamp, q, dq, np.array(DQ(pose).translation()), twist)
            command = self._controller.step(state, self.config.dt)
        except StateError as error:
            self._reject(error)
            return
        except DqwalkError as error:
            self._fail(f"no motion for this state: {error}", stamp)
            return
        if not np.isfinite(command.effort).all():
            self._fail("the torques are not finite", stamp)
            return
        self._failures.good()
        self._begin = begin
        if self._new_target is not None:
            x_target = DQ.from_pose(self._new_target).vec8()
            self._pub["hand_target_applied"].publish(ros.pose(stamp, ODOM, x_target))
            self._new_target = None
        msg = JointState()
        msg.header.stamp = ros.time_msg(stamp)
        msg.name = list(self._names)
        msg.effort = np.clip(command.effort, -self._most, self._most).tolist()
        self._pub[EFFORT].publish(msg)
        self._counts["ticks"] += 1
        self._counts["capturability missed"] += self._controller.last.answer.residual > 1e-6
        if self._counts["ticks"] % self._every == 1:
            self._diagnose(stamp)

    def _fail(self, why: str, stamp: int) -> None:
        """Leave a state without an answer, and end after `safety.failures` of them in a row."""
        self.get_logger().error(why, **THROTTLE)
        if self._failures.fault(why):
            self._failed = why
            self.get_logger().error(f"no command any more: {why}")
            self._diagnose(stamp)
            self.stop(1)

    def _may_answer(self) -> bool:
        """Hold the first answer of a recorded walk until nothing of it can be lost."""
        if self._counts["ticks"] or not self.config.node.wait_for_recorder:
            return True
        return ros.is_heard_by(self, self._pub[EFFORT], "recorder")

    def _reject(self, error: StateError) -> None:
        self._counts["states rejected"] += 1
        self.get_logger().error(f"state rejected ({self._counts['states rejected']} so far): {error}", **THROTTLE)

    def _diagnose(self, stamp: int) -> None:
        level, text = ("ERROR", self._failed) if self._failed else ("OK", "in balance")
        values: dict[str, Any] = dict(self._counts)
        if not self._failed:
            last = self._controller.last.answer
            if last.residual > 1e-6:
                level, text = "WARN", "cannot stop within the preview"
            values |= {"capturability": last.residual, "solve time": last.solve_time, "solver": last.method}
        self.diagnose("balance", self._hardware, level, text, values, stamp)
