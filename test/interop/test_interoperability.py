"""Messages and behaviour of other robots and nodes that this package itself never produces.

Each was found in use with Jazzy's own nodes.
"""

from __future__ import annotations

import itertools
import sys
import types
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from inside import state, subscribe, until
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dqwalk_ros.config import Config, from_yaml, load, overlaid, to_yaml
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.command_line import parameters_of
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.base import Inertial
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import DqwalkError

PAPER = load("paper")
MODEL = load_model(PAPER.robot)
NAMES, ZERO = MODEL.joint_names, np.zeros(MODEL.n)
DT = PAPER.dt


# ---------------------------------------------------------------------- states


@pytest.mark.parametrize("bad", [ZERO + np.nan, np.append(np.inf, ZERO[1:])], ids=["all", "one"])
def test_nan_velocities_are_treated_as_not_measured(make: Any, bad: np.ndarray) -> None:
    """Jazzy's joint_state_broadcaster fills in NaN for what a position servo does not measure."""
    one = make("controller", PAPER)
    for k in range(5):
        one.send("joint_states", state(NAMES, ZERO, 1.0 + k * DT, velocity=bad))
    assert len(one.got["joint_velocity_commands"]) == 5
    assert "rejected" not in one.log


def test_rejected_states_do_not_raise_the_rate_of_diagnostics(make: Any) -> None:
    one = make("controller", PAPER)
    for k in range(100):
        one.clock.now += DT
        one.send("joint_states", state(NAMES, np.full(MODEL.n, np.nan), 1.0 + k * DT))
    assert 4 <= len(one.got["diagnostics"]) <= 5  # at 10 Hz


@pytest.mark.parametrize("with_imu", [False, True])
def test_a_gripper_on_joint_states_does_not_stop_the_walk(make: Any, with_imu: bool) -> None:
    """Partial publishers are common practice: hands, heads, joint_state_publisher. A state may precede its imu."""
    one = make("controller", PAPER.updated({"plant.imu": with_imu, "plant.lockstep": with_imu}))
    upright = Inertial(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 9.81]))
    gripper = one.beside("gripper")
    gripper.create_publisher(type(state(NAMES, ZERO, 0.0)), "joint_states", 1)
    plant = one.beside("plant")
    plant.create_publisher(type(state(NAMES, ZERO, 0.0)), "joint_states", 1)
    until(lambda: len(ros.publishers_of(one.node, "joint_states")) == 2)
    for batch in range(4):
        for k in range(50):
            at = 1.0 + (50 * batch + k) * DT
            one.send("joint_states", state(NAMES, ZERO, at))
            if with_imu:
                one.send("imu", ros.imu(round(1e9 * at), "", upright))
            one.send("joint_states", state(["finger"], [0.1], at))
        one.tick()
    assert len(one.got["joint_velocity_commands"]) >= 200
    assert "two plants" not in one.log
    assert "rejected" not in one.log


# ---------------------------------------------------------------------- commands


def moved(make: Any, stamp_of: Any) -> tuple[Any, float]:
    """Send commands with such stamps to an integrator in real time; return it and its largest angle [rad]."""
    one = make("integrator", PAPER.updated({"plant.command_timeout": 1.0}))  # stamps are of the system's clock
    for _ in range(20):
        one.pass_period()
        published = ros.nanoseconds(one.got["joint_states"][-1].header.stamp)
        one.send(
            "joint_velocity_commands",
            state(NAMES, [], 1e-9 * stamp_of(published, one.node.get_clock().now().nanoseconds), velocity=ZERO + 0.1),
        )
    return one, float(np.abs(one.node.plant.state.q).max())


@pytest.mark.parametrize(
    "stamp_of", [lambda state, now: state, lambda state, now: now, lambda state, now: 0], ids=["state", "now", "unset"]
)
def test_commands_are_accepted_with_any_common_stamp(make: Any, stamp_of: Any) -> None:
    """joint_state_topic_hardware_interface and teleoperation stamp now(), `ros2 topic pub` does not stamp at all."""
    one, angle = moved(make, stamp_of)
    assert angle > 0.0
    assert one.node.commands.gate.late == 0


