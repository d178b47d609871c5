"""Attacks on nodes that once succeeded: each is rejected with its reason, and no node exits because of it."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from full_disk import limited_file_size
from geometry_msgs.msg import PoseStamped
from inside import state
from nav_msgs.msg import Path as NavPath
from rclpy.serialization import serialize_message
from rclpy.task import Future
from sensor_msgs.msg import Imu
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from dqwalk_ros.config import load, overlaid, with_files
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report.bag.storage import load as load_bag
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import PlantError, StateError

PAPER = load("paper").updated({"dt": 0.02})
MODEL = load_model(PAPER.robot)
GARBAGE = [b"", b"\x00", b"\x00\x01\x00\x00", bytes(11), b"\x00\x01\x00\x00" + struct.pack("<iI", 1, 0) + b"\xff" * 40]
"""The last one has a valid stamp."""


def serialized_state(stamp: float) -> bytes:
    return bytes(serialize_message(state(MODEL.joint_names, np.zeros(MODEL.n), stamp)))


def readable_states(path: Path) -> int:
    """Return the number of states that can be read from a bag."""
    return len(load_bag(path, lambda name, kind: True).columns["/joint_states"].raws)


# ---------------------------------------------------------------------- recorder, monitor, viewer


def test_the_recorder_skips_invalid_messages(make: Any, tmp_path: Path) -> None:
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    for k in range(100):
        one.send("joint_states", serialized_state(1.0 + 0.02 * k))
        if k == 50:
            for raw in (*GARBAGE[:-1], serialized_state(-5.0)):
                one.send("joint_states", raw)
                one.send("center_of_pressure", raw)
            one.send("joint_states", serialized_state(2_145_916_800.0))
    assert "joint_states not recorded: a message of 4 bytes has no header" in one.log
    assert "joint_states not recorded: its stamp is -5 s, before 1970" in one.log
    one.node.close()
    assert readable_states(tmp_path / "bag") == 101
    times = load_bag(tmp_path / "bag", lambda name, kind: True).columns["/joint_states"].times
    assert max(times) == times[-1] == round(1e9 * (1.0 + 0.02 * 99))  # the impossible stamp is not that of the bag


def test_a_recorder_without_a_robot_keeps_a_bounded_number_of_messages(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dqwalk_ros.nodes.recorder._MOST_EARLY", 3)
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    for k in range(2):
        for j in range(5):
            one.send("center_of_pressure", bytes(serialize_message(ros.point(10 * k + j, "world", np.zeros(3)))))
        one.send("walk_config", bytes(serialize_message(String(data="a"))))
    assert [name for name, _ in one.node._early] == ["center_of_pressure"] * 3 + ["walk_config"] * 2
    assert "nothing more is recorded before joint_states" in one.log


def test_missing_centres_of_pressure_are_not_counted_as_lost(make: Any, tmp_path: Path) -> None:
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    for k in (0, 1, 40):
        one.send("joint_states", serialized_state(1.0 + 0.02 * k))
        at = ros.point(round(1e9 * (1.0 + 0.02 * k)), "world", np.zeros(3))
        one.send("center_of_pressure", bytes(serialize_message(at)))
    assert one.node._missing["joint_states"] == 38
    assert one.node._missing["center_of_pressure"] == 0


@pytest.mark.parametrize("clock", [0.0, 1.0, 1.9e9])
def test_the_states_of_a_gripper_are_recorded_but_tell_no_time(make: Any, tmp_path: Path, clock: float) -> None:
    """Unstamped ones before those of the robot kept the time of the bag at zero; others were counted as gaps."""
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    stamps = 2.0 + PAPER.dt * np.arange(100)
    stray = state(["of another robot"], [0.0], stamps[0])
    one.send("joint_velocity_commands", bytes(serialize_message(stray)))
    for k, stamp in enumerate(stamps):
        if k % 5 == 0:
            gripper = state(["gripper"], [0.01 * k], clock + bool(clock) * PAPER.dt * k)
            one.send("joint_states", bytes(serialize_message(gripper)))
        one.send("joint_states", serialized_state(stamp))
        one.send("joint_velocity_commands", serialized_state(stamp))
        one.send("phase_log", bytes(serialize_message(String(data=str(k)))))
    assert not any(one.node._missing.values())
    one.node.close()
    assert "joint_states 100, " in one.log
    assert "joint_states of other joints 20" in one.log
    columns = load_bag(tmp_path / "bag", lambda name, kind: True).columns
    assert len(columns["/joint_states"].raws) == 120
    expected = np.round(1e9 * stamps).astype(np.int64)
    np.testing.assert_array_equal(columns["/joint_velocity_commands"].times[2:], expected[1:])
    np.testing.assert_array_equal(columns["/phase"].times[2:], expected[2:])


def test_commands_read_long_before_their_states_are_recorded_at_their_stamps(make: Any, tmp_path: Path) -> None:
    """A suspended recorder wakes with full queues, in lockstep of many seconds; each is read as a whole."""
    one, stamps = make("recorder", PAPER, "--bag", str(tmp_path / "bag")), PAPER.dt * np.arange(200, 3000)
    one.send("joint_states", serialized_state(stamps[0]))
    for topic in ("joint_velocity_commands", "joint_states"):
        for k, stamp in enumerate(stamps):
            msg = state(MODEL.joint_names, np.full(MODEL.n, 1e-3 * k), stamp)
            one.send(topic, bytes(serialize_message(msg)))
    assert not any(one.node._missing.values())
    one.node.close()
    found = load_bag(tmp_path / "bag", lambda name, kind: True).columns["/joint_velocity_commands"].times
    np.testing.assert_array_equal(found, np.round(1e9 * stamps).astype(np.int64))


@pytest.mark.parametrize(
    ("name", "again", "error"), [("bag", "", "No such file"), ("bag/bag.mcap", "bag/bag.mcap", "was replaced")]
)
def test_the_recorder_reports_a_deleted_recording(make: Any, tmp_path: Path, name: str, again: str, error: str) -> None:
    """Within a second, and with exit code 1 also if it ends before."""
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    one.send("joint_states", serialized_state(1.0))
    one.node._flush()
    (tmp_path / name).rename(tmp_path / "elsewhere")
    if again:
        (tmp_path / again).touch()
    for ends in (one.node._flush, one.node.close):
        one.log.lines.clear()
        one.node.done = Future()
        ends()
        assert error in one.log
        assert one.node.done.result() == 1


def test_the_recorder_reports_a_full_disk_and_keeps_the_recording(make: Any, tmp_path: Path) -> None:
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    rng = np.random.default_rng(1)
    with limited_file_size(300_000):
        for k in range(10_000):
            q = rng.uniform(-1.0, 1.0, MODEL.n)  # random, so that it cannot be compressed
            one.send("joint_states", bytes(serialize_message(state(MODEL.joint_names, q, 1.0 + 0.02 * k))))
            if not k % 100:
                one.node._flush()
            if one.node.done.done():
                break
        assert one.node.done.result() == 1
        one.node.close()
    assert "cannot write" in one.log
    assert 100 < readable_states(tmp_path / "bag") <= k


def test_monitor_and_viewer_ignore_invalid_messages(make: Any) -> None:
    walk, monitor, viewer = (
        make("controller", PAPER),
        make("phase_monitor", PAPER),
        make("viewer", PAPER, "--port", "0"),
    )
    walk.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), 1.0))
    for node in (monitor, viewer):
        node.follow(walk)
    for raw in GARBAGE:
        monitor.send("joint_states", raw)
    assert "joint_states rejected: a message of 1 bytes has no header" in monitor.log
    assert "a message that cannot be read" in monitor.log
    target = PoseStamped()
    target.pose.position.x = math.nan
    for node in (monitor, viewer):
        node.send("swing_target", target)
        assert "cannot rebuild the phase: swing_target is nan m away" in node.log
    monitor.node._next = -1
    monitor.send("joint_states", serialized_state(1.0))
    assert "double_support" in monitor.got["diagnostics"][-1].status[0].message
    for text in ("0.5 ms", "-1", "nan", "1e999", "\x1b[31m"):
        messages = [KeyValue(key="iterations", value=text), KeyValue(key="solve time", value=text)]
        status = DiagnosticStatus(name="controller: walk", level=b"\x00", message=text, values=messages)
        viewer.send("/diagnostics", DiagnosticArray(status=[status]))
    viewer.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), 1.0))
    viewer.node._show()
    viewer.node.close()


def test_monitor_and_viewer_keep_the_phase_through_single_wrong_stamps(make: Any) -> None:
    """They forget it when time was set back, which three states tell."""
    walk, monitor = make("controller", PAPER), make("phase_monitor", PAPER)
    viewer = make("viewer", PAPER, "--port", "0")
    walk.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), 5.0))
    for one in (monitor, viewer):
        one.follow(walk)

    def shown(stamp: float) -> bool:
        before, evaluated = viewer.node.page.shown, len(monitor.got["diagnostics"])
        monitor.send("joint_states", serialized_state(stamp))
        viewer.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), stamp))
        viewer.node._show()
        both = viewer.node.page.shown > before, len(monitor.got["diagnostics"]) > evaluated
        assert both[0] is both[1]
        return both[0]

    assert shown(5.0)
    for stamp, wrong in ((6.0, 0.0), (7.0, 3.0), (8.0, 2e9)):
        assert not shown(wrong)
        assert shown(stamp)
    assert [shown(t) for t in (1.0, 1.2, 1.4, 1.6)] == [False] * 4  # the phase began later
    viewer.node.close()


# ---------------------------------------------------------------------- controller, plant


@pytest.mark.parametrize(
    ("place", "rotation", "reason"),
    [
        ((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), "nan m away"),
        ((0.0, math.inf, 0.0), (1.0, 0.0, 0.0, 0.0), "inf m away"),
        ((0.0, 0.0, 1e300), (1.0, 0.0, 0.0, 0.0), r"1e\+300 m away; 1e\+06 m at most"),
        ((1e308, -1e308, 1e308), (1.0, 0.0, 0.0, 0.0), "m away"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "no unit quaternion: its norm is 0"),
        ((0.0, 0.0, 0.0), (1e200, 0.0, 0.0, 0.0), r"no unit quaternion: its norm is 1e\+200"),
        ((0.0, 0.0, 0.0), (1.0, math.nan, 0.0, 0.0), "no unit quaternion: its norm is nan"),
        ((0.0, 0.0, 0.0), (-1.7e308, 1.7e308, 1.7e308, 1.7e308), "no unit quaternion: its norm is inf"),
    ],
)
def test_no_number_of_a_pose_passes_or_ends_a_node(place: Any, rotation: Any, reason: str) -> None:
    """Footsteps, targets of hands and poses of a base: a square of such a number overflows."""
    msg = PoseStamped()
    p, r = msg.pose.position, msg.pose.orientation
    p.x, p.y, p.z = place
    r.w, r.x, r.y, r.z = rotation
    with pytest.raises(StateError, match=f"the pose .*{reason}"):
        ros.checked_pose(msg, "the pose")


def test_the_target_of_a_hand_of_a_whole_body_is_checked_as_any_other(make: Any) -> None:
    one = make("whole_body_controller", load("whole_body"))
    for far in (math.nan, 1e308):
        msg = PoseStamped()
        msg.pose.position.y = far
        one.send("hand_target", msg)
        assert f"hand_target rejected: it is {far:.3g} m away; 1e+06 m at most" in one.log


def test_states_stamped_before_1970_are_rejected(make: Any) -> None:
    one = make("controller", PAPER)
    for k in range(5):
        one.send("joint_states", state(MODEL.joint_names, np.zeros(MODEL.n), -100.0 + 0.02 * k))
    assert "joint_states rejected (1 so far): its stamp is -100 s, before 1970" in one.log
    assert not one.got["joint_velocity_commands"]


def test_long_lists_of_names_are_shortened_to_one_line(make: Any) -> None:
    one = make("controller", PAPER)
    names = [*MODEL.joint_names[1:], *(f"\x1b[31mjoint\n{k}" for k in range(20_000))]
    one.send("joint_states", state(names, np.zeros(len(names)), 1.0))
    messages = json.dumps([status.message for msg in one.got["diagnostics"] for status in msg.status])
    for text in (messages, *(line for _, line in one.log.lines)):
        assert text.isprintable()
        assert len(text) < 2000
    assert "and 19988 more" in one.log


@pytest.mark.parametrize("name", ["\x1b[31m\n\u202e", "x" * 10_000])
def test_names_of_frames_and_joints_are_shortened_to_one_line(make: Any, name: str) -> None:
    config = with_files(overlaid(load("poppy"), "physics"), [Path("arms")]).updated({"gait.steps": 0})
    one = make("controller", config)
    model = one.node._model
    plant = make_plant("physics", one.node.config, model)
    one.exchange(plant, model, 1.0)
    header = Header(frame_id=name)
    pose = PoseStamped(header=header)
    pose.pose.orientation.w = 1.0
    one.send("footsteps", NavPath(header=header, poses=[PoseStamped(pose=pose.pose)]))
    one.send("footsteps", NavPath(header=Header(frame_id="l_sole"), poses=[pose]))
    one.send("left_hand_target", pose)
    one.send("arm_trajectory", JointTrajectory(joint_names=[name]))
    one.send("imu", Imu(header=header))
    one.send("joint_states", state(model.joint_names, plant.state.q, 1.0 + config.dt))
    said = [line for level, line in one.log.lines if level == "error" or "refused" in line]
    assert len(said) == 5, said
    for text in said:
        assert text.isprintable()
        assert len(text) < 500


def test_a_reset_of_the_simulated_robot_ends_the_walk(make: Any) -> None:
    """In physics, during a swing: the walk has failed, the commands are zero and the robot stands."""
    config = overlaid(load("poppy"), "physics").updated({"qp.solver": "daqp"})
    model = load_model(config.robot)
    node, plant = make("controller", config), make_plant("physics", config, model)
    for k in range(500):
        if k == 400:
            assert node.got["phase"][-1].data.startswith("single_support")
            plant = make_plant("physics", config, model)
        u = node.exchange(plant, model, 1.0 + k * config.dt)
    assert node.got["phase"][-1].data == "failed"
    assert not u.any()
    assert not plant.fallen


def test_physics_says_why_commands_have_no_effect(make: Any) -> None:
    one = make("physics", overlaid(load("poppy"), "physics"))
    node = one.node
    one.send("joint_velocity_commands", state(node.model.joint_names, [], 0.0, velocity=np.zeros(node.model.n)))
    node._on_period()
    node.plant._law.gate.fault = "l_knee_y has jumped to another angle"
    node._on_period()
    node._on_period()
    assert not one.got["plant_ready"][-1].data
    assert "holding still: l_knee_y has jumped to another angle" in one.log
    assert one.call("reset", Trigger.Request()).success
    node._on_period()
    assert one.got["plant_ready"][-1].data


def test_a_diverged_simulation_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a log
    config = overlaid(load("poppy"), "physics")
    plant = make_plant("physics", config, load_model(config.robot))
    plant.push([1e300, 0.0, 0.0])
    zero = Command(0.0, np.zeros(plant.model.n))
    with pytest.raises(PlantError, match="not finite any more"):
        plant.step(zero, config.dt)
