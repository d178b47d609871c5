"""The dynamic walk: properties of its plan, steps and tasks, and a short walk in physics."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import pickle
from pathlib import Path

import mujoco
import numpy as np
import pytest
from walks import values

import dqwalk_ros as dq
from dqwalk_ros.config import find_share, overlaid, with_files
from dqwalk_ros.estimation.load import FootLoads
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Observer
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.walk import Walk
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, bag, report
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.simulation import closed_loop, simulate, warm_up
from dqwalk_ros.studies import robustness
from dqwalk_ros.studies.pushes import Push, pushed
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.com import com_and_xi
from dqwalk_ros.walks.dynamic.adjust import Step, adjusted, left_over, transfer_time
from dqwalk_ros.walks.dynamic.force import converging, fed_back
from dqwalk_ros.walks.dynamic.ground import Ground, include
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
from dqwalk_ros.walks.dynamic.plan import Pressed, Rest, Support, single_supports
from dqwalk_ros.walks.dynamic.swing import Swing, advanced
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.following import FollowPose, Target
from dqwalk_ros.walks.footprint import Footprint
from dqwalk_ros.walks.table import make_controller

CONFIG = dq.load("poppy_dynamic")
MODEL = dq.load_model(CONFIG.robot)
OMEGA = np.array([4.4, 3.7])
MIRROR = np.array([1.0, -1.0])
DYNAMIC = CONFIG.dynamic


def random_posture(seed: int) -> np.ndarray:
    q = MODEL.posture(CONFIG.standing.posture) + 0.2 * np.random.default_rng(seed).normal(size=MODEL.n)
    return np.clip(q, MODEL.q_min, MODEL.q_max)


def prepared(config: dq.Config) -> DynamicWalk:
    walk = DynamicWalk(config, MODEL)
    walk.prepare()
    return walk


def supports(length: float = 0.05, width: float = 0.08, first: float = 1.0, roll: float = 0.0) -> list[Support]:
    """Return a support and six following ones, `length` apart [m]; the first is on the left."""
    aims = [np.array([k * length, first * 0.5 * width * (-1.0) ** k]) for k in range(7)]
    return [Support(aim, np.array([roll, 0.0]), 0.1, 0.4) for aim in aims]


# ---------------------------------------------------------------------- the plan


@pytest.mark.parametrize(
    "reference",
    [
        Pressed(np.array([0.0, 0.04]), np.array([0.05, -0.04]), np.array([0.04, 0.01]), 0.1, OMEGA),
        Pressed(np.array([0.0, 0.04]), np.array([0.0, 0.04]), np.array([0.03, 0.01]), 0.4, OMEGA),
        Rest(np.array([0.0, 0.0]), np.array([0.01, 0.02]), 0.6, OMEGA),
    ],
    ids=["double", "single", "rest"],
)
def test_xi_diverges_from_z(reference: Pressed | Rest) -> None:
    h = 1e-6
    for t in np.linspace(0.05, 0.9, 7) * reference.duration:
        xi, z = reference.at(t)
        slope = (reference.at(t + h)[0] - reference.at(t - h)[0]) / (2.0 * h)
        assert slope == pytest.approx(OMEGA * (xi - z), abs=1e-7)
    again = pickle.loads(pickle.dumps(reference))  # in another process its function has another address
    assert "compiled" not in vars(again)
    np.testing.assert_array_equal(again.at(0.1), reference.at(0.1))


@pytest.mark.parametrize("roll", [0.0, 0.015])
def test_the_plan_is_continuous(roll: float) -> None:
    every = supports(roll=roll)
    every[3] = every[3]._replace(double=0.2, single=0.3)
    plan = single_supports(every, OMEGA, ends=False)
    assert len(plan) == len(every) - 1
    for k, (start, end) in enumerate(plan):
        a, b = every[k], every[k + 1]
        assert Pressed(a.first, a.last, end, a.single, OMEGA).at(0.0)[0] == pytest.approx(start)
        if k + 1 < len(plan):
            begins, _ = plan[k + 1]
            double = Pressed(a.last, b.first, begins, b.double, OMEGA)
            assert double.at(0.0)[0] == pytest.approx(end)
            assert double.at(b.double)[0] == pytest.approx(begins)


@pytest.mark.parametrize("ends", [False, True])
def test_plans_of_left_and_right_are_mirrored(ends: bool) -> None:
    left = single_supports(supports(roll=0.01), OMEGA, ends=ends)
    right = single_supports(supports(first=-1.0, roll=0.01), OMEGA, ends=ends)
    assert np.array(left) * MIRROR == pytest.approx(np.array(right))


def test_distant_steps_hardly_affect_the_plan() -> None:
    on, off = (single_supports(supports(), OMEGA, ends=ends)[0][0] for ends in (False, True))
    assert np.abs(on - off).max() < 1e-4


def test_stepping_in_place_is_periodic() -> None:
    plan = single_supports(supports(length=0.0), OMEGA, ends=False)
    assert plan[0][0] == pytest.approx(plan[2][0], abs=1e-4)
    assert plan[0][0] * MIRROR == pytest.approx(plan[1][0], abs=1e-3)
    assert plan[0][0][0] == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------- the pendulum


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


# ---------------------------------------------------------------------- steps


def a_step() -> Step:
    (here, _, _, _), (there, _, _, _), *_ = every = supports()
    (_, end), *_ = single_supports(every, OMEGA, ends=False)
    half = np.array([0.06, 0.015])
    return Step(
        z=here, landing=there, offset=end - there, duration=0.4, omega=OMEGA,
        low=here - half, high=here + half, reach=np.array([0.1, 0.0]),
    )  # fmt: skip


def at(step: Step, elapsed: float) -> np.ndarray:
    return Pressed(step.z, step.z, step.landing + step.offset, step.duration, OMEGA).at(elapsed)[0]


def test_small_errors_do_not_change_the_step() -> None:
    step = a_step()
    for elapsed in (0.05, 0.15, 0.25):
        for error in ([0.0, 0.0], [0.01, 0.0], [0.0, 0.003], [-0.008, -0.003]):  # within the range of the ankle
            xi = at(step, elapsed) + np.array(error)
            time, shift, over = adjusted(step, xi, elapsed, 0.4, np.zeros(2), DYNAMIC)
            assert time == pytest.approx(0.4, abs=0.006)
            assert np.abs(shift).max() < 0.002
            assert over == pytest.approx([0.0, 0.0], abs=1e-3)


def test_left_over_is_the_error_beyond_the_ankle_range() -> None:
    step, elapsed, left = a_step(), 0.1, 0.3
    xi = at(step, elapsed) + np.array([0.08, 0.02])
    over, _ = left_over(step, xi, elapsed, left)
    # with the zero-moment point in the corner of the sole, the error of xi at the end of the step
    reached = step.high + np.exp(OMEGA * left) * (xi - step.high)
    assert over == pytest.approx(reached - step.landing - step.offset)


def test_a_push_changes_position_and_time_of_the_step() -> None:
    step, xi = a_step(), at(a_step(), 0.15)
    time, shift = 0.4, np.zeros(2)
    for _ in range(20):
        time, shift, _ = adjusted(step, xi + np.array([0.06, 0.0]), 0.15, time, shift, DYNAMIC)
    assert shift[0] > 0.02
    for _ in range(20):  # towards the other foot: the step must end earlier
        time, shift, _ = adjusted(step, xi - np.array([0.0, 0.03]), 0.15, time, shift, DYNAMIC)
    assert time < 0.35
    assert shift[1] == 0.0  # there is no ankle roll


def test_a_double_support_lasts_until_xi_has_arrived() -> None:
    a, b = np.array([0.0, 0.0]), np.array([0.05, -0.08])
    reference = Pressed(a, b, np.array([0.06, -0.06]), 0.1, OMEGA)
    xi, z = reference.at(0.03)
    assert transfer_time(reference, z, xi, 0.0) == pytest.approx(0.07, abs=0.005)
    behind = xi + np.array([0.0, 0.006])
    longer = transfer_time(reference, z, behind, 0.07)
    assert longer > 0.08
    begin, _ = Pressed(z, b, reference.end, longer, OMEGA).at(0.0)  # of the longer double support
    assert begin[1] == pytest.approx(behind[1], abs=2e-3)
    assert transfer_time(reference, z, xi - np.array([0.0, 0.015]), 0.07) == pytest.approx(0.07)
    assert transfer_time(reference, z, behind, 0.45) == pytest.approx(0.45, abs=0.011)  # longer than what is tried


def test_a_robot_that_is_held_does_not_wait_for_ever() -> None:
    """In a double support a hand stops the robot, so the divergent component never arrives."""
    config = CONFIG.updated({"gait.steps": 6})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    held = next(state for state, _ in closed_loop(controller, plant) if controller.phase_index == 5)
    assert controller.phase.kind is PhaseKind.DOUBLE_SUPPORT
    held, begun = dataclasses.replace(held, dq=np.zeros(MODEL.n), gyro=np.zeros(3)), held.time
    while controller.phase_index == 5 and held.time - begun < 6.0:
        held = dataclasses.replace(held, time=held.time + config.dt)
        controller.step(held, config.dt)
    assert 0.2 < held.time - begun < 4.0


def test_a_push_towards_the_swing_foot_is_caught_on_the_spot() -> None:
    """The foot lands early and throws the robot back; a longer double support catches it."""
    config = overlaid(CONFIG, "physics").updated({"gait.step_length": 0.0, "gait.steps": 4})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def push(time: float) -> None:  # in the middle of the second step, in support on the right foot
        due = controller.phase_index == 4 and 0.2 <= time + begin - controller.phase_began < 0.3
        plant.push(np.array([0.0, 6.0 if due else 0.0, 0.0]))

    begin = plant.state.time
    trace = simulate(controller, plant, before_step=push)
    assert trace.finished, trace.notes
    assert any(record.decision.startswith("the double support lasts") for record in trace.phases)
    assert all(record.decision == "" for record in trace.phases[:4])


def test_a_swing_lands_at_a_changed_goal_and_time() -> None:
    start, goal = DQ.from_pose([-0.05, 0.08, 0.002]).vec8(), DQ.from_pose([0.05, 0.08, 0.0]).vec8()
    swing, dt, duration = Swing(start, goal, 0.02), 0.001, 0.4
    places = []
    for k in range(1, 450):
        t = k * dt
        if t > 0.2:
            swing.goal, duration = np.array([0.08, 0.08]), 0.44
        pose, velocity, _ = advanced(*swing.compiled, t, duration)
        places.append([*pose[:3], *velocity[:3]])
    path = np.array(places)
    slope = np.diff(path[:, :3], axis=0) / dt
    assert path[-1, :3] == pytest.approx([0.08, 0.08, 0.0], abs=1e-6)
    assert np.abs(path[-1, 3:]).max() < 1e-3
    assert np.abs(slope - 0.5 * (path[1:, 3:] + path[:-1, 3:]))[np.arange(448) != 199].max() < 0.02
    assert path[:, 2].max() == pytest.approx(0.02, abs=0.002)


def test_a_foot_that_lands_late_only_comes_down_at_the_end() -> None:
    start, goal, late = DQ.from_pose([-0.05, 0.08, 0.0]).vec8(), DQ.from_pose([0.05, 0.08, 0.0]).vec8(), 0.03
    swings = [(Swing(start, goal, 0.02), 0.4), (Swing(start, goal, 0.02, still=late / (0.4 + late)), 0.4 + late)]
    for t in np.linspace(0.3, 0.4, 20):
        (prompt, _, _), (other, _, _) = (advanced(*swing.compiled, float(t), duration) for swing, duration in swings)
        assert other[:2] == pytest.approx(prompt[:2], abs=5e-4)
        assert other[2] > prompt[2] + 5e-5
    assert other[:2] == pytest.approx([0.05, 0.08], abs=1e-9)


@pytest.mark.parametrize(("below", "goal"), [(0.0, 0.025), (-0.025, 0.025), (-0.025, 0.0), (0.0, -0.025)])
def test_a_swing_clears_the_edge_of_a_stair_that_is_10_mm_from_the_sole(below: float, goal: float) -> None:
    x = [-0.06, 0.12]
    swing = Swing(DQ.from_pose([x[0], 0.08, below]).vec8(), DQ.from_pose([x[1], 0.08, goal]).vec8(), 0.02, 0.0, below)
    path = np.array([np.concatenate(advanced(*swing.compiled, t, 0.4)[:2]) for t in np.arange(0.001, 0.401, 0.001)])
    edge = path[:, 0] > x[0] + 0.01 if goal > below else path[:, 0] < x[1] - 0.01
    assert path[edge, 2].min() > max(goal, below) - 1e-9
    assert path[-1, :3] == pytest.approx([x[1], 0.08, goal], abs=1e-6)
    assert np.abs(path[-1, 7:]).max() < 1e-3
    assert path[:, 2].max() < max(goal, below) + 0.021
    slope = np.diff(path[:, 2]) / 0.001
    assert np.abs(slope - 0.5 * (path[1:, 9] + path[:-1, 9])).max() < 0.02


@pytest.mark.parametrize("stopped", [0.15, 0.3])
@pytest.mark.parametrize("height", [None, 0.03])
def test_a_climbing_foot_that_is_stopped_goes_back_down_or_stays_on_top(stopped: float, height: float | None) -> None:
    start, goal = DQ.from_pose([-0.05, 0.08, -0.01]).vec8(), DQ.from_pose([0.07, 0.08, 0.02]).vec8()
    swing, dt = Swing(start, goal, 0.02, level=-0.01), 0.001
    poses = []
    for t in np.arange(dt, 0.401, dt):
        poses.append(advanced(*swing.compiled, float(t), 0.4)[0])
        if abs(t - stopped) < 1e-9:
            assert swing.is_over(poses[-1][:2]) is (stopped > 0.2)
            landing = swing.stop(poses[-1][:2], height)
    path, at = np.array(poses), round(stopped / dt) - 1
    assert path[-1, :2] == pytest.approx(landing, abs=1e-6)
    assert landing == pytest.approx([-0.05, 0.08] if height is None else path[at, :2], abs=1e-9)
    if height is None:  # to the ground before the stair, without a jump
        assert path[-1, 2] == pytest.approx(0.0, abs=1e-6)
        assert np.abs(np.diff(path[:, 2])).max() < 1e-3
    else:
        assert path[at + 1 :, 2] == pytest.approx(height, abs=1e-9)


# ---------------------------------------------------------------------- the ground


def random_vertical(random: np.random.Generator) -> np.ndarray:
    """Return the vertical in axes of a sole that is inclined by some degrees."""
    up = np.array([0.1, 0.1, 1.0]) * [*random.uniform(-1.0, 1.0, 2), 1.0]
    return up / np.linalg.norm(up)


@pytest.mark.parametrize("seed", range(5))
def test_a_sole_that_tips_leaves_the_swing_foot_at_its_height_above_the_ground(seed: int) -> None:
    """Up to the dead zone of 0.5 degrees."""
    random = np.random.default_rng(seed)
    flat, up = random_vertical(random), random_vertical(random)
    ground, unsure = Ground(flat), math.radians(0.5)
    seen = (
        DQ(ground.tip(up, unsure)).Ad(DQ([0.0, *flat])).vec3()
    )  # the vertical, as far as the sole is taken to have tipped
    angle = math.acos(flat @ up)
    assert math.acos(flat @ seen) == pytest.approx(angle - math.radians(0.5))
    assert math.acos(seen @ up) == pytest.approx(math.radians(0.5))
    p, r = random.normal(size=3), random.normal(size=4)
    moved = ground.tipped(up, unsure, np.array([*p, *r / np.linalg.norm(r)]))
    assert seen @ moved[:3] == pytest.approx(flat @ p)
    before, after = DQ(r).P().normalized().conj().Ad(DQ([0.0, *flat])), DQ(moved[3:]).conj().Ad(DQ([0.0, *seen]))
    assert after.vec3() == pytest.approx(before.vec3())  # the vertical in axes of the swing sole
    assert Ground(flat).tip(flat, math.radians(0.5)) == pytest.approx(DQ(1.0).vec8())


def test_the_ground_is_inclined_as_the_soles_are_in_the_mean() -> None:
    random = np.random.default_rng(0)
    slope = random_vertical(random)
    ground = Ground(np.array([0.0, 0.0, 1.0]))
    turn = Footprint(0.1 + 0.2j, np.exp(0.3j))  # of the previous sole in the axes of the next
    for k in range(4000):
        if k % 100 == 99:
            ground.change_base(turn)
            slope = DQ(turn.pose).P().Ad(DQ([0.0, *slope])).vec3()
        include(ground.vertical, slope + 0.02 * random.normal(size=3), 0.005)
    assert ground.tip(slope, 1e-3) == pytest.approx(DQ(1.0).vec8(), abs=2e-3)


def test_the_pressure_is_aimed_further_inside_after_a_step_on_an_inclined_sole() -> None:
    """Until two steps have ended on soles that are level but for the noise of the sensor."""
    ground, found = Ground(np.array([0.0, 0.0, 1.0])), []
    for tilt in (0.4, 0.0, 0.6, 0.3, 0.4, 2.0):
        ground.end_step(math.radians(tilt))
        found.append(ground.inward > 0.0)
    assert found == [False, False, True, True, False, True]


def still(time: float, q: np.ndarray, up: np.ndarray, elapsed: float) -> State:
    state = State(time, q, dq=np.zeros(MODEL.n), up=up, gyro=np.zeros(3))
    state.elapsed = elapsed
    return state


def swing_target(config: dq.Config, q: np.ndarray, before: np.ndarray, up: np.ndarray, ticks: int) -> np.ndarray:
    """Return the target of the left foot after some states in support on the right one, position and quaternion.

    In the double support before it the vertical is `before` in axes of the left sole, then `up` in those of the right.
    """
    walk = prepared(config)
    both = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q)
    walk.observe(both, Kinematics(MODEL, q, Foot.LEFT, before), still(1.0, q, before, 0.0))
    stands = Footprint.of(Kinematics(MODEL, q, Foot.RIGHT).pose(MODEL.soles[Foot.LEFT].frame))
    phase = walk.phase(PhaseKind.SINGLE_SUPPORT, Foot.RIGHT, q, stands.pose)
    for k in range(ticks + 1):
        kin = Kinematics(MODEL, q, Foot.RIGHT, up)
        assert walk.observe(phase, kin, still(1.0 + config.dt * (k + 1), q, up, config.dt * k)) is None
    (target,) = (task.target for task in phase.tasks if isinstance(task, FollowPose))
    return target.numbers[:7]


def inclined(degrees: float) -> np.ndarray:
    """Return the vertical in axes of a sole that is inclined about its x axis."""
    return np.array([0.0, math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])


@pytest.mark.parametrize(("latency", "late"), [(0.0, 0.0), (0.0, 0.03), (0.02, 0.0), (0.04, 0.02)])
def test_a_delay_moves_foot_pressure_and_reference_ahead(
    latency: float, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With D, the delay less a period: the foot is down 1.4 D early, the reference of the CoM ahead by 0.75 D.

    With ``dynamic.land_late`` the foot is down later.

    In double support the plan's pressure is that of D before the command acts: until then one foot is in the air.
    """
    config = CONFIG.updated({"servo.latency": latency, "servo.assumed_latency": latency, "dynamic.catch": False})
    q, up, drive = MODEL.posture(config.standing.posture), inclined(0.0), Drive.of(config, MODEL)
    ahead = max(drive.delay - config.dt, 0.0)
    down, later = config.standing.swing_duration - 1.4 * ahead, config.updated({"dynamic.land_late": late})
    heights = [swing_target(later, q, up, up, math.ceil((down + late) / config.dt) + k)[2] for k in (-3, 0)]
    level = swing_target(later, q, up, up, 200)[2]
    assert heights[0] > level + 1e-6
    assert heights[1] == pytest.approx(level, abs=1e-9)

    walk = prepared(config)
    both = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q)
    kin, omega = Kinematics(MODEL, q, Foot.LEFT, up), walk.pendulum.omega
    walk.observe(both, kin, still(1.0, q, up, 0.0))
    planned, time, before = walk._reference, 1.0 + config.dt, copy.deepcopy(walk._now)
    walk.observe(both, kin, still(time, q, up, config.dt))
    now, (c, xi) = walk._now, com_and_xi(kin, still(time, q, up, 0.0), omega)
    led = converging(now.c, now.xi, planned.at(config.dt + 0.75 * ahead)[0], omega, 0.75 * ahead)
    np.testing.assert_allclose(walk._targets["com"].numbers, np.concatenate(led), rtol=1e-12)
    _, xi = when_acting(Moving(*before.compiled), time, c, xi)
    (due, _), (_, z) = (planned.at(config.dt + drive.delay - less) for less in (0.0, ahead))
    fed = fed_back(z, due, xi, walk._gain, 0.0, *walk._support, config.standing.pressure_margin)
    np.testing.assert_allclose(now.pressure, fed, rtol=1e-12)


