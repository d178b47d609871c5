"""Standing walk whose pushes beyond what one sole balances are caught by steps of the dynamic walk.

While the divergent component of motion xi is within the sole on the ground, a zero-moment point within the sole brings
it back. Beyond the sole it diverges, unless the swing foot lands where it can be caught: towards that foot, ahead or
back. On the other side no foot can land.
"""

from __future__ import annotations

import math

from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, Phase, PhaseKind
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.paper.walk import Change
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.com import com_and_xi
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.footprint import Footprint
from dqwalk_ros.walks.standing.walk import StandingWalk

_CONFIRMED = 3
"""Number of consecutive states with xi beyond the sole after which it is caught, to reject measurement noise."""
_LATEST = 0.05
"""Largest delay of the drive with which a step catches more than the sole supports [s]."""
_TAKEN = ("task", "standing", "dynamic", "joints")
"""Sections of the dynamic walk that apply while its steps catch a push."""


class Steps(DynamicWalk):
    """The dynamic walk from a foot in the air on: steps until xi is between heels and toes, then a stance."""

    def following(self, phase: Phase | None, kin: Kinematics) -> Next | None:
        """Return what follows `phase`, which at first is the interrupted one; None after the stance."""
        assert phase is not None
        if phase is not self._known:
            return self._set_foot_down(phase, kin)
        if phase.kind is PhaseKind.STANCE:
            return None
        if phase.kind is PhaseKind.DOUBLE_SUPPORT:
            target = self.footsteps.wanted(phase.support, 0.0, 0.0, 0.0)
            return Next(PhaseKind.SINGLE_SUPPORT, phase.support, target)
        return Next(PhaseKind.STANCE if self._caught else PhaseKind.DOUBLE_SUPPORT, phase.support.other)

    def tune(self, config: Config) -> None:
        """Replace the parameters from the next phase on."""
        self.config = self.footsteps.config = config
        self._phases.clear()

    @property
    def _is_idle(self) -> bool:
        """Whether a stance continues: never, because then the interrupted walk does."""
        return False

    def _set_foot_down(self, phase: Phase, kin: Kinematics) -> Next:
        """Return the rest of the single support `phase` at `kin`: the swing foot comes down beside the support foot."""
        self._known, self._time, self._flight = None, -math.inf, None
        self._pushed = self._together = self._descends = True
        ahead = Footprint.of(kin.pose(kin.swing)).place.real
        aside = self.footsteps.stride(phase.support, 0.0, 0.0, 0.0).place.imag
        return Next(PhaseKind.SINGLE_SUPPORT, phase.support, Footprint(complex(ahead, aside)).pose)

    @property
    def _caught(self) -> bool:
        """Whether, at a landing, xi is between heels and toes of the feet."""
        flight = self._flight
        assert flight is not None
        step, half = flight.step, 0.5 * self.model.soles[Foot.LEFT].length - self.config.dynamic.catch_margin
        xi = float(self._now.smooth[0] - step.z[0])
        landed = float(step.landing[0] - step.z[0] + flight.shift[0])
        return min(landed, 0.0) - half < xi < max(landed, 0.0) + half


class RecoveringWalk(StandingWalk):
    """Standing walk that lets the steps of ``gait.recover`` take over when xi leaves the sole, and then continues."""

    steps: Steps
    """The walk that takes over, which `prepare` makes; a recorded walk is rebuilt without it."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        super().__init__(config, model)
        self._in_time = Drive.of(config, model).delay <= _LATEST
        self._beyond = 0  # number of consecutive states with xi beyond the sole

    def prepare(self) -> None:
        """Prepare the steps.

        Raises
        ------
        ConfigError
            If ``gait.recover`` is not the configuration of a dynamic walk.
        """
        super().prepare()
        self.steps = Steps(_steps_config(self.config), self.model)
        self.steps.arms = self.arms
        self.steps.prepare()

    def use(self, drive: Drive) -> None:
        """Use a model of the servos also for the steps."""
        super().use(drive)
        self._in_time = drive.delay <= _LATEST
        self.steps.use(drive)

    def tune(self, config: Config) -> None:
        """Replace the parameters from the next phase on, for the steps those that they share with this walk."""
        super().tune(config)
        self.steps.tune(_with_steps(config, self.steps.config))

    def observe(self, phase: Phase, kin: Kinematics, state: Estimate) -> Change | None:
        """Let the steps take over from a single support in which xi is beyond the sole."""
        change = super().observe(phase, kin, state)
        if change or state.up is None or not self._in_time or phase.kind is not PhaseKind.SINGLE_SUPPORT:
            return change
        beyond = self._beyond_sole(kin, state)
        self._beyond = self._beyond + 1 if beyond > 0.0 else 0
        if self._beyond < _CONFIRMED:
            return None
        self._beyond = 0
        text = f"steps catch a push: the divergent component is {1e3 * beyond:.0f} mm beyond what the sole supports"
        return Change(text, walk=self.steps)

    def _beyond_sole(self, kin: Kinematics, state: Estimate) -> float:
        """Return how far xi is beyond what the base sole supports, ahead, back or towards the swing foot [m]."""
        steps, sole = self.steps, self.model.soles[kin.base]
        _, xi = com_and_xi(kin, state, steps.pendulum.omega)
        x, y = (xi - sole.center[:2]).tolist()
        inward = -y if kin.base is Foot.LEFT else y
        along = abs(x) - 0.5 * sole.length + steps.config.dynamic.catch_margin
        return float(max(along, inward - 0.5 * sole.width + self.config.standing.pressure_margin))


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
    return config.updated(
        {**taken, **own, "gait.style": "dynamic", "gait.recover": "", "gait.steps": 0, "gait.footsteps": ()}
    )
