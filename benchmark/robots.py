"""Made-up bipeds with any number of joints, and the states of a walk to time them on."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.qp import Problem, make_solver
from dqwalk_ros.robot import Foot, RobotModel, load_model
from dqwalk_ros.simulation import make_walk
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["KINDS", "Case", "biped", "biped_urdf", "case"]

KINDS = {"DSP": PhaseKind.DOUBLE_SUPPORT, "SSP": PhaseKind.SINGLE_SUPPORT}
_LEG = "zxyyyx"  # hip yaw, roll, pitch, knee, ankle pitch, roll; longer legs go on in this order
_LENGTH = 0.8
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def biped_urdf(joints_per_leg: int) -> str:
    """Return a pelvis and two legs of `joints_per_leg` joints, as URDF text."""
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    parts = [
        '<robot name="biped"><link name="pelvis"><inertial><origin xyz="0 0 0.1"/><mass value="8"/>'
        f"{inertia}</inertial></link>"
    ]
    step = _LENGTH / joints_per_leg
    for side, y in (("l", 0.09), ("r", -0.09)):
        parent = "pelvis"
        for i in range(joints_per_leg):
            link, axis = f"{side}_{i}", _LEG[i % len(_LEG)]
            origin = f"0 {y} 0" if i == 0 else f"0 0 {-step}"
            parts.append(
                f'<joint name="{side}_joint_{i}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="{origin}"/><axis xyz="{_AXES[axis]}"/>'
                '<limit lower="-1.5" upper="1.5" velocity="8" effort="50"/></joint>'
                f'<link name="{link}"><inertial><origin xyz="0 0 {-0.5 * step}"/><mass value="{12 / joints_per_leg}"/>'
                f"{inertia}</inertial></link>"
            )
            parent = link
        parts.append(
            f'<joint name="{side}_mount" type="fixed"><parent link="{parent}"/><child link="{side}_sole"/>'
            f'<origin xyz="0.02 0 {-step}"/></joint><link name="{side}_sole"/>'
        )
    return "".join([*parts, "</robot>"])


def biped(joints: int) -> tuple[Config, RobotModel]:
    """Return the configuration and the model of a biped with so many joints, an even number."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "biped.urdf"
        path.write_text(biped_urdf(joints // 2), encoding="utf-8")
        config = Config.from_flat(
            {
                "robot.urdf": str(path),
                "robot.sole_length": 0.2,
                "robot.sole_width": 0.1,
                "pelvis.height": 0.6,
                "task.eta": 0.5,
                "gait.step_length": 0.1,
                "ssp.com_radius": 0.06,
            }
        )
        return config, load_model(config.robot)


@dataclass(frozen=True)
class Case:
    """A phase of a robot, and configurations along it, each (n,)."""

    config: Config
    model: RobotModel
    phase: Phase
    states: tuple[np.ndarray, ...]

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return self.config.dt

    def problem(self, q: np.ndarray) -> Problem:
        """Return the quadratic program at a configuration."""
        at = self.phase.evaluate(Kinematics(self.model, q, self.phase.base))
        return at.problem(self.dt, np.full(self.model.n, np.inf))


def case(joints: int, kind: PhaseKind, ticks: int = 3000, kept: int = 150) -> Case:
    """Return `kept` states of a closed loop of `ticks` ticks."""
    config, model = biped(joints)
    # crouching: each leg bends at the pitch joints that make hip, knee and ankle, and the sole stays level
    q = np.zeros(model.n)
    for side in ("l", "r"):
        for i, angle in ((2, -0.2), (3, 0.4), (4, -0.2)):
            name = f"{side}_joint_{i}"
            if name in model.joint_names:
                q[model.joint_names.index(name)] = angle
    foot = Foot.LEFT
    target = make_walk(config, model).footstep(foot) if kind is PhaseKind.SINGLE_SUPPORT else None
    if kind is PhaseKind.SINGLE_SUPPORT:  # the cylinder of the support foot has to hold the CoM
        config = config.updated({"ssp.com_radius": 0.2})
    phase = make_walk(config, model).phase(kind, foot, q, target)
    of, solver, states = Case(config, model, phase, ()), make_solver("daqp"), []
    for tick in range(ticks):
        if tick % (ticks // kept) == 0:
            states.append(q)
        q = q + config.dt * solver.solve(of.problem(q)).u
    return replace(of, states=tuple(states))
