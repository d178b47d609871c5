"""The SROS 2 policy allows exactly what the nodes use, and by default the nodes are visible on this machine only."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from stepped_time import SteppedTime

from dqwalk_ros.config import find_share, load, with_files
from dqwalk_ros.support.node_table import NODES

ROOT = Path(__file__).resolve().parents[2]
WAYS = ("publish", "subscribe", "reply", "request")
Rights = dict[str, set[str]]


def resolved(name: str, node: str) -> str:
    """Return a name of the policy in its absolute form; it may be absolute, private or relative to `/`, as in sros2."""
    if name.startswith("~/"):
        return f"/{node}/{name[2:]}"
    return name if name.startswith("/") else f"/{name}"


def policy() -> dict[str, Rights]:
    """Return the rights of each node."""
    out: dict[str, Rights] = {}
    for enclave in ElementTree.parse(find_share("config/security", "policy.xml")).getroot().iter("enclave"):
        (profile,) = enclave.iter("profile")
        node = profile.get("node", "")
        assert enclave.get("path") == f"/dqwalk/{node}"
        rights = out[node] = {way: set() for way in WAYS}
        for group in profile:
            ((way, qualifier),) = group.attrib.items()
            assert qualifier == "ALLOW"
            assert way in (("publish", "subscribe") if group.tag == "topics" else ("reply", "request"))
            names = [resolved(item.text or "", node) for item in group]
            assert {item.tag for item in group} == {group.tag[:-1]}
            assert len(names) == len(set(names)), f"{node}: a name occurs twice"
            rights[way] |= set(names)
    return out


def test_the_policy_follows_the_sros2_schema() -> None:
    """Elements, attributes and their order follow the schema of sros2 [REP-2022, version 0.2.0]."""
    root = ElementTree.parse(ROOT / "config/security/policy.xml").getroot()
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    assert [child.tag for child in root] == ["enclaves"]
    for enclave in root[0]:
        assert (enclave.tag, set(enclave.attrib)) == ("enclave", {"path"})
        (profiles,) = enclave
        (profile,) = profiles
        assert (profiles.tag, profile.tag, set(profile.attrib)) == ("profiles", "profile", {"ns", "node"})
        assert {group.tag for group in profile} == {"topics", "services"}
        assert all(re.fullmatch(r"[~/]?[a-z_/]+", item.text or "") for group in profile for item in group)


def test_every_node_has_an_enclave_and_the_operator_may_call_every_service() -> None:
    rights = policy()
    assert set(rights) == {*NODES, "operator"}
    ours = {s for node in NODES for s in rights[node]["reply"] if "parameter" not in s and "type_desc" not in s}
    assert rights["operator"]["request"] == ours


OWN = {"recorder": ["--bag", "bag"], "viewer": ["--port", "0"], "pilot": ["--cmd-vel", "0.01,0,0,1"]}
PAPER = load("paper").updated({"dt": 0.02, "poppy.dummy": True})
STEERED = with_files(load("poppy"), [Path("arms")]).updated(
    {"dt": 0.02, "gait.steps": 0, "plant.imu": True, "plant.foot_force": True}
)
CONFIGS = dict.fromkeys(("controller", "physics", "pilot"), STEERED)
CONFIGS |= dict.fromkeys(("whole_body_controller", "rigid"), load("whole_body"))


@pytest.mark.parametrize("name", NODES)
def test_nodes_use_exactly_the_rights_of_the_policy(
    name: str, make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The publishers, subscriptions, services and clients of each node, started in this process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(SteppedTime, "passes", 1e-3)  # the driver uses angles of three times
    node, expected = make(name, CONFIGS.get(name, PAPER), *OWN.get(name, [])).node, policy()[name]
    found = {
        "publish": node.get_publisher_names_and_types_by_node(name, "/"),
        "subscribe": node.get_subscriber_names_and_types_by_node(name, "/"),
        "reply": node.get_service_names_and_types_by_node(name, "/"),
        "request": node.get_client_names_and_types_by_node(name, "/"),
    }
    does = {way: {topic for topic, _ in names} for way, names in found.items()}
    if importlib.util.find_spec("tf2_msgs") is None and name == "controller":
        expected["publish"] -= {"/tf", "/tf_static"}  # the wheels of ROS have no tf2_msgs
    if name == "recorder":  # it subscribes to them as soon as they are published
        from dqwalk_ros.support.topics import OTHERS

        expected["subscribe"] -= {resolved(topic, name) for topic in OTHERS}
        does["subscribe"] -= {"/rosout"}
    if name == "drive":  # it asks each controller that it finds for its parameters
        expected["request"] -= {"/forward_position_controller/get_parameters"}
    node.close()
    assert does == expected


def test_a_secured_node_does_not_start_without_its_keys(tmp_path: Path) -> None:
    """It logs the reason and exits with code 2."""
    from dqwalk_ros.cli.runner import environment, private_domain

    secured = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
    }
    with private_domain() as domain:
        done = subprocess.run(
            [sys.executable, "-m", "dqwalk_ros.nodes", "integrator", "--ros-args", "--enclave", "/dqwalk/integrator"],
            env={**environment(domain), **secured},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 2
    assert "SECURITY ERROR" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_runner_limits_discovery_to_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    from dqwalk_ros.cli.runner import environment

    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    assert environment(None)["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
