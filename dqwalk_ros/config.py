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
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import yaml

from dqwalk_ros import strict_yaml
from dqwalk_ros.errors import ConfigError

__all__ = [
    "Config",
    "DspConfig",
    "DynamicConfig",
    "EstimationConfig",
    "GaitConfig",
    "JointsConfig",
    "MonitorConfig",
    "NodeConfig",
    "OdometryConfig",
    "OutputConfig",
    "PelvisConfig",
    "PhysicsConfig",
    "PlantConfig",
    "PoppyConfig",
    "QpConfig",
    "RobotConfig",
    "SafetyConfig",
    "SensorsConfig",
    "ServoConfig",
    "Spec",
    "SspConfig",
    "StandingConfig",
    "TaskConfig",
    "WholeBodyConfig",
    "beside",
    "find_share",
    "from_yaml",
    "load",
    "since",
    "to_yaml",
]

OF_RCLPY = ("use_sim_time", "qos_overrides", "start_type_description_service")
"""Parameters that every node of rclpy has; ``ros2 param dump`` writes them too."""

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
    """Declare a parameter: its default, what it means, its unit, and its closed bounds."""
    return dataclasses.field(
        default=default, metadata={"meaning": meaning, "unit": unit, "low": low, "high": high, "live": live}
    )


@dataclass(frozen=True)
class RobotConfig:
    """Which robot, and which part of it."""

    urdf: str = _par("poppy.urdf", "URDF or xacro: a path, relative to this file, or the name of one shipped in urdf/")
    pelvis: str = _par("pelvis", "link whose height (U11) watches")
    left_sole: str = _par("l_sole", "link at the centre of the left sole, x forward, z up")
    right_sole: str = _par("r_sole", "link at the centre of the right sole, x forward, z up")
    left_sole_xyz: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "centre of the left sole in that link", "m")
    left_sole_rpy: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "its roll, pitch and yaw there", "rad")
    right_sole_xyz: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "centre of the right sole in that link", "m")
    right_sole_rpy: tuple[float, float, float] = _par((0.0, 0.0, 0.0), "its roll, pitch and yaw there", "rad")
    imu: str = _par("", "link of the inertial sensor; empty: the pelvis")
    imu_rpy: tuple[float, float, float] = _par(
        (0.0, 0.0, 0.0), "roll, pitch and yaw at which it is mounted in that link (`dqwalk identify`)", "rad"
    )
    drop: tuple[str, ...] = _par((), "joints cut off together with all they carry")
    lock: tuple[str, ...] = _par((), "joints held at zero, or at an angle: JOINT=RADIANS; '*' matches any text")
    sole_center: Literal["link", "foot_com"] = _par(
        "link",
        "where the sole's centre is: 'link' (the sole link's origin) or 'foot_com' (below the foot's centre of mass)",
    )
    sole_length: float = _par(0.0, "length of the sole; 0 takes the sole link's box", "m", 0.0, 1.0)
    sole_width: float = _par(0.0, "width of the sole; 0 takes the sole link's box", "m", 0.0, 1.0)


@dataclass(frozen=True)
class GaitConfig:
    """Where the feet go."""

    style: Literal["paper", "standing", "dynamic"] = _par(
        "paper",
        "'paper' (Fig. 1: planes and a cylinder), 'standing' (the CoM stays over the true soles) or 'dynamic' (it does "
        "not: docs/dynamic.md)",
    )
    walk: str = _par("", "a walk of your own in place of the style's, as MODULE:CLASS; docs/tutorial.md makes one")
    first_support: Literal["left", "right"] = _par("left", "the foot that carries the weight first")
    cycles: int = _par(1, "walking cycles, of four phases each (Fig. 1)", "", 1, 100000)
    step_length: float = _par(0.05, "landing place of the swing foot ahead of the support foot", "m", -0.5, 0.5)
    step_width: float = _par(
        0.0, "lateral distance of the soles' centres; 0 keeps that of the zero posture", "m", 0.0, 1.0
    )
    steps: int = _par(4, "standing: steps before the feet are put together; 0 walks as cmd_vel says", "", 0, 100000)
    step_side: float = _par(0.0, "standing: sideways part of each step, positive to the left", "m", -0.2, 0.2)
    step_turn: float = _par(0.0, "standing: turn of each step, positive to the left", "rad", -0.8, 0.8)
    step_height: float = _par(0.02, "standing: height of the swing foot's via point", "m", 0.0, 0.2, live=True)
    most_length: float = _par(0.05, "standing: longest step that cmd_vel can ask for", "m", 0.0, 0.5, live=True)
    most_side: float = _par(0.05, "standing: longest step to a side that cmd_vel can ask for", "m", 0.0, 0.2, live=True)
    most_turn: float = _par(0.1, "standing: largest turn per step that cmd_vel can ask for", "rad", 0.0, 0.8, live=True)
    footstep_tolerance: float = _par(
        0.01,
        "standing: a commanded footstep is moved by so much at most to where the legs reach",
        "m",
        0.0,
        0.1,
        live=True,
    )
    cmd_vel_timeout: float = _par(
        0.5, "without a new cmd_vel for this long the feet are put together", "s", 0.0, 60.0, live=True
    )
    phase_timeout: float = _par(900.0, "a phase that takes longer has failed", "s", 0.1, 1e5, live=True)


