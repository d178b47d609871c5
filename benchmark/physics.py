"""Time of the closed loop in physics and of the engine's steps alone: same robot, same steps, alternately.

Then the time of the same walk in two engines, MuJoCo and Drake.

python -m benchmark.physics [--ticks 2000]
"""

from __future__ import annotations

import argparse
import itertools
import time

import mujoco
import numpy as np

from benchmark.timing import machine, table  # first: it sets the number of threads
from dqwalk_ros.config import load, overlaid
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.table import plant_type
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.walks.table import make_controller

CHUNK = 100
WALKS = {"poppy": 0.015, "poppy_dynamic": 0.1}
"""Configuration of each walk, and its speed [m/s]."""


def walk(name: str, solver: str, ticks: int) -> tuple[float, float, float]:
    """Return the CPU time per tick [us] of the engine alone, the plant, and the controller."""
    config = overlaid(load(name), "physics").updated({"qp.solver": solver, "gait.steps": 0})
    model = load_model(config.robot)
    controller = make_controller(config, model)
    plant = PhysicsPlant(config, model, model.posture(config.standing.posture))
    controller.steer(WALKS[name], 0.0, 0.0)
    again, steps = mujoco.MjData(plant.mj), round(config.dt / plant.mj.opt.timestep)
    state = plant.state
    spent = np.zeros((0, 3))
    for _ in range(ticks // CHUNK + 1):
        mujoco.mj_copyData(again, plant.mj, plant.data)
        controls, in_controller, in_plant = [], 0.0, 0.0
        for _ in range(CHUNK):
            t0 = time.process_time()
            command = controller.step(state, config.dt)
            t1 = time.process_time()
            state = plant.step(command, config.dt)
            t2 = time.process_time()
            in_controller, in_plant = in_controller + t1 - t0, in_plant + t2 - t1
            controls.append(plant.data.ctrl.copy())
        t0 = time.process_time()
        for control in controls:
            again.ctrl[:] = control
            mujoco.mj_step(plant.mj, again, steps)
        engine = time.process_time() - t0
        assert np.array_equal(again.qpos, plant.data.qpos), "these are not the same steps"
        spent = np.vstack([spent, [engine, in_plant, in_controller]])
    assert not plant.fallen
    return tuple(1e6 / CHUNK * np.median(spent[1:], axis=0))  # the first chunk compiles


def engines(name: str, ticks: int) -> dict[str, float]:
    """Return the CPU time per tick [us] of the plant in each engine, both driven by controllers of their own."""
    config = overlaid(load(name), "physics").updated({"gait.steps": 0})
    model = load_model(config.robot)
    plants, spent = {}, {}
    for engine in ("physics", "drake"):
        controller = make_controller(config, model)
        plants[engine] = plant_type(engine).of(config, model, model.posture(config.standing.posture)), controller
        controller.steer(WALKS[name], 0.0, 0.0)
        spent[engine] = []
    for _ in range(ticks // CHUNK + 1):
        for engine, (plant, controller) in plants.items():
            total = 0.0
            for _ in range(CHUNK):
                command = controller.step(plant.state, config.dt)
                t0 = time.process_time()
                plant.step(command, config.dt)
                total += time.process_time() - t0
            spent[engine].append(1e6 * total / CHUNK)
    return {engine: float(np.median(times[1:])) for engine, times in spent.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=2000)
    args = parser.parse_args()
    print(f"{machine()}\n")
    rows = []
    for name, solver in itertools.product(WALKS, ("clarabel", "daqp")):
        engine, plant, controller = walk(name, solver, args.ticks)
        loop = plant + controller
        rows.append([name, solver, *(f"{x:.0f}" for x in (engine, plant, controller, loop)), f"{loop / engine:.2f}"])
    print(
        table(
            ["configuration", "solver", "engine [us]", "plant [us]", "controller [us]", "loop [us]", "loop / engine"],
            rows,
        )
    )
    print("\nmedians of CPU time per tick; the engine is mj_step on the same controls, the plant contains it")
    rows = []
    for name in WALKS:
        took = engines(name, args.ticks)
        rows.append([name, *(f"{took[x]:.0f}" for x in took), f"{took['drake'] / took['physics']:.1f}"])
    print("\n" + table(["configuration", "MuJoCo [us]", "Drake [us]", "Drake / MuJoCo"], rows))
    print("\nmedians of CPU time per tick of the plant")


if __name__ == "__main__":
    main()
