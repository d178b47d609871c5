"""The faults of docs/faults.md with live nodes, one after the other during the same walk (`make chaos`).

The order of the cases matters: the walk continues from one to the next, and must complete a cycle at the end. Times
depend on the load of the machine; only their order of magnitude is asserted.
"""

from __future__ import annotations

import copy
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import chaos
import numpy as np
import pytest
from chaos import BUSY, Chaos, row
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.report import bag
from dqwalk_ros.report.bag.storage import load as load_bag
from dqwalk_ros.robot.model import load_model

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

RESUMED = "walk resumed"
HELD = "safely held"
UNDISTURBED = "walk undisturbed"
NODES = ("integrator", "phase_monitor", "controller")


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chaos]:
    # the relay adds a delay, and the joints of this walk turn at up to 8 rad/s
    values = {"safety.contradiction": 1.0}
    with private_domain() as domain, closing(Chaos(tmp_path_factory.mktemp("chaos"), domain, values)) as one:
        for name in NODES:
            one.start_relayed(name)
        one.until_walking(120.0)
        yield one


@pytest.fixture(autouse=True)
def _nodes_still_run(walk: Chaos, request: pytest.FixtureRequest) -> Iterator[None]:
    """Relay messages unchanged again, and check that the node processes still run; `test_signals` ends them."""
    yield
    walk.on_states = walk.on_commands = chaos.passing
    if not request.node.originalname.startswith("test_signals"):
        dead = {name: walk.processes.exit_code(name) for name in NODES}
        assert dead == dict.fromkeys(NODES), walk.logs()


# ---------------------------------------------------------------------- the network


HARMLESS = {
    "30 % of the {} are lost": (chaos.dropping(0.3), "none needed"),
    "{} arrive in swapped pairs": (chaos.reordering(), "the older one is ignored"),
    "{} arrive twice": (chaos.duplicating, "the second is ignored"),
}


@pytest.mark.parametrize("way", ["states", "commands"])
@pytest.mark.parametrize("fault", HARMLESS)
def test_messages_that_are_lost_swapped_or_doubled(walk: Chaos, fault: str, way: str) -> None:
    policy, reaction = HARMLESS[fault]
    setattr(walk, f"on_{way}", policy)
    walk.spin(1.5)
    walk.until_walking(BUSY)
    row(fault.format(way), reaction, None, UNDISTURBED)


@pytest.mark.parametrize("way", ["states", "commands"])
def test_delayed_messages(walk: Chaos, way: str) -> None:
    """A command 200 ms late was computed from an outdated state."""
    setattr(walk, f"on_{way}", chaos.delaying(0.2))
    took = walk.until_standing(10.0)
    assert took < BUSY
    setattr(walk, f"on_{way}", chaos.passing)
    walk.until_walking()
    row(f"{way} are 200 ms late", "the plant ignores the commands and holds", took, RESUMED)


@pytest.mark.parametrize("way", ["states", "commands"])
def test_no_messages(walk: Chaos, way: str) -> None:
    setattr(walk, f"on_{way}", chaos.blocking)
    took = walk.until_standing()
    assert took < BUSY
    if way == "states":
        walk.until(lambda: "timed out" in walk.status("controller").message, 20.0, "the status of a timeout")
    setattr(walk, f"on_{way}", chaos.passing)
    walk.until_walking()
    row(f"no {way} at all", "the plant holds", took, RESUMED)


# ---------------------------------------------------------------------- corrupted messages


def set_value(field: str, i: int, value: float) -> Callable[[JointState], None]:
    def change(msg: JointState) -> None:
        getattr(msg, field)[i] = value

    return change


def rename_joint(msg: JointState) -> None:
    msg.name = ["wrong", *msg.name[1:]]


def duplicate_name(msg: JointState) -> None:
    msg.name = [msg.name[1], *msg.name[1:]]


def drop_name(msg: JointState) -> None:
    msg.name = msg.name[1:]


