"""The walk on ROS 2: thin nodes around the core, and the only folder that imports rclpy.

=========================  ===========================================================================
`entry`                    command line of the nodes: help, exit codes
`runtime`                  start, spin, signals, orderly end
`parameters`               the schema of `dqwalk_ros.config` as ROS parameters
`messages`, `commands`     topics, and messages <-> the core's values
`phase_log`                the phases of a walk, rebuilt from its topics
`markers`, `transform`     shapes for RViz, and /tf where tf2_msgs is installed
`controller`               joint_states -> joint_velocity_commands
`inertial`, `steering`     imu and cmd_vel, the controller's further ears
`odometry`                 base_pose
`simulated`                what every simulated plant does
`integrator`               the plant that stands in for the hardware: joints that obey
`physics`                  the same in a physics engine
`pilot`                    a course -> cmd_vel
`poppy_driver`             the plant that is the hardware
`whole_body_controller`    joint_states, base_pose, base_twist -> joint_effort_commands
`rigid`                    the plant for torques
`phase_monitor`            /diagnostics and markers, recomputed from the topics
`recorder`                 rosbag2
`viewer`                   the walk in the browser
=========================  ===========================================================================
"""
