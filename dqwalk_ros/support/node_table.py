"""The nodes of this package: one table, used by their command line and by the reader of parameter files."""

from __future__ import annotations

NODES = {
    "controller": "nodes.controller:Controller",
    "drive": "nodes.drive:RobotDrive",
    "integrator": "nodes.plant:Integrator",
    "phase_monitor": "nodes.phase_monitor:PhaseMonitor",
    "physics": "nodes.plant:Physics",
    "pilot": "nodes.pilot:Pilot",
    "poppy_driver": "nodes.poppy_driver:PoppyDriver",
    "recorder": "nodes.recorder:Recorder",
    "rigid": "whole_body.nodes.rigid:Rigid",
    "viewer": "nodes.viewer:Viewer",
    "whole_body_controller": "whole_body.nodes.controller:WholeBodyController",
}
"""Module, relative to this package, and class of each node."""
