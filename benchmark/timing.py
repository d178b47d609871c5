"""Interleaved timing for machines that are shared with other users.

Every round runs every case for a short time, in random order. Only figures of one call can be compared: ratios are
medians over the rounds of the ratio within a round.
"""

from __future__ import annotations

import contextlib
import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import gc
import platform
import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np

from dqwalk_ros.support import provenance


@dataclass(frozen=True)
class Times:
    """Times of one case [us]: all single calls, and the median of each round."""

    single: np.ndarray
    rounds: np.ndarray

    @property
    def median(self) -> float:
        """Median of the single calls [us]."""
        return float(np.median(self.single))

    def ratio(self, other: Times) -> float:
        """Median ratio to another case of the same run."""
        return float(np.median(self.rounds / other.rounds))


def interleaved(
    cases: Mapping[str, Callable[[Any], object]], states: Sequence[Any], rounds: int = 30, chunk: int = 20
) -> dict[str, Times]:
    """Time every case on the states, in turn."""
    order = random.Random(0)
    names, single = list(cases), {name: [] for name in cases}
    at = dict.fromkeys(cases, 0)
    for name in names:
        for state in states[:3]:
            cases[name](state)
    gc.collect()
    gc.disable()
    try:
        for _ in range(rounds):
            order.shuffle(names)
            for name in names:
                case, times = cases[name], []
                case(states[at[name] % len(states)])  # warms the caches, not counted
                for i in range(1, chunk + 1):
                    state = states[(at[name] + i) % len(states)]
                    began = time.perf_counter_ns()
                    case(state)
                    times.append(time.perf_counter_ns() - began)
                at[name] += chunk + 1
                single[name].append(times)
    finally:
        gc.enable()
    out = {}
    for name, times in single.items():
        all_times = 1e-3 * np.array(times)
        out[name] = Times(all_times.ravel(), np.median(all_times, axis=1))
    return out


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table, aligned for reading as text."""
    columns = list(zip(header, *rows, strict=True))
    widths = [max(len(cell) for cell in column) for column in columns]
    right = [False] + [True] * (len(header) - 1)

    def line(cells: Sequence[str]) -> str:
        padded = (c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True))
        return "| " + " | ".join(padded) + " |"

    rule = "|" + "|".join("-" * (w + 1) + (":" if r else "-") for w, r in zip(widths, right, strict=True)) + "|"
    return "\n".join([line(header), rule, *map(line, rows)])


def machine(packages: Sequence[str] = ("numpy", "numba", "clarabel", "daqp")) -> str:
    """Return the processor, the load and the versions of what is installed, in one line."""
    versions = [f"Python {platform.python_version()}"]
    for package in packages:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions.append(f"{package} {metadata.version(package)}")
    load = os.getloadavg()[0]
    return f"{provenance.machine()['processor']}, load {load:.1f}; {', '.join(versions)}"
