"""The whole-body controller in closed loop with rigid bodies on rigid ground."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from exactness import checked_walk

from dqwalk_ros.config import load
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError, ModelError, PlantError, StateError
from dqwalk_ros.whole_body import Scenario, WholeBodyController, WholeBodyTrace, follow
from dqwalk_ros.whole_body.dynamics import Multibody
from dqwalk_ros.whole_body.equations import friction_edges, joint_bounds
from dqwalk_ros.whole_body.experiments import walk
from dqwalk_ros.whole_body.objectives import FrameOutsideSphere, FramePosition
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

CONFIG = load("whole_body")
MODEL = load_model(CONFIG.robot)
TARGET = ((0.0, (1.2, -0.8, 0.9)),)


@cache
def reached() -> WholeBodyTrace:
    """Return a walk in place until a target appears during a swing, at 0.8 s."""
    return walk(CONFIG, Scenario("short", 2.0, ((0.8, TARGET[0][1]),)))


def assert_limits(walked: WholeBodyTrace) -> None:
    """Assert that level 1 holds on every tick, with the contact forces of the plant."""
    assert walked.stood, walked.note
    for name in ("cop_margin", "friction", "normal", "torque", "joint", "step"):
        least = -1e-5 if name == "joint" else -1e-6  # (S9) has the error of the integration and of impacts
        assert walked.margins[name].min() > least, name
    assert walked.residual.max() < 1e-6
    assert walked.violation.max() == 0.0


def test_every_solution_is_exact() -> None:
    """Levels 1 and 2 hold to 1e-8, and the accelerations equal those of Clarabel to 1e-3 rad/s^2; with a push."""
    _, answers = checked_walk(CONFIG, Scenario("short", 0.65, TARGET, ((0.495, (0.0, 10.0, 0.0)),)))
    assert answers.sampled >= 6
    assert max(answers.equality, answers.inequality) < 1e-8
    assert answers.acceleration < 1e-3


def test_the_robot_walks_towards_the_target() -> None:
    walked = reached()
    assert_limits(walked)
    assert walked.error[-1] < walked.error[walked.at(0.9)] - 0.3
    assert len(walked.footholds()) == 3  # the first stance foot and two steps
    assert np.abs(walked.height_error).max() < 1e-3
    assert walked.tilt.max() < 0.02
    assert walked.effort.std(axis=0).max() > 1.0


def test_a_landing_between_two_ticks_costs_no_torque() -> None:
    """The first step ends 1.4 ms after a tick, so that gains of the raw remaining time would amplify errors by 11."""
    config = CONFIG.updated({"dt": 0.0047})
    walked = walk(config, Scenario("between", 1.15, TARGET))
    assert len(walked.footholds()) == 2
    assert_limits(walked)


def test_the_next_footstep_follows_the_target_at_once() -> None:
    """The target appears during a swing: the landing position planned in the same tick changes."""
    walked = reached()
    i = walked.at(0.8) + 1
    assert walked.time[i] == pytest.approx(0.8)
    assert walked.single[i]
    usual = np.abs(np.diff(walked.landing[i - 10 : i], axis=0)).max()
    assert np.linalg.norm(walked.landing[i] - walked.landing[i - 1]) > 5.0 * usual + 1e-3


def test_the_contact_forces_of_the_plant_match_the_plan() -> None:
    """From the torques alone the plant computes the accelerations and contact wrenches of the controller's plan."""
    controller = WholeBodyController(CONFIG, MODEL)
    plant = RigidPlant(MODEL, controller.start, pushed="chest")
    controller.reach(TARGET[0][1])
    for _ in range(120):
        before = plant.state
        command = controller.step(before, CONFIG.dt)
        after = plant.step(command, CONFIG.dt)
        for foot, wrench in controller.last.wrenches.items():
            assert plant.wrenches[foot] == pytest.approx(wrench, abs=1e-4)
        assert after.v == pytest.approx(before.v + CONFIG.dt * controller.last.answer.x[: len(before.v)], abs=1e-7)


def test_a_push_obeys_the_law_of_impact() -> None:
    """(S23), (S24): both feet keep still, and the momentum that is missing went through them."""
    controller = WholeBodyController(CONFIG, MODEL)
    plant = RigidPlant(MODEL, controller.start, pushed="chest")
    body = Multibody(MODEL, ("chest", "L_sole", "R_sole"))
    before = plant.state
    plant.push([0.0, 15.0, 0.0])
    after = plant.state
    d = body.at(after.x_base, after.q, after.v)
    assert d.frames["L_sole"].velocity == pytest.approx(np.zeros(6), abs=1e-9)
    assert d.frames["R_sole"].velocity == pytest.approx(np.zeros(6), abs=1e-9)
    assert d.com_velocity[1] > 0.05
    J = np.vstack([d.frames["L_sole"].jacobian, d.frames["R_sole"].jacobian])
    missing = d.H @ (after.v - before.v) - d.frames["chest"].jacobian[:3].T @ [0.0, 15.0, 0.0]
    impulse = np.linalg.lstsq(J.T, missing, rcond=None)[0]
    assert J.T @ impulse == pytest.approx(missing, abs=1e-8)


def test_without_the_balance_level_the_robot_falls() -> None:
    """Negative control: without the second level the robot falls within two seconds."""
    walked = walk(CONFIG.updated({"whole_body.capturability": False}), Scenario("no balance", 2.0, TARGET))
    assert not walked.stood
    assert walked.time[-1] < 2.0


@cache
def in_place() -> WholeBodyTrace:
    return walk(CONFIG, Scenario("in place", 1.35))


