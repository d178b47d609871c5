"""The whole-body controller: the hand follows a target, on a robot of HRP-2's size (pip install daqp pin)."""

import dataclasses

from dqwalk_ros import load
from dqwalk_ros.whole_body import SCENARIOS
from dqwalk_ros.whole_body.experiments import walk

scenario = dataclasses.replace(SCENARIOS["1"], duration=0.5)  # the first half second of Test 1
trace = walk(load("whole_body"), scenario)
least = {name: values.min() for name, values in trace.margins.items()}
print(f"{len(trace.time)} ticks; {trace.note or 'it stands'}; the hand reaches for {trace.time[-1]:.2f} s")
for name, value in least.items():
    print(f"  least margin of {name}: {value:.4g}")
