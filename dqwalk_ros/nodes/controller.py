"""The walk as a node: a state comes in, a command goes out.

The node knows nothing of time: in lockstep and in real time alike it answers the state it gets. What it adds to the
core's `Controller` is what a robot needs around it: start, pause and reset, zeros when anything is wrong, and the
topics that say what is going on.
"""

from __future__ import annotations

import enum
import sys
import time
import traceback
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dqwalk_ros import origin
from dqwalk_ros.config import to_yaml
from dqwalk_ros.controllers import Command, State, make_controller, warm_up
from dqwalk_ros.errors import DqwalkError, QPError, StateError
from dqwalk_ros.gait import way
from dqwalk_ros.model import load_model
from dqwalk_ros.nodes import entry
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.inertial import InertialSensor
from dqwalk_ros.nodes.odometry import Odometry
from dqwalk_ros.nodes.parameters import Parameters
from dqwalk_ros.nodes.phase_log import phase_messages
from dqwalk_ros.nodes.runtime import LAST_WORDS, STEADY, Life, Throttle, Worker, run, say
from dqwalk_ros.nodes.steering import Steering
from dqwalk_ros.safety import Latch, Rivals, StateGate
from dqwalk_ros.topics import FINISHED, TOPICS

__all__ = ["ControllerNode", "main"]


class Mode(enum.Enum):
    """What the controller does with a state; the value is shown on `phase` where no phase is under way."""

    IDLE = "idle"
    WALKING = "walking"
    PAUSED = "paused"
    DONE = FINISHED
    FAILED = "failed"