@pytest.mark.parametrize("latency", [0.0, 0.04])
def test_the_swing_foot_leaves_a_tipped_sole_and_lands_on_the_ground(latency: float) -> None:
    """With a delay only if the sole tips by more than 60 degrees/s times it, here 2.25 degrees."""
    changes = {"servo.latency": latency, "servo.assumed_latency": latency, "dynamic.catch": False}
    config, q = CONFIG.updated(changes), MODEL.posture(CONFIG.standing.posture)
    stands, up = Kinematics(MODEL, q, Foot.RIGHT).point(MODEL.soles[Foot.LEFT].frame), inclined(2.0)
    begun, landed = (swing_target(config, q, inclined(0.0), up, ticks)[:3] for ticks in (0, 80))
    assert begun == pytest.approx(stands, abs=2e-4)
    assert up @ landed == pytest.approx(up @ stands if latency else 0.0, abs=1e-3)  # 3.3 mm above the ground


def test_the_ground_stays_as_it_is_when_the_base_changes_to_a_turned_foot() -> None:
    """On a slope the sole does not tip, although the vertical has other coordinates in its axes."""
    config, q = CONFIG.updated({"dynamic.catch": False}), MODEL.posture(CONFIG.standing.posture)
    q[MODEL.joint_names.index("l_hip_z")] = 0.4
    turn = Footprint.of(Kinematics(MODEL, q, Foot.RIGHT).pose(MODEL.soles[Foot.LEFT].frame))
    before = inclined(6.0)
    up = DQ(turn.pose).P().Ad(DQ([0.0, *before])).vec3()
    assert np.linalg.norm(up - before) > 0.03
    assert swing_target(config, q, before, up, 80)[2] == pytest.approx(0.0, abs=2e-4)


