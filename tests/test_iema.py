"""IEMA against a naive oracle, candidate by candidate, and its contracts."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from fields import rough
from oracles import NaiveIema

import geomag


def make(seed, *, dtype="float64", holes=0.0, spacing=(0.01, 0.02)):
    rng = np.random.default_rng(seed)
    ny, nx = 40, 50
    values = rough(rng, ny, nx).astype(dtype)
    if holes:
        values[rng.random((ny, nx)) < holes] = np.nan
    x, y = 10 + spacing[0] * np.arange(nx), 40 + spacing[1] * np.arange(ny)
    return rng, values, x, y


def draw_track(rng, x, y, n, offset):
    """A straight track inside the map and its indicated copy."""
    dx, dy = x[1] - x[0], y[1] - y[0]
    start = np.array([x[0] + dx * rng.uniform(14, 20), y[0] + dy * rng.uniform(14, 20)])
    velocity = np.array([dx * rng.uniform(0.3, 1.1), dy * rng.uniform(0.3, 1.1)])
    truth = start + np.arange(n)[:, None] * velocity
    return truth, truth - offset


@pytest.mark.parametrize(
    ("options", "oracle_options"),
    [
        ({}, {}),
        ({"tolerance": (0.011, 0.021)}, {"tolerance": (0.011, 0.021)}),
        ({"max_misses": 2}, {"max_misses": 2}),
        ({"unknown": "drop"}, {"drop": True}),
        ({"step": (0.005, 0.01)}, {"step": (0.005, 0.01)}),
        ({"step": (0.0071, 0.0123)}, {"step": (0.0071, 0.0123)}),
    ],
    ids=["paper", "tolerance", "misses", "drop", "half-step", "odd-step"],
)
@pytest.mark.parametrize("seed", range(60))
def test_equals_the_naive_rule(seed, options, oracle_options):
    """Feasible set, scores, extent, best and status are the oracle's after every sample, on and off the grid."""
    rng, values, x, y = make(seed, holes=0.01 if seed % 3 == 2 else 0.0)
    spacing = (0.01, 0.02)
    half = (0.05, 0.1)
    on_grid = seed % 2 == 0
    cells = rng.integers(-5, 6, 2) if on_grid else rng.uniform(-5, 5, 2)
    truth, indicated = draw_track(rng, x, y, 18, cells * spacing)
    sigma = 4.0
    grid = geomag.GridMap(values, x, y)
    readings = grid.sample(truth[:, 0], truth[:, 1])
    readings = np.where(np.isnan(readings), 0.0, readings) + rng.normal(0, sigma, len(truth))
    oracle = NaiveIema(values, x, y, sigma, half, **{"step": spacing, **oracle_options})
    iema = geomag.Iema(grid, sigma=sigma, half_width=half, **options)
    for k in range(len(truth)):
        step = iema.update(*indicated[k], readings[k])
        status, extent, best = oracle.update(*indicated[k], readings[k])
        np.testing.assert_array_equal(iema.feasible, oracle.T)
        np.testing.assert_allclose(iema.log_scores[oracle.T], oracle.logS[oracle.T], rtol=1e-9, atol=1e-9)
        assert step.status == status
        assert step.n_feasible == oracle.T.sum()
        if status == "lost":
            assert not step.fix.ok
            assert math.isnan(step.fix.x)
            break
        np.testing.assert_allclose(step.extent, extent, atol=1e-12)
        np.testing.assert_allclose(step.best_offset, best, atol=1e-12)


def test_true_offset_on_the_grid_is_found_and_reported():
    rng, values, x, y = make(3)
    grid = geomag.GridMap(values, x, y)
    truth, indicated = draw_track(rng, x, y, 30, np.array([0.03, -0.04]))
    track = geomag.Track(indicated[:, 0], indicated[:, 1], grid.sample(truth[:, 0], truth[:, 1]))
    fix = geomag.Iema(grid, sigma=1.0, half_width=(0.05, 0.1)).run(track)
    assert fix.ok
    assert fix.status == "fixed"
    assert fix.offset == pytest.approx((0.03, -0.04))
    used = fix.n_samples
    assert 1 < used < 30
    np.testing.assert_allclose(fix.track, truth[:used], atol=1e-9)
    assert (fix.x, fix.y) == pytest.approx(tuple(truth[used - 1]))
    assert fix.covariance_m2 is None
    assert fix.risk is None


