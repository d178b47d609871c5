"""Robots for tests: the paper's legs, the whole Poppy, a fictitious biped, and mirror images."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dqwalk_ros.config import Config, RobotConfig, load
from dqwalk_ros.robot.model import Frame, RobotModel, load_model

DATA = Path(__file__).parents[1] / "data"


@cache
def legs() -> RobotModel:
    """The robot of the paper: Poppy's two legs and its pelvis, ten joints."""
    return load_model(load("paper").robot)


@cache
def poppy() -> RobotModel:
    """The complete Poppy."""
    return load_model(RobotConfig())


def biped12_config(**changes: Any) -> Config:
    """Configuration of a fictitious biped: other names, six joints per leg, three times the mass."""
    robot = {
        "robot.urdf": str(DATA / "biped12.urdf"),
        "robot.pelvis": "base",
        "robot.left_sole": "left_sole",
        "robot.right_sole": "right_sole",
        "pelvis.height": 0.4,
    }
    return Config().updated({**robot, **changes})


@cache
def biped12() -> RobotModel:
    return load_model(biped12_config().robot)


ROBOTS = {"legs": legs, "poppy": poppy, "biped12": biped12}


def mirrored(model: RobotModel) -> RobotModel:
    """Return the mirror image in the sagittal plane y = 0, whose left sole is the image of the right one.

    Points are reflected by S = diag(1, -1, 1); a rotation's axis is a pseudovector, so the same angle turns about
    -S a, and a pose x becomes its image with r = (w, -x, y, -z).
    """
    reflect = np.array([1.0, -1.0, 1.0])
    pose = np.array([1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0])
    bodies = tuple(
        dataclasses.replace(
            body,
            origin=pose * body.origin,
            axis=-reflect * body.axis,
            com=reflect * body.com,
            inertia=np.outer(reflect, reflect) * body.inertia,
        )
        for body in model.bodies
    )
    frames = {name: Frame(frame.body, pose * frame.pose) for name, frame in model.frames.items()}
    soles = {foot.other: dataclasses.replace(sole, center=reflect * sole.center) for foot, sole in model.soles.items()}
    return dataclasses.replace(model, bodies=bodies, frames=frames, soles=soles)


def edited(folder: Path, source: Path, *changes: tuple[str, str]) -> Path:
    """Write a URDF that is edited by regular expressions; return its path."""
    text = source.read_text(encoding="utf-8")
    for pattern, replacement in changes:
        text, hits = re.subn(pattern, replacement, text, flags=re.DOTALL)
        assert hits, pattern
    path = folder / "edited.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def configurations(model: RobotModel, count: int, seed: int = 0) -> np.ndarray:
    """Random joint angles within the limits, shape (count, n) [rad]."""
    rng = np.random.default_rng(seed)
    return rng.uniform(model.q_min, model.q_max, (count, model.n))


def central_difference(f: Any, q: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """The derivative of f: (n,) -> (...,) at q, shape (..., n), to the fourth order in the step."""
    columns = []
    for i in range(q.size):
        d = np.zeros(q.size)
        d[i] = step
        columns.append((8.0 * (f(q + d) - f(q - d)) - (f(q + 2.0 * d) - f(q - 2.0 * d))) / (12.0 * step))
    return np.stack(columns, axis=-1)
