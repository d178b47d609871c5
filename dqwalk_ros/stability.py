"""What a robot on position servos needs to stand, by its mass and its height: stiffness, damping, a short delay.

Each is one formula, for `dqwalk config --check` before a walk and for the cause of a fall after it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import Foot, RobotModel
from dqwalk_ros.servos import Drive, Servos
from dqwalk_ros.statics import GRAVITY

__all__ = [
    "Finding",
    "damping_ratio",
    "divergent_component",
    "leg_inertia",
    "longest_delay",
    "pendulum_stiffness",
    "servo_findings",
]

Array = NDArray[np.float64]

STIFFNESS = 3.0
"""Least stiffness of the servos [m g h]."""
DAMPING = 0.3
"""Least damping ratio of a leg that swings."""


@dataclass(frozen=True)
class Finding:
    """Something that makes a robot fall.

    Attributes
    ----------
    message : str
        A sentence with its number.
    parameter : str
        What to change; empty where that is not known.
    what : str
        In one word, such as ``stiffness``.
    time : float
        From when on [s].
    """

    message: str
    parameter: str
    what: str = ""
    time: float = 0.0

    def __str__(self) -> str:
        return f"{self.message} ({self.parameter})" if self.parameter else self.message


def pendulum_stiffness(config: Config, model: RobotModel, kin: Kinematics) -> float:
    """Return m g h, the torque per angle with which gravity tips a robot about its ankles [N m/rad]."""
    return config.physics.mass_scale * model.mass * GRAVITY * float(kin.com[2])


def leg_inertia(model: RobotModel, kin: Kinematics) -> float:
    """Return the inertia of the right leg about its first joint, its bodies taken for points [kg m^2]."""
    left, right = (_way(model, model.frames[model.soles[foot].frame].body) for foot in Foot)
    leg = [body for body in right if body not in left]
    first: dict[int, str] = {}
    for name, frame in model.frames.items():
        first.setdefault(frame.body, name)

    def place(body: int) -> DQ:
        return DQ(kin.pose(first[body])) * DQ(model.frames[first[body]].pose).conj()

    hip = place(leg[0]).translation()
    levers = [place(body).transform_point(model.bodies[body].com) - hip for body in leg]
    total = sum(model.bodies[body].mass * float(x**2 + z**2) for body, (x, _, z) in zip(leg, levers, strict=True))
    return max(total, 1e-6)


def _way(model: RobotModel, body: int) -> list[int]:
    """Return the bodies from the root to `body`."""
    out = []
    while body > 0:
        out.append(body)
        body = model.bodies[body].parent
    return out[::-1]


def divergent_component(c: Array, v: Array, height: Array) -> Array:
    """Return xi = c + v/w with w^2 = g/h, the divergent component of motion of a linear inverted pendulum.

    A robot that puts its centre of pressure there comes to rest over it, so it is also called the capture point.

    Parameters
    ----------
    c, v : ndarray, shape (..., 2)
        Centre of mass on the ground and its velocity [m, m/s].
    height : ndarray, shape (..., 1)
        h, of the centre of mass over the ground [m].
    """
    return c + v * np.sqrt(height / GRAVITY)


def damping_ratio(damping: float, stiffness: float, inertia: float) -> float:
    """Return that of a leg which swings on a servo; its damping is a part of its stiffness [s, N m/rad, kg m^2]."""
    return 0.5 * damping * math.sqrt(stiffness / inertia)


def longest_delay(gain: float, height: float) -> float:
    """Return the delay [s] up to which feedback of the divergent component keeps an inverted pendulum upright.

    With the gain k and w^2 = g/h its closed loop is xi' = w xi - w (1 + k) xi(t - T), which is stable up to

        T = acos(1/(1 + k)) / (w sqrt((1 + k)^2 - 1))
    """
    k = 1.0 + max(gain, 1e-3)
    return math.acos(1.0 / k) / (math.sqrt(GRAVITY / height) * math.sqrt(k * k - 1.0))


def servo_findings(config: Config, model: RobotModel) -> Iterator[Finding]:
    """Yield what is wrong with the servos of a walk that stands: stiffness and damping."""
    kin = Kinematics(model, model.posture(config.standing.posture), Foot.LEFT)
    servos, drive = Servos.of(config, model), Drive.of(config, model)
    stiffness = float(np.median(servos.stiffness))
    mgh = pendulum_stiffness(config, model, kin)
    if stiffness < STIFFNESS * mgh:
        told = float(np.median(drive.stiffness))
        wrong = f", told {told:.3g}," if abs(told - stiffness) > 0.1 * stiffness else ""
        yield Finding(
            f"a stiffness of {stiffness:.3g} N m/rad{wrong} is {stiffness / mgh:.2g} m g h, and a robot stands from "
            f"{STIFFNESS:g} m g h = {STIFFNESS * mgh:.3g} N m/rad on, better 5",
            "servo.stiffness, servo.assumed_stiffness" if wrong else "servo.stiffness",
            "stiffness",
        )
    inertia = leg_inertia(model, kin) + float(np.median(servos.armature))
    damping = float(np.median((servos.damping + servos.back_emf) / servos.stiffness))
    fed = float(np.median(drive.angles(drive.damping)))
    # damping that is fed forward damps as far as it is that of the servos: beyond that it makes robots fall
    ratio = damping_ratio(damping + min(fed, damping), stiffness, inertia)
    if ratio < DAMPING:
        more = f"; {fed:.2g} s are fed forward as if they had it" if fed > damping else ""
        yield Finding(
            f"the damping ratio of a swinging leg is {ratio:.2f}, and it should be above {DAMPING}: a damping of "
            f"{math.sqrt(inertia / stiffness):.2g} s makes it 0.5{more}",
            "servo.damping, servo.assumed_damping" if more else "servo.damping",
            "damping",
        )
