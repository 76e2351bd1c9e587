"""Numbers of text, what stands for no number, and the dummies of other programs."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geomag._errors import DataWarning, InvalidInputError

Array = NDArray[np.float64]

#: What stands for no value in a table, in lower case.
MISSING = {
    "",
    "*",
    "nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "-",
    "--",
    "---",
    "nat",
    "?",
    "missing",
    "blank",
    "nil",
    "-nan",
}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d{1,3})?")
_WHOLE = re.compile(r"[+-]?[0-9]+")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_HEMISPHERE = re.compile(r"([+-]?\d+(?:\.\d+)?)\s*°?\s*([NSEWnsew])")


def is_number(text: str) -> bool:
    """Whether a field is a decimal number, with a point."""
    return _NUMBER.fullmatch(text) is not None


def is_decimal_comma(text: str) -> bool:
    """Whether a field is a number with a decimal comma."""
    return _DECIMAL_COMMA.fullmatch(text) is not None


def is_missing(text: str) -> bool:
    """Whether a field stands for no value."""
    return text.lower() in MISSING


def plain(text: str) -> float:
    """A decimal number; ValueError for all else, also for what `float` takes beside (`1_0`, `inf`, blanks)."""
    if not is_number(text):
        raise ValueError(text)
    return float(text.replace("D", "E").replace("d", "e"))


def whole(text: str) -> int:
    """A number of digits, with or without a sign; ValueError for all else, also for what `int` takes beside."""
    if not _WHOLE.fullmatch(text):
        raise ValueError(text)
    return int(text)


def number(text: str, comma: bool = False) -> float:
    """One field as a number, NaN where it stands for none; ValueError for anything else."""
    text = text.strip()
    if is_missing(text):
        return float("nan")
    if comma and "," in text:
        text = text.replace(",", ".", 1)
    if _NUMBER.fullmatch(text):
        return float(text.replace("D", "E").replace("d", "e"))
    found = _HEMISPHERE.fullmatch(text)
    if found:
        return float(found[1]) * (-1.0 if found[2] in "SWsw" else 1.0)
    raise ValueError(text)


def numbers(texts: Sequence[str], comma: bool, where: str, lines: Sequence[int] | None = None) -> Array:
    """A column as numbers; what is none is named with its line."""
    try:
        # The fast way takes only what the slow one does, but for words of infinity and underscores, which are looked for.
        found = np.array(texts, dtype=np.str_).astype(np.float64)
        if np.isfinite(found).all() and not any("_" in t for t in texts):
            return found
    except (ValueError, OverflowError):
        pass
    out = np.empty(len(texts))
    for k, text in enumerate(texts):
        try:
            out[k] = number(text, comma)
        except ValueError:
            at = f"line {lines[k]}" if lines is not None else f"row {k}"
            raise InvalidInputError(f"{where}: needed numbers, got {text!r} in {at}") from None
    return out


def _nines(value: float) -> bool:
    """Whether a number is -999, or nines in four places and more before the point (9999, -99999.9, 99999.00)."""
    text = f"{abs(value):.6f}".rstrip("0").rstrip(".")
    return value == -999.0 or (len(text.split(".")[0]) >= 4 and set(text) <= {"9", "."})


def dummies_of(values: NDArray[np.floating], least: float = 0.0) -> list[float]:
    """Numbers in an array that stand for no value: sizes that no field has, and nines or integer limits away from all others.

    Numbers of 1e12 and more in size are none of a field in nT, mGal, metres or degrees (Surfer's 1.70141e38, Geosoft's -1e32 and
    -1e12, netCDF's 9.97e36). Nines and the limits of integers count where they lie outside the range of the other numbers by more than it is
    wide, from five nines on wherever they lie outside it. `least` is the smallest that may be one.
    """
    known = np.unique(values[np.isfinite(values)])
    found = [float(v) for v in known if abs(v) >= 0.99e12]
    rest = known[np.abs(known) < 0.99e12]
    ends = [*rest[: min(8, len(rest))], *rest[max(0, len(rest) - 8) :]]
    suspects = {float(v) for v in ends if abs(v) >= least and (_nines(float(v)) or float(v) in _LIMITS)}
    if suspects:
        others = rest[~np.isin(rest, list(suspects))]
        for v in sorted(suspects):
            if not len(others):
                found.append(v)
                continue
            low, high = float(others[0]), float(others[-1])
            gap = low - v if v < low else v - high
            if gap > (0.0 if abs(v) >= 99_999 else high - low):
                found.append(v)
    return found


_LIMITS = {-32768.0, 32767.0, -32767.0, -2147483648.0, 2147483647.0, 65535.0, 4294967295.0}


def without_dummies(values: Array, where: str, least: float = 0.0) -> Array:
    """Values with dummies as NaN; a `DataWarning` tells which and how many."""
    found = dummies_of(values, least)
    if not found:
        return values
    gone = np.isin(values, np.array(found, dtype=values.dtype))
    told = ", ".join(f"{v:g}" for v in found[:4])
    warnings.warn(
        f"{where}: {int(gone.sum())} of {values.size} values are dummies ({told}) and are left out",
        DataWarning,
        stacklevel=4,
    )
    out = values.copy()
    out[gone] = np.nan
    return out
