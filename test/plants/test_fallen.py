"""Whether a simulated robot has fallen, for any root link."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim")

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.engine import standing_root
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model

CONFIG = overlaid(load("poppy"), "physics").updated({"physics.settle": 0.1})
FLOOR = """<robot name="poppy_humanoid">
  <link name="base_footprint"/>
  <joint name="to_pelvis" type="fixed">
    <parent link="base_footprint"/><child link="pelvis"/><origin xyz="0 0 -0.42" rpy="{rpy}"/>
  </joint>"""


@pytest.mark.parametrize("rpy", ["0 0 0", "3.14159265 0 0", "0 1.2 0"])
def test_a_fall_does_not_depend_on_the_root_link(tmp_path: Path, rpy: str) -> None:
    """A root link such as base_footprint is on the floor; it may also be upside down."""
    urdf = load_model(CONFIG.robot).urdf.replace('<robot name="poppy_humanoid">', FLOOR.format(rpy=rpy), 1)
    (tmp_path / "robot.urdf").write_text(urdf)
    config = CONFIG.updated({"robot.urdf": str(tmp_path / "robot.urdf")})
    model = load_model(config.robot)
    assert model.root == "base_footprint"
    plant, still = make_plant("physics", config, model), Command(0.0, np.zeros(model.n))
    for _ in range(10):
        plant.step(still, config.dt)
        assert not plant.fallen
    plant.push([60.0, 0.0, 0.0])
    for k in range(400):
        plant.step(still, config.dt)
        if k == 40:
            plant.push(np.zeros(3))
        if plant.fallen:
            break
    assert plant.fallen
    assert k > 40


@pytest.mark.parametrize("engine", ["physics", "drake"])
@pytest.mark.parametrize("floor", [-0.5, 0.0, 0.5])
def test_a_fall_is_judged_over_the_soles(engine: str, floor: float) -> None:
    """Wherever stairs have led them; a robot on its knees has fallen."""
    if engine == "drake":
        pytest.importorskip("pydrake", reason="there is no wheel of Drake for this machine")
    model = load_model(CONFIG.robot)
    plant = make_plant(engine, CONFIG, model)
    for posture, fallen in (([], False), (["?_hip_y=-1.7", "?_knee_y=2.3", "?_ankle_y=-0.6"], True)):
        q = model.posture(posture)
        plant._seat(q, (DQ.from_pose([0.0, 0.0, floor]) * DQ(standing_root(model, q))).vec8())
        assert plant.fallen is fallen
