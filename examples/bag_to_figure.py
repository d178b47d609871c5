"""Write a walk as a bag, read it back, and draw a figure."""

import tempfile
from pathlib import Path

from dqwalk_ros import KinematicPlant, load, load_model, make_controller, simulate
from dqwalk_ros.report import analyse, bag, save

config = load("paper")
model = load_model(config.robot)
trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=2.0)

with tempfile.TemporaryDirectory() as folder:
    bag.write(trace, Path(folder) / "bag")
    again = bag.read(Path(folder) / "bag")  # or any bag of `ros2 bag record`
    print(f"{len(again)} of {len(trace)} states")
    for file in save(analyse(again), Path(folder), ("png",)):
        print(f"{file.name}: {file.stat().st_size} bytes")
