"""The paths of a walk that stands, compiled: the CoM from foot to foot, a sole over a via point.

What they are is said by `tasks.ComPath` and `tasks.SwingPath`, and by `kinematics.pose_difference`.
"""

from __future__ import annotations

import math

from dqwalk_ros.kernels import _qmul, _translation, jit

__all__ = ["com_path", "difference", "difference_row", "minimum_jerk", "on_ground", "swing_path"]


@jit
def minimum_jerk(s):  # type: ignore[no-untyped-def]
    """Return the place 0..1 and the slope at the fraction `s` of the time."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * (s * (1.0 - s)) ** 2


@jit
def on_ground(com, up, k):  # type: ignore[no-untyped-def]
    """Return coordinate `k` of where the vertical through the CoM meets the plane of the base sole."""
    return com[k] - com[2] * (up[k] / up[2])


@jit
def com_path(com, up, elapsed, goal, start, duration, eta, saturation, e, wanted):  # type: ignore[no-untyped-def]
    """Fill the error (2,) of the CoM from its path to `goal` (2,), and the e' asked for."""
    place, slope = minimum_jerk(elapsed / duration)
    for k in range(2):
        e[k] = on_ground(com, up, k) - (start[k] + place * (goal[k] - start[k]))
    size = math.sqrt(e[0] * e[0] + e[1] * e[1])
    cap = 1.0 if size <= saturation else saturation / size
    for k in range(2):
        wanted[k] = slope / duration * (goal[k] - start[k]) - eta * (e[k] * cap)


@jit
def difference(x, p_d, r_d, e, r):  # type: ignore[no-untyped-def]
    """Fill p - p_d and 2 Im(r r_d*) of a pose (8,), and the quaternion r r_d* itself; r_d* is given conjugate."""
    _translation(x, e[:3])
    _qmul(x[:4], r_d, r)
    if r[0] < 0.0:
        for k in range(4):
            r[k] = -r[k]
    for k in range(3):
        e[k] -= p_d[k]
        e[3 + k] = 2.0 * r[1 + k]


@jit
def difference_row(line, p, r, lever, J, i):  # type: ignore[no-untyped-def]
    """Fill column `i` of the Jacobian of `difference`: what the joint on a line does to a frame at `p`."""
    l0, l1, l2 = line[0], line[1], line[2]
    J[0, i] = l1 * p[2] - l2 * p[1] + line[3]
    J[1, i] = l2 * p[0] - l0 * p[2] + line[4]
    J[2, i] = l0 * p[1] - l1 * p[0] + line[5]
    # r' = 1/2 w r, so (2 Im r)' = r_0 w - v x w
    J[3, i] = lever * (r[0] * l0 - (r[2] * l2 - r[3] * l1))
    J[4, i] = lever * (r[0] * l1 - (r[3] * l0 - r[1] * l2))
    J[5, i] = lever * (r[0] * l2 - (r[1] * l1 - r[2] * l0))


@jit
def swing_path(elapsed, data, p, r, velocity):  # type: ignore[no-untyped-def]
    """Fill position (3,), conjugate rotation (4,) and velocity (6,) of a sole on its path.

    `data` is start (3), way (3), rotation at the start (4), half the turn (3), height, duration.
    """
    height, duration = data[13], data[14]
    s = min(max(elapsed / duration, 0.0), 1.0)
    place, slope = minimum_jerk((s - 0.1) / 0.8)
    rate = slope / 0.8
    bump, rise = 64.0 * (s * (1.0 - s)) ** 3, 192.0 * (s * (1.0 - s)) ** 2 * (1.0 - 2.0 * s)
    for k in range(3):
        p[k] = data[k] + place * data[3 + k]
        velocity[k] = data[3 + k] * rate / duration
        velocity[3 + k] = 2.0 * data[10 + k] * rate / duration
    p[2] += bump * height
    velocity[2] += rise * height / duration
    half = data[10:13]
    angle = math.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
    sine = math.sin(place * angle) / angle if angle > 1e-12 else place
    a, b, c, d = math.cos(place * angle), sine * half[0], sine * half[1], sine * half[2]
    w, x, y, z = data[6], data[7], data[8], data[9]
    r[0] = a * w - b * x - c * y - d * z
    r[1] = -(a * x + b * w + c * z - d * y)
    r[2] = -(a * y - b * z + c * w + d * x)
    r[3] = -(a * z + b * y - c * x + d * w)
