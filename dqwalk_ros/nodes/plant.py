"""Simulated robots: a kinematic integrator and a physics engine.

In lockstep a plant publishes a state, waits for the command with the same stamp, moves and publishes the next state, so
that a run is reproducible and as fast as the machine allows. In real time it publishes at 1/dt, with or without
commands, as hardware does.
"""

from __future__ import annotations

import argparse
from collections import deque
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.command_input import CommandInput
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.base import Plant, pushed_periods
from dqwalk_ros.plants.table import make_plant, plant_type
from dqwalk_ros.robot.limits import clamp_velocity
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import ConfigError, DqwalkError, StateError
from dqwalk_ros.support.topics import TOPICS, VELOCITY, WORLD

_ASK_AGAIN = 0.5
"""Time after which a lockstep state without a command is published again [s]: state or command may have been lost."""
_FIRST_ASK = 0.05
"""The same before the first command [s], while the controller may still be starting."""
_PUSH = 0.1
"""Duration of a push [s], in simulated time, rounded to whole periods."""
_JUDGED = 500_000
"""Number of the last ticks whose delays are reported at the end."""
_MAX_SPEED = 10.0
"""Largest change of the robot's velocity by a push [m/s]."""


class SimulatedPlant(WalkNode):
    """Commands -> joint_states, in lockstep or in real time; a subclass defines the plant."""

    claims = "joint_states"
    topic = VELOCITY
    """Topic of the commands."""

    def __init__(self, name: str, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__(name, options, **keywords)
        self.model = load_model(self.config.robot)
        self.dt = self.config.dt
        self.plant = self.make_plant()
        self.commands = CommandInput(self, self.model, self.topic)
        self.ticks = 0
        self._stamp = 0  # of the state published last [ns]
        self.trouble = ""  # what is wrong with the plant, which is an error
        self._missed = 0
        self._published_at = -float("inf")  # steady time [s]
        self._moved = self._now()
        self._states = self.advertise("joint_states")
        self._state_msg = ros.JointWriter(self.model.joint_names)
        self._clock_topic = self.create_publisher(Clock, "/clock", 10) if self.config.plant.clock else None
        if self.lockstep:
            self.listen(JointState, self.topic, self._on_answer, 1)
            self.create_timer(_FIRST_ASK, self._ask)
        else:
            self.listen(JointState, self.topic, self._on_command, 1)
            self.create_timer(self.dt, self._on_period)
        self.create_timer(1.0 / self.config.monitor.rate, self._diagnose)

    def log_ready(self) -> None:
        """Log robot and mode when the node is ready."""
        mode = "lockstep" if self.lockstep else f"real time at {1.0 / self.dt:g} Hz"
        self.get_logger().info(f"{self.model.name}: {self.model.n} joints, {mode}")

    # ------------------------------------------------------------------ defined by each plant

    def make_plant(self) -> Any:
        """Return the simulated plant."""
        raise NotImplementedError

    def period(self, passed: float) -> float:
        """Return the time to move in real time, `passed` after the last tick [s].

        At most two periods: lost time is not made up for.
        """
        return min(passed, 2.0 * self.dt)

    def real_time(self) -> int:
        """Return the stamp of a state in real time [ns]."""
        return int(self.get_clock().now().nanoseconds)

    def on_step(self, before: int) -> None:
        """Publish what belongs to the period since the stamp `before` [ns]; called before the state after it."""

    def publish(self) -> None:
        """Publish the state, with the torques of the joints if they are measured."""
        if self._clock_topic is not None:
            self._clock_topic.publish(Clock(clock=ros.time_msg(self._stamp)))
        state = self.plant.state
        self._states.publish(self._state_msg(self._stamp, position=state.q, velocity=state.dq, effort=state.effort))

    # ------------------------------------------------------------------ lockstep

    def _on_answer(self, msg: JointState) -> None:
        command = self.commands.take_answer(msg, self._stamp)
        if command is not None:
            u = clamp_velocity(command.velocity, self.plant.commanded, self.model, self.dt)
            self._move(Command(self._stamp * 1e-9, u, command.effort), self.dt)

    def _ask(self) -> None:
        """Publish the state again if no command has arrived."""
        now = self.steady()
        if now - self._published_at < (_ASK_AGAIN if self.ticks else _FIRST_ASK) or not self._may_begin():
            return
        self._published_at = now
        self.publish()

    def _may_begin(self) -> bool:
        """Return whether monitor and recorder, if they are to be waited for, have subscribed to the states."""
        if self.ticks:
            return True
        awaited = self.config.node.wait_for_monitor
        return (not awaited or ros.is_heard_by(self, self._states, "phase_monitor")) and self.may_publish()

    # ------------------------------------------------------------------ real time

    def _on_command(self, msg: JointState) -> None:
        self.commands.take(msg, self._stamp)

    def _now(self) -> float:
        """Return the time by which periods are measured [s]: the steady clock, or /clock with use_sim_time."""
        return 1e-9 * self.get_clock().now().nanoseconds if self.uses_sim_time else self.steady()

    def _on_period(self) -> None:
        now = self._now()
        passed, self._moved = max(now - self._moved, 0.0), now
        if not now or not self._may_begin():  # no node publishes the /clock of use_sim_time
            return
        if passed > 2.0 * self.dt:
            self._missed += int(passed / self.dt) - 1
        self.commands.log_motion()
        dt, gate = self.period(passed), self.commands.gate
        if gate.holding:
            self._move(None, dt)
        else:
            self._move(Command(self._stamp * 1e-9, gate.velocity(self.plant.commanded, dt), gate.effort), dt)

    # ------------------------------------------------------------------ both

    def _move(self, command: Command | None, dt: float) -> None:
        """Move for `dt` [s], or hold without a command, and publish the state."""
        try:
            self.plant.hold(dt) if command is None else self.plant.step(command, dt)
        except DqwalkError as error:
            self.get_logger().error(f"the plant failed: {error}")
            self.stop(1)
            return
        before, self.ticks = self._stamp, self.ticks + 1
        self._stamp = round(self.ticks * self.dt * 1e9) if self.lockstep else self.real_time()
        self._published_at = self.steady()
        self.on_step(before)
        self.publish()

    def _diagnose(self) -> None:
        level, text = self.commands.level()
        if time_trouble := self.time_trouble():
            self.get_logger().error(time_trouble, **throttled(10.0))
        if trouble := time_trouble or self.trouble:
            level, text = "ERROR", trouble
        values = {"ticks": self.ticks, "periods missed": self._missed, **self.commands.counts()}
        self.diagnose("plant", self.model.name, level, text, values, self._stamp)


class Integrator(SimulatedPlant):
    """Simulate the robot by integrating the commanded joint velocities (Euler), at 1/dt or in lockstep.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]

    Publishes::

        joint_states             sensor_msgs/JointState [rad, rad/s]
        plant_ready              std_msgs/Bool, latched: false while the plant holds, in real time
        /clock                   rosgraph_msgs/Clock with plant.clock: the time of its stamps, for all nodes
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Sections of the schema: dt, robot, standing.posture, plant, monitor.rate, node.

    Example::

        dqwalk_integrator --ros-args --params-file config/paper.yaml -p plant.lockstep:=true

    Raises
    ------
    ConfigError
        With plant.imu, for whose messages the controller would wait.
    """

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("integrator", options, **keywords)
        if self.config.plant.imu:
            raise ConfigError("plant.imu is true, but only physics has an inertial sensor: use it, or set it to false")
        self.log_ready()

    def make_plant(self) -> Plant:
        """Return joints that follow their commands exactly."""
        posture = self.model.posture(self.config.standing.posture)
        return plant_type(self.config.plant.name or "integrator").of(self.config, self.model, posture)


class Physics(SimulatedPlant):
    """Simulate the robot in MuJoCo with soles, servos and an inertial sensor, in real time or in lockstep.

    In real time the engine advances by one period per tick of the steady clock: on a slow machine the simulation is
    slow, but does not jump. Stamps are simulated time, counted from the time of the clock at the start.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]; efforts are feedforward torques [N m]
        push                     geometry_msgs/WrenchStamped: its force times 1 s hits the pelvis [N s], in world

    Publishes::

        joint_states             sensor_msgs/JointState [rad, rad/s]
        plant_ready              std_msgs/Bool, latched: false while the plant holds, in real time
        plant_warning            std_msgs/String, latched: why the walk should end, from physics.warn_at on
        imu                      sensor_msgs/Imu of the link robot.imu, with the stamp of the state
        true_base_pose           geometry_msgs/PoseStamped: the pelvis in the world; for analysis, as the next four:
        true_joint_states        sensor_msgs/JointState: angles without the errors of the sensors [rad]
        left_foot_wrench, right_foot_wrench   geometry_msgs/WrenchStamped: ground on the sole, in its frame
        center_of_pressure       geometry_msgs/PointStamped: of both feet in the world; not published in the air
        /clock                   rosgraph_msgs/Clock with plant.clock: the time of its stamps, for all nodes
        /diagnostics             diagnostic_msgs/DiagnosticArray: ERROR when the robot has fallen

    Services::

        ~/reset                  std_srvs/Trigger: puts the robot back on its feet (real time)

    Sections of the schema: dt, robot, plant, physics, sensors, servo, monitor.rate, node.

    Example::

        dqwalk_physics --ros-args --params-file config/poppy.yaml -p plant.imu:=true

    Raises
    ------
    PlantError
        If MuJoCo cannot load the robot.
    """

    plant: Any

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("physics", options, **keywords)
        self._streams = {name: self.advertise(name) for name in TOPICS if TOPICS[name].source == "physics"}
        self._true_angles = ros.JointWriter(self.model.joint_names)
        self._late: deque[float] = deque(maxlen=_JUDGED)  # delay of each tick while commands arrive [s]
        self._stamp0 = self.get_clock().now().nanoseconds
        self._pushed_until = -1  # tick
        self._max_impulse = _MAX_SPEED * self.model.mass  # [N s]
        self.offer("~/reset", self._reset)
        self.create_subscription(WrenchStamped, "push", self._on_push, 10)
        self.log_ready()
        if not self.config.plant.imu:
            self.get_logger().warning(
                "plant.imu is false: without an inertial sensor the controller does not balance, and robots fall; give "
                "both nodes the parameters of config/plants/physics.yaml, too"
            )

    def make_plant(self) -> Plant:
        """Return the robot on its soles."""
        return make_plant(self.config.plant.name or "physics", self.config, self.model)

    def period(self, passed: float) -> float:
        """Return one period, however late the tick is."""
        if not self.commands.gate.watchdog.silent:
            self._late.append(passed - self.dt)
        return self.dt

    def real_time(self) -> int:
        """Return the simulated time, counted from the time of the clock at the start [ns]."""
        return self._stamp0 + round(self.ticks * self.dt * 1e9)

    def publish(self) -> None:
        """Publish the sensors before the state, because the controller needs them together with it."""
        if self.ticks == self._pushed_until:
            self.plant.push(np.zeros(3))
        stamp, streams = self._stamp, self._streams
        others = (streams[name] for name in streams if name != "imu")
        truth = self.plant.truth if any(stream.get_subscription_count() for stream in others) else None
        streams["imu"].publish(ros.imu(stamp, self.model.imu_link, self.plant.inertial))
        super().publish()
        if truth is not None:
            streams["true_base_pose"].publish(ros.pose(stamp, WORLD, truth.pelvis))
            streams["true_joint_states"].publish(self._true_angles(stamp, position=truth.q))
            for foot in Foot:
                wrench = ros.wrench(stamp, self.model.soles[foot].frame, truth.wrenches[foot])
                streams[f"{foot.value}_foot_wrench"].publish(wrench)
            if np.isfinite(cop := truth.cop).all():
                streams["center_of_pressure"].publish(ros.point(stamp, WORLD, cop))
        self.commands.warn(self.plant.warning)
        if not self.lockstep:
            self.commands.forbid(self.plant.fault)
        elif self.plant.fault:
            self.get_logger().error(f"no command has an effect: {self.plant.fault}", once=True)
        if self.plant.fallen and not self.trouble:
            self.trouble = f"the robot fell at {self.ticks * self.dt:.2f} s; ~/reset puts it back on its feet"
            self.get_logger().error(self.trouble)
            if self.is_child:  # a walk without a user who could call ~/reset
                self.stop(1)

    def _on_push(self, msg: WrenchStamped) -> None:
        try:
            impulse = ros.impulse(msg, self._max_impulse)
        except StateError as error:
            self.get_logger().error(f"push rejected: {error}")
            return
        periods = pushed_periods(_PUSH, self.dt)
        self.plant.push(impulse / (periods * self.dt))
        self._pushed_until = self.ticks + periods
        self.get_logger().info("pushed: {:g}, {:g}, {:g} N s".format(*impulse) + f" within {periods * self.dt:g} s")

    def _reset(self) -> tuple[bool, str]:
        if self.lockstep:
            return False, "lockstep time cannot be set back: restart the node"
        self.plant = self.make_plant()
        self.commands.gate.hold()
        self.trouble = ""
        return True, "the robot stands; the controller needs ~/reset and ~/start"

    def close(self) -> None:
        """Log the achieved rate and the delays of the ticks."""
        if self.lockstep or len(self._late) < 2:
            return
        late = 1e3 * np.array(self._late)
        took = float(late.sum()) * 1e-3 + len(late) * self.dt
        rate = len(late) / took
        text = (
            f"{len(late)} ticks at {rate:.1f} Hz, {100.0 * rate * self.dt:.1f} % of real time; late by "
            f"{np.median(late):.2f} ms (median), {np.percentile(late, 99):.1f} ms (p99), {late.max():.0f} ms at most"
        )
        self.get_logger().info(text)
        self.report(pace=text)
