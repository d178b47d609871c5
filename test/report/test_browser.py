"""The pages in headless Chromium: pixels, curves and controls (``make browser``)."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import PATIENCE, address, chromium, dark_share, picture, running
from recorded import short_config

from dqwalk_ros import cli
from dqwalk_ros.report import bag

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parents[2]
SIZE = {"width": 1000, "height": 560}
"""Of the window: small, because without a graphics card the CPU renders every pixel."""
MIDDLE = slice(350, 670)
"""Columns of the picture between the panels."""


def status(page) -> str:
    return page.inner_text("[data-dqwalk=status]")


def seconds(page) -> float:
    return float(re.search(r"time\s+([\d.]+) s", status(page)).group(1))


def until(page, condition: str, **values: object) -> None:
    """Wait until a JavaScript expression is true; ``status`` and ``margins`` are the panels, ``time`` the shown time.

    The expression can use `values` by their names.
    """
    page.wait_for_function(
        """([condition, names, values]) => {
            const panel = name => document.querySelector(`[data-dqwalk=${name}]`);
            if (!panel('status') || !panel('margins')) return false;
            const status = panel('status').innerText, margins = panel('margins').innerHTML;
            const time = parseFloat((status.match(/time\\s+([\\d.]+) s/) || [])[1]);
            return new Function('status', 'margins', 'time', ...names, `return ${condition}`)(
                status, margins, time, ...values);
        }""",
        arg=[condition, list(values), list(values.values())],
        timeout=PATIENCE,
    )


def until_drawn(page, name: str, accept: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Take pictures until one is accepted, and return it."""
    deadline = time.monotonic() + 1e-3 * PATIENCE
    while not accept(image := picture(page, name)):
        assert time.monotonic() < deadline, f"the picture {name}.png was not as expected in time"
        page.wait_for_timeout(500)
    return image


def robot_seen(image: np.ndarray) -> bool:
    return dark_share(image, MIDDLE) > 0.005  # motors, soles


def test_playback_of_a_bag(path, tmp_path):
    with running("-m", "dqwalk_ros.cli", "view", path, "--port", 0) as (url, _), chromium(tmp_path, **SIZE) as page:
        page.goto(url)
        until(page, "margins.includes('TIGHTEST')")
        start = until_drawn(page, "view_start", robot_seen)
        assert len(page.query_selector_all("[data-curve]")) >= 8

        page.get_by_role("button", name="Play").click()
        until(page, "status.includes('single support')")
        until(page, "time > then", then=seconds(page))
        page.get_by_role("button", name="Pause").click()
        page.get_by_role("button", name="Play").wait_for(timeout=PATIENCE)
        page.wait_for_timeout(3000)  # for updates still in transmission
        held = seconds(page)
        page.wait_for_timeout(2000)
        assert seconds(page) == held
        until_drawn(page, "view_walked", lambda image: robot_seen(image) and moved(image, start))

        field = page.locator("input[type=text], input[inputmode]").first
        before = page.inner_html("[data-dqwalk=margins]")
        field.fill("2")
        field.press("Enter")
        until(page, "Math.abs(time - 2) < 0.1 && margins !== before", before=before)
        page.get_by_role("button", name="end", exact=True).click()
        until(page, "status.includes('finished')")
        picture(page, "view_end")
        assert page.errors == []


def moved(image: np.ndarray, before: np.ndarray) -> bool:
    return float(np.abs(image - before)[:, MIDDLE].max()) > 0.3


def test_a_simulation_is_shown_while_it_runs(tmp_path):
    # The walk must outlast a slow browser, and have few states: each is written and analysed after the interruption. So
    # the engine has a small time step.
    options = {"gait.steps": 10_000, "physics.timestep": 2e-4}
    words = [word for key, value in options.items() for word in ("--set", f"{key}={value}")]
    command = ("-m", "dqwalk_ros.cli", "simulate", "--view", "--port", 0, "--out", tmp_path / "walk", "--no-figures")
    physics = ("--config", "poppy_dynamic", "--plant", "physics", *words)
    with running(*command, *physics) as (url, walk), chromium(tmp_path, **SIZE) as page:
        page.goto(url)
        until(page, "time >= 0 && status.includes('solved in')")
        until(page, "time > then", then=seconds(page))
        then = seconds(page)
        until_drawn(page, "simulate", robot_seen)
        walk.send_signal(signal.SIGINT)  # the walk ends; the completed part is saved and can be replayed
        page.get_by_role("button", name="Play").wait_for(timeout=PATIENCE)
        kept = bag.read(tmp_path / "walk/bag")
        assert not kept.finished
        assert kept.time[-1] > then
        assert page.errors == []


def test_a_walk_in_ros_is_shown_live(nodes, tmp_path):
    config = short_config(**{"gait.cycles": 50, "plant.lockstep": False})
    live = nodes(config)
    live.start("viewer", "--port", "0")
    live.start("phase_monitor")
    live.start("integrator")
    live.start("controller")
    with chromium(tmp_path, **SIZE) as page:
        page.goto(address(live.processes))
        until(page, "time >= 0 && status.includes('iterations')")
        first, then = page.inner_html("[data-dqwalk=margins]"), seconds(page)
        assert then < 200.0  # time of the walk, not time of day
        until(page, "time > then + 0.5 && margins !== first", then=then, first=first)
        until_drawn(page, "live", robot_seen)
        assert page.errors == []
    # it waits at first, and software WebGL can keep the plant from the processor for 0.1 s
    wrong = {s.message for s in live.statuses("controller") if s.level != b"\x00"}
    assert all("timed out" in text or text.startswith("waiting for joint_states") for text in wrong), wrong


def test_a_report_replays_offline(path, tmp_path):
    cli.main(["report", str(path), "--html", "--no-figures", "--quiet", "--out", str(tmp_path / "out")])
    with chromium(tmp_path, offline=True) as page:
        page.goto((tmp_path / "out/report.html").as_uri())
        page.wait_for_function("window.dqwalkDrawn > 0")
        start = picture(page, "report")
        assert dark_share(start, slice(150, 800)) > 0.005
        page.evaluate("() => { const s = document.getElementById('time'); s.value = s.max / 2; s.oninput(); }")
        assert np.abs(picture(page, "report_scrubbed") - start)[:, 150:800].max() > 0.3
        before = page.inner_text("#clock")
        page.get_by_role("button", name="Play").click()
        page.wait_for_function(f"document.getElementById('clock').textContent !== '{before}'")
        page.set_viewport_size({"width": 360, "height": 800})  # a telephone: only wide tables scroll sideways
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        assert page.errors == []