def test_without_a_target_the_robot_walks_in_place() -> None:
    walked = in_place()
    assert_limits(walked)
    places = np.array([place for _, place in walked.footholds()])
    assert np.abs(np.diff(places[:, 0])).max() < 0.06
    assert 0.15 < np.abs(walked.com_velocity[:, 1]).max() < 0.45


def test_the_hand_avoids_an_obstacle() -> None:
    """A user-defined distance: the hand avoids a sphere on its path."""
    scenario = Scenario("obstacle", 0.7, ((0.0, (0.45, -0.35, 0.9)),))
    free = walk(CONFIG, scenario)
    at = int(0.45 / CONFIG.dt)
    center = free.hand[at] + [0.0, 0.01, 0.0]
    sphere = FrameOutsideSphere(name="ball", frame="R_hand", center=center, radius=0.06, eta=20.0)

    def clearance(walked: WholeBodyTrace) -> float:
        return float(np.linalg.norm(walked.hand - sphere.center, axis=1).min() - sphere.radius)

    assert clearance(free) < -0.04
    controller = WholeBodyController(CONFIG, MODEL, distances=[sphere])
    kept = follow(controller, RigidPlant(MODEL, controller.start, pushed="chest"), scenario)
    assert kept.stood
    assert clearance(kept) > -1e-3


def test_a_custom_objective_is_followed() -> None:
    """The left hand also reaches for a position."""
    place = np.array([0.25, 0.35, 0.95])
    own = FramePosition(name="left hand", frame="L_hand", target=place, kp=100.0)
    controller = WholeBodyController(CONFIG, MODEL, objectives=[own])
    plant = RigidPlant(MODEL, controller.start, pushed="chest")
    body = Multibody(MODEL, ("L_hand",))

    def error() -> float:
        s = plant.state
        return float(np.linalg.norm(body.at(s.x_base, s.q, s.v).frames["L_hand"].position - place))

    first = error()
    for _ in range(160):
        plant.step(controller.step(plant.state, CONFIG.dt), CONFIG.dt)
    assert error() < 0.5 * first


def test_joint_bounds_stop_a_joint_before_its_limit() -> None:
    """A joint accelerated towards its limit as much as (S9) allows stops before it."""
    q, dq = MODEL.q_max - 0.3, np.full(MODEL.n, 4.0)
    for _ in range(400):
        _, upper = joint_bounds(MODEL, q, dq, CONFIG.whole_body.limit_time)
        q, dq = q + CONFIG.dt * dq + 0.5 * CONFIG.dt**2 * upper, dq + CONFIG.dt * upper
        assert (q <= MODEL.q_max + 1e-3).all()
    assert q == pytest.approx(MODEL.q_max, abs=5e-3)


def test_friction_edges_are_unit_vectors_on_the_cone() -> None:
    G = friction_edges(0.6)
    assert np.linalg.norm(G, axis=0) == pytest.approx(np.ones(4))
    assert np.linalg.norm(G[:2], axis=0) == pytest.approx(0.6 * G[2])


def test_invalid_arguments_are_errors() -> None:
    controller = WholeBodyController(CONFIG, MODEL)
    start = controller.start
    with pytest.raises(StateError, match="three finite"):
        controller.reach([0.0, np.nan, 0.0])
    with pytest.raises(StateError, match="dq"):
        controller.step(replace(start, dq=np.zeros(3)), CONFIG.dt)
    with pytest.raises(StateError, match="x_base"):
        controller.step(replace(start, x_base=np.full(8, np.nan)), CONFIG.dt)
    with pytest.raises(RuntimeError):
        _ = controller.last
    plant = RigidPlant(MODEL, start, pushed="chest")
    with pytest.raises(PlantError, match="impulse"):
        plant.push([1.0, 2.0])
    command = controller.step(start, CONFIG.dt)
    with pytest.raises(PlantError, match="torques"):
        plant.step(replace(command, effort=np.full(MODEL.n, np.nan)), CONFIG.dt)
    for key, value, message in (
        ("posture", ["L_kne=0.8"], "L_kne"),
        ("posture", ["L_knee=much"], "L_knee=much.*JOINT=RADIANS"),
        ("free", ["X_*"], "X_"),
        ("hand", "third_hand", "third_hand"),
    ):
        with pytest.raises((ModelError, ConfigError), match=message):
            WholeBodyController(CONFIG.updated({f"whole_body.{key}": value}), MODEL)
    with pytest.raises(ConfigError, match="not a place"):
        Scenario("never", 1.0, ((0.0, (1.0, 2.0)),))  # type: ignore[arg-type]


def test_the_mirrored_walk_is_the_mirror_image() -> None:
    """Started on the other foot, the walk makes the mirrored steps."""
    right = [(t, place) for t, place in in_place().footholds() if t < 1.3]
    left = walk(CONFIG.updated({"gait.first_support": "left"}), Scenario("left first", 1.3))
    for (t0, p0), (t1, p1) in zip(right, left.footholds(), strict=True):
        assert t0 == t1
        # the right arm is free and the left is not, so the mirror is not perfect
        assert p1 * [1, -1] == pytest.approx(p0, abs=0.02)


@pytest.mark.long
def test_a_push_beyond_reach_degrades_gracefully() -> None:
    """A push of 25 N s violates (S14); level 1 holds for as long as the robot does not fall."""
    walked = walk(CONFIG, Scenario("hard", 3.5, TARGET, ((2.5, (0.0, 25.0, 0.0)),)))
    missed = walked.residual > 1e-6
    assert missed.any()
    up = missed & (walked.violation == 0.0)
    assert up.any()
    assert walked.margins["cop_margin"][up].min() > -1e-6
