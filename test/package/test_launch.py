"""The launch files: the started nodes and, if ROS is installed (`make colcon`), the result of `ros2 launch`."""

from __future__ import annotations

import runpy
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from stand_in_launch import MODULES, Context, Launch, StandIn

from dqwalk_ros.config import SHIPPED, Config, from_yaml, load
from dqwalk_ros.robot.model import load_model, parse_model
from dqwalk_ros.robot.xacro_file import expanded
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.node_table import NODES

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "launch" / "walk.launch.py"
ARGUMENTS = {
    *("config", "plant", "lockstep", "namespace", "use_sim_time", "autostart", "dummy", "respawn"),
    *("log_level", "rviz", "view", "bag", "interface", "params", "set"),
}


@pytest.fixture
def warnings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the warnings that a launch file logs."""
    logged: list[str] = []
    module = Launch("launch.logging")
    module.get_logger = lambda _: types.SimpleNamespace(warning=logged.append)
    monkeypatch.setitem(sys.modules, "launch.logging", module)
    return logged


@pytest.fixture
def defined(monkeypatch: pytest.MonkeyPatch, warnings: list[str]) -> dict[str, Any]:
    """Return the names that the launch file defines."""
    for module in MODULES:
        if module != "launch.logging":
            monkeypatch.setitem(sys.modules, module, Launch(module))
    monkeypatch.delitem(
        sys.modules, "dqwalk_ros.nodes.launching", raising=False
    )  # it has the stand-ins of another test
    return runpy.run_path(str(FILE))


Start = Callable[..., tuple[dict[str, StandIn], list[StandIn]]]


@pytest.fixture
def start(defined: dict[str, Any]) -> Start:
    """Return a function of launch arguments that returns the nodes by name and the other actions."""

    def start(**given: str) -> tuple[dict[str, StandIn], list[StandIn]]:
        actions = defined["nodes"]({name: default for name, (default, *_) in defined["ARGUMENTS"].items()} | given)
        nodes = {one.given["name"]: one for one in actions if type(one).__name__ == "Node"}
        return nodes, [one for one in actions if one not in nodes.values()]

    return start


def config_of(node: StandIn) -> Config:
    """Return the parameters of a node; later ones override earlier ones."""
    config = Config()
    for one in node.given["parameters"]:
        own = {k: v for k, v in one.items() if k != "use_sim_time"} if isinstance(one, dict) else None
        config = config.updated(own) if own is not None else from_yaml(Path(one).read_text(), onto=config)
    return config


def test_every_argument_is_described(defined: dict[str, Any]) -> None:
    assert set(defined["ARGUMENTS"]) == ARGUMENTS
    assert all(len(description) > 20 for _, description, _ in defined["ARGUMENTS"].values())


def test_every_started_node_is_installed(defined: dict[str, Any], start: Start) -> None:
    started = {name for plant in defined["PLANTS"] for name in start(plant=plant, view="true", bag="walk")[0]}
    assert started == set(NODES) - {"pilot", "whole_body_controller", "rigid"}


def test_a_plant_of_your_own_is_run_by_the_node_of_its_kind(start: Start) -> None:
    name = "dqwalk_ros.plants.kinematic:KinematicPlant"
    assert config_of(start(plant=name)[0]["integrator"]).plant.name == name


def exits_of(nodes: dict[str, StandIn], handlers: list[StandIn]) -> dict[str, Callable[[int], list[StandIn]]]:
    """Return for each node what the launch does when it ends with an exit code."""
    events = [handler.args[0] for handler in handlers]
    names = {id(node): name for name, node in nodes.items()}
    return {
        names[id(event.given["target_action"])]: lambda code, event=event: event.given["on_exit"](
            types.SimpleNamespace(returncode=code), None
        )
        for event in events
    }


def test_the_end_of_a_controller_does_not_end_other_nodes(start: Start) -> None:
    """Other robots of the same launch, and the driver with its ~/compliant, must keep running."""
    for plant in ("integrator", "physics", "ros2_control", "poppy"):
        nodes, handlers = start(plant=plant)
        exits = exits_of(nodes, handlers)
        assert set(exits) == set(nodes)
        assert not any(exits[name](code) for name in nodes for code in (0, 1, -9)), plant


def test_a_walk_of_which_a_node_cannot_start_ends(start: Start) -> None:
    """As with a second launch of the same walk, or a recorder whose folder exists."""
    nodes, handlers = start(plant="physics", bag="walk", view="true")
    for name, on_exit in exits_of(nodes, handlers).items():
        with pytest.raises(RuntimeError, match=f"did not start: see the message of {name}"):
            on_exit(2)


def test_in_lockstep_the_end_of_the_controller_ends_its_own_nodes(start: Start) -> None:
    nodes, handlers = start(lockstep="true", bag="walk", namespace="left")
    exits = exits_of(nodes, handlers)
    ended = [one.given["event"] for one in exits["controller"](0)]
    assert {type(event).__name__ for event in ended} == {"ShutdownProcess"}
    targets = [event.given["process_matcher"].args[0] for event in ended]
    assert targets == [node for name, node in nodes.items() if name != "controller"]
    assert not exits["integrator"](0)
    with pytest.raises(RuntimeError, match="the controller ended with 1"):  # else `ros2 launch` exits with 0
        exits["controller"](1)


def test_a_configuration_is_a_file_or_a_shipped_name(start: Start) -> None:
    """`ros2 launch` starts nodes with their defaults if a parameter file is missing: another robot's walk."""
    nodes, _ = start(plant="poppy", config="poppy_dynamic_50hz")
    assert config_of(nodes["controller"]).gait == load("poppy_dynamic_50hz").gait
    for wrong in ("poppy_dynamc", "my_robot/robot.yaml"):
        with pytest.raises(ConfigError, match=f"no configuration.* '{wrong}'"):
            start(plant="ros2_control", config=wrong)


