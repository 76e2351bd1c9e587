"""The daily variation and its storms, taken off readings with a base station's record.

The field changes by tens of nanoteslas within a day, as one writes. A base station near the survey, or an observatory, says how: its
record (`read_iaga2002`, or any table) is taken away at the dates of the log, carried to the log's longitude. The regular
daily variation follows local time, so its slow part is taken as much later as the log is further west; what is faster is taken to
be everywhere at once. What is left is told as a standard deviation and a correlation time, for matchers (a bias) and filters (a
bias that walks).

>>> import numpy as np
>>> from geomag.diurnal import BaseRecord
>>> day = np.datetime64("2026-03-01") + np.arange(1440) * np.timedelta64(60, "s")
>>> daily = 25.0 * np.sin(2 * np.pi * np.arange(1440) / 1440)
>>> base = BaseRecord(day, 48_000.0 + daily, longitude=10.0, latitude=47.0)
>>> noon = np.datetime64("2026-03-01T06:00")
>>> round(float(base.variation(noon, 10.0)), 1), round(float(base.variation(noon, 25.0)), 1)
(25.0, 24.2)
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geomag._errors import InvalidInputError, MissingFileError, ReadError, ShapeError, TooFewSamplesError
from geomag.io._numbers import number, plain
from geomag.mainfield import _microseconds

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["BaseRecord", "DiurnalReduction", "IagaRecord", "Removed", "read_iaga2002"]

_EARTH_M = 6_371_200.0
#: From here on a value of IAGA-2002 says that there is none: 99999.00 missing, 88888.00 not recorded.
_IAGA_NONE = 88_888.0
_HOUR_US = 3.6e9
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}", re.ASCII)
_CLOCK = re.compile(r"\d{2}:\d{2}:\d{2}(\.\d{1,9})?", re.ASCII)


@dataclass(frozen=True)
class IagaRecord:
    """An observatory's record as IAGA-2002 has it.

    Attributes
    ----------
    header : dict of str
        Lines of the head by their names: 'Station Name', 'IAGA CODE', 'Reported', ...
    time : array of shape (n,), datetime64[ms], UTC
    components : dict of arrays of shape (n,)
        By their letters, as reported: nT; declination and inclination in minutes of arc; NaN where there is no value.
    longitude, latitude : float
        Degrees, longitude from -180 to 180.
    height_m : float
        Elevation, NaN where it is not said.
    """

    header: dict[str, str]
    time: NDArray[np.datetime64]
    components: dict[str, NDArray[np.float64]]
    longitude: float
    latitude: float
    height_m: float

    def total(self) -> NDArray[np.float64]:
        """Total intensity, nT, shape (n,): of the components where all are there, else as its own instrument has it."""
        c = self.components
        square = None
        if {"X", "Y", "Z"} <= c.keys():
            square = c["X"] ** 2 + c["Y"] ** 2 + c["Z"] ** 2
        elif {"H", "Z"} <= c.keys():
            square = c["H"] ** 2 + c["Z"] ** 2
        own = next((c[k] for k in "FS" if k in c), None)
        if square is None and own is None:
            raise InvalidInputError(f"IAGA-2002: needed X, Y, Z or H, Z or F among the components, got {', '.join(c)}")
        if square is None:
            return np.asarray(own)
        of_components = np.sqrt(square)
        return of_components if own is None else np.where(np.isfinite(of_components), of_components, own)

    def base(self) -> BaseRecord:
        """The record as what `BaseRecord` takes away."""
        return BaseRecord(self.time, self.total(), self.longitude, self.latitude)


def read_iaga2002(path: str | Path) -> IagaRecord:
    r"""Read a file in the format IAGA-2002, as INTERMAGNET and the World Data Centres give them.

    Parameters
    ----------
    path : path
        The file; seconds, minutes or hours.

    Returns
    -------
    IagaRecord

    Raises
    ------
    MissingFileError, ReadError
        Naming the line that does not fit.

    References
    ----------
    IAGA-2002 data exchange format, https://www.ncei.noaa.gov/services/world-data-system/v-dat-working-group/iaga-2002-data-exchange-format

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from geomag.diurnal import read_iaga2002
    >>> head = [("Format", "IAGA-2002"), ("Station Name", "Somewhere"), ("IAGA CODE", "SMW"), ("Geodetic Latitude", "47.0"),
    ...         ("Geodetic Longitude", "10.0"), ("Reported", "XYZF")]
    >>> text = "".join(f" {k:<23}{v:<45}|\n" for k, v in head)
    >>> text += "DATE       TIME         DOY     SMWX      SMWY      SMWZ      SMWF   |\n"
    >>> text += "2026-03-01 00:00:00.000 060     21000.00   1000.00  43000.00  99999.00\n"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "smw.min")
    ...     _ = file.write_text(text)
    ...     record = read_iaga2002(file)
    >>> record.longitude, record.total().round(1)
    (10.0, array([47864.4]))
    """
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"IAGA-2002: needed an existing file, got nothing at {path}")
    lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    header: dict[str, str] = {}
    at = 0
    for at, line in enumerate(lines):
        if line.startswith("DATE"):
            break
        if not line.startswith(" "):
            raise ReadError(f"{path}, line {at + 1}: needed a line of the head of IAGA-2002, got {line[:60]!r}")
        if not line.lstrip().startswith("#"):
            header[line[1:24].strip()] = line[24:69].rstrip("|").strip()
    else:
        raise ReadError(
            f"{path}: needed IAGA-2002 with a line that begins with DATE, got {len(lines)} lines without it"
        )
    columns = lines[at].rstrip("|").split()
    if columns[:3] != ["DATE", "TIME", "DOY"] or len(columns) < 4:
        raise ReadError(f"{path}, line {at + 1}: needed columns DATE, TIME, DOY and components, got {lines[at]!r}")
    names = [c[-1].upper() for c in columns[3:]]
    times, rows = [], []
    for k, line in enumerate(lines[at + 1 :], at + 2):
        words = line.split()
        if not words:
            continue
        try:
            # The converters of Python and NumPy take more than the format has: `1_0`, zones, dates without a day.
            if not (_DAY.fullmatch(words[0]) and _CLOCK.fullmatch(words[1])):
                raise ValueError(line)
            times.append(np.datetime64(f"{words[0]}T{words[1]}", "ms"))
            values = [plain(w) for w in words[3:]]
        except (ValueError, IndexError) as error:
            raise ReadError(f"{path}, line {k}: needed date, time, day and values, got {line[:70]!r}") from error
        if len(values) != len(names):
            raise ReadError(f"{path}, line {k}: needed {len(names)} values ({', '.join(names)}), got {len(values)}")
        rows.append(values)
    if not rows:
        raise ReadError(f"{path}: needed lines of values, got none")
    table = np.array(rows)
    table[table >= _IAGA_NONE] = np.nan
    places = []
    for name in ("Geodetic Latitude", "Geodetic Longitude"):
        try:
            places.append(number(header[name]))
        except (KeyError, ValueError) as error:
            raise ReadError(f"{path}: needed a number as {name}, got {header.get(name)!r}") from error
    try:
        height = number(header.get("Elevation", ""))
    except ValueError:
        height = math.nan
    time = np.array(times)
    if (np.diff(time) <= np.timedelta64(0, "ms")).any():
        k = int(np.argmax(np.diff(time) <= np.timedelta64(0, "ms"))) + 1
        raise ReadError(f"{path}: needed times that rise, got {time[k]} after {time[k - 1]}")
    components = {n: table[:, k] for k, n in enumerate(names)}
    latitude, longitude = places
    return IagaRecord(
        header, time, components, longitude - 360.0 if longitude >= 180.0 else longitude, latitude, height
    )


class Removed(NamedTuple):
    """Readings without the variation, and what is left in them."""

    values: NDArray[np.float64]
    """Readings less the variation, nT, shape (n,)."""
    variation_nt: NDArray[np.float64]
    """The variation that was taken away, nT, shape (n,)."""
    sigma_nt: float
    """Standard deviation of what is left of it, nT: for a matcher the bias, for a filter the bias that walks."""
    correlation_time_s: float
    """Time over which the rest stays alike (to 1/e), seconds."""

    def drift_nt(self, span_s: float) -> float:
        """Standard deviation of what the rest changes by over a time, nT: the drift of the bias over a track so long.

        sigma sqrt(2 (1 - exp(-span / time))), of a process with that standard deviation and correlation time.
        """
        return self.sigma_nt * math.sqrt(2.0 * -math.expm1(-abs(span_s) / self.correlation_time_s))

    def walk_nt_sqrt_s(self) -> float:
        """The same as a random walk, nT per root second: what a filter's bias walks by within the correlation time."""
        return self.sigma_nt * math.sqrt(2.0 / self.correlation_time_s)


