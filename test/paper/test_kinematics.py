"""Kinematics compared with dual quaternions from the pelvis, and with `pin`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robots import biped12, central_difference, configurations, legs, mirrored, poppy

from dqwalk_ros.config import RobotConfig
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Point, Pose
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.robot.model import load_model


def from_root(model, q):
    """Poses of all bodies in the root's frame, by dual quaternion products alone."""
    poses = []
    for body in model.bodies:
        if body.parent < 0:
            poses.append(DQ(1.0))
        else:
            poses.append(poses[body.parent] * DQ(body.origin) * DQ.rotation_about(q[body.joint], body.axis))
    return poses


def frame_from_root(model, poses, name):
    frame = model.frames[name]
    return poses[frame.body] * DQ(frame.pose)


def assert_equal_up_to_sign(a, b, tol=1e-12):
    a, b = np.asarray(a), np.asarray(b)
    np.testing.assert_allclose(a if a[:4] @ b[:4] >= 0.0 else -a, b, rtol=0, atol=tol)


# ---------------------------------------------------------------------- sections 3.4 and 3.5, written out


def test_every_frame(robot, foot):
    for q in configurations(robot, 10, seed=1):
        x = from_root(robot, q)
        kin = Kinematics(robot, q, foot)
        base = frame_from_root(robot, x, robot.soles[foot].frame)
        for name in robot.frames:
            expected = base.conj() * frame_from_root(robot, x, name)
            assert_equal_up_to_sign(kin.pose(name), expected.vec8())
            offset = np.array([0.1, -0.2, 0.3])
            np.testing.assert_allclose(kin.point(name, offset), expected.transform_point(offset), atol=1e-12)
            np.testing.assert_allclose(kin.direction(name, offset), expected.P().Ad(DQ(offset)).vec3(), atol=1e-12)


def test_centre_of_mass(robot, foot):
    """(4), with the mass of the support foot; and (5) as the weighted sum of the partial Jacobians of (3)."""
    for q in configurations(robot, 4, seed=2):
        x = from_root(robot, q)
        kin = Kinematics(robot, q, foot)
        base = frame_from_root(robot, x, robot.soles[foot].frame)
        com, J = np.zeros(3), np.zeros((3, robot.n))
        for index, body in enumerate(robot.bodies):
            p = (base.conj() * x[index]).transform_point(body.com)
            com += body.mass / robot.mass * p
            J += body.mass / robot.mass * partial_com_jacobian(robot, kin, index)
        np.testing.assert_allclose(kin.com, com, atol=1e-12)
        np.testing.assert_allclose(kin.com_jacobian, J, atol=1e-12)
        foot_body = robot.bodies[robot.frames[robot.soles[foot].frame].body]
        assert foot_body.mass > 0.0  # it contributes although it is at rest


def frame_on(model, index):
    """A frame on a body, and the body's centre of mass in it."""
    name, frame = next((name, frame) for name, frame in model.frames.items() if frame.body == index)
    return name, DQ(frame.pose).conj().transform_point(model.bodies[index].com)


def partial_com_jacobian(model, kin, index):
    """(3): vec8(x_c') = H8-(x_ci) J_i q', reduced to the translation as in section 2.2."""
    name, com = frame_on(model, index)
    x_ci = DQ.from_pose(com)
    J = x_ci.haminus8() @ Pose(name).jacobian(kin)
    x = DQ(kin.pose(name)) * x_ci
    # p = 2 D(x) P(x)*, so p' = 2 D(x') P(x)* + 2 D(x) P(x')*
    columns = [(2.0 * (DQ(c).D() * x.P().conj() + x.D() * DQ(c).P().conj())).vec4()[1:] for c in J.T]
    return np.array(columns).T


def test_partial_com_jacobians_of_the_reversed_chain(foot):
    """One per body, those of the stance leg included, against central differences."""
    robot = legs()
    for q in configurations(robot, 10, seed=3):
        kin = Kinematics(robot, q, foot)
        for index in range(len(robot.bodies)):
            name, com = frame_on(robot, index)
            expected = central_difference(lambda q, n=name, c=com: Kinematics(robot, q, foot).point(n, c), q)
            np.testing.assert_allclose(partial_com_jacobian(robot, kin, index), expected, atol=1e-9)
            np.testing.assert_allclose(kin.point_jacobian(name, com), expected, atol=1e-9)
    stance = [i for i, name in enumerate(robot.joint_names) if name[0] == foot.value[0]]
    shank = robot.frames[robot.soles[foot].frame].body
    shank = robot.bodies[shank].parent
    name, com = frame_on(robot, shank)
    moved = np.abs(kin.point_jacobian(name, com)).max(axis=0) > 1e-9
    assert moved[stance[-1]]  # the ankle moves the shank above it
    assert moved.sum() == 1  # and no other joint does: the chain is reversed


def test_the_base_is_at_rest(robot, foot):
    q = configurations(robot, 1)[0]
    kin = Kinematics(robot, q, foot)
    sole = robot.soles[foot].frame
    assert_equal_up_to_sign(kin.pose(sole), [1, 0, 0, 0, 0, 0, 0, 0], 1e-14)
    assert not Pose(sole).jacobian(kin).any()
    assert not Point(sole, np.ones(3)).jacobian(kin).any()


