"""The robot in a physics engine (MuJoCo): true soles, friction, position servos and an inertial sensor.

The URDF is loaded as it is: links without mass stay massless, joints that the model does not move are held, the
pelvis floats. What a real robot cannot measure (`PhysicsPlant.truth`) is for analysis only.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command, State
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PlantError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.plants.scenery import add_scenery, with_visual_shapes
from dqwalk_ros.plants.servos import Servos
from dqwalk_ros.plants.truth import Inertial, Truth, upward

__all__ = ["PhysicsPlant", "Truth", "compiled"]

Array = NDArray[np.float64]

_HELD = 300.0
"""Stiffness of the joints that the model does not move [N m/rad]."""


class PhysicsPlant:
    """MuJoCo behind the servos.

    Parameters
    ----------
    config : Config
    model : RobotModel
    q0 : array_like, shape (n,), optional
        Where it begins, on both soles [rad]; all zero without it.
    """

    def __init__(self, config: Config, model: RobotModel, q0: ArrayLike | None = None) -> None:
        self.config, self.model = config, model
        c = config.physics
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        self.mj = compiled(config, model)
        self.data: Any = mujoco.MjData(self.mj)
        self._substeps = max(1, round(config.dt / self.mj.opt.timestep))
        joints = [self.mj.joint(name) for name in model.joint_names]
        self._qadr = np.array([int(j.qposadr[0]) for j in joints])
        self._vadr = np.array([int(j.dofadr[0]) for j in joints])
        self._act = np.array([self.mj.actuator(name).id for name in model.joint_names])
        self._root = self.mj.body(model.root).id
        self._sole = {foot: self.mj.geom(f"sole_{foot.value}").id for foot in Foot}
        self._sole_body = {foot: self.mj.body(model.soles[foot].frame).id for foot in Foot}
        self._floor = self.mj.geom("floor").id
        self._imu = self.mj.body(c.imu).id
        self._pelvis = self.mj.body(model.pelvis).id
        self._seat(q)
        self._servos = Servos(config.servo, q, model.q_min, model.q_max)
        self._bias = np.zeros(model.n)
        self.data.ctrl[self._act] = q
        for _ in range(round(c.settle / self.mj.opt.timestep)):
            mujoco.mj_step(self.mj, self.data)
        self._seen: Any = mujoco.MjData(self.mj)  # a copy to look at: looking changes nothing of the walk
        self._seen_at = -1
        self._time0, self._ticks = float(self.data.time), 0
        self._state = self._measured()

    @property
    def state(self) -> State:
        """The state now, as the robot's sensors have it."""
        return self._state

    def step(self, command: Command, dt: float) -> State:
        """Return the state one period later.

        Raises
        ------
        PlantError
            If the command does not fit, or the simulation has gone astray.
        """
        u = np.asarray(command.velocity, dtype=np.float64)
        if u.shape != (self.model.n,) or not np.isfinite(u).all():
            raise PlantError(f"the command must have {self.model.n} finite velocities, got {u}")
        if command.effort is not None:
            tau = np.asarray(command.effort, dtype=np.float64)
            if tau.shape != u.shape or not np.isfinite(tau).all():
                raise PlantError(f"the command must have {self.model.n} finite torques, got {tau}")
            command = Command(command.time, u, np.clip(tau, -self.model.effort_max, self.model.effort_max))
        now = float(self.data.time)
        self._servos.command(command, self._state.q, now, dt)
        for _ in range(max(1, round(dt / self.mj.opt.timestep))):
            self._drive(self._servos.output(float(self.data.time)))
            mujoco.mj_step(self.mj, self.data)
        if not np.isfinite(self.data.qpos).all():
            raise PlantError("the simulation is not finite any more")
        self._ticks += 1
        self._state = self._measured()
        return self._state

    def push(self, force: ArrayLike) -> None:
        """Push the pelvis with `force` (3,) [N] in world axes until the next call."""
        self.data.xfrc_applied[self._root, :3] = np.asarray(force, dtype=np.float64)

    @property
    def commanded(self) -> Array:
        """Positions that the servos are told, without the sag, shape (n,) [rad]."""
        return self._servos.wanted

    @property
    def truth(self) -> Truth:
        """What no sensor measures."""
        data = self._look()
        soles = {foot: self._pose(data, body) for foot, body in self._sole_body.items()}
        wrenches = {foot: self._wrench(data, foot) for foot in Foot}
        pelvis = self._pose(data, self._pelvis)
        return Truth(pelvis, soles, wrenches, np.array(data.subtree_com[self._root]))

    @property
    def inertial(self) -> Inertial:
        """What the inertial sensor says, without noise."""
        data = self._look()
        acceleration = np.empty(6)
        mujoco.mj_objectAcceleration(self.mj, data, mujoco.mjtObj.mjOBJ_XBODY, self._imu, acceleration, 1)
        gyro = self._state.gyro
        assert gyro is not None  # it is measured with every state
        return Inertial(self._orientation, gyro, acceleration[3:])

    @property
    def fallen(self) -> bool:
        """Whether the pelvis has come down to 60 % of its first height or leans by more than 60 degrees."""
        up = self.data.xmat[self._root].reshape(3, 3)[2, 2]
        return bool(self.data.xpos[self._root][2] < 0.6 * self._height or up < 0.5)

    # ------------------------------------------------------------------ inside

    def _drive(self, position: Array) -> None:
        gap = self.config.servo.backlash
        if gap > 0.0:
            # no torque within the play of the gears
            q = self.data.qpos[self._qadr]
            e = position - q
            position = q + np.sign(e) * np.maximum(np.abs(e) - 0.5 * gap, 0.0)
        self.data.ctrl[self._act] = position

    def _measured(self) -> State:
        self._orientation = self.data.xquat[self._imu].copy()
        gyro = np.empty(6)
        mujoco.mj_objectVelocity(self.mj, self.data, mujoco.mjtObj.mjOBJ_XBODY, self._imu, gyro, 1)
        return State(
            time=round(self._ticks * self.config.dt * 1e9) * 1e-9,  # as a stamp of ROS has it
            q=self.data.qpos[self._qadr].copy(),
            dq=self.data.qvel[self._vadr].copy(),
            up=upward(*self._orientation.tolist()),
            gyro=gyro[:3].copy(),
        )

    def _seat(self, q: Array) -> None:
        """Put the left sole flat on the floor."""
        kin = Kinematics(self.model, q, Foot.LEFT)
        x = DQ(kin.pose(self.model.root))
        p, r = x.translation(), x.vec8()[:4]
        other = kin.point(kin.swing)
        self.data.qpos[:3] = p + np.array([0.0, -0.5 * other[1], 0.0005])
        self.data.qpos[3:7] = r
        self.data.qpos[self._qadr] = q
        mujoco.mj_forward(self.mj, self.data)
        self._height = float(self.data.xpos[self._root][2])

    def _look(self) -> Any:
        """Return a copy of the world with all forces and accelerations of this very moment."""
        if self._seen_at != self._ticks:
            self._seen_at = self._ticks
            mujoco.mj_copyData(self._seen, self.mj, self.data)
            mujoco.mj_forward(self.mj, self._seen)
            mujoco.mj_rnePostConstraint(self.mj, self._seen)
        return self._seen

    def _pose(self, data: Any, body: int) -> Array:
        return DQ.from_pose(data.xpos[body], data.xquat[body]).vec8()

    def _wrench(self, data: Any, foot: Foot) -> Array:
        geom, body = self._sole[foot], self._sole_body[foot]
        pairs = data.contact.geom[: data.ncon]
        mine = (pairs == geom).any(axis=1) & (pairs == self._floor).any(axis=1)
        force, one = np.zeros((data.ncon, 3)), np.empty(6)
        for k in np.flatnonzero(mine):
            mujoco.mj_contactForce(self.mj, data, k, one)
            force[k] = one[:3]
        frames = data.contact.frame[: data.ncon].reshape(-1, 3, 3)
        sign = np.where(pairs[:, 0] == self._floor, 1.0, -1.0)
        force = sign[:, None] * np.einsum("kij,ki->kj", frames, force)
        torque = np.cross(data.contact.pos[: data.ncon] - data.xpos[body], force)
        R = data.xmat[body].reshape(3, 3)
        return np.concatenate([force.sum(axis=0) @ R, torque.sum(axis=0) @ R])


