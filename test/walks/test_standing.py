"""The standing walk: its rows, tasks and footsteps, and short walks with and without physics."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import scipy.optimize
from robots import DATA, central_difference
from rosbags.highlevel import AnyReader
from walks import problem_at, segments, values

import dqwalk_ros as dq
from dqwalk_ros import report as reporting
from dqwalk_ros.cli.footsteps import reached
from dqwalk_ros.config import overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.features import CenterOfMassOnGround, Point
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import moved_inside
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Command, Estimate, State
from dqwalk_ros.paper.statics import Soles, gravity_torques, ground_torques
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.report import bag
from dqwalk_ros.report.scene import Moments, Scene
from dqwalk_ros.simulation import simulate
from dqwalk_ros.support.errors import ConfigError, PhaseError, PlantError
from dqwalk_ros.walks.com import measured, velocity
from dqwalk_ros.walks.following import ComPath, SwingPath, com_path
from dqwalk_ros.walks.standing.balance import Balance
from dqwalk_ros.walks.standing.walk import PathEnd, StandingWalk
from dqwalk_ros.walks.table import make_controller, make_walk

CONFIG = dq.load("poppy")
MODEL = dq.load_model(CONFIG.robot)
BIPED12 = dq.load(DATA / "biped12.yaml").updated({"robot.urdf": str(DATA / "biped12.urdf")})
TILTED = np.array([0.05, -0.08, np.sqrt(1.0 - 0.05**2 - 0.08**2)])


def somewhere(seed: int, scale: float = 0.2) -> np.ndarray:
    q = MODEL.posture(CONFIG.standing.posture) + scale * np.random.default_rng(seed).normal(size=MODEL.n)
    return np.clip(q, MODEL.q_min, MODEL.q_max)


def test_the_path_begins_at_the_center_of_mass_on_a_slope() -> None:
    """The projection is along gravity, as in the error; that along the normal of the soles is 23 mm away."""
    controller = make_controller(CONFIG, MODEL)
    q = MODEL.posture(CONFIG.standing.posture)
    controller.step(State(0.0, q, np.zeros(MODEL.n), up=np.array([0.0, np.sin(0.05), np.cos(0.05)])), CONFIG.dt)
    level = Kinematics(MODEL, q, controller.phase.base).com_on_ground
    (task,) = (task for task in controller.phase.tasks if isinstance(task, ComPath))
    assert controller.error < 1e-9
    assert np.linalg.norm(task.start - level) == pytest.approx(0.023, abs=0.001)


def test_swing_paths_connect_start_and_goal_and_their_velocity_is_the_derivative() -> None:
    start = DQ.from_pose([0.0, 0.1, 0.0]).vec8()
    goal = DQ.from_pose([0.1, 0.12, 0.0], [np.cos(0.1), 0.0, 0.0, np.sin(0.1)]).vec8()
    path = SwingPath(name="s", frame="r_sole", start=start, goal=goal, height=0.03, duration=2.0, eta=5.0, lever=0.2)

    def at(x: DQ) -> np.ndarray:
        return np.concatenate([x.translation(), x.vec8()[:4]])  # coordinates of the point and the rotation

    for t, pose in ((0.0, start), (2.0, goal)):
        assert path.evaluate(at(DQ(pose)), t)[0] == pytest.approx(np.zeros(6), abs=1e-12)
    middle = at(DQ(start)), at(DQ(goal))
    assert 0.5 * sum(path.evaluate(s, 1.0)[0][2] for s in middle) == pytest.approx(-0.03)
    h = 1e-6
    for t in (0.1, 0.5, 1.0, 1.7):
        e, gradient, _ = path.evaluate(at(DQ(start)), t)
        s = at(DQ(start)) - np.linalg.lstsq(gradient, e)[0]  # on the path: the error is affine in s
        s[3:] /= np.linalg.norm(s[3:])
        numeric = (path.evaluate(s, t + h)[0] - path.evaluate(s, t - h)[0]) / (2.0 * h)
        assert path.evaluate(s, t)[2] == pytest.approx(numeric, abs=1e-6)


def test_a_held_sole_without_ankle_roll_has_independent_rows() -> None:
    """The six rows have rank five; five rows are kept, and their null space is that of all six."""
    phase = make_walk(CONFIG, MODEL).phase(PhaseKind.DOUBLE_SUPPORT, Foot.LEFT, MODEL.posture(CONFIG.standing.posture))
    kin = Kinematics(MODEL, MODEL.posture(CONFIG.standing.posture), phase.base)
    E = problem_at(phase, kin, CONFIG.dt).E
    _, full = values(phase.equalities[0], kin)
    kept = np.abs(E).max(axis=1) > 0.0
    assert kept.sum() == 5
    assert np.linalg.matrix_rank(full, tol=5e-3) == 5
    u = np.linalg.svd(E[kept])[2][5:].T @ np.random.default_rng(0).normal(size=MODEL.n - 5)
    assert np.abs(full @ u).max() < 5e-3 * np.abs(u).max() * np.linalg.norm(full, 2)


def test_footsteps_are_flat_within_reach_and_mirrored() -> None:
    steps = StandingWalk(CONFIG, MODEL).footsteps
    left, right = (DQ(steps.step(foot, 0.05, 0.0, 0.0)).translation() for foot in (Foot.RIGHT, Foot.LEFT))
    assert left == pytest.approx([0.05, 0.0949, 0.0], abs=2e-4)
    assert right == pytest.approx(left * [1.0, -1.0, 1.0], abs=2e-4)
    # without ankle roll two flat parallel feet keep their lateral distance, or turn
    aside, turn = reached(steps, Foot.LEFT, 0.0, -0.02, 0.0)[1:3]
    assert -0.01 < aside < -0.005
    assert np.degrees(turn) < -4.0
    for angle in (0.1, -0.5):
        assert reached(steps, Foot.LEFT, 0.0, 0.0, angle)[2:] == pytest.approx([angle, 0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("turn", [0.0, 0.2])
def test_footprints_are_reachable_with_the_com_over_either_foot(turn: float) -> None:
    """An independent check: a general least-squares solver finds joint angles that satisfy both."""
    x = StandingWalk(CONFIG, MODEL).footsteps.step(Foot.LEFT, 0.03, 0.0, turn)
    frame = MODEL.soles[Foot.RIGHT].frame
    for over in (Point(MODEL.soles[Foot.LEFT].frame, MODEL.soles[Foot.LEFT].center),
                 Point(frame, MODEL.soles[Foot.RIGHT].center)):  # fmt: skip

        def off(q: np.ndarray, over: Point = over) -> np.ndarray:
            kin = Kinematics(MODEL, q, Foot.LEFT)
            return np.concatenate([kin.pose(frame) - x, kin.com[:2] - over.value(kin)[:2]])

        start = np.clip(MODEL.posture(CONFIG.standing.posture), MODEL.q_min + 1e-6, MODEL.q_max - 1e-6)
        found = scipy.optimize.least_squares(off, start, bounds=(MODEL.q_min, MODEL.q_max), xtol=1e-12, ftol=1e-12)
        assert np.abs(found.fun).max() < 1e-3


def test_an_invalid_posture_entry_is_an_error() -> None:
    for entry in ("knee=0.3", "?_knee_y=bent"):
        with pytest.raises(ConfigError, match=r"standing\.posture"):
            MODEL.posture([entry])


def test_gravity_torques_are_the_derivative_of_the_potential() -> None:
    q = somewhere(4)
    kin = Kinematics(MODEL, q, Foot.LEFT)
    height = central_difference(lambda q: Kinematics(MODEL, q, Foot.LEFT).com[2], q)
    tau = gravity_torques(kin, both=False)
    assert tau == pytest.approx(MODEL.mass * 9.80665 * height, abs=1e-5)


def borne(kin: Kinematics, force: np.ndarray, p: np.ndarray, at: dict[Foot, np.ndarray] | None = None) -> np.ndarray:
    """Return the torques of a force of the ground on both soles."""
    soles = Soles.of(MODEL, kin.base, both=True, at=at)
    return ground_torques(force, p, kin.com, kin.com_jacobian, kin.lines, kin.poses, soles)


@pytest.mark.parametrize("inside", [0.0, 0.01])
def test_ground_torques_are_weighted_by_the_load_of_each_sole(inside: float) -> None:
    """Mean of two models, one per base sole, weighted by load; the other sole is a point with its part of the force.

    The points on which the soles carry all of it may be inside their centres.
    """
    X = np.array([1.0, 0.0, 0.0])
    aside = {foot: np.array([0.0, inside * (1.0 if foot is Foot.RIGHT else -1.0), 0.0]) for foot in Foot}
    at = {foot: MODEL.soles[foot].center + aside[foot] for foot in Foot}

    def seen_from(base: Foot, q: np.ndarray, force: np.ndarray, share: float, ahead: float) -> np.ndarray:
        kin, sole = Kinematics(MODEL, q, base), MODEL.soles[base.other]
        point = at[base.other] + np.clip(ahead, -0.5 * sole.length, 0.5 * sole.length) * X
        return force @ (kin.com_jacobian - share * kin.point_jacobian(sole.frame, point))

    rng, shares = np.random.default_rng(0), []
    for _ in range(20):
        q, force, p = somewhere(7), rng.normal(size=3) * [2.0, 3.0, 26.0], rng.normal(size=2) * [0.08, 0.06] - [0, 0.05]
        kin, other = Kinematics(MODEL, q, Foot.LEFT), MODEL.soles[Foot.RIGHT]
        a, b = at[Foot.LEFT][:2], kin.point(other.frame, at[Foot.RIGHT])[:2]
        share = float(np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
        beside = p - a - share * (b - a)
        turned = np.array([force @ kin.direction(other.frame, e) for e in np.eye(3)])
        from_left = seen_from(Foot.LEFT, q, force, share, beside @ kin.direction(other.frame, X)[:2])
        from_right = seen_from(Foot.RIGHT, q, turned, 1.0 - share, beside[0])
        tau = borne(kin, force, p, at if inside else None)
        assert tau == pytest.approx((1.0 - share) * from_left + share * from_right, abs=1e-12)
        shares.append(share)
    assert 0.0 < np.median(shares) < 1.0


def reference(path: ComPath, kin: Kinematics, elapsed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of the path at one configuration."""
    goals = [kin.point(point.frame, point.offset) for point in path.over]
    return com_path(np.concatenate([np.zeros(2), *goals]), path.start, elapsed, path.duration)


