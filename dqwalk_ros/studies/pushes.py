"""Finds the largest impulse on a link that the robot survives, for each direction, by bisection.

The impulse is that of a force, or the momentum of a bottle on a rope: the test of push recovery of the RoboCup Humanoid
League (rules of 2025, part A).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind, Timed
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.base import pushed_periods
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.studies.loads import Bottle, ConstantForce, Load, drop, farthest_momentum
from dqwalk_ros.studies.plan import digest
from dqwalk_ros.studies.runner import Store, run
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import DqwalkError, PlantError
from dqwalk_ros.walks.table import make_controller, make_walk, style_of

MOMENTS = ("standing", "left", "right")
"""In a stance on both feet, or in the middle of a step on the left or on the right foot."""

_STANDS = 3.0
"""Time for which the robot must stand after a push in a stance [s]."""
_LATE = 5.0
"""Longest delay of the stance; without a stance by then the walk is stopped [s]."""
_LEAST_PART = 0.02
"""Fraction of the mass that a body has which is pushed anywhere."""
_FIRST, _MOST, _TOLERANCE = 0.045, 1.5, 0.0036
"""First and largest impulse that are tried, and accuracy of the limit, in units of `impulse_scale`."""


@dataclass(frozen=True)
class Push:
    """A push on the pelvis or another link: a constant force for some time, or a bottle on a rope."""

    moment: str
    """One of `MOMENTS`."""
    direction: float
    """Direction of the force, 0 ahead, pi/2 to the left [rad]."""
    impulse: float
    """Of the force, or momentum of the bottle [N s]."""
    duration: float = 0.1
    """Of the force: rounded to whole control periods, without an effect on the impulse [s]."""
    part: float = 0.5
    """Fraction of the step after which the push begins."""
    bottle: float = 0.0
    """Mass of the bottle [kg], which hits the pelvis; 0: a constant force."""
    link: str = ""
    """The link that the force pushes, at its centre of mass; empty: the pelvis."""

    @classmethod
    def anywhere(cls, impulse: float, model: RobotModel, seed: int) -> Self:
        """Return a push in mid-step of random link, horizontal direction, foot and moment.

        The link is one of the bodies with at least `_LEAST_PART` of the mass.
        """
        random = np.random.default_rng(seed)
        parts = zip(model.links, model.bodies, strict=True)
        links = [link for link, body in parts if body.mass >= _LEAST_PART * model.mass]
        foot, link = str(random.choice(MOMENTS[1:])), str(random.choice(links))
        return cls(foot, random.uniform(0.0, 2.0 * math.pi), impulse, part=random.uniform(0.0, 0.95), link=link)

    @property
    def towards(self) -> Array:
        """Its direction in the world, a unit vector (3,)."""
        return np.array([math.cos(self.direction), math.sin(self.direction), 0.0])

    def load(self, robot_mass: float, dt: float) -> Load:
        """Return what pushes a robot of a mass [kg], with a control period `dt` [s]."""
        if self.bottle:
            return Bottle(self.bottle, self.impulse, robot_mass)
        return ConstantForce(self.impulse, pushed_periods(self.duration, dt))


class Limit(msgspec.Struct, frozen=True):
    """The limit in one direction."""

    moment: str
    direction: float
    """[rad]"""
    survived: float
    """Largest impulse survived, or momentum of the bottle [N s]."""
    failed: float | None
    """Smallest impulse that was not survived [N s]; None if the largest one tried was survived."""
    reason: str
    """Why the walk ended at `failed`."""


def impulse_scale(config: Config) -> float:
    """Return M sqrt(g h) [N s], the scale of impulses for a comparison of robots; h is the height of the CoM."""
    model = load_model(config.robot)
    return model.mass * math.sqrt(GRAVITY * float(_posture(config, model).com[2]))


def robocup_measure(config: Config, bottle: float, momentum: float) -> float:
    """Return M = sqrt(H)/h_c m_B/m_R h_i/h_c [m^-0.5], by which the RoboCup Humanoid League ranks push recovery.

    H is the height from which the bottle of mass m_B swings, m_R the mass of the robot, h_c the height of its CoM, and
    h_i that of the hit, here of the pelvis.
    """
    model = load_model(config.robot)
    kin = _posture(config, model)
    com, hit = float(kin.com[2]), float(kin.point(model.pelvis)[2])
    return math.sqrt(drop(bottle, momentum)) / com * bottle / model.mass * hit / com


def _posture(config: Config, model: RobotModel) -> Kinematics:
    return Kinematics(model, make_walk(config, model).posture, Foot.LEFT)


def pushed(config: Config, push: Push) -> str:
    """Simulate a walk with one push; return why it was not survived, an empty text if it was.

    Raises
    ------
    PlantError
        If the walk ends, or the robot falls, before the push.
    """
    standing = push.moment == "standing"
    pushed_at = 2 if style_of(config) == "standing" else 6  # a dynamic walk needs some steps to full length
    values: dict[str, object] = {"gait.steps": 0 if standing else 2 * pushed_at - 2}
    if not standing:  # so that the pushed step, an even one, is on the requested foot
        values["gait.first_support"] = Foot(push.moment).other.value
    varied = config.updated(values)
    model = load_model(varied.robot)
    controller, plant = make_controller(varied, model), make_plant(varied.plant.name or "physics", varied, model)
    load = push.load(model.mass, varied.dt)
    began, why, transfer = math.inf, "", _transfer(varied)
    try:
        for state, _ in closed_loop(controller, plant):
            if began == math.inf and _due(controller, state.time, 0 if standing else pushed_at, push.part):
                began = state.time
            truth = plant.truth if push.bottle else None
            ahead = float(push.towards @ DQ(truth.pelvis).translation()) if truth else 0.0
            plant.push(load.force(ahead, varied.dt) * push.towards if began <= state.time else np.zeros(3), push.link)
            if standing and state.time > min(began, transfer + _LATE) + _STANDS:
                break
        if plant.fallen:
            why = f"fell in {controller.phase.name}"
    except DqwalkError as error:
        why = str(error)
    if began == math.inf:
        raise PlantError(f"the walk ended before the push{': ' + why if why else ''}")
    return why


def _transfer(config: Config) -> float:
    """Return the time after which a robot in a stance is at rest [s]."""
    return config.standing.transfer_duration if style_of(config) == "standing" else config.dynamic.stop_duration


def _due(controller: VelocityController, time: float, number: int, part: float) -> bool:
    """Return whether the push begins now: with `number` 0 in a stance, else in a fraction `part` of step `number`."""
    since = time - controller.phase_began
    if not number:
        return since >= _transfer(controller.config)
    steps = (controller.phase_index + 1) // 2 == number and controller.phase.kind is PhaseKind.SINGLE_SUPPORT
    rule = controller.phase.rule
    swing = rule.duration if isinstance(rule, Timed) else controller.config.standing.swing_duration
    return steps and since >= part * swing - 1e-9


def limit(config: Config, like: Push, tolerance: float, index: int, point: Mapping[str, Any]) -> Limit:
    """Find the largest impulse that is survived at the moment and in the direction of `point`, to a tolerance [N s].

    In all else the pushes are like one of them; the index is not used.
    """
    scale = impulse_scale(config)
    most = farthest_momentum(like.bottle) if like.bottle else _MOST * scale

    def fails(impulse: float) -> str:
        return pushed(config, replace(like, impulse=impulse, **point))

    return Limit(**point, **largest(fails, _FIRST * scale, most, tolerance)._asdict())


def limits(
    config: Config,
    out: Path,
    like: Push,
    moments: Sequence[str] = MOMENTS,
    directions: int = 8,
    *,
    tolerance: float | None = None,
    **options: Any,
) -> list[Limit]:
    """Find the limit in each of some directions at each of some `MOMENTS`, of pushes like one; see `every_limit`.

    The tolerance is in [N s], by default 0.36 % of `impulse_scale`.
    """
    tolerance = _TOLERANCE * impulse_scale(config) if tolerance is None else tolerance
    settings = config, like.duration, like.part, like.bottle, like.link, tolerance
    task = functools.partial(limit, config, like, tolerance)
    return every_limit(task, settings, out, moments, directions, **options)


def every_limit(
    task: Callable[[int, Mapping[str, Any]], Limit],
    settings: tuple[Any, ...],
    out: Path,
    moments: Sequence[str],
    directions: int,
    *,
    force: bool = False,
    **options: Any,
) -> list[Limit]:
    """Find a limit for every moment and each of some evenly spread directions, by a task such as `limit`.

    The settings are everything besides the point that affects an outcome, first the configuration. Limits are kept in
    ``limits.jsonl`` of a folder, unless `force` discards earlier ones; other options and errors are those of
    `runner.run`.
    """
    points = [{"moment": m, "direction": 2.0 * math.pi * k / directions} for m in moments for k in range(directions)]
    key = digest(settings[0], points, *settings[1:])
    return [one for _, one in run(task, Store(out / "limits.jsonl", key, points, Limit, force=force), **options)]
