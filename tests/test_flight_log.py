"""Logs of flights: read, written, refused by line."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag.flight_log import FlightLog, read_flight_log, read_rows, write_flight_log


def test_round_trip_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(1)
    log = FlightLog(
        np.arange(5.0), rng.normal(size=5), rng.normal(size=5), np.array([1.5, np.nan, 3.25, np.nan, 0.1]), rng.normal(size=(5, 2)),
        rng.normal(size=5), rng.normal(size=(5, 2)),
    )  # fmt: skip
    path = tmp_path / "log.csv"
    write_flight_log(path, log)
    again = read_flight_log(path)
    for name in ("time_s", "x", "y", "readings", "velocity_m_s", "heading_deg", "truth"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))


def test_columns_by_their_usual_names_and_as_named():
    rows = list(read_rows(["# a comment", "tt;ins_lon;ins_lat;mag;ins_ve;ins_vn", "0;16.5;47.2;31.5;70;-1"]))
    assert rows[0].x == 16.5
    assert rows[0].velocity_m_s == (70.0, -1.0)
    named = list(read_rows(["when,a,b,c", "0,1,2,3"], time_s="when", x="a", y="b", value="c"))
    assert (named[0].x, named[0].value) == (1.0, 3.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,lon,lat\n0,1,2\n", "needed a column for value"),
        ("t,lon,lat,value\n0,1,2\n", "line 2: needed 4 columns as in the header, got 3"),
        ("t,lon,lat,value\n0,1,2,3\n1,,2,3\n", "line 3: needed a finite x, got ''"),
        ("t,lon,lat,value\n0,1,2,abc\n", "line 2: value: needed a number, got 'abc'"),
        ("t,lon,lat,value\n0,1,2,inf\n", "needed a finite number or none"),
        ("t,lon,lat,value\n", "needed a header and at least one row"),
    ],
)
def test_what_is_no_log_is_refused_by_line(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(geomag.GeomagError, match=message):
        read_flight_log(path)


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(geomag.MissingFileError, match="needed a file"):
        read_flight_log(tmp_path / "none.csv")
