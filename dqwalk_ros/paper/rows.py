"""The rows of a phase's constraints: names and numbers, and what a period in sampled time leaves of a distance."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from dqwalk_ros.paper.constraints import Constraint, JointMaximum, JointMinimum, vfi
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of l equalities, m inequalities, and the upper and lower limits of n joints, in this order."""

    names: tuple[str, ...]
    spans: dict[str, slice]
    """The rows of each constraint."""
    equalities: int
    """Number of equality rows, l."""
    numbers: Array
    """Bound, eta and return speed of each row, shape (3, l + m + 2n)."""
    near: Array
    """Distance above its bound beyond which a row is left out of the program (`Constraint.near`), shape (l + m,)."""
    radius: Array
    """R of `sampled`, shape (l + m + 2n,): the height of the CoM at the start; zero for the joint limits [m]."""

    @classmethod
    def of(
        cls,
        kin: Kinematics,
        equalities: Sequence[Constraint],
        inequalities: Sequence[Constraint],
        limits: tuple[JointMaximum, JointMinimum],
    ) -> Self:
        """Return the rows of the constraints of a phase that begins at `kin`."""
        every = (*equalities, *inequalities, *limits)
        names = [constraint.row_names(kin.model.joint_names) for constraint in every]
        counts = [len(group) for group in names]
        near = np.repeat([c.near for c in every[:-2]], counts[:-2])
        return cls(
            names=tuple(itertools.chain(*names)),
            spans={c.name: span for c, span in zip(every, slices(counts), strict=True)},
            equalities=sum(counts[: len(equalities)]),
            numbers=np.repeat([[c.bound, c.eta, c.return_speed] for c in every], counts, axis=0).T.copy(),
            near=near,
            radius=np.append(np.full(len(near), kin.com[2]), np.zeros(sum(counts[-2:]))),
        )

    def by_name(self, margins: Array) -> dict[str, Array]:
        """Return the margins (...) of each constraint, by name, from those of all rows (..., l + m + 2n).

        For a constraint of several rows it is the smallest one; for an equality the one with the largest magnitude.
        """
        out = {}
        for name, span in self.spans.items():
            part = margins[..., span]
            if span.stop <= self.equalities:
                largest = np.abs(part).argmax(axis=-1, keepdims=True)
                out[name] = np.take_along_axis(part, largest, axis=-1)[..., 0]
            else:
                out[name] = part.min(axis=-1)
        return out


@jit
def sampled(
    d: Array, eta: Array, return_speed: Array, dt: float, period: float, turned: float, radius: Array
) -> Array:  # fmt: skip
    """Least margins after a period that began with the margins d, all (k,): what `vfi` requires in sampled time.

    d+ >= d + T w - R/2 (sum_i |q+_i - q_i|)^2, which is (1 - eta T) d less the curvature of the distance of a point
    from a plane along the motion; other distances may curve more (docs/equations.md, Discrete time).

    Parameters
    ----------
    d, eta, return_speed : ndarray, shape (k,)
        Distances above their bounds, and the parameters of `vfi`.
    dt, period : float
        Control period, and the time T that passed [s]; what is below its bound need not return for longer than dt.
    turned : float
        Sum of the absolute changes of all joint angles [rad].
    radius : ndarray, shape (k,)
        R: largest distance of the point from the joints' axes [m]; zero for a joint's angle.
    """
    w = vfi(d, np.zeros(d.shape[0]), eta, return_speed, dt)
    least: Array = d + np.where(w < 0.0, period, min(period, dt)) * w - 0.5 * radius * turned**2
    return least


@jit
def least_after(
    margins: Array, numbers: Array, near: Array, radius: Array, turned: float, period: float, dt: float
) -> Array:
    """Return the least margins (l + m + 2n,) after a period [s], as `sampled`, from numbers, near and radius of `Rows`.

    The margin of an equality is -|d|. Of a body that is too far for a row it is only known that it does not touch.
    """
    least: Array = sampled(margins, numbers[1], numbers[2], dt, period, turned, radius)
    for i in range(len(near)):
        if margins[i] >= near[i]:
            least[i] = -0.5 * radius[i] * turned**2
    return least


def slices(sizes: Sequence[int]) -> list[slice]:
    """Return the slices of consecutive blocks of the given sizes."""
    return [slice(end - size, end) for end, size in zip(itertools.accumulate(sizes), sizes, strict=True)]
