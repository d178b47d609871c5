"""Distances between parts that both move, and between lines, as vector-field inequalities [Marinho2019, Quiroz2019].

Capsules, which are segments with a thickness, keep the bodies of a robot apart; lines and the angle between them keep
tools and the trunk in a cone; primitives that move by themselves add their velocity as the residual of [Marinho2019].
All distances except that of the cone are in [m].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import Constraint, Region
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMass, Direction, Feature, Point
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.robot.model import RobotModel

_TINY = 1e-12


@jit
def _fraction(x: float, length: float) -> float:
    """Return x / length limited to [0, 1]; 0 for a segment without length."""
    return min(max(x / length, 0.0), 1.0) if length > _TINY else 0.0


@jit
def closest_on_segments(s):  # type: ignore[no-untyped-def]
    """Return the fractions t and r at which two segments are closest: a + t (b - a) and c + r (d - c).

    The squared distance is convex in (t, r): its least value is where its gradient vanishes or else on an edge of the
    unit square, so that parallel segments and segments without length need no case of their own.

    Parameters
    ----------
    s : ndarray, shape (12,)
        The ends a, b, c and d [m].
    """
    u, v, w = s[3:6] - s[:3], s[9:] - s[6:9], s[:3] - s[6:9]
    uu, uv, vv, uw, vw = u @ u, u @ v, v @ v, u @ w, v @ w
    det = uu * vv - uv * uv
    if det > _TINY * max(uu * vv, _TINY):
        t, r = (uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det
        if 0.0 <= t <= 1.0 and 0.0 <= r <= 1.0:
            return t, r
    best, at = np.inf, (0.0, 0.0)
    for t, r in (
        (0.0, _fraction(vw, vv)),
        (1.0, _fraction(vw + uv, vv)),
        (_fraction(-uw, uu), 0.0),
        (_fraction(uv - uw, uu), 1.0),
    ):
        e = w + t * u - r * v
        if e @ e < best:
            best, at = e @ e, (t, r)
    return at


@jit
def segments_apart(ends: Array, pairs: NDArray[np.int64]) -> Array:
    """Return the distances of pairs (k, 2) of segments with the given ends (m, 6) [m], shape (k,)."""
    out = np.empty(pairs.shape[0])
    for k in range(pairs.shape[0]):
        one, other = ends[pairs[k, 0]], ends[pairs[k, 1]]
        t, r = closest_on_segments(np.concatenate((one, other)))
        w = one[:3] + t * (one[3:] - one[:3]) - other[:3] - r * (other[3:] - other[:3])
        out[k] = math.sqrt(w @ w)
    return out


@jit
def _unit(e: Array) -> tuple[float, Array]:
    """Return length and direction of e (3,); no direction, zero, where the length is zero."""
    length = math.sqrt(e @ e)
    return length, e / length if length > _TINY else np.zeros(3)


@jit
def capsules_apart(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Distance of two segments, s (12,) = (their ends), less the sum a[0] of their radii [m], and its gradient.

    At the least distance the fractions t and r do not matter to first order, so the gradient is that of fixed ones.
    """
    t, r = closest_on_segments(s)
    length, n = _unit(s[:3] + t * (s[3:6] - s[:3]) - s[6:9] - r * (s[9:] - s[6:9]))
    gradient = np.concatenate(((1.0 - t) * n, t * n, (r - 1.0) * n, -r * n))
    return np.array([length - a[0]]), gradient.reshape(1, 12), np.zeros(1)


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` [m] of the segment from `a` to `b`, both (3,) in a frame of the robot [m]."""

    frame: str
    a: Array
    b: Array
    radius: float

    @property
    def ends(self) -> tuple[Point, Point]:
        """The ends of the segment."""
        return Point(self.frame, self.a), Point(self.frame, self.b)


@dataclass(frozen=True, kw_only=True)
class CapsulesApart(Constraint):
    """Keep two bodies of the robot apart: the distance between the surfaces of their capsules [m]."""

    one: Capsule
    other: Capsule
    function = capsules_apart

    @property
    def watches(self) -> tuple[Feature, ...]:
        """The ends of both segments."""
        return (*self.one.ends, *self.other.ends)

    @cached_property
    def parameters(self) -> Array:
        """Sum of the radii, shape (1,)."""
        return np.array([self.one.radius + self.other.radius])


def capsules_in(config: Config, model: RobotModel) -> tuple[CapsulesApart, ...]:
    """Return the constraints of the section ``collision``, one per pair of links.

    Raises
    ------
    ConfigError
        If an entry is not valid, or a link has no capsule; the message names it.
    """
    c, shapes = config.collision, {}
    given: dict[str, Any] = {"eta": c.eta, "bound": c.margin, "return_speed": c.recovery, "near": c.near}
    for entry in c.capsules:
        link, _, text = (part.strip() for part in entry.partition("="))
        try:
            *ends, radius = numbers = [float(number) for number in text.split()]
        except ValueError:
            ends, radius, numbers = [], 0.0, []
        if len(numbers) != 7 or not np.isfinite(numbers).all() or radius < 0.0:
            raise ConfigError(f"collision.capsules has '{entry}'; it must be LINK=ax ay az bx by bz radius")
        shapes[link] = Capsule(link, np.array(ends[:3]), np.array(ends[3:]), radius)
    out = []
    for entry in c.pairs:
        links = tuple(part.strip() for part in entry.split("="))
        for link in links:
            if link not in model.frames:
                raise ConfigError(f"collision.pairs has '{entry}', but the robot has no link '{link}'")
            if link not in shapes:
                raise ConfigError(
                    f"collision.pairs has '{entry}', but collision.capsules has no '{link}'; "
                    "`dqwalk config CONFIG --capsules` prints those fitted to the robot's shapes"
                )
        if len(links) != 2 or model.frames[links[0]].body == model.frames[links[1]].body:
            raise ConfigError(f"collision.pairs has '{entry}'; it must be LINK=LINK, which move against each other")
        one, other = (shapes[link] for link in links)
        out.append(CapsulesApart(name=f"apart_{links[0]}_{links[1]}", one=one, other=other, **given))
    return tuple(out)


# ---------------------------------------------------------------------- lines


@jit
def lines_apart(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Distance of two lines, s (12,) = (p, l, p', l'), unit directions l and l', less a[0] [m], and its gradient.

    Parallel lines have the distance of p from the other line; there the distance has a kink, because lines that are
    not quite parallel meet far away, and the gradient is that of p.
    """
    w, l, k = s[:3] - s[6:9], s[3:6], s[9:]
    c = l @ k
    sine = 1.0 - c * c
    t = (c * (k @ w) - l @ w) / sine if sine > 1e-9 else 0.0
    r = k @ w + t * c
    length, n = _unit(w + t * l - r * k)
    gradient = np.concatenate((n, t * n, -n, -r * n))
    return np.array([length - a[0]]), gradient.reshape(1, 12), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class LinesApart(Constraint):
    """Keep two lines of the robot, such as the axes of two tools, at a distance [m], [Marinho2019] line to line."""

    point: Point
    direction: Direction
    other_point: Point
    other_direction: Direction
    distance: float
    function = lines_apart

    @cached_property
    def parameters(self) -> Array:
        """The distance, shape (1,)."""
        return np.array([self.distance])


@jit
def outside_line(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Distance of a point from a line, s (9,) = (point, p, l), unit direction l, less a[0] [m], and its gradient."""
    w = s[:3] - s[3:6]
    along = w @ s[6:]
    length, n = _unit(w - along * s[6:])
    gradient = np.concatenate((n, -n, -along * n))
    return np.array([length - a[0]]), gradient.reshape(1, 9), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PointOutsideLine(Constraint):
    """Keep a point at a distance from a line of the robot [m], [Marinho2019] line to point."""

    target: Point | CenterOfMass
    point: Point
    direction: Direction
    distance: float
    function = outside_line

    @cached_property
    def parameters(self) -> Array:
        """The distance, shape (1,)."""
        return np.array([self.distance])


@jit
def in_cone(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return 2 - 2 cos(a[3]) - |l - a[:3]|^2 of the unit direction l = s (3,), and its gradient.

    |l - l'|^2 = 2 - 2 cos(angle) is smooth where the directions are equal or opposite; the angle itself is not.
    """
    e = s - a[:3]
    return np.array([2.0 - 2.0 * math.cos(a[3]) - e @ e]), -2.0 * e.reshape(1, 3), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class AxisInCone(Constraint):
    """Keep an axis within an angle of a fixed direction, [Quiroz2019]: lean of the trunk, cone of a hand."""

    axis: Direction
    """A unit vector."""
    center: Array
    """Unit vector in the base frame, shape (3,)."""
    angle: float
    """Largest angle between them, at most pi [rad]."""
    function = in_cone
    unit = "rad"

    @cached_property
    def parameters(self) -> Array:
        """Centre and angle, shape (4,)."""
        return np.array([*self.center, self.angle])

    def margin(self, d: float) -> float:
        """Return the angle left to the cone's surface [rad]."""
        square = 2.0 - 2.0 * math.cos(self.angle) - d
        return self.angle - 2.0 * math.asin(min(0.5 * math.sqrt(max(square, 0.0)), 1.0))

    @property
    def full_margin(self) -> float:
        """The angle of the cone [rad]."""
        return self.angle


# ---------------------------------------------------------------------- moving primitives


@jit
def outside_sphere(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Distance of a point s (3,) from the centre a[:3] + elapsed a[3:6], less a[6] [m], its gradient and residual."""
    length, n = _unit(s - a[:3] - elapsed * a[3:6])
    return np.array([length - a[6]]), n.reshape(1, 3), np.array([-(n @ a[3:6])])


@dataclass(frozen=True, kw_only=True)
class PointOutsideSphere(Constraint):
    """Keep a point out of a sphere that moves at a constant velocity [m], [Marinho2019] with its residual."""

    point: Point | CenterOfMass
    center: Array
    velocity: Array
    """When the phase begins, in the base frame, shape (3,) [m, m/s]."""
    radius: float
    """[m]"""
    function = outside_sphere

    @cached_property
    def parameters(self) -> Array:
        """Centre, velocity and radius, shape (7,)."""
        return np.array([*self.center, *self.velocity, self.radius])


@jit
def over_moving_plane(s: Array, a: Array, elapsed: float) -> tuple[Array, Array, Array]:
    """Return <p - o, n> - a[0] [m] of s (9,) = (p, o, n), and its gradient."""
    w, n = s[:3] - s[3:6], s[6:]
    return np.array([w @ n - a[0]]), np.concatenate((n, -n, w)).reshape(1, 9), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PointOverMovingPlane(Constraint):
    """Keep a sphere about a point on the positive side of a plane of the robot, such as the front of the trunk [m]."""

    point: Point | CenterOfMass
    origin: Point
    """A point of the plane."""
    normal: Direction
    """A unit vector."""
    radius: float = 0.0
    """Of the sphere [m]."""
    function = over_moving_plane

    @cached_property
    def parameters(self) -> Array:
        """The radius, shape (1,)."""
        return np.array([self.radius])

    def region(self, kin: Kinematics) -> Region:
        """Return a part of the plane."""
        return Region("plane", DQ.facing(self.normal.value(kin), self.origin.value(kin)).vec8(), (0.2, 0.2))
