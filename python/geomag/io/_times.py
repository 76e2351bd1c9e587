"""Times of a log: ISO dates, day or month first, times of day over midnight, seconds and their fractions since any epoch."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomag._errors import TimeError
from geomag.io._numbers import plain
from geomag.io._units import SECONDS, tidy

Array = NDArray[np.float64]
Ask = Callable[[str], TimeError]

_DAY = 86_400.0
_CLOCK = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d+))?)?\s*([AaPp]\.?[Mm]\.?)?"
_ZONE = r"\s*(Z|z|UTC|GMT|[+-]\d{2}:?\d{2}|[+-]\d{2})?"
_ISO = re.compile(rf"(\d{{4}})([-/.]?)(\d{{2}})\2(\d{{2}})(?:[T\s]+{_CLOCK}{_ZONE})?$")
_ISO_SHORT = re.compile(r"(\d{4})(\d{2})(\d{2})T(\d{2})(\d{2})(\d{2})(?:[.,](\d+))?(Z)?$")
_ORDINAL = re.compile(rf"(\d{{4}})-(\d{{3}})(?:[T\s]+{_CLOCK}{_ZONE})?$")
_NUMBERS = re.compile(rf"(\d{{1,2}})([-/.])(\d{{1,2}})\2(\d{{4}})(?:[T,\s]+{_CLOCK}{_ZONE})?$")
_NAMED = re.compile(rf"(\d{{1,2}})[-\s/]([A-Za-z]{{3,9}})[-\s/](\d{{4}})(?:[T,\s]+{_CLOCK}{_ZONE})?$")
_TIME_OF_DAY = re.compile(rf"{_CLOCK}{_ZONE}$")
_MONTHS = {
    m: k for k, m in enumerate(("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"), 1)
}
#: Units of numbers since 1970, by the range in which years 2000 to 2100 lie.
_EPOCHS = ((9.46e8, 4.2e9, "s"), (9.46e11, 4.2e12, "ms"), (9.46e14, 4.2e15, "us"), (9.46e17, 4.2e18, "ns"))
#: Slower than this over ground, m/s, or faster, and numbers are no seconds.
_SLOWEST_M_S, _FASTEST_M_S = 0.15, 20_000.0


def looks_like_time(text: str) -> bool:
    """Whether a field of a table is a date or a time of day."""
    return any(p.match(text) for p in (_ISO_SHORT, _NUMBERS, _NAMED, _TIME_OF_DAY)) or (
        not text.isdigit() and (_ISO.match(text) is not None or _ORDINAL.match(text) is not None)
    )


def _clock(hour: str, minute: str, second: str | None, fraction: str | None, half: str | None) -> float:
    h, m, s = int(hour), int(minute), int(second or 0)
    if half:
        if not 1 <= h <= 12:
            raise ValueError(hour)
        h = h % 12 + (12 if half[0] in "Pp" else 0)
    if h > 24 or m > 59 or s > 60:
        raise ValueError(hour, minute, second)
    return 3600.0 * h + 60.0 * m + s + (float(f"0.{fraction}") if fraction else 0.0)


def _zone(text: str | None) -> float | None:
    """Seconds east of Greenwich; None where a time has no zone."""
    if not text:
        return None
    if text[0] not in "+-":
        return 0.0
    digits = text[1:].replace(":", "")
    return (1 if text[0] == "+" else -1) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:] or 0))


def _date(year: int, month: int, day: int) -> float:
    return (dt.date(year, month, day).toordinal() - 719_163) * _DAY


Parsed = tuple[float, float | None, bool]  # seconds, zone, whether it is a date


def _dated(day: float, groups: Sequence[str | None]) -> Parsed:
    """Seconds since 1970, with a time of day that may be left out."""
    if groups[0] is None:
        return day, None, True
    zone = _zone(groups[5])
    return day + _clock(*groups[:5]) - (zone or 0.0), zone, True  # type: ignore[arg-type]


def _parse(text: str, day_first: bool) -> Parsed:
    if found := _ISO_SHORT.match(text):
        g = found.groups()
        return (
            _date(int(g[0]), int(g[1]), int(g[2])) + _clock(g[3], g[4], g[5], g[6], None),
            0.0 if g[7] else None,
            True,
        )
    if found := _ISO.match(text):
        g = found.groups()
        return _dated(_date(int(g[0]), int(g[2]), int(g[3])), g[4:])
    if found := _ORDINAL.match(text):
        g = found.groups()
        return _dated(_date(int(g[0]), 1, 1) + (int(g[1]) - 1) * _DAY, g[2:])
    if found := _NUMBERS.match(text):
        g = found.groups()
        day, month = (int(g[0]), int(g[2])) if day_first or g[1] == "." else (int(g[2]), int(g[0]))
        return _dated(_date(int(g[3]), month, day), g[4:])
    if found := _NAMED.match(text):
        g = found.groups()
        return _dated(_date(int(g[2]), _MONTHS[g[1][:3].lower()], int(g[0])), g[3:])
    if found := _TIME_OF_DAY.match(text):
        g = found.groups()
        return _clock(*g[:5]), _zone(g[5]), False
    raise ValueError(text)


def _all(texts: Sequence[str], day_first: bool) -> list[Parsed] | None:
    try:
        return [_parse(t, day_first) for t in texts]
    except (ValueError, KeyError):
        return None


def _relative(parsed: list[Parsed], where: str) -> Array:
    """Seconds since the first; times of day go on over midnight."""
    kinds = {p[2] for p in parsed}
    if len(kinds) > 1:
        raise TimeError(f"{where}: needed dates throughout, or times of day throughout, got both")
    zones = {p[1] is None for p in parsed}
    if len(zones) > 1:
        raise TimeError(f"{where}: needed a time zone at every time or at none, got both")
    seconds = np.array([p[0] for p in parsed])
    return np.asarray((over_midnight(seconds) if kinds == {False} else seconds) - seconds[0])


def over_midnight(seconds: Array) -> Array:
    """Times of day made to go on over midnight: a fall of more than half a day is a new day."""
    return np.asarray(seconds + _DAY * np.cumsum(np.concatenate([[0], np.diff(seconds) < -0.5 * _DAY])))


def _rising(t: Array) -> bool:
    return bool(np.all(np.diff(t) >= 0))


def dates_from_text(texts: Sequence[str], where: str) -> NDArray[np.datetime64]:
    """Dates in UTC of texts that are dates, day first where it has to be; a time without a zone is in UTC.

    Raises `TimeError` for what is no date: times of day alone, or dates that can be read in two ways.
    """
    texts = [t.strip().strip('"') for t in texts]
    seconds = from_text(texts, where)
    readings = [some for some in (_all(texts, True), _all(texts, False)) if some is not None]
    if seconds is None or not readings or not readings[0][0][2]:
        raise TimeError(f"{where}: needed dates (YYYY-MM-DDThh:mm:ss), got '{texts[0]}'")
    right = next(some for some in readings if np.array_equal(np.array([p[0] for p in some]) - some[0][0], seconds))
    return _as_dates(np.array([p[0] for p in right]))


def dates_from_numbers(numbers: Array, unit: str | None, where: str) -> NDArray[np.datetime64]:
    """Dates in UTC of numbers since 1970, whose unit their size tells.

    Raises `TimeError` for numbers that count from elsewhere.
    """
    for low, high, name in _EPOCHS:
        if low <= float(numbers.min()) and float(numbers.max()) <= high and (unit is None or tidy(unit) == name):
            return _as_dates(_scaled(numbers, SECONDS[name]))
    raise TimeError(f"{where}: needed dates, or seconds (ms, us, ns) since 1970, got {numbers[0]:.15g}; give one date")


def _as_dates(seconds: Array) -> NDArray[np.datetime64]:
    return np.round(seconds * 1e6).astype("int64").astype("datetime64[us]")


def from_text(texts: Sequence[str], where: str) -> Array | None:
    """Seconds since the first of dates or times of day; None for what is neither.

    Raises `TimeError` for dates that can be read day first and month first with different results.
    """
    texts = [t.strip().strip('"') for t in texts]
    day_first = _all(texts, True)
    month_first = _all(texts, False) if any(_NUMBERS.match(t) for t in texts) else None
    if day_first is None and month_first is None:
        return None
    if day_first is None or month_first is None:
        return _relative(day_first or month_first or [], where)
    one, other = _relative(day_first, where), _relative(month_first, where)
    if np.array_equal(one, other):
        return one
    # A log goes forward without leaps: where one reading has a leap of weeks and the other runs on, it is the other.
    runs = [_rising(t) and float(np.diff(t).max(initial=0.0)) <= _DAY for t in (one, other)]
    if runs[0] != runs[1]:
        return one if runs[0] else other
    raise TimeError(
        f"{where}: needed dates that can be read in one way, got '{texts[0]}' to '{texts[-1]}', which may be day first or month "
        "first; write them as YYYY-MM-DD, or read without times (time=False)"
    )


def _hhmmss(numbers: Array, seconds: bool) -> Array | None:
    """Numbers such as 235959.5, or 2359 without seconds, as times of day; None where they cannot be."""
    whole = numbers if seconds else numbers * 100.0
    h, m, s = np.floor(whole / 10_000), np.floor(whole / 100) % 100, whole % 100
    good = (numbers >= 0) & (h < 24) & (m < 60) & (s < 60)
    if not seconds:
        h, m, s = np.floor(numbers / 100), np.floor(numbers % 100), 60.0 * (numbers % 1)
    return np.asarray(3600 * h + 60 * m + s) if good.all() else None


def from_numbers(numbers: Array, unit: str | None, where: str, step_m: Array | None = None) -> Array:
    """Seconds of numbers in a unit, or by their size since 1970; where they cannot be seconds the unit is asked for.

    `step_m` are the distances between neighbours, metres: they tell milliseconds from seconds.
    """
    if unit is not None:
        if tidy(unit) in ("hhmmss", "hhmm"):
            clock = _hhmmss(numbers, tidy(unit) == "hhmmss")
            if clock is None:
                raise TimeError(f"{where}: needed times as {tidy(unit)}, got {numbers[0]:g} to {numbers[-1]:g}")
            return over_midnight(clock)
        if tidy(unit) not in SECONDS:
            raise TimeError(
                f"{where}: needed a unit of time (s, ms, us, ns, min, h, days, hhmm or hhmmss), got {unit!r}"
            )
        return _scaled(numbers, SECONDS[tidy(unit)])
    for low, high, name in _EPOCHS:
        if low <= float(numbers.min()) and float(numbers.max()) <= high and name != "s":
            return _scaled(numbers, SECONDS[name])
    ask = _asked(where, numbers)
    if not _rising(numbers):
        falls = np.flatnonzero(np.diff(numbers) < 0)
        if len(falls) <= max(1, len(numbers) // 1000) and _hhmmss(numbers, True) is None and numbers.max() <= _DAY:
            return over_midnight(numbers) if np.all(np.diff(numbers)[falls] < -0.5 * _DAY) else numbers
        if np.all(np.diff(numbers)[falls] < -0.5 * _DAY) and numbers.min() >= 0 and numbers.max() < _DAY:
            return over_midnight(numbers)
        raise ask("they fall")
    steps = np.diff(numbers)
    for seconds in (True, False):
        clock = _hhmmss(numbers, seconds)
        if clock is not None and len(steps) > 1 and float(steps.max()) > 0:
            raw = float(steps.max()) / max(float(np.median(steps)), 1e-9)
            told = np.diff(clock)
            if raw > 1.5 and _rising(clock) and float(told.max()) <= 1.01 * max(float(np.median(told)), 1e-9):
                raise ask(f"they would run evenly as {'hhmmss' if seconds else 'hhmm'}")
    if not len(steps):
        return numbers
    if float(np.median(steps)) > _DAY:
        raise ask(f"they are {np.median(steps):g} apart")
    if step_m is not None and float(np.median(step_m)) > 0 and float(np.median(steps)) > 0:
        speed = float(np.median(step_m)) / float(np.median(steps))
        if not _SLOWEST_M_S <= speed <= _FASTEST_M_S:
            raise ask(f"as seconds they make a speed of {speed:.3g} m/s")
    return numbers


def _asked(where: str, numbers: Array) -> Ask:
    def ask(why: str) -> TimeError:
        return TimeError(
            f"{where}: needed times in seconds, got {numbers[0]:.15g} to {numbers[-1]:.15g}, which cannot be ({why}); give "
            "time_unit= (s, ms, us, ns, min, h, days, hhmm or hhmmss), or read without times (time=False)"
        )

    return ask


def _scaled(numbers: Array, factor: float) -> Array:
    """Numbers times a factor, divided where that is exact."""
    return np.asarray(numbers / round(1.0 / factor) if factor < 1.0 else numbers * factor)


def from_stamps(stamps: Any) -> Array:  # noqa: ANN401 - a pandas Series of dates
    """Seconds since the first of a data frame's own dates."""
    return np.asarray((stamps - stamps.iloc[0]).dt.total_seconds(), dtype=np.float64)


