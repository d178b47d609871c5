"""Whether the controllers of a robot understand the commands of the node drive, and are there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from driven import DT, NAMES, TOPIC, Driven
from inside import until
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory


def test_no_output_before_the_topic_has_a_subscriber(make: Any) -> None:
    """The walk waits until the output topic has a subscriber."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    one = driven.one
    one.tick()
    driven.tick(0.0)
    assert not driven.sent
    assert [msg.data for msg in one.got["plant_ready"]] == [False]
    assert "no node subscribes to /joint_commands" in one.got["diagnostics"][-1].status[0].message
    one.foreign_node("arm").create_subscription(JointTrajectory, "joint_commands", lambda _: None, 1)
    expected = (
        "arm with trajectory_msgs/msg/JointTrajectory uses /joint_commands, which is a sensor_msgs/msg/JointState"
    )
    until(lambda: driven.tick() or driven.node._blind.startswith(expected))
    assert driven.node._blind.endswith("set output.type")
    robot = one.foreign_node("controller_manager")
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    until(lambda: driven.tick() or len(one.got["plant_ready"]) > 1)
    assert one.got["plant_ready"][-1].data


@pytest.mark.parametrize(
    ("parameters", "wrong"),
    [
        ({"joints": NAMES, "interface_name": "position"}, ""),
        ({"joints": NAMES[::-1]}, "/robot has its joints in another order: set output.joints to [bust_x, "),
        ({"joints": (*NAMES, "gripper")}, "/robot has more joints than output.joints: set output.joints to [l_hip_x, "),
        ({"joints": NAMES[:5]}, "/robot lacks abs_x, abs_y, abs_z"),
        ({"joints": NAMES, "interface_name": "velocity"}, "/robot takes velocity, not position: set output.interface"),
        ({}, ""),
    ],
)
def test_a_controller_that_would_misunderstand_its_commands_gets_none(make: Any, parameters: Any, wrong: str) -> None:
    """A Float64MultiArray has neither names nor units. Until the controller has answered, nobody is sent anything."""
    driven = Driven(make, asks=True)
    one = driven.one
    others = [one.beside(name) for name in ("listener", "robot")]
    for node in others:
        node.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    for name, value in parameters.items():
        others[1].declare_parameter(name, list(value) if isinstance(value, tuple) else value)
    listener, robot, own = (SingleThreadedExecutor(context=node.context) for node in (*others, driven.node))
    for executor, node in zip((listener, robot, own), (*others, driven.node), strict=True):
        executor.add_node(node)

    def wait_for(*answering: SingleThreadedExecutor, answers: int) -> None:
        until(lambda: driven.tick(0.0) or len(driven.node._controllers._found) == 2)

        def answered() -> bool:
            driven.tick(0.0)
            for executor in (*answering, own):
                executor.spin_once(0.005)
            return sum(not one.left for one in driven.node._controllers._found.values()) == answers

        until(answered)

    wait_for(listener, answers=1)
    assert not driven.sent
    wait_for(listener, robot, answers=2)
    driven.tick(0.1)  # sees the last answer
    driven.tick(0.1)
    assert bool(driven.sent) == (not wrong)
    assert one.got["plant_ready"][-1].data == (not wrong)
    assert wrong in driven.node._blind
    for executor in (listener, robot, own):
        executor.shutdown()


@pytest.mark.parametrize(("name", "trusted"), [("robot", True), ("_NODE_NAME_UNKNOWN_", False)])
def test_only_a_known_controller_without_parameters_is_trusted(
    make: Any, monkeypatch: pytest.MonkeyPatch, name: str, trusted: bool
) -> None:
    """Such as one of micro-ROS; a node whose name has not been discovered yet may have parameters."""
    driven = Driven(make, asks=True)
    end = SimpleNamespace(node_namespace="/", node_name=name, endpoint_gid=[1])
    monkeypatch.setattr(driven.node, "get_subscriptions_info_by_topic", lambda _: [end])
    monkeypatch.setattr(driven.node._output, "get_subscription_count", lambda: 1, raising=False)
    for _ in range(round(2.5 / DT)):
        driven.tick(0.1)
    assert not driven.sent
    for _ in range(round(1.0 / DT)):
        driven.tick(0.1)
    assert bool(driven.sent) == trusted


