"""The node drive: conversion of commands for the controllers of a robot."""

from __future__ import annotations

import itertools
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from inside import state, until
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.time import Time
from ros2_control import EXTRA, ControllerManager, Known
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.nodes.safety import UNKNOWN
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.errors import ConfigError

POPPY = overlaid(load("poppy"), "ros2_control")
MODEL = load_model(POPPY.robot)
NAMES = MODEL.joint_names
POSTURE = MODEL.posture(POPPY.standing.posture)
DT = POPPY.dt
KNEE = NAMES.index("l_knee_y")
TOPIC = {kind: f"forward_{kind}_controller/commands" for kind in ("position", "velocity")}


# ---------------------------------------------------------------------- walks


class Ros2ControlWalk:
    """A walk whose robot, in physics, is driven through ros2_control, simulated period by period."""

    def __init__(self, make: Any, rate: float, interface: str, config: Config = POPPY, **more: Any) -> None:
        self.dt = 1.0 / rate
        joints = (*EXTRA, *reversed(NAMES))
        values: dict[str, Any] = {"dt": self.dt, "servo.assumed_rate": rate, "servo.assumed_latency": self.dt}
        values |= {"output.interface": interface, "output.joints": joints, "node.autostart": True}
        self.config = config.updated({**values, "qp.solver": "daqp", **more})
        # they go where they are commanded: the lead is in the goals already
        servos = self.config.updated({"servo.window": 1.0, "servo.assumed_lead": 0.0})
        self.robot = ControllerManager(make_plant("physics", servos, MODEL), interface, joints, MODEL.imu, rate)
        self.controller, self.drive = make("controller", self.config), make("drive", self.config)
        self.drive.node._controllers = Known()
        self.controller.send("plant_ready", Bool(data=True))
        self.output, self._commands = self.drive.got[TOPIC[interface]], self.controller.got["joint_velocity_commands"]
        self._received = 0

    def update(self, *, killed: bool = False) -> None:
        """Simulate one period, with or without the controller of the walk."""
        self.drive.clock.now += self.dt
        measured, imu = self.robot.update()
        self.drive.send("joint_states", measured)
        if not killed:
            self.controller.send("imu", imu)
            self.controller.send("joint_states", measured)
            for message in self._commands:
                self.drive.send("joint_velocity_commands", message)
            self._commands.clear()
        self.drive.node._check()
        for message in self.output[self._received :]:
            self.robot.on_commands(message)
        self._received = len(self.output)

    def miss(self) -> None:
        """Simulate one period that the controller manager misses."""
        self.drive.clock.now += self.dt
        self.robot.miss()


def check_walk(
    make: Any, rate: float, interface: str, steps: int, config: Config = POPPY, missed: float = 0.0
) -> Ros2ControlWalk:
    """Walk, and check that the robot has not fallen and has walked the distance; return the walk.

    `missed` is the fraction of periods that the controller manager misses.
    """
    rng = np.random.default_rng(1)
    walk = Ros2ControlWalk(make, rate, interface, config, **{"gait.steps": steps})
    robot, controller = walk.robot, walk.controller.node
    began = {foot: DQ(x).translation()[0] for foot, x in robot.plant.truth.soles.items()}
    while controller._mode.value == "walking" and not robot.plant.fallen:
        walk.miss() if rng.random() < missed else walk.update()
    assert controller._mode.value == "finished", (controller._problem, robot.updates * walk.dt)
    assert not robot.plant.fallen
    ahead = {foot: DQ(x).translation()[0] - began[foot] for foot, x in robot.plant.truth.soles.items()}
    which = f"{rate:g} Hz, {interface}, {100 * missed:g} % missed"
    print(f"{which}: {robot.updates * walk.dt:.1f} s, feet {min(ahead.values()):.3f} m ahead")
    ramp = min(config.dynamic.ramp, (steps - 1) // 2) if config.gait.style == "dynamic" else 0
    paces = steps - ramp  # the first and the last ones are shorter
    assert list(ahead.values()) == pytest.approx([paces * walk.config.gait.step_length] * 2, rel=0.2)
    return walk


def test_one_step_through_ros2_control(make: Any) -> None:
    check_walk(make, 50.0, "velocity", 1)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("rate", "interface", "missed"),
    [*itertools.product((50.0, 100.0, 200.0), TOPIC, (0.0,)), *itertools.product((100.0, 200.0), TOPIC, (0.05,))],
)
def test_dynamic_steps_through_ros2_control(make: Any, rate: float, interface: str, missed: float) -> None:
    """Legs that yield within servo.window do not contradict their commands."""
    config = overlaid(load("poppy_dynamic_50hz" if rate == 50.0 else "poppy_dynamic"), "ros2_control")
    walk = check_walk(make, rate, interface, 40, config, missed)
    largest = walk.controller.node._falls.contradictions.largest
    print(f"largest contradiction {largest:.3f} rad of {walk.config.safety.contradiction:g}")
    assert largest < 0.5 * walk.config.safety.contradiction


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("interface", ["position", "velocity"])
@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 500.0])
def test_ten_steps_through_ros2_control(make: Any, rate: float, interface: str) -> None:
    check_walk(make, rate, interface, 10)