def clear(msg: JointState) -> None:
    msg.name, msg.position, msg.velocity = [], [], []


STATES = {
    "NaN in an angle": (set_value("position", 2, np.nan), "not a finite position"),
    "inf in an angle": (set_value("position", 9, np.inf), "not a finite position"),
    "a joint renamed": (rename_joint, "joints missing"),
    "a joint named twice": (duplicate_name, "joints missing"),
    "a name short": (drop_name, "joints missing"),
    "nothing in the message": (clear, "joints missing"),
}


@pytest.mark.parametrize("fault", STATES)
def test_corrupted_states(walk: Chaos, fault: str) -> None:
    change, text = STATES[fault]
    walk.on_states = chaos.changing(change)
    took = walk.until_status("controller", text)
    walk.until_standing()
    walk.on_states = chaos.passing
    walk.until_walking()
    row(f"state: {fault}", "rejected with the reason, plant holds", took, RESUMED)


COMMANDS = {
    "NaN in a velocity": set_value("velocity", 2, np.nan),
    "-inf in a velocity": set_value("velocity", 9, -np.inf),
    "a joint renamed": rename_joint,
    "a joint named twice": duplicate_name,
    "a name short": drop_name,
    "nothing in the message": clear,
}


@pytest.mark.parametrize("fault", COMMANDS)
def test_corrupted_commands(walk: Chaos, fault: str) -> None:
    walk.on_commands = chaos.changing(COMMANDS[fault])
    took = walk.until_standing()
    assert took < BUSY
    assert all(np.isfinite(q).all() for _, q in walk.moved[-50:])
    walk.on_commands = chaos.passing
    walk.until_walking()
    row(f"command: {fault}", "rejected, plant holds", took, RESUMED)


def test_one_corrupted_state_in_ten(walk: Chaos) -> None:
    count = iter(range(10**9))
    bad = chaos.changing(set_value("position", 0, np.nan))
    walk.on_states = lambda msg: bad(msg) if next(count) % 10 == 0 else chaos.passing(msg)
    walk.spin(1.5)
    walk.until_walking(BUSY)
    row("one state in ten has a NaN", "rejected; no timeout", None, UNDISTURBED)


def test_spikes_in_an_angle(walk: Chaos) -> None:
    count = iter(range(10**9))

    def spike(msg: JointState) -> Iterator[tuple[float, JointState]]:
        if next(count) % 10 == 0:  # a single one may be lost
            msg.position[2] = msg.position[2] + 0.5 * (-1.0 if msg.position[2] > 0.0 else 1.0)
        yield 0.0, msg

    walk.on_states = spike
    took = walk.until_status("controller", "a jump")
    walk.on_states = chaos.passing
    walk.until_walking()
    row("a spike of 0.5 rad in one angle of every tenth state", "rejected as a jump", took, RESUMED)


def test_joints_in_another_order_and_additional_ones(walk: Chaos) -> None:
    def change(msg: JointState) -> None:
        msg.name = ["head_z", *reversed(msg.name)]
        msg.position = [9.0, *reversed(msg.position)]
        msg.velocity = [0.0, *reversed(msg.velocity)]

    walk.on_states = chaos.changing(change)
    walk.spin(1.0)
    walk.until_walking(BUSY)
    row("joints in another order, and an additional one", "matched by name", None, UNDISTURBED)


def clear_velocities(msg: JointState) -> None:
    msg.velocity, msg.effort = [], []


@pytest.mark.parametrize("change", [clear_velocities, set_value("velocity", 0, np.nan)], ids=["missing", "nan"])
def test_states_without_velocities(walk: Chaos, change: Callable[[JointState], None]) -> None:
    walk.on_states = chaos.changing(change)
    walk.spin(1.0)
    walk.until_walking(BUSY)
    row("states without velocities, or with NaN", "none needed", None, UNDISTURBED)


# ---------------------------------------------------------------------- clocks


