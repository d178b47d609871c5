"""``dqwalk adopt``: makes a configuration that walks from the URDF or MJCF of another robot."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Place,
    command,
    folder_option,
    force_option,
    parse_overrides,
    port_option,
    quiet_option,
    set_option,
)
from dqwalk_ros.support.errors import ConfigError, ModelError, OutputError
from dqwalk_ros.support.wording import kinds

if TYPE_CHECKING:
    from dqwalk_ros.adopt import Adoption
    from dqwalk_ros.report.viewer.page import Page

_SHOWN = 8
"""Kinds of repairs that are printed, with one example of each."""


@command("""
writes to the folder of --out:
  robot.urdf       the robot repaired, with soles; the original is not changed
  robot.yaml       the standing walk; a comment beside each number gives its source
  dynamic.yaml     the dynamic walk, several times as fast
  climb.yaml       what the dynamic walk needs to climb steps by touch (--params), if it does so
  paper.yaml       the walk of Urban & Adorno
  whole_body.yaml  the whole-body controller, if the robot has ankle roll joints and arms
  robot.png        the robot in its posture, soles, CoM, and forward direction
  adopt.json       all results

exit code: 0 the standing walk walks, or the dynamic walk is OK; 1 adopted, but does not walk; 2 it cannot be adopted

examples:
  dqwalk adopt my_robot.urdf
  dqwalk adopt my_robot/scene.xml                          MJCF, which MuJoCo reads
  dqwalk adopt my_robot_description                        a folder with one robot description
  dqwalk adopt robot.urdf.xacro --package-path ~/ws/src --out my_robot
  dqwalk adopt robot.urdf --servo hip=MX-106 --servo knee=MX-106 --servo ankle=MX-64
  dqwalk adopt robot.urdf --left l_foot --right r_foot --forward -x
  dqwalk adopt my_robot.urdf --force --view                again, and show the result in the browser
  dqwalk simulate --config adopted/robot.yaml --plant physics
  dqwalk simulate --config adopted/dynamic.yaml --plant physics
  dqwalk reach --config adopted/whole_body.yaml --test 1
