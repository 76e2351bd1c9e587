"""The error model of a grid from flights with known positions."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.calibration import assess
from geomag.survey import ErrorModel, Lines, learn_from_flights, with_errors
from geomag.survey._survey import windows_of

SETTINGS = {"spacing_m": 150.0, "half_width_m": 800.0, "tolerance_m": 200.0, "samples": 30}


@pytest.fixture(scope="module")
def scene():
    """A field, a grid that is too coarse for it, and flights over it."""
    crust = synthetic.Crust(waves=256, longest_m=8000.0, height_m=150.0, shortest_m=300.0, dipoles=0, texture_rms=60)
    field = crust.draw((0, 0, 18_000, 18_000), seed=5)
    axis = np.arange(0.0, 18_001.0, 300.0)
    x, y = np.meshgrid(axis, axis)
    grid = geomag.GridMap(field.sample(x.ravel(), y.ravel()).reshape(x.shape), axis, axis, name="made up", units="nT")
    along = np.arange(300.0, 17_700.0, 30.0)
    flights = [
        geomag.Track(along, 0 * along + n, field.sample(along, 0 * along + n) + 40.0)
        for n in (3110.0, 8770.0, 14_560.0)
    ]
    return field, grid, flights


def test_one_calibration_flight_makes_a_grid_useful(scene, monkeypatch):
    monkeypatch.setattr("geomag.survey._trials.MOST_WINDOWS", 150)
    monkeypatch.setattr("geomag.survey._trials.FORECAST_WINDOWS", 20)
    field, grid, flights = scene
    model = learn_from_flights(grid, flights, line_spacing_m=600.0, **SETTINGS)
    assert model.distance_m == pytest.approx(150)
    assert model.recalibration[0] <= 0.8
    made = with_errors(grid, None, model)
    assert (made.name, made.units) == ("made up", "nT")
    # The sigma is that of the interpolation between the nodes, within a factor of two.
    rng = np.random.default_rng(1)
    x, y = rng.uniform(1000, 17_000, (2, 4000))
    error = np.abs(field.sample(x, y) - grid.sample(x, y))
    sigma = geomag.GridMap(made.sigma, grid.x, grid.y).sample(x, y)
    assert 0.5 < np.median(error) / np.median(0.765 * sigma) * model.share < 2.0
    along = np.arange(500.0, 17_500.0, 30.0)
    others = [
        Lines(0 * along + e, along, field.sample(0 * along + e, along), 0 * along)
        for e in np.arange(1000.0, 17_000.0, 450.0)
    ]
    tracks, truth = [], []
    for wx, wy, v in windows_of(others, SETTINGS["spacing_m"], 30):
        offset = rng.uniform(-800, 800, 2)
        tracks.append(geomag.Track(wx - offset[0], wy - offset[1], v))
        truth.append((wx[-1], wy[-1]))
    options = {"name": "unseen", "half_width_m": 800.0, "tolerance_m": 200.0}
    learnt, bare = (assess(m, tracks, np.array(truth), **options) for m in (made, grid))
    assert learnt.fixed.mean() > bare.fixed.mean() + 0.1
    wrong, declared = np.sum(learnt.error_m[learnt.fixed] > 200), learnt.risk[learnt.fixed].sum()
    assert wrong <= declared + 3 * np.sqrt(declared + 1)


def test_flights_that_teach_nothing_are_refused(scene):
    _, grid, flights = scene
    with pytest.raises(geomag.TooFewSamplesError, match="at least 1"):
        learn_from_flights(grid, [])
    with pytest.raises(geomag.TooFewSamplesError, match="at least 6 windows"):
        learn_from_flights(grid, [flights[0][:60]], **SETTINGS)
    away = geomag.Track(np.asarray(flights[0].x) + 1e6, flights[0].y, flights[0].values)
    with pytest.raises(geomag.TooFewSamplesError, match="on the map, got 0"):
        learn_from_flights(grid, [away], **SETTINGS)
    with pytest.raises(geomag.InvalidInputError, match="tolerance_m: needed"):
        learn_from_flights(grid, flights, tolerance_m=-1.0)
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.05, 300.0, 60, 0.1)
    with pytest.raises(geomag.InvalidInputError, match="learnt from flights"):
        with_errors(grid, None, model)
