"""A map through its file is the map: to the last bit, and fixes what it fixed before."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.survey import map_from_lines

for module in ("xarray", "netCDF4", "rasterio"):
    pytest.importorskip(module, reason="needs the extra 'io'")


def bits(grid):
    """All that a map is, as bytes."""
    return pickle.dumps(
        [part.tobytes() if isinstance(part, np.ndarray) else repr(part) for part in flat(grid.__reduce__()[1])]
    )


def flat(part):
    if isinstance(part, dict):
        part = [v for k in sorted(part) for v in (k, part[k])]
    if isinstance(part, (list, tuple)):
        return [inner for p in part for inner in flat(p)]
    return [part]


def layers(shape, seed=0):
    return np.abs(np.random.default_rng(seed).normal(size=shape))


def whole(dtype=np.float64, geographic=True):
    """A map with everything that it may know, on axes that no decimal number hits."""
    shape = (9, 11)
    values = np.random.default_rng(1).normal(0, 50, shape).astype(dtype)
    values[3, 4] = np.nan
    x, y = 16.0 + np.arange(11) / 3, 46.0 + np.arange(9) / 7
    grid = geomag.GridMap(
        values, x, y, geographic=geographic, sigma=layers(shape), height_m=300.0 + layers(shape, 2), name="anomaly",
        units="nT", crs="EPSG:4326" if geographic else "EPSG:32633",
    )  # fmt: skip
    return grid.with_error_model(
        nu=3.5, scale_spread=0.3, correlation=0.7, registration=0.01, distance_m=layers(shape, 3)
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("geographic", [True, False])
def test_through_a_file_to_the_bit(tmp_path, dtype, geographic):
    grid = whole(dtype, geographic)
    grid.save(tmp_path / "map.nc")
    for back in (geomag.GridMap.open(tmp_path / "map.nc"), geomag.read_grid(tmp_path / "map.nc")):
        assert bits(back) == bits(grid)
    grid.to_xarray().to_netcdf(tmp_path / "array.nc")
    assert bits(geomag.GridMap.from_xarray(grid.to_xarray())) == bits(grid)
    back = geomag.read_grid(tmp_path / "array.nc", "anomaly")
    assert (bits(back), back.error_model["nu"]) == (bits(grid), 3.5)


def test_other_programs_find_the_errors_and_the_system(tmp_path):
    import netCDF4

    whole().save(tmp_path / "map.nc")
    with netCDF4.Dataset(tmp_path / "map.nc") as file:
        field = file["anomaly"]
        assert set(field.ancillary_variables.split()) <= set(file.variables)
        assert file["anomaly_sigma"].standard_name == "standard_error"
        assert "GEOGCRS" in file[field.grid_mapping].crs_wkt
        assert file["longitude"].standard_name == "longitude"


def test_plain_and_constant_knowledge(tmp_path):
    grid = geomag.GridMap(np.eye(3), [0, 50, 100], [0, 50, 100], sigma=2.5, height_m=120.0)
    grid = grid.with_error_model(nu=30.0, scale_spread=0.0, correlation=0.0, registration=0.0, distance_m=0.1)
    for each in (grid, geomag.GridMap(np.eye(3), [0, 50, 100], [0, 50, 100])):
        each.save(tmp_path / "map.nc")
        assert bits(geomag.GridMap.open(tmp_path / "map.nc")) == bits(each)


def test_nothing_of_ones_own_is_a_dummy(tmp_path):
    """Nor is a unit turned into another: what is saved comes back."""
    values = np.arange(9.0).reshape(3, 3)
    values[1, 1] = 99_999.0
    grid = geomag.GridMap(values, [0, 50, 100], [0, 50, 100], units="uT")
    grid.save(tmp_path / "map.nc")
    assert bits(geomag.GridMap.open(tmp_path / "map.nc")) == bits(grid)


def test_a_part_of_a_map_is_not_taken_for_the_whole():
    """Layers that no longer fit are not laid over other nodes."""
    part = geomag.GridMap.from_xarray(whole().to_xarray()[1:, 2:])
    assert part.error_model is None


def test_a_sigma_that_is_given_stands_for_all_that_is_known(tmp_path):
    whole().save(tmp_path / "map.nc")
    grid = geomag.read_grid(tmp_path / "map.nc", sigma=4.0)
    assert (float(grid.sigma), grid.error_model) == (4.0, None)


@pytest.mark.parametrize("spoil", ["{", '{"format": 99}', '{"format": 1, "axes": 3}', "[]"])
def test_spoilt_knowledge_is_refused(tmp_path, spoil):
    import netCDF4

    whole().save(tmp_path / "map.nc")
    with netCDF4.Dataset(tmp_path / "map.nc", "a") as file:
        file["anomaly"].geomag_map = spoil
    with pytest.raises(geomag.ReadError, match="geomag_map"):
        geomag.read_grid(tmp_path / "map.nc")


def test_open_refuses_other_files(tmp_path):
    whole().to_xarray().drop_attrs().to_netcdf(tmp_path / "other.nc")
    (tmp_path / "text.nc").write_text("x,y,value\n")
    for name in ("other.nc", "text.nc"):
        with pytest.raises(geomag.ReadError, match="needed a map that geomag saved"):
            geomag.GridMap.open(tmp_path / name)


@pytest.fixture(scope="module")
def survey():
    field = synthetic.Crust().draw((0, 0, 12_000, 12_000), seed=4)
    lines = synthetic.survey(field, line_spacing_m=500.0, sample_spacing_m=50.0, sigma=2.0)
    return field, lines


def test_a_learnt_map_fixes_what_it_fixed(tmp_path, survey):
    field, lines = survey
    grid = map_from_lines(lines)
    grid.save(tmp_path / "map.nc")
    back = geomag.GridMap.open(tmp_path / "map.nc")
    assert bits(back) == bits(grid)
    k = np.arange(40.0)
    true_x, true_y = 2000 + 140 * k, 1500 + 70 * k
    track = geomag.Track(true_x + 250, true_y - 300, field.sample(true_x, true_y))
    fixes = [
        geomag.match_posterior(g, track, half_width=(800, 800), sigma=2.0, tolerance_m=200.0, max_risk=0.01)
        for g in (grid, back)
    ]
    assert fixes[0].to_dict() == fixes[1].to_dict()


def test_the_map_command_makes_one(tmp_path, survey):
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    from geomag.cli import run

    _, lines = survey
    rows = np.column_stack([lines.line.astype(float), lines.x, lines.y, lines.values])
    np.savetxt(tmp_path / "lines.csv", rows, delimiter=",", header="line,x_m,y_m,mag_nT", comments="", fmt="%.6f")
    assert run(["map", str(tmp_path / "lines.csv"), "--out", str(tmp_path / "map.nc"), "--json"]) == 0
    grid = geomag.GridMap.open(tmp_path / "map.nc")
    assert (grid.name, grid.units, grid.geographic) == ("mag_nT", "nT", False)
    assert grid.error_model is not None
    assert json.loads(grid.to_xarray().attrs["geomag_map"])["numbers"]