@pytest.mark.parametrize(
    ("length", "impulse", "part"), [(0.0, 0.4, 0.5), (0.0, 0.6, 0.1), (0.05, 0.75, 0.5), (0.05, 0.7, 0.1)]
)
def test_a_push_that_tips_the_sole_outwards_is_caught(length: float, impulse: float, part: float) -> None:
    """A swing foot that lands, or is held, in the plane of the tipped sole carries no weight.

    The trunk must not be thrown against the largest one of these pushes, and the sole that the last one tips must
    not be taken for uneven ground.
    """
    config = overlaid(CONFIG, "physics").updated({"gait.step_length": length, "qp.solver": "daqp"})
    assert not pushed(config, Push("left", 0.5 * math.pi, impulse, part=part))


@pytest.mark.parametrize(
    ("bent", "behind", "moves", "delay", "stopped"),
    [
        (0.3, 0.02, 0.0, 0.0, True),
        (0.3, 0.012, 0.0, 0.0, False),  # the legs follow their path less well
        (0.3, 0.02, 3.0, 0.0, False),  # it catches up, or is moved by a support that tips
        (0.0, 0.02, 0.0, 0.0, False),  # it stands
        (0.3, 0.02, 0.0, 0.04, False),
        (0.3, 0.03, 0.0, 0.04, True),
    ],
)
def test_a_foot_is_stopped_in_the_air_at_rest_behind_its_path(
    bent: float, behind: float, moves: float, delay: float, stopped: bool
) -> None:
    walk = prepared(CONFIG)
    q, dq = walk.posture.copy(), np.zeros(MODEL.n)
    q[MODEL.joint_names.index("r_knee_y")] += bent
    dq[MODEL.joint_names.index("r_knee_y")] = moves
    kin = Kinematics(MODEL, q, Foot.LEFT)
    phase = walk.one_foot(Foot.LEFT, kin, kin.pose(kin.swing))
    velocity = np.array([0.2, 0.0])
    place = kin.point(kin.swing)[:2] + np.array([behind, 0.0]) + delay * velocity
    found = walk._stopped(phase, kin, State(1.0, q, dq), place, velocity, delay, 0.1)
    assert (found is not None) is stopped


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"servo.latency": 0.02, "servo.assumed_latency": 0.02},
        {"gait.step_length": 0.126, "gait.most_length": 0.126, "dynamic.quicken": 0.08, "dynamic.aim_inside": 0.0},
        {"gait.steps": 0, "gait.footsteps": ["0.05 0 0 0"] * 10},
    ],
)
def test_a_foot_that_an_obstacle_stops_lands_there(changes: dict[str, object], tmp_path: Path) -> None:
    """Pushed on it makes the robot fall. Afterwards there are steps on the spot, and no commanded footsteps."""
    ahead = {"gait.steps": 10, "physics.rise": 0.05, "physics.stairs_at": 0.15}
    config = overlaid(CONFIG, "physics").updated({**ahead, "qp.solver": "daqp", **changes})
    plant, controller = make_plant("physics", config, MODEL), make_controller(config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    stopped = [k for k, phase in enumerate(trace.phases) if "obstacle" in phase.decision]
    assert stopped
    assert all(later - k > 6 for k, later in itertools.pairwise(stopped))
    assert len(trace.phases) == (stopped[0] + 4 if config.gait.footsteps else 24)
    bag.write(trace, tmp_path / "bag")
    missed = [found["message"] for found in report(analyse(bag.read(tmp_path / "bag")))["violations"]]
    assert any(trace.phases[stopped[0]].decision in message for message in missed)


CLIMB = with_files(overlaid(CONFIG, "physics"), [Path("climb")]).updated({"qp.solver": "daqp"})


@pytest.mark.parametrize(("rise", "onto"), [(0.02, True), (0.035, True), (0.06, False)])
def test_a_walk_climbs_what_has_stopped_it_unless_that_is_too_high(rise: float, onto: bool) -> None:
    """The foot is to land at 15 mm, and stays where it bears weight."""
    config = CLIMB.updated({"gait.steps": 10, "physics.rise": rise, "physics.stairs_at": 0.2})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    heights = [DQ(plant.truth.soles[foot]).translation()[2] for foot in Foot]
    assert heights == pytest.approx([onto * rise] * 2, abs=1e-3)


def test_a_walk_that_cannot_climb_as_high_says_so() -> None:
    with pytest.raises(ConfigError, match=r"gait\.climb: footstep 3, of the right foot: .* gait\.most_length is 0\.09"):
        prepared(CLIMB.updated({"gait.most_length": 0.09}))


@pytest.mark.parametrize("steps", [0, 4])
def test_what_is_left_of_a_commanded_footprint_ends_when_the_feet_are_put_together(steps: int) -> None:
    """Also a side or turn that no other step of the walk has; it would step on the spot for ever."""
    walk = prepared(CONFIG.updated({"gait.steps": steps}))
    walk._done, step, together = steps, np.array([0.1, 1e-4, 1e-4]), False
    walk.stop()
    for done in range(steps, steps + 20):
        step, together = walk._after(step, done, Foot.LEFT)
        if together:
            return
    pytest.fail(f"the last step is {step}")


@pytest.mark.long
@pytest.mark.parametrize("latency", [0.0, 0.02])
def test_three_stairs_are_climbed_by_touch(latency: float) -> None:
    changes = {"servo.latency": latency, "servo.assumed_latency": latency, "gait.steps": 60}
    config = CLIMB.updated({**changes, "physics.rise": 0.025, "physics.stairs": 3})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    assert all(DQ(plant.truth.soles[foot]).translation()[2] > 0.07 for foot in Foot)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("length", "latency", "falls"),
    [
        (0.0, 0.0, {0.4: 0, 0.45: 0, 0.55: 0, 0.6: 0}),
        (0.05, 0.0, {0.3: 0, 0.5: 0, 0.7: 0}),
        (0.05, 0.02, {0.25: 0, 0.3: 0}),
    ],
)
def test_pushes_of_every_direction_at_every_part_of_a_step(
    length: float, latency: float, falls: dict[float, int]
) -> None:
    """Several impulses, because their limits are not monotone; `falls` is the number of falls allowed at each."""
    changes = {"gait.step_length": length, "servo.latency": latency, "servo.assumed_latency": latency}
    config = overlaid(CONFIG, "physics").updated({**changes, "qp.solver": "daqp"})
    parts, angles = (0.1, 0.25, 0.5, 0.75), 0.25 * math.pi * np.arange(8)
    points = [(foot, part, float(angle)) for foot in ("left", "right") for part in parts for angle in angles]
    for impulse, allowed in falls.items():
        fell = [p for p in points if pushed(config, Push(p[0], p[2], impulse, part=p[1]))]
        stood = len(points) - len(fell)
        print(f"\n{2.0 * length:g} m/s, {1e3 * latency:g} ms, {impulse} N s: {stood} of {len(points)} stood")
        assert len(fell) <= allowed


