"""Names that a package imports on first use are the same for a program and for a type checker."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest


@pytest.mark.parametrize("package", ["dqwalk_ros", "dqwalk_ros.report", "dqwalk_ros.report.bag"])
def test_every_public_name_is_what_a_type_checker_sees(package: str) -> None:
    module = import_module(package)
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    (checked,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in checked.body for alias in node.names}  # type: ignore[attr-defined]
    assert seen.keys() == set(module.__all__) - {"__version__"}
    for name, source in seen.items():
        assert getattr(module, name) is getattr(import_module(source), name)


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'dqwalk_ros' has no attribute 'lode'"):
        _ = import_module("dqwalk_ros").lode