class ControllerNode(Worker):
    """joint_states -> joint_velocity_commands.

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
        self._model = load_model(config.robot)
        warm_up(config, self._model)
        self._controller = make_controller(config, self._model)
        self._lockstep, self._dt = config.plant.lockstep, config.dt
        self.last_words = LAST_WORDS[self._lockstep]
        self._mode = Mode.WALKING if config.node.autostart else Mode.IDLE
        self._problem = ""
        self._report = options.child

        self._reader = ros.JointReader(self._model.joint_names)
        self._command_msg = ros.JointWriter(self._model.joint_names)
        self._still = self._said = Command(0.0, np.zeros(self._model.n))
        self._stamp = self._stamp0 = -1  # of the last and the first state answered [ns]
        safety = config.safety
        self._gate = StateGate(
            self._model,
            config.dt,
            lambda: self._parameters.config.plant.command_timeout,
            outside=safety.outside,
            jumps=safety.jumps,
            by_stamp=self._lockstep,
        )
        self._failures = Latch(safety.failures)
        self._plants = Rivals()
        self._rivals = ""
        self._stale = False
        self._ticks = self._rejected = self._ignored = 0
        self._phase_index = -1
        self._compute_time = 0.0  # from the last state in to its command out [s]

        self._pub = {name: ros.publisher(node, name) for name in TOPICS if TOPICS[name].source in ("controller", "all")}
        self._odometry = Odometry(node, self._pub["base_pose"])
        self._pub["walk_config"].publish(String(data=to_yaml(config)))
        self._pub["walk_origin"].publish(String(data=origin.to_text(origin.here())))
        self._pub["robot_description"].publish(String(data=self._model.urdf))
        self._say_phase()

        # Only the newest state counts, and a late one is worthless, except in lockstep, where each counts.
        node.create_subscription(JointState, "joint_states", self._on_state, ros.stream(1, reliable=self._lockstep))
        self._sensor = self._make_sensor() if config.plant.imu else None
        steered = config.gait.style == "standing" and not config.gait.steps
        self._steering = Steering(node, config, self._controller) if steered else None
        for name in ("start", "pause", "stop", "reset"):
            node.create_service(Trigger, f"~/{name}", getattr(self, f"_{name}"))
        node.create_timer(0.02, self._watch, clock=STEADY)
        self._diagnose_now = Throttle(1.0 / config.monitor.rate)
        self._warn_now = Throttle(2.0)
        self._report_now = Throttle(0.5)
        self._look_now = Throttle(0.25)
        node.get_logger().info(
            f"{self._model.name}: {self._model.n} joints, {way(config)}, "
            f"{'lockstep' if self._lockstep else f'real time, dt {config.dt} s'}, {self._mode.value}"
        )

    def _make_sensor(self) -> InertialSensor:
        return InertialSensor(
            self.node,
            lockstep=self._lockstep,
            timeout=lambda: self._parameters.config.plant.command_timeout,
            again=self._on_state,
        )

    # ------------------------------------------------------------------ the loop

    def _on_state(self, msg: JointState) -> None:
        began = time.perf_counter()
        stamp = ros.nanoseconds(msg.header.stamp)
        try:
            state: State | None = self._reader.state(msg)
            if state is not None and self._sensor is not None:
                state = self._sensor.joined(msg, state)
            if state is None or not self._is_new(stamp):
                return
            self._gate.accept(stamp, state.q)
        except StateError as error:
            self._reject(error)
            return
        self._stale = False
        if not self._may_answer():
            return
        before = self._mode
        if self._mode is Mode.WALKING and not self._rivals:
            answer: Command | None = self._step(state, stamp)
        elif self._lockstep:
            answer = None  # no answer: simulated time stands still
        else:
            answer = self._still
        if answer is not None:
            self._stamp, self._said = stamp, answer
            self._publish_command()
            self._compute_time = time.perf_counter() - began
            self._ticks += 1
            if self._phase_index >= 0:
                self._odometry.publish(stamp, self._controller)
        if self._mode is not before:
            self._done()
        elif self._diagnose_now():
            self._diagnose()
        self._report_progress()

    def _reject(self, error: StateError) -> None:
        """Note a state that cannot be used; it has changed nothing."""
        self._rejected += 1
        if self._warn_now():
            self.node.get_logger().error(f"joint_states rejected ({self._rejected} so far): {error}")
        if self._gate.jumped and self._mode is Mode.WALKING:
            self._said = self._fail(self._gate.jumped.reason)
            self._publish_zero()
            self._done()
        else:
            self._diagnose("ERROR", f"joint_states rejected: {error}")

    def _is_new(self, stamp: int) -> bool:
        if stamp > self._stamp:
            return True
        if self._lockstep:
            if stamp == self._stamp:  # the plant asks again: our answer was lost
                self._publish_command()
            elif self._warn_now():
                self.node.get_logger().error(
                    f"the plant began again at {stamp * 1e-9:.3f} s, this walk is at {self._stamp * 1e-9:.3f} s: "
                    "call ~/reset"
                )
            return False
        # An older state has been overtaken, unless nothing newer comes: then the plant's clock was set back.
        if not self._gate.watchdog.silent:
            self._ignored += 1
            return False
        self.node.get_logger().warning(f"the stamps went back by {(self._stamp - stamp) * 1e-9:.3f} s")
        return True

    def _may_answer(self) -> bool:
        """Hold the first answer of a recorded walk until nothing of it can be lost."""
        if self._ticks or not self._parameters.config.node.wait_for_recorder:
            return True
        streams = ("joint_velocity_commands", "base_pose")
        return all(ros.is_heard_by(self.node, self._pub[name], "recorder") for name in streams)

    def _step(self, state: State, stamp: int) -> Command:
        """Return the answer; whatever goes wrong, zeros."""
        try:
            if self._steering is not None:
                self._steering.apply()
            command = self._controller.step(state, self._dt)
            self._failures.good()
        except QPError as error:
            if self._failures.fault(str(error)):
                return self._fail(f"{error} ({self._failures.limit} times in a row)")
            if self._warn_now():
                self.node.get_logger().error(f"standing still for a tick: {error}")
            return self._still
        except DqwalkError as error:
            return self._fail(str(error))
        except Exception as error:  # a fault of ours must stop the robot like any other
            traceback.print_exc()
            return self._fail(f"internal error: {type(error).__name__}: {error}")
        if not np.isfinite(command.velocity).all():
            return self._fail("internal error: the controller's answer is not finite")
        if self._stamp0 < 0:
            self._stamp0 = stamp
        if self._controller.phase_index != self._phase_index:
            self._phase_index = self._controller.phase_index
            self._publish_phase(stamp)
        if self._controller.finished:
            self._mode = Mode.DONE
            return self._still
        return command

    def _fail(self, reason: str) -> Command:
        self._mode, self._problem = Mode.FAILED, reason
        return self._still

    def _done(self) -> None:
        """Say once how the walk ended."""
        self._say_phase()
        if self._mode is Mode.DONE:
            self.node.get_logger().info(f"the walk is over after {self._ticks} ticks")
        else:
            self.node.get_logger().error(f"the walk failed; holding still: {self._problem}")
        self._diagnose()
        self._report_progress(final=True)
        if self._parameters.config.node.exit_when_done:
            self.life.end(0 if self._mode is Mode.DONE else 1)

    def _watch(self) -> None:
        """Answer a plant that fell silent with zeros, once (real time only: in lockstep it may take its time)."""
        if self._look_now():
            self._look()
        if self._lockstep or self._stale or self._stamp < 0:
            return
        if self._gate.watchdog.silent:
            self._stale = True
            self._publish_zero()
            if self._warn_now():
                self.node.get_logger().warning("joint_states fell silent: commanding zero velocity")
            self._diagnose("STALE", "joint_states fell silent")

    def _look(self) -> None:
        """Stand still where two plants say where the robot is."""
        rivals = self._plants.judge(ros.others(self.node, "joint_states"))
        if rivals != self._rivals:
            self._rivals = rivals
            log = self.node.get_logger()
            log.error(f"standing still: two plants: {rivals}") if rivals else log.info("one plant again: going on")

    def _publish_zero(self) -> None:
        if not self._lockstep and self._stamp >= 0:
            self._said = self._still
            self._publish_command()

    # ------------------------------------------------------------------ services

    def _start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._mode in (Mode.IDLE, Mode.PAUSED):
            self._mode = Mode.WALKING
            self._say_phase()
            return self._answer(response, True, "walking")
        if self._mode is Mode.WALKING:
            return self._answer(response, True, "already walking")
        why = f"it failed: {self._problem}" if self._mode is Mode.FAILED else "it is over"
        return self._answer(response, False, f"this walk cannot go on, {why}; call ~/reset first")

    def _pause(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._mode is not Mode.WALKING:
            return self._answer(response, self._mode is Mode.PAUSED, f"not walking: {self._mode.value}")
        self._mode = Mode.PAUSED
        self._say_phase()
        return self._answer(response, True, "paused: holding still; ~/start goes on")

    def _stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._mode is not Mode.WALKING:
            return self._answer(response, False, f"not walking: {self._mode.value}")
        try:
            self._controller.stop()
        except DqwalkError as error:
            return self._answer(response, False, str(error))
        return self._answer(response, True, "stopping: the feet are put together after the step under way")

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._controller.reset()
        self._mode, self._problem, self._phase_index = Mode.IDLE, "", -1
        self._stamp = self._stamp0 = -1
        self._said = self._still
        self._gate.reset()
        self._failures.reset()
        self._say_phase()
        return self._answer(response, True, "the walk begins anew from where the robot stands; ~/start starts it")

    def _answer(self, response: Trigger.Response, success: bool, message: str) -> Trigger.Response:
        self.node.get_logger().info(message)
        response.success, response.message = success, message
        return response

    # ------------------------------------------------------------------ topics

    def _publish_command(self) -> None:
        msg = self._command_msg(self._stamp, velocity=self._said.velocity, effort=self._said.effort)
        self._pub["joint_velocity_commands"].publish(msg)

    def _say_phase(self) -> None:
        walking = self._mode is Mode.WALKING and self._phase_index >= 0
        name = self._controller.phase.name if walking else self._mode.value
        if name != Mode.WALKING.value:  # nothing to tell before the first state
            self._pub["phase"].publish(String(data=name))

    def _publish_phase(self, stamp: int) -> None:
        """Say where the phase began; `stamp` [ns] is that of the state, which seconds of the clock would round."""
        phase = self._controller.phase
        for name, msg in phase_messages(self._model, phase, stamp):
            self._pub[name].publish(msg)
        self._say_phase()
        self.node.get_logger().info(f"{(stamp - self._stamp0) * 1e-9:8.3f} s  phase {self._phase_index}: {phase.name}")

    def _diagnose(self, level: str = "", message: str = "") -> None:
        last = self._controller.last if self._phase_index >= 0 else None
        values: dict[str, object] = {
            "ticks": self._ticks,
            "states rejected": self._rejected,
            "states overtaken": self._ignored,
        }
        if last is not None:
            values |= {"error": last.error, "solve time": last.solve_time, "iterations": last.iterations}
            values["compute time"] = self._compute_time
            values["active rows"] = ", ".join(last.active)
        if self._steering is not None:
            values |= self._steering.values()
        if not level:
            trouble = self._problem or (f"two plants: {self._rivals}" if self._rivals else "")
            level = "ERROR" if trouble or self._failures.count else "OK"
            walking = self._mode is Mode.WALKING and self._phase_index >= 0
            message = trouble or (self._controller.phase.name if walking else self._mode.value)
        entry_ = ros.status(f"{self.node.get_name()}: walk", self._model.name, level, message, values)
        self._pub["diagnostics"].publish(ros.diagnostics(max(self._stamp, 0), entry_))

    def _report_progress(self, final: bool = False) -> None:
        if not self._report or not (final or self._report_now()):
            return
        walking = self._phase_index >= 0
        say(
            "walk",
            mode=self._mode.value,
            phase=self._controller.phase.name if walking else "",
            phase_index=self._phase_index,
            time=(self._stamp - self._stamp0) * 1e-9 if walking else 0.0,
            ticks=self._ticks,
            error=float(self._controller.last.error) if walking and self._controller.last else None,
            reason=self._problem,
        )

    def close(self) -> None:
        """Command zero velocity; in lockstep the plant stands still without an answer."""
        if self._stamp >= 0 and not self._lockstep:
            self._said = self._still
            self._publish_command()


def main(argv: list[str] | None = None) -> int:
    """Run the node; return the exit code."""
    options = entry.parse("controller", sys.argv[1:] if argv is None else argv)
    return run("controller", lambda node, life: ControllerNode(node, life, options), options)


if __name__ == "__main__":
    sys.exit(main())
