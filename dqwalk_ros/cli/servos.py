"""``dqwalk servos``: which servo a biped needs, and what its own allow."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import command, config_of, params_option, quiet_option, set_option
from dqwalk_ros.support.errors import ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.studies.servo_choice import Choice, Most


@command("""
columns:
  one for each joint of a leg: the largest speed [m/s] that its torque-speed curve allows by the best of several step
            durations and heights of the CoM, if all other joints are strong enough; > where the reach of the legs ends
            first, < where less was not tried
  all       the largest speed that all joints allow with the same step, and the limiting joint
  height    largest height of a step [mm], and slope [deg], at the step length and duration of ROBOT
  push      largest push ahead [N s] that recovery steps of such lengths catch
  rms       largest RMS torque of a joint at the speed of ROBOT, as a part of its stall torque: above about 0.2
            small servos get hot

The model has no lag, no backlash and no errors: keep a reserve. Every type has the voltage of its row, and
the robot keeps its mass. `config/servos.yaml` has the data of the types with their sources.

examples:
  dqwalk adopt my_robot.urdf && dqwalk servos adopted
  dqwalk servos poppy_dynamic --type MX-28 --type XM430-W350
  dqwalk servos adopted/dynamic.yaml --set gait.step_length=0.08
""")
@click.argument("robot", metavar="ROBOT", default="poppy_dynamic")
@click.option("--type", "names", metavar="TYPE", multiple=True, help="Only this type; may be repeated.")
@quiet_option
@params_option
@set_option
def servos(robot: str, names: tuple[str, ...], quiet: bool, params: tuple[Path, ...], changes: tuple[str, ...]) -> int:
    """Show how fast a biped can walk with its servos, or others.

    ROBOT is the configuration of a dynamic walk, or a folder that `dqwalk adopt` has written.
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.robot.model import load_model
    from dqwalk_ros.robot.servos import load_types
    from dqwalk_ros.studies.servo_choice import Gait, choose
    from dqwalk_ros.support.text_table import aligned

    file = str(Path(robot) / "dynamic.yaml") if Path(robot).is_dir() else robot
    config = config_of(file, changes, params=params)
    model, types = load_model(config.robot), load_types(config.servo.table)
    if unknown := set(names) - set(types):
        raise ConfigError(f"--type {min(unknown)}: the types are {', '.join(types)}")
    wanted = {name: kind for name, kind in types.items() if not names or name in names}
    with Progress(quiet=quiet) as bar:
        found = choose(config, model, wanted, bar)
    gait = Gait.of(config)
    print(
        f"{model.name}: {model.mass:.3g} kg, steps of {gait.duration:.3g} s and {1e3 * gait.height:.0f} mm height, "
        f"{gait.speed:.3g} m/s; of each joint the largest speed [m/s] (--help explains the columns)\n"
    )
    joints = list(found[0].joints)
    head = ["servo", "V", *joints, "all", "binds", "height [mm]", "slope [deg]", "push [N s]", "rms"]
    print(aligned([_row(one) for one in found], head, right=[k for k in range(1, len(head)) if head[k] != "binds"]))
    return 0


def _row(one: Choice) -> list[str]:
    return [
        one.name, f"{one.voltage:g}" if one.voltage else "",
        *(_text(most, 1.0, 2) for most in one.joints.values()),
        _text(one.speed, 1.0, 2), one.speed.joint or "reach",
        _text(one.height, 1e3, 0), _text(one.slope, math.degrees(1.0), 0), f"{one.push:.2f}", f"{one.warm:.2f}",
    ]  # fmt: skip


def _text(most: Most, factor: float, digits: int) -> str:
    return f"{most.sign}{factor * most.value:.{digits}f}"
