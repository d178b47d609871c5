"""Wrong sensor values and joints that do not follow: detected by contradictions, named, and the walk ends."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from inside import state
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes.fall_watch import Contradictions
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import State
from dqwalk_ros.plants.base import Inertial, upward
from dqwalk_ros.plants.servo_goals import ServoGoals
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.studies.robustness import assumed
from dqwalk_ros.walks.table import make_controller

CONFIG = overlaid(load("poppy"), "poppy_as_built")
MODEL = load_model(CONFIG.robot)
BEGIN = 0.6
"""When a sensor fault begins [s]."""
KNEE, HIP = MODEL.joint_names.index("l_knee_y"), MODEL.joint_names.index("l_hip_y")
Fault = Callable[[float, np.ndarray, Inertial], tuple[np.ndarray, Inertial]]


def slipped(angle: float) -> Fault:
    return lambda t, q, inertial: (q + angle * np.eye(MODEL.n)[KNEE], inertial)


def drifting(t: float, q: np.ndarray, inertial: Inertial) -> tuple[np.ndarray, Inertial]:
    return q - 0.1 * (t - BEGIN) * np.eye(MODEL.n)[KNEE], inertial


def frozen() -> Fault:
    kept: list[float] = []

    def fault(t: float, q: np.ndarray, inertial: Inertial) -> tuple[np.ndarray, Inertial]:
        kept.append(q[HIP])
        return np.where(np.arange(MODEL.n) == HIP, kept[0], q), inertial

    return fault


def turned(angle: float, axis: int) -> Fault:
    turn = np.zeros(4)
    turn[0], turn[1 + axis] = math.cos(0.5 * angle), math.sin(0.5 * angle)

    def fault(t: float, q: np.ndarray, inertial: Inertial) -> tuple[np.ndarray, Inertial]:
        return q, dataclasses.replace(inertial, orientation=(DQ(inertial.orientation) * DQ(turn)).vec4())

    return fault


def turning(t: float, q: np.ndarray, inertial: Inertial) -> tuple[np.ndarray, Inertial]:
    """Turn the inertial sensor by 20 degrees in 2 s, with a gyroscope that measures this."""
    t = min(t - BEGIN, 2.0)
    rate = math.radians(10.0) * np.eye(3)[1] * (t < 2.0)
    q, inertial = turned(math.radians(10.0) * t, 1)(t, q, inertial)
    return q, dataclasses.replace(inertial, gyro=inertial.gyro + rate)


LONG = pytest.mark.long
FAULTS = [
    pytest.param(frozen(), "l_hip_y does not follow its commands", id="a frozen joint"),
    pytest.param(slipped(0.3), "l_knee_y", id="an encoder that slipped by 0.3 rad"),
    pytest.param(slipped(-0.3), "l_knee_y", id="by -0.3 rad", marks=LONG),
    pytest.param(slipped(0.5), "l_knee_y by 0.5", id="by 0.5 rad", marks=LONG),
    pytest.param(slipped(0.8), "l_knee_y by 0.8", id="by 0.8 rad", marks=LONG),
    pytest.param(drifting, "l_knee_y does not follow its commands", id="a drift of 0.1 rad/s"),
    pytest.param(turned(math.radians(20.0), 0), "inertial sensor", id="an imu turned to the side by 20 degrees"),
    pytest.param(turned(math.radians(20.0), 1), "inertial sensor", id="forwards", marks=LONG),
    pytest.param(turned(math.radians(-20.0), 1), "inertial sensor", id="backwards", marks=LONG),
    pytest.param(turning, "sole leans by", id="slowly", marks=LONG),
]


@pytest.mark.parametrize(("fault", "named"), FAULTS)
def test_a_wrong_sensor_value_is_named_and_ends_the_walk(make: Any, fault: Fault, named: str) -> None:
    node = make("controller", CONFIG)
    plant, dt = make_plant("physics", CONFIG, MODEL), CONFIG.dt
    at = None
    for k in range(round((BEGIN + 5.0) / dt)):
        t, q, inertial = k * dt, plant.state.q, plant.inertial
        if t >= BEGIN:
            at = plant.state.q.copy() if at is None else at
            q, inertial = fault(t, q, inertial)
        node.exchange(plant, MODEL, 1.0 + t, q, inertial)
        if node.got["phase"][-1].data in ("failed", "fallen"):
            break
    assert at is not None
    assert named in node.got["diagnostics"][-1].status[0].message
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    assert np.abs(plant.state.q - at).max() < 0.4  # no joint moved further than this


@pytest.mark.parametrize("holds", [True, False])
def test_a_plant_that_receives_no_commands_is_not_a_sensor_fault(make: Any, holds: bool) -> None:
    """The controller commands zero at once; the walk fails unless the plant reports that it holds."""
    config = load("paper").updated({"dt": 0.02, "safety.contradiction": 0.01})
    node, stamps = make("controller", config), itertools.count(50)

    def commands_motion(ticks: int) -> bool:
        """Send states of a robot at rest; return whether the controller commands it to move."""
        for stamp in itertools.islice(stamps, ticks):
            node.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), 0.02 * stamp))
        return any(node.got["joint_velocity_commands"][-1].velocity)

    assert 50 < next(k for k in range(200) if not commands_motion(1)) < 150
    assert node.got["phase"][-1].data == "double_support/left"
    if holds:
        node.send("plant_ready", Bool(data=False))
    assert not commands_motion(30)
    assert node.got["phase"][-1].data == ("double_support/left" if holds else "failed")
    if not holds:
        text = node.got["diagnostics"][-1].status[0].message
        assert text.endswith("; no plant subscribes to joint_velocity_commands")
    if holds:
        node.send("plant_ready", Bool(data=True))
        assert commands_motion(2)


@pytest.mark.parametrize(("moved", "ticks", "continues"), [(0.05, 60, True), (0.3, 60, False), (0.3, 30, True)])
@pytest.mark.parametrize("paused", [False, True])
def test_a_walk_whose_robot_was_moved_while_the_torque_was_off_does_not_continue(
    make: Any, moved: float, ticks: int, continues: bool, paused: bool
) -> None:
    """With the next ~/activate it would go on in mid-step, unasked."""
    node, stamps = make("controller", load("paper").updated({"dt": 0.02})), itertools.count(50)
    q = np.zeros(MODEL.n)

    def commands_motion(ticks: int, speed: float = 0.0) -> bool:
        for stamp in itertools.islice(stamps, ticks):
            q[KNEE] += 0.02 * speed
            node.send("joint_states", state(MODEL.joint_names, q, 0.02 * stamp))
        return any(node.got["joint_velocity_commands"][-1].velocity)

    assert commands_motion(3)
    if paused:
        node.call("~/pause", Trigger.Request())
    node.send("plant_ready", Bool(data=False))
    assert not commands_motion(ticks, moved / (0.02 * ticks))  # a joint that comes to rest takes less than a second
    node.send("plant_ready", Bool(data=True))
    assert commands_motion(3) is (continues and not paused)
    answer = node.call("~/start", Trigger.Request())
    assert answer.success is continues
    assert continues or "l_knee_y has moved by 0.3" in answer.message
    node.call("~/reset", Trigger.Request())
    node.send("plant_ready", Bool(data=False))
    assert node.call("~/start", Trigger.Request()).message == "walking once the plant is ready"


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [25.0, 60.0, 90.0])
@pytest.mark.parametrize("latency", [0.0, 0.02, 0.04])
@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_ordinary_servos_and_sensors_are_not_reported(stiffness: float, latency: float, rate: float) -> None:
    """Four steps with ordinary sensor errors stay below a third of the limits."""
    values = {"servo.stiffness": stiffness, "servo.latency": latency, "servo.rate": rate, "servo.backlash": 0.0058}
    sensors = {f"sensors.{name}": value for name, value in dataclasses.asdict(CONFIG.sensors).items()}
    config = overlaid(load("poppy"), "physics").updated({**values, **sensors})
    config = config.updated(assumed(config))
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    strict = config.updated({"safety.contradiction": 0.3 * config.safety.contradiction})
    judge = Contradictions(strict, MODEL, lambda: 0.1)
    before = np.zeros(MODEL.n)
    for measured, command in closed_loop(controller, plant):
        assert not judge.judge(measured, before), measured.time
        assert controller.lean < 0.3 * config.safety.sole_tilt
        before = command.velocity
    assert controller.finished


def walked(make: Any, config: Config, periods: Any) -> Any:
    """Return a controller that has received states at these intervals [s], and what it sent, of `periods` each time."""
    node, model, time = make("controller", config), load_model(config.robot), 1.0
    for each in periods:
        node.got["joint_velocity_commands"].clear()
        for period in each:
            time += period
            node.send("joint_states", state(model.joint_names, np.zeros(model.n), time))
        node.node._check_plants()
        yield node


def test_a_walk_that_may_hold_stands_still_on_a_busy_machine_and_continues(make: Any) -> None:
    """Three of eleven walks on a busy machine ended for good."""
    config = load("paper").updated({"dt": 0.02, "plant.command_timeout": 0.5})
    slow, moves = [], []
    for node in walked(make, config, ([0.02] * 60, [0.06] * 40, [0.06] * 10, [0.02] * 40, [0.02] * 10)):
        slow.append(node.node._slow)
        moves.append(any(any(msg.velocity) for msg in node.got["joint_velocity_commands"]))
        shown = node.got["diagnostics"][-1].status[0]
    assert ["0.0600 s, but dt" in text for text in slow] == [False, True, True, False, False]
    assert moves == [True, True, False, False, True]
    assert "standing still: joint_states arrive every 0.0600 s" in node.log
    assert "again: continuing" in node.log
    assert "single" in shown.message or "double" in shown.message


def test_a_dynamic_walk_between_two_steps_cannot_hold(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load("paper").updated({"dt": 0.02, "plant.command_timeout": 0.5})
    monkeypatch.setattr(VelocityController, "may_hold", False)
    *_, node = walked(make, config, ([0.02] * 60, [0.06] * 40))
    assert node.got["phase"][-1].data == "failed"


@pytest.mark.parametrize("bunch", [(0.002, 0.008), (0.0039, 0.0061), (0.005, 0.005, 0.005, 0.01)])
def test_states_that_come_in_bunches_or_get_lost_are_no_other_period(make: Any, bunch: tuple[float, ...]) -> None:
    config = load("paper").updated({"dt": 0.005, "plant.command_timeout": 0.5})
    (node,) = walked(make, config, [bunch * (60 // len(bunch))])
    assert "joint_states arrive" not in node.log


@pytest.mark.parametrize(("lockstep", "period", "ends"), [(True, 0.0201, True), (False, 0.03, False)])
def test_a_plant_with_another_dt_ends_the_walk(make: Any, lockstep: bool, period: float, ends: bool) -> None:
    config = load("paper").updated({"dt": 0.02, "plant.lockstep": lockstep})
    node, model = make("controller", config), load_model(config.robot)
    for k in range(60):
        node.send("joint_states", state(model.joint_names, np.zeros(model.n), 1.0 + k * period))
    if not lockstep:
        node.node._check_plants()
    warning = f"joint_states arrive every {period:.4f} s, but dt is 0.02 s"
    assert (warning in node.got["diagnostics"][-1].status[0].message) is ends
    assert (node.got["phase"][-1].data == "failed") is ends
    assert ends or warning in node.log


# ---------------------------------------------------------------------- accumulated contradictions


def judged(states: list[State], u: np.ndarray) -> str:
    free = dataclasses.replace(MODEL, q_min=np.full(MODEL.n, -np.inf), q_max=np.full(MODEL.n, np.inf))
    judge = Contradictions(CONFIG.updated({"dt": 0.02}), free, lambda: 0.1)
    return next((why for one in states if (why := judge.judge(one, u))), "")


def test_a_robot_that_follows_its_commands_is_accepted() -> None:
    u = 0.5 * np.ones(MODEL.n)
    assert not judged([State(0.02 * k, 0.02 * k * u) for k in range(1000)], u)
    sagging = 0.2 * np.eye(MODEL.n)[3]  # once, as under a load
    assert not judged([State(0.02 * k, 0.02 * k * u + sagging * (k > 7)) for k in range(1000)], u)


def test_joints_that_follow_quick_commands_late_by_the_assumed_delay_are_accepted() -> None:
    """A hand that began to move ended a walk on servos with an ordinary delay."""
    late, step = 3, 0.02
    u = 4.0 * np.sign(np.sin(np.arange(200) / 7.0))[:, None] * np.ones(MODEL.n)
    q = step * np.cumsum(u, axis=0)
    free = dataclasses.replace(MODEL, q_min=np.full(MODEL.n, -np.inf), q_max=np.full(MODEL.n, np.inf))
    told = {"servo.assumed_latency": late * step, "servo.assumed_rate": 0.0, "servo.types": ()}
    for frozen, values in ((False, told), (True, told), (False, told | {"servo.assumed_latency": 0.0})):
        judge = Contradictions(CONFIG.updated({"dt": step, "servo.assumed_damping": 0.0} | values), free, lambda: 0.1)
        measured = np.where(frozen & (np.arange(MODEL.n) == KNEE), 0.0, q)
        states = [State(step * k, measured[max(k - late - 1, 0)]) for k in range(len(u))]
        found = [judge.judge(one, u[max(k - 1, 0)]) for k, one in enumerate(states)]
        assert any(found) is (frozen or values is not told)


def test_lost_states_and_a_holding_plant_are_no_contradiction() -> None:
    u = np.ones(MODEL.n)
    assert not judged([State(0.02 * k, 0.02 * k * u) for k in range(0, 1000, 4)], u)
    assert not judged([State(0.0, 0.0 * u), State(30.0, 1.0 * u), State(60.0, 0.2 * u)], u)


def test_after_a_gap_contradictions_are_forgotten() -> None:
    """The robot may have been moved in the meantime; what was off before does not count any more."""
    u, off = np.zeros(MODEL.n), np.eye(MODEL.n)[KNEE]
    states = [State(0.0, u), State(0.02, 0.2 * off), State(0.13, 0.9 * off), State(0.15, 1.1 * off)]
    assert not judged(states, u)
    assert judged([*states, State(0.17, 1.2 * off)], u).startswith("l_knee_y does not follow its commands, it is 0.30")


def test_a_leg_that_yields_is_no_contradiction_and_a_blocked_one_is() -> None:
    """The goal stays within servo.window of the joint: a command that is withheld for long is still noticed."""
    config = CONFIG.updated({"dt": 0.02, "servo.window": 0.006, "servo.assumed_latency": 0.0})
    u = 0.04 * np.eye(MODEL.n)[KNEE]
    for speed, named in ((0.0, False), (0.03, False), (2.0, True)):
        judge = Contradictions(config, MODEL, lambda: 0.1)
        states = [State(0.02 * k, np.zeros(MODEL.n)) for k in range(1000)]
        found = [judge.judge(one, (speed / 0.04) * u) for one in states]
        assert any(found) is named, speed
        assert judge.largest < 0.25 or named


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plant_that_is_late_on_a_busy_machine_is_no_contradiction(sign: float) -> None:
    """Each state is 80 ms after the one before, but the plant has moved for two periods only."""
    u = sign * np.ones(MODEL.n)
    late = [State(0.08 * k, 0.04 * k * u) for k in range(1000)]
    assert not judged(late, u)
    frozen = [dataclasses.replace(one, q=np.where(np.arange(MODEL.n) == KNEE, 0.0, one.q)) for one in late]
    assert judged(frozen, u).startswith("l_knee_y does not follow its commands")
    runaway = [dataclasses.replace(one, q=2.5 * one.q) for one in late]
    assert "does not follow its commands" in judged(runaway, u)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_what_a_late_plant_has_not_moved_is_not_expected_later(share: float) -> None:
    """Servos follow 60 ms later; each fourth period the plant is late, and moves for all or for half of it."""
    u, delay, times, motion = np.ones(MODEL.n), 0.06, [0.0], [0.0]
    for k in range(300):
        period = 0.02 if k % 4 else 0.08
        moves = share * period if period > 0.02 else period
        times += [times[-1] + moves, times[-1] + period]
        motion += [motion[-1] + moves, motion[-1] + moves]
    told = {"dt": 0.02, "servo.assumed_latency": delay, "servo.assumed_rate": 0.0, "servo.types": ()}
    config = CONFIG.updated({**told, "servo.assumed_damping": 0.0})
    free = dataclasses.replace(MODEL, q_min=np.full(MODEL.n, -np.inf), q_max=np.full(MODEL.n, np.inf))
    judge = Contradictions(config, free, lambda: 0.1)
    late = [State(t, np.interp(t - delay, times, motion) * u) for t in times[::2]]
    assert [why for one in late if (why := judge.judge(one, u))] == []
    assert judge.largest < 1e-6


def test_what_judges_a_state_is_compiled_before_the_first_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second state of a walk was answered seconds late where the cache was empty."""
    commanded, command = [], ServoGoals.command
    monkeypatch.setattr(ServoGoals, "command", lambda *given: commanded.append(given) or command(*given))
    judge = Contradictions(CONFIG, MODEL, lambda: 0.1)
    assert commanded
    assert not judge.judge(State(CONFIG.dt, np.ones(MODEL.n)), np.zeros(MODEL.n))  # compared with nothing
    assert judge.largest == 0.0


def test_a_clock_set_back_resets_the_check() -> None:
    u = np.zeros(MODEL.n)
    assert not judged([State(5.0, u), State(1.0, u + 3.0), State(1.02, u + 3.0)], u)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_deviating_joint_is_named(sign: float) -> None:
    u = np.zeros(MODEL.n)
    for k, name in enumerate(MODEL.joint_names):
        why = judged([State(0.0, u), State(0.02, u + 0.26 * sign * np.eye(MODEL.n)[k])], u)
        assert why.startswith(f"{name} does not follow its commands, it is 0.26 rad off")


def test_a_sensor_consistent_with_its_gyroscope_is_accepted() -> None:
    u, rate = np.zeros(MODEL.n), np.array([0.7, -0.4, 0.3])
    turned = [DQ.rotation_about(0.005 * k * np.linalg.norm(rate), rate / np.linalg.norm(rate)) for k in range(400)]
    states = [State(0.005 * k, u, up=upward(*x.vec4()), gyro=rate) for k, x in enumerate(turned)]
    assert not judged(states, u)
    assert "inertial sensor" in judged([dataclasses.replace(one, gyro=0.0 * rate) for one in states], u)
