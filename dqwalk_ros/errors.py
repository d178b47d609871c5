"""What can go wrong, each error carrying its evidence."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

__all__ = [
    "BagError",
    "ConfigError",
    "DqwalkError",
    "ModelError",
    "PhaseError",
    "PlantError",
    "QPError",
    "StateError",
    "StudyError",
    "ViewerError",
    "listed",
]


def listed(names: Collection[str]) -> str:
    """Return some names that came from outside, for a message that fits on a line and cannot act on a terminal."""
    shown = [ascii(name)[1:-1][:60] for name in sorted(names)[:12]]
    return ", ".join([*shown, f"and {len(names) - 12} more"] if len(names) > 12 else shown)


class DqwalkError(Exception):
    """The parent of every error this package raises on purpose."""


class ConfigError(DqwalkError):
    """A configuration that cannot be used; the message names the key and what it should be."""


class ModelError(DqwalkError):
    """A robot description that cannot be used; the message names the element."""


class StateError(DqwalkError):
    """A measured state that must not reach the controller; the message names the joints."""


class PlantError(DqwalkError):
    """The other side of the command (simulator, driver) failed."""


class BagError(DqwalkError):
    """A bag that cannot be read as a walk; the message says what is missing."""


class ViewerError(DqwalkError):
    """The page cannot be served; the message says what to do."""


class StudyError(DqwalkError):
    """The results of a study cannot be read or written."""


class QPError(DqwalkError):
    """A quadratic program without an acceptable answer.

    Attributes
    ----------
    status : str
        What the solver said.
    rows : tuple of str
        Names of the rows that stand in the way, most violated first; may be empty.
    short : dict of str to float
        By how much rows would have to give way, in their own unit per second; may be empty.
    """

    def __init__(
        self, message: str, *, status: str, rows: Sequence[str] = (), short: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.status = status
        self.rows = tuple(rows)
        self.short = dict(short or {})


class PhaseError(DqwalkError):
    """A phase that cannot end by its rule.

    Attributes
    ----------
    phase : str
        Name of the phase, such as ``"single_support/left"``.
    error : float
        Norm of the task error at which it stopped.
    active : tuple of str
        Names of the rows that hold it there.
    """

    def __init__(self, message: str, *, phase: str, error: float, active: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.phase = phase
        self.error = error
        self.active = tuple(active)

    def held_by(self, rows: Sequence[str]) -> PhaseError:
        """Return the error with the rows that hold the phase where it is."""
        text = f"; active: {', '.join(rows)}" if rows else "; no constraint is active: a local minimum of the task"
        return PhaseError(f"{self}{text}", phase=self.phase, error=self.error, active=rows)