def test_a_second_node_that_commands_the_robot_stops_it(make: Any) -> None:
    """Such as another drive, or sliders: the robot would jump from the goals of one to those of the other."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    robot, sliders = (driven.one.beside(name) for name in ("robot", "sliders"))
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    until(lambda: driven.tick(0.1) or driven.sent)
    other = sliders.create_publisher(JointState, "joint_commands", 1)
    until(lambda: driven.tick(0.1) or driven.node._blind)
    assert driven.node._blind == "more than one node commands /joint_commands: /drive, /sliders"
    assert not driven.one.got["plant_ready"][-1].data
    sent = [msg.position for msg in driven.sent]
    driven.tick(0.1)
    assert all(msg.position == sent[-1] for msg in driven.sent[len(sent) :])
    sliders.destroy_publisher(other)
    until(lambda: driven.tick(0.1) or not driven.node._blind)


def test_a_controller_that_is_not_active_is_named(make: Any) -> None:
    """It subscribes to its commands as soon as it is configured, and ignores them until it is active."""
    driven = Driven(make, asks=True, output__type="joint_state", output__topic="joint_commands")
    one = driven.one
    robot, manager = one.beside("legs"), one.beside("controller_manager")
    robot.create_subscription(JointState, "joint_commands", lambda _: None, 1)
    publishers = [manager.create_publisher(DiagnosticArray, "/diagnostics", 1)]
    until(lambda: driven.tick(0.1) or driven.sent)

    def report(state: str) -> str:
        values = [KeyValue(key="arms.state", value="active"), KeyValue(key="legs.state", value=state)]
        values.append(KeyValue(key="legs.execution_time", value="Avg: 3.00 us"))
        status = DiagnosticStatus(name="controller_manager: Controllers Activity", values=values)
        one.send("/diagnostics", DiagnosticArray(status=[DiagnosticStatus(name="other"), status]))
        driven.tick(0.1)
        return str(driven.node._blind)

    until(lambda: report("inactive"))
    expected = "the controller legs is inactive: `ros2 control set_controller_state legs active`"
    assert report("inactive") == expected
    assert not one.got["plant_ready"][-1].data
    assert report("active") == ""
    publishers.append(one.foreign_node("controller_manager").create_publisher(DiagnosticArray, "/diagnostics", 1))
    until(lambda: driven.node.count_publishers("/diagnostics") == 3)
    assert report("inactive") == "", "of which of the managers?"


def test_a_controller_that_is_loaded_again_is_asked_again(make: Any) -> None:
    """It may have another order now; meanwhile a listener remains, which is no controller."""
    driven = Driven(make, asks=True)
    made = [driven.one.beside(name) for name in ("listener", "robot", "again")]
    made[1].declare_parameter("joints", list(NAMES))
    made[2].declare_parameter("joints", list(NAMES[::-1]))
    executors = [SingleThreadedExecutor(context=node.context) for node in (*made, driven.node)]
    for executor, node in zip(executors, (*made, driven.node), strict=True):
        executor.add_node(node)

    def happens(expected: Any) -> None:
        def happened() -> bool:
            driven.tick(0.1)
            for executor in executors:
                executor.spin_once(0.002)
            return bool(expected())

        until(happened)

    listener, robot, again = made
    listener.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    before = robot.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    happens(lambda: driven.sent)
    robot.destroy_subscription(before)
    happens(lambda: "does not subscribe to" in driven.node._blind)
    sent = len(driven.sent)
    again.create_subscription(Float64MultiArray, TOPIC["position"], lambda _: None, 1)
    happens(lambda: "/again has its joints in another order" in driven.node._blind)
    assert len(driven.sent) == sent
    for executor in executors:
        executor.shutdown()
