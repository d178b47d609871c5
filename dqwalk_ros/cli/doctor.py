"""``dqwalk doctor``: checks whether a robot is ready to walk."""

from __future__ import annotations

import contextlib
import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import (
    Place,
    Real,
    Setup,
    command,
    setup_options,
)
from dqwalk_ros.plants.table import PLANTS, entry
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.ros_environment import check_ros_environment

if TYPE_CHECKING:
    from dqwalk_ros.config import Config
    from dqwalk_ros.robot.model import RobotModel

_BY_HAND = 300.0
"""Longest time for which joints are moved by hand [s]."""


def _namespace(_: click.Context, __: click.Parameter, text: str) -> str:
    names = text.strip("/")
    if names and not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", names, re.ASCII):
        expected = "names of letters, digits and underscores, separated by '/', such as robot_1"
        raise click.BadParameter(f"expected {expected}, not {text[:80]!r}")
    return names


@command("""
examples:
  dqwalk doctor --plant poppy                              a Poppy whose poppy_driver runs
  dqwalk doctor --plant ros2_control --config my_robot.yaml
  dqwalk doctor --plant poppy --params identified.yaml     with the parameters of `dqwalk identify`
  dqwalk doctor --plant poppy --by-hand                    torque off: move each joint by hand, to check names and signs
  dqwalk doctor --offline --plant ros2_control --config my_robot.yaml --controllers controllers.yaml
  dqwalk doctor --offline                                  the configuration and its robot only
""")
@setup_options("poppy", list(PLANTS), "poppy")
@click.option("--seconds", metavar="S", type=Real(0.5, 600.0), default=5.0, help="Time to listen [s].")
@click.option("--namespace", metavar="NAME", default="", show_default=False, callback=_namespace,
              help="Namespace of the robot.")  # fmt: skip
@click.option(
    "--by-hand",
    is_flag=True,
    help="Name each joint that you move by hand, and how it moved by the model, for up to five minutes.",
)
@click.option("--controllers", metavar="FILE", type=Place(), default=None,
              help="Also compare with this parameter file of the robot's controller_manager.")  # fmt: skip
@click.option("--offline", is_flag=True, help="Check the configuration only.")
def doctor(
    setup: Setup,
    seconds: float,
    namespace: str,
    by_hand: bool,
    controllers: Path | None,
    offline: bool,
) -> int:
    """Check a standing robot before its first step.

    Listens to its topics without moving anything, and prints the result of each check; if a check failed, also what to
    do. docs/hardware.md takes a robot from the box to its first step. Exit code 1 if a check failed.
    """
    from dqwalk_ros.cli.progress import Progress
    from dqwalk_ros.robot.model import load_model

    made, plant = setup.made(), setup.plant
    if controllers is not None and plant != "ros2_control":
        raise ConfigError(f"--controllers is of a robot with --plant ros2_control, not {plant}")
    if by_hand and offline:
        raise ConfigError("--by-hand listens to the robot, which --offline does not: leave one of them out")
    model = load_model(made.robot)
    with Progress() as bar:
        bar.stage(0.0, "checking the configuration")
        findings = _findings(made, model, plant, controllers)
    print(f"{model.name}: {model.n} joints, configuration '{setup.config}', plant {plant}")
    for finding in findings:
        print(f"! {'configuration':22s} {finding}")
    if not findings:
        print(f"  {'configuration':22s} fits the robot")
    if offline:
        return 1 if findings else 0
    check_ros_environment()
    if by_hand:
        return _by_hand(model, namespace)
    wrong = len(findings) + _failed_checks(made, model, namespace, seconds, simulated=bool(entry(plant).type))
    failed = f"{wrong} check{'s' if wrong > 1 else ''} failed; repair the first one first"
    print(failed if wrong else "ready to walk")
    return 1 if wrong else 0


def _findings(config: Config, model: RobotModel, plant: str, controllers: Path | None) -> list[object]:
    """Return what is wrong with a configuration; an error that only a walk would show is raised."""
    from dqwalk_ros.adopt.check import check, require_usable
    from dqwalk_ros.plants.robot_output import differences
    from dqwalk_ros.plants.table import require_accepted

    findings: list[object] = [*check(config, model)]
    if not findings:
        require_usable(config, model)
        require_accepted(plant, config, model)
    return findings if controllers is None else [*findings, *differences(config, model, controllers)]


def _by_hand(model: RobotModel, namespace: str) -> int:
    """Name each joint that is moved by hand; return the exit code."""
    from dqwalk_ros.cli.readiness import ByHand
    from dqwalk_ros.nodes.doctor import listen

    print(
        "move each joint by hand, one after the other (Ctrl-C ends); the model says, seen from the pelvis:",
        flush=True,
    )
    moved = ByHand(model, partial(print, flush=True))
    with contextlib.suppress(KeyboardInterrupt):
        listen(_BY_HAND, namespace, moved)
    if not moved.states:
        print("! no joint_states: start the driver, or the joint_state_broadcaster")
    print(f"! not moved: {', '.join(moved.left)}" if moved.left else "every joint was moved")
    print("where the robot did otherwise, the sign or the name of the joint is wrong, in its driver or in the model")
    return 1 if moved.left else 0


def _failed_checks(config: Config, model: RobotModel, namespace: str, seconds: float, *, simulated: bool) -> int:
    """Listen to the robot, and print the result of each check; return how many failed."""
    from dqwalk_ros.cli.readiness import examine
    from dqwalk_ros.nodes.doctor import listen

    print(f"listening for {seconds:g} s; the robot must stand still", flush=True)
    heard = listen(seconds, namespace)
    heard.simulated = simulated
    wrong = 0
    for found in examine(config, model, heard):
        print(found)
        wrong += not found.ok
    return wrong
