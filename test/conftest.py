"""Fixtures of all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import declared
import pytest
import robots
from hypothesis import HealthCheck, settings
from stepped_time import SteppedTime

from dqwalk_ros.cli.runner import private_domain
from dqwalk_ros.config import Config, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel

# a background job of a script ignores SIGINT, and one of nohup SIGHUP, and a started process inherits this
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


# the same examples every time, and no failure of a busy machine
settings.register_profile(
    "dqwalk",
    deadline=None,
    derandomize=True,
    max_examples=40,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("dqwalk")

HERE = Path(__file__).parent

SLOWEST = (
    "studies/test_runner.py",
    "studies/test_study_files.py",
    "studies/test_pushes.py",
    "nodes/test_nodes.py",
    "walks/dynamic/test_obstacles.py",
    "walks/dynamic/test_pushes.py",
    "walks/test_dynamic.py",
    "paper/test_paper_walk.py",
    "plants/test_poppy_faults.py",
    "interop/test_interoperability.py",
    "adopt/test_stance.py",
    "nodes/test_poppy_driver.py",
    "cli/test_cli.py",
    "faults/test_restart.py",
    "cli/test_runner.py",
    "faults/test_strangers.py",
    "adopt/test_adopt.py",
    "whole_body/test_nodes.py",
    "report/test_damaged_bags.py",
    "faults/test_glitches.py",
    "package/test_startup.py",
    "report/test_bag.py",
    "report/test_html.py",
    "walks/test_standing.py",
    "nodes/test_plant.py",
    "nodes/test_robot_controllers.py",
    "nodes/test_drive_walks.py",
    "whole_body/test_controller.py",
    "cli/test_results.py",
)
"""Files that take longest, longest first. They are started first, so that all workers of pytest-xdist end together."""


def pytest_configure(config: pytest.Config) -> None:
    config.option.loadscopereorder = False  # pytest-xdist would start the files with the most tests first


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the package once, before pytest-xdist starts its workers."""
    if getattr(session.config.option, "numprocesses", None):
        import warm

        warm.compile_all()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile the package before tests of nodes: on a busy machine this takes longer than the timeout of a test.

    What has been imported is no garbage; to look through it again and again takes a tenth of the time of all tests.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    if "rclpy" in sys.modules and not session.config.option.collectonly:
        import warm

        warm.compile_all()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: rank.get(item.path.relative_to(HERE).as_posix(), len(rank)))


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> declared.Module:
    return declared.Module.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    return (yield from declared.skip_where_missing())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    return (yield from declared.skip_where_missing())


@pytest.fixture(autouse=True)
def signal_handlers() -> Iterator[None]:
    """Restore the handlers of signals, which a node that runs in the process of the tests replaces."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def paper() -> Config:
    """The paper's configuration."""
    return load("paper")


@pytest.fixture(scope="session")
def legs() -> RobotModel:
    """The robot of the paper: pelvis and legs of Poppy."""
    return robots.legs()


@pytest.fixture(params=list(Foot), ids=lambda foot: foot.value)
def foot(request: pytest.FixtureRequest) -> Foot:
    """Each foot in turn."""
    return request.param


@pytest.fixture(params=list(robots.ROBOTS))
def robot(request: pytest.FixtureRequest) -> RobotModel:
    """Each robot in turn."""
    return robots.ROBOTS[request.param]()


@pytest.fixture
def clock() -> SteppedTime:
    """A clock that a test advances."""
    return SteppedTime(100.0)


@pytest.fixture
def domain() -> Iterator[int]:
    """A ROS domain that no other test uses."""
    with private_domain() as number:
        yield number


@pytest.fixture
def make(tmp_path: Path, domain: int) -> Iterator[Any]:
    """A function that makes nodes in the process of the test, with one clock; see `inside.Inside`."""
    from inside import Inside

    made: list[Inside] = []
    clock = SteppedTime(100.0)

    def make(name: str, config: Config | str, *own: str, ros: tuple[str, ...] = ()) -> Inside:
        made.append(Inside(name, config, tmp_path, *own, ros=ros, domain=domain, clock=clock))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def nodes(tmp_path: Path, domain: int) -> Iterator[Callable[..., Any]]:
    """A function of a configuration that returns a `live.Live`, or another kind of it, whose nodes are processes."""
    from live import Live

    made: list[Live] = []

    def start(config: Config, name: str = "test", kind: type[Live] = Live) -> Live:
        folder = tmp_path / name
        folder.mkdir()
        made.append(kind(folder, domain, config, name=name))
        return made[-1]

    yield start
    for one in reversed(made):
        one.close()
