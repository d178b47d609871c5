"""What only pictures of the physics need: the robot's visual shapes, a sky, a ruled floor, light."""

from __future__ import annotations

import re
from typing import Any

import mujoco

__all__ = ["add_scenery", "with_visual_shapes"]

_ROBOT = re.compile(r"<robot\b[^>]*>")


def with_visual_shapes(urdf: str) -> str:
    """Return a URDF of which MuJoCo keeps the visual shapes: it drops them unless the file itself says otherwise."""
    return _ROBOT.sub(lambda found: found[0] + '<mujoco><compiler discardvisual="false"/></mujoco>', urdf, count=1)


def add_scenery(spec: Any, floor: Any) -> None:
    """Add a sky, lines on the floor and light that casts shadows; nothing that touches.

    Parameters
    ----------
    spec : mujoco.MjSpec
    floor : mujoco.MjsGeom
    """
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
    floor.material, floor.rgba = "ruled", [1.0, 1.0, 1.0, 1.0]
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0.5, -1.0, 3.0], dir=[-0.2, 0.35, -1.0],
        castshadow=True, diffuse=[0.45] * 3, specular=[0.1] * 3,
    )  # fmt: skip
