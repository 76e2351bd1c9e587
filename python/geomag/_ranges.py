"""What numbers may be: one check, and one way to say what was needed, for every function that takes some."""

from __future__ import annotations

import math

from geomag._errors import InvalidInputError


def above(least: float, **numbers: float) -> None:
    """Refuse numbers that are not finite and above `least`, by name."""
    for name, value in numbers.items():
        if not (math.isfinite(value) and value > least):
            raise InvalidInputError(f"{name}: needed a number > {least:g}, got {value}")


def at_least(least: float, **numbers: float) -> None:
    """Refuse numbers that are not finite and at least `least`, by name."""
    for name, value in numbers.items():
        if not (math.isfinite(value) and value >= least):
            raise InvalidInputError(f"{name}: needed a number >= {least:g}, got {value}")
