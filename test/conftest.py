"""Fixtures of all tests."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import declared
import pytest
import robots

from dqwalk_ros.config import Config, load
from dqwalk_ros.robot import Foot, RobotModel

# a background job of a script ignores SIGINT, and one of nohup SIGHUP, and a started process inherits this
for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)


SLOWEST = (
    *("test_nodes", "test_study", "test_runner", "test_walk", "test_driver", "test_bag", "test_cli"),
    *("test_html_report", "test_damaged_bags", "test_analysis", "test_poppy_faults", "test_identify", "test_viewer"),
    *("test_kinematics", "test_startup", "test_interoperability", "test_physics_nodes", "test_two_robots"),
)
"""Files that take longest, longest first. They are started first, so that all workers of pytest-xdist end together."""


def pytest_configure(config: pytest.Config) -> None:
    config.option.loadscopereorder = False  # pytest-xdist would start the files with the most tests first


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> declared.Module:
    return declared.Module.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    return (yield from declared.skip_where_missing())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    return (yield from declared.skip_where_missing())


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
