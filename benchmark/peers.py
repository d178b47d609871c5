"""The tick of a phase written with the packages one would use instead.

All solve the same quadratic program (6): their own kinematics, the rows in numpy as one writes them by hand, their
usual solver. The robot is handed over as the serial chain from the base sole to the other one.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.robots import Case
from dqwalk_ros.constraints import AxisLevel, PointInCylinder, PointInsideWall, PointOverPlane
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.kinematics import CenterOfMass, support_tree
from dqwalk_ros.tasks import ComOverFoot

__all__ = ["PEERS", "Chain", "Places", "Poses", "Program", "ordered"]

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
        root = support_tree(model, base)
        joint, (origin, axis, mass, com) = root.tree[:, 1], np.split(root.links, [8, 11, 12], axis=1)
        self.n = model.n
        self.order = joint[1:]  # of the model's joints along the chain
        self.back = np.argsort(self.order)
        self.origin, self.axis, self.com, self.mass = origin[1:], axis[1:], com, mass[:, 0] * model.mass
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

    def mjcf(self, q_min: Array, q_max: Array) -> str:
        """Return the chain as MuJoCo's XML, with the limits [rad] of its joints."""

        def text(values: Array) -> str:
            return " ".join(f"{v:.17g}" for v in values)

        def place(x: Array) -> str:
            return f'pos="{text(DQ(x).translation())}" quat="{text(x[:4])}"'

        def body(k: int) -> str:
            mass, com = max(self.mass[k], 1e-9), text(self.com[k])
            sites = "".join(
                f'<site name="{name}" {place(x)}/>'
                for name, (of, x) in (("end", self.end), ("pelvis", self.pelvis))
                if of == k
            )
            return f'<inertial pos="{com}" mass="{mass:.17g}" diaginertia="1e-4 1e-4 1e-4"/>{sites}'

        parts = [f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="body0">{body(0)}']
        for k in range(self.n):
            limits = text(np.array([q_min[k], q_max[k]]))
            parts.append(
                f'<body name="body{k + 1}" {place(self.origin[k])}>'
                f'<joint name="q{k}" type="hinge" axis="{text(self.axis[k])}" range="{limits}"/>{body(k + 1)}'
            )
        return "".join([*parts, "</body>" * (self.n + 1), "</worldbody></mujoco>"])

    def moving(self) -> tuple[float, Array]:
        """Return the share of the mass that moves, and what the base at rest adds to the CoM [m].

        Pinocchio leaves out what is at rest.
        """
        return self.mass[1:].sum() / self.mass.sum(), self.mass[0] * self.com[0] / self.mass.sum()


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
        if isinstance(point, CenterOfMass):
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

    def task(self, at: Places) -> tuple[Array, Array]:
        """Return the Jacobian and the error of the task."""
        task = self.phase.tasks[0]
        if self.com_task:
            p, J_p = self.point(task.foot, at)
            return (at.J_com - J_p)[:2], (at.com - p)[:2]
        sign = 1.0 if at.x[:4] @ task.target[:4] >= 0.0 else -1.0
        return sign * at.J_x, sign * at.x - task.target

    def holds(self, at: Places) -> tuple[Array, Array]:
        """Return E and e of the equalities."""
        return self._stack(self.phase.equalities, at)

    def rows(self, at: Places) -> tuple[Array, Array]:
        """Return G and h of the inequalities, G u >= h."""
        return self._stack(self.phase.inequalities, at)

    def _stack(self, of: Sequence[Any], at: Places) -> tuple[Array, Array]:
        A, b = np.empty((len(of), self.q_max.size)), np.empty(len(of))
        for k, row in enumerate(of):
            A[k], b[k] = self.row(row, at)
        return A, b

    def __call__(self, q: Array, at: Places) -> tuple[Array, ...]:
        """Return H, c, E, e, G, h, lower, upper."""
        J, error = self.task(at)
        upper, lower = self.eta_q * (self.q_max - q), self.eta_q * (self.q_min - q)
        return J.T @ J + self.eye, self.phase.eta * (error @ J), *self.holds(at), *self.rows(at), lower, upper


def ordered(program: Program, chain: Chain) -> Program:
    """Return the program with its joints in the order of the chain."""
    program.q_max, program.q_min = program.q_max[chain.order], program.q_min[chain.order]
    return program


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


class InPlace:
    """Clarabel kept and updated in place, at its default tolerances and without scaling."""

    def __init__(self) -> None:
        self.solver: Any = None

    def __call__(self, H: Array, c: Array, E: Array, e: Array, G: Array, h: Array, lower: Array, upper: Array) -> Array:
        """Solve."""
        n = c.size
        eye = np.eye(n)
        A, b = np.concatenate([E, -G, eye, -eye]), np.concatenate([e, -h, upper, -lower])
        P = H[self.upper] if self.solver else None
        if self.solver is None:
            import clarabel
            from scipy import sparse

            self.upper = tuple(reversed(np.tril_indices(n)))  # of the upper triangle, column by column
            full = np.ones_like(A, dtype=bool)
            pattern = sparse.csc_matrix(full)
            pattern.data = A.T.ravel()
            triangle = sparse.csc_matrix(np.triu(np.ones((n, n))))
            triangle.data = H[self.upper]
            settings = clarabel.DefaultSettings()
            settings.verbose = False
            settings.presolve_enable = False
            cones = [clarabel.ZeroConeT(e.size)] if e.size else []
            cones.append(clarabel.NonnegativeConeT(b.size - e.size))
            self.solver = clarabel.DefaultSolver(triangle, c, pattern.astype(float), b, cones, settings)
        else:
            self.solver.update(P=P.tolist(), q=c.tolist(), A=A.T.ravel().tolist(), b=b.tolist())
        return np.array(self.solver.solve().x)


def pinocchio(of: Case, solve: Callable[..., Array]) -> Callable[[Array], Array]:
    """Return the tick with Pinocchio's kinematics."""
    import pinocchio as pin

    chain, program = Chain(of), ordered(Program(of), Chain(of))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(chain.urdf(), encoding="utf-8")
        model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    end, pelvis = model.getFrameId("end"), model.getFrameId("pelvis")
    share, rest = chain.moving()
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
        return solve(*program(q, places))[chain.back]

    return tick


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

    chain, program, n = Chain(of), ordered(Program(of), Chain(of)), of.model.n
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
        H, c, E, e, G, h, lower, upper = program(q, places)
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
    "pinocchio + clarabel in place": lambda of: pinocchio(of, InPlace()),
    "pink + quadprog": lambda of: _own("pink")(of),
    "mink + quadprog": lambda of: _own("mink")(of),
    "placo": lambda of: _own("placo")(of),
}


def _own(name: str) -> Callable[[Case], Callable[[Array], Array]]:
    from benchmark import inverse_kinematics  # which needs what is above

    return getattr(inverse_kinematics, name)
