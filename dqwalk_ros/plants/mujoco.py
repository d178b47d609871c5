"""The robot in the physics engine MuJoCo, with rectangular soles, friction and position servos."""

from __future__ import annotations

import os
import pathlib
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.plants.engine import HELD, Box, EnginePlant, floor_of, gravity_of, pose_of, slope_of, steps_of
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.robot.shapes import make_convex
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import ModelError, PlantError

_THICK = 0.008
"""Thickness of the boxes of the soles [m]."""
_SOLID = [0.95, 0.99, 0.0005, 0.5, 2.0]
"""MuJoCo's contact impedance (solimp): full from a penetration of 0.5 mm on."""


_SHADES = [[0.66, 0.71, 0.78, 1.0], [0.78, 0.82, 0.87, 1.0]]
"""Colours of boxes on the floor."""
_LEAST_FRICTION = 0.01
"""Least friction with which a stiffness of the contact can be specified: its pyramid must have a width."""
_IMPEDANCE = 0.9
"""Constant contact impedance where the contact is specified in physical terms."""
_PLACE = 1e-3
"""Largest distance from a point of axes that pass through it [m]."""


class PhysicsPlant(EnginePlant):
    """The robot in MuJoCo."""

    def _make(self, servos: Servos) -> None:
        model = self.model
        self.mj = build(self.config, model, servos)
        self.data: Any = mujoco.MjData(self.mj)
        # views into the data of the engine
        self._qpos, self._qvel = self.data.qpos, self.data.qvel
        self._xpos, self._xquat, self._xmat = self.data.xpos, self.data.xquat, self.data.xmat
        self._sensed, self._torque = self.data.sensordata, self.data.qfrc_actuator
        joints = [self.mj.joint(name) for name in model.joint_names]
        self._qadr = np.array([int(j.qposadr[0]) for j in joints])
        self._vadr = np.array([int(j.dofadr[0]) for j in joints])
        root, self._pelvis_id, self._imu = (
            self.mj.body(link).id for link in (model.root, model.pelvis, model.imu_link)
        )
        self._imu_orientation, self._imu_axes = self._xquat[self._imu], self._xmat[self._imu].reshape(3, 3)
        self._imu_turning, self._center = self.data.cvel[self._imu, :3], self.data.subtree_com[root]
        self._bodies = {link: self.mj.body(link).id for link in (model.pelvis, *(model.soles[f].frame for f in Foot))}
        self._ground = {foot: self.mj.sensor(f"ground_{foot.value}").adr[0] for foot in Foot}
        self._goals = self.data.ctrl.reshape(-1, model.n)  # a view; a second row where there is backlash

    def _seat(self, q: Array, root: Array | None) -> None:
        self._qpos[self._qadr] = q
        if root is not None:
            self._qpos[:3], self._qpos[3:7] = DQ(root).translation(), root[:4]
        mujoco.mj_forward(self.mj, self.data)

    def _divide(self, dt: float) -> int:
        return set_timestep(self.mj, dt, self.config.physics.timestep)

    @property
    def _time(self) -> float:
        time: float = self.data.time
        return time

    def _run(self, goals: Array, steps: int) -> Array:
        mj, data, torque = self.mj, self.data, np.zeros(len(self._torque))
        self._goals[:] = goals
        step = mujoco.mj_step2  # mj_step1 has computed positions and velocities already; mj_step does both
        for _ in range(steps):
            step(mj, data)
            torque += self._torque
            step = mujoco.mj_step
        mujoco.mj_step1(mj, data)
        return torque.take(self._vadr)

    def push(self, force: ArrayLike, link: str = "") -> None:
        """Push a link; see `Plant.push`."""
        self.data.xfrc_applied[:] = 0.0
        self.data.xfrc_applied[self.mj.body(link or self.model.pelvis).id, :3] = np.asarray(force, dtype=np.float64)

    def _joints(self) -> tuple[Array, Array]:
        return self._qpos.take(self._qadr), self._qvel.take(self._vadr)

    def _imu_motion(self) -> tuple[Array, Array, Array]:
        return self._imu_orientation, self._imu_turning, self._imu_axes

    def _acceleration(self) -> Array:
        out = np.empty(6)
        mujoco.mj_rnePostConstraint(self.mj, self.data)
        mujoco.mj_objectAcceleration(self.mj, self.data, mujoco.mjtObj.mjOBJ_XBODY, self._imu, out, 1)
        return out[3:]

    def _pose(self, link: str) -> Array:
        body = self._bodies[link]
        x: Array = pose_of(self._xpos[body], self._xquat[body])
        return x

    def _height_of(self, link: str) -> float:
        return float(self._xpos[self._bodies[link], 2])

    def _wrench(self, foot: Foot) -> Array:
        body, sensor = self._bodies[self.model.soles[foot].frame], self._ground[foot]
        wrench: Array = _moved_wrench(self._sensed[sensor : sensor + 9], self._xpos[body], self._xmat[body])
        return wrench

    @property
    def _com(self) -> Array:
        com: Array = self._center.copy()
        return com

    def _floor_normal(self) -> Array:
        normal: Array = self._xmat[self._pelvis_id, 6:].copy()
        return normal


