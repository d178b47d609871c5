"""Standing walk that catches by steps of the dynamic walk what the sole of a single support cannot bear.

While the divergent component of motion xi is within the sole on the ground, a zero-moment point within the sole brings
it back. Beyond the sole it diverges, unless the swing foot lands where it can be caught: towards that foot, ahead or
back. On the other side no foot can land.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.walk import Phase, PhaseKind, Rule
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.dynamic.walk import DynamicWalk, com_and_xi
from dqwalk_ros.walks.standing.footsteps import Footprint
from dqwalk_ros.walks.standing.walk import StandingWalk

__all__ = ["RecoveringWalk"]


_CONFIRMED = 3
"""Number of consecutive states with xi beyond the sole after which it is caught, to reject measurement noise."""
_LATEST = 0.05
"""Largest delay of the drive with which a step catches more than the sole bears [s]."""
_TAKEN = ("task", "standing", "dynamic", "joints")
"""Sections of the dynamic walk that apply while its steps catch a push."""


class _Interruptible:
    """Rule that ends a phase by another rule, or at once when it is interrupted."""

    def __init__(self, rule: Rule) -> None:
        self._rule, self.interrupted = rule, False

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return whether the phase ends; see `walk.Rule.is_over`."""
        return self.interrupted or self._rule.is_over(error, elapsed)


