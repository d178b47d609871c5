"""Walks in physics through simulated controllers of ros2_control."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from driven import MODEL, NAMES, POPPY, TOPIC
from ros2_control import EXTRA, ControllerManager, Known
from std_msgs.msg import Bool

from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.plants.table import make_plant


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
