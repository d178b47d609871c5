"""What a controller node does with states that it must not answer, and how it ends a walk."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from inside import state, values
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.controller import Mode
from dqwalk_ros.paper.state import Command
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ModelError, QPError

CONFIG = load("paper").updated({"dt": 0.02, "safety.contradiction": 3.0, "safety.failures": 3})
MODEL = load_model(CONFIG.robot)
NAMES = MODEL.joint_names


class Answered:
    """A walking controller, on a test clock, and a robot that stands still.

    Attributes
    ----------
    now : float
        Stamp of the last state [s].
    """

    def __init__(self, make: Any, **changes: Any) -> None:
        self.one = make("controller", CONFIG.updated(changes))
        self.node, self.log, self.got = self.one.node, self.one.log, self.one.got
        self.sent = self.got["joint_velocity_commands"]
        self.now = 10.0

    def start(self) -> str:
        """Return the answer of ~/start."""
        message: str = self.one.call("~/start", Trigger.Request()).message
        return message

    def tick(self, q: Any = None, *, passed: float = CONFIG.dt, stamp: float | None = None) -> Any:
        """Let time pass and send a state; return the commanded velocities, empty if it is not answered."""
        self.now += passed
        self.one.clock.now += passed
        before = len(self.sent)
        self.one.send("joint_states", state(NAMES, np.zeros(MODEL.n) if q is None else q, stamp or self.now))
        return list(self.sent[-1].velocity) if len(self.sent) > before else []

    @property
    def status(self) -> Any:
        self.node._diagnose()
        return self.got["diagnostics"][-1].status[0]


def test_states_whose_stamps_do_not_advance_get_zero_once_and_are_named(make: Any) -> None:
    walk = Answered(make)
    assert any(walk.tick())
    frozen, answers = walk.now, []
    for _ in range(8):
        answers += [a for a in [walk.tick(stamp=frozen)] if a]
    assert len(answers) == 1
    assert not any(answers[0])
    assert "they all have the stamp 10.02: set header.stamp" in walk.log
    assert any(walk.tick())  # they advance again
    assert len([text for _, text in walk.log.lines if "they all have the stamp" in text]) == 4


def test_states_of_a_second_publisher_are_not_answered(make: Any) -> None:
    walk = Answered(make)
    assert any(walk.tick())
    for number in range(1, 4):
        before = len(walk.sent)
        walk.one.send("joint_states", state(NAMES, np.full(MODEL.n, 0.01), walk.now + 0.5 * CONFIG.dt), number=number)
        assert len(walk.sent) == before
        assert any(walk.tick())


def test_two_plants_hold_the_robot_until_there_is_one(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    walk, publishers = Answered(make), ["/a", "/b"]
    monkeypatch.setattr(ros, "publishers_of", lambda *_: tuple(publishers))
    for _ in range(2):
        assert any(walk.tick())
        walk.one.send("joint_states", state(NAMES[::-1], np.zeros(MODEL.n), walk.now))
        walk.node._check_plants()
    assert "standing still: two plants: /a, /b" in walk.log
    assert not any(walk.tick())
    assert walk.status.message == "two plants: /a, /b"
    assert walk.status.level == b"\x02"
    publishers.pop()
    walk.node._check_plants()
    assert "one plant again: continuing" in walk.log
    assert any(walk.tick())
    assert walk.status.level == b"\x00"


def test_states_that_time_out_get_zero_once(make: Any) -> None:
    walk = Answered(make)
    assert any(walk.tick())
    for _ in range(3):
        walk.one.clock.now += 0.11
        walk.now += 0.11
        walk.node._check_timeout()
    assert len(walk.sent) == 2
    assert not any(walk.sent[-1].velocity)
    assert walk.got["diagnostics"][-1].status[0].message == "joint_states timed out"
    assert any(walk.tick())
    walk.node._check_timeout()
    assert len(walk.sent) == 3
    walk.one.clock.now += 0.11
    walk.node._check_timeout()
    assert not any(walk.sent[-1].velocity)  # after each timeout


def test_a_walk_that_waits_for_its_plant_says_so(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if a node that is no plant has said that it is not ready, such as a bag that is played."""
    walk = Answered(make)
    assert any(walk.tick())
    assert walk.status.level == b"\x00"
    walk.one.send("plant_ready", Bool(data=False))
    assert not any(walk.tick())
    assert (walk.status.level, walk.status.message) == (b"\x01", "standing still until the plant is ready")
    monkeypatch.setattr(ros, "publishers_of", lambda *_: ("/drive", "/player"))
    assert walk.status.message.endswith("ready, which /drive and /player say")


