"""Is this robot ready to walk? What its topics say while it stands, check by check; nothing is moved.

Each check is a function of the configuration, the model and what was heard. It returns what it found, and whether that
is as it must be; a sentence that is not says what to do.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from numpy.typing import NDArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Bool

from dqwalk_ros.config import Config
from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import StateError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.inputs import VELOCITY
from dqwalk_ros.nodes.safety import outside_limits
from dqwalk_ros.robot import Foot, RobotModel

__all__ = ["CHECKS", "Finding", "Heard", "examine", "listen"]

Array = NDArray[np.float64]

_RATE = 0.2
"""States may come at a rate that is off by this part."""
_LATE = 3.0
"""One state in a hundred may come later than so many periods."""
_LEVEL, _HEIGHT = math.radians(4.0), 0.012
"""By the joint angles the soles of a robot that stands agree to this [rad, m]."""
_UPRIGHT = math.radians(10.0)
"""A robot that stands leans less [rad]."""
_STILL, _GRAVITY = 0.05, 0.6
"""The angular velocity at rest [rad/s], and how far the acceleration may be from 9.81 m/s^2."""
_DISCOVERY = 5.0
"""A node that publishes is discovered within this [s]."""
_POSTURE = 0.3
"""A walk begins no further from its posture [rad]."""


@dataclass
class Heard:
    """What came on the topics while one listened.

    Attributes
    ----------
    seconds : float
    states : list of (JointState, int)
        With the time of the clock at receipt [ns].
    imus : list of (Imu, int)
    errors : dict of str to str
        What /diagnostics said at the level ERROR, by name.
    ready : bool or None
        plant_ready, where somebody says it.
    publishers, takers : tuple of str
        Nodes that publish joint_states, and that take commands.
    """

    seconds: float
    states: list[tuple[JointState, int]] = field(default_factory=list)
    imus: list[tuple[Imu, int]] = field(default_factory=list)
    errors: dict[str, str] = field(default_factory=dict)
    ready: bool | None = None
    publishers: tuple[str, ...] = ()
    takers: tuple[str, ...] = ()

    def angles(self, model: RobotModel) -> Array:
        """Return the angles (n,) of the last state [rad].

        Raises
        ------
        StateError
            If no state came, or it cannot be used.
        """
        if not self.states:
            raise StateError("no joint_states came")
        return ros.JointReader(model.joint_names).state(self.states[-1][0]).q


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes
    ----------
    what, text : str
    ok : bool
    """

    what: str
    ok: bool
    text: str

    def __str__(self) -> str:
        return f"{'  ' if self.ok else '! '}{self.what:22s} {self.text}"


Check = Callable[[Config, RobotModel, Heard], tuple[bool, str]]


