"""Compiles the package for the tests: its workers and nodes would otherwise all compile the same functions at once.

``python test/support/warm.py walks`` and ``python test/support/warm.py others`` compile in parallel.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numba
import numpy as np

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.estimation.base import BaseEstimator
from dqwalk_ros.paper.features import QUANTITY
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics, compose
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.compiled import digest
from dqwalk_ros.support.interrupts import serve
from dqwalk_ros.walks.arms.tasks import HandInTrunk
from dqwalk_ros.walks.table import make_controller


def walks() -> None:
    """The first ticks of every kind of walk, with both solvers, on its usual plant."""
    short = {"task.eta": 1.0, "dsp.eta_ground": 20.0, "ssp.threshold": 0.02, "dsp.stall_rate": 3e-3, "dt": 0.04}
    physics = "physics" if find_spec("mujoco") else "integrator"
    for name, plant, time in (("paper", "integrator", 6.0), ("poppy", physics, 2.0), ("poppy_dynamic", physics, 1.5)):
        for solver in ("clarabel", "daqp"):
            config = load(name).updated({**(short if name == "paper" else {}), "qp.solver": solver})
            config = overlaid(config, plant) if plant == "physics" else config
            model = load_model(config.robot)
            simulate(make_controller(config, model), make_plant(plant, config, model), max_time=time)


def others() -> None:
    """The first updates of the base estimator, and the tasks of the arms."""
    config = load("poppy")
    model = load_model(config.robot)
    kin, estimator = Kinematics(model, model.posture(config.standing.posture), Foot.LEFT), BaseEstimator(config, model)
    for time in (0.0, 0.005):
        estimator.update(time, kin, np.zeros(3), np.array([0.0, 0.0, 9.81]), both=True)
    QUANTITY.table([HandInTrunk.function])


def compile_all() -> None:
    """Compile in two processes, unless this was done since a compiled function changed, or nothing is compiled."""
    if numba.config.DISABLE_JIT:
        return
    done = Path(compose.stats.cache_path) / f"all_for_tests_{digest(__name__)}"
    if not done.exists():
        parts = [subprocess.Popen([sys.executable, __file__, name]) for name in ("walks", "others")]
        codes = [part.wait() for part in parts]
        if not any(codes):
            done.touch()


if __name__ == "__main__":
    serve(os.getppid())
    {"walks": walks, "others": others}[sys.argv[1]]()
