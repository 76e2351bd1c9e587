"""Grid search holds the map, the surface and a few rows a thread, and nothing more."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("resource", reason="peak memory is read by the resource module")

CODE = """
import resource, numpy as np, geomag
side = 2600
values = np.random.default_rng(0).uniform(-100, 100, (side, side))
grid = geomag.GridMap(values, np.arange(side), np.arange(side))
k = np.arange(12)
track = geomag.Track(1300.3 + 2.1 * k, 1290.7 + 1.3 * k, grid.sample(1307.3 + 2.1 * k, 1285.7 + 1.3 * k))
geomag.match_grid(grid, track, "msd", half_width=10)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
fix = geomag.match_grid(grid, track, "msd", half_width=1200)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
assert fix.offset == (7.0, -5.0) or abs(fix.offset[0] - 7) < 0.5
print((after - before) * 1024, 2401 * 2401 * 8)
"""


def test_peak_memory_is_one_surface():
    out = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    grown, surface = map(int, out.stdout.split())
    assert grown < 1.5 * surface
