"""The robot as a free-floating multibody system: H, h, Jacobians and their drifts (S1) [Sherikov2014].

The generalized velocity is v = (v_base, q'): the linear and angular velocity of the root link in its own axes, and the
joint velocities in the order of the model; the paper has the base last. A wrench or a velocity of a frame is
(linear, angular) in world axes, at the frame's origin.

The computations are those of pinocchio, an optional dependency (the extra ``[wholebody]``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True)
class FrameMotion:
    """Pose, velocity, Jacobian and drift of a frame, in world axes."""

    position: Array
    """Shape (3,) [m]."""
    rotation: Array
    """Shape (3, 3)."""
    velocity: Array
    """J v, linear and angular, shape (6,) [m/s, rad/s]."""
    jacobian: Array
    """J, shape (6, nv)."""
    drift: Array
    """J' v, so that the acceleration is J v' + J' v, shape (6,) [m/s^2, rad/s^2]."""


@dataclass(frozen=True)
class Dynamics:
    """The terms of (S1), CoM and frames at one state."""

    q: Array
    """Joint angles, shape (n,) [rad]."""
    v: Array
    """Velocity of the base and of the joints, shape (6 + n,)."""
    H: Array
    """Generalized inertia, shape (nv, nv)."""
    h: Array
    """Coriolis, centrifugal and gravity effects, shape (nv,)."""
    com: Array
    """c, shape (3,) [m]."""
    com_velocity: Array
    """c', shape (3,) [m/s]."""
    com_jacobian: Array
    """J_com, shape (3, nv)."""
    com_drift: Array
    """J'_com v, shape (3,) [m/s^2]."""
    frames: Mapping[str, FrameMotion]
    """The frames given to `Multibody`."""

    @property
    def nv(self) -> int:
        """6 + n."""
        return int(self.v.shape[0])


