"""Gridding and continuation side by side with verde and harmonica, in one run, answers compared."""

from __future__ import annotations

import warnings

import numpy as np
from lattice import best_of

import geomag
from geomag._geomag import _minimum_curvature
from geomag.continuation import continue_to


def gridding(smoke):
    import verde

    n, side = (150, 30) if smoke else (1500, 100)
    rng = np.random.default_rng(6)

    def field(x, y):
        return 50 * np.sin(x / 6e3) * np.cos(y / 5e3) + 20 * np.sin((x + y) / 4e3)

    x, y = rng.uniform(0, 4e4, (2, n))
    values = field(x, y)
    step = 4e4 / (side - 1)
    axis = np.arange(side) * step
    inside = slice(side // 10, -side // 10)

    def error(surface):
        return float(np.sqrt(np.mean((surface - field(axis, axis[:, None]))[inside, inside] ** 2)))

    ours, surface = best_of(
        lambda: np.asarray(_minimum_curvature(x, y, values, (0.0, step, side), (0.0, step, side), aspect=1.0)), 0.1
    )
    surface = surface.reshape(side, side)

    def spline():
        return verde.Spline().fit((x, y), values).predict(np.meshgrid(axis, axis))

    theirs, other = best_of(spline, 0.1)
    assert error(surface) < 2 * error(other) + 0.5, (error(surface), error(other))
    case = f"minimum curvature, {n} points to {side} x {side}"
    yield case, "geomag", ours, 1e9 * ours / side**2, 1.0
    yield case, "verde.Spline", theirs, 1e9 * theirs / side**2, theirs / ours


def continuing(smoke):
    import harmonica
    import xarray

    side = 64 if smoke else 512
    axis = np.arange(side) * 200.0
    k = 2 * np.pi / (side * 200.0)
    values = 40 * np.sin(5 * k * axis)[None, :] * np.cos(3 * k * axis)[:, None]
    grid = geomag.GridMap(values, axis, axis, height_m=0.0)
    ours, above = best_of(lambda: continue_to(grid, 300.0, edges="periodic"), 0.2)
    array = xarray.DataArray(values, coords={"northing": axis, "easting": axis}, dims=("northing", "easting"))
    theirs, other = best_of(lambda: harmonica.upward_continuation(array, 300.0), 0.2)
    np.testing.assert_allclose(np.asarray(above.values), other.values, atol=1e-8)
    foretold, _ = best_of(lambda: continue_to(grid, 300.0), 0.2)
    case = f"continuation of {side} x {side}"
    yield case, "geomag, periodic", ours, 1e9 * ours / side**2, 1.0
    yield case, "geomag, edges foretold, sigma", foretold, 1e9 * foretold / side**2, foretold / ours
    yield case, "harmonica", theirs, 1e9 * theirs / side**2, theirs / ours


def table(smoke=False):
    """Rows of (case, what, seconds, ns per node, times as long as geomag)."""
    # Of harmonica's own libraries, about what they will change.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield from gridding(smoke)
        yield from continuing(smoke)
