"""A configuration: all sections, with values that are replaced by their dotted names."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dqwalk_ros.config.schema import Spec, Value, checked, parameter, specs_of
from dqwalk_ros.config.sections import (
    ArmsConfig,
    CollisionConfig,
    DspConfig,
    DynamicConfig,
    EstimationConfig,
    GaitConfig,
    JointsConfig,
    MonitorConfig,
    NodeConfig,
    OdometryConfig,
    OutputConfig,
    PelvisConfig,
    PhysicsConfig,
    PlantConfig,
    PoppyConfig,
    QpConfig,
    RobotConfig,
    SafetyConfig,
    SensorsConfig,
    ServoConfig,
    SspConfig,
    StandingConfig,
    TaskConfig,
    WholeBodyConfig,
)
from dqwalk_ros.support.errors import ConfigError


@dataclass(frozen=True)
class Config:
    """All parameters of a walk."""

    dt: float = parameter(
        0.005, "control period, and step of the Euler integration; smaller: more accurate", "s", 1e-4, 0.1
    )
    robot: RobotConfig = field(default_factory=RobotConfig)
    gait: GaitConfig = field(default_factory=GaitConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    dsp: DspConfig = field(default_factory=DspConfig)
    ssp: SspConfig = field(default_factory=SspConfig)
    standing: StandingConfig = field(default_factory=StandingConfig)
    dynamic: DynamicConfig = field(default_factory=DynamicConfig)
    pelvis: PelvisConfig = field(default_factory=PelvisConfig)
    joints: JointsConfig = field(default_factory=JointsConfig)
    arms: ArmsConfig = field(default_factory=ArmsConfig)
    collision: CollisionConfig = field(default_factory=CollisionConfig)
    qp: QpConfig = field(default_factory=QpConfig)
    servo: ServoConfig = field(default_factory=ServoConfig)
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)
    plant: PlantConfig = field(default_factory=PlantConfig)
    output: OutputConfig = field(default_factory=OutputConfig)
    estimation: EstimationConfig = field(default_factory=EstimationConfig)
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    poppy: PoppyConfig = field(default_factory=PoppyConfig)
    node: NodeConfig = field(default_factory=NodeConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    whole_body: WholeBodyConfig = field(default_factory=WholeBodyConfig)

    @classmethod
    def specs(cls) -> tuple[Spec, ...]:
        """Return every parameter, in the order of the schema."""
        return tuple(_specs().values())

    def flat(self) -> dict[str, Value]:
        """Return ``{dotted name: value}``."""
        names = _specs()
        return dict(zip(names, operator.attrgetter(*names)(self), strict=True))

    def updated(self, values: Mapping[str, Any], *, source: str = "") -> Config:
        """Return a copy with the values of ``{dotted name: value}`` replaced.

        Raises
        ------
        ConfigError
            For an unknown name, a wrong type or a value out of bounds.
        """
        try:
            values = {name: checked(_specs(), name, value) for name, value in values.items()}
        except ConfigError as error:
            raise ConfigError(f"{source}: {error}" if source else str(error)) from error
        tree: dict[str, dict[str, Value]] = {}
        for name, value in values.items():
            section, _, key = name.rpartition(".")
            tree.setdefault(section, {})[key] = value
        top: dict[str, Any] = dict(tree.pop("", {}))
        for section, entries in tree.items():
            top[section] = dataclasses.replace(getattr(self, section), **entries)
        return dataclasses.replace(self, **top)


_specs = functools.partial(specs_of, Config)
