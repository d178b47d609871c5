"""The robot stands after its controller was killed, reset, paused or frozen in the middle of a step."""

from __future__ import annotations

import functools
import itertools
import math
import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Next, PhaseKind
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import Plant
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.walks.table import make_controller, make_walk

MOMENTS = 20
"""Instants of one step: the second double support of a walk, and the single support after it."""
BEGIN, STEP = 3.0, 3.0
"""Start and duration of that step [s]."""
HELD = {"kill": 1.1, "reset": 0.2, "pause": 2.0, "freeze": 0.0}
FROZEN = (0.3, 2.0, 30.0)
AFTER = 5.0
"""Time for which it must not fall afterwards [s]: a foot in the air is put down, and the next one lifted."""

CONFIG = functools.cache(lambda plant: overlaid(load("poppy"), plant).updated({"gait.steps": 6}))


def step_without_controller(plant: Plant, steps: list[tuple[float, Command]], dt: float) -> None:
    """Step the plant with a fixed command for each span of time [s]."""
    for span, command in steps:
        for _ in range(round(span / dt)):
            plant.step(command, dt)


DEFAULT = {("physics", "kill", 14), ("poppy_as_built", "freeze", 15)}
CASES = [
    pytest.param(*case, id="-".join(map(str, case)), marks=() if case in DEFAULT else pytest.mark.long)
    for case in itertools.product(("physics", "poppy_as_built"), HELD, range(MOMENTS))
]


@pytest.mark.parametrize(("plant", "fault", "moment"), CASES)
def test_the_robot_does_not_fall_when_its_controller_fails(plant: str, fault: str, moment: int) -> None:
    config = CONFIG(plant)
    model = load_model(config.robot)
    controller, robot = make_controller(config, model), make_plant("physics", config, model)
    at = BEGIN + (moment + 0.5) / MOMENTS * STEP
    last = next(command for state, command in closed_loop(controller, robot) if state.time >= at)
    still, timeout = Command(at, np.zeros(model.n)), config.plant.command_timeout
    span = HELD[fault] or FROZEN[moment % len(FROZEN)]
    silent = [(timeout, last), (span, still)] if fault in ("kill", "freeze") else [(span, still)]
    step_without_controller(robot, silent, config.dt)
    assert not robot.fallen
    if fault in ("kill", "reset"):
        controller = make_controller(config, model)
    end = robot.state.time + AFTER
    for state, _ in closed_loop(controller, robot):
        if state.time >= end:
            break
    assert not robot.fallen
    assert state.time >= end


DYNAMIC = overlaid(load("poppy_dynamic"), "physics").updated({"qp.solver": "daqp", "gait.steps": 8})
PAUSES = [1.4, *(pytest.param(t, marks=pytest.mark.long) for t in (0.1, *(1.0 + 0.025 * k for k in range(MOMENTS))))]
"""Times at which the dynamic walk is paused [s]: in mid-swing, before the first step, and in all of a step."""


@pytest.mark.parametrize("at", PAUSES)
def test_a_paused_dynamic_walk_puts_its_feet_together_stands_and_continues(make: Any, at: float) -> None:
    """In mid-step it would fall without commands."""
    node, model = make("controller", DYNAMIC), load_model(DYNAMIC.robot)
    robot, dt, time = make_plant("physics", DYNAMIC, model), DYNAMIC.dt, 0.0

    def walk(until: Callable[[], bool], most: float) -> None:
        nonlocal time
        begin = time
        while not until():
            node.exchange(robot, model, 1.0 + time)
            time += dt
            assert not robot.fallen
            assert time < begin + most

    def moved() -> float:
        return float(DQ(robot.truth.pelvis).translation()[0])

    walk(lambda: time >= at, 5.0)
    refused = node.call("reset", Trigger.Request())
    assert not refused.success
    assert "call ~/pause first" in refused.message
    answer = node.call("pause", Trigger.Request())
    assert answer.success
    assert "puts its feet together" in answer.message
    assert node.got["phase"][-1].data.split("/")[0] in ("stance", "single_support", "double_support")
    walk(lambda: node.got["phase"][-1].data == "paused", 4.0)
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    feet = [DQ(x).translation()[0] for x in robot.truth.soles.values()]
    assert abs(feet[0] - feet[1]) < 0.01
    stood, end = moved(), time + 1.0
    walk(lambda: time >= end, 2.0)
    assert abs(moved() - stood) < 0.01
    assert node.call("start", Trigger.Request()).success
    walk(lambda: moved() > stood + 0.05, 5.0)
    assert node.call("pause", Trigger.Request()).success
    assert node.call("start", Trigger.Request()).success  # before it stands
    walk(lambda: node.got["phase"][-1].data == "finished", 8.0)


