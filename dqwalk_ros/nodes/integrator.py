"""The plant that stands in for the hardware: it integrates the commanded velocities.

In lockstep it publishes a state, waits for the command with that very stamp, integrates, publishes the next: a run is
exact and as fast as the machine. In real time it publishes at 1/dt whatever comes, as hardware does.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from dqwalk_ros.controllers import Command
from dqwalk_ros.exceptions import DqwalkError, StateError
from dqwalk_ros.model import load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Throttle, Worker, run
from dqwalk_ros.plants.kinematic import KinematicPlant

__all__ = ["IntegratorNode", "main"]

_ASK_AGAIN = 0.5
"""A lockstep state without an answer is published again after this long [s]: its command may have been lost."""
_FIRST_ASK = 0.05
"""The same before the first answer [s], while the controller may not be up yet."""


class IntegratorNode(Worker):
    """joint_velocity_commands -> joint_states.

    Parameters
    ----------
    node : rclpy.node.Node
    life : Life
    options : argparse.Namespace
        From `entry.parse`.
    """

    def __init__(self, node: Node, life: Life, options: Any) -> None:
        self.node, self.life = node, life
        self._parameters = Parameters(node, options.argv)
        config = self._parameters.config
        model = load_model(config.robot)
        self._dt, self._lockstep = config.dt, config.plant.lockstep
        self.last_words = LAST_WORDS[self._lockstep]
        self._plant = KinematicPlant(model)
        self._reader = ros.JointReader(model.joint_names)
        self._state_msg = ros.JointWriter(model.joint_names)
        self._hardware = model.name
        self._zero = np.zeros(model.n)

        self._stamp = 0  # of the state published last [ns]
        self._asked = time.monotonic()
        self._command = Command(time=0.0, velocity=self._zero)
        self._command_stamp = -1  # [ns]
        self._heard = -float("inf")  # when a command came last (steady clock) [s]
        self._holding = True
        self._stepped = time.monotonic()
        self._counts = {"ticks": 0, "commands rejected": 0, "commands late": 0, "periods missed": 0}

        self._states = ros.publisher(node, "joint_states")
        self._diagnostics = ros.publisher(node, "diagnostics")
        self._warn_now = Throttle(2.0)
        on_command = self._on_command_lockstep if self._lockstep else self._on_command
        node.create_subscription(JointState, "joint_velocity_commands", on_command, ros.stream(1))
        if self._lockstep:
            node.create_timer(_FIRST_ASK, self._ask, clock=STEADY)
        else:
            node.create_timer(self._dt, self._on_period, clock=STEADY)
        node.create_timer(1.0 / config.monitor.rate, self._diagnose, clock=STEADY)
        mode = "lockstep" if self._lockstep else f"real time at {1.0 / self._dt:g} Hz"
        node.get_logger().info(f"{model.name}: {model.n} joints, {mode}")

    # ------------------------------------------------------------------ lockstep

    def _on_command_lockstep(self, msg: JointState) -> None:
        stamp = ros.nanoseconds(msg.header.stamp)
        if stamp != self._stamp:
            self._counts["commands late"] += 1  # the answer to a state that was asked for twice
            return
        command = self._checked(msg)
        if command is None:
            return
        try:
            self._plant.step(command, self._dt)
        except DqwalkError as error:
            self._end(f"the plant failed: {error}")
            return
        self._counts["ticks"] += 1
        self._stamp = round(self._counts["ticks"] * self._dt * 1e9)
        self._heard = self._asked = time.monotonic()
        self._publish()

    def _ask(self) -> None:
        """Publish the state again where no answer came."""
        now = time.monotonic()
        if now - self._asked < (_ASK_AGAIN if self._counts["ticks"] else _FIRST_ASK) or not self._may_begin():
            return
        self._asked = now
        self._publish()

    def _may_begin(self) -> bool:
        """Tell whether everyone listens who must not miss the first state."""
        if self._counts["ticks"] or not self._parameters.config.node.wait_for_recorder:
            return True
        return ros.is_heard_by(self.node, self._states, "recorder")

    # ------------------------------------------------------------------ real time

    def _on_command(self, msg: JointState) -> None:
        stamp = ros.nanoseconds(msg.header.stamp)
        if stamp < self._command_stamp and not self._silent():
            self._counts["commands late"] += 1
            return
        command = self._checked(msg)
        if command is None:
            return
        self._command, self._command_stamp = command, stamp
        self._heard = time.monotonic()
        if self._holding:
            self._holding = False
            self.node.get_logger().info("commands arrive: moving")

    def _on_period(self) -> None:
        """Move for the time that has passed, two periods at most: a late tick is never made up for."""
        now = time.monotonic()
        passed, self._stepped = now - self._stepped, now
        if passed > 2.0 * self._dt:
            self._counts["periods missed"] += int(passed / self._dt) - 1
        if self._silent() and not self._holding:
            self._holding = True
            self._command = Command(time=self._command.time, velocity=self._zero)
            self.node.get_logger().warning(
                f"no command for {self._parameters.config.plant.command_timeout:g} s: holding still"
            )
        try:
            self._plant.step(self._command, min(passed, 2.0 * self._dt))
        except DqwalkError as error:
            self._end(f"the plant failed: {error}")
            return
        self._counts["ticks"] += 1
        self._stamp = self.node.get_clock().now().nanoseconds
        self._publish()

    def _silent(self) -> bool:
        return time.monotonic() - self._heard > self._parameters.config.plant.command_timeout

    # ------------------------------------------------------------------ both

    def _checked(self, msg: JointState) -> Command | None:
        """Return the command; None where it is rejected, which leaves everything as it was."""
        try:
            return self._reader.command(msg)
        except StateError as error:
            self._counts["commands rejected"] += 1
            if self._warn_now():
                count = self._counts["commands rejected"]
                self.node.get_logger().error(f"joint_velocity_commands rejected ({count} so far): {error}")
            return None

    def _publish(self) -> None:
        state = self._plant.state
        self._states.publish(self._state_msg(self._stamp, position=state.q, velocity=state.dq))

    def _diagnose(self) -> None:
        if self._lockstep:
            waits = time.monotonic() - self._asked
            level, text = ("OK", "lockstep") if waits < 2.0 else ("WARN", "waiting for a command")
        else:
            level, text = ("WARN", "holding: no commands") if self._holding else ("OK", "moving")
        if self._counts["commands rejected"]:
            level = "ERROR" if self._silent() else "WARN"
        entry_ = ros.status(f"{self.node.get_name()}: plant", self._hardware, level, text, self._counts)
        self._diagnostics.publish(ros.diagnostics(self._stamp, entry_))

    def _end(self, why: str) -> None:
        self.node.get_logger().error(why)
        self.life.end(1)


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("integrator", sys.argv[1:] if argv is None else argv)
    return run("integrator", lambda node, life: IntegratorNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
