"""The dynamic walk: its phases, what moves with a delay, and walks in physics."""

from __future__ import annotations

import copy
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from dynamic_poppy import CONFIG, MODEL, inclined, prepared, random_posture, still, swing_target
from walks import values

import dqwalk_ros as dq
from dqwalk_ros.config import find_share, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import Observer
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import analyse, report
from dqwalk_ros.robot.servos import Drive
from dqwalk_ros.simulation import simulate
from dqwalk_ros.studies import robustness
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.walks.com import com_and_xi
from dqwalk_ros.walks.dynamic.force import converging, fed_back
from dqwalk_ros.walks.dynamic.pendulum import (
    Moving,
    when_acting,
)
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.following import FollowPose, Target
from dqwalk_ros.walks.table import make_controller

DYNAMIC = CONFIG.dynamic


@pytest.mark.parametrize(("latency", "late"), [(0.0, 0.0), (0.0, 0.03), (0.02, 0.0), (0.04, 0.02)])
def test_a_delay_moves_foot_pressure_and_reference_ahead(
    latency: float, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With D, the delay less a period: the foot is down 1.4 D early, the reference of the CoM ahead by 0.75 D.

    With ``dynamic.land_late`` the foot is down later.

    In double support the plan's pressure is that of D before the command acts: until then one foot is in the air.
    """
    config = CONFIG.updated({"servo.latency": latency, "servo.assumed_latency": latency, "dynamic.catch": False})
    q, up, drive = MODEL.posture(config.standing.posture), inclined(0.0), Drive.of(config, MODEL)
    ahead = max(drive.delay - config.dt, 0.0)
    down, later = config.standing.swing_duration - 1.4 * ahead, config.updated({"dynamic.land_late": late})
    heights = [swing_target(later, q, up, up, math.ceil((down + late) / config.dt) + k)[2] for k in (-3, 0)]
    level = swing_target(later, q, up, up, 200)[2]
    assert heights[0] > level + 1e-6
    assert heights[1] == pytest.approx(level, abs=1e-9)

    walk = prepared(config)
    both = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q)
    kin, omega = Kinematics(MODEL, q, Foot.LEFT, up), walk.pendulum.omega
    walk.observe(both, kin, still(1.0, q, up, 0.0))
    planned, time, before = walk._reference, 1.0 + config.dt, copy.deepcopy(walk._now)
    walk.observe(both, kin, still(time, q, up, config.dt))
    now, (c, xi) = walk._now, com_and_xi(kin, still(time, q, up, 0.0), omega)
    led = converging(now.c, now.xi, planned.at(config.dt + 0.75 * ahead)[0], omega, 0.75 * ahead)
    np.testing.assert_allclose(walk._targets["com"].numbers, np.concatenate(led), rtol=1e-12)
    _, xi = when_acting(Moving(*before.compiled), time, c, xi)
    (due, _), (_, z) = (planned.at(config.dt + drive.delay - less) for less in (0.0, ahead))
    fed = fed_back(z, due, xi, walk._gain, 0.0, *walk._support, config.standing.pressure_margin)
    np.testing.assert_allclose(now.pressure, fed, rtol=1e-12)


@pytest.mark.parametrize("steps", [0, 4])
def test_what_is_left_of_a_commanded_footprint_ends_when_the_feet_are_put_together(steps: int) -> None:
    """Also a side or turn that no other step of the walk has; it would step on the spot for ever."""
    walk = prepared(CONFIG.updated({"gait.steps": steps}))
    walk._done, step, together = steps, np.array([0.1, 1e-4, 1e-4]), False
    walk.stop()
    for done in range(steps, steps + 20):
        step, together = walk._after(step, done, Foot.LEFT)
        if together:
            return
    pytest.fail(f"the last step is {step}")


def test_follow_pose_feeds_the_target_velocity_forward() -> None:
    kin = Kinematics(MODEL, random_posture(5), Foot.LEFT)
    x = DQ(kin.pose(kin.swing))
    place, velocity = np.array([*x.translation(), *x.vec4()[:4]]), np.arange(6.0)
    task = FollowPose(name="swing", frame=kin.swing, target=Target(place, velocity), eta=12.0, lever=0.2)
    e, _ = values(task, kin)
    assert e == pytest.approx(np.zeros(6), abs=1e-9)
    s = Observer(task.watches, kin.tree)(kin)[0]
    assert -task.evaluate(s)[2] == pytest.approx(velocity * [1, 1, 1, 0.2, 0.2, 0.2])


def test_sequence_of_phases() -> None:
    walk = DynamicWalk(CONFIG.updated({"gait.steps": 2}), MODEL)
    names, phase, q = [], None, walk.posture
    while (begins := walk.following(phase, Kinematics(MODEL, q, Foot.LEFT))) is not None:
        phase = walk.phase(begins.kind, begins.support, q, begins.swing_target)
        names.append(phase.name)
    left, right = "left", "right"
    assert names == [
        "stance/left",
        *(f"{kind}/{foot}" for foot in (left, right, left) for kind in ("double_support", "single_support")),
        "stance/right",
    ]
    assert len(names) == DynamicWalk.phases(walk.config)


@pytest.mark.parametrize("kind", PhaseKind)
def test_a_phase_is_that_of_a_new_walk_and_assembled_once_for_each_kind_and_foot(kind: PhaseKind) -> None:
    q, walk, new = MODEL.posture(CONFIG.standing.posture), prepared(CONFIG), prepared(CONFIG)
    later = q + 0.02 * np.sin(np.arange(MODEL.n))
    steps = [walk.footsteps.wanted(Foot.LEFT, length, 0.0, 0.0) for length in (0.05, 0.08)]
    first = walk.phase(kind, Foot.LEFT, q, steps[0])
    first.evaluate(q)
    again, other = (one.phase(kind, Foot.LEFT, later, steps[1]) for one in (walk, new))
    assert again.assembly is first.assembly
    assert again.q_start is not first.q_start
    expected, found = other.evaluate(q, elapsed=0.0), again.evaluate(q, elapsed=0.0)
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_array_equal(found.problem.numbers, expected.problem.numbers)


def test_a_steered_walk_ramps_its_steps_and_stops_with_feet_together() -> None:
    walk = DynamicWalk(CONFIG.updated({"gait.steps": 0}), MODEL)
    stance = walk.phase(PhaseKind.STANCE, Foot.LEFT, walk.posture)
    assert not stance.rule.is_over(lambda: 0.0, 100.0)  # it waits
    fastest = CONFIG.gait.most_length / (0.5 - DYNAMIC.quicken)
    assert fastest == pytest.approx(0.2, abs=0.005)
    assert walk.steer(1.0, 0.0, 0.0)[0] == pytest.approx(fastest)
    assert stance.rule.is_over(lambda: 0.0, 100.0)
    step, lengths = np.zeros(3), []
    for k in range(6):
        step, _ = walk._after(step, k, Foot.LEFT)
        lengths.append(step[0])
    assert lengths == pytest.approx(CONFIG.gait.most_length * np.array([0.25, 0.5, 0.75, 1.0, 1.0, 1.0]))
    walk.steer(0.0, 0.0, 0.0)
    for _ in range(3):
        step, together = walk._after(step, 9, Foot.LEFT)
        assert not together
    assert walk._after(step, 9, Foot.LEFT)[1]


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.17, 0.27])
def test_a_steered_walk_takes_the_steps_of_its_velocity(speed: float) -> None:
    """Longer steps are quicker."""
    walk = DynamicWalk(FAST.updated({"gait.steps": 0}), MODEL)
    assert walk.steer(speed, 0.0, 0.1) == pytest.approx((speed, 0.0, 0.1))
    length, _, turn = walk._step_at((speed, 0.0, 0.1))
    double, single = walk._durations(length)
    assert length / (double + single) == pytest.approx(speed)
    assert turn / (double + single) == pytest.approx(0.1)
    assert double + single <= 0.5


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"dynamic.quicken": 0.2}, r"lasts 0 s.*lower dynamic\.quicken \(0\.2 s\)"),
        ({"dynamic.quicken": 0.05, "dt": 0.09}, r"less than dt, 0\.09 s"),
    ],
)
def test_a_step_without_time_for_a_support_is_refused(values: dict[str, float], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        DynamicWalk(CONFIG.updated(values), MODEL)


def test_the_trunk_keeps_its_posture_over_many_steps() -> None:
    """At 0.30 m/s; a trunk that moves the CoM is at the limit of its pitch in every step."""
    config = CONFIG.updated({"gait.steps": 12, "gait.step_length": 0.126, "gait.most_length": 0.126})
    config = config.updated({"dynamic.quicken": 0.08})
    trace = simulate(make_controller(config, MODEL), make_plant("integrator", config, MODEL))
    assert trace.finished, trace.notes
    bent = {
        name: np.degrees(trace.q[:, MODEL.joint_names.index(name)]) for name in ("abs_y", "bust_y", "abs_z", "bust_x")
    }
    assert max(np.abs(bent[name]).max() for name in ("abs_y", "bust_y")) < 1.0
    assert max(abs(bent[name][-1]) for name in bent) < 2.0


@pytest.mark.long
@pytest.mark.parametrize("noise", [False, True])
def test_cmd_vel_steers_the_dynamic_walk_on_a_circle(noise: bool) -> None:
    """Of 0.5 m, to 3 cm, and round to 5 mm; a sole that slips at the landing of the other would make it larger."""
    sensors = {"attitude_noise": 0.004, "gyro_noise": 0.02, "encoder": 0.001534, "velocity_filter": 0.01, "seed": 1}
    changes = {f"sensors.{key}": value for key, value in sensors.items()} if noise else {}
    config = overlaid(CONFIG, "physics").updated({"gait.steps": 0, "qp.solver": "daqp", **changes})
    controller, plant = make_controller(config, MODEL), make_plant("physics", config, MODEL)

    def steer(time: float) -> None:
        controller.steer(0.08, 0.0, 0.16) if time < 46.0 else controller.stop()

    trace = simulate(controller, plant, before_step=steer, max_time=60.0)
    assert trace.finished, trace.notes
    assert trace.physics is not None
    second = np.ones(round(1.0 / config.dt)) * config.dt  # the mean over a second is without the sway
    walking = (trace.time > 4.0) & (trace.time < 45.0)
    pelvis = DQ(trace.physics.pelvis).translation()
    x, y = (np.convolve(pelvis[:, k], second, "same")[walking] for k in range(2))
    fit, *_ = np.linalg.lstsq(np.column_stack([2.0 * x, 2.0 * y, np.ones_like(x)]), x**2 + y**2, rcond=None)
    radius = math.sqrt(fit[2] + fit[0] ** 2 + fit[1] ** 2)
    off = np.abs(np.hypot(x - fit[0], y - fit[1]) - radius).max()
    print(f"\ncircle of {radius:.3f} m, round to {1e3 * off:.1f} mm")
    assert radius == pytest.approx(0.5, abs=0.03)
    assert off < (0.008 if noise else 0.005)


@pytest.mark.long
@pytest.mark.parametrize("latency", [0.0, 0.02])
@pytest.mark.parametrize("speed", [0.10, 0.17])
def test_a_biped_with_ankle_roll_walks_dynamically(speed: float, latency: float) -> None:
    """With Poppy's parameters, but its aims and its lateral frequency."""
    biped = dq.load(str(Path(__file__).parents[1] / "data" / "biped12.yaml"))
    own = ("dynamic.aim_ahead", "dynamic.aim_inside", "dynamic.side_frequency", "standing.posture")
    tree = strict_yaml.read(find_share("config", "poppy_dynamic.yaml").read_text(), source="poppy_dynamic.yaml")
    sections = tree["/**"]["ros__parameters"]
    common = {
        f"{name}.{key}": value
        for name in ("task", "standing", "dynamic", "servo", "joints")
        for key, value in sections[name].items()
        if f"{name}.{key}" not in own
    }
    changes = {
        "gait.style": "dynamic", "gait.steps": 14, "gait.step_length": 0.5 * speed, "gait.most_length": 0.1,
        "servo.stiffness": 200.0, "servo.assumed_stiffness": 200.0, "dynamic.upright_weight": 1.0,
        "dynamic.catch_side": 0.05, "servo.latency": latency, "servo.assumed_latency": latency,
    }  # fmt: skip
    config = overlaid(biped, "physics").updated({**common, **changes})
    model = dq.load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant("physics", config, model))
    found = report(analyse(trace))
    print(f"\n{speed} m/s, {1e3 * latency:.0f} ms: tilt {math.degrees(found['physics']['tilt']['value']):.2f} degrees")
    assert trace.finished, trace.notes
    assert found["ok"]


