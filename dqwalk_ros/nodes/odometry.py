"""base_pose, the odometry of a walk; also on /tf where tf2_msgs is installed."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from dqwalk_ros.controllers import Controller
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.topics import ODOM

__all__ = ["Odometry"]


class Odometry:
    """Says where the pelvis is, if anybody listens.

    Parameters
    ----------
    node : rclpy.node.Node
    publisher : rclpy.publisher.Publisher
        Of base_pose.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self._publisher = publisher
        self._transform: Any = None
        try:
            from dqwalk_ros.nodes.transform import TransformSender
        except ImportError:  # the PyPI wheels of ROS have no tf2_msgs
            return
        self._transform = TransformSender(node)

    def publish(self, stamp: int, controller: Controller) -> None:
        """Publish the pose of a state's stamp [ns]."""
        if self._transform is None and not self._publisher.get_subscription_count():
            return
        msg = ros.pose(stamp, ODOM, controller.odometry())
        self._publisher.publish(msg)
        if self._transform is not None:
            self._transform(msg, controller.model.pelvis)
