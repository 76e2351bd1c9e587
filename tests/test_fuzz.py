"""Readers under mutated inputs: a short form of what tests/fuzzing.py does at length, and the seeds that once found something."""

from __future__ import annotations

import os

import numpy as np
import pytest

for module in ("xarray", "netCDF4", "rasterio", "harmonica"):
    pytest.importorskip(module, reason="needs the extras 'io' and 'survey'")

import fuzzing  # noqa: E402 - after the libraries that it needs

LONG = 200 if "GEOMAG_LONG" in os.environ else 1
#: Kind and seed of inputs that once ended in anything but an error of ours or the numbers of the file.
FOUND = [("binary", 157), ("binary", 325), ("text", 26712), ("text", 28429), ("text", 33459), ("grid", 41803), ("esri", 74778),
         ("lines", 18189), ("mgd77", 13199), ("mgd77", 45426), ("log", 525132), ("gxf", 5001), ("gxf", 32779)]  # fmt: skip


@pytest.mark.parametrize("kind", [*fuzzing.TEXT, *fuzzing.GRIDS])
def test_mutated_inputs(kind):
    count = 300 if kind in fuzzing.TEXT else 40 if kind in ("netcdf", "gmt", "tiff", "ers") else 100
    assert fuzzing.run(kind, 0, count * LONG) == []


@pytest.mark.parametrize(("kind", "seed"), FOUND)
def test_seeds_that_found_something(tmp_path, kind, seed):
    assert fuzzing.one(kind, seed, tmp_path) is None


def test_the_oracle_sees_a_stranger():
    """A number that the text does not hold is told, in whatever unit; those that it holds are not."""
    text = b"x_km,y,value\n1.25,2e3,-7\n"
    assert fuzzing.strangers(np.array([1250.0, 2000.0, -7.0, np.nan]), text).size == 0
    assert fuzzing.strangers(np.array([1.26, -7.5]), text).tolist() == [-7.5, 1.26]
