"""One state of a walk, judged: every distance, error and margin, and whether all is well.

What is promised is Groenwall's bound in discrete time: a distance that began at d_0 stays above
``min(0, (1 - eta dt)^k d_0)``, an equality that began at r_0 below ``(1 - eta dt)^k |r_0|``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import Config, MonitorConfig
from dqwalk_ros.constraints import PointInCylinder
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.geometry import ConvexPolygon
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.robot import RobotModel
from dqwalk_ros.walk import Phase, PhaseKind

__all__ = ["Assessment", "Assessor", "support_polygon"]


@dataclass(frozen=True)
class Assessment:
    """What is to be said of one state.

    Attributes
    ----------
    level : str
        ``"OK"``, ``"WARN"`` where a distance is closer to its bound than ``monitor.warn_margin``, ``"ERROR"`` where
        one is beyond what is promised by more than ``monitor.tolerance``.
    message : str
        The phase, and what decided the level.
    values : mapping of str to float
        ``distance/NAME``, ``residual/NAME``, ``error``, and the margins: ``margin/paper`` of the CoM to the paper's
        planes (9), (10) or cylinder (14), ``margin/polygon`` to the true support polygon, ``margin/joints``.
    """

    level: str
    message: str
    values: Mapping[str, float]


class Assessor:
    """Judges the states of one phase.

    Parameters
    ----------
    config : Config
    model : RobotModel
    phase : Phase
    """

    def __init__(self, config: Config, model: RobotModel, phase: Phase) -> None:
        self.config, self.model, self.phase = config, model, phase
        start = phase.distances(Kinematics(model, phase.q_start, phase.base))
        self._rate = {row.name: 1.0 - min(1.0, row.eta * config.dt) for row in (*phase.constraints, *phase.equalities)}
        self._holds = {hold.name for hold in phase.equalities}
        self._radius = {row.name: row.cylinder.radius for row in phase.inequalities if isinstance(row, PointInCylinder)}
        self._start = start

    def __call__(self, kin: Kinematics, elapsed: float, monitor: MonitorConfig | None = None) -> Assessment:
        """Judge one state.

        Parameters
        ----------
        kin : Kinematics
            Seen from the base of the phase.
        elapsed : float
            Time since the phase began [s].
        monitor : MonitorConfig, optional
            Instead of the configuration's own.
        """
        monitor = monitor or self.config.monitor
        ticks = max(elapsed, 0.0) / self.config.dt
        distances = self.phase.distances(kin)
        values: dict[str, float] = {"error": float(self.phase.error(kin)), "time in phase": elapsed}
        broken: list[str] = []
        close: list[str] = []
        for name, d in distances.items():
            promised = self._start[name] * self._rate.get(name, 1.0) ** ticks
            if name in self._holds:
                values[f"residual/{name}"] = float(d)
                if abs(d) > abs(promised) + monitor.tolerance:
                    broken.append(f"{name} is off by {d:.3g}")
                continue
            values[f"distance/{name}"] = float(d)
            if d < min(0.0, promised) - monitor.tolerance:
                broken.append(f"{name} is {-d:.3g} beyond its bound")
            elif (margin := self._margin(name, d)) < monitor.warn_margin:
                close.append(f"{name} within {margin:.2g}")
        values |= self._margins(kin, distances)
        text = "; ".join(broken or close)
        level = "ERROR" if broken else "WARN" if close else "OK"
        return Assessment(level, f"{self.phase.name}: {text}" if text else self.phase.name, values)

    def _margin(self, name: str, d: float) -> float:
        """Return a distance in its plain unit: that to a cylinder is r^2 - d^2, whose unit is m^2."""
        radius = self._radius.get(name)
        return d if radius is None else radius - float(np.sqrt(max(0.0, radius**2 - d)))

    def _margins(self, kin: Kinematics, distances: Mapping[str, float]) -> dict[str, float]:
        model, phase = self.model, self.phase
        margins: dict[str, float] = {}
        if "com_cylinder" in distances:
            center = model.soles[phase.base].center
            margins["margin/paper"] = self.config.ssp.com_radius - float(np.hypot(*(kin.com - center)[:2]))
        elif "tip_plane" in distances:
            margins["margin/paper"] = min(distances["tip_plane"], distances["back_plane"])
        return margins | {
            "margin/polygon": support_polygon(model, phase, kin).distance(kin.com),
            "margin/joints": float(np.minimum(kin.q - model.q_min, model.q_max - kin.q).min()),
        }


def support_polygon(model: RobotModel, phase: Phase, kin: Kinematics) -> ConvexPolygon:
    """Return the convex hull of the soles on the ground, in the base sole's frame [m]."""
    corners = model.soles[phase.base].corners
    if phase.kind is not PhaseKind.SINGLE_SUPPORT:
        end = model.soles[phase.base.other]
        corners = np.concatenate([corners, DQ(kin.pose(end.frame)).transform_point(end.corners)])
    return ConvexPolygon.hull(corners)
