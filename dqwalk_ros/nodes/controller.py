"""The walking controller as a node: it answers each measured state with a command.

The node has no clock of its own: in lockstep and in real time it answers each state on arrival. To the core's
`VelocityController` it adds start, pause and reset, zero velocity on any fault, and topics that show the progress.
"""

from __future__ import annotations

import argparse
import enum
import math
import time
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from dqwalk_ros.config import Config
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes import wheels
from dqwalk_ros.nodes.answering import AnsweringNode, Fields
from dqwalk_ros.nodes.arms import ArmInput
from dqwalk_ros.nodes.fall_watch import FallWatch
from dqwalk_ros.nodes.foot_forces import FootForces
from dqwalk_ros.nodes.footsteps import FootstepInput
from dqwalk_ros.nodes.inertial_sensor import InertialSensor
from dqwalk_ros.nodes.odometry import Odometry
from dqwalk_ros.nodes.phase_publisher import PhasePublisher
from dqwalk_ros.nodes.plant_readiness import PlantReadiness
from dqwalk_ros.nodes.publishers import FirstPublisher
from dqwalk_ros.nodes.steering import Steering
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.phase import PhaseKind
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import stands_still
from dqwalk_ros.simulation import warm_up
from dqwalk_ros.support.errors import ConfigError, DqwalkError, StateError
from dqwalk_ros.support.topics import FAILED, FALLEN, FINISHED
from dqwalk_ros.walks.stepping import SteppingWalk
from dqwalk_ros.walks.table import make_controller, walk_type

_TUNED = 1.5
"""Largest factor by which a parameter of the walk changes at once while the robot walks: Poppy's standing walk falls if
its transfer takes half of its time."""


class Mode(enum.Enum):
    """What the controller does with a state; the value is published on `phase` while no phase is under way."""

    IDLE = "idle"
    WALKING = "walking"
    PAUSED = "paused"
    DONE = FINISHED
    FAILED = FAILED
    FALLEN = FALLEN


