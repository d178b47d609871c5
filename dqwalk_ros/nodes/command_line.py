"""Command line of the nodes: help, options, console scripts.

``--help`` prints the docstring of the node's class and its parameters. Both are read without importing ROS, so help is
fast and works where ROS is not installed.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import re
import signal
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dqwalk_ros.config import Config, Spec
from dqwalk_ros.plants.table import defaults_of
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.imports import not_imported
from dqwalk_ros.support.node_table import NODES
from dqwalk_ros.support.ros_environment import check_ros_environment
from dqwalk_ros.support.wording import unexpanded


def docstring(name: str) -> str:
    """Return the docstring of a node's class."""
    module, _, kind = NODES[name].partition(":")
    file = Path(__file__).parents[1].joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    (found,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == kind)
    return inspect.cleandoc(ast.get_docstring(found) or "")


def sections_of(name: str) -> list[str]:
    """Return the sections of the schema, or single parameters of it, that a node's docstring lists."""
    found = re.search(r"^Sections of the schema: (.*?)\.$", docstring(name), re.M | re.S)
    return re.split(r",\s+", found.group(1)) if found else []


def parameters_of(name: str) -> list[Spec]:
    """Return the parameters that a node uses, those of `sections_of`, with its defaults."""
    listed, defaults = sections_of(name), defaults_of(name).flat()
    used = [spec for spec in Config.specs() if spec.name in listed or spec.name.split(".")[0] in listed]
    return [replace(spec, default=defaults[spec.name]) for spec in used]


def parse(name: str, argv: Sequence[str]) -> argparse.Namespace:
    """Parse the command line of a node; ``.argv`` of the result is the complete command line, for rclpy.

    Parameters
    ----------
    name : str
        Name of the node.
    argv : sequence of str
        Without the program's name.
    """
    helps = not {"-h", "--help"}.isdisjoint(argv)  # else its texts, which take 20 ms, are not needed
    parser = argparse.ArgumentParser(
        prog=f"dqwalk_{name}",
        usage=f"dqwalk_{name} {'--bag DIR ' if name == 'recorder' else ''}"
        "[--ros-args --params-file FILE -p NAME:=VALUE ...]",
        description=docstring(name).replace("::\n", ":\n") if helps else None,
        epilog=_epilog(name) if helps else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--child", action="store_true", help="for programs: print progress as lines of JSON, stop with the parent"
    )
    if name == "recorder":
        parser.add_argument(
            "--bag", metavar="DIR", type=_new, required=True, help="folder to create; it must not exist yet"
        )
    if name == "pilot":
        parser.add_argument(
            "--cmd-vel", metavar="X,Y,TURN,S", action="append", required=True,
            help="velocity forward, left [m/s] and turn [rad/s], and its duration [s]; repeat for the next leg",
        )  # fmt: skip
    if name == "viewer":
        parser.add_argument("--port", type=int, help="port of the page; 0: any [8080, or the next free one]")
    own = list(argv)
    if "--ros-args" in own:
        start = own.index("--ros-args")
        stop = own.index("--", start) + 1 if "--" in own[start:] else len(own)
        del own[start:stop]
    options = parser.parse_args(own)
    options.argv = [name, *argv]
    return options


def _new(folder: str) -> str:
    """Return the name of a folder to be created."""
    if why := unexpanded(folder) or ("" if folder else "it is empty"):
        raise argparse.ArgumentTypeError(f"'{folder}': {why}")
    return folder


def _epilog(name: str) -> str:
    lines = ["parameters (name = default [unit]):"]
    for spec in parameters_of(name):
        unit = f" [{spec.unit}]" if spec.unit else ""
        value = str(spec.default).lower() if spec.type is bool else spec.default
        head = f"  {spec.name} = {value if value not in ('', ()) else '(none)'}{unit}"
        lines += textwrap.wrap(spec.meaning, 118, initial_indent=f"{head:42s}  ", subsequent_indent=" " * 44)
    lines += [
        "",
        "  Every node accepts every parameter of the package, so one file serves all nodes (`/**:`); an unknown name",
        "  is an error. Exit code: 0 stopped or finished, 1 the walk failed, 2 invalid arguments.",
        "",
        f"with a sourced ROS: ros2 run dqwalk_ros {name} --help",
    ]
    return "\n".join(lines)


def main(name: str, argv: Sequence[str]) -> int:
    """Run a node; return the exit code.

    Parameters
    ----------
    name : str
        Name of the node.
    argv : sequence of str
        Without the program's name.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # an import may lose a KeyboardInterrupt; later `wheels.init`
    options = parse(name, argv)  # help and usage errors need no ROS
    module, _, kind = NODES[name].partition(":")
    try:
        check_ros_environment()
        base = importlib.import_module("dqwalk_ros.nodes.base")
        made = getattr(importlib.import_module(f"dqwalk_ros.{module}"), kind)
    except ConfigError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    except Exception as error:
        if why := not_imported(error):
            print(f"{name}: {why}", file=sys.stderr)
            return 2
        raise
    code: int = base.main(made, options)
    return code


def script() -> int:
    """Run the node named by the program, such as ``controller`` or ``dqwalk_controller``."""
    return main(Path(sys.argv[0]).stem.removeprefix("dqwalk_"), sys.argv[1:])
