"""Moved to `dqwalk_ros.robot`; this name goes when nothing imports it any more."""

from dqwalk_ros.robot import Body, Foot, Frame, RobotModel, Sole, find_urdf, load_model, parse_model

__all__ = ["Body", "Foot", "Frame", "RobotModel", "Sole", "find_urdf", "load_model", "parse_model"]
