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
from typing import NamedTuple

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import PLACE, Kinematics, Place, jacobian_column, point_at, support_tree
from dqwalk_ros.paper.state import State
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.support.arrays import Array, Mask
from dqwalk_ros.support.by_address import BOOLEAN, BOOLEANS, FLOAT, VECTOR, Record
from dqwalk_ros.support.compiled import jit

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


class _Legs(NamedTuple):
    """Both legs, seen from a base sole, and what is known of their joints."""

    right: bool
    """Whether the base sole is the right one."""
    pelvis: Mask
    """Whether a joint moves the pelvis, shape (n,)."""
    center: Array
    other_center: Array
    """Centres of the base sole and of the other one in their frames, shape (3,) [m]."""
    other: Place
    """Of the other sole."""
    weight: float
    """Of the robot [N]."""
    armature: Array
    """Inertia of the rotors, shape (n,) [kg m^2]."""
    acceleration: Array
    """Filtered acceleration of the joints, shape (n,) [rad/s^2]."""


_LEGS = Record(_Legs, BOOLEAN, BOOLEANS, VECTOR, VECTOR, PLACE, FLOAT, VECTOR, VECTOR)
_opened = _LEGS.opened


class FootLoads:
    """Estimate of the vertical forces on the soles; `update` processes one state."""

    def __init__(self, config: Config, model: RobotModel) -> None:
        self._weight, armature = model.mass * GRAVITY, Drive.of(config, model).armature
        acceleration, self._legs = np.zeros(model.n), {}
        for base in Foot:
            tree, sole, other = support_tree(model, base), model.soles[base], model.soles[base.other]
            pelvis, place = tree.frames[model.pelvis].moves, tree.frames[other.frame]
            given = self._weight, armature, acceleration
            self._legs[base] = _Legs(base is Foot.RIGHT, pelvis, sole.center, other.center, place, *given)
        self._tables = {base: _LEGS.table(legs) for base, legs in self._legs.items()}
        self._time = -math.inf
        self._dq = np.zeros(model.n)
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
        passed = state.time - self._time
        dt, loads = passed if 0.0 <= passed <= _GAP else math.inf, self._loads.copy()
        if state.forces is not None:
            _filter(loads, state.forces, dt, self._weight)
        elif state.effort is not None and state.dq is not None and _estimate(
            self._tables[kin.base], loads, self._dq, state.dq, state.effort, dt,
            kin.lines, kin.com, kin.com_jacobian, kin.poses, kin.up,
        ):  # fmt: skip
            self._dq = state.dq
        else:
            return None
        self._time, self._loads = state.time, loads
        return loads


@jit
def _approach(dt: float) -> float:
    """Return the part of the way to a new value that the filters go in `dt` [s]; all of it at the beginning."""
    return 1.0 if dt == math.inf else dt / (_SMOOTH + dt)


@jit
def _estimate(
    table: Array, loads: Array, before: Array, dq: Array, effort: Array, dt: float, lines: Array, com: Array,
    J_com: Array, poses: Array, up: Array,
) -> bool:  # fmt: skip
    """Filter the accelerations of the joints, whose velocities were `before` (n,), and the loads (2,) of the feet.

    Return whether all torques are finite; otherwise nothing is changed. The `table` is that of `_Legs`.
    """
    legs = _opened(table)
    acceleration, weight = legs.acceleration, legs.weight
    if not np.isfinite(effort).all():
        return False
    if dt == math.inf:
        acceleration[:] = 0.0
    elif dt > 0.0:
        acceleration += _approach(dt) * ((dq - before) / dt - acceleration)
    at_other = point_at(poses, legs.other.body, legs.other.pose, legs.other_center)
    tau = effort - legs.armature * acceleration
    forces = _forces(lines, com, J_com, up, legs.pelvis, legs.other.moves, legs.center, at_other, weight, tau)
    _filter(loads, np.array([forces[1], forces[0]]) if legs.right else forces, dt, weight)
    return True


@jit
def _filter(loads: Array, now: Array, dt: float, weight: float) -> None:
    """Filter the loads (2,) with the forces `now` (2,) [N], of which a sole only pushes."""
    loads += _approach(dt) * (np.minimum(np.maximum(now, 0.0), _MOST * weight) - loads)


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
    forces, sizes, v = np.zeros(2), np.zeros(2), np.empty(3)
    for i in range(lines.shape[0]):
        if not other[i]:
            continue  # trunk and arms
        along = up[0] * J_com[0, i] + up[1] * J_com[1, i] + up[2] * J_com[2, i]
        jacobian_column(lines[i], at_base if pelvis[i] else at_other, 1.0, v)
        if pelvis[i]:
            k, J = 0, -(up @ v)
            jacobian_column(lines[i], com, 1.0, v)
            g = weight * (along - up @ v)
        else:
            k, J = 1, up @ v
            g = weight * along
        forces[k] += J * (g - tau[i])
        sizes[k] += J * J
    return forces / np.maximum(sizes, 1e-9)
