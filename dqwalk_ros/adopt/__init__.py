"""Makes a configuration that walks from another robot's URDF.

`adopt` reads a robot description, identifies legs, soles, arms and sensors, derives the parameters of the walk, and
writes the files; `trial` walks with them. Each value from `anatomy`, `posture` and `parameters` is reported with its
source and a confidence.
"""

from __future__ import annotations

import json
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dqwalk_ros.adopt.anatomy import Anatomy, distances, find_anatomy
from dqwalk_ros.adopt.check import check
from dqwalk_ros.adopt.doubts import (
    assume_masses,
    check_names,
    list_massless,
    repair_degrees,
    repair_inertias,
    use_led_joints,
)
from dqwalk_ros.adopt.mjcf import MjcfDrive, is_mjcf, load_mjcf
from dqwalk_ros.adopt.parameters import (
    ASSUMED,
    HEAVY_LEGS,
    LEAST,
    LONGEST,
    Numbers,
    assumed,
    com_threshold,
    drive_parameters,
    dynamic_parameters,
    paper_parameters,
    parameters,
    robot_entries,
    servo_types,
    whole_body_parameters,
)
from dqwalk_ros.adopt.posture import at_limits, over_one_foot, stand, why_not
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.config import Config, RobotConfig, load
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel, load_model, parse_model
from dqwalk_ros.robot.servos import load_types
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.standing_limits import Finding
from dqwalk_ros.robot.urdf import Urdf, moves, zero_pose
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ModelError, OutputError, missing, printable
from dqwalk_ros.support.output import refuse_existing, write_text
from dqwalk_ros.support.text_table import aligned

__all__ = ["FILES", "Adoption", "adopt", "changed", "table", "write_dynamic", "write_yaml"]

FILES = (
    "robot.urdf", "robot.yaml", "dynamic.yaml", "climb.yaml", "paper.yaml", "whole_body.yaml", "robot.png", "adopt.json"
)  # fmt: skip
"""Names of the files that `adopt`, `picture.draw` and `trial.climb` write."""
_CROUCH = 0.91
"""Distance of hip and ankle as a fraction of the straight leg, for the longer steps of the whole-body controller."""
_ALIGNED = 1e-6
"""Largest angle between the axes of the pelvis or the root and those of the robot that counts as none [rad]."""
_OVER = 0.1
"""Largest distance of the CoM from the middle of a sole that it can reach, as a part of that at which phases end."""
_LONG = 0.66
"""Least length of a step, as a fraction of the usual one, for which the soles are not placed closer."""
_DENSE = 25.0, 1000.0
"""Least and largest mass divided by the cube of the height of the CoM [kg/m^3] that are not doubted; 135 robots have 38
to 850."""
_HEAVY_FOOT = 0.1
"""Part of the robot's mass above which that of a foot is doubtful."""
_HIGH = 0.4, 1.6
"""Least and largest height of the origin of pelvis and root above the soles, as fractions of that of the hips."""


@dataclass(frozen=True)
class Adoption:
    """An adopted robot: its files, its parts and the parameters of its walk.

    Attributes
    ----------
    folder : Path
        Folder with ``robot.urdf``, ``robot.yaml``, ``dynamic.yaml``, ``paper.yaml``, ``whole_body.yaml`` (if the pelvis
        can move sideways over flat soles, and the robot has arms) and ``adopt.json``.
    config : Config
        The configuration of ``robot.yaml``.
    model : RobotModel
        The model of the repaired robot.
    anatomy : Anatomy
        Legs, soles, arms and sensors.
    numbers : Numbers
        The initial posture, and quantities from which the parameters were derived.
    entries : tuple of Entry
        All parameters in ``robot.yaml``.
    evidence : tuple of Entry
        Values found in the robot description, with their sources.
    repairs : tuple of str
        Repairs of the robot description.
    findings : tuple of Finding
        Why no standing walk is possible, and problems that `check` found.
    """

    folder: pathlib.Path
    config: Config
    model: RobotModel
    anatomy: Anatomy
    numbers: Numbers
    entries: tuple[Entry, ...]
    evidence: tuple[Entry, ...]
    repairs: tuple[str, ...]
    findings: tuple[Finding, ...]


