"""What it costs to begin: nothing heavy is imported before it is needed, and compiling is announced."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dqwalk_ros.kernels import COMPILED

ROOT = Path(__file__).resolve().parent.parent
HEAVY = ("numpy", "scipy", "numba", "clarabel", "matplotlib", "yourdfpy", "rclpy")


def python(code: str, here: Path = ROOT, **env: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", code]
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=here, env=os.environ | env)


@pytest.mark.parametrize("code", ["import dqwalk_ros", "from dqwalk_ros.cli import parser; parser.build()"])
def test_nothing_heavy_comes_with_the_package_or_its_help(code):
    out = python(f"{code}\nimport sys\nprint([name for name in {HEAVY!r} if name in sys.modules])").stdout
    assert out.strip() == "[]"


def test_a_controller_is_ready_without_the_slow_parts_of_scipy():
    code = (
        "import sys, numpy as np\n"
        "from dqwalk_ros import kinematics\n"
        "from dqwalk_ros.controllers import velocity\n"
        "from dqwalk_ros.qp import make_solver\n"
        "make_solver('clarabel'), make_solver('daqp')\n"
        "print('scipy.sparse' in sys.modules, 'scipy.optimize' in sys.modules)"
    )
    assert python(code).stdout.strip() == "False False"


def test_the_integrator_node_is_spared_numba():
    code = "import sys\nfrom dqwalk_ros.nodes import integrator\nfrom dqwalk_ros.model import load_model\n"
    code += "from dqwalk_ros.config import load\nfrom dqwalk_ros.plants.kinematic import KinematicPlant\n"
    code += "KinematicPlant(load_model(load('paper').robot), compiled=False)\nprint('numba' in sys.modules)"
    assert python(code).stdout.strip() == "False"


def test_compiling_is_announced_once_per_machine(tmp_path):
    code = "import numpy as np\nfrom dqwalk_ros.kernels import compose, point\nx = np.eye(8)[0]\n"
    code += "compose(x, x), point(x, x[:3])"
    words = "compiling for this machine"
    assert python(code, NUMBA_CACHE_DIR=str(tmp_path), NUMBA_DISABLE_JIT="0").stderr.count(words) == 1
    assert words not in python(code, NUMBA_CACHE_DIR=str(tmp_path), NUMBA_DISABLE_JIT="0").stderr


def test_a_compiled_function_is_compiled_anew_when_what_it_calls_has_changed(tmp_path):
    """numba itself looks at no file but the function's own."""
    package = tmp_path / "dqwalk_ros"
    shutil.copytree(ROOT / "dqwalk_ros", package, ignore=shutil.ignore_patterns("__pycache__"))
    code = "import numpy as np\nfrom dqwalk_ros.standing.paths import swing_path\nfrom dqwalk_ros.kernels import jit\n"
    code += "v = np.zeros(6)\nswing_path(0.5, np.ones(15), v[:3], np.zeros(4), v)\nprint(v[2])"
    here = {"NUMBA_DISABLE_JIT": "0", "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    words = "compiling for this machine"
    assert words in python(code, tmp_path, **here).stderr
    assert words not in python(code, tmp_path, **here).stderr
    kernels = package / "kernels.py"
    kernels.write_text(kernels.read_text() + "# another version\n")
    assert words in python(code, tmp_path, **here).stderr


def test_every_file_with_compiled_functions_is_known():
    files = (
        path for path in (ROOT / "dqwalk_ros").rglob("*.py") if re.search(r"^@jit|= jit\(", path.read_text(), re.M)
    )
    assert sorted(str(path.relative_to(ROOT / "dqwalk_ros")) for path in files) == sorted(COMPILED)
