"""A whole-body walk as one HTML file: verdict, replay, table, figures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.report.colors import BLUE, RED
from dqwalk_ros.report.html.page import bad, figures, heading, origin_table, replay, table, write_page
from dqwalk_ros.report.html.replay import Curve, Mark, Replay, Stretch, frames_of
from dqwalk_ros.report.metrics import support_polygon
from dqwalk_ros.report.scene import bodies_of, on_ground
from dqwalk_ros.whole_body.demands import Demand
from dqwalk_ros.whole_body.figures import drawn
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.trace import WholeBodyTrace

_CURVES = {
    "torque": ("torque, left to the limit", "%", 100.0),
    "joint": ("joints, left to a limit", "°", float(np.degrees(1.0))),
    "cop_margin": ("CoP, left to the edge", "mm", 1e3),
    "friction": ("friction, left to the pyramid", "% m g", 100.0),
}
_ROUNDING = 1e-6
"""Margins smaller than this are shown as zero, because a limit that is reached is not violated."""


def write(
    path: str | os.PathLike[str],
    name: str,
    walked: WholeBodyTrace,
    found: Sequence[Demand],
    notes: Sequence[str],
    *,
    overwrite: bool = False,
) -> None:
    """Write the report of a walk, under the name of its bag, to an HTML file; see `written` for errors."""
    parameters = [(key, str(value)) for key, value in walked.config.flat().items()]
    parts = [
        _heading(name, walked, sum(not check.ok for check in found)),
        replay([name], "Blue ball: hand; red ball: its target. "),
        f"<h2>Requirements and results</h2><div class='card scroll'>{_checks(found)}</div>",
        figures([drawn([walked])]),
        f"<h2>Notes</h2><div class='card'><ul>{''.join(f'<li>{escape(note)}</li>' for note in notes)}</ul></div>",
        "<h2>Configuration</h2><details class='card'><summary>Every parameter</summary>"
        f"{table(('', ''), parameters)}</details>",
        origin_table([(name, walked.origin)]),
    ]
    write_page(path, name, parts, [_body_replay_data(walked)], overwrite=overwrite)


def _heading(name: str, w: WholeBodyTrace, broken: int) -> str:
    late = w.error[w.time > w.time[-1] - 3.0]
    numbers = {
        "time walked": f"{w.time[-1] + w.config.dt:.1f} s",
        "steps": str(max(len(w.footholds()) - 1, 0)),
        "path of the CoM": f"{float(np.linalg.norm((w.com[-1] - w.com[0])[:2])):.2f} m",
        "error of the hand, rms of the last 3 s": f"{1e3 * float(np.sqrt((late**2).mean())):.1f} mm",
        "largest torque, of its limit": f"{100.0 * (1.0 - float(w.margins['torque'].min())):.0f} %",
        "solving, on average": f"{1e3 * float(w.times[:, 2].mean()):.2f} ms",
    }
    numbers = {key: value.replace("nan mm", "–") for key, value in numbers.items()}
    title = w.scenario.name + (f": {w.note}" if w.note else "")
    about = f"{title}; {w.model.name}, {w.model.n} joints, {w.model.mass:.1f} kg"
    return heading(name, f"{broken} not met" if broken else "every requirement met", about, numbers, ok=not broken)


def _checks(found: Sequence[Demand]) -> str:
    rows = []
    for check in found:
        verdict = "" if not check.bound else "ok" if check.ok else bad("not met")
        rows.append(
            (check.name, check.bound, check.got, "" if check.authors is None else f"{check.authors:.4g}", verdict)
        )
    return table(("", "required", "result", "authors", ""), rows, (2, 3))


def _body_replay_data(walked: WholeBodyTrace) -> dict[str, Any]:
    """Return plain data for `replay.js`, as `replay_data` does for a walk of phases."""
    model, rows, began = walked.model, frames_of(walked.time), float(walked.time[0])
    stepping = Stepping.of(walked.config)
    bodies, polygons = [], []
    for row in rows.tolist():
        swing = stepping.swing(float(walked.time[row]))
        base = Foot.LEFT if swing is None else swing.foot.other
        kin = Kinematics(model, walked.q[row], base)
        x = (DQ(walked.x_base[row]) * DQ(kin.pose(model.root)).conj()).vec8()
        bodies.append(bodies_of(kin, x))
        polygons.append(on_ground(support_polygon(model, base, kin, double=swing is None), x))
    places = {Foot.LEFT: walked.left, Foot.RIGHT: walked.right}
    stands = [(0.0, foot, places[foot][0]) for foot in Foot]  # the initial stance
    for index, (when, _) in enumerate(walked.footholds()):
        foot = stepping.foot(index)
        if index:
            stands.append((when - began, foot, places[foot][walked.at(when) + 1]))
    stretches = []
    for k in [0, *(np.flatnonzero(np.diff(walked.single)) + 1).tolist()]:
        swing = stepping.swing(float(walked.time[k]))
        name = "both feet stand" if swing is None else f"the {swing.foot.value} foot swings"
        stretches.append(Stretch(float(walked.time[k]) - began, name, swing is None))
    error = "error of the hand"
    curves = {error: Curve(error, "mm", 1e3 * walked.error[rows])}
    for key, (title, unit, scale) in _CURVES.items():
        values = walked.margins[key][rows]
        known = np.isfinite(values)
        if known.any():
            exact = np.where(np.abs(values) < _ROUNDING, 0.0, values)
            curves[key] = Curve(title, unit, scale * np.where(known, exact, np.nan))
    return Replay(
        config=walked.config, model=model, time=walked.time[rows] - began, bodies=np.array(bodies),
        com=walked.com[rows], polygons=polygons,
        prints=[(when, foot, place + model.soles[foot].corners) for when, foot, place in stands],
        stretches=stretches, curves=curves, tight=[""] * len(rows),
        marks=[Mark(BLUE, walked.hand[rows]), Mark(RED, walked.target[rows])],
    ).data()  # fmt: skip
