"""The programs that a user starts: the command `dqwalk` and the nodes."""

from __future__ import annotations

import signal
import sys


class _Starting:
    """While a program imports its modules, Ctrl-C ends it silently: nothing has begun that could be lost.

    Python would print where it was importing, or an import could lose the KeyboardInterrupt. A package that cannot be
    imported, as with the PYTHONPATH of another Python, ends it with its name.
    """

    def __enter__(self) -> None:
        self._before = signal.getsignal(signal.SIGINT)
        if self._before is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        signal.signal(signal.SIGINT, self._before)
        if not isinstance(error, Exception):
            return
        from dqwalk_ros.support.imports import not_imported  # not before Ctrl-C ends the program silently

        if why := not_imported(error):
            sys.exit(f"{sys.argv[0].rpartition('/')[2]}: {why}")


def dqwalk() -> int:
    """Run the command `dqwalk`; return the exit code."""
    with _Starting():
        from dqwalk_ros.cli import main
    return main()


def node() -> int:
    """Run the node named by the program, such as ``controller`` or ``dqwalk_controller``; return the exit code."""
    with _Starting():
        from dqwalk_ros.nodes.command_line import script
    return script()
