"""Base class of the controller nodes: checks each state, computes a command, stops the robot on a fault.

A subclass defines the command. Faults of a state, of the plant that publishes it, and of the command are handled here.
"""

from __future__ import annotations

import argparse
import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from dqwalk_ros.config import to_yaml
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.publishers import DuplicateStates
from dqwalk_ros.nodes.state_gate import StateGate
from dqwalk_ros.nodes.watchdog import FaultCounter
from dqwalk_ros.paper.state import Command
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.support import provenance
from dqwalk_ros.support.errors import DqwalkError, QPError, StateError
from dqwalk_ros.support.wording import listed

Fields = dict[str, Any]
"""A command: values (n,) by the field of JointState."""

_PERIODS = 50
"""Number of periods from which the rate of the states is computed."""
_MIN_PERIODS = 10
"""Fewest periods from which it is computed."""
_RATE_TOLERANCE, _MAX_PERIOD, _CONTINUES = 0.2, 2.5, 1.5
"""Relative error of the period above which a warning is logged; period, in units of dt, above which the robot must
stand still, because each command would move it too far, and below which the walk continues."""


class AnsweringNode(WalkNode):
    """A controller node: answers each valid state with a command, and stops the robot on a fault.

    In real time the stop command is sent once; in lockstep the plant does not move without a command.
    """

    gate: type[StateGate] = StateGate
    """Decides which states are accepted."""
    field, stopping = "velocity", "zero velocity"
    """Field of a command that is zero when the robot stops, and the name of that command in log messages."""
    states = "joint_states"
    """Name of the states in log messages."""
    awaited: tuple[str, ...] = ("joint_states",)
    """Topics of which a state consists."""
    what = "walk"
    """Name of the status on /diagnostics."""

    def __init__(self, name: str, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__(name, options, **keywords)
        config = self.config
        self._model = load_model(config.robot)
        self._reader = ros.JointReader(self._model.joint_names)
        self._command_msg = ros.JointWriter(self._model.joint_names)
        self._commands = self.advertise(self.claims)
        self._still: Fields = {self.field: np.zeros(self._model.n)}
        self._sent = self._still  # the last command
        self._problem = ""
        self._stamp = -1  # of the last state answered [ns]
        self._accepted = -1  # stamp of the last state accepted [ns]
        self._periods: deque[float] = deque(maxlen=_PERIODS)  # between states [s]
        self._gate = self.gate(
            self._model,
            config.dt,
            lambda: self.config.plant.command_timeout,
            outside=config.safety.outside,
            jumps=config.safety.jumps,
            by_stamp=self.lockstep,
            clock=self.steady,
        )
        self._failures = FaultCounter(config.safety.failures)
        self._plants = DuplicateStates(config.dt)
        self._duplicates = self._slow = ""  # why the robot stands still for now
        self._others = self._waiting = ""  # of the states before the first one, and what was logged of them
        self._stale = False
        self._ticks = self._rejected = self._steps = 0
        self._diagnosed = -float("inf")  # [s]
        self.create_timer(0.02, self._check_timeout)
        self.create_timer(0.25, self._check_plants)

    def _publish_description(self) -> Publisher:
        """Publish configuration, versions and robot, also for late subscribers; return the publisher of the first."""
        texts = {"walk_config": to_yaml(self.config), "walk_origin": provenance.to_text(provenance.here())}
        if self.config.node.robot_description:
            texts["robot_description"] = self._model.urdf
        publishers = {name: self.advertise(name) for name in texts}
        for name, text in texts.items():
            publishers[name].publish(String(data=text))
        return publishers["walk_config"]

    # ------------------------------------------------------------------ defined by each controller

    @property
    def _is_walking(self) -> bool:
        """Whether the walk is under way; otherwise the robot stands still."""
        raise NotImplementedError

    @property
    def _may_hold(self) -> bool:
        """Whether the robot may stand still now, and the walk continue later."""
        return False

    def _fail(self, reason: str) -> None:
        """End the walk as failed."""
        self._problem = reason

    def _done(self) -> None:
        """Log and publish how the walk ended; called once."""
        raise NotImplementedError

    def _condition(self) -> tuple[str, str, dict[str, object]]:
        """Return level, message and values for /diagnostics of a walk without a problem."""
        raise NotImplementedError

    # ------------------------------------------------------------------ states

    def _reject(self, error: StateError) -> None:
        """Log and count a state that was rejected; nothing else changes."""
        self._rejected += 1
        self.get_logger().error(f"{self.states} rejected ({self._rejected} so far): {error}", **throttled())
        if self._gate.fault and self._is_walking:
            self._end(self._gate.fault)
        elif self._is_time_to_diagnose():
            self._diagnose("ERROR", self._problem or f"{self.states} rejected: {error}")  # the cause of a fall stays

    def _names_none(self, msg: JointState) -> bool:
        """Return whether a message has no joint of the robot; before the first state it says so."""
        if not self._reader.is_foreign(msg):
            return False
        if self._accepted < 0:
            have = listed(self._model.joint_names)
            self._others = f"{self.states} name none of its joints: they name {listed(msg.name)}; it has {have}"
            self.get_logger().warning(self._others, **throttled(10.0))
        return True

    def _is_new(self, stamp: int) -> bool:
        if self.lockstep:
            if stamp == self._stamp:  # published again: the command was lost
                self._publish_command()
            elif stamp < self._stamp:
                self.get_logger().error(
                    f"the plant restarted at {stamp * 1e-9:.3f} s, this walk is at {self._stamp * 1e-9:.3f} s: "
                    "call ~/reset",
                    **throttled(),
                )
            return stamp > self._stamp
        if not self._gate.is_new(stamp):
            if stuck := self._gate.stuck:
                if not self._stale:
                    self._stale = True  # until a state is accepted
                    self._publish_zero()
                self._reject(StateError(stuck))
            return False
        return True

    def _note(self, stamp: int) -> None:
        """Store the stamp of an accepted state."""
        self._stale = False
        if wrong := self._gate.velocities.wrong.reason:
            self.get_logger().warning(wrong, once=True)
        if step := self._gate.stepped:
            self._steps += 1
            self.get_logger().warning(f"the stamps jumped by {step:+.3f} s, a clock was set; the walk continues")
        elif 0 <= self._accepted < stamp:
            self._periods.append(1e-9 * (stamp - self._accepted))
        self._accepted = stamp
        if self.lockstep and len(self._periods) < _MIN_PERIODS:
            self._check_rate()

    def _may_answer(self) -> bool:
        """Return whether the first command may be sent: with a recorder, once it has subscribed to every message."""
        if self._ticks or not self.config.node.wait_for_recorder:
            return True
        ends = self.get_subscriptions_info_by_topic(self.resolve_topic_name("joint_states"))
        return any(end.node_name == "recorder" for end in ends) and self.may_publish()

    # ------------------------------------------------------------------ answers

    def _guarded(self, step: Callable[[], Command]) -> Any | None:
        """Return the command of `step`, or None after an error; an error that is not tolerated ends the walk."""
        try:
            command = step()
        except QPError as error:
            if self._failures.fault(str(error)):
                self._fail(f"{error} ({self._failures.limit} times in a row)")
            else:
                self.get_logger().error(f"standing still for a tick: {error}", **throttled())
            return None
        except DqwalkError as error:
            self._fail(str(error))
            return None
        except Exception as error:  # an error of this package must stop the robot, too
            traceback.print_exc()
            self._fail(f"internal error: {type(error).__name__}: {error}")
            return None
        self._failures.good()
        if not (np.isfinite(command.velocity).all() and (command.effort is None or np.isfinite(command.effort).all())):
            self._fail("internal error: the command is not finite")
            return None
        return command

    def _publish_command(self) -> None:
        """Publish the last command with the stamp of the last state answered."""
        self._commands.publish(self._command_msg(self._stamp, **self._sent))

    def _end(self, reason: str) -> None:
        """End the walk as failed, and stop the robot."""
        self._fail(reason)
        self._publish_zero()
        self._done()

    def _publish_zero(self) -> None:
        if not self.lockstep and self._stamp >= 0:
            self._sent = self._still
            self._publish_command()

    def close(self) -> None:
        """Stop the robot; in lockstep the plant does not move without a command."""
        self._publish_zero()

    # ------------------------------------------------------------------ the plant

    def _check_timeout(self) -> None:
        """Stop the robot, once, if its states have timed out; in real time only, lockstep has no timeout."""
        if self._stamp < 0 and self._is_time_to_diagnose():
            self._report_waiting()
        if self.lockstep or self._stale or self._stamp < 0 or not self._gate.watchdog.silent:
            return
        self._stale = True
        self._publish_zero()
        self.get_logger().warning(f"{self.states} timed out: commanding {self.stopping}", **throttled())
        self._diagnose("STALE", f"{self.states} timed out")

    def _report_waiting(self) -> None:
        """Report why there is no state yet, and log it when it changes: topics may have other names on a robot."""
        text = f"waiting for {' and '.join(self.awaited)}"
        absent = [topic for topic in self.awaited if not ros.publishers_of(self, topic)]
        if why := self._others or (absent and f"no node publishes {' or '.join(absent)}"):
            text += f": {why}"
        self._diagnose("WARN", text)
        if text != self._waiting:
            self._waiting = text
            self.get_logger().info(text)

    def _check_plants(self) -> None:
        """Stand still while two plants publish the robot's state."""
        duplicates = self._plants.judge(ros.publishers_of(self, "joint_states"))
        log = self.get_logger()
        if duplicates != self._duplicates:
            self._duplicates = duplicates
            text = f"standing still: two plants: {duplicates}"
            log.error(text) if duplicates else log.info("one plant again: continuing")
        self._check_rate()
        if trouble := self.time_trouble():
            log.error(trouble, **throttled(10.0))
            self._diagnose("ERROR", trouble)

    def _check_rate(self) -> None:
        """Compare the period of the states with dt, for which each command is computed.

        It is the mean of the last periods without the longest third and the shortest quarter of them: a lost state
        doubles a period, and states may come in bunches.
        """
        n, dt = len(self._periods), self.config.dt
        if n < (1 if self.lockstep else _MIN_PERIODS):
            return
        period = float(np.mean(sorted(self._periods)[n // 4 : n - n // 3]))
        error = abs(period / dt - 1.0)
        text = f"joint_states arrive every {period:.4f} s, but dt is {dt:g} s: set dt to the period of the states"
        if period > 1.5 * dt:
            text += ", or, if the plant sends one every dt, run less beside this node, which misses some"
        slow = not self.lockstep and period > (_CONTINUES if self._slow else _MAX_PERIOD) * dt
        if self._is_walking and ((self.lockstep and error > 1e-3) or (slow and not (self._slow or self._may_hold))):
            self._end(text)
        elif slow and not self._slow:
            self._slow = text
            self.get_logger().error(f"standing still: {text}")
        elif self._slow and not slow:
            self._slow = ""
            self.get_logger().info(f"joint_states arrive every {period:.4f} s again: continuing")
        elif error > _RATE_TOLERANCE and n == _PERIODS:
            self.get_logger().warning(text, **throttled(30.0))

    # ------------------------------------------------------------------ diagnostics

    def _diagnose(self, level: str = "", message: str = "") -> None:
        """Publish diagnostics; without a level, those of the walk."""
        self._diagnosed = self.steady()
        of_walk, text, values = self._condition()
        if not level:
            plants = f"two plants: {self._duplicates}" if self._duplicates else ""
            trouble = self._problem or plants or self._slow or self.time_trouble()
            level, message = "ERROR" if trouble or self._failures.count else of_walk, trouble or text
        counts = {"ticks": self._ticks, "states rejected": self._rejected, "states overtaken": self._gate.overtaken}
        values = {**counts, "clock steps": self._steps, **values}
        self.diagnose(self.what, self._model.name, level, message, values, max(self._stamp, 0))

    def _is_time_to_diagnose(self) -> bool:
        return self.steady() - self._diagnosed >= 1.0 / self.config.monitor.rate
