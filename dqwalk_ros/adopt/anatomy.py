"""What is what in a robot description: legs, forward, soles, pelvis, torso, hands, inertial sensor.

Everything is read off the zero posture (joints whose range excludes zero stand at the nearest limit): the legs are the
two chains that mirror each other and reach the ground; ahead is where the knees bend to and the feet are longer, unless
the names of left and right say otherwise; a sole is the largest rectangle in the plane on which a foot stands.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.adopt.skeleton import Evidence, Points, Skeleton
from dqwalk_ros.adopt.soles import FoundSole, find_soles, foot_links, plane_below
from dqwalk_ros.errors import ModelError
from dqwalk_ros.robot import Foot
from dqwalk_ros.shapes import Shapes
from dqwalk_ros.urdf import Urdf

__all__ = ["Anatomy", "find_anatomy"]

Array = NDArray[np.float64]

_NEAR_FLOOR = 0.03
"""A foot is no higher above the lowest point than this part of the robot's height."""
_TOUCHES = 0.006
"""Two bodies touch the ground together if their lowest points differ by less than this part of the height."""
_ASYMMETRY = 0.02
"""Left and right joints mirror each other to this part of the length of a leg."""


@dataclass(frozen=True)
class Anatomy:
    """The parts of a biped.

    Attributes
    ----------
    turn : ndarray, shape (3, 3)
        Axes of the robot (x ahead, y left, z up) in the axes of the root link, as rows.
    legs : dict of Foot to tuple of str
        Joints from the hip to the ankle.
    kinds : str
        What they turn: R, P and Y for roll, pitch and yaw, such as ``YRPPPR``.
    soles : dict of Foot to FoundSole
    pelvis, torso, imu : str
        Links.
    hands : dict of Foot to str
        Links at the ends of the arms; empty without arms.
    waist : tuple of str
        Joints between the pelvis and the torso.
    toes : tuple of str
        Joints within the feet.
    leg : float
        Height of the hips above the soles [m].
    evidence : tuple of Evidence
    """

    turn: Array
    legs: dict[Foot, tuple[str, ...]]
    kinds: str
    soles: dict[Foot, FoundSole]
    pelvis: str
    torso: str
    imu: str
    hands: dict[Foot, str]
    waist: tuple[str, ...]
    toes: tuple[str, ...]
    leg: float
    evidence: tuple[Evidence, ...]


def find_anatomy(
    urdf: Urdf,
    shapes: Shapes,
    *,
    left: str = "",
    right: str = "",
    forward: str = "",
) -> Anatomy:
    """Find the parts of a biped.

    Parameters
    ----------
    urdf : Urdf
    shapes : Shapes
    left, right : str
        Links of the feet, where they are known.
    forward : str
        ``+x``, ``-x``, ``+y`` or ``-y`` of the root link, where it is known.

    Raises
    ------
    ModelError
        If it is no biped that stands on flat soles, in one sentence.
    """
    points = Points(shapes)
    plain = Skeleton(urdf)
    if len(plain.joints) < 6:
        raise ModelError(f"this is no biped: it has {len(plain.joints)} joints that turn")
    for name in (left, right):
        if name and name not in urdf.links:
            raise ModelError(f"there is no link '{name}'; it has {', '.join(urdf.links)}")
    problem: ModelError | None = None
    for up in _UPS:
        skeleton = Skeleton(urdf, up)
        try:
            pair = _find_legs(skeleton, points, (left, right))
        except ModelError as error:
            problem = problem or error  # what the usual axes say
            continue
        if problem is not None and not _stands(skeleton, points, pair):
            continue
        return _anatomy(urdf, points, skeleton, pair, forward, bool(left and right))
    assert problem is not None
    raise problem


def _ups() -> Iterator[Array]:
    """Yield rotations (3, 3) that turn one axis of the root link up: z as ROS has it, then the others."""
    yield np.eye(3)
    for axis, sign in ((1, 1.0), (0, 1.0), (1, -1.0), (0, -1.0)):
        up = np.zeros(3)
        up[axis] = sign
        other = np.array([0.0, 0.0, 1.0])
        yield np.array([np.cross(other, up), other, up]) if axis == 0 else np.array([other, np.cross(up, other), up])


_UPS = tuple(_ups())


def _stands(skeleton: Skeleton, points: Points, pair: tuple[str, str]) -> bool:
    """Tell whether legs found with an unusual axis up carry the robot: level feet, and the CoM well above them."""
    for ankle in pair:
        found, _ = points.of(skeleton, foot_links(skeleton, ankle))
        if found is None or plane_below(found)[0][2] < 1.0:
            return False
    feet = 0.5 * (skeleton.place(pair[0]) + skeleton.place(pair[1]))
    com = skeleton.com(list(skeleton.bodies))
    way = com - feet
    return bool(way[2] > 2.0 * math.hypot(way[0], way[1]))