@jit
def _moved_wrench(measured: Array, p: Array, R: Array) -> Array:
    """Return a force and torque (6,) about the point p (3,) in the axes R (9,), by row.

    `measured` (9,) are force and torque with the opposite sign, and the point at which they act, in world axes.
    """
    force, at = -measured[:3], measured[6:]
    torque = np.cross(at - p, force) - measured[3:6]
    to_axes = R.reshape((3, 3)).T
    return np.concatenate((to_axes @ force, to_axes @ torque))


def set_timestep(mj: Any, dt: float, largest: float) -> int:
    """Set the time step of a MuJoCo model to an integer fraction of a period, and return the number of steps.

    Engine and state would drift apart if the steps did not add up to the period.

    Parameters
    ----------
    dt : float
        Period [s].
    largest : float
        Largest time step [s].
    """
    count = steps_of(dt, largest)
    mj.opt.timestep = dt / count
    return count


def robot_spec(model: RobotModel, *, friction: float, contact_time: float, held: bool = False) -> Any:
    """Return a MuJoCo specification of the robot on a floor, without actuators; the caller may extend it.

    Parameters
    ----------
    friction : float
        Friction coefficient of soles and floor.
    contact_time : float
        Time constant of the contact between soles and floor [s].
    held : bool
        Whether the root link is held in the air instead of floating.
    """
    # MuJoCo discards the shapes added for pictures unless the file itself contains this option
    keep = '<mujoco><compiler discardvisual="false"/></mujoco></robot>'
    spec = mujoco.MjSpec.from_string(model.urdf_without_shapes.replace("</robot>", keep))
    spec.compiler.inertiafromgeom = 0  # masses are those of the URDF, not of the geometries
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # divergence must be detected, not reset
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    if held:
        spec.body(model.root).pos = [0.0, 0.0, HELD]
    else:
        spec.body(model.root).add_freejoint()
    for joint in spec.joints:
        joint.actfrclimited = False  # the reader takes it from the URDF; torques are limited by what drives the joint
    touching = {"friction": [friction, 0.005, 0.0001], "solref": [contact_time, 1.0], "solimp": _SOLID}
    for foot in Foot:
        sole = model.soles[foot]
        spec.body(sole.frame).add_geom(
            name=f"sole_{foot.value}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.5 * sole.length, 0.5 * sole.width, 0.5 * _THICK],
            pos=[*sole.center[:2], 0.5 * _THICK],
            mass=0.0,
            contype=1,
            conaffinity=2,
            rgba=[0.2, 0.21, 0.23, 1.0],
            **touching,
        )
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[20.0, 20.0, 0.1],
        contype=2,
        conaffinity=1,
        rgba=[0.86, 0.88, 0.9, 1.0],
        **touching,
    )
    return spec


