"""Records that compiled functions take by their address."""

from typing import NamedTuple

import numba
import numpy as np
import pytest

from dqwalk_ros.support.by_address import BOOLEAN, FLOAT, INTEGER, INTEGERS, MASK, MATRIX, VECTOR, Record
from dqwalk_ros.support.compiled import jit

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="then a record is its own table")


class Inner(NamedTuple):
    """A record within another one."""

    indices: np.ndarray
    chosen: np.ndarray


class Outer(NamedTuple):
    """Arrays of other types and dimensions."""

    b: np.ndarray
    inner: Inner
    A: np.ndarray


RECORD = Record(Outer, VECTOR, Record(Inner, INTEGERS, MASK), MATRIX)
opened = RECORD.opened


@jit
def doubled(table):
    """Double what is chosen of A, and return b, and the sum of the indices."""
    b, (indices, chosen), A = opened(table)
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            if chosen[i, j]:
                A[i, j] *= 2.0
    return b.copy(), indices.sum()


def outer():
    """A record."""
    chosen = np.array([[True, False, False], [False, False, True]])
    return Outer(np.array([1.0, 2.0]), Inner(np.array([3, 4, 5]), chosen), np.arange(6.0).reshape(2, 3) + 1.0)


def test_a_compiled_function_works_in_the_memory_of_a_record():
    record = outer()
    b, total = doubled(RECORD.table(record))
    np.testing.assert_array_equal(b, record.b)
    assert total == 12
    np.testing.assert_array_equal(record.A, [[2.0, 2.0, 3.0], [4.0, 5.0, 12.0]])


@pytest.mark.parametrize("wrong", [np.zeros((3, 2)).T, np.zeros((2, 3), dtype=np.float32), np.zeros(6)])
def test_an_array_of_another_type_has_no_address(wrong):
    with pytest.raises(TypeError, match="an array of Outer is"):
        RECORD.table(outer()._replace(A=wrong))


class Mixed(NamedTuple):
    """Numbers around an array."""

    weight: float
    values: np.ndarray
    index: int
    doubled: bool


MIXED = Record(Mixed, FLOAT, VECTOR, INTEGER, BOOLEAN)
mixed_opened = MIXED.opened


@jit
def weighted(table):
    """Return the weighted value at the index, twice that if the record says so."""
    record = mixed_opened(table)
    value = record.weight * record.values[record.index]
    return 2.0 * value if record.doubled else value


def test_a_record_has_numbers():
    values = np.array([3.0, 5.0, 7.0])
    for index, doubled_ in ((1, False), (2, True)):
        record = Mixed(-0.1, values, index, doubled_)
        assert weighted(MIXED.table(record)) == -0.1 * values[index] * (2.0 if doubled_ else 1.0)
