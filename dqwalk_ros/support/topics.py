"""The topics of a walk: one table, used by the nodes, by the reader of bags and by the documentation."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "BODY_REQUIRED",
    "BODY_TOPICS",
    "FAILED",
    "FALLEN",
    "FINISHED",
    "ODOM",
    "OPTIONAL",
    "OTHERS",
    "PHASE_LOG",
    "REQUIRED",
    "TOPICS",
    "WORLD",
    "Topic",
]

ODOM = "odom"
"""Frame of the base sole at the start of the walk [REP-105]."""

WORLD = "world"
"""Frame of a physics engine's floor; used for ground truth only, which a real robot does not have."""

FINISHED = "finished"
"""Message on `phase` after the last phase of a walk."""

FALLEN = "fallen"
"""Message on `phase` after a fall of the robot."""

FAILED = "failed"
"""Message on `phase` after an error that ended the walk."""


@dataclass(frozen=True)
class Topic:
    """One topic: name, message type and quality of service of its publisher.

    Attributes
    ----------
    name : str
        Name in the namespace of the robot; a leading ``/`` keeps it out of any namespace.
    type : str
        Message type.
    latched : bool
        Durability transient local: a late subscriber receives the last `depth` messages.
    depth : int
        History depth of the publisher.
    meaning : str
    source : str
        Publishing node: ``"plant"``, ``"controller"``, ``"physics"`` (only the plant of that name), ``"effort"`` (the
        controller, if joint_states has torques) or ``"all"``.
    """

    name: str
    type: str
    latched: bool
    depth: int
    meaning: str
    source: str = "controller"


OPTIONAL = ("physics", "effort")
"""Sources of topics that not every walk has."""

_HISTORY = 20_000
"""History depth of a stream, for a slow recorder: about 20 s of lockstep at full speed.

On a busy machine the middleware loses samples and sends them again only at the next heartbeat. A long history delays
no other subscriber: the depth of each subscriber decides which message it takes next."""

_PHASES = 100
"""History depth of messages of which there is one per phase, for late and slow subscribers such as the recorder."""

_STATUSES = 1000
"""History depth of /diagnostics: at the end of a walk in lockstep the monitor publishes those of its last seconds at
once, and a slow recorder must not miss the first of them."""

