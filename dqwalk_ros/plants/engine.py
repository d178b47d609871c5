"""The robot in a physics engine, with position servos and sensors; a subclass for each engine.

The root link floats, and only the soles have contacts with the ground. Everything except the mechanics is here, so that
all engines simulate the same servos, bus and sensors.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config, PhysicsConfig
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import X, Y
from dqwalk_ros.paper.kinematics import Kinematics, quaternion_product
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.paper.statics import GRAVITY, gravity_torques
from dqwalk_ros.plants.base import Inertial, Plant, Truth, are_finite, checked, upward
from dqwalk_ros.plants.sensors import Reading, Sensors
from dqwalk_ros.plants.servo_goals import ServoGoals
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import Servos
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.compiled import jit
from dqwalk_ros.support.errors import PlantError

HELD = 1.5
"""Height at which the root link is held in the air [m]."""
_NO_ACCELERATION = np.zeros(3)


class EnginePlant(Plant):
    """The robot with position servos in a physics engine.

    Parameters
    ----------
    q0 : array_like, shape (n,), optional
        Initial joint angles, with both soles on the ground, or held by its root [rad]; zero by default.
    servos : Servos, optional
        The simulated servos; by default those of the section ``servo``.
    law : ServoGoals, optional
        Computes the goals of the servos; by default as the section ``servo`` describes it.
    """

    physics = True
    parameters = "physics"

    def __init__(
        self,
        config: Config,
        model: RobotModel,
        q0: ArrayLike | None = None,
        servos: Servos | None = None,
        law: ServoGoals | None = None,
    ) -> None:
        self.config, self.model = config, model
        q = np.zeros(model.n) if q0 is None else np.array(q0, dtype=np.float64)
        servos = servos or Servos.of(config, model)
        self._back_emf = servos.back_emf
        mounting = DQ(model.frames[model.imu_link].pose).conj() * DQ(model.frames[model.imu].pose)
        self._mounting = mounting.vec4()
        self._to_sensor = np.ascontiguousarray(mounting.rotation_matrix().T)
        self._level = slope_of(config)
        self._sensors, self._foot_force = Sensors(config.sensors), config.plant.foot_force
        self._law = law or ServoGoals.of(config, model, simulated=servos)
        self._make(servos)
        root = None if config.physics.held else standing_root(model, q)
        self._seat(q, root)
        self._upright = self._floor_normal()
        self._height = -math.inf if root is None else self._over_soles()  # one that is held cannot fall
        # the first goals include the torques against gravity: soft servos would let the robot tip backwards
        up = -gravity_of(self._level) / GRAVITY
        effort = np.zeros(model.n) if root is None else gravity_torques(Kinematics(model, q, Foot.LEFT, up), both=True)
        self._law.gate.use(q, 0.0)
        self._law.begin(effort)
        self._elapsed = 0.0  # [ns]
        self._dt, self._count = config.dt, self._divide(config.dt)
        goals, settle = self._law.output(0.0)[0], max(1, round(config.physics.settle * self._count / config.dt))
        self._run(goals, settle - 1)
        torque = self._run(goals, 1)
        self._q, self._dq = self._joints()
        self._effort = torque - self._back_emf * self._dq
        self._state = self._measured()

    @property
    def state(self) -> State:
        """The present state as measured by the robot's sensors."""
        return self._state

    def step(self, command: Command, dt: float) -> State:
        """Return the state after one period, which the engine's steps divide evenly.

        Raises
        ------
        PlantError
            If the command has a wrong size or is not finite, or the simulation has diverged.
        """
        u, tau = checked(command.velocity, self.model.n, "velocities"), command.effort
        if tau is not None:
            tau = checked(tau, self.model.n, "torques")
        return self._advance(u, tau, dt)

    def hold(self, dt: float) -> State:
        """Return the state after one period without a command."""
        return self._advance(None, None, dt)

    def _advance(self, u: Array | None, tau: Array | None, dt: float) -> State:
        if dt != self._dt:
            self._dt, self._count = dt, self._divide(dt)
        left = count = self._count
        h, now = dt / count, self._time
        self._law.measure(self._state.q, now)
        if u is not None:
            self._law.command(u, tau, now, dt)
        before, torque = self._q, np.zeros(len(self._q))
        while left:
            goals, until = self._law.output(now)
            steps = min(left, max(1, math.ceil((until - now) / h - 1e-6))) if until < math.inf else left
            torque += self._run(goals, steps)
            left, now = left - steps, self._time
        self._q, self._dq = self._joints()
        self._effort = _mean_effort(torque, count, self._back_emf, before, self._q, h)
        if not are_finite(self._q):
            raise PlantError("the simulation is not finite any more")
        self._elapsed += dt * 1e9
        self._state = self._measured()
        return self._state

    @property
    def commanded(self) -> Array:
        """Commanded positions without the offsets by feedforward torques, shape (n,) [rad]."""
        return self._law.wanted

    @property
    def warning(self) -> str:
        """Why the walk should end: ``physics.warn_at`` has come; or empty."""
        at = self.config.physics.warn_at
        return f"{at:g} s have passed (physics.warn_at)" if 0.0 < at <= self._state.time else ""

    @property
    def fault(self) -> str:
        """Why no command has an effect any more; empty if commands have."""
        return self._law.fault

    @property
    def truth(self) -> Truth:
        """Ground truth; forces are those of one step of the engine, torques the mean of the last period."""
        model = self.model
        return Truth(
            pelvis=self._pose(model.pelvis),
            soles={foot: self._pose(model.soles[foot].frame) for foot in Foot},
            wrenches={foot: self._wrench(foot) for foot in Foot},
            com=self._com,
            q=self._q,
            effort=self._effort,
        )

    @property
    def inertial(self) -> Inertial:
        """Measurements of the inertial sensor."""
        r = self._reading
        acceleration = self._to_sensor @ self._acceleration() if self._sensors.exact else r.acceleration
        return Inertial(r.orientation, r.gyro, acceleration)

    @property
    def fallen(self) -> bool:
        """Whether the CoM is below 60 % of its initial height, or the pelvis leans by more than 60 degrees from there.

        The height is that over the lower sole, wherever stairs have led it. Neither depends on where a description has
        the origin of a link, or on its axes.
        """
        return self._over_soles() < 0.6 * self._height or bool(self._floor_normal() @ self._upright < 0.5)

    def _over_soles(self) -> float:
        """Return the height of the CoM over the lower sole [m]."""
        return float(self._com[2]) - min(self._height_of(sole.frame) for sole in self.model.soles.values())

    def _measured(self) -> State:
        orientation, gyro = _imu(self._level, *self._imu_motion(), self._mounting, self._to_sensor)
        time = round(self._elapsed) * 1e-9  # rounded to nanoseconds, like a ROS stamp
        # the acceleration of an exact sensor is computed only when `inertial` is read
        acceleration = _NO_ACCELERATION if self._sensors.exact else self._to_sensor @ self._acceleration()
        exact = Reading(orientation, gyro, acceleration, self._q, self._dq, self._effort)
        r = self._reading = self._sensors.measure(time, exact)
        felt = None if self._sensors.exact else r.acceleration
        feet = np.array([np.linalg.norm(self._wrench(foot)[:3]) for foot in Foot]) if self._foot_force else None
        return State(time, r.q, r.dq, _upward(*r.orientation.tolist()), r.gyro, felt, r.effort, feet)

    # ------------------------------------------------------------------ the engine

    @abstractmethod
    def _make(self, servos: Servos) -> None:
        """Make the world, with servos whose torques are clip(stiffness e - damping dq, +-torque) - back_emf dq."""

    @abstractmethod
    def _seat(self, q: Array, root: Array | None) -> None:
        """Set joint angles (n,) [rad], and the pose (8,) of the root link where it is not held, at rest."""

    @abstractmethod
    def _divide(self, dt: float) -> int:
        """Set the step to an integer fraction of a period [s], and return the number of steps."""

    @property
    @abstractmethod
    def _time(self) -> float:
        """Time of the engine [s]."""

    @abstractmethod
    def _run(self, goals: Array, steps: int) -> Array:
        """Make steps with goals (n,) [rad]; return the sum over them of the torques (n,) without back EMF [N m]."""

    @abstractmethod
    def _joints(self) -> tuple[Array, Array]:
        """Return new arrays of the angles and velocities of the joints, both (n,) [rad, rad/s]."""

    @abstractmethod
    def _imu_motion(self) -> tuple[Array, Array, Array]:
        """Return the motion of the inertial sensor's link on the floor, in contiguous arrays.

        It is the orientation (4,) and, in axes of the floor, the angular velocity (3,) [rad/s] and the axes of the
        link, the columns of a matrix (3, 3).
        """

    @abstractmethod
    def _acceleration(self) -> Array:
        """Return the specific force (3,) at the origin of that link, in its axes [m/s^2]."""

    @abstractmethod
    def _pose(self, link: str) -> Array:
        """Return the pose (8,) of a link."""

    @abstractmethod
    def _height_of(self, link: str) -> float:
        """Return the height of a link's origin [m]."""

    @abstractmethod
    def _wrench(self, foot: Foot) -> Array:
        """Return the force and torque of the ground about the sole's origin in its axes, shape (6,)."""

    @property
    @abstractmethod
    def _com(self) -> Array:
        """Centre of mass, shape (3,) [m]."""

    @abstractmethod
    def _floor_normal(self) -> Array:
        """Return the normal of the floor in the axes of the pelvis (3,)."""


