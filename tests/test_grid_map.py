"""GridMap: interpolation against SciPy, gradients against differences, bounds against dense sampling, bad input."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from fields import rough
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import bilinear
from scipy.interpolate import RegularGridInterpolator

import geomag


def make(seed=0, ny=12, nx=15, **options):
    rng = np.random.default_rng(seed)
    values = rough(rng, ny, nx, smooth=1.5)
    x, y = -30.0 + 2.5 * np.arange(nx), 100.0 + 4.0 * np.arange(ny)
    return rng, values, x, y, geomag.GridMap(values, x, y, **options)


def test_bilinear_equals_scipy():
    rng, values, x, y, grid = make()
    px, py = rng.uniform(x[0], x[-1], 500), rng.uniform(y[0], y[-1], 500)
    expected = RegularGridInterpolator((y, x), values)(np.column_stack([py, px]))
    np.testing.assert_allclose(grid.sample(px, py), expected, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(grid.sample(*np.meshgrid(x, y)), values)


def test_bicubic_is_exact_for_quadratics_up_to_the_border():
    x, y = np.arange(8.0), 3.0 * np.arange(6.0)
    f = lambda a, b: 2 + a - 0.5 * b + 0.3 * a * a - 0.02 * b * b + 0.1 * a * b  # noqa: E731
    grid = geomag.GridMap(f(x[None, :], y[:, None]), x, y)
    rng = np.random.default_rng(1)
    px, py = rng.uniform(0, 7, 300), rng.uniform(0, 15, 300)
    np.testing.assert_allclose(grid.sample(px, py, interpolation="bicubic"), f(px, py), atol=1e-11)
    east, north = grid.gradient(px, py, interpolation="bicubic")
    np.testing.assert_allclose(east, 1 + 0.6 * px + 0.1 * py, atol=1e-11)
    np.testing.assert_allclose(north, -0.5 - 0.04 * py + 0.1 * px, atol=1e-11)


def test_bicubic_converges_with_the_third_order():
    errors = []
    for n in (40, 80):
        x = np.linspace(0, 2 * np.pi, n)
        grid = geomag.GridMap(np.sin(x)[None, :] * np.cos(x)[:, None], x, x)
        rng = np.random.default_rng(2)
        px, py = rng.uniform(1, 5, (2, 400))
        errors.append(np.abs(grid.sample(px, py, interpolation="bicubic") - np.sin(px) * np.cos(py)).max())
    assert errors[0] / errors[1] > 6.5


@pytest.mark.parametrize("method", ["bilinear", "bicubic"])
def test_gradient_equals_differences(method):
    rng, _, x, y, grid = make(3)
    px, py = rng.uniform(x[1], x[-2], 200), rng.uniform(y[1], y[-2], 200)
    h = 1e-6
    east, north = grid.gradient(px, py, interpolation=method)
    sample = lambda a, b: grid.sample(a, b, interpolation=method)  # noqa: E731
    inside = (np.abs((px - x[0]) / 2.5 % 1 - 0.5) < 0.49) & (np.abs((py - y[0]) / 4 % 1 - 0.5) < 0.49)
    np.testing.assert_allclose(east[inside], ((sample(px + h, py) - sample(px - h, py)) / (2 * h))[inside], atol=1e-5)
    np.testing.assert_allclose(north[inside], ((sample(px, py + h) - sample(px, py - h)) / (2 * h))[inside], atol=1e-5)


def test_geographic_gradient_is_per_metre():
    lon, lat = np.arange(10, 11, 0.1), np.arange(60, 61, 0.1)
    grid = geomag.GridMap(lon[None, :] * 2.0 + lat[:, None] * 3.0, lon, lat, geographic=True)
    east, north = grid.gradient(10.45, 60.45)
    # Radii of WGS84 at 60.45 degrees, by the formulas of any textbook.
    e2 = 0.00669437999014
    s = np.sin(np.deg2rad(60.45))
    transverse = 6378137 / np.sqrt(1 - e2 * s * s)
    meridional = 6378137 * (1 - e2) / (1 - e2 * s * s) ** 1.5
    assert east == pytest.approx(2.0 / (np.deg2rad(1) * transverse * np.cos(np.deg2rad(60.45))), rel=1e-9)
    assert north == pytest.approx(3.0 / (np.deg2rad(1) * meridional), rel=1e-9)


def test_bounds_hold_every_value_within_and_are_attained():
    rng, _, x, y, grid = make(4)
    for _ in range(60):
        px, py = rng.uniform(x[4], x[-5]), rng.uniform(y[4], y[-5])
        half = rng.uniform(0.1, 7, 2)
        low, high = grid.bounds(px, py, half_width=half)
        dense = grid.sample(
            *np.meshgrid(np.linspace(px - half[0], px + half[0], 61), np.linspace(py - half[1], py + half[1], 61))
        )
        assert low - 1e-9 <= dense.min()
        assert dense.max() <= high + 1e-9
        assert dense.max() > high - 0.15 * (high - low)
    assert np.isnan(grid.bounds(x[0], y[0], half_width=1.0)[0])


def test_holes_spoil_only_what_needs_them():
    _, values, x, y, _ = make(5)
    values = values.copy()
    values[4, 6] = np.nan
    grid = geomag.GridMap(values, x, y)
    assert grid.holes == 1
    assert np.isnan(grid.sample(x[6] + 0.1, y[4] + 0.1))
    assert grid.sample(x[7], y[4]) == values[4, 7]
    assert grid.sample(x[7], y[4] + 1.0) == pytest.approx(0.75 * values[4, 7] + 0.25 * values[5, 7])
    # A bicubic surface takes slopes from one node further out on each side, and nothing from beyond.
    whole = geomag.GridMap(np.where(np.isnan(values), 0.0, values), x, y)
    for column in range(3, 10):
        read = grid.sample(x[column] + 0.1, y[4], interpolation="bicubic")
        if 4 <= column <= 7:
            assert np.isnan(read)
        else:
            assert read == whole.sample(x[column] + 0.1, y[4], interpolation="bicubic")
    rng = np.random.default_rng(0)
    for px, py in zip(rng.uniform(x[0] - 2, x[-1] + 2, 400), rng.uniform(y[0] - 2, y[-1] + 2, 400), strict=True):
        np.testing.assert_allclose(grid.sample(px, py), bilinear(values, x, y, px, py), rtol=1e-12, atol=1e-10)


def test_either_direction_gives_the_same_map():
    _, values, x, y, _grid = make(6, sigma=3.0)
    sigma = np.abs(values)
    reference = geomag.GridMap(values, x, y, sigma=sigma)
    for flip_y, flip_x in ((1, -1), (-1, 1), (-1, -1)):
        other = geomag.GridMap(values[::flip_y, ::flip_x], x[::flip_x], y[::flip_y], sigma=sigma[::flip_y, ::flip_x])
        np.testing.assert_array_equal(other.values, values)
        np.testing.assert_array_equal(other.sigma, reference.sigma)
        np.testing.assert_array_equal(other.x, x)
        np.testing.assert_array_equal(other.y, y)


def test_float32_stays_float32_and_ints_become_float64():
    _, values, x, y, _ = make(7)
    assert geomag.GridMap(values.astype("f4"), x, y).values.dtype == np.float32
    assert geomag.GridMap(values.astype("i4"), x, y).values.dtype == np.float64
    masked = np.ma.masked_less(values, 0)
    assert geomag.GridMap(masked, x, y).holes == (values < 0).sum()


def test_date_line():
    x = np.array([178.0, 179.0, -180.0, -179.0, -178.0])
    grid = geomag.GridMap(np.arange(5.0) * np.ones((3, 1)), x, [0, 1, 2], geographic=True)
    np.testing.assert_allclose(grid.x, [178, 179, 180, 181, 182])
    np.testing.assert_allclose(grid.sample([179.5, -179.5, 181.5, -178.5], 1.0), [1.5, 2.5, 3.5, 3.5])
    assert np.isnan(grid.sample(0.0, 1.0))


def test_pickle_keeps_every_bit():
    _, values, x, y, _ = make(8)
    values[0, 0] = np.nan
    for dtype in ("f4", "f8"):
        grid = geomag.GridMap(
            values.astype(dtype), x + 0.1, y / 3, sigma=np.abs(values), name="n", units="nT", crs="EPSG:1"
        )
        back = pickle.loads(pickle.dumps(grid))
        assert back.values.tobytes() == grid.values.tobytes()
        assert back.x.tobytes() == grid.x.tobytes()
        assert back.sigma.tobytes() == grid.sigma.tobytes()
        assert (back.name, back.units, back.crs) == ("n", "nT", "EPSG:1")


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"values": np.zeros((3, 3))}, geomag.ShapeError, r"needed shape \(3, 4\)"),
        ({"values": np.zeros(12)}, geomag.ShapeError, "two dimensions"),
        ({"x": [0, 1, 2, 4]}, geomag.InvalidInputError, r"axis x\[1\]|axis x\[2\]"),
        ({"y": [0, 1, 1]}, geomag.InvalidInputError, "axis y"),
        ({"y": [0, np.nan, 2]}, geomag.NotFiniteError, r"y\[1\]"),
        ({"x": [1, 1, 1, 1]}, geomag.InvalidInputError, "axis x"),
        ({"values": np.full((3, 4), np.inf)}, geomag.NotFiniteError, "map values"),
        ({"values": np.full((3, 4), np.nan)}, geomag.InvalidInputError, "at least one value"),
        ({"values": [["a"] * 4] * 3}, geomag.InvalidInputError, "real numbers"),
        ({"values": np.zeros((3, 4), complex)}, geomag.InvalidInputError, "real numbers"),
        ({"sigma": -1.0}, geomag.InvalidInputError, "sigma"),
        ({"sigma": np.ones((2, 2))}, geomag.ShapeError, "sigma"),
        ({"y": [100, 200, 300], "geographic": True}, geomag.InvalidInputError, "metres"),
        ({"x": [0, 200, 400, 600], "geographic": True}, geomag.InvalidInputError, "axis x"),
        ({"x": [0], "values": np.zeros((3, 1))}, geomag.TooFewSamplesError, "axis x"),
    ],
)
def test_bad_maps_say_what_is_wrong(change, error, match):
    arguments = {"values": np.zeros((3, 4)), "x": [0, 1, 2, 3], "y": [0, 1, 2], **change}
    with pytest.raises(error, match=match) as caught:
        geomag.GridMap(**arguments)
    assert isinstance(caught.value, geomag.GeomagError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_an_infinite_value_is_named_where_the_caller_put_it(dtype):
    values = np.zeros((60, 50), dtype)
    values[3, 7] = np.inf
    x, y = np.arange(50.0), 100 - np.arange(60.0)
    with pytest.raises(geomag.NotFiniteError, match=r"row 3, column 7 \(x 7, y 97\)"):
        geomag.GridMap(values, x, y)
    with pytest.raises(geomag.NotFiniteError, match=r"row 3, column 7 \(x 42, y 97\)"):
        geomag.GridMap(values, x[::-1], y)
    with pytest.raises(geomag.InvalidInputError, match=r"sigma\[3, 7\]"):
        geomag.GridMap(np.zeros((60, 50)), x, y, sigma=values)


def test_there_is_no_scale_beyond_the_poles():
    degrees = geomag.GridMap(np.zeros((3, 4)), [0, 1, 2, 3], [80, 81, 82], geographic=True)
    for y in (95.0, -90.1):
        with pytest.raises(geomag.InvalidInputError, match="latitude"):
            degrees.metres_per_unit(y)
    assert geomag.GridMap(np.zeros((3, 4)), [0, 1, 2, 3], [80, 81, 82]).metres_per_unit(95.0) == (1.0, 1.0)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(numbers, min_size=0, max_size=6),
    st.lists(numbers, min_size=0, max_size=6),
    st.integers(0, 2**32),
    st.booleans(),
)
def test_any_axes_are_taken_or_refused(x, y, seed, geographic):
    """No panic and no silent nonsense: the map is either refused or returns its own node values."""
    values = np.random.default_rng(seed).standard_normal((len(y), len(x)))
    try:
        grid = geomag.GridMap(values, x, y, geographic=geographic)
    except geomag.GeomagError:
        return
    assert len(x) >= 2
    assert len(y) >= 2
    spread = max(abs(grid.x[-1] - grid.x[0]) * 1e-9, 1e-300)
    for i in range(len(y)):
        for j in range(len(x)):
            if abs(x[j]) * 1e-15 < spread:
                got = grid.sample(x[j], y[i])
                assert np.isnan(got) or got == pytest.approx(values[i, j], rel=0.2, abs=0.2)


def test_every_layer_turns_with_the_axes():
    rng = np.random.default_rng(2)
    x, y = np.arange(0.0, 500.0, 50.0), np.arange(0.0, 300.0, 50.0)
    values, sigma, distance = (rng.uniform(1.0, 2.0, (6, 10)) for _ in range(3))
    distance = distance.astype(np.float32).astype(float)
    law = {"nu": 4.0, "scale_spread": 0.2, "correlation": 1.0, "registration": 0.1}
    up = geomag.GridMap(values, x, y, sigma=sigma).with_error_model(**law, distance_m=distance)
    for rows, columns in ((-1, 1), (1, -1), (-1, -1)):
        turn = np.s_[::rows, ::columns]
        other = geomag.GridMap(values[turn], x[::columns], y[::rows], sigma=sigma[turn])
        other = other.with_error_model(**law, distance_m=distance[turn])
        for a, b in ((up.values, other.values), (up.sigma, other.sigma)):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(other.error_model["distance_m"], distance)
        for again in (other.with_error_model(**other.error_model), pickle.loads(pickle.dumps(other))):
            np.testing.assert_array_equal(again.error_model["distance_m"], distance)
        np.testing.assert_array_equal(
            pickle.loads(pickle.dumps(other))
            .with_error_model(**law, distance_m=distance[turn])
            .error_model["distance_m"],
            distance,
        )
    with pytest.raises(geomag.InvalidInputError, match="'given' or 'values'"):
        up.with_error_model(**law, distance_m=distance, layout="upside down")
