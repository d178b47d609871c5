"""What a lab's robot and other people's nodes say and do, which this package's own never did.

Each test is a defect that was found where the package was used beside Jazzy's own nodes; it failed before its mend.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

from geometry_msgs.msg import Twist
from inside import inside, state
from rclpy.node import Node

from dqwalk_ros.config import load, to_yaml
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.safety import DuplicateStates
from dqwalk_ros.robot import load_model

PAPER = load("paper")
MODEL = load_model(PAPER.robot)
NAMES, ZERO = MODEL.joint_names, np.zeros(MODEL.n)
DT = PAPER.dt


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with inside(tmp_path) as made:
        yield made


# ---------------------------------------------------------------------- states


@pytest.mark.parametrize("bad", [ZERO + np.nan, np.append(np.inf, ZERO[1:])], ids=["all", "one"])
def test_velocities_that_nobody_measures_are_missing(make: Any, bad: np.ndarray) -> None:
    """Jazzy's joint_state_broadcaster fills in NaN for what a position servo does not measure."""
    one = make("controller", PAPER)
    for k in range(5):
        one.hand("joint_states", state(NAMES, ZERO, 1.0 + k * DT, velocity=bad))
    assert len(one.got["joint_velocity_commands"]) == 5
    assert "rejected" not in one.log


def test_diagnostics_of_rejected_states_come_at_the_rate_of_diagnostics(make: Any) -> None:
    one = make("controller", PAPER)
    for k in range(100):
        one.hand("joint_states", state(NAMES, np.full(MODEL.n, np.nan), 1.0 + k * DT))
    assert 1 <= len(one.got["diagnostics"]) <= 5


def test_a_gripper_on_joint_states_is_somebody_else(make: Any) -> None:
    """Partial publishers are common practice: hands, heads, joint_state_publisher."""
    one = make("controller", PAPER)
    gripper = Node("gripper", context=one.context)
    gripper.create_publisher(type(state(NAMES, ZERO, 0.0)), "joint_states", 1)
    plant = Node("plant", context=one.context)
    plant.create_publisher(type(state(NAMES, ZERO, 0.0)), "joint_states", 1)
    try:
        for look in range(4):
            for k in range(50):
                at = 1.0 + (50 * look + k) * DT
                one.hand("joint_states", state(NAMES, ZERO, at))
                one.hand("joint_states", state(["finger"], [0.1], at))
            one.tick()
            one.tick()
    finally:
        gripper.destroy_node()
        plant.destroy_node()
    assert len(one.got["joint_velocity_commands"]) >= 200
    assert "two plants" not in one.log
    assert "rejected" not in one.log


PUBLISHERS = ("/a", "/b")


def looks(stamps: list[list[int]], names: list[tuple[str, ...]] | None = None) -> list[str]:
    judge, out = DuplicateStates(DT), []
    for look in stamps:
        for k, stamp in enumerate(look):
            judge.note((names or [NAMES])[k % len(names or [NAMES])], stamp)
        out.append(judge.judge(PUBLISHERS))
    return out


def test_two_plants_are_told_by_what_they_publish() -> None:
    period = round(DT * 1e9)
    single = [[(50 * look + k) * period for k in range(50)] for look in range(4)]
    assert looks(single) == [""] * 4
    assert looks([look[::3] for look in single]) == [""] * 4  # most are lost
    double = [sorted([*look, *(stamp + 1000 for stamp in look)]) for look in single]
    assert looks(double) == ["", "/a, /b", "/a, /b", "/a, /b"]
    other_clock = [[stamp + (10**12 if k % 2 else 0) for k, stamp in enumerate(look)] for look in single]
    assert looks(other_clock)[1] == "/a, /b"
    assert looks(single, [NAMES, (*NAMES, "head")])[1] == "/a, /b"


# ---------------------------------------------------------------------- commands


