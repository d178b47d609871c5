"""Random faults of states and commands in any order, to `drive` and to `physics`, both with a robot in physics.

Whatever arrives, four laws hold: a goal moves no faster than its joint can, and begins where the joint was measured; no
number beyond the limits of the joints leaves; no torque is more than the joint's; and motion ends within the timeout
after states or commands end. Afterwards the robot moves again.
"""

from __future__ import annotations

import itertools
import math
import os
import random
from collections import deque
from typing import Any

import numpy as np
import pytest
from inside import state
from ros2_control import ControllerManager, Known
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.plants.table import make_plant
from dqwalk_ros.robot.model import load_model
from dqwalk_ros.robot.servos import Drive

POPPY = overlaid(load("poppy"), "ros2_control")
MODEL = load_model(POPPY.robot)
NAMES, N = MODEL.joint_names, MODEL.n
TOPIC = {kind: f"forward_{kind}_controller/commands" for kind in ("position", "velocity")}
TIMEOUT, CHECK = POPPY.plant.command_timeout, 0.02
DURATION = 0.5
"""Time of the faults of one sequence [s]."""
STATES = {
    "good": 8, "lost": 2, "doubled": 1, "late": 1, "unstamped": 1, "frozen": 1, "clock set": 1, "not a number": 1,
    "glitch": 3, "slipped": 0.5, "restarted": 0.5,
}  # fmt: skip
COMMANDS = {
    "good": 8, "none": 2, "zero": 1, "absurd": 2, "torque": 2, "absurd torque": 1, "not a number": 1, "relayed": 1,
    "unstamped": 1, "of the clock": 1, "of the future": 1, "several": 1,
}  # fmt: skip
"""What a sender does for a while, and how often."""


def command(draw: random.Random, way: str, stamp: int, relayed: int, clock: int) -> JointState:
    """Return a command of a kind of `COMMANDS`; the stamps are those of the last state, an old one, and now [ns]."""
    size = {"absurd": 10.0 ** draw.choice((1, 2, 300)), "zero": 0.0}.get(way, 0.5)
    u = size * np.array([draw.uniform(-1.0, 1.0) for _ in range(N)])
    if way == "not a number":
        u[draw.randrange(N)] = math.nan
    torque = {"torque": 1.0, "absurd torque": 10.0 ** draw.choice((2, 4, 300))}.get(way, 0.0)
    tau = torque * np.array([draw.uniform(-3.0, 3.0) for _ in range(N)])
    msg = state(NAMES, [], 0.0, velocity=u, effort=tau if torque else [])
    stamps = {"unstamped": 0, "relayed": relayed, "of the clock": clock, "of the future": stamp + 10**12}
    msg.header.stamp = ros.time_msg(stamps.get(way, stamp))
    return msg