class Clock:
    """Times that come one by one, as seconds: numbers as they stand, dates since the first, times of day on over midnight."""

    def __init__(self, unit: str | None = None) -> None:
        self._unit = unit
        self._first: float | None = None
        self._last: float | None = None
        self._days = 0.0

    def midnight(self, seconds: float) -> float:
        """A time of day, a day later for every midnight that has gone by."""
        if self._last is not None and seconds < self._last - 0.5 * _DAY:
            self._days += _DAY
        self._last = seconds
        return seconds + self._days

    def seconds(self, text: str, where: str) -> float:
        """Seconds of one field; ValueError for what is no time, TimeError for a date with two readings."""
        text = text.strip().strip('"')
        try:
            given = plain(text)
        except ValueError:
            return self._of_text(text, where)
        if not np.isfinite(given):
            raise ValueError(text)
        if self._unit is not None:
            return (
                self.midnight(float(from_numbers(np.array([given]), self._unit, where)[0]))
                if tidy(self._unit).startswith("hhmm")
                else float(from_numbers(np.array([given]), self._unit, where)[0])
            )
        for low, high, name in _EPOCHS:
            if low <= given <= high and name != "s":
                return float(_scaled(np.array([given]), SECONDS[name])[0])
        return given

    def _of_text(self, text: str, where: str) -> float:
        one, other = _all([text], True), _all([text], False)
        if one is None and other is None:
            raise ValueError(text)
        if one is not None and other is not None and one != other:
            raise TimeError(
                f"{where}: needed dates that can be read in one way, got '{text}'; write them as YYYY-MM-DD"
            )
        seconds, _, dated = (one or other or [])[0]
        if not dated:
            return self.midnight(seconds)
        self._first = seconds if self._first is None else self._first
        return seconds - self._first
