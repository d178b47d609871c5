"""Every Jacobian compared with central differences: 100 random configurations, both support feet, 1e-6."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil

import numpy as np
import pytest
from robots import central_difference, configurations, legs
from walks import values

import dqwalk_ros
from dqwalk_ros.paper.collisions import Capsule
from dqwalk_ros.paper.constraints import Constraint
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import (
    CenterOfMass,
    CenterOfMassOnGround,
    Direction,
    Observer,
    Point,
    Pose,
    Rotation,
)
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import ConvexPolygon, Cylinder, Line, Plane
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.tasks import Task
from dqwalk_ros.walks.following import Target

COUNT = 100
TOLERANCE = 1e-6
OFFSET = np.array([0.03, -0.02, 0.05])
V = np.array([0.36, 0.48, 0.8])
TILTED = np.array([0.05, -0.08, np.sqrt(1.0 - 0.05**2 - 0.08**2)])
"""The vertical in the frame of a tilted sole."""


# ---------------------------------------------------------------------- Kinematics


def sample_frames(robot, foot):
    """Return frames at both ends, in the middle, and on the stance leg."""
    knees = [name for name in robot.frames if "shank" in name or "shin" in name]
    return [robot.soles[foot.other].frame, robot.pelvis, *knees[:2]]


def test_kinematics(robot, foot):
    frames = sample_frames(robot, foot)

    def coordinates(q):
        kin = Kinematics(robot, q, foot)
        parts = [kin.com]
        for name in frames:
            parts += [kin.pose(name), kin.point(name, OFFSET), kin.direction(name, V)]
        return np.concatenate(parts)

    def jacobians(q):
        kin = Kinematics(robot, q, foot)
        parts = [kin.com_jacobian]
        for name in frames:
            parts += [Pose(name).jacobian(kin), kin.point_jacobian(name, OFFSET), Direction(name, V).jacobian(kin)]
        return np.concatenate(parts)

    for q in configurations(robot, COUNT, seed=20):
        np.testing.assert_allclose(jacobians(q), central_difference(coordinates, q), rtol=0, atol=TOLERANCE)


def test_rotations(robot, foot):
    """J_r of section 2.2, and the angular velocity 2 r' r*."""
    frame = robot.soles[foot.other].frame
    for q in configurations(robot, COUNT // 10, seed=21):
        kin = Kinematics(robot, q, foot)
        slope = central_difference(lambda q: Kinematics(robot, q, foot).pose(frame)[:4], q)
        np.testing.assert_allclose(Rotation(frame).jacobian(kin), slope, rtol=0, atol=TOLERANCE)
        r = DQ(kin.pose(frame)).P()
        omega = np.array([(2.0 * DQ(column) * r.conj()).vec3() for column in slope.T]).T
        np.testing.assert_allclose(kin.angular_jacobian(frame), omega, rtol=0, atol=TOLERANCE)


# ---------------------------------------------------------------------- tasks and constraints


def subclasses(parent):
    """Every class of the package that derives from `parent`."""
    for module in pkgutil.walk_packages(dqwalk_ros.__path__, "dqwalk_ros."):
        if not module.name.startswith(("dqwalk_ros.nodes", "dqwalk_ros.cli", "dqwalk_ros.plants.drake")):
            importlib.import_module(module.name)
    found, stack = [], [parent]
    while stack:
        for cls in stack.pop().__subclasses__():
            stack.append(cls)
            if not cls.__abstractmethods__ and hasattr(cls, "function") and cls.__module__.startswith("dqwalk_ros."):
                found.append(cls)
    return sorted(found, key=lambda cls: cls.__name__)


def examples(model, foot):
    """Return values of fields of tasks and constraints, by name or, where this is ambiguous, by class and name."""
    base, swing = model.soles[foot], model.soles[foot.other]
    zero = np.zeros(model.n)
    target = DQ(Kinematics(model, zero, foot).pose(swing.frame)) * DQ.from_pose([0.05, 0.01, 0.02])
    return {
        "name": "example",
        "eta": 3.0,
        "foot": Point(swing.frame, swing.center),
        "frame": swing.frame,
        "target": target.vec8(),
        "q_ref": 0.1 + zero,
        "q_min": model.q_min,
        "q_max": model.q_max,
        "direction": np.array([0.6, 0.8, 0.0]),
        "point": Point(swing.frame, swing.tip),
        "moving": Point(swing.frame, swing.heel),
        "fixed": base.tip,
        "side": -1.0,
        "plane": Plane.through([0.0, 0.0, 0.1], [0.1, -0.2, 1.0]),
        "cylinder": Cylinder(Line.through([0.02, 0.03, 0.0], [0.1, 0.2, 1.0]), 0.05),
        "polygon": ConvexPolygon(base.corners[:, :2]),
        "points": swing.corners,
        "pose": target.vec8(),
        "over": (Point(base.frame, base.center),),
        "start": DQ(Kinematics(model, zero, foot).pose(swing.frame)).vec8(),
        "goal": target.vec8(),
        "height": 0.02,
        "duration": 2.0,
        "depth": 0.1,
        "lever": 0.2,
        "path": np.array([zero, 0.1 + zero]),
        "dt": 0.005,
        "ComPath.start": np.array([0.01, 0.02]),
        "feature": CenterOfMassOnGround(),
        "selects": np.array([[1.0, 0.0], [0.5, 2.0]]),
        "AtRest.selects": np.eye(2, model.n),
        "Follow.target": Target(np.array([0.01, 0.02]), np.array([0.1, 0.0])),
        "FollowPose.target": Target(np.array([*target.translation(), *target.vec8()[:4]]), np.zeros(6)),
        # the CoM, so that more than one branch of a constraint on points is tested
        "PointInsideWall.point": CenterOfMass(),
        "PointInCylinder.point": CenterOfMass(),
        "one": Capsule(swing.frame, swing.tip, swing.heel + 0.02, 0.01),
        "other": Capsule(model.pelvis, np.array([0.0, 0.02, 0.0]), np.array([0.01, 0.0, 0.3]), 0.02),
        "LinesApart.direction": Direction(swing.frame, np.array([0.6, 0.8, 0.0])),
        "other_point": Point(model.pelvis),
        "other_direction": Direction(model.pelvis, np.array([0.0, 0.6, 0.8])),
        "distance": 0.02,
        "PointOutsideLine.target": CenterOfMass(),
        "PointOutsideLine.direction": Direction(swing.frame, np.array([0.6, 0.8, 0.0])),
        "axis": Direction(model.pelvis, np.array([0.0, 0.0, 1.0])),
        "center": np.array([0.0, 0.6, 0.8]),
        "angle": 0.9,
        "velocity": np.array([0.1, -0.05, 0.02]),
        "radius": 0.03,
        "origin": Point(model.pelvis, np.array([0.02, 0.0, 0.0])),
        "normal": Direction(model.pelvis, np.array([1.0, 0.0, 0.0])),
        "features": (Point(swing.frame, swing.tip),),
        "size": 2,
        "Beside.numbers": np.array([0.1, 0.2, 0.0, 0.0, 1.0, 0.5, -0.3, 0.2, 0.0, 2.0]),
        "hand": swing.frame,
        "trunk": model.pelvis,
        "HandInTrunk.numbers": np.array([0.1, 0.0, -0.3, 0.6, 0.8, 0.0, -0.8, 0.6, 0.0, 0.0, 0.0, 0.0, 0.2, 1.0]),
    }


def example(cls, model, foot):
    """Return an instance; values of new fields must be added to `examples`."""
    known = examples(model, foot)
    given = {}
    for field in dataclasses.fields(cls):
        key = f"{cls.__name__}.{field.name}"
        if key in known or field.name in known:
            given[field.name] = known.get(key, known.get(field.name))
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            pytest.fail(f"add a value of '{field.name}' of {cls.__name__} to test_jacobians.examples")
    return cls(**given)


def on_a_tilted_sole(q, foot):
    return Kinematics(legs(), q, foot, TILTED)


def test_tasks_and_constraints(foot):
    """All at the same postures, for which the kinematics are computed once."""
    classes = [*subclasses(Task), *subclasses(Constraint)]
    made = [example(cls, legs(), foot) for cls in classes]
    observers = [Observer(one.watches, on_a_tilted_sole(np.zeros(legs().n), foot).tree) for one in made]

    def evaluated(q):
        kin = on_a_tilted_sole(q, foot)
        for one, observer in zip(made, observers, strict=True):
            s, J = observer(kin)
            value, gradient, _ = one.evaluate(s, 0.4)
            yield value, gradient @ J

    def all_values(q):
        return [value for value, _ in evaluated(q)]

    for q in configurations(legs(), COUNT // 5, seed=22):
        sizes = [d.size for d in all_values(q)]
        slopes = central_difference(lambda q: np.concatenate(all_values(q)), q)
        slopes = np.split(slopes, np.cumsum(sizes)[:-1])
        for one, size, expected, (_, J) in zip(made, sizes, slopes, evaluated(q), strict=True):
            assert J.shape == (size, legs().n), one
            scale = max(1.0, np.abs(J).max()) if isinstance(one, Constraint) else 1.0
            np.testing.assert_allclose(J, expected, rtol=0, atol=TOLERANCE * scale, err_msg=type(one).__name__)
    for one, size in zip(made, sizes, strict=True):
        assert isinstance(one, Task) or len(one.row_names(legs().joint_names)) == size, one


def test_rates_are_the_derivatives_by_time(foot):
    """At fixed coordinates; `Follow` and `FollowPose` have the rates of targets that do not move by themselves."""
    kin, h = on_a_tilted_sole(0.1 * np.ones(legs().n), foot), 1e-6
    for cls in (*subclasses(Task), *subclasses(Constraint)):
        one = example(cls, legs(), foot)
        if one.live is None:
            s = np.concatenate([feature.value(kin) for feature in one.watches])
            later, before = one.evaluate(s, 0.4 + h)[0], one.evaluate(s, 0.4 - h)[0]
            slope = (later - before) / (2.0 * h)
            np.testing.assert_allclose(one.evaluate(s, 0.4)[2], slope, rtol=0, atol=TOLERANCE, err_msg=cls.__name__)


def test_all_tasks_and_constraints_are_found():
    assert {"ComOverFoot", "FramePose", "Posture"} <= {cls.__name__ for cls in subclasses(Task)}
    assert len(subclasses(Constraint)) >= 6


def test_the_pose_error_uses_the_closer_of_x_and_minus_x():
    """x and -x are the same pose: the error must not depend on the target's sign."""
    robot = legs()
    rng = np.random.default_rng(24)
    cls = next(cls for cls in subclasses(Task) if cls.__name__ == "FramePose")
    for q in configurations(robot, 20, seed=25):
        kin = Kinematics(robot, q, Foot.LEFT)
        x_d = (DQ(kin.pose("r_sole")) * DQ.from_pose(0.1 * rng.normal(size=3))).vec8()
        plus, minus = (cls(name="x", frame="r_sole", target=s * x_d) for s in (1.0, -1.0))
        np.testing.assert_allclose(values(plus, kin)[0], -values(minus, kin)[0], atol=1e-15)
        assert np.linalg.norm(values(plus, kin)[0]) < 0.5
