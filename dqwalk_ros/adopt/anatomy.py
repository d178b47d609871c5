"""Identifies legs, forward direction, soles, pelvis, torso, hands and inertial sensor in a robot description.

The posture is the zero posture, with joints whose range excludes zero at their nearest limit. The legs are the two
chains that mirror each other and reach the ground. The forward direction follows from the names of left and right, the
direction in which the knees bend, the longer part of the feet, and the axes of the root link. A sole is the largest
rectangle in the plane on which a foot stands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dqwalk_ros.adopt.arms import find_hands, find_imu
from dqwalk_ros.adopt.doubts import check_density, check_one, check_sizes
from dqwalk_ros.adopt.lean import Lean, waist_moves
from dqwalk_ros.adopt.legs import Leg, bent, freedom, leg_of
from dqwalk_ros.adopt.pair import NoLegsError, branches, find_pair, mirrored
from dqwalk_ros.adopt.skeleton import Entry, Skeleton
from dqwalk_ros.adopt.soles import FoundSole, find_soles, foot_links
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import X, Y
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf, moves
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_UNLIKE = 0.5
"""Largest difference of the limits of joints that mirror each other [rad]."""
_OTHER_SERVO = 2.0
"""Largest velocity or effort limit of a joint, relative to that of the joint of the other leg."""
_STRAIGHT = 0.9
"""Least component of an axis that counts as roll, pitch or yaw."""
_LATERAL = 0.5
"""Least lateral component of the axis of a knee with which the leg steps forward."""
_SAME = 1e-3
"""Largest distance of joints at one place, as a fraction of the height of a leg."""
_FASTEST = 50.0
"""Velocity limit of a leg above which it has another unit or is none [rad/s]; that of fast legs is 20 to 40."""
_INNER = 0.5
"""Part of the way from the middle to an ankle by which the CoM must be moved: there the inner part of a sole begins."""
_CLEARANCE = 0.02
"""Half of the least gap between the soles, as a fraction of the leg length."""
_DISTANCES = 1.0, 0.87, 0.75, 0.62, 0.5, 0.4, 1.15, 1.3, 1.5, 1.75
"""Distances of the soles that are tried in this order, as fractions of that of the zero posture."""


@dataclass(frozen=True)
class Anatomy:
    """The parts of a biped."""

    turn: Array
    """Axes of the robot (x forward, y left, z up) in the axes of the root link, as rows, shape (3, 3)."""
    legs: dict[Foot, tuple[str, ...]]
    """Joints from the hip to the ankle."""
    kinds: str
    """Axes of the joints of a leg: R, P and Y for roll, pitch and yaw, S for skew ones, such as ``YRPPPR``."""
    sideways: bool
    turns: bool
    """Whether the pelvis can move sideways over both flat soles, and whether the feet can turn under it."""
    soles: dict[Foot, FoundSole]
    """The soles of both feet."""
    pelvis: str
    torso: str
    imu: str
    """Links; `imu` is empty if no link is named like an inertial sensor."""
    hands: dict[Foot, str]
    """Links at the ends of the arms; empty for a robot without arms."""
    arms: dict[Foot, tuple[str, ...]]
    """Joints from the torso to the hand; empty for a robot without arms."""
    waist: tuple[str, ...]
    """Joints between the pelvis and the torso."""
    lean: Lean | None
    """How the pelvis leans to move the CoM sideways, if neither it nor the waist can move it so."""
    leg: float
    """Height of the hips above the soles [m]."""
    hips: DQ
    """Pose of the robot's axes halfway between the hips, in the axes of the root link, in the zero posture."""
    apart: float
    """Lateral distance of the soles' centres when standing [m]: that of the zero posture, limited to a range without
    collisions if the pelvis can move sideways."""
    evidence: tuple[Entry, ...]
    """The values above, with their sources."""


