"""Every target of the Makefile, and every command of README's tables and code blocks, works in a clone of its own.

The clone is of the last commit. It has its own .venv and its own cache; of this machine only pip's settings and cache.
`python -m pytest -m long -s test/package/test_fresh_clone.py -k "make and walk or colcon"` prints time and disk space.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LOCAL, _, ON_ROS = README.partition("## On a machine with ROS 2 Jazzy")  # its commands: test_package.py

TARGETS = re.findall(r"^([a-z-]+):.*##", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
TABLES = "\n".join(line for line in LOCAL.splitlines() if line.startswith("|"))
CELLS = re.findall(r"`((?:make|dqwalk|python) [^`]+)`", TABLES)
BLOCKS = re.findall(r"^```bash\n(.*?)^```", LOCAL, re.M | re.S)
LINES = [line.partition("#")[0].strip() for block in BLOCKS for line in block.splitlines()]
PYTHON = [f"python -c {shlex.quote(code)}" for code in re.findall(r"^```python\n(.*?)^```", ON_ROS, re.M | re.S)]
COMMANDS = list(dict.fromkeys([*(f"make {name}" for name in TARGETS), *LINES, *CELLS, *PYTHON]))

NEEDS_A_ROBOT = {"dqwalk doctor"}

SHORTENED = {
    "make walk-physics": "STEPS=2",
    "make walk-physics GAIT=poppy": "STEPS=2",
    "make test": "ARGS='-k test_solvers'",
    "make test-long": "ARGS='-k test_rosdistro_still_has_the_keys'",
    "make browser": "ARGS='-k test_a_report_replays_offline'",
    "make chaos": "ARGS='-k test_pause_and_start'",
    "make fuzz": "ARGS='-k test_parameter_files_of_random_text'",
    "make mutation": "ARGS='--every 4 dqwalk_ros/report/viewer/guard.py'",
    "make soak": "ARGS='--minutes 1'",
    "make robots": "ARGS='--only icub_reduced'",
    "make benchmark": "ARGS='--only cycle --ticks 1000'",
    "make see": "ARGS=report",
    "make evidence": "ARGS='--sample 1'",
}
"""Arguments that select little of what takes long."""

COMPLETED = {
    "dqwalk adopt FILE": "dqwalk adopt test/data/small_humanoid.urdf",
    "dqwalk identify BAG": "dqwalk exercise --out hanging && dqwalk identify hanging/bag",
    "dqwalk view BAG": "exec 3< <(PYTHONUNBUFFERED=1 dqwalk view test/data/recorded/walk 2>&1) && "
    "grep --max-count 1 http://127 <&3 && kill $!",
    "dqwalk study STUDY.yaml": "dqwalk study studies/step_length.yaml --out study",
}
"""What stands for a word in capitals."""


def shell(command: str) -> str:
    """Return what a person types for a command of README or a target, in a shell in the clone."""
    if command.startswith("make "):
        return f"{command} PYTHON={Path(sys.base_prefix) / 'bin/python3'} {SHORTENED.get(command, '')}"
    return f"{shell('make venv')} && . .venv/bin/activate && {COMPLETED.get(command, command)}"


@pytest.mark.long
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("command", [one for one in COMMANDS if one not in NEEDS_A_ROBOT], ids=lambda one: one[:30])
def test_a_command_works_in_a_fresh_clone(command: str, tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
    cache = subprocess.run(
        [sys.executable, "-m", "pip", "cache", "dir"], capture_output=True, text=True, check=True
    ).stdout.strip()
    kept = {name: value for name, value in os.environ.items() if name.startswith("PIP_") or name in ("HOME", "LANG")}
    environment = kept | {"PATH": os.defpath, "PIP_CACHE_DIR": cache, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    began = time.monotonic()
    done = subprocess.run(
        ["bash", "-c", shell(command)],
        cwd=clone, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, check=False,
    )  # fmt: skip
    print(done.stdout)
    size = sum(path.lstat().st_size for path in tmp_path.rglob("*") if path.is_file())
    print(f"{command}: {(time.monotonic() - began) / 60:.1f} minutes, {size / 1e6:.0f} MB with .venv and cache")
    assert done.returncode == 0
    assert "which has no rosdep key" not in done.stdout  # the reason of a skipped test (declared.py)
    shutil.rmtree(clone)  # half a gigabyte


def test_commands_are_found_and_shortened_ones_exist() -> None:
    """So that a target or a row is neither overlooked nor, after it is renamed, run at full length."""
    assert set(SHORTENED) | set(COMPLETED) | NEEDS_A_ROBOT <= set(COMMANDS)
    assert {"make walk", "make lint", "make clean", "make walk-physics GAIT=poppy", "make reach"} <= set(COMMANDS)
    assert not [one for one in COMMANDS if re.search(r"\b[A-Z]{2,}\b(?!=)", one) and one not in COMPLETED]
