"""Data never name code: the class of a walk is imported only where the user has named it."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest
from recorded import short_walk
from std_msgs.msg import String

from dqwalk_ros import cli
from dqwalk_ros.config import load, to_yaml
from dqwalk_ros.report import bag
from dqwalk_ros.support.errors import BagError

PAPER = load("paper")


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of a module with a walk, which says when it is imported."""
    (tmp_path / "strange_walk.py").write_text(
        "import pathlib\nfrom dqwalk_ros.paper.walk import PaperWalk\n"
        f"pathlib.Path({str(tmp_path / 'imported')!r}).touch()\n\n\nclass Mine(PaperWalk):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "strange_walk", raising=False)
    return "strange_walk:Mine"


@pytest.fixture
def recorded(tmp_path: Path, module: str) -> Path:
    """Return the bag of a walk of that class, with the class also in a later change of parameters."""
    walked = short_walk()
    bag.write(walked, tmp_path / "plain", diagnostics=False)
    named = walked.config.updated({"gait.walk": module})
    phases = tuple(dataclasses.replace(record, config=named) for record in walked.phases)
    bag.write(dataclasses.replace(walked, phases=phases, config=named), tmp_path / "bag", diagnostics=False)
    (tmp_path / "imported").unlink(missing_ok=True)
    sys.modules.pop("strange_walk", None)
    return tmp_path / "bag"


@pytest.mark.parametrize("command", ["report", "view", "movie", "identify", "replay"])
def test_no_command_imports_what_a_bag_names(
    command: str, recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main([command, str(recorded), *(["--port", "0"] if command == "view" else [])]) == 1
    assert "'strange_walk:Mine', which is not imported" in capsys.readouterr().err
    assert not (tmp_path / "imported").exists()


def test_the_user_may_name_it(recorded: Path, module: str, tmp_path: Path) -> None:
    command = ["report", str(recorded), "--no-figures", "--quiet", "--out", str(tmp_path / "out")]
    assert cli.main([*command, "--walk", module]) == 0
    assert (tmp_path / "imported").exists()
    with pytest.raises(BagError, match="not imported because data name it"):
        bag.read(recorded, walk="strange_walk:Other")


@pytest.mark.parametrize("node", ["phase_monitor", "viewer"])
def test_no_node_imports_what_a_topic_names(make: Any, node: str, module: str, tmp_path: Path) -> None:
    one = make(node, PAPER, *(["--port", "0"] if node == "viewer" else []))
    named = PAPER.updated({"gait.walk": module})
    one.send("walk_config", String(data=to_yaml(named)))
    assert "not imported because data name it" in one.log
    assert one.node._phases.config is None
    one.send("walk_config", String(data=to_yaml(PAPER)))
    one.send("walk_config", String(data=to_yaml(named, 10)))  # changed during the walk
    assert not one.node._phases._tuned
    assert not (tmp_path / "imported").exists()
    trusting = make(node, named, *(["--port", "0"] if node == "viewer" else []))
    trusting.send("walk_config", String(data=to_yaml(named)))
    assert trusting.node._phases.config == named
