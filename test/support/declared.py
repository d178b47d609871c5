"""Packages that may be missing: ROS, and those without a rosdep key, which package.xml cannot declare.

A test that needs one of them is skipped if it is not installed. As a pytest plugin (``-p declared``) this file makes
all of them unimportable, so that the tests run as on such a machine.
"""

from __future__ import annotations

import importlib.abc
import importlib.util
import sys
from collections.abc import Iterator
from typing import Any

import pytest

OPTIONAL = frozenset(
    {
        *("daqp", "distributed", "mink", "mujoco", "pin", "pink", "pinocchio", "placo", "playwright"),
        *("pyarrow", "quadprog", "qpsolvers", "viser"),
    }
)


def missing(error: BaseException | None) -> str:
    """Return which missing package caused an error; empty if it has another cause."""
    while error is not None:
        name = (getattr(error, "name", None) or "").partition(".")[0]
        if isinstance(error, ModuleNotFoundError) and name in OPTIONAL:
            return f"{name}, which has no rosdep key"
        if name.endswith(("rclpy", "_msgs", "_srvs")) and importlib.util.find_spec("rclpy") is None:
            return "ROS 2: source one, or pip install '.[ros]'"
        error = error.__cause__ or error.__context__
    return ""


class Module(pytest.Module):
    """A test module, skipped if it imports an optional package that is not installed."""

    def _getobj(self) -> Any:
        try:
            return super()._getobj()
        except self.CollectError as error:
            if name := missing(error):
                pytest.skip(f"needs {name}", allow_module_level=True)
            raise


def skip_where_missing() -> Iterator[None]:
    """Run a test or a fixture; skip it if an optional package is missing."""
    try:
        return (yield)
    except Exception as error:
        if name := missing(error):
            pytest.skip(f"needs {name}")
        raise


class _Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name: str, path: Any, target: Any = None) -> None:
        if name.partition(".")[0] in OPTIONAL:
            raise ModuleNotFoundError(f"No module named {name!r} (hidden)", name=name)


def pytest_load_initial_conftests() -> None:
    """Make the optional packages unimportable."""
    sys.meta_path.insert(0, _Hidden())
