"""Scattered points of a map side by side with SciPy, in one run, answers compared."""

from __future__ import annotations

import numpy as np
from lattice import best_of
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

import geomag


def table(smoke=False):
    """Rows of (case, what, seconds, ns per point, times as long as geomag)."""
    rng = np.random.default_rng(2)
    values = rng.uniform(-100, 100, (500, 500))
    grid = geomag.GridMap(values, np.arange(500.0), np.arange(500.0))
    interpolator = RegularGridInterpolator((np.arange(500.0), np.arange(500.0)), values)
    patience = 0.05 if smoke else 0.3
    for n in (1, 500) if smoke else (1, 500, 100_000):
        x, y = rng.uniform(3, 495, (2, n))
        ours, wanted = best_of(lambda x=x, y=y: grid.sample(x, y), patience)
        for what, work in (
            ("geomag", None),
            ("geomag, bicubic", lambda x=x, y=y: grid.sample(x, y, interpolation="bicubic")),
            ("scipy map_coordinates", lambda x=x, y=y: map_coordinates(values, [y, x], order=1)),
            ("scipy RegularGridInterpolator", lambda x=x, y=y: interpolator((y, x))),
        ):
            took, answer = (ours, wanted) if work is None else best_of(work, patience)
            if "bicubic" not in what:
                np.testing.assert_allclose(answer, wanted, atol=1e-9)
            yield f"sample {n} points", what, took, 1e9 * took / n, took / ours