# ---------------------------------------------------------------------- no state is answered late


@pytest.mark.parametrize("name", ["poppy", "poppy_dynamic"])
def test_no_file_is_parsed_during_a_walk(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To parse a URDF takes 60 ms, too long for a walk in real time."""
    config = overlaid(dq.load(name), "physics")
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def parse(*_: object) -> None:
        pytest.fail("a file is parsed")

    for module in ("robot.urdf.Urdf.__init__", "walks.dynamic.recovery.load", "support.strict_yaml.read"):
        monkeypatch.setattr(f"dqwalk_ros.{module}", parse)
    for state, _ in closed_loop(controller, plant):
        if controller.phase.kind is PhaseKind.SINGLE_SUPPORT and state.time > controller.phase_began + 0.1:
            return
    pytest.fail("no single support began")


@pytest.mark.parametrize(
    ("name", "plant", "changes"),
    [
        *((name, "physics", {"gait.steps": steps}) for name in ("poppy", "poppy_dynamic") for steps in (20, 0)),
        ("poppy", "poppy", {}),  # without an inertial sensor
        ("paper", "integrator", {}),
    ],
)
def test_warming_up_evaluates_every_kind_of_phase(
    name: str, plant: str, changes: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is compiled in the middle of a step stops the robot for seconds."""
    evaluated, loads = [], []
    evaluate, update = Phase.evaluate, FootLoads.update
    monkeypatch.setattr(Phase, "evaluate", lambda one, *rest: evaluated.append(one.kind) or evaluate(one, *rest))
    monkeypatch.setattr(FootLoads, "update", lambda *given: loads.append(update(*given)) or loads[-1])
    warm_up(overlaid(dq.load(name), plant).updated(changes), MODEL)
    assert {PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT} <= set(evaluated)
    assert loads[0] is not None


def test_warming_up_evaluates_a_walk_that_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    """A walk of its own, in whose `observe` an attribute is missing, would end the node before it begins."""
    monkeypatch.setattr(Walk, "prepare", lambda walk: setattr(walk, "known", None))
    monkeypatch.setattr(Walk, "observe", lambda walk, *_: walk.known)
    warm_up(dq.load("paper"), dq.load_model(dq.load("paper").robot))


# ---------------------------------------------------------------------- tasks


def test_follow_pose_feeds_the_target_velocity_forward() -> None:
    kin = Kinematics(MODEL, random_posture(5), Foot.LEFT)
    x = DQ(kin.pose(kin.swing))
    place, velocity = np.array([*x.translation(), *x.vec4()[:4]]), np.arange(6.0)
    task = FollowPose(name="swing", frame=kin.swing, target=Target(place, velocity), eta=12.0, lever=0.2)
    e, _ = values(task, kin)
    assert e == pytest.approx(np.zeros(6), abs=1e-9)
    s = Observer(task.watches, kin.tree)(kin)[0]
    assert -task.evaluate(s)[2] == pytest.approx(velocity * [1, 1, 1, 0.2, 0.2, 0.2])


# ---------------------------------------------------------------------- the walk


def test_sequence_of_phases() -> None:
    walk = DynamicWalk(CONFIG.updated({"gait.steps": 2}), MODEL)
    names, phase, q = [], None, walk.posture
    while (begins := walk.following(phase, Kinematics(MODEL, q, Foot.LEFT))) is not None:
        phase = walk.phase(begins.kind, begins.support, q, begins.swing_target)
        names.append(phase.name)
    left, right = "left", "right"
    assert names == [
        "stance/left",
        *(f"{kind}/{foot}" for foot in (left, right, left) for kind in ("double_support", "single_support")),
        "stance/right",
    ]
    assert len(names) == DynamicWalk.phases(walk.config)


@pytest.mark.parametrize("kind", PhaseKind)
def test_a_phase_is_that_of_a_new_walk_and_assembled_once_for_each_kind_and_foot(kind: PhaseKind) -> None:
    q, walk, new = MODEL.posture(CONFIG.standing.posture), prepared(CONFIG), prepared(CONFIG)
    later = q + 0.02 * np.sin(np.arange(MODEL.n))
    steps = [walk.footsteps.wanted(Foot.LEFT, length, 0.0, 0.0) for length in (0.05, 0.08)]
    first = walk.phase(kind, Foot.LEFT, q, steps[0])
    first.evaluate(q)
    again, other = (one.phase(kind, Foot.LEFT, later, steps[1]) for one in (walk, new))
    assert again.assembly is first.assembly
    assert again.q_start is not first.q_start
    expected, found = other.evaluate(q, elapsed=0.0), again.evaluate(q, elapsed=0.0)
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_array_equal(found.problem.numbers, expected.problem.numbers)


def test_a_steered_walk_ramps_its_steps_and_stops_with_feet_together() -> None:
    walk = DynamicWalk(CONFIG.updated({"gait.steps": 0}), MODEL)
    stance = walk.phase(PhaseKind.STANCE, Foot.LEFT, walk.posture)
    assert not stance.rule.is_over(lambda: 0.0, 100.0)  # it waits
    fastest = CONFIG.gait.most_length / (0.5 - DYNAMIC.quicken)
    assert fastest == pytest.approx(0.2, abs=0.005)
    assert walk.steer(1.0, 0.0, 0.0)[0] == pytest.approx(fastest)
    assert stance.rule.is_over(lambda: 0.0, 100.0)
    step, lengths = np.zeros(3), []
    for k in range(6):
        step, _ = walk._after(step, k, Foot.LEFT)
        lengths.append(step[0])
    assert lengths == pytest.approx(CONFIG.gait.most_length * np.array([0.25, 0.5, 0.75, 1.0, 1.0, 1.0]))
    walk.steer(0.0, 0.0, 0.0)
    for _ in range(3):
        step, together = walk._after(step, 9, Foot.LEFT)
        assert not together
    assert walk._after(step, 9, Foot.LEFT)[1]


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.17, 0.27])
def test_a_steered_walk_takes_the_steps_of_its_velocity(speed: float) -> None:
    """Longer steps are quicker."""
    walk = DynamicWalk(FAST.updated({"gait.steps": 0}), MODEL)
    assert walk.steer(speed, 0.0, 0.1) == pytest.approx((speed, 0.0, 0.1))
    length, _, turn = walk._step_at((speed, 0.0, 0.1))
    double, single = walk._durations(length)
    assert length / (double + single) == pytest.approx(speed)
    assert turn / (double + single) == pytest.approx(0.1)
    assert double + single <= 0.5


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"dynamic.quicken": 0.2}, r"lasts 0 s.*lower dynamic\.quicken \(0\.2 s\)"),
        ({"dynamic.quicken": 0.05, "dt": 0.09}, r"less than dt, 0\.09 s"),
    ],
)
def test_a_step_without_time_for_a_support_is_refused(values: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        DynamicWalk(CONFIG.updated(values), MODEL)


def test_the_trunk_keeps_its_posture_over_many_steps() -> None:
    """At 0.30 m/s; a trunk that moves the CoM is at the limit of its pitch in every step."""
    config = CONFIG.updated({"gait.steps": 12, "gait.step_length": 0.126, "gait.most_length": 0.126})
    config = config.updated({"dynamic.quicken": 0.08})
    trace = simulate(make_controller(config, MODEL), make_plant("integrator", config, MODEL))
    assert trace.finished, trace.notes
    bent = {
        name: np.degrees(trace.q[:, MODEL.joint_names.index(name)]) for name in ("abs_y", "bust_y", "abs_z", "bust_x")
    }
    assert max(np.abs(bent[name]).max() for name in ("abs_y", "bust_y")) < 1.0
    assert max(abs(bent[name][-1]) for name in bent) < 2.0


@pytest.mark.long
@pytest.mark.parametrize("noise", [False, True])
def test_cmd_vel_steers_the_dynamic_walk_on_a_circle(noise: bool) -> None:
    """Of 0.5 m, to 3 cm, and round to 5 mm; a sole that slips at the landing of the other would make it larger."""
    sensors = {"attitude_noise": 0.004, "gyro_noise": 0.02, "encoder": 0.001534, "velocity_filter": 0.01, "seed": 1}
    changes = {f"sensors.{key}": value for key, value in sensors.items()} if noise else {}
    config = overlaid(CONFIG, "physics").updated({"gait.steps": 0, "qp.solver": "daqp", **changes})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def steer(time: float) -> None:
        controller.steer(0.08, 0.0, 0.16) if time < 46.0 else controller.stop()

    trace = simulate(controller, plant, before_step=steer, max_time=60.0)
    assert trace.finished, trace.notes
    assert trace.physics is not None
    second = np.ones(round(1.0 / config.dt)) * config.dt  # the mean over a second is without the sway
    walking = (trace.time > 4.0) & (trace.time < 45.0)
    pelvis = DQ(trace.physics.pelvis).translation()
    x, y = (np.convolve(pelvis[:, k], second, "same")[walking] for k in range(2))
    fit, *_ = np.linalg.lstsq(np.column_stack([2.0 * x, 2.0 * y, np.ones_like(x)]), x**2 + y**2, rcond=None)
    radius = math.sqrt(fit[2] + fit[0] ** 2 + fit[1] ** 2)
    off = np.abs(np.hypot(x - fit[0], y - fit[1]) - radius).max()
    print(f"\ncircle of {radius:.3f} m, round to {1e3 * off:.1f} mm")
    assert radius == pytest.approx(0.5, abs=0.03)
    assert off < (0.008 if noise else 0.005)


@pytest.mark.long
@pytest.mark.parametrize("latency", [0.0, 0.02])
@pytest.mark.parametrize("speed", [0.10, 0.17])
def test_a_biped_with_ankle_roll_walks_dynamically(speed: float, latency: float) -> None:
    """With Poppy's parameters, but its aims and its lateral frequency."""
    biped = dq.load(str(Path(__file__).parents[1] / "data" / "biped12.yaml"))
    own = ("dynamic.aim_ahead", "dynamic.aim_inside", "dynamic.side_frequency", "standing.posture")
    tree = strict_yaml.read(find_share("config", "poppy_dynamic.yaml").read_text(), source="poppy_dynamic.yaml")
    sections = tree["/**"]["ros__parameters"]
    common = {
        f"{name}.{key}": value
        for name in ("task", "standing", "dynamic", "servo", "joints")
        for key, value in sections[name].items()
        if f"{name}.{key}" not in own
    }
    changes = {
        "gait.style": "dynamic", "gait.steps": 14, "gait.step_length": 0.5 * speed, "gait.most_length": 0.1,
        "servo.stiffness": 200.0, "servo.assumed_stiffness": 200.0, "dynamic.upright_weight": 1.0,
        "dynamic.catch_side": 0.05, "servo.latency": latency, "servo.assumed_latency": latency,
    }  # fmt: skip
    config = overlaid(biped, "physics").updated({**common, **changes})
    model = dq.load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant("physics", config, model))
    found = report(analyse(trace))
    print(f"\n{speed} m/s, {1e3 * latency:.0f} ms: tilt {math.degrees(found['physics']['tilt']['value']):.2f} degrees")
    assert trace.finished, trace.notes
    assert found["ok"]


