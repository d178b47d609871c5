"""The physics plant as a real process over DDS: the same walk as in one process, and its further topics."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped, Twist, WrenchStamped
from live import Live
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, JointState

from dqwalk_ros import report as reporting
from dqwalk_ros.cli.runner import run_walk
from dqwalk_ros.config import load, overlaid
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.steering import Steering
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.topics import TOPICS
from dqwalk_ros.walks.table import make_controller

CONFIG = overlaid(load("poppy"), "physics")
PAPER = load("paper")
DEEP = QoSProfile(depth=10_000)
pytestmark = pytest.mark.xdist_group("physics_nodes")


def listen(live: Live, kind: Any, topic: str) -> dict[int, Any]:
    """Return a dictionary that collects the messages of a topic by stamp [ns]."""
    got: dict[int, Any] = {}
    live.node.create_subscription(kind, topic, lambda m: got.__setitem__(ros.nanoseconds(m.header.stamp), m), DEEP)
    return got


def test_a_physics_walk_in_lockstep_equals_that_of_one_process(nodes: Any) -> None:
    # more steps than are compared, and the nodes wait for this one: the result does not depend on the load
    values = {"plant.lockstep": True, "gait.steps": 100, "node.wait_for_recorder": True}
    live = nodes(CONFIG.updated(values), name="recorder")
    for topic in TOPICS.values():  # as a recorder does
        profile = ros.latched(topic.depth) if topic.latched else DEEP
        live.node.create_subscription(ros.message_type(topic.type), topic.name, lambda _: None, profile)
    live.node.create_subscription(Odometry, "odom", lambda _: None, DEEP)
    states, commands = listen(live, JointState, "joint_states"), listen(live, JointState, "joint_velocity_commands")
    imus, bases = listen(live, Imu, "imu"), listen(live, PoseStamped, "true_base_pose")
    pressures = listen(live, PointStamped, "center_of_pressure")
    wrenches: dict[Foot, dict[int, WrenchStamped]] = {foot: {} for foot in Foot}
    largest = [0.0]  # load of both feet so far [N], kept on arrival: thousands of states arrive until the push

    def add_wrench(foot: Foot, msg: WrenchStamped) -> None:
        at = ros.nanoseconds(msg.header.stamp)
        wrenches[foot][at] = msg
        largest[0] = max(largest[0], sum(got[at].wrench.force.z for got in wrenches.values() if at in got))

    for foot in Foot:
        topic = f"{foot.value}_foot_wrench"
        live.node.create_subscription(WrenchStamped, topic, partial(add_wrench, foot), DEEP)
    live.start("physics")
    live.start("controller")
    live.until(lambda: len(commands) > 320, 120.0, "320 ticks")
    pushes = live.offer(WrenchStamped, "push", "physics")
    push = WrenchStamped()
    push.wrench.force.z = float("nan")
    pushes.publish(push)
    live.until(lambda: "push rejected" in live.processes.log("physics"), 20.0, "the rejection")

    weight = 9.81 * load_model(live.config.robot).mass
    assert largest[0] < 1.4 * weight
    push.wrench.force.z = -4.0  # 40 N for 0.1 s: visible in every part of a step
    pushes.publish(push)
    live.until(lambda: largest[0] > 1.5 * weight, 60.0, "the push in the contact forces")
    assert "pushed: 0, 0, -4 N s" in live.processes.log("physics")
    live.processes.stop()
    config = live.config
    model = load_model(config.robot)
    controller, plant = make_controller(config, model), make_plant("physics", config, model)
    compared = 0
    for tick in range(300):  # the first single support begins at 300
        stamp = round(tick * config.dt * 1e9)
        state, truth = plant.state, plant.truth
        command = controller.step(state, config.dt)
        if stamp in states and stamp in commands:  # the first may precede the subscription
            compared += 1
            np.testing.assert_allclose(states[stamp].position, state.q, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(commands[stamp].velocity, command.velocity, rtol=0.0, atol=1e-9)
            np.testing.assert_allclose(commands[stamp].effort, command.effort, rtol=0.0, atol=1e-9)
        if tick % 20 == 0 and all(stamp in got for got in (imus, bases, pressures, *wrenches.values())):
            up, gyro, _ = ros.inertial_of(imus[stamp])
            np.testing.assert_allclose(up, state.up, atol=1e-9)
            np.testing.assert_allclose(gyro, state.gyro, atol=1e-9)
            np.testing.assert_allclose(ros.checked_pose(bases[stamp], "base_pose").vec8(), truth.pelvis, atol=1e-9)
            assert imus[stamp].linear_acceleration.z == pytest.approx(9.81, abs=1.0)
            weight = sum(wrenches[foot][stamp].wrench.force.z for foot in Foot)
            assert weight == pytest.approx(sum(w[2] for w in truth.wrenches.values()), abs=1e-9)
            assert weight == pytest.approx(9.81 * model.mass, rel=0.2)
            p = pressures[stamp].point
            np.testing.assert_allclose([p.x, p.y, p.z], truth.cop, atol=1e-9)
        plant.step(command, config.dt)
    assert compared > 250
    assert {m.header.frame_id for m in imus.values()} == {model.imu}
    assert {m.header.frame_id for m in pressures.values()} == {"world"}


def test_the_integrator_refuses_a_walk_that_waits_for_an_inertial_sensor(make: Any) -> None:
    with pytest.raises(ConfigError, match=r"plant\.imu is true, but only physics has an inertial sensor"):
        make("integrator", CONFIG.updated({"plant.name": "", "plant.imu": True}))


@pytest.mark.parametrize("dt", [0.005, 0.03, 0.07])
def test_a_push_lasts_whole_periods_and_keeps_its_impulse(make: Any, dt: float) -> None:
    one, forces = make("physics", CONFIG.updated({"dt": dt, "plant.lockstep": True})), [np.zeros(3)]
    one.node.plant.push = lambda force: forces.append(np.asarray(force))
    push = WrenchStamped()
    push.wrench.force.y = 0.5
    one.send("push", push)
    impulse = np.zeros(3)
    for _ in range(40):
        impulse += forces[-1] * dt  # the force acts until the next tick
        one.node.ticks += 1
        one.node.publish()
    assert impulse == pytest.approx([0.0, 0.5, 0.0])


def test_cmd_vel_times_out_by_the_time_of_receipt(make: Any) -> None:
    class Steered:
        def __init__(self) -> None:
            self.asked: list[tuple[float, ...]] = []

        def steer(self, *asked: float) -> tuple[float, ...]:
            self.asked.append(asked)
            return min(asked[0], 0.01), *asked[1:]

    one, controller = make("integrator", PAPER), Steered()
    steering = Steering(one.node, controller)
    msg = Twist()
    msg.linear.x, msg.linear.y, msg.angular.z = 1.0, 0.5, -0.25
    steering.apply()
    one.send("cmd_vel", msg)
    steering.apply()
    assert "steered: 0.0100 m/s forward" in one.log
    assert "limited by the reach of the legs" in one.log
    msg.linear.x = float("nan")
    one.send("cmd_vel", msg)  # is ignored
    steering.apply()
    one.clock.now += PAPER.gait.cmd_vel_timeout + 0.01
    one.send("cmd_vel", msg)  # and does not restart the timeout
    steering.apply()
    assert controller.asked == [(0.0, 0.0, 0.0), (1.0, 0.5, -0.25), (1.0, 0.5, -0.25), (0.0, 0.0, 0.0)]
    assert steering.rejected == 2
    assert "timed out" in one.log


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_physics_walk_through_ros_is_recorded_and_reported(tmp_path: Path) -> None:
    config = CONFIG.updated({"gait.steps": 2})
    model = load_model(config.robot)
    expected = simulate(make_controller(config, model), make_plant("physics", config, model))
    outcome = run_walk(config, tmp_path / "bag", plant="physics")
    assert outcome.finished, outcome.reason
    walked = bag.read(tmp_path / "bag")
    n = len(expected)
    assert 0 <= len(walked) - n <= 1
    np.testing.assert_allclose(walked.q[:n], expected.q, rtol=0.0, atol=1e-9)
    assert walked.physics is not None
    assert expected.physics is not None
    np.testing.assert_allclose(walked.physics.pelvis[:n], expected.physics.pelvis, rtol=0.0, atol=1e-9)
    assert walked.loads is not None
    assert expected.loads is not None
    np.testing.assert_allclose(walked.loads[: n - 1], expected.loads[: n - 1], rtol=0.0, atol=1e-9)
    report = reporting.report(reporting.analyse(walked))
    assert report["ok"], report["violations"]
    assert report["physics"]["steps"] == 3
    assert report["physics"]["cop_inside"] >= 0.99


@pytest.mark.long
@pytest.mark.timeout(600)
def test_cmd_vel_steers_and_its_timeout_puts_the_feet_together(nodes: Any) -> None:
    live = nodes(CONFIG.updated({"plant.lockstep": True, "gait.steps": 0}))
    twists = live.node.create_publisher(Twist, "cmd_vel", 1)
    live.start("physics")
    live.start("controller")
    live.until(lambda: "stance/left" in live.phases(), 120.0, "the first stance")
    live.spin(2.0)
    assert live.phase == "stance/left"  # no velocity is requested
    asked = Twist()
    asked.linear.x, asked.angular.z = 10.0, 0.1

    def step() -> bool:
        twists.publish(asked)
        live.spin(0.1)
        return sum(phase.startswith("single_support") for phase in live.phases()) >= 2

    live.until(step, 120.0, "two steps")
    assert "limited by the reach of the legs" in live.processes.log("controller")
    live.until(lambda: live.phase.startswith("stance"), 120.0, "the feet together")
    live.spin(2.0)
    assert live.phase.startswith("stance")
    assert "cmd_vel timed out" in live.processes.log("controller")
    assert live.call("controller/stop").success
    live.until(lambda: live.phase == "finished", 60.0, "the end")
    assert "fell at" not in live.processes.log("physics")


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_physics_walk_in_real_time_does_not_fall(tmp_path: Path) -> None:
    outcome = run_walk(CONFIG.updated({"gait.steps": 1}), tmp_path / "bag", plant="physics", lockstep=False)
    assert outcome.finished, outcome.reason
    assert "% of real time" in outcome.pace
    walked = bag.read(tmp_path / "bag")
    report = reporting.report(reporting.analyse(walked))
    assert not report["physics"]["fallen"]


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_pilot_walks_an_arc(tmp_path: Path) -> None:
    config = CONFIG.updated({"gait.steps": 0})
    outcome = run_walk(config, tmp_path / "bag", plant="physics", course=["0.0167,0,0.04,12", "-0.01,0,0,6"])
    assert outcome.finished, outcome.reason
    report = reporting.report(reporting.analyse(bag.read(tmp_path / "bag")))
    assert report["ok"], report["violations"]
    assert report["physics"]["turned"] > np.radians(15.0)