def test_a_command_from_the_future_is_ignored_with_the_reason(make: Any) -> None:
    one, angle = moved(make, lambda state, now: now + 3_000_000_000)
    assert angle == 0.0
    assert "joint_velocity_commands ignored" in one.log
    for _ in range(2):
        one.tick()
    assert "stamped 3.0" in one.got["diagnostics"][-1].status[0].message


# ---------------------------------------------------------------------- topics


def test_the_topic_phase_holds_only_the_current_phase(make: Any) -> None:
    """`ros2 topic echo --once /phase` requests a history of more than one; phase_log has all phases."""
    one = make("controller", PAPER)
    offered = {p.topic_name: p for p in one.node.publishers}
    assert offered["/phase"].qos_profile.depth == offered["/support_foot"].qos_profile.depth == 1
    assert offered["/phase_log"].qos_profile.depth == 100
    one.send("joint_states", state(NAMES, ZERO, 1.0))
    assert [m.data for m in one.got["phase"]] == [m.data for m in one.got["phase_log"]] == ["double_support/left"]


def test_topics_that_steer_the_walk_are_recorded(make: Any, tmp_path: Path) -> None:
    one = make("recorder", PAPER, "--bag", str(tmp_path / "bag"))
    one.beside("pilot").create_publisher(Twist, "cmd_vel", 1)
    until(lambda: one.node._discover() or "cmd_vel" in one.node._others)
    assert one.node._others["cmd_vel"].type == "geometry_msgs/msg/Twist"
    assert "/rosout" in one.node._others
    one.node.close()


# ---------------------------------------------------------------------- parameters


def test_parameters_of_other_packages_are_ignored(make: Any) -> None:
    """As in ROS, a node ignores parameters that it does not declare."""
    text = to_yaml(PAPER) + "    robot_name: poppy\n    teleop: {scale: 2.0}\n/arm:\n  ros__parameters: {port: x}\n"
    one = make("controller", text)
    assert one.node.config == PAPER
    assert "ignoring parameters of other packages: robot_name, teleop.scale" in one.log


def test_a_file_for_other_nodes_only_is_accepted_with_a_warning(make: Any) -> None:
    text = "/**/controller:\n  ros__parameters: {dt: 0.01}\n"
    one = make("phase_monitor", text)
    assert one.node.config.dt == load("paper").dt
    assert "no section applies to /phase_monitor" in one.log
    assert "--params-file missing" in one.log  # without it the controller uses a robot of 25 joints
    assert "--params-file missing" not in make("viewer", text).log  # as the pilot, it has no robot


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/**: {ros__parameters: {gate.step_length: 0.04}}", "did you mean 'gait.step_length'"),
        ("/**: {ros__parameters: {gait.step_lenght: 0.04}}", "did you mean 'gait.step_length'"),
        ("/**: {ros__parameters: {gait.foo: 0.04}}", "unknown"),
        ("/**/controler: {ros__parameters: {dt: 0.01}}", "did you mean 'controller'"),
        ("/**: {ros__parameters: {robot: {urdf: nothing.urdf}}}", r"nothing\.urdf"),
    ],
)
def test_a_misspelt_name_is_an_error(make: Any, text: str, expected: str) -> None:
    with pytest.raises(DqwalkError, match=expected):
        make("controller", text)


# ---------------------------------------------------------------------- odometry and frames


class TFMessage:
    """A stand-in for the message of tf2_msgs, which the ROS wheels do not contain."""

    def __init__(self, transforms: list[Any]) -> None:
        self.transforms = transforms


@pytest.fixture
def tf(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[Any]]:
    """Return the messages published on /tf and /tf_static, by topic."""
    message = types.ModuleType("tf2_msgs.msg")
    message.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, "tf2_msgs", types.ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", message)
    sent: dict[str, list[Any]] = {}
    create = Node.create_publisher

    def create_publisher(self: Any, kind: Any, topic: str, *args: Any, **keywords: Any) -> Any:
        if kind is not TFMessage:
            return create(self, kind, topic, *args, **keywords)
        return types.SimpleNamespace(publish=sent.setdefault(topic, []).append)

    monkeypatch.setattr(Node, "create_publisher", create_publisher)
    return sent