class Multibody:
    """Evaluates (S1) for a model.

    Parameters
    ----------
    frames : iterable of str
        Links whose motion is computed.

    Raises
    ------
    ModelError
        If pinocchio cannot read the robot, or there is no such frame.
    """

    def __init__(self, model: RobotModel, frames: Iterable[str] = ()) -> None:
        self.model = model
        self._pin = _build(model)
        self._pin.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        self._data = self._pin.createData()
        self.mass = float(pin.computeTotalMass(self._pin))
        missing = [name for name in frames if not self._pin.existFrame(name)]
        if missing:
            raise ModelError(f"the robot '{model.name}' has no link '{missing[0]}'")
        self._frames = {name: self._pin.getFrameId(name) for name in frames}
        joints = [self._pin.joints[self._pin.getJointId(name)] for name in model.joint_names]
        self._iq = np.array([joint.idx_q for joint in joints])
        self._iv = np.concatenate([np.arange(6), [joint.idx_v for joint in joints]])
        self._ivv = np.ix_(self._iv, self._iv)
        self._zero = np.zeros(self._pin.nv)

    @property
    def nv(self) -> int:
        """6 + n."""
        return int(self._pin.nv)

    def at(self, x_base: ArrayLike, q: Array, v: Array) -> Dynamics:
        """Return the dynamics at a state.

        Parameters
        ----------
        x_base : array_like, shape (8,)
            Pose of the root link in the world.
        q : ndarray, shape (n,)
            [rad]
        v : ndarray, shape (6 + n,)
        """
        model, data, zero = self._pin, self._data, self._zero
        full = self._configuration(x_base, q)
        speed = np.empty(self.nv)
        speed[self._iv] = v
        pin.forwardKinematics(model, data, full, speed, zero)
        pin.computeJointJacobians(model, data, full)
        pin.updateFramePlacements(model, data)
        upper = np.triu(pin.crba(model, data, full))
        inertia = upper + np.triu(upper, 1).T
        effects = pin.nonLinearEffects(model, data, full, speed)
        pin.centerOfMass(model, data, full, speed, zero)
        com, com_velocity, com_drift = data.com[0].copy(), data.vcom[0].copy(), data.acom[0].copy()
        com_jacobian = pin.jacobianCenterOfMass(model, data, full, False)
        frames = {}
        for name, at in self._frames.items():
            jacobian = pin.getFrameJacobian(model, data, at, _WORLD)[:, self._iv]
            frames[name] = FrameMotion(
                position=data.oMf[at].translation.copy(),
                rotation=data.oMf[at].rotation.copy(),
                velocity=jacobian @ v,
                jacobian=jacobian,
                drift=pin.getFrameClassicalAcceleration(model, data, at, _WORLD).vector.copy(),
            )
        return Dynamics(
            q=q,
            v=v,
            H=inertia[self._ivv],
            h=effects[self._iv],
            com=com,
            com_velocity=com_velocity,
            com_jacobian=com_jacobian[:, self._iv],
            com_drift=com_drift,
            frames=frames,
        )

    def integrate(self, x_base: ArrayLike, q: Array, step: Array) -> tuple[Array, Array]:
        """Return the pose of the base (8,) and the joints (n,) after a displacement v dt, shape (6 + n,)."""
        moved = np.empty(self.nv)
        moved[self._iv] = step
        full = pin.integrate(self._pin, self._configuration(x_base, q), moved)
        return DQ.from_pose(full[:3], full[[6, 3, 4, 5]]).vec8(), full[self._iq]

    def stand(self, posture: Array, apart: float, upright: str) -> tuple[Array, Array]:
        """Return a standing state: soles flat on the ground side by side, the CoM above their middle, the origin.

        Both soles' links and the link `upright` must be among the frames.

        Parameters
        ----------
        posture : ndarray, shape (n,)
            Joint angles that the arms keep, and from which the legs are iterated [rad].
        apart : float
            Lateral distance of the soles' links [m].
        upright : str
            The link to keep upright.

        Returns
        -------
        x_base : ndarray, shape (8,)
        q : ndarray, shape (n,)

        Raises
        ------
        ModelError
            If there is no such state.
        """
        places = {Foot.LEFT: np.array([0.0, 0.5 * apart, 0.0]), Foot.RIGHT: np.array([0.0, -0.5 * apart, 0.0])}
        x_base, q, still = DQ.from_pose([0.0, 0.0, 0.7]).vec8(), posture.copy(), np.zeros(self.nv)
        for _ in range(200):
            dynamics = self.at(x_base, q, still)
            rows, errors = [dynamics.com_jacobian[:2]], [-dynamics.com[:2]]
            for foot, place in places.items():
                motion = dynamics.frames[self.model.soles[foot].frame]
                rows.append(motion.jacobian)
                errors.append(place - motion.position)
                errors.append(-rotation_error(motion.rotation))
            rows.append(dynamics.frames[upright].jacobian[3:])
            errors.append(-rotation_error(dynamics.frames[upright].rotation))
            J, error = np.vstack(rows), np.concatenate(errors)
            inverse = np.linalg.pinv(J, rcond=1e-6)
            back = np.concatenate([np.zeros(6), 0.2 * (posture - q)])
            step = inverse @ error + back - inverse @ (J @ back)
            if np.abs(error).max() < 1e-10 and np.abs(step).max() < 1e-6:
                return x_base, q
            x_base, q = self.integrate(x_base, q, np.clip(step, -0.2, 0.2))
        off = float(np.abs(error).max())
        raise ModelError(f"'{self.model.name}' cannot stand with its soles {apart:g} m apart: the error is {off:.2g}")

    def _configuration(self, x_base: ArrayLike, q: Array) -> Array:
        """Return pinocchio's configuration vector, shape (nq,)."""
        x, full = DQ(x_base), np.empty(self._pin.nq)
        full[:3], full[3:7], full[self._iq] = x.translation(), x.rotation()[[1, 2, 3, 0]], q
        return full


def rotation_error(rotation: Array, desired: Array | None = None) -> Array:
    """Return the rotation vector from `desired` (by default the identity) to `rotation`, in world axes, (3,) [rad]."""
    error: Array = pin.log3(rotation if desired is None else rotation @ desired.T)
    return error


def _build(model: RobotModel) -> pin.Model:
    """Return pinocchio's model of the joints that move."""
    try:
        return pin.buildModelFromXML(model.urdf_without_shapes, pin.JointModelFreeFlyer())
    except ValueError as error:
        raise ModelError(f"pinocchio cannot read '{model.name}': {error}") from error
