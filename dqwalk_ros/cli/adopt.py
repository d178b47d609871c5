"""``dqwalk adopt``: another robot's URDF to a configuration that walks."""

from __future__ import annotations

from pathlib import Path

import click

from dqwalk_ros.cli.options import command, parse_overrides, quiet_option, set_option

__all__ = ["adopt"]


@command("""
writes to the folder of --out:
  robot.urdf       the robot repaired, with soles; the original is not changed
  robot.yaml       the walk that stands; beside each number stands where it is from
  paper.yaml       the walk of Urban & Adorno
  whole_body.yaml  the whole-body controller, where the ankles roll and there are arms
  robot.png        the robot in the posture, its soles, its CoM, and which way is ahead
  adopt.json       all that was found

exit code: 0 it walks; 1 it was adopted and falls; 2 this robot cannot walk here, and why

examples:
  dqwalk adopt my_robot.urdf
  dqwalk adopt robot.urdf.xacro --package-path ~/ws/src --out my_robot
  dqwalk adopt robot.urdf --left l_foot --right r_foot --forward -x
  dqwalk simulate --config adopted/robot.yaml --plant physics
  dqwalk reach --config adopted/whole_body.yaml --test 1
""")
@click.argument("urdf", type=click.Path(path_type=Path))
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path), default="adopted", show_default=True,
              help="Folder of the results.")  # fmt: skip
@click.option("--package-path", "places", metavar="DIR", multiple=True, type=click.Path(path_type=Path),
              help="Look for ROS packages here, too; may be given several times.")  # fmt: skip
@click.option("--left", metavar="LINK", default="", help="Link of the left foot.")
@click.option("--right", metavar="LINK", default="", help="Link of the right foot.")
@click.option("--forward", type=click.Choice(["+x", "-x", "+y", "-y"]), help="Axis of the root link that looks ahead.")
@click.option("--yes", is_flag=True, help="Take the best guess instead of asking.")
@click.option("--no-walk", is_flag=True, help="Write the files and check them; do not walk.")
@quiet_option
@set_option
def adopt(
    urdf: Path,
    out: Path,
    places: tuple[Path, ...],
    left: str,
    right: str,
    forward: str | None,
    yes: bool,
    no_walk: bool,
    quiet: bool,
    changes: tuple[str, ...],
) -> int:
    """Make a configuration that walks of a robot description, URDF or xacro."""
    from dqwalk_ros import adopt as adopting
    from dqwalk_ros.adopt.picture import draw
    from dqwalk_ros.adopt.trial import first_walks
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.errors import ConfigError

    if bool(left) != bool(right):
        raise ConfigError("--left and --right are given together")
    given = dict(parse_overrides(changes))
    found = adopting.adopt(
        urdf, out, package_paths=places, left=left, right=right, forward=forward or "", changes=given
    )
    if not quiet:
        for repair in found.repairs:
            print(f"repaired: {repair}")
        print(adopting.table(found))
    unsure = [e.what for e in found.anatomy.evidence if e.what == "ahead" and e.confidence == "guess"]
    if unsure and not yes:
        click.confirm("which way is ahead is a guess (see the table); go on?", abort=True)
    draw(found.config, found.model, out / "robot.png")
    for finding in found.findings:
        print(f"check: {finding}")
    if no_walk:
        return 1 if found.findings else 0
    last = None
    with Progress(quiet=quiet) as bar:
        for result, cure in first_walks(found, given, lambda text: bar(0.0, text)):
            print(f"{result}" + (f" {'cured by' if result.stood else 'in spite of'}: {cure}" if cure else ""))
            last = result
    if last is None or not last.stood:
        print("no cure helped")
        return 1
    print(f"dqwalk simulate --config {out / 'robot.yaml'} --plant physics")
    return 0
