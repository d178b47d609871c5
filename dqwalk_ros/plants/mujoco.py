"""The robot in the physics engine MuJoCo, with rectangular soles, friction, position servos and an inertial sensor.

The root link floats, and only the soles have contacts with the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics, quaternion_product
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY, gravity_torques
from dqwalk_ros.plants.base import Inertial, Plant, Truth, checked, upward
from dqwalk_ros.plants.sensors import Reading, Sensors
from dqwalk_ros.plants.servo_goals import ServoGoals
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import PlantError

__all__ = ["PhysicsPlant", "build", "held_torques", "robot_spec", "set_timestep"]


_THICK = 0.008
"""Thickness of the boxes of the soles [m]."""
_HELD = 1.5
"""Height at which the root link is held in the air [m]."""
_SOLID = [0.95, 0.99, 0.0005, 0.5, 2.0]
"""MuJoCo's contact impedance (solimp): full from a penetration of 0.5 mm on."""
_NO_ACCELERATION = np.zeros(3)


class PhysicsPlant(Plant):
    """The robot with position servos in MuJoCo.

    Parameters
    ----------
    q0 : array_like, shape (n,), optional
        Initial joint angles, with both soles on the ground, or held by its root [rad]; zero by default.
    servos : Servos, optional
        The simulated servos; by default those of the section ``servo``.
    law : ServoGoals, optional
        Computes the goals of the servos; by default as the section ``servo`` describes it.
    """

    physics = True
    parameters = "physics"

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        q0: ArrayLike | None = None,
        servos: Servos | None = None,
        law: ServoGoals | None = None,
    ) -> None:
        self.config, self.model = config, model
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        servos = servos or Servos.of(config, model)
        self.mj = build(config, model, servos)
        self.data: Any = mujoco.MjData(self.mj)
        self._qpos, self._qvel = self.data.qpos, self.data.qvel  # views, and so are these
        self._xpos, self._xquat, self._xmat = self.data.xpos, self.data.xquat, self.data.xmat
        self._cvel = self.data.cvel
        self._sensed, self._torque = self.data.sensordata, self.data.qfrc_actuator
        joints = [self.mj.joint(name) for name in model.joint_names]
        self._qadr = np.array([int(j.qposadr[0]) for j in joints])
        self._vadr = np.array([int(j.dofadr[0]) for j in joints])
        self._root = self.mj.body(model.root).id
        self._pelvis = self.mj.body(model.pelvis).id
        self._imu = self.mj.body(model.imu_link).id
        mounting = DQ(model.frames[model.imu_link].pose).conj() * DQ(model.frames[model.imu].pose)
        self._mounting = mounting.vec4()
        self._to_sensor = np.ascontiguousarray(mounting.rotation_matrix().T)
        self._soles = {foot: self.mj.body(model.soles[foot].frame).id for foot in Foot}
        self._ground = {foot: self.mj.sensor(f"ground_{foot.value}").adr[0] for foot in Foot}
        self._goals = self.data.ctrl.reshape(-1, model.n)  # a view; a second row where there is backlash
        # without these torques the robot would tip backwards on soft servos before the first command
        up = -self.mj.opt.gravity / GRAVITY
        standing = Kinematics(model, q, Foot.LEFT, up)
        effort = np.zeros(model.n) if config.physics.held else gravity_torques(standing, both=True)
        self._seat(q)
        self._back_emf = servos.back_emf
        self._law = law or ServoGoals.of(config, model, simulated=servos)
        self._law.gate.use(q, 0.0)
        self._law.begin(effort)
        self._goals[:] = self._law.output(0.0)[0]
        self._sensors = Sensors(config.sensors)
        self._level = _level(config)
        self._elapsed = 0.0  # [ns]
        self._dt, self._count = config.dt, set_timestep(self.mj, config.dt, config.physics.timestep)
        mujoco.mj_step(self.mj, self.data, max(1, round(config.physics.settle / self.mj.opt.timestep)))
        mujoco.mj_step1(self.mj, self.data)
        self._effort = self._torque[self._vadr] - self._back_emf * self._qvel[self._vadr]
        self._state = self._measured()

    @property
    def state(self) -> State:
        """The present state as measured by the robot's sensors."""
        return self._state

    def step(self, command: Command, dt: float) -> State:
        """Return the state after one period, which the engine's steps divide evenly.

        Raises
        ------
        PlantError
            If the command has a wrong size or is not finite, or the simulation has diverged.
        """
        u, tau = checked(command.velocity, self.model.n, "velocities"), command.effort
        if tau is not None:
            tau = checked(tau, self.model.n, "torques")
        return self._advance(u, tau, dt)

    def hold(self, dt: float) -> State:
        """Return the state after one period without a command."""
        return self._advance(None, None, dt)

    def _advance(self, u: Array | None, tau: Array | None, dt: float) -> State:
        mj, data = self.mj, self.data
        if dt != self._dt:
            self._dt, self._count = dt, set_timestep(mj, dt, self.config.physics.timestep)
        left = count = self._count
        h, now = dt / count, data.time
        self._law.measure(self._state.q, now)
        if u is not None:
            self._law.command(u, tau, now, dt)
        q, torque = self._qpos[self._qadr], np.zeros_like(self._qvel)
        while left:
            self._goals[:], until = self._law.output(now)
            steps = min(left, max(1, math.ceil((until - now) / h - 1e-6))) if until < math.inf else left
            for _ in range(steps):
                # mj_step1 has computed positions and velocities already; mj_step2 applies the forces
                mujoco.mj_step2(mj, data)
                torque += self._torque
                mujoco.mj_step1(mj, data)
            left, now = left - steps, data.time
        self._effort = (torque[self._vadr] - self._back_emf * (self._qpos[self._qadr] - q) / h) / count
        if not math.isfinite(self._qpos.dot(self._qpos)):
            raise PlantError("the simulation is not finite any more")
        self._elapsed += dt * 1e9
        self._state = self._measured()
        return self._state

    def push(self, force: ArrayLike) -> None:
        """Push the pelvis with `force` (3,) [N] in world axes until the next call."""
        self.data.xfrc_applied[self._pelvis, :3] = np.asarray(force, dtype=np.float64)

    @property
    def commanded(self) -> Array:
        """Commanded positions without the offsets by feedforward torques, shape (n,) [rad]."""
        return self._law.wanted

    @property
    def truth(self) -> Truth:
        """Ground truth; forces are those of the engine's last step, torques the mean of the last period."""
        soles = {foot: self._pose(body) for foot, body in self._soles.items()}
        return Truth(
            pelvis=self._pose(self._pelvis),
            soles=soles,
            wrenches={foot: self._wrench(foot) for foot in Foot},
            com=self.data.subtree_com[self._root].copy(),
            q=self._qpos[self._qadr],
            effort=self._effort,
        )

    @property
    def inertial(self) -> Inertial:
        """Measurements of the inertial sensor."""
        r = self._reading
        return replace(r, acceleration=self._acceleration()) if self._sensors.exact else r

    @property
    def fallen(self) -> bool:
        """Whether the root link is below 60 % of its initial height or is inclined by more than 60 degrees."""
        return bool(self._xpos[self._root, 2] < 0.6 * self._height or self._xmat[self._root, 8] < 0.5)

    def _measured(self) -> State:
        orientation, gyro = _imu(
            self._level, self._xquat[self._imu], self._mounting, self._xmat[self._imu], self._to_sensor,
            self._cvel[self._imu],
        )  # fmt: skip
        time = round(self._elapsed) * 1e-9  # rounded to nanoseconds, like a ROS stamp
        q, dq = self._qpos[self._qadr], self._qvel[self._vadr]
        # the acceleration of an exact sensor is computed only when `inertial` is read
        acceleration = _NO_ACCELERATION if self._sensors.exact else self._acceleration()
        exact = Reading(orientation, gyro, acceleration, q, dq)
        r = self._reading = self._sensors.measure(time, exact)
        felt = None if self._sensors.exact else r.acceleration
        return State(time, r.q, r.dq, upward(*r.orientation.tolist()), r.gyro, felt)

    def _acceleration(self) -> Array:
        out = np.empty(6)
        mujoco.mj_rnePostConstraint(self.mj, self.data)
        mujoco.mj_objectAcceleration(self.mj, self.data, mujoco.mjtObj.mjOBJ_XBODY, self._imu, out, 1)
        felt: Array = self._to_sensor @ out[3:]
        return felt

    def _seat(self, q: Array) -> None:
        """Set the initial pose, with the left sole flat on the floor, unless the root link is held in the air."""
        self.data.qpos[self._qadr] = q
        if self.config.physics.held:
            self._height = -math.inf  # it cannot fall
            mujoco.mj_forward(self.mj, self.data)
            return
        kin = Kinematics(self.model, q, Foot.LEFT)
        x = DQ(kin.pose(self.model.root))
        p, r = x.translation(), x.vec8()[:4]
        other = kin.point(kin.swing)
        self.data.qpos[:3] = p + np.array([0.0, -0.5 * other[1], 0.0005])
        self.data.qpos[3:7] = r
        mujoco.mj_forward(self.mj, self.data)
        self._height = float(self.data.xpos[self._root][2])

    def _pose(self, body: int) -> Array:
        x: Array = _pose(self._xpos[body], self._xquat[body])
        return x

    def _wrench(self, foot: Foot) -> Array:
        """Return the force and torque of the ground about the sole's origin in its axes, shape (6,)."""
        body, sensor = self._soles[foot], self._ground[foot]
        wrench: Array = _moved_wrench(self._sensed[sensor : sensor + 9], self._xpos[body], self._xmat[body])
        return wrench


