"""Calibrated matching: batch, streaming, several fields, prediction, survey maps, reports."""

from __future__ import annotations

import os
import pickle

import numpy as np
import pytest
from oracles import posterior

import geomag
from geomag import synthetic
from geomag._statistics import wilson
from geomag.calibration import assess, calibrate_lines, calibrate_simulated, suitability
from geomag.survey import (
    Lines,
    learn_errors,
    line_spacing_m,
    map_from_lines,
    read_lines,
    smooth_lines,
    with_line_spacing,
)


def field(x, y):
    x, y = np.asarray(x) / 1000, np.asarray(y) / 1000
    return 60 * np.sin(1.7 * x) * np.cos(1.3 * y) + 40 * np.sin(2.9 * x + 1.1 * y) + 25 * np.cos(3.7 * y - 0.6 * x)


@pytest.fixture(scope="module")
def grid():
    axis = np.arange(0.0, 12_001.0, 100.0)
    return geomag.GridMap(field(axis[None, :], axis[:, None]), axis, axis, sigma=0.0)


def flight(grid, offset, n=30, sigma=0.5, bias=0.0, seed=0):
    rng = np.random.default_rng(seed)
    course = rng.uniform(0, 2 * np.pi)
    along = 150 * (np.arange(n) - n / 2)
    x, y = 6000 + along * np.sin(course), 6000 + along * np.cos(course)
    return geomag.Track(x - offset[0], y - offset[1], grid.sample(x, y) + bias + rng.normal(0, sigma, n))


def test_fix_has_everything_that_it_declares(grid):
    fix = geomag.match_posterior(grid, flight(grid, (740, -310), bias=17), half_width=1000, sigma=0.5, tolerance_m=100)
    assert fix.ok
    assert np.hypot(fix.offset_m[0] - 740, fix.offset_m[1] + 310) < 30
    assert 0 <= fix.risk <= 0.01
    assert fix.goodness > 1e-3
    assert np.all(np.linalg.eigvalsh(fix.covariance_m2) > 0)


def test_a_plain_map_needs_no_words_about_its_error(grid):
    plain = geomag.GridMap(grid.values, grid.x, grid.y)
    fix = geomag.match_posterior(plain, flight(grid, (200, 300), n=40), half_width=1000, tolerance_m=200)
    assert not fix.ok or np.hypot(fix.offset_m[0] - 200, fix.offset_m[1] - 300) < 200


def test_surface_sums_to_one_and_peaks_at_the_answer(grid):
    fix = geomag.match_posterior(
        grid, flight(grid, (300, 400)), half_width=1000, sigma=0.5, step=100, surface=True, tolerance_m=200
    )
    assert fix.surface.shape == (21, 21)
    assert np.nansum(fix.surface) == pytest.approx(1, abs=1e-6)
    row, column = np.unravel_index(np.nanargmax(fix.surface), fix.surface.shape)
    assert (column - 10, row - 10) == (3, 4)


def test_streaming_agrees_with_batch_and_pickles(grid):
    track = flight(grid, (330, 610), n=25, bias=8)
    matcher = geomag.PosteriorMatcher(grid, half_width=1000, sigma=0.5)
    for k, sample in enumerate(zip(track.x, track.y, track.values, strict=True)):
        if k == 9:
            twin = pickle.loads(pickle.dumps(matcher))
        step = matcher.update(*sample)
        if k >= 9:
            other = twin.update(*sample)
            assert (other.status, other.risk, other.n_feasible) == (step.status, step.risk, step.n_feasible)
    batch = geomag.match_posterior(grid, track, half_width=1000, sigma=0.5)
    streamed = matcher.fix()
    assert streamed.status == batch.status
    assert streamed.offset_m == pytest.approx(batch.offset_m, abs=0.5)
    assert streamed.risk == pytest.approx(batch.risk, abs=1e-4)


