"""Checks of the environment variables of ROS, which ROS itself checks late, and partly by ending the process."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import listed

_LAST_DOMAIN = 232
"""The ports of higher domains would be above 65535."""


def check_ros_environment(environment: Mapping[str, str] = os.environ) -> None:
    """Raise ConfigError if a node cannot start, or hears no other, with the environment variables of ROS as set."""
    domain, rmw = environment.get("ROS_DOMAIN_ID", ""), environment.get("RMW_IMPLEMENTATION", "")
    if domain and not (domain.isdecimal() and len(domain) < 10 and int(domain) <= _LAST_DOMAIN):
        raise ConfigError(
            f"the environment variable ROS_DOMAIN_ID is {domain!r:.40}; set it to a whole number from 0 to "
            f"{_LAST_DOMAIN}, or unset it"
        )
    if environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "OFF" and environment.get("ROS_LOCALHOST_ONLY") != "1":
        raise ConfigError(
            "the environment variable ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, so no node hears another one, not even on "
            "this machine; set it to LOCALHOST or SUBNET, or unset it"
        )
    known = _middlewares(environment)
    if rmw and known and rmw not in known:
        raise ConfigError(
            f"the environment variable RMW_IMPLEMENTATION is {rmw!r:.60}, which is not installed; set it to one of "
            f"{listed(known)}, or unset it"
        )


def _middlewares(environment: Mapping[str, str]) -> set[str]:
    """Return the names of the installed middlewares, as far as they are in the ament index."""
    prefixes = [*filter(None, environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    indices = (Path(prefix) / "share/ament_index/resource_index/rmw_typesupport" for prefix in prefixes)
    return {file.name for index in indices if index.is_dir() for file in index.iterdir()} - {"rmw_implementation"}
