"""Estimation of the base of a walking robot from joint angles, inertial sensor and contacts, with covariance.

A contact-aided invariant extended Kalman filter [Hartley2020]: the state X in SE_N(3) consists of orientation R,
velocity v and position p of the inertial sensor in the world, and of the positions d of heel and toe of each sole; in
addition the biases of gyroscope and accelerometer are estimated. The error xi is right-invariant,
X_estimated = exp(xi) X, so that the measurement equation of a sole at rest, R h(q) + p - d = 0, is linear in xi with
coefficients that do not depend on the state.

The floor is assumed to be level except for a few millimetres between footholds: the height of a landing sole is the
only measurement that distinguishes a tilt of the sensor from a bias of its accelerometer. A sole that lands elsewhere
is on a stair, as high as the estimate has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.estimation.load import share_of
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY, share
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

_GRAVITY = np.array([0.0, 0.0, -GRAVITY])
_POINTS = tuple((foot, side) for foot in Foot for side in (-0.5, 0.5))
"""Heel and toe of both soles, as offsets from the centre in lengths of the sole."""
_R, _V, _P, _GYRO, _ACCELEROMETER = slice(0, 3), slice(3, 6), slice(6, 9), slice(21, 24), slice(24, 27)
"""Indices in xi of the errors of R, v, p and of the biases; those of the contact points are 9 to 20."""
_SIZE = 27
"""Length of xi."""
_SLIP = 2.5, 0.017
"""Distance of a contact point from its former position above which it has slipped or lifted: in standard deviations of
the kinematics, or in lengths of the sole, whichever is more; soles that stand yield by up to 1.3 % of their length. It
does not count how well the base is known: a slip is not to turn a base that is known badly."""
_STAIR = 5.0
"""Height of a landing contact point above which it is on a stair, in standard deviations."""
_JOLT = np.array([0.015, 0.1])
"""Largest change of orientation [rad] and velocity [m/s] by the change between two measurements that is used.