@pytest.mark.parametrize("seconds", [-100, 100])
def test_step_of_the_stamps(walk: Chaos, seconds: int) -> None:
    """As after a step of the system clock; commands are shifted back, so that they match the stamps of the plant."""

    def shift(by: int) -> Callable[[JointState], None]:
        def change(msg: JointState) -> None:
            msg.header.stamp.sec += by

        return change

    walk.on_states, walk.on_commands = chaos.changing(shift(seconds)), chaos.changing(shift(-seconds))
    walk.spin(1.0)
    walk.until_walking()
    walk.on_states, walk.on_commands = chaos.passing, chaos.passing
    walk.spin(0.5)
    walk.until_walking()
    row(f"the stamps step by {seconds:+d} s and back", "at most one timeout", None, RESUMED)


def test_commands_stamped_in_the_future(walk: Chaos) -> None:
    def change(msg: JointState) -> None:
        msg.header.stamp.sec += 100

    walk.on_commands = chaos.changing(change)
    took = walk.until_standing()
    walk.on_commands = chaos.passing
    walk.until_walking()
    row("commands stamped 100 s in the future", "a clock fault: ignored, plant holds", took, RESUMED)


# ---------------------------------------------------------------------- processes


@pytest.mark.parametrize("phase", ["double_support", "single_support"])
def test_the_controller_is_killed_and_restarted(walk: Chaos, phase: str) -> None:
    """Also in mid-swing: the new controller starts to walk from the present posture."""
    for _ in range(10):  # a phase may end before its middle
        seen = len(walk.phases())
        walk.until(lambda n=seen: walk.phase.startswith(phase) and len(walk.phases()) > n, 60.0, f"the next {phase}")
        walk.spin(0.4)
        if walk.phase.startswith(phase):
            break
    assert walk.phase.startswith(phase)
    walk.processes.signal("controller", signal.SIGKILL)
    took = walk.until_standing()
    assert took < BUSY
    q = walk.angles().copy()
    walk.start_relayed("controller")
    walk.until(lambda: walk.walking(), 90.0, "the new controller walking")
    steps = [np.abs(b - a).max() for (_, a), (_, b) in zip(walk.moved[-2000:], walk.moved[-1999:], strict=False)]
    assert max(steps) < 8.2 * 0.04 + 1e-9
    assert np.abs(walk.angles() - q).max() < 1.0
    row(f"controller: SIGKILL in {phase}, restarted", "the plant holds", took, "a new walk from there")


def test_the_controller_is_frozen(walk: Chaos) -> None:
    walk.processes.signal("controller", signal.SIGSTOP)
    took = walk.until_standing()
    assert took < BUSY
    walk.spin(0.5)
    assert walk.standing()
    walk.processes.signal("controller", signal.SIGCONT)
    walk.until_walking()
    row("controller: SIGSTOP, SIGCONT", "the plant holds", took, RESUMED)


def test_the_plant_is_frozen(walk: Chaos) -> None:
    walk.processes.signal("integrator", signal.SIGSTOP)
    took = walk.until_status("controller", "timed out")
    walk.until(lambda: walk.speed_of() == 0.0, 20.0, "a zero command")
    walk.processes.signal("integrator", signal.SIGCONT)
    walk.until_walking()
    row("plant: SIGSTOP, SIGCONT", "STALE, zero velocity once, then no commands", took, RESUMED)


def test_the_monitor_is_killed_and_restarted(walk: Chaos) -> None:
    walk.processes.signal("phase_monitor", signal.SIGKILL)
    walk.spin(1.0)
    walk.until_walking(BUSY)
    walk.start_relayed("phase_monitor")
    walk.until(lambda: walk.status("phase_monitor"), 60.0, "the monitor")
    row("monitor: SIGKILL, restarted", "it is not in the loop", None, UNDISTURBED)


