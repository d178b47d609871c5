"""``dqwalk version``: prints the installed versions, for bug reports."""

from __future__ import annotations

from dqwalk_ros.cli.options import command


@command("")
def version() -> int:
    """Show the versions of this package and its dependencies."""
    from dqwalk_ros.support import provenance

    for name, value in provenance.machine().items():
        print(f"{name:<12} {value}")
    return 0
