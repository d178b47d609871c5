"""Input of the inertial sensor, checked on arrival by `InertialGate`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from sensor_msgs.msg import Imu, JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import wheels
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.inertial_gate import Felt, InertialGate
from dqwalk_ros.nodes.publishers import FirstPublisher
from dqwalk_ros.paper.state import State
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.wording import shown


class InertialSensor:
    """Adds the inertial sensor's message to the state of the joints.

    In lockstep a state waits for the imu message with the same stamp. In real time the newest message is used, if its
    stamp is within ``plant.command_timeout`` of the state's; the first one may arrive that long after the first state.
    Messages of a second sensor are ignored.

    Parameters
    ----------
    frame : str
        Link of the sensor: messages in another frame are rejected.
    gate : InertialGate
        Decides which measurements are used.
    on_state : callable
        Called again with a state that had to wait for its imu message.
    """

    def __init__(
        self,
        node: WalkNode,
        frame: str,
        gate: InertialGate,
        on_state: Callable[[JointState], None],
    ) -> None:
        self._node, self._frame, self._gate, self._on_state = node, frame, gate, on_state
        self._newest: Imu | None = None
        self._waiting: JointState | None = None
        self._first, self._received = math.inf, -math.inf  # times of receipt: of the first state, of the newest [s]
        self._source = FirstPublisher(lambda: node.config.plant.command_timeout, node.steady)
        node.listen(Imu, "imu", wheels.numbered(self._on_imu), 1 if node.lockstep else ros.best_effort(1))

    def _on_imu(self, msg: Imu, number: int) -> None:
        own, newest = self._is_own(msg), self._newest
        foreign = not own and newest is not None and self._is_own(newest)
        if foreign or (own and not self._node.lockstep and self._source.is_another(number)):
            names = ", ".join(ros.publishers_of(self._node, "imu"))
            text = f"imu: messages of a second sensor are ignored, stop or remap it: {names} publish them"
            self._node.get_logger().error(text, **throttled())
            return
        self._newest, self._received = msg, self._node.steady()
        waiting = self._waiting
        if waiting is not None and waiting.header.stamp == msg.header.stamp:
            self._waiting = None
            self._on_state(waiting)

    def join(self, msg: JointState, state: State) -> State | None:
        """Return a state with the newest measurement; None if that has not arrived yet.

        Raises
        ------
        StateError
            If no measurement was received, it is too old, or it is invalid.
        """
        newest = self._newest
        if self._node.lockstep:
            if newest is None or newest.header.stamp != msg.header.stamp:
                self._waiting = msg
                return None
        elif newest is None:
            now = self._node.steady()
            self._first = min(self._first, now)
            if now - self._first <= self._node.config.plant.command_timeout:
                return None  # the node has just started
            raise StateError("imu: no message yet (plant.imu is true)")
        else:
            before = 1e-9 * (ros.nanoseconds(msg.header.stamp) - ros.nanoseconds(newest.header.stamp))
            silent, longest = self._node.steady() - self._received, self._node.config.plant.command_timeout
            if why := ros.untimely(before, silent, longest):
                raise StateError(f"imu: {why}")
        if not self._is_own(newest):
            given = shown(newest.header.frame_id)
            raise StateError(f"imu: it is in the frame '{given}', and robot.imu is '{self._frame}': they must agree")
        rejected = self._gate.rejected
        felt = self._gate.use(ros.nanoseconds(newest.header.stamp), self._read(newest))
        if self._gate.rejected > rejected:
            text = f"imu rejected ({self._gate.rejected} so far): {self._gate.rejection}"
            self._node.get_logger().error(text, **throttled())
        if resumed := self._gate.resumed:
            self._node.get_logger().warning(resumed, **throttled())
        return dataclasses.replace(state, up=felt.up, gyro=felt.gyro, acceleration=felt.acceleration)

    def _is_own(self, msg: Imu) -> bool:
        """Return whether a message is in the frame of the robot's sensor."""
        return ros.is_frame_of(self._frame, msg.header.frame_id)

    @staticmethod
    def _read(msg: Imu) -> Felt | StateError:
        """Return what a message says, or why it is invalid."""
        try:
            return Felt(*ros.inertial_of(msg))
        except StateError as error:
            return error
