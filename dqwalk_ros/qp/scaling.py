"""The scaling of (6) before it is solved, and the check of the answer after; compiled.

The costs of a slow walk are tiny (joint velocities down to 1e-6 rad/s), so a solver's absolute tolerances never count
unless the problem is scaled first: u = s v with s the length of a gradient step (or the longest step a row asks for),
and the objective divided by its mean curvature.
"""

from __future__ import annotations

import math

from dqwalk_ros.kernels import jit

__all__ = [
    "check",
    "pack_active_set",
    "pack_interior_point",
    "pack_nearby",
    "scales",
    "unpack_active_set",
    "unpack_interior_point",
    "unpack_nearby",
]


@jit
def scales(H, c, E, e, G, h, lower, upper):  # type: ignore[no-untyped-def]
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
    for k in range(e.shape[0]):
        asked = max(asked, abs(e[k]))
        total += e[k]
        for i in range(n):
            total += E[k, i]
    for k in range(h.shape[0]):
        asked = max(asked, h[k])
        total += h[k]
        for i in range(n):
            total += G[k, i]
    s = max(math.sqrt(square) / curvature, asked)
    if not math.isfinite(total + square):
        s = math.nan
    elif s == 0.0:
        s = 1.0
    return s, curvature


@jit
def _objective(H, c, diagonal, r, s, curvature, P, q):  # type: ignore[no-untyped-def]
    """Fill P, the upper triangle of H or with r > 0 diag(diagonal, 1), and q."""
    n, k = c.shape[0], 0
    for i in range(n):
        if r > 0:
            P[i] = diagonal[i] / curvature
        else:
            for j in range(i + 1):
                P[k] = H[i, j] / curvature
                k += 1
        q[i] = c[i] / (s * curvature)
    for j in range(r):
        P[n + j] = 1.0 / curvature
        q[n + j] = 0.0


@jit
def pack_interior_point(H, c, E, e, G, h, lower, upper, diagonal, J, cap, sizes, out):  # type: ignore[no-untyped-def]
    """Fill P, q, A, b of min 1/2 v'Pv + q'v, A v + slack = b, column by column, into `out`; return s and curvature.

    Rows are [E; -G; I; -I]. With P dense it is the upper triangle of H; lifted (sizes[4] = 1) the variables are
    (v, y) with the rows y - J v = 0 first and P = diag(diagonal, 1). Where b is above `cap` it is capped; the whole
    b comes after the capped one.
    """
    s, curvature = scales(H, c, E, e, G, h, lower, upper)
    n, l, m = c.shape[0], e.shape[0], h.shape[0]  # noqa: E741
    lifted = sizes[4] == 1
    r = J.shape[0] if lifted else 0
    P, q, A, b = out[: sizes[0]], out[sizes[0] : sizes[1]], out[sizes[1] : sizes[2]], out[sizes[2] : sizes[3]]
    full = out[sizes[3] :]
    _objective(H, c, diagonal, r, s, curvature, P, q)
    k = 0
    for i in range(n):
        for j in range(r):
            A[k] = -J[j, i]
            k += 1
        for j in range(l):
            A[k] = E[j, i]
            k += 1
        for j in range(m):
            A[k] = -G[j, i]
            k += 1
        A[k] = 1.0
        A[k + 1] = -1.0
        k += 2
    for j in range(r):
        A[k + j] = 1.0
        b[j] = full[j] = 0.0
    for j in range(l):
        b[r + j] = full[r + j] = e[j] / s
    for j in range(m):
        full[r + l + j] = -h[j] / s
    for i in range(n):
        full[r + l + m + i] = upper[i] / s
        full[r + l + m + n + i] = -lower[i] / s
    for j in range(r + l, b.shape[0]):
        b[j] = min(full[j], cap)
    return s, curvature


@jit
def _room(j, G, h, lower, upper):  # type: ignore[no-untyped-def]
    """Return the room of an inequality at u = 0; they are numbered as the rows [G; upper; lower]."""
    n, m = upper.shape[0], h.shape[0]
    if j < m:
        return -h[j]
    return upper[j - m] if j < m + n else -lower[j - m - n]


@jit
def pack_nearby(H, c, E, e, G, h, lower, upper, diagonal, J, reach, most, chosen, out):  # type: ignore[no-untyped-def]
    """Fill P, q, A, b as `pack_interior_point` does, with the inequalities within `reach` of u = 0 alone.

    They are dense rows, whichever they are. Their numbers are written to `chosen`, the nearest one at least; beyond
    `most` of them nothing is filled. With a `diagonal` the form is lifted. Return s, curvature and their count.
    """
    s, curvature = scales(H, c, E, e, G, h, lower, upper)
    n, l, m, r = c.shape[0], e.shape[0], h.shape[0], J.shape[0]  # noqa: E741
    count, nearest, least = 0, 0, math.inf
    for j in range(m + 2 * n):
        room = _room(j, G, h, lower, upper) / s
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
    p = n + r if r > 0 else n * (n + 1) // 2
    k = p + n + r
    _objective(H, c, diagonal, r, s, curvature, out[:p], out[p:k])
    for i in range(n):
        for j in range(r):
            out[k] = -J[j, i]
            k += 1
        for j in range(l):
            out[k] = E[j, i]
            k += 1
        for j in chosen[:count]:
            if j < m:
                out[k] = -G[j, i]
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
        out[k] = e[j] / s
        k += 1
    for j in chosen[:count]:
        out[k] = _room(j, G, h, lower, upper) / s
        k += 1
    return s, curvature, count


