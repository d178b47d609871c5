"""How the motion of a driven robot ends: without states, with wrong stamps, by wrong numbers."""

from __future__ import annotations

import itertools
import time
from typing import Any

import numpy as np
import pytest
from driven import DT, KNEE, MODEL, POPPY, POSTURE, TOPIC, Driven, measured
from inside import state, until
from rclpy.clock import ClockType
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from dqwalk_ros.config import load
from dqwalk_ros.robot.model import load_model


def test_a_drive_that_ends_is_not_ready(make: Any) -> None:
    """The latched message of one that is gone would remain, and the walk fail with a joint that is blocked."""
    one = Driven(make)
    one.tick(0.1)
    assert one.one.got["plant_ready"][-1].data
    one.node.close()
    assert not one.one.got["plant_ready"][-1].data


def test_closing_the_drive_stops_the_robot(make: Any) -> None:
    one = Driven(make, output__interface="velocity")
    one.tick(0.2)
    assert one.out.any()
    one.node.close()
    assert not one.out.any()


STAMPS = {"clock": None, "state": "the last", "relay": "the first", "zero": 0.0}
"""Stamps of commands: of the controller's clock, of the last state, of a repeated message, and none."""


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("interface", list(TOPIC))
def test_motion_ends_when_the_states_end_whatever_the_stamps_of_the_commands(
    make: Any, interface: str, stamps: str
) -> None:
    one = Driven(make, output__interface=interface)
    for _ in range(5):
        one.tick(0.3)
    assert one.node._commands.gate.ready
    last, outputs = one.now, []
    for _ in range(60):
        one.tick(states=False)
        clock = 1e-9 * one.node.get_clock().now().nanoseconds
        stamp = {"clock": clock, "state": 1.0 + last, "relay": 1.0 + last - DT, "zero": 0.0}[stamps]
        one.command(0.3, stamp=stamp)
        outputs.append((one.now - last, one.out))
    if interface == "velocity":
        moving = [at for at, out in outputs if out.any()]
    else:
        moving = [at for (_, before), (at, out) in itertools.pairwise(outputs) if (out != before).any()]
    assert max(moving, default=0.0) <= one.config.plant.command_timeout + DT + 1e-9
    assert one.node._commands.gate.watchdog.silent, "a command without an effect does not feed the watchdog"
    assert not one.one.got["plant_ready"][-1].data
    assert ("error", "stopping: no valid joint_states for 0.1 s") in one.log.lines


def test_states_with_the_same_stamp_are_no_new_states(make: Any) -> None:
    one = Driven(make)
    one.tick(0.3)
    for _ in range(60):
        one.tick(states=False)
        one.one.send("joint_states", measured(one.q, 1.0 + 4 * DT))
        one.command(0.3)
    assert one.out[KNEE] - POSTURE[KNEE] <= 0.3 * (one.config.plant.command_timeout + 2 * DT)


def test_states_and_commands_without_stamps_move_the_robot(make: Any) -> None:
    """The clock of a robot may never have been set."""
    one = Driven(make, known=False)
    for k in range(23):
        one.one.clock.now += DT
        one.one.send("joint_states", measured(one.q, 0.0))
        if k >= 3:
            one.command(0.1 + 0.001 * k, stamp=0.0)
    speeds = 0.1 + 0.001 * np.arange(3, 23)
    assert one.out[KNEE] - POSTURE[KNEE] == pytest.approx(DT * speeds.sum())


def test_a_clock_that_is_not_used_is_named(make: Any) -> None:
    """Without use_sim_time the goals move for the time that has passed, not for the simulated one."""
    one = make("drive", POPPY)
    one.foreign_node("gazebo").create_publisher(Clock, "/clock", 1)
    until(lambda: one.node.count_publishers("/clock"))
    one.node._diagnose()
    assert "/clock is published, but use_sim_time is false" in one.log


def test_while_the_clock_of_a_simulator_stands_still_the_plant_is_not_ready(make: Any) -> None:
    """States that go on are not answered meanwhile: the joints would not follow, and the walk would fail."""
    driven = Driven(make, known=False, ros=("-p", "use_sim_time:=true"))
    one, clock = driven.one, driven.node.get_clock()

    def passes(seconds: float, *, simulated: bool = True) -> str:
        for _ in range(round(seconds / DT)):
            if simulated:
                clock.set_ros_time_override(Time(seconds=1.0 + driven.now, clock_type=ClockType.ROS_TIME))
            driven.tick(0.1)
        driven.node._diagnose()
        return str(one.got["diagnostics"][-1].status[0].message)

    assert passes(0.1, simulated=False) == "use_sim_time is set, but no node publishes /clock"
    assert passes(0.5) == "moving"
    assert passes(0.7, simulated=False) == "holding: use_sim_time is set, but /clock stands still"
    assert not one.got["plant_ready"][-1].data
    assert passes(0.5) == "moving"
    assert one.got["plant_ready"][-1].data


