"""Any robot's drive: what the walk commands, as a robot's own controllers take it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

from inside import inside, state
from ros2_control import EXTRA, ControllerManager
from std_msgs.msg import Bool, Float64MultiArray

from dqwalk_ros.cli.options import overlaid
from dqwalk_ros.config import load
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.robot import load_model
from dqwalk_ros.simulation import make_plant

POPPY = overlaid(load("poppy"), "ros2_control")
MODEL = load_model(POPPY.robot)
NAMES = MODEL.joint_names
POSTURE = MODEL.posture(POPPY.standing.posture)
DT = POPPY.dt
TOPIC = {kind: f"forward_{kind}_controller/commands" for kind in ("position", "velocity")}


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with inside(tmp_path) as made:
        yield made


# ---------------------------------------------------------------------- walks


def stands(make: Any, rate: float, interface: str, steps: int) -> None:
    """Walk behind the controllers of ros2_control, and see that the robot stands on its feet at the end."""
    dt = 1.0 / rate
    joints = (*EXTRA, *reversed(NAMES))
    values: dict[str, Any] = {"dt": dt, "gait.steps": steps, "servo.assumed_rate": rate, "servo.assumed_latency": dt}
    values |= {"output.interface": interface, "output.joints": joints}
    values |= {"plant.command_timeout": 2.0, "node.autostart": True}
    config = POPPY.updated(values)
    robot = ControllerManager(make_plant("physics", config, MODEL), interface, joints, MODEL.imu, rate)
    began = {foot: DQ(x).translation()[0] for foot, x in robot.plant.truth.soles.items()}
    controller, drive = make("controller", config), make("drive", config)
    controller.hand("plant_ready", Bool(data=True))
    told, answers = drive.got[TOPIC[interface]], controller.got["joint_velocity_commands"]
    while controller.node._mode.value == "walking" and not robot.plant.fallen:
        measured, imu = robot.update()
        drive.hand("joint_states", measured)
        controller.hand("imu", imu)
        controller.hand("joint_states", measured)
        for answer in answers:
            drive.hand("joint_velocity_commands", answer)
        for message in told:
            robot.on_commands(message)
        answers.clear()
        told.clear()
    assert controller.node._mode.value == "finished", (controller.node._problem, robot.updates * dt)
    assert not robot.plant.fallen
    for foot, x in robot.plant.truth.soles.items():
        assert DQ(x).translation()[0] - began[foot] == pytest.approx(steps * config.gait.step_length, rel=0.2), foot


def test_the_walk_stands_behind_ros2_control(make: Any) -> None:
    stands(make, 50.0, "velocity", 1)


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("interface", ["position", "velocity"])
@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0, 500.0])
def test_ten_steps_behind_ros2_control(make: Any, rate: float, interface: str) -> None:
    stands(make, rate, interface, 10)


# ---------------------------------------------------------------------- what it tells


def measured(q: Any, stamp: float = 1.0) -> Any:
    return state((*NAMES, *EXTRA), [*q, 0.3, 0.4], stamp)


def command(stamp: float = 1.0, speed: float = 0.0) -> Any:
    return state(NAMES, [], stamp, velocity=np.full(MODEL.n, speed))


def test_nothing_is_told_before_the_first_command(make: Any) -> None:
    """The walk waits until the output topic has a subscriber."""
    one = make("drive", POPPY)
    one.hand("joint_velocity_commands", command())
    one.hand("joint_states", measured(POSTURE))
    one.tick()
    assert not one.got[TOPIC["position"]]
    assert [msg.data for msg in one.got["plant_ready"]] == [False]
    assert "no node subscribes to /forward_position_controller/commands" in one.got["diagnostics"][-1].status[0].message
    robot = one.stranger("controller_manager")
    robot.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    deadline = time.monotonic() + 20.0
    while len(one.got["plant_ready"]) < 2 and time.monotonic() < deadline:
        one.tick()
        time.sleep(0.01)
    assert one.got["plant_ready"][-1].data


@pytest.mark.parametrize("kind", ["float64_multi_array", "joint_trajectory", "joint_state"])
def test_positions_are_integrated_in_the_order_of_the_controller(make: Any, kind: str) -> None:
    joints = (EXTRA[1], *reversed(NAMES))
    one = make("drive", POPPY.updated({"output.type": kind, "output.joints": joints, "output.topic": "told"}))
    for k in range(3):
        one.hand("joint_states", measured(POSTURE, 1.0 + k * DT))
        one.hand("joint_velocity_commands", command(1.0 + k * DT, 0.1))
    last = one.got["told"][-1]
    told = {
        "float64_multi_array": lambda: last.data,
        "joint_trajectory": lambda: last.points[0].positions,
        "joint_state": lambda: last.position,
    }[kind]()
    assert told[0] == 0.4  # the camera stays
    np.testing.assert_allclose(told[1:], POSTURE[::-1] + 3 * DT * 0.1, atol=1e-12)
    if kind == "joint_trajectory":
        assert last.joint_names == list(joints)
        assert last.points[0].time_from_start.nanosec == round(DT * 1e9)


def test_a_position_stays_close_to_what_is_measured(make: Any) -> None:
    one = make("drive", POPPY)
    for k in range(200):
        one.hand("joint_states", measured(POSTURE, 1.0 + k * DT))  # it does not move
        one.hand("joint_velocity_commands", command(1.0 + k * DT, 0.5))
    told = np.array(one.got[TOPIC["position"]][-1].data)
    np.testing.assert_allclose(told - POSTURE, POPPY.servo.window, atol=1e-12)


def test_velocities_reach_the_same_places_and_no_joint_is_told_more_than_it_can(make: Any) -> None:
    """Torques are fed forward as angles, which a joint reaches no faster than its limit."""
    torques = np.full(MODEL.n, 3.0)  # 0.05 rad, ten times as far as a joint moves in a period
    told = {}
    for interface in TOPIC:
        one = make("drive", POPPY.updated({"output.interface": interface}))
        for k in range(30):
            one.hand("joint_states", measured(POSTURE, 1.0 + k * DT))
            msg = command(1.0 + k * DT, 0.1)
            msg.effort = torques.tolist()
            one.hand("joint_velocity_commands", msg)
        told[interface] = np.array([msg.data for msg in one.got[TOPIC[interface]]])
    assert (np.abs(told["velocity"]) <= MODEL.velocity_max + 1e-12).all()
    np.testing.assert_allclose(POSTURE + DT * told["velocity"].sum(axis=0), told["position"][-1], atol=1e-9)


# ---------------------------------------------------------------------- what ends the motion


@pytest.mark.parametrize("interface", list(TOPIC))
def test_a_robot_whose_controller_is_gone_is_told_to_stay(make: Any, interface: str) -> None:
    """Within 0.2 s: the silence that counts, and a look. The robot's own controllers would go on for ever."""
    one = make("drive", POPPY.updated({"output.interface": interface}))
    now = [0.0]
    one.node._commands.gate.watchdog._clock = lambda: now[0]
    told = one.got[TOPIC[interface]]
    look = min(one.node.timers, key=lambda timer: timer.timer_period_ns)
    for k in range(20):
        now[0] += DT
        one.hand("joint_states", measured(POSTURE, 1.0 + k * DT))
        one.hand("joint_velocity_commands", command(1.0 + k * DT, 0.2))
    before, killed = len(told), now[0]
    while len(told) == before:
        now[0] += 1e-9 * look.timer_period_ns
        one.hand("joint_states", measured(POSTURE, now[0] + 1.0))
        look.callback()
    assert now[0] - killed <= 0.2
    if interface == "velocity":
        assert not any(told[-1].data)
    else:
        assert told[-1].data == told[before - 1].data
    look.callback()
    assert len(told) == before + 2  # again, for a message may be lost
    assert "holding still: no command for 0.1 s" in one.log