Walks of Poppy cause less than a third of it. So a single wrong measurement, or an impact, moves the estimate by a few
millimetres, whatever the rate of the sensor."""
_LANDING = 0.1
"""Time from the touch of a foot in which both soles may pivot [s]: neither bears enough weight to hold the yaw."""
_ASTRAY = 3
"""Number of consecutive updates in which every standing sole seems to slip, from which on the estimate is wrong."""
_LEAST_LOAD = 0.1
"""Fraction of the weight below which a sole does not count as standing: it is about to lift, or has just landed."""


@dataclass(frozen=True)
class BaseEstimate:
    """Estimated pose and velocity of the pelvis; the world is the frame of the first base sole, with z vertical."""

    pose: Array
    """Pose of the pelvis in the world, shape (8,)."""
    velocity: Array
    angular_velocity: Array
    """Velocities of the pelvis in axes of the world, shape (3,) [m/s, rad/s]."""
    covariance: Array
    """Covariance of the errors of orientation (a rotation vector in axes of the world), velocity and position, shape
    (9, 9) [rad, m/s, m]."""
    contacts: frozenset[Foot]
    """Soles that stand without slipping."""

    def velocity_covariance(self, R: Array) -> Array:
        """Return the covariance (3, 3) of the velocity's error in axes of the robot with the orientation `R` (3, 3).

        An error of the orientation turns the velocity in axes of the world, but not in those of the robot.
        """
        to_robot = R.T @ np.hstack([_cross(self.velocity), np.eye(3)])
        out: Array = to_robot @ self.covariance[:6, :6] @ to_robot.T
        return out


class _Filter(NamedTuple):
    """State X of the filter, and what is known of its error; `_predict` and `_contact` change the arrays in place."""

    R: Array
    v: Array
    p: Array
    """Orientation (3, 3), velocity (3,) and position (3,) of the inertial sensor in the world [m/s, m]."""
    d: Array
    """Contact points in the world, shape (4, 3) [m]."""
    bias: Array
    """Biases of gyroscope and accelerometer, shape (6,) [rad/s, m/s^2]."""
    P: Array
    """Covariance of xi, shape (27, 27)."""


class BaseEstimator:
    """Estimates the base recursively; `update` processes one state."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._config, self._model = config.estimation, model
        self._imu = model.imu
        length = min(sole.length for sole in model.soles.values())
        self._slip = max(_SLIP[0] * config.estimation.kinematics, _SLIP[1] * length)
        self._points = [
            (sole.frame, sole.center + np.array([side * sole.length, 0.0, 0.0]))
            for sole, side in ((model.soles[foot], side) for foot, side in _POINTS)
        ]
        c = config.estimation
        deviations = [c.gyro_noise] * 3 + [c.accelerometer_noise] * 3 + [c.slip]
        deviations += [c.gyro_drift] * 3 + [c.accelerometer_drift] * 3
        deviations += [c.pivot * 0.5 * length]
        self._noise = np.array([*deviations, 0.0]) ** 2
        self._landing_noise = np.array([*deviations, c.pivot_landing / math.sqrt(_LANDING)]) ** 2
        self._both, self._landed = True, -math.inf  # when the last foot has come to the ground [s]
        self._time = math.nan
        self._last_inertial = np.zeros(3), np.zeros(3)
        self._stood, self._ground = np.zeros(4, dtype=bool), np.zeros(4)
        self._slipping = 0  # consecutive updates in which every standing sole seems to slip

    @property
    def astray(self) -> bool:
        """Whether the inertial sensor contradicts the standing soles, so that the estimate is wrong."""
        return self._slipping >= _ASTRAY

    def update(
        self, time: float, kin: Kinematics, gyro: Array, acceleration: Array, *, both: bool, loads: Array | None = None
    ) -> BaseEstimate:
        """Return the estimate at `time` [s].

        Parameters
        ----------
        kin : Kinematics
            The robot at the measured joint angles and vertical, in the frame of a sole on the ground.
        gyro, acceleration : ndarray, shape (3,)
            Measurements of the inertial sensor in its frame [rad/s, m/s^2].
        both : bool
            Whether the other sole is on the ground, too. A sole that carries less than 10 % of the weight is not used
            as a contact: it may slide by a millimetre before it lifts and after it lands.
        loads : ndarray, shape (2,), optional
            Vertical forces on the left and on the right sole [N]; without them the CoM divides the weight.
        """
        c, foot_of = self._config, [foot for foot, _ in _POINTS]
        x_imu = DQ(kin.pose(self._imu))
        R_imu, p_imu = x_imu.rotation_matrix(), x_imu.translation()
        points = [kin.point(frame, offset) for frame, offset in self._points]
        h = np.ascontiguousarray((np.array(points) - p_imu) @ R_imu)  # (4, 3), from the sensor in its frame
        base, other = (self._model.soles[foot] for foot in (kin.base, kin.base.other))
        load = 0.0
        if both and loads is not None:
            load = share_of(kin.base.other, loads)
        elif both:
            load = float(share(kin.com_on_ground, base.center, kin.point(other.frame, other.center)))
        loaded = {kin.base: load <= 1.0 - _LEAST_LOAD, kin.base.other: load >= _LEAST_LOAD}
        stands = np.array([loaded[foot] for foot in foot_of])
        if both and not self._both:
            self._landed = time
        self._both = both
        noise = self._landing_noise if time - self._landed < _LANDING else self._noise
        if math.isnan(self._time):
            self._begin(R_imu, p_imu, h)
        else:
            gyro, acceleration = (
                last + np.clip(now - last, -most, most)
                for now, last, most in zip(
                    (gyro, acceleration), self._last_inertial, _JOLT / (time - self._time), strict=True
                )
            )
            mean = 0.5 * (gyro + self._last_inertial[0]), 0.5 * (acceleration + self._last_inertial[1])
            _predict(time - self._time, *mean, noise, self._filter)
        X = self._filter
        lost = _contact(h, stands, self._stood, self._ground, c.kinematics**2, c.floor**2, self._slip, X)
        held = stands & self._stood
        self._slipping = self._slipping + 1 if held.any() and lost[held].all() else 0
        self._time, self._last_inertial, self._stood = time, (gyro, acceleration), stands
        pelvis = DQ.from_matrix(X.R, X.p) * x_imu.conj() * DQ(kin.pose(self._model.pelvis))
        p = pelvis.translation()
        omega = X.R @ (gyro - X.bias[:3])
        contacts = frozenset(foot for foot, s, slipped in zip(foot_of, stands, lost, strict=True) if s and not slipped)
        velocity = X.v + _cross(omega) @ (p - X.p)
        return BaseEstimate(pelvis.vec8(), velocity, omega, self._covariance(p, velocity), contacts)

    def _begin(self, R: Array, p: Array, h: Array) -> None:
        """Initialize state and covariance by the sensor's pose and the contact points `h` (4, 3) in its frame."""
        c = self._config
        tilt = c.floor / 0.07  # inclination of a sole by the unevenness of the floor
        first = np.array([tilt, tilt, 1e-4, *[0.01] * 3, *[c.kinematics] * 3])
        P = np.zeros((_SIZE, _SIZE))
        P[:9, :9] = np.diag(first**2)
        P[_GYRO, _GYRO] = np.eye(3) * c.gyro_bias**2
        P[_ACCELEROMETER, _ACCELEROMETER] = np.eye(3) * c.accelerometer_bias**2
        d = np.ascontiguousarray(p + h @ R.T)
        self._filter = X = _Filter(np.ascontiguousarray(R), np.zeros(3), p.copy(), d, np.zeros(6), P)
        for k in range(len(_POINTS)):
            _reset_point(k, h[k], c.kinematics**2, X)

    def _covariance(self, p: Array, v: Array) -> Array:
        """Return the covariance (9, 9) of the errors of orientation, velocity `v`, position `p`, from that of xi."""
        T = np.eye(9)
        T[_V, _R], T[_P, _R] = -_cross(v), -_cross(p)
        out: Array = T @ self._filter.P[:9, :9] @ T.T
        return out


