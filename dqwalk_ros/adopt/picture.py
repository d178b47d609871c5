"""Draws an adopted robot in the initial posture: shapes, joints, both soles, the CoM and the forward direction."""

from __future__ import annotations

import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.report.figures.style import FOOT, INK, RED, drawing, new_figure
from dqwalk_ros.robot.model import RobotModel, find_urdf
from dqwalk_ros.robot.shapes import Shapes
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.output import written

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_TRIANGLES = 60_000
_LIGHT = np.array([0.5, -0.4, 0.77])
_VIEWS = {"from the side": (0, 2, -1.0, 1), "from the front": (1, 2, 1.0, 0), "from above": (0, 1, 1.0, 2)}
"""Horizontal and vertical axis of each view, sign of the axis towards the viewer, and the axis itself."""


def draw(config: Config, model: RobotModel, path: pathlib.Path, *, overwrite: bool = False) -> None:
    """Draw the robot in the initial posture of its walk in three views; the suffix of the file is its format.

    See `written` for errors.
    """
    from matplotlib.collections import PolyCollection

    kin = Kinematics(model, model.posture(config.standing.posture), Foot.LEFT)
    triangles = _triangles(model, kin, find_urdf(config.robot.urdf))
    soles = {foot: DQ(kin.pose(sole.frame)).transform_point(sole.corners) for foot, sole in model.soles.items()}
    bones = _bones(model, kin)
    with drawing():
        figure = new_figure(9.0, 4.6)
        for ax, (title, (right, up, sign, depth)) in zip(figure.subplots(1, 3), _VIEWS.items(), strict=True):
            if len(triangles):
                order = np.argsort(sign * triangles[:, :, depth].mean(axis=1))
                shown = triangles[order]
                normals = np.cross(shown[:, 1] - shown[:, 0], shown[:, 2] - shown[:, 0])
                bright = np.abs(normals @ _LIGHT) / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
                colors = np.repeat(0.55 + 0.4 * bright[:, None], 3, axis=1)
                projected: Any = shown[:, :, [right, up]]  # as an array, which is drawn faster than a list
                ax.add_collection(PolyCollection(projected, facecolors=colors, edgecolors="none"))
            for bone in bones:
                ax.plot(bone[:, right], bone[:, up], color=INK, linewidth=1.0, marker="o", markersize=2.0)
            for foot, corners in soles.items():
                ring = corners[[0, 1, 2, 3, 0]]
                ax.plot(ring[:, right], ring[:, up], color=FOOT[foot], label=f"{foot.value} sole")
            ax.plot(kin.com[right], kin.com[up], "o", color=RED, markersize=6, label="CoM")
            _arrow(ax, kin, right, up)
            ax.set_aspect("equal")
            ax.autoscale_view()
            ax.set_title(title)
            ax.set_xlabel("xyz"[right] + " [m]")
            ax.set_ylabel("xyz"[up] + " [m]")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8.0)
        with written(path, overwrite=overwrite) as new:
            figure.savefig(new)


def _arrow(ax: Axes, kin: Kinematics, right: int, up: int) -> None:
    """Draw an arrow in the forward direction from halfway between the soles."""
    if right == 0:
        middle = 0.5 * kin.point(kin.swing)
        begin = float(middle[right]), float(middle[up])
        end = begin[0] + 0.4 * float(kin.com[2]), begin[1]
        ax.plot(*end, alpha=0.0)  # room for the arrow
        ax.annotate("", end, begin, arrowprops={"arrowstyle": "->", "color": INK})
        ax.annotate("ahead", end, (2, 0), textcoords="offset points", fontsize=8.0, va="center")


def _bones(model: RobotModel, kin: Kinematics) -> Array:
    """Return the lines from joint to joint, and from the last joint of a leg to its sole, shape (k, 2, 3) [m]."""
    places = [kin.point(link) for link in model.links]
    lines = [(places[body.parent], places[k]) for k, body in enumerate(model.bodies) if body.parent >= 0]
    lines += [(places[model.frames[s.frame].body], kin.point(s.frame, s.center)) for s in model.soles.values()]
    return np.array(lines)


def _triangles(model: RobotModel, kin: Kinematics, file: pathlib.Path) -> Array:
    """Return the triangles of the visual shapes, or else of the collision shapes, shape (k, 3, 3) [m]."""
    shapes = Shapes(Urdf(model.urdf, model.name), file)
    for which in ("visuals", "collisions"):
        found = []
        for link in model.frames:
            pose = DQ(kin.pose(link))
            turn, place = pose.rotation_matrix(), pose.translation()  # a hundred times as fast as a product per corner
            found += [(part.vertices @ turn.T + place)[part.faces] for part in shapes.of(link, which)]
        if found:
            triangles = np.concatenate(found)
            return triangles[:: 1 + len(triangles) // _MOST_TRIANGLES]
    return np.empty((0, 3, 3))