""")
@click.argument("urdf", metavar="FILE", type=Place())
@folder_option("adopted")
@force_option
@click.option("--package-path", "places", metavar="DIR", multiple=True,
              type=Place(exists=True, file_okay=False),
              help="Also search for ROS packages here; may be repeated.")  # fmt: skip
@click.option("--xacro", "arguments", metavar="NAME=VALUE", multiple=True,
              help="Argument of a xacro file; may be repeated.")  # fmt: skip
@click.option("--left", metavar="LINK", default="", show_default=False, help="Link of the left foot.")
@click.option("--right", metavar="LINK", default="", show_default=False, help="Link of the right foot.")
@click.option("--forward", type=click.Choice(["+x", "-x", "+y", "-y"]), help="Forward axis of the root link.")
@click.option("--servo", "servos", metavar="NAME=TYPE", multiple=True,
              help="Type in config/servos.yaml of the servos of joints whose name contains NAME.")  # fmt: skip
@click.option("--yes", is_flag=True, help="Take the best guess instead of asking.")
@click.option("--no-walk", is_flag=True, help="Write the files and check them; do not walk.")
@click.option("--view", is_flag=True, help="Show posture, soles, CoM and forward direction in the browser.")
@port_option
@quiet_option
@set_option
def adopt(
    urdf: Path,
    out: Path,
    force: bool,
    places: tuple[Path, ...],
    arguments: tuple[str, ...],
    left: str,
    right: str,
    forward: str | None,
    servos: tuple[str, ...],
    yes: bool,
    no_walk: bool,
    view: bool,
    port: int | None,
    quiet: bool,
    changes: tuple[str, ...],
) -> int:
    """Configure another biped from its URDF, xacro or MJCF."""
    from dqwalk_ros import adopt as adopting
    from dqwalk_ros.adopt.description import description_in
    from dqwalk_ros.adopt.picture import draw
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.plants.table import plant_type

    if view:
        import dqwalk_ros.report.viewer.page  # noqa: F401 - if viser is missing, say so before the work
    if not no_walk:
        plant_type("physics")  # if the engine is missing, say so before the work
    if bool(left) != bool(right):
        raise ConfigError("--left and --right must be given together")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"'{out}' is a file, not a folder")
    xacro, given = _values(arguments), dict(parse_overrides(changes))
    sides = {"left": left, "right": right, "forward": forward or ""}
    file = description_in(urdf)
    if file != urdf and not quiet:
        print(f"the robot description in the folder: {file}")
    with Progress(quiet=quiet) as bar:
        try:
            found = adopting.adopt(
                file, out, package_paths=places, xacro=xacro, **sides, servos=servos, changes=given,
                overwrite=force, progress=bar.stage,
            )  # fmt: skip
        except OutputError as error:
            raise ConfigError(str(error)) from error  # it is not adopted
        except ModelError as error:
            for repair in kinds(getattr(error, "__notes__", ())):
                bar.print(f"repaired: {repair}")
            raise
        bar.stage(0.7, "drawing")
        draw(found.config, found.model, out / "robot.png", overwrite=force)
    if not quiet:
        _print_found(found)
    page = _page(found, port) if view else None
    if not yes:
        _confirm_forward(found)
    for finding in found.findings:
        print(f"check: {finding}")
    code = (1 if found.findings else 0) if no_walk else _walk(found, given, quiet=quiet)
    if page is not None:
        _wait(page)
    return code


def _values(arguments: tuple[str, ...]) -> dict[str, str]:
    """Return the values of entries NAME=VALUE of --xacro.

    Raises
    ------
    ConfigError
        If an entry has another form.
    """
    if wrong := [text for text in arguments if not text.partition("=")[0] or "=" not in text]:
        raise ConfigError(f"--xacro {wrong[0]}: expected NAME=VALUE")
    return {name: value for name, _, value in (text.partition("=") for text in arguments)}


def _print_found(found: Adoption) -> None:
    """Print repairs, the table of what was found, and the files."""
    from dqwalk_ros.adopt.files import FILES

    out, repairs = found.folder, kinds(found.repairs)
    for repair in repairs[:_SHOWN]:
        print(f"repaired: {repair}")
    if len(repairs) < len(found.repairs) or len(repairs) > _SHOWN:
        print(f"all {len(found.repairs)} repairs are listed in {out / 'adopt.json'}")
    print(found.table())
    files = [out / name for name in sorted(FILES) if (out / name).exists()]
    print(f"wrote {', '.join(map(str, files))}; look at robot.png first")


def _confirm_forward(found: Adoption) -> None:
    """Ask whether a forward direction that is a guess is right.

    Raises
    ------
    ConfigError
        If it is not confirmed.
    """
    unsure = [e.what for e in found.anatomy.evidence if e.what == "ahead" and e.confidence == "guess"]
    if unsure and not _confirmed("the forward direction is a guess (see the table); continue?"):
        raise ConfigError("the forward direction is a guess that was not confirmed: give --forward, or --yes takes it")


def _confirmed(question: str) -> bool:
    """Return the answer of the user; no where the standard input ends without one, as in a script."""
    try:
        return click.confirm(question)
    except click.Abort:
        if sys.stdin.isatty():
            raise  # Ctrl-C
        return False


def _page(found: Adoption, port: int | None) -> Page:
    """Return a page that shows the robot in the first posture of its walk."""
    from dqwalk_ros.report.scene import Scene, beginning
    from dqwalk_ros.report.viewer.page import Page

    page = Page(port)
    page.set_scene(Scene(found.config, found.model), opacity=0.45)
    page.point_ahead(page.show(beginning(found.config, found.model), force=True))
    print(f"{page.url} shows the robot", flush=True)
    return page


def _wait(page: Page) -> None:
    """Show the page until Ctrl-C."""
    print(f"{page.url} shows the robot until Ctrl-C", flush=True)
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        page.close()


def _what(changes: Mapping[str, object]) -> str:
    """Return changed parameters as text."""
    return ", ".join(f"{key} = {value}" for key, value in changes.items())


def _walk(found: Adoption, given: dict[str, object], *, quiet: bool) -> int:
    """Test the walks, print their results, and return the exit code."""
    from dqwalk_ros.adopt.trial import Trial, best, climb, dynamic_walks, first_walks
    from dqwalk_ros.cli.progress import Progress

    last, fast = None, list[Trial]()
    with Progress(quiet=quiet) as bar:
        for result, cure in first_walks(found, given, bar):
            bar.print(f"{result}" + (f" {'cured by' if result.stood else 'in spite of'}: {cure}" if cure else ""))
            last = result
        stands = last is not None and last.stood
        for result, cure in dynamic_walks(found, given, last.changes if last and stands else None, bar):
            if result.plant == "physics":  # the standing walk again, with the servos of a cure
                bar.print(f"{result} with {cure}")
                continue
            bar.print(f"{result}" + (f" {'in spite of' if result.note else 'cured by'}: {cure}" if cure else ""))
            fast.append(result)
        quick = best(fast)
        if quick.stood and not quick.note:
            bar.print(climb(found, bar))
    if len(fast) > 1:
        servos = ", and robot.yaml the same servos" if "servo.stiffness" in quick.changes else ""
        print(f"{found.folder / 'dynamic.yaml'} has {_what(quick.changes) or 'no changes'}{servos}")
    steps = quick.stood and (stands or not quick.note)
    ends = "is not possible" if last is None else "falls" if last.plant == "physics" else "ends early in kinematics"
    slow = "is not OK" if quick.stood else "waits in its double supports" if quick.late else "falls"
    walks = {"robot.yaml": ("the standing walk", stands, ends), "dynamic.yaml": ("the dynamic walk", steps, slow)}
    for file in (file for file, (_, good, _) in walks.items() if good):
        print(shlex.join(["dqwalk", "simulate", "--config", str(found.folder / file), "--plant", "physics"]))
    if not stands and not steps:
        apart = f"soles less than {1e3 * found.anatomy.apart:.0f} mm apart" if found.anatomy.lean else ""
        less = (
            f"; its trunk would lean less with ankles that roll, {apart}, or more mass above its hips" if apart else ""
        )
        print(
            f"adopted, but does not walk, and no cure helped: the standing walk {ends}, the dynamic walk {slow}: "
            f"change what their causes name{less}"
        )
        return 1
    each = ", ".join(f"{name} {'stands in physics' if good else end}" for name, good, end in walks.values())
    but = ", but the report of the dynamic walk is not OK" if steps and quick.note else ""
    print(f"adopted: {'the standing and the dynamic walk stand in physics' if stands and steps else each}{but}")
    return 0
