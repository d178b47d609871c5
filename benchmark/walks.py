"""Walks of one small biped in MuJoCo: ours, and that of placo's walk pattern generator played open loop.

python -m benchmark.walks [--seeds 20] [--steps 20]

The robot is test/data/small_humanoid.urdf, of the size of a ROBOTIS OP3, as `dqwalk adopt` configures it. All walkers
command the same position servos on the same floor; placo and our dynamic walk are to walk at the same speed.

placo plans the whole walk before it starts: its preview of the CoM, its swing feet, and one solution of its inverse
kinematics per control period. Its joint angles are commanded one after the other, together with the torques against
gravity that placo computes for the sole that stands, or for both soles in proportion to the planned ZMP. Of
the durations in `TIMINGS` placo has those with which it arrives for the most seeds; these seeds are not in the table.

Each seed draws masses, friction, stiffness of the servos and slope of the floor, which no walker knows, and the noise
of the sensors, which placo does not read. A push is a constant force on the pelvis for 0.1 s in the middle of a single
support; the table gives the largest impulse in the worst of eight directions, on either foot, after which the robot
walks on for three seconds.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.timing import machine, table  # first: it sets the number of threads
from dqwalk_ros.adopt import adopt
from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY, share
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.urdf import Urdf
from dqwalk_ros.simulation import closed_loop
from dqwalk_ros.studies.bisection import largest
from dqwalk_ros.support.errors import DqwalkError
from dqwalk_ros.walks.table import make_controller, make_walk

ROBOT = Path("test/data/small_humanoid.urdf")
TIMINGS = ((0.33, 0.2), (0.5, 0.08), (0.5, 0.2), (0.7, 0.2))  # single and double support [s]
TUNING = range(100, 106)  # seeds for the choice of placo's durations
PUSH = 0.1  # [s]
MOST, TOLERANCE = 2.0, 0.03  # [N s]
AFTER = 3.0  # a pushed robot must walk on for this long [s]
UPRIGHT = 1.0  # a walk that ends must stand for this long [s]

Array = np.ndarray


@dataclass(frozen=True)
class Pattern:
    """A walk of placo's: joint angles (N, n) [rad], torques (N, n) [N m], and time for each state [s]."""

    q: Array
    effort: Array
    support: list[Foot | None]
    tick: float


