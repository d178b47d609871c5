"""Compiles the package for the tests: its workers and nodes would otherwise all compile the same functions at once.

``python test/warm.py walks`` and ``python test/warm.py estimator`` compile about the same amount.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

from dqwalk_ros.config import load
from dqwalk_ros.estimation.base import BaseEstimator
from dqwalk_ros.kinematics import Kinematics, compose
from dqwalk_ros.robot import Foot, load_model
from dqwalk_ros.simulation import make_controller, make_plant, simulate


def walks() -> None:
    """The first ticks of every kind of walk, with both solvers."""
    short = {"task.eta": 1.0, "dsp.eta_ground": 20.0, "ssp.threshold": 0.02, "dsp.stall_rate": 3e-3, "dt": 0.04}
    for name, changes, time in (("paper", short, 6.0), ("poppy", {}, 2.0), ("poppy_dynamic", {}, 1.5)):
        for solver in ("clarabel", "daqp"):
            config = load(name).updated({**changes, "qp.solver": solver})
            model = load_model(config.robot)
            simulate(make_controller(config, model), make_plant("kinematic", config, model), max_time=time)


def estimator() -> None:
    """The first updates of the base estimator."""
    config = load("poppy")
    model = load_model(config.robot)
    kin, estimator = Kinematics(model, model.posture(config.standing.posture), Foot.LEFT), BaseEstimator(config, model)
    for time in (0.0, 0.005):
        estimator.update(time, kin, np.zeros(3), np.array([0.0, 0.0, 9.81]), both=True)


def compile_all() -> None:
    """Compile in two processes, unless there is compiled code of this folder already."""
    if not any(Path(compose.stats.cache_path).glob("*.nbi")):
        parts = [subprocess.Popen([sys.executable, __file__, name]) for name in ("walks", "estimator")]
        for part in parts:
            part.wait()


if __name__ == "__main__":
    {"walks": walks, "estimator": estimator}[sys.argv[1]]()