@pytest.mark.parametrize("kind", [PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT])
def test_balance_torques_follow_the_com_path_with_the_cop_inside_the_soles(kind: PhaseKind) -> None:
    """The formula of the docstring, in numpy, on a tilted sole; a centre of pressure outside the soles is clamped."""
    goal = StandingWalk(CONFIG, MODEL).footsteps.step(Foot.LEFT, 0.05, 0.0, 0.0)
    phase = make_walk(CONFIG, MODEL).phase(kind, Foot.LEFT, MODEL.posture(CONFIG.standing.posture), goal)
    path = next(task for task in phase.tasks if isinstance(task, ComPath))
    polygon = phase.inequalities[0].polygon
    n, d = polygon.edges()
    s, cut = CONFIG.standing, 0
    for seed in range(8):
        kin = Kinematics(MODEL, somewhere(seed, 0.1), phase.base, TILTED)
        state = Estimate(0.6, kin.q, 0.2 * np.random.default_rng(seed).normal(size=MODEL.n), up=TILTED, elapsed=0.6)
        h, c, v = float(TILTED @ kin.com), kin.com_on_ground, (kin.com_jacobian @ state.dq)[:2]
        w, k = np.sqrt(9.80665 / h), s.balance
        _, v_d, a_d = reference(path, kin, 0.6)
        a = a_d - w**2 * k * values(path, kin, 0.6)[0] - w * (1.0 + k) * (v - v_d)
        p = c - a / w**2
        cut += polygon.distance(p) < s.pressure_margin
        p = moved_inside(p, n, d, s.pressure_margin)
        tau = Balance(phase, CONFIG)(kin, state)
        if kind is PhaseKind.SINGLE_SUPPORT:
            wanted = MODEL.mass * w**2 * (c - p) @ CenterOfMassOnGround().jacobian(kin)
            assert tau - gravity_torques(kin, both=False) == pytest.approx(wanted, rel=1e-9, abs=1e-10)
        else:
            a = w**2 * (c - p)
            force = MODEL.mass * (9.80665 * TILTED + [*a, -(a @ TILTED[:2]) / TILTED[2]])
            assert tau == pytest.approx(borne(kin, force, p), rel=1e-9, abs=1e-10)
    assert cut > 0


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (0.25, r"is not over after 8 s at an error of 0\.0\d+ m .*; gait\.phase_timeout may be too short$"),
        (0.02, r"has stalled at an error of 0\.0\d+ m \(it ends below 0\.\d+ m\)$"),
        (0.0, r"has stalled at an error of 0\.1 m \(it ends below 0\.\d+ m\)$"),
    ],
)
def test_a_phase_that_takes_too_long_says_whether_its_error_still_falls(rate: float, message: str) -> None:
    rule = PathEnd(CONFIG.updated({"gait.phase_timeout": 8.0}), PhaseKind.SINGLE_SUPPORT, "single_support/left")

    def over_at(t: float) -> bool:
        return rule.is_over(lambda: 0.1 * math.exp(-rate * t), t)

    assert not any(map(over_at, np.arange(0.0, 8.0, 0.01).tolist()))
    with pytest.raises(PhaseError, match=message) as failed:
        over_at(8.01)
    assert failed.value.stalled == ("stalled" in message)