def find_anatomy(
    urdf: Urdf,
    shapes: Shapes,
    *,
    left: str = "",
    right: str = "",
    forward: str = "",
) -> Anatomy:
    """Find the parts of a biped.

    `left` and `right` are the links of the feet, `forward` is the forward axis of the root link, ``+x``, ``-x``, ``+y``
    or ``-y``; they are found if empty.

    Raises
    ------
    ModelError
        If the robot is not a biped that stands on flat soles.
    """
    for name in (left, right):
        if name and name not in urdf.links:
            raise ModelError(f"there is no link '{name}'; the links are {', '.join(urdf.links)}")
    plain, root = Skeleton(urdf, shapes), urdf.root
    if len(plain.joints) < 6:
        slides = [joint.name for joint in urdf.joints.values() if joint.type == "prismatic"]
        more = f"; '{slides[0]}' is prismatic, and linear joints do not move in a walk" if slides else ""
        fixed = sum("has no range" in repair for repair in urdf.repairs)
        welded = sum(joint.type == "fixed" for joint in urdf.joints.values())
        more += f"; {welded} joints are of the type 'fixed'" if welded else ""
        more += f"; {fixed} joints have no range, their lower and upper limits are equal" if fixed else ""
        more += "".join(f"; {repair}" for repair in urdf.repairs if "all taken as fixed" in repair)
        raise ModelError(f"the robot is not a biped: it has only {len(plain.joints)} revolute joints{more}")
    check_one(urdf)
    check_sizes(plain, shapes)
    try:
        return _anatomy(*find_pair(plain, (left, right)), forward, bool(left))
    except NoLegsError as error:
        # the root may be in a leg: which link is the root is arbitrary
        for link in _forks(plain):
            urdf.reroot(link)
            shapes.forget()
            try:
                found = _anatomy(*find_pair(Skeleton(urdf, shapes), (left, right)), forward, bool(left))
            except ModelError:
                continue
            urdf.repairs.append(f"no two legs are seen from the root link '{root}': '{link}' is taken as the root")
            return found
        if not error.unlike:
            raise
        one, two, what = error.unlike
        urdf.reroot(root)
        shapes.forget()
        found = _anatomy(*find_pair(Skeleton(urdf, shapes), (one, two)), forward, False)
        unlike = Entry("symmetry of the legs", what, "an <origin> or an axis may be wrong", "guess")
        return replace(found, evidence=(*found.evidence, unlike))


def _forks(skeleton: Skeleton) -> list[str]:
    """Return the heaviest links of the bodies between two or more joints, besides the root, the heaviest body first."""
    parents = [way[-2] for way in map(skeleton.way, skeleton.joints) if len(way) > 1]
    return [skeleton.heaviest(body) for body in sorted({*parents}, key=lambda body: -skeleton.mass(body))]


# ---------------------------------------------------------------------- the rest of the robot


def _anatomy(skeleton: Skeleton, pair: tuple[str, str], forward: str, named: bool) -> Anatomy:
    """Return the parts of a biped whose legs end with the joints `pair`; `named` says that the user has named them."""
    urdf = skeleton.urdf
    _check_shapes(skeleton, pair)
    one, two = branches(skeleton, *pair)
    if _fix_knees(skeleton, one, two):
        skeleton = skeleton.turned(skeleton.turn)
        one, two = branches(skeleton, *pair)
    _check_led(skeleton, one, two)
    _check_joints(skeleton, one, two)
    up = skeleton.pose(urdf.root).rotation_matrix()  # from the root's axes to axes with z up
    yaw, one, two, ahead = _find_forward(skeleton, one, two, forward)
    skeleton = skeleton.turned(yaw @ up)
    legs = {Foot.LEFT: one, Foot.RIGHT: two}
    _check_knees(skeleton, legs)
    _turn_knee(skeleton, legs)
    left, right = (_leg(skeleton, joints) for joints in legs.values())
    hip, ankle = 0.5 * (left.hip + right.hip), 0.5 * (left.ankle + right.ankle)
    check_density(urdf, float(hip[2] - ankle[2]))
    pelvis_body = skeleton.body(urdf.joints[one[0]].parent)
    parents = {urdf.joints[leg[0]].parent for leg in legs.values()}
    pelvis = parents.pop() if len(parents) == 1 else skeleton.heaviest(pelvis_body)
    hands, torso_body = find_hands(skeleton, {*one, *two}, pelvis_body)
    waist = tuple(joint for joint in skeleton.way(torso_body) if joint not in skeleton.way(pelvis_body))
    sideways, turns = _freedom(skeleton, legs, float(hip[2] - ankle[2]))
    kinds = "".join(_kind(skeleton.axis(joint)) for joint in one)
    over = 0.5 * abs(float((left.ankle - right.ankle)[1]))
    leans = not sideways and waist_moves(skeleton, waist) < _INNER * over
    soles = find_soles(skeleton, legs, float(hip[2] - ankle[2]))
    ground = float(np.mean([sole.placed(skeleton).translation()[2] for sole in soles.values()]))
    y = [float(sole.placed(skeleton).translation()[1]) for sole in soles.values()]
    apart, height = abs(y[0] - y[1]), float(hip[2] - ground)
    if sideways:
        apart = _sole_distance(apart, abs(float((left.hip - right.hip)[1])), soles[Foot.LEFT].width, height)
    found = Anatomy(
        turn=yaw @ up,
        legs=legs,
        kinds=kinds,
        sideways=sideways,
        turns=turns,
        soles=soles,
        pelvis=pelvis,
        torso=skeleton.heaviest(torso_body),
        imu=find_imu(skeleton, pelvis_body, torso_body),
        hands=hands,
        arms={foot: tuple(j for j in skeleton.chain[hand] if j not in waist) for foot, hand in hands.items()},
        waist=waist,
        lean=Lean.of(skeleton, legs, float(hip[2])) if leans else None,
        leg=height,
        hips=skeleton.pose(urdf.root).conj() * DQ.from_pose(hip),
        apart=apart,
        evidence=(),
    )
    chosen = "given by --left and --right" if named else "the chains that mirror each other and reach the ground"
    return replace(found, evidence=_evidence(skeleton, found, chosen, ahead))


