"""Runs a script with a copy of the package in which one line is changed, and compares its output."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@cache
def output_of(script: str, package: Path = ROOT) -> str:
    """Return the output of a script run with a copy of the package, or its error output."""
    here = os.environ | {"PYTHONPATH": str(package), "NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    here |= {"OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=package, env=here)
    return done.stdout if done.returncode == 0 else done.stderr


def copy_package(folder: Path) -> Path:
    """Copy the package, its configurations and its robots to a folder."""
    for part in ("dqwalk_ros", "config", "urdf"):
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def changed(tag: str, name: str, line: str, broken: str) -> str:
    """Return the text of a file with a line changed, which it has once, below an equation tag."""
    text = (ROOT / name).read_text(encoding="utf-8")
    assert text.count(line) == 1, line
    at = text[: text.index(line)].count("\n")
    assert tag in " ".join(" ".join(text.splitlines()[max(0, at - 14) : at + 2]).split()), tag
    return text.replace(line, broken)


def changes_output(folder: Path, script: str, tag: str, name: str, line: str, broken: str) -> bool:
    """Change a line below an equation tag in a copy; return whether the output of the script changes."""
    text = changed(tag, name, line, broken)
    (copy_package(folder) / name).write_text(text, encoding="utf-8")
    return output_of(script, folder) != output_of(script)
