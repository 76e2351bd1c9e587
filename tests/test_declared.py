"""What is declared holds: interpolation, stated errors, effects that were not told."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import geomag
from geomag.stress import StressRow, _spline, flights_with_effect, right_maps, table

X = np.arange(0.0, 101_000.0, 1000.0)


def field(x: Any, y: Any) -> Any:
    x, y = np.asarray(x) / 1000, np.asarray(y) / 1000
    return (
        70 * np.sin(1.1 * x + 0.3) * np.cos(0.8 * y) + 50 * np.sin(0.9 * y + 0.5 * x) + 30 * np.cos(1.4 * x - 1.2 * y)
    )


GRID = geomag.GridMap(field(*np.meshgrid(X, X)), X, X, sigma=0.0)
SETTING: dict[str, Any] = {"half_width": 5000, "tolerance_m": 200}


def flight(reading: Any, n: int = 40, sigma: float = 1.0, turn: float = 0.0, seed: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    course = rng.uniform(0, 2 * np.pi) + np.radians(turn) * (np.arange(n) >= n // 2)
    x = 50_000 + np.cumsum(400 * np.sin(course)) - 200 * n * np.sin(course[0])
    y = 50_000 + np.cumsum(400 * np.cos(course)) - 200 * n * np.cos(course[0])
    offset = rng.uniform(-4000, 4000, 2)
    values = reading(x, y) + rng.normal(0, sigma, n) + rng.uniform(-30, 30)
    return geomag.Track(x - offset[0], y - offset[1], values), offset


def test_readings_by_the_spline_are_declared_rightly() -> None:
    pytest.importorskip("scipy")
    from scipy.interpolate import RectBivariateSpline

    spline = RectBivariateSpline(X, X, GRID.values)
    tracks, offsets = zip(*(flight(lambda x, y: spline.ev(y, x), 20, seed=k) for k in range(80)), strict=True)
    fixes = geomag.match_posterior_many(GRID, list(tracks), sigma=1.0, **SETTING)
    wrong = sum(f.ok and np.hypot(*np.subtract(f.offset_m, o)) > 200 for f, o in zip(fixes, offsets, strict=True))
    declared = sum(f.risk for f in fixes if f.ok)
    assert sum(f.ok for f in fixes) > 40
    assert wrong <= declared + 2 * np.sqrt(declared) + 0.5


def test_interpolation_is_an_option_of_all_of_them() -> None:
    track, offset = flight(lambda x, y: GRID.sample(x, y, interpolation="bicubic"), sigma=0.3)
    for fix in (
        geomag.match_posterior(GRID, track, sigma=0.3, interpolation="bicubic", **SETTING),
        geomag.match_posterior_many(GRID, [track], sigma=0.3, interpolation="bicubic", **SETTING)[0],
        geomag.PosteriorMatcher(GRID, sigma=0.3, interpolation="bicubic", **SETTING).run(track),
    ):
        assert fix.ok
        assert np.hypot(*np.subtract(fix.offset_m, offset)) < 200
    assert geomag.predict_many(GRID, [track], sigma=0.3, interpolation="bicubic", flights=2, **SETTING)[0] is not None
    with pytest.raises(geomag.InvalidInputError, match="bilinear"):
        geomag.match_posterior(GRID, track, interpolation="nearest", **SETTING)


def test_the_spline_of_the_stress_tables_is_the_spline() -> None:
    pytest.importorskip("scipy")
    from scipy.interpolate import RectBivariateSpline

    spline = RectBivariateSpline(X, X, GRID.values)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(20_000, 80_000, (2, 500))
    np.testing.assert_allclose(_spline(GRID)(x, y), spline.ev(y, x), atol=1e-6)


def test_a_stated_error_has_a_correlation_that_can_be_said() -> None:
    grid = geomag.GridMap(GRID.values, X, X, sigma=4.0, correlation_m=0.0)
    assert grid.correlation_m == 0.0
    assert geomag.GridMap(GRID.values, X, X, sigma=4.0).correlation_m is None
    assert pickle.loads(pickle.dumps(grid)).correlation_m == 0.0
    tracks = [flight(grid.sample, 100, 4.0, seed=k)[0] for k in range(20)]
    assert sum(f.ok for f in geomag.match_posterior_many(grid, tracks, sigma=0.5, **SETTING)) > 10
    with pytest.raises(geomag.InvalidInputError, match="correlation_m"):
        geomag.GridMap(GRID.values, X, X, sigma=4.0, correlation_m=-1.0)


def test_a_step_of_the_bias_at_a_turn_is_named() -> None:
    refused = []
    for k in range(12):
        track, _ = flight(GRID.sample, turn=90, seed=k)
        stepped = geomag.Track(track.x, track.y, track.values + 40.0 * (np.arange(40) > 20))
        fix = geomag.match_posterior(GRID, stepped, sigma=1.0, **SETTING)
        if fix.misfit:
            refused.append(fix)
        told = geomag.match_posterior(GRID, stepped, sigma=1.0, leg_bias_sigma=40.0, **SETTING)
        assert told.misfit is None
    assert all(f.status == "rejected" and f.misfit[0] == "legs" and f.misfit[2] > 6 for f in refused)
    assert all(f.to_dict()["misfit"] == f.misfit and pickle.loads(pickle.dumps(f)).misfit == f.misfit for f in refused)
    assert all("asks for legs" in repr(f) for f in refused)


def test_a_threshold_is_kept_with_the_map() -> None:
    model = {"nu": 3.0, "scale_spread": 0.3, "correlation": 1.0, "registration": 0.0, "distance_m": 100.0}
    grid = GRID.with_error_model(**model, misfit_threshold=9.0)
    assert grid.error_model["misfit_threshold"] == 9.0
    again = GRID.with_error_model(**grid.error_model)
    assert again.error_model == grid.error_model
    assert pickle.loads(pickle.dumps(again)).error_model == grid.error_model
    assert "misfit_threshold" not in GRID.with_error_model(**model).error_model
    with pytest.raises(geomag.InvalidInputError, match="misfit_threshold"):
        GRID.with_error_model(**model, misfit_threshold=-1.0)


def test_short_stress_table_holds() -> None:
    rows = right_maps(cells_m=[1000], shortest_cells=[4], sigmas=[0.3], samples=[40], flights=60)
    assert [r.name.split(", ")[2] for r in rows] == ["bilinear", "bicubic", "spline", "field"]
    for row in rows:
        assert row.fixed > 30, row
        assert row.consistent, row
        assert row.refused <= 2, row
        assert row.mean_square < 2 + 4 * 2 / np.sqrt(row.fixed), row
        assert row.beyond < 0.06, row


def test_steps_that_nobody_told_leave_no_wrong_fix() -> None:
    grid = geomag.GridMap(GRID.values, X, X, sigma=4.0)
    options: dict[str, Any] = {"half_width_m": 5000, "tolerance_m": 300, "spacing_m": 400, "flights": 60}
    none, *steps = flights_with_effect(grid, heights_m=[0.0], steps=[10.0, 40.0, 150.0], **options)
    assert none.fixed > 40
    assert none.refused <= 2
    for row in steps:
        assert row.within(0.01), row
    # Told, they are fixed again.
    (told,) = flights_with_effect(grid, heights_m=[], steps=[40.0], tell=True, **options)
    assert told.fixed > 0.5 * none.fixed, told
    assert told.within(0.01), told


def test_rows_are_held_against_a_share_of_wrong_fixes() -> None:
    row = StressRow("as named", 100, 100, 3, 0, 0.1, 2.0, 0.01)
    # Binomial: three or more of a hundred at one in a hundred, 8 %; four or more, 2 %.
    assert row.within(0.01)
    assert not StressRow("as named", 100, 100, 4, 0, 0.1, 2.0, 0.01).within(0.01)
    assert StressRow("as named", 100, 0, 0, 0, 0.0, 2.0, 0.0).within(0.01)
    assert "(!)" in table([row])
    assert "(!)" not in table([row], 0.01)
