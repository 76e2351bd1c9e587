"""Frames against pymap3d and pyproj, the sphere against the paper's corrected formulas, vectors and their lengths."""

import pickle

import numpy as np
import pytest

import geomag

ORIGINS = [(33.0, 118.0, 0.0), (-22.0, 140.7, 300.0), (89.0, -20.0, 10.0), (0.0, 179.9, -50.0)]


@pytest.fixture
def places(rng):
    n = 500
    return rng.uniform(-85, 85, n), rng.uniform(-180, 180, n), rng.uniform(-5e3, 5e4, n)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.mark.parametrize("origin", ORIGINS)
def test_agrees_with_pymap3d_to_a_millimetre(origin, places):
    pymap3d = pytest.importorskip("pymap3d")
    frame = geomag.LocalFrame(*origin)
    expected = pymap3d.geodetic2ned(*places, *origin)
    for got, want in zip(frame.forward(*places), expected, strict=True):
        np.testing.assert_allclose(got, want, atol=1e-3)
    lat, lon, h = frame.inverse(*expected)
    np.testing.assert_allclose(lat, places[0], atol=1e-8)
    np.testing.assert_allclose((lon - places[1] + 180) % 360 - 180, 0, atol=1e-6)
    np.testing.assert_allclose(h, places[2], atol=1e-3)


def test_agrees_with_pyproj_to_a_millimetre(places):
    pyproj = pytest.importorskip("pyproj")
    lat0, lon0, h0 = ORIGINS[1]
    steps = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lat_0={lat0} +lon_0={lon0} +h_0={h0}"
    )
    east, north, up = pyproj.Transformer.from_pipeline(steps).transform(places[1], places[0], places[2])
    n, e, d = geomag.LocalFrame(lat0, lon0, h0).forward(*places)
    np.testing.assert_allclose([n, e, d], [north, east, -up], atol=1e-3)


@pytest.mark.parametrize("earth", ["wgs84", "sphere"])
def test_round_trip_to_nanometres(earth, rng):
    frame = geomag.LocalFrame(33.0, 118.0, 20.0, earth=earth)
    lat, lon, h = rng.uniform(30, 36, 2000), rng.uniform(115, 121, 2000), rng.uniform(-1e3, 2e4, 2000)
    point = np.array(frame.forward(lat, lon, h))
    back = np.array(frame.forward(*frame.inverse(*point)))
    # Degrees of longitude near 118 are rounded to 1.4e-14, 1.3 nm.
    assert np.abs(point - back).max() < 4e-9
    assert np.abs(np.array(frame.inverse(*point)) - [lat, lon, h]).max() < 4e-9


def test_sphere_follows_the_papers_corrected_formulas(rng):
    radius = 6371200.0
    frame = geomag.LocalFrame(40.0, 100.0, earth="sphere")
    lat, lon, h = rng.uniform(38, 42, 300), rng.uniform(97, 103, 300), rng.uniform(0, 5e3, 300)
    theta0, theta, away = np.radians(50.0), np.radians(90 - lat), np.radians(100.0 - lon)
    cos_phi = np.cos(theta0) * np.cos(theta) + np.sin(theta0) * np.sin(theta) * np.cos(away)
    phi = np.arccos(cos_phi)
    sin_alpha = np.sin(theta) * np.sin(away) / np.sin(phi)
    cos_alpha = (np.cos(theta) - np.cos(theta0) * cos_phi) / (np.sin(theta0) * np.sin(phi))
    r = radius + h
    want = [r * np.sin(phi) * cos_alpha, -r * np.sin(phi) * sin_alpha, radius - r * cos_phi]
    # An arc cosine next to one keeps half the digits: that is why the frame does not go this way.
    np.testing.assert_allclose(frame.forward(lat, lon, h), want, atol=2e-3)


