"""Marine trackline files of NCEI: MGD77 (fixed columns) and M77T (tabs).

The columns of an MGD77 data record are those of the format's documentation (Hittelman et al., The marine geophysical data exchange format
MGD77, revised 2010); implied decimals and all-nines for no value are part of it.
"""

from __future__ import annotations

import datetime as dt

import numpy as np

from geomag._errors import ReadError
from geomag.io._log_tables import Array, numbers_table
from geomag.io._numbers import number, whole
from geomag.io._text import Table

#: Name, first column from 0, length, and what a unit of its last digit is.
_FIELDS = (
    ("latitude", 27, 8, 1e-5), ("longitude", 35, 9, 1e-5), ("total_field_nt", 60, 6, 0.1), ("total_field_2_nt", 66, 6, 0.1),
    ("residual_field_nt", 72, 6, 0.1), ("observed_gravity_mgal", 90, 7, 0.1), ("free_air_anomaly_mgal", 103, 5, 0.1),
)  # fmt: skip
_RECORD = 108


def looks_like_mgd77(text: str) -> bool:
    """Whether a text has data records of MGD77, with or without its header."""
    lines = [line for line in text[:6000].split("\n") if line.strip()]
    header = bool(lines) and lines[0][:1] in "14" and "MGD77" in lines[0][:20]
    data = (
        bool(lines) and lines[0][:1] in "35" and len(lines[0].rstrip()) >= _RECORD and lines[0][12:27].strip().isdigit()
    )
    return header or data


def looks_like_m77t(text: str) -> bool:
    """Whether a text is an M77T table."""
    first = text[:400].split("\n", 1)[0].split("\t")
    return first[:1] == ["SURVEY_ID"] and {"TIMEZONE", "DATE", "TIME", "LAT", "LON"} <= set(first)


def _field(line: str, first: int, length: int) -> float:
    text = line[first : first + length].strip()
    # Nines stand for no value where they fill the field, but for a sign.
    if not text or (set(text.lstrip("+-")) <= {"9"} and len(text.lstrip("+-")) >= length - 1 and len(text) == length):
        return float("nan")
    # A blank at the end would be a digit less, and all decimals are implied.
    return float(whole(line[first : first + length].lstrip()))


def _seconds(year: int, month: int, day: int, hours: float, zone_h: float) -> float:
    return (dt.date(year, month, day).toordinal() - 719_163) * 86_400.0 + 3600.0 * (hours + zone_h)


def mgd77_table(text: str, where: str) -> Table:
    """Data records of an MGD77 file as a table; columns without any value are left out."""
    rows: list[list[float]] = []
    for row, line in enumerate(text.split("\n"), start=1):
        if line[:1] not in ("3", "5") or len(line.rstrip()) < 44 or not line[12:16].strip().isdigit():
            continue
        try:
            zone = _field(line, 9, 3)
            hour, minute = line[20:22].strip(), line[22:27].strip()
            nines = {"9"} >= set(hour) or {"9"} >= set(minute)
            clock = float("nan") if nines else whole(hour) + whole(minute) / 60_000.0
            stamp = _seconds(
                whole(line[12:16]), whole(line[16:18]), whole(line[18:20]), clock, 0.0 if np.isnan(zone) else zone
            )
            rows.append([stamp, *(_field(line, a, n) * f for _, a, n, f in _FIELDS)])
        except ValueError as error:
            raise ReadError(
                f"{where}, line {row}: needed a data record of MGD77, got {line[:60]!r} ({error})"
            ) from error
    if not rows:
        raise ReadError(f"{where}: needed data records of MGD77, got none")
    data = np.array(rows)
    # Ten-thousandths would leave rounding: values are the decimal numbers that the digits spell.
    columns = {name: np.round(data[:, k + 1], 5) for k, (name, *_) in enumerate(_FIELDS)}
    return _timed(data[:, 0], {n: c for n, c in columns.items() if not np.isnan(c).all()}, where)


def _timed(stamps: Array, columns: dict[str, Array], where: str) -> Table:
    known = {"time_s": stamps - stamps[0]} if not np.isnan(stamps).any() else {}
    return numbers_table(known | columns, where)


def m77t_table(table: Table, where: str) -> Table:
    """An M77T table with its date and time as one column, and names that carry their units."""
    names = {c.name: c for c in table.columns}
    missing = [n for n in ("TIMEZONE", "DATE", "TIME", "LAT", "LON") if n not in names]
    if missing:
        raise ReadError(f"{where}: needed the columns of M77T, got none called {', '.join(missing)}")
    columns: dict[str, Array] = {"longitude": table.floats(names["LON"]), "latitude": table.floats(names["LAT"])}
    for own, ours in (("MAG_TOT", "total_field_nt"), ("MAG_TOT2", "total_field_2_nt"), ("MAG_RES", "residual_field_nt"),
                      ("GRA_OBS", "observed_gravity_mgal"), ("FREEAIR", "free_air_anomaly_mgal")):  # fmt: skip
        if own in names and not np.isnan(c := table.floats(names[own])).all():
            columns[ours] = c
    stamps = []
    for row, (date, time, zone) in enumerate(
        zip(*(table.fields[names[k].index] for k in ("DATE", "TIME", "TIMEZONE")), strict=True)
    ):
        try:
            hours = whole(time[:2]) + number(time[2:]) / 60.0
            stamps.append(_seconds(whole(date[:4]), whole(date[4:6]), whole(date[6:8]), hours, number(zone or "0")))
        except ValueError as error:
            if date and time:
                raise ReadError(
                    f"{where}, line {table.lines[row]}: needed a date and a time, got {date!r} and {time!r}"
                ) from error
            stamps.append(float("nan"))
    return _timed(np.array(stamps), columns, where)