_ALL = (
    Topic(
        "joint_states",
        "sensor_msgs/msg/JointState",
        False,
        _HISTORY,
        "positions [rad] and velocities [rad/s], by name",
        "plant",
    ),
    Topic(
        "joint_velocity_commands",
        "sensor_msgs/msg/JointState",
        False,
        _HISTORY,
        "velocities [rad/s], with an inertial sensor torques [N m]; the stamp is that of the state they answer",
    ),
    Topic("phase", "std_msgs/msg/String", True, 1, "name of the current phase, such as double_support/left"),
    Topic(
        "phase_start",
        "sensor_msgs/msg/JointState",
        True,
        _PHASES,
        "joint positions [rad] at the start of the phase; frame_id is the base sole",
    ),
    Topic(
        "com_target",
        "geometry_msgs/msg/PointStamped",
        True,
        _PHASES,
        "double support: goal of the CoM at the start of the phase, in the frame of the base sole",
    ),
    Topic(
        "swing_target",
        "geometry_msgs/msg/PoseStamped",
        True,
        _PHASES,
        "single support: pose at which the swing foot lands, in the frame of the base sole",
    ),
    Topic("support_foot", "std_msgs/msg/String", True, 1, "support foot of the current phase: left or right"),
    Topic("base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY, "pose of the pelvis in odom"),
    *(
        Topic(
            f"{side}_foot_load",
            "geometry_msgs/msg/WrenchStamped",
            False,
            _HISTORY,
            f"vertical force of the ground on the {side} sole, estimated from the torques of joint_states [N]",
            "effort",
        )
        for side in ("left", "right")
    ),
    Topic("walk_config", "std_msgs/msg/String", True, 1, "every parameter, as the text of a parameter file"),
    Topic("walk_origin", "std_msgs/msg/String", True, 1, "software versions and machine of the controller"),
    Topic("robot_description", "std_msgs/msg/String", True, 1, "URDF"),
    Topic(
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        False,
        _STATUSES,
        "every distance, error and margin",
        "all",
    ),
    Topic("imu", "sensor_msgs/msg/Imu", False, _HISTORY, "measurements of the inertial sensor", "physics"),
    Topic("true_base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY, "true pelvis pose in world", "physics"),
    Topic("true_joint_states", "sensor_msgs/msg/JointState", False, _HISTORY, "true joint angles", "physics"),
    *(
        Topic(
            f"{side}_foot_wrench",
            "geometry_msgs/msg/WrenchStamped",
            False,
            _HISTORY,
            f"wrench of the ground on the {side} sole, about the sole's origin, in its axes [N, N m]",
            "physics",
        )
        for side in ("left", "right")
    ),
    Topic(
        "center_of_pressure", "geometry_msgs/msg/PointStamped", False, _HISTORY, "of both feet in the world", "physics"
    ),
)

TOPICS: dict[str, Topic] = {topic.name.lstrip("/"): topic for topic in _ALL}

PHASE_LOG = Topic("phase_log", "std_msgs/msg/String", True, _PHASES, "all messages of `phase`, for the recorder")
"""`phase` has a history of one message, so that a late subscriber receives the current phase only. The recorder stores
the messages of this topic as `phase`, so that none is lost."""

OTHERS = (
    "cmd_vel",
    "footsteps",
    "footstep_status",
    "odom",
    "push",
    "hand_target",
    "joint_goals",
    "/tf",
    "/tf_static",
    "/rosout",
)
"""Further topics, which steer a walk or accompany it; recorded at the newest stamp of joint_states."""

REQUIRED = ("joint_states", "joint_velocity_commands", "phase", "phase_start", "walk_config")
"""Topics that a bag of a walk must contain."""

_SHARED = ("joint_states", "base_pose", "walk_config", "walk_origin", "robot_description", "diagnostics")
_BODY = (
    Topic(
        "joint_effort_commands",
        "sensor_msgs/msg/JointState",
        False,
        _HISTORY,
        "torques [N m]; the stamp is that of the state they answer",
    ),
    Topic(
        "base_twist",
        "geometry_msgs/msg/TwistStamped",
        False,
        _HISTORY,
        "velocity of the root link in its own axes [m/s, rad/s]",
        "plant",
    ),
    Topic(
        "left_wrench",
        "geometry_msgs/msg/WrenchStamped",
        False,
        _HISTORY,
        "wrench of the ground on the left sole while it stands, about the sole's origin, in the axes of odom [N, N m]; "
        "the stamp is that of the state before",
        "plant",
    ),
    Topic(
        "right_wrench",
        "geometry_msgs/msg/WrenchStamped",
        False,
        _HISTORY,
        "the same for the right sole",
        "plant",
    ),
    Topic(
        "hand_target_applied",
        "geometry_msgs/msg/PoseStamped",
        True,
        _PHASES,
        "target of the hand; the stamp is that of the first state that it applies to",
    ),
    Topic(
        "push_applied",
        "geometry_msgs/msg/WrenchStamped",
        True,
        _PHASES,
        "impulse that acted on the torso [N s], as a force for 1 s; the stamp is that of the first state after it",
        "plant",
    ),
)

BODY_TOPICS: dict[str, Topic] = {name: TOPICS[name] for name in _SHARED} | {topic.name: topic for topic in _BODY}
"""The topics of a whole-body walk."""

BODY_REQUIRED = ("joint_states", "base_pose", "base_twist", "joint_effort_commands", "walk_config")
"""Topics that a bag of a whole-body walk must contain."""
