"""Records a walk as a rosbag2; messages are stored unchanged, in serialised form.

Messages are recorded at the time of their own stamp. A message without a stamp, or with a stamp seconds ahead of the
walk, is recorded at the newest stamp so far. In lockstep this is simulated time, so a bag does not depend on the speed
of the machine; in real time it differs from the time of receipt by the transport delay. An identical message that was
published again in lockstep is recorded once. States of other joints, such as those of a gripper, are recorded, but tell
no time.
"""

from __future__ import annotations

import argparse
import contextlib
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy
from rosbags.rosbag2 import WriterError
from sensor_msgs.msg import JointState

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode, throttled
from dqwalk_ros.nodes.watchdog import ClockSteps
from dqwalk_ros.report.bag.storage import connect, flush, open_writer
from dqwalk_ros.support.errors import StateError
from dqwalk_ros.support.topics import BODY_TOPICS, EFFORT, OTHERS, PHASE_LOG, TOPICS, VELOCITY, Topic

_DEPTH = 50_000
"""Depth of the queues: minutes of real time, most of a minute of lockstep at full speed."""
_MOST_EARLY = 20_000
"""Largest number of messages that are kept until the first state arrives; a robot may be idle for hours."""
_FLUSH = 1.0
"""Period of writing to the disk [s]; a recorder that is killed loses up to two, as `TimerWaker` resets late timers."""
_DISCOVERY = 0.5
"""Period of the search for new topics [s]."""
_DRAIN = {True: 6.0, False: 0.5}
"""Longest wait at shutdown for messages that are still in transit [s], in lockstep and in real time."""
_ALL = TOPICS | BODY_TOPICS
"""Topics of both kinds of walk; the bag contains those on which a message was published."""
_PHYSICS = tuple(name for name, topic in TOPICS.items() if topic.source == "physics")
_EACH_TICK = ("joint_states", "joint_velocity_commands", "base_pose", "joint_effort_commands", "base_twist", *_PHYSICS)
_STAMPED = ("sensor_msgs/", "geometry_msgs/", "diagnostic_msgs/")
_FAR = 5_000_000_000
"""Jump of the stamp [ns] above which the stamp of a single message is considered wrong."""


class _RobotStates:
    """Tells the robot's messages of joint_states from those of a gripper: the commands name the joints of the robot."""

    _HEAD, _MOST = slice(12, 200), 100
    """Bytes of a serialised message behind its stamp, by which messages with the same joints are known, and largest
    number of them that is remembered."""

    def __init__(self) -> None:
        self._joints: set[str] = set()
        self._reader: ros.JointReader | None = None
        self._commands: set[bytes] = set()  # first bytes, which are frame and names
        self._foreign: dict[bytes, bool] = {}  # by the same of states

    def learn(self, raw: bytes) -> bool:
        """Learn the joints of a command; return whether there are new ones."""
        head = bytes(raw[self._HEAD])
        if head in self._commands or len(self._commands) >= self._MOST:
            return False
        self._commands.add(head)
        with contextlib.suppress(StateError):
            if new := {*ros.deserialized(raw, JointState).name} - self._joints:
                self._joints |= new
                self._reader = ros.JointReader(sorted(self._joints))
                self._foreign.clear()
                return True
        return False

    def is_foreign(self, raw: bytes) -> bool:
        """Return whether a message has joints, but none of the robot, as far as these are known."""
        if self._reader is None:
            return False
        head = bytes(raw[self._HEAD])
        if head not in self._foreign:
            if len(self._foreign) >= self._MOST:
                self._foreign.clear()
            try:
                self._foreign[head] = self._reader.is_foreign(ros.deserialized(raw, JointState))
            except StateError:
                return True
        return self._foreign[head]


