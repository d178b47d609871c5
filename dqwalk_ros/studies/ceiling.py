"""What the robot itself allows: the speed that its servos can walk, and the push that a pendulum on its soles catches.

A result is worth what it is beside its ceiling. That of a push is the largest impulse after which steps catch the
divergent component xi of a linear inverted pendulum (Koolen et al. 2012): the pressure stays at the edge of the sole
towards xi, xi' = w (xi - z), and every foot lands as early and as far as the walk lets it. A robot can exceed it,
because it turns its body and stands on a tipped sole, and a pendulum is a point mass on a flat one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.studies.pushes import Push
from dqwalk_ros.studies.servo_choice import Gait, Most, choose, own_servos
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.dynamic.recovery import RecoveringWalk
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.stepping import SteppingWalk
from dqwalk_ros.walks.table import make_walk, walk_type

_SETTLED = 50
"""Number of steps after which the pendulum is at rest."""


def caught(half: float, first: float, then: float, growth: float, left: float) -> float:
    """Return how far xi may be from the middle of a sole, in one direction, to be caught by any number of steps [m].

    Parameters
    ----------
    half : float
        Distance of the edge of each sole from its middle [m].
    first, then : float
        How far in this direction the other foot can land from the present one, and this one from the other [m].
    growth, left : float
        exp(w T) for the duration T of a step, and for the time until the first landing.
    """
    here = other = half  # what a support catches just after the landing that begins it
    for _ in range(_SETTLED):  # a contraction by 1/growth
        here, other = half + max(first + other - half, 0.0) / growth, half + max(then + here - half, 0.0) / growth
    return half + max(first + other - half, 0.0) / left


class PushCeiling:
    """The largest impulses that a pendulum on the soles of a robot catches, with the steps of its walk.

    A standing walk steps as ``gait.recover`` says, from the middle of its sole; a stance takes no step.

    Raises
    ------
    ConfigError
        If the walk has no soles to press on: it is no `SteppingWalk`.
    """

    def __init__(self, config: Config, model: RobotModel) -> None:
        walk = make_walk(config, model)
        if not isinstance(walk, SteppingWalk):
            raise ConfigError(f"a push has a ceiling for a standing or a dynamic walk, not for {type(walk).__name__}")
        walk.prepare()
        kin, sole = Kinematics(model, walk.posture, Foot.LEFT), model.soles[Foot.LEFT]
        beside = DQ(walk.footsteps.beside(Foot.LEFT)).transform_point(model.soles[Foot.RIGHT].center) - sole.center
        self._mass, self._half = model.mass, 0.5 * np.array([sole.length, sole.width])
        self._apart, self._swing = float(abs(beside[1])), config.standing.swing_duration
        self._gait = Gait.of(config) if isinstance(walk, DynamicWalk) else None
        self._omega, self._steps = np.full(2, math.sqrt(GRAVITY / float(kin.com[2]))), config
        if steps := walk if isinstance(walk, DynamicWalk) else walk.steps if isinstance(walk, RecoveringWalk) else None:
            self._omega, self._steps = steps.pendulum.omega, steps.config
        self._catches = steps is not None and self._steps.dynamic.catch

    def of(self, push: Push) -> float:
        """Return the largest impulse [N s] at the moment and in the direction of a push, whatever its own is.

        The pendulum is pushed at once, in the steady walk of the configuration.
        """
        room = []
        for axis, part in enumerate((math.cos(push.direction), math.sin(push.direction))):
            if abs(part) > 1e-9:
                away = self._room(push, axis, math.copysign(1.0, part))
                room.append(self._mass * float(self._omega[axis]) * away / abs(part))
        return max(min(room), 0.0)

    def _room(self, push: Push, axis: int, sign: float) -> float:
        """Return how far xi may be displaced along an axis, to the side of `sign` [m]."""
        half, omega, d = float(self._half[axis]), float(self._omega[axis]), self._steps.dynamic
        if push.moment == "standing":
            return half + 0.5 * self._apart * axis
        inward = -1.0 if push.moment == "left" else 1.0
        landing = (self._gait.length if self._gait else 0.0, self._apart * inward)[axis]
        xi = 0.0  # of the steady walk, from the middle of the sole
        if self._gait:
            since = 0.5 * self._gait.double + push.part * self._gait.single
            whole = math.exp(omega * self._gait.duration)
            xi = landing / (whole + (-1.0, 1.0)[axis]) * math.exp(omega * since)
        if not self._catches:
            return half - sign * xi
        reach = (d.catch_length, d.catch_side)[axis]
        back = (1.0, -1.0)[axis]  # the other foot's landings: as far ahead, and to the other side
        left = math.exp(omega * max(d.shortest_step - push.part * self._swing, 0.0))
        first, then = sign * landing + reach, sign * landing * back + reach
        return caught(half, first, then, math.exp(omega * d.shortest_step), left) - sign * xi


def ceilings(configs: Mapping[str, Config], pushes: Mapping[str, Sequence[Push]]) -> dict[str, str]:
    """Return the ceiling of each of some rows, with its unit; that of `pushes` is the one of the weakest.

    The ceiling of a dynamic walk is the speed that its servos allow (`servo_choice`); that of a standing walk is not
    known, because it stands still between its steps.
    """
    out: dict[str, str] = {}
    known: dict[tuple[object, ...], Most] = {}
    for name, config in configs.items():
        model, kind = load_model(config.robot), walk_type(config)
        if name in pushes and issubclass(kind, SteppingWalk):
            ceiling = PushCeiling(config, model)
            out[name] = f"{min(ceiling.of(push) for push in pushes[name]):.2f} N s"
        elif name not in pushes and kind is DynamicWalk:
            of_servos = [getattr(own_servos(config, model), field.name).tobytes() for field in fields(Servos)]
            key = (*of_servos, replace(Gait.of(config), length=0.0), config.robot, str(config.standing.posture))
            if key not in known:
                known[key] = choose(config, model, {})[0].speed
            out[name] = f"{known[key].sign}{known[key].value:.2f} m/s"
    return out
