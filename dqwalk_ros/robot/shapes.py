"""The visual and collision shapes of a robot's links as triangles, including meshes."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.robot.packages import find_package_file, is_pointer
from dqwalk_ros.robot.urdf import Urdf, pose_of
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.support.wording import listed

if TYPE_CHECKING:
    from yourdfpy import Collision, Link, Visual

_KINDS = ("collisions", "visuals")
PRIMITIVES = ("box", "cylinder", "sphere")
"""Shapes that every viewer can draw; all other shapes are drawn as triangles."""
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the axes of a file whose y axis is up to those of a link, whose z axis is up."""
_CLOSER = 0.22
"""Logarithm of the factor by which turned meshes must be closer to the CoM of their links."""


@dataclass(frozen=True)
class Surface:
    """A triangulated shape in the frame of its link."""

    vertices: Array
    """Shape (N, 3) [m]."""
    faces: NDArray[np.int64]
    """Indices of the vertices of each triangle, shape (M, 3)."""
    color: tuple[float, float, float, float] | None
    """Red, green, blue, opacity."""
    what: str
    """Kind of the shape, or name of the mesh file."""


class Shapes:
    """Reads the shapes of a robot.

    Parameters
    ----------
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

    def forget(self) -> None:
        """Read the shapes again when they are needed: the frames of links have changed."""
        self._hulls.clear()

    def file(self, mesh: str) -> pathlib.Path | None:
        """Return the absolute path of a mesh; None if it is not found."""
        file = find_package_file(mesh, self._near, self._places)
        return None if file is None else file.absolute()

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

    def hulls(self, names: Sequence[str], which: str = "") -> tuple[dict[str, Array], str]:
        """Return the corners (N, 3) of the convex hulls of some links in their frames [m], and of which surfaces.

        These are the ``collisions``, or, if none of the links has any, the ``visuals``, unless `which` is given; links
        without are left out.
        """
        for kind in (which,) if which else _KINDS:
            found = {name: corners for name in names if (corners := self._hull(name, kind)) is not None}
            if found:
                return found, kind
        return {}, ""

    def complete(self, feet: Sequence[Sequence[str]]) -> tuple[str, dict[str, str]]:
        """Return which surfaces of the links of feet can all be read, or else the reason for each mesh that cannot.

        These are the ``collisions``, or else the ``visuals``, of which each foot has some; links that have none of
        these must have all of the other.
        """
        lost: dict[str, str] = {}
        for which, other in (_KINDS, _KINDS[::-1]):
            shapes = [[(name, getattr(self._links[name], which)) for name in links] for links in feet]
            if not all(any(found for _, found in foot) for foot in shapes):
                continue
            missing = [self._unread(k, found or getattr(self._links[k], other)) for foot in shapes for k, found in foot]
            if not any(missing):
                return which, {}
            lost = lost or {mesh: why for part in missing for mesh, why in part.items()}
        return "", lost

    def unread(self, names: Sequence[str]) -> dict[str, str]:
        """Return the reason for each mesh of some links that cannot be read."""
        links = ((name, self._links[name]) for name in names)
        return {k: v for name, link in links for k, v in self._unread(name, (*link.collisions, *link.visuals)).items()}

    def _unread(self, name: str, shapes: Sequence[Visual | Collision]) -> dict[str, str]:
        """Return the reason for each mesh among some shapes of a link that cannot be read."""
        lost = [shape for shape in shapes if self.surface(self._links[name], shape) is None]
        meshes = [shape.geometry.mesh.filename for shape in lost if shape.geometry.mesh is not None]
        return {mesh: self.missing.get(mesh, "is not finite") for mesh in meshes}

    def _hull(self, name: str, which: str) -> Array | None:
        """Return the corners of the convex hull of a link's surfaces; None for a link without any."""
        key = name, which
        if key not in self._hulls:
            link = self._links[name]
            surfaces = (self.surface(link, shape, hull=True) for shape in getattr(link, which))
            found = [surface.vertices for surface in surfaces if surface is not None]
            one = found[0] if len(found) == 1 else None  # only corners already
            self._hulls[key] = _corners(np.concatenate(found)) if len(found) > 1 else one
        return self._hulls[key]

    def surface(self, link: Link, shape: Visual | Collision, *, hull: bool = False) -> Surface | None:
        """Return a shape of a link as triangles; None if its mesh is not available, for the reason in `missing`.

        With `hull`, a mesh has only the corners of its convex hull, and no triangles.
        """
        kind, size = kind_and_size(shape)
        if kind == "mesh":
            name = shape.geometry.mesh.filename
            file = self.file(name)
            if file is None:
                self.missing[name] = "not found"
                return None
            try:
                vertices, faces, y_up = (_mesh_hull if hull else _mesh)(str(file))
            except Exception as error:  # the reader of each mesh format raises its own exceptions
                self.missing[name] = " ".join(str(error).split())[:100] or type(error).__name__
                return None
            vertices = vertices * size
            if y_up and self._turns_y_up:
                vertices = vertices @ _Y_UP.T
            what = file.name
        else:
            vertices, faces = _primitive(kind, size)
            what = kind
        if not np.isfinite(vertices).all():
            return None
        return Surface(pose_of(shape.origin).transform_point(vertices), faces, rgba_of(shape), what)

    @cached_property
    def _turns_y_up(self) -> bool:
        """Whether meshes that are declared as y up are to be turned to z up: one decision for the robot.

        Some tools ignore the declaration, so it does not say reliably which axis of the file is up. Turned meshes are
        those that are, all in all, closer to the CoM of their links.
        """
        gain = 0.0
        for link in self._links.values():
            for shape in (*link.collisions, *link.visuals):
                kind, size = kind_and_size(shape)
                file = self.file(shape.geometry.mesh.filename) if kind == "mesh" and link.inertial.mass else None
                if file is None or file.suffix.lower() != ".dae":
                    continue
                try:
                    vertices, _, y_up = _mesh(str(file))
                except Exception:  # the reader of each mesh format raises its own exceptions
                    continue
                com = pose_of(shape.origin).conj().transform_point(link.inertial.origin[:3, 3])
                gain += _closer_turned(vertices * size, com) if y_up else 0.0
        return gain > _CLOSER


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


