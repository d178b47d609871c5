"""How far apart the soles are, and the quantities of the walk that follow from this."""

from __future__ import annotations

import math
from dataclasses import replace

from dqwalk_ros.adopt.anatomy import Anatomy, distances
from dqwalk_ros.adopt.parameters import LEAST, LONGEST, MOST_LEAN, Numbers, com_threshold
from dqwalk_ros.adopt.posture import at_limits, over_one_foot, stand, why_not
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import ModelError

_OVER = 0.1
"""Largest distance of the CoM from the middle of a sole that it can reach, as a part of that at which phases end."""
_LONG = 0.66
"""Least length of a step, as a fraction of the usual one, for which the soles are not placed closer."""

_SQUAT = 0.2
"""Largest difference of the length of a leg from the wanted one, as a fraction of this, for which soles stand wider."""


def find_stance(model: RobotModel, anatomy: Anatomy) -> Numbers:
    """Return the quantities of the walk.

    Where joints are at their limits with the soles as far apart as in the zero posture, the soles are closer: so close
    that the CoM reaches the middle of one sole, and the legs make steps of two thirds of the usual length, or else the
    longest; where the CoM reaches it at no distance, it is that at which it comes nearest. They are wider where the
    robot walks at none of these distances, as with hips whose range excludes the zero posture, or stands with joints at
    their limits at all of them, as with hips that roll outwards from it only: a walk cannot move on from there.

    Raises
    ------
    ModelError
        If the robot cannot stand on both feet.
    """
    problem, possible = None, list[tuple[bool, bool, bool, float, Numbers]]()
    usual, *others = distances(anatomy)
    for apart in (usual, *others):
        if apart > usual and any(walks and free for walks, _, free, *_ in possible):
            break
        why = f"{'wider' if apart > usual else 'closer'} than in the zero posture, where joints are at their limits"
        more = (Entry("distance of the soles", f"{1e3 * apart:.0f} mm", why, "likely"),) if apart != usual else ()
        tried = replace(anatomy, apart=apart, evidence=(*anatomy.evidence, *more))
        try:
            numbers, deviation = _at(model, tried)
        except ModelError as error:
            problem = problem or error
            continue
        over = deviation < _OVER * com_threshold(anatomy.leg)
        standing = numbers.standing
        free = standing.margin > 0.0 or not at_limits(model, standing)
        free &= apart <= usual or standing.off < _SQUAT
        step = min(numbers.step, _LONG * LONGEST * anatomy.leg)
        if over and free and step < numbers.step:
            return numbers
        possible.append((not numbers.hindrance, over, free, step if over else -deviation, numbers))
    if possible:
        return max(possible, key=lambda one: one[:4])[4]
    assert problem is not None
    raise problem


def _at(model: RobotModel, anatomy: Anatomy) -> tuple[Numbers, float]:
    """Return the quantities of the walk, and how near the CoM comes to the middle of a sole [m]; see `find_stance`."""
    standing = stand(model, anatomy)
    if anatomy.lean is not None:
        return replace(numbers := Numbers.of(model, anatomy, standing), hindrance=_leans(numbers)), 0.0
    worst = max((over_one_foot(model, anatomy, standing, foot) for foot in Foot), key=lambda one: one.error)
    deviation, most = worst.error, com_threshold(anatomy.leg)
    if deviation > most:  # a walk itself keeps no distance from the limits
        free = replace(standing, margin=0.0)
        worst = max((over_one_foot(model, anatomy, free, foot) for foot in Foot), key=lambda one: one.error)
    numbers = Numbers.of(model, anatomy, standing)
    hindrance = ""
    if worst.error > most:
        hindrance = (
            f"the CoM of this robot cannot be placed over one sole with both feet flat: the least distance from its "
            f"middle is {1e3 * worst.error:.1f} mm, and a standing walk lifts the other foot at {1e3 * most:.1f} mm"
            f"{why_not(model, anatomy, worst)}"
        )
    elif numbers.reach < LEAST * anatomy.leg:
        hindrance = (
            f"with the CoM over one sole the legs reach steps of {1e3 * max(0.0, numbers.reach):.1f} mm only: "
            f"{', '.join(numbers.stuck) or 'none of their joints'} at the limit"
        )
    return replace(numbers, hindrance=hindrance), deviation


def _leans(numbers: Numbers) -> str:
    """Return why a robot whose trunk has to lean cannot do a standing walk.

    Raises
    ------
    ModelError
        If it cannot do a dynamic walk either.
    """
    lean, apart = numbers.anatomy.lean, numbers.anatomy.apart
    assert lean is not None
    none = "no ankle of this robot rolls, and no waist moves its CoM over one sole"
    if lean.lever <= 0.0:
        raise ModelError(f"{none}: a trunk that leans would do so, but its CoM is not above the hips")
    angle, most = numbers.leaning(numbers.pace), min(lean.most, MOST_LEAN)
    if angle > most:
        rolls = f"its hips roll by {math.degrees(lean.most):.0f} degrees to one side"
        but = rolls if lean.most < MOST_LEAN else "that tips it"
        raise ModelError(
            f"{none}: its trunk, which moves the CoM by {1e3 * lean.lever:.0f} mm/rad, would have to lean by "
            f"{math.degrees(angle):.0f} degrees in each step even of a dynamic walk on soles that are "
            f"{1e3 * apart:.0f} mm apart; {but}"
        )
    return (
        f"{none}: for a standing walk its trunk would have to lean by {math.degrees(0.5 * apart / lean.lever):.0f} "
        f"degrees; in the dynamic walk it leans by {math.degrees(angle):.0f}"
    )
