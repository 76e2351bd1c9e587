"""Sizes out of all reason are refused in a word, before memory or time is spent on them."""

import numpy as np
import pytest

import geomag
from geomag.campaign._plan import _numbers

HUGE = 2**61
AXIS = np.arange(0.0, 6000.0, 100.0)


@pytest.fixture(scope="module")
def grid():
    return geomag.GridMap(90 * np.sin(AXIS / 400)[None, :] * np.cos(AXIS / 500)[:, None], AXIS, AXIS)


@pytest.fixture(scope="module")
def track(grid):
    k = np.arange(30.0)
    x, y = 1000 + 90 * k, 2000 + 40 * k
    return geomag.Track(x, y, grid.sample(x + 210, y - 125))


def test_bounds_of_a_box_beyond_the_map_are_unknown(grid):
    for half_width in (1e11, 1e300, np.inf, np.nan):
        assert np.isnan(grid.bounds(50.0, 50.0, half_width=half_width)).all()
    assert np.isnan(grid.bounds(np.nan, 50.0, half_width=10.0)).all()
    # The whole map and not a cell more.
    middle, half = 0.5 * AXIS[-1], 0.5 * AXIS[-1]
    assert grid.bounds(middle, middle, half_width=half) == (grid.values.min(), grid.values.max())
    assert np.isnan(grid.bounds(middle, middle, half_width=half + 1)).all()


@pytest.mark.parametrize(
    "options",
    [
        {"method": "bpso", "particles": HUGE},
        {"method": "bpso", "iterations": HUGE},
        {"max_length": 10**9},
        {"max_length": HUGE},
        {"max_length": HUGE, "max_iterations": HUGE},
        {"draws": HUGE},
        {"draws": 10**6, "quanta": np.arange(1.0, 400.0)},
        {"quanta": np.arange(1.0, 10**6)},
    ],
    ids=str,
)
def test_tuning_states_its_limits(grid, track, options):
    with pytest.raises(geomag.InvalidInputError, match=r"at most|to 1000000"):
        geomag.tune_sequence(grid, track, sigma=0.5, offset_m=250.0, **options)


@pytest.mark.parametrize(("half_width_m", "step_m"), [(2.0**127, 1.0), (1e308, 1e-300), (1e5, 1.0)])
def test_a_start_lattice_over_its_limit_is_refused(grid, track, half_width_m, step_m):
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_contour(grid, track, starts="grid", half_width_m=half_width_m, step_m=step_m)


def test_no_caller_raises_a_limit_beyond_what_a_machine_has(grid, track):
    most = 2**64 - 1
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_contour(grid, track, starts="grid", half_width_m=1e9, step_m=1.0, max_candidates=most)
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_grid(grid, track, half_width=1e9, step=1.0, max_candidates=most)
    with pytest.raises(geomag.CandidateLimitError):
        geomag.Iema(grid, sigma=1.0, half_width=1e9, step=1.0, max_candidates=most)


def test_a_filter_states_its_limit():
    for make in (geomag.UnscentedKalmanFilter, geomag.ExtendedKalmanFilter):
        with pytest.raises(geomag.GeomagError, match="at most 4096"):
            make(np.zeros(10**6), 1.0)
    with pytest.raises(geomag.GeomagError, match="at most 4096"):
        geomag.UnscentedKalmanFilter(np.zeros(2), 1.0).update(np.zeros(10**6), lambda x: np.zeros(10**6), 1.0)


def test_orders_are_not_cut_short():
    assert len(geomag.RectangularHarmonicModel.terms(800)) == 2 * 800 * 801
    for order in (801, 1001, HUGE):
        with pytest.raises(geomag.InvalidInputError, match="800"):
            geomag.RectangularHarmonicModel.terms(order)


def test_flights_and_trials_state_their_limits(grid, track):
    from geomag._geomag import predict_many

    with pytest.raises(geomag.InvalidInputError, match="at most"):
        predict_many(grid, [track], half_width=500.0, sigma=1.0, flights=HUGE)
    with pytest.raises(geomag.InvalidInputError, match="at most"):
        _numbers(10**12)


def test_more_threads_than_the_system_has_are_not_started(grid, track):
    with pytest.raises(geomag.InvalidInputError, match="threads: needed 1 to 512"):
        geomag.match_grid(grid, track, half_width=500.0, threads=HUGE)
