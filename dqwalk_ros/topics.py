"""The topics of a walk: one table for the nodes, the bags and the documentation."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "BODY_REQUIRED",
    "BODY_TOPICS",
    "FAILED",
    "FALLEN",
    "FINISHED",
    "ODOM",
    "PHASE_LOG",
    "REQUIRED",
    "TOPICS",
    "WORLD",
    "Topic",
]

ODOM = "odom"
"""Frame of the base sole at the very start of the walk [REP-105]."""

WORLD = "world"
"""Frame of a physics engine's floor; what is told in it no robot knows."""

FINISHED = "finished"
"""What `phase` says once the walk is over."""

FALLEN = "fallen"
"""What `phase` says once the robot has fallen."""

FAILED = "failed"
"""What `phase` says where the walk could not go on."""


@dataclass(frozen=True)
class Topic:
    """One topic as its publisher offers it.

    Attributes
    ----------
    name : str
        Name in the namespace of the robot; a leading ``/`` keeps it out of any namespace.
    type : str
        Message type.
    latched : bool
        Transient local: a subscriber that comes late gets the last message.
    depth : int
        History kept by the publisher.
    meaning : str
    source : str
        ``"plant"``, ``"controller"``, ``"physics"`` (the plant of that name alone) or ``"all"``.
    """

    name: str
    type: str
    latched: bool
    depth: int
    meaning: str
    source: str = "controller"


_HISTORY = 20_000
"""What a publisher keeps of a stream, for a recorder that fell behind: some 20 s of lockstep at full speed.

On a busy machine the middleware drops samples on the way and repairs that only every 3 s. It delays nobody: what a
subscriber takes next is decided by its own depth."""

_PHASES = 100
"""Phases that are kept for whoever comes late or fell behind: a recorder wants each of them."""

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
    Topic("phase", "std_msgs/msg/String", True, 1, "such as double_support/left: what goes on now"),
    Topic(
        "phase_start",
        "sensor_msgs/msg/JointState",
        True,
        _PHASES,
        "positions at the start of the phase, frame_id the base sole",
    ),
    Topic(
        "com_target",
        "geometry_msgs/msg/PointStamped",
        True,
        _PHASES,
        "double support: where the CoM goes, as seen at the start, in the base sole",
    ),
    Topic(
        "swing_target",
        "geometry_msgs/msg/PoseStamped",
        True,
        _PHASES,
        "single support: the landing place, in the base sole",
    ),
    Topic("support_foot", "std_msgs/msg/String", True, 1, "left or right: the foot the phase name gives"),
    Topic("base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY, "pelvis in odom"),
    Topic("walk_config", "std_msgs/msg/String", True, 1, "every parameter, as the text of a parameter file"),
    Topic("walk_origin", "std_msgs/msg/String", True, 1, "versions and machine of who walks, a line each"),
    Topic("robot_description", "std_msgs/msg/String", True, 1, "URDF"),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", False, 10, "every distance, error and margin", "all"),
    Topic("imu", "sensor_msgs/msg/Imu", False, _HISTORY, "inertial sensor of the pelvis", "physics"),
    Topic("true_base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY, "pelvis in the world", "physics"),
    *(
        Topic(
            f"{side}_foot_wrench",
            "geometry_msgs/msg/WrenchStamped",
            False,
            _HISTORY,
            f"ground on the {side} sole, about its origin, in its axes [N, N m]",
            "physics",
        )
        for side in ("left", "right")
    ),
    Topic(
        "center_of_pressure", "geometry_msgs/msg/PointStamped", False, _HISTORY, "of both feet in the world", "physics"
    ),
)

TOPICS: dict[str, Topic] = {topic.name.lstrip("/"): topic for topic in _ALL}

PHASE_LOG = Topic("phase_log", "std_msgs/msg/String", True, _PHASES, "what `phase` has shown, for the recorder")
"""`phase` keeps one message, so that whoever asks is told what goes on now; a bag's `phase` comes from here, so that
none of them is lost."""

REQUIRED = ("joint_states", "joint_velocity_commands", "phase", "phase_start", "walk_config")
"""Without these a bag is not a walk."""

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
        "ground on the left sole while it stands: about the sole's origin, in the axes of odom [N, N m]; the stamp is "
        "that of the state before",
        "plant",
    ),
    Topic(
        "right_wrench",
        "geometry_msgs/msg/WrenchStamped",
        False,
        _HISTORY,
        "the same of the right sole",
        "plant",
    ),
    Topic(
        "hand_target_applied",
        "geometry_msgs/msg/PoseStamped",
        True,
        _PHASES,
        "where the hand should be; the stamp is that of the first state it holds for",
    ),
    Topic(
        "push_applied",
        "geometry_msgs/msg/WrenchStamped",
        True,
        _PHASES,
        "force times 1 s: an impulse that has hit the torso [N s]; the stamp is that of the first state after it",
        "plant",
    ),
)

BODY_TOPICS: dict[str, Topic] = {name: TOPICS[name] for name in _SHARED} | {topic.name: topic for topic in _BODY}
"""The topics of a whole-body walk."""

BODY_REQUIRED = ("joint_states", "base_pose", "base_twist", "joint_effort_commands", "walk_config")
"""Without these a bag is not a whole-body walk."""
