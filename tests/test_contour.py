"""Contour matching against contourpy, scipy and its own covariance."""

import pickle
import warnings

import contourpy
import numpy as np
import pytest
from scipy.linalg import orthogonal_procrustes
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

import geomag
from geomag.reduction import GravityReduction, MagneticReduction, eotvos_mgal, match_with_reduction


def rough_grid(seed, n=41, holes=0.0, smooth=False):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, n))
    if smooth:
        k = np.arange(n)
        values = 2 * np.sin(k / 5)[None, :] * np.cos(k / 7)[:, None] + 0.1 * values
    values[rng.random((n, n)) < holes] = np.nan
    x, y = np.arange(n) * 100.0, np.arange(n) * 130.0
    return values, x, y


@pytest.mark.parametrize(
    ("seed", "holes", "smooth"), [(0, 0.0, False), (1, 0.1, False), (2, 0.0, True), (3, 0.05, True)]
)
def test_closest_points_agree_with_contourpy(seed, holes, smooth):
    """White noise is full of saddles: a fifth of the cells that a contour crosses."""
    values, x, y = rough_grid(seed, holes=holes, smooth=smooth)
    grid = geomag.GridMap(values, x, y)
    # corner_mask would cut triangles off cells with one hole: interpolation needs all four corners.
    lines = contourpy.contour_generator(x, y, np.ma.masked_invalid(values), name="serial", corner_mask=False)
    rng = np.random.default_rng(seed + 10)
    compared = 0
    for level in np.nanquantile(values, rng.uniform(0.1, 0.9, 8)):
        pieces = [p for p in lines.lines(level) if len(p)]
        dense = []
        for piece in pieces:
            d = np.hypot(*np.diff(piece, axis=0).T)
            for a, b, length in zip(piece[:-1], piece[1:], d, strict=True):
                t = np.linspace(0, 1, max(2, int(length / 0.5)))[:, None]
                dense.append(a + t * (b - a))
        tree = KDTree(np.concatenate(dense))
        px, py = rng.uniform(-500, x[-1] + 500, 500), rng.uniform(-500, y[-1] + 500, 500)
        cx, cy, distance = geomag.closest_contour_point(grid, px, py, level)
        reference, _ = tree.query(np.column_stack([px, py]))
        # Samples every half metre along a line are never nearer than the line, and at most 0.07 m further beyond 1 m.
        assert (distance <= reference + 1e-9).all()
        np.testing.assert_allclose(distance, reference, atol=0.3)
        assert (reference - distance)[reference > 2].max() < 0.05
        np.testing.assert_allclose(np.hypot(cx - px, cy - py), distance, rtol=1e-9)
        compared += px.size
    assert compared == 4000


def test_closest_point_radius_and_errors():
    grid = geomag.GridMap([[0.0, 10.0], [0.0, 10.0]], [0.0, 100.0], [0.0, 100.0])
    assert np.isnan(geomag.closest_contour_point(grid, 20.0, 30.0, 5.0, radius_m=29.0)).all()
    assert np.isnan(geomag.closest_contour_point(grid, 20.0, 30.0, 50.0)[2])
    with pytest.raises(geomag.InvalidInputError, match="radius_m"):
        geomag.closest_contour_point(grid, 20.0, 30.0, 5.0, radius_m=0.0)
    with pytest.raises(geomag.NotFiniteError):
        geomag.closest_contour_point(grid, np.nan, 30.0, 5.0)


def test_transforms_agree_with_scipy():
    rng = np.random.default_rng(4)
    for _ in range(200):
        p = rng.normal(size=(8, 2)) * 1000
        q = p @ rng.normal(size=(2, 2)) + rng.normal(size=2) * 500 + rng.normal(size=(8, 2)) * 50
        w = rng.uniform(0.1, 2, 8)
        pc, qc = np.average(p, axis=0, weights=w), np.average(q, axis=0, weights=w)
        matrix, shift = geomag.fit_transform(p, q, kind="rigid", weights=w)
        three = np.column_stack([p - pc, np.zeros(8)]), np.column_stack([q - qc, np.zeros(8)])
        # Wahba's problem in space may tilt the plane; keep it flat with a heavy vertical pair.
        up = np.array([[0.0, 0.0, 1e6]])
        rotation, _ = Rotation.align_vectors(
            np.vstack([three[1], up]), np.vstack([three[0], up]), weights=np.append(w, 1e3)
        )
        np.testing.assert_allclose(matrix, rotation.as_matrix()[:2, :2], atol=1e-6)
        np.testing.assert_allclose(shift, qc - matrix @ pc, atol=1e-6)
        similar, _ = geomag.fit_transform(p, q, kind="similarity")
        a, b = p - p.mean(axis=0), q - q.mean(axis=0)
        r, strength = orthogonal_procrustes(a, b)
        if np.linalg.det(r) > 0:
            np.testing.assert_allclose(similar, (strength / (a**2).sum()) * r.T, atol=1e-9)
        affine, offset = geomag.fit_transform(p, q, kind="affine", weights=w)
        root = np.sqrt(w)[:, None]
        solution, *_ = np.linalg.lstsq(root * np.column_stack([p, np.ones(8)]), root * q, rcond=None)
        np.testing.assert_allclose(affine, solution[:2].T, atol=1e-7)
        np.testing.assert_allclose(offset, solution[2], atol=1e-5)