def test_the_commanded_acceleration_is_that_of_the_commands_and_zero_after_a_gap() -> None:
    walk, q = prepared(CONFIG), MODEL.posture(CONFIG.standing.posture)
    a, dt = np.linspace(-3.0, 3.0, MODEL.n), CONFIG.dt
    phase, kin = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q), Kinematics(MODEL, q, Foot.LEFT, inclined(0.0))
    walk.observe(phase, kin, still(0.0, q, kin.up, 0.0))

    def accelerated(time: float, u: np.ndarray) -> np.ndarray:
        walk.effort(phase, kin, still(time, q, kin.up, time), u)
        return walk._acceleration.copy()

    found = [accelerated(k * dt, a * k * dt) for k in range(40)]
    assert np.abs(found[0]).max() == 0.0
    assert found[-1] == pytest.approx(a, abs=1e-3)
    assert np.abs(accelerated(40 * dt + 0.2, 2.0 * a)).max() == 0.0


def test_the_swing_foot_lands_gently() -> None:
    """And not early: then, or if the ground stops it, it unloads the supporting sole."""
    config = overlaid(CONFIG, "physics").updated({"gait.steps": 3, "qp.solver": "daqp"})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    assert trace.finished, trace.notes
    assert trace.physics is not None
    force, weight = {foot: trace.physics.wrenches[foot][:, 2] for foot in Foot}, 9.81 * MODEL.mass
    pairs = itertools.pairwise(trace.phases)
    landings = [(record, after.time) for record, after in pairs if record.kind is PhaseKind.SINGLE_SUPPORT]
    for record, end in landings:
        near = np.flatnonzero(np.abs(trace.time - end) < 0.05)
        touch = near[force[record.support.other][near] > 0.5][0]
        assert trace.time[touch] > end - 0.0125
        after = slice(touch, touch + round(0.05 / config.dt))
        assert force[record.support][after].min() > 0.25 * weight
        assert force[record.support.other][after].max() < 0.9 * weight
    assert len(landings) == 4


