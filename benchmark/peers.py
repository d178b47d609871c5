"""The tick of a phase written with the packages one would use instead.

All solve the same quadratic program (6): their own kinematics, the rows in numpy as one writes them by hand, their
usual solver. The robot is handed over as the serial chain from the base sole to the other one.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.robots import Case
from dqwalk_ros.constraints import AxisLevel, PointInCylinder, PointInsideWall, PointOverPlane
from dqwalk_ros.dq import DQ
from dqwalk_ros.kinematics import rooted
from dqwalk_ros.tasks import ComOverFoot

__all__ = ["PEERS"]

Array = np.ndarray


@dataclass(frozen=True)
class Places:
    """What the rows of a phase are made of: the end sole, the pelvis and the CoM, and how they move."""

    R: Array  # (3, 3) of the end sole
    p: Array  # (3,)
    J_p: Array  # (3, n), of its origin
    J_w: Array  # (3, n), its angular velocity
    pelvis: Array
    J_pelvis: Array
    com: Array
    J_com: Array
    x: Array | None = None  # (8,) and (8, n), in single support
    J_x: Array | None = None


class Chain:
    """The robot of a case as a serial chain, for others."""

    def __init__(self, of: Case) -> None:
        model, base = of.model, of.phase.base
        root = rooted(model, base)
        _, joint, origin, axis, mass, com = root.arrays
        self.n = model.n
        self.order = joint[1:]  # of the model's joints along the chain
        self.back = np.argsort(self.order)
        self.origin, self.axis, self.com, self.mass = origin[1:], axis[1:], com, mass * model.mass
        self.end = root.frames[model.soles[base.other].frame]
        self.pelvis = root.frames[model.pelvis]

    def urdf(self) -> str:
        """Return the chain as URDF text."""

        def inertial(k: int) -> str:
            xyz = " ".join(f"{v:.17g}" for v in self.com[k])
            return (
                f'<inertial><origin xyz="{xyz}"/><mass value="{max(self.mass[k], 1e-9):.17g}"/>'
                '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
            )

        def place(x: Array) -> str:
            R, p = DQ(x).rotation_matrix(), DQ(x).translation()
            angles = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(np.clip(R[2, 0], -1, 1)), np.arctan2(R[1, 0], R[0, 0])
            return '<origin xyz="{:.17g} {:.17g} {:.17g}" rpy="{:.17g} {:.17g} {:.17g}"/>'.format(*p, *angles)

        parts = [f'<robot name="chain"><link name="body0">{inertial(0)}</link>']
        for k in range(self.n):
            axis = " ".join(f"{v:.17g}" for v in self.axis[k])
            parts.append(
                f'<joint name="q{k}" type="revolute"><parent link="body{k}"/><child link="body{k + 1}"/>'
                f'{place(self.origin[k])}<axis xyz="{axis}"/>'
                '<limit lower="-3" upper="3" velocity="8" effort="9"/></joint>'
                f'<link name="body{k + 1}">{inertial(k + 1)}</link>'
            )
        for name, (body, x) in (("end", self.end), ("pelvis", self.pelvis)):
            parts.append(
                f'<joint name="{name}_mount" type="fixed"><parent link="body{body}"/><child link="{name}"/>{place(x)}'
                f'</joint><link name="{name}"/>'
            )
        return "".join([*parts, "</robot>"])


class Program:
    """(6) of a phase, by hand: constants looked up once, rows in numpy."""

    def __init__(self, of: Case) -> None:
        self.phase, self.dt = of.phase, of.dt
        self.pelvis = of.model.pelvis
        above, below = of.phase.limits
        self.q_max, self.q_min, self.eta_q = above.q_max - above.bound, below.q_min + below.bound, above.eta
        self.com_task = isinstance(of.phase.tasks[0], ComOverFoot)
        self.eye = of.phase.damping**2 * np.eye(of.model.n)

    def point(self, point: Any, at: Places) -> tuple[Array, Array]:
        """Return a point of the phase and its Jacobian."""
        if not point.frame:
            return at.com, at.J_com
        if point.frame == self.pelvis:
            return at.pelvis, at.J_pelvis
        r = at.R @ point.offset
        return at.p + r, at.J_p + np.cross(at.J_w.T, r).T

    def row(self, row: Any, at: Places) -> tuple[Array, float]:
        """Return one row and its right-hand side."""
        if isinstance(row, AxisLevel):
            z = at.R[:, 2]
            J, d = row.direction @ np.cross(at.J_w.T, z).T, row.direction @ z
        else:
            p, J_p = self.point(row.point, at)
            if isinstance(row, PointOverPlane):
                J, d = row.plane.n @ J_p, row.plane.n @ p - row.plane.d
            elif isinstance(row, PointInCylinder):  # upright
                v = (p - np.cross(row.cylinder.axis.l, row.cylinder.axis.m))[:2]
                J, d = -2.0 * v @ J_p[:2], row.cylinder.radius**2 - v @ v
            else:
                assert isinstance(row, PointInsideWall)
                b, J_b = self.point(row.moving, at)
                t, v = (b - row.fixed)[:2], (p - row.fixed)[:2]
                length = np.sqrt(t @ t)
                n = np.array([-t[1], t[0]]) * (row.side / length)
                J, d = n @ (J_p[:2] - (t @ v / length**2) * J_b[:2]), n @ v
        return J, -min(row.eta, 1.0 / self.dt) * (d - row.bound)

    def __call__(self, q: Array, at: Places) -> tuple[Array, ...]:
        """Return H, c, E, e, G, h, lower, upper."""
        phase, n = self.phase, q.size
        task = phase.tasks[0]
        if self.com_task:
            p, J_p = self.point(task.foot, at)
            J, error = (at.J_com - J_p)[:2], (at.com - p)[:2]
        else:
            sign = 1.0 if at.x[:4] @ task.target[:4] >= 0.0 else -1.0
            J, error = sign * at.J_x, sign * at.x - task.target
        E, e = np.empty((len(phase.holds), n)), np.empty(len(phase.holds))
        G, h = np.empty((len(phase.rows), n)), np.empty(len(phase.rows))
        for k, row in enumerate(phase.holds):
            E[k], e[k] = self.row(row, at)
        for k, row in enumerate(phase.rows):
            G[k], h[k] = self.row(row, at)
        upper, lower = self.eta_q * (self.q_max - q), self.eta_q * (self.q_min - q)
        return J.T @ J + self.eye, phase.eta * (error @ J), E, e, G, h, lower, upper


def quadprog(H: Array, c: Array, E: Array, e: Array, G: Array, h: Array, lower: Array, upper: Array) -> Array:
    """Solve with quadprog."""
    from quadprog import solve_qp

    eye = np.eye(c.size)
    return solve_qp(H, -c, np.concatenate([E, G, eye, -eye]).T, np.concatenate([e, h, lower, -upper]), e.size)[0]


def daqp(H: Array, c: Array, E: Array, e: Array, G: Array, h: Array, lower: Array, upper: Array) -> Array:
    """Solve with daqp."""
    import daqp as solver

    high = np.concatenate([upper, e, np.full(h.size, 1e30)])
    low = np.concatenate([lower, e, h])
    sense = np.zeros(high.size, dtype=np.int32)
    sense[c.size : c.size + e.size] = 5
    return np.array(solver.solve(H, c, np.concatenate([E, G]), high, low, sense, primal_tol=1e-12)[0])


def pinocchio(of: Case, solve: Callable[..., Array]) -> Callable[[Array], Array]:
    """Return the tick with Pinocchio's kinematics."""
    import pinocchio as pin

    chain, program = Chain(of), Program(of)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(chain.urdf(), encoding="utf-8")
        model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    end, pelvis = model.getFrameId("end"), model.getFrameId("pelvis")
    share = chain.mass[1:].sum() / chain.mass.sum()  # Pinocchio leaves out what is at rest
    rest = chain.mass[0] * chain.com[0] / chain.mass.sum()
    x_end = Poses(of)

    def tick(q: Array) -> Array:
        q = q[chain.order]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J_com = share * pin.jacobianCenterOfMass(model, data, q, False)
        J = pin.getFrameJacobian(model, data, end, pin.LOCAL_WORLD_ALIGNED)
        J_pelvis = pin.getFrameJacobian(model, data, pelvis, pin.LOCAL_WORLD_ALIGNED)[:3]
        T = data.oMf[end]
        places = Places(
            T.rotation, T.translation, J[:3], J[3:], data.oMf[pelvis].translation, J_pelvis,
            share * data.com[0] + rest, J_com, *x_end(T.rotation, T.translation, J),
        )  # fmt: skip
        return solve(*permuted(program, q, places, chain))[chain.back]

    return tick