def test_a_phase_runs_out_of_time_also_within_its_path() -> None:
    rule = PathEnd(CONFIG.updated({"gait.phase_timeout": 0.5}), PhaseKind.SINGLE_SUPPORT, "single_support/left")
    with pytest.raises(PhaseError, match=r"gait\.phase_timeout may be too short$"):
        rule.is_over(lambda: 0.1, 0.6)


@pytest.mark.parametrize("over", [(Point("l_sole"),), (Point("l_sole"), Point("r_sole"))])
def test_the_com_path_is_smooth(over: tuple[Point, ...]) -> None:
    path = ComPath(name="com", start=np.array([0.02, -0.1]), over=over, duration=1.2, saturation=1.0)
    q, h = somewhere(6), 1e-4
    for t in (0.2, 0.6, 1.1):
        before, now, after = (reference(path, Kinematics(MODEL, q, Foot.RIGHT), t + k * h) for k in (-1, 0, 1))
        assert now[1] == pytest.approx((after[0] - before[0]) / (2 * h), abs=1e-6)
        assert now[2] == pytest.approx((after[1] - before[1]) / (2 * h), abs=1e-6)


def com_velocity(kin: Kinematics, state: State, share: float = 0.0) -> np.ndarray:
    return velocity(share, *measured(kin, state))


