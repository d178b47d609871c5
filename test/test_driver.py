"""The Poppy driver over topics and by the clock, on emulated servos (`make driver` prints the figures)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: source one, or pip install '.[ros]'")

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.long
@pytest.mark.timeout(1000)
@pytest.mark.parametrize("options", [[], ["--full"]], ids=["a fast cycle", "the paper's cycle"])
def test_a_cycle_on_the_dummy_motors(options: list[str]) -> None:
    """It finishes, at 50 Hz, every angle within its limits and read back where its goal was."""
    words = [sys.executable, "-m", "benchmark.driver", *options]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
