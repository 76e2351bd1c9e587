"""Tracks from tables: which columns, in which units, at what times."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from geomag._errors import DataWarning, InvalidInputError, ReadError, TimeError, TooFewSamplesError
from geomag._geomag import GridMap, Track
from geomag._optional import require
from geomag.io import _times
from geomag.io._names import Column, asked_column, coordinate_columns, the_one
from geomag.io._numbers import without_dummies
from geomag.io._tables import load_table, table_from_pandas, text_or_numbers
from geomag.io._text import Table
from geomag.io._units import METRES, OTHER_ANGLES, field_unit, is_degree, metres_in, tidy

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Missing = Literal["error", "drop"]


@dataclass
class Points:
    """Positions and values of a table with all that it says of them: metres or degrees, nT or mGal."""

    x: Array
    y: Array
    values: Array
    geographic: bool | None
    unit: str | None
    columns: tuple[Column, Column, Column]


def _told_unit(column: Column, unit: str | None, option: str, where: str) -> Column:
    """The column with a unit that the caller knows; one that the file says otherwise is not overruled."""
    if unit is None:
        return column
    known = field_unit(unit) if option == "value_unit" else tidy(unit) in METRES or is_degree(unit) or None
    if known is None:
        needed = (
            "a unit of a field (nT, uT, mG, mGal, ...)" if option == "value_unit" else "degrees or a unit of length"
        )
        raise InvalidInputError(f"{option}: needed {needed}, got {unit!r}")
    if column.unit is not None and tidy(column.unit) != tidy(unit):
        raise InvalidInputError(
            f"{option}: needed {column.unit!r}, as the name of column '{column.name}' of {where} says, got {unit!r}"
        )
    system = column.system
    if option == "xy_unit":
        system = "geographic" if is_degree(unit) else "projected"
        if column.system is not None and column.system != system:
            raise InvalidInputError(
                f"{option}: needed a unit of what column '{column.name}' of {where} is, got {unit!r}"
            )
    return replace(column, unit=unit, system=system)


def _in_own_unit(values: Array, column: Column, where: str) -> tuple[Array, str | None]:
    """Values in nT or mGal where the column's name has a unit of a field, else as they are."""
    known = field_unit(column.unit)
    if known is None:
        return values, column.unit
    unit, factor = known
    return (values if factor == 1.0 else values * factor), unit


def _coordinates(table: Table, column: Column) -> Array:
    where = f"{table.where}, column '{column.name}'"
    c = table.floats(column)
    unit = column.unit
    if column.system == "geographic" or (unit is not None and is_degree(unit)):
        if unit is not None and tidy(unit) in OTHER_ANGLES:
            raise InvalidInputError(f"{where}: needed degrees, got {unit!r}")
        limit = 90.0 if column.kind == "y" else 720.0
        beyond = np.flatnonzero(np.abs(c) > limit)
        if beyond.size:
            c = without_dummies(c, where, 999.0)
            beyond = np.flatnonzero(np.abs(c) > limit)
        if beyond.size:
            raise InvalidInputError(
                f"{where}: needed {'latitudes in [-90, 90]' if column.kind == 'y' else 'longitudes in [-720, 720]'} degrees, got "
                f"{c[beyond[0]]:g} in row {beyond[0]} (metres? minutes? degrees times 1e7?)"
            )
        return c
    factor = metres_in(unit, where)
    c = without_dummies(c, where, 99_999.0)
    return c if factor == 1.0 else c * factor


def value_column(table: Table, asked: str | int | None, unit: str | None, height_too: bool = False) -> Column:
    """The column of the readings: the one asked for, else the only one that is a reading (in that unit where one is told)."""
    if asked is not None:
        return asked_column(table.columns, asked, table.where)
    found = [c for c in table.columns if c.kind == "value"]
    if unit is not None and len(found) > 1:
        known = field_unit(unit)
        same = [c for c in found if (field_unit(c.unit) or (c.unit, 1.0))[0] == (known[0] if known else unit)]
        found = same or found
    if not found and height_too:
        found = [c for c in table.columns if c.name.lower() == "z"]
    return the_one(table.columns, "value", found, table.where)


