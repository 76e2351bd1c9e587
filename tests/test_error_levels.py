"""Where a map's errors are larger or smaller than its formula says, learnt from lines left out."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

import geomag
from geomag.survey import ErrorModel, Lines, learn_errors, with_errors
from geomag.survey._levels import Levels
from geomag.survey._surface import Axes

SPACING = 200.0


def samples(rng, count=6000, factor=1.0):
    """Errors over a square of 20 km of which the western half is `factor` times worse than its sigma, and the eastern as much better."""
    x, y = rng.uniform(0, 20_000, (2, count))
    sigma = 10 ** rng.uniform(0, 1, count)
    true = np.where(x < 10_000, factor, 1 / factor)
    return x, y, sigma * true * rng.standard_t(3, count), sigma


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_the_factor_is_found_where_it_is(factor):
    x, y, errors, sigma = samples(np.random.default_rng(2), factor=factor)
    axes = Axes((0.0, 100.0, 201), (0.0, 100.0, 201), (100.0, 100.0))
    found = Levels.of(x, y, errors, sigma, SPACING).on(axes)
    west, east = found[20:180, 20:80], found[20:180, 120:180]
    # About the survey's mean, which is that of the logarithms, and drawn to it by what the mean counts for.
    assert np.log(west.mean()) == pytest.approx(np.log(factor), abs=0.35 * np.log(factor) + 0.06)
    assert np.log(east.mean()) == pytest.approx(-np.log(factor), abs=0.35 * np.log(factor) + 0.06)
    if factor > 1:
        assert west.min() > east.max()


def test_nothing_known_nearby_leaves_the_formula():
    axes = Axes((0.0, 100.0, 101), (0.0, 100.0, 101), (100.0, 100.0))
    far = Levels.of(np.full(50, 9000.0), np.full(50, 9000.0), np.full(50, 9.0), np.linspace(1, 90, 50), SPACING)
    assert np.all(far.on(axes)[:40, :40] == 1.0)
    none = Levels.of(*(np.empty(0),) * 4, SPACING)
    assert np.all(none.on(axes) == 1.0)
    beyond = Levels.of(np.array([-1e6]), np.array([0.0]), np.array([5.0]), np.array([1.0]), SPACING)
    assert np.all(beyond.on(axes) == 1.0)


def test_sigma_carries_the_factor():
    x, y, errors, sigma = samples(np.random.default_rng(3), factor=2.0)
    levels = Levels.of(x, y, errors, sigma, SPACING)
    axis = np.arange(0.0, 20_001.0, 100.0)
    grid = geomag.GridMap(np.add.outer(np.cos(axis / 700), np.sin(axis / 900)) * 50, axis, axis)
    model = ErrorModel(0.1, 1.0, 0.3, 0.1, 1.2, 0.05, SPACING, 100, 0.3, distance_m=60.0)
    plain = np.asarray(with_errors(grid, None, model).sigma)
    placed = np.asarray(with_errors(grid, None, replace(model, levels=levels)).sigma)
    np.testing.assert_allclose(placed / plain, levels.on(Axes.of(grid)), rtol=1e-6)


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
def test_a_part_of_a_survey_that_is_rough_between_its_lines_has_the_larger_sigma():
    """The western half holds a texture that the lines do not resolve, of the same gradient on the lines as a trend."""
    rng = np.random.default_rng(8)
    along = np.arange(0.0, 16_000.0, 40.0)
    number = np.arange(0, 48)
    x = np.tile(along, number.size)
    y = np.repeat(number * SPACING, along.size)
    smooth = 40 * np.sin(x / 900) * np.cos(y / 1100)
    rough = np.where(x < 8000, 15 * np.repeat(rng.normal(size=number.size), along.size) * np.sin(x / 400), 0)
    lines = Lines(x, y, smooth + rough + rng.normal(0, 0.1, x.size), np.repeat(number, along.size), False)
    options = {"spacing_m": 100.0, "half_width_m": 500.0, "tolerance_m": 100.0, "samples": 30}
    model = learn_errors(lines, folds=3, **options)
    assert model.lapses is not None
    assert model.lapses[1] == pytest.approx(29 * 100.0)
    axis = np.arange(0.0, 15_900.0, 50.0)
    flat = geomag.GridMap(np.add.outer(np.zeros(188), np.sin(axis / 300)), axis, np.arange(188) * 50.0)
    sigma = np.asarray(with_errors(flat, lines, model).sigma)
    # The map given is the same all over: only the lines left out tell its halves apart.
    assert np.median(sigma[30:150, 20:140]) > 2 * np.median(sigma[30:150, 180:300])
