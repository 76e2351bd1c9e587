"""One battery for every matcher: a new one adds a line to `MATCHERS`."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import pytest
from fields import rough

import geomag
from geomag._words import Criterion

HALF_M = 400.0
SIGMA = 1.0
CELL = 50.0


def run_iema(grid, track):
    half = HALF_M / np.array(grid.metres_per_unit(float(track.y[-1])))
    # A finer lattice and a gate wide enough for offsets between its points; see the guide.
    step = np.array(grid.spacing) / 2
    return geomag.Iema(grid, sigma=5.0, half_width=half, step=step, tolerance=half * 0.4, max_misses=1).run(track)


def run_grid(criterion, **options):
    def run(grid, track):
        half = HALF_M / np.array(grid.metres_per_unit(float(track.y[-1])))
        return geomag.match_grid(grid, track, criterion, half_width=half, **options)

    return run


def run_posterior(grid, track):
    half = HALF_M / np.array(grid.metres_per_unit(float(track.y[-1])))
    return geomag.match_posterior(grid, track, half_width=half, sigma=SIGMA, tolerance_m=100.0, max_risk=0.01)


def run_posterior_stream(grid, track):
    half = HALF_M / np.array(grid.metres_per_unit(float(track.y[-1])))
    return geomag.PosteriorMatcher(grid, half_width=half, sigma=SIGMA, tolerance_m=100.0, max_risk=0.01).run(track)


CONTOUR = {
    "transform": "translation",
    "radius_m": 2 * HALF_M,
    "starts": "grid",
    "refine": True,
    # It reads the map bicubically, the readings here are bilinear: the difference is the map's error.
    "sigma": 4.0,
    "offset_sigma_m": HALF_M / 2,
    "heading_sigma_deg": 0.1,
    "scale_sigma": 0.001,
}


def run_contour(grid, track):
    return geomag.match_contour(grid, track, **CONTOUR)


def run_sliding(grid, track):
    sliding = geomag.SlidingContour(grid, length=len(track), **CONTOUR)
    fixes = [sliding.update(x, y, value) for x, y, value in zip(track.x, track.y, track.values, strict=True)]
    return fixes[-1]


class Line(NamedTuple):
    """A matcher in the battery."""

    run: Callable[[geomag.GridMap, geomag.Track], geomag.Fix]
    #: Error that its answers may have, metres (median).
    allowed: float
    #: What of the package it is.
    of: object
    #: Fixes of eight that it declares at least. PROD is the largest where the field is: its best place is told, and left ambiguous.
    least: int = 6


MATCHERS = {
    "iema": Line(run_iema, 150.0, geomag.Iema),
    "msd": Line(run_grid("msd", sigma=SIGMA), 15.0, geomag.match_grid),
    "mad": Line(run_grid("mad"), 15.0, geomag.match_grid),
    "prod": Line(run_grid("prod"), 100.0, geomag.match_grid, least=0),
    "ncc": Line(run_grid("ncc"), 15.0, geomag.match_grid),
    "hausdorff": Line(run_grid("hausdorff"), 25.0, geomag.match_grid),
    "posterior": Line(run_posterior, 25.0, geomag.match_posterior),
    "posterior, streamed": Line(run_posterior_stream, 25.0, geomag.PosteriorMatcher),
    "contour": Line(run_contour, 15.0, geomag.match_contour),
    "contour, sliding": Line(run_sliding, 15.0, geomag.SlidingContour),
}


def test_every_matcher_is_in_the_battery():
    """What the package calls a matcher: functions `match_*`, and classes whose `run` makes fixes of a track; and every measure."""
    functions = {n for n in geomag.__all__ if n.startswith("match_") and not n.endswith("_many")}
    stub = (Path(geomag.__file__).parent / "_geomag.pyi").read_text(encoding="utf-8")
    classes = re.split(r"^(?:@final\n)?class ", stub, flags=re.M)[1:]
    streams = {
        re.match(r"\w+", text)[0] for text in classes if re.search(r"def run\(self, track.*-> (Fix|list\[Fix\]):", text)
    }
    assert {"match_grid", "Iema"} <= functions | streams
    assert {line.of.__name__ for line in MATCHERS.values()} == functions | streams
    assert set(get_args(Criterion)) <= set(MATCHERS)


def make(seed, *, geographic=False, dtype="float64", holes=0.0, flip=False):
    """A map and a track on it whose INS is off by up to 300 m, and the true offset in metres."""
    rng = np.random.default_rng(seed)
    values = rough(rng, 80, 90, smooth=4.0).astype(dtype)
    if holes:
        values[rng.random(values.shape) < holes] = np.nan
    x, y = CELL * np.arange(90), CELL * np.arange(80)
    k = np.arange(25)
    px, py = 1300.0 + 62 * k, 1200.0 + 41 * k
    unit = np.ones(2)
    if geographic:
        # The same plane laid across the date line on the equator, where a degree is nearly the same both ways.
        unit = np.array([111_319.49, 110_574.3])
        x, y = 179.98 + x / unit[0], y / unit[1] - 0.01
        px, py = 179.98 + px / unit[0], py / unit[1] - 0.01
        x = np.where(x >= 180, x - 360, x)
    if flip:
        values, y = values[::-1], y[::-1]
    grid = geomag.GridMap(values, x, y, geographic=geographic)
    full = grid.sample(px, py)
    readings = np.where(np.isnan(full), np.nanmean(full), full) + rng.normal(0, SIGMA, len(k))
    offset_m = rng.uniform(-300, 300, 2)
    lon = px - offset_m[0] / unit[0]
    if geographic:
        lon = np.where(lon >= 180, lon - 360, lon)
    return grid, geomag.Track(lon, py - offset_m[1] / unit[1], readings), offset_m


@pytest.fixture(params=MATCHERS)
def matcher(request):
    return MATCHERS[request.param]


@pytest.mark.parametrize(
    "case",
    [{}, {"geographic": True}, {"dtype": "float32"}, {"flip": True}],
    ids=["plain", "date line", "float32", "descending"],
)
def test_finds_the_truth(matcher, case):
    errors, fixed = [], 0
    for seed in range(8):
        grid, track, offset_m = make(seed, **case)
        fix = matcher.run(grid, track)
        assert isinstance(fix, geomag.Fix)
        assert fix.ok == (fix.status == "fixed")
        fixed += fix.ok
        if fix.ok or not matcher.least:
            errors.append(np.hypot(*(np.array(fix.offset_m) - offset_m)))
            unit = np.array(grid.metres_per_unit(float(fix.y)))
            np.testing.assert_allclose(fix.offset_m, np.array(fix.offset) * unit, rtol=1e-3)
            # IEMA may answer before the track ends: its fix is for the last sample that it took.
            last = len(fix.track) - 1
            turns = (fix.x - track.x[last] - fix.offset[0]) / 360
            assert turns == pytest.approx(round(turns), abs=1e-11)
            assert fix.y == pytest.approx(track.y[last] + fix.offset[1])
            assert len(fix.track) <= len(track)
    assert fixed >= matcher.least
    assert np.median(errors) <= matcher.allowed


@pytest.mark.parametrize("name", [n for n in MATCHERS if n != "iema"])
def test_unrelated_readings_are_declined(name):
    """Readings from another place: an honest matcher declines. The paper's IEMA has no notion of it (see its guide)."""
    run = MATCHERS[name].run
    claims = 0
    for seed in range(12):
        grid, track, _ = make(seed)
        other = np.random.default_rng(100 + seed).normal(0, 100, len(track))
        fix = run(grid, geomag.Track(track.x, track.y, other))
        claims += fix.ok
    assert claims <= 4