NOISY = overlaid(CONFIG, "physics").updated(
    {
        "servo.types": ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"], "qp.solver": "daqp",
        "sensors.attitude_noise": 0.004, "sensors.gyro_noise": 0.02, "sensors.encoder": 0.001534,
        "sensors.velocity_filter": 0.01,
    }
)  # fmt: skip
FAST = NOISY.updated(
    {"gait.step_length": 0.126, "gait.most_length": 0.126, "dynamic.quicken": 0.08, "dynamic.aim_inside": 0.0}
)


def test_a_push_is_confirmed_for_a_time_and_by_two_states() -> None:
    found = [DynamicWalk(CONFIG.updated({"dt": dt}), MODEL)._confirmed for dt in (0.0025, 0.005, 0.02)]
    assert found == [6, 3, 2]


@pytest.mark.parametrize("gain", [127, pytest.param(254, marks=pytest.mark.long)])
def test_poppy_as_built_walks_dynamically(gain: int) -> None:
    changes = {"gait.steps": 10, "servo.p_gain": gain}
    config = overlaid(dq.load("poppy_dynamic_50hz"), "poppy_as_built").updated(changes)
    model = dq.load_model(config.robot)
    assert model.mass == pytest.approx(3.2)
    trace = simulate(make_controller(config, model), make_plant("poppy_as_built", config, model))
    assert trace.finished, trace.notes
    physics = report(analyse(trace))["physics"]
    assert not physics["fallen"]
    assert math.degrees(physics["tilt"]["value"]) < 1.0
    assert physics["cop_inside"] > 0.996  # a sole bears its weight only once it is down