def test_the_commanded_acceleration_is_that_of_the_commands_and_zero_after_a_gap() -> None:
    walk, q = prepared(CONFIG), MODEL.posture(CONFIG.standing.posture)
    a, dt = np.linspace(-3.0, 3.0, MODEL.n), CONFIG.dt
    phase, kin = walk.phase(PhaseKind.DOUBLE_SUPPORT, Foot.RIGHT, q), Kinematics(MODEL, q, Foot.LEFT, inclined(0.0))
    walk.observe(phase, kin, still(0.0, q, kin.up, 0.0))

    def accelerated(time: float, u: np.ndarray) -> np.ndarray:
        walk.effort(phase, kin, still(time, q, kin.up, time), u)
        return walk._acceleration.copy()

    found = [accelerated(k * dt, a * k * dt) for k in range(40)]
    assert np.abs(found[0]).max() == 0.0
    assert found[-1] == pytest.approx(a, abs=1e-3)
    assert np.abs(accelerated(40 * dt + 0.2, 2.0 * a)).max() == 0.0


def test_the_swing_foot_lands_gently() -> None:
    """And not early: then, or if the ground stops it, it unloads the supporting sole."""
    config = overlaid(CONFIG, "physics").updated({"gait.steps": 3, "qp.solver": "daqp"})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    assert trace.finished, trace.notes
    assert trace.physics is not None
    force, weight = {foot: trace.physics.wrenches[foot][:, 2] for foot in Foot}, 9.81 * MODEL.mass
    pairs = itertools.pairwise(trace.phases)
    landings = [(record, after.time) for record, after in pairs if record.kind is PhaseKind.SINGLE_SUPPORT]
    for record, end in landings:
        near = np.flatnonzero(np.abs(trace.time - end) < 0.05)
        touch = near[force[record.support.other][near] > 0.5][0]
        assert trace.time[touch] > end - 0.0125
        after = slice(touch, touch + round(0.05 / config.dt))
        assert force[record.support][after].min() > 0.25 * weight
        assert force[record.support.other][after].max() < 0.9 * weight
    assert len(landings) == 4


