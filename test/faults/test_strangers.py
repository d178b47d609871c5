"""A second controller, a second plant, and nodes that are started twice."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inside import state, until
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from dqwalk_ros.config import load
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError

CONFIG = load("paper").updated({"dt": 0.02, "plant.command_timeout": 4.0})  # longer than any delay of the live tests
MODEL = load_model(CONFIG.robot)


def command(stamp: int, speed: float) -> Any:
    msg = state(MODEL.joint_names, [], 0.0, velocity=np.full(MODEL.n, speed))
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
    return msg


def test_commands_of_a_second_controller_are_ignored_from_the_first(make: Any) -> None:
    """Commands cause no motion as soon as there are two publishers, before the plant's next periodic check."""
    plant = make("integrator", CONFIG)
    node = plant.node
    plant.foreign_node("controller").create_publisher(JointState, "joint_velocity_commands", QoSProfile(depth=1))
    until(lambda: node.count_publishers("/joint_velocity_commands") == 1)
    plant.pass_period()
    plant.send("joint_velocity_commands", command(node._stamp, 0.1))
    plant.pass_period()
    moved = node.plant.state.q.copy()
    assert moved.any()
    plant.foreign_node("stranger").create_publisher(JointState, "joint_velocity_commands", QoSProfile(depth=1))
    until(lambda: node.count_publishers("/joint_velocity_commands") == 2)
    for _ in range(3):
        plant.send("joint_velocity_commands", command(node._stamp - 1, 8.0))
        plant.pass_period()
    assert node.plant.state.q == pytest.approx(moved, abs=0.0)
    assert "holding still: two controllers: " in plant.log
    assert not plant.got["plant_ready"][-1].data
    until(lambda: node.commands._check() or "two controllers: /controller, /stranger" in plant.log)


def test_the_command_timeout_can_only_be_lowered_while_the_robot_moves(make: Any) -> None:
    plant = make("integrator", CONFIG)
    node = plant.node

    def accepts(value: float) -> bool:
        (result,) = node.set_parameters([Parameter("plant.command_timeout", value=value)])
        assert result.successful or "can only be lowered while the robot moves" in result.reason
        return result.successful

    assert accepts(5.0)
    plant.pass_period()
    plant.send("joint_velocity_commands", command(node._stamp, 0.1))
    assert not accepts(10.0)
    assert not accepts(5.1)
    assert node.config.plant.command_timeout == 5.0
    assert accepts(4.0)
    (result,) = node.set_parameters([Parameter("plant.command_timeout", value=0.03)])
    assert "the robot would stand still; set at least 0.04 s" in result.reason
    node.commands.gate.hold()
    assert accepts(5.0)


@pytest.mark.parametrize("impulse", [1e12, -1e300, float("nan"), float("inf")])
def test_an_excessive_push_is_rejected(make: Any, impulse: float) -> None:
    from geometry_msgs.msg import WrenchStamped

    from dqwalk_ros.config import overlaid

    plant = make("physics", overlaid(load("poppy"), "physics"))
    msg = WrenchStamped()
    msg.wrench.force.y = impulse
    plant.send("push", msg)
    assert f"push rejected: 0, {impulse:g}, 0 N s are beyond" in plant.log
    assert not plant.node.plant.data.xfrc_applied.any()


def test_a_node_that_already_runs_does_not_start_again(nodes: Any) -> None:
    """Also on a busy machine; a killed node does not prevent the start."""
    live, second = nodes(CONFIG), nodes(CONFIG, name="other")

    def one_more_state() -> None:
        begun = live.stamp()
        live.until(lambda: live.stamp() > begun + 0.2, 60.0, "a state")

    live.start("integrator")
    one_more_state()
    second.start("integrator")
    assert second.processes.wait("integrator", 60.0) == 2
    assert "/integrator is already running" in second.processes.log("integrator")
    one_more_state()
    live.processes.signal("integrator", signal.SIGKILL)
    live.processes.wait("integrator", 10.0)
    second.start("integrator")
    one_more_state()


@pytest.mark.parametrize("name", ["drive", pytest.param("phase_monitor", marks=pytest.mark.long)])
def test_every_node_of_a_second_launch_is_refused(make: Any, name: str) -> None:
    """Two monitors would publish, and two drives command the robot."""
    first, second = make(name, CONFIG), make(name, CONFIG)
    first.node.refuse_a_second()
    with pytest.raises(ConfigError, match=f"/{name} is already running"):
        second.node.refuse_a_second()


def test_a_node_ends_with_the_process_that_started_it(domain: int) -> None:
    """As with `ros2 launch`, of which a killed one would leave a walking robot."""
    node = [sys.executable, "-m", "dqwalk_ros.nodes", "integrator", "--ros-args", "-p", "node.end_with_parent:=true"]
    parent = subprocess.Popen(
        ["sh", "-c", '"$@" & wait', "sh", *node], env=os.environ | {"ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert parent.stdout is not None
    assert any("joints, real time" in line for line in parent.stdout)
    parent.kill()
    parent.stdout.read()  # until the node has closed it, too
    parent.wait()


def test_a_node_that_runs_on_another_machine_is_detected(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no lock of it on this machine."""
    first, second = make("integrator", CONFIG), make("integrator", CONFIG)
    first.node.refuse_a_second()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    second.node.refuse_a_second()  # the first one publishes nothing: it may be dead
    until(lambda: ros.publishers_of(second.node, "joint_states") == ("/integrator", "/integrator"))
    over = threading.Event()

    def publish() -> None:
        while not over.wait(0.02):
            first.node.publish()

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        with pytest.raises(ConfigError, match="/integrator is already running and publishes /joint_states"):
            second.node.refuse_a_second()
    finally:
        over.set()
        thread.join()
