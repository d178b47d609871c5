"""Adopts a robot: from its description to the files of its walks, without walking."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from dqwalk_ros.adopt.anatomy import Anatomy, find_anatomy
from dqwalk_ros.adopt.check import check
from dqwalk_ros.adopt.description import part_of
from dqwalk_ros.adopt.doubts import (
    assume_masses,
    check_names,
    list_massless,
    repair_degrees,
    repair_inertias,
    use_led_joints,
)
from dqwalk_ros.adopt.files import changed, check_places, write_dynamic, write_yaml, yaml_value
from dqwalk_ros.adopt.frames import add_body_frames, add_soles
from dqwalk_ros.adopt.mjcf import is_mjcf, load_mjcf
from dqwalk_ros.adopt.parameters import (
    ASSUMED,
    HEAVY_LEGS,
    Numbers,
    assumed,
    drive_parameters,
    paper_parameters,
    parameters,
    robot_entries,
    servo_types,
    whole_body_parameters,
)
from dqwalk_ros.adopt.posture import at_limits, stand
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.adopt.stance import find_stance
from dqwalk_ros.config import Config, RobotConfig, load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.robot.model import RobotModel, load_model, parse_model
from dqwalk_ros.robot.servos import load_types
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.standing_limits import Finding
from dqwalk_ros.robot.urdf import Urdf, moves
from dqwalk_ros.support.errors import ModelError
from dqwalk_ros.support.output import write_text
from dqwalk_ros.support.text_table import aligned
from dqwalk_ros.support.wording import missing

_CROUCH = 0.91
"""Distance of hip and ankle as a fraction of the straight leg, for the longer steps of the whole-body controller."""
_DENSE = 25.0, 1000.0
"""Least and largest mass divided by the cube of the height of the CoM [kg/m^3] that are not doubted; 135 robots have 38
to 850."""
_HEAVY_FOOT = 0.1
"""Part of the robot's mass above which that of a foot is doubtful."""


