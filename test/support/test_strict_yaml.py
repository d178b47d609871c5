"""The reader of YAML files; its errors are tested with the configurations."""

from __future__ import annotations

from dqwalk_ros.support import strict_yaml


def test_what_is_read_belongs_to_its_reader() -> None:
    """A change of it changes nothing that is read later from the same text."""
    text = "a: {b: [1, 2]}"
    first = strict_yaml.read(text)
    first["a"]["b"].append(3)
    assert strict_yaml.read(text) == {"a": {"b": [1, 2]}}