def adopt(
    path: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    package_paths: Sequence[str | os.PathLike[str]] = (),
    xacro: Mapping[str, str] | None = None,
    left: str = "",
    right: str = "",
    forward: str = "",
    servos: Sequence[str] = (),
    changes: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Callable[[float, str], None] = lambda *_: None,
) -> Adoption:
    """Read a robot description, derive the parameters of a walk and write the files, without walking.

    Parameters
    ----------
    path : path
        URDF, xacro or MJCF; it is not changed.
    folder : path
        Folder of the results; created if it does not exist.
    package_paths : sequence of path
        Further folders to search for ROS packages, besides the installed packages and the folders above the file.
    xacro : dict of str to str, optional
        Values of the arguments of a xacro file.
    left, right : str
        Links of the feet; empty to find them.
    forward : str
        Forward axis of the root link, ``+x``, ``-x``, ``+y`` or ``-y``; empty to find it.
    servos : sequence of str
        Types of servos, NAME=TYPE, of the joints whose name is or contains NAME; those of the others are derived.
    changes : dict of str to value, optional
        Parameters that replace the derived ones.
    overwrite : bool
        Replace files that exist in `folder`, but not the robot description itself.
    progress : callable, optional
        Called with the fraction done and the name of the next stage.

    Raises
    ------
    ModelError
        If the robot description cannot be read, or the robot cannot walk with this package; no file is written. Repairs
        that were made before are the notes of the exception (``__notes__``).
    ConfigError
        If a value of `changes` or an entry of `servos` is invalid; no file is written.
    OutputError
        If a file of `FILES` exists in `folder` and is not to be replaced; no file is written.
    """
    path, folder = pathlib.Path(path), pathlib.Path(folder)
    _check_places(path, folder, overwrite=overwrite)
    progress(0.0, "reading the robot")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ModelError(missing("robot file", path))
    urdf, drives = load_mjcf(path, package_paths) if is_mjcf(path) else (Urdf.load(path, package_paths, xacro), {})
    shapes = Shapes(urdf, path, tuple(map(pathlib.Path, package_paths)))
    sides = {"left": left, "right": right, "forward": forward}
    try:
        return _adopted(path, folder, urdf, shapes, drives, sides, servos, changes or {}, overwrite, progress)
    except ModelError as error:
        for repair in dict.fromkeys(urdf.repairs):
            error.add_note(repair)
        raise


def _adopted(
    path: pathlib.Path,
    folder: pathlib.Path,
    urdf: Urdf,
    shapes: Shapes,
    drives: Mapping[str, MjcfDrive],
    sides: Mapping[str, str],
    servos: Sequence[str],
    changes: Mapping[str, Any],
    overwrite: bool,
    progress: Callable[[float, str], None],
) -> Adoption:
    """Adopt a robot description that was read; see `adopt`."""
    check_names(urdf)
    repair_degrees(urdf)
    use_led_joints(urdf)
    guessed = assume_masses(urdf, shapes)
    anatomy = find_anatomy(urdf, shapes, **sides)
    list_massless(urdf)
    repair_inertias(urdf, shapes, anatomy.leg)
    anatomy = replace(anatomy, pelvis=_add_frames(urdf, anatomy))
    soles = _add_soles(urdf, anatomy)
    shapes.name_files()
    robot = _robot(folder, urdf, anatomy, soles, changes)
    text = urdf.text()
    progress(0.3, "finding its postures")
    numbers = _numbers(parse_model(text, robot), anatomy)
    anatomy = numbers.anatomy
    if numbers.weak:
        _strengthen(urdf, numbers.weak)
        text = urdf.text()
        numbers = replace(numbers, model=parse_model(text, robot))
    about = robot_entries(numbers.model, anatomy, robot.lock, "those that walk")
    own, driven = drive_parameters(drives, numbers)
    entries = _entries([*about, *parameters(numbers)], numbers.model, own, servos, changes)
    whole_body = []
    if anatomy.sideways and len(anatomy.hands) == len(Foot):
        whole_body = _whole_body(urdf, text, robot, numbers)

    write_text(folder / "robot.urdf", text, overwrite=overwrite)
    write_dynamic(folder, numbers, entries, changes, overwrite=overwrite)
    about_it = f"{urdf.name}, adopted from {path.name}"
    write_yaml(folder / "robot.yaml", entries, f"{about_it}: the standing walk.", overwrite=overwrite)
    paper = [*about, *paper_parameters(numbers)]
    write_yaml(folder / "paper.yaml", paper, f"{about_it}: the walk of Urban & Adorno.", overwrite=overwrite)
    if whole_body:
        write_yaml(folder / "whole_body.yaml", whole_body, f"{about_it}: Sherikov et al.", overwrite=overwrite)
    for file in ("climb.yaml", *(() if whole_body else ("whole_body.yaml",))):
        (folder / file).unlink(missing_ok=True)  # of a robot that was adopted here before
    config = load(folder / "robot.yaml")
    model = load_model(config.robot)
    evidence = (
        *anatomy.evidence,
        *_mass_evidence(numbers, "guess" if guessed else "sure"),
        *driven,
        *_missing_evidence(shapes),
    )
    found = Adoption(
        folder, config, model, anatomy, numbers, tuple(entries), evidence,
        tuple(dict.fromkeys((*urdf.repairs, *model.repairs))),
        (*([Finding(numbers.hindrance, "")] if numbers.hindrance else []), *check(config, model)),
    )  # fmt: skip
    write_text(folder / "adopt.json", json.dumps(_json(found, path), indent=1) + "\n", overwrite=overwrite)
    return found


