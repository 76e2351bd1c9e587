"""The declared risk: a line in log-odds learnt with the map, applied wherever a risk is declared, and the two rules of declaration."""

from __future__ import annotations

import pickle
import threading
import time

import numpy as np
import pytest

import geomag
from geomag.calibration import Calibration
from geomag.survey import ErrorModel, limit_of_mean
from geomag.survey import _trials as trials
from geomag.survey._fit import (
    SLOPE_PRIOR,
    fit_covariance_factor,
    fit_forecast,
    fit_lapses,
    fit_recalibration,
    recalibrated,
)
from geomag.survey._folds import Fold
from geomag.survey._model import Law
from geomag.survey._steps import Steps
from geomag.survey._surface import Axes


@pytest.fixture(scope="module")
def scene():
    """A map with an error model, and tracks of which some are fixed and some are not."""
    axis = np.arange(0.0, 8000.0, 100.0)
    x, y = np.meshgrid(axis, axis)
    values = 60 * np.sin(x / 500) * np.cos(y / 600) + 30 * np.sin(x / 911 + y / 733)
    grid = geomag.GridMap(values, axis, axis, sigma=3.0)
    rng = np.random.default_rng(3)
    tracks = []
    for k in range(12):
        px, py = 1500 + 120 * np.arange(8 + 3 * k), 1500 + 90.0 * k + 60 * np.arange(8 + 3 * k)
        tracks.append(geomag.Track(px - 150, py + 90, grid.sample(px, py) + rng.normal(0, 2, px.size)))
    base = {"nu": 3.0, "scale_spread": 0.35, "correlation": 1.0, "registration": 0.05, "distance_m": 100.0}
    return grid, tracks, base


def test_the_declared_risk_is_the_line_of_the_computed_one(scene):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0}
    plain = grid.with_error_model(**base)
    line = (0.7, 0.4)
    read = grid.with_error_model(**base, recalibration=line, forecast=(1.5, 1.2))
    assert read.error_model["recalibration"] == line
    assert read.error_model["forecast"] == (1.5, 1.2, 0.0)
    again = grid.with_error_model(**read.error_model)
    assert again.error_model == read.error_model
    for streaming in (False, True):
        before = geomag.match_posterior_many(plain, tracks, streaming=streaming, max_risk=1e-12, **options)
        after = geomag.match_posterior_many(again, tracks, streaming=streaming, max_risk=1e-12, **options)
        computed = np.array([f.risk for f in before])
        assert np.ptp(computed) > 0.01
        np.testing.assert_allclose(
            [f.risk for f in after], recalibrated(computed, line), rtol=1e-9, atol=1e-10
        )  # rounding of 1 - mass
    # What is declared follows: the limit is one of the declared risk.
    fixed = geomag.match_posterior_many(read, tracks, max_risk=0.1, **options)
    assert all(f.risk <= 0.1 for f in fixed if f.ok)
    assert any(f.ok for f in fixed)
    # With two maps the more careful line holds.
    both = [
        geomag.match_posterior(m, tracks[5], channels=[(plain, tracks[5].values, 1.0)], **options).risk
        for m in (plain, read)
    ]
    assert both[1] == pytest.approx(recalibrated(np.array([both[0]]), line)[0], rel=1e-9)


@pytest.mark.parametrize("line", [(0.0, 0.0), (-1.0, 0.0), (np.nan, 0.0), (1.0, np.inf)])
def test_a_line_that_is_none_is_refused(scene, line):
    grid, _, base = scene
    with pytest.raises(geomag.InvalidInputError, match="recalibration"):
        grid.with_error_model(**base, recalibration=line)


def test_the_forecast_widens_what_is_foretold(scene):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0}

    def foretold(flights):
        return [
            geomag.predict_many(grid.with_error_model(**base, forecast=f), tracks, flights=flights, **options)
            for f in ((1.0, 1.0), (3.0, 2.0))
        ]

    for a, b in zip(*foretold(0), strict=True):
        np.testing.assert_allclose(b.covariance_m2, 4 * np.asarray(a.covariance_m2), rtol=1e-9)
        np.testing.assert_allclose(b.bound_m2, a.bound_m2)
    plain, wide = foretold(8)
    assert np.mean([b.fix_probability for b in wide]) < np.mean([a.fix_probability for a in plain])