def standing_root(model: RobotModel, q: Array) -> Array:
    """Return the pose (8,) of the root link with the left sole flat on the floor, at which it does not yet touch."""
    kin = Kinematics(model, q, Foot.LEFT)
    lifted = DQ.from_pose([0.0, -0.5 * kin.point(kin.swing)[1], 0.0005])
    return (lifted * DQ(kin.pose(model.root))).vec8()


def steps_of(dt: float, largest: float) -> int:
    """Return the number of steps of at most `largest` [s] that divide a period `dt` [s] evenly."""
    return max(1, math.ceil(dt / largest - 1e-6))


def slope_of(config: Config) -> Array:
    """Return the orientation (4,) of the sloping floor, the simulation's world frame, relative to a level one."""
    c = config.physics
    return (DQ.rotation_about(-c.slope, Y) * DQ.rotation_about(c.slope_side, X)).vec4()


def gravity_of(level: Array) -> Array:
    """Return gravity (3,) in the frame of the floor with the orientation `level` (4,) [m/s^2]."""
    out: Array = DQ(level).conj().rotation_matrix() @ np.array([0.0, 0.0, -GRAVITY])
    return out


@jit
def _mean_effort(torque: Array, count: int, back_emf: Array, before: Array, q: Array, h: float) -> Array:
    """Return the mean torques (n,) [N m] of `count` steps of `h` [s] in which joints moved from `before` to q (n,).

    `torque` (n,) is the sum without back EMF, which is `back_emf` (n,) times the velocity.
    """
    return (torque - back_emf * (q - before) / h) / count


