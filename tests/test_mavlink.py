"""Fixes as MAVLink messages, read back by pymavlink."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

import geomag

mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="needs the extra 'mavlink'")


@pytest.fixture(scope="module")
def scene():
    x, y = 16.0 + 0.001 * np.arange(120), 47.0 + 0.001 * np.arange(100)
    field = (
        90 * np.sin(np.arange(120) / 5)[None, :] * np.cos(np.arange(100) / 7)[:, None]
        + 5 * np.arange(120)[None, :] ** 0.5
    )
    grid = geomag.GridMap(field, x, y, geographic=True, sigma=0.0)
    k = np.arange(30.0)
    px, py = 16.03 + 0.0015 * k, 47.03 + 0.0011 * k
    track = geomag.Track(px - 0.003, py + 0.002, grid.sample(px, py))
    fix = geomag.match_posterior(grid, track, half_width=(0.01, 0.01), sigma=2.0, tolerance_m=100.0)
    assert fix.ok
    return grid, track, fix


def messages(data):
    return list(mavlink.MAVLink(None).parse_buffer(data))


def test_a_fix_goes_out_with_its_covariance(scene):
    from geomag.mavlink import Encoder

    _, _, fix = scene
    position, command = messages(Encoder(system=7).encode(fix, 1000.25))
    assert (position.get_type(), position.get_srcSystem(), position.time_usec) == (
        "GLOBAL_POSITION_INT_COV",
        7,
        1_000_250_000,
    )
    assert (position.lat, position.lon) == (round(1e7 * fix.y), round(1e7 * fix.x))
    c = np.asarray(fix.covariance_m2)
    got = np.reshape(position.covariance, (6, 6))[:2, :2]
    np.testing.assert_allclose(got, c[::-1, ::-1], rtol=1e-6)
    assert command.command == mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE
    assert (command.x, command.y, command.param1) == (position.lat, position.lon, pytest.approx(1000.25 % 250))
    assert command.param3 == pytest.approx(math.sqrt(np.trace(c) / 2), rel=1e-6)


def test_what_is_no_fix_is_not_sent(scene):
    from geomag.mavlink import Encoder

    grid, track, _ = scene
    poor = geomag.match_posterior(grid, track[:3], half_width=(0.01, 0.01), sigma=50.0, tolerance_m=10.0)
    assert not poor.ok
    assert Encoder().encode(poor) == b"" == Encoder().encode(None)
    metres = geomag.GridMap(grid.values, 1000.0 * np.arange(120), 1000.0 * np.arange(100), sigma=0.0)
    k = np.arange(30.0)
    px, py = 30_000 + 1500 * k, 30_000 + 1100 * k
    there = geomag.match_posterior(
        metres, geomag.Track(px, py, metres.sample(px, py)), half_width=5000.0, sigma=2.0, tolerance_m=1000.0
    )
    with pytest.raises(geomag.InvalidInputError, match="map in metres"):
        Encoder().encode(there)
    with pytest.raises(geomag.InvalidInputError, match="0 to 255"):
        Encoder(system=300)


def test_the_stream_command_writes_messages(tmp_path, scene):
    for module in ("typer", "xarray", "netCDF4"):
        pytest.importorskip(module, reason="needs the extras 'cli' and 'io'")
    grid, track, _ = scene
    grid.save(tmp_path / "map.nc")
    lines = (
        "lon,lat,mag_nT\n"
        + "\n".join(f"{a},{b},{c}" for a, b, c in zip(track.x, track.y, track.values, strict=True))
        + "\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "geomag", "stream", str(tmp_path / "map.nc"), "--sigma", "2", "--half-width-m", "900", "--tolerance-m", "100", "--output", "mavlink"],
        input=lines.encode(), capture_output=True, check=False, env=dict(os.environ),
    )  # fmt: skip
    assert done.stderr == b""
    kinds = [m.get_type() for m in messages(done.stdout)]
    assert kinds[:2] == ["GLOBAL_POSITION_INT_COV", "COMMAND_INT"]


def test_a_map_in_metres_is_told_by_its_system(scene):
    """The position is that of the fix, turned to degrees."""
    pyproj = pytest.importorskip("pyproj", reason="needs the extra 'geo'")
    axis = np.arange(0.0, 12_000.0, 100.0)
    field = 90 * np.sin(axis / 700)[None, :] * np.cos(axis / 900)[:, None] + 40 * np.sin(axis / 400)[:, None]
    grid = geomag.GridMap(field, 500_000 + axis, 5_200_000 + axis, sigma=0.0, crs="EPSG:32633")
    k = np.arange(40.0)
    x, y = 503_000 + 90 * k, 5_203_000 + 70 * k
    fix = geomag.match_posterior(
        grid, geomag.Track(x - 150, y + 90, grid.sample(x, y)), half_width=600.0, sigma=1.0, tolerance_m=100.0
    )
    assert fix.ok
    from geomag.mavlink import Encoder

    sent = messages(Encoder(crs=grid.crs).encode(fix))[0]
    there = pyproj.Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True).transform(fix.x, fix.y)
    assert (sent.lon * 1e-7, sent.lat * 1e-7) == pytest.approx(there, abs=1e-6)