def pose_of(transform: Any) -> DQ:
    p, r = transform.transform.translation, transform.transform.rotation
    return DQ.from_pose([p.x, p.y, p.z], [r.w, r.x, r.y, r.z])


def test_frames_follow_rep_105_and_120(make: Any, tf: dict[str, list[Any]]) -> None:
    """odom -> base_link -> base_footprint, joined to the root of the URDF; from the first state on, walking or not."""
    one = make("controller", PAPER.updated({"node.autostart": False}))
    q = np.clip(0.1 * np.random.default_rng(2).normal(size=MODEL.n), MODEL.q_min, MODEL.q_max)
    one.send("joint_states", state(NAMES, q, 1.0))
    (static,) = tf["/tf_static"][0].transforms
    assert (static.header.frame_id, static.child_frame_id) == ("base_link", MODEL.root)
    base, footprint = tf["/tf"][-1].transforms
    assert (base.header.frame_id, base.child_frame_id) == ("odom", "base_link")
    assert (footprint.header.frame_id, footprint.child_frame_id) == ("base_link", "base_footprint")
    kin = Kinematics(MODEL, q, Foot.RIGHT)  # the base of the first phase, double_support/left
    np.testing.assert_allclose(pose_of(base).vec8(), kin.pose(MODEL.root), atol=1e-12)
    ground = pose_of(base) * pose_of(footprint)
    assert ground.translation()[2] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(ground.translation()[:2], pose_of(base).translation()[:2], atol=1e-12)
    np.testing.assert_allclose(ground.rotation_matrix()[2], [0.0, 0.0, 1.0], atol=1e-12)


ADDED = {
    "neither": (),
    "footprint is the root": (("base_footprint", "base_link"), ("base_link", "pelvis")),
    "footprint is the root, no base_link": (("base_footprint", "pelvis"),),
    "base_link is the root": (("base_link", "pelvis"),),
    "footprint is below the root": (("base_link", "pelvis"), ("base_link", "base_footprint")),
    "base_link is below the root": (("world", "pelvis"), ("pelvis", "base_link")),
    "base_link moves": (("l_shin", "base_link"),),
}
"""Links added to Poppy's URDF, by fixed joints (parent, child)."""


def with_links(folder: Path, added: Any) -> str:
    """Return the path of a robot that is Poppy with further links, each shifted and turned."""
    text = (Path(__file__).parents[2] / "urdf" / "poppy.urdf").read_text()
    names = {name for pair in added for name in pair}
    lines = [f'<link name="{name}"/>' for name in names if f'<link name="{name}"' not in text]
    for parent, child in added:
        lines.append(f'<joint name="to_{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>')
        lines.append('<origin xyz="0.01 0.02 0.3" rpy="0 0.1 0.2"/></joint>')
    path = folder / "robot.urdf"
    path.write_text(text.replace("</robot>", "\n".join([*lines, "</robot>"])))
    return str(path)


@pytest.mark.parametrize("added", ADDED.values(), ids=ADDED)
def test_frames_are_one_tree_with_those_of_the_urdf(make: Any, tf: Any, tmp_path: Path, added: Any) -> None:
    """A robot_state_publisher publishes the joints of the URDF; no frame may have two parents."""
    one = make("controller", PAPER.updated({"robot.urdf": with_links(tmp_path, added), "node.autostart": False}))
    model = one.node._model
    subscribe(one, "/odom", OdometryMessage)
    q = np.clip(0.1 * np.random.default_rng(2).normal(size=model.n), model.q_min, model.q_max)
    one.send("joint_states", state(model.joint_names, q, 1.0))
    kin = Kinematics(model, q, Foot.RIGHT)  # the base of the first phase, double_support/left
    pose = {name: DQ(kin.pose(name)) for name in model.frames}
    edges = [
        (joint.find("parent").get("link"), joint.find("child").get("link"))
        for joint in ElementTree.fromstring(model.urdf).iter("joint")
    ]
    parents = {child: (parent, pose[parent].conj() * pose[child]) for parent, child in edges}
    for message in (*tf.get("/tf_static", []), *tf["/tf"]):
        for each in message.transforms:
            assert each.child_frame_id not in parents, each.child_frame_id
            parents[each.child_frame_id] = (each.header.frame_id, pose_of(each))

    def from_odom(frame: str, below: int = 0) -> DQ:
        assert below <= len(parents), f"a loop above {frame}"
        return DQ(1.0) if frame == "odom" else from_odom(parents[frame][0], below + 1) * parents[frame][1]

    assert {*pose, "base_link", "base_footprint"} == {*parents}  # all of them are connected
    for frame in pose:
        np.testing.assert_allclose(from_odom(frame).rotation_matrix(), pose[frame].rotation_matrix(), atol=1e-9)
        np.testing.assert_allclose(from_odom(frame).translation(), pose[frame].translation(), atol=1e-9)
    message = one.got["odom"][-1]
    assert message.child_frame_id == "base_link"
    at = message.pose.pose.position
    np.testing.assert_allclose([at.x, at.y, at.z], from_odom("base_link").translation(), atol=1e-9)
    if "base_footprint" not in pose:
        assert from_odom("base_footprint").translation()[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["paper", "poppy", "poppy_dynamic"])