def pattern(config: Config, model: RobotModel, speed: float, steps: int, single: float, double: float) -> Pattern:
    """Return placo's walk at a speed [m/s], with the durations of single and double support [s]."""
    import placo

    urdf = Urdf(model.urdf_without_shapes, model.name)
    for foot in Foot:
        sole = model.soles[foot]
        urdf.add_frame(f"{foot.value}_foot", sole.frame, DQ.from_pose(sole.center))
    if "trunk" not in urdf.links:
        urdf.add_frame("trunk", model.pelvis, DQ(1.0))
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(urdf.text(shapes=False))
        file.flush()
        robot = placo.HumanoidRobot(file.name)
    q = model.posture(config.standing.posture)
    kin, sole, gait = Kinematics(model, q, Foot.LEFT), model.soles[Foot.LEFT], config.gait
    p = placo.HumanoidParameters()
    p.single_support_duration, p.single_support_timesteps, p.double_support_ratio = single, 10, double / single
    p.startend_double_support_ratio = 2.0
    p.planned_timesteps = 64
    p.walk_foot_height, p.walk_foot_rise_ratio = gait.step_height, 0.2
    p.walk_com_height = float(kin.com[2])
    p.feet_spacing = abs(float(kin.point(kin.swing)[1]))
    p.foot_length, p.foot_width, p.zmp_margin = sole.length, sole.width, 0.02
    p.foot_zmp_target_y = -0.01  # inwards: outwards it falls, and with 0 it arrives less often
    length = speed * (single + double)
    p.walk_max_dx_forward = max(length, p.walk_max_dx_forward)
    solver = placo.KinematicsSolver(robot)
    solver.dt = config.dt
    solver.enable_velocity_limits(True)
    tasks = placo.WalkTasks()
    tasks.initialize_tasks(solver, robot)
    tasks.reach_initial_pose(np.eye(4), p.feet_spacing, p.walk_com_height, p.walk_trunk_pitch)
    planner = placo.FootstepsPlannerRepetitive(p)
    planner.configure(length, 0.0, 0.0, steps)
    soles = [placo.flatten_on_floor(T) for T in (robot.get_T_world_left(), robot.get_T_world_right())]
    prints = planner.plan(placo.HumanoidRobot_Side.left, *soles)
    supports = placo.FootstepsPlanner.make_supports(prints, 0.0, True, p.has_double_support(), True)
    omega = math.sqrt(GRAVITY / p.walk_com_height)
    began = time.process_time()
    plan = placo.WalkPatternGenerator(robot, p).plan(supports, robot.com_world(), 0.0)
    angles, efforts, on = [], [], []
    spent = time.process_time() - began
    for t in np.arange(0.0, plan.t_end, config.dt):
        began = time.process_time()
        tasks.update_tasks_from_trajectory(plan, t)
        robot.update_kinematics()
        solver.solve(True)
        against = {foot: robot.static_gravity_compensation_torques_dict(f"{foot.value}_foot") for foot in Foot}
        spent += time.process_time() - began
        both = plan.support_is_both(t)
        left = 1.0 if both or plan.support_side(t) == placo.HumanoidRobot_Side.left else 0.0
        if both:
            feet = [robot.get_T_world_left()[:3, 3], robot.get_T_world_right()[:3, 3]]
            left = 1.0 - share(plan.get_p_world_ZMP(t, omega)[:2], *feet)
        angles.append([robot.get_joint(name) for name in model.joint_names])
        efforts.append(
            [left * against[Foot.LEFT][j] + (1.0 - left) * against[Foot.RIGHT][j] for j in model.joint_names]
        )
        on.append(None if both else Foot.LEFT if left else Foot.RIGHT)
    return Pattern(np.array(angles), np.array(efforts), on, spent / len(angles))


class Playback:
    """Commands the joint angles of a `Pattern`, one state after the other; stands on the last ones."""

    def __init__(self, config: Config, made: Pattern) -> None:
        self.config, self._made, self._k = config, made, 0

    @property
    def finished(self) -> bool:
        """Whether the last joint angles are commanded."""
        return self._k >= len(self._made.q) - 1

    @property
    def support(self) -> Foot | None:
        """The foot of the present single support; None in double support."""
        return self._made.support[min(self._k, len(self._made.support) - 1)]

    def step(self, state: State, dt: float) -> Command:
        """Return the velocities to the next joint angles, and the torques."""
        q, k = self._made.q, self._k
        self._k = min(k + 1, len(q) - 1)
        return Command(state.time, (q[self._k] - q[k]) / dt, self._made.effort[self._k])


@dataclass(frozen=True)
class Walked:
    """A simulated walk: whether it ended upright, its length [m], time [s], power [W], work [J], CPU time a tick [s].

    `supports` are its single supports: foot, begin and end [s].
    """

    upright: bool
    way: float
    time: float
    power: float
    work: float
    tick: float
    supports: list[tuple[Foot, float, float]]