def come(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether states come."""
    if not heard.states:
        who = (
            f"from {', '.join(heard.publishers)}, who publishes nothing"
            if heard.publishers
            else "and nobody offers any"
        )
        return False, (
            f"none in {heard.seconds:g} s, {who}: start the driver, or the joint_state_broadcaster; the same "
            "ROS_DOMAIN_ID, namespace and ROS_AUTOMATIC_DISCOVERY_RANGE here as there?"
        )
    return True, f"{len(heard.states)} in {heard.seconds:g} s from {', '.join(sorted(set(heard.publishers)))}"


def named(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether every joint of the walk is measured."""
    try:
        heard.angles(model)
    except StateError as error:
        return False, f"{error}: name the joints as {model.name} does, or lock them with robot.lock"
    velocities = ros.JointReader(model.joint_names).state(heard.states[-1][0]).dq
    return True, f"all {model.n}" + (
        "; velocities are not measured, differences are taken" if velocities is None else ""
    )


def in_time(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether the states come once per dt."""
    stamps = np.unique([ros.nanoseconds(msg.header.stamp) for msg, _ in heard.states]) * 1e-9
    if len(stamps) < 10:
        return False, f"{len(stamps)} different stamps are too few to tell: the plant must stamp each state anew"
    periods = np.diff(stamps)
    middle, late = float(np.median(periods)), float(np.percentile(periods, 99))
    text = f"{1.0 / middle:.1f} Hz, 99 % within {1e3 * late:.1f} ms"
    if abs(middle / config.dt - 1.0) > _RATE:
        return (
            False,
            f"{text}; dt is {config.dt:g} s: set dt to {middle:.4g}, or the rate of the driver to {1 / config.dt:g}",
        )
    if late > _LATE * config.dt:
        return False, f"{text}: the bus or the machine is too slow; lower the rate and dt, give the loop a processor"
    return True, text


def young(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether what is measured arrives soon after; the rest of the delay is that of the command."""
    ages = [1e-9 * (at - ros.nanoseconds(msg.header.stamp)) for msg, at in heard.states]
    middle, late = float(np.median(ages)), float(np.percentile(ages, 99))
    text = f"{1e3 * middle:.1f} ms old on arrival, 99 % within {1e3 * late:.1f} ms"
    if not -0.01 <= middle <= config.plant.command_timeout:
        return False, f"{text}: the clocks of two machines differ (chrony), or use_sim_time is wrong"
    told = config.servo.assumed_latency
    if middle > 0.5 * config.dt and told < middle:
        return (
            False,
            f"{text}; the controller is told {1e3 * told:g} ms: set servo.assumed_latency to this and the command's",
        )
    return True, text


def within(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether every joint is inside its limits."""
    if outside := outside_limits(heard.angles(model), model, 0.01):
        return (
            False,
            f"{outside} beyond a limit: calibrate the joint, or its sign is wrong (poppy.calibration, the URDF)",
        )
    return True, "all inside"


def posture(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether the robot stands as the walk begins."""
    off = np.abs(heard.angles(model) - model.posture(config.standing.posture))
    k = int(off.argmax())
    text = f"{model.joint_names[k]} is furthest from the first pose, {off[k]:.2f} rad"
    if off[k] > _POSTURE:
        return (
            False,
            f"{text}: bring the robot there first (~/activate of poppy_driver; a trajectory with ros2_control)",
        )
    return True, text


def soles(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether both soles are on one floor, by the joint angles."""
    kin = Kinematics(model, heard.angles(model), Foot.LEFT)
    x = DQ(kin.pose(kin.swing))
    height, lean = float(x.translation()[2]), math.acos(min(max(float(x.rotation_matrix()[2, 2]), -1.0), 1.0))
    text = f"right sole {1e3 * height:+.1f} mm and {math.degrees(lean):.1f} deg off the left one's plane"
    if abs(height) > _HEIGHT or lean > _LEVEL:
        return False, f"{text}, by the joint angles: calibrate the legs with both soles flat on the floor"
    return True, text


def sensed(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether the inertial sensor is upright and at rest, in the frame of its link."""
    if not config.plant.imu:
        return True, "not asked for (plant.imu is false): torques and the fall are not watched"
    if not heard.imus:
        return False, "nothing on imu: start the sensor's broadcaster and remap its topic, or set plant.imu: false"
    msg = heard.imus[-1][0]
    if msg.header.frame_id not in ("", model.imu_link):
        return False, f"its frame is '{msg.header.frame_id}', and robot.imu is '{model.imu_link}': they must agree"
    try:
        up, gyro, _ = ros.inertial_of(msg)
    except StateError as error:
        return False, f"{error}: it must estimate an orientation (imu_filter_madgwick)"
    kin = Kinematics(model, heard.angles(model), Foot.LEFT)
    lean = math.acos(min(max(float(kin.direction(model.imu, up)[2]), -1.0), 1.0))
    a = msg.linear_acceleration
    pull = math.sqrt(a.x**2 + a.y**2 + a.z**2)
    text = f"leans by {math.degrees(lean):.1f} deg, turns at {np.linalg.norm(gyro):.3f} rad/s, {pull:.2f} m/s^2"
    if lean > _UPRIGHT:
        return False, f"{text}: it is mounted askew (the URDF's joint of '{model.imu_link}'), or the floor is"
    if np.linalg.norm(gyro) > _STILL or abs(pull - 9.81) > _GRAVITY:
        return False, f"{text}: at rest it must be still and say 9.81; calibrate it, mind its units"
    return True, text


def taken(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether somebody takes the commands."""
    if not heard.takers:
        return False, f"nobody listens on {VELOCITY}: start poppy_driver, drive, or a plant"
    return True, ", ".join(heard.takers)


def ready(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether the plant says that commands count."""
    if heard.ready is False:
        return (
            False,
            "plant_ready is false: ~/activate of poppy_driver, or activate the controllers that drive talks to",
        )
    return True, "commands count" if heard.ready else "nobody says otherwise"


def healthy(config: Config, model: RobotModel, heard: Heard) -> tuple[bool, str]:
    """Tell whether nothing reports an error."""
    if heard.errors:
        return False, "; ".join(f"{name}: {text}" for name, text in heard.errors.items())
    return True, "no errors"


CHECKS: dict[str, Check] = {
    "states": come,
    "joints": named,
    "rate": in_time,
    "latency": young,
    "limits": within,
    "soles": soles,
    "first pose": posture,
    "inertial sensor": sensed,
    "commands": taken,
    "plant": ready,
    "/diagnostics": healthy,
}
"""In the order in which one mends a robot; each of the rest needs states."""
_WITHOUT_STATES = ("states", "commands", "plant", "/diagnostics")


def examine(config: Config, model: RobotModel, heard: Heard) -> Iterator[Finding]:
    """Yield what each check found."""
    usable = True
    for what, check in CHECKS.items():
        if usable or what in _WITHOUT_STATES:
            ok, text = check(config, model, heard)
            yield Finding(what, ok, text)
            if what in ("states", "joints"):
                usable = usable and ok


def listen(config: Config, seconds: float, namespace: str = "") -> Heard:
    """Listen to a robot for so long [s] from its first state on; wait for that state as long, at least `_DISCOVERY`."""
    context = Context()
    rclpy.init(context=context)
    heard = Heard(seconds)
    try:
        node = Node("doctor", namespace=namespace, context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)

        def keep(box: list[tuple[Any, int]], msg: Any) -> None:
            box.append((msg, node.get_clock().now().nanoseconds))

        def told_ready(msg: Bool) -> None:
            heard.ready = msg.data

        def diagnosed(msg: DiagnosticArray) -> None:
            for status in msg.status:
                heard.errors.pop(status.name, None)
                if status.level == DiagnosticStatus.ERROR:
                    heard.errors[status.name] = status.message

        node.create_subscription(
            JointState, "joint_states", partial(keep, heard.states), ros.stream(100, reliable=False)
        )
        node.create_subscription(Imu, "imu", partial(keep, heard.imus), ros.stream(100, reliable=False))
        node.create_subscription(DiagnosticArray, "/diagnostics", diagnosed, ros.stream(100))
        node.create_subscription(Bool, "plant_ready", told_ready, ros.latched())
        end = time.monotonic() + max(seconds, _DISCOVERY)
        heard_from = False
        while (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=min(left, 0.1))
            if heard.states and not heard_from:
                heard_from, end = True, time.monotonic() + seconds
        heard.publishers = ros.other_publishers(node, "joint_states")
        ends = node.get_subscriptions_info_by_topic(node.resolve_topic_name(VELOCITY))
        heard.takers = tuple(sorted({end.node_name for end in ends} - {"recorder", "viewer", "phase_monitor"}))
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()
    return heard