class Battery:
    """One node and its robot, held in the air.

    Attributes
    ----------
    moved : int
        Number of messages that moved the robot.
    kinds : set of str
        What has happened.
    """

    def __init__(self, make: Any, rate: float, interface: str, seed: int) -> None:
        self.dt, self._interface, self._random = 1.0 / rate, interface, random.Random(seed)
        values = {
            "dt": self.dt,
            "servo.assumed_rate": rate,
            "servo.assumed_latency": self.dt,
            "servo.assumed_lead": 0.02,
        }
        config = POPPY.updated({**values, "output.interface": interface, "physics.held": True})
        plant = make_plant("physics", config.updated({"servo.window": 1.0}), MODEL)
        self._robot = ControllerManager(plant, interface, NAMES, MODEL.imu, rate)
        self._drive = make("drive", config)
        self._drive.node._controllers = Known()
        self._node, self._sent = self._drive.node, self._drive.got[TOPIC[interface]]
        self._fastest = MODEL.velocity_max
        self._most = np.abs(Drive.of(config, MODEL).angles(MODEL.effort_max))
        self.moved, self.kinds = 0, set[str]()
        self._heard = self._commanded = -math.inf  # times of the last message that may allow motion [s]
        self._seen: deque[np.ndarray] = deque(maxlen=6)  # angles that were sent
        self._out: np.ndarray | None = None
        self._path: deque[tuple[float, np.ndarray]] = deque(maxlen=100)  # of the goals
        self._stamps, self._stamp = 0, 0  # offset of the stamps, and the last one [ns]
        self._offset, self._glitch = np.zeros(N), 0
        self._queue: list[tuple[float, JointState, np.ndarray]] = []
        self._relayed, self._done, self._due = 1, 0, 0.0

    @property
    def _now(self) -> float:
        return float(self._drive.clock.now)

    def sequence(self) -> None:
        """Let faults happen; then states, commands or both end; then all is well again."""
        draw = self._random
        end, until = self._now + DURATION, [0.0, 0.0]
        mood, way = "good", "good"
        while self._now < end:
            if self._now >= until[0]:
                mood, until[0] = self._drawn(STATES), self._now + draw.uniform(self.dt, 0.15)
            if self._now >= until[1]:
                way, until[1] = self._drawn(COMMANDS), self._now + draw.uniform(self.dt, 0.15)
            self.kinds |= {f"state {mood}", f"command {way}"}
            self._period(mood, way)
            if draw.random() < 0.005:
                self._reset()
        self._done += 1
        ends = ("states", "commands", "both")[self._done % 3]
        end = self._now + TIMEOUT + 5 * CHECK
        while self._now < end:
            self._period(
                "lost" if ends != "commands" else "good", self._drawn(COMMANDS) if ends == "states" else "none"
            )
        self._recover()

    def _drawn(self, kinds: dict[str, float]) -> str:
        return self._random.choices(list(kinds), list(kinds.values()))[0]

    def _period(self, mood: str, way: str) -> None:
        """Simulate the robot for a period, and deliver its state and the commands."""
        true, _ = self._robot.update()
        self._drive.clock.now += self.dt
        for msg, right in self._messages(mood, dict(zip(true.name, true.position, strict=True))):
            self._deliver(msg, right)
        for _ in range(3 if way == "several" else 1):
            if way != "none":
                self._command(way)
        if self._now >= self._due - 1e-9:
            self._due = self._now + CHECK
            self._node._check()
            self._judge(self._now, None)

    # ------------------------------------------------------------------ the robot

    def _messages(self, mood: str, angles: dict[str, float]) -> list[tuple[JointState, np.ndarray]]:
        """Return the states that arrive in this period, each with the angles (n,) that it should have."""
        draw, moment = self._random, self._robot.stamp
        if mood == "restarted":
            self._stamps, self._robot._command, mood = -moment + draw.randrange(10**9), None, "lost"
        if mood == "clock set" and draw.random() < 0.2:
            self._stamps += round(1e9 * draw.choice((-1e9, -5.0, -0.05, 0.05, 5.0, 3600.0)))
            self._stamps = self._stamps if moment + self._stamps > 0 else 0  # there is no time before 1970
        if mood == "slipped" and draw.random() < 0.2:
            self._offset[draw.randrange(N)] += draw.uniform(-0.3, 0.3)
        right = np.array([angles[name] for name in NAMES]) + self._offset
        q = right.copy()
        if mood == "glitch" and draw.random() < 0.5:
            self._glitch = (self._glitch + draw.randrange(1, N)) % N  # three at the same joint would be believed
            q[self._glitch] += draw.choice((-1.0, 1.0)) * 10.0 ** draw.choice((-3, -2, -1, -0.5, 0, 300))
        if mood == "not a number":
            q[draw.randrange(N)] = draw.choice((math.nan, math.inf, -math.inf))
        if mood != "frozen":
            self._stamp = moment + self._stamps
        msg = state(NAMES, q, 1e-9 * (0 if mood == "unstamped" else self._stamp))
        late = self._now + (draw.uniform(0.0, 0.06) if mood == "late" else 0.0)
        if mood != "lost":
            self._queue += [(late, msg, right)] * (2 if mood == "doubled" else 1)
        due = [one for one in self._queue if one[0] <= self._now]
        self._queue = [one for one in self._queue if one[0] > self._now]
        return [(msg, right) for _, msg, right in due]

    def _deliver(self, msg: JointState, right: np.ndarray) -> None:
        q, gate = np.array(msg.position), self._node._law.gate
        at = gate.at.copy()
        reach = (self._node._now() - at + self.dt) * self._fastest
        if np.isfinite(q).all():
            self._seen.append(q)
            self._heard = self._now
        self._drive.send("joint_states", msg)
        self._judge(self._now, None)
        far = (gate.at > at) & (np.abs(gate.q - right) > 2.0 * reach)  # from the last one, which may be as far off
        assert not (far & (self._offset == 0.0)).any(), "an impossible angle is used"

    # ------------------------------------------------------------------ the controller

    def _command(self, way: str) -> None:
        if self._random.random() < 0.02:
            self._relayed = self._stamp
        clock = self._node.get_clock().now().nanoseconds
        msg = command(self._random, way, self._stamp, self._relayed, clock)
        if np.isfinite(msg.velocity).all():
            self._commanded = self._now
        active = self._node._law.active
        self._drive.send("joint_velocity_commands", msg)
        self._judge(self._now, active)

    def _reset(self) -> None:
        assert self._drive.call("reset", Trigger.Request()).success
        self._judge(self._now, None)

    def _recover(self) -> None:
        """Check that, with good sensors and after a reset, the robot moves again.

        It may first have to return: with a slipped encoder a joint can have left its range.
        """
        self._offset[:] = 0.0
        self._reset()
        self._drive.clock.now += 1.1  # two controllers may have been suspected
        before, end = self.moved, self._now + 1.0
        while self.moved == before:
            assert self._now < end, [text for _, text in self._drive.log.lines[-5:]]
            self._period("good", "good")
        self._drive.log.lines.clear()

    # ------------------------------------------------------------------ the laws

    def _judge(self, now: float, active: bool | None) -> None:
        """Check the messages to the robot; `active`: whether goals had to continue, None if no command was given."""
        for msg in self._sent:
            out = np.array(msg.data)
            self._robot.on_commands(msg)
            assert np.isfinite(out).all()
            if self._interface == "velocity":
                moves = bool(out.any())
                assert (np.abs(out) <= self._fastest + 1e-9).all()
            else:
                moves = self._out is not None and bool((out != self._out).any())
                self._judge_goal(now, out, active)
            if moves:
                assert active is not None, "moved without a command"
                assert now - self._heard <= TIMEOUT + 1e-9, "moved without states"
                assert now - self._commanded <= 1e-9
                self.moved += 1
            self._out = out
        self._sent.clear()
        law = self._node._law
        assert (np.abs(law._offset) <= self._most + 1e-12).all()
        if self._interface == "velocity" and self._out is not None and self._out.any():
            for what, last in (("states", self._heard), ("commands", self._commanded)):
                assert now - last <= TIMEOUT + 3 * CHECK, f"moves on without {what}"

    def _judge_goal(self, now: float, goal: np.ndarray, active: bool | None) -> None:
        """Check that a goal continues, or begins where a joint was measured."""
        assert (goal >= MODEL.q_min - POPPY.safety.outside - 1e-9).all()
        assert (goal <= MODEL.q_max + POPPY.safety.outside + 1e-9).all()
        step = 2 * self.dt * self._fastest + 1e-9
        if self._out is not None and active is not False:
            assert (np.abs(goal - self._out) <= step).all()
            for before, was in itertools.takewhile(lambda one: now - one[0] <= 0.1, reversed(self._path)):
                assert (np.abs(goal - was) <= self._fastest * (now - before) + step).all()
        elif self._out is None or (np.abs(goal - self._out) > step).any():
            near = np.min([np.abs(goal - q) for q in self._seen], axis=0)
            continued = np.full(N, math.inf) if self._out is None else np.abs(goal - self._out)
            assert (np.minimum(near, continued) <= step).all()
            self._path.clear()
        self._path.append((now, goal))


