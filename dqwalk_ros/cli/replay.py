"""``dqwalk replay``: a robot with identified servos beside the recording of an exercise."""

from __future__ import annotations

import math
from pathlib import Path

import click

from dqwalk_ros.cli.options import command, params_option, quiet_option

__all__ = ["replay"]

_MOST = 1.5
"""A joint that is further off than this does not move like the recording [deg]."""


@command("""
The commands of the exercise go to MuJoCo with the servos of --params; without it with those of identified.yaml beside
the bag, or, where there is none, with those that the exercise was configured with. Exit code 1: a joint is further
than 1.5 degrees (rms) from the recording.

examples:
  dqwalk replay exercise/bag
  dqwalk replay exercise/bag --params mine.yaml
""")
@click.argument("bag", metavar="BAG", type=click.Path(path_type=Path))
@params_option
@quiet_option
def replay(bag: Path, params: tuple[Path, ...], quiet: bool) -> int:
    """Run a robot with identified servos beside the recording of an exercise, and print how far its joints are off."""
    import numpy as np

    from dqwalk_ros.cli.options import put_on
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.identification.replay import replay as run
    from dqwalk_ros.report.bag import read
    from dqwalk_ros.report.table import aligned

    trace = read(bag)
    beside = bag.resolve().parent / "identified.yaml"
    files = params or ((beside,) if beside.is_file() else ())
    config = put_on(trace.config, files)
    with Progress(quiet=quiet) as bar:
        q = run(trace, config, bar)
    rms = np.degrees(np.sqrt(np.mean((q - trace.q) ** 2, axis=0)))
    if not quiet:
        print(f"servos: {', '.join(map(str, files)) or 'as the exercise was configured'}")
        rows = [[name, f"{off:.3f}"] for name, off in zip(trace.model.joint_names, rms, strict=True)]
        print(aligned(rows, ["joint", "off, rms\n[deg]"], right=(1,)))
    worst = int(np.argmax(rms))
    mean = math.sqrt(float(np.mean(rms**2)))
    print(f"all joints: {mean:.3f} degrees rms; most: {trace.model.joint_names[worst]}, {rms[worst]:.3f} degrees")
    return 1 if rms[worst] > _MOST else 0
