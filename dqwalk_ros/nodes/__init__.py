"""The walk on ROS 2: five thin nodes around the core, and the only folder that imports rclpy.

====================  ================================================================================
`entry`               command line of the nodes: help, exit codes
`runtime`             start, spin, signals, orderly end
`parameters`          the schema of `dqwalk_ros.config` as ROS parameters
`messages`            topics, and messages <-> the core's values
`controller`          joint_states -> joint_velocity_commands
`integrator`          the plant that stands in for the hardware
`phase_monitor`       /diagnostics and markers, recomputed from the topics
`recorder`            rosbag2
`viewer`              the walk in the browser
====================  ================================================================================
"""
