"""Samples from a pipe, fixes to a pipe: one line in, one line out, at once.

Input is CSV (`x,y,value` or `time,x,y,value`; lines that start with # and a header line are passed over) or NMEA 0183:
positions from GGA or RMC sentences, values from a sentence `$PGMAG,<value>*hh` after them. Output is one JSON object a
sample. Nothing is buffered, so that a fix is there when its sample is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TextIO

from geomag._errors import InvalidInputError
from geomag._geomag import Fix

__all__ = ["Sample", "read_csv", "read_nmea", "run"]


@dataclass(frozen=True)
class Sample:
    """One reading: indicated position (map units), measured value, time in seconds where it is known."""

    x: float
    y: float
    value: float
    time_s: float | None = None


class _Step(Protocol):
    @property
    def status(self) -> str: ...
    @property
    def fix(self) -> Fix: ...


class Matcher(Protocol):
    """A streaming matcher: `Iema`, `PosteriorMatcher` and their like."""

    def update(self, x: float, y: float, value: float) -> _Step | Fix:
        """Take one sample."""
        ...


def read_csv(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from CSV lines `x,y,value` or `time,x,y,value`.

    Raises
    ------
    InvalidInputError
        Naming the line that is neither.
    """
    for number, raw in enumerate(lines, start=1):
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        parts = line.replace(";", ",").split(",")
        try:
            numbers = [float(p) for p in parts]
        except ValueError as error:
            if number == 1:
                continue  # a header
            raise InvalidInputError(f"line {number}: needed numbers x,y,value, got {line!r}") from error
        if len(numbers) not in (3, 4) or not all(map(math.isfinite, numbers)):
            raise InvalidInputError(f"line {number}: needed finite x,y,value or time,x,y,value, got {line!r}")
        x, y, value = numbers[-3:]
        yield Sample(x, y, value, numbers[0] if len(numbers) == 4 else None)


def _sentence(line: str, number: int) -> list[str] | None:
    """Fields of an NMEA sentence whose checksum holds; None for lines that are no sentence."""
    if not line.startswith("$"):
        return None
    body, star, told = line[1:].partition("*")
    if star:
        checksum = 0
        for byte in body.encode("ascii", "replace"):
            checksum ^= byte
        try:
            good = int(told[:2], 16) == checksum
        except ValueError:
            good = False
        if not good:
            raise InvalidInputError(f"line {number}: needed checksum {checksum:02X}, got {told!r}")
    return body.split(",")


def _degrees(text: str, hemisphere: str, digits: int) -> float:
    value = int(text[:digits]) + float(text[digits:]) / 60.0
    return -value if hemisphere in ("S", "W") else value


def read_nmea(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from NMEA 0183: a position (GGA or RMC), then `$PGMAG,<value>*hh`; other sentences are passed over.

    Raises
    ------
    InvalidInputError
        Naming the line of a wrong checksum or of a sentence that cannot be read.
    """
    position: tuple[float, float, float | None] | None = None
    for number, raw in enumerate(lines, start=1):
        fields = _sentence(raw.strip(), number)
        if fields is None:
            continue
        try:
            kind = fields[0][-3:]
            if kind in ("GGA", "RMC"):
                first = 2 if kind == "GGA" else 3
                latitude = _degrees(fields[first], fields[first + 1], 2)
                longitude = _degrees(fields[first + 2], fields[first + 3], 3)
                clock = fields[1]
                seconds = 3600.0 * int(clock[:2]) + 60.0 * int(clock[2:4]) + float(clock[4:]) if clock else None
                position = (longitude, latitude, seconds)
            elif fields[0] == "PGMAG" and position is not None:
                yield Sample(position[0], position[1], float(fields[1]), position[2])
        except (IndexError, ValueError) as error:
            raise InvalidInputError(f"line {number}: needed an NMEA sentence, got {raw.strip()!r}") from error


def run(matcher: Matcher, samples: Iterable[Sample], out: TextIO, *, restart: bool = True) -> Fix | None:
    """Feed samples to a streaming matcher and write one JSON line for each; return the last fix.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    out : where the lines go; flushed after each.
    restart : whether the matcher begins anew after a fix or when lost; it must then have `reset()`.
    """
    last: Fix | None = None
    for sample in samples:
        step = matcher.update(sample.x, sample.y, sample.value)
        fix = step if isinstance(step, Fix) else step.fix
        line = {k: _plain(v) for k, v in fix.to_dict().items()}
        if sample.time_s is not None:
            line["time_s"] = sample.time_s
        out.write(json.dumps(line, allow_nan=False) + "\n")
        out.flush()
        last = fix
        if restart and fix.status in ("fixed", "lost"):
            matcher.reset()  # type: ignore[attr-defined]
    return last


def _plain(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
