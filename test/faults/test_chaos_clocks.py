"""Steps of the system clock and of simulated time during a walk, with live nodes (part of `make chaos`).

stepped_clock.c changes the system clock of the nodes' processes, and every wait that depends on it; their steady clock
is not changed. libfaketime is not used, because it leaves some waits unchanged, which blocks nodes that a real step of
the clock does not disturb.
"""

from __future__ import annotations

import itertools
import mmap
import shutil
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from chaos import BUSY, Chaos, row
from rosgraph_msgs.msg import Clock

from dqwalk_ros.cli.runner import private_domain

pytestmark = [pytest.mark.long, pytest.mark.timeout(300), pytest.mark.xdist_group("chaos")]


def stepped_clock(folder: Path) -> Path:
    """Compile the library that makes the system clock of a process adjustable; return its path."""
    compiler, library = shutil.which("cc") or shutil.which("gcc"), folder / "stepped_clock.so"
    assert compiler, "these tests need a C compiler: make chaos installs one (apt install gcc libc6-dev)"
    source = Path(__file__).with_name("stepped_clock.c")
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, source, "-ldl", "-lpthread"], check=True)
    return library


@contextmanager
def walking(folder: Path, *plant: str) -> Iterator[Chaos]:
    with private_domain() as domain, closing(Chaos(folder, domain, {})) as one:
        one.start_relayed("integrator", *plant)
        one.start_relayed("controller")
        yield one


def disturbance(one: Chaos, since: float) -> float:
    """Return the longest time without motion since `since` [s]."""
    moved = [(at, q) for at, q in one.moved if at >= since]
    going = [a for (a, p), (_, q) in itertools.pairwise(moved) if (p != q).any()]
    return float(np.diff([since, *going, moved[-1][0]]).max())


@pytest.fixture(scope="module")
def set_clock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Chaos, Callable[[int], None]]]:
    folder = tmp_path_factory.mktemp("clocks")
    offset = folder / "offset"
    offset.write_bytes(bytes(8))

    library = stepped_clock(folder)
    with (
        offset.open("r+b") as file,
        mmap.mmap(file.fileno(), 8) as page,
        pytest.MonkeyPatch.context() as environment,
    ):
        environment.setenv("LD_PRELOAD", str(library))
        environment.setenv("STEPPED_CLOCK", str(offset))

        def set_to(seconds: int) -> None:
            page[:] = struct.pack("=q", seconds * 1_000_000_000)

        with walking(folder) as one:
            one.until_walking(120.0)
            yield one, set_to


@pytest.mark.parametrize("seconds", [-100, 100, -3600, 0])
def test_step_of_the_system_clock(set_clock: tuple[Chaos, Callable[[int], None]], seconds: int) -> None:
    """Offsets one after the other [s]: back, ahead, far back, and 0 again."""
    one, set_to = set_clock
    one.until_walking()
    one.spin(0.5)
    before, began = one.stamp(), time.monotonic()
    set_to(seconds)
    one.until(lambda: abs(one.stamp() - before) > 50.0, 20.0, "the step of the clock")
    one.spin(1.0)
    one.until_walking()
    one.spin(0.5)
    took = disturbance(one, began)
    assert took < BUSY + 1.0
    assert all(one.processes.exit_code(name) is None for name in ("integrator", "controller"))
    step = one.stamp() - before - (time.monotonic() - began)
    row(
        f"step of the system clock by {step:+.0f} s",
        "one timeout at most: timers use the steady clock",
        took,
        "walk resumed",
    )


def test_simulated_time_steps_back_and_stops(tmp_path: Path) -> None:
    """The plant takes its stamps from /clock, which steps back by 100 s; later it stops and continues."""
    with walking(tmp_path, "use_sim_time:=true") as one:
        clock = one.node.create_publisher(Clock, "/clock", 10)
        offset, stopped = [1000.0 - time.monotonic()], [0.0]

        def tick() -> None:
            now = stopped[0] or time.monotonic() + offset[0]
            clock.publish(Clock(clock=Time(sec=int(now), nanosec=int(1e9 * (now % 1.0)))))

        one.node.create_timer(0.01, tick)
        one.until_walking(120.0)
        one.spin(1.0)
        began = time.monotonic()
        offset[0] -= 100.0
        one.until(lambda: one.stamp() < time.monotonic() + offset[0] + 50.0, 20.0, "the step")
        one.spin(1.0)
        one.until_walking()
        took = disturbance(one, began)
        assert took < BUSY + 1.0
        row("/clock steps back by 100 s", "one timeout at most", took, "walk resumed")

        stopped[0] = time.monotonic() + offset[0]
        took = one.until_standing()
        assert took < BUSY
        one.spin(0.5)
        assert one.standing()
        offset[0] = stopped[0] - time.monotonic()
        stopped[0] = 0.0
        one.until_walking()
        row("/clock stops", "states with equal stamps are ignored: zeros, the plant holds", took, "walk resumed")