def moved(make: Any, stamp_of: Any) -> tuple[Any, float]:
    """Return an integrator in real time that was told to move by commands with such stamps, and how far it did."""
    one = make("integrator", PAPER.updated({"plant.command_timeout": 0.1}))
    (period, *_) = [t for t in one.node.timers if t.timer_period_ns == round(DT * 1e9)]
    for _ in range(20):
        period.callback()
        published = ros.nanoseconds(one.got["joint_states"][-1].header.stamp)
        one.hand(
            "joint_velocity_commands",
            state(NAMES, [], 1e-9 * stamp_of(published, one.node.get_clock().now().nanoseconds), velocity=ZERO + 0.1),
        )
    return one, float(np.abs(one.node.plant.state.q).max())


@pytest.mark.parametrize(
    "stamp_of", [lambda state, now: state, lambda state, now: now, lambda state, now: 0], ids=["state", "now", "unset"]
)
def test_commands_count_whatever_way_they_are_stamped(make: Any, stamp_of: Any) -> None:
    """joint_state_topic_hardware_interface and teleoperation stamp now(), `ros2 topic pub` does not stamp at all."""
    one, far = moved(make, stamp_of)
    assert far > 0.0
    assert one.node.commands.gate.late == 0


def test_a_command_out_of_time_is_ignored_and_the_plant_says_why(make: Any) -> None:
    one, far = moved(make, lambda state, now: now + 3_000_000_000)
    assert far == 0.0
    assert "joint_velocity_commands ignored" in one.log
    for _ in range(2):
        one.tick()
    assert "stamped 3.0" in one.got["diagnostics"][-1].status[0].message


# ---------------------------------------------------------------------- topics


def test_phase_shows_what_is_now(make: Any) -> None:
    """`ros2 topic echo --once /phase` asks for a history of more than one; the log of all is a topic of its own."""
    one = make("controller", PAPER)
    offered = {p.topic_name: p for p in one.node.publishers}
    assert offered["/phase"].qos_profile.depth == offered["/support_foot"].qos_profile.depth == 1
    assert offered["/phase_log"].qos_profile.depth == 100
    one.hand("joint_states", state(NAMES, ZERO, 1.0))
    assert [m.data for m in one.got["phase"]] == [m.data for m in one.got["phase_log"]] == ["double_support/left"]


def test_what_steers_a_walk_is_in_its_bag(make: Any, tmp_path: Path) -> None:
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    pilot = Node("pilot", context=one.context)
    twists = pilot.create_publisher(Twist, "cmd_vel", 1)
    try:
        for _ in range(200):
            one.node._look_for_others()
            if "cmd_vel" in one.node._others:
                break
        assert one.node._others["cmd_vel"].type == "geometry_msgs/msg/Twist"
        assert "/rosout" in one.node._others
    finally:
        twists.destroy()
        pilot.destroy_node()
        one.node.close()


# ---------------------------------------------------------------------- parameters


def test_a_file_of_a_whole_robot_is_taken(make: Any) -> None:
    """ROS's rule: what a node does not declare is not for it."""
    text = to_yaml(PAPER) + "    robot_name: poppy\n    teleop: {scale: 2.0}\n/arm:\n  ros__parameters: {port: x}\n"
    one = make("controller", text)
    assert one.node.config == PAPER
    assert "somebody else, left alone: robot_name, teleop.scale" in one.log


def test_a_file_for_other_nodes_only_is_taken_with_a_warning(make: Any) -> None:
    one = make("phase_monitor", "/**/controller:\n  ros__parameters: {dt: 0.01}\n")
    assert one.node.config.dt == load("paper").dt
    assert "no section reaches /phase_monitor" in one.log
    assert "--params-file missing" in one.log  # `ros2 run dqwalk_ros controller` walks a robot of 25 joints


@pytest.mark.parametrize(
    ("key", "meant"),
    [("gate.step_length", "gait.step_length"), ("gait.step_lenght", "gait.step_length"), ("gait.foo", "unknown")],
)
def test_a_misspelt_key_is_an_error_all_the_same(make: Any, key: str, meant: str) -> None:
    with pytest.raises(ConfigError, match=meant):
        make("controller", f"/**:\n  ros__parameters:\n    {key}: 0.04\n")
