"""Every parameter of the package: its default, unit, meaning and bounds.

A parameter is one line of a section in `sections`. The same schema serves plain Python (`load`), the command line
(``dqwalk config``), the parameters of the ROS nodes and the documentation; a configuration file is a ROS parameter
file::

    /**:
      ros__parameters:
        dt: 0.005
        ssp: {com_radius: 0.05}
"""

from __future__ import annotations

from dqwalk_ros.config.configuration import Config
from dqwalk_ros.config.files import (
    OF_RCLPY,
    SHIPPED,
    applies_from,
    find_config,
    find_file,
    find_params,
    find_share,
    from_yaml,
    is_foreign,
    is_whole_body,
    load,
    overlaid,
    replaced,
    resolved,
    sections_of,
    to_yaml,
    with_files,
)
from dqwalk_ros.config.schema import Spec, Value
from dqwalk_ros.config.sections import (
    DynamicConfig,
    GaitConfig,
    MonitorConfig,
    PhysicsConfig,
    PoppyConfig,
    RobotConfig,
    SensorsConfig,
    WholeBodyConfig,
)

__all__ = [
    "OF_RCLPY", "SHIPPED", "Config", "DynamicConfig", "GaitConfig", "MonitorConfig", "PhysicsConfig", "PoppyConfig",
    "RobotConfig", "SensorsConfig", "Spec", "Value", "WholeBodyConfig", "applies_from", "find_config", "find_file",
    "find_params", "find_share", "from_yaml", "is_foreign", "is_whole_body", "load", "overlaid", "replaced", "resolved",
    "sections_of", "to_yaml", "with_files",
]  # fmt: skip
