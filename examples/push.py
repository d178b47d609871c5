"""Push the pelvis of a robot that stands in MuJoCo; `closed_loop` is the loop into which you insert your own code."""

import numpy as np

from dqwalk_ros import load, load_model, make_controller
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.simulation import closed_loop

config = load("poppy").updated({"gait.steps": 0})
model = load_model(config.robot)
controller, plant = make_controller(config, model), make_plant("physics", config, model)
begin = plant.state.time

for state, _ in closed_loop(controller, plant):
    time = state.time - begin
    pushed = 2.0 <= time < 2.1
    plant.push([3.0, 0.0, 0.0] if pushed else np.zeros(3))  # 0.3 N s ahead
    if time > 3.5:
        break
print("it fell" if plant.fallen else "it stands")