def test_the_covariance_foretold_is_that_of_the_simulated_fixes(scene):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0, "max_risk": 0.01}
    model = grid.with_error_model(**base)
    local, flown = (geomag.predict_many(model, tracks, flights=flights, **options) for flights in (0, 12))
    # With another reading of the covariances only those of the fixes change.
    read = geomag.predict_many(grid.with_error_model(**base, covariance_factor=0.5), tracks, flights=12, **options)
    fixed = [p.fix_probability > 0 for p in flown]
    assert any(fixed)
    assert not all(fixed)
    for ok, a, b, c in zip(fixed, local, flown, read, strict=True):
        np.testing.assert_allclose(c.covariance_m2, (0.5 if ok else 1.0) * np.asarray(b.covariance_m2), rtol=1e-9)
        assert ok != np.allclose(a.covariance_m2, b.covariance_m2)
        # A fix that is declared at 1 % within the tolerance is not spread wider than that.
        assert not ok or np.trace(b.covariance_m2) < options["tolerance_m"] ** 2


def test_what_is_foretold_has_a_part_that_no_information_takes_away(scene):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0, "flights": 0}
    plain, read = (
        geomag.predict_many(grid.with_error_model(**base, forecast=f), tracks, **options)
        for f in ((1.0, 1.0), (1.0, 1.4, 0.3))
    )
    for a, b in zip(plain, read, strict=True):
        expected = 1.4**2 * np.asarray(a.covariance_m2) + (0.3 * base["distance_m"]) ** 2 * np.eye(2)
        np.testing.assert_allclose(b.covariance_m2, expected, rtol=1e-9)
    for wrong in ((1.0, 1.0, -0.1), (1.0, 0.0, 0.1), (1.0, 1.0, np.nan), (1.0, 1.0, 0.1, 0.1)):
        with pytest.raises((geomag.InvalidInputError, TypeError), match="forecast"):
            grid.with_error_model(**base, forecast=wrong)


def test_spread_and_registration_of_what_is_foretold_are_found():
    rng = np.random.default_rng(8)
    local, distance = np.exp(rng.normal(3.0, 0.6, 8000)), rng.uniform(50, 150, 8000)
    for spread, registration in ((1.5, 0.3), (2.0, 0.01), (0.5, 0.4)):
        variance = spread**2 * local**2 + 2 * (registration * distance) ** 2
        found = fit_forecast(local**2, distance, np.sqrt(variance * rng.exponential(1.0, local.size)), 1.0)
        again = found[0] ** 2 * local**2 + 2 * (found[1] * distance) ** 2
        np.testing.assert_allclose(again, variance, rtol=0.2)
    # Data on the spot, or no error at all: still two numbers.
    for away, error in ((0.0, 20.0), (100.0, 0.0), (0.0, 0.0)):
        found = fit_forecast(np.full(30, 400.0), np.full(30, away), np.full(30, error), 1.0)
        assert np.all(np.isfinite(found))
        assert found[0] > 0
    # Information that explains nothing is still believed to be worth something where the field is flat.
    spread, _ = fit_forecast(local[:200] ** 2, distance[:200], 40.0 * np.sqrt(rng.exponential(1.0, 200)), 0.5)
    assert 0.1 < spread < 1


