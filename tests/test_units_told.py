"""What a caller knows and a file does not say: units of a log, the spacing of a map's lines, the seam of a map of arrays, a route's columns."""

from __future__ import annotations

import io
import json
import pickle

import numpy as np
import pytest

import geomag
from geomag.io import close_seam
from geomag.survey import with_line_spacing

pytest.importorskip("netCDF4", reason="needs the extra 'io'")


@pytest.fixture
def log(tmp_path):
    (tmp_path / "log.csv").write_text("time,x,y,value\n0,500.1,5100.2,48.1\n1,500.2,5100.3,48.2\n")
    return tmp_path / "log.csv"


def test_units_of_a_log_may_be_told(log):
    plain = geomag.read_track(log)
    assert (plain.x[0], plain.values[0], plain.geographic) == (500.1, 48.1, None)
    told = geomag.read_track(log, xy_unit="km", value_unit="uT")
    assert (told.x[0], told.y[0], told.values[0], told.geographic) == pytest.approx((500_100, 5_100_200, 48_100, False))
    pandas = pytest.importorskip("pandas", reason="needs the extra 'io'")
    frame = pandas.DataFrame({"x": [10.0, 10.1], "y": [45.0, 45.1], "value": [1.0, 2.0], "z": [100.0, 110.0]})
    track = geomag.io.track_from_pandas(frame, geographic=True, value_unit="mG", height="z")
    assert (track.geographic, track.values[0], track.height_m[1]) == (True, 100.0, 110.0)


def test_what_a_file_says_is_repeated_or_refused(tmp_path, log):
    (tmp_path / "said.csv").write_text("x_km,y_km,mag_nT\n500.1,5100.2,48.1\n")
    assert geomag.read_track(tmp_path / "said.csv", xy_unit="km", value_unit="nT").x[0] == 500_100.0
    for options, words in (
        ({"xy_unit": "m"}, "xy_unit: needed 'km'"),
        ({"value_unit": "uT"}, "value_unit: needed 'nT'"),
        ({"xy_unit": "deg"}, "xy_unit: needed 'km'"),
    ):
        with pytest.raises(geomag.InvalidInputError, match=words):
            geomag.read_track(tmp_path / "said.csv", **options)
    for options, words in (({"xy_unit": "nT"}, "unit of length"), ({"value_unit": "km"}, "unit of a field")):
        with pytest.raises(geomag.InvalidInputError, match=words):
            geomag.read_track(log, **options)
    (tmp_path / "degrees.csv").write_text("lon,lat,mag\n10,45,48.1\n")
    with pytest.raises(geomag.InvalidInputError, match="a unit of what column 'lon'"):
        geomag.read_track(tmp_path / "degrees.csv", xy_unit="m")


def survey(**more):
    axis = np.arange(0.0, 3000.0, 100.0)
    values = np.random.default_rng(0).normal(0.0, 30.0, (30, 30))
    return geomag.GridMap(values, axis, axis, height_m=300.0, ground_scale=0.5, name="anomaly", units="nT", **more)  # fmt: skip


def test_the_spacing_of_the_lines_goes_through_a_file(tmp_path):
    grid = survey(line_spacing_m=400.0)
    grid.save(tmp_path / "map.nc")
    for other in (geomag.GridMap.open(tmp_path / "map.nc"), geomag.read_grid(tmp_path / "map.nc"), pickle.loads(pickle.dumps(grid)), grid.with_ground_scale(0.7)):  # fmt: skip
        assert other.line_spacing_m == 400.0
    assert survey().line_spacing_m is None
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(geomag.InvalidInputError, match="line_spacing_m"):
            survey(line_spacing_m=bad)


def test_errors_of_the_lines_leave_what_the_map_knows():
    """Height and true scale were lost, so that a fix on a map in Web Mercator was wrong by the cosine of its latitude."""
    grid = with_line_spacing(survey(), 250.0)
    assert (grid.line_spacing_m, grid.height_m, grid.units) == (250.0, 300.0, "nT")
    assert grid.metres_per_unit(100.0) == (0.5, 0.5)


def test_commands_use_the_spacing_that_the_file_says(tmp_path, capsys, monkeypatch):
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    from geomag.cli import run

    survey(line_spacing_m=400.0).save(tmp_path / "map.nc")
    rows = [f"{500 + 30 * k},{700 + 40 * k},{k % 7}" for k in range(30)]
    (tmp_path / "log.csv").write_text("x_m,y_m,value\n" + "\n".join(rows) + "\n")
    assert run(["info", str(tmp_path / "map.nc")]) == 0
    assert "lines     400 m apart" in capsys.readouterr().out
    arguments = ["match", str(tmp_path / "map.nc"), str(tmp_path / "log.csv"), "--half-width-m", "300", "--json"]
    assert run(arguments) in (0, 3)
    own, err = capsys.readouterr()
    assert "lines are 400 m apart" in err
    assert run([*arguments, "--line-spacing-m", "400"]) in (0, 3)
    told, err = capsys.readouterr()
    assert (own, err) == (told, "")
    for method, said in (("posterior", True), ("iema", False)):
        monkeypatch.setattr("sys.stdin", io.StringIO("x,y,value\n" + "\n".join(rows) + "\n"))
        assert run(["stream", str(tmp_path / "map.nc"), "--method", method, "--half-width-m", "300"]) in (0, 3)
        assert ("lines are 400 m apart" in capsys.readouterr().err) is said


