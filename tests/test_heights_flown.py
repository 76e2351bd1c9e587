"""Flights above a map, level, climbing and descending: told their heights, they are fixed as at the map's own, and as rightly.

The long form makes the tables of docs/guide/heights.md: maps of two thirds of the lines, flights along the others over the map of all
lines, continued, on two surveys. Run it with `GEOMAG_LONG=1 pytest -s tests/test_heights_flown.py`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pytest

import geomag
from geomag import calibration, continuation, survey
from geomag.survey import folds_of
from geomag.survey._survey import windows_of

SAMPLES = 40


def flown(maps, truth, windows, profile, own, seed=1):
    """Fixed, wrong and the number of tracks along windows, one list of them a map; readings of `truth`, a stack."""
    rng = np.random.default_rng(seed)
    fixed = wrong = count = 0
    heights = np.linspace(*profile, SAMPLES).astype(float)
    for grid, some in zip(maps, windows, strict=True):
        tracks, places = [], []
        for x, y in some:
            offset = rng.uniform(-own.half_m, own.half_m, 2) / grid.metres_per_unit(float(y[-1]))
            readings = truth.sample(x, y, heights) + rng.normal(0, 1.0, SAMPLES)
            tracks.append(geomag.Track(x - offset[0], y - offset[1], readings, height_m=heights))
            places.append((x[-1], y[-1]))
        got = calibration.assess(
            grid, tracks, np.array(places), name="", half_width_m=own.half_m, tolerance_m=own.tolerance_m
        )
        fixed += int(got.fixed.sum())
        wrong += int((got.error_m[got.fixed] > own.tolerance_m).sum())
        count += len(tracks)
    return fixed, wrong, count


def test_flights_above_a_map_are_fixed_once_they_tell_their_heights():
    axis = np.arange(0.0, 20_001.0, 100.0)
    rng = np.random.default_rng(7)
    waves = [(rng.normal(0, 12), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(500, 9000, 60)]

    def field(x, y, height):
        return sum(a * np.exp(-k * height) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)

    grid = geomag.GridMap(field(axis, axis[:, None], 0.0), axis, axis, sigma=0.0, height_m=100.0)
    fixed, untold_right, wrong = 0, 0, 0
    for _ in range(12):
        x = np.linspace(0, 7800, 40) + rng.uniform(3000, 8000)
        y = np.linspace(0, 3000, 40) + rng.uniform(4000, 11_000)
        height = np.linspace(*rng.uniform(100, 500, 2), 40)
        offset = rng.uniform(-800, 800, 2)
        readings = field(x, y, height - 100.0) + rng.normal(0, 0.5, 40)
        told = geomag.Track(x - offset[0], y - offset[1], readings, height_m=height)
        fix = geomag.match_posterior(grid, told, half_width=1000, sigma=0.5, tolerance_m=150)
        fixed += fix.ok
        wrong += fix.ok and np.hypot(*(np.array(fix.offset_m) - offset)) > 150
        untold = geomag.Track(told.x, told.y, readings)
        fix = geomag.match_posterior(grid, untold, half_width=1000, sigma=0.5, tolerance_m=150)
        untold_right += fix.ok and np.hypot(*(np.array(fix.offset_m) - offset)) <= 150
    assert fixed >= 10
    assert wrong == 0
    assert untold_right < fixed


@dataclass(frozen=True)
class Survey:
    """How a survey is flown: its files, flights, and the heights of their first and last samples."""

    lines: str
    grid: str
    columns: dict[str, str]
    spacing_m: float
    half_m: float
    tolerance_m: float
    profiles: list[tuple[float, float]]
    #: Up to here four fifths of the fixes at the map's own height are to be had.
    high_m: float


SURVEYS = {
    "osborne": Survey(
        "osborne-aeromag/osborne_lines.csv.gz", "osborne-aeromag/osborne_grid_from_shared_lines.nc", {}, 200.0, 1000.0, 200.0,
        [(0, 0), (50, 50), (100, 100), (200, 200), (300, 300), (500, 500), (1000, 1000), (0, 300), (300, 50), (0, 1000), (1000, 200)], 300.0,
    ),
    "britain": Survey(
        "britain-aeromag/britain_lines.csv.gz", "britain-aeromag/britain_grid_from_shared_lines.nc",
        {"value": "total_field_anomaly_nt", "line": "line"}, 1000.0, 8000.0, 1500.0,
        [(0, 0), (300, 300), (600, 600), (1200, 1200), (2000, 2000), (0, 1200)], 600.0,
    ),
}  # fmt: skip


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
@pytest.mark.parametrize("name", SURVEYS)
def test_a_survey_from_its_own_height_to_far_above(data_file, capsys, name):
    own = SURVEYS[name]
    lines = survey.read_lines(data_file(own.lines), **own.columns)
    whole = geomag.read_grid(data_file(own.grid))
    truth = geomag.GridMap(np.asarray(whole.values, float), whole.x, whole.y, geographic=True, sigma=0.0, height_m=0.0)
    highest = max(map(max, own.profiles))
    truth = truth.continue_to(np.r_[0.0, np.geomspace(0.01, 1.0, 40) * highest], edges="mirrored")
    pieces = lines.split()
    fold = folds_of(pieces, 3)
    maps, windows = [], []
    for k in range(3):
        kept = survey.Lines.joined([p for p, f in zip(pieces, fold, strict=True) if f != k])
        learnt = survey.map_from_lines(kept)
        level = geomag.GridMap(
            learnt.values, learnt.x, learnt.y, geographic=True, sigma=learnt.sigma, height_m=0.0
        ).with_error_model(**learnt.error_model)
        taken = [p for p, f in zip(pieces, fold, strict=True) if f == k]
        some = [(x, y) for x, y, _ in windows_of(taken, own.spacing_m, SAMPLES, 0.0) if len(x) == SAMPLES]
        ok = [
            np.isfinite(truth.sample(x, y, 0.0)).all() and np.isfinite(learnt.sample(x, y)).mean() >= 0.9
            for x, y in some
        ]
        maps.append(level.continue_to(continuation.levels(level, 0.0, highest)))
        # Two starts each.
        windows.append([w for w, good in zip(some, ok, strict=True) if good] * 2)
    rows = {profile: flown(maps, truth, windows, profile, own) for profile in own.profiles}
    with capsys.disabled():
        for (first, last), (fixed, wrong, count) in rows.items():
            print(f"| {first} to {last} m | {count} | {fixed / count:.1%} | {wrong / max(fixed, 1):.2%} ({wrong}) |")
    at_map = rows[0, 0][0] / rows[0, 0][2]
    for (first, last), (fixed, wrong, count) in rows.items():
        assert wrong <= 0.015 * fixed, (first, last)
        if max(first, last) <= own.high_m:
            assert fixed / count >= 0.8 * at_map, (first, last)
