"""Topics and messages of the nodes: quality of service, checks on arrival, conversion to and from the core's values."""

from __future__ import annotations

import array
import importlib
import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header

from dqwalk_ros.nodes.joint_order import JointOrder
from dqwalk_ros.nodes.publishers import UNKNOWN
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.state import Command, State
from dqwalk_ros.plants.base import Inertial, upward
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.wording import listed

_LEASE = 0.5
"""Time without a sign of life after which a publisher of `watched` is taken for killed or stopped [s]."""
_FUSION = "measure it, or estimate it by a filter (imu_filter_madgwick)"
"""Where an inertial sensor does not estimate what the walk needs."""


def best_effort(depth: int) -> QoSProfile:
    """Return the quality of service of a subscription for which the newest message matters, and a lost one does not."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def latched(depth: int = 1) -> QoSProfile:
    """Return the quality of service of a topic that late subscribers receive as well (transient local)."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def watched() -> QoSProfile:
    """Return that of a latched topic whose subscribers may ask to be told when its process is killed or stopped."""
    lease = Duration(seconds=_LEASE)
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, liveliness_lease_duration=lease)


def hear(node: Node, kind: Any, topic: str, callback: Callable[[Any], None]) -> None:
    """Subscribe to a topic of any quality of service, and to the last message of a publisher that latches it."""
    events = SubscriptionEventCallbacks(use_default_callbacks=False)  # each publisher is heard by one of the two
    for profile in (latched(), best_effort(1)):
        node.create_subscription(kind, topic, callback, profile, event_callbacks=events)


def message_type(name: str) -> Any:
    """Return the Python class of a message type such as ``std_msgs/msg/String``."""
    package, _, kind = name.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def of_another_type(node: Node, topic: str, kind: Any) -> str:
    """Return which nodes use a topic, of this full name, with another type than `kind`, so that no message passes."""
    own = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
    ends = (*node.get_publishers_info_by_topic(topic), *node.get_subscriptions_info_by_topic(topic))
    others = {f"{end.node_name} with {end.topic_type}" for end in ends if end.topic_type != own}
    if not others:
        return ""
    advice = "; see node.stamped_cmd_vel" if topic.endswith("/cmd_vel") else ""
    return f"{listed(others)} uses {topic}, which is a {own} here{advice}"


def publishers_of(node: Node, topic: str) -> tuple[str, ...]:
    """Return the names of the nodes that publish a topic, one entry per publisher."""
    ends = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    return tuple(sorted(map(node_of, ends)))


def node_of(end: Any) -> str:
    """Return the full name of the node of a publisher or a subscriber, as rclpy describes it, or `UNKNOWN`."""
    if end.node_name == "_NODE_NAME_UNKNOWN_":
        return UNKNOWN
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"


def executing(node: Node, topic: str) -> tuple[str, ...]:
    """Return the names of the nodes that subscribe to a topic of commands, but of those that only watch the walk."""
    ends = node.get_subscriptions_info_by_topic(node.resolve_topic_name(topic))
    return tuple(sorted({end.node_name for end in ends} - {"doctor", "recorder", "viewer", "phase_monitor"}))


def is_heard_by(node: Node, offered: Publisher, name: str) -> bool:
    """Return whether all discovered subscribers of a publisher are connected, with the node `name` among them."""
    asked = node.get_subscriptions_info_by_topic(offered.topic_name)
    return any(end.node_name == name for end in asked) and offered.get_subscription_count() >= len(asked)


# ---------------------------------------------------------------------- time


def nanoseconds(stamp: Time) -> int:
    """Return a stamp [ns]."""
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def time_msg(stamp: int) -> Time:
    """Return the message of a stamp [ns]."""
    sec, nanosec = divmod(stamp, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def header(stamp: int, frame: str = "") -> Header:
    """Return the header of a message with a stamp [ns] and a frame."""
    return Header(stamp=time_msg(stamp), frame_id=frame)


def stamp_of(raw: bytes) -> int:
    """Return the stamp [ns] of a serialised message that begins with a header.

    Raises
    ------
    StateError
        If it is too short, or the stamp is before 1970.
    """
    if len(raw) < 12:
        raise StateError(f"a message of {len(raw)} bytes has no header")
    # four bytes of encapsulation; the second one gives the byte order
    sec, nanosec = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, 4)
    if sec < 0:
        raise StateError(f"its stamp is {sec} s, before 1970")
    return int(sec * 1_000_000_000 + nanosec)


def deserialized(raw: bytes, kind: type) -> Any:
    """Return the message of a type that was serialised.

    Raises
    ------
    StateError
        If it cannot be read.
    """
    try:
        return deserialize_message(raw, kind)
    except RuntimeError as error:
        raise StateError("a message that cannot be read") from error


# ---------------------------------------------------------------------- joints


