"""The divergent component of motion over footprints, in closed form [Englsberger2015].

A linear inverted pendulum c'' = w^2 (c - z), with the centre of mass c along the ground, the zero-moment point z and a
frequency w for each axis, has an unstable part xi' = w (xi - z) and a stable part c' = w (xi - c), in which c converges
to xi. So only the divergent component xi = c + c'/w must be planned. Its equation is solved backwards in time, where it
is stable, from the last planned step to the current one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.by_address import FLOAT, MATRIX, NOTHING, VECTOR, Signature
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.walks.following import minimum_jerk

REFERENCE = Signature(NOTHING, VECTOR, FLOAT, MATRIX)
"""Type of the functions of references: they fill `out` from (numbers, elapsed, out)."""


_OFFSET = 0.4
"""xi at the start of the last planned step, as a fraction of the distance from the middle of the feet to its foot."""
_LAST = 0.25
"""xi at the end of the last single support, as a fraction of the distance from the middle of the feet to its foot."""


@jit
def before(a: Array, b: Array, end: Array, time: float, omega: Array) -> Array:
    """Return the divergent component a given time before it is at `end`, while z moves linearly from `a` to `b`.

    The solution of xi' = w (xi - z): with e = exp(-w T) and b = a it is z + e (xi(T) - z).

    Parameters
    ----------
    a, b : ndarray, shape (2,)
        Zero-moment point at the beginning and at the end [m].
    end : ndarray, shape (2,)
        xi at the end [m].
    time : float
        T [s].
    omega : ndarray, shape (2,)
        w [1/s].

    Returns
    -------
    ndarray, shape (2,)
        xi at the beginning [m].
    """
    if time < 1e-9:
        return end
    e = np.exp(-omega * time)
    return e * end + (1.0 - e) * a + (b - a) / (omega * time) * (1.0 - e * (1.0 + omega * time))


@jit
def _pressed(numbers: Array, elapsed: float, out: Array) -> None:
    """Fill the rows of `out` (2, 2) with xi and z of `Pressed`."""
    a, b, end, duration, omega = numbers[:2], numbers[2:4], numbers[4:6], numbers[6], numbers[7:]
    left = min(max(duration - elapsed, 0.0), duration)
    z = b - left / duration * (b - a)
    out[0], out[1] = before(z, b, end, left, omega), z


@jit
def _resting(numbers: Array, elapsed: float, out: Array) -> None:
    """Fill the rows of `out` (2, 2) with xi and z of `Rest`."""
    start, goal, duration, omega = numbers[:2], numbers[2:4], numbers[4], numbers[5:]
    place, slope, _ = minimum_jerk(elapsed / duration)
    way = goal - start
    xi = start + place * way
    out[0], out[1] = xi, xi - slope / duration * way / omega


class Reference(ABC):
    """Planned divergent component xi and zero-moment point z during a phase of `duration` [s].

    `function` is the compiled function of the class, of the type `REFERENCE`.
    """

    function: ClassVar[Callable[[Array, float, Array], None]]
    duration: float

    @property
    @abstractmethod
    def numbers(self) -> Array:
        """All constants, which the function takes, one-dimensional."""

    @cached_property
    def compiled(self) -> tuple[Any, Array]:
        """Entry of the function in a table of the type `REFERENCE`, and its numbers."""
        return REFERENCE.table([type(self).function])[0], self.numbers

    def at(self, elapsed: float) -> tuple[Array, Array]:
        """Return xi and z (2,) [m], `elapsed` [s] into the phase."""
        out = np.empty((2, 2))
        type(self).function(self.compiled[1], elapsed, out)
        return out[0], out[1]

    def __getstate__(self) -> dict[str, Any]:
        """Return all but `compiled`: the addresses of functions are those of this process."""
        return {name: value for name, value in self.__dict__.items() if name != "compiled"}


@dataclass(frozen=True)
class Pressed(Reference):
    """Reference of a support: z moves linearly from `a` to `b`, and xi ends at `end`."""

    a: Array
    b: Array
    """Zero-moment point at the beginning and at the end, shape (2,) [m]."""
    end: Array
    """xi at the end, shape (2,) [m]."""
    duration: float
    """[s]"""
    omega: Array
    """Frequencies of the pendulum, shape (2,) [1/s]."""
    function = _pressed

    @property
    def numbers(self) -> Array:
        """Shape (9,)."""
        return np.array([*self.a, *self.b, *self.end, self.duration, *self.omega])


@dataclass(frozen=True)
class Rest(Reference):
    """Reference of a stance: xi moves from `start` to `goal` on a minimum-jerk path, at rest at both ends."""

    start: Array
    goal: Array
    """xi at the beginning and at the end, shape (2,) [m]."""
    duration: float
    """[s]"""
    omega: Array
    """Frequencies of the pendulum, shape (2,) [1/s]."""
    function = _resting

    @property
    def numbers(self) -> Array:
        """Shape (7,)."""
        return np.array([*self.start, *self.goal, self.duration, *self.omega])


class Support(NamedTuple):
    """A planned single support."""

    aim: Array
    """Middle of the path of the CoP on the sole, shape (2,) [m]."""
    roll: Array
    """The zero-moment point moves from aim - roll to aim + roll, shape (2,) [m]."""
    double: float
    single: float
    """Durations of the double support before it and of the single support [s]."""

    @property
    def first(self) -> Array:
        """Zero-moment point at the beginning, shape (2,) [m]."""
        return self.aim - self.roll

    @property
    def last(self) -> Array:
        """Zero-moment point at the end, shape (2,) [m]."""
        return self.aim + self.roll


def single_supports(supports: Sequence[Support], omega: Array, *, ends: bool) -> list[tuple[Array, Array]]:
    """Return xi at the beginning and at the end of each single support.

    Parameters
    ----------
    supports : sequence of Support
        The current one and those of the following steps; two or more.
    omega : ndarray, shape (2,)
        Frequencies of the pendulum [1/s].
    ends : bool
        Whether the walk ends on the last two feet; otherwise it continues with steps like the last one.

    Returns
    -------
    list of tuple of ndarray, shape (2,)
        xi at the beginning and at the end of the single support on each of `supports` but the last [m].
    """
    a, b = supports[-2], supports[-1]
    middle = 0.5 * (a.aim + b.aim)
    if ends:
        end = middle + _LAST * (a.aim - middle)
    else:
        end = before(a.last, b.first, middle + _OFFSET * (b.aim - middle), b.double, omega)
    out: list[tuple[Array, Array]] = []
    for one, following in zip(supports[-2::-1], supports[:0:-1], strict=True):
        if out:
            end = before(one.last, following.first, out[-1][0], following.double, omega)
        out.append((before(one.first, one.last, end, one.single, omega), end))
    return out[::-1]
