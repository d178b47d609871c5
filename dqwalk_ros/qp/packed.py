"""How the arrays of a quadratic program (6) lie in one buffer, so that compiled functions take one argument for all."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.kernels import jit

__all__ = ["size", "split", "views"]

Array = NDArray[np.float64]


def size(n: int, l: int, m: int, r: int) -> int:  # noqa: E741
    """Return how many numbers a problem of n variables, l equalities, m inequalities and r rows of J has."""
    return n * (n + 4) + (l + m) * (n + 1) + r * n


def views(values: Array, n: int, l: int, m: int, r: int) -> tuple[Array, ...]:  # noqa: E741
    """Return H (n, n), c, lower, upper, diagonal (n,), W (l + m, n) and w of equalities and inequalities, J (r, n)."""
    k = l + m
    at = n * n
    H = values[:at].reshape((n, n))
    c, lower, upper = values[at : at + n], values[at + n : at + 2 * n], values[at + 2 * n : at + 3 * n]
    diagonal = values[at + 3 * n : at + 4 * n]
    at += 4 * n
    W, w = values[at : at + k * n].reshape((k, n)), values[at + k * n : at + k * (n + 1)]
    at += k * (n + 1)
    return H, c, lower, upper, diagonal, W, w, values[at : at + r * n].reshape((r, n))


split: Any = jit(views)
"""`views`, for compiled functions."""
