"""The walks and pushes that a table of results claims, each in several engines, with exact bounds of their chances."""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from dqwalk_ros import report
from dqwalk_ros.config import Config, find_file, load, overlaid, with_files
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.plants.base import Plant
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import RobotModel, find_urdf, load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies import ceiling
from dqwalk_ros.studies.plan import digest
from dqwalk_ros.studies.pushes import Push, pushed
from dqwalk_ros.studies.runner import Point, Store, drawn, run
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError, DqwalkError, PlantError
from dqwalk_ros.support.wording import listed
from dqwalk_ros.walks.course import Course, speeds
from dqwalk_ros.walks.stepping import SteppingWalk
from dqwalk_ros.walks.table import make_controller, make_walk, refuse_endless, walk_type

_CONFIDENCE = 0.95
"""Probability with which the bounds of `bounds` contain the true chance."""
_REACH = 1.0
"""Largest distance of an arm's joint from its posture at the random poses of its hand [rad]."""
_DIRECTIONS, _PARTS = 8, (0.1, 0.25, 0.5, 0.75)
"""Of the pushes of a row: evenly spread directions, and fractions of a step after which they begin."""
_HEIGHTS = ("physics.rubble", "physics.rise")
"""Parameters that `of_robot` scales by the leg."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A claim: a walk with several seeds of the sensors' errors, or a walk with pushes."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]
    config: str
    """As ``--config``."""
    plant: Literal["physics", "poppy_as_built"] = "physics"
    """Name of a file in ``config/plants/``, without the engine."""
    params: list[str] = []
    """As ``--params``, before `set`."""
    use: list[str] = []
    """Names of sets of parameters in the file."""
    set: dict[str, Any] = {}
    """Parameters, as ``--set``, with precedence over those sets."""
    cmd_vel: list[str] = []
    """Legs of a steered walk, as ``--cmd-vel``."""
    seeds: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 20
    """Number of walks, with ``sensors.seed`` `first`, `first` + 1, ..."""
    first: Annotated[int, msgspec.Meta(ge=0, le=10**6)] = 1
    hands: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    """Interval after which each hand gets a new random pose in the trunk [s]; 0: none. Needs ``arms.joints``."""
    course: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)] = 0.0
    """Duration of a course of random velocities, another one for each seed (`Course.random`) [s]; 0: none."""
    push: Annotated[float, msgspec.Meta(ge=0.0, le=1e3)] = 0.0
    """Impulse of each push [N s], in 8 directions, on either foot, at 4 moments of a step; 0: walks without a push. On
    a random course: that of a push on a random link in each of its legs."""
    anywhere: bool = False
    """Whether each push is on a random link, in a random direction and moment (`Push.anywhere`), one for each seed."""

    @property
    def steered(self) -> bool:
        """Whether its walks follow commands of velocity."""
        return bool(self.cmd_vel or self.course)

    def made(self) -> Config:
        """Return the configuration of the walks, without seed and engine.

        Raises
        ------
        ConfigError
            If a parameter or a leg of the course is invalid.
        """
        Course.parse(self.cmd_vel)
        made = with_files(overlaid(load(self.config), self.plant), map(Path, self.params))
        made = made.updated(({"gait.steps": 0} if self.steered else {}) | self.set, source=self.name)
        if self.steered and walk_type(made).phases(made):
            raise ConfigError(f"{self.name}: cmd_vel and course steer a standing or dynamic walk with gait.steps: 0")
        if not (self.steered or self.push):
            refuse_endless(made)
        if self.cmd_vel and self.course:
            raise ConfigError(f"{self.name}: a walk follows either cmd_vel or a random course")
        if self.hands and not (made.arms.left_hand or made.arms.right_hand):
            raise ConfigError(f"{self.name}: hands need free arms: arms.joints with arms.left_hand or arms.right_hand")
        return made


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    rows: Annotated[list[Row], msgspec.Meta(min_length=1)]
    sets: dict[str, dict[str, Any]] = {}


class WalkOutcome(msgspec.Struct, frozen=True):
    """The outcome of a walk; of a walk with a push only whether it stood, and why not."""

    stood: bool
    """Whether it was finished upright, and its soles covered the path of its steps (`GroundTruth.failure`)."""
    reason: str = ""
    """Why it did not stand, or what is not OK."""
    ok: bool | None = None
    """Whether its report is OK."""
    tilt: float | None = None
    landing: float | None = None
    """Largest tilt of the loaded sole [rad], largest landing error [m]."""
    inside: float | None = None
    """Fraction of the states with the pressure inside the support polygon."""
    speed: float | None = None
    """Distance over time, of the whole walk [m/s]."""
    touching: int | None = None
    """Number of states in which links of the robot touch each other, summed over pairs (`plants.mujoco.own_contacts`);
    None in another engine, and if MuJoCo cannot read the shapes of the robot."""


def read(path: str) -> dict[str, Row]:
    """Read the rows of a file, a path or a name in ``config/``, by their names.

    Raises
    ------
    ConfigError
        If the file or one of the configurations is invalid.
    """
    file = find_file("file of rows", path, "config", ("evidence", "ground", "obstacles", "arms", "as_built"))
    try:
        read = msgspec.convert(strict_yaml.read(strict_yaml.read_text(file), source=str(file)), _File)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{file}: {error}") from None
    rows = {}
    for row in read.rows:
        if unknown := set(row.use) - set(read.sets):
            raise ConfigError(f"{file}: '{row.name}' uses {listed(unknown)}; the sets are {listed(read.sets)}")
        if row.name in rows:
            raise ConfigError(f"{file}: two rows have the name '{row.name}'")
        given = {key: value for name in row.use for key, value in read.sets[name].items()}
        rows[row.name] = msgspec.structs.replace(row, set=given | row.set)
        rows[row.name].made()
    return rows


def of_robot(rows: Mapping[str, Row], config: str) -> dict[str, Row]:
    """Return the rows with the walk of another robot, and heights of the ground in proportion to its legs.

    Parameter files and types of servos, which are those of the rows' own robots, are left out.

    Parameters
    ----------
    config : str
        As ``--config``.

    Raises
    ------
    ConfigError
        If it does not fit a row.
    """
    leg = functools.cache(_leg)
    out = {}
    for name, row in rows.items():
        kept = {key: value for key, value in row.set.items() if key != "servo.types"}
        scaled = {key: kept[key] * leg(config) / leg(row.config) for key in _HEIGHTS if key in kept}
        out[name] = msgspec.structs.replace(row, config=config, plant="physics", params=[], set=kept | scaled)
        out[name].made()
    return out


def _leg(config: str) -> float:
    """Return the height of the pelvis over a sole in the posture of a configuration's walk [m]."""
    made = load(config)
    model = load_model(made.robot)
    kin = Kinematics(model, make_walk(made, model).posture, Foot.LEFT)
    return float(kin.point(model.pelvis)[2])


