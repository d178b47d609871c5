"""Walks for tests: one short but complete walk, computed once per process, and functions that modify bags."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from dqwalk_ros import load, load_model, make_controller, simulate
from dqwalk_ros.config import Config
from dqwalk_ros.plants.kinematic import KinematicPlant
from dqwalk_ros.report.bag.storage import typestore
from dqwalk_ros.simulation import Trace

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


Edit = Callable[[str, int, Any], tuple[int, Any] | None]


def rewrite(
    source: Path,
    target: Path,
    *,
    rename: Callable[[str], str | None] = lambda topic: topic,
    edit: Edit = lambda topic, time, message: (time, message),
    storage: StoragePlugin = StoragePlugin.MCAP,
    prepare: Callable[[Writer], None] = lambda writer: None,
) -> Path:
    """Copy a bag; `rename` may drop a topic (None), `edit` change or drop messages."""
    store = typestore()
    writer = Writer(target, version=9, storage_plugin=storage)
    prepare(writer)
    with Reader(source) as reader, writer:
        out = {}
        for connection in reader.connections:
            if (name := rename(connection.topic)) is not None:
                out[connection.topic] = writer.add_connection(
                    name,
                    connection.msgtype,
                    typestore=store,
                    offered_qos_profiles=connection.ext.offered_qos_profiles,
                )
        for connection, time, raw in reader.messages():
            if connection.topic not in out:
                continue
            message = store.deserialize_cdr(raw, connection.msgtype)
            if (edited := edit(connection.topic, time, message)) is not None:
                writer.write(out[connection.topic], edited[0], store.serialize_cdr(edited[1], connection.msgtype))
    return target
