"""The ROS 2 nodes around the core; rclpy is imported here and in `dqwalk_ros.whole_body.nodes` only."""
