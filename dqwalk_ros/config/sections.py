"""Every parameter of a section: its default, unit, meaning and bounds, in one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dqwalk_ros.config.schema import parameter

ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotConfig:
    """The robot description and the links and joints of it that the walk uses."""

    urdf: str = parameter("poppy.urdf", "URDF or xacro: a path relative to this file, or the name of a file in urdf/")
    pelvis: str = parameter("pelvis", "link whose height above the support sole is bounded by (U11)")
    left_sole: str = parameter("l_sole", "link of the left sole, origin at its centre, x forward, z up")
    right_sole: str = parameter("r_sole", "link of the right sole, origin at its centre, x forward, z up")
    left_sole_xyz: tuple[float, float, float] = parameter(ZERO, "centre of the sole in left_sole", "m", -10, 10)
    left_sole_rpy: tuple[float, float, float] = parameter(ZERO, "roll, pitch, yaw of the sole in it", "rad", -6.3, 6.3)
    right_sole_xyz: tuple[float, float, float] = parameter(ZERO, "centre of the sole in right_sole", "m", -10, 10)
    right_sole_rpy: tuple[float, float, float] = parameter(ZERO, "roll, pitch, yaw of the sole in it", "rad", -6.3, 6.3)
    imu: str = parameter("", "link of the inertial sensor; empty: the pelvis")
    imu_rpy: tuple[float, float, float] = parameter(ZERO, "roll, pitch, yaw of the sensor in it", "rad", -6.3, 6.3)
    drop: tuple[str, ...] = parameter((), "joints removed together with all links after them; '*' matches any text")
    lock: tuple[str, ...] = parameter((), "joints fixed at zero, or at an angle: JOINT=RADIANS; '*' matches any text")
    mass: float = parameter(
        0.0,
        "mass as weighed; scales the masses and inertias of the URDF; larger: more torque; 0: the URDF's",
        "kg",
        0.0,
        1e4,
    )
    payload: tuple[str, ...] = parameter(
        (), "masses carried at the origins of links, in kg: LINK=MASS, such as l_hand=0.3; not part of robot.mass"
    )
    sole_center: Literal["link", "foot_com"] = parameter(
        "link",
        "centre of the sole: 'link' (origin of the sole link) or 'foot_com' (below the foot's centre of mass)",
    )
    sole_length: float = parameter(0.0, "length of the sole; 0: that of the sole link's collision box", "m", 0.0, 1.0)
    sole_width: float = parameter(0.0, "width of the sole; 0: that of the sole link's collision box", "m", 0.0, 1.0)


@dataclass(frozen=True)
class GaitConfig:
    """Kind of walk, length of the walk and its footsteps."""

    style: Literal["paper", "standing", "dynamic"] = parameter(
        "paper",
        "'paper' (Fig. 1: bounded by planes and a cylinder), 'standing' (statically stable: the CoM stays over "
        "the soles) or 'dynamic' (dynamically stable: docs/dynamic.md)",
    )
    walk: str = parameter("", "class of your own walk, as MODULE:CLASS, in place of gait.style (docs/tutorial.md)")
    recover: str = parameter(
        "",
        "standing: dynamic walk whose steps catch pushes that one sole cannot balance, such as poppy_dynamic, or a "
        "file relative to that of the configuration; empty: none",
    )
    first_support: Literal["left", "right"] = parameter("left", "foot of the first single support")
    cycles: int = parameter(1, "paper: number of walking cycles of four phases each (Fig. 1)", "", 1, 100000)
    step_length: float = parameter(
        0.05, "paper: landing place ahead of the support foot; otherwise: advance per step", "m", -0.5, 0.5
    )
    step_width: float = parameter(0.0, "lateral distance of the soles' centres; 0: that at zero angles", "m", 0.0, 1.0)
    steps: int = parameter(
        4, "standing, dynamic: steps before the feet are put together; 0: steered by cmd_vel", "", 0, 100000
    )
    step_side: float = parameter(0.0, "lateral part of each step, positive: left; not paper", "m", -0.2, 0.2)
    step_turn: float = parameter(0.0, "rotation of each step, positive: left; not paper", "rad", -0.8, 0.8)
    step_height: float = parameter(0.02, "height of the swing foot; larger: more clearance", "m", 0.001, 0.2, live=True)
    climb: float = parameter(0.0, "dynamic: largest height of a step that is climbed by touch; 0: off", "m", 0.0, 0.1)
    most_length: float = parameter(0.05, "longest step that cmd_vel can command", "m", 0.0, 0.5, live=True)
    most_side: float = parameter(0.05, "longest lateral step that cmd_vel can command", "m", 0.0, 0.2, live=True)
    most_turn: float = parameter(0.1, "largest rotation per step that cmd_vel can command", "rad", 0.0, 0.8, live=True)
    footsteps: tuple[str, ...] = parameter(
        (),
        "standing, dynamic: the steps of the walk, each AHEAD LEFT TURN UP of the body, but UP of the foot over the "
        "other one [m, m, rad, m]; needs gait.steps: 0",
    )
    footstep_tolerance: float = parameter(
        0.01,
        "largest correction of a commanded footstep, and height up to which soles count as level; larger: fewer are "
        "refused",
        "m",
        0.0,
        0.1,
        live=True,
    )
    cmd_vel_timeout: float = parameter(
        0.5, "without a new cmd_vel for this time the robot puts its feet together", "s", 0.0, 60.0, live=True
    )
    phase_timeout: float = parameter(
        900.0, "longest duration of a phase; beyond it: an error", "s", 0.1, 1e5, live=True
    )


@dataclass(frozen=True)
class TaskConfig:
    """Parameters of the objective (U6)."""

    eta: float = parameter(0.05, "convergence rate of the error in (U6); larger: faster", "1/s", 1e-6, 1e3, live=True)
    damping: float = parameter(0.1, "lambda, velocity damping in (U6); larger: slower", "", 1e-6, 1e3, live=True)
    posture_weight: float = parameter(
        0.0, "weight of a task that keeps standing.posture; larger: closer to it; 0: off", "", 0.0, 1e3, live=True
    )


@dataclass(frozen=True)
class DspConfig:
    """Double support, section 4.1."""

    eta_sliding: float = parameter(5.0, "rate of (U7); larger: the tip slides faster to its limit", "1/s", 1e-3, 1e4)
    sliding_radius: float = parameter(0.04, "radius of (U7); larger: the tip may slide further", "m", 1e-4, 1.0)
    eta_ground: float = parameter(5.0, "rate of (U8) and flat_feet; larger: faster correction", "1/s", 1e-3, 1e4)
    flat_feet: bool = parameter(True, "keep the end sole parallel to the ground; false: only its tip, the literal (U8)")
    eta_tip: float = parameter(10.0, "rate of (U9); larger: faster approach to the front plane", "1/s", 1e-3, 1e4)
    eta_back: float = parameter(20.0, "rate of (U10); larger: faster approach to the back plane", "1/s", 1e-3, 1e4)
    stall_rate: float = parameter(
        1e-4, "smallest decrease of the error per stall_window; below it the phase ends", "m", 1e-9, 1.0
    )
    stall_window: float = parameter(1.0, "time over which the decrease of the error is measured", "s", 0.01, 1e3)


@dataclass(frozen=True)
class SspConfig:
    """Single support, section 4.2."""

    eta_com: float = parameter(5.0, "rate of (U14); larger: faster approach to the cylinder", "1/s", 1e-3, 1e4)
    com_radius: float = parameter(0.05, "radius of (U14); larger: the CoM may move further", "m", 1e-4, 1.0)
    threshold: float = parameter(1e-3, "||vec8(x - x_d)|| that ends the phase; larger: earlier", "", 1e-9, 1.0)


@dataclass(frozen=True)
class StandingConfig:
    """The standing walk: the CoM is kept inside the support polygon of the real soles."""

    margin: float = parameter(0.008, "distance of the CoM from the edges; larger: safer", "m", 0.0, 0.1, live=True)
    eta_edges: float = parameter(5.0, "rate of the edges; larger: faster approach to them", "1/s", 1e-3, 1e4, live=True)
    eta_feet: float = parameter(
        5.0, "rate of the end sole's pose; larger: faster; 0: at rest", "1/s", 0.0, 1e4, live=True
    )
    recovery: float = parameter(
        0.02, "largest speed at which a violation is corrected; larger: more abrupt", "m/s", 1e-4, 1e3, live=True
    )
    transfer_duration: float = parameter(
        1.5, "duration of the CoM transfer from foot to foot; larger: slower steps", "s", 0.05, 60.0, live=True
    )
    swing_duration: float = parameter(1.5, "duration of a swing; larger: slower steps", "s", 0.05, 60.0, live=True)
    com_threshold: float = parameter(0.003, "CoM error that ends the phase; larger: earlier", "m", 1e-5, 0.1, live=True)
    swing_threshold: float = parameter(0.002, "error that ends a swing; larger: earlier", "m", 1e-5, 0.1, live=True)
    aim_inside: float = parameter(
        0.0,
        "offset of the CoM on one foot towards the other; larger: balances more outward push",
        "m",
        0.0,
        0.05,
        live=True,
    )
    saturation: float = parameter(0.03, "limit of the CoM error; larger: faster correction", "m", 1e-4, 1.0, live=True)
    com_weight: float = parameter(0.3, "weight of the CoM on one foot; larger: closer to it", "", 0.0, 1e3, live=True)
    swing_weight: float = parameter(
        10.0, "weight of the swing foot's path; larger: closer to it", "", 1e-3, 1e4, live=True
    )
    swing_rate: float = parameter(10.0, "convergence to the swing path; larger: faster", "1/s", 0.1, 1e3, live=True)
    lever: float = parameter(0.2, "length that weights angles; larger: orientation counts more", "m/rad", 1e-3, 10.0)
    balance: float = parameter(0.5, "gain of the CoM's feedback; larger: stiffer; 0: none", "", 0.0, 10.0, live=True)
    pressure_margin: float = parameter(
        0.004, "smallest distance of the commanded CoP from the edges; larger: less torque", "m", 0.0, 0.1, live=True
    )
    sole_gap: float = parameter(
        0.004, "least lateral gap of the soles; larger: further apart", "m", 0.0, 0.2, live=True
    )
    posture: tuple[str, ...] = parameter((), "first posture, JOINT=RADIANS; '*' matches any text; other joints: zero")


@dataclass(frozen=True)
class DynamicConfig:
    """The dynamic walk; durations, weights and gains common to both walks are in the section ``standing``."""

    start_duration: float = parameter(0.6, "duration of the first weight shift; larger: slower start", "s", 0.1, 10.0)
    stop_duration: float = parameter(1.0, "time in which the CoM comes to rest; larger: slower stop", "s", 0.1, 10.0)
    ramp: int = parameter(
        3, "number of steps over which the step length grows and shrinks; larger: smoother", "", 0, 100
    )
    aim_ahead: float = parameter(
        0.0, "offset of the planned zero-moment point ahead of the sole's centre", "m", -0.1, 0.1
    )
    aim_inside: float = parameter(0.0, "offset of the zero-moment point towards the other foot", "m", -0.05, 0.05)
    roll: float = parameter(
        0.0, "half the travel of the CoP along a sole, per step length; larger: faster walk", "", 0.0, 1.0
    )
    quicken: float = parameter(
        0.0, "time by which a step of gait.most_length is shorter than one on the spot; larger: faster", "s", 0.0, 1.0
    )
    land_late: float = parameter(
        0.0, "time after the planned touchdown at which the swing path ends; larger: later", "s", 0.0, 0.2
    )
    side_frequency: float = parameter(1.0, "lateral over model frequency; larger: faster sway", "", 0.5, 1.5)
    com_weight: float = parameter(20.0, "weight of the CoM's path; larger: followed more closely", "", 1e-3, 1e4)
    com_rate: float = parameter(2.0, "rate at which the CoM converges to its path; larger: faster", "1/s", 0.0, 100.0)
    height_weight: float = parameter(5.0, "weight of the CoM's height; larger: kept more closely", "", 0.0, 1e4)
    height_rate: float = parameter(4.0, "rate at which the CoM's height converges; larger: faster", "1/s", 0.0, 100.0)
    upright_weight: float = parameter(0.1, "weight of an upright pelvis; larger: kept more closely", "", 0.0, 1e4)
    upright_rate: float = parameter(
        5.0, "rate at which the pelvis converges to upright; larger: faster", "1/s", 0.0, 100.0
    )
    trunk_weight: float = parameter(
        0.0, "weight of a trunk that does not pitch, nor roll while a push tips the sole; 0: it swings", "", 0.0, 1e4
    )
    catch: bool = parameter(True, "adjust time and place of a step to the measured divergent component of motion")
    catch_margin: float = parameter(0.012, "CoP margin of step adjustment; larger: earlier steps", "m", 0.0, 0.1)
    catch_beyond: float = parameter(
        0.01, "error predicted at landing that adjusts a step; larger: fewer", "m", 0.0, 1.0
    )
    catch_length: float = parameter(0.1, "largest adjustment of a step ahead; larger: more effect", "m", 0.0, 0.5)
    catch_side: float = parameter(0.0, "largest lateral adjustment of a step; 0 without ankle roll", "m", 0.0, 0.2)
    shortest_step: float = parameter(0.26, "least duration of an adjusted swing; smaller: earlier", "s", 0.05, 10.0)
    untouched: float = parameter(0.04, "time after lift-off without adjustment; larger: later", "s", 0.0, 1.0)
    settled: float = parameter(0.12, "time before landing without adjustment; larger: fixed earlier", "s", 0.0, 1.0)


@dataclass(frozen=True)
class PelvisConfig:
    """The pelvis plane (U11)."""

    eta: float = parameter(500.0, "rate of (U11), at most 1/dt; larger: faster approach to the plane", "1/s", 1e-3, 1e4)
    height: float = parameter(0.2, "height of the plane of (U11) above the sole; larger: higher pelvis", "m", 0.0, 10.0)


@dataclass(frozen=True)
class JointsConfig:
    """Joint limits (U12)-(U13)."""

    eta: float = parameter(10.0, "rate of (U12), (U13); larger: faster approach to limits", "1/s", 1e-3, 1e4, live=True)
    margin: float = parameter(0.0, "distance kept from both limits; larger: less range", "rad", 0.0, 1.0, live=True)
    velocity: float = parameter(0.0, "largest joint velocity; smaller: slower; 0: the URDF's", "rad/s", 0.0, 100.0)


@dataclass(frozen=True)
class CollisionConfig:
    """Bodies of the robot that are kept apart."""

    pairs: tuple[str, ...] = parameter((), "links kept apart, LINK=LINK, such as l_shin=r_shin")
    capsules: tuple[str, ...] = parameter(
        (), "shape of a link in its frame, LINK=ax ay az bx by bz radius [m] (`dqwalk config CONFIG --capsules`)"
    )
    margin: float = parameter(0.005, "distance kept between the capsules; larger: safer", "m", 0.0, 0.5)
    eta: float = parameter(5.0, "rate of the distances; larger: faster approach", "1/s", 1e-3, 1e4)
    near: float = parameter(
        0.025, "distance above the margin below which a pair has a row; larger: earlier", "m", 1e-3, 10.0
    )
    recovery: float = parameter(0.05, "largest speed at which a violation is corrected", "m/s", 1e-4, 1e3)


@dataclass(frozen=True)
class ArmsConfig:
    """Arms that move beside a standing or dynamic walk, with less weight than it."""

    joints: tuple[str, ...] = parameter((), "joints of the arms, which robot.lock must not name; '*' matches any text")
    left_hand: str = parameter("", "link that left_hand_target moves; empty: none")
    right_hand: str = parameter("", "link that right_hand_target moves; empty: none")
    swing: tuple[str, ...] = parameter(
        (), "JOINT=RADIANS per metre by which the left foot is ahead of the right one; '*' matches any text"
    )
    weight: float = parameter(0.05, "weight of the joints' angles; larger: kept more closely", "", 1e-6, 1e4)
    rate: float = parameter(8.0, "rate at which joints and hands converge; larger: faster", "1/s", 0.01, 100.0)
    hand_weight: float = parameter(2.0, "weight of a commanded hand; larger: kept more closely", "", 1e-6, 1e6)
    lever: float = parameter(
        0.0, "length that weights a hand's orientation; 0: only its position counts", "m/rad", 0.0, 10.0
    )
    joint_speed: float = parameter(
        1.0, "largest speed of a joint of an arm; larger: quicker, but may topple the robot", "rad/s", 0.01, 100.0
    )
    hand_speed: float = parameter(0.2, "largest speed at which an error of a hand is corrected", "m/s", 0.001, 10.0)
    timeout: float = parameter(
        0.0, "time after the last command until an arm returns to the posture; 0: never", "s", 0.0, 1e4
    )


@dataclass(frozen=True)
class QpConfig:
    """The solver of (U6)."""

    solver: Literal["clarabel", "daqp", "nnls"] = parameter(
        "clarabel", "QP solver; daqp, an optional package, is faster; nnls is scipy's, used where clarabel is missing"
    )


@dataclass(frozen=True)
class ServoConfig:
    """Position servos behind velocity commands; defaults: Dynamixel MX at 12 V with a raised P gain.

    The parameters ``assumed*`` are the servo model that controller and driver use; the others describe the servos of
    the simulated robot. The driver of Poppy writes `p_gain` to the servos.
    """

    types: tuple[str, ...] = parameter((), "servo types of servo.table, JOINT=TYPE; '*' matches any text")
    table: str = parameter("servos", "table of servo types: a path, or the name of a file in config/")
    p_gain: int = parameter(254, "P register of the servos of servo.types that have one; larger: stiffer", "", 1, 254)
    voltage: float = parameter(12.0, "supply voltage of the servos of servo.types; larger: more torque", "V", 1.0, 60.0)

    stiffness: float = parameter(
        60.0, "torque per position error; larger: stiffer (MX-28: 6 to 51)", "N m/rad", 0.1, 1e6
    )
    damping: float = parameter(
        0.02, "torque per joint velocity, divided by the stiffness; larger: more lag", "s", 0.0, 1.0
    )
    torque_scale: float = parameter(0.81, "stall torque over the URDF's effort (MX-28: 2.5 of 3.1)", "", 0.001, 100.0)
    backlash: float = parameter(0.0, "total play of the simulated gears; an MX has 0.0058", "rad", 0.0, 0.1)
    resolution: float = parameter(0.00153, "step size of the commanded position; 0: continuous", "rad", 0.0, 0.1)
    friction: float = parameter(0.02, "dry friction of the simulated gears", "N m", 0.0, 10.0)
    armature: float = parameter(0.01, "inertia of the rotor, reflected through the gears", "kg m^2", 0.0, 1.0)
    rate: float = parameter(0.0, "rate at which positions are written; 0: every period", "Hz", 0.0, 1e4)
    latency: float = parameter(0.0, "delay from writing a position to its effect in the simulation", "s", 0.0, 0.5)
    window: float = parameter(
        0.15,
        "goal window: tolerated distance of goal and predicted angle, at P = 254; smaller: softer",
        "rad",
        1e-3,
        3.0,
    )
    window_lag: float = parameter(
        0.0, "lag of the joints, by which the goal window extends in the direction of motion", "s", 0.0, 0.1
    )
    window_time: float = parameter(
        0.0, "time constant with which a goal beyond the window returns; 0: at once", "s", 0.0, 1.0
    )
    assumed_stiffness: float = parameter(
        60.0, "stiffness that converts torques to position offsets; 0: no feedforward", "N m/rad", 0.0, 1e6
    )
    assumed_damping: float = parameter(
        0.0, "assumed damping, divided by the stiffness; above the true one the robot falls", "s", 0.0, 0.2
    )
    assumed_lead: float = parameter(
        0.0, "time by which goals are ahead where torques are fed forward; larger: less lag", "s", 0.0, 0.2
    )
    assumed_armature: float = parameter(
        0.01, "assumed inertia of the rotor; larger: more torque to swing a leg", "kg m^2", 0.0, 1.0
    )
    assumed_latency: float = parameter(
        0.0, "assumed delay from a measurement to the effect of the command that answers it", "s", 0.0, 0.25
    )
    assumed_rate: float = parameter(0.0, "assumed rate of writing positions; 0: every period", "Hz", 0.0, 1e4)
    assumed_velocity_filter: float = parameter(
        0.0, "assumed time constant of the low-pass of measured joint velocities; 0: none", "s", 0.0, 1.0
    )
    assumed: tuple[str, ...] = parameter((), "what `dqwalk identify` found, JOINT=stiffness 49.2, damping 0.009, ...")


@dataclass(frozen=True)
class PhysicsConfig:
    """The simulated world of the physics plant."""

    timestep: float = parameter(
        0.001, "time step of the physics engine; smaller: more accurate, slower", "s", 1e-5, 0.01
    )
    friction: float = parameter(
        0.8, "friction coefficient between soles and floor; smaller: more slippery", "", 0.0, 5.0
    )
    contact_time: float = parameter(
        0.005, "time constant of the contact, half of its damping over its stiffness; smaller: harder", "s", 1e-4, 1.0
    )
    contact_stiffness: float = parameter(
        0.0, "stiffness of the contact at a corner of a sole; 0: about 3e5, in MuJoCo by contact_time", "N/m", 0.0, 1e8
    )
    cone: Literal["pyramidal", "elliptic"] = parameter(
        "pyramidal", "cone of friction in MuJoCo; in Drake always elliptic"
    )
    slope: float = parameter(0.0, "inclination of the floor, positive: it rises ahead", "rad", -0.5, 0.5)
    slope_side: float = parameter(
        0.0, "lateral inclination of the floor, positive: it rises to the left", "rad", -0.5, 0.5
    )
    rubble: float = parameter(0.0, "largest height of boxes strewn on the floor; 0: no boxes", "m", 0.0, 0.05)
    rise: float = parameter(0.0, "height of each stair ahead, negative: down; 0: no stairs", "m", -0.1, 0.1)
    stairs: int = parameter(1, "number of stairs", "", 1, 100)
    tread: float = parameter(0.25, "length of each stair; larger: flatter", "m", 0.01, 10.0)
    stairs_at: float = parameter(0.3, "distance of the first stair from the robot's first place", "m", 0.0, 100.0)
    mass_scale: float = parameter(1.0, "factor of all masses and inertias; larger: heavier", "", 0.1, 10.0)
    warn_at: float = parameter(
        0.0, "time at which the plant asks for the end of the walk, as a hot motor does; 0: never", "s", 0.0, 1e6
    )
    settle: float = parameter(0.5, "time simulated at rest before the walk begins", "s", 0.0, 60.0)
    held: bool = parameter(False, "the simulated root link is held level in the air, as in a stand (`dqwalk exercise`)")


@dataclass(frozen=True)
class SensorsConfig:
    """Errors of the simulated sensors, by default zero."""

    encoder: float = parameter(
        0.0, "step size of measured joint angles; 0: continuous; an MX has 0.001534", "rad", 0.0, 0.1
    )
    velocity_filter: float = parameter(0.0, "time constant of the velocities' low-pass; 0: exact", "s", 0.0, 1.0)
    rate: float = parameter(0.0, "rate at which the joints are read; 0: every control period", "Hz", 0.0, 1e4)
    age: float = parameter(0.0, "delay of a reading; larger: later", "s", 0.0, 0.5)
    attitude_bias: float = parameter(
        0.0, "constant error of the measured vertical, in a random direction", "rad", 0.0, 0.2
    )
    attitude_noise: float = parameter(0.0, "standard deviation of the noise of the measured vertical", "rad", 0.0, 0.2)
    gyro_bias: float = parameter(
        0.0, "constant error of the angular velocity, in a random direction", "rad/s", 0.0, 1.0
    )
    gyro_noise: float = parameter(0.0, "standard deviation of the noise of the angular velocity", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = parameter(0.0, "error of the acceleration, random direction", "m/s^2", 0.0, 10.0)
    accelerometer_noise: float = parameter(
        0.0, "standard deviation of the noise of the acceleration", "m/s^2", 0.0, 10.0
    )
    misalignment: float = parameter(0.0, "angle of the inertial sensor's mounting error", "rad", 0.0, 0.5)
    seed: int = parameter(0, "seed of all random errors of the sensors and of the rubble", "", 0, 2**31 - 1)


@dataclass(frozen=True)
class PlantConfig:
    """Communication with the plant, a simulator or a robot driver."""

    name: str = parameter(
        "", "plant of a simulating node: a name of plants/table.py, or MODULE:CLASS; empty: the node's"
    )
    lockstep: bool = parameter(False, "each state waits for its command: deterministic, fast; false: real time")
    clock: bool = parameter(False, "a simulated plant publishes /clock; the other nodes then need use_sim_time: true")
    imu: bool = parameter(False, "each state comes with a message on imu; the controller waits for both")
    foot_force: bool = parameter(
        False,
        "each foot has a force sensor: its load is that of left_foot_wrench and right_foot_wrench; not in lockstep",
    )
    command_timeout: float = parameter(
        0.1, "time without a command after which the plant holds", "s", 0.0, 10.0, live=True
    )


@dataclass(frozen=True)
class OutputConfig:
    """Commands of the node `drive` to the joint controllers of another robot."""

    type: Literal["float64_multi_array", "joint_trajectory", "joint_state"] = parameter(
        "float64_multi_array",
        "message type: 'float64_multi_array' for a forward_command_controller, 'joint_trajectory' for a "
        "joint_trajectory_controller, or 'joint_state'",
    )
    interface: Literal["position", "velocity"] = parameter("position", "velocities, or positions within servo.window")
    topic: str = parameter("", "command topic of the robot's controller; empty: ros2_control's default")
    joints: tuple[str, ...] = parameter((), "joints of that controller in its order; empty: the joints of the model")


@dataclass(frozen=True)
class EstimationConfig:
    """Standard deviations that the estimator of the base assumes."""

    gyro_noise: float = parameter(
        0.002, "noise density of the gyroscope; larger: trusted less", "rad/s/sqrt(Hz)", 1e-6, 1.0
    )
    accelerometer_noise: float = parameter(
        0.04, "noise density of the accelerometer; larger: trusted less", "m/s^2/sqrt(Hz)", 1e-5, 100.0
    )
    gyro_bias: float = parameter(0.01, "standard deviation of the gyroscope's bias at the start", "rad/s", 0.0, 1.0)
    accelerometer_bias: float = parameter(
        0.12, "standard deviation of the accelerometer's bias at the start", "m/s^2", 0.0, 10.0
    )
    gyro_drift: float = parameter(
        1e-5, "random walk of the gyroscope's bias; larger: changes faster", "rad/s/sqrt(s)", 0.0, 1.0
    )
    accelerometer_drift: float = parameter(
        1e-4, "random walk of the accelerometer's bias; larger: changes faster", "m/s^2/sqrt(s)", 0.0, 10.0
    )
    kinematics: float = parameter(0.001, "error of a sole's heel or toe; larger: trusted less", "m", 1e-5, 0.1)
    slip: float = parameter(0.001, "random walk of a standing sole; larger: trusted less", "m/sqrt(s)", 1e-6, 0.1)
    pivot: float = parameter(
        0.002, "random walk of a standing sole's direction; larger: contacts count less", "rad/sqrt(s)", 1e-6, 0.1
    )
    pivot_landing: float = parameter(
        0.02, "turn of the soles on the floor when a foot lands; larger: contacts count less", "rad", 0.0, 0.5
    )
    floor: float = parameter(0.0015, "variation of the floor's height; larger: trusted less", "m", 1e-5, 1.0)


@dataclass(frozen=True)
class MonitorConfig:
    """Diagnostics during the walk."""

    rate: float = parameter(10.0, "diagnostics published per second of walking", "Hz", 0.1, 1e3, live=True)
    warn_margin: float = parameter(0.002, "distance from a bound that is a warning", "m", 0.0, 1.0, live=True)
    tolerance: float = parameter(1e-5, "violation of a bound that is an error", "m", 0.0, 1.0, live=True)


@dataclass(frozen=True)
class NodeConfig:
    """Start, end and interfaces of the ROS nodes."""

    autostart: bool = parameter(True, "walk as soon as the first state arrives; false: wait for the service ~/start")
    exit_when_done: bool = parameter(False, "exit when the walk is over: code 0 if it finished, 1 if it failed")
    end_with_parent: bool = parameter(False, "end with the process that started the node, such as ros2 launch (Linux)")
    wait_for_recorder: bool = parameter(False, "the walk begins, and is judged, only once a recorder receives it")
    wait_for_monitor: bool = parameter(
        False, "the controller answers the first state only when a phase_monitor is present"
    )
    robot_description: bool = parameter(True, "publish robot_description; false: a robot_state_publisher publishes it")
    stamped_cmd_vel: bool = parameter(False, "cmd_vel is a TwistStamped, as with Nav2's enable_stamped_cmd_vel")


@dataclass(frozen=True)
class OdometryConfig:
    """Odometry for Nav2 and RViz [REP-105, REP-120]."""

    odom_frame: str = parameter("odom", "frame of the base sole at the start of the walk, fixed in the world")
    base_frame: str = parameter("base_link", "base frame: a link of the URDF, or joined to its root on /tf_static")
    footprint_frame: str = parameter(
        "base_footprint", "frame on the ground below base_frame; empty, or a link of the URDF: not published"
    )
    step_deviation: float = parameter(0.003, "deviation of a step's length; larger: more covariance", "m", 0.0, 1.0)
    turn_deviation: float = parameter(0.005, "deviation of a step's turn; larger: more covariance", "rad", 0.0, 1.0)
    window: float = parameter(
        0.1, "time over which the velocity is averaged; larger: smoother, later", "s", 0.001, 10.0
    )


@dataclass(frozen=True)
class WholeBodyConfig:
    """The whole-body controller of Sherikov, Dimitrov and Wieber, for robots whose ankles pitch and roll.

    Weights are w of 1/2 w ||r||^2 on the third level of the hierarchy, where wrenches are in units of the robot's
    weight. Stiffnesses without a damping of their own are critically damped.
    """

    torso: str = parameter("chest", "link that is kept upright (S18), and on which pushes act")
    hand: str = parameter("R_hand", "link that reaches for the target (S17)")
    posture: tuple[str, ...] = parameter((), "reference posture, JOINT=RADIANS; joints not listed: zero")
    free: tuple[str, ...] = parameter((), "joints that are only damped, without reference (S19); '*' matches any text")

    interval: float = parameter(0.1, "T, the preview's sampling interval (S10); larger: coarser", "s", 0.01, 1.0)
    intervals: int = parameter(16, "N, number of preview intervals; larger: longer, slower", "", 4, 64)
    single_support: float = parameter(0.7, "duration of a single support", "s", 0.1, 10.0)
    double_support: float = parameter(0.1, "duration of the double support between two steps", "s", 0.01, 10.0)
    first_double_support: float = parameter(0.3, "duration of standing before the first step", "s", 0.0, 10.0)
    feet_distance: float = parameter(0.19, "lateral distance between the soles' links at the start", "m", 0.05, 1.0)
    cop_length: float = parameter(
        0.1372, "length of the rectangle in which the CoP is kept, along x of the sole (S7), (S11)", "m", 0.01, 0.5
    )
    cop_width: float = parameter(0.058, "width of that rectangle, along y of the sole", "m", 0.01, 0.5)
    step_length: float = parameter(0.2, "largest step ahead of or behind the other foot (S12)", "m", 0.0, 1.0)
    step_width_min: float = parameter(0.19, "least lateral distance of a landing foot (S12)", "m", 0.0, 1.0)
    step_width_max: float = parameter(0.30, "largest lateral distance of a landing foot (S12)", "m", 0.0, 1.0)
    step_height: float = parameter(0.07, "height of the swing foot at mid-swing (S16)", "m", 0.0, 0.3)
    freeze: float = parameter(0.05, "time before landing from which its place is fixed", "s", 0.01, 1.0)

    friction: float = parameter(
        0.7, "mu, the friction coefficient assumed in (S4); smaller: more cautious", "", 0.05, 2.0
    )
    contact_damping: float = parameter(10.0, "decay rate of a standing foot's velocity (S8)", "1/s", 0.0, 100.0)
    limit_time: float = parameter(0.05, "T of the joint limits (S9); larger: joints brake earlier", "s", 0.005, 1.0)
    effort: float = parameter(150.0, "largest joint torque; the URDF's limit where that is smaller", "N m", 1.0, 1e4)
    capturability: bool = parameter(True, "second level, capturability (S14); false: the robot falls")

    com_kp: float = parameter(100.0, "stiffness of the CoM's height; larger: stiffer", "1/s^2", 0.0, 1e4)
    foot_kp: float = parameter(
        400.0, "stiffness of the swing foot's orientation (S16); larger: stiffer", "1/s^2", 0.0, 1e4
    )
    hand_kp: float = parameter(100.0, "stiffness of the hand's position (S17); larger: stiffer", "1/s^2", 0.0, 1e4)
    hand_saturation: float = parameter(11.8, "largest acceleration by the hand's error (S17)", "m/s^2", 0.1, 1e3)
    torso_kp: float = parameter(100.0, "stiffness of the torso's orientation (S18); larger: stiffer", "1/s^2", 0.0, 1e4)
    joint_kp: float = parameter(
        25.0, "stiffness of the joints about the posture (S19); larger: stiffer", "1/s^2", 0.0, 1e4
    )
    joint_kd: float = parameter(
        3.0, "damping of the joints in whole_body.free (S19); larger: more damping", "1/s", 0.0, 1e3
    )

    hand_weight: float = parameter(
        1.0, "weight of the hand's position (S17); larger: followed more closely", "", 0.0, 1e6
    )
    torso_weight: float = parameter(10.0, "weight of the torso (S18); larger: followed more closely", "", 0.0, 1e6)
    joint_weight: float = parameter(0.05, "weight of the posture (S19); larger: followed more closely", "", 0.0, 1e6)
    jerk_weight: float = parameter(1e-6, "weight of the swing foot's jerk (S20); larger: smoother", "", 0.0, 1e6)
    cop_weight: float = parameter(5e3, "weight of the CoP's offset in its foot (S21); larger: smaller", "", 0.0, 1e9)
    cop_velocity_weight: float = parameter(2.0, "weight of the CoP's velocity (S22); larger: slower CoP", "", 0.0, 1e6)
    wrench_weight: float = parameter(1e-4, "weight of contact wrenches; larger: smaller wrenches", "", 0.0, 1e6)
    regularization: float = parameter(1e-6, "weight of all variables: makes the solution unique", "", 1e-9, 1.0)


@dataclass(frozen=True)
class SafetyConfig:
    """Limits at which a node refuses a state or ends the walk (docs/faults.md)."""

    outside: float = parameter(0.1, "distance outside the limits beyond which a state is refused", "rad", 0.0, 1.0)
    tilt: float = parameter(0.5, "pelvis inclination (plant.imu) that counts as a fall", "rad", 0.1, 1.5)
    sole_tilt: float = parameter(0.2, "inclination of the base sole that ends the walk", "rad", 0.02, 1.5)
    contradiction: float = parameter(0.25, "error of a measured motion that ends the walk", "rad", 0.01, 3.0)
    jumps: int = parameter(3, "consecutive impossible measurements that end the walk", "", 1, 1000)
    failures: int = parameter(10, "consecutive infeasible QPs that end the walk", "", 1, 1000)


@dataclass(frozen=True)
class PoppyConfig:
    """The driver of the real Poppy."""

    motors: str = parameter("poppy", "table of the motors: a path, or the name of a file in config/motors/")
    dummy: bool = parameter(False, "use emulated servos instead of a robot")
    rate: float = parameter(50.0, "rate at which goals are written and angles are read", "Hz", 5.0, 100.0)
    lower_port: str = parameter("auto", "serial port of the legs, such as /dev/ttyACM0; auto: search for it")
    upper_port: str = parameter("auto", "serial port of the upper body; auto: search for it")
    load: bool = parameter(
        False,
        "publish the torques of the joints of the walk, from the motors' present loads, as effort in joint_states",
    )
    sync_read: bool = parameter(True, "read all motors of a bus at once: USB2AX true, FTDI and U2D2 false")
    calibration: tuple[str, ...] = parameter((), "angle of a motor where its joint is at zero, JOINT=DEGREES")
    activate: bool = parameter(False, "switch the torque on at start; false: wait for the service ~/activate")
    start_speed: float = parameter(0.25, "joint speed to the first posture; larger: faster", "rad/s", 0.01, 1.0)
    start_tolerance: float = parameter(0.1, "joint error at which the posture is reached", "rad", 1e-3, 0.5)
    max_speed: float = parameter(120.0, "largest speed commanded to a servo; smaller: slower", "deg/s", 2.0, 360.0)
    max_lead: float = parameter(
        0.2, "servo.window on the way to the first posture; larger: more torque", "rad", 0.01, 1.0
    )
    hot: float = parameter(
        65.0, "motor temperature above which the robot holds still; the walk ends 5 below it", "degC", 30.0, 80.0
    )
    low_voltage: float = parameter(
        10.0,
        "supply voltage below which the robot holds still; the walk ends 0.5 above it; 0: not checked",
        "V",
        0.0,
        14.0,
    )
    max_load: float = parameter(95.0, "load that counts as blocked after `blocked_after`", "%", 10.0, 1000.0)
    blocked_after: float = parameter(1.0, "longest time off the goal; larger: more tolerant", "s", 0.1, 60.0)
    torque_off_at_end: bool = parameter(False, "switch the torque off at the end; false: hold the position")