@pytest.mark.parametrize("names", [("/drive",), ("/robot/drive", "/player")])
def test_a_walk_that_waits_for_its_plant_says_why(make: Any, monkeypatch: pytest.MonkeyPatch, names: Any) -> None:
    """The plant says it on /diagnostics, where others report, too."""
    walk = Answered(make)
    monkeypatch.setattr(ros, "publishers_of", lambda *_: names)
    walk.one.send("plant_ready", Bool(data=False))

    def reports(name: str, text: str, level: bytes = DiagnosticStatus.WARN) -> None:
        status = DiagnosticStatus(name=name, level=level, message=text)
        walk.one.send("/diagnostics", DiagnosticArray(status=[status]))

    own = names[0].lstrip("/")
    reports(f"{own}: plant", "the torque is off:\ncall ~/activate")
    reports(f"{own}: motors", "too hot")
    reports("other: plant", "asleep")
    once = "once the plant is ready: the torque is off: call ~/activate"
    assert not any(walk.tick())
    assert walk.start() == f"already walking {once}"
    walk.node._mode = Mode.IDLE
    assert walk.start() == f"walking {once}"
    assert not any(walk.tick())
    assert "standing still until the plant is ready: the torque is off: call ~/activate" in walk.status.message
    reports(f"{own}: plant", "moving", DiagnosticStatus.OK)
    assert walk.node._plant.why == ""


def test_a_start_that_moves_nothing_yet_says_what_has_to_happen(make: Any) -> None:
    walk = Answered(make)
    assert walk.start() == "already walking once joint_states are accepted: /diagnostics says why they are not"
    assert any(walk.tick())
    assert walk.start() == "already walking"
    walk.node._duplicates = "/a, /b"
    assert walk.start() == "already walking once this is over: two plants: /a, /b"


def test_before_the_first_state_it_says_what_it_waits_for(make: Any) -> None:
    walk = Answered(make)
    walk.node._check_timeout()
    text = "waiting for joint_states: no node publishes joint_states"
    assert walk.got["diagnostics"][-1].status[0].message == text
    assert text in walk.one.log
    walk.one.clock.now += 1.0
    walk.node._check_timeout()
    assert not walk.sent
    walk.one.send("joint_states", state([f"robot1/{name}" for name in MODEL.joint_names], np.zeros(MODEL.n), 1.0))
    walk.one.clock.now += 1.0
    walk.node._check_timeout()
    expected = "waiting for joint_states: joint_states name none of its joints: they name robot1/l_ankle_y, "
    assert walk.got["diagnostics"][-1].status[0].message.startswith(expected)
    assert "joint_states name none of its joints" in walk.one.log


@pytest.mark.parametrize("step", [1000.0, -9.0, 1.7e9])
def test_a_clock_that_is_set_is_logged_and_the_walk_continues(make: Any, step: float) -> None:
    """Two states are not answered; the command after them is that for three periods later."""
    other = Answered(make)
    expected = [other.tick(passed=passed) for passed in (*[CONFIG.dt] * 5, 3 * CONFIG.dt)]
    walk = Answered(make)
    found = [walk.tick() for _ in range(5)]
    walk.now += step
    assert [walk.tick() for _ in range(2)] == [[], []]
    np.testing.assert_allclose([*found, walk.tick()], expected, atol=1e-9)
    assert walk.got["phase"] == other.got["phase"]
    assert f"the stamps jumped by {step:+.3f} s, a clock was set; the walk continues" in walk.log
    phase = [text for _, text in walk.log.lines if "phase 0: " in text]
    walk.node._begin_phase(walk.node._gate.time_of(round(1e9 * walk.now)) - walk.node._began)  # of the next phase
    assert [float(text.split()[0]) for text in (*phase, walk.log.lines[-1][1])] == pytest.approx([0.0, 7 * CONFIG.dt])
    assert values(walk.status)["clock steps"] == "1"
    assert values(walk.status)["states overtaken"] == "2"
    assert "jumped" not in other.log


def test_consecutive_impossible_states_end_the_walk_with_zero(make: Any) -> None:
    walk = Answered(make)
    assert any(walk.tick())
    for k in range(3):
        assert walk.got["phase"][-1].data == "double_support/left"
        answer = walk.tick(0.4 * np.eye(MODEL.n)[1])
        assert bool(answer) == (k == 2)
    assert not any(walk.sent[-1].velocity)
    assert walk.got["phase"][-1].data == "failed"
    assert f"{NAMES[1]} by 0.4 rad; 3 in a row" in walk.status.message
    assert values(walk.status)["states rejected"] == "3"
    assert not walk.tick()


def unsolved(*_: Any) -> Command:
    raise QPError("no solution", status="Infeasible")