# ---------------------------------------------------------------------- output


def measured(q: Any, stamp: float = 1.0) -> Any:
    return state((*NAMES, *EXTRA), [*q, 0.3, 0.4], stamp)


def command(stamp: float = 1.0, speed: float = 0.0) -> Any:
    return state(NAMES, [], stamp, velocity=np.full(MODEL.n, speed))


class Driven:
    """The node on a test clock, whose robot does not move by itself.

    Attributes
    ----------
    q : ndarray, shape (n,)
        Measured angles [rad].
    """

    def __init__(
        self, make: Any, *, known: bool = True, asks: bool = False, ros: tuple[str, ...] = (), **settings: Any
    ) -> None:
        self.config = POPPY.updated({name.replace("__", "."): value for name, value in settings.items()})
        self.one = make("drive", self.config, ros=ros)
        self.node, self.log, self.q = self.one.node, self.one.log, POSTURE.copy()
        if not asks:
            self.node._controllers = Known()
        o = self.config.output
        self.topic = o.topic or TOPIC[o.interface]
        for _ in range(3 if known else 0):
            self.tick()

    def tick(self, speed: float | None = None, effort: Any = None, *, states: bool = True) -> None:
        """Let a period pass; the robot sends its state, and a controller commands velocities and torques."""
        self.one.clock.now += DT
        if states:
            self.one.send("joint_states", measured(self.q, 1.0 + self.now))
        if speed is not None:
            self.command(speed, effort)
        self.node._check()

    def command(self, speed: float, effort: Any = None, *, stamp: float | None = None) -> None:
        msg = command(1.0 + self.now if stamp is None else stamp, speed)
        if effort is not None:
            msg.effort = [float(x) for x in np.broadcast_to(effort, MODEL.n)]
        self.one.send("joint_velocity_commands", msg)

    @property
    def now(self) -> float:
        """Time of the node's clock, and of the stamps minus 1 s [s]."""
        return float(self.one.clock.now)

    @property
    def sent(self) -> list[Any]:
        """Messages sent to the robot."""
        return self.one.got[self.topic]

    @property
    def out(self) -> np.ndarray:
        """Values (n,) sent last, of the joints of the walk."""
        return np.array(self.sent[-1].data)[: MODEL.n]