def test_transform_errors():
    line = np.column_stack([np.arange(5.0), 2 * np.arange(5.0)])
    with pytest.raises(geomag.RankDeficientError, match="line"):
        geomag.fit_transform(line, line, kind="affine")
    with pytest.raises(geomag.TooFewSamplesError):
        geomag.fit_transform(line[:1], line[:1], kind="rigid")
    with pytest.raises(geomag.InvalidInputError, match="transform"):
        geomag.fit_transform(line, line, kind="projective")
    with pytest.raises(geomag.ShapeError):
        geomag.fit_transform(line.T, line.T)


@pytest.fixture(scope="module")
def scene():
    x = np.arange(0.0, 40_000.0, 250.0)
    field = 120 * np.sin(x / 1700)[None, :] * np.cos(x / 2300)[:, None] + 60 * np.cos(
        (x[None, :] + 2 * x[:, None]) / 3100
    )
    grid = geomag.GridMap(field, x, x)
    k = np.arange(22.0)
    tx, ty = 9000 + 600 * k, 8000 + 560 * k
    return grid, tx, ty, grid.sample(tx, ty, interpolation="bicubic")


def test_by_default_iccp_to_the_letter(scene):
    grid, tx, ty, v = scene
    track = geomag.Track(tx - 300, ty + 250, v)
    fix = geomag.match_contour(grid, track)
    assert fix.covariance_m2 is None
    assert fix.risk is None
    assert fix.goodness is None
    assert fix.iterations <= 300
    exact = geomag.match_contour(
        grid, track, transform="translation", converged_m=1e-3, max_iterations=5000, radius_m=3000
    )
    assert exact.ok
    np.testing.assert_allclose(exact.offset_m, (300, -250), atol=5)
    np.testing.assert_allclose(exact.track, np.column_stack([tx, ty]), atol=5)
    quick = geomag.match_contour(
        grid, track, transform="translation", converged_m=1e-3, max_iterations=5000, radius_m=3000, acceleration=4
    )
    np.testing.assert_allclose(quick.offset_m, exact.offset_m, atol=1)
    assert quick.iterations < exact.iterations


def test_recommended_pipeline_in_degrees(scene):
    grid, tx, ty, v = scene
    # The same field in degrees, on both sides of the date line.
    metres = np.array([65_000.0, 111_400.0])
    lon = (179.8 + grid.x / metres[0] + 180) % 360 - 180
    degrees = geomag.GridMap(grid.values, lon, 54.0 + grid.y / metres[1], geographic=True)
    rng = np.random.default_rng(1)
    track = geomag.Track(
        (179.8 + (tx - 500) / metres[0] + 180) % 360 - 180,
        54.0 + (ty + 400) / metres[1],
        v + rng.normal(size=v.size) + 7,
    )
    fix = geomag.match_contour(
        degrees, track, starts="grid", refine=True, sigma=1.0, offset_sigma_m=560, heading_sigma_deg=0.5,
        scale_sigma=0.01, bias_sigma=10, tolerance_m=300,
    )  # fmt: skip
    assert fix.ok
    assert fix.risk < 0.01
    assert abs(fix.bias - 7) < 2
    east, north = degrees.metres_per_unit(fix.y)
    turn = (fix.x - 179.8 - tx[-1] / metres[0] + 180) % 360 - 180
    error = np.array([turn, fix.y - 54.0 - ty[-1] / metres[1]]) * (east, north)
    assert error @ np.linalg.solve(fix.covariance_m2, error) < 13.8  # 99.9 %


