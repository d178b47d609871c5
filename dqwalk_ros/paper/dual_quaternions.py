"""Quaternions and dual quaternions, section 2.1 [Adorno2017].

A dual quaternion is an array of eight reals, ``h1 + h2 i + h3 j + h4 k + eps (h1' + h2' i + h3' j + h4' k)``,
and a `DQ` contains any number of them, shape ``(..., 8)``. A quaternion is a dual quaternion whose dual part is zero.
"""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.support.arrays import Array

_CONJ4 = np.array([1.0, -1.0, -1.0, -1.0])
_CONJ8 = np.concatenate([_CONJ4, _CONJ4])
_SMALL = 1e-12


def product(
    a1: float, a2: float, a3: float, a4: float, b1: float, b2: float, b3: float, b4: float
) -> tuple[float, float, float, float]:
    """Hamilton product of the quaternions (a1, a2, a3, a4) and (b1, b2, b3, b4), real part first.

    All products of quaternions and dual quaternions follow from it: those of arrays here, and those of `kinematics`,
    which compiles it (jit).
    """
    return (
        a1 * b1 - a2 * b2 - a3 * b3 - a4 * b4,
        a1 * b2 + a2 * b1 + a3 * b4 - a4 * b3,
        a1 * b3 - a2 * b4 + a3 * b1 + a4 * b2,
        a1 * b4 + a2 * b3 - a3 * b2 + a4 * b1,
    )


_T = np.array([[product(*a, *b) for b in np.eye(4).tolist()] for a in np.eye(4).tolist()])
"""Structure constants: the product of the units i and j is sum_k T[i, j, k] of the unit k."""
_PRODUCT = _T.reshape(16, 4)
_LEFT, _RIGHT = _T.transpose(0, 2, 1).reshape(4, 16), _T.transpose(1, 2, 0).reshape(4, 16)
_T8 = np.zeros((8, 8, 8))  # with eps^2 = 0
_T8[:4, :4, :4] = _T8[:4, 4:, 4:] = _T8[4:, :4, 4:] = _T
_DUAL_PRODUCT = _T8.reshape(64, 8)


def _bilinear(a: Array, b: Array, constants: Array) -> Array:
    """Return the product of elements (..., m) of an algebra with the structure constants (m m, m)."""
    pairs = a[..., :, None] * b[..., None, :]
    out: Array = pairs.reshape(*pairs.shape[:-2], len(constants)) @ constants
    return out


