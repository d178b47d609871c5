"""Whether the plant of a walk executes its commands, and whether it asks for the end of the walk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from std_msgs.msg import Bool, String

from dqwalk_ros.nodes import messages as ros
from dqwalk_ros.nodes.base import WalkNode
from dqwalk_ros.paper.state import State
from dqwalk_ros.support.wording import one_line

_MOVED = 0.1
"""Largest motion of a joint while the plant is not ready after which an interrupted walk continues [rad]."""
_LEFT_ALONE = 1.0
"""Longest time for which the plant may be not ready whatever the joints do: they come to rest where they hold [s]."""


class PlantReadiness:
    """Input of plant_ready, of the liveliness of its publisher, and of plant_warning.

    Parameters
    ----------
    warned : callable
        Called with a warning when there was none.

    Attributes
    ----------
    ready : bool
        Whether the plant executes commands; true until it says otherwise.
    why : str
        Why it does not, as it reports on /diagnostics; empty if it does, or has not reported it yet.
    warning : str
        Why the walk should end; empty without a warning.
    """

    def __init__(self, node: WalkNode, warned: Callable[[str], None]) -> None:
        self._node, self._logger, self._warned = node, node.get_logger(), warned
        self.ready = self._says_ready = True  # now, and by its last message
        self.warning = self.why = ""
        self._left_at: State | None = None  # at which the plant has interrupted the walk
        ros.hear(node, Bool, "plant_ready", self._on_ready)
        ros.hear(node, String, "plant_warning", self._on_warning)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        alive = SubscriptionEventCallbacks(liveliness=self._on_liveliness, use_default_callbacks=False)
        node.create_subscription(Bool, "plant_ready", lambda _: None, ros.watched(), event_callbacks=alive)

    def _on_ready(self, msg: Bool) -> None:
        """Stand still while the plant cannot execute commands, such as a robot whose torque is off."""
        self._says_ready = msg.data
        self._wait(msg.data, "")

    def _on_liveliness(self, event: Any) -> None:
        """Stand still while no plant lives: one that was killed or stopped cannot say that it is not ready."""
        if event.not_alive_count and not event.alive_count:
            self._wait(False, "the plant's process was killed or stopped: ")
        elif event.alive_count and event.not_alive_count_change < 0:  # the same one lives again
            self._wait(self._says_ready, "")

    def _wait(self, ready: bool, why: str) -> None:
        if ready != self.ready:
            self.ready = ready
            self._logger.info("the plant is ready" if ready else f"{why}standing still until the plant is ready")

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        """Note why a plant that is not ready is not."""
        for status in msg.status:
            name, _, what = status.name.partition(": ")
            if what == "plant" and f"/{name}" in ros.publishers_of(self._node, "plant_ready"):
                self.why = "" if status.level == DiagnosticStatus.OK else one_line(status.message)

    @property
    def waits(self) -> str:
        """What the walk waits for, and why."""
        return f"the plant is ready{self.why and f': {self.why}'}"

    def _on_warning(self, msg: String) -> None:
        before, self.warning = self.warning, one_line(msg.data)
        if before and not self.warning:
            self._logger.info("the plant has withdrawn its warning: a walk may begin")
        if not before and self.warning:
            self._logger.warning(f"the plant warns: {self.warning}")
            self._warned(self.warning)

    def condition(self, *, walking: bool) -> str:
        """Return that a walk waits for its plant, and for which one if several say so, or that it warns; or ""."""
        if self.ready or not walking:
            return f"the plant warns: {self.warning}" if self.warning else ""
        several = ros.publishers_of(self._node, "plant_ready")
        said = f", which {' and '.join(several)} say" if len(several) > 1 else ""
        return f"standing still until {self.waits}{said}"

    def moved(self, state: State, *, begun: bool) -> tuple[int, float] | None:
        """Return the joint that was moved too far while the plant interrupted a walk, and by how much [rad], or None.

        As by hand with the torque off, and then to its first pose: nobody expects that the walk continues in mid-step.
        It is asked for at every state; `begun` is whether a walk is under way.
        """
        if not begun:
            self._left_at = None
        elif not self.ready:
            self._left_at = state if self._left_at is None else self._left_at
        elif self._left_at is not None:
            left, self._left_at = self._left_at, None
            moved = np.abs(state.q - left.q)
            if moved[k := int(moved.argmax())] > _MOVED and state.time - left.time > _LEFT_ALONE:
                return k, float(moved[k])
        return None
