"""joint_states and imu: two messages that make one state."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from dqwalk_ros.controllers import State
from dqwalk_ros.errors import StateError
from dqwalk_ros.nodes import messages as ros

__all__ = ["InertialSensor"]


class InertialSensor:
    """The newest word of the inertial sensor.

    In lockstep a state waits for the message of its own stamp; in real time the newest one counts, as long as its
    stamp is within the timeout of the state's.

    Parameters
    ----------
    node : rclpy.node.Node
    lockstep : bool
    timeout : callable
        Returns the largest difference of the stamps in real time [s].
    again : callable
        Called with a state that had to wait.
    """

    def __init__(
        self, node: Node, *, lockstep: bool, timeout: Callable[[], float], again: Callable[[JointState], None]
    ) -> None:
        self._lockstep, self._timeout, self._again = lockstep, timeout, again
        self._newest: Imu | None = None
        self._waiting: JointState | None = None
        node.create_subscription(Imu, "imu", self._on_imu, ros.stream(1, reliable=lockstep))

    def _on_imu(self, msg: Imu) -> None:
        self._newest = msg
        waiting = self._waiting
        if waiting is not None and waiting.header.stamp == msg.header.stamp:
            self._waiting = None
            self._again(waiting)

    def joined(self, msg: JointState, state: State) -> State | None:
        """Return a state with what the sensor says; None in lockstep where that is still to come.

        Raises
        ------
        StateError
            If the sensor is silent or says what cannot be used.
        """
        newest = self._newest
        if self._lockstep:
            if newest is None or newest.header.stamp != msg.header.stamp:
                self._waiting = msg
                return None
        elif newest is None:
            raise StateError("imu: nothing came yet (plant.imu is true)")
        else:
            age = 1e-9 * abs(ros.nanoseconds(msg.header.stamp) - ros.nanoseconds(newest.header.stamp))
            if age > self._timeout():
                raise StateError(f"imu: its stamp is {age:.3f} s away from the state's")
        up, gyro = ros.up_and_gyro(newest)
        return dataclasses.replace(state, up=up, gyro=gyro)
