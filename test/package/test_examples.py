"""Every example runs, prints the expected output and writes no file."""

from __future__ import annotations

import runpy
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from recorded import SHORT

from dqwalk_ros.cli.runner import environment
from dqwalk_ros.config import load
from dqwalk_ros.report.figures import figure8

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = {
    "one_tick": "largest KKT residual",
    "walk": "OK: every constraint was kept",
    "bag_to_figure": "401 of 401 states",
    "physics": "finished after",
    "push": "it stands",
    "study": "0.02 m: finished True",
    "own_constraint": "com_above",
    "own_robot": "201 states of double_support/left",
    "whole_body": "it stands; the hand",
    "ros_node": "first command",
}


def test_every_example_is_listed():
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == set(EXAMPLES)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run_and_print_the_expected_output(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [name])
    monkeypatch.setattr("dqwalk_ros.report.figures.FIGURES", {"figure8": (figure8, "")})  # drawing takes long
    if name == "walk":  # as slow as the paper's it has 60 000 states
        monkeypatch.setattr("dqwalk_ros.load", lambda source: load(source).updated(SHORT), raising=False)
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")
    assert EXAMPLES[name] in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_the_ros_node_walks_with_the_integrator(nodes, domain):
    live = nodes(load("paper"))
    live.start("integrator")
    command = [sys.executable, str(ROOT / "examples" / "ros_node.py"), "--spin"]
    with subprocess.Popen(command, env=environment(domain)) as process:
        try:
            states = live.got["joint_states"]
            live.until(lambda: states and max(map(abs, states[-1].position)) > 0.02, 120.0, "a motion of 0.02 rad")
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) == 0
        finally:
            process.kill()
