"""The walk on ROS 2: rclpy nodes around the core, and the only folder that imports rclpy.

=========================  ===========================================================================
`command_line`             help, options, console scripts: all that needs no ROS
`wheels`                   what rclpy and its wheels lack, worked around
`base`                     what every node is: parameters, diagnostics, an exit code
`parameters`               the schema of `dqwalk_ros.config` as ROS parameters
`messages`                 messages <-> the core's values
`safety`                   which states and commands count; no ROS in it
`inputs`                   states with their inertial sensor, commands, cmd_vel: read and judged
`phase_log`                the phases of a walk, rebuilt from its topics
`markers`                  shapes for RViz
`odometry`                 base_pose and /tf
`controller`               joint_states -> joint_velocity_commands
`plant`                    joint_velocity_commands -> joint_states: integrator, physics
`poppy_driver`             the same on the real robot
`pilot`                    a course -> cmd_vel
`whole_body_controller`    joint_states, base_pose, base_twist -> joint_effort_commands
`rigid`                    the plant for torques
`phase_monitor`            /diagnostics and markers, recomputed from the topics
`recorder`                 rosbag2
`viewer`                   the walk in the browser
=========================  ===========================================================================
"""
