"""``dqwalk config``: lists, checks or prints parameters."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import click

from dqwalk_ros.cli.options import command, config_of, params_option, parse_overrides, set_option
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.wording import listed

if TYPE_CHECKING:
    from pathlib import Path

    from dqwalk_ros.config import Config, Spec


@command("""
examples:
  dqwalk config                                            every parameter
  dqwalk config --section ssp                              those of one section
  dqwalk config paper > mine.yaml                          start a configuration of your own
  dqwalk config mine.yaml --check                          is it valid?
  dqwalk config paper --set gait.step_length=0.04
  dqwalk config poppy_dynamic --params arms > mine.yaml    with a file of config/overlays
  dqwalk config poppy --set 'collision.pairs=[l_shin=r_shin]' --capsules     their shapes, for your file
""")
@click.argument("config", required=False)
@click.option("--section", metavar="NAME", help="List one section only.")
@click.option("--check", is_flag=True, help="Only check that it is valid and fits its robot.")
@click.option(
    "--capsules",
    is_flag=True,
    help="Print collision.capsules for the links of collision.pairs, by default for the arms.",
)
@params_option
@set_option
def config(
    config: str | None,
    section: str | None,
    check: bool,
    capsules: bool,
    params: tuple[Path, ...],
    changes: tuple[str, ...],
) -> int:
    """List, check or print parameters.

    Without CONFIG: the list of all parameters. With CONFIG, the name of a shipped configuration or the path of a YAML
    file: check it and print it in full, as a ROS parameter file. Live parameters may be set while a node runs.
    """
    from dqwalk_ros.config import Config, to_yaml

    if config is not None and section is not None:
        raise ConfigError("--section belongs to the list of all parameters; leave out CONFIG")
    for option, given in (("--params", params), ("--check", check), ("--capsules", capsules)):
        if config is None and given:
            raise ConfigError(f"{option} is about a configuration; name it, such as dqwalk config poppy {option}")
    if config is not None:
        made = config_of(config, changes, params=params)
        if capsules:
            return _capsules(made)
        if not check:
            print(to_yaml(made), end="")
            return 0
        return _check(config, made)
    Config().updated(parse_overrides(changes), source="command line")
    print(_listing(section))
    return 0


def _check(name: str, made: Config) -> int:
    """Print the parameters that do not fit the robot; return 1 if there are any."""
    from dqwalk_ros.adopt.check import check, require_usable
    from dqwalk_ros.config import is_whole_body
    from dqwalk_ros.robot.model import load_model

    model = load_model(made.robot)
    for repair in model.repairs:
        print(f"repaired: {repair}")
    if is_whole_body(made):
        from dqwalk_ros.whole_body import WholeBodyController

        WholeBodyController(made, model)
        findings = []
    elif not (findings := check(made, model)):
        require_usable(made, model)
    for finding in findings:
        print(f"{name}: {finding}")
    if not findings:
        print(f"{name}: can be used")
    return 1 if findings else 0


def _capsules(made: Config) -> int:
    """Print the capsules around the shapes of the links that are kept apart, without pairs those that the arms meet."""
    from dqwalk_ros.adopt.own_bodies import pairs_of_arms
    from dqwalk_ros.robot.model import find_urdf, load_model
    from dqwalk_ros.robot.shapes import Shapes, capsule_around
    from dqwalk_ros.robot.urdf import Urdf

    model = load_model(made.robot)
    urdf = Urdf(model.urdf, model.name)
    shapes = Shapes(urdf, find_urdf(made.robot.urdf))
    pairs = made.collision.pairs
    if not pairs and made.arms.joints:
        pairs = tuple(found := pairs_of_arms(made, model, shapes.hulls(list(urdf.links))[0]))
        for mesh, reason in shapes.missing.items():
            print(f"# without {mesh}: {reason}")
        if not found:
            raise ConfigError("the arms can meet no link whose shape can be read: collision.pairs is not needed")
        print("# what the arms can meet, and in what part of their postures they do\ncollision.pairs:")
        for pair, part in found.items():
            print(f'  - "{pair}"  # {100.0 * part:.1f} %')
    links = dict.fromkeys(link.strip() for pair in pairs for link in pair.split("="))
    if not links:
        raise ConfigError("--capsules needs collision.pairs, such as --set 'collision.pairs=[l_shin=r_shin]'")
    hulls, which = shapes.hulls([link for link in links if link in model.frames])
    if lost := [link for link in links if link not in hulls]:
        why = "; ".join(f"{mesh}: {reason}" for mesh, reason in shapes.missing.items())
        raise ConfigError(f"no shape of {listed(lost)} can be read{f' ({why})' if why else ''}")
    print(f"# around the {which} of the links\ncollision.capsules:")
    for link in links:
        a, b, radius = capsule_around(hulls[link])
        print(f'  - "{link}={" ".join(f"{x:.4f}" for x in (*a, *b))} {radius:.4f}"')
    return 0


def _listing(section: str | None) -> str:
    from dqwalk_ros.config import Config

    specs = [spec for spec in Config.specs() if section in (None, spec.name.rpartition(".")[0])]
    if not specs:
        known = dict.fromkeys(spec.name.rpartition(".")[0] for spec in Config.specs())
        raise ConfigError(f"no section {section!r}; the sections are {', '.join(name for name in known if name)}")
    names = max(len(spec.name) for spec in specs)
    lines = []
    for spec in specs:
        live = ", live" if spec.live else ""
        lines.append(f"{spec.name:<{names}}  {_value(spec)}  ({spec.expects}{live})")
        lines += textwrap.wrap(spec.meaning, 100, initial_indent=" " * (names + 2), subsequent_indent=" " * (names + 2))
    return "\n".join(lines)


def _value(spec: Spec) -> str:
    value = spec.default
    text = str(value).lower() if isinstance(value, bool) else "none" if value in ((), "") else str(value)
    return f"{text} {spec.unit}".rstrip()
