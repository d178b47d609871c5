"""The walks, one for each ``gait.style`` and a user's own by MODULE:CLASS, and the controller that executes one."""

from __future__ import annotations

from collections.abc import Mapping

from dqwalk_ros.config import Config, is_whole_body
from dqwalk_ros.controller import VelocityController
from dqwalk_ros.paper.walk import PaperWalk, Walk
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.own_class import own_class
from dqwalk_ros.walks.dynamic.recovery import RecoveringWalk
from dqwalk_ros.walks.dynamic.walk import DynamicWalk
from dqwalk_ros.walks.standing.walk import StandingWalk

WALKS: Mapping[str, type[Walk]] = {"paper": PaperWalk, "standing": StandingWalk, "dynamic": DynamicWalk}
"""Class of the walk of each ``gait.style``."""


def walk_type(config: Config) -> type[Walk]:
    """Return the class of the walk that `config` describes: that of ``gait.walk`` if given, else of ``gait.style``.

    Raises
    ------
    ConfigError
        If ``gait.walk`` is not MODULE:CLASS, the class cannot be imported, or it is not a subclass of `Walk` that
        defines all its members; if the configuration is of the whole-body controller, which has no such walk.
    """
    if is_whole_body(config):
        raise ConfigError("this is a configuration of the whole-body controller: dqwalk reach --config CONFIG")
    own = config.gait.walk
    if not own:
        recovers = config.gait.style == "standing" and config.gait.recover
        return RecoveringWalk if recovers else WALKS[config.gait.style]
    try:
        return own_class(own, Walk)  # type: ignore[type-abstract]
    except ImportError as error:
        raise ConfigError(f"gait.walk is '{own}'; {error}") from error


def style_of(config: Config) -> str:
    """Return the ``gait.style`` of the walk that `config` describes: of an own one that of the class it extends, or "".

    Raises
    ------
    ConfigError
        As `walk_type`.
    """
    kind = walk_type(config)
    return next((style for style, walk in WALKS.items() if issubclass(kind, walk)), "")


def refuse_endless(config: Config) -> None:
    """Check a walk that is simulated until its end.

    Raises
    ------
    ConfigError
        If it has none.
    """
    if not walk_type(config).phases(config):
        raise ConfigError("the walk has no end, because it is steered: set gait.steps to a number of steps")


def refuse_foreign_code(config: Config, trusted: str = "") -> None:
    """Check a configuration that the user has not chosen, such as that of a recording or of a topic.

    A class is imported from a module, which executes it, so data may name no class but those of this package.

    Parameters
    ----------
    trusted : str
        The value of ``gait.walk`` that the user has given.

    Raises
    ------
    ConfigError
        If ``gait.walk`` names another class.
    """
    own = config.gait.walk
    if own not in ("", trusted) and own.partition(":")[0].partition(".")[0] != "dqwalk_ros":
        raise ConfigError(
            f"the walk is of the class {own!r:.100}, which is not imported because data name it; if you trust it, name "
            f"it yourself: --walk {own[:100]} (a node: -p gait.walk:={own[:100]})"
        )


def make_walk(config: Config, model: RobotModel) -> Walk:
    """Return a new walk as `config` describes it.

    Raises
    ------
    ConfigError
        As `walk_type`, and if the walk refuses its parameters or the robot.
    """
    return walk_type(config)(config, model)


def make_controller(config: Config, model: RobotModel) -> VelocityController:
    """Return a new controller as `config` describes it.

    Raises
    ------
    ConfigError
        As `walk_type`, and if ``robot.pelvis`` is a link of a leg, or ``gait.recover`` is not the configuration of a
        dynamic walk.
    """
    left, right = model.joints_to_soles(model.pelvis)
    if abs(left - right) > 1:  # one, where a leg has a joint more than the other
        raise ConfigError(
            f"robot.pelvis is '{model.pelvis}', which is part of a leg: {left} joints move it against the left sole, "
            f"{right} against the right one; name the link that carries both legs, and a sole at the end of each"
        )
    return VelocityController(config, model, walk_type(config))
