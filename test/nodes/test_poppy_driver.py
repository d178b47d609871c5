"""The Poppy driver as a node in real time, with emulated servos over pseudo-terminals, with and without faults.

`make driver` prints the results of a walk on emulated servos.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from dynamixel_bus import LOAD, MOTORS, TEMPERATURE, VOLTAGE, FaultyServos, Terminals
from inside import state
from live import LATCHED, Live
from poppy_rig import driver_node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.plants.poppy.dynamixel import GOAL, TORQUE_ENABLE
from dqwalk_ros.support.errors import ConfigError, PlantError

ROOT = Path(__file__).resolve().parents[2]
CONFIG = load("paper").updated({"dt": 0.02, "monitor.rate": 20.0})
KNEE, RIGHT_KNEE = "l_knee_y", "r_knee_y"


class Robot(Live):
    """The driver on its buses, and a controller that moves the left knee back and forth.

    Attributes
    ----------
    buses : Terminals
    speed : float
        Velocity of the knee [rad/s].
    ready : bool or None
        Last message of plant_ready; None before the first.
    """

    def __init__(self, folder: Path, domain: int, config: Config, name: str = "test") -> None:
        self.buses = Terminals(folder, l_knee_y=20.0)
        super().__init__(folder, domain, config.updated(self.buses.settings), name=name)
        self.speed = 0.3
        self.ready: bool | None = None
        self.node.create_subscription(Bool, "plant_ready", self._on_ready, LATCHED)
        self._commands = self.node.create_publisher(JointState, "joint_velocity_commands", QoSProfile(depth=1))
        self._compliant = self.node.create_client(SetBool, "poppy_driver/compliant")
        self.node.create_subscription(JointState, "joint_states", self._answer, QoSProfile(depth=1))

    def _on_ready(self, msg: Bool) -> None:
        self.ready = msg.data

    def _answer(self, msg: JointState) -> None:
        names = [
            name for name in msg.name if name.startswith(("l_hip", "l_knee", "l_ankle", "r_hip", "r_knee", "r_ankle"))
        ]
        knee = msg.position[msg.name.index(KNEE)]
        self.speed = -abs(self.speed) if knee > 0.5 else abs(self.speed) if knee < 0.2 else self.speed
        command = JointState(header=msg.header, name=names, velocity=[self.speed * (n == KNEE) for n in names])
        self._commands.publish(command)

    def goals(self) -> list[int]:
        """Return the goals in the registers of all servos."""
        return [self.buses.of(name).joint(name).word(GOAL) for name in MOTORS]

    def torques(self) -> set[int]:
        """Return the set of values in the torque registers of all servos."""
        return {self.buses.of(name).joint(name).memory[TORQUE_ENABLE] for name in MOTORS}

    def until_torque(self, on: bool) -> None:
        """Wait until the torque of all servos is on or off; they read their commands after the driver has answered."""
        self.until(lambda: self.torques() == {int(on)}, 10.0, f"the torque {'on' if on else 'off'}")

    def until_active(self, condition: Callable[[], Any], timeout: float, what: str) -> None:
        """Wait for what an active driver does.

        The emulated motors are threads of this process, which a busy machine can suspend for longer than an outage may
        last; then the robot is activated again, as an operator would.
        """

        def holds() -> Any:
            if any("then ~/activate" in status.message for status in self.statuses("poppy_driver")[-2:]):
                self.got["diagnostics"].clear()
                self.call("poppy_driver/activate")
            return condition()

        self.until(holds, timeout, what)

    def until_moving(self) -> None:
        """Wait until commands move the goal of the knee."""
        before = self.buses.of(KNEE).joint(KNEE).word(GOAL)
        self.until_active(
            lambda: abs(self.buses.of(KNEE).joint(KNEE).word(GOAL) - before) > 20, 20.0, "a goal that moves"
        )

    def is_still(self, seconds: float = 0.5) -> bool:
        """Return whether no goal changes for a time [s]."""
        before = self.goals()
        self.spin(seconds)
        return self.goals() == before

    def until_error(self, text: str, timeout: float = 10.0) -> None:
        """Wait until a status of the driver is ERROR and contains a text."""
        start = len(self.got["diagnostics"])

        def found() -> bool:
            new = [s for array in self.got["diagnostics"][start:] for s in array.status]
            return any(text in s.message and s.level == b"\x02" for s in new)

        self.until(found, timeout, f"an ERROR with {text!r}")

    def activate(self) -> None:
        """Activate the driver; wait for the first pose, and until commands have an effect."""
        answer = self.call("poppy_driver/activate")
        assert answer.success, answer.message
        self.until_active(lambda: self.ready, 30.0, "the first pose")
        self.until_moving()

    def set_compliant(self, on: bool) -> SetBool.Response:
        self.until(self._compliant.service_is_ready, 20.0, "the service")
        future = self._compliant.call_async(SetBool.Request(data=on))
        self.until(future.done, 20.0, "an answer")
        return future.result()

    def clear_faults(self) -> None:
        """Remove all faults and plug the ports in."""
        for name, servos in self.buses.servos.items():
            servos.clear_faults()
            for servo in servos.servos.values():
                servo.error = 0
                servo.memory[TEMPERATURE], servo.memory[VOLTAGE] = 38, 120
            if self.buses.terminals[name].gone:
                self.buses.terminals[name].plug_in()

    def close(self) -> None:
        super().close()
        self.buses.close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with private_domain() as domain, closing(Robot(tmp_path_factory.mktemp("robot"), domain, CONFIG)) as one:
        one.start("poppy_driver")
        yield one


@pytest.fixture
def walking(robot: Robot) -> Iterator[Robot]:
    """The robot, moving and without faults."""
    robot.clear_faults()
    robot.until(lambda: robot.got["joint_states"], 30.0, "a state")
    if not robot.ready:
        robot.until(lambda: robot.call("poppy_driver/activate").success, 10.0, "the torque")
        robot.until_active(lambda: robot.ready, 30.0, "the first pose")
    robot.until_moving()
    robot.got["joint_states"].clear()
    yield robot
    assert robot.processes.exit_code("poppy_driver") is None, robot.logs()


def stamp(msg: JointState) -> float:
    return msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec


def test_angles_are_published_and_nothing_moves_before_activate(robot: Robot) -> None:
    robot.until(lambda: len(robot.got["joint_states"]) > 50, 60.0, "states")
    assert robot.torques() == {0}
    robot.until(lambda: robot.ready is False, 20.0, "plant_ready: false")
    robot.until(
        lambda: any("the torque is off: call ~/activate" in s.message for s in robot.statuses("poppy_driver")),
        5.0,
        "a status that asks for ~/activate",
    )
    state = robot.got["joint_states"][-1]
    assert state.position[state.name.index(KNEE)] == pytest.approx(0.349, abs=0.002)
    assert robot.is_still()
    robot.activate()
    robot.until_torque(True)
    assert robot.set_compliant(True).success
    robot.until_torque(False)
    robot.until(lambda: robot.ready is False, 20.0, "plant_ready: false")
    robot.got["joint_states"].clear()
    robot.until(lambda: len(robot.got["joint_states"]) > 10, 20.0, "states while the torque is off")


def test_the_latency_of_the_goals_is_published(walking: Robot) -> None:
    def latencies() -> list[float]:
        values = {v.key: v.value for s in walking.statuses("poppy_driver")[-1:] for v in s.values}
        found = [float(values.get(key, "nan")) for key in ("latency", "longest latency")]
        return found if 0.0 < found[0] < 0.1 else []

    middle, longest = walking.until(latencies, 20.0, "a latency below 0.1 s")
    assert longest >= middle


def disconnect_bus(robot: Robot, servos: FaultyServos) -> None:
    servos.dead = True


def unplug(robot: Robot, servos: FaultyServos) -> None:
    robot.buses.terminals["lower"].unplug()


def send_garbage(robot: Robot, servos: FaultyServos) -> None:
    servos.garbage = 1.0


BUS_FAULTS = {
    "the bus is silent": (disconnect_bus, "lower bus: every motor does not answer"),
    "the port is unplugged": (unplug, "lower bus: the port is gone"),
    "garbage": (send_garbage, "lower bus: "),
}
"""Faults that the serial port takes part in; `test_poppy_faults.py` has all of them, and those of the motors."""


@pytest.mark.parametrize(
    "fault",
    [name if name == "the port is unplugged" else pytest.param(name, marks=pytest.mark.long) for name in BUS_FAULTS],
)
def test_old_angles_are_not_published(walking: Robot, fault: str) -> None:
    begin, text = BUS_FAULTS[fault]
    begin(walking, walking.buses.servos["lower"])
    began = time.time()
    walking.until_error(text)
    walking.until(walking.is_still, 20.0, "goals that stay")  # the servos may still read those sent before
    assert walking.is_still(1.5)  # longer than an outage after which the motion resumes
    assert max(map(stamp, walking.got["joint_states"]), default=0.0) <= began + 0.02
    walking.until(lambda: walking.ready is False, 20.0, "plant_ready: false")
    walking.clear_faults()
    walking.until(lambda: walking.call("poppy_driver/activate").success, 10.0, "the torque")
    walking.until_active(lambda: walking.ready, 30.0, "the first pose")
    walking.until_moving()


def overheat(servos: FaultyServos) -> None:
    servos.joint(KNEE).memory[TEMPERATURE] = 70


def block(servos: FaultyServos) -> None:
    servos.joint(KNEE).blocked = True


MOTOR_FAULTS = {
    "a motor is hot": (overheat, "l_knee_y is at 70 degC, too hot"),
    "a joint is blocked": (block, "l_knee_y cannot follow"),
}


@pytest.mark.long
@pytest.mark.parametrize("fault", MOTOR_FAULTS)
def test_a_motor_fault_holds_the_robot(walking: Robot, fault: str) -> None:
    begin, text = MOTOR_FAULTS[fault]
    begin(walking.buses.servos["lower"])
    walking.until_error(text)
    walking.until(walking.is_still, 20.0, "goals that stay")  # the goal of a blocked joint is reset first
    walking.until(lambda: walking.ready is False, 20.0, "plant_ready: false")
    walking.buses.servos["lower"].joint(KNEE).write(LOAD, bytes(2))


def test_two_drivers_do_not_share_a_port(walking: Robot, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dqwalk_ros.nodes", "poppy_driver", "--ros-args", "--params-file"]
    with (tmp_path / "log").open("w+") as log:
        second = subprocess.Popen([*command, str(walking.params)], stdout=log, stderr=log)
        walking.until(lambda: second.poll() is not None, 60.0, "the end of the second driver")  # and answer the first
        log.seek(0)
        assert "the lower bus cannot be opened" in log.read()
    assert second.returncode == 2
    walking.got["joint_states"].clear()
    walking.until(lambda: len(walking.got["joint_states"]) > 10, 20.0, "states of the first driver")


@pytest.mark.long
@pytest.mark.parametrize("torque_off", [False, True])
def test_the_torque_at_exit_is_as_configured(nodes: Any, torque_off: bool) -> None:
    settings = {"poppy.torque_off_at_end": torque_off, "poppy.activate": True}
    robot = nodes(CONFIG.updated(settings), kind=Robot)
    robot.start("poppy_driver")
    robot.until(lambda: robot.ready, 60.0, "the first pose")
    for servos in robot.buses.servos.values():
        servos.damaged = 0.3  # must have no effect
    robot.processes.signal("poppy_driver", signal.SIGINT)
    assert robot.processes.wait("poppy_driver", 15.0) == 0
    assert "Traceback" not in robot.processes.log("poppy_driver")
    robot.until_torque(not torque_off)


@pytest.mark.long
@pytest.mark.timeout(1000)
@pytest.mark.parametrize("options", [[], ["--full"]], ids=["a fast cycle", "the paper's cycle"])
def test_a_cycle_on_emulated_motors(options: list[str]) -> None:
    """The walk finishes, at 50 Hz, with all angles within their limits and close to their goals."""
    words = [sys.executable, "-m", "benchmark.lab.driver", *options]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("stamps", ["of the states", "none", "of the first state"])
def test_commands_move_the_robot_whatever_their_stamps(make: Any, monkeypatch: pytest.MonkeyPatch, stamps: str) -> None:
    """Each command moves the joints for the time since the last one, and a repeated message for no time."""
    one, _ = driver_node(make, monkeypatch, CONFIG)
    node, passed = one.node, []
    node._plant._law.active = node._plant.ready = True
    node._plant.write = lambda command, dt: passed.append(dt)
    node._commands.forbid("")
    node._stamp = 1_000_000_000
    names = node._plant.names[:10]
    for k in range(5):
        one.clock.now += CONFIG.dt
        node._stamp = 1_000_000_000 + round(k * CONFIG.dt * 1e9)
        at = {"of the states": 1.0 + k * CONFIG.dt, "none": 0.0, "of the first state": 1.0}[stamps]
        for _ in range(3):
            one.send("joint_velocity_commands", state(names, [], at, velocity=[0.1] * len(names)))
    node._plant._law.active = node._plant.ready = False
    node._plant.close()
    assert passed == pytest.approx([CONFIG.dt] * 5)


def test_the_defaults_of_the_driver_are_those_of_its_plant(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a simulation have another period, and the highest gain of the servos."""
    one, _ = driver_node(make, monkeypatch, "/**: {ros__parameters: {poppy.start_speed: 0.1}}")
    assert one.node.config == overlaid(Config(), "poppy").updated({"poppy.start_speed": 0.1})


