"""Pictures of the robot, drawn by MuJoCo without a display: set MUJOCO_GL to egl or osmesa where there is none."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dq import DQ
from dqwalk_ros.exceptions import PlantError
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
        self._mj = compiled(config, model, _scenery)
        self._data: Any = mujoco.MjData(self._mj)
        self._mj.vis.global_.offwidth, self._mj.vis.global_.offheight = width, height
        self._qadr = np.array([int(self._mj.joint(name).qposadr[0]) for name in model.joint_names])
        self._root = self._mj.body(model.root).id
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
        self._renderer.update_scene(self._data, self._look)
        image: NDArray[np.uint8] = self._renderer.render()
        return image


def _scenery(spec: Any) -> None:
    """Give the floor tiles of 10 cm and the world a sky."""
    textures, kinds = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky = {"rgb1": [0.99, 0.99, 1.0], "rgb2": [0.86, 0.90, 0.95], "width": 64, "height": 384}
    spec.add_texture(name="sky", type=textures.mjTEXTURE_SKYBOX, builtin=kinds.mjBUILTIN_GRADIENT, **sky)
    tiles = {"rgb1": [0.93, 0.94, 0.95], "rgb2": [0.86, 0.88, 0.90], "width": 256, "height": 256}
    spec.add_texture(name="tiles", type=textures.mjTEXTURE_2D, builtin=kinds.mjBUILTIN_CHECKER, **tiles)
    material = spec.add_material(name="tiles", texrepeat=[_TILES, _TILES], texuniform=True, emission=0.45)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor = spec.geom("floor")
    floor.material, floor.rgba = "tiles", [1.0, 1.0, 1.0, 1.0]


_TILES = 5
"""Pairs of tiles in a metre."""
