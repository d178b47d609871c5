"""The robot in a physics engine: true soles, friction, servos and an inertial sensor; the one importer of mujoco.

The URDF is loaded as it is: links without mass stay massless, joints that the model does not move are held, the
pelvis floats. What a real robot cannot measure (`PhysicsPlant.truth`) is for analysis only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command, State
from dqwalk_ros.dq import DQ
from dqwalk_ros.exceptions import PlantError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.plants.servos import Servos

__all__ = ["PhysicsPlant", "Truth", "compiled"]

Array = NDArray[np.float64]

_HELD = 300.0
"""Stiffness of the joints that the model does not move [N m/rad]."""


@dataclass(frozen=True)
class Truth:
    """What no sensor of the robot measures.

    Attributes
    ----------
    pelvis : ndarray, shape (8,)
        Its pose in the world.
    soles : dict of Foot to ndarray, shape (8,)
        Poses of the soles in the world.
    wrenches : dict of Foot to ndarray, shape (6,)
        Force [N] and torque [N m] of the ground on each sole, about its origin, in its axes.
    com : ndarray, shape (3,)
        In the world [m].
    """

    pelvis: Array
    soles: dict[Foot, Array]
    wrenches: dict[Foot, Array]
    com: Array

    @property
    def cop(self) -> Array | None:
        """Centre of pressure of both feet in the world, shape (3,) [m]; None in the air."""
        total, moment = 0.0, np.zeros(3)
        for foot, w in self.wrenches.items():
            x = DQ(self.soles[foot])
            if w[2] > 1e-3:
                total += w[2]
                moment += w[2] * x.transform_point([-w[4] / w[2], w[3] / w[2], 0.0])
        return moment / total if total > 1e-2 else None


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
        self._seat(q)
        self._servos = Servos(config.servo, q, model.q_min, model.q_max)
        self._bias = np.zeros(model.n)
        self.data.ctrl[self._act] = q
        for _ in range(round(c.settle / self.mj.opt.timestep)):
            mujoco.mj_step(self.mj, self.data)
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
    def truth(self) -> Truth:
        """What no sensor measures."""
        mujoco.mj_forward(self.mj, self.data)
        soles = {foot: self._pose(body) for foot, body in self._sole_body.items()}
        wrenches = {foot: self._wrench(foot) for foot in Foot}
        return Truth(
            self._pose(self.mj.body(self.model.pelvis).id), soles, wrenches, np.array(self.data.subtree_com[self._root])
        )

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
        R = self.data.xmat[self._imu].reshape(3, 3)
        gyro = np.empty(6)
        mujoco.mj_objectVelocity(self.mj, self.data, mujoco.mjtObj.mjOBJ_XBODY, self._imu, gyro, 1)
        return State(
            time=self._ticks * self.config.dt,
            q=self.data.qpos[self._qadr].copy(),
            dq=self.data.qvel[self._vadr].copy(),
            up=R[2].copy(),
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

    def _pose(self, body: int) -> Array:
        return DQ.from_pose(self.data.xpos[body], self.data.xquat[body]).vec8()

    def _wrench(self, foot: Foot) -> Array:
        geom, body = self._sole[foot], self._sole_body[foot]
        out, one = np.zeros(6), np.empty(6)
        R, p = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            pair = (contact.geom1, contact.geom2)
            if geom not in pair or self._floor not in pair:
                continue
            mujoco.mj_contactForce(self.mj, self.data, k, one)
            frame = np.asarray(contact.frame).reshape(3, 3)
            force = frame.T @ one[:3] * (1.0 if pair[0] == self._floor else -1.0)
            out[:3] += R.T @ force
            out[3:] += R.T @ np.cross(contact.pos - p, force)
        return out


def compiled(config: Config, model: RobotModel) -> Any:
    """Return the MuJoCo model of the robot, its servos and the floor.

    Raises
    ------
    PlantError
        If MuJoCo refuses the robot.
    """
    c, s = config.physics, config.servo
    spec = mujoco.MjSpec.from_string(model.urdf)
    spec.compiler.inertiafromgeom = 0  # the soles have no mass; none may be made up
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.compiler.discardvisual = False  # for pictures
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
            friction=[c.friction, 0.005, 0.0001], contype=1, conaffinity=2, rgba=[0.2, 0.21, 0.23, 1.0], group=0,
            solref=[c.contact_time, 1.0], solimp=_SOLID,
        )  # fmt: skip
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[20.0, 20.0, 0.1], friction=[c.friction, 0.005, 0.0001],
        solref=[c.contact_time, 1.0], solimp=_SOLID, contype=2, conaffinity=1, rgba=[0.86, 0.88, 0.9, 1.0],
    )  # fmt: skip
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
