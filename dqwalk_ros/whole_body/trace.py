"""The record of a whole-body walk: what a bag contains of it, and what the controller computed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.errors import DqwalkError
from dqwalk_ros.support.provenance import here
from dqwalk_ros.trace import Recorded
from dqwalk_ros.whole_body.controller import BodyState, WholeBodyController
from dqwalk_ros.whole_body.rigid_plant import BodyPlant
from dqwalk_ros.whole_body.scenario import Scenario


@dataclass(frozen=True)
class Reaction:
    """Effect of a jump of the hand's target on the preview in the same control period."""

    time: float
    """Time of the jump [s]."""
    swinging: bool
    """Whether a foot was in the air."""
    moved: tuple[float, ...]
    """Distance between the previewed footsteps for the new and for the previous target, solved for the same state, the
    next footstep first [m]."""
    held: bool = False
    """Whether the next footstep cannot move: it is at a bound of its box in both coordinates, or fixed."""


@dataclass(frozen=True, kw_only=True)
class BodyLog(Recorded):
    """What a bag contains of a whole-body walk."""

    scenario: Scenario
    """Targets and pushes, at the times at which they took effect."""
    dq: Array
    x_base: Array
    v_base: Array
    """Joint velocities [rad/s], pose of the root link and its velocity in its own axes, shapes (N, n), (N, 8), (N, 6)
    [m/s, rad/s]."""
    effort: Array
    """Torques commanded for each state, shape (N, n) [N m]."""
    wrenches: Array
    """Force and moment of the ground on the left and the right sole in the period after each state, about the sole's
    origin, in world axes, shape (N, 2, 6) [N, N m]; nan if the foot does not stand or its wrench was not recorded."""

    def state(self, k: int) -> BodyState:
        """Return the state of index `k`."""
        return BodyState(float(self.time[k]), self.q[k], dq=self.dq[k], x_base=self.x_base[k], v_base=self.v_base[k])


@dataclass(frozen=True, kw_only=True)
class WholeBodyTrace(BodyLog):
    """A whole-body walk with what the controller computed for it, one row per control period."""

    target: Array
    hand: Array
    com: Array
    com_velocity: Array
    left: Array
    right: Array
    """Target of the hand (nan without one), hand, CoM and its velocity, and the soles' links, shape (N, 3) [m, m/s]."""
    support: Array
    landing: Array
    """The foot that landed last, and the next landing place, shape (N, 2) [m]."""
    single: Mask
    """Whether the robot is in single support, shape (N,)."""
    height_error: Array
    tilt: Array
    """Error of the CoM's height [m] and inclination of the torso [rad], each of shape (N,)."""
    residual: Array
    violation: Array
    iterations: Array
    """Residual of (S14) [m], relaxation of level 1, and number of iterations of the solver, shape (N,)."""
    method: tuple[str, ...]
    """Method of the solution, as in `Answer`."""
    times: Array
    """Time taken by model, assembly and solution, and in total, by the controller's clock, shape (N, 4) [s]."""
    margins: Mapping[str, Array]
    """Least distance from each limit, shape (N,): ``cop_margin`` [m], ``friction`` and ``normal`` force in units of the
    weight, ``torque`` relative to the limit, ``joint`` [rad], ``step`` [m]. The forces are those of the plant."""
    reactions: tuple[Reaction, ...] = ()
    """Effect of each jump of the target."""
    note: str = ""
    """Reason for an early end of the walk; empty without one."""
    again: bool = False
    """Whether the trace is from a recorded walk that was solved again."""

    @property
    def stood(self) -> bool:
        """Whether the walk reached its end without a fall or an error."""
        return not self.note

    @property
    def error(self) -> Array:
        """Horizontal distance of the hand from its target, shape (N,) [m]."""
        return np.asarray(np.linalg.norm((self.hand - self.target)[:, :2], axis=1))

    def at(self, time: float) -> int:
        """Return the index of the last row before a time [s]."""
        return max(int(np.searchsorted(self.time, time - 1e-6)) - 1, 0)

    def footholds(self) -> list[tuple[float, Array]]:
        """Return time [s] and position (2,) [m] of each landing, beginning with the first support foot."""
        moved = np.flatnonzero(np.any(np.abs(np.diff(self.support, axis=0)) > 1e-9, axis=1)) + 1
        return [(float(self.time[i]), self.support[i]) for i in moved]


