"""A walk with a user-defined constraint: the centre of mass stays above a height in double support."""

import dataclasses

import numpy as np

from dqwalk_ros import KinematicPlant, VelocityController, load, load_model, simulate
from dqwalk_ros.paper.constraints import Constraint
from dqwalk_ros.paper.features import CenterOfMass
from dqwalk_ros.paper.walk import PaperWalk
from dqwalk_ros.support.compiled import jit


@jit
def height_above(s, least, elapsed):  # s: the coordinates of what is watched, here p_CoM (3,)
    """Distance (1,), its gradient (1, 3), and the rate at which it changes by time alone."""
    return s[2:] - least, np.array([[0.0, 0.0, 1.0]]), np.zeros(1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComAbove(Constraint):
    """The centre of mass stays above a height [m]."""

    height: float
    watches = (CenterOfMass(),)
    function = height_above

    @property
    def parameters(self):
        return np.array([self.height])


class HighWalk(PaperWalk):
    """The paper's walk with one more inequality in double support."""

    def both_feet(self, kind, support, kin):
        phase = super().both_feet(kind, support, kin)
        high = ComAbove(name="com_above", eta=5.0, height=0.27)
        return dataclasses.replace(phase, inequalities=(*phase.inequalities, high))


config = load("paper")  # by configuration: gait.walk: "own_constraint:HighWalk"
model = load_model(config.robot)
controller = VelocityController(config, model, HighWalk)
trace = simulate(controller, KinematicPlant(model), max_time=1.0)
print(f"{len(trace)} states; rows: {', '.join(controller.problem.names[:9])}")
