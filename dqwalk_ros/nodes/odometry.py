"""Odometry for Nav2 and RViz: odom, base_pose, and the frames of REP-105 and REP-120 on /tf.

With an inertial sensor that has an accelerometer the pose is estimated by `estimation.base`; without one it is computed
from the joint angles alone, from sole to sole.

The transforms make one tree together with those of a robot_state_publisher, where no frame has two parents:

- If base_frame is a link of the URDF, odom is the parent of the URDF's root; otherwise it is the parent of base_frame,
  which is the parent of the root.
- footprint_frame is below base_frame, unless it is a link of the URDF, which has its place there.

/tf and /tf_static are published where tf2_msgs is installed; the wheels of ROS on PyPI lack it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.qos import QoSProfile

from dqwalk_ros.estimation.base import BaseEstimate, BaseEstimator
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.paper.dual_quaternions import DQ
from dqwalk_ros.paper.kinematics import Kinematics
from dqwalk_ros.paper.state import State
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.arrays import Array
from dqwalk_ros.walks.footprint import flat

_FIXED = 0.005
"""Standard deviation of height, roll and pitch [m, rad], which do not drift, and of velocities [m/s, rad/s]."""
_TIMEOUT = 0.5
"""Time without a state after which the estimator is restarted from the last pose [s]."""
_RESTARTS = 3
"""Number of times that the estimate may go astray in a walk, before the pose is computed from the legs alone."""
_POSE = [0, 1, 2, 6, 7, 8]
"""Indices of orientation and position in the covariance of an estimate."""


class Odometry:
    """Publishes the pose of the base in odom, its velocity, and the covariances of both.

    A new walk starts from the last pose of the one before, so the pose in odom does not jump.

    Attributes
    ----------
    base_sole : DQ
        Pose in odom of the base sole of the last state.
    """

    def __init__(self, node: WalkNode, model: RobotModel) -> None:
        self._node, self._model, self._config = node, model, node.config.odometry
        self._poses = node.advertise("base_pose")
        self._odom = node.create_publisher(OdometryMessage, "odom", 10)
        self._send_transforms = _sender(node, "/tf", 100)
        base, footprint, odom = self._config.base_frame, self._config.footprint_frame, self._config.odom_frame
        links = model.frames
        self._link = base if base in links else model.root  # its pose is that of base_frame
        self._top = model.root if base in links else base  # frame whose parent is odom
        self._footprint = "" if footprint in (base, odom) or footprint in links else footprint
        self._is_rigid = links[model.pelvis].body == links[self._link].body
        if odom in (*links, base):
            node.get_logger().error(
                f"no /tf: odometry.odom_frame '{odom}' is also a link of the robot or odometry.base_frame: rename it"
            )
            self._send_transforms = None
        elif base not in links and (send := _sender(node, "/tf_static", ros.latched())) is not None:
            send([_transform(0, base, model.root, DQ(1.0))])
        self._window: deque[tuple[float, DQ]] = deque()  # times [s] and poses of the base
        self._origin, self._last, self.base_sole = DQ(1.0), DQ(1.0), DQ(1.0)
        self._restarted = False
        self._steps = 0
        self._estimator = BaseEstimator(node.config, model)
        self._estimated: BaseEstimate | None = None
        self._astray = 0  # how often the estimate went astray in this walk

    def restart(self) -> None:
        """Start a new walk at the last pose, wherever that walk has its origin."""
        self._astray = 0
        self._continue()

    def _continue(self) -> None:
        """Forget the motion so far; the next pose is the last one."""
        self._restarted = self._restarted or bool(self._window)
        self._window.clear()
        self._estimator = BaseEstimator(self._node.config, self._model)

    @property
    def origin(self) -> Array:
        """Pose in odom of the frame of the walk's first phase, shape (8,)."""
        return self._origin.vec8()

    def note_step(self) -> None:
        """Count a step; each step increases the covariance of the pose."""
        self._steps += 1

    def publish(
        self, stamp: int, state: State, kin: Kinematics, x_base: DQ, *, both: bool, loads: Array | None = None
    ) -> None:
        """Publish the odometry of a state.

        Parameters
        ----------
        stamp : int
            Of the state [ns]. Its time, which does not jump with a clock that is set, is that of all computations.
        kin : Kinematics
            At that state.
        x_base : DQ
            Pose of the base sole of `kin` in the frame of the walk's first phase, computed from the joint angles.
        both : bool
            Whether both feet are on the ground.
        loads : ndarray, shape (2,), optional
            Vertical forces on the left and on the right sole [N].
        """
        time = state.time
        passed = time - self._window[-1][0] if self._window else _TIMEOUT  # then there is nothing to forget
        if self._estimated is not None and not 0.0 < passed <= _TIMEOUT:
            self._continue()
        if passed <= 0.0:
            self._window.clear()  # the plant has restarted
        e = self._estimate(state, kin, both=both, loads=loads)
        if self._window and (e is None) is not (self._estimated is None):
            self._restarted = True  # the pose of the legs has another origin
        self._estimated = e
        x_pelvis = e.pose if e is not None else (x_base * DQ(kin.pose(self._model.pelvis))).vec8()
        walk_base = DQ(x_pelvis) * DQ(kin.pose(self._model.pelvis)).conj()  # of `kin`, in the frame of the first phase
        x_link = walk_base * DQ(kin.pose(self._link))
        if self._restarted:
            self._origin, self._restarted = self._last * x_link.conj(), False
        self.base_sole = self._origin * walk_base
        x = self._last = self._origin * x_link
        self._window.append((time, x))
        while len(self._window) > 2 and time - self._window[1][0] >= self._config.window - 1e-6:
            self._window.popleft()
        if self._poses.get_subscription_count():
            pose = (self._origin * DQ(x_pelvis)).vec8()
            self._poses.publish(ros.pose(stamp, self._config.odom_frame, pose))
        if self._odom.get_subscription_count():
            self._odom.publish(self._message(stamp, x))
        if self._send_transforms is not None:
            x_root = self._origin * walk_base * DQ(kin.pose(self._model.root))
            self._send_transforms(self._frames(stamp, x_root, x))

    def _estimate(self, state: State, kin: Kinematics, *, both: bool, loads: Array | None) -> BaseEstimate | None:
        """Return the estimate at a state; None without an inertial sensor that can be believed."""
        if state.gyro is None or state.acceleration is None or self._astray >= _RESTARTS:
            return None
        try:
            with np.errstate(all="ignore"):
                felt = state.gyro, state.acceleration
                estimate = self._estimator.update(state.time, kin, *felt, both=both, loads=loads)
            if not self._estimator.astray and math.isfinite(sum(estimate.pose.tolist())):
                return estimate
        except np.linalg.LinAlgError:
            pass
        self._astray += 1
        self._estimator = BaseEstimator(self._node.config, self._model)
        text = "the accelerometer contradicts the legs: is its acceleration in m/s^2, and in the sensor's frame?"
        then = "the pose is that of the legs alone" if self._astray >= _RESTARTS else "the estimate begins again"
        self._node.get_logger().error(f"odometry: {text} {then}")
        return None

    def _message(self, stamp: int, x: DQ) -> OdometryMessage:
        c = self._config
        msg = OdometryMessage(header=ros.header(stamp, c.odom_frame), child_frame_id=c.base_frame)
        msg.pose.pose = ros.pose_fields(x.vec8())
        walked, turned = (math.sqrt(self._steps) * d for d in (c.step_deviation, c.turn_deviation))
        deviations = np.array([walked, walked, 0.0, 0.0, 0.0, turned])  # x, y, z, roll, pitch, yaw
        of_pose, of_twist, twist = np.diag(deviations**2 + _FIXED**2), np.diag(np.full(6, _FIXED**2)), self._velocity()
        if (e := self._estimated) is not None:
            R_odom, R = self._origin.rotation_matrix(), (self._origin.conj() * x).rotation_matrix()
            to_odom = np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), R_odom)  # position first, then orientation
            of_pose = to_odom @ e.covariance[np.ix_(_POSE, _POSE)] @ to_odom.T
            of_twist[:3, :3] = e.velocity_covariance(R)
            if self._is_rigid:
                arm, turn = (self._origin.conj() * x).translation() - DQ(e.pose).translation(), e.angular_velocity
                twist = np.concatenate([R.T @ (e.velocity + np.cross(turn, arm)), R.T @ turn])
        msg.pose.covariance, msg.twist.covariance = of_pose.ravel(), of_twist.ravel()
        linear, angular = msg.twist.twist.linear, msg.twist.twist.angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = twist.tolist()
        return msg

    def _velocity(self) -> Array:
        """Return the mean velocity over the window, linear and angular, in the base frame (6,) [m/s, rad/s]."""
        (t0, x0), (t1, x1) = self._window[0], self._window[-1]
        if t1 == t0:
            return np.zeros(6)
        moved = x1.rotation_matrix().T @ (x1.translation() - x0.translation())
        return np.concatenate([moved, (x0.conj() * x1).rotation_vector()]) / (t1 - t0)

    def _frames(self, stamp: int, x_root: DQ, x: DQ) -> list[TransformStamped]:
        """Return the transforms on /tf, from the poses in odom of the URDF's root and of the base."""
        config = self._config
        frames = [_transform(stamp, config.odom_frame, self._top, x_root)]
        if self._footprint:
            frames.append(_transform(stamp, config.base_frame, self._footprint, x.conj() * DQ(flat(x.vec8()))))
        return frames


def _transform(stamp: int, parent: str, child: str, x: DQ) -> TransformStamped:
    msg = TransformStamped(header=ros.header(stamp, parent), child_frame_id=child)
    pose, moved = ros.pose_fields(x.vec8()), msg.transform.translation
    moved.x, moved.y, moved.z = pose.position.x, pose.position.y, pose.position.z
    msg.transform.rotation = pose.orientation
    return msg


def _sender(node: WalkNode, topic: str, profile: QoSProfile | int) -> Callable[[list[TransformStamped]], None] | None:
    """Return a function that publishes transforms on a topic; None if tf2_msgs is not installed."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return None
    publisher = node.create_publisher(TFMessage, topic, profile)
    return lambda transforms: publisher.publish(TFMessage(transforms=transforms))
