"""One frame for maps and tracks: references turned, scales on the ground, mixtures refused by name."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest

import geomag

pytest.importorskip("pyproj")

from geomag.projection import AlignedWarning, align, transform, true_scale


def rough(x, y):
    """A field of waves of some kilometres."""
    return 60 * np.sin(x / 900) * np.cos(y / 1100) + 40 * np.sin((x + 2 * y) / 1700)


def utm_map(crs="EPSG:32632"):
    x = np.arange(0.0, 20_000.0, 200.0)
    return geomag.GridMap(rough(x[None, :], x[:, None]), 5e5 + x, 5e6 + x, units="nT", sigma=0.0, crs=crs)


def utm_track(geographic=True):
    """Truth in UTM, and the indicated track 400 m east, 300 m south of it."""
    k = np.arange(40.0)
    x, y = 5e5 + 6000 + 180 * k, 5e6 + 7000 + 120 * k
    values = utm_map().sample(x, y, interpolation="bicubic") + np.random.default_rng(1).normal(0, 0.5, k.size)
    px, py = x + 400, y - 300
    if geographic:
        px, py = transform(px, py, "EPSG:32632", "EPSG:4326")
    return geomag.Track(px, py, values, k, geographic=geographic)


@pytest.mark.parametrize(
    "match",
    [
        lambda g, t: geomag.match_posterior(g, t, half_width=1000.0, sigma=1.0, tolerance_m=100.0),
        lambda g, t: geomag.match_posterior_many(g, [t], half_width=1000.0, sigma=1.0, tolerance_m=100.0)[0],
        lambda g, t: geomag.match_grid(g, t, half_width=1000.0),
        lambda g, t: geomag.match_contour(g, t, starts="grid", refine=True, sigma=1.0, offset_sigma_m=500.0),
    ],
    ids=["posterior", "posterior_many", "grid", "contour"],
)
def test_a_log_in_degrees_on_a_utm_map(match):
    with pytest.warns(AlignedWarning, match=r"from WGS 84 .*to the map's WGS 84 / UTM zone 32N"):
        fix = match(utm_map(), utm_track())
    assert fix.status == "fixed"
    assert np.hypot(fix.offset_m[0] + 400, fix.offset_m[1] - 300) < 60
    assert fix.x > 4e5


def test_streaming_matchers_turn_a_whole_track_too():
    track = utm_track()
    iema = geomag.Iema(utm_map(), sigma=2.0, half_width=(1000.0, 1000.0), tolerance=(300.0, 300.0))
    posterior = geomag.PosteriorMatcher(utm_map(), half_width=1000.0, sigma=1.0, tolerance_m=100.0)
    for matcher in (iema, posterior):
        with pytest.warns(AlignedWarning):
            fix = matcher.run(track)
        assert fix.status == "fixed"
        assert np.hypot(fix.offset_m[0] + 400, fix.offset_m[1] - 300) < 300


def test_degrees_on_local_metres_are_refused_by_name():
    for call in (
        lambda g, t: geomag.match_posterior(g, t, half_width=1000.0, sigma=1.0, tolerance_m=100.0),
        lambda g, t: geomag.match_grid(g, t, half_width=1000.0),
        align,
    ):
        with pytest.raises(geomag.InvalidInputError, match="needed positions in metres as the map's, got degrees"):
            call(utm_map(crs=None), utm_track())
    metres = geomag.Track([1.0, 2.0], [1.0, 2.0], [0.0, 1.0], geographic=False)
    degrees = geomag.GridMap(np.zeros((3, 3)), [0, 1, 2.0], [0, 1, 2.0], geographic=True)
    with pytest.raises(geomag.InvalidInputError, match="needed positions in degrees as the map's, got metres"):
        align(degrees, metres)


def test_what_is_not_said_is_as_the_map():
    k = np.arange(40.0)
    track = geomag.Track(5e5 + 6000 + 180 * k, 5e6 + 7000 + 120 * k, np.zeros(40))
    assert track.geographic is None
    assert align(utm_map(), track) is track
    assert align(utm_map(), utm_track(geographic=False)).x[0] == utm_track(geographic=False).x[0]


def test_a_track_in_another_projection():
    track = utm_track(geographic=False)
    x, y = transform(track.x, track.y, "EPSG:32632", "EPSG:32633")
    other = geomag.Track(x, y, track.values, track.time_s, height_m=120.0, geographic=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = align(utm_map(), other, track_crs="EPSG:32633", quiet=True)
    np.testing.assert_allclose(back.x, track.x, atol=1e-3)
    assert back.height_m[0] == 120.0
    assert back.time_s[-1] == 39.0
    degrees = geomag.GridMap(np.zeros((3, 3)), [8, 9, 10.0], [44, 45, 46.0], geographic=True)
    assert 8 < align(degrees, other, track_crs="EPSG:32633", quiet=True).x[0] < 10
    with pytest.raises(geomag.InvalidInputError, match="crs"):
        align(utm_map(), other, track_crs="EPSG:nonsense")


def test_a_tracks_coordinates_go_with_it():
    track = utm_track()
    assert track[3:9].geographic is True
    assert pickle.loads(pickle.dumps(track)).geographic is True


def mercator(crs="EPSG:3857"):
    """A map around 10 E, 60 N, cells of 400 map units; the field is made in metres on the ground about its middle."""
    x0, y0 = transform(10.0, 60.0, "EPSG:4326", "EPSG:3857")
    axis = 400.0 * np.arange(-60, 61)
    x, y = float(x0) + axis, float(y0) + axis
    return geomag.GridMap(rough(axis[None, :] / 2, axis[:, None] / 2), x, y, sigma=0.0, crs=crs)


def test_mercator_has_its_true_scale():
    grid = true_scale(mercator())
    # At 60 N on WGS84 a metre of Web Mercator is 0.50126 m along the parallel, 0.50042 m along the meridian.
    east, north = grid.metres_per_unit(float(grid.y[60]))
    assert east == pytest.approx(0.501260, abs=2e-6)
    assert north == pytest.approx(0.500417, abs=2e-6)
    assert grid.spacing_m[0] == pytest.approx(200.5, abs=0.1)
    assert grid.metres_per_unit(float(grid.y[-1]))[0] < east < grid.metres_per_unit(float(grid.y[0]))[0]
    for method in ("bilinear", "bicubic"):
        steep, flat = (
            grid.gradient(grid.x[40], grid.y[50], interpolation=method),
            mercator().gradient(grid.x[40], grid.y[50], interpolation=method),
        )
        assert steep[0] == pytest.approx(flat[0] / grid.metres_per_unit(float(grid.y[50]))[0])
    back = pickle.loads(pickle.dumps(grid))
    np.testing.assert_array_equal(back.ground_scale, grid.ground_scale)
    assert (
        grid.with_error_model(nu=6.0, scale_spread=0.5, correlation=0.2, registration=0.0, distance_m=1.0).ground_scale
        is not None
    )


def test_an_offset_on_mercator_is_metres_on_the_ground():
    grid = true_scale(mercator())
    k = np.arange(40.0)
    x, y = grid.x[30] + 350 * k, grid.y[40] + 250 * k
    values = grid.sample(x, y, interpolation="bicubic") + np.random.default_rng(2).normal(0, 0.5, k.size)
    east, north = grid.metres_per_unit(float(y[-1]))
    track = geomag.Track(x + 800 / east, y - 500 / north, values)
    reach = (1500 / east, 1500 / north)
    for fix in (
        geomag.match_posterior(grid, track, half_width=reach, sigma=1.0, tolerance_m=100.0),
        geomag.match_grid(grid, track, half_width=reach),
        geomag.match_contour(grid, track, starts="grid", refine=True, sigma=1.0, offset_sigma_m=700.0),
    ):
        assert fix.status == "fixed"
        assert np.hypot(fix.offset_m[0] + 800, fix.offset_m[1] - 500) < 30
        assert abs(fix.x - x[-1]) < 60


def test_near_scales_and_unknown_ones_are_left():
    for grid in (
        utm_map(),
        utm_map(crs=None),
        geomag.GridMap(np.zeros((3, 3)), [0, 1, 2.0], [0, 1, 2.0], geographic=True),
    ):
        assert true_scale(grid) is grid


def test_scales_given_by_hand():
    grid = geomag.GridMap(np.zeros((3, 2)), [0.0, 1.0], [20.0, 10.0, 0.0], ground_scale=[0.2, 0.3, 0.4])
    # The rows came from north to south.
    assert grid.metres_per_unit(20.0) == (0.2, 0.2)
    assert grid.metres_per_unit(5.0) == pytest.approx((0.35, 0.35))
    assert geomag.GridMap(np.zeros((3, 2)), [0.0, 1.0], [0.0, 1.0, 2.0], ground_scale=0.5).metres_per_unit(1.0) == (
        0.5,
        0.5,
    )
    for scale in ([0.2, 0.3], [0.0, 1.0, 1.0], np.nan, np.ones((3, 3))):
        with pytest.raises(geomag.GeomagError, match="ground_scale"):
            geomag.GridMap(np.zeros((3, 2)), [0.0, 1.0], [0.0, 1.0, 2.0], ground_scale=scale)
    with pytest.raises(geomag.InvalidInputError, match="geographic"):
        geomag.GridMap(np.zeros((3, 2)), [0.0, 1.0], [0.0, 1.0, 2.0], geographic=True, ground_scale=0.5)


def test_points_that_a_projection_does_not_reach():
    with pytest.raises(geomag.InvalidInputError, match=r"point \[1\]"):
        transform([9.0, np.inf], [45.0, 0.0], "EPSG:4326", "EPSG:32632")


def test_suitability_is_in_metres_on_the_ground():
    pytest.importorskip("xarray")
    from geomag.blocks import position_bound

    axis = 100.0 * np.arange(60)
    field = rough(axis[None, :], axis[:, None])
    ground = geomag.GridMap(field, axis, axis).to_xarray()
    paper = geomag.GridMap(field, 2 * axis, 2 * axis).to_xarray()
    options = {"samples": 10, "spacing_m": 150.0, "sigma": 1.0, "map_error_m": 0.0, "tolerance_m": 50.0}
    wanted = position_bound(ground, heading_deg=[30.0], **options)
    found = position_bound(paper, heading_deg=[30.0], ground_scale=(0.5, 0.5), **options)
    for name in wanted:
        np.testing.assert_array_equal(found[name].values, wanted[name].values)
    with pytest.raises(geomag.InvalidInputError, match="ground_scale"):
        position_bound(paper, heading_deg=[30.0], ground_scale=(0.0, 0.5), **options)


@pytest.fixture
def command():
    for module in ("typer", "pandas", "xarray", "netCDF4"):
        pytest.importorskip(module)
    from geomag.cli import run

    return run


def test_a_utm_map_and_a_log_in_degrees_in_one_command(command, tmp_path, capsys):
    import json

    utm_map().to_xarray().to_netcdf(tmp_path / "map.nc")
    track = utm_track()
    rows = "\n".join(f"{a:.8f},{b:.8f},{v}" for a, b, v in zip(track.x, track.y, track.values, strict=True))
    (tmp_path / "log.csv").write_text("longitude,latitude,total_field_anomaly_nt\n" + rows)
    status = command(["match", str(tmp_path / "map.nc"), str(tmp_path / "log.csv"), "--method", "msd", "--json"])
    said = capsys.readouterr()
    assert status == 0, said.err
    assert "turned from WGS 84" in said.err
    fix = json.loads(said.out)
    assert np.hypot(fix["offset_m"][0] + 400, fix["offset_m"][1] - 300) < 60


def test_a_local_map_and_a_log_in_degrees_are_one_line_of_refusal(command, tmp_path, capsys):
    utm_map(crs=None).to_xarray().to_netcdf(tmp_path / "map.nc")
    (tmp_path / "log.csv").write_text("longitude,latitude,total_field_anomaly_nt\n9.1,45.1,3\n9.2,45.2,4\n")
    assert command(["match", str(tmp_path / "map.nc"), str(tmp_path / "log.csv")]) == 1
    said = capsys.readouterr().err
    assert "degrees" in said
    assert "metres" in said
    assert "lost" not in said