def test_no_output_before_the_topic_has_a_subscriber(make: Any) -> None:
    """The walk waits until the output topic has a subscriber."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    one = driven.one
    one.tick()
    driven.tick(0.0)
    assert not driven.sent
    assert [msg.data for msg in one.got["plant_ready"]] == [False]
    assert "no node subscribes to /joint_commands" in one.got["diagnostics"][-1].status[0].message
    one.foreign_node("arm").create_subscription(JointTrajectory, "joint_commands", lambda _: None, 1)
    expected = (
        "arm with trajectory_msgs/msg/JointTrajectory uses /joint_commands, which is a sensor_msgs/msg/JointState"
    )
    until(lambda: driven.tick() or driven.node._blind.startswith(expected))
    assert driven.node._blind.endswith("set output.type")
    robot = one.foreign_node("controller_manager")
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    until(lambda: driven.tick() or len(one.got["plant_ready"]) > 1)
    assert one.got["plant_ready"][-1].data


@pytest.mark.parametrize(
    ("parameters", "wrong"),
    [
        ({"joints": NAMES, "interface_name": "position"}, ""),
        ({"joints": NAMES[::-1]}, "/robot has its joints in another order: set output.joints to [bust_x, "),
        ({"joints": (*NAMES, "gripper")}, "/robot has more joints than output.joints: set output.joints to [l_hip_x, "),
        ({"joints": NAMES[:5]}, "/robot lacks abs_x, abs_y, abs_z"),
        ({"joints": NAMES, "interface_name": "velocity"}, "/robot takes velocity, not position: set output.interface"),
        ({}, ""),
    ],
)
def test_a_controller_that_would_misunderstand_its_commands_gets_none(make: Any, parameters: Any, wrong: str) -> None:
    """A Float64MultiArray has neither names nor units. Until the controller has answered, nobody is sent anything."""
    driven = Driven(make, asks=True)
    one = driven.one
    others = [one.beside(name) for name in ("listener", "robot")]
    for node in others:
        node.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    for name, value in parameters.items():
        others[1].declare_parameter(name, list(value) if isinstance(value, tuple) else value)
    listener, robot, own = (SingleThreadedExecutor(context=node.context) for node in (*others, driven.node))
    for executor, node in zip((listener, robot, own), (*others, driven.node), strict=True):
        executor.add_node(node)

    def wait_for(*answering: SingleThreadedExecutor, answers: int) -> None:
        until(lambda: driven.tick(0.0) or len(driven.node._controllers._found) == 2)

        def answered() -> bool:
            driven.tick(0.0)
            for executor in (*answering, own):
                executor.spin_once(0.005)
            return sum(not one.left for one in driven.node._controllers._found.values()) == answers

        until(answered)

    wait_for(listener, answers=1)
    assert not driven.sent
    wait_for(listener, robot, answers=2)
    driven.tick(0.1)  # sees the last answer
    driven.tick(0.1)
    assert bool(driven.sent) == (not wrong)
    assert one.got["plant_ready"][-1].data == (not wrong)
    assert wrong in driven.node._blind
    for executor in (listener, robot, own):
        executor.shutdown()


@pytest.mark.parametrize(("name", "trusted"), [("robot", True), (UNKNOWN, False)])
def test_only_a_known_controller_without_parameters_is_trusted(
    make: Any, monkeypatch: pytest.MonkeyPatch, name: str, trusted: bool
) -> None:
    """Such as one of micro-ROS; a node whose name has not been discovered yet may have parameters."""
    driven = Driven(make, asks=True)
    end = SimpleNamespace(node_namespace="/", node_name=name, endpoint_gid=[1])
    monkeypatch.setattr(driven.node, "get_subscriptions_info_by_topic", lambda _: [end])
    monkeypatch.setattr(driven.node._output, "get_subscription_count", lambda: 1, raising=False)
    for _ in range(round(2.5 / DT)):
        driven.tick(0.1)
    assert not driven.sent
    for _ in range(round(1.0 / DT)):
        driven.tick(0.1)
    assert bool(driven.sent) == trusted


def test_a_second_node_that_commands_the_robot_stops_it(make: Any) -> None:
    """Such as another drive, or sliders: the robot would jump from the goals of one to those of the other."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    robot, sliders = (driven.one.beside(name) for name in ("robot", "sliders"))
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    until(lambda: driven.tick(0.1) or driven.sent)
    other = sliders.create_publisher(JointState, "joint_commands", 1)
    until(lambda: driven.tick(0.1) or driven.node._blind)
    assert driven.node._blind == "more than one node commands /joint_commands: /drive, /sliders"
    assert not driven.one.got["plant_ready"][-1].data
    sent = [msg.position for msg in driven.sent]
    driven.tick(0.1)
    assert all(msg.position == sent[-1] for msg in driven.sent[len(sent) :])
    sliders.destroy_publisher(other)
    until(lambda: driven.tick(0.1) or not driven.node._blind)


