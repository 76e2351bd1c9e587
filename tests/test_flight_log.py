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
        ("t,lon,lat,value\n0,1,2\n", "line 2: needed a readable table with 4 fields as named"),
        ("t,lon,lat,value\n0,1,2,3\n1,,2,3\n", "needed a position in every row, got x nan, y 2.0 in data row 1"),
        ("t,lon,lat,value\n0,1,2,abc\n", "column 'value': needed numbers, got 'abc' in line 2"),
        ("t,lon,lat,value\n0,1,2,inf\n", "column 'value': needed numbers, got 'inf' in line 2"),
        ("t,lon,lat,value\n", "at least one row"),
    ],
)
def test_what_is_no_log_is_refused_by_line(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(geomag.GeomagError, match=message):
        read_flight_log(path)


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(geomag.MissingFileError, match="needed an existing file"):
        read_flight_log(tmp_path / "none.csv")


def test_a_file_is_read_as_every_table(tmp_path):
    """Units in names, decimal commas, times of day and dummies are not the log's own business."""
    path = tmp_path / "log.csv"
    path.write_text(
        "UTC time;Lat (deg);Lon (deg);TMI (uT);heading;true_lon;true_lat\n"
        "23:59:59;47,1;16,2;48,5;90;16,21;47,11\n00:00:00;47,1;16,201;99999;90;16,211;47,11\n"
    )
    with pytest.warns(geomag.DataWarning, match="dummies"):
        log = read_flight_log(path)
    assert (log.time_s.tolist(), log.x.tolist(), log.y.tolist()) == ([0.0, 1.0], [16.2, 16.201], [47.1, 47.1])
    np.testing.assert_array_equal(log.readings, [48_500.0, np.nan])
    assert log.truth.tolist() == [[16.21, 47.11], [16.211, 47.11]]
