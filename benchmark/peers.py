"""The tick of a phase written with other packages, each as an experienced user would write it.

Except for placo and, in single support, mink, pink and roboplan, all solve the same quadratic program (U6) as
`benchmark.peer_adapter`: with the package's kinematics, rows in numpy, and its usual solver. "In place":
preallocated arrays and a direct call of the solver; "qpsolvers": a simple first version, with new numpy matrices
passed to the package of that name. mink, pink, placo and roboplan use their own tasks for the swing foot, so their
result in single support differs.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.biped import Chain, Walk, chain_urdf
from benchmark.denavit import parameters
from dqwalk_ros.paper.dual_quaternions import DQ

Array = np.ndarray
Tick = Callable[[Array], Array]
_LINE = [1, 2, 3, 5, 6, 7]


class Rows:
    """The program of a phase in arrays that are allocated once.

    Rows of `A` are the equality, where there is one, and the inequalities, A u = e and A u >= b; what a row is worth is
    in `b`. Then bounds on u.
    """

    def __init__(self, chain: Chain, walk: Walk, phase: str) -> None:
        n, self.walk, self.dsp = chain.n, walk, phase == "dsp"
        self.equalities = int(self.dsp)
        rows = 5 if self.dsp else 2
        self.H, self.c = np.empty((n, n)), np.empty(n)
        self.A, self.b = np.empty((rows, n)), np.empty(rows)
        self.lower, self.upper = np.empty(n), np.empty(n)
        self._q_min, self._q_max = chain.q_min, chain.q_max
        self._damping, self._diagonal = walk.lam**2, np.arange(n) * (n + 1)
        self._planes = np.stack([walk.tip_plane[0], walk.back_plane[0]])
        self._offsets = np.array([walk.tip_plane[1], walk.back_plane[1]])
        self._rates = np.array([walk.eta_tip, walk.eta_back])

    def double_support(
        self, q: Array, com: Array, J_com: Array, p: Array, J_p: Array, pelvis: Array, J_pelvis: Array
    ) -> None:
        """Fill in the double support from CoM, end sole and pelvis (3,) and their Jacobians (3, n)."""
        w, A, b = self.walk, self.A, self.b
        A[0], b[0] = J_p[2], -w.eta_ground * p[2]
        v = p[:2] - w.slide_center[:2]
        np.dot(-2.0 * v, J_p[:2], out=A[1])
        b[1] = -w.eta_sliding * (w.slide_radius**2 - v @ v)
        np.dot(self._planes, J_com, out=A[2:4])
        b[2:4] = self._rates * (self._offsets - self._planes @ com)
        A[4], b[4] = J_pelvis[2], -w.eta_pelvis * (pelvis[2] - w.pelvis_height)
        self._finish(q, J_com[:2], com[:2] - w.com_target)

    def single_support(
        self, q: Array, com: Array, J_com: Array, x: Array, J_x: Array, pelvis: Array, J_pelvis: Array
    ) -> None:
        """Fill in the single support from CoM and pelvis, and the swing foot's pose (8,) with its Jacobian (8, n)."""
        w, A, b = self.walk, self.A, self.b
        v = com[:2] - w.com_center[:2]
        np.dot(-2.0 * v, J_com[:2], out=A[0])
        b[0] = -w.eta_com * (w.com_radius**2 - v @ v)
        A[1], b[1] = J_pelvis[2], -w.eta_pelvis * (pelvis[2] - w.pelvis_height)
        if x[:4] @ w.x_goal[:4] < 0.0:
            x, J_x = -x, -J_x
        self._finish(q, J_x, x - w.x_goal)

    def _finish(self, q: Array, J: Array, error: Array) -> None:
        w = self.walk
        np.dot(J.T, J, out=self.H)
        self.H.ravel()[self._diagonal] += self._damping
        np.dot(error, J, out=self.c)
        self.c *= w.eta
        np.subtract(self._q_max, q, out=self.upper)
        self.upper *= w.eta_q
        np.subtract(self._q_min, q, out=self.lower)
        self.lower *= w.eta_q


# ---------------------------------------------------------------------- solvers


