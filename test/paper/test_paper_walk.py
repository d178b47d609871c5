"""Whole walks with the paper's gains: figures of section 5, Groenwall's bounds, exact solutions of their programs."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import short_config, short_walk
from robots import biped12, biped12_config, legs, mirrored
from walks import Segment, exact, paper_segments, paper_walk, problem_at, segments, walk

from dqwalk_ros.config import load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.qp import make_solver

TOLERANCE = 1e-5
"""The paper's own discretisation effect: m, m^2 for squared distances, rad."""

WALKS = [
    pytest.param("left", True, 1, id="left-flat"),
    pytest.param("right", True, 1, marks=pytest.mark.long, id="right-flat"),
    *(
        pytest.param(first, flat, cycles, marks=pytest.mark.long, id=name)
        for first in ("left", "right")
        for flat, cycles, name in ((True, 3, f"{first}-flat-3"), (False, 1, f"{first}-literal"))
    ),
]
"""First support foot, flat feet or the literal (8), cycles."""

pytestmark = pytest.mark.timeout(1800)
each_walk = pytest.mark.parametrize(("first", "flat", "cycles"), WALKS)


@each_walk
def test_every_phase_ends_by_its_switching_rule(first, flat, cycles):
    trace = paper_walk(first, flat, cycles)
    assert trace.finished, trace.notes
    assert trace.notes == ()
    other = {"left": "right", "right": "left"}[first]
    cycle = [f"{kind}_support/{foot}" for foot in (first, other) for kind in ("double", "single")]
    assert [record.name for record in trace.phases] == cycle * cycles
    config = trace.config
    for part in paper_segments(first, flat, cycles):
        assert part.time[-1] < config.gait.phase_timeout
        window = round(config.dsp.stall_window / config.dt)
        if part.phase.kind is PhaseKind.SINGLE_SUPPORT:
            assert part.error[-1] < config.ssp.threshold
            assert (part.error[:-1] >= config.ssp.threshold).all()  # and not later
        else:
            fall = part.error[:-window] - part.error[window:]
            assert fall[-1] < config.dsp.stall_rate
            assert part.error[-1] < config.ssp.com_radius
            inside = part.error[window:] < config.ssp.com_radius
            assert not ((fall < config.dsp.stall_rate) & inside)[:-1].any()


@each_walk
def test_each_swing_lands_five_centimetres_ahead(first, flat, cycles):
    nominal = abs(Kinematics(legs(), np.zeros(10), Foot.LEFT).point("r_sole")[1])
    for part in paper_segments(first, flat, cycles):
        if part.phase.kind is PhaseKind.SINGLE_SUPPORT:
            aside = -nominal if part.phase.base is Foot.LEFT else nominal
            landed = part.last.point(part.last.swing)
            assert np.linalg.norm(landed - [0.05, aside, 0.0]) < 2.1e-3
            up = part.last.direction(part.last.swing, np.array([0.0, 0.0, 1.0]))
            assert np.arccos(min(1.0, up[2])) < 2e-3  # and flat


def groenwall(part: Segment, name: str, dt: float) -> np.ndarray:
    """Return (1 - eta dt)^k d_0 for every tick and row."""
    d = {**part.distances, **part.equalities}[name]
    return (1.0 - part.rates[name] * dt) ** np.arange(len(d))[:, None] * d[0]


@each_walk
def test_distances_satisfy_groenwalls_inequality(first, flat, cycles):
    """No distance falls below its bound or faster than its rate allows; equalities converge at their rate."""
    for part in paper_segments(first, flat, cycles):
        for name, d in part.distances.items():
            assert d.min() >= -TOLERANCE, f"{part.phase.name}: {name} {d.min():.3g}"
            excess = (d - groenwall(part, name, 0.005)).min()
            assert excess >= -TOLERANCE, f"{part.phase.name}: {name} {excess:.3g}"
        for name, d in part.equalities.items():
            excess = np.abs(d - groenwall(part, name, 0.005)).max()
            assert excess <= TOLERANCE, f"{part.phase.name}: {name} {excess:.3g}"