@dataclass(frozen=True)
class TaskConfig:
    """The objective of (U6)."""

    eta: float = _par(0.05, "convergence rate of the task error in (U6)", "1/s", 1e-6, 1e3, live=True)
    damping: float = _par(0.1, "lambda, the damping of the joint velocities in (U6)", "", 1e-6, 1e3, live=True)
    posture_weight: float = _par(
        0.0, "weight of a task back to the zero posture (0: none, as in the paper)", "", 0.0, 1e3, live=True
    )


@dataclass(frozen=True)
class DspConfig:
    """Double support, section 4.1."""

    eta_sliding: float = _par(5.0, "rate of (U7)", "1/s", 1e-3, 1e4)
    sliding_radius: float = _par(0.04, "the end foot's tip may slide this far", "m", 1e-4, 1.0)
    eta_ground: float = _par(5.0, "rate of (U8) and of the flat-foot rows", "1/s", 1e-3, 1e4)
    flat_feet: bool = _par(True, "keep the end sole parallel to the ground; false: the literal (U8), its tip only")
    eta_tip: float = _par(10.0, "rate of (U9)", "1/s", 1e-3, 1e4)
    eta_back: float = _par(20.0, "rate of (U10)", "1/s", 1e-3, 1e4)
    stall_rate: float = _par(
        1e-4, "the phase is over when the error falls by less than this in a stall_window", "m", 1e-9, 1.0
    )
    stall_window: float = _par(1.0, "time over which the fall of the error is judged", "s", 0.01, 1e3)


@dataclass(frozen=True)
class SspConfig:
    """Single support, section 4.2."""

    eta_com: float = _par(5.0, "rate of (U14)", "1/s", 1e-3, 1e4)
    com_radius: float = _par(0.05, "radius of the cylinder that holds the CoM in (U14)", "m", 1e-4, 1.0)
    threshold: float = _par(1e-3, "the phase is over when ||vec8(x - x_d)|| is below this", "", 1e-9, 1.0)


@dataclass(frozen=True)
class StandingConfig:
    """The walk that stands: the CoM inside the edges of the true soles."""

    margin: float = _par(0.008, "distance kept from each edge of the support polygon", "m", 0.0, 0.1, live=True)
    eta_edges: float = _par(5.0, "rate of the edges", "1/s", 1e-3, 1e4, live=True)
    eta_feet: float = _par(
        5.0, "rate at which the end sole is held in place; 0 only keeps it at rest", "1/s", 0.0, 1e4, live=True
    )
    recovery: float = _par(0.02, "a distance beyond its bound returns no faster than this", "m/s", 1e-4, 1e3, live=True)
    transfer_duration: float = _par(1.5, "time of the CoM's path from foot to foot", "s", 0.05, 60.0, live=True)
    swing_duration: float = _par(1.5, "time of the swing foot's path", "s", 0.05, 60.0, live=True)
    com_threshold: float = _par(0.003, "a double support is over when the CoM is this close", "m", 1e-5, 0.1, live=True)
    swing_threshold: float = _par(
        0.002, "a single support is over when the sole is this close", "m", 1e-5, 0.1, live=True
    )
    saturation: float = _par(0.03, "the CoM error is limited to this length", "m", 1e-4, 1.0, live=True)
    com_weight: float = _par(
        0.3, "weight of the CoM over the support sole while the other foot swings", "", 0.0, 1e3, live=True
    )
    swing_weight: float = _par(10.0, "weight of the swing foot's path", "", 1e-3, 1e4, live=True)
    swing_rate: float = _par(10.0, "convergence of the swing foot to its path", "1/s", 0.1, 1e3, live=True)
    lever: float = _par(0.2, "length that converts angles of the swing foot to distances", "m/rad", 1e-3, 10.0)
    balance: float = _par(
        0.5, "gain of the torques that draw the CoM to its path; 0: gravity only", "", 0.0, 10.0, live=True
    )
    pressure_margin: float = _par(
        0.004, "least distance from an edge at which the torques put the CoP", "m", 0.0, 0.1, live=True
    )
    sole_gap: float = _par(0.004, "least distance of the soles beside each other", "m", 0.0, 0.2, live=True)
    posture: tuple[str, ...] = _par((), "posture in which a walk begins, JOINT=RADIANS, '*' matches any text; others 0")


