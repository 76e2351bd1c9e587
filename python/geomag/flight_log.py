"""Logs of a flight: what the INS indicated and what was read, from a file or a pipe.

Text with a header line: time, position and reading, and where there are, velocity and heading of the INS (without them the navigator takes differences of
positions) and the true position (for tests). A reading that is missing is an empty field or `nan`.

Columns and the names that are known:

- time, seconds: time_s, time, t, tt, seconds
- x: longitude, lon, x, easting, east, ins_lon
- y: latitude, lat, y, northing, north, ins_lat
- reading: value, total_field_anomaly_nt, anomaly, magnetic, gravity, mag, reading
- velocity, m/s: velocity_east_m_s, ve, v_east, ins_ve and velocity_north_m_s, vn, v_north, ins_vn
- heading, degrees: heading_deg, heading, yaw_deg, yaw, ins_yaw
- truth: true_x, true_longitude, true_lon and true_y, true_latitude, true_lat
- height, metres: only the one that is asked for, as files rarely say above what
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, UnknownVariableError
from geomag._geomag import GridMap, Track
from geomag.io._names import asked_column, understand
from geomag.io._tables import load_table
from geomag.io._tracks import dates_of, points_of, times_of
from geomag.io._units import metres_in

Array = npt.NDArray[np.float64]

#: Names of the columns, the first of them those that `write_flight_log` writes.
NAMES: dict[str, tuple[str, ...]] = {
    "time_s": ("time_s", "time", "t", "tt", "seconds"),
    "x": ("longitude", "lon", "x", "easting", "east", "ins_lon"),
    "y": ("latitude", "lat", "y", "northing", "north", "ins_lat"),
    "value": ("value", "total_field_anomaly_nt", "anomaly", "magnetic", "gravity", "mag", "reading"),
    "velocity_east": ("velocity_east_m_s", "ve", "v_east", "ins_ve"),
    "velocity_north": ("velocity_north_m_s", "vn", "v_north", "ins_vn"),
    "heading": ("heading_deg", "heading", "yaw_deg", "yaw", "ins_yaw"),
    "true_x": ("true_x", "true_longitude", "true_lon"),
    "true_y": ("true_y", "true_latitude", "true_lat"),
    "height": (),
}
NEEDED = ("time_s", "x", "y", "value")


@dataclass(frozen=True)
class LogRow:
    """One line of a log; NaN for a reading that is missing, None for what the log does not have."""

    time_s: float
    x: float
    y: float
    value: float
    velocity_m_s: tuple[float, float] | None = None
    heading_deg: float | None = None
    truth: tuple[float, float] | None = None
    geographic: bool | None = None


@dataclass(frozen=True)
class FlightLog:
    """A whole log: shapes (n,), `velocity_m_s` (n, 2) east-north, `truth` (n, 2) map units; None for what the log does not have.

    `geographic` says whether places are degrees, where the log says so; `date` has the dates in UTC, where they were asked for.
    """

    time_s: Array
    x: Array
    y: Array
    readings: Array
    velocity_m_s: Array | None = None
    heading_deg: Array | None = None
    truth: Array | None = None
    geographic: bool | None = None
    height_m: Array | None = None
    date: npt.NDArray[np.datetime64] | None = None

    def on_map(self, grid: GridMap) -> FlightLog:
        """The log in the coordinates of a map: positions by its system, velocities and headings to grid north.

        What says nothing of its own (`geographic` is None) is taken to be as the map is. An `AlignedWarning` says what was done.

        Raises `InvalidInputError` for degrees on a map in metres without a system, and for metres on a map in degrees.

        Examples
        --------
        >>> import numpy as np, geomag, warnings
        >>> from geomag.flight_log import FlightLog
        >>> grid = geomag.GridMap([[0.0, 1], [2, 3]], [5e5, 5.1e5], [4.98e6, 4.99e6], crs="EPSG:32632")
        >>> log = FlightLog(np.array([0.0]), np.array([11.0]), np.array([45.0]), np.array([30.0]), heading_deg=np.array([90.0]), geographic=True)
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     turned = log.on_map(grid)
        >>> turned.x.round(-1), turned.heading_deg.round(2)    # east of the meridian grid north lies to the east of true north
        (array([657630.]), array([88.59]))
        """
        from geomag.projection import DEGREES, align, convergence_deg, transform

        if self.geographic is None or self.geographic == grid.geographic:
            return self
        there = align(grid, Track(self.x, self.y, np.zeros(len(self.x)), geographic=self.geographic))
        assert grid.crs is not None
        turn = convergence_deg(grid.crs, self.x, self.y)
        velocity, heading, truth = self.velocity_m_s, self.heading_deg, self.truth
        if velocity is not None:
            east, north = velocity.T
            c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
            velocity = np.column_stack([c * east - s * north, s * east + c * north])
        if heading is not None:
            heading = (heading - turn) % 360.0
        if truth is not None:
            truth = np.column_stack(transform(truth[:, 0], truth[:, 1], DEGREES, grid.crs))
        return replace(
            self,
            x=np.asarray(there.x),
            y=np.asarray(there.y),
            velocity_m_s=velocity,
            heading_deg=heading,
            truth=truth,
            geographic=grid.geographic,
        )


def _columns(names: list[str], asked: Mapping[str, str | None], where: str) -> dict[str, int]:
    known = {name.strip().strip('"').lower(): k for k, name in reversed(list(enumerate(names)))}
    found: dict[str, int] = {}
    for what, usual in NAMES.items():
        name = asked.get(what)
        if name is not None and name.lower() not in known:
            raise UnknownVariableError(f"{where}: needed a column among {', '.join(names)}, got '{name}'")
        at = next((known[n] for n in ((name.lower(),) if name else usual) if n in known), None)
        if at is not None:
            found[what] = at
        elif what in NEEDED:
            raise UnknownVariableError(
                f"{where}: needed a column for {what} ({', '.join(usual)}), got {', '.join(names)}"
            )
    return found


def read_rows(lines: Iterable[str], *, where: str = "log", **columns: str | None) -> Iterator[LogRow]:
    """Rows of a log, one at a time, as they come: for a pipe.

    `columns` name those that are called otherwise: time_s, x, y, value, velocity_east, velocity_north, heading, true_x, true_y.

    Raises `UnknownVariableError` for a header without what is needed, `InvalidInputError` naming the line that is not numbers, or has no time or position.

    Examples
    --------
    >>> from geomag.flight_log import read_rows
    >>> rows = list(read_rows(["time_s,lon,lat,mag,ve,vn", "0,16.1,47.2,31.5,70,0", "1,16.101,47.2,,70,0"]))
    >>> rows[0].velocity_m_s, rows[1].value
    ((70.0, 0.0), nan)
    """
    at: dict[str, int] | None = None
    width = 0
    geographic: bool | None = None
    for number, parts in enumerate(csv.reader(_plain(lines)), start=1):
        if not parts or parts[0].startswith("#"):
            continue
        if at is None:
            at, width = _columns(parts, columns, where), len(parts)
            x, y = (understand(at[k], parts[at[k]].strip().strip('"')) for k in ("x", "y"))
            system = x.system or y.system
            geographic = None if system is None else system == "geographic"
            continue
        if len(parts) != width:
            raise InvalidInputError(
                f"{where}, line {number}: needed {width} columns as in the header, got {len(parts)}"
            )
        numbers = {what: _number(parts[k], f"{where}, line {number}: {what}") for what, k in at.items()}
        for what in ("time_s", "x", "y"):
            if not math.isfinite(numbers[what]):
                raise InvalidInputError(f"{where}, line {number}: needed a finite {what}, got {parts[at[what]]!r}")
        velocity = (numbers.get("velocity_east", math.nan), numbers.get("velocity_north", math.nan))
        truth = (numbers.get("true_x", math.nan), numbers.get("true_y", math.nan))
        heading = numbers.get("heading", math.nan)
        yield LogRow(
            numbers["time_s"],
            numbers["x"],
            numbers["y"],
            numbers["value"],
            velocity if all(map(math.isfinite, velocity)) else None,
            heading if math.isfinite(heading) else None,
            truth if all(map(math.isfinite, truth)) else None,
            geographic,
        )


def _plain(lines: Iterable[str]) -> Iterator[str]:
    for line in lines:
        text = line.lstrip("\ufeff")
        yield text.replace(";", ",").replace("\t", ",")


def _number(text: str, where: str) -> float:
    if not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError as error:
        raise InvalidInputError(f"{where}: needed a number, got {text!r}") from error
    if math.isinf(value):
        raise InvalidInputError(f"{where}: needed a finite number or none, got {text!r}")
    return value


def read_flight_log(path: str | Path, *, dated: bool = False, **columns: str | None) -> FlightLog:
    r"""Read a log of a flight from a file; `columns` as for `read_rows`, and height.

    `dated` asks for the dates of its times too, for what changes from day to day; a log without dates is refused then.

    Files are read as `geomag.read_track` reads them (separators, units in names, dummies, times of every kind, compressed, logs of vehicles).
    A reading that is missing is NaN; a log whose velocity or heading is missing in some rows is taken as one without.

    Raises `MissingFileError`, `ReadError`, `UnknownVariableError` and `InvalidInputError`.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from geomag.flight_log import read_flight_log
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.csv")
    ...     _ = path.write_text("time_s,x,y,value,heading_deg\n0,0,0,31.5,90\n1,70,0,nan,90\n")
    ...     log = read_flight_log(path)
    >>> log.readings, log.heading_deg, log.velocity_m_s
    (array([31.5,  nan]), array([90., 90.]), None)
    """
    table = load_table(path)
    where = str(path)
    for what in columns:
        if what not in NAMES:
            raise InvalidInputError(f"{where}: needed columns named among {', '.join(NAMES)}, got '{what}'")
    points = points_of(table, columns.get("x"), columns.get("y"), columns.get("value"))
    place = np.isfinite(points.x) & np.isfinite(points.y)
    if not place.all():
        k = int(np.argmin(place))
        raise InvalidInputError(
            f"{where}: needed a position in every row, got x {points.x[k]}, y {points.y[k]} in data row {k}"
        )
    time = times_of(table, columns.get("time_s"), points)

    def whole(*wanted: str) -> Array | None:
        found = []
        for what in wanted:
            asked = columns.get(what)
            known = {c.name.lower(): c for c in table.columns}
            one = (
                asked_column(table.columns, asked, where)
                if asked
                else next((known[n] for n in NAMES[what] if n in known), None)
            )
            if one is None or np.isnan(table.floats(one)).any():
                return None
            found.append(table.floats(one))
        return found[0] if len(found) == 1 else np.column_stack(found)

    velocity, truth = whole("velocity_east", "velocity_north"), whole("true_x", "true_y")
    height = None
    if (asked_height := columns.get("height")) is not None:
        column = asked_column(table.columns, asked_height, where)
        height = table.floats(column) * metres_in(column.unit, f"{where}, column '{column.name}'")
    date = dates_of(table, columns.get("time_s")) if dated else None
    return FlightLog(
        time, points.x, points.y, points.values, velocity, whole("heading"), truth, points.geographic, height, date
    )


def write_flight_log(path: str | Path, log: FlightLog) -> None:
    """Write a log that `read_flight_log` reads, full precision."""
    columns: list[tuple[str, Array]] = [("time_s", log.time_s), ("x", log.x), ("y", log.y), ("value", log.readings)]
    if log.velocity_m_s is not None:
        columns += [("velocity_east_m_s", log.velocity_m_s[:, 0]), ("velocity_north_m_s", log.velocity_m_s[:, 1])]
    if log.heading_deg is not None:
        columns.append(("heading_deg", log.heading_deg))
    if log.truth is not None:
        columns += [("true_x", log.truth[:, 0]), ("true_y", log.truth[:, 1])]
    if log.height_m is not None:
        columns.append(("height_m", log.height_m))
    with Path(path).open("w", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([name for name, _ in columns])
        for row in zip(*(c for _, c in columns), strict=True):
            writer.writerow(["" if math.isnan(v) else repr(float(v)) for v in row])
