"""What numbers may be: one check, and one way to say what was needed, for every function that takes some."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping

from geomag._errors import InvalidInputError


def above(least: float, **numbers: float) -> None:
    """Refuse, by name, what is not a finite number above `least`."""
    _check(numbers, ">", operator.gt, least)


def at_least(least: float, **numbers: float) -> None:
    """Refuse, by name, what is not a finite number that is at least `least`."""
    _check(numbers, ">=", operator.ge, least)


def _check(numbers: Mapping[str, float], sign: str, good: Callable[[float, float], bool], least: float) -> None:
    for name, value in numbers.items():
        try:
            if math.isfinite(value) and good(value, least):
                continue
        except (TypeError, OverflowError):
            pass
        raise InvalidInputError(f"{name}: needed a number {sign} {least:g}, got {value}")
