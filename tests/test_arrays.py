"""Arrays in whatever layout NumPy may hand them over: what is read is what NumPy shows."""

import numpy as np
import pytest

import geomag

X = np.arange(1.0, 6.0)


def packed(values):
    """A column of packed records: not aligned, and 17 bytes from one number to the next."""
    records = np.zeros(np.shape(values), dtype=[("f", "i1"), ("v", np.asarray(values).dtype), ("g", "f8")])
    records["v"] = values
    return records["v"]


def unaligned(values):
    values = np.asarray(values)
    out = np.zeros(values.nbytes + 1, np.uint8)[1:].view(values.dtype).reshape(values.shape)
    out[...] = values
    return out


LAYOUTS = {
    "packed": packed,
    "unaligned": unaligned,
    "swapped": lambda v: v.astype(v.dtype.newbyteorder()),
    "backwards": lambda v: v[..., ::-1].copy()[..., ::-1],
    "every other": lambda v: np.repeat(v, 2, axis=-1)[..., ::2],
    "packed backwards": lambda v: packed(v[..., ::-1])[..., ::-1],
    "columns first": np.asfortranarray,
    "read only": lambda v: np.frombuffer(v.tobytes(), v.dtype).reshape(v.shape),
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_a_track_reads_what_numpy_shows(layout):
    track = geomag.Track(layout(X), layout(10 * X), layout(100 * X), time_s=layout(X))
    np.testing.assert_array_equal(track.x, X)
    np.testing.assert_array_equal(track.y, 10 * X)
    np.testing.assert_array_equal(track.values, 100 * X)
    np.testing.assert_array_equal(track.time_s, X)


@pytest.mark.parametrize("dtype", ["f4", "f8", "i2"])
@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_a_map_reads_what_numpy_shows(layout, dtype):
    values = np.arange(20.0).reshape(4, 5).astype(dtype)
    sigma = 0.5 + values.astype(float)
    axes = np.arange(5).astype(dtype), np.arange(4).astype(dtype)
    grid = geomag.GridMap(layout(values), layout(axes[0]), layout(axes[1]), sigma=layout(sigma))
    np.testing.assert_array_equal(grid.values, values)
    np.testing.assert_array_equal(grid.sigma, sigma)
    # Single precision stays single, in whatever byte order it came.
    assert grid.values.dtype == (np.float32 if dtype == "f4" else np.float64)
    u, v = np.array([[0.5, 1.5], [2.0, 3.0]]), np.array([[0.0, 1.0], [2.5, 3.0]])
    np.testing.assert_array_equal(grid.sample(layout(u), layout(v)), grid.sample(u, v))


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_a_filter_reads_what_numpy_shows(layout):
    p = np.array([[2.0, 0.5], [0.5, 1.0]])
    for make in (geomag.UnscentedKalmanFilter, geomag.ExtendedKalmanFilter):
        kalman = make(layout(np.array([1.0, 2.0])), layout(p))
        np.testing.assert_allclose(kalman.P, p, rtol=1e-14)
    kalman = geomag.UnscentedKalmanFilter(np.array([1.0, 2.0]), p)
    kalman.update(layout(np.array([1.5, 2.5])), layout(np.eye(2)), layout(np.array([1.0, 2.0])))
    gain = p @ np.linalg.inv(p + np.diag([1.0, 2.0]))
    np.testing.assert_allclose(kalman.x, [1.0, 2.0] + gain @ [0.5, 0.5], rtol=1e-12)


def test_single_precision_axes_may_be_swapped():
    x = np.linspace(100.0, 101.0, 301, dtype="f4")
    values = np.zeros((301, 301))
    plain = geomag.GridMap(values, x, x)
    assert geomag.GridMap(values, x.astype(">f4"), x.astype(">f4")).spacing == plain.spacing


@pytest.mark.parametrize("turn", ["rotate_to_origin", "rotate_from_origin"])
def test_places_and_vectors_broadcast_as_numpy_does(turn):
    rotate = getattr(geomag.LocalFrame(33.0, 118.0), turn)
    vectors = np.arange(12.0).reshape(4, 3)
    latitude = np.array([34.0, 35.0, 36.0, 37.0])
    one_by_one = np.array([[rotate(a, 118.5, v) for v in vectors] for a in latitude])
    np.testing.assert_array_equal(rotate(latitude[:, None], 118.5, vectors), one_by_one)
    np.testing.assert_array_equal(rotate(latitude, 118.5, vectors), one_by_one[range(4), range(4)])
    np.testing.assert_array_equal(rotate(latitude, [118.5], vectors[:1]), one_by_one[:, 0])
    np.testing.assert_array_equal(rotate(latitude[:1], 118.5, packed(vectors)), one_by_one[0])
    assert rotate([], 118.5, np.zeros((0, 3))).shape == (0, 3)
    assert rotate([], [118.5], [1.0, 2.0, 3.0]).shape == (0, 3)
    assert rotate(34.0, 118.5, np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("turn", ["rotate_to_origin", "rotate_from_origin"])
@pytest.mark.parametrize(("places", "vectors"), [(0, 4), (4, 0), (3, 4), (2, 3)])
def test_places_and_vectors_that_do_not_fit_are_refused(turn, places, vectors):
    rotate = getattr(geomag.LocalFrame(33.0, 118.0), turn)
    with pytest.raises(geomag.ShapeError, match="vector"):
        rotate(np.full(places, 34.0), np.full(places, 118.5), np.zeros((vectors, 3)))
    with pytest.raises(geomag.ShapeError, match=r"\(\.\.\., 3\)"):
        rotate(34.0, 118.5, np.zeros((3, 2)))
