"""``dqwalk version``: what is installed, for bug reports."""

from __future__ import annotations

from dqwalk_ros.cli.options import command

__all__ = ["version"]


@command("")
def version() -> int:
    """Show the versions of this package and of what it uses."""
    from dqwalk_ros import provenance

    for name, value in provenance.machine().items():
        print(f"{name:<12} {value}")
    return 0
