"""Learned walks of Booster's T1: the two policies in the package holosoma-inference, with the robot of holosoma.

A policy answers at its own rate the imu, the joints, the commanded velocity, its last answer and the phase of its gait
with the goals of the 29 joints, whose motors have the gains that come with it. Scales, posture and order of the joints
are read from the package. The walk ends with a second at zero velocity. A policy
walks at two thirds of a low velocity; it is commanded the one with which it walks as far as it should.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmark.scene import Array, Walker
from dqwalk_ros.config import Config
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.mujoco import PhysicsPlant
from dqwalk_ros.plants.servo_goals import AngleGate
from dqwalk_ros.robot.model import RobotModel, load_model
from dqwalk_ros.robot.servos import Servos

STOP = 1.0  # [s]
FARTHEST = 0.02  # error of the length of the walk, relative


def package(name: str) -> Path:
    """Return the folder of an installed package, which need not be importable."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        raise SystemExit(f"the package {name} is missing; see benchmark/requirements.txt")
    return Path(spec.origin).parent


def robot() -> Path:
    """Return the description of the T1."""
    return package("holosoma") / "data" / "robots" / "t1" / "t1_29dof.xml"


class Policy:
    """A policy of the T1, from its file, and what it needs to know of the robot."""

    def __init__(self, name: str) -> None:
        import onnx
        import onnxruntime
        from holosoma_inference.config.config_values.observation import loco_t1_29dof as observed
        from holosoma_inference.config.config_values.robot import t1_29dof as body
        from holosoma_inference.config.config_values.task import locomotion as task

        path = package("holosoma_inference") / "models" / "loco" / "t1_29dof" / f"{name}_t1_29dof.onnx"
        facts = {fact.key: json.loads(fact.value) for fact in onnx.load(path).metadata_props}
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(path, options)
        self.joints, self.posture = facts["dof_names"], np.array(body.default_dof_angles)
        self.kp, self.kd = np.array(facts["kp"]), np.array(facts["kd"])
        self.dt, self.scale, self.gait_period = 1.0 / task.rl_rate, task.policy_action_scale, task.gait_period
        self._terms, self._scales = sorted(observed.obs_dict["actor_obs"]), observed.obs_scales
        self.fastest = facts["command_ranges"]["lin_vel_x"][1]

    def __call__(self, **terms: Array) -> Array:
        """Return the answer (29,) to what the robot observes."""
        seen = np.concatenate([np.ravel(terms[name]) * self._scales[name] for name in self._terms])
        out: Array = self._session.run(None, {"actor_obs": seen[None].astype(np.float32)})[0][0].astype(np.float64)
        return out


class Learned:
    """The controller: commands `speed` [m/s] to a policy for a time [s], then zero velocity."""

    def __init__(self, config: Config, policy: Policy, speed: float, duration: float) -> None:
        model = load_model(config.robot)
        self.config, self._policy, self._speed, self._duration = config, policy, speed, duration
        self._order = np.array([model.joint_names.index(name) for name in policy.joints])
        self._answer, self._goals = np.zeros(len(policy.joints)), policy.posture
        self._time, self._phase = 0.0, np.array([0.0, math.pi])

    @property
    def finished(self) -> bool:
        """Whether it has stood for long enough after the walk."""
        return self._time > self._duration + STOP

    def step(self, state: State, dt: float) -> Command:
        """Return the velocities that lead to the policy's goals within a period."""
        self._time = state.time
        walks = state.time < self._duration
        self._phase = (self._phase + 2.0 * math.pi * dt / self._policy.gait_period) if walks else np.full(2, math.pi)
        assert state.up is not None
        assert state.gyro is not None
        assert state.dq is not None
        self._answer = self._policy(
            base_ang_vel=state.gyro,
            projected_gravity=-state.up,
            command_lin_vel=np.array([self._speed if walks else 0.0, 0.0]),
            command_ang_vel=np.zeros(1),
            dof_pos=state.q[self._order] - self._policy.posture,
            dof_vel=state.dq[self._order],
            actions=self._answer,
            sin_phase=np.sin(self._phase),
            cos_phase=np.cos(self._phase),
        )
        goals = self._policy.posture + self._policy.scale * self._answer
        u = np.zeros(len(state.q))
        u[self._order] = (goals - self._goals) / dt
        self._goals = goals
        return Command(state.time, u)


class Goals:
    """A law without limits, delay or rounding: the goals of the motors are those of the policy."""

    fault = ""

    def __init__(self, q: Array, stiffness: Array) -> None:
        n = len(q)
        self.gate = AngleGate([""] * n, np.full(n, np.inf), 0.0, longest=lambda: np.inf, timeout=lambda: np.inf)
        self.wanted, self._stiffness, self._offset = q.copy(), stiffness, np.zeros(n)

    def begin(self, effort: Array) -> None:
        """Stand against the torques (n,) [N m] until the first command."""
        self._offset = effort / self._stiffness

    def measure(self, q: Array, time: float) -> None:
        """Motors know their angles themselves."""

    def command(self, u: Array, tau: Array | None, time: float, dt: float) -> None:
        """Move the goals by a velocity (n,) [rad/s]."""
        self.wanted, self._offset = self.wanted + dt * u, np.zeros(len(u))

    def output(self, time: float) -> tuple[Array, float]:
        """Return the goals (n,) [rad] and until when they hold [s]."""
        return self.wanted + self._offset, math.inf


def learned_walk(ours: Config, name: str, speed: float, duration: float) -> Walker:
    """Return the walk of a policy, "fastsac" or "ppo", at a speed [m/s] for a time [s]."""
    policy = Policy(name)
    config = ours.updated({"dt": policy.dt, "robot.lock": [], "standing.posture": [], "servo.stiffness": 1.0})
    model = load_model(config.robot)
    order = [policy.joints.index(name) for name in model.joint_names]

    def plant(config: Config, model: RobotModel, q: Array) -> PhysicsPlant:
        # servo.stiffness is the factor of the world on the gains
        kp, kd = config.servo.stiffness * policy.kp[order], config.servo.stiffness * policy.kd[order]
        motors = replace(Servos.of(config, model), stiffness=kp, damping=kd)
        return PhysicsPlant(config, model, q, motors, Goals(q, kp))  # type: ignore[arg-type]

    length, commanded = speed * duration, speed
    while True:
        make = lambda c, v=commanded: Learned(c, policy, v, duration)  # noqa: E731
        title = f"learned, {name} of holosoma"
        walker = Walker(title, config, make, policy.posture[order], length, plant=plant, balances=True)
        missing = 1.0 - walker.walk({}).way / length
        if abs(missing) < FARTHEST or commanded > policy.fastest:
            return walker
        commanded += missing * speed
