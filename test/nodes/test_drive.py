"""The node drive: conversion of commands for the controllers of a robot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from driven import DT, KNEE, MODEL, NAMES, POPPY, POSTURE, TOPIC, Driven
from ros2_control import EXTRA

from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.errors import ConfigError


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