def _robot(
    folder: pathlib.Path, urdf: Urdf, anatomy: Anatomy, soles: Mapping[Foot, str], changes: Mapping[str, Any]
) -> RobotConfig:
    """Return the section ``robot`` of a description with the frames `soles`, and with those of `changes` in it.

    Raises
    ------
    ConfigError
        If one of these is invalid.
    """
    sole = anatomy.soles[Foot.LEFT]
    free = {joint for leg in anatomy.legs.values() for joint in leg}
    if not anatomy.sideways:
        free |= set(anatomy.waist)  # where the pelvis cannot move sideways, the trunk moves the CoM over a sole
    found = RobotConfig(
        urdf=str(folder / "robot.urdf"),
        pelvis=anatomy.pelvis,
        left_sole=soles[Foot.LEFT],
        right_sole=soles[Foot.RIGHT],
        imu=anatomy.imu,
        lock=_lock(urdf, free),
        sole_length=float(f"{sole.length:.4g}"),
        sole_width=float(f"{sole.width:.4g}"),
    )
    given = {key: value for key, value in changes.items() if key.startswith("robot.")}
    return replace(Config(), robot=found).updated(given).robot


def _strengthen(urdf: Urdf, weak: Mapping[str, float]) -> None:
    """Replace the effort limits of `weak` joints by those given [N m]."""
    for name, effort in weak.items():
        limit = urdf.joints[name].limit
        urdf.repairs.append(
            f"joint '{name}' has an effort limit of {limit.effort:.3g} N m, too little for it or for others "
            "of the legs with the same limit to stand on one foot, to move the pressure under it, or to swing the "
            f"other leg: {effort:.3g} N m is assumed, which the servo must have"
        )
        limit.effort = effort


def _entries(
    derived: Sequence[Entry],
    model: RobotModel,
    drives: Mapping[str, float],
    servos: Sequence[str],
    changes: Mapping[str, Any],
) -> list[Entry]:
    """Return the parameters of the standing walk: the `derived` ones, changed by file, servos and user in this order.

    Raises
    ------
    ConfigError
        If a value is invalid.
    """
    entries = changed(derived, drives, "joints and actuators of the MJCF file")
    if servos:
        kinds = servo_types(servos, model.joint_names, load_types(Config().servo.table))
        entries = changed(
            entries, {"servo.types": kinds}, "given by --servo; for these joints from the table of servos"
        )
    entries = changed(entries, changes, "given by --set")
    given = {entry.what: entry.value for entry in entries}
    if "servo.assumed" not in given and "servo.types" not in given:
        reason = f"{ASSUMED:g} of servo.damping: with less stiff legs tremble, with all of it commands alternate"
        entries.append(Entry("servo.assumed", list(assumed(given["servo.damping"])), reason, "guess"))
    Config().updated({entry.what: entry.value for entry in entries})  # no file is written of invalid values
    return entries