def compiled(config: Config, model: RobotModel, *, seen: bool = False) -> Any:
    """Return the MuJoCo model of the robot, its servos and the floor.

    Parameters
    ----------
    config : Config
    model : RobotModel
    seen : bool
        For pictures: with the visual shapes of the URDF, a sky and a ruled floor. What the geometry that collides looks
        like is in group 0 then, all else in group 2.

    Raises
    ------
    PlantError
        If MuJoCo refuses the robot.
    """
    c, s = config.physics, config.servo
    spec = mujoco.MjSpec.from_string(with_visual_shapes(model.urdf) if seen else model.urdf)
    spec.compiler.inertiafromgeom = 0  # the soles have no mass; none may be made up
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.6] * 3
    spec.option.timestep = c.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    root = spec.body(model.root)
    if root is None:
        raise PlantError(f"the URDF has no link '{model.root}'")
    root.add_freejoint(name="root")
    for body in list(spec.bodies):  # what the model has dropped is not there
        if body.name not in ("world", *model.frames) and (
            body.parent is None or body.parent.name in ("world", *model.frames)
        ):
            spec.delete(body)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0  # only soles touch
    for foot in Foot:
        sole = model.soles[foot]
        body = spec.body(sole.frame)
        half = [0.5 * sole.length, 0.5 * sole.width, 0.5 * _THICK]
        place = [*sole.center[:2], 0.5 * _THICK]
        body.add_geom(
            name=f"sole_{foot.value}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=place, mass=0.0,
            friction=[c.friction, 0.005, 0.0001], contype=1, conaffinity=2, rgba=[0.2, 0.21, 0.23, 1.0], group=2,
            solref=[c.contact_time, 1.0], solimp=_SOLID,
        )  # fmt: skip
    floor = spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20.0, 20.0, 0.1], friction=[c.friction, 0.005, 0.0001],
        solref=[c.contact_time, 1.0], solimp=_SOLID, contype=2, conaffinity=1, rgba=[0.86, 0.88, 0.9, 1.0], group=2,
    )  # fmt: skip
    if seen:
        add_scenery(spec, floor)
    index = {name: k for k, name in enumerate(model.joint_names)}
    for joint in spec.joints:
        if joint.name == "root":
            continue
        k = index.get(joint.name)
        stiffness = s.stiffness if k is not None else _HELD
        joint.damping, joint.armature, joint.frictionloss = [0.0, 0.0, 0.0], s.armature, s.friction
        joint.limited = False
        torque = min(s.torque_scale * float(model.effort_max[k]), 1e3) if k is not None else 1e3
        act = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        act.gainprm[0] = stiffness
        act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        act.biasprm[1], act.biasprm[2] = -stiffness, -s.damping * stiffness
        act.forcelimited, act.forcerange = True, [-torque, torque]
    try:
        made = spec.compile()
    except ValueError as error:
        raise PlantError(f"MuJoCo refuses the robot: {error}") from error
    made.body_mass *= c.mass_scale
    made.body_inertia *= c.mass_scale
    return made


_THICK = 0.008
"""Of the boxes of the soles [m]."""
_SOLID = [0.95, 0.99, 0.0005, 0.5, 2.0]
"""Impedance of a contact: firm from half a millimetre on."""
