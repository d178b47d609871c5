"""The standing walk in MuJoCo: one step of the whole Poppy (pip install mujoco)."""

from dqwalk_ros import load, load_model, make_controller
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.simulation import simulate

config = load("poppy").updated({"gait.steps": 1})
model = load_model(config.robot)
trace = simulate(make_controller(config, model), make_plant("physics", config, model))

print(f"{'finished' if trace.finished else '; '.join(trace.notes)} after {trace.time[-1]:.2f} s")
for phase in trace.phases:
    print(f"  {phase.time:5.2f} s  {phase.name}")