def test_parameters_are_a_file_or_a_shipped_name(start: Start) -> None:
    made = config_of(start(config="poppy_dynamic", params="rough")[0]["controller"])
    assert made.servo.window < load("poppy_dynamic").servo.window
    with pytest.raises(ConfigError, match="no parameter file 'ruff': neither a file nor one of arms, climb, rough"):
        start(params="ruff")


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("confg:=my_robot/robot.yaml", "no argument 'confg:='; did you mean 'config:='"),
        ("plnat:=poppy", "did you mean 'plant:='"),
        ("gait.steps:=4", "'gait.steps' is a parameter: set:='gait.steps=VALUE'"),
    ],
)
def test_an_argument_that_is_misspelt_starts_no_other_walk(defined: dict[str, Any], word: str, expected: str) -> None:
    """`ros2 launch` ignores it: the default robot would walk on the default plant."""
    context = Context({name: default for name, (default, *_) in defined["ARGUMENTS"].items()})
    context.argv = ("config:=poppy", word)
    from dqwalk_ros.nodes.launching import values_of

    with pytest.raises(ConfigError, match=expected):
        values_of(context, defined["ARGUMENTS"])


def test_no_argument_of_a_launch_file_is_taken_for_a_misspelt_one_of_another(
    defined: dict[str, Any], others: dict[str, dict[str, Any]]
) -> None:
    """A launch file that is included sees the command line of the one that includes it."""
    from dqwalk_ros.nodes.launching import values_of

    files = [defined, *others.values()]
    words = tuple(f"{name}:=x" for own in files for name in own["ARGUMENTS"])
    for own in files:
        context = Context({name: default for name, (default, *_) in own["ARGUMENTS"].items()})
        context.argv = (*words, "discovery:=OFF", "model:=robot.urdf", "use_rviz:=true", "params_file:=x")
        values_of(context, own["ARGUMENTS"])


def test_single_parameters_are_applied_last(start: Start) -> None:
    nodes, _ = start(plant="poppy", set="gait.steps=1 dt=0.04 'robot.lock=[head_*, l_arm_*]'")
    config = config_of(nodes["poppy_driver"])
    assert (config.gait.steps, config.dt, config.robot.lock) == (1, 0.04, ("head_*", "l_arm_*"))
    assert config_of(start(set="gait.cycles=1")[0]["controller"]).gait.cycles == 1
    with pytest.raises(ConfigError, match=r"'gait\.step'"):
        start(set="gait.step=1")
    with pytest.raises(ConfigError, match="needs KEY=VALUE"):
        start(set="gait.steps")


