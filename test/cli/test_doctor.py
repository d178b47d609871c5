"""`dqwalk doctor` reports each fault that prevents walking, and a robot without faults as ready."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from inside import state
from live import LATCHED
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

from dqwalk_ros.cli import main
from dqwalk_ros.cli.readiness import CHECKS, ByHand, examine
from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.doctor import Doctor, Heard, listen
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.base import Inertial
from dqwalk_ros.robot.directions import motion
from dqwalk_ros.robot.model import load_model

CONFIG = load("poppy").updated({"plant.imu": True})
MODEL = load_model(CONFIG.robot)
POSTURE = MODEL.posture(CONFIG.standing.posture)
UPRIGHT = Inertial(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 9.81]))
EPOCH = 1_700_000_000.0
ROOT = Path(__file__).resolve().parents[2]


def robot(
    q: np.ndarray = POSTURE, *, period: float = CONFIG.dt, age: float = 0.001, names: Any = MODEL.joint_names,
    inertial: Inertial | None = UPRIGHT, frame: str = MODEL.imu, **heard: Any,
) -> Heard:  # fmt: skip
    times = [EPOCH + k * period for k in range(100)]
    received = [round((t + age) * 1e9) for t in times]
    states = [(state(names, q, t, velocity=np.zeros(len(q))), at) for t, at in zip(times, received, strict=True)]
    imus: list[tuple[Imu, int]] = []
    if inertial is not None:
        imus = [(ros.imu(round(t * 1e9), frame, inertial), at) for t, at in zip(times, received, strict=True)]
    values = {"publishers": ("/driver",), "subscribers": ("driver",), "ready": True, "diagnosed": True, **heard}
    return Heard(1.0, **{"states": states, "imus": imus, **values})


def failed_checks(heard: Heard) -> dict[str, str]:
    return {finding.what: finding.text for finding in examine(CONFIG, MODEL, heard) if not finding.ok}


def test_a_ready_robot_passes_all_checks() -> None:
    findings = list(examine(CONFIG, MODEL, robot()))
    assert [finding.what for finding in findings] == list(CHECKS)
    assert all(finding.ok for finding in findings), failed_checks(robot())


def test_a_simulation_behind_real_time_is_no_fault() -> None:
    assert "latency" in failed_checks(robot(age=0.2))
    assert not failed_checks(robot(age=0.2, simulated=True))


def test_messages_of_two_publishers_of_the_same_joints_are_counted(domain: int) -> None:
    """Not those of a gripper, and a driver that was restarted once is none."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        node = Doctor(context)
        (heard,) = (s for s in node.subscriptions if s.topic_name == "/joint_states")
        for k in range(40):
            for names, number in ((["a", "b"], 50 + k), (["gripper"], 7 + k), (["b", "a"], k)):
                if k >= 10 or number != k:
                    heard.callback(JointState(name=names), {"publication_sequence_number": number})
        assert node.heard.backs == 30
        assert len(node.heard.states) == 110
    finally:
        context.try_shutdown()


@pytest.mark.parametrize("phase", ["idle", "finished", "failed", "fallen"])
def test_a_controller_without_a_walk_is_no_fault(phase: str) -> None:
    assert not failed_checks(robot(phase=phase, controllers=("/controller",)))


def test_silence_on_diagnostics_is_not_the_absence_of_errors() -> None:
    (found,) = (f for f in examine(CONFIG, MODEL, robot(diagnosed=False)) if f.what == "/diagnostics")
    assert "not heard" in found.text


def test_stamps_that_do_not_advance_have_no_latency() -> None:
    heard = robot(simulated=True)
    unstamped = [(state(MODEL.joint_names, POSTURE, 0.0), at) for _, at in heard.states]
    found = failed_checks(replace(heard, states=unstamped))
    assert "header.stamp" in found["latency"]
    assert "only 1 different stamps" in found["rate"]


def test_the_latency_of_simulated_time_is_unknown() -> None:
    latency = next(f for f in examine(CONFIG, MODEL, robot(age=EPOCH, simulated=True)) if f.what == "latency")
    assert latency.ok
    assert latency.text.startswith("unknown: the stamps of the simulation")


