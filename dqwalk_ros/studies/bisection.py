"""The largest load that is survived, by doubling and bisection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Bracket", "largest"]


@dataclass(frozen=True)
class Bracket:
    """What was found.

    Attributes
    ----------
    survived : float
        The largest load that was survived.
    failed : float or None
        The least that was not, less than the tolerance above; None where nothing failed.
    reason : str
        What failed there.
    """

    survived: float
    failed: float | None
    reason: str


def largest(fails: Callable[[float], str], first: float, most: float, tolerance: float) -> Bracket:
    """Double a load until it is not survived, then bisect.

    A robot that survives a load is taken to survive every lesser one.

    Parameters
    ----------
    fails : callable
        Returns why a load is not survived, an empty text if it is.
    first, most : float
        The first load that is tried, and the largest.
    tolerance : float
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
        if why := fails(tried):
            failed, reason = tried, why
        else:
            survived = tried
    return Bracket(survived, failed, reason)
