"""Each equation (S1)-(S24) is marked at one line of code, which is executed: if it is changed, the walk changes."""

from __future__ import annotations

import io
import re
import sys
import tokenize
from pathlib import Path

import numpy as np
import pytest
from mutated import changed, changes_output, output_of

from dqwalk_ros import whole_body
from dqwalk_ros.config import load
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.whole_body import Scenario, WholeBodyController, follow
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

FOLDER = Path(whole_body.__file__).parent


def tags() -> dict[int, list[tuple[str, int]]]:
    """Return file and line of the code that each tag marks, by number; a comment line marks the code below it."""
    found: dict[int, list[tuple[str, int]]] = {}
    for file in FOLDER.glob("*.py"):
        text = file.read_text(encoding="utf-8")
        lines = text.splitlines()
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type != tokenize.COMMENT:
                continue
            row = token.start[0]
            while lines[row - 1].lstrip().startswith("#"):
                row += 1
            for number in re.findall(r"\(S(\d+)\)(?= |$)", token.string):
                found.setdefault(int(number), []).append((str(file), row))
    return found


def test_each_equation_is_tagged_at_one_executed_line() -> None:
    found = tags()
    assert sorted(found) == list(range(1, 25))
    assert {number: places for number, places in found.items() if len(places) != 1} == {}
    config = load("whole_body")
    model = load_model(config.robot)
    executed: set[tuple[str, int]] = set()

    def trace(frame, event, argument):
        if not frame.f_code.co_filename.startswith(str(FOLDER)):
            return None
        if event == "line":
            executed.add((frame.f_code.co_filename, frame.f_lineno))
        return trace

    controller = WholeBodyController(config, model)
    plant = RigidPlant(model, controller.start, pushed=config.whole_body.torso)
    scenario = Scenario("short", 0.5, ((0.0, (0.6, -0.4, 0.9)),), ((0.2, (0.0, 5.0, 0.0)),))
    before = sys.gettrace()
    sys.settrace(trace)
    try:
        walked = follow(controller, plant, scenario)
    finally:
        sys.settrace(before)
    assert walked.stood
    assert np.isfinite(walked.effort).all()
    missed = {
        number for number, [(file, row)] in found.items() if not any((file, row + k) in executed for k in (0, 1, 2))
    }
    assert missed == set()


EQUATIONS, OBJECTIVES, PREVIEW, PLANT = (
    f"dqwalk_ros/whole_body/{name}.py" for name in ("equations", "objectives", "preview", "rigid_plant")
)
PLACES = {
    1: (EQUATIONS, "= d.H[6:] / most[:, None]", "= 1.1 * d.H[6:] / most[:, None]"),
    2: (EQUATIONS, "= d.H[:6] / weight", "= 1.1 * d.H[:6] / weight"),
    3: (EQUATIONS, "base[:, mu] = -J[3:, :6].T", "base[:, mu] = -1.1 * J[3:, :6].T"),
    4: (EQUATIONS, "base[:, lam] = -J[:3, :6].T @ edges", "base[:, lam] = -1.1 * J[:3, :6].T @ edges"),
    5: (EQUATIONS, "rows.bound(lam, 0.0, np.inf, LAW)", "rows.bound(lam, 0.01, np.inf, LAW)"),
    6: (EQUATIONS, "sign * np.eye(3)", "sign * np.diag([1.0, 1.0, 0.9])"),
    7: (EQUATIONS, "sign * np.eye(3)", "sign * np.diag([0.9, 0.9, 1.0])"),
    8: (EQUATIONS, "rows.equal(-sole.drift - config", "rows.equal(sole.drift - config"),
    9: (EQUATIONS, "2.0 * gap / T**2", "1.9 * gap / T**2"),
    10: (PREVIEW, "= -mass.zeta, com[:2]", "= mass.zeta, com[:2]"),
    11: (PREVIEW, "= 0.5 * config.cop_length,", "= 0.4 * config.cop_length,"),
    12: (PREVIEW, "(-config.step_length, across[0])", "(0.0, across[0])"),
    13: (PREVIEW, "c[:2] + c_dot[:2] / self.omega", "c[:2] + c_dot[:2]"),
    14: (EQUATIONS, "stop[0, y] = mass.alpha @ preview.M", "stop[0, y] = 1.1 * mass.alpha @ preview.M"),
    15: (EQUATIONS, "com[0, y.start] = d.com_jacobian[axis], -1.0", "com[0, y.start] = d.com_jacobian[axis], -1.1"),
    16: (EQUATIONS, "across[:, : at.nv] = J[:2] / a", "across[:, : at.nv] = 1.1 * J[:2] / a"),
    17: (OBJECTIVES, "return pull - self.kd", "return 0.9 * pull - self.kd"),
    18: (OBJECTIVES, "return -self.kp * error", "return -0.9 * self.kp * error"),
    19: (OBJECTIVES, "return self.stiffness * (self.reference", "return 0.9 * self.stiffness * (self.reference"),
    20: (EQUATIONS, "config.jerk_weight * a * a", "config.jerk_weight * a"),
    21: (
        EQUATIONS,
        "diagonal[y][preview.cops] += config.cop_weight",
        "diagonal[y][preview.cops] += 0.9 * config.cop_weight",
    ),
    22: (EQUATIONS, "H[y, y] += damping", "H[y, y] += 0.9 * damping"),
    23: (PLANT, "momentum = d.H @ s.v +", "momentum = 0.9 * d.H @ s.v +"),
    24: (PLANT, "momentum, np.zeros(len(J)))", "momentum, np.full(len(J), 1e-3))"),
}
"""File, the original line, and the changed line."""

LOOK = """
from dqwalk_ros import load, load_model
from dqwalk_ros.whole_body import Scenario, WholeBodyController, follow
from dqwalk_ros.whole_body.rigid_plant import RigidPlant
config = load("whole_body")
model = load_model(config.robot)
controller = WholeBodyController(config, model)
plant = RigidPlant(model, controller.start, pushed="chest")
scenario = Scenario("short", 0.5, ((0.0, (0.6, -0.4, 0.9)),), ((0.2, (0.0, 5.0, 0.0)),))
walked, h = follow(controller, plant, scenario), controller.last.problem
for part in (walked.q[-1], h.H, h.c, h.A, h.lower, h.upper):
    print([f"{number:.9g}" for number in part.ravel()])
"""


@pytest.mark.parametrize("number", PLACES)
def test_each_changed_line_is_below_its_tag(number: int) -> None:
    assert changed(f"(S{number})", *PLACES[number])


@pytest.mark.long
@pytest.mark.parametrize("number", PLACES)
def test_a_changed_equation_changes_the_walk(number: int, tmp_path: Path) -> None:
    assert output_of(LOOK).count("\n") == 6, output_of(LOOK)
    assert changes_output(tmp_path, LOOK, f"(S{number})", *PLACES[number])
