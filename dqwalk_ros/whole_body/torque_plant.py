"""The whole-body controller's robot in a physics engine (MuJoCo), driven by joint torques: soles slip, tilt and bounce.

What the controller takes for rigid contact is here a soft one that the engine finds by itself: which feet stand is not
taken from the command. `plants.mujoco` is the other robot in MuJoCo, on position servos.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PlantError
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState, Wrench

__all__ = ["TorquePlant"]

Array = NDArray[np.float64]

_THICK = 0.01
"""Thickness of a sole [m]."""
_SOFT = (0.005, 1.0)
"""Time constant and damping ratio of the contacts [s]."""
_PUSH = 0.05
"""Duration of a push [s]."""


class TorquePlant:
    """MuJoCo with torques on the joints; only the soles touch the ground.

    Parameters
    ----------
    model : RobotModel
    state : BodyState
        Where it begins.
    pushed : str
        The link that pushes act on.
    timestep : float
        Of the engine [s].
    friction : float
        Of soles and ground.
    """

    wrenches: Mapping[Foot, Wrench] = {}
    """The forces of a soft contact are not judged."""

    def __init__(
        self, model: RobotModel, state: BodyState, *, pushed: str, timestep: float = 0.001, friction: float = 0.9
    ) -> None:
        self._mj = _compiled(model, timestep, friction)
        self._data: Any = mujoco.MjData(self._mj)
        joints = [self._mj.joint(name) for name in model.joint_names]
        self._qadr = np.array([int(joint.qposadr[0]) for joint in joints])
        self._vadr = np.array([int(joint.dofadr[0]) for joint in joints])
        self._pushed = self._mj.body(pushed).id
        x = DQ(state.x_base)
        self._data.qpos[:3], self._data.qpos[3:7], self._data.qpos[self._qadr] = x.translation(), x.rotation(), state.q
        self._data.qvel[:3], self._data.qvel[3:6] = x.rotation_matrix() @ state.v_base[:3], state.v_base[3:]
        self._data.qvel[self._vadr] = state.dq
        mujoco.mj_forward(self._mj, self._data)
        self._state, self._begin, self._periods = state, state.time, 0
        self._pushes: list[tuple[float, Array]] = []
        self.effort = np.zeros(model.n)

    @property
    def state(self) -> BodyState:
        """The state now, as a perfect sensor has it."""
        return self._state

    def step(self, command: BodyCommand, dt: float) -> BodyState:
        """Return the state one period later.

        Raises
        ------
        PlantError
            If the command is not finite or does not fit, or the simulation has gone astray.
        """
        if command.effort.shape != self._qadr.shape or not np.isfinite(command.effort).all():
            raise PlantError(f"the command must have {self._qadr.size} finite torques, got {command.effort}")
        self.effort = command.effort
        for _ in range(max(1, round(dt / self._mj.opt.timestep))):
            now = float(self._data.time)
            self._pushes = [(end, force) for end, force in self._pushes if now < end - 1e-9]
            self._data.xfrc_applied[self._pushed, :3] = sum((force for _, force in self._pushes), np.zeros(3))
            self._data.qfrc_applied[self._vadr] = command.effort
            mujoco.mj_step(self._mj, self._data)
        if not np.isfinite(self._data.qpos).all():
            raise PlantError("the simulation is not finite any more")
        self._periods += 1
        r = self._data.qpos[3:7] / np.linalg.norm(self._data.qpos[3:7])
        x = DQ.from_pose(self._data.qpos[:3], r)
        linear = x.rotation_matrix().T @ self._data.qvel[:3]  # MuJoCo has it in the axes of the world
        self._state = BodyState(
            self._begin + self._periods * dt,
            self._data.qpos[self._qadr].copy(),
            dq=self._data.qvel[self._vadr].copy(),
            x_base=x.vec8(),
            v_base=np.concatenate([linear, self._data.qvel[3:6]]),
        )
        return self._state

    def push(self, impulse: ArrayLike) -> None:
        """Push for 50 ms: an impulse (3,) [N s] at the centre of mass of the link that pushes act on.

        Raises
        ------
        PlantError
            If it is not three finite numbers.
        """
        r = np.asarray(impulse, dtype=np.float64)
        if r.shape != (3,) or not np.isfinite(r).all():
            raise PlantError(f"an impulse is three finite numbers [N s], got {impulse!r}")
        self._pushes.append((float(self._data.time) + _PUSH, r / _PUSH))


def _compiled(model: RobotModel, timestep: float, friction: float) -> Any:
    spec = mujoco.MjSpec.from_string(model.urdf)
    spec.compiler.inertiafromgeom = 0  # the soles have no mass; none may be made up
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    joints = {joint.name for joint in spec.joints}
    if joints != set(model.joint_names):
        odd = ", ".join(sorted(joints ^ set(model.joint_names)))
        raise PlantError(f"every joint of the URDF must move here; not so: {odd} (robot.drop, robot.lock)")
    spec.body(model.root).add_freejoint(name="root")
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    same = {"friction": [friction, 0.01, 0.001], "solref": _SOFT}
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
            **same,
        )
    floor = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(name="floor", type=floor, size=[20.0, 20.0, 0.1], contype=2, conaffinity=1, **same)
    return spec.compile()
