"""Identifies the arms of a biped, and its inertial sensor."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

import numpy as np

from dqwalk_ros.adopt.skeleton import Skeleton
from dqwalk_ros.paper.foot import Foot

_IMU = re.compile(r"(?<![a-z])(imu|gyro|accelerometer|ahrs|inertial)(?![a-z])", re.IGNORECASE)


def find_hands(skeleton: Skeleton, legs: set[str], pelvis: str) -> tuple[dict[Foot, str], str]:
    """Return the links at the ends of the arms, and the body that carries the arms."""
    carried: dict[str, list[str]] = {}
    for body in skeleton.joints:
        carried.setdefault(skeleton.way(body)[-2] if len(skeleton.way(body)) > 1 else "", []).append(body)
    led = {joint.mimic.joint for joint in skeleton.urdf.joints.values() if joint.mimic}
    arms: list[tuple[float, tuple[str, ...], tuple[str, ...]]] = []
    for siblings in carried.values():
        free = [body for body in siblings if body not in legs]
        for a, b in itertools.combinations(free, 2):
            first, second = (_unbranched(carried, led, body) for body in (a, b))
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


def _unbranched(carried: dict[str, list[str]], led: set[str], body: str) -> tuple[str, ...]:
    """Return the chain that starts at a body, up to its end, a branch, or a joint that fingers mimic."""
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


def find_imu(skeleton: Skeleton, pelvis: str, torso: str) -> str:
    """Return a link of the pelvis, or else of the torso, that is named like an inertial sensor; empty if none is."""
    for body in (pelvis, torso):
        named = [link for link in skeleton.bodies[body] if _IMU.search(link)]
        if named:
            return min(named, key=len)
    return ""
