"""What a robot description says, parsed once per machine.

yourdfpy reads the URDF; importing it brings trimesh, scipy.spatial and networkx with it, more than half of the time
until a controller is ready. What this package needs of the result is a few kilobytes, so it is kept beside the user's
other caches ($XDG_CACHE_HOME or ~/.cache, dqwalk_ros/robots) under the hash of the file. A cache that cannot be read or
written is no error.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib.util
import io
import json
import os
import pathlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.errors import ModelError

__all__ = ["Box", "Joint", "Link", "Robot", "parse"]

Array = NDArray[np.float64]

_FORMAT = 1
"""To be counted up with every change of what is kept."""
_KEPT = 64
"""Robots; the oldest go first."""


@dataclass(frozen=True)
class Box:
    """A box that collides: size (3,) [m], pose (4, 4) in the frame of its link."""

    size: Array
    origin: Array


@dataclass(frozen=True)
class Link:
    """A link: its mass [kg], CoM (3,) in its frame [m], and boxes that collide."""

    name: str
    mass: float
    com: Array
    boxes: tuple[Box, ...]


@dataclass(frozen=True)
class Joint:
    """A joint: pose (4, 4) in the frame of the parent link, axis (3,), whom it mimics, and the limits it has.

    `limits` has those of lower, upper [rad], velocity [rad/s] and effort [N m] that are given.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    mimic: str
    limits: dict[str, float]


@dataclass(frozen=True)
class Robot:
    """A tree of links and joints."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]


def parse(data: bytes, source: str) -> Robot:
    """Return what a URDF says; `source` is its name in messages. The bytes have passed `description.checked`.

    Raises
    ------
    ModelError
        If yourdfpy refuses it.
    """
    path = _cache(data)
    robot = _kept(path)
    if robot is None:
        robot = _parsed(data, source)
        _keep(path, robot)
    return robot


def _parsed(data: bytes, source: str) -> Robot:
    import yourdfpy

    try:
        robot = yourdfpy.URDF.load(io.BytesIO(data), load_meshes=False, build_scene_graph=False, mesh_dir="").robot
        return Robot(robot.name, tuple(map(_link, robot.links)), tuple(map(_joint, robot.joints)))
    except Exception as error:  # lxml, yourdfpy and numpy each have their own
        raise ModelError(f"{source}: not a URDF: {' '.join(str(error).split())[:300]}") from error


def _link(link: Any) -> Link:
    inertial = link.inertial
    mass = float(inertial.mass) if inertial is not None and inertial.mass else 0.0
    com = np.zeros(3) if inertial is None or inertial.origin is None else inertial.origin[:3, 3]
    boxes = (
        Box(np.asarray(shape.geometry.box.size, dtype=np.float64), _pose(shape.origin))
        for shape in link.collisions
        if shape.geometry.box is not None
    )
    return Link(link.name, mass, com, tuple(boxes))


def _joint(joint: Any) -> Joint:
    limits = {}
    for what in ("lower", "upper", "velocity", "effort"):
        value = getattr(joint.limit, what, None) if joint.limit is not None else None
        if value is not None:
            limits[what] = float(value)
    mimic = joint.mimic.joint if joint.mimic is not None else ""
    axis = np.asarray(joint.axis, dtype=np.float64)
    return Joint(joint.name, joint.type, joint.parent, joint.child, _pose(joint.origin), axis, mimic, limits)


def _pose(matrix: Array | None) -> Array:
    return np.eye(4) if matrix is None else np.asarray(matrix, dtype=np.float64)


# ---------------------------------------------------------------------- the cache


def _cache(data: bytes) -> pathlib.Path:
    """Return where a robot is kept: another yourdfpy is another place."""
    found = importlib.util.find_spec("yourdfpy")
    parser = ""
    if found is not None and found.origin:
        with contextlib.suppress(OSError):
            parser = f"{found.origin} {os.stat(found.origin).st_mtime_ns}"
    key = hashlib.sha256(f"{_FORMAT} {parser} ".encode() + data).hexdigest()
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return pathlib.Path(home) / "dqwalk_ros" / "robots" / f"{key}.json"


def _kept(path: pathlib.Path) -> Robot | None:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        links = (
            Link(**{**link, "com": np.array(link["com"]), "boxes": tuple(map(_box, link["boxes"]))})
            for link in read["links"]
        )
        joints = (
            Joint(**{**joint, "origin": np.array(joint["origin"]), "axis": np.array(joint["axis"])})
            for joint in read["joints"]
        )
        return Robot(read["name"], tuple(links), tuple(joints))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _box(box: dict[str, Any]) -> Box:
    return Box(np.array(box["size"]), np.array(box["origin"]))


def _keep(path: pathlib.Path, robot: Robot) -> None:
    text = json.dumps(dataclasses.asdict(robot), default=np.ndarray.tolist)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        own = path.with_suffix(f".{os.getpid()}")
        own.write_text(text, encoding="utf-8")
        own.replace(path)  # whole or not at all
        known = sorted(path.parent.glob("*.json"), key=lambda file: file.stat().st_mtime)
        for old in known[:-_KEPT]:
            old.unlink()