def test_starts_channels_weights_and_errors(scene):
    grid, tx, ty, v = scene
    track = geomag.Track(tx - 1500, ty + 1250, v)
    there = geomag.match_contour(grid, track, transform="translation", starts=[(0.0, 0.0), (1450.0, -1200.0)],
                                 converged_m=0.01, max_iterations=3000)  # fmt: skip
    np.testing.assert_allclose(there.offset_m, (1500, -1250), atol=5)
    second = geomag.match_contour(grid, track, channels=[(grid, v, 1.0)], sigma=1.0, weights=np.ones(22),
                                  starts="grid", radius_m=2500.0, transform="translation")  # fmt: skip
    np.testing.assert_allclose(second.offset_m, (1500, -1250), atol=60)
    for bad, message in [
        ({"transform": "twist"}, "transform"),
        ({"starts": "grid"}, "half_width_m"),
        ({"starts": "nowhere"}, "starts"),
        ({"stiffness": -1.0}, "stiffness"),
        ({"offset_sigma_m": 0.0}, "offset_sigma_m"),
        ({"weights": [1.0]}, "weights"),
        ({"max_iterations": -3}, "max_iterations"),
    ]:
        with pytest.raises(geomag.GeomagError, match=message):
            geomag.match_contour(grid, track, **bad)
    with pytest.raises(TypeError, match="unexpected"):
        geomag.match_contour(grid, track, sgima=1.0)
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_contour(grid, track, starts="grid", half_width_m=1e7, step_m=1.0)
    with pytest.raises(geomag.RankDeficientError, match="straight"):
        geomag.match_contour(grid, track, transform="affine")
    with pytest.raises(geomag.TooFewSamplesError):
        geomag.match_contour(grid, track[:1])
    assert geomag.match_contour(grid, geomag.Track(tx, ty, v + 1e6)).status == "lost"


def test_sliding_window(scene):
    grid, tx, ty, v = scene
    options = {"transform": "translation", "radius_m": 2000.0, "converged_m": 0.01, "max_iterations": 2000}
    window = geomag.SlidingContour(grid, length=12, **options)
    copy = geomag.SlidingContour(grid, length=12, **options)
    for k in range(22):
        copy = pickle.loads(pickle.dumps(copy))
        fix = window.update(tx[k] - 300, ty[k] + 250, v[k])
        other = copy.update(tx[k] - 300, ty[k] + 250, v[k])
        assert (fix.status == "searching") == (k < 11)
        np.testing.assert_equal(fix.to_dict(), other.to_dict())
    np.testing.assert_allclose(fix.offset_m, (300, -250), atol=15)
    assert window.settled == copy.settled
    assert window.settled["number"] == 9
    assert window.settled["estimates"] == 10
    # Windows end at samples 11 to 21: samples 10 and 11 were in all eleven of them, the newest in one.
    assert [p["estimates"] for p in window.averaged] == [11, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1]
    np.testing.assert_allclose([window.settled["x"], window.settled["y"]], [tx[9], ty[9]], atol=15)
    fixes = geomag.SlidingContour(grid, length=12, **options).run(geomag.Track(tx - 300, ty + 250, v))
    assert len(fixes) == 22
    np.testing.assert_equal(fixes[-1].to_dict(), fix.to_dict())


def test_eotvos_is_the_centrifugal_and_coriolis_acceleration():
    """2 omega v cos(lat) sin(course) + v^2 / R, in mGal and knots."""
    omega, radius, knot = 7.292115e-5, 6.371e6, 1852 / 3600
    v, course, lat = 20.0, 73.0, 38.0
    exact = 1e5 * (
        2 * omega * v * knot * np.cos(np.radians(lat)) * np.sin(np.radians(course)) + (v * knot) ** 2 / radius
    )
    assert float(eotvos_mgal(v, course, lat)) == pytest.approx(exact, rel=1e-3)


def gravity_scene():
    boule = pytest.importorskip("boule")
    lon, lat = np.linspace(110, 111.5, 181), np.linspace(15, 16.5, 181)
    anomaly = 45 * np.sin(9 * lon)[None, :] * np.cos(11 * lat)[:, None] + 20 * np.cos(
        14 * (lon[None, :] + lat[:, None])
    )
    grid = geomag.GridMap(anomaly, lon, lat, geographic=True)
    tx, ty = 110.4 + 0.013 * np.arange(24), 15.3 + 0.011 * np.arange(24)
    t = 300.0 * np.arange(24)
    gravity = GravityReduction(height_m=0.0)
    raw = grid.sample(tx, ty) - gravity.correction(tx, ty, t)
    assert abs(float(np.median(raw)) - float(boule.WGS84.normal_gravity((None, 15.4, 0.0)))) < 300
    return grid, tx, ty, t, raw, gravity


