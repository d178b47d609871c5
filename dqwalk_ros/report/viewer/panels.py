"""HTML of the page's panels: for each margin a bar, a number and a curve; the smallest one is marked."""

from __future__ import annotations

from html import escape

import numpy as np

from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.report.colors import GREEN, INK, MUTED, ORANGE, RED, TIGHT, hexed
from dqwalk_ros.report.scene import Gauge, View, tightest

_MOST = 900
"""Most points of a curve; when it has more, every second one is dropped."""
_WIDTH, _HEIGHT = 300.0, 34.0
_MUTED = hexed(MUTED)
_FONT = f"font:13px/1.35 system-ui,-apple-system,'Segoe UI',sans-serif;color:{hexed(INK)}"


class History:
    """Every margin over time, with a limited number of points."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.rows: list[dict[str, float]] = []
        self.known: dict[str, Gauge] = {}  # the last one of each name
        self.marks: list[float] = []
        self._step = 0.0

    def add(self, view: View) -> None:
        """Add a view, later than those before."""
        time = view.moment.time
        if self.times and time - self.times[-1] < self._step:
            return
        self.times.append(time)
        shown = {gauge.name: gauge for gauge in view.gauges if gauge.role != "held"}
        self.known |= shown
        self.rows.append({name: gauge.value for name, gauge in shown.items()})
        if not self.marks or view.moment.began > self.marks[-1]:
            self.marks.append(view.moment.began)
        if len(self.times) > _MOST:
            self.times, self.rows = self.times[::2], self.rows[::2]
            self._step = 1.5 * (self.times[-1] - self.times[0]) / len(self.times)

    def span(self, now: float) -> tuple[float, float]:
        """Return first and last time of the curves, which include `now`."""
        first = self.times[0] if self.times else now
        last = max(self.times[-1] if self.times else now, now)
        return first, max(last, first + 1.0)


def margins_html(view: View, history: History) -> str:
    """Return all margins of a view; those of other phases remain, greyed out, so that the layout does not change."""
    now = {gauge.name: gauge for gauge in view.gauges if gauge.role != "held"}
    known = history.known | now
    names = sorted(known, key=lambda name: known[name].role == "watched")  # what is no constraint is last
    tight = tightest(view.gauges).name
    first, last = history.span(view.moment.time)
    parts = [_row(known[name], name in now, name == tight, history, (first, last), view.moment.time) for name in names]
    held = [gauge for gauge in view.gauges if gauge.role == "held"]
    tail = ""
    if held:
        cells = " &nbsp; ".join(f"{escape(g.label)} <b>{abs(g.value):.2g}</b>" for g in held)
        tail = f'<div style="color:{_MUTED};padding:4px 10px">equalities, residual [10⁻³]: {cells}</div>'
    axis = (
        f'<div style="display:flex;justify-content:space-between;color:{_MUTED};font-size:11px;padding:0 10px">'
        f"<span>{first:.1f} s</span><span>{last:.1f} s</span></div>"
    )
    return f'<div data-dqwalk="margins" style="{_FONT}">{"".join(parts)}{axis}{tail}</div>'


def _row(gauge: Gauge, present: bool, tight: bool, history: History, span: tuple[float, float], now: float) -> str:
    kept = not present or gauge.value >= 0.0
    color = hexed(TIGHT if tight else gauge.color if kept else RED)
    value = f"{gauge.value:.2f} {gauge.unit}" if present else "–"
    fade = "" if present else "opacity:.38;"
    mark = f"background:#fff4e0;box-shadow:inset 3px 0 0 {hexed(TIGHT)};" if tight else ""
    badge = f' <span style="color:{hexed(ORANGE)};font-weight:700;font-size:11px">TIGHTEST</span>' if tight else ""
    share = float(np.clip(gauge.share, 0.0, 1.0)) if present else 0.0
    bar = (
        '<div style="height:4px;background:#e4e8ec;border-radius:2px;margin:1px 0 2px">'
        f'<div style="height:4px;border-radius:2px;width:{100 * share:.0f}%;background:{color}"></div></div>'
    )
    return (
        f'<div style="padding:4px 10px 2px;{fade}{mark}"><div style="display:flex;justify-content:space-between">'
        f"<span>{escape(gauge.label)}{badge}</span>"
        f'<b style="font-variant-numeric:tabular-nums;color:{color}">{value}</b></div>'
        f"{bar}{_curve(gauge.name, color, history, span, now)}</div>"
    )


def _curve(name: str, color: str, history: History, span: tuple[float, float], now: float) -> str:
    """Return a curve as SVG, with the threshold as a dashed red line and the current time as a thin one."""
    known = [(t, row[name]) for t, row in zip(history.times, history.rows, strict=True) if name in row]
    values = np.array([v for _, v in known]) if known else np.zeros(1)
    low, high = min(0.0, float(values.min())), max(float(values.max()), 1e-6)
    room = 0.08 * (high - low)
    low, high = low - room, high + room

    def x(t: float) -> float:
        return _WIDTH * (t - span[0]) / (span[1] - span[0])

    def y(v: float) -> float:
        return _HEIGHT * (1.0 - (v - low) / (high - low))

    gap = 3.0 * (span[1] - span[0]) / max(len(history.times), 1)
    path, before = [], -np.inf
    for t, v in known:
        path.append(f"{'M' if t - before > gap else 'L'}{x(t):.1f} {y(v):.1f}")
        before = t
    marks = "".join(f"M{x(t):.1f} 0V{_HEIGHT}" for t in history.marks[1:])
    return (
        f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" preserveAspectRatio="none" '
        f'style="width:100%;height:{_HEIGHT:.0f}px;display:block">'
        f'<path d="{marks}" stroke="#d0d7de" fill="none" vector-effect="non-scaling-stroke"/>'
        f'<path d="M0 {y(0.0):.1f}H{_WIDTH:.0f}" stroke="{hexed(RED)}" stroke-dasharray="4 3" fill="none" '
        'vector-effect="non-scaling-stroke"/>'
        f'<path data-curve="{escape(name)}" d="{"".join(path)}" stroke="{color}" stroke-width="1.6" fill="none" '
        'stroke-linejoin="round" vector-effect="non-scaling-stroke"/>'
        f'<path d="M{x(now):.1f} 0V{_HEIGHT}" stroke="{hexed(INK)}" stroke-width="1" fill="none" '
        'vector-effect="non-scaling-stroke"/></svg>'
    )


_DOING = {
    PhaseKind.DOUBLE_SUPPORT: "the CoM moves over the {} foot",
    PhaseKind.SINGLE_SUPPORT: "support on the {} foot, the other swings",
    PhaseKind.STANCE: "the CoM stays between the feet",
}
_LEVEL = {"OK": hexed(GREEN), "WARN": hexed(TIGHT), "ERROR": hexed(RED)}


def status_html(view: View, *, total: int, note: str) -> str:
    """Return phase, its number of the `total` (0: not known), time, level and solver of a view."""
    moment = view.moment
    phase = moment.phase
    doing = _DOING[phase.kind].format(phase.support.value)
    title = escape(phase.name.partition("/")[0].replace("_", " "))
    over = moment.label if moment.label in ("finished", "failed", "paused", "idle") else ""
    badge = _LEVEL[view.level]
    number = f"{moment.index + 1}{f' of {total}' if total else ''}"
    solver = escape(moment.solver) or "not recorded"
    rows = [
        ("time", f"{moment.time:.2f} s"),
        ("phase", number),
        ("task error", f"{view.error:.5f}"),
        ("solver", solver),
        ("page", escape(note)),
    ]
    cells = "".join(
        f'<tr><td style="color:{_MUTED};padding:1px 10px 1px 0;vertical-align:top">{key}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{value}</td></tr>'
        for key, value in rows
    )
    return (
        f'<div data-dqwalk="status" style="{_FONT};padding:2px 10px 6px">'
        f'<div style="display:flex;justify-content:space-between;align-items:center;margin-bottom:2px">'
        f'<span style="font-size:17px;font-weight:700">{title}{": " + over if over else ""}</span>'
        f'<span style="background:{badge};color:white;border-radius:9px;padding:1px 9px;font-weight:700;'
        f'font-size:12px">{escape(view.level)}</span></div>'
        f'<div style="color:{_MUTED};margin-bottom:6px">{escape(doing)} (world: {phase.base.value} sole)</div>'
        f'<table style="border-spacing:0">{cells}</table></div>'
    )
