"""The command line: ``dqwalk simulate | robustness | walk | report | view | config | version``.

Only `argparse` is loaded until a command is known, so that help comes at once.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Sequence

from dqwalk_ros.cli import parser
from dqwalk_ros.errors import ConfigError, DqwalkError, ModelError

__all__ = ["FAILED", "OK", "USAGE", "main"]

OK, FAILED, USAGE = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 if all went well, 1 if the walk failed or broke a promise, 2 if the arguments or the configuration
        cannot be used.
    """
    args = parser.build().parse_args(argv)
    try:
        return _run(args)
    except (ConfigError, ModelError) as error:
        return _fail(error, USAGE)
    except DqwalkError as error:
        return _fail(error, FAILED)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "dqwalk_ros":
            raise
        return _fail(f"this needs the Python module '{error.name}', which is not installed", FAILED)
    except KeyboardInterrupt:
        return _fail("interrupted", FAILED)
    except BrokenPipeError:  # `dqwalk config | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE


def _run(args: argparse.Namespace) -> int:
    command = importlib.import_module(f"dqwalk_ros.cli.{args.command}")
    code: int = command.run(args)
    sys.stdout.flush()
    return code


def _fail(error: object, code: int) -> int:
    print(f"dqwalk: {error}", file=sys.stderr)
    return code
