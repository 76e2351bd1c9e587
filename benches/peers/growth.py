"""How the cost grows: times over some three decades of one size at a time, everything else held."""

from __future__ import annotations

import numpy as np
from lattice import best_of, rough

import geomag
from geomag._geomag import _minimum_curvature


def searched(side, samples, map_side=None, **options):
    """Seconds of a grid search."""
    half = side // 2
    k = np.arange(samples)
    # Long tracks go to and fro, so that the map does not grow with them.
    xs, ys = half + 10.3 + np.abs((2.1 * k) % 400 - 200), half + 20.7 + np.abs((1.3 * k) % 400 - 200)
    values = rough(map_side or 2 * half + 320)
    grid = geomag.GridMap(values, np.arange(len(values)), np.arange(len(values)))
    track = geomag.Track(xs, ys, grid.sample(xs + 2, ys - 2))
    return best_of(lambda: geomag.match_grid(grid, track, "msd", half_width=half, **options), 0.1)[0]


def evaluated(order, points=2000):
    rng = np.random.default_rng(order)
    count = 3 + sum(1 for _ in geomag.RectangularHarmonicModel.terms(order))
    region = [(-1e5, 1e5), (-1e5, 1e5), (-1e4, 7e3)]
    model = geomag.RectangularHarmonicModel.from_coefficients(order, 3e5, rng.normal(size=count), region=region)
    at = rng.uniform(-1e5, 1e5, points), rng.uniform(-1e5, 1e5, points), np.full(points, -1e3)
    return best_of(lambda: model.field(*at), 0.1)[0]


def gridded(points, side=200):
    rng = np.random.default_rng(points)
    x, y = rng.uniform(0, 4e4, (2, points))
    step = 4e4 / (side - 1)
    return best_of(
        lambda: _minimum_curvature(x, y, np.sin(x / 5e3), (0.0, step, side), (0.0, step, side), aspect=1.0), 0.1
    )[0]


def matched(side, samples):
    """Seconds of a calibrated match, its tests of misfit with it."""
    half = 200.0 * (side // 2)
    axis = np.arange(300) * 200.0
    grid = geomag.GridMap(50 * np.sin(axis / 1.9e3) * np.cos(axis / 2.3e3)[:, None], axis, axis, sigma=1.0)
    k = np.arange(samples)
    x, y = 2.5e4 + 200 * np.abs(k % 80 - 40), 2.6e4 + 130 * np.abs(k % 60 - 30)
    track = geomag.Track(x, y, grid.sample(x + 150, y - 90))
    return best_of(lambda: geomag.match_posterior(grid, track, half_width=half, sigma=1.0, tolerance_m=200.0), 0.1)[0]


def growths(smoke=False):
    """(what grows, its sizes, seconds)."""
    few = slice(0, 2) if smoke else slice(None)
    sides = [11, 31, 101, 317, 1001][few]
    yield "offsets of a grid search, 50 samples", [s * s for s in sides], [searched(s, 50) for s in sides]
    samples = [10, 32, 100, 316, 1000, 10_000][few]
    yield "samples of a grid search, 101 x 101 offsets", samples, [searched(101, n) for n in samples]
    maps = [421, 1000, 3000][few]
    yield "nodes of the map, 101 x 101 offsets, 50 samples", [m * m for m in maps], [searched(101, 50, m) for m in maps]
    sides = [11, 37, 101][few]
    yield "offsets of a calibrated match, 40 samples", [s * s for s in sides], [matched(s, 40) for s in sides]
    samples = [10, 40, 160, 640][few]
    yield "samples of a calibrated match, 37 x 37 offsets", samples, [matched(37, n) for n in samples]
    orders = [3, 6, 12, 24][few]
    yield "order of a harmonic model, 2,000 points", orders, [evaluated(n) for n in orders]
    points = [200, 2000, 20_000, 200_000][few]
    yield "points of survey lines gridded to 200 x 200", points, [gridded(n) for n in points]
    threads = [1, 2]
    yield (
        "threads of a grid search, 1001 x 1001 offsets, 100 samples",
        threads,
        [searched(31 if smoke else 1001, 100, threads=n) for n in threads],
    )
