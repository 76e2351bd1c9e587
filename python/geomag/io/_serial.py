"""Samples from lines as they come: CSV and NMEA 0183. A line that cannot be read is passed over and told; the stream goes on."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from geomag._errors import DataWarning, InvalidInputError, UnknownVariableError
from geomag.io._names import Column, columns_of, coordinate_columns
from geomag.io._numbers import is_decimal_comma, is_missing, is_number, number
from geomag.io._text import is_datum, split_line, without_tail
from geomag.io._times import Clock
from geomag.io._units import field_unit, metres_in, tidy

#: Readings of this size and more, and nines, stand for none; see `_numbers.dummies_of` for whole columns.
_DUMMIES = {99_999.0, -99_999.0, 999_999.0, -999_999.0, -9_999.0, -999.0, 9_999_999.0, -32_768.0}


@dataclass(frozen=True)
class Sample:
    """One reading: indicated position (map units), measured value, time in seconds where it is known.

    `geographic` says whether the position is in degrees, where the stream said so: see `on_map`.
    """

    x: float
    y: float
    value: float
    time_s: float | None = None
    geographic: bool | None = field(default=None, repr=False, compare=False)


def told(text: str) -> None:
    """Say that something was passed over."""
    warnings.warn(text, DataWarning, stacklevel=4)


def _separator(line: str) -> str:
    if ";" in line:
        return ";"
    if "\t" in line:
        return "\t"
    if "," in line:
        fields = line.split()
        comma_decimals = len(fields) in (3, 4) and all(is_decimal_comma(f) or is_number(f) for f in fields)
        return " " if comma_decimals else ","
    return " "


@dataclass(frozen=True)
class _Form:
    """How the lines of a stream are to be read."""

    separator: str
    count: int
    x: int
    y: int
    value: int
    time: int | None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    geographic: bool | None = None
    time_unit: str | None = None


def _usual(separator: str, count: int, line: str, number_: int) -> _Form:
    if count not in (3, 4):
        raise InvalidInputError(
            f"line {number_}: needed x,y,value or time,x,y,value, or a header that names more, got {line!r}"
        )
    return _Form(separator, count, *((0, 1, 2, None) if count == 3 else (1, 2, 3, 0)))


def _named(names: Sequence[str], separator: str, number_: int) -> _Form:
    """Columns of x, y, value and time by a header."""
    columns = columns_of(names)
    where = f"line {number_}: needed columns for x, y and value, got {', '.join(names)}"
    try:
        x, y = coordinate_columns(columns, None, None, where)
    except UnknownVariableError as error:
        raise InvalidInputError(f"{where} ({str(error).removeprefix(where + ': ')})") from error
    values = [c for c in columns if c.kind == "value"]
    if len(values) != 1:
        raise InvalidInputError(f"{where}: {len(values)} of them may be the value")
    value = values[0]
    times = [c for c in columns if c.kind == "time"]
    time: Column | None = times[0] if len(times) == 1 else None
    geographic = None if x.system is None else x.system == "geographic"
    scale_x, scale_y = (1.0 if geographic else metres_in(c.unit, where) for c in (x, y))
    known = field_unit(value.unit)
    return _Form(
        separator, len(names), x.index, y.index, value.index, None if time is None else time.index,
        (scale_x, scale_y, 1.0 if known is None else known[1]), geographic, None if time is None or tidy(time.unit or "utc") in ("utc", "gmt", "local", "gps") else time.unit,
    )  # fmt: skip


def _sample(parts: Sequence[str], form: _Form, clock: Clock, number_: int) -> Sample | str:
    """A sample, or why there is none."""
    if len(parts) != form.count:
        return f"needed {form.count} columns, got {len(parts)}"
    comma = form.separator != ","
    try:
        x, y, value = (number(parts[k], comma) for k in (form.x, form.y, form.value))
    except ValueError as error:
        return f"needed numbers x, y, value, got {error}"
    if not all(map(math.isfinite, (x, y, value))):
        return "needed a position and a value, got none"
    if abs(value) >= 0.99e12 or value in _DUMMIES:
        return f"needed a value, got the dummy {value:g}"
    if form.geographic and (abs(y) > 90.0 or abs(x) > 720.0):
        return f"needed degrees, got x {x:g}, y {y:g}"
    if any(abs(c) >= 0.99e12 for c in (x, y)):
        return f"needed a position, got x {x:g}, y {y:g}"
    seconds = None
    if form.time is not None and not is_missing(parts[form.time]):
        try:
            seconds = clock.seconds(parts[form.time], f"line {number_}")
        except ValueError as error:
            if isinstance(error, InvalidInputError):
                raise
            return f"needed a time, got {parts[form.time]!r}"
    sx, sy, sv = form.scale
    return Sample(x * sx, y * sy, value * sv, seconds, form.geographic)


def read_csv(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from CSV lines `x,y,value` or `time,x,y,value`, or with the columns that a header line names.

    A header is read as `geomag.read_track` reads it: names in any case and order, with units (`Lat (deg)`, `X_km`, `mag_nT`); one whose names do
    not tell x, y and value is refused. A later line that is bad, or has no reading, is passed over and told by a `DataWarning`.

    Raises
    ------
    InvalidInputError
        For a header without x, y or value, or a first line without a header of other than three or four numbers.

    Examples
    --------
    >>> from geomag.stream import read_csv
    >>> list(read_csv(["Lat (deg),Lon (deg),TMI (nT)", "46.95,16.2,12.5"]))
    [Sample(x=16.2, y=46.95, value=12.5, time_s=None)]
    """
    form: _Form | None = None
    clock = Clock()
    for number_, raw in enumerate(lines, start=1):
        line = raw.strip().lstrip("\ufeff").strip("\0")
        if not line or line[0] in "#%":
            continue
        separator = form.separator if form is not None else _separator(line)
        parts = without_tail(split_line(line, separator))
        if form is None:
            if not any(is_datum(p) for p in parts):
                names = [p.strip('"') for p in parts]
                form = _named(names, separator, number_)
                clock = Clock(form.time_unit)
                continue
            form = _usual(separator, len(parts), line, number_)
        found = _sample(parts, form, clock, number_)
        if isinstance(found, str):
            told(f"line {number_} is passed over: {found} in {line[:80]!r}")
            continue
        yield found


