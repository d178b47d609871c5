"""The command line, ``dqwalk``: one module per command.

The module of a command imports heavy dependencies only when the command runs, so that help is fast.
"""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
from collections.abc import Sequence

import click

from dqwalk_ros.support.errors import ConfigError, DqwalkError, ModelError
from dqwalk_ros.support.imports import not_imported
from dqwalk_ros.support.interrupts import is_interrupt
from dqwalk_ros.support.wording import printable

__all__ = ["FAILED", "OK", "USAGE", "dqwalk", "main"]

OK, FAILED, USAGE = 0, 1, 2

COMMANDS = (
    "simulate",
    "walk",
    "reach",
    "report",
    "view",
    "movie",
    "robustness",
    "pushes",
    "evidence",
    "footsteps",
    "study",
    "exercise",
    "identify",
    "replay",
    "adopt",
    "servos",
    "config",
    "doctor",
    "version",
)

_EPILOG = """\b
examples:
  dqwalk simulate --out walk                                      the paper's walk: bag, figures and report in walk/
  dqwalk simulate --config poppy_dynamic --plant physics --view   the dynamic walk in MuJoCo, shown in the browser
  dqwalk report walk/bag --html                                   evaluate a recorded walk, on one page
  dqwalk adopt my_robot.urdf                                      another robot: a configuration that walks
  dqwalk doctor --plant poppy                                     is this robot ready to walk? (docs/hardware.md)

exit code: 0 success; 1 the walk failed or violated a constraint, or a file cannot be read or written; 2 wrong
arguments or configuration
"""


class _Commands(click.Group):
    """Finds a command by the name of its module."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        made: click.Command = getattr(importlib.import_module(f"dqwalk_ros.cli.{name}"), name)
        return made

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in COMMANDS:
            ctx.fail(f"no command {args[0]!r}; the commands are {', '.join(COMMANDS)}")
        return super().resolve_command(ctx, args)


@click.command(cls=_Commands, epilog=_EPILOG, no_args_is_help=False, context_settings={"max_content_width": 120})
def dqwalk() -> None:
    """Biped walking control with quadratic programming and vector-field inequalities."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code, which the help describes."""
    words = list(sys.argv[1:] if argv is None else argv)
    _open_standard_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a terminal in ASCII or Latin-1 shows what it can
    os.environ.pop("MPLBACKEND", None)  # figures are written, not shown; matplotlib refuses an unknown backend
    try:
        with dqwalk.make_context("dqwalk", words) as context:
            code: int | None = dqwalk.invoke(context)
        sys.stdout.flush()
        return code or OK
    except click.exceptions.Exit as done:  # of --help
        return done.exit_code
    except click.UsageError as error:
        own = [word for word in words[:1] if word in COMMANDS]  # for errors of the parser, which know no command
        path = error.ctx.command_path if error.ctx else " ".join(["dqwalk", *own])
        return _fail(f"{error.format_message().rstrip('.')}; `{path} --help` shows how", USAGE)
    except click.Abort:  # a question without an answer
        return _fail("interrupted", FAILED)
    except (ConfigError, ModelError) as error:
        return _fail(error, USAGE)
    except DqwalkError as error:
        return _fail(error, FAILED)
    except (KeyboardInterrupt, SystemError) as error:
        if not is_interrupt(error):
            raise
        return _fail("interrupted", FAILED)
    except MemoryError:
        return _fail("not enough memory", FAILED)
    except BrokenPipeError:  # `dqwalk config | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:  # a full disk, a folder that cannot be written, ...
        where = repr(error.filename) if error.filename else _lost_folder()
        return _fail(f"{error.strerror or error}{where and f': {where}'}", FAILED)
    except Exception as error:
        if why := not_imported(error):
            return _fail(why, FAILED)
        raise


def _lost_folder() -> str:
    """Return that the current folder was removed; empty if it was not."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return "the current folder was removed; change to another one"
    return ""


def _open_standard_streams() -> None:
    """Open the null device for each standard stream that is closed; else a file of results would take its number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115


def _fail(error: object, code: int) -> int:
    """Print an error in one line without control characters, and return the exit code."""
    print(f"dqwalk: {printable(str(error))}", file=sys.stderr)
    return code
