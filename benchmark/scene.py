"""One world for walks of different packages on the same robot: what they are judged by.

Each seed draws masses, friction, stiffness of the servos and slope of the floor, which no walk knows, and the noise of
the sensors. A push is a constant force on the pelvis for 0.1 s in the middle of a single support, after which the robot
must walk on for three seconds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.support.errors import DqwalkError

HEAD = ("walk", "mean speed [m/s]", "arrived", "worst push [N s]", "J*", "where", "tick [ms]", "power [W]",
        "cost of transport", "fastest [m/s]")  # fmt: skip
PUSH = 0.1  # [s]
MOST, TOLERANCE = 1.2, 0.006  # of the push, as J*
AFTER = 3.0  # a pushed robot must walk on for this long [s]
UPRIGHT = 1.0  # a walk that ends must stand for this long [s]
BEARS = 0.02  # of the weight: a foot with less is in the air
FASTER = 1.25  # ratio of two speeds that are tried

Array = np.ndarray


class Controller(Protocol):
    """What walks: as the controllers of this package."""

    config: Config

    @property
    def finished(self) -> bool:
        """Whether the walk has ended."""

    def step(self, state: State, dt: float) -> Command:
        """Return the command that answers a state."""


@dataclass(frozen=True)
class Walked:
    """A simulated walk: whether it ended upright, its length [m], time [s], power [W], work [J], CPU time a tick [s].

    `supports` are its single supports: foot, begin and end [s].
    """

    upright: bool
    way: float
    time: float
    power: float
    work: float
    tick: float
    supports: list[tuple[Foot, float, float]]


@dataclass(frozen=True)
class Walker:
    """What is compared.

    It has a configuration, functions that return its controller and its robot at the joint angles `q`, a planned length
    [m], its CPU time per tick [s] where `make` returns a walk planned before, and whether it is its controller that
    keeps the robot upright after the walk, instead of the last joint angles.
    """

    name: str
    config: Config
    make: Callable[[Config], Controller]
    q: Array
    length: float
    tick: float | None = None
    plant: Callable[[Config, RobotModel, Array], PhysicsPlant] = PhysicsPlant
    balances: bool = False

    def walk(self, changes: dict[str, Any], push: tuple[float, Array] | None = None) -> Walked:
        """Simulate a walk in a changed world, with a push of (begin [s], force (3,) [N])."""
        config = self.config.updated(changes)
        model = load_model(config.robot)
        controller, plant = self.make(config), self.plant(config, model, self.q)
        start, q, began, ticks, energy, work = plant.truth.pelvis, plant.truth.q, 0.0, [], [], 0.0
        bears, standing = BEARS * GRAVITY * model.mass, []

        def before(t: float) -> None:
            nonlocal began
            if push is not None:
                plant.push(push[1] if push[0] <= t < push[0] + PUSH - 1e-9 else np.zeros(3))
            began = time.process_time()

        try:
            for state, _ in closed_loop(controller, plant, before):
                ticks.append(time.process_time() - began)
                if push is not None:
                    if state.time > push[0] + AFTER:
                        break
                    continue
                truth = plant.truth
                joints, q = truth.effort * (truth.q - q) / config.dt, truth.q
                energy.append(float(np.abs(joints).sum()))
                work += config.dt * float(np.maximum(joints, 0.0).sum())
                forces = {foot: np.linalg.norm(wrench[:3]) for foot, wrench in truth.wrenches.items()}
                standing.append((state.time, [foot for foot in Foot if forces[foot] > bears]))
            rest = Command(0.0, np.zeros(model.n))
            for _ in range(0 if plant.fallen or push is not None else round(UPRIGHT / config.dt)):
                plant.step(controller.step(plant.state, config.dt) if self.balances else rest, config.dt)
        except DqwalkError:
            return Walked(False, math.nan, math.nan, math.nan, math.nan, math.nan, [])
        way = DQ(plant.truth.pelvis).translation() - DQ(start).translation()
        duration = len(ticks) * config.dt
        tick = float(np.median(ticks)) if self.tick is None else self.tick
        return Walked(
            not plant.fallen,
            float(way[0]),
            duration,
            float(np.mean(energy or [math.nan])),
            work,
            tick,
            list(_single_supports(standing)),
        )


def _single_supports(standing: list[tuple[float, list[Foot]]]) -> Iterator[tuple[Foot, float, float]]:
    """Yield foot, begin and end of each single support of at least 0.1 s."""
    begin: tuple[Foot, float] | None = None
    for t, feet in standing:
        foot = feet[0] if len(feet) == 1 else None
        if begin is not None and foot is not begin[0]:
            if t - begin[1] > 0.1:
                yield (*begin, t)
            begin = None
        if foot is not None and begin is None:
            begin = foot, t


def world(seed: int) -> dict[str, Any]:
    """Return the changes of the world that a seed draws."""
    random = np.random.default_rng(seed)
    stiffness = random.uniform(0.85, 1.15)
    return {
        "physics.mass_scale": random.uniform(0.9, 1.1),
        "physics.friction": random.uniform(0.4, 1.0),
        "physics.slope": math.radians(random.uniform(-1.0, 1.0)),
        "physics.slope_side": math.radians(random.uniform(-1.0, 1.0)),
        "servo.stiffness": stiffness,  # a factor of the nominal one
        "sensors.seed": seed,
        "sensors.attitude_noise": 0.004,
        "sensors.gyro_noise": 0.02,
        "sensors.encoder": 0.001534,
        "sensors.velocity_filter": 0.01,
    }


def changed(walker: Walker, seed: int) -> dict[str, Any]:
    """Return the changes of the world of a walker."""
    drawn = world(seed)
    return {**drawn, "servo.stiffness": drawn["servo.stiffness"] * walker.config.servo.stiffness}


def arrives(walker: Walker, changes: dict[str, Any]) -> bool:
    """Return whether a walk ends upright after at least 70 % of its length."""
    walked = walker.walk(changes)
    return walked.upright and walked.way > 0.7 * walker.length


def worst_push(walker: Walker, calm: Walked, scale: float) -> tuple[float, str]:
    """Return the largest impulse survived in the worst of eight directions, in mid-step on either foot [N s].

    `scale` is M sqrt(g h) [N s].
    """
    worst = math.inf, ""
    for foot in Foot:
        _, begin, end = [support for support in calm.supports if support[0] is foot][2]  # at full length
        for k in range(8):
            angle = 0.25 * math.pi * k
            ahead = np.array([math.cos(angle), math.sin(angle), 0.0]) / PUSH
            at = 0.5 * (begin + end)

            def fails(impulse: float, at: float = at, ahead: Array = ahead) -> str:
                return "" if walker.walk({}, (at, impulse * ahead)).upright else "fell"

            found = largest(fails, 0.04 * scale, MOST * scale, TOLERANCE * scale).survived
            if found < worst[0]:
                worst = found, f"on the {foot.value} foot, {45 * k} degrees"
    return worst


def fastest(make: Callable[[float], Walker], speed: float, seeds: int) -> float:
    """Return the highest of the speeds `speed` times powers of `FASTER` at which a walk arrives for all seeds [m/s]."""
    best, factor = 0.0, 1.0
    while True:
        walker = make(factor)
        if not all(arrives(walker, changed(walker, seed)) for seed in range(seeds)):
            return best
        best, factor = factor * speed, FASTER * factor


def row(make: Callable[[float], Walker], speed: float, scale: float, seeds: int) -> list[str]:
    """Return the row of the table of a walk, which `make` returns for a factor of the common speed [m/s].

    `scale` is M sqrt(g h) [N s].
    """
    walker = make(1.0)
    model = load_model(walker.config.robot)
    print(f"{walker.name} ...", flush=True)
    calm = walker.walk({})
    arrived = sum(arrives(walker, changed(walker, seed)) for seed in range(seeds))
    impulse, where = worst_push(walker, calm, scale)
    cells = [
        walker.name,
        f"{calm.way / calm.time:.3f}",
        f"{arrived} of {seeds}",
        f"{impulse:.2f}",
        f"{impulse / scale:.3f}",
        where,
        f"{1e3 * calm.tick:.2f}",
        f"{calm.power:.2f}",
        f"{calm.work / (GRAVITY * model.mass * calm.way):.2f}",
        f"{fastest(make, speed, seeds):.3f}",
    ]
    print("  ".join(cells), flush=True)
    return cells
