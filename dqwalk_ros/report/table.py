"""The report as text: aligned tables for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from dqwalk_ros.report.binding import Load
from dqwalk_ros.support.text_table import aligned

_EDGE = 1e-5
"""Distance up to which the CoM counts as at the edge of its support [m]: the error of Euler's method."""
_LIMITS_SHOWN = 3
"""Number of limits that are named, the most frequent ones."""
_TURNED = math.radians(0.5)
"""Turn below which the walk counts as straight [rad]."""


def render(report: Mapping[str, Any]) -> str:
    """Return the report (see `verdict.report`) as aligned text: phases, distances, the walk, the verdict."""
    head, *rows = phases(report)
    parts = [aligned(rows, head, right=(1, 2, 3, 4, 5, 7, 8))]
    head, *rows = bounds(report)
    parts.append(aligned(rows, head, right=range(1, len(head))))
    parts.append(aligned(numbers(report)))
    return "\n\n".join([*parts, _verdict(report)]) + "\n"


def phases(report: Mapping[str, Any]) -> list[list[str]]:
    """Return the head and the rows of a table of the phases."""
    head = ["phase", "start\n[s]", "end\n[s]", "ticks", "error\nfirst", "\nlast", "tightest distance", "", "violation"]
    rows = [
        [
            phase["name"] + ("" if phase["ended"] else " (stopped)"),
            f"{phase['start']:.2f}",
            f"{phase['end']:.2f}",
            str(phase["ticks"]),
            f"{phase['error']['first']:.5f}",
            f"{phase['error']['last']:.5f}",
            phase["worst"]["name"],
            f"{phase['worst']['value']:.2e}",
            f"{phase['worst']['violation']:.1e}" if phase["worst"]["violation"] else "none",
        ]
        for phase in report["phases"]
    ]
    return [head, *rows]


def bounds(report: Mapping[str, Any]) -> list[list[str]]:
    """Return the head and the rows of a table of how close each constraint came to its bounds in the walk."""
    head = [
        "constraint",
        "smallest distance\nto its bound",
        "at\n[s]",
        "smallest margin to the\nbound of a period [1/s]",
        "at\n[s]",
    ]
    rows = []
    for name, found in report["walk"]["bounds"].items():
        least = [found["distance"], found.get("spare")]
        cells = [(f"{one['value']:.4g}", f"{one['time']:.2f}") if one else ("far", "") for one in least]
        rows.append([name, *cells[0], *cells[1]])
    return [head, *rows]


