"""Every stage of one tick, and beside it the tick of other packages.

    python -m benchmark.tick                  our stages
    python -m benchmark.tick --peers          and what one would use instead, on the same problem

A peer's error is |u - u*| relative to the largest velocity of u*, the answer of the active-set solver, whose
Karush-Kuhn-Tucker residuals are checked. A peer that is not installed is named and left out; their versions are in
benchmark/requirements.txt, for an environment of their own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from benchmark.robots import KINDS, Case, case
from benchmark.timing import interleaved, machine, table  # first: it sets the number of threads
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.qp import make_solver

Tick = Callable[[np.ndarray], np.ndarray]


def ours(of: Case, solver: str) -> Tick:
    """Return our tick, u of q."""
    kept = make_solver(solver)
    return lambda q: kept.solve(of.problem(q)).u


def stages(of: Case, rounds: int) -> str:
    """Time every stage; return a table."""
    model, base, phase = of.model, of.phase.base, of.phase
    kins = {id(q): Kinematics(model, q, base) for q in of.states}
    problems = {id(q): of.problem(q) for q in of.states}
    seen, free = {key: phase.evaluate(kin) for key, kin in kins.items()}, np.full(model.n, np.inf)
    chosen, daqp = make_solver("clarabel"), make_solver("daqp")
    inside: list[float] = []

    def clarabel(q: np.ndarray) -> None:
        inside.append(chosen.solve(problems[id(q)]).solve_time)

    cases = {
        "kinematics": lambda q: Kinematics(model, q, base),
        "errors, distances and gradients": lambda q: phase.evaluate(kins[id(q)]),
        "rows and objective": lambda q: seen[id(q)].problem(of.dt, free),
        "Clarabel, with scaling and check": clarabel,
        "DAQP, with scaling and check": lambda q: daqp.solve(problems[id(q)]),
        "tick with Clarabel": ours(of, "clarabel"),
        "tick with DAQP": ours(of, "daqp"),
    }
    times = interleaved(cases, of.states, rounds)
    tick = times["tick with Clarabel"]
    rows = [[name, f"{t.median:.1f}", f"{t.ratio(tick):.2f}"] for name, t in times.items()]
    solve = 1e6 * float(np.median(inside))
    rows.insert(4, ["Clarabel's own solve alone", f"{solve:.1f}", f"{solve / tick.median:.2f}"])
    return table(["stage", "us", "/ tick with Clarabel"], rows)


def beside(of: Case, rounds: int) -> str:
    """Time our tick and the peers'; return a table."""
    from benchmark import peers

    exact = ours(of, "daqp")
    ticks: dict[str, Tick] = {"dqwalk_ros + clarabel": ours(of, "clarabel"), "dqwalk_ros + daqp": ours(of, "daqp")}
    missing = []
    for name, make in peers.PEERS.items():
        try:
            ticks[name] = make(of)
            ticks[name](of.states[0])
        except ImportError as error:
            missing.append(f"{name} is not here ({error})")
    errors = {}
    for name, tick in ticks.items():
        relative = []
        for q in of.states[::10]:
            u = exact(q)
            relative.append(np.abs(tick(q) - u).max() / np.abs(u).max())
        errors[name] = max(relative)
    times = interleaved(ticks, of.states, rounds, 10)
    first, second = times["dqwalk_ros + clarabel"], times["dqwalk_ros + daqp"]
    rows = [
        [name, f"{t.median:.1f}", f"{first.ratio(t):.2f}", f"{second.ratio(t):.2f}", f"{errors[name]:.0e}"]
        for name, t in sorted(times.items(), key=lambda item: item[1].median)
    ]
    header = ["tick", "us", "ours with Clarabel / it", "ours with DAQP / it", "error, relative"]
    return "\n\n".join([table(header, rows), *missing])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", action="store_true", help="time the packages one would use instead, too")
    parser.add_argument("--joints", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=30)
    args = parser.parse_args()
    packages = ("numpy", "numba", "clarabel", "daqp", "quadprog")
    if args.peers:
        packages += ("dqrobotics", "pin", "pin-pink", "mink", "placo")
    print(machine(packages))
    for name, kind in KINDS.items():
        of = case(args.joints, kind)
        print(f"\n### {name}, {args.joints} joints\n\n{stages(of, args.rounds)}", flush=True)
        if args.peers:
            print(f"\n{beside(of, args.rounds)}", flush=True)


if __name__ == "__main__":
    main()