def test_the_recorder_is_killed(walk: Chaos, tmp_path: Path) -> None:
    """The walk continues, and the recording can be read."""
    walk.processes.start("recorder", ["--bag", str(tmp_path / "bag"), "--ros-args", "--params-file", str(walk.params)])
    walk.until_started("recorder")
    walk.spin(5.0)
    killed = walk.stamp()
    walk.processes.signal("recorder", signal.SIGKILL)
    walk.processes.wait("recorder", 10.0)
    walk.spin(1.0)
    walk.until_walking(BUSY)
    recorded = bag.read(tmp_path / "bag")
    # by the stamps: when the recorder has discovered who publishes the states is another matter
    (states,) = (
        c for name, c in load_bag(tmp_path / "bag", lambda *_: True).columns.items() if name.endswith("joint_states")
    )
    assert killed - 1e-9 * states.times[-1] < 1.0 + BUSY
    assert any("metadata.yaml is missing" in note for note in recorded.notes)
    row("recorder: SIGKILL", f"{len(recorded)} states can be read", None, UNDISTURBED)


def test_the_viewer_is_killed(walk: Chaos) -> None:
    walk.processes.start("viewer", ["--port", "0", "--ros-args", "--params-file", str(walk.params)])
    walk.until(lambda: "the page is" in walk.processes.log("viewer"), 60.0, "the page")
    walk.spin(1.0)
    walk.processes.signal("viewer", signal.SIGKILL)
    walk.spin(1.0)
    walk.until_walking(BUSY)
    row("viewer: SIGKILL", "it is not in the loop", None, UNDISTURBED)


@pytest.mark.parametrize(
    ("what", "topic", "node"),
    [("controller", "joint_velocity_commands", "integrator"), ("plant", "states_in", "controller")],
)
def test_two_controllers_and_two_plants(walk: Chaos, what: str, topic: str, node: str) -> None:
    from rclpy.node import Node

    other = Node(f"other_{what}", context=walk._context)
    publisher = other.create_publisher(JointState, topic, QoSProfile(depth=1))

    def claim(msg: JointState) -> Iterator[tuple[float, JointState]]:
        second = copy.deepcopy(msg)  # a second plant: the same joints, with another clock
        second.header.stamp.nanosec = max(second.header.stamp.nanosec - 50_000_000, 0)
        # between two states: of two simultaneous messages a controller receives the newest only
        walk.publish_delayed(0.4 * walk.config.dt, publisher, second)
        yield 0.0, msg

    walk.on_states = claim if what == "plant" else chaos.passing
    try:
        took = walk.until_status(node, f"two {what}s: /other_{what}, /test", 30.0)
        walk.until_standing()
    finally:
        walk.on_states = chaos.passing
        walk.spin(0.2)  # until all delayed messages are sent
        other.destroy_publisher(publisher)
        other.destroy_node()
    walk.until_walking(40.0)
    row(f"a second {what}", f"the {node} holds and reports both names", took, RESUMED)


# ---------------------------------------------------------------------- parameters, QoS, load


def set_parameter(walk: Chaos, node: str, name: str, **value: object) -> object:
    client = walk.node.create_client(SetParameters, f"{node}/set_parameters")
    walk.until(client.service_is_ready, 40.0, "the parameter service")
    kind = {"double_value": 3, "integer_value": 2, "string_value": 4, "double_array_value": 8}[next(iter(value))]
    request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(type=kind, **value))])
    future = client.call_async(request)
    walk.until(future.done, 20.0, "an answer")
    walk.node.destroy_client(client)
    return future.result().results[0]


ABUSE = {
    "nan": {"double_value": float("nan")},
    "inf": {"double_value": float("inf")},
    "-1": {"double_value": -1.0},
    "a text": {"string_value": "x"},
    "an array": {"double_array_value": [0.1, 0.2]},
    "1e300": {"double_value": 1e300},
}


