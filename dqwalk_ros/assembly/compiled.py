"""The compiled half of the assembly: one pass over the table of a phase.

Every joint is a line l + eps m. A distance whose gradient at the point p is g feels the joint's turn by the
reciprocal product of that line with the wrench (g, p x g) of a force g at p, so a row of (6) is

    J_i = l_i . (p x g) + m_i . g        for the joints i that move the point,

whatever the distance is. The tables are made, and their columns explained, in `dqwalk_ros.assembly`.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.assembly.independent import independent
from dqwalk_ros.kernels import _mul, _rotate, _translation, jit, snapshot
from dqwalk_ros.qp.packed import split
from dqwalk_ros.standing.paths import com_path, difference, difference_row, on_ground, swing_path

__all__ = [
    "AXIS",
    "COM_OVER_FOOT",
    "COM_PATH",
    "CYLINDER",
    "EDGE",
    "FRAME_HELD",
    "FRAME_POSE",
    "PLANE",
    "POSTURE",
    "SWING_PATH",
    "WALL",
    "evaluate",
    "first_error",
]

PLANE, CYLINDER, WALL, AXIS, EDGE, FRAME_HELD = 0, 1, 2, 3, 4, 5
COM_OVER_FOOT, FRAME_POSE, POSTURE, COM_PATH, SWING_PATH = 0, 1, 2, 3, 4


@jit
def _place(poses, com, body, offset, p, t):  # type: ignore[no-untyped-def]
    """Put the point at `offset` of a body, or the CoM where `body` is -1, into `p`; `t` is scratch."""
    if body < 0:
        for k in range(3):
            p[k] = com[k]
        return
    _translation(poses[body], p)
    _rotate(poses[body], offset, t)
    for k in range(3):
        p[k] += t[k]


@jit
def _pull(row, factor, g, p, body, lines, J_com, moves):  # type: ignore[no-untyped-def]
    """Add `factor` times the gradient `g` at the point `p` of a body, seen by the joints, to `row`."""
    n = lines.shape[0]
    g0, g1, g2 = factor * g[0], factor * g[1], factor * g[2]
    if body < 0:
        for i in range(n):
            row[i] += g0 * J_com[0, i] + g1 * J_com[1, i] + g2 * J_com[2, i]
        return
    m0 = p[1] * g2 - p[2] * g1
    m1 = p[2] * g0 - p[0] * g2
    m2 = p[0] * g1 - p[1] * g0
    for i in range(n):
        if moves[body, i]:
            l = lines[i]  # noqa: E741
            row[i] += l[0] * m0 + l[1] * m1 + l[2] * m2 + l[3] * g0 + l[4] * g1 + l[5] * g2


@jit
def _right(d, data, fastest):  # type: ignore[no-untyped-def]
    """Return the right-hand side for a distance: -eta (d - bound), within the largest and the least."""
    return max(min(-min(data[0], fastest) * (d - data[1]), data[2]), data[3])


@jit
def _rows(poses, lines, com, J_com, up, moves, index, data, fastest, W, w):  # type: ignore[no-untyped-def]
    """Fill the rows W u >= w (or = w) that the table knows.

    Columns of `data`: eta, bound, largest and least right-hand side, then what the kind asks for; of `index`: kind,
    body, second body, the first row, and 1 where several rows are to be made independent.
    """
    n = lines.shape[0]
    scratch = np.empty(30)
    p, b, g, t = scratch[:3], scratch[3:6], scratch[6:9], scratch[9:12]
    e, x, r = scratch[12:18], scratch[18:26], scratch[26:]
    for k in range(index.shape[0]):
        kind, body, other, at = index[k, 0], index[k, 1], index[k, 2], index[k, 3]
        a = data[k, 10:17]
        row = W[at]
        for i in range(n):
            row[i] = 0.0
        if kind == FRAME_HELD:  # the frame on its body, and the pose it is held at with its rotation conjugate
            _mul(poses[body], data[k, 4:12], x, r)
            difference(x, data[k, 12:15], data[k, 15:19], e, r)
            _translation(x, p)
            held = W[at : at + 6]
            for i in range(n):
                if moves[body, i]:
                    difference_row(lines[i], p, r, 1.0, held, i)
                else:
                    for j in range(6):
                        held[j, i] = 0.0
            for j in range(6):
                w[at + j] = _right(e[j], data[k], fastest)
            if index[k, 4] == 1:
                independent(held, w[at : at + 6])
            continue
        if kind == EDGE:  # a = n, d
            d = a[0] * on_ground(com, up, 0) + a[1] * on_ground(com, up, 1) - a[2]
            lean = (a[0] * up[0] + a[1] * up[1]) / up[2]
            for i in range(n):
                row[i] = a[0] * J_com[0, i] + a[1] * J_com[1, i] - lean * J_com[2, i]
        elif kind == AXIS:
            # the direction R z turns about every joint as a point would, without moving
            _rotate(poses[body], data[k, 4:7], p)
            d = a[0] * p[0] + a[1] * p[1] + a[2] * p[2]
            m0, m1, m2 = p[1] * a[2] - p[2] * a[1], p[2] * a[0] - p[0] * a[2], p[0] * a[1] - p[1] * a[0]
            for i in range(n):
                if moves[body, i]:
                    row[i] = lines[i, 0] * m0 + lines[i, 1] * m1 + lines[i, 2] * m2
        else:
            _place(poses, com, body, data[k, 4:7], p, t)
            if kind == PLANE:  # a = n, d
                d = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] - a[3]
                _pull(row, 1.0, a, p, body, lines, J_com, moves)
            elif kind == CYLINDER:  # a = l, m, r^2
                t[0] = p[1] * a[2] - p[2] * a[1] - a[3]
                t[1] = p[2] * a[0] - p[0] * a[2] - a[4]
                t[2] = p[0] * a[1] - p[1] * a[0] - a[5]
                d = a[6] - (t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
                g[0] = a[1] * t[2] - a[2] * t[1]
                g[1] = a[2] * t[0] - a[0] * t[2]
                g[2] = a[0] * t[1] - a[1] * t[0]
                _pull(row, -2.0, g, p, body, lines, J_com, moves)
            else:  # WALL: a = the fixed place, side; the moving place is data[7:10] of `other`
                _place(poses, com, other, data[k, 7:10], b, t)
                x0, y0 = b[0] - a[0], b[1] - a[1]
                square = x0 * x0 + y0 * y0
                length = math.sqrt(square)
                g[0], g[1], g[2] = -a[3] * y0 / length, a[3] * x0 / length, 0.0
                d = g[0] * (p[0] - a[0]) + g[1] * (p[1] - a[1])
                along = (x0 * (p[0] - a[0]) + y0 * (p[1] - a[1])) / square
                _pull(row, 1.0, g, p, body, lines, J_com, moves)
                _pull(row, -along, g, b, other, lines, J_com, moves)
        w[at] = _right(d, data[k], fastest)


@jit
def _com_path(poses, com, up, elapsed, body, other, data, eta, e, wanted):  # type: ignore[no-untyped-def]
    """Fill error and e' of a CoM path; the goal is the mean of a point on each of two bodies."""
    p, b, t, goal = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    _place(poses, com, body, data[1:4], p, t)
    _place(poses, com, other, data[4:7], b, t)
    for k in range(2):
        goal[k] = 0.5 * (p[k] + b[k])
    com_path(com, up, elapsed, goal, data[7:9], data[9], eta, data[10], e, wanted)