# ---------------------------------------------------------------------- compiled functions


@jit
def _cross(a: Array) -> Array:
    """Return the matrix (3, 3) of the cross product a x."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@jit
def _exp(a: Array) -> Array:
    """Return the rotation matrix (3, 3) of the rotation vector `a` (3,) [rad] (Rodrigues)."""
    angle = math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
    K = _cross(a)
    turn: Array = np.eye(3) + K
    if angle >= 1e-8:
        turn = np.eye(3) + math.sin(angle) / angle * K + (1.0 - math.cos(angle)) / angle**2 * (K @ K)
    return turn


@jit
def _predict(dt: float, gyro: Array, acceleration: Array, noise: Array, X: _Filter) -> None:
    """Prediction step over `dt` [s] with the measurements of the inertial sensor; `noise` are variances per second."""
    R, v, p, d, bias, P = X
    omega = gyro - bias[:3]
    linear = R @ (acceleration - bias[3:]) + _GRAVITY
    A = np.zeros((_SIZE, _SIZE))  # xi' = A xi + noise
    A[_V, _R], A[_P, _V] = _cross(_GRAVITY), np.eye(3)
    A[_R, _GYRO], A[_V, _ACCELEROMETER] = -R, -R
    A[_V, _GYRO], A[_P, _GYRO] = -_cross(v) @ R, -_cross(p) @ R
    for k in range(4):
        A[9 + 3 * k : 12 + 3 * k, _GYRO] = -_cross(d[k]) @ R
    F = np.eye(_SIZE) + dt * A + 0.5 * dt**2 * (A @ A)
    G = np.ascontiguousarray(A[:, 21:])  # noise of the sensors has the same input matrix as their biases
    Q = (G * noise[:6]) @ G.T
    for i in range(12):  # a sole slides along the floor as a whole, and its heel relative to its toe
        Q[9 + i, 9 + i] += noise[13]
        if i % 3 < 2:
            partner = i + 3 if i % 6 < 3 else i - 3
            Q[9 + i, 9 + i] += noise[6]
            Q[9 + i, 9 + partner] += noise[6]
    for k in range(0, 4, 2):  # and pivots about its centre when a foot lands
        x, y, _ = 0.5 * (d[k + 1] - d[k])
        w = np.array([y, -x, 0.0, -y, x, 0.0])
        Q[9 + 3 * k : 15 + 3 * k, 9 + 3 * k : 15 + 3 * k] += noise[14] * (w.reshape((6, 1)) * w)
    for i in range(6):
        Q[21 + i, 21 + i] += noise[7 + i]
    P[:] = F @ P @ F.T + dt * Q
    p += dt * v + 0.5 * dt**2 * linear
    v += dt * linear
    R[:] = R @ _exp(dt * omega)


@jit
def _reset_point(k: int, h: Array, variance: float, X: _Filter) -> None:
    """Set the contact point k to its present position, `h` (3,) in the sensor's frame, with the error of the base."""
    i, P = 9 + 3 * k, X.P
    X.d[k] = X.p + X.R @ h
    P[i : i + 3, :] = P[_P, :]
    P[:, i : i + 3] = P[:, _P]
    for j in range(3):
        P[i + j, i + j] += variance