def test_the_declared_covariance_is_the_factor_times_the_computed_one(scene, tmp_path):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0}
    plain, read = grid.with_error_model(**base), grid.with_error_model(**base, covariance_factor=0.6)
    read.save(tmp_path / "map.nc")
    for again in (geomag.read_grid(tmp_path / "map.nc"), pickle.loads(pickle.dumps(read))):
        assert again.error_model["covariance_factor"] == 0.6
    for streaming in (False, True):
        before, after = (geomag.match_posterior_many(m, tracks, streaming=streaming, **options) for m in (plain, read))
        assert any(f.ok for f in before)
        for a, b in zip(before, after, strict=True):
            np.testing.assert_allclose(b.covariance_m2, 0.6 * np.asarray(a.covariance_m2), rtol=1e-12)
            assert (a.risk, a.status, a.offset) == (b.risk, b.status, b.offset)
    # Of two maps the more careful factor holds, and a map that has none says nothing.
    wide = grid.with_error_model(**base, covariance_factor=1.5)
    track = tracks[5]
    alone, first, second = (
        np.asarray(geomag.match_posterior(m, track, channels=[(n, track.values, 1.0)], **options).covariance_m2)
        for m, n in ((plain, plain), (read, wide), (read, plain))
    )
    np.testing.assert_allclose(first, 1.5 * alone, rtol=1e-9)
    np.testing.assert_allclose(second, 0.6 * alone, rtol=1e-9)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(geomag.InvalidInputError, match="covariance_factor"):
            grid.with_error_model(**base, covariance_factor=wrong)


def test_the_factor_on_covariances_is_found_where_fixes_are_many_and_shrunk_where_they_are_few():
    rng = np.random.default_rng(9)
    squares = 0.6 * rng.chisquare(2, 4000)
    squares[:40] = 1e6  # answers that are wrong altogether move no median
    assert fit_covariance_factor(squares, 1.0) == pytest.approx(0.6, abs=0.04)
    few = np.full(20, 0.6 * 2 * np.log(2))
    assert 0.6 < fit_covariance_factor(few, 1.0) < fit_covariance_factor(few, 0.2) < 1
    assert fit_covariance_factor(np.zeros(20), 1.0) > 0


def test_the_line_is_found_where_answers_are_many_and_shrunk_where_they_are_few():
    rng = np.random.default_rng(5)
    risk = 1 / (1 + np.exp(rng.normal(2.5, 2.0, 40_000)))
    true = (0.6, 0.3)
    wrong = rng.random(risk.size) < recalibrated(risk, true)
    many = fit_recalibration(risk, wrong, 1.0, 0.002)
    assert many == pytest.approx(true, abs=0.06)
    few = fit_recalibration(risk[:10], wrong[:10], 1.0, 0.002)
    assert true[0] < few[0] < SLOPE_PRIOR[0]
    assert SLOPE_PRIOR[0] - few[0] < few[0] - true[0]
    # Windows that overlap weigh as those that would not.
    thinned = fit_recalibration(np.repeat(risk[:300], 4), np.repeat(wrong[:300], 4), 0.25, 0.002)
    assert thinned == pytest.approx(fit_recalibration(risk[:300], wrong[:300], 1.0, 0.002), abs=1e-6)


@pytest.fixture
def survey_parts():
    """Two folds of straight lines over one map, each with 49 windows of 20 samples 100 m apart, and how they are flown."""
    axis = np.arange(0.0, 16_000.0, 200.0)
    base = geomag.GridMap(np.sin(axis / 900) + np.cos(axis[:, None] / 700), axis, axis)
    along = np.arange(100.0, 15_800.0, 50.0)
    rows = 500.0 + 1000.0 * np.arange(14)
    lines = [geomag.survey.Lines(along, 0 * along + y, 0 * along, np.full(along.size, k)) for k, y in enumerate(rows)]
    axes = Axes.of(base)
    distance = np.full((axis.size, axis.size), 300.0)
    parts = [Fold([], lines[k::2], axes, base, distance, []) for k in (0, 1)]
    return parts, trials.Settings(100.0, 1000.0, 200.0, 20)


@pytest.mark.parametrize(("most", "spare"), [(1000, 82), (60, 45)])
def test_windows_that_models_are_not_tried_on_are_kept_for_the_line(survey_parts, monkeypatch, most, spare):
    monkeypatch.setattr(trials, "MOST_WINDOWS", 16)
    monkeypatch.setattr(trials, "MOST_LINE_WINDOWS", most)
    parts, settings = survey_parts
    assert trials.flown(parts, settings, np.random.default_rng(1)) == 1.0
    tried, kept = (
        [{(x[0], y[0]) for x, y, _ in getattr(part, name)} for part in parts] for name in ("windows", "spare")
    )
    assert sum(map(len, tried)) == 16
    assert 0.6 * spare <= sum(map(len, kept)) <= spare
    assert not any(a & b for a, b in zip(tried, kept, strict=True))
    # All are taken before one is flown twice.
    monkeypatch.setattr(trials, "MOST_WINDOWS", 400)
    trials.flown(parts, settings, np.random.default_rng(1))
    assert not any(part.spare for part in parts)


