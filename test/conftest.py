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