@jit
def pack_active_set(H, c, E, e, G, h, lower, upper, H_out, c_out, A_out, high, low):  # type: ignore[no-untyped-def]
    """Fill H, c, A and the bounds of low <= [v; A v] <= high, scaled; return s and curvature."""
    s, curvature = scales(H, c, E, e, G, h, lower, upper)
    n, l = c.shape[0], e.shape[0]  # noqa: E741
    for i in range(n):
        for j in range(n):
            H_out[i, j] = H[i, j] / curvature
        c_out[i] = c[i] / (s * curvature)
        high[i], low[i] = upper[i] / s, lower[i] / s
    for k in range(l):
        for i in range(n):
            A_out[k, i] = E[k, i]
        high[n + k] = low[n + k] = e[k] / s
    for k in range(h.shape[0]):
        for i in range(n):
            A_out[l + k, i] = G[k, i]
        low[n + l + k] = h[k] / s
    return s, curvature


@jit
def check(H, c, E, e, G, h, lower, upper, u, z, s, curvature):  # type: ignore[no-untyped-def]
    """Return the largest scaled violation of a row, that row, and the other KKT residuals' largest, relative.

    The multipliers z are those of the equalities, inequalities, upper and lower bounds.
    """
    n, l, m = c.shape[0], e.shape[0], h.shape[0]  # noqa: E741
    worst, row, other = 0.0, -1, 0.0
    force = s * curvature
    gradient = c.copy()
    for i in range(n):
        for j in range(n):
            gradient[i] += H[i, j] * u[j]
        gradient[i] += z[l + m + i] - z[l + m + n + i]
    for k in range(l + m):
        value = 0.0
        for i in range(n):
            a = E[k, i] if k < l else G[k - l, i]
            value += a * u[i]
            gradient[i] += a * z[k] if k < l else -a * z[k]
        force = max(force, abs(z[k]))
        if k < l:
            off = abs(value - e[k]) / s
        else:
            off = (h[k - l] - value) / s
            other = max(other, -z[k] / force, abs(z[k] / force * off))
        if not off <= worst:
            worst, row = off, k
    for i in range(n):
        for j in range(2):
            k = l + m + j * n + i
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
def unpack_interior_point(  # type: ignore[no-untyped-def]
    H, c, E, e, G, h, lower, upper, s, curvature, x, z, first, u_out, z_out
):
    """Scale the answer back into u and z, and `check` it; the multipliers begin at `first`."""
    for i in range(u_out.shape[0]):
        u_out[i] = s * x[i]
    for k in range(z_out.shape[0]):
        z_out[k] = s * curvature * z[first + k]
    return check(H, c, E, e, G, h, lower, upper, u_out, z_out, s, curvature)


@jit
def unpack_nearby(  # type: ignore[no-untyped-def]
    H, c, E, e, G, h, lower, upper, s, curvature, chosen, count, x, z, first, u_out, z_out
):
    """Scale the answer back into u and z, and `check` it; fourth, the least room that a row left out has [s]."""
    n, l, m = c.shape[0], e.shape[0], h.shape[0]  # noqa: E741
    for i in range(n):
        u_out[i] = s * x[i]
    for k in range(l):
        z_out[k] = s * curvature * z[first + k]
    least, k = math.inf, 0
    for j in range(m + 2 * n):
        z_out[l + j] = 0.0
        if k < count and chosen[k] == j:
            z_out[l + j] = s * curvature * z[first + l + k]
            k += 1
            continue
        room = _room(j, G, h, lower, upper)
        if j < m:
            for i in range(n):
                room += G[j, i] * u_out[i]
        else:
            room += -u_out[j - m] if j < m + n else u_out[j - m - n]
        least = min(least, room / s)
    worst, row, other = check(H, c, E, e, G, h, lower, upper, u_out, z_out, s, curvature)
    return worst, row, other, least


@jit
def unpack_active_set(  # type: ignore[no-untyped-def]
    H, c, E, e, G, h, lower, upper, s, curvature, x, z, u_out, z_out
):
    """Scale the answer back into u and z, and `check` it; lower bounds have negative multipliers in daqp."""
    n, l, m = c.shape[0], e.shape[0], h.shape[0]  # noqa: E741
    force = s * curvature
    for i in range(n):
        u_out[i] = s * x[i]
        z_out[l + m + i] = force * max(z[i], 0.0)
        z_out[l + m + n + i] = force * max(-z[i], 0.0)
    for k in range(l):
        z_out[k] = force * z[n + k]
    for k in range(m):
        z_out[l + k] = -force * z[n + l + k]
    return check(H, c, E, e, G, h, lower, upper, u_out, z_out, s, curvature)