def test_float32_map_follows_the_same_candidates():
    rng, values, x, y = make(5, dtype="float32")
    truth, indicated = draw_track(rng, x, y, 20, np.array([0.02, 0.02]))
    small, large = geomag.GridMap(values, x, y), geomag.GridMap(values.astype(float), x, y)
    assert small.values.dtype == np.float32
    a, b = (geomag.Iema(g, sigma=3.0, half_width=(0.05, 0.1)) for g in (small, large))
    for p, v in zip(indicated, large.sample(truth[:, 0], truth[:, 1]), strict=True):
        a.update(*p, v)
        b.update(*p, v)
        np.testing.assert_array_equal(a.feasible, b.feasible)


@pytest.mark.parametrize("at", [0, 1, 4])
def test_saved_state_goes_on_bit_for_bit(at):
    rng, values, x, y = make(7)
    grid = geomag.GridMap(values, x, y)
    truth, indicated = draw_track(rng, x, y, 12, np.array([0.013, 0.037]))
    readings = grid.sample(truth[:, 0], truth[:, 1]) + rng.normal(0, 2, 12)
    through = geomag.Iema(grid, sigma=4.0, half_width=(0.05, 0.1), max_misses=1)
    broken = geomag.Iema(grid, sigma=4.0, half_width=(0.05, 0.1), max_misses=1)
    for k in range(12):
        if k == at:
            broken = pickle.loads(pickle.dumps(broken))
        one, other = through.update(*indicated[k], readings[k]), broken.update(*indicated[k], readings[k])
        assert repr(one) == repr(other)
        np.testing.assert_array_equal(through.log_scores, broken.log_scores)


def test_damaged_state_is_refused():
    _, values, x, y = make(1)
    iema = geomag.Iema(geomag.GridMap(values, x, y), sigma=1.0, half_width=0.05)
    iema.update(10.2, 40.4, 0.0)
    restore, (grid, state) = iema.__reduce__()
    for bad in (b"", b"nonsense", state[:-3], state + b"x"):
        with pytest.raises(geomag.StateError):
            restore(grid, bad)
    other = geomag.GridMap(values[:4, :4], x[:4] * 100, y[:4])
    with pytest.raises(geomag.StateError, match="outside"):
        restore(other, state) if iema.n_feasible else pytest.skip("nothing feasible is left to misplace")


def test_reset_begins_again():
    _rng, values, x, y = make(2)
    iema = geomag.Iema(geomag.GridMap(values, x, y), sigma=1.0, half_width=(0.05, 0.1))
    assert iema.n_feasible == 11 * 11
    iema.update(10.2, 40.4, 1e6)
    assert iema.n_feasible == 0
    iema.reset()
    assert iema.n_feasible == 121
    assert iema.n_samples == 0


def test_a_candidate_that_was_never_tested_is_no_fix():
    """On a hole every candidate survives untested; a lattice of one is unique but says nothing."""
    values = np.full((10, 10), np.nan)
    values[0, 0] = 1.0
    grid = geomag.GridMap(values, np.arange(10.0), np.arange(10.0))
    step = geomag.Iema(grid, sigma=1.0, half_width=0.0).update(5.0, 5.0, 3.0)
    assert step.n_feasible == 1
    assert step.status == "searching"


def test_survives_an_outlier_when_allowed():
    rng, values, x, y = make(11)
    grid = geomag.GridMap(values, x, y)
    truth, indicated = draw_track(rng, x, y, 30, np.array([0.03, -0.04]))
    readings = grid.sample(truth[:, 0], truth[:, 1])
    readings[1] += 500.0
    track = geomag.Track(indicated[:, 0], indicated[:, 1], readings)
    assert geomag.Iema(grid, sigma=1.0, half_width=(0.05, 0.1)).run(track).status == "lost"
    fix = geomag.Iema(grid, sigma=1.0, half_width=(0.05, 0.1), max_misses=1).run(track)
    assert fix.ok
    assert fix.offset == pytest.approx((0.03, -0.04))