@pytest.mark.parametrize(
    ("axis", "sign", "expected"),
    [
        (1, 1.0, "(ahead 8.0,"),
        (1, -1.0, "(back 8.0,"),
        (0, 1.0, "right 8.0)"),
        (0, -1.0, "left 8.0)"),
    ],
)
def test_the_direction_in_which_a_robot_is_leaned_is_said(axis: int, sign: float, expected: str) -> None:
    """Whoever leans it by hand sees whether the sensor is mounted as its link says."""
    (found,) = (
        f for f in examine(CONFIG, MODEL, robot(inertial=leaning(axis, sign * 8.0))) if f.what[:8] == "inertial"
    )
    assert expected in found.text
    assert found.ok
    inverse = replace(leaning(axis, sign * 8.0), orientation=leaning(axis, -sign * 8.0).orientation)
    assert "points 16 deg away from the vertical" in failed_checks(robot(inertial=inverse))["inertial sensor"]


@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (-1.0, True), (0.0, True), (57.3, True)])
def test_the_gyroscope_of_a_robot_that_is_leaned_is_compared_with_its_vertical(factor: float, named: bool) -> None:
    heard, imus = robot(), []
    for k, (msg, at) in enumerate(heard.imus):
        felt = leaning(1, 9.0 * k / len(heard.imus))
        rate = math.radians(9.0) / (len(heard.imus) * CONFIG.dt) * np.array([0.0, factor, 0.0])
        imus.append((ros.imu(ros.nanoseconds(msg.header.stamp), MODEL.imu, replace(felt, gyro=rate)), at))
    imus[-1] = (ros.imu(ros.nanoseconds(imus[-1][0].header.stamp), MODEL.imu, felt), at)  # it has come to rest
    found = failed_checks(replace(heard, imus=imus)).get("inertial sensor", "")
    assert ("it was leaned by 9 deg, and its gyroscope is" in found) is named, found


def leaning(axis: int, degrees: float) -> Inertial:
    """Return what a sensor with the axes of the pelvis measures on a robot that leans about one of them."""
    half = math.radians(0.5 * degrees)
    x = DQ(np.array([math.cos(half), *(math.sin(half) * np.eye(3)[axis])]))
    up = x.conj().rotation_matrix() @ [0.0, 0.0, 9.81]
    return Inertial(x.vec4(), np.zeros(3), up)


