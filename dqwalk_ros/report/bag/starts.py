"""Where the phases of a recorded walk began, and where in the world that was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dqwalk_ros.dual_quaternions import DQ
from dqwalk_ros.errors import BagError
from dqwalk_ros.kinematics import Kinematics
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import PhaseKind
from dqwalk_ros.report.bag import messages
from dqwalk_ros.report.bag.joints import unpack_joint_states
from dqwalk_ros.report.bag.storage import Column
from dqwalk_ros.trace import PhaseRecord

__all__ = ["Start", "first_base", "records", "starts", "texts"]

Array = NDArray[np.float64]
_SAME_POSE = 1e-9


def texts(column: Column) -> list[str]:
    """Return the texts of a column of std_msgs/String."""
    return [str(messages.unpack(raw, column.type).data) for raw in column.raws]


@dataclass(frozen=True)
class Start:
    """The start of a phase as recorded."""

    name: str
    stamp: int
    base: Foot
    q: Array
    swing_target: Array | None

    @property
    def kind(self) -> PhaseKind:
        """Double or single support."""
        return PhaseKind(self.name.partition("/")[0])

    @property
    def support(self) -> Foot:
        """The foot the name gives."""
        return Foot(self.name.partition("/")[2])


def starts(path: Path, model: RobotModel, columns: Mapping[str, Column]) -> list[Start]:
    """Return every phase in order, its name joined to its start by the time of recording."""
    column = columns["phase_start"]
    begun = unpack_joint_states(column.raws)
    names = [
        (time, text) for time, text in zip(columns["phase"].times, texts(columns["phase"]), strict=True) if "/" in text
    ]
    if not names or not column.raws:
        raise BagError(f"'{path}' holds no phase of a walk")
    frames = {model.soles[foot].frame: foot for foot in Foot}
    targets = _targets(columns.get("swing_target"))
    missing = [name for name in model.joint_names if name not in begun.names]
    if missing or not set(begun.frames) <= set(frames):
        raise BagError(
            f"'{path}' is of another robot: phase_start names {begun.frames[0]} and {', '.join(begun.names)}"
        )
    out: dict[int, Start] = {}
    for i, stamp in enumerate(begun.stamps.tolist()):
        base = frames[begun.frames[i]]
        out[stamp] = Start(
            # a name is said again after a pause, and says not which start it belongs to
            name=names[i][1] if len(names) == len(begun.stamps) else _name(base, stamp in targets),
            stamp=stamp,
            base=base,
            q=begun.position[i, begun.columns(model.joint_names)],
            swing_target=targets.get(stamp),
        )
    phases = [out[stamp] for stamp in sorted(out)]
    for phase in phases:
        expected = phase.support if phase.kind is PhaseKind.SINGLE_SUPPORT else phase.support.other
        if phase.base is not expected:
            raise BagError(f"'{path}': {phase.name} cannot stand on the {phase.base.value} foot")
        if phase.kind is PhaseKind.SINGLE_SUPPORT and phase.swing_target is None:
            raise BagError(f"'{path}': the swing target of {phase.name} at {phase.stamp / 1e9:.3f} s is missing")
    return phases


def _name(base: Foot, swings: bool) -> str:
    """Return the name of a phase by its base sole, and whether a swing target began with it."""
    kind = PhaseKind.SINGLE_SUPPORT if swings else PhaseKind.DOUBLE_SUPPORT
    return f"{kind.value}/{(base if swings else base.other).value}"


def _targets(column: Column | None) -> dict[int, Array]:
    if column is None:
        return {}
    found = [messages.unpack(raw, column.type) for raw in column.raws]
    return {m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec: messages.pose_of(m) for m in found}


def first_base(model: RobotModel, columns: Mapping[str, Column], start: Start) -> Array:
    """Return the pose of the first phase's base sole in odom: the origin, unless the recording began later."""
    one = DQ(1.0).vec8()
    column = columns.get("base_pose")
    if column is None:
        return one
    for raw in column.raws:
        message = messages.unpack(raw, column.type)
        if message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec == start.stamp:
            x = (
                DQ(messages.pose_of(message)) * DQ(Kinematics(model, start.q, start.base).pose(model.pelvis)).conj()
            ).vec8()
            return one if min(np.abs(x - one).max(), np.abs(x + one).max()) < _SAME_POSE else x
    return one


def records(
    model: RobotModel,
    phases: Sequence[Start],
    stamps: NDArray[np.int64],
    x_odom_base: Array,
    epoch: int,
    notes: list[str],
) -> tuple[PhaseRecord, ...]:
    """Return the records; odometry goes on where the base changes: x_odom_new = x_odom_old x_old_new(q_start).

    Their times count from `epoch` [ns].
    """
    out: list[PhaseRecord] = []
    for start in phases:
        if out and out[-1].base is not start.base:
            step = Kinematics(model, start.q, out[-1].base).pose(model.soles[start.base].frame)
            x_odom_base = (DQ(x_odom_base) * DQ(step)).vec8()
        tick, time = int(np.searchsorted(stamps, start.stamp)), (start.stamp - epoch) / 1e9
        if tick == len(stamps):
            notes.append(f"{start.name} began at {time:.3f} s, after the last state, and is left out")
            break
        if out and out[-1].start == tick:  # over before the recording began
            out.pop()
        if stamps[tick] != start.stamp:
            notes.append(f"the state at which {start.name} began, {time:.3f} s, is missing")
        out.append(
            PhaseRecord(
                name=start.name,
                kind=start.kind,
                support=start.support,
                base=start.base,
                start=tick,
                time=time,
                q_start=start.q,
                swing_target=start.swing_target,
                x_odom_base=x_odom_base,
            )
        )
    return tuple(out)