def test_com_velocity_includes_the_rotation_of_a_tipping_sole() -> None:
    q, turning = somewhere(5), np.array([0.1, 0.2, 0.0])
    kin = Kinematics(MODEL, q, Foot.LEFT)
    in_imu = DQ(kin.pose("imu")).rotation_matrix().T @ turning
    v = com_velocity(kin, State(0.0, q, dq=np.zeros(MODEL.n), gyro=in_imu))
    assert v == pytest.approx(np.cross(turning, kin.com))


def test_com_velocity_from_the_other_sole_is_that_of_a_robot_which_stands_on_it() -> None:
    """Each sole is at rest as far as it bears the weight; with all of the weight on one sole only that one counts."""
    random = np.random.default_rng(5)
    q = MODEL.posture(CONFIG.standing.posture) + 0.1 * random.normal(size=MODEL.n)
    state = State(0.0, q, dq=random.normal(size=MODEL.n), gyro=random.normal(size=3))
    left, right = (Kinematics(MODEL, q, foot) for foot in Foot)
    to_left = DQ(left.pose(left.swing)).rotation_matrix()
    np.testing.assert_allclose(com_velocity(left, state, 1.0), to_left @ com_velocity(right, state), atol=1e-12)
    half = 0.5 * (com_velocity(left, state) + to_left @ com_velocity(right, state))
    np.testing.assert_allclose(com_velocity(left, state, 0.5), half, atol=1e-12)
    assert np.linalg.norm(half - com_velocity(left, state)) > 0.01


def walked(plant: str, **values: object):
    config = CONFIG.updated({key.replace("__", "."): value for key, value in values.items()})
    model = dq.load_model(config.robot)
    body = make_plant(plant, config, model)
    return simulate(make_controller(config, model), body), body


