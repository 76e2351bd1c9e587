"""One battery for everything that is fed sample by sample, and for everything that is saved: a new one adds a line."""

from __future__ import annotations

import contextlib
import pickle

import numpy as np
import pytest
from fields import rough
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import geomag
import geomag.synthetic
from geomag._geomag import MainFieldModel
from geomag.compensation import Compensator

X = np.arange(0.0, 4000.0, 50.0)
GRID = geomag.GridMap(rough(np.random.default_rng(5), 80, 80, smooth=4.0), X, X)
K = np.arange(60.0)
TRUE = 800.0 + 40.0 * K, 1000.0 + 30.0 * K
INDICATED = TRUE[0] - 60.0, TRUE[1] + 90.0
READINGS = GRID.sample(*TRUE) + np.random.default_rng(6).normal(0, 0.5, len(K))


def sample(stream, k):
    return stream.update(INDICATED[0][k], INDICATED[1][k], READINGS[k])


def feedback(stream, k):
    offset = (60.0, -90.0) if k % 3 == 2 else None
    covariance = [[2500.0, 100.0], [100.0, 2500.0]] if offset else None
    return stream.step(float(10 * k), INDICATED[0][k], INDICATED[1][k], offset_m=offset, covariance_m2=covariance)


def kalman(ukf, k):
    ukf.predict([[1.0, 1.0], [0.0, 1.0]], 0.1)
    return ukf.update([READINGS[k]], [[1.0, 0.0]], 4.0)


def extended(ekf, k):
    ekf.predict(ekf.x, [[1.0, 0.0], [0.0, 1.0]], 0.1)
    return ekf.update([READINGS[k]], [ekf.x[0]], [[1.0, 0.0]], 4.0)


#: name -> (a stream at its start, what sample k does to it, updates that it refuses)
STREAMS = {
    "Iema": (
        lambda: geomag.Iema(GRID, sigma=2.0, half_width=200.0, max_misses=2),
        sample,
        [
            lambda s: s.update(np.nan, 0.0, 1.0),
            lambda s: s.update(0.0, 1e30, 1.0),
            lambda s: s.update(0.0, 0.0, np.inf),
        ],
    ),
    "PosteriorMatcher": (
        lambda: geomag.PosteriorMatcher(GRID, half_width=200.0, sigma=0.5, max_samples=12),
        sample,
        [
            lambda s: s.update(np.nan, 0.0, 1.0),
            lambda s: s.update(0.0, 1e30, 1.0),
            lambda s: s.update(0.0, 0.0, np.inf),
        ],
    ),
    "SlidingContour": (
        lambda: geomag.SlidingContour(GRID, length=6, transform="translation", radius_m=400.0),
        sample,
        [
            lambda s: s.update(np.nan, 0.0, 1.0),
            lambda s: s.update(0.0, 1e30, 1.0),
            lambda s: s.update(0.0, 0.0, np.inf),
        ],
    ),
    "DeltaModulator": (
        lambda: geomag.DeltaModulator(2.0),
        lambda s, k: s.update(READINGS[k]),
        [lambda s: s.update(np.nan)],
    ),
    "Compensator": (
        lambda: Compensator([100.0, 20.0] + [0.5] * 16, max_gap_s=2.0),
        lambda s, k: s.update(float(k), [30_000.0 + 10 * k, 500.0 * k, 40_000.0], 50_060.0),
        [lambda s: s.update(np.nan, [1.0, 2.0, 3.0], 1.0), lambda s: s.update(1e9, [1.0, 2.0], 1.0)],
    ),
    "FieldNavigator": (
        lambda: geomag.FieldNavigator(
            GRID, start=(830.0, 1010.0), covariance_m2=900.0, reading_sigma=1.0, speed_sigma_m_s=0.2, bias_sigma=1.0
        ),
        lambda s, k: s.step(10.0, 5.0, 53.13, READINGS[k]),
        [
            lambda s: s.step(-1.0, 5.0, 0.0),
            lambda s: s.step(1.0, 1e12, 0.0, 1.0),
            lambda s: s.step(1.0, 5.0, 0.0, [1.0, 2.0]),
        ],
    ),
    "Navigator": (
        lambda: geomag.Navigator(GRID, position_sigma_m=100.0),
        lambda s, k: s.step(float(k), INDICATED[0][k], INDICATED[1][k], (40.0, 30.0), 53.13, READINGS[k]),
        [
            lambda s: s.step(1e9, np.nan, 0.0, (0.0, 0.0), 0.0, 1.0),
            lambda s: s.step(1e9, 0.0, 1e30, (0.0, 0.0), 0.0, 1.0),
            lambda s: s.step(1e9, 0.0, 0.0, (0.0, 0.0), 0.0, np.inf),
        ],
    ),
    "InsFeedback": (
        geomag.InsFeedback,
        feedback,
        [
            lambda s: s.step(-5.0, 0.0, 0.0) or s.step(-6.0, 0.0, 0.0),
            lambda s: s.step(1e9, 1e30, 0.0),
            lambda s: s.step(1e9, 0.0, 0.0, offset_m=(1.0, 2.0), covariance_m2=[[1.0, 2.0], [2.0, 1.0]]),
        ],
    ),
    "UnscentedKalmanFilter": (
        lambda: geomag.UnscentedKalmanFilter([0.0, 1.0], np.diag([4.0, 1.0])),
        kalman,
        [lambda s: s.predict(lambda x: [np.nan, 0.0], 0.1), lambda s: s.update([1.0], [[1.0, 0.0]], -1.0)],
    ),
    "ExtendedKalmanFilter": (
        lambda: geomag.ExtendedKalmanFilter([0.0, 1.0], np.diag([4.0, 1.0])),
        extended,
        [lambda s: s.predict([np.nan, 0.0], np.eye(2), 0.1), lambda s: s.update([1.0], [1.0], [[1.0, 0.0]], -1.0)],
    ),
}

