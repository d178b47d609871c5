"""Every parameter of the package: its default, unit, meaning and bounds.

A parameter is one line of a section below. The same schema serves plain Python (`load`), the command line
(``dqwalk config``), the parameters of the ROS nodes and the documentation; a configuration file is a ROS parameter
file::

    /**:
      ros__parameters:
        dt: 0.005
        ssp: {com_radius: 0.05}
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import os
import pathlib
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import yaml

from dqwalk_ros import strict_yaml
from dqwalk_ros.errors import ConfigError

__all__ = [
    "SHIPPED", "Config", "DspConfig", "DynamicConfig", "EstimationConfig", "GaitConfig", "JointsConfig",
    "MonitorConfig", "NodeConfig", "OdometryConfig", "OutputConfig", "PelvisConfig", "PhysicsConfig", "PlantConfig",
    "PoppyConfig", "QpConfig", "RobotConfig", "SafetyConfig", "SensorsConfig", "ServoConfig", "Spec", "SspConfig",
    "StandingConfig", "TaskConfig", "WholeBodyConfig", "beside", "find_share", "from_yaml", "load", "overlaid",
    "put_on", "since", "to_yaml",
]  # fmt: skip

OF_RCLPY = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""Parameters that rclpy declares for every node; ``ros2 param dump`` writes them, `from_yaml` ignores them."""

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]


def _par(
    default: Value,
    meaning: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    *,
    live: bool = False,
) -> Any:
    """Declare a parameter: default, meaning, unit, closed bounds, and whether it may be set during a walk (live)."""
    return dataclasses.field(
        default=default, metadata={"meaning": meaning, "unit": unit, "low": low, "high": high, "live": live}
    )


@dataclass(frozen=True)
class RobotConfig:
    """The robot description and the links and joints of it that the walk uses."""

    urdf: str = _par("poppy.urdf", "URDF or xacro: a path relative to this file, or the name of a file in urdf/")
    pelvis: str = _par("pelvis", "link whose height above the support sole is bounded by (U11)")
    left_sole: str = _par("l_sole", "link of the left sole, origin at its centre, x forward, z up")
    right_sole: str = _par("r_sole", "link of the right sole, origin at its centre, x forward, z up")
    left_sole_xyz: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "centre of the sole in left_sole", "m")
    left_sole_rpy: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "roll, pitch, yaw of the sole in it", "rad")
    right_sole_xyz: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "centre of the sole in right_sole", "m")
    right_sole_rpy: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "roll, pitch, yaw of the sole in it", "rad")
    imu: str = _par("", "link of the inertial sensor; empty: the pelvis")
    imu_rpy: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "roll, pitch, yaw of the sensor in that link", "rad")
    drop: tuple[str, ...] = _par((), "joints removed together with all links after them; '*' matches any text")
    lock: tuple[str, ...] = _par((), "joints fixed at zero, or at an angle: JOINT=RADIANS; '*' matches any text")
    mass: float = _par(
        0.0,
        "mass as weighed; scales the masses and inertias of the URDF; larger: more torque; 0: the URDF's",
        "kg",
        0.0,
        1e4,
    )
    sole_center: Literal["link", "foot_com"] = _par(
        "link",
        "centre of the sole: 'link' (origin of the sole link) or 'foot_com' (below the foot's centre of mass)",
    )
    sole_length: float = _par(0.0, "length of the sole; 0: that of the sole link's collision box", "m", 0.0, 1.0)
    sole_width: float = _par(0.0, "width of the sole; 0: that of the sole link's collision box", "m", 0.0, 1.0)


@dataclass(frozen=True)
class GaitConfig:
    """Kind of walk, length of the walk and its footsteps."""

    style: Literal["paper", "standing", "dynamic"] = _par(
        "paper",
        "'paper' (Fig. 1: bounded by planes and a cylinder), 'standing' (statically stable: the CoM stays over "
        "the soles) or 'dynamic' (dynamically stable: docs/dynamic.md)",
    )
    walk: str = _par("", "class of your own walk, as MODULE:CLASS, in place of gait.style (docs/tutorial.md)")
    recover: str = _par(
        "",
        "standing: dynamic walk whose steps catch what the soles cannot bear, a name such as poppy_dynamic, or a file "
        "relative to that of the configuration; empty: none",
    )
    first_support: Literal["left", "right"] = _par("left", "foot of the first single support")
    cycles: int = _par(1, "paper: number of walking cycles of four phases each (Fig. 1)", "", 1, 100000)
    step_length: float = _par(
        0.05, "paper: landing place ahead of the support foot; otherwise: advance per step", "m", -0.5, 0.5
    )
    step_width: float = _par(0.0, "lateral distance of the soles' centres; 0: that at zero angles", "m", 0.0, 1.0)
    steps: int = _par(
        4, "standing, dynamic: steps before the feet are put together; 0: steered by cmd_vel", "", 0, 100000
    )
    step_side: float = _par(0.0, "lateral part of each step, positive: left; not paper", "m", -0.2, 0.2)
    step_turn: float = _par(0.0, "rotation of each step, positive: left; not paper", "rad", -0.8, 0.8)
    step_height: float = _par(0.02, "height of the swing foot; larger: more clearance", "m", 0.0, 0.2, live=True)
    most_length: float = _par(0.05, "longest step that cmd_vel can command", "m", 0.0, 0.5, live=True)
    most_side: float = _par(0.05, "longest lateral step that cmd_vel can command", "m", 0.0, 0.2, live=True)
    most_turn: float = _par(0.1, "largest rotation per step that cmd_vel can command", "rad", 0.0, 0.8, live=True)
    footstep_tolerance: float = _par(
        0.01,
        "largest correction of a commanded footstep; larger: fewer are refused",
        "m",
        0.0,
        0.1,
        live=True,
    )
    cmd_vel_timeout: float = _par(
        0.5, "without a new cmd_vel for this time the robot puts its feet together", "s", 0.0, 60.0, live=True
    )
    phase_timeout: float = _par(900.0, "longest duration of a phase; beyond it: an error", "s", 0.1, 1e5, live=True)