def test_vectors_keep_their_length_and_come_back(rng):
    frame = geomag.LocalFrame(33.0, 118.0)
    lat, lon = rng.uniform(-90, 90, 200), rng.uniform(-180, 180, 200)
    v = rng.normal(size=(200, 3)) * 5e4
    w = frame.rotate_to_origin(lat, lon, v)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), np.linalg.norm(v, axis=1), rtol=1e-14)
    np.testing.assert_allclose(frame.rotate_from_origin(lat, lon, w), v, atol=1e-9)
    np.testing.assert_array_equal(np.stack(frame.rotate_to_origin(lat, lon, *v.T), axis=-1), w)
    one = frame.rotate_to_origin(34.0, 118.0, [0.0, 0.0, 1.0])
    # North of the origin, down leans back: towards the origin's south.
    np.testing.assert_allclose(one, [-np.sin(np.radians(1)), 0, np.cos(np.radians(1))], atol=1e-15)


def test_a_vector_turns_as_the_ground_under_it(rng):
    frame = geomag.LocalFrame(33.0, 118.0, 100.0)
    lat, lon, step = 34.2, 116.5, 1e-5
    here = np.array(frame.forward(lat, lon, 0.0))
    north = np.array(frame.forward(lat + step, lon, 0.0)) - here
    down = np.array(frame.forward(lat, lon, -1.0)) - here
    np.testing.assert_allclose(frame.rotate_to_origin(lat, lon, [1.0, 0, 0]), north / np.linalg.norm(north), atol=1e-7)
    np.testing.assert_allclose(frame.rotate_to_origin(lat, lon, [0, 0, 1.0]), down, atol=1e-8)


def test_shapes_scalars_and_defaults():
    frame = geomag.LocalFrame(33.0, 118.0)
    n, e, d = frame.forward(33.0, 118.0)
    assert (n, e, d) == (0.0, 0.0, 0.0)
    assert isinstance(n, float)
    assert frame.forward(np.full((3, 1), 33.0), np.full(4, 118.1), 0.0)[0].shape == (3, 4)
    assert frame.rotate_to_origin(33.0, 118.0, np.ones((2, 5, 3))).shape == (2, 5, 3)
    assert pickle.loads(pickle.dumps(frame)) == frame
    sphere = geomag.LocalFrame(1.0, 2.0, 3.0, earth="sphere", radius_m=6.4e6)
    assert pickle.loads(pickle.dumps(sphere)) == sphere
    assert sphere.radius_m == 6.4e6
    assert frame.radius_m is None
    assert "118" in repr(frame)


@pytest.mark.parametrize("bad", [(91.0, 0.0), (np.nan, 0.0), (0.0, np.inf)])
def test_refuses_what_is_no_place(bad):
    with pytest.raises(geomag.InvalidInputError):
        geomag.LocalFrame(*bad)


def test_refuses_latitudes_beyond_the_poles():
    frame = geomag.LocalFrame(47.0, 7.0)
    with pytest.raises(geomag.InvalidInputError, match=r"latitude_deg\[1\]: .*got 91"):
        frame.forward([47.0, 91.0], 7.0, 0.0)
    with pytest.raises(geomag.InvalidInputError, match="latitude_deg"):
        frame.rotate_to_origin(-90.5, 7.0, [1.0, 2.0, 3.0])
    with pytest.raises(geomag.InvalidInputError, match="latitude_deg"):
        frame.rotate_from_origin(-90.5, 7.0, 1.0, 2.0, 3.0)
    assert np.isfinite(frame.forward([-90.0, 90.0], 7.0, 0.0)).all()
    assert np.isnan(frame.forward(np.nan, 7.0, 0.0)).all()


def test_refuses_unknown_figures_and_vectors():
    with pytest.raises(geomag.InvalidInputError, match="wgs84"):
        geomag.LocalFrame(0.0, 0.0, earth="flat")
    frame = geomag.LocalFrame(0.0, 0.0)
    with pytest.raises(geomag.ShapeError):
        frame.rotate_to_origin(0.0, 0.0, [1.0, 2.0])
    with pytest.raises(geomag.InvalidInputError):
        frame.rotate_to_origin(0.0, 0.0, 1.0, 2.0)
