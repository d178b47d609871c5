"""Rows of an equality made independent, compiled."""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.constraints import DEPENDENT
from dqwalk_ros.kernels import jit

__all__ = ["independent"]


@jit
def independent(E, e):  # type: ignore[no-untyped-def]
    """Turn the rows of E u = e (k, n) into orthogonal ones, in place; those that no joint can move become zero.

    The left singular vectors of E are the eigenvectors of E E', by Jacobi's rotations.
    """
    k, n = E.shape
    A, V = np.empty((k, k)), np.zeros((k, k))
    for i in range(k):
        V[i, i] = 1.0
        for j in range(i + 1):
            total = 0.0
            for m in range(n):
                total += E[i, m] * E[j, m]
            A[i, j] = A[j, i] = total
    for _ in range(30):
        off, on = 0.0, 0.0
        for i in range(k):
            on += A[i, i] * A[i, i]
            for j in range(i):
                off += A[i, j] * A[i, j]
        if off <= 1e-30 * on:
            break
        for i in range(k - 1):
            for j in range(i + 1, k):
                if A[i, j] == 0.0:
                    continue
                theta = (A[j, j] - A[i, i]) / (2.0 * A[i, j])
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for m in range(k):
                    a, b = A[m, i], A[m, j]
                    A[m, i], A[m, j] = c * a - s * b, s * a + c * b
                for m in range(k):
                    a, b = A[i, m], A[j, m]
                    A[i, m], A[j, m] = c * a - s * b, s * a + c * b
                for m in range(k):
                    a, b = V[m, i], V[m, j]
                    V[m, i], V[m, j] = c * a - s * b, s * a + c * b
    largest = 0.0
    for i in range(k):
        largest = max(largest, A[i, i])
    rows, right = E.copy(), e.copy()
    for i in range(k):
        kept = A[i, i] > DEPENDENT * DEPENDENT * largest
        e[i] = 0.0
        for m in range(n):
            E[i, m] = 0.0
        if kept:
            for j in range(k):
                e[i] += V[j, i] * right[j]
                for m in range(n):
                    E[i, m] += V[j, i] * rows[j, m]
