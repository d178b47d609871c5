"""The phases of the walk as data.

A phase says what is wanted (tasks), what is held (equalities), what is kept (inequalities) and where the feet are
meant to go; `assemble` turns it into the quadratic program (6) at one configuration. The world of a phase is the
sole of its base foot. Each style of walking has a module that builds its phases.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqwalk_ros.config import Config
from dqwalk_ros.model import Foot, RobotModel
from dqwalk_ros.phases import paper
from dqwalk_ros.phases.phase import Phase, PhaseKind, assemble, com_target
from dqwalk_ros.standing import phases as standing

__all__ = ["Phase", "PhaseKind", "assemble", "com_target", "make_phase"]


def make_phase(
    config: Config,
    model: RobotModel,
    kind: PhaseKind,
    support: Foot,
    q_start: ArrayLike,
    swing_target: ArrayLike | None = None,
) -> Phase:
    """Return the phase that begins at `q_start`; the same arguments give the same phase.

    Parameters
    ----------
    config : Config
    model : RobotModel
    kind : PhaseKind
    support : Foot
    q_start : array_like, shape (n,)
        [rad]
    swing_target : array_like, shape (8,)
        For single support.

    Raises
    ------
    ValueError
        If a single support comes without its target.
    """
    q = np.array(q_start, dtype=np.float64)
    style = standing if config.gait.style == "standing" else paper
    phase: Phase
    if kind is PhaseKind.STANCE:
        phase = standing.stance(config, model, support, q)
    elif kind is PhaseKind.DOUBLE_SUPPORT:
        phase = style.double_support(config, model, support, q)
    elif swing_target is None:
        raise ValueError("a single support needs the target of its swing foot")
    else:
        phase = style.single_support(config, model, support, q, np.array(swing_target, dtype=np.float64))
    return phase