def _numbers(model: RobotModel, anatomy: Anatomy) -> Numbers:
    """Return the quantities of the walk.

    Where joints are at their limits with the soles as far apart as in the zero posture, the soles are closer: so close
    that the CoM reaches the middle of one sole, and the legs make steps of two thirds of the usual length, or else the
    longest; where the CoM reaches it at no distance, it is that at which it comes nearest. They are wider where the
    robot walks at none of these distances, as with hips whose range excludes the zero posture.

    Raises
    ------
    ModelError
        If the robot cannot stand on both feet.
    """
    problem, possible = None, list[tuple[bool, bool, float, Numbers]]()
    usual, *others = distances(anatomy)
    for apart in (usual, *others):
        if apart > usual and any(stands for stands, *_ in possible):
            break
        why = f"{'wider' if apart > usual else 'closer'} than in the zero posture, where joints are at their limits"
        more = (Entry("distance of the soles", f"{1e3 * apart:.0f} mm", why, "likely"),) if apart != usual else ()
        tried = replace(anatomy, apart=apart, evidence=(*anatomy.evidence, *more))
        try:
            numbers, deviation = _standing(model, tried)
        except ModelError as error:
            problem = problem or error
            continue
        over = deviation < _OVER * com_threshold(anatomy.leg)
        if over and numbers.step > _LONG * LONGEST * anatomy.leg:
            return numbers
        possible.append((not numbers.hindrance, over, numbers.step if over else -deviation, numbers))
    if possible:
        return max(possible, key=lambda one: one[:3])[3]
    assert problem is not None
    raise problem


def _standing(model: RobotModel, anatomy: Anatomy) -> tuple[Numbers, float]:
    """Return the quantities of the walk, and how near the CoM comes to the middle of a sole [m]; see `_numbers`."""
    standing = stand(model, anatomy)
    worst = max((over_one_foot(model, anatomy, standing, foot) for foot in Foot), key=lambda one: one.error)
    deviation, most = worst.error, com_threshold(anatomy.leg)
    if deviation > most:  # a walk itself keeps no distance from the limits
        free = replace(standing, margin=0.0)
        worst = max((over_one_foot(model, anatomy, free, foot) for foot in Foot), key=lambda one: one.error)
    numbers = Numbers.of(model, anatomy, standing)
    hindrance = ""
    if worst.error > most:
        hindrance = (
            f"the CoM of this robot cannot be placed over one sole with both feet flat: the least distance from its "
            f"middle is {1e3 * worst.error:.1f} mm, and a standing walk lifts the other foot at {1e3 * most:.1f} mm"
            f"{why_not(model, anatomy, worst)}"
        )
    elif numbers.reach < LEAST * anatomy.leg:
        hindrance = (
            f"with the CoM over one sole the legs reach steps of {1e3 * max(0.0, numbers.reach):.1f} mm only: "
            f"{', '.join(numbers.stuck) or 'none of their joints'} at the limit"
        )
    return replace(numbers, hindrance=hindrance), deviation


def _check_places(path: pathlib.Path, folder: pathlib.Path, *, overwrite: bool) -> None:
    """Raise OutputError if a file of `FILES` may not be written to a folder."""
    source = {path.resolve(), path.parent.resolve() / path.name}
    if mine := source & {folder.resolve() / name for name in FILES}:
        raise OutputError(f"'{min(mine)}' is the robot description itself; choose another folder with --out")
    if not overwrite:
        refuse_existing(folder / name for name in FILES)


def table(found: Adoption) -> str:
    """Return the results as a text table: quantity, value, confidence and source."""
    rows = [("quantity", "value", "confidence", "source")]
    rows += [(e.what, e.value, e.confidence, e.source) for e in found.evidence]
    rows += [
        (e.what, _yaml_value(e.value), e.confidence, e.source)
        for e in found.entries
        if not e.what.startswith("robot.") or e.confidence != "sure"
    ]

    def cut(text: str, most: int) -> str:
        return text if len(text) <= most else text[: most - 3] + "..."

    return aligned([(cut(what, 48), cut(value, 64), confidence, source) for what, value, confidence, source in rows])


