"""Each equation (S1)-(S24) stands at one place in the code, and that place is executed."""

from __future__ import annotations

import io
import re
import sys
import tokenize
from pathlib import Path

import numpy as np

from dqwalk_ros import whole_body
from dqwalk_ros.config import load
from dqwalk_ros.robot import load_model
from dqwalk_ros.whole_body import Scenario, WholeBodyController, follow
from dqwalk_ros.whole_body.rigid_plant import RigidPlant

FOLDER = Path(whole_body.__file__).parent


def tags() -> dict[int, list[tuple[str, int]]]:
    """Return where each number is in a comment: file and line, that of the code below a comment of its own."""
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


def test_each_equation_is_at_one_place_that_runs() -> None:
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