def test_the_nodes_of_a_launch_end_with_it(start: Start, others: dict[str, dict[str, Any]]) -> None:
    """Also when `ros2 launch` itself is killed."""
    for plant in ("integrator", "physics", "poppy", "ros2_control"):
        assert all(config_of(node).node.end_with_parent for node in start(plant=plant, view="true")[0].values())
    body = others["whole_body"]["nodes"]({"config": "whole_body", "lockstep": "false", "bag": ""})
    assert [one.given["parameters"][1]["node.end_with_parent"] for one in body if "name" in one.given] == [True] * 2


@pytest.mark.parametrize("plant", ["poppy", "ros2_control"])
def test_a_real_robot_uses_the_balanced_walk_and_waits_for_start(start: Start, plant: str) -> None:
    """With the paper's walk, or with a start at the first state, it would fall."""
    nodes, _ = start(plant=plant)
    for name in ("controller", "poppy_driver" if plant == "poppy" else "drive"):
        config = config_of(nodes[name])
        assert config.gait == load("poppy").gait
        assert not config.node.autostart
    assert config_of(start(plant=plant, autostart="true")[0]["controller"]).node.autostart


def test_each_argument_reaches_the_nodes(start: Start) -> None:
    """`ros2 launch` ignores arguments that are not declared."""
    nodes, _ = start(
        plant="poppy", namespace="left", use_sim_time="true", log_level="debug", respawn="true", dummy="true", bag="b"
    )
    for name, node in nodes.items():
        assert node.given["namespace"] == "left"
        assert node.given["remappings"] == [("/tf", "tf"), ("/tf_static", "tf_static")]
        assert node.given["parameters"][-1] == {"use_sim_time": True}
        assert node.given["ros_arguments"][-2:] == ["--log-level", "debug"]
        assert node.given.get("respawn", False) is (name in ("controller", "phase_monitor"))
    assert config_of(nodes["poppy_driver"]).poppy.dummy
    assert nodes["recorder"].given["arguments"] == ["--bag", "b"]
    assert all(config_of(node).node.wait_for_recorder for node in nodes.values())
    assert config_of(start(plant="integrator", use_sim_time="true")[0]["integrator"]).plant.clock
    assert config_of(start(plant="ros2_control", interface="velocity")[0]["drive"]).output.interface == "velocity"
    assert config_of(start(config=str(ROOT / "config" / "poppy.yaml"))[0]["controller"]).gait == load("poppy").gait


def test_params_replace_what_the_plant_sets_and_a_warning_names_the_rest(
    start: Start, warnings: list[str], tmp_path: Path
) -> None:
    config, params = tmp_path / "robot.yaml", tmp_path / "identified.yaml"
    servo = "{assumed_latency: 0.012, assumed_damping: 0.03}"
    config.write_text(f"/**: {{ros__parameters: {{monitor: {{tolerance: 0.1}}, servo: {servo}}}}}")
    params.write_text("/**: {ros__parameters: {servo: {assumed_latency: 0.012}}}")
    nodes, _ = start(plant="ros2_control", config=str(config), params=str(params))
    for name in ("controller", "drive", "phase_monitor"):
        made = config_of(nodes[name])
        assert (made.servo.assumed_latency, made.servo.assumed_damping) == (0.012, 0.02)
    (warning,) = warnings
    assert "servo.assumed_damping 0.03 by 0.02; to keep one: params:=FILE" in warning
    warnings.clear()
    start(plant="ros2_control", config=str(config), params=str(params), set="servo.assumed_damping=0.03")
    assert not warnings
    with pytest.raises(ConfigError, match=r"no parameter file .*other\.yaml"):
        start(plant="ros2_control", params=str(tmp_path / "other.yaml"))


def test_shipped_configurations_and_those_of_other_packages_start_without_a_warning(
    start: Start, warnings: list[str], defined: dict[str, Any], tmp_path: Path
) -> None:
    for plant in defined["PLANTS"]:
        for config in ("", *(str(ROOT / "config" / f"{name}.yaml") for name in SHIPPED if name != "whole_body")):
            start(plant=plant, config=config)
    foreign = tmp_path / "foreign.yaml"
    foreign.write_text("/arm: {ros__parameters: {port: x}}")
    start(plant="physics", config=str(foreign))
    assert not warnings