#: Objects that are saved and are no streams.
OBJECTS = {
    "Fix": lambda: geomag.match_grid(GRID, geomag.Track(*INDICATED, READINGS), half_width=100.0, surface=True),
    "Path": lambda: geomag.synthetic.Path.straight(
        (0.0, 0.0), course_deg=30.0, speed_m_s=10.0, interval_s=1.0, samples=5
    ),
    "SyntheticField": lambda: geomag.synthetic.Crust(waves=4, dipoles=2).draw((0.0, 0.0, 1e4, 1e4), seed=1),
}


NORTH, EAST = (a.ravel() for a in np.meshgrid(*[np.linspace(-5e3, 5e3, 11)] * 2))
MODEL = geomag.RectangularHarmonicModel.fit(
    NORTH, EAST, 0.0, np.stack([np.sin(NORTH / 1e3), np.cos(EAST / 700), np.sin(EAST / 700)], -1), order=4
)

#: Objects that are saved as what they were made of: a text or arguments, for the constructor's own checks to judge.
BY_VALUE = {
    "GridMap": lambda: geomag.GridMap(np.arange(12.0).reshape(3, 4), [0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0], sigma=2.0),
    "MapStack": lambda: geomag.MapStack(
        [geomag.GridMap(np.ones((2, 2)), [0.0, 1.0], [0.0, 1.0], height_m=h) for h in (0.0, 50.0)]
    ),
    "Track": lambda: geomag.Track([0.0, 1.0, 2.0], [5.0, 6.0, 7.0], [1.0, 2.0, 3.0], time_s=[0.0, 1.0, 2.0]),
    "LocalFrame": lambda: geomag.LocalFrame(49.0, -100.0, 200.0),
    "RectangularHarmonicModel": lambda: MODEL,
    "HarmonicMap": lambda: MODEL.to_map("down", down_m=-100.0),
    "MainFieldModel": lambda: MainFieldModel([2020.0, 2025.0], np.ones((2, 2)), np.zeros((2, 2)), degree=1),
    "SearchBox": lambda: geomag.SearchBox(half_width_m=(300.0, 400.0), step=2.0),
    "InsPrior": lambda: geomag.InsPrior(heading_sigma_deg=1.0),
    "Acceptance": lambda: geomag.Acceptance(tolerance_m=100.0),
    "InsModel": geomag.InsModel.tactical,
    "MatcherPlan": geomag.MatcherPlan,
    "FieldSensor": lambda: geomag.FieldSensor(GRID),
}


def state(stream):
    return stream.__reduce__()[1][-1]


def varint(number):
    out = bytearray()
    while True:
        number, low = number >> 7, number & 127
        out.append(low | (128 if number else 0))
        if not number:
            return bytes(out)


def opened(data):
    """Head, up to the name, and body of a saved state."""
    at = 0

    def read():
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    for _ in range(2):
        length = read()
        at += length
    head = data[:at]
    read(), read()
    return head, data[at:]