@pytest.mark.parametrize("bias", [False, True])
def test_risk_and_covariance_are_those_of_the_exact_posterior(grid, bias):
    risks, exact = [], []
    for seed in range(40):
        offset = np.random.default_rng(seed).uniform(-900, 900, 2)
        track = flight(grid, offset, n=14 if bias else 9, sigma=5, bias=20.0 * bias, seed=seed)
        fix = geomag.match_posterior(
            grid, track, half_width=1000, sigma=5, tolerance_m=100, bias_sigma=None if bias else 0.0, nu=1e4
        )
        risk, centre, covariance, _ = posterior(grid.values, grid.x, grid.y, track, 5, 1050, 15, 100, bias=bias)
        risks.append(fix.risk)
        exact.append(risk)
        # A covariance that a far and unlikely place decides is as uncertain as that place.
        if risk < 1e-3:
            deviation = np.sqrt(np.trace(covariance))
            assert np.hypot(*(np.array(fix.offset_m) - centre)) < 0.1 * deviation + 1
            assert np.trace(fix.covariance_m2) == pytest.approx(np.trace(covariance), rel=0.1)
    risks, exact = np.array(risks), np.array(exact)
    assert np.sum(exact < 0.1) >= 5
    assert np.all(np.abs(risks - exact) < 0.03)
    assert np.mean(risks) == pytest.approx(np.mean(exact), rel=0.03)


def test_a_heading_error_larger_than_a_cell_is_integrated_out(grid):
    # 3 degrees over 4 km displace the first sample by two cells.
    sigma = np.radians(3.0)
    turns = np.linspace(-4, 4, 81) * sigma
    nees = []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        offset, turn = rng.uniform(-500, 500, 2), rng.normal(0, sigma)
        true = flight(grid, (0, 0), n=28, sigma=6, seed=seed)
        away = np.column_stack([true.x - true.x[-1], true.y - true.y[-1]])
        c, s = np.cos(turn), np.sin(turn)
        # Indicated so that turning clockwise about the newest sample brings it back.
        x = true.x[-1] + c * away[:, 0] - s * away[:, 1] - offset[0]
        y = true.y[-1] + c * away[:, 1] + s * away[:, 0] - offset[1]
        track = geomag.Track(x, y, true.values)
        fix = geomag.match_posterior(
            grid, track, half_width=600, sigma=6, tolerance_m=100, bias_sigma=0.0, heading_sigma_deg=3.0, nu=1e4
        )
        risk, centre, covariance, heading = posterior(
            grid.values, grid.x, grid.y, track, 6, 650, 20, 100, bias=False, headings=turns, heading_sigma=sigma
        )
        error = np.array(fix.offset_m) - offset
        nees.append(error @ np.linalg.solve(fix.covariance_m2, error))
        assert fix.risk == pytest.approx(risk, abs=0.05)
        if risk < 1e-3:
            assert np.hypot(*(np.array(fix.offset_m) - centre)) < 0.5 * np.sqrt(np.trace(covariance))
            assert np.trace(fix.covariance_m2) == pytest.approx(np.trace(covariance), rel=0.2)
            assert fix.heading_deg == pytest.approx(np.degrees(heading), abs=0.6)
    # The mean of 24 chi-square variables of two degrees of freedom, four standard errors.
    assert np.mean(nees) < 2 + 4 * 2 / np.sqrt(len(nees))


def test_a_stream_follows_drift_and_heading_among_outliers(grid):
    declared, wrong, fixed = 0.0, 0, 0
    for seed in range(40):
        rng = np.random.default_rng(500 + seed)
        offset, turn, drift = rng.uniform(-700, 700, 2), rng.normal(0, np.radians(3)), rng.normal(0, 60, 2)
        true = flight(grid, (0, 0), n=32, sigma=1, bias=rng.uniform(-50, 50), seed=seed)
        values = true.values + 50 * rng.choice([-1, 1], 32) * (rng.random(32) < 0.08)
        away = np.column_stack([true.x - true.x[-1], true.y - true.y[-1]])
        c, s = np.cos(turn), np.sin(turn)
        age = np.linspace(1, 0, 32)
        x = true.x[-1] + c * away[:, 0] - s * away[:, 1] - offset[0] + age * drift[0]
        y = true.y[-1] + c * away[:, 1] + s * away[:, 0] - offset[1] + age * drift[1]
        matcher = geomag.PosteriorMatcher(
            grid, half_width=1000, sigma=1, tolerance_m=150, heading_sigma_deg=3.0, drift_sigma_m=60.0
        )
        for k, sample in enumerate(zip(x, y, values, strict=True)):
            fix = matcher.update(*sample).fix
            if fix is not None and fix.ok:
                fixed += 1
                declared += fix.risk
                wrong += np.hypot(fix.x - true.x[k], fix.y - true.y[k]) > 150
                break
    assert fixed > 20
    assert wrong <= declared + 4 * np.sqrt(declared) + 0.5


