"""Start-up time: heavy modules are imported when needed, and compilation is announced."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dqwalk_ros.config import load
from dqwalk_ros.robot import model

ROOT = Path(__file__).resolve().parents[2]


def python(code: str, here: Path = ROOT, **env: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=here, env=os.environ | env)
    assert done.returncode == 0, done.stderr
    return done


OPTIONAL = ("mujoco", "viser", "pinocchio", "daqp", "distributed", "pyarrow", "trimesh", "dynamixel_sdk")
WALK = ("report.bag", "report.html.page", "report.figures.paper", "cli.report", "cli.walk", "cli.results", "cli.runner")
MODEL = (
    "from dqwalk_ros.config import load\nfrom dqwalk_ros.robot.model import load_model\nload_model(load('paper').robot)"
)
HEAVY = ("numpy", "scipy", "numba", "clarabel", "matplotlib", "yourdfpy", "rclpy", "yaml", "msgspec", "rosbags", "tqdm")
PROCESSES = {
    "help": [("import dqwalk_ros.cli\ndqwalk_ros.cli.main(['simulate', '--help'])", HEAVY)],
    "small nodes": [  # the model is remembered
        ("import dqwalk_ros.nodes.pilot, dqwalk_ros.nodes.recorder", ("numba", "yourdfpy")),
        (f"import dqwalk_ros.nodes.plant, dqwalk_ros.plants.kinematic\n{MODEL}", ("numba", "yourdfpy")),
    ],
    "solvers": [  # the slow parts of scipy
        (
            "from dqwalk_ros import controller\nfrom dqwalk_ros.paper.qp import make_solver\n"
            "make_solver('clarabel'), make_solver('daqp')",
            ("scipy.sparse", "scipy.optimize"),
        )
    ],
    "walk": [
        (
            "from dqwalk_ros import simulation, controller\nfrom dqwalk_ros.plants import kinematic",
            (*OPTIONAL, "rclpy", "matplotlib"),
        ),
        (
            "import dqwalk_ros.nodes.controller, dqwalk_ros.nodes.phase_monitor",
            (*OPTIONAL, "matplotlib", "scipy.spatial", "scipy.optimize"),
        ),
        ("import dqwalk_ros.report as a\na.report, a.analyse, a.render", ("matplotlib",)),
        ("\n".join(f"import dqwalk_ros.{name}" for name in WALK), OPTIONAL),  # `make walk` installs no extras
    ],
}
"""What is imported in a process, in this order, and modules that are not to be imported then."""


@pytest.mark.parametrize("name", PROCESSES)
def test_modules_are_imported_when_needed(name):
    model._remembered.cache_clear()
    model.load_model(load("paper").robot)  # remembered on disk
    lines = ["import sys"]
    for code, unused in PROCESSES[name]:
        lines += [code, f"assert not [name for name in {unused!r} if name in sys.modules]"]
    python("\n".join(lines))


CODE = "import numpy as np\nfrom dqwalk_ros.paper.kinematics import compose\nx = np.eye(8)[0]\nprint(compose(x, x))"
ANNOUNCED = "compiling for this machine"


def test_a_compiled_function_calls_only_modules_that_its_digest_contains():
    """The digest follows `from MODULE import NAME`; of a module that is imported from its package it has nothing."""
    for file in (ROOT / "dqwalk_ros").rglob("*.py"):
        if "jit" not in (text := file.read_text(encoding="utf-8")):
            continue
        for found in ast.walk(ast.parse(text)):
            assert not isinstance(found, ast.Import) or not any("dqwalk_ros" in name.name for name in found.names), file
            if isinstance(found, ast.ImportFrom) and (found.module or "").startswith("dqwalk_ros"):
                place = ROOT.joinpath(*found.module.split("."))
                modules = [n.name for n in found.names if place.joinpath(f"{n.name}.py").is_file()]
                assert not modules, f"{file}: import names from {found.module}.{modules[0]}"


def test_compilation_is_announced_and_repeated_when_only_a_called_function_changes(tmp_path):
    """numba itself checks only the file of the function."""
    package = tmp_path / "dqwalk_ros"
    shutil.copytree(ROOT / "dqwalk_ros", package, ignore=shutil.ignore_patterns("__pycache__"))
    here = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_DISABLE_JIT": "0", "PYTHONPATH": str(tmp_path)}
    first = python(CODE, tmp_path, **here)
    assert first.stderr.count(ANNOUNCED) == 1
    other = package / "paper" / "statics.py"  # has compiled functions that `compose` does not call
    other.write_text(other.read_text().replace("GRAVITY = 9.8", "GRAVITY = 1.6"))
    assert ANNOUNCED not in python(CODE, tmp_path, **here).stderr
    product = package / "paper" / "dual_quaternions.py"  # has compiled functions, and is not the file of `compose`
    product.write_text(product.read_text().replace("a1 * b1 - a2 * b2", "2.0 * a1 * b1 - a2 * b2"))
    changed = python(CODE, tmp_path, **here)
    assert ANNOUNCED in changed.stderr
    assert changed.stdout != first.stdout


def test_a_full_disk_keeps_no_compiled_function_from_running(monkeypatch):
    from numba.core.caching import FunctionCache

    from dqwalk_ros.support.compiled import jit

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FunctionCache, "save_overload", full)

    @jit
    def twice(x):
        return 2.0 * x

    assert twice(3.0) == 6.0