def test_a_clock_that_steps_back_stops_no_robot(make: Any) -> None:
    one = Driven(make)
    for k in range(40):
        one.one.clock.now += DT
        stamp = (2.0 if k < 10 else 1.0) + one.now
        one.one.send("joint_states", measured(one.q, stamp))
        one.command(0.1, stamp=stamp)
        one.node._check()
    stopped = 4 * DT  # until three states agree that the clock was set
    assert DT * 0.1 * 40 - 0.1 * stopped <= one.out[KNEE] - POSTURE[KNEE] <= DT * 0.1 * 40


@pytest.mark.parametrize("off", [1e9, 0.5, -0.5])
def test_single_wrong_stamps_of_states_cost_one_state_each(make: Any, off: float) -> None:
    one = Driven(make)
    for k in range(40):
        one.one.clock.now += DT
        one.one.send("joint_states", measured(one.q, 1.0 + one.now + (off if k in (10, 20) else 0.0)))
        one.command(0.1)
        one.node._check()
    assert one.out[KNEE] - POSTURE[KNEE] == pytest.approx(DT * 0.1 * 40)


def test_the_command_to_stay_is_repeated_for_a_second(make: Any) -> None:
    """Because a message may be lost; then no more, because the robot may be moved by hand."""
    one = Driven(make)
    one.one.clock.now += 1000.0
    for _ in range(5):
        one.tick(0.1)
    begun, times = len(one.sent), []
    for _ in range(round(1.5 / DT)):
        one.tick()
        times += [one.now] * (len(one.sent) > begun + len(times))
    assert np.diff(times).max() < 1.5 * DT
    assert times[-1] - times[0] == pytest.approx(1.0 - one.config.plant.command_timeout, abs=3 * DT)


def test_lost_time_is_not_made_up_for(make: Any) -> None:
    one = Driven(make)
    one.tick(0.1)
    for _ in range(10):
        one.tick()
    goal = one.out
    one.tick(0.1)
    np.testing.assert_allclose(one.out - goal, 2 * DT * 0.1, atol=1e-12)


@pytest.mark.parametrize("interface", list(TOPIC))
def test_a_stop_with_the_stamp_of_a_state_answered_before_has_an_effect(make: Any, interface: str) -> None:
    """Also if no time has passed on the clock of a simulator."""
    one = Driven(make, output__interface=interface)
    for _ in range(2):
        one.tick(0.2)
    goal = one.out
    one.command(0.0)
    if interface == "velocity":
        assert not one.out.any()
    one.tick()
    one.command(0.0, stamp=1.0 + one.now - DT)
    np.testing.assert_array_equal(one.out, goal if interface == "position" else 0.0 * goal)


def test_a_robot_that_was_moved_by_hand_begins_where_it_is(make: Any) -> None:
    """A while after the last command nothing is sent; the next one begins at the measured angles."""
    one = Driven(make)
    for _ in range(10):
        one.tick(0.1)
    for _ in range(300):
        one.tick()
    count = len(one.sent)
    for _ in range(100):
        one.q[KNEE] += 0.005
        one.tick()
    assert len(one.sent) == count
    one.tick(0.1)
    assert one.out[KNEE] == pytest.approx(one.q[KNEE] + 0.1 * DT)


@pytest.mark.parametrize("torque", [60.0, 1200.0, 1e300])
@pytest.mark.parametrize("interface", list(TOPIC))
def test_one_excessive_torque_moves_no_joint_beyond_its_limits(make: Any, interface: str, torque: float) -> None:
    one = Driven(make, output__interface=interface)
    for _ in range(3):
        one.tick(0.0, 1.0)
    before = one.out
    one.tick(0.0, torque)
    if interface == "velocity":
        assert (np.abs(one.out) <= MODEL.velocity_max + 1e-9).all()
    else:
        assert (np.abs(one.out - before) <= DT * MODEL.velocity_max + 1e-9).all()
        assert (np.abs(one.out - POSTURE) <= MODEL.effort_max / POPPY.servo.assumed_stiffness + 1e-9).all()


