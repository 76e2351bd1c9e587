"""What a filter has to know of a map's errors is found again where it was put in."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.survey import Lines
from geomag.survey._crossings import crossings, misfit_of
from geomag.survey._learn_filter import learn_filter, mean_variance

FIELD = synthetic.Crust(height_m=400.0).draw((0, 0, 40_000, 20_000), seed=3)
DISTANCE_M = 150.0


@pytest.fixture(scope="module")
def grid():
    return FIELD.grid(100.0)


def flown(rng, shift_m=0.0, changes_m=0.0, scale=0.0, readings_m=40.0):
    """Lines over the field that are not in the map: displaced, as a whole or over a length, with errors of Student's law."""
    lines = []
    for k, y in enumerate(np.arange(1_000.0, 19_000.0, 300.0)):
        x = np.arange(1_000.0, 39_000.0, readings_m)
        moved = shift_m * rng.standard_normal(2)[:, None] * np.ones(x.size)
        if changes_m:
            keep = np.exp(-readings_m / changes_m)
            for axis in range(2):
                for j in range(1, x.size):
                    moved[axis, j] = keep * moved[axis, j - 1] + shift_m * np.sqrt(1 - keep**2) * rng.standard_normal()
        values = FIELD.sample(x + moved[0], y + moved[1]) + scale * rng.standard_t(3, x.size)
        lines.append(Lines(x, np.full(x.size, y), values, np.full(x.size, k)))
    return lines


def learnt(grid, lines, sigma, rng):
    known = geomag.GridMap(np.asarray(grid.values), grid.x, grid.y, sigma=np.full(grid.shape, sigma))
    return learn_filter([(known, np.full(grid.shape, DISTANCE_M))], [lines], lines, 1.0, 0.01, rng)


def test_the_sigma_of_a_sample_and_of_a_mean(grid):
    rng = np.random.default_rng(1)
    law = learnt(grid, flown(rng, scale=4.0), 2.0, rng)
    assert law.sample_factor == pytest.approx(2.0, rel=0.05)
    # Means of six independent readings: 0.4 of one, a little more with such tails, less the least.
    assert 0.25 < law.batch_factor < 0.65
    assert law.registration_m_per_d < 0.1


def test_features_that_stand_displaced_as_a_whole(grid):
    rng = np.random.default_rng(2)
    law = learnt(grid, flown(rng, shift_m=60.0, scale=1.0), 1.0, rng)
    assert law.registration_m_per_d == pytest.approx(60.0 / DISTANCE_M, rel=0.25)
    assert law.registration_length > 60.0


def test_a_displacement_that_changes_has_its_length(grid):
    rng = np.random.default_rng(3)
    law = learnt(grid, flown(rng, shift_m=60.0, changes_m=2_250.0, scale=1.0), 1.0, rng)
    assert law.registration_m_per_d == pytest.approx(60.0 / DISTANCE_M, rel=0.3)
    assert (
        7.0 < law.registration_length < 45.0
    )  # 15 distances to the data; sixty lines tell it to a factor of two or three


def test_too_little_to_learn_from(grid):
    rng = np.random.default_rng(4)
    assert learnt(grid, [one._take(np.arange(one.x.size) < 30) for one in flown(rng, scale=1.0)[:3]], 1.0, rng) is None


def test_mean_of_a_process_over_a_stretch():
    assert mean_variance(1e-6, 1.0) == pytest.approx(1.0, abs=1e-3)
    assert mean_variance(100.0, 1.0) == pytest.approx(0.02, rel=0.02)


def test_lines_disagree_by_their_noise_once_levels_are_out():
    survey = synthetic.survey(FIELD, line_spacing_m=500.0, tie_spacing_m=1_000.0, sigma=2.0, level_sigma=15.0, seed=5)
    differences, who = crossings(survey.split(), np.random.default_rng(0))
    assert differences.size > 1_000
    assert 1.4826 * np.median(np.abs(differences)) > 15.0
    # Two readings are interpolated at a crossing, here at one of them: their own noise.
    assert misfit_of(differences, who) == pytest.approx(2.0, rel=0.12)
    assert np.isnan(misfit_of(differences[:10], who[:10]))


def test_a_gap_is_not_crossed():
    survey = synthetic.survey(FIELD, line_spacing_m=500.0, tie_spacing_m=1_000.0, seed=5)
    hole = np.abs(survey.x - 20_000.0) < 1_500.0
    apart = Lines(survey.x[~hole], survey.y[~hole], survey.values[~hole], survey.line[~hole])
    before, _ = crossings(survey.split(), np.random.default_rng(0))
    after, _ = crossings(apart.split(), np.random.default_rng(0))
    assert np.abs(after).max() < 20.0
    assert after.size < before.size
