"""A stand-in for the command `ros2`, which the wheels of ROS lack, as far as the documentation uses it.

usage: stand_in_ros2.py run | launch | topic pub | service call | param set, with the words of `ros2`
"""

from __future__ import annotations

import contextlib
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from stand_in_launch import MODULES, Launch, StandIn

ROOT = Path(__file__).resolve().parents[2]


def run(package: str, name: str, *words: str) -> int:
    """Become a node of the package, or `dqwalk`."""
    assert package == "dqwalk_ros"
    program = [str(Path(sys.executable).parent / "dqwalk")] if name == "dqwalk" else node_program(name)
    os.execv(program[0], [*program, *words])


def node_program(name: str) -> list[str]:
    return [sys.executable, str(ROOT / "scripts" / name)]


# ---------------------------------------------------------------------- launch


def launch(package: str, file: str, *words: str) -> int:
    """Start what a launch file describes, until it has ended or Ctrl-C."""
    assert package == "dqwalk_ros"
    for name in MODULES:
        sys.modules[name] = Launch(name)
    sys.modules["launch.logging"].get_logger = lambda _: types.SimpleNamespace(warning=print)  # type: ignore[attr-defined]
    actions = actions_of(ROOT / "launch" / file, dict(word.split(":=", 1) for word in words))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    nodes = [one for one in actions if type(one).__name__ == "Node"]
    exits = [one.args[0].given for one in actions if type(one).__name__ == "RegisterEventHandler"]
    with tempfile.TemporaryDirectory() as folder:
        running = {one: subprocess.Popen(command_of(one, Path(folder))) for one in nodes}
        failed = True
        try:
            while running:
                time.sleep(0.05)
                for one in [one for one in running if running[one].poll() is not None]:
                    code = running.pop(one).returncode
                    for ended in (given["on_exit"] for given in exits if given["target_action"] is one):
                        for event in ended(types.SimpleNamespace(returncode=code), None) if callable(ended) else ended:
                            end(event.given["event"], running)
            failed = False
        except KeyboardInterrupt:
            failed = False
        except RuntimeError as error:
            print(f"[ERROR] [launch]: {error}", flush=True)
        for process in running.values():
            process.send_signal(signal.SIGINT)
        for process in running.values():
            process.wait(30.0)
    return 1 if failed else 0


def actions_of(file: Path, given: dict[str, str]) -> list[StandIn]:
    """Return the actions of a launch file, and of those that it includes."""
    own = runpy.run_path(str(file))
    assert given.keys() <= own["ARGUMENTS"].keys(), f"{file.name} has no arguments {given.keys()}"
    found = []
    values = {name: default for name, (default, *_) in own["ARGUMENTS"].items()} | given
    for one in own["nodes"](values):
        included = type(one).__name__ == "IncludeLaunchDescription"
        found += actions_of(Path(one.args[0].args[0]), dict(one.given["launch_arguments"])) if included else [one]
    return found


def command_of(node: StandIn, folder: Path) -> list[str]:
    """Return the command line of a node, with its parameters in files as launch_ros writes them."""
    given = node.given
    assert given["package"] == "dqwalk_ros", f"{given['package']} is not installed"
    words = [*node_program(given["executable"]), *given.get("arguments", ()), "--ros-args", *given["ros_arguments"]]
    words += ["-r", f"__node:={given['name']}"]
    if given.get("namespace"):
        words += ["-r", f"__ns:=/{given['namespace']}"]
    for old, new in given.get("remappings", ()):
        words += ["-r", f"{old}:={new}"]
    for k, one in enumerate(given["parameters"]):
        if isinstance(one, dict):
            file = folder / f"{given['name']}{k}.yaml"
            values = {key: list(value) if isinstance(value, tuple) else value for key, value in one.items()}
            file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
            one = str(file)
        words += ["--params-file", one]
    return words


def end(event: StandIn, running: dict[StandIn, subprocess.Popen[bytes]]) -> None:
    """Execute a ShutdownProcess of one node, or a Shutdown of all."""
    one = event.given["process_matcher"].args[0] if "process_matcher" in event.given else None
    for process in running.values() if one is None else [running[one]] if one in running else []:
        process.send_signal(signal.SIGINT)


# ---------------------------------------------------------------------- topics, services, parameters


def interface(name: str, kind: str) -> Any:
    """Return the class of an interface such as std_msgs/msg/String."""
    package, middle, cls = name.split("/")
    assert middle == kind
    return getattr(__import__(f"{package}.{kind}", fromlist=[cls]), cls)


def filled(message: Any, given: dict[str, Any]) -> Any:
    """Set the fields of a message; an unknown field or a wrong type is an error of rclpy."""
    kinds = message.get_fields_and_field_types()
    for key, value in given.items():
        old = getattr(message, key)
        if isinstance(value, dict):
            filled(old, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            cls = interface(kinds[key].removeprefix("sequence<").removesuffix(">").replace("/", "/msg/"), "msg")
            setattr(message, key, [filled(cls(), one) for one in value])
        else:
            setattr(message, key, float(value) if isinstance(old, float) else value)
    return message


def with_node(use: Callable[[Any], int]) -> int:
    """Call a function with a node that is handled in it by `spin_once`."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node(f"ros2_{os.getpid()}")
    with contextlib.suppress(KeyboardInterrupt):
        return use(node)
    return 0


def pub(*words: str) -> int:
    """Publish a message once, when there is a subscriber, or at a rate."""
    *options, topic, kind, text = words
    rate = float(options[1]) if options[0] == "-r" else None
    assert rate or options == ["--once"]
    message = filled(interface(kind, "msg")(), yaml.safe_load(text))

    def publish(node: Any) -> int:
        publisher = node.create_publisher(type(message), topic, 1)
        while publisher.get_subscription_count() < 1:
            time.sleep(0.05)
        while True:
            publisher.publish(message)
            time.sleep(1.0 / rate if rate else 0.5)
            if not rate:
                return 0

    return with_node(publish)


def called(node: Any, cls: Any, name: str, request: Any) -> Any:
    """Return the response of a service."""
    import rclpy

    client = node.create_client(cls, name)
    assert client.wait_for_service(60.0), f"there is no service {name}"
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
    return future.result()


def call(name: str, kind: str, text: str = "{}") -> int:
    """Call a service; the exit code is that of its success."""
    cls = interface(kind, "srv")
    request = filled(cls.Request(), yaml.safe_load(text))

    def ask(node: Any) -> int:
        response = called(node, cls, name, request)
        print(response, flush=True)
        return 0 if response.success else 1

    return with_node(ask)


def put(name: str, key: str, value: str) -> int:
    """Set a parameter of a node."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    wanted = Parameter(key, value=yaml.safe_load(value)).to_parameter_msg()

    def ask(node: Any) -> int:
        (result,) = called(
            node, SetParameters, f"{name}/set_parameters", SetParameters.Request(parameters=[wanted])
        ).results
        print("Set parameter successful" if result.successful else f"Setting parameter failed: {result.reason}")
        return 0 if result.successful else 1

    return with_node(ask)


VERBS: dict[str, Callable[..., int]] = {
    "run": run, "launch": launch, "topic pub": pub, "service call": call, "param set": put,
}  # fmt: skip

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where a shell has it ignored
    one, two, *_ = sys.argv[1:]
    verb = one if one in VERBS else f"{one} {two}"
    sys.exit(VERBS[verb](*sys.argv[1 + len(verb.split()) :]))
