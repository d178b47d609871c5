"""Generates the HTML of a report, for one walk or for two side by side."""

from __future__ import annotations

import base64
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from dqwalk_ros.report import colors
from dqwalk_ros.report import table as tables
from dqwalk_ros.report.bag.messages import Status, faults
from dqwalk_ros.report.figures.style import Drawn, write_figure
from dqwalk_ros.report.html.replay import replay_data
from dqwalk_ros.report.metrics import Series
from dqwalk_ros.support import provenance
from dqwalk_ros.support.output import write_text

_SHAPES = (
    "Its edge is red while the centre of mass is outside. Orange: the plane or cylinder of the tightest constraint, "
    "and on the ground the divergent component of motion."
)
"""Caption of what only a walk of phases shows."""
_MANY = 100
"""Number of phases above which the figures are png, which is smaller then."""
_MIME = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True)
class Subject:
    """A walk to report on: name of its bag, series, `verdict.report`, diagnostics of the nodes, and figures."""

    name: str
    series: Series
    report: dict[str, Any]
    statuses: list[Status]
    figures: Sequence[Drawn]


def write(subjects: Sequence[Subject], path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the report of one walk, or of two side by side, to an HTML file; see `written` for errors."""
    parts = [
        f"<div class='two'>{''.join(map(_heading, subjects))}</div>",
        replay([s.name for s in subjects], _SHAPES),
        _comparison(subjects) if len(subjects) > 1 else _section("The walk in numbers", _all_numbers, subjects),
        _section("Smallest distance to each bound", _margins, subjects),
        _section("Phases", _phases, subjects),
        figures([s.figures for s in subjects], "png" if any(map(_is_long, subjects)) else "svg"),
        _section("Joint speeds and limits", _joints, subjects),
        _section("Time of a tick", _tick_times, subjects),
        _section("Faults", _faults, subjects),
        _section("Violations and notes", _violations, subjects),
        _configuration(subjects),
        origin_table([(s.name, s.series.trace.origin) for s in subjects]),
    ]
    name, walks = " and ".join(s.name for s in subjects), [replay_data(s.series) for s in subjects]
    write_page(path, name, parts, walks, overwrite=overwrite)


def write_page(
    path: str | os.PathLike[str], name: str, parts: Sequence[str], walks: Sequence[Any], *, overwrite: bool
) -> None:
    """Write a page of some parts, with the data of the walks for the replay."""
    data = json.dumps(walks, separators=(",", ":")).replace("<", "\\u003c")  # so that it contains no tag or comment
    text = (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>dqwalk: {escape(name)}</title>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        "<link rel='icon' href='data:,'>"
        f"<style>{colors.css()}{_asset('style.css')}</style></head><body><main>{''.join(parts)}</main>"
        f"<script id='data' type='application/json'>{data}</script><script>{_asset('replay.js')}</script></body></html>"
    )
    write_text(path, text, overwrite=overwrite)


def _asset(name: str) -> str:
    return resources.files("dqwalk_ros.report.html").joinpath(name).read_text(encoding="utf-8")


def _section(title: str, body: Callable[[Subject], str], subjects: Sequence[Subject]) -> str:
    labels = [f"<p><b>{escape(s.name)}</b></p>" if len(subjects) > 1 else "" for s in subjects]
    cards = [f"<div class='card scroll'>{label}{body(s)}</div>" for label, s in zip(labels, subjects, strict=True)]
    return f"<h2>{title}</h2><div class='two'>{''.join(cards)}</div>"


class Markup(str):
    """A cell of a table that is HTML already; other cells are text and are escaped."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """Return a table; `numbers` are the indices of the right-aligned columns."""

    def cells(tag: str, row: Sequence[str]) -> str:
        texts = (cell if isinstance(cell, Markup) else escape(cell) for cell in row)
        return "".join(f"<{tag}{' class=n' if c in numbers else ''}>{text}</{tag}>" for c, text in enumerate(texts))

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><tr>{cells('th', head)}</tr>{body}</table>"


# ---------------------------------------------------------------------- sections


def _heading(subject: Subject) -> str:
    report = subject.report
    walk, margin, robot = report["walk"], report["walk"]["margin"], report["robot"]
    violations = [v for v in report["violations"] if v["what"] != "finished"]
    words = [] if walk["finished"] else [tables.ending(report)]
    if violations:
        words.append(f"{len(violations)} violation{'s' if len(violations) > 1 else ''}")
    about = f"{robot['name']}, {len(robot['joints'])} joints, {robot['mass']:.2f} kg"
    error = walk["landing_error"]
    numbers = {
        "time walked": f"{walk['duration']:.1f} s",
        "steps": tables.steps(report),
        "distance": f"{1e3 * walk['distance']:.1f} mm",
        "largest landing error": "–" if error is None else f"{1e3 * error:.2f} mm",
        **_balance(report),
        "smallest joint-limit margin": f"{np.degrees(margin['joints']['value']):.2f}°",
        "largest joint speed": f"{walk['joint_speed']['largest']:.3f} rad/s",
    }
    return heading(subject.name, ", ".join(words) or "every constraint kept", about, numbers, ok=report["ok"])


def _balance(report: Mapping[str, Any]) -> dict[str, str]:
    """Return name and text of the margins that the balance of this kind of walk depends on."""
    margin, physics = report["walk"]["margin"], report["physics"]
    out = {}
    if "paper" in margin:
        out["smallest paper margin"] = f"{1e3 * margin['paper']['value']:+.2f} mm"
    if tables.quasi_static(report):
        out["smallest margin of the CoM in the soles"] = f"{1e3 * margin['true']['value']:+.2f} mm"
    elif physics is not None:
        pressure = physics["cop_margin"]
        out["smallest margin of the centre of pressure"] = "–" if pressure is None else f"{1e3 * pressure:+.2f} mm"
        out["largest tilt of the loaded sole"] = f"{np.degrees(physics['tilt']['value']):.2f}°"
    return out


def heading(name: str, verdict: str, about: str, numbers: Mapping[str, str], *, ok: bool) -> str:
    """Return the title of a walk with its verdict, a line about it, and a tile for each number."""
    tiles = "".join(f"<div class='tile'><span>{key}</span><b>{value}</b></div>" for key, value in numbers.items())
    return (
        f"<div><h1>{escape(name)}<span class='badge {'ok' if ok else 'violated'}'>{verdict}</span></h1>"
        f"<p class='muted'>{escape(about)}</p><div class='tiles'>{tiles}</div></div>"
    )


def _all_numbers(subject: Subject) -> str:
    return table(("", ""), tables.numbers(subject.report))


def replay(names: Sequence[str], more: str) -> str:
    """Return the replay of one walk, or of two side by side; `more` is added to its caption."""
    stages = "".join(
        f"<div><p>{escape(name)}: <b id='phase{k}'></b></p><div class='replay'>"
        f"<canvas class='stage' id='stage{k}'></canvas><div id='curves{k}'></div></div></div>"
        for k, name in enumerate(names)
    )
    speeds = "".join(f"<option>{v}</option>" for v in ("0.25", "0.5", "1", "2", "5", "10", "20", "50"))
    return (
        f"<h2>Replay</h2><div class='card'><div class='two{' both' if len(names) > 1 else ''}'>{stages}</div>"
        "<div class='bar'><button id='play'>Play</button>"
        "<input id='time' type='range' min='0' value='0' aria-label='time'><span id='clock'></span>"
        f"<label>speed × <select id='speed'>{speeds}</select></label></div>"
        "<p class='muted'>Drag to rotate, scroll to zoom, space to play. Click a curve to go to that time. The curves "
        "show the distance to the bound (dashed).<br>Red: centre of mass, its projection and path. Green: support "
        f"polygon. {more}</p></div>"
    )


def _margins(subject: Subject) -> str:
    head, *rows = tables.bounds(subject.report)
    marked = [[bad(cell) if cell.startswith("-") else cell for cell in row] for row in rows]
    note = (
        "<p class='muted'>[m], cylinders (sliding, com_cylinder) [m²], joints [rad]; kept if not negative. "
        "The bound of a period is what eta allows from one state to the next; far: no row was needed.</p>"
    )
    return table([name.replace("\n", " ") for name in head], marked, range(1, len(head))) + note


def bad(text: str) -> Markup:
    """Return a cell in red."""
    return Markup(f"<span class='bad'>{escape(text)}</span>")


def _phases(subject: Subject) -> str:
    head, *rows = tables.phases(subject.report)
    return table([name.replace("\n", " ") for name in head], rows, (1, 2, 3, 4, 5, 7, 8))


def _is_long(subject: Subject) -> bool:
    return len(subject.series.spans) > _MANY


def figures(walks: Sequence[Iterable[Drawn]], kind: str = "svg") -> str:
    """Return the figures of one walk, or of two, those of the same name side by side, as svg or png."""
    rows: dict[str, str] = {}
    for walk in walks:
        for name, figure, caption in walk:
            image = io.BytesIO()
            write_figure(figure, image, kind)
            source = f"data:{_MIME[kind]};base64,{base64.b64encode(image.getvalue()).decode()}"
            shown = f"<figure><img alt='{escape(caption)}' src='{source}'><figcaption>{caption}</figcaption></figure>"
            rows[name] = rows.get(name, "") + shown
    return "<h2>Figures</h2>" + "".join(f"<div class='two'>{row}</div>" for row in rows.values())


def _joints(subject: Subject) -> str:
    series = subject.series
    model = series.trace.model
    known = np.isfinite(series.trace.u).all(axis=1)
    fastest = np.abs(series.trace.u[known]).max(axis=0, initial=0.0)
    rows = []
    for i, name in enumerate(model.joint_names):
        share = float(fastest[i] / model.velocity_max[i])
        meter = f"<span class='meter'><i style='width:{100 * min(1.0, share):.1f}%'></i></span> {100 * share:.1f} %"
        left = float(np.degrees(series.joint_margin[:, i].min()))
        limit = f"{model.velocity_max[i]:.2f}"
        rows.append((name, f"{fastest[i]:.4f}", limit, Markup(meter), f"{left:.2f}°"))
    head = ("joint", "fastest [rad/s]", "limit [rad/s]", "share of the limit", "closest to a limit")
    return table(head, rows, (1, 2, 4))


def _tick_times(subject: Subject) -> str:
    times = subject.series.trace.solve_time
    times = times[np.isfinite(times)]
    where = "every tick"
    if not len(times):
        values = [status.solve_time for status in subject.statuses]
        times, where = np.array([v for v in values if 0.0 <= v < 10.0]), "samples from /diagnostics"
    if not len(times):
        return "<p class='muted'>The bag contains no solving times.</p>"
    micro = 1e6 * times
    edges = np.linspace(0.0, float(np.percentile(micro, 99)) * 1.1 + 1e-9, 41)
    counts, _ = np.histogram(micro, edges)
    bars = "".join(
        f"<rect x='{12 * k}' y='{100 - 96 * n / counts.max():.1f}' width='10' height='{96 * n / counts.max():.1f}'/>"
        for k, n in enumerate(counts)
    )
    text = f"median {np.median(micro):.0f} µs, 99 % {np.percentile(micro, 99):.0f} µs, at most {micro.max():.0f} µs"
    return (
        f"<p>Solver, {where} ({len(micro)}): {text}.</p>"
        "<svg viewBox='0 0 480 118' style='width:100%;max-width:640px'>"
        f"<g fill='var(--blue)'>{bars}</g><text x='0' y='115' font-size='11' fill='var(--muted)'>0</text>"
        f"<text x='480' y='115' font-size='11' fill='var(--muted)' text-anchor='end'>{edges[-1]:.0f} µs</text></svg>"
    )


def _faults(subject: Subject) -> str:
    found = faults(subject.statuses)
    if not found:
        return "<p class='muted'>None: every status was OK, or the bag has no /diagnostics.</p>"
    epoch = subject.series.trace.epoch / 1e9
    rows = [
        (
            Markup(f"<span class='level-{fault.level}'>{fault.level}</span>"),
            fault.name,
            fault.message[:160],
            f"{fault.first - epoch:.2f}",
            f"{fault.last - epoch:.2f}",
            str(fault.count),
        )
        for fault in found[:40]
    ]
    return table(("level", "status", "first message", "first [s]", "last [s]", "count"), rows, (3, 4, 5))


def _violations(subject: Subject) -> str:
    items = [f"<li class='bad'><b>{escape(line)}</b></li>" for line in tables.why(subject.report)]
    items += [f"<li class='bad'>{escape(v['message'])}</li>" for v in subject.report["violations"][:50]]
    items += [f"<li>{escape(note)}</li>" for note in subject.report["notes"]]
    return f"<ul>{''.join(items)}</ul>" if items else "<p class='muted'>None.</p>"


# ---------------------------------------------------------------------- two walks


def _comparison(subjects: Sequence[Subject]) -> str:
    one, other = (dict(tables.numbers(s.report)) for s in subjects)
    rows = "".join(
        f"<tr{'' if one.get(key) == other.get(key) else ' class=differs'}><td>{escape(key)}</td>"
        f"<td class=n>{escape(one.get(key, '–'))}</td><td class=n>{escape(other.get(key, '–'))}</td></tr>"
        for key in one | other
    )
    a, b = (s.report["config"] for s in subjects)
    changed = [(key, str(a.get(key)), str(b.get(key))) for key in a if a.get(key) != b.get(key)]
    config = (
        table(("parameter", *(s.name for s in subjects)), changed)
        if changed
        else "<p class='muted'>The same configuration.</p>"
    )
    names = [escape(s.name) for s in subjects]
    return (
        f"<h2>Side by side</h2><div class='card scroll'><table class=wraps><tr><th></th><th class=n>{names[0]}</th>"
        f"<th class=n>{names[1]}</th></tr>{rows}</table></div>"
        f"<h2>Parameters that differ</h2><div class='card scroll'>{config}</div>"
    )


# ---------------------------------------------------------------------- configuration and versions


def _configuration(subjects: Sequence[Subject]) -> str:
    out = []
    for s in subjects:
        rows = [(key, str(value)) for key, value in s.report["config"].items()]
        title = f"<summary>Configuration of {escape(s.name)}</summary>"
        out.append(f"<details class='card'>{title}{table(('', ''), rows)}</details>")
    return f"<h2>Configuration</h2><div class='two'>{''.join(out)}</div>"


def origin_table(walked: Sequence[tuple[str, Mapping[str, str]]]) -> str:
    """Return a table of versions and machine, of each walk and of this report."""
    made = provenance.here()
    head = ("", *(f"walked: {name}" if len(walked) > 1 else "walked" for name, _ in walked), "reported")
    columns = [*(dict(entry) for _, entry in walked), made]
    rows = []
    for key in dict.fromkeys(key for column in columns for key in column):
        cells = [column.get(key, "") if column else "not recorded" for column in columns]
        rows.append(("at" if key == "began" else key, *cells))
    return f"<h2>Versions and machine</h2><div class='card scroll'>{table(head, rows)}</div>"
