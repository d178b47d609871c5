"""``dqwalk replay``: compares a simulated robot with identified servos with the recording of an exercise."""

from __future__ import annotations

import math
from pathlib import Path

from dqwalk_ros.cli.options import bag_argument, beside, command, params_option, quiet_option

_MOST = 1.5
"""Largest rms error of a joint [deg]."""


@command("""
Simulates the commands of the exercise in MuJoCo with the servos of --params, and prints the errors of the joints; by
default with those of identified.yaml beside the bag, or, without this file, with those of the exercise's configuration.
Exit code 1 if the rms error of a joint is larger than 1.5 degrees.

examples:
  dqwalk replay exercise/bag
  dqwalk replay exercise/bag --params mine.yaml
""")
@bag_argument
@params_option
@quiet_option
def replay(bag: Path, params: tuple[Path, ...], quiet: bool) -> int:
    """Compare a simulated robot with a recorded exercise."""
    import numpy as np

    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.config import with_files
    from dqwalk_ros.identification.replay import replay as run
    from dqwalk_ros.report.bag import read
    from dqwalk_ros.support.text_table import aligned

    trace = read(bag)
    identified = beside(bag, "identified.yaml")
    files = params or ((identified,) if identified.is_file() else ())
    config = with_files(trace.config, files)
    with Progress(quiet=quiet) as bar:
        q = run(trace, config, bar)
    rms = np.degrees(np.sqrt(np.mean((q - trace.q) ** 2, axis=0)))
    if not quiet:
        print(f"servos: {', '.join(map(str, files)) or 'as the exercise was configured'}")
        rows = [[name, f"{error:.3f}"] for name, error in zip(trace.model.joint_names, rms, strict=True)]
        print(aligned(rows, ["joint", "rms error\n[deg]"], right=(1,)))
    worst = int(np.argmax(rms))
    mean = math.sqrt(float(np.mean(rms**2)))
    print(f"rms error: {mean:.3f} degrees; largest: {trace.model.joint_names[worst]}, {rms[worst]:.3f} degrees")
    return 1 if rms[worst] > _MOST else 0
