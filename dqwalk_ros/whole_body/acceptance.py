"""Everything that the whole-body controller must show, asked for and got: ``dqwalk reach --all``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.robot import load_model
from dqwalk_ros.whole_body.batch import Walk
from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.exactness import Answers, condensed_difference, infeasible, model_difference
from dqwalk_ros.whole_body.reaching import Check, checks
from dqwalk_ros.whole_body.scenario import PAPER_TIMES, SCENARIOS, Scenario
from dqwalk_ros.whole_body.trace import Reaching

__all__ = ["Row", "judge", "render", "unit_rows", "walks"]

_TARGET = SCENARIOS["1"].targets[:1]
_HARD: dict[str, tuple[float, float, dict[str, float]]] = {
    "10 N s to the left at 2.5 s": (2.5, 10.0, {}),
    "15 N s to the left at 2.5 s": (2.5, 15.0, {}),
    "20 N s to the left at 2.5 s": (2.5, 20.0, {}),
    "15 N s to the left at 2.3 s": (2.3, 15.0, {}),
    "15 N s, friction 0.4": (2.5, 15.0, {"whole_body.friction": 0.4}),
    "15 N s, N = 8": (2.5, 15.0, {"whole_body.intervals": 8}),
}
"""When, how hard, and what else is different."""
_FORCES = ("cop_margin", "friction", "normal", "torque", "joint", "step")


@dataclass(frozen=True)
class Row:
    """One demand.

    Attributes
    ----------
    topic, what, asked, got : str
    ok : bool
    must : bool
        False for an aim: a goal that is hoped for, often the authors' figure on another robot.
    """

    topic: str
    what: str
    asked: str
    got: str
    ok: bool
    must: bool = True


def walks() -> dict[str, Walk]:
    """Return the walks that `judge` needs, by name."""
    one, two = SCENARIOS["1"], SCENARIOS["2"]
    off = {"whole_body.capturability": False}
    found = {"1": Walk(one, exact=True), "2": Walk(two, exact=True)}
    for k, (when, _) in enumerate(two.pushes):
        others = (*two.pushes[:k], *two.pushes[k + 1 :])
        name = f"Test 2 without push {k + 1}"
        found[f"2 without {k}"] = Walk(replace(two, name=name, pushes=others, duration=when + 1.4))
    found["paper"] = Walk(replace(one, name="Test 1, the paper's times", targets=PAPER_TIMES))
    found["in place"] = Walk(Scenario("in place", 8.0))
    for name, (when, push, changes) in _HARD.items():
        found[name] = Walk(Scenario(name, 6.0, _TARGET, ((when, (0.0, push, 0.0)),)), changes)
    found["no level 2"] = Walk(Scenario("without level 2, with the hand's target", 2.0, _TARGET), off)
    found["no level 2, in place"] = Walk(Scenario("without level 2, in place", 2.0), off)
    return found


def unit_rows(config: Config) -> list[Row]:
    """Judge the equations by themselves."""
    model = load_model(config.robot)
    mass = WholeBodyController(config, model).point_mass
    forces, places = model_difference(model)
    far = infeasible(config, model)
    topic = "equations"
    return [
        _most(topic, "sum of the alpha of (14), less 1", abs(float(mass.alpha.sum()) - 1.0), 1e-12),
        _most(
            topic,
            "(14) in closed form, and condensed with A and B: coefficients differ by",
            condensed_difference(mass),
            1e-12,
        ),
        _most(topic, "H v' + h and Newton's and Euler's laws link by link differ by [N, N m]", forces, 1e-10),
        _most(topic, "places of soles and CoM, and by dual quaternions, differ by [m]", places, 1e-10),
        Row(topic, "(14) out of reach: solved by", "level 2 relaxed", far.method, far.method == "level 2 relaxed"),
        _most(topic, "(14) out of reach: level 1 violated by", far.level1, 1e-6),
        Row(
            topic,
            "(14) out of reach: ||E x - e||, and the least there is [m]",
            "equal to 1e-5",
            f"{far.residual:.7f}, {far.least:.7f}",
            abs(far.residual - far.least) <= 1e-5 < far.least,
        ),
    ]


def judge(walked: Mapping[str, Reaching], answers: Answers) -> list[Row]:
    """Judge the walks of `walks`, and the answers of Tests 1 and 2."""
    one, two = walked["1"], walked["2"]
    found = {"1": checks(one), "2": checks(two, [walked["2 without 0"], walked["2 without 1"]])}
    found["paper"] = checks(walked["paper"])
    rows = _answers(answers)
    for key in ("1", "paper", "2"):
        topic = walked[key].scenario.name
        shown = [check for check in found[key] if check.bound]
        rows += [_row(topic, check) for check in shown if not _every_tick(check)]
        rows += _aims(topic, found[key])
    both = [check for key in ("1", "2") for check in found[key] if _every_tick(check)]
    for name in dict.fromkeys(check.name for check in both):
        alike = [check for check in both if check.name == name]
        worst = max if alike[0].bound == "0" else min
        rows.append(_row("every tick of both", worst(alike, key=lambda check: check.value)))
    rows += _in_place(walked["in place"])
    rows += [_stands("robust", name, walked[name]) for name in _HARD]
    for name in ("no level 2", "no level 2, in place"):
        w = walked[name]
        end = w.note.partition(":")[0] or "stood"
        rows.append(Row("negative", w.scenario.name, "falls within 2 s", end, w.note.startswith("fell")))
    return rows + _times([one, two])


def _every_tick(check: Check) -> bool:
    return check.name.startswith(("least ", "ticks "))


def _answers(seen: Answers) -> list[Row]:
    topic, all_of_them = "answers", f"{seen.ticks} ticks"
    return [
        _most(topic, f"equality residual of {all_of_them} of Tests 1 and 2", seen.equality, 1e-6),
        _most(topic, f"inequality violation of {all_of_them}", seen.inequality, 1e-6),
        _most(topic, f"v' and Clarabel's, {seen.sampled} ticks, differ by [rad/s^2]", seen.acceleration, 1e-3),
    ]


def _aims(topic: str, found: Sequence[Check]) -> list[Row]:
    """Return the goals beyond what must be: the authors' figures, and 0.10 m where they have that and more."""
    rows = []
    for check in found:
        if check.name.startswith("footstep moved"):
            what = check.name.replace("footstep", "aim: footstep")
            rows.append(Row(topic, what, ">= 0.1", f"{check.value:.4g} m", check.value >= 0.1, must=False))
        elif check.name.endswith("rms of the last 3 s") and topic != "Test 2":
            got, ok = f"{1e3 * check.value:.2f} mm", round(1e3 * check.value, 1) <= 8.4
            rows.append(Row(topic, "the authors' figure for that", "<= 8.4 mm", got, ok, must=False))
    return rows