@jit
def _swing_path(poses, elapsed, body, data, x, r, e, wanted):  # type: ignore[no-untyped-def]
    """Fill pose, rotation r r_d*, error and e' of a swing path, without the weight of angles."""
    p_d, r_d, s = np.empty(3), np.empty(4), np.empty(4)
    swing_path(elapsed, data[9:24], p_d, r_d, wanted)
    _mul(poses[body], data[1:9], x, s)
    difference(x, p_d, r_d, e, r)
    for j in range(6):
        wanted[j] -= data[24] * e[j]


@jit
def first_error(bodies, n, seen, up, elapsed, index, data):  # type: ignore[no-untyped-def]
    """Return the norm of the error of the first task in the table; `seen` is the buffer of `kernels.forward`."""
    poses, _, com, _ = snapshot(seen, bodies, n)
    scratch = np.empty(24)
    e, wanted, x, r = scratch[:6], scratch[6:12], scratch[12:20], scratch[20:]
    kind, body, other = index[0, 0], index[0, 1], index[0, 2]
    if kind == COM_OVER_FOOT:
        _place(poses, com, body, data[0, 1:4], e, wanted)
        return math.hypot(com[0] - e[0], com[1] - e[1])
    if kind == FRAME_POSE:
        _mul(poses[body], data[0, 1:9], x, r)
        target = data[0, 9:17]
        near = x[0] * target[0] + x[1] * target[1] + x[2] * target[2] + x[3] * target[3]
        square = 0.0
        for i in range(8):
            square += ((x[i] if near >= 0.0 else -x[i]) - target[i]) ** 2
        return math.sqrt(square)
    if kind == COM_PATH:
        _com_path(poses, com, up, elapsed, body, other, data[0], 0.0, e, wanted)
        return math.sqrt(e[0] * e[0] + e[1] * e[1])
    _swing_path(poses, elapsed, body, data[0], x, r, e, wanted)
    lever = data[0, 25]
    total = 0.0
    for j in range(3):
        total += e[j] * e[j] + (lever * e[3 + j]) ** 2
    return math.sqrt(total)


