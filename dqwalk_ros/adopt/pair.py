"""Finds the two legs of a biped, and what is up.

The axes of the root link are not those of the robot: another one may be up, or none if the description has it tilted.
The plane in which the legs mirror each other shows what is lateral, and level soles below straight legs what is up.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from dqwalk_ros.adopt.legs import axes_differ, leg_of
from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.adopt.soles import foot_links, plane_below
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.geometry import X, Y, Z, angle_of
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_NEAR_FLOOR = 0.03
"""Largest height of a foot above the lowest point, as a fraction of the robot's height."""
_TOUCHES = 0.006
"""Largest difference of the lowest points of two bodies that both touch the ground, as a fraction of the height."""
_ACROSS = 0.5
"""Largest cosine of the axis of a toe to the way from ankle to toe, and of that of a wheel to the vertical; least slope
of the way from ankle to toe to the vertical."""
_ROUND = 0.85
"""Least radius of a wheel, as a fraction of its largest one."""
_ASYMMETRY = 0.02
"""Tolerance of the symmetry of left and right joints, as a fraction of the length of a leg."""
_TURNED = 45.0
"""Angle of the axis of a joint to the mirror image of the other one above which one of them is wrong [degrees]."""
_PART = 0.25
"""Part of an asymmetry, and of its tolerance, below which it does not tell directions apart."""
_SIDEWAYS = 0.5
"""Least horizontal part of the way from leg to leg."""
_NEARLY = 3.0
"""Difference of two chains, in parts of what is allowed, below which an error about them says more than one of z up."""
_LEAST_JOINTS = 4
"""Least number of joints of legs by which another axis of the root link than z may be up."""
_LEANS = 0.1
"""Least angle of soles and legs to an axis of the root link with which this axis is not up [rad]."""
_AGREE = 0.5
"""Largest difference of the angles of soles and legs that agree, as a fraction of the lesser one."""
_UPS = tuple(np.array(rows) for rows in ((X, Y, Z), (Z, X, Y), (Y, Z, X), (Z, -X, -Y), (-Y, Z, -X), (X, -Y, -Z)))
"""Rotations (3, 3) that make an axis of the root link vertical: z first (REP-103), then the others."""


