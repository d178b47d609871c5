"""Recorder, monitor and viewer hear publishers of any quality of service."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from inside import state, until
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool, String

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.doctor import Doctor
from dqwalk_ros.nodes.wheels import numbered
from dqwalk_ros.report.bag.storage import load as load_bag
from dqwalk_ros.robot.model import load_model

CONFIG = load("poppy")
MODEL = load_model(CONFIG.robot)
PATIENCE = 60.0
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class Robot:
    """A robot that publishes states and measurements, best effort, while a node of the same process listens."""

    def __init__(self, domain: int, profile: Any, namespace: str = "") -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node("robot", context=self._context)
        self._pub = self.node.create_publisher(JointState, "joint_states", profile)
        self._imu = self.node.create_publisher(Imu, "imu", profile)
        self._k = 0

    def until(self, listener: Any, done: Callable[[], bool]) -> None:
        """Publish and let the listener spin until it has heard enough."""
        executor: Any = EventsExecutor(context=listener.context)
        executor.add_node(listener.node)
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < deadline, listener.log.lines
            self._k += 1
            stamp = 1.0 + 0.01 * self._k
            self._pub.publish(state(MODEL.joint_names, np.zeros(MODEL.n), stamp))
            msg = Imu()
            msg.header.stamp, msg.orientation.w = ros.time_msg(round(1e9 * stamp)), 1.0
            self._imu.publish(msg)
            for _ in range(5):
                executor.spin_once(timeout_sec=0.01)
        executor.remove_node(listener.node)

    def close(self) -> None:
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def robots(domain: int) -> Iterator[Callable[[Any], Robot]]:
    made: list[Robot] = []

    def start(profile: Any) -> Robot:
        made.append(Robot(domain, profile))
        return made[-1]

    yield start
    for one in made:
        one.close()


@pytest.mark.parametrize("profile", [BEST_EFFORT, QoSProfile(depth=10)], ids=["best effort", "reliable"])
def test_the_recorder_records_every_publisher(make: Any, robots: Any, profile: Any, tmp_path: Path) -> None:
    one, robot = make("recorder", CONFIG, "--bag", str(tmp_path / "bag")), robots(profile)
    counts = one.node._counts
    robot.until(one, lambda: min(counts["joint_states"], counts["imu"]) > 5)
    one.node.close()
    assert len(load_bag(tmp_path / "bag", lambda name, kind: True).columns["/imu"].raws) > 5
    assert not one.node.done.done()


@pytest.mark.parametrize("name", ["phase_monitor", "viewer"])
@pytest.mark.parametrize("lockstep", [True, False])
def test_monitor_and_viewer_hear_best_effort_publishers(make: Any, robots: Any, name: str, lockstep: bool) -> None:
    own = ["--port", "0"] if name == "viewer" else []
    one, robot = make(name, CONFIG.updated({"plant.lockstep": lockstep}), *own), robots(BEST_EFFORT)
    heard = one.node._phases
    robot.until(one, lambda: len(heard._imu) > 5)
    if name == "phase_monitor":
        robot.until(one, lambda: one.node._phases.newest > 0)


def test_the_quality_of_service_can_be_set(make: Any, tmp_path: Path) -> None:
    override = "qos_overrides./imu.subscription.reliability:=best_effort"
    for name, own in (
        ("phase_monitor", []),
        ("viewer", ["--port", "0"]),
        ("recorder", ["--bag", str(tmp_path / "bag")]),
    ):
        one = make(name, CONFIG, *own, ros=("-p", override))
        found = {s.qos_profile.reliability for s in one.node.subscriptions if s.topic_name == "/imu"}
        assert found == {ReliabilityPolicy.BEST_EFFORT}


def test_a_recorder_that_recorded_nothing_has_failed(make: Any, robots: Any, tmp_path: Path) -> None:
    one = make("recorder", CONFIG, "--bag", str(tmp_path / "bag"))
    one.node._sources = ("/driver",)
    one.node.close()
    assert "no message of joint_states was recorded, although /driver publishes it" in one.log
    assert one.node.done.result() == 1


def test_a_recorder_without_a_robot_has_not_failed(make: Any, tmp_path: Path) -> None:
    one = make("recorder", CONFIG, "--bag", str(tmp_path / "bag"))
    one.node.close()
    assert not one.node.done.done()


@pytest.mark.parametrize(
    "profile", [BEST_EFFORT, QoSProfile(depth=10), ros.latched()], ids=["sensor", "cli", "latched"]
)
def test_a_warning_is_heard_of_any_publisher_in_one_line(make: Any, domain: int, profile: Any) -> None:
    """Such as of `ros2 topic pub`, which latches nothing; a latched one was published before."""
    early = profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
    one = None if early else make("controller", CONFIG)
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    battery = Node("battery", context=context)
    try:
        publisher = battery.create_publisher(String, "plant_warning", profile)
        text = String(data="battery\n\x1b[31m at 9 %" + 10_000 * "!")
        publisher.publish(text)
        one = one or make("controller", CONFIG)
        executor: Any = EventsExecutor(context=one.context)
        executor.add_node(one.node)
        deadline = time.monotonic() + 20.0
        while not one.node._plant.warning and time.monotonic() < deadline:
            if not early:
                publisher.publish(text)
            executor.spin_once(timeout_sec=0.05)
        executor.remove_node(one.node)
        assert one.node._plant.warning.startswith("battery [31m at 9 %")
        assert len(one.node._plant.warning) == 300
    finally:
        battery.destroy_node()
        context.try_shutdown()


_PLANT = """
import rclpy
from rclpy.node import Node
from std_msgs.msg import Bool
from dqwalk_ros.nodes import messages as ros
rclpy.init(domain_id={domain})
node = Node("drive")
node.create_publisher(Bool, "plant_ready", ros.{profile}).publish(Bool(data=True))
rclpy.spin(node)
"""


@pytest.mark.parametrize("profile", ["watched()", "latched()"])
def test_the_walk_waits_while_its_plant_is_stopped_or_killed(make: Any, domain: int, profile: str) -> None:
    """If that is a plant of this package; one of another quality of service is not taken for dead."""
    one = make("controller", CONFIG)
    executor: Any = EventsExecutor(context=one.context)
    executor.add_node(one.node)
    ends = one.node.get_publishers_info_by_topic
    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        started.append(subprocess.Popen([sys.executable, "-c", _PLANT.format(domain=domain, profile=profile)]))
        until(lambda: len(ends("/plant_ready")) == len(started))

    def waits(expected: bool, least: float = 0.0) -> None:
        since = time.monotonic()

        def waiting() -> bool:
            executor.spin_once(timeout_sec=0.05)
            return time.monotonic() - since >= least and bool(one.node._plant.ready) is not expected

        until(waiting)

    mortal = profile == "watched()"
    try:
        for _ in range(2 if mortal else 1):  # the second one beside the first, which the middleware still lists
            start()
            waits(False, 0.2)
            started[-1].send_signal(signal.SIGSTOP)
            waits(mortal, 0.7)
            started[-1].send_signal(signal.SIGCONT)
            waits(False)
            started[-1].kill()
            waits(mortal, 0.7)
        assert ("process was killed or stopped" in one.log) == mortal
    finally:
        for process in started:
            process.kill()
            process.wait()
        executor.remove_node(one.node)


@pytest.mark.parametrize(
    "profile", [BEST_EFFORT, QoSProfile(depth=10), ros.latched()], ids=["sensor", "cli", "latched"]
)
def test_a_plant_that_is_not_ready_is_heard_whatever_its_quality_of_service(make: Any, profile: Any) -> None:
    """By the controller, and by the doctor."""
    one = make("controller", CONFIG)
    doctor = Doctor(one.context)
    plant = one.foreign_node("driver").create_publisher(Bool, "plant_ready", profile)
    executor: Any = EventsExecutor(context=one.context)
    executor.add_node(one.node)
    executor.add_node(doctor)

    def heard() -> bool:
        plant.publish(Bool(data=False))
        executor.spin_once(timeout_sec=0.05)
        return not one.node._plant.ready and doctor.heard.ready is False

    until(heard)
    executor.remove_node(one.node)
    executor.remove_node(doctor)
    doctor.destroy_node()
    assert "incompatible" not in str(one.log.lines)


@pytest.mark.parametrize("kind", [EventsExecutor, SingleThreadedExecutor])
def test_messages_come_with_the_numbers_of_their_publishers(domain: int, kind: Any) -> None:
    """The two executors pass them on in different ways."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node, heard = Node("listener", context=context), list[tuple[str, int]]()
    node.create_subscription(String, "x", numbered(lambda msg, number: heard.append((msg.data, number))), 10)
    executor: Any = kind(context=context)
    executor.add_node(node)
    deadline = time.monotonic() + PATIENCE
    for name in ("first", "second"):
        publisher = node.create_publisher(String, "x", 10)
        while [one for one, _ in heard].count(name) < 3:
            assert time.monotonic() < deadline
            publisher.publish(String(data=name))
            executor.spin_once(timeout_sec=0.05)
    numbers = {name: [number for one, number in heard if one == name] for name in ("first", "second")}
    assert all(found == sorted(set(found)) for found in numbers.values())
    assert min(numbers["second"]) <= max(numbers["first"])
    context.try_shutdown()