def test_mirror_image(robot, foot):
    """A mirrored robot on the other foot, at the same angles, has mirrored positions."""
    image = mirrored(robot)
    reflect = np.array([1.0, -1.0, 1.0])
    for q in configurations(robot, 10, seed=6):
        kin, other = Kinematics(robot, q, foot), Kinematics(image, q, foot.other)
        np.testing.assert_allclose(other.com, reflect * kin.com, atol=1e-13)
        np.testing.assert_allclose(other.com_jacobian, reflect[:, None] * kin.com_jacobian, atol=1e-13)
        for name in robot.frames:
            np.testing.assert_allclose(other.point(name), reflect * kin.point(name), atol=1e-13)


# ---------------------------------------------------------------------- against pinocchio


def pin_model(model):
    """Return the robot in `pin` with a free root (a fixed root has no mass there), and its joint order."""
    full = pin.buildModelFromXML(model.urdf, pin.JointModelFreeFlyer())
    locked = [full.getJointId(name) for name in full.names[2:] if name not in model.joint_names]
    reduced = pin.buildReducedModel(full, locked, pin.neutral(full)) if locked else full
    order = [model.joint_names.index(name) for name in reduced.names[2:]]
    return reduced, order


PIN_ROBOTS = {
    "poppy": poppy,
    "locked": lambda: load_model(
        RobotConfig(lock=("abs_*", "bust_*", "head_*", "*_shoulder_*", "*_arm_*", "*_elbow_*"))
    ),
    "biped12": biped12,
}


def skew(v):
    return np.cross(v, np.eye(3)).T


@pytest.mark.parametrize("name", PIN_ROBOTS)
def test_com_and_frames_agree_with_pin(name, foot):
    model = PIN_ROBOTS[name]()
    theirs, order = pin_model(model)
    assert theirs.nv == 6 + model.n
    data = theirs.createData()
    sole = theirs.getFrameId(model.soles[foot].frame)
    for q in configurations(model, 50, seed=9):
        kin = Kinematics(model, q, foot)
        v = np.concatenate([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], q[order]])
        pin.computeJointJacobians(theirs, data, v)
        pin.updateFramePlacements(theirs, data)
        J_com = pin.jacobianCenterOfMass(theirs, data, v)
        base = data.oMf[sole]
        J_base = pin.getFrameJacobian(theirs, data, sole, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)

        def in_sole_frame(p, J_p, base=base, J_base=J_base):
            """Return a point and its Jacobian in the frame of the sole, which moves in `pin`."""
            J = J_p - J_base[:3] + skew(p - base.translation) @ J_base[3:]  # w x r = -r x w
            ours = np.empty((3, model.n))
            ours[:, order] = base.rotation.T @ J[:, 6:]
            return base.rotation.T @ (p - base.translation), ours

        p, J = in_sole_frame(data.com[0], J_com)
        np.testing.assert_allclose(kin.com, p, atol=1e-9)
        np.testing.assert_allclose(kin.com_jacobian, J, atol=1e-9)
        assert model.mass == pytest.approx(pin.computeTotalMass(theirs), rel=1e-12)
        for frame in (model.soles[foot.other].frame, model.pelvis):
            index = theirs.getFrameId(frame)
            J_f = pin.getFrameJacobian(theirs, data, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            p, J = in_sole_frame(data.oMf[index].translation, J_f[:3])
            np.testing.assert_allclose(kin.point(frame), p, atol=1e-9)
            np.testing.assert_allclose(kin.point_jacobian(frame), J, atol=1e-9)
            turn = np.empty_like(J)
            turn[:, order] = base.rotation.T @ (J_f[3:] - J_base[3:])[:, 6:]
            np.testing.assert_allclose(kin.angular_jacobian(frame), turn, atol=1e-9)


# ---------------------------------------------------------------------- compiled and interpreted

PLAIN = """
import sys, numpy as np
sys.path.insert(0, "test/support")
from robots import legs, configurations
from dqwalk_ros.paper.features import Pose
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.foot import Foot
import numba
out = []
for q in configurations(legs(), 3, seed=10):
    for foot in Foot:
        k = Kinematics(legs(), q, foot)
        out += [k.com, k.com_jacobian, k.lines, k.pose(k.swing), Pose(k.swing).jacobian(k), k.point_jacobian("pelvis")]
print(int(numba.config.DISABLE_JIT), *(x.hex() for a in out for x in a.ravel().tolist()))
"""


@pytest.mark.long
def test_compiled_and_plain_kernels_agree():
    """NUMBA_DISABLE_JIT=1 runs the same functions as plain Python."""
    results = {}
    for plain in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": plain}
        root = Path(__file__).resolve().parents[2]
        command = [sys.executable, "-c", PLAIN]
        run = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, check=True)
        flag, *numbers = run.stdout.split()
        assert flag == plain
        results[plain] = np.array([float.fromhex(x) for x in numbers])
    assert results["0"].size > 1000
    np.testing.assert_allclose(results["1"], results["0"], rtol=0, atol=1e-14)
