"""``dqwalk identify``: estimates the parameters of the servos from a recorded exercise."""

from __future__ import annotations

import dataclasses
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import Place, Real, bag_argument, beside, command, force_option, quiet_option
from dqwalk_ros.support.output import refuse_existing, refuse_inside, write_text

if TYPE_CHECKING:
    from dqwalk_ros.identification.fit import Identified

_UNLIKE = 0.5
"""Rms error above which the motion is not that of a servo [deg]: replays of servos drawn at random are within 0.1."""


@command("""
prints of each servo, with standard deviations:
  delay [ms]           from a measurement to the effect of its command: bus, USB and servo
  stiffness [N m/rad], damping [ms] (torque per speed, divided by the stiffness), friction [N m]
  backlash [deg]       play between goal and joint within which there is no torque
  rms error [deg]      of the servo model
and roll and pitch of the inertial sensor's mounting. Torques are in proportion to the mass: weigh the robot (--mass).

examples:
  dqwalk identify exercise/bag
  dqwalk identify exercise/bag --mass 3.4 --out mine.yaml
  dqwalk simulate --config poppy --plant poppy_as_built --params mine.yaml      use the result
  ros2 run dqwalk_ros controller --ros-args --params-file config/poppy.yaml --params-file mine.yaml
then:
  dqwalk replay exercise/bag --params mine.yaml         compare a robot with these servos with the recording
""")
@bag_argument
@click.option(
    "--mass",
    metavar="KG",
    type=Real(0.01, 1e3),
    help="Mass of the robot, as weighed.  [default: that in the bag]",
)
@click.option(
    "--out",
    metavar="FILE",
    type=Place(dir_okay=False),
    help="Parameter file for the result.  [default: identified.yaml beside BAG]",
)
@force_option
@quiet_option
def identify(bag: Path, mass: float | None, out: Path | None, force: bool, quiet: bool) -> int:
    """Identify the servos of a robot from a recorded exercise."""
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.identification import fit
    from dqwalk_ros.report.bag import read, read_orientations
    from dqwalk_ros.robot.model import parse_model

    out = out or beside(bag, "identified.yaml")
    refuse_inside(bag, out)
    if not force:
        refuse_existing([out])
    trace = read(bag)
    mass = mass or trace.config.physics.mass_scale * trace.model.mass
    robot = dataclasses.replace(trace.config.robot, mass=mass)
    trace = dataclasses.replace(trace, model=parse_model(trace.model.urdf, robot))
    with Progress(quiet=quiet) as progress:
        found = fit.identify(trace, read_orientations(bag), progress=progress)
    write_text(out, fit.parameters(found, trace.config.dt, mass), overwrite=force)
    if not quiet:
        print(table(found))
        of, params = shlex.quote(str(bag)), shlex.join(["--params", str(out)])
        print(f"wrote {out}; dqwalk replay {of} {params} compares, dqwalk simulate {params} uses it")
    return 1 if found.missing or unexplained(found) else 0


def unexplained(found: Identified) -> list[str]:
    """Return the joints whose recorded motion the model of a servo does not explain."""
    off = {name: math.degrees(rms) for name, rms in zip(found.joints, found.rms, strict=True)}
    return [name for name in found.joints if name not in found.missing and off[name] > _UNLIKE]


def table(found: Identified) -> str:
    """Return the result as aligned text."""
    from dqwalk_ros.support.text_table import aligned

    unit = (1e3, 1.0, 1e3, 180.0 / math.pi, 1.0)
    digits = (1, 1, 1, 2, 3)
    head = [
        "joint",
        "delay\n[ms]",
        "stiffness\n[N m/rad]",
        "damping\n[ms]",
        "backlash\n[deg]",
        "friction\n[N m]",
        "rms error\n[deg]",
    ]
    rows = []
    for name, values, spread, rms in zip(found.joints, found.value, found.deviation, found.rms, strict=True):
        if name in found.missing:
            continue
        cells = [
            f"{k * value:.{n}f} ± {k * s:.{n}f}" for value, s, k, n in zip(values, spread, unit, digits, strict=True)
        ]
        rows.append([name, *cells, f"{math.degrees(rms):.3f}"])
    parts = [aligned(rows, head, right=range(1, len(head)))]
    if (m := found.mounting) is not None:
        roll, pitch = (math.degrees(angle) for angle in m.rpy[:2])
        parts.append(f"inertial sensor: roll {roll:+.2f}, pitch {pitch:+.2f} degrees, including its own error of the "
                     "vertical; yaw is not observable while the robot is level")  # fmt: skip
    parts += [f"NOT FOUND: {name}: {why}" for name, why in found.missing.items()]
    if unlike := unexplained(found):
        parts.append(
            f"NOT EXPLAINED: {', '.join(unlike)}: no servo moves like that, within {_UNLIKE:g} degrees (rms); was the "
            "pelvis clamped and level, did the limbs hang free, and is the mass right? poppy.dummy has no gravity"
        )
    return "\n\n".join(parts)
