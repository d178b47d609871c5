"""placo's walk pattern generator, played open loop.

placo plans the whole walk before it starts: its preview of the CoM, its swing feet, and one solution of its inverse
kinematics per control period. Its joint angles are commanded one after the other, together with the torques against
gravity that placo computes for the sole that stands, or for both soles in proportion to the planned ZMP. The servos
follow their goals, as a walk without feedback needs; with the compliant legs of our walk it falls in its first steps.
Of the durations in `TIMINGS` placo has those with which it arrives for the most seeds; the table has other seeds.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass

import numpy as np

from benchmark.scene import Array, Walker, arrives, changed
from dqwalk_ros.config import Config
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY, share
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.urdf import Urdf

TIMINGS = ((0.33, 0.2), (0.5, 0.08), (0.5, 0.2), (0.7, 0.2))  # single and double support [s]
WINDOW = 0.5  # from the joint to its goal [rad]
TUNING = range(100, 106)  # seeds for the choice of placo's durations


@dataclass(frozen=True)
class Pattern:
    """A walk of placo's: joint angles (N, n) [rad], torques (N, n) [N m], and CPU time for each state [s]."""

    q: Array
    effort: Array
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
        file.write(urdf.text())
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
    angles, efforts = [], []
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
    return Pattern(np.array(angles), np.array(efforts), spent / len(angles))


class Playback:
    """Commands the joint angles of a `Pattern`, one state after the other; stands on the last ones."""

    def __init__(self, config: Config, made: Pattern) -> None:
        self.config, self._made, self._k = config, made, 0

    @property
    def finished(self) -> bool:
        """Whether the last joint angles are commanded."""
        return self._k >= len(self._made.q) - 1

    def step(self, state: State, dt: float) -> Command:
        """Return the velocities to the next joint angles, and the torques."""
        q, k = self._made.q, self._k
        self._k = min(k + 1, len(q) - 1)
        return Command(state.time, (q[self._k] - q[k]) / dt, self._made.effort[self._k])


def placo_walk(config: Config, speed: float) -> Walker:
    """Return placo's walk at a speed [m/s], with the best of `TIMINGS`."""
    best, most = None, -1
    config = config.updated({"servo.window": WINDOW})
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