@jit
def _contact(
    h: Array, standing: Mask, stood: Mask, ground: Array, kinematics: float, floor: float, slip: float, X: _Filter
) -> Mask:
    """Correction step with the standing contact points; return which of the four have slipped or lifted, shape (4,).

    A point farther than `slip` [m] from its former position has slipped. `ground` (4,) are the heights on which they
    stand [m]: zero, or where a stair is found.
    """
    R, _, p, d, _, P = X
    H, z, noise = np.zeros((12, _SIZE)), np.zeros(12), np.zeros(12)
    m, lost = 0, np.zeros(4, np.bool_)
    for k in range(4):
        if not standing[k]:
            continue
        i = 9 + 3 * k
        e = R @ h[k] + p - d[k]  # = xi_p - xi_d + noise
        lost[k] = stood[k] and e @ e > slip**2
        if stood[k] and not lost[k]:
            for j in range(3):
                H[m, 6 + j], H[m, i + j], z[m], noise[m] = 1.0, -1.0, e[j], kinematics
                m += 1
        else:
            _reset_point(k, h[k], kinematics, X)
            # its height: d_z - ground = (xi_R x d + xi_d)_z + noise
            H[m, 0], H[m, 1], H[m, i + 2], noise[m] = d[k, 1], -d[k, 0], 1.0, floor
            if not stood[k]:
                stair = d[k, 2] ** 2 > _STAIR**2 * (H[m] @ P @ H[m] + floor)
                ground[k] = d[k, 2] if stair else 0.0
            z[m] = d[k, 2] - ground[k]
            m += 1
    if m > 0:
        _correct(np.ascontiguousarray(H[:m]), z[:m], noise[:m], X)
    return lost


@jit
def _correct(H: Array, z: Array, noise: Array, X: _Filter) -> None:
    """Correct the state by the residuals z = H xi + noise (m,): X = exp(-K z) X; `noise` (m,) are variances."""
    R, v, p, d, bias, P = X
    S = H @ P @ H.T + np.diag(noise)
    K = np.ascontiguousarray(np.linalg.solve(S, H @ P).T)
    xi = -(K @ z)
    turn, jacobian = _exp(xi[:3]), np.eye(3) + 0.5 * _cross(xi[:3])
    R[:] = turn @ R
    v[:] = turn @ v + jacobian @ xi[3:6]
    p[:] = turn @ p + jacobian @ xi[6:9]
    for k in range(4):
        d[k] = turn @ d[k] + jacobian @ xi[9 + 3 * k : 12 + 3 * k]
    bias += xi[21:]
    L = np.eye(_SIZE) - K @ H
    P[:] = L @ P @ L.T + (K * noise) @ K.T
