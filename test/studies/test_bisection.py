"""Bisection for the largest load."""

from __future__ import annotations

import pytest

from dqwalk_ros.studies.bisection import largest


@pytest.mark.parametrize("limit", [0.77, 0.001, 3.999, 0.25])
def test_the_largest_load_is_found_by_bisection(limit):
    tried = []

    def fails(load):
        tried.append(load)
        return "" if load < limit else "fell"

    found = largest(fails, first=0.25, most=4.0, tolerance=0.02)
    assert found.survived < limit <= found.failed <= found.survived + 0.02
    assert found.reason == "fell"
    assert len(tried) < 14
    nothing = largest(lambda load: "", first=0.25, most=4.0, tolerance=0.02)
    assert (nothing.survived, nothing.failed, nothing.reason) == (4.0, None, "")