def assert_balanced(trace) -> None:
    assert trace.finished, trace.notes
    for part in segments(trace):
        assert part.distances["edges"].min() >= -1e-4
        if part.phase.swing_target is not None:
            assert part.distances["clearance"].min() >= -5e-4
            landed = part.last.point(part.last.swing)
            assert np.linalg.norm(landed - DQ(part.phase.swing_target).translation()) <= 3e-3


@pytest.mark.parametrize("first", ["left", "right"])
def test_one_step_stays_balanced_over_its_true_soles(first: str) -> None:
    trace, _ = walked("integrator", gait__steps=1, gait__first_support=first)
    assert_balanced(trace)
    assert [record.name.split("/")[0] for record in trace.phases] == [
        "double_support", "single_support", "double_support", "single_support", "stance",
    ]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(
    ("values", "ahead", "turned"),
    [
        ({"gait__steps": 20}, 1.0, 0.0),
        ({"gait__steps": 10, "gait__step_length": -0.05}, -0.5, 0.0),
        ({"gait__steps": 45, "gait__step_length": 0.0, "gait__step_turn": np.radians(8.0)}, 0.0, 2.0 * np.pi),
    ],
    ids=["20 ahead", "10 back", "a full turn"],
)
def test_long_walks_stay_balanced(values: dict[str, object], ahead: float, turned: float) -> None:
    trace, _ = walked("integrator", **values)
    assert_balanced(trace)
    walk = reporting.report(reporting.analyse(trace))["walk"]
    assert walk["forward"] == pytest.approx(ahead, abs=5e-3)
    assert walk["turned"] == pytest.approx(turned, abs=np.radians(1.0))


@pytest.mark.long
@pytest.mark.parametrize("plant", ["integrator", "physics"])
def test_a_robot_with_ankle_roll_steps_sideways(plant: str) -> None:
    config = BIPED12.updated({"gait.steps": 10, "gait.step_length": 0.0, "gait.step_side": 0.03})
    model = dq.load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant(plant, config, model))
    if plant == "integrator":
        assert_balanced(trace)
    report = reporting.report(reporting.analyse(trace))
    assert trace.finished, trace.notes
    assert report["walk"]["lateral"] == pytest.approx(0.3, abs=5e-3)
    assert report["physics"] is None or report["physics"]["displacement"][1] == pytest.approx(0.3, abs=5e-3)


@pytest.mark.long
def test_in_physics_the_papers_walk_loads_its_swing_foot() -> None:
    """The CoM leaves the true support polygon, and the robot tips onto its other foot in single support."""
    config = dq.load("paper")
    model = dq.load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant("physics", config, model), max_time=30.0)
    series = reporting.analyse(trace)
    report = reporting.report(series)
    single = series.spans[1]
    assert report["walk"]["margin"]["true"]["outside_from"] == pytest.approx(series.time[single.start], abs=0.1)
    assert report["physics"]["swing_load"] > 0.25
    assert report["physics"]["cop_inside"] < 0.9


def test_a_foot_that_an_obstacle_stops_is_put_down() -> None:
    """Pushed on, it lets the supporting sole slip, and the robot falls in the third step."""
    ahead = {"gait.steps": 4, "physics.rise": 0.05, "physics.stairs_at": 0.15}
    config = overlaid(CONFIG, "physics").updated({**ahead, "qp.solver": "daqp"})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    assert trace.finished, trace.notes
    stopped = [k for k, phase in enumerate(trace.phases) if "obstacle" in phase.decision]
    assert stopped
    for k in stopped:
        now, after = trace.phases[k], trace.phases[k + 1]
        assert now.name == after.name
        landed = DQ(after.swing_target).translation() - DQ(now.swing_target).translation()
        assert landed[0] < -0.005


