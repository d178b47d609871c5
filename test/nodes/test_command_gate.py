"""Which commands a plant executes, on a test clock."""

from __future__ import annotations

import numpy as np
from stepped_time import SteppedTime

from dqwalk_ros.nodes.command_gate import CommandGate
from dqwalk_ros.robot.model import RobotModel

DT = 0.005
MS = 1_000_000
PERIOD = 5 * MS


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
        assert gate.ignored == "stamped 0.200 s before the last state"


def test_ignored_commands_do_not_feed_the_watchdog(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    gate.accept(100 * PERIOD, u, 100 * PERIOD)
    for _ in range(30):
        clock.now += DT
        gate.accept(50 * PERIOD, u, 100 * PERIOD)
    assert gate.late == 30
    assert gate.holding


def test_after_the_clock_is_set_back_the_plant_goes_on(model: RobotModel, clock: SteppedTime) -> None:
    gate, u = commands_of(model, clock), np.full(model.n, 0.01)
    ahead = 100_000_000_000
    assert gate.accept(ahead, u, ahead)
    clock.now += DT
    assert not gate.accept(ahead - PERIOD, u, ahead)  # an old command
    assert not gate.accept(ahead, u, 2 * PERIOD)  # its state is of the time before
    for k in range(2, 61):
        clock.now += DT
        assert gate.accept(k * PERIOD, u, k * PERIOD)
        assert not gate.accept((k - 1) * PERIOD, u, k * PERIOD)
    assert not gate.holding


def test_a_refusal_holds_despite_commands(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.refused = "two controllers: a, b"
    gate.accept(0, np.full(model.n, 0.01), 0)
    assert gate.holding
    assert not gate.velocity(np.zeros(model.n), DT).any()


def test_torques_end_with_the_motion(model: RobotModel, clock: SteppedTime) -> None:
    """A drive keeps its last torques by itself."""
    gate, tau = commands_of(model, clock), np.full(model.n, 0.5)
    assert gate.effort is None
    gate.accept(PERIOD, np.zeros(model.n), PERIOD, tau)
    assert gate.effort is tau
    clock.now += 0.11
    assert gate.holding
    assert gate.effort is None
    gate.accept(2 * PERIOD, np.zeros(model.n), 2 * PERIOD, tau)
    gate.refused = "two controllers"
    assert gate.effort is None


def test_hold_discards_the_command(model: RobotModel, clock: SteppedTime) -> None:
    gate = commands_of(model, clock)
    gate.accept(0, np.full(model.n, 0.01), 0)
    gate.hold()
    assert gate.holding


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
