"""Small files as they occur in the field: each gives its right value, or a refusal in words that can be acted on.

`tests/cases/README.md` says what is right for each. A column, a unit or a place taken wrongly without a word never is.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import geomag
from geomag.stream import read_csv, read_nmea
from geomag.survey import line_spacing_m, read_lines

for module in ("xarray", "netCDF4", "rasterio", "pandas"):
    pytest.importorskip(module, reason="needs the extra 'io'")

CASES = Path(__file__).parent / "cases"


def samples(name, first, last, count, **options):
    track = geomag.read_track(CASES / name, **options)
    assert len(track) == count
    for k, (x, y, value, time) in ((0, first), (-1, last)):
        assert (track.x[k], track.y[k], track.values[k], track.time_s[k]) == pytest.approx((x, y, value, time))
    return track


def log_trailing_comma():
    samples("log-trailing-comma.csv", (10.0, 45.0, 30.0, 0.0), (10.05, 45.05, 35.0, 5.0), 6)


def log_hash_in_header():
    samples("log-hash-in-header.csv", (10.0, 45.0, 30.0, 0.0), (10.05, 45.05, 35.0, 5.0), 6)


def log_semicolon():
    samples("log-semicolon.csv", (10.0, 45.0, 30.5, 0.0), (10.04, 45.04, 34.5, 4.0), 5)


def log_day_first():
    track = samples("log-day-first.csv", (10.0, 45.0, 30.0, 0.0), (10.03, 45.0, 33.0, 3.0), 4)
    assert track.time_s.tolist() == [0.0, 1.0, 2.0, 3.0]


def log_microseconds():
    track = geomag.read_track(CASES / "log-microseconds.csv")
    assert np.diff(track.time_s).tolist() == [100.0, 100.0, 100.0]
    assert track.values[0] == 980600.0


def log_iso_mixed():
    assert geomag.read_track(CASES / "log-iso-mixed.csv").time_s.tolist() == [0.0, 0.5, 1.0, 1.5]


def log_midnight():
    assert geomag.read_track(CASES / "log-midnight.csv").time_s.tolist() == [0.0, 1.0, 2.0, 3.0]


def nmea_noise():
    with pytest.warns(geomag.DataWarning, match=r"line 5 is passed over.*checksum"):
        found = list(read_nmea((CASES / "nmea-noise.txt").read_text().splitlines()))
    assert [(round(s.y, 6), s.value) for s in found] == [(48.1173, 48650.1), (48.117467, 48651.2), (48.1178, 48653.4)]
    assert all(round(s.x, 6) == 11.516667 for s in found)
    assert [s.time_s for s in found] == [43200.0, 43201.0, 43203.0]
    with pytest.warns(geomag.DataWarning, match="line 5"):
        track = geomag.read_track(CASES / "nmea-noise.txt")
    assert (track.values.tolist(), track.time_s.tolist(), track.geographic) == (
        [48650.1, 48651.2, 48653.4],
        [43200, 43201, 43203],
        True,
    )


def stream_latitude_first():
    found = list(read_csv((CASES / "stream-latitude-first.csv").read_text().splitlines()))
    assert (found[0].x, found[0].y, found[0].value) == (16.2, 46.95, 12.5)
    assert len(found) == 5


def lines_geosoft():
    with pytest.raises(geomag.InvalidInputError, match="degrees or metres"):
        read_lines(CASES / "lines-geosoft.xyz")
    lines = {str(one.line[0]): one for one in read_lines(CASES / "lines-geosoft.xyz", geographic=False).split()}
    assert list(lines) == ["L10", "T900"]
    got = [np.column_stack([one.x, one.y, one.values]).tolist() for one in lines.values()]
    assert got == [[[1000, 2000, 31.5], [1200, 2000, 33.5]], [[1050, 2100, 30.1], [1050, 2000, 30.7]]]
    named = read_lines(CASES / "lines-geosoft.xyz", x="X", y="Y", value="MAG", line="line", geographic=False)
    assert len(named.split()) == 2
    with pytest.raises(geomag.InvalidInputError, match=r"2 lines.*split"):
        geomag.read_track(CASES / "lines-geosoft.xyz")


def lines_date_line():
    lines = read_lines(CASES / "lines-date-line.csv")
    first = lines.split()[0]
    length = geomag.Track(first.x, first.y, first.values).distance_m(geographic=True)[-1]
    assert length == pytest.approx(12_000, abs=10)
    assert 400 < line_spacing_m(lines) < 550


def grid_degrees_oasis():
    pytest.importorskip("harmonica", reason="needs the extra 'survey'")
    path = CASES / "grid-degrees-oasis.grd"
    with pytest.raises(geomag.InvalidInputError, match="degrees or metres"):
        geomag.read_grid(path)
    grid = geomag.read_grid(path, geographic=True)
    np.testing.assert_allclose(grid.x, 115.5 + 0.01 * np.arange(5), atol=1e-9)
    np.testing.assert_allclose(grid.y, -32.5 + 0.01 * np.arange(4), atol=1e-9)
    assert grid.spacing_m == pytest.approx((940, 1109), abs=1)


def grid_longitude_first():
    grid = geomag.read_grid(CASES / "grid-longitude-first.nc")
    assert grid.shape == (4, 5)
    np.testing.assert_allclose(grid.x, np.linspace(8.0, 10.0, 5))
    np.testing.assert_allclose(grid.y, np.linspace(44.0, 45.5, 4))
    assert grid.sample(9.0, 45.5) == 23.0


def grid_feet_grid_mapping():
    for geographic in (None, False):
        grid = geomag.read_grid(CASES / "grid-feet-grid-mapping.nc", geographic=geographic)
        np.testing.assert_allclose([grid.x[0], grid.x[-1]], [304800.610, 305166.370], atol=1e-3)
        np.testing.assert_allclose([grid.y[0], grid.y[-1]], [60960.122, 61234.442], atol=1e-3)
        assert grid.spacing_m == pytest.approx((91.440, 91.440), abs=1e-3)
        pyproj = pytest.importorskip("pyproj", reason="needs the extra 'geo'")
        place = pyproj.Transformer.from_crs(grid.crs, "EPSG:2263", always_xy=True).transform(grid.x[0], grid.y[0])
        assert place == pytest.approx((1_000_000.0, 200_000.0), abs=1e-2)
    with pytest.raises(geomag.InvalidInputError, match="geographic=False"):
        geomag.read_grid(CASES / "grid-feet-grid-mapping.nc", geographic=True)


def grid_emag2_columns():
    path = CASES / "grid-emag2-columns.csv"
    for geographic in (None, True, False):
        with pytest.raises(geomag.InvalidInputError, match="8 columns"):
            geomag.read_grid(path, geographic=geographic)
    for columns in ((2, 3, 5), ("2", "3", "5")):
        with pytest.warns(geomag.DataWarning, match="6 of 48 values are dummies"):
            grid = geomag.read_grid(path, columns=columns, geographic=True)
        assert (grid.shape, grid.holes) == ((6, 8), 6)
        assert (grid.x[0], grid.y[0]) == (10.0, 45.0)
        assert (np.nanmin(grid.values), np.nanmax(grid.values)) == (6.0, 62.0)


def test_the_command_line_names_columns_too(capsys):
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    from geomag.cli import run

    path = str(CASES / "grid-emag2-columns.csv")
    assert run(["info", path]) == 1
    assert "--columns 2,3,5" in capsys.readouterr().err
    assert run(["info", path, "--columns", "2,3,5", "--geographic"]) == 0
    out, err = capsys.readouterr()
    assert "6 x 8 nodes" in out
    assert "6 of 48 values are dummies" in err


def grid_surfer_blanks():
    with pytest.warns(geomag.DataWarning, match="1 of 12 values are dummies"):
        grid = geomag.read_grid(CASES / "grid-surfer-blanks.xyz")
    assert (grid.shape, grid.holes, grid.geographic) == ((3, 4), 1, False)
    assert np.isnan(grid.sample(100, 100))
    assert (np.nanmin(grid.values), np.nanmax(grid.values)) == (0.0, 320.0)


def grid_base90_dummy():
    grid = geomag.read_grid(CASES / "grid-base90-dummy.gxf", geographic=False)
    assert (grid.x.tolist(), grid.y.tolist()) == ([1000, 1100, 1200, 1300, 1400], [2000, 2100, 2200, 2300])
    assert grid.holes == 1
    assert np.isnan(grid.sample(1200, 2200))
    assert (np.nanmin(grid.values), np.nanmax(grid.values), grid.sample(1000, 2000)) == (100.0, 109.5, 107.5)


def grid_rotated():
    with pytest.raises(geomag.InvalidInputError, match="rotated by 30"):
        geomag.read_grid(CASES / "grid-rotated.gxf", geographic=False)


def grid_esri():
    grid = geomag.read_grid(CASES / "grid-esri.asc", geographic=False)
    assert (grid.x.tolist(), grid.y.tolist()) == ([1050, 1150, 1250, 1350, 1450], [2050, 2150, 2250, 2350])
    assert np.isnan(grid.sample(1250, 2250))
    assert (grid.holes, grid.sample(1050, 2050)) == (1, 15.0)


def grid_no_georeference():
    for geographic in (None, True, False):
        with pytest.raises(geomag.InvalidInputError, match="georeference"):
            geomag.read_grid(CASES / "grid-no-georeference.tif", geographic=geographic)


def grid_global_0_358():
    grid = geomag.read_grid(CASES / "grid-global-0-358.nc")
    for longitude in (359.0, -1.0):
        assert grid.sample(longitude, 0.0) == pytest.approx(49.985, abs=1e-3)


def web_mercator():
    pytest.importorskip("pyproj", reason="needs the extra 'geo'")
    grid = geomag.read_grid(CASES / "map-web-mercator.tif")
    assert grid.spacing_m == pytest.approx((200.0, 200.0), rel=0.02)
    track = geomag.read_track(CASES / "log-web-mercator.csv")
    east, north = grid.metres_per_unit(float(track.y[-1]))
    fix = geomag.match_grid(grid, track, half_width=(1500 / east, 1500 / north), criterion="msd")
    assert fix.ok
    assert fix.offset_m == pytest.approx((-800.0, 500.0), abs=30.0)
    assert (fix.x, fix.y) == pytest.approx((1116886.7, 8401955.4), abs=60.0)


def z_is_height():
    grid, track = geomag.read_grid(CASES / "map-z.nc"), geomag.read_track(CASES / "log-z-is-height.csv")
    assert_fixed(grid, track)


def gravity():
    grid = geomag.read_grid(CASES / "map-gravity.nc")
    with pytest.raises(geomag.UnknownVariableError, match=r"total_field_anomaly_nt, free_air_anomaly_mgal.*value="):
        geomag.read_track(CASES / "log-two-fields.csv")
    assert_fixed(grid, geomag.read_track(CASES / "log-two-fields.csv", grid=grid))
    with pytest.raises(geomag.InvalidInputError, match="mGal"):
        geomag.read_track(CASES / "log-two-fields.csv", value="total_field_anomaly_nt", grid=grid)


def assert_fixed(grid, track):
    east, north = grid.metres_per_unit(float(track.y[-1]))
    fix = geomag.match_grid(grid, track, half_width=(1500 / east, 1500 / north), criterion="msd")
    assert fix.ok
    assert fix.offset_m == pytest.approx((-304.0, 334.0), abs=10.0)


def local_metres():
    grid = geomag.read_grid(CASES / "map-local-metres.nc")
    with pytest.raises(geomag.InvalidInputError, match="in metres as the map's"):
        geomag.read_track(CASES / "log-degrees.csv", grid=grid)
    with pytest.raises(geomag.InvalidInputError, match="in metres as the map's"):
        geomag.match_posterior(grid, geomag.read_track(CASES / "log-degrees.csv"), half_width=500.0, sigma=2.0)


#: Every file of tests/cases, and what is checked of it.
TABLE = {
    "log-trailing-comma.csv": log_trailing_comma,
    "log-hash-in-header.csv": log_hash_in_header,
    "log-semicolon.csv": log_semicolon,
    "log-day-first.csv": log_day_first,
    "log-microseconds.csv": log_microseconds,
    "log-iso-mixed.csv": log_iso_mixed,
    "log-midnight.csv": log_midnight,
    "nmea-noise.txt": nmea_noise,
    "stream-latitude-first.csv": stream_latitude_first,
    "lines-geosoft.xyz": lines_geosoft,
    "lines-date-line.csv": lines_date_line,
    "grid-degrees-oasis.grd": grid_degrees_oasis,
    "grid-longitude-first.nc": grid_longitude_first,
    "grid-feet-grid-mapping.nc": grid_feet_grid_mapping,
    "grid-emag2-columns.csv": grid_emag2_columns,
    "grid-surfer-blanks.xyz": grid_surfer_blanks,
    "grid-base90-dummy.gxf": grid_base90_dummy,
    "grid-rotated.gxf": grid_rotated,
    "grid-esri.asc": grid_esri,
    "grid-no-georeference.tif": grid_no_georeference,
    "grid-global-0-358.nc": grid_global_0_358,
    "map-web-mercator.tif": web_mercator,
    "log-web-mercator.csv": web_mercator,
    "map-z.nc": z_is_height,
    "log-z-is-height.csv": z_is_height,
    "map-gravity.nc": gravity,
    "log-two-fields.csv": gravity,
    "map-local-metres.nc": local_metres,
    "log-degrees.csv": local_metres,
}


def test_every_file_is_in_the_table():
    assert {p.name for p in CASES.iterdir() if p.suffix != ".md"} == set(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_case(name):
    TABLE[name]()