@dataclass(frozen=True)
class BaseRecord:
    """The variation of the total intensity at a fixed place.

    For logs within some hundred kilometres. Not for the auroral zone, where nothing at a distance says what happens here.

    Attributes
    ----------
    time : array of shape (n,), n >= 2
        Dates, rising: numpy datetime64, datetimes, pandas timestamps, ISO text; without a time zone in UTC.
    total_nt : array of shape (n,)
        Total intensity, nT; NaN where there is none.
    longitude, latitude : float
        Where, degrees.
    level_nt : float, optional
        What is no variation: the quiet level, which the map goes with. The median of the record by default; a constant
        error here is a bias of the readings.
    max_gap_s : float
        Longest gap that is interpolated over; what lies in a longer one is refused.
    slow_s : float
        Period from which a variation follows local time.
    coherence_m : float
        Distance at which the fast part has nothing in common any more; `residual` against a second station tells.

    Raises
    ------
    ShapeError, TooFewSamplesError, InvalidInputError

    Notes
    -----
    Local time: at longitude l the slow part of date t is that of the base at t + (l - base) / 15 hours, as the Sun has it.
    """

    time: Any
    total_nt: ArrayLike
    longitude: float
    latitude: float
    level_nt: float | None = None
    max_gap_s: float = 600.0
    slow_s: float = 7200.0
    coherence_m: float = 500_000.0
    _us: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _slow: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _fast: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        us = _dates(self.time)
        values = np.asarray(self.total_nt, dtype=float)
        if us.ndim != 1 or values.shape != us.shape:
            raise ShapeError(
                f"base record: needed time and total_nt of one shape (n,), got {us.shape} and {values.shape}"
            )
        if (np.diff(us) <= 0).any():
            raise InvalidInputError(f"base record time[{int(np.argmax(np.diff(us) <= 0)) + 1}]: needed times that rise")
        if not (-360.0 <= self.longitude <= 360.0 and -90.0 <= self.latitude <= 90.0):
            raise InvalidInputError(f"base record: needed a place in degrees, got {self.longitude}, {self.latitude}")
        for name in ("max_gap_s", "slow_s", "coherence_m"):
            if not getattr(self, name) > 0:
                raise InvalidInputError(f"base record {name}: needed a number > 0, got {getattr(self, name)}")
        good = np.isfinite(values)
        if good.sum() < 2:
            raise TooFewSamplesError(f"base record: needed at least 2 values that are numbers, got {int(good.sum())}")
        level = float(np.median(values[good])) if self.level_nt is None else float(self.level_nt)
        slow = _running_mean(us[good] / 1e6, values[good] - level, self.slow_s)
        for name, value in (("_us", us[good]), ("_slow", slow), ("_fast", values[good] - level - slow)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "level_nt", level)

    def _at(self, us: NDArray[np.float64], part: NDArray[np.float64], what: str) -> NDArray[np.float64]:
        own = self._us
        flat = np.atleast_1d(us)
        outside = (flat < own[0]) | (flat > own[-1])
        if outside.any():
            k = int(np.argmax(outside))
            raise InvalidInputError(
                f"{what}[{k}]: needed a date within the base record, {_iso(own[0])} to {_iso(own[-1])}, got {_iso(flat[k])}"
            )
        after = np.clip(np.searchsorted(own, flat), 1, own.size - 1)
        gap = np.where(own[after] == flat, 0.0, own[after] - own[after - 1]) / 1e6
        if (gap > self.max_gap_s).any():
            k = int(np.argmax(gap > self.max_gap_s))
            raise InvalidInputError(
                f"{what}[{k}]: needed a date in no gap of the base record over {self.max_gap_s:g} s, got {_iso(flat[k])} in one "
                f"of {gap[k]:g} s"
            )
        return np.asarray(np.interp(us, own, part))

    def variation(self, date: Any, longitude: ArrayLike) -> NDArray[np.float64]:  # noqa: ANN401 - any kind of date
        """The variation at dates and longitudes, nT; arrays broadcast.

        Raises
        ------
        InvalidInputError
            For a date off the record or in a gap of it; a log far to the east needs the record to go on later.
        """
        us, lon = np.broadcast_arrays(_dates(date), np.asarray(longitude, dtype=float))
        east = (lon - self.longitude + 180.0) % 360.0 - 180.0
        slow = self._at(us + east / 15.0 * _HOUR_US, self._slow, "date, in the base's local time,")
        return slow + self._at(us, self._fast, "date")

    def remove(
        self,
        date: Any,  # noqa: ANN401 - any kind of date
        longitude: ArrayLike,
        latitude: ArrayLike,
        reading_nt: ArrayLike,
    ) -> Removed:
        """Take the variation off readings.

        The rest is estimated from the record: where the log lies east or west, what it matters whether the slow part follows
        local or universal time, since storms do the latter; and of the fast part the share that the distance has grown to.

        Parameters
        ----------
        date : array of shape (n,)
            Dates of the readings.
        longitude, latitude : arrays of shape (n,), or numbers
            Where, degrees.
        reading_nt : array of shape (n,)
            Total intensity or anomaly, nT.

        Returns
        -------
        Removed

        Raises
        ------
        InvalidInputError, ShapeError

        Examples
        --------
        >>> import numpy as np
        >>> from geomag.diurnal import BaseRecord
        >>> day = np.datetime64("2026-03-01") + np.arange(1440) * np.timedelta64(60, "s")
        >>> daily = 25.0 * np.sin(2 * np.pi * np.arange(1440) / 1440)
        >>> base = BaseRecord(day, 48_000.0 + daily, longitude=10.0, latitude=47.0)
        >>> log = day[400:700:10]
        >>> off = base.remove(log, 10.2, 47.1, 30.0 + base.variation(log, 10.2))
        >>> off.values.round(6).max(), off.sigma_nt < 1.0
        (np.float64(30.0), True)
        """
        us = _dates(date)
        reading = np.asarray(reading_nt, dtype=float)
        if us.ndim != 1 or reading.shape != us.shape:
            raise ShapeError(
                f"diurnal: needed dates and readings of one shape (n,), got {us.shape} and {reading.shape}"
            )
        lon, lat = (np.broadcast_to(np.asarray(a, dtype=float), us.shape) for a in (longitude, latitude))
        variation = self.variation(date, lon)
        doubt = self._at(us, self._slow, "date") + self._at(us, self._fast, "date") - variation
        away = float(np.mean(_distance_m(self.longitude, self.latitude, lon, lat)))
        fast = min(1.0, away / self.coherence_m) * self._fast
        sigma = float(np.hypot(np.sqrt(np.mean(doubt**2)), np.std(fast)))
        tau = _correlation_time(self._us / 1e6, self._slow if np.std(doubt) > np.std(fast) else fast)
        return Removed(reading - variation, variation, sigma, tau)

    def residual(self, other: BaseRecord) -> tuple[float, float]:
        """Standard deviation (nT) and correlation time (s) of what this record leaves on another station's.

        The measured size of what a log at that distance is left with.
        """
        us = other._us
        shift = ((other.longitude - self.longitude + 180.0) % 360.0 - 180.0) / 15.0 * _HOUR_US
        own = self._us
        shared = (us >= max(own[0], own[0] - shift)) & (us <= min(own[-1], own[-1] - shift))
        if shared.sum() < 3:
            raise TooFewSamplesError(f"residual: needed at least 3 dates on both records, got {int(shared.sum())}")
        dates = us[shared].astype("int64").astype("datetime64[us]")
        theirs = other._slow[shared] + other._fast[shared]
        left = theirs - self.variation(dates, other.longitude)
        left = left - left.mean()
        return float(np.std(left)), _correlation_time(us[shared] / 1e6, left)