def test_the_same_bits_whatever_runs_beside(grid):
    tracks = [flight(grid, (100, 50 * k), seed=k) for k in range(8)]
    many = geomag.match_posterior_many(grid, tracks, half_width=1000, sigma=0.5)
    for track, fix in zip(tracks, many, strict=True):
        alone = geomag.match_posterior(grid, track, half_width=1000, sigma=0.5)
        assert (alone.x, alone.y, alone.risk) == (fix.x, fix.y, fix.risk)


def test_a_second_field_helps(grid):
    axis = grid.x
    other = geomag.GridMap(field(axis[None, :] + 5000, axis[:, None] - 3000), axis, axis, sigma=0.0)
    track = flight(grid, (100, 200), n=12, sigma=2)
    values = other.sample(track.x + 100, track.y + 200)
    alone = geomag.match_posterior(grid, track, half_width=1000, sigma=2.0)
    both = geomag.match_posterior(grid, track, half_width=1000, sigma=2.0, channels=[(other, values, 2.0)])
    assert np.trace(both.covariance_m2) < np.trace(alone.covariance_m2)


def test_bad_input_says_what_was_needed(grid):
    track = flight(grid, (0, 0))
    with pytest.raises(geomag.InvalidInputError, match="half_width"):
        geomag.match_posterior(grid, track, half_width=-1)
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_posterior(grid, track, half_width=1000, step=0.01)
    with pytest.raises(geomag.InvalidInputError, match="max_risk"):
        geomag.match_posterior(grid, track, half_width=1000, max_risk=2)
    for name, value in {"heading_sigma_deg": 181, "scale_sigma": 2, "drift_sigma_m": np.inf}.items():
        with pytest.raises(geomag.InvalidInputError, match=name):
            geomag.match_posterior(grid, track, half_width=1000, **{name: value})
    with pytest.raises(geomag.ShapeError):
        grid.with_error_model(nu=3, scale_spread=0.3, correlation=1, registration=0.1, distance_m=np.zeros((2, 2)))


def test_error_model_stays_with_the_map(grid):
    layered = geomag.GridMap(grid.values, grid.x, grid.y, sigma=2.0).with_error_model(
        nu=3, scale_spread=0.3, correlation=1, registration=0.1, distance_m=150.0
    )
    again = pickle.loads(pickle.dumps(layered))
    assert again.error_model == layered.error_model
    assert again.error_model["distance_m"] == 150.0


def test_what_filters_need_stays_with_the_map(grid):
    plain = {"nu": 3.0, "scale_spread": 0.3, "correlation": 1.0, "registration": 0.1, "distance_m": 150.0}
    law = {
        "sample_factor": 1.8,
        "batch_factor": 1.6,
        "crossover": 2.5,
        "registration_m_per_d": 0.4,
        "registration_length": 30.0,
    }
    assert grid.with_error_model(**plain).error_model == plain
    layered = grid.with_error_model(**plain, **law)
    assert layered.error_model == plain | law
    assert layered.with_error_model(**layered.error_model).error_model == plain | law
    assert pickle.loads(pickle.dumps(layered)).error_model == plain | law
    partly = grid.with_error_model(**plain, crossover=2.0).error_model
    assert partly["crossover"] == 2.0
    assert set(partly) == set(plain | law)
    for name in law:
        with pytest.raises(geomag.InvalidInputError, match=name):
            grid.with_error_model(**plain, **(law | {name: -1.0}))


