"""Prediction of the angles at which a command acts, by a model of the drive that the motion of the joints corrects."""

from __future__ import annotations

from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.estimation.drive import DriveWatch
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array


class Predictor:
    """Predicts the joint angles from the commands under way.

    Parameters
    ----------
    assumed : Drive
        Model of the drive that the parameters describe.

    Attributes
    ----------
    watch : DriveWatch
        What the joints have shown of the drive.
    """

    def __init__(self, assumed: Drive) -> None:
        self.watch = DriveWatch(assumed)
        self._history = CommandHistory(assumed.delay, assumed.stiffness.size)

    @property
    def drive(self) -> Drive:
        """The model with the delay that was learned."""
        return self.watch.drive

    def interrupt(self) -> None:
        """Forget the commands, because the robot has held still."""
        self._history = CommandHistory(self.drive.delay, self.drive.stiffness.size)
        self.watch.interrupt()

    def acting(self, time: float, q: Array) -> Array:
        """Return the angles (n,) [rad] at which a command for the angles `q` (n,) at `time` [s] acts."""
        return q + self._history.pending(time)

    def add(self, time: float, q: Array, u: Array, effort: Array | None, dt: float) -> None:
        """Add a state and the command that answers it.

        Parameters
        ----------
        time : float
            Time of the state [s].
        q : ndarray, shape (n,)
            Its angles [rad].
        u : ndarray, shape (n,)
            Commanded velocities [rad/s].
        effort : ndarray, shape (n,), or None
            Torques that are fed forward [N m]; None: nothing is learned from this state.
        dt : float
            Period for which the command holds [s].
        """
        motion = self._history.motion
        self._history.add(time, u, dt)
        if effort is not None:
            self.watch.add(time, q, motion, effort, dt)
            self._history.delay = self.drive.delay
