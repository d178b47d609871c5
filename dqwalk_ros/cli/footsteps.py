"""``dqwalk footsteps``: shows which steps the legs of a robot reach."""

from __future__ import annotations

import cmath
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import command, config_of, config_option, params_option, set_option
from dqwalk_ros.support.errors import ConfigError

if TYPE_CHECKING:
    from dqwalk_ros.paper.foot import Foot
    from dqwalk_ros.support.arrays import Array
    from dqwalk_ros.walks.footsteps import Footsteps

_LENGTHS = (-0.1, -0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075, 0.1)
_SIDES = (-0.06, -0.04, -0.02, -0.01, -0.005, 0.0, 0.005, 0.01, 0.02, 0.04, 0.06)
"""Requested steps of a robot whose pelvis is 0.4 m high [m]."""
_TURNS = (-30, -20, -15, -10, -5, 0, 5, 10, 15, 20, 30)
"""[deg]"""


@command("""
examples:
  dqwalk footsteps
  dqwalk footsteps --config my_biped.yaml --support right
""")
@config_option("poppy")
@click.option("--support", type=click.Choice(["left", "right"]), default="left", help="Support foot.")
@params_option
@set_option
def footsteps(config: str, support: str, params: tuple[Path, ...], changes: tuple[str, ...]) -> int:
    """Show which steps the legs of a robot can reach.

    A footprint is moved to the nearest one that can be reached with both soles flat and the centre of mass over either
    of them. The table shows the result for steps ahead, to the side and with a turn.
    """
    import numpy as np

    from dqwalk_ros.paper.foot import Foot
    from dqwalk_ros.paper.kinematics import Kinematics
    from dqwalk_ros.robot.model import load_model
    from dqwalk_ros.support.text_table import aligned
    from dqwalk_ros.walks.standing.walk import StandingWalk
    from dqwalk_ros.walks.table import style_of

    made, foot = config_of(config, changes, params=params), Foot(support)
    if style_of(made) != "standing":
        raise ConfigError(f"footsteps need a standing walk; gait.style of '{config}' is {made.gait.style}")
    model = load_model(made.robot)
    height = float(Kinematics(model, np.zeros(model.n), foot).point(made.robot.pelvis)[2])
    scale = float(f"{height / 0.4:.1g}")  # one digit, so that the steps are round numbers
    asked = {
        "ahead [mm]": [(scale * x, 0.0, 0.0) for x in _LENGTHS],
        "to the left [mm]": [(0.0, scale * y, 0.0) for y in _SIDES],
        "turn, to the left [deg]": [(0.0, 0.0, math.radians(a)) for a in _TURNS],
    }
    steps = StandingWalk(made, model).footsteps
    print(f"{model.name} on its {foot.value} foot: reachable footprints, both soles flat, the CoM over either sole\n")
    for name, wanted in asked.items():
        rows = []
        for one in wanted:
            ahead, left, turn, off, angle = reached(steps, foot, *one)
            value = math.degrees(one[2]) if "turn" in name else 1e3 * (one[0] or one[1])
            numbers = 1e3 * ahead, 1e3 * left, math.degrees(turn), 1e3 * off, math.degrees(angle)
            rows.append([f"{value:g}", *(f"{number:z.1f}" for number in numbers)])
        head = (name, "reached: ahead [mm]", "to the left [mm]", "turn [deg]", "off by [mm]", "[deg]")
        print(aligned(rows, head, right=range(len(head))) + "\n")
    return 0


def reached(steps: Footsteps, support: Foot, length: float, side: float, turn: float) -> Array:
    """Return the reachable step nearest to a requested one, shape (5,).

    It is the motion of the body ahead, to the left and in yaw, and the distance of the footprint from the requested one
    [m, m, rad, m, rad].
    """
    import numpy as np

    from dqwalk_ros.walks.footprint import Footprint

    begin, wanted = steps.stride(support, 0.0, 0.0, 0.0), steps.stride(support, length, side, turn)
    found = Footprint.of(steps.step(support, length, side, turn))
    moved, angle = found.place - begin.place, abs(cmath.phase(found.ahead / wanted.ahead))
    return np.array([moved.real, moved.imag, cmath.phase(found.ahead), abs(found.place - wanted.place), angle])
