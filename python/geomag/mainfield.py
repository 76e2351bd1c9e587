"""The main field of the Earth: IGRF-14, WMM2025 and WMMHR2025 behind one interface.

A magnetometer reads some 50,000 nT of main field under every anomaly. `load` brings a model by its name, `MainField.field` and
`MainField.total` evaluate it: places on WGS84, a date for every sample, a whole day of log in one call. What to take off raw
readings before they are matched is in `geomag.reduction.MagneticReduction`.

IGRF-14 comes with ppigrf, WMM2025 with wmm-calculator, WMMHR2025 with wmmhr (`pip install 'geomag-nav[field]'`); any other file of
coefficients in the formats .shc, .COF or IGRF's own table comes by its path. Coefficients alone are taken from there: the sums are
ours, since a date a sample and degree 133 over a day of log are asked for in one call. They meet the official test values
of WMM2025 and WMMHR2025 to 0.1 nT (`tests/test_mainfield.py`).

>>> import datetime
>>> from geomag.mainfield import load
>>> igrf = load("igrf14")
>>> when = datetime.datetime(2026, 6, 1, tzinfo=datetime.timezone.utc)
>>> round(float(igrf.total(10.0, 45.0, 600.0, when)), 2)
47724.82
"""

from __future__ import annotations

import datetime
import gzip
import importlib.resources
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError, MissingDependencyError, MissingFileError, ReadError
from geomag._geomag import MainFieldModel

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

__all__ = ["MODELS", "MainField", "MainFieldModel", "decimal_year", "load", "main_field"]

#: Where the coefficients of a name come from: package, what to install, file.
_SOURCES = {
    "igrf14": ("ppigrf", "ppigrf", "IGRF14.shc"),
    "wmm2025": ("wmm", "wmm-calculator", "coefs/WMM.COF"),
    "wmmhr2025": ("wmmhr", "wmmhr", "coefs/WMMHR.COF"),
}

#: Names that `load` knows.
MODELS = tuple(_SOURCES)

_EPOCH = np.datetime64("1970-01-01T00:00:00", "us")
_DAY_US = 86_400_000_000.0


def _microseconds(date: Any) -> NDArray[np.float64] | None:  # noqa: ANN401 - any kind of date
    """Dates as microseconds since 1970 in UTC, or None where they are numbers."""
    array = np.asarray(date)
    if array.dtype.kind == "M":
        if np.isnat(array).any():
            at = int(np.argmax(np.isnat(array)))
            raise InvalidInputError(f"date[{at}]: needed a date, got NaT")
        return (array.astype("datetime64[us]") - _EPOCH) / np.timedelta64(1, "us")
    if array.dtype.kind in "fiu":
        return None
    if array.dtype.kind not in "OUS":
        raise InvalidInputError(f"date: needed dates or decimal years, got {array.dtype}")
    flat = [_one_date(value, k) for k, value in enumerate(array.ravel())]
    return np.array(flat, dtype=float).reshape(array.shape)


def _one_date(value: Any, k: int) -> float:  # noqa: ANN401 - any kind of date
    if isinstance(value, (bytes, str)):
        text = value.decode() if isinstance(value, bytes) else value
        try:
            value = datetime.datetime.fromisoformat(text.strip())
        except ValueError as error:
            raise InvalidInputError(f"date[{k}]: needed a date in ISO 8601, got {text!r}") from error
    elif isinstance(value, np.datetime64):
        value = value.astype("datetime64[us]").item()
    elif isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        value = datetime.datetime(value.year, value.month, value.day)
    if not isinstance(value, datetime.datetime) or value != value:  # noqa: PLR0124 - pandas' NaT is no date
        raise InvalidInputError(f"date[{k}]: needed a date or a decimal year, got {value!r}")
    if value.tzinfo is not None:
        value = value.astimezone(datetime.UTC).replace(tzinfo=None)
    return float((np.datetime64(value, "us") - _EPOCH) / np.timedelta64(1, "us"))


