"""Many whole-body walks at a time, in processes of their own."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from dqwalk_ros.config import Config
from dqwalk_ros.errors import ConfigError
from dqwalk_ros.robot import RobotModel, load_model
from dqwalk_ros.whole_body.controller import WholeBodyController
from dqwalk_ros.whole_body.exactness import Answers
from dqwalk_ros.whole_body.loop import BodyPlant, follow
from dqwalk_ros.whole_body.records import BodyState
from dqwalk_ros.whole_body.rigid_plant import RigidPlant
from dqwalk_ros.whole_body.scenario import Scenario
from dqwalk_ros.whole_body.trace import Reaching

__all__ = ["PLANTS", "Walk", "each", "make_body_plant", "walk"]

PLANTS = ("rigid", "physics")
"""What the controller is closed with: rigid bodies on rigid ground, or MuJoCo."""
_Key = TypeVar("_Key")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class Walk:
    """A walk to be made.

    Attributes
    ----------
    scenario : Scenario
    changes : mapping of str to value
        Of the configuration, such as ``{"whole_body.friction": 0.4}``.
    plant : str
    exact : bool
        Check every answer on the way.
    """

    scenario: Scenario
    changes: Mapping[str, Any] = field(default_factory=dict)
    plant: str = "rigid"
    exact: bool = False


def make_body_plant(name: str, config: Config, model: RobotModel, state: BodyState) -> BodyPlant:
    """Return a plant of `PLANTS` in a state.

    Raises
    ------
    ConfigError
        If there is no such plant.
    """
    torso = config.whole_body.torso
    if name == "physics":
        from dqwalk_ros.whole_body.torque_plant import TorquePlant

        return TorquePlant(model, state, pushed=torso)
    if name == "rigid":
        return RigidPlant(model, state, pushed=torso, damping=config.whole_body.contact_damping)
    raise ConfigError(f"there is no plant '{name}': {', '.join(PLANTS)}")


def walk(
    config: Config, wanted: Walk, progress: Callable[[float, str], None] | None = None
) -> tuple[Reaching, Answers]:
    """Make a walk; its times are CPU time of this process."""
    config = config.updated(dict(wanted.changes))
    model = load_model(config.robot)
    controller = WholeBodyController(config, model, clock=time.process_time)
    plant, answers = make_body_plant(wanted.plant, config, model, controller.start), Answers()
    walked = follow(
        controller,
        plant,
        wanted.scenario,
        clock=time.process_time,
        progress=progress,
        watch=answers if wanted.exact else None,
    )
    return walked, answers


def each(
    task: Callable[..., _Result], asked: Mapping[_Key, tuple[Any, ...]], jobs: int
) -> Iterator[tuple[_Key, _Result]]:
    """Yield what `task` returns for each of the named arguments, as it comes, `jobs` processes at a time."""
    with (
        _one_thread_each(),
        ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        futures = {pool.submit(task, *arguments): key for key, arguments in asked.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            _cancel(futures)


def _cancel(futures: Iterable[Any]) -> None:
    for future in futures:
        future.cancel()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that start meanwhile compute with one thread, unless somebody has said otherwise."""
    names = [name for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if name not in os.environ]
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]