def daqp_in_place(rows: Rows) -> Callable[[], Array]:
    """Return a function that solves with DAQP."""
    from daqp import solve

    n, k, m = rows.c.size, rows.equalities, len(rows.b)
    high, low, sense = np.full(n + m, 1e30), np.empty(n + m), np.zeros(n + m, dtype=np.int32)
    sense[n : n + k] = 5

    def answer() -> Array:
        high[:n], low[:n], low[n:], high[n : n + k] = rows.upper, rows.lower, rows.b, rows.b[:k]
        return solve(rows.H, rows.c, rows.A, high, low, sense, primal_tol=1e-12)[0]

    return answer


def quadprog_in_place(rows: Rows) -> Callable[[], Array]:
    """Return a function that solves with quadprog."""
    from quadprog import solve_qp

    n, k, m = rows.c.size, rows.equalities, len(rows.b)
    C, b = np.zeros((n, m + 2 * n)), np.empty(m + 2 * n)
    C[:, m : m + n], C[:, m + n :] = np.eye(n), -np.eye(n)

    def answer() -> Array:
        C[:, :m], b[:m], b[m : m + n] = rows.A.T, rows.b, rows.lower
        np.negative(rows.upper, out=b[m + n :])
        return solve_qp(rows.H, -rows.c, C, b, k)[0]

    return answer


def clarabel_in_place(rows: Rows) -> Callable[[], Array]:
    """Return a function that solves with one Clarabel solver whose data is updated; default tolerances, no scaling."""
    import clarabel
    from scipy import sparse

    n, k, m = rows.c.size, rows.equalities, len(rows.b)
    triangle = np.tril_indices(n)  # row by row: the upper one column by column
    sign = np.where(np.arange(m) < k, 1.0, -1.0)
    pattern = sparse.csc_matrix(np.vstack([np.ones((m, n)), np.eye(n), -np.eye(n)]))
    values = pattern.data.reshape(n, m + 2)
    solver: Any = None

    def answer() -> Array:
        nonlocal solver
        values[:, :m] = (sign[:, None] * rows.A).T
        b = np.concatenate([sign * rows.b, rows.upper, -rows.lower])
        if solver is None:
            settings = clarabel.DefaultSettings()
            settings.verbose = settings.presolve_enable = False
            cones = [clarabel.ZeroConeT(k)] if k else []
            cones.append(clarabel.NonnegativeConeT(m - k + 2 * n))
            P = sparse.csc_matrix(np.triu(np.ones((n, n))))
            P.data = rows.H[triangle]
            solver = clarabel.DefaultSolver(P, rows.c, pattern, b, cones, settings)
        else:
            solver.update(P=rows.H[triangle].tolist(), q=rows.c.tolist(), A=pattern.data.tolist(), b=b.tolist())
        return np.array(solver.solve().x)

    return answer


# ---------------------------------------------------------------------- packages


def pose_in_place(n: int) -> Callable[[float, Array, Array, Array], tuple[Array, Array]]:
    """Return a function of a unit quaternion w + v, a position p and a Jacobian (6, n), first of p, then of the angles.

    It returns the unit dual quaternion (8,) of the pose and its Jacobian (8, n), in the same two arrays every time.
    """
    cross = np.zeros((3, 3))  # p x
    x, twist, J_x = np.empty(8), np.empty((6, n)), np.empty((8, n))
    # half of H-(x), times a pure twist, is linear in x: one entry of x with a sign everywhere
    basis = np.stack([DQ(one).haminus8()[:, _LINE] for one in np.eye(8)])
    index, sign = np.abs(basis).argmax(axis=0), 0.5 * basis.sum(axis=0)

    def pose(w: float, v: Array, p: Array, J: Array) -> tuple[Array, Array]:
        x[0], x[1:4] = w, v
        x[4] = -0.5 * (p @ v)
        cross[0, 1], cross[0, 2], cross[1, 2] = -p[2], p[1], -p[0]
        cross[1, 0], cross[2, 0], cross[2, 1] = p[2], -p[1], p[0]
        x[5:] = 0.5 * (w * p + cross @ v)
        twist[:3] = J[3:]
        np.dot(cross, J[3:], out=twist[3:])
        twist[3:] += J[:3]  # of the point of the foot that is at the world's origin
        np.dot(sign * x[index], twist, out=J_x)
        return x, J_x

    return pose


