"""The standing walk catches by steps of the dynamic walk the pushes that one sole cannot balance."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="needs the extra sim")

import dqwalk_ros as dq
from dqwalk_ros.config import overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Estimate
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, bag, report
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies.pushes import Push, limits, pushed
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.trace import Trace
from dqwalk_ros.walks.dynamic import recovery
from dqwalk_ros.walks.dynamic.recovery import RecoveringWalk
from dqwalk_ros.walks.dynamic.swing import Swing, advanced
from dqwalk_ros.walks.standing.walk import StandingWalk
from dqwalk_ros.walks.table import make_controller

CONFIG = overlaid(dq.load("poppy"), "physics").updated({"qp.solver": "daqp"})
MODEL = dq.load_model(CONFIG.robot)
WITHOUT = {"gait.recover": ""}
INWARD = -0.5 * math.pi
"""Direction of the swing foot in support on the left foot [rad]."""


def walked(changes: dict[str, object], newtons: float = 0.0, max_time: float | None = None) -> Trace:
    """Return a walk of one step, pushed for 0.1 s towards the swing foot in the middle of it."""
    config = CONFIG.updated({"gait.steps": 1, **changes})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)
    begin, since = plant.state.time, math.inf

    def push(time: float) -> None:
        nonlocal since
        if since == math.inf and controller.phase_index == 1 and begin + time >= controller.phase_began + 0.75:
            since = time
        plant.push(np.array([0.0, -newtons if since <= time < since + 0.1 - 1e-9 else 0.0, 0.0]))

    return simulate(controller, plant, before_step=push, max_time=max_time)


def test_a_push_in_mid_step_is_caught_by_a_step(tmp_path: Path) -> None:
    pushed_by = 6.0  # 0.6 N s, towards the swing foot
    assert not walked(WITHOUT, pushed_by).finished
    trace = walked({}, pushed_by)
    assert trace.finished, trace.notes
    names = [record.name for record in trace.phases]
    first = next(k for k, record in enumerate(trace.phases) if record.config is not None)
    assert "steps catch a push" in trace.phases[first - 1].decision
    assert names[first] == names[first - 1] == "single_support/left"
    steps = [record for record in trace.phases if record.config is not None]
    assert all(record.config is not None and record.config.gait.style == "dynamic" for record in steps)
    assert steps[-1].kind is PhaseKind.STANCE
    # then the standing walk continues with its steps
    assert names[-3:] == ["double_support/right", "single_support/right", "stance/left"]
    bag.write(trace, tmp_path / "bag")
    again = bag.read(tmp_path / "bag")
    assert [record.name for record in again.phases] == names
    styles = [[(record.config or one.config).gait.style for record in one.phases] for one in (trace, again)]
    assert styles[0] == styles[1]
    assert report(analyse(again))["ok"]


def test_without_a_push_the_walk_is_the_same() -> None:
    alone, ready = (walked(changes, max_time=3.5) for changes in (WITHOUT, {}))
    assert [record.name for record in ready.phases][1:] == ["single_support/left", "double_support/right"]
    assert np.array_equal(alone.q, ready.q)
    assert np.array_equal(alone.u, ready.u, equal_nan=True)
    assert not any(record.decision for record in ready.phases)


def recovering(changes: dict[str, object]) -> RecoveringWalk:
    config = CONFIG.updated(changes)
    walk = RecoveringWalk(config, MODEL)
    walk.prepare()
    return walk


def observed(walk: RecoveringWalk, beyond: float, *, up: bool = True, kind: str = "single_support") -> bool:
    """Return whether steps take over from a single support on the left foot, with xi beyond the sole [m]."""
    kin = Kinematics(MODEL, walk.posture, Foot.LEFT)
    phase = walk.phase(PhaseKind(kind), Foot.LEFT, walk.posture, kin.pose(kin.swing))
    walk._beyond_sole = lambda *_: beyond  # type: ignore[method-assign]
    change = walk.observe(phase, kin, Estimate(0.0, walk.posture, up=np.array([0.0, 0.0, 1.0]) if up else None))
    assert change is None or change.walk is walk.steps
    return change is not None


def test_steps_take_over_once_xi_is_beyond_the_sole_at_three_states_in_a_row() -> None:
    """Noise does not trigger them."""
    walk = recovering({})
    beyond = [0.001, 0.001, -0.001, 0.001, 0.0, 0.001, 0.001, 0.002, 0.001, 0.001, 0.001]
    assert [k for k, one in enumerate(beyond) if observed(walk, one)] == [7, 10]
    assert not any(observed(walk, 0.1, up=False) for _ in range(9))
    assert not any(observed(walk, 0.1, kind="double_support") for _ in range(9))


@pytest.mark.parametrize(("latency", "catches"), [(0.0, True), (0.027, True), (0.028, False)])
def test_steps_take_over_only_from_a_drive_that_is_fast_enough(latency: float, catches: bool) -> None:
    """The servos and half a period delay it by another 22.5 ms."""
    walk = recovering({"servo.assumed_latency": latency})
    assert any(observed(walk, 0.1) for _ in range(9)) is catches


@pytest.mark.parametrize("landing", [0.05, -0.05])
def test_a_push_counts_as_balanced_once_xi_is_between_heels_and_toes_of_both_feet(landing: float) -> None:
    """At a landing that is moved by 10 mm, on a support foot that is 0.2 m ahead of the origin."""
    steps = recovering({}).steps
    half, landed = 0.5 * MODEL.soles[Foot.LEFT].length - steps.config.dynamic.catch_margin, landing + 0.01
    step = SimpleNamespace(z=np.array([0.2, 0.0]), landing=np.array([0.2 + landing, -0.1]))
    steps._flight = SimpleNamespace(step=step, shift=np.array([0.01, 0.0]))  # type: ignore[assignment]
    back, front = min(landed, 0.0) - half, max(landed, 0.0) + half
    for xi, caught in ((back - 1e-3, False), (back + 1e-3, True), (front - 1e-3, True), (front + 1e-3, False)):
        steps._now = SimpleNamespace(smooth=np.array([0.2 + xi, 0.0]))  # type: ignore[assignment]
        assert bool(steps._caught) is caught


@pytest.mark.parametrize("foot", list(Foot))
def test_xi_is_beyond_the_sole_where_the_ankle_cannot_bring_it_back(
    monkeypatch: pytest.MonkeyPatch, foot: Foot
) -> None:
    """Ahead, back and towards the swing foot; the outer side does not count, because no foot can land there."""
    walk, sole = recovering({}), MODEL.soles[foot]
    kin, at = Kinematics(MODEL, walk.posture, foot), np.zeros(2)
    monkeypatch.setattr(recovery, "com_and_xi", lambda *_: (at, sole.center[:2] + at))
    along = 0.5 * sole.length - walk.steps.config.dynamic.catch_margin
    across = 0.5 * sole.width - walk.config.standing.pressure_margin
    inward = -1.0 if foot is Foot.LEFT else 1.0
    state = Estimate(0.0, walk.posture, np.zeros(MODEL.n), np.array([0.0, 0.0, 1.0]), np.zeros(3))
    for x, y, beyond in (
        (along + 0.003, 0.0, 0.003),
        (-along - 0.003, 0.0, 0.003),
        (along - 0.003, 0.0, -0.003),
        (0.0, across + 0.004, 0.004),
        (0.0, across - 0.004, -0.004),
    ):
        at[:] = x, inward * y
        assert walk._beyond_sole(kin, state) == pytest.approx(beyond, abs=1e-9)
    at[:] = 0.0, -inward * (across + 0.1)
    assert walk._beyond_sole(kin, state) < 0.0


def test_the_steps_must_be_those_of_a_dynamic_walk() -> None:
    with pytest.raises(ConfigError, match=r"gait\.style must be dynamic, not standing"):
        make_controller(CONFIG.updated({"gait.recover": "poppy"}), MODEL)
    with pytest.raises(ConfigError, match="no configuration 'nothing'"):
        make_controller(CONFIG.updated({"gait.recover": "nothing"}), MODEL)
    # a recorded walk is read without the file
    recorded = StandingWalk(CONFIG.updated({"gait.recover": "nothing"}), MODEL)
    assert recorded.phase(PhaseKind.STANCE, Foot.LEFT, recorded.posture).kind is PhaseKind.STANCE


def test_a_tuned_parameter_also_applies_to_the_steps_unless_they_have_their_own() -> None:
    tuned = {"gait.step_height": 0.03, "standing.swing_duration": 2.0}
    walk = RecoveringWalk(CONFIG, MODEL)
    walk.prepare()
    before = walk.steps.config
    walk.tune(CONFIG.updated(tuned))
    assert before.gait.step_height == 0.02
    assert walk.steps.config == before.updated({"gait.step_height": 0.03})
    assert walk.steps.footsteps.config is walk.steps.config


def test_a_foot_in_the_air_descends_from_where_it_is() -> None:
    start, goal, dt = DQ.from_pose([-0.02, 0.09, 0.013]).vec8(), DQ.from_pose([0.01, 0.09, 0.0]).vec8(), 0.001
    swing = Swing(start, goal, 0.02, 0.4)
    assert 0.2 < swing.begun < 0.4
    times = swing.begun + dt * np.arange(round((0.4 - swing.begun) / dt) + 1)
    path = np.array([advanced(*swing.compiled, t, 0.4)[0][:3] for t in times])
    assert path[0] == pytest.approx([-0.02, 0.09, 0.013], abs=1e-4)
    assert path[-1] == pytest.approx([0.01, 0.09, 0.0], abs=1e-4)
    assert np.diff(path[:, 2]).max() <= 0.0


@pytest.mark.long
def test_the_largest_pushes_of_the_standing_walk(tmp_path: Path) -> None:
    """In mid-step: a step catches twice and more of what the soles bear, but to the outside, where no foot can land."""
    steps, table = dq.load("poppy").updated({"qp.solver": "daqp"}), {}
    for name, config in {"with": steps, "without": steps.updated(WITHOUT)}.items():
        found = limits(config, tmp_path / name, Push("left", 0.0, 0.0), ["left"], tolerance=0.05)
        table[name] = {round(math.degrees(one.direction)): one.survived for one in found}
    print()
    for angle in table["with"]:
        print(
            f"{angle:4d} degrees: {table['without'][angle]:.2f} N s on the sole, {table['with'][angle]:.2f} with steps"
        )
    assert all(table["with"][angle] > table["without"][angle] for angle in table["with"])
    assert min(table["with"][angle] for angle in (225, 270, 315)) > 0.7
    assert pushed(steps, Push("right", -INWARD, 0.6)) == ""  # the same on the other foot
