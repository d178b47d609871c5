"""The law from commands to the goals of servos: gate, clamps, window, limits, rounding, rate and delay."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dynamixel_bus import MOTORS, TYPES, Memory

from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants import servo_goals
from dqwalk_ros.plants.poppy.plant import PoppyPlant
from dqwalk_ros.plants.servo_goals import JUMPS, AngleGate, ServoGoals
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.servos import P_MOST, Drive, Servos, goal_windows

CONFIG = load("poppy")
MODEL = load_model(CONFIG.robot)
N = MODEL.n
KNEE = MODEL.joint_names.index("l_knee_y")
POSTURE = MODEL.posture(CONFIG.standing.posture)
DT = 0.005
TIMEOUT = 0.1


def law_of(config: Config = CONFIG, q: Any = None, model: Any = MODEL, *, simulated: bool = False) -> ServoGoals:
    """Return the law at angles q (n,) [rad], measured at the time zero."""
    law = ServoGoals.of(config, model, lambda: TIMEOUT, simulated=Servos.of(config, model) if simulated else None)
    law.gate.use(POSTURE if q is None else q, 0.0)
    law.begin()
    return law


def settings(**changes: Any) -> Config:
    return CONFIG.updated({"servo.resolution": 0.0, **{f"servo.{name}": value for name, value in changes.items()}})


# ---------------------------------------------------------------------- velocities


def test_goals_are_delayed_and_held() -> None:
    law, seen = law_of(settings(latency=0.02, rate=50.0), np.zeros(N), simulated=True), []
    for k in range(20):
        law.measure(np.zeros(N), DT * k)
        law.command(np.full(N, 0.1), None, DT * k, DT)
        seen.append(law.output(DT * k)[0][0])
    steps = [0.1 * DT * (1 + 4 * max((k - 4) // 4, -1)) if k >= 4 else 0.0 for k in range(20)]
    np.testing.assert_allclose(seen, steps, atol=1e-12)


def test_goals_for_which_nobody_asks_are_not_kept() -> None:
    """A controller judges each command by this law, and asks for no goal; it walks for hours."""
    kept = []
    for count in (20, 200):
        law = law_of(settings(latency=0.02), np.zeros(N), simulated=True)
        for k in range(count):
            law.measure(np.zeros(N), DT * k)
            law.command(np.full(N, 0.1), None, DT * k, DT)
        kept.append(len(law._queue))
    assert kept == [4, 4]
    np.testing.assert_allclose(law.output(DT * k)[0], law.wanted - 4 * 0.1 * DT, atol=1e-12)


def test_the_goals_of_simulated_servos_are_rounded() -> None:
    law = law_of(CONFIG.updated({"servo.resolution": 0.01}), np.zeros(N), simulated=True)
    law.command(np.full(N, 1.2), None, 0.0, DT)  # 0.006 rad
    np.testing.assert_allclose(law.output(0.0)[0], 0.01, atol=1e-12)
    np.testing.assert_allclose(law.wanted, 0.006, atol=1e-12)


@pytest.mark.parametrize("latency", [0.0, 0.02, 0.033])
def test_goals_stay_near_the_position_at_which_the_command_finds_the_joint(latency: float) -> None:
    """A delayed joint that follows is not held back; one that is blocked is left behind by the window only."""
    config = settings(assumed_latency=latency, window=0.006)
    assert Drive.of(config, MODEL).delay == pytest.approx(latency)
    start, u = np.clip(np.full(N, 0.1), MODEL.q_min, MODEL.q_max), np.full(N, 1.0)
    follows, blocked = law_of(config, start), law_of(config, start)
    free = MODEL.q_max - start > 0.25
    for k in range(40):
        time = k * DT
        follows.measure(start + max(time - latency, 0.0), time)
        follows.command(u, None, time, DT)
        np.testing.assert_allclose((follows.wanted - start)[free], time + DT, atol=1e-12)
        blocked.measure(start, time)
        blocked.command(u, None, time, DT)
    for k in range(40, 40 + math.ceil(latency / DT) + 1):
        blocked.measure(start, k * DT)
        blocked.command(np.zeros(N), None, k * DT, DT)
    np.testing.assert_allclose((blocked.wanted - start)[free], config.servo.window, atol=1e-12)


@pytest.mark.parametrize("dt", [0.002, 0.02])
@pytest.mark.parametrize("u", [0.5, -0.5])
def test_a_goal_beyond_the_window_returns_with_its_time_constant(u: float, dt: float) -> None:
    """The goal of a blocked joint is at most u T beyond the window, and returns as exp(-t / T) whatever the period."""
    window, time_constant, knee = 0.006, 0.06, np.eye(N)[KNEE]
    law = law_of(settings(window=window, window_time=time_constant))
    times = dt * np.arange(round(2.0 * time_constant / dt) * 5 + 1)
    for time in times:
        law.measure(POSTURE, time)
        law.command(u * knee, None, time, dt)
    beyond = np.sign(u) * (law.wanted - POSTURE)[KNEE] - window
    assert 0.8 * abs(u) * time_constant < beyond <= abs(u) * time_constant
    for time in times[-1] + dt * np.arange(1, round(time_constant / dt) + 1):
        law.measure(POSTURE, time)
        law.command(0.0 * knee, None, time, dt)
    remaining = np.sign(u) * (law.wanted - POSTURE)[KNEE] - window
    assert remaining == pytest.approx(math.exp(-1.0) * beyond)


@pytest.mark.parametrize("u", [1.0, -1.0])
def test_a_window_extends_by_the_lag_in_the_direction_of_motion_only(u: float) -> None:
    """The goal of a joint that is blocked, then of one that is pulled ahead of its goal."""
    window, lag, knee = 0.006, 0.03, np.eye(N)[KNEE]
    law = law_of(settings(window=window, window_lag=lag))
    for k in range(20):
        law.measure(POSTURE, k * DT)
        law.command(u * knee, None, k * DT, DT)
    np.testing.assert_allclose((law.wanted - POSTURE)[KNEE], u * (window + lag), atol=1e-12)
    law = law_of(settings(window=window, window_lag=lag))
    for k in range(20):
        pulled = POSTURE + 0.01 * u * k * knee
        law.measure(pulled, k * DT)
        law.command(1e-3 * u * knee, None, k * DT, DT)
    np.testing.assert_allclose((pulled - law.wanted)[KNEE], u * window, atol=1e-12)


def test_the_torque_at_the_edge_of_a_window_does_not_depend_on_the_p_gain() -> None:
    types = [f"{name}={MOTORS[name].type}" for name in MODEL.joint_names]
    stiff = settings(types=types, p_gain=P_MOST)
    np.testing.assert_array_equal(goal_windows(stiff, MODEL), stiff.servo.window)
    for gain in (127, 32):
        soft = settings(types=types, p_gain=gain)
        torques = [Servos.of(one, MODEL).stiffness * goal_windows(one, MODEL) for one in (soft, stiff)]
        np.testing.assert_allclose(*torques, rtol=1e-12)


@pytest.mark.parametrize("u", [1e3, -1e3, 1e300])
def test_velocities_are_clamped(u: float) -> None:
    law = law_of()
    assert law.command(np.full(N, u), None, 0.0, DT)
    far = np.sign(u) * MODEL.velocity_max * DT
    np.testing.assert_allclose(law.goal, np.clip(POSTURE + far, MODEL.q_min, MODEL.q_max), atol=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_outside_its_range_moves_towards_it_only(side: float) -> None:
    q = (MODEL.q_max if side > 0.0 else MODEL.q_min) + side * 0.05
    law = law_of(q=q)
    for u, moved in ((1.0, 0.0), (0.0, 0.0), (-1.0, -DT)):
        law.command(np.full(N, side * u), None, 0.0, DT)
        np.testing.assert_allclose(law.goal, q + side * moved, atol=1e-12)


# ---------------------------------------------------------------------- torques


@pytest.mark.parametrize("torque", [60.0, 1200.0, 1e300, -1e300])
@pytest.mark.parametrize("stiffness", [60.0, 1e-3])
@pytest.mark.parametrize("limited", [True, False])
def test_a_torque_moves_a_goal_no_further_than_the_limits_and_no_faster_than_the_joint(
    torque: float, stiffness: float, limited: bool
) -> None:
    model = MODEL if limited else dataclasses.replace(MODEL, effort_max=np.full(N, np.inf))
    law = law_of(settings(assumed_stiffness=stiffness), model=model)
    before = law.goal
    for k in range(400):
        law.measure(POSTURE, k * DT)
        assert law.command(np.zeros(N), np.full(N, torque), k * DT, DT)
        assert (np.abs(law.goal - before) <= DT * MODEL.velocity_max + 1e-12).all()
        before = law.goal
    assert (law.goal >= MODEL.q_min).all()
    assert (law.goal <= MODEL.q_max).all()
    if limited:
        offset = np.clip(np.sign(torque) * MODEL.effort_max / stiffness, -math.pi, math.pi)
        np.testing.assert_allclose(law.goal, np.clip(POSTURE + offset, MODEL.q_min, MODEL.q_max), atol=1e-12)


def test_a_torque_against_the_damping_of_a_servo_is_not_part_of_its_limit() -> None:
    """What the servo itself subtracts at the commanded velocity: the motor has no more than its limit."""
    law = law_of(settings(assumed_lead=0.05, window=1.0))
    speed = np.zeros(N)
    speed[KNEE] = 2.0
    effort = MODEL.effort_max + 100.0
    for k in range(100):
        law.measure(POSTURE, k * DT)
        assert law.command(speed, effort, k * DT, DT)
    offset = law.goal - law.wanted
    np.testing.assert_allclose(offset[KNEE], MODEL.effort_max[KNEE] / 60.0 + 0.05 * 2.0, atol=1e-9)
    np.testing.assert_allclose(offset[KNEE + 1], MODEL.effort_max[KNEE + 1] / 60.0, atol=1e-9)


def test_without_torques_a_command_keeps_those_of_the_last() -> None:
    law = law_of()
    for k, torque in enumerate((1.0, None)):
        law.command(np.zeros(N), None if torque is None else np.full(N, torque), k * DT, DT)
    np.testing.assert_allclose(law.goal, POSTURE + 1.0 / 60.0, atol=1e-12)


# ---------------------------------------------------------------------- measured angles


def test_commands_have_an_effect_while_the_angles_are_recent() -> None:
    law, u = law_of(), np.full(N, 0.1)
    assert law.command(u, None, TIMEOUT, DT)
    goal = law.goal.copy()
    assert not law.command(u, np.ones(N), np.nextafter(TIMEOUT, 1.0), DT)
    np.testing.assert_array_equal(law.goal, goal)
    law.measure(POSTURE, 1.0)
    assert law.command(u, None, 1.0, DT)
    law.end()
    assert not law.command(u, None, 1.0, DT)


@pytest.mark.parametrize("off", [0.3, 1.5, -1.5, 1e9, 1e300, math.nan, math.inf])
def test_one_wrong_angle_has_no_effect_and_three_are_a_fault(off: float) -> None:
    law, wrong = law_of(), POSTURE.copy()
    wrong[KNEE] += off
    for k in range(1, 4):
        law.measure(wrong if k == 2 else POSTURE, k * DT)
        assert law.command(np.zeros(N), None, k * DT, DT)
        np.testing.assert_array_equal(law.goal, POSTURE)
    assert law.gate.rejected == 1
    for k in range(4, 7):
        assert not law.gate.fault
        law.measure(wrong, k * DT)
    assert law.gate.fault == "l_knee_y has jumped to another angle"
    law.measure(POSTURE, 7 * DT)
    assert not law.command(np.ones(N), None, 7 * DT, DT)
    law.begin()
    assert law.command(np.ones(N), None, 7 * DT, DT)


def test_a_wrong_angle_soon_after_the_last_one_is_compared_by_the_time_between_them() -> None:
    law = law_of()
    least = DT * MODEL.velocity_max[KNEE]  # the tolerance, for a late or early state
    for beyond, taken in ((1e-6, False), (-1e-6, True)):
        q = POSTURE + (least + beyond) * np.eye(N)[KNEE]
        assert law.measure(q, 1e-9 * (1.0 - beyond))[KNEE] == taken


def test_each_joint_has_its_own_time() -> None:
    gate = AngleGate(("a", "b"), np.ones(2), 0.0, longest=lambda: 0.05, timeout=lambda: TIMEOUT)
    gate.use(np.zeros(2), 0.0)
    taken = gate.measure(np.array([0.04, 0.04]), np.array([0.05, 0.03]), True)
    assert taken.tolist() == [True, False]
    assert gate.age(0.1) == pytest.approx(0.1)
    taken = gate.measure(np.array([0.04, 0.04]), np.array([0.05, 0.05]), True)
    assert taken.tolist() == [False, True], "an angle whose time has not changed is not new"
    assert gate.age(0.1) == pytest.approx(0.05)
    assert not gate.measure(np.full(2, 0.1), np.full(2, 9.0), True).any(), "a joint moves unseen for a while only"


def test_an_angle_is_used_at_the_start_once_three_in_a_row_agree() -> None:
    gate = AngleGate(("a",), np.ones(1), 0.01, longest=lambda: TIMEOUT, timeout=lambda: TIMEOUT)
    for k, q in enumerate((2.0, 0.0, 0.001, -1.0, 0.001, 0.002, 0.003)):
        assert not gate.known
        gate.measure(np.array([q]), np.array([1.0 + DT * k]), False)
    assert gate.q[0] == 0.003
    assert not gate.rejected
    for k in range(JUMPS):  # turned by hand
        assert gate.q[0] == 0.003
        gate.measure(np.array([1.0]), np.array([2.0 + DT * k]), False)
    assert gate.q[0] == 1.0
    assert not gate.fault
    gate.forget()
    assert not gate.known
    assert not gate.fresh(2.0)


def test_goals_that_the_servos_hold_remain_unless_they_are_far() -> None:
    law = law_of()
    held = POSTURE + np.array([0.1 if k % 2 else 1.0 for k in range(N)])
    law.begin(held=held)
    np.testing.assert_array_equal(law.goal, np.where(np.arange(N) % 2, held, POSTURE))


def test_a_blocked_joint_is_relieved() -> None:
    law = law_of()
    law.command(np.full(N, 1.0), np.ones(N), 0.0, DT)
    goal = law.goal.copy()
    law.relieve(KNEE)
    assert law.goal[KNEE] == law.wanted[KNEE] == POSTURE[KNEE]
    assert (np.delete(law.goal, KNEE) == np.delete(goal, KNEE)).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("speed", [None, 0.0, 0.3])
def test_a_joint_that_moves_against_its_full_torque_is_a_fault(side: float, speed: float | None) -> None:
    """Also if the window pulls the goal after it."""
    law, full = law_of(), MODEL.effort_max[KNEE] / CONFIG.servo.assumed_stiffness
    for k in range(1, 101):
        moved = 0.005 * k
        law.measure(POSTURE + side * moved * np.eye(N)[KNEE], k * DT)
        if speed is not None:
            law.command(np.full(N, -side * speed), None, k * DT, DT)
        if law.fault:
            break
    assert law.fault == "l_knee_y moved away from its goal at full torque"
    assert full + 0.2 < moved < full + 0.25
    assert not law.command(np.ones(N), None, k * DT, DT)
    law.forget()
    assert not law.fault


def test_a_joint_that_lags_or_is_deflected_or_comes_back_is_no_runaway() -> None:
    full = MODEL.effort_max[KNEE] / CONFIG.servo.assumed_stiffness
    lag = law_of(settings(window=1.0), np.clip(np.zeros(N), MODEL.q_min, MODEL.q_max))
    for k in range(1, 400):  # 0.1 rad behind a goal that moves to and fro
        time = k * DT
        lag.measure(np.clip(0.4 * np.sin(3.0 * time - 0.25) + 0.1, MODEL.q_min, MODEL.q_max), time)
        lag.command(np.full(N, 1.2 * np.cos(3.0 * time)), None, time, DT)
        assert not lag.fault
    loaded = law_of()
    for k in range(1, 400):  # a load that comes and goes
        loaded.measure(POSTURE + (full + 0.19) * np.sin(0.02 * k) * np.eye(N)[KNEE], k * DT)
        assert not loaded.fault


# ---------------------------------------------------------------------- one law for all plants


PERIOD = 0.02
ALL = CONFIG.updated(
    {
        "dt": PERIOD,
        "servo.window": 0.01,
        "servo.window_lag": 0.005,
        "servo.window_time": 0.01,
        "servo.p_gain": 127,
        "servo.types": [f"{name}={MOTORS[name].type}" for name in MODEL.joint_names],
        "servo.assumed_latency": 0.04,
        "servo.assumed_rate": 50.0,
    }
)
UNIT = math.radians(360.0 / 4095)
"""Step of the positions of an MX [rad]."""


def on_the_bus(q: np.ndarray) -> np.ndarray:
    """Return the nearest angles that the servos can measure."""
    out = []
    for name, angle in zip(MODEL.joint_names, q, strict=True):
        motor, kind = MOTORS[name], TYPES[MOTORS[name].type]
        out.append(motor.user(kind.degrees(kind.position(motor.servo(math.degrees(angle))))))
    return np.radians(out)


START = on_the_bus(POSTURE)
Step = Callable[[np.ndarray, np.ndarray, Any], np.ndarray]
"""Processes measured angles, velocities and torques (n,) of a period, and returns the goals (n,)."""


def physics_goals() -> Step:
    law, time = ServoGoals.of(ALL, MODEL, simulated=Servos.of(ALL, MODEL)), np.zeros(())
    law.gate.use(START, 0.0)
    law.begin()

    def step(q: np.ndarray, u: np.ndarray, effort: Any) -> np.ndarray:
        time[...] += PERIOD
        law.measure(q, float(time))
        law.command(u, effort, float(time), PERIOD)
        return law.goal

    return step


def drive_goals(make: Any) -> Step:
    from inside import state
    from ros2_control import Known

    one = make("drive", ALL)
    one.node._controllers = Known()
    out = one.got["forward_position_controller/commands"]

    def step(q: np.ndarray, u: np.ndarray | None, effort: Any) -> np.ndarray:
        one.clock.now += PERIOD
        one.send("joint_states", state(MODEL.joint_names, q, one.clock.now))
        if u is not None:
            torques = {} if effort is None else {"effort": effort}
            one.send("joint_velocity_commands", state(MODEL.joint_names, [], one.clock.now, velocity=u, **torques))
        return np.array(out[-1].data) if out else START

    for _ in range(JUMPS):
        step(START, None, None)
    return step


def poppy_goals() -> Step:
    memory = Memory(timed=False, **dict(zip(MODEL.joint_names, np.degrees(START), strict=True)))
    plant = PoppyPlant(ALL, MODEL, START, buses=memory.buses, clock=memory.clock, each=map)
    plant.activate()
    while not plant.ready:
        plant.hold(PERIOD)
        memory.clock.now += PERIOD
    memory.clock.now += 1.0

    def step(q: np.ndarray, u: np.ndarray, effort: Any) -> np.ndarray:
        memory.clock.now += PERIOD
        for name, angle in zip(MODEL.joint_names, q, strict=True):
            servo = memory.servo(name)
            servo.moved, servo.blocked = servo.kind.position(MOTORS[name].servo(math.degrees(angle))), True
        plant.read()
        plant.write(Command(memory.clock.now, u, effort), PERIOD)
        return np.array([memory.goal(name) for name in MODEL.joint_names])

    return step


def test_the_same_states_and_commands_give_the_same_goals_in_physics_drive_and_poppy(make: Any) -> None:
    """Joints that follow late, torques that come and go, velocities above the limits, one wrong angle."""
    physics, drive, poppy = physics_goals(), drive_goals(make), poppy_goals()
    rng, goals = np.random.default_rng(1), [START] * 3
    held_back = 0.0
    for k in range(45):
        q = on_the_bus(START + 0.2 * (goals[-3] - START) + (rng.normal(0.0, 0.002, N) if k else 0.0))
        if k == 20:
            q[KNEE] += 0.6
        u = rng.normal(0.0, 1.0, N) if k % 10 else rng.normal(0.0, 100.0, N)
        effort = None if k % 3 == 0 else rng.normal(0.0, 1.5, N)
        goals.append(physics(q, u, effort))
        held_back = max(held_back, float(np.abs(goals[-1] - goals[-2] - PERIOD * u).max()))
        np.testing.assert_allclose(drive(q, u, effort), goals[-1], atol=1e-9, err_msg=str(k))
        np.testing.assert_allclose(poppy(q, u, effort), goals[-1], atol=0.5 * UNIT + 1e-6, err_msg=str(k))
    assert held_back > 0.05, "the limits of the law have an effect"
    compiled = getattr(servo_goals._goals, "signatures", ["none, in `make mutation`"])
    assert len(compiled) == 1, "compiled once more while a robot moves"
