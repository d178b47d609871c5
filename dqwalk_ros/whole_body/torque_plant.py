"""The robot of the whole-body controller in MuJoCo, driven by joint torques; its soles can slip, tilt and bounce.

Contacts are compliant and detected by the engine; the stance in the command is not used. Robot, soles and floor are
those of `plants.mujoco`, without servos.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.plants.mujoco import robot_spec, set_timestep
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import PlantError
from dqwalk_ros.whole_body.controller import BodyCommand, BodyState
from dqwalk_ros.whole_body.rigid_plant import BodyPlant

_STEP = 0.001
"""Largest time step of the engine [s]."""
_FRICTION = 0.9
"""Friction coefficient of soles and ground."""
_SOFT = 0.005
"""Time constant of the contacts [s]."""
_PUSH = 0.05
"""Duration of a push [s]."""


class TorquePlant(BodyPlant):
    """MuJoCo with joint torques; a push is a force at the centre of mass of the pushed link, for 50 ms.

    Parameters
    ----------
    state : BodyState
        Initial state.
    pushed : str
        The link that pushes act on.
    """

    def __init__(self, model: RobotModel, state: BodyState, *, pushed: str) -> None:
        super().__init__(state)
        spec = robot_spec(model, friction=_FRICTION, contact_time=_SOFT)
        self._mj = spec.compile()
        self._data: Any = mujoco.MjData(self._mj)
        joints = [self._mj.joint(name) for name in model.joint_names]
        self._qadr = np.array([int(joint.qposadr[0]) for joint in joints])
        self._vadr = np.array([int(joint.dofadr[0]) for joint in joints])
        self._pushed = self._mj.body(pushed).id
        x, d = DQ(state.x_base), self._data
        d.qpos[:3], d.qpos[3:7], d.qpos[self._qadr] = x.translation(), x.rotation(), state.q
        d.qvel[:3], d.qvel[3:6], d.qvel[self._vadr] = x.rotation_matrix() @ state.v_base[:3], state.v_base[3:], state.dq
        mujoco.mj_forward(self._mj, d)
        self._pushes: list[tuple[float, Array]] = []  # end of the push [s], and force (3,) [N]

    def _move(self, command: BodyCommand, time: float, dt: float) -> None:
        d = self._data
        d.qfrc_applied[self._vadr] = command.effort
        for _ in range(set_timestep(self._mj, dt, _STEP)):
            self._pushes = [(end, force) for end, force in self._pushes if d.time < end - 1e-9]
            d.xfrc_applied[self._pushed, :3] = sum((self._share(end) * f for end, f in self._pushes), np.zeros(3))
            mujoco.mj_step(self._mj, d)
        if not np.isfinite(d.qpos).all():
            raise PlantError("the simulation is not finite any more")
        x = DQ.from_pose(d.qpos[:3], d.qpos[3:7] / np.linalg.norm(d.qpos[3:7]))
        linear = x.rotation_matrix().T @ d.qvel[:3]  # MuJoCo's linear velocity is in world axes
        q, dq, v_base = d.qpos[self._qadr], d.qvel[self._vadr], np.concatenate([linear, d.qvel[3:6]])
        self.state = BodyState(time, q, dq=dq, x_base=x.vec8(), v_base=v_base)

    def _share(self, end: float) -> float:
        """Return the fraction of the next step of the engine that is before the time `end` [s]."""
        share = (end - float(self._data.time)) / self._mj.opt.timestep
        return share if share < 1.0 - 1e-6 else 1.0  # without the rounding errors of a whole step

    def _hit(self, impulse: Array) -> None:
        self._pushes.append((float(self._data.time) + _PUSH, impulse / _PUSH))