def test_a_controller_that_is_not_active_is_named(make: Any) -> None:
    """It subscribes to its commands as soon as it is configured, and ignores them until it is active."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    one = driven.one
    robot, manager = one.beside("legs"), one.beside("controller_manager")
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    publishers = [manager.create_publisher(DiagnosticArray, "/diagnostics", 1)]
    until(lambda: driven.tick(0.1) or driven.sent)

    def report(state: str) -> str:
        values = [KeyValue(key="arms.state", value="active"), KeyValue(key="legs.state", value=state)]
        values.append(KeyValue(key="legs.execution_time", value="Avg: 3.00 us"))
        status = DiagnosticStatus(name="controller_manager: Controllers Activity", values=values)
        one.send("/diagnostics", DiagnosticArray(status=[DiagnosticStatus(name="other"), status]))
        driven.tick(0.1)
        return str(driven.node._blind)

    until(lambda: report("inactive"))
    expected = "the controller legs is inactive: `ros2 control set_controller_state legs active`"
    assert report("inactive") == expected
    assert not one.got["plant_ready"][-1].data
    assert report("active") == ""
    publishers.append(one.foreign_node("controller_manager").create_publisher(DiagnosticArray, "/diagnostics", 1))
    until(lambda: driven.node.count_publishers("/diagnostics") == 3)
    assert report("inactive") == "", "of which of the managers?"


def test_a_drive_that_ends_is_not_ready(make: Any) -> None:
    """The latched message of one that is gone would remain, and the walk fail with a joint that is blocked."""
    one = Driven(make)
    one.tick(0.1)
    assert one.one.got["plant_ready"][-1].data
    one.node.close()
    assert not one.one.got["plant_ready"][-1].data


def test_a_controller_that_is_loaded_again_is_asked_again(make: Any) -> None:
    """It may have another order now; meanwhile a listener remains, which is no controller."""
    driven = Driven(make, asks=True)
    made = [driven.one.beside(name) for name in ("listener", "robot", "again")]
    made[1].declare_parameter("joints", list(NAMES))
    made[2].declare_parameter("joints", list(NAMES[::-1]))
    executors = [SingleThreadedExecutor(context=node.context) for node in (*made, driven.node)]
    for executor, node in zip(executors, (*made, driven.node), strict=True):
        executor.add_node(node)

    def happens(expected: Any) -> None:
        def happened() -> bool:
            driven.tick(0.1)
            for executor in executors:
                executor.spin_once(0.002)
            return bool(expected())

        until(happened)

    listener, robot, again = made
    listener.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    before = robot.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    happens(lambda: driven.sent)
    robot.destroy_subscription(before)
    happens(lambda: "does not subscribe to" in driven.node._blind)
    sent = len(driven.sent)
    again.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    happens(lambda: "/again has its joints in another order" in driven.node._blind)
    assert len(driven.sent) == sent
    for executor in executors:
        executor.shutdown()


@pytest.mark.parametrize("kind", ["float64_multi_array", "joint_trajectory", "joint_state"])
def test_positions_are_integrated_and_in_the_order_of_the_controller(make: Any, kind: str) -> None:
    joints = (EXTRA[1], *reversed(NAMES))
    one = Driven(make, output__type=kind, output__joints=joints, output__topic="told")
    for _ in range(3):
        one.tick(0.1)
    last = one.sent[-1]
    output = {
        "float64_multi_array": lambda: last.data,
        "joint_trajectory": lambda: last.points[0].positions,
        "joint_state": lambda: last.position,
    }[kind]()
    assert output[0] == 0.4  # the camera joint keeps its position
    np.testing.assert_allclose(output[1:], POSTURE[::-1] + 3 * DT * 0.1, atol=1e-12)
    if kind == "joint_trajectory":
        assert last.joint_names == list(joints)
        assert last.points[0].time_from_start.nanosec == round(DT * 1e9)


def test_commanded_positions_stay_close_to_the_measured_ones(make: Any) -> None:
    one = Driven(make)
    for _ in range(200):
        one.tick(0.5)
    within_delay = 0.5 * Drive.of(POPPY, MODEL).delay  # the motion that the robot may still make
    np.testing.assert_allclose(one.out - POSTURE, POPPY.servo.window + within_delay, atol=1e-9)


def test_velocity_output_matches_position_output_within_limits(make: Any) -> None:
    """Feed-forward torques are added as angles, limited to the joint velocity limits."""
    output = {}
    for interface in TOPIC:
        one = Driven(make, output__interface=interface)
        for _ in range(30):
            one.tick(0.1, 3.0)  # 0.05 rad, ten times the motion of a joint in a period
        output[interface] = np.array([msg.data for msg in one.sent])
    assert (np.abs(output["velocity"]) <= MODEL.velocity_max + 1e-12).all()
    np.testing.assert_allclose(POSTURE + DT * output["velocity"].sum(axis=0), output["position"][-1], atol=1e-9)


def led_by(make: Any, speeds: tuple[float | None, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return how far velocities lead beyond the positions at the end, shape (n,), and the velocities (N, n).

    In a period without a speed the controller of the robot neither publishes a state nor writes a command.
    """
    position = Driven(make)
    for speed in speeds:
        position.tick(speed)
    velocity, led, holds = Driven(make, output__interface="velocity"), POSTURE.copy(), np.zeros(MODEL.n)
    for speed in speeds:
        if speed is not None and velocity.sent:  # it writes what it has received
            holds = velocity.out
        velocity.tick(speed)
        led = led + DT * holds
    return led + DT * velocity.out - position.out, np.array([msg.data[: MODEL.n] for msg in velocity.sent])


