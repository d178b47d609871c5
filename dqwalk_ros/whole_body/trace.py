"""A whole-body walk as a table: what was measured, what was commanded, what the controller previewed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.records import BodyCommand, BodyState, BodyTick, Wrench
from dqwalk_ros.whole_body.scenario import Scenario

__all__ = ["FEET", "BodyLog", "Collector", "Reaching", "Reaction"]

Array = NDArray[np.float64]

FEET = (Foot.LEFT, Foot.RIGHT)
"""The order of feet in arrays."""


@dataclass(frozen=True)
class Reaction:
    """What a jump of the target did to the preview in that very tick.

    Attributes
    ----------
    time : float
        [s]
    swinging : bool
        Whether a foot was in the air.
    moved : tuple of float
        How far each previewed footstep moved, the next one first: solved with the new target, and from the same
        state with the one before it [m].
    held : bool
        Whether the next footstep cannot move: in both coordinates at a bound of its box, or settled.
    """

    time: float
    swinging: bool
    moved: tuple[float, ...]
    held: bool = False


@dataclass(frozen=True)
class BodyLog:
    """A whole-body walk as its topics tell it.

    Attributes
    ----------
    config : Config
    model : RobotModel
    scenario : Scenario
        Targets and pushes, when they took effect.
    states : tuple of BodyState
        Time counts from the first one.
    effort : ndarray, shape (N, n)
        The torques that answered each state [N m].
    wrenches : ndarray, shape (N, 2, 6)
        Force and moment of the ground on the left and the right sole in the period after each state, about the
        sole's origin, in world axes [N, N m]; nan where a foot does not stand, or nobody told.
    notes : tuple of str
        What is missing or was left out.
    origin : mapping of str to str
        Versions and machine of who walked, empty where the record does not say.
    """

    config: Config
    model: RobotModel
    scenario: Scenario
    states: tuple[BodyState, ...]
    effort: Array
    wrenches: Array
    notes: tuple[str, ...] = ()
    origin: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Reaching:
    """What happened, one row per tick.

    Attributes
    ----------
    scenario : Scenario
    config : Config
    model : RobotModel
    time : ndarray, shape (N,)
        [s]
    q, dq, x_base, v_base : ndarray, shapes (N, n), (N, n), (N, 8), (N, 6)
        The joints [rad, rad/s], the pose of the root link and its velocity in its own axes.
    target, hand, com, com_velocity, left, right : ndarray, shape (N, 3)
        Places, and the soles' links [m, m/s]; nan where there is no target.
    support, landing, cop, cop_preview : ndarray, shape (N, 2)
        The foot that landed last, where the next one is to land, the CoP of the contacts and of the point mass [m].
    single : ndarray of bool, shape (N,)
        Whether one foot stands.
    wrenches : ndarray, shape (N, 2, 6)
        As of `BodyLog`.
    margins : mapping of str to ndarray, shape (N,)
        How far each limit is away, at least: ``cop_margin`` [m], ``friction`` and ``normal`` force in units of the
        weight, ``torque`` relative to the limit, ``joint`` [rad], ``step`` [m]. The forces are the plant's.
    effort : ndarray, shape (N, n)
        [N m]
    height_error, tilt, capturability, violation : ndarray, shape (N,)
    method : tuple of str
    iterations : ndarray, shape (N,)
    times : ndarray, shape (N, 4)
        Model, assembly, solution and the whole tick [s], by the controller's clock.
    reactions : tuple of Reaction
        To each jump of the target.
    note : str
        How it ended before its time, empty if it did not.
    again : bool
        Whether it was solved again from a record.
    origin : mapping of str to str
        Versions and machine of who walked, empty where that is not known.
    """

    scenario: Scenario
    config: Config
    model: RobotModel
    time: Array
    q: Array
    dq: Array
    x_base: Array
    v_base: Array
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
    wrenches: Array
    margins: dict[str, Array]
    effort: Array
    height_error: Array
    tilt: Array
    capturability: Array
    violation: Array
    method: tuple[str, ...]
    iterations: Array
    times: Array
    reactions: tuple[Reaction, ...] = ()
    note: str = ""
    again: bool = False
    origin: Mapping[str, str] = field(default_factory=dict)

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


_MARGINS = ("cop_margin", "friction", "normal", "torque", "joint", "step")
_STATE = ("time", "q", "dq", "x_base", "v_base", "effort", "wrenches")
_PLACES = ("target", "hand", "com", "com_velocity", "left", "right", "support", "landing", "cop", "cop_preview")
_NUMBERS = ("height_error", "tilt", "capturability", "violation", "iterations", "times")
_NAMES = (*_STATE, *_PLACES, *_NUMBERS)


@dataclass
class Collector:
    """Collects a `Reaching` tick by tick.

    Parameters
    ----------
    controller : WholeBodyController
    scenario : Scenario
    """

    controller: WholeBodyController
    scenario: Scenario
    reactions: list[Reaction] = field(default_factory=list)
    _rows: dict[str, list[object]] = field(default_factory=dict)

    def add(
        self,
        time: float,
        state: BodyState,
        command: BodyCommand,
        effort: Array,
        wrenches: Mapping[Foot, Wrench],
        spent: float,
    ) -> BodyTick:
        """Add the tick that the controller has just made; `effort` is what the plant was given."""
        controller = self.controller
        tick, target = controller.last, controller.target
        forces = np.full((2, 6), np.nan)
        for foot, wrench in wrenches.items():
            forces[FEET.index(foot)] = np.concatenate([wrench.force, wrench.moment])
        row = {
            "time": time,
            "q": state.q,
            "dq": state.dq,
            "x_base": state.x_base,
            "v_base": state.v_base,
            "target": np.full(3, np.nan) if target is None else target,
            "hand": tick.hand,
            "com": tick.com,
            "com_velocity": tick.com_velocity,
            "left": controller.sole(Foot.LEFT),
            "right": controller.sole(Foot.RIGHT),
            "support": tick.support,
            "landing": tick.footsteps[0],
            "cop": tick.cop,
            "cop_preview": tick.cop_preview,
            "single": len(command.stance) == 1,
            "wrenches": forces,
            "effort": effort,
            "height_error": tick.height_error,
            "tilt": tick.tilt,
            "capturability": tick.capturability,
            "violation": tick.violation,
            "method": tick.method,
            "iterations": tick.iterations,
            "times": (*tick.times, spent),
            **_margins(controller, wrenches, state.q, effort, tick),
        }
        for name, value in row.items():
            self._rows.setdefault(name, []).append(value)
        return tick

    def reaching(self, note: str = "", *, again: bool = False, origin: Mapping[str, str] | None = None) -> Reaching:
        """Return what was collected."""
        rows = {name: np.array(self._rows[name], dtype=np.float64) for name in (*_NAMES, *_MARGINS)}
        return Reaching(
            scenario=self.scenario,
            config=self.controller.config,
            model=self.controller.model,
            **{name: rows[name] for name in _NAMES},
            single=np.array(self._rows["single"], dtype=np.bool_),
            margins={name: rows[name] for name in _MARGINS},
            method=tuple(map(str, self._rows["method"])),
            reactions=tuple(self.reactions),
            note=note,
            again=again,
            origin=dict(origin or {}),
        )

    def __len__(self) -> int:
        return len(self._rows.get("time", ()))


def _margins(
    controller: WholeBodyController, wrenches: Mapping[Foot, Wrench], q: Array, effort: Array, tick: BodyTick
) -> dict[str, float]:
    """Say how far each limit is away; the forces are those of the plant, not those the controller planned."""
    settings, model = controller.config.whole_body, controller.model
    half = 0.5 * np.array([settings.cop_length, settings.cop_width])
    weight = controller.weight
    cop, friction, normal = np.inf, np.inf, np.inf
    for wrench in wrenches.values():
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
