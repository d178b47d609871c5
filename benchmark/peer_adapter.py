"""One tick through the public API: a phase built by hand, kinematics, rows, the quadratic program, its solution.

`make_clarabel` and `make_daqp` take the robot as a serial chain and the numbers of its two phases (`benchmark.biped`,
or any object with the same attributes) and return u as a function of q, like the ticks of `benchmark.peers`.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmark.biped import Chain, Walk, chain_urdf
from dqwalk_ros.config import Config
from dqwalk_ros.paper.constraints import Constraint, JointMaximum, JointMinimum, PointInCylinder, PointOverPlane
from dqwalk_ros.paper.features import CenterOfMass, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import Cylinder, Line, Plane, Z
from dqwalk_ros.paper.phase import Phase, PhaseKind
from dqwalk_ros.paper.qp import make_solver
from dqwalk_ros.paper.tasks import ComOverFoot, FramePose, Task
from dqwalk_ros.robot.model import RobotModel, load_model

Array = np.ndarray


class Never:
    """A rule that never ends a phase."""

    def is_over(self, error: float, elapsed: float) -> bool:
        """Return False."""
        return False


def robot_of(chain: Chain) -> RobotModel:
    """Return the robot of a chain whose root is the left sole."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(chain_urdf(chain), encoding="utf-8")
        names = {"robot.urdf": str(path), "robot.left_sole": "base", "robot.right_sole": "tip"}
        return load_model(Config().updated({**names, "robot.sole_length": 0.1, "robot.sole_width": 0.06}).robot)


def phase_of(model: RobotModel, walk: Walk, phase: str) -> Phase:
    """Return the phase ``"dsp"`` or ``"ssp"`` of a walk, in the frame of the left sole."""
    com, tip = CenterOfMass(), Point("tip")
    pelvis = PointOverPlane(
        name="pelvis", eta=walk.eta_pelvis, point=Point("pelvis"), plane=Plane(Z, walk.pelvis_height)
    )

    def upright(center: Array, radius: float) -> Cylinder:
        return Cylinder(Line.through(center, Z), radius)

    if phase == "dsp":
        kind, target = PhaseKind.DOUBLE_SUPPORT, None
        task: Task = ComOverFoot(name="com", foot=Point("base", np.array([*walk.com_target, 0.0])))
        equalities: tuple[Constraint, ...] = (
            PointOverPlane(name="ground", eta=walk.eta_ground, point=tip, plane=Plane(Z, 0.0)),
        )
        inequalities: tuple[Constraint, ...] = (
            PointInCylinder(
                name="sliding",
                eta=walk.eta_sliding,
                point=tip,
                cylinder=upright(walk.slide_center, walk.slide_radius),
            ),
            PointOverPlane(name="tip_plane", eta=walk.eta_tip, point=com, plane=Plane(*walk.tip_plane)),
            PointOverPlane(name="back_plane", eta=walk.eta_back, point=com, plane=Plane(*walk.back_plane)),
            pelvis,
        )
    else:
        kind, target = PhaseKind.SINGLE_SUPPORT, walk.x_goal
        task = FramePose(name="swing", frame="tip", target=walk.x_goal)
        equalities = ()
        inequalities = (
            PointInCylinder(
                name="com_cylinder", eta=walk.eta_com, point=com, cylinder=upright(walk.com_center, walk.com_radius)
            ),
            pelvis,
        )
    return Phase(
        model=model,
        kind=kind,
        support=Foot.LEFT,
        base=Foot.LEFT,
        q_start=np.zeros(model.n),
        swing_target=target,
        eta=walk.eta,
        damping=walk.lam,
        tasks=(task,),
        equalities=equalities,
        inequalities=inequalities,
        limits=(
            JointMaximum(name="joint_max", eta=walk.eta_q, q_max=model.q_max),
            JointMinimum(name="joint_min", eta=walk.eta_q, q_min=model.q_min),
        ),
        rule=Never(),
    )


def make(solver: str) -> Callable[[Chain, Walk, str], Callable[[Array], Array]]:
    """Return a function that makes ticks with a solver."""

    def maker(chain: Chain, walk: Walk, phase: str) -> Callable[[Array], Array]:
        model = robot_of(chain)
        ours, kept = phase_of(model, walk, phase), make_solver(solver)
        to_model = np.array([chain.names.index(name) for name in model.joint_names])
        to_chain = np.argsort(to_model)
        no_limit = np.full(model.n, math.inf)

        def tick(q: Array) -> Array:
            at = ours.evaluate(q[to_model], Z, math.inf, walk.dt, no_limit)
            return kept.solve(at.problem).u[to_chain]

        return tick

    return maker


make_clarabel = make("clarabel")
make_daqp = make("daqp")
