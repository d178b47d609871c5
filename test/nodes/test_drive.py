"""The node drive: conversion of commands for the controllers of a robot."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from inside import state, until
from ros2_control import EXTRA, ControllerManager
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.simulation import make_plant
from dqwalk_ros.support.errors import ConfigError

POPPY = overlaid(load("poppy"), "ros2_control")
MODEL = load_model(POPPY.robot)
NAMES = MODEL.joint_names
POSTURE = MODEL.posture(POPPY.standing.posture)
DT = POPPY.dt
TOPIC = {kind: f"forward_{kind}_controller/commands" for kind in ("position", "velocity")}


# ---------------------------------------------------------------------- walks


class Ros2ControlWalk:
    """A walk whose robot, in physics, is driven through ros2_control, simulated period by period."""

    def __init__(self, make: Any, rate: float, interface: str, **more: Any) -> None:
        self.dt = 1.0 / rate
        joints = (*EXTRA, *reversed(NAMES))
        values: dict[str, Any] = {"dt": self.dt, "servo.assumed_rate": rate, "servo.assumed_latency": self.dt}
        values |= {"output.interface": interface, "output.joints": joints, "node.autostart": True}
        self.config = POPPY.updated({**values, "qp.solver": "daqp", **more})
        self.robot = ControllerManager(make_plant("physics", self.config, MODEL), interface, joints, MODEL.imu, rate)
        self.controller, self.drive = make("controller", self.config), make("drive", self.config)
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


def check_walk(make: Any, rate: float, interface: str, steps: int) -> None:
    """Walk, and check that the robot has not fallen and has walked the distance."""
    walk = Ros2ControlWalk(make, rate, interface, **{"gait.steps": steps})
    robot, controller = walk.robot, walk.controller.node
    began = {foot: DQ(x).translation()[0] for foot, x in robot.plant.truth.soles.items()}
    while controller._mode.value == "walking" and not robot.plant.fallen:
        walk.update()
    assert controller._mode.value == "finished", (controller._problem, robot.updates * walk.dt)
    assert not robot.plant.fallen
    ahead = {foot: DQ(x).translation()[0] - began[foot] for foot, x in robot.plant.truth.soles.items()}
    print(f"{rate:g} Hz, {interface}: {robot.updates * walk.dt:.1f} s, feet {min(ahead.values()):.3f} m ahead")
    assert list(ahead.values()) == pytest.approx([steps * walk.config.gait.step_length] * 2, rel=0.2)


def test_one_step_through_ros2_control(make: Any) -> None:
    check_walk(make, 50.0, "velocity", 1)


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


def test_no_output_before_the_topic_has_a_subscriber(make: Any) -> None:
    """The walk waits until the output topic has a subscriber."""
    one = make("drive", POPPY)
    one.send("joint_velocity_commands", command())
    one.send("joint_states", measured(POSTURE))
    one.tick()
    assert not one.got[TOPIC["position"]]
    assert [msg.data for msg in one.got["plant_ready"]] == [False]
    assert "no node subscribes to /forward_position_controller/commands" in one.got["diagnostics"][-1].status[0].message
    robot = one.foreign_node("controller_manager")
    robot.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    until(lambda: one.tick() or len(one.got["plant_ready"]) > 1)
    assert one.got["plant_ready"][-1].data


@pytest.mark.parametrize("kind", ["float64_multi_array", "joint_trajectory", "joint_state"])
def test_positions_are_integrated_and_in_the_order_of_the_controller(make: Any, kind: str) -> None:
    joints = (EXTRA[1], *reversed(NAMES))
    one = make("drive", POPPY.updated({"output.type": kind, "output.joints": joints, "output.topic": "told"}))
    for k in range(3):
        one.send("joint_states", measured(POSTURE, 1.0 + k * DT))
        one.send("joint_velocity_commands", command(1.0 + k * DT, 0.1))
    last = one.got["told"][-1]
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
    one = make("drive", POPPY)
    for k in range(200):
        one.send("joint_states", measured(POSTURE, 1.0 + k * DT))  # the robot does not move
        one.send("joint_velocity_commands", command(1.0 + k * DT, 0.5))
    output = np.array(one.got[TOPIC["position"]][-1].data)
    within_delay = 0.5 * Drive.of(POPPY, MODEL).delay  # the motion that the robot may still make
    np.testing.assert_allclose(output - POSTURE, POPPY.servo.window + within_delay, atol=1e-9)


def test_velocity_output_matches_position_output_within_limits(make: Any) -> None:
    """Feed-forward torques are added as angles, limited to the joint velocity limits."""
    torques = np.full(MODEL.n, 3.0)  # 0.05 rad, ten times the motion of a joint in a period
    output = {}
    for interface in TOPIC:
        one = make("drive", POPPY.updated({"output.interface": interface}))
        for k in range(30):
            one.send("joint_states", measured(POSTURE, 1.0 + k * DT))
            msg = command(1.0 + k * DT, 0.1)
            msg.effort = torques.tolist()
            one.send("joint_velocity_commands", msg)
        output[interface] = np.array([msg.data for msg in one.got[TOPIC[interface]]])
    assert (np.abs(output["velocity"]) <= MODEL.velocity_max + 1e-12).all()
    np.testing.assert_allclose(POSTURE + DT * output["velocity"].sum(axis=0), output["position"][-1], atol=1e-9)


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
    one = make("drive", POPPY.updated({"output.interface": "velocity"}))
    one.send("joint_states", measured(POSTURE))
    one.send("joint_velocity_commands", command(speed=0.2))
    assert any(one.got[TOPIC["velocity"]][-1].data)
    one.node.close()
    assert not any(one.got[TOPIC["velocity"]][-1].data)


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
    one = make("drive", POPPY.updated({"output.joints": (*NAMES, "gripper")}))
    one.send("joint_states", measured(POSTURE))
    one.send("joint_velocity_commands", command(speed=0.2))
    assert not one.got[TOPIC["position"]]
    assert "joints missing: gripper" in one.log


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"output.joints": NAMES[1:]}, f"lacks {NAMES[0]}, which the walk moves"),
        ({"output.joints": (*NAMES, NAMES[0])}, "names a joint twice"),
        ({"output.type": "joint_trajectory", "output.interface": "velocity"}, "needs 'output.interface' position"),
        ({"plant.lockstep": True}, "a robot does not wait"),
    ],
)
def test_inconsistent_output_parameters_are_an_error(make: Any, values: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        make("drive", POPPY.updated(values))