def sealed(head, body):
    """Bytes with a checksum that fits: what is in them is then for the object itself to judge."""
    total = 0xCBF29CE484222325
    for byte in body:
        total = ((total ^ byte) * 0x100000001B3) % (1 << 64)
    return head + varint(len(body)) + varint(total) + body


@pytest.mark.parametrize("name", STREAMS)
def test_saved_and_resumed_is_undisturbed(name):
    """Update, save, load in any order, begun again once: to the last bit what a stream says that nobody touched."""
    make, step, _ = STREAMS[name]

    @settings(max_examples=12, deadline=None, database=None, derandomize=True)
    @given(st.lists(st.booleans(), min_size=8, max_size=20))
    def check(saves):
        plain, moved = make(), make()
        for k, save in enumerate(saves):
            if save:
                moved = pickle.loads(pickle.dumps(moved))
            assert repr(step(plain, k)) == repr(step(moved, k))
        assert state(plain) == state(moved)
        if hasattr(moved, "reset") and name != "Navigator":  # a navigator is reset to a place
            moved.reset()
            assert state(moved) == state(make())

    check()


@pytest.mark.parametrize("name", STREAMS)
def test_a_refused_update_changes_nothing(name):
    make, step, refused = STREAMS[name]
    stream = make()
    for k in range(9):
        for bad in refused:
            before = state(stream)
            with contextlib.suppress(geomag.GeomagError):
                copy = pickle.loads(pickle.dumps(stream))
                bad(copy)
                continue
            assert state(copy) == before or name == "InsFeedback"
            with pytest.raises(geomag.GeomagError):
                bad(stream)
            if name != "InsFeedback":
                assert state(stream) == before
        step(stream, k)


@pytest.mark.parametrize("name", [*STREAMS, *OBJECTS])
def test_any_bytes_are_refused_or_make_a_valid_object(name):
    if name in STREAMS:
        make, step, _ = STREAMS[name]
        whole = make()
        for k in range(4):
            step(whole, k)
    else:
        whole, step = OBJECTS[name](), None
    restore, arguments = whole.__reduce__()
    *others, data = arguments
    head, body = opened(data)
    assert sealed(head, body) == data
    assert state(restore(*others, data)) == data

    @settings(
        max_examples=150, deadline=None, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
    )
    @given(
        st.lists(st.tuples(st.integers(0, len(body) - 1), st.integers(0, 255)), min_size=1, max_size=4),
        st.integers(-3, 3),
        st.booleans(),
    )
    def check(changes, longer, honest):
        bent = bytearray(body)
        for at, value in changes:
            bent[at] = value
        bent = bytes(bent[: len(bent) + min(longer, 0)]) + b"\x01" * max(longer, 0)
        broken = sealed(head, bent) if honest else head + data[len(head) : len(data) - len(body)] + bent
        try:
            other = restore(*others, broken)
        except geomag.GeomagError:
            return
        # What came back is an object like any other.
        repr(other)
        for attribute in dir(other):
            if not attribute.startswith("_"):
                with contextlib.suppress(geomag.GeomagError):
                    getattr(other, attribute)
        if step is not None:
            with contextlib.suppress(geomag.GeomagError):
                step(other, 5)
        restore(*others, state(other))

    check()


