"""The path of the steps, the circle through a path, and the power of the joints."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from recorded import rewrite

from dqwalk_ros import report as reporting
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.report import bag
from dqwalk_ros.report.ground import Circle, commanded_way, shortfall
from dqwalk_ros.report.metrics import pelvis_in_odom
from dqwalk_ros.trace import PhysicsRecord


def test_the_commanded_way_is_that_of_the_middle_between_the_soles(trace):
    """A first step of a length, whose foot begins beside the other one, then two of the double length."""
    steps = []
    for support, side in ((Foot.LEFT, -1.0), (Foot.RIGHT, 1.0), (Foot.LEFT, -1.0)):
        kin = Kinematics(trace.model, np.zeros(trace.model.n), support)
        target = DQ.from_pose([0.05, side * abs(kin.point(kin.swing)[1]), 0.0]).vec8()
        steps.append(SimpleNamespace(model=trace.model, q_start=kin.q, base=support, swing_target=target))
    assert commanded_way(steps) == pytest.approx(0.025 + 0.05 + 0.05, abs=1e-12)
    beside = DQ.from_pose(DQ(steps[-1].swing_target).translation() - [0.05, 0.0, 0.0]).vec8()
    back = SimpleNamespace(**{**vars(steps[-1]), "swing_target": beside})  # after a stance the same foot swings again
    assert commanded_way([*steps, back]) == pytest.approx(0.125 + 0.025, abs=1e-12)
    assert "moved 0.09 m, its steps cover 0.12 m" in shortfall(0.09, commanded_way(steps))
    assert not shortfall(0.11, commanded_way(steps))
    assert not shortfall(0.0, commanded_way([]))


def test_a_circle_is_fitted_through_points() -> None:
    angles = np.linspace(0.0, 5.0, 40)
    p = np.array([0.3, -0.2]) + 0.5 * np.column_stack([np.cos(angles), np.sin(angles)])
    circle = Circle.through(p)
    assert circle.center == pytest.approx([0.3, -0.2])
    assert circle.radius == pytest.approx(0.5)
    assert circle.deviation < 1e-9


def on_the_ground(trace, effort, **other):
    """Return the series of a walk in physics, with some torques of the joints (N, n)."""
    count = len(trace)
    known = PhysicsRecord(
        pelvis=pelvis_in_odom(trace),
        wrenches={foot: np.tile([0.0, 0.0, 10.0, 0.0, 0.0, 0.0], (count, 1)) for foot in Foot},
        cop=np.zeros((count, 3)),
        orientation=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        gyro=np.zeros((count, 3)),
        acceleration=np.zeros((count, 3)),
        q=trace.q,
        effort=effort,
    )
    return reporting.analyse(dataclasses.replace(trace, physics=dataclasses.replace(known, **other)))


def test_a_centre_of_pressure_that_is_not_recorded_is_not_judged(trace):
    """In the air there is none, which is known from the wrenches."""
    effort, lost = np.zeros((len(trace), trace.model.n)), np.full((len(trace), 3), np.nan)
    series = on_the_ground(trace, effort, cop=lost)
    assert series.ground.inside is None
    found = reporting.report(series)
    assert found["physics"]["cop_inside"] is None
    assert not any("centre of pressure" in one["message"] for one in found["violations"])
    recorded = on_the_ground(trace, effort).ground
    half = np.where(np.arange(len(trace))[:, None] % 2, recorded.physics.cop, np.nan)
    inside = np.isfinite(recorded.cop_margin) & (recorded.cop_margin >= -1e-4)
    assert on_the_ground(trace, effort, cop=half).ground.inside == np.mean(inside[1::2])
    airborne = {foot: np.zeros((len(trace), 6)) for foot in Foot}
    assert on_the_ground(trace, effort, cop=lost, wrenches=airborne).ground.inside == 0.0


def test_true_angles_are_read_by_the_names_of_their_joints(trace, tmp_path):
    known = on_the_ground(trace, np.zeros((len(trace), trace.model.n))).trace
    bag.write(known, tmp_path / "a")

    def turn(topic, time, message):
        """Reverse the joints, and add one."""
        message.name = [*reversed(message.name), "gripper"]
        message.position = np.append(message.position[::-1], 9.0)
        return time, message

    rewrite(tmp_path / "a", tmp_path / "b", edit=turn, edits="/true_joint_states")
    np.testing.assert_array_equal(bag.read(tmp_path / "b").physics.q, known.physics.q)


def test_power_is_torque_times_velocity(trace):
    """A constant torque on one joint does the work tau (q_end - q_start); the power is its absolute value."""
    joint, torque = 3, 2.0
    effort = np.zeros((len(trace), trace.model.n))
    effort[:, joint] = torque
    series = on_the_ground(trace, effort)
    ground, angle = series.ground, trace.q[:, joint]
    rises, periods = np.maximum(np.diff(angle), 0.0).sum(), np.diff(trace.time)
    assert np.isnan(ground.power[0])
    assert ground.work[1:] @ periods == pytest.approx(torque * rises)
    assert ground.power[1:] @ periods == pytest.approx(torque * np.abs(np.diff(angle)).sum())
    energy = reporting.report(series)["physics"]["energy"]
    assert energy["positive"] == pytest.approx(ground.work[1:].mean())
    assert energy["cost_of_transport"] > 0.0
    heavy = dataclasses.replace(trace, config=trace.config.updated({"physics.mass_scale": 2.0}))
    of_heavy = reporting.report(on_the_ground(heavy, effort))["physics"]["energy"]
    assert of_heavy["cost_of_transport"] == pytest.approx(0.5 * energy["cost_of_transport"])


def test_the_time_of_a_step_is_from_landing_to_landing(trace):
    """Double support before the first step, and the time until the end, are no part of it."""
    report = reporting.report(reporting.analyse(trace))
    landings = [phase["end"] for phase in report["phases"] if "landing" in phase]
    in_physics = reporting.report(on_the_ground(trace, np.zeros_like(trace.u)))["physics"]
    assert in_physics["seconds_per_step"] == pytest.approx(landings[1] - landings[0])
