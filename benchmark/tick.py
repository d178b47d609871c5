"""Time of each stage of one tick, and of the same tick written with other packages.

    python -m benchmark.tick                  stages of this package
    python -m benchmark.tick --peers          and other packages, on the same problem

The error of another package is |u - u*| relative to the largest velocity of u*, the solution of the active-set
solver, whose Karush-Kuhn-Tucker residuals are checked. A package that is not installed is named and omitted; the
versions are in benchmark/requirements.txt, for a separate environment.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable

import numpy as np

from benchmark.biped import PHASES, Chain, Walk, biped, states, walk_of
from benchmark.peer_adapter import make_clarabel, make_daqp, phase_of, robot_of
from benchmark.timing import interleaved, machine, table  # first: it sets the number of threads
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.qp import make_solver

Array = np.ndarray
UP = np.array([0.0, 0.0, 1.0])
Tick = Callable[[Array], Array]
OURS = {"dqwalk_ros + clarabel": make_clarabel, "dqwalk_ros + daqp": make_daqp}


def stages(chain: Chain, walk: Walk, kind: str, rounds: int) -> str:
    """Time every stage; return a table."""
    model = robot_of(chain)
    phase = phase_of(model, walk, kind)
    # each stage is timed alone, on states of the walk
    qs = states(make_daqp(chain, walk, kind), walk)
    no_limit = np.full(model.n, math.inf)
    problems = {id(q): phase.evaluate(q, UP, math.inf, walk.dt, no_limit).problem for q in qs}
    clarabel, daqp = make_solver("clarabel"), make_solver("daqp")
    inside: list[float] = []

    def solve(q: Array) -> None:
        inside.append(clarabel.solve(problems[id(q)]).solve_time)

    cases = {
        "kinematics alone": lambda q: Kinematics(model, q, phase.base),
        "joint angles to quadratic program": lambda q: phase.evaluate(q, UP, math.inf, walk.dt, no_limit),
        "Clarabel, with scaling and check": solve,
        "DAQP, with scaling and check": lambda q: daqp.solve(problems[id(q)]),
        "tick with Clarabel": make_clarabel(chain, walk, kind),
        "tick with DAQP": make_daqp(chain, walk, kind),
    }
    times = interleaved(cases, qs, rounds)
    whole = times["tick with Clarabel"]
    rows = [[name, f"{t.median:.1f}", f"{t.ratio(whole):.2f}"] for name, t in times.items()]
    alone = 1e6 * float(np.median(inside))
    rows.insert(3, ["Clarabel's own solve alone", f"{alone:.1f}", f"{alone / whole.median:.2f}"])
    return table(["stage", "us", "/ tick with Clarabel"], rows)


def beside(chain: Chain, walk: Walk, kind: str, rounds: int) -> str:
    """Time the tick of this package and of the others; return a table."""
    from benchmark.peers import PEERS

    exact = make_daqp(chain, walk, kind)
    qs = states(exact, walk)
    ticks: dict[str, Tick] = {name: make(chain, walk, kind) for name, make in OURS.items()}
    absent, unable = list[str](), list[str]()
    for name, make in PEERS.items():
        try:
            ticks[name] = make(chain, walk, kind)
            ticks[name](qs[0])
        except ImportError:
            ticks.pop(name, None)
            absent.append(name)
        except NotImplementedError as error:
            unable.append(f"Without {name}: {error}.")
    errors = {}
    for name, tick in ticks.items():
        answers = [(tick(q), exact(q)) for q in qs[::10]]
        errors[name] = max(np.abs(u - v).max() / np.abs(v).max() for u, v in answers)
    times = interleaved(ticks, qs, rounds, 10)
    first, second = (times[name] for name in OURS)
    rows = [
        [name, f"{t.median:.1f}", f"{first.ratio(t):.2f}", f"{second.ratio(t):.2f}", f"{errors[name]:.0e}"]
        for name, t in sorted(times.items(), key=lambda item: item[1].median)
    ]
    header = ["tick", "us", "ours with Clarabel / it", "ours with DAQP / it", "error, relative"]
    missing = [f"Not installed in this environment: {'; '.join(absent)}."] if absent else []
    return "\n\n".join([table(header, rows), *unable, *missing])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", action="store_true", help="also time other packages")
    parser.add_argument("--rounds", type=int, default=40)
    args = parser.parse_args()
    warnings.filterwarnings("ignore", message="Converted matrix")
    packages = ("numpy", "numba", "clarabel", "daqp", "quadprog")
    if args.peers:
        packages += ("dqrobotics", "pin", "pin-pink", "mink", "placo", "qpsolvers", "frax", "jax", "roboplan")
    print(machine(packages))
    chain = biped()
    walk = walk_of(chain)
    for kind, name in PHASES.items():
        print(f"\n### {name.capitalize()}, {chain.n} joints\n\n{stages(chain, walk, kind, args.rounds)}", flush=True)
        if args.peers:
            print(f"\n{beside(chain, walk, kind, args.rounds)}", flush=True)


if __name__ == "__main__":
    main()
