"""What every simulated plant does as a node, whatever it simulates: take commands, move, publish states.

In lockstep it publishes a state, waits for the command with that very stamp, moves, publishes the next: a run is
exact and as fast as the machine. In real time it publishes at 1/dt whatever comes, as hardware does.
"""

from __future__ import annotations

import time
from typing import Any

from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState

from dqwalk_ros.config import Config
from dqwalk_ros.controllers import Command
from dqwalk_ros.errors import DqwalkError
from dqwalk_ros.model import RobotModel, load_model
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.commands import Commands
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Worker
from dqwalk_ros.plants import Plant
from dqwalk_ros.safety import clamp_velocity

__all__ = ["SimulatedPlant"]

_ASK_AGAIN = 0.5
"""A lockstep state without an answer is published again after this long [s]: its command may have been lost."""
_FIRST_ASK = 0.05
"""The same before the first answer [s], while the controller may not be up yet."""


class SimulatedPlant(Worker):
    """joint_velocity_commands -> joint_states; each plant says what it simulates.

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
        self._report = options.child
        config = self._parameters.config
        self._model = model = load_model(config.robot)
        self._dt, self._lockstep = config.dt, config.plant.lockstep
        self.last_words = LAST_WORDS[self._lockstep]
        self._plant = self.make_plant(config, model)
        self._commands = Commands(node, model, self._parameters)
        self._state_msg = ros.JointWriter(model.joint_names)

        self._stamp = 0  # of the state published last [ns]
        self._asked = time.monotonic()
        self._stepped = time.monotonic()
        self._counts: dict[str, object] = {}
        self._ticks = self._missed = 0

        self._streams: dict[str, Publisher] = {"joint_states": ros.publisher(node, "joint_states")}
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

    # ------------------------------------------------------------------ what a plant says of itself

    def make_plant(self, config: Config, model: RobotModel) -> Plant:
        """Return what is simulated."""
        raise NotImplementedError

    def reference(self) -> NDArray[Any]:
        """Return the angles (n,) from which a velocity moves the joints [rad]: limits are kept from there."""
        return self._plant.state.q

    def period(self, passed: float) -> float:
        """Return the time to move in real time when `passed` has gone by since the last tick [s].

        Two periods at most: a late tick is never made up for.
        """
        return min(passed, 2.0 * self._dt)

    def real_time(self) -> int:
        """Return the stamp of a state in real time [ns]."""
        return int(self.node.get_clock().now().nanoseconds)

    def publish(self) -> None:
        """Publish the state and whatever belongs to it."""
        state = self._plant.state
        self._streams["joint_states"].publish(self._state_msg(self._stamp, position=state.q, velocity=state.dq))

    def trouble(self) -> str:
        """Return what is wrong with the plant, which is an error; empty if nothing is."""
        return ""

    # ------------------------------------------------------------------ lockstep

    def _on_command_lockstep(self, msg: JointState) -> None:
        gate = self._commands.gate
        if ros.nanoseconds(msg.header.stamp) != self._stamp:
            gate.late += 1  # the answer to a state that was asked for twice
            return
        command = self._commands.checked(msg)
        if command is None or not gate.accept(self._stamp, command.velocity, self._stamp, command.effort):
            return
        if gate.refused:
            return
        u = clamp_velocity(command.velocity, self.reference(), self._model, self._dt)
        if self._move(Command(self._stamp * 1e-9, u, command.effort), self._dt):
            self._stamp = round(self._ticks * self._dt * 1e9)
            self._asked = time.monotonic()
            self.publish()

    def _ask(self) -> None:
        """Publish the state again where no answer came."""
        now = time.monotonic()
        if now - self._asked < (_ASK_AGAIN if self._ticks else _FIRST_ASK) or not self._may_begin():
            return
        self._asked = now
        self.publish()

    def _may_begin(self) -> bool:
        """Tell whether everyone listens who must not miss the first state."""
        if self._ticks:
            return True
        wanted, states = self._parameters.config.node, self._streams["joint_states"]
        if wanted.wait_for_monitor and not ros.is_heard_by(self.node, states, "phase_monitor"):
            return False
        recorded = self._streams.values() if wanted.wait_for_recorder else ()
        return all(ros.is_heard_by(self.node, offered, "recorder") for offered in recorded)

    # ------------------------------------------------------------------ real time

    def _on_command(self, msg: JointState) -> None:
        self._commands.take(msg, self._stamp)

    def _on_period(self) -> None:
        now = time.monotonic()
        passed, self._stepped = now - self._stepped, now
        if passed > 2.0 * self._dt:
            self._missed += int(passed / self._dt) - 1
        self._commands.note_motion()
        dt, gate = self.period(passed), self._commands.gate
        u = gate.velocity(self.reference(), dt)
        if self._move(Command(self._stamp * 1e-9, u, gate.effort), dt):
            self._stamp = self.real_time()
            self.publish()

    # ------------------------------------------------------------------ both

    def _move(self, command: Command, dt: float) -> bool:
        try:
            self._plant.step(command, dt)
        except DqwalkError as error:
            self._end(f"the plant failed: {error}")
            return False
        self._ticks += 1
        return True

    def _diagnose(self) -> None:
        level, text = self._commands.level()
        if self._lockstep and level == "WARN":
            waits = self._commands.gate.watchdog.age
            level, text = ("OK", "lockstep") if waits < 2.0 else ("WARN", "waiting for a command")
        if trouble := self.trouble():
            level, text = "ERROR", trouble
        values = {"ticks": self._ticks, "periods missed": self._missed, **self._counts, **self._commands.counts()}
        entry_ = ros.status(f"{self.node.get_name()}: plant", self._model.name, level, text, values)
        self._diagnostics.publish(ros.diagnostics(self._stamp, entry_))

    def _end(self, why: str) -> None:
        self.node.get_logger().error(why)
        self.life.end(1)
