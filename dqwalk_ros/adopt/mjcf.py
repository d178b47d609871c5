"""Robot descriptions of MuJoCo (MJCF), converted to a URDF with the same links, joints, masses and shapes.

MuJoCo itself reads the file and resolves its defaults, classes, units and included files. Its bodies become links, each
with the origin of its last joint; bodies with several joints get links without mass between these. What a URDF has no
word for, the drives of the joints, is returned beside it.
"""

from __future__ import annotations

import math
import os
import pathlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.robot.packages import find_package_file, is_pointer
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import ModelError

_CARRIED = 0.2
"""Least mass that a joint of a limb carries, as a fraction of that of another joint of its loop; rods carry less."""
_TETRAHEDRON = [0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0, 0.001]
"""Corners of a small mesh in the place of a missing one [m]."""
_UNKNOWN = re.compile(r"unrecognized attribute: '(\w+)' Element '(\w+)'")
"""What MuJoCo says of an attribute that it does not know; its name, and that of its element."""
_NUMBERS = re.compile(r"bad format in attribute '(\w+)' Element '(\w+)'")
"""What MuJoCo says of numbers that it cannot read, as those with commas; their attribute, and its element."""
_WEIGHTLESS = re.compile(r"mass and inertia of moving bodies must be larger.*Element name '(.*?)'")
"""What MuJoCo says of a moving body without mass or inertia; its name."""
_LEAST_MASS = 1e-5, 1e-9
"""Mass [kg] and moment of inertia [kg m^2] of a moving body without."""
_TURNS = {"quat", "axisangle", "xyaxes", "zaxis", "euler"}
"""Attributes of an orientation."""
_SETTINGS = {
    "compiler",
    "flag",
    "global",
    "headlight",
    "map",
    "option",
    "quality",
    "rgba",
    "scale",
    "size",
    "statistic",
}
"""Elements of MJCF that are not about a robot."""
_HOLLOW = re.compile(r"mesh volume is too small: (.+?) \.")
"""What MuJoCo says of a mesh that encloses no volume; its name."""


@dataclass(frozen=True)
class MjcfDrive:
    """What an MJCF file says about the drive of a joint."""

    stiffness: float
    damping: float
    """Gains of its position actuator, 0 without one, and with the damping of the joint [N m/rad, N m s/rad]."""
    armature: float
    """[kg m^2]"""
    friction: float
    """[N m]"""


def is_mjcf(path: pathlib.Path) -> bool:
    """Return whether a file is MJCF: its outermost element is <mujoco>."""
    try:
        return bool(next(root.tag for _, root in ElementTree.iterparse(path, ["start"])) == "mujoco")
    except (OSError, ElementTree.ParseError, StopIteration, ValueError):
        return False  # what reads it says so


