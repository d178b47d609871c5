"""The fit: from what the joints were told and what they did to delay, stiffness, damping, backlash, friction, mounting.

Each servo is a model of its own, as `servos` has it, behind a delay T:

    M q'' = K dead(goal(t - T) - q, b) - D q' - f sign(q') - tau(t)

with M what turns about the joint, its rotor included, dead(e, b) the error beyond the play b of the gears, and tau what
gravity and the motion of all other joints do, by inverse dynamics at the angles that were measured. The parameters are
those with which the model (`servo_model`), run from state to state, is nearest to the recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation
from scipy.special import log_ndtr

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.identification.exercise import limbs
from dqwalk_ros.identification.replay import require_exercise
from dqwalk_ros.identification.servo_model import simulate
from dqwalk_ros.plants import upward
from dqwalk_ros.plants.bus import Bus
from dqwalk_ros.plants.mujoco import held_torques
from dqwalk_ros.servos import Drive, Servos
from dqwalk_ros.simulation import Trace
from dqwalk_ros.urdf import Origin

__all__ = ["NAMES", "Identified", "Mounting", "goals_of", "identify", "parameters"]

Array = NDArray[np.float64]

NAMES = ("delay", "stiffness", "damping", "backlash", "friction")
"""What is found of each servo [s, N m/rad, s, rad, N m]; the damping is divided by the stiffness."""

_STEP = 0.001
"""Of the model [s]."""
_MOVES = 1e-3
"""A command beyond this is one to move [rad/s]."""
_LEAST = 0.02
"""A joint that turned by less than this did not move [rad]."""
_SLACK = 0.4
"""Around its commands a joint counts as exercised for this long [s]."""
_BLOCK = 1.0
"""Errors of the model further apart than this are independent [s]."""
_OFFSET = 0.0005
"""How well the goals' own zero is known [rad]."""
_ROTOR, _EMF, _FRICTION = 0.05, 0.15, 0.5
"""How well inertia of the rotor, back EMF and friction are known from the type of a servo, as parts of them."""
_DELAY = 0.0002
"""How alike the delays of all servos are: they hang on the same bus [s]."""
_SOFT = 3.0
"""Errors beyond this many standard deviations count less."""
_FINE = 2e-4
"""Finer readings than this are no better: the model is not [rad]."""
_SHARE = 0.5
"""What the model is off, as a part of a step of the encoder."""
_PARTS = (0.2, 0.5, 0.8)
"""Backlash as a part of all play, in the beginnings that are tried: the fit has more than one minimum."""
_LONGEST = 0.2
"""Delays are looked for up to this [s]."""


@dataclass(frozen=True)
class Mounting:
    """How the inertial sensor is mounted, with its own error of the vertical: roll and pitch [rad].

    Its yaw does not show in a robot that is held level.

    Attributes
    ----------
    rpy, deviation : ndarray, shape (3,)
        Roll, pitch and yaw, and their standard deviations [rad].
    """

    rpy: Array
    deviation: Array


@dataclass(frozen=True)
class Identified:
    """What was found.

    Attributes
    ----------
    joints : tuple of str
    value, deviation : ndarray, shape (n, 5)
        Of `NAMES`, and the standard deviations.
    rms : ndarray, shape (n,)
        What the model of each joint is off the recording [rad].
    missing : dict of str to str
        Joints of which nothing is known, and why; their rows are nan.
    mounting : Mounting or None
        None without an inertial sensor.
    """

    joints: tuple[str, ...]
    value: Array
    deviation: Array
    rms: Array
    missing: dict[str, str]
    mounting: Mounting | None


