"""Arms beside a walk: they swing, follow trajectories and poses of hands, and leave the walk as it is."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import walks

from dqwalk_ros.config import Config, RobotConfig, load, with_files
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.robot.model import load_model, parse_model
from dqwalk_ros.support.errors import ConfigError, ModelError, StateError
from dqwalk_ros.walks.arms.arms import Arms
from dqwalk_ros.walks.arms.paths import JointPath
from dqwalk_ros.walks.table import make_controller, make_walk

QUICK = {"standing.transfer_duration": 0.4, "standing.swing_duration": 0.4, "node.robot_description": False}
CONFIG = with_files(load("poppy"), [Path("arms")]).updated({"gait.steps": 0, "gait.recover": "", **QUICK})
MODEL = load_model(CONFIG.robot)
SMALL = Path(__file__).parents[1] / "data" / "small_humanoid.urdf"
ELBOW = MODEL.joint_names.index("l_elbow_y")
WALKING = with_files(load("poppy_dynamic"), [Path("arms")]).updated({"gait.steps": 0, "plant.imu": False})
ZERO = np.zeros(MODEL.n)
IN_FRONT = DQ.from_pose([0.15, 0.1, -0.05])


class Robot:
    """A controller and joints that follow it exactly."""

    def __init__(self, config: Config = CONFIG) -> None:
        self.controller, self.arms = make_controller(config, MODEL), None
        self.plant = KinematicPlant(MODEL, make_walk(config, MODEL).posture)
        self.arms: Arms = self.controller.walk.arms  # type: ignore[attr-defined]

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds / CONFIG.dt)):
            self.plant.step(self.controller.step(self.plant.state, CONFIG.dt), CONFIG.dt)
            each()

    @property
    def q(self) -> Any:
        return self.plant.state.q

    def hand(self, frame: str) -> Any:
        """Position of the left hand in a frame, at the last state."""
        kin = self.controller.kin
        return DQ(kin.pose(frame)).conj().transform_point(kin.point("l_hand"))


def test_arms_are_locked_unless_they_are_freed() -> None:
    walk = make_walk(load("poppy_dynamic"), load_model(load("poppy_dynamic").robot))
    assert (walk.arms, walk.beside(Foot.LEFT)) == (None, ())  # type: ignore[attr-defined]


@pytest.mark.parametrize("lever", [0.0, 0.1])
def test_gradients_of_the_tasks_are_those_of_differences(lever: float) -> None:
    config = CONFIG.updated({"arms.lever": lever})
    arms, rng = Arms(config, MODEL, MODEL.posture(config.standing.posture)), np.random.default_rng(1)
    arms.reach("left", IN_FRONT * DQ.from_roll_pitch_yaw([0.3, -0.4, 0.5]), "chest")
    q = 0.5 * (MODEL.q_min + MODEL.q_max) + 0.2 * rng.standard_normal(MODEL.n)
    for hand in arms.hands.values():
        hand.set(Kinematics(MODEL, q, Foot.LEFT), None, lever)
    for base in Foot:
        for task in arms.tasks(base):
            _, J = walks.values(task, Kinematics(MODEL, q, base))
            for k in range(MODEL.n):
                step = 1e-6 * np.eye(MODEL.n)[k]
                ahead, back = (walks.values(task, Kinematics(MODEL, q + s, base))[0] for s in (step, -step))
                np.testing.assert_allclose(J[:, k], (ahead - back) / 2e-6, atol=1e-8)


def test_arms_swing_against_the_legs_and_have_no_part_in_the_steps() -> None:
    robot, swung = Robot(), []
    other = Robot(CONFIG.updated({"arms.swing": ()}))
    for one in (robot, other):
        one.run(0.1)
        one.controller.steer(0.05, 0.0, 0.0)
    left, right = (MODEL.joint_names.index(f"{side}_shoulder_y") for side in "lr")

    def note() -> None:
        kin = robot.controller.kin
        swung.append((robot.q[left], robot.q[right], float((kin.point("l_sole") - kin.point("r_sole"))[0])))

    robot.run(1.6, note)  # until the right foot has landed
    other.run(1.6)
    q_left, q_right, ahead = np.array(swung).T
    assert np.ptp(q_left) > 0.05
    assert np.corrcoef(q_left, ahead)[0, 1] > 0.95
    assert np.corrcoef(q_right, ahead)[0, 1] < -0.95
    landed = [one.controller.soles() for one in (robot, other)]
    for foot in Foot:
        np.testing.assert_allclose(landed[0][foot], landed[1][foot], atol=1e-4)


def test_a_trajectory_is_followed_and_its_end_is_held() -> None:
    robot = Robot(CONFIG.updated({"arms.joint_speed": 3.0}))
    robot.run(0.1)
    robot.controller.steer(0.05, 0.0, 0.0)
    robot.arms.follow(["l_elbow_y"], [0.5, 1.0], [[-0.8], [-1.2]], [[-1.0], [0.0]])
    seen: list[float] = []
    robot.run(1.5, lambda: seen.append(float(robot.q[ELBOW])))
    path = JointPath(np.array([0.0, 0.5, 1.0]), np.array([0.0, -0.8, -1.2]), np.array([0.0, -1.0, 0.0]))
    wanted = [path.at((k + 1) * CONFIG.dt)[0] for k in range(len(seen))]
    np.testing.assert_allclose(seen, wanted, atol=0.02)
    robot.arms.follow(["l_elbow_y"], [], [])
    robot.run(2.5)
    assert abs(robot.q[ELBOW]) < 0.01


def test_a_path_is_differentiated_by_its_velocity() -> None:
    times, rng = np.array([0.0, 0.4, 1.0]), np.random.default_rng(2)
    for velocities in (None, rng.standard_normal(3)):
        path = JointPath(times, rng.standard_normal(3), velocities)
        for t in (0.1, 0.3, 0.5, 0.9):
            assert path.at(t)[1] == pytest.approx((path.at(t + 1e-6)[0] - path.at(t - 1e-6)[0]) / 2e-6, abs=1e-6)
        for k, t in enumerate(times):
            assert path.at(t)[0] == pytest.approx(path.angles[k])
        for k, fastest in enumerate(path.fastest()):
            speeds = [abs(path.at(t)[1]) for t in np.linspace(times[k], times[k + 1], 2001)[1:-1]]
            assert max(speeds) == pytest.approx(fastest, rel=1e-3)
        assert (path.at(-1.0)[1], path.at(2.0)) == (0.0, (path.angles[-1], 0.0))


@pytest.mark.parametrize(
    ("names", "times", "angles", "velocities", "reason"),
    [
        ([], [1.0], [[]], None, "names no joint"),
        (["l_knee_y"], [1.0], [[0.1]], None, "l_knee_y is no joint of the arms; they are l_shoulder_y"),
        (["l_elbow_y"] * 2, [1.0], [[0.0, 0.0]], None, "names a joint twice"),
        (["l_elbow_y"], [1.0, 2.0], [[-1.0]], None, "positions for 2 points of 1 joints"),
        (["l_elbow_y"], [1.0, 1.0], [[-1.0], [-1.1]], None, "not increasing"),
        (["l_elbow_y"], [math.nan], [[-1.0]], None, "not finite"),
        (["l_elbow_y"], [1.0], [[math.nan]], None, "point 1 of l_elbow_y is nan rad"),
        (["l_elbow_y"], [1.0, 2.0], [[-1.0], [0.5]], None, "point 2 of l_elbow_y is 0.5 rad; its limits are -2.583"),
        (
            ["l_elbow_y"],
            [1.0],
            [[-1.0]],
            [[-9.0]],
            "point 1 of l_elbow_y has -9 rad/s; its limit is 1 .arms.joint_speed",
        ),
        (["l_elbow_y"], [1.0, 1.1], [[-1.0], [-2.0]], None, "l_elbow_y needs 10 rad/s to point 2"),
        (["l_elbow_y"], [1.0, 2.0], [[-1.0], [-1.8]], [[0.0], [0.0]], "l_elbow_y needs 1.2 rad/s to point 2"),
    ],
)
def test_invalid_trajectories_are_refused_by_name(
    names: list[str], times: list[float], angles: Any, velocities: Any, reason: str
) -> None:
    arms = Arms(CONFIG, MODEL, np.zeros(MODEL.n))
    with pytest.raises(StateError, match=reason):
        arms.follow(names, times, angles, velocities)


def test_a_trajectory_of_another_clock_is_refused() -> None:
    with pytest.raises(StateError, match="after the last state"):
        Arms(CONFIG, MODEL, np.zeros(MODEL.n)).follow(["l_elbow_y"], [1.0], [[-1.0]], begin=1.7e9)


def test_a_hand_follows_a_pose_in_the_trunk_while_the_robot_walks() -> None:
    robot = Robot()
    robot.run(0.1)
    robot.controller.steer(0.05, 0.0, 0.0)
    robot.arms.reach("left", IN_FRONT, "chest")
    before, fastest = robot.hand("chest"), []

    def note() -> None:
        nonlocal before
        now = robot.hand("chest")
        fastest.append(np.linalg.norm(now - before) / CONFIG.dt)
        before = now

    robot.run(2.5, note)
    np.testing.assert_allclose(robot.hand("chest"), IN_FRONT.translation(), atol=2e-3)
    assert max(fastest) < 1.3 * CONFIG.arms.hand_speed


def test_a_hand_stays_at_a_place_on_the_ground_while_the_robot_steps_on() -> None:
    robot = Robot()
    robot.run(0.1)
    kin, base = robot.controller.kin, DQ(robot.controller.x_odom_base)
    place = DQ(kin.pose("chest")) * DQ.from_pose([0.19, 0.1, -0.05])
    robot.arms.reach("left", place)
    world = (base * place).translation()
    robot.controller.steer(0.05, 0.0, 0.0)
    phases = set()
    robot.run(2.4, lambda: phases.add(robot.controller.phase_index))
    assert len(phases) > 3
    now = DQ(robot.controller.x_odom_base).transform_point(robot.controller.kin.point("l_hand"))
    np.testing.assert_allclose(now, world, atol=5e-3)


def test_a_hand_that_is_sent_into_the_pelvis_stays_outside() -> None:
    pair = "apart_l_forearm_pelvis"
    least = {}
    for pairs in (CONFIG.collision.pairs, ()):
        robot = Robot(CONFIG.updated({"collision.pairs": pairs}))
        robot.run(0.1)
        kin = robot.controller.kin
        robot.arms.reach("left", DQ(kin.pose("chest")).conj() * DQ(kin.pose("pelvis")), "chest")
        kept, seen = make_walk(CONFIG, MODEL), []
        phase = kept.phase(robot.controller.phase.kind, robot.controller.phase.support, robot.q)
        robot.run(1.5, lambda: seen.append(robot.q))  # noqa: B023
        least[bool(pairs)] = min(phase.distances(q)[pair] for q in seen[::10])
        # all programs count, of which there are several while it presses
        assert (robot.controller.iterations > robot.controller.solution.iterations) is bool(pairs)
    assert least[False] < -0.01
    assert least[True] > -1e-4


def test_a_walk_is_not_moved_by_a_hand_that_presses_on_the_body() -> None:
    """The robot walks past a place on the ground which the hand is to keep to, in the middle of its body."""
    from dqwalk_ros.plants.mujoco import own_contacts

    trunk = [MODEL.joint_names.index(name) for name in ("abs_x", "abs_y", "abs_z", "bust_x", "bust_y")]
    seen: list[list[Any]] = []
    told: list[str] = []
    for places in ([], [[0.1, 0.0, 0.42]]):
        robot, angles = Robot(WALKING), []
        robot.run(0.1)
        robot.controller.steer(0.1, 0.0, 0.0)
        for place in places:
            robot.arms.reach("left", DQ.from_pose(place))

        def note() -> None:
            angles.append(robot.q)  # noqa: B023
            told.extend(robot.arms.news())  # noqa: B023

        robot.run(4.0, note)
        seen.append(angles)
    assert np.abs(np.array(seen[1]) - np.array(seen[0]))[:, trunk].max() < 0.1
    assert not own_contacts(MODEL, np.array(seen[1]))
    assert len(told) == 1
    assert "the left hand stops" in told[0]
    assert "the body is in the way (apart_l_" in told[0]


def test_the_shares_of_all_tasks_are_the_objective() -> None:
    robot = Robot()
    robot.run(0.1)
    robot.arms.reach("left", IN_FRONT, "chest")
    robot.run(0.3)
    now = robot.controller.phase.evaluate(robot.q, elapsed=0.3, dt=CONFIG.dt)
    robot.run(0.1)  # which evaluates other states
    shares = [now.share([name]) for name in now.assembly.task_spans]
    damping = now.assembly.damping**2 * np.eye(MODEL.n)
    np.testing.assert_allclose(sum(H for H, _ in shares) + damping, now.problem.H, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sum(c for _, c in shares), now.problem.c, rtol=1e-9, atol=1e-9)
    assert np.abs(now.share(["left_hand"])[1]).max() > 1e-3


def test_what_an_arm_cannot_reach_is_said_once() -> None:
    robot = Robot()
    robot.run(0.1)
    told: list[str] = []
    angles: list[Any] = []
    robot.arms.reach("left", DQ.from_pose([0.6, 0.1, 0.0]), "chest")  # the elbow is stretched, as in all these places
    robot.run(3.0, lambda: angles.append(robot.q))
    joints = [MODEL.joint_names.index(name) for name in robot.arms.names]
    assert np.abs(np.diff(angles, axis=0)[:, joints]).max() < CONFIG.dt * CONFIG.arms.joint_speed + 1e-9
    robot.run(3.0, lambda: told.extend(robot.arms.news()))
    assert len(told) == 1
    assert told[0].startswith("the left hand stops")
    assert told[0].endswith("it is out of reach")
    robot.arms.reach("left", IN_FRONT, "chest")
    robot.run(2.5, lambda: told.extend(robot.arms.news()))
    assert len(told) == 1
    robot.arms.follow(["l_shoulder_y", "l_shoulder_x", "l_arm_z", "l_elbow_y"], [0.5], [[0.0, -0.3, 0.0, 0.0]])
    robot.run(4.5, lambda: told.extend(robot.arms.news()))
    assert any(each.startswith("l_shoulder_") and "(apart_l_" in each for each in told)
    assert len(told) == len({*told}) <= 1 + 4


def test_the_command_prints_the_pairs_that_poppys_arms_can_meet(capsys: Any) -> None:
    from dqwalk_ros import cli
    from dqwalk_ros.support import strict_yaml

    free = [
        "config",
        "poppy_dynamic",
        "--params",
        "arms",
        "--set",
        "collision.pairs=[]",
        "--set",
        "collision.capsules=[]",
    ]
    assert cli.main([*free, "--check"]) == 1
    assert "nothing keeps the free arms from the body" in capsys.readouterr().out
    assert cli.main([*free, "--capsules"]) == 0
    printed = strict_yaml.read(capsys.readouterr().out, source="printed")
    pairs = {frozenset(pair.split("=")) for pair in printed["collision.pairs"]}
    assert pairs >= {frozenset(pair.split("=")) for pair in CONFIG.collision.pairs}
    assert len(pairs) < len(CONFIG.collision.pairs) + 5
    alone = Arms(CONFIG.updated({name: tuple(value) for name, value in printed.items()}), MODEL, ZERO)
    assert not alone.news()
    assert (
        "nothing keeps the arms from the body" in Arms(CONFIG.updated({"collision.pairs": ()}), MODEL, ZERO).news()[0]
    )


def test_an_arm_that_gave_up_may_do_so_again_after_its_timeout() -> None:
    robot = Robot(CONFIG.updated({"arms.timeout": 0.3}))
    robot.run(0.1)
    robot.arms.follow(["l_elbow_y"], [0.5], [[-0.4]])
    robot.run(0.2)
    assert len(robot.arms.give_up(ELBOW)) == 4
    assert not len(robot.arms.give_up(ELBOW))
    assert not len(robot.arms.give_up(MODEL.joint_names.index("l_knee_y")))
    robot.run(0.5)
    assert len(robot.arms.give_up(ELBOW)) == 4


def test_poppys_links_touch_in_no_posture_that_the_rows_of_its_arms_allow() -> None:
    from dqwalk_ros.plants.mujoco import own_contacts

    rng, joints = np.random.default_rng(1), [MODEL.joint_names.index(name) for name in Arms(CONFIG, MODEL, ZERO).names]
    standing, margin = MODEL.posture(CONFIG.standing.posture), CONFIG.joints.margin
    phase = make_walk(CONFIG, MODEL).phase(PhaseKind.STANCE, Foot.LEFT, standing)
    postures: dict[bool, list[Any]] = {True: [standing], False: [standing]}
    for _ in range(4000):
        q = standing.copy()
        q[joints] = rng.uniform(MODEL.q_min[joints] + margin, MODEL.q_max[joints] - margin)
        allowed = all(d >= 0.0 for name, d in phase.distances(q).items() if name.startswith("apart_"))
        postures[allowed].append(q)
    assert not own_contacts(MODEL, np.array(postures[True]))
    assert len(own_contacts(MODEL, np.array(postures[False]))) > 12


def test_the_newest_command_of_an_arm_counts_until_its_timeout() -> None:
    robot = Robot(CONFIG.updated({"arms.timeout": 0.5}))
    robot.run(0.1)
    robot.arms.follow(["l_elbow_y", "r_elbow_y"], [0.2], [[-0.3, -0.3]])
    robot.run(0.1)
    robot.arms.reach("left", IN_FRONT, "chest")
    robot.run(0.4)
    assert robot.q[MODEL.joint_names.index("r_elbow_y")] == pytest.approx(-0.3, abs=0.01)
    assert robot.arms.hands["left"].pose is not None
    robot.run(2.0)
    assert robot.arms.hands["left"].pose is None
    arms = [MODEL.joint_names.index(name) for name in robot.arms.names]
    np.testing.assert_allclose(robot.q[arms], MODEL.posture(CONFIG.standing.posture)[arms], atol=0.03)
    robot.arms.reach("left", IN_FRONT, "chest")
    robot.arms.follow(["l_elbow_y"], [1.0], [[-1.0]])
    assert robot.arms.hands["left"].pose is None


@pytest.mark.parametrize("frame", ["l_sole", "map"])
def test_poses_in_other_links_are_refused(frame: str) -> None:
    with pytest.raises(StateError, match=rf"in '{frame}', which is not fixed to 'chest'"):
        Arms(CONFIG, MODEL, np.zeros(MODEL.n)).reach("left", IN_FRONT, frame)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"arms.joints": ("l_tail",)}, "arms.joints names 'l_tail'"),
        ({"arms.left_hand": "l_foot"}, "arms.left_hand is 'l_foot', which no joint of arms.joints moves"),
        ({"arms.left_hand": "r_hand"}, "arms.left_hand and arms.right_hand are both 'r_hand'"),
        ({"arms.left_hand": "claw"}, "arms.left_hand is 'claw', and the robot has no such link"),
        ({"arms.joints": ("?_elbow_y", "?_knee_y")}, "arms.joints names l_knee_y, r_knee_y of the legs"),
        ({"standing.posture": ("l_knee_y=9",)}, "standing.posture is outside the joint limits: l_knee_y by"),
        ({"arms.swing": ("l_knee_y=1",)}, "arms.swing names l_knee_y, which is not in arms.joints"),
    ],
)
def test_a_wrong_section_is_refused_by_name(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        make_walk(CONFIG.updated(changes), MODEL)


def test_the_engine_counts_contacts_between_links() -> None:
    from dqwalk_ros.plants.mujoco import own_contacts

    hanging = MODEL.posture(CONFIG.standing.posture)
    inward = MODEL.posture([*CONFIG.standing.posture, "l_shoulder_x=-0.3"])
    crossed = MODEL.posture([*CONFIG.standing.posture, "?_hip_z=0.5", "l_hip_x=-0.3"])
    assert not own_contacts(MODEL, np.array([hanging, hanging]))
    point = '<collision><geometry><sphere radius="0"/></geometry></collision></link>'  # a contact point of Drake
    pointed = replace(MODEL, urdf=MODEL.urdf.replace("</link>", point))
    found = own_contacts(pointed, np.array([hanging, inward, inward, crossed]))
    assert found["l_forearm, pelvis"] == 2
    assert found["l_shin, r_shin"] == 1
    assert not own_contacts(MODEL, np.array([inward, inward]))  # as in the first state
    small = parse_model(SMALL.read_text(), RobotConfig(pelvis="trunk", left_sole="l_foot", right_sole="r_foot"))
    bent = small.posture(["?_hip_pitch=-1.0"])  # the boxes of hip and thigh overlap, two joints at one place apart
    assert not own_contacts(small, np.array([np.zeros(small.n), bent]))


# ---------------------------------------------------------------------- a load


def test_a_load_is_part_of_the_model_of_its_description_and_of_the_engine() -> None:
    import mujoco

    from dqwalk_ros.plants.mujoco import build

    config = CONFIG.updated({"robot.payload": ("l_hand=0.3",), "robot.mass": 3.0})
    model = load_model(config.robot)
    assert model.mass == pytest.approx(3.3)
    again = parse_model(model.urdf, config.robot)
    assert again.mass == pytest.approx(3.3)
    q = model.posture(["l_elbow_y=-1.2", "l_shoulder_x=0.4"])
    kin, plain = (
        Kinematics(one, q, Foot.LEFT) for one in (model, load_model(config.updated({"robot.payload": ()}).robot))
    )
    np.testing.assert_allclose(3.3 * kin.com, 3.0 * plain.com + 0.3 * kin.point("l_hand"), atol=1e-12)
    mj = build(config, model)
    data = mujoco.MjData(mj)
    for name, angle in zip(model.joint_names, q, strict=True):
        data.qpos[mj.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(mj, data)
    sole = mj.body("l_sole").id
    found = data.xmat[sole].reshape(3, 3).T @ (data.subtree_com[1] - data.xpos[sole])
    np.testing.assert_allclose(found, kin.com, atol=1e-9)


@pytest.mark.parametrize("entry", ["l_hand", "l_hand=heavy", "l_hand=-1", "claw=1"])
def test_a_wrong_load_is_refused(entry: str) -> None:
    with pytest.raises((ConfigError, ModelError), match=r"robot\.payload"):
        load_model(CONFIG.updated({"robot.payload": (entry,)}).robot)


# ---------------------------------------------------------------------- topics


def test_the_topics_command_the_arms_and_name_what_they_refuse(make: Any) -> None:
    from geometry_msgs.msg import PoseStamped
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from dqwalk_ros.nodes import messages as ros

    node, robot = make("controller", CONFIG), KinematicPlant(MODEL, make_walk(CONFIG, MODEL).posture)
    node.exchange(robot, MODEL, 1.0)
    arms = node.node._controller.walk.arms

    def aim(frame: str, x: DQ, **changes: float) -> None:
        msg = PoseStamped(pose=ros.pose_fields(x.vec8()))
        msg.header.frame_id = frame
        for name, value in changes.items():
            setattr(msg.pose.orientation, name, value)
        node.send("left_hand_target", msg)

    aim("chest", IN_FRONT)
    assert not arms.hands["left"].fixed
    kin = node.node._controller.kin
    aim("odom", node.node._odometry.base_sole * DQ(kin.pose("l_hand")))
    np.testing.assert_allclose(arms.hands["left"].pose.translation(), kin.point("l_hand"), atol=1e-12)
    points = [JointTrajectoryPoint(positions=[-0.1], velocities=v) for v in ([], [0.0])]
    for k, point in enumerate(points):
        point.time_from_start.sec = k + 1
    node.send("arm_trajectory", JointTrajectory(joint_names=["l_elbow_y"], points=points[:1]))
    assert arms.hands["left"].pose is None
    for bad, reason in (
        (lambda: aim("map", IN_FRONT), "left_hand_target rejected (1 so far): the pose of the left hand is in 'map'"),
        (lambda: aim("", IN_FRONT), "no frame_id"),
        (lambda: aim("chest", IN_FRONT, w=7.0), "no unit quaternion"),
        (lambda: aim("chest", IN_FRONT, w=1e200), "no unit quaternion"),
        (lambda: aim("odom", DQ.from_pose([1e308, 0.0, 0.0])), "the pose is 1e+308 m away"),
        (lambda: node.send("arm_trajectory", JointTrajectory(joint_names=["l_elbow_y"], points=points)),
         "arm_trajectory rejected (1 so far): point 2 has 1 positions and 1 velocities"),
        (lambda: node.send("arm_trajectory", JointTrajectory(joint_names=["l_knee_y"], points=points[:1])),
         "l_knee_y is no joint of the arms"),
    ):  # fmt: skip
        bad()
        assert reason in node.log
    assert node.node._arms.values() == {"left_hand_target rejected": 5, "arm_trajectory rejected": 2}


def test_a_trajectory_begins_by_the_clock_of_the_states_after_it_was_set(make: Any) -> None:
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    from dqwalk_ros.nodes import messages as ros

    config = CONFIG.updated({"plant.lockstep": False})
    node, robot = make("controller", config), KinematicPlant(MODEL, make_walk(config, MODEL).posture)
    times = (*(1.0 + config.dt * np.arange(5)), *(3600.0 + config.dt * np.arange(5)))
    for stamp in times:
        node.exchange(robot, MODEL, stamp)
    assert "a clock was set" in node.log
    point = JointTrajectoryPoint(positions=[-0.1])
    point.time_from_start.sec = 1
    msg = JointTrajectory(header=ros.header(round(1e9 * (times[-1] + 0.5))), joint_names=["l_elbow_y"], points=[point])
    node.send("arm_trajectory", msg)
    ((_, _, begin),) = node.node._controller.walk.arms._asked
    walked = node.node._controller.walk.arms._time  # of the last state
    assert begin - walked == pytest.approx(0.5)


@pytest.mark.parametrize("arm", [True, False])
def test_an_arm_that_something_blocks_holds_still_and_ends_no_walk(make: Any, arm: bool) -> None:
    from geometry_msgs.msg import Twist
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    node, robot = make("controller", CONFIG), KinematicPlant(MODEL, make_walk(CONFIG, MODEL).posture)
    stuck, sent = MODEL.joint_names.index("l_elbow_y" if arm else "l_knee_y"), []

    def walk(seconds: float, *, blocked: bool) -> None:
        angle = robot.state.q[stuck]
        for _ in range(round(seconds / CONFIG.dt)):
            q = robot.state.q.copy()
            q[stuck] = angle if blocked else q[stuck]  # of a leg it also drifts
            angle += 0.0 if arm else 0.5 * CONFIG.dt
            sent.append(node.exchange(robot, MODEL, 1.0 + CONFIG.dt * len(sent), q))
            if blocked:
                robot.state.q[stuck] = angle if arm else robot.state.q[stuck]

    def aim(angle: float) -> None:
        point = JointTrajectoryPoint(positions=[angle])
        point.time_from_start.sec = 1
        node.send("arm_trajectory", JointTrajectory(joint_names=["l_elbow_y"], points=[point]))

    walk(0.2, blocked=False)
    forward = Twist()
    forward.linear.x = 0.05
    node.send("cmd_vel", forward)
    aim(-1.5)
    walk(3.0, blocked=True)
    assert (node.got["phase"][-1].data == "failed") is not arm
    if not arm:
        return
    told = "l_elbow_y does not follow: its arm holds still where it is; something blocks it"
    assert told in node.log
    assert np.abs(np.array(sent[-100:])[:, ELBOW]).max() < 0.05
    aim(-1.0)
    walk(2.0, blocked=False)
    assert abs(robot.state.q[ELBOW] + 1.0) < 0.05
    aim(0.0)
    walk(2.0, blocked=True)
    assert [line for _, line in node.log.lines].count(told) == 2
    assert "failed" not in [message.data for message in node.got["phase"]]


def test_an_arm_is_not_blamed_for_a_plant_that_holds(make: Any) -> None:
    """A robot that may stand still waits whether the plant reports that it holds; the arm keeps its command."""
    from std_msgs.msg import Bool
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    config, periods = CONFIG.updated({"plant.lockstep": False}), itertools.count()
    node, robot = make("controller", config), KinematicPlant(MODEL, make_walk(config, MODEL).posture)

    def stand(seconds: float, *, holds: bool = False) -> None:
        for k in itertools.islice(periods, round(seconds / config.dt)):
            q = robot.state.q.copy()
            node.exchange(robot, MODEL, 1.0 + config.dt * k)
            if holds:
                robot.state.q[:] = q

    stand(0.2)
    point = JointTrajectoryPoint(positions=[-1.5])
    point.time_from_start.sec = 2
    node.send("arm_trajectory", JointTrajectory(joint_names=["l_elbow_y"], points=[point]))
    stand(1.0)
    angle = robot.state.q[ELBOW]
    for _ in range(100):
        stand(config.dt, holds=True)
        if node.node._falls.suspected:
            break
    assert "l_elbow_y does not follow its commands" in node.node._falls.suspected
    node.send("plant_ready", Bool(data=False))
    stand(0.5, holds=True)
    assert robot.state.q[ELBOW] == angle
    node.send("plant_ready", Bool(data=True))
    stand(3.0)
    assert abs(robot.state.q[ELBOW] + 1.5) < 0.05
    assert "does not follow" not in node.log
