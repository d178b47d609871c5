"""Finds the largest load that is survived, by doubling and bisection."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Bracket(NamedTuple):
    """The interval that contains the limit."""

    survived: float
    """The largest load that was survived."""
    failed: float | None
    """The smallest load that was not, at most the tolerance above `survived`; None if no load failed."""
    reason: str
    """Why it was not survived."""


def largest(fails: Callable[[float], str], first: float, most: float, tolerance: float) -> Bracket:
    """Double a load, from `first` to `most`, until it is not survived, then bisect down to the tolerance.

    Assumes that a robot that survives a load also survives every smaller one. `fails` returns why a load is not
    survived, an empty text if it is survived.
    """
    survived, failed, reason = 0.0, None, ""
    while survived < most and failed is None:
        tried = min(max(2.0 * survived, first), most)
        if reason := fails(tried):
            failed = tried
        else:
            survived = tried
    while failed is not None and failed - survived > tolerance:
        tried = 0.5 * (survived + failed)
        if not survived < tried < failed:  # no number is between them
            break
        if why := fails(tried):
            failed, reason = tried, why
        else:
            survived = tried
    return Bracket(survived, failed, reason)