def decimal_year(date: ArrayLike | datetime.date | datetime.datetime) -> NDArray[np.float64]:
    """Dates as decimal years: the year, and the share of it that is over.

    Parameters
    ----------
    date : date, datetime, ISO text, numpy datetime64, pandas timestamps or decimal years, one or an array
        A time zone is heeded; without one a date is in UTC. Numbers are decimal years already.

    Returns
    -------
    array of the shape of `date`

    Raises
    ------
    InvalidInputError
        For what is no date, naming the first.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.mainfield import decimal_year
    >>> decimal_year(np.array(["2026-01-01", "2026-07-02T12:00"], dtype="datetime64[m]"))
    array([2026. , 2026.5])
    """
    us = _microseconds(date)
    if us is None:
        return np.asarray(date, dtype=float)
    stamps = _EPOCH + us.astype("int64").astype("timedelta64[us]")
    year = stamps.astype("datetime64[Y]")
    start, end = (y.astype("datetime64[us]") for y in (year, year + np.timedelta64(1, "Y")))
    return np.asarray(year.astype(int) + 1970 + (stamps - start) / (end - start))


@dataclass(frozen=True)
class MainField:
    """A model of the main field, evaluated where and when one likes within its years.

    For taking the main field off readings, and for the direction of the field along a flight. Not for the crust: IGRF and WMM
    end at wavelengths of 3,000 km, WMMHR at 300 km, whose crustal part is also in an anomaly map, so that a map reduced by
    IGRF wants readings reduced by IGRF.

    Attributes
    ----------
    name : what it was loaded by
    model : MainFieldModel
        Its coefficients.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.mainfield import load
    >>> igrf = load("igrf14")
    >>> day = np.datetime64("2026-03-01") + np.arange(0, 86_400, 600) * np.timedelta64(1, "s")
    >>> igrf.field(np.linspace(5, 12, day.size), 48.0, 1000.0, day).shape
    (144, 3)
    """

    name: str
    model: MainFieldModel

    @property
    def degree(self) -> int:
        """Highest degree."""
        return self.model.degree

    @property
    def years(self) -> tuple[float, float]:
        """First and last decimal year that it is for."""
        return float(self.model.epochs[0]), float(self.model.epochs[-1])

    def _years(self, date: Any) -> NDArray[np.float64]:  # noqa: ANN401 - any kind of date
        """Dates on the model's scale: linear in days between its epochs, as its coefficients are."""
        us = _microseconds(date)
        first, last = self.years
        if us is None:
            years = np.asarray(date, dtype=float)
        else:
            epochs = self.model.epochs
            days = np.array([_one_date(datetime.date(int(e), 1, 1), 0) for e in epochs]) / _DAY_US
            days += (epochs - np.floor(epochs)) * 365.25
            at = us / _DAY_US
            years = np.interp(at, days, epochs, left=np.nan, right=np.nan)
            years = np.where(np.isnan(years), decimal_year(date), years)
            # A date outside stays outside, whatever its decimal year rounds to.
            years = np.where(at < days[0], np.minimum(years, np.nextafter(first, -np.inf)), years)
            years = np.where(at > days[-1], np.maximum(years, np.nextafter(last, np.inf)), years)
        flat = np.atleast_1d(years).ravel()
        outside = ~((flat >= first) & (flat <= last))
        if outside.any():
            at_ = int(np.argmax(outside))
            where = f"date[{at_}]" if flat.size > 1 else "date"
            raise InvalidInputError(
                f"{where}: needed a date within the years of {self.name}, {first:g} to {last:g}, got {_said(date, at_, flat)}"
            )
        return years

    def field(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        height_m: ArrayLike,
        date: Any,  # noqa: ANN401 - any kind of date
    ) -> NDArray[np.float64]:
        """North, east and down component of the main field, nT.

        Parameters
        ----------
        longitude, latitude : arrays
            Degrees, WGS84.
        height_m : array
            Height above the ellipsoid, metres.
        date : date, datetime, ISO text, numpy datetime64, pandas timestamps or decimal years
            One, or one a sample. A time zone is heeded; without one a date is in UTC. Everything broadcasts.

        Returns
        -------
        array of shape (..., 3)

        Raises
        ------
        InvalidInputError
            For a date outside the model's years, a latitude beyond a pole; NotFiniteError, ShapeError.
        """
        return np.asarray(self.model.field(longitude, latitude, height_m, self._years(date)))

    def total(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        height_m: ArrayLike,
        date: Any,  # noqa: ANN401 - any kind of date
    ) -> NDArray[np.float64]:
        """Total intensity of the main field, nT; arguments as of `field`."""
        return np.asarray(np.linalg.norm(self.field(longitude, latitude, height_m, date), axis=-1))

    def declination_inclination_deg(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        height_m: ArrayLike,
        date: Any,  # noqa: ANN401 - any kind of date
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Declination (east of north) and inclination (down), degrees; arguments as of `field`."""
        north, east, down = np.moveaxis(self.field(longitude, latitude, height_m, date), -1, 0)
        return np.degrees(np.arctan2(east, north)), np.degrees(np.arctan2(down, np.hypot(north, east)))


def _said(date: Any, at: int, years: NDArray[np.float64]) -> str:  # noqa: ANN401 - any kind of date
    flat = np.asarray(date).ravel()
    given = flat[at if flat.size > 1 else 0]
    return f"{given}" if flat.dtype.kind not in "fiu" else f"{float(years[at]):.4f}"


def load(name: str = "igrf14", path: str | Path | None = None) -> MainField:
    """A model of the main field by its name, or from a file of coefficients.

    Parameters
    ----------
    name : {'igrf14', 'wmm2025', 'wmmhr2025'}
        Which model; with `path`, what to call it.
    path : path, optional
        A file in the format .shc, .COF or of IGRF's own table, plain or gzipped, instead of an installed one.

    Returns
    -------
    MainField

    Raises
    ------
    InvalidInputError, MissingDependencyError, MissingFileError, ReadError

    Examples
    --------
    >>> from geomag.mainfield import load
    >>> load("igrf14").years
    (1900.0, 2030.0)
    """
    if path is not None:
        return MainField(name, _read(Path(path)))
    if name not in _SOURCES:
        raise InvalidInputError(
            f"main field: needed one of {', '.join(MODELS)}, or a path to coefficients, got {name!r}"
        )
    return _installed(name)


@cache
def _installed(name: str) -> MainField:
    package, distribution, file = _SOURCES[name]
    try:
        resource = importlib.resources.files(package).joinpath(file)
    except ImportError as error:
        raise MissingDependencyError(
            f"main field {name}: needed the coefficients that '{distribution}' brings, which is not installed ({error}); "
            f"install it with: pip install 'geomag-nav[field]', or pass path= to a file of coefficients"
        ) from error
    with importlib.resources.as_file(resource) as path:
        if not path.exists():
            raise MissingDependencyError(
                f"main field {name}: needed {file} in '{distribution}', got a version without it; pass path= to a file"
            )
        found = MainField(name, _read(path))
    wanted = {"igrf14": (1900.0, 2030.0), "wmm2025": (2025.0, 2030.0), "wmmhr2025": (2025.0, 2030.0)}[name]
    if found.years != wanted:
        raise MissingDependencyError(
            f"main field {name}: needed coefficients for {wanted[0]:g} to {wanted[1]:g}, got {found.years} in the "
            f"installed '{distribution}'; pass path= to a file"
        )
    return found


def main_field(
    name: str,
    longitude: ArrayLike,
    latitude: ArrayLike,
    height_m: ArrayLike,
    date: Any,  # noqa: ANN401 - any kind of date
) -> NDArray[np.float64]:
    """North, east and down component of a model by its name, nT, shape (..., 3): `load(name).field(...)`.

    >>> from geomag.mainfield import main_field
    >>> main_field("igrf14", 10.0, 45.0, 600.0, 2025.0).round()
    array([22837.,  1450., 41812.])
    """
    return load(name).field(longitude, latitude, height_m, date)


def _read(path: Path) -> MainFieldModel:
    if not path.exists():
        raise MissingFileError(f"main field: needed an existing file of coefficients, got nothing at {path}")
    raw = path.read_bytes()
    try:
        text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode("ascii")
        lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
        if not lines:
            raise ValueError("no line of numbers")
        words = lines[0].split()
        if words[0] == "c/s":
            return _igrf_table(lines)
        return _shc(lines) if len(words) >= 5 else _cof(lines)
    except (UnicodeDecodeError, ValueError, IndexError, OSError, EOFError) as error:
        raise ReadError(f"{path}: needed coefficients as .shc, .COF or IGRF's table, got: {error}") from error


class _Table:
    """Coefficients by epoch and pair, filled one by one."""

    def __init__(self, epochs: list[float], degree: int) -> None:
        self.epochs, self.degree = epochs, degree
        self.g, self.h = (np.zeros((len(epochs), (degree + 1) * (degree + 2) // 2 - 1)) for _ in "gh")
        self.met: set[tuple[int, int]] = set()

    def put(self, n: int, m: int, values: list[float]) -> None:
        """Values of one coefficient, an epoch each; h has a negative order."""
        if not (1 <= n <= self.degree and abs(m) <= n) or len(values) != len(self.epochs):
            raise ValueError(f"degree {n}, order {m} with {len(values)} values")
        (self.g if m >= 0 else self.h)[:, n * (n + 1) // 2 + abs(m) - 1] = values
        self.met.add((n, m))

    def model(self) -> MainFieldModel:
        wanted = sum(2 * n + 1 for n in range(1, self.degree + 1))
        if len(self.met) != wanted:
            raise ValueError(f"{len(self.met)} coefficients of {wanted} up to degree {self.degree}")
        return MainFieldModel(self.epochs, self.g, self.h, degree=self.degree)


def _shc(lines: list[str]) -> MainFieldModel:
    lowest, degree, count = (int(w) for w in lines[0].split()[:3])
    epochs = [float(w) for w in lines[1].split()]
    if lowest != 1 or len(epochs) != count:
        raise ValueError(f"degree from {lowest}, {len(epochs)} epochs of {count}")
    table = _Table(epochs, degree)
    for line in lines[2:]:
        words = line.split()
        table.put(int(words[0]), int(words[1]), [float(w) for w in words[2:]])
    return table.model()


def _igrf_table(lines: list[str]) -> MainFieldModel:
    epochs = [float(w) for w in lines[1].split()[3:-1]]
    rows = [line.split() for line in lines[2:]]
    table = _Table([*epochs, epochs[-1] + 5.0], max(int(r[1]) for r in rows))
    for kind, n, m, *words in rows:
        values = [float(w) for w in words]
        # The last column is a change a year.
        table.put(int(n), int(m) if kind == "g" else -int(m), [*values[:-1], values[-2] + 5.0 * values[-1]])
    return table.model()


def _cof(lines: list[str]) -> MainFieldModel:
    epoch = float(lines[0].split()[0])
    if not math.isfinite(epoch):
        raise ValueError(f"epoch {epoch}")
    rows = list(_cof_rows(lines[1:]))
    table = _Table([epoch, epoch + 5.0], max(r[0] for r in rows))
    for n, m, g, h, g_rate, h_rate in rows:
        table.put(n, m, [g, g + 5.0 * g_rate])
        if m > 0:
            table.put(n, -m, [h, h + 5.0 * h_rate])
    return table.model()


def _cof_rows(lines: list[str]) -> Iterator[tuple[int, int, float, float, float, float]]:
    for line in lines:
        if line.startswith("9999"):
            return
        words = line.split()
        g, h, g_rate, h_rate = (float(w) for w in words[2:6])
        yield int(words[0]), int(words[1]), g, h, g_rate, h_rate
