"""What it costs to begin: nothing heavy is imported before it is needed, and compiling is announced."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
HEAVY = ("numpy", "scipy", "numba", "clarabel", "matplotlib", "yourdfpy", "rclpy")


def python(code: str, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, env=os.environ | env
    )


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


def test_compiling_is_announced_once_per_machine(tmp_path):
    code = "import numpy as np\nfrom dqwalk_ros.kernels import compose, point\nx = np.eye(8)[0]\n"
    code += "compose(x, x), point(x, x[:3])"
    words = "compiling for this machine"
    assert python(code, NUMBA_CACHE_DIR=str(tmp_path), NUMBA_DISABLE_JIT="0").stderr.count(words) == 1
    assert words not in python(code, NUMBA_CACHE_DIR=str(tmp_path), NUMBA_DISABLE_JIT="0").stderr
