"""A user's own plant: one class, named on the command line and in the launch file, walks like those of the table."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from dqwalk_ros import cli
from dqwalk_ros.config import Config
from dqwalk_ros.plants.table import PHYSICS, PLANTS, SIMULATORS, entry, plant_type
from dqwalk_ros.support.errors import ConfigError, PlantError
from dqwalk_ros.walks.table import walk_type

OWN = '''
from pathlib import Path

from dqwalk_ros.plants.kinematic import KinematicPlant


class Counting(KinematicPlant):
    """Writes how many periods it has executed."""

    def step(self, command, dt):
        state = super().step(command, dt)
        Path(__file__).with_name("periods").write_text(str(self._periods))
        return state
'''
SHORT = ("--set", "gait.step_length=0.02", "--set", "task.eta=1", "--set", "dsp.stall_rate=3e-3")
SHORT += ("--set", "dsp.eta_ground=100", "--set", "ssp.threshold=0.02", "--no-figures", "--quiet")


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of an own plant in a module on the path of this process and of those it starts."""
    (tmp_path / "counting.py").write_text(OWN, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "counting", raising=False)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]))
    return "counting:Counting"


def test_every_plant_of_the_table_can_be_made_or_names_its_node() -> None:
    for name, each in PLANTS.items():
        assert entry(name) is each
        if not each.type:
            with pytest.raises(PlantError, match=each.node):
                plant_type(name)
    assert set(PHYSICS) < set(SIMULATORS) < set(PLANTS)


@pytest.mark.parametrize(
    "name",
    ["no_such", "os:path", "dqwalk_ros.plants.base:Plant", "dqwalk_ros.plants.kinematic:Nothing", "no_module:Plant"],
)
def test_what_is_no_plant_is_an_error(name: str) -> None:
    with pytest.raises(PlantError, match=name):
        plant_type(name)


@pytest.mark.parametrize("body", ["raise RuntimeError('broken')", "1 / 0", "class Own(:", "import no_such_module"])
def test_a_module_that_cannot_be_imported_is_an_error(
    body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of MuJoCo, where MUJOCO_GL names no library."""
    (tmp_path / "broken_module.py").write_text(body, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlantError, match=r"'broken_module:Own'; the class cannot be imported: ."):
        plant_type("broken_module:Own")
    with pytest.raises(ConfigError, match=r"'broken_module:Own'; the class cannot be imported: ."):
        walk_type(Config().updated({"gait.walk": "broken_module:Own"}))


@pytest.mark.parametrize("command", ["simulate", pytest.param("walk", marks=pytest.mark.long)])
def test_an_own_plant_walks(own: str, tmp_path: Path, command: str) -> None:
    """In one process, and as a node."""
    out = tmp_path / "out"
    assert cli.main([command, "--plant", own, "--out", str(out), *SHORT]) == 0
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert int((tmp_path / "periods").read_text(encoding="utf-8")) >= report["walk"]["ticks"] - 1 > 100
