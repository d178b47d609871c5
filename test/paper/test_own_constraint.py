"""A user-defined constraint appears in the rows, the monitor, the report and on the page, by configuration alone."""

from __future__ import annotations

import numpy as np
import pytest

from dqwalk_ros import KinematicPlant, Kinematics, load, load_model, make_controller, simulate
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.report import analyse, report
from dqwalk_ros.report.scene import Moments, Scene
from dqwalk_ros.report.verdict import Assessor

CONFIG = load("paper").updated({"gait.walk": "own_walk:HighWalk"})
MODEL = load_model(CONFIG.robot)


@pytest.fixture(scope="module")
def walked():
    controller = make_controller(CONFIG, MODEL)
    return controller, simulate(controller, KinematicPlant(MODEL), max_time=0.2)


def test_the_constraint_is_a_row_of_the_quadratic_program(walked):
    controller, trace = walked
    problem = controller.problem
    row = problem.names.index("com_above") - problem.e.size
    kin = Kinematics(MODEL, trace.q[-1], controller.phase.base)
    np.testing.assert_allclose(problem.G[row], kin.com_jacobian[2], atol=1e-15)
    assert problem.h[row] == pytest.approx(-5.0 * (kin.com[2] - 0.25), abs=1e-12)


def test_the_report_and_the_monitor_evaluate_the_constraint(walked):
    _, trace = walked
    series = analyse(trace)
    np.testing.assert_allclose(series.distances["com_above"], series.com[:, 2] - 0.25, atol=1e-15)
    assert "com_above" in str(report(series))
    kin = Kinematics(MODEL, trace.q[-1], trace.phases[0].base)
    values = Assessor(CONFIG, MODEL, trace.phases[0].phase(CONFIG, MODEL))(kin, 0.2).values
    assert values["distance/com_above"] == pytest.approx(kin.com[2] - 0.25)


def test_the_report_and_the_monitor_know_where_a_moving_obstacle_is():
    config = CONFIG.updated({"gait.walk": "own_walk:AroundABall"})
    trace = simulate(make_controller(config, MODEL), KinematicPlant(MODEL), max_time=1.0)
    series = analyse(trace)
    away = np.linalg.norm(series.com - [0.3, 0.0, 0.3] + np.outer(trace.time, [0.1, 0.0, 0.0]), axis=1) - 0.1
    np.testing.assert_allclose(series.distances["ball"], away, atol=1e-12)
    assert report(series)["walk"]["bounds"]["lean"]["distance"]["value"] > 0.0
    kin = Kinematics(MODEL, trace.q[-1], trace.phases[0].base)
    values = Assessor(config, MODEL, trace.phases[0].phase(config, MODEL))(kin, trace.time[-1]).values
    assert values["distance/ball"] == pytest.approx(away[-1])


def test_the_page_shows_the_constraint(walked):
    _, trace = walked
    view = Scene(CONFIG, MODEL).look(Moments(trace).at(20))
    gauge = next(gauge for gauge in view.gauges if gauge.name == "com_above")
    assert (gauge.title, gauge.color) == ("CoM over the table", (1, 2, 3))
    drawn = next(one for one in view.regions if one.name == "com_above")
    assert drawn.color == (1, 2, 3)
    assert drawn.region.size == (0.3, 0.2)
    base = view.moment.x_odom_base
    np.testing.assert_allclose(DQ(drawn.region.pose).translation()[2] - DQ(base).translation()[2], 0.25, atol=1e-12)


def test_a_phase_of_its_own_is_judged_by_its_own_rule():
    config = CONFIG.updated({"gait.walk": "own_walk:StandingFirst"})
    trace = simulate(make_controller(config, MODEL), KinematicPlant(MODEL), max_time=0.2)
    assert [phase.name for phase in trace.phases] == ["stance/left", "double_support/left"]
    found = report(analyse(trace))
    assert "foot's centre" not in str(found["violations"])  # a stance does not transfer the CoM