@pytest.fixture
def others(monkeypatch: pytest.MonkeyPatch, defined: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the names that the other launch files define, by the name of the file."""
    found = Launch("ament_index_python.packages")  # it finds every package
    found.PackageNotFoundError = KeyError
    monkeypatch.setitem(sys.modules, "ament_index_python", Launch("ament_index_python"))
    monkeypatch.setitem(sys.modules, found.__name__, found)
    files = [file for file in FILE.parent.iterdir() if file != FILE]
    return {file.name.removesuffix(".launch.py"): runpy.run_path(str(file)) for file in files}


def test_ros2_control_passes_its_parameters_to_the_walk(others: dict[str, dict[str, Any]]) -> None:
    own = others["ros2_control"]
    given = {name: default for name, (default, *_) in own["ARGUMENTS"].items()}
    *_, handler = own["nodes"](given | {"params": "identified.yaml", "set": "gait.steps=1"})
    (walk,) = handler.args[0].given["on_exit"]
    passed = dict(walk.given["launch_arguments"])
    assert (passed["params"], passed["set"]) == ("identified.yaml", "gait.steps=1")
    assert load(passed["config"]) == load("poppy")


def test_every_launch_file_refuses_a_configuration_that_does_not_exist(others: dict[str, dict[str, Any]]) -> None:
    for name, own in others.items():
        given = {key: default for key, (default, *_) in own["ARGUMENTS"].items()}
        with pytest.raises(ConfigError, match="no configuration 'whole_bdy'"):
            own["nodes"](given | {"config": "whole_bdy"})
        assert own["nodes"](given), name


def test_nodes_are_discovered_on_this_machine_only_unless_asked_otherwise(
    defined: dict[str, Any], others: dict[str, dict[str, Any]]
) -> None:
    """ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST unless the environment or the argument sets it."""
    for name, own in {"walk": defined, **others}.items():
        actions = own["generate_launch_description"]().args[0]
        declared = {one.args[0]: one.given for one in actions if type(one).__name__ == "DeclareLaunchArgument"}
        assert declared.keys() - {"discovery"} == own["ARGUMENTS"].keys()
        assert type(actions[-1]).__name__ == "OpaqueFunction"
        if name in ("demo", "nav2"):  # they include walk.launch.py
            assert "discovery" not in declared
            continue
        (variable,) = (one for one in actions if type(one).__name__ == "SetEnvironmentVariable")
        assert (variable.args[0], variable.args[1].args) == ("ROS_AUTOMATIC_DISCOVERY_RANGE", ("discovery",))
        default = declared["discovery"]["default_value"]
        assert (type(default).__name__, default.args) == ("EnvironmentVariable", ("ROS_AUTOMATIC_DISCOVERY_RANGE",))
        assert default.given == {"default_value": "LOCALHOST"}


def test_every_node_has_its_enclave(defined: dict[str, Any], others: dict[str, dict[str, Any]]) -> None:
    for own in (defined, others["ros2_control"], others["whole_body"]):
        given = {key: default for key, (default, *_) in own["ARGUMENTS"].items()}
        nodes = [one for one in own["nodes"](given) if type(one).__name__ == "Node"]
        assert nodes
        for node in nodes:
            name = node.given.get("name", node.given["executable"])
            assert node.given["ros_arguments"][:2] == ["--enclave", f"/dqwalk/{name}"]


def test_the_demo_is_a_steered_walk_in_physics_on_the_page(others: dict[str, dict[str, Any]], start: Start) -> None:
    own = others["demo"]
    given = {name: default for name, (default, *_) in own["ARGUMENTS"].items()}
    for changes, timeout in (("", 1.0), ("gait.cmd_vel_timeout=2.0", 2.0)):
        (walk,) = own["nodes"](given | {"set": changes})
        nodes, _ = start(**dict(walk.given["launch_arguments"]))
        assert set(nodes) == {"controller", "phase_monitor", "physics", "viewer"}
        config = config_of(nodes["controller"])
        assert (config.gait.style, config.gait.steps, config.gait.cmd_vel_timeout) == ("dynamic", 0, timeout)
        assert config.node.autostart
        assert config.plant.imu


def test_nav2_steers_the_demo_within_its_limits(others: dict[str, dict[str, Any]]) -> None:
    """Each managed node has parameters under its name, and wanted velocities reach the walk through the smoother."""
    own = others["nav2"]
    given = {name: default for name, (default, *_) in own["ARGUMENTS"].items()}
    walk, *started = own["nodes"](given | {"set": "gait.lead=1"})
    assert dict(walk.given["launch_arguments"])["set"] == "gait.lead=1"
    nodes = {one.given["name"]: one.given for one in started}
    managed = nodes["lifecycle_manager"]["parameters"][0]["node_names"]
    parameters = yaml.safe_load((ROOT / "config" / "nav2" / "nav2.yaml").read_text())
    assert set(managed) | {"local_costmap", "global_costmap"} == set(parameters)
    assert set(nodes) == {*managed, "lifecycle_manager", "map"}
    alone = own["nodes"](given | {"walk": "false", "fixed": "false"})
    assert [one.given["name"] for one in alone] == [*managed, "lifecycle_manager"]
    renamed = {name: dict(nodes[name]["remappings"]) for name in managed}
    assert {name for name, topics in renamed.items() if topics.get("cmd_vel") == "cmd_vel_nav"} == {
        "controller_server", "behavior_server", "velocity_smoother",
    }  # fmt: skip
    assert [name for name, topics in renamed.items() if "cmd_vel" in topics.values()] == ["velocity_smoother"]


def test_nav2_that_is_not_installed_is_named(others: dict[str, dict[str, Any]]) -> None:
    def missing(package: str) -> str:
        raise KeyError(package)

    own = others["nav2"]
    own["nodes"].__globals__["get_package_prefix"] = missing
    with pytest.raises(RuntimeError, match="sudo apt install ros-jazzy-navigation2"):
        own["nodes"]({name: default for name, (default, *_) in own["ARGUMENTS"].items()})


def test_rviz_shows_exactly_the_published_joints(start: Start) -> None:
    """RobotModel fails if the description has 25 joints and joint_states has 10."""
    nodes, _ = start(rviz="true")
    (described,) = (p for p in nodes["robot_state_publisher"].given["parameters"] if "robot_description" in p)
    joints = ElementTree.fromstring(described["robot_description"]).iter("joint")
    config = config_of(nodes["controller"])
    published = load_model(config.robot).joint_names
    assert {joint.get("name") for joint in joints if joint.get("type") != "fixed"} == set(published)
    assert not config.node.robot_description  # robot_state_publisher publishes it
    assert Path(nodes["rviz2"].given["arguments"][-1]).is_file()


def test_the_ros2_control_description_matches_the_walking_robot() -> None:
    """All joints have both command interfaces; controllers list them in the order that the node drive uses."""
    config = load("poppy")
    urdf = expanded(ROOT / "urdf" / "poppy.ros2_control.urdf.xacro", arguments={"plugin": "a/Plugin"}).text.decode()
    assert parse_model(urdf, config.robot).joint_names == load_model(config.robot).joint_names
    root = ElementTree.fromstring(urdf)
    (component,) = root.iter("ros2_control")
    assert component.findtext("hardware/plugin") == "a/Plugin"
    moving = {joint.get("name") for joint in root.iter("joint") if joint.get("type") == "revolute"}
    commanded = {joint.get("name"): [i.get("name") for i in joint.iter("command_interface")] for joint in component}
    assert {name for name, interfaces in commanded.items() if interfaces} == moving
    assert all(interfaces in ([], ["position", "velocity"]) for interfaces in commanded.values())
    controllers = yaml.safe_load((ROOT / "config" / "ros2_control" / "controllers.yaml").read_text())
    for interface in ("position", "velocity"):
        controller = controllers[f"/**/forward_{interface}_controller"]["ros__parameters"]
        assert controller["interface_name"] == interface
        assert tuple(controller["joints"]) == load_model(config.robot).joint_names
    assert 1.0 / controllers["/**/controller_manager"]["ros__parameters"]["update_rate"] == config.dt


@pytest.mark.native
def test_ros2_launch_reads_the_launch_file() -> None:
    """Needs an installed ROS: the ROS wheels do not contain `launch`."""
    import launch
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    description = PythonLaunchDescriptionSource(str(FILE)).get_launch_description(launch.LaunchContext())
    arguments = {argument.name: argument for argument in description.get_launch_arguments()}
    assert set(arguments) == {*ARGUMENTS, "discovery"}
