"""A whole walk through ROS 2: start the nodes as processes, watch them, end them, say how it went.

Where ROS was installed from wheels there is no `ros2 launch`; this does its work, and returns an exit code that means
something. It needs no ROS itself: the controller reports its progress as lines of JSON on its standard output.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dqwalk_ros.config import Config, to_yaml
from dqwalk_ros.runner.processes import Processes, environment, private_domain
from dqwalk_ros.runner.watch import Progress, Watch
from dqwalk_ros.standing.course import Course

__all__ = ["PLANTS", "Outcome", "Processes", "environment", "private_domain", "run_walk"]

PLANTS = {"integrator": "integrator", "physics": "physics", "poppy": "poppy_driver"}
"""The node that is each plant."""


@dataclass(frozen=True)
class Outcome:
    """How a walk went.

    Attributes
    ----------
    finished : bool
        Every phase ended by its rule, and everything was recorded.
    reason : str
        Why not, where it did not.
    ticks : int
    walked : float
        Time of the walk [s].
    took : float
        Time of the clock, from the first tick to the last [s].
    bag, logs : Path
    pace : str
        In real time, what the plant said of its own.
    """

    finished: bool
    reason: str
    ticks: int
    walked: float
    took: float
    bag: Path
    logs: Path
    pace: str = ""

    def __str__(self) -> str:
        pace = f"{self.ticks} ticks, {self.walked:.1f} s of walking in {self.took:.1f} s"
        if self.took > 0.0:
            pace += f" ({self.ticks / self.took:.0f} ticks/s)"
        if self.pace:
            pace += f"; plant: {self.pace}"
        return f"finished: {pace}" if self.finished else f"{self.reason} (after {pace}; logs in {self.logs})"


def run_walk(
    config: Config,
    bag: str | os.PathLike[str],
    *,
    plant: str = "integrator",
    course: Sequence[str] = (),
    lockstep: bool = True,
    progress: Progress | None = None,
    logs: str | os.PathLike[str] | None = None,
    domain: int | None = None,
) -> Outcome:
    """Walk with controller, plant, phase_monitor and recorder as processes of their own.

    Parameters
    ----------
    config : Config
    bag : path-like
        The folder that the recorder makes; it must not be there yet.
    plant : {"integrator", "physics", "poppy"}
        Other side of the command; what ``config/plants/NAME.yaml`` asks for is in `config` already.
    course : sequence of str
        Legs for the node pilot, as `gait.course.Course.parse` reads them; `config` has ``gait.steps: 0`` then.
    lockstep : bool
        Each state waits for its command; otherwise the walk goes by the clock.
    progress : callable, optional
        Called with the fraction done and some text, several times a second.
    logs : path-like, optional
        Where parameters and logs of the nodes go; `log` beside the bag by default.
    domain : int, optional
        ROS domain; by default ``ROS_DOMAIN_ID`` where it is set, else one that nobody else on this machine uses.

    Returns
    -------
    Outcome
    """
    bag = Path(bag)
    folder = Path(logs) if logs is not None else bag.parent / "log"
    folder.mkdir(parents=True, exist_ok=True)
    config = config.updated(
        {
            "plant.lockstep": lockstep,
            "node.autostart": True,
            "node.exit_when_done": True,
            "node.wait_for_recorder": True,
            "node.wait_for_monitor": True,
        }
    )
    params = folder / "params.yaml"
    params.write_text(to_yaml(config), encoding="utf-8")
    ros = ["--ros-args", "--params-file", str(params)]
    with contextlib.ExitStack() as stack:
        if domain is None and "ROS_DOMAIN_ID" not in os.environ:
            domain = stack.enter_context(private_domain())
        processes = stack.enter_context(Processes(folder, domain))
        processes.start("recorder", ["--bag", str(bag), *ros])
        processes.start("phase_monitor", ros)
        node = PLANTS[plant]
        processes.start(node, ros)
        processes.start("controller", ros)
        if course:
            processes.start("pilot", [*(f"--cmd-vel={leg}" for leg in course), *ros])
        duration = Course.parse(course).duration
        watch = Watch(config, progress, plant=node, duration=duration)
        reason = watch.until_the_end(processes)
        processes.stop()
        reason = reason or _incomplete(processes, lockstep)
        paces = [line["text"] for line in processes.said(node) if line.get("event") == "pace"]
    last = watch.last
    return Outcome(
        finished=not reason,
        reason=reason,
        ticks=int(last.get("ticks", 0)),
        walked=float(last.get("time", 0.0)),
        took=watch.took,
        bag=bag,
        logs=folder,
        pace=paces[-1] if paces else "",
    )


def _incomplete(processes: Processes, lockstep: bool) -> str:
    """Return what is wrong with a recording that has ended; gaps are the clock's in real time, a loss in lockstep."""
    recorded = [line for line in processes.said("recorder") if line.get("event") == "recorded"]
    if not recorded:
        return f"the recorder did not finish the bag: {processes.last_words('recorder')}"
    missing = recorded[-1]["missing"]
    if lockstep and missing:
        return "the bag is incomplete: " + ", ".join(
            f"{count} of {name} are missing" for name, count in missing.items()
        )
    return ""
