"""What stops a foot: it lands there, or climbs; stairs."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from dynamic_poppy import CONFIG, MODEL, prepared

from dqwalk_ros.config import overlaid, with_files
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, bag, report
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.table import make_controller


@pytest.mark.parametrize(
    ("bent", "behind", "moves", "delay", "stopped"),
    [
        (0.3, 0.02, 0.0, 0.0, True),
        (0.3, 0.012, 0.0, 0.0, False),  # the legs follow their path less well
        (0.3, 0.02, 3.0, 0.0, False),  # it catches up, or is moved by a support that tips
        (0.0, 0.02, 0.0, 0.0, False),  # it stands
        (0.3, 0.02, 0.0, 0.04, False),
        (0.3, 0.03, 0.0, 0.04, True),
    ],
)
def test_a_foot_is_stopped_in_the_air_at_rest_behind_its_path(
    bent: float, behind: float, moves: float, delay: float, stopped: bool
) -> None:
    walk = prepared(CONFIG)
    q, dq = walk.posture.copy(), np.zeros(MODEL.n)
    q[MODEL.joint_names.index("r_knee_y")] += bent
    dq[MODEL.joint_names.index("r_knee_y")] = moves
    kin = Kinematics(MODEL, q, Foot.LEFT)
    phase = walk.one_foot(Foot.LEFT, kin, kin.pose(kin.swing))
    velocity = np.array([0.2, 0.0])
    place = kin.point(kin.swing)[:2] + np.array([behind, 0.0]) + delay * velocity
    found = walk._stopped(phase, kin, Estimate(1.0, q, dq), place, velocity, delay, 0.1)
    assert (found is not None) is stopped


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"servo.latency": 0.02, "servo.assumed_latency": 0.02},
        {"gait.step_length": 0.126, "gait.most_length": 0.126, "dynamic.quicken": 0.08, "dynamic.aim_inside": 0.0},
        {"gait.steps": 0, "gait.footsteps": ["0.05 0 0 0"] * 10},
    ],
)
def test_a_foot_that_an_obstacle_stops_lands_there(changes: dict[str, object], tmp_path: Path) -> None:
    """Pushed on it makes the robot fall. Afterwards there are steps on the spot, and no commanded footsteps."""
    ahead = {"gait.steps": 10, "physics.rise": 0.05, "physics.stairs_at": 0.15}
    config = overlaid(CONFIG, "physics").updated({**ahead, "qp.solver": "daqp", **changes})
    plant, controller = make_plant("physics", config, MODEL), make_controller(config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    stopped = [k for k, phase in enumerate(trace.phases) if "obstacle" in phase.decision]
    assert stopped
    assert all(later - k > 6 for k, later in itertools.pairwise(stopped))
    assert len(trace.phases) == (stopped[0] + 4 if config.gait.footsteps else 24)
    bag.write(trace, tmp_path / "bag")
    missed = [found["message"] for found in report(analyse(bag.read(tmp_path / "bag")))["violations"]]
    assert any(trace.phases[stopped[0]].decision in message for message in missed)


CLIMB = with_files(overlaid(CONFIG, "physics"), [Path("climb")]).updated({"qp.solver": "daqp"})


@pytest.mark.parametrize(("rise", "onto"), [(0.02, True), (0.035, True), (0.06, False)])
def test_a_walk_climbs_what_has_stopped_it_unless_that_is_too_high(rise: float, onto: bool) -> None:
    """The foot is to land at 15 mm, and stays where it bears weight."""
    config = CLIMB.updated({"gait.steps": 10, "physics.rise": rise, "physics.stairs_at": 0.2})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    heights = [DQ(plant.truth.soles[foot]).translation()[2] for foot in Foot]
    assert heights == pytest.approx([onto * rise] * 2, abs=1e-3)


def test_a_walk_that_cannot_climb_as_high_says_so() -> None:
    with pytest.raises(ConfigError, match=r"gait\.climb: footstep 3, of the right foot: .* gait\.most_length is 0\.09"):
        prepared(CLIMB.updated({"gait.most_length": 0.09}))


@pytest.mark.long
@pytest.mark.parametrize("latency", [0.0, 0.02])
def test_three_stairs_are_climbed_by_touch(latency: float) -> None:
    changes = {"servo.latency": latency, "servo.assumed_latency": latency, "gait.steps": 60}
    config = CLIMB.updated({**changes, "physics.rise": 0.025, "physics.stairs": 3})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    assert trace.finished, trace.notes
    assert all(DQ(plant.truth.soles[foot]).translation()[2] > 0.07 for foot in Foot)


@pytest.mark.long
@pytest.mark.parametrize(("overlays", "up"), [(["stairs"], 0.075), (["stairs", "stairs_down"], -0.075)])
def test_three_stairs_are_walked_by_footsteps(overlays: list[str], up: float) -> None:
    config = with_files(overlaid(CONFIG, "physics"), [Path(name) for name in overlays]).updated({"qp.solver": "daqp"})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    trace = simulate(controller, plant)
    found = report(analyse(trace))
    assert found["ok"], found["violations"]
    assert [DQ(plant.truth.soles[foot]).translation()[2] for foot in Foot] == pytest.approx([up, up], abs=1e-3)
