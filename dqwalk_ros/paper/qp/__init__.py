"""The quadratic program (U6): `problem`, its solvers `clarabel` and `daqp`, and what to do if it is `infeasible`."""

from dqwalk_ros.paper.qp.clarabel import ClarabelSolver
from dqwalk_ros.paper.qp.daqp import DaqpSolver
from dqwalk_ros.paper.qp.problem import Solver

__all__ = ["make_solver"]


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"`` or ``"daqp"``; it reuses memory, DAQP also its active set, between problems.

    Raises
    ------
    QPError
        If the solver is not installed.
    """
    return DaqpSolver() if name == "daqp" else ClarabelSolver()
