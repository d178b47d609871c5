"""Footstep planning: footprints beside the path of the body, moved to the nearest pose that the legs can reach."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import pose_error
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Observer, Point, Rotation
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import angle_of
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, StateError
from dqwalk_ros.walks.footprint import Footprint, flat

_LEVER = 0.1
"""Length that weights angles against distances in the search for the nearest reachable pose [m/rad]."""
_KEPT, _POSTURE = 30.0, 1e-3
"""Weights of the residuals that must vanish, and of the standing posture [m/rad], relative to the distance."""
_UPRIGHT, _FREE = [2, 3, 4], [0, 1, 5]
_FREE_WEIGHT = np.array([1.0, 1.0, _LEVER])
_SEARCHES = (60, 1e-5, False), (200, 1e-6, True)
"""Largest number of iterations of a search, change at which it ends [m], and whether its steps are curved: the second
one goes on where the first one leaves the place out of reach, as with joints at their limits. A dynamic walk, whose
steps have their time, has no second one: it does not get into postures so far from that in which it stands."""
_DAMPING = 1e-4
"""Least damping of the Levenberg-Marquardt method."""
_ROWS = 18
"""Number of the residuals before those of the posture."""
_STAIR = 1.5
"""Least height of a stair, relative to ``gait.footstep_tolerance``, up to which soles count as level."""
_BEFORE, _OVERHANG = 0.07, 0.18
"""Parts of the sole: from the toes to an obstacle before a foot climbs it, and beyond its edge when it stands on it."""
_REMEMBERED = 100
"""Largest number of steps whose landing poses are remembered: a steered walk may take another one each time."""


def stair_height(height: float, config: Config) -> float:
    """Return the height of a sole over the other one [m], 0 if both count as level: rubble is no stair."""
    return height if abs(height) > config.gait.footstep_tolerance else 0.0


def parsed(texts: Sequence[str]) -> list[tuple[float, float, float, float]]:
    """Return length, side [m], turn [rad] and height [m] of the steps in ``gait.footsteps``.

    Raises
    ------
    ConfigError
        If a text is not four numbers.
    """
    steps = []
    for text in texts:
        try:
            length, side, turn, up = map(float, text.split())
        except ValueError:
            length = side = turn = up = math.nan
        if not math.isfinite(length + side + turn + up):
            raise ConfigError(f"gait.footsteps needs 'AHEAD LEFT TURN UP' [m, m, rad, m], not '{text[:80]}'")
        steps.append((length, side, turn, up))
    return steps


class Carried(NamedTuple):
    """Where a walk has its CoM when a foot lands and when the other one lifts off."""

    share: tuple[float, float] = (0.0, 1.0)
    """Part of the way from the standing sole to the landing one, at both times."""
    height: float | None = None
    """Height over the lower sole [m]; None: any. With a height, soles may be at different heights."""


class Reached(NamedTuple):
    """The nearest footprint that the legs reach."""

    pose: Array
    """In the frame of the support sole, shape (8,)."""
    posture: Array
    """In which the swing foot lands there, shape (n,) [rad]."""
    at_limit: tuple[str, ...]
    """The joints at a limit."""
    missed: float
    """Error of what must be kept: height, roll and pitch of the sole, and the places of the CoM [m]."""


class Footsteps:
    """Plans the footprints of a walk.

    Parameters
    ----------
    posture : ndarray, shape (n,)
        The standing posture [rad].
    carried : Carried, optional
        By default as in a standing walk, over the sole that stands alone.
    """

    def __init__(self, config: Config, model: RobotModel, posture: Array, carried: Carried | None = None) -> None:
        self._model, self._carried = model, carried or Carried()
        self._q_ref = posture
        half = 0.5j * config.gait.step_width
        if not half:  # the distance in the zero posture
            kin = Kinematics(model, np.zeros(model.n), Foot.RIGHT)
            half = 0.5 * Footprint.of(kin.pose(kin.swing)).place
        self._place = {Foot.RIGHT: -half, Foot.LEFT: half}  # positions of the soles relative to the middle between them
        self._known: dict[tuple[object, ...], Array] = {}
        self.config = config

    def beside(self, support: Foot) -> Array:
        """Return the pose of the other sole with the feet side by side, in the frame of the `support` sole, (8,)."""
        return self.step(support, 0.0, 0.0, 0.0)

    def step(self, support: Foot, length: float, side: float, turn: float) -> Array:
        """Return the reachable landing pose of the swing sole, flat, in the frame of the `support` sole, shape (8,).

        The body, in the middle between the feet, moves by (length, side) [m] and turns by `turn` [rad]; the swing foot
        lands in its position relative to the moved body.
        """
        key = (support, round(length, 6), round(side, 6), round(turn, 6))
        if key not in self._known:
            if len(self._known) == _REMEMBERED:
                self._known.clear()
            self._known[key] = self.nearest(support, self.wanted(support, length, side, turn)).pose
        return self._known[key]

    def reach(self, length: float) -> tuple[float, tuple[str, ...]]:
        """Return the length of the shorter step of both feet within the reach of the legs, and the joints at a limit.

        It is 0 if a foot does not reach its place beside the other one.

        Parameters
        ----------
        length : float
            Length of the wanted step [m].
        """
        found = []
        for support in Foot:
            beside = self.wanted(support, 0.0, 0.0, 0.0)
            reached = self.nearest(support, beside)
            if self._out_of_reach(reached, beside):
                found.append((0.0, reached.at_limit))
                continue
            reached = self.nearest(support, self.wanted(support, length, 0.0, 0.0))
            found.append((float((DQ(reached.pose).translation() - DQ(beside).translation())[0]), reached.at_limit))
        return min(found, key=lambda one: abs(one[0]))

    def not_beside(self) -> str:
        """Return why a foot does not reach its place beside the other one, from which steps begin; or ``""``."""
        for support in Foot:
            beside = self.wanted(support, 0.0, 0.0, 0.0)
            if why := self._out_of_reach(self.nearest(support, beside), beside):
                return f"the place of the {support.other.value} foot beside the other one is {why}"
        return ""

    def wanted(self, support: Foot, length: float, side: float, turn: float) -> Array:
        """Return the landing pose of `step` without regard to the reach of the legs, shape (8,)."""
        return self.stride(support, length, side, turn).pose

    def stride(self, support: Foot, length: float, side: float, turn: float) -> Footprint:
        """Return `wanted` as a footprint, relative to that of `support`."""
        body = Footprint(complex(length, side) - self._place[support], cmath.rect(1.0, turn))
        return body.then(Footprint(self._place[support.other]))

    def step_to(self, support: Foot, footprint: Array) -> tuple[float, float, float]:
        """Return length, side [m] and turn [rad] of the `stride` to a footprint (8,)."""
        to = Footprint.of(footprint)
        moved = to.place - to.ahead * self._place[support.other] + self._place[support]
        return moved.real, moved.imag, cmath.phase(to.ahead)

    def planned(self, support: Foot, wanted: Sequence[Array]) -> list[Array]:
        """Return the reachable footprints (8,) nearest to commanded ones, each in the frame of its support sole.

        Parameters
        ----------
        support : Foot
            The first support foot; the feet alternate.
        wanted : sequence of ndarray, shape (8,)
            Poses, each in the frame of the footprint before it; the first one in the frame of the `support` sole.

        Raises
        ------
        StateError
            If a footprint violates a limit; the message names the footprint and the limit.
        """
        out = []
        for k, x in enumerate(wanted, start=1):
            try:
                out.append(self._allowed(support, x))
            except StateError as error:
                raise StateError(f"footstep {k}, of the {support.other.value} foot: {error}") from None
            support = support.other
        return out

    def climbing(self, stopped: Foot) -> list[Array]:
        """Return the footprints (8,) of `planned` that climb an obstacle that has stopped the foot `stopped`.

        Both feet stand a little before it; one foot steps onto it, and then the other one, completely. The assumed
        height is that of the lowest obstacle that stops a foot.

        Raises
        ------
        ConfigError
            If the legs do not reach them.
        """
        length, support, wanted = self._model.soles[stopped].length, stopped, []
        least = min(self.config.gait.step_height, self.config.gait.climb)
        for part, up in (-_BEFORE, 0.0), (0.0, 0.0), (1.0 + _BEFORE - _OVERHANG, least), (0.5, 0.0), (0.0, 0.0):
            pose = DQ(self.wanted(support, part * length, 0.0, 0.0))
            wanted.append((DQ.from_pose([0.0, 0.0, up]) * pose).vec8())
            support = support.other
        try:
            return self.planned(stopped, wanted)
        except StateError as error:
            raise ConfigError(f"gait.climb: {error}") from None

    def _allowed(self, support: Foot, wanted: Array) -> Array:
        """Return the reachable footprint nearest to a commanded one (8,); raise StateError if it violates a limit."""
        gait, s = self.config.gait, self.config.standing
        x = DQ(wanted)
        height, up = float(x.translation()[2]), float(x.rotation_matrix()[2, 2])
        if stair_height(height, self.config) and self._carried.height is None:
            raise StateError(
                f"{1e3 * height:.0f} mm above the ground, where both soles stand; a dynamic walk has stairs"
            )
        if 1.0 < abs(height) / max(gait.footstep_tolerance, 1e-9) < _STAIR:
            level = 1e3 * gait.footstep_tolerance
            raise StateError(
                f"{1e3 * height:.0f} mm above the other sole: up to {level:.0f} mm (gait.footstep_tolerance) is level, "
                f"from {_STAIR * level:.0f} mm on a stair"
            )
        if up < math.cos(gait.footstep_tolerance / s.lever):
            raise StateError(f"it leans by {math.degrees(angle_of(up)):.1f} deg; soles stand level")
        off, ahead = x.translation() - DQ(self.wanted(support, 0.0, 0.0, 0.0)).translation(), x.rotation_matrix()[:, 0]
        turn = math.atan2(ahead[1], ahead[0])
        if abs(off[0]) > gait.most_length + gait.footstep_tolerance:
            raise StateError(
                f"{off[0]:.3g} m ahead of its place beside the other; gait.most_length is {gait.most_length:g} m"
            )
        if abs(turn) > gait.most_turn + gait.footstep_tolerance / s.lever:
            raise StateError(f"turned by {turn:.3g} rad; gait.most_turn is {gait.most_turn:g} rad")
        here, there = self._model.soles[support], self._model.soles[support.other]
        side = 1.0 if support is Foot.RIGHT else -1.0
        corners = DQ(flat(wanted)).transform_point(there.corners)
        gap = float((side * (corners[:, 1] - here.center[1])).min() - 0.5 * here.width)
        if gap < s.sole_gap - 1e-9:
            raise StateError(
                f"{1e3 * gap:.0f} mm beside the other sole; standing.sole_gap is {1e3 * s.sole_gap:.0f} mm"
            )
        reached = self.nearest(support, wanted)
        if why := self._out_of_reach(reached, wanted):
            raise StateError(why)
        return reached.pose

    def _out_of_reach(self, reached: Reached, wanted: Array) -> str:
        """Return by how much and why the footprint `reached` is not that of `wanted` (8,); empty if it is."""
        most = self.config.gait.footstep_tolerance
        height = stair_height(float(DQ(wanted).translation()[2]), self.config)
        off_by = DQ(flat(wanted, height)).conj() * DQ(reached.pose)
        far = max(float(np.linalg.norm(off_by.translation())), reached.missed)
        angle = abs(float(off_by.rotation_vector()[2]))
        if max(far, self.config.standing.lever * angle) <= most:
            return ""
        where = ", ".join(f"{1e3 * v:.0f}" for v in DQ(reached.pose).translation()[:2])
        why = f"{', '.join(reached.at_limit)} at the limit" if reached.at_limit else "no free ankle joint"
        return (
            f"out of reach by {1e3 * far:.0f} mm and {math.degrees(angle):.1f} deg ({why}); the nearest is at "
            f"{where} mm in the other sole, gait.footstep_tolerance is {1e3 * most:.0f} mm"
        )

    def nearest(self, support: Foot, wanted: Array) -> Reached:
        """Return the reachable pose of the level swing sole nearest to `wanted` (8,).

        Two postures with the same footprint are computed together: that in which the swing foot lands, in a standing
        walk with the CoM over the support sole, and that in which the next double support ends, with the CoM over the
        swing sole. Large weights enforce height, roll and pitch of the footprint, the positions of the CoM, and the
        equality of both footprints.
        """
        model, n = self._model, self._model.n
        frame = model.soles[support.other].frame
        p_d, r_d = DQ(wanted).translation(), wanted[:4].copy()
        sole = Observer([Point(frame), Rotation(frame)], Kinematics(model, self._q_ref, support).tree)
        stands, lands, carried = model.soles[support].center, model.soles[support.other].center, self._carried
        level = stair_height(float(p_d[2]), self.config)
        p_d[2] = level
        tall = None if carried.height is None else carried.height + min(level, 0.0)
        q_ref = np.tile(np.clip(self._q_ref, model.q_min, model.q_max), 2)
        low, high = np.tile(model.q_min, 2), np.tile(model.q_max, 2)

        def residual(q: Array) -> tuple[Array, Array]:
            J, e = np.zeros((_ROWS + 2 * n, 2 * n)), np.zeros(_ROWS + 2 * n)
            for k in range(2):
                part, rows = slice(k * n, (k + 1) * n), slice(8 * k, 8 * k + 8)
                kin = Kinematics(model, q[part], support)
                s, J_s = sole(kin)
                off, gradient = pose_error(s, p_d, r_d, 1.0)
                turn = gradient @ J_s
                part_of_way = carried.share[k]
                center = (1.0 - part_of_way) * stands + part_of_way * kin.point(frame, lands)
                J_center = part_of_way * kin.point_jacobian(frame, lands)
                com, J_com = (kin.com - center)[:2], (kin.com_jacobian - J_center)[:2]
                if tall is not None:
                    e[16 + k], J[16 + k, part] = _KEPT * (kin.com[2] - tall), _KEPT * kin.com_jacobian[2]
                e[rows] = np.concatenate([_KEPT * off[_UPRIGHT], _FREE_WEIGHT * off[_FREE], _KEPT * com])
                J[rows, part] = np.concatenate(
                    [_KEPT * turn[_UPRIGHT], _FREE_WEIGHT[:, None] * turn[_FREE], _KEPT * J_com]
                )
            # the footprint of the second posture must be that of the first one
            e[11:14] = _KEPT * (e[11:14] - e[3:6])
            J[11:14, n:] *= _KEPT
            J[11:14, :n] = -_KEPT * J[3:6, :n]
            e[_ROWS:] = _POSTURE * (q - q_ref)
            J[_ROWS:] = _POSTURE * np.eye(2 * n)
            return e, J

        q = q_ref
        for iterations, still, curved in _SEARCHES if tall is None else _SEARCHES[:1]:
            q, e = _least_squares(residual, q, low, high, iterations, still, curved)
            at_limit = ((q <= low + 1e-6) | (q >= high - 1e-6)).reshape(2, n).any(axis=0)
            joints = tuple(model.joint_names[i] for i in np.flatnonzero(at_limit))
            kept = [0, 1, 2, 6, 7, 8, 9, 10, 14, 15, 16, 17]  # of the residuals
            missed = float(np.abs(e[kept]).max()) / _KEPT
            pose = flat(Kinematics(model, q[:n], support).pose(frame), level)
            reached = Reached(pose, q[:n], joints, missed)
            if not self._out_of_reach(reached, wanted):
                break
        return reached


def _least_squares(
    residual: Callable[[Array], tuple[Array, Array]],
    q: Array,
    low: Array,
    high: Array,
    iterations: int,
    still: float,
    curved: bool,
) -> tuple[Array, Array]:
    """Return q (m,) within its limits at the least norm of its residual, and this residual (k,).

    The Levenberg-Marquardt method with the limits as an active set; `residual` returns e (k,) and its Jacobian (k, m).
    It ends after the `iterations`, or where the residual changes by less than `still` [m]. A `curved` step is corrected
    by what the residual deviates from its linear model: much longer ones are possible then where heavy residuals must
    vanish [Transtrum & Sethna, geodesic acceleration, arXiv:1201.5885].
    """
    damping, (e, J) = _DAMPING, residual(q)
    for _ in range(iterations):
        gradient = J.T @ e
        stuck = ((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0))
        free = np.flatnonzero(~stuck)
        step = np.zeros(len(q))
        H = J[:, free].T @ J[:, free] + damping * np.eye(len(free))
        step[free] = np.linalg.solve(H, -gradient[free])
        moved = np.clip(q + step, low, high)
        e_moved, J_moved = residual(moved)
        if curved:
            step[free] = np.linalg.solve(H, -J[:, free].T @ (e_moved - e - J @ (moved - q)))
            bent = np.clip(moved + step, low, high)
            e_bent, J_bent = residual(bent)
            if e_bent @ e_bent < e_moved @ e_moved:
                moved, e_moved, J_moved = bent, e_bent, J_bent
        if e_moved @ e_moved >= e @ e:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        done = np.abs(e_moved - e)[:_ROWS].max() < still
        q, e, J, damping = moved, e_moved, J_moved, max(0.2 * damping, _DAMPING)
        if done:
            break
    return q, e
