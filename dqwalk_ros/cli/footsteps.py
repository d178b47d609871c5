"""``dqwalk footsteps``: which steps the legs of a robot reach."""

from __future__ import annotations

import argparse
import math

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.cli.settings import config_of
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.kinematics import pose_difference
from dqwalk_ros.model import Foot, load_model
from dqwalk_ros.standing.footsteps import Footsteps

__all__ = ["reached", "run"]

_ASKED = {
    "ahead [mm]": [(0.001 * x, 0.0, 0.0) for x in (-100, -75, -50, -25, 0, 25, 50, 75, 100)],
    "aside, to the left [mm]": [(0.0, 0.001 * y, 0.0) for y in (-60, -40, -20, -10, -5, 0, 5, 10, 20, 40, 60)],
    "turn, to the left [deg]": [(0.0, 0.0, math.radians(a)) for a in (-30, -20, -15, -10, -5, 0, 5, 10, 15, 20, 30)],
}


def run(args: argparse.Namespace) -> int:
    """Do it and return the exit code."""
    config = config_of(args)
    if config.gait.style != "standing":
        raise ConfigError(f"footsteps are those of a standing walk; gait.style of '{args.config}' is not standing")
    model = load_model(config.robot)
    steps = Footsteps(config, model)
    support = Foot(args.support)
    print(f"{model.name} on its {support.value} foot: where the other one can stand, both flat, the CoM over either\n")
    for name, asked in _ASKED.items():
        print(f"{name:>26s}   reached: ahead [mm]  aside [mm]  turn [deg]   off by [mm]  [deg]")
        for one in asked:
            ahead, aside, turn, off, angle = reached(steps, support, *one)
            value = math.degrees(one[2]) if "turn" in name else 1e3 * (one[0] or one[1])
            print(
                f"{value:26.0f} {1e3 * ahead:21.1f} {1e3 * aside:11.1f} {math.degrees(turn):11.1f}"
                f" {1e3 * off:13.1f} {math.degrees(angle):6.1f}"
            )
        print()
    return 0


def reached(steps: Footsteps, support: Foot, length: float, side: float, turn: float) -> NDArray[np.float64]:
    """Return what a step that is asked for comes to.

    Returns
    -------
    ndarray, shape (5,)
        How far the body moves ahead, aside, and turns, and how far the footprint is from the one that was asked for
        [m, m, rad, m, rad].
    """
    x = steps.step(support, length, side, turn)
    moved = DQ(steps.wanted(support, 0.0, 0.0, 0.0)).translation()
    d = pose_difference(x, steps.wanted(support, length, side, turn))
    p, ahead = DQ(x).translation() - moved, DQ(x).rotation_matrix()[:, 0]
    return np.array([p[0], p[1], math.atan2(ahead[1], ahead[0]), math.hypot(d[0], d[1]), abs(d[5])])