def _evidence(skeleton: Skeleton, found: Anatomy, chosen: str, ahead: Sequence[Entry]) -> tuple[Entry, ...]:
    """Return what was found, with the sources: that of the legs is `chosen`, and `ahead` are the directions."""
    legs, one, two = found.legs, *found.legs.values()
    toes = tuple(j for leg in legs.values() for j in skeleton.joints if leg[-1] in skeleton.way(j)[:-1])
    can = ((found.sideways, "move sideways over flat soles"), (found.turns, "turn the feet"))
    does = [text for does, text in can if does]
    entries = [
        Entry("legs", f"{' '.join(one)} | {' '.join(two)}", chosen),
        *ahead,
        Entry("axes of a leg", found.kinds, "axes of its joints: roll, pitch, yaw, or skew"),
        Entry(
            "locked in the legs", _locked(skeleton, legs), "joints between pelvis and foot that do not turn", "likely"
        ),
        Entry(
            "without torque limit", _without_torque_limit(skeleton, legs), "other joints of the legs have one", "guess"
        ),
        Entry("limits of the legs", _unlike_limits(skeleton, legs), "an axis or a limit is wrong", "guess"),
        Entry("velocity of the legs", _too_fast(skeleton, legs), "no servo is so fast: degrees/s, or rpm?", "guess"),
        Entry("the legs can", " and ".join(does) or "only bend", "rank of their axes with bent knees"),
        Entry(
            "sideways",
            f"the trunk leans: {1e3 * found.lean.lever:.0f} mm/rad" if found.lean else "",
            "no ankle rolls, and no waist moves the CoM over a sole",
        ),
        *(Entry(f"{foot.value} sole", str(s), s.source, s.confidence) for foot, s in found.soles.items()),
        Entry("toes", " ".join(toes), "joints carried by the ankles: locked", "likely"),
        Entry("pelvis", found.pelvis, "link that carries both legs"),
        Entry("torso", found.torso, "body that carries both arms" if found.hands else "heaviest body above the legs"),
        Entry("hands", ", ".join(found.hands.values()), "ends of the arms", "likely"),
        Entry("inertial sensor", found.imu, "link name")
        if found.imu
        else Entry("inertial sensor", found.pelvis, "pelvis: no link is named like an inertial sensor", "guess"),
    ]
    return tuple(entry for entry in entries if entry.value)


def _check_joints(skeleton: Skeleton, one: tuple[str, ...], two: tuple[str, ...]) -> None:
    """Raise ModelError if two legs have too few joints, or no knee."""
    bare = _bare_ends(skeleton, (one[-1], two[-1]))
    if len(one) < 4:
        raise ModelError(
            f"the legs that end with '{one[-1]}' and '{two[-1]}' have only {len(one)} joints, too few to keep soles "
            f"flat on the ground in a walk{bare}"
        )
    shapes = [leg_of(*skeleton.lines(joints)) for joints in (one, two)]
    if bare and not all(shapes):
        raise ModelError(f"the legs end at '{one[-1]}' and '{two[-1]}', without hip, knee and ankle{bare}")
    if not all(shapes):
        names = ", ".join(one if not shapes[0] else two)
        raise ModelError(f"this biped has a leg without knee or ankle: of {names} none bends it between hip and foot")


