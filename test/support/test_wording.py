"""Words of messages."""

from __future__ import annotations

import pytest

from dqwalk_ros.support.wording import listed


@pytest.mark.parametrize(
    ("names", "text"), [([], "none"), (["b", "a"], "a, b"), ([f"{k:02d}" for k in range(14)], None)]
)
def test_a_list_of_names_is_short_and_never_empty(names: list[str], text: str | None) -> None:
    found = listed(names)
    assert found == text if text else found.endswith("10, 11, and 2 more")
