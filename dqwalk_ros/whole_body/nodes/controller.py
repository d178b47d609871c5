"""The whole-body controller as a node: it answers each state of joints and base with joint torques.

A state consists of three messages with one stamp: joint_states, base_pose and base_twist. The configuration, the robot
and the stamp from which each target applies are published as well, so that a recorded walk can be recomputed.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from sensor_msgs.msg import JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.answering import AnsweringNode
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import ODOM
from dqwalk_ros.whole_body import controller as core
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState
from dqwalk_ros.whole_body.hierarchy import Answer
from dqwalk_ros.whole_body.nodes.body_gate import BodyGate

_PARTS = 20
"""Most states of which messages are missing."""
_AT_REST = 0.05
"""Largest velocity of a robot at rest, which a walk starts from [m/s, rad/s]."""
_DAY = 86_400_000_000_000
"""Stamps below this are simulated time, counted from the start of the walk [ns]."""


class WholeBodyController(AnsweringNode):
    """Walk to where the hand can reach its target, always able to stop: answer each state with joint torques.

    Subscribes to::

        joint_states, base_pose, base_twist   one state in three messages with one stamp [rad, rad/s, m, m/s]:
                                 sensor_msgs/JointState; geometry_msgs/PoseStamped of the root link in odom;
                                 geometry_msgs/TwistStamped of the root link in its own axes
        hand_target              geometry_msgs/PoseStamped: target of the hand in odom; may change at any time

    Publishes::

        joint_effort_commands    sensor_msgs/JointState [N m]; stamp: that of the state it answers
        hand_target_applied      geometry_msgs/PoseStamped, latched; stamp: the first state to which it applies
        walk_config              std_msgs/String, latched: all current parameters
        walk_origin              std_msgs/String, latched: versions and machine
        robot_description        std_msgs/String, latched: URDF
        /diagnostics             diagnostic_msgs/DiagnosticArray: WARN if it cannot stop within the preview,
                                 ERROR if states are rejected or the walk has failed, STALE without states

    Services::

        ~/reset                  std_srvs/Trigger: starts a new walk, without a target

    Sections of the schema: dt, robot, gait, whole_body, plant, monitor, safety, node.

    Example::

        dqwalk_whole_body_controller --ros-args --params-file config/whole_body.yaml -p whole_body.friction:=0.4
    """

    claims = "joint_effort_commands"
    gate = BodyGate
    _gate: BodyGate
    field, stopping = "effort", "zero torque"
    states, awaited = "body state", ("joint_states", "base_pose", "base_twist")
    what = "balance"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("whole_body_controller", options, **keywords)
        model = self._model
        self._controller = core.WholeBodyController(self.config, model)
        self._effort_max = np.minimum(model.effort_max, self.config.whole_body.effort)
        self._answered = self._still  # the last command that answers a state
        self._q_answered: Array = np.empty(0)  # joint angles of this state
        self._begin: int | None = None  # stamp at which the walk began [ns]
        self._last: Answer | None = None  # of the hierarchy
        self._parts: dict[int, dict[str, Any]] = {}  # of incomplete states, by stamp [ns]
        self._targets_rejected = self._missed = 0
        self._new_target: Array | None = None  # not applied to a state yet
        self._applied = self.advertise("hand_target_applied")
        self._publish_description()
        self.create_subscription(JointState, "joint_states", self._on_joints, 10)
        self.create_subscription(PoseStamped, "base_pose", self._on_pose, 10)
        self.create_subscription(TwistStamped, "base_twist", self._on_twist, 10)
        self.create_subscription(PoseStamped, "hand_target", self._on_target, 10)
        self.offer("~/reset", self._reset)
        self.get_logger().info(f"{model.name}: {model.n} joints, {model.mass:.1f} kg, no target yet")

    # ------------------------------------------------------------------ a state in three messages

    def _on_joints(self, msg: JointState) -> None:
        if self._names_none(msg):
            return
        stamp = ros.nanoseconds(msg.header.stamp)
        self._plants.note(msg.name, stamp)
        self._part(stamp, joints=msg)

    def _on_pose(self, msg: PoseStamped) -> None:
        self._part(ros.nanoseconds(msg.header.stamp), pose=msg)

    def _on_twist(self, msg: TwistStamped) -> None:
        v, w = msg.twist.linear, msg.twist.angular
        self._part(ros.nanoseconds(msg.header.stamp), twist=np.array([v.x, v.y, v.z, w.x, w.y, w.z]))

    def _part(self, stamp: int, **part: Any) -> None:
        """Store one message of the state with a stamp, and answer the state once it is complete."""
        parts = self._parts.setdefault(stamp, {})
        parts |= part
        if len(parts) < 3:
            while len(self._parts) > _PARTS:
                del self._parts[next(iter(self._parts))]  # the oldest, not the earliest: stamps may be wrong
            return
        self._parts = {other: kept for other, kept in self._parts.items() if other > stamp}
        try:
            if stamp == self._stamp and not (self._problem or self._duplicates):
                self._answer_again(parts["joints"])
            elif self._is_new(stamp):
                state = self._state(stamp, **parts)
                self._note(stamp)
                if self._may_answer():
                    self._on_state(stamp, state)
        except StateError as error:
            self._reject(error)

    def _answer_again(self, joints: JointState) -> None:
        """Publish the last command again, for a plant that publishes the last state again.

        Raises
        ------
        StateError
            If it is another state with the same stamp.
        """
        if not np.array_equal(self._reader.state(joints).q, self._q_answered):
            raise StateError(
                f"it differs from the last one and has the same stamp, {1e-9 * self._stamp:.9g}: set header.stamp to "
                "the time of the measurement, a new one for each state"
            )
        self._sent = self._answered
        self._publish_command()

    def _state(self, stamp: int, joints: JointState, pose: PoseStamped, twist: Array) -> BodyState:
        """Return the state of three messages.

        Raises
        ------
        StateError
            If it is invalid.
        """
        read = self._reader.state(joints)
        if read.dq is None:
            raise StateError("joint_states need a finite velocity of each joint")
        x_base = ros.checked_pose(pose, "base_pose")
        if stamp < self._stamp:
            back = 1e-9 * (self._stamp - stamp)
            raise StateError(f"the plant restarted, {back:.3f} s before the last state answered: call ~/reset")
        begin = self._begin
        if begin is None:
            # a robot that moves is in the middle of a walk that another controller started
            moving = bool(max(np.abs(read.dq).max(), np.abs(twist).max()) > _AT_REST)
            if moving and stamp >= _DAY:
                raise StateError("the robot moves, and its stamps are not simulated time: start the walk at rest")
            begin = 0 if moving else stamp
        self._gate.accept_body(stamp, read, x_base.translation(), twist)
        self._begin = begin
        return BodyState(1e-9 * (stamp - begin), read.q, dq=read.dq, x_base=x_base.vec8(), v_base=twist)

    # ------------------------------------------------------------------ commands

    def _on_state(self, stamp: int, state: BodyState) -> None:
        """Answer a state; without a command the plant holds."""
        if not (self._problem or self._duplicates):
            command: BodyCommand | None = self._guarded(lambda: self._controller.step(state, self.config.dt))
            if command is not None:
                effort = np.clip(command.effort, -self._effort_max, self._effort_max)
                self._sent = self._answered = {"effort": effort}
                self._stamp, self._q_answered = stamp, state.q
                if self._new_target is not None:
                    self._applied.publish(ros.pose(stamp, ODOM, DQ.from_pose(self._new_target).vec8()))
                    self._new_target = None
                self._publish_command()
                self._ticks += 1
                self._last = self._controller.last.answer
                self._missed += self._last.residual > 1e-6
            elif self._problem:
                self._publish_zero()
                self._done()
        if self._is_time_to_diagnose():
            self._diagnose()

    @property
    def _is_walking(self) -> bool:
        return not self._problem

    def _done(self) -> None:
        self.get_logger().error(f"the walk failed; sending no more torques: {self._problem}")
        self._diagnose()
        if self.config.node.exit_when_done:
            self.stop(1)

    # ------------------------------------------------------------------ targets and services

    def _on_target(self, msg: PoseStamped) -> None:
        try:
            self._controller.reach(ros.checked_place(msg.pose.position, "it"))
            self._new_target = self._controller.target
        except StateError as error:
            self._targets_rejected += 1
            self.get_logger().error(f"hand_target rejected: {error}")

    def _reset(self) -> tuple[bool, str]:
        self._controller.reset()
        self._problem, self._begin, self._new_target, self._last = "", None, None, None
        self._stamp, self._sent = -1, self._still
        self._gate.reset()
        self._failures.reset()
        return True, "the next walk starts from the current posture, without a target"

    def _condition(self) -> tuple[str, str, dict[str, object]]:
        values: dict[str, object] = {
            "targets rejected": self._targets_rejected,
            "capturability missed": self._missed,
        }
        if (last := self._last) is not None:
            values |= {"capturability": last.residual, "solve time": last.solve_time, "solver": last.method}
        if self._failures.count:
            return "ERROR", "no command for the last state", values
        if last is not None and last.residual > 1e-6:
            return "WARN", "cannot stop within the preview", values
        return "OK", "in balance", values
