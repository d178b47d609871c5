"""Doubts about a robot description: units that are not SI, inertias that no such body has, joints that lead each other.

What has one likely meaning is repaired and listed in `Urdf.repairs`. The rest is an error that names the file, the size
and the likely unit.
"""

from __future__ import annotations

import contextlib
import math
from collections import Counter

import numpy as np

from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.robot.shapes import Shapes, kind_and_size
from dqwalk_ros.robot.urdf import Urdf, moves
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_MEANT = set("=*?[")
"""Characters that have a meaning where a parameter names joints."""
_LARGER, _SMALLER = 8.0, 0.02
"""Size of the largest mesh divided by the span of the joints, above and below which one of both has another unit."""
_HEAVIEST, _LIGHTEST, _USUAL = 5000.0, 1.0, 80.0
"""Largest, least and usual mass divided by the cube of the leg length [kg/m^3]; that of a robot is about 30 to 300."""
_SHORTEST, _LONGEST = 0.05, 2.0
"""Least and largest length of a leg [m]."""
_UNITS = {0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches"}
"""Units of length [m]."""
_TURNS, _FULL = 6.5, 361.0
"""Largest limit of a joint in radians, and in degrees."""
_DEGREES = 30.0
"""Least value of the largest limit in degrees; a limit of 10 for all joints is rather none."""
_GYRATION = 2.0
"""Largest radius of gyration of a link, as a multiple of the distance of its farthest corner from its CoM."""
_GUESSED = 0.3
"""Radius of gyration assumed for a link with shapes, as a multiple of this distance."""
_SMALLEST = 0.01
"""Least distance of the farthest corner of a link from its CoM [m]."""
_LEAST_DENSITY, _DENSITY, _LARGEST_DENSITY = 30.0, 500.0, 3000.0
"""Mass of a robot divided by the volume of the convex hulls of its links [kg/m^3]; 350 to 900 are usual."""


def check_names(urdf: Urdf) -> None:
    """Raise ModelError if a joint has a name that no parameter can name, such as an entry of ``robot.lock``."""
    for joint in urdf.joints.values():
        if moves(joint) and (found := set(joint.name) & _MEANT):
            raise ModelError(
                f"joint '{joint.name}' cannot be named in a configuration, in which {min(found)!r} has a meaning in "
                "names of joints (JOINT=RADIANS, and patterns): rename it, in the driver of the robot as well"
            )


def repair_degrees(urdf: Urdf) -> None:
    """Convert the limits of all joints to radians if those of most of them can only be degrees."""
    limits = [joint.limit for joint in urdf.joints.values() if joint.type == "revolute"]
    sizes = [max(abs(limit.lower), abs(limit.upper)) for limit in limits]
    known = [size for size in sizes if math.isfinite(size)]
    large = [size for size in known if size > _TURNS]
    if 2 * len(large) <= len(known) or len(set(large)) < 3 or not _DEGREES <= max(large) <= _FULL:
        return
    for limit in limits:
        limit.lower, limit.upper = math.radians(limit.lower), math.radians(limit.upper)
    urdf.repairs.append(
        f"{len(large)} of {len(known)} revolute joints have limits of up to {max(large):g}, which can only be degrees: "
        "all limits are converted to radians"
    )


_OF_ALL, _LIMB = 0.2, 4
"""Least part of the mass and number of joints of a limb that belong to another robot."""


def check_sizes(skeleton: Skeleton, shapes: Shapes) -> None:
    """Raise ModelError if the meshes have another unit of length than the joints."""
    places = np.array([skeleton.place(joint) for joint in skeleton.joints])
    span = float(np.linalg.norm(np.ptp(places, axis=0)))
    largest, what = 0.0, ""
    for name, link in skeleton.urdf.links.items():
        hulls, which = shapes.hulls([name])
        if hulls and all(kind_and_size(shape)[0] == "mesh" for shape in getattr(link, which)):
            size = float(np.ptp(hulls[name], axis=0).max())
            if size > largest:
                shape = getattr(link, which)[0].geometry.mesh
                largest, what = size, f"the mesh '{shape.filename}' of '{name}' is {size:.3g} m large"
    if not what or span <= 0.0:
        return
    if largest > _LARGER * span:
        unit = "millimetres" if largest > 60.0 * span else "centimetres or inches"
        scale = '; write <mesh ... scale="0.001 0.001 0.001"/>' if unit == "millimetres" else ""
        raise ModelError(f"{what}, but the joints of the robot span {span:.3g} m: is the mesh in {unit}{scale}?")
    if largest < _SMALLER * span:
        raise ModelError(
            f"{what}, and no other is larger, but the joints of the robot span {span:.4g} m: are the positions of the "
            "joints in millimetres?"
        )


def check_one(urdf: Urdf) -> None:
    """Raise ModelError if two robots or more hang on a root link without mass: heavy parts that fork into limbs."""
    if urdf.links[urdf.root].inertial.mass:
        return
    total = sum(link.inertial.mass for link in urdf.links.values())
    robots = []
    for joint in urdf.child_joints(urdf.root):
        part = urdf.after(joint.child)
        limbs = [sum(_limb(urdf, below.child) for below in urdf.child_joints(link)) for link in part]
        if sum(urdf.links[link].inertial.mass for link in part) > _OF_ALL * total and max(limbs) > 1:
            robots.append(joint.child)
    if len(robots) > 1:
        raise ModelError(
            f"'{urdf.root}' carries {len(robots)} robots, which begin with {', '.join(map(repr, robots))}: remove "
            "the joints to all but one of them"
        )


def _limb(urdf: Urdf, link: str) -> bool:
    """Return whether a link and what follows it have the joints of a leg."""
    return sum(moves(joint) for part in urdf.after(link) for joint in urdf.child_joints(part)) + 1 >= _LIMB


def check_density(urdf: Urdf, leg: float) -> None:
    """Raise ModelError if the robot has no mass, or far too much or too little for legs of the length `leg` [m]."""
    mass = sum(link.inertial.mass for link in urdf.links.values())
    if not mass > 0.0:
        raise ModelError(f"'{urdf.name}' has no mass, so it has no centre of mass: its links lack <inertial>")
    if _LIGHTEST * leg**3 < mass < _HEAVIEST * leg**3 and leg < _LONGEST:
        return
    units = [(length, grams) for length in (1.0, *_UNITS) for grams in (1.0, 1e-3)][1:]
    likely = [(length, grams) for length, grams in units if _SHORTEST < leg * length < _LONGEST] or units

    def unusual(of: tuple[float, float]) -> float:
        return abs(math.log(mass * of[1] / (leg * of[0]) ** 3 / _USUAL))

    length, grams = min(likely, key=unusual)
    doubts = [f"the lengths in {_UNITS[length]}"] if length < 1.0 else []
    doubts += ["the masses in grams"] if grams < 1.0 else []
    raise ModelError(
        f"the links of '{urdf.name}' weigh {mass:.4g} kg together, with legs of {leg:.4g} m: "
        f"are {' and '.join(doubts)}?"
    )


def assume_masses(urdf: Urdf, shapes: Shapes) -> bool:
    """Assume masses of the usual density within the convex hulls of the links if theirs are unknown.

    They are if no link has one, or if more than half of them have the same one and the robot would be lighter or denser
    than any: the mass of a template. Return whether.
    """
    import trimesh

    known = [link.inertial.mass for link in urdf.links.values() if link.inertial.mass]
    usual, count = Counter(known).most_common(1)[0] if known else (0.0, 0)
    if 2 * count < len(known):
        return False
    solids = {}
    for name in urdf.links:
        for corners in shapes.hulls([name])[0].values():
            with contextlib.suppress(Exception):  # a shape without volume; Qhull has its own exceptions
                solids[name] = trimesh.convex.convex_hull(corners).mass_properties
    volume = sum(float(solid.volume) for solid in solids.values())
    if known and (not volume or _LEAST_DENSITY < sum(known) / volume < _LARGEST_DENSITY):
        return False
    replaced = sum(urdf.links[name].inertial.mass for name in solids)
    scale = _DENSITY * volume / replaced if replaced else 1.0  # of a link whose shape cannot be read
    for name, link in urdf.links.items():
        part = link.inertial
        part.mass, part.inertia = scale * part.mass, scale * part.inertia
        if name in solids:
            solid = solids[name]
            part.mass, part.inertia = _DENSITY * float(solid.volume), _DENSITY * np.asarray(solid.inertia)
            part.origin[:3, 3] = solid.center_mass
    if volume:
        total = sum(link.inertial.mass for link in urdf.links.values())
        why = "no link has a mass"
        if known:
            why = (
                f"{count} of {len(known)} links have the mass {usual:g} kg, as in a template, and the robot would have "
                f"{sum(known) / volume:.3g} kg/m^3"
            )
        urdf.repairs.append(
            f"{why}: {_DENSITY:g} kg/m^3 within the convex hulls of their shapes are assumed, "
            f"{total:.3g} kg in all; weigh the robot and give --set robot.mass=KG"
        )
    return True


def list_massless(urdf: Urdf) -> None:
    """List the bodies that have shapes and no mass: they move the CoM away from where the robot has it."""
    bodies = [urdf.root, *(joint.child for joint in urdf.joints.values() if moves(joint))]
    fixed = {name: [urdf.links[link] for link in urdf.fixed_to(name)] for name in bodies}
    shaped = [name for name, links in fixed.items() if any(link.visuals or link.collisions for link in links)]
    if lost := [f"'{name}'" for name in shaped if not sum(link.inertial.mass for link in fixed[name]) > 0.0]:
        what = "has a shape" if len(lost) == 1 else "have shapes"
        urdf.repairs.append(f"{', '.join(lost)} {what} and no mass: <inertial> may be missing")


def repair_inertias(urdf: Urdf, shapes: Shapes, leg: float) -> None:
    """Replace moments of inertia that are too large for a link of its mass and size; `leg` is the leg length [m].

    The mass of a body is within its shapes, so its radius of gyration is less than the distance of their farthest
    corner. Without a shape it is less than the leg.
    """
    for name, link in urdf.links.items():
        part = link.inertial
        if not part.mass:
            continue
        found = list(shapes.hulls([name])[0].values())
        far = _farthest(found[0], part.origin[:3, 3]) if found else leg / _GYRATION
        most = part.mass * (_GYRATION * max(far, _SMALLEST)) ** 2
        largest = float(np.linalg.eigvalsh(part.inertia)[-1])
        if largest > most:
            assumed = part.mass * (_GUESSED * max(far if found else 0.2 * leg, _SMALLEST)) ** 2
            part.inertia = assumed * np.eye(3)
            size = f"a size of {1e3 * far:.0f} mm" if found else f"legs of {1e3 * leg:.0f} mm"
            urdf.repairs.append(
                f"link '{name}' has the moment of inertia {largest:.2g} kg m^2, too much for {part.mass:.3g} kg "
                f"with {size}: {assumed:.2g} is assumed"
            )


def _farthest(corners: Array, point: Array) -> float:
    return float(np.linalg.norm(corners - point, axis=1).max())


def use_led_joints(urdf: Urdf) -> None:
    """Exchange the roles of joints that mimic each other where the led one carries the robot's limb.

    A description of a linkage lets the joint of a limb mimic that of a crank or of a linear actuator. Both move with
    each other, so the joint of the limb can as well lead the crank.
    """
    carried = {name: urdf.after(joint.child) for name, joint in urdf.joints.items()}
    for joint in [*urdf.joints.values()]:
        led = joint.mimic
        leader = urdf.joints.get(led.joint) if led else None
        if led is None or leader is None or leader.mimic or not led.multiplier or not moves(leader):
            continue
        if joint.type not in ("revolute", "continuous") or joint.child in carried[leader.name]:
            continue
        after = [other for other in urdf.joints.values() if other.parent in carried[leader.name]]
        free = [other for other in after if moves(other) and not other.mimic]
        mass, less = (sum(urdf.links[link].inertial.mass for link in carried[j.name]) for j in (joint, leader))
        if free or mass <= less:
            continue
        ends = [led.multiplier * end + led.offset for end in (leader.limit.lower, leader.limit.upper)]
        joint.limit.lower, joint.limit.upper = max(min(ends), joint.limit.lower), min(max(ends), joint.limit.upper)
        if not joint.limit.lower < joint.limit.upper:
            joint.limit.lower, joint.limit.upper = min(ends), max(ends)
        inverse, offset = 1.0 / led.multiplier, -led.offset / led.multiplier
        joint.limit.effort = min(joint.limit.effort, abs(inverse) * leader.limit.effort)
        for other in urdf.joints.values():
            mimic = other.mimic
            if mimic and mimic.joint == leader.name and other is not joint:
                mimic.joint, mimic.offset = joint.name, mimic.multiplier * offset + mimic.offset
                mimic.multiplier *= inverse
        joint.mimic, leader.mimic = None, led
        led.joint, led.multiplier, led.offset = joint.name, inverse, offset
        urdf.repairs.append(
            f"joint '{joint.name}' mimics '{leader.name}' and carries more than it: taken as the one that moves, "
            f"'{leader.name}' follows"
        )