def permuted(program: Program, q: Array, places: Places, chain: Chain) -> tuple[Array, ...]:
    """Return the program of a state in the chain's order of joints."""
    if program.q_max.size and not hasattr(program, "ordered"):
        program.q_max, program.q_min = program.q_max[chain.order], program.q_min[chain.order]
        program.ordered = True
    return program(q, places)


class Poses:
    """The pose of the end sole as a dual quaternion, with its Jacobian, from rotation, translation and twist."""

    def __init__(self, of: Case) -> None:
        self.needed = not isinstance(of.phase.tasks[0], ComOverFoot)

    def __call__(self, R: Array, p: Array, J: Array) -> tuple[Array | None, Array | None]:
        """Return x (8,) and J_x (8, n); J is [velocity of the origin; angular velocity] in world axes."""
        if not self.needed:
            return None, None
        x = DQ.from_matrix(R, p)
        moment = J[:3] - np.cross(J[3:].T, p).T  # of the velocity at the world's origin
        return x.vec8(), 0.5 * x.haminus8()[:, [1, 2, 3, 5, 6, 7]] @ np.concatenate([J[3:], moment])


def dqrobotics(of: Case) -> Callable[[Array], Array]:
    """Return the tick with dqrobotics' kinematics and its quadprog solver."""
    from dqrobotics import DQ as Dual
    from dqrobotics import haminus8, translation, vec8
    from dqrobotics.robot_modeling import DQ_Kinematics, DQ_SerialManipulatorDH
    from dqrobotics.solvers import DQ_QuadprogSolver

    from benchmark.denavit import parameters

    chain, program, n = Chain(of), Program(of), of.model.n
    base, table, frames = parameters(chain)
    robot = DQ_SerialManipulatorDH(table)
    robot.set_reference_frame(Dual(base))
    robot.set_base_frame(Dual(base))
    solver, total = DQ_QuadprogSolver(), chain.mass.sum()
    at_rest = chain.mass[0] * chain.com[0] / total
    coms = [Dual(frames(k + 1, np.concatenate([[1, 0, 0, 0, 0], 0.5 * chain.com[k + 1]]))) for k in range(n)]
    end, pelvis = Dual(frames(chain.end[0], chain.end[1])), Dual(frames(chain.pelvis[0], chain.pelvis[1]))

    def frame(q: Array, body: int, x_local: Any) -> tuple[Any, Array, Array]:
        x = robot.fkm(q, body - 1) * x_local
        J_x = np.zeros((8, n))
        J_x[:, :body] = haminus8(x_local) @ robot.pose_jacobian(q, body - 1)
        return x, J_x, DQ_Kinematics.translation_jacobian(J_x, x)[1:]

    def tick(q: Array) -> Array:
        q = q[chain.order]
        com, J_com = at_rest.copy(), np.zeros((3, n))
        for k in range(n):
            x, _, J = frame(q, k + 1, coms[k])
            com += (chain.mass[k + 1] / total) * vec8(translation(x))[1:4]
            J_com += (chain.mass[k + 1] / total) * J
        x, J_x, J_p = frame(q, chain.end[0], end)
        x_pelvis, _, J_pelvis = frame(q, chain.pelvis[0], pelvis)
        h = vec8(x)
        J_w = 2.0 * (DQ(h[:4]).conj().haminus4() @ J_x[:4])[1:]  # w = 2 r' r*
        R = DQ(h).rotation_matrix()
        places = Places(
            R, vec8(translation(x))[1:4], J_p, J_w, vec8(translation(x_pelvis))[1:4], J_pelvis, com, J_com, h, J_x
        )
        H, c, E, e, G, h, lower, upper = permuted(program, q, places, chain)
        eye = np.eye(n)
        A, b = np.concatenate([-G, eye, -eye]), np.concatenate([-h, upper, -lower])
        if not e.size:
            return np.array(solver.solve_quadratic_program(H, c, A, b, None, None))[chain.back]
        return np.array(solver.solve_quadratic_program(H, c, A, b, E, e))[chain.back]

    return tick


PEERS: dict[str, Callable[[Case], Callable[[Array], Array]]] = {
    "pinocchio + quadprog": lambda of: pinocchio(of, quadprog),
    "pinocchio + daqp": lambda of: pinocchio(of, daqp),
    "dqrobotics + quadprog": dqrobotics,
}