#: Two tracks over the EMM map, (first, step, offset) of longitude and latitude and readings, at which a search that judges a
#: coarse cell by a density widened to its size is sure of a place kilometres away: the flat places win.
LOST_BY_COARSE_DENSITY = [
    (
        (118.8104184088991, -0.009142125187663871, 0.08416999),
        (31.776816542016014, -0.0050154132697789785, -0.02353608),
        "19.6 24.27 30.99 36.21 43.04 48.96 55.73 62.12 67.99 74.66 81.24 87.33 93.05 98.51 103.77 109.2 114.9 119.57 124.4 "
        "128.14 130.58 134.92 136.96 140.83 142.17 143.22 143.63 144.02 144.86 144.17 143.19 142.05 140.77 137.17 135.42 133.3 "
        "129.87 125.43 121.85 118.31",
    ),
    (
        (116.60587702984708, 0.010316926777321829, 0.06124858),
        (32.50544744005069, -0.00298513064075296, -0.09115291),
        "29.82 29.53 28.87 28.54 25.7 23.72 22.39 20.57 17.28 14.15 10.76 7.34 3.25 0.11 -3.13 -6.41 -10.34 -15.48 -17.8 -21.46 "
        "-24.53 -28.22 -30.55 -33.3 -35.71 -38.63 -39.7 -41.54 -42.19 -42.53 -43.11 -43.49 -43.41 -42.82 -42.17 -41.44 -40.57 "
        "-38.26 -37.94 -35.0",
    ),
]


@pytest.fixture(scope="module")
def emm(data_file):
    pytest.importorskip("xarray")
    path = data_file("emm2017-crustal/emm2017_east_china_116_120E_31_35N_h0.nc")
    raw = geomag.read_grid(path, "total_field_anomaly_nt")
    return geomag.GridMap(raw.values, raw.x, raw.y, geographic=True, sigma=0.0)


@pytest.mark.parametrize("case", LOST_BY_COARSE_DENSITY, ids=["rms 1.3 km", "rms 14 km"])
def test_coarse_stage_keeps_the_cell_that_holds_the_truth(emm, case):
    (x, dx, off_x), (y, dy, off_y), readings = case
    k = np.arange(40)
    track = geomag.Track(x + dx * k, y + dy * k, np.array(readings.split(), dtype=float))
    half = 10_400 / np.array(emm.metres_per_unit(float(y)))
    fix = geomag.match_posterior(emm, track, half_width=tuple(half), sigma=0.5, tolerance_m=1110)
    error = np.hypot(*((np.array(fix.offset) - [off_x, off_y]) * emm.metres_per_unit(float(y))))
    assert error < 1110 or fix.risk > 0.02


@pytest.mark.parametrize("streaming", [False, True])
def test_risk_holds_on_the_emm_map(emm, streaming):
    result = calibrate_simulated(
        emm, sigma=0.5, half_width_m=11_100, tolerance_m=1110, trials=600, seed=4, streaming=streaming, bias_sigma=0.0
    )
    summary = result.summary()
    assert summary["fixed"] > 0.95
    assert summary["median_m"] < 0.25 * 1110
    ok = result.fixed
    wrong, declared = np.sum(result.error_m[ok] > 1110), result.risk[ok].sum()
    assert wrong <= declared + 3 * np.sqrt(declared + 1)


