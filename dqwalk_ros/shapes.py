"""The shapes of a robot's links as points and triangles, meshes included."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.packages import find_package_file
from dqwalk_ros.urdf import Link, Shape, Urdf

__all__ = ["PRIMITIVES", "Shapes", "Surface", "meshes_of"]

Array = NDArray[np.float64]

PRIMITIVES = ("box", "cylinder", "sphere")
"""What everything that draws has; what else there is, is drawn as triangles."""


@dataclass(frozen=True)
class Surface:
    """A triangulated shape in the frame of its link: vertices (N, 3) [m], faces (M, 3), colour, and its source."""

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
        The file of the robot description, around which packages are looked for.
    places : sequence of path
        Folders that may hold packages, too.

    Attributes
    ----------
    missing : dict of str to str
        Meshes that were not found or cannot be read, and why.
    """

    def __init__(self, urdf: Urdf, near: pathlib.Path, places: tuple[pathlib.Path, ...] = ()) -> None:
        self._links, self._near, self._places = urdf.links, near, places
        self.missing: dict[str, str] = {}

    def file(self, mesh: str) -> pathlib.Path | None:
        """Return the file of a mesh, or None."""
        return find_package_file(mesh, self._near, self._places)

    def named(self, link: Link) -> Link:
        """Return a link whose meshes are named by their files, as far as they were found."""

        def renamed(shape: Shape) -> Shape:
            file = self.file(shape.mesh) if shape.kind == "mesh" else None
            return shape if file is None else replace(shape, mesh=file.resolve().as_uri())

        return replace(link, visuals=tuple(map(renamed, link.visuals)), collisions=tuple(map(renamed, link.collisions)))

    def of(self, name: str, which: str) -> list[Surface]:
        """Return the surfaces of a link; `which` is ``visuals`` or ``collisions``."""
        link = self._links[name]
        found = (self.surface(link, shape) for shape in getattr(link, which))
        return [surface for surface in found if surface is not None]

    def surface(self, link: Link, shape: Shape) -> Surface | None:
        """Return a shape of a link as triangles; None where its mesh cannot be had, which `missing` explains."""
        if shape.kind == "mesh":
            file = self.file(shape.mesh)
            if file is None:
                self.missing[shape.mesh] = "not found"
                return None
            try:
                vertices, faces, sideways = _mesh(str(file))
            except Exception as error:  # every format has its own
                self.missing[shape.mesh] = " ".join(str(error).split())[:100] or type(error).__name__
                return None
            vertices = vertices * shape.size
            if sideways and _fits_better_upright(vertices, link, shape):
                vertices = vertices @ _UPRIGHT.T
            what = file.name
        else:
            vertices, faces = _primitive(shape)
            what = shape.kind
        if not np.isfinite(vertices).all():
            return None
        pose = shape.origin.matrix
        return Surface(vertices @ pose[:3, :3].T + pose[:3, 3], faces, shape.color, what)


def meshes_of(urdf: Urdf, near: pathlib.Path, most: int = 60_000) -> list[tuple[str, Surface]]:
    """Return what is seen of a robot and is no primitive, by its link.

    Parameters
    ----------
    urdf : Urdf
    near : path
        The file of the robot description.
    most : int
        So many triangles in all, about: finer meshes are made coarser.
    """
    shapes = Shapes(urdf, near)
    found = [
        (name, surface)
        for name, link in urdf.links.items()
        for shape in link.visuals
        if shape.kind not in PRIMITIVES and (surface := shapes.surface(link, shape)) is not None
    ]
    fine, cell = found, 0.5e-3
    while sum(len(surface.faces) for _, surface in found) > most:
        cell *= 2.0
        found = [(name, _coarser(surface, cell)) for name, surface in fine]
    return found


def _coarser(surface: Surface, cell: float) -> Surface:
    """Return a surface whose vertices are merged within cells of that size [m]."""
    _, first, place = np.unique(np.round(surface.vertices / cell), axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[surface.faces]
    a, b, c = faces.T
    return replace(surface, vertices=surface.vertices[first], faces=faces[(a != b) & (b != c) & (c != a)])


_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From a file whose y axis is up."""


@lru_cache(maxsize=512)
def _mesh(file: str) -> tuple[Array, NDArray[np.int64], bool]:
    """Return vertices and faces of a file, and whether it says that its y axis is up."""
    import trimesh

    mesh: Any = trimesh.load(file, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not len(vertices):
        raise ValueError("it has no triangles")
    sideways = False
    if file.lower().endswith(".dae"):
        text = pathlib.Path(file).read_bytes()[:20000]
        sideways = b"<up_axis>Y_UP" in text
        units = str(mesh.metadata.get("units", ""))
        if units.endswith("* meters"):
            vertices = vertices * float(units.split()[0])
    return vertices, np.asarray(mesh.faces, dtype=np.int64), sideways


def _fits_better_upright(vertices: Array, link: Link, shape: Shape) -> bool:
    """Tell whether a mesh lies nearer to the link's CoM with its y axis up, as its file says.

    Tools differ in whether they heed that, so files that say it are not reliable.
    """
    if not link.mass:
        return False
    pose = shape.origin.matrix
    com = pose[:3, :3].T @ (link.com - pose[:3, 3])

    def distance(points: Array) -> float:
        low, high = points.min(axis=0), points.max(axis=0)
        return float(np.linalg.norm(np.maximum(np.maximum(low - com, com - high), 0.0))) + 0.1 * float(
            np.linalg.norm(0.5 * (low + high) - com)
        )

    return distance(vertices @ _UPRIGHT.T) < 0.8 * distance(vertices)


def _primitive(shape: Shape) -> tuple[Array, NDArray[np.int64]]:
    import trimesh

    make = trimesh.creation
    if shape.kind == "box":
        mesh = make.box(shape.size)
    elif shape.kind == "sphere":
        mesh = make.icosphere(subdivisions=2, radius=shape.size[0])
    elif shape.kind == "cylinder":
        mesh = make.cylinder(radius=shape.size[0], height=shape.size[1])
    else:
        mesh = make.capsule(radius=shape.size[0], height=shape.size[1])
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
