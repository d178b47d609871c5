"""The checks of `dqwalk doctor`, whether a robot is ready to walk.

Each check is a function of the configuration, the model and the messages received. It returns a text with the result,
or raises a `_Failed` that says what to do.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from dqwalk_ros.config import Config
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.doctor import Heard
from dqwalk_ros.nodes.fall_watch import FallWatch
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.foot import Foot
from dqwalk_ros.paper.geometry import angle_of
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.statics import GRAVITY
from dqwalk_ros.robot.directions import motion
from dqwalk_ros.robot.limits import outside_limits
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import VELOCITY
from dqwalk_ros.support.wording import shown

_RESTARTS = 2
"""Most restarts of a driver while the doctor listens."""
_RATE = 0.2
"""Largest relative error of the period of the states."""
_LATE = 3.0
"""Largest 99th percentile of that period, in units of dt."""
_LEVEL, _HEIGHT = math.radians(4.0), 0.012
"""Largest angle and height between the soles of a robot that stands, computed from the joint angles [rad, m]."""
_UPRIGHT = math.radians(10.0)
"""Largest inclination of the inertial sensor of a robot that stands [rad]."""
_STILL, _PULL = 0.05, 0.6
"""Largest angular velocity at rest [rad/s], and largest deviation of the acceleration from gravity [m/s^2]."""
_LEANED = 0.1
"""Least change of the vertical that tells something about the gyroscope [rad]."""
_SLOW = 0.05
"""Longest period of the inertial sensor [s]: with 0.04 s the as-built Poppy walks in MuJoCo, with 0.08 s it falls."""
_POSTURE = 0.3
"""Largest distance of a joint from the first posture of the walk [rad]."""
_MOVED = 0.05
"""Largest range of a joint's angles while the robot stands still [rad]; sensor noise and backlash are smaller."""
_BY_HAND = 0.15
"""Motion of a joint by hand from which on it is named [rad]: one that is pulled along moves less."""
_BEHIND = 3600.0
"""Largest delay of a simulation whose stamps count from the time of the clock [s]."""
_AT_REST = ("", "idle", "finished", "failed", "fallen")
"""Values of `phase` while no walk is under way; empty if it is not published."""
_WHERE = "in a file for --params and params:="
"""Where to set what the file of the plant sets, too: this file is applied after it."""


@dataclass(frozen=True)
class Result:
    """The result of a check."""

    what: str
    """Name of the check."""
    ok: bool
    text: str
    """The result; if the check failed, also what to do."""

    def __str__(self) -> str:
        return f"{'  ' if self.ok else '! '}{self.what:22s} {self.text}"


class _Failed(Exception):
    """A check has failed; the text is its result, and what to do."""


Check = Callable[[Config, RobotModel, Heard], str]


def _require_heard(heard: Heard, topic: str) -> None:
    """Raise `_Failed` if a latched topic is published, but was not heard: what is not known has not been checked."""
    if publishers := heard.unheard.get(topic):
        raise _Failed(
            f"not heard: {', '.join(publishers)} publishes {topic}, but nothing has arrived: run this command again "
            "while the machine is less busy; if that does not help, restart the node"
        )


