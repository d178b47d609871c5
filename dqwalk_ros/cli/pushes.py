"""``dqwalk pushes``: finds the largest impulse the robot survives in each direction, standing and walking."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Many,
    Real,
    Setup,
    command,
    many_options,
    setup_options,
)
from dqwalk_ros.plants.table import PHYSICS
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import listed

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.studies.pushes import Limit

_LABELS = {
    "standing": "standing on both feet",
    "left": "in mid-step on the left foot",
    "right": "in mid-step on the right foot",
}


@command("""
writes to the folder of --out:
  limits.jsonl            a line per finished direction; an interrupted run continues from here
  pushes.csv, .txt, .png

examples:
  dqwalk pushes --jobs 4 --set qp.solver=daqp
  dqwalk pushes --config poppy_dynamic_50hz --plant poppy_as_built --tolerance 0.05
  dqwalk pushes --moment standing --directions 16 --set standing.balance=1.0
  dqwalk pushes --config poppy_dynamic --bottle 3          RoboCup: on the spot, from behind and in front
  dqwalk pushes --config poppy_dynamic --link chest --duration 0.03     an impact on the chest
""")
@setup_options("poppy", PHYSICS, "physics")
@click.option(
    "--moment",
    type=click.Choice(["all", "standing", "left", "right"]),
    default="all",
    help="Standing, or in the middle of a step on this foot.",
)
@click.option(
    "--part", metavar="X", type=Real(0.0, 0.95), default=0.5, help="Fraction of the step at which the push begins."
)
@click.option("--directions", metavar="N", type=click.IntRange(1, 360), default=8, help="Directions, evenly spread.")
@click.option(
    "--duration", metavar="S", type=Real(0.0, 10.0, min_open=True), default=0.1, help="Duration of each push [s]."
)
@click.option(
    "--link",
    metavar="NAME",
    show_default="the pelvis",
    help="Link that is pushed, at its centre of mass, as by a fist.",
)
@click.option(
    "--tolerance",
    metavar="NS",
    type=Real(0.0, 1e3, min_open=True),
    show_default="0.36 % of M sqrt(g h)",
    help="Accuracy of each impulse [N s].",
)
@click.option(
    "--bottle",
    metavar="KG",
    type=Real(0.5, 20.0),
    help="Push recovery of the RoboCup Humanoid League (rules of 2025): while the robot walks on the spot, or with the "
    "steps of --set gait.step_length=M, a bottle on a rope of 1.75 m hits its pelvis, from behind and from the front. "
    "Has its own directions and no --duration.",
)
@many_options("pushes")
def pushes(
    setup: Setup,
    moment: str,
    directions: int,
    part: float,
    duration: float,
    link: str | None,
    tolerance: float | None,
    bottle: float | None,
    many: Many,
) -> int:
    """Find the largest push the robot survives.

    Pushes the pelvis or another link of a walking robot in physics, in eight directions, standing on both feet and in
    the middle of a step on either foot, finds by bisection the impulse at which it falls, and prints the largest
    impulse survived. Needs MuJoCo: pip install mujoco
    """
    from dqwalk_ros.cli.results import prepare_study, write_study
    from dqwalk_ros.report.figures.studies import pushes_figure
    from dqwalk_ros.robot.model import load_model
    from dqwalk_ros.studies import pushes as study
    from dqwalk_ros.studies.ceiling import PushCeiling
    from dqwalk_ros.walks.stepping import SteppingWalk
    from dqwalk_ros.walks.table import style_of, walk_type

    if bottle:  # on the spot, unless the steps are given
        setup = replace(setup, changes=("gait.step_length=0", *setup.changes))
    made = setup.made()
    model = load_model(made.robot)
    if link and link not in model.frames:
        raise ConfigError(f"--link {link}: the links of {model.name} are {listed(model.frames)}")
    if link and bottle:
        raise ConfigError("--bottle hits the pelvis: omit --link")
    if bottle:
        if moment == "standing":
            raise ConfigError("--bottle hits a robot that walks: choose --moment left, right or all")
        directions = 2
    if style_of(made) == "paper":
        raise ConfigError(f"pushes need a standing or a dynamic walk; gait.style of '{setup.config}' is paper")
    moments = (study.MOMENTS[1:] if bottle else study.MOMENTS) if moment == "all" else (moment,)
    like = study.Push(moments[0], 0.0, 0.0, duration, part, bottle or 0.0, link or "")
    prepare_study(many, "limits.jsonl", "pushes.csv", "pushes.txt", "pushes.png")
    with many.options("directions") as options:
        found = study.limits(made, many.folder, like, moments, directions, tolerance=tolerance, **options)
    head = ["moment", "direction_deg", "survived_Ns", "failed_Ns", "reason"]
    rows = [[one.moment, round(math.degrees(one.direction), 3), one.survived, one.failed, one.reason] for one in found]
    by_moment = {_LABELS[key]: [one for one in found if one.moment == key] for key in moments}
    if bottle:
        text = f"{table(found, f'momentum of a bottle of {bottle:g} kg')}\n\n{_robocup(found, bottle, made)}"
        figure = pushes_figure(by_moment, f"{model.name}: largest momentum of a bottle of {bottle:g} kg survived [N s]")
    else:
        where, ceiling = link or model.pelvis, None
        if issubclass(walk_type(made), SteppingWalk):
            pendulum = PushCeiling(made, model)

            def ceiling(one: Limit) -> float:
                return pendulum.of(replace(like, moment=one.moment, direction=one.direction))

        text = table(found, f"impulse of a push of {duration:g} s on {where}", study.impulse_scale(made), ceiling)
        figure = pushes_figure(by_moment, f"{model.name}: largest push on {where} survived [N s]")
    write_study(many, "pushes", head, rows, text, figure)
    return 0


def table(
    found: Sequence[Limit], what: str, scale: float | None = None, ceiling: Callable[[Limit], float] | None = None
) -> str:
    """Return the impulses survived, described by `what`, a line per direction and a column per moment.

    With the `scale` M sqrt(g h) of the robot [N s], the weakest are also printed as J*, divided by it; with a `ceiling`
    [N s], each has its own in brackets.
    """
    from dqwalk_ros.support.text_table import aligned

    moments = list(dict.fromkeys(one.moment for one in found))

    def cell(one: Limit) -> str:
        beside = f" ({ceiling(one):.2f})" if ceiling else ""
        return f"{'' if one.failed is not None else '>= '}{one.survived:.3g}{beside}"

    least = {m: min((one for one in found if one.moment == m), key=lambda one: one.survived) for m in moments}
    rows = [
        [f"{math.degrees(direction):.0f}", *(cell(one) for one in found if one.direction == direction)]
        for direction in dict.fromkeys(one.direction for one in found)
    ]
    rows.append(["weakest", *(cell(least[m]) for m in moments)])
    if scale:
        rows.append(["J*", *(f"{least[m].survived / scale:.3f}" for m in moments)])
    text = aligned(rows, ("towards [deg, 0 ahead, 90 left]", *moments), right=range(len(moments) + 1))
    head = f"largest {what} that is survived [N s]"
    head += f"; J* is it divided by M sqrt(g h) = {scale:.3g} N s" if scale else ""
    head += "\nin brackets: what a pendulum on these soles catches with the steps of this walk" if ceiling else ""
    return f"{head}\n\n{text}"


def _robocup(found: Sequence[Limit], bottle: float, config: Config) -> str:
    """Return the distances of the release and the measure M of the weaker foot, from behind and from the front."""
    from dqwalk_ros.studies.loads import ROPE, release_distance
    from dqwalk_ros.studies.pushes import robocup_measure

    lines = []
    for where, direction in (("from behind", 0.0), ("from the front", math.pi)):
        least = min(one.survived for one in found if abs(one.direction - direction) < 1e-6)
        distance, measure = release_distance(bottle, least), robocup_measure(config, bottle, least)
        lines.append(f"{where}: released {distance:.2f} m away, on a rope of {ROPE:g} m: M = {measure:.2f}")
    return "\n".join(lines)
