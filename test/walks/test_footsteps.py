"""Commanded footsteps: reachable ones are executed, others are rejected with the violated limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqwalk_ros import cli
from dqwalk_ros.config import load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.standing.walk import StandingWalk
from dqwalk_ros.walks.table import make_controller

QUICK = {"standing.transfer_duration": 0.5, "standing.swing_duration": 0.5, "node.robot_description": False}
CONFIG = load("poppy").updated({"gait.steps": 0, **QUICK})
MODEL = load_model(CONFIG.robot)
STEPS = StandingWalk(CONFIG, MODEL).footsteps


def turned(x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> DQ:
    return DQ.from_pose([x, y, z], [np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)])


BESIDE = DQ(STEPS.beside(Foot.LEFT))  # the right footprint in the left sole


@pytest.mark.parametrize(
    ("footprint", "limit"),
    [
        (turned(0.2, 0.0) * BESIDE, r"0\.2 m ahead .* gait\.most_length is 0\.06 m"),
        (turned(0.0, 0.0, -0.5) * BESIDE, r"gait\.most_turn is 0\.14 rad"),
        (turned(0.0, 0.12) * BESIDE, r"standing\.sole_gap is 4 mm"),
        (turned(0.0, -0.04) * BESIDE, r"out of reach by .* gait\.footstep_tolerance is 10 mm"),
        (turned(0.0, 0.0, 0.0, 0.05) * BESIDE, "50 mm above the ground"),
        (BESIDE * DQ.from_pose([0.0, 0.0, 0.0], [np.cos(0.1), np.sin(0.1), 0.0, 0.0]), "leans by 11.5 deg"),
    ],
)
def test_infeasible_footsteps_are_rejected_with_the_limit(footprint: DQ, limit: str) -> None:
    with pytest.raises(StateError, match=limit) as refused:
        STEPS.planned(Foot.LEFT, [BESIDE.vec8(), DQ(STEPS.beside(Foot.RIGHT)).vec8(), footprint.vec8()])
    assert str(refused.value).startswith("footstep 3, of the right foot: ")


def test_footsteps_are_moved_within_the_tolerance_to_be_reachable() -> None:
    wanted = turned(0.03, -0.01) * BESIDE
    (x,) = STEPS.planned(Foot.LEFT, [wanted.vec8()])
    error = (wanted.conj() * DQ(x)).translation()
    assert 1e-3 < np.linalg.norm(error) < CONFIG.gait.footstep_tolerance


def test_a_walk_whose_feet_do_not_reach_their_places_beside_each_other_does_not_begin() -> None:
    """Its footprints would be moved aside, and steps of 18 mm would become steps of 70 mm."""
    wide = CONFIG.updated({"gait.steps": 2, "gait.step_width": 0.3})
    walk = StandingWalk(wide, MODEL)
    assert walk.footsteps.reach(wide.gait.step_length)[0] == 0.0
    with pytest.raises(ConfigError, match=r"gait\.step_width: the place of the right foot beside the .* out of reach"):
        walk.prepare()


# ---------------------------------------------------------------------- heights

DYNAMIC = load("poppy_dynamic").updated({"gait.steps": 0, "gait.most_length": 0.13})


def stairs(*steps: str) -> DynamicWalk:
    return DynamicWalk(DYNAMIC.updated({"gait.footsteps": steps}), MODEL)


@pytest.mark.parametrize("support", Foot)
def test_a_step_to_a_footprint_is_the_stride_that_leads_there(support: Foot) -> None:
    steps = stairs().footsteps
    for step in ((0.05, 0.0, 0.0), (0.02, -0.01, 0.1), (-0.03, 0.02, -0.14)):
        assert steps.step_to(support, steps.wanted(support, *step)) == pytest.approx(step, abs=1e-12)


def test_steps_are_remembered_but_not_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes several milliseconds, and a steered walk may last for weeks."""
    steps = StandingWalk(load("poppy"), MODEL).footsteps
    found = list[np.ndarray]()
    monkeypatch.setattr(steps, "nearest", lambda foot, x: found.append(x) or SimpleNamespace(pose=x))
    for k in range(1000):
        for _ in range(2):
            assert DQ(steps.step(Foot.LEFT, 1e-5 * k, 0.0, 0.0)).translation()[0] == pytest.approx(1e-5 * k)
    assert len(found) == 1000
    assert len(steps._known) <= 100


def test_footprints_on_stairs_keep_their_heights() -> None:
    walk = stairs("0.05 0 0 0.025", "0.12 0 0 -0.025", "0.05 0 0 0.005")
    walk.prepare()
    heights = [float(DQ(x).translation()[2]) for x in walk._planned]
    assert heights == pytest.approx([0.025, -0.025, 0.0], abs=1e-12)  # 5 mm are level