def _check_states(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that states arrive."""
    if not heard.states:
        publishers = ", ".join(heard.publishers) or "no node"
        raise _Failed(
            f"none in {heard.seconds:g} s; publisher: {publishers}: start the driver, or the joint_state_broadcaster; "
            "check that ROS_DOMAIN_ID, namespace and ROS_AUTOMATIC_DISCOVERY_RANGE are the same here and there"
        )
    if heard.backs > _RESTARTS and len(heard.publishers) > 1:
        raise _Failed(
            f"{' and '.join(heard.publishers)} publish the same joints: stop all but one, or remap the joint_states of "
            "the others"
        )
    return f"{len(heard.states)} in {heard.seconds:g} s from {', '.join(sorted(set(heard.publishers)))}"


def _check_joint_names(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that every joint of the walk is measured."""
    reader = ros.JointReader(model.joint_names)
    for msg, _ in heard.states[:-1]:
        with contextlib.suppress(StateError):
            reader.state(msg)
    try:
        velocities = reader.state(heard.states[-1][0]).dq
    except StateError as error:
        raise _Failed(
            f"{error}: name the joints as {model.name} does, merge them into one message (joint_state_publisher with a "
            "source_list), or lock them with robot.lock"
        ) from error
    return f"all {model.n}" + (
        "; no measured velocities, so they are computed by differences" if velocities is None else ""
    )


def _check_rate(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the states arrive once per dt."""
    stamps = np.unique([ros.nanoseconds(msg.header.stamp) for msg, _ in heard.states]) * 1e-9
    if len(stamps) < 10:
        raise _Failed(f"only {len(stamps)} different stamps: the plant must give each state its own stamp")
    periods = np.diff(stamps)
    middle, late = float(np.median(periods)), float(np.percentile(periods, 99))
    text = f"{1.0 / middle:.1f} Hz, 99 % within {1e3 * late:.1f} ms"
    if abs(middle / config.dt - 1.0) > _RATE:
        raise _Failed(
            f"{text}; dt is {config.dt:g} s: set dt to {middle:.4g} {_WHERE}, or the rate of the driver to "
            f"{1 / config.dt:g}"
        )
    if late > _LATE * config.dt:
        raise _Failed(f"{text}: the bus or the machine is too slow; lower the rate and dt, give the loop a processor")
    return text


def _check_latency(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check the time between stamp and receipt of a state; the delay of the command adds to it in the loop."""
    ages = [1e-9 * (at - ros.nanoseconds(msg.header.stamp)) for msg, at in heard.states]
    middle, late = float(np.median(ages)), float(np.percentile(ages, 99))
    text = f"{1e3 * middle:.1f} ms old on arrival, 99 % within {1e3 * late:.1f} ms"
    if len({ros.nanoseconds(msg.header.stamp) for msg, _ in heard.states}) < 2:
        raise _Failed("unknown: set header.stamp to the time of the measurement, a new one for each state")
    if heard.simulated and abs(middle) > _BEHIND:
        return "unknown: the stamps of the simulation do not count from the time of the clock"
    if heard.simulated:
        return f"the simulation is {1e3 * middle:.1f} ms behind real time"
    if not -0.01 <= middle <= config.plant.command_timeout:
        raise _Failed(f"{text}: the clocks of two machines differ (chrony), or use_sim_time is wrong")
    assumed = config.servo.assumed_latency
    if middle > 0.5 * config.dt and assumed < middle:
        raise _Failed(
            f"{text}; the controller assumes {1e3 * assumed:g} ms: set servo.assumed_latency {_WHERE} to the sum of "
            "this delay and the command's"
        )
    return text


def _check_rest(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the robot stands still, and that no walk is under way."""
    _require_heard(heard, "phase")
    if heard.phase not in _AT_REST:
        raise _Failed(
            f"a walk is under way, phase is '{heard.phase}': end it (~/stop of the controller, or Ctrl-C), put the "
            "robot into its first pose, and run this command again"
        )
    if heard.moving:
        raise _Failed(
            f"{', '.join(heard.controllers) or 'a node'} publishes {VELOCITY} other than zero: stop it, and run this "
            "command again"
        )
    reader = ros.JointReader(model.joint_names)
    with contextlib.suppress(StateError):  # an invalid state is the controller's to reject
        moved = np.ptp([reader.state(msg).q for msg, _ in heard.states], axis=0)
        k = int(moved.argmax())
        if moved[k] > _MOVED:
            raise _Failed(
                f"{model.joint_names[k]} moved by {moved[k]:.2f} rad in {heard.seconds:g} s: stop whatever moves the "
                "robot, wait until it stands still, and run this command again"
            )
    return "no walk is under way"


def _check_limits(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that every joint is inside its limits."""
    if outside := outside_limits(heard.angles(model), model, 0.01):
        raise _Failed(
            f"{outside} beyond a limit: calibrate the joint, or correct its sign (poppy.calibration, the URDF)"
        )
    return "all inside"


def _check_posture(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the robot stands in the first posture of the walk."""
    off = np.abs(heard.angles(model) - model.posture(config.standing.posture))
    k = int(off.argmax())
    text = f"{model.joint_names[k]} is furthest from the first pose, {off[k]:.2f} rad"
    if off[k] > _POSTURE:
        raise _Failed(
            f"{text}: bring the robot there first (~/activate of poppy_driver; a trajectory with ros2_control)"
        )
    return text


def _check_soles(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the joint angles place both soles in one plane, as on a level floor."""
    kin = Kinematics(model, heard.angles(model), Foot.LEFT)
    x = DQ(kin.pose(kin.swing))
    height, lean = float(x.translation()[2]), angle_of(x.rotation_matrix()[2, 2])
    text = f"right sole {1e3 * height:+.1f} mm and {math.degrees(lean):.1f} deg off the left one's plane"
    if abs(height) > _HEIGHT or lean > _LEVEL:
        raise _Failed(f"{text}, computed from the joint angles: calibrate the legs with both soles flat on the floor")
    return text


def _check_inertial_sensor(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the inertial sensor is upright and at rest, in the frame of its link."""
    if not config.plant.imu:
        return "not used (plant.imu is false): no torque feedforward, and a fall is not detected"
    if not heard.imus:
        raise _Failed(
            f"nothing on imu: start the sensor's broadcaster and remap its topic, or set plant.imu: false {_WHERE}"
        )
    msg = heard.imus[-1][0]
    stamps = np.unique([ros.nanoseconds(one.header.stamp) for one, _ in heard.imus]) * 1e-9
    enough = f"its rate must be {1.0 / _SLOW:g} Hz at least"
    if len(stamps) < 2:
        raise _Failed(f"all its messages have one stamp: set header.stamp to the time of each measurement; {enough}")
    if not (period := float(np.median(np.diff(stamps)))) <= _SLOW:
        raise _Failed(f"it measures every {period:.3f} s: {enough}, better that of the states")
    if not ros.is_frame_of(model.imu_link, msg.header.frame_id):
        raise _Failed(
            f"its frame is '{shown(msg.header.frame_id)}', and robot.imu is '{model.imu_link}': they must agree"
        )
    try:
        up, gyro, _ = ros.inertial_of(msg)
    except StateError as error:
        raise _Failed(str(error)) from error
    kin = Kinematics(model, heard.angles(model), Foot.LEFT)
    back, right, height = kin.direction(model.imu, up)
    lean = angle_of(height)
    where = "back" if back > 0.0 else "ahead", "right" if right > 0.0 else "left"
    a = np.array([msg.linear_acceleration.x, msg.linear_acceleration.y, msg.linear_acceleration.z])
    pull = float(np.linalg.norm(a))
    text = (
        f"leans by {math.degrees(lean):.1f} deg ({where[0]} {math.degrees(abs(back)):.1f}, {where[1]} "
        f"{math.degrees(abs(right)):.1f}), turns at {np.linalg.norm(gyro):.3f} rad/s, {pull:.2f} m/s^2"
    )
    if lean > FallWatch.upside_down:
        raise _Failed(f"{text}: {FallWatch.other_frame}")
    if (off := angle_of(up @ a / max(pull, 1e-9))) > _UPRIGHT and pull > 1.0:
        raise _Failed(
            f"{text}: its acceleration points {math.degrees(off):.0f} deg away from the vertical of its orientation: "
            "is that the inverse quaternion, or has it other axes?"
        )
    if contradiction := _turns_otherwise(heard):
        raise _Failed(f"{text}: {contradiction}")
    if lean > _UPRIGHT:
        raise _Failed(f"{text}: it is mounted askew (the URDF's joint of '{model.imu_link}'), or the floor is")
    if np.linalg.norm(gyro) > _STILL or abs(pull - GRAVITY) > _PULL:
        raise _Failed(f"{text}: at rest it measures {GRAVITY:.2f} m/s^2 and no rotation; calibrate it, check its units")
    return text


def _turns_otherwise(heard: Heard) -> str:
    """Return how the gyroscope contradicts the vertical of a robot that was leaned meanwhile; or ""."""
    times = 1e-9 * np.array([ros.nanoseconds(msg.header.stamp) for msg, _ in heard.imus])
    measured = [ros.inertial_of(msg) for msg, _ in heard.imus]
    up, gyro = (np.array([one[k] for one in measured]) for k in range(2))
    leaned = float(np.linalg.norm(up[-1] - up[0]))
    turned = np.linalg.norm(up[-1] - up[0] - np.diff(times) @ np.cross(up, gyro)[:-1])
    if leaned < _LEANED or turned < 0.5 * leaned:
        return ""
    return (
        f"it was leaned by {math.degrees(leaned):.0f} deg, and its gyroscope is {math.degrees(turned):.0f} deg off: is "
        "it inverted, in degrees, or of other axes?"
    )


def _check_subscribers(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that a node subscribes to the commands."""
    if not heard.subscribers:
        raise _Failed(f"no node subscribes to {VELOCITY}: start poppy_driver, drive, or a plant")
    return ", ".join(heard.subscribers)


def _check_plant_ready(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that the plant accepts commands."""
    _require_heard(heard, "plant_ready")
    if heard.ready is False:
        why = heard.plant or "call ~/activate of poppy_driver, or activate the controllers that drive uses"
        raise _Failed(f"plant_ready is false: {why}")
    if heard.warning:
        raise _Failed(f"plant_warning, so ~/start is refused: {heard.warning}")
    return "accepts commands" if heard.ready else "does not publish plant_ready"


def _check_diagnostics(config: Config, model: RobotModel, heard: Heard) -> str:
    """Check that no node reports an error on /diagnostics."""
    if heard.errors:
        raise _Failed("; ".join(f"{name}: {text}" for name, text in heard.errors.items()))
    return "no errors" if heard.diagnosed else "not heard: no node reports on /diagnostics"


class ByHand:
    """Names the joints that are moved by hand, each once, and which way the model says that they moved.

    Attributes
    ----------
    left : list of str
        Joints that have not been moved yet.
    states : int
        Number of states that were looked at.
    """

    def __init__(self, model: RobotModel, show: Callable[[str], None]) -> None:
        self._model, self._show = model, show
        self._reader = ros.JointReader(model.joint_names)
        self.states, self._first = 0, np.zeros(0)
        self.left = list(model.joint_names)

    def __call__(self, heard: Heard) -> bool:
        """Look at the states that have arrived since the last time; return whether every joint has been moved."""
        new, self.states = heard.states[self.states :], len(heard.states)
        for msg, _ in new:
            with contextlib.suppress(StateError):
                q = self._reader.state(msg).q
                self._first = self._first if len(self._first) else q
                for k in np.flatnonzero(np.abs(q - self._first) > _BY_HAND):
                    if (name := self._model.joint_names[k]) in self.left:
                        self.left.remove(name)
                        turned = float(q[k] - self._first[k])
                        self._show(f"  {name:22s} {turned:+.2f} rad: {motion(self._model, q, int(k), turned)}")
        return not self.left


CHECKS: dict[str, Check] = {
    "states": _check_states,
    "joints": _check_joint_names,
    "rate": _check_rate,
    "latency": _check_latency,
    "rest": _check_rest,
    "limits": _check_limits,
    "soles": _check_soles,
    "first pose": _check_posture,
    "inertial sensor": _check_inertial_sensor,
    "commands": _check_subscribers,
    "plant": _check_plant_ready,
    "/diagnostics": _check_diagnostics,
}
"""All checks, in the order in which their faults are to be repaired."""
_WITHOUT_STATES = ("states", "commands", "plant", "/diagnostics")
"""Checks that are also made if no valid state was received."""


def examine(config: Config, model: RobotModel, heard: Heard) -> Iterator[Result]:
    """Run the checks and yield their results; messages with none of the robot's joints count only if all are such."""
    reader, usable = ros.JointReader(model.joint_names), True
    own = [(msg, at) for msg, at in heard.states if not reader.is_foreign(msg)]
    heard = dataclasses.replace(heard, states=own or heard.states)
    for what, check in CHECKS.items():
        if usable or what in _WITHOUT_STATES:
            try:
                result = Result(what, True, check(config, model, heard))
            except _Failed as failed:
                result = Result(what, False, str(failed))
            yield result
            if what in ("states", "joints"):
                usable = usable and result.ok
