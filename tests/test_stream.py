"""Samples from a pipe, fixes to a pipe."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.stream import _FIELDS, Sample, read_csv, read_nmea, run


@pytest.fixture(scope="module")
def scene():
    field = synthetic.Crust().draw((0, 0, 40_000, 30_000), seed=7)
    grid = field.grid(500.0)
    path = synthetic.Path.straight((9_000, 7_000), course_deg=60, speed_m_s=60, interval_s=8, samples=40)
    ins = synthetic.InsError(position_m=(-800.0, 500.0))
    return grid, synthetic.fly(field, path, ins=ins, sensor=synthetic.Sensor(sigma=2.0)).track


MATCHERS = {
    "iema": lambda grid: geomag.Iema(grid, sigma=5.0, half_width=2000.0, tolerance=1000.0, max_misses=3),
    "posterior": lambda grid: geomag.PosteriorMatcher(grid, half_width=2000.0, sigma=5.0, tolerance_m=500.0),
    "contour": lambda grid: geomag.SlidingContour(
        grid, length=10, sigma=5.0, starts="grid", half_width_m=2000.0, offset_sigma_m=1000.0, refine=True
    ),
}


@pytest.mark.parametrize("restart", [True, False])
@pytest.mark.parametrize("name", MATCHERS)
def test_every_streaming_matcher_runs(scene, name, restart):
    grid, track = scene
    samples = [Sample(*s) for s in zip(track.x, track.y, track.values, track.time_s, strict=True)]
    out = io.StringIO()
    last = run(MATCHERS[name](grid), samples, out, restart=restart)
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [line["time_s"] for line in lines] == list(track.time_s)
    by_hand = MATCHERS[name](grid)
    given = None
    for line, s in zip(lines, samples, strict=True):
        step = by_hand.update(s.x, s.y, s.value)
        fix = step if isinstance(step, geomag.Fix) else step.fix
        assert set(line) == {*_FIELDS, "time_s"}
        assert line["status"] == (step if fix is None else fix).status
        assert line["ok"] == (fix is not None and fix.ok)
        assert (line["n_samples"] is None) == (fix is None)
        given = given if fix is None else fix
        if restart and name != "contour" and fix is not None and fix.status in ("fixed", "lost"):
            by_hand.reset()
    assert any(line["ok"] for line in lines)
    assert set(_FIELDS) == set(last.to_dict())
    assert repr(last) == repr(given)


def sentence(body):
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}"


GGA = "GPGGA,120030.50,4807.0380,N,01131.0000,W,1,08,0.9,545.4,M,46.9,M,,"
RMC = "GPRMC,120031,A,3351.6500,S,15112.6000,E,0,0,010126,,"


def test_a_lost_posterior_begins_anew_and_says_so(scene):
    grid, track = scene
    rng = np.random.default_rng(3)
    wrong = [Sample(track.x[k], track.y[k], float(rng.uniform(-1e4, 1e4))) for k in range(25)]
    right = [Sample(*s) for s in zip(track.x, track.y, track.values, strict=True)]

    def lines(samples):
        out = io.StringIO()
        run(geomag.PosteriorMatcher(grid, half_width=2000.0, sigma=5.0, tolerance_m=500.0), samples, out)
        return [json.loads(line) for line in out.getvalue().splitlines()]

    said = lines(wrong)
    lost = [k for k, line in enumerate(said) if line["status"] == "lost"]
    assert lost
    assert all(said[k]["restarted"] for k in lost)
    assert not any("restarted" in line for line in said if line["status"] != "lost")
    # After the restart it is as if the nonsense had never been.
    fresh = lines(right)
    assert any(line["ok"] for line in fresh)
    assert lines(wrong[: lost[-1] + 1] + right)[lost[-1] + 1 :] == fresh


def test_nmea_gives_the_samples():
    lines = [sentence(GGA), sentence("PGMAG,48123.5"), sentence("GPGSV,1,1,00"), sentence(RMC),
             sentence("PGMAG,-12.25"), "noise"]  # fmt: skip
    first, second = read_nmea(lines)
    assert (first.x, first.y, first.value) == pytest.approx((-(11 + 31 / 60), 48 + 7.038 / 60, 48123.5))
    assert first.time_s == pytest.approx(12 * 3600 + 30.5)
    assert (second.x, second.y) == pytest.approx((151 + 12.6 / 60, -(33 + 51.65 / 60)))
    with pytest.warns(geomag.DataWarning, match="line 1 is passed over.*needed checksum"):
        assert list(read_nmea(["$PGMAG,1.0*00"])) == []


@pytest.mark.parametrize(
    "void",
    [
        RMC.replace(",A,", ",V,"),
        RMC + ",N",
        "GPRMC,120031,V,,,,,,,010126,,",
        "GPRMC,120031,A,,,,,,,010126,,",
        GGA.replace(",W,1,", ",W,0,"),
        GGA.replace(",W,1,", ",W,,"),
        "GPGGA,,,,,,0,,,,,,,,",
    ],
)
def test_a_void_position_is_none(void):
    """Nor may the readings after it be laid to the position before."""
    lines = [sentence(s) for s in (GGA, "PGMAG,1", "PGMAG,", void, "PGMAG,2", RMC, "PGMAG,3")]
    assert [s.value for s in read_nmea(lines)] == [1.0, 3.0]
    assert [s.value for s in read_nmea(lines[3:])] == [3.0]


@pytest.mark.parametrize(
    "wrong",
    [
        GGA.replace("4807.0380,N", "4807.0380,X"),
        GGA.replace("4807.0380,N", "4807.0380,"),
        GGA.replace("4807.0380", "4867.0380"),
        GGA.replace("4807.0380", "9807.0380"),
        GGA.replace("01131.0000", "18131.0000"),
        GGA.replace("01131.0000", "011nan"),
        "GPGGA,120030.50,4807.0380,N",
        "PGMAG,nan",
        "PGMAG,x",
        "PGMAG",
    ],
)
def test_a_sentence_that_cannot_be_is_passed_over_and_told(wrong):
    """The stream goes on; a reading after a garbled position is not laid to the old one."""
    lines = [sentence(s) for s in (GGA, wrong, "PGMAG,7", RMC, "PGMAG,8")]
    with pytest.warns(geomag.DataWarning, match="line 2 is passed over: needed an NMEA sentence"):
        found = [s.value for s in read_nmea(lines)]
    assert found == ([7.0, 8.0] if wrong.startswith("PGMAG") else [8.0])


def test_times_of_day_go_on_over_midnight():
    late = GGA.replace("120030.50", "235959.00")
    lines = [sentence(s) for s in (late, "PGMAG,1", GGA.replace("120030.50", "000000.00"), "PGMAG,2")]
    assert [s.time_s for s in read_nmea(lines)] == [86399.0, 86400.0]
    clock = ["time,lon,lat,value", "23:59:59.5,10,45,1", "00:00:00.0,10,45,2", "2026-01-01,10,45"]
    with pytest.warns(geomag.DataWarning, match="line 4"):
        assert [s.time_s for s in read_csv(clock)] == [86399.5, 86400.0]


@pytest.fixture
def folder(tmp_path, scene):
    for module in ("typer", "xarray"):
        pytest.importorskip(module, reason="needs the extras 'cli' and 'io'")
    scene[0].to_xarray().to_netcdf(tmp_path / "map.nc")
    return tmp_path


def test_noise_on_the_line_is_passed_over_and_told(folder):
    done = subprocess.run(
        [sys.executable, "-m", "geomag", "stream", "map.nc"],
        cwd=folder, input=b"9000,7000,5\n9000,\xff,5\n", capture_output=True, check=False,
        env={**os.environ, "PYTHONIOENCODING": "utf-8:strict"},
    )  # fmt: skip
    assert done.returncode == 3
    assert b"line 2" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert len(done.stdout.splitlines()) == 1


def test_csv_lines():
    assert [s.value for s in read_csv(["x,y,value", "1,2,3", "# note", "1,2,4"])] == [3.0, 4.0]
    assert list(read_csv(["0,1,2,4"])) == [Sample(1.0, 2.0, 4.0, 0.0)]
    assert list(read_csv(["1,5;2,5;3,5"])) == [Sample(1.5, 2.5, 3.5)]
    assert list(read_csv(["1,5 2,5 3,5"])) == [Sample(1.5, 2.5, 3.5)]


@pytest.mark.parametrize(
    "bad", ["1,2", "1,2,nan", "1,2,*", "1,2,", "a,b,c", "1,2,3,inf", "1,2,99999", "1,2,-1e32", "1_0,2,3", "\x00\x01"]
)
def test_a_bad_line_is_passed_over_and_told(bad):
    with pytest.warns(geomag.DataWarning, match="line 2 is passed over"):
        assert [s.value for s in read_csv(["1,2,3", bad, "1,2,4"])] == [3.0, 4.0]


def test_a_csv_header_may_follow_comments_and_is_not_a_spoilt_sample():
    assert list(read_csv(["# log", "", "x,y,value", "1,2,3"])) == [Sample(1.0, 2.0, 3.0)]
    assert list(read_csv(["\ufeff1,2,3"])) == [Sample(1.0, 2.0, 3.0)]
    for spoilt in (["1,2,3x"], ["x,y,value", "x,y,value"]):
        with pytest.warns(geomag.DataWarning, match=f"line {len(spoilt)}"):
            assert list(read_csv(spoilt)) == []


def test_a_csv_header_names_the_columns():
    assert list(read_csv(["x,y,value,time_s", "1,2,3,4"])) == [Sample(1.0, 2.0, 3.0, 4.0)]
    assert list(read_csv(["Latitude;Longitude;tmi_1", "1;2;3"])) == [Sample(2.0, 1.0, 3.0)]
    assert list(read_csv(["line,x,y,field", "7,1,2,3"])) == [Sample(1.0, 2.0, 3.0)]
    assert list(read_csv(["X_km,Y_km,mag_uT,time_us", "1,2,3,4000000"])) == [Sample(1000.0, 2000.0, 3000.0, 4.0)]
    for header in (
        "x,value,height",
        "x,y,one,two",
        "a,b",
        "a,b,c",
        "a,b,c,d,e",
        "x,y,z",
        "lon,lat,anomaly,tmi",
        "lon,longitude,lat,mag",
    ):
        with pytest.raises(geomag.InvalidInputError, match="line 1: needed columns"):
            list(read_csv([header, "1,2,3"]))
    with pytest.warns(geomag.DataWarning, match="line 2.*needed 4 columns"):
        assert list(read_csv(["x,y,value,time_s", "1,2,3"])) == []


def test_a_table_of_a_track_streams_as_the_track(scene):
    pytest.importorskip("pandas")
    from geomag import exchange

    track = scene[1]
    samples = list(read_csv(exchange.track_to_pandas(track).to_csv(index=False).splitlines()))
    for name, values in (("x", track.x), ("y", track.y), ("value", track.values), ("time_s", track.time_s)):
        assert np.array_equal([getattr(s, name) for s in samples], values)