def build(
    config: Config,
    model: RobotModel,
    servos: Servos | None = None,
    *,
    scenery: Callable[[Any], None] | None = None,
) -> Any:
    """Return the MuJoCo model of the robot, its servos and the floor.

    Parameters
    ----------
    servos : Servos, optional
        As ``servo`` describes them without it.
    scenery : callable, optional
        Called with the specification, to add elements for pictures.

    Raises
    ------
    PlantError
        If MuJoCo cannot compile the model.
    """
    c, s = config.physics, servos or Servos.of(config, model)
    play = 0.5 * s.stiffness * s.backlash  # [N m]
    try:
        spec = robot_spec(model, friction=c.friction, contact_time=c.contact_time, held=c.held)
        spec.option.timestep = c.timestep
        if c.cone == "elliptic":
            spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.gravity = gravity_of(slope_of(config))
        for body in spec.bodies:
            body.mass *= c.mass_scale
            body.inertia, body.fullinertia = body.inertia * c.mass_scale, body.fullinertia * c.mass_scale
        for k, name in enumerate(model.joint_names):
            joint = spec.joint(name)
            joint.damping[0], joint.armature, joint.frictionloss = s.back_emf[k], s.armature[k], s.friction[k]
            joint.limited = False
            _add_spring(spec, name, s.stiffness[k], s.damping[k], s.torque[k] + play[k])
        if play.any():
            # zero torque within the backlash b: K (e - clip(e, -b/2, b/2)) is a positive plus a negative spring
            for k, name in enumerate(model.joint_names):
                _add_spring(spec, name, -s.stiffness[k], 0.0, play[k])
        floor, boxes = floor_of(config)
        spec.geom("floor").pos = [0.0, 0.0, floor]
        _add_boxes(spec, boxes)
        for foot in Foot:
            _add_ground_sensor(spec, foot)
        if scenery is not None:
            scenery(spec)
        mj = spec.compile()
    except ValueError as error:
        raise PlantError(f"MuJoCo refuses the robot: {error}") from error
    if c.contact_stiffness > 0.0:
        if c.friction < _LEAST_FRICTION:
            raise PlantError(f"physics.contact_stiffness needs, in MuJoCo, physics.friction >= {_LEAST_FRICTION}")
        _set_contact(mj, mj.body(model.soles[Foot.LEFT].frame).id, c.contact_stiffness, 2.0 * c.contact_time)
    return mj


def _set_contact(mj: Any, body: int, stiffness: float, relaxation: float) -> None:
    """Give all contacts a constant stiffness K [N/m], and a damping of K times `relaxation` [s].

    MuJoCo's reference acceleration of a constraint is -b v - k d r; under a force f it deviates from this by R f.
    With a constant impedance d, R = A (1 - d)/d, where A is the approximate inverse inertia of the `body`. A contact
    has four constraints, the edges of a pyramid of friction mu, whose A is 1 + mu^2 times that, and whose R is 2 mu^2
    times that of the first. So K = 2 k d^2 / (mu^2 (1 + mu^2) (1 - d) A).
    """
    d, mu = _IMPEDANCE, float(mj.geom_friction[mj.body_geomadr[body], 0])
    A = mu**2 * (1.0 + mu**2) * (1.0 - d) * float(mj.body_invweight0[body, 0])
    k = 0.5 * stiffness * A / d**2
    b = relaxation * k * d
    mj.geom_solimp[:] = [d, d, 0.001, 0.5, 2.0]
    mj.geom_solref[:] = [-k * d**2, -b * d]  # MuJoCo divides them by d^2 and d


def own_contacts(model: RobotModel, q: Array, near: str | os.PathLike[str] = ".") -> Counter[str]:
    """Return in how many of the states q (N, n) links of the robot touch each other, by pairs as ``l_foot, r_foot``.

    The shapes are the collision shapes of the URDF, whose path is `near`; those of meshes are their convex hulls. Links
    that a joint or joints at one place connect, such as those of a hip, and pairs that touch in the first state are not
    counted.

    Raises
    ------
    PlantError
        If a mesh is not available, or MuJoCo cannot read the shapes.
    """
    try:
        urdf = Urdf(model.urdf, model.name)
        files = make_convex(urdf, pathlib.Path(near))
        spec = mujoco.MjSpec.from_string(urdf.text(), assets=files)
        spec.compiler.fusestatic, spec.compiler.balanceinertia = False, True  # nothing moves
        mj = spec.compile()
    except (ValueError, ModelError) as error:
        raise PlantError(f"MuJoCo refuses the shapes of the robot: {error}") from error
    data, found = mujoco.MjData(mj), Counter[str]()
    at = [int(mj.joint(name).qposadr[0]) for name in model.joint_names]
    names = [mj.body(int(body)).name for body in mj.geom_bodyid]
    first: set[str] = set()
    for k, angles in enumerate(q):
        data.qpos[at] = angles
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_collision(mj, data)
        pairs = {", ".join(sorted(names[geom] for geom in contact)) for contact in data.contact.geom}
        first = first if k else pairs
        found.update(pairs - first)
    return Counter({pair: count for pair, count in found.items() if not _at_one_place(mj, pair.split(", "))})