ON_RUBBLE = CONFIG.updated(
    {
        "gait.steps": 14, "gait.step_length": 0.04, "servo.types": ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"],
        "servo.p_gain": 254, "physics.rubble": 0.005, "sensors.attitude_noise": 0.004, "sensors.gyro_noise": 0.02,
        "sensors.encoder": 0.001534, "sensors.velocity_filter": 0.01,
    }
)  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(("overlays", "up"), [(["stairs"], 0.075), (["stairs", "stairs_down"], -0.075)])
def test_three_stairs_are_walked_by_footsteps(overlays: list[str], up: float) -> None:
    config = with_files(overlaid(CONFIG, "physics"), [Path(name) for name in overlays]).updated({"qp.solver": "daqp"})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    found = report(analyse(trace))
    assert found["ok"], found["violations"]
    assert [DQ(plant.truth.soles[foot]).translation()[2] for foot in Foot] == pytest.approx([up, up], abs=1e-3)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_nearly_all_walks_on_rubble_stand() -> None:
    """With the same aim as on level ground five of these fall."""
    stood = sum(robustness.walk(ON_RUBBLE, 0, {"sensors.seed": seed}).stood for seed in range(1, 21))
    print(f"\nrubble of 5 mm: {stood} of 20 stood")
    assert stood >= 18


