"""Map and log in another frame, at another height, with dates: each right in one command and in one call."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

for _module in ("typer", "pandas", "xarray", "netCDF4", "pyproj", "ppigrf"):
    pytest.importorskip(_module)

import pandas as pd  # noqa: E402

import geomag  # noqa: E402
from geomag.cli import run  # noqa: E402
from geomag.diurnal import DiurnalReduction, read_iaga2002  # noqa: E402
from geomag.mainfield import load  # noqa: E402
from geomag.projection import convergence_deg, transform, true_scale  # noqa: E402
from geomag.reduction import MagneticReduction, Reductions, match_with_reduction  # noqa: E402

UTM, MERCATOR = "EPSG:32632", "EPSG:3857"


def crust(seed=3, count=50):
    """A field over a plane in metres that falls with height."""
    rng = np.random.default_rng(seed)
    waves = [(rng.normal(0, 14), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(700, 9000, count)]

    def field(x, y, height=0.0):
        x, y, height = np.broadcast_arrays(x, y, height)
        return sum(a * np.exp(-k * height) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)

    return field


def saved(grid, path):
    grid.to_xarray().to_netcdf(path)
    return path


def of_another_program(grid, path):
    """The map as others write it: values on axes, and a grid mapping with the reference system."""
    import pyproj
    import xarray as xr

    data = xr.Dataset({"anomaly": (("y", "x"), np.asarray(grid.values), {"units": "nT", "grid_mapping": "crs"})})
    data = data.assign_coords(x=grid.x, y=grid.y).assign(crs=((), 0, {"crs_wkt": pyproj.CRS(grid.crs).to_wkt()}))
    data.to_netcdf(path)
    return path


def utm_map(field, **more):
    x, y = np.arange(640e3, 660e3, 100.0), np.arange(5.20e6, 5.22e6, 100.0)
    return geomag.GridMap(field(x, y[:, None]), x, y, sigma=0.5, crs=UTM, name="anomaly_nt", units="nT", **more)


def call(capsys, *arguments):
    status = run([str(a) for a in arguments])
    out = capsys.readouterr()
    return status, out.out, out.err


def log_of(grid, field, n=60, height=None, main=None, spread_days=0.0, offset_m=(420.0, -310.0)):
    """A flight in degrees over a UTM map, the INS off by an offset; raw readings where a main field is told."""
    x, y = np.linspace(645e3, 653e3, n), np.linspace(5.206e6, 5.213e6, n)
    when = np.datetime64("2026-03-30T22:00:00") + (np.linspace(0, max(86400 * spread_days, 1200.0), n) * 1e6).astype(
        "timedelta64[us]"
    )
    lon, lat = transform(x, y, UTM, "EPSG:4326")
    readings = (
        field(x, y, 0.0 if height is None else height - 100.0) + 12.0 + np.random.default_rng(5).normal(0, 0.3, n)
    )
    if main is not None:
        readings = readings + load(main).total(lon, lat, 100.0 if height is None else height, when)
    ilon, ilat = transform(x - offset_m[0], y - offset_m[1], UTM, "EPSG:4326")
    table = pd.DataFrame({"utc": when, "longitude": ilon, "latitude": ilat, "tmi_nt": readings})
    if height is not None:
        table["h"] = height
    return table, (x, y)


def test_utm_map_and_log_in_degrees(tmp_path, capsys):
    field = crust()
    grid = utm_map(field)
    table, (x, y) = log_of(grid, field)
    table.to_csv(tmp_path / "log.csv", index=False)
    status, out, err = call(capsys, "match", saved(grid, tmp_path / "map.nc"), tmp_path / "log.csv",
                            "--half-width-m", 1000, "--sigma", 0.5, "--tolerance-m", 100, "--json")  # fmt: skip
    fix = json.loads(out)
    assert status == 0
    assert "turned from" in err
    assert np.hypot(fix["x"] - x[-1], fix["y"] - y[-1]) < 30
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        track = geomag.Track(table.longitude, table.latitude, table.tmi_nt, geographic=True)
        here = geomag.match_posterior(grid, track, half_width=1000, sigma=0.5, tolerance_m=100)
    assert here.ok
    assert np.hypot(here.x - x[-1], here.y - y[-1]) < 30


def test_web_mercator_map_at_sixty_north(tmp_path, capsys):
    field = crust(4)
    # Two metres on paper are one on the ground.
    x, y = np.arange(1.10e6, 1.14e6, 200.0), np.arange(8.39e6, 8.43e6, 200.0)
    bare = geomag.GridMap(field(x / 2, y[:, None] / 2), x, y, sigma=0.5, crs=MERCATOR, units="nT")
    grid = true_scale(bare)
    n = 60
    tx, ty = np.linspace(1.110e6, 1.126e6, n), np.linspace(8.402e6, 8.416e6, n)
    readings = field(tx / 2, ty / 2) + np.random.default_rng(1).normal(0, 0.3, n)
    lon, lat = transform(tx - 840, ty + 620, MERCATOR, "EPSG:4326")
    pd.DataFrame({"longitude": lon, "latitude": lat, "value": readings}).to_csv(tmp_path / "log.csv", index=False)
    written = of_another_program(bare, tmp_path / "map.nc")
    status, out, err = call(capsys, "match", written, tmp_path / "log.csv", "--half-width-m", 1000, "--sigma", 0.5, "--tolerance-m", 100,
                            "--map-sigma", 0.5, "--json")  # fmt: skip
    assert status == 0, err
    fix = json.loads(out)
    assert np.allclose(fix["offset_m"], [420.0, -310.0], atol=15)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        track = geomag.Track(lon, lat, readings, geographic=True)
        units = 1000 / np.array(grid.metres_per_unit(float(ty[-1])))
        here = geomag.match_posterior(grid, track, half_width=tuple(units), sigma=0.5, tolerance_m=100)
    assert np.allclose(here.offset_m, fix["offset_m"], atol=1.0)


def test_map_at_another_height(tmp_path, capsys):
    field = crust(5)
    table, (x, y) = log_of(utm_map(field), field, height=np.linspace(250, 420, 60))
    table.to_csv(tmp_path / "log.csv", index=False)
    told = ["--half-width-m", 1000, "--sigma", 0.5, "--tolerance-m", 100, "--json"]
    high = saved(utm_map(field, height_m=100.0), tmp_path / "map.nc")
    status, out, _ = call(capsys, "match", high, tmp_path / "log.csv", "--height-m", "h", *told)
    fix = json.loads(out)
    assert status == 0
    assert np.hypot(fix["x"] - x[-1], fix["y"] - y[-1]) < 40
    assert fix["heights_m"] == [250.0, 420.0]
    bare = saved(utm_map(field), tmp_path / "bare.nc")
    status, out, _ = call(capsys, "match", bare, tmp_path / "log.csv", "--height-m", "h", "--map-height-m", 100, *told)
    assert json.loads(out)["offset_m"] == pytest.approx(fix["offset_m"])
    status, _, err = call(capsys, "match", bare, tmp_path / "log.csv", "--height-m", "h", *told)
    assert status not in (0, 3)
    assert "--map-height-m" in err


@pytest.mark.parametrize("days", [0.0, 2.5])
def test_raw_log_with_a_range_of_dates(tmp_path, capsys, days):
    field = crust(6)
    grid = utm_map(field, height_m=100.0)
    table, (x, y) = log_of(grid, field, height=np.full(60, 300.0), main="igrf14", spread_days=days)
    table.to_csv(tmp_path / "log.csv", index=False)
    status, out, err = call(capsys, "match", saved(grid, tmp_path / "map.nc"), tmp_path / "log.csv", "--main-field", "igrf14", "--height-m", "h",
                            "--half-width-m", 1000, "--sigma", 0.5, "--tolerance-m", 100, "--json")  # fmt: skip
    assert status == 0, err
    fix = json.loads(out)
    assert np.hypot(fix["x"] - x[-1], fix["y"] - y[-1]) < 40
    main = MagneticReduction(table.utc.to_numpy(), 300.0)
    found = match_with_reduction(
        grid, table.longitude, table.latitude, table.tmi_nt, main, height_m=np.full(60, 300.0),
        matcher=geomag.match_posterior, half_width=1000, sigma=0.5, tolerance_m=100,
    )  # fmt: skip
    assert found.fix.ok
    assert found.converged
    assert found.fix.offset_m == pytest.approx(fix["offset_m"], abs=2.0)
    # Reduced at the places that were found, readings are the map's, but for the bias.
    at = grid.continue_to(300.0).sample(x, y)
    assert np.std(found.values - at) < 1.0


def test_dates_beyond_a_model_and_logs_without_dates_are_refused(tmp_path, capsys):
    field = crust(6)
    grid = saved(utm_map(field), tmp_path / "map.nc")
    table, _ = log_of(utm_map(field), field, main="igrf14")
    late = table.assign(utc=table.utc + np.timedelta64(3650, "D"))
    late.to_csv(tmp_path / "late.csv", index=False)
    status, _, err = call(capsys, "match", grid, tmp_path / "late.csv", "--main-field", "igrf14")
    assert status not in (0, 3)
    assert "2036" in err
    table.drop(columns="utc").to_csv(tmp_path / "bare.csv", index=False)
    status, _, err = call(capsys, "match", grid, tmp_path / "bare.csv", "--main-field", "igrf14")
    assert status not in (0, 3)
    assert "dates" in err
    table.assign(utc=np.arange(60.0)).to_csv(tmp_path / "seconds.csv", index=False)
    status, _, err = call(capsys, "match", grid, tmp_path / "seconds.csv", "--main-field", "igrf14")
    assert status not in (0, 3)
    assert "since 1970" in err
    status, _, err = call(capsys, "match", grid, tmp_path / "bare.csv", "--date", "2026-03-31")
    assert "--main-field" in err
    status, out, err = call(
        capsys, "match", grid, tmp_path / "bare.csv", "--main-field", "igrf14", "--date", "2026-03-31"
    )
    assert "main field" in out
    assert "igrf14" in out


def base_record(path, start="2026-03-30T00:00:00", days=3):
    head = {"Format": "IAGA-2002", "Geodetic Latitude": "47.0", "Geodetic Longitude": "11.0", "Reported": "F"}
    text = "".join(f" {k:<23}{v:<45}|\n" for k, v in head.items()) + "DATE       TIME         DOY     SMWF   |\n"
    minutes = np.arange(24 * 60 * days)
    values = 48_000 + 40 * np.sin(2 * np.pi * minutes / 1440) + 12 * np.sin(2 * np.pi * minutes / 17)
    for k, v in zip(minutes, values, strict=True):
        when = (np.datetime64(start) + np.timedelta64(int(k), "m")).item()
        text += f"{when:%Y-%m-%d %H:%M:%S}.000 {when:%j}   {v:10.2f}\n"
    path.write_text(text)
    return path


def test_base_station_in_the_same_command(tmp_path, capsys):
    field = crust(7)
    grid = utm_map(field)
    table, (x, y) = log_of(grid, field, main="wmm2025")
    base = read_iaga2002(base_record(tmp_path / "base.min")).base()
    lon = table.longitude.to_numpy()
    table["tmi_nt"] += base.variation(table.utc.to_numpy(), lon)
    table.to_csv(tmp_path / "log.csv", index=False)
    told = ["--main-field", "wmm2025", "--height-m", 100, "--half-width-m", 1000, "--sigma", 0.5, "--tolerance-m", 100]
    path = saved(grid, tmp_path / "map.nc")
    status, out, err = call(capsys, "match", path, tmp_path / "log.csv", *told, "--base", tmp_path / "base.min")
    assert status == 0, err
    assert "variation" in out
    assert "wmm2025" in out
    parts = Reductions(
        MagneticReduction(table.utc.to_numpy(), 100.0, "wmm2025"), DiurnalReduction(base, table.utc.to_numpy())
    )
    found = match_with_reduction(
        grid, lon, table.latitude, table.tmi_nt, parts, matcher=geomag.match_posterior, half_width=1000, sigma=0.5, tolerance_m=100
    )  # fmt: skip
    assert np.hypot(found.fix.x - x[-1], found.fix.y - y[-1]) < 30


def flight(field, n=900):
    """A raw flight of a quarter of an hour over the UTM map at 300 m, in degrees, with velocity and heading of true north."""
    time = np.arange(float(n))
    course = np.radians(52.0)
    x, y = 642e3 + 12 * np.sin(course) * time, 5.204e6 + 12 * np.cos(course) * time
    lon, lat = transform(x, y, UTM, "EPSG:4326")
    when = np.datetime64("2026-03-30T23:52:00") + (time * 1e6).astype("timedelta64[us]")
    raw = field(x, y, 200.0) + load("igrf14").total(lon, lat, 300.0, when)
    ilon, ilat = transform(x - 90, y + 60, UTM, "EPSG:4326")
    turn = convergence_deg(UTM, ilon, ilat)
    true = np.degrees(course) + turn
    east, north = 12 * np.sin(np.radians(true)), 12 * np.cos(np.radians(true))
    table = pd.DataFrame(
        {
            "time": when,
            "longitude": ilon,
            "latitude": ilat,
            "tmi_nt": raw,
            "ve": east,
            "vn": north,
            "heading": true,
            "h": 300.0,
        }
    )
    return table, (x, y)


def test_navigate_raw_log_in_degrees_over_a_utm_map_at_another_height(tmp_path, capsys):
    field = crust(8)
    grid = utm_map(field, height_m=100.0)
    table, (x, y) = flight(field)
    table.to_csv(tmp_path / "log.csv", index=False)
    status, out, err = call(capsys, "navigate", saved(grid, tmp_path / "map.nc"), tmp_path / "log.csv", "--main-field", "igrf14",
                            "--height-m", "h", "--value", "tmi_nt", "--json", "--out", tmp_path / "track.csv")  # fmt: skip
    assert status == 0, err
    assert "turned from" in err
    told = pd.read_csv(tmp_path / "track.csv")
    late = np.hypot(told.x - x, told.y - y)[300:]
    assert late.median() < 25
    when, height = table.time.to_numpy(), table.h.to_numpy()
    reduced = table.tmi_nt + MagneticReduction(when, height).correction(
        table.longitude.to_numpy(), table.latitude.to_numpy(), None
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        here = geomag.navigate(
            grid, np.arange(900.0), table.longitude, table.latitude, velocity_m_s=table[["ve", "vn"]].to_numpy(),
            heading_deg=table.heading, readings=reduced, height_m=height, geographic=True,
        )  # fmt: skip
    assert np.median(np.hypot(*here.error_m(x, y).T)[300:]) < 25
    assert json.loads(out)["status"] == "tracking"
