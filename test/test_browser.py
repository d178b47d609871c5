"""The pages as people see them: pixels, curves and controls in headless Chromium (``make browser``)."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, dark_share, picture
from recorded import SHORT, short_config, short_walk

from dqwalk_ros import bag, cli

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parent.parent
MIDDLE = slice(500, 950)
"""Columns of the picture between the panels."""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "walk"
    bag.write(short_walk(), path)
    return path


@contextmanager
def running(*words) -> Iterator[str]:
    """Run a program that prints the address of its page, and yield that."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen([sys.executable, *map(str, words)], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield next(m.group() for line in process.stdout if (m := re.search(r"http://127\.0\.0\.1:\d+", line)))
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        process.wait(20)


def status(page) -> str:
    return page.inner_text("[data-dqwalk=status]")


def seconds(page) -> float:
    return float(re.search(r"time\s+([\d.]+) s", status(page)).group(1))


def test_a_bag_is_played_and_scrubbed(path, tmp_path):
    with running("-m", "dqwalk_ros.cli", "view", path, "--port", 0) as url, chromium(tmp_path) as page:
        page.goto(url)
        page.wait_for_selector("[data-dqwalk=margins]", timeout=60_000)
        page.wait_for_timeout(3000)
        start = picture(page, "view_start")
        assert dark_share(start, MIDDLE) > 0.005  # motors, soles: the robot is there
        assert "TIGHTEST" in page.inner_text("[data-dqwalk=margins]")
        assert len(page.query_selector_all("[data-curve]")) >= 8

        page.get_by_role("button", name="Play").click()
        page.wait_for_function("document.querySelector('[data-dqwalk=status]').innerText.includes('single support')")
        then = seconds(page)
        page.wait_for_timeout(1500)
        assert seconds(page) > then
        page.get_by_role("button", name="Pause").click()
        page.wait_for_timeout(1500)
        held = seconds(page)
        page.wait_for_timeout(500)
        assert seconds(page) == held
        page.wait_for_timeout(1500)
        walked = picture(page, "view_walked")
        assert np.abs(walked - start)[:, MIDDLE].max() > 0.3

        field = page.locator("input[type=text], input[inputmode]").first
        before = page.inner_html("[data-dqwalk=margins]")
        field.fill("2")
        field.press("Enter")
        page.wait_for_timeout(2000)
        assert seconds(page) == pytest.approx(2.0, abs=0.1)
        assert page.inner_html("[data-dqwalk=margins]") != before
        page.get_by_role("button", name="end", exact=True).click()
        page.wait_for_timeout(2000)
        assert "finished" in status(page)
        picture(page, "view_end")
        assert page.errors == []


def test_a_walk_is_seen_while_it_is_computed(tmp_path):
    words = [word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")]
    command = ("-m", "dqwalk_ros.cli", "simulate", "--view", "--port", 0, "--out", tmp_path / "walk", "--no-figures")
    with running(*command, "--cycles", 8, *words) as url, chromium(tmp_path) as page:
        page.goto(url)
        page.wait_for_selector("[data-dqwalk=margins]", timeout=60_000)
        page.wait_for_timeout(2000)
        then = seconds(page)
        page.wait_for_function(f"!document.querySelector('[data-dqwalk=status]').innerText.includes('{then:.2f} s')")
        assert "solved in" in status(page)
        assert dark_share(picture(page, "simulate"), MIDDLE) > 0.005
        page.get_by_role("button", name="Play").wait_for(timeout=120_000)  # the walk is over: it can be replayed
        assert page.errors == []


def test_a_walk_on_ros_is_seen_live(tmp_path):
    from live import Live

    from dqwalk_ros.runner import private_domain

    config = short_config(**{"gait.cycles": 50, "plant.lockstep": False})
    with private_domain() as domain:
        live = Live(tmp_path, domain, config)
        try:
            live.start("viewer", "--port", "0")
            live.start("phase_monitor")
            live.start("integrator")
            live.start("controller")
            deadline = time.monotonic() + 60.0
            while not (found := re.search(r"http://127\.0\.0\.1:\d+", live.processes.log("viewer"))):
                assert time.monotonic() < deadline, live.logs()
                live.spin(0.2)
            with chromium(tmp_path) as page:
                page.goto(found.group())
                page.wait_for_selector("[data-dqwalk=margins]", timeout=60_000)
                page.wait_for_timeout(3000)
                first, then = page.inner_html("[data-dqwalk=margins]"), seconds(page)
                page.wait_for_timeout(3000)
                assert seconds(page) > then + 0.5
                assert page.inner_html("[data-dqwalk=margins]") != first
                assert "iterations" in status(page)
                assert dark_share(picture(page, "live"), MIDDLE) > 0.005
                assert page.errors == []
            assert not [s for s in live.statuses("controller") if s.level not in (b"\x00", 0)]
        finally:
            live.close()


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
        assert page.errors == []
