"""Commands to the arms of a walking robot: trajectories of joints and poses of hands, checked on arrival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.odometry import Odometry
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.walks.arms.arms import Arms
from dqwalk_ros.walks.stepping import SteppingWalk

_TRAJECTORY = "arm_trajectory"


class ArmInput:
    """Input of arm_trajectory, left_hand_target and right_hand_target, as joint_trajectory_controller or MoveIt Servo.

    Parameters
    ----------
    controller : VelocityController
        Of a standing or dynamic walk with ``arms.joints``.
    time_of : callable
        Returns the time of the walk [s] of a stamp [ns].
    """

    def __init__(
        self, node: WalkNode, controller: VelocityController, odometry: Odometry, time_of: Callable[[int], float]
    ) -> None:
        self._node, self._controller, self._odometry, self._time_of = node, controller, odometry, time_of
        self._rejected: Counter[str] = Counter()
        node.listen(JointTrajectory, _TRAJECTORY, partial(self._take, _TRAJECTORY, self._follow), 10)
        for side in self._arms.hands:
            reach = partial(self._reach, side)
            node.listen(PoseStamped, f"{side}_hand_target", partial(self._take, f"{side}_hand_target", reach), 1)

    @property
    def _arms(self) -> Arms:
        walk = self._controller.walk
        assert isinstance(walk, SteppingWalk)
        assert walk.arms is not None
        return walk.arms

    def _take(self, topic: str, execute: Callable[[Any], None], msg: Any) -> None:
        """Execute a message, or log why it is invalid."""
        try:
            execute(msg)
        except StateError as error:
            self._rejected[topic] += 1
            self._node.get_logger().error(f"{topic} rejected ({self._rejected[topic]} so far): {error}", **throttled())

    def _follow(self, msg: JointTrajectory) -> None:
        stamp, points = ros.nanoseconds(msg.header.stamp), msg.points
        times = [1e-9 * ros.nanoseconds(point.time_from_start) for point in points]
        angles, velocities = ([list(getattr(p, what)) for p in points] for what in ("positions", "velocities"))
        for k, (q, v) in enumerate(zip(angles, velocities, strict=True), start=1):
            if len(q) != len(msg.joint_names) or len(v) not in (0, len(q)) or bool(v) is not bool(velocities[0]):
                raise StateError(
                    f"point {k} has {len(q)} positions and {len(v)} velocities for {len(msg.joint_names)} joints"
                )
        known = velocities if velocities and velocities[0] else None
        self._arms.follow(list(msg.joint_names), times, angles, known, self._time_of(stamp) if stamp else None)

    def _reach(self, side: str, msg: PoseStamped) -> None:
        frame, pose = msg.header.frame_id, ros.checked_pose(msg, "the pose")
        if frame == self._node.config.odometry.odom_frame:
            self._arms.reach(side, self._odometry.base_sole.conj() * pose)
        elif not frame:
            raise StateError("the pose has no frame_id; it must be odom, or a link of the trunk")
        else:
            self._arms.reach(side, pose, frame)

    def give_up(self, joint: int) -> NDArray[np.intp]:
        """Give up the command of an arm; see `Arms.give_up`."""
        return self._arms.give_up(joint)

    def tell(self) -> None:
        """Log what has happened to commands."""
        for news in self._arms.news():
            self._node.get_logger().warning(news)

    def values(self) -> dict[str, object]:
        """Return the values shown on /diagnostics."""
        return {f"{topic} rejected": count for topic, count in self._rejected.items()}
