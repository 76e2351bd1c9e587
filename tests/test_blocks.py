"""Blocks: the same bits for any cut, lazily too, within a bound of memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import geomag
from geomag import synthetic

xr = pytest.importorskip("xarray")

from geomag import blocks  # noqa: E402 - after the check

OPTIONS = {"heading_deg": (0.0, 45.0, 90.0), "samples": 9, "spacing_m": 700.0, "sigma": 3.0}


@pytest.fixture(scope="module")
def data():
    grid = synthetic.Crust().draw((0, 0, 60_000, 45_000), seed=3).grid(500.0, units="nT")
    values = grid.values.astype("float32")
    values[30:34, 50:60] = np.nan
    return xr.DataArray(values, coords={"y": grid.y, "x": grid.x}, dims=("y", "x"))


@pytest.mark.parametrize("block", [(7, 11), (1, 121), (64, 16), 1000])
def test_bound_is_the_same_for_any_cut(data, block):
    whole = blocks.position_bound(data, block=10_000, **OPTIONS)
    cut = blocks.position_bound(data, block=block, **OPTIONS)
    assert list(whole) == ["error_m_000", "samples_000", "error_m_045", "samples_045", "error_m_090", "samples_090"]
    for name in whole:
        assert whole[name].values.tobytes() == cut[name].values.tobytes(), name
    assert np.isfinite(whole["error_m_045"]).mean() > 0.5


def test_bound_is_lazy_on_chunks(data):
    pytest.importorskip("dask")
    lazy = blocks.position_bound(data.chunk({"y": 20, "x": 33}), **OPTIONS)
    assert lazy["error_m_000"].chunks is not None
    assert lazy.compute().identical(blocks.position_bound(data, **OPTIONS))


def test_bound_on_degrees(data):
    grid = synthetic.Crust().draw((-3.0, 54.0, -2.2, 54.5), geographic=True, seed=1).grid(0.01, units="nT")
    degrees = xr.DataArray(grid.values, coords={"y": grid.y, "x": grid.x}, dims=("y", "x"))
    whole = blocks.position_bound(degrees, geographic=True, block=1000, **OPTIONS)
    assert whole.identical(blocks.position_bound(degrees, geographic=True, block=13, **OPTIONS))


def test_bound_is_what_matching_reaches():
    """Honest: grid searches of many noise draws on a right map come to the bound, and no closer."""
    field = synthetic.Crust(dipoles=0, shortest_m=6000.0).draw((0, 0, 60_000, 60_000), seed=5)
    grid = field.grid(500.0)
    data = xr.DataArray(grid.values, coords={"y": grid.y, "x": grid.x}, dims=("y", "x"))
    bound = blocks.position_bound(data, heading_deg=(90.0,), samples=30, spacing_m=1000.0, sigma=2.0, map_error_m=0.0)
    expected = float(bound["error_m_090"].sel(x=45_000, y=30_000))
    path = synthetic.Path.straight((16_000, 30_000), course_deg=90, speed_m_s=100, interval_s=10, samples=30)
    errors = []
    for seed in range(200):
        flight = synthetic.fly(field, path, sensor=synthetic.Sensor(sigma=2.0), seed=seed)
        fix = geomag.match_contour(
            grid, flight.track, sigma=2.0, refine=True, transform="translation", bias_sigma=1e6, offset_sigma_m=1e5,
            radius_m=2000.0,
        )  # fmt: skip
        errors.append(np.hypot(fix.x - path.x[-1], fix.y - path.y[-1]))
    reached = np.sqrt(np.mean(np.square(errors)))
    assert reached == pytest.approx(expected, rel=0.15)


def test_harmonic_evaluation_in_blocks():
    """A field model over a grid: the same values in one block, in many, and lazily."""
    rng = np.random.default_rng(0)
    north, east, down = rng.uniform(-50e3, 50e3, 400), rng.uniform(-50e3, 50e3, 400), rng.uniform(-2e3, 0, 400)
    field = np.column_stack([np.cos(north / 2e4), np.sin(east / 3e4), np.cos((north + east) / 4e4)]) * 100
    model = geomag.RectangularHarmonicModel.fit(north, east, down, field, order=3)

    def total(x, y):
        found = model.field(y.ravel(), x.ravel(), np.zeros(x.size))
        return {"north": found[:, 0].reshape(x.shape), "down": found[:, 2].reshape(x.shape)}

    x, y = np.linspace(-4e4, 4e4, 61), np.linspace(-4e4, 4e4, 47)
    whole = blocks.evaluate(total, x, y, ["north", "down"], block=1000)
    assert whole.identical(blocks.evaluate(total, x, y, ["north", "down"], block=10))
    pytest.importorskip("dask")
    assert whole.identical(blocks.evaluate(total, x, y, ["north", "down"], block=16, lazy=True).compute())


LARGE = """
import hashlib, json, resource, sys, time
import numpy as np, xarray as xr
from geomag import blocks
n = int(sys.argv[1])
x = np.arange(n) * 500.0
data = np.empty((n, n), dtype="float32")
for i in range(n):  # row by row, so that making the map takes no more memory than the map
    data[i] = 80 * np.sin(x / 3100 + i / 9) + 40 * np.cos(x / 7300 - i / 17)