@dataclass(frozen=True)
class DynamicConfig:
    """The walk that moves; durations of a step, weights and gains that it shares with the standing walk are there."""

    start_duration: float = _par(0.6, "time in which the first step begins, from rest", "s", 0.1, 10.0)
    stop_duration: float = _par(1.0, "time in which the CoM comes to rest between the feet", "s", 0.1, 10.0)
    ramp: int = _par(3, "steps over which the length grows to that asked for, and shrinks", "", 0, 100)
    aim_ahead: float = _par(0.0, "the zero-moment point is aimed this far ahead of the sole's centre", "m", -0.1, 0.1)
    aim_inside: float = _par(0.0, "and this far towards the other foot", "m", -0.05, 0.05)
    side_frequency: float = _par(
        1.0, "part of the pendulum's frequency to the side by the model that is used", "", 0.5, 1.5
    )
    com_weight: float = _par(20.0, "weight of the CoM's path", "", 1e-3, 1e4)
    com_rate: float = _par(2.0, "convergence of the CoM to its path", "1/s", 0.0, 100.0)
    height_weight: float = _par(5.0, "weight of the CoM's height, that of the posture", "", 0.0, 1e4)
    height_rate: float = _par(4.0, "convergence of the CoM's height", "1/s", 0.0, 100.0)
    upright_weight: float = _par(0.1, "weight of an upright pelvis", "", 0.0, 1e4)
    upright_rate: float = _par(5.0, "convergence of the pelvis to upright", "1/s", 0.0, 100.0)
    catch: bool = _par(True, "adjust time and place of a step to the divergent component as it is measured")
    catch_margin: float = _par(
        0.012, "the ankle is trusted with a zero-moment point this far inside the sole", "m", 0.0, 0.1
    )
    catch_beyond: float = _par(
        0.01, "a step is adjusted where the ankle leaves over more than this at the landing", "m", 0.0, 1.0
    )
    catch_length: float = _par(0.1, "a landing place is moved this far ahead or back at most", "m", 0.0, 0.5)
    catch_side: float = _par(0.0, "and to the side; 0 without ankle roll", "m", 0.0, 0.2)
    shortest_step: float = _par(0.26, "least time of a single support that is adjusted", "s", 0.05, 10.0)
    longest_step: float = _par(1.5, "its greatest time, as a multiple of the planned one", "", 1.0, 5.0)
    hurry: float = _par(0.03, "the time of landing changes by this at most at one state", "s", 0.0, 1.0)
    untouched: float = _par(0.04, "a step is not adjusted this long after it has begun", "s", 0.0, 1.0)
    settled: float = _par(0.12, "nor this long before the foot lands", "s", 0.0, 1.0)


@dataclass(frozen=True)
class PelvisConfig:
    """The pelvis plane (U11)."""

    eta: float = _par(500.0, "rate of (U11); 1/dt is used where it is larger", "1/s", 1e-3, 1e4)
    height: float = _par(0.2, "height of the plane above the support sole", "m", 0.0, 10.0)


@dataclass(frozen=True)
class JointsConfig:
    """Joint limits (U12)-(U13)."""

    eta: float = _par(10.0, "rate of (U12) and (U13)", "1/s", 1e-3, 1e4, live=True)
    margin: float = _par(0.0, "distance kept from both limits", "rad", 0.0, 1.0, live=True)
    velocity: float = _par(0.0, "largest joint velocity inside the QP; 0: no limit", "rad/s", 0.0, 100.0)


@dataclass(frozen=True)
class QpConfig:
    """How (U6) is solved."""

    solver: Literal["clarabel", "daqp"] = _par(
        "clarabel", "solver of the QP; daqp, an extra, gives the same answers in less time"
    )


