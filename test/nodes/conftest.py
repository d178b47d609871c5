"""Fixtures of the tests of the nodes' decisions."""

from __future__ import annotations

import pytest

from dqwalk_ros.config import load
from dqwalk_ros.robot.model import RobotModel, load_model


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return load_model(load("paper").robot)