def test_prediction_and_bound_on_the_emm_map(emm):
    rng = np.random.default_rng(9)
    tracks = []
    while len(tracks) < 300:
        course = rng.uniform(0, 2 * np.pi)
        path = rng.uniform([117, 32], [119, 34]) + 0.02 * np.outer(np.arange(40) - 20, [np.sin(course), np.cos(course)])
        values = emm.sample(path[:, 0], path[:, 1]) + rng.normal(0, 0.5, 40)
        tracks.append(geomag.Track(path[:, 0], path[:, 1], values))
    options = {"half_width": 0.05, "sigma": 0.5, "tolerance_m": 2000.0, "bias_sigma": 0.0}
    predicted = geomag.predict_many(emm, tracks, flights=0, **options)
    fixes = geomag.match_posterior_many(emm, tracks, **options)
    pairs = [(p, np.array(f.offset_m)) for p, f in zip(predicted, fixes, strict=True) if f.ok]
    assert len(pairs) > 200
    against_bound = np.mean([e @ np.linalg.solve(p.bound_m2, e) for p, e in pairs])
    against_prediction = np.mean([e @ np.linalg.solve(p.covariance_m2, e) for p, e in pairs])
    # Chi-square with two degrees of freedom over the fixes, four standard errors; the bound may be missed by 1.15.
    chance = 4 * 2 / np.sqrt(len(pairs))
    assert abs(against_prediction - 2) < chance
    assert np.sqrt(against_bound / 2) < 1.15


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        ({}, {}),
        ({"bias": 50.0}, {}),
        ({"outlier_share": 0.05, "outlier": 50.0}, {}),
        ({"heading_deg": 1.0}, {}),
        ({"drift_m": 50.0}, {}),
        ({"drift_m": 50.0}, {"drift_sigma_m": 50.0 / np.sqrt(2)}),
    ],
    ids=["plain", "bias", "outliers", "heading", "drift told as a bound", "drift told as a root mean square"],
)
def test_declared_risk_holds_in_simulation(grid, extra, told):
    result = calibrate_simulated(
        grid, sigma=1.0, half_width_m=1000, tolerance_m=100, samples=25, trials=300, **extra, **told
    )
    summary = result.summary()
    assert summary["fixed"] > 0.5
    ok = result.fixed
    wrong, declared = np.sum(result.error_m[ok] > 100), result.risk[ok].sum()
    assert wrong <= declared + 4 * np.sqrt(declared + 1)
    # The map is right and the sensor as told, but for outliers, which are forgiven: nothing is to be refused.
    assert np.mean(result.status == "rejected") < 0.01


def test_prediction_bounds_what_happens(grid):
    tracks = [flight(grid, (0, 0), seed=s) for s in range(60)]
    predicted = geomag.predict_many(grid, tracks, half_width=500, sigma=0.5, tolerance_m=300, flights=0)
    assert "no flights simulated" in repr(predicted[0])
    result = assess(
        grid,
        tracks,
        np.array([[t.x[-1], t.y[-1]] for t in tracks]),
        name="routes",
        half_width_m=500,
        tolerance_m=300,
        sigma=0.5,
    )
    ok = result.fixed
    expected = np.array([np.trace(p.bound_m2) for p in predicted])[ok]
    ratio = np.sqrt(np.mean(result.error_m[ok] ** 2) / np.mean(expected))
    assert 0.7 < ratio < 1.3


def test_suitability_has_layers_of_the_right_shape(grid, tmp_path):
    found = suitability(
        grid,
        spacing_m=150,
        half_width_m=500,
        tolerance_m=200,
        sigma=0.5,
        samples=15,
        places=3,
        flights=1,
        headings_deg=(0, 90),
    )
    assert found.sigma_m.shape == found.fix_probability.shape == (2, 3, 3)
    assert np.nanmax(found.fix_probability) <= 1


def survey(seed=0):
    rng = np.random.default_rng(seed)
    x, y, v, line = [], [], [], []
    for k, north in enumerate(np.arange(0, 12_001, 300.0)):
        east = np.arange(0, 12_001, 25.0)
        x.append(east)
        y.append(np.full(east.size, north))
        v.append(3 * field(1.7 * east, 1.7 * north) + rng.normal(0, 0.5, east.size))
        line.append(np.full(east.size, k))
    return Lines(*(np.concatenate(a) for a in (x, y, v, line)))


@pytest.fixture
def few_windows(monkeypatch):
    """Errors are learnt from fewer windows than usual, which is quick."""
    monkeypatch.setattr("geomag.survey._trials.MOST_WINDOWS", 150)
    monkeypatch.setattr("geomag.survey._trials.FORECAST_WINDOWS", 40)


