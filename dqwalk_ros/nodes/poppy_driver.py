"""The real Poppy as a plant: commands become goals of its servos, their angles become states.

A robot that is switched on stands anywhere. So the driver says no joint state until it has taken the robot slowly to
its first pose; a controller that waits for states walks from there. With the torque off (`~/compliant`) it listens to
nobody, and takes the robot to the first pose again afterwards.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from dqwalk_ros.controllers import Command
from dqwalk_ros.errors import ConfigError, DqwalkError
from dqwalk_ros.model import load_model
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import STEADY, THROTTLE, WalkNode
from dqwalk_ros.nodes.inputs import VELOCITY, CommandInput
from dqwalk_ros.plants.poppy import Health, PoppyPlant

__all__ = ["PoppyDriver"]

_COOLER = 5.0
"""A robot that got too hot holds still until it is this much cooler [K]."""


class PoppyDriver(WalkNode):
    """Drive a real Poppy Humanoid through pypot; poppy.dummy:=true tries it without one.

    Subscribes to::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]

    Publishes::

        joint_states             sensor_msgs/JointState of all 25 motors, once the first pose is reached
        joint_goals              sensor_msgs/JointState: the angles they were told with that state [rad]
        /diagnostics             temperature, voltage and load of every motor

    Services::

        ~/compliant              std_srvs/SetBool: true switches the torque off, false on again

    Sections of the schema: dt, robot, plant, poppy.

    Example::

        dqwalk_poppy_driver --ros-args --params-file config/paper.yaml -p dt:=0.02 -p poppy.dummy:=true

    Raises
    ------
    ConfigError
        In lockstep, or where the control period is shorter than the bus's.
    PlantError
        If the motors do not answer.
    """

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("poppy_driver", options, **keywords)
        config = self.config
        self._period = 1.0 / config.poppy.rate
        if config.plant.lockstep:
            raise ConfigError("'plant.lockstep' must be false: a robot does not wait for its command")
        if config.dt < 0.99 * self._period:
            raise ConfigError(
                f"'dt' is {config.dt:g} s, and the motors answer every {self._period:g} s (poppy.rate): "
                f"set dt: {self._period:g}, as config/plants/poppy.yaml does"
            )
        model = load_model(config.robot)
        self._plant = PoppyPlant(model, config.poppy)
        self._commands = CommandInput(self, model)
        self._state_msg = ros.JointWriter(self._plant.names)
        self._goal_msg = ros.JointWriter(self._plant.names)
        self._hardware = f"{model.name}{' (dummy motors)' if config.poppy.dummy else ''}"
        self._zero = np.zeros(model.n)
        self._stamp = -1
        self._q = self._plant.q
        self._stepped = time.monotonic()
        self._counts = {"ticks": 0, "periods missed": 0}
        self._left = 0.0
        self._lag = np.zeros(len(self._plant.names))  # largest since it was told last [rad]
        self._too_hot = False
        self._states = self.advertise("joint_states")
        self._goals = self.create_publisher(JointState, "joint_goals", ros.stream(10))
        self.create_subscription(JointState, VELOCITY, self._on_command, ros.stream(1))
        self.create_service(SetBool, "~/compliant", self._set_compliant)
        self.create_timer(self._period, self._on_period, clock=STEADY)
        self.create_timer(1.0 / config.monitor.rate, self._diagnose, clock=STEADY)
        self._commands.forbid("on the way to the first pose")
        self._plant.set_compliant(False)
        self.get_logger().info(f"{self._hardware}: {len(self._plant.names)} motors at {config.poppy.rate:g} Hz")

    def _on_command(self, msg: JointState) -> None:
        self._commands.take(msg, self._stamp)

    def _on_period(self) -> None:
        """Move for the time that has passed, two periods at most: a late tick is never made up for."""
        now = time.monotonic()
        passed, self._stepped = now - self._stepped, now
        if passed > 2.0 * self._period:
            self._counts["periods missed"] += int(passed / self._period) - 1
        dt = min(passed, 2.0 * self._period)
        told = self._plant.goal
        try:
            if self._plant.ready or self._plant.compliant:
                u = self._commands.gate.velocity(self._plant.state.q, dt)
                self._plant.step(Command(self._stamp * 1e-9, u), dt)
                self._commands.log_motion()
            else:
                self._approach(dt)
            self._publish(passed, told)
        except DqwalkError as error:
            self.get_logger().error(f"the robot failed: {error}")
            self.stop(1)

    def _approach(self, dt: float) -> None:
        self._left = self._plant.approach(dt)
        if self._plant.ready:
            self._commands.gate.hold()
            self._commands.forbid("")
            self.get_logger().info("in the first pose")
        else:
            self.get_logger().info(f"on the way to the first pose: {self._left:.2f} rad left", **THROTTLE)

    def _publish(self, passed: float, told: NDArray[np.float64]) -> None:
        """Say where the joints are; `told` are the goals that they had since the last time."""
        q, before = self._plant.q, self._q
        self._q = q
        self._counts["ticks"] += 1
        if self._plant.ready:
            self._stamp = self.get_clock().now().nanoseconds
            velocity = (q - before) / max(passed, 1e-3)
            self._states.publish(self._state_msg(self._stamp, position=q, velocity=velocity))
            self._goals.publish(self._goal_msg(self._stamp, position=self._plant.goal))
            self._lag = np.maximum(self._lag, np.abs(q - told))

    def _set_compliant(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self._commands.forbid("the torque is off")
            self._plant.set_compliant(request.data)
            if not request.data:
                self._commands.forbid("on the way to the first pose")
        except DqwalkError as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = "the torque is off" if request.data else "the torque is on: moving to the first pose, slowly"
        self.get_logger().info(response.message)
        return response

    # ------------------------------------------------------------------ health

    def _watch_heat(self, health: Health) -> None:
        """Hold still while a motor is too hot; its own firmware would go limp, which is worse."""
        name, hottest = health.hottest
        hot = self.config.poppy.hot
        if self._too_hot != (hottest > (hot - _COOLER if self._too_hot else hot)):
            self._too_hot = not self._too_hot
            self._commands.forbid(f"{name} is at {hottest:.0f} degC, too hot" if self._too_hot else "")

    def _diagnose(self) -> None:
        health = self._plant.health
        if self._plant.ready:
            self._watch_heat(health)
        level, text = self._commands.level()
        if not self._plant.ready and not self._plant.compliant:
            level, text = "WARN", f"on the way to the first pose: {self._left:.2f} rad left"
        name, hottest = health.hottest
        values = {**self._counts, **self._commands.counts(), "hottest motor": name, "hottest temperature": hottest}
        i = int(self._lag.argmax())
        values |= {"lagging joint": self._plant.names[i], "lag": float(self._lag[i])}
        self._lag[:] = 0.0
        stamp = max(self._stamp, 0)
        self.diagnose("plant", self._hardware, level, text, values, stamp)
        each: dict[str, object] = {}
        for joint in self._plant.names:
            each[f"temperature/{joint}"] = health.temperature[joint]
            each[f"voltage/{joint}"] = health.voltage[joint]
            each[f"load/{joint}"] = health.load[joint]
        hot = "ERROR" if self._too_hot else "OK"
        self.diagnose("motors", self._hardware, hot, f"{name} is hottest, {hottest:.0f} degC", each, stamp)

    def close(self) -> None:
        """Hold, or go limp where that is asked for, and let go of the buses."""
        self._plant.close()