def goals_of(trace: Trace) -> Array:
    """Return the goals (N, n) that the servos were sent in answer to each state [rad].

    Commands were integrated as `plants.bus` does it.
    """
    config = trace.config.updated({"servo.rate": 0.0, "servo.latency": 0.0})
    model, servos, drive = trace.model, Servos.of(config, trace.model), Drive.of(config, trace.model)
    begin = np.clip(np.zeros(model.n), model.q_min, model.q_max)  # of an exercise
    bus = Bus(config.servo, servos, drive, begin, model.q_min, model.q_max)
    out, u = np.empty_like(trace.q), np.nan_to_num(trace.u)
    for k, time in enumerate(trace.time):
        passed = trace.time[k + 1] - time if k + 1 < len(trace) else config.dt
        bus.command(u[k], None, trace.q[k], time, float(passed))
        out[k] = bus.output(time)[0]
    return out


def identify(
    trace: Trace,
    orientations: Array | None = None,
    *,
    mass_scale: float = 1.0,
    progress: Callable[[float, str], None] | None = None,
) -> Identified:
    """Return what an exercise shows of the servos and of the inertial sensor.

    Of the recorded configuration only what the servos are said to be is used, as a beginning: the resolution of goals
    and the rotors of their types.

    Parameters
    ----------
    trace : Trace
        An exercise.
    orientations : ndarray, shape (m, 4), optional
        Of the inertial sensor, unit quaternions, real part first.
    mass_scale : float
        What the robot weighs, as a part of what its URDF says.
    progress : callable, optional
        Called with the fraction done and the joint.

    Raises
    ------
    BagError
        If it is no exercise, or no joint moved.
    """
    require_exercise(trace)
    model, dt = trace.model, float(np.median(np.diff(trace.time)))
    told, goals, nominal = np.nan_to_num(trace.u), goals_of(trace), Servos.of(trace.config, model)
    window = max(7, round(0.14 / dt) | 1)
    # a spline's own acceleration, in straight pieces from state to state: so the model takes the torques, too
    q = CubicSpline(trace.time, savgol_filter(trace.q, window, 4, axis=0))
    ddq = q(trace.time, 2)
    tau, inertia = held_torques(model, mass_scale, q(trace.time), q(trace.time, 1), ddq)
    tau -= inertia * ddq  # what the joint's own motion takes is in the model
    missing: dict[str, str] = {}
    servos: dict[int, _Servo] = {}
    for limb in limbs(model):
        near = np.ones(2 * round(_SLACK / dt) + 1)
        around = np.array([np.convolve(np.abs(told[:, i]) > _MOVES, near, "same") > 0 for i in limb]).T
        for i, joint in enumerate(limb):
            name = model.joint_names[joint]
            alone = around[:, i] & ~np.delete(around, i, axis=1).any(axis=1)
            turned = np.ptp(trace.q[alone, joint]) if alone.any() else 0.0
            if not alone.any():
                missing[name] = "it was not exercised"
            elif turned < _LEAST:
                missing[name] = (
                    f"it turned by {math.degrees(turned):.1f} degrees only: is its torque on, is it blocked?"
                )
            else:
                servos[joint] = _Servo(_pieces(trace, goals, tau, inertia, joint, alone), nominal, joint)
    if len(missing) == model.n:
        raise BagError(f"no joint moved: {model.joint_names[0]}: {missing[model.joint_names[0]]}")
    value, deviation = np.full((model.n, len(NAMES)), np.nan), np.full((model.n, len(NAMES)), np.nan)
    rms, said = np.full(model.n, np.nan), progress or (lambda fraction, text: None)
    for k, (joint, servo) in enumerate(servos.items()):
        said(0.7 * k / len(servos), model.joint_names[joint])
        servo.begin()
    delay = float(np.median([servo.x[0] for servo in servos.values()]))
    for k, (joint, servo) in enumerate(servos.items()):
        said(0.7 + 0.3 * k / len(servos), model.joint_names[joint])
        value[joint], deviation[joint], rms[joint] = servo.finish(delay)
    return Identified(model.joint_names, value, deviation, rms, missing, _mounting(trace, orientations))


