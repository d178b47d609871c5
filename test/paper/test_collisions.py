"""Distances between moving parts, compared with other formulas and solvers, and a foot that they hold back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from dqwalk_ros import KinematicPlant, Kinematics, cli, load, load_model
from dqwalk_ros.paper.collisions import (
    AxisInCone,
    Capsule,
    PointOutsideSphere,
    PointOverMovingPlane,
    capsules_apart,
    capsules_in,
    closest_on_segments,
    lines_apart,
    outside_line,
    segments_apart,
)
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Direction, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.robot.shapes import capsule_around
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.table import make_controller, make_walk

MODEL = load_model(load("paper").robot)
SHIN = "0.0 0.0 -0.02 0.0 0.0 -0.15 0.03"


def generators(count=50):
    return map(np.random.default_rng, range(count))


def gradient_of(function, s, a):
    """Central differences of a distance."""
    h, out = 1e-6, np.empty(len(s))
    for i in range(len(s)):
        e = np.zeros(len(s))
        e[i] = h
        out[i] = (function(s + e, a, 0.0)[0][0] - function(s - e, a, 0.0)[0][0]) / (2.0 * h)
    return out


# ---------------------------------------------------------------------- segments


def segments(rng, kind):
    a, b, c, d = rng.normal(size=(4, 3))
    if kind == "parallel":
        d = c + rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0) * (b - a)
    elif kind == "a point":
        d = c
    elif kind == "points":
        b, d = a, c
    elif kind == "crossing":
        middle = a + rng.uniform(0.2, 0.8) * (b - a)
        c, d = middle - 0.5 * (d - c) + 0.01, middle + 0.5 * (d - c) + 0.01
    return np.concatenate([a, b, c, d])


@pytest.mark.parametrize("kind", ["any", "parallel", "a point", "points", "crossing"])
def test_segments_have_the_distance_that_a_bounded_least_squares_solver_finds(kind):
    for rng in generators():
        s = segments(rng, kind)
        a, b, c, d = s.reshape(4, 3)
        A = np.column_stack([b - a, c - d])
        expected = np.linalg.norm(A @ lsq_linear(A, c - a, (0.0, 1.0), tol=1e-14).x - (c - a))
        assert capsules_apart(s, np.array([0.3]), 0.0)[0][0] == pytest.approx(expected - 0.3, abs=1e-8)
        assert segments_apart(s.reshape(2, 6), np.array([[1, 0]]))[0] == pytest.approx(expected, abs=1e-8)
        assert all(0.0 <= fraction <= 1.0 for fraction in closest_on_segments(s))


@pytest.mark.parametrize("kind", ["any", "a point", "points", "crossing"])
def test_the_gradient_of_segments_is_that_of_their_distance(kind):
    """Of a segment without length both ends move together."""
    ends = {"a point": [0, 1, 2, 2], "points": [0, 0, 1, 1]}.get(kind, [0, 1, 2, 3])
    together = np.kron((np.array(ends)[:, None] == np.unique(ends)).astype(float), np.eye(3))
    for rng in generators():
        s, a = segments(rng, kind), np.array([0.1])
        x = np.linalg.pinv(together) @ s
        expected = gradient_of(lambda x, a, t: capsules_apart(together @ x, a, t), x, a)
        np.testing.assert_allclose(capsules_apart(s, a, 0.0)[1][0] @ together, expected, atol=1e-6)


def test_the_distance_of_parallel_segments_falls_along_its_gradient():
    """Where several points are the closest ones, the distance has directions of descent only."""
    for rng in generators():
        s = segments(rng, "parallel")
        d, gradient, _ = capsules_apart(s, np.zeros(1), 0.0)
        further = capsules_apart(s - 1e-4 * gradient[0], np.zeros(1), 0.0)[0]
        assert further[0] < d[0]


def test_segments_that_meet_are_in_contact_without_a_direction():
    s = np.array([-1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0])
    d, gradient, _ = capsules_apart(s, np.array([0.05]), 0.0)
    assert d[0] == -0.05
    assert not gradient.any()


# ---------------------------------------------------------------------- lines


def lines(rng):
    p, l, q, k = rng.normal(size=(4, 3))
    return np.concatenate([p, l / np.linalg.norm(l), q, k / np.linalg.norm(k)])


def test_lines_have_the_distance_of_the_common_normal():
    for rng in generators():
        s = lines(rng)
        n = np.cross(s[3:6], s[9:])
        expected = abs((s[:3] - s[6:9]) @ n) / np.linalg.norm(n)
        assert lines_apart(s, np.array([0.2]), 0.0)[0][0] == pytest.approx(expected - 0.2, abs=1e-9)


def test_parallel_lines_have_the_distance_of_a_point_of_one():
    for rng in generators():
        s = lines(rng)
        s[9:] = rng.choice([-1.0, 1.0]) * s[3:6]
        expected = np.linalg.norm(np.cross(s[:3] - s[6:9], s[3:6]))
        assert lines_apart(s, np.zeros(1), 0.0)[0][0] == pytest.approx(expected, abs=1e-9)
        assert outside_line(s[[0, 1, 2, 6, 7, 8, 9, 10, 11]], np.zeros(1), 0.0)[0][0] == pytest.approx(expected)


# ---------------------------------------------------------------------- cone, sphere


@pytest.mark.parametrize("angle", [0.3, 0.5 * math.pi, math.pi])
def test_the_margin_of_a_cone_is_the_angle_left(angle):
    cone = AxisInCone(
        name="c", eta=1.0, axis=Direction("pelvis", np.eye(3)[2]), center=np.array([0.0, 0.0, 1.0]), angle=angle
    )
    for lean in (0.0, 0.2, 1.5, 3.0, math.pi):
        s = np.array([math.sin(lean), 0.0, math.cos(lean)])
        assert cone.margin(float(cone.evaluate(s)[0][0])) == pytest.approx(angle - lean, abs=1e-6)


def test_the_residual_of_a_moving_sphere_is_the_rate_of_the_distance_of_a_resting_point():
    for rng in generators(10):
        center, velocity, s = rng.normal(size=(3, 3))
        sphere = PointOutsideSphere(
            name="s", eta=1.0, point=Point("pelvis"), center=center, velocity=velocity, radius=0.1
        )
        h = 1e-6
        rate = (sphere.evaluate(s, 0.5 + h)[0][0] - sphere.evaluate(s, 0.5 - h)[0][0]) / (2.0 * h)
        assert sphere.evaluate(s, 0.5)[2][0] == pytest.approx(rate, abs=1e-7)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3)])
def test_the_region_of_a_plane_of_the_robot_faces_along_its_normal(axis):
    """Also downwards, where the shortest rotation from z is not unique."""
    plane = PointOverMovingPlane(
        name="p", eta=1.0, point=Point("l_sole"), origin=Point("pelvis"), normal=Direction("pelvis", axis)
    )
    kin = Kinematics(MODEL, np.zeros(MODEL.n), Foot.LEFT)
    found = DQ(plane.region(kin).pose).rotation_matrix()[:, 2]
    np.testing.assert_allclose(found, plane.normal.value(kin), atol=1e-9)


# ---------------------------------------------------------------------- capsules of a robot


def test_a_capsule_contains_the_points_around_which_it_is():
    for rng in generators(20):
        points = rng.normal(size=(40, 3)) * rng.uniform(0.1, 2.0, 3)
        a, b, radius = capsule_around(points)
        t = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0.0, 1.0)
        assert np.linalg.norm(points - a - t[:, None] * (b - a), axis=1).max() <= radius + 1e-9


def test_a_capsule_is_found_again():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points = 0.03 * directions + np.where(directions[:, 2:] > 0.0, [[0.1, 0.0, 0.4]], [[0.1, 0.0, 0.0]])
    a, b, radius = capsule_around(points)
    assert radius == pytest.approx(0.03, rel=0.05)
    assert np.linalg.norm(b - a) == pytest.approx(0.4, rel=0.05)


def apart(**changes):
    values = {"collision.pairs": ("l_shin=r_shin",), "collision.capsules": (f"l_shin={SHIN}", f"r_shin={SHIN}")}
    return load("paper").updated(values | {name.replace("__", "."): value for name, value in changes.items()})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"collision__pairs": ("l_shin=r_chin",)}, "the robot has no link 'r_chin'"),
        ({"collision__capsules": (f"l_shin={SHIN}",)}, "capsules has no 'r_shin'; `dqwalk config CONFIG --capsules`"),
        ({"collision__capsules": ("l_shin=0 0 1",)}, "it must be LINK=ax ay az bx by bz radius"),
        ({"collision__pairs": ("l_shin=l_shin",)}, "which move against each other"),
    ],
)
def test_entries_that_are_not_valid_are_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        capsules_in(apart(**changes), MODEL)


def test_only_a_pair_that_is_near_has_a_row():
    q = np.zeros(MODEL.n)

    def evaluated(near, **limits):
        kind, support = PhaseKind.DOUBLE_SUPPORT, Foot.LEFT
        return make_walk(apart(collision__near=near), MODEL).phase(kind, support, q).evaluate(q, dt=0.005, **limits)

    plain = make_walk(load("paper"), MODEL).phase(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT, q).evaluate(q, dt=0.005)
    far = evaluated(1e-3)
    distance = far.distances()["apart_l_shin_r_shin"]  # which monitor and report see, too
    assert distance > 1e-3
    for one, other in zip(far.problem, plain.problem, strict=True):
        np.testing.assert_array_equal(one, other)
    reach = 0.005 * np.abs(far.J[far.assembly.task_rows :][far.assembly.rows.spans["apart_l_shin_r_shin"]]).sum()
    for speed, rows in ((0.9 * distance / reach, 0), (1.1 * distance / reach, 1)):  # it could touch within a period
        limited = evaluated(1e-3, velocity=np.full(MODEL.n, speed))
        assert len(limited.problem.w) == len(plain.problem.w) + rows
    near = evaluated(distance + 1e-3)
    assert set(near.problem.names) - set(far.problem.names) == {"apart_l_shin_r_shin"}
    row = near.problem.names.index("apart_l_shin_r_shin")
    assert near.problem.w[row] == pytest.approx(-load("paper").collision.eta * distance)
    np.testing.assert_array_equal(near.problem.W[row], near.J[near.assembly.task_rows + row])


def test_shins_that_a_step_would_bring_together_stay_apart_at_every_tick():
    quick = {"task.eta": 1.0, "ssp.threshold": 0.02, "dsp.stall_rate": 0.003}
    narrow = load("paper").updated(quick | {"gait.step_length": 0.02, "gait.step_width": 0.02})
    kept = narrow.updated(
        {name: value for name, value in apart(collision__margin=0.07).flat().items() if "collision" in name}
    )
    (pair,) = capsules_in(kept, MODEL)
    least = []
    for config in (narrow, kept):
        trace = simulate(make_controller(config, MODEL), KinematicPlant(MODEL), max_time=5.0)
        found = []
        for q in trace.q[::20]:
            kin = Kinematics(MODEL, q, Foot.LEFT)
            found.append(pair.evaluate(np.concatenate([end.value(kin) for end in pair.watches]))[0][0])
        least.append(min(found))
    assert least[0] < 0.067
    assert least[1] == pytest.approx(0.07, abs=1e-6)


def test_the_command_prints_capsules_that_the_configuration_accepts(capsys):
    words = ["config", "poppy", "--set", "collision.pairs=[l_shin=r_shin, l_thigh=r_thigh]"]
    assert cli.main([*words, "--capsules"]) == 0
    printed = [line.split('"')[1] for line in capsys.readouterr().out.splitlines() if '"' in line]
    assert [one.partition("=")[0] for one in printed] == ["l_shin", "r_shin", "l_thigh", "r_thigh"]
    config = load("poppy").updated(
        {"collision.pairs": ("l_shin=r_shin", "l_thigh=r_thigh"), "collision.capsules": tuple(printed)}
    )
    model = load_model(config.robot)
    kin = Kinematics(model, np.zeros(model.n), Foot.LEFT)
    for constraint in capsules_in(config, model):
        s = np.concatenate([one.value(kin) for one in constraint.watches])
        assert constraint.evaluate(s)[0][0] > 0.0
    assert isinstance(constraint.one, Capsule)
