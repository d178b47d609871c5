"""Pictures of the robot, drawn by MuJoCo without a display: set MUJOCO_GL to egl or osmesa where there is none."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import PlantError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.plants.physics import compiled

__all__ = ["Camera"]

Array = NDArray[np.float64]


class Camera:
    """Looks at a robot from aside, as far ahead as it is; to be used with `with`.

    Parameters
    ----------
    config : Config
    model : RobotModel
    width, height : int
        Of the pictures [pixels].
    azimuth, elevation : float
        Where the camera looks to [degrees].
    distance : float
        [m]

    Raises
    ------
    PlantError
        If nothing can be drawn here.
    """

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        width: int = 360,
        height: int = 480,
        *,
        azimuth: float = 130.0,
        elevation: float = -12.0,
        distance: float = 1.4,
    ) -> None:
        self._model = model
        self._mj = compiled(config, model, seen=True)
        self._data: Any = mujoco.MjData(self._mj)
        self._mj.vis.global_.offwidth, self._mj.vis.global_.offheight = width, height
        self._qadr = np.array([int(self._mj.joint(name).qposadr[0]) for name in model.joint_names])
        self._root = self._mj.body(model.root).id
        self._shown = mujoco.MjvOption()
        self._shown.geomgroup[0] = 0  # what collides
        self._look = mujoco.MjvCamera()
        self._look.azimuth, self._look.elevation, self._look.distance = azimuth, elevation, distance
        try:
            self._renderer = mujoco.Renderer(self._mj, height, width)
        except Exception as error:  # whatever the OpenGL that is there raises
            raise PlantError(f"nothing can be drawn here: {error}; set MUJOCO_GL to egl or osmesa") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._renderer.close()

    def picture(self, q: Array, pelvis: Array) -> NDArray[np.uint8]:
        """Return the robot at the angles `q` (n,) [rad] with the pelvis at a pose (8,), shape (height, width, 3)."""
        kin = Kinematics(self._model, q, Foot.LEFT)
        root = DQ(pelvis) * DQ(kin.pose(self._model.pelvis)).conj() * DQ(kin.pose(self._model.root))
        self._data.qpos[:3], self._data.qpos[3:7] = root.translation(), root.P().vec4()
        self._data.qpos[self._qadr] = q
        mujoco.mj_forward(self._mj, self._data)
        com = self._data.subtree_com[self._root]
        self._look.lookat[:] = [com[0], 0.0, 0.9 * com[2]]
        self._renderer.update_scene(self._data, self._look, self._shown)
        image: NDArray[np.uint8] = self._renderer.render()
        return image