@pytest.mark.parametrize("name", [*STREAMS, *OBJECTS])
def test_damage_is_found_by_its_checksum(name):
    whole = (STREAMS[name][0] if name in STREAMS else OBJECTS[name])()
    restore, arguments = whole.__reduce__()
    *others, data = arguments
    for at in range(0, len(data), 1 + len(data) // 40):
        bent = bytearray(data)
        bent[at] ^= 4
        with pytest.raises(geomag.StateError):
            restore(*others, bytes(bent))
    with pytest.raises(geomag.StateError):
        restore(*others, data[: len(data) // 2])
    with pytest.raises(geomag.StateError):
        restore(*others, data + b"\x00")


def test_a_small_state_takes_little_to_refuse():
    """A lattice of a million offsets and more in a state of a thousand bytes is refused before it is made."""
    matcher = geomag.PosteriorMatcher(GRID, half_width=200.0, sigma=0.5)
    restore, (grid, data) = matcher.__reduce__()
    head, body = opened(data)
    # The two numbers of half_width come first in the options.
    wide = np.array([1e6, 1e6]).tobytes()
    assert np.array([200.0, 200.0]).tobytes() in body
    with pytest.raises(geomag.GeomagError):
        restore(grid, sealed(head, body.replace(np.array([200.0, 200.0]).tobytes(), wide)))


def test_a_field_that_ends_does_not_cost_the_matcher_its_place():
    """A wild position asks for too large a window of a model: it is refused, and the samples after it fix as if it never came."""
    north, east = (a.ravel() for a in np.meshgrid(*[np.linspace(-5e3, 5e3, 21)] * 2))
    field = np.stack([-30 * np.sin(north / 1e3), 20 * np.cos(east / 700), 30 * np.cos(north / 1e3)], -1)
    field[:, 2] += 20 * np.sin(east / 700)
    model = geomag.RectangularHarmonicModel.fit(north, east, 0.0, field, order=10).to_map("down", down_m=0.0)
    rng = np.random.default_rng(0)
    calm, shaken = (
        geomag.PosteriorMatcher(model, half_width=300, sigma=1.0, tolerance_m=100, max_candidates=2500)
        for _ in range(2)
    )
    refused = 0
    for k in range(12):
        x, y = -2500.0 + 120 * k, -1500.0 + 90 * k
        value = float(model.sample(x, y)) + rng.normal(0, 0.5)
        if k == 3:
            before = state(shaken)
            with pytest.raises(geomag.GeomagError):
                shaken.update(1e7, 1e7, value)
            assert state(shaken) == before
            refused += 1
        assert repr(calm.update(x - 150, y + 90, value)) == repr(shaken.update(x - 150, y + 90, value))
    assert refused == 1


def test_every_saved_type_is_in_the_battery():
    module = geomag._geomag
    saved = {
        name
        for name in dir(module)
        if isinstance(getattr(module, name), type) and "__reduce__" in vars(getattr(module, name))
    }
    assert saved == {*STREAMS, *OBJECTS, *BY_VALUE}


def parts(arguments):
    """Every number, text and array in nested arguments, as paths to it."""
    for k, item in arguments.items() if isinstance(arguments, dict) else enumerate(arguments):
        if isinstance(item, (tuple, list, dict)):
            yield from ((k, *path) for path in parts(item))
        elif isinstance(item, (int, float, str, np.ndarray)) and not isinstance(item, bool):
            yield (k,)


def bent(arguments, path, with_what):
    out = dict(arguments) if isinstance(arguments, dict) else list(arguments)
    first, *rest = path
    out[first] = bent(out[first], rest, with_what) if rest else with_what(out[first])
    return type(arguments)(out)


def broken(item, how):
    """A number, text or array of an object's arguments that is not what it was."""
    if isinstance(item, str):
        at = how % max(len(item), 1)
        return item[:at] + "9e-"[how % 3] + item[at + 1 + how % 2 :]
    wild = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e300, 1e-300, 3.0][how % 8]
    if isinstance(item, np.ndarray):
        if how % 3 == 0:
            return item[..., :-1] if item.ndim else item
        with np.errstate(over="ignore"):
            changed = item.copy()
        changed.flat[how % changed.size] = wild
        return changed
    return type(item)(wild) if np.isfinite(wild) and abs(wild) < 1e9 else wild


@pytest.mark.parametrize("name", BY_VALUE)
def test_any_value_is_refused_or_makes_a_valid_object(name):
    whole = BY_VALUE[name]()
    assert repr(pickle.loads(pickle.dumps(whole))) == repr(whole)
    restore, arguments = whole.__reduce__()[:2]
    assert pickle.dumps(restore(*arguments).__reduce__()[1]) == pickle.dumps(arguments)
    paths = list(parts(arguments))
    assert paths or name == "MapStack"

    @settings(max_examples=60, deadline=None, database=None, derandomize=True)
    @given(st.integers(0, max(len(paths) - 1, 0)), st.integers(0, 10_000))
    def check(which, how):
        if not paths:
            return
        try:
            other = restore(*bent(arguments, paths[which], lambda item: broken(item, how)))
        except (geomag.GeomagError, TypeError, ValueError, OverflowError):
            return
        repr(other)
        for attribute in dir(other):
            if not attribute.startswith("_"):
                with contextlib.suppress(geomag.GeomagError):
                    getattr(other, attribute)
        pickle.loads(pickle.dumps(other))

    check()