# ---------------------------------------------------------------------- legs


def _find_legs(skeleton: Skeleton, points: Points, given: tuple[str, str]) -> tuple[str, str]:
    """Return the last joints of the two legs."""
    if all(given):
        a, b = (skeleton.body(link) for link in given)
        if not a or not b or a == b:
            raise ModelError(f"'{given[0]}' and '{given[1]}' are no feet: no two chains of joints end there")
        return a, b
    lowest: dict[str, float] = {}
    for body, links in skeleton.bodies.items():
        found, _ = points.of(skeleton, links)
        if found is not None:
            lowest[body] = float(found[:, 2].min())
    if not any(lowest.get(body) is not None for body in skeleton.joints):
        raise ModelError(
            "no moving part has a shape that can be read, so no sole can be found: give --left and --right"
        )
    floor = min(lowest.values())
    top = max(pose[2, 3] for pose in map(skeleton.pose, skeleton.urdf.links))
    height = max(top - floor, 1e-3)
    near = {body for body, z in lowest.items() if z < floor + _NEAR_FLOOR * height}
    feet = []
    for body in sorted(near - {""}, key=lambda body: (lowest[body], body)):
        way = skeleton.way(body)
        if not (len(way) > 1 and _is_toe(skeleton, way[-2], body, lowest, floor, height)):
            feet.append(body)
    feet = [body for body in feet if not any(body in skeleton.way(other)[:-1] for other in feet)]
    feet = _without_doubles(skeleton, feet, height)
    if len(feet) > 2 and all(len(skeleton.way(body)) < 3 for body in feet):
        raise ModelError(f"this is no biped: {len(feet)} legs reach the ground, with fewer than 3 joints each")
    long_enough = [body for body in feet if len(skeleton.way(body)) >= 3]
    pairs = [(a, b) for a, b in itertools.combinations(long_enough, 2) if _mirrored(skeleton, *_own(skeleton, a, b))]
    if pairs and not any(_carries(skeleton, _own(skeleton, *pair)) for pair in pairs):
        raise ModelError("this is no biped: what reaches lowest hangs from the top of the robot, as arms do")
    if "" in near:
        raise ModelError("this is no biped: it stands on its base, not on legs")
    if len(long_enough) > 2:
        raise ModelError(
            f"this is no biped: {len(long_enough)} legs reach the ground ({', '.join(long_enough)}); "
            "if it is one, name its feet by --left and --right"
        )
    if not pairs:
        what = (
            f"only {', '.join(map(repr, long_enough))} reaches the ground"
            if long_enough
            else "no leg reaches the ground"
        )
        raise ModelError(
            f"this is no biped: no two chains of joints that mirror each other stand on the ground in the zero posture "
            f"({what}); name its feet by --left and --right"
        )
    return pairs[0]


def _is_toe(skeleton: Skeleton, foot: str, body: str, lowest: dict[str, float], floor: float, height: float) -> bool:
    """Tell whether a body is the toe of a foot: that stands as well, and the joint between both is low and ahead."""
    way = skeleton.place(body) - skeleton.place(foot)
    stands = lowest.get(foot, math.inf) < lowest[body] + _TOUCHES * height
    low = skeleton.place(body)[2] < floor + 2.0 * _NEAR_FLOOR * height
    return bool(stands and low and math.hypot(way[0], way[1]) > 0.02 * height)


def _without_doubles(skeleton: Skeleton, feet: list[str], height: float) -> list[str]:
    """Return one foot of those at the same place: legs of parallel bars are described as chains side by side."""
    kept: list[str] = []
    for foot in sorted(feet, key=lambda body: (-skeleton.mass(body), -len(skeleton.way(body)), body)):
        if all(np.linalg.norm(skeleton.place(foot) - skeleton.place(other)) > 0.03 * height for other in kept):
            kept.append(foot)
    return kept


