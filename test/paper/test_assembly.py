"""The quadratic program of a phase compared with its definition (U6), from values and Jacobians."""

from __future__ import annotations

import dataclasses
import pickle
from functools import cache

import numpy as np
import pytest
from walks import DT, KINDS, phase_of, problem_at, setting, values

from dqwalk_ros.config import load
from dqwalk_ros.paper.assembly import DEPENDENT
from dqwalk_ros.paper.constraints import Constraint, PointOverPlane
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMass, Point, Watched, affine, observe
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Plane
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.tasks import Posture
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.table import make_walk


def configurations(count, seed=0):
    model = setting()[1]
    return np.random.default_rng(seed).uniform(model.q_min, model.q_max, (count, model.n))


def vfi_rows(row, kin):
    """Return the vector-field inequality of one constraint, section 4."""
    d, J = values(row, kin)
    return J, np.minimum(-min(row.eta, 1.0 / DT) * (d - row.bound), row.return_speed)


def hold_rows(row, kin):
    """Return an equality, made linearly independent by its singular values, and its right-hand side as last column."""
    E, e = vfi_rows(row, kin)
    e = np.maximum(e, -row.return_speed)
    U, s, V = np.linalg.svd(E, full_matrices=False)
    kept = s > DEPENDENT * s[0]
    return np.c_[(s * kept)[:, None] * V, np.where(kept, U.T @ e, 0.0)]


def desired(task, e, rate, eta):
    """Return the desired e' less the rate by time: -eta e of (U6), with the norm of e saturated."""
    eta, norm = eta if task.eta is None else task.eta, np.linalg.norm(e)
    return -eta * (e if norm <= task.saturation else task.saturation * e / norm) - rate


def assert_equal(phase, kin, elapsed=np.inf):
    """Compare the program with (U6) as in the paper, from errors, rates, distances and Jacobians."""
    problem, n = problem_at(phase, kin, DT, elapsed=elapsed), kin.q.size
    H, c = phase.damping**2 * np.eye(n), np.zeros(n)
    for task in phase.tasks:
        (e, J), s = values(task, kin, elapsed), np.concatenate([feature.value(kin) for feature in task.watches])
        H += task.weight * J.T @ J
        c -= task.weight * J.T @ desired(task, e, task.evaluate(s, elapsed)[2], phase.eta)
    G = np.concatenate([np.c_[vfi_rows(row, kin)] for row in phase.inequalities])
    above, below = phase.limits
    pairs = {
        "H": (problem.H, H),
        "c": (problem.c, c),
        "G, h": (np.c_[problem.G, problem.h], G),
        "upper": (problem.upper, -vfi_rows(above, kin)[1]),
        "lower": (problem.lower, vfi_rows(below, kin)[1]),
    }
    for name, (ours, exact) in pairs.items():
        np.testing.assert_allclose(ours, exact, rtol=1e-11, atol=1e-12, err_msg=name)
    # equalities are the same up to an orthogonal transformation
    ours = np.c_[problem.E, problem.e]
    exact = np.concatenate([np.empty((0, n + 1)), *(hold_rows(row, kin) for row in phase.equalities)])
    np.testing.assert_allclose(ours.T @ ours, exact.T @ exact, rtol=1e-9, atol=1e-11)
    assert np.count_nonzero(np.abs(ours).max(axis=1)) == np.count_nonzero(np.abs(exact).max(axis=1))
    assert len(problem.names) == problem.e.size + problem.h.size + 2 * n
    error = np.linalg.norm(values(phase.tasks[0], kin, elapsed)[0])
    assert phase.assembly.error(kin, elapsed) == pytest.approx(error, rel=1e-12, abs=1e-15)
    return problem


@pytest.mark.parametrize(("kind", "foot"), KINDS)
def test_rows_match_their_definition(kind, foot):
    phase = phase_of(kind, foot)
    for q in configurations(25):
        assert_equal(phase, Kinematics(setting()[1], q, phase.base))


