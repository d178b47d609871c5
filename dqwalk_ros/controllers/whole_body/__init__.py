"""The whole-body motion controller with long-term balance constraints [Sherikov2014]."""

from __future__ import annotations

from dqwalk_ros.controllers.whole_body.controller import WholeBodyController
from dqwalk_ros.controllers.whole_body.records import BodyCommand, BodyState, BodyTick, Wrench

__all__ = ["BodyCommand", "BodyState", "BodyTick", "WholeBodyController", "Wrench"]
