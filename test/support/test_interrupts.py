"""Ctrl-C in the middle of a walk, and at the start of a program."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from robots import legs

from dqwalk_ros.adopt import trial
from dqwalk_ros.config import load
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report.bag import walk
from dqwalk_ros.simulation import closed_loop, simulate
from dqwalk_ros.support.interrupts import postponed_interrupts
from dqwalk_ros.walks.table import make_controller

ROOT = Path(__file__).resolve().parents[2]
PAPER = load("paper")


def interrupted_walk(*signals, step=5):
    """Return the trace of a walk in which the signals arrive before a step is computed."""
    steps = itertools.count()

    def before_step(_):
        if next(steps) == step:
            for number in signals:
                signal.raise_signal(number)

    return simulate(make_controller(PAPER, legs()), KinematicPlant(legs()), before_step=before_step, max_time=0.1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_step_is_completed_and_recorded(number):
    before = signal.getsignal(number)
    trace = interrupted_walk(number)
    assert trace.interrupted
    assert trace.notes == ("interrupted at 0.025 s",)
    assert len(trace) == len(trace.q) == len(trace.u) == 6
    assert np.isfinite(trace.u).all()
    assert signal.getsignal(number) is before


def test_a_second_interrupt_acts_at_once():
    with pytest.raises(KeyboardInterrupt):
        interrupted_walk(signal.SIGINT, signal.SIGINT)


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_interrupt_while_the_bag_is_written_loses_no_walk(tmp_path, monkeypatch, interrupted):
    """It takes seconds; only who has already interrupted the walk does not want to wait for it."""
    trace, columns = interrupted_walk(*[signal.SIGINT] * interrupted), walk._columns

    def interrupting(*args):
        signal.raise_signal(signal.SIGINT)
        return columns(*args)

    monkeypatch.setattr(walk, "_columns", interrupting)
    with pytest.raises(KeyboardInterrupt):
        walk.write(trace, tmp_path / "bag")
    assert (tmp_path / "bag" / "bag.mcap").exists() == (not interrupted)


def test_an_ignored_interrupt_remains_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        trace = interrupted_walk(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert not trace.interrupted
    assert len(trace) == 21


def system_error(cause):
    error = SystemError("a compiled function returned a result with an exception set")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (system_error(KeyboardInterrupt()), KeyboardInterrupt),
        (system_error(system_error(KeyboardInterrupt())), KeyboardInterrupt),
        (system_error(None), SystemError),
    ],
)
def test_an_interrupt_within_a_compiled_function_is_a_keyboard_interrupt(error, raised):
    """Numba raises a SystemError if the interrupt arrives while a function returns an array."""
    plant = KinematicPlant(legs())
    with mock.patch.object(plant, "step", side_effect=error), pytest.raises(raised):
        list(closed_loop(make_controller(PAPER, legs()), plant))


def test_no_trial_begins_after_an_interrupt():
    with pytest.raises(KeyboardInterrupt):
        trial.walk(PAPER, legs(), "integrator", lambda *_: signal.raise_signal(signal.SIGINT))


@pytest.mark.parametrize(("program", "imported"), [("bin/dqwalk", "click"), ("scripts/controller", "msgspec")])
def test_an_interrupt_while_a_program_imports_its_modules_ends_it_silently(program, imported, tmp_path):
    (tmp_path / f"{imported}.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    done = subprocess.run(
        [sys.executable, ROOT / program, "--help"],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"},
        capture_output=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, b"", b"")


def test_an_interrupt_is_not_lost_where_what_is_protected_from_it_fails():
    def fails():
        with postponed_interrupts():
            signal.raise_signal(signal.SIGINT)
            raise ImportError

    with pytest.raises(KeyboardInterrupt) as caught:
        fails()
    assert isinstance(caught.value.__context__, ImportError)


def test_an_interrupt_while_yourdfpy_is_imported_is_not_lost():
    """To trimesh, which it imports, an optional package is missing whatever is raised while it is imported."""
    code = (
        "import signal, sys\nfrom dqwalk_ros.robot.urdf import Urdf\n"
        "class Finder:\n    def find_spec(self, name, *_):\n"
        "        if name == 'shapely.geometry': sys.meta_path.remove(self); signal.raise_signal(signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\nsys.meta_path.insert(0, Finder())\n"
        "try: Urdf('<robot/>', 'test')\nexcept KeyboardInterrupt: print('interrupted')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.stdout == "interrupted\n", done.stderr
