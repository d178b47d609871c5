"""Tests 1 and 2: a hand that is led about, and a robot that is pushed meanwhile, section VII [Sherikov2014]."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controllers.whole_body import BodyCommand, BodyState, BodyTick, WholeBodyController, Wrench
from dqwalk_ros.exceptions import ConfigError, DqwalkError
from dqwalk_ros.model import Foot

__all__ = ["PAPER_TIMES", "SCENARIOS", "BodyPlant", "Reaching", "Scenario", "follow"]

Array = NDArray[np.float64]

_FALLEN = 0.2
"""A robot whose CoM is lower than it should be by this fraction of its height falls."""


class BodyPlant(Protocol):
    """A body that takes torques and pushes."""

    @property
    def state(self) -> BodyState:
        """The state now."""

    @property
    def wrenches(self) -> Mapping[Foot, Wrench]:
        """What the ground did to the feet; empty where that is not judged."""

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        """Return the state one period later."""

    def push(self, impulse: tuple[float, float, float]) -> None:
        """Hit the robot [N s]."""


@dataclass(frozen=True)
class Scenario:
    """What happens to the robot.

    Attributes
    ----------
    name : str
    duration : float
        [s]
    targets : tuple of (float, tuple)
        From when on the hand should be where [s, m].
    pushes : tuple of (float, tuple)
        When which impulse hits the torso [s, N s].
    """

    name: str
    duration: float
    targets: tuple[tuple[float, tuple[float, float, float]], ...] = ()
    pushes: tuple[tuple[float, tuple[float, float, float]], ...] = ()

    def __post_init__(self) -> None:
        """Refuse what never happens."""
        for when, what in (*self.targets, *self.pushes):
            if len(what) != 3 or not np.isfinite((when, *what)).all() or not when >= 0.0:
                raise ConfigError(f"'{self.name}': {what} at {when} s is no place or impulse at a time from 0 on")


_TARGETS = ((0.0, (1.2, -0.8, 0.9)), (4.6, (2.0, -0.8, 0.9)), (6.25, (2.0, -0.2, 0.9)), (8.0, (1.8, -0.4, 0.9)))
_PUSHES = ((2.5, (0.0, 15.0, 0.0)), (7.0, (-15.0, 0.0, 0.0)))
SCENARIOS = {
    "1": Scenario("Test 1", 14.0, _TARGETS),
    "2": Scenario("Test 2", 14.0, _TARGETS, _PUSHES),
}
"""The paper's tests, with the times of the thesis, where the target jumps in mid-swing."""
PAPER_TIMES = ((0.0, (1.2, -0.8, 0.9)), (4.0, (2.0, -0.8, 0.9)), (8.0, (1.8, -0.4, 0.9)))
"""The targets at the times that the paper's text has."""


@dataclass(frozen=True)
class Reaching:
    """What happened, one row per tick.

    Attributes
    ----------
    scenario : Scenario
    config : Config
    time : ndarray, shape (N,)
        [s]
    q, x_base : ndarray, shapes (N, n), (N, 8)
        The joints [rad] and the pose of the root link.
    target, hand, com, com_velocity, left, right : ndarray, shape (N, 3)
        Places, and the soles' links [m, m/s]; nan where there is no target.
    support, landing, cop, cop_preview : ndarray, shape (N, 2)
        The foot that landed last, where the next one is to land, the CoP of the contacts and of the point mass [m].
    single : ndarray of bool, shape (N,)
        Whether one foot stands.
    margins : mapping of str to ndarray, shape (N,)
        How far each limit is away, at least: ``cop`` [m], ``friction`` and ``normal`` force in units of the weight,
        ``torque`` relative to the limit, ``joint`` [rad], ``step`` [m]. The forces are the plant's.
    effort : ndarray, shape (N, n)
        [N m]
    height_error, tilt, capturability, violation : ndarray, shape (N,)
    method : tuple of str
    iterations : ndarray, shape (N,)
    times : ndarray, shape (N, 4)
        Model, assembly, solution and the whole tick [s], by the controller's clock.
    note : str
        How it ended before its time, empty if it did not.
    """

    scenario: Scenario
    config: Config
    time: Array
    q: Array
    x_base: Array
    target: Array
    hand: Array
    com: Array
    com_velocity: Array
    left: Array
    right: Array
    support: Array
    landing: Array
    cop: Array
    cop_preview: Array
    single: NDArray[np.bool_]
    margins: dict[str, Array]
    effort: Array
    height_error: Array
    tilt: Array
    capturability: Array
    violation: Array
    method: tuple[str, ...]
    iterations: Array
    times: Array
    note: str = ""

    @property
    def stood(self) -> bool:
        """Whether it came to its end on its feet."""
        return not self.note

    @property
    def error(self) -> Array:
        """Horizontal distance of the hand from its target, shape (N,) [m]."""
        return np.asarray(np.linalg.norm((self.hand - self.target)[:, :2], axis=1))

    def at(self, time: float) -> int:
        """Index of the last tick before a time [s]."""
        return max(int(np.searchsorted(self.time, time - 1e-6)) - 1, 0)

    def footholds(self) -> list[tuple[float, Array]]:
        """Return when and where each foot landed, beginning with the first support foot [s, m]."""
        moved = np.flatnonzero(np.any(np.abs(np.diff(self.support, axis=0)) > 1e-9, axis=1)) + 1
        return [(float(self.time[i]), self.support[i]) for i in moved]