def _in_place(w: Reaching) -> list[Row]:
    topic = "in place, 8 s"
    places = np.array([place for _, place in w.footholds()])
    drift = float(np.abs(places[2:] - places[:-2]).max()) if len(places) > 2 else float("nan")
    speed = float(np.abs(w.com_velocity[:, 1]).max())
    missed = int((w.capturability > 1e-6).sum())
    rows = [
        _stands(topic, "without the hand's objective", w),
        _most(topic, "a foot's place from one of its steps to the next, at most [m]", drift, 0.06),
        _most(topic, "CoM off its height, at most [m]", float(np.abs(w.height_error).max()), 1e-3),
        _most(topic, "torso off upright, at most [rad]", float(w.tilt.max()), 0.02),
        Row(topic, "lateral speed of the CoM, at most [m/s]", "0.2 to 0.45", f"{speed:.3g}", 0.2 <= speed <= 0.45),
        Row(topic, "ticks that miss capturability (14)", "0", str(missed), missed == 0),
    ]
    least = {name: float(w.margins[name].min()) for name in _FORCES}
    tightest = min(least, key=lambda name: least[name])
    ok = all(value >= (-1e-5 if name == "joint" else -1e-6) for name, value in least.items())
    got = f"{least[tightest]:.2g} ({tightest.removesuffix('_margin')})"
    return [*rows, Row(topic, "CoP, forces, torques, joints, steps: least distance to a limit", ">= 0", got, ok)]


def _times(walked: Sequence[Reaching]) -> list[Row]:
    spent = 1e3 * np.vstack([w.times for w in walked])
    solve, tick = spent[:, 2], spent[:, 3]
    topic = "CPU time, Tests 1, 2"
    mean = float(solve.mean())
    return [
        Row(topic, "solution, mean (the paper's: 0.92 ms, 2012)", "< 0.92 ms", f"{mean:.2f} ms", mean < 0.92),
        Row(topic, "solution, mean", "< 0.5 ms", f"{mean:.2f} ms", mean < 0.5, must=False),
        _percentile(topic, "solution, 99 %", solve, 1.5),
        _percentile(topic, "whole tick, 99 %", tick, 5.0),
    ]


def _percentile(topic: str, what: str, values: np.ndarray[tuple[int, ...], np.dtype[np.float64]], most: float) -> Row:
    value = float(np.percentile(values, 99))
    return Row(topic, what, f"< {most:g} ms", f"{value:.2f} ms", value < most)


def _stands(topic: str, what: str, w: Reaching) -> Row:
    return Row(topic, what, "stands", f"stood {w.time[-1] + w.config.dt:.1f} s" if w.stood else w.note, w.stood)


def _most(topic: str, what: str, value: float, most: float) -> Row:
    return Row(topic, what, f"<= {most:g}", f"{value:.2g}", value <= most)


def _row(topic: str, check: Check) -> Row:
    return Row(topic, check.name, check.bound, f"{check.value:.4g} {check.unit}".strip(), check.ok)


def _word(row: Row) -> str:
    return "ok" if row.ok else "NOT OK" if row.must else "aim not reached"


def render(rows: Sequence[Row]) -> str:
    """Return the table, and below it what it comes to."""
    cells = [("", "", "asked", "got", "")]
    topic = ""
    for row in rows:
        cells.append(("" if row.topic == topic else row.topic, row.what, row.asked, row.got, _word(row)))
        topic = row.topic
    width = [max(len(row[i]) for row in cells) for i in range(5)]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip() for row in cells]
    must, aims = [row for row in rows if row.must], [row for row in rows if not row.must]
    met, reached = sum(row.ok for row in must), sum(row.ok for row in aims)
    total = f"{met} of {len(must)} demands met, {reached} of {len(aims)} aims reached"
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:], "", total])
