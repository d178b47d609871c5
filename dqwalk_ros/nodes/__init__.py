"""The ROS 2 nodes around the core; the only folder that imports rclpy.

=========================  ===========================================================================
`command_line`             help, options and console scripts of the nodes; works without ROS
`launching`                what the launch files share
`wheels`                   workarounds for rclpy and its wheels on PyPI
`base`                     base class of every node: parameters, diagnostics, exit code
`parameters`               the schema of `dqwalk_ros.config` as ROS parameters
`messages`                 conversion between messages and the core's values
`safety`                   which commands are accepted; imports no ROS
`state_gate`               which states are accepted; imports no ROS
`inertial_sensor`          which inertial measurements are; imports no ROS
`fall_watch`, `fall_cause` whether the robot has fallen, and why
`answering`                base class of both controllers: state checks, stopping the robot
`inputs`                   inertial sensor, joint commands and cmd_vel, checked on arrival
`footsteps`                commanded footsteps (nav_msgs/Path)
`phases`                   publishes the phases of a walk; rebuilds them from the topics
`markers`                  shapes for RViz and Foxglove
`odometry`                 odom, base_pose and /tf
`controller`               joint_states -> joint_velocity_commands
`plant`                    joint_velocity_commands -> joint_states: integrator, physics
`poppy_driver`             the same on a real Poppy
`drive`                    joint_velocity_commands -> the controllers of another robot, such as ros2_control's
`pilot`                    a course -> cmd_vel
`whole_body_controller`    joint_states, base_pose, base_twist -> joint_effort_commands
`rigid`                    joint_effort_commands -> joint_states, base_pose, base_twist: rigid-body simulation
`phase_monitor`            /diagnostics and markers, recomputed from the topics
`recorder`                 records a rosbag2
`viewer`                   shows the walk in the browser
`doctor`                   the checks of `dqwalk doctor`: is the robot ready to walk?
=========================  ===========================================================================
"""