def points_of(
    table: Table,
    x: str | int | None,
    y: str | int | None,
    value: str | int | None,
    *,
    geographic: bool | None = None,
    unit: str | None = None,
    height_too: bool = False,
    xy_unit: str | None = None,
    value_unit: str | None = None,
) -> Points:
    """Positions and values of a table; NaN where one is missing or a dummy."""
    px, py = coordinate_columns(table.columns, x, y, table.where, geographic)
    pv = value_column(table, value, unit if value_unit is None else value_unit, height_too)
    px, py = (_told_unit(c, xy_unit, "xy_unit", table.where) for c in (px, py))
    pv = _told_unit(pv, value_unit, "value_unit", table.where)
    if pv.index in (px.index, py.index):
        raise InvalidInputError(f"{table.where}: needed a column for value beside x and y, got '{pv.name}'")
    said = px.system or py.system
    system = None if said is None else said == "geographic"
    if geographic is not None and system is not None and geographic != system:
        raise InvalidInputError(
            f"{table.where}: needed geographic={system}, as columns '{px.name}' and '{py.name}' are "
            f"{'degrees' if system else 'no degrees'}, got geographic={geographic}"
        )
    if system is None and geographic:
        px, py = (Column(c.index, c.name, k, "geographic", c.unit) for c, k in ((px, "x"), (py, "y")))  # type: ignore[arg-type]
    cx, cy = _coordinates(table, px), _coordinates(table, py)
    where = f"{table.where}, column '{pv.name}'"
    values, value_unit = _in_own_unit(without_dummies(table.floats(pv), where), pv, where)
    return Points(cx, cy, values, system if geographic is None else geographic, value_unit, (px, py, pv))


def read_track(
    path: str | Path,
    x: str | int | None = None,
    y: str | int | None = None,
    value: str | int | None = None,
    *,
    time: str | int | Literal[False] | None = None,
    time_unit: str | None = None,
    missing: Missing = "error",
    grid: GridMap | None = None,
    height: str | int | None = None,
    position: str | None = None,
    reading: str | None = None,
    geographic: bool | None = None,
    xy_unit: str | None = None,
    value_unit: str | None = None,
) -> Track:
    r"""Read an indicated track with measured values from CSV (also compressed), other text, Parquet, or the log of a vehicle.

    Logs are PX4 ULog, ArduPilot dataflash, ROS bags, MagNav HDF5, MGD77 and M77T; the kind is found from a file's first bytes. In a log of a vehicle the
    reading is the strength of its magnetometer in nT, and positions are those of its navigation, at the times of the readings.

    Columns are known by their names and units (`Lat (deg)`, `X_km`, `mag_nT`), in any case and order. Where two may be meant, or
    none is known, an error names the columns and the keyword to give; their order is never taken for a meaning.

    Parameters
    ----------
    path : the file.
    x, y, value, time : column names, or numbers from 0 of a file without a header. By default the ones whose names say what they
        are; a height is never a reading. Times are optional; `time=False` leaves them.
    time_unit : of times that are numbers (s, ms, us, ns, min, h, days, hhmm, hhmmss), where the file does not say it.
    missing : what to do with rows where position or value is missing: 'error' names the first, 'drop' leaves them out.
        Dummies of other programs (99999, -1e32, ...) are always left out, and told by a `DataWarning`.
    height : column of the heights above the map's height datum; none by default, as files rarely say which datum theirs is.
    position, reading : streams of a log (`vehicle_global_position`, `MAG[1]`, `/imu/mag`, `mag_1_uc`), where it has several; a number of any
        other message is `message.field`.
    grid : a map that the track is for: its unit chooses among several readings, and degrees are not taken for metres.
    geographic, xy_unit, value_unit : whether coordinates are degrees, their unit (km, ft, ...) and that of the readings (uT, mG, ...), where
        the file does not say them; what it says may be repeated, not contradicted. Without any, numbers are metres or degrees as the map's, and
        readings in the map's unit.

    Returns
    -------
    Track
        Coordinates in degrees or metres (kilometres and feet are turned into those), values in nT or mGal where the name of
        their column has a unit of a field, times in seconds.

    Raises
    ------
    MissingFileError, ReadError, UnknownVariableError, InvalidInputError, MissingDependencyError

    Examples
    --------
    >>> import pathlib, tempfile, geomag
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.csv")
    ...     _ = path.write_text("time_s,longitude,latitude,anomaly\n0,16.10,47.2,31.5\n8,16.11,47.2,35.0\n")
    ...     track = geomag.read_track(path)
    >>> len(track), track.values.tolist(), track.time_s.tolist()
    (2, [31.5, 35.0], [0.0, 8.0])
    """
    table = load_table(path, position, reading)
    return track_of(
        table, x, y, value, time=time, time_unit=time_unit, missing=missing, grid=grid, height=height, geographic=geographic,
        xy_unit=xy_unit, value_unit=value_unit,
    )  # fmt: skip