def test_flat_field_is_not_fixed(matcher):
    run = matcher.run
    grid, track, _ = make(0)
    flat = geomag.GridMap(np.full((80, 90), 5.0), grid.x, grid.y)
    assert not run(flat, geomag.Track(track.x, track.y, np.full(len(track), 5.0))).ok


def test_holes_do_not_mislead(matcher):
    for seed in range(4):
        grid, track, offset_m = make(seed, holes=0.003)
        fix = matcher.run(grid, track)
        if fix.ok:
            assert np.hypot(*(np.array(fix.offset_m) - offset_m)) < 3 * matcher.allowed


def test_a_track_far_off_the_map_is_no_fix(matcher):
    run = matcher.run
    grid, track, _ = make(0)
    away = geomag.Track(track.x + 1e6, track.y, track.values)
    with contextlib.suppress(geomag.InvalidInputError):
        assert not run(grid, away).ok


def test_one_sample_is_no_fix(matcher):
    run = matcher.run
    grid, track, _ = make(0)
    with contextlib.suppress(geomag.TooFewSamplesError):
        assert not run(grid, track[:1]).ok


def test_same_answer_every_time(matcher):
    run = matcher.run
    grid, track, _ = make(3)
    assert repr(run(grid, track)) == repr(run(grid, track))