NOISY = overlaid(CONFIG, "physics").updated(
    {
        "servo.types": ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"], "qp.solver": "daqp",
        "sensors.attitude_noise": 0.004, "sensors.gyro_noise": 0.02, "sensors.encoder": 0.001534,
        "sensors.velocity_filter": 0.01,
    }
)  # fmt: skip
FAST = NOISY.updated(
    {"gait.step_length": 0.126, "gait.most_length": 0.126, "dynamic.quicken": 0.08, "dynamic.aim_inside": 0.0}
)


@pytest.mark.parametrize("gain", [127, pytest.param(254, marks=pytest.mark.long)])
def test_poppy_as_built_walks_dynamically(gain: int) -> None:
    changes = {"gait.steps": 10, "servo.p_gain": gain}
    config = overlaid(dq.load("poppy_dynamic_50hz"), "poppy_as_built").updated(changes)
    model = dq.load_model(config.robot)
    assert model.mass == pytest.approx(3.2)
    trace = simulate(make_controller(config, model), make_plant("poppy_as_built", config, model))
    assert trace.finished, trace.notes
    physics = report(analyse(trace))["physics"]
    assert not physics["fallen"]
    assert math.degrees(physics["tilt"]["value"]) < 1.0
    assert physics["cop_inside"] > 0.996  # a sole bears its weight only once it is down


ON_RUBBLE = CONFIG.updated(
    {
        "gait.steps": 14, "gait.step_length": 0.04, "servo.types": ["*=MX-28", "?_hip_y=MX-64", "abs_[xy]=MX-64"],
        "servo.p_gain": 254, "physics.rubble": 0.005, "sensors.attitude_noise": 0.004, "sensors.gyro_noise": 0.02,
        "sensors.encoder": 0.001534, "sensors.velocity_filter": 0.01,
    }
)  # fmt: skip


@pytest.mark.long
@pytest.mark.timeout(600)
def test_nearly_all_walks_on_rubble_stand() -> None:
    """With the same aim as on level ground five of these fall."""
    stood = sum(robustness.walk(ON_RUBBLE, 0, {"sensors.seed": seed}).stood for seed in range(1, 21))
    print(f"\nrubble of 5 mm: {stood} of 20 stood")
    assert stood >= 18