def test_works_across_the_date_line():
    rng = np.random.default_rng(4)
    values = rough(rng, 60, 60)
    x = 179.7 + 0.01 * np.arange(60)
    y = -10 + 0.01 * np.arange(60)
    grid = geomag.GridMap(values, np.where(x >= 180, x - 360, x), y, geographic=True)
    lon, lat = 179.93 + 0.008 * np.arange(25), -9.75 + 0.006 * np.arange(25)
    readings = grid.sample(lon, lat)
    indicated = lon - 0.03
    wrapped = np.where(indicated >= 180, indicated - 360, indicated)
    fix = geomag.Iema(grid, sigma=0.5, half_width=0.05).run(geomag.Track(wrapped, lat + 0.02, readings))
    assert fix.ok
    assert fix.offset == pytest.approx((0.03, -0.02))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"sigma": 0.0}, "sigma: needed a finite number > 0, got 0"),
        ({"sigma": -1.0}, "sigma"),
        ({"sigma": math.nan}, "sigma"),
        ({"half_width": (-0.1, 0.1)}, "half_width x"),
        ({"half_width": (0.1, 0.1, 0.1)}, "half_width"),
        ({"tolerance": -1.0}, "tolerance x"),
        ({"step": 0.0}, "step x"),
        ({"unknown": "maybe"}, "'keep' or 'drop'"),
        ({"gate_sigmas": 0.0}, "gate_sigmas"),
    ],
)
def test_bad_options_say_what_is_wrong(change, match):
    _, values, x, y = make(0)
    options = {"sigma": 1.0, "half_width": 0.05, **change}
    with pytest.raises(geomag.InvalidInputError, match=match):
        geomag.Iema(geomag.GridMap(values, x, y), **options)


def test_a_huge_lattice_is_refused_before_memory_is_taken():
    _, values, x, y = make(0)
    with pytest.raises(geomag.CandidateLimitError, match="max_candidates"):
        geomag.Iema(geomag.GridMap(values, x, y), sigma=1.0, half_width=(1.0, 1.0), step=(6e-5, 6e-5))


@pytest.mark.parametrize("sample", [(math.nan, 40.0, 1.0), (10.0, math.inf, 1.0), (10.0, 40.0, math.nan)])
def test_a_bad_sample_leaves_the_state_as_it_was(sample):
    _, values, x, y = make(0)
    iema = geomag.Iema(geomag.GridMap(values, x, y), sigma=1.0, half_width=0.05)
    iema.update(10.2, 40.4, values[20, 20])
    before = iema.log_scores.copy()
    with pytest.raises(geomag.NotFiniteError):
        iema.update(*sample)
    np.testing.assert_array_equal(iema.log_scores, before)
    assert iema.n_samples == 1


def test_nothing_tested_is_no_offset():
    _, values, x, y = make(0)
    iema = geomag.Iema(geomag.GridMap(values, x, y), sigma=1.0, half_width=0.05)
    step = iema.update(12.0, 40.4, 1.0)
    assert (step.status, step.n_feasible) == ("searching", 11 * 7)
    assert np.isnan([*step.best_offset, step.log_score, step.runner_up]).all()
    fix = iema.run(geomag.Track([12.0, 12.01], [40.4, 40.41], [1.0, 2.0]))
    assert (fix.status, fix.n_samples, len(fix.track)) == ("searching", 2, 0)
    assert np.isnan([fix.x, fix.y, *fix.offset, *fix.offset_m, fix.score, fix.runner_up]).all()
    on_map = iema.update(10.2, 40.4, values[20, 20])
    assert np.isfinite([*on_map.best_offset, on_map.log_score]).all()


def test_many_candidates_are_the_same_as_few():
    """Large lattices go through the threads; the same candidates in a small one do not."""
    _, values, x, y = make(3)
    grid = geomag.GridMap(values, x, y)
    large = geomag.Iema(grid, sigma=60.0, half_width=0.2, step=(0.001, 0.001), max_misses=1)
    small = geomag.Iema(grid, sigma=60.0, half_width=0.05, step=(0.001, 0.001), max_misses=1)
    for k in range(6):
        sample = (10.21 + 0.007 * k, 40.37 + 0.004 * k, values[20, 20])
        step = large.update(*sample)
        small.update(*sample)
        assert step.n_feasible == np.isfinite(large.log_scores).sum()
        assert step.n_feasible > 2**15
    np.testing.assert_allclose(large.log_scores[150:251, 150:251], small.log_scores, rtol=1e-12)
