"""The whole-body controller and its plant as real processes, in lockstep."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from live import Live
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load
from dqwalk_ros.report import bag
from dqwalk_ros.robot import load_model
from dqwalk_ros.runner import private_domain
from dqwalk_ros.whole_body import WholeBodyController, retrace
from dqwalk_ros.whole_body.demands import checks
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

ROOT = Path(__file__).resolve().parent.parent
CONFIG = load("whole_body").updated({"plant.lockstep": True, "node.wait_for_recorder": True})


@pytest.fixture
def live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with private_domain() as domain:
        made = Live(tmp_path, domain, CONFIG)
        yield made
        made.close()


def test_it_walks_over_topics(live: Live, tmp_path: Path) -> None:
    """The torques are those of one process, tick by tick; a target is set and moved, a push is given; all is recorded.

    Solved again from the bag, every torque is that of the nodes: each target and push is in it at the state it was.
    """
    efforts: dict[int, JointState] = {}
    twists: list[TwistStamped] = []
    profile = QoSProfile(depth=1000)

    def note(msg: JointState) -> None:
        efforts[msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec] = msg

    live.node.create_subscription(JointState, "joint_effort_commands", note, profile)
    live.node.create_subscription(TwistStamped, "base_twist", twists.append, profile)
    target = live.node.create_publisher(PoseStamped, "hand_target", 10)
    push = live.node.create_publisher(WrenchStamped, "push", 10)
    live.start("recorder", "--bag", str(tmp_path / "bag"))
    live.start("whole_body_controller")
    live.start("rigid")
    live.until(lambda: len(efforts) > 40, 90.0, "forty ticks")

    model = load_model(CONFIG.robot)
    controller = WholeBodyController(CONFIG, model)
    plant = RigidPlant(model, controller.start, pushed="chest")
    for tick in range(30):
        command = controller.step(plant.state, CONFIG.dt)
        msg = efforts.get(round(tick * CONFIG.dt * 1e9))
        if msg is not None:  # the first may have come before this test listened
            got = np.array([msg.effort[msg.name.index(name)] for name in model.joint_names])
            assert got == pytest.approx(command.effort, abs=1e-3)
        plant.step(command, CONFIG.dt)

    live.until(lambda: target.get_subscription_count() and push.get_subscription_count(), 20.0, "listeners")
    goal = PoseStamped()
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = 1.2, -0.8, 0.9
    target.publish(goal)
    begun = len(efforts)
    live.until(lambda: len(efforts) > begun + 200, 60.0, "another second")
    at = len(twists)
    hit = WrenchStamped()
    hit.wrench.force.y = 4.0  # at a moment nobody chose: 10 N s can be more than a step under way can catch
    push.publish(hit)
    live.until(lambda: "pushed: 0, 4, 0 N s" in live.processes.log("rigid"), 20.0, "the push")

    def jump() -> bool:  # within one tick, and far beyond what walking does
        speeds = np.array([[t.twist.linear.x, t.twist.linear.y, t.twist.linear.z] for t in twists[at - 1 :]])
        return len(speeds) > 1 and bool(np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() > 0.05)

    live.until(jump, 30.0, "the velocity after it")
    goal.pose.position.x = 1.6  # while it walks
    target.publish(goal)
    moved = len(efforts)
    live.until(lambda: len(efforts) > moved + 100, 60.0, "half a second more")
    assert all(s.level == b"\x00" for s in live.statuses("whole_body_controller"))
    live.until(lambda: live.status("rigid") is not None, 20.0, "a word of the plant")
    assert live.status("rigid").level == b"\x00"

    stranger = live.node.create_publisher(JointState, "joint_effort_commands", 10)  # a second one, out of its mind
    names = list(model.joint_names)

    def mad() -> bool:
        stranger.publish(JointState(name=names, effort=[float("nan")] * len(names)))
        return "two controllers: /test, /whole_body_controller" in live.status("rigid").message

    live.until(mad, 20.0, "the plant holding still and naming both")
    assert live.processes.exit_code("rigid") is None
    live.node.destroy_publisher(stranger)
    ticks = len(efforts)
    live.until(lambda: len(efforts) > ticks + 5, 40.0, "the walk going on")

    live.processes.stop()
    log = bag.read_body(tmp_path / "bag")
    assert any("torque commands are incomplete or not finite" in note for note in log.notes)  # the stranger's
    assert [place for _, place in log.scenario.targets] == [(1.2, -0.8, 0.9), (1.6, -0.8, 0.9)]
    assert [impulse for _, impulse in log.scenario.pushes] == [(0.0, 4.0, 0.0)]
    assert len(log.states) > moved
    walked, off = retrace(log)
    assert walked.stood
    assert off < 1e-3
    assert [check.name for check in checks(walked) if not check.ok] == []


def test_the_launch_file_starts_what_is_installed() -> None:
    text = (ROOT / "launch" / "whole_body.launch.py").read_text(encoding="utf-8")
    calls = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "node"]
    started = {call.args[0].value for call in calls}
    assert started == {"whole_body_controller", "rigid", "recorder"}
    for name in started:
        script = ROOT / "scripts" / name
        assert script.stat().st_mode & 0o111
        assert f'main("{name}"' in script.read_text(encoding="utf-8")