def _own(skeleton: Skeleton, a: str, b: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints of two chains from where they part."""
    first, second = skeleton.way(a), skeleton.way(b)
    k = 0
    while k < min(len(first), len(second)) and first[k] == second[k]:
        k += 1
    return first[k:], second[k:]


def _mirrored(skeleton: Skeleton, a: Sequence[str], b: Sequence[str]) -> bool:
    if len(a) != len(b) or len(a) < 3:
        return False
    p, q = (np.array([skeleton.place(joint) for joint in leg]) for leg in (a, b))
    size = float(np.ptp(np.concatenate([p, q])[:, 2]))
    apart = p - q
    across = np.median(apart, axis=0)
    across[2] = 0.0
    length = float(np.linalg.norm(across))
    if length < 1e-3:
        return False
    across /= length
    off = apart - np.outer(apart @ across, across)
    axes = np.array([skeleton.axis(joint) for joint in a])
    off -= np.sum(off * axes, axis=1)[:, None] * axes  # where a joint is along its own axis makes no difference
    middle = (0.5 * (p + q)) @ across
    tolerance = max(0.006, _ASYMMETRY * size)
    return bool(np.abs(off).max() < tolerance and np.ptp(middle) < tolerance and size > 0.0)


def _carries(skeleton: Skeleton, legs: tuple[tuple[str, ...], tuple[str, ...]]) -> bool:
    """Tell whether the rest of the robot is above these legs rather than below their hips."""
    rest = [body for body in skeleton.bodies if not set(skeleton.way(body)) & {*legs[0], *legs[1]}]
    hip, ankle = (0.5 * (skeleton.place(legs[0][k]) + skeleton.place(legs[1][k]))[2] for k in (0, -1))
    if not sum(map(skeleton.mass, rest)) > 0.0:
        return True
    return bool(skeleton.com(rest)[2] > hip - 0.12 * (hip - ankle))


# ---------------------------------------------------------------------- the rest of the robot


def _anatomy(
    urdf: Urdf, points: Points, skeleton: Skeleton, pair: tuple[str, str], forward: str, told: bool
) -> Anatomy:
    one, two = _own(skeleton, *pair)
    if len(one) < 4:
        raise ModelError(
            f"this biped has {len(one)} joints in a leg: too few to keep a sole flat on the ground while it walks"
        )
    evidence: list[Evidence] = []
    up = skeleton.pose(urdf.root)[:3, :3]  # root's axes -> axes with z up
    yaw, one, two = _ahead(skeleton, points, one, two, forward, evidence)
    skeleton = Skeleton(urdf, yaw @ up)
    legs = {Foot.LEFT: one, Foot.RIGHT: two}
    evidence.insert(
        0,
        Evidence(
            "legs",
            f"{' '.join(one)} | {' '.join(two)}",
            "named by --left and --right" if told else "the chains that mirror each other and reach the ground",
        ),
    )
    kinds = "".join(_kind(skeleton.axis(joint)) for joint in one)
    evidence.append(Evidence("axes of a leg", kinds, "axes of its joints: roll, pitch, yaw"))
    hip, ankle = (0.5 * (skeleton.place(one[k]) + skeleton.place(two[k])) for k in (0, -1))
    soles, toes = find_soles(skeleton, points, legs, float(hip[2] - ankle[2]), evidence)
    ground = float(np.mean([(skeleton.pose(s.link) @ s.pose)[2, 3] for s in soles.values()]))
    leg = float(hip[2] - ground)
    pelvis_body = skeleton.body(urdf.joints[one[0]].parent)
    parents = {urdf.joints[leg[0]].parent for leg in legs.values()}
    pelvis = parents.pop() if len(parents) == 1 else skeleton.heaviest(pelvis_body)
    evidence.append(Evidence("pelvis", pelvis, "link that carries both legs"))
    hands, torso_body = _hands(skeleton, {*one, *two}, pelvis_body)
    torso = skeleton.heaviest(torso_body)
    evidence.append(
        Evidence("torso", torso, "body that carries both arms" if hands else "heaviest body above the legs")
    )
    if hands:
        evidence.append(Evidence("hands", f"{hands[Foot.LEFT]}, {hands[Foot.RIGHT]}", "ends of the arms", "likely"))
    waist = tuple(joint for joint in skeleton.way(torso_body) if joint not in skeleton.way(pelvis_body))
    imu = _imu(skeleton, pelvis_body, torso_body)
    evidence.append(
        Evidence(
            "inertial sensor",
            imu or pelvis,
            "link named so" if imu else "the pelvis: no link is named so",
            "sure" if imu else "guess",
        )
    )
    return Anatomy(yaw @ up, legs, kinds, soles, pelvis, torso, imu, hands, waist, toes, leg, tuple(evidence))


def _kind(axis: Array) -> str:
    return "RPY"[int(np.argmax(np.abs(axis)))]


def _side_of_names(skeleton: Skeleton, one: Sequence[str], two: Sequence[str]) -> int:
    """Return 1 if the names say that `one` is the left leg, -1 if the right, 0 if they say nothing."""
    votes = 0
    joints = skeleton.urdf.joints
    names = [(a, b) for a, b in zip(one, two, strict=True)]
    names += [(joints[a].child, joints[b].child) for a, b in names]
    for a, b in names:
        letters = _difference(a, b)
        if letters is not None:
            first, second = letters
            if first.startswith("l") and second.startswith("r"):
                votes += 1
            elif first.startswith("r") and second.startswith("l"):
                votes -= 1
    return int(np.sign(votes))


def _difference(a: str, b: str) -> tuple[str, str] | None:
    """Return the words in which two names differ, from their first to their last difference, in small letters."""
    start = 0
    while start < min(len(a), len(b)) and a[start] == b[start]:
        start += 1
    end = 0
    while end < min(len(a), len(b)) - start and a[-1 - end] == b[-1 - end]:
        end += 1
    first, second = a[start : len(a) - end].lower(), b[start : len(b) - end].lower()
    pairs = {("l", "r"), ("left", "right"), ("lef", "righ"), ("lft", "rgt"), ("lt", "rt")}
    return (first, second) if (first, second) in pairs or (second, first) in pairs else None


def _ahead(
    skeleton: Skeleton,
    points: Points,
    one: tuple[str, ...],
    two: tuple[str, ...],
    forward: str,
    evidence: list[Evidence],
) -> tuple[Array, tuple[str, ...], tuple[str, ...]]:
    """Return the rotation (3, 3) that turns ahead to x, and the left and the right leg."""
    across = np.median([skeleton.place(a) - skeleton.place(b) for a, b in zip(one, two, strict=True)], axis=0)
    across[2] = 0.0
    across /= np.linalg.norm(across)
    ahead = np.array([across[1], -across[0], 0.0])  # if `one` is the left leg
    root = skeleton.pose(skeleton.urdf.root)[:3, :3]
    votes: list[tuple[float, str]] = []  # > 0: `one` is the left leg
    names = _side_of_names(skeleton, one, two)
    if names:
        votes.append((3.0 * names, "the names of left and right"))
    knee = _knee(skeleton, one, two, ahead)
    if knee:
        votes.append((2.0 * knee, "the way the knees bend"))
    longer = _longer(skeleton, points, one, two, ahead)
    if longer:
        votes.append((longer, "the feet, which are longer ahead of the ankle"))
    usual = float(ahead @ root[:, 0])
    if abs(usual) > 0.9:
        votes.append((1.5 * np.sign(usual), "x of the root link, as REP-103 has it"))
    if forward:
        sign, axis = (-1.0 if forward[0] == "-" else 1.0), "xyz".index(forward[-1])
        told = float(sign * root[:, axis] @ ahead)
        if abs(told) < 0.9:
            raise ModelError(f"{forward} of the root link is across the legs, not ahead: give another --forward")
        total, source, confidence = told, "given by --forward", "sure"
    else:
        total = sum(weight for weight, _ in votes)
        if total == 0.0:
            raise ModelError("nothing says which way is ahead: give --forward, +x or -x of the root link")
        agree = [text for weight, text in votes if weight * total > 0.0]
        against = [text for weight, text in votes if weight * total < 0.0]
        source = ", ".join(agree) + (f"; against it: {', '.join(against)}" if against else "")
        confidence = "sure" if abs(total) >= 3.0 and not against else "likely" if abs(total) >= 2.0 else "guess"
    if total < 0.0:
        ahead, one, two = -ahead, two, one
    where = root.T @ ahead
    axis = int(np.argmax(np.abs(where)))
    exact = abs(where[axis]) > 0.99
    name = f"{'+' if where[axis] > 0 else '-'}{'xyz'[axis]}" if exact else str(where.round(3).tolist())
    evidence.append(Evidence("ahead", f"{name} of {skeleton.urdf.root}", source, confidence))
    if exact:
        ahead = root @ np.eye(3)[axis] * np.sign(where[axis])
    x, y, _ = ahead / np.linalg.norm(ahead)
    return np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]]), one, two


def _knee(skeleton: Skeleton, one: Sequence[str], two: Sequence[str], ahead: Array) -> float:
    """Return 1 if the knees bend so that they point along `ahead`, -1 if the other way, 0 if they bend both ways."""
    across = np.array([-ahead[1], ahead[0], 0.0])
    out = 0.0
    for leg in (one, two):
        pitch = [joint for joint in leg if abs(skeleton.axis(joint) @ across) > 0.8]
        if len(pitch) < 3:
            return 0.0
        heights = [skeleton.place(joint)[2] for joint in pitch]
        middle = 0.5 * (heights[0] + heights[-1])
        knee = min(pitch[1:-1], key=lambda joint: abs(skeleton.place(joint)[2] - middle))
        joint = skeleton.joints[knee]
        if not math.isfinite(joint.lower + joint.upper):
            return 0.0
        lean = joint.lower + joint.upper
        if abs(lean) < 0.3 * (joint.upper - joint.lower):
            return 0.0
        shank = skeleton.place(pitch[-1]) - skeleton.place(knee)
        moved = np.cross(math.copysign(1.0, lean) * skeleton.axis(knee), shank)
        out += -math.copysign(0.5, float(moved @ ahead))  # the shank goes back where the knee points ahead
    return out if abs(out) == 1.0 else 0.0


def _longer(skeleton: Skeleton, points: Points, one: Sequence[str], two: Sequence[str], ahead: Array) -> float:
    """Return up to 1 if the feet are longer ahead of their ankles, down to -1 if behind, 0 if that says nothing."""
    reach = []
    for leg in (one, two):
        found, _ = points.of(skeleton, foot_links(skeleton, leg[-1]))
        if found is None:
            return 0.0
        low = found[found[:, 2] < found[:, 2].min() + 0.02]
        along = (low - skeleton.place(leg[-1])) @ ahead
        reach.append((float(along.max()), float(-along.min())))
    front, back = np.mean(reach, axis=0)
    if min(front, back) <= 0.0:
        return float(np.sign(front - back))
    ratio = math.log(front / back)
    return 0.0 if abs(ratio) < math.log(1.15) else float(np.clip(ratio / math.log(1.6), -1.0, 1.0))


# ---------------------------------------------------------------------- arms and sensors


def _hands(skeleton: Skeleton, legs: set[str], pelvis: str) -> tuple[dict[Foot, str], str]:
    """Return the ends of the arms, and the body that carries them."""
    carried: dict[str, list[str]] = {}
    for body in skeleton.joints:
        carried.setdefault(skeleton.way(body)[-2] if len(skeleton.way(body)) > 1 else "", []).append(body)
    led = {joint.mimic for joint in skeleton.urdf.joints.values() if joint.mimic}
    arms: list[tuple[float, tuple[str, ...], tuple[str, ...]]] = []
    for siblings in carried.values():
        free = [body for body in siblings if body not in legs]
        for a, b in itertools.combinations(free, 2):
            first, second = (_straight(carried, led, body) for body in (a, b))
            if len(first) == len(second) and _mirrored_arms(skeleton, first, second):
                reach = float(np.linalg.norm(skeleton.place(first[-1]) - skeleton.place(first[0])))
                arms.append((reach, first, second))
    others = [body for body in skeleton.bodies if not set(skeleton.way(body)) & legs]
    if not arms:
        return {}, max(others, key=skeleton.mass) if others else pelvis
    _, first, second = max(arms)
    if skeleton.place(first[-1])[1] < skeleton.place(second[-1])[1]:
        first, second = second, first
    way = skeleton.way(first[0])
    hands = {foot: skeleton.joints[arm[-1]].child for foot, arm in ((Foot.LEFT, first), (Foot.RIGHT, second))}
    return hands, way[-2] if len(way) > 1 else ""


def _straight(carried: dict[str, list[str]], led: set[str], body: str) -> tuple[str, ...]:
    """Return the chain from a body on, up to where it branches or ends, or fingers follow a joint."""
    chain = [body]
    while len(carried.get(chain[-1], ())) == 1 and carried[chain[-1]][0] not in led:
        chain += carried[chain[-1]]
    return tuple(chain)


def _mirrored_arms(skeleton: Skeleton, a: Sequence[str], b: Sequence[str]) -> bool:
    if len(a) < 2:
        return False
    p, q = (np.array([skeleton.place(joint) for joint in arm]) for arm in (a, b))
    size = float(np.ptp(np.concatenate([p, q]), axis=0).max())
    return bool(np.abs(p * [1.0, -1.0, 1.0] - q)[:, [0, 2]].max() < 0.05 * size and p[-1, 1] * q[-1, 1] < 0.0)


_IMU = re.compile(r"(?<![a-z])(imu|gyro|accelerometer|ahrs|inertial)(?![a-z])", re.IGNORECASE)


def _imu(skeleton: Skeleton, pelvis: str, torso: str) -> str:
    """Return a link that is named like an inertial sensor: of the pelvis, else of the torso; or nothing."""
    for body in (pelvis, torso):
        named = [link for link in skeleton.bodies[body] if _IMU.search(link)]
        if named:
            return min(named, key=len)
    return ""
