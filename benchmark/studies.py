"""A study of many short walks in one process and in two.

python -m benchmark.studies [--walks 1000]
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmark.timing import machine, table

STUDY = """\
config: paper
set: {{gait.cycles: 1, qp.solver: daqp, dsp.stall_rate: 0.003, dsp.eta_ground: 100.0, ssp.threshold: 0.02}}
sample: latin_hypercube
count: {walks}
vary:
  gait.step_length: {{from: 0.01, to: 0.03}}
  task.eta: {{from: 0.8, to: 1.2}}
"""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walks", type=int, default=1000)
    args = parser.parse_args()
    print(f"{machine()}\n")
    rows, digests, first = [], set(), 0.0
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder) / "study.yaml"

        def run(walks: int, jobs: int) -> tuple[float, bytes]:
            """Return the time on the clock [s] and the table of results."""
            study.write_text(STUDY.format(walks=walks), encoding="utf-8")
            out = Path(folder) / f"{walks}_on_{jobs}"
            command = ["study", str(study), "--jobs", str(jobs), "--out", str(out)]
            began = time.perf_counter()
            subprocess.run([sys.executable, "-m", "dqwalk_ros.cli", *command], check=True, stdout=subprocess.DEVNULL)
            return time.perf_counter() - began, (out / "walks.parquet").read_bytes()

        run(2, 1)  # compiles
        for jobs in (1, 2):
            took, results = run(args.walks, jobs)
            first = first or took
            digests.add(hashlib.sha256(results).hexdigest())
            rows.append([str(jobs), str(args.walks), f"{took:.1f}", f"{args.walks / took:.1f}", f"{first / took:.2f}"])
    print(table(["processes", "walks", "wall [s]", "walks/s", "times as fast"], rows))
    print(f"\nthe two tables of results are {'the same' if len(digests) == 1 else 'DIFFERENT'}")


if __name__ == "__main__":
    main()
