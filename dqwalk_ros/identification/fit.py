"""Fits delay, stiffness, damping, backlash, friction and sensor mounting to the commands and angles of an exercise.

The model of each servo is that of `servos` after a delay T:

    M q'' = K dead(goal(t - T) - q, b) - D q' - f sign(q') - tau(t)

with the inertia M about the joint including its rotor, the error dead(e, b) beyond the backlash b of the gears, and the
torque tau of gravity and of the motion of all other joints, by inverse dynamics at the measured angles. The parameters
minimize the error of the simulated model with respect to the recording (maximum likelihood).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.special import log_ndtr

from dqwalk_ros.identification.replay import require_exercise
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.plants.base import upward
from dqwalk_ros.plants.mujoco import held_torques
from dqwalk_ros.plants.servo_goals import ServoGoals
from dqwalk_ros.robot.clearance import limbs
from dqwalk_ros.robot.servos import IDENTIFIED, Servos
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import BagError
from dqwalk_ros.trace import Trace

NAMES = ("delay", *IDENTIFIED)
"""Identified parameters of each servo [s, N m/rad, s, rad, N m]; the damping is divided by the stiffness."""

_STEP = 0.001
"""Integration step of the model [s]."""
_MOVES = 1e-3
"""Commanded velocity above which a joint is being exercised [rad/s]."""
_LEAST = 0.02
"""Least range of motion of a joint that is identified [rad]."""
_SLACK = 0.4
"""Time before and after its commands that belongs to the exercise of a joint [s]."""
_BLOCK = 1.0
"""Time after which errors of the model are regarded as independent [s]."""
_OFFSET = 0.0005
"""Prior standard deviation of the zero of the goals [rad]."""
_ROTOR, _EMF, _FRICTION = 0.05, 0.15, 0.5
"""Relative prior standard deviations of rotor inertia, back EMF and friction of a servo of known type."""
_DELAY = 0.0002
"""Prior standard deviation of the delay of a servo from the median delay, as all are on the same bus [s]."""
_SOFT = 3.0
"""Scale of the robust loss, in standard deviations."""
_FINE = 2e-4
"""Least resolution of the angles used in the fit, because of the errors of the model [rad]."""
_SHARE = 0.5
"""Standard deviation of the error of the model, as a fraction of the resolution of the encoder."""
_PARTS = (0.2, 0.5, 0.8)
"""Backlash as a fraction of the whole hysteresis in the initial guesses, as the fit has several local minima."""
_LONGEST = 0.2
"""Largest delay of the search [s]."""


@dataclass(frozen=True)
class Mounting:
    """Orientation of the inertial sensor on its link, including the sensor's own error of the vertical.

    Only roll and pitch are identified; yaw is not observable while the robot is held level.
    """

    rpy: Array
    """Roll, pitch and yaw, shape (3,) [rad]."""
    deviation: Array
    """Standard deviations, shape (3,) [rad]; nan for yaw."""


@dataclass(frozen=True)
class Identified:
    """Identified parameters of all servos and of the inertial sensor."""

    joints: tuple[str, ...]
    """Names of the n joints."""
    value: Array
    deviation: Array
    """Values of `NAMES`, and their standard deviations, shape (n, 5)."""
    rms: Array
    """Rms error of the model of each joint, shape (n,) [rad]."""
    missing: dict[str, str]
    """Joints that could not be identified, with the reason; their rows are nan."""
    mounting: Mounting | None
    """None without an inertial sensor."""


def goals_of(trace: Trace) -> Array:
    """Return the goals sent to the servos in response to each state, shape (N, n) [rad].

    By the law of the plants (`plants.servo_goals`).

    Parameters
    ----------
    trace : Trace
        An exercise of N states.
    """
    model, config = trace.model, trace.config.updated({"servo.rate": 0.0, "servo.latency": 0.0})
    law = ServoGoals.of(config, model, simulated=Servos.of(config, model))
    law.gate.use(np.clip(np.zeros(model.n), model.q_min, model.q_max), trace.time[0])  # where an exercise begins
    law.begin()
    out, u = np.empty_like(trace.q), np.nan_to_num(trace.u)
    for k, time in enumerate(trace.time):
        passed = trace.time[k + 1] - time if k + 1 < len(trace) else config.dt
        law.measure(trace.q[k], time)
        law.command(u[k], None, time, float(passed))
        out[k] = law.output(time)[0]
    return out


def identify(
    trace: Trace,
    orientations: Array | None = None,
    *,
    progress: Callable[[float, str], None] | None = None,
) -> Identified:
    """Identify the parameters of the servos and the mounting of the inertial sensor from an exercise.

    The servos of the recorded configuration are the initial guess; their torque limits, the resolution of the goals and
    the rotor inertias of their types are used as well.

    Parameters
    ----------
    trace : Trace
        An exercise.
    orientations : ndarray, shape (m, 4), optional
        Measured by the inertial sensor: unit quaternions, real part first.
    progress : callable, optional
        Called with the completed fraction and the name of the joint.

    Raises
    ------
    BagError
        If the recording is not an exercise, or no joint moved.
    """
    require_exercise(trace)
    model, dt = trace.model, float(np.median(np.diff(trace.time)))
    commanded, goals, nominal = np.nan_to_num(trace.u), goals_of(trace), Servos.of(trace.config, model)
    window = max(7, round(0.14 / dt) | 1)
    # the acceleration of the spline is piecewise linear between states, as the model interpolates the torques
    q = CubicSpline(trace.time, savgol_filter(trace.q, window, 4, axis=0))
    ddq = q(trace.time, 2)
    tau, inertia = held_torques(model, q(trace.time), q(trace.time, 1), ddq)
    tau -= inertia * ddq  # the model includes the inertia of the joint itself
    missing: dict[str, str] = {}
    servos: dict[int, _Servo] = {}
    for limb in limbs(model):
        near = np.ones(2 * round(_SLACK / dt) + 1)
        around = np.array([np.convolve(np.abs(commanded[:, i]) > _MOVES, near, "same") > 0 for i in limb]).T
        for i, joint in enumerate(limb):
            name = model.joint_names[joint]
            alone = around[:, i] & ~np.delete(around, i, axis=1).any(axis=1)
            turned = np.ptp(trace.q[alone, joint]) if alone.any() else 0.0
            if not alone.any():
                missing[name] = "the joint was not exercised"
            elif turned < _LEAST:
                missing[name] = (
                    f"the joint moved by only {math.degrees(turned):.1f} degrees: is its torque on, is it blocked?"
                )
            else:
                servos[joint] = _Servo(_pieces(trace, goals, tau, inertia, joint, alone), nominal, joint)
    if len(missing) == model.n:
        raise BagError(f"no joint moved: {model.joint_names[0]}: {missing[model.joint_names[0]]}")
    value, deviation = np.full((model.n, len(NAMES)), np.nan), np.full((model.n, len(NAMES)), np.nan)
    rms, show = np.full(model.n, np.nan), progress or (lambda fraction, text: None)
    for k, (joint, servo) in enumerate(servos.items()):
        show(0.7 * k / len(servos), model.joint_names[joint])
        servo.begin()
    delay = float(np.median([servo.x[0] for servo in servos.values()]))
    for k, (joint, servo) in enumerate(servos.items()):
        show(0.7 + 0.3 * k / len(servos), model.joint_names[joint])
        value[joint], deviation[joint], rms[joint] = servo.finish(delay)
    return Identified(model.joint_names, value, deviation, rms, missing, _mounting(trace, orientations))


def parameters(found: Identified, dt: float, mass: float) -> str:
    """Return the parameters ``servo.assumed`` and others of the controller, as the text of a ROS parameter file.

    A goal is the integral of the commands at the end of the control period, but is sent at its beginning. So the
    assumed delay is shorter than the identified delay by half a period.

    Parameters
    ----------
    dt : float
        Control period [s].
    mass : float
        Mass of the robot [kg].
    """
    known = [k for k, name in enumerate(found.joints) if name not in found.missing]
    weight = 1.0 / np.maximum(found.deviation[known, 0], 1e-4)
    delay = float(np.average(found.value[known, 0], weights=weight))
    assumed = ["servo:", f"  assumed_latency: {max(delay - 0.5 * dt, 0.0):.4f}", "  assumed_rate: 0.0", "  assumed:"]
    for k in known:
        values = ", ".join(f"{name} {x:.4g}" for name, x in zip(NAMES[1:], found.value[k, 1:], strict=True))
        assumed.append(f'    - "{found.joints[k]}={values}"')
    assumed += ["robot:", f"  mass: {mass:.4f}"]
    if found.mounting is not None:
        rpy = ", ".join(f"{angle:.5f}" for angle in found.mounting.rpy)
        assumed.append(f"  imu_rpy: [{rpy}]")
    lines = ["# Results of `dqwalk identify`; a ROS parameter file to be loaded after that of the robot.", "/**:"]
    return "\n".join([*lines, "  ros__parameters:", *(f"    {line}" for line in assumed)]) + "\n"


# ---------------------------------------------------------------------- one servo


@dataclass(frozen=True)
class _Piece:
    """A period in which one joint was exercised: times [s], angles, goals, torques and inertias, all (m,)."""

    time: Array
    q: Array
    goal: Array
    tau: Array
    inertia: Array
    before: Array
    """Times and goals (2, k) just before the period, which act after the delay."""


def _pieces(trace: Trace, goals: Array, tau: Array, inertia: Array, joint: int, alone: Mask) -> list[_Piece]:
    ends = np.flatnonzero(np.diff(np.concatenate([[0], alone, [0]])))
    out = []
    for a, b in zip(ends[::2], ends[1::2], strict=True):
        if trace.time[b - 1] - trace.time[a] < 2.0:
            continue
        ago = slice(max(0, a - math.ceil(_LONGEST / (trace.time[1] - trace.time[0])) - 1), a)
        out.append(
            _Piece(
                time=trace.time[a:b],
                q=trace.q[a:b, joint],
                goal=goals[a:b, joint],
                tau=tau[a:b, joint],
                inertia=inertia[a:b, joint],
                before=np.array([trace.time[ago], goals[ago, joint]]),
            )
        )
    return out


class _Servo:
    """Fit of the model of one servo to its recording."""

    def __init__(self, pieces: list[_Piece], nominal: Servos, joint: int) -> None:
        self._pieces, self._step, self._limit = pieces, _encoder(pieces), float(nominal.torque[joint])
        K, D = float(nominal.stiffness[joint]), float((nominal.back_emf + nominal.damping)[joint])
        rotor = max(float(nominal.armature[joint]), 1e-5)
        play, friction = max(float(nominal.backlash[joint]), 0.002), max(float(nominal.friction[joint]), 0.01)
        # T, K, D, b, f, rotor inertia, zero of the goals, creep and lead of friction: see `_simulated`
        self.x = np.array([0.05, K, D, play, friction, rotor, 0.0, 0.005, 0.003])
        self._scale = np.array([0.02, K, 0.02 * K, 0.005, 0.1, rotor, 1e-3, 0.01, 0.01])
        self._low = np.array([0.0, 0.05 * K, 0.0, 0.0, 0.0, 0.1 * rotor, -0.05, 1e-4, 0.0])
        self._high = np.array([_LONGEST, 20.0 * K, K, 0.2, 10.0, 10.0 * rotor, 0.05, 0.03, 0.02])
        # prior: motor parameters of a known type, and zero of the goals
        typed = nominal.back_emf[joint] > 0.0
        self._prior_mean = self.x.copy()
        self._prior_deviation = np.full(9, np.inf)
        self._prior_deviation[5], self._prior_deviation[6] = (_ROTOR if typed else 1.0) * rotor, _OFFSET
        if typed:
            self._prior_deviation[2], self._prior_deviation[4] = _EMF * D, _FRICTION * friction
        self._block = np.concatenate([np.floor(piece.time / _BLOCK) for piece in pieces])

    def begin(self) -> None:
        """Find initial parameters from several initial guesses, because the fit has several local minima."""
        begins = np.tile(self.x, (round(_LONGEST / 0.01), 1))
        begins[:, 0] = 0.005 + 0.01 * np.arange(len(begins))
        begin = min(begins, key=lambda x: float(np.abs(self._errors(x)).sum()))
        play = begin[3] + 2.0 * begin[4] / begin[1]  # hysteresis of a slow motion, by backlash and friction
        found = []
        for part in _PARTS:
            begin[3], begin[4] = part * play, 0.5 * (1.0 - part) * play * begin[1]
            found.append(self._solve(begin, 8))
        self.x = self._solve(min(found, key=lambda one: float(one.cost)).x * self._scale, 15).x * self._scale

    def finish(self, delay: float) -> tuple[Array, Array, float]:
        """Return values and standard deviations (5,) of `NAMES`, and the rms error [rad]; `delay` is the prior mean."""
        self._prior_mean[0], self._prior_deviation[0] = delay, _DELAY
        found, many = self._solve(self.x, 25), len(self._block)
        x, J = found.x * self._scale, found.jac
        # consecutive errors are correlated, so the covariance is computed from sums over blocks (sandwich estimator)
        score = J * found.fun[:, None]
        blocks = np.add.reduceat(score[:many], np.flatnonzero(np.diff(self._block, prepend=-1.0)), axis=0)
        bread, known = np.linalg.pinv(J.T @ J), J[many:]
        covariance = bread @ (blocks.T @ blocks + known.T @ known) @ bread * np.outer(self._scale, self._scale)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        value, spread = x[:5].copy(), deviation[:5].copy()
        value[2], spread[2] = x[2] / x[1], math.hypot(deviation[2], x[2] / x[1] * deviation[1]) / x[1]
        return value, spread, float(np.sqrt(np.mean(self._deviations(x) ** 2)))

    def _solve(self, x: Array, most: int) -> Any:
        low, high = self._low / self._scale, self._high / self._scale
        return least_squares(
            lambda y: self._errors(y * self._scale),
            np.clip(x / self._scale, low + 1e-6, high - 1e-6),
            bounds=(low, high),
            diff_step=1e-3,
            x_scale="jac",
            max_nfev=most,
        )

    def _errors(self, x: Array) -> Array:
        """Return the residuals of the measured angles and of the prior, in standard deviations."""
        prior = (x - self._prior_mean) / self._prior_deviation
        return np.concatenate([_angle_residuals(self._deviations(x), self._step), prior])

    def _deviations(self, x: Array) -> Array:
        return np.concatenate([_run(piece, x, self._limit) for piece in self._pieces])


def _encoder(pieces: list[_Piece]) -> float:
    """Return the resolution of the measured angles [rad]: their least change."""
    steps = np.abs(np.concatenate([np.diff(piece.q) for piece in pieces]))
    return max(float(steps[steps > 1e-9].min(initial=0.1)), _FINE)


def _angle_residuals(error: Array, step: float) -> Array:
    """Return robust residuals of angles measured with a resolution of `step` [rad], in standard deviations.

    Goals have the same resolution, so in slow motion all measurements are rounded in the same direction, and the
    quantization error does not average out. The likelihood of a measurement is that of an angle within half a step.
    """
    sigma, far = _SHARE * step, np.abs(error)
    inside, beyond = log_ndtr((0.5 * step - far) / sigma), log_ndtr((-0.5 * step - far) / sigma)
    cost = -(inside + np.log1p(-np.exp(beyond - inside)))
    least = -math.log(math.erf(0.5 * step / sigma / math.sqrt(2.0)))
    z = 2.0 * np.maximum(cost - least, 0.0) / _SOFT**2
    out: Array = np.sign(error) * _SOFT * np.sqrt(2.0 * (np.sqrt(1.0 + z) - 1.0))  # robust loss
    return out


def _run(piece: _Piece, x: Array, limit: float) -> Array:
    """Return the error of the model with respect to the recording of a piece, shape (m,) [rad]."""
    times = np.concatenate([piece.before[0], piece.time])
    goals = np.concatenate([piece.before[1], piece.goal])
    out: Array = _simulated(piece.time, piece.q, piece.tau, piece.inertia, times, goals, x, limit, _STEP) - piece.q
    out[: np.searchsorted(piece.time, piece.time[0] + _SLACK)] = 0.0  # the initial state is not known exactly
    return out


@jit
def _simulated(
    time: Array, measured: Array, tau: Array, inertia: Array, sent: Array, goals: Array, x: Array, limit: float,
    step: float,
) -> Array:  # fmt: skip
    """Return the angles of the model, starting at rest at the first measured angle.

    Friction has its full value if abs(v + lead v') > creep, and is proportional to v + lead v' below. For ideal dry
    friction creep and lead are zero; in a physics engine both are positive.

    Parameters
    ----------
    time : ndarray, shape (m,)
        [s]
    measured : ndarray, shape (m,)
        Measured angles, of which only the first is used [rad].
    tau : ndarray, shape (m,)
        Load torque [N m].
    inertia : ndarray, shape (m,)
        Inertia about the joint without the rotor [kg m^2].
    sent, goals : ndarray, shape (k,)
        Times at which the goals were sent [s], and goals [rad].
    x : ndarray, shape (9,)
        T [s], K [N m/rad], D [N m s/rad], b [rad] and f [N m] of the model, inertia of the rotor [kg m^2], zero of the
        goals [rad], creep [rad/s] and lead [s].
    limit : float
        Largest torque [N m].
    step : float
        Largest integration step [s].

    Returns
    -------
    ndarray, shape (m,)
        Angles [rad].
    """
    delay, K, D, b, f, rotor, zero, creep, lead = x
    out = np.empty(time.shape[0])
    q, v = measured[0], 0.0
    out[0] = q
    last = sent.shape[0] - 1
    at = 0
    while at < last and sent[at + 1] + delay <= time[0]:
        at += 1
    for k in range(time.shape[0] - 1):
        count = max(1, round((time[k + 1] - time[k]) / step))
        h = (time[k + 1] - time[k]) / count
        M = 0.5 * (inertia[k] + inertia[k + 1]) + rotor
        for i in range(count):
            now = time[k] + i * h
            goal = goals[at]
            while at < last and sent[at + 1] + delay < now + h:  # the goal changes within this step
                part = min(max((sent[at + 1] + delay - now) / h, 0.0), 1.0)
                goal = part * goal + (1.0 - part) * goals[at + 1]
                at += 1
            load = tau[k] + (i + 0.5) / count * (tau[k + 1] - tau[k])
            e = goal + zero - q
            e = e - min(max(e, -0.5 * b), 0.5 * b)
            drive = min(max(K * e, -limit), limit)
            free = (M * v + h * (drive - load)) / (M + h * D)
            brake = h * f / (M + h * D)
            soft, ahead = brake / creep, lead / h
            slow = (free + soft * ahead * v) / (1.0 + soft * (1.0 + ahead))
            slips = slow + ahead * (slow - v)
            if slips > creep:
                v = free - brake
            elif slips < -creep:
                v = free + brake
            else:
                v = slow
            q += h * v
        out[k + 1] = q
    return out


# ---------------------------------------------------------------------- the inertial sensor


def _mounting(trace: Trace, orientations: Array | None) -> Mounting | None:
    """Return the roll and pitch of the sensor's mounting from the vertical that it measures while the root is level."""
    if orientations is None or not len(orientations):
        return None
    up = np.array([upward(*row.tolist()) for row in orientations])  # = R_mounted^T R_link^T z
    link = DQ(trace.model.frames[trace.model.imu_link].pose).rotation_matrix().T @ Z
    mean = up.mean(axis=0) / np.linalg.norm(up.mean(axis=0))
    axis = np.cross(mean, link)
    sine = float(np.linalg.norm(axis))
    turn = axis / max(sine, 1e-12) * math.atan2(sine, float(mean @ link))
    noise = up.std(axis=0) / math.sqrt(len(up))
    return Mounting(DQ(0.5 * turn).exp().roll_pitch_yaw(), np.array([noise[1], noise[0], math.nan]))
