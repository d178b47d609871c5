"""Every tunable of the package: its default, unit, meaning and bounds.

One schema serves plain Python (`load`), the command line and the parameters of the ROS nodes; a
configuration file is a ROS parameter file::

    /**:
      ros__parameters:
        dt: 0.005
        ssp: {com_radius: 0.05}
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
import pathlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from dqwalk_ros import strict_yaml
from dqwalk_ros.errors import ConfigError

__all__ = [
    "Config",
    "DspConfig",
    "GaitConfig",
    "JointsConfig",
    "MonitorConfig",
    "NodeConfig",
    "PelvisConfig",
    "PhysicsConfig",
    "PlantConfig",
    "PoppyConfig",
    "QpConfig",
    "RobotConfig",
    "SafetyConfig",
    "ServoConfig",
    "Spec",
    "SspConfig",
    "StandingConfig",
    "TaskConfig",
    "WholeBodyConfig",
    "find_share",
    "from_yaml",
    "load",
    "to_yaml",
]

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]


def _par(
    default: Value,
    meaning: str,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
    structural: bool = False,
) -> Any:
    """Declare one parameter as a dataclass field that carries its own documentation."""
    meta = {
        "meaning": meaning,
        "unit": unit,
        "low": low,
        "high": high,
        "choices": choices,
        "structural": structural,
    }
    return dataclasses.field(default=default, metadata=meta)


@dataclass(frozen=True)
class Spec:
    """One parameter as the nodes, the command line and the documentation see it.

    Attributes
    ----------
    name : str
        Dotted name, such as ``"ssp.com_radius"``.
    type : type
        ``bool``, ``int``, ``float``, ``str`` or ``tuple`` (of strings, or of floats).
    default : bool, int, float, str or tuple
    unit, meaning : str
    low, high : float or None
        Closed bounds.
    choices : tuple of str
        The only values allowed, where there are any.
    structural : bool
        Fixed once a node runs (it shapes the model or the process).
    """

    name: str
    type: type
    default: Value
    unit: str
    meaning: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    structural: bool


@dataclass(frozen=True)
class RobotConfig:
    """Which robot, and which part of it."""

    urdf: str = _par("poppy.urdf", "URDF file: a path, or the name of one shipped in urdf/", structural=True)
    pelvis: str = _par("pelvis", "link whose height (11) watches", structural=True)
    left_sole: str = _par("l_sole", "link at the centre of the left sole, x forward, z up", structural=True)
    right_sole: str = _par("r_sole", "link at the centre of the right sole, x forward, z up", structural=True)
    drop: tuple[str, ...] = _par((), "joints cut off together with all they carry", structural=True)
    lock: tuple[str, ...] = _par((), "joints held at zero; '*' at either end matches any text", structural=True)
    sole_center: str = _par(
        "link",
        "where the sole's centre is: 'link' (the sole link's origin) or 'foot_com' (below the foot's centre of mass)",
        choices=("link", "foot_com"),
        structural=True,
    )
    sole_length: float = _par(0.0, "length of the sole; 0 takes the sole link's box", "m", 0.0, 1.0, structural=True)
    sole_width: float = _par(0.0, "width of the sole; 0 takes the sole link's box", "m", 0.0, 1.0, structural=True)


@dataclass(frozen=True)
class GaitConfig:
    """Where the feet go."""

    style: str = _par(
        "paper",
        "'paper' (Fig. 1: planes and a cylinder) or 'standing' (the CoM stays over the true soles)",
        choices=("paper", "standing"),
        structural=True,
    )
    first_support: str = _par("left", "the foot that carries the weight first", choices=("left", "right"))
    cycles: int = _par(1, "walking cycles, of four phases each (Fig. 1)", "", 1, 100000)
    step_length: float = _par(0.05, "landing place of the swing foot ahead of the support foot", "m", -0.5, 0.5)
    step_width: float = _par(
        0.0, "lateral distance of the soles' centres; 0 keeps that of the zero posture", "m", 0.0, 1.0
    )
    steps: int = _par(4, "standing: steps before the feet are put together; 0 walks as cmd_vel says", "", 0, 100000)
    step_side: float = _par(0.0, "standing: each step this far to the left", "m", -0.2, 0.2)
    step_turn: float = _par(0.0, "standing: each step turns this far to the left", "rad", -0.8, 0.8)
    step_height: float = _par(0.02, "standing: height of the swing foot's via point", "m", 0.0, 0.2)
    most_length: float = _par(0.05, "standing, steered: cmd_vel asks for no longer step", "m", 0.0, 0.5)
    most_side: float = _par(0.05, "standing, steered: nor for one further aside", "m", 0.0, 0.2)
    most_turn: float = _par(0.1, "standing, steered: nor for one that turns further", "rad", 0.0, 0.8)
    cmd_vel_timeout: float = _par(0.5, "without a new cmd_vel for this long the feet are put together", "s", 0.0, 60.0)
    phase_timeout: float = _par(900.0, "a phase that takes longer has failed", "s", 0.1, 1e5)


@dataclass(frozen=True)
class TaskConfig:
    """The objective of (6)."""

    eta: float = _par(0.05, "convergence rate of the task error in (6)", "1/s", 1e-6, 1e3)
    damping: float = _par(0.1, "lambda, the damping of the joint velocities in (6)", "", 1e-6, 1e3)
    posture_weight: float = _par(
        0.0, "weight of a task back to the zero posture (0: none, as in the paper)", "", 0.0, 1e3
    )


@dataclass(frozen=True)
class DspConfig:
    """Double support, section 4.1."""

    eta_sliding: float = _par(5.0, "rate of (7)", "1/s", 1e-3, 1e4)
    sliding_radius: float = _par(0.04, "the end foot's tip may slide this far", "m", 1e-4, 1.0)
    eta_ground: float = _par(5.0, "rate of (8) and of the flat-foot rows", "1/s", 1e-3, 1e4)
    flat_feet: bool = _par(True, "keep the end sole parallel to the ground; false: the literal (8), its tip only")
    eta_tip: float = _par(10.0, "rate of (9)", "1/s", 1e-3, 1e4)
    eta_back: float = _par(20.0, "rate of (10)", "1/s", 1e-3, 1e4)
    stall_rate: float = _par(
        1e-4, "the phase is over when the error falls by less than this in a stall_window", "m", 1e-9, 1.0
    )
    stall_window: float = _par(1.0, "time over which the fall of the error is judged", "s", 0.01, 1e3)


@dataclass(frozen=True)
class SspConfig:
    """Single support, section 4.2."""

    eta_com: float = _par(5.0, "rate of (14)", "1/s", 1e-3, 1e4)
    com_radius: float = _par(0.05, "radius of the cylinder that holds the CoM in (14)", "m", 1e-4, 1.0)
    threshold: float = _par(1e-3, "the phase is over when ||vec8(x - x_d)|| is below this", "", 1e-9, 1.0)


@dataclass(frozen=True)
class StandingConfig:
    """The walk that stands: the CoM inside the edges of the true soles."""

    margin: float = _par(0.008, "each edge of the support polygon is moved in by this", "m", 0.0, 0.1)
    eta_edges: float = _par(5.0, "rate of the edges", "1/s", 1e-3, 1e4)
    eta_feet: float = _par(5.0, "rate at which the end sole is held in place; 0 only keeps it at rest", "1/s", 0.0, 1e4)
    recovery: float = _par(0.02, "what is beyond its bound is led back no faster than this", "m/s", 1e-4, 1e3)
    transfer_duration: float = _par(1.5, "time of the CoM's path from foot to foot", "s", 0.05, 60.0)
    swing_duration: float = _par(1.5, "time of the swing foot's path", "s", 0.05, 60.0)
    com_threshold: float = _par(0.003, "a double support is over when the CoM is this close", "m", 1e-5, 0.1)
    swing_threshold: float = _par(0.002, "a single support is over when the sole is this close", "m", 1e-5, 0.1)
    saturation: float = _par(0.03, "larger CoM errors are answered like this one", "m", 1e-4, 1.0)
    com_weight: float = _par(0.3, "weight of the CoM over the support sole while the other foot swings", "", 0.0, 1e3)
    swing_weight: float = _par(10.0, "weight of the swing foot's path", "", 1e-3, 1e4)
    swing_rate: float = _par(10.0, "convergence of the swing foot to its path", "1/s", 0.1, 1e3)
    lever: float = _par(0.2, "what an angle of the swing foot counts", "m/rad", 1e-3, 10.0)
    balance: float = _par(0.5, "gain of the torques that draw the CoM to its path; 0: gravity only", "", 0.0, 10.0)
    pressure_margin: float = _par(0.004, "the torques ask for no pressure closer to an edge than this", "m", 0.0, 0.1)
    sole_gap: float = _par(0.004, "least distance of the soles beside each other", "m", 0.0, 0.2)
    posture: tuple[str, ...] = _par((), "angles of the posture task, JOINT=RADIANS, '*' matches any text; others 0")


@dataclass(frozen=True)
class PelvisConfig:
    """The pelvis plane (11)."""

    eta: float = _par(500.0, "rate of (11); 1/dt is used where it is larger", "1/s", 1e-3, 1e4)
    height: float = _par(0.2, "height of the plane above the support sole", "m", 0.0, 10.0)


@dataclass(frozen=True)
class JointsConfig:
    """Joint limits (12)-(13)."""

    eta: float = _par(10.0, "rate of (12) and (13)", "1/s", 1e-3, 1e4)
    margin: float = _par(0.0, "moves both limits inwards", "rad", 0.0, 1.0)
    velocity: float = _par(0.0, "largest joint velocity inside the quadratic program; 0: none", "rad/s", 0.0, 100.0)


@dataclass(frozen=True)
class QpConfig:
    """How (6) is solved."""

    solver: str = _par(
        "clarabel",
        "solver of the QP; daqp, an extra, gives the same answers in less time",
        choices=("clarabel", "daqp"),
        structural=True,
    )


@dataclass(frozen=True)
class ServoConfig:
    """Position servos that are told velocities; defaults: Dynamixel MX at 12 V with a raised P gain."""

    stiffness: float = _par(
        60.0, "torque per angle of error; an MX-28 has 6 at its default P and 51 at most", "N m/rad", 0.1, 1e4
    )
    damping: float = _par(0.02, "torque per speed, as a part of the stiffness", "s", 0.0, 1.0)
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
        60.0, "stiffness by which the torque of gravity is fed forward; 0: not at all", "N m/rad", 0.0, 1e4
    )


@dataclass(frozen=True)
class PhysicsConfig:
    """The world of the physics plant."""

    timestep: float = _par(0.001, "step of the physics engine", "s", 1e-5, 0.01)
    friction: float = _par(0.8, "of the soles on the floor", "", 0.0, 5.0)
    contact_time: float = _par(
        0.005, "time constant of the contact between sole and floor: less is harder", "s", 1e-4, 1.0
    )
    mass_scale: float = _par(1.0, "masses and inertias are multiplied by this", "", 0.1, 10.0)
    settle: float = _par(0.5, "time to come to rest before the walk", "s", 0.0, 60.0)
    imu: str = _par("imu", "link of the inertial sensor", structural=True)


@dataclass(frozen=True)
class PlantConfig:
    """The other side of the command."""

    lockstep: bool = _par(False, "each state waits for its command: exact, and as fast as the machine", structural=True)
    imu: bool = _par(False, "each state comes with a message on imu; the controller waits for both", structural=True)
    command_timeout: float = _par(0.1, "without a new command for this long the plant holds", "s", 0.0, 10.0)


@dataclass(frozen=True)
class MonitorConfig:
    """What is reported while walking."""

    rate: float = _par(10.0, "diagnostics per second of walking", "Hz", 0.1, 1e3)
    warn_margin: float = _par(0.002, "a distance closer than this to its bound is a warning", "m", 0.0, 1.0)
    tolerance: float = _par(1e-5, "a distance beyond its bound by more than this is an error", "m", 0.0, 1.0)


@dataclass(frozen=True)
class NodeConfig:
    """How the ROS nodes start and end."""

    autostart: bool = _par(True, "walk as soon as the first state arrives; false: wait for ~/start", structural=True)
    exit_when_done: bool = _par(
        False, "the controller exits when the walk is over: 0 if it finished, 1 if it failed", structural=True
    )
    wait_for_recorder: bool = _par(False, "the first tick waits until a recorder listens", structural=True)
    wait_for_monitor: bool = _par(False, "the plant's first tick waits for a phase_monitor too", structural=True)


@dataclass(frozen=True)
class WholeBodyConfig:
    """The whole-body controller of Sherikov, Dimitrov and Wieber; a robot with ankles that roll.

    Weights are w of 1/2 w ||r||^2 on the third level; wrenches are in units of the robot's weight there.
    """

    torso: str = _par("chest", "link that is kept upright (18), and that pushes act on", structural=True)
    hand: str = _par("R_hand", "link that reaches (17)", structural=True)
    posture: tuple[str, ...] = _par((), "'joint: angle' of the posture; what is not named is zero", structural=True)
    free: tuple[str, ...] = _par((), "joints only damped, without a reference (19); '*' is any text", structural=True)

    interval: float = _par(0.1, "T, the sampling interval of the preview (10)", "s", 0.01, 1.0, structural=True)
    intervals: int = _par(16, "N, the number of intervals previewed", "", 4, 64, structural=True)
    single_support: float = _par(0.7, "duration of a single support", "s", 0.1, 10.0, structural=True)
    double_support: float = _par(0.1, "duration of the double support between steps", "s", 0.01, 10.0, structural=True)
    first_double_support: float = _par(0.3, "standing before the first step", "s", 0.0, 10.0, structural=True)
    feet_distance: float = _par(0.19, "lateral distance of the soles at the start", "m", 0.05, 1.0, structural=True)
    cop_length: float = _par(0.1372, "rectangle of the CoP around the sole's link, along x (7), (11)", "m", 0.01, 0.5)
    cop_width: float = _par(0.058, "the same along y", "m", 0.01, 0.5)
    step_length: float = _par(0.2, "a foot lands at most this far ahead of or behind the other (12)", "m", 0.0, 1.0)
    step_width_min: float = _par(0.19, "least lateral distance of a landing foot from the other (12)", "m", 0.0, 1.0)
    step_width_max: float = _par(0.30, "greatest lateral distance (12)", "m", 0.0, 1.0)
    step_height: float = _par(0.07, "height of the swing foot in the middle of a step (16)", "m", 0.0, 0.3)
    freeze: float = _par(0.05, "the landing place is settled this long before the landing", "s", 0.01, 1.0)

    friction: float = _par(0.7, "mu of (4)", "", 0.05, 2.0)
    contact_damping: float = _par(10.0, "rate at which a velocity of a standing foot decays (8)", "1/s", 0.0, 100.0)
    limit_time: float = _par(0.05, "T of the joint limits (9)", "s", 0.005, 1.0)
    effort: float = _par(150.0, "greatest joint torque; the URDF's where that is less", "N m", 1.0, 1e4)
    capturability: bool = _par(True, "the second level, (14); without it the robot falls")

    com_kp: float = _par(100.0, "stiffness of the CoM's height", "1/s^2", 0.0, 1e4)
    foot_kp: float = _par(400.0, "stiffness of the swing foot's orientation (16)", "1/s^2", 0.0, 1e4)
    hand_kp: float = _par(100.0, "stiffness of (17); all damping is critical", "1/s^2", 0.0, 1e4)
    hand_saturation: float = _par(11.8, "the hand is pulled by at most this along each axis (17)", "m/s^2", 0.1, 1e3)
    torso_kp: float = _par(100.0, "stiffness of (18)", "1/s^2", 0.0, 1e4)
    joint_kp: float = _par(25.0, "stiffness of (19)", "1/s^2", 0.0, 1e4)
    joint_kd: float = _par(3.0, "damping of the free joints (19)", "1/s", 0.0, 1e3)

    hand_weight: float = _par(1.0, "weight of (17)", "", 0.0, 1e6)
    torso_weight: float = _par(10.0, "weight of (18)", "", 0.0, 1e6)
    joint_weight: float = _par(0.05, "weight of (19)", "", 0.0, 1e6)
    jerk_weight: float = _par(1e-6, "weight of (20), the swing foot's jerk", "", 0.0, 1e6)
    cop_weight: float = _par(5e3, "weight of (21), the CoP in the middle of the feet", "", 0.0, 1e9)
    cop_velocity_weight: float = _par(2.0, "weight of (22)", "", 0.0, 1e6)
    wrench_weight: float = _par(1e-4, "weight of the contact wrenches; not in the paper", "", 0.0, 1e6)
    regularization: float = _par(1e-6, "weight of all variables, for one answer; not in the paper", "", 1e-9, 1.0)


@dataclass(frozen=True)
class SafetyConfig:
    """What a node refuses (docs/faults.md)."""

    outside: float = _par(0.1, "a state further outside the joint limits is refused", "rad", 0.0, 1.0, structural=True)
    jumps: int = _par(5, "jumps of the state in a row that end the walk", "", 1, 1000, structural=True)
    failures: int = _par(10, "programs without an answer in a row that end the walk", "", 1, 1000, structural=True)


@dataclass(frozen=True)
class PoppyConfig:
    """The driver of the real Poppy."""

    motors: str = _par("poppy", "table of the motors: a path, or the name of one in config/motors/", structural=True)
    dummy: bool = _par(False, "pypot's dummy motors instead of a robot", structural=True)
    rate: float = _par(50.0, "goals sent and angles read per second", "Hz", 5.0, 100.0, structural=True)
    lower_port: str = _par("auto", "serial port of the legs, such as /dev/ttyACM0", structural=True)
    upper_port: str = _par("auto", "serial port of the upper body", structural=True)
    sync_read: bool = _par(True, "read all motors of a bus at once: USB2AX yes, FTDI and U2D2 no", structural=True)
    calibration: tuple[str, ...] = _par((), "what pypot shows at a joint's zero, as JOINT=DEGREES", structural=True)
    start_speed: float = _par(0.25, "speed of the way to the first pose", "rad/s", 0.01, 1.0, structural=True)
    start_tolerance: float = _par(
        0.1, "joints this near to the first pose are there", "rad", 1e-3, 0.5, structural=True
    )
    max_speed: float = _par(120.0, "no servo is told to turn faster", "deg/s", 2.0, 360.0, structural=True)
    max_lead: float = _par(0.2, "a goal is never further from its joint", "rad", 0.01, 1.0, structural=True)
    hot: float = _par(65.0, "the robot holds still when a motor is hotter", "degC", 30.0, 80.0, structural=True)
    torque_off_at_end: bool = _par(False, "the motors go limp when the driver ends; false: they hold", structural=True)


@dataclass(frozen=True)
class Config:
    """All parameters of a walk."""

    dt: float = _par(0.005, "control period, and the step of Euler's integration", "s", 1e-4, 0.1, structural=True)
    robot: RobotConfig = dataclasses.field(default_factory=RobotConfig)
    gait: GaitConfig = dataclasses.field(default_factory=GaitConfig)
    task: TaskConfig = dataclasses.field(default_factory=TaskConfig)
    dsp: DspConfig = dataclasses.field(default_factory=DspConfig)
    ssp: SspConfig = dataclasses.field(default_factory=SspConfig)
    standing: StandingConfig = dataclasses.field(default_factory=StandingConfig)
    pelvis: PelvisConfig = dataclasses.field(default_factory=PelvisConfig)
    joints: JointsConfig = dataclasses.field(default_factory=JointsConfig)
    qp: QpConfig = dataclasses.field(default_factory=QpConfig)
    servo: ServoConfig = dataclasses.field(default_factory=ServoConfig)
    physics: PhysicsConfig = dataclasses.field(default_factory=PhysicsConfig)
    plant: PlantConfig = dataclasses.field(default_factory=PlantConfig)
    monitor: MonitorConfig = dataclasses.field(default_factory=MonitorConfig)
    safety: SafetyConfig = dataclasses.field(default_factory=SafetyConfig)
    poppy: PoppyConfig = dataclasses.field(default_factory=PoppyConfig)
    node: NodeConfig = dataclasses.field(default_factory=NodeConfig)
    whole_body: WholeBodyConfig = dataclasses.field(default_factory=WholeBodyConfig)

    @classmethod
    def specs(cls) -> tuple[Spec, ...]:
        """Return every parameter, in the order of the schema."""
        return tuple(_specs(cls(), ""))

    def flat(self) -> dict[str, Value]:
        """Return ``{dotted name: value}``."""
        return {spec.name: _get(self, spec.name) for spec in self.specs()}

    @classmethod
    def from_flat(cls, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Build a configuration from ``{dotted name: value}``; what is not named keeps its default.

        Raises
        ------
        ConfigError
            For an unknown name, a wrong type or a value out of bounds.
        """
        return cls().updated(values, source=source)

    def updated(self, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Return a copy with some values replaced, checked as in `from_flat`."""
        specs = {spec.name: spec for spec in self.specs()}
        tree: dict[str, dict[str, Value]] = {}
        for name, value in values.items():
            if name not in specs:
                raise ConfigError(f"{_where(source)}unknown parameter '{name[:80]}'{_hint(name, specs)}")
            section, _, key = name.rpartition(".")
            tree.setdefault(section, {})[key] = _checked(specs[name], value, source)
        top: dict[str, Any] = dict(tree.pop("", {}))
        for section, entries in tree.items():
            top[section] = dataclasses.replace(getattr(self, section), **entries)
        return dataclasses.replace(self, **top)


def _specs(node: Any, prefix: str) -> list[Spec]:
    out: list[Spec] = []
    for field in dataclasses.fields(node):
        value = getattr(node, field.name)
        if dataclasses.is_dataclass(value):
            out += _specs(value, f"{prefix}{field.name}.")
            continue
        out.append(Spec(name=prefix + field.name, type=type(value), default=value, **field.metadata))
    return out


def _get(config: Config, name: str) -> Value:
    node: Any = config
    for part in name.split("."):
        node = getattr(node, part)
    value: Value = node
    return value


def _where(source: str) -> str:
    return f"{source}: " if source else ""


def _hint(name: str, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(name[:100], known, n=3, cutoff=0.6)
    if not close:
        key = name.rpartition(".")[2]
        close = [k for k in known if k.rpartition(".")[2] == key][:3]
    return f"; did you mean {' or '.join(repr(c) for c in close)}?" if close else "; `dqwalk config` lists them all"


def _checked(spec: Spec, value: Any, source: str) -> Value:
    """Return `value` in the type of `spec`, or say why it cannot be."""

    def wrong(what: str) -> ConfigError:
        unit = f" [{spec.unit}]" if spec.unit else ""
        return ConfigError(f"{_where(source)}'{spec.name}' {what}, got {value!r:.80} ({spec.meaning}{unit})")

    if spec.type is bool:
        if not isinstance(value, bool):
            raise wrong("must be true or false")
        return value
    if spec.type is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise wrong("must be a whole number")
    elif spec.type is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong("must be a number")
        value = float(value) if abs(value) < 1e308 else math.inf  # a whole number may be larger than any real one
        if not math.isfinite(value):
            raise wrong("must be finite")
    elif spec.type is str:
        if not isinstance(value, str):
            raise wrong("must be a text")
        if spec.choices and value not in spec.choices:
            raise wrong(f"must be one of {', '.join(spec.choices)}")
        return value
    else:
        if isinstance(value, str) or not isinstance(value, list | tuple):
            raise wrong("must be a list")
        if not all(isinstance(item, str) for item in value):
            raise wrong("must be a list of texts")
        return tuple(item for item in value if item)
    if (spec.low is not None and value < spec.low) or (spec.high is not None and value > spec.high):
        raise wrong(f"must lie in [{spec.low:g}, {spec.high:g}]")
    number: Value = value
    return number


def find_share(folder: str, name: str) -> pathlib.Path:
    """Return the path of a data file of this package (``config/``, ``urdf/``, ``launch/``).

    It is looked for beside the sources, then in the ament index, then below ``sys.prefix``.

    Raises
    ------
    ConfigError
        Where none of these has it; the message lists the places.
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
    """Read a configuration: a path, or the name of one of ours (``"paper"``).

    Raises
    ------
    ConfigError
        If the file is missing, is not YAML, or has a key or a value that does not fit.
    """
    path = pathlib.Path(source)
    if not path.is_file():
        if path.suffix or len(path.parts) > 1:
            raise ConfigError(f"no configuration file '{path}'")
        path = find_share("config", f"{path}.yaml")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read '{path}': {error}") from error
    return from_yaml(text, source=str(path))


def from_yaml(text: str, *, source: str = "", onto: Config | None = None) -> Config:
    """Read a configuration from the text of a ROS parameter file; what it does not name is as in `onto`.

    Raises
    ------
    ConfigError
        As `load`.
    """
    tree, lines = strict_yaml.read(text, source=source)
    if not isinstance(tree, dict) or not all(isinstance(node, dict) for node in tree.values()):
        raise ConfigError(f"{_where(source)}expected '/**: {{ros__parameters: {{...}}}}'")
    config = onto or Config()
    for node, body in tree.items():
        if set(body) != {"ros__parameters"} or not isinstance(body["ros__parameters"], dict):
            raise ConfigError(f"{_where(source)}node '{node}' must hold 'ros__parameters' and nothing else")
        values = _flattened(body["ros__parameters"], "", source)
        for name, value in values.items():
            line = lines.get((str(node), "ros__parameters", *name.split(".")))
            config = config.updated({name: value}, source=f"{source or 'text'}, line {line}" if line else source)
    return config


def _flattened(tree: Mapping[Any, Any], prefix: str, source: str) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            raise ConfigError(f"{_where(source)}the key {prefix}{key!r} is not a text")
        found = _flattened(value, f"{prefix}{key}.", source) if isinstance(value, dict) else {prefix + key: value}
        if doubled := [name for name in found if name in out]:  # gait.cycles and gait: {cycles: }
            raise ConfigError(f"{_where(source)}'{doubled[0]}' is given twice")
        out.update(found)
    return out


def to_yaml(config: Config) -> str:
    """Return the configuration as the text of a ROS parameter file; `from_yaml` reads it back exactly.

    An empty list has no type in a ROS parameter file and is written as a list with one empty text.
    """
    tree: dict[str, Any] = {}
    for name, value in config.flat().items():
        section, _, key = name.rpartition(".")
        target = tree.setdefault(section, {}) if section else tree
        target[key] = (list(value) or [""]) if isinstance(value, tuple) else value
    return str(yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False))
