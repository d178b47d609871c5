"""Properties of dual quaternions, sections 2.1 and 3 [Adorno2017], with random values from hypothesis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from dqwalk_ros.paper.dual_quaternions import DQ, E, i, j, k, qconj, qmul
from dqwalk_ros.paper.geometry import Z

numbers = st.floats(-10.0, 10.0, allow_subnormal=False)
vectors = arrays(float, 3, elements=numbers)
any_dq = arrays(float, 8, elements=numbers).map(DQ)


@st.composite
def directions(draw):
    v = draw(vectors.filter(lambda v: np.linalg.norm(v) > 1e-2))
    return v / np.linalg.norm(v)


@st.composite
def poses(draw):
    """Unit dual quaternions of any rotation and translation."""
    angle = draw(st.floats(-2.0 * np.pi, 2.0 * np.pi))
    return DQ.from_pose(draw(vectors), DQ.rotation_about(angle, draw(directions())).vec4())


def same(a: DQ, b: DQ | float, tol: float = 1e-12) -> None:
    a8 = a.vec8()
    b8 = (b if isinstance(b, DQ) else DQ(b)).vec8()
    np.testing.assert_allclose(a8, np.broadcast_to(b8, a8.shape), rtol=0.0, atol=tol * max(1.0, np.abs(a8).max()))


# ---------------------------------------------------------------------- the ring


def test_units():
    for a in (i, j, k):
        same(a * a, -1.0)
    same(i * j * k, -1.0)
    same(i * j, k)
    same(j * k, i)
    same(k * i, j)
    same(E * E, 0.0)
    for a in (i, j, k):
        same(E * a, a * E)


@given(any_dq, any_dq, any_dq)
def test_ring_axioms(a, b, c):
    same((a * b) * c, a * (b * c), 1e-11)
    same(a * (b + c), a * b + a * c)
    same((a + b) * c, a * c + b * c)
    same(a + b, b + a)
    same(a - b, -(b - a))
    same(a * DQ(1.0), a)
    same(DQ(1.0) * a, a)
    same(2.0 * a, a + a)
    same(a * 2.0, a + a)
    same(1.0 - a, -(a - 1.0))


@given(any_dq, any_dq)
def test_conjugate_and_primary_and_dual_parts(a, b):
    same((a * b).conj(), b.conj() * a.conj())
    same(a.Re() + a.Im(), a)
    same(a.Re() - a.Im(), a.conj())
    same(a.P() + E * a.D(), a)


@given(any_dq, any_dq)
def test_hamilton_operators(a, b):
    product = (a * b).vec8()
    tol = 1e-12 * max(1.0, np.abs(product).max())
    np.testing.assert_allclose(b.haminus8() @ a.vec8(), product, rtol=0, atol=tol)


@given(any_dq.filter(lambda a: np.linalg.norm(a.vec4()) > 0.1), any_dq)
def test_norm_and_inverse(a, b):
    n = a.norm()
    same(n * n, a * a.conj(), 1e-11)
    same(n.Im(), 0.0)
    same(a * a.inv(), 1.0, 1e-11)
    same(a.inv() * a, 1.0, 1e-11)
    unit = a.normalized()
    same(unit * unit.conj(), 1.0)
    same((a * b).norm(), n * b.norm(), 1e-9) if np.linalg.norm(b.vec4()) > 0.1 else None


def test_inverse_without_a_primary_part_is_an_error():
    with pytest.raises(ZeroDivisionError, match="no inverse"):
        E.inv()


# ---------------------------------------------------------------------- the group of poses


@given(poses(), poses(), poses())
def test_group_axioms(x, y, z):
    same((x * y) * z, x * (y * z), 1e-11)
    same(x * x.conj(), 1.0)
    same(x.conj() * x, 1.0)
    same(x.inv(), x.conj(), 1e-11)
    same((x * y).norm(), 1.0, 1e-12)


@given(poses(), poses())
def test_poses_match_homogeneous_matrices(x, y):
    def matrix(x):
        return np.block([[x.rotation_matrix(), x.translation()[:, None]], [np.zeros((1, 3)), 1.0]])

    np.testing.assert_allclose(matrix(x * y), matrix(x) @ matrix(y), atol=1e-11)
    np.testing.assert_allclose(matrix(x.conj()), np.linalg.inv(matrix(x)), atol=1e-11)
    expected = Rotation.from_quat(x.rotation()[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(x.rotation_matrix(), expected, atol=1e-13)


@given(vectors, poses())
def test_from_pose_round_trip(p, x):
    y = DQ.from_pose(p, x.rotation())
    np.testing.assert_allclose(y.translation(), p, atol=1e-13)
    np.testing.assert_array_equal(y.rotation(), x.rotation())
    same(y, x.P() + E * (0.5 * (DQ(p) * x.P())))  # (1)


@given(poses())
def test_exp_inverts_log(x):
    log = x.log()
    same(log.Re(), 0.0)
    same(log.exp(), x, 1e-11)


@given(st.floats(0.0, 2.0 * np.pi), directions(), vectors)
def test_log_of_a_known_motion(angle, axis, p):
    x = DQ.from_pose(p, DQ.rotation_about(angle, axis).vec4())
    if np.sin(0.5 * angle) > 1e-6:
        np.testing.assert_allclose(x.log().vec3(), 0.5 * angle * axis, atol=1e-9)
    np.testing.assert_allclose(x.log().vec8()[5:], 0.5 * p, atol=1e-12)


@given(st.floats(0.0, 3.14), directions(), vectors)
def test_the_rotation_vector_is_that_of_the_smaller_angle(angle, axis, p):
    x = DQ.from_pose(p, DQ.rotation_about(angle, axis).vec4())
    for same_pose in (x, -x):
        np.testing.assert_allclose(same_pose.rotation_vector(), angle * axis, atol=1e-9)
    both = DQ(np.stack([x.vec8(), -x.vec8()])).rotation_vector()
    np.testing.assert_allclose(both, np.tile(angle * axis, (2, 1)), atol=1e-9)


@pytest.mark.parametrize(
    "angle", [0.0, 1e-300, 1e-13, 1e-9, 1e-6, np.pi, 2 * np.pi - 1e-6, 2 * np.pi - 1e-13, 2 * np.pi]
)
def test_exp_inverts_log_at_limit_angles(angle):
    x = DQ.from_pose([1.0, 2.0, 3.0], DQ.rotation_about(angle, [0.6, 0.0, 0.8]).vec4())
    same(x.log().exp(), x)


@given(directions(), vectors)
def test_a_frame_that_faces_a_direction_is_turned_by_the_least_angle(z, p):
    for way in (z, Z, -Z):
        x = DQ.facing(way, p)
        np.testing.assert_allclose(x.translation(), p, atol=1e-12)
        np.testing.assert_allclose(x.rotation_matrix()[:, 2], way, atol=1e-8)
        assert np.linalg.norm(x.rotation_vector()) == pytest.approx(np.arctan2(np.hypot(*way[:2]), way[2]), abs=1e-8)


@pytest.mark.parametrize("start", [[0, 0, 0], [np.pi, 0, 0], [0, np.pi, 0], [0, 0, np.pi]], ids=["1", "x", "y", "z"])
def test_from_matrix_near_every_branch(start):
    rng = np.random.default_rng(0)
    for size in [0.0, 1e-12, 1e-8, 1e-4, 1.0] * 20:
        rotation = Rotation.from_rotvec(size * rng.normal(size=3)) * Rotation.from_rotvec(start)
        x = DQ.from_matrix(rotation.as_matrix(), [1.0, -2.0, 3.0])
        np.testing.assert_allclose(x.rotation_matrix(), rotation.as_matrix(), atol=1e-14)
        np.testing.assert_allclose(x.translation(), [1.0, -2.0, 3.0], atol=1e-14)
        assert x.vec8()[0] >= 0.0
        same(x.norm(), 1.0)


# ---------------------------------------------------------------------- transformed points


@given(poses(), vectors)
def test_transformation_of_points(x, c):
    moved = x.rotation_matrix() @ c + x.translation()
    np.testing.assert_allclose(x.transform_point(c), moved, atol=1e-11)


# ---------------------------------------------------------------------- arrays


def test_arrays_of_any_leading_shape():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 4, 5, 8))
    product = (DQ(a) * DQ(b)).vec8()
    assert product.shape == (4, 5, 8)
    for index in np.ndindex(4, 5):
        np.testing.assert_allclose(product[index], (DQ(a[index]) * DQ(b[index])).vec8(), atol=1e-14)
        same(DQ(DQ(a).inv().vec8()[index]), DQ(a[index]).inv())
    p = rng.normal(size=(5, 3))
    x = DQ(a).normalized()
    assert x.translation().shape == (4, 5, 3)
    assert x.transform_point(p).shape == (4, 5, 3)
    np.testing.assert_allclose(x.log().exp().vec8(), x.vec8(), atol=1e-12)


def test_quaternion_functions():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 4))
    np.testing.assert_allclose(qmul(a, b), (DQ(a) * DQ(b)).vec4())
    np.testing.assert_allclose(qconj(a), DQ(a).conj().vec4())


@pytest.mark.parametrize(
    ("value", "vec8"), [(2.0, [2, 0, 0, 0]), ([1, 2, 3], [0, 1, 2, 3]), ([4, 1, 2, 3], [4, 1, 2, 3])]
)
def test_short_values_are_padded_with_zeros(value, vec8):
    np.testing.assert_array_equal(DQ(value).vec8(), [*vec8, 0, 0, 0, 0])


def test_other_lengths_are_rejected():
    with pytest.raises(ValueError, match="1, 3, 4 or 8 coefficients, not 5"):
        DQ(np.zeros(5))
