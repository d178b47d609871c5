"""Fixtures of the tests of recordings and reports: a walk, by default the short one, and its bag."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded import short_walk

from dqwalk_ros.report import bag
from dqwalk_ros.trace import Trace


@pytest.fixture(scope="module")
def trace() -> Trace:
    return short_walk()


@pytest.fixture(scope="module")
def path(trace: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "walk"
    bag.write(trace, path)
    return path