def parameters(found: Identified, dt: float, mass_scale: float) -> str:
    """Return what the controller is told of all this, as the text of a ROS parameter file.

    A goal is where the integral of the commands is at the end of its period, but it is sent at the beginning, so the
    controller is told a delay that is shorter by half a period.
    """
    known = [k for k, name in enumerate(found.joints) if name not in found.missing]
    weight = 1.0 / np.maximum(found.deviation[known, 0], 1e-4)
    delay = float(np.average(found.value[known, 0], weights=weight))
    told = ["servo:", f"  assumed_latency: {max(delay - 0.5 * dt, 0.0):.4f}", "  assumed_rate: 0.0", "  assumed:"]
    for k in known:
        values = ", ".join(f"{name} {x:.4g}" for name, x in zip(NAMES[1:], found.value[k, 1:], strict=True))
        told.append(f'    - "{found.joints[k]}={values}"')
    told += ["physics:", f"  mass_scale: {mass_scale:.4f}"]
    if found.mounting is not None:
        rpy = ", ".join(f"{angle:.5f}" for angle in found.mounting.rpy)
        told += ["robot:", f"  imu_rpy: [{rpy}]"]
    lines = ["# What `dqwalk identify` found; a ROS parameter file to be put on top of another one.", "/**:"]
    return "\n".join([*lines, "  ros__parameters:", *(f"    {line}" for line in told)]) + "\n"


# ---------------------------------------------------------------------- one servo


@dataclass(frozen=True)
class _Piece:
    """A time in which one joint was exercised: times (m,), angles, goals, torques and inertias at them."""

    time: Array
    q: Array
    goal: Array
    tau: Array
    inertia: Array
    before: Array
    """Goals and times (2, k) of the time just before, which are still under way."""


def _pieces(
    trace: Trace, goals: Array, tau: Array, inertia: Array, joint: int, alone: NDArray[np.bool_]
) -> list[_Piece]:
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
    """The model of one servo, and the recording that it is fitted to."""

    def __init__(self, pieces: list[_Piece], told: Servos, joint: int) -> None:
        self._pieces, self._step, self._limit = pieces, _encoder(pieces), float(told.torque[joint])
        K, D = float(told.stiffness[joint]), float((told.back_emf + told.damping)[joint])
        rotor = max(float(told.armature[joint]), 1e-5)
        play, friction = max(float(told.backlash[joint]), 0.002), max(float(told.friction[joint]), 0.01)
        # T, K, D, b, f, the rotor, the zero of the goals, and how soft friction is: see `servo_model.simulate`
        self.x = np.array([0.05, K, D, play, friction, rotor, 0.0, 0.005, 0.003])
        self._scale = np.array([0.02, K, 0.02 * K, 0.005, 0.1, rotor, 1e-3, 0.01, 0.01])
        self._low = np.array([0.0, 0.05 * K, 0.0, 0.0, 0.0, 0.1 * rotor, -0.05, 1e-4, 0.0])
        self._high = np.array([_LONGEST, 20.0 * K, K, 0.2, 10.0, 10.0 * rotor, 0.05, 0.03, 0.02])
        # what is known before: of a type the motor, and the zero of the goals
        typed = told.back_emf[joint] > 0.0
        self._mean = self.x.copy()
        self._sure = np.full(9, np.inf)
        self._sure[5], self._sure[6] = (_ROTOR if typed else 1.0) * rotor, _OFFSET
        if typed:
            self._sure[2], self._sure[4] = _EMF * D, _FRICTION * friction
        self._block = np.concatenate([np.floor(piece.time / _BLOCK) for piece in pieces])

    def begin(self) -> None:
        """Find the parameters from nothing, roughly: the fit has more than one minimum."""
        begins = np.tile(self.x, (round(_LONGEST / 0.01), 1))
        begins[:, 0] = 0.005 + 0.01 * np.arange(len(begins))
        begin = min(begins, key=lambda x: float(np.abs(self._errors(x)).sum()))
        play = begin[3] + 2.0 * begin[4] / begin[1]  # what a slow motion is late, of backlash and friction together
        found = []
        for part in _PARTS:
            begin[3], begin[4] = part * play, 0.5 * (1.0 - part) * play * begin[1]
            found.append(self._solve(begin, 8))
        self.x = self._solve(min(found, key=lambda one: float(one.cost)).x * self._scale, 15).x * self._scale

    def finish(self, delay: float) -> tuple[Array, Array, float]:
        """Return values and deviations (5,) of `NAMES`, and the rms of the errors; the others have this delay."""
        self._mean[0], self._sure[0] = delay, _DELAY
        found, many = self._solve(self.x, 25), len(self._block)
        x, J = found.x * self._scale, found.jac
        # errors that follow each other are no independent ones: they are summed over blocks of time
        score = J * found.fun[:, None]
        blocks = np.add.reduceat(score[:many], np.flatnonzero(np.diff(self._block, prepend=-1.0)), axis=0)
        bread, known = np.linalg.pinv(J.T @ J), J[many:]
        covariance = bread @ (blocks.T @ blocks + known.T @ known) @ bread * np.outer(self._scale, self._scale)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        value, spread = x[:5].copy(), deviation[:5].copy()
        value[2], spread[2] = x[2] / x[1], math.hypot(deviation[2], x[2] / x[1] * deviation[1]) / x[1]
        return value, spread, float(np.sqrt(np.mean(self._off(x) ** 2)))

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
        """Return by how many standard deviations readings and what is known before are off."""
        return np.concatenate([_unlikely(self._off(x), self._step), (x - self._mean) / self._sure])

    def _off(self, x: Array) -> Array:
        return np.concatenate([_run(piece, x, self._limit) for piece in self._pieces])