@pytest.mark.parametrize("dead", [True, False], ids=["of a dead plant", "before an obstacle"])
def test_a_foot_that_rests_drops_the_footsteps_only_before_an_obstacle(dead: bool) -> None:
    """A plant killed in mid-swing looks like an obstacle until its death is known, half a second later."""
    config = CONFIG.updated({"gait.steps": 0, "qp.solver": "daqp"})
    controller, dt = make_controller(config, MODEL), config.dt
    walk, q, t = controller.walk, MODEL.posture(config.standing.posture), 0.0
    assert isinstance(walk, StandingWalk)
    command = controller.step(State(t, q, np.zeros(MODEL.n)), dt)
    support = Foot(config.gait.first_support)
    ahead = [walk.footsteps.step(foot, 0.03, 0.0, 0.0) for foot in (support, support.other, support)]
    walk.place(support, ahead)
    begun, rests, lives_at = [], False, math.inf
    while len(begun) < 6 and t < 40.0:
        t += dt
        swings, met = controller.phase.swing_target is not None, "obstacle" in controller.phase.decision
        rests = rests or (swings and t > controller.phase_began + 0.4 * config.standing.swing_duration)
        if met and lives_at == math.inf:
            lives_at = t + (0.5 if dead else 0.0)
        if dead and 0.0 <= t - lives_at < dt:
            t += 2.0  # its death is known, and the walk stands still
        moves = np.zeros(MODEL.n) if rests and t < lives_at else command.velocity
        q, index = q + dt * moves, controller.phase_index
        command = controller.step(State(t, q, moves), dt)
        if controller.phase_index > index:
            begun.append((controller.phase.kind, walk.placed))
    double, single = PhaseKind.DOUBLE_SUPPORT, PhaseKind.SINGLE_SUPPORT
    put_down = [(single, 2), (single, 2)] if dead else [(single, 2)]  # again after the interruption
    after = [(double, 2), (single, 1)] if dead else [(double, 0), (single, 0)]
    assert begun[2 : 2 + len(put_down) + 2] == put_down + after


def test_one_step_in_physics_stays_balanced() -> None:
    trace, plant = walked("physics", gait__steps=1)
    assert trace.finished, trace.notes
    assert not plant.fallen
    truth = plant.truth
    assert sum(w[2] for w in truth.wrenches.values()) == pytest.approx(MODEL.mass * 9.81, rel=0.05)
    soles = [DQ(x).translation() for x in truth.soles.values()]
    assert soles[0][0] == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("first", ["left", pytest.param("right", marks=pytest.mark.long)])
def test_on_one_foot_the_com_is_moved_towards_the_other_foot(first: str) -> None:
    places = []
    for aim in (0.0, CONFIG.standing.aim_inside):
        trace, _ = walked("integrator", gait__steps=1, gait__first_support=first, standing__aim_inside=aim)
        part = next(part for part in segments(trace) if part.phase.swing_target is not None)
        places.append(part.last.com_on_ground[1])
    inside = -0.005 if first == "left" else 0.005
    assert CONFIG.standing.aim_inside == abs(inside)
    assert places[1] - places[0] == pytest.approx(inside, abs=1e-3)


