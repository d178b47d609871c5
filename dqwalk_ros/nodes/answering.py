"""What every controller node has in common: which states it answers, and how it stops the robot.

A subclass says what an answer is; all that may go wrong with a state, with the plant that sends it and with the
answer itself is decided here.
"""

from __future__ import annotations

import argparse
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from dqwalk_ros.errors import DqwalkError, QPError, StateError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import STEADY, THROTTLE, WalkNode
from dqwalk_ros.nodes.safety import DuplicateStates, FaultCounter, StateGate
from dqwalk_ros.robot import load_model

__all__ = ["AnsweringNode"]

_PERIODS = 50
"""Periods over which the rate of the states is judged."""
_FEW = 10
"""So many must be known before a rate is judged."""
_OFF, _SLOW = 0.2, 2.5
"""States that come at another rate than 1/dt by more than this part are a warning; states so many times slower end
the walk: each command moves the robot too far."""


class AnsweringNode(WalkNode):
    """A controller: answers each measured state that can be used, and stops the robot where anything is wrong.

    In real time a command that stops the robot is sent once; in lockstep the plant stands still without an answer.

    Parameters
    ----------
    name : str
    options : argparse.Namespace
    gate : type of StateGate
        Decides which states may be answered.
    states : str
        What the states are called in messages.
    stopping : str
        What stops the robot, for messages.
    """

    _commands: Publisher
    _still: Any
    """The command that stops the robot."""
    _sent: Any
    """The command sent last."""

    def __init__(
        self,
        name: str,
        options: argparse.Namespace,
        *,
        gate: type[StateGate] = StateGate,
        states: str = "joint_states",
        stopping: str = "zero velocity",
        **keywords: Any,
    ) -> None:
        super().__init__(name, options, **keywords)
        config = self.config
        self._states, self._awaited, self._stopping = states, states, stopping
        self._model = load_model(config.robot)
        self._reader = ros.JointReader(self._model.joint_names)
        self._command_msg = ros.JointWriter(self._model.joint_names)
        self._problem = ""
        self._stamp = -1  # of the last state answered [ns]
        self._seen = -1  # stamp of the last state accepted [ns]
        self._periods: deque[float] = deque(maxlen=_PERIODS)  # between states [s]
        self._gate = gate(
            self._model,
            config.dt,
            lambda: self.config.plant.command_timeout,
            outside=config.safety.outside,
            jumps=config.safety.jumps,
            by_stamp=self.lockstep,
        )
        self._failures = FaultCounter(config.safety.failures)
        self._plants = DuplicateStates(config.dt)
        self._duplicates = ""
        self._stale = False
        self._ticks = self._rejected = 0
        self._diagnosed = -float("inf")  # steady time [s]
        self.create_timer(0.02, self._look_for_silence, clock=STEADY)
        self.create_timer(0.25, self._look_for_duplicates, clock=STEADY)

    # ------------------------------------------------------------------ what differs between controllers

    @property
    def _is_walking(self) -> bool:
        """Whether states are answered by the controller, rather than by standing still."""
        raise NotImplementedError

    def _numbers(self, command: Any) -> NDArray[np.float64]:
        """Return the numbers of a command that leave the node."""
        raise NotImplementedError

    def _publish_command(self) -> None:
        """Publish the command sent last, with the stamp of the last state answered."""
        raise NotImplementedError

    def _fail(self, reason: str) -> None:
        """Note that the walk has failed."""
        raise NotImplementedError

    def _done(self) -> None:
        """Say once how the walk ended."""
        raise NotImplementedError

    def _diagnose(self, level: str = "", message: str = "") -> None:
        """Publish diagnostics; without a level they are those of the walk."""
        raise NotImplementedError

    # ------------------------------------------------------------------ states

    def _reject(self, error: StateError) -> None:
        """Note a state that cannot be used; it has changed nothing."""
        self._rejected += 1
        self.get_logger().error(f"{self._states} rejected ({self._rejected} so far): {error}", **THROTTLE)
        if self._gate.jumped and self._is_walking:
            self._fail(self._gate.jumped.reason)
            self._publish_zero()
            self._done()
        elif self._is_time_to_diagnose():
            self._diagnose("ERROR", f"{self._states} rejected: {error}")

    def _is_new(self, stamp: int) -> bool:
        if self.lockstep:
            if stamp == self._stamp:  # the plant asks again: our answer was lost
                self._publish_command()
            elif stamp < self._stamp:
                self.get_logger().error(
                    f"the plant began again at {stamp * 1e-9:.3f} s, this walk is at {self._stamp * 1e-9:.3f} s: "
                    "call ~/reset",
                    **THROTTLE,
                )
            return stamp > self._stamp
        if not self._gate.is_new(stamp):
            return False
        if stamp < self._stamp:
            self.get_logger().warning(f"the stamps went back by {(self._stamp - stamp) * 1e-9:.3f} s")
        return True

    def _note(self, stamp: int) -> None:
        """Note the stamp of a state that was accepted."""
        self._stale = False
        if 0 <= self._seen < stamp:
            self._periods.append(1e-9 * (stamp - self._seen))
        self._seen = stamp
        if self.lockstep and len(self._periods) < _FEW:
            self._judge_rate()

    def _may_answer(self) -> bool:
        """Hold the first answer of a recorded walk until nothing of it can be lost."""
        if self._ticks or not self.config.node.wait_for_recorder:
            return True
        ends = self.get_subscriptions_info_by_topic(self.resolve_topic_name("joint_states"))
        hears_states = any(end.node_name == "recorder" for end in ends)
        return hears_states and ros.is_heard_by(self, self._commands, "recorder")

    # ------------------------------------------------------------------ answers

    def _guarded(self, step: Callable[[], Any]) -> Any | None:
        """Return the command of `step`, or None after an error; an error that cannot be passed over fails the walk."""
        try:
            command = step()
        except QPError as error:
            if self._failures.fault(str(error)):
                self._fail(f"{error} ({self._failures.limit} times in a row)")
            else:
                self.get_logger().error(f"standing still for a tick: {error}", **THROTTLE)
            return None
        except DqwalkError as error:
            self._fail(str(error))
            return None
        except Exception as error:  # a fault of ours must stop the robot like any other
            traceback.print_exc()
            self._fail(f"internal error: {type(error).__name__}: {error}")
            return None
        self._failures.good()
        if not np.isfinite(self._numbers(command)).all():
            self._fail("internal error: the controller's answer is not finite")
            return None
        return command

    def _publish_zero(self) -> None:
        if not self.lockstep and self._stamp >= 0:
            self._sent = self._still
            self._publish_command()

    def close(self) -> None:
        """Stop the robot; in lockstep the plant stands still without an answer."""
        self._publish_zero()

    # ------------------------------------------------------------------ the plant

    def _look_for_silence(self) -> None:
        """Stop a robot whose plant fell silent, once (real time only: in lockstep it may take its time)."""
        if self._stamp < 0 and self._is_time_to_diagnose():
            self._diagnose("WARN", f"waiting for {self._awaited}")
        if self.lockstep or self._stale or self._stamp < 0 or not self._gate.watchdog.silent:
            return
        self._stale = True
        self._publish_zero()
        self.get_logger().warning(f"{self._states} fell silent: commanding {self._stopping}", **THROTTLE)
        self._diagnose("STALE", f"{self._states} fell silent")

    def _look_for_duplicates(self) -> None:
        """Stand still where two plants publish the robot's state."""
        duplicates = self._plants.judge(ros.other_publishers(self, "joint_states"))
        log = self.get_logger()
        if duplicates != self._duplicates:
            self._duplicates = duplicates
            text = f"standing still: two plants: {duplicates}"
            log.error(text) if duplicates else log.info("one plant again: going on")
        self._judge_rate()
        if trouble := self.time_trouble():
            log.error(trouble, throttle_duration_sec=10.0, throttle_time_source_type=STEADY)
            self._diagnose("ERROR", trouble)

    def _judge_rate(self) -> None:
        """Look whether the states come at the rate for which the commands are made."""
        if len(self._periods) < (1 if self.lockstep else _FEW):
            return
        period, dt = float(np.percentile(self._periods, 25)), self.config.dt  # a state that was lost doubles one
        off = abs(period / dt - 1.0)
        text = f"joint_states come every {period:.4f} s, and dt is {dt:g} s: set dt to the period of the states"
        if self._is_walking and (period > _SLOW * dt or (self.lockstep and off > 1e-3)):
            self._fail(text)
            self._publish_zero()
            self._done()
        elif off > _OFF and len(self._periods) == _PERIODS:
            self.get_logger().warning(text, throttle_duration_sec=30.0, throttle_time_source_type=STEADY)

    # ------------------------------------------------------------------ what is said

    def _answer(self, response: Trigger.Response, success: bool, message: str) -> Trigger.Response:
        self.get_logger().info(message)
        response.success, response.message = success, message
        return response

    def _is_time_to_diagnose(self) -> bool:
        return time.perf_counter() - self._diagnosed >= 1.0 / self.config.monitor.rate
