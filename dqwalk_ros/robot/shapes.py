"""The visual and collision shapes of a robot's links as triangles, including meshes."""

from __future__ import annotations

import pathlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.robot.packages import find_package_file
from dqwalk_ros.robot.urdf import Urdf, pose_of
from dqwalk_ros.support.arrays import Array

if TYPE_CHECKING:
    from yourdfpy import Collision, Link, Visual

__all__ = ["PRIMITIVES", "Shapes", "Surface", "kind_and_size", "meshes_of", "rgba_of"]


PRIMITIVES = ("box", "cylinder", "sphere")
"""Shapes that every viewer can draw; all other shapes are drawn as triangles."""


@dataclass(frozen=True)
class Surface:
    """A triangulated shape in the frame of its link.

    Attributes
    ----------
    vertices : ndarray, shape (N, 3)
        [m]
    faces : ndarray of int, shape (M, 3)
        Indices of the vertices of each triangle.
    color : tuple of four float, or None
        Red, green, blue, opacity.
    what : str
        Kind of the shape, or name of the mesh file.
    """

    vertices: Array
    faces: NDArray[np.int64]
    color: tuple[float, float, float, float] | None
    what: str


class Shapes:
    """Reads the shapes of a robot.

    Parameters
    ----------
    urdf : Urdf
    near : path
        Path of the robot description; packages are also searched in the folders around it.
    places : sequence of path
        Additional folders that contain packages.

    Attributes
    ----------
    missing : dict of str to str
        Reason for each mesh that was not found or cannot be read.
    """

    def __init__(self, urdf: Urdf, near: pathlib.Path, places: tuple[pathlib.Path, ...] = ()) -> None:
        self._links, self._near, self._places = urdf.links, near, places
        self.missing: dict[str, str] = {}
        self._hulls: dict[tuple[str, str], Array | None] = {}

    def file(self, mesh: str) -> pathlib.Path | None:
        """Return the path of a mesh; None if it is not found."""
        return find_package_file(mesh, self._near, self._places)

    def name_files(self) -> None:
        """Name the meshes that are found by the URI of their file, in the description itself."""
        for link in self._links.values():
            for shape in (*link.visuals, *link.collisions):
                mesh = shape.geometry.mesh
                if mesh is not None and (file := self.file(mesh.filename)) is not None:
                    mesh.filename = file.resolve().as_uri()

    def of(self, name: str, which: str) -> list[Surface]:
        """Return the surfaces of a link; `which` is ``visuals`` or ``collisions``."""
        link = self._links[name]
        found = (self.surface(link, shape) for shape in getattr(link, which))
        return [surface for surface in found if surface is not None]

    def hulls(self, names: Sequence[str]) -> tuple[dict[str, Array], str]:
        """Return the corners (N, 3) of the convex hulls of some links in their frames [m], and of which surfaces.

        These are the ``collisions``, or, if none of the links has any, the ``visuals``; links without are left out.
        """
        for which in ("collisions", "visuals"):
            found = {name: corners for name in names if (corners := self._hull(name, which)) is not None}
            if found:
                return found, which
        return {}, ""

    def _hull(self, name: str, which: str) -> Array | None:
        """Return the corners of the convex hull of a link's surfaces; None for a link without any."""
        key = name, which
        if key not in self._hulls:
            found = [surface.vertices for surface in self.of(name, which)]
            self._hulls[key] = _corners(np.concatenate(found)) if found else None
        return self._hulls[key]

    def surface(self, link: Link, shape: Visual | Collision) -> Surface | None:
        """Return a shape of a link as triangles; None if its mesh is not available, for the reason in `missing`."""
        kind, size = kind_and_size(shape)
        if kind == "mesh":
            name = shape.geometry.mesh.filename
            file = self.file(name)
            if file is None:
                self.missing[name] = "not found"
                return None
            try:
                vertices, faces, y_up = _mesh(str(file))
            except Exception as error:  # the reader of each mesh format raises its own exceptions
                self.missing[name] = " ".join(str(error).split())[:100] or type(error).__name__
                return None
            vertices = vertices * size
            if y_up and _is_closer_rotated(vertices, link, shape):
                vertices = vertices @ _Y_UP.T
            what = file.name
        else:
            vertices, faces = _primitive(kind, size)
            what = kind
        if not np.isfinite(vertices).all():
            return None
        return Surface(pose_of(shape.origin).transform_point(vertices), faces, rgba_of(shape), what)