def qmul(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions, shapes (..., 4), real part first."""
    return _bilinear(a, b, _PRODUCT)


def qconj(a: Array) -> Array:
    """Conjugate of quaternions, shape (..., 4)."""
    conjugate: Array = a * _CONJ4
    return conjugate


class DQ:
    """Dual quaternions over an array of shape (..., 8).

    Parameters
    ----------
    value : array_like, shape (..., 8), (..., 4), (..., 3) or scalar
        Coefficients on the last axis: eight of a dual quaternion, four of a quaternion, three of a pure quaternion
        (imaginary part), or one real number. Missing coefficients are zero.

    Raises
    ------
    ValueError
        If the last axis has a different length.
    """

    __slots__ = ("_h",)
    __array_priority__ = 100.0

    def __init__(self, value: ArrayLike) -> None:
        h = np.asarray(value, dtype=np.float64)
        if h.ndim == 0:
            h = h[None]
        size = h.shape[-1]
        if size not in (1, 3, 4, 8):
            raise ValueError(f"a dual quaternion has 1, 3, 4 or 8 coefficients, not {size}")
        if size != 8:
            full = np.zeros((*h.shape[:-1], 8))
            start = 1 if size == 3 else 0
            full[..., start : start + size] = h
            h = full
        self._h = h

    # ------------------------------------------------------------------ construction

    @classmethod
    def rotation_about(cls, angle: ArrayLike, axis: ArrayLike) -> Self:
        """Return cos(angle/2) + axis sin(angle/2); `angle` [rad] (...), `axis` unit vector (..., 3)."""
        half = 0.5 * np.asarray(angle, dtype=np.float64)[..., None]
        n = np.asarray(axis, dtype=np.float64)
        r = np.empty((*np.broadcast_shapes(half.shape[:-1], n.shape[:-1]), 4))
        r[..., :1] = np.cos(half)
        r[..., 1:] = np.sin(half) * n
        return cls(r)

    @classmethod
    def from_pose(cls, p: ArrayLike, r: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Self:
        """Return the pose r + eps 1/2 p r of (U1); `p` [m] (..., 3), `r` unit quaternion (..., 4)."""
        d = 0.5 * qmul(DQ(p).vec4(), np.asarray(r, dtype=np.float64))
        x = np.empty((*d.shape[:-1], 8))
        x[..., :4], x[..., 4:] = r, d
        return cls(x)

    @classmethod
    def from_matrix(cls, rotation: ArrayLike, p: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Return the pose of a rotation matrix (3, 3) and a translation (3,) [m]."""
        m = np.asarray(rotation, dtype=np.float64)
        # row i is 4 r_i (r1, r2, r3, r4); normalizing the row of the largest r_i is accurate for every rotation
        w1, w2, w3 = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
        s12, s13, s23 = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
        d1, d2, d3 = np.diag(m)
        rows = np.array(
            [
                [1.0 + d1 + d2 + d3, w1, w2, w3],
                [w1, 1.0 + d1 - d2 - d3, s12, s13],
                [w2, s12, 1.0 - d1 + d2 - d3, s23],
                [w3, s13, s23, 1.0 - d1 - d2 + d3],
            ]
        )
        r = rows[int(np.argmax(np.diag(rows)))]
        r = r / np.linalg.norm(r)
        return cls.from_pose(p, r if r[0] >= 0.0 else -r)

    @classmethod
    def from_roll_pitch_yaw(cls, rpy: ArrayLike, p: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Return the pose of roll, pitch and yaw about the fixed axes x, y and z (3,) [rad], and p (3,) [m]."""
        x, y, z = cls.rotation_about(rpy, np.eye(3)).vec4()
        r = qmul(z, qmul(y, x))
        return cls.from_pose(p, r if r[0] >= 0.0 else -r)

    @classmethod
    def facing(cls, z: Array, p: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Return the pose at p (3,) [m] whose z axis is the unit vector z (3,), turned there by the least angle."""
        r = np.array([1.0 + z[2], -z[1], z[0], 0.0])
        norm = float(np.linalg.norm(r))
        return cls.from_pose(p, r / norm if norm > 1e-9 else (0.0, 1.0, 0.0, 0.0))

    # ------------------------------------------------------------------ parts

    def vec8(self) -> Array:
        """Return vec8 h, shape (..., 8)."""
        return self._h

    def vec4(self) -> Array:
        """Return vec4 of the primary part, shape (..., 4)."""
        return self._h[..., :4]

    def vec3(self) -> Array:
        """Return vec3, the imaginary part of the primary part, shape (..., 3)."""
        return self._h[..., 1:4]

    def P(self) -> Self:
        """Primary part."""
        return type(self)(self._h[..., :4])

    def D(self) -> Self:
        """Dual part."""
        return type(self)(self._h[..., 4:])

    def Re(self) -> Self:
        """Real part h1 + eps h1'."""
        h = np.zeros_like(self._h)
        h[..., ::4] = self._h[..., ::4]
        return type(self)(h)

    def Im(self) -> Self:
        """Imaginary part."""
        h = self._h.copy()
        h[..., ::4] = 0.0
        return type(self)(h)

    def conj(self) -> Self:
        """Conjugate Re(h) - Im(h)."""
        return type(self)(self._h * _CONJ8)

    def norm(self) -> Self:
        """Norm, the dual number whose square is h h*; its dual part is valid only for a non-zero primary part."""
        square = (self * self.conj())._h
        primary = np.sqrt(square[..., 0])
        h = np.zeros_like(self._h)
        h[..., 0] = primary
        h[..., 4] = 0.5 * square[..., 4] / np.where(primary > 0.0, primary, 1.0)
        return type(self)(h)

    def inv(self) -> Self:
        """Inverse h* (h h*)^-1.

        Raises
        ------
        ZeroDivisionError
            If a primary part is zero.
        """
        square = (self * self.conj())._h
        a, b = square[..., :1], square[..., 4:5]
        if np.any(a == 0.0):
            raise ZeroDivisionError("a dual quaternion whose primary part is zero has no inverse")
        h = np.zeros_like(self._h)
        h[..., :1] = 1.0 / a
        h[..., 4:5] = -b / a**2
        return self.conj() * type(self)(h)

    def normalized(self) -> Self:
        """Return the unit dual quaternion h |h|^-1."""
        return self * self.norm().inv()

    # ------------------------------------------------------------------ algebra

    def __add__(self, other: DQ | float) -> Self:
        return type(self)(self._h + _as_dq(other)._h)

    __radd__ = __add__

    def __sub__(self, other: DQ | float) -> Self:
        return type(self)(self._h - _as_dq(other)._h)

    def __rsub__(self, other: DQ | float) -> Self:
        return type(self)(_as_dq(other)._h - self._h)

    def __neg__(self) -> Self:
        return type(self)(-self._h)

    def __mul__(self, other: DQ | float) -> Self:
        if not isinstance(other, DQ):
            return type(self)(self._h * other)
        return type(self)(_bilinear(self._h, other._h, _DUAL_PRODUCT))

    def __rmul__(self, other: float) -> Self:
        return type(self)(other * self._h)

    def __repr__(self) -> str:
        return f"DQ({np.array2string(self._h, precision=6, suppress_small=True)})"

    def haminus8(self) -> Array:
        """H-8 with vec8(ab) = haminus8(b) vec8(a), the operator of (U3); shape (..., 8, 8)."""
        return _blocks(_right(self._h[..., :4]), _right(self._h[..., 4:]))

    # ------------------------------------------------------------------ rigid motions (unit norm)

    def translation(self) -> Array:
        """Position p = 2 D(x) P(x)* of the pose (U1), shape (..., 3) [m]."""
        return 2.0 * qmul(self._h[..., 4:], qconj(self._h[..., :4]))[..., 1:]

    def rotation(self) -> Array:
        """Orientation r = P(x) of the pose (U1), a unit quaternion, shape (..., 4)."""
        return self._h[..., :4]

    def rotation_matrix(self) -> Array:
        """Rotation matrix of the orientation, shape (..., 3, 3)."""
        r = self._h[..., :4]
        both = _left(r) @ _right(qconj(r))
        return both[..., 1:, 1:]

    def roll_pitch_yaw(self) -> Array:
        """Angles of the orientation of one pose about the fixed axes x, y and z, shape (3,) [rad]."""
        R = self.rotation_matrix()
        cos_pitch = math.hypot(R[0, 0], R[1, 0])
        regular = cos_pitch > 1e-9  # otherwise the axes of roll and yaw coincide
        roll = math.atan2(R[2, 1], R[2, 2]) if regular else math.atan2(-R[1, 2], R[1, 1])
        return np.array([roll, math.atan2(-R[2, 0], cos_pitch), math.atan2(R[1, 0], R[0, 0]) if regular else 0.0])

    def Ad(self, other: DQ) -> Self:
        """Return x h x*: the quaternion, direction or line `other` given in the frame x, in the parent frame."""
        return self * type(self)(other._h) * self.conj()

    def transform_point(self, p: ArrayLike) -> Array:
        """Return p + r c r*: the point c given in the frame x, in the parent frame, shape (..., 3) [m]."""
        r = self.rotation()
        return self.translation() + qmul(qmul(r, DQ(p).vec4()), qconj(r))[..., 1:]

    def log(self) -> Self:
        """Logarithm (phi n + eps p)/2 of a unit dual quaternion, a pure dual quaternion.

        The angle phi is in [0, 2 pi]; x and -x, the same pose, have different angles. The axis n of phi = 2 pi is not
        unique and set to i.
        """
        h = np.zeros_like(self._h)
        h[..., 1:4], h[..., 5:] = _half_turn(self._h[..., :4]), 0.5 * self.translation()
        return type(self)(h)

    def rotation_vector(self) -> Array:
        """Rotation vector phi n [rad] of the orientation with phi in [0, pi], the same for x and -x; shape (..., 3)."""
        r = self._h[..., :4]
        return 2.0 * _half_turn(np.where(r[..., :1] < 0.0, -r, r))

    def exp(self) -> Self:
        """Exponential of a pure dual quaternion, the inverse of `log`."""
        g = self._h[..., 1:4]
        half = np.linalg.norm(g, axis=-1, keepdims=True)
        # np.sinc(x / pi) is sin(x)/x, also at zero
        r = np.concatenate([np.cos(half), np.sinc(half / np.pi) * g], axis=-1)
        return type(self).from_pose(2.0 * self._h[..., 5:], r)


def _as_dq(value: DQ | float) -> DQ:
    return value if isinstance(value, DQ) else DQ(value)


def _half_turn(r: Array) -> Array:
    """Return half of the rotation vectors, phi n / 2, of unit quaternions (..., 4); shape (..., 3) [rad]; see `log`."""
    sin = np.linalg.norm(r[..., 1:], axis=-1, keepdims=True)
    half = np.arctan2(sin, r[..., :1])
    turn: Array = np.where(sin > _SMALL, half / np.where(sin > _SMALL, sin, 1.0), 1.0) * r[..., 1:]
    turn[..., :1] += np.where((sin <= _SMALL) & (r[..., :1] < 0.0), half, 0.0)
    return turn


def _left(a: Array) -> Array:
    """Return the matrices H+4 of the quaternions a (..., 4), shape (..., 4, 4): vec4(ab) = H+4(a) vec4(b)."""
    matrix: Array = (a @ _LEFT).reshape(*a.shape[:-1], 4, 4)
    return matrix


def _right(a: Array) -> Array:
    """Return the matrices H-4 of the quaternions a (..., 4), shape (..., 4, 4): vec4(ba) = H-4(a) vec4(b)."""
    matrix: Array = (a @ _RIGHT).reshape(*a.shape[:-1], 4, 4)
    return matrix


def _blocks(primary: Array, dual: Array) -> Array:
    """Return the matrices [[primary, 0], [dual, primary]], shape (..., 8, 8)."""
    top = np.concatenate([primary, np.zeros_like(primary)], axis=-1)
    return np.concatenate([top, np.concatenate([dual, primary], axis=-1)], axis=-2)


i = DQ([0.0, 1.0, 0.0, 0.0])
j = DQ([0.0, 0.0, 1.0, 0.0])
k = DQ([0.0, 0.0, 0.0, 1.0])
E = DQ([0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