data = xr.DataArray(data, coords={"y": x, "x": x}, dims=("y", "x"))
start = time.perf_counter()
found = blocks.position_bound(data, heading_deg=(0.0, 90.0), samples=20, spacing_m=500.0, block=int(sys.argv[2]))
took = time.perf_counter() - start
digest = hashlib.sha256()
for name in found:
    digest.update(np.ascontiguousarray(found[name].values))
try:  # a child's ru_maxrss begins with its parent's
    status = open("/proc/self/status").read()
    peak = int(status.split("VmHWM:")[1].split()[0]) / 1024
except (OSError, IndexError):
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"digest": digest.hexdigest(), "peak_mib": peak, "seconds": took}))
"""


def large(n, block):
    done = subprocess.run([sys.executable, "-c", LARGE, str(n), str(block)], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_memory_stays_with_the_block_and_bits_do_not():
    """A quarter of the full size by default; GEOMAG_LARGE=1 does 5000 x 5000, in one block and in many."""
    n = 5000 if os.environ.get("GEOMAG_LARGE") == "1" else 1200
    many = large(n, 512)
    results_mib = 4 * n * n * 4 / 2**20
    assert many["peak_mib"] < min(2048, 300 + 2.5 * results_mib)
    assert large(n, n)["digest"] == many["digest"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda d: blocks.blockwise(d[0], lambda v, x, y: {}, ["a"]), "two dimensions"),
        (lambda d: blocks.blockwise(d, lambda v, x, y: {}, ["a"]), "named 'a'"),
        (lambda d: blocks.blockwise(d, lambda v, x, y: {"a": v[:1]}, ["a"]), "shape"),
        (lambda d: blocks.blockwise(d, lambda v, x, y: {"a": v}, ["a"], halo=(-1, 0)), "halo"),
        (lambda d: blocks.blockwise(d, lambda v, x, y: {"a": v}, ["a"], block=0), "block"),
        (lambda d: blocks.position_bound(d[::-1]), "ascending"),
        (lambda d: blocks.position_bound(d, sigma=0.0), "sigma"),
        (lambda d: blocks.position_bound(d, sigma=np.nan), "sigma: needed a finite number"),
        (lambda d: blocks.position_bound(d, spacing_m=np.inf), "spacing_m: needed a finite number"),
        (lambda d: blocks.position_bound(d, samples=-1), "samples: needed at least 2"),
        (lambda d: blocks.position_bound(d, heading_deg=(0.0, np.nan)), "heading_deg: needed a finite number"),
        (lambda d: blocks.position_bound(d, heading_deg=(5.0, 9.0, 5.0)), "headings that differ"),
        (lambda d: blocks.position_bound(d, heading_deg=()), "heading_deg"),
    ],
)
def test_bad_input_is_refused_by_name(data, call, words):
    with pytest.raises(geomag.InvalidInputError, match=words):
        call(data)
