"""Renders a walk as a movie or as a strip of pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.arrays import Array
from dqwalk_ros.report.metrics import pelvis_in_odom
from dqwalk_ros.simulation import Trace

__all__ = ["frames", "save_movie", "save_strip"]

Image = NDArray[np.uint8]
Progress = Callable[[float, str], None]
"""Called with the fraction done and a line of text."""
_MOVIE, _STRIP = (360, 400), (240, 400)
"""Width and height of the pictures of a movie and of a strip [pixels]."""


def frames(trace: Trace, times: Array, width: int, height: int, progress: Progress | None = None) -> Iterator[Image]:
    """Yield a picture of the robot at each time [s], with the time and the phase written on it.

    The pose of the pelvis is the true one for walks in physics, else that of odometry.

    Raises
    ------
    PlantError
        If MuJoCo cannot render on this machine.
    """
    from dqwalk_ros.report.camera import Camera

    pelvis = pelvis_in_odom(trace) if trace.physics is None else trace.physics.pelvis
    known = np.flatnonzero(np.isfinite(pelvis).all(axis=1))
    starts = np.array([record.time for record in trace.phases])
    with Camera(trace.config, trace.model, width, height) as camera:
        for k, time in enumerate(times):
            tick = known[min(int(np.searchsorted(trace.time[known], time)), len(known) - 1)]
            picture = camera.picture(trace.q[tick], pelvis[tick])
            record = trace.phases[max(int(np.searchsorted(starts, trace.time[tick], side="right")) - 1, 0)]
            yield _labelled(picture, f"{trace.time[tick]:.1f} s", record.name.replace("_", " "))
            if progress is not None:
                progress((k + 1) / len(times), f"{k + 1} of {len(times)} pictures")


def save_movie(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    speed: float = 2.0,
    rate: float = 12.5,
    progress: Progress | None = None,
) -> None:
    """Write the walk as an animated picture, a .gif or a .webp.

    The speed is relative to real time, the rate in pictures per second.
    """
    from PIL import Image as pillow

    times = np.arange(trace.time[0], trace.time[-1] + 1e-9, speed / rate)
    made = [pillow.fromarray(one) for one in frames(trace, times, *_MOVIE, progress)]
    options: dict[str, Any] = {"quality": 70, "method": 4}
    if Path(path).suffix.lower() == ".gif":
        palette = made[len(made) // 2].quantize(64)
        made = [one.quantize(palette=palette, dither=pillow.Dither.NONE) for one in made]
        options = {"optimize": True}
    made[0].save(path, save_all=True, append_images=made[1:], duration=round(1e3 / rate), loop=0, **options)


def save_strip(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    count: int = 8,
    between: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> None:
    """Write some pictures of the walk side by side, evenly spread over it, or `between` two times [s]."""
    from PIL import Image as pillow

    first, last = between or (float(trace.time[0]), float(trace.time[-1]))
    gap = np.full((_STRIP[1], 4, 3), 255, dtype=np.uint8)
    made = frames(trace, np.linspace(first, last, count), *_STRIP, progress)
    row = [part for one in made for part in (one, gap)][:-1]
    pillow.fromarray(np.concatenate(row, axis=1)).quantize(128).save(path, optimize=True)


def _labelled(picture: Image, *lines: str) -> Image:
    from PIL import Image as pillow
    from PIL import ImageDraw, ImageFont

    image = pillow.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(13)
    for k, line in enumerate(lines):
        draw.text((8, 6 + 17 * k), line, fill=(36, 41, 47), font=font)
    return np.asarray(image)
