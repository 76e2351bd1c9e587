"""Samples from a pipe, fixes to a pipe: one line in, one line out, at once.

Input is CSV or NMEA 0183. CSV lines are `x,y,value` or `time,x,y,value`, or whatever a header line says; lines that start with #
are passed over. NMEA has positions in GGA or RMC sentences and values in sentences `$PGMAG,<value>*hh` after them. Output is one
JSON object a sample. Nothing is buffered, so that a fix is there when its sample is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TextIO

from geomag._errors import InvalidInputError
from geomag._geomag import Fix
from geomag.io import _TIME_NAMES, _VALUE_NAMES, _X_NAMES, _Y_NAMES, _is_number

__all__ = ["Event", "Matcher", "Sample", "Step", "feed", "read_csv", "read_nmea", "run"]

#: Those of `Fix.to_dict()`.
_FIELDS = (
    "status",
    "ok",
    "x",
    "y",
    "offset",
    "offset_m",
    "heading_deg",
    "scale",
    "bias",
    "covariance_m2",
    "risk",
    "goodness",
    "score",
    "runner_up",
    "n_samples",
    "iterations",
)


@dataclass(frozen=True)
class Sample:
    """One reading: indicated position (map units), measured value, time in seconds where it is known."""

    x: float
    y: float
    value: float
    time_s: float | None = None


class Step(Protocol):
    """What a matcher says after a sample; no fix where it did not look for one at this sample."""

    @property
    def status(self) -> str:
        """Whether a fix may be declared, and why not."""
        ...

    @property
    def fix(self) -> Fix | None:
        """The answer, where there is one."""
        ...


class Matcher(Protocol):
    """A streaming matcher: `Iema`, `PosteriorMatcher`, `SlidingContour` and their like.

    One that has `reset()` can begin anew; a sliding window need not.
    """

    def update(self, x: float, y: float, value: float, /) -> Step | Fix:
        """Take one sample."""
        ...


def _header(names: Sequence[str], number: int) -> list[int | None]:
    """Columns of x, y, value and time by a header; the usual order where it names no coordinates."""
    known = {name.strip().strip('"').lower(): k for k, name in reversed(list(enumerate(names)))}

    def column(usual: Sequence[str]) -> int | None:
        return next((known[name] for name in usual if name in known), None)

    x, y, value, time = (column(usual) for usual in (_X_NAMES, _Y_NAMES, _VALUE_NAMES, _TIME_NAMES))
    if x is None and y is None and len(names) in (3, 4):
        return _usual(len(names))
    others = sorted(set(range(len(names))) - {x, y, time})
    if value is None and len(others) == 1:
        value = others[0]
    if x is None or y is None or value is None:
        raise InvalidInputError(f"line {number}: needed columns for x, y and value, got {', '.join(names)}")
    return [x, y, value, time]


def _usual(count: int) -> list[int | None]:
    return [0, 1, 2, None] if count == 3 else [1, 2, 3, 0]


def read_csv(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from CSV lines `x,y,value` or `time,x,y,value`, or with the columns that a header line names.

    Raises
    ------
    InvalidInputError
        Naming the line that is neither, or a header without x, y or value.
    """
    columns: list[int | None] | None = None
    count, first = 0, True
    for number, raw in enumerate(lines, start=1):
        line = raw.strip().lstrip("\ufeff")
        if not line or line.startswith("#"):
            continue
        parts = line.replace(";", ",").split(",")
        if first and not any(map(_is_number, parts)):
            columns, count, first = _header(parts, number), len(parts), False
            continue
        first = False
        at = columns or _usual(len(parts))
        if len(parts) != count if columns else len(parts) not in (3, 4):
            form = f"{count} columns as in the header" if columns else "x,y,value or time,x,y,value"
            raise InvalidInputError(f"line {number}: needed {form}, got {line!r}")
        try:
            x, y, value, time = (None if k is None else float(parts[k]) for k in at)
        except ValueError as error:
            raise InvalidInputError(f"line {number}: needed numbers x,y,value, got {line!r}") from error
        if x is None or y is None or value is None or not all(math.isfinite(v) for v in (x, y, value, time or 0.0)):
            raise InvalidInputError(f"line {number}: needed finite x,y,value or time,x,y,value, got {line!r}")
        yield Sample(x, y, value, time)


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


def _degrees(text: str, hemisphere: str, digits: int, hemispheres: str) -> float:
    degrees, minutes = int(text[:digits]), float(text[digits:])
    value = degrees + minutes / 60.0
    if not (0 <= minutes < 60 and 0 <= value <= (90.0 if digits == 2 else 180.0) and hemisphere in tuple(hemispheres)):
        raise ValueError(text, hemisphere)
    return -value if hemisphere == hemispheres[1] else value