@pytest.mark.parametrize(
    ("plant", "change", "reason"),
    [
        ("poppy", "poppy.calibration=[l_hipy=2.0]", "no motor moves 'l_hipy'; the joints are "),
        ("poppy", "poppy.calibration=['l_hip_y=2,0']", "has 'l_hip_y=2,0'; it must be JOINT=DEGREES"),
        ("poppy", "poppy.calibration=[l_hip_y=2, l_hip_y=3]", "l_hip_y is given twice"),
        ("poppy", "poppy.motors=nowhere", "no table of motors 'nowhere'"),
        ("poppy", "poppy.rate=20", "the motors answer every 0.05 s"),
        ("poppy", "plant.lockstep=true", "a robot does not wait for its command"),
        ("ros2_control", "output.joints=[l_hip_x]", "'output.joints' lacks l_hip_z"),
        ("ros2_control", f"output.joints=[{', '.join(MODEL.joint_names)}, l_hip_x]", "names a joint twice"),
        (
            "ros2_control",
            "output.type=joint_trajectory; output.interface=velocity",
            "needs 'output.interface' position",
        ),
    ],
)
def test_what_the_node_of_a_robot_would_refuse_is_found_without_the_robot(
    plant: str, change: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = [word for one in change.split("; ") for word in ("--set", one)]
    assert main(["doctor", "--offline", "--plant", plant, *changes]) == 2
    assert reason in capsys.readouterr().err


SHIPPED = ROOT / "config/ros2_control/controllers.yaml"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("", "", ""),
        (
            "l_hip_x, l_hip_z,",
            "l_hip_z, l_hip_x,",
            "has its joints in another order: set output.joints to [l_hip_z, l_hip_x",
        ),
        ("r_ankle_y, abs_y,", "r_ankle_y,", "forward_position_controller lacks abs_y of output.joints"),
        ("interface_name: position", "interface_name: velocity", "takes velocity, not position"),
        ("update_rate: 200", "update_rate: 100", "updates at 100 Hz, and dt is 0.005: set it to 0.01"),
        ("frame_id: pelvis", "frame_id: imu_link", "in the frame 'imu_link', and robot.imu is 'pelvis'"),
        (
            "/**/forward_position_controller:",
            "/**/legs:",
            "no 'forward_position_controller', whose topic is output.topic",
        ),
        ("update_rate: 200", "update_rate: {", "not YAML"),
    ],
)
def test_the_parameters_of_the_controllers_are_compared(
    old: str, new: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the robot is there; `drive` asks the controllers themselves."""
    file = tmp_path / "controllers.yaml"
    file.write_text(SHIPPED.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    words = ["doctor", "--offline", "--plant", "ros2_control", "--controllers", str(file)]
    assert main(words) == (2 if expected == "not YAML" else int(bool(expected)))
    said = capsys.readouterr()
    assert expected in said.out + said.err
    assert ("fits the robot" in said.out) == (not expected)


def test_joints_that_are_moved_by_hand_are_named_with_the_direction_of_the_model() -> None:
    """Each once; a joint of another sign or name is not noticed by any other check, and the robot falls."""
    shown: list[str] = []
    moved, heard = ByHand(MODEL, shown.append), robot()
    assert not moved(heard)
    q = POSTURE.copy()
    for name, turn in (("l_knee_y", 0.3), ("r_hip_z", -0.3), ("l_knee_y", -0.3), ("r_ankle_y", -0.2), ("abs_y", 0.1)):
        q[MODEL.joint_names.index(name)] += turn
        heard.states.append((state(MODEL.joint_names, q, EPOCH + 5.0), 0))
        moved(heard)
    assert [" ".join(text.split()) for text in shown] == [
        "l_knee_y +0.30 rad: l_shin moved back",
        "r_hip_z -0.30 rad: r_hip_motor turned right",
        "r_ankle_y -0.20 rad: r_foot moved up",
    ]
    heard.states.append((state(MODEL.joint_names, POSTURE + 0.2, EPOCH + 6.0), 0))
    assert moved(heard)
    assert not moved.left


def test_what_was_not_moved_by_hand_is_listed_also_after_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_: float, __: str, enough: Callable[[Heard], bool]) -> None:
        q = POSTURE + 0.3 * (np.array(MODEL.joint_names) != "abs_z")
        enough(robot())
        enough(replace(robot(), states=[*robot().states, (state(MODEL.joint_names, q, EPOCH + 5.0), 0)]))
        raise KeyboardInterrupt

    monkeypatch.setattr("dqwalk_ros.nodes.doctor.listen", interrupted)
    assert main(["doctor", "--by-hand"]) == 1
    out = capsys.readouterr().out
    assert "! not moved: abs_z\n" in out
    assert "no joint_states" not in out


@pytest.mark.parametrize("joint", MODEL.joint_names)
def test_the_direction_of_a_joint_is_that_of_its_kinematics(joint: str) -> None:
    """What hangs on a joint of a leg moves as its sole does."""
    k = MODEL.joint_names.index(joint)
    words = motion(MODEL, POSTURE, k, 1.0), motion(MODEL, POSTURE, k, -1.0)
    assert words[0] != words[1]
    if not joint.startswith("l_") or "turned" in words[0]:
        return
    at = (POSTURE + turn * np.eye(MODEL.n)[k] for turn in (1e-3, -1e-3))
    ahead, back = (DQ(Kinematics(MODEL, q, Foot.LEFT).pose(MODEL.pelvis)).conj().translation() for q in at)
    of_sole = ahead - back
    axis = int(np.abs(of_sole).argmax())
    word = ("ahead", "back") if axis == 0 else ("left", "right") if axis == 1 else ("up", "down")
    assert word[int(of_sole[axis] < 0.0)] in words[0]


def test_the_states_of_a_gripper_are_ignored() -> None:
    heard = robot()
    fingers = [(state(["finger"], [0.1], EPOCH + 0.003 * k), round((EPOCH + 1.0) * 1e9)) for k in range(300)]
    assert not failed_checks(replace(heard, states=[*heard.states, *fingers]))


def bent(joint: str, angle: float) -> np.ndarray:
    q = POSTURE.copy()
    q[MODEL.joint_names.index(joint)] += angle
    return q


def swaying(joint: str) -> Heard:
    heard = robot()
    angles = enumerate(np.linspace(0.1, 0.0, len(heard.states)))
    states = [(state(MODEL.joint_names, bent(joint, x), EPOCH + k * CONFIG.dt), heard.states[k][1]) for k, x in angles]
    return replace(heard, states=states)


def halves() -> Heard:
    heard, names = robot(), MODEL.joint_names
    parts = [names[k::2] for k in range(2)]
    states = [
        (state(parts[k % 2], np.zeros(len(parts[k % 2])), EPOCH + k * CONFIG.dt), at)
        for k, (_, at) in enumerate(heard.states)
    ]
    return replace(heard, states=states)


def few_imus(every: int) -> Heard:
    heard = robot()
    return replace(heard, imus=heard.imus[::every])


FAULTS: dict[str, tuple[Callable[[], Heard], str, str]] = {
    "silent": (lambda: robot(states=[], publishers=()), "states", "start the driver"),
    "two drivers": (lambda: robot(backs=90, publishers=("/a", "/b")), "states", "/a and /b publish the same joints"),
    "another robot": (lambda: robot(names=["x", *MODEL.joint_names[1:]]), "joints", "joints missing: l_hip_x"),
    "legs apart": (lambda: halves(), "joints", "; other messages have them, but one must have all: name the joints"),
    "slow": (lambda: robot(period=0.02), "rate", "set dt to 0.02 in a file for --params and params:="),
    "clocks": (lambda: robot(age=-3.0), "latency", "chrony"),
    "slow imu": (lambda: few_imus(15), "inertial sensor", "it measures every 0.075 s: its rate must be 20 Hz"),
    "one imu message": (lambda: few_imus(1000), "inertial sensor", "all its messages have one stamp"),
    "late": (lambda: robot(age=0.03), "latency", "set servo.assumed_latency in a file for --params"),
    "phase not heard": (lambda: robot(unheard={"phase": ("/controller",)}), "rest", "not heard: /controller publishes"),
    "plant_ready not heard": (
        lambda: robot(ready=None, unheard={"plant_ready": ("/driver",)}),
        "plant",
        "not heard: /driver publishes plant_ready",
    ),
    "in mid-walk": (lambda: robot(phase="single_support/left"), "rest", "end it (~/stop"),
    "commanded": (lambda: robot(moving=True, controllers=("/pilot",)), "rest", "/pilot publishes"),
    "in motion": (lambda: swaying("l_hip_y"), "rest", "l_hip_y moved by 0.10 rad"),
    "limit": (lambda: robot(bent("l_knee_y", -1.0)), "limits", "l_knee_y by"),
    "calibration": (lambda: robot(bent("r_ankle_y", 0.1)), "soles", "calibrate the legs"),
    "arms up": (lambda: robot(bent("abs_z", 0.5)), "first pose", "abs_z is furthest"),
    "no imu": (lambda: robot(inertial=None), "inertial sensor", "nothing on imu"),
    "imu elsewhere": (lambda: robot(frame="camera"), "inertial sensor", "they must agree"),
    "imu askew": (
        lambda: robot(inertial=leaning(0, 28.6)),
        "inertial sensor",
        "mounted askew",
    ),
    "imu in g": (
        lambda: robot(inertial=Inertial(UPRIGHT.orientation, np.zeros(3), np.array([0.0, 0.0, 1.0]))),
        "inertial sensor",
        "check its units",
    ),
    "no subscriber": (lambda: robot(subscribers=()), "commands", "start poppy_driver"),
    "limp": (lambda: robot(ready=False), "plant", "~/activate"),
    "other joints": (
        lambda: robot(ready=False, plant="c has its joints in another order"),
        "plant",
        "in another order",
    ),
    "warm": (lambda: robot(warning="l_knee_y is at 61 degC"), "plant", "~/start is refused: l_knee_y is at 61"),
    "hot": (lambda: robot(errors={"motors": "l_knee_y is 71 degC"}), "/diagnostics", "71 degC"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_reported_with_a_remedy(fault: str) -> None:
    heard, check, expected = FAULTS[fault]
    found = failed_checks(heard())
    assert expected in found[check]
    assert check == next(iter(found))  # no other check fails before it


@pytest.mark.parametrize(
    ("namespace", "name", "counts"),
    [
        ("/one", "one/controller: walk", True),
        ("/one", "/one/hands/left: motors", True),
        ("/one", "two/controller: walk", False),
        ("/one", "controller_manager: activity", True),  # diagnostic_updater leaves the namespace out
        ("/one", "imu/left: rate", True),  # no namespace
        ("/one", "one_more/controller: walk", False),
        ("/", "two/controller: walk", True),  # which may be a part of this robot
    ],
)
def test_errors_of_another_robot_do_not_count(namespace: str, name: str, counts: bool) -> None:
    heard = Heard(1.0)
    nodes = [("controller", f"/{one}") for one in ("one", "two", "one_more")]
    doctor: Any = SimpleNamespace(
        heard=heard, get_namespace=lambda: namespace, get_node_names_and_namespaces=lambda: [("doctor", "/"), *nodes]
    )
    doctor._is_of_another = partial(Doctor._is_of_another, doctor)
    Doctor._on_diagnostics(doctor, DiagnosticArray(status=[DiagnosticStatus(level=b"\x02", name=name, message="bad")]))
    assert heard.errors == ({name: "bad"} if counts else {})
    assert heard.diagnosed is counts


def test_a_ros_that_does_not_start_is_an_error_in_one_line(monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    """Such as without a folder for its log, or without keys where security is enabled."""

    def refuse(**_: Any) -> None:
        raise RuntimeError("failed to initialize logging: no folder, at logging.cpp:154\nmore")

    monkeypatch.setattr(rclpy, "init", refuse)
    for secured, expected in (("false", "logging.cpp:154\n"), ("true", "the keys of this node")):
        monkeypatch.setenv("ROS_SECURITY_ENABLE", secured)
        assert main(["doctor", "--plant", "poppy"]) == 2
        error = capfd.readouterr().err
        assert "dqwalk: failed to initialize logging: no folder, at" in error
        assert expected in error
        assert "Traceback" not in error


@pytest.mark.parametrize("late", [True, False], ids=["late", "never"])
def test_a_phase_that_is_published_is_waited_for(domain: int, monkeypatch: pytest.MonkeyPatch, late: bool) -> None:
    """No walk is under way if its controller says so, and not if nothing was heard from it."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setattr("dqwalk_ros.nodes.doctor._DISCOVERY", 1.0)
    monkeypatch.setattr("dqwalk_ros.nodes.doctor._LATCHED", 60.0 if late else 0.2)
    context, over = Context(), threading.Event()
    rclpy.init(context=context, domain_id=domain)
    walk = Node("controller", context=context)
    states = walk.create_publisher(JointState, "joint_states", 1)
    phase = walk.create_publisher(String, "phase", LATCHED)
    began: list[float] = []

    def publish() -> None:
        while not over.wait(0.02):
            states.publish(state(MODEL.joint_names, POSTURE, 1.0))
            if states.get_subscription_count() and not began:
                began.append(time.monotonic())
            if late and began and time.monotonic() > began[0] + 2.0:  # the time to listen is over then
                phase.publish(String(data="single_support/left"))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        heard = listen(0.5)
    finally:
        over.set()
        thread.join()
        context.try_shutdown()
    assert heard.phase == ("single_support/left" if late else "")
    assert heard.unheard == ({} if late else {"phase": ("/controller",)})


@pytest.mark.long
def test_doctor_with_live_nodes(nodes: Any, domain: int, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    # at 20 Hz, because a walk ends where a busy machine misses most of its states
    arguments = ["doctor", "--plant", "integrator", "--seconds", "1", "--set", "plant.imu=false", "--set", "dt=0.05"]
    with monkeypatch.context() as shorter:
        shorter.setattr("dqwalk_ros.nodes.doctor._DISCOVERY", 1.0)
        assert main(arguments) == 1
    output = capfd.readouterr().out
    assert "start the driver" in output
    assert output.endswith("failed; repair the first one first\n")
    long_phase = {"standing.transfer_duration": 60.0, "gait.phase_timeout": 900.0}  # longer than doctor listens
    live = nodes(CONFIG.updated({"plant.imu": False, "dt": 0.05, **long_phase}))
    live.start("integrator")
    live.until(lambda: len(live.got["joint_states"]) > 20, 60.0, "states")
    main(arguments)
    output = capfd.readouterr().out
    assert "  joints                 all 15" in output
    assert "  soles  " in output
    assert "  commands               integrator" in output
    assert "no walk is under way" in output
    live.start("controller")
    live.until(lambda: live.phase.startswith("double_support"), 120.0, "a walk")
    assert main(arguments) == 1
    assert "! rest                   a walk is under way, phase is 'double_support" in capfd.readouterr().out