def test_a_map_of_arrays_is_closed_where_it_is_asked():
    x, y = np.arange(0.0, 360.0, 2.0), np.arange(-10.0, 11.0, 2.0)
    layer = 1.0 + np.random.default_rng(1).random((len(y), len(x)))
    field = 50 * np.cos(np.radians(x))[None, :] + y[:, None]
    grid = geomag.GridMap(field, x, y, geographic=True, sigma=layer, height_m=100 * layer, name="a", units="nT", line_spacing_m=5e4).with_error_model(
        nu=5.0, scale_spread=0.1, correlation=2.0, registration=0.1, distance_m=1000 * layer)  # fmt: skip
    assert np.isnan(grid.sample(359.0, 0.0))
    whole = close_seam(grid)
    assert whole.sample(-1.0, 0.0) == whole.sample(359.0, 0.0) == pytest.approx(49.985, abs=1e-3)
    assert (whole.name, whole.units, whole.line_spacing_m) == ("a", "nT", 5e4)
    for known in (whole.sigma, whole.height_m / 100, whole.error_model["distance_m"] / 1000):
        assert known.shape == whole.shape
        np.testing.assert_allclose(known[:, 5:-5], layer, rtol=1e-6)
        np.testing.assert_allclose(known[:, :5], layer[:, -5:], rtol=1e-6)
    part = geomag.GridMap(field[:, :90], x[:90], y, geographic=True)
    assert close_seam(part) is part


def test_a_route_is_read_as_a_log_is(tmp_path, capsys):
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    pyproj = pytest.importorskip("pyproj", reason="needs the extra 'geo'")
    from geomag.cli import run

    axis = np.arange(0.0, 20_000.0, 200.0)
    field = 90 * np.sin(axis / 900)[None, :] * np.cos(axis / 1100)[:, None]
    geomag.GridMap(field, 500_000 + axis, 5_200_000 + axis, sigma=2.0, units="nT", crs="EPSG:32633").save(
        tmp_path / "map.nc"
    )
    east, north = np.array([504_000.0, 516_000.0]), np.array([5_204_000.0, 5_213_000.0])
    lon, lat = pyproj.Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True).transform(east, north)

    def promised(header, rows):
        (tmp_path / "route.csv").write_text(header + "\n" + "\n".join(rows) + "\n")
        code = run(
            [
                "suitability",
                str(tmp_path / "map.nc"),
                "--route",
                str(tmp_path / "route.csv"),
                "--json",
                "--speed",
                "60",
                "--interval",
                "5",
            ]
        )
        return code, *capsys.readouterr()

    right = promised("Easting (m),Northing (m)", [f"{a},{b}" for a, b in zip(east, north, strict=True)])
    assert right[0] == 0
    assert (
        promised("wp;Y_km;X_km", [f"1;{b / 1000};{a / 1000}" for a, b in zip(east, north, strict=True)])[1] == right[1]
    )
    code, out, err = promised("Lat (deg),Lon (deg)", [f"{b:.12f},{a:.12f}" for a, b in zip(lon, lat, strict=True)])
    assert code == 0
    assert "EPSG:4326" in err or "degrees" in err
    places = [[(row["x"], row["y"]) for row in json.loads(text)["route"]] for text in (out, right[1])]
    np.testing.assert_allclose(*places, atol=0.01)
    code, _, err = promised("a,b", ["1,2", "3,4"])
    assert code == 1
    assert "--x" in err


def test_units_of_a_log_on_the_command_line(tmp_path, capsys):
    """The same fix from a log in kilometres and microtesla as from one in metres and nanotesla; what contradicts the file is refused by its option."""
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    from geomag.cli import run

    axis = np.arange(0.0, 6000.0, 50.0)
    grid = geomag.GridMap(
        90 * np.sin(axis / 400)[None, :] * np.cos(axis / 500)[:, None], axis, axis, sigma=1.0, units="nT"
    )
    grid.save(tmp_path / "map.nc")
    k = np.arange(30.0)
    x, y = 1000 + 90 * k, 2000 + 40 * k
    values = grid.sample(x + 210, y - 125)

    def matched(header, rows, *options):
        (tmp_path / "log.csv").write_text(
            header + "\n" + "\n".join(f"{a:.9f},{b:.9f},{c:.9f}" for a, b, c in rows) + "\n"
        )
        code = run(
            ["match", str(tmp_path / "map.nc"), str(tmp_path / "log.csv"), "--half-width-m", "500", "--json", *options]
        )
        return code, *capsys.readouterr()

    code, out, _ = matched("x_m,y_m,value", zip(x, y, values, strict=True))
    assert code == 0
    other = matched(
        "x,y,value", zip(x / 1000, y / 1000, values / 1000, strict=True), "--xy-unit", "km", "--value-unit", "uT"
    )
    assert other[0] == 0
    assert json.loads(other[1])["offset_m"] == pytest.approx(json.loads(out)["offset_m"], abs=0.01)
    code, _, err = matched("x_m,y_m,value_nT", zip(x, y, values, strict=True), "--value-unit", "uT")
    assert code == 1
    assert "--value-unit" in err