def _fix_knees(skeleton: Skeleton, *legs: tuple[str, ...]) -> list[str]:
    """Take the axes of knees with three, as models of humans have, as fixed but for the one along the line of the legs.

    They are returned.
    """
    lateral, fixed = mirrored(skeleton, *legs)[0], list[str]()
    for joints in legs:
        places, axes = skeleton.lines(joints)
        leg = leg_of(places, axes)
        if leg is None:
            continue
        same = np.linalg.norm(places - places[leg.knee], axis=1) < _SAME * np.ptp(places[:, 2])
        knee = [joint for joint, here in zip(joints, same, strict=True) if here]
        bends = max(knee, key=lambda joint: abs(skeleton.axis(joint) @ lateral))
        fixed += [joint for joint in knee if joint != bends] if len(knee) >= 3 else []
    for joint in fixed:
        skeleton.urdf.joints[joint].type = "fixed"
        skeleton.urdf.repairs.append(f"joint '{joint}' is one of three or more axes of a knee: taken as fixed")
    return fixed


def _check_knees(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> None:
    """Raise ModelError if the knees bend sideways."""
    knees = [joints[_leg(skeleton, joints).knee] for joints in legs.values()]
    if all(abs(skeleton.axis(knee) @ Y) >= _LATERAL for knee in knees):
        return
    # of a linkage that is described as a chain, joints beside the leg are farther from hip and ankle than the knee
    joints, knee = legs[Foot.LEFT], knees[0]
    rest = [one for one in joints if abs(skeleton.axis(one) @ skeleton.axis(knee)) < _STRAIGHT]
    leg = leg_of(*skeleton.lines(rest)) if rest else None
    if leg is not None and abs(skeleton.axis(rest[leg.knee]) @ Y) >= _LATERAL:
        chain = ", ".join(one for one in joints if one not in rest)
        raise ModelError(
            f"'{rest[leg.knee]}' bends the leg ahead, but '{knee}' is farther from hip and ankle and bends it "
            f"sideways: of {chain}, those that belong to a linkage must be fixed, or follow its motor (<mimic>)"
        )
    raise ModelError(
        f"the knees '{knees[0]}' and '{knees[1]}' bend sideways: their axes are not along the line from leg to leg"
        ", so the legs cannot step ahead; are x and y exchanged in the positions of the legs or in the axes?"
    )


def _kind(axis: Array) -> str:
    """Return R, P or Y for an axis (3,) along x, y or z, S for a skew one."""
    along = int(np.argmax(np.abs(axis)))
    return "RPY"[along] if abs(axis[along]) > _STRAIGHT else "S"


def _leg(skeleton: Skeleton, joints: Sequence[str]) -> Leg:
    leg = leg_of(*skeleton.lines(joints))
    assert leg is not None  # as before the axes were turned
    return leg


def _freedom(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]], length: float) -> tuple[bool, bool]:
    """Return whether the pelvis can move sideways over both flat soles, and whether the feet can turn."""
    angles: dict[str, float] = {}
    for joints in legs.values():
        axes, knee = skeleton.lines(joints)[1], _leg(skeleton, joints).knee
        angles |= dict(zip(joints, bent(axes, knee, Y).tolist(), strict=True))
    posed = skeleton.posed(angles)
    left, right = (posed.lines(joints) for joints in legs.values())
    return freedom((left, right), length)


