"""``dqwalk movie``: renders a recorded walk as a movie or as a strip of pictures."""

from __future__ import annotations

import os
from pathlib import Path

import click

from dqwalk_ros.cli.options import (
    Numbers,
    Place,
    Real,
    bag_argument,
    command,
    force_option,
    namespace_option,
    quiet_option,
    walk_option,
)
from dqwalk_ros.support.errors import ConfigError, PlantError
from dqwalk_ros.support.output import make_folder, refuse_existing, refuse_inside


@command("""
examples:
  dqwalk movie walk/bag --out walk.gif --speed 4
  dqwalk movie walk/bag --out strip.png --strip 9 --between 20,120
""")
@bag_argument
@namespace_option
@walk_option
@click.option(
    "--out",
    metavar="FILE",
    type=Place(written=True),
    default="walk.gif",
    help=".gif, .webp, or .png for a strip.",
)
@click.option(
    "--speed", metavar="X", type=Real(0.01, 1e3), default=2.0, help="Speed of the movie, relative to real time."
)
@click.option("--rate", metavar="HZ", type=Real(0.01, 100.0), default=12.5, help="Pictures per second of the movie.")
@click.option("--strip", metavar="N", type=click.IntRange(1, 100), default=8, help="Pictures of a strip.")
@click.option("--between", metavar="A,B", type=Numbers(2), help="First and last time of a strip [s]; default: all.")
@force_option
@quiet_option
def movie(
    bag: Path,
    namespace: str | None,
    walk: str,
    out: Path,
    speed: float,
    rate: float,
    strip: int,
    between: tuple[float, float] | None,
    force: bool,
    quiet: bool,
) -> int:
    """Draw a recorded walk as a movie or a strip of pictures.

    MuJoCo draws the robot with the visual shapes of its URDF; without a display it uses EGL, or what MUJOCO_GL says
    (osmesa). Bags of walks in physics contain the true pose of the pelvis; for others it is that of odometry.
    Needs MuJoCo: pip install mujoco
    """
    if out.suffix.lower() not in (".gif", ".webp", ".png"):
        raise ConfigError(f"--out needs a .gif, a .webp, or a .png for a strip, not '{out}'")
    if between is not None and not between[0] < between[1]:
        raise ConfigError(f"--between needs two times in their order, not {between[0]:g},{between[1]:g}")
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo is imported
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.report import bag as bags

    try:
        from dqwalk_ros.report.movie import save_movie, save_strip
    except ModuleNotFoundError:
        raise
    except Exception as error:  # MuJoCo loads the library of MUJOCO_GL when it is imported
        platform = os.environ.get("MUJOCO_GL", "")
        raise PlantError(
            f"nothing can be drawn with MUJOCO_GL={platform}: {error}; install its library, or try egl"
        ) from error
    refuse_inside(bag, out)
    if not force:
        refuse_existing([out])
    make_folder(out.parent)
    trace = bags.read(bag, namespace=namespace, walk=walk)
    with Progress(quiet=quiet) as bar:
        if out.suffix.lower() == ".png":
            save_strip(trace, out, count=strip, between=between, progress=bar, overwrite=force)
        else:
            save_movie(trace, out, speed=speed, rate=rate, progress=bar, overwrite=force)
    print(f"wrote {out}")
    return 0