@pytest.mark.usefixtures("few_windows")
def test_lines_become_a_map_that_knows_its_errors():
    lines = survey()
    assert line_spacing_m(lines) == pytest.approx(300, rel=0.15)
    model = learn_errors(lines, seed=1)
    assert model.windows >= 20
    made = map_from_lines(lines, model=model)
    assert made.error_model["nu"] == 3
    sigma = np.asarray(made.sigma)
    distance = made.error_model["distance_m"]
    near, far = sigma[distance < 40], sigma[distance > 120]
    assert np.nanmedian(far) > np.nanmedian(near)
    between = np.abs(made.sample([6000.0], [6150.0]) - 3 * field(1.7 * 6000.0, 1.7 * 6150.0))
    assert between[0] < 60


def test_smoothed_lines_keep_the_trend_and_lose_the_noise():
    rng = np.random.default_rng(4)
    along = np.cumsum(rng.uniform(5, 15, 400))
    x, label = np.concatenate([along, along, [0.0]]), np.repeat([3, 1, 2], [400, 400, 1])
    trend = np.where(label == 3, 0.01 * x + 7, -5.0)
    noise = rng.normal(0, 1, x.size)
    order = rng.permutation(2)  # lines in any order, each line's own readings in theirs
    rows = np.concatenate([np.flatnonzero(label == k) for k in (np.array([3, 1])[order])] + [[800]])
    flat = smooth_lines(Lines(x[rows], label[rows] * 100.0, np.full(x.size, 3.0), label[rows]), 100.0)
    assert np.allclose(flat.values, 3.0, rtol=1e-12)
    lines = Lines(x[rows], label[rows] * 100.0, (trend + noise)[rows], label[rows])
    smooth = smooth_lines(lines, 100.0)
    assert np.array_equal(smooth.x, lines.x)
    assert np.array_equal(smooth.line, lines.line)
    left = smooth.values - trend[rows]
    inner = (lines.x > 200) & (lines.x < along[-1] - 200)
    # Ten readings averaged twice: a triangle of twenty, whose squared weights add up to 2 / 3 of a tenth.
    assert np.std(left[inner]) == pytest.approx(np.sqrt(2 / 30), rel=0.2)
    assert np.max(np.abs(left[inner])) < 1.2
    # Ends, and a line of one reading, are as they were.
    for end in (0, 399, 400, 799, 800):
        assert smooth.values[end] == pytest.approx(lines.values[end], abs=1e-9)
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(geomag.InvalidInputError, match="length_m: needed a number > 0"):
            smooth_lines(lines, wrong)


@pytest.mark.usefixtures("few_windows")
def test_errors_that_go_together_further_than_usual_are_learnt(monkeypatch):
    monkeypatch.setattr("geomag.survey._trials.FIRST_CORRELATION", 0.2)
    monkeypatch.setattr("geomag.survey._trials.SHARES", (0.5,))
    model = learn_errors(survey(), smoothing_m=0.0, folds=3, seed=1)
    tried = sorted(t["correlation"] for t in model.trials)
    # Longer and longer ones, until the longest is not the best.
    assert tried == pytest.approx([0.2 * 1.25**k for k in range(len(tried))])
    assert 0.4 < model.correlation < max(tried)


@pytest.mark.usefixtures("few_windows")
def test_the_line_spacing_alone_gives_a_map_its_errors():
    lines = survey()
    made = map_from_lines(lines, model=learn_errors(lines, seed=1))
    values = np.asarray(made.values).copy()
    values[20:25, 30:40] = np.nan
    bare = geomag.GridMap(values, made.x, made.y, name="survey", units="nT")
    rough = with_line_spacing(bare, 300.0)
    assert (rough.name, rough.units) == ("survey", "nT")
    assert np.array_equal(np.isnan(rough.values), np.isnan(values))
    assert rough.error_model["correlation"] == 2.25
    assert np.nanmax(rough.error_model["distance_m"]) == 75
    # Where the map is twice as steep or the lines twice as far apart, it is twice as wrong.
    wider = np.asarray(with_line_spacing(bare, 600.0).sigma) / np.asarray(rough.sigma)
    assert np.nanmedian(wider) == pytest.approx(2, abs=0.1)
    steeper = geomag.GridMap(2 * values, made.x, made.y)
    np.testing.assert_allclose(with_line_spacing(steeper, 300.0).sigma, 2 * np.asarray(rough.sigma), rtol=1e-9)
    sigma = np.asarray(rough.sigma)
    # Further than 120 m from the nearest of lines 300 m apart: the harmonic mean of 120 and 180.
    far = made.error_model["distance_m"] > 144
    assert 0.3 < np.nanmedian(sigma[far]) / np.nanmedian(np.asarray(made.sigma)[far]) < 3
    for spacing in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(geomag.InvalidInputError, match="line_spacing_m"):
            with_line_spacing(bare, spacing)
    alone = np.full((4, 4), np.nan)
    alone[1, 1] = 3.0
    with pytest.raises(geomag.InvalidInputError, match="neighbouring"):
        with_line_spacing(geomag.GridMap(alone, made.x[:4], made.y[:4]), 300.0)
    with pytest.raises(geomag.InvalidInputError, match="3 x 3"):
        with_line_spacing(geomag.GridMap(values[:2], made.x, made.y[:2]), 300.0)


