"""Where the robot is: base_pose, and odom -> pelvis on /tf where tf2_msgs is installed (the PyPI wheels lack it)."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.publisher import Publisher

from dqwalk_ros.controller import VelocityController
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.topics import ODOM

__all__ = ["Odometry"]


class Odometry:
    """Publishes where the pelvis is, if anybody listens.

    Parameters
    ----------
    node : rclpy.node.Node
    poses : rclpy.publisher.Publisher
        Of base_pose.
    """

    def __init__(self, node: Node, poses: Publisher) -> None:
        self._poses = poses
        self._transforms: Publisher | None = None
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            return
        self._make_message: Any = TFMessage
        self._transforms = node.create_publisher(TFMessage, "/tf", ros.stream(100))

    def publish(self, stamp: int, controller: VelocityController) -> None:
        """Publish the pose of a state's stamp [ns]."""
        if self._transforms is None and not self._poses.get_subscription_count():
            return
        msg = ros.pose(stamp, ODOM, controller.odometry())
        self._poses.publish(msg)
        if self._transforms is not None:
            transform = TransformStamped(header=msg.header, child_frame_id=controller.model.pelvis)
            moved, p = transform.transform.translation, msg.pose.position
            moved.x, moved.y, moved.z = p.x, p.y, p.z
            transform.transform.rotation = msg.pose.orientation
            self._transforms.publish(self._make_message(transforms=[transform]))
