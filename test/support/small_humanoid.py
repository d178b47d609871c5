"""The small humanoid of test/data, which walks, and changes to its description."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from robots import edited

from dqwalk_ros.adopt.anatomy import Anatomy, find_anatomy
from dqwalk_ros.config import RobotConfig
from dqwalk_ros.robot.model import RobotModel, parse_model
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf

SMALL = Path(__file__).parents[1] / "data" / "small_humanoid.urdf"
X, Y, Z = np.eye(3)


def anatomy_of(urdf: Urdf, near: Path = SMALL) -> Anatomy:
    return find_anatomy(urdf, Shapes(urdf, near))


def read(tmp_path: Path, *changes: tuple[str, str]) -> Urdf:
    return Urdf.load(edited(tmp_path, SMALL, *changes))


def small_model(urdf: Urdf, **sections: object) -> RobotModel:
    robot = {"pelvis": "trunk", "left_sole": "l_foot", "right_sole": "r_foot", **sections}
    return parse_model(urdf.text(), RobotConfig(**robot))  # type: ignore[arg-type]


def moved(urdf: Urdf, link: str, pose: np.ndarray) -> None:
    """Give a link another frame at `pose` (4, 4) in the present one; the robot is the same."""
    back = np.linalg.inv(pose)
    part = urdf.links[link].inertial
    part.origin, part.inertia = back @ part.origin, back[:3, :3] @ part.inertia @ back[:3, :3].T
    part.origin[:3, :3] = np.eye(3)
    for shape in (*urdf.links[link].visuals, *urdf.links[link].collisions):
        shape.origin = back @ shape.origin
    for joint in urdf.joints.values():
        if joint.parent == link:
            joint.origin = back @ joint.origin
        if joint.child == link:
            joint.origin = joint.origin @ pose
            joint.axis = None if joint.axis is None else back[:3, :3] @ joint.axis


def at(xyz: object, R: object = None) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = xyz, np.eye(3) if R is None else R
    return pose


NO_ROLL = r'(name="._ankle_roll" type=)"revolute"', r'\1"fixed"'


def in_units(text: str, lengths: float) -> str:
    """Multiply the positions and sizes of a URDF."""

    def times(match: re.Match[str]) -> str:
        return f'{match[1]}"{" ".join(repr(lengths * float(word)) for word in match[2].split())}"'

    return re.sub(r'((?:<origin xyz|<box size|<sphere radius|length|radius)=)"([^"]*)"', times, text)


def narrowed(tmp_path: Path, **limits: float) -> Path:
    """Write the robot with symmetric limits of some joints of both legs [rad]."""
    changes = [
        (rf'(name="._{name}".*?lower=)"[^"]*" upper="[^"]*"', rf'\1"-{most}" upper="{most}"')
        for name, most in limits.items()
    ]
    return edited(tmp_path, SMALL, *changes)


def written(tmp_path: Path, urdf: Urdf) -> Path:
    path = tmp_path / "perturbed.urdf"
    path.write_text(urdf.text())
    return path


FOOT_BOX = r'<box size="0.1265 0.0825 0.0132"/>'