def write_yaml(path: pathlib.Path, entries: Sequence[Entry], title: str, *, overwrite: bool) -> None:
    """Write parameters as a ROS parameter file, with the reason for each value in a comment beside it."""
    lines = [f"# {printable(title)} `dqwalk config` explains each key.", "/**:", "  ros__parameters:"]
    sections: dict[str, list[Entry]] = {}
    for entry in entries:
        sections.setdefault(entry.what.rpartition(".")[0], []).append(entry)
    for section, members in sections.items():
        indent = "    "
        if section:
            lines.append(f"    {section}:")
            indent = "      "
        for entry in members:
            text = f"{indent}{entry.what.rpartition('.')[2]}: {_yaml_value(entry.value)}"
            note = entry.source + ("" if entry.confidence == "sure" else f" ({entry.confidence})")
            lines.append(f"{text:<44}  # {printable(note)}")
    write_text(path, "\n".join(lines) + "\n", overwrite=overwrite)


def _yaml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_quoted, value)) + "]"
    if isinstance(value, str):
        plain = value.replace("_", "").replace(".", "").isalnum() and strict_yaml.read(value) == value
        return value if plain else _quoted(value)
    return repr(value)


def _quoted(value: Any) -> str:
    """Return a string or number in YAML, whatever characters a name of the robot has."""
    return json.dumps(value, ensure_ascii=False) if printable(str(value)) == str(value) else json.dumps(value)


def changed(entries: Sequence[Entry], changes: Mapping[str, Any], reason: str) -> list[Entry]:
    """Return the entries with the values of `changes`, which may add keys, and with `reason` for these."""
    known = {entry.what for entry in entries}
    kept = [Entry(e.what, changes[e.what], reason) if e.what in changes else e for e in entries]
    return kept + [Entry(key, value, reason) for key, value in changes.items() if key not in known]


def write_dynamic(
    folder: pathlib.Path,
    numbers: Numbers,
    entries: Sequence[Entry],
    given: Mapping[str, Any],
    cured: Mapping[str, Any] | None = None,
    *,
    overwrite: bool,
) -> None:
    """Write ``dynamic.yaml``, the configuration of the dynamic walk, from the `entries` of the standing walk.

    Of the parameters `given` by the user, those of the standing walk's own steps and durations are not used; those of
    `cured` were changed after a dynamic walk.
    """
    damping, stiffness = (
        next(entry.value for entry in entries if entry.what == what) for what in ("servo.damping", "servo.stiffness")
    )
    new = {entry.what: entry for entry in dynamic_parameters(numbers, damping, stiffness)}
    common = ("dynamic.", "servo.", "qp.")
    only = "gait.recover"  # of the standing walk
    own = {k: v for k, v in given.items() if (k not in new or k.startswith(common)) and k != only}
    merged = [new.pop(entry.what, entry) for entry in entries if entry.what != only] + list(new.values())
    title = f"{numbers.model.name}: the dynamic walk (docs/dynamic.md)."
    merged = changed(changed(merged, own, "given by --set"), cured or {}, "changed after a walk that was not OK")
    write_yaml(folder / "dynamic.yaml", merged, title, overwrite=overwrite)


def _add_frames(urdf: Urdf, anatomy: Anatomy) -> str:
    """Add a root link, and a pelvis between the hips with x forward and z up, to a description that lacks them.

    The name of the pelvis is returned. Where a description has the origins and the axes of these links is arbitrary;
    heights and directions are not.
    """
    hips = anatomy.hips

    def serves(x: DQ) -> bool:
        """Return whether a pose in the root link has the axes of the robot and is not far from the hips."""
        off = hips.conj() * x
        high = anatomy.leg + float(off.translation()[2])
        upright = float(np.linalg.norm(off.rotation_vector())) < _ALIGNED
        return upright and _HIGH[0] * anatomy.leg < high < _HIGH[1] * anatomy.leg

    pelvis, old, others = anatomy.pelvis, urdf.root, dict(urdf.joints)
    if not serves(zero_pose(urdf, pelvis)):
        pelvis = "dqwalk_pelvis"
        urdf.add_frame(pelvis, anatomy.pelvis, zero_pose(urdf, anatomy.pelvis).conj() * hips)
        others = dict(urdf.joints)
    if not serves(DQ(1.0)):
        urdf.joints.clear()
        urdf.add_frame("dqwalk_root", old, hips.conj())
        (joint,) = urdf.joints.values()
        joint.parent, joint.child = "dqwalk_root", old
        urdf.joints.update(others)
    return pelvis


