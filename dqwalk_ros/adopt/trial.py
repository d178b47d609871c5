"""Walks with an adopted robot for the first time, and changes parameters if it falls or lands beside its targets."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dqwalk_ros.adopt.adoption import Adoption
from dqwalk_ros.adopt.files import changed, write_dynamic, write_yaml
from dqwalk_ros.adopt.parameters import HEAVY_LEGS, Numbers, assumed, climb_parameters, rounded
from dqwalk_ros.adopt.skeleton import Entry
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report.binding import Load, most_loaded
from dqwalk_ros.report.causes import causes
from dqwalk_ros.report.metrics import analyse, pelvis_in_odom
from dqwalk_ros.report.verdict import violations
from dqwalk_ros.robot.model import RobotModel, find_urdf, load_model
from dqwalk_ros.robot.standing_limits import Finding
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies.servo_choice import Gait, largest_loads, own_servos, step
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import DqwalkError, PlantError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.table import make_controller

_LOADED = 0.01
"""Least part of a torque-speed curve that is reported: joints without torque limit need less."""
_SHORT = 0.9
"""Fraction of the planned distance below which a walk is reported as shorter."""
_EVERY = 10
"""Number of states of which one is searched for links that touch each other."""
_LIGHTER = 0.1
"""Factor of ``task.posture_weight`` with which a joint at its limit holds the CoM less off its goal."""
_FLAT, _TREAD, _SPARE = 0.3, 0.25, 14
"""Least way to a step and on it [m], and the number of steps with which a robot climbs it; both ways suit two soles."""
_LONGEST, _PATIENCE = 120.0, 3.0
"""Longest time of a climb [s], and of a dynamic walk, as a multiple of the planned one."""
_STIFFER = 8.0
"""Servo stiffness as a multiple of m g h that may cure a walk where the description gives none."""
_FIRST = 10
"""Steps of a dynamic walk, before the whole one, of a robot that cannot do the standing walk: many wait in each."""
_COMPLIES, _SHORTER = 0.4, 0.7
"""Factors of ``servo.window`` and of the length of a step that may cure a dynamic walk."""
_LOWER, _EARLIER, _SOONER = 0.6, 0.3, 0.7
"""Those of the height of a step, the delay of its landing, and the duration of the start: without rolling ankles a body
tips from foot to foot, and faster than a slow start assumes."""


@dataclass(frozen=True)
class Trial:
    """The result of a trial walk."""

    plant: str
    """``integrator`` or ``physics``; ``dynamic walk`` if it is this walk in physics."""
    stood: bool
    """Whether the walk was completed."""
    distance: float
    """Measured displacement of the pelvis along x [m]."""
    planned: float
    """Displacement according to the parameters [m]."""
    note: str
    """Reason for which the walk ended early; what its report finds, if it was completed."""
    violations: int = 0
    """How much that is, if it was completed."""
    late: bool = False
    """Whether the robot still stood where the time of its walk was over: its CoM did not arrive where steps begin."""
    causes: tuple[Finding, ...] = ()
    """Causes of a fall, the earliest first."""
    load: Load | None = None
    """The servo that is closest to its torque-speed curve, in physics."""
    touching: str = ""
    """Which links of one leg meet those of the other, which no engine simulates; empty if none does, or if MuJoCo
    cannot read the shapes."""
    changes: Mapping[str, Any] = field(default_factory=dict)
    """The parameters that were changed after earlier walks."""

    @property
    def short(self) -> bool:
        """Whether the robot got less far than planned."""
        return self.distance < _SHORT * self.planned

    def __str__(self) -> str:
        if not self.stood:
            fell = () if self.late else self.causes[:1]
            return f"{self.plant}: {self.note}" + "".join(f"; it fell because: {cause}" for cause in fell)
        short = f" instead of {self.planned:.3f} m" if self.short else ""
        load = f", {self.load}" if self.load and self.load.part > _LOADED else ""
        but = "; ".join(text for text in (self.note, self.touching) if text)
        return f"{self.plant}: walked {self.distance:.3f} m{short}{load}" + (f", but {but}" if but else "")


def first_walks(
    found: Adoption, given: Mapping[str, Any], progress: Callable[[float, str], None] = lambda *_: None
) -> Iterator[tuple[Trial, str]]:
    """Walk in kinematics, then in physics; after a fall try cures until one helps: in physics those of `cures`.

    In kinematics it is that the posture weighs less. There is no walk if the trunk has to lean, or if the legs reach no
    step. Yields each walk and a
    description of the cures applied to it, empty for the derived parameters. ``robot.yaml`` and ``dynamic.yaml`` are
    rewritten if a cure helps; no cure changes the parameters `given` by the user. The progress is called with the
    fraction of the present walk and a line of text.
    """
    names: list[str] = []
    changes: dict[str, Any] = {}

    def trial(plant: str) -> tuple[Trial, str]:
        if changes:
            reason = f"changed after a walk that ended early: {', '.join(names)}"
            _write(found, changed(found.entries, changes, reason), given)
        config = load(found.folder / "robot.yaml")
        return replace(walk(config, load_model(config.robot), plant, progress), changes=dict(changes)), ", ".join(names)

    if found.anatomy.lean is not None or found.numbers.reach <= 0.0:
        return  # only its dynamic walk is possible
    first = trial("integrator")
    yield first
    weight = "task.posture_weight"
    if not first[0].stood and weight not in given:
        names.append(f"{_LIGHTER:g} times {weight}")
        changes[weight] = rounded(_LIGHTER * found.config.task.posture_weight)
        first = trial("integrator")
        yield first
    if first[0].stood:
        first = trial("physics")
        yield first
        if first[0].stood:
            return
        for what, values in cures(found.config, found.numbers, first[0].causes):
            names.append(what)
            changes |= {key: value for key, value in values.items() if key not in given}
            again = trial("physics")
            yield again
            if again[0].stood:
                return
    if changes:
        _write(found, found.entries, given)


def _write(found: Adoption, entries: Sequence[Entry], given: Mapping[str, Any]) -> None:
    """Write both walks with the `entries` of the standing walk."""
    title = f"{found.model.name}: the standing walk."
    write_yaml(found.folder / "robot.yaml", entries, title, overwrite=True)
    write_dynamic(found.folder, found.numbers, entries, given, overwrite=True)


def dynamic_walks(
    found: Adoption,
    given: Mapping[str, Any],
    standing: Mapping[str, Any] | None,
    progress: Callable[[float, str], None] = lambda *_: None,
) -> Iterator[tuple[Trial, str]]:
    """Walk the dynamic walk in physics; if it falls or its report is not OK, try seven cures, one after the other.

    These are more compliant legs, the same with all of the servos' lag assumed, goals ahead by all of this lag, stiffer
    servos if their stiffness is a guess, an earlier start and landing, the same with lower steps, and shorter steps;
    goals ahead and shorter steps with the changes of the best of the walks before. Where a walk is `late`, its legs
    rather do not reach what it wants, and neither lag nor stiffness of the servos is tried. A robot has one stiffness:
    before a stiffer one is tried, the standing walk has to stand with it.

    Yields each walk and a description of the changes before it, as `first_walks` does; `standing` are the changes that
    cured the standing walk, None if it does not stand. ``dynamic.yaml`` is that of the `best` of these walks in the
    end, even if the robot falls, and ``robot.yaml`` has the same servos. Where something is wrong, the `note` also says
    which joint cannot do the steps.
    """
    part = found.numbers.legs
    heavy = (
        f"its legs are {100.0 * part:.0f} % of its mass, and this walk takes them for light"
        if part > HEAVY_LEGS
        else ""
    )

    def trial() -> Trial:
        config = load(found.folder / "dynamic.yaml")
        model = load_model(config.robot)

        def walked(steps: int) -> Trial:
            part = config.updated({"gait.steps": min(steps, config.gait.steps)})
            return walk(part, model, "physics", lambda share, text: progress(share, f"dynamic walk in {text}"))

        first = walked(_FIRST) if found.numbers.hindrance else None
        done = first if first is not None and first.late else walked(config.gait.steps)
        beyond = too_much(config, model) if found.anatomy.lean is None else ""  # of a pelvis that is upright
        why = (done.note, beyond, heavy) if done.note else ()
        return replace(done, plant="dynamic walk", note="; ".join(text for text in why if text))

    config = load(found.folder / "dynamic.yaml")
    servo, gait = config.servo, config.gait
    complies = {"servo.window": rounded(max(_COMPLIES * servo.window, 1e-3), 2)}
    lag: dict[str, Any] = {"servo.assumed": list(assumed(servo.damping, 1.0))} if servo.assumed else {}
    ahead = {**lag, "servo.assumed_lead": servo.damping}
    shorter = {
        **{f"gait.{key}": rounded(_SHORTER * getattr(gait, key), 2) for key in ("step_length", "most_length")},
        "gait.steps": math.ceil(gait.steps / _SHORTER),
    }
    earlier = {
        "dynamic.land_late": rounded(_EARLIER * config.dynamic.land_late, 2),
        "dynamic.start_duration": rounded(_SOONER * config.dynamic.start_duration, 2),
    }
    lower = {**earlier, "gait.step_height": rounded(_LOWER * gait.step_height, 2)}
    none: dict[str, Any] = {}
    guessed = any(entry.what == "servo.stiffness" and entry.confidence == "guess" for entry in found.entries)
    stiffness = rounded(_STIFFER * found.numbers.mgh)
    same = {"servo.stiffness": stiffness, "servo.assumed_stiffness": stiffness}
    stiffer = same if guessed and not servo.types and stiffness > servo.stiffness else none
    tried = (
        ("", none),
        (f"more compliant legs ({_COMPLIES:g} times servo.window)", complies),
        ("these legs, and all of the servos' lag assumed (servo.assumed)", {**complies, **lag} if lag else none),
        ("goals ahead by all of the servos' lag (servo.assumed_lead)", ahead),
        (f"stiffer servos ({_STIFFER:g} m g h, servo.stiffness)", stiffer),
        (f"an earlier start and landing ({_EARLIER:g} times dynamic.land_late)", earlier),
        (f"both, and lower steps ({_LOWER:g} times gait.step_height)", lower),
        (f"shorter steps ({_SHORTER:g} times gait.step_length)", shorter),
    )
    entries = changed(found.entries, standing or {}, "changed after a standing walk that ended early")
    walks = list[Trial]()
    for what, changes in tried:
        # lengths given by the user are those of the standing walk
        kept = {key: value for key, value in changes.items() if key not in given or key in shorter}
        late = bool(walks) and walks[-1].late
        if (what and not kept) or (late and not any(changes is one for one in (complies, earlier, lower, shorter))):
            continue
        if changes is stiffer and standing is not None:
            slow = load(found.folder / "robot.yaml").updated(kept)
            again = walk(slow, load_model(slow.robot), "physics", progress)
            yield again, what
            if not again.stood:
                continue
        kept = {**(best(walks).changes if changes is ahead or changes is shorter else {}), **kept}
        write_dynamic(found.folder, found.numbers, entries, given, kept, overwrite=True)
        walks.append(replace(trial(), changes=kept))
        yield walks[-1], what
        if not walks[-1].note:
            break
    cured = best(walks).changes
    if servos := {key: value for key, value in cured.items() if key in stiffer}:
        entries = changed(entries, servos, "changed after a dynamic walk that was not OK")
        _write(found, entries, given)
    write_dynamic(found.folder, found.numbers, entries, given, cured, overwrite=True)


def climb(found: Adoption, progress: Callable[[float, str], None] = lambda *_: None) -> str:
    """Walk in physics up a step that the dynamic walk does not know; return what the robot did there.

    If it climbs it, ``climb.yaml`` has the parameters of this, for ``--params``; otherwise there is no such file.
    """
    file, config = found.folder / "climb.yaml", load(found.folder / "dynamic.yaml")
    entries = climb_parameters(found.numbers, config)
    changes: dict[str, Any] = {entry.what: entry.value for entry in entries}
    sole = found.model.soles[Foot.LEFT].length
    rise, at, tread = changes["gait.climb"], max(_FLAT, sole), max(_TREAD, 2.0 * sole)
    changes |= {"physics.rise": rise, "physics.stairs_at": at, "physics.tread": tread}
    changes["gait.steps"] = math.ceil((at + 0.5 * tread) / config.gait.step_length) + _SPARE
    file.unlink(missing_ok=True)
    step = f"a step of {1e3 * rise:.0f} mm that it does not know"
    try:
        trace = _walked(config.updated(changes), found.model, "physics", progress, _LONGEST)
    except DqwalkError as error:
        return f"climb: {step} is too high: {error}"
    if not trace.finished:
        return f"climb: at {step}: {'; '.join(trace.notes) or f'not on it after {_LONGEST:g} s'}"
    if _distance(trace, axis=2) < 0.5 * rise:
        return f"climb: it stays in front of {step}"
    title = f"{found.model.name} climbs by touch: dynamic.yaml with --params climb.yaml (docs/dynamic.md)."
    write_yaml(file, entries, title, overwrite=True)
    return f"climb: climbed {step}"


def best(walks: Sequence[Trial]) -> Trial:
    """Return the walk that stood, got as far as planned, and has the fewest violations; the first of equal ones."""
    return min(walks, key=lambda walk: (not walk.stood, bool(walk.violations) and walk.short, walk.violations))


def too_much(config: Config, model: RobotModel) -> str:
    """Return which joint cannot do a step of a dynamic walk by its speed or torque; empty if each can."""
    motion, servos = step(config, model, Gait.of(config)), own_servos(config, model)
    speed, loads = np.abs(motion.velocity).max(axis=0), largest_loads(servos, motion)
    fast, loaded = int(np.argmax(speed / model.velocity_max)), int(np.argmax(loads))
    if motion.off:
        return f"the legs do not reach its steps: {', '.join(motion.stuck) or 'no joint is'} at the limit"
    if speed[fast] > model.velocity_max[fast]:
        name, most = model.joint_names[fast], float(model.velocity_max[fast])
        return f"its steps need {speed[fast]:.2f} rad/s of {name}, whose limit is {most:.2f} rad/s (predicted)"
    if loads[loaded] > 1.0:
        return (
            f"its steps need {loads[loaded]:.2f} of the torque-speed curve of {model.joint_names[loaded]} (predicted)"
        )
    return ""


def walk(config: Config, model: RobotModel, plant: str, progress: Callable[[float, str], None]) -> Trial:
    """Walk as far as the configuration says, or one cycle of the paper's walk, on ``integrator`` or ``physics``.

    An error of the walk is the `note` of the result.
    """
    standing, most = config.standing, None
    if config.gait.style == "dynamic":
        steps = config.gait.steps * (standing.transfer_duration + standing.swing_duration)
        most = config.dynamic.start_duration + _PATIENCE * steps + config.dynamic.stop_duration
    try:
        one = {"gait.cycles": 1} if config.gait.style == "paper" else {}
        trace = _walked(config.updated(one), model, plant, progress, most)
    except DqwalkError as error:
        return Trial(plant, False, 0.0, 0.0, str(error))
    series = analyse(trace)
    swings = sum(phase.swing_target is not None for phase in trace.phases)
    slow = 1 + (min(config.dynamic.ramp, (config.gait.steps - 1) // 2) if config.gait.style == "dynamic" else 0)
    planned = config.gait.step_length * max(0, swings - slow)
    if not trace.finished:
        late = f"not at its end after {most:.0f} s: double supports wait until the CoM has arrived" if most else ""
        why = "; ".join(trace.notes) or late
        waits = not trace.notes
        return Trial(plant, False, _distance(trace), planned, why, late=waits, causes=tuple(causes(series)))
    found = violations(series)
    note = f"{found[0].message}" + (f", and {len(found) - 1} more" if len(found) > 1 else "") if found else ""
    touching = legs_touching(model, trace.q[::_EVERY], find_urdf(config.robot.urdf)) if plant == "physics" else ""
    return Trial(plant, True, _distance(trace), planned, note, len(found), load=most_loaded(trace), touching=touching)


def _walked(
    config: Config,
    model: RobotModel,
    plant: str,
    progress: Callable[[float, str], None],
    most: float | None = None,
) -> Trace:
    """Return the trace of a walk that has to stand by itself, of at most `most` seconds; see `walk`."""
    config = config.updated({"gait.recover": ""})
    config = overlaid(config, plant) if plant == "physics" else config
    controller, body = make_controller(config, model), make_plant(plant, config, model)

    def show(done: float, text: str) -> None:
        progress(done, f"{plant}: {text}")

    return simulate(controller, body, max_time=most, progress=show, whole=True)


def legs_touching(model: RobotModel, q: Array, near: str | os.PathLike[str] = ".") -> str:
    """Return which link meets a leg in the states q (N, n), and in what part of them; empty if none does.

    A link of the same leg does not count. `near` is the path of the robot description.
    """
    from dqwalk_ros.plants.mujoco import own_contacts  # needs the engine

    left, right = (set(model.chain(model.frames[model.soles[foot].frame].body)) for foot in Foot)
    leg = {name: (frame.body in left - right) - (frame.body in right - left) for name, frame in model.frames.items()}
    try:
        met = own_contacts(model, q, near)
    except PlantError as error:
        return f"whether its links meet is not known ({error})"
    pairs = {pair: count for pair, count in met.items() if len({leg[link] for link in pair.split(", ")}) > 1}
    if not pairs:
        return ""
    worst = min(pairs, key=lambda pair: (-pairs[pair], pair))
    legs = 0 not in {leg[link] for link in worst.split(", ")}
    return (
        f"{'the legs meet' if legs else 'a leg meets another link'} ({worst.replace(', ', ' and ')} in "
        f"{100.0 * pairs[worst] / len(q):.0f} % of the states), which is not simulated: "
        + (
            "collision.pairs keeps them apart"
            if legs
            else "if that is of an arm, robot.lock holds it further out, as l_shoulder_roll=0.25"
        )
    )


def _distance(trace: Trace, axis: int = 0) -> float:
    """Return the displacement of the pelvis along an axis [m]: the true one in physics, else that of leg odometry."""
    physics = trace.physics
    known = physics is not None and np.isfinite(physics.pelvis).any()
    poses = physics.pelvis if physics is not None and known else pelvis_in_odom(trace)
    x = DQ(poses[np.isfinite(poses[:, 0])]).translation()[:, axis]
    return float(x[-1] - x[0])


def cures(config: Config, numbers: Numbers, found: Sequence[Finding]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield changes that may prevent a fall: a description, and the values of it and of all changes before it.

    Changes for the causes `found` are first, in their order.
    """
    servo, standing = config.servo, config.standing
    stiffness = rounded(_STIFFER * numbers.mgh)

    def damped(stiffness: float) -> dict[str, Any]:
        damping = numbers.damping(stiffness, 0.8, servo.armature)
        return {"servo.damping": damping} | ({"servo.assumed": list(assumed(damping))} if servo.assumed else {})

    known: dict[str, tuple[str, dict[str, Any]]] = {
        "damping": ("a damping ratio of 0.8", damped(servo.stiffness)),
        "stiffness": (
            f"a stiffness of {_STIFFER:g} m g h, a damping ratio of 0.8",
            {"servo.stiffness": stiffness, "servo.assumed_stiffness": stiffness, **damped(stiffness)},
        ),
        "pressure": (
            "1.3 times the transfer duration",
            {"standing.transfer_duration": rounded(1.3 * standing.transfer_duration)},
        ),
        "step": ("0.7 times the step length", {"gait.step_length": rounded(0.7 * config.gait.step_length)}),
    }
    order = [cause.what for cause in found if cause.what in known]
    changes: dict[str, Any] = {}
    for what in dict.fromkeys([*order, *known]):
        if what == "damping" and "servo.stiffness" in changes:
            continue  # already included in the change of the stiffness
        changes |= known[what][1]
        yield known[what][0], dict(changes)
