"""A Poppy plant with emulated servos in memory and a test clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from dynamixel_bus import Memory

from dqwalk_ros.config import Config, load, overlaid
from dqwalk_ros.paper.state import Command
from dqwalk_ros.plants.poppy import plant
from dqwalk_ros.plants.poppy.dynamixel import DynamixelBus
from dqwalk_ros.plants.poppy.plant import PoppyPlant
from dqwalk_ros.robot.model import load_model

DT = 0.02
WALK = {
    "gait.step_length": 0.02,
    "task.eta": 1.0,
    "dsp.stall_rate": 3e-3,
    "dsp.eta_ground": 25.0,
    "ssp.threshold": 0.02,
}
CONFIG = overlaid(load("paper"), "poppy").updated(WALK)
MAX_AGE = CONFIG.plant.command_timeout
MODEL = load_model(CONFIG.robot)


class Rig:
    """A plant, its servos and its clock.

    Parameters
    ----------
    sync_read : bool
    angles : dict of str to float
        Initial angles of joints [deg].
    settings : dict
        Changes of the configuration.
    """

    def __init__(
        self,
        *,
        sync_read: bool = True,
        angles: dict[str, float] | None = None,
        settings: dict[str, object] | None = None,
    ) -> None:
        self.config = CONFIG.updated(settings or {})
        self.model = load_model(self.config.robot)
        self.memory = Memory(sync_read=sync_read, **(angles or {}))
        self.plant = self.opened()

    def opened(self) -> PoppyPlant:
        memory, posture = self.memory, np.zeros(self.model.n)
        own = {"buses": memory.buses, "clock": memory.clock, "each": map}
        return PoppyPlant(self.config, self.model, posture, **own)

    def tick(self, u: float = 0.0, effort: float | None = None) -> float:
        """Execute one period; return the time that the plant took [s]."""
        n, began = self.model.n, self.memory.clock.now
        torque = None if effort is None else np.full(n, effort)
        self.plant.step(Command(0.0, np.full(n, u), torque), DT)
        took = self.memory.clock.now - began
        self.memory.clock.now = max(self.memory.clock.now, began + DT)
        return took

    def run(self, seconds: float, u: float = 0.0) -> None:
        end = self.memory.clock.now + seconds
        while self.memory.clock.now < end:
            self.tick(u)

    def until(self, condition: Callable[[], object], seconds: float) -> float:
        """Execute periods until a condition holds; return the time it took [s]."""
        began = self.memory.clock.now
        while not condition():
            assert self.memory.clock.now - began < seconds, self.plant.watch.faults
            self.tick()
        return self.memory.clock.now - began

    def settle(self) -> None:
        self.plant.activate()
        self.until(lambda: self.plant.ready, 30.0)

    @property
    def faults(self) -> str:
        return "; ".join(self.plant.watch.faults.values())


def driver_node(
    make: Any,
    monkeypatch: pytest.MonkeyPatch,
    config: Config | str,
    memory: Memory | None = None,
    ros: tuple[str, ...] = (),
) -> tuple[Any, Memory]:
    """Return the driver as a node in the process of the test, and its servos, new ones or those of `memory`.

    Both have the clock of the test.
    """
    made: list[Memory] = []

    def open_buses(motors: object, types: object, own: object, clock: Any) -> Mapping[str, DynamixelBus]:
        made.append(memory or Memory(timed=False, clock=clock))
        return made[-1].buses

    monkeypatch.setattr(plant, "open_buses", open_buses)
    one = make("poppy_driver", config, ros=ros)
    one.node._plant._buses.each = map
    return one, made[-1]
