"""True motion and contact of a walk in physics, and whether the robot covered the path of its steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import X
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import Phase
from dqwalk_ros.plants.base import tilt
from dqwalk_ros.report.hull import hull_margin
from dqwalk_ros.report.spans import Span
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.trace import PhysicsRecord, Trace

FALLEN = 0.6
"""Height of the pelvis over the lower sole, relative to its first one, below which the robot has fallen."""
TIPPED = np.radians(20.0)
"""Tilt of the more loaded sole above which the robot has fallen [rad]."""
WAY = 0.8
"""Least fraction of the path of its steps that a walk covers; below it, the robot stepped on the spot."""
_TOUCH = 1e-4
"""Distance beyond an edge up to which the centre of pressure counts as inside, because contacts are soft [m]."""
_UNLOADED = 1e-2
"""Load of both feet below which the robot is in the air, so that there is no centre of pressure [N]."""
_TURNED = np.radians(60.0)
"""Turn above which a circle is fitted to the path [rad]."""


def middle(soles: Mapping[Foot, Array], model: RobotModel) -> Array:
    """Return the middle between the centres of both soles with poses (..., 8), shape (..., 3) [m]."""
    centers = [DQ(soles[foot]).transform_point(model.soles[foot].center) for foot in Foot]
    return np.asarray(np.mean(centers, axis=0))


def commanded_way(steps: Iterable[Phase]) -> float:
    """Return the length of the path of the middle between the soles if each step lands on its target [m].

    Parameters
    ----------
    steps : iterable of Phase
        The single supports that ended with a landing.
    """
    way, landed, last = 0.0, None, None
    for phase in steps:
        assert phase.swing_target is not None
        if landed is None:
            kin = Kinematics(phase.model, phase.q_start, phase.base)
            before = DQ(kin.pose(kin.swing))
        else:  # usually the other foot swings; after a stance it may be the same one
            before = landed if phase.base is last else landed.conj()
        landed, last = DQ(phase.swing_target), phase.base
        way += 0.5 * float(np.linalg.norm((landed.translation() - before.translation())[:2]))
    return way


def shortfall(way: float, commanded: float) -> str:
    """Return a sentence if a walk covered too little of the path of its steps, both lengths in [m]; else ``""``."""
    short = way < WAY * commanded
    return f"the robot was stopped: its soles moved {way:.2f} m, its steps cover {commanded:.2f} m" if short else ""


@dataclass(frozen=True)
class Circle:
    """The circle of least squares through a path."""

    center: Array
    """In the world, shape (2,) [m]."""
    radius: float
    deviation: float
    """Radius, and root mean square distance of the path from the circle [m]."""

    @classmethod
    def through(cls, p: Array) -> Circle:
        """Return the circle of least squares through the points `p` (N, 2) [m]."""
        A = np.column_stack([2.0 * p, np.ones(len(p))])
        x, y, c = np.linalg.lstsq(A, (p**2).sum(axis=1), rcond=None)[0]
        center, radius = np.array([x, y]), float(np.sqrt(c + x**2 + y**2))
        off = np.linalg.norm(p - center, axis=1) - radius
        return cls(center, radius, float(np.sqrt(np.mean(off**2))))


class GroundTruth:
    """True motion and contact of a walk in physics: tilt of the soles, centre of pressure, path.

    Computed from the true pose of the pelvis, the true joint angles and the wrenches on the soles; the measured angles
    replace true ones that are missing. From the controller only the phases are used, which define the support soles.
    Series have one value per tick (N of them), in the world.

    Attributes
    ----------
    soles : dict of Foot to ndarray, shape (N, 8)
        True poses.
    com : ndarray, shape (N, 3)
        [m]
    tilt : ndarray, shape (N,)
        Of the more loaded sole [rad].
    cop_margin : ndarray, shape (N,)
        Distance of the centre of pressure to the edge of the phase's support soles, positive inside [m]; nan in the
        air.
    height : ndarray, shape (N,)
        Of the pelvis over the lower sole [m].
    stands : ndarray, shape (M, 3)
        x, y [m] and yaw [rad, unwrapped] halfway between the feet, at the start of each double support or stance and at
        the end.
    circle : Circle or None
        Fitted if the path turns far enough.
    power : ndarray, shape (N,)
        Of all joints in the period before each state, sum |tau dq| [W]; nan at the first state, and where torques were
        not recorded. It is the mean torque times the mean velocity: at a single moment, such as before each change of
        the servos' goals, the torque is not that of the period.
    work : ndarray, shape (N,)
        Sum of the positive part of each joint's power [W]: the power of servos that do not recover braking energy.
    """

    def __init__(self, trace: Trace, spans: Sequence[Span], physics: PhysicsRecord) -> None:
        self.physics, self._trace, self._spans = physics, trace, spans
        model, count = trace.model, len(trace)
        self.soles = {foot: np.empty((count, 8)) for foot in Foot}
        self.com, self.cop_margin = np.empty((count, 3)), np.full(count, np.nan)
        true_q = np.where(np.isfinite(physics.q), physics.q, trace.q)
        for span in spans:
            ticks, base = span.ticks, span.phase.base
            kins = [Kinematics(model, q, base) for q in true_q[ticks]]
            pelvis, end = (
                np.array([kin.pose(f) for kin in kins]) for f in (model.pelvis, model.soles[base.other].frame)
            )
            x = DQ(physics.pelvis[ticks]) * DQ(pelvis).conj()
            self.soles[base][ticks] = x.vec8()
            self.soles[base.other][ticks] = (x * DQ(end)).vec8()
            self.com[ticks] = x.transform_point(np.array([kin.com for kin in kins]))
            feet = tuple(Foot) if span.double else (span.phase.support,)
            poses = {foot: DQ(self.soles[foot][ticks]) for foot in feet}
            corners = [x.transform_point(c)[:, :2] for foot, x in poses.items() for c in model.soles[foot].corners]
            self.cop_margin[ticks] = hull_margin(np.stack(corners, axis=1), physics.cop[ticks, :2])
        lower = np.min([DQ(self.soles[foot]).translation()[:, 2] for foot in Foot], axis=0)
        self.height = DQ(physics.pelvis).translation()[:, 2] - lower
        self.cop_margin[~np.isfinite(physics.cop).all(axis=1)] = np.nan
        loads = np.stack([physics.wrenches[foot][:, 2] for foot in Foot], axis=1)
        tilts = np.stack([tilt(self.soles[foot]) for foot in Foot], axis=1)
        self.tilt = tilts[np.arange(count), np.argmax(np.nan_to_num(loads), axis=1)]
        self.stands = self._stands()
        turned = abs(float(self.stands[-1, 2] - self.stands[0, 2]))
        arc = turned > _TURNED and len(self.stands) > 5
        self.circle = Circle.through(self.stands[1:, :2]) if arc else None
        joints = np.full(true_q.shape, np.nan)  # power [W]
        joints[1:] = physics.effort[1:] * np.diff(true_q, axis=0) / np.diff(trace.time)[:, None]
        self.power, self.work = np.abs(joints).sum(axis=1), np.maximum(joints, 0.0).sum(axis=1)

    @property
    def way(self) -> float:
        """Length of the path of the middle between the soles, from step to step [m]."""
        return float(np.linalg.norm(np.diff(self.stands[:, :2], axis=0), axis=1).sum())

    @property
    def commanded(self) -> float:
        """Length of that path if each step lands on its target [m]."""
        return commanded_way(span.phase for span in self._spans if not span.double and span.ending is not None)

    @property
    def inside(self) -> float | None:
        """Fraction of the ticks whose centre of pressure is inside, of those that are recorded; None without any.

        Ticks in the air count as outside: their wrenches are recorded, and zero.
        """
        load = sum(self.physics.wrenches[foot][:, 2] for foot in Foot)
        known = np.isfinite(self.cop_margin) | (load < _UNLOADED)
        return float(np.mean(np.nan_to_num(self.cop_margin[known], nan=-np.inf) >= -_TOUCH)) if known.any() else None

    @property
    def fallen(self) -> bool:
        """Whether the robot fell: its pelvis is too low, or a loaded sole is tilted too far."""
        low = np.nanmin(self.height) < FALLEN * self.height[np.isfinite(self.height)][0]
        return bool(low or np.nanmax(self.tilt) > TIPPED)

    @property
    def failure(self) -> str:
        """Why a walk does not count as one that stood: it ended early, fell, or was stopped; empty if it does."""
        if self.fallen or not self._trace.finished:
            return "; ".join(self._trace.notes) or "the robot fell"
        return shortfall(self.way, self.commanded)

    @property
    def swing_load(self) -> float | None:
        """Fraction of the weight on the swing foot, the median of all ticks; None without single support."""
        parts = []
        for span in self._spans:
            if not span.double:
                feet = (span.phase.support.other, span.phase.support)
                swing, support = (self.physics.wrenches[foot][span.ticks, 2] for foot in feet)
                parts.append(swing / np.maximum(swing + support, 1e-3))
        part = np.concatenate(parts) if parts else np.empty(0)
        return float(np.nanmedian(part)) if np.isfinite(part).any() else None

    @property
    def load_error(self) -> float | None:
        """Error of the estimated fraction of the weight on the left foot, the median; None without an estimate."""
        if (loads := self._trace.loads) is None:
            return None
        true = np.stack([self.physics.wrenches[foot][:, 2] for foot in Foot], axis=1)
        estimated, real = (f[:, 0] / np.maximum(f.sum(axis=1), 1e-3) for f in (loads, true))
        error = np.abs(estimated - real)
        return float(np.nanmedian(error)) if np.isfinite(error).any() else None

    @property
    def drift(self) -> float:
        """Horizontal error of odometry at the end, relative to the first base sole [m]."""
        first, last = self._spans[0], self._spans[-1]
        true = DQ(self.soles[first.phase.base][0]).conj() * DQ(self.soles[last.phase.base][-1])
        estimated = DQ(first.record.x_odom_base).conj() * DQ(last.record.x_odom_base)
        return float(np.linalg.norm((true.translation() - estimated.translation())[:2]))

    def _stands(self) -> Array:
        ticks = [span.start for span in self._spans if span.double] + [len(self._trace) - 1]
        soles, yaws = {foot: x[ticks] for foot, x in self.soles.items()}, []
        for x in soles.values():
            ahead = DQ(x).P().Ad(DQ(X)).vec3()
            yaws.append(np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0])))
        return np.column_stack([middle(soles, self._trace.model)[:, :2], np.mean(yaws, axis=0)])