def test_poppy_walks_in_physics_and_recovers_from_a_push(tmp_path: Path) -> None:
    config = CONFIG.updated({"gait.steps": 4, "dynamic.stop_duration": 0.6})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def push(time: float) -> None:  # outward, in the middle of the second step, in support on the right foot
        due = controller.phase_index == 4 and 0.2 <= time + begin - controller.phase_began < 0.3
        plant.push(np.array([0.0, -4.0 if due else 0.0, 0.0]))

    begin = plant.state.time
    trace = simulate(controller, plant, before_step=push)
    assert trace.finished, trace.notes
    # step lengths 25, 50, 50 and 25 mm
    assert trace.physics is not None
    pelvis = DQ(trace.physics.pelvis[[0, -1]]).translation()
    assert pelvis[1, 0] - pelvis[0, 0] == pytest.approx(0.15, abs=0.04)
    assert trace.phases[2].decision == ""  # before the push
    pushed = [record for record in trace.phases[4:] if record.decision]
    assert pushed
    bag.write(trace, tmp_path / "bag")
    again = bag.read(tmp_path / "bag")
    assert [record.name for record in again.phases] == [record.name for record in trace.phases]
    for record, read in zip(trace.phases, again.phases, strict=True):
        if record.swing_target is not None:
            assert read.swing_target == pytest.approx(record.swing_target, abs=1e-12)
