"""A study: the same walk with varied parameters in two processes (pip install distributed pyarrow)."""

import tempfile
from pathlib import Path

from dqwalk_ros.studies import read, walk_all

TEXT = """\
config: paper
set: {task.eta: 2.0, task.damping: 0.02, ssp.threshold: 0.02, dsp.stall_rate: 0.005, gait.phase_timeout: 3.0}
vary:
  gait.step_length: [0.01, 0.02]
"""

if __name__ == "__main__":  # the processes import this file, too
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "lengths.yaml"
        file.write_text(TEXT, encoding="utf-8")
        rows = walk_all(read(file), Path(folder) / "out", jobs=2)
        for row in rows:
            print(f"{row['gait.step_length']} m: finished {row['finished']}, {row['duration']} s, {row['steps']} steps")