@dataclass(frozen=True)
class Walker:
    """What is compared: configuration, function that returns a controller, initial joint angles, planned length [m]."""

    name: str
    config: Config
    make: Callable[[Config], Any]
    q: Array
    length: float
    tick: float | None = None

    def walk(self, changes: dict[str, Any], push: tuple[float, Array] | None = None) -> Walked:
        """Simulate a walk in a changed world, with a push of (begin [s], force (3,) [N])."""
        config = self.config.updated(changes)
        model = load_model(config.robot)
        controller, plant = self.make(config), PhysicsPlant(config, model, self.q)
        start, q, began, ticks, energy, work = plant.truth.pelvis, plant.truth.q, 0.0, [], [], 0.0
        supports: list[tuple[Foot, float, float]] = []
        on: tuple[Foot, float] | None = None

        def before(t: float) -> None:
            nonlocal began
            if push is not None:
                plant.push(push[1] if push[0] <= t < push[0] + PUSH - 1e-9 else np.zeros(3))
            began = time.process_time()

        try:
            for state, _ in closed_loop(controller, plant, before):
                ticks.append(time.process_time() - began)
                if push is not None:
                    if state.time > push[0] + AFTER:
                        break
                    continue
                truth = plant.truth
                joints, q = truth.effort * (truth.q - q) / config.dt, truth.q
                energy.append(float(np.abs(joints).sum()))
                work += config.dt * float(np.maximum(joints, 0.0).sum())
                foot = _support(controller)
                if on is not None and foot is not on[0]:
                    supports.append((*on, state.time))
                    on = None
                if foot is not None and on is None:
                    on = foot, state.time
            rest = Command(0.0, np.zeros(model.n))
            for _ in range(0 if plant.fallen or push is not None else round(UPRIGHT / config.dt)):
                plant.step(rest, config.dt)
        except DqwalkError:
            return Walked(False, math.nan, math.nan, math.nan, math.nan, math.nan, supports)
        way = DQ(plant.truth.pelvis).translation() - DQ(start).translation()
        duration = len(ticks) * config.dt
        tick = float(np.median(ticks)) if self.tick is None else self.tick
        return Walked(
            not plant.fallen, float(way[0]), duration, float(np.mean(energy or [math.nan])), work, tick, supports
        )


def _support(controller: Any) -> Foot | None:
    if isinstance(controller, Playback):
        return controller.support
    return controller.phase.support if controller.phase.kind is PhaseKind.SINGLE_SUPPORT else None


def world(seed: int) -> dict[str, Any]:
    """Return the changes of the world that a seed draws."""
    random = np.random.default_rng(seed)
    stiffness = random.uniform(0.85, 1.15)
    return {
        "physics.mass_scale": random.uniform(0.9, 1.1),
        "physics.friction": random.uniform(0.4, 1.0),
        "physics.slope": math.radians(random.uniform(-1.0, 1.0)),
        "physics.slope_side": math.radians(random.uniform(-1.0, 1.0)),
        "servo.stiffness": stiffness,  # a factor of the nominal one
        "sensors.seed": seed,
        "sensors.attitude_noise": 0.004,
        "sensors.gyro_noise": 0.02,
        "sensors.encoder": 0.001534,
        "sensors.velocity_filter": 0.01,
    }


def changed(walker: Walker, seed: int) -> dict[str, Any]:
    """Return the changes of the world of a walker."""
    drawn = world(seed)
    return {**drawn, "servo.stiffness": drawn["servo.stiffness"] * walker.config.servo.stiffness}


def worst_push(walker: Walker, calm: Walked) -> tuple[float, str]:
    """Return the largest impulse survived in the worst of eight directions, in mid-step on either foot [N s]."""
    worst = math.inf, ""
    for foot in Foot:
        _, begin, end = [support for support in calm.supports if support[0] is foot][2]  # at full length
        for k in range(8):
            angle = 0.25 * math.pi * k
            ahead = np.array([math.cos(angle), math.sin(angle), 0.0]) / PUSH
            at = 0.5 * (begin + end)

            def fails(impulse: float, at: float = at, ahead: Array = ahead) -> str:
                return "" if walker.walk({}, (at, impulse * ahead)).upright else "fell"

            found = largest(fails, 0.12, MOST, TOLERANCE).survived
            if found < worst[0]:
                worst = found, f"on the {foot.value} foot, {45 * k} degrees"
    return worst


def arrives(walker: Walker, changes: dict[str, Any]) -> bool:
    """Return whether a walk ends upright after at least 70 % of its length."""
    walked = walker.walk(changes)
    return walked.upright and walked.way > 0.7 * walker.length