def test_the_line_is_learnt_at_the_correlation_that_is_flown_from_all_windows(survey_parts, monkeypatch):
    monkeypatch.setattr(trials, "MOST_WINDOWS", 16)
    parts, settings = survey_parts
    rng = np.random.default_rng(2)
    independent = trials.flown(parts, settings, rng)
    one = trials.Trials(parts, Law(0.1, 300.0, 200.0), (0.1, 0.1, 0.1), settings, independent, rng, Steps(None, 9.0))
    asked = []

    def answered(self, point, correlation, tracks, offsets, folds=None):
        """Answers whose risks want an intercept of minus the correlation, a thousand a fold."""
        asked.append((correlation, sum(map(len, tracks)), [o.shape for o in offsets]))
        computed = rng.normal(0, 2, (len(tracks), 1000))
        wrong = rng.random(computed.shape) < 1 / (1 + np.exp(correlation - computed))
        stated = np.ones(1000, dtype=bool)
        return [
            trials.Outcome(1 / (1 + np.exp(-c)), 0.0 * c, w, stated, 0.0 * c)
            for c, w in zip(computed, wrong, strict=True)
        ]

    monkeypatch.setattr(trials.Trials, "_answered", answered)
    point = trials.Point()
    ladder = one.at(point)
    assert ladder.line[1] == pytest.approx(-point.correlation, abs=0.2)
    chosen = one.chosen(point, 0.5)
    assert chosen.line == pytest.approx((1.0, -0.5), abs=0.15)
    windows = [(len(part.windows), len(part.spare)) for part in parts]
    total, shapes = sum(a for a, _ in windows), [(a, 2) for a, _ in windows]
    aside, others = sum(b for _, b in windows), [(b, 2) for _, b in windows]
    assert aside > 4 * total
    assert asked == [(point.correlation, total, shapes), (0.5, total, shapes), (0.5, aside, others)]
    assert chosen.risk.size == 4000


def test_a_model_that_half_of_the_folds_deny_is_tried_no_further(survey_parts, monkeypatch):
    monkeypatch.setattr(trials, "WINDOWS_TO_HALVE", 20)
    parts, settings = survey_parts
    rng = np.random.default_rng(3)
    trials.flown(parts, settings, rng)
    one = trials.Trials(parts, Law(0.1, 300.0, 200.0), (0.1, 0.1, 0.1), settings, 1.0, rng, Steps(None, 9.0))
    asked = []

    def answered(self, point, correlation, tracks, offsets, folds=None):
        """Answers that are the better the nearer the correlation is to 2."""
        asked.extend((point, k) for k in folds)
        away = abs(np.log(correlation / 2.0))
        wrong = np.arange(200) < 10
        risk = np.where(wrong, 1 / (1 + away), 0.02 + 0.3 * away)
        return [trials.Outcome(risk, 300.0 * wrong, wrong, np.ones(200, dtype=bool), np.ones(200)) for _ in folds]

    monkeypatch.setattr(trials.Trials, "_answered", answered)
    best, correlation = one.search()
    assert best.correlation == pytest.approx(2.0, rel=0.13)
    assert correlation == pytest.approx(2.0, rel=0.13)
    assert len(asked) == len(set(asked))
    tried = {point: {k for other, k in asked if other == point} for point, _ in asked}
    assert {frozenset(folds) for folds in tried.values()} == {frozenset({0}), frozenset({0, 1})}
    assert tried[best] == {0, 1}
    # What one half denied has no total of all folds.
    assert all(point in one.half and point not in one.seen for point, folds in tried.items() if folds == {0})