class _Steps(DynamicWalk):
    """The dynamic walk from a foot in the air on: steps until xi is between heels and toes, then a stance."""

    def begin(self, phase: Phase, kin: Kinematics) -> tuple[PhaseKind, Foot, Array | None]:
        """Return the rest of the single support `phase` at `kin`: the swing foot comes down beside the support foot."""
        self._known, self._time, self._flight = None, -math.inf, None
        self._pushed = self._together = self._descends = True
        ahead = Footprint.of(kin.pose(kin.swing)).place.real
        aside = self.footsteps.stride(phase.support, 0.0, 0.0, 0.0).place.imag
        return PhaseKind.SINGLE_SUPPORT, phase.support, Footprint(complex(ahead, aside)).pose

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return kind, support foot and swing target of the phase after `phase`; None after the stance."""
        assert phase is not None
        if phase.kind is PhaseKind.STANCE:
            return None
        if phase.kind is PhaseKind.DOUBLE_SUPPORT:
            return PhaseKind.SINGLE_SUPPORT, phase.support, self.footsteps.wanted(phase.support, 0.0, 0.0, 0.0)
        return PhaseKind.STANCE if self._caught else PhaseKind.DOUBLE_SUPPORT, phase.support.other, None

    @property
    def _caught(self) -> bool:
        """Whether, at a landing, xi is between heels and toes of the feet."""
        flight = self._flight
        assert flight is not None
        step, half = flight.step, 0.5 * self.model.soles[Foot.LEFT].length - self.config.dynamic.catch_margin
        xi, landed = float(self._smooth[0] - step.z[0]), float(step.landing[0] - step.z[0] + flight.shift[0])
        return min(landed, 0.0) - half < xi < max(landed, 0.0) + half


class RecoveringWalk(StandingWalk):
    """Standing walk that hands over to the dynamic walk of ``gait.recover`` when xi leaves the sole, and continues.

    The single support that is interrupted has a `decision`; the phases of the steps have their own configuration.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._in_time = Drive.of(config, model).delay <= _LATEST
        self._interrupted: Phase | None = None  # the phase to continue after, while steps catch a push
        self._beyond = 0  # number of consecutive states with xi beyond the sole
        self._kin: Kinematics | None = None  # at the last state of a single support

    @cached_property
    def _steps(self) -> _Steps:
        return _Steps(_steps_config(self.config), self.model)  # a recorded walk is rebuilt without them

    def prepare(self) -> None:
        """Prepare the steps.

        Raises
        ------
        ConfigError
            If ``gait.recover`` is not the configuration of a dynamic walk.
        """
        self._steps.prepare()

    def tune(self, config: Config) -> None:
        """Replace the parameters, for the steps those that they share with the standing walk."""
        super().tune(config)
        self._steps.tune(_with_steps(config, self._steps.config))

    @property
    def current(self) -> Config:
        """Configuration of the current phase."""
        return self._steps.config if self._interrupted else self.config

    # ------------------------------------------------------------------ order

    def is_waiting(self, phase: Phase) -> bool:
        """Return whether `phase` is a stance of a steered walk with zero velocity and without footprints."""
        return self._interrupted is None and super().is_waiting(phase)

    def following(self, phase: Phase | None) -> tuple[PhaseKind, Foot, Array | None] | None:
        """Return the phase after `phase`: after an interruption a step, after the steps that of the continued walk."""
        if self._interrupted is not None:
            if (following := self._steps.following(phase)) is not None:
                return following
            phase, self._interrupted = self._interrupted, None
        elif phase is not None and phase.decision and self._kin is not None:
            self._interrupted, self._beyond = phase, 0
            return self._steps.begin(phase, self._kin)
        return super().following(phase)

    def restarts(self, phase: Phase) -> float | None:
        """Return for how long to stand before a phase begins again after an interruption of the control [s]."""
        return self._steps.restarts(phase) if self._interrupted else super().restarts(phase)

    # ------------------------------------------------------------------ phases

    def both_feet(self, kind: PhaseKind, support: Foot, q_start: Array) -> Phase:
        """Return a phase with both feet on the ground, of the steps while they catch a push."""
        if self._interrupted:
            return self._steps.both_feet(kind, support, q_start)
        return super().both_feet(kind, support, q_start)

    def one_foot(self, support: Foot, q_start: Array, swing_target: Array) -> Phase:
        """Return a single support, of the steps while they catch a push."""
        if self._interrupted:
            return self._steps.one_foot(support, q_start, swing_target)
        return super().one_foot(support, q_start, swing_target)

    def _rule(self, kind: PhaseKind, support: Foot) -> Rule:
        rule = super()._rule(kind, support)
        return _Interruptible(rule) if kind is PhaseKind.SINGLE_SUPPORT else rule

    # ------------------------------------------------------------------ update for every state

    def observe(self, phase: Phase, kin: Kinematics, state: State) -> Phase:
        """Return the phase; a single support gets a decision at the state before it is interrupted."""
        if self._interrupted:
            return self._steps.observe(phase, kin, state)
        phase = super().observe(phase, kin, state)
        if state.up is None or not self._in_time or phase.kind is not PhaseKind.SINGLE_SUPPORT:
            return phase
        self._kin = kin
        if phase.decision:
            assert isinstance(phase.rule, _Interruptible)
            phase.rule.interrupted = True
            return phase
        beyond = self._beyond_sole(kin, state)
        self._beyond = self._beyond + 1 if beyond > 0.0 else 0
        if self._beyond >= _CONFIRMED:
            text = f"steps catch a push: the divergent component is {1e3 * beyond:.0f} mm beyond what the sole can bear"
            self._observed = phase = replace(phase, decision=text)
        return phase

    def _beyond_sole(self, kin: Kinematics, state: State) -> float:
        """Return how far xi is beyond what the base sole can bear, ahead, back or towards the swing foot [m]."""
        steps, sole = self._steps, self.model.soles[kin.base]
        _, xi = com_and_xi(kin.com, steps.com_velocity(kin, state), kin.up, steps.pendulum.omega)
        x, y = (xi - sole.center[:2]).tolist()
        inward = -y if kin.base is Foot.LEFT else y
        along = abs(x) - 0.5 * sole.length + steps.config.dynamic.catch_margin
        return float(max(along, inward - 0.5 * sole.width + self.config.standing.pressure_margin))

    def effort(self, phase: Phase, kin: Kinematics, state: State, u: Array) -> Array:
        """Return the feedforward torques of the walk or of the steps, shape (n,) [N m]."""
        return self._steps.effort(phase, kin, state, u) if self._interrupted else super().effort(phase, kin, state, u)


def _steps_config(config: Config) -> Config:
    """Return the configuration of the steps: that of ``gait.recover``, for the robot and the servos of `config`.

    Raises
    ------
    ConfigError
        If there is no such configuration, or it is not that of a dynamic walk.
    """
    dynamic = load(config.gait.recover)
    if dynamic.gait.style != "dynamic":
        raise ConfigError(
            f"gait.recover is '{config.gait.recover}'; its gait.style must be dynamic, not {dynamic.gait.style}"
        )
    return _with_steps(config, dynamic)


def _with_steps(config: Config, dynamic: Config) -> Config:
    """Return `config` with the sections of `dynamic` that apply while steps catch a push."""
    taken = {name: value for name, value in dynamic.flat().items() if name.split(".")[0] in _TAKEN}
    own = {"standing.posture": config.standing.posture, "servo.assumed_lead": dynamic.servo.assumed_lead}
    return config.updated({**taken, **own, "gait.style": "dynamic", "gait.recover": "", "gait.steps": 0})
