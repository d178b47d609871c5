"""The node drive on a test clock, and the robot that it drives."""

from __future__ import annotations

from typing import Any

import numpy as np
from inside import state
from ros2_control import EXTRA, Known

from dqwalk_ros.config import load, overlaid
from dqwalk_ros.robot.model import load_model

POPPY = overlaid(load("poppy"), "ros2_control")
MODEL = load_model(POPPY.robot)
NAMES = MODEL.joint_names
POSTURE = MODEL.posture(POPPY.standing.posture)
DT = POPPY.dt
KNEE = NAMES.index("l_knee_y")
TOPIC = {kind: f"forward_{kind}_controller/commands" for kind in ("position", "velocity")}


def measured(q: Any, stamp: float = 1.0) -> Any:
    return state((*NAMES, *EXTRA), [*q, 0.3, 0.4], stamp)


def command(stamp: float = 1.0, speed: float = 0.0) -> Any:
    return state(NAMES, [], stamp, velocity=np.full(MODEL.n, speed))


class Driven:
    """The node on a test clock, whose robot does not move by itself.

    Attributes
    ----------
    q : ndarray, shape (n,)
        Measured angles [rad].
    """

    def __init__(
        self, make: Any, *, known: bool = True, asks: bool = False, ros: tuple[str, ...] = (), **settings: Any
    ) -> None:
        self.config = POPPY.updated({name.replace("__", "."): value for name, value in settings.items()})
        self.one = make("drive", self.config, ros=ros)
        self.node, self.log, self.q = self.one.node, self.one.log, POSTURE.copy()
        if not asks:
            self.node._controllers = Known()
        o = self.config.output
        self.topic = o.topic or TOPIC[o.interface]
        for _ in range(3 if known else 0):
            self.tick()

    def tick(self, speed: float | None = None, effort: Any = None, *, states: bool = True) -> None:
        """Let a period pass; the robot sends its state, and a controller commands velocities and torques."""
        self.one.clock.now += DT
        if states:
            self.one.send("joint_states", measured(self.q, 1.0 + self.now))
        if speed is not None:
            self.command(speed, effort)
        self.node._check()

    def command(self, speed: float, effort: Any = None, *, stamp: float | None = None) -> None:
        msg = command(1.0 + self.now if stamp is None else stamp, speed)
        if effort is not None:
            msg.effort = [float(x) for x in np.broadcast_to(effort, MODEL.n)]
        self.one.send("joint_velocity_commands", msg)

    @property
    def now(self) -> float:
        """Time of the node's clock, and of the stamps minus 1 s [s]."""
        return float(self.one.clock.now)

    @property
    def sent(self) -> list[Any]:
        """Messages sent to the robot."""
        return self.one.got[self.topic]

    @property
    def out(self) -> np.ndarray:
        """Values (n,) sent last, of the joints of the walk."""
        return np.array(self.sent[-1].data)[: MODEL.n]