@dataclass(frozen=True)
class Adoption:
    """An adopted robot: its files, its parts and the parameters of its walk."""

    folder: pathlib.Path
    """Folder with ``robot.urdf``, ``robot.yaml``, ``dynamic.yaml``, ``paper.yaml``, ``whole_body.yaml`` (if the pelvis
    can move sideways over flat soles, and the robot has arms) and ``adopt.json``."""
    config: Config
    """The configuration of ``robot.yaml``."""
    model: RobotModel
    """The model of the repaired robot."""
    anatomy: Anatomy
    """Legs, soles, arms and sensors."""
    numbers: Numbers
    """The initial posture, and quantities from which the parameters were derived."""
    entries: tuple[Entry, ...]
    """All parameters in ``robot.yaml``."""
    evidence: tuple[Entry, ...]
    """Values found in the robot description, with their sources."""
    repairs: tuple[str, ...]
    """Repairs of the robot description."""
    findings: tuple[Finding, ...]
    """Why no standing walk is possible, and problems that `check` found."""

    def table(self) -> str:
        """Return the results as a text table: quantity, value, confidence and source."""
        rows = [("quantity", "value", "confidence", "source")]
        rows += [(e.what, e.value, e.confidence, e.source) for e in self.evidence]
        rows += [
            (e.what, yaml_value(e.value), e.confidence, e.source)
            for e in self.entries
            if not e.what.startswith("robot.") or e.confidence != "sure"
        ]

        def cut(text: str, most: int) -> str:
            return text if len(text) <= most else text[: most - 3] + "..."

        return aligned([(cut(what, 48), cut(value, 64), *rest) for what, value, *rest in rows])

    def text(self, source: pathlib.Path) -> str:
        """Return the results as JSON, with the file they come from."""

        def rows(entries: Sequence[Entry], *names: str) -> list[dict[str, Any]]:
            return [dict(zip(names, vars(entry).values(), strict=True)) for entry in entries]

        results = {
            "from": str(source),
            "robot": self.model.name,
            "evidence": rows(self.evidence, "what", "value", "source", "confidence"),
            "parameters": rows(self.entries, "key", "value", "reason", "confidence"),
            "repairs": list(self.repairs),
            "findings": [vars(f) for f in self.findings],
        }
        return json.dumps(results, indent=1) + "\n"


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
    check_places(path, folder, overwrite=overwrite)
    progress(0.0, "reading the robot")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ModelError(missing("robot file", path))
    try:
        urdf, drives = load_mjcf(path, package_paths) if is_mjcf(path) else (Urdf.load(path, package_paths, xacro), {})
    except ModelError as error:
        raise ModelError(f"{error}{part_of(path)}") from error
    shapes = Shapes(urdf, path, tuple(map(pathlib.Path, package_paths)))
    changes = changes or {}
    with _repairs_noted(urdf):
        check_names(urdf)
        repair_degrees(urdf)
        use_led_joints(urdf)
        guessed = assume_masses(urdf, shapes)
        anatomy = find_anatomy(urdf, shapes, left=left, right=right, forward=forward)
        list_massless(urdf)
        repair_inertias(urdf, shapes, anatomy.leg)
        anatomy = replace(anatomy, pelvis=add_body_frames(urdf, anatomy))
        robot = _robot(folder, urdf, anatomy, add_soles(urdf, anatomy), changes)
        shapes.name_files()
        progress(0.3, "finding its postures")
        numbers = find_stance(parse_model(urdf.text(), robot), anatomy)
        if numbers.weak:
            _strengthen(urdf, numbers.weak)
            numbers = replace(numbers, model=parse_model(urdf.text(), robot))
        about = robot_entries(numbers.model, numbers.anatomy, robot.lock, "those that walk")
        own, driven = drive_parameters(drives, numbers)
        entries = _entries([*about, *parameters(numbers)], numbers.model, own, servos, changes)
        files = {
            "robot.yaml": (entries, "the standing walk."),
            "paper.yaml": ([*about, *paper_parameters(numbers)], "the walk of Urban & Adorno."),
        }
        if anatomy.sideways and len(anatomy.hands) == len(Foot):
            files["whole_body.yaml"] = _whole_body(urdf, robot, numbers), "Sherikov et al."

        write_text(folder / "robot.urdf", urdf.text(), overwrite=overwrite)
        write_dynamic(folder, numbers, entries, changes, overwrite=overwrite)
        for name, (values, what) in files.items():
            write_yaml(folder / name, values, f"{urdf.name}, adopted from {path.name}: {what}", overwrite=overwrite)
        for name in {"climb.yaml", "whole_body.yaml"} - set(files):
            (folder / name).unlink(missing_ok=True)  # of a robot that was adopted here before
        config = load(folder / "robot.yaml")
        model = load_model(config.robot)
        walks = load(folder / "dynamic.yaml") if anatomy.lean is not None else config
        masses = _mass_evidence(numbers, "guess" if guessed else "sure")
        found = Adoption(
            folder, config, model, numbers.anatomy, numbers, tuple(entries),
            (*numbers.anatomy.evidence, *masses, *driven, *_missing_evidence(shapes)),
            tuple(dict.fromkeys((*urdf.repairs, *model.repairs))),
            (*([Finding(numbers.hindrance, "")] if numbers.hindrance else []), *check(walks, model)),
        )  # fmt: skip
        write_text(folder / "adopt.json", found.text(path), overwrite=overwrite)
    return found


@contextlib.contextmanager
def _repairs_noted(urdf: Urdf) -> Iterator[None]:
    """Note the repairs made before a ModelError in it."""
    try:
        yield
    except ModelError as error:
        error.args = ("; ".join([str(error), *urdf.left_out[:1]]),)  # it may be a leg
        for repair in dict.fromkeys(urdf.repairs):
            error.add_note(repair)
        raise


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
    if not anatomy.sideways and anatomy.lean is None:
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


def _whole_body(urdf: Urdf, robot: RobotConfig, numbers: Numbers) -> list[Entry]:
    """Return the parameters of the whole-body controller, which also moves the waist and the arms."""
    anatomy = numbers.anatomy
    limbs = (*anatomy.legs.values(), anatomy.waist, *anatomy.arms.values())
    lock = _lock(urdf, {joint for limb in limbs for joint in limb})
    model = parse_model(urdf.text(), replace(robot, lock=lock))
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
