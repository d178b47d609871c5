"""The robot in a physics engine as a node: the integrator's topics, the inertial sensor, and what no sensor measures.

In real time the engine takes one period per tick of the steady clock, so a late machine makes a late simulation, never
one that jumps; stamps are the simulation's time, counted from the clock's at its start. How late, it says at its end.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_srvs.srv import Trigger

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.runtime import Life, run, say
from dqwalk_ros.nodes.simulated import SimulatedPlant
from dqwalk_ros.plants import Plant, make_plant
from dqwalk_ros.plants.physics import PhysicsPlant
from dqwalk_ros.topics import TOPICS, WORLD

__all__ = ["PhysicsNode", "main"]


_PUSH = 0.1
"""A push lasts so long [s], of simulated time."""


class PhysicsNode(SimulatedPlant):
    """joint_velocity_commands -> joint_states, imu, and the truth; push shoves it.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.

    Raises
    ------
    PlantError
        If MuJoCo refuses the robot.
    """

    _plant: PhysicsPlant

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        super().__init__(node, life, options)
        self._streams |= {name: ros.publisher(node, name) for name in TOPICS if TOPICS[name].source == "physics"}
        self._frames = {f"{foot.value}_foot_wrench": self._model.soles[foot].frame for foot in Foot}
        self._imu = self._parameters.config.physics.imu
        self._fell = ""
        self._late: list[float] = []  # behind a period [s], of each tick under way
        self._without = 0
        self._began = time.monotonic()
        self._stamp0 = node.get_clock().now().nanoseconds
        self._pushed_until = -1  # tick
        node.create_service(Trigger, "~/reset", self._reset)
        node.create_subscription(WrenchStamped, "push", self._on_push, ros.stream(10))

    def make_plant(self, config: Config, model: RobotModel) -> Plant:
        """Return the robot on its soles."""
        return make_plant("physics", config, model)

    def reference(self) -> NDArray[Any]:
        """Return what the servos are told: velocities are integrated from there."""
        return self._plant.commanded

    def period(self, passed: float) -> float:
        """Return one period, however late the tick is."""
        if not self._commands.gate.watchdog.silent:
            self._late.append(passed - self._dt)
        return self._dt

    def real_time(self) -> int:
        """Return the time of the simulation, counted from the clock's at its start [ns]."""
        return self._stamp0 + round(self._ticks * self._dt * 1e9)

    def publish(self) -> None:
        """Publish the sensors first, for the controller waits for them with the state."""
        stamp, streams = self._stamp, self._streams
        streams["imu"].publish(ros.imu(stamp, self._imu, self._plant.inertial))
        super().publish()
        if any(streams[name].get_subscription_count() for name in streams if name not in ("imu", "joint_states")):
            truth = self._plant.truth
            streams["true_base_pose"].publish(ros.pose(stamp, WORLD, truth.pelvis))
            for foot in Foot:
                name = f"{foot.value}_foot_wrench"
                streams[name].publish(ros.wrench(stamp, self._frames[name], truth.wrenches[foot]))
            if (cop := truth.cop) is not None:
                streams["center_of_pressure"].publish(ros.point(stamp, WORLD, cop))
        if self._plant.fallen and not self._fell:
            self._fell = f"the robot fell at {self._ticks * self._dt:.2f} s; ~/reset puts it back on its feet"
            self.node.get_logger().error(self._fell)
            if self._report:  # nobody is there to pick it up
                self.life.end(1)

    def _on_push(self, msg: WrenchStamped) -> None:
        """Take the force times one second as the impulse on the pelvis [N s], as the node `rigid` does."""
        f = msg.wrench.force
        impulse = np.array([f.x, f.y, f.z])
        if not np.isfinite(impulse).all():
            self.node.get_logger().error("push rejected: not finite")
            return
        self._plant.push(impulse / _PUSH)
        self._pushed_until = self._ticks + round(_PUSH / self._dt)
        self.node.get_logger().info(f"pushed: {f.x:g}, {f.y:g}, {f.z:g} N s within {_PUSH:g} s")

    def _move(self, command: Command, dt: float) -> bool:
        if self._ticks == self._pushed_until:
            self._plant.push(np.zeros(3))
        return super()._move(command, dt)

    def trouble(self) -> str:
        """Return that the robot has fallen."""
        return self._fell

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._lockstep:
            response.success, response.message = False, "in lockstep time cannot begin again: start the node anew"
            return response
        self._plant = self.make_plant(self._parameters.config, self._model)  # type: ignore[assignment]
        self._commands.gate.hold()
        self._fell = ""
        response.success, response.message = True, "the robot stands; the controller's ~/reset and ~/start begin anew"
        self.node.get_logger().info(response.message)
        return response

    def close(self) -> None:
        """Say how much of real time it was."""
        if self._lockstep or len(self._late) < 2:
            return
        late = 1e3 * np.array(self._late)
        took = float(late.sum()) * 1e-3 + len(late) * self._dt
        rate = len(late) / took
        text = (
            f"{len(late)} ticks at {rate:.1f} Hz, {100.0 * rate * self._dt:.1f} % of real time; late by "
            f"{np.median(late):.2f} ms (median), {np.percentile(late, 99):.1f} ms (p99), {late.max():.0f} ms at most"
        )
        self.node.get_logger().info(text)
        if self._report:
            say("pace", text=text, rate=rate, real_time=rate * self._dt)


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("physics", sys.argv[1:] if argv is None else argv)
    return run("physics", lambda node, life: PhysicsNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
