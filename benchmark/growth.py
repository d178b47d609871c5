"""How a tick grows with the number of joints and with the number of rows.

python -m benchmark.growth [--most-joints 100] [--most-rows 1000]
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from benchmark.robots import KINDS, Case, case
from benchmark.timing import interleaved, machine, table  # first: it sets the number of threads
from dqwalk_ros.constraints import PointOverPlane
from dqwalk_ros.geometry import Plane
from dqwalk_ros.kinematics import Point
from dqwalk_ros.qp import make_solver

JOINTS = (6, 12, 24, 48, 100)
ROWS = (10, 30, 100, 300, 1000)


def with_rows(of: Case, rows: int) -> Case:
    """Return the case with planes around the robot, so that it has so many rows besides joint limits."""
    rng = np.random.default_rng(0)
    frames = list(of.model.frames)
    planes = []
    for k in range(rows - len(of.phase.inequalities)):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        point = Point(frames[k % len(frames)], 0.05 * rng.normal(size=3))
        planes.append(PointOverPlane(name=f"plane{k}", eta=5.0, point=point, plane=Plane(n, -2.0)))
    phase = dataclasses.replace(of.phase, inequalities=(*of.phase.inequalities, *planes))
    return dataclasses.replace(of, phase=phase)


def times(of: Case, rounds: int) -> dict[str, float]:
    """Median time of a tick by solver [us]."""
    solvers = {name: make_solver(name) for name in ("clarabel", "daqp")}

    def tick(solver, q):
        return solver.solve(of.problem(q))

    cases = {name: (lambda q, s=solver: tick(s, q)) for name, solver in solvers.items()}
    return {name: t.median for name, t in interleaved(cases, of.states[:40], rounds, 5).items()}


def grown(sizes: list[int], found: list[dict[str, float]], what: str, first: int) -> str:
    """Return the table, and the exponents between the sizes from `first` on."""
    names = list(found[0])
    rows = [[str(size), *(f"{t[name]:.0f}" for name in names)] for size, t in zip(sizes, found, strict=True)]
    at = sizes.index(first)
    span = np.log(sizes[-1] / sizes[at])
    rows.append(
        [f"exponent {first} to {sizes[-1]}", *(f"{np.log(found[-1][n] / found[at][n]) / span:.2f}" for n in names)]
    )
    return table([what, *(f"{name} [us]" for name in names)], rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most-joints", type=int, default=JOINTS[-1])
    parser.add_argument("--most-rows", type=int, default=ROWS[-1])
    parser.add_argument("--rounds", type=int, default=8)
    args = parser.parse_args()
    print(machine())
    for name, kind in KINDS.items():
        sizes = [n for n in JOINTS if n <= args.most_joints]
        found = [times(case(n, kind, 200, 40), args.rounds) for n in sizes]
        print(f"\n### {name}, by joints\n\n{grown(sizes, found, 'joints', 12)}", flush=True)
        rows = [m for m in ROWS if m <= args.most_rows]
        twelve = case(12, kind, 200, 40)
        found = [times(with_rows(twelve, m), args.rounds) for m in rows]
        print(f"\n### {name}, 12 joints, by rows\n\n{grown(rows, found, 'rows', 10)}", flush=True)


if __name__ == "__main__":
    main()