@pytest.mark.parametrize(
    ("step", "limit"),
    [
        ("0.05 0 0 0.012", "12 mm above the other sole: up to 10 mm"),
        ("0.124 0 0 -0.1", r"footstep 1, of the right foot: out of reach by .* \(l_ankle_y at the limit\)"),
        ("0.2 0 0 0.025", r"gait\.most_length is 0\.13 m"),
        ("0.05 0 0.025", r"needs 'AHEAD LEFT TURN UP'"),
    ],
)
def test_steps_that_the_legs_cannot_make_are_refused_before_the_walk(step: str, limit: str) -> None:
    with pytest.raises(ConfigError, match=limit):
        stairs(step).prepare()


def test_footsteps_need_a_walk_without_other_steps() -> None:
    with pytest.raises(ConfigError, match=r"gait\.steps is 20, it must be 0"):
        DynamicWalk(DYNAMIC.updated({"gait.footsteps": ("0 0 0 0",), "gait.steps": 20}), MODEL).prepare()


def test_the_next_footsteps_make_up_for_what_a_landing_has_missed() -> None:
    walk = stairs(*["0.05 0 0 0"] * 4)
    walk.prepare()
    kin = Kinematics(MODEL, walk.posture, Foot.LEFT)

    def following(last: DQ, missed: DQ) -> DQ:
        """Return the next footprint, in the frame of the sole that has landed off its footprint `last` by `missed`."""
        landed = SimpleNamespace(swing="", pose=lambda _: (last * missed).vec8())
        return DQ(walk._next_footprint(landed))  # type: ignore[arg-type]

    wanted = [DQ(walk.footsteps.wanted(foot, 0.05, 0.0, 0.0)) for foot in (Foot.RIGHT, Foot.LEFT)]
    missed = turned(-0.004, 0.002, 0.01)
    second = following(DQ(walk._next_footprint(kin)), missed)
    np.testing.assert_allclose((missed * second).vec8(), wanted[0].vec8(), atol=5e-4)  # moved into reach by so much
    missed = turned(-0.025, 0.0)  # 10 mm are the most in a step
    third = following(second, missed)
    fourth = following(third, DQ(1.0))
    ahead = [float(x.translation()[0]) for x in (third, fourth)]
    assert ahead == pytest.approx([0.05 + 0.01, 0.05 + 0.01], abs=1e-3)


def test_only_stairs_keep_a_sole_above_the_other_one() -> None:
    """Also of the phases that a monitor builds from topics: it is given where each swing leads."""
    raised, walk = SimpleNamespace(swing="", point=lambda _: np.array([0.0, 0.1, 0.025])), stairs()
    for height, level in ((0.0, 0.0), (0.005, 0.0), (-0.025, 0.025), (0.0, 0.025)):
        goal = (DQ.from_pose([0.0, 0.0, height]) * DQ(walk.footsteps.beside(Foot.LEFT))).vec8()
        walk.phase(PhaseKind.SINGLE_SUPPORT, Foot.LEFT, walk.posture, goal)
        assert walk._level(raised) == level  # type: ignore[arg-type]