def track_from_pandas(
    table: pd.DataFrame,
    x: str | None = None,
    y: str | None = None,
    value: str | None = None,
    *,
    time: str | Literal[False] | None = None,
    time_unit: str | None = None,
    missing: Missing = "error",
    grid: GridMap | None = None,
    height: str | None = None,
    geographic: bool | None = None,
    xy_unit: str | None = None,
    value_unit: str | None = None,
    where: str = "table",
) -> Track:
    """Make a track of the columns of a DataFrame; arguments as for `read_track`."""
    rows = table_from_pandas(table, where)
    return track_of(
        rows, x, y, value, time=time, time_unit=time_unit, missing=missing, grid=grid, height=height, geographic=geographic,
        xy_unit=xy_unit, value_unit=value_unit,
    )  # fmt: skip


def track_of(
    table: Table,
    x: str | int | None = None,
    y: str | int | None = None,
    value: str | int | None = None,
    *,
    time: str | int | Literal[False] | None = None,
    time_unit: str | None = None,
    missing: Missing = "error",
    grid: GridMap | None = None,
    height: str | int | None = None,
    geographic: bool | None = None,
    xy_unit: str | None = None,
    value_unit: str | None = None,
) -> Track:
    """A track of a table; arguments as for `read_track`."""
    where = table.where
    if missing not in ("error", "drop"):
        raise InvalidInputError(f"missing: needed 'error' or 'drop', got '{missing}'")
    if table.labels is not None and len(set(table.labels)) > 1:
        names = list(dict.fromkeys(table.labels))
        raise InvalidInputError(
            f"{where}: needed one track, got {len(names)} lines ({', '.join(names[:5])}) that have to be split: "
            "geomag.survey.read_lines does it"
        )
    points = points_of(
        table, x, y, value, geographic=geographic, unit=None if grid is None else grid.units, xy_unit=xy_unit, value_unit=value_unit
    )  # fmt: skip
    if grid is not None:
        _fits(points, grid, where)
    keep = kept_rows(table, points, missing)
    px, py, values = points.x[keep], points.y[keep], points.values[keep]
    step_m = None if points.geographic is None else steps_m(px, py, points.geographic)
    seconds = _seconds(table, time, time_unit, keep, step_m)
    heights = None
    if height is not None:
        column = asked_column(table.columns, height, where)
        at = f"{where}, column '{column.name}'"
        heights = without_dummies(table.floats(column), at)[keep] * metres_in(column.unit, at)
    return Track(px, py, values, time_s=seconds, height_m=heights, geographic=points.geographic)


def kept_rows(table: Table, points: Points, missing: Missing) -> NDArray[np.bool_]:
    """Rows with a position and a value; raises for those without as `missing` says, and where there are none."""
    where = table.where
    dummies = np.isnan(points.values) & ~np.isnan(table.floats(points.columns[2]))
    for c, own in zip(points.columns[:2], (points.x, points.y), strict=True):
        dummies |= np.isnan(own) & ~np.isnan(table.floats(c))
    bad = ~np.isfinite(np.column_stack([points.x, points.y, points.values])).all(axis=1)
    if (bad & ~dummies).any() and missing == "error":
        k = int((bad & ~dummies).argmax())
        raise InvalidInputError(
            f"{where}: needed a position and a value in every row, got x {points.x[k]}, y {points.y[k]}, value "
            f"{points.values[k]} in data row {k} ({int((bad & ~dummies).sum())} such rows); missing='drop' leaves them out"
        )
    keep = np.asarray(~bad)
    if not keep.any():
        raise TooFewSamplesError(f"{where}: needed a position and a value in one row at least, got none")
    return keep


def waypoints(path: str | Path, x: str | int | None, y: str | int | None, grid: GridMap) -> Track:
    """Waypoints of a table as a track without readings, whose columns are known as those of a log are."""
    table = load_table(path)
    px, py = coordinate_columns(table.columns, x, y, table.where)
    said = px.system or py.system
    cx, cy = _coordinates(table, px), _coordinates(table, py)
    known = np.isfinite(cx) & np.isfinite(cy)
    if known.sum() < 2:
        raise TooFewSamplesError(f"{table.where}: needed at least two waypoints, got {int(known.sum())}")
    cx, cy = cx[known], cy[known]
    points = Points(cx, cy, np.zeros(len(cx)), None if said is None else said == "geographic", None, (px, py, px))
    _fits(points, grid, table.where)
    return Track(cx, cy, points.values, geographic=points.geographic)