class JointReader:
    """Converts JointState messages to states and commands, in the order of the model's joints."""

    def __init__(self, joint_names: Sequence[str]) -> None:
        self._order = JointOrder(joint_names)

    def state(self, msg: JointState) -> State:
        """Return the measured state; velocities that are missing or not all finite are None.

        A joint_state_broadcaster publishes NaN for servos that measure no velocity; the walk does not need it.

        Raises
        ------
        StateError
            As `JointOrder`: an invalid message is rejected as a whole; or if its stamp is before 1970.
        """
        if msg.header.stamp.sec < 0:
            raise StateError(f"its stamp is {msg.header.stamp.sec} s, before 1970")
        q = self._order(msg.name, msg.position, "position")
        dq = self._order(msg.name, msg.velocity, "velocity", finite=False) if len(msg.velocity) else None
        if dq is not None and not np.isfinite(dq).all():
            dq = None
        effort = None
        if len(msg.effort) == len(msg.name):  # the walk does without: torques that do not fit reject no state
            effort = self._order(msg.name, msg.effort, "effort", finite=False)
        return State(time=nanoseconds(msg.header.stamp) * 1e-9, q=q, dq=dq, effort=effort)

    def is_whole(self, msg: JointState) -> bool:
        """Return whether a message names all joints of the model."""
        return self._order.joints.issubset(msg.name)

    def is_foreign(self, msg: JointState) -> bool:
        """Return whether a message has joints, but none of the model, such as that of a gripper."""
        return bool(msg.name) and self._order.joints.isdisjoint(msg.name)

    def command(self, msg: JointState) -> Command:
        """Return the commanded velocities, and the feedforward torques if the message has any.

        Raises
        ------
        StateError
            As `state`.
        """
        velocity = self._order(msg.name, msg.velocity, "velocity")
        effort = self._order(msg.name, msg.effort, "effort") if len(msg.effort) else None
        return Command(nanoseconds(msg.header.stamp) * 1e-9, velocity, effort)

    def torques(self, msg: JointState) -> Command:
        """Return the commanded torques; the velocities are zero.

        Raises
        ------
        StateError
            As `state`.
        """
        effort = self._order(msg.name, msg.effort, "effort")
        return Command(nanoseconds(msg.header.stamp) * 1e-9, np.zeros_like(effort), effort)


class JointWriter:
    """Makes JointState messages of a set of joints; one message is reused, so publish it before the next call.

    Parameters
    ----------
    frame : str
        The frame_id of the header.
    """

    def __init__(self, joint_names: Sequence[str], frame: str = "") -> None:
        self._msg = JointState(name=list(joint_names))
        self._msg.header.frame_id = frame

    def __call__(
        self,
        stamp: int,
        *,
        position: Array | None = None,
        velocity: Array | None = None,
        effort: Array | None = None,
    ) -> JointState:
        """Return the message with a stamp [ns], positions [rad], velocities [rad/s] and torques [N m]."""
        msg = self._msg
        msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        # array.array of doubles is the only type that rclpy accepts without a check of each number
        msg.position = array.array("d", b"" if position is None else position.tobytes())
        msg.velocity = array.array("d", b"" if velocity is None else velocity.tobytes())
        msg.effort = array.array("d", b"" if effort is None else effort.tobytes())
        return msg


# ---------------------------------------------------------------------- poses and points

_FARTHEST = 1e6
"""Largest distance of a pose from the origin of its frame [m]: squares of it, and their sums, remain exact enough."""


def pose_fields(x: Array) -> Pose:
    """Return the Pose of a unit dual quaternion (8,); its translation is 2 D(x) P(x)*, (U1)."""
    w, i, j, k, dw, di, dj, dk = x.tolist()  # Python floats are faster than numpy scalars, and this runs every tick
    out = Pose()
    out.position.x = 2.0 * (-dw * i + di * w - dj * k + dk * j)
    out.position.y = 2.0 * (-dw * j + di * k + dj * w - dk * i)
    out.position.z = 2.0 * (-dw * k - di * j + dj * i + dk * w)
    out.orientation.w, out.orientation.x, out.orientation.y, out.orientation.z = w, i, j, k
    return out


def pose(stamp: int, frame: str, x: Array) -> PoseStamped:
    """Return a PoseStamped of the unit dual quaternion `x` (8,)."""
    return PoseStamped(header=header(stamp, frame), pose=pose_fields(x))


def checked_pose(msg: PoseStamped, what: str) -> DQ:
    """Return the pose of a PoseStamped from outside; `what` is its name in the error message.

    Raises
    ------
    StateError
        If its quaternion is not a unit quaternion, or its position is not finite or farther away than `_FARTHEST`.
    """
    r = msg.pose.orientation
    size = math.hypot(r.w, r.x, r.y, r.z)  # without overflow
    if not abs(size - 1.0) < 1e-3:
        raise StateError(f"{what} has no unit quaternion: its norm is {size:.3g}")
    place = checked_place(msg.pose.position, what)
    return DQ.from_pose(place, [r.w / size, r.x / size, r.y / size, r.z / size])