def points(rows: Mapping[str, Row], engines: Sequence[str], sample: int = 0) -> list[dict[str, Any]]:
    """Return all walks, or of each row and engine `sample` of them, drawn at random but the same for all engines."""
    out: list[dict[str, Any]] = []
    for name, row in rows.items():
        every: list[dict[str, Any]] = [{"seed": row.first + k} for k in range(row.seeds)]
        if row.push and not row.anywhere and not row.course:
            every = [
                {"foot": foot, "direction": 2.0 * math.pi * k / _DIRECTIONS, "part": part}
                for foot, k, part in itertools.product(("left", "right"), range(_DIRECTIONS), _PARTS)
            ]
        out += [{"row": name, "engine": engine, **one} for engine in engines for one in drawn(every, sample)]
    return out


def _evaluate(
    rows: Mapping[str, Row], configs: Mapping[str, Config], index: int, point: Mapping[str, Any]
) -> WalkOutcome:
    """Simulate one walk; the index is not used."""
    row, config = rows[point["row"]], configs[point["row"]].updated({"plant.name": point["engine"]})
    try:
        model = load_model(config.robot)
        if row.push and not row.course:
            push = (
                Push.anywhere(row.push, model, point["seed"])
                if row.anywhere
                else Push(point["foot"], point["direction"], row.push, part=point["part"])
            )
            why = pushed(config, push)
            return WalkOutcome(not why, why)
        config = config.updated({"sensors.seed": point["seed"]})
        controller, plant = make_controller(config, model), make_plant(point["engine"], config, model)
        course = Course.parse(row.cmd_vel)
        if row.course:
            course = Course.random(row.course, speeds(controller.walk), point["seed"])
        orders = [course.steering(controller)] if row.steered else []
        if row.course and row.push:
            orders.append(_pushing(plant, course, row.push, model, config.dt, point["seed"]))
        if row.hands:
            orders.append(_reaching(controller, row.hands, point["seed"]))

        def before_step(time: float) -> None:
            for order in orders:
                order(time)

        trace = simulate(controller, plant, before_step=before_step, whole=True)
        series = report.analyse(trace)
        ground, found = series.judged, report.report(series)
    except DqwalkError as error:
        return WalkOutcome(False, str(error))
    of, failure = found["physics"], ground.failure
    reasons = [*trace.notes, *filter(None, [failure]), *(one["message"] for one in found["violations"])]
    why = "" if found["ok"] else "; ".join([*dict.fromkeys(reasons)][:2])
    seconds = float(trace.time[-1] - trace.time[0])
    landing, speed = found["walk"]["landing_error"], of["way"] / seconds if seconds > 0.0 else None
    touching = None
    if point["engine"] == "physics":
        from dqwalk_ros.plants.mujoco import own_contacts  # needs the engine

        with contextlib.suppress(PlantError):  # shapes that MuJoCo cannot read, such as some meshes
            touching = own_contacts(model, trace.q, find_urdf(config.robot.urdf)).total()
    return WalkOutcome(not failure, why, found["ok"], of["tilt"]["value"], landing, of["cop_inside"], speed, touching)


