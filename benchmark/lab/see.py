"""Cost of the visualization: time until the page is shown, frame rate, effect on the walk, time of a report.

    python -m benchmark.lab.see [open] [rate] [cost] [report]

Needs Chromium, with WebGL in software: the frame rate drawn here is not that of a browser with a graphics card; the
rate sent by the page does not depend on it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "test" / "support"))

import numpy as np
from browser import address, chromium, dark_share, picture, running
from recorded import short_config, short_walk

from benchmark.timing import machine, table
from dqwalk_ros.cli.runner import Processes, private_domain, run_walk
from dqwalk_ros.config import Config, load, to_yaml
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report import bag
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.walks.table import make_controller

SIZE = {"width": 1000, "height": 500}
MIDDLE = slice(350, 670)
"""Size of the browser window, and the columns of its picture between the panels [pixels]."""
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}


def until_seen(page: Any, timeout: float = 60.0) -> float:
    """Wait until the robot is visible; return that time [s]."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        if dark_share(picture(page, "see"), MIDDLE) > 0.005:
            return time.monotonic()
    raise SystemExit("the page shows no robot")


def opening(folder: Path, rounds: int = 5) -> None:
    """Print the time from the command to the address, and to the visible robot in a browser that already runs."""
    path = folder / "walk"
    bag.write(short_walk(), path)
    times = []
    with chromium(folder, **SIZE) as page:
        for _ in range(rounds):
            began = time.monotonic()
            with running("-m", "dqwalk_ros.cli", "view", path, "--port", 0) as (url, _):
                printed = time.monotonic()
                page.goto(url)
                loaded = time.monotonic()
                seen = until_seen(page)
                times.append((printed - began, loaded - began, seen - began))
                page.goto("about:blank")
    rows = []
    for name, column in zip(("address printed", "page loaded", "robot seen"), np.array(times).T, strict=True):
        rows.append([f"dqwalk view: {name}", f"{np.median(column):.2f}", f"{column.min():.2f}", f"{column.max():.2f}"])
    print(table([f"after the command [s], {rounds} times", "median", "least", "most"], rows), flush=True)


@contextlib.contextmanager
def walking(folder: Path, config: Config) -> Iterator[str]:
    """Walk through ROS in real time with the viewer; yield the address of the page."""
    params = folder / "params.yaml"
    params.write_text(to_yaml(config), encoding="utf-8")
    with private_domain() as domain, Processes(folder, domain) as processes:
        url = viewer(processes, params)
        for name in ("phase_monitor", "integrator", "controller"):
            processes.start(name, ["--ros-args", "--params-file", str(params)])
        yield url


def viewer(processes: Processes, params: Path) -> str:
    """Start the viewer; return the address of its page."""
    processes.start("viewer", ["--port", "0", "--ros-args", "--params-file", str(params)])
    return address(processes)


def smoothness(folder: Path, seconds: float = 15.0) -> None:
    """Print how many pictures per second the page sends and a browser draws during a walk."""
    config = short_config(**{"gait.cycles": 50, "plant.lockstep": False})
    with walking(folder, config) as url, chromium(folder, **SIZE) as page:
        page.goto(url)
        page.wait_for_selector("[data-dqwalk=margins]", timeout=60_000)
        until_seen(page)
        page.evaluate(
            "() => { window.drawn = 0; const tick = () => { window.drawn++; requestAnimationFrame(tick); }; tick(); }"
        )
        sent, began = [], time.monotonic()
        while time.monotonic() - began < seconds:
            time.sleep(1.0)
            found = re.search(r"(\d+) frames per second", page.inner_text("[data-dqwalk=status]"))
            sent.append(int(found.group(1)) if found else 0)
        drawn = page.evaluate("window.drawn") / (time.monotonic() - began)
        errors = page.errors
    print(
        f"page of a walk by the clock: {np.median(sent):.0f} frames per second sent (least {min(sent)}), {drawn:.0f} "
        f"frames drawn by Chromium in software, {len(errors)} errors in its console",
        flush=True,
    )


def cost(folder: Path, rounds: int = 3) -> None:
    """Print how much the page slows a walk in lockstep, which runs as fast as possible."""
    config = load("paper").updated({"gait.cycles": 1, "task.eta": 1.0, "ssp.threshold": 4e-3})
    cases: dict[str, list[float]] = {"no viewer": [], "viewer": [], "viewer and open page": []}
    for k in range(rounds):
        for name, paces in cases.items():
            with contextlib.ExitStack() as stack:
                domain = stack.enter_context(private_domain())
                if name != "no viewer":
                    logs = folder / f"viewer{k}{len(paces)}{len(name)}"
                    logs.mkdir()
                    params = logs / "params.yaml"
                    params.write_text(to_yaml(config), encoding="utf-8")
                    url = viewer(stack.enter_context(Processes(logs, domain)), params)
                if name == "viewer and open page":
                    page = stack.enter_context(chromium(folder, **SIZE))
                    page.goto(url)
                outcome = run_walk(config, folder / f"bag{k}{len(name)}", domain=domain)
            if not outcome.finished:
                raise SystemExit(f"the walk failed: {outcome.reason}")
            paces.append(outcome.ticks / outcome.took)
    base = np.array(cases["no viewer"])
    rows = [
        [
            name,
            f"{np.median(paces):.0f}",
            f"{np.median(np.array(paces) / base):.2f}",
            ", ".join(f"{p:.0f}" for p in paces),
        ]
        for name, paces in cases.items()
    ]
    print(table(["walk in lockstep with", "ticks/s", "ratio", "each"], rows), flush=True)


def reporting(folder: Path, states: int = 120_000) -> None:
    """Print time and memory of a report of ten minutes of the paper's walk."""
    path, config = folder / "long", load("paper").updated({"gait.cycles": 10})
    model = load_model(config.robot)
    trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=(states - 1) * config.dt)
    bag.write(trace, path)
    out = folder / "out"
    words = ["report", str(path), "--html", "--no-figures", "--quiet", "--out", str(out)]
    began = time.monotonic()
    done = subprocess.Popen([sys.executable, "-m", "dqwalk_ros.cli", *words], env=ENVIRONMENT)
    _, status, used = os.wait4(done.pid, 0)
    took = time.monotonic() - began
    if not (out / "report.html").exists():
        raise SystemExit(f"no report (exit code {os.waitstatus_to_exitcode(status)})")
    size = (out / "report.html").stat().st_size / 1e6
    spent = used.ru_utime + used.ru_stime
    print(
        f"report of {len(trace)} states: {took:.1f} s ({spent:.1f} s of processor time), at most "
        f"{used.ru_maxrss / 1024:.0f} MiB; the HTML has {size:.2f} MB",
        flush=True,
    )


PARTS = {"open": opening, "rate": smoothness, "cost": cost, "report": reporting}


def main() -> None:
    """Run all parts, or the given ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], help="all of them by default")
    args = parser.parse_args()
    print(f"{machine(('viser', 'numpy', 'matplotlib'))}\n", flush=True)
    for name in args.parts or PARTS:
        with tempfile.TemporaryDirectory() as folder:
            PARTS[name](Path(folder))


if __name__ == "__main__":
    main()