def dynamic_config(folder: Path, steps: int, longer: float = 1.0) -> Config:
    """Return the configuration of our dynamic walk, with steps longer by a factor."""
    config = on_physics(folder / "dynamic.yaml", steps)
    length = longer * config.gait.step_length
    return config.updated({"gait.step_length": length, "gait.most_length": max(length, config.gait.most_length)})


def on_physics(path: Path, steps: int) -> Config:
    """Return a configuration for the physics plant."""
    return overlaid(load(path), "physics").updated({"gait.steps": steps, "qp.solver": "daqp"})


def ours(name: str, config: Config) -> Walker:
    """Return one of our walks."""
    posture = make_walk(config, load_model(config.robot)).posture
    make = lambda c: make_controller(c, load_model(c.robot))  # noqa: E731
    return Walker(name, config, make, posture, config.gait.steps * config.gait.step_length)


def placo_walk(config: Config, speed: float) -> Walker:
    """Return placo's walk at a speed [m/s], with the best of `TIMINGS`."""
    best, most = None, -1
    for single, double in TIMINGS:
        made = pattern(config, load_model(config.robot), speed, config.gait.steps, single, double)
        name = f"placo, open loop, {single:g} s + {double:g} s"
        length = speed * (single + double) * config.gait.steps
        walker = Walker(name, config, lambda c, made=made: Playback(c, made), made.q[0], length, made.tick)
        arrived = sum(arrives(walker, changed(walker, seed)) for seed in TUNING)
        if arrived > most:
            best, most = walker, arrived
    assert best is not None
    return best


def fastest(make: Callable[[float], Walker], speed: float, seeds: int) -> float:
    """Return the highest of the speeds 1, 1.25, 1.5, ... times `speed` at which a walk arrives for all seeds [m/s]."""
    best, factor = 0.0, 1.0
    while True:
        walker = make(factor)
        if not all(arrives(walker, changed(walker, seed)) for seed in range(seeds)):
            return best
        best, factor = factor * speed, factor + 0.25


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--steps", type=int, default=20)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        adopt(ROBOT, folder)
        dynamic = dynamic_config(folder, args.steps)
        period = dynamic.standing.transfer_duration + dynamic.standing.swing_duration
        speed = dynamic.gait.step_length / period
        at: list[Callable[[float], Walker]] = [
            lambda factor: placo_walk(dynamic, factor * speed),
            lambda factor: ours("our dynamic walk", dynamic_config(folder, args.steps, factor)),
            lambda _: ours("our standing walk", on_physics(folder / "robot.yaml", args.steps)),
        ]
        rows = []
        for make in at:
            walker = make(1.0)
            print(f"{walker.name} ...", flush=True)
            calm = walker.walk({})
            arrived = sum(arrives(walker, changed(walker, seed)) for seed in range(args.seeds))
            impulse, where = worst_push(walker, calm)
            weight = GRAVITY * load_model(walker.config.robot).mass
            quick = walker.config is dynamic or "dynamic" in walker.name
            rows.append(
                [
                    walker.name,
                    f"{calm.way / calm.time:.3f}",
                    f"{arrived} of {args.seeds}",
                    f"{impulse:.2f}",
                    where,
                    f"{1e3 * calm.tick:.2f}",
                    f"{calm.power:.2f}",
                    f"{calm.work / (weight * calm.way):.2f}",
                    f"{fastest(make, speed, args.seeds):.3f}" if quick else "-",
                ]
            )
            print("  ".join(rows[-1]), flush=True)
    head = ["walk", "mean speed [m/s]", "arrived", "worst push [N s]", "where", "tick [ms]", "power [W]",
            "cost of transport", "fastest [m/s]"]  # fmt: skip
    print(f"\n{machine(('numpy', 'mujoco', 'placo', 'daqp'))}\n\n{table(head, rows)}")


if __name__ == "__main__":
    main()
