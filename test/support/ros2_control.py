"""Emulation of a robot with ros2_control: broadcasters and forward controllers of Jazzy, after their manuals.

The controller manager reads the hardware, lets the broadcasters publish and the forward_command_controller copy its
last command, and writes it, so the answer to a state reaches the joints one period later. joint_state_broadcaster
lists the joints alphabetically and publishes NaN for values that are not measured; every stamp is the current time;
the forward controller repeats its last command without a timeout.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from sensor_msgs.msg import Imu, JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.paper.state import Command

EPOCH = 1_700_000_000_000_000_000
"""Stamp at which the robot is switched on [ns]."""
EXTRA = ("a_gripper", "z_camera")
"""Joints of the robot that are not in the model of the walk."""


class Known:
    """Controllers of a robot that understand whatever `drive` sends: in place of its `RobotControllers`."""

    trouble = ""

    def look(self) -> None:
        """Find nothing."""


class ControllerManager:
    """One robot, its broadcasters, and one forward_command_controller.

    Parameters
    ----------
    plant : Plant
        The robot.
    interface : {"velocity", "position"}
    joints : sequence of str
        Joints of the forward controller, in its order.
    imu_frame : str
    rate : float
        update_rate of the manager [Hz].
    """

    def __init__(self, plant: Any, interface: str, joints: Any, imu_frame: str, rate: float) -> None:
        self.plant, self._interface, self._frame = plant, interface, imu_frame
        self._names, self._dt = plant.model.joint_names, 1.0 / rate
        self._order = [joints.index(name) for name in self._names]
        self._command: np.ndarray | None = None  # received
        self._written: np.ndarray | None = None  # to the hardware
        self._unladen = np.zeros(len(self._names))  # goals are what is commanded, without offsets by torques
        self.updates = 0

    @property
    def stamp(self) -> int:
        """The current time [ns]."""
        return EPOCH + round(self.updates * self._dt * 1e9)

    def on_commands(self, msg: Any) -> None:
        """Receive a command of the forward controller (Float64MultiArray)."""
        self._command = np.array(msg.data)

    def update(self) -> tuple[JointState, Imu]:
        """Return the messages of the broadcasters; then write the command and simulate one period."""
        measured = dict(zip(self._names, self.plant.state.q, strict=True)) | dict.fromkeys(EXTRA, 0.0)
        state = JointState(name=sorted(measured), position=[float(measured[name]) for name in sorted(measured)])
        state.velocity = state.effort = [float("nan")] * len(measured)
        state.header.stamp = ros.time_msg(self.stamp)
        imu = ros.imu(self.stamp, self._frame, self.plant.inertial)
        self._written = self._command
        self.miss()
        return state, imu

    def miss(self) -> None:
        """Simulate one period; by itself, one that the manager misses: it reads nothing, and the last command holds."""
        u, effort = np.zeros(len(self._names)), None
        if self._written is not None:
            command, effort = self._written[self._order], self._unladen
            u = command if self._interface == "velocity" else (command - self.plant.commanded) / self._dt
        self.plant.step(Command(1e-9 * self.stamp, u, effort), self._dt)
        self.updates += 1