def _reaching(controller: VelocityController, interval: float, seed: int) -> Callable[[float], None]:
    """Return what gives each hand of a walk a pose in the trunk after every interval [s].

    The poses are those at random angles of the arms within `_REACH` of their posture.
    """
    walk, model, rng = controller.walk, controller.model, np.random.default_rng(seed)
    assert isinstance(walk, SteppingWalk)
    assert walk.arms is not None
    arms, count = walk.arms, 0

    def order(time: float) -> None:
        nonlocal count
        if time < count * interval:
            return
        count += 1
        for side in arms.hands:
            q = walk.posture + rng.uniform(-_REACH, _REACH, model.n)
            kin = Kinematics(model, np.clip(q, model.q_min, model.q_max), Foot.LEFT)
            arms.reach(side, arms.pose_in_trunk(side, kin), arms.hands[side].trunk)

    return order


def _pushing(
    plant: Plant, course: Course, impulse: float, model: RobotModel, dt: float, seed: int
) -> Callable[[float], None]:
    """Return what pushes a robot once in each leg of a course, with an impulse [N s] on a random link (`Push`)."""
    ends = np.cumsum([leg.duration for leg in course.legs])
    pushes = [Push.anywhere(impulse, model, 1000 * seed + k) for k in range(len(ends))]
    begins = [end - leg.duration * (1.0 - push.part) for end, leg, push in zip(ends, course.legs, pushes, strict=True)]
    loads = [push.load(model.mass, dt) for push in pushes]

    def order(time: float) -> None:
        if (k := int(np.searchsorted(begins, time, side="right")) - 1) >= 0:
            plant.push(loads[k].force(0.0, dt) * pushes[k].towards, pushes[k].link)

    return order


def collect(
    rows: Mapping[str, Row], engines: Sequence[str], out: Path, *, sample: int = 0, force: bool = False, **options: Any
) -> list[tuple[Point, WalkOutcome]]:
    """Simulate what is missing in ``walks.jsonl`` of a folder, and return all points with their outcomes in order.

    With `force` earlier results are discarded; other options and errors are those of `runner.run`.
    """
    configs, every = {name: row.made() for name, row in rows.items()}, points(rows, engines, sample)
    walks = [
        (row.push, row.anywhere, row.cmd_vel, row.course, row.hands, configs[name].flat()) for name, row in rows.items()
    ]
    key = digest(next(iter(configs.values())), every, walks)
    store = Store(out / "walks.jsonl", key, every, WalkOutcome, force=force)
    return run(functools.partial(_evaluate, rows, configs), store, **options)


def ceilings(rows: Mapping[str, Row]) -> dict[str, str]:
    """Return what the robot allows beside what a row claims, as `ceiling.ceilings`; a random course has no ceiling."""
    wanted = {name: row for name, row in rows.items() if not row.course}
    pushes = {
        name: [Push(one["foot"], one["direction"], row.push, part=one["part"]) for one in points({name: row}, [""])]
        for name, row in wanted.items()
        if row.push and not row.anywhere
    }
    made = {name: row.made() for name, row in wanted.items() if name in pushes or not row.push}
    return ceiling.ceilings(made, pushes)


def bounds(count: int, total: int) -> tuple[float, float]:
    """Return the bounds of the chance of an event that happened `count` times in `total`, both in [0, 1].

    They contain the true chance with at least `_CONFIDENCE`, whatever it is (Clopper and Pearson 1934).
    """
    from scipy.stats import binomtest

    found = binomtest(count, total).proportion_ci(_CONFIDENCE, method="exact")
    return float(found.low), float(found.high)
