"""Headless Chromium for tests: opens a page, reads its console, takes pictures."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.image import imread
from playwright.sync_api import sync_playwright

from dqwalk_ros.cli.runner import Processes

FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
URL = r"http://127\.0\.0\.1:\d+"
PATIENCE = 120_000
"""Timeout for a change of the page [ms]: on two busy cores a picture may take seconds."""
PICTURES = Path(os.environ.get("DQWALK_PICTURES", "results/pictures"))
"""Folder for the pictures of the tests."""


@contextmanager
def running(*words) -> Iterator[tuple[str, subprocess.Popen]]:
    """Run a program that prints the address of its page; yield that and its process."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen([sys.executable, *map(str, words)], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        url = next(m.group() for line in process.stdout if (m := re.search(URL, line)))
        yield url, process
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:  # an interrupted walk shows its page until a second signal
            process.send_signal(signal.SIGINT)
            process.wait(20)


def address(processes: Processes) -> str:
    """Return the address of the page of the node ``viewer``, when it has logged it."""
    deadline = time.monotonic() + 60.0
    while not (found := re.search(URL, processes.log("viewer"))):
        assert time.monotonic() < deadline, processes.last_error("viewer")
        time.sleep(0.05)
    return found.group()


@contextmanager
def chromium(folder: Path, *, width: int = 1440, height: int = 860, offline: bool = False) -> Iterator[Any]:
    """Yield a page; its attribute ``errors`` collects the errors of the console and of the scripts."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    assert program, "these tests need chromium: make browser installs it"
    with sync_playwright() as play:
        context = play.chromium.launch_persistent_context(
            str(folder / "profile"),
            executable_path=program,
            headless=True,
            viewport={"width": width, "height": height},
            args=list(FLAGS),
            offline=offline,
        )
        page = context.pages[0]
        page.errors = []
        page.on("console", lambda m: page.errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        try:
            yield page
        finally:
            context.close()


def picture(page: Any, name: str) -> np.ndarray:
    """Take a picture, save it in `PICTURES`, and return it, shape (height, width, 3), 0 to 1."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    path = PICTURES / f"{name}.png"
    page.screenshot(path=str(path), timeout=PATIENCE)
    return np.asarray(imread(path))[..., :3]


def dark_share(image: np.ndarray, columns: slice) -> float:
    """Return the fraction of the pixels of some columns that are darker than the ground and its grid."""
    return float((image[:, columns].mean(axis=2) < 0.55).mean())