@pytest.mark.parametrize("left_out", [slice(0, 1), slice(0, 0)])
def test_half_of_the_folds_denies_nothing_where_it_has_no_windows(survey_parts, monkeypatch, left_out):
    monkeypatch.setattr(trials, "WINDOWS_TO_HALVE", 20)
    parts, settings = survey_parts
    rng = np.random.default_rng(3)
    trials.flown(parts, settings, rng)
    for part in parts[left_out]:
        part.windows = []
    # Flights make one fold, a survey whose first lines the maps do not cover has folds without windows.
    parts = parts if parts[left_out] else parts[1:]
    one = trials.Trials(parts, Law(0.1, 300.0, 200.0), (0.1, 0.1, 0.1), settings, 1.0, rng, Steps(None, 9.0))
    assert one.at(one.search()[0]).risk.size > 0
    assert not one.half


def test_both_rules_of_declaration():
    risk = np.array([0.001, 0.004, 0.015, 0.02, 0.3, 0.0005])
    status = np.array(["fixed", "fixed", "searching", "searching", "ambiguous", "lost"])
    error = np.array([10.0, 300.0, 10.0, 10.0, 400.0, 10.0])
    answers = Calibration("made up", 200.0, 0.01, risk, error, status == "fixed", status, np.ones(6), np.full(6, 40))
    rows = {(r["mean_rule"], r["limit"]): r for r in answers.shares((0.01, 0.05))}
    assert rows[0.0, 0.01]["fixed"] == pytest.approx(2 / 6)
    assert rows[0.0, 0.01]["wrong"] == 1
    # 0.001, 0.004, 0.015 and 0.02 have the mean 0.01.
    assert rows[1.0, 0.01]["fixed"] == pytest.approx(4 / 6)
    assert rows[1.0, 0.01]["max_risk"] == 0.02
    assert rows[0.0, 0.05]["fixed"] == pytest.approx(4 / 6)
    assert answers.log_loss() == pytest.approx(
        -np.mean(np.log([1 - 0.001, 0.004, 1 - 0.015, 1 - 0.02, 0.3])), rel=1e-12
    )
    assert "mean risk within it" in answers.to_markdown()
    assert limit_of_mean([0.5], 0.01) == 0.0
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.05, 300.0, 60, 0.1, risks=[0.001, 0.019, 0.5])
    assert model.limit_of_mean(0.01) == 0.019


@pytest.mark.parametrize("independent", [1.0, 0.5])
def test_bins_are_judged_together(independent):
    def answers(factor, seed):
        drawn = np.random.default_rng(seed)
        risk = np.exp(drawn.uniform(np.log(0.003), np.log(0.5), 600))
        wrong = drawn.random(600) < factor * risk
        n = risk.size
        return Calibration(
            "made", 1.0, 0.01, risk, np.where(wrong, 2.0, 0.5), risk <= 0.01, np.array(["fix"] * n), np.ones(n),
            np.full(n, 40), independent=independent,
        )  # fmt: skip

    right = [answers(1.0, seed).together(draws=400) for seed in range(60)]
    p = np.array([one["p"] for one in right])
    if independent == 1.0:
        # Uniform where the risks are right, and as many surveys with all bins inside as is said.
        assert 0.35 < p.mean() < 0.65
        assert np.mean(p < 0.1) < 0.25
        inside = [
            all(row["lower"] <= row["declared"] <= row["upper"] for row in answers(1.0, seed).reliability()[2:])
            for seed in range(60)
        ]
        assert abs(np.mean(inside) - right[0]["all_inside"]) < 0.2
    assert 0.6 < right[0]["all_inside"] < 0.95
    bold = [answers(2.0, seed).together(draws=400)["p"] for seed in range(5)]
    assert max(bold) < 0.01
    assert right[0]["bins"] == 5
    assert "together: chi-square" in answers(1.0, 3).to_markdown()


def test_progress_is_told_from_the_first_moment_on():
    told = []
    steps = Steps(lambda done, total: told.append((done, total)), 4.0)
    assert told == [(0, 400)]
    steps.within(1.0)(1, 2)
    steps.add(1.0)
    steps.add(9.0)
    assert told[1:] == [(50, 400), (100, 400), (400, 400)]


