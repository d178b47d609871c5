"""Every equation of the paper is executed: it is changed at its tag, and the walk must change.

Each case changes one line of a copy of the package, and compares the rows of both phases and a walk ten times as
fast as the paper's. If a second copy of the formula were executed instead, both would remain unchanged.
"""

from __future__ import annotations

import re

import pytest
from mutated import ROOT, changed, changes_output, copy_package, output_of

PLACES = {
    "(U1)": ("dqwalk_ros/paper/kinematics.py", "2.0 * t[1], 2.0 * t[2]", "2.1 * t[1], 2.0 * t[2]"),
    "(U2)": ("dqwalk_ros/paper/kinematics.py", "link[11] * (p[k] + c[k])", "link[11] * (p[k] - c[k])"),
    "(U3)": ("dqwalk_ros/paper/kinematics.py", "0.5 * lines[i, k], 0.5", "0.6 * lines[i, k], 0.5"),
    "(U4)": ("dqwalk_ros/paper/kinematics.py", "p_com[:] = subtree[0, :3]", "p_com[:] = 1.1 * subtree[0, :3]"),
    "(U5)": (
        "dqwalk_ros/paper/kinematics.py",
        "subtree[b], subtree[b, 3], J_com",
        "subtree[b], 1.1 * subtree[b, 3], J_com",
    ),
    "(U6)": ("dqwalk_ros/paper/qp/problem.py", "H[i, i] += damping**2", "H[i, i] += damping"),
    "vector-field inequality": (
        "dqwalk_ros/paper/constraints.py",
        "eta, 1.0 / dt) * (d - bound)",
        "eta, 1.0 / dt) * d + 1e-3",
    ),
    "(U7)": (
        "dqwalk_ros/paper/walk.py",
        'name="sliding", eta=dsp.eta_sliding',
        'name="sliding", eta=2.0 * dsp.eta_sliding',
    ),
    "(U7) and (U14)": ("dqwalk_ros/paper/constraints.py", "a[6] ** 2 - square", "a[6] ** 2 - 1.1 * square"),
    "(U8)": ("dqwalk_ros/paper/walk.py", "point=tip, plane=Plane(Z, 0.0)", "point=tip, plane=Plane(Z, 1e-3)"),
    "(U9)": ("dqwalk_ros/paper/walk.py", 'wall("tip_plane", dsp.eta_tip', 'wall("tip_plane", 2.0 * dsp.eta_tip'),
    "(U10)": ("dqwalk_ros/paper/walk.py", 'wall("back_plane", dsp.eta_back', 'wall("back_plane", 2.0 * dsp.eta_back'),
    "(U9) and (U10)": (
        "dqwalk_ros/paper/constraints.py",
        "point_to_wall(s, a[:3], a[3])",
        "point_to_wall(s, a[:3], -a[3])",
    ),
    "(U11)": ("dqwalk_ros/paper/walk.py", "Plane(Z, config.pelvis.height)", "Plane(Z, 1.1 * config.pelvis.height)"),
    "(U12)": ("dqwalk_ros/paper/walk.py", "q_max=model.q_max", "q_max=0.9 * model.q_max"),
    "(U13)": ("dqwalk_ros/paper/walk.py", "q_min=model.q_min", "q_min=0.9 * model.q_min"),
    "q_max - q of (U12)": ("dqwalk_ros/paper/constraints.py", "return q_max - q,", "return 0.9 * q_max - q,"),
    "q - q_min of (U13)": ("dqwalk_ros/paper/constraints.py", "return q - q_min,", "return q - 0.9 * q_min,"),
    "(U14)": (
        "dqwalk_ros/paper/walk.py",
        'name="com_cylinder", eta=ssp.eta_com',
        'name="com_cylinder", eta=2.0 * ssp.eta_com',
    ),
    "section 4.1": (
        "dqwalk_ros/paper/tasks.py",
        "-np.eye(2, 3)]",
        "-0.9 * np.eye(2, 3)]",
    ),
    "ection 4.2": ("dqwalk_ros/paper/tasks.py", "return sign * s - target", "return 1.01 * sign * s - target"),
    "switching rule of section 5": (
        "dqwalk_ros/paper/phase.py",
        "fall < self._stall and",
        "fall < 0.1 * self._stall and",
    ),
    "of Fig. 1": ("dqwalk_ros/paper/walk.py", "PHASES_PER_CYCLE < 2 else", "PHASES_PER_CYCLE < 1 else"),
}
"""Tag, file, the original line, and the changed line."""

LOOK = """
import numpy as np
from dqwalk_ros import Foot, KinematicPlant, Kinematics, load, load_model, make_controller, make_walk, simulate
from dqwalk_ros.paper.phase import PhaseKind
config = load("paper").updated({"task.eta": 0.5, "task.damping": 0.03})
model = load_model(config.robot)
walk, q = make_walk(config, model), np.linspace(-0.05, 0.05, model.n)
for kind, target in ((PhaseKind.DOUBLE_SUPPORT, None), (PhaseKind.SINGLE_SUPPORT, walk.footstep(Foot.LEFT))):
    phase = walk.phase(kind, Foot.LEFT, np.zeros(model.n), target)
    problem = phase.evaluate(q, dt=config.dt, velocity=model.velocity_max).problem
    print(np.array2string(problem.numbers, precision=12, threshold=10**6))
trace = simulate(make_controller(config, model), KinematicPlant(model), max_time=9.0)
print([(phase.name, round(phase.time, 6)) for phase in trace.phases], trace.notes)
"""


@pytest.mark.parametrize("tag", PLACES)
def test_each_tag_marks_one_line(tag):
    assert changed(tag, *PLACES[tag])


def test_one_comment_marks_each_equation_at_the_line_that_is_changed():
    marks = [
        (number, str(file.relative_to(ROOT)), row)
        for file in sorted((ROOT / "dqwalk_ros").rglob("*.py"))
        for row, line in enumerate(file.read_text(encoding="utf-8").splitlines())
        for number in re.findall(r"# \(U(\d+)\)", line)
    ]
    assert sorted(int(number) for number, _, _ in marks) == list(range(1, 15))
    for number, file, row in marks:
        name, line, _ = PLACES[f"(U{number})"]
        text = (ROOT / name).read_text(encoding="utf-8")
        assert (name, True) == (file, abs(text[: text.index(line)].count("\n") - row) <= 3), number


@pytest.mark.long
@pytest.mark.parametrize("tag", PLACES)
def test_the_equation_at_each_tag_is_executed(tag, tmp_path):
    assert "double_support/left" in output_of(LOOK)
    assert changes_output(tmp_path, LOOK, tag, *PLACES[tag])


@pytest.mark.long
def test_the_walk_uses_the_parameters_of_the_configuration(tmp_path):
    copy_package(tmp_path)
    assert output_of(LOOK, tmp_path) == output_of(LOOK)
    output_of.cache_clear()
    config = tmp_path / "config" / "paper.yaml"
    text = config.read_text(encoding="utf-8")
    assert text.count("eta_tip: 10.0") == 1
    config.write_text(text.replace("eta_tip: 10.0", "eta_tip: 11"), encoding="utf-8")
    assert output_of(LOOK, tmp_path) != output_of(LOOK)