@pytest.mark.parametrize("off", [0.3, 1.5, 1e9, 1e300])
@pytest.mark.parametrize("holding", [True, False])
@pytest.mark.parametrize("interface", list(TOPIC))
def test_one_wrong_angle_moves_nothing(make: Any, interface: str, holding: bool, off: float) -> None:
    one = Driven(make, output__interface=interface)
    for _ in range(3):
        one.tick(0.0)
    for _ in range(30 if holding else 0):
        one.tick()
    before, speed = one.out, None if holding else 0.0
    one.q[KNEE] += off
    one.tick(speed)
    one.q[KNEE] = POSTURE[KNEE]
    np.testing.assert_array_equal(one.out, before)
    for _ in range(5):
        one.tick(speed)
        np.testing.assert_array_equal(one.out, before)
    assert not one.node._law.gate.fault


def test_states_of_a_second_publisher_move_nothing(make: Any) -> None:
    """Such as those of a joint_state_publisher with sliders, which joints may have reached since the last state."""
    one = Driven(make)
    one.tick(0.0)
    before = one.out
    for k in range(1, 10):
        one.one.send("joint_states", measured(np.zeros(MODEL.n), 1.001 + one.now), number=k)
        one.tick(0.0)
        np.testing.assert_array_equal(one.out, before)
    assert "joint_states rejected (1 so far): overtaken by another one, or of a second publisher" in one.log
    for _ in range(10):
        one.tick(0.0, states=False)
    one.one.send("joint_states", measured(POSTURE, 1.0 + one.now), number=1)  # the first one has ended
    one.tick(0.0, states=False)
    assert one.node._commands.unable == ""


def test_a_joint_that_jumps_stops_the_robot_until_reset(make: Any) -> None:
    one = Driven(make, output__interface="velocity")
    for _ in range(5):
        one.tick(0.3)
    one.q[KNEE] += 0.5
    for _ in range(5):
        one.tick(0.3)
    assert not one.out.any()
    assert "stopping: l_knee_y has jumped to another angle: check its sensor, then ~/reset" in one.log
    for _ in range(300):
        one.tick(0.3)
        assert not one.out.any()
    assert one.one.call("reset", Trigger.Request()).success
    for _ in range(5):
        one.tick(0.3)
    assert one.out.any()
    assert one.one.got["plant_ready"][-1].data


@pytest.mark.parametrize("interface", list(TOPIC))
def test_a_joint_that_moves_against_its_torque_stops_the_robot_until_reset(make: Any, interface: str) -> None:
    """Such as one whose motor has lost its mode; `drive` cannot switch its torque off, and says so."""
    one = Driven(make, output__interface=interface)
    one.tick(0.0)
    for _ in range(20):
        one.q[KNEE] += 0.02
        one.tick(0.0)
    assert "l_knee_y moved away from its goal at full torque: unless another controller moves it, switch" in one.log
    stopped = one.out
    for _ in range(300):
        one.tick(0.3)
    np.testing.assert_array_equal(one.out, stopped)
    assert one.one.call("reset", Trigger.Request()).success
    for _ in range(5):
        one.tick(0.3)
    assert one.out[0] > (stopped[0] if interface == "position" else 0.0)


@pytest.mark.long
def test_the_robot_stops_after_the_controller_process_is_killed(nodes: Any) -> None:
    """With a forward controller that repeats its last command; prints how long the motion continued."""
    import signal

    config = load("paper").updated({"dt": 0.02, "output.interface": "velocity"})
    names = load_model(config.robot).joint_names
    live = nodes(config)
    q, output, at = np.zeros(len(names)), [np.zeros(len(names))], [0.0]

    def take(msg: Float64MultiArray) -> None:
        output[0], at[0] = np.array(msg.data), time.monotonic()

    def update() -> None:
        q[:] += 0.02 * output[0]
        states.publish(state(names, q, time.time()))

    states = live.node.create_publisher(JointState, "joint_states", 10)
    live.node.create_subscription(Float64MultiArray, TOPIC["velocity"], take, 1)
    live.node.create_timer(0.02, update)
    live.start("drive")
    live.start("controller")
    live.until(lambda: np.abs(output[0]).max() > 1e-3, 120.0, "motion")
    live.spin(2.0)
    live.processes.signal("controller", signal.SIGKILL)
    killed, before = time.monotonic(), q.copy()
    live.until(lambda: not output[0].any(), 20.0, "the end of the motion")
    print(f"motion ended {at[0] - killed:.3f} s after the kill, {np.abs(q - before).max():.4f} rad further")
    live.spin(1.0)
    assert not output[0].any()
    assert live.processes.exit_code("drive") is None