def test_too_few_lines_are_refused():
    x = np.arange(0.0, 1000, 10)
    with pytest.raises(geomag.TooFewSamplesError):
        learn_errors(Lines(x, 0 * x, x, np.zeros(x.size)))
    with pytest.raises(geomag.ShapeError):
        Lines(x, x, x, np.zeros(3))


@pytest.mark.usefixtures("few_windows")
def test_left_out_lines_are_declared_rightly(tmp_path):
    result = calibrate_lines(survey(3), half_width_m=1000, tolerance_m=200, spacing_m=150, samples=30, most=150)
    text = result.to_markdown()
    assert "declared risk" in text
    ok = result.fixed
    wrong, declared = np.sum(result.error_m[ok] > 200), result.risk[ok].sum()
    assert wrong <= declared + 4 * np.sqrt(declared + 1)
    pytest.importorskip("matplotlib")
    result.plot(tmp_path / "reliability.svg")
    assert result.name in (tmp_path / "reliability.svg").read_text().replace("&#45;", "-")
    with pytest.raises(geomag.InvalidInputError, match="ending"):
        result.plot(tmp_path / "reliability.doc")


def test_wilson_interval():
    low, high = wilson(1, 100)
    assert (low, high) == (pytest.approx(0.0018, abs=3e-4), pytest.approx(0.0545, abs=3e-4))
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("bias_sigma", [0.0, None])
def test_how_far_off_an_outlier_is_tells_nothing(grid, bias_sigma):
    track = flight(grid, (430.0, -280.0), n=40, sigma=0.5, seed=5)
    risks, places = [], []
    for off in (0.0, 30.0, 60.0, 600.0):
        values = np.array(track.values)
        values[[6, 17, 31]] += off * np.array([1, -1, 1])
        fix = geomag.match_posterior(
            grid,
            geomag.Track(track.x, track.y, values),
            sigma=0.5,
            half_width=1000,
            tolerance_m=6,
            max_risk=0.5,
            bias_sigma=bias_sigma,
        )
        risks.append(fix.risk)
        places.append(fix.offset)
        assert fix.ok
    # Three samples less than there were, and no more than that.
    assert np.ptp(risks[1:]) <= 1e-3 * risks[1]
    assert np.ptp(places[1:], axis=0).max() < 1e-3
    assert risks[0] < risks[1] < 2 * risks[0]
    assert np.hypot(*np.subtract(places[1], places[0])) < 1


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
def test_osborne_lines_that_are_not_in_the_map(data_file):
    pytest.importorskip("pandas")
    lines = read_lines(data_file("osborne-aeromag/osborne_lines.csv.gz"))
    result = calibrate_lines(
        lines, name="Osborne", half_width_m=1000, tolerance_m=200, spacing_m=200, samples=40, most=1200
    ).summary()
    assert result["tracks"] >= 500
    assert result["fixed"] >= 0.6
    assert result["wrong"] <= 0.02
    assert result["gross"] <= 0.003
    assert result["median_m"] < 65


