"""Record a walk as a rosbag2, byte for byte as it went over the wire.

The bag's time is the walk's: a message is filed under its own stamp, one without a stamp, or with one that is seconds
ahead of the walk, under the newest stamp so far. In lockstep that is simulated time, so that a bag plays back, plots
and compares alike however fast the machine was; in real time the two differ by the transport's delay. A message that
was published again, word for word, because its answer was late is recorded once.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy
from rosbags.rosbag2 import WriterError

from dqwalk_ros.errors import StateError
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import STEADY, THROTTLE, WalkNode
from dqwalk_ros.report.bag.storage import connect, flush, open_writer
from dqwalk_ros.topics import BODY_TOPICS, PHASE_LOG, TOPICS, Topic

__all__ = ["OTHERS", "Recorder", "WalkTime"]

_DEPTH = 50_000
"""Messages that may wait here: minutes of real time, most of a minute of lockstep at full speed."""
_FLUSH = 1.0
"""A recorder that is killed loses what came within so long at most [s]."""
_LOOK = 0.5
"""Time between two looks for topics that nobody published before [s]."""
_LINGER = {True: 6.0, False: 0.5}
"""Longest time for what is still under way when the end is asked for [s], in lockstep and in real time."""
_ALL = TOPICS | BODY_TOPICS
"""Those of either kind of walk; the bag has the ones that something was said on."""
_PHYSICS = tuple(name for name, topic in TOPICS.items() if topic.source == "physics")
OTHERS = (
    "cmd_vel",
    "footsteps",
    "footstep_status",
    "push",
    "hand_target",
    "joint_goals",
    "/tf",
    "/tf_static",
    "/rosout",
)
"""What steers a walk or goes with it; it is filed under the newest stamp of joint_states."""
_EACH_TICK = ("joint_states", "joint_velocity_commands", "base_pose", "joint_effort_commands", "base_twist", *_PHYSICS)
_STAMPED = ("sensor_msgs/", "geometry_msgs/", "diagnostic_msgs/")


FAR = 5_000_000_000
"""A state whose stamp is so far from those before it [ns] may be the error of one message."""


class WalkTime:
    """The newest stamp of a walk, which one state with a stamp that cannot be does not move.

    Attributes
    ----------
    newest : int
        [ns]; -1 before the first state.
    """

    def __init__(self) -> None:
        self.newest = -1
        self._far: int | None = None  # of the state before, where it was far from all others

    def add(self, stamp: int) -> None:
        """Take the stamp of a state [ns]; one that is far away counts once the next state is beside it."""
        known = self.newest if self._far is None or abs(stamp - self._far) > FAR else self._far
        if self.newest < 0 or abs(stamp - known) <= FAR:
            self.newest = max(known, stamp)
            self._far = None
        else:
            self._far = stamp


class Recorder(WalkNode):
    """Record a walk as a rosbag2 (MCAP), byte for byte; report how much came and whether anything is missing.

    Subscribes to every topic of the walk::

        joint_states, joint_velocity_commands, phase, phase_start, com_target, swing_target, support_foot, base_pose,
        walk_config, walk_origin, robot_description, /diagnostics; those of the node physics where it runs;
        of the whole body: joint_effort_commands, base_twist, left_wrench, right_wrench, hand_target_applied,
        push_applied; and where somebody publishes them: cmd_vel, footsteps, footstep_status, push, hand_target,
        joint_goals, /tf, /tf_static, /rosout

    Writes::

        the folder --bag: an .mcap file and metadata.yaml, for ros2 bag, Foxglove and `dqwalk report`

    Sections of the schema: plant.

    Example::

        dqwalk_recorder --bag my_walk --ros-args --params-file config/paper.yaml

    Raises
    ------
    BagError
        If the folder is there already or cannot be made.
    """

    pause = 0.05
    has_diagnostics = False

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("recorder", options, **keywords)
        config = self.config
        self._period, self._linger = round(config.dt * 1e9), _LINGER[config.plant.lockstep]
        self._path = Path(options.bag)
        self._writer = open_writer(self._path)
        self._connections: dict[str, Any] = {}
        self._counts = dict.fromkeys(_ALL, 0)
        self._last = dict.fromkeys(_EACH_TICK, -1)
        self._last_raw: dict[str, bytes] = {}
        self._missing = dict.fromkeys(_EACH_TICK, 0)
        self._time = WalkTime()
        self._early: list[tuple[str, bytes]] = []  # what came before the first stamp
        self._handled = 0
        self._seen = -1
        self._stop_at = float("inf")
        self._others: dict[str, Topic] = {}  # that are not in the table, as they were found
        for name, topic in _ALL.items():
            self._subscribe(PHASE_LOG.name if name == "phase" else topic.name, name, topic)
        self._look_for_others()
        self.create_timer(_FLUSH, self._flush, clock=STEADY)
        self.create_timer(_LOOK, self._look_for_others, clock=STEADY)
        self.get_logger().info(f"recording to {self._path}")

    def _subscribe(self, topic_name: str, name: str, topic: Topic) -> None:
        profile = ros.latched(topic.depth) if topic.latched else ros.stream(_DEPTH)
        kind = ros.message_type(topic.type)
        self.create_subscription(kind, topic_name, partial(self._on_message, name, topic), profile, raw=True)

    def _look_for_others(self) -> None:
        """Subscribe to what else belongs to a walk, in whatever type it is published, once somebody publishes it."""
        for name in OTHERS:
            ends = () if name in self._others else self.get_publishers_info_by_topic(self.resolve_topic_name(name))
            for end in ends[:1]:
                latched = end.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
                topic = self._others[name] = Topic(name, end.topic_type, latched, 100, "", "other")
                try:
                    self._subscribe(name, name, topic)
                except (ImportError, AttributeError):
                    self.get_logger().warning(f"cannot record {name}: its type {end.topic_type} is not installed")

    def _on_message(self, name: str, topic: Topic, raw: bytes) -> None:
        self._handled += 1
        stamp = self._time.newest
        if topic.source != "other" and topic.type.startswith(_STAMPED):
            try:
                own = ros.stamp_of(raw)
            except StateError as error:
                self.get_logger().error(f"{name} not recorded: {error}", **THROTTLE)
                return
            if name in self._last:
                if raw == self._last_raw.get(name):
                    return
                self._last_raw[name] = raw
            if name == "joint_states":
                self._time.add(own)
            # what is latched may be far older than the recording
            stamp = max(own, self._time.newest) if topic.latched else own
            if stamp > self._time.newest + FAR >= FAR:  # no bag is to end in another year
                stamp = self._time.newest
            elif name in self._last:
                self._note_gap(name, own)
        if self._time.newest < 0:
            self._early.append((name, bytes(raw)))
            return
        try:
            for early, data in self._early:
                self._write(early, self._time.newest, data)
            self._early.clear()
            self._write(name, stamp, raw)
        except (OSError, WriterError) as error:
            self.get_logger().error(f"cannot write '{self._path}': {error}")
            self.stop(1)

    def _write(self, name: str, stamp: int, raw: bytes) -> None:
        if name not in self._connections:
            topic = _ALL.get(name) or self._others[name]
            self._connections[name] = connect(self._writer, self.resolve_topic_name(topic.name), topic)
        self._writer.write(self._connections[name], stamp, raw)
        self._counts[name] = self._counts.get(name, 0) + 1

    def _flush(self) -> None:
        try:
            if not self._path.exists():
                raise OSError("its folder was removed")
            flush(self._writer)
        except (OSError, WriterError) as error:
            self.get_logger().error(f"cannot write '{self._path}': {error}")
            self.stop(1)

    def _note_gap(self, name: str, own: int) -> None:
        last, self._last[name] = self._last[name], own
        silent = name == "center_of_pressure"  # while the robot is in the air
        if last >= 0 and own - last > 1.5 * self._period and not silent:
            self._missing[name] += round((own - last) / self._period) - 1

    def is_drained(self) -> bool:
        """Tell whether nothing more is on its way, or it has taken too long."""
        now = time.monotonic()
        self._stop_at = min(self._stop_at, now + self._linger)
        seen, self._seen = self._seen, self._handled
        return seen == self._seen or now > self._stop_at

    def close(self) -> None:
        """Finish the bag and log what is in it."""
        log = self.get_logger()
        try:
            for name, data in self._early:  # no state ever came: the walk's own messages are still worth keeping
                self._write(name, 0, data)
            self._writer.close()
        except (OSError, WriterError) as error:
            log.error(f"'{self._path}' is not complete, `dqwalk report` reads what is on the disk: {error}")
        log.info(f"{self._path}: " + ", ".join(f"{n} {count}" for n, count in self._counts.items() if count))
        missing = {name: count for name, count in self._missing.items() if count}
        if missing:
            log.warning("periods without a message: " + ", ".join(f"{n} {count}" for n, count in missing.items()))
        self.report("recorded", bag=str(self._path), counts=self._counts, missing=missing)
