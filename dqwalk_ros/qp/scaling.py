"""The scaling of (6) before it is solved, and the check of the answer after; compiled.

The costs of a slow walk are tiny (joint velocities down to 1e-6 rad/s), so a solver's absolute tolerances never count
unless the problem is scaled first: u = s v with s the length of a gradient step (or the longest step a row asks for),
and the objective divided by its mean curvature.
"""

from __future__ import annotations

import math

from dqwalk_ros.kernels import jit
from dqwalk_ros.qp.packed import split

__all__ = [
    "check",
    "pack_active_set",
    "pack_interior_point",
    "pack_nearby",
    "unpack_active_set",
    "unpack_interior_point",
    "unpack_nearby",
]


@jit
def _scales(H, c, lower, upper, W, w, l):  # type: ignore[no-untyped-def] # noqa: E741
    """Return s and the mean curvature; s is nan where any number of the problem is not finite."""
    n = c.shape[0]
    total, square, curvature, asked = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        square += c[i] * c[i]
        curvature += H[i, i] / n
        total += lower[i] + upper[i]
        asked = max(asked, lower[i], -upper[i])
        for j in range(n):
            total += H[i, j]
    for k in range(w.shape[0]):
        asked = max(asked, w[k], -w[k] if k < l else 0.0)
        total += w[k]
        for i in range(n):
            total += W[k, i]
    s = max(math.sqrt(square) / curvature, asked)
    if not math.isfinite(total + square):
        s = math.nan
    elif s == 0.0:
        s = 1.0
    return s, curvature


@jit
def _objective(H, c, diagonal, r, s, curvature, out):  # type: ignore[no-untyped-def]
    """Fill P, the upper triangle of H or with r > 0 diag(diagonal, 1), and q; return how many numbers they are."""
    n, k = c.shape[0], 0
    for i in range(n):
        if r > 0:
            out[k] = diagonal[i] / curvature
            k += 1
        else:
            for j in range(i + 1):
                out[k] = H[i, j] / curvature
                k += 1
    for _ in range(r):
        out[k] = 1.0 / curvature
        k += 1
    for i in range(n):
        out[k] = c[i] / (s * curvature)
        k += 1
    for _ in range(r):
        out[k] = 0.0
        k += 1
    return k


@jit
def pack_interior_point(values, n, l, m, rows, lifted, cap, out):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill P, q, A, b of min 1/2 v'Pv + q'v, A v + slack = b, column by column, into `out`; return s and curvature.

    Rows are [E; -G; I; -I]. With P dense it is the upper triangle of H; lifted the variables are (v, y) with the
    `rows` rows y - J v = 0 first and P = diag(diagonal, 1). Where b is above `cap` it is capped; the whole b comes
    after the capped one.
    """
    H, c, lower, upper, diagonal, W, w, J = split(values, n, l, m, rows)
    s, curvature = _scales(H, c, lower, upper, W, w, l)
    r = rows if lifted else 0
    k = _objective(H, c, diagonal, r, s, curvature, out)
    for i in range(n):
        for j in range(r):
            out[k] = -J[j, i]
            k += 1
        for j in range(l + m):
            out[k] = W[j, i] if j < l else -W[j, i]
            k += 1
        out[k] = 1.0
        out[k + 1] = -1.0
        k += 2
    for _ in range(r):
        out[k] = 1.0
        k += 1
    height = r + l + m + 2 * n
    b, full = out[k : k + height], out[k + height : k + 2 * height]
    for j in range(r):
        b[j] = full[j] = 0.0
    for j in range(l):
        b[r + j] = full[r + j] = w[j] / s
    for j in range(m + 2 * n):
        room = _room(j, w[l:], lower, upper) / s
        full[r + l + j] = room
        b[r + l + j] = min(room, cap)
    return s, curvature


@jit
def _room(j, h, lower, upper):  # type: ignore[no-untyped-def]
    """Return the room of an inequality at u = 0; they are numbered as the rows [G; upper; lower]."""
    n, m = upper.shape[0], h.shape[0]
    if j < m:
        return -h[j]
    return upper[j - m] if j < m + n else -lower[j - m - n]


@jit
def pack_nearby(values, n, l, m, rows, lifted, reach, most, chosen, out):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill P, q, A, b as `pack_interior_point` does, with the inequalities within `reach` of u = 0 alone.

    They are dense rows, whichever they are. Their numbers are written to `chosen`, the nearest one at least; beyond
    `most` of them nothing is filled. Return s, curvature and their count.
    """
    H, c, lower, upper, diagonal, W, w, J = split(values, n, l, m, rows)
    s, curvature = _scales(H, c, lower, upper, W, w, l)
    r, h = rows if lifted else 0, w[l:]
    count, nearest, least = 0, 0, math.inf
    for j in range(m + 2 * n):
        room = _room(j, h, lower, upper) / s
        if room <= reach:
            if count == most:
                return s, curvature, most + 1
            chosen[count] = j
            count += 1
        if room < least:
            nearest, least = j, room
    if count == 0:
        chosen[0] = nearest
        count = 1
    k = _objective(H, c, diagonal, r, s, curvature, out)
    for i in range(n):
        for j in range(r):
            out[k] = -J[j, i]
            k += 1
        for j in range(l):
            out[k] = W[j, i]
            k += 1
        for j in chosen[:count]:
            if j < m:
                out[k] = -W[l + j, i]
            else:
                out[k] = (1.0 if j == m + i else 0.0) - (1.0 if j == m + n + i else 0.0)
            k += 1
    for _ in range(r):
        out[k] = 1.0
        k += 1
    for _ in range(r):
        out[k] = 0.0
        k += 1
    for j in range(l):
        out[k] = w[j] / s
        k += 1
    for j in chosen[:count]:
        out[k] = _room(j, h, lower, upper) / s
        k += 1
    return s, curvature, count


