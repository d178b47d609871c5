"""The nodes as real processes over DDS, each test in its own ROS domain; no timing is asserted tightly."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

from live import LATCHED, SHORT, Live
from sensor_msgs.msg import JointState

from dqwalk_ros.config import Config, load, to_yaml
from dqwalk_ros.nodes.command_line import NODES
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report import bag
from dqwalk_ros.robot import load_model
from dqwalk_ros.runner import environment, private_domain, run_walk
from dqwalk_ros.simulation import make_controller, simulate
from dqwalk_ros.topics import TOPICS

Make = Callable[..., Live]
LONG = {**SHORT, "task.eta": 0.3, "ssp.threshold": 1e-3}
"""Five times as many ticks as `SHORT`, so that a fast machine can be stopped in the middle."""


@pytest.fixture
def live(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Make]:
    """Make `Live` with parameters, ended after the test."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made: list[Live] = []
    with private_domain() as domain:

        def make(**values: object) -> Live:
            config = load("paper").updated({key.replace("__", "."): v for key, v in values.items()})
            made.append(Live(tmp_path, domain, config))
            return made[-1]

        yield make
        for one in made:
            one.close()


def names_of(config: Config) -> list[str]:
    return list(load_model(config.robot).joint_names)


# ---------------------------------------------------------------------- lockstep


