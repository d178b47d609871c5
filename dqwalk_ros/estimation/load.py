"""Load of each foot: measured, or estimated from the torques of its leg, such as the present load of a Dynamixel.

The joints between pelvis and sole carry the links of their leg, accelerate their rotors, and transmit the force of the
ground. Seen from the pelvis, with the torques g of the weight beyond each joint, the inertias A of the rotors, the
vertical `up` and the Jacobian J of the sole's centre, a vertical force F satisfies

    tau = g + A q'' - F J'up

Its least-squares solution over the joints of the leg is filtered. Friction of the gears and a pressure beside the
centre of the sole make it wrong by a fraction of the weight, but similarly for both legs: their ratio is known to about
a twentieth.
"""

from __future__ import annotations

import math

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.compiled import jit

__all__ = ["FootLoads", "share_of"]


_SMOOTH = 0.01
"""Time constant of the filter of the forces, and of that of the joint accelerations [s]."""
_MOST = 3.0
"""Largest force on a sole, in weights, so that one wrong torque is forgotten after a few filter times."""
_GAP = 0.1
"""Time without a state after which the filters begin again [s]."""


def share_of(foot: Foot, loads: Array) -> float:
    """Return the fraction of the loads (2,) of the left and the right foot [N] that is on `foot`; 0.5 in the air."""
    left, right = loads.tolist()
    mine = left if foot is Foot.LEFT else right
    return mine / (left + right) if left + right > 0.0 else 0.5


class FootLoads:
    """Estimate of the vertical forces on the soles; `update` processes one state."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._weight, self._armature = model.mass * GRAVITY, Drive.of(config, model).armature
        self._time = -math.inf
        self._dq, self._acceleration = np.zeros((2, model.n))
        self._loads = np.zeros(2)

    def update(self, kin: Kinematics, state: State) -> Array | None:
        """Return the forces on the left and on the right sole, shape (2,) [N]; None if they are not known.

        Those that sensors measure are only filtered; others are estimated from torques and velocities.

        Parameters
        ----------
        kin : Kinematics
            At the state, in the frame of either sole.
        state : State
            The same state may be given again.
        """
        model, tree, dt = kin.model, kin.tree, state.time - self._time
        if state.forces is not None:
            dt = dt if 0.0 <= dt <= _GAP else math.inf
            self._time, self._loads = state.time, _filtered(self._loads, state.forces, dt, self._weight)
            return self._loads
        if state.effort is None or state.dq is None or not np.isfinite(state.effort).all():
            return None
        moves = (tree.moves[tree.frames[frame][0]] for frame in (model.pelvis, kin.swing))
        soles = model.soles[kin.base].center, kin.point(kin.swing, model.soles[kin.base.other].center)
        if not 0.0 <= dt <= _GAP:
            dt, self._dq, self._acceleration = math.inf, state.dq, np.zeros(model.n)
        self._acceleration = _accelerated(self._acceleration, self._dq, state.dq, dt)
        self._loads = _loaded(
            self._loads, kin.base is Foot.RIGHT, dt, kin.lines, kin.com, kin.com_jacobian, kin.up, *moves, *soles,
            self._weight, self._armature, self._acceleration, state.effort,
        )  # fmt: skip
        self._time, self._dq = state.time, state.dq
        return self._loads


@jit
def _approach(dt: float) -> float:
    """Return the part of the way to a new value that the filters go in `dt` [s]; all of it at the beginning."""
    return 1.0 if dt == math.inf else dt / (_SMOOTH + dt)


@jit
def _accelerated(acceleration: Array, before: Array, dq: Array, dt: float) -> Array:
    """Return the filtered acceleration (n,) after the velocities changed from `before` to `dq` (n,) in `dt` [s]."""
    gained = (dq - before) / dt if 0.0 < dt < math.inf else np.zeros(dq.shape[0])
    filtered: Array = acceleration + _approach(dt) * (gained - acceleration)
    return filtered


@jit
def _loaded(
    loads: Array, right: bool, dt: float, lines: Array, com: Array, J_com: Array, up: Array, pelvis: Mask, other: Mask,
    at_base: Array, at_other: Array, weight: float, armature: Array, acceleration: Array, effort: Array,
) -> Array:  # fmt: skip
    """Return the filtered loads (2,) of both feet; `right` is whether the right one is the base. See `_forces`."""
    tau = effort - armature * acceleration
    forces = _forces(lines, com, J_com, up, pelvis, other, at_base, at_other, weight, tau)
    filtered: Array = _filtered(loads, np.array([forces[1], forces[0]]) if right else forces, dt, weight)
    return filtered


@jit
def _filtered(loads: Array, now: Array, dt: float, weight: float) -> Array:
    """Return the loads (2,) after the forces `now` (2,) [N], of which a sole only pushes."""
    filtered: Array = loads + _approach(dt) * (np.minimum(np.maximum(now, 0.0), _MOST * weight) - loads)
    return filtered


@jit
def _forces(
    lines: Array, com: Array, J_com: Array, up: Array, pelvis: Mask, other: Mask, at_base: Array, at_other: Array,
    weight: float, tau: Array,
) -> Array:  # fmt: skip
    """Return the vertical forces [N] on the base sole and on the other one, from the torques `tau` (n,) [N m].

    `pelvis` and `other` (n,) are whether a joint moves the pelvis and the other sole, `at_base` and `at_other` (3,) the
    centres of the soles, and `weight` [N] is that of the robot. For the leg of the base sole all motions are relative
    to the pelvis, too: a joint that moves all other links by the velocity v moves those below it by -v.
    """
    forces, sizes = np.zeros(2), np.zeros(2)
    for i in range(lines.shape[0]):
        axis, m = lines[i, :3], lines[i, 3:]
        if not other[i]:
            continue  # trunk and arms
        along = up[0] * J_com[0, i] + up[1] * J_com[1, i] + up[2] * J_com[2, i]
        if pelvis[i]:
            k, J = 0, -(up @ (np.cross(axis, at_base) + m))
            g = weight * (along - up @ (np.cross(axis, com) + m))
        else:
            k, J = 1, up @ (np.cross(axis, at_other) + m)
            g = weight * along
        forces[k] += J * (g - tau[i])
        sizes[k] += J * J
    return forces / np.maximum(sizes, 1e-9)