def test_velocity_limits_only_tighten_the_bounds():
    phase, limit = phase_of(*KINDS[0]), np.linspace(0.0, 3.0, setting()[1].n)
    limit[-1] = np.inf
    for q in configurations(5, seed=2):
        kin = Kinematics(setting()[1], 1.2 * q, phase.base)
        free, limited = problem_at(phase, kin, DT), problem_at(phase, kin, DT, limit)
        np.testing.assert_array_equal(limited.upper, np.clip(free.upper, -limit, limit))
        np.testing.assert_array_equal(limited.lower, np.clip(free.lower, -limit, limit))
        np.testing.assert_array_equal(limited.G, free.G)
        assert (limited.upper < free.upper).any()


@jit
def higher(s, a, elapsed):
    d, gradient, rate = affine(s, a, elapsed)
    return d - 0.01, gradient, rate


@jit
def rising(s, a, elapsed):
    d, gradient, rate = affine(s, a, elapsed)
    return d - 0.1 * elapsed, gradient, rate - 0.1


class Rising(PointOverPlane):
    """A plane that rises by 0.1 m/s."""

    function = rising


class Higher(PointOverPlane):
    """A user-defined constraint, which must not be evaluated as its parent class."""

    function = higher


@jit
def apart(s, a, elapsed):
    v, gradient = s[:3] - s[3:], np.zeros((2, 6))
    gradient[0, :3], gradient[0, 3:], gradient[1, 2] = 2.0 * v, -2.0 * v, 1.0
    return np.array([v @ v - 0.01, s[2]]), gradient, np.zeros(2)


class Apart(Constraint):
    """A user-defined constraint of two points with two rows."""

    function = apart

    @property
    def watches(self):
        return (Point("l_sole"), Point("r_sole"))

    def row_names(self, joint_names):
        return ("apart", "high")


@jit
def twice(s, a, elapsed):
    e, gradient, rate = affine(s, a, elapsed)
    return 2.0 * e, 2.0 * gradient, rate


class Twice(Posture):
    """A user-defined task."""

    function = twice


@pytest.mark.parametrize(("kind", "foot"), KINDS[::2])
def test_user_defined_tasks_and_constraints(kind, foot):
    phase = phase_of(kind, foot)
    plane = next(row for row in phase.inequalities if type(row) is PointOverPlane)
    own = Higher(name="own", eta=3.0, bound=0.02, point=plane.point, plane=plane.plane)
    apart, held = Apart(name="both", eta=1.0), dataclasses.replace(own, name="held")
    task = Twice(name="own", weight=0.3, q_ref=np.full(setting()[1].n, 0.2))
    mixed = dataclasses.replace(
        phase,
        inequalities=(own, *phase.inequalities, apart),
        equalities=(*phase.equalities, held),
        tasks=(*phase.tasks, task),
    )
    for q in configurations(5, seed=1):
        kin = Kinematics(setting()[1], q, phase.base)
        assert_equal(mixed, kin)
        plain, more = phase.distances(q), mixed.distances(q)
        assert more["own"] == pytest.approx(kin.point(plane.point.frame)[2] - plane.plane.d - 0.03)
        assert {name: more[name] for name in plain} == pytest.approx(plain)


@jit
def scalar(s, a, elapsed):
    return s[2], np.zeros((1, 3)), np.zeros(1)


class Scalar(PointOverPlane):
    """A constraint whose function returns a number instead of an array."""

    function = scalar


@jit
def flat(s, a, elapsed):
    return s[2:] - a[0], np.zeros((1, 2)), np.zeros(1)


class Flat(PointOverPlane):
    """A constraint whose gradient lacks a coordinate."""

    function = flat


class Nameless(Apart):
    """A constraint of two rows with one name."""

    def row_names(self, joint_names):
        return (self.name,)


def test_a_function_of_another_form_is_refused():
    phase = phase_of(*KINDS[0])
    row = phase.inequalities[-1]
    same = {"name": "own", "eta": 3.0, "point": row.point, "plane": row.plane}
    for wrong, error in (
        (Scalar(**same), "scalar is not of the type"),
        (Flat(**same), r"own: gradient .* \(1, 2\) and \(1,\), not \(1, 3\) and \(1,\)"),
        (Nameless(name="both", eta=1.0), "both has 2 distances, but names 1"),
    ):
        with pytest.raises((TypeError, ValueError), match=error):
            dataclasses.replace(phase, inequalities=(wrong,)).evaluate(phase.q_start)


