"""The compiled rows against their definition, the methods of tasks and constraints, whatever a phase mixes."""

from __future__ import annotations

import dataclasses
import pickle
from functools import cache

import numpy as np
import pytest

from dqwalk_ros.assembly.independent import independent
from dqwalk_ros.config import load
from dqwalk_ros.constraints import DEPENDENT, PointOverPlane, gain, hold_rows, vfi_rows
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.gait import footstep
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, load_model
from dqwalk_ros.phases import PhaseKind, assemble, make_phase
from dqwalk_ros.standing.phases import posture
from dqwalk_ros.tasks import Posture

DT = 0.005
KINDS = [(kind, foot) for kind in (PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT) for foot in Foot]


@cache
def setting():
    config = load("paper").updated({"task.posture_weight": 0.01})
    return config, load_model(config.robot)


def phase_of(kind, foot):
    config, model = setting()
    target = footstep(config, model, foot) if kind is PhaseKind.SINGLE_SUPPORT else None
    return make_phase(config, model, kind, foot, np.full(model.n, 0.01), target)


def configurations(count, seed=0):
    model = setting()[1]
    return np.random.default_rng(seed).uniform(model.q_min, model.q_max, (count, model.n))


def defined(phase, kin):
    """(6) as the paper writes it, from nothing but error, distance and jacobian."""
    n = kin.q.size
    H, c = phase.damping**2 * np.eye(n), np.zeros(n)
    for task in phase.tasks:
        J = task.jacobian(kin)
        H += task.weight * J.T @ J
        c += task.weight * phase.eta * J.T @ task.error(kin)

    def stacked(rows):
        parts = [vfi_rows(row, kin, DT) for row in rows]
        return np.concatenate([np.empty((0, n)), *(G for G, _ in parts)]), np.concatenate([[], *(h for _, h in parts)])

    above, below = phase.limits
    upper = gain(above.eta, DT) * (above.distance(kin) - above.bound)
    lower = -gain(below.eta, DT) * (below.distance(kin) - below.bound)
    return H, c, *stacked(phase.holds), *stacked(phase.rows), lower, upper


