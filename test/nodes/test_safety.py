"""Every decision of `nodes/safety.py` about states and commands, on a test clock."""

from __future__ import annotations

import numpy as np
import pytest
from stepped_time import SteppedTime

from dqwalk_ros.config import load
from dqwalk_ros.nodes.safety import (
    BodyGate,
    CommandGate,
    DuplicatePublishers,
    DuplicateStates,
    FaultCounter,
    JointOrder,
    StateGate,
    Watchdog,
)
from dqwalk_ros.robot.limits import outside_limits
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.support.errors import StateError

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


@pytest.fixture
def clock() -> SteppedTime:
    return SteppedTime(100.0)


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return load_model(load("paper").robot)


# ---------------------------------------------------------------------- names


def test_joints_are_matched_by_name_in_any_order() -> None:
    order = JointOrder(["a", "b"])
    np.testing.assert_array_equal(order(["b", "head", "a"], [2.0, 9.0, 1.0], "position"), [1.0, 2.0])
    np.testing.assert_array_equal(order(["a", "b"], [3.0, 4.0], "position"), [3.0, 4.0])


@pytest.mark.parametrize(
    ("names", "values", "expected"),
    [
        (["a"], [1.0], "joints missing: b"),
        (["a", "c"], [1.0, 2.0], "joints missing: b; it has c"),
        ([], [], "joints missing: a, b"),
        (["a", "b", "a"], [1.0, 2.0, 3.0], "named twice: a"),
        (["a", "b"], [1.0], "2 names, but 1 numbers"),
        (["a", "b"], [1.0, 2.0, 3.0], "2 names, but 3 numbers"),
        (["a", "b"], [1.0, float("nan")], "not a finite position: b = nan"),
        (["a", "b"], [float("-inf"), 1.0], "not a finite position: a = -inf"),
        (["b", "a"], [float("inf"), 1.0], "not a finite position: b = inf"),
    ],
)
def test_wrong_joint_names_and_values_are_rejected_by_name(
    names: list[str], values: list[float], expected: str
) -> None:
    order = JointOrder(["a", "b"])
    order(["a", "b"], [0.0, 0.0], "position")
    with pytest.raises(StateError, match=expected):
        order(names, values, "position")
    np.testing.assert_array_equal(order(["a", "b"], [5.0, 6.0], "position"), [5.0, 6.0])


# ---------------------------------------------------------------------- watchdog and latch


def test_the_watchdog_measures_silence_by_the_time_of_receipt(clock: SteppedTime) -> None:
    dog = Watchdog(lambda: 0.1, clock)
    assert dog.silent  # no message yet
    dog.feed()
    clock.now += 0.0999
    assert not dog.silent
    clock.now += 0.0002
    assert dog.silent
    dog.feed()
    assert not dog.silent
    dog.starve()
    assert dog.silent


def test_the_fault_counter_latches_after_consecutive_faults_until_reset() -> None:
    latch = FaultCounter(3)
    assert not latch.fault("x")
    assert not latch.fault("x")
    latch.good()
    assert not latch.fault("x")
    assert not latch.fault("x")
    assert latch.fault("third")
    latch.good()
    assert latch
    assert latch.reason == "third"
    latch.reset()
    assert not latch


# ---------------------------------------------------------------------- states


def gate_of(model: RobotModel, clock: SteppedTime, **options: object) -> StateGate:
    return StateGate(model, DT, lambda: 0.1, clock=clock, **options)  # type: ignore[arg-type]