def _fits(points: Points, grid: GridMap, where: str) -> None:
    """Refuse degrees on a map in metres, metres on one in degrees, and readings of another quantity."""
    if points.geographic is not None and points.geographic != grid.geographic and not grid.crs:
        of = ("degrees", "metres")
        raise InvalidInputError(
            f"{where}: needed positions in {of[0] if grid.geographic else of[1]} as the map's, got columns "
            f"'{points.columns[0].name}' and '{points.columns[1].name}' in {of[0] if points.geographic else of[1]}"
        )
    ours, theirs = field_unit(points.unit), field_unit(grid.units)
    if ours and theirs and ours[0] != theirs[0]:
        raise InvalidInputError(
            f"{where}: needed readings in {theirs[0]} as the map's values, got column '{points.columns[2].name}' in {ours[0]}"
        )


def steps_m(x: Array, y: Array, geographic: bool) -> Array:
    """Distances between neighbours, metres (a sphere's, near enough for a speed)."""
    if not geographic:
        return np.hypot(np.diff(x), np.diff(y))
    east = (np.diff(x) + 180.0) % 360.0 - 180.0
    scale = np.cos(np.radians(0.5 * (y[1:] + y[:-1])))
    return np.asarray(111_200.0 * np.hypot(east * scale, np.diff(y)))


def _time_column(table: Table, asked: str | int | None) -> list[Column]:
    """The column of the times, or a date and a time of day; nothing where there is none or where several may be."""
    if asked is not None:
        return [asked_column(table.columns, asked, table.where)]
    times = [c for c in table.columns if c.kind == "time"]
    dates = [c for c in table.columns if c.kind == "date"]
    if len(times) > 1:
        _told(
            f"{table.where}: several columns may be times ({', '.join(c.name for c in times)}); none is used, name one with time="
        )
        return []
    if len(times) == 1 and len(dates) == 1:
        return [*dates, *times]
    return times or dates[:1]


def _told(text: str) -> None:
    warnings.warn(text, DataWarning, stacklevel=5)


def _seconds(
    table: Table,
    asked: str | int | Literal[False] | None,
    unit: str | None,
    keep: NDArray[np.bool_],
    step_m: Array | None,
) -> Array | None:
    """Times of the rows that are kept, seconds; None where there are none that can be understood and none were asked for."""
    if asked is False:
        return None
    columns = _time_column(table, asked)
    if not columns:
        return None
    column = columns[-1]
    where = f"{table.where}, column '{column.name}'"
    texts, plain = text_or_numbers(table, column)
    if plain is not None:
        if not len(plain):
            return None
        plain = plain[keep]
        if not np.isfinite(plain).all():
            _untimed(where, "a time is missing", asked)
            return None
        told = (
            unit
            or (None if tidy(column.unit or "utc") in ("utc", "gmt", "local", "gps") else column.unit)
            or ("hhmmss" if "hhmmss" in column.name.lower() else None)
        )
        told = told or ("hhmm" if "hhmm" in column.name.lower() else None)
        seconds = _times.from_numbers(plain, told, where, step_m)
    else:
        chosen = [t for t, k in zip(cast("Sequence[str]", texts), keep, strict=True) if k]
        if len(columns) == 2 and all(":" in t and "-" not in t for t in chosen):
            days = [t for t, k in zip(table.fields[columns[0].index], keep, strict=True) if k]
            chosen = [f"{d} {t}" for d, t in zip(days, chosen, strict=True)]
        found = _times.from_text(chosen, where)
        if found is None:
            _untimed(where, f"needed seconds, dates or times of day, got {chosen[0]!r}", asked)
            return None
        seconds = found
    falls = np.flatnonzero(np.diff(seconds) < 0)
    if falls.size:
        _untimed(where, f"times fall at row {falls[0] + 1}", asked)
        return None
    return seconds


def times_of(table: Table, asked: str | int | None, points: Points) -> Array:
    """Times of every row, seconds, for what cannot do without; errors say what is wrong with them."""
    columns = [asked_column(table.columns, asked, table.where)] if asked is not None else _time_column(table, None)
    if not columns:
        the_one(table.columns, "time", [c for c in table.columns if c.kind == "time"], table.where)
    step_m = None if points.geographic is None else steps_m(points.x, points.y, points.geographic)
    found = _seconds(
        table, asked if asked is not None else columns[-1].name, None, np.ones(len(table), dtype=bool), step_m
    )
    if found is None:  # a date beside a time of day, which are looked for without asking
        raise InvalidInputError(f"{table.where}: needed times in column '{columns[-1].name}', got none")
    return found