def test_a_moving_bound_changes_the_right_hand_side():
    """The rate of a distance by time alone is not for the joints to provide: J u + rate >= -eta d."""
    phase = phase_of(*KINDS[0])
    rising = Rising(name="own", eta=3.0, point=Point("pelvis"), plane=Plane.through(np.zeros(3), [0.0, 0.0, 1.0]))
    phase = dataclasses.replace(phase, inequalities=(rising,))
    kin = Kinematics(setting()[1], phase.q_start, phase.base)
    assert problem_at(phase, kin, DT, elapsed=2.0).h[0] == pytest.approx(0.1 - 3.0 * (kin.point("pelvis")[2] - 0.2))


def test_a_feature_that_several_tasks_and_constraints_watch_is_computed_once():
    phase = phase_of(*KINDS[0])
    kin = Kinematics(setting()[1], phase.q_start, phase.base)
    point = Point("pelvis", np.array([0.01, 0.02, 0.03]))
    over = [
        PointOverPlane(name=name, eta=1.0, point=point, plane=Plane.through(np.zeros(3), normal))
        for name, normal in (("one", [0.0, 0.0, 1.0]), ("other", [1.0, 0.0, 0.0]))
    ]
    watched, columns = Watched.of([[CenterOfMass(), point], *(one.watches for one in over), [CenterOfMass()]], kin.tree)
    assert columns == [slice(0, 6), slice(3, 6), slice(3, 6), slice(0, 3)]
    observe(kin.bodies, watched)
    np.testing.assert_allclose(watched.s, [*kin.com, *kin.point("pelvis", point.offset)], atol=1e-15)


def test_joint_angles_may_be_read_only_or_a_part_of_another_array():
    phase = phase_of(*KINDS[0])
    q = configurations(1)[0]
    fixed = q.copy()
    fixed.flags.writeable = False
    for one in (fixed, np.repeat(q, 2)[::2]):
        np.testing.assert_array_equal(phase.evaluate(one).values, phase.evaluate(q).values)


def test_a_later_tick_does_not_change_an_earlier_problem():
    phase = phase_of(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT)
    q, other = configurations(2)
    model = setting()[1]
    problem = problem_at(phase, Kinematics(model, q, phase.base), DT)
    before = problem.numbers.copy()
    problem_at(phase, Kinematics(model, other, phase.base), DT)
    np.testing.assert_array_equal(problem.numbers, before)


def test_a_phase_can_be_pickled():
    phase = phase_of(PhaseKind.SINGLE_SUPPORT, Foot.RIGHT)
    kin = Kinematics(setting()[1], configurations(1)[0], phase.base)
    H = problem_at(phase, kin, DT).H
    np.testing.assert_array_equal(problem_at(pickle.loads(pickle.dumps(phase)), kin, DT).H, H)


@cache
def standing():
    config = load("poppy")
    return config, load_model(config.robot)


@pytest.mark.parametrize("kind", list(PhaseKind))
@pytest.mark.parametrize("foot", list(Foot))
def test_rows_of_the_standing_walk_match_their_definition(kind, foot):
    """On a tilted sole, at several times along the path, inside and outside the bounds."""
    config, model = standing()
    rng = np.random.default_rng(3)
    q = model.posture(config.standing.posture) + 0.05 * rng.normal(size=model.n)
    q_start = np.clip(q, model.q_min, model.q_max)
    goal = DQ.from_pose([0.05, 0.1 if foot is Foot.RIGHT else -0.1, 0.0], [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]).vec8()
    phase = make_walk(config, model).phase(kind, foot, q_start, goal)
    above, below = phase.limits
    phase = dataclasses.replace(phase, limits=(above, dataclasses.replace(below, bound=0.05)))
    for elapsed in (0.0, 0.3, 0.7, 1.2, 1.5, np.inf):
        up = np.array([*(0.1 * rng.normal(size=2)), 1.0])
        q = q_start + 0.1 * rng.normal(size=model.n)
        kin = Kinematics(model, q, phase.base, up / np.linalg.norm(up))
        problem = assert_equal(phase, kin, elapsed)
        assert np.abs(problem.upper).max() > 0.5 >= -problem.upper.min()
        e, _ = values(phase.tasks[0], kin, elapsed)
        assert phase.evaluate(kin.q, kin.up, elapsed).error == pytest.approx(np.linalg.norm(e), rel=1e-11)
