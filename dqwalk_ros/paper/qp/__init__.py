"""The quadratic program (U6): `problem`, its solvers `clarabel`, `daqp` and `least_distance`, and `infeasible`."""

import logging

from dqwalk_ros.paper.qp.daqp import DaqpSolver
from dqwalk_ros.paper.qp.least_distance import NnlsSolver
from dqwalk_ros.paper.qp.problem import Solver

__all__ = ["make_solver"]


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"``, ``"daqp"`` or ``"nnls"``, which reuses memory between problems.

    Without Clarabel, scipy's non-negative least squares take its place, and the log says so.

    Raises
    ------
    ConfigError
        If DAQP is chosen and not installed.
    """
    if name == "daqp":
        return DaqpSolver(make_solver("clarabel"))
    if name == "clarabel":
        try:
            from dqwalk_ros.paper.qp.clarabel import ClarabelSolver
        except ImportError:
            logging.getLogger("dqwalk_ros").warning(
                "clarabel is not installed (pip install clarabel): scipy's nnls solves the quadratic programs"
            )
        else:
            return ClarabelSolver()
    return NnlsSolver()
