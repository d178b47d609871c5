"""The robot in two physics engines: the same masses, kinematics, servos and contacts, and the same walks."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

import dqwalk_ros as dq
from dqwalk_ros import report
from dqwalk_ros.config import Config, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.engine import standing_root
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import PlantError
from dqwalk_ros.walks.table import make_controller

pytest.importorskip("pydrake", reason="there is no wheel of Drake for this machine")
from dqwalk_ros.plants.drake import DrakePlant

CONFIG = overlaid(dq.load("poppy_dynamic"), "physics")
MODEL = load_model(CONFIG.robot)
POSTURE = MODEL.posture(CONFIG.standing.posture)
ENGINES = (PhysicsPlant, DrakePlant)
MX = {"servo.types": ("*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64")}


def made(engine: Any, posture: Any = POSTURE, **changes: object) -> Any:
    config = CONFIG.updated({name.replace("__", "."): value for name, value in changes.items()})
    return engine(config, MODEL, posture)


def still(plant: Any, periods: int) -> None:
    for _ in range(periods):
        plant.step(Command(plant.state.time, np.zeros(MODEL.n)), CONFIG.dt)


def test_masses_poses_and_velocities_are_the_same() -> None:
    """Mass matrix with the rotors, bias torques and poses of links, of the robot held by its root."""
    one, two = (
        made(engine, physics__held=True, physics__settle=0.001, **{"servo.types": MX["servo.types"]})
        for engine in ENGINES
    )
    world, context, random = two._world, two._context, np.random.default_rng(0)
    assert world.CalcTotalMass(context) == pytest.approx(one.mj.body_mass.sum(), rel=1e-12)
    full = np.zeros((one.mj.nv, one.mj.nv))
    for _ in range(10):
        q, dq_ = random.uniform(-0.6, 0.6, MODEL.n), random.normal(size=MODEL.n)
        one._qpos[one._qadr], one._qvel[one._vadr] = q, dq_
        mujoco.mj_forward(one.mj, one.data)
        mujoco.mj_fullM(one.mj, one.data, full)
        two._seat(q, None)
        velocities = world.GetVelocities(context)
        velocities[two._vs] = dq_
        world.SetVelocities(context, velocities)
        of_two = world.CalcMassMatrix(context)[np.ix_(two._vs, two._vs)]
        np.testing.assert_allclose(of_two, full[np.ix_(one._vadr, one._vadr)], atol=1e-12)
        bias = world.CalcBiasTerm(context) - world.CalcGravityGeneralizedForces(context)
        np.testing.assert_allclose(bias[two._vs], one.data.qfrc_bias[one._vadr], atol=1e-12)
        for link in one._bodies:
            np.testing.assert_allclose(two._pose(link), one._pose(link), atol=1e-12)
        for found, expected in zip(two._imu_motion(), one._imu_motion(), strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_it_falls_freely(engine: Any) -> None:
    plant = made(engine, physics__settle=0.001, physics__contact_time=0.001)
    plant._seat(POSTURE, (DQ.from_pose([0.0, 0.0, 1.0]) * DQ(standing_root(MODEL, POSTURE))).vec8())
    height = plant.truth.com[2]
    still(plant, 60)
    n = 60 * plant._count
    h = 60 * CONFIG.dt / n  # it has fallen for one step already
    assert height - plant.truth.com[2] == pytest.approx(0.5 * GRAVITY * h**2 * n * (n + 3), rel=1e-3)
    assert np.linalg.norm(plant.inertial.acceleration) < 0.1  # it feels no weight


@pytest.mark.parametrize("friction", [0.4, 0.8])
@pytest.mark.parametrize("engine", ENGINES)
def test_the_soles_sink_by_the_stated_stiffness(engine: Any, friction: float) -> None:
    stiffness = 3e4
    plant = made(engine, physics__contact_stiffness=stiffness, physics__friction=friction, physics__settle=1.0)
    truth = plant.truth
    assert sum(w[2] for w in truth.wrenches.values()) == pytest.approx(MODEL.mass * GRAVITY, rel=0.01)
    for foot in Foot:
        center = [*MODEL.soles[foot].center[:2], 0.0]
        sunk = -DQ(truth.soles[foot]).transform_point(center)[2]
        assert sunk == pytest.approx(truth.wrenches[foot][2] / (4.0 * stiffness), rel=0.02)


def test_a_stiffness_without_friction_is_refused_in_mujoco() -> None:
    with pytest.raises(PlantError, match=r"needs, in MuJoCo, physics\.friction >= 0\.01"):
        made(PhysicsPlant, physics__contact_stiffness=3e4, physics__friction=0.0)


def test_both_stand_with_the_same_pressure_and_torques() -> None:
    one, two = (made(engine, physics__settle=0.8).truth for engine in ENGINES)
    np.testing.assert_allclose(two.cop[:2], one.cop[:2], atol=2e-4)
    np.testing.assert_allclose(two.effort, one.effort, atol=0.03)  # dry friction takes up to 0.02 N m of each
    np.testing.assert_allclose(two.com, one.com, atol=2e-4)


@pytest.mark.parametrize("changes", [{}, MX], ids=["default", "MX"])
def test_a_hanging_joint_answers_the_same(changes: dict[str, Any]) -> None:
    """A step of 0.1 rad of one knee; the MX has backlash, dry friction and back EMF."""
    moved = []
    for engine in ENGINES:
        plant = engine(CONFIG.updated({"physics.held": True, "servo.window": 3.0, **changes}), MODEL, np.zeros(MODEL.n))
        u = np.zeros(MODEL.n)
        knee = MODEL.joint_names.index("l_knee_y")
        u[knee] = 0.1 / CONFIG.dt
        angles = [plant.step(Command(0.0, u), CONFIG.dt).q[knee]]
        angles += [plant.step(Command(0.0, 0.0 * u), CONFIG.dt).q[knee] for _ in range(59)]
        moved.append(angles)
    difference = np.array(moved[1]) - moved[0]
    assert np.sqrt(np.mean(difference**2)) < 2.5e-3
    assert abs(moved[0][-1]) > 0.03


def test_a_push_moves_its_link_in_both_engines() -> None:
    """The lateral joints of the trunk bend to one side if the chest is pushed, to the other one if the pelvis is."""
    trunk = [MODEL.joint_names.index(name) for name in ("abs_x", "bust_x")]
    for link, side in (("chest", -1.0), ("", 1.0)):
        moved, bent = [], []
        for engine in ENGINES:
            plant = made(engine)
            before = plant.truth
            plant.push([0.0, 20.0, 0.0], link)
            still(plant, 4)
            plant.push(np.zeros(3))
            still(plant, 4)
            now = plant.truth
            moved.append(now.com[1] - before.com[1])
            bent.append(float((now.q - before.q)[trunk].sum()))
        assert 1e-3 < moved[0] < 0.5 * 20.0 / MODEL.mass * 0.04**2
        assert moved[1] == pytest.approx(moved[0], rel=0.1)
        assert bent[0] * side > 0.005
        assert bent[1] == pytest.approx(bent[0], rel=0.1)


def test_a_period_that_is_no_multiple_of_its_step_is_refused() -> None:
    plant = made(DrakePlant)
    with pytest.raises(PlantError, match=r"the period of 0.0033 s is no multiple of Drake's step of 0.001 s"):
        plant.step(Command(0.0, np.zeros(MODEL.n)), 0.0033)


def walked(plant: str, config: Config, **changes: object) -> dict[str, Any]:
    config = config.updated({name.replace("__", "."): value for name, value in changes.items()})
    model = load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant(plant, config, model))
    return report.report(report.analyse(trace))


@pytest.mark.long
@pytest.mark.parametrize("engine", ["physics", "drake"])
@pytest.mark.parametrize("walk", ["poppy", "poppy_dynamic"])
def test_walks_transfer(walk: str, engine: str) -> None:
    found = walked(engine, overlaid(dq.load(walk), "physics"), gait__steps=8)
    print(f"{walk} in {engine}: {found['physics']['displacement'][0]:.3f} m")
    assert found["ok"]


@pytest.mark.long
@pytest.mark.parametrize("engine", ["physics", "drake"])
def test_rubble_is_walked_on(engine: str) -> None:
    found = walked(engine, CONFIG, gait__steps=8, physics__rubble=0.003)
    assert not found["physics"]["fallen"]
    assert found["physics"]["displacement"][0] > 0.2


@pytest.mark.parametrize("engine", ENGINES)
def test_the_robot_stands_beside_rubble(engine: Any) -> None:
    """Hundreds of boxes beside an infinite floor; in another order they end the process in Drake."""
    plant = made(engine, physics__rubble=0.005)
    still(plant, 8)
    assert min(plant.truth.wrenches[foot][2] for foot in Foot) > 5.0


@pytest.mark.parametrize("rise", [0.02, -0.02])
@pytest.mark.parametrize("engine", ENGINES)
def test_stairs_are_stood_on(engine: Any, rise: float) -> None:
    """The robot starts on the level before the stairs, and stands on the second of three."""
    plant = made(engine, physics__settle=0.05, physics__rise=rise, physics__stairs=3, physics__tread=0.4)
    for ahead, height in ((0.0, 0.0), (0.9, 2.0 * rise), (2.0, 3.0 * rise)):
        plant._seat(POSTURE, (DQ.from_pose([ahead, 0.0, height]) * DQ(standing_root(MODEL, POSTURE))).vec8())
        still(plant, 8)
        for foot, sole in plant.truth.soles.items():
            assert DQ(sole).translation()[2] == pytest.approx(height, abs=5e-4)
            assert plant.truth.wrenches[foot][2] > 5.0


def test_drake_falls_when_it_is_thrown() -> None:
    plant = made(DrakePlant)
    assert not plant.fallen
    plant._seat(POSTURE, DQ.from_pose([0.0, 0.0, 0.2], [0.0, 1.0, 0.0, 0.0]).vec8())
    assert plant.fallen