@dataclass(frozen=True)
class DiurnalReduction:
    """The variation as a `geomag.reduction.Reduction`: to be taken off again at matched positions.

    Parameters
    ----------
    base : BaseRecord
    date : dates of the samples, shape (n,), or one for all
    """

    base: BaseRecord
    date: Any

    def correction(
        self, longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Minus the variation, nT."""
        del latitude, time_s
        return -self.base.variation(self.date, longitude)


def _dates(date: Any) -> NDArray[np.float64]:  # noqa: ANN401 - any kind of date
    us = _microseconds(date)
    if us is None:
        raise InvalidInputError("date: needed dates (datetime, numpy datetime64, ISO text), got plain numbers")
    return us


def _iso(us: float) -> str:
    return str(np.datetime64(round(us / 1e6), "s"))


def _running_mean(time_s: NDArray[np.float64], values: NDArray[np.float64], width_s: float) -> NDArray[np.float64]:
    """Straight line through what lies within half a width: at the ends of the record too it follows a slope."""
    low = np.searchsorted(time_s, time_s - 0.5 * width_s)
    high = np.searchsorted(time_s, time_s + 0.5 * width_s, side="right")
    t = time_s - time_s[0]
    sums = [np.concatenate([[0.0], np.cumsum(a)]) for a in (np.ones_like(t), t, values, t * t, t * values)]
    n, st, sv, stt, stv = (s[high] - s[low] for s in sums)
    mean_t, mean_v = st / n, sv / n
    spread = stt / n - mean_t**2
    slope = np.where(spread > 1e-9 * width_s**2, (stv / n - mean_t * mean_v) / np.maximum(spread, 1e-300), 0.0)
    return np.asarray(mean_v + slope * (t - mean_t))


def _correlation_time(time_s: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Lag at which the correlation of a series falls to 1/e, seconds; all of it where it does not."""
    step = float(np.median(np.diff(time_s)))
    grid = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    v = np.interp(grid, time_s, values)
    v = v - v.mean()
    power = float(v @ v)
    if not power > 0:
        return float(time_s[-1] - time_s[0])
    spectrum = np.abs(np.fft.rfft(v, 2 * v.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: v.size] / power
    below = np.flatnonzero(correlation < math.exp(-1.0))
    return float(step * below[0]) if below.size else float(time_s[-1] - time_s[0])


def _distance_m(
    longitude: float, latitude: float, lon: NDArray[np.float64], lat: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Great circle, metres."""
    a, b, turn = np.radians(latitude), np.radians(lat), np.radians(lon - longitude)
    half = np.sin(0.5 * (b - a)) ** 2 + np.cos(a) * np.cos(b) * np.sin(0.5 * turn) ** 2
    return np.asarray(2.0 * _EARTH_M * np.arcsin(np.sqrt(np.minimum(half, 1.0))))
