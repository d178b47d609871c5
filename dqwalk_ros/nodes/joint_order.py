"""The values of a message in the order of the model's joints."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.wording import listed


class JointOrder:
    """Puts values with joint names into the order of the model's joints.

    Joints that the model does not have are ignored. Any other mismatch rejects the whole message.
    """

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._joints = tuple(joint_names)
        self.joints = frozenset(joint_names)
        self._names: list[str] = []
        self._seen = set[str]()  # joints that any message has named
        self._index: NDArray[np.intp] | None = None

    def __call__(self, names: Sequence[str], values: ArrayLike, what: str, *, finite: bool = True) -> Array:
        """Return the values of the model's joints, shape (n,); `what` is the name of the values in error messages.

        Raises
        ------
        StateError
            If joints are missing or named twice, a length is wrong or, with `finite`, a value is not finite; the
            message names the joints.
        """
        if self._index is None or names != self._names:
            self._index = self._order(names)
            self._names = list(names)
        given = np.asarray(values, dtype=np.float64)
        if given.shape != (len(self._names),):
            raise StateError(f"{len(self._names)} names, but {given.size} numbers in '{what}'")
        out: Array = given[self._index]
        if finite and not (math.isfinite(sum(out.tolist())) or np.isfinite(out).all()):  # the sum is a fast first test
            bad = ", ".join(f"{self._joints[i]} = {out[i]}" for i in np.flatnonzero(~np.isfinite(out)))
            raise StateError(f"not a finite {what}: {bad}")
        return out

    def _order(self, names: Sequence[str]) -> NDArray[np.intp]:
        place = {name: i for i, name in enumerate(names)}
        self._seen |= self.joints & place.keys()
        if missing := [joint for joint in self._joints if joint not in place]:
            extra = [name for name in names if name not in self._joints]
            also = f"; it has {listed(extra)}, which are not in the model" if extra else ""
            if self._seen.issuperset(missing):
                also += "; other messages have them, but one must have all"
            raise StateError(f"joints missing: {', '.join(missing)}{also}")
        if len(place) != len(names) and (doubled := {name for name in self.joints if names.count(name) > 1}):
            raise StateError(f"joints named twice: {listed(doubled)}")
        return np.array([place[joint] for joint in self._joints], np.intp)