@pytest.mark.parametrize("up", [0.025, -0.025])
def test_a_walk_over_a_stair_moves_soles_and_com_by_its_height(up: float) -> None:
    config = DYNAMIC.updated({"gait.footsteps": (f"0.1 0 0 {up}", "0 0 0 0")})
    controller, plant = make_controller(config, MODEL), make_plant("integrator", config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    last = controller.soles()
    assert [DQ(last[foot]).translation()[2] for foot in Foot] == pytest.approx([up, up], abs=1e-3)
    assert [DQ(last[foot]).translation()[0] for foot in Foot] == pytest.approx([0.1, 0.1], abs=2e-3)
    kin = Kinematics(MODEL, trace.q[-1], Foot.LEFT)
    assert kin.com[2] == pytest.approx(Kinematics(MODEL, trace.q[0], Foot.LEFT).com[2], abs=2e-3)


class KinematicRobot:
    """The controller in this process, with joints that follow their commands exactly."""

    def __init__(self, make: Any) -> None:
        self.node = make("controller", CONFIG)
        self.plant = make_plant("integrator", CONFIG, MODEL)
        self.ticks = 0

    def until(self, wanted: str, max_ticks: int = 4000) -> list[str]:
        statuses = self.node.got["footstep_status"]
        while not (statuses and statuses[-1].data.startswith(wanted)):
            assert self.ticks < max_ticks, [msg.data for msg in statuses]
            self.node.exchange(self.plant, MODEL, 1.0 + self.ticks * CONFIG.dt)
            self.ticks += 1
        return [msg.data for msg in statuses]

    def walk(self, ticks: int) -> None:
        with pytest.raises(AssertionError):
            self.until("nothing", self.ticks + ticks)

    def send(self, *footprints: DQ, frame: str = "odom") -> str:
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Path as PathMessage

        from dqwalk_ros.nodes import messages as ros

        path = PathMessage()
        path.header.frame_id = frame
        path.poses = [PoseStamped(pose=ros.pose_fields(x.vec8())) for x in footprints]
        self.node.send("footsteps", path)
        return str(self.node.got["footstep_status"][-1].data)


@pytest.fixture
def robot(make: Any) -> KinematicRobot:
    return KinematicRobot(make)


def test_footsteps_in_odom_are_walked(robot: KinematicRobot) -> None:
    controller = robot.node.node._controller
    assert "not in a stance" in robot.send(BESIDE)
    robot.walk(10)
    soles = {foot: DQ(x) for foot, x in controller.soles().items()}
    left = soles[Foot.LEFT] * turned(0.04, 0.0, 0.05)
    right = left * turned(0.03, 0.0) * BESIDE
    assert robot.send(left, right) == "walking 0/2"
    assert "not in a stance" not in robot.node.log.lines[-1]
    statuses = robot.until("done")
    assert statuses[-3:] == ["walking 1/2", "walking 1/2", "done 2/2"] or statuses[-2:] == ["walking 1/2", "done 2/2"]
    assert controller.phase.name.startswith("stance")
    for foot, wanted in ((Foot.LEFT, left), (Foot.RIGHT, right)):
        error = (wanted.conj() * DQ(controller.soles()[foot])).translation()
        assert np.linalg.norm(error) < CONFIG.gait.footstep_tolerance, foot
    robot.walk(50)
    assert controller.phase.name.startswith("stance")  # it waits in the stance phase


def test_footsteps_in_a_sole_frame_and_cancellation_by_an_empty_path(robot: KinematicRobot) -> None:
    robot.walk(10)
    frame = MODEL.soles[Foot.LEFT].frame
    assert "must be odom, or a sole" in robot.send(BESIDE, frame="map")
    assert robot.send(*[turned(0.02 * k, 0.0) * (BESIDE if k % 2 else DQ(1.0)) for k in range(1, 6)], frame=frame) == (
        "walking 0/5"
    )
    robot.until("walking 1/5")
    assert "not in a stance" in robot.send(BESIDE)
    assert robot.send() == "cancelled: 4 footsteps dropped, the feet are put together"
    controller = robot.node.node._controller
    names = []
    while not (names and names[-1].startswith("stance")):
        robot.walk(20)
        names.append(controller.phase.name)
        assert len(names) < 100
    apart = DQ(controller.soles()[Foot.LEFT]).conj() * DQ(controller.soles()[Foot.RIGHT])
    np.testing.assert_allclose(apart.translation(), BESIDE.translation(), atol=5e-3)


@pytest.mark.parametrize("how", ["stop", "reset", "fail"])
def test_footsteps_that_are_not_walked_are_not_called_done(
    robot: KinematicRobot, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = robot.node.node
    robot.walk(10)
    frame = MODEL.soles[Foot.LEFT].frame
    assert robot.send(*[turned(0.02 * k, 0.0) * (BESIDE if k % 2 else DQ(1.0)) for k in range(1, 6)], frame=frame)
    controller._footsteps.show()
    with monkeypatch.context() as context:  # a step that recovers from a push
        context.setattr(type(controller._controller), "phase", SimpleNamespace(kind=PhaseKind.SINGLE_SUPPORT))
        controller._footsteps.show()
    assert [msg.data for msg in robot.node.got["footstep_status"][-2:]] == 2 * ["walking 0/5"]
    robot.until("walking 1/5")
    if how == "stop":
        assert controller._stop()[0]
    elif how == "reset":
        assert controller._pause()[0]
        assert controller._reset()[0]
        assert controller._start()[0]
    else:
        controller._end("a reason")
    robot.walk(700)
    assert not any(msg.data.startswith("done") for msg in robot.node.got["footstep_status"])
    then = "the feet are put together" if how == "stop" else "the walk is over"
    assert robot.node.got["footstep_status"][-1].data == f"cancelled: 4 footsteps dropped, {then}"


def test_the_table_requests_round_steps(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["footsteps"])
    asked = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith(" ")]
    assert asked[:9] == ["-100", "-75", "-50", "-25", "0", "25", "50", "75", "100"]
    assert asked[9:20] == ["-60", "-40", "-20", "-10", "-5", "0", "5", "10", "20", "40", "60"]
