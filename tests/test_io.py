"""Reading maps and tracks: every format made here by an independent writer, and what must be refused."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
from fields import rough

import geomag

xr = pytest.importorskip("xarray", reason="needs the extra 'io'")
pd = pytest.importorskip("pandas", reason="needs the extra 'io'")


@pytest.fixture
def field():
    values = rough(np.random.default_rng(0), 9, 11)
    values[2, 3] = np.nan
    return values, 140.5 + 0.01 * np.arange(11), -22.0 + 0.02 * np.arange(9)


def dataset(values, x, y, **more):
    return xr.Dataset(
        {"anomaly": (("latitude", "longitude"), values, {"units": "nT"}), **more},
        coords={"latitude": y, "longitude": x},
    )


def same(grid, values, x, y, rtol=1e-9):
    np.testing.assert_allclose(grid.values, values, rtol=rtol, atol=1e-4)
    np.testing.assert_allclose(grid.x, x, atol=1e-6)
    np.testing.assert_allclose(grid.y, y, atol=1e-6)


def test_netcdf(tmp_path, field):
    values, x, y = field
    path = tmp_path / "map.nc"
    dataset(values, x, y).to_netcdf(path)
    grid = geomag.read_grid(path)
    same(grid, values, x, y)
    assert (grid.geographic, grid.name, grid.units) == (True, "anomaly", "nT")


def test_netcdf_with_several_variables_and_sigma(tmp_path, field):
    values, x, y = field
    path = tmp_path / "map.nc"
    dataset(values, x, y, error=(("latitude", "longitude"), np.abs(values))).to_netcdf(path)
    with pytest.raises(geomag.UnknownVariableError, match="anomaly, error"):
        geomag.read_grid(path)
    with pytest.raises(geomag.UnknownVariableError, match="got 'field'") as caught:
        geomag.read_grid(path, "field")
    assert isinstance(caught.value, KeyError)
    grid = geomag.read_grid(path, "anomaly", sigma="error")
    np.testing.assert_allclose(grid.sigma, np.abs(values))


def test_xarray_either_dimension_order_and_back(field):
    values, x, y = field
    array = dataset(values, x, y)["anomaly"]
    for a in (array, array.transpose("longitude", "latitude"), array[::-1], array.astype("f4")):
        grid = geomag.GridMap.from_xarray(a)
        same(grid, values, x, y, rtol=1e-6)
        back = grid.to_xarray()
        assert back.dims == ("latitude", "longitude")
        xr.testing.assert_allclose(back, array.rename("anomaly").astype(back.dtype), rtol=1e-6)
    assert geomag.GridMap.from_xarray(array.astype("f4")).values.dtype == np.float32


def test_kilometres_become_metres():
    array = xr.DataArray(
        np.eye(3), coords={"northing": [0.0, 1, 2], "easting": [5.0, 6, 7]}, dims=("northing", "easting")
    )
    array["easting"].attrs["units"] = array["northing"].attrs["units"] = "km"
    grid = geomag.GridMap.from_xarray(array)
    np.testing.assert_allclose(grid.x, [5000, 6000, 7000])
    assert not grid.geographic


def projected(x_units, y_units, crs=None):
    array = xr.DataArray(
        np.eye(3), coords={"northing": [0.0, 1, 2], "easting": [5.0, 6, 7]}, dims=("northing", "easting")
    )
    for name, unit in (("easting", x_units), ("northing", y_units)):
        if unit is not None:
            array[name].attrs["units"] = unit
    if crs is not None:
        array.attrs["crs"] = crs
    return array


@pytest.mark.parametrize(
    ("x_units", "y_units", "x_factor", "y_factor"),
    [("km", "m", 1000.0, 1.0), ("metres", "kilometers", 1.0, 1000.0), ("ft", "ft", 0.3048, 0.3048),
     ("US survey foot", "us-ft", 1200 / 3937, 1200 / 3937), (None, "km", 1.0, 1000.0)],
)  # fmt: skip
def test_every_axis_has_its_own_unit(x_units, y_units, x_factor, y_factor):
    grid = geomag.GridMap.from_xarray(projected(x_units, y_units))
    np.testing.assert_allclose(grid.x, np.array([5, 6, 7]) * x_factor)
    np.testing.assert_allclose(grid.y, np.array([0, 1, 2]) * y_factor)


@pytest.mark.parametrize(
    ("x_units", "y_units", "geographic", "words"),
    [("furlong", "furlong", None, "furlong"), ("m", "parsec", False, "parsec"),
     ("degrees_east", "m", None, "both in metres"), ("degrees_east", "degrees_north", False, "degrees_east")],
)  # fmt: skip
def test_a_unit_that_is_no_length_is_refused(x_units, y_units, geographic, words):
    with pytest.raises(geomag.InvalidInputError, match=words):
        geomag.GridMap.from_xarray(projected(x_units, y_units), geographic=geographic)


def test_words_are_no_coordinates():
    array = xr.DataArray(np.eye(3), coords={"y": [0, 1, 2], "x": list("abc")}, dims=("y", "x"))
    with pytest.raises(geomag.InvalidInputError, match="numbers as coordinates along 'x'"):
        geomag.GridMap.from_xarray(array, geographic=False)


def test_values_come_in_nanotesla_or_milligal():
    array = projected("m", "m")
    for unit, ours, factor in (
        ("uT", "nT", 1e3),
        ("gamma", "nT", 1.0),
        ("m/s2", "mGal", 1e5),
        ("counts", "counts", 1.0),
    ):
        array.attrs["units"] = unit
        grid = geomag.GridMap.from_xarray(array)
        assert (grid.units, grid.values.max()) == (ours, factor)


def test_degrees_to_the_west_are_refused():
    array = projected("degrees_west", "degrees_north").rename(easting="longitude", northing="latitude")
    with pytest.raises(geomag.InvalidInputError, match="to the east"):
        geomag.GridMap.from_xarray(array)


def test_radians_are_no_degrees():
    array = projected("radian", "radian").rename(easting="longitude", northing="latitude")
    with pytest.raises(geomag.InvalidInputError, match="radian"):
        geomag.GridMap.from_xarray(array)


def tiff(path, crs, bands=1, **more):
    rasterio = pytest.importorskip("rasterio", reason="needs the extra 'io'")
    profile = {"driver": "GTiff", "height": 3, "width": 4, "count": bands, "dtype": "float32", "crs": crs}
    with rasterio.open(
        path, "w", transform=rasterio.transform.from_origin(1000, 2000, 10, 20), **profile | more
    ) as out:
        for k in range(bands):
            out.write((np.arange(12).reshape(3, 4) + 100 * k).astype(out.dtypes[k]), k + 1)
    return rasterio


def places(x, y, crs):
    pyproj = pytest.importorskip("pyproj", reason="needs the extra 'geo'")
    return pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(x, y)


@pytest.mark.parametrize(
    ("crs", "factor"),
    [("EPSG:2263", 1200 / 3937), ("EPSG:2222", 0.3048), ("EPSG:2263+5703", 1200 / 3937),
     ("+proj=utm +zone=16 +units=km", 1000.0), ("EPSG:32616", 1.0)],
)  # fmt: skip
def test_a_raster_in_other_units_comes_in_metres_with_its_crs(tmp_path, crs, factor):
    tiff(tmp_path / "map.tif", crs)
    x, y = 1005.0 + 10 * np.arange(4), 1950.0 + 20 * np.arange(3)
    for geographic in (None, False):
        grid = geomag.read_grid(tmp_path / "map.tif", geographic=geographic)
        np.testing.assert_allclose(grid.x, x * factor)
        np.testing.assert_allclose(grid.y, y * factor)
        np.testing.assert_allclose(places(grid.x[:3], grid.y, grid.crs), places(x[:3], y, crs), atol=1e-9)
    if factor == 1.0:
        assert grid.crs == crs
    array = projected("us-ft", "us-ft", "EPSG:2263")
    grid = geomag.GridMap.from_xarray(array)
    np.testing.assert_allclose(
        places(grid.x, grid.y, grid.crs), places(array.easting, array.northing, "EPSG:2263"), atol=1e-9
    )


def test_a_raster_in_grads_is_refused(tmp_path):
    tiff(tmp_path / "map.tif", "EPSG:4807")
    with pytest.raises(geomag.InvalidInputError, match="grad"):
        geomag.read_grid(tmp_path / "map.tif")


def test_a_raster_of_several_bands_asks_which(tmp_path):
    rasterio = tiff(tmp_path / "map.tif", "EPSG:32616", bands=2)
    with rasterio.open(tmp_path / "map.tif", "r+") as out:
        out.set_band_description(2, "anomaly")
    for wrong in (None, "3"):
        with pytest.raises(geomag.UnknownVariableError, match="1, 2, anomaly"):
            geomag.read_grid(tmp_path / "map.tif", wrong)
    for name in ("2", "anomaly"):
        assert geomag.read_grid(tmp_path / "map.tif", name).values.min() == 100.0
    (tmp_path / "map.csv").write_text("x_m,y_m,value\n" + "\n".join(f"{i},{j},1" for i in (0, 1) for j in (0, 1)))
    with pytest.raises(geomag.InvalidInputError, match="variable"):
        geomag.read_grid(tmp_path / "map.csv", "anomaly")


def test_scale_offset_and_unit_of_a_raster(tmp_path):
    rasterio = tiff(tmp_path / "map.tif", "EPSG:32616", dtype="int16")
    with rasterio.open(tmp_path / "map.tif", "r+") as out:
        out.scales, out.offsets, out.units = (0.1,), (48_000.0,), ("nT",)
    grid = geomag.read_grid(tmp_path / "map.tif")
    np.testing.assert_allclose(grid.values[::-1], 48_000 + 0.1 * np.arange(12).reshape(3, 4))
    assert grid.units == "nT"


def test_unknown_units_are_asked_for():
    """Neither the order of dimensions nor the size of coordinates is a guess."""
    array = xr.DataArray(np.eye(3), coords={"b": [0.0, 1, 2], "a": [5.0, 6, 7]}, dims=("b", "a"))
    with pytest.raises(geomag.InvalidInputError, match="which of its dimensions b, a is x"):
        geomag.GridMap.from_xarray(array, geographic=True)
    with pytest.raises(geomag.InvalidInputError, match="geographic=True or geographic=False"):
        geomag.GridMap.from_xarray(array, x="a")
    assert geomag.GridMap.from_xarray(array, x="b", geographic=True).x.tolist() == [0.0, 1.0, 2.0]
    assert geomag.GridMap.from_xarray(array.rename(b="y", a="x"), geographic=True).geographic


@pytest.mark.parametrize("driver", ["GTiff", "GSBG", "GSAG", "GS7BG"])
def test_rasters(tmp_path, field, driver):
    rasterio = pytest.importorskip("rasterio", reason="needs the extra 'io'")
    from rasterio.transform import from_origin

    values, x, y = field
    if driver != "GTiff":
        x, y = 1000.0 + 50 * np.arange(11), 2000.0 + 50 * np.arange(9)
    dx, dy = x[1] - x[0], y[1] - y[0]
    path = tmp_path / ("map.tif" if driver == "GTiff" else "map.grd")
    profile = {
        "height": 9,
        "width": 11,
        "count": 1,
        "dtype": "float32",
        "transform": from_origin(x[0] - dx / 2, y[-1] + dy / 2, dx, dy),
    }
    top_down = values[::-1].astype("f4")
    if driver == "GTiff":
        profile |= {"nodata": np.nan, "crs": "EPSG:4326"}
    else:
        top_down = np.where(np.isnan(top_down), np.float32(1.70141e38), top_down)
    if driver == "GTiff":
        with rasterio.open(path, "w", driver=driver, **profile) as out:
            out.write(top_down, 1)
    else:
        from rasterio.shutil import copy

        source = tmp_path / "source.tif"
        with rasterio.open(source, "w", driver="GTiff", **profile) as out:
            out.write(top_down, 1)
        copy(source, path, driver=driver)
    grid = geomag.read_grid(path) if driver == "GTiff" else geomag.read_grid(path, geographic=False)
    same(grid, values, x, y, rtol=1e-5)
    assert grid.geographic == (driver == "GTiff")


def test_oasis_montaj(tmp_path):
    pytest.importorskip("harmonica", reason="needs the extra 'survey'")
    values = np.arange(12.0).reshape(3, 4)
    header = struct.pack("<5i", 8, 2, 4, 3, 1) + struct.pack("<7d", 10.0, 10.0, 500.0, 700.0, 0.0, 0.0, 1.0)
    path = tmp_path / "map.grd"
    path.write_bytes(header.ljust(512, b"\0") + values.astype("<f8").tobytes())
    same(geomag.read_grid(path, geographic=False), values, 500 + 10 * np.arange(4), 700 + 10 * np.arange(3))


def test_xyz_text(tmp_path, field):
    values, x, y = field
    xx, yy = np.meshgrid(x, y)
    known = np.isfinite(values)
    rows = np.column_stack([xx[known], yy[known], values[known]])
    rows = np.random.default_rng(1).permutation(rows)
    named = tmp_path / "map.csv"
    named.write_text("longitude,latitude,anomaly\n" + "\n".join(",".join(f"{v:.6f}" for v in r) for r in rows))
    same(geomag.read_grid(named), values, x, y)
    bare = tmp_path / "map.xyz"
    bare.write_text("# made by hand\n" + "\n".join("  ".join(f"{v:.6f}" for v in r) for r in rows))
    with pytest.raises(geomag.InvalidInputError, match="degrees or metres"):
        geomag.read_grid(bare)
    same(geomag.read_grid(bare, geographic=True), values, x, y)
    scattered = tmp_path / "points.csv"
    points = np.random.default_rng(2).uniform(0, 1, (50, 3))
    scattered.write_text("x_m,y_m,value\n" + "\n".join(",".join(map(str, r)) for r in points))
    with pytest.raises(geomag.InvalidInputError, match="gridded first"):
        geomag.read_grid(scattered)


@pytest.mark.parametrize(
    "content", [b"", b"\x00\x01\x02" * 50, b"CDF\x01rubbish", b"\x89HDF\r\n\x1a\nxx", b"II*\x00zz", b"a,b\n1,2\n"]
)
def test_corrupt_files_are_refused(tmp_path, content):
    path = tmp_path / "broken"
    path.write_bytes(content)
    with pytest.raises(geomag.GeomagError, match="broken"):
        geomag.read_grid(path)


def test_missing_files_and_folders(tmp_path):
    for read in (geomag.read_grid, geomag.read_track):
        with pytest.raises(geomag.MissingFileError, match="nothing at") as caught:
            read(tmp_path / "none.nc")
        assert isinstance(caught.value, FileNotFoundError)
        with pytest.raises(geomag.ReadError, match="folder"):
            read(tmp_path)


def table(n=6):
    return pd.DataFrame(
        {
            "time": pd.date_range("2020-01-01", periods=n, freq="2s"),
            "Longitude": 140.5 + 0.01 * np.arange(n),
            "latitude": -22.0 + 0.01 * np.arange(n),
            "height_m": 300,
            "total_field_anomaly_nt": np.arange(n),
        }
    )


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "parquet", "txt"])
def test_tracks(tmp_path, kind):
    path = tmp_path / f"log.{kind}"
    frame = table()
    if kind == "parquet":
        pytest.importorskip("pyarrow", reason="needs the extra 'io'")
        frame.to_parquet(path)
    elif kind == "csv.gz":
        path.write_bytes(gzip.compress(frame.to_csv(index=False).encode()))
    elif kind == "txt":
        frame.drop(columns="time").to_csv(path, index=False, sep=" ")
    else:
        frame.to_csv(path, index=False)
    track = geomag.read_track(path)
    np.testing.assert_allclose(track.x, frame["Longitude"])
    np.testing.assert_allclose(track.values, frame["total_field_anomaly_nt"])
    if kind != "txt":
        np.testing.assert_allclose(track.time_s, 2.0 * np.arange(6))
    other = geomag.read_track(path, value="height_m")
    assert other.values[0] == 300


def test_bad_tracks(tmp_path):
    frame = table()
    frame.loc[3, "total_field_anomaly_nt"] = np.nan
    path = tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    with pytest.raises(geomag.InvalidInputError, match="data row 3"):
        geomag.read_track(path)
    assert len(geomag.read_track(path, missing="drop")) == 5
    with pytest.raises(geomag.UnknownVariableError, match="height_m"):
        geomag.read_track(path, value="nothing")
    with pytest.raises(geomag.InvalidInputError, match="missing"):
        geomag.read_track(path, missing="maybe")
    table().drop(columns="total_field_anomaly_nt").to_csv(path, index=False)
    with pytest.raises(geomag.UnknownVariableError, match="column for value"):
        geomag.read_track(path)
    text = table().astype({"Longitude": object})
    text.loc[2, "Longitude"] = "east"
    text.to_csv(path, index=False)
    with pytest.raises(geomag.InvalidInputError, match="column 'Longitude': needed numbers, got 'east' in line 4"):
        geomag.read_track(path)
    path.write_text("longitude,latitude,value\n")
    with pytest.raises(geomag.ReadError, match="at least one row"):
        geomag.read_track(path)


def test_the_shared_grids_read(data_file):
    grid = geomag.read_grid(data_file("osborne-aeromag/osborne_grid_from_shared_lines.nc"))
    assert grid.geographic
    assert grid.shape == (834, 666)
    assert grid.spacing == pytest.approx((0.0005, 0.0005))
    grid = geomag.read_grid(data_file("namad-kansas/namad_kansas.nc"))
    assert grid.shape == (100, 100)


@pytest.mark.parametrize("keep", [20, 60])
def test_a_torn_or_broken_compressed_table(tmp_path, keep):
    whole = gzip.compress(b"longitude,latitude,value\n" + b"1.25,2.5,3.75\n" * 500)
    for number, content in enumerate((whole[:keep], whole[:15] + b"\xff" * keep + whole[15 + keep :])):
        path = tmp_path / f"{number}.csv.gz"
        path.write_bytes(content)
        with pytest.raises(geomag.ReadError, match="needed a readable table"):
            geomag.read_track(path)