class BodyRecorder:
    """Collects a `WholeBodyTrace`, one control period after the other."""

    def __init__(self, controller: WholeBodyController, scenario: Scenario) -> None:
        self._controller, self._scenario = controller, scenario
        self._rows: dict[str, list[Any]] = defaultdict(list)
        self._forces: list[tuple[Array, Mapping[Foot, Array]]] = []
        self.reactions: list[Reaction] = []

    def add(self, state: BodyState, plant: BodyPlant) -> None:
        """Add a state, the controller's step for it, and the plant's torques and wrenches in the period before."""
        self._forces.append((plant.effort, plant.wrenches))
        c, tick, target = self._controller, self._controller.last, self._controller.target
        scene, answer, settings = tick.scene, tick.answer, c.config.whole_body
        d, preview, footsteps = scene.dynamics, scene.preview, tick.footsteps
        left, right = (d.frames[c.model.soles[foot].frame].position for foot in Foot)
        height_error, tilt = c.posture_error
        dP = np.diff(footsteps, axis=0, prepend=scene.support[None])
        row = {
            **{name: getattr(state, name) for name in ("time", "q", "dq", "x_base", "v_base")},
            "target": np.full(3, np.nan) if target is None else target,
            "hand": d.frames[settings.hand].position,
            "com": d.com,
            "com_velocity": d.com_velocity,
            "left": left,
            "right": right,
            "support": scene.support,
            "landing": footsteps[0],
            "single": len(scene.stance) == 1,
            "height_error": height_error,
            "tilt": tilt,
            **{name: getattr(answer, name) for name in ("residual", "violation", "iterations", "method")},
            "times": tick.times,
            "step": float(np.minimum(dP - preview.lower[preview.feet], preview.upper[preview.feet] - dP).min()),
        }
        for name, value in row.items():
            self._rows[name].append(value)

    def trace(self, plant: BodyPlant, note: str) -> WholeBodyTrace:
        """Return the trace of all periods that the plant has completed.

        Parameters
        ----------
        plant : BodyPlant
            The plant after the last period.
        note : str
            Reason for an early end of the walk.

        Raises
        ------
        DqwalkError
            If there is none.
        """
        controller, forces = self._controller, [*self._forces[1:], (plant.effort, plant.wrenches)]  # after each state
        count = sum(time < plant.state.time for time in self._rows["time"])
        if not count:
            raise DqwalkError(f"{self._scenario.name} ended before its first tick: {note or 'it is shorter than one'}")
        columns: dict[str, Any] = {name: np.array(values[:count]) for name, values in self._rows.items()}
        step, method, no_contact = columns.pop("step"), columns.pop("method"), np.full(6, np.nan)
        margins = [self._distances(q, *each) for q, each in zip(columns["q"], forces[:count], strict=True)]
        return WholeBodyTrace(
            scenario=self._scenario,
            config=controller.config,
            model=controller.model,
            **columns,
            effort=np.array([effort for effort, _ in forces[:count]]),
            wrenches=np.array([[each.get(foot, no_contact) for foot in Foot] for _, each in forces[:count]]),
            method=tuple(method.tolist()),
            margins={name: np.array([row[name] for row in margins]) for name in margins[0]} | {"step": step},
            reactions=tuple(self.reactions),
            note=note,
            origin=here(),
        )

    def _distances(self, q: Array, effort: Array, wrenches: Mapping[Foot, Array]) -> dict[str, float]:
        """Return the least distance from each limit; the forces are those of the plant, not the planned ones."""
        settings, model, weight = self._controller.config.whole_body, self._controller.model, self._controller.weight
        half = 0.5 * np.array([settings.cop_length, settings.cop_width])
        cop, friction, normal = np.inf, np.inf, np.inf
        for wrench in wrenches.values():
            up = float(wrench[2])
            normal = min(normal, up / weight)
            # distance from the pyramid's faces; the CoP is defined from a thousandth of the weight on
            tangential = float(np.abs(wrench[:2]).max())
            friction = min(friction, (settings.friction / np.sqrt(2.0) * up - tangential) / weight)
            if up > 1e-3 * weight:
                cop = min(cop, float((half - np.abs(wrench[[4, 3]]) / up).min()))
        most = np.minimum(model.effort_max, settings.effort)
        return {
            "cop_margin": cop,
            "friction": friction,
            "normal": normal,
            "torque": float((1.0 - np.abs(effort) / most).min()),
            "joint": float(np.minimum(q - model.q_min, model.q_max - q).min()),
        }