@pytest.mark.parametrize("walks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_lockstep_walk_equals_that_of_one_process(tmp_path: Path, walks: int) -> None:
    """Every time, and with a complete bag."""
    config = load("paper").updated(SHORT)
    model = load_model(config.robot)
    expected = simulate(make_controller(config, model), KinematicPlant(model))
    assert expected.finished
    for path in [tmp_path / str(k) / "bag" for k in range(walks)]:
        outcome = run_walk(config, path)
        assert outcome.finished, outcome.reason
        walked = bag.read(path)
        assert walked.finished
        n = len(expected.time)
        assert 0 <= len(walked.time) - n <= 1  # the plant steps once more, at zero velocity
        np.testing.assert_allclose(walked.q[:n], expected.q, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(walked.u[:n], expected.u, rtol=0.0, atol=1e-9)
        assert [(p.name, p.start) for p in walked.phases] == [(p.name, p.start) for p in expected.phases]
        for a, b in zip(walked.phases, expected.phases, strict=True):
            np.testing.assert_allclose(a.x_odom_base, b.x_odom_base, rtol=0.0, atol=1e-9)
        check_bag_is_complete(path, round(config.dt * 1e9))


def check_bag_is_complete(path: Path, period: int) -> None:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    stamps: dict[str, list[int]] = {}
    judged = []
    with Reader(path) as reader:
        assert {connection.topic for connection in reader.connections} == {
            "/rosout",
            *(f"/{name}" for name, topic in TOPICS.items() if topic.source != "physics"),
        }
        for connection, time, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic in ("/joint_states", "/joint_velocity_commands", "/base_pose"):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                assert stamp == time
                stamps.setdefault(connection.topic, []).append(stamp)
            elif connection.topic == "/diagnostics":
                judged += [s for s in message.status if s.name == "phase_monitor: walk" and s.values]
    assert len(judged) > 20
    assert all(status.level < 2 for status in judged), [status.message for status in judged if status.level > 1]
    for topic, found in stamps.items():
        assert found == [k * period for k in range(len(found))], topic
    assert len(stamps["/joint_velocity_commands"]) == len(stamps["/base_pose"]) == len(stamps["/joint_states"]) - 1


@pytest.mark.long
def test_a_bag_of_a_late_recorder_is_a_walk(live: Make, tmp_path: Path) -> None:
    one = live(plant__lockstep=True, **{key.replace(".", "__"): value for key, value in LONG.items()})
    walk = [f"{kind}_support/{foot}" for foot in ("left", "right") for kind in ("double", "single")]
    one.start("integrator")
    one.start("controller")
    one.until_ready("controller/pause")  # during discovery, so that the call comes before the end of the walk
    one.until(lambda: "double_support/left" in one.phases(), 60.0, "the first phase")
    assert one.call("controller/pause").success
    one.until(lambda: one.phase == "paused", 10.0, "the pause")
    before_the_pause = [name for name in one.phases() if name in walk][-1]  # at least the first, see above
    ahead = walk[walk.index(before_the_pause) :]
    one.start("recorder", "--bag", str(tmp_path / "bag"))
    one.until_started("recorder")
    one.until(lambda: one.node.count_subscribers("joint_states") > 2, 60.0, "the recorder listening")
    one.spin(2.0)
    assert one.call("controller/start").success
    one.until(lambda: "finished" in one.phases(), 60.0, "the end of the walk")
    one.spin(1.0)
    one.processes.signal("recorder", signal.SIGINT)
    assert one.processes.wait("recorder", 20.0) == 0
    walked = bag.read(tmp_path / "bag")
    assert walked.finished
    assert [phase.name for phase in walked.phases][-len(ahead) :] == ahead
    assert walked.time[0] > 0.0


def at_rest(one: Live) -> bool:
    """Return whether nothing moves for 1.5 s; on a loaded machine some states still arrive at first."""
    before = one.last("joint_states")
    one.spin(1.5)
    after = one.last("joint_states")
    if before is None or after.position != before.position:
        return False
    return not one.config.plant.lockstep or after.header.stamp == before.header.stamp


def test_pause_stops_the_simulated_time_in_lockstep(live: Make) -> None:
    one = live(plant__lockstep=True)
    one.start("integrator")
    one.start("controller")
    one.until_ready("controller/pause")
    one.until(lambda: len(one.got["joint_states"]) > 200, 60.0, "walking")
    assert one.call("controller/pause").success
    one.until(lambda: one.phase == "paused", 10.0, "the pause")
    one.until(lambda: at_rest(one), 20.0, "time standing still")
    before = one.stamp()
    assert one.call("controller/start").success
    one.until(lambda: one.stamp() > before, 10.0, "going on")


# ---------------------------------------------------------------------- real time


def test_a_real_time_walk_follows_the_clock(live: Make) -> None:
    one = live(monitor__rate=20.0)
    for name in ("integrator", "controller", "phase_monitor"):
        one.start(name)
    one.until(lambda: "double_support/left" in one.phases(), 60.0, "the first phase")
    count = len(one.got["joint_states"])
    one.spin(4.0)
    assert len(one.got["joint_states"]) - count > 200  # 800 on an idle machine
    assert one.speeds().max() > 1e-3
    one.until(lambda: any(s.values for s in one.statuses("phase_monitor")), 20.0, "a status with values")
    watched = [s for s in one.statuses("phase_monitor") if s.values]
    keys = {pair.key for pair in watched[-1].values}
    assert {"phase", "error", "distance/tip_plane", "distance/back_plane", "margin/polygon"} <= keys
    assert all(s.level in (b"\x00", b"\x01") for s in watched), [s.message for s in watched if s.level == b"\x02"]
    one.processes.signal("controller", signal.SIGINT)
    assert one.processes.wait("controller", 15.0) == 0
    one.until(lambda: one.speed_of() == 0.0, 10.0, "a zero command at the end")
    one.until(lambda: at_rest(one), 20.0, "the robot standing still")


def test_services_start_pause_and_reset(live: Make) -> None:
    one = live(node__autostart=False)
    began: list[JointState] = []
    one.node.create_subscription(JointState, "phase_start", began.append, LATCHED)
    one.start("integrator")
    one.start("controller")
    one.until(lambda: len(one.got["joint_velocity_commands"]) > 20, 60.0, "commands")
    one.until(lambda: one.phase == "idle", 10.0, "an idle controller")
    assert one.speeds().max() == 0.0

    assert one.call("controller/start").success
    one.until(lambda: one.phase == "double_support/left" and one.speed_of() > 0.0, 10.0, "walking")
    assert one.call("controller/pause").success
    one.until(lambda: one.phase == "paused" and one.speed_of(5) == 0.0, 10.0, "standing still")
    assert one.call("controller/start").success
    one.until(lambda: one.phase == "double_support/left" and one.speed_of() > 0.0, 10.0, "going on")
    assert one.call("controller/reset").success
    one.until(lambda: one.phase == "idle" and one.speed_of(5) == 0.0, 10.0, "the reset")
    assert not one.call("controller/pause").success
    assert one.call("controller/start").success
    one.until(lambda: one.phase == "double_support/left", 10.0, "walking again")
    answered = one.got["joint_velocity_commands"]

    def stamps(messages: list[JointState]) -> set[tuple[int, int]]:
        return {(m.header.stamp.sec, m.header.stamp.nanosec) for m in messages}

    one.until(lambda: len(began) == 2 and stamps(began) <= stamps(answered), 20.0, "phases that began at a state")


def test_an_invalid_state_is_rejected_and_the_walk_continues(live: Make) -> None:
    one = live(plant__command_timeout=10.0)
    names = names_of(one.config)
    one.start("controller")
    one.until(lambda: one.node.count_subscribers("joint_states") > 1, 60.0, "the controller")
    zero = np.zeros(len(names))

    def answer_to(stamp: float) -> bool:
        return any(
            round(m.header.stamp.sec + m.header.stamp.nanosec * 1e-9, 3) == stamp
            for m in one.got["joint_velocity_commands"]
        )

    def accepted(stamp: float, *, order: list[int] | None = None, extra: bool = False) -> None:
        index = order or list(range(len(names)))
        shown = [names[i] for i in index] + (["head_z"] if extra else [])

        def answered() -> bool:  # best effort: a message may be lost
            one.publish_state(shown, np.zeros(len(shown)), stamp)
            one.spin(0.1)
            return answer_to(stamp)

        one.until(answered, 20.0, f"an answer to {stamp}")

    accepted(1.0)
    nan, inf = zero.copy(), zero.copy()
    nan[3], inf[0] = np.nan, -np.inf
    for stamp, (shown, q, dq, expected) in enumerate(
        [
            (names, nan, (), f"not a finite position: {names[3]}"),
            (names, inf, (), f"not a finite position: {names[0]}"),
            (names[1:], zero[1:], (), f"joints missing: {names[0]}"),
            (["wrong", *names[1:]], zero, (), f"joints missing: {names[0]}; it has wrong"),
            ([*names, names[2]], [*zero, 0.0], (), f"joints named twice: {names[2]}"),
            (names, zero[1:], (), "numbers in 'position'"),
            (names, zero, zero[1:], "numbers in 'velocity'"),
            ([], [], (), "joints missing"),
        ],
        start=2,
    ):

        def rejected(
            shown: object = shown, q: object = q, dq: object = dq, expected: str = expected, at: int = stamp
        ) -> bool:
            one.publish_state(shown, q, float(at), dq)
            one.spin(0.1)
            return any(expected in s.message and s.level == b"\x02" for s in one.statuses("controller"))

        one.until(rejected, 20.0, expected)
        assert not answer_to(float(stamp))
    assert "joint_states rejected" in one.processes.log("controller")
    accepted(20.0)
    accepted(21.0, order=list(reversed(range(len(names)))))
    accepted(22.0, extra=True)


def test_an_invalid_command_causes_no_motion(live: Make) -> None:
    from rclpy.qos import QoSProfile

    one = live(plant__lockstep=True)
    names = names_of(one.config)
    commands = one.node.create_publisher(JointState, "joint_velocity_commands", QoSProfile(depth=10))
    one.start("integrator")
    one.until(lambda: one.got["joint_states"], 60.0, "the first state")
    one.until(lambda: commands.get_subscription_count() > 1, 10.0, "the integrator")
    bad = JointState(name=names, velocity=[float("nan")] * len(names))
    commands.publish(bad)
    one.until(lambda: "joint_velocity_commands rejected" in one.processes.log("integrator"), 10.0, "the rejection")
    late = JointState(name=names, velocity=[1.0] * len(names))
    late.header.stamp.sec = 7
    commands.publish(late)
    one.spin(1.0)
    assert {m.header.stamp.nanosec for m in one.got["joint_states"]} == {0}
    commands.publish(JointState(name=names, velocity=[1.0] * len(names)))
    one.until(lambda: one.stamp() > 0.0, 10.0, "the next state")
    np.testing.assert_allclose(
        np.array(one.last("joint_states").position) - one.got["joint_states"][0].position, one.config.dt, atol=1e-12
    )


# ---------------------------------------------------------------------- start and end


SIGNALLED = ["controller", "integrator", "phase_monitor", "poppy_driver", "recorder"]


@pytest.mark.parametrize(
    ("name", "number"),
    [
        *((name, signal.SIGINT) for name in SIGNALLED),
        ("integrator", signal.SIGTERM),
        ("integrator", signal.SIGHUP),
        *(pytest.param(name, signal.SIGTERM, marks=pytest.mark.long) for name in SIGNALLED if name != "integrator"),
    ],
)
def test_a_signal_ends_a_node_without_a_traceback(live: Make, name: str, number: signal.Signals) -> None:
    no_motors = {"dt": 0.02, "poppy.dummy": True} if name == "poppy_driver" else {}
    one = live(**no_motors)
    one.start(name, *(["--bag", str(one.params.parent / "bag")] if name == "recorder" else []))
    one.until_started(name)
    one.processes.signal(name, number)
    assert one.processes.wait(name, 20.0) == 0, one.logs()
    assert "Traceback" not in one.processes.log(name)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/**: {ros__parameters: {gait: {step_lenght: 0.04}}}", "did you mean 'gait.step_length'"),
        pytest.param(
            "/**: {ros__parameters: {gait: {step_length: far}}}",
            "'gait.step_length' must be a number in [-0.5, 0.5], got",
            marks=pytest.mark.long,
        ),
        (
            "/**: {ros__parameters: {gait: {step_length: 99.0}}}",
            "'gait.step_length' must be a number in [-0.5, 0.5], got 99.0",
        ),
        ("/**/controler: {ros__parameters: {dt: 0.01}}", "did you mean 'controller'"),
        ("/**: {ros__parameters: {robot: {urdf: nothing.urdf}}}", "nothing.urdf"),
    ],
)
def test_invalid_parameters_end_a_node_with_exit_code_2(tmp_path: Path, text: str, expected: str) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with private_domain() as domain:
        done = subprocess.run(
            [sys.executable, "-m", "dqwalk_ros.nodes", "controller", "--ros-args", "--params-file", str(file)],
            env=environment(domain),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 2, done.stderr
    assert expected in done.stderr
    assert "Traceback" not in done.stderr


def test_parameters_are_described_and_live_ones_can_be_set(live: Make) -> None:
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import DescribeParameters, SetParameters

    one = live(plant__lockstep=True)
    one.params.write_text(to_yaml(one.config).replace("step_width: 0.0", "step_width: 0"))  # an integer for a float
    one.start("integrator")
    describe = one.node.create_client(DescribeParameters, "integrator/describe_parameters")
    change = one.node.create_client(SetParameters, "integrator/set_parameters")
    one.until(lambda: describe.service_is_ready() and change.service_is_ready(), 60.0, "the parameter services")

    future = describe.call_async(DescribeParameters.Request(names=["gait.step_length", "gait.first_support"]))
    one.until(future.done, 10.0, "the description")
    length, foot = future.result().descriptors
    assert "[m]" in length.description
    assert length.floating_point_range[0].to_value == 0.5
    assert length.read_only
    assert "left, right" in foot.additional_constraints

    def set_to(name: str, value: float) -> object:
        parameter = Parameter(name=name, value=ParameterValue(type=3, double_value=value))
        done = change.call_async(SetParameters.Request(parameters=[parameter]))
        one.until(done.done, 10.0, "the answer")
        return done.result().results[0]

    assert set_to("plant.command_timeout", 0.2).successful
    assert not set_to("plant.command_timeout", -1.0).successful
    assert not set_to("gait.step_length", 0.01).successful


@pytest.mark.parametrize("name", NODES)
def test_help_works_without_ros(name: str) -> None:
    code = (
        f"import sys; sys.modules['rclpy'] = None; sys.argv = ['bin/dqwalk_{name}', '--help']\n"
        "from dqwalk_ros.nodes.command_line import script; script()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    for word in ("Subscribes to", "Example:", f"dqwalk_{name}", f"ros2 run dqwalk_ros {name}", "joint_states"):
        assert word in done.stdout