def assert_equal(phase, kin):
    problem = assemble(phase, kin, DT)
    names = ("H", "c", "E", "e", "G", "h", "lower", "upper")
    for name, ours, exact in zip(names, problem.arrays, defined(phase, kin), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-12, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(np.diag(problem.diagonal) + problem.J.T @ problem.J, problem.H, rtol=1e-12, atol=1e-12)
    assert len(problem.names) == problem.e.size + problem.h.size + 2 * kin.q.size


@pytest.mark.parametrize(("kind", "foot"), KINDS)
def test_every_row_is_its_definition(kind, foot):
    phase = phase_of(kind, foot)
    for q in configurations(25):
        assert_equal(phase, Kinematics(setting()[1], q, phase.base))


def test_velocity_limits_only_tighten_the_bounds():
    phase, limit = phase_of(*KINDS[0]), np.linspace(0.0, 3.0, setting()[1].n)
    limit[-1] = np.inf
    for q in configurations(5, seed=2):
        kin = Kinematics(setting()[1], 1.2 * q, phase.base)
        free, limited = assemble(phase, kin, DT), assemble(phase, kin, DT, limit)
        np.testing.assert_array_equal(limited.upper, np.clip(free.upper, -limit, limit))
        np.testing.assert_array_equal(limited.lower, np.clip(free.lower, -limit, limit))
        np.testing.assert_array_equal(limited.G, free.G)
        assert (limited.upper < free.upper).any()


class Higher(PointOverPlane):
    """A user's own constraint, which the table must not take for its parent."""

    def distance(self, kin):
        return super().distance(kin) - 0.01


class Twice(Posture):
    """A user's own task."""

    def error(self, kin):
        return 2.0 * super().error(kin)

    def jacobian(self, kin):
        return 2.0 * super().jacobian(kin)


@pytest.mark.parametrize(("kind", "foot"), KINDS[::2])
def test_kinds_unknown_to_the_table_are_asked_by_their_methods(kind, foot):
    phase = phase_of(kind, foot)
    plane = next(row for row in phase.rows if type(row) is PointOverPlane)
    own = Higher(name="own", eta=3.0, bound=0.02, point=plane.point, plane=plane.plane)
    task = Twice(name="own", weight=0.3, q_ref=np.full(setting()[1].n, 0.2))
    first = phase.rows[0]
    mixed = dataclasses.replace(
        phase, rows=(own, *phase.rows, own), holds=(*phase.holds, own), tasks=(*phase.tasks, task)
    )
    for q in configurations(5, seed=1):
        assert_equal(mixed, Kinematics(setting()[1], q, phase.base))
    assert mixed.rows[1] is first


def test_a_later_tick_leaves_the_problem_of_an_earlier_one_alone():
    phase = phase_of(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT)
    q, other = configurations(2)
    model = setting()[1]
    problem = assemble(phase, Kinematics(model, q, phase.base), DT)
    before = [array.copy() for array in problem.arrays]
    assemble(phase, Kinematics(model, other, phase.base), DT)
    for ours, kept in zip(problem.arrays, before, strict=True):
        np.testing.assert_array_equal(ours, kept)


def test_a_phase_can_be_sent_to_another_process():
    phase = phase_of(PhaseKind.SINGLE_SUPPORT, Foot.RIGHT)
    kin = Kinematics(setting()[1], configurations(1)[0], phase.base)
    H = assemble(phase, kin, DT).H
    np.testing.assert_array_equal(assemble(pickle.loads(pickle.dumps(phase)), kin, DT).H, H)


@cache
def standing():
    config = load("poppy")
    return config, load_model(config.robot)


@pytest.mark.parametrize("kind", list(PhaseKind))
@pytest.mark.parametrize("foot", list(Foot))
def test_every_row_of_the_standing_walk_is_its_definition(kind, foot):
    """On a tilted sole, on the way along the path, inside the bounds and beyond them."""
    config, model = standing()
    rng = np.random.default_rng(3)
    q_start = np.clip(posture(config, model) + 0.05 * rng.normal(size=model.n), model.q_min, model.q_max)
    goal = DQ.from_pose([0.05, 0.1 if foot is Foot.RIGHT else -0.1, 0.0], [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]).vec8()
    phase = make_phase(config, model, kind, foot, q_start, goal)
    above, below = phase.limits
    phase = dataclasses.replace(phase, limits=(above, dataclasses.replace(below, bound=0.05)))
    for elapsed in (0.0, 0.3, 0.7, 1.2, 1.5, np.inf):
        up = np.array([*(0.1 * rng.normal(size=2)), 1.0])
        q = q_start + 0.1 * rng.normal(size=model.n)
        kin = Kinematics(model, q, phase.base, up / np.linalg.norm(up), elapsed)
        problem = assemble(phase, kin, DT)
        H, c = phase.damping**2 * np.eye(model.n), np.zeros(model.n)
        for task in phase.tasks:
            J = task.jacobian(kin)
            H += task.weight * J.T @ J
            c -= task.weight * J.T @ task.wanted(kin, phase.eta)
        np.testing.assert_allclose(problem.H, H, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(problem.c, c, rtol=1e-11, atol=1e-12)
        for ours, rows in ((np.c_[problem.G, problem.h], phase.rows),):
            exact = np.concatenate([np.c_[vfi_rows(row, kin, DT)] for row in rows])
            np.testing.assert_allclose(ours, exact, rtol=1e-11, atol=1e-12)
        if phase.holds:  # the same rows, but for a rotation among them
            ours, exact = np.c_[problem.E, problem.e], np.c_[hold_rows(phase.holds[0], kin, DT)]
            np.testing.assert_allclose(ours.T @ ours, exact.T @ exact, rtol=1e-9, atol=1e-11)
            assert np.count_nonzero(np.abs(ours).max(axis=1)) == np.count_nonzero(np.abs(exact).max(axis=1))
        for bound, limit, sign in ((problem.upper, phase.limits[0], -1.0), (problem.lower, phase.limits[1], 1.0)):
            np.testing.assert_allclose(sign * bound, vfi_rows(limit, kin, DT)[1], rtol=1e-12)
        assert np.abs(problem.upper).max() > 0.5 >= -problem.upper.min()
        e = phase.tasks[0].error(kin)
        assert phase.error(kin) == pytest.approx(np.linalg.norm(e), rel=1e-11)


@pytest.mark.parametrize("rank", [0, 1, 3, 6])
def test_independent_rows_are_those_of_the_singular_values(rank):
    rng = np.random.default_rng(rank)
    E = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 15)) + 1e-4 * rng.normal(size=(6, 15)) * (rank < 6)
    e = rng.normal(size=6)
    U, s, V = np.linalg.svd(E, full_matrices=False)
    kept = s > DEPENDENT * s[0]
    exact = np.c_[(s * kept)[:, None] * V, np.where(kept, U.T @ e, 0.0)]
    independent(E, e)
    ours = np.c_[E, e]
    np.testing.assert_allclose(ours.T @ ours, exact.T @ exact, rtol=1e-9, atol=1e-12)
    off = E @ E.T
    assert np.abs(off - np.diag(np.diag(off))).max() < 1e-12 * max(np.abs(off).max(), 1e-9)
