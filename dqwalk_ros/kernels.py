"""Compiled kinematics: poses, joint lines and the centre of mass in one pass.

`dq.py` states the same mathematics readably and is the test oracle of everything here; with
``NUMBA_DISABLE_JIT=1`` these functions run as plain Python.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event
from numpy.typing import NDArray

__all__ = [
    "COMPILED",
    "clip",
    "compose",
    "forward",
    "integrate",
    "jit",
    "line_jacobian",
    "point",
    "point_jacobian",
    "pose_jacobian",
    "snapshot",
]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class _Notice(event.Listener):
    """Says once that this process compiles, so that nobody takes the wait for a hang."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        """Compiling begins; what is in the cache is not compiled."""
        if not self._told:
            self._told = True
            logging.getLogger("dqwalk_ros").warning("compiling for this machine; this takes a while, once")

    def on_end(self, event: Any) -> None:
        """Compiling is over."""


event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]

COMPILED = (
    "assembly/compiled.py",
    "assembly/independent.py",
    "standing/paths.py",
    "standing/balance.py",
    "kernels.py",
    "qp/dual.py",
    "qp/packed.py",
    "qp/scaling.py",
)
"""Files with compiled functions."""


def _digest() -> str:
    found = hashlib.sha256()
    for name in COMPILED:
        found.update((Path(__file__).parent / name).read_bytes())
    return found.hexdigest()


_DIGEST = _digest()


def jit(function: Callable[..., Any]) -> Any:
    """Return the function compiled: once per machine, IEEE arithmetic as written.

    Compiled functions contain those they call, but numba takes what it kept for current while the file of the
    function itself is unchanged. Here all files with compiled functions must be.
    """
    compiled: Any = numba.njit(cache=True, fastmath=False, error_model="numpy")(function)
    kept = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if kept is not None:
        kept._source_stamp = kept._source_stamp, _DIGEST
    return compiled


@jit
def _qmul(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@jit
def _mul(a, b, out, t):  # type: ignore[no-untyped-def]
    """Product of dual quaternions into `out`; `t` is scratch for four numbers."""
    _qmul(a[:4], b[:4], out[:4])
    _qmul(a[:4], b[4:], out[4:])
    _qmul(a[4:], b[:4], t)
    for k in range(4):
        out[4 + k] += t[k]


@jit
def _rotate(r, v, out):  # type: ignore[no-untyped-def]
    """Rotate: r v r* of a pure quaternion."""
    a = r[2] * v[2] - r[3] * v[1] + r[0] * v[0]
    b = r[3] * v[0] - r[1] * v[2] + r[0] * v[1]
    c = r[1] * v[1] - r[2] * v[0] + r[0] * v[2]
    x = v[0] + 2.0 * (r[2] * c - r[3] * b)
    y = v[1] + 2.0 * (r[3] * a - r[1] * c)
    z = v[2] + 2.0 * (r[1] * b - r[2] * a)
    out[0] = x
    out[1] = y
    out[2] = z


@jit
def _translation(x, out):  # type: ignore[no-untyped-def]
    """2 D(x) P(x)*."""
    out[0] = 2.0 * (-x[4] * x[1] + x[5] * x[0] - x[6] * x[3] + x[7] * x[2])
    out[1] = 2.0 * (-x[4] * x[2] + x[5] * x[3] + x[6] * x[0] - x[7] * x[1])
    out[2] = 2.0 * (-x[4] * x[3] - x[5] * x[2] + x[6] * x[1] + x[7] * x[0])


@jit
def snapshot(values, bodies, n):  # type: ignore[no-untyped-def]
    """Return poses (bodies, 8), joint lines (n, 6), the CoM (3,) and its Jacobian (3, n) as views of one buffer."""
    a, b = 8 * bodies, 8 * bodies + 6 * n
    poses, lines = values[:a].reshape((bodies, 8)), values[a:b].reshape((n, 6))
    return poses, lines, values[b : b + 3], values[b + 3 : b + 3 + 3 * n].reshape((3, n))


@jit
def forward(q, tree, links, values):  # type: ignore[no-untyped-def]
    """Fill poses, joint lines, the CoM (4) and its Jacobian (5) into the buffer that `snapshot` explains.

    Return whether all of q is finite.

    Bodies come parents first, body 0 at rest; the columns of `tree` are parent and joint, those of `links` origin
    (8), axis (3), mass divided by the total, and centre of mass (3). A joint's line l + eps m is that of its axis in
    the world; a joint turns all that lies after it about this line.
    """
    bodies = tree.shape[0]
    poses, lines, p_com, J_com = snapshot(values, bodies, q.shape[0])
    scratch = np.empty(26)
    t, half, x, p, c = scratch[:4], scratch[4:12], scratch[12:20], scratch[20:23], scratch[23:]
    for k in range(8):
        half[k] = poses[0, k] = 0.0
    poses[0, 0] = 1.0
    after = np.empty((bodies, 4))  # of the body and all after it: sum of mass times position, mass
    for b in range(bodies):
        link = links[b]
        if b > 0:
            axis = link[8:11]
            _mul(poses[tree[b, 0]], link[:8], x, t)
            angle = 0.5 * q[tree[b, 1]]
            s = math.sin(angle)
            half[0] = math.cos(angle)
            for k in range(3):
                half[1 + k] = s * axis[k]
            _mul(x, half, poses[b], t)
            row = lines[tree[b, 1]]
            _rotate(poses[b], axis, row[:3])
            _translation(poses[b], p)
            row[3] = p[1] * row[2] - p[2] * row[1]
            row[4] = p[2] * row[0] - p[0] * row[2]
            row[5] = p[0] * row[1] - p[1] * row[0]
        _translation(poses[b], p)
        _rotate(poses[b], link[12:15], c)
        after[b, 3] = link[11]
        for k in range(3):
            after[b, k] = link[11] * (p[k] + c[k])
    for b in range(bodies - 1, 0, -1):
        m, i = after[b], tree[b, 1]
        for k in range(4):
            after[tree[b, 0], k] += m[k]
        l = lines[i]  # noqa: E741
        J_com[0, i] = l[1] * m[2] - l[2] * m[1] + m[3] * l[3]
        J_com[1, i] = l[2] * m[0] - l[0] * m[2] + m[3] * l[4]
        J_com[2, i] = l[0] * m[1] - l[1] * m[0] + m[3] * l[5]
    for k in range(3):
        p_com[k] = after[0, k]
    good = True
    for i in range(q.shape[0]):
        good = good and math.isfinite(q[i])
    return good


@jit
def compose(a, b):  # type: ignore[no-untyped-def]
    """Return the product of two dual quaternions (8,)."""
    out = np.empty(8)
    _mul(a, b, out, np.empty(4))
    return out


@jit
def point(x, offset):  # type: ignore[no-untyped-def]
    """Return the point (3,) at `offset` in the frame `x` (8,)."""
    p = np.empty(3)
    c = np.empty(3)
    _translation(x, p)
    _rotate(x, offset, c)
    for k in range(3):
        p[k] += c[k]
    return p


@jit
def point_jacobian(lines, moves, p):  # type: ignore[no-untyped-def]
    """Return l x p + m of the joints that move the point, shape (3, n)."""
    n = lines.shape[0]
    J = np.zeros((3, n))
    for i in range(n):
        if moves[i]:
            l = lines[i]  # noqa: E741
            J[0, i] = l[1] * p[2] - l[2] * p[1] + l[3]
            J[1, i] = l[2] * p[0] - l[0] * p[2] + l[4]
            J[2, i] = l[0] * p[1] - l[1] * p[0] + l[5]
    return J


@jit
def line_jacobian(lines, moves, v):  # type: ignore[no-untyped-def]
    """Return l x v of the joints that turn the direction `v` (3,), shape (3, n)."""
    n = lines.shape[0]
    J = np.zeros((3, n))
    for i in range(n):
        if moves[i]:
            l = lines[i]  # noqa: E741
            J[0, i] = l[1] * v[2] - l[2] * v[1]
            J[1, i] = l[2] * v[0] - l[0] * v[2]
            J[2, i] = l[0] * v[1] - l[1] * v[0]
    return J


@jit
def pose_jacobian(lines, moves, x):  # type: ignore[no-untyped-def]
    """Return 1/2 vec8(line x) of the joints that move the frame `x` (8,), shape (8, n)."""
    n = lines.shape[0]
    J = np.zeros((8, n))
    line = np.zeros(8)
    out = np.empty(8)
    t = np.empty(4)
    for i in range(n):
        if moves[i]:
            for k in range(3):
                line[1 + k] = 0.5 * lines[i, k]
                line[5 + k] = 0.5 * lines[i, 3 + k]
            _mul(line, x, out, t)
            for k in range(8):
                J[k, i] = out[k]
    return J


# ---------------------------------------------------------------------- joint velocities


@jit
def clip(u, limit, out):  # type: ignore[no-untyped-def]
    """Write joint velocities (n,) within -limit .. limit to `out`; return whether all of `u` is finite.

    What is not finite becomes nan: no limit makes a velocity of it.
    """
    good = True
    for i in range(u.shape[0]):
        known = math.isfinite(u[i])
        out[i] = min(max(u[i], -limit[i]), limit[i]) if known else math.nan
        good = good and known
    return good


@jit
def integrate(q, u, limit, dt, q_out, u_out):  # type: ignore[no-untyped-def]
    """Write joint angles (n,) a period `dt` later by Euler's method, and velocities as `clip`; return as it does."""
    good = clip(u, limit, u_out)
    for i in range(u.shape[0]):
        q_out[i] = q[i] + dt * u_out[i]
    return good