def test_velocities_lead_to_the_positions_also_where_a_period_is_missed(make: Any) -> None:
    off, _ = led_by(make, (0.02, -0.01, None, 0.03, 0.02, None, 0.01, 0.02, 0.01, 0.02))
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_a_stop_takes_back_nothing(make: Any) -> None:
    off, sent = led_by(make, (0.02, 0.02, None, None, 0.0))
    assert (off > 1e-5).all()
    assert not sent[-1].any()


def test_joints_led_too_far_wait_and_never_move_against_their_command(make: Any) -> None:
    off, sent = led_by(make, (*[0.02] * 5, *[None] * 4, *[0.02] * 10))
    assert sent.min() >= 0.0
    assert sent.max() <= 0.04 + 1e-9
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


# ---------------------------------------------------------------------- end of the motion


@pytest.mark.parametrize("interface", list(TOPIC))
def test_a_robot_with_its_controller_killed_stops(make: Any, interface: str) -> None:
    """After 0.2 s at most: timeout, check interval and a period. The controllers of the robot have no timeout."""
    walk = Ros2ControlWalk(make, 50.0, interface)
    for _ in range(60):  # until the middle of the first transfer
        walk.update()
    plant, before = walk.robot.plant, 0
    speeds, goals = [float(np.abs(plant.state.dq).max())], [plant.commanded.copy()]
    for _ in range(40):
        before = len(walk.output)
        walk.update(killed=True)
        speeds.append(float(np.abs(plant.state.dq).max()))
        goals.append(plant.commanded.copy())
    commanded = max(k for k in range(1, 41) if (goals[k] != goals[k - 1]).any()) * walk.dt
    moved = max(k for k, speed in enumerate(speeds) if speed > 0.1 * speeds[0]) * walk.dt
    print(f"{interface}: {speeds[0]:.2f} rad/s, commands went on for {commanded:.2f} s, motion for {moved:.2f} s")
    assert speeds[0] > 0.1
    assert commanded <= 0.2
    assert len(walk.output) == before + 1  # it is repeated, because a message may be lost
    assert interface == "position" or not any(walk.output[-1].data)
    assert "holding still: no command for 0.1 s" in walk.drive.log


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


# ---------------------------------------------------------------------- wrong numbers


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


# ---------------------------------------------------------------------- rejected states and parameters


def test_no_output_without_all_angles(make: Any) -> None:
    """This includes joints outside the walk that must be commanded to keep their position."""
    one = Driven(make, output__joints=(*NAMES, "gripper"))
    for _ in range(3):
        one.tick(0.2)
    assert not one.sent
    assert "joints missing: gripper" in one.log
    one.node._diagnose()
    message = one.one.got["diagnostics"][-1].status[0].message
    assert message.startswith("no valid joint_states yet: joints missing: gripper; it has a_gripper")


def test_why_the_states_are_not_valid_is_said_on_diagnostics(make: Any) -> None:
    one = Driven(make)
    for _ in range(5):
        one.tick(0.1)
    for k in range(40):
        one.q[KNEE] = 4.0 + 0.1 * k
        one.tick(0.1)
    stopping = [text for level, text in one.log.lines if text.startswith("stopping")]
    assert len(stopping) == 1
    assert stopping[0].startswith("stopping: no valid joint_states for 0.1 s: outside the joint limits: l_knee_y by")


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"output.joints": NAMES[1:]}, f"lacks {NAMES[0]}, which the walk moves"),
        ({"output.joints": (*NAMES, NAMES[0])}, "names a joint twice"),
        ({"output.type": "joint_trajectory", "output.interface": "velocity"}, "needs 'output.interface' position"),
        ({"plant.lockstep": True}, "a robot does not wait"),
        (
            {"output.topic": "joint_states", "output.type": "joint_state"},
            "'output.topic' joint_states is a topic of the",
        ),
        ({"output.topic": "/plant_ready"}, "'output.topic' /plant_ready is a topic of the walk"),
    ],
)
def test_inconsistent_output_parameters_are_an_error(make: Any, values: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        make("drive", POPPY.updated(values))