def kind_and_size(shape: Visual | Collision) -> tuple[str, tuple[float, ...]]:
    """Return the kind of a shape, and its size [m].

    These are ``box`` (x, y, z), ``cylinder`` (radius, length along z), ``sphere`` (radius), or ``mesh`` (scale of x, y
    and z).
    """
    kind, given = next((kind, given) for kind, given in vars(shape.geometry).items() if given is not None)
    if kind == "mesh":
        return kind, tuple((given.scale * np.ones(3)).tolist())
    return kind, tuple(np.hstack([*vars(given).values()]).tolist())


def rgba_of(shape: Visual | Collision) -> tuple[float, float, float, float] | None:
    """Return red, green, blue and opacity of a shape, or None if it has no color."""
    material = getattr(shape, "material", None)
    return tuple(material.color.rgba.tolist()) if material else None


def _corners(points: Array) -> Array:
    """Return the corners (M, 3) of the convex hull of points (N, 3), or all points if they span no volume."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and few robots need it

    try:
        corners: Array = points[ConvexHull(points).vertices]
        return corners
    except (QhullError, ValueError):
        return points


_MOST = 60_000
"""Largest number of triangles of a robot."""


def meshes_of(urdf: Urdf, near: pathlib.Path) -> list[tuple[str, Surface]]:
    """Return the visual shapes of a robot that are not in `PRIMITIVES`, each with the name of its link.

    `near` is the path of the robot description. Meshes with more than `_MOST` triangles in all are simplified.
    """
    shapes = Shapes(urdf, near)
    found = [
        (name, surface)
        for name, link in urdf.links.items()
        for shape in link.visuals
        if kind_and_size(shape)[0] not in PRIMITIVES and (surface := shapes.surface(link, shape)) is not None
    ]
    full, cell = found, 0.5e-3
    while sum(len(surface.faces) for _, surface in found) > _MOST:
        cell *= 2.0
        found = [(name, _simplified(surface, cell)) for name, surface in full]
    return found


def _simplified(surface: Surface, cell: float) -> Surface:
    """Return a surface whose vertices are merged within the cells of a cubic grid of size `cell` [m]."""
    _, first, place = np.unique(np.round(surface.vertices / cell), axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[surface.faces]
    a, b, c = faces.T
    return replace(surface, vertices=surface.vertices[first], faces=faces[(a != b) & (b != c) & (c != a)])


_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the axes of a file whose y axis is up to those of a link, whose z axis is up."""


@lru_cache(maxsize=512)
def _mesh(file: str) -> tuple[Array, NDArray[np.int64], bool]:
    """Return vertices (N, 3) [m] and faces (M, 3) of a file, and whether the file declares its y axis as up."""
    import trimesh

    mesh: Any = trimesh.load(file, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not len(vertices):
        raise ValueError("it has no triangles")
    y_up = False
    if file.lower().endswith(".dae"):
        text = pathlib.Path(file).read_bytes()[:20000]
        y_up = b"<up_axis>Y_UP" in text
        units = str(mesh.metadata.get("units", ""))
        if units.endswith("* meters"):
            vertices = vertices * float(units.split()[0])
    return vertices, np.asarray(mesh.faces, dtype=np.int64), y_up


def _is_closer_rotated(vertices: Array, link: Link, shape: Visual | Collision) -> bool:
    """Return whether a mesh that is declared as y up is closer to the link's CoM after the rotation to z up.

    Some tools ignore the declaration, so it does not tell reliably which axis of the file is up.
    """
    if not link.inertial.mass:
        return False
    com = pose_of(shape.origin).conj().transform_point(link.inertial.origin[:3, 3])

    def distance(points: Array) -> float:
        low, high = points.min(axis=0), points.max(axis=0)
        return float(np.linalg.norm(np.maximum(np.maximum(low - com, com - high), 0.0))) + 0.1 * float(
            np.linalg.norm(0.5 * (low + high) - com)
        )

    return distance(vertices @ _Y_UP.T) < 0.8 * distance(vertices)


def _primitive(kind: str, size: Sequence[float]) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices (N, 3) [m] and faces (M, 3) of one of `PRIMITIVES`."""
    import trimesh

    make = trimesh.creation
    if kind == "box":
        mesh = make.box(size)
    elif kind == "sphere":
        mesh = make.icosphere(subdivisions=2, radius=size[0])
    else:
        mesh = make.cylinder(radius=size[0], height=size[1])
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
