"""Renders a walk with MuJoCo, as a movie or as a strip of pictures.

On a machine without a display set MUJOCO_GL to egl or osmesa.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.mujoco import build
from dqwalk_ros.report.colors import INK
from dqwalk_ros.report.metrics import pelvis_in_odom
from dqwalk_ros.report.scene import BodyShape, shapes_of
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ConfigError, PlantError
from dqwalk_ros.support.output import written
from dqwalk_ros.trace import Trace

Progress = Callable[[float, str], None]
"""Called with the fraction done and a line of text."""
_MOVIE, _STRIP = (360, 400), (240, 400)
"""Width and height of the pictures of a movie and of a strip [pixels]."""
_MOST = 3000
"""Most pictures of a movie; they are in memory together."""
_AZIMUTH, _ELEVATION = 130.0, -12.0
"""Direction of view [degrees]."""
_DISTANCE = 1.4
"""Distance of the camera from the robot [m]."""


def frames(trace: Trace, times: Array, width: int, height: int, progress: Progress) -> Iterator[Image.Image]:
    """Yield a picture of the robot at each time [s], with the time and the phase written on it.

    The pose of the pelvis is the true one for walks in physics, else that of odometry.

    Raises
    ------
    PlantError
        If MuJoCo cannot render on this machine.
    """
    pelvis = pelvis_in_odom(trace) if trace.physics is None else trace.physics.pelvis
    known = np.flatnonzero(np.isfinite(pelvis).all(axis=1))
    starts = np.array([record.time for record in trace.phases])
    with _Camera(trace.config, trace.model, width, height) as camera:
        for k, time in enumerate(times):
            tick = known[min(int(np.searchsorted(trace.time[known], time)), len(known) - 1)]
            picture = Image.fromarray(camera.picture(trace.q[tick], pelvis[tick]))
            record = trace.phases[max(int(np.searchsorted(starts, trace.time[tick], side="right")) - 1, 0)]
            draw, font = ImageDraw.Draw(picture), ImageFont.load_default(13)
            for row, line in enumerate((f"{trace.time[tick]:.1f} s", record.name.replace("_", " "))):
                draw.text((8, 6 + 17 * row), line, fill=INK, font=font)
            yield picture
            progress((k + 1) / len(times), f"{k + 1} of {len(times)} pictures")


def save_movie(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    speed: float,
    rate: float,
    progress: Progress,
    overwrite: bool,
) -> None:
    """Write the walk as an animated picture, a .gif or a .webp; see `written` for errors.

    The speed is relative to real time, the rate in pictures per second.

    Raises
    ------
    ConfigError
        If the movie has too many pictures.
    """
    count = 1 + int((trace.time[-1] - trace.time[0]) * rate / speed)
    if count > _MOST:
        raise ConfigError(f"a movie of {count} pictures is too long; {_MOST} at most: raise --speed, or lower --rate")
    times = np.arange(trace.time[0], trace.time[-1] + 1e-9, speed / rate)
    made = list(frames(trace, times, *_MOVIE, progress))
    options: dict[str, Any] = {"quality": 70, "method": 4}
    if Path(path).suffix.lower() == ".gif":
        palette = made[len(made) // 2].quantize(64)
        made = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in made]
        options = {"optimize": True}
    options |= {"save_all": True, "append_images": made[1:], "duration": round(1e3 / rate), "loop": 0}
    with written(path, overwrite=overwrite) as new:
        made[0].save(new, **options)


def save_strip(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    count: int,
    between: tuple[float, float] | None,
    progress: Progress,
    overwrite: bool,
) -> None:
    """Write some pictures of the walk side by side, evenly spread over it or `between` two times [s]; see `written`."""
    begin, end = float(trace.time[0]), float(trace.time[-1])
    first, last = between or (begin, end)
    if first > end or last < begin:
        raise ConfigError(f"the walk lasts from {begin:g} to {end:g} s, not from {first:g} to {last:g} s")
    gap = np.full((_STRIP[1], 4, 3), 255, dtype=np.uint8)
    made = frames(trace, np.linspace(first, last, count), *_STRIP, progress)
    row = [part for one in made for part in (np.asarray(one), gap)][:-1]
    with written(path, overwrite=overwrite) as new:
        Image.fromarray(np.concatenate(row, axis=1)).quantize(128).save(new, optimize=True)


# ---------------------------------------------------------------------- pictures


class _Camera:
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
        self._mj = build(config, model, scenery=scenery_of(config, model))
        self._data: Any = mujoco.MjData(self._mj)
        self._mj.vis.global_.offwidth, self._mj.vis.global_.offheight = width, height
        self._qadr = np.array([int(self._mj.joint(name).qposadr[0]) for name in model.joint_names])
        self._root = self._mj.body(model.root).id
        self._look = mujoco.MjvCamera()
        self._look.azimuth, self._look.elevation, self._look.distance = _AZIMUTH, _ELEVATION, _DISTANCE
        try:
            self._renderer = mujoco.Renderer(self._mj, height, width)
        except Exception as error:  # the exceptions depend on the OpenGL platform
            raise PlantError(f"nothing can be drawn here: {error}; set MUJOCO_GL to egl or osmesa") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
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
        self._renderer.update_scene(self._data, self._look)
        image: NDArray[np.uint8] = self._renderer.render()
        return image


def scenery_of(config: Config, model: RobotModel) -> Callable[[Any], None]:
    """Return a function that adds the shapes of the robot and its surroundings, without effect on the physics."""

    def add(spec: Any) -> None:
        _add_surroundings(spec)
        for number, shape in enumerate(shapes_of(config, model)):
            _add_shape(spec, spec.body(model.links[shape.body]), f"shape{number}", shape)

    return add


def _add_shape(spec: Any, body: Any, name: str, shape: BodyShape) -> None:
    kind, x = mujoco.mjtGeom, DQ(shape.pose)
    looks: dict[str, Any] = {
        "name": name, "pos": x.translation(), "quat": x.rotation(), "rgba": shape.color,
        "contype": 0, "conaffinity": 0, "mass": 0.0,
    }  # fmt: skip
    if shape.vertices is not None and shape.faces is not None:
        spec.add_mesh(
            name=name, uservert=shape.vertices.ravel(), userface=shape.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )  # fmt: skip
        body.add_geom(type=kind.mjGEOM_MESH, meshname=name, **looks)
    elif shape.kind == "box":
        body.add_geom(type=kind.mjGEOM_BOX, size=[0.5 * side for side in shape.size], **looks)
    elif shape.kind == "cylinder":
        radius, length = shape.size
        body.add_geom(type=kind.mjGEOM_CYLINDER, size=[radius, 0.5 * length, 0.0], **looks)
    else:
        body.add_geom(type=kind.mjGEOM_SPHERE, size=[*shape.size, 0.0, 0.0], **looks)


def _add_surroundings(spec: Any) -> None:
    """Add a sky, lines on the floor and a light with shadows."""
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
