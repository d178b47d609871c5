"""Files that are not parameter files: each is rejected with its line."""

from __future__ import annotations

import pytest

from dqwalk_ros.config import Config, from_yaml, load, to_yaml
from dqwalk_ros.errors import ConfigError

HEAD = "/**:\n  ros__parameters:\n"
BOMB = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))

BAD = {
    "a key twice": (HEAD + "    dt: 0.005\n    dt: 0.01\n", "line 4: .*'dt' was given in line 3"),
    "a section twice": (
        HEAD + "    gait: {cycles: 1}\n    gait: {cycles: 2}\n",
        "line 4: .*'gait' was given in line 3",
    ),
    "a node twice": ("/**: {ros__parameters: {}}\n/**: {ros__parameters: {}}\n", "line 2: .*was given in line 1"),
    "dotted and nested": (HEAD + "    gait.cycles: 1\n    gait: {cycles: 2}\n", "'gait.cycles' is given twice"),
    "a typo": (
        HEAD + "    gait:\n      cylces: 2\n",
        "line 4: unknown parameter 'gait.cylces'; did you mean 'gait.cycles'",
    ),
    "out of range": (HEAD + "    dt: -1.0\n", "line 3: 'dt' must be a number in"),
    "wrong type": (
        HEAD + "    gait:\n      cycles: two\n",
        "line 4: 'gait.cycles' must be a whole number in .*, got 'two'",
    ),
    "half a cycle": (HEAD + "    gait: {cycles: 1.5}\n", "must be a whole number"),
    "nan": (HEAD + "    dt: .nan\n", "line 3: 'dt' must be a number in .*, got nan"),
    "inf": (HEAD + "    dt: .inf\n", "must be a number in .*, got inf"),
    "nothing": (HEAD + "    dt:\n", "line 3: 'dt' must be a number in .*, got None"),
    "a list": (HEAD + "    dt: [0.005]\n", "must be a number"),
    "a truth": (HEAD + "    dt: true\n", "must be a number"),
    "400 digits": (HEAD + f"    dt: {'9' * 400}\n", "must be a number in"),
    "5000 digits": (HEAD + f"    dt: {'9' * 5000}\n", "not YAML"),
    "a date": (HEAD + "    dt: 2001-99-99\n", "not YAML"),
    "a tab": (HEAD + "\tdt: 1\n", "line 3: not YAML"),
    "an open bracket": (HEAD + "    dt: [1\n", "line 4: not YAML"),
    "a bomb": (BOMB, "line 1: not YAML: anchors"),
    "an alias": (HEAD + "    dt: *x\n", "line 3: not YAML: anchors"),
    "a merge": (HEAD + "    <<: {dt: 1}\n", "line 3: not YAML: merge keys"),
    "code": ("!!python/object/apply:os.system ['true']", "not YAML"),
    "a tag": (HEAD + "    dt: !x 1\n", "line 3: not YAML"),
    "two documents": (f"{HEAD}    dt: 0.005\n---\n{HEAD}    dt: 0.01\n", "not YAML"),
    "too deep": ("[" * 5000, "nested too deeply"),
    "too long": ("#" * (1 << 20) + "\n", "longer than 1 MiB"),
    "a list as key": (HEAD + "    ? [a]\n    : 1\n", "line 3: not YAML: found unhashable key"),
    "a number as key": (HEAD + "    1: 2\n", "not a text"),
    "no node": ("dt: 0.005\n", "expected '/\\*\\*"),
    "no ros__parameters": ("/**:\n  dt: 0.005\n", "must hold 'ros__parameters'"),
    "empty": ("", "expected"),
    "a zero": ("\x00", "not YAML"),
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_files_are_rejected_with_the_line(name: str) -> None:
    text, expected = BAD[name]
    with pytest.raises(ConfigError, match=expected) as caught:
        from_yaml(text, source="file.yaml")
    assert str(caught.value).startswith("file.yaml")
    assert len(str(caught.value)) < 1000


def test_integers_are_accepted_for_real_parameters() -> None:
    assert from_yaml(HEAD + "    task: {eta: 1}\n").task.eta == 1.0


def test_numbers_in_exponent_notation_are_accepted() -> None:
    """As in rcl; by YAML 1.1 alone it would be a string."""
    assert from_yaml(HEAD + "    task: {eta: 5e-2}\n").task.eta == 0.05


def test_written_configurations_can_be_loaded() -> None:
    for config in (Config(), load("paper")):
        assert from_yaml(to_yaml(config)) == config