def test_a_walk_that_fails_while_it_pauses_is_not_started_again(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    walk = Answered(make)
    assert any(walk.tick())
    monkeypatch.setattr(type(walk.node._controller), "may_hold", False)
    assert "puts its feet together" in walk.one.call("pause", Trigger.Request()).message
    monkeypatch.setattr(walk.node._controller, "step", unsolved)
    for _ in range(CONFIG.safety.failures):
        walk.tick()
    answer = walk.one.call("start", Trigger.Request())
    assert not answer.success
    assert "it failed: no solution" in answer.message
    assert not any(walk.tick())


def test_errors_of_the_controller_are_tolerated_as_configured(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    walk, raised = Answered(make), [QPError("infeasible", status="Infeasible")]

    def step(*_: Any) -> Command:
        if raised:
            raise raised[0]
        return Command(0.0, np.ones(MODEL.n))

    assert any(walk.tick())
    monkeypatch.setattr(walk.node._controller, "step", step)
    for _ in range(2):
        assert walk.tick() == [0.0] * MODEL.n
    assert walk.status.level == b"\x02"  # while there is no command
    raised.clear()
    assert walk.tick() == [1.0] * MODEL.n
    raised.append(QPError("infeasible", status="Infeasible"))
    for k in range(3):
        assert walk.tick() == [0.0] * MODEL.n
        assert (walk.got["phase"][-1].data == "failed") == (k == 2)
    assert "infeasible (3 times in a row)" in walk.status.message


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (ModelError("no such link"), "no such link"),
        (ValueError("wrong"), "internal error: ValueError: wrong"),
        (np.nan, "internal error: the command is not finite"),
    ],
)
@pytest.mark.parametrize("field", ["velocity", "effort"])
def test_one_other_error_ends_the_walk(
    make: Any, monkeypatch: pytest.MonkeyPatch, fault: Any, named: str, field: str
) -> None:
    walk = Answered(make)

    def step(*_: Any) -> Command:
        if isinstance(fault, Exception):
            raise fault
        command = Command(0.0, np.zeros(MODEL.n), np.zeros(MODEL.n))
        getattr(command, field)[2] = fault
        return command

    monkeypatch.setattr(walk.node._controller, "step", step)
    assert walk.tick() == [0.0] * MODEL.n
    assert walk.got["phase"][-1].data == "failed"
    assert named in walk.status.message


@pytest.mark.parametrize(
    ("period", "holds", "warns"), [(0.0255, False, True), (0.0236, False, False), (0.051, True, True)]
)
def test_the_period_of_the_states_is_compared_with_dt(make: Any, period: float, holds: bool, warns: bool) -> None:
    """Lost states do not count."""
    walk = Answered(make)
    for k in range(70):
        walk.tick(passed=2 * period if k % 4 == 0 else period)
    walk.node._check_rate()
    assert walk.got["phase"][-1].data != "failed"
    assert ("standing still: joint_states" in walk.log) is holds
    assert (f"joint_states arrive every {period:.4f} s, but dt is 0.02 s" in walk.log) is warns
    assert ("run less beside this node" in walk.log) is (period > 0.03)


def test_a_closed_controller_commands_zero_last(make: Any) -> None:
    walk = Answered(make)
    walk.node.close()
    assert not walk.sent  # nothing has moved
    assert any(walk.tick())
    walk.node.close()
    assert not any(walk.sent[-1].velocity)
    assert walk.sent[-1].header.stamp == walk.sent[-2].header.stamp


def test_diagnostics_are_published_at_their_rate(make: Any) -> None:
    walk = Answered(make, **{"monitor.rate": 5.0})
    before = len(walk.got["diagnostics"])
    for _ in range(100):  # 2 s
        walk.tick()
    assert len(walk.got["diagnostics"]) - before == pytest.approx(10, abs=1)
    walk.node.set_parameters([Parameter("monitor.rate", value=50.0)])
    before = len(walk.got["diagnostics"])
    for _ in range(50):
        walk.tick()
    assert len(walk.got["diagnostics"]) - before >= 20


def test_in_lockstep_a_state_that_is_sent_again_gets_the_same_answer(make: Any) -> None:
    walk = Answered(make, **{"plant.lockstep": True})
    first = walk.tick()
    assert any(first)
    assert walk.tick(passed=0.0) == first
    assert walk.sent[-1].header.stamp == walk.sent[-2].header.stamp
    assert any(walk.tick())
    assert walk.tick(stamp=5.0) == []
    assert "the plant restarted at 5.000 s" in walk.log
    walk.node.close()
    assert any(walk.sent[-1].velocity)  # without a command simulated time stands still


def test_joints_of_others_are_no_state(make: Any) -> None:
    walk = Answered(make)
    walk.one.send("joint_states", JointState(name=["gripper"], position=[0.1]))
    assert not walk.sent
    assert values(walk.status)["states rejected"] == "0"


def test_a_walk_that_waits_in_mid_step_can_be_reset(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the torque off no reset makes it fall, and no pause puts its feet together."""
    walk = Answered(make)
    monkeypatch.setattr(type(walk.node._controller), "may_hold", property(lambda _: False))
    assert any(walk.tick())
    answer = walk.one.call("~/reset", Trigger.Request())
    assert (answer.success, answer.message) == (False, "it would fall in mid-step; call ~/pause first, then it stands")
    walk.one.send("plant_ready", Bool(data=False))
    assert not any(walk.tick())
    assert walk.one.call("~/pause", Trigger.Request()).message.startswith("pausing")
    assert walk.one.call("~/reset", Trigger.Request()).success
    assert walk.got["phase"][-1].data == "idle"