@pytest.mark.parametrize("name", ["poppy_dynamic", "paper"])
def test_a_walk_ends_in_a_stance_when_the_plant_warns_and_none_begins(make: Any, name: str) -> None:
    """In mid-swing; a walk that cannot stop is paused."""
    config = DYNAMIC if name == "poppy_dynamic" else load("paper").updated({"plant.lockstep": False})
    node, model = make("controller", config), load_model(config.robot)
    robot, dt, time = make_plant("physics" if config is DYNAMIC else "integrator", config, model), config.dt, 0.0

    def walk(until: Callable[[], bool], most: float = 10.0) -> None:
        nonlocal time
        end = time + most
        while not until():
            node.exchange(robot, model, 1.0 + time)
            time += dt
            assert not robot.fallen
            assert time < end

    def call(service: str) -> Any:
        return node.call(service, Trigger.Request())

    first = "single_support" if config is DYNAMIC else "double_support"
    walk(lambda: bool(node.got["phase"]) and node.got["phase"][-1].data.startswith(first))
    walk(lambda end=time + 0.2: time >= end)
    node.send("plant_warning", String(data="l_knee_y is at 61 degC"))
    if config is not DYNAMIC:
        assert node.got["phase"][-1].data == "paused"
        walk(lambda end=time + dt: time >= end)
    else:
        walk(lambda: node.got["phase"][-1].data == "finished")
        feet = [DQ(x).translation()[0] for x in robot.truth.soles.values()]
        assert abs(feet[0] - feet[1]) < 0.01
        assert "ticks: l_knee_y is at 61 degC" in node.log
        assert call("reset").success
    assert not any(node.got["joint_velocity_commands"][-1].velocity)
    node.tick()
    refused = call("start")
    assert (refused.success, refused.message) == (
        False,
        "the plant warns: l_knee_y is at 61 degC; an empty text on plant_warning withdraws it",
    )
    node.send("plant_warning", String(data=""))
    assert call("start").success
    walk(lambda: any(node.got["joint_velocity_commands"][-1].velocity))


def test_a_robot_holds_still_at_once_unless_it_would_fall() -> None:
    """A quasi-static walk does in each posture; steps that catch a push do not."""
    for name, holds in (("paper", True), ("poppy", True), ("poppy_dynamic", False)):
        config = load(name)
        model = load_model(config.robot)
        controller = make_controller(config, model)
        assert controller.may_hold  # before the first state
        plant = make_plant("integrator", config, model)
        controller.step(plant.state, config.dt)
        assert controller.may_hold is holds
        controller._active = getattr(controller.walk, "steps", controller.walk)
        assert controller.may_hold is (name == "paper")


@pytest.mark.parametrize("support", list(Foot))
def test_a_foot_in_the_air_is_put_down_first(support: Foot) -> None:
    config = CONFIG("physics").updated({"gait.first_support": support.value})
    model = load_model(config.robot)
    walk = make_walk(config, model)
    assert walk.following(None, Kinematics(model, walk.posture, Foot.LEFT)) == Next(PhaseKind.DOUBLE_SUPPORT, support)
    for bent in Foot:
        q = walk.posture.copy()
        for joint, angle in (("hip_y", -0.3), ("knee_y", 0.6), ("ankle_y", -0.3)):
            q[model.joint_names.index(f"{bent.value[0]}_{joint}")] += angle
        begins = walk.following(None, Kinematics(model, q, Foot.LEFT))
        assert (begins.kind, begins.support) == (PhaseKind.SINGLE_SUPPORT, bent.other)
        assert DQ(begins.swing_target).translation()[2] == pytest.approx(0.0)


@pytest.mark.parametrize("degrees", [-6.0, 6.0])
def test_no_foot_is_in_the_air_on_a_slope_to_the_side(degrees: float) -> None:
    config = CONFIG("physics")
    model = load_model(config.robot)
    walk, slope = make_walk(config, model), math.radians(degrees)
    up = [0.0, math.sin(slope), math.cos(slope)]
    assert walk.following(None, Kinematics(model, walk.posture, Foot.LEFT, up)).kind is PhaseKind.DOUBLE_SUPPORT


@pytest.mark.long
def test_a_new_controller_continues_the_walk_in_mid_swing(nodes: Any) -> None:
    """Through ROS, in real time; the old one is killed."""
    live = nodes(CONFIG("poppy_as_built").updated({"gait.steps": 100}))
    live.start("physics")
    live.start("controller")
    live.until(lambda: live.phase == "single_support/right", 120.0, "the second swing")
    began = live.stamp()
    live.until(lambda: live.stamp() > began + 0.7, 20.0, "its middle")
    live.processes.signal("controller", signal.SIGKILL)
    live.processes.wait("controller", 10.0)
    seen = len(live.phases())
    live.start("controller")
    live.until(lambda: sum("support/" in p for p in live.phases()[seen:]) >= 5, 120.0, "two more steps")
    walked = [p for p in live.phases()[seen:] if "support/" in p]
    assert walked[:2] == ["single_support/right", "double_support/left"]
    assert "fell" not in live.processes.log("physics")
