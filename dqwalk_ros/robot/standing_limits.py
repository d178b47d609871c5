"""Requirements on stiffness, damping and delay of the position servos of a standing robot.

They depend on the mass and the height of the robot; `dqwalk config --check` uses them before a walk, and
`report.causes` after a fall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Drive, Servos
from dqwalk_ros.support.arrays import Array

STIFFNESS = 3.0
"""Least stiffness of the servos, as a multiple of m g h."""
DAMPING = 0.3
"""Least damping ratio of a swinging leg."""


@dataclass(frozen=True)
class Finding:
    """A problem of a configuration, or a cause of a fall."""

    message: str
    """A sentence with the measured value."""
    parameter: str
    """Parameters to change; empty if unknown."""
    what: str = ""
    """Kind of the problem in one word, such as ``stiffness``."""
    time: float = 0.0
    """Time from which on it acted [s]."""

    def __str__(self) -> str:
        return f"{self.message} ({self.parameter})" if self.parameter else self.message


def leg_inertia(model: RobotModel, kin: Kinematics) -> float:
    """Return the inertia of the right leg about its first joint, with its bodies as point masses [kg m^2]."""
    left, right = (model.chain(model.frames[model.soles[foot].frame].body) for foot in Foot)
    leg = [body for body in right if body not in left]
    hip = kin.point(model.links[leg[0]])
    levers = [kin.point(model.links[body], model.bodies[body].com) - hip for body in leg]
    total = sum(model.bodies[body].mass * float(x**2 + z**2) for body, (x, _, z) in zip(leg, levers, strict=True))
    return max(total, 1e-6)


def divergent_component(c: Array, v: Array, height: Array) -> Array:
    """Return xi = c + v/w with w^2 = g/h, the divergent component of motion of a linear inverted pendulum.

    A robot whose centre of pressure is at xi comes to rest above it, so xi is also called the capture point.

    Parameters
    ----------
    c, v : ndarray, shape (..., 2)
        Centre of mass on the ground and its velocity [m, m/s].
    height : ndarray, shape (..., 1)
        Height h of the centre of mass above the ground [m].

    Returns
    -------
    ndarray, shape (..., 2)
        xi [m].
    """
    return c + v * np.sqrt(height / GRAVITY)


def longest_delay(gain: float, height: float) -> float:
    """Return the longest delay T [s] for which feedback of the divergent component stabilizes an inverted pendulum.

    With the gain k and w^2 = g/h the closed loop is xi' = w xi - w (1 + k) xi(t - T), which is stable up to

        T = acos(1/(1 + k)) / (w sqrt((1 + k)^2 - 1))

    Parameters
    ----------
    gain : float
        k.
    height : float
        Height h of the centre of mass [m].
    """
    k = 1.0 + max(gain, 1e-3)
    return math.acos(1.0 / k) / (math.sqrt(GRAVITY / height) * math.sqrt(k * k - 1.0))


def servo_findings(config: Config, model: RobotModel) -> Iterator[Finding]:
    """Yield problems of the stiffness and the damping of the servos of a standing walk.

    Yields
    ------
    Finding
        ``stiffness`` below 3 m g h, or ``damping`` ratio of a swinging leg below 0.3.
    """
    kin = Kinematics(model, model.posture(config.standing.posture), Foot.LEFT)
    servos, drive = Servos.of(config, model), Drive.of(config, model)
    stiffness = float(np.median(servos.stiffness))
    # gravitational torque about the ankles per angle of inclination [N m/rad]
    mgh = config.physics.mass_scale * model.mass * GRAVITY * float(kin.com[2])
    if stiffness < STIFFNESS * mgh:
        assumed = float(np.median(drive.stiffness))
        wrong = f" (assumed: {assumed:.3g})" if abs(assumed - stiffness) > 0.1 * stiffness else ""
        yield Finding(
            f"a stiffness of {stiffness:.3g} N m/rad{wrong} is {stiffness / mgh:.2g} m g h; below "
            f"{STIFFNESS:g} m g h = {STIFFNESS * mgh:.3g} N m/rad most robots fall, 5 m g h are better",
            "servo.stiffness, servo.assumed_stiffness" if wrong else "servo.stiffness",
            "stiffness",
        )
    inertia = leg_inertia(model, kin) + float(np.median(servos.armature))
    damping = float(np.median((servos.damping + servos.back_emf) / servos.stiffness))
    fed = float(np.median(drive.angles(drive.damping)))
    # fed-back damping is effective only up to the damping of the servos; more of it makes robots fall
    ratio = 0.5 * (damping + min(fed, damping)) * math.sqrt(stiffness / inertia)
    if ratio < DAMPING:
        more = f"; the assumed damping of {fed:.2g} s is larger than that of the servos" if fed > damping else ""
        yield Finding(
            f"the damping ratio of a swinging leg is {ratio:.2f} and should be above {DAMPING}: a damping of "
            f"{math.sqrt(inertia / stiffness):.2g} s gives a ratio of 0.5{more}",
            "servo.damping, servo.assumed_damping" if more else "servo.damping",
            "damping",
        )
