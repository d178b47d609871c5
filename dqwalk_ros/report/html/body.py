"""A whole-body walk as one HTML file: verdict, replay, table, figures."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.report.figures.reaching import reactions, solver, walk_from_above
from dqwalk_ros.report.figures.style import drawing
from dqwalk_ros.report.html.page import Markup, document, origin_table, replay, table
from dqwalk_ros.report.html.replay import FRAMES, packed, robot_data, rounded
from dqwalk_ros.robot import Foot
from dqwalk_ros.whole_body.demands import Demand
from dqwalk_ros.whole_body.preview import Stepping
from dqwalk_ros.whole_body.trace import WholeBodyTrace

__all__ = ["BodySubject", "body_replay_data", "write"]

_CURVES = {
    "torque": ("torque, left to the limit", "%", 100.0),
    "joint": ("joints, left to a limit", "°", float(np.degrees(1.0))),
    "cop_margin": ("CoP, left to the edge", "mm", 1e3),
    "friction": ("friction, left to the pyramid", "% m g", 100.0),
}
_ROUNDING = 1e-6
"""Margins smaller than this are shown as zero, because a limit that is reached is not violated."""
_CAPTIONS = (
    "Figure 2: solving time of the hierarchy, and changes of its active set.",
    "Figure 3: from above.",
    "Figures 4, 5: target, hand, support and the velocity of the centre of mass.",
)


@dataclass(frozen=True)
class BodySubject:
    """A whole-body walk to report on.

    Attributes
    ----------
    name : str
        Of the bag.
    walked : WholeBodyTrace
    found : sequence of Demand
    off : float
        Largest difference between recorded and recomputed torques [N m].
    notes : sequence of str
    """

    name: str
    walked: WholeBodyTrace
    found: Sequence[Demand]
    off: float
    notes: Sequence[str] = ()


def write(subject: BodySubject, path: str | os.PathLike[str]) -> None:
    """Write the report of a walk to an HTML file."""
    Path(path).write_text(_page(subject), encoding="utf-8")


def _page(subject: BodySubject) -> str:
    w = subject.walked
    parts = [
        _heading(subject),
        f"<h2>Replay</h2><div class='card'>{replay([subject.name], 'Blue ball: hand; red ball: its target. ')}</div>",
        f"<h2>Requirements and results</h2><div class='card scroll'>{_checks(subject.found)}</div>",
        _figures(w),
        f"<h2>Notes</h2><div class='card'>{_notes(subject)}</div>",
        "<h2>Configuration</h2><details class='card'><summary>Every parameter</summary>"
        + table(("", ""), [(key, str(value)) for key, value in w.config.flat().items()])
        + "</details>",
        origin_table([(subject.name, w.origin)]),
    ]
    return document(subject.name, parts, [body_replay_data(w)])


def _heading(subject: BodySubject) -> str:
    w = subject.walked
    broken = [check for check in subject.found if not check.ok]
    word = "every requirement met" if not broken else f"{len(broken)} not met"
    late = w.error[w.time > w.time[-1] - 3.0]
    numbers = {
        "time walked": f"{w.time[-1] + w.config.dt:.1f} s",
        "steps": str(max(len(w.footholds()) - 1, 0)),
        "path of the CoM": f"{float(np.linalg.norm((w.com[-1] - w.com[0])[:2])):.2f} m",
        "error of the hand, rms of the last 3 s": f"{1e3 * float(np.sqrt((late**2).mean())):.1f} mm",
        "largest torque, of its limit": f"{100.0 * (1.0 - float(w.margins['torque'].min())):.0f} %",
        "solving, on average": f"{1e3 * float(w.times[:, 2].mean()):.2f} ms",
    }
    tiles = "".join(
        f"<div class='tile'><span>{key}</span><b>{value.replace('nan mm', '–')}</b></div>"
        for key, value in numbers.items()
    )
    title = w.scenario.name + (f": {w.note}" if w.note else "")
    return (
        f"<h1>{escape(subject.name)}<span class='badge {'violated' if broken else 'ok'}'>{word}</span></h1>"
        f"<p class='muted'>{escape(title)}; {escape(w.model.name)}, {w.model.n} joints, {w.model.mass:.1f} kg</p>"
        f"<div class='tiles'>{tiles}</div>"
    )


def _checks(found: Sequence[Demand]) -> str:
    rows = []
    for check in found:
        verdict = "" if not check.bound else "ok" if check.ok else Markup("<span class='bad'>not met</span>")
        authors = "" if check.authors is None else f"{check.authors:.4g}"
        rows.append((check.name, check.bound, check.got, authors, verdict))
    return table(("", "required", "result", "authors", ""), rows, (2, 3))


def _figures(walked: WholeBodyTrace) -> str:
    shown = []
    figures = (solver(walked), walk_from_above([walked]), reactions(walked))
    for figure, caption in zip(figures, _CAPTIONS, strict=True):
        image = io.BytesIO()
        with drawing():
            figure.savefig(image, format="svg")
        text = base64.b64encode(image.getvalue()).decode()
        source = f"data:image/svg+xml;base64,{text}"
        shown.append(f"<figure><img alt='{caption}' src='{source}'><figcaption>{caption}</figcaption></figure>")
    return "<h2>Figures</h2>" + "".join(shown)


def _notes(subject: BodySubject) -> str:
    items = [f"Recorded and recomputed torques differ by at most {subject.off:.2g} N m.", *subject.notes]
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def body_replay_data(walked: WholeBodyTrace) -> dict[str, Any]:
    """Return plain data for `replay.js`, as `replay_data` does for a walk of phases."""
    model, count = walked.model, len(walked.time)
    rows = np.unique(np.linspace(0, count - 1, min(FRAMES, count)).astype(int))
    stepping = Stepping.of(walked.config.whole_body, Foot(walked.config.gait.first_support))
    x = DQ(walked.x_base[rows])
    places, began = {Foot.LEFT: walked.left, Foot.RIGHT: walked.right}, float(walked.time[0])
    prints = []
    for foot in Foot:  # the initial stance
        prints.append(_print(walked, foot, 0.0, places[foot][0]))
    for index, (when, _) in enumerate(walked.footholds()):
        foot = stepping.foot(index)
        if index:
            prints.append(_print(walked, foot, when - began, places[foot][walked.at(when) + 1]))
    changes = [0, *(np.flatnonzero(np.diff(walked.single)) + 1).tolist()]
    phases = []
    for k in changes:
        swing = stepping.swing(float(walked.time[k]))
        name = "both feet stand" if swing is None else f"the {swing.foot.value} foot swings"
        base = Foot.LEFT if swing is None else swing.foot.other
        phases.append({"name": name, "t": float(walked.time[k]) - began, "double": swing is None, "base": base.value})
    curves = [{"name": "error of the hand", "unit": "mm", "v": packed(1e3 * walked.error[rows])}]
    for key, (name, unit, scale) in _CURVES.items():
        values = walked.margins[key][rows]
        known = np.isfinite(values)
        if known.any():
            exact = np.where(np.abs(values) < _ROUNDING, 0.0, values)
            curves.append({"name": name, "unit": unit, "v": packed(scale * np.where(known, exact, np.nan))})
    return {
        **robot_data(walked.config, model),
        "t": packed(walked.time[rows] - began),
        "q": packed(walked.q[rows]),
        "root": packed(np.concatenate([x.translation(), walked.x_base[rows][:, :4]], axis=1)),
        "com": packed(walked.com[rows]),
        "prints": prints,
        "phases": phases,
        "curves": curves,
        "tight": {"names": [""], "at": base64.b64encode(bytes(len(rows))).decode()},
        "points": [
            {"name": "hand", "color": [0.12, 0.37, 0.71], "v": packed(walked.hand[rows])},
            {"name": "target", "color": [0.82, 0.14, 0.18], "v": packed(walked.target[rows])},
        ],
    }


def _print(walked: WholeBodyTrace, foot: Foot, when: float, place: Any) -> dict[str, Any]:
    sole = walked.model.soles[foot]
    return {"t": when, "foot": foot.value, "c": [rounded(place + corner) for corner in sole.corners]}