@pytest.mark.parametrize("value", ABUSE)
@pytest.mark.parametrize("node", ["controller", "integrator"])
def test_invalid_parameter_values(walk: Chaos, node: str, value: str) -> None:
    assert not set_parameter(walk, node, "plant.command_timeout", **ABUSE[value]).successful
    assert walk.processes.exit_code(node) is None
    walk.until_walking()
    row(f"{node}: plant.command_timeout = {value}", "rejected", None, UNDISTURBED)


def test_structural_parameters_are_read_only(walk: Chaos) -> None:
    assert not set_parameter(walk, "controller", "gait.step_length", double_value=0.3).successful
    walk.until_walking()
    row("gait.step_length set during the walk", "read only", None, UNDISTURBED)


def test_a_thousand_parameter_writes(walk: Chaos) -> None:
    client = walk.node.create_client(SetParameters, "controller/set_parameters")
    walk.until(client.service_is_ready, 40.0, "the parameter service")
    began = time.monotonic()
    for start in range(0, 1000, 5):  # the queue of a service holds ten requests
        futures = []
        for k in range(start, start + 5):
            bad = k % 3 == 0
            value = ParameterValue(type=3, double_value=-1.0 if bad else 0.1 + 1e-4 * k)
            request = SetParameters.Request(parameters=[Parameter(name="plant.command_timeout", value=value)])
            futures.append((bad, client.call_async(request)))
        walk.until(lambda futures=futures: all(f.done() for _, f in futures), 60.0, "5 answers")
        assert all(f.result().results[0].successful is not bad for bad, f in futures)
    took = time.monotonic() - began
    walk.node.destroy_client(client)
    walk.until_walking()
    assert set_parameter(walk, "controller", "plant.command_timeout", double_value=0.1).successful
    row("1000 parameter writes", "applied between ticks, a third rejected", took, UNDISTURBED)


def test_commands_of_another_quality_of_service(walk: Chaos) -> None:
    from rclpy.node import Node

    other = Node("unreliable", context=walk._context)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = other.create_publisher(JointState, "joint_velocity_commands", best_effort)
    try:
        heard = "/joint_velocity_commands is best effort, and so is the subscription now"
        walk.until(lambda: heard in walk.processes.log("integrator"), 30.0, "the log of the other quality")
    finally:
        other.destroy_publisher(publisher)
        other.destroy_node()
    walk.until_walking(40.0)
    row("best-effort commands", "heard, as a second controller is", None, RESUMED)


@pytest.mark.parametrize("busy", [0.1, 1.0])
def test_cpu_overload(walk: Chaos, busy: float) -> None:
    """The plant executes one late tick, no burst of ticks."""
    before = len(walk.moved)
    walk.processes.signal("integrator", signal.SIGSTOP)
    time.sleep(busy)
    walk.processes.signal("integrator", signal.SIGCONT)
    walk.spin(1.0)
    walk.until_walking()
    q = np.array([q for _, q in walk.moved[before:]])
    assert np.abs(np.diff(q, axis=0)).max() < 8.2 * 2.0 * walk.config.dt + 1e-9
    row(f"the plant gets no CPU time for {busy:g} s", "one late tick of two periods at most", None, RESUMED)


# ---------------------------------------------------------------------- services, shutdown


def test_pause_and_start(walk: Chaos) -> None:
    assert walk.call("controller/pause").success
    took = walk.until_standing()
    assert walk.call("controller/start").success
    walk.until_walking()
    row("~/pause, ~/start", "stands", took, RESUMED)


@pytest.mark.parametrize("angle", [2.3, 3.0], ids=["inside its limits", "outside"])
def test_persistent_jumps_latch_failed_until_reset(walk: Chaos, angle: float) -> None:
    def shift(msg: JointState) -> None:
        msg.position[msg.name.index("l_knee_y")] = angle  # further than it turns in five periods, even late ones

    walk.on_states = chaos.changing(shift)
    try:
        walk.until(lambda: walk.phase == "failed", 10.0, "the latch")
    finally:
        walk.on_states = chaos.passing
    took = walk.until_standing()
    walk.spin(0.5)
    assert walk.standing()
    try:
        assert not walk.call("controller/start").success
    finally:
        assert walk.call("controller/reset").success
        assert walk.call("controller/start").success
    walk.until_walking()
    row(f"a knee jumps to {angle:g} rad and stays there", "latched: failed until ~/reset", took, "walks after ~/reset")


