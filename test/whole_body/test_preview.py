"""The preview compared with the equations from which it was derived."""

from __future__ import annotations

import numpy as np
import pytest
from exactness import condensed_difference, discretized
from hypothesis import given
from hypothesis import strategies as st

from dqwalk_ros.config import Config, GaitConfig, WholeBodyConfig
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.whole_body.preview import PointMass, Stepping, previewed, swing_acceleration, swing_jerk

CONFIG = WholeBodyConfig()
STEPPING = Stepping.of(Config(gait=GaitConfig(first_support="right")))
MASS = PointMass(0.8, CONFIG.interval, CONFIG.intervals)


@given(st.floats(0.3, 1.2), st.floats(0.05, 0.2), st.integers(4, 16))
def test_capturability_is_the_condensed_form(height: float, interval: float, intervals: int) -> None:
    """(S14) equals c'_N + c''_N/omega of (S10), stepped with A and B; its coefficients are positive and sum to one."""
    mass = PointMass(height, interval, intervals)
    assert mass.alpha.sum() == pytest.approx(1.0, abs=1e-12)
    assert (mass.alpha > 0.0).all()
    assert condensed_difference(mass) < 1e-12


def test_the_matrices_solve_the_differential_equation() -> None:
    """(S10) integrated in a thousand small steps."""
    mass = PointMass(0.8, 0.1, 16)
    A, B, D = discretized(mass)
    w2 = mass.omega**2
    F, g = np.array([[0, 1, 0], [0, 0, 1], [0, w2, 0]]), np.array([0, 0, -w2])
    x, n = np.array([0.1, -0.2, 0.7]), 1000
    expected = A @ x + B * 0.3
    h = mass.interval / n
    for _ in range(n):
        k1 = F @ x + g * 0.3
        k2 = F @ (x + 0.5 * h * k1) + g * 0.3
        x = x + h * k2
    assert x == pytest.approx(expected, abs=1e-7)
    assert D @ x == pytest.approx(x[0] - mass.zeta * x[2])


@given(st.floats(0.05, 0.7), st.floats(-0.2, 0.2), st.floats(-1.0, 1.0), st.floats(-0.3, 0.3))
def test_the_cubic_arrives_at_rest(left: float, s: float, speed: float, end: float) -> None:
    a, b = swing_acceleration(left)
    ja, jb = swing_jerk(left)
    acceleration, jerk = a * (end - s) - b * speed, -ja * (end - s) + jb * speed
    assert s + speed * left + acceleration * left**2 / 2 + jerk * left**3 / 6 == pytest.approx(end, abs=1e-9)
    assert speed + acceleration * left + jerk * left**2 / 2 == pytest.approx(0.0, abs=1e-9)


def test_step_timing() -> None:
    """Standing to 0.3 s, over to the right foot until 0.4 s, then 0.7 s swings and 0.1 s transitions."""
    s = STEPPING.coordinate([0.0, 0.3, 0.35, 0.4, 1.1, 1.15, 1.2, 1.9, 1.95])
    assert s == pytest.approx([-1.0, -1.0, -0.5, 0.0, 0.0, 0.5, 1.0, 1.0, 1.5])
    assert STEPPING.swing(0.2) is None
    swing = STEPPING.swing(0.6)
    assert swing is not None
    assert swing.foot is Foot.LEFT
    assert (swing.elapsed, swing.remaining) == pytest.approx((0.2, 0.5))
    assert STEPPING.swing(1.1) is None
    assert STEPPING.swing(1.1 - 1e-12) is None  # rounding of an accumulated clock
    assert STEPPING.swing(1.2).foot is Foot.RIGHT
    assert [STEPPING.step(t) for t in (0.39, 0.4, 1.199, 1.2)] == [-1, 0, 0, 1]


def test_the_preview_moves_continuously_with_the_clock() -> None:
    """Over three steps with feet that land as previewed, every limit moves by a small amount per tick."""
    places = {-1: np.zeros(2), 0: np.array([0.0, -0.095])}
    last = None
    for tick in range(round(2.6 / 0.005)):
        t = 0.4 + 0.005 * tick
        landed = STEPPING.step(t) + (STEPPING.swing(t) is None)
        for j in range(max(places) + 1, landed + 1):
            places[j] = np.array([0.1 * j, 0.095 * (-1) ** (j + 1)])
        p = previewed(CONFIG, STEPPING, MASS, t, np.zeros(2), places)
        base = max(places)
        steps = len(p.lower[p.feet])
        dP = np.array([[0.1, 0.19 * (-1) ** (base + k)] for k in range(steps)])
        center = (p.offset + p.M[:, p.feet] @ dP)[1:]
        for edge in (center + p.lower[p.cops], center + p.upper[p.cops]):
            assert np.isfinite(edge).all()
        if last is not None:
            assert np.abs(center - last).max() <= 0.19 * 0.005 / 0.1 + 1e-9
        last = center
        assert steps in (1, 2, 3)
        assert (p.lower[p.feet] <= dP + 1e-12).all()
        assert (dP <= p.upper[p.feet] + 1e-12).all()


def test_the_first_previewed_footstep_is_fixed() -> None:
    p = previewed(CONFIG, STEPPING, MASS, 0.0, np.array([1.0, 2.0]), {-1: np.array([1.0, 2.0])})
    assert p.lower[p.feet][0] == pytest.approx([0.0, -0.095])
    assert p.upper[p.feet][0] == pytest.approx([0.0, -0.095])
    assert p.offset == pytest.approx(np.tile([1.0, 2.0], (17, 1)))
    assert p.upper[p.cops][0] == pytest.approx([0.0686, 0.124])  # both feet side by side
    assert p.upper[p.cops][-1] == pytest.approx([0.0686, 0.029])