def checked_place(p: Point, what: str) -> list[float]:
    """Return the coordinates of a point from outside [m]; `what` is its name in the error message.

    Raises
    ------
    StateError
        If it is not finite, or farther away than `_FARTHEST`.
    """
    if not (far := math.hypot(p.x, p.y, p.z)) <= _FARTHEST:
        raise StateError(f"{what} is {far:.3g} m away; {_FARTHEST:g} m at most")
    return [p.x, p.y, p.z]


def xyz(p: Array) -> Point:
    """Return the Point of a vector (3,) [m]."""
    return Point(x=float(p[0]), y=float(p[1]), z=float(p[2]))


def point(stamp: int, frame: str, p: Array) -> PointStamped:
    """Return a PointStamped of a vector (3,) [m]."""
    return PointStamped(header=header(stamp, frame), point=xyz(p))


# ---------------------------------------------------------------------- inertial sensor, ground


def imu(stamp: int, frame: str, measured: Inertial) -> Imu:
    """Return the message of an inertial sensor with a stamp [ns]."""
    msg = Imu(header=header(stamp, frame))
    r, w, a = msg.orientation, msg.angular_velocity, msg.linear_acceleration
    r.w, r.x, r.y, r.z = measured.orientation.tolist()
    w.x, w.y, w.z = measured.gyro.tolist()
    a.x, a.y, a.z = measured.acceleration.tolist()
    return msg


def untimely(before: float, silent: float, longest: float) -> str:
    """Return why a message is not of the time of a state, and what to do; empty if it is.

    Parameters
    ----------
    before : float
        From its stamp to that of the state [s].
    silent : float
        Since it was received [s]; infinite if there is none.
    longest : float
        Largest difference of the stamps [s].
    """
    if silent == math.inf:
        return "no message yet"
    if abs(before) <= longest:
        return ""
    if silent > longest:
        return f"no message for {silent:.3g} s: its driver has stopped, or sends too seldom"
    where = "before" if before > 0.0 else "after"
    return (
        f"its stamp is {abs(before):.3f} s {where} the state's, though it has just arrived: stamp both with the time "
        "of the measurement, by one clock (chrony)"
    )


def is_frame_of(link: str, frame: str) -> bool:
    """Return whether a frame_id is that of a link: its name, with or without a prefix such as ``robot1/``, or empty."""
    return not frame or frame.rpartition("/")[2] == link


def inertial_of(msg: Imu) -> tuple[Array, Array, Array | None]:
    """Return the unit vector against gravity, angular velocity [rad/s] and acceleration [m/s^2], (3,) each.

    All are in the sensor's frame. Only roll and pitch of the orientation are used, so the sensor needs no compass. The
    acceleration is None if its covariance begins with -1, which in ROS marks a missing measurement.

    Raises
    ------
    StateError
        If there is no orientation or no angular velocity, or a number is not finite.
    """
    for what in ("orientation", "angular_velocity"):
        if getattr(msg, f"{what}_covariance")[0] < 0.0:
            raise StateError(f"imu: its covariance says that it has no {what.replace('_', ' ')}: {_FUSION}")
    r, w, a = msg.orientation, msg.angular_velocity, msg.linear_acceleration
    size = math.sqrt(r.w * r.w + r.x * r.x + r.y * r.y + r.z * r.z)
    gyro, acceleration = np.array([w.x, w.y, w.z]), np.array([a.x, a.y, a.z])
    if not abs(size - 1.0) < 1e-3:
        cure = "its driver must normalize it" if size else f"it estimates no orientation: {_FUSION}"
        raise StateError(f"imu: not a unit quaternion, its norm is {size:g}: {cure}")
    if not np.isfinite(gyro).all():
        raise StateError("imu: its angular velocity is not finite: {:g}, {:g}, {:g} rad/s".format(*gyro))
    known = msg.linear_acceleration_covariance[0] >= 0.0 and bool(np.isfinite(acceleration).all())
    return upward(r.w, r.x, r.y, r.z), gyro, acceleration if known else None


def wrench(stamp: int, frame: str, w: Array) -> WrenchStamped:
    """Return a WrenchStamped of force and torque (6,) [N, N m]."""
    msg = WrenchStamped(header=header(stamp, frame))
    f, t = msg.wrench.force, msg.wrench.torque
    f.x, f.y, f.z, t.x, t.y, t.z = w.tolist()
    return msg


def impulse(msg: WrenchStamped, most: float) -> Array:
    """Return the impulse (3,) of a push [N s]: its force times one second.

    Raises
    ------
    StateError
        If a component is not finite, or beyond `most` [N s].
    """
    f = msg.wrench.force
    out = np.array([f.x, f.y, f.z])
    if not np.abs(out).max() <= most:
        raise StateError(f"{f.x:g}, {f.y:g}, {f.z:g} N s are beyond {most:.0f} N s, or not finite")
    return out