def test_its_end_stops_the_robot(make: Any) -> None:
    one = make("drive", POPPY.updated({"output.interface": "velocity"}))
    one.hand("joint_states", measured(POSTURE))
    one.hand("joint_velocity_commands", command(speed=0.2))
    assert any(one.got[TOPIC["velocity"]][-1].data)
    one.node.close()
    assert not any(one.got[TOPIC["velocity"]][-1].data)


@pytest.mark.long
def test_the_controller_is_killed_as_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind a forward controller that goes on with its last command for ever; prints how long it moved on."""
    import signal

    from live import Live

    from dqwalk_ros.runner import private_domain

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    config = load("paper").updated({"dt": 0.02, "output.interface": "velocity"})
    names = load_model(config.robot).joint_names
    with private_domain() as domain:
        live = Live(tmp_path, domain, config)
        q, told, at = np.zeros(len(names)), [np.zeros(len(names))], [0.0]

        def take(msg: Float64MultiArray) -> None:
            told[0], at[0] = np.array(msg.data), time.monotonic()

        def update() -> None:
            q[:] += 0.02 * told[0]
            live.publish_state(list(names), q, time.time())

        try:
            live.node.create_subscription(Float64MultiArray, TOPIC["velocity"], take, 1)
            live.node.create_timer(0.02, update)
            live.start("drive")
            live.start("controller")
            live.until(lambda: np.abs(told[0]).max() > 1e-3, 120.0, "motion")
            live.spin(2.0)
            live.processes.signal("controller", signal.SIGKILL)
            killed, before = time.monotonic(), q.copy()
            live.until(lambda: not told[0].any(), 20.0, "the end of the motion")
            print(f"motion ended {at[0] - killed:.3f} s after the kill, {np.abs(q - before).max():.4f} rad further")
            live.spin(1.0)
            assert not told[0].any()
            assert live.processes.exit_code("drive") is None
        finally:
            live.close()


# ---------------------------------------------------------------------- what it refuses


def test_an_angle_that_is_not_known_moves_nothing(make: Any) -> None:
    """Neither a joint of the walk, nor one that must be told where to stay."""
    one = make("drive", POPPY.updated({"output.joints": (*NAMES, "gripper")}))
    one.hand("joint_states", measured(POSTURE))
    one.hand("joint_velocity_commands", command(speed=0.2))
    assert not one.got[TOPIC["position"]]
    assert "joints missing: gripper" in one.log


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"output.joints": NAMES[1:]}, f"lacks {NAMES[0]}, which the walk moves"),
        ({"output.joints": (*NAMES, NAMES[0])}, "names a joint twice"),
        ({"output.type": "joint_trajectory", "output.interface": "velocity"}, "needs 'output.interface' position"),
        ({"plant.lockstep": True}, "a robot does not wait"),
    ],
)
def test_an_output_that_cannot_be_is_an_error(make: Any, values: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        make("drive", POPPY.updated(values))
