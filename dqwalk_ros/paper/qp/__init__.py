"""The quadratic program (U6): `problem`, its solvers `clarabel`, `daqp` and `least_distance`, and `infeasible`."""

import logging

import numpy as np

from dqwalk_ros.paper.qp.daqp import DaqpSolver
from dqwalk_ros.paper.qp.least_distance import NnlsSolver, Solver
from dqwalk_ros.paper.qp.problem import Problem

__all__ = ["make_solver"]

_FIRST = Problem.of(np.eye(1), np.ones(1), np.empty((0, 1)), np.empty(0), -np.ones(1), np.ones(1))
"""A problem that compiles what a solver calls, so that the first one in which an inequality binds is not late."""


def make_solver(name: str) -> Solver:
    """Return a new solver, ``"clarabel"``, ``"daqp"`` or ``"nnls"``, which reuses memory between problems.

    Without Clarabel, scipy's non-negative least squares take its place, and the log says so.

    Raises
    ------
    ConfigError
        If DAQP is chosen and not installed.
    """
    solver = DaqpSolver(make_solver("clarabel")) if name == "daqp" else _made(name)
    solver.constrained(_FIRST)
    return solver


def _made(name: str) -> Solver:
    """Return Clarabel's solver, or scipy's."""
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