@jit
def _imu(level, link, mounting, R, to_sensor, velocity):  # type: ignore[no-untyped-def]
    """Return the orientation (4,) of the inertial sensor in a level world, and its angular velocity in its axes (3,).

    `level`, `link` and `mounting` (4,) are the orientations of the floor, of the link on the floor, and of the sensor
    on the link; `R` (9,), by row, is that of the link too. The first three numbers of `velocity` (6,) are the angular
    velocity in world axes.
    """
    a = quaternion_product(level[0], level[1], level[2], level[3], link[0], link[1], link[2], link[3])
    b = quaternion_product(a[0], a[1], a[2], a[3], mounting[0], mounting[1], mounting[2], mounting[3])
    return np.array(b), to_sensor @ (R.reshape((3, 3)).T @ velocity[:3])


@jit
def _pose(p, r):  # type: ignore[no-untyped-def]
    """Return the pose r + eps 1/2 p r of (U1), shape (8,)."""
    x = np.empty(8)
    x[:4] = r
    x[4:] = quaternion_product(0.0, 0.5 * p[0], 0.5 * p[1], 0.5 * p[2], r[0], r[1], r[2], r[3])
    return x


@jit
def _moved_wrench(measured, p, R):  # type: ignore[no-untyped-def]
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
    mj : mujoco.MjModel
    dt : float
        Period [s].
    largest : float
        Largest time step [s].
    """
    count = max(1, math.ceil(dt / largest - 1e-6))
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
    if held:
        spec.body(model.root).pos = [0.0, 0.0, _HELD]
    else:
        spec.body(model.root).add_freejoint(name="root")
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
        mujoco.mju_rotVecQuat(spec.option.gravity, [0.0, 0.0, -GRAVITY], DQ(_level(config)).conj().vec4())
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
        if c.rubble > 0.0:
            _add_rubble(spec, c.rubble, config.sensors.seed)
        for foot in Foot:
            _add_ground_sensor(spec, foot)
        if scenery is not None:
            scenery(spec)
        return spec.compile()
    except ValueError as error:
        raise PlantError(f"MuJoCo refuses the robot: {error}") from error


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
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
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


def _add_rubble(spec: Any, height: float, seed: int) -> None:
    """Add boxes of random size, up to `height` [m] high, to the floor ahead of and behind the robot."""
    random, floor = np.random.default_rng(seed), spec.geom("floor")
    for x in np.arange(-1.0, 1.5, 0.06):
        for y in np.arange(-0.3, 0.31, 0.06):
            if abs(x) < 0.2:
                continue  # the robot starts here
            half = [*random.uniform(0.01, 0.03, 2), 0.5 * height * random.uniform()]
            turn = random.uniform(0.0, np.pi)
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=half,
                pos=[x + random.uniform(-0.01, 0.01), y + random.uniform(-0.01, 0.01), half[2]],
                quat=[np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)],
                rgba=floor.rgba,
                friction=floor.friction,
                solref=floor.solref,
                solimp=floor.solimp,
                contype=floor.contype,
                conaffinity=floor.conaffinity,
            )


def _level(config: Config) -> Array:
    """Return the orientation (4,) of the floor, which is the simulation's world frame, relative to the level."""
    c = config.physics
    return (DQ.rotation_about(-c.slope, [0.0, 1.0, 0.0]) * DQ.rotation_about(c.slope_side, [1.0, 0.0, 0.0])).vec4()
