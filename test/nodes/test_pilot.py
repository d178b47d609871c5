"""The pilot walks a course by cmd_vel, in the time of the walk, and ends it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from inside import state
from rclpy.task import Future
from std_srvs.srv import Trigger

from dqwalk_ros.config import load

CONFIG = load("poppy").updated({"gait.steps": 0})


def test_a_wrong_stamp_does_not_end_the_course_of_the_pilot(make: Any) -> None:
    """Nor does a clock that is set."""
    pilot = make("pilot", CONFIG, "--cmd-vel", "0.01,0,0,10")
    pilot.node._twists.get_subscription_count = lambda: 1
    for stamp in (*np.arange(1.0, 3.0, 0.1), 2e9, *np.arange(3.0, 5.0, 0.1), *np.arange(1e9, 1e9 + 7.0, 0.1)):
        pilot.send("joint_velocity_commands", state([], [], stamp))
        pilot.node._steer()
    forward = [msg.linear.x for msg in pilot.got["cmd_vel"]]
    assert 97 <= forward.count(0.01) <= 105  # 10 s, in which the time stands still for 3 states
    assert forward[-1] == 0.0
    now = pilot.node._now
    pilot.send("joint_velocity_commands", state([], [], 5.0))
    assert pilot.node._now == now


def test_the_pilot_says_after_2_s_and_every_10_s_that_it_waits_for_a_controller(make: Any) -> None:
    pilot = make("pilot", CONFIG, "--cmd-vel", "0.01,0,0,1")
    assert "a course of 1 s in 1 leg" in [line for _, line in pilot.log.lines]
    for periods, times in ((19, 0), (1, 1), (99, 1), (1, 2)):
        for _ in range(periods):
            pilot.node._steer()
        assert pilot.log.lines.count(("info", "waiting for a controller")) == times


def test_the_end_of_a_course_is_asked_for_until_the_controller_agrees(make: Any) -> None:
    """An answer may be lost, and a controller that is paused refuses."""
    pilot = make("pilot", CONFIG, "--cmd-vel", "0.01,0,0,1")
    asked: list[Future] = []

    def call(request: Trigger.Request) -> Future:
        asked.append(Future())
        return asked[-1]

    ready = [False]
    pilot.send("joint_velocity_commands", state([], [], 1.0))
    pilot.node._steer()
    assert not pilot.got["cmd_vel"], "no node subscribes"
    pilot.node._twists.get_subscription_count = lambda: 1
    pilot.node._stopping = SimpleNamespace(service_is_ready=lambda: ready[0], call_async=call, destroy=lambda: None)

    def steer(periods: int) -> int:
        for _ in range(periods):
            pilot.node._steer()
        return len(asked)

    pilot.send("joint_velocity_commands", state([], [], 5.0))
    assert steer(1) == 0
    for stamp in np.arange(5.0, 6.0, 0.1):
        pilot.send("joint_velocity_commands", state([], [], stamp))
        assert steer(1) == 0
    assert {msg.linear.x for msg in pilot.got["cmd_vel"]} == {0.01}
    pilot.send("joint_velocity_commands", state([], [], 6.01))
    assert steer(20) == 0, "no controller has the service"
    assert pilot.got["cmd_vel"][-1].linear.x == 0.0
    ready[0] = True
    assert steer(1) == 1
    assert steer(19) == 1
    assert steer(1) == 2, "the first answer is lost"
    asked[-1].set_result(Trigger.Response(success=False, message="not walking: paused"))
    assert steer(20) == 3
    text = "end of the course; the controller answers: not walking: paused"
    assert pilot.log.lines.count(("info", text)) == 1
    asked[-1].set_result(Trigger.Response(success=False, message="not walking: paused"))
    assert steer(20) == 4
    assert pilot.log.lines.count(("info", text)) == 1
    assert not pilot.node.done.done()
    asked[-1].set_result(Trigger.Response(success=True, message="stopping"))
    assert steer(1) == 4
    assert pilot.node.done.result() == 0
