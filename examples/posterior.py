"""A calibrated fix from survey lines to answer: lines, a map that knows its errors, a track, a fix with its risk."""

from __future__ import annotations

import numpy as np

import geomag
from geomag.survey import Lines, map_from_lines


def field(x, y):
    """A rough field, nT."""
    x, y = np.asarray(x) / 600, np.asarray(y) / 600
    return 180 * np.sin(1.7 * x) * np.cos(1.3 * y) + 120 * np.sin(2.9 * x + 1.1 * y) + 75 * np.cos(3.7 * y - 0.6 * x)


def main() -> None:
    """Survey a square in lines 300 m apart, fly between them, and ask where the flight was."""
    rng = np.random.default_rng(1)
    north, east = (
        a.ravel() for a in np.meshgrid(np.arange(0, 12_001, 300.0), np.arange(0, 12_001, 25.0), indexing="ij")
    )
    values = np.round(field(east, north) + rng.normal(0, 0.5, east.size))
    grid = map_from_lines(Lines(east, north, values, line=north.astype(int)))

    x, y = np.linspace(2500, 8500, 40), np.linspace(4050, 6450, 40)
    track = geomag.Track(x - 430, y + 280, field(x, y) + 25 + rng.normal(0, 0.5, 40))
    fix = geomag.match_posterior(grid, track, half_width=1000, tolerance_m=150)
    print(fix)
    print(f"risk {fix.risk:.2e}, true offset (430, -280), found ({fix.offset_m[0]:.0f}, {fix.offset_m[1]:.0f})")


if __name__ == "__main__":
    main()