def test_a_clock_that_is_set_back_withholds_no_state(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    one, _ = driver_node(make, monkeypatch, CONFIG)
    began, stamps = one.clock.now, []

    def at(off: float) -> Time:
        return Time(nanoseconds=round(1e9 * (one.clock.now - began + off)))

    for k in range(20):
        off = 1000.0 if k < 10 else 5.0
        monkeypatch.setattr(one.node, "get_clock", lambda off=off: SimpleNamespace(now=lambda: at(off)), raising=False)
        one.clock.now += CONFIG.dt
        one.node._on_period()
        stamps.append(stamp(one.got["joint_states"][-1]) - off)
    assert stamps == pytest.approx([(k + 1) * CONFIG.dt for k in range(20)], abs=1e-6)
    assert len(one.got["joint_states"]) == 20


def until(one: Any, condition: Callable[[], object], seconds: float = 30.0) -> None:
    """Execute periods of a driver until a condition holds."""
    end = one.clock.now + seconds
    while not condition():
        assert one.clock.now < end, one.log.lines[-5:]
        one.clock.now += CONFIG.dt
        one.node._on_period()


def test_a_fault_on_the_way_to_the_first_pose_is_logged(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    one, memory = driver_node(make, monkeypatch, CONFIG.updated({"poppy.activate": True, "poppy.start_speed": 0.02}))
    until(one, lambda: "moving to the first pose: " in one.log)
    memory.servos["lower"].dead = True
    until(one, lambda: "not moving to the first pose: lower bus: every motor does not answer" in one.log, 1.0)


def test_the_first_pose_is_the_posture_of_the_walk(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"standing.posture": ["r_knee_y=0.5"], "poppy.activate": True}
    one, memory = driver_node(make, monkeypatch, CONFIG.updated(settings))
    until(one, lambda: one.node._plant.ready)
    assert memory.angle(RIGHT_KNEE) == pytest.approx(0.5, abs=CONFIG.poppy.start_tolerance)


def test_a_refused_activation_is_reported_until_the_next_one(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer of the service is long gone when somebody wonders why the robot does not walk."""
    one, _ = driver_node(make, monkeypatch, CONFIG)

    def refuse() -> None:
        raise PlantError("no way to the first pose keeps l_hand and head apart")

    with monkeypatch.context() as patch:
        patch.setattr(one.node._plant, "activate", refuse)
        assert not one.call("activate", Trigger.Request()).success
    one.node._diagnose()
    said = one.got["diagnostics"][-2].status[0].message
    assert said.startswith("the torque is off: call ~/activate; it was refused last time: no way to the first pose")
    assert one.call("activate", Trigger.Request()).success
    one.node._diagnose()
    assert "refused" not in one.got["diagnostics"][-2].status[0].message


def test_a_robot_that_would_never_move_is_refused(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"commands come every 0.02 s .* set at least 0.04 s"):
        driver_node(make, monkeypatch, CONFIG.updated({"plant.command_timeout": 0.03}))


def test_a_second_activation_moves_no_robot(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be in mid-step, and would move to its first pose."""
    one, memory = driver_node(make, monkeypatch, CONFIG.updated({"poppy.activate": True}))
    plant = one.node._plant
    until(one, lambda: plant.ready)
    for name, request in (("activate", Trigger.Request()), ("compliant", SetBool.Request(data=False))):
        answer = one.call(name, request)
        assert (answer.success, answer.message, plant.ready) == (True, "the torque is on already", True)
    memory.servo(KNEE).memory[TEMPERATURE] = 63
    until(one, lambda: one.got["plant_warning"])
    assert "l_knee_y is at 63 degC, the robot holds at 65" in one.got["plant_warning"][-1].data
    assert one.node._commands.gate.ready
    memory.servo(KNEE).memory[TEMPERATURE] = 70
    until(one, lambda: "too hot" in one.node._commands.gate.refused)
    assert not one.call("activate", Trigger.Request()).success
    memory.servo(KNEE).memory[TEMPERATURE] = 40
    until(one, lambda: not one.got["plant_warning"][-1].data)


def test_a_driver_that_waits_for_a_clock_says_so(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With use_sim_time its states would be stamped 0, and a walk would wait without a reason."""
    one, _ = driver_node(make, monkeypatch, CONFIG.updated({"poppy.activate": True}), ros=("-p", "use_sim_time:=true"))
    until(one, lambda: one.node._plant.ready)
    assert one.node._commands.gate.refused == "use_sim_time is set, but no node publishes /clock"


def test_the_torque_is_switched_off_after_a_fall_and_on_when_no_motor_is_hot(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, memory = driver_node(make, monkeypatch, CONFIG.updated({"poppy.activate": True}))
    until(one, lambda: one.node._plant.ready)
    one.send("phase", String(data="fallen"))
    assert not any(memory.torque(name) for name in MOTORS)
    memory.servo(KNEE).memory[TEMPERATURE] = 70
    until(one, lambda: "too hot" in one.node._commands.gate.refused)
    answer = one.call("compliant", SetBool.Request(data=False))
    assert not answer.success
    assert "l_knee_y is at 70 degC, too hot" in answer.message
    assert not any(memory.torque(name) for name in MOTORS)
    memory.servo(KNEE).memory[TEMPERATURE] = 38
    until(one, lambda: "too hot" not in one.node._commands.gate.refused)
    assert one.call("activate", Trigger.Request()).success
    until(one, lambda: one.node._plant.ready)
    assert all(memory.torque(name) for name in MOTORS)


def test_motors_that_an_earlier_driver_left_on_are_not_said_to_be_off(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That driver was killed."""
    before, memory = driver_node(make, monkeypatch, CONFIG.updated({"poppy.activate": True}))
    until(before, lambda: before.node._plant.ready)
    one, _ = driver_node(make, monkeypatch, CONFIG, memory)
    assert "the motors hold where they are" in one.node._commands.gate.refused
    one.send("phase", String(data="fallen"))
    assert not any(memory.torque(name) for name in MOTORS)
    assert one.node._commands.gate.refused == "the torque is off: call ~/activate"


def test_motors_that_have_not_reported_their_temperature_do_not_end_the_driver(
    make: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their long replies may be damaged where the short ones with their angles are not."""
    one, _ = driver_node(make, monkeypatch, CONFIG)
    for part in one.node._plant.parts:
        part.bus.registers[:] = [None] * len(part.bus.ids)
    one.node._diagnose()
    assert one.got["diagnostics"][-1].status[0].message == "no motor has reported its temperature"
