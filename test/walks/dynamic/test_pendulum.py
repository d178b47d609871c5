"""The pendulum of the dynamic walk, its angular momentum and inertia."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dynamic_poppy import CONFIG, MODEL, OMEGA, prepared, random_posture

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.walks.dynamic.pendulum import (
    Moving,
    Pendulum,
    advance,
    angular_momentum,
    command,
    measure,
    swing_inertia,
    when_acting,
)
from dqwalk_ros.walks.footprint import Footprint


@pytest.mark.parametrize("base", list(Foot))
def test_angular_momentum_matches_mujoco(base: Foot) -> None:
    from dqwalk_ros.plants.mujoco import build

    rng = np.random.default_rng(3)
    q, u = random_posture(2), rng.normal(size=MODEL.n)
    kin, h = Kinematics(MODEL, q, base), 1e-7
    mj = build(CONFIG, MODEL)
    data = mujoco.MjData(mj)

    def place(kin: Kinematics) -> np.ndarray:
        x = DQ(kin.pose(MODEL.root))
        qpos = np.zeros(mj.nq)
        qpos[:7] = [*x.translation(), *x.vec8()[:4]]
        qpos[[mj.joint(name).qposadr[0] for name in MODEL.joint_names]] = kin.q
        return qpos

    a, b = place(Kinematics(MODEL, q - h * u, base)), place(Kinematics(MODEL, q + h * u, base))
    mujoco.mj_differentiatePos(mj, data.qvel, 2.0 * h, a, b)
    data.qpos[:] = place(kin)
    mujoco.mj_forward(mj, data)
    mujoco.mj_subtreeVel(mj, data)
    assert angular_momentum(kin) @ u == pytest.approx(data.subtree_angmom[mj.body(MODEL.root).id], abs=1e-6)


@pytest.mark.parametrize("base", list(Foot))
def test_the_inertia_of_the_swing_leg_matches_mujoco(base: Foot) -> None:
    from dqwalk_ros.plants.mujoco import build

    mj = build(CONFIG, MODEL)
    data = mujoco.MjData(mj)
    joints = [mj.joint(name) for name in MODEL.joint_names]
    q = random_posture(4)
    data.qpos[[joint.qposadr[0] for joint in joints]] = q
    mujoco.mj_forward(mj, data)
    every, dofs = np.empty((mj.nv, mj.nv)), [joint.dofadr[0] for joint in joints]
    mujoco.mj_fullM(mj, data, every)
    expected = every[np.ix_(dofs, dofs)] - np.diag(mj.dof_armature[dofs])
    leg = np.array([name.startswith(f"{base.other.value[0]}_") and "arm" not in name for name in MODEL.joint_names])
    leg &= [any(part in name for part in ("hip", "knee", "ankle")) for name in MODEL.joint_names]
    found = swing_inertia(Kinematics(MODEL, q, base))
    assert leg.sum() == 5
    assert found == pytest.approx(np.where(np.outer(leg, leg), expected, 0.0), abs=1e-9)


def moved(c: np.ndarray, v: np.ndarray, z: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pendulum c'' = w^2 (c - z) after a time [s], by its hyperbolic functions."""
    cosh, sinh = np.cosh(OMEGA * time), np.sinh(OMEGA * time)
    return z + (c - z) * cosh + v / OMEGA * sinh, (c - z) * OMEGA * sinh + v * cosh


@pytest.mark.parametrize("assumed", [0.05, 0.0])
def test_the_error_is_fed_back_that_remains_when_the_command_acts(assumed: float) -> None:
    """The points under way act one after the other, each from half a period before the middle of its period on.

    The delay may have been assumed wrongly, and learned.
    """
    delay, dt, rng = 0.05, 0.02, np.random.default_rng(1)
    now, points = Pendulum(OMEGA, assumed, dt), 0.03 * rng.normal(size=(8, 2))
    c, v = 0.02 * rng.normal(size=2), 0.1 * rng.normal(size=2)
    now.reset(c, c + v / OMEGA, c)
    now.use(delay)
    for k, z in enumerate(points):
        command(Moving(*now.compiled), k * dt, z)
    time = 7 * dt + 0.003
    found, xi = when_acting(Moving(*now.compiled), time, c, c + v / OMEGA)
    begins = np.arange(8) * dt + delay - 0.5 * dt
    for at in np.arange(time, time + delay - 1e-9, 1e-4):
        acting = points[np.searchsorted(begins, at + 0.5e-4, side="right") - 1]
        c, v = moved(c, v, acting, 1e-4)
    assert found == pytest.approx(c, abs=1e-6)
    assert xi == pytest.approx(c + v / OMEGA, abs=1e-6)


def test_without_a_delay_the_measured_error_is_fed_back() -> None:
    now, c, xi = Pendulum(OMEGA, 0.0, 0.005), np.array([0.01, 0.02]), np.array([0.02, 0.01])
    now.reset(c, xi, xi)
    command(Moving(*now.compiled), 1.0, np.array([0.1, 0.1]))
    later = when_acting(Moving(*now.compiled), 1.005, c, xi)
    assert later[0] == pytest.approx(c, abs=1e-12)
    assert later[1] == pytest.approx(xi, abs=1e-12)


def test_the_pendulum_goes_on_in_the_axes_of_the_other_sole() -> None:
    """With equal frequencies along both axes it does not depend on them."""
    rng, turn, omega = np.random.default_rng(2), Footprint(0.1 + 0.2j, np.exp(0.3j)), np.array([4.0, 4.0])
    one, changes = Pendulum(omega, 0.03, 0.01), Pendulum(omega, 0.03, 0.01)
    for k in range(12):
        c, xi, z = 0.05 * rng.normal(size=(3, 2))
        if k == 0:
            one.reset(turn.points(c), turn.points(xi), turn.points(xi))
            changes.reset(c, xi, xi)
        if k == 6:
            changes.change_base(turn)
        later = []
        for now, there in ((one, turn.points), (changes, turn.points if k >= 6 else lambda p: p)):
            advance(Moving(*now.compiled), 0.01)
            measure(Moving(*now.compiled), 0.01 * k, 0.01, there(xi))
            later.append(when_acting(Moving(*now.compiled), 0.01 * k, there(c), there(xi)))
            command(Moving(*now.compiled), 0.01 * k, there(z))
    assert np.array(later[1]) == pytest.approx(np.array(later[0]))
    assert changes.c == pytest.approx(one.c)
    assert changes.smooth == pytest.approx(one.smooth)


def test_the_lateral_pendulum_frequency_is_reduced() -> None:
    found = [prepared(CONFIG.updated({"gait.first_support": foot.value})).pendulum.omega for foot in Foot]
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    plain = np.sqrt(9.80665 / Kinematics(MODEL, MODEL.posture(CONFIG.standing.posture), Foot.LEFT).com[2])
    assert 0.75 < found[0][1] / plain < 0.85  # 0.79 by regression of c'' on c - z in the physics
