"""The whole-body controller and its plant: as processes in lockstep, and inside the test with invalid messages."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from inside import state
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import QPError
from dqwalk_ros.whole_body import BodyCommand, BodyState, WholeBodyController, retrace
from dqwalk_ros.whole_body import controller as core
from dqwalk_ros.whole_body.bag import read_body
from dqwalk_ros.whole_body.demands import checks
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

ROOT = Path(__file__).resolve().parents[2]
CONFIG = load("whole_body").updated({"plant.lockstep": True, "node.wait_for_recorder": True})


def test_a_walk_over_topics_equals_that_of_one_process_and_is_recorded(nodes: Any, tmp_path: Path) -> None:
    """The torques are equal at each tick; a target is set and moved, and a push applied.

    The walk solved again from the bag has the same torques, so each target and push is recorded at the right state.
    """
    live = nodes(CONFIG)
    efforts: dict[int, JointState] = {}
    twists: list[TwistStamped] = []
    profile = QoSProfile(depth=1000)

    def note(msg: JointState) -> None:
        efforts[msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec] = msg

    live.node.create_subscription(JointState, "joint_effort_commands", note, profile)
    live.node.create_subscription(TwistStamped, "base_twist", twists.append, profile)
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
        if msg is not None:  # the first may precede the subscription
            got = np.array([msg.effort[msg.name.index(name)] for name in model.joint_names])
            assert got == pytest.approx(command.effort, abs=1e-3)
        plant.step(command, CONFIG.dt)

    target = live.offer(PoseStamped, "hand_target", "whole_body_controller", "recorder")
    push = live.offer(WrenchStamped, "push", "rigid", "recorder")
    goal = PoseStamped()
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = 1.2, -0.8, 0.9
    target.publish(goal)
    begun = len(efforts)
    live.until(lambda: len(efforts) > begun + 80, 60.0, "0.4 s")
    at = len(twists)
    hit = WrenchStamped()
    hit.wrench.force.y = 4.0  # at an arbitrary time; 10 N s can be too much during a swing
    push.publish(hit)
    live.until(lambda: "pushed: 0, 4, 0 N s" in live.processes.log("rigid"), 20.0, "the push")

    def jump() -> bool:  # within one tick, much larger than in walking
        speeds = np.array([[t.twist.linear.x, t.twist.linear.y, t.twist.linear.z] for t in twists[max(at - 1, 0) :]])
        return len(speeds) > 1 and bool(np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() > 0.05)

    live.until(jump, 30.0, "a jump of the velocity")
    goal.pose.position.x = 1.6  # during the walk
    target.publish(goal)
    moved = len(efforts)
    live.until(lambda: len(efforts) > moved + 40, 60.0, "0.2 s more")
    statuses = live.statuses("whole_body_controller")
    assert all(s.message.startswith(("waiting for joint_states", "in balance")) for s in statuses)
    live.until(lambda: live.status("rigid") and live.status("rigid").level == b"\x00", 20.0, "a plant that is well")

    stranger = live.offer(JointState, "joint_effort_commands", "rigid", "recorder")  # a second, faulty controller
    names = list(model.joint_names)

    def two_controllers() -> bool:
        stranger.publish(JointState(name=names, effort=[float("nan")] * len(names)))
        return "two controllers: /test, /whole_body_controller" in live.status("rigid").message

    live.until(two_controllers, 20.0, "the plant holding still and naming both")
    assert live.processes.exit_code("rigid") is None
    live.node.destroy_publisher(stranger)
    ticks = len(efforts)
    live.until(lambda: len(efforts) > ticks + 5, 40.0, "the walk continuing")

    live.processes.stop()
    log = read_body(tmp_path / "bag")
    assert any(
        "torque commands are incomplete or not finite" in note for note in log.notes
    )  # those of the second controller
    assert [place for _, place in log.scenario.targets] == [(1.2, -0.8, 0.9), (1.6, -0.8, 0.9)]
    assert [impulse for _, impulse in log.scenario.pushes] == [(0.0, 4.0, 0.0)]
    assert len(log) > moved
    walked, off = retrace(log)
    assert walked.stood
    assert off < 1e-3
    assert [check.name for check in checks(walked) if not check.ok] == []


# ---------------------------------------------------------------------- one node, called directly

REAL = load("whole_body")
MODEL = load_model(REAL.robot)


def send_state(node: Any, stamp: float, body: BodyState, **changed: Any) -> None:
    """Send a node the three messages of a state; `changed`: other joint names, angles, velocities, pose or twist."""
    values = {"names": MODEL.joint_names, "q": body.q, "dq": body.dq, "x": body.x_base, "twist": body.v_base} | changed
    node.send("joint_states", state(values["names"], values["q"], stamp, velocity=values["dq"]))
    ns = round(stamp * 1e9)
    pose = ros.pose(ns, "odom", values["x"])
    if "turned" in values:
        pose.pose.orientation.w *= values["turned"]
    node.send("base_pose", pose)
    twist = TwistStamped(header=pose.header)
    for vector, numbers in ((twist.twist.linear, values["twist"][:3]), (twist.twist.angular, values["twist"][3:])):
        vector.x, vector.y, vector.z = map(float, numbers)
    node.send("base_twist", twist)


def commands_of(node: Any) -> list[JointState]:
    return node.got["joint_effort_commands"]


def last_status(node: Any) -> Any:
    return node.got["diagnostics"][-1].status[0]


def one(values: Any, value: float) -> np.ndarray:
    """Return a copy with another first value."""
    out = np.array(values, dtype=np.float64)
    out[0] = value
    return out


START = WholeBodyController(REAL, MODEL).start
KNEE = MODEL.joint_names.index("L_knee")
GLITCHES: dict[str, tuple[dict[str, Any], str]] = {
    "jump": ({"q": START.q + 1.0 * (np.arange(MODEL.n) == KNEE)}, "a jump that the velocity limits do not allow"),
    "beyond a limit": ({"q": one(START.q, MODEL.q_max[0] + 0.5)}, "outside the joint limits"),
    "fast": ({"dq": one(START.dq, 1000.0)}, "1e+03 rad/s"),
    "angle not finite": ({"q": one(START.q, math.nan)}, "not a finite position"),
    "no velocities": ({"dq": []}, "need a finite velocity"),
    "a name twice": ({"names": [*MODEL.joint_names[:-1], MODEL.joint_names[0]]}, "joints missing"),
    "base jumps": ({"x": DQ.from_pose([0.0, 0.0, 1.7]).vec8()}, "the base jumped by"),
    "quaternion": ({"turned": 2.0}, "no unit quaternion: its norm is 2"),
    "twist": ({"twist": one(START.v_base, 1e200)}, "the base moves at"),
    "twist not finite": ({"twist": one(START.v_base, math.nan)}, "not finite"),
}


def test_an_invalid_state_is_rejected_with_its_reason_and_the_walk_continues(make: Any) -> None:
    """Each between two valid states: it has no command, ERROR with the reason, and the next state has a command."""
    node = make("whole_body_controller", REAL)
    send_state(node, 0.0, START)
    for k, (name, (changed, why)) in enumerate(GLITCHES.items()):
        before = len(commands_of(node))
        node.node._diagnosed = -math.inf
        send_state(node, 0.01 * k + 0.005, START, **changed)
        assert len(commands_of(node)) == before, name
        assert last_status(node).level == b"\x02", name
        assert why in last_status(node).message, name
        send_state(node, 0.01 * k + 0.010, START)
        assert len(commands_of(node)) == before + 1, name
    assert not node.node.done.done()
    node.node._diagnose()
    assert last_status(node).level == b"\x00"
    assert all(np.isfinite(msg.effort).all() for msg in commands_of(node))


def test_when_states_time_out_zero_torques_are_sent_once_and_the_status_is_stale(make: Any) -> None:
    node = make("whole_body_controller", REAL)
    node.tick()
    assert last_status(node).message.startswith("waiting for joint_states and base_pose and base_twist")
    send_state(node, 0.0, START)
    assert max(map(abs, commands_of(node)[-1].effort)) > 10.0
    node.clock.now += 1.5 * REAL.plant.command_timeout
    node.tick()
    assert not any(commands_of(node)[-1].effort)
    assert (last_status(node).level, last_status(node).message) == (b"\x03", "body state timed out")
    count = len(commands_of(node))
    node.tick()
    assert len(commands_of(node)) == count
    for _ in range(
        2
    ):  # the plant repeats its state: it gets the same command once, else it would assume two controllers
        send_state(node, 0.0, START)
        node.tick()
        assert len(commands_of(node)) == count + 1
        assert commands_of(node).pop().effort == commands_of(node)[0].effort
    send_state(node, 0.005, START)
    assert max(map(abs, commands_of(node)[-1].effort)) > 10.0
    node.node.close()
    assert not any(commands_of(node)[-1].effort)


def test_states_whose_stamps_do_not_advance_are_rejected_with_the_reason(make: Any) -> None:
    """As of a driver that leaves header.stamp at zero."""
    node = make("whole_body_controller", REAL)
    send_state(node, 0.0, START)
    node.node._diagnosed = -math.inf
    send_state(node, 0.0, START, q=START.q + 1e-3)
    assert len(commands_of(node)) == 1
    assert last_status(node).level == b"\x02"
    assert "has the same stamp, 0: set header.stamp" in last_status(node).message
    send_state(node, 0.005, START, q=START.q + 1e-3)
    assert len(commands_of(node)) == 2


def test_one_state_of_another_time_and_messages_of_another_clock_do_not_end_the_walk(make: Any) -> None:
    node = make("whole_body_controller", REAL)
    body = WholeBodyController(REAL, MODEL).start
    for k in range(12):
        if k == 4:  # a plant waits for its command, so its stamps advance by a period
            send_state(node, 1e6, body)
            send_state(node, REAL.dt * k + 1.0, body)
        if k == 8:  # of another robot, whose stamps are those of a clock
            for ahead in range(100):
                node.send("base_pose", ros.pose(10**18 + ahead, "odom", body.x_base))
        node.clock.now += REAL.dt
        send_state(node, REAL.dt * k, body)
    stamps = [ros.nanoseconds(msg.header.stamp) for msg in commands_of(node)]
    assert stamps == [round(1e9 * REAL.dt * k) for k in range(12)]


@pytest.mark.parametrize("fault", ["infeasible", "not finite", "an exception"])
def test_a_failed_controller_sends_zero_torques_and_waits_for_a_reset(
    make: Any, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = make("whole_body_controller", REAL)
    send_state(node, 0.0, START)
    good = core.WholeBodyController.step

    def step(self: Any, body: Any, dt: float) -> Any:
        if fault == "infeasible":
            raise QPError("no solution", status="Infeasible")
        if fault == "not finite":
            return replace(good(self, body, dt), effort=np.full(MODEL.n, math.nan))
        raise ZeroDivisionError

    monkeypatch.setattr(core.WholeBodyController, "step", step)
    for k in range(1, REAL.safety.failures + 1):
        send_state(node, 0.005 * k, START)
    monkeypatch.undo()
    assert all(np.isfinite(msg.effort).all() for msg in commands_of(node))
    assert len(commands_of(node)) == 2
    assert not any(commands_of(node)[-1].effort)
    assert last_status(node).level == b"\x02"
    assert not node.node.done.done()  # the node keeps running
    send_state(node, 0.1, START)
    assert len(commands_of(node)) == 2
    assert node.call("reset", Trigger.Request()).success
    send_state(node, 0.105, START)
    assert max(map(abs, commands_of(node)[-1].effort)) > 10.0


def test_consecutive_jumps_end_the_walk(make: Any) -> None:
    node = make("whole_body_controller", REAL.updated({"node.exit_when_done": True}))
    send_state(node, 0.0, START)
    for k in range(REAL.safety.jumps):
        send_state(node, 0.005 * (k + 1), START, x=DQ.from_pose([5.0 + k, 0.0, 0.7]).vec8())
    assert not any(commands_of(node)[-1].effort)
    assert "in a row" in last_status(node).message
    assert node.node.done.result() == 1


def test_a_controller_restarted_during_a_swing_continues_the_walk(make: Any) -> None:
    """The plant waits; the new controller derives the swing foot from the stamps, and the robot does not fall."""
    plant = RigidPlant(MODEL, START, pushed="chest")
    stepping = WholeBodyController(REAL, MODEL).stepping
    node = make("whole_body_controller", REAL)
    for tick in range(240):
        if tick == 140:  # 0.3 s into the swing
            assert stepping.swing(0.005 * tick) is not None
            node = make("whole_body_controller", REAL)
        now = 0.005 * tick
        send_state(node, now, plant.state)
        effort = np.array(commands_of(node)[-1].effort)
        assert np.abs(effort).max() <= REAL.whole_body.effort
        zero = np.zeros(MODEL.n)
        stance, landing = stepping.stance(now), stepping.landing(now, 0.005)
        plant.step(
            BodyCommand(now, zero, effort=effort, stance=stance, landing=landing),
            0.005,
        )
    assert "in balance" in last_status(node).message
    assert plant.state.x_base is not None
    assert abs(DQ(plant.state.x_base).translation()[2] - DQ(START.x_base).translation()[2]) < 0.02


def test_with_stamps_of_the_wall_clock_a_walk_must_begin_at_rest(make: Any) -> None:
    node = make("whole_body_controller", REAL)
    moving = replace(START, dq=START.dq + 0.2)
    send_state(node, 1.7e9, moving)
    assert commands_of(node) == []
    assert "start the walk at rest" in last_status(node).message
    send_state(node, 1.7e9 + 1.0, START)
    assert len(commands_of(node)) == 1


def effort_message(stamp: float, effort: Any) -> JointState:
    return state(MODEL.joint_names, [], stamp, effort=effort)


def test_the_plant_holds_without_a_command_and_applies_the_first_one_for_a_state(make: Any) -> None:
    """A controller without new states sends zero for a state that it has already answered: the first command counts."""
    node = make("rigid", REAL)
    period = node.pass_period
    period()
    assert len(node.got["joint_states"]) == 1
    for _ in range(3):
        period()
    assert len(node.got["joint_states"]) == 1  # it waits: the simulated time stands still
    first = np.array(WholeBodyController(REAL, MODEL).step(START, REAL.dt).effort)
    node.send("joint_effort_commands", effort_message(0.0, first))
    node.send("joint_effort_commands", effort_message(0.0, 0.0 * first))
    period()
    np.testing.assert_allclose(node.node.plant.effort, first)
    node.clock.now += 1.5 * REAL.plant.command_timeout
    period()
    assert "holding still: no command for 0.1 s" in node.log
    node.node._diagnose()
    assert (last_status(node).level, last_status(node).message) == (b"\x01", "holding: no commands")


def test_torques_are_clamped_and_excessive_pushes_rejected(make: Any) -> None:
    node = make("rigid", REAL)
    node.node._on_period()
    node.send("joint_effort_commands", effort_message(0.0, np.full(MODEL.n, 6e4)))
    for newtons in (1e300, 1e5, math.nan):
        push = WrenchStamped()
        push.wrench.force.y = newtons
        node.send("push", push)
    node.node._on_period()
    np.testing.assert_allclose(node.node.plant.effort, MODEL.effort_max)
    assert sum("push rejected" in text for _, text in node.log.lines) == 3
    assert np.isfinite(node.got["joint_states"][-1].velocity).all()


def test_the_launch_file_starts_installed_nodes() -> None:
    text = (ROOT / "launch" / "whole_body.launch.py").read_text(encoding="utf-8")
    calls = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "node"]
    started = {call.args[0].value for call in calls}
    assert started == {"whole_body_controller", "rigid", "recorder"}
