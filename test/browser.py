"""Headless Chromium for tests: opens a page, reads its console, takes pictures."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.image import imread
from playwright.sync_api import sync_playwright

FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
PICTURES = Path(os.environ.get("DQWALK_PICTURES", "results/pictures"))
"""Folder for the pictures of the tests."""


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
    page.screenshot(path=str(path))
    return np.asarray(imread(path))[..., :3]


def dark_share(image: np.ndarray, columns: slice) -> float:
    """Return the fraction of the pixels of some columns that are darker than the ground and its grid."""
    return float((image[:, columns].mean(axis=2) < 0.55).mean())