def pinocchio(solver: Callable[[Rows], Callable[[], Array]]) -> Callable[[Chain, Walk, str], Tick]:
    """Return a function that makes ticks with Pinocchio's kinematics."""

    def make(chain: Chain, walk: Walk, phase: str) -> Tick:
        import pinocchio as pin

        rows = Rows(chain, walk, phase)
        solve, dsp = solver(rows), phase == "dsp"
        model = pin.buildModelFromXML(chain_urdf(chain))
        data, world = model.createData(), pin.LOCAL_WORLD_ALIGNED
        tip, pelvis = model.getFrameId("tip"), model.getFrameId("pelvis")
        # what is fixed to the world has no mass for Pinocchio
        share = chain.mass.sum() / (chain.base_mass + chain.mass.sum())
        rest = (1.0 - share) * chain.base_com
        pose = pose_in_place(chain.n)

        def tick(q: Array) -> Array:
            J_com = pin.jacobianCenterOfMass(model, data, q, False)
            J_com *= share
            pin.computeJointJacobians(model, data, q)
            T = pin.updateFramePlacement(model, data, tip)
            T_pelvis = pin.updateFramePlacement(model, data, pelvis)
            J = pin.getFrameJacobian(model, data, tip, world)
            J_pelvis = pin.getFrameJacobian(model, data, pelvis, world)
            p, com = T.translation, share * data.com[0] + rest
            if dsp:
                rows.double_support(q, com, J_com, p, J[:3], T_pelvis.translation, J_pelvis[:3])
            else:
                r = pin.Quaternion(T.rotation).coeffs()
                x, J_x = pose(r[3], r[:3], p, J)
                rows.single_support(q, com, J_com, x, J_x, T_pelvis.translation, J_pelvis[:3])
            return solve()

        return tick

    return make


def haminus4(r: Array) -> Array:
    """Return the matrix H-(r) of a quaternion, a r = H-(r) a."""
    a, b, c, d = r
    return np.array([[a, -b, -c, -d], [b, a, d, -c], [c, -d, a, b], [d, c, -b, a]])


def pinocchio_plain(solver: str) -> Callable[[Chain, Walk, str], Tick]:
    """Return a function that makes ticks with Pinocchio's kinematics, matrices of numpy and qpsolvers."""

    def make(chain: Chain, walk: Walk, phase: str) -> Tick:
        import pinocchio as pin
        import qpsolvers

        w, eye = walk, np.eye(chain.n)
        model = pin.buildModelFromXML(chain_urdf(chain))
        data, world = model.createData(), pin.LOCAL_WORLD_ALIGNED
        tip, pelvis = model.getFrameId("tip"), model.getFrameId("pelvis")
        share = chain.mass.sum() / (chain.base_mass + chain.mass.sum())
        rest = (1.0 - share) * chain.base_com

        def tick(q: Array) -> Array:
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            J_com = share * pin.jacobianCenterOfMass(model, data, q, False)
            com, T = share * data.com[0] + rest, data.oMf[tip]
            J = pin.getFrameJacobian(model, data, tip, world)
            J_pelvis = pin.getFrameJacobian(model, data, pelvis, world)
            height = np.array([w.eta_pelvis * (data.oMf[pelvis].translation[2] - w.pelvis_height)])
            if phase == "dsp":
                p = T.translation
                v = (p - w.slide_center) * [1.0, 1.0, 0.0]
                task, error = J_com[:2], com[:2] - w.com_target
                E, e = J[2:3], np.array([-w.eta_ground * p[2]])
                rows = [2.0 * v @ J[:3], -w.tip_plane[0] @ J_com, -w.back_plane[0] @ J_com]
                free = [
                    w.eta_sliding * (w.slide_radius**2 - v @ v),
                    w.eta_tip * (w.tip_plane[0] @ com - w.tip_plane[1]),
                    w.eta_back * (w.back_plane[0] @ com - w.back_plane[1]),
                ]
            else:
                r = np.roll(pin.Quaternion(T.rotation).coeffs(), 1)
                x = np.concatenate([r, 0.5 * haminus4(r) @ [0.0, *T.translation]])
                x *= 1.0 if x @ w.x_goal > 0.0 else -1.0
                twist = np.vstack([J[3:], J[:3] - np.cross(J[3:].T, T.translation).T])
                H = np.zeros((8, 8))
                H[:4, :4] = H[4:, 4:] = haminus4(x[:4])
                H[4:, :4] = haminus4(x[4:])
                task, error = 0.5 * H[:, _LINE] @ twist, x - w.x_goal
                v = (com - w.com_center) * [1.0, 1.0, 0.0]
                E, e = None, None
                rows, free = [2.0 * v @ J_com], [w.eta_com * (w.com_radius**2 - v @ v)]
            G = np.vstack([*rows, -J_pelvis[2], eye, -eye])
            h = np.concatenate([free, height, w.eta_q * (chain.q_max - q), w.eta_q * (q - chain.q_min)])
            P, c = task.T @ task + w.lam**2 * eye, w.eta * (task.T @ error)
            return qpsolvers.solve_qp(P, c, G, h, E, e, solver=solver)

        return tick

    return make