def load_mjcf(path: pathlib.Path, places: Sequence[str | os.PathLike[str]] = ()) -> tuple[Urdf, dict[str, MjcfDrive]]:
    """Return the description of an MJCF file, and the drives of its joints by name.

    Meshes that are not where the file says are searched around it and in the folders `places`. Pictures and height
    fields, which a robot does not need, are not read.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file, a mass follows from a mesh that cannot be read, the file has no
        robot, or actuated joints form a loop.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(f"'{path}' is a file of MuJoCo: pip install mujoco, which reads it") from error
    spec, repairs = _spec(path)
    lost = _replace_missing(path, spec, places)
    for body in spec.bodies:
        for geom in () if body.explicitinertial else body.geoms:
            file = lost.get(geom.meshname)
            if file is not None and geom.density > 0.0 and not math.isfinite(geom.mass):
                why = "is a Git LFS pointer: run 'git lfs pull' in its repository" if file.is_file() else "is not found"
                raise ModelError(f"'{path}': the mass of '{body.name}' follows from the mesh '{file}', which {why}")
    for element in (*spec.pairs, *spec.excludes, *spec.keys, *spec.sensors):  # they may name what is in another file
        spec.delete(element)
    hollow: list[str] = []
    while True:
        try:
            mj = spec.compile()
            break
        except (ValueError, RuntimeError) as error:
            text = " ".join(str(error).split())
            weightless, found = _WEIGHTLESS.search(text), _HOLLOW.search(text)
            if weightless and not spec.compiler.boundmass:
                spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS
                mass, inertia = _LEAST_MASS
                repairs.append(
                    f"body '{weightless[1]}' moves, but has no mass or inertia: at least {mass:g} kg and {inertia:g} "
                    "kg m^2 of each body are assumed"
                )
                continue
            if found is None or found[1] in hollow:
                raise ModelError(f"MuJoCo refuses '{path}': {text[:300]}") from error
            hollow.append(found[1])
            for mesh in spec.meshes:
                if (mesh.name or pathlib.Path(mesh.file).stem) == found[1]:
                    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    conversion = _Conversion(path, mujoco, spec, mj, lost)
    conversion.repairs += repairs
    conversion.repairs += [f"the mesh '{name}' encloses no volume: taken as a shell" for name in hollow]
    urdf = Urdf(conversion.text(), str(path))
    # the lines are those of the conversion
    urdf.repairs = [*conversion.repairs, *(re.sub(r"^line \d+: ", "", text) for text in urdf.repairs)]
    return urdf, conversion.drives


def _spec(path: pathlib.Path) -> tuple[Any, list[str]]:
    """Return a file as MuJoCo reads it, without settings of other versions of MuJoCo; and what was left out."""
    import mujoco

    repairs = list[str]()
    root = None if path.suffix.lower() == ".xml" else _with_includes(path, repairs)
    while True:
        try:
            if root is None:
                return mujoco.MjSpec.from_file(str(path)), repairs
            return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode")), repairs
        except (ValueError, RuntimeError, OSError) as error:
            text = " ".join(str(error).split())
            unknown, unread = _UNKNOWN.search(text), _NUMBERS.search(text)
            found, twice = unknown or unread, "at most one of 'fullinertia'" in text
            if root is None and (found or twice or "Element 'include'" in text):
                root = _with_includes(path, repairs)
                if not (found or twice):
                    continue
            if twice and root is not None and _without_turns(root):
                repairs.append(
                    "<inertial> has an orientation beside 'fullinertia', as older versions ignored: left out"
                )
                continue
            named = [] if root is None or not found else [e for e in root.iter(found[2]) if found[1] in e.attrib]
            if unread and (named := [e for e in named if "," in e.attrib[unread[1]]]):
                for element in named:
                    element.attrib[unread[1]] = element.attrib[unread[1]].replace(",", " ")
                repairs.append(f"<{unread[2]}> has commas between the numbers of '{unread[1]}': left out")
                continue
            if unknown is None or unknown[2] not in _SETTINGS or not named:
                raise ModelError(f"MuJoCo refuses '{path}': {text[:300]}") from error
            for element in named:
                del element.attrib[unknown[1]]
            repairs.append(f"<{unknown[2]}> has the attribute '{unknown[1]}' of another version of MuJoCo: left out")


def _without_turns(root: ElementTree.Element) -> bool:
    """Take the orientations from the elements <inertial> with all moments of inertia; return whether there were any."""
    given = [one for one in root.iter("inertial") if "fullinertia" in one.attrib and _TURNS & one.attrib.keys()]
    for element in given:
        for key in _TURNS & element.attrib.keys():
            del element.attrib[key]
    return bool(given)


def _with_includes(file: pathlib.Path, repairs: list[str], *within: pathlib.Path) -> ElementTree.Element:
    """Return the root of an MJCF file with the contents of the files that it includes; `within` includes it.

    Files that are missing, such as sky and floor that a package provides, are left out and listed in `repairs`.
    """
    main, *_ = *within, file
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise ModelError(f"'{main}' cannot be read: '{file}': {error}") from error
    if file in within:
        raise ModelError(f"'{main}' cannot be read: '{file}' includes itself")
    for parent in [*root.iter()]:
        for at, child in reversed([*enumerate(parent)]):
            if child.tag == "include":
                part = main.parent / child.get("file", "")
                if part.is_file():
                    parent[at : at + 1] = [*_with_includes(part, repairs, *within, file)]
                else:
                    parent.remove(child)
                    repairs.append(f"the file '{child.get('file')}' that it includes is not found: left out")
    return root


def _mesh_file(path: pathlib.Path, spec: Any, mesh: Any, places: Sequence[str | os.PathLike[str]] = ()) -> pathlib.Path:
    """Return the file of a mesh: the named one, or if it does not exist that of the same name near the MJCF file."""
    inside = pathlib.Path(str(spec.meshdir or "")) / str(mesh.file)
    named = pathlib.Path(spec.modelfiledir or path.parent) / inside
    if named.is_file():
        return named
    found = (find_package_file(str(uri), path, places) for uri in (inside, mesh.file))
    return next((file for file in found if file), named)


def _replace_missing(
    path: pathlib.Path, spec: Any, places: Sequence[str | os.PathLike[str]]
) -> dict[str, pathlib.Path]:
    """Replace meshes that cannot be read by small ones, without which MuJoCo refuses a file; return their files.

    The converted description names the true files, and what reads its shapes says what is missing. Pictures, materials
    and height fields are left out or replaced as well.
    """
    lost = {}
    for mesh in spec.meshes:
        file = _mesh_file(path, spec, mesh, places)
        if mesh.file and file.is_file() and not is_pointer(file):
            mesh.file = str(file.resolve())
        elif mesh.file:
            lost[mesh.name or file.stem] = file
            mesh.name, mesh.file = mesh.name or file.stem, ""
            mesh.uservert, mesh.userface = _TETRAHEDRON, [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
    for drawn in (*spec.geoms, *spec.sites, *spec.tendons):
        drawn.material = ""  # it may be in a file that includes this one
    for picture in (*spec.materials, *spec.textures, *spec.skins):
        spec.delete(picture)
    for field in spec.hfields:
        field.file, field.nrow, field.ncol, field.userdata = "", 2, 2, [0.0] * 4
    return lost


class _Conversion:
    """The conversion of one compiled model."""

    def __init__(self, path: pathlib.Path, mujoco: Any, spec: Any, mj: Any, lost: dict[str, pathlib.Path]) -> None:
        self._path, self._mujoco, self._spec, self._mj, self._lost = path, mujoco, spec, mj, lost
        self.repairs: list[str] = []
        self.drives: dict[str, MjcfDrive] = {}
        self._robot = ElementTree.Element("robot", {"name": spec.modelname or path.stem})
        self._offset: dict[int, Array] = {}  # position of the origin of a body's link in the body [m]
        self._fixed: set[int] = set()  # joints of linkages
        self._motors: dict[int, list[int]] = {}  # joints with actuators that move a joint through a linkage
        self._names = {body: mj.body(body).name or f"body_{body}" for body in range(1, mj.nbody)}

    def text(self) -> str:
        """Return the description as URDF."""
        mj = self._mj
        root = self._root()
        inside = [body for body in range(1, mj.nbody) if mj.body_rootid[body] == root]
        driven = {joint for joint in map(self._joint_of, range(mj.nu)) if joint is not None and self._has_axis(joint)}
        self._open_loops(set(inside), driven)
        for body in inside:
            self._add_body(body, root, driven)
        for site in range(mj.nsite):
            body, name = int(mj.site_bodyid[site]), mj.site(site).name
            if body in inside and name and name not in self._names.values():
                ElementTree.SubElement(self._robot, "link", {"name": name})
                pose = DQ.from_pose(mj.site_pos[site] - self._offset[body], mj.site_quat[site])
                self._add_joint(f"{name}_fixed", "fixed", self._names[body], name, pose)
        self._add_led()
        return ElementTree.tostring(self._robot, encoding="unicode")

    def _root(self) -> int:
        """Return the body that carries most others of those on the world."""
        mj = self._mj
        count = {body: int((mj.body_rootid == body).sum()) for body in range(1, mj.nbody) if not mj.body_parentid[body]}
        if not count:
            raise ModelError(f"'{self._path}' has no body, so no robot")
        root = max(count, key=lambda body: count[body])
        hang = [self._names[body] for body in count if self._hangs(body)]
        if len(hang) > 1 and self._hangs(root):
            raise ModelError(
                f"'{self._path}': the bodies {', '.join(hang)} are attached to the world by joints of their own, so "
                "the link that carries the legs, with its mass, is not in the file: put them into one <body> with a "
                "<freejoint/> and an <inertial>"
            )
        others = [self._names[body] for body in count if body != root]
        if others:
            self.repairs.append(f"bodies on the world besides '{self._names[root]}' are left out: {', '.join(others)}")
        return root

    def _hangs(self, body: int) -> bool:
        """Return whether a body on the world has joints, and all of them hinges or slides."""
        mj, free = self._mj, self._mujoco.mjtJoint.mjJNT_FREE
        joints = range(mj.body_jntadr[body], mj.body_jntadr[body] + mj.body_jntnum[body])
        return bool(joints) and not any(_is(mj.jnt_type[j], free) for j in joints)

    def _open_loops(self, inside: set[int], driven: set[int]) -> None:
        """Open the loops of links: the limb's own joints are taken as driven, those of its linkage as fixed.

        A crank and its rods carry little beside a limb; a linear actuator may be heavy, but slides. A limb with more
        joints than its loops have actuators is not moved by its joints one by one: they are all fixed.
        """
        mj, types = self._mj, self._mujoco.mjtEq
        loops: list[tuple[set[int], set[int]]] = []  # joints of each, and those of its limbs
        for k in range(mj.neq):
            ends = self._ends(k) if _is(mj.eq_type[k], types.mjEQ_CONNECT, types.mjEQ_WELD) else ()
            if not ends or not mj.eq_active0[k] or not inside.issuperset(ends):
                continue
            joints = self._joints_to(ends[0]) ^ self._joints_to(ends[1])
            carried = {j: float(mj.body_subtreemass[mj.jnt_bodyid[j]]) for j in joints}
            limbs = {j for j in joints if carried[j] > _CARRIED * max(carried.values())}
            others = [loop for loop in loops if loop[0] & joints]
            loops = [loop for loop in loops if loop not in others]
            loops.append((joints.union(*(loop[0] for loop in others)), limbs.union(*(loop[1] for loop in others))))
        for joints, limbs in loops:
            if not joints - (driven or limbs):
                what = ", ".join(map(self._joint_name, sorted(joints)))
                raise ModelError(f"'{self._path}': {what} are in a loop of links; only trees of links can walk")
            limbs = limbs & self._turning(joints) or limbs
            motors, names = joints & driven, ", ".join(map(self._joint_name, sorted(limbs)))
            moved = not self._mj.nu or len(limbs) <= len(motors)
            linear = "" if all(map(self._turns, motors)) else "; the torques of its linear actuators are not known"
            self.repairs.append(
                f"a loop of links moves {names}: taken as driven directly, its linkage as fixed{linear}"
                if moved
                else f"a loop of links has the joints {names} and {len(motors)} actuators: all taken as fixed"
            )
            self._fixed |= joints - limbs if moved else joints
            if moved and driven:
                self._motors |= {j: sorted(motors - limbs) for j in limbs - driven}
                driven |= limbs

    def _turning(self, joints: set[int]) -> set[int]:
        """Return those joints of a loop that turn, and carry none of its joints that slide."""
        mj, slide = self._mj, self._mujoco.mjtJoint.mjJNT_SLIDE
        sliding = [j for j in joints if _is(mj.jnt_type[j], slide)]
        return {j for j in joints if self._turns(j)} - set[int]().union(
            *(self._joints_to(int(mj.jnt_bodyid[j])) for j in sliding)
        )

    def _joints_to(self, body: int) -> set[int]:
        """Return the joints that move a body."""
        mj, out = self._mj, set[int]()
        while body:
            out |= {*range(mj.body_jntadr[body], mj.body_jntadr[body] + mj.body_jntnum[body])}
            body = int(mj.body_parentid[body])
        return out

    def _ends(self, equality: int) -> tuple[int, int]:
        mj = self._mj
        ids = int(mj.eq_obj1id[equality]), int(mj.eq_obj2id[equality])
        if _is(mj.eq_objtype[equality], self._mujoco.mjtObj.mjOBJ_SITE):
            return int(mj.site_bodyid[ids[0]]), int(mj.site_bodyid[ids[1]])
        return ids

    def _joint_of(self, actuator: int) -> int | None:
        """Return the joint that an actuator drives; None if it drives something else."""
        mj, types = self._mj, self._mujoco.mjtTrn
        on_joint = _is(mj.actuator_trntype[actuator], types.mjTRN_JOINT, types.mjTRN_JOINTINPARENT)
        return int(mj.actuator_trnid[actuator, 0]) if on_joint else None

    def _add_body(self, body: int, root: int, driven: set[int]) -> None:
        mj, name = self._mj, self._names[body]
        parent = int(mj.body_parentid[body])
        joints = [*range(mj.body_jntadr[body], mj.body_jntadr[body] + mj.body_jntnum[body])]
        if body == root:
            self._offset[body] = np.zeros(3)
            held = [self._joint_name(j) for j in joints if not _is(mj.jnt_type[j], self._mujoco.mjtJoint.mjJNT_FREE)]
            if held:
                self.repairs.append(f"the joints {', '.join(held)} between world and '{name}' are left out: it floats")
            self._add_link(name, body)
            return
        joints = [j for j in joints if self._usable(j, driven)]
        pose = DQ.from_pose(mj.body_pos[body] - self._offset[parent], mj.body_quat[body])
        last, at = self._names[parent], np.zeros(3)
        for j in joints:
            end = name if j == joints[-1] else f"{name}_{self._joint_name(j)}"
            axis, place = mj.jnt_axis[j], mj.jnt_pos[j]
            rest = DQ.rotation_about(-float(mj.qpos0[mj.jnt_qposadr[j]]), axis) if self._turns(j) else DQ(1.0)
            pose = pose * DQ.from_pose(place - at) * rest
            if end != name:
                ElementTree.SubElement(self._robot, "link", {"name": end})
            self._add_moving(j, last, end, pose)
            pose, at, last = DQ(1.0), place, end
        self._offset[body] = at
        if not joints:
            self._add_joint(f"{name}_fixed", "fixed", last, name, pose)
        self._add_link(name, body)

    def _turns(self, joint: int) -> bool:
        return _is(self._mj.jnt_type[joint], self._mujoco.mjtJoint.mjJNT_HINGE)

    def _joint_name(self, joint: int) -> str:
        return str(self._mj.joint(joint).name or f"joint_{joint}")

    def _has_axis(self, joint: int) -> bool:
        """Return whether a joint turns about or slides along an axis."""
        types = self._mujoco.mjtJoint
        return _is(self._mj.jnt_type[joint], types.mjJNT_HINGE, types.mjJNT_SLIDE)

    def _usable(self, joint: int, driven: set[int]) -> bool:
        name = self._joint_name(joint)
        led = any(
            _is(self._mj.eq_type[k], self._mujoco.mjtEq.mjEQ_JOINT) and self._mj.eq_obj1id[k] == joint
            for k in range(self._mj.neq)
        )
        if not self._has_axis(joint):
            self.repairs.append(f"joint '{name}' is a ball or free joint: taken as fixed")
        elif joint in self._fixed:
            pass  # `_open_loops` says so
        elif driven and joint not in driven and not led:
            self.repairs.append(f"joint '{name}' has no actuator, others have one: taken as fixed")
        else:
            return True
        return False

    def _add_moving(self, joint: int, parent: str, child: str, pose: DQ) -> None:
        """Add a joint that moves, with limits and drive."""
        mj, name = self._mj, self._joint_name(joint)
        limited, dof = bool(mj.jnt_limited[joint]), int(mj.jnt_dofadr[joint])
        kind = ("revolute" if limited else "continuous") if self._turns(joint) else "prismatic"
        element = self._add_joint(name, kind, parent, child, pose)
        ElementTree.SubElement(element, "axis", {"xyz": _words(mj.jnt_axis[joint])})
        efforts = [float(np.abs(mj.jnt_actfrcrange[joint]).max())] if mj.jnt_actfrclimited[joint] else []
        stiffness, damping = 0.0, float(np.atleast_1d(mj.dof_damping[dof])[0])
        for k in range(mj.nu):
            motor = self._joint_of(k)
            if motor not in (joint, *self._motors.get(joint, ())):
                continue
            if mj.jnt_type[motor] != mj.jnt_type[joint]:
                continue  # the force of a linear actuator is no torque
            gear = abs(float(mj.actuator_gear[k, 0]))
            gain, bias = float(mj.actuator_gainprm[k, 0]), mj.actuator_biasprm[k]
            if mj.actuator_forcelimited[k]:
                efforts.append(gear * float(np.abs(mj.actuator_forcerange[k]).max()))
            if _is(mj.actuator_biastype[k], self._mujoco.mjtBias.mjBIAS_AFFINE) and bias[1] < 0.0:
                stiffness, damping = stiffness - gear**2 * float(bias[1]), damping - gear**2 * float(bias[2])
            elif mj.actuator_ctrllimited[k] and gain:
                efforts.append(gear * abs(gain) * float(np.abs(mj.actuator_ctrlrange[k]).max()))
        limit = {"effort": repr(min(efforts))} if efforts and min(efforts) > 0.0 else {}
        if limited:
            limit |= {key: repr(float(end)) for key, end in zip(("lower", "upper"), mj.jnt_range[joint], strict=True)}
        ElementTree.SubElement(element, "limit", limit)
        armature, friction = float(mj.dof_armature[dof]), float(np.atleast_1d(mj.dof_frictionloss[dof])[0])
        self.drives[name] = MjcfDrive(stiffness, damping, armature, friction)

    def _add_joint(self, name: str, kind: str, parent: str, child: str, pose: DQ) -> ElementTree.Element:
        element = ElementTree.SubElement(self._robot, "joint", {"name": name, "type": kind})
        ElementTree.SubElement(element, "parent", {"link": parent})
        ElementTree.SubElement(element, "child", {"link": child})
        _add_origin(element, pose)
        return element

    def _add_link(self, name: str, body: int) -> None:
        """Add a link with the mass and the shapes of a body."""
        mj, offset = self._mj, self._offset[body]
        link = ElementTree.SubElement(self._robot, "link", {"name": name})
        mass = float(mj.body_mass[body])
        if mass > 0.0:
            part = ElementTree.SubElement(link, "inertial")
            _add_origin(part, DQ.from_pose(mj.body_ipos[body] - offset))
            ElementTree.SubElement(part, "mass", {"value": repr(mass)})
            R = DQ.from_pose(np.zeros(3), mj.body_iquat[body]).rotation_matrix()
            inertia = R @ np.diag(mj.body_inertia[body]) @ R.T
            keys = {f"i{a}{b}": (i, k) for i, a in enumerate("xyz") for k, b in enumerate("xyz") if i <= k}
            ElementTree.SubElement(part, "inertia", {key: repr(float(inertia[at])) for key, at in keys.items()})
        for geom in range(mj.body_geomadr[body], mj.body_geomadr[body] + mj.body_geomnum[body]):
            touches = mj.geom_contype[geom] or mj.geom_conaffinity[geom]
            self._add_geom(link, "collision" if touches else "visual", geom, offset)

    def _add_geom(self, link: ElementTree.Element, which: str, geom: int, offset: Array) -> None:
        mj, types = self._mj, self._mujoco.mjtGeom
        kind, (a, b, c) = mj.geom_type[geom], (2.0 * mj.geom_size[geom]).tolist()
        pose = DQ.from_pose(mj.geom_pos[geom] - offset, mj.geom_quat[geom])
        if _is(kind, types.mjGEOM_BOX):
            shape = ("box", {"size": _words((a, b, c))})
        elif _is(kind, types.mjGEOM_SPHERE):
            shape = ("sphere", {"radius": repr(0.5 * a)})
        elif _is(kind, types.mjGEOM_CYLINDER, types.mjGEOM_CAPSULE):
            name = "cylinder" if _is(kind, types.mjGEOM_CYLINDER) else "capsule"
            shape = (name, {"radius": repr(0.5 * a), "length": repr(b)})
        elif _is(kind, types.mjGEOM_MESH) and (found := self._mesh(int(mj.geom_dataid[geom]))) is not None:
            shape, at = found
            pose = pose * at.conj()
        else:
            self.repairs.append(f"a shape of '{link.get('name')}' is left out: a URDF has none of its kind")
            return
        element = ElementTree.SubElement(link, which)
        _add_origin(element, pose)
        ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), *shape)

    def _mesh(self, mesh: int) -> tuple[tuple[str, dict[str, str]], DQ] | None:
        """Return a mesh as element and attributes, and the pose in the file of the frame that MuJoCo gave it."""
        given = next((m for m in self._spec.meshes if m.id == mesh), None)
        if given is None or not (given.file or given.name in self._lost):
            return None
        file = str(self._lost[given.name]) if given.name in self._lost else pathlib.Path(given.file).as_uri()
        at = DQ.from_pose(self._mj.mesh_pos[mesh], self._mj.mesh_quat[mesh])
        return ("mesh", {"filename": file, "scale": _words(given.scale)}), at

    def _add_led(self) -> None:
        """Add the joints that follow others as mimic joints."""
        mj = self._mj
        known = {element.get("name"): element for element in self._robot.iter("joint")}
        for k in range(mj.neq):
            if not _is(mj.eq_type[k], self._mujoco.mjtEq.mjEQ_JOINT) or not mj.eq_active0[k] or mj.eq_obj2id[k] < 0:
                continue
            led, leader = (self._joint_name(int(j)) for j in (mj.eq_obj1id[k], mj.eq_obj2id[k]))
            if led in known and leader in known:
                numbers = {"multiplier": repr(float(mj.eq_data[k, 1])), "offset": repr(float(mj.eq_data[k, 0]))}
                ElementTree.SubElement(known[led], "mimic", {"joint": leader, **numbers})


def _is(value: Any, *kinds: Any) -> bool:
    """Return whether a number of a compiled model is one of some enumerators of MuJoCo."""
    return int(value) in {int(kind) for kind in kinds}


def _add_origin(element: ElementTree.Element, pose: DQ) -> None:
    xyz, rpy = (_words(v) for v in (pose.translation(), pose.roll_pitch_yaw()))
    ElementTree.SubElement(element, "origin", {"xyz": xyz, "rpy": rpy})


def _words(numbers: Any) -> str:
    return " ".join(repr(float(x) if math.isfinite(float(x)) else 0.0) for x in numbers)
