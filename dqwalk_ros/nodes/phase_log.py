"""The phases of a walk as monitor and viewer rebuild them from topics."""

from __future__ import annotations

import contextlib
from collections import deque
from typing import Any, Literal

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

from dqwalk_ros.config import Config, applies_from, from_yaml
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.nodes.watchdog import ClockSteps
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.walk import kind_with_target
from dqwalk_ros.report.verdict import Assessor
from dqwalk_ros.robot.model import RobotModel, parse_model
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import DqwalkError, StateError
from dqwalk_ros.support.topics import TOPICS
from dqwalk_ros.support.wording import shown
from dqwalk_ros.walks.table import make_walk, refuse_foreign_code

_KEPT = 100
"""Number of phases that are stored."""
_MEASURED = 5000
"""Number of messages of the inertial sensor that are stored; in lockstep a thousand arrive in a second."""
_FAR = 5_000_000_000
"""Time ahead of the last state from which on a stamp may be wrong [ns]."""
_OLD = 0.5
"""Age from which on a measured vertical is not used [s]."""


class PhaseLog:
    """Subscribes to the phases of a walk, and finds the phase that a state belongs to, for messages in any order.

    A phase is rebuilt from its start: the base sole is the frame of `phase_start`; with a `com_target` of the same
    stamp it is a double support, with a `swing_target` a single support.

    Attributes
    ----------
    config : Config or None
    model : RobotModel or None
    reader : JointReader or None
    label : str
        Last message of `phase`.
    newest : int
        Stamp of the newest state [ns]; -1 before the first.
    """

    def __init__(self, node: WalkNode) -> None:
        self._logger, self._own_walk = node.get_logger(), node.config.gait.walk
        self.config: Config | None = None
        self.model: RobotModel | None = None
        self.reader: ros.JointReader | None = None
        self.label = self._urdf = ""
        self._starts: dict[int, JointState] = {}  # by stamp [ns]
        self._targets: dict[int, tuple[PhaseKind, Any]] = {}
        self._tuned: dict[int, Config] = {}
        self._assessors: dict[int, Assessor] = {}
        self._imu: deque[tuple[int, bytes]] = deque(maxlen=_MEASURED)  # by stamp [ns]; those no state has needed yet
        self._vertical: tuple[int, Array | None] = (0, None)  # stamp [ns], unit vector in the sensor's frame
        self.newest, self._steps = -1, ClockSteps()
        node.listen(Imu, "imu", self._on_imu, _MEASURED, raw=True)
        for name, callback in {
            "walk_config": self._on_config,
            "robot_description": self._on_description,
            "phase": self._on_phase,
            "phase_start": self._on_start,
            "com_target": self._on_target,
            "swing_target": self._on_target,
        }.items():
            topic = TOPICS[name]
            node.create_subscription(ros.message_type(topic.type), name, callback, ros.latched(topic.depth))

    @property
    def lockstep(self) -> bool:
        """Whether the walk is in lockstep."""
        return self.config is not None and self.config.plant.lockstep

    def is_foreign(self, msg: JointState) -> bool:
        """Return whether a message has no joint of the robot, as far as that is known."""
        return self.reader is not None and self.reader.is_foreign(msg)

    def _on_config(self, msg: String) -> None:
        try:
            config = from_yaml(msg.data, source="walk_config")
            refuse_foreign_code(config, self._own_walk)
        except DqwalkError as error:
            self._logger.error(str(error))
            return
        if (stamp := applies_from(msg.data)) is not None:  # changed during the walk
            _store(self._tuned, stamp, config)
            for began in [began for began in self._assessors if began >= stamp]:
                del self._assessors[began]
            if self.config is not None:
                return
        self.config = config
        self._load()

    def _on_description(self, msg: String) -> None:
        self._urdf = msg.data
        self._load()

    def _load(self) -> None:
        if self.config is None or not self._urdf:
            return
        try:
            self.model = parse_model(self._urdf, self.config.robot)
        except DqwalkError as error:
            self._logger.error(str(error))
            return
        self.reader = ros.JointReader(self.model.joint_names)
        self._assessors.clear()
        self._logger.info(f"received the walk of {self.model.name}, {self.model.n} joints")

    def _on_phase(self, msg: String) -> None:
        self.label = msg.data

    def _on_imu(self, raw: bytes) -> None:
        with contextlib.suppress(StateError):
            stamp = ros.stamp_of(raw)
            while self._imu and self._imu[-1][0] > stamp:  # had a wrong stamp, or a clock was set back
                self._imu.pop()
            self._imu.append((stamp, raw))

    def _on_start(self, msg: JointState) -> None:
        _store(self._starts, ros.nanoseconds(msg.header.stamp), msg)

    def _on_target(self, msg: PointStamped | PoseStamped) -> None:
        if isinstance(msg, PoseStamped):
            try:
                target = PhaseKind.SINGLE_SUPPORT, ros.checked_pose(msg, "swing_target").vec8()
            except StateError as error:
                self._logger.error(f"cannot rebuild the phase: {error}")
                return
        else:
            target = PhaseKind.DOUBLE_SUPPORT, np.array([msg.point.x, msg.point.y])
        stamp = ros.nanoseconds(msg.header.stamp)
        self._assessors.pop(stamp, None)  # the target of the swing foot has changed
        _store(self._targets, stamp, target)

    def up(self, stamp: int) -> Array | None:
        """Return the newest measured vertical (3,) at the stamp of a state [ns]; None if there is none."""
        newest = None
        while self._imu and self._imu[0][0] <= stamp:
            newest = self._imu.popleft()
        if newest is not None:
            with contextlib.suppress(StateError):
                self._vertical = newest[0], ros.inertial_of(ros.deserialized(newest[1], Imu))[0]
        measured, up = self._vertical
        return up if 0 <= stamp - measured <= _OLD * 1e9 else None

    def begun(self, after: int, until: int) -> list[int]:
        """Return the start stamps of the phases in the interval (after, until] [ns], in order."""
        return sorted(key for key in self._starts if after < key <= until)

    def register(self, stamp: int) -> Literal["follows", "wrong", "set back"]:
        """Return what the stamp of a state [ns] is: a single wrong one, or of a plant or clock that was set back.

        In the latter case the phases after it are dropped.
        """
        apart = stamp - self.newest if self.newest >= 0 else 0
        if not self._steps.accepts(stamp, follows=0 <= apart <= _FAR):
            return "wrong"
        self.newest = stamp
        if apart >= 0:
            return "follows"
        self._forget_after(stamp)
        return "set back"

    def _forget_after(self, stamp: int) -> None:
        """Drop the phases that began after a stamp [ns] and the measurements."""
        self._imu.clear()
        for table in (self._starts, self._targets, self._assessors, self._tuned):
            for key in [key for key in table if key > stamp]:
                del table[key]

    def at(self, stamp: int) -> tuple[int, Assessor] | None:
        """Return the start [ns] and the assessor of the phase at a state's stamp [ns]; None if it is not known."""
        began = max((key for key in self._starts if key <= stamp), default=None)
        if began is None:
            return None
        if began not in self._assessors:
            made = self._make(began)
            if made is None:
                return None
            _store(self._assessors, began, made)
        return began, self._assessors[began]

    def _make(self, began: int) -> Assessor | None:
        if self.config is None or self.model is None or self.reader is None or began not in self._targets:
            return None
        start, (kind, target) = self._starts[began], self._targets[began]
        base = self.model.foot_of.get(start.header.frame_id)
        if base is None:
            given = shown(start.header.frame_id)
            self._logger.error(f"phase_start is in the frame '{given}', not a sole of the robot")
            del self._starts[began]
            return None
        support = base if kind is PhaseKind.SINGLE_SUPPORT else base.other
        try:
            q = self.reader.state(start).q
            if kind is PhaseKind.DOUBLE_SUPPORT:  # a stance has a com_target as well, but at another point
                kind, target = kind_with_target(Kinematics(self.model, q, base), target), None
            config = self._tuned.get(max((key for key in self._tuned if key <= began), default=-1), self.config)
            phase = make_walk(config, self.model).phase(kind, support, q, target)
            return Assessor(config, self.model, phase)
        except DqwalkError as error:
            self._logger.error(f"cannot rebuild the phase: {error}")
            del self._starts[began]
            return None


def _store(table: dict[int, Any], key: int, value: Any) -> None:
    table[key] = value
    while len(table) > _KEPT:
        del table[min(table)]
