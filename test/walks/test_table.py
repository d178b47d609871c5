"""A user's own walk, named by ``gait.walk``."""

from __future__ import annotations

import pytest

from dqwalk_ros.config import load
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.table import walk_type


@pytest.mark.parametrize("name", ["own_walk", "own_walk:LowWalk", "nowhere:HighWalk", "own_walk:ComAbove", ":"])
def test_an_unknown_walk_class_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"gait\.walk is"):
        walk_type(load("paper").updated({"gait.walk": name}))
