"""Harmonic models of survey lines beside the gridded map of the same lines, on lines that neither has seen."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import geomag
from geomag.harmonic_survey import compare_with_map, model_from_lines
from geomag.survey import Lines

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
MAIN = (31_300.0, 3_400.0, -40_800.0)


def drawn(seed=3, spacing=200.0, noise=1.0):
    """East-west lines over a known crust, at 300 m above its top."""
    from geomag import synthetic

    field = synthetic.Crust(texture_rms=60.0, height_m=150.0).draw((0, 0, 4000, 4000), seed=seed)
    rows = np.arange(200.0, 3801.0, spacing)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(200.0, 3801.0, 40.0), rows))
    values = field.sample(x, y) + noise * np.random.default_rng(seed).normal(size=x.size)
    return Lines(x, y, values, np.round(y)), field


def test_left_out_lines_of_a_known_crust():
    lines, _ = drawn()
    seen = []
    found = compare_with_map(lines, 150.0, MAIN, order=16, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (5, 5)
    assert found.model.size > 0.8 * lines.x.size
    assert found.model_rms < 1.05 * found.grid_rms
    assert 0.6 < found.normalised < 1.6
    assert len(found.chosen) == 5
    assert "two sigma" in str(found)


def test_the_model_of_all_lines_knows_its_own_errors():
    lines, field = drawn()
    model = model_from_lines(lines, 150.0, MAIN, order=12, anisotropy=(0.8, 1.0, 1.25))
    nugget, scale = model.misfit
    assert nugget > 0
    assert scale >= 0
    rng = np.random.default_rng(1)
    x, y = rng.uniform(400, 3600, (2, 500))
    direction = np.array(MAIN) / np.linalg.norm(MAIN)
    # The frame's origin is in the middle of the lines.
    points = (y - 2000.0, x - 2000.0, np.zeros(500))
    # The misfit is that of readings, which have noise of 1 nT.
    reading = field.sample(x, y) + rng.normal(size=500)
    error = model.field(*points) @ direction - reading
    sigma = model.sigma(*points, direction=direction)
    assert np.std(error) < 0.25 * np.std(lines.values)
    assert 0.3 < np.mean((error / sigma) ** 2) < 1.5


def test_what_is_refused():
    lines, _ = drawn(spacing=1200.0)
    with pytest.raises(geomag.TooFewSamplesError, match="lines"):
        compare_with_map(lines, 150.0, MAIN)
    lines, _ = drawn()
    with pytest.raises(geomag.ShapeError, match="main_field"):
        model_from_lines(lines, 150.0, [1.0, 2.0])
    with pytest.raises(geomag.InvalidInputError, match="height_m"):
        model_from_lines(lines, np.nan, MAIN)


long = pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")


@pytest.mark.parametrize("chosen", [slice(1, 2), pytest.param(slice(None), marks=long)], ids=["one", "all"])
def test_osborne_blocks(data_file, chosen):
    """No worse than the gridded map on left-out lines, over blocks on which nothing was chosen."""
    pytest.importorskip("pandas")
    from harmonic_survey import BLOCKS, compare_block

    table = data_file("osborne-aeromag/osborne_lines.csv.gz")
    found = [compare_block(table, *block) for block in BLOCKS[chosen]]
    ratios = np.array([c.model_rms / c.grid_rms for c in found])
    assert np.exp(np.log(ratios).mean()) < 1.0, ratios
    assert ratios.max() < 1.1, ratios
    # One block has a line over an anomaly such as no other line shows: the mean over blocks would be that block's.
    normalised = np.median([c.normalised for c in found])
    assert 0.7 < normalised < 1.5, normalised