@dataclass(frozen=True)
class TaskConfig:
    """Parameters of the objective (U6)."""

    eta: float = _par(0.05, "convergence rate of the error in (U6); larger: faster", "1/s", 1e-6, 1e3, live=True)
    damping: float = _par(0.1, "lambda, velocity damping in (U6); larger: slower", "", 1e-6, 1e3, live=True)
    posture_weight: float = _par(
        0.0, "weight of a task that keeps standing.posture; larger: closer to it; 0: off", "", 0.0, 1e3, live=True
    )


@dataclass(frozen=True)
class DspConfig:
    """Double support, section 4.1."""

    eta_sliding: float = _par(5.0, "rate of (U7); larger: the tip slides faster to its limit", "1/s", 1e-3, 1e4)
    sliding_radius: float = _par(0.04, "radius of (U7); larger: the tip may slide further", "m", 1e-4, 1.0)
    eta_ground: float = _par(5.0, "rate of (U8) and flat_feet; larger: faster correction", "1/s", 1e-3, 1e4)
    flat_feet: bool = _par(True, "keep the end sole parallel to the ground; false: only its tip, the literal (U8)")
    eta_tip: float = _par(10.0, "rate of (U9); larger: faster approach to the front plane", "1/s", 1e-3, 1e4)
    eta_back: float = _par(20.0, "rate of (U10); larger: faster approach to the back plane", "1/s", 1e-3, 1e4)
    stall_rate: float = _par(1e-4, "fall of the error per stall_window that ends the phase", "m", 1e-9, 1.0)
    stall_window: float = _par(1.0, "time over which the error's fall is measured", "s", 0.01, 1e3)


@dataclass(frozen=True)
class SspConfig:
    """Single support, section 4.2."""

    eta_com: float = _par(5.0, "rate of (U14); larger: faster approach to the cylinder", "1/s", 1e-3, 1e4)
    com_radius: float = _par(0.05, "radius of (U14); larger: the CoM may move further", "m", 1e-4, 1.0)
    threshold: float = _par(1e-3, "||vec8(x - x_d)|| that ends the phase; larger: earlier", "", 1e-9, 1.0)


@dataclass(frozen=True)
class StandingConfig:
    """The standing walk: the CoM is kept inside the support polygon of the true soles."""

    margin: float = _par(0.008, "distance of the CoM from the edges; larger: safer", "m", 0.0, 0.1, live=True)
    eta_edges: float = _par(5.0, "rate of the edges; larger: faster approach to them", "1/s", 1e-3, 1e4, live=True)
    eta_feet: float = _par(5.0, "rate of the end sole's pose; larger: faster; 0: at rest", "1/s", 0.0, 1e4, live=True)
    recovery: float = _par(
        0.02, "largest speed at which a violation is corrected; larger: more abrupt", "m/s", 1e-4, 1e3, live=True
    )
    transfer_duration: float = _par(1.5, "time from foot to foot; larger: slower steps", "s", 0.05, 60.0, live=True)
    swing_duration: float = _par(1.5, "duration of a swing; larger: slower steps", "s", 0.05, 60.0, live=True)
    com_threshold: float = _par(0.003, "CoM error that ends the phase; larger: earlier", "m", 1e-5, 0.1, live=True)
    swing_threshold: float = _par(0.002, "error that ends a swing; larger: earlier", "m", 1e-5, 0.1, live=True)
    aim_inside: float = _par(
        0.0, "offset of the CoM on one foot towards the other; larger: bears more outwards", "m", 0.0, 0.05, live=True
    )
    saturation: float = _par(0.03, "limit of the CoM error; larger: faster correction", "m", 1e-4, 1.0, live=True)
    com_weight: float = _par(0.3, "weight of the CoM in single support; larger: closer", "", 0.0, 1e3, live=True)
    swing_weight: float = _par(10.0, "weight of the swing foot's path; larger: closer", "", 1e-3, 1e4, live=True)
    swing_rate: float = _par(10.0, "convergence to the swing path; larger: faster", "1/s", 0.1, 1e3, live=True)
    lever: float = _par(0.2, "length that weights angles; larger: orientation counts more", "m/rad", 1e-3, 10.0)
    balance: float = _par(0.5, "gain of the CoM's feedback; larger: stiffer; 0: none", "", 0.0, 10.0, live=True)
    pressure_margin: float = _par(
        0.004, "least distance of the commanded CoP from the edges; larger: less torque", "m", 0.0, 0.1, live=True
    )
    sole_gap: float = _par(0.004, "least lateral gap of the soles; larger: further apart", "m", 0.0, 0.2, live=True)
    posture: tuple[str, ...] = _par((), "first posture, JOINT=RADIANS; '*' matches any text; other joints: zero")


