"""Whether the links of a robot keep clear of each other, by the capsules around their shapes, and a way that does."""

from __future__ import annotations

import itertools
import math
import pathlib
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.paper.collisions import segments_apart
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.shapes import Shapes, capsule_around
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array

_CLEAR, _NEARER, _SLACK = 0.01, 0.005, 0.0005
"""Least distance of links that are not neighbours, and by how much those that are nearer in the zero posture may
approach each other [m]; the same on a way, also for those that are nearer at its ends."""
_STEP = 0.05
"""Largest change of a joint between two postures of a way that are looked at [rad]."""
_TRIES, _ASIDE = 300, 0.6
"""Number of random postures by which a way may lead, and their largest distance from the middle of it [rad]."""


def limbs(model: RobotModel) -> list[list[int]]:
    """Return the indices of the joints of each limb that the root carries, parents first."""
    found: dict[int, list[int]] = {}
    first = [0] * len(model.bodies)
    for b, body in enumerate(model.bodies):
        if body.joint >= 0:
            first[b] = b if body.parent == 0 else first[body.parent]
            found.setdefault(first[b], []).append(body.joint)
    return list(found.values())


class Capsules:
    """Capsules around links of a robot, by the names of the links: ends (3,) in their frames, and radius [m]."""

    def __init__(self, model: RobotModel, capsules: Mapping[str, tuple[Array, Array, float]]) -> None:
        self._model, self.links = model, list(capsules)
        self._ends = [np.array(capsule[:2]) for capsule in capsules.values()]
        self._radii = np.array([radius for *_, radius in capsules.values()])

    def distances(self, q: Array, pairs: NDArray[np.int64]) -> Array:
        """Return the distances (k,) [m] of pairs (k, 2), indices of `links`, at joint angles q (n,) [rad]."""
        kin = Kinematics(self._model, q, Foot.LEFT)
        placed = zip(self.links, self._ends, strict=True)
        ends = [DQ(kin.pose(link)).transform_point(own).ravel() for link, own in placed]
        apart: Array = segments_apart(np.array(ends).reshape(-1, 6), pairs) - self._radii[pairs].sum(axis=1)
        return apart


class Clearance:
    """Distances of the links of a robot that more than two joints connect.

    Links are the capsules around their shapes, or points if these cannot be read. They are to keep `_CLEAR` apart or,
    where they are nearer in the zero posture, nearly as far as there.

    Attributes
    ----------
    pairs : ndarray of int, shape (k, 2)
        Indices of the links of each pair.
    limbs : ndarray of int, shape (k, 2)
        First joints of the limbs to which they belong; -1 for the root.
    least : ndarray, shape (k,)
        Least distances [m].
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        urdf = Urdf(model.urdf, model.name)
        shapes = Shapes(urdf, pathlib.Path())
        hulls, _ = shapes.hulls(list(urdf.links))
        points = [name for name in urdf.links if name not in hulls and (not hulls or shapes.unread([name]))]
        capsules = {name: capsule_around(corners) for name, corners in hulls.items()}
        self._capsules = Capsules(model, capsules | {name: (np.zeros(3), np.zeros(3), 0.0) for name in points})
        self._links = self._capsules.links
        chains = [model.chain(model.frames[name].body) for name in self._links]
        first = [model.bodies[chain[1]].joint if len(chain) > 1 else -1 for chain in chains]
        far = [(i, j) for j in range(len(chains)) for i in range(j) if len({*chains[i]} ^ {*chains[j]}) > 2]
        self.pairs = np.array(far, dtype=np.int64).reshape(-1, 2)
        self.limbs = np.array(first)[self.pairs]
        self._zero = self.distances(np.zeros(model.n))
        self.least = np.minimum(self._zero - _NEARER, _CLEAR)

    @property
    def joints(self) -> int:
        """Number of joints, n."""
        return self._model.n

    def distances(self, q: Array) -> Array:
        """Return the distances (k,) of the pairs at joint angles q (n,) [m, rad]."""
        return self._capsules.distances(q, self.pairs)

    def names(self, pair: int) -> str:
        """Return the links of a pair in words."""
        return " and ".join(self._links[i] for i in self.pairs[pair])

    def way(self, begin: Array, end: Array) -> tuple[list[Array], str]:
        """Return postures (n,) that lead from one to another, straight from each to the next, and keep clear [rad].

        Tried are the straight way, the limbs one after the other, and ways by a random posture. Pairs that are nearer
        at an end may stay as near.

        Returns
        -------
        list of ndarray
            The postures after `begin`, the last one is `end`; empty if no way was found.
        str
            The links that are too near on the straight way; empty if it is clear.
        """
        ends = np.minimum(self.distances(begin), self.distances(end))
        least = np.minimum(np.minimum(self._zero, ends) - _SLACK, _CLEAR)
        nearest = ""
        for way in self._ways(begin, end):
            near = self._near(itertools.pairwise([begin, *way]), least)
            if near < 0:
                return way, nearest
            nearest = nearest or self.names(near)
        return [], nearest

    def _ways(self, begin: Array, end: Array) -> Iterator[list[Array]]:
        yield [end]
        for order in itertools.permutations(limbs(self._model)):
            way, here = [], begin
            for limb in order:
                here = here.copy()
                here[limb] = end[limb]
                way.append(here)
            yield way
        random, model = np.random.default_rng(0), self._model
        for _ in range(_TRIES):
            aside = 0.5 * (begin + end) + random.uniform(-_ASIDE, _ASIDE, model.n)
            yield [np.clip(aside, model.q_min, model.q_max), end]

    def _near(self, parts: Iterator[tuple[Array, Array]], least: Array) -> int:
        """Return a pair that comes too near on the parts of a way; -1 if none does."""
        for one, other in parts:
            count = max(1, math.ceil(float(np.abs(other - one).max()) / _STEP))
            for s in np.linspace(0.0, 1.0, count + 1)[1:]:
                near = self.distances(one + s * (other - one)) < least
                if near.any():
                    return int(np.argmax(near))
        return -1