def test_an_infeasible_program(walk: Chaos) -> None:
    """The controller gets states of a simulated robot with a raised leg until the program is infeasible."""
    model = load_model(walk.config.robot)
    q, commands, stamps = np.zeros(model.n), [], []
    leg = model.joint_names.index("l_hip_y")
    q[leg] = model.q_min[leg]

    def give_state(msg: JointState) -> Iterator[tuple[float, JointState]]:
        stamps.append(msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec)
        if commands and len(stamps) > 1:
            q[:] += min(max(stamps[-1] - stamps[-2], 0.0), 0.1) * commands[-1]
        out = JointState(header=msg.header, name=list(model.joint_names), position=q.tolist())
        yield 0.0, out

    def apply_command(msg: JointState) -> Iterator[tuple[float, JointState]]:
        commands.append(np.array(msg.velocity))
        zero = copy.deepcopy(msg)  # so that the real plant does not move
        zero.velocity = [0.0] * len(msg.velocity)
        yield 0.0, zero

    assert walk.call("controller/pause").success
    walk.until_standing()
    walk.on_states, walk.on_commands = give_state, apply_command
    walk.spin(0.3)
    assert walk.call("controller/reset").success
    assert walk.call("controller/start").success
    began = len(commands)
    try:
        took = walk.until_status("controller", "is short by", 60.0)
        walk.until(lambda: walk.phase == "failed", 20.0, "the latch")
        assert walk.standing()
        assert walk.config.safety.failures < len(commands) - began
        assert all(np.isfinite(u).all() for u in commands)
        assert any(u.any() for u in commands[began:])  # it moved before the failure
        zeros = walk.config.safety.failures  # `phase` may arrive before the last of them
        walk.until(lambda: not any(u.any() for u in commands[-zeros:]), 20.0, "zero commands at the end")
    finally:
        walk.on_states, walk.on_commands = chaos.passing, chaos.passing
        assert walk.call("controller/reset").success
        assert walk.call("controller/start").success
    walk.until_walking()
    row("an infeasible program", "zeros; names the conflicting rows; failed until ~/reset", took, "walks after ~/reset")


def test_a_full_cycle_is_walked_after_all_faults(walk: Chaos) -> None:
    start = len(walk.phases())
    walk.until(lambda: sum("support/" in p for p in walk.phases()[start:]) >= 5, 120.0, "a cycle of four phases")
    statuses = [s for s in walk.statuses("phase_monitor") if s.values][-20:]
    assert len(statuses) == 20
    assert all(s.level in (b"\x00", b"\x01") for s in statuses), [s.message for s in statuses]
    assert all(np.isfinite(q).all() for _, q in walk.moved)
    row("after all faults", "a whole cycle, every constraint kept", None, RESUMED)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", ["controller", "phase_monitor", "integrator"])
def test_signals(walk: Chaos, name: str, number: signal.Signals) -> None:
    for dead in [node for node in NODES if walk.processes.exit_code(node) is not None]:
        walk.start_relayed(dead)
        walk.until_started(dead)
    walk.until_walking(90.0)
    began = time.monotonic()
    walk.processes.signal(name, number)
    assert walk.processes.wait(name, 15.0) == 0
    took = time.monotonic() - began
    assert took < 2.0 + BUSY
    if name == "controller":
        walk.until_standing()
        walk.until(lambda: walk.speed_of() == 0.0, 20.0, "a final zero command")
    reaction = "zero command last, exit code 0" if name == "controller" else "exit code 0"
    row(f"{name}: {number.name}", reaction, took, UNDISTURBED if name == "phase_monitor" else HELD)