def _encoder(pieces: list[_Piece]) -> float:
    """Return the step in which angles were read [rad]: the least change of them."""
    steps = np.abs(np.concatenate([np.diff(piece.q) for piece in pieces]))
    return max(float(steps[steps > 1e-9].min(initial=0.1)), _FINE)


def _unlikely(error: Array, step: float) -> Array:
    """Return by how many standard deviations readings in steps are off the model.

    Goals have the same steps, so that in slow motion all readings are rounded the same way: that is no noise that
    averages out. A reading says that the angle was within half a step, no more.
    """
    sigma, far = _SHARE * step, np.abs(error)
    inside, beyond = log_ndtr((0.5 * step - far) / sigma), log_ndtr((-0.5 * step - far) / sigma)
    cost = -(inside + np.log1p(-np.exp(beyond - inside)))
    least = -math.log(math.erf(0.5 * step / sigma / math.sqrt(2.0)))
    z = 2.0 * np.maximum(cost - least, 0.0) / _SOFT**2
    out: Array = np.sign(error) * _SOFT * np.sqrt(2.0 * (np.sqrt(1.0 + z) - 1.0))  # far ones count less
    return out


def _run(piece: _Piece, x: Array, limit: float) -> Array:
    """Return what the model is off the recording at each time of a piece, shape (m,) [rad]."""
    times = np.concatenate([piece.before[0], piece.time])
    goals = np.concatenate([piece.before[1], piece.goal])
    out: Array = simulate(piece.time, piece.q, piece.tau, piece.inertia, times, goals, x, limit, _STEP) - piece.q
    out[: np.searchsorted(piece.time, piece.time[0] + _SLACK)] = 0.0  # where it began is not known exactly
    return out


# ---------------------------------------------------------------------- the inertial sensor


def _mounting(trace: Trace, seen: Array | None) -> Mounting | None:
    """Return the roll and pitch at which the sensor sees the vertical of a root link that is held level."""
    if seen is None or not len(seen):
        return None
    up = np.array([upward(*row.tolist()) for row in seen])  # = R_mounted^T R_link^T z
    link = DQ(trace.model.frames[trace.model.imu_link].pose).rotation_matrix().T @ [0.0, 0.0, 1.0]
    mean = up.mean(axis=0) / np.linalg.norm(up.mean(axis=0))
    axis = np.cross(mean, link)
    sine = float(np.linalg.norm(axis))
    turn = axis / max(sine, 1e-12) * math.atan2(sine, float(mean @ link))
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    noise = up.std(axis=0) / math.sqrt(len(up))
    return Mounting(np.array(Origin.of(pose).rpy), np.array([noise[1], noise[0], math.nan]))
