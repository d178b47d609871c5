"""A walk with a user-defined constraint: the centre of mass stays above a height in double support."""

import dataclasses

import numpy as np

from dqwalk_ros import KinematicPlant, VelocityController, load, load_model, simulate
from dqwalk_ros.paper.constraints import Constraint
from dqwalk_ros.paper.kinematics import CenterOfMass
from dqwalk_ros.paper.walk import PaperWalk


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComAbove(Constraint):
    """The centre of mass stays above a height [m]."""

    height: float
    watches = (CenterOfMass(),)

    def value(self, s):  # s: the coordinates of what is watched, here p_CoM (3,)
        return s[2] - self.height, np.array([0.0, 0.0, 1.0])


class HighWalk(PaperWalk):
    """The paper's walk with one more inequality in double support."""

    def both_feet(self, kind, support, q_start):
        phase = super().both_feet(kind, support, q_start)
        high = ComAbove(name="com_above", eta=5.0, height=0.27)
        return dataclasses.replace(phase, inequalities=(*phase.inequalities, high))


config = load("paper")  # by configuration: gait.walk: "own_constraint:HighWalk"
model = load_model(config.robot)
controller = VelocityController(config, model, HighWalk)
trace = simulate(controller, KinematicPlant(model), max_time=1.0)
print(f"{len(trace)} states; rows: {', '.join(controller.problem.names[:9])}")
