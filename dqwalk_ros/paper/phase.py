"""A phase of a walk, and the rules that end it: tasks, equalities and inequalities, section 4 [Urban2020].

The base frame of a phase is the sole of its base foot.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

from dqwalk_ros.config import Config
from dqwalk_ros.paper.assembly import Assembly, Evaluation
from dqwalk_ros.paper.constraints import Constraint, JointMaximum, JointMinimum
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PhaseError

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel


class PhaseKind(enum.Enum):
    """Kind of a phase: double support, single support, or stance, a double support with the CoM between the feet."""

    DOUBLE_SUPPORT = "double_support"
    SINGLE_SUPPORT = "single_support"
    STANCE = "stance"


class Rule(Protocol):
    """Condition that ends a phase; it is evaluated once for each state of the phase."""

    def is_over(self, error: Callable[[], float], elapsed: float) -> bool:
        """Return whether the phase ends at the present state.

        Parameters
        ----------
        error : callable
            Computes the norm of the error of the phase's first task.
        elapsed : float
            Time since the phase began [s].

        Raises
        ------
        PhaseError
            If the phase has stalled, or takes longer than ``gait.phase_timeout``.
        """


@dataclass(frozen=True)
class Next:
    """What follows a phase."""

    kind: PhaseKind
    support: Foot
    swing_target: Array | None = None
    """x_d, the pose at which the swing sole lands, in the frame of the support sole, shape (8,); required for a single
    support."""


@dataclass(kw_only=True, eq=False)
class Phase:
    """One phase of a walk; nothing of it but `swing_target` and `decision` changes, by `decide`."""

    model: RobotModel
    kind: PhaseKind
    support: Foot
    """The foot that carries the weight at the end of the phase; it is part of the phase's name."""
    base: Foot
    """The foot whose sole is the base frame: the support foot in single support, the other one in double support."""
    q_start: Array
    """Joint angles at the start of the phase, shape (n,) [rad]."""
    swing_target: Array | None
    """x_d, the pose at which the swing sole lands, in the base frame, shape (8,)."""
    eta: float
    damping: float
    """eta [1/s] and lambda of (U6)."""
    tasks: tuple[Task, ...]
    """The phase's rule is applied to the error of the first one."""
    equalities: tuple[Constraint, ...]
    """Constraints d' = -eta (d - bound)."""
    inequalities: tuple[Constraint, ...]
    """Constraints d' >= -eta (d - bound)."""
    limits: tuple[JointMaximum, JointMinimum]
    """Joint limits (U12) and (U13), which are bounds of u in the quadratic program."""
    rule: Rule
    """Condition that ends the phase."""
    decision: str = ""
    """Description of a change of the swing target during the phase, and its reason; empty without a change."""

    @property
    def double(self) -> bool:
        """Whether both soles stand."""
        return self.kind is not PhaseKind.SINGLE_SUPPORT

    @property
    def name(self) -> str:
        """Kind and support foot, such as ``double_support/left``."""
        return f"{self.kind.value}/{self.support.value}"

    def decide(self, decision: str, swing_target: Array | None) -> None:
        """Note what was changed during the phase and why, and the new swing target (8,) if there is one."""
        self.decision = decision
        if swing_target is not None:
            self.swing_target = swing_target

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All inequalities, including the joint limits."""
        return (*self.inequalities, *self.limits)

    @cached_property
    def assembly(self) -> Assembly:
        """Evaluates tasks and constraints; it has the names of the rows of the quadratic program."""
        kin = Kinematics(self.model, self.q_start, self.base)
        stacked = self.tasks, self.equalities, self.inequalities, self.limits
        return Assembly(kin, *stacked, eta=self.eta, damping=self.damping)

    def again(self, kin: Kinematics, swing_target: Array | None, rule: Rule) -> Phase:
        """Return the phase with the same tasks and constraints, whose targets the walk sets, that begins at `kin`."""
        phase = replace(self, q_start=kin.q, swing_target=swing_target, rule=rule, decision="")
        phase.assembly = self.assembly
        return phase

    def evaluate(
        self,
        q: Array,
        up: Array = Z,
        elapsed: float = math.inf,
        dt: float | None = None,
        velocity: Array | None = None,
    ) -> Evaluation:
        """Return errors, distances and the quadratic program (U6).

        Parameters
        ----------
        q : ndarray, shape (n,)
            Joint angles [rad].
        up : ndarray, shape (3,)
            Unit vector against gravity in the frame of `base`; by default z, a level sole.
        elapsed : float
            Time since the phase began [s], for tasks that follow a path and for moving obstacles; by default infinity,
            the end of the path.
        dt : float
            Control period [s]: rates are limited to 1/dt; by default they are not.
        velocity : ndarray, shape (n,)
            Largest joint velocities, to which the bounds of u are clipped [rad/s]; by default they are not.
        """
        return self.assembly(q, up, elapsed, dt, velocity)

    def distances(self, q: Array) -> dict[str, float]:
        """Return each signed distance minus its bound at `q` (n,) when it begins; see `Evaluation.distances`."""
        return self.evaluate(q, elapsed=0.0).distances()


def names_phase(text: str) -> bool:
    """Return whether a text of the topic `phase` is a `Phase.name`: no mode, and no decision, which is a sentence."""
    return "/" in text and " " not in text


_STALLED_WINDOWS = 10
"""A phase has stalled when the error decreases too slowly to reach its goal in time for this many windows in a row."""


class EndRule:
    """The switching rule of section 5.

    A double support ends when its error has stopped decreasing and the projection of the CoM is inside the cylinder of
    (U14) around the end foot. A single support ends when its error is below the threshold.

    Parameters
    ----------
    name : str
        Name of the phase, for messages.
    double : bool
        Whether it is a double support.
    """

    def __init__(self, config: Config, name: str, *, double: bool) -> None:
        self._name, self._double = name, double
        window = max(1, round(config.dsp.stall_window / config.dt))
        self._errors: deque[float] = deque(maxlen=window + 1)
        self._window = window * config.dt
        # the error of the double support is the distance of the CoM from the end foot's centre
        self._goal = config.ssp.com_radius if double else config.ssp.threshold
        self._slow_states = 0
        self._stall, self._timeout, self._dt = config.dsp.stall_rate, config.gait.phase_timeout, config.dt

    def is_over(self, error: Callable[[], float], elapsed: float) -> bool:
        """Return whether the phase ends at the state with this error, by the switching rule of section 5."""
        now, errors = error(), self._errors
        errors.append(now)
        full = len(errors) == errors.maxlen
        fall = errors[0] - now
        if self._double:
            if full and fall < self._stall and now < self._goal:
                return True
        elif now < self._goal:
            return True
        timeout = self._timeout
        if elapsed > timeout:
            raise self._failed(f"is not over after {timeout:g} s", now, stalled=False)
        if full:
            # at the mean rate of the last window the goal is not reached within the timeout
            too_slow = fall * timeout < (now - self._goal) * self._window
            self._slow_states = self._slow_states + 1 if too_slow else 0
            if self._slow_states * self._dt > _STALLED_WINDOWS * self._window:
                raise self._failed("has stalled", now, stalled=True)
        return False

    def _failed(self, what: str, error: float, *, stalled: bool) -> PhaseError:
        unit = " m" if self._double else ""
        hint = "" if stalled else "; gait.phase_timeout may be too short"
        return PhaseError(
            f"{self._name} {what} at an error of {error:.4g}{unit} (it ends below {self._goal:.4g}{unit}){hint}",
            phase=self._name,
            error=error,
            stalled=stalled,
        )


class Timed:
    """Rule that ends a phase after a duration, which may change during the phase, and not while `waits` returns True.

    Attributes
    ----------
    duration : float
        [s]
    begun : float
        Part of the duration that has passed when the phase begins, because its swing foot is in the air already [s].
    """

    def __init__(self, duration: float, waits: Callable[[], bool] = lambda: False) -> None:
        self.duration, self.begun, self._waits = duration, 0.0, waits

    def is_over(self, error: Callable[[], float], elapsed: float) -> bool:
        """Return whether the time is up; see `Rule.is_over`."""
        return not self._waits() and elapsed + self.begun >= self.duration - 1e-9
