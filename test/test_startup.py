"""Start-up time: heavy modules are imported when needed, and compilation is announced."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
HEAVY = ("numpy", "scipy", "numba", "clarabel", "matplotlib", "yourdfpy", "rclpy")


def python(code: str, here: Path = ROOT, **env: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", code]
    return subprocess.run(words, capture_output=True, text=True, check=True, cwd=here, env=os.environ | env)


@pytest.mark.parametrize("code", ["import dqwalk_ros", "import dqwalk_ros.cli"])
def test_package_and_help_import_no_heavy_modules(code):
    out = python(f"{code}\nimport sys\nprint([name for name in {HEAVY!r} if name in sys.modules])").stdout
    assert out.strip() == "[]"


def test_the_controller_imports_no_slow_parts_of_scipy():
    code = (
        "import sys, numpy as np\n"
        "from dqwalk_ros import kinematics\n"
        "from dqwalk_ros import controller\n"
        "from dqwalk_ros.qp import make_solver\n"
        "make_solver('clarabel'), make_solver('daqp')\n"
        "print('scipy.sparse' in sys.modules, 'scipy.optimize' in sys.modules)"
    )
    assert python(code).stdout.strip() == "False False"


def test_the_integrator_node_does_not_import_numba():
    code = "import sys\nfrom dqwalk_ros.nodes.plant import Integrator\nfrom dqwalk_ros.robot import load_model\n"
    code += "from dqwalk_ros.config import load\nfrom dqwalk_ros.plants.kinematic import KinematicPlant\n"
    code += "KinematicPlant(load_model(load('paper').robot))\nprint('numba' in sys.modules)"
    assert python(code).stdout.strip() == "False"


CODE = "import numpy as np\nfrom dqwalk_ros.kinematics import compose\nx = np.eye(8)[0]\nprint(compose(x, x))"
ANNOUNCED = "compiling for this machine"


def test_compilation_is_announced_once_per_machine(tmp_path):
    here = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    assert python(CODE, **here).stderr.count(ANNOUNCED) == 1
    assert ANNOUNCED not in python(CODE, **here).stderr


def test_a_compiled_function_is_recompiled_when_a_function_it_calls_changes(tmp_path):
    """numba itself checks only the file of the function."""
    package = tmp_path / "dqwalk_ros"
    shutil.copytree(ROOT / "dqwalk_ros", package, ignore=shutil.ignore_patterns("__pycache__"))
    here = {"XDG_CACHE_HOME": str(tmp_path), "NUMBA_DISABLE_JIT": "0", "PYTHONPATH": str(tmp_path)}
    first = python(CODE, tmp_path, **here).stdout
    assert ANNOUNCED not in python(CODE, tmp_path, **here).stderr
    called = package / "geometry.py"  # has compiled functions, and is not the file of `compose`
    called.write_text(called.read_text() + "# another version\n")
    assert ANNOUNCED in python(CODE, tmp_path, **here).stderr
    product = package / "dual_quaternions.py"
    product.write_text(product.read_text().replace("a1 * b1 - a2 * b2", "2.0 * a1 * b1 - a2 * b2"))
    assert python(CODE, tmp_path, **here).stdout != first