class Controller(AnsweringNode):
    """Walk: answer each measured state with joint velocities, from one quadratic program per tick.

    Subscribes to::

        joint_states             sensor_msgs/JointState [rad, rad/s], joints matched by name
        imu                      sensor_msgs/Imu with plant.imu: roll and pitch, and angular velocity
        cmd_vel                  geometry_msgs/Twist, walk with gait.steps: 0: linear x, y, angular z
        footsteps                nav_msgs/Path of soles in odom or in a sole, walk with gait.steps: 0
        arm_trajectory           trajectory_msgs/JointTrajectory of joints of arms.joints
        left_hand_target, right_hand_target
                                 geometry_msgs/PoseStamped in odom, or in a link of the trunk
        left_foot_wrench, right_foot_wrench
                                 geometry_msgs/WrenchStamped with plant.foot_force: ground on a sole
        plant_ready              std_msgs/Bool, latched: the walk waits while this is false
        plant_warning            std_msgs/String, latched: a reason ends the walk as ~/stop does

    Publishes::

        joint_velocity_commands  sensor_msgs/JointState [rad/s]; stamp: that of the state it answers;
                                 with an imu also torques that hold the robot [N m]
        phase, support_foot      std_msgs/String, latched: current phase; at the end 'finished', 'failed' or 'fallen'
        phase_log                std_msgs/String, latched: the last hundred messages of `phase`
        phase_start              sensor_msgs/JointState, latched: joint angles at the start of the phase
        com_target, swing_target geometry_msgs/PointStamped, PoseStamped, latched, in the support sole's frame
        footstep_status          std_msgs/String, latched: 'walking 2/5', 'done 5/5', 'refused: why', 'cancelled: ...'
        odom                     nav_msgs/Odometry: pose and velocity of odometry.base_frame
        base_pose                geometry_msgs/PoseStamped: the pelvis in odom
        left_foot_load, right_foot_load
                                 geometry_msgs/WrenchStamped, from the torques of joint_states: vertical force on a sole
        /tf, /tf_static          tf2_msgs/TFMessage where tf2_msgs exists: odom, base and footprint
        walk_config              std_msgs/String, latched: all current parameters
        walk_origin              std_msgs/String, latched: versions and machine
        robot_description        std_msgs/String, latched: URDF
        /diagnostics             diagnostic_msgs/DiagnosticArray

    Services::

        ~/start ~/pause ~/reset  std_srvs/Trigger
        ~/stop                   std_srvs/Trigger: a standing or dynamic walk puts its feet together and ends

    Sections of the schema: dt, robot, gait, task, dsp, ssp, standing, dynamic, pelvis, joints, arms, collision, qp,
    servo, plant, estimation, monitor, safety, node, odometry.

    Example::

        dqwalk_controller --ros-args --params-file config/paper.yaml -p gait.step_length:=0.04
    """

    claims = "joint_velocity_commands"

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("controller", options, **keywords)
        config = self.config
        if config.plant.imu:
            self.awaited = ("joint_states", "imu")
        warm_up(config, self._model)
        self._controller = make_controller(config, self._model)
        self._mode = Mode.WALKING if config.node.autostart else Mode.IDLE
        self._began: float | None = None  # time of the first state answered [s]
        self._ended_for = ""  # the plant's warning that has ended the walk
        self._pausing = False  # the walk comes to a rest, where it is paused
        self._falls = FallWatch(
            config,
            self._model,
            lambda: self.config.plant.command_timeout,
            lockstep=self.lockstep,
            may_hold=lambda: self._may_hold,
        )
        self._compute_time = 0.0  # from the last state in to its command out [s]
        self._reported = -float("inf")  # steady time [s]

        self._phases = PhasePublisher(self, self._model, self._publish_description())
        self._odometry = Odometry(self, self._model)
        self._load_topics = [self.advertise(f"{foot.value}_foot_load") for foot in Foot]
        self._first_base: Foot | None = None  # its sole is the frame odom
        self._show_phase()

        self._source = FirstPublisher(lambda: self.config.plant.command_timeout, self.steady)
        # In real time only the newest state is of use; in lockstep every state must arrive.
        self.listen(
            JointState, "joint_states", wheels.numbered(self._on_state), 1 if self.lockstep else ros.best_effort(1)
        )
        self._plant = PlantReadiness(self, self._end_in_a_stance)
        self._imu = (
            InertialSensor(self, self._model.imu_link, self._gate.inertial, self._take) if config.plant.imu else None
        )
        self._feet = FootForces(self) if config.plant.foot_force else None
        steered = not walk_type(config).phases(config)
        self._steering = Steering(self, self._controller) if steered else None
        self._footsteps = FootstepInput(self, self._controller, self._odometry) if steered else None
        moves_arms = isinstance(self._controller.walk, SteppingWalk) and self._controller.walk.arms is not None
        self._arms = ArmInput(self, self._controller, self._odometry, self._gate.time_of) if moves_arms else None
        if self._arms is not None:
            self._falls.gives_up = self._arms.give_up
        self.offer("~/start", self._start)
        self.offer("~/pause", self._pause)
        self.offer("~/stop", self._stop)
        self.offer("~/reset", self._reset)
        self.get_logger().info(
            f"{self._model.name}: {self._model.n} joints, {walk_type(config).describe(config)}, "
            f"{'lockstep' if self.lockstep else f'real time, dt {config.dt} s'}, {self._mode.value}"
        )

    # ------------------------------------------------------------------ the loop

    def _on_state(self, msg: JointState, number: int) -> None:
        if self._names_none(msg):
            return
        self._plants.note(msg.name, ros.nanoseconds(msg.header.stamp))
        of_one = self.lockstep or not self._reader.is_whole(msg)
        if of_one or not self._source.is_another(number):
            self._take(msg)

    def _take(self, msg: JointState) -> None:
        """Answer a state if it is accepted; one that has waited for its imu message comes here twice."""
        began = time.perf_counter()
        stamp = ros.nanoseconds(msg.header.stamp)
        state = self._checked(msg, stamp)
        if state is None or not self._may_answer():
            return
        before = self._mode
        self._look_for_motion_while_not_ready(state)
        ready = self._is_executed
        self._look_for_contradictions(state, ready)
        if self._mode is Mode.WALKING and ready and not self._falls.suspected:
            answer: Fields | None = self._step(state, stamp)
        elif self.lockstep:
            answer = None  # no answer: simulated time stands still
        else:
            answer = self._still
        if answer is not None:
            self._stamp, self._sent = stamp, answer
            self._publish_command()
            self._compute_time = time.perf_counter() - began
            self._ticks += 1
            self._publish_odometry(stamp, state)
            self._publish_loads(stamp)
        if self._mode is not before and self._mode is not Mode.PAUSED:
            self._done()
        elif self._is_time_to_diagnose():
            self._diagnose()
        self._report_progress()

    def _checked(self, msg: JointState, stamp: int) -> State | None:
        """Return the state of a message; None if it waits for its imu message, is old, or is rejected."""
        try:
            read = self._reader.state(msg)
            state = read if self._imu is None else self._imu.join(msg, read)
            if state is None or not self._is_new(stamp):
                return None
            self._look_for_a_fall(state)
            if self._feet is not None:
                state.forces = self._feet.at(stamp)
            state = self._gate.accept(stamp, state)
        except StateError as error:
            self._reject(error)
            return None
        self._note(stamp)
        return state

    def _publish_odometry(self, stamp: int, state: State) -> None:
        """Publish the pose of the robot in the frame of the first phase, also before that phase has begun."""
        controller, both, x_base = self._controller, True, DQ(1.0)
        kin, loads = controller.kin, controller.loads
        if self._has_begun:
            phase = controller.phase
            base, both, x_base = phase.base, phase.double, DQ(controller.x_odom_base)
        else:
            base = self._first_base = self._first_base or controller.first_base(state)
        if kin is None or kin.base is not base or not np.array_equal(kin.q, state.q):  # the walk has not answered it
            kin, loads = Kinematics.measured(self._model, state.q, base, state.up), None
        self._odometry.publish(stamp, state, kin, x_base, both=both, loads=loads)

    def _publish_loads(self, stamp: int) -> None:
        """Publish the estimated loads of the feet at the last state that the walk has answered."""
        if self._controller.loads is None or self._mode is not Mode.WALKING:
            return
        for topic, foot, load in zip(self._load_topics, Foot, self._controller.loads, strict=True):
            if topic.get_subscription_count():
                force = np.array([0.0, 0.0, load, 0.0, 0.0, 0.0])
                topic.publish(ros.wrench(stamp, self._model.soles[foot].frame, force))

    @property
    def _is_executed(self) -> bool:
        """Whether the plant executes commands, and gets them."""
        return self._plant.ready and not (self._duplicates or self._slow)

    @property
    def _is_walking(self) -> bool:
        return self._mode is Mode.WALKING

    @property
    def _may_hold(self) -> bool:
        return self._controller.may_hold

    def _step(self, state: State, stamp: int) -> Fields:
        """Return the command for a state; zero velocity after an error."""

        def step() -> Command:
            if self._steering is not None:
                self._steering.apply()
            return self._controller.step(state, self.config.dt)

        command: Command | None = self._guarded(step)
        if command is None:
            return self._still
        if self._arms is not None:
            self._arms.tell()
        if self._began is None:
            self._began = state.time
        if self._phases.follow(self._controller, stamp):
            self._begin_phase(state.time - self._began)
        if self._controller.finished:
            self._mode = Mode.DONE
            return self._still
        if tips := self._falls.tips(self._controller.phase.base, self._controller.lean):
            self._mode, self._problem = Mode.FALLEN, tips
            return self._still
        if self._pausing and self._controller.may_hold:
            self._pausing, self._mode = False, Mode.PAUSED
            self._show_phase()
            return self._still
        return {"velocity": command.velocity, "effort": command.effort}

    def _look_for_a_fall(self, state: State) -> None:
        """End the walk if the pelvis leans too far."""
        lying = self._falls.look(state.up)
        if lying and self._mode in (Mode.WALKING, Mode.PAUSED, Mode.FAILED):
            self._problem = "; ".join(filter(None, [self._problem, lying]))
            self._mode = Mode.FALLEN
            self._publish_zero()
            self._done()

    def _look_for_motion_while_not_ready(self, state: State) -> None:
        """End a walk that the plant has interrupted, if the robot was moved meanwhile."""
        begun = self._mode in (Mode.WALKING, Mode.PAUSED) and self._has_begun
        if (moved := self._plant.moved(state, begun=begun)) is not None:
            k, angle = moved
            name = self._model.joint_names[k]
            self._fail(f"{name} has moved by {angle:.2f} rad while the plant was not ready")

    def _look_for_contradictions(self, state: State, ready: bool) -> None:
        """End the walk if the measurements contradict the commands; not checked while the robot stands still."""
        if self._mode is not Mode.WALKING or not ready:
            self._falls.forget()
        elif confirmed := self._falls.compare(state, self._sent["velocity"], self._controller.lean):
            unheard = "" if ros.executing(self, self.claims) else f"; no plant subscribes to {self.claims}"
            self._fail(confirmed + unheard)

    def _fail(self, reason: str) -> None:
        super()._fail(reason)
        self._falls.forget()
        self._mode = Mode.FAILED

    def _done(self) -> None:
        """Log and publish how the walk ended; called once."""
        self._show_phase()
        self._end_footsteps()
        if self._mode is Mode.DONE:
            log, why = self.get_logger(), f": {self._ended_for}" if self._ended_for else ""
            (log.warning if why else log.info)(f"the walk is over after {self._ticks} ticks{why}")
        else:
            self.get_logger().error(f"the walk failed; holding still: {self._problem}")
        self._diagnose()
        self._report_progress(final=True)
        if self.config.node.exit_when_done:
            self.stop(0 if self._mode is Mode.DONE else 1)

    def _end_in_a_stance(self, reason: str) -> None:
        """End the walk because the plant warns: it would soon hold in mid-step. One that cannot stop is paused."""
        if self._mode is not Mode.WALKING:
            return
        try:
            self._controller.stop()
        except DqwalkError as error:
            if self.lockstep:
                self._end(f"{reason}; {error}")
            else:
                self.perform(self._pause)
            return
        self._ended_for = reason
        self.get_logger().info("stopping: after the current step the feet are put together")

    # ------------------------------------------------------------------ services

    def _start(self) -> tuple[bool, str]:
        if self._mode in (Mode.IDLE, Mode.PAUSED) or (self._mode is Mode.WALKING and self._pausing):
            if self._gate.fault:
                return False, f"{self._gate.fault}; call ~/reset first"
            if self._plant.warning:
                return False, f"the plant warns: {self._plant.warning}; an empty text on plant_warning withdraws it"
            self._controller.pause(False)
            self._mode, self._pausing = Mode.WALKING, False
            self._show_phase()
            return True, f"walking{self._once}"
        if self._mode is Mode.WALKING:
            return True, f"already walking{self._once}"
        why = "it is over" if self._mode is Mode.DONE else f"it failed: {self._problem}"
        return False, f"this walk cannot continue, {why}; call ~/reset first"

    @property
    def _once(self) -> str:
        """What has to happen before the robot moves; empty if nothing has."""
        if self._accepted < 0 or self._stale:
            return " once joint_states are accepted: /diagnostics says why they are not"
        if held := (self._duplicates and f"two plants: {self._duplicates}") or self._slow:
            return f" once this is over: {held}"
        return "" if self._plant.ready else f" once {self._plant.waits}"

    def _pause(self) -> tuple[bool, str]:
        if self._mode is not Mode.WALKING:
            return self._mode is Mode.PAUSED, f"not walking: {self._mode.value}"
        self._controller.pause(True)
        if not self._controller.may_hold:
            self._pausing = True
            return True, "pausing: it puts its feet together, then it stands; ~/start continues"
        self._mode = Mode.PAUSED
        self._show_phase()
        return True, "paused: holding still; ~/start continues"

    def _stop(self) -> tuple[bool, str]:
        if self._mode is not Mode.WALKING:
            how = "; ~/start, then ~/stop" if self._mode is Mode.PAUSED else ""
            return False, f"not walking: {self._mode.value}{how}"
        self._controller.stop()
        return True, "stopping: after the current step the feet are put together"

    def _reset(self) -> tuple[bool, str]:
        if self._falls.lying:
            return False, f"{self._falls.lying}; put it on its feet first"
        moves = self._mode is Mode.WALKING and self._has_begun and self._is_executed and not self._stale
        if moves and not (self.lockstep or self._controller.may_hold):
            return False, "it would fall in mid-step; call ~/pause first, then it stands"
        self._end_footsteps()
        self._controller.reset()
        self._odometry.restart()
        self._phases.restart()
        self._mode, self._pausing, self._first_base = Mode.IDLE, False, None
        self._problem = self._ended_for = ""
        self._stamp, self._began = -1, None
        self._sent = self._still
        self._gate.reset()
        self._falls.forget()
        self._failures.reset()
        self._show_phase()
        return True, "the next walk starts from the current posture of the robot; call ~/start"

    # ------------------------------------------------------------------ topics

    def tune(self, config: Config) -> None:
        """Apply live parameters; those of the walk take effect at the next phase, and change little by little."""
        if why := stands_still(config):
            raise ConfigError(why)
        own = ("plant.", "monitor.", "gait.cmd_vel_timeout")
        before, now = self.config.flat(), config.flat()
        changed = [name for name in now if now[name] != before[name] and not name.startswith(own)]
        for name in changed if self._is_walking and self._has_begun else ():
            was, wanted = before[name], now[name]
            if not (isinstance(was, float) and isinstance(wanted, float) and was):
                continue
            low, high = was / _TUNED, _TUNED * was
            if not low * (1.0 - 1e-9) <= wanted <= high * (1.0 + 1e-9):
                how = "set it in steps, or call ~/pause first"
                raise ConfigError(
                    f"'{name}' is {was:g}; while the robot walks it may be {low:.3g} to {high:.3g}: {how}"
                )
        if changed:
            self._controller.tune(config)

    @property
    def _has_begun(self) -> bool:
        """Whether the walk has a phase."""
        return self._began is not None

    @property
    def _label(self) -> str:
        """Name of the current phase, or of the mode."""
        return self._controller.phase.name if self._mode is Mode.WALKING and self._has_begun else self._mode.value

    def _show_phase(self) -> None:
        if self._label != Mode.WALKING.value:  # no phase is known before the first state
            self._phases.show(self._label)

    def _end_footsteps(self) -> None:
        if self._footsteps is not None and self._has_begun:
            self._footsteps.show(ended="the walk is over")

    def _begin_phase(self, elapsed: float) -> None:
        phase = self._controller.phase
        if phase.kind is PhaseKind.SINGLE_SUPPORT:
            self._odometry.note_step()
        if self._footsteps is not None:
            self._footsteps.show()
        self.get_logger().info(f"{elapsed:8.3f} s  phase {self._controller.phase_index}: {phase.name}")

    def _condition(self) -> tuple[str, str, dict[str, object]]:
        values: dict[str, object] = {}
        if self._imu is not None:
            values["imu rejected"] = self._gate.inertial.rejected
        if self._has_begun:
            now = self._controller
            values |= {"error": now.error, "solve time": now.solve_time, "iterations": now.iterations}
            values |= {"compute time": self._compute_time, "active rows": ", ".join(now.active)}
        if self._steering is not None:
            values |= self._steering.values()
        if self._arms is not None:
            values |= self._arms.values()
        drive = self._controller.predictor.watch
        if math.isfinite(drive.delay):
            values |= {"excess delay": drive.delay, "stiffness ratio": drive.stiffness}
        feet = self._feet.warning if self._feet is not None else ""
        plant = self._plant.condition(walking=self._is_walking)
        gate = self._gate.inertial.warning, self._gate.velocities.wrong.reason
        warning = "; ".join(filter(None, [plant, *drive.warnings(), *gate, feet]))
        return "WARN" if warning else "OK", warning or self._label, values

    def _report_progress(self, final: bool = False) -> None:
        now = self.steady()
        if not (final or now - self._reported > 0.5):
            return
        self._reported = now
        walking = self._has_begun
        self.report(
            mode=self._mode.value,
            phase=self._controller.phase.name if walking else "",
            phase_index=self._controller.phase_index,
            time=0.0 if self._began is None else self._gate.time_of(self._stamp) - self._began,
            ticks=self._ticks,
            error=float(self._controller.error) if walking else None,
            reason=self._problem or self._ended_for,
        )