MANY = int(os.environ.get("DQWALK_BATTERY", "10000")) // (2 * len(TOPIC))
"""Number of long sequences of each kind."""
FEW = [(100.0, "velocity", 3), (200.0, "position", 3)]
LONG = {"marks": (pytest.mark.long, pytest.mark.timeout(7200))}


@pytest.mark.parametrize(
    ("rate", "interface", "count"), FEW + [pytest.param(r, i, MANY, **LONG) for r in (100.0, 200.0) for i in TOPIC]
)
def test_random_faults_move_no_joint_wrongly(make: Any, rate: float, interface: str, count: int) -> None:
    """The node is started again after each 100 sequences."""
    kinds, moved = set[str](), 0
    for first in range(0, count, 100):
        battery = Battery(make, rate, interface, seed=first)
        for _ in range(min(100, count - first)):
            battery.sequence()
        kinds, moved = kinds | battery.kinds, moved + battery.moved
    print(f"\n{count} sequences at {rate:g} Hz, {interface}: {moved} messages moved the robot")
    assert moved > 10 * count
    if count > 100:
        assert kinds == {*(f"state {kind}" for kind in STATES), *(f"command {kind}" for kind in COMMANDS)}


class PhysicsBattery:
    """The node `physics`, which has the states of its own robot, held in the air.

    Attributes
    ----------
    moved : int
        Number of periods in which a goal moved.
    """

    def __init__(self, make: Any, rate: float, seed: int) -> None:
        self.dt, self._random, self.moved = 1.0 / rate, random.Random(seed), 0
        config = overlaid(load("poppy"), "physics").updated(
            {"dt": self.dt, "physics.held": True, "servo.assumed_lead": 0.02}
        )
        self._physics, self._timeout = make("physics", config), config.plant.command_timeout
        self._node, self._states = self._physics.node, self._physics.got["joint_states"]
        self._most = np.abs(Drive.of(config, MODEL).angles(MODEL.effort_max))
        self._commanded, self._relayed = -math.inf, 0

    def sequence(self) -> None:
        """Let faults happen; then commands end; then all is well again."""
        draw, clock = self._random, self._physics.clock
        end, until, way = clock.now + DURATION, 0.0, "good"
        while clock.now < end:
            if clock.now >= until:
                way, until = draw.choices(list(COMMANDS), list(COMMANDS.values()))[0], clock.now + draw.uniform(0, 0.15)
            self._period(*[way] * (3 if way == "several" else 1))
            if draw.random() < 0.005:
                assert self._physics.call("reset", Trigger.Request()).success
        end = clock.now + self._timeout + 5 * CHECK
        while clock.now < end:
            self._period()
        clock.now += 1.1  # two controllers may have been suspected
        assert self._physics.call("reset", Trigger.Request()).success  # a joint may have moved against its torque
        before = self.moved
        for _ in range(8):
            self._period("good")
        assert self.moved > before, self._physics.log.lines[-5:]
        self._physics.log.lines.clear()
        self._states.clear()

    def _period(self, *ways: str) -> None:
        """Deliver commands, simulate the robot for a period, and check its goals."""
        clock, node, draw = self._physics.clock, self._node, self._random
        clock.now += self.dt * draw.choice((1.0, 1.0, 1.0, 0.5, 5.0))  # and periods that are missed
        for way in ways:
            if draw.random() < 0.02:
                self._relayed = node._stamp
            msg = command(draw, way, node._stamp, self._relayed, node.get_clock().now().nanoseconds)
            if way != "none":
                self._physics.send("joint_velocity_commands", msg)
                self._commanded = clock.now if np.isfinite(msg.velocity).all() else self._commanded
        law = node.plant._law
        before = law.goal.copy()
        node._on_period()
        assert (np.abs(law.goal - before) <= self.dt * MODEL.velocity_max + 1e-9).all()
        assert (law.goal >= MODEL.q_min - POPPY.safety.outside - 1e-9).all()
        assert (law.goal <= MODEL.q_max + POPPY.safety.outside + 1e-9).all()
        assert (np.abs(law._offset) <= self._most + 1e-12).all()
        assert np.isfinite(self._states[-1].position).all()
        if (law.goal != before).any():
            self.moved += 1
            assert clock.now - self._commanded <= self._timeout + 5 * self.dt + 1e-9, "moves on without commands"


@pytest.mark.parametrize("rate", [100.0, pytest.param(200.0, **LONG)])
def test_random_faults_move_no_simulated_joint_wrongly(make: Any, rate: float) -> None:
    """The node is started again after each 100 sequences."""
    count, moved = (3 if rate == 100.0 else 2 * MANY * len(TOPIC)), 0
    for first in range(0, count, 100):
        battery = PhysicsBattery(make, rate, seed=first)
        for _ in range(min(100, count - first)):
            battery.sequence()
        moved += battery.moved
    print(f"\n{count} sequences at {rate:g} Hz, physics: goals moved in {moved} periods")
    assert moved > 10 * count