@jit
def _tasks(q, poses, lines, com, J_com, up, elapsed, moves, index, data, eta, diagonal, c, J, e):  # type: ignore[no-untyped-def]
    """Fill J (r, n) and e (r,) of the tasks in the table, each times the root of its weight; posture is diagonal.

    It is -e that is asked for, eta times the error unless the task is a path.
    """
    n = lines.shape[0]
    scratch = np.empty(49)
    p, g, t = scratch[:3], scratch[3:6], scratch[6:9]
    x, h, line, s = scratch[9:17], scratch[17:25], scratch[25:33], scratch[33:37]
    six, wanted = scratch[37:43], scratch[43:]
    at = 0
    for k in range(index.shape[0]):
        kind, body, weight = index[k, 0], index[k, 1], data[k, 0]
        root = math.sqrt(weight)
        if kind == POSTURE:
            for i in range(n):
                diagonal[i] += weight
                c[i] += weight * eta * (q[i] - data[k, 1 + i])
        elif kind == COM_OVER_FOOT:
            _place(poses, com, body, data[k, 1:4], p, t)
            for j in range(2):
                for i in range(3):
                    g[i] = 1.0 if i == j else 0.0
                for i in range(n):
                    J[at + j, i] = root * J_com[j, i]
                _pull(J[at + j], -root, g, p, body, lines, J_com, moves)
                e[at + j] = eta * (root * (com[j] - p[j]))
            at += 2
        elif kind == COM_PATH:
            _com_path(poses, com, up, elapsed, body, index[k, 2], data[k], eta, six, wanted)
            for j in range(2):
                lean = up[j] / up[2]
                for i in range(n):
                    J[at + j, i] = root * (J_com[j, i] - lean * J_com[2, i])
                e[at + j] = -root * wanted[j]
            at += 2
        elif kind == SWING_PATH:
            _swing_path(poses, elapsed, body, data[k], x, s, six, wanted)
            _translation(x, p)
            lever = data[k, 25]
            part = J[at : at + 6]
            for i in range(n):
                if moves[body, i]:
                    difference_row(lines[i], p, s, lever, part, i)
                    for j in range(6):
                        part[j, i] *= root
                else:
                    for j in range(6):
                        part[j, i] = 0.0
            for j in range(6):
                e[at + j] = -root * (wanted[j] if j < 3 else lever * wanted[j])
            at += 6
        else:  # FRAME_POSE
            _mul(poses[body], data[k, 1:9], x, s)
            target = data[k, 9:17]
            near = x[0] * target[0] + x[1] * target[1] + x[2] * target[2] + x[3] * target[3]
            if near < 0.0:
                root = -root
            line[0] = line[4] = 0.0
            for i in range(8):
                e[at + i] = eta * (root * x[i] - abs(root) * target[i])
            for i in range(n):
                if moves[body, i]:
                    for j in range(3):
                        line[1 + j] = 0.5 * root * lines[i, j]
                        line[5 + j] = 0.5 * root * lines[i, 3 + j]
                    _mul(line, x, h, s)
                    for j in range(8):
                        J[at + j, i] = h[j]
                else:
                    for j in range(8):
                        J[at + j, i] = 0.0
            at += 8


@jit
def evaluate(  # type: ignore[no-untyped-def]
    q, seen, up, elapsed, moves, rows, row_data, tasks, task_data, limits, velocity, eta, damping, fastest,
    n, l, m, r, out,  # noqa: E741
):  # fmt: skip
    """Fill the quadratic program (6) into a buffer that `qp.packed` explains.

    `seen` is the buffer of `kernels.forward`, `fastest` is 1/dt; `limits` (2, n + 3) are the joint limits, eta, bound
    and recovery of (12) and (13), and `velocity` (n,) is what their rows are kept within.
    """
    poses, lines, com, J_com = snapshot(seen, moves.shape[0], n)
    H, c, lower, upper, diagonal, W, w, J = split(out, n, l, m, r)
    e = np.empty(r)
    for i in range(n):
        diagonal[i] = damping * damping
        c[i] = 0.0
        high = min(limits[0, n], fastest) * (limits[0, i] - q[i] - limits[0, n + 1])
        low = -min(limits[1, n], fastest) * (q[i] - limits[1, i] - limits[1, n + 1])
        v = velocity[i]
        upper[i] = max(min(max(high, -limits[0, n + 2]), v), -v)
        lower[i] = max(min(min(low, limits[1, n + 2]), v), -v)
    _tasks(q, poses, lines, com, J_com, up, elapsed, moves, tasks, task_data, eta, diagonal, c, J, e)
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(r):
                total += J[k, i] * J[k, j]
            H[i, j] = H[j, i] = total
        H[i, i] += diagonal[i]
        for k in range(r):
            c[i] += e[k] * J[k, i]
    _rows(poses, lines, com, J_com, up, moves, rows, row_data, fastest, W, w)