_upward = jit(upward)


@jit
def _imu(
    level: Array, link: Array, velocity: Array, axes: Array, mounting: Array, to_sensor: Array
) -> tuple[Array, Array]:
    """Return the orientation (4,) of the inertial sensor in a level world, and its angular velocity in its axes (3,).

    `level`, `link` and `mounting` (4,) are the orientations of the floor, of the link on the floor, and of the sensor
    on the link. The angular velocity `velocity` (3,) and the `axes` (3, 3) of the link are those of `_imu_motion`.
    """
    a = quaternion_product(level[0], level[1], level[2], level[3], link[0], link[1], link[2], link[3])
    b = quaternion_product(a[0], a[1], a[2], a[3], mounting[0], mounting[1], mounting[2], mounting[3])
    return np.array(b), to_sensor @ (velocity @ axes)


@jit
def pose_of(p: Array, r: Array) -> Array:
    """Return the pose r + eps 1/2 p r of (U1), shape (8,), of a position p (3,) [m] and a unit quaternion r (4,)."""
    x = np.empty(8)
    x[:4] = r
    x[4:] = quaternion_product(0.0, 0.5 * p[0], 0.5 * p[1], 0.5 * p[2], r[0], r[1], r[2], r[3])
    return x


class Box(NamedTuple):
    """A box that the robot walks on: half its sizes and the position of its centre (3,) [m], and its yaw [rad]."""

    half: tuple[float, float, float]
    at: tuple[float, float, float]
    turn: float


def floor_of(config: Config) -> tuple[float, list[Box]]:
    """Return the height of the floor below the robot's first place [m], and the boxes of stairs and rubble on it."""
    c = config.physics
    floor = min(0.0, c.rise * c.stairs)
    return floor, [*_stairs(c, floor), *(_rubble(c.rubble, config.sensors.seed, floor) if c.rubble else ())]


def _stairs(c: PhysicsConfig, floor: float) -> Iterator[Box]:
    """Yield the boxes of the stairs; where these lead down, the robot begins on the first of them."""
    if not c.rise:
        return
    edges = [c.stairs_at + k * c.tread for k in range(c.stairs)]
    ends = [-_FAR, *edges] if c.rise < 0.0 else [*edges, _FAR]
    for k in range(c.stairs):
        top = c.rise * (k if c.rise < 0.0 else k + 1)
        half = 0.5 * (ends[k + 1] - ends[k]), _BROAD, 0.5 * (top - floor)
        yield Box(half, (0.5 * (ends[k] + ends[k + 1]), 0.0, floor + half[2]), 0.0)


_FAR, _BROAD = 10.0, 1.0
"""Where the floor above or before the stairs ends, and half of the width of the stairs [m]."""


def _rubble(height: float, seed: int, floor: float) -> Iterator[Box]:
    """Yield boxes of random size, up to `height` [m] high, ahead of and behind the robot."""
    random = np.random.default_rng(seed)
    for x in np.arange(-1.0, 1.5, 0.06):
        for y in np.arange(-0.3, 0.31, 0.06):
            if abs(x) < 0.2:
                continue  # the robot starts here
            a, b = random.uniform(0.01, 0.03, 2)
            half = (a, b, 0.5 * height * random.uniform())
            turn = random.uniform(0.0, np.pi)
            place = x + random.uniform(-0.01, 0.01), y + random.uniform(-0.01, 0.01), floor + half[2]
            yield Box(half, place, turn)