@dataclass(frozen=True)
class ServoConfig:
    """Position servos that are told velocities; defaults: Dynamixel MX at 12 V with a raised P gain.

    What is assumed is what the controller and the driver are told; the rest is how the servos of the physics are.
    """

    types: tuple[str, ...] = _par((), "servos of a type of the table, JOINT=TYPE; '*' matches any text")
    table: str = _par("servos", "table of the types: a path, or the name of one in config/")
    p_gain: int = _par(254, "P register of the servos of a type that has one", "", 1, 255)
    voltage: float = _par(12.0, "supply of the servos of a type", "V", 1.0, 60.0)

    stiffness: float = _par(
        60.0, "torque per position error; an MX-28 has 6 at its default P gain and 51 at most", "N m/rad", 0.1, 1e4
    )
    damping: float = _par(0.02, "torque per speed, divided by the stiffness", "s", 0.0, 1.0)
    torque_scale: float = _par(
        0.81, "stall torque as a part of the URDF's effort (MX-28: 2.5 of 3.1 N m)", "", 0.0, 100.0
    )
    backlash: float = _par(0.0, "play of the gears; an MX has 0.0058", "rad", 0.0, 0.1)
    resolution: float = _par(0.00153, "smallest step of the commanded position", "rad", 0.0, 0.1)
    friction: float = _par(0.02, "dry friction of the gears", "N m", 0.0, 10.0)
    armature: float = _par(0.01, "inertia of the rotor behind the gears", "kg m^2", 0.0, 1.0)
    rate: float = _par(0.0, "positions are written this often; 0: every period", "Hz", 0.0, 1e4)
    latency: float = _par(0.0, "a written position takes effect this much later", "s", 0.0, 0.5)
    window: float = _par(0.15, "the commanded position stays this close to the measured one", "rad", 1e-3, 3.0)
    assumed_stiffness: float = _par(
        60.0, "stiffness by which torques are fed forward; 0: not at all; a type has its own", "N m/rad", 0.0, 1e4
    )
    assumed_damping: float = _par(
        0.0, "damping that is fed forward; more than the servos truly have falls; a type has its own", "s", 0.0, 0.2
    )
    assumed_lead: float = _par(
        0.0, "torque fed forward per commanded speed, divided by the stiffness: no lag by damping", "s", 0.0, 0.2
    )
    assumed_latency: float = _par(0.0, "delay from a measurement to the effect of its answer", "s", 0.0, 0.25)
    assumed_rate: float = _par(0.0, "positions are written this often; 0: every period", "Hz", 0.0, 1e4)
    assumed: tuple[str, ...] = _par((), "what `dqwalk identify` found, JOINT=stiffness 49.2, damping 0.009, ...")


@dataclass(frozen=True)
class PhysicsConfig:
    """The world of the physics plant."""

    timestep: float = _par(0.001, "step of the physics engine", "s", 1e-5, 0.01)
    friction: float = _par(0.8, "friction coefficient of the soles on the floor", "", 0.0, 5.0)
    contact_time: float = _par(
        0.005, "time constant of the contact of sole and floor; smaller is harder", "s", 1e-4, 1.0
    )
    slope: float = _par(0.0, "the floor rises ahead by this angle", "rad", -0.5, 0.5)
    slope_side: float = _par(0.0, "the floor rises to the left by this angle", "rad", -0.5, 0.5)
    rubble: float = _par(0.0, "boxes up to this high lie on the floor", "m", 0.0, 0.05)
    mass_scale: float = _par(1.0, "masses and inertias are multiplied by this", "", 0.1, 10.0)
    settle: float = _par(0.5, "time to come to rest before the walk", "s", 0.0, 60.0)
    held: bool = _par(False, "the root link is held in the air, level, as in a stand (`dqwalk exercise`)")


