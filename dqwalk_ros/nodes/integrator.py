"""The plant that stands in for the hardware: it integrates the commanded velocities.

In lockstep it publishes a state, waits for the command with that very stamp, integrates, publishes the next: a run is
exact and as fast as the machine. In real time it publishes at 1/dt whatever comes, as hardware does.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState

from dqwalk_ros.controllers import Command
from dqwalk_ros.exceptions import DqwalkError
from dqwalk_ros.model import load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.commands import Commands
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Worker, run
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.safety import clamp_velocity

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
        self._model = model = load_model(config.robot)
        self._dt, self._lockstep = config.dt, config.plant.lockstep
        self.last_words = LAST_WORDS[self._lockstep]
        self._plant = KinematicPlant(model)
        self._commands = Commands(node, model, self._parameters)
        self._state_msg = ros.JointWriter(model.joint_names)
        self._hardware = model.name

        self._stamp = 0  # of the state published last [ns]
        self._asked = time.monotonic()
        self._stepped = time.monotonic()
        self._counts = {"ticks": 0, "periods missed": 0}

        self._states = ros.publisher(node, "joint_states")
        self._diagnostics = ros.publisher(node, "diagnostics")
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
        gate = self._commands.gate
        if ros.nanoseconds(msg.header.stamp) != self._stamp:
            gate.late += 1  # the answer to a state that was asked for twice
            return
        u = self._commands.checked(msg)
        if u is None or not gate.accept(self._stamp, u, self._stamp) or gate.refused:
            return
        u = clamp_velocity(u, self._plant.state.q, self._model, self._dt)
        try:
            self._plant.step(Command(self._stamp * 1e-9, u), self._dt)
        except DqwalkError as error:
            self._end(f"the plant failed: {error}")
            return
        self._counts["ticks"] += 1
        self._stamp = round(self._counts["ticks"] * self._dt * 1e9)
        self._asked = time.monotonic()
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
        self._commands.take(msg, self._stamp)

    def _on_period(self) -> None:
        """Move for the time that has passed, two periods at most: a late tick is never made up for."""
        now = time.monotonic()
        passed, self._stepped = now - self._stepped, now
        if passed > 2.0 * self._dt:
            self._counts["periods missed"] += int(passed / self._dt) - 1
        self._commands.note_motion()
        dt = min(passed, 2.0 * self._dt)
        try:
            self._plant.step(Command(self._stamp * 1e-9, self._commands.gate.velocity(self._plant.state.q, dt)), dt)
        except DqwalkError as error:
            self._end(f"the plant failed: {error}")
            return
        self._counts["ticks"] += 1
        self._stamp = self.node.get_clock().now().nanoseconds
        self._publish()

    # ------------------------------------------------------------------ both

    def _publish(self) -> None:
        state = self._plant.state
        self._states.publish(self._state_msg(self._stamp, position=state.q, velocity=state.dq))

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        if self._lockstep and level == "WARN":
            waits = self._commands.gate.watchdog.age
            level, text = ("OK", "lockstep") if waits < 2.0 else ("WARN", "waiting for a command")
        counts = {**self._counts, **self._commands.counts()}
        entry_ = ros.status(f"{self.node.get_name()}: plant", self._hardware, level, text, counts)
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
