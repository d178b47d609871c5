"""The ROS nodes of the whole-body controller and of its plant."""
