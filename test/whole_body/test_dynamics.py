"""The multibody dynamics compared with independent sums over the bodies and with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from exactness import model_difference

from dqwalk_ros.config import load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.whole_body.dynamics import Multibody, rotation_error

MODEL = load_model(load("whole_body").robot)
FRAMES = ("L_sole", "R_sole", "chest", "R_hand", "head")
RNG = np.random.default_rng(3)


def state(spread: float = 1.0):
    x_base = DQ(0.3 * RNG.normal(size=8) * [0, 1, 1, 1, 0, 1, 1, 1]).exp().vec8()
    q = MODEL.q_min + RNG.random(MODEL.n) * (MODEL.q_max - MODEL.q_min)
    return x_base, q, spread * RNG.normal(size=6 + MODEL.n)


@pytest.fixture(scope="module")
def body() -> Multibody:
    return Multibody(MODEL, FRAMES)


def test_forces_and_places_match_newton_and_the_dual_quaternions() -> None:
    forces, places = model_difference(MODEL)
    assert forces < 1e-10
    assert places < 1e-10


def test_jacobians_and_drifts_are_derivatives(body: Multibody) -> None:
    """p' = J v and p'' = J v' + J' v, by central differences along a motion of constant v."""
    x_base, q, v = state(0.5)
    eps = 1e-5
    now = body.at(x_base, q, v)
    after, before = (body.at(*body.integrate(x_base, q, s * eps * v), v) for s in (1.0, -1.0))
    assert now.com_velocity == pytest.approx((after.com - before.com) / (2 * eps), abs=1e-8)
    assert now.com_jacobian @ v == pytest.approx(now.com_velocity, abs=1e-10)
    # v is constant in the axes of the base, whose rotation is not part of J' v
    assert now.com_drift == pytest.approx((after.com_velocity - before.com_velocity) / (2 * eps), abs=1e-7)
    for frame in FRAMES:
        a, b, c = after.frames[frame], before.frames[frame], now.frames[frame]
        assert c.velocity[:3] == pytest.approx((a.position - b.position) / (2 * eps), abs=1e-8)
        turned = rotation_error(a.rotation, b.rotation) / (2 * eps)
        assert c.velocity[3:] == pytest.approx(turned, abs=1e-7)
        assert c.drift == pytest.approx((a.velocity - b.velocity) / (2 * eps), abs=1e-6)


def test_stand_places_the_feet_as_requested(body: Multibody) -> None:
    x_base, q = body.stand(np.where([n.endswith("knee") for n in MODEL.joint_names], 0.8, 0.0), 0.2, "chest")
    d = body.at(x_base, q, np.zeros(body.nv))
    for foot, y in ((Foot.LEFT, 0.1), (Foot.RIGHT, -0.1)):
        assert d.frames[MODEL.soles[foot].frame].position == pytest.approx([0.0, y, 0.0], abs=1e-9)
        assert d.frames[MODEL.soles[foot].frame].rotation == pytest.approx(np.eye(3), abs=1e-9)
    assert d.com[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    with pytest.raises(ModelError, match="cannot stand"):
        body.stand(q, 4.0, "chest")


def test_dropped_and_locked_joints_are_not_in_the_dynamics() -> None:
    robot = load("whole_body").updated({"robot.drop": ["neck_yaw"], "robot.lock": ["L_wrist_*"]}).robot
    model = load_model(robot)
    body = Multibody(model, ("L_hand",))
    assert body.nv == 6 + model.n
    assert body.mass == pytest.approx(model.mass, abs=1e-10)
    with pytest.raises(ModelError, match="'head'"):
        Multibody(model, ("head",))
