"""Every line of the pages for a lab's first days is typed in a shell, in the order of the page, and ends as it says.

Without a ROS of this machine a stand-in of `ros2` is used. Robots are emulated, and long walks are shortened.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from dqwalk_ros.cli.runner import environment, private_domain

ROOT = Path(__file__).resolve().parents[2]
RECORDED, STAND_IN = ROOT / "test/data/recorded/walk", ROOT / "test/support/stand_in_ros2.py"

NOT_RUN = {
    "rviz:=true": "RViz",
    "ros2_control": "controllers of ros2_control",
    "nav2_msgs": "Nav2",
    "identif": "an exercise of five minutes, which test_fresh_clone.py runs",
    "exercise": "the same",
    "plant:=poppy             ": "a robot; the line before emulates it",
}
"""Lines with these words, and what they need."""

QUICK = ("task.eta=1.0", "gait.step_length=0.02", "ssp.threshold=0.02", "dsp.stall_rate=0.003")
"""A walk of the paper in a few seconds."""
CHANGED = {
    "poppy_driver --ros-args": "poppy_driver --ros-args -p poppy.dummy:=true",
    "lockstep:=true": f"lockstep:=true set:='{' '.join(QUICK)}'",
    "walk --out my_walk": f"walk --out my_walk --set {' --set '.join(QUICK)}",
    "--out standing_walk": "--out standing_walk --set gait.steps=1",
    "dqwalk walk": "env -u ROS_DOMAIN_ID dqwalk walk",  # beside what runs in the domain of the other lines
    "simulate --view": f"simulate --view --set {' --set '.join(QUICK)}",
    ",20 ": ",4 ",
    ",30 ": ",4 ",
}
"""Parts of lines that are replaced: by an emulation, or by a shorter walk."""

ENDLESS = {
    r"ros2 launch (?!.*lockstep)": r"controller\]: .* joints,",
    r"ros2 run dqwalk_ros (?!pilot)": r"\]: ",
    r"dqwalk view": "http://127",
    r"dqwalk simulate --view": "OK: every constraint",
}
"""Lines that run until Ctrl-C, and what they print when they are ready."""

ENDS = {"poppy_driver --ros-args": "integrator", "ros2 launch": "", "dqwalk report": ""}
"""Which of the running lines are ended by Ctrl-C before one with these words: those with others, empty for all."""

PAGES = {
    "hardware": ["ready to walk", "success=True", "walking", "paused"],
    "interfaces": ["single_support/right", "the next walk starts", "walking", "stood for"],
    "see": ["OK: every constraint", "wrote walk.gif", "wrote strip.png"],
    "tuning": ["Set parameter successful"],
}
"""What the lines of a page print, among other things."""


def lines_of(page: str) -> Iterator[str]:
    """Yield the commands of a page as they are typed, a command on several lines as one."""
    text = (ROOT / f"docs/{page}.md").read_text(encoding="utf-8")
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, re.S | re.M):
        if language not in ("", "bash"):
            continue
        waiting = ""
        for line in block.splitlines():
            waiting += line + "\n"
            if waiting.count("'") % 2 == 0 and not line.endswith("\\"):
                yield waiting.strip()
                waiting = ""


class Shell:
    """Types lines in a folder; those that run until Ctrl-C stay in the background."""

    def __init__(self, folder: Path, domain: int) -> None:
        self._folder = folder
        self._outputs: dict[str, Path] = {}  # of all lines
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._environment = environment(domain) | {"OPENBLAS_NUM_THREADS": "1"}
        path = [str(Path(sys.executable).parent), os.environ["PATH"]]
        if shutil.which("ros2") is None:
            tools = folder / "bin"
            tools.mkdir()
            (tools / "ros2").write_text(f'#!/bin/sh\nexec {sys.executable} {STAND_IN} "$@"\n')
            (tools / "ros2").chmod(0o755)
            path.insert(0, str(tools))
        self._environment["PATH"] = os.pathsep.join(path)

    def output(self, line: str = "") -> str:
        """Return what a line has printed, by default what all have."""
        files = [self._outputs[line]] if line else self._outputs.values()
        return "".join(file.read_text(errors="replace") for file in files)

    def type(self, line: str) -> None:
        """Run a line to its end, which must be a success; or until it is ready, if it runs until Ctrl-C."""
        for words, which in ENDS.items():
            if words in line:
                for other in [one for one in self._running if which in one]:
                    self.interrupt(other)
        self._outputs[line] = self._folder / f"output{len(self._outputs)}"
        with open(self._outputs[line], "wb") as output:
            self._running[line] = process = subprocess.Popen(
                ["bash", "-c", line], cwd=self._folder, env=self._environment, stdin=subprocess.DEVNULL,
                stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        if "pub -r" in line:
            time.sleep(2.0)
            self.interrupt(line)
        elif ready := next((ready for words, ready in ENDLESS.items() if re.match(words, line)), None):
            until = time.monotonic() + 300.0
            while not re.search(ready, self.output(line)):
                assert process.poll() is None, self.output(line)
                assert time.monotonic() < until, line
                time.sleep(0.2)
        else:
            assert process.wait(600.0) == 0, self.output(line)
            del self._running[line]

    def interrupt(self, line: str) -> None:
        """Press Ctrl-C, and expect that the line ends as if nothing were wrong."""
        process = self._running.pop(line)
        assert process.poll() is None, self.output(line)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(60.0) in (0, 128 + signal.SIGINT), self.output(line)

    def close(self) -> None:
        """End all, also after a failure."""
        try:
            for line in list(self._running):
                self.interrupt(line)
        finally:
            for process in self._running.values():
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES)
def test_the_lines_of_a_page_end_as_it_says(page: str, tmp_path: Path) -> None:
    (tmp_path / "config").symlink_to(ROOT / "config")
    for name in ("walk", "slower"):
        if page == "see":
            shutil.copytree(RECORDED, tmp_path / name / "bag")
    with private_domain() as domain:
        shell = Shell(tmp_path, domain)
        try:
            if page == "tuning":  # of a robot that walks
                shell.type("ros2 launch dqwalk_ros walk.launch.py config:=poppy plant:=physics")
            for line in lines_of(page):
                if any(words in line for words in NOT_RUN):
                    continue
                for old, new in CHANGED.items():
                    line = line.replace(old, new)
                if "doctor --plant" in line:  # asked once before ~/activate, which is its answer, and then again
                    shell.type(f"{line} || true")
                    continue
                shell.type(line)
                if "/activate" in line:
                    shell.type("until dqwalk doctor --plant poppy; do sleep 1; done")
        finally:
            shell.close()
    assert [text for text in PAGES[page] if text not in shell.output()] == []


def test_what_is_not_run_or_changed_is_in_the_pages() -> None:
    """So that no rule is left over after a line has changed."""
    lines = [line for page in PAGES for line in lines_of(page)]
    for words in (*NOT_RUN, *CHANGED, *ENDS):
        assert any(words in line for line in lines), words