def test_second_reduction_takes_the_reduction_error_away():
    grid, tx, ty, t, raw, gravity = gravity_scene()
    options = {"transform": "translation", "starts": "grid", "refine": True, "sigma": 0.5, "offset_sigma_m": 8000.0}
    found = match_with_reduction(grid, tx + 0.03, ty - 0.06, raw, gravity, time_s=t, **options)
    error = np.hypot(found.fix.x - tx[-1], found.fix.y - ty[-1]) * 111e3
    first = np.hypot(found.first.x - tx[-1], found.first.y - ty[-1]) * 111e3
    assert found.converged
    assert found.passes >= 3
    assert error < 30 < first
    np.testing.assert_allclose(found.values, grid.sample(tx, ty), atol=0.1)
    with pytest.raises(geomag.ShapeError):
        match_with_reduction(grid, tx, ty[:-1], raw, gravity)
    with pytest.raises(geomag.InvalidInputError, match="time_s"):
        match_with_reduction(grid, tx, ty, raw, gravity)


def test_magnetic_reduction_is_the_main_field():
    ppigrf = pytest.importorskip("ppigrf")
    import datetime

    when = datetime.datetime(2024, 5, 1)
    lon, lat = np.array([16.0, 17.0]), np.array([34.0, 35.0])
    east, north, up = ppigrf.igrf(lon, lat, 1.0, when)
    expected = -np.sqrt(east**2 + north**2 + up**2).ravel()
    np.testing.assert_allclose(MagneticReduction(when, 1000.0).correction(lon, lat, None), expected)


def waves():
    x = np.arange(60.0)
    return geomag.GridMap(90 * np.sin(x / 4)[None, :] * np.cos(x / 5)[:, None], x, x)


def along(grid, dx=0.0):
    k = np.arange(20.0)
    return geomag.Track(18.3 + dx + k, 25.6 + 0.7 * k, grid.sample(20.3 + k, 22.6 + 0.7 * k))


@pytest.mark.parametrize("options", [{}, {"transform": "translation"}, {"radius_m": 20.0}])
def test_a_track_off_the_map_is_lost(options):
    grid = waves()
    for dx in (80.0, 1e6):
        fix = geomag.match_contour(grid, along(grid, dx), **options)
        assert fix.status == "lost"
        assert np.isnan(fix.x)
    assert geomag.match_contour(grid, along(grid), starts=[[1e9, 0.0]], **options).status == "lost"


def test_no_place_off_the_map_is_a_fix():
    grid = waves()
    for dx in np.arange(20.0, 45.0, 2.0):
        fix = geomag.match_contour(grid, along(grid, dx))
        assert not fix.ok or np.isfinite(grid.sample(fix.x, fix.y))


def test_the_newest_sample_of_a_window_must_have_been_used():
    grid = waves()
    window = geomag.SlidingContour(grid, length=8, transform="translation", radius_m=6.0)
    track = along(grid)
    for k in range(12):
        fix = window.update(track.x[k], track.y[k], track.values[k])
    assert fix.ok
    assert not window.update(1e7, 0.0, 0.0).ok


def test_contours_that_only_just_determine_the_transform_are_no_fix():
    grid = waves()
    track = along(grid)
    assert geomag.match_contour(grid, track[:1], transform="translation").status == "uninformative"
    assert geomag.match_contour(grid, track[:2]).status == "uninformative"


def test_a_tolerance_without_refinement_warns():
    """Before 0.1.0 was named anew, `tolerance_m` said where the iteration ends: that is `converged_m` now."""
    axis = np.arange(0.0, 3000.0, 50.0)
    grid = geomag.GridMap(90 * np.sin(axis / 300)[None, :] * np.cos(axis / 350)[:, None], axis, axis)
    k = np.arange(20.0)
    track = geomag.Track(900 + 40 * k, 1000 + 30 * k, grid.sample(950 + 40 * k, 960 + 30 * k))
    with pytest.warns(UserWarning, match="converged_m"):
        geomag.match_contour(grid, track, tolerance_m=1e-6)
    with pytest.warns(UserWarning, match="converged_m"):
        geomag.SlidingContour(grid, length=8, tolerance_m=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        geomag.match_contour(grid, track, tolerance_m=100.0, refine=True)
        geomag.match_contour(grid, track, converged_m=1e-6)