@dataclass(frozen=True)
class SensorsConfig:
    """What the sensors of the physics get wrong; all are exact by default."""

    encoder: float = _par(0.0, "joint angles are read in steps of this; an MX has 0.001534", "rad", 0.0, 0.1)
    velocity_filter: float = _par(
        0.0, "joint velocities are differences of readings, low-passed with this time constant; 0: exact", "s", 0.0, 1.0
    )
    rate: float = _par(0.0, "the joints are read this often; 0: every period", "Hz", 0.0, 1e4)
    age: float = _par(0.0, "a reading is this old when it arrives", "s", 0.0, 0.5)
    attitude_bias: float = _par(0.0, "error of the inertial sensor's vertical, in a random direction", "rad", 0.0, 0.2)
    attitude_noise: float = _par(0.0, "standard deviation of its noise", "rad", 0.0, 0.2)
    gyro_bias: float = _par(0.0, "error of the angular velocity, in a random direction", "rad/s", 0.0, 1.0)
    gyro_noise: float = _par(0.0, "standard deviation of its noise", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = _par(0.0, "error of the acceleration, in a random direction", "m/s^2", 0.0, 10.0)
    accelerometer_noise: float = _par(0.0, "standard deviation of its noise", "m/s^2", 0.0, 10.0)
    misalignment: float = _par(0.0, "the inertial sensor is mounted askew by this", "rad", 0.0, 0.5)
    seed: int = _par(0, "of all that is random here and on the floor", "", 0, 2**31 - 1)


@dataclass(frozen=True)
class PlantConfig:
    """The other side of the command."""

    lockstep: bool = _par(False, "each state waits for its command: exact, and as fast as the machine")
    clock: bool = _par(False, "a simulated plant publishes /clock; the other nodes then take use_sim_time: true")
    imu: bool = _par(False, "each state comes with a message on imu; the controller waits for both")
    command_timeout: float = _par(0.1, "without a new command for this long the plant holds", "s", 0.0, 10.0, live=True)


@dataclass(frozen=True)
class OutputConfig:
    """What the node `drive` tells the controllers of a robot of your own."""

    type: Literal["float64_multi_array", "joint_trajectory", "joint_state"] = _par(
        "float64_multi_array",
        "messages: 'float64_multi_array' for a forward_command_controller, 'joint_trajectory' for a "
        "joint_trajectory_controller, or 'joint_state'",
    )
    interface: Literal["position", "velocity"] = _par(
        "position", "what the joints are told: velocities, or positions within servo.window of the measured ones"
    )
    topic: str = _par("", "topic of the robot's controller; empty: that of ros2_control's own for type and interface")
    joints: tuple[str, ...] = _par((), "joints of that controller in its order; empty: those of the walk")


@dataclass(frozen=True)
class EstimationConfig:
    """How sure the estimate of the base takes its sources to be; standard deviations."""

    gyro_noise: float = _par(0.002, "noise density of the gyroscope", "rad/s/sqrt(Hz)", 1e-6, 1.0)
    accelerometer_noise: float = _par(0.04, "noise density of the accelerometer", "m/s^2/sqrt(Hz)", 1e-5, 100.0)
    gyro_bias: float = _par(0.01, "bias of the gyroscope at the start", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = _par(0.12, "bias of the accelerometer at the start", "m/s^2", 0.0, 10.0)
    gyro_drift: float = _par(1e-5, "random walk of the gyroscope's bias", "rad/s/sqrt(s)", 0.0, 1.0)
    accelerometer_drift: float = _par(1e-4, "random walk of the accelerometer's bias", "m/s^2/sqrt(s)", 0.0, 10.0)
    kinematics: float = _par(0.001, "place of a sole's heel or toe by the joint angles", "m", 1e-5, 0.1)
    slip: float = _par(0.001, "random walk of a sole that stands", "m/sqrt(s)", 1e-6, 0.1)
    pivot: float = _par(0.002, "random walk of the direction of a sole that stands", "rad/sqrt(s)", 1e-6, 0.1)
    floor: float = _par(0.0015, "height of the floor from footfall to footfall", "m", 1e-5, 1.0)


@dataclass(frozen=True)
class MonitorConfig:
    """What is reported while walking."""

    rate: float = _par(10.0, "diagnostics per second of walking", "Hz", 0.1, 1e3, live=True)
    warn_margin: float = _par(0.002, "a distance closer than this to its bound is a warning", "m", 0.0, 1.0, live=True)
    tolerance: float = _par(1e-5, "a distance beyond its bound by more than this is an error", "m", 0.0, 1.0, live=True)


@dataclass(frozen=True)
class NodeConfig:
    """How the ROS nodes start and end."""

    autostart: bool = _par(True, "walk as soon as the first state arrives; false: wait for ~/start")
    exit_when_done: bool = _par(False, "the controller exits when the walk is over: 0 if it finished, 1 if it failed")
    wait_for_recorder: bool = _par(False, "the first tick waits for a recorder")
    wait_for_monitor: bool = _par(False, "the first tick waits for a phase_monitor")
    robot_description: bool = _par(True, "publish robot_description; false where a robot_state_publisher does")
    stamped_cmd_vel: bool = _par(False, "cmd_vel is a TwistStamped, as with Nav2's enable_stamped_cmd_vel")


@dataclass(frozen=True)
class OdometryConfig:
    """Where the robot is, for Nav2 and RViz [REP-105, REP-120]."""

    odom_frame: str = _par("odom", "frame of the base sole at the very start")
    base_frame: str = _par("base_link", "frame of the URDF's root link, to which it is joined on /tf_static")
    footprint_frame: str = _par("base_footprint", "frame on the ground below it; empty: none")
    step_deviation: float = _par(0.003, "standard deviation of a step's length and width", "m", 0.0, 1.0)
    turn_deviation: float = _par(0.005, "standard deviation of a step's turn", "rad", 0.0, 1.0)
    window: float = _par(0.1, "the velocity is that of the last so long", "s", 0.001, 10.0)


@dataclass(frozen=True)
class WholeBodyConfig:
    """The whole-body controller of Sherikov, Dimitrov and Wieber; a robot with ankles that roll.

    Weights are w of 1/2 w ||r||^2 on the third level; wrenches are in units of the robot's weight there.
    """

    torso: str = _par("chest", "link that is kept upright (S18), and that pushes act on")
    hand: str = _par("R_hand", "link that reaches (S17)")
    posture: tuple[str, ...] = _par((), "angles of the posture, 'JOINT: RADIANS'; all others are zero")
    free: tuple[str, ...] = _par((), "joints that are only damped, without a reference (S19); '*' matches any text")

    interval: float = _par(0.1, "T, the sampling interval of the preview (S10)", "s", 0.01, 1.0)
    intervals: int = _par(16, "N, the number of intervals previewed", "", 4, 64)
    single_support: float = _par(0.7, "duration of a single support", "s", 0.1, 10.0)
    double_support: float = _par(0.1, "duration of the double support between steps", "s", 0.01, 10.0)
    first_double_support: float = _par(0.3, "standing before the first step", "s", 0.0, 10.0)
    feet_distance: float = _par(0.19, "lateral distance of the soles at the start", "m", 0.05, 1.0)
    cop_length: float = _par(0.1372, "rectangle of the CoP around the sole's link, along x (S7), (S11)", "m", 0.01, 0.5)
    cop_width: float = _par(0.058, "width of that rectangle, along y", "m", 0.01, 0.5)
    step_length: float = _par(0.2, "a foot lands at most this far ahead of or behind the other (S12)", "m", 0.0, 1.0)
    step_width_min: float = _par(0.19, "least lateral distance of a landing foot from the other (S12)", "m", 0.0, 1.0)
    step_width_max: float = _par(0.30, "greatest lateral distance (S12)", "m", 0.0, 1.0)
    step_height: float = _par(0.07, "height of the swing foot in the middle of a step (S16)", "m", 0.0, 0.3)
    freeze: float = _par(0.05, "the landing place is settled this long before the landing", "s", 0.01, 1.0)

    friction: float = _par(0.7, "mu of (S4)", "", 0.05, 2.0)
    contact_damping: float = _par(10.0, "rate at which a velocity of a standing foot decays (S8)", "1/s", 0.0, 100.0)
    limit_time: float = _par(0.05, "T of the joint limits (S9)", "s", 0.005, 1.0)
    effort: float = _par(150.0, "greatest joint torque; the URDF's where that is less", "N m", 1.0, 1e4)
    capturability: bool = _par(True, "the second level, (S14); without it the robot falls")

    com_kp: float = _par(100.0, "stiffness of the CoM's height", "1/s^2", 0.0, 1e4)
    foot_kp: float = _par(400.0, "stiffness of the swing foot's orientation (S16)", "1/s^2", 0.0, 1e4)
    hand_kp: float = _par(100.0, "stiffness of (S17); all damping is critical", "1/s^2", 0.0, 1e4)
    hand_saturation: float = _par(
        11.8, "largest acceleration asked of the hand along each axis (S17)", "m/s^2", 0.1, 1e3
    )
    torso_kp: float = _par(100.0, "stiffness of (S18)", "1/s^2", 0.0, 1e4)
    joint_kp: float = _par(25.0, "stiffness of (S19)", "1/s^2", 0.0, 1e4)
    joint_kd: float = _par(3.0, "damping of the free joints (S19)", "1/s", 0.0, 1e3)

    hand_weight: float = _par(1.0, "weight of (S17)", "", 0.0, 1e6)
    torso_weight: float = _par(10.0, "weight of (S18)", "", 0.0, 1e6)
    joint_weight: float = _par(0.05, "weight of (S19)", "", 0.0, 1e6)
    jerk_weight: float = _par(1e-6, "weight of (S20), the swing foot's jerk", "", 0.0, 1e6)
    cop_weight: float = _par(5e3, "weight of (S21), the CoP in the middle of the feet", "", 0.0, 1e9)
    cop_velocity_weight: float = _par(2.0, "weight of (S22)", "", 0.0, 1e6)
    wrench_weight: float = _par(1e-4, "weight of the contact wrenches; not in the paper", "", 0.0, 1e6)
    regularization: float = _par(
        1e-6, "weight of all variables, which makes the answer unique; not in the paper", "", 1e-9, 1.0
    )


@dataclass(frozen=True)
class SafetyConfig:
    """What a node refuses (docs/faults.md)."""

    outside: float = _par(0.1, "a state further outside the joint limits is refused", "rad", 0.0, 1.0)
    tilt: float = _par(0.5, "a pelvis that leans further (plant.imu) has fallen: the walk ends", "rad", 0.1, 1.5)
    sole_tilt: float = _par(0.2, "so has a base sole that leans further: it has lost its ground", "rad", 0.02, 1.5)
    contradiction: float = _par(
        0.25, "a joint, or a vertical, that moves by so much otherwise than it should ends the walk", "rad", 0.01, 3.0
    )
    jumps: int = _par(5, "consecutive jumps of the state that end the walk", "", 1, 1000)
    failures: int = _par(10, "consecutive infeasible QPs that end the walk", "", 1, 1000)


@dataclass(frozen=True)
class PoppyConfig:
    """The driver of the real Poppy."""

    motors: str = _par("poppy", "table of the motors: a path, or the name of one in config/motors/")
    dummy: bool = _par(False, "emulated servos instead of a robot")
    rate: float = _par(50.0, "goals sent and angles read per second", "Hz", 5.0, 100.0)
    lower_port: str = _par("auto", "serial port of the legs, such as /dev/ttyACM0")
    upper_port: str = _par("auto", "serial port of the upper body")
    sync_read: bool = _par(True, "read all motors of a bus at once: USB2AX yes, FTDI and U2D2 no")
    calibration: tuple[str, ...] = _par((), "angle that the motors show at a joint's zero, JOINT=DEGREES")
    activate: bool = _par(False, "the driver switches the torque on at start; false: ~/activate does")
    start_speed: float = _par(0.25, "speed of the way to the first pose", "rad/s", 0.01, 1.0)
    start_tolerance: float = _par(0.1, "distance at which a joint counts as in the first pose", "rad", 1e-3, 0.5)
    max_speed: float = _par(120.0, "largest speed asked of a servo", "deg/s", 2.0, 360.0)
    max_lead: float = _par(0.2, "largest distance of a goal from the measured angle", "rad", 0.01, 1.0)
    hot: float = _par(65.0, "the robot holds still when a motor is hotter", "degC", 30.0, 80.0)
    low_voltage: float = _par(10.0, "the robot holds still when a motor has less; 0: never", "V", 0.0, 14.0)
    max_load: float = _par(95.0, "load of a motor that counts as blocked after `blocked_after`", "%", 10.0, 1000.0)
    blocked_after: float = _par(1.0, "longest time for which a joint may not follow its goal", "s", 0.1, 60.0)
    p_gain: int = _par(127, "P register of MX servos (MX-28: 127 is 25 N m/rad, 32 is 6); 0: as it is", "", 0, 254)
    torque_off_at_end: bool = _par(False, "the motors go limp when the driver ends; false: they stay as they are")


@dataclass(frozen=True)
class Config:
    """All parameters of a walk."""

    dt: float = _par(0.005, "control period, and the step of Euler's integration", "s", 1e-4, 0.1)
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

    @classmethod
    def from_flat(cls, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Build a configuration from ``{dotted name: value}``; parameters that are not named keep their defaults.

        Raises
        ------
        ConfigError
            For an unknown name, a wrong type or a value out of bounds.
        """
        return cls().updated(values, source=source)

    def updated(self, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Return a copy with some values replaced, checked as in `from_flat`."""
        if "physics.imu" in values:
            values = {"robot.imu" if name == "physics.imu" else name: value for name, value in values.items()}
            if values["robot.imu"] != "imu":  # its default then, which is in every recorded configuration
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
        The annotation: type, bounds and meaning, as msgspec reads them.
    type : type
        ``bool``, ``int``, ``float``, ``str`` or ``tuple``.
    default : bool, int, float, str or tuple
    unit, meaning : str
    low, high : float or None
        Closed bounds.
    live : bool
        It may be set while a standing walk goes on, and counts from the next phase on.
    choices : tuple of str
        The only values allowed; empty where any text is.
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
        """What a value must be, in words."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.type is tuple:
            return "a list of numbers" if get_args(get_args(self.hint)[0])[0] is float else "a list of texts"
        kind = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[self.type]
        return kind if self.low is None else f"{kind} in [{self.low:g}, {self.high:g}]"


@functools.cache
def _specs() -> dict[str, Spec]:
    return {spec.name: spec for spec in _walked(Config, "")}


def _walked(section: Any, prefix: str) -> Iterator[Spec]:
    hints = get_type_hints(section)
    for field in dataclasses.fields(section):
        hint, meta = hints[field.name], field.metadata
        if dataclasses.is_dataclass(hint):
            yield from _walked(hint, f"{prefix}{field.name}.")
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
    """Return a value in the type of its parameter, or say why it cannot be."""
    specs = _specs()
    if name not in specs:
        raise ConfigError(f"unknown parameter {name[:80]!r}{_hint(name, specs)}")
    spec = specs[name]
    if spec.type is tuple and isinstance(value, list | tuple):
        value = [item for item in value if item != ""]  # ROS has no empty list: it is written as one empty text
    try:
        checked: Value = msgspec.convert(value, spec.hint)
    except msgspec.ValidationError:
        unit = f" [{spec.unit}]" if spec.unit else ""
        raise ConfigError(f"'{name}' must be {spec.expects}, got {value!r:.80} ({spec.meaning}{unit})") from None
    return checked


def _hint(name: str, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(name[:100], known, n=3, cutoff=0.6)
    if not close:
        key = name.rpartition(".")[2]
        close = [k for k in known if k.rpartition(".")[2] == key][:3]
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else "; `dqwalk config` lists them all"


def find_share(folder: str, name: str) -> pathlib.Path:
    """Return the path of a data file of this package (``config/``, ``urdf/``, ``launch/``).

    The search goes from the sources to the ament index to ``sys.prefix``.

    Raises
    ------
    ConfigError
        If the file is in none of these places; the message lists them.
    """
    roots = [pathlib.Path(__file__).resolve().parent.parent]
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    roots += [pathlib.Path(p) / "share" / "dqwalk_ros" for p in [*prefixes, sys.prefix]]
    for root in roots:
        path = root / folder / name
        if path.is_file():
            return path
    raise ConfigError(f"no file '{name}' in {folder}/ of this package; looked in {', '.join(map(str, roots))}")


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
        path = find_share("config", f"{path}.yaml")
    return beside(path, from_yaml(strict_yaml.read_text(path), source=str(path)))


def beside(path: pathlib.Path, config: Config) -> Config:
    """Return a configuration whose URDF is found from anywhere: its path is relative to the file that names it."""
    urdf = path.parent / config.robot.urdf
    return config.updated({"robot.urdf": str(urdf.resolve())}) if config.robot.urdf and urdf.is_file() else config


def from_yaml(text: str, *, source: str = "text", onto: Config | None = None) -> Config:
    """Read a configuration from the text of a ROS parameter file; parameters it does not name are those of `onto`.

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
            for name, value in values.items():  # which one was it?
                line = strict_yaml.line_of(text, [str(node), "ros__parameters", *name.split(".")])
                config.updated({name: value}, source=f"{source}, line {line}")
            raise
    return config


def _flattened(tree: Mapping[Any, Any], prefix: str, source: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            raise ConfigError(f"{source}: the key {prefix}{key!r} is not a text")
        found = _flattened(value, f"{prefix}{key}.", source) if isinstance(value, dict) else {prefix + key: value}
        if doubled := [name for name in found if name in out]:  # gait.cycles and gait: {cycles: }
            raise ConfigError(f"{source}: '{doubled[0]}' is given twice")
        out.update(found)
    return out


_SINCE = "# in force from the state with the stamp {} ns"


def since(text: str) -> int | None:
    """Return the stamp [ns] of the state from which the configuration of a text is in force; None: from the start."""
    found = re.match(_SINCE.format(r"(-?\d+)"), text)
    return int(found.group(1)) if found else None


def to_yaml(config: Config, since: int | None = None) -> str:
    """Return the configuration as the text of a ROS parameter file; `from_yaml` reads it back exactly.

    An empty list has no type in a ROS parameter file and is written as a list with one empty text. One that was changed
    while the robot walked tells since which stamp [ns].
    """
    tree: dict[str, Any] = {}
    for name, value in config.flat().items():
        section, _, key = name.rpartition(".")
        target = tree.setdefault(section, {}) if section else tree
        target[key] = (list(value) or [""]) if isinstance(value, tuple) else value
    begin = "" if since is None else _SINCE.format(since) + "\n"
    return begin + str(yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False))