def dqrobotics(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with dqrobotics: distances and Jacobians as in the paper, its quadprog."""
    from dqrobotics import DQ as Dual
    from dqrobotics import haminus8, translation, vec3, vec8
    from dqrobotics.robot_modeling import DQ_Kinematics as K
    from dqrobotics.robot_modeling import DQ_SerialManipulatorDH
    from dqrobotics.solvers import DQ_QuadprogSolver
    from dqrobotics.utils import DQ_Geometry as G

    n, eye = chain.n, np.eye(chain.n)
    base, table, place = parameters(chain)
    robot = DQ_SerialManipulatorDH(table)
    robot.set_reference_frame(Dual(base))
    robot.set_base_frame(Dual(base))
    coms = [Dual(place(i, np.eye(3), chain.com[i])) for i in range(n)]
    tip, pelvis = Dual(place(n - 1, chain.tip_R, chain.tip_p)), Dual(place(5, np.eye(3), chain.pelvis_point))
    total = chain.base_mass + chain.mass.sum()

    def plane(normal: Array, offset: float) -> Any:
        return Dual([0.0, *normal, offset, 0.0, 0.0, 0.0])

    def upright(center: Array) -> Any:
        return Dual([0.0, 0.0, 0.0, 1.0, 0.0, *np.cross(center, [0.0, 0.0, 1.0])])

    up = np.array([0.0, 0.0, 1.0])
    ground, floor = plane(up, 0.0), plane(up, walk.pelvis_height)
    tip_plane, back_plane = plane(*walk.tip_plane), plane(*walk.back_plane)
    sliding, cylinder = upright(walk.slide_center), upright(walk.com_center)
    solver = DQ_QuadprogSolver()

    def frame(q: Array, i: int, local: Any) -> tuple[Any, Array, Array]:
        x = robot.fkm(q, i) * local
        J_x = haminus8(local) @ robot.pose_jacobian(q, i)
        return x, J_x, K.translation_jacobian(J_x, x)

    def tick(q: Array) -> Array:
        com, J_com = Dual(chain.base_com) * chain.base_mass, np.zeros((4, n))
        for i in range(n):
            x, _, J = frame(q, i, coms[i])
            com = com + chain.mass[i] * translation(x)
            J_com[:, : i + 1] += chain.mass[i] * J
        com, J_com = com * (1.0 / total), J_com / total
        x, J_x, J_p = frame(q, n - 1, tip)
        x_pelvis, _, J = frame(q, chain.pelvis_index, pelvis)
        J_pelvis, p_pelvis = np.zeros((4, n)), translation(x_pelvis)
        J_pelvis[:, : chain.pelvis_index + 1] = J
        rows = [K.point_to_plane_distance_jacobian(J_pelvis, p_pelvis, floor)]
        b = [walk.eta_pelvis * G.point_to_plane_distance(p_pelvis, floor)]
        equality = None, None
        if phase == "dsp":
            p = translation(x)
            J, error = J_com[1:3], vec3(com)[:2] - walk.com_target
            d = walk.slide_radius**2 - G.point_to_line_squared_distance(p, sliding)
            rows.append(-K.point_to_line_distance_jacobian(J_p, p, sliding))
            b.append(walk.eta_sliding * d)
            for wall, eta in ((tip_plane, walk.eta_tip), (back_plane, walk.eta_back)):
                rows.append(K.point_to_plane_distance_jacobian(J_com, com, wall))
                b.append(eta * G.point_to_plane_distance(com, wall))
            J_ground = K.point_to_plane_distance_jacobian(J_p, p, ground)
            equality = J_ground, np.array([-walk.eta_ground * G.point_to_plane_distance(p, ground)])
        else:
            h = vec8(x)
            sign = 1.0 if h @ walk.x_goal > 0.0 else -1.0
            J, error = sign * J_x, sign * h - walk.x_goal
            rows.append(-K.point_to_line_distance_jacobian(J_com, com, cylinder))
            b.append(walk.eta_com * (walk.com_radius**2 - G.point_to_line_squared_distance(com, cylinder)))
        W = np.vstack([*(-row for row in rows), eye, -eye])
        w = np.concatenate([b, walk.eta_q * (chain.q_max - q), walk.eta_q * (q - chain.q_min)])
        return solver.solve_quadratic_program(J.T @ J + walk.lam**2 * eye, walk.eta * (J.T @ error), W, w, *equality)

    return tick


def pink(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with pink: tasks and barriers, its quadprog."""
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.barriers import Barrier
    from pink.limits import ConfigurationLimit
    from pink.tasks import ComTask, FrameTask

    model = pin.buildModelFromXML(chain_urdf(chain))
    configuration = Configuration(model, model.createData(), np.zeros(chain.n))
    share = chain.mass.sum() / (chain.base_mass + chain.mass.sum())
    rest = (1.0 - share) * chain.base_com

    def com(of: Any) -> Array:
        return share * pin.centerOfMass(of.model, of.data, of.q) + rest

    def com_jacobian(of: Any) -> Array:
        return share * pin.jacobianCenterOfMass(of.model, of.data, of.q)

    def point(name: str) -> Callable[[Any], Array]:
        return lambda of: of.get_transform_frame_to_world(name).translation

    def point_jacobian(name: str) -> Callable[[Any], Array]:
        return lambda of: of.get_transform_frame_to_world(name).rotation @ of.get_frame_jacobian(name)[:3]

    class OverPlane(Barrier):
        def __init__(self, p: Any, J: Any, plane: tuple[Array, float], gain: float) -> None:
            super().__init__(1, gain=gain)
            self.p, self.J, self.n, self.d = p, J, *plane

        def compute_barrier(self, of: Any) -> Array:
            return np.array([self.n @ self.p(of) - self.d])

        def compute_jacobian(self, of: Any) -> Array:
            return (self.n @ self.J(of))[None]

    class InCylinder(Barrier):
        def __init__(self, p: Any, J: Any, center: Array, radius: float, gain: float) -> None:
            super().__init__(1, gain=gain)
            self.p, self.J, self.center, self.radius = p, J, center[:2], radius

        def compute_barrier(self, of: Any) -> Array:
            v = self.p(of)[:2] - self.center
            return np.array([self.radius**2 - v @ v])

        def compute_jacobian(self, of: Any) -> Array:
            return (-2.0 * (self.p(of)[:2] - self.center) @ self.J(of)[:2])[None]

    class WholeCom(ComTask):
        def compute_error(self, of: Any) -> Array:
            return com(of) - self.target_com

        def compute_jacobian(self, of: Any) -> Array:
            return com_jacobian(of)

    class Height(ComTask):
        def compute_error(self, of: Any) -> Array:
            return of.get_transform_frame_to_world("tip").translation[2:3]

        def compute_jacobian(self, of: Any) -> Array:
            return point_jacobian("tip")(of)[2:3]

    up = np.array([0.0, 0.0, 1.0])
    barriers: list[Any] = [
        OverPlane(point("pelvis"), point_jacobian("pelvis"), (up, walk.pelvis_height), walk.eta_pelvis)
    ]
    limits = [ConfigurationLimit(model, config_limit_gain=walk.eta_q * walk.dt)]
    constraints: list[Any] | None = None
    if phase == "dsp":
        task: Any = WholeCom(cost=[1.0, 1.0, 0.0], gain=walk.eta * walk.dt)
        task.set_target(np.array([*walk.com_target, 0.0]))
        height = Height(cost=1.0, gain=walk.eta_ground * walk.dt)
        height.set_target(np.zeros(3))
        constraints = [height]
        tip = point("tip"), point_jacobian("tip")
        barriers += [
            InCylinder(*tip, walk.slide_center, walk.slide_radius, walk.eta_sliding),
            OverPlane(com, com_jacobian, walk.tip_plane, walk.eta_tip),
            OverPlane(com, com_jacobian, walk.back_plane, walk.eta_back),
        ]
    else:
        task = FrameTask("tip", position_cost=1.0, orientation_cost=1.0, gain=walk.eta * walk.dt)
        goal = DQ(walk.x_goal)
        task.set_target(pin.SE3(goal.rotation_matrix(), goal.translation()))
        barriers.append(InCylinder(com, com_jacobian, walk.com_center, walk.com_radius, walk.eta_com))

    def tick(q: Array) -> Array:
        configuration.update(q)
        return solve_ik(
            configuration, [task], walk.dt, solver="quadprog", damping=walk.lam**2, limits=limits,
            barriers=barriers, constraints=constraints, safety_break=False,
        )  # fmt: skip

    return tick


def mink(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with mink (MuJoCo): tasks and limits, its quadprog."""
    import mujoco
    from mink import SE3, ComTask, Configuration, ConfigurationLimit, FrameTask, solve_ik
    from mink.limits.limit import Constraint, Limit

    model = mujoco.MjModel.from_xml_string(_mjcf(chain))
    configuration, n = Configuration(model), chain.n
    tip, pelvis = model.site("tip").id, model.site("pelvis").id
    J_com, J_tip, J_pelvis = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    rows = 4 if phase == "dsp" else 2
    G, h = np.empty((rows, n)), np.empty(rows)
    planes = ((walk.tip_plane, walk.eta_tip), (walk.back_plane, walk.eta_back))

    class Rows(Limit):
        def compute_qp_inequalities(self, of: Any, dt: float) -> Any:
            m, d = of.model, of.data
            mujoco.mj_jacSubtreeCom(m, d, J_com, 1)
            mujoco.mj_jacSite(m, d, J_pelvis, None, pelvis)
            com = d.subtree_com[1]
            G[0], h[0] = -J_pelvis[2], walk.eta_pelvis * (d.site_xpos[pelvis][2] - walk.pelvis_height)
            if phase == "dsp":
                mujoco.mj_jacSite(m, d, J_tip, None, tip)
                v = d.site_xpos[tip][:2] - walk.slide_center[:2]
                G[1], h[1] = 2.0 * v @ J_tip[:2], walk.eta_sliding * (walk.slide_radius**2 - v @ v)
                for k, ((normal, offset), eta) in enumerate(planes, 2):
                    G[k], h[k] = -normal @ J_com, eta * (normal @ com - offset)
            else:
                v = com[:2] - walk.com_center[:2]
                G[1], h[1] = 2.0 * v @ J_com[:2], walk.eta_com * (walk.com_radius**2 - v @ v)
            return Constraint(G, dt * h)

    class Height(ComTask):
        def compute_error(self, of: Any) -> Array:
            return of.data.site_xpos[tip][2:3]

        def compute_jacobian(self, of: Any) -> Array:
            mujoco.mj_jacSite(of.model, of.data, J_tip, None, tip)
            return J_tip[2:3]

    limits = [Rows(), ConfigurationLimit(model, gain=walk.eta_q * walk.dt)]
    constraints: list[Any] | None = None
    if phase == "dsp":
        task: Any = ComTask(cost=[1.0, 1.0, 0.0], gain=walk.eta * walk.dt)
        task.set_target(np.array([*walk.com_target, 0.0]))
        constraints = [Height(cost=1.0, gain=walk.eta_ground * walk.dt)]
    else:
        task = FrameTask("tip", "site", position_cost=1.0, orientation_cost=1.0, gain=walk.eta * walk.dt)
        task.set_target(SE3(np.concatenate([walk.x_goal[:4], DQ(walk.x_goal).translation()])))

    def tick(q: Array) -> Array:
        configuration.update(q)
        return solve_ik(configuration, [task], walk.dt, "quadprog", walk.lam**2, limits=limits, constraints=constraints)

    return tick


def _mjcf(chain: Chain) -> str:
    def text(values: Any) -> str:
        return " ".join(f"{value:.17g}" for value in values)

    def inertial(mass: float, com: Array) -> str:
        return f'<inertial pos="{text(com)}" mass="{mass:.17g}" diaginertia="1e-4 1e-4 1e-4"/>'

    parts = ['<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="base">']
    parts.append(inertial(chain.base_mass, chain.base_com))
    for i, name in enumerate(chain.names):
        turn = DQ.from_matrix(chain.fixed_R[i], np.zeros(3)).vec8()[:4]
        parts.append(
            f'<body pos="{text(chain.fixed_p[i])}" quat="{text(turn)}">{inertial(chain.mass[i], chain.com[i])}'
            f'<joint name="{name}" axis="{text(chain.axis[i])}" range="{chain.q_min[i]} {chain.q_max[i]}"/>'
        )
        if i == chain.pelvis_index:
            parts.append(f'<site name="pelvis" pos="{text(chain.pelvis_point)}"/>')
    turn = DQ.from_matrix(chain.tip_R, np.zeros(3)).vec8()[:4]
    parts.append(f'<site name="tip" pos="{text(chain.tip_p)}" quat="{text(turn)}"/>')
    return "".join([*parts, "</body>" * (chain.n + 1), "</worldbody></mujoco>"])


def placo(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with placo; rows without a placo constraint are half spaces of joints, updated at each tick."""
    import placo as package

    n, dt, dsp = chain.n, walk.dt, phase == "dsp"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(chain_urdf(chain), encoding="utf-8")
        robot = package.RobotWrapper(str(path), package.Flags.ignore_collisions)
    if list(robot.joint_names()) != chain.names:
        raise RuntimeError("placo orders the joints in another way")
    solver = package.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.dt = dt
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    solver.add_regularization_task(walk.lam**2)
    if dsp:
        aim = solver.add_com_task(np.zeros(3))
        aim.mask.set_axises("xy", "task")
        aim.configure("aim", "soft", 1.0)
        foot = solver.add_position_task("tip", np.zeros(3))
        foot.mask.set_axises("z", "task")
        foot.configure("foot", "hard", 1.0)
    else:
        aim = solver.add_frame_task("tip", np.eye(4))
        aim.configure("aim", "soft", 1.0, 1.0)
    rows = 4 if dsp else 2
    A, b = np.zeros((rows + 2 * n, n + 7)), np.empty(rows + 2 * n)
    A[rows : rows + n, 7:], A[rows + n :, 7:] = np.eye(n), -np.eye(n)
    spaces = solver.add_joint_space_half_spaces_constraint(A, b)
    spaces.configure("rows", "hard", 1.0)
    goal = DQ(walk.x_goal).translation()
    planes = ((walk.tip_plane, walk.eta_tip), (walk.back_plane, walk.eta_back))

    def tick(q: Array) -> Array:
        state = robot.state
        state.q[7:] = q
        robot.state = state
        robot.update_kinematics()
        com, J_com = robot.com_world(), robot.com_jacobian()[:, 6:]
        T, T_pelvis = robot.get_T_world_frame("tip"), robot.get_T_world_frame("pelvis")
        J_pelvis = robot.frame_jacobian("pelvis", "local_world_aligned")[:3, 6:]
        A[0, 7:], b[0] = -J_pelvis[2], walk.eta_pelvis * (T_pelvis[2, 3] - walk.pelvis_height)
        if dsp:
            J = robot.frame_jacobian("tip", "local_world_aligned")[:3, 6:]
            v = T[:2, 3] - walk.slide_center[:2]
            A[1, 7:], b[1] = 2.0 * v @ J[:2], walk.eta_sliding * (walk.slide_radius**2 - v @ v)
            for k, ((normal, offset), eta) in enumerate(planes, 2):
                A[k, 7:], b[k] = -normal @ J_com, eta * (normal @ com - offset)
            target = com.copy()
            target[:2] -= walk.eta * dt * (com[:2] - walk.com_target)
            aim.target_world = target
            place = T[:3, 3].copy()
            place[2] -= walk.eta_ground * dt * place[2]
            foot.target_world = place
        else:
            v = com[:2] - walk.com_center[:2]
            A[1, 7:], b[1] = 2.0 * v @ J_com[:2], walk.eta_com * (walk.com_radius**2 - v @ v)
            T[:3, 3] -= walk.eta * dt * (T[:3, 3] - goal)
            aim.T_world_frame = T
        b[rows : rows + n], b[rows + n :] = walk.eta_q * (chain.q_max - q), walk.eta_q * (q - chain.q_min)
        spaces.A, spaces.b = A, A[:, 7:] @ q + dt * b
        return solver.solve(False)[6:] / dt

    return tick


def frax(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with frax: its kinematics in one compiled JAX function, and DAQP in place."""
    import os

    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")  # as frax recommends for a CPU
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    from frax.core.robot import Robot
    from frax.utils.rotation_utils import rmat_to_quat_wxyz

    n, rows = chain.n, Rows(chain, walk, phase)
    solve, dsp, pose = daqp_in_place(rows), phase == "dsp", pose_in_place(n)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(chain_urdf(chain), encoding="utf-8")
        robot = Robot(str(path), joint_ordering=chain.names)
    share = chain.mass.sum() / (chain.base_mass + chain.mass.sum())  # frax omits what is fixed to the world
    rest = (1.0 - share) * chain.base_com
    tip, pelvis = np.eye(4), np.eye(4)
    tip[:3, :3], tip[:3, 3], pelvis[:3, 3] = chain.tip_R, chain.tip_p, chain.pelvis_point
    above_tip, above_pelvis = np.arange(n), np.arange(chain.pelvis_index + 1)

    @jax.jit
    def state(q: Any) -> Any:
        at = robot.joint_to_world_transforms(q)
        T = robot._frame_transform(at, tip, n - 1)
        T_pelvis = robot._frame_transform(at, pelvis, chain.pelvis_index)
        J, J_pelvis = robot._frame_jacobian(at, tip, above_tip), robot._frame_jacobian(at, pelvis, above_pelvis)
        com = jnp.concatenate([share * robot._center_of_mass(at) + rest, T[:3, 3], T_pelvis[:3, 3]])
        J_com = share * robot._center_of_mass_jacobian(at)
        return jnp.concatenate([com, rmat_to_quat_wxyz(T[:3, :3])]), jnp.concatenate([J_com, J, J_pelvis[:3]])

    def tick(q: Array) -> Array:
        places, jacobians = map(np.asarray, state(q))
        com, p, p_pelvis, r = places[:3], places[3:6], places[6:9], places[9:]
        J_com, J, J_pelvis = jacobians[:3], jacobians[3:9], jacobians[9:]
        if dsp:
            rows.double_support(q, com, J_com, p, J[:3], p_pelvis, J_pelvis)
        else:
            x, J_x = pose(r[0], r[1:], p, J)
            rows.single_support(q, com, J_com, x, J_x, p_pelvis, J_pelvis)
        return solve()

    return tick


def roboplan(chain: Chain, walk: Walk, phase: str) -> Tick:
    """Return the tick with roboplan's oink: frame task, joint limits and the barrier of the pelvis; its ProxQP.

    It has no task and no barrier of the CoM, so it has no double support, and single support lacks the cylinder of the
    CoM.
    """
    from roboplan import core, optimal_ik

    if phase == "dsp":
        raise NotImplementedError("it has no task of the CoM")
    scene = core.Scene("biped", core.loadUrdfSceneDescriptionFromXml(chain_urdf(chain)))
    if list(scene.getJointNames()) != chain.names:
        raise RuntimeError("roboplan orders the joints in another way")
    settings, goal = optimal_ik.OinkSettings(), np.eye(4)
    settings.eps_abs, settings.eps_rel = 1e-10, 0.0  # by default it returns the last change again: it is small enough
    oink = optimal_ik.Oink(scene, settings)
    goal[:3, :3], goal[:3, 3] = DQ(walk.x_goal).rotation_matrix(), DQ(walk.x_goal).translation()
    options = optimal_ik.FrameTaskOptions(task_gain=walk.eta * walk.dt)
    tasks = [optimal_ik.FrameTask(oink, scene, core.CartesianConfiguration("base", "tip", goal), options)]
    limits = [optimal_ik.PositionLimit(oink, walk.eta_q * walk.dt)]
    least, most = np.array([-9.0, -9.0, walk.pelvis_height]), np.full(3, 9.0)
    upwards = optimal_ik.ConstraintAxisSelection(x=False, y=False)
    barriers = [
        optimal_ik.PositionBarrier(
            oink, scene, "pelvis", least, most, walk.dt, upwards, gain=walk.eta_pelvis, safe_displacement_gain=0.0
        )
    ]
    change = np.empty(chain.n)

    def tick(q: Array) -> Array:
        oink.solveIk(q, tasks, limits, barriers, change, walk.lam**2)
        return change / walk.dt

    return tick


PEERS: dict[str, Callable[[Chain, Walk, str], Tick]] = {
    "pinocchio + daqp, in place": pinocchio(daqp_in_place),
    "pinocchio + quadprog, in place": pinocchio(quadprog_in_place),
    "pinocchio + clarabel, in place": pinocchio(clarabel_in_place),
    "pinocchio + daqp, qpsolvers": pinocchio_plain("daqp"),
    "pinocchio + quadprog, qpsolvers": pinocchio_plain("quadprog"),
    "dqrobotics + quadprog": dqrobotics,
    "placo": placo,
    "mink + quadprog": mink,
    "pink + quadprog": pink,
    "frax + daqp": frax,
    "roboplan (oink)": roboplan,
}
"""Functions of (chain, walk, phase) that return a tick, a function of q that returns u."""