@dataclass
class _Rows:
    """Collects them."""

    rows: dict[str, list[object]] = field(default_factory=dict)

    def add(self, **values: object) -> None:
        for name, value in values.items():
            self.rows.setdefault(name, []).append(value)

    def array(self, name: str) -> Array:
        return np.array(self.rows.get(name, []), dtype=np.float64)


def follow(
    controller: WholeBodyController,
    plant: BodyPlant,
    scenario: Scenario,
    *,
    clock: Callable[[], float] = time.perf_counter,
    progress: Callable[[float, str], None] | None = None,
) -> Reaching:
    """Close the loop of controller and plant over a scenario.

    A fall, or a controller or plant that gives up, ends it; what happened until then is returned.
    """
    config, rows, note = controller.config, _Rows(), ""
    targets, pushes = sorted(scenario.targets), sorted(scenario.pushes)
    state, begin = plant.state, plant.state.time
    tick: BodyTick | None = None
    for _ in range(round(scenario.duration / config.dt)):
        now = state.time - begin
        while targets and targets[0][0] <= now + 1e-9:
            controller.reach(targets.pop(0)[1])
        while pushes and pushes[0][0] <= now + 1e-9:
            plant.push(pushes.pop(0)[1])
            state = plant.state
        try:
            began = clock()
            command = controller.step(state, config.dt)
            spent = clock() - began
            after = plant.step(command, config.dt)
        except DqwalkError as error:
            note = f"gave up at {now:.3f} s: {error}"
            break
        tick = controller.last
        target = controller.target
        rows.add(
            time=now,
            q=state.q,
            x_base=state.x_base,
            target=np.full(3, np.nan) if target is None else target,
            hand=tick.hand,
            com=tick.com,
            com_velocity=tick.com_velocity,
            left=controller.sole(Foot.LEFT),
            right=controller.sole(Foot.RIGHT),
            support=tick.support,
            landing=tick.footsteps[0],
            cop=tick.cop,
            cop_preview=tick.cop_preview,
            single=len(command.stance) == 1,
            effort=command.effort,
            height_error=tick.height_error,
            tilt=tick.tilt,
            capturability=tick.capturability,
            violation=tick.violation,
            method=tick.method,
            iterations=tick.iterations,
            times=(*tick.times, spent),
            **_margins(controller, plant, state.q, command.effort, tick),
        )
        if abs(tick.height_error) > _FALLEN * controller.point_mass.height:
            note = f"fell at {now:.3f} s"
            break
        state = after
        if progress is not None:
            progress(now / scenario.duration, f"{scenario.name}  t = {now:.1f} s")
    if tick is None:
        raise DqwalkError(f"{scenario.name} ended before it began: {note}")
    names = ("q", "x_base", "target", "hand", "com", "com_velocity", "left", "right", "support", "landing", "cop")
    return Reaching(
        scenario=scenario,
        config=config,
        time=rows.array("time"),
        **{name: rows.array(name) for name in (*names, "cop_preview", "effort", "height_error", "tilt")},
        single=rows.array("single").astype(np.bool_),
        margins={name: rows.array(name) for name in ("cop_margin", "friction", "normal", "torque", "joint", "step")},
        capturability=rows.array("capturability"),
        violation=rows.array("violation"),
        method=tuple(str(name) for name in rows.rows["method"]),
        iterations=rows.array("iterations"),
        times=rows.array("times"),
        note=note,
    )


def _margins(
    controller: WholeBodyController, plant: BodyPlant, q: Array, effort: Array, tick: BodyTick
) -> dict[str, float]:
    """Say how far each limit is away; the forces are those of the plant, not those the controller planned."""
    settings, model = controller.config.whole_body, controller.model
    half = 0.5 * np.array([settings.cop_length, settings.cop_width])
    weight = controller.weight
    cop, friction, normal = np.inf, np.inf, np.inf
    for wrench in plant.wrenches.values():
        up = float(wrench.force[2])
        normal = min(normal, up / weight)
        # the pyramid's faces; and the CoP of a foot that carries a thousandth of the weight has no place
        sideways = float(np.abs(wrench.force[:2]).max())
        friction = min(friction, (settings.friction / np.sqrt(2.0) * up - sideways) / weight)
        if up > 1e-3 * weight:
            cop = min(cop, float((half - np.abs(wrench.cop)).min()))
    most = np.minimum(model.effort_max, settings.effort)
    dP = tick.footsteps - np.vstack([tick.support, tick.footsteps[:-1]])
    lower, upper = controller.step_bounds
    return {
        "cop_margin": cop,
        "friction": friction,
        "normal": normal,
        "torque": float((1.0 - np.abs(effort) / most).min()),
        "joint": float(np.minimum(q - model.q_min, model.q_max - q).min()),
        "step": float(np.minimum(dP - lower, upper - dP).min()),
    }