def _locked(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> str:
    """Return the joints on the way to the feet that move but do not turn by themselves: sliding and led ones."""
    carrier, out = {joint.child: joint for joint in skeleton.urdf.joints.values()}, []
    for joints in legs.values():
        link = skeleton.joints[joints[-1]].parent
        while link != skeleton.joints[joints[0]].child and link in carrier:
            joint = carrier[link]
            if moves(joint) and joint.name not in skeleton.joints:
                out.append(joint.name)
            link = joint.parent
    return ", ".join(out)


def _without_torque_limit(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> str:
    """Return the joints of the legs without a torque limit, if others have one."""
    joints = [name for names in legs.values() for name in names]
    free = [name for name in joints if math.isinf(skeleton.joints[name].limit.effort)]
    return ", ".join(free) if len(free) < len(joints) else ""


def _too_fast(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> str:
    """Return the least velocity limit of the legs if no servo has it; empty if one does, or if there is none."""
    least = min(skeleton.joints[name].limit.velocity for names in legs.values() for name in names)
    return f"{least:g} rad/s at least" if _FASTEST < least < math.inf else ""


def _unlike_limits(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> str:
    """Return the joints of both legs whose limits do not mirror each other; empty if all do."""
    out = []
    for names in zip(*legs.values(), strict=True):
        (one, two), (a, b) = (skeleton.joints[name].limit for name in names), map(skeleton.axis, names)
        same = float(a * [-1.0, 1.0, -1.0] @ b)  # the mirror image of a rotation about a is one about (-x, y, -z)
        there = (two.lower, two.upper) if same > 0.0 else (-two.upper, -two.lower)
        off = max((abs(x - y) for x, y in zip((one.lower, one.upper), there, strict=True) if x != y), default=0.0)
        if abs(same) > _STRAIGHT and off > _UNLIKE:
            ranges = " and ".join(f"{j.lower:.2f} to {j.upper:.2f}" for j in (one, two))
            out.append(f"'{names[0]}' and '{names[1]}' do not mirror each other: {ranges} rad")
        for what, unit in (("velocity", "rad/s"), ("effort", "N m")):
            low, high = sorted(getattr(limit, what) for limit in (one, two))
            if _OTHER_SERVO * low < high < math.inf:
                text = f"have the {what} limits {getattr(one, what):g} and {getattr(two, what):g} {unit}"
                out.append(f"'{names[0]}' and '{names[1]}' {text}")
    return "; ".join(out)


def _check_led(skeleton: Skeleton, *legs: tuple[str, ...]) -> None:
    """Raise ModelError if legs cannot walk without a joint that carries a foot and follows another one of the legs.

    Both are locked: hips that yaw together, as NAO's, are not needed.
    """
    urdf = skeleton.urdf
    both = [set(foot_links(skeleton, joints[-1])) for joints in legs]
    for joint in urdf.joints.values():
        if joint.mimic is None or joint.mimic.joint not in urdf.joints:
            continue
        leader = urdf.joints[joint.mimic.joint]
        moved = sorted([bool(foot & set(urdf.after(one.child))) for foot in both] for one in (joint, leader))
        if moved == [[False, True], [True, False]] and not all(leg_of(*skeleton.lines(joints)) for joints in legs):
            raise ModelError(
                f"'{joint.name}' of a leg mimics '{leader.name}' of the other leg: legs that bend together cannot walk"
            )
    for joints in legs:
        feet = foot_links(skeleton, joints[-1])
        half = 0.5 * sum(urdf.links[link].inertial.mass for link in feet)
        for joint in urdf.joints.values():
            if joint.mimic is None or joint.mimic.joint not in joints:
                continue
            carried = urdf.after(joint.child)
            share = sum(urdf.links[link].inertial.mass for link in carried if link in feet)
            if skeleton.joints[joints[-1]].child in carried or share > half:
                raise ModelError(
                    f"'{joint.name}' of a leg mimics '{joint.mimic.joint}': legs whose joints lead each other cannot "
                    "walk with this package"
                )


def _check_shapes(skeleton: Skeleton, ankles: tuple[str, str]) -> None:
    """Raise ModelError if a mesh of a foot, or of what it carries, cannot be read: the sole would be another one."""
    which, missing = skeleton.complete([foot_links(skeleton, ankle) for ankle in ankles])
    if not which and missing:
        mesh, why = next(iter(missing.items()))
        more = f", and {len(missing) - 1} more" if len(missing) > 1 else ""
        cure = "; give --package-path of a folder that has it, or put a box in its place" if why == "not found" else ""
        raise ModelError(
            f"what '{ankles[0]}' and '{ankles[1]}' carry has a mesh that cannot be read, so its sole is unknown: "
            f"'{mesh}' {why}{more}{cure}"
        )


def _sole_distance(apart: float, hips: float, width: float, leg: float) -> float:
    """Return the lateral distance of the soles' centres when standing [m].

    `apart` is that of the zero posture, `hips` that of the hips, `width` is that of a sole, `leg` the leg length [m].
    """
    least = _least_distance(width, leg)
    return float(f"{max(least, min(apart, max(1.5 * hips, least))):.4g}")


def _least_distance(width: float, leg: float) -> float:
    """Return the least distance of the soles' centres of legs that do not touch [m]."""
    return width + 2.0 * _CLEARANCE * leg


def distances(anatomy: Anatomy) -> list[float]:
    """Return lateral distances of the soles' centres [m] to try: usual, closer, wider; one if no ankle rolls."""
    least = _least_distance(anatomy.soles[Foot.LEFT].width, anatomy.leg)
    parts = _DISTANCES if anatomy.sideways else (1.0,)
    return [float(f"{part * anatomy.apart:.4g}") for part in parts if part * anatomy.apart >= least or part == 1.0]


def _bare_ends(skeleton: Skeleton, pair: tuple[str, str]) -> str:
    """Return the end of an error message that names the links without a shape below the joints `pair`, or ``""``."""
    ends = []
    for last in pair:
        below = [body for body in skeleton.joints if last in skeleton.way(body)[:-1]]
        if below and all(skeleton.points(skeleton.bodies[body])[0] is None for body in below):
            ends.append(repr(skeleton.heaviest(max(below, key=lambda body: len(skeleton.way(body))))))
    have = "has" if len(ends) == 1 else "have"
    return f": {' and '.join(ends)} below {have} no shape; add a box as <collision>" if ends else ""


def _side_vote(skeleton: Skeleton, one: Sequence[str], two: Sequence[str]) -> int:
    """Return 1 if by its names `one` is the left leg, -1 if it is the right leg, 0 if the names do not differ so."""
    joints = skeleton.urdf.joints
    names = list(zip(one, two, strict=True))
    names += [(joints[a].child, joints[b].child) for a, b in names]
    return int(np.sign(sum(_is_left_of(a, b) - _is_left_of(b, a) for a, b in names)))


def _is_left_of(a: str, b: str) -> bool:
    """Return whether a name becomes another one if a word or letter for left in it is replaced by that for right."""
    a, b = a.lower(), b.lower()
    sides = (("left", "right"), ("lft", "rgt"), ("l", "r"))
    return any(a[: m.start()] + right + a[m.end() :] == b for left, right in sides for m in re.finditer(left, a))


def _find_forward(
    skeleton: Skeleton,
    one: tuple[str, ...],
    two: tuple[str, ...],
    forward: str,
) -> tuple[Array, tuple[str, ...], tuple[str, ...], list[Entry]]:
    """Return the rotation (3, 3) that turns the forward direction to x, the left and the right leg, and the sources."""
    lateral = mirrored(skeleton, one, two)[0]
    ahead = np.array([lateral[1], -lateral[0], 0.0])  # if `one` is the left leg
    root = skeleton.pose(skeleton.urdf.root).rotation_matrix()
    usual = float(ahead @ root[:, 0])
    votes = [  # > 0: `one` is the left leg
        (3.0 * _side_vote(skeleton, one, two), "the names of left and right"),
        (2.0 * _knee_vote(skeleton, one, two, ahead), "the direction in which the knees bend"),
        (_length_vote(skeleton, one, two, ahead), "the feet, which are longer in front of the ankle"),
        (1.5 * round(usual) * (abs(usual) > 0.9), "x of the root link (REP-103)"),
    ]
    if forward:
        sign, axis = (-1.0 if forward[0] == "-" else 1.0), "xyz".index(forward[-1])
        given = float(sign * root[:, axis] @ ahead)
        if abs(given) < 0.9:
            raise ModelError(f"{forward} of the root link is a lateral direction of the legs: give another --forward")
        total, source, confidence = given, "given by --forward", "sure"
    else:
        total = sum(weight for weight, _ in votes)
        agree = [text for weight, text in votes if weight * total > 0.0]
        against = [text for weight, text in votes if weight * total < 0.0]
        source = ", ".join(agree) + (f"; against it: {', '.join(against)}" if against else "")
        confidence = "sure" if abs(total) >= 3.0 and not against else "likely" if abs(total) >= 2.0 else "guess"
        if total == 0.0:  # it walks either way
            total, source = float(ahead @ (root[:, 0] + root[:, 1])), "nothing shows it: give --forward if it is wrong"
    if total < 0.0:
        ahead, one, two = -ahead, two, one
    where = root.T @ ahead
    axis = int(np.argmax(np.abs(where)))
    name = (
        f"{'+' if where[axis] > 0 else '-'}{'xyz'[axis]}" if abs(where[axis]) > 0.9999 else str(where.round(3).tolist())
    )
    x, y, _ = ahead
    found = [Entry("ahead", f"{name} of {skeleton.urdf.root}", source, confidence)]
    names, knees, feet = (weight for weight, _ in votes[:3])
    if names * (knees + feet) < 0.0 and names * feet <= 0.0:  # knees may bend backward, as those of a bird seem to
        disagree = [part for part, weight in (("knees", knees), ("feet", feet)) if names * weight < 0.0]
        why = f"by {' and '.join(disagree)}, the leg that is named left is the right one"
        found.append(Entry("side names", "may be exchanged", why, "guess"))
    return np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]]), one, two, found


def _knee_vote(skeleton: Skeleton, one: Sequence[str], two: Sequence[str], ahead: Array) -> float:
    """Return 1 if the bent knees point along `ahead`, -1 if they point against it, 0 if they do not agree."""
    votes = {_knee_points(skeleton, leg, ahead) for leg in (one, two)}
    return votes.pop() if len(votes) == 1 else 0.0


def _knee_points(skeleton: Skeleton, leg: Sequence[str], ahead: Array) -> float:
    """Return 1 if the bent knee of a leg points along `ahead`, -1 if it points against it, 0 if it bends both ways."""
    lateral = np.array([-ahead[1], ahead[0], 0.0])
    shape = leg_of(*skeleton.lines(leg))
    knee = leg[shape.knee] if shape else ""
    if shape is None or abs(skeleton.axis(knee) @ lateral) < 0.7:
        return 0.0
    joint = skeleton.joints[knee]
    if not math.isfinite(joint.limit.lower + joint.limit.upper):
        return 0.0
    lean = joint.limit.lower + joint.limit.upper
    if abs(lean) < 0.3 * (joint.limit.upper - joint.limit.lower):
        return 0.0
    shank = shape.ankle - shape.middle
    moved = np.cross(math.copysign(1.0, lean) * skeleton.axis(knee), shank)
    return -math.copysign(1.0, float(moved @ ahead))  # the shank moves backward if the knee points forward


def _turn_knee(skeleton: Skeleton, legs: dict[Foot, tuple[str, ...]]) -> None:
    """Give the range of a knee that bends back, while the other one bends ahead, the other sign if it mirrors it then.

    The forward axis is x.
    """
    back = [foot for foot, joints in legs.items() if _knee_points(skeleton, joints, X) < 0.0]
    knees = {foot: skeleton.joints[joints[_leg(skeleton, joints).knee]] for foot, joints in legs.items()}
    if len(back) != 1 or _knee_points(skeleton, legs[back[0].other], X) <= 0.0:
        return
    wrong, other = knees[back[0]], knees[back[0].other]
    limit = wrong.limit
    least, most = (sorted((abs(one.limit.lower), abs(one.limit.upper))) for one in (wrong, other))
    if max(abs(np.subtract(least, most))) > _UNLIKE:
        return
    skeleton.urdf.repairs.append(
        f"joint '{wrong.name}' bends its knee back by {limit.lower:.2f} to {limit.upper:.2f} rad, '{other.name}' bends "
        "the other one ahead: the limits are taken with the other sign"
    )
    limit.lower, limit.upper = -limit.upper, -limit.lower


def _length_vote(skeleton: Skeleton, one: Sequence[str], two: Sequence[str], ahead: Array) -> float:
    """Return a vote in [-1, 1]: positive if the feet are longer in front of the ankles, 0 if there is no difference."""
    reach = []
    for leg in (one, two):
        found, _ = skeleton.points(foot_links(skeleton, leg[-1]))
        if found is None:
            return 0.0
        low = found[found[:, 2] < found[:, 2].min() + 0.02]
        along = (low - _leg(skeleton, leg).ankle) @ ahead
        reach.append((float(along.max()), float(-along.min())))
    front, back = np.mean(reach, axis=0)
    if min(front, back) <= 0.0:
        return float(np.sign(front - back))
    ratio = math.log(front / back)
    return 0.0 if abs(ratio) < math.log(1.15) else float(np.clip(ratio / math.log(1.6), -1.0, 1.0))
