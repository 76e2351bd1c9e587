"""Tables of any origin as one kind: text, Parquet, data frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from geomag._errors import InvalidInputError, ReadError
from geomag._optional import require
from geomag.io import _bag, _dataflash, _log_tables, _magnav, _mgd77, _ulog
from geomag.io._names import Column, columns_of
from geomag.io._serial import read_nmea
from geomag.io._text import Table, decoded, existing, parse, plain_bytes

if TYPE_CHECKING:
    import pandas as pd


def table_from_pandas(frame: pd.DataFrame, where: str) -> Table:
    """A data frame as a table; its numbers stay as they are."""
    pandas = require("pandas", "io", "tables")
    columns = columns_of([str(c) for c in frame.columns])
    table = Table(where, columns, [], list(range(len(frame))))
    for column, name in zip(columns, frame.columns, strict=True):
        series = frame[name]
        if pandas.api.types.is_datetime64_any_dtype(series):
            stamps = series.dt.tz_convert(None) if getattr(series.dtype, "tz", None) is not None else series
            table.fields.append([] if not len(stamps) else [_iso(s) for s in stamps])
        elif pandas.api.types.is_numeric_dtype(series):
            table.fields.append([])
            table.numbers_[column.index] = np.asarray(series.to_numpy(dtype=np.float64, na_value=np.nan))
        else:
            table.fields.append(["" if pandas.isna(v) else str(v).strip() for v in series])
    return table


def _iso(stamp: Any) -> str:  # noqa: ANN401 - a pandas timestamp
    return "" if stamp != stamp else str(stamp.isoformat())  # noqa: PLR0124 - not a time is unequal to itself


def load_table(path: str | Path, position: str | None = None, reading: str | None = None) -> Table:
    """The table of a file: a log of a vehicle, Parquet, marine tracklines, else text, compressed or not.

    `position` and `reading` name streams of a log; other files have none.
    """
    path = Path(path)
    if path.is_dir() and _bag.is_bag(path, b""):
        return _bag.bag_table(path, position, reading)
    path = existing(path)
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(_ulog.MAGIC):
        return _ulog.ulog_table(path, position, reading)
    if head.startswith(_dataflash.MAGIC):
        return _dataflash.dataflash_table(path, position, reading)
    if _bag.is_bag(path, head):
        return _bag.bag_table(path, position, reading)
    if head.startswith(b"\x89HDF") and _magnav.is_magnav_flight(path):
        return _magnav.magnav_table(path, position, reading)
    if head.lstrip(b"\xef\xbb\xbf \r\n")[:1] == b"$" and position is None and reading is None:
        return _nmea_table(decoded(path.read_bytes(), str(path)), str(path))
    if position is not None or reading is not None:
        raise InvalidInputError(
            f"{path}: needed no position= and reading=, which name the streams of a log, for a table"
        )
    if path.suffix.lower() in (".parquet", ".pq"):
        pandas = require("pandas", "io", "reading Parquet")
        try:
            frame = pandas.read_parquet(path)
        except (OSError, ValueError) as error:
            raise ReadError(f"{path}: needed a readable table, got: {error}") from error
        if not len(frame):
            raise ReadError(f"{path}: needed a readable table with at least one row, got none")
        return table_from_pandas(frame, str(path))
    text = decoded(plain_bytes(path.read_bytes(), str(path)), str(path))
    if _mgd77.looks_like_mgd77(text):
        return _mgd77.mgd77_table(text, str(path))
    table = parse(text, str(path))
    return _mgd77.m77t_table(table, str(path)) if _mgd77.looks_like_m77t(text) else table


def _nmea_table(text: str, where: str) -> Table:
    """Samples of a file of NMEA sentences; times where every sample has one."""
    samples = list(read_nmea(text.split("\n")))
    if not samples:
        raise ReadError(
            f"{where}: needed positions (GGA, RMC, GLL or GNS) and readings ($PGMAG) after them, got none that can be read"
        )
    columns = {
        n: np.array([getattr(s, k) for s in samples])
        for n, k in (("longitude", "x"), ("latitude", "y"), ("value", "value"))
    }
    times = [s.time_s for s in samples]
    timed = {} if None in times else {"time_s": np.array(times, dtype=np.float64)}
    return _log_tables.numbers_table(timed | columns, where)


def read_table(path: str | Path) -> pd.DataFrame:
    """A table (CSV, compressed or not, other text, Parquet) as a data frame: columns of numbers as such, others as they are written."""
    pandas = require("pandas", "io", "tables as data frames")
    table = load_table(path)
    out: dict[str, Any] = {}
    for column in table.columns:
        texts = table.fields[column.index]
        if column.index in table.numbers_:
            out[column.name] = table.numbers_[column.index]
        else:
            words, plain = text_or_numbers(table, column)
            whole = plain is not None and all(t.lstrip("+-").isdigit() and len(t) < 18 for t in texts)
            out[column.name] = np.array(texts, dtype=np.int64) if whole else words if plain is None else plain
    return cast("pd.DataFrame", pandas.DataFrame(out))


def floats(frame: pd.DataFrame, column: str, where: object) -> NDArray[np.float64]:
    """A column of a data frame as numbers."""
    columns = {str(c): c for c in frame.columns}
    try:
        return np.asarray(frame[columns[column]], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{where}: needed numbers in column '{column}', got: {error}") from error


def text_or_numbers(table: Table, column: Column) -> tuple[list[str] | None, NDArray[np.float64] | None]:
    """A column as numbers where it is of numbers, else as it is written."""
    if column.index in table.numbers_:
        return None, table.numbers_[column.index]
    try:
        return None, table.floats(column)
    except InvalidInputError:
        return list(table.fields[column.index]), None