def test_states_of_a_walk_are_accepted(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    for k in range(100):
        assert gate.is_new(k * PERIOD)
        gate.accept(k * PERIOD, 0.9 * DT * k * np.minimum(model.velocity_max, 0.5 * model.q_max / (100 * DT)))
        clock.now += DT
    assert gate.overtaken == 0


def test_a_spike_is_rejected_and_does_not_feed_the_watchdog(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    zero = np.zeros(model.n)
    gate.accept(0, zero)
    clock.now += 0.06
    spike = zero.copy()
    spike[3] = 0.9
    with pytest.raises(StateError, match=rf"jump.*{model.joint_names[3]} by 0.9 rad"):
        gate.accept(PERIOD, spike)
    clock.now += 0.06
    assert gate.watchdog.silent
    gate.accept(2 * PERIOD, zero)  # valid; the spike had no effect
    assert not gate.watchdog.silent


def test_consecutive_jumps_latch_until_reset(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock, jumps=3)
    zero, far = np.zeros(model.n), 0.4 * np.eye(model.n)[1] * np.sign(model.q_max[1] + model.q_min[1])
    gate.accept(0, zero)
    for k in range(1, 4):
        clock.now += DT
        with pytest.raises(StateError, match="jump"):
            gate.accept(k * PERIOD, far)
    with pytest.raises(StateError, match="reset"):
        gate.accept(4 * PERIOD, zero)
    gate.reset()
    gate.accept(5 * PERIOD, far)


def test_a_persistent_jump_is_never_accepted(model: RobotModel, clock: SteppedTime) -> None:
    """The time during which it is rejected does not count as time in which the joint could move."""
    gate = gate_of(model, clock, jumps=1000)
    gate.accept(0, np.zeros(model.n))
    for k in range(1, 100):
        clock.now += DT
        with pytest.raises(StateError, match="jump"):
            gate.accept(k * PERIOD, 0.3 * np.eye(model.n)[0])
    clock.now += DT
    gate.accept(100 * PERIOD, np.zeros(model.n))


def test_a_stamp_in_the_future_does_not_allow_a_jump(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(0, np.zeros(model.n))
    clock.now += DT
    with pytest.raises(StateError, match="jump"):
        gate.accept(100_000_000_000, np.full(model.n, 0.05) + 0.95 * np.eye(model.n)[2])


def test_after_a_long_silence_another_posture_is_accepted(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(0, np.zeros(model.n))
    clock.now += 1.0
    gate.accept(PERIOD, 0.3 * np.eye(model.n)[0])


def test_in_lockstep_jumps_are_judged_by_stamps_not_by_the_clock(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock, by_stamp=True)
    gate.accept(0, np.zeros(model.n))
    clock.now += 100.0
    with pytest.raises(StateError, match="jump"):
        gate.accept(PERIOD, 0.3 * np.eye(model.n)[0])
    gate.reset()
    gate.accept(200 * PERIOD, np.zeros(model.n))  # only the elapsed time counts, not the stamp itself
    with pytest.raises(StateError, match="jump"):
        gate.accept(201 * PERIOD, 0.3 * np.eye(model.n)[0])


@pytest.mark.parametrize("beyond", [1e-9, 1e-4, 0.01, 0.0999])
def test_joints_slightly_outside_their_limits_are_accepted(
    model: RobotModel, clock: SteppedTime, beyond: float
) -> None:
    for i in range(model.n):
        q = np.zeros(model.n)
        q[i] = model.q_max[i] + beyond
        gate_of(model, clock).accept(0, q)
        q[i] = model.q_min[i] - beyond
        gate_of(model, clock).accept(0, q)


@pytest.mark.parametrize("beyond", [0.101, 0.5, 1e6])
def test_joints_far_outside_their_limits_are_rejected_by_name(
    model: RobotModel, clock: SteppedTime, beyond: float
) -> None:
    for i, name in enumerate(model.joint_names):
        for sign, limit in ((1.0, model.q_max[i]), (-1.0, model.q_min[i])):
            q = np.zeros(model.n)
            q[i] = limit + sign * beyond
            with pytest.raises(StateError, match=rf"outside the joint limits: {name} by"):
                gate_of(model, clock).accept(0, q)
            assert name in outside_limits(q, model, 0.1)


def test_states_out_of_order_are_dropped_until_the_watchdog_times_out(model: RobotModel, clock: SteppedTime) -> None:
    gate = gate_of(model, clock)
    gate.accept(10 * PERIOD, np.zeros(model.n))
    assert not gate.is_new(10 * PERIOD)
    assert not gate.is_new(9 * PERIOD)
    assert gate.is_new(11 * PERIOD)
    assert gate.overtaken == 2
    clock.now += 0.11  # no newer state: the plant's clock was set back
    assert gate.is_new(3 * PERIOD)


@pytest.mark.parametrize("stamp", [0, 1000 * PERIOD])
def test_stamps_that_do_not_advance_are_not_a_clock_set_back(model: RobotModel, clock: SteppedTime, stamp: int) -> None:
    gate, zero = gate_of(model, clock), np.zeros(model.n)
    assert gate.is_new(stamp)
    gate.accept(stamp, zero)
    for k in range(1, 50):
        clock.now += DT
        assert not gate.is_new(stamp)
        assert bool(gate.stuck) == (k >= gate.repeats)
    assert gate.watchdog.silent
    assert f"the stamp {1e-9 * stamp:g}: set header.stamp" in gate.stuck
    assert gate.is_new(stamp + PERIOD)
    assert not gate.stuck
    assert gate.is_new(stamp - PERIOD)  # after the timeout


def test_states_that_arrive_twice_are_no_fault(model: RobotModel, clock: SteppedTime) -> None:
    gate, zero = gate_of(model, clock), np.zeros(model.n)
    for k in range(20):
        assert gate.is_new(k * PERIOD)
        gate.accept(k * PERIOD, zero)
        assert not gate.is_new(k * PERIOD)
        assert not gate.stuck


# ---------------------------------------------------------------------- commands


def commands_of(model: RobotModel, clock: SteppedTime) -> CommandGate:
    return CommandGate(model, lambda: 0.1, clock)


def test_the_plant_holds_before_the_first_and_after_the_last_command(model: RobotModel, clock: SteppedTime) -> None:
    gate, zero = commands_of(model, clock), np.zeros(model.n)
    assert gate.holding
    assert not gate.velocity(zero, DT).any()
    assert gate.accept(0, np.full(model.n, 0.01), 0)
    np.testing.assert_array_equal(gate.velocity(zero, DT), np.full(model.n, 0.01))
    clock.now += 0.099
    assert not gate.holding
    clock.now += 0.002
    assert gate.holding
    assert not gate.velocity(zero, DT).any()


def test_commands_for_a_wrong_state_are_ignored(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    now = 1000 * PERIOD
    assert gate.accept(now - PERIOD, u, now)
    assert not gate.accept(now - 2 * PERIOD, 2 * u, now)  # overtaken
    assert not gate.accept(now + 1, 2 * u, now)  # for a state that was never published: a clock fault
    assert gate.late == 2
    np.testing.assert_array_equal(gate.velocity(np.zeros(model.n), DT), u)


def test_commands_stamped_at_sending_are_accepted_until_too_old(model: RobotModel, clock: SteppedTime) -> None:
    gate, u, now = commands_of(model, clock), np.full(model.n, 0.01), 1000 * PERIOD
    sent = 5000 * PERIOD
    assert gate.accept(sent, u, now, clock=sent + 99 * MS)
    assert not gate.accept(sent + PERIOD, u, now, clock=sent + PERIOD + 101 * MS)


def test_commands_delayed_by_200_ms_cause_no_motion(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    for k in range(1, 200):
        gate.accept(k * PERIOD, u, k * PERIOD + 200 * MS)
        clock.now += DT
        assert gate.holding


def test_ignored_commands_do_not_feed_the_watchdog(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    gate.accept(100 * PERIOD, u, 100 * PERIOD)
    for _ in range(30):
        clock.now += DT
        gate.accept(50 * PERIOD, u, 100 * PERIOD)
    assert gate.late == 30
    assert gate.holding


def test_after_the_clock_is_set_back_the_plant_holds_for_one_timeout(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    ahead = 100_000_000_000
    gate.accept(ahead, u, ahead)
    accepted = []
    for k in range(1, 61):  # a stamp of zero is none
        clock.now += DT
        accepted.append(gate.accept(k * PERIOD, u, k * PERIOD))
    assert not accepted[0]
    assert accepted[-1]
    assert accepted.index(True) == pytest.approx(20, abs=2)


def test_a_refusal_holds_despite_commands(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.refused = "two controllers: a, b"
    gate.accept(0, np.full(model.n, 0.01), 0)
    assert gate.holding
    assert not gate.velocity(np.zeros(model.n), DT).any()


def test_hold_discards_the_command(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.accept(0, np.full(model.n, 0.01), 0)
    gate.hold()
    assert gate.holding


def test_two_publishers_are_reported_at_once_unless_one_may_be_stale(clock: SteppedTime) -> None:
    judge = DuplicatePublishers(clock).judge
    assert judge([]) == judge(["/a"]) == ""
    assert judge(["/b", "/a"]) == "/a, /b"
    unknown = "_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_"  # as rclpy names a node that is not discovered yet
    assert judge([unknown]) == ""
    assert judge([unknown, unknown]) == unknown
    assert judge(["/a", "/a"]) == ""
    clock.now += 24.9
    assert judge(["/a", "/a"]) == ""
    clock.now += 0.2
    assert judge(["/a", "/a"]) == "/a, 2 times"
    assert judge(["/a"]) == ""
    assert judge(["/a", "/a"]) == ""  # the time starts again


def test_a_second_plant_is_detected_by_its_messages() -> None:
    def verdict(messages: list[tuple[list[str], int]], publishers: list[str]) -> str:
        judge = DuplicateStates(DT)
        for look in range(1, DuplicateStates.looks + 1):
            for names, stamp in messages:
                judge.note(names, stamp)
            found = judge.judge(publishers)
            assert look == DuplicateStates.looks or found == ""  # one interval is not enough
        return found

    both, one = ["/a", "/b"], [(["x"], k * PERIOD) for k in range(50)]
    assert verdict(one, both) == ""  # the other one publishes other joints
    assert verdict(one, ["/a"]) == ""
    assert verdict(one[::3], both) == ""  # most are lost
    assert verdict([m for m in one for _ in range(2)], both) == "/a, /b"  # more messages than the stamps explain
    assert verdict([(["x"], k * PERIOD) for k in (0, 5, 1, 6, 2, 7, 3, 8)], both) == "/a, /b"  # back and forth
    assert verdict([*one, (["x", "y"], 50 * PERIOD)], both) == "/a, /b"  # another list of joints
    twice = [(["x"], stamp * PERIOD) for stamp in (0, 5, 4, 9, 8, 13)]
    assert verdict(twice, both) == ""  # two states out of order, which is normal


def test_the_rate_of_a_plant_is_measured_while_there_is_only_one() -> None:
    """A plant at twice the expected rate is not reported as two plants."""
    judge = DuplicateStates(2 * DT)
    for publishers in (["/a"], ["/a", "/b"], ["/a", "/b"]):
        for k in range(50):
            judge.note(["x"], k * PERIOD)
        found = judge.judge(publishers)
    assert found == ""


def test_the_plant_is_ready_until_commands_time_out(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    assert gate.ready  # no command yet
    gate.accept(0, np.zeros(model.n), 0)
    clock.now += 0.099
    assert gate.ready
    clock.now += 0.002
    assert not gate.ready
    gate.accept(PERIOD, np.zeros(model.n), PERIOD)
    assert gate.ready
    gate.refused = "two controllers"
    assert not gate.ready


def test_different_commands_for_one_state_indicate_two_controllers(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    for k in range(4):
        assert not gate.contradicted
        gate.accept(PERIOD, np.full(model.n, 0.01 * k), PERIOD)
    assert gate.contradicted
    assert gate.holding
    clock.now += 0.99
    assert gate.contradicted
    clock.now += 0.02
    assert not gate.contradicted


# ---------------------------------------------------------------------- whole bodies


def accepted_body() -> tuple[BodyGate, dict[str, np.ndarray]]:
    """Return a gate that has accepted a state, and that state."""
    body = load_model(load("whole_body").robot)
    gate = BodyGate(body, DT, lambda: 0.5)
    q = np.clip(np.zeros(body.n), body.q_min, body.q_max)
    state = {"q": q, "dq": np.zeros(body.n), "place": np.array([0.0, 0.0, 0.7]), "v_base": np.zeros(6)}
    gate.accept_body(0, **state)
    return gate, state


@pytest.mark.parametrize(
    ("what", "value", "why"),
    [
        ("q", 0.5, "a jump that the velocity limits do not allow"),
        ("q", 9.0, "outside the joint limits"),
        ("dq", 1000.0, "turns at 1e\\+03 rad/s"),
        ("dq", 1e300, "turns at"),
        ("dq", np.nan, "not finite"),
        ("v_base", 1e200, "the base moves at"),
        ("v_base", np.inf, "not finite"),
        ("place", 1.0, "the base jumped by"),
    ],
)
def test_an_invalid_body_state_is_rejected_and_changes_nothing(what: str, value: float, why: str) -> None:
    gate, state = accepted_body()
    wrong = {**state, what: state[what].copy()}
    wrong[what][-1] += value
    with pytest.raises(StateError, match=why):
        gate.accept_body(PERIOD, **wrong)
    gate.accept_body(2 * PERIOD, **state)


def test_velocity_changes_by_a_push_are_accepted() -> None:
    """A push changes velocities instantly, also beyond a joint's velocity limit; both are accepted."""
    gate, state = accepted_body()
    pushed = {**state, "dq": state["dq"] + 13.0, "v_base": np.array([0.0, 1.0, 0.0, 2.0, 0.0, 0.0])}
    gate.accept_body(PERIOD, **pushed)
    gate.accept_body(2 * PERIOD, **{**pushed, "q": state["q"] + 13.0 * DT})


def test_a_base_that_moves_too_fast_is_rejected_at_any_time() -> None:
    gate, state = accepted_body()
    late = 1000 * PERIOD
    gate.accept_body(late, **state)
    with pytest.raises(StateError, match="the base jumped by"):
        gate.accept_body(late + PERIOD, **{**state, "place": state["place"] + [1.0, 0.0, 0.0]})
    gate.accept_body(late + PERIOD, **{**state, "place": state["place"] + [0.09, 0.0, 0.0]})


def test_consecutive_jumps_of_the_base_latch() -> None:
    gate, state = accepted_body()
    for k in range(5):
        far = {**state, "place": state["place"] + [5.0 + k, 0.0, 0.0]}
        with pytest.raises(StateError, match="jump"):
            gate.accept_body((k + 1) * PERIOD, **far)
    with pytest.raises(StateError, match="in a row"):
        gate.accept_body(9 * PERIOD, **state)
