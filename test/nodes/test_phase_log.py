"""The phase of each state, rebuilt from the topics: whatever the stamps say."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped
from inside import Log, state
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from dqwalk_ros.config import Config, load, to_yaml
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.phase_log import PhaseLog
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.walk import com_target
from dqwalk_ros.plants.base import Inertial
from dqwalk_ros.robot.model import RobotModel, load_model

PAPER = load("paper")
MODEL = load_model(PAPER.robot)
S = 1_000_000_000


class Fed:
    """A log of phases without a node; `send` passes a message to the callback of its topic."""

    def __init__(self, config: Config = PAPER, model: RobotModel = MODEL) -> None:
        self.said, self._heard = Log(), dict[str, Any]()
        self._config, self._model = config, model
        node: Any = SimpleNamespace(
            get_logger=lambda: self.said,
            config=config,
            listen=lambda kind, topic, callback, *_, **__: self._heard.update({topic: callback}),
            create_subscription=lambda kind, topic, callback, _: self._heard.update({topic: callback}),
        )
        self.log = PhaseLog(node)

    def send(self, topic: str, msg: Any) -> None:
        self._heard[topic](msg)

    def tell_walk(self) -> None:
        """Send the configuration and the robot."""
        self.send("walk_config", String(data=to_yaml(self._config)))
        self.send("robot_description", String(data=self._model.urdf))

    def measure(self, stamp: int, lean: float) -> None:
        """Send the measurement of an inertial sensor that leans forward by an angle [rad]."""
        turned = np.array([np.cos(0.5 * lean), 0.0, np.sin(0.5 * lean), 0.0])
        measured = Inertial(turned, np.zeros(3), np.zeros(3))
        self.send("imu", bytes(serialize_message(ros.imu(stamp, "pelvis", measured))))

    def begin(self, stamp: int, base: Foot = Foot.LEFT, kind: PhaseKind = PhaseKind.DOUBLE_SUPPORT) -> None:
        """Send the start of a phase on both feet."""
        frame, q = self._model.soles[base].frame, self._model.posture(self._config.standing.posture)
        start = state(self._model.joint_names, q, 1e-9 * stamp)
        start.header.frame_id = frame
        goal = com_target(kind, Kinematics(self._model, q, base))
        self.send("phase_start", start)
        self.send("com_target", ros.point(stamp, frame, goal))

    def found(self, stamp: int) -> tuple[int, Foot, float]:
        """Return the start of the phase at a state [ns], its base, and the gain in force."""
        at = self.log.at(stamp)
        assert at is not None
        assert at[1].phase.kind is PhaseKind.DOUBLE_SUPPORT
        return at[0], at[1].phase.base, at[1].config.task.eta


def leans(up: Any) -> float:
    return round(float(np.arctan2(-up[0], up[2])), 6)


def test_a_stamp_follows_or_is_wrong_until_three_tell_that_a_clock_was_set() -> None:
    one = Fed()
    register = one.log.register
    for stamp in (0, 0, S, 6 * S):  # also the first one, the same one again, and one after a gap of 5 s
        assert register(stamp) == "follows"
    assert register(11 * S + 1) == register(11 * S + 2) == "wrong"
    assert one.log.newest == 6 * S
    assert register(7 * S) == "follows"  # so these were wrong
    assert [register(100 * S + k) for k in range(3)] == ["wrong", "wrong", "follows"]
    for stamp in (50 * S, 60 * S + 2, 60 * S + 3):
        one.begin(stamp)
    one.measure(50 * S, 0.0)
    assert [register(60 * S + k) for k in range(3)] == ["wrong", "wrong", "set back"]
    assert one.log.begun(0, 200 * S) == [50 * S, 60 * S + 2]  # those after it belong to another time
    assert one.log.up(60 * S) is None
    assert register(61 * S) == "follows"


def test_the_vertical_of_a_state_is_the_newest_measured_one_of_the_last_half_second() -> None:
    one = Fed()
    assert one.log.up(S) is None
    for k in range(5):
        one.measure(S + k * S // 10, 0.1 * k)
    assert [leans(one.log.up(S + stamp)) for stamp in (0, S // 5, S // 5 + 1)] == [0.0, 0.2, 0.2]
    last = S + 4 * S // 10
    assert leans(one.log.up(last + S // 2)) == 0.4
    assert one.log.up(last + S // 2 + 1) is None
    assert one.log.up(last - 1) is None  # measured later


@pytest.mark.parametrize("wrong", [0, (2**31 - 1) * S, 2 * S])
def test_a_wrong_stamp_of_the_inertial_sensor_costs_one_measurement(wrong: int) -> None:
    one = Fed()
    one.measure(S, 0.1)
    assert leans(one.log.up(S)) == 0.1
    one.measure(wrong, 0.7)
    one.send("imu", b"\x00\x01")
    one.measure(S + S // 10, 0.2)
    assert leans(one.log.up(S + S // 10)) == 0.2


def test_a_phase_begins_at_its_stamp_and_has_the_parameters_in_force_then() -> None:
    one, gripper = Fed(), state(["gripper"], [0.0], 1.0)
    assert one.log.at(S) is None
    one.begin(S)
    assert one.log.at(S) is None  # of an unknown robot
    assert not one.log.lockstep
    assert not one.log.is_foreign(gripper)
    one.tell_walk()
    assert one.log.is_foreign(gripper)
    one.begin(3 * S, Foot.RIGHT)
    one.send("walk_config", String(data=to_yaml(PAPER.updated({"task.eta": 0.125}), 2 * S)))
    assert one.log.at(S - 1) is None
    assert one.found(S) == one.found(3 * S - 1) == (S, Foot.LEFT, PAPER.task.eta)
    assert one.found(3 * S) == (3 * S, Foot.RIGHT, 0.125)
    one.send("walk_config", String(data=to_yaml(PAPER.updated({"task.eta": 0.25}), 3 * S)))
    assert one.found(4 * S) == (3 * S, Foot.RIGHT, 0.25)
    assert one.log.begun(S, 3 * S) == [3 * S]
    assert [level for level, _ in one.said.lines] == ["info"]


def test_a_phase_in_the_frame_of_no_sole_is_named_and_the_one_before_remains() -> None:
    one = Fed()
    one.tell_walk()
    one.begin(S)
    foreign = state(MODEL.joint_names, np.zeros(MODEL.n), 2.0)
    foreign.header.frame_id = "\x1b[31m"
    one.send("phase_start", foreign)
    one.send("com_target", PointStamped(header=foreign.header))
    assert one.log.at(2 * S) is None
    assert "phase_start is in the frame '\\x1b[31m', not a sole of the robot" in one.said
    assert one.found(2 * S)[0] == S


@pytest.mark.parametrize("kind", [PhaseKind.STANCE, PhaseKind.DOUBLE_SUPPORT])
@pytest.mark.parametrize("base", list(Foot))
def test_a_stance_and_a_transfer_have_different_targets(kind: PhaseKind, base: Foot) -> None:
    config = load("poppy")
    one = Fed(config, load_model(config.robot))
    one.tell_walk()
    one.begin(S, base, kind)
    found = one.log.at(S)
    assert found is not None
    assert (found[1].phase.kind, found[1].phase.base) == (kind, base)


def test_the_latest_hundred_phases_are_kept() -> None:
    one = Fed()
    for k in range(1, 103):
        one.begin(k * S)
    assert one.log.begun(0, 200 * S) == [k * S for k in range(3, 103)]