#: Sentences with a position.
_POSITIONS = ("GGA", "RMC", "GLL", "GNS")
#: A line may hold several, or half of one before a whole one, or a tag block.
_SENTENCES = re.compile(r"\$[^$\r\n]*")


def _sentence(line: str) -> list[str] | None:
    """Fields of an NMEA sentence whose checksum holds; None for lines that are no sentence, ValueError for a wrong checksum."""
    if not line.startswith("$"):
        return None
    body, star, after = line[1:].partition("*")
    if star:
        checksum = 0
        for byte in body.encode("ascii", "replace"):
            checksum ^= byte
        if after[:2].upper() != f"{checksum:02X}":
            raise ValueError(f"needed checksum {checksum:02X}, got {after[:2]!r}")
    return body.split(",")


def _degrees(text: str, hemisphere: str, digits: int, hemispheres: str) -> float:
    if not (text[:digits].isascii() and text[:digits].isdigit() and is_number(text[digits:])):
        raise ValueError(f"needed degrees and minutes, got {text!r}")
    degrees, minutes = int(text[:digits]), float(text[digits:])
    value = degrees + minutes / 60.0
    if not (0 <= minutes < 60 and 0 <= value <= (90.0 if digits == 2 else 180.0) and hemisphere in tuple(hemispheres)):
        raise ValueError(f"needed degrees and minutes, got {text!r} {hemisphere!r}")
    return -value if hemisphere == hemispheres[1] else value


def _position(fields: list[str]) -> tuple[float, float, float | None] | None:
    """Longitude, latitude and seconds of the day of a sentence with a position; None where it says that it has none."""
    kind = fields[0][-3:]
    first, at = {"GGA": (2, 1), "GNS": (2, 1), "RMC": (3, 1), "GLL": (1, 5)}[kind]
    latitude, north, longitude, east = fields[first : first + 4]
    clock = fields[at]
    if kind == "GGA":
        void = fields[6] in ("", "0")  # its quality
    elif kind == "GNS":
        void = not fields[6].strip("N")  # a mode for every system
    else:
        # Status and, from version 2.3 on, mode.
        void = fields[{"RMC": 2, "GLL": 6}[kind]] != "A" or fields[{"RMC": 12, "GLL": 7}[kind] :][:1] == ["N"]
    if void or not latitude or not longitude:
        return None
    seconds = None
    if clock:
        if not (is_number(clock) and clock[:6].isdigit()):
            raise ValueError(f"needed a time of day, got {clock!r}")
        hours, minutes, rest = int(clock[:2]), int(clock[2:4]), float(clock[4:])
        if hours > 24 or minutes > 59 or rest >= 61:
            raise ValueError(f"needed a time of day, got {clock!r}")
        seconds = 3600.0 * hours + 60.0 * minutes + rest
    return _degrees(longitude, east, 3, "EW"), _degrees(latitude, north, 2, "NS"), seconds


def read_nmea(lines: Iterable[str]) -> Iterator[Sample]:
    """Samples from NMEA 0183: a position (GGA, RMC, GLL or GNS), then `$PGMAG,<value>*hh`; other sentences are passed over.

    A sentence that declares its position void (GGA of quality 0, RMC of status V) or leaves it empty ends the one
    before: readings are passed over until there is a position again, and so is one that is empty. So does a garbled sentence, which is told by a
    `DataWarning`; the stream goes on. Times of day go on over midnight.
    """
    position: tuple[float, float, float | None] | None = None
    clock = Clock()
    silent = False
    for number_, line in (
        (k, sentence) for k, raw in enumerate(lines, start=1) for sentence in _SENTENCES.findall(raw)
    ):
        try:
            fields = _sentence(line.strip())
            if fields is None:
                continue
            if fields[0][-3:] in _POSITIONS:
                position = _position(fields)
                silent = silent and position is None
                if position is not None and position[2] is not None:
                    position = (*position[:2], clock.midnight(position[2]))
            elif fields[0] == "PGMAG" and position is None and fields[1]:
                if not silent:
                    told(
                        f"line {number_} is passed over, as all readings are until there is a position ({', '.join(_POSITIONS)})"
                    )
                silent = True
            elif fields[0] == "PGMAG" and position is not None and fields[1]:
                value = number(fields[1])
                if not math.isfinite(value) or abs(value) >= 0.99e12 or value in _DUMMIES:
                    raise ValueError(f"needed a reading, got {fields[1]!r}")
                yield Sample(position[0], position[1], value, position[2], True)
        except (IndexError, ValueError) as error:
            told(f"line {number_} is passed over: needed an NMEA sentence, got {line[:90]!r} ({error})")
            # Which sentence it was cannot be known: a reading after it must not be laid to an old position.
            if "PGMAG" not in line[:7]:
                position, silent = None, True
