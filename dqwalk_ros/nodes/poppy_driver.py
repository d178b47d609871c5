"""A real Poppy as a plant: converts commands to goal angles of its servos, and publishes the measured angles."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.command_input import CommandInput
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.poppy.motors import require_bus
from dqwalk_ros.plants.poppy.plant import PoppyPlant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support.errors import DqwalkError, PlantError
from dqwalk_ros.support.topics import FALLEN, VELOCITY

_SOONEST = 0.5
"""Least time between two goals, in periods."""


class PoppyDriver(WalkNode):
    """Drive a real Poppy Humanoid; with poppy.dummy:=true, emulated motors.

    The driver does not move the robot by itself (unless poppy.activate is set). It publishes the angles from the start.
    ~/activate switches the torque on in the current posture, checks it, and moves the robot slowly to its first pose,
    standing.posture; then commands are accepted. While the torque is on and no motor has a fault, ~/activate does
    nothing. The stamp of a state is the time at which its oldest angle was read; a state with an angle older than
    plant.command_timeout is not published. While a motor has a fault the robot holds still, and /diagnostics names the
    motor, the fault, and what to do.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]; effort is a feedforward torque [N m]
        phase                    std_msgs/String: 'fallen' switches the torque off

    Publishes::

        joint_states             sensor_msgs/JointState of all 25 motors
        joint_goals              sensor_msgs/JointState: their goal angles at the time of that state [rad]
        plant_ready              std_msgs/Bool, latched: whether commands are accepted
        plant_warning            std_msgs/String, latched: why the walk should end, such as a motor that is warm
        /diagnostics             latency of the loop; temperature, voltage, load and error bits of every motor

    Services::

        ~/activate               std_srvs/Trigger: switch the torque on, go to the first pose
        ~/compliant              std_srvs/SetBool: true switches the torque off, false is ~/activate

    Sections of the schema: dt, robot, standing.posture, plant, servo, monitor.rate, poppy.

    The defaults are those of config/plants/poppy.yaml.

    Example::

        dqwalk_poppy_driver --ros-args -p poppy.dummy:=true

    Raises
    ------
    ConfigError
        As `require_bus`, and the motors and their calibration.
    PlantError
        If the motors do not answer.
    """

    claims = "joint_states"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("poppy_driver", options, **keywords)
        config = self.config
        self._period = 1.0 / config.poppy.rate
        require_bus(config)
        model = load_model(config.robot)
        posture = model.posture(config.standing.posture)
        self._plant = PoppyPlant(config, model, posture, clock=self.steady)
        self._commands = CommandInput(self, model)
        self._state_msg = ros.JointWriter(self._plant.names)
        self._goal_msg = ros.JointWriter(self._plant.names)
        self._hardware = f"{model.name}{' (emulated motors)' if config.poppy.dummy else ''}"
        self._refused = ""  # why the last ~/activate was, if no motor has a fault, which is reported while it lasts
        self._stamp, self._measured_at = -1, -math.inf  # of the state published last [ns], and by the steady clock [s]
        self._sent_at = self._read_at = self.steady()
        self._counts = {"ticks": 0, "periods missed": 0, "states withheld": 0}
        self._latencies: list[float] = []  # since the last diagnostics [s]
        self._lag = np.zeros(len(self._plant.names))  # largest since the last diagnostics [rad]
        self._states = self.advertise("joint_states")
        self._goals = self.create_publisher(JointState, "joint_goals", 10)
        self.create_subscription(JointState, VELOCITY, self._on_command, 1)
        self.create_subscription(String, "phase", self._on_phase, 1)
        self.offer("~/activate", partial(self._switch, True))
        self.create_service(SetBool, "~/compliant", self._on_compliant)
        self.create_timer(self._period, self._on_period)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose)
        self.get_logger().info(f"{self._hardware}: {len(self._plant.names)} motors at {config.poppy.rate:g} Hz")
        if config.poppy.activate:
            self._plant.activate()
        self._hold_for_a_reason()

    def _on_command(self, msg: JointState) -> None:
        """Send the goals at once, because waiting for the next period would add delay to the loop."""
        if not self._commands.take(msg, self._stamp) or not self._plant.ready:
            return
        if self.steady() - self._sent_at < _SOONEST * self._period:
            return  # sent again; the bus has not transmitted the last goals yet
        self._send_goals()
        if stamp := ros.nanoseconds(msg.header.stamp):
            self._latencies.append(1e-9 * (self.get_clock().now().nanoseconds - stamp))

    def _on_period(self) -> None:
        plant, was_ready = self._plant, self._plant.ready
        now = self.steady()
        self._counts["periods missed"] += max(int((now - self._read_at) / self._period) - 1, 0)
        self._read_at = now
        self._commands.log_motion()
        if not plant.ready or self._commands.gate.holding:
            self._send_goals()
        plant.read()
        if plant.ready and not was_ready:
            self._commands.gate.hold()
            self.get_logger().info("in the first pose")
        self._hold_for_a_reason()
        self._publish()

    def _send_goals(self) -> None:
        """Move for the time since the last goals, at most two periods: lost time is not made up for."""
        now, gate = self.steady(), self._commands.gate
        passed, self._sent_at = now - self._sent_at, now
        dt = min(passed, 2.0 * self._period)
        u = gate.velocity(self._plant.commanded, dt)
        self._plant.write(None if gate.holding else Command(self._stamp * 1e-9, u, gate.effort), dt)

    def _publish(self) -> None:
        """Publish the measured angles, and the goals at that time."""
        self._counts["ticks"] += 1
        plant = self._plant
        measured_at = plant.measured_at
        if not plant.fresh or measured_at <= self._measured_at:
            self._counts["states withheld"] += 1
            return
        stamp = self._stamp = self.get_clock().now().nanoseconds - round(1e9 * plant.age)
        self._measured_at = measured_at
        effort = plant.state.effort
        if effort is not None:  # of the joints of the walk
            effort = np.append(effort, np.full(len(plant.names) - len(effort), np.nan))
        q, dq = plant.measured.q, plant.measured.dq
        self._states.publish(self._state_msg(stamp, position=q, velocity=dq, effort=effort))
        if plant.active:
            self._goals.publish(self._goal_msg(stamp, position=plant.goal))
            self._lag = np.maximum(self._lag, np.abs(plant.measured.q - plant.goal))

    # ------------------------------------------------------------------ torque

    def _hold_for_a_reason(self) -> None:
        """Hold while a fault or a missing torque prevents motion."""
        plant = self._plant
        reason = plant.watch.fault
        if reason and plant.active and not plant.ready:
            self.get_logger().warning(f"not moving to the first pose: {reason}", **throttled())
        if not reason and not plant.active:
            on = "the motors hold where they are, not activated by this driver: call ~/activate, or ~/compliant"
            reason = on if plant.stiff else "the torque is off: call ~/activate"
            reason += f"; it was refused last time: {self._refused}" if self._refused else ""
        if not reason and not plant.ready:
            reason = "moving to the first pose"
            self.get_logger().info(f"{reason}: {plant.remaining:.2f} rad left", **throttled())
        self._commands.forbid(reason or self.time_trouble())
        self._commands.warn(plant.warning)

    def _on_compliant(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = self.perform(partial(self._switch, not request.data))
        return response

    def _on_phase(self, msg: String) -> None:
        """Switch the torque off when the robot has fallen; ignore a fall from before this driver was started."""
        if msg.data == FALLEN and (self._plant.active or self._plant.stiff):
            self.get_logger().error("the robot has fallen: switching the torque off")
            self.perform(partial(self._switch, False))

    def _switch(self, on: bool) -> tuple[bool, str]:
        if on and self._plant.active and not self._plant.watch.faults:  # it may be in mid-step
            return True, "the torque is on already"
        self._commands.gate.hold()
        self._refused = ""
        try:
            self._plant.activate() if on else self._plant.release()
        except DqwalkError as error:
            self._refused = str(error) if on and not self._plant.watch.faults else ""
            raise
        finally:
            self._hold_for_a_reason()
        return True, "the torque is on: moving to the first pose, slowly" if on else "the torque is off"

    # ------------------------------------------------------------------ diagnostics

    def _diagnose(self) -> None:
        plant, faults = self._plant, self._plant.watch.faults
        level, text = self._commands.level()
        if not faults and not plant.ready:
            level = "WARN"
            text = (
                f"moving to the first pose: {plant.remaining:.2f} rad left"
                if plant.active
                else self._commands.gate.refused
            )
        i = int(self._lag.argmax())
        values = {**self._counts, **self._commands.counts()}
        values |= {"lagging joint": plant.names[i], "lag": float(self._lag[i]), "oldest angle": plant.age}
        if self._latencies:
            values |= {"latency": float(np.median(self._latencies)), "longest latency": max(self._latencies)}
        self._lag[:] = 0.0
        self._latencies.clear()
        stamp = max(self._stamp, 0)
        self.diagnose("plant", self._hardware, level, text, values, stamp)

        each: dict[str, object] = {}
        heat: dict[str, float] = {}
        for part in plant.parts:
            for k, seen, error in zip(part.places, part.bus.registers, part.bus.error, strict=True):
                joint = plant.names[k]
                if seen is not None:
                    heat[joint] = seen.temperature
                    each |= {f"temperature/{joint}": seen.temperature, f"voltage/{joint}": seen.voltage}
                each |= {f"load/{joint}": float(plant.measured.load[k]), f"error bits/{joint}": int(error)}
        state = "no motor has reported its temperature"
        if heat:
            hottest = max(heat, key=lambda joint: heat[joint])
            each |= {"hottest motor": hottest, "hottest temperature": heat[hottest]}
            state = f"{hottest} is hottest, {heat[hottest]:.0f} degC"
        level = "ERROR" if faults else "WARN" if plant.warning else "OK"
        text = plant.watch.fault or plant.warning or state
        self.diagnose("motors", self._hardware, level, text, each, stamp)

    def close(self) -> None:
        """Hold or switch the torque off, as configured, and close the buses."""
        self._commands.close()
        try:
            self._plant.close()
        except PlantError as error:
            self.get_logger().error(str(error))
