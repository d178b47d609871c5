"""Exceptions of the package; some have attributes that name the rows or the phase concerned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


class DqwalkError(Exception):
    """Base class of all exceptions that this package defines."""


class ConfigError(DqwalkError):
    """A configuration is not valid; the message names the key and the values allowed."""


class ModelError(DqwalkError):
    """A robot description is not valid; the message names the element."""


class StateError(DqwalkError):
    """A measured state or a commanded target is not valid; the message names the joints or the value."""


class PlantError(DqwalkError):
    """The plant (simulator or robot driver) failed, or a command does not fit it."""


class BagError(DqwalkError):
    """A bag does not contain a walk that can be read; the message names what is missing."""


class OutputError(DqwalkError):
    """A result is not written, because something exists in its place."""


class ViewerError(DqwalkError):
    """The viewer's web page cannot be served; the message says what to do."""


class StudyError(DqwalkError):
    """The results of a study cannot be read or written."""


class QPError(DqwalkError):
    """A quadratic program has no solution, or the solver found none that fulfils the optimality conditions.

    Attributes
    ----------
    status : str
        Status of the solver, or of the check of its solution.
    rows : tuple of str
        Names of the rows that conflict or are violated, most violated first; may be empty.
    short : dict of str to float
        Amount by which each of some rows must be relaxed for the problem to be feasible, in the row's own unit per
        second; may be empty.
    """

    def __init__(
        self, message: str, *, status: str, rows: Sequence[str] = (), short: Mapping[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.status = status
        self.rows = tuple(rows)
        self.short = dict(short or {})


class PhaseError(DqwalkError):
    """A phase does not reach the condition that ends it.

    Attributes
    ----------
    phase : str
        Name of the phase, such as ``"single_support/left"``.
    error : float
        Norm of the task error when the exception was raised.
    active : tuple of str
        Names of the inequalities that were active then.
    stalled : bool
        Whether the error no longer decreased.
    """

    def __init__(
        self, message: str, *, phase: str, error: float, active: Sequence[str] = (), stalled: bool = False
    ) -> None:
        super().__init__(message)
        self.phase = phase
        self.error = error
        self.active = tuple(active)
        self.stalled = stalled

    def held_by(self, rows: Sequence[str]) -> PhaseError:
        """Return a copy of the error that names `rows`, the inequalities that are active, in attribute and message."""
        minimum = ": a local minimum of the task" if self.stalled else ""
        text = f"active: {', '.join(rows)}" if rows else f"no constraint is active{minimum}"
        return PhaseError(f"{self}; {text}", phase=self.phase, error=self.error, active=rows, stalled=self.stalled)