def test_on_a_slope_distances_are_along_the_measured_vertical(tmp_path) -> None:
    """Without it the CoM seemed 25 mm beside its place, beyond an edge of the support sole."""
    config = overlaid(CONFIG, "physics").updated({"gait.steps": 1, "physics.slope_side": 0.0524})
    trace = simulate(make_controller(config, MODEL), make_plant("physics", config, MODEL))
    scene, moments = Scene(trace.config, MODEL), Moments(trace)
    found = [scene.assess(moments.at(tick))[1] for tick in range(0, len(trace), 20)]
    assert not [one.message for one in found if one.level == "ERROR"]
    assert min(one.values["margin/polygon"] for one in found) > 0.01
    bag.write(trace, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        told = [c for c in reader.connections if c.topic == "/diagnostics"]
        levels = [reader.deserialize(raw, c.msgtype).status[0].level for c, _, raw in reader.messages(told)]
    assert len(levels) > 20
    assert max(levels) < 2  # no ERROR


def test_what_is_a_violation_is_an_error_of_its_state_and_nothing_else() -> None:
    """Report and monitor have one law; a held sole, whose rows depend on each other, has no bound of its own."""
    trace, _ = walked("integrator", gait__steps=1)
    spoilt, tick, joint = trace.q.copy(), 100, MODEL.joint_names.index("bust_x")
    spoilt[tick, joint] = MODEL.q_max[joint] + 3.0 * CONFIG.monitor.tolerance
    for q, wrong in ((trace.q, []), (spoilt, [tick])):
        given = dataclasses.replace(trace, q=q)
        scene, moments = Scene(trace.config, MODEL), Moments(given)
        found = [scene.assess(moments.at(k))[1] for k in range(0, len(trace), 10)]
        assert [10 * k for k, one in enumerate(found) if one.level == "ERROR"] == wrong, found[tick // 10].message
        told = {one["what"] for one in reporting.report(reporting.analyse(given))["violations"]}
        assert ("joint_max" in told) is bool(wrong)


def test_the_physics_model_has_the_mass_of_the_robot() -> None:
    plant = make_plant("physics", CONFIG.updated({"physics.settle": 0.0}), MODEL)
    assert plant.mj.body_mass.sum() == pytest.approx(MODEL.mass, rel=1e-12)
    assert plant.state.up == pytest.approx([0.0, 0.0, 1.0], abs=0.2)


def test_an_interrupted_transfer_starts_again_from_rest() -> None:
    """Continued in the middle at its previous velocity, the path would tip the robot, so it stands first."""
    config = CONFIG.updated({"gait.steps": 1})
    model = dq.load_model(config.robot)
    controller, plant = make_controller(config, model), make_plant("physics", config, model)
    state, dt, stands = plant.state, config.dt, config.standing.transfer_duration
    command, still = Command(0.0, np.zeros(model.n)), Command(0.0, np.zeros(model.n))
    for tick in range(700 + round(stands / dt)):
        if not 150 <= tick < 210:
            command = controller.step(state, dt)
        elif tick >= 150 + round(config.plant.command_timeout / dt):
            command = still  # every plant holds after its command timeout
        state = plant.step(command, dt)
        assert not plant.fallen
        if tick == 210:
            assert controller.phase_index == 1
            assert controller.phase.kind is PhaseKind.DOUBLE_SUPPORT
            assert controller.phase_began == pytest.approx(210 * dt + stands)
    assert controller.phase.kind is PhaseKind.SINGLE_SUPPORT


def test_an_unknown_plant_is_an_error() -> None:
    with pytest.raises(PlantError, match="no plant is called 'fysics': integrator, physics"):
        make_plant("fysics", CONFIG, MODEL)


def test_an_interrupted_swing_begins_again_where_the_foot_is() -> None:
    """Continued, its path would be ahead of a foot whose plant was dead for a while, as before an obstacle."""
    config = CONFIG.updated({"gait.steps": 1})
    model = dq.load_model(config.robot)
    controller, plant = make_controller(config, model), make_plant("physics", config, model)
    state = plant.state
    while controller.phase_index < 1 or state.time < controller.phase_began + 0.5:
        command = controller.step(state, config.dt)
        state = plant.step(command, config.dt)
    target, speed = controller.phase.swing_target, np.abs(state.dq).max()
    for _ in range(round(config.plant.command_timeout / config.dt) - 1):
        state = plant.step(command, config.dt)
    command = controller.step(State(state.time + 60.0, state.q), config.dt)
    assert controller.phase_began == pytest.approx(state.time + 60.0)
    assert controller.phase.swing_target == pytest.approx(target)
    kin = Kinematics.measured(model, state.q, controller.phase.base, None)
    swing = controller.phase.tasks[0]
    assert isinstance(swing, SwingPath)
    assert swing.start == pytest.approx(kin.pose(kin.swing), abs=1e-9)
    assert np.abs(command.velocity).max() < 1.2 * speed  # it does not catch up


def test_another_biped_walks_in_physics_with_its_own_configuration() -> None:
    config = BIPED12.updated({"gait.steps": 1})
    model = dq.load_model(config.robot)
    plant = make_plant("physics", config, model)
    trace = simulate(make_controller(config, model), plant)
    assert trace.finished, trace.notes
    assert not plant.fallen


@pytest.mark.long
def test_a_walk_of_one_metre_in_physics_stays_balanced() -> None:
    config = CONFIG.updated({"gait.steps": 20})
    model = dq.load_model(config.robot)
    trace = simulate(make_controller(config, model), make_plant("physics", config, model))
    assert trace.finished, trace.notes
    physics = reporting.report(reporting.analyse(trace))["physics"]
    assert not physics["fallen"]
    assert physics["way"] > 0.95
    assert physics["tilt"]["value"] < np.radians(2.0)
    assert physics["cop_inside"] > 0.99