def dates_of(table: Table, asked: str | int | None = None) -> NDArray[np.datetime64]:
    """Date of every row, UTC, for what changes from day to day; NaT where a row has none.

    Raises `TimeError` for a log without dates, naming the column that has none.
    """
    columns = [asked_column(table.columns, asked, table.where)] if asked is not None else _time_column(table, None)
    if not columns:
        raise TimeError(f"{table.where}: needed a column of dates, got {', '.join(c.name for c in table.columns)}")
    column = columns[-1]
    where = f"{table.where}, column '{column.name}'"
    texts, plain = text_or_numbers(table, column)
    out = np.full(len(table), np.datetime64("NaT", "us"))
    if plain is not None:
        known = np.isfinite(plain)
        unit = None if tidy(column.unit or "utc") in ("utc", "gmt", "local", "gps") else column.unit
        if known.any():
            out[known] = _times.dates_from_numbers(plain[known], unit, where)
        return out
    chosen = list(cast("Sequence[str]", texts))
    if len(columns) == 2 and all(":" in t and "-" not in t for t in chosen if t.strip()):
        chosen = [f"{d} {t}" if t.strip() else "" for d, t in zip(table.fields[columns[0].index], chosen, strict=True)]
    known = np.array([bool(t.strip()) for t in chosen])
    if known.any():
        out[known] = _times.dates_from_text([t for t in chosen if t.strip()], where)
    return out


def _untimed(where: str, why: str, asked: object) -> None:
    """No times: an error where they were asked for, else told and left."""
    if asked is not None:
        raise InvalidInputError(f"{where}: needed times that rise, of every row; {why}")
    _told(f"{where}: times are left out: {why}")


def track_to_pandas(track: Track, *, geographic: bool = False) -> pd.DataFrame:
    """Return the samples as a DataFrame with columns x, y (or longitude, latitude), value and, where known, time_s."""
    pandas = require("pandas", "io", "track_to_pandas")
    x_name, y_name = ("longitude", "latitude") if geographic else ("x", "y")
    table: pd.DataFrame = pandas.DataFrame({x_name: track.x, y_name: track.y, "value": track.values})
    if track.time_s is not None:
        table["time_s"] = track.time_s
    return table


def _one_turn(x: Array) -> Array:
    """Longitudes on the turn on which they lie closest together, so that lines over the date line are whole."""
    other = x % 360.0
    return other if np.ptp(x) > 180.0 and np.ptp(other) < np.ptp(x) else x


def line_points(
    path: str | Path,
    x: str | None,
    y: str | None,
    value: str | None,
    line: str | None,
    geographic: bool | None,
    height: str | None = None,
) -> tuple[Points, NDArray[Any], NDArray[np.float64] | None]:
    """Points of survey lines, the label of each, and its height where asked for; rows without one of them are left out."""
    table = load_table(path)
    points = points_of(table, x, y, value, geographic=geographic)
    if points.geographic is None:
        raise InvalidInputError(
            f"{table.where}: needed to know whether columns '{points.columns[0].name}' and '{points.columns[1].name}' are degrees or "
            "metres, got neither units nor names that say so; pass geographic=True or geographic=False"
        )
    if table.labels is not None and line in (None, "line"):
        labels: NDArray[Any] = np.array(table.labels)
    else:
        found = [c for c in table.columns if c.kind == "line"]
        found = [c for c in found if c.name.lower() == "line"] or found
        one = (
            asked_column(table.columns, line, table.where)
            if line
            else the_one(table.columns, "line", found, table.where)
        )
        texts, plain = text_or_numbers(table, one)
        labels = np.array(texts) if plain is None else plain
    keep = np.isfinite(points.x) & np.isfinite(points.y) & np.isfinite(points.values)
    heights = None
    if height is not None:
        column = asked_column(table.columns, height, table.where)
        at = f"{table.where}: column '{column.name}'"
        heights = without_dummies(table.floats(column), at) * metres_in(column.unit, at)
        keep &= np.isfinite(heights)
    if not keep.any():
        raise ReadError(f"{table.where}: needed a position and a value in one row at least, got none")
    points.x, points.y, points.values = points.x[keep], points.y[keep], points.values[keep]
    if points.geographic:
        points.x = _one_turn(points.x)
    if labels.dtype.kind == "f" and np.all((labels == np.rint(labels)) & (np.abs(labels) < 2**53)):
        labels = labels.astype(np.int64)
    return points, labels[keep], None if heights is None else heights[keep]