def _add_soles(urdf: Urdf, anatomy: Anatomy) -> dict[Foot, str]:
    names = {foot: f"dqwalk_{foot.value}_sole" for foot in Foot}
    for foot, sole in anatomy.soles.items():
        urdf.add_frame(names[foot], sole.link, sole.pose)
    return names


def _whole_body(urdf: Urdf, text: str, robot: RobotConfig, numbers: Numbers) -> list[Entry]:
    """Return the parameters of the whole-body controller, which also moves the waist and the arms."""
    anatomy = numbers.anatomy
    limbs = (*anatomy.legs.values(), anatomy.waist, *anatomy.arms.values())
    lock = _lock(urdf, {joint for limb in limbs for joint in limb})
    model = parse_model(text, replace(robot, lock=lock))
    standing = stand(model, anatomy, _CROUCH)
    about = robot_entries(model, anatomy, lock, "legs, waist and arms")
    return [*about, *whole_body_parameters(model, standing, numbers)]


def _lock(urdf: Urdf, free: set[str]) -> tuple[str, ...]:
    """Return the joints that are not free, with an angle [rad] where zero is outside their limits."""
    locked = [joint for joint in urdf.joints.values() if moves(joint) and joint.name not in free and not joint.mimic]
    angles = {joint.name: min(max(0.0, joint.limit.lower), joint.limit.upper) for joint in locked}
    return tuple(name if not angle else f"{name}={angle:.6g}" for name, angle in angles.items())


def _mass_evidence(n: Numbers, sure: str = "sure") -> list[Entry]:
    """Return what follows from the masses, which are as `sure` as these."""
    ahead, model = 1e3 * n.standing.com[0], n.model
    foot = max(model.bodies[model.frames[sole.frame].body].mass for sole in model.soles.values())
    part = foot / model.mass
    heavy = Entry("mass of a foot", f"{foot:.3g} kg, {100 * part:.0f} % of the robot", "2 to 6 % are usual", "guess")
    stuck = ", ".join([] if n.standing.margin else at_limits(model, n.standing))
    limits = Entry("at a limit in the posture", stuck, "there is no posture without", "guess")
    density = model.mass / n.height**3
    usual = _DENSE[0] < density < _DENSE[1]
    doubt = "sum of the links; 50 to 300 kg/m^3 times the cube of the CoM's height are usual: weigh the robot"
    light = "40 to 60 % are usual: the dynamic walk takes legs for light"
    legs = Entry("mass of the legs", f"{100 * n.legs:.0f} % of the robot", light, "guess")
    return [
        *([heavy] if part > _HEAVY_FOOT else []),
        *([legs] if n.legs > HEAVY_LEGS else []),
        *([limits] if stuck else []),
        Entry("mass", f"{model.mass:.4g} kg", "sum of the links" if usual else doubt, sure if usual else "guess"),
        Entry("CoM in the posture", f"{ahead:.1f} mm forward, {n.height:.3f} m up", "posture", sure),
        Entry("m g h", f"{n.mgh:.4g} N m/rad", "mass and height of the CoM", sure),
        Entry("inertia of a leg", f"{n.inertia:.3g} kg m^2", "its bodies as point masses, about the hip", sure),
        Entry("torque on one foot", f"{n.torque:.2f} of the effort limit", f"{n.joint}, statics", "likely"),
    ]


def _missing_evidence(shapes: Shapes) -> list[Entry]:
    lost = [f"'{mesh}' {why}" for mesh, why in shapes.missing.items()]
    return [Entry("meshes not read", f"{len(lost)}: {lost[0]}", "no foot needs them", "likely")] if lost else []


def _json(found: Adoption, path: pathlib.Path) -> dict[str, Any]:
    def rows(entries: Sequence[Entry], *names: str) -> list[dict[str, Any]]:
        return [dict(zip(names, vars(entry).values(), strict=True)) for entry in entries]

    return {
        "from": str(path),
        "robot": found.model.name,
        "evidence": rows(found.evidence, "what", "value", "source", "confidence"),
        "parameters": rows(found.entries, "key", "value", "reason", "confidence"),
        "repairs": list(found.repairs),
        "findings": [vars(f) for f in found.findings],
    }
