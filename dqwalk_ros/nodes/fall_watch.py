"""Decides when a walk ends because the robot lies, tips over, or does not move as it is commanded."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.estimation.delay import CommandHistory
from dqwalk_ros.estimation.vertical import turning
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import angle_of
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import State
from dqwalk_ros.plants.servo_goals import ServoGoals
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


class _Expected:
    """The motion that is expected of the joints: what their servos are asked for, and what is commanded.

    Parameters
    ----------
    first : State
        The first state that is answered.
    """

    def __init__(self, config: Config, model: RobotModel, first: State) -> None:
        self._goals = ServoGoals.of(config, model)
        self._goals.gate.use(first.q, first.time)
        self._goals.begin()
        self._late = CommandHistory(Drive.of(config, model).delay, 2 * model.n)

    def motion(self, before: State, commanded: Array, moves: float, until: float) -> Array:
        """Return both motions from a state until a time [s], shape (2, n) [rad].

        The command in answer to the state, `commanded` (n,) [rad/s], moves the joints for `moves` [s].
        """
        goals = self._goals
        goals.gate.use(before.q, before.time)
        wanted = goals.wanted
        goals.command(commanded, None, before.time, moves)
        velocity = np.append((goals.wanted - wanted) / moves, commanded)
        return self._late.motion_of(before.time, velocity, moves, until).reshape(2, -1)


class Contradictions:
    """Detects joints that do not follow their commands, and inertial measurements that contradict each other.

    The difference between measured and expected motion is integrated with a decay. The expected motion is that of the
    servos' goals, which stay within ``servo.window`` of the joints, so a leg that complies is no contradiction. The
    deflection of servos and the bias of a gyroscope stay small in this sum; an angle that has slipped or drifts does
    not. The goal of a joint that is blocked or frozen also stays near the joint, so the difference from the commanded
    motion is integrated as well, with a shorter memory, because it contains all motion that the window withholds. Both
    are expected later by the delay of the drive (``servo.assumed_*``), so that a quick motion is no contradiction.

    Between two states that are further apart than two periods, states were lost, or the plant was late. In the first
    case it moved all the time; in the second for two periods only, because no plant makes up for lost time. Only motion
    outside these two limits counts.

    Parameters
    ----------
    timeout : callable
        Returns the timeout of the states [s].

    Attributes
    ----------
    largest : float
        Largest of all sums since the beginning, of joints and vertical [rad].
    joint : int
        Index of the joint that the last `judge` described; -1 for none.
    """

    memory = 10.0, 4.0, 1.0
    """Time constants of the decay: of what was asked for, of what was commanded, and of the vertical [s]."""
    repeats = 0.3
    """Time for which a slow sensor may repeat its measurement [s]."""

    def __init__(self, config: Config, model: RobotModel, timeout: Callable[[], float]) -> None:
        self._model, self._limit, self._period, self._timeout = model, config.safety.contradiction, config.dt, timeout
        self._config = config
        self.largest, self.joint = 0.0, -1
        self.forget()
        zero = np.zeros(model.n)
        for time in (0.0, config.dt):  # compiled here, so that no state is answered late
            self.judge(State(time, zero), zero)
        self.forget()
        self.largest = 0.0

    def forgive(self, joints: NDArray[np.intp]) -> None:
        """Clear the sums of some joints."""
        self._off[:, joints] = 0.0

    def forget(self) -> None:
        """Clear the sums; the next state is compared with nothing."""
        self._before: State | None = None
        self._expected: list[_Expected] = []  # of a late plant that holds, and of one that moves
        self._off, self._turned = np.zeros((2, self._model.n)), np.zeros(3)
        self._same = 0.0  # time for which the inertial sensor has measured exactly the same [s]

    def judge(self, state: State, commanded: Array, *, leaning: bool = False) -> str:
        """Return a description of the contradiction, empty if there is none.

        Parameters
        ----------
        commanded : ndarray, shape (n,)
            Velocities commanded since the previous state [rad/s].
        leaning : bool
            Whether the base sole seems to be tilted, which a wrong angle causes; the limit is then halved.
        """
        self.joint = -1
        before, self._before = self._before, state
        passed = state.time - before.time if before is not None else 0.0
        if before is None or not 0.0 < passed <= self._timeout():  # after a gap it may have moved
            self.forget()
            self._before = state
            return ""
        if not self._expected:
            self._expected = [_Expected(self._config, self._model, before) for _ in range(2)]
        holding, moving = self._expected
        least = holding.motion(before, commanded, min(passed, 2.0 * self._period), state.time)
        most = moving.motion(before, commanded, passed, state.time)
        asked_for, commanded_to, _ = (math.exp(-passed / memory) for memory in self.memory)
        k, off = _integrate(self._off, state.q, before.q, least, most, np.array([asked_for, commanded_to]))
        self.largest = max(self.largest, off)
        if off > (0.5 * self._limit if leaning else self._limit):
            self.joint = k
            return (
                f"{self._model.joint_names[k]} does not follow its commands, it is {off:.2f} rad off: it is "
                "blocked or without power, its angle is frozen or has slipped, or the node that moves it was killed"
            )
        if before.up is None or before.gyro is None or state.up is None or state.gyro is None:
            return ""
        self._same = self._same + passed if _felt(before) == _felt(state) else 0.0
        turned = passed * turning(before.up, before.gyro)
        self._turned = math.exp(-passed / self.memory[2]) * (self._turned + state.up - before.up - turned)
        self.largest = max(self.largest, math.sqrt(float(self._turned @ self._turned)))
        return self.of_sensor(self._limit)

    @property
    def frozen(self) -> str:
        """That the inertial sensor measures nothing new, although the robot walks; empty if it does."""
        if self._same <= self.repeats:
            return ""
        return (
            f"the inertial sensor has measured exactly the same for {self._same:.2g} s: its driver repeats an old "
            "measurement, restart it"
        )

    def of_sensor(self, limit: float) -> str:
        """Return that the inertial sensor contradicts itself by more than a limit [rad]; empty if it does not."""
        off = math.sqrt(float(self._turned @ self._turned))
        if off <= limit:
            return ""
        return (
            f"the inertial sensor contradicts itself: the rotation of its vertical differs by {off:.2f} rad from that "
            "of its gyroscope; lean the robot by hand while dqwalk doctor listens, to check its mounting and signs"
        )


def _felt(state: State) -> list[float]:
    """Return what the inertial sensor has measured at a state."""
    assert state.up is not None
    assert state.gyro is not None
    return [*state.up.tolist(), *state.gyro.tolist()]


@jit
def _integrate(off: Array, q: Array, before: Array, least: Array, most: Array, kept: Array) -> tuple[int, float]:
    """Add to the sums `off` (2, n), of which the parts `kept` (2,) remain, what joints moved beyond two limits (2, n).

    Return the joint with the largest sum, and that [rad].
    """
    joint, largest = 0, 0.0
    for i in range(off.shape[0]):
        for k in range(q.shape[0]):
            moved, low, high = q[k] - before[k], min(least[i, k], most[i, k]), max(least[i, k], most[i, k])
            off[i, k] = kept[i] * (off[i, k] + (moved - min(max(moved, low), high)))
            if abs(off[i, k]) > largest:
                joint, largest = k, abs(off[i, k])
    return joint, largest


class FallWatch:
    """Decides when a walk ends because the robot lies, tips over, or does not move as it is commanded.

    Parameters
    ----------
    timeout : callable
        Returns the timeout of states and commands [s].

    Attributes
    ----------
    lying : str
        How far the pelvis leans, where that is a fall; else empty.
    suspected : str
        What contradicts the commands; until it is confirmed the robot must stand still. Empty if nothing does.
    contradictions : Contradictions
    may_hold : callable
        Returns whether the robot may stand still now.
    gives_up : callable
        Gets the index of a joint that does not follow, -1 for none, and returns the indices of those that are commanded
        to hold still instead of moving; empty if the walk must end.
    """

    ready_delay = 0.3
    """Longest time until a plant reports on plant_ready that it holds [s]."""
    upside_down = math.radians(150.0)
    """Inclination above which an inertial sensor rather measures in another frame [rad]."""
    other_frame = (
        "is the imu's frame NED (z down), or is its quaternion in the order w, x, y, z? It must be ENU, as REP 103 "
        "says (z up)"
    )

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        timeout: Callable[[], float],
        *,
        lockstep: bool,
        may_hold: Callable[[], bool] = lambda: False,
    ) -> None:
        self._limits, self._timeout, self._lockstep, self.may_hold = config.safety, timeout, lockstep, may_hold
        self.contradictions = Contradictions(config, model, timeout)
        zero = Kinematics(model, np.zeros(model.n), Foot.LEFT)  # in which the sensor's `_upright` points up
        self._upright = np.array([zero.direction(model.imu, axis)[2] for axis in np.eye(3)])
        self.lying = ""
        self.gives_up: Callable[[int], NDArray[np.intp]] = lambda joint: np.zeros(0, np.intp)
        self.forget()

    def forget(self) -> None:
        """Compare the next state with nothing: no motion has been commanded."""
        self.contradictions.forget()
        self.suspected, self._since = "", 0.0

    def look(self, up: Array | None) -> str:
        """Return how far the pelvis leans for a vertical (3,), where that is a fall: motion would only do damage.

        This does not depend on the joints: their angles may be refused when the robot hits the ground.
        """
        self.lying = ""
        if up is not None:
            lean = angle_of(float(self._upright @ up))
            if lean > self._limits.tilt:
                self.lying = f"the robot has fallen: its pelvis leans by {math.degrees(lean):.0f} deg"
            if lean > self.upside_down:
                self.lying += f": {self.other_frame}"
            elif self.lying:
                self.lying += self._cause
        return self.lying

    def tips(self, foot: Foot, lean: float) -> str:
        """Return how far a standing sole leans [rad], where that is a fall."""
        if lean <= self._limits.sole_tilt:
            return ""
        return f"the robot falls: its {foot.value} sole leans by {math.degrees(lean):.0f} deg{self._cause}"

    @property
    def _cause(self) -> str:
        """What contradicted the commands or itself before a fall, too late to be confirmed; empty if nothing did."""
        cause = self.suspected or self.contradictions.of_sensor(0.5 * self._limits.contradiction)
        return "".join(f"; {text}" for text in (cause, self.contradictions.frozen) if text)

    def compare(self, state: State, commanded: Array, lean: float) -> str:
        """Return a confirmed contradiction between a state and what was commanded before it; empty if there is none.

        Parameters
        ----------
        commanded : ndarray, shape (n,)
            [rad/s]
        lean : float
            Of the base sole [rad].
        """
        if not self.suspected:
            leaning = lean > 0.5 * self._limits.sole_tilt
            self.suspected = self.contradictions.judge(state, commanded, leaning=leaning)
            self._since = state.time
        if not self.suspected:
            return ""
        # a plant that does not receive the commands holds, and reports this a little later
        waits = 0.0 if self._lockstep else self._timeout() + self.ready_delay
        confirmed = state.time - self._since >= waits
        if (confirmed or not self.may_hold()) and (given_up := self.gives_up(self.contradictions.joint)).size:
            self.suspected = ""
            self.contradictions.forgive(given_up)
        return "; ".join(filter(None, [self.suspected, self.contradictions.frozen])) if confirmed else ""
