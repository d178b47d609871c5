"""One tick of the controller by hand: a state, the phase, its quadratic program, its solution."""

import numpy as np

from dqwalk_ros.config import load
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.walks.table import make_walk

config = load("paper")  # section 5 of the paper
model = load_model(config.robot)
q = np.zeros(model.n)  # a measured state [rad]

# the double support that brings the CoM over the left foot; its world is the sole of the right one
phase = make_walk(config, model).phase(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT, q)
now = phase.evaluate(q, dt=config.dt, velocity=model.velocity_max)
problem = now.problem  # (U6)
solution = make_solver("clarabel").solve(problem)

print(f"{phase.name}: error {now.error:.4f} m")
for name, distance in now.distances().items():
    print(f"  {name:12s} {distance: .4f}")
for name, speed in zip(model.joint_names, solution.u, strict=True):
    print(f"  {name:12s} {speed: .5f} rad/s")
print(f"largest KKT residual {solution.residuals(problem).largest:.1e}")
