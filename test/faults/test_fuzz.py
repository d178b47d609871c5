"""Random invalid robots, parameter files and messages: rejected with an error, in bounded time and memory.

`make fuzz` runs 10 000 of them, the default suite a hundred.
"""

from __future__ import annotations

import dataclasses
import os
import re
import resource
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dqwalk_ros.config import from_yaml, load, to_yaml
from dqwalk_ros.nodes.joint_order import JointOrder
from dqwalk_ros.nodes.state_gate import StateGate
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError, ModelError, StateError

INPUTS = int(os.environ.get("DQWALK_FUZZ", "120"))
MEMORY = 500 * 1024  # [kB] of the process, if only these tests run in it (make fuzz)
GROWTH = 100 * 1024  # [kB] if other tests ran in the process before
ALLOWED = {"memory": MEMORY}
ROOT = Path(__file__).resolve().parents[2]
URDF = (ROOT / "test" / "data" / "biped12.urdf").read_text(encoding="utf-8")
YAML = to_yaml(load("paper"))
MODEL = load_model(load("paper").robot)

fuzzed = settings(
    max_examples=max(INPUTS // 6, 1), deadline=2000, suppress_health_check=list(HealthCheck), print_blob=False
)
WORDS = [
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1",
    "0",
    "",
    "1 2",
    "x" * 5000,
    "9" * 400,
    "&a;",
    "*a",
    "&a",
    "[",
    "{",
    "!!x",
    "\x00",
    "\ud7ff",
]
junk = st.sampled_from(WORDS) | st.text(max_size=20) | st.floats().map(repr) | st.integers().map(str)


def peak_memory() -> int:
    """Return the peak memory of this process [kB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.fixture(autouse=True)
def limit(monkeypatch: pytest.MonkeyPatch) -> None:
    before = peak_memory()
    monkeypatch.setitem(ALLOWED, "memory", MEMORY if before < MEMORY - GROWTH else before + GROWTH)


def check_memory() -> None:
    assert peak_memory() < ALLOWED["memory"]


def mutated(text: str, pattern: str) -> st.SearchStrategy[str]:
    """Replace, delete, duplicate or swap pieces of a text."""
    pieces = re.split(pattern, text)
    place = st.integers(0, len(pieces) - 1)
    change = st.tuples(st.sampled_from(["set", "cut", "copy", "swap"]), place, place, junk)

    def apply(changes: list[tuple[str, int, int, str]]) -> str:
        out = list(pieces)
        for how, i, j, value in changes:
            i, j = i % len(out), j % len(out)
            if how == "set":
                out[i] = value
            elif how == "cut" and len(out) > 1:
                del out[i]
            elif how == "copy":
                out.insert(j, out[i])
            else:
                out[i], out[j] = out[j], out[i]
        return "".join(out)

    return st.lists(change, min_size=1, max_size=6).map(apply)


def load_text(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_bytes(data)
        try:
            model = load_model(dataclasses.replace(load("paper").robot, urdf=str(path)))
        except ModelError:
            return
        assert np.isfinite(model.q_min).all()
        assert (model.q_min < model.q_max).all()
        assert model.mass > 0.0
    check_memory()


@fuzzed
@given(text=mutated(URDF, r"(<[^>]*>|\n)"))
def test_robots_with_modified_elements(text: str) -> None:
    load_text(text.encode("utf-8", "surrogatepass"))


@fuzzed
@given(text=mutated(URDF, r'("[^"]*")'))
def test_robots_with_modified_values(text: str) -> None:
    load_text(text.encode("utf-8", "surrogatepass"))


@fuzzed
@given(data=st.binary(max_size=2000) | st.binary(max_size=300).map(lambda b: b"<robot name='r'>" + b + b"</robot>"))
def test_robots_of_random_bytes(data: bytes) -> None:
    load_text(data)


@fuzzed
@given(text=mutated(YAML, r"(: |\n *)"))
def test_modified_parameter_files(text: str) -> None:
    try:
        config = from_yaml(text, source="f")
    except ConfigError:
        return
    assert from_yaml(to_yaml(config)) == config
    check_memory()


@fuzzed
@given(
    text=st.text(max_size=500) | st.lists(junk, max_size=30).map("".join) | st.lists(junk, max_size=30).map("\n".join)
)
def test_parameter_files_of_random_text(text: str) -> None:
    try:
        from_yaml(text, source="f")
    except ConfigError:
        return
    check_memory()


numbers = st.lists(st.floats(width=64) | st.just(0.0), max_size=20)
some_names = st.lists(st.sampled_from([*MODEL.joint_names, "head", ""]) | st.text(max_size=5), max_size=20)


@fuzzed
@given(
    messages=st.lists(
        st.tuples(
            st.just(list(MODEL.joint_names)) | st.permutations(MODEL.joint_names) | some_names,
            st.just([0.0] * MODEL.n) | st.lists(st.floats(), min_size=MODEL.n, max_size=MODEL.n) | numbers,
            st.integers(-(2**62), 2**62),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_random_messages(messages: list[tuple[list[str], list[float], int]]) -> None:
    order, gate = JointOrder(MODEL.joint_names), StateGate(MODEL, 0.005, lambda: 0.1)
    for names, values, stamp in messages:
        try:
            q = order(names, values, "position")
            if gate.is_new(stamp):
                gate.accept(stamp, State(0.0, q))
        except StateError:
            continue
        assert np.isfinite(q).all()
        assert q.shape == (MODEL.n,)
