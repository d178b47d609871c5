"""The estimate of the base compared with the true motion in physics, with sensor errors and slipping soles."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.estimation.base import BaseEstimate, BaseEstimator
from dqwalk_ros.estimation.vertical import filtered_vertical
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.walks.com import measured, velocity
from dqwalk_ros.walks.table import make_controller

POPPY = dq.load("poppy")
MODEL = dq.load_model(POPPY.robot)


def errors(steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a walk as built, with a slip of 2 mm per step; return errors (N, 9) and their NEES (N,)."""
    changes = {"gait.steps": steps, "qp.solver": "daqp", "sensors.seed": seed}
    config = overlaid(POPPY, "poppy_as_built").updated(changes)
    plant, controller = make_plant("physics", config, MODEL), make_controller(config, MODEL)
    estimator, random = BaseEstimator(config, MODEL), np.random.default_rng(seed)
    world, found, nees, slipped = None, [], [], 0
    for state, _ in closed_loop(controller, plant):
        phase = controller.phase
        single = phase.kind is PhaseKind.SINGLE_SUPPORT
        kin = Kinematics.measured(MODEL, state.q, phase.base, state.up)
        felt, loads = (state.gyro, state.acceleration), controller.loads
        estimate = estimator.update(state.time, kin, *felt, both=not single, loads=loads)
        truth = plant.truth
        if world is None:  # the first base sole, level
            R = DQ(truth.soles[phase.base]).rotation_matrix()
            yaw = math.atan2(R[1, 0], R[0, 0])
            p = DQ(truth.soles[phase.base]).translation() * [1.0, 1.0, 0.0]
            world = DQ.from_pose(p, [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
        if single and controller.phase_index > slipped:
            # on a uniform floor a translation of the robot is equivalent to a slip
            slipped, way = controller.phase_index, random.uniform(-np.pi, np.pi)
            plant.data.qpos[:2] += 0.002 * np.array([math.cos(way), math.sin(way)])
        twist = np.empty(6)
        mujoco.mj_objectVelocity(plant.mj, plant.data, mujoco.mjtObj.mjOBJ_XBODY, plant._pelvis_id, twist, 0)
        x, y = world.conj() * DQ(truth.pelvis), DQ(estimate.pose)
        turned = (y * x.conj()).rotation()
        found.append(
            np.concatenate([
                2.0 * turned[1:] * np.sign(turned[0]),
                estimate.velocity - world.rotation_matrix().T @ twist[3:],
                y.translation() - x.translation(),
            ])
        )  # fmt: skip
        nees.append(found[-1] @ np.linalg.solve(estimate.covariance, found[-1]))
    assert controller.finished
    assert not plant.fallen
    return np.array(found), np.array(nees)


def test_the_covariance_of_the_velocity_in_its_own_axes_contains_no_yaw() -> None:
    """Errors of a turned velocity (right-invariant: R' = exp(a) R, v' = exp(a) v + b), drawn and counted."""
    random, v, count = np.random.default_rng(1), np.array([0.2, -0.05, 0.01]), 20000
    R = DQ.from_pose(np.zeros(3), [math.cos(0.4), 0.0, 0.0, math.sin(0.4)]).rotation_matrix()
    a, b = random.normal(size=(count, 3)) * [0.01, 0.01, 0.2], random.normal(size=(count, 3)) * [0.01, 0.02, 0.005]
    errors = np.zeros((count, 9))
    errors[:, :3], errors[:, 3:6] = a, np.cross(a, v) + b
    estimate = BaseEstimate(DQ(1.0).vec8(), v, np.zeros(3), np.cov(errors.T), frozenset())
    np.testing.assert_allclose(estimate.velocity_covariance(R), np.cov((b @ R).T), rtol=0, atol=1e-6)
    assert np.cov(errors[:, 3:6].T)[1, 1] > 1e-3  # of the velocity in axes of the world


@pytest.mark.parametrize("height", [-0.03, 0.03])
def test_a_sole_on_a_stair_does_not_tilt_the_estimate(height: float) -> None:
    """The robot is at rest; its left foot lands on a stair."""
    higher, lower = (MODEL.posture([f"?_hip_y={-a}", f"?_knee_y={2.0 * a}", f"?_ankle_y={-a}"]) for a in (0.6, 0.3))
    q = np.where([name.startswith("l_") is (height > 0.0) for name in MODEL.joint_names], higher, lower)
    kin = Kinematics(MODEL, q, Foot.RIGHT)
    assert kin.point(kin.swing)[2] == pytest.approx(height, abs=0.02)
    estimator, up = BaseEstimator(POPPY, MODEL), np.array([kin.direction(MODEL.imu, axis)[2] for axis in np.eye(3)])
    for k in range(300):
        x = estimator.update(0.005 * k, kin, np.zeros(3), GRAVITY * up, both=k > 100)
    off = DQ(x.pose).conj() * DQ(kin.pose(MODEL.pelvis))
    assert np.abs(off.translation()).max() < 1e-3
    assert np.abs(off.rotation_vector()).max() < 1e-3


def estimated(
    glitch: dict[int, tuple[np.ndarray, np.ndarray]], dt: float = 0.005, count: int = 300
) -> tuple[BaseEstimator, np.ndarray]:
    """Return the estimator of a robot at rest, and its positions (N, 3); some measurements are off."""
    estimator, kin = BaseEstimator(POPPY, MODEL), Kinematics(MODEL, MODEL.posture(POPPY.standing.posture), Foot.LEFT)
    up = np.array([kin.direction(MODEL.imu, axis)[2] for axis in np.eye(3)])
    found = []
    for k in range(count):
        gyro, acceleration = glitch.get(k, (np.zeros(3), np.zeros(3)))
        x = estimator.update(k * dt, kin, gyro, GRAVITY * up + acceleration, both=True)
        found.append(DQ(x.pose).translation())
    return estimator, np.array(found)


@pytest.mark.parametrize("dt", [0.005, 0.02])
@pytest.mark.parametrize("size", [1e2, *(pytest.param(s, marks=pytest.mark.long) for s in (1.0, 1e4, 1e8, 1e300))])
def test_a_single_wrong_measurement_moves_the_estimate_by_millimetres(size: float, dt: float) -> None:
    """Once the first states have reduced the covariance of the velocity."""
    for axis in np.eye(3):
        for glitch in ((np.zeros(3), size * axis), (size * axis, np.zeros(3)), (-size * axis, size * axis)):
            estimator, at = estimated({100: glitch}, dt, 130)
            assert np.linalg.norm(at - at[99], axis=1)[100:].max() < 0.008
            assert not estimator.astray


@pytest.mark.parametrize(("after", "turned"), [(0.02, 0.012), (0.3, 0.15)], ids=["at the landing", "a stumble"])
def test_a_pivot_of_the_soles_turns_the_robot_as_the_gyroscope_says(after: float, turned: float) -> None:
    """The robot turns as a whole within 30 ms on both feet, its joints at rest; the legs cannot know."""
    dt, kin = 0.005, Kinematics(MODEL, MODEL.posture(POPPY.standing.posture), Foot.LEFT)
    R = np.array([kin.direction(MODEL.imu, axis) for axis in np.eye(3)])  # from the world to the sensor
    estimator, landing, still = BaseEstimator(POPPY, MODEL), 400, np.zeros(3)
    for k in range(800):
        since = k * dt - (landing * dt + after)
        gyro = R @ [0.0, 0.0, turned / 0.03] if -1e-9 < since < 0.03 - 1e-9 else still
        x = estimator.update(k * dt, kin, gyro, GRAVITY * R[:, 2], both=k >= landing)
    yaw = (DQ(x.pose) * DQ(kin.pose(MODEL.pelvis)).conj()).rotation_vector()[2]
    assert yaw == pytest.approx(turned, rel=0.2)
    assert not estimator.astray


@pytest.mark.parametrize(("length", "slips"), [(0.144, True), (0.28, False)])
def test_a_long_sole_may_yield_by_more_than_a_short_one(length: float, slips: bool) -> None:
    """The left sole seems to move to the side by 3.5 mm."""
    soles = {foot: replace(sole, length=length) for foot, sole in MODEL.soles.items()}
    model = replace(MODEL, soles=soles)
    q = MODEL.posture(POPPY.standing.posture)
    turn = 0.01 * (np.arange(MODEL.n) == MODEL.joint_names.index("l_hip_x"))
    left, moved = (Kinematics(MODEL, x, Foot.RIGHT).point(MODEL.soles[Foot.LEFT].frame) for x in (q, q + turn))
    turned = q + 0.0035 / np.linalg.norm(moved - left) * turn
    estimator = BaseEstimator(POPPY, model)
    for k in range(100):
        kin = Kinematics(MODEL, turned if k == 99 else q, Foot.RIGHT)
        up = np.array([kin.direction(MODEL.imu, axis)[2] for axis in np.eye(3)])
        x = estimator.update(0.005 * k, kin, np.zeros(3), GRAVITY * up, both=True)
    assert (Foot.LEFT not in x.contacts) is slips


def test_an_accelerometer_that_contradicts_the_standing_soles_is_noticed() -> None:
    estimator, _ = estimated({k: (np.zeros(3), np.array([0.0, 100.0, 0.0])) for k in range(300)})
    assert estimator.astray


def test_an_accelerometer_that_measures_in_g_has_a_large_bias_only() -> None:
    estimator, at = estimated({k: (np.zeros(3), np.array([0.0, 0.0, 1.0 - GRAVITY])) for k in range(300)})
    assert not estimator.astray
    assert np.linalg.norm(at - at[0], axis=1).max() < 0.02


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_errors_of_the_base_match_the_estimated_covariance(seed: int) -> None:
    error, nees = errors(4, seed)
    rms = np.sqrt((error**2).mean(axis=0))
    assert np.degrees(np.linalg.norm(rms[:2])) < 0.6
    assert np.degrees(np.abs(error[:, 2])).max() < 2.0
    assert np.linalg.norm(rms[3:6]) < 0.02
    assert np.linalg.norm(error[-1, 6:8]) < 0.015  # the slips contribute 4 mm (rms)
    assert 2.7 < nees.mean() < 19.0  # the 95 % band of chi-squared with 9 degrees of freedom


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [0, 1])
def test_the_drift_over_ten_metres_is_below_one_percent(seed: int) -> None:
    error, nees = errors(200, seed)
    rms, drift = np.sqrt((error**2).mean(axis=0)), float(np.linalg.norm(error[-1, 6:8]))
    yaw = np.degrees(error[-1, 2])
    print(
        f"\nseed {seed}: drift {1e3 * drift:.1f} mm, yaw {yaw:.2f} degrees, "
        f"roll and pitch {np.degrees(np.linalg.norm(rms[:2])):.2f} degrees rms, "
        f"velocity {np.linalg.norm(rms[3:6]):.4f} m/s rms, mean NEES {nees.mean():.1f}"
    )
    assert drift < 0.1
    assert abs(yaw) < 2.0
    assert np.degrees(np.linalg.norm(rms[:2])) < 0.5
    assert np.linalg.norm(rms[3:6]) < 0.02


def test_an_unloaded_sole_is_not_used_as_a_contact() -> None:
    """With the CoM above one sole the other sole may slide."""
    q, still = MODEL.posture(POPPY.standing.posture), (np.zeros(3), np.array([0.0, 0.0, 9.81]))
    middle = Kinematics(MODEL, q, Foot.LEFT)
    over = Kinematics(MODEL, q, Foot.LEFT, [0.0, math.sin(0.15), math.cos(0.15)])  # the vertical of a tilted robot
    for kin in (middle, over):
        beside = kin.com_on_ground[1] / kin.point(kin.swing)[1]
        held = BaseEstimator(POPPY, MODEL).update(0.0, kin, *still, both=True).contacts
        assert held == (set(Foot) if kin is middle else {Foot.LEFT if beside < 0.1 else Foot.RIGHT})
    for loads, foot in (([0.5, 20.0], Foot.RIGHT), ([20.0, 0.5], Foot.LEFT)):  # with the CoM in the middle
        known = {"both": True, "loads": np.array(loads)}
        assert BaseEstimator(POPPY, MODEL).update(0.0, middle, *still, **known).contacts == {foot}


def verticals(omega: np.ndarray, *, noise: float = 0.0, bias: float = 0.0, states: int = 2000) -> np.ndarray:
    """Return true and filtered verticals (N, 2, 3) of a sensor that turns with omega sin(t) [rad/s]."""
    dt, random, R, before, out = 0.005, np.random.default_rng(1), np.eye(3), None, []
    size, axis = np.linalg.norm(omega), DQ(np.array([0.0, *omega, 0.0, 0.0, 0.0, 0.0]))
    for k in range(states):
        half = 0.5 * size * (1.0 - math.cos(k * dt))
        turn = math.sin(half) / max(size, 1e-12) * axis.vec8()[1:4]
        R = DQ.from_pose(np.zeros(3), [math.cos(half), *turn]).rotation_matrix()
        up = R[2] + noise * random.normal(size=3)
        measured = State(k * dt, np.zeros(1), up=up / np.linalg.norm(up), gyro=omega * math.sin(k * dt) + bias)
        vertical = measured.up if before is None else filtered_vertical(before.up, before.gyro, measured, dt)
        before = State(measured.time, measured.q, up=vertical, gyro=measured.gyro)
        out.append([R[2], vertical])
    return np.array(out)


@pytest.mark.parametrize("omega", np.eye(3))
def test_the_filtered_vertical_has_no_lag(omega):
    true, filtered = verticals(omega).swapaxes(0, 1)
    assert np.ptp(true, axis=0).max() > 0.1 or omega[2]
    np.testing.assert_allclose(filtered, true, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(filtered, axis=1), 1.0, atol=1e-12)


def test_noise_of_the_vertical_is_reduced_and_a_bias_of_the_gyroscope_turns_it_by_little():
    """White noise remains to sqrt(dt / 2T) = 0.16 of it, and a bias b causes an error of T b, with T = 0.1 s."""
    true, noisy = verticals(np.zeros(3), noise=0.004).swapaxes(0, 1)
    assert np.std((noisy - true)[100:, :2]) == pytest.approx(0.16 * 0.004, rel=0.15)
    true, biased = verticals(np.zeros(3), bias=np.array([0.02, 0.0, 0.0])).swapaxes(0, 1)
    assert np.linalg.norm(biased[-1] - true[-1]) == pytest.approx(0.1 * 0.02, rel=0.01)


def test_a_sensor_without_angular_velocity_is_not_filtered():
    up = np.array([0.0, 0.6, 0.8])
    assert filtered_vertical(np.array([0.0, 0.0, 1.0]), None, State(0.005, np.zeros(1), up=up), 0.005) is up
    assert filtered_vertical(np.array([0.0, 0.0, 1.0]), up, State(0.005, np.zeros(1)), 0.005) is None


def test_the_gyroscope_is_as_late_as_the_joint_velocities() -> None:
    """An ankle moves the robot to and fro above a sole at rest; the CoM seems to move faster if it alone is late."""
    dt, lag, errors = 0.005, 0.01, {}
    q, joint = MODEL.posture(POPPY.standing.posture), MODEL.joint_names.index("l_ankle_y")
    for assumed in (0.0, lag):
        controller = make_controller(POPPY.updated({"servo.assumed_velocity_filter": assumed}), MODEL)
        dq, errors[assumed] = np.zeros(MODEL.n), []
        for k in range(200):
            moved, speed = q.copy(), np.zeros(MODEL.n)
            moved[joint] += 0.05 * math.sin(20.0 * k * dt)
            speed[joint] = math.cos(20.0 * k * dt)
            dq += (1.0 - math.exp(-dt / lag)) * (speed - dq)
            kin = Kinematics(MODEL, moved, Foot.LEFT)
            turn = kin.lines[joint, :3] * speed[joint]
            gyro = np.array([kin.direction(MODEL.imu, axis) for axis in np.eye(3)]) @ turn
            up = np.array([kin.direction(MODEL.imu, axis)[2] for axis in np.eye(3)])
            state = controller._last_state = controller._estimated(State(k * dt, moved, dq.copy(), up, gyro))
            errors[assumed].append(velocity(0.0, *measured(kin, state)) - kin.com_jacobian @ dq)
    assert np.abs(errors[lag][20:]).max() < 0.1 * np.abs(errors[0.0][20:]).max()


def test_the_vertical_is_the_measured_one_after_a_gap():
    """A robot may be turned by hand while no state arrives."""
    controller = make_controller(POPPY, MODEL)
    q, leaning, gap = controller.walk.posture, [math.sin(0.1), 0.0, math.cos(0.1)], 1.2 * POPPY.plant.command_timeout
    for time, up in ((0.0, [0.0, 0.0, 1.0]), (POPPY.dt, [0.0, 0.0, 1.0]), (POPPY.dt + gap, leaning)):
        controller.step(State(time, q, np.zeros(MODEL.n), np.array(up), np.zeros(3)), POPPY.dt)
    assert controller.lean == pytest.approx(0.1, abs=0.02)
