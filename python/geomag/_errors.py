"""Exceptions. Each is a `GeomagError` and also the builtin kind that fits it; messages say needed, got and where."""

from __future__ import annotations


class GeomagError(Exception):
    """Root of every exception that geomag raises on purpose."""


class InvalidInputError(GeomagError, ValueError):
    """An argument is outside what the function accepts."""


class ShapeError(InvalidInputError):
    """Arrays that belong together do not fit each other."""


class NotFiniteError(InvalidInputError):
    """A value that must be finite is NaN or infinite."""


class TooFewSamplesError(InvalidInputError):
    """Too few samples for what was asked."""


class CandidateLimitError(InvalidInputError, MemoryError):
    """A search would exceed `max_candidates`; refused before memory is taken."""


class NumericalError(GeomagError, ArithmeticError):
    """A computation has no trustworthy numerical answer."""


class NotPositiveDefiniteError(NumericalError):
    """A covariance that must be positive definite is not, after bounded regularisation."""


class RankDeficientError(NumericalError):
    """Equations without a unique solution."""


class StateError(GeomagError, ValueError):
    """Saved state that cannot be read back."""


class ReadError(GeomagError, OSError):
    """A file that cannot be read as what it should be."""


class MissingFileError(GeomagError, FileNotFoundError):
    """A file that is not there."""


class UnknownVariableError(GeomagError, KeyError):
    """A variable or column that a file does not have."""

    def __str__(self) -> str:  # KeyError would show the message quoted
        return str(self.args[0]) if self.args else ""


class MissingDependencyError(GeomagError, ImportError):
    """An optional library is needed; the message names the extra that brings it."""


class TimeError(InvalidInputError):
    """Times of a file that can be read in two ways, or that cannot be what they are taken for."""


class DataWarning(UserWarning):
    """Something in a file or a stream was passed over or left out, and the rest is used; says what, how much and where."""