class Recorder(WalkNode):
    """Record a walk as a rosbag2 (MCAP); at the end report the number of messages and whether any are missing.

    Subscribes to every topic of the walk::

        joint_states, joint_velocity_commands, phase, phase_start, com_target, swing_target, support_foot, base_pose,
        walk_config, walk_origin, robot_description, /diagnostics; those of the node physics, if it runs;
        of the whole body: joint_effort_commands, base_twist, left_wrench, right_wrench, hand_target_applied,
        push_applied; and, if they are published: cmd_vel, footsteps, footstep_status, arm_trajectory,
        left_hand_target, right_hand_target, odom, push, hand_target, joint_goals, /tf, /tf_static, /rosout

    Writes::

        the folder --bag: an .mcap file and metadata.yaml, for ros2 bag, Foxglove and `dqwalk report`

    Sections of the schema: dt, plant.

    Example::

        dqwalk_recorder --bag my_walk --ros-args --params-file config/paper.yaml

    Raises
    ------
    BagError
        If the folder exists already or cannot be created.
    """

    pause = 0.05
    has_diagnostics = False

    def __init__(self, options: argparse.Namespace, **keywords: Any) -> None:
        super().__init__("recorder", options, **keywords)
        config = self.config
        self._period, self._drain_time = round(config.dt * 1e9), _DRAIN[config.plant.lockstep]
        # after a suspension a queue of commands may be read before that of the states they answer
        self._ahead = max(_FAR, _DEPTH * self._period)
        self._path = Path(options.bag)
        self._writer = open_writer(self._path)
        self._connections: dict[str, Any] = {}
        self._counts = dict.fromkeys(_ALL, 0)
        self._last = dict.fromkeys(_EACH_TICK, -1)
        self._last_raw: dict[str, bytes] = {}
        self._missing = dict.fromkeys(_EACH_TICK, 0)
        self._newest, self._steps = -1, ClockSteps()  # stamp of the newest state [ns]; -1 before the first
        self._robot = _RobotStates()
        self._early: list[tuple[str, bytes]] = []  # messages before the first stamp
        self._handled = self._handled_before = 0  # number of messages, now and at the last check of `is_drained`
        self._stop_at = float("inf")
        self._others: dict[str, Topic] = {}  # topics of `OTHERS`, as discovered
        for name, topic in (_ALL | {"phase": PHASE_LOG}).items():
            self._subscribe(topic.name, name, topic)
        self._sources: tuple[str, ...] = ()  # names of the nodes that publish joint_states
        self._discover()
        self.create_timer(_FLUSH, self._flush)
        self.create_timer(_DISCOVERY, self._discover)
        self.get_logger().info(f"recording to {self._path}")

    def _subscribe(self, topic_name: str, name: str, topic: Topic) -> None:
        profile = ros.latched(topic.depth) if topic.latched else _DEPTH
        kind = ros.message_type(topic.type)
        self.listen(kind, topic_name, partial(self._on_message, name, topic), profile, raw=True)

    def _discover(self) -> None:
        """Subscribe to those topics of `OTHERS` that are published, with the type of their publisher."""
        self._sources = ros.publishers_of(self, "joint_states") or self._sources
        for name in OTHERS:
            ends = () if name in self._others else self.get_publishers_info_by_topic(self.resolve_topic_name(name))
            for end in ends[:1]:
                latched = all(end.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for end in ends)
                topic = self._others[name] = Topic(name, end.topic_type, latched, 100, "")
                try:
                    self._subscribe(name, name, topic)
                except (ImportError, AttributeError):
                    self.get_logger().warning(f"cannot record {name}: its type {end.topic_type} is not installed")

    def _on_message(self, name: str, topic: Topic, raw: bytes) -> None:
        self._handled += 1
        stamp = self._newest
        if name in (VELOCITY, EFFORT) and self._robot.learn(raw):
            self._last["joint_states"], self._missing["joint_states"] = -1, 0  # those so far may be of a gripper
        foreign = name == "joint_states" and self._robot.is_foreign(raw)  # recorded as a topic of `OTHERS`
        if not foreign and name not in OTHERS and topic.type.startswith(_STAMPED):
            try:
                own = ros.stamp_of(raw)
            except StateError as error:
                self.get_logger().error(f"{name} not recorded: {error}", **throttled())
                return
            if name in self._last:
                if raw == self._last_raw.get(name):
                    return
                self._last_raw[name] = raw
            if name == "joint_states":
                near = self._newest < 0 or abs(own - self._newest) <= _FAR
                if self._steps.accepts(own, follows=near):
                    self._newest = max(own, self._newest) if near else own
            # a latched message may be much older than the recording
            stamp = max(own, self._newest) if topic.latched else own
            if stamp > self._newest + self._ahead >= self._ahead:  # a wrong one must not extend the bag by years
                stamp = self._newest
            elif name in self._last:
                self._note_gap(name, own)
        if self._newest < 0:
            if topic.latched or len(self._early) < _MOST_EARLY:
                self._early.append((name, bytes(raw)))
            else:
                self.get_logger().warning("nothing more is recorded before joint_states", **throttled(30.0))
            return
        try:
            for early, data in self._early:
                self._write(early, self._newest, data)
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
        what = f"{name} of other joints" if name == "joint_states" and self._robot.is_foreign(raw) else name
        self._counts[what] = self._counts.get(what, 0) + 1

    def _flush(self) -> None:
        try:
            flush(self._writer)
        except (OSError, WriterError) as error:
            self.get_logger().error(f"cannot write '{self._path}': {error}")
            self.stop(1)

    def _note_gap(self, name: str, own: int) -> None:
        last, self._last[name] = self._last[name], own
        optional = name == "center_of_pressure"  # not published while the robot is in the air
        if last >= 0 and own - last > 1.5 * self._period and not optional:
            self._missing[name] += round((own - last) / self._period) - 1

    def is_drained(self) -> bool:
        """Return whether no message has arrived since the last call, or the time limit has passed."""
        now = self.steady()
        self._stop_at = min(self._stop_at, now + self._drain_time)
        before, self._handled_before = self._handled_before, self._handled
        return before == self._handled or now > self._stop_at

    def close(self) -> None:
        """Finish the bag and log its contents."""
        log = self.get_logger()
        try:
            for name, data in self._early:  # no state was received: keep the other messages
                self._write(name, 0, data)
            flush(self._writer)
            self._writer.close()
        except (OSError, WriterError) as error:
            log.error(f"'{self._path}' is incomplete; `dqwalk report` reads the part on the disk: {error}")
            self.stop(1)
        if self._sources and not self._counts["joint_states"]:
            log.error(f"no message of joint_states was recorded, although {', '.join(self._sources)} publishes it")
            self.stop(1)
        log.info(f"{self._path}: " + ", ".join(f"{n} {count}" for n, count in self._counts.items() if count))
        missing = {name: count for name, count in self._missing.items() if count}
        if missing:
            log.warning("periods without a message: " + ", ".join(f"{n} {count}" for n, count in missing.items()))
        self.report(counts=self._counts, missing=missing)