def _position(fields: list[str]) -> tuple[float, float, float | None] | None:
    """Longitude, latitude and seconds of the day of a GGA or RMC sentence; None where it says that it has none."""
    gga = fields[0].endswith("GGA")
    first = 2 if gga else 3
    latitude, north, longitude, east = fields[first : first + 4]
    # Quality of a GGA, status and, from version 2.3 on, mode of an RMC.
    void = fields[6] in ("", "0") if gga else fields[2] != "A" or fields[12:13] == ["N"]
    if void or not latitude or not longitude:
        return None
    clock = fields[1]
    seconds = 3600.0 * int(clock[:2]) + 60.0 * int(clock[2:4]) + float(clock[4:]) if clock else None
    return _degrees(longitude, east, 3, "EW"), _degrees(latitude, north, 2, "NS"), seconds


def read_nmea(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from NMEA 0183: a position (GGA or RMC), then `$PGMAG,<value>*hh`; other sentences are passed over.

    A sentence that declares its position void (GGA of quality 0, RMC of status V) or leaves it empty ends the one
    before: readings are passed over until there is a position again, and so is one that is empty.

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
            if fields[0][-3:] in ("GGA", "RMC"):
                position = _position(fields)
            elif fields[0] == "PGMAG" and position is not None and fields[1]:
                value = float(fields[1])
                if not math.isfinite(value):
                    raise ValueError(fields[1])
                yield Sample(position[0], position[1], value, position[2])
        except (IndexError, ValueError) as error:
            raise InvalidInputError(f"line {number}: needed an NMEA sentence, got {raw.strip()!r}") from error


@dataclass(frozen=True)
class Event:
    """What one sample did to a matcher that `feed` feeds: its status, its fix where it looked for one, whether it begins anew."""

    sample: Sample
    status: str
    fix: Fix | None
    restarted: bool = False


def feed(matcher: Matcher, samples: Iterable[Sample], *, restart: bool = True) -> Iterator[Event]:
    """Feed samples to a streaming matcher, one event a sample, at once; begin anew after a fix or when it is lost.

    A matcher is lost when it says so, with a fix or without one: none of its candidates is left, and no further sample would
    bring one back. An event says where it was begun anew, and the next sample is the first of the new search.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    restart : whether a matcher that has `reset()` begins anew.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.stream import Sample, feed
    >>> x = np.arange(0.0, 3000.0, 50.0)
    >>> grid = geomag.GridMap(90 * np.sin(x / 140)[None, :] + 80 * np.cos(x / 120)[:, None], x, x)
    >>> samples = [Sample(700 + 40 * k, 900 + 30 * k, 1e4) for k in range(3)]
    >>> [(e.status, e.restarted) for e in feed(geomag.Iema(grid, 1.0, 200.0), samples)]
    [('lost', True), ('lost', True), ('lost', True)]
    """
    reset = getattr(matcher, "reset", None) if restart else None
    for sample in samples:
        step = matcher.update(sample.x, sample.y, sample.value)
        fix = step if isinstance(step, Fix) else step.fix
        status = step.status if fix is None else fix.status
        over = reset is not None and status in ("fixed", "lost")
        yield Event(sample, status, fix, over)
        if over and reset is not None:
            reset()


def run(matcher: Matcher, samples: Iterable[Sample], out: TextIO, *, restart: bool = True) -> Fix | None:
    """Feed samples to a streaming matcher and write one JSON line for each; return the last fix that it gave.

    A line has the fields of `Fix.to_dict()`, all but the status null where the matcher did not look for a fix, and
    `restarted` where the matcher was lost and begins anew: see `feed`.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    out : where the lines go; flushed after each.
    restart : whether a matcher that has `reset()` begins anew after a fix or when lost.
    """
    last: Fix | None = None
    for event in feed(matcher, samples, restart=restart):
        fix = event.fix
        line = _nothing(event.status) if fix is None else {k: _plain(v) for k, v in fix.to_dict().items()}
        if event.sample.time_s is not None:
            line["time_s"] = event.sample.time_s
        if event.restarted and event.status == "lost":
            line["restarted"] = True
        out.write(json.dumps(line, allow_nan=False) + "\n")
        out.flush()
        if fix is not None:
            last = fix
    return last


def _nothing(status: str) -> dict[str, object]:
    """The line of a sample without a fix."""
    return {**dict.fromkeys(_FIELDS), "status": status, "ok": False}


def _plain(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
