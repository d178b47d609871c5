"""Where the robot is, as Nav2 and RViz expect it: odom, base_pose, and the frames of REP-105 and REP-120 on /tf.

/tf and /tf_static are published where tf2_msgs is installed; the wheels of ROS on PyPI lack it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from numpy.typing import NDArray
from rclpy.qos import QoSProfile

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.robot import RobotModel

__all__ = ["Odometry"]

Array = NDArray[np.float64]

_FIXED = 0.005
"""Standard deviation of what does not drift, height, roll and pitch [m, rad], and of velocities [m/s, rad/s]."""


class Odometry:
    """Publishes the base in odom, its velocity, and how far both may be off.

    A walk that begins anew begins where the last one ended: odom does not jump.

    Parameters
    ----------
    node : WalkNode
    model : RobotModel
    """

    def __init__(self, node: WalkNode, model: RobotModel) -> None:
        self._node, self._model, self._config = node, model, node.config.odometry
        self._poses = node.advertise("base_pose")
        self._odom = node.create_publisher(OdometryMessage, "odom", ros.stream(10))
        self._send_transforms = _sender(node, "/tf", ros.stream(100))
        pelvis, root = model.frames[model.pelvis], model.frames[model.root]
        self._x_pelvis_root = DQ(pelvis.pose).conj() * DQ(root.pose)
        if pelvis.body != root.body:
            node.get_logger().warning(
                f"{model.pelvis} moves against the root {model.root}: RViz shows it off its place"
            )
        if self._config.base_frame != model.root and (send := _sender(node, "/tf_static", ros.latched())) is not None:
            send([_transform(0, self._config.base_frame, model.root, DQ(1.0))])
        self._window: deque[tuple[int, DQ]] = deque()  # stamps [ns] and poses of the base
        self._origin, self._last = DQ(1.0), DQ(1.0)
        self._is_new = False
        self._steps = 0

    def begin_anew(self) -> None:
        """Go on from the last pose, wherever a new walk has its origin."""
        self._is_new = bool(self._window)
        self._window.clear()

    @property
    def origin(self) -> Array:
        """Pose in odom of the world of the walk's first phase, shape (8,)."""
        return self._origin.vec8()

    def note_step(self) -> None:
        """Count a step, by which the pose is less certain."""
        self._steps += 1

    def publish(self, stamp: int, x_pelvis: Array) -> None:
        """Publish for a state.

        Parameters
        ----------
        stamp : int
            Of the state [ns].
        x_pelvis : ndarray, shape (8,)
            Pose of the pelvis in the world of the walk's first phase.
        """
        x_root = DQ(x_pelvis) * self._x_pelvis_root
        if self._is_new:
            self._origin, self._is_new = self._last * x_root.conj(), False
        x = self._last = self._origin * x_root
        if self._window and stamp <= self._window[-1][0]:
            self._window.clear()  # the plant's clock was set back
        self._window.append((stamp, x))
        while len(self._window) > 2 and stamp - self._window[1][0] >= self._config.window * 1e9:
            self._window.popleft()
        if self._poses.get_subscription_count():
            pose = (self._origin * DQ(x_pelvis)).vec8()
            self._poses.publish(ros.pose(stamp, self._config.odom_frame, pose))
        if self._odom.get_subscription_count():
            self._odom.publish(self._message(stamp, x))
        if self._send_transforms is not None:
            self._send_transforms(self._frames(stamp, x))

    def _message(self, stamp: int, x: DQ) -> OdometryMessage:
        msg = OdometryMessage(child_frame_id=self._config.base_frame)
        msg.header.stamp, msg.header.frame_id = ros.time_msg(stamp), self._config.odom_frame
        msg.pose.pose = ros.pose_fields(x.vec8())
        walked, turned = (
            math.sqrt(self._steps) * d for d in (self._config.step_deviation, self._config.turn_deviation)
        )
        deviations = np.array([walked, walked, 0.0, 0.0, 0.0, turned])  # x, y, z, roll, pitch, yaw
        msg.pose.covariance = np.diag(deviations**2 + _FIXED**2).ravel()
        msg.twist.covariance = np.diag(np.full(6, _FIXED**2)).ravel()
        linear, angular = msg.twist.twist.linear, msg.twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = self._velocity().tolist()
        return msg

    def _velocity(self) -> Array:
        """Return the mean velocity over the window, linear and angular, in the base's axes (6,) [m/s, rad/s]."""
        (t0, x0), (t1, x1) = self._window[0], self._window[-1]
        if t1 == t0:
            return np.zeros(6)
        passed = 1e-9 * (t1 - t0)
        moved = x1.rotation_matrix().T @ (x1.translation() - x0.translation())
        w, *xyz = (x0.conj() * x1).vec4()
        axis = np.array(xyz) * math.copysign(1.0, w)
        sine = float(np.linalg.norm(axis))
        turned = axis * (2.0 * math.atan2(sine, abs(w)) / sine if sine > 0.0 else 0.0)
        return np.concatenate([moved, turned]) / passed

    def _frames(self, stamp: int, x: DQ) -> list[TransformStamped]:
        config = self._config
        frames = [_transform(stamp, config.odom_frame, config.base_frame, x)]
        if config.footprint_frame:
            frames.append(_transform(stamp, config.base_frame, config.footprint_frame, x.conj() * footprint(x)))
        return frames


def footprint(x: DQ) -> DQ:
    """Return the pose on the ground below a pose, with its yaw."""
    place, r = x.translation(), x.rotation_matrix()
    yaw = math.atan2(r[1, 0], r[0, 0])
    return DQ.from_pose([place[0], place[1], 0.0], [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])


def _transform(stamp: int, parent: str, child: str, x: DQ) -> TransformStamped:
    msg = TransformStamped(child_frame_id=child)
    msg.header.stamp, msg.header.frame_id = ros.time_msg(stamp), parent
    pose, moved = ros.pose_fields(x.vec8()), msg.transform.translation
    moved.x, moved.y, moved.z = pose.position.x, pose.position.y, pose.position.z
    msg.transform.rotation = pose.orientation
    return msg


def _sender(node: WalkNode, topic: str, profile: QoSProfile) -> Callable[[list[TransformStamped]], None] | None:
    """Return what publishes transforms; None where tf2_msgs is not installed."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return None
    publisher = node.create_publisher(TFMessage, topic, profile)
    return lambda transforms: publisher.publish(TFMessage(transforms=transforms))
