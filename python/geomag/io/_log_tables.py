"""Positions and readings that a log keeps in streams of their own, brought together by their times into one table."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geomag._errors import DataWarning, ReadError, UnknownVariableError
from geomag.io._names import Column, columns_of
from geomag.io._text import Table

Array = NDArray[np.float64]

#: Positions further apart in time than this are not joined by a line.
MOST_GAP_S = 5.0


@dataclass(frozen=True)
class Series:
    """One stream of a log: a name, times in seconds, and columns of that length."""

    name: str
    time_s: Array
    columns: dict[str, Array]


def one_of(found: dict[str, Series], asked: str | None, what: str, where: str) -> Series:
    """The stream asked for by name, or the only one there is; several and none are asked about."""
    if asked is not None:
        if asked not in found:
            raise UnknownVariableError(f"{where}: needed {what}= among {', '.join(found) or 'none'}, got '{asked}'")
        return found[asked]
    if len(found) != 1:
        got = "none" if not found else f"{len(found)}: {', '.join(found)}; name one with {what}="
        raise UnknownVariableError(f"{where}: needed one stream for {what}, got {got}")
    return next(iter(found.values()))


def magnitude_nt(x: Array, y: Array, z: Array, nt_per_unit: float) -> Array:
    """Strength of a vector reading, nT."""
    return np.asarray(np.sqrt(x * x + y * y + z * z) * nt_per_unit)


def joined(positions: Series, readings: Series, where: str) -> Table:
    """A table with a row for every reading that lies between two positions; others are left out and told.

    Positions are interpolated linearly in time; they need columns `longitude` and `latitude`, degrees.
    """
    order = np.argsort(positions.time_s, kind="stable")
    t = positions.time_s[order]
    good = (
        np.isfinite(t)
        & np.isfinite(positions.columns["longitude"][order])
        & np.isfinite(positions.columns["latitude"][order])
    )
    t, order = t[good], order[good]
    fresh = np.concatenate([[True], np.diff(t) > 0]) if t.size else np.zeros(0, dtype=bool)
    t, order = t[fresh], order[fresh]
    at = readings.time_s
    if t.size < 2 or at.size == 0:
        raise ReadError(f"{where}: needed two positions and a reading at least, got {t.size} and {at.size}")
    rows = np.argsort(at, kind="stable")
    at = at[rows]
    after = np.clip(np.searchsorted(t, at, side="left"), 1, t.size - 1)
    inside = np.isfinite(at) & (at >= t[0]) & (at <= t[-1]) & (t[after] - t[after - 1] <= MOST_GAP_S)
    if not inside.all():
        warnings.warn(
            f"{where}: {int((~inside).sum())} of {at.size} readings of {readings.name} have no positions within {MOST_GAP_S:g} s around "
            "them and are left out",
            DataWarning,
            stacklevel=5,
        )
    if not inside.any():
        raise ReadError(
            f"{where}: needed readings between positions, got {at[0]:g} to {at[-1]:g} s and {t[0]:g} to {t[-1]:g} s"
        )
    rows, at = rows[inside], at[inside]
    out: dict[str, Array] = {"time_s": at - at[0]}
    for name, values in positions.columns.items():
        own = values[order]
        own = np.unwrap(own, period=360.0) if name == "longitude" else own
        out[name] = np.interp(at, t, own)
    out["longitude"] = (out["longitude"] + 180.0) % 360.0 - 180.0
    for name, values in readings.columns.items():
        out[name] = values[rows]
    return numbers_table(out, where)


def numbers_table(columns: dict[str, Array], where: str) -> Table:
    """A table of columns of numbers."""
    names = list(columns)
    made: list[Column] = columns_of(names)
    count = len(columns[names[0]])
    table = Table(where, made, [[] for _ in names], list(range(count)))
    table.numbers_ = {k: np.asarray(columns[n], dtype=np.float64) for k, n in enumerate(names)}
    return table
