"""The paper's walk, in this process."""

from dqwalk_ros import KinematicPlant, load, load_model, make_controller, simulate
from dqwalk_ros.report import analyse, render, report

config = load("paper")
model = load_model(config.robot)
trace = simulate(make_controller(config, model), KinematicPlant(model))

print(f"{len(trace)} states, {len(trace.phases)} phases, q of the last: {trace.q[-1].round(4)}")
print(render(report(analyse(trace))))
