"""The tick of a phase in packages that bring an inverse-kinematics solver of their own: pink, mink and placo.

Each is given the phase in its own terms: tasks, limits, and whatever it has for rows that it does not know (barriers
in pink, a limit in mink, half spaces over the joints in placo). The rows themselves come from `peers.Program`. placo
takes no task from outside: it follows its own CoM and frame tasks, which is another program of the same size.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmark.peers import Chain, Places, Poses, Program, ordered
from benchmark.robots import Case
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.tasks import ComOverFoot

__all__ = ["mink", "pink", "placo"]

Array = np.ndarray


def pink(of: Case) -> Callable[[Array], Array]:
    """Return the tick with pink and quadprog."""
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.barriers import Barrier
    from pink.limits import ConfigurationLimit
    from pink.tasks import Task

    chain, program, x_end, dt = Chain(of), ordered(Program(of), Chain(of)), Poses(of), of.dt
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(chain.urdf(), encoding="utf-8")
        model = pin.buildModelFromUrdf(str(path))
    model.lowerPositionLimit, model.upperPositionLimit = program.q_min, program.q_max
    configuration = Configuration(model, model.createData(), np.zeros(chain.n))
    share, rest = chain.moving()
    places = _Newest()

    def look() -> None:
        model, data = configuration.model, configuration.data
        T = configuration.get_transform_frame_to_world("end")
        R, p = T.rotation, T.translation
        J = np.concatenate([R @ half for half in np.split(configuration.get_frame_jacobian("end"), 2)])
        pelvis = configuration.get_transform_frame_to_world("pelvis")
        J_pelvis = pelvis.rotation @ configuration.get_frame_jacobian("pelvis")[:3]
        J_com = share * pin.jacobianCenterOfMass(model, data, configuration.q)
        com = share * data.com[0] + rest
        places.at = Places(R, p, J[:3], J[3:], pelvis.translation, J_pelvis, com, J_com, *x_end(R, p, J))

    class Aim(Task):
        def compute_error(self, configuration: Configuration) -> Array:
            return program.task(places.at)[1]

        def compute_jacobian(self, configuration: Configuration) -> Array:
            return program.task(places.at)[0]

        def __repr__(self) -> str:
            return "Aim()"

    class Hold(Task):
        def compute_error(self, configuration: Configuration) -> Array:
            return -dt * program.holds(places.at)[1]

        def compute_jacobian(self, configuration: Configuration) -> Array:
            return program.holds(places.at)[0]

        def __repr__(self) -> str:
            return "Hold()"

    class Rows(Barrier):
        def compute_barrier(self, configuration: Configuration) -> Array:
            return -program.rows(places.at)[1]

        def compute_jacobian(self, configuration: Configuration) -> Array:
            return program.rows(places.at)[0]

    holds, rows = len(of.phase.equalities), len(of.phase.inequalities)
    tasks = [Aim(cost=1.0, gain=of.phase.eta * dt)]
    constraints = [Hold(cost=1.0, gain=1.0)] if holds else None
    limits = [ConfigurationLimit(model, config_limit_gain=program.eta_q * dt)]
    barriers = [Rows(rows, gain=1.0)]

    def tick(q: Array) -> Array:
        configuration.update(q[chain.order])
        look()
        u = solve_ik(
            configuration, tasks, dt, solver="quadprog", damping=of.phase.damping**2, limits=limits,
            barriers=barriers, constraints=constraints, safety_break=False,
        )  # fmt: skip
        return u[chain.back]

    return tick


def mink(of: Case) -> Callable[[Array], Array]:
    """Return the tick with mink (MuJoCo) and quadprog."""
    import mujoco
    from mink import Configuration, ConfigurationLimit, solve_ik
    from mink.limits.limit import Constraint, Limit
    from mink.tasks import Task

    chain, program, x_end, dt = Chain(of), ordered(Program(of), Chain(of)), Poses(of), of.dt
    model = mujoco.MjModel.from_xml_string(chain.mjcf(program.q_min, program.q_max))
    configuration = Configuration(model)
    end, pelvis = model.site("end").id, model.site("pelvis").id
    places = _Newest()

    def look() -> None:
        model, data, n = configuration.model, configuration.data, chain.n
        J, J_pelvis, J_com = np.empty((6, n)), np.empty((3, n)), np.empty((3, n))
        mujoco.mj_jacSite(model, data, J[:3], J[3:], end)
        mujoco.mj_jacSite(model, data, J_pelvis, None, pelvis)
        mujoco.mj_jacSubtreeCom(model, data, J_com, 1)
        R, p = data.site_xmat[end].reshape(3, 3), data.site_xpos[end]
        places.at = Places(
            R, p, J[:3], J[3:], data.site_xpos[pelvis], J_pelvis, data.subtree_com[1], J_com, *x_end(R, p, J)
        )

    class Aim(Task):
        def compute_error(self, configuration: Configuration) -> Array:
            return program.task(places.at)[1]

        def compute_jacobian(self, configuration: Configuration) -> Array:
            return program.task(places.at)[0]

    class Hold(Task):
        def compute_error(self, configuration: Configuration) -> Array:
            return -dt * program.holds(places.at)[1]

        def compute_jacobian(self, configuration: Configuration) -> Array:
            return program.holds(places.at)[0]

    class Rows(Limit):
        def compute_qp_inequalities(self, configuration: Configuration, dt: float) -> Constraint:
            J, least = program.rows(places.at)
            return Constraint(-J, -dt * least)

    size = 2 if program.com_task else 8
    tasks = [Aim(cost=np.ones(size), gain=of.phase.eta * dt)]
    holds = len(of.phase.equalities)
    constraints = [Hold(cost=np.ones(holds), gain=1.0)] if holds else None
    limits = [Rows(), ConfigurationLimit(model, gain=program.eta_q * dt)]

    def tick(q: Array) -> Array:
        configuration.update(q[chain.order])
        look()
        damping = of.phase.damping**2
        return solve_ik(configuration, tasks, dt, "quadprog", damping, limits=limits, constraints=constraints)[
            chain.back
        ]

    return tick


def placo(of: Case) -> Callable[[Array], Array]:
    """Return the tick with placo."""
    import placo as package

    chain, program, dt, n = Chain(of), ordered(Program(of), Chain(of)), of.dt, of.model.n
    x_end = Poses(of)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(chain.urdf(), encoding="utf-8")
        robot = package.RobotWrapper(str(path), package.Flags.ignore_collisions)
    if list(robot.joint_names()) != [f"q{i}" for i in range(n)]:
        raise RuntimeError("placo orders the joints in another way")
    solver = package.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.dt = dt
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)
    solver.add_regularization_task(of.phase.damping**2)
    if program.com_task:
        aim = solver.add_com_task(np.zeros(3))
        aim.mask.set_axises("xy", "task")
        aim.configure("aim", "soft", 1.0)
    else:
        aim = solver.add_frame_task("end", np.eye(4))
        aim.configure("aim", "soft", 1.0, 1.0)
    holds, rows = len(of.phase.equalities), len(of.phase.inequalities)
    A = np.zeros((2 * holds + rows + 2 * n, n + 7))  # an equality is two half spaces
    A[-2 * n : -n, 7:], A[-n:, 7:] = np.eye(n), -np.eye(n)
    spaces = solver.add_joint_space_half_spaces_constraint(A, np.zeros(len(A)))
    spaces.configure("rows", "hard", 1.0)

    def tick(q: Array) -> Array:
        q = q[chain.order]
        state = robot.state
        state.q[7:] = q
        robot.state = state
        robot.update_kinematics()
        T = robot.get_T_world_frame("end")
        R, p, com = T[:3, :3], T[:3, 3], robot.com_world()
        J = robot.frame_jacobian("end", "local_world_aligned")[:, 6:]
        J_pelvis = robot.frame_jacobian("pelvis", "local_world_aligned")[:3, 6:]
        pelvis, J_com = robot.get_T_world_frame("pelvis")[:3, 3], robot.com_jacobian()[:, 6:]
        at = Places(R, p, J[:3], J[3:], pelvis, J_pelvis, com, J_com, *x_end(R, p, J))
        if isinstance(of.phase.tasks[0], ComOverFoot):
            foot = program.point(of.phase.tasks[0].foot, at)[0]
            target = com.copy()
            target[:2] -= of.phase.eta * dt * (com - foot)[:2]
            aim.target_world = target
        else:
            target, goal = T.copy(), DQ(of.phase.tasks[0].target).translation()
            target[:3, 3] -= of.phase.eta * dt * (p - goal)
            aim.T_world_frame = target
        E, e = program.holds(at)
        G, h = program.rows(at)
        A[:holds, 7:], A[holds : 2 * holds, 7:], A[2 * holds : 2 * holds + rows, 7:] = E, -E, -G
        upper, lower = program.eta_q * (program.q_max - q), program.eta_q * (program.q_min - q)
        spaces.A = A
        spaces.b = A[:, 7:] @ q + dt * np.concatenate([e, -e, -h, upper, -lower])
        return (solver.solve(False)[6:] / dt)[chain.back]

    return tick


class _Newest:
    """Where everything is at the state that was looked at last."""

    at: Places