@dataclass(frozen=True)
class DynamicConfig:
    """The dynamic walk; durations, weights and gains common to both walks are in the section ``standing``."""

    start_duration: float = _par(0.6, "duration of the first weight shift; larger: slower start", "s", 0.1, 10.0)
    stop_duration: float = _par(1.0, "time in which the CoM comes to rest; larger: slower stop", "s", 0.1, 10.0)
    ramp: int = _par(3, "number of steps over which the step length grows and shrinks; larger: smoother", "", 0, 100)
    aim_ahead: float = _par(0.0, "offset of the planned zero-moment point ahead of the sole's centre", "m", -0.1, 0.1)
    aim_inside: float = _par(0.0, "offset of the zero-moment point towards the other foot", "m", -0.05, 0.05)
    side_frequency: float = _par(1.0, "lateral over model frequency; larger: faster sway", "", 0.5, 1.5)
    com_weight: float = _par(20.0, "weight of the CoM's path; larger: followed more closely", "", 1e-3, 1e4)
    com_rate: float = _par(2.0, "rate at which the CoM converges to its path; larger: faster", "1/s", 0.0, 100.0)
    height_weight: float = _par(5.0, "weight of the CoM's height; larger: kept more closely", "", 0.0, 1e4)
    height_rate: float = _par(4.0, "rate at which the CoM's height converges; larger: faster", "1/s", 0.0, 100.0)
    upright_weight: float = _par(0.1, "weight of an upright pelvis; larger: kept more closely", "", 0.0, 1e4)
    upright_rate: float = _par(5.0, "rate at which the pelvis converges to upright; larger: faster", "1/s", 0.0, 100.0)
    catch: bool = _par(True, "adjust time and place of a step to the measured divergent component of motion")
    catch_margin: float = _par(0.012, "margin of the ankle's pressure; larger: earlier steps", "m", 0.0, 0.1)
    catch_beyond: float = _par(0.01, "error at landing that adjusts a step; larger: fewer", "m", 0.0, 1.0)
    catch_length: float = _par(0.1, "largest adjustment of a step ahead; larger: more effect", "m", 0.0, 0.5)
    catch_side: float = _par(0.0, "largest lateral adjustment of a step; 0 without ankle roll", "m", 0.0, 0.2)
    shortest_step: float = _par(0.26, "least duration of an adjusted swing; smaller: earlier", "s", 0.05, 10.0)
    longest_step: float = _par(1.5, "longest adjusted swing, as a multiple of the planned one", "", 1.0, 5.0)
    hurry: float = _par(0.03, "largest change of the landing time per period; larger: faster", "s", 0.0, 1.0)
    untouched: float = _par(0.04, "time after lift-off without adjustment; larger: later", "s", 0.0, 1.0)
    settled: float = _par(0.12, "time before landing without adjustment; larger: fixed earlier", "s", 0.0, 1.0)


@dataclass(frozen=True)
class PelvisConfig:
    """The pelvis plane (U11)."""

    eta: float = _par(500.0, "rate of (U11), at most 1/dt; larger: faster approach to the plane", "1/s", 1e-3, 1e4)
    height: float = _par(0.2, "height of the plane of (U11) above the sole; larger: higher pelvis", "m", 0.0, 10.0)


@dataclass(frozen=True)
class JointsConfig:
    """Joint limits (U12)-(U13)."""

    eta: float = _par(10.0, "rate of (U12), (U13); larger: faster approach to limits", "1/s", 1e-3, 1e4, live=True)
    margin: float = _par(0.0, "distance kept from both limits; larger: less range", "rad", 0.0, 1.0, live=True)
    velocity: float = _par(0.0, "largest joint velocity; smaller: slower; 0: the URDF's", "rad/s", 0.0, 100.0)


@dataclass(frozen=True)
class QpConfig:
    """The solver of (U6)."""

    solver: Literal["clarabel", "daqp"] = _par("clarabel", "QP solver; daqp, an optional package, is faster")


@dataclass(frozen=True)
class ServoConfig:
    """Position servos behind velocity commands; defaults: Dynamixel MX at 12 V with a raised P gain.

    The parameters ``assumed*`` are the servo model that controller and driver use; the others describe the servos of
    the simulated robot.
    """

    types: tuple[str, ...] = _par((), "servo types of servo.table, JOINT=TYPE; '*' matches any text")
    table: str = _par("servos", "table of servo types: a path, or the name of a file in config/")
    p_gain: int = _par(254, "P register of the servos of servo.types that have one; larger: stiffer", "", 1, 255)
    voltage: float = _par(12.0, "supply voltage of the servos of servo.types; larger: more torque", "V", 1.0, 60.0)

    stiffness: float = _par(60.0, "torque per position error; larger: stiffer (MX-28: 6 to 51)", "N m/rad", 0.1, 1e4)
    damping: float = _par(0.02, "torque per joint velocity, divided by the stiffness; larger: more lag", "s", 0.0, 1.0)
    torque_scale: float = _par(0.81, "stall torque over the URDF's effort (MX-28: 2.5 of 3.1)", "", 0.0, 100.0)
    backlash: float = _par(0.0, "total play of the simulated gears; an MX has 0.0058", "rad", 0.0, 0.1)
    resolution: float = _par(0.00153, "step size of the commanded position; 0: continuous", "rad", 0.0, 0.1)
    friction: float = _par(0.02, "dry friction of the simulated gears", "N m", 0.0, 10.0)
    armature: float = _par(0.01, "inertia of the rotor, reflected through the gears", "kg m^2", 0.0, 1.0)
    rate: float = _par(0.0, "rate at which positions are written; 0: every period", "Hz", 0.0, 1e4)
    latency: float = _par(0.0, "delay from writing a position to its effect in the simulation", "s", 0.0, 0.5)
    window: float = _par(
        0.15, "largest distance of goal and expected angle; smaller: yields more, larger: more torque", "rad", 1e-3, 3.0
    )
    assumed_stiffness: float = _par(
        60.0, "stiffness that converts torques to position offsets; 0: no feedforward", "N m/rad", 0.0, 1e4
    )
    assumed_damping: float = _par(
        0.0, "damping assumed, divided by the stiffness; above the true one the robot falls", "s", 0.0, 0.2
    )
    assumed_lead: float = _par(0.0, "torque fed forward per velocity; larger: less lag", "s", 0.0, 0.2)
    assumed_armature: float = _par(
        0.01, "assumed inertia of the rotor; larger: more torque to swing a leg", "kg m^2", 0.0, 1.0
    )
    assumed_latency: float = _par(
        0.0, "assumed delay from a measurement to the effect of the command that answers it", "s", 0.0, 0.25
    )
    assumed_rate: float = _par(0.0, "assumed rate of writing positions; 0: every period", "Hz", 0.0, 1e4)
    assumed: tuple[str, ...] = _par((), "what `dqwalk identify` found, JOINT=stiffness 49.2, damping 0.009, ...")


