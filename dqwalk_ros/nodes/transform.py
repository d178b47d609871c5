"""odom -> pelvis on /tf. Importing this fails where tf2_msgs is not installed, as with the PyPI wheels of ROS."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from dqwalk_ros.nodes.messages import stream

__all__ = ["TransformSender"]


class TransformSender:
    """Send poses as transforms.

    Parameters
    ----------
    node : rclpy.node.Node
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TFMessage, "/tf", stream(100))

    def __call__(self, pose: PoseStamped, child: str) -> None:
        """Send the pose of the frame `child` in the frame of `pose`."""
        msg = TransformStamped(header=pose.header, child_frame_id=child)
        p = pose.pose.position
        msg.transform.translation.x, msg.transform.translation.y, msg.transform.translation.z = p.x, p.y, p.z
        msg.transform.rotation = pose.pose.orientation
        self._publisher.publish(TFMessage(transforms=[msg]))
