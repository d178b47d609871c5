"""The first seconds of the paper's walk, in this process."""

from dqwalk_ros import KinematicPlant, load, load_model, make_controller, simulate
from dqwalk_ros.report import analyse, render, report

config = load("paper")
model = load_model(config.robot)
trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=5.0)

print(f"{len(trace)} states, {trace.phases[0].name}, q of the last: {trace.q[-1].round(4)}")
print(render(report(analyse(trace))))
