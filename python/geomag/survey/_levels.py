"""How much better or worse than its formula says a map is from place to place.

The size of errors is one formula for the whole survey; what it leaves out (dikes that run between the lines, stretches that were flown or digitised
badly) goes over kilometres. Lines that were left out say where: their errors over the formula's sigma, smoothed over a few line spacings, foretell
those of other lines nearby. On the two surveys of docs/calibration-report.md they correlate by 0.6 and 0.8, window by window, with errors that
had no part in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomag.survey._lines import Array
from geomag.survey._surface import Axes, spread_out

#: Standard deviation of the smoothing, line spacings.
RADIUS_SPACINGS = 3.0
#: Samples that the survey's mean counts for at every place.
MEAN_SAMPLES = 8.0
#: Errors are counted as at least this share of sigma: the logarithm of a hit says nothing.
LEAST_RATIO = 0.05
#: Factors are within this and its inverse.
MOST = 6.0


@dataclass(frozen=True)
class Levels:
    """Errors of left-out lines over the sigma of the formula: places in map units, logarithms about their mean, smoothing radius."""

    x: Array
    y: Array
    log_ratio: Array
    radius_m: float

    @staticmethod
    def of(x: Array, y: Array, errors: Array, sigma: Array, line_spacing_m: float) -> Levels:
        """From errors and the sigma of the formula at their places, all (n,); those without a sigma are left out."""
        known = np.isfinite(errors) & np.isfinite(sigma) & (sigma > 0)
        logs = np.log(np.abs(errors[known]) / sigma[known] + LEAST_RATIO)
        about = logs - logs.mean() if logs.size else logs
        return Levels(x[known], y[known], about, RADIUS_SPACINGS * line_spacing_m)

    def on(self, axes: Axes) -> Array:
        """The factor on sigma at the nodes of a map, 1 where no errors are known nearby."""
        radius = max(self.radius_m / axes.cell, 1.0)
        i = np.round((self.x - axes.x[0]) / axes.x[1]).astype(int)
        j = np.round((self.y - axes.y[0]) / axes.y[1]).astype(int)
        inside = (i >= 0) & (i < axes.x[2]) & (j >= 0) & (j < axes.y[2])
        node = j[inside] * axes.x[2] + i[inside]
        shape = (axes.y[2], axes.x[2])
        total, count = (
            spread_out(np.bincount(node, weights, shape[0] * shape[1]).astype(float).reshape(shape), radius)
            for weights in (self.log_ratio[inside], np.ones(node.size))
        )
        # What one sample counts for at its own place.
        whole = 2 * np.pi * radius**2
        mean = total * whole / (np.maximum(count, 0.0) * whole + MEAN_SAMPLES)
        return np.asarray(np.exp(np.clip(mean, -np.log(MOST), np.log(MOST))), dtype=np.float64)