class NoLegsError(ModelError):
    """No two legs were found, in the tree with the present root link.

    Attributes
    ----------
    off : float
        How far the most similar chains that reach the ground are from mirroring each other, in parts of what is
        allowed; infinite without two.
    unlike : tuple of str
        The last links of two chains that are near enough to be legs which are built or described unlike, and how they
        differ; empty without such chains.
    """

    def __init__(self, message: str, off: float = math.inf, unlike: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.off, self.unlike = off, unlike


def find_pair(plain: Skeleton, given: tuple[str, str]) -> tuple[Skeleton, tuple[str, str]]:
    """Return the skeleton in axes with z up, and the last joints of the two legs; `given` are the feet, or empty.

    That axis of the root link is next to up with which the legs stand, or else carry the robot at all; z is the first.

    Raises
    ------
    ModelError
        If the robot is not a biped; NoLegsError if it may be one with another root link.
    """
    first: tuple[Skeleton, tuple[str, str]] | None = None  # with z up
    problems = list[ModelError]()
    for k, up in enumerate(_UPS):
        skeleton = plain.turned(up)
        try:
            pair = _find_legs(skeleton, given)
        except ModelError as error:
            problems.append(error)
            continue
        skeleton = _upright(skeleton, pair)
        if _stands(skeleton, pair):
            return skeleton, pair
        if k == 0:
            first = skeleton, pair
        elif _above(skeleton, pair) and len(branches(skeleton, *pair)[0]) >= _LEAST_JOINTS:
            problems.append(_leaning(skeleton, pair, up))
    unsure = first is not None or isinstance(problems[0], NoLegsError)
    # that of z up, unless another axis has almost two legs
    worst = min(problems, key=_how_far, default=None) if unsure else problems[0]
    if first is not None and (worst is None or _above(*first) or math.isinf(_how_far(worst))):
        return first
    assert worst is not None
    raise worst


def _how_far(problem: ModelError) -> float:
    """Return how far chains of joints are from being legs, in parts of what is allowed; infinite if not near."""
    return problem.off if isinstance(problem, NoLegsError) and problem.off < _NEARLY else math.inf


def _leaning(skeleton: Skeleton, pair: tuple[str, str], up: Array) -> NoLegsError:
    """Return the error of legs on leaning feet, with another axis of the root link `up` than z."""
    lean = max(angle_of(plane_below(found)[0][2]) for found in _feet(skeleton, pair) if found is not None)
    axis = int(np.argmax(np.abs(up[2])))
    return NoLegsError(
        f"the robot does not stand in its zero posture: with {'-' if up[2, axis] < 0 else '+'}{'xyz'[axis]} of its "
        f"root link up it has legs that end with '{pair[0]}' and '{pair[1]}', but their soles lean by "
        f"{math.degrees(lean):.0f} degrees; make them level at angles of zero",
        1.0,
    )


def _upright(skeleton: Skeleton, pair: tuple[str, str]) -> Skeleton:
    """Return the skeleton in axes in which two legs are beside each other, and upright on their soles if they can be.

    Soles alone may be tilted in the zero posture, and legs alone bent: what both agree on is up.
    """
    lateral = mirrored(skeleton, *branches(skeleton, *pair))[0]
    if lateral[2]:
        skeleton = _with_up(skeleton, Z - lateral[2] * lateral)
        lateral = np.array([*lateral[:2], 0.0]) / np.linalg.norm(lateral[:2])
    leaning = []  # of the soles and of the legs, ahead of z
    for joints in branches(skeleton, *pair):
        leg, foot = leg_of(*skeleton.lines(joints)), skeleton.points(foot_links(skeleton, joints[-1]))[0]
        if leg is None or foot is None:
            return skeleton
        ways = plane_below(foot)[0], leg.hip - leg.ankle
        leaning.append([math.atan2(np.cross(lateral, Z) @ -way, way[2]) for way in ways])
    sole, leg_line = np.mean(leaning, axis=0).tolist()
    least = min(abs(sole), abs(leg_line))
    if least < _LEANS or abs(sole - leg_line) > _AGREE * least:
        return skeleton
    return _with_up(skeleton, math.cos(sole) * Z - math.sin(sole) * np.cross(lateral, Z))


def _with_up(skeleton: Skeleton, up: Array) -> Skeleton:
    """Return the skeleton turned such that a direction (3,) of its axes is z, by the least angle."""
    return skeleton.turned(DQ.facing(up / np.linalg.norm(up)).conj().rotation_matrix() @ skeleton.turn)


def _stands(skeleton: Skeleton, pair: tuple[str, str]) -> bool:
    """Return whether two legs carry the robot in the zero posture: level feet, the CoM above them."""
    level = math.cos(_LEANS)
    return all(found is not None and plane_below(found)[0][2] >= level for found in _feet(skeleton, pair)) and _above(
        skeleton, pair
    )


def _feet(skeleton: Skeleton, pair: tuple[str, str]) -> list[Array | None]:
    """Return the corners of both feet, (N, 3) each [m]; None without a shape."""
    return [skeleton.points(foot_links(skeleton, ankle))[0] for ankle in pair]


def _above(skeleton: Skeleton, pair: tuple[str, str]) -> bool:
    """Return whether the CoM is above two feet in the zero posture."""
    feet = 0.5 * (skeleton.place(pair[0]) + skeleton.place(pair[1]))
    way = skeleton.com(list(skeleton.bodies)) - feet
    return bool(way[2] > 2.0 * math.hypot(way[0], way[1]))


def _find_legs(skeleton: Skeleton, given: tuple[str, str]) -> tuple[str, str]:
    """Return the last joints of the two legs."""
    if all(given):
        a, b = (skeleton.body(link) for link in given)
        one, two = branches(skeleton, a, b) if a and b else ((), ())
        if not one or len(one) != len(two) or not mirrored(skeleton, one, two)[0].any():
            raise ModelError(
                f"'{given[0]}' and '{given[1]}' cannot be the feet: they are not the ends of two chains of as many "
                "joints beside each other"
            )
        return a, b
    lowest, floor, height = _heights(skeleton)
    near = {body for body, z in lowest.items() if z < floor + _NEAR_FLOOR * height}
    low = [body for body in sorted(lowest) if body and lowest[body] < floor + 2.0 * _NEAR_FLOOR * height]
    if len(wheels := [body for body in low if _is_wheel(skeleton, body)]) > 1:
        raise ModelError(f"the robot does not stand on feet but on wheels: {', '.join(map(repr, wheels))} turn them")
    feet = [body for body in near - {""} if not _is_toe(skeleton, body, lowest, floor, height)]
    feet = [body for body in feet if not any(body in skeleton.way(other)[:-1] for other in feet)]
    feet = _without_duplicates(skeleton, feet, height)
    if len(feet) > 2 and all(len(skeleton.way(body)) < 3 for body in feet):
        raise ModelError(f"the robot is not a biped: {len(feet)} legs reach the ground, with fewer than 3 joints each")
    long_enough = [body for body in feet if len(skeleton.way(body)) >= 3]
    found = {pair: _difference(skeleton, *branches(skeleton, *pair)) for pair in itertools.combinations(long_enough, 2)}
    pairs = [pair for pair, different in found.items() if not different[1]]
    if pairs and not any(_is_below_body(skeleton, branches(skeleton, *pair)) for pair in pairs):
        raise ModelError(
            "the robot is not a biped: its lowest limbs are suspended from above the CoM of the rest of it, like arms; "
            "if they are legs, correct mass and <origin> in its <inertial>, or name the feet with --left and --right"
        )
    if "" in near:
        raise NoLegsError("the robot is not a biped: it stands on its base, not on legs")
    if len(long_enough) > 2:
        raise ModelError(
            f"the robot is not a biped: {len(long_enough)} legs reach the ground ({', '.join(long_enough)}); "
            "if it is a biped, name its feet with --left and --right"
        )
    if not long_enough:
        most = max(len(skeleton.way(body)) for body in feet)
        raise NoLegsError(
            f"the robot is not a biped: what reaches the ground, {', '.join(map(repr, feet))}, is carried by {most} "
            "joints at most, too few to keep a sole flat in a walk"
        )
    if len(long_enough) == 1:  # the shape of the other foot may be less deep
        (foot,) = long_enough
        others = [body for body in skeleton.joints if foot not in skeleton.way(body) and body not in skeleton.way(foot)]
        found = {(foot, body): _difference(skeleton, *branches(skeleton, foot, body)) for body in others}
        pairs = [pair for pair, different in found.items() if not different[1]]
    if not pairs:
        pair = min(found, key=lambda one: found[one], default=("", ""))
        least, what = found.get(pair, (math.inf, ""))
        if len(long_enough) == 1 and not math.isfinite(least):
            what = f"only '{long_enough[0]}' reaches the ground"
        alike = least < _NEARLY and _most_turned(skeleton, *branches(skeleton, *pair)) < _TURNED
        raise NoLegsError(
            f"the robot is not a biped: no two chains of joints that mirror each other reach the ground in the zero "
            f"posture ({what}){skeleton.lacking()}; name its feet with --left and --right",
            least,
            (*(skeleton.joints[joint].child for joint in pair), what) if alike else (),
        )
    return pairs[0]


def _heights(skeleton: Skeleton) -> tuple[dict[str, float], float, float]:
    """Return the height of the lowest point of each body with shapes, of the lowest of all, and of the robot [m].

    Raises
    ------
    ModelError
        If no moving body has a shape, or a joint is below all that have one, so that the feet are not among them.
    """
    places = {body: skeleton.points(links)[0] for body, links in skeleton.bodies.items()}
    lowest = {body: float(p[:, 2].min()) for body, p in places.items() if p is not None}
    cure = (
        f"{skeleton.lacking()}: give --package-path of a folder that has its package or the file"
        if skeleton.lacking()
        else ": add a box as <collision> to each foot"
    )
    if not lowest.keys() & skeleton.joints.keys():
        raise ModelError(f"no moving part has a shape that can be read, so the soles are unknown{cure}")
    floor = min(lowest.values())
    top = max(skeleton.pose(link).translation()[2] for link in skeleton.urdf.links)
    height = max(top - floor, 1e-3)
    deepest = min(skeleton.joints, key=lambda joint: float(skeleton.place(joint)[2]))
    if skeleton.place(deepest)[2] < floor - _NEAR_FLOOR * height:
        raise ModelError(
            f"joint '{deepest}' is below all links with a shape that can be read, so the soles are unknown{cure}"
        )
    return lowest, floor, height


def _is_wheel(skeleton: Skeleton, body: str) -> bool:
    """Return whether a body turns without end about a level axis, and is as far from it in all directions."""
    joint, corners, axis = skeleton.joints[body], skeleton.points(skeleton.bodies[body])[0], skeleton.axis(body)
    endless = joint.type == "continuous" or joint.limit.upper - joint.limit.lower > math.tau
    if corners is None or not endless or abs(axis[2]) > _ACROSS:
        return False
    across = np.cross(axis, Z) / np.linalg.norm(np.cross(axis, Z))
    angles = np.linspace(0.0, math.tau, 16, endpoint=False)
    ways = np.outer(np.cos(angles), across) + np.outer(np.sin(angles), np.cross(axis, across))
    radii = ((corners - skeleton.place(body)) @ ways.T).max(axis=0)
    return bool(radii.min() > _ROUND * radii.max() > 0.0)


def _is_toe(skeleton: Skeleton, body: str, lowest: dict[str, float], floor: float, height: float) -> bool:
    """Return whether a body is the toe of a foot: both touch the ground, and the joint between them is low.

    It is ahead of that of the foot, and turns about an axis across this way: the joint of an ankle may be as low.
    """
    if len(skeleton.way(body)) < 2:
        return False
    foot = skeleton.way(body)[-2]
    way = skeleton.place(body) - skeleton.place(foot)
    ahead = math.hypot(way[0], way[1])
    stands = lowest.get(foot, math.inf) < lowest[body] + _TOUCHES * height
    low = skeleton.place(body)[2] < floor + 2.0 * _NEAR_FLOOR * height
    across = abs(skeleton.axis(body)[:2] @ way[:2]) < _ACROSS * ahead
    return bool(stands and low and across and ahead > max(0.02 * height, _ACROSS * abs(way[2])))


def _without_duplicates(skeleton: Skeleton, feet: list[str], height: float) -> list[str]:
    """Return one foot of those at the same position: a URDF describes a leg of parallel bars as several chains."""
    kept: list[str] = []
    for foot in sorted(feet, key=lambda body: (-skeleton.mass(body), -len(skeleton.way(body)), body)):
        if all(np.linalg.norm(skeleton.place(foot) - skeleton.place(other)) > 0.03 * height for other in kept):
            kept.append(foot)
    return kept


def branches(skeleton: Skeleton, a: str, b: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints of two chains after their last common joint."""
    first, second = skeleton.way(a), skeleton.way(b)
    common = sum(joint in second for joint in first)  # a joint has one way to the root
    return first[common:], second[common:]


def _difference(skeleton: Skeleton, one: Sequence[str], two: Sequence[str]) -> tuple[float, str]:
    """Return how much two chains of joints differ, in parts of what is allowed, and how if it is more than that."""
    if len(one) != len(two):
        return math.inf, f"'{one[-1]}' ends a chain of {len(one)} joints, '{two[-1]}' one of {len(two)}"
    if len(one) < 3:
        return math.inf, f"'{one[-1]}' ends a chain of only {len(one)} joints"
    lateral, off, most = mirrored(skeleton, one, two)
    if not lateral.any():
        return math.inf, f"'{one[-1]}' and '{two[-1]}' are not beside each other"
    worst = int(np.argmax(off > 0.99 * off.max()))  # the joints below it are as far off
    apart = _most_turned(skeleton, one[worst : worst + 1], two[worst : worst + 1], lateral)
    if off[worst] >= most and apart > _TURNED:
        return float(off[worst]) / most, (
            f"the axis of '{one[worst]}' is {apart:.0f} degrees from the mirror image of that of '{two[worst]}'"
        )
    what = f"'{one[worst]}' is {1e3 * off[worst]:.3g} mm from the mirror image of '{two[worst]}', more than "
    return float(off[worst]) / most, f"{what}{1e3 * most:.3g} mm" if off[worst] >= most else ""


def _most_turned(skeleton: Skeleton, one: Sequence[str], two: Sequence[str], lateral: Array | None = None) -> float:
    """Return the largest angle of an axis to that of the other chain or to its mirror image [degrees]."""
    lateral = mirrored(skeleton, one, two)[0] if lateral is None else lateral
    a, b = (np.array([skeleton.axis(joint) for joint in joints]) for joints in (one, two))
    image = b - 2.0 * np.outer(b @ lateral, lateral)
    same = np.maximum(*(np.abs(np.sum(a * other, axis=1)) for other in (b, image)))
    return math.degrees(angle_of(same.min()))


def mirrored(skeleton: Skeleton, one: Sequence[str], two: Sequence[str]) -> tuple[Array, Array, float]:
    """Return the lateral direction of two chains of k joints, and how far they are from being mirror images or copies.

    Returns
    -------
    lateral : ndarray, shape (3,)
        Unit vector from `two` to `one`: an axis of the root link unless another horizontal one is much better, and this
        unless one with a vertical part is; zero if there is none.
    off : ndarray, shape (k,)
        Distance of each joint from the image of the other one [m].
    most : float
        Tolerance of these distances [m].
    """
    (p, a), (q, b) = skeleton.lines(one), skeleton.lines(two)
    most = max(0.006, _ASYMMETRY * float(np.ptp(np.concatenate([p, q])[:, 2])))
    way = np.median(p - q, axis=0)
    level = way * [1.0, 1.0, 0.0]
    axes = skeleton.pose(skeleton.urdf.root).rotation_matrix().T
    axis = axes[np.argmax(np.abs(axes @ level))]
    lateral, off = np.zeros(3), np.full(len(one), math.inf)
    if np.linalg.norm(level) < max(1e-3, _SIDEWAYS * float(np.linalg.norm(way))):
        return lateral, off, most
    for direction in (axis * np.sign(axis @ level) * (abs(axis[2]) < 1e-9), level, way):
        if not direction.any():
            continue
        unit = direction / np.linalg.norm(direction)
        found = axes_differ(p, a, q, b, unit)
        if off.max() > _PART * most and found.max() < _PART * off.max():
            lateral, off = unit, found
    return lateral, off, most


def _is_below_body(skeleton: Skeleton, legs: tuple[tuple[str, ...], tuple[str, ...]]) -> bool:
    """Return whether the CoM of the rest of the robot is above the hips of these legs."""
    rest = [body for body in skeleton.bodies if not set(skeleton.way(body)) & {*legs[0], *legs[1]}]
    hip, ankle = (0.5 * (skeleton.place(legs[0][k]) + skeleton.place(legs[1][k]))[2] for k in (0, -1))
    found = [leg_of(*skeleton.lines(leg)) for leg in legs]
    if found[0] and found[1]:
        hip, ankle = (0.5 * (a + b)[2] for a, b in zip(*((leg.hip, leg.ankle) for leg in found if leg), strict=True))
    if not sum(map(skeleton.mass, rest)) > 0.0:
        return True
    return bool(skeleton.com(rest)[2] > hip - 0.12 * (hip - ankle))
