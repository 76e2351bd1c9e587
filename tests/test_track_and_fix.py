"""Track and Fix: contracts and bad input."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from fields import rough
from hypothesis import given, settings
from hypothesis import strategies as st

import geomag


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (([], [], []), geomag.TooFewSamplesError, "needed at least 1 samples, got 0"),
        (([1, 2], [1], [1, 2]), geomag.ShapeError, "track y"),
        (([1], [1], [1], [1, 2]), geomag.ShapeError, "time_s"),
        (([1, np.nan], [1, 2], [1, 2]), geomag.NotFiniteError, r"track x\[1\]"),
        (([1, 2], [1, 2], [1, np.inf]), geomag.NotFiniteError, r"track values\[1\]"),
        (([1, 2], [1, 2], [1, np.nan]), geomag.NotFiniteError, r"track values\[1\]"),
        (([1, 2], [1, 2], [1, 2], [5, 4]), geomag.InvalidInputError, r"time_s\[1\]"),
        (([[1, 2]], [1, 2], [1, 2]), geomag.ShapeError, "one dimension"),
        ((["a"], [1], [1]), geomag.InvalidInputError, "real numbers"),
    ],
)
def test_bad_tracks_say_what_is_wrong(arguments, error, match):
    with pytest.raises(error, match=match):
        geomag.Track(*arguments)


def test_distance_on_the_ellipsoid():
    track = geomag.Track([0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1, 2, 3])
    d = track.distance_m(geographic=True)
    # One degree of meridian from the equator and of the parallel at one degree, WGS84 (geodesic values).
    assert d[1] == pytest.approx(110_574.4, abs=1.0)
    assert d[2] - d[1] == pytest.approx(111_302.6, abs=1.0)


def test_slices_and_pickles():
    track = geomag.Track(np.arange(5.0), np.arange(5.0) * 2, np.arange(5.0) * 3, np.arange(5.0))
    assert len(track[1:4]) == 3
    np.testing.assert_array_equal(track[::2].values, [0, 6, 12])
    back = pickle.loads(pickle.dumps(track))
    np.testing.assert_array_equal(back.values, track.values)
    with pytest.raises(geomag.TooFewSamplesError):
        track[5:]
    with pytest.raises(geomag.InvalidInputError, match="slice"):
        track[0]


def test_fix_is_readable_and_goes_to_json_and_back():
    rng = np.random.default_rng(0)
    grid = geomag.GridMap(rough(rng, 30, 30), np.arange(30.0) * 10, np.arange(30.0) * 10)
    k = np.arange(12)
    track = geomag.Track(80 + 9 * k, 90 + 7 * k, grid.sample(101 + 9 * k, 77 + 7 * k))
    fix = geomag.match_grid(grid, track, half_width=50, surface=True)
    assert "\n" not in repr(fix)
    assert repr(fix).startswith("Fix(fixed, x ")
    d = json.loads(json.dumps(fix.to_dict()))
    names = {"x", "y", "offset", "offset_m", "heading_deg", "scale", "covariance_m2", "risk", "status", "ok", "score"}
    assert names | {"runner_up", "n_samples", "iterations"} <= set(d)
    back = pickle.loads(pickle.dumps(fix))
    assert repr(back) == repr(fix)
    assert back.surface.tobytes() == fix.surface.tobytes()
    assert fix.offset == pytest.approx((21, -13), abs=1.0)
    assert (fix.x, fix.y) == pytest.approx((track.x[-1] + fix.offset[0], track.y[-1] + fix.offset[1]))


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(1, 12),
    st.sampled_from(["msd", "mad", "prod", "ncc", "hausdorff"]),
    st.floats(-400, 400),
    st.floats(0, 200),
    st.sampled_from([None, 3.0, 10.0, 5.0]),
    st.floats(0, 0.3),
    st.sampled_from(["f4", "f8"]),
)
def test_matchers_answer_or_refuse(seed, n, criterion, shift, half, step, holes, dtype):
    """Whatever is thrown at it: a typed error, or an answer that agrees with itself."""
    rng = np.random.default_rng(seed)
    values = rough(rng, 20, 25).astype(dtype)
    values[rng.random(values.shape) < holes] = np.nan
    values[0, 0] = 0.0
    grid = geomag.GridMap(values, 10.0 * np.arange(25), 10.0 * np.arange(20))
    track = geomag.Track(
        60 + shift + rng.uniform(0, 12, n).cumsum(), 60 + rng.uniform(0, 9, n).cumsum(), rng.normal(0, 100, n)
    )
    try:
        fix = geomag.match_grid(grid, track, criterion, half_width=half, step=step, surface=True)
    except geomag.GeomagError:
        return
    assert fix.ok == (fix.status == "fixed")
    finite = np.isfinite(fix.surface)
    if not finite.any():
        assert not fix.ok
        assert np.isnan(fix.x)
        return
    best = fix.surface[finite].max() if criterion in ("prod", "ncc") else fix.surface[finite].min()
    assert fix.score == pytest.approx(best, rel=1e-3, abs=1e-3)
    if fix.covariance_m2 is not None:
        assert np.all(np.linalg.eigvalsh(fix.covariance_m2) >= 0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.floats(-1e3, 1e3), st.floats(0, 300), st.floats(1e-3, 1e4), st.integers(0, 3))
def test_iema_answers_or_refuses(seed, shift, half, sigma, misses):
    rng = np.random.default_rng(seed)
    grid = geomag.GridMap(rough(rng, 20, 25), 10.0 * np.arange(25), 10.0 * np.arange(20))
    iema = geomag.Iema(grid, sigma=sigma, half_width=half, max_misses=misses)
    before = iema.n_feasible
    for k in range(6):
        step = iema.update(60 + shift + 9 * k, 70 + 7 * k, rng.normal(0, 100))
        assert step.n_feasible <= before
        assert step.n_feasible == iema.feasible.sum()
        assert (step.status == "lost") == (step.n_feasible == 0)
        before = step.n_feasible
