"""The topics of a walk: one table, used by the nodes and by the reader of bags.

docs/interfaces.md says what each of them means; a test compares both.
"""

from __future__ import annotations

from dataclasses import dataclass

ODOM = "odom"
"""Frame of the base sole at the start of the walk [REP-105]."""

WORLD = "world"
"""Frame of a physics engine's floor; used for ground truth only, which a real robot does not have."""

VELOCITY, EFFORT = "joint_velocity_commands", "joint_effort_commands"
"""Topics of the commands of both kinds of walk."""

FINISHED = "finished"
"""Message on `phase` after the last phase of a walk."""

FALLEN = "fallen"
"""Message on `phase` after a fall of the robot."""

FAILED = "failed"
"""Message on `phase` after an error that ended the walk."""


@dataclass(frozen=True)
class Topic:
    """One topic: name, message type and quality of service of its publisher."""

    name: str
    """Name in the namespace of the robot; a leading ``/`` keeps it out of any namespace."""
    type: str
    """Message type."""
    latched: bool
    """Durability transient local: a late subscriber receives the last `depth` messages."""
    depth: int
    """History depth of the publisher."""
    source: str = "controller"
    """Publishing node: ``"plant"``, ``"controller"``, ``"physics"`` (only the plant of that name), ``"effort"`` (the
    controller, if joint_states has torques), ``"warning"`` (a plant, or another node of the robot, with a reason) or
    ``"all"``."""


OPTIONAL = ("physics", "effort", "warning")
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
    Topic("joint_states", "sensor_msgs/msg/JointState", False, _HISTORY, "plant"),
    Topic("plant_warning", "std_msgs/msg/String", True, 1, "warning"),
    Topic("joint_velocity_commands", "sensor_msgs/msg/JointState", False, _HISTORY),
    Topic("phase", "std_msgs/msg/String", True, 1),
    Topic("phase_start", "sensor_msgs/msg/JointState", True, _PHASES),
    Topic("com_target", "geometry_msgs/msg/PointStamped", True, _PHASES),
    Topic("swing_target", "geometry_msgs/msg/PoseStamped", True, _PHASES),
    Topic("support_foot", "std_msgs/msg/String", True, 1),
    Topic("base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY),
    Topic("left_foot_load", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "effort"),
    Topic("right_foot_load", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "effort"),
    Topic("walk_config", "std_msgs/msg/String", True, 1),
    Topic("walk_origin", "std_msgs/msg/String", True, 1),
    Topic("robot_description", "std_msgs/msg/String", True, 1),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", False, _STATUSES, "all"),
    Topic("imu", "sensor_msgs/msg/Imu", False, _HISTORY, "physics"),
    Topic("true_base_pose", "geometry_msgs/msg/PoseStamped", False, _HISTORY, "physics"),
    Topic("true_joint_states", "sensor_msgs/msg/JointState", False, _HISTORY, "physics"),
    Topic("left_foot_wrench", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "physics"),
    Topic("right_foot_wrench", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "physics"),
    Topic("center_of_pressure", "geometry_msgs/msg/PointStamped", False, _HISTORY, "physics"),
)

TOPICS: dict[str, Topic] = {topic.name.lstrip("/"): topic for topic in _ALL}

PHASE_LOG = Topic("phase_log", "std_msgs/msg/String", True, _PHASES)
"""`phase` has a history of one message, so that a late subscriber receives the current phase only. The recorder stores
the messages of this topic as `phase`, so that none is lost."""

OTHERS = (
    "cmd_vel",
    "footsteps",
    "footstep_status",
    "arm_trajectory",
    "left_hand_target",
    "right_hand_target",
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
    Topic("joint_effort_commands", "sensor_msgs/msg/JointState", False, _HISTORY),
    Topic("base_twist", "geometry_msgs/msg/TwistStamped", False, _HISTORY, "plant"),
    Topic("left_wrench", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "plant"),
    Topic("right_wrench", "geometry_msgs/msg/WrenchStamped", False, _HISTORY, "plant"),
    Topic("hand_target_applied", "geometry_msgs/msg/PoseStamped", True, _PHASES),
    Topic("push_applied", "geometry_msgs/msg/WrenchStamped", True, _PHASES, "plant"),
)

BODY_TOPICS: dict[str, Topic] = {name: TOPICS[name] for name in _SHARED} | {topic.name: topic for topic in _BODY}
"""The topics of a whole-body walk."""

BODY_REQUIRED = ("joint_states", "base_pose", "base_twist", "joint_effort_commands", "walk_config")
"""Topics that a bag of a whole-body walk must contain."""
