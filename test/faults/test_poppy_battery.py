"""Random sequences of wrong angles, gaps, stamps, clocks and restarts at the driver of Poppy, on its emulated buses.

The driver is a node in the process of the test, with a clock that the test advances. In each period the goals move no
further than the law allows, no torque is above its limit, and no old angle counts as fresh; motion ends when states or
commands end; and the robot moves again after the faults.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dynamixel_bus import BUSES, MOTORS, TEMPERATURE, TYPES, VOLTAGE, Memory
from inside import state
from poppy_rig import CONFIG, DT, MODEL, driver_node
from rclpy.time import Time
from std_srvs.srv import SetBool, Trigger

OWN = CONFIG.updated({"poppy.start_speed": 1.0, "servo.window": 0.05, "servo.assumed_lead": 0.02})
TIMEOUT = OWN.plant.command_timeout
STAMPS = ("state", "clock", "none", "first", "future", "old")
SPEEDS = (0.1,) * 4 + (1.0,) * 4 + (0.0, 100.0, 1e300, math.nan)
TORQUES = (None, None, 0.5, 0.5, 0.5, 3.0, 3.0, 3.0, 100.0, 1e300, math.nan)
LATE = (0.05, 0.15, 0.4)  # [s]
CLOCK = (-1e3, -1.0, -0.05, 0.05, 1.0, 1e3)  # [s]
EVENTS = {
    "glitch": 6, "dead": 2, "silent": 1, "lossy": 3, "damaged": 1, "garbage": 2, "unplugged": 1, "no commands": 2,
    "stamps": 3, "clock": 2, "late": 2, "blocked": 1, "power": 1, "hot": 1, "low": 1, "bits": 1, "activate": 1,
    "compliant": 1, "restart": 0.05,
}  # fmt: skip
"""How often something happens, in relation to the others."""
_STEP = 0.003
"""Two steps of an MX, and more than half a step of an AX, which the head has [rad]."""


class Battery:
    """The driver, its servos, and what happens to them.

    Attributes
    ----------
    sequences, periods, moving, stopped : int
        Number of sequences, of periods, of those in which a goal moved, and of ends of states or commands before which
        goals moved.
    largest : float
        Largest motion of a goal in a period, as a part of the allowed one.
    latest : float
        Longest time for which goals moved after the last state or command [s].
    """

    def __init__(self, make: Any, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
        self.rng, self._start = random.Random(seed), lambda memory: driver_node(make, monkeypatch, OWN, memory)
        self.sequences = self.periods = self.moving = self.stopped = 0
        self.largest = self.latest = 0.0
        self.offset, self.stamps, self.first = 1e4, "state", -1
        self.healed: list[tuple[int, Callable[[], None]]] = []  # after which period a fault ends
        self.silent_until, self.answered = 0, -1
        self.truth: deque[tuple[float, np.ndarray]] = deque()  # recent angles, and their times
        self.wrong: dict[str, float] = {}  # until when a servo may have shown a wrong angle [s]
        self.restart(None)

    def restart(self, memory: Memory | None) -> None:
        """Start the driver, or close it and start it again with the servos as they are."""
        if memory is not None:
            self.heal()
            self.node.close()
        self.one, self.memory = self._start(memory)
        self.node, self.clock = self.one.node, self.memory.clock
        self.node.get_clock = lambda: SimpleNamespace(now=self.time)
        kinds = [TYPES[MOTORS[name].type] for name in self.plant.names]
        self._half = np.radians([0.5 * kind.range / (kind.positions - 1) for kind in kinds])  # of a step
        self.call("activate", Trigger.Request())

    def heal(self) -> None:
        """End all faults."""
        self.memory.clear_faults()
        for name in MOTORS:
            servo = self.memory.servo(name)
            servo.error, servo.memory[TEMPERATURE], servo.memory[VOLTAGE] = 0, 40, 120

    def time(self) -> Time:
        """Return the time of the system clock."""
        return Time(nanoseconds=round(1e9 * (self.clock.now + self.offset)))

    @property
    def plant(self) -> Any:
        return self.node._plant

    def call(self, service: str, request: Any) -> bool:
        """Call a service, and check that the motors that it switches on hold the angles that they have."""
        found = self.one.call(service, request)
        answer = found.success and "already" not in found.message
        if answer and self.plant.active:
            held = [self.memory.goal(name) for name in self.plant.names]
            np.testing.assert_allclose(held, self.plant.measured.q, atol=1e-6)
        return bool(answer)

    # ------------------------------------------------------------------ what happens

    def happen(self) -> None:
        """Let something happen that lasts for some periods."""
        rng, kind = self.rng, self.rng.choices(list(EVENTS), EVENTS.values())[0]
        servos, lasts = self.memory.servos[rng.choice(BUSES)], rng.choice([1, 2, 4, 12])
        servo = rng.choice(list(servos.servos.values()))
        if kind == "glitch":
            servos.slip[servo.number] = rng.uniform(-180.0, 180.0)
        elif kind == "dead":
            servos.dead = True
        elif kind == "silent":
            servos.silent.add(servo.number)
        elif kind == "lossy":
            servos.drop_reply = lambda packet: rng.random() < 0.3
        elif kind == "damaged":
            servos.damaged = rng.choice([0.05, 1.0])
        elif kind == "garbage":
            servos.garbage = rng.choice([0.3, 1.0])
        elif kind == "unplugged":
            servos.unplugged = True
        elif kind == "hot":
            servo.memory[TEMPERATURE] = 255
        elif kind == "low":
            servo.memory[VOLTAGE] = 80
        elif kind == "bits":
            servo.error = rng.choice([1, 4, 32, 64, 127])
        elif kind == "blocked":
            servo.blocked = True
            lasts = 80
        elif kind == "power":
            servos.cut_power()
        elif kind == "no commands":
            self.silent_until = self.periods + lasts
        elif kind == "stamps":
            self.stamps = rng.choice(STAMPS)
        elif kind == "clock":
            self.offset = max(self.offset + rng.choice(CLOCK), 0.0)
        elif kind == "late":
            self.clock.now += rng.choice(LATE)
        elif kind == "activate":
            self.call("activate", Trigger.Request())
        elif kind == "compliant":
            self.one.call("compliant", SetBool.Request(data=True))
        elif kind == "restart":
            self.restart(self.memory)
        self.healed.append((self.periods + lasts, self.heal))

    def command(self) -> None:
        """Send commands with random values and the present kind of stamps."""
        rng, n = self.rng, MODEL.n
        last, clock = 1e-9 * self.node._stamp, 1e-9 * self.time().nanoseconds
        if self.node._stamp == self.answered and self.stamps == "state" and rng.random() < 0.9:
            return  # a controller answers each state once
        self.answered = self.node._stamp
        self.first = last if self.first < 0.0 else self.first
        stamps = {
            "state": last,
            "clock": clock,
            "none": 0.0,
            "first": self.first,
            "future": last + 9.0,
            "old": last - 1.0,
        }
        speed, torque = rng.choice(SPEEDS), rng.choice(TORQUES)
        fields = {"velocity": [speed * rng.uniform(-1.0, 1.0) for _ in range(n)]}
        if torque is not None:
            fields["effort"] = [torque * rng.uniform(-1.0, 1.0) for _ in range(n)]
        message = state(MODEL.joint_names, [], max(stamps[self.stamps], 0.0), **fields)
        for _ in range(rng.choice([1, 1, 1, 3])):
            self.one.send("joint_velocity_commands", message)

    # ------------------------------------------------------------------ what must hold

    def tick(self, *, commands: bool = True) -> None:
        """Let a period pass, and check the goals."""
        self.periods += 1
        self.clock.now += DT
        for done in [one for one in self.healed if one[0] <= self.periods]:
            self.healed.remove(done)
            done[1]()
        plant, names = self.plant, self.plant.names
        for name in names:
            self.memory.servo(name).advance(self.clock.now)
            if MOTORS[name].id in self.memory.of(name).slip:
                self.wrong[name] = self.clock.now + 1.0
        self.truth.append((self.clock.now, np.array([self.memory.angle(name) for name in names])))
        while self.truth[0][0] < self.clock.now - TIMEOUT - DT:
            self.truth.popleft()
        goal, outside, registers = plant.goal.copy(), plant._law.wanted.copy(), self.registers()
        passed, blocked = self.clock.now - self.node._sent_at, set(plant.watch.lasting)
        if commands and self.periods > self.silent_until:
            self.command()
        self.node._on_period()

        law, limits = plant._law, plant._law._limits
        relieved = np.array([f"blocked/{name}" in set(plant.watch.lasting) - blocked for name in names])
        moved, allowed = np.abs(plant.goal - goal), limits.velocity_max * min(passed, 2.0 * DT)
        assert (relieved | ~(moved > allowed + 1e-9)).all(), "a goal jumps"
        if allowed.min() > 0.0 and plant.active:
            self.largest = max(self.largest, float((moved / allowed)[~relieved].max()))
        self.moving += bool(moved[~relieved].max(initial=0.0) > 1e-6)
        assert (np.abs(law._offset) <= limits.effort_max * law._drive.angles(np.ones(len(names))) + 1e-9).all()
        low, high = np.minimum(limits.q_min, outside) - 1e-9, np.maximum(limits.q_max, outside) + 1e-9
        assert (relieved | ~((plant.goal < low) | (plant.goal > high))).all(), "a goal leaves the limits"
        if plant.fresh:
            past = [q for _, q in self.truth]
            near = (plant.measured.q >= np.min(past, axis=0) - _STEP) & (
                plant.measured.q <= np.max(past, axis=0) + _STEP
            )
            trusted = np.array([self.wrong.get(name, 0.0) < self.clock.now for name in names])
            assert (near | ~trusted).all(), "an old angle counts as fresh"
        now = self.registers()
        written = (now == registers) | (np.abs(now - plant.goal) <= self._half + 1e-6)
        assert (written | relieved).all(), "another goal is written"  # that of a relieved joint follows

    def registers(self) -> np.ndarray:
        """Return the goals in the servos (N,) [rad]."""
        return np.array([self.memory.goal(name) for name in self.plant.names])

    def end(self, *, states: bool) -> None:
        """Let the states or the commands end, and check that the motion ends."""
        if states:
            self.healed.clear()
            for name in self.rng.choice([("lower",), ("upper",), BUSES]):
                self.memory.servos[name].dead = True
        ended = self.clock.now
        for _ in range(16):
            before, faults = self.plant.goal.copy(), set(self.plant.watch.lasting)
            ends = states or self.plant.ready  # the first pose is reached without commands
            self.tick(commands=states)
            known = self.plant.watch.lasting.keys() == faults  # a joint that is blocked is relieved later
            moved = not np.array_equal(self.plant.goal, before, equal_nan=True)  # nan before the torque is first on
            if ends and known and moved:
                self.latest = max(self.latest, self.clock.now - ended)
        assert self.latest <= TIMEOUT + 1e-9, "motion goes on"
        assert self.node._commands.gate.holding, "the driver does not say that it holds"
        self.healed.clear()
        self.heal()

    def move_by_hand(self) -> None:
        """Move the limbs apart with the torque off, in a second."""
        assert self.one.call("compliant", SetBool.Request(data=True)).success
        places = {self.memory.servo(name): MOTORS[name].servo(0.0) for name in MOTORS}
        for part in np.linspace(0.02, 1.0, 50):
            for servo, zero in places.items():
                servo.moved += part * (servo.kind.position(zero) - servo.moved)
            self.tick(commands=False)

    def sequence(self) -> None:
        """Let things happen, end the states or the commands, and prepare for the next sequence."""
        self.sequences += 1
        for _ in range(self.rng.randrange(8, 24)):
            if self.rng.random() < 0.15:
                self.happen()
            self.tick()
        moving, self.stamps = self.moving, "state"
        self.tick()
        self.stopped += self.moving > moving
        self.end(states=self.rng.random() < 0.5)
        for _ in range(300):
            if self.plant.ready and not self.plant.watch.faults:
                return
            if not self.plant.active or self.plant.watch.lasting:
                found = self.one.call("activate", Trigger.Request())
                if "no way to the first pose" in found.message:  # random motions have entangled the limbs
                    self.move_by_hand()
                    continue
            self.tick(commands=False)
        raise AssertionError(f"the robot does not move again: {self.plant.watch.faults}")


def run(make: Any, monkeypatch: pytest.MonkeyPatch, seed: int, count: int) -> None:
    battery = Battery(make, monkeypatch, seed)
    while battery.sequences < count:
        battery.sequence()
    print(
        f"seed {seed}: {battery.sequences} sequences of {battery.periods} periods, goals move in {battery.moving}, by "
        f"{100.0 * battery.largest:.1f} % of what is allowed at most; {battery.stopped} motions are stopped, within "
        f"{battery.latest:.2f} s"
    )
    assert battery.moving > 5 * count
    assert battery.stopped > count // 5


def test_a_sample_of_the_battery(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    run(make, monkeypatch, 0, 5)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(1, 21))
def test_10_000_sequences(make: Any, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    run(make, monkeypatch, seed, 500)
