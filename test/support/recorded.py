"""Walks for tests: one short but complete walk, computed once per process, and functions that modify bags."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from dqwalk_ros import load, load_model, make_controller, simulate
from dqwalk_ros.config import Config
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report.bag.storage import typestore
from dqwalk_ros.trace import PhaseRecord, Trace

SHORT = {"dt": 0.04, "task.eta": 0.4, "dsp.eta_ground": 20.0, "ssp.threshold": 4e-3, "dsp.stall_rate": 1e-3}
"""Eight times as fast as the paper; Euler integration at this speed needs the higher `dsp.eta_ground`."""


def short_config(**changes: Any) -> Config:
    return load("paper").updated({**SHORT, **changes})


@cache
def short_walk() -> Trace:
    """One cycle, four phases, 581 ticks."""
    config = short_config()
    model = load_model(config.robot)
    return simulate(make_controller(config, model), KinematicPlant(model))


def part(trace: Trace, ticks: slice, phases: Sequence[PhaseRecord]) -> Trace:
    """Return some states of a walk and the given phases; it is not finished."""
    series = {name: getattr(trace, name)[ticks] for name in ("time", "q", "u", "solve_time")}
    return replace(trace, phases=tuple(phases), finished=False, **series)


def repeated(trace: Trace, times: int) -> Trace:
    """Return the walk, which begins at zero, several times in succession, for figures and times only."""
    n, dt = len(trace), trace.config.dt
    series = {name: np.concatenate([getattr(trace, name)] * times) for name in ("q", "u", "solve_time")}
    phases = [replace(r, start=r.start + k * n, time=r.time + k * n * dt) for k in range(times) for r in trace.phases]
    return replace(trace, time=dt * np.arange(times * n), phases=tuple(phases), **series)


Edit = Callable[[str, int, Any], tuple[int, Any] | None]


def rewrite(
    source: Path,
    target: Path,
    *,
    rename: Callable[[str], str | None] = lambda topic: topic,
    edit: Edit | None = None,
    edits: str = "",
    storage: StoragePlugin = StoragePlugin.MCAP,
    prepare: Callable[[Writer], None] = lambda writer: None,
) -> Path:
    """Copy a bag without its QoS; `rename` may drop a topic (None), `edit` change or drop messages, of `edits` only."""
    store = typestore()
    writer = Writer(target, version=9, storage_plugin=storage)
    prepare(writer)
    with Reader(source) as reader, writer:
        out = {}
        for connection in reader.connections:
            if (name := rename(connection.topic)) is not None:
                out[connection.topic] = writer.add_connection(name, connection.msgtype, typestore=store)
        for connection, time, raw in reader.messages():
            if connection.topic not in out:
                continue
            if edit is None or (edits and connection.topic != edits):
                writer.write(out[connection.topic], time, raw)
                continue
            message = store.deserialize_cdr(raw, connection.msgtype)
            if (edited := edit(connection.topic, time, message)) is not None:
                writer.write(out[connection.topic], edited[0], store.serialize_cdr(edited[1], connection.msgtype))
    return target
