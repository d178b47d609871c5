"""A user-defined walk as in docs/tutorial.md, in a module that ``gait.walk`` names."""

from __future__ import annotations

import dataclasses

import numpy as np

from dqwalk_ros.paper.collisions import AxisInCone, PointOutsideSphere
from dqwalk_ros.paper.constraints import Constraint, Look, Region
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMass, Direction
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Z
from dqwalk_ros.paper.phase import Next, PhaseKind
from dqwalk_ros.paper.walk import PaperWalk
from dqwalk_ros.support.compiled import jit


@jit
def above(s, a, elapsed):
    return s[2:] - a, np.array([[0.0, 0.0, 1.0]]), np.zeros(1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComAbove(Constraint):
    """The centre of mass stays above a height [m]."""

    height: float
    watches = (CenterOfMass(),)
    function = above

    @property
    def parameters(self):
        return np.array([self.height])

    def region(self, kin):
        return Region("plane", DQ.from_pose([0.0, 0.0, self.height]).vec8(), (0.3, 0.2))


class HighWalk(PaperWalk):
    """The paper's walk, with the centre of mass held high in double support."""

    def both_feet(self, kind, support, kin):
        phase = super().both_feet(kind, support, kin)
        look = Look("CoM over the table", (1, 2, 3))
        high = ComAbove(name="com_above", eta=5.0, height=0.25, look=look)
        return dataclasses.replace(phase, inequalities=(*phase.inequalities, high))


class AroundABall(PaperWalk):
    """The paper's walk, whose CoM is to stay out of a ball that rolls past, and whose trunk is to stay upright."""

    def both_feet(self, kind, support, kin):
        phase = super().both_feet(kind, support, kin)
        ball = {"center": np.array([0.3, 0.0, 0.3]), "velocity": np.array([-0.1, 0.0, 0.0]), "radius": 0.1}
        out = PointOutsideSphere(name="ball", eta=5.0, point=CenterOfMass(), **ball)
        upright = AxisInCone(name="lean", eta=5.0, axis=Direction("pelvis", Z), center=Z, angle=0.2)
        return dataclasses.replace(phase, inequalities=(*phase.inequalities, out, upright))


@dataclasses.dataclass(frozen=True)
class Lasts:
    """Ends a phase after some time [s]."""

    duration: float

    def is_over(self, error, elapsed):
        return elapsed >= self.duration


class StandingFirst(PaperWalk):
    """The paper's walk, which begins with a short stance."""

    def following(self, phase, kin):
        return Next(PhaseKind.STANCE, Foot.LEFT) if phase is None else super().following(phase, kin)

    def both_feet(self, kind, support, kin):
        phase = super().both_feet(kind, support, kin)
        stance = kind is PhaseKind.STANCE
        return dataclasses.replace(phase, kind=kind, rule=Lasts(0.1)) if stance else phase
