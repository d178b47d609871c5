"""The table of a Poppy's motors: which servo moves a joint, and at which angle of it the joint is at zero."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Annotated

import msgspec

from dqwalk_ros.config import Config, find_file
from dqwalk_ros.plants.base import require_real_time
from dqwalk_ros.robot.model import RobotModel
from dqwalk_ros.robot.servos import ServoType, load_types
from dqwalk_ros.support import strict_yaml
from dqwalk_ros.support.entries import numbers
from dqwalk_ros.support.errors import ConfigError

_Degrees = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]


class Motor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One servo."""

    name: str
    """Name of its joint."""
    id: Annotated[int, msgspec.Meta(ge=0, le=252)]
    """Id on the bus."""
    type: str
    """Type in the table of servo types, such as ``MX-28``."""
    bus: str
    """Name of the bus."""
    direct: bool
    """Whether positive angles of the servo are positive angles of the joint."""
    offset: _Degrees
    """Offset of the joint angle, see `user` [deg]."""
    raw: tuple[_Degrees, _Degrees]
    """Lower and upper limit of the servo angle [deg]."""

    def user(self, raw: float) -> float:
        """Return the joint angle for a servo angle [deg]."""
        return (raw if self.direct else -raw) - self.offset

    def servo(self, user: float) -> float:
        """Return the servo angle for a joint angle [deg]."""
        return user + self.offset if self.direct else -(user + self.offset)

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the joint [deg], lower first."""
        a, b = self.user(self.raw[0]), self.user(self.raw[1])
        return min(a, b), max(a, b)


def load_motors(source: str, types: Mapping[str, ServoType]) -> dict[str, Motor]:
    """Read a table of motors from a path, or from the file of this name in config/motors/.

    Parameters
    ----------
    types : mapping of str to ServoType
        The known types, see `load_types`.

    Returns
    -------
    dict of str to Motor
        By the name of the joint.

    Raises
    ------
    ConfigError
        If the file is missing or not a valid table; the message names the motor.
    """
    path = find_file("table of motors", source, "config/motors", ("poppy",))
    text = strict_yaml.read_text(path)
    tree = strict_yaml.read(text, source=str(path))
    table = tree.get("motors") if isinstance(tree, dict) else None
    if not isinstance(table, dict) or not table:
        raise ConfigError(f"{path}: expected 'motors: {{JOINT: {{id, type, bus, direct, offset, raw}}}}'")
    out: dict[str, Motor] = {}
    for name, entry in table.items():
        try:
            if not isinstance(entry, dict):
                raise ValueError("expected {id, type, bus, direct, offset, raw}")
            motor = msgspec.convert(dict(name=str(name), **entry), Motor)
            if motor.type not in (known := [name for name, kind in types.items() if kind.positions]):
                raise ValueError(f"the type must be one of {', '.join(known)}")
            if not motor.raw[0] < motor.raw[1]:
                raise ValueError("raw must be [lower, upper]")
            if motor.id in (other.id for other in out.values()):
                raise ValueError(f"another motor has the id {motor.id}")
        except (TypeError, ValueError) as error:
            line = strict_yaml.line_of(text, ("motors", str(name)))
            raise ConfigError(f"{path}, line {line}: motor '{name}': {error}") from error
        out[motor.name] = motor
    return out


def typed(config: Config, motors: Iterable[Motor]) -> Config:
    """Return the configuration with the types of motors as ``servo.types``, unless it has types already."""
    types = tuple(f"{motor.name}={motor.type}" for motor in motors)
    return config if config.servo.types else config.updated({"servo.types": types})


def calibration(entries: tuple[str, ...], motors: Mapping[str, Motor]) -> dict[str, float]:
    """Return the zero offsets of joints [deg] from texts such as ``l_hip_y=-3``.

    Raises
    ------
    ConfigError
        If a text is something else, or names no motor.
    """
    out = dict[str, float]()
    for name, degrees in numbers(entries, "poppy.calibration", "JOINT=DEGREES, such as l_hip_y=-3"):
        if name not in motors:
            raise ConfigError(f"poppy.calibration: no motor moves '{name}'; the joints are {', '.join(motors)}")
        if abs(degrees) > 45.0:
            raise ConfigError(f"poppy.calibration: {name} is off by {degrees:g} degrees, 45 at most")
        if name in out:
            raise ConfigError(f"poppy.calibration: {name} is given twice")
        out[name] = degrees
    return out


def motors_of(config: Config, model: RobotModel) -> tuple[dict[str, Motor], dict[str, float]]:
    """Return the motors of a robot by their joints, and the zero offsets of joints [deg].

    Raises
    ------
    ConfigError
        As `load_motors` and `calibration`, and if a joint of the model has no motor.
    """
    motors = load_motors(config.poppy.motors, load_types(config.servo.table))
    if missing := [name for name in model.joint_names if name not in motors]:
        raise ConfigError(f"the motors '{config.poppy.motors}' lack {', '.join(missing)} of {model.name}")
    return motors, calibration(config.poppy.calibration, motors)


def require_bus(config: Config) -> None:
    """Check that the motor buses can do what the walk requires.

    Raises
    ------
    ConfigError
        In lockstep, if dt is shorter than the period of the buses, or if both have the same port.
    """
    require_real_time(config)
    own, period = config.poppy, 1.0 / config.poppy.rate
    if config.dt < 0.99 * period:
        raise ConfigError(
            f"'dt' is {config.dt:g} s, but the motors answer every {period:g} s (poppy.rate): "
            f"set dt: {period:g}, as config/plants/poppy.yaml does"
        )
    ports = own.lower_port, own.upper_port
    if not own.dummy and "auto" not in ports and os.path.realpath(ports[0]) == os.path.realpath(ports[1]):
        raise ConfigError(f"poppy.lower_port and poppy.upper_port are the same port, {ports[0]}")


def require_usable(config: Config, model: RobotModel) -> None:
    """Check that the driver accepts a configuration, as `require_bus` and `motors_of` do."""
    require_bus(config)
    motors_of(config, model)
