"""Pictures of the robot rendered by MuJoCo; on a machine without a display set MUJOCO_GL to egl or osmesa."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.arrays import Array
from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ModelError, PlantError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.robot import Foot, RobotModel, find_urdf
from dqwalk_ros.shapes import meshes_of
from dqwalk_ros.urdf import Urdf

__all__ = ["Camera", "add_scenery"]

_GREY = (0.7, 0.72, 0.75, 1.0)
_AZIMUTH, _ELEVATION = 130.0, -12.0
"""Direction of view [degrees]."""
_DISTANCE = 1.4
"""Distance of the camera from the robot [m]."""


class Camera:
    """A camera beside the robot that moves forward with it; a context manager.

    Parameters
    ----------
    width, height : int
        Size of the pictures [pixels].

    Raises
    ------
    PlantError
        If OpenGL rendering is not available.
    """

    def __init__(self, config: Config, model: RobotModel, width: int, height: int) -> None:
        self._model = model
        seen = Urdf(model.urdf, model.name)
        try:
            near = find_urdf(config.robot.urdf)
        except ModelError:
            near = Path(config.robot.urdf)
        meshes = meshes_of(seen, near)
        for name, link in seen.links.items():  # MuJoCo cannot read all mesh formats and URIs by itself
            plain = tuple(shape for shape in link.visuals if shape.kind != "mesh")
            collide = tuple(shape for shape in link.collisions if shape.kind != "mesh")
            seen.links[name] = replace(link, visuals=plain, collisions=collide)

        def add(spec: Any) -> None:
            add_scenery(spec)
            for number, (name, surface) in enumerate(meshes):
                spec.add_mesh(
                    name=f"mesh{number}", uservert=surface.vertices.ravel(), userface=surface.faces.ravel(),
                    inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
                )  # fmt: skip
                spec.body(name).add_geom(
                    type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh{number}", group=1, contype=0, conaffinity=0,
                    mass=0.0, rgba=surface.color or _GREY,
                )  # fmt: skip

        self._mj = build(config, replace(model, urdf=seen.text()), scenery=add)
        self._data: Any = mujoco.MjData(self._mj)
        self._mj.vis.global_.offwidth, self._mj.vis.global_.offheight = width, height
        self._qadr = np.array([int(self._mj.joint(name).qposadr[0]) for name in model.joint_names])
        self._root = self._mj.body(model.root).id
        self._shown = mujoco.MjvOption()
        self._shown.geomgroup[0] = 0  # what collides
        self._look = mujoco.MjvCamera()
        self._look.azimuth, self._look.elevation, self._look.distance = _AZIMUTH, _ELEVATION, _DISTANCE
        try:
            self._renderer = mujoco.Renderer(self._mj, height, width)
        except Exception as error:  # the exceptions depend on the OpenGL platform
            raise PlantError(f"nothing can be drawn here: {error}; set MUJOCO_GL to egl or osmesa") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._renderer.close()

    def picture(self, q: Array, pelvis: Array) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) of the robot at the angles `q` (n,) [rad] and the `pelvis` pose (8,)."""
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


def add_scenery(spec: Any) -> None:
    """Add a sky, lines on the floor and a light with shadows, without effect on the physics."""
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.6] * 3
    kind, built = mujoco.mjtTexture, mujoco.mjtBuiltin
    spec.add_texture(
        name="sky", type=kind.mjTEXTURE_SKYBOX, builtin=built.mjBUILTIN_GRADIENT,
        rgb1=[1.0, 1.0, 1.0], rgb2=[0.78, 0.85, 0.93], width=256, height=1536,
    )  # fmt: skip
    ground = [0.93, 0.94, 0.95]
    spec.add_texture(
        name="ruled", type=kind.mjTEXTURE_2D, builtin=built.mjBUILTIN_FLAT, mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=ground, rgb2=ground, markrgb=[0.62, 0.66, 0.71], width=256, height=256,
    )  # fmt: skip
    material = spec.add_material(name="ruled", texrepeat=[5.0, 5.0], texuniform=True)  # a line every 20 cm
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ruled"
    floor = spec.geom("floor")
    floor.material, floor.rgba = "ruled", [1.0, 1.0, 1.0, 1.0]
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0.5, -1.0, 3.0], dir=[-0.2, 0.35, -1.0],
        castshadow=True, diffuse=[0.45] * 3, specular=[0.1] * 3,
    )  # fmt: skip