def test_side_by_side_keeps_the_order_and_reports_from_one_thread(monkeypatch):
    monkeypatch.setenv("RAYON_NUM_THREADS", "3")
    told, reporters, workers = [], set(), set()
    together = threading.Barrier(3, timeout=30)

    def progress(done, total):
        reporters.add(threading.get_ident())
        told.append(done)

    steps = Steps(progress, 6.0)

    def work(item):
        workers.add(threading.get_ident())
        together.wait()  # passed only where three work at the same time
        half = steps.within(1.0)
        half(1, 2)
        time.sleep(0.15)
        steps.add(1.0)
        return item**2

    assert steps.side_by_side(work, range(6)) == [0, 1, 4, 9, 16, 25]
    steps.add(0.0)
    assert reporters == {threading.get_ident()}
    assert len(workers) == 3
    assert threading.get_ident() not in workers
    assert told == sorted(told)
    assert told[-1] == 600
    monkeypatch.setenv("RAYON_NUM_THREADS", "1")
    assert steps.side_by_side(lambda item: threading.get_ident(), range(2)) == [threading.get_ident()] * 2


@pytest.mark.parametrize("fails", ["in a thread", "in progress"])
def test_what_fails_side_by_side_stops_the_others(monkeypatch, fails):
    monkeypatch.setenv("RAYON_NUM_THREADS", "2")
    begun, turns = [], []

    def progress(done, total):
        if fails == "in progress" and begun:
            raise KeyboardInterrupt

    steps = Steps(progress, 50.0)

    def work(item):
        begun.append(item)
        if item == 0 and fails == "in a thread":
            raise ValueError("no window")
        for turn in range(3000):  # a minute, were it not stopped
            turns.append(turn)
            steps.waited_for(turn, 3000)
            time.sleep(0.02)

    with pytest.raises(ValueError if fails == "in a thread" else KeyboardInterrupt):
        steps.side_by_side(work, range(50))
    assert len(begun) < 10
    assert len(turns) < 1000


def test_short_tracks_are_riskier_by_their_lapses(scene, tmp_path):
    grid, tracks, base = scene
    options = {"half_width": 1000.0, "sigma": 1.0, "tolerance_m": 150.0, "max_risk": 1e-12}
    line, (share, length_m) = (0.8, 0.1), (0.02, 3500.0)
    plain = grid.with_error_model(**base, recalibration=line)
    lapsing = grid.with_error_model(**base, recalibration=line, lapses=(share, length_m))
    assert lapsing.error_model["lapses"] == (share, length_m)
    lapsing.save(tmp_path / "map.nc")
    assert geomag.read_grid(tmp_path / "map.nc").error_model["lapses"] == (share, length_m)
    assert pickle.loads(pickle.dumps(lapsing)).error_model["lapses"] == (share, length_m)
    for streaming in (False, True):
        before = geomag.match_posterior_many(plain, tracks, streaming=streaming, **options)
        after = geomag.match_posterior_many(lapsing, tracks, streaming=streaming, **options)
        lengths = [np.hypot(np.diff(t.x), np.diff(t.y)).sum() for t in tracks]
        assert min(lengths) < length_m < max(lengths)
        lapses = [max(0.0, share * ((length_m / length) ** 2 - 1)) for length in lengths]
        expected = [1 - (1 - f.risk) * (1 - more) for f, more in zip(before, lapses, strict=True)]
        np.testing.assert_allclose([f.risk for f in after], expected, rtol=1e-9, atol=1e-12)
    for wrong in ((-0.1, 100.0), (1.5, 100.0), (0.1, 0.0), (np.nan, 100.0)):
        with pytest.raises(geomag.InvalidInputError, match="lapses"):
            grid.with_error_model(**base, lapses=wrong)


def test_the_share_of_lapses_is_found():
    rng = np.random.default_rng(5)
    n = 20_000
    risk, ratio = 10 ** rng.uniform(-4, -1, n), rng.choice([1.2, 1.5, 2.0], n)
    for share in (0.0, 0.03):
        wrong = rng.random(n) < 1 - (1 - risk) * (1 - share * (ratio**2 - 1))
        found = fit_lapses(risk, ratio, wrong, np.ones(n))
        assert found == pytest.approx(share, abs=0.004)
    # Nothing seen: what is believed beforehand.
    assert fit_lapses(risk[:0], ratio[:0], wrong[:0], risk[:0]) == pytest.approx(0.01, rel=0.05)
