"""Another robot's URDF -> a configuration that walks.

`adopt` reads a robot description, infers what is what, derives every number of the walk, writes the files, and tries
the walk. What `anatomy`, `posture` and `parameters` found is told with its source and how sure it is.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqwalk_ros.adopt.anatomy import Anatomy, find_anatomy
from dqwalk_ros.adopt.check import Finding, check
from dqwalk_ros.adopt.parameters import (
    Entry,
    Numbers,
    measure,
    paper_parameters,
    parameters,
    robot_entries,
    whole_body_parameters,
)
from dqwalk_ros.adopt.posture import Standing, over_one_foot, stand
from dqwalk_ros.adopt.skeleton import Evidence, Skeleton
from dqwalk_ros.config import Config, RobotConfig, load
from dqwalk_ros.errors import ModelError
from dqwalk_ros.robot import Foot, RobotModel, load_model
from dqwalk_ros.shapes import Shapes
from dqwalk_ros.urdf import Origin, Urdf

__all__ = ["Adoption", "Finding", "adopt", "changed", "check", "table", "write_yaml"]

_CROUCH = 0.91
"""Distance of hip and ankle as a part of the straight leg, for the whole-body controller: room for long steps."""
_CLEARANCE = 0.02
"""The soles stand at least this far apart, as a part of a leg."""


@dataclass(frozen=True)
class Adoption:
    """An adopted robot: its files, and what was found.

    Attributes
    ----------
    folder : Path
        With ``robot.urdf``, ``robot.yaml``, ``paper.yaml``, ``whole_body.yaml`` (where the ankles roll and there are
        arms) and ``adopt.json``.
    config : Config
        Of ``robot.yaml``.
    model : RobotModel
    anatomy : Anatomy
    standing : Standing
    numbers : Numbers
    entries : tuple of Entry
        Everything in ``robot.yaml``.
    evidence : tuple of Evidence
    repairs : tuple of str
    findings : tuple of Finding
        Of `check`.
    """

    folder: pathlib.Path
    config: Config
    model: RobotModel
    anatomy: Anatomy
    standing: Standing
    numbers: Numbers
    entries: tuple[Entry, ...]
    evidence: tuple[Evidence, ...]
    repairs: tuple[str, ...]
    findings: tuple[Finding, ...]


def adopt(
    path: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    package_paths: Sequence[str | os.PathLike[str]] = (),
    left: str = "",
    right: str = "",
    forward: str = "",
    changes: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Adoption:
    """Read a robot, derive a walk for it and write the files; nothing walks yet.

    Parameters
    ----------
    path : path
        URDF or xacro; it is not changed.
    folder : path
        Of the results; it is made.
    package_paths : sequence of path
        Folders in which ROS packages are looked for, besides the installed ones and those around the file.
    left, right : str
        Links of the feet, where they must be named.
    forward : str
        ``+x``, ``-x``, ``+y`` or ``-y`` of the root link, where it must be told.
    changes : dict of str to value, optional
        Parameters that are given rather than derived.
    say : callable, optional
        Called with a line of text where something takes its time.

    Raises
    ------
    ModelError
        If this robot cannot walk with this package, in one sentence.
    """
    path, folder = pathlib.Path(path), pathlib.Path(folder)
    say("reading")
    urdf = Urdf.load(path)
    shapes = Shapes(urdf, path, tuple(map(pathlib.Path, package_paths)))
    say("looking for legs, soles and arms")
    anatomy = find_anatomy(urdf, shapes, left=left, right=right, forward=forward)
    _turn_root(urdf, anatomy)
    soles = _add_soles(urdf, anatomy)
    _find_meshes(urdf, shapes)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf.text(), encoding="utf-8")

    say("looking for a posture")
    sole = anatomy.soles[Foot.LEFT]
    free = {joint for leg in anatomy.legs.values() for joint in leg}
    if "R" not in anatomy.kinds[-2:]:
        free |= set(anatomy.waist)  # without ankles that roll the trunk must bring the CoM over a sole
    locked = _locked(urdf, free)
    robot = RobotConfig(
        urdf=str(folder / "robot.urdf"),
        pelvis=anatomy.pelvis,
        left_sole=soles[Foot.LEFT],
        right_sole=soles[Foot.RIGHT],
        imu=anatomy.imu,
        lock=_lock_entries(locked),
        sole_length=float(f"{sole.length:.4g}"),
        sole_width=float(f"{sole.width:.4g}"),
    )
    model = load_model(robot)
    width = _apart(urdf, anatomy)
    standing = stand(model, anatomy, width)
    single = [over_one_foot(model, anatomy, standing, foot) for foot in Foot]
    off = max(error for _, error in single)
    if off > 0.25 * sole.width + 0.005:
        raise ModelError(
            f"the CoM of this robot cannot be brought over one sole with both feet flat: it stays "
            f"{1e3 * off:.0f} mm away from the middle"
        )
    step = math.floor(0.09 * anatomy.leg * 1e3 + 1e-6) / 1e3
    numbers = measure(model, anatomy, standing, [q for q, _ in single], step)
    about = robot_entries(model, anatomy, locked, soles, "what walks")
    entries = [*about, *parameters(model, anatomy, numbers, standing)]
    entries = changed(entries, changes or {}, "given by --set")
    write_yaml(folder / "robot.yaml", entries, f"{urdf.name}, adopted from {path.name}: the walk that stands.")
    paper = [*about, *paper_parameters(numbers, standing, anatomy)]
    write_yaml(folder / "paper.yaml", paper, f"{urdf.name}, adopted from {path.name}: the walk of Urban & Adorno.")
    if "R" in anatomy.kinds[-2:] and len(anatomy.hands) == len(Foot):
        _write_whole_body(folder, urdf, anatomy, robot, numbers, path.name)
    config = load(folder / "robot.yaml")
    model = load_model(config.robot)
    evidence = (*anatomy.evidence, *_measured(numbers, standing))
    found = Adoption(
        folder, config, model, anatomy, standing, numbers, tuple(entries), evidence,
        tuple(dict.fromkeys((*urdf.repairs, *model.repairs))), tuple(check(config, model)),
    )  # fmt: skip
    (folder / "adopt.json").write_text(json.dumps(_json(found, path), indent=1) + "\n", encoding="utf-8")
    return found


def table(found: Adoption) -> str:
    """Return what was found as text: quantity, value, how sure, and where it is from."""
    rows = [("quantity", "value", "sure?", "from")]
    rows += [(e.what, e.value, e.confidence, e.source) for e in found.evidence]
    rows += [
        (e.key, _plain(e.value), e.confidence, e.reason)
        for e in found.entries
        if not e.key.startswith("robot.") or e.confidence != "sure"
    ]
    cut = [48, 64]
    widths = [min(max(len(row[k]) for row in rows), (cut[0], cut[1], 7)[k]) for k in range(3)]
    lines = []
    for row in rows:
        cells = [text if len(text) <= widths[k] else text[: widths[k] - 3] + "..." for k, text in enumerate(row[:3])]
        lines.append("  ".join(f"{text:<{widths[k]}}" for k, text in enumerate(cells)) + "  " + row[3])
    return "\n".join(lines)


def write_yaml(path: pathlib.Path, entries: Sequence[Entry], title: str) -> None:
    """Write parameters as a ROS parameter file, the reason of each in a comment beside it."""
    lines = [f"# {title} `dqwalk config` explains each key.", "/**:", "  ros__parameters:"]
    sections: dict[str, list[Entry]] = {}
    for entry in entries:
        sections.setdefault(entry.key.rpartition(".")[0], []).append(entry)
    for section, members in sections.items():
        indent = "    "
        if section:
            lines.append(f"    {section}:")
            indent = "      "
        for entry in members:
            text = f"{indent}{entry.key.rpartition('.')[2]}: {_plain(entry.value)}"
            note = entry.reason + ("" if entry.confidence == "sure" else f" ({entry.confidence})")
            lines.append(f"{text:<44}  # {note}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(json.dumps(item) for item in value) + "]"
    if isinstance(value, str):
        return value if value.replace("_", "").replace(".", "").isalnum() else json.dumps(value)
    return repr(value)


def changed(entries: Sequence[Entry], changes: Mapping[str, Any], reason: str) -> list[Entry]:
    """Return entries of which some have other values, for a reason."""
    known = {entry.key for entry in entries}
    kept = [Entry(e.key, changes[e.key], reason) if e.key in changes else e for e in entries]
    return kept + [Entry(key, value, reason) for key, value in changes.items() if key not in known]


def _turn_root(urdf: Urdf, anatomy: Anatomy) -> None:
    """Put a link before the root whose x is ahead and whose z is up, unless the root is such a link."""
    if np.allclose(anatomy.turn, np.eye(3), atol=1e-9):
        return
    old = urdf.root
    links, joints = dict(urdf.links), dict(urdf.joints)
    urdf.links.clear()
    urdf.joints.clear()
    pose = np.eye(4)
    pose[:3, :3] = anatomy.turn
    urdf.links.update(links)
    urdf.add_frame("dqwalk_root", old, Origin())
    joint = urdf.joints.pop("dqwalk_root_joint")
    urdf.joints["dqwalk_root_joint"] = type(joint)(joint.name, "fixed", "dqwalk_root", old, Origin.of(pose), joint.axis)
    urdf.joints.update(joints)


def _add_soles(urdf: Urdf, anatomy: Anatomy) -> dict[Foot, str]:
    names = {foot: f"dqwalk_{foot.value}_sole" for foot in Foot}
    for foot, sole in anatomy.soles.items():
        urdf.add_frame(names[foot], sole.link, Origin.of(sole.pose))
    return names


def _find_meshes(urdf: Urdf, shapes: Shapes) -> None:
    """Name meshes by their files, unless their package is installed, so that they are found from anywhere."""
    for link in list(urdf.links.values()):
        urdf.links[link.name] = shapes.named(link)


def _write_whole_body(
    folder: pathlib.Path, urdf: Urdf, anatomy: Anatomy, robot: RobotConfig, numbers: Numbers, source: str
) -> None:
    """Write the configuration of the whole-body controller, in which waist and arms move, too."""
    chain = Skeleton(urdf).chain
    arms = {foot: tuple(j for j in chain[hand] if j not in anatomy.waist) for foot, hand in anatomy.hands.items()}
    legs = {joint for leg in anatomy.legs.values() for joint in leg}
    locked = _locked(urdf, legs | set(anatomy.waist) | {joint for arm in arms.values() for joint in arm})
    model = load_model(dataclasses.replace(robot, lock=_lock_entries(locked)))
    standing = stand(model, anatomy, numbers.apart, bent=_CROUCH)
    names = {foot: model.soles[foot].frame for foot in Foot}
    about = robot_entries(model, anatomy, locked, names, "legs, waist and arms")
    entries = [*about, *whole_body_parameters(model, anatomy, numbers, standing, arms)]
    write_yaml(folder / "whole_body.yaml", entries, f"{urdf.name}, adopted from {source}: Sherikov et al.")


def _lock_entries(locked: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(name if not angle else f"{name}={angle:.6g}" for name, angle in locked.items())


def _locked(urdf: Urdf, free: set[str]) -> dict[str, float]:
    """Return every joint that is not free, and where it is held."""
    out = {}
    for joint in urdf.joints.values():
        if joint.moves and joint.name not in free and not joint.mimic:
            out[joint.name] = min(max(0.0, joint.lower), joint.upper)
    return out


def _apart(urdf: Urdf, anatomy: Anatomy) -> float:
    """Return the lateral distance of the soles: that of the zero posture, or what keeps them clear of each other."""
    skeleton = Skeleton(urdf)
    y = [float((skeleton.pose(sole.link) @ sole.pose)[1, 3]) for sole in anatomy.soles.values()]
    hips = [float(skeleton.place(leg[0])[1]) for leg in anatomy.legs.values()]
    apart, hip = abs(y[0] - y[1]), abs(hips[0] - hips[1])
    least = anatomy.soles[Foot.LEFT].width + 2.0 * _CLEARANCE * anatomy.leg
    return float(f"{max(least, min(apart, max(1.5 * hip, least))):.4g}")


def _measured(numbers: Numbers, standing: Standing) -> list[Evidence]:
    n = numbers
    return [
        Evidence("mass", f"{n.mass:.4g} kg", "sum of the links"),
        Evidence("CoM in the posture", f"{1e3 * standing.com[0]:.1f} mm ahead, {n.height:.3f} m up", "posture"),
        Evidence("m g h", f"{n.mgh:.4g} N m/rad", "mass and height of the CoM"),
        Evidence("inertia of a leg", f"{n.inertia:.3g} kg m^2", "its bodies taken for points, about the hip"),
        Evidence("torque on one foot", f"{n.torque:.2f} of the effort limit", f"{n.joint}, statics", "likely"),
    ]


def _json(found: Adoption, path: pathlib.Path) -> dict[str, Any]:
    return {
        "from": str(path),
        "robot": found.model.name,
        "evidence": [vars(e) for e in found.evidence],
        "parameters": [vars(e) for e in found.entries],
        "repairs": list(found.repairs),
        "findings": [vars(f) for f in found.findings],
    }
