"""Complete walks, computed once per process, and the distances of all constraints along them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import robots
from numpy.typing import NDArray

from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.features import Observer, Quantity
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.qp.problem import Problem
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_controller, make_walk

Array = NDArray[np.float64]


def problem_at(
    phase: Phase, kin: Kinematics, dt: float = 0.005, limit: Array | None = None, elapsed: float = np.inf
) -> Problem:
    """The quadratic program of a phase at one configuration."""
    return phase.evaluate(kin.q, kin.up, elapsed, dt, limit).problem


def problem_of(
    H: Array, c: Array, E: Array, e: Array, G: Array, h: Array, lower: Array, upper: Array, names: tuple[str, ...] = ()
) -> Problem:
    """The problem with the equalities E u = e and the inequalities G u >= h."""
    return Problem.of(H, c, np.concatenate([E, G]), np.concatenate([e, h]), lower, upper, len(e), names)


def values(item: Quantity, kin: Kinematics, elapsed: float = np.inf) -> tuple[Array, Array]:
    """Error of a task or distance of a constraint (k,), and its Jacobian (k, n), by the chain rule."""
    s, J = Observer(item.watches, kin.tree)(kin)
    value, gradient, _ = item.evaluate(s, elapsed)
    return value, gradient @ J


def exact(problem: Problem) -> Array:
    """Goldfarb and Idnani's dual active-set method, on the problem in units of its own gradient."""
    import quadprog

    s = np.abs(problem.c).max() / np.abs(problem.H).max()
    n = problem.c.size
    A = np.concatenate([problem.E, problem.G, -np.eye(n), np.eye(n)])
    b = np.concatenate([problem.e, problem.h, -problem.upper, problem.lower]) / s
    H = problem.H / np.abs(problem.H).max()
    c = problem.c / np.abs(problem.c).max()
    return s * quadprog.solve_qp(H, -c, A.T.copy(), b, problem.e.size)[0]


def walk(config: Config, model: RobotModel, max_time: float | None = None) -> Trace:
    return simulate(make_controller(config, model), KinematicPlant(model), max_time=max_time)


def paper_walk(first: str, flat: bool = True, cycles: int = 1) -> Trace:
    """The paper's walk with the paper's gains."""
    return _paper_walk(first, flat, cycles)


@cache  # without default values: for the cache, an omitted and an explicit default are different calls
def _paper_walk(first: str, flat: bool, cycles: int) -> Trace:
    changes = {"gait.first_support": first, "dsp.flat_feet": flat, "gait.cycles": cycles}
    return walk(load("paper").updated(changes), robots.legs())


@dataclass(frozen=True)
class Segment:
    """One phase of a walk: its states from the first to the one that ended it, with the values of its constraints.

    `distances` has one array (ticks, k) per inequality constraint, minus its bound, `equalities` the same per equality
    constraint; `rates` are the gains eta that are used [1/s].
    """

    phase: Phase
    ticks: range
    time: np.ndarray
    error: np.ndarray
    distances: dict[str, np.ndarray]
    equalities: dict[str, np.ndarray]
    rates: dict[str, float]
    last: Kinematics


def segments(trace: Trace) -> Iterator[Segment]:
    """Recompute the phases of a walk from its joint angles."""
    config, model = trace.config, trace.model
    for record, span in zip(trace.phases, trace.spans, strict=True):
        phase = make_walk(config, model).phase(record.kind, record.support, record.q_start, record.swing_target)
        ticks = range(span.start, min(span.stop + 1, len(trace)))  # with the state that ended it
        error, margins = [], []
        for tick in ticks:
            now = phase.evaluate(trace.q[tick])
            error.append(now.error)
            margins.append(now.margins)
        rows = (*phase.equalities, *phase.constraints)
        arrays = {row.name: np.array(margins)[:, phase.assembly.rows.spans[row.name]] for row in rows}
        yield Segment(
            phase=phase,
            ticks=ticks,
            time=trace.time[ticks.start : ticks.stop] - trace.time[ticks.start],
            error=np.array(error),
            distances={row.name: arrays[row.name] for row in phase.constraints},
            equalities={row.name: arrays[row.name] for row in phase.equalities},
            rates={row.name: min(row.eta, 1.0 / config.dt) for row in rows},
            last=Kinematics(model, trace.q[ticks[-1]], phase.base),
        )


@cache
def paper_segments(first: str, flat: bool, cycles: int) -> tuple[Segment, ...]:
    return tuple(segments(paper_walk(first, flat, cycles)))


DT = 0.005
KINDS = [(kind, foot) for kind in (PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT) for foot in Foot]


@cache
def setting():
    config = load("paper").updated({"task.posture_weight": 0.01})
    return config, load_model(config.robot)


def phase_of(kind, foot):
    config, model = setting()
    walk = make_walk(config, model)
    target = walk.footstep(foot) if kind is PhaseKind.SINGLE_SUPPORT else None
    return walk.phase(kind, foot, np.full(model.n, 0.01), target)
