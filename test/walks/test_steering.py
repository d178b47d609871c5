"""Steering of a walk: course, limits, waiting, stopping; recording and checks of the physics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros import report as reporting
from dqwalk_ros.cli import main
from dqwalk_ros.config import overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.base import upward
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.report.viewer.page import _COURSES
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.course import Course, Leg, speeds
from dqwalk_ros.walks.standing.walk import StandingWalk
from dqwalk_ros.walks.table import make_controller, walk_type

CONFIG = dq.load("poppy").updated({"gait.steps": 0})
MODEL = dq.load_model(CONFIG.robot)
PERIOD = CONFIG.standing.transfer_duration + CONFIG.standing.swing_duration


def test_a_course_is_parsed_and_followed_in_order() -> None:
    course = Course.parse(["0.01,0,0.02,30", "-0.01,0.001,0,5"])
    assert course.legs == (Leg(0.01, 0.0, 0.02, 30.0), Leg(-0.01, 0.001, 0.0, 5.0))
    assert course.duration == 35.0
    assert course.at(29.9) == (0.01, 0.0, 0.02)
    assert course.at(30.0) == (-0.01, 0.001, 0.0)
    assert course.at(35.0) is None
    for text in ("0.01,0,0.02", "a,0,0,1", "0,0,0,0", "0,0,inf,1", "nan,0,0,1", ""):
        with pytest.raises(ConfigError, match="--cmd-vel needs"):
            Course.parse([text])


@pytest.mark.parametrize(
    "requested",
    [(1.0, 0.0, 0.0), (-1e200, 0.0, 0.0), (0.0, 0.0, 1.7e308), (0.3, 0.2, -1.0), (1.7e308, 1.7e308, -1e308)],
)
def test_cmd_vel_is_clamped_to_the_reach_of_the_legs(requested: tuple[float, float, float]) -> None:
    g = CONFIG.gait
    walked = np.array(StandingWalk(CONFIG, MODEL).steer(*requested)) * PERIOD
    most = np.array([g.most_length, g.most_side, g.most_turn])
    part = np.divide(walked, most, out=np.zeros(3), where=most > 0.0)
    assert np.linalg.norm(part) == pytest.approx(1.0)  # exactly the maximum
    assert (np.sign(walked) * np.sign(requested) >= 0.0).all()
    if most[1] == 0.0:
        assert walked[1] == 0.0


@pytest.mark.parametrize("name", ["poppy", "poppy_dynamic", "poppy_dynamic_50hz"])
def test_the_largest_velocities_are_walked_and_no_larger_ones(name: str) -> None:
    config = dq.load(name).updated({"gait.steps": 0})
    walk = walk_type(config)(config, MODEL)
    fastest = np.array(speeds(walk))
    assert (fastest[[0, 2]] > 0.0).all()
    for axis in np.eye(3):
        np.testing.assert_allclose(walk.steer(*(axis * fastest)), axis * fastest, rtol=1e-9)
        np.testing.assert_allclose(walk.steer(*(1.1 * axis * fastest)), axis * fastest, rtol=1e-9)
    for way in _COURSES.values():  # those of the page are walked as chosen
        np.testing.assert_allclose(walk.steer(*(way * fastest)), way * fastest, rtol=1e-9)


def test_cmd_vel_within_the_reach_of_the_legs_is_not_changed() -> None:
    requested = 0.4 * CONFIG.gait.most_length / PERIOD, 0.0, 0.4 * CONFIG.gait.most_turn / PERIOD
    assert StandingWalk(CONFIG, MODEL).steer(*requested) == pytest.approx(requested)


def test_a_steered_walk_waits_walks_and_stops_with_the_feet_together() -> None:
    controller, plant = make_controller(CONFIG, MODEL), make_plant("integrator", CONFIG, MODEL)
    names: list[str] = []
    poses: list[np.ndarray] = []

    def pilot(time: float) -> None:
        if controller.phase_index >= len(names):
            names.append(controller.phase.name)
        if names:
            soles = controller.soles()
            poses.append(np.concatenate([DQ(soles[foot]).translation() for foot in Foot]))
        if time < 2.0:
            controller.steer(0.0, 0.0, 0.0)
        elif len(names) < 3:
            controller.steer(0.01, 0.0, 0.0)
        elif names[-1].startswith("stance"):
            controller.stop()
        else:
            controller.steer(0.0, 0.0, 0.0)

    trace = simulate(controller, plant, before_step=pilot, max_time=30.0)
    assert trace.finished, trace.notes
    kinds = [record.kind for record in trace.phases]
    double, single = PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT
    assert kinds == [PhaseKind.STANCE, double, single, PhaseKind.STANCE] or kinds == [
        PhaseKind.STANCE, double, single, double, single, PhaseKind.STANCE,
    ]  # fmt: skip
    assert trace.phases[1].time >= 2.0  # it waited longer than the stance requires
    jumps = np.linalg.norm(np.diff(poses, axis=0), axis=1)
    assert jumps.max() < 0.2 * CONFIG.dt  # odometry is continuous where the base changes


def test_steering_or_stopping_a_walk_without_steering_is_an_error() -> None:
    counted = make_controller(CONFIG.updated({"gait.steps": 2}), MODEL)
    with pytest.raises(ConfigError, match=r"gait\.steps: 0"):
        counted.steer(0.01, 0.0, 0.0)
    config = dq.load("paper")
    with pytest.raises(ConfigError, match="pause"):
        make_controller(config, dq.load_model(config.robot)).stop()


def test_the_up_vector_is_independent_of_yaw() -> None:
    r = np.random.default_rng(3).normal(size=4)
    r /= np.linalg.norm(r)
    up = DQ.from_pose([0.0, 0.0, 0.0], r).rotation_matrix()[2]
    assert upward(*(1.0001 * r)) == pytest.approx(up, abs=1e-12)
    yaw = np.array([np.cos(0.4), 0.0, 0.0, np.sin(0.4)])
    assert upward(*(DQ(yaw) * DQ(r)).vec4()) == pytest.approx(up, abs=1e-12)


@pytest.fixture(scope="module")
def short():
    """Return 1.6 s in physics, the first double support."""
    config = overlaid(dq.load("poppy"), "physics").updated({"gait.steps": 1})
    return simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL), max_time=1.6)


def test_reading_the_true_state_does_not_change_the_simulation() -> None:
    config = CONFIG.updated({"gait.steps": 1})
    ends = []
    for look in (False, True):
        controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
        for _ in range(40):
            plant.step(controller.step(plant.state, config.dt), config.dt)
            if look:
                assert np.isfinite(plant.truth.cop).all()
                assert np.linalg.norm(plant.inertial.acceleration) == pytest.approx(9.81, abs=1.5)
        ends.append(plant.state.q)
    assert (ends[0] == ends[1]).all()


def test_a_bag_contains_the_physics_data(short, tmp_path: Path) -> None:
    bag.write(short, tmp_path / "bag")
    read = bag.read(tmp_path / "bag")
    assert read.physics is not None
    for name in ("pelvis", "cop", "orientation", "gyro", "acceleration"):
        np.testing.assert_allclose(getattr(read.physics, name), getattr(short.physics, name), rtol=0.0, atol=1e-15)
    for foot in Foot:
        assert (read.physics.wrenches[foot] == short.physics.wrenches[foot]).all()


def test_the_report_contains_the_balance_of_the_walk(short) -> None:
    report = reporting.report(reporting.analyse(short))
    assert [one["what"] for one in report["violations"]] == ["finished"]  # the walk was stopped early
    of = report["physics"]
    assert of["cop_inside"] == 1.0
    assert 0.0 <= of["tilt"]["value"] < np.radians(0.5)
    assert not of["fallen"]
    text = reporting.render(report)
    assert "inside the support polygon in 100.00 % of ticks" in text


def tampered(trace, **changes):
    return dataclasses.replace(trace, physics=dataclasses.replace(trace.physics, **changes))


def violated(trace) -> set[str]:
    return {violation["what"] for violation in reporting.report(reporting.analyse(trace))["violations"]}


def test_the_report_detects_a_loss_of_balance(short) -> None:
    """A centre of pressure 20 cm outside on 2 % of the ticks, a sole tilted by 3 degrees, a robot on its knees."""
    n = len(short)
    cop = short.physics.cop.copy()
    cop[: n // 50 + 1, 0] += 0.2
    assert violated(tampered(short, cop=cop)) == {"cop", "finished"}
    cop[:] = np.nan
    in_the_air = {foot: np.zeros_like(wrench) for foot, wrench in short.physics.wrenches.items()}
    assert "cop" in violated(tampered(short, cop=cop, wrenches=in_the_air))
    lean = DQ([np.cos(np.radians(1.5)), np.sin(np.radians(1.5)), 0.0, 0.0])
    pelvis = short.physics.pelvis.copy()
    pelvis[n // 2] = (lean * DQ(pelvis[n // 2])).vec8()
    assert "tilt" in violated(tampered(short, pelvis=pelvis))
    q = short.physics.q.copy()
    q[-20:] = short.model.posture(["?_hip_y=-1.7", "?_knee_y=2.3", "?_ankle_y=-0.6"])
    assert "fallen" in violated(tampered(short, q=q))


def test_an_invalid_course_is_a_command_line_error(tmp_path: Path, capsys) -> None:
    arguments = ["simulate", "--config", "poppy", "--cmd-vel", "far", "--out", str(tmp_path / "walk")]
    assert main(arguments) == 2
    assert "--cmd-vel needs" in capsys.readouterr().err
    assert not (tmp_path / "walk" / "bag").exists()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_cmd_vel_leads_the_robot_around_a_circle_in_physics(tmp_path: Path) -> None:
    out = tmp_path / "circle"
    arguments = ["simulate", "--config", "poppy", "--plant", "physics", "--cmd-vel", "0.012,0,0.037,172"]
    assert main([*arguments, "--out", str(out), "--quiet"]) == 0
    of = reporting.report(reporting.analyse(bag.read(out / "bag")))["physics"]
    assert of["turned"] > np.radians(340.0)
    assert of["circle"]["radius"] == pytest.approx(0.012 / 0.037, rel=0.1)