def _at_one_place(mj: Any, pair: Sequence[str]) -> bool:
    """Return whether the axes of all joints between two bodies pass through one point."""
    data, chains = mujoco.MjData(mj), []
    mujoco.mj_kinematics(mj, data)
    for name in pair:
        chain, body = set(), int(mj.body(name).id)
        while body:
            chain.add(body)
            body = int(mj.body_parentid[body])
        chains.append(chain)
    between = [joint for joint in range(mj.njnt) if int(mj.jnt_bodyid[joint]) in chains[0] ^ chains[1]]
    across = np.eye(3) - data.xaxis[between, :, None] * data.xaxis[between, None, :]
    anchors = across @ data.xanchor[between, :, None]
    point = np.linalg.pinv(across.sum(axis=0)) @ anchors.sum(axis=0)  # of least squares
    return bool((np.linalg.norm(across @ point - anchors, axis=1) < _PLACE).all())


def held_torques(model: RobotModel, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array]:
    """Return what moves the joints of a robot that is held by its root, level: torques, and inertias about the joints.

    Parameters
    ----------
    q, dq, ddq : ndarray, shape (N, n)
        [rad, rad/s, rad/s^2]

    Returns
    -------
    tuple of ndarray, shape (N, n)
        Torques [N m] and diagonals of the mass matrix [kg m^2], both without the rotors.
    """
    spec = robot_spec(model, friction=0.0, contact_time=0.01, held=True)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for name in model.joint_names:
        joint = spec.joint(name)
        joint.damping[0], joint.armature, joint.frictionloss = 0.0, 0.0, 0.0
    mj = spec.compile()
    data = mujoco.MjData(mj)
    at = [int(mj.joint(name).dofadr[0]) for name in model.joint_names]
    tau, inertia, full = np.empty_like(q), np.empty_like(q), np.empty((mj.nv, mj.nv))
    for k in range(len(q)):
        data.qpos[at], data.qvel[at], data.qacc[at] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(mj, data)
        mujoco.mj_fullM(mj, data, full)
        tau[k], inertia[k] = data.qfrc_inverse[at], full.diagonal()[at]
    return tau, inertia


def _add_spring(spec: Any, joint: str, stiffness: float, damping: float, limit: float) -> None:
    """Add an actuator to a joint, with the torque clip(K e - D dq, -limit, limit), e from the control."""
    act = spec.add_actuator(target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    act.gainprm[0] = stiffness
    act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    act.biasprm[1], act.biasprm[2] = -stiffness, -damping
    act.forcelimited, act.forcerange = True, [-limit, limit]


def _add_ground_sensor(spec: Any, foot: Foot) -> None:
    """Add a sensor of the net force, torque and centre of all contacts of a sole, in world axes."""
    field = mujoco.mjtConDataField
    wanted = sum(1 << int(f) for f in (field.mjCONDATA_FORCE, field.mjCONDATA_TORQUE, field.mjCONDATA_POS))
    net_force = 3  # the reduction to a single wrench
    spec.add_sensor(
        name=f"ground_{foot.value}",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=f"sole_{foot.value}",
        intprm=[wanted, net_force, 1],
    )


def _add_boxes(spec: Any, boxes: list[Box]) -> None:
    """Add boxes that touch as the floor does, in two shades, so that their edges are seen."""
    floor = spec.geom("floor")
    for k, box in enumerate(boxes):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=box.half,
            pos=box.at,
            quat=[np.cos(0.5 * box.turn), 0.0, 0.0, np.sin(0.5 * box.turn)],
            rgba=_SHADES[k % 2],
            friction=floor.friction,
            solref=floor.solref,
            solimp=floor.solimp,
            contype=floor.contype,
            conaffinity=floor.conaffinity,
        )