MADE_UP = {
    "rough": {"height_m": 75.0, "shortest_m": 150.0, "dipoles": 40, "dipole_depth_m": (100.0, 600.0)},
    "as aeromagnetic ones are": {"height_m": 150.0, "shortest_m": 300.0, "dipole_depth_m": (200.0, 800.0)},
    "smooth": {"height_m": 400.0, "shortest_m": 800.0, "dipoles": 6, "dipole_depth_m": (500.0, 1500.0)},
    "flat": {"height_m": 600.0, "shortest_m": 1200.0, "dipoles": 0, "texture_rms": 15.0},
}


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
@pytest.mark.parametrize(
    ("kind", "sigma", "level_sigma", "least"),
    [("rough", 1.0, 2.0, 0.9), ("as aeromagnetic ones are", 1.0, 2.0, 0.9), ("smooth", 1.0, 2.0, 0.9),
     ("flat", 1.0, 2.0, 0.3), ("flat", 1.0, 0.0, 0.6), ("rough", 10.0, 5.0, 0.8)],
)  # fmt: skip
def test_the_risk_holds_on_surveys_that_nobody_tuned_to(kind, sigma, level_sigma, least):
    field = synthetic.Crust(waves=512, longest_m=20_000.0, **MADE_UP[kind]).draw((0, 0, 36_000, 36_000), seed=3)
    lines = synthetic.survey(
        field, line_spacing_m=250.0, tie_spacing_m=5000.0, sigma=sigma, level_sigma=level_sigma, wander_m=12.0, seed=3
    )
    result = calibrate_lines(lines, name=kind, half_width_m=1000, tolerance_m=200, spacing_m=200, most=1200)
    assert result.fixed.mean() > least
    ok = result.fixed
    wrong, declared = np.sum(result.error_m[ok] > 200), result.risk[ok].sum()
    assert wrong <= declared + 4 * np.sqrt(declared + 1)
    # Where the spread of the errors is believed, the risk is too; 2 would be right, 4 to 7 is what noise that is honoured gives.
    assert np.mean(result.nees[ok]) < 3.0


RING = tuple((555 * np.sin(a), 555 * np.cos(a)) for a in np.arange(12) * np.pi / 6)
TURNS = tuple(np.radians(np.arange(-3.6, 3.61, 0.3)))
HARD = {
    "bias": (200, {"bias": 50}, {"bias": True}),
    "outliers": (200, {"outlier_share": 0.05, "outlier": 50}, {"outliers": (0.05, 50)}),
    "heading": (120, {"heading_deg": 1.0}, {"headings": TURNS, "heading_sigma": np.radians(1)}),
    "drift": (120, {"drift_m": 555.0}, {"drifts": RING}),
}


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
@pytest.mark.parametrize("case", HARD)
def test_whoever_is_right_about_the_risk_fixes_hardly_more(data_file, monkeypatch, case):
    """At 1 nT the exact posterior, which knows all laws, is the limit; ours is told less and stays near it."""
    pytest.importorskip("xarray")
    file = data_file("emm2017-crustal/emm2017_east_china_116_120E_31_35N_h0.nc")
    emm = geomag.read_grid(file, "total_intensity_nt")
    east, north = emm.metres_per_unit(33.0)
    x, y = np.arange(emm.x.size) * emm.spacing[0] * east, np.arange(emm.y.size) * emm.spacing[1] * north
    values = np.asarray(emm.values, dtype=float)
    trials, simulated, exact = HARD[case]
    tracks = []
    monkeypatch.setattr(
        "geomag.calibration.assess", lambda grid, some, *a, **k: tracks.extend(some) or assess(grid, some, *a, **k)
    )
    told = {} if "bias" in simulated else {"bias_sigma": 0.0}
    ours = calibrate_simulated(
        geomag.GridMap(values, x, y, sigma=0.0),
        sigma=1.0,
        half_width_m=11_100,
        tolerance_m=1110,
        trials=trials,
        seed=7,
        **simulated,
        **told,
    )
    exact = {"bias": False, **exact}
    risks = np.array([posterior(values, x, y, t, 1.0, 11_100, 111, 1110, **exact)[0] for t in tracks])
    limit = np.mean(risks <= 0.01)
    assert abs(ours.fixed.mean() - limit) < 0.08
    if case != "outliers":
        assert limit < 0.95