@each_walk
def test_joint_limits_are_never_crossed(first, flat, cycles):
    trace = paper_walk(first, flat, cycles)
    assert (trace.q >= trace.model.q_min).all()
    assert (trace.q <= trace.model.q_max).all()
    assert np.abs(trace.u[:-1]).max() <= trace.model.velocity_max.min()


@each_walk
def test_the_walk_moves_forward(first, flat, cycles):
    """The CoM moves forward, although by much less than the steps: feet slide back in double support."""
    trace = paper_walk(first, flat, cycles)
    com = [
        DQ(record.x_odom_base).transform_point(Kinematics(trace.model, trace.q[tick], record.base).com)
        for record, tick in ((trace.phases[0], 0), (trace.phases[-1], -1))
    ]
    assert com[1][0] - com[0][0] > 0.01 * cycles
    for record in trace.phases:
        y = DQ(record.x_odom_base)
        np.testing.assert_allclose((y * y.conj()).vec8(), [1, 0, 0, 0, 0, 0, 0, 0], rtol=0, atol=1e-12)


# ---------------------------------------------------------------------- quadratic programs


LONG = [pytest.param(first, flat, 1, marks=pytest.mark.long) for first in ("left", "right") for flat in (True, False)]


@pytest.mark.parametrize(("first", "flat", "every"), [("left", True, 25), *LONG])
def test_solutions_along_a_walk_are_exact(first, flat, every):
    """KKT residuals are below 1e-9, and the exact solution agrees to 1e-9; every program of a phase's first second."""
    trace, solver, count = paper_walk(first, flat), make_solver("clarabel"), 0
    for part in paper_segments(first, flat, 1):
        for tick in [*part.ticks[:200], *part.ticks[200:-1:every]]:
            kin = Kinematics(trace.model, trace.q[tick], part.phase.base)
            problem = problem_at(part.phase, kin, trace.config.dt, trace.model.velocity_max)
            solution = solver.solve(problem)
            assert solution.residuals(problem).largest < 1e-9
            u = exact(problem)
            np.testing.assert_allclose(solution.u, u, rtol=0, atol=1e-9 * np.abs(u).max())
            # and the walk used this solution
            np.testing.assert_allclose(solution.u, trace.u[tick], rtol=0, atol=1e-9 * np.abs(u).max())
            count += 1
    assert count > 2000


# ---------------------------------------------------------------------- symmetry, other robots


def test_a_left_step_is_the_mirror_image_of_a_right_step():
    """The mirrored robot, starting on the other foot, has the same joint angles during a whole cycle."""
    trace, image = short_walk(), walk(short_config(**{"gait.first_support": "right"}), mirrored(legs()))
    cycle = [f"{kind}_support/{foot}" for foot in ("right", "left") for kind in ("double", "single")]
    assert [record.name for record in image.phases] == cycle
    assert [record.start for record in image.phases] == [record.start for record in trace.phases]
    np.testing.assert_allclose(image.q, trace.q, rtol=0, atol=1e-9)


def test_a_walk_is_reproducible():
    """Bitwise: it depends neither on a seed nor on the load of the machine."""
    again = walk(load("paper"), legs(), max_time=5.0)
    np.testing.assert_array_equal(again.q, paper_walk("left").q[: len(again)])


@pytest.mark.parametrize("first", ["left", pytest.param("right", marks=pytest.mark.long)])
def test_another_biped_walks_with_its_own_configuration(first):
    """A fictitious one: other names, six joints per leg, a fixed torso; with higher gains, for a short test."""
    config = biped12_config(**FAST, **{"gait.first_support": first})
    trace = walk(config, biped12())
    assert trace.finished, trace.notes
    assert len(trace.phases) == 4
    for part in segments(trace):
        for name, d in part.distances.items():
            assert d.min() >= -TOLERANCE, f"{part.phase.name}: {name} {d.min():.3g}"
        if part.phase.kind is PhaseKind.SINGLE_SUPPORT:
            assert part.last.point(part.last.swing)[0] == pytest.approx(0.05, abs=2.1e-3)
    assert (trace.q >= trace.model.q_min).all()
    assert (trace.q <= trace.model.q_max).all()


FAST = {"dt": 0.02, "task.eta": 0.3, "task.damping": 0.05}
