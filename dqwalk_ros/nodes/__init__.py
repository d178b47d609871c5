"""The ROS 2 nodes around the core; rclpy is imported here and in `dqwalk_ros.whole_body.nodes` only.

=========================  ===========================================================================
`command_line`             help, options and console scripts of the nodes; works without ROS
`launching`                what the launch files share
`wheels`                   workarounds for rclpy and its wheels on PyPI
`base`                     base class of every node: parameters, diagnostics, exit code
`parameters`               the schema of `dqwalk_ros.config` as ROS parameters
`messages`                 conversion between messages and the core's values
`safety`                   which commands are accepted; imports no ROS
`state_gate`               which states are accepted; imports no ROS
`inertial_sensor`          measurements of the inertial sensor, joined with the states
`foot_forces`              measurements of force sensors in the feet
`fall_watch`, `fall_cause` whether the robot has fallen, and why
`answering`                base class of both controllers: state checks, stopping the robot
`inputs`                   joint commands and cmd_vel, checked on arrival
`footsteps`                commanded footsteps (nav_msgs/Path)
`arms`                     commands to the arms: trajectories of joints, poses of hands
`phases`                   publishes the phases of a walk; rebuilds them from the topics
`markers`                  shapes for RViz and Foxglove
`odometry`                 odom, base_pose and /tf
`controller`               joint_states -> joint_velocity_commands
`plant`                    joint_velocity_commands -> joint_states: integrator, physics
`poppy_driver`             the same on a real Poppy
`drive`                    joint_velocity_commands -> the controllers of another robot, such as ros2_control's
`pilot`                    a course -> cmd_vel
`phase_monitor`            /diagnostics and markers, recomputed from the topics
`recorder`                 records a rosbag2
`viewer`                   shows the walk in the browser
`doctor`                   listens to the topics of a robot for `dqwalk doctor`
=========================  ===========================================================================
"""