@dataclass(frozen=True)
class PhysicsConfig:
    """The simulated world of the physics plant."""

    timestep: float = _par(0.001, "time step of the physics engine; smaller: more accurate, slower", "s", 1e-5, 0.01)
    friction: float = _par(0.8, "friction coefficient between soles and floor; smaller: more slippery", "", 0.0, 5.0)
    contact_time: float = _par(0.005, "time constant of the contact; smaller: harder", "s", 1e-4, 1.0)
    slope: float = _par(0.0, "inclination of the floor, positive: it rises ahead", "rad", -0.5, 0.5)
    slope_side: float = _par(0.0, "lateral inclination of the floor, positive: it rises to the left", "rad", -0.5, 0.5)
    rubble: float = _par(0.0, "largest height of boxes strewn on the floor; 0: no boxes", "m", 0.0, 0.05)
    mass_scale: float = _par(1.0, "factor of all masses and inertias; larger: heavier", "", 0.1, 10.0)
    settle: float = _par(0.5, "time simulated at rest before the walk begins", "s", 0.0, 60.0)
    held: bool = _par(False, "the simulated root link is held level in the air, as in a stand (`dqwalk exercise`)")


@dataclass(frozen=True)
class SensorsConfig:
    """Errors of the simulated sensors, by default zero."""

    encoder: float = _par(0.0, "step size of measured joint angles; 0: continuous; an MX has 0.001534", "rad", 0.0, 0.1)
    velocity_filter: float = _par(0.0, "time constant of the velocities' low-pass; 0: exact", "s", 0.0, 1.0)
    rate: float = _par(0.0, "rate at which the joints are read; 0: every control period", "Hz", 0.0, 1e4)
    age: float = _par(0.0, "delay of a reading; larger: later", "s", 0.0, 0.5)
    attitude_bias: float = _par(0.0, "constant error of the measured vertical, in a random direction", "rad", 0.0, 0.2)
    attitude_noise: float = _par(0.0, "standard deviation of the noise of the measured vertical", "rad", 0.0, 0.2)
    gyro_bias: float = _par(0.0, "constant error of the angular velocity, in a random direction", "rad/s", 0.0, 1.0)
    gyro_noise: float = _par(0.0, "standard deviation of the noise of the angular velocity", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = _par(0.0, "error of the acceleration, random direction", "m/s^2", 0.0, 10.0)
    accelerometer_noise: float = _par(0.0, "standard deviation of the noise of the acceleration", "m/s^2", 0.0, 10.0)
    misalignment: float = _par(0.0, "angle of the inertial sensor's mounting error", "rad", 0.0, 0.5)
    seed: int = _par(0, "seed of all random errors of the sensors and of the rubble", "", 0, 2**31 - 1)


@dataclass(frozen=True)
class PlantConfig:
    """Communication with the plant, a simulator or a robot driver."""

    lockstep: bool = _par(False, "each state waits for its command: deterministic, fast; false: real time")
    clock: bool = _par(False, "a simulated plant publishes /clock; the other nodes then need use_sim_time: true")
    imu: bool = _par(False, "each state comes with a message on imu; the controller waits for both")
    command_timeout: float = _par(0.1, "without a command for this long the plant stops", "s", 0.0, 10.0, live=True)


@dataclass(frozen=True)
class OutputConfig:
    """Commands of the node `drive` to the joint controllers of another robot."""

    type: Literal["float64_multi_array", "joint_trajectory", "joint_state"] = _par(
        "float64_multi_array",
        "message type: 'float64_multi_array' for a forward_command_controller, 'joint_trajectory' for a "
        "joint_trajectory_controller, or 'joint_state'",
    )
    interface: Literal["position", "velocity"] = _par("position", "velocities, or positions within servo.window")
    topic: str = _par("", "command topic of the robot's controller; empty: ros2_control's default")
    joints: tuple[str, ...] = _par((), "joints of that controller in its order; empty: the joints of the model")


@dataclass(frozen=True)
class EstimationConfig:
    """Standard deviations that the estimator of the base assumes."""

    gyro_noise: float = _par(0.002, "noise density of the gyroscope; larger: trusted less", "rad/s/sqrt(Hz)", 1e-6, 1.0)
    accelerometer_noise: float = _par(
        0.04, "noise density of the accelerometer; larger: trusted less", "m/s^2/sqrt(Hz)", 1e-5, 100.0
    )
    gyro_bias: float = _par(0.01, "standard deviation of the gyroscope's bias at the start", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = _par(
        0.12, "standard deviation of the accelerometer's bias at the start", "m/s^2", 0.0, 10.0
    )
    gyro_drift: float = _par(
        1e-5, "random walk of the gyroscope's bias; larger: changes faster", "rad/s/sqrt(s)", 0.0, 1.0
    )
    accelerometer_drift: float = _par(
        1e-4, "random walk of the accelerometer's bias; larger: changes faster", "m/s^2/sqrt(s)", 0.0, 10.0
    )
    kinematics: float = _par(0.001, "error of a sole's heel or toe; larger: trusted less", "m", 1e-5, 0.1)
    slip: float = _par(0.001, "random walk of a standing sole; larger: trusted less", "m/sqrt(s)", 1e-6, 0.1)
    pivot: float = _par(
        0.002, "random walk of a standing sole's direction; larger: contacts count less", "rad/sqrt(s)", 1e-6, 0.1
    )
    floor: float = _par(0.0015, "variation of the floor's height; larger: trusted less", "m", 1e-5, 1.0)


@dataclass(frozen=True)
class MonitorConfig:
    """Diagnostics during the walk."""

    rate: float = _par(10.0, "diagnostics published per second of walking", "Hz", 0.1, 1e3, live=True)
    warn_margin: float = _par(0.002, "distance from a bound that is a warning", "m", 0.0, 1.0, live=True)
    tolerance: float = _par(1e-5, "violation of a bound that is an error", "m", 0.0, 1.0, live=True)


@dataclass(frozen=True)
class NodeConfig:
    """Start, end and interfaces of the ROS nodes."""

    autostart: bool = _par(True, "walk as soon as the first state arrives; false: wait for the service ~/start")
    exit_when_done: bool = _par(False, "exit when the walk is over: code 0 if it finished, 1 if it failed")
    wait_for_recorder: bool = _par(False, "the controller answers the first state only when a recorder is present")
    wait_for_monitor: bool = _par(False, "the controller answers the first state only when a phase_monitor is present")
    robot_description: bool = _par(True, "publish robot_description; false: a robot_state_publisher publishes it")
    stamped_cmd_vel: bool = _par(False, "cmd_vel is a TwistStamped, as with Nav2's enable_stamped_cmd_vel")


@dataclass(frozen=True)
class OdometryConfig:
    """Odometry for Nav2 and RViz [REP-105, REP-120]."""

    odom_frame: str = _par("odom", "frame of the base sole at the start of the walk, fixed in the world")
    base_frame: str = _par("base_link", "base frame: a link of the URDF, or joined to its root on /tf_static")
    footprint_frame: str = _par(
        "base_footprint", "frame on the ground below base_frame; empty, or a link of the URDF: not published"
    )
    step_deviation: float = _par(0.003, "deviation of a step's length; larger: more covariance", "m", 0.0, 1.0)
    turn_deviation: float = _par(0.005, "deviation of a step's turn; larger: more covariance", "rad", 0.0, 1.0)
    window: float = _par(0.1, "time over which the velocity is averaged; larger: smoother, later", "s", 0.001, 10.0)


@dataclass(frozen=True)
class WholeBodyConfig:
    """The whole-body controller of Sherikov, Dimitrov and Wieber, for robots whose ankles pitch and roll.

    Weights are w of 1/2 w ||r||^2 on the third level of the hierarchy, where wrenches are in units of the robot's
    weight. Stiffnesses without a damping of their own are critically damped.
    """

    torso: str = _par("chest", "link that is kept upright (S18), and on which pushes act")
    hand: str = _par("R_hand", "link that reaches for the target (S17)")
    posture: tuple[str, ...] = _par((), "reference posture, 'JOINT: RADIANS'; joints not listed: zero")
    free: tuple[str, ...] = _par((), "joints that are only damped, without reference (S19); '*' matches any text")

    interval: float = _par(0.1, "T, the preview's sampling interval (S10); larger: coarser", "s", 0.01, 1.0)
    intervals: int = _par(16, "N, number of preview intervals; larger: longer, slower", "", 4, 64)
    single_support: float = _par(0.7, "duration of a single support", "s", 0.1, 10.0)
    double_support: float = _par(0.1, "duration of the double support between two steps", "s", 0.01, 10.0)
    first_double_support: float = _par(0.3, "duration of standing before the first step", "s", 0.0, 10.0)
    feet_distance: float = _par(0.19, "lateral distance between the soles' links at the start", "m", 0.05, 1.0)
    cop_length: float = _par(
        0.1372, "length of the rectangle in which the CoP is kept, along x of the sole (S7), (S11)", "m", 0.01, 0.5
    )
    cop_width: float = _par(0.058, "width of that rectangle, along y of the sole", "m", 0.01, 0.5)
    step_length: float = _par(0.2, "largest step ahead of or behind the other foot (S12)", "m", 0.0, 1.0)
    step_width_min: float = _par(0.19, "least lateral distance of a landing foot (S12)", "m", 0.0, 1.0)
    step_width_max: float = _par(0.30, "largest lateral distance of a landing foot (S12)", "m", 0.0, 1.0)
    step_height: float = _par(0.07, "height of the swing foot at mid-swing (S16)", "m", 0.0, 0.3)
    freeze: float = _par(0.05, "time before landing from which its place is fixed", "s", 0.01, 1.0)

    friction: float = _par(0.7, "mu, the friction coefficient assumed in (S4); smaller: more cautious", "", 0.05, 2.0)
    contact_damping: float = _par(10.0, "decay rate of a standing foot's velocity (S8)", "1/s", 0.0, 100.0)
    limit_time: float = _par(0.05, "T of the joint limits (S9); larger: joints brake earlier", "s", 0.005, 1.0)
    effort: float = _par(150.0, "largest joint torque; the URDF's limit where that is smaller", "N m", 1.0, 1e4)
    capturability: bool = _par(True, "second level, capturability (S14); false: the robot falls")

    com_kp: float = _par(100.0, "stiffness of the CoM's height; larger: stiffer", "1/s^2", 0.0, 1e4)
    foot_kp: float = _par(400.0, "stiffness of the swing foot's orientation (S16); larger: stiffer", "1/s^2", 0.0, 1e4)
    hand_kp: float = _par(100.0, "stiffness of the hand's position (S17); larger: stiffer", "1/s^2", 0.0, 1e4)
    hand_saturation: float = _par(11.8, "largest acceleration by the hand's error (S17)", "m/s^2", 0.1, 1e3)
    torso_kp: float = _par(100.0, "stiffness of the torso's orientation (S18); larger: stiffer", "1/s^2", 0.0, 1e4)
    joint_kp: float = _par(25.0, "stiffness of the joints about the posture (S19); larger: stiffer", "1/s^2", 0.0, 1e4)
    joint_kd: float = _par(3.0, "damping of the joints in whole_body.free (S19); larger: more damping", "1/s", 0.0, 1e3)

    hand_weight: float = _par(1.0, "weight of the hand's position (S17); larger: followed more closely", "", 0.0, 1e6)
    torso_weight: float = _par(10.0, "weight of the torso (S18); larger: followed more closely", "", 0.0, 1e6)
    joint_weight: float = _par(0.05, "weight of the posture (S19); larger: followed more closely", "", 0.0, 1e6)
    jerk_weight: float = _par(1e-6, "weight of the swing foot's jerk (S20); larger: smoother", "", 0.0, 1e6)
    cop_weight: float = _par(5e3, "weight of the CoP's offset in its foot (S21); larger: smaller", "", 0.0, 1e9)
    cop_velocity_weight: float = _par(2.0, "weight of the CoP's velocity (S22); larger: slower CoP", "", 0.0, 1e6)
    wrench_weight: float = _par(1e-4, "weight of contact wrenches; larger: smaller wrenches", "", 0.0, 1e6)
    regularization: float = _par(1e-6, "weight of all variables: makes the solution unique", "", 1e-9, 1.0)


@dataclass(frozen=True)
class SafetyConfig:
    """Limits at which a node refuses a state or ends the walk (docs/faults.md)."""

    outside: float = _par(0.1, "distance outside the limits that refuses a state", "rad", 0.0, 1.0)
    tilt: float = _par(0.5, "pelvis inclination (plant.imu) that counts as a fall", "rad", 0.1, 1.5)
    sole_tilt: float = _par(0.2, "inclination of the base sole that ends the walk", "rad", 0.02, 1.5)
    contradiction: float = _par(0.25, "motion error of joint or vertical that ends the walk", "rad", 0.01, 3.0)
    jumps: int = _par(5, "consecutive jumps of the state that end the walk", "", 1, 1000)
    failures: int = _par(10, "consecutive infeasible QPs that end the walk", "", 1, 1000)


@dataclass(frozen=True)
class PoppyConfig:
    """The driver of the real Poppy."""

    motors: str = _par("poppy", "table of the motors: a path, or the name of a file in config/motors/")
    dummy: bool = _par(False, "use emulated servos instead of a robot")
    rate: float = _par(50.0, "rate at which goals are written and angles are read", "Hz", 5.0, 100.0)
    lower_port: str = _par("auto", "serial port of the legs, such as /dev/ttyACM0; auto: search for it")
    upper_port: str = _par("auto", "serial port of the upper body; auto: search for it")
    sync_read: bool = _par(True, "read all motors of a bus at once: USB2AX true, FTDI and U2D2 false")
    calibration: tuple[str, ...] = _par((), "angle of a motor where its joint is at zero, JOINT=DEGREES")
    activate: bool = _par(False, "switch the torque on at start; false: wait for the service ~/activate")
    start_speed: float = _par(0.25, "joint speed to the first posture; larger: faster", "rad/s", 0.01, 1.0)
    start_tolerance: float = _par(0.1, "joint error at which the posture is reached", "rad", 1e-3, 0.5)
    max_speed: float = _par(120.0, "largest speed commanded to a servo; smaller: slower", "deg/s", 2.0, 360.0)
    max_lead: float = _par(0.2, "largest distance of goal and angle; larger: more torque", "rad", 0.01, 1.0)
    hot: float = _par(65.0, "motor temperature above which the robot holds still", "degC", 30.0, 80.0)
    low_voltage: float = _par(10.0, "supply voltage below which the robot holds still; 0: not checked", "V", 0.0, 14.0)
    max_load: float = _par(95.0, "load that counts as blocked after `blocked_after`", "%", 10.0, 1000.0)
    blocked_after: float = _par(1.0, "longest time off the goal; larger: more tolerant", "s", 0.1, 60.0)
    p_gain: int = _par(127, "P register of MX servos (MX-28: 127 is 25 N m/rad); 0: not written", "", 0, 254)
    torque_off_at_end: bool = _par(False, "switch the torque off at the end; false: hold the position")


@dataclass(frozen=True)
class Config:
    """All parameters of a walk."""

    dt: float = _par(0.005, "control period, and step of the Euler integration; smaller: more accurate", "s", 1e-4, 0.1)
    robot: RobotConfig = RobotConfig()
    gait: GaitConfig = GaitConfig()
    task: TaskConfig = TaskConfig()
    dsp: DspConfig = DspConfig()
    ssp: SspConfig = SspConfig()
    standing: StandingConfig = StandingConfig()
    dynamic: DynamicConfig = DynamicConfig()
    pelvis: PelvisConfig = PelvisConfig()
    joints: JointsConfig = JointsConfig()
    qp: QpConfig = QpConfig()
    servo: ServoConfig = ServoConfig()
    physics: PhysicsConfig = PhysicsConfig()
    sensors: SensorsConfig = SensorsConfig()
    plant: PlantConfig = PlantConfig()
    output: OutputConfig = OutputConfig()
    estimation: EstimationConfig = EstimationConfig()
    monitor: MonitorConfig = MonitorConfig()
    safety: SafetyConfig = SafetyConfig()
    poppy: PoppyConfig = PoppyConfig()
    node: NodeConfig = NodeConfig()
    odometry: OdometryConfig = OdometryConfig()
    whole_body: WholeBodyConfig = WholeBodyConfig()

    @classmethod
    def specs(cls) -> tuple[Spec, ...]:
        """Return every parameter, in the order of the schema."""
        return tuple(_specs().values())

    def flat(self) -> dict[str, Value]:
        """Return ``{dotted name: value}``."""
        at: Any = self
        return {name: functools.reduce(getattr, name.split("."), at) for name in _specs()}

    def updated(self, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Return a copy with the values of ``{dotted name: value}`` replaced.

        Raises
        ------
        ConfigError
            For an unknown name, a wrong type or a value out of bounds.
        """
        if "physics.imu" in values:
            values = {"robot.imu" if name == "physics.imu" else name: value for name, value in values.items()}
            if values["robot.imu"] != "imu":  # the former default, which every older recording contains
                warnings.warn(f"{source or 'a configuration'}: 'physics.imu' is now 'robot.imu'", stacklevel=2)
        try:
            checked = {name: _checked(name, value) for name, value in values.items()}
        except ConfigError as error:
            raise ConfigError(f"{source}: {error}" if source else str(error)) from error
        tree: dict[str, dict[str, Value]] = {}
        for name, value in checked.items():
            section, _, key = name.rpartition(".")
            tree.setdefault(section, {})[key] = value
        top: dict[str, Any] = dict(tree.pop("", {}))
        for section, entries in tree.items():
            top[section] = dataclasses.replace(getattr(self, section), **entries)
        return dataclasses.replace(self, **top)


@dataclass(frozen=True)
class Spec:
    """One parameter as the nodes, the command line and the documentation see it.

    Attributes
    ----------
    name : str
        Dotted name, such as ``"ssp.com_radius"``.
    hint : type
        Type annotation with bounds, by which msgspec checks a value.
    type : type
        ``bool``, ``int``, ``float``, ``str`` or ``tuple``.
    default : bool, int, float, str or tuple
    low, high : float or None
        Closed bounds.
    live : bool
        Whether it may be set during a standing walk; it takes effect at the next phase.
    choices : tuple of str
        The values allowed; empty for any value within the bounds.
    """

    name: str
    hint: Any
    type: type
    default: Value
    unit: str
    meaning: str
    low: float | None
    high: float | None
    live: bool
    choices: tuple[str, ...]

    @property
    def expects(self) -> str:
        """Description of the values allowed, such as ``a number in [0, 1]``."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.type is tuple:
            return "a list of numbers" if get_args(get_args(self.hint)[0])[0] is float else "a list of texts"
        kind = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[self.type]
        return kind if self.low is None else f"{kind} in [{self.low:g}, {self.high:g}]"


@functools.cache
def _specs() -> dict[str, Spec]:
    return {spec.name: spec for spec in _section_specs(Config, "")}


def _section_specs(section: Any, prefix: str) -> Iterator[Spec]:
    """Yield the parameters of a section and of its subsections, with `prefix` before each name."""
    hints = get_type_hints(section)
    for field in dataclasses.fields(section):
        hint, meta = hints[field.name], field.metadata
        if dataclasses.is_dataclass(hint):
            yield from _section_specs(hint, f"{prefix}{field.name}.")
            continue
        choices = get_args(hint) if get_origin(hint) is Literal else ()
        yield Spec(
            name=prefix + field.name,
            hint=Annotated[hint, msgspec.Meta(ge=meta["low"], le=meta["high"])],
            type=str if choices else get_origin(hint) or hint,
            default=getattr(section, field.name),
            choices=choices,
            **meta,
        )


def _checked(name: str, value: Any) -> Value:
    """Return a value converted to the type of its parameter.

    Raises
    ------
    ConfigError
        If there is no such parameter, or the value has another type or is out of bounds.
    """
    specs = _specs()
    if name not in specs:
        raise ConfigError(f"unknown parameter {name[:80]!r}{_suggestion(name, specs)}")
    spec = specs[name]
    if spec.type is tuple and isinstance(value, list | tuple):
        value = [item for item in value if item != ""]  # ROS has no empty list: it is written as one empty text
    try:
        checked: Value = msgspec.convert(value, spec.hint)
    except msgspec.ValidationError:
        unit = f" [{spec.unit}]" if spec.unit else ""
        raise ConfigError(f"'{name}' must be {spec.expects}, got {value!r:.80} ({spec.meaning}{unit})") from None
    return checked


def _suggestion(name: str, known: Mapping[str, Any]) -> str:
    """Return the names most similar to an unknown one, as the end of an error message."""
    close = difflib.get_close_matches(name[:100], known, n=3, cutoff=0.6)
    if not close:
        key = name.rpartition(".")[2]
        close = [k for k in known if k.rpartition(".")[2] == key][:3]
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else "; `dqwalk config` lists them all"


def find_share(folder: str, name: str) -> pathlib.Path:
    """Return the path of a data file of this package (``config/``, ``urdf/``, ``launch/``).

    It is searched in the source tree, in the ament index and in ``sys.prefix``, in this order.

    Raises
    ------
    ConfigError
        If the file is not found; the message lists the folders searched.
    """
    roots = [pathlib.Path(__file__).resolve().parent.parent]
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    roots += [pathlib.Path(p) / "share" / "dqwalk_ros" for p in [*prefixes, sys.prefix]]
    for root in roots:
        path = root / folder / name
        if path.is_file():
            return path
    raise ConfigError(f"no file '{name}' in {folder}/ of this package; looked in {', '.join(map(str, roots))}")


SHIPPED = ("paper", "poppy", "poppy_dynamic", "poppy_dynamic_50hz", "whole_body")
"""Names of the configurations in ``config/``."""


def load(source: str | os.PathLike[str]) -> Config:
    """Read a configuration: a path, or the name of a shipped one (``"paper"``).

    Raises
    ------
    ConfigError
        If the file is missing, is not YAML, or has an unknown key or a value out of bounds.
    """
    path = pathlib.Path(source)
    if not path.is_file():
        if path.suffix or len(path.parts) > 1:
            raise ConfigError(f"no configuration file '{path}'")
        if str(path) not in SHIPPED:
            raise ConfigError(f"no configuration '{path}': neither a file nor one of {', '.join(SHIPPED)}")
        path = find_share("config", f"{path}.yaml")
    return beside(path, from_yaml(strict_yaml.read_text(path), source=str(path)))


def beside(path: pathlib.Path, config: Config) -> Config:
    """Return `config` with absolute paths of the files that it names relative to its own file `path`."""
    named = {"robot.urdf": config.robot.urdf, "gait.recover": config.gait.recover}
    found = {name: path.parent / file for name, file in named.items() if file and (path.parent / file).is_file()}
    return config.updated({name: str(file.resolve()) for name, file in found.items()}) if found else config


def from_yaml(text: str, *, source: str = "text", onto: Config | None = None) -> Config:
    """Read a configuration from the text of a ROS parameter file; all other parameters are those of `onto`.

    Raises
    ------
    ConfigError
        As `load`; the message names the line.
    """
    tree = strict_yaml.read(text, source=source)
    if not isinstance(tree, dict) or not all(isinstance(node, dict) for node in tree.values()):
        raise ConfigError(f"{source}: expected '/**: {{ros__parameters: {{...}}}}'")
    config = onto or Config()
    for node, body in tree.items():
        if set(body) != {"ros__parameters"} or not isinstance(body["ros__parameters"], dict):
            raise ConfigError(f"{source}: node '{node}' must hold 'ros__parameters' and nothing else")
        values = _flattened(body["ros__parameters"], "", source)
        values = {name: value for name, value in values.items() if name.split(".")[0] not in OF_RCLPY}
        try:
            config = config.updated(values)
        except ConfigError:
            for name, value in values.items():  # find the parameter, for the line in the message
                line = strict_yaml.line_of(text, [str(node), "ros__parameters", *name.split(".")])
                config.updated({name: value}, source=f"{source}, line {line}")
            raise
    return config


def put_on(config: Config, files: Iterable[pathlib.Path]) -> Config:
    """Return a configuration with the parameters of files applied, one after the other.

    Raises
    ------
    ConfigError
        If a file is missing or cannot be used.
    """
    for path in files:
        if not path.is_file():
            raise ConfigError(f"no parameter file '{path}'")
        config = from_yaml(strict_yaml.read_text(path), source=str(path), onto=config)
    return config


def overlaid(config: Config, plant: str) -> Config:
    """Return a configuration with the parameters of ``config/plants/NAME.yaml`` applied."""
    return put_on(config, [find_share("config/plants", f"{plant}.yaml")])


def _flattened(tree: Mapping[Any, Any], prefix: str, source: str) -> dict[str, Any]:
    """Return ``{dotted name: value}`` of nested dictionaries."""
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            raise ConfigError(f"{source}: the key {prefix}{key!r} is not a text")
        found = _flattened(value, f"{prefix}{key}.", source) if isinstance(value, dict) else {prefix + key: value}
        if duplicates := [name for name in found if name in out]:  # gait.cycles and gait: {cycles: }
            raise ConfigError(f"{source}: '{duplicates[0]}' is given twice")
        out.update(found)
    return out


_SINCE = "# in force from the state with the stamp {} ns"


def since(text: str) -> int | None:
    """Return the stamp [ns] of the state from which a configuration written by `to_yaml` applies; None: from the start.

    A configuration that was changed during a walk contains this stamp as a comment.
    """
    found = re.match(_SINCE.format(r"(-?\d+)"), text)
    return int(found.group(1)) if found else None


def to_yaml(config: Config, since: int | None = None) -> str:
    """Return the configuration as the text of a ROS parameter file; `from_yaml` reads it back exactly.

    An empty list has no type in a ROS parameter file and is written as a list with one empty text. `since` is the stamp
    [ns] of the first state that the configuration applies to, if it was changed during the walk; see `since`.
    """
    tree: dict[str, Any] = {}
    for name, value in config.flat().items():
        section, _, key = name.rpartition(".")
        target = tree.setdefault(section, {}) if section else tree
        target[key] = (list(value) or [""]) if isinstance(value, tuple) else value
    begin = "" if since is None else _SINCE.format(since) + "\n"
    return begin + yaml.dump({"/**": {"ros__parameters": tree}}, Dumper=yaml.CSafeDumper, sort_keys=False)