@jit
def pack_active_set(values, n, l, m, rows, out):  # type: ignore[no-untyped-def] # noqa: E741
    """Fill H, c, A, high and low of low <= [v; A v] <= high, scaled, into `out`; return s and curvature.

    What has no upper bound is left as it is.
    """
    at, k = n * (n + 1), l + m
    H_out, c_out, A_out = out[: n * n].reshape((n, n)), out[n * n : at], out[at : at + k * n].reshape((k, n))
    high, low = out[at + k * n : at + k * n + n + k], out[at + k * n + n + k :]
    H, c, lower, upper, _, W, w, _ = split(values, n, l, m, rows)
    s, curvature = _scales(H, c, lower, upper, W, w, l)
    for i in range(n):
        for j in range(n):
            H_out[i, j] = H[i, j] / curvature
        c_out[i] = c[i] / (s * curvature)
        high[i], low[i] = upper[i] / s, lower[i] / s
    for k in range(l + m):
        for i in range(n):
            A_out[k, i] = W[k, i]
        low[n + k] = w[k] / s
        if k < l:
            high[n + k] = low[n + k]
    return s, curvature


@jit
def _check(H, c, lower, upper, W, w, l, u, z, s, curvature):  # type: ignore[no-untyped-def] # noqa: E741
    n, k_all = c.shape[0], w.shape[0]
    worst, row, other = 0.0, -1, 0.0
    force = s * curvature
    gradient = c.copy()
    for i in range(n):
        for j in range(n):
            gradient[i] += H[i, j] * u[j]
        gradient[i] += z[k_all + i] - z[k_all + n + i]
    for k in range(k_all):
        value, sign = 0.0, 1.0 if k < l else -1.0
        for i in range(n):
            value += W[k, i] * u[i]
            gradient[i] += sign * W[k, i] * z[k]
        force = max(force, abs(z[k]))
        if k < l:
            off = abs(value - w[k]) / s
        else:
            off = (w[k] - value) / s
            other = max(other, -z[k] / force, abs(z[k] / force * off))
        if not off <= worst:
            worst, row = off, k
    for i in range(n):
        for j in range(2):
            k = k_all + j * n + i
            force = max(force, abs(z[k]))
            off = ((u[i] - upper[i]) if j == 0 else (lower[i] - u[i])) / s
            other = max(other, -z[k] / force, abs(z[k] / force * off))
            if not off <= worst:
                worst, row = off, k
    for i in range(n):
        if not abs(gradient[i]) <= other * force:
            other = abs(gradient[i]) / force
    return worst, row, other


@jit
def check(values, n, l, m, rows, u, z, s, curvature):  # type: ignore[no-untyped-def] # noqa: E741
    """Return the largest scaled violation of a row, that row, and the other KKT residuals' largest, relative.

    The multipliers z are those of the equalities, inequalities, upper and lower bounds.
    """
    H, c, lower, upper, _, W, w, _ = split(values, n, l, m, rows)
    return _check(H, c, lower, upper, W, w, l, u, z, s, curvature)


@jit
def unpack_interior_point(  # type: ignore[no-untyped-def]
    values, n, l, m, rows, s, curvature, x, z, first, u_out, z_out,  # noqa: E741
):  # fmt: skip
    """Scale the answer back into u and z, and `check` it; the multipliers begin at `first`."""
    for i in range(n):
        u_out[i] = s * x[i]
    for k in range(l + m + 2 * n):
        z_out[k] = s * curvature * z[first + k]
    return check(values, n, l, m, rows, u_out, z_out, s, curvature)


@jit
def unpack_nearby(  # type: ignore[no-untyped-def]
    values, n, l, m, rows, s, curvature, chosen, count, answer, columns, first, u_out, z_out,  # noqa: E741
):  # fmt: skip
    """Scale the answer back into u and z, and `check` it; fourth, the least room that a row left out has [s].

    In `answer` the multipliers come after so many `columns`, and of them the first are those of the lifted form.
    """
    H, c, lower, upper, _, W, w, _ = split(values, n, l, m, rows)
    z, force = answer[columns + first :], s * curvature
    for i in range(n):
        u_out[i] = s * answer[i]
    for k in range(l):
        z_out[k] = force * z[k]
    least, k = math.inf, 0
    for j in range(m + 2 * n):
        z_out[l + j] = 0.0
        if k < count and chosen[k] == j:
            z_out[l + j] = force * z[l + k]
            k += 1
            continue
        room = _room(j, w[l:], lower, upper)
        if j < m:
            for i in range(n):
                room += W[l + j, i] * u_out[i]
        else:
            room += -u_out[j - m] if j < m + n else u_out[j - m - n]
        least = min(least, room / s)
    worst, row, other = _check(H, c, lower, upper, W, w, l, u_out, z_out, s, curvature)
    return worst, row, other, least


@jit
def unpack_active_set(values, n, l, m, rows, s, curvature, x, z, u_out, z_out):  # type: ignore[no-untyped-def] # noqa: E741
    """Scale the answer back into u and z, and `check` it; lower bounds have negative multipliers in daqp."""
    force = s * curvature
    for i in range(n):
        u_out[i] = s * x[i]
        z_out[l + m + i] = force * max(z[i], 0.0)
        z_out[l + m + n + i] = force * max(-z[i], 0.0)
    for k in range(l + m):
        z_out[k] = force * z[n + k] if k < l else -force * z[n + k]
    return check(values, n, l, m, rows, u_out, z_out, s, curvature)