def numbers(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and text of each result for the whole walk."""
    walk, mm = report["walk"], 1e3
    margin, joints, speed = walk["margin"], walk["margin"]["joints"], walk["joint_speed"]
    way = f"{steps(report)}, {mm * walk['forward']:.1f} mm forward, {mm * walk['lateral']:.1f} mm to the left"
    if abs(walk["turned"]) > _TURNED:
        way += f", turned {math.degrees(walk['turned']):+.1f} degrees"
    lines = [
        ("walk", ending(report)),
        ("time", f"{walk['duration']:.2f} s, {walk['ticks']} ticks"),
        ("steps", way),
    ]
    if walk["landing_error"] is not None:
        lines.append(("landing error", f"at most {mm * walk['landing_error']:.2f} mm"))
    closest = f"{joints['value']:.4f} rad at {joints['time']:.2f} s ({walk['closest_joint']})"
    lines.append(("joint-limit margin", closest))
    fastest = f"at most {speed['largest']:.3f} rad/s, {100 * speed['of_limit']:.1f} % of the limit"
    lines.append(("joint speed", fastest))
    reached = [f"{name} on {count} ticks" for name, count in list(walk["limits_reached"].items())[:_LIMITS_SHOWN]]
    lines.append(("limits reached", ", ".join(reached) or "none while it steps"))
    if (delay := walk["delay"])["used"] != delay["assumed"]:
        used, assumed = mm * delay["used"], mm * delay["assumed"]
        lines.append(("delay", f"{used:.0f} ms by the motion of the joints, {assumed:.0f} ms by servo.assumed_*"))
    if "paper" in margin:
        lines.append(("paper margin", _margin(margin["paper"])))
    if quasi_static(report):
        lines.append(("true margin", _margin(margin["true"])))
        if "true_urdf_sole" in margin:
            lines.append(("  URDF's own sole", _margin(margin["true_urdf_sole"])))
    if report["physics"] is not None:
        lines += _physics(report["physics"])
    lines.append(("unit-norm error", f"{walk['unit_norm_error']:.1e}"))
    if (solve := report["solve_time"]) is not None:
        lines.append(("solve time", ", ".join(f"{key} {1e6 * value:.0f} us" for key, value in solve.items())))
    if count := walk["unanswered"]:
        lines.append(("unanswered", f"{count} state{'s' if count > 1 else ''} without a command"))
    lines += [("note", note) for note in report["notes"]]
    return lines


def ending(report: Mapping[str, Any]) -> str:
    """Return how the walk ended, in words."""
    walk = report["walk"]
    if walk["cut"]:
        return "the recording is cut off before its end"
    return "finished" if walk["finished"] else "stopped before its end"


def quasi_static(report: Mapping[str, Any]) -> bool:
    """Return whether the CoM is to be inside the soles; in a dynamic walk only the centre of pressure is."""
    return bool(report["walk"]["style"] != "dynamic")


def steps(report: Mapping[str, Any]) -> str:
    """Return the number of steps in words: the step that puts the feet together is counted apart."""
    count, config = report["walk"]["steps"], report["config"]
    if report["walk"]["finished"] and report["walk"]["style"] != "paper" and 0 < config["gait.steps"] == count - 1:
        return f"{count - 1} and 1 that puts the feet together"
    return str(count)


def _physics(of: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return name and text of each result for a walk in physics."""
    mm, degrees = 1e3, 180.0 / math.pi
    x, y = of["displacement"]
    pace = "" if of["seconds_per_step"] is None else f", {of['seconds_per_step']:.2f} s per step"
    lines = [
        ("in physics", "the robot FELL" if of["fallen"] else f"it stood{pace}"),
        ("  true path", f"{of['way']:.3f} m; from start to end {x:+.3f} m ahead, {y:+.3f} m to the left"),
        ("  turned", f"{degrees * of['turned']:+.1f} degrees"),
    ]
    if "circle" in of:
        circle = of["circle"]
        lines.append(("  circle", f"radius {circle['radius']:.3f} m, rms error {mm * circle['deviation']:.1f} mm"))
    tilt = of["tilt"]
    lines.append(("  tilt of the sole", f"at most {degrees * tilt['value']:.2f} degrees at {tilt['time']:.2f} s"))
    if of["landing_height"] is not None:
        height = mm * of["landing_height"]
        lines.append(("  landing height", f"at most {height:.1f} mm at the assumed touchdown"))
    if (inside := of["cop_inside"]) is not None:
        margin = "" if of["cop_margin"] is None else f"; at worst {mm * of['cop_margin']:+.1f} mm"
        lines.append(("  CoP", f"inside the support polygon in {100.0 * inside:.2f} % of ticks{margin}"))
    if (load := of["swing_load"]) is not None:
        lines.append(("  swing foot", f"carries {100.0 * load:.1f} % of the weight while it swings (median)"))
    if (error := of["load_error"]) is not None:
        lines.append(("  load of a foot", f"from torques, {100.0 * error:.1f} % of the weight off (median)"))
    if (load := of.get("load")) is not None:
        lines.append(("  servos", str(Load(**load))))
    if (energy := of.get("energy")) is not None:
        text = f"{energy['power']:.2f} W at the joints on average (sum |tau dq|), {energy['positive']:.2f} W positive"
        if energy["cost_of_transport"] is not None:
            text += f"; cost of transport {energy['cost_of_transport']:.2f}"
        lines.append(("  energy", text))
    lines.append(("  odometry", f"{mm * of['odometry_drift']:.1f} mm off at the end"))
    return lines


def _margin(least: Mapping[str, float]) -> str:
    where = "at the edge" if abs(least["value"]) < _EDGE else "outside" if least["value"] < 0.0 else "inside"
    first = f", from {least['outside_from']:.2f} s on" if where == "outside" and "outside_from" in least else ""
    return f"{1e3 * least['value']:+.2f} mm at {least['time']:.2f} s ({where}{first})"


def _verdict(report: Mapping[str, Any]) -> str:
    if report["ok"]:
        recorded = ", as far as the walk was recorded" if report["walk"]["cut"] else ""
        return f"OK: every constraint was kept and every phase ended by its rule{recorded}"
    violations = report["violations"]
    shown = [f"  {violation['message']}" for violation in violations[:20]]
    more = [f"  and {len(violations) - 20} more"] if len(violations) > 20 else []
    times = "once" if len(violations) == 1 else f"{len(violations)} times"
    return "\n".join([f"NOT OK, {times}:", *shown, *more, *why(report)])


def why(report: Mapping[str, Any]) -> list[str]:
    """Return why the robot fell: a line for the first cause and one for each other; empty if it did not fall."""
    found = [c["message"] + (f" ({c['parameter']})" if c["parameter"] else "") for c in report["causes"]]
    return [("it fell because: " if k == 0 else "as well: ") + text for k, text in enumerate(found)]
