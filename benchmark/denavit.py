"""Denavit-Hartenberg parameters of a serial chain, in the form of dqrobotics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmark.biped import Chain
from dqwalk_ros.paper.dual_quaternions import DQ

Array = np.ndarray


def parameters(chain: Chain) -> tuple[Array, Array, Callable[[int, Array, Array], Array]]:
    """Return the base pose (8,), the table (5, n) of theta, d, a, alpha, type, and a change of frame.

    The change of frame takes a body and a place on it, rotation and translation, to the pose (8,) in the frame that the
    parameters give that body.
    """
    bodies, x = [], DQ(1.0)
    for R, p in zip(chain.fixed_R, chain.fixed_p, strict=True):
        x = x * DQ.from_matrix(R, p)
        bodies.append(x)
    axes = [(b.rotation_matrix() @ a, b.translation()) for b, a in zip(bodies, chain.axis, strict=True)]
    z, o = axes[0]
    any_x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    frames, rows = [(any_x / np.linalg.norm(any_x), z, o)], []
    for z2, o2 in axes[1:]:
        x_axis, z, o = frames[-1]
        normal, way = np.cross(z, z2), o2 - o
        if np.linalg.norm(normal) > 1e-9:  # from the foot of the common normal
            x2 = normal / np.linalg.norm(normal)
            d, a, s = np.linalg.solve(np.stack([z, x2, -z2], axis=1), way)
            o2 = o2 + s * z2
        else:
            d = float(z @ way)
            across = way - d * z
            a = float(np.linalg.norm(across))
            x2 = across / a if a > 1e-9 else x_axis
        theta = np.arctan2(np.cross(x_axis, x2) @ z, x_axis @ x2)
        rows.append((theta, d, a, np.arctan2(np.cross(z, z2) @ x2, z @ z2), 0.0))
        frames.append((x2, z2, o2))
    rows.append((0.0, 0.0, 0.0, 0.0, 0.0))
    frames.append(frames[-1])
    poses = [DQ.from_matrix(np.stack([x, np.cross(z, x), z], axis=1), o) for x, z, o in frames]

    def place(body: int, R: Array, p: Array) -> Array:
        return (poses[body + 1].conj() * bodies[body] * DQ.from_matrix(R, p)).vec8()

    return poses[0].vec8(), np.array(rows).T, place