def capsule_around(points: Array) -> tuple[Array, Array, float]:
    """Return the ends (3,) and the radius [m] of a capsule along the longest direction of points that contains them.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        [m]
    """
    axis = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    across = points - np.outer(points @ axis, axis)
    # the middle of the extent across the axis, in a basis of that plane
    basis = np.linalg.svd(axis[None])[2][1:]
    flat = across @ basis.T
    center = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    far = np.linalg.norm(flat - center, axis=1)
    radius = float(far.max())
    along, cap = points @ axis, np.sqrt(np.maximum(radius**2 - far**2, 0.0))
    low, high = float((along + cap).min()), float((along - cap).max())
    if low > high:  # a ball
        low = high = 0.5 * (low + high)
    return basis.T @ center + low * axis, basis.T @ center + high * axis, radius


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


def make_convex(urdf: Urdf, near: pathlib.Path) -> dict[str, bytes]:
    """Replace the collision meshes of a robot by their convex hulls; remove visual shapes, and those without volume.

    Parameters
    ----------
    urdf : Urdf
        Is changed.
    near : path
        Path of the robot description.

    Returns
    -------
    dict of str to bytes
        The hulls by the names that the description has now, as STL files.

    Raises
    ------
    ModelError
        If a mesh is not available.
    """
    import trimesh

    shapes, files = Shapes(urdf, near), dict[str, bytes]()
    for name, link in urdf.links.items():
        link.visuals.clear()
        solid = [shape for shape in link.collisions if all(kind_and_size(shape)[1])]
        link.collisions[:] = solid
        for shape in solid:
            if (mesh := shape.geometry.mesh) is None:
                continue
            if (surface := shapes.surface(link, shape)) is None:
                raise ModelError(f"a mesh of {name} is not available: {listed(shapes.missing)}")
            file = f"{len(files)}.stl"
            try:
                hull = trimesh.Trimesh(surface.vertices, surface.faces, process=False).convex_hull
            except Exception as error:  # a mesh without volume; Qhull has its own exceptions
                raise ModelError(f"the mesh '{surface.what}' of {name} has no convex hull") from error
            files[file] = hull.export(file_type="stl")
            shape.origin, mesh.filename, mesh.scale = None, file, None
    return files


def _simplified(surface: Surface, cell: float) -> Surface:
    """Return a surface whose vertices are merged within the cells of a cubic grid of size `cell` [m]."""
    _, first, place = np.unique(np.round(surface.vertices / cell), axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[surface.faces]
    a, b, c = faces.T
    return replace(surface, vertices=surface.vertices[first], faces=faces[(a != b) & (b != c) & (c != a)])


@lru_cache(maxsize=512)
def _mesh(file: str) -> tuple[Array, NDArray[np.int64], bool]:
    """Return vertices (N, 3) [m] and faces (M, 3) of a file, and whether the file declares its y axis as up."""
    import trimesh

    if is_pointer(file):
        raise ValueError("is a Git LFS pointer instead of a mesh: run 'git lfs pull' in its repository")
    mesh: Any = trimesh.load(file, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if not len(vertices):
        raise ValueError("has no triangles")
    y_up = False
    if file.lower().endswith(".dae"):
        text = pathlib.Path(file).read_bytes()[:20000]
        y_up = b"<up_axis>Y_UP" in text
        units = str(mesh.metadata.get("units", ""))
        if units.endswith("* meters"):
            vertices = vertices * float(units.split()[0])
    return vertices, np.asarray(mesh.faces, dtype=np.int64), y_up


@lru_cache(maxsize=512)
def _mesh_hull(file: str) -> tuple[Array, NDArray[np.int64], bool]:
    """Return what `_mesh` does, with the corners of the convex hull and no faces."""
    vertices, _, y_up = _mesh(file)
    return _corners(vertices), np.empty((0, 3), np.int64), y_up


def _closer_turned(vertices: Array, com: Array) -> float:
    """Return the logarithm of the factor by which a mesh (N, 3) is closer to a point (3,) after a turn to z up."""

    def distance(points: Array) -> float:
        low, high = points.min(axis=0), points.max(axis=0)
        return float(np.linalg.norm(np.maximum(np.maximum(low - com, com - high), 0.0))) + 0.1 * float(
            np.linalg.norm(0.5 * (low + high) - com)
        )

    return math.log(max(distance(vertices), 1e-6) / max(distance(vertices @ _Y_UP.T), 1e-6))


@lru_cache(maxsize=512)
def _primitive(kind: str, size: tuple[float, ...]) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices (N, 3) [m] and faces (M, 3) of one of `PRIMITIVES`."""
    import trimesh

    make = trimesh.creation
    if kind == "box":
        mesh = make.box(size)
    elif kind == "sphere":
        mesh = make.icosphere(subdivisions=2)
        mesh.vertices *= size[0]  # which is zero where a description gives points of contact
    else:
        mesh = make.cylinder(radius=size[0], height=size[1])
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
