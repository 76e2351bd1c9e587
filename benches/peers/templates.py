"""OpenCV's template matching where it can do the case: samples on the nodes of the map, as a template with a mask."""

from __future__ import annotations

import numpy as np
from lattice import best_of

import geomag


def table(smoke=False):
    """Rows of (case, what, seconds, ns per offset and sample, times as long as geomag)."""
    import cv2

    half, samples = (20, 10) if smoke else (100, 50)
    rng = np.random.default_rng(4)
    k = np.arange(samples)
    xs, ys = half + 2 * k, half + k
    values = rng.uniform(-100, 100, (2 * half + samples + 2, 2 * half + 2 * samples + 2)).astype(np.float32)
    grid = geomag.GridMap(values, np.arange(values.shape[1]), np.arange(values.shape[0]))
    measured = values[ys - 5, xs + 7]
    track = geomag.Track(xs, ys, measured)
    options = {"half_width": half, "surface": True, "refine": False, "min_overlap": 1.0}
    ours, fix = best_of(lambda: geomag.match_grid(grid, track, "msd", **options), 0.2)
    template = np.zeros((samples, 2 * samples - 1), dtype=np.float32)
    mask = np.zeros_like(template)
    template[k, 2 * k], mask[k, 2 * k] = measured, 1.0
    image = values[: template.shape[0] + 2 * half, : template.shape[1] + 2 * half]
    theirs, surface = best_of(lambda: cv2.matchTemplate(image, template, cv2.TM_SQDIFF, mask=mask), 0.2)
    assert fix.offset == (7.0, -5.0)
    best = np.unravel_index(np.argmin(surface), surface.shape)
    assert (best[1] - half, best[0] - half) == (7, -5)
    np.testing.assert_allclose(surface / samples, fix.surface, atol=1e-3 * np.nanmax(fix.surface))
    case = f"{2 * half + 1}x{2 * half + 1}x{samples} on nodes, float32"
    each = 1e9 / ((2 * half + 1) ** 2 * samples)
    yield case, "geomag", ours, ours * each, 1.0
    yield case, "OpenCV matchTemplate, mask", theirs, theirs * each, theirs / ours