def test_the_help_lists_every_section_that_the_controller_reads(
    make: Any, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    read: set[str] = set()

    def get(self: Config, section: str) -> Any:
        source = Path(sys._getframe(1).f_code.co_filename)
        inside = "dqwalk_ros" in source.parts[-4:-1]
        if inside and source.parent.name != "config":  # which copies all of them
            read.add(section)
        return object.__getattribute__(self, section)

    config = overlaid(load(name), "physics")
    monkeypatch.setattr(Config, "__getattribute__", get)
    make("controller", config)
    sections = {spec.name.split(".")[0] for spec in Config.specs()}
    assert read & sections <= {spec.name.split(".")[0] for spec in parameters_of("controller")}
    assert {"servo", "odometry", "estimation"} <= read


def odometry(make: Any, urdf: str, frame: str, *, with_sensor: bool) -> tuple[list[DQ], np.ndarray, float]:
    """Return poses and velocities of odom during 1 s of a walk, for a link as base_frame, and their period."""
    config = (overlaid(load("poppy"), "physics") if with_sensor else load("poppy")).updated({"robot.urdf": urdf})
    changes = {"odometry.base_frame": frame, "odometry.window": 0.005}
    one = make("controller", config.updated(changes))
    subscribe(one, "/odom", OdometryMessage)
    plant = make_plant("physics" if with_sensor else "integrator", config, one.node._model)
    for k in range(200):
        one.exchange(plant, one.node._model, 1.0 + k * config.dt)
    fields = [(m.pose.pose.position, m.pose.pose.orientation, m.twist.twist) for m in one.got["odom"]]
    x = [DQ.from_pose([p.x, p.y, p.z], [r.w, r.x, r.y, r.z]) for p, r, _ in fields]
    twist = [[getattr(v, axis) for v in (t.linear, t.angular) for axis in "xyz"] for *_, t in fields]
    return x, np.array(twist), config.dt


@pytest.mark.parametrize(
    ("frame", "with_sensor"),
    [
        pytest.param("imu", False, marks=pytest.mark.long),
        pytest.param("l_shin", False, marks=pytest.mark.long),
        ("l_shin", True),
    ],
)
def test_the_velocity_of_odometry_is_that_of_base_frame(make: Any, frame: str, with_sensor: bool) -> None:
    """Added up, the velocity of a link of the pelvis, or of one that a joint moves, is its way."""
    x, twist, dt = odometry(make, "poppy.urdf", frame, with_sensor=with_sensor)
    moved = np.array([b.translation() - a.translation() for a, b in itertools.pairwise(x)])
    v = np.array([pose.rotation_matrix() @ one[:3] for pose, one in zip(x, twist, strict=True)])
    assert np.abs(moved / dt).max() > 0.004
    np.testing.assert_allclose((v[1:] + v[:-1])[50:].sum(axis=0) * dt / 2.0, moved[50:].sum(axis=0), atol=3e-4)


def test_the_velocity_with_a_sensor_is_that_of_base_frame(make: Any, tmp_path: Path) -> None:
    """Two links of one body differ by the velocity of the rotation."""
    urdf = with_links(tmp_path, [("pelvis", "base_link")])
    x, of_pelvis, _ = odometry(make, urdf, "pelvis", with_sensor=True)
    y, of_base, _ = odometry(make, urdf, "base_link", with_sensor=True)
    arm = np.array([(a.conj() * b).translation() for a, b in zip(x, y, strict=True)])
    assert np.linalg.norm(arm, axis=1).min() > 0.01
    turns = [(a.conj() * b).rotation_matrix().T for a, b in zip(x, y, strict=True)]
    rotated = np.einsum("kij,kj->ki", turns, of_pelvis[:, :3] + np.cross(of_pelvis[:, 3:], arm))
    np.testing.assert_allclose(of_base[:, :3], rotated, atol=1e-6)


def test_odom_that_is_a_link_is_reported(make: Any, tf: Any, tmp_path: Path) -> None:
    one = make("controller", PAPER.updated({"robot.urdf": with_links(tmp_path, [("odom", "pelvis")])}))
    one.send("joint_states", state(one.node._model.joint_names, np.zeros(one.node._model.n), 1.0))
    assert "odometry.odom_frame 'odom' is also a link" in one.log
    assert not tf.get("/tf")
    assert not tf.get("/tf_static")


def test_odometry_has_pose_velocity_and_covariance(make: Any) -> None:
    one = make("controller", load("poppy"))
    model = one.node._model
    subscribe(one, "/odom", OdometryMessage)
    plant = make_plant("integrator", one.node.config, model)
    for k in range(700):  # through the first step
        one.exchange(plant, model, 1.0 + k * one.node.config.dt)
    odom = one.got["odom"]
    assert {(m.header.frame_id, m.child_frame_id) for m in odom} == {("odom", "base_link")}
    place = np.array([[m.pose.pose.position.x, m.pose.pose.position.y, m.pose.pose.position.z] for m in odom])
    speed = np.array([[getattr(m.twist.twist.linear, axis) for axis in "xyz"] for m in odom])
    between = (place[60:] - place[:-60]) / (60 * one.node.config.dt)  # it does not turn: base and odom agree
    np.testing.assert_allclose(speed[60:].cumsum(axis=0)[-1] * one.node.config.dt, place[-1] - place[50], atol=2e-3)
    assert np.abs(between).max() > 0.005
    before, after = (np.diag(np.reshape(odom[k].pose.covariance, (6, 6))) for k in (0, -1))
    assert (after[[0, 1, 5]] > before[[0, 1, 5]]).all()
    np.testing.assert_array_equal(after[2:5], before[2:5])


def test_odometry_does_not_jump_when_a_walk_restarts(make: Any) -> None:
    quick = {"standing.transfer_duration": 0.4, "standing.swing_duration": 0.4}
    one = make("controller", load("poppy").updated(quick))
    model, dt = one.node._model, one.node.config.dt
    subscribe(one, "/odom", OdometryMessage)
    plant = make_plant("integrator", one.node.config, model)
    for k in range(250):
        if k == 190:  # after the first step
            one.call("~/reset".removeprefix("~"), Trigger.Request())
        one.exchange(plant, model, 1.0 + k * dt)
    place = np.array([[m.pose.pose.position.x, m.pose.pose.position.y] for m in one.got["odom"]])
    assert np.linalg.norm(place[189] - place[0]) > 0.01
    assert np.abs(np.diff(place, axis=0)).max() < 2e-3


# ---------------------------------------------------------------------- time


def test_use_sim_time_without_a_clock_is_reported(make: Any) -> None:
    """It must not be reported as "two controllers: /controller"."""
    for name in ("controller", "integrator"):
        one = make(name, PAPER, ros=("-p", "use_sim_time:=true"))
        for _ in range(3):
            one.tick()
        assert "use_sim_time is set, but no node publishes /clock" in one.log
        assert "use_sim_time" in one.got["diagnostics"][-1].status[0].message
        assert not one.got.get("joint_states")
        assert "two controllers" not in one.log


def test_a_simulated_plant_publishes_the_clock(make: Any) -> None:
    """RViz and /tf can follow a walk in lockstep, whose stamps begin at zero."""
    one = make("integrator", PAPER.updated({"plant.lockstep": True, "plant.clock": True}))
    one.tick()
    one.send("joint_velocity_commands", state(NAMES, [], 0.0, velocity=ZERO))
    assert [ros.nanoseconds(m.clock) for m in one.got["clock"]] == [0, round(DT * 1e9)]


def test_the_integrator_follows_the_ros_clock(make: Any) -> None:
    """With a clock at half the real rate it moves at half the velocity."""
    one = make("integrator", PAPER, ros=("-p", "use_sim_time:=true"))
    times = iter(np.cumsum(np.full(60, 0.5 * DT)) + 10.0)
    one.node._now = lambda: next(times)
    one.node.time_trouble = lambda: ""
    (period, *_) = [t for t in one.node.timers if t.timer_period_ns == round(DT * 1e9)]
    period.callback()
    for _ in range(50):
        one.send("joint_velocity_commands", state(NAMES, [], 0.0, velocity=ZERO + 0.1))
        period.callback()
    assert one.node.plant.state.q == pytest.approx(ZERO + 0.1 * 50 * 0.5 * DT)


# ---------------------------------------------------------------------- further interfaces


def test_diagnostics_contain_the_namespace_and_the_robot(make: Any) -> None:
    """So that those of two robots are not merged."""
    one = make("controller", PAPER, ros=("-r", "__ns:=/left"))
    one.tick()
    (status,) = one.got["diagnostics"][-1].status
    assert (status.name, status.hardware_id) == ("left/controller: walk", "left/poppy_humanoid")
    assert status.message.startswith("waiting for joint_states")  # also before the first state


def test_publishing_of_the_robot_description_can_be_disabled(make: Any) -> None:
    """ros2_control's controller_manager uses the first description it receives."""
    one = make("controller", PAPER.updated({"node.robot_description": False}))
    assert "robot_description" not in one.got
    assert "walk_config" in one.got


@pytest.mark.parametrize("stamped", [False, True])
def test_cmd_vel_is_accepted_stamped_and_unstamped(make: Any, stamped: bool) -> None:
    one = make("controller", load("poppy").updated({"gait.steps": 0, "node.stamped_cmd_vel": stamped}))
    msg = Twist()
    msg.linear.x = 0.01
    one.send("cmd_vel", TwistStamped(twist=msg) if stamped else msg)
    assert one.node._steering._asked == (0.01, 0.0, 0.0)
    one.foreign_node("teleop").create_publisher(Twist if stamped else TwistStamped, "cmd_vel", 1)
    until(lambda: one.node.check_types() or "see node.stamped_cmd_vel" in one.log)
    kinds = [f"geometry_msgs/msg/{name}" for name in ("Twist", "TwistStamped")]
    own, other = kinds[stamped], kinds[not stamped]
    assert f" with {other} uses /cmd_vel, which is a {own} here; see node.stamped_cmd_vel" in one.log


def test_quality_of_service_can_be_overridden(make: Any) -> None:
    override = "qos_overrides./joint_states.subscription.reliability:=reliable"
    one = make("controller", PAPER, ros=("-p", override))
    (found,) = (s for s in one.node.subscriptions if s.topic_name == "/joint_states")
    assert found.qos_profile.reliability is ReliabilityPolicy.RELIABLE


def test_a_walk_waits_until_everything_that_accompanies_it_is_recorded(make: Any) -> None:
    """The recorder discovers odom and /tf, which not every robot has, later than the topics of the walk."""
    one = make("controller", PAPER.updated({"node.wait_for_recorder": True}))
    recorder = one.beside("recorder")
    late = [end for end in one.node.publishers if end.topic_name in ("/odom", "/tf", "/tf_static", "/footstep_status")]
    own = {"/parameter_events", "/phase", "/rosout"}
    walk = [end for end in one.node.publishers if end not in late and end.topic_name not in own]
    assert late
    for ends in (walk, late):
        assert not one.node.is_recorded()
        for end in ends:
            recorder.create_subscription(end.msg_type, end.topic_name, lambda _: None, 10)
        until(lambda ends=ends: all(ros.is_heard_by(one.node, end, "recorder") for end in ends))
    assert one.node.is_recorded()


def test_a_real_time_plant_waits_for_the_recorder(make: Any) -> None:
    """As in lockstep; otherwise the first states and commands are not recorded."""
    one = make("integrator", PAPER.updated({"node.wait_for_recorder": True}))
    (period, *_) = [t for t in one.node.timers if t.timer_period_ns == round(DT * 1e9)]
    period.callback()
    assert not one.got["joint_states"]
    recorder = one.beside("recorder")
    for kind, topic in ((JointState, "joint_states"), (String, "plant_warning"), (DiagnosticArray, "/diagnostics")):
        recorder.create_subscription(kind, topic, lambda _: None, 10)
    until(lambda: period.callback() or one.got["joint_states"])
    assert one.got["joint_states"]


def test_the_output_of_param_dump_is_a_valid_configuration() -> None:
    text = to_yaml(PAPER) + "    use_sim_time: false\n    start_type_description_service: true\n"
    assert from_yaml(text) == PAPER


@pytest.mark.parametrize(("space", "shown"), [("left", "7 iterations"), ("right", "")])
def test_the_viewer_shows_the_solver_of_its_own_robot(make: Any, space: str, shown: str) -> None:
    one = make("viewer", PAPER, "--port", "0", ros=("-r", "__ns:=/left"))
    values = [KeyValue(key="iterations", value="7"), KeyValue(key="solve time", value="1e-4")]
    status = DiagnosticStatus(name=f"{space}/controller: walk", values=values)
    one.send("/diagnostics", DiagnosticArray(status=[status]))
    one.node.close()
    assert one.node._solver.startswith(shown)
    assert bool(one.node._solver) == bool(shown)


def test_the_monitor_uses_the_measured_vertical(make: Any) -> None:
    """The newest one before a state; one that is old or cannot be read is not used."""
    phases = make("phase_monitor", PAPER)
    for k in range(1, 40):
        tilted = Inertial(np.array([np.cos(0.01 * k), np.sin(0.01 * k), 0.0, 0.0]), np.zeros(3), np.zeros(3))
        phases.send("imu", serialize_message(ros.imu(k * 10**9, "imu", tilted)))
    phases.send("imu", b"short")
    log = phases.node._phases
    assert log.up(0) is None
    np.testing.assert_allclose(log.up(7 * 10**9 + 1000), [0.0, np.sin(0.14), np.cos(0.14)], atol=1e-12)
    np.testing.assert_allclose(log.up(7 * 10**9 + 2000), [0.0, np.sin(0.14), np.cos(0.14)], atol=1e-12)
    assert log.up(7 * 10**9 + 6 * 10**8) is None
    log._forget_after(7 * 10**9)
    assert log.up(8 * 10**9) is None


def test_margins_of_the_monitor_are_along_the_measured_vertical(make: Any) -> None:
    walk, monitor = make("controller", PAPER), make("phase_monitor", PAPER)
    walk.send("joint_states", state(NAMES, ZERO, 1.0))
    monitor.follow(walk)
    margins = []
    for k, angle in enumerate((0.0, 0.04)):
        tilted = Inertial(np.array([np.cos(0.5 * angle), 0.0, np.sin(0.5 * angle), 0.0]), np.zeros(3), np.zeros(3))
        monitor.send("imu", serialize_message(ros.imu((k + 1) * 10**9, "imu", tilted)))
        monitor.send("joint_states", serialize_message(state(NAMES, ZERO, 1.0 + k)))
        values = {pair.key: pair.value for pair in monitor.got["diagnostics"][-1].status[0].values}
        margins.append(float(values["margin/polygon"]))
    kin = Kinematics(MODEL, ZERO, Foot.LEFT)
    assert abs(margins[0] - margins[1]) == pytest.approx(kin.com[2] * np.tan(0.04), rel=0.1)


@pytest.mark.parametrize("lockstep", [False, True])
def test_states_that_arrive_before_the_walk_is_known_are_judged(make: Any, lockstep: bool) -> None:
    """On a busy machine the first message of walk_config takes longer than hundreds of states in lockstep."""
    config = PAPER.updated({"plant.lockstep": lockstep})
    walk, monitor = make("controller", config), make("phase_monitor", config)
    walk.send("joint_states", state(NAMES, ZERO, 1.0))
    for k in range(10):
        monitor.send("joint_states", serialize_message(state(NAMES, ZERO, 1.0 + 0.2 * k)))
    monitor.follow(walk)
    monitor.node.close()
    assert [array.header.stamp.nanosec for array in monitor.got["diagnostics"]] == [
        round(1e9 * (0.2 * k % 1.0)) for k in range(10)
    ]
    assert all("double_support" in array.status[0].message for array in monitor.got["diagnostics"])


def test_states_are_judged_once_the_recorder_hears_it(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine a short walk is over before the recorder has connected to /diagnostics of the monitor."""
    walk, monitor = make("controller", PAPER), make("phase_monitor", PAPER.updated({"node.wait_for_recorder": True}))
    heard = iter([False] * 12)
    monkeypatch.setattr(monitor.node, "is_recorded", lambda: next(heard, True))
    walk.send("joint_states", state(NAMES, ZERO, 1.0))
    monitor.follow(walk)
    for k in range(10):
        monitor.send("joint_states", serialize_message(state(NAMES, ZERO, 1.0 + 0.2 * k)))
    assert not monitor.got["diagnostics"]
    monitor.node.close()
    assert len(monitor.got["diagnostics"]) == 10


def test_a_monitor_says_that_it_is_not_recorded(make: Any) -> None:
    walk, monitor = make("controller", PAPER), make("phase_monitor", PAPER.updated({"node.wait_for_recorder": True}))
    walk.send("joint_states", state(NAMES, ZERO, 1.0))
    monitor.follow(walk)
    monitor.send("joint_states", serialize_message(state(NAMES, ZERO, 1.0)))
    monitor.node.close()
    assert "1 states are not judged: no recorder has subscribed to /diagnostics" in monitor.log


@pytest.mark.parametrize("lockstep", [False, True])
def test_monitor_and_viewer_ignore_the_states_of_a_gripper(make: Any, lockstep: bool) -> None:
    """In lockstep its stamps, of another clock, are no restart of the plant."""
    config = PAPER.updated({"plant.lockstep": lockstep})
    walk, monitor = make("controller", config), make("phase_monitor", config)
    viewer = make("viewer", config, "--port", "0")
    walk.send("joint_states", state(NAMES, ZERO, 1.0))
    for one in (monitor, viewer):
        one.follow(walk)
    for k in range(100):
        other = (1e9 if lockstep else 0.9) + k * DT
        for msg in (state(NAMES, ZERO, 1.0 + k * DT), state(["finger"], [0.1], other)):
            monitor.send("joint_states", serialize_message(msg))
            viewer.send("joint_states", msg)
    viewer.node._show()
    shown = viewer.node._phase is not None
    viewer.node.close()
    monitor.node.close()
    assert shown
    assert len(monitor.got["diagnostics"]) == 5  # at 10 Hz
    assert "double_support" in monitor.got["diagnostics"][-1].status[0].message
    assert "rejected" not in monitor.log
    assert "rejected" not in viewer.log


def test_the_page_steers_a_simulated_robot_until_it_is_closed(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load("poppy_dynamic").updated({"gait.steps": 0})
    walk, viewer = make("controller", config), make("viewer", config, "--port", "0")
    page = viewer.node.page
    monkeypatch.setattr(type(page), "is_watched", True)
    viewer.node._steer()
    for topic in ("walk_config", "robot_description"):
        viewer.send(topic, walk.got[topic][-1])
    viewer.node._show()
    assert not page.steers  # a real robot is not steered by a page
    viewer.send("true_base_pose", PoseStamped())
    assert page.steers
    viewer.node._steer()
    viewer.node._on_steer(np.array([0.1, 0.0, 0.2]))
    viewer.node._steer()
    viewer.node._on_steer(np.zeros(3))  # "stop" takes effect at once, not after gait.cmd_vel_timeout
    viewer.node._steer()
    viewer.node._on_steer(np.array([0.1, 0.0, 0.2]))
    viewer.node._steer()
    monkeypatch.setattr(type(page), "is_watched", False)
    viewer.node._steer()
    viewer.node._steer()
    viewer.node.close()
    sent = [(msg.linear.x, msg.linear.y, msg.angular.z) for msg in viewer.got["cmd_vel"]]
    assert sent == 2 * [(0.1, 0.0, 0.2), (0.0, 0.0, 0.0)]  # at rest another node may steer
