"""What grid files say of themselves is believed; what they do not say is asked for."""

from __future__ import annotations

import numpy as np
import pytest

import geomag

xr = pytest.importorskip("xarray", reason="needs the extra 'io'")
netCDF4 = pytest.importorskip("netCDF4", reason="needs the extra 'io'")
rasterio = pytest.importorskip("rasterio", reason="needs the extra 'io'")

VALUES = np.arange(12.0).reshape(3, 4)
X, Y = np.array([8.0, 8.5, 9.0, 9.5]), np.array([44.0, 44.5, 45.0])
EAST, NORTH = {"units": "degrees_east"}, {"units": "degrees_north"}


def array(x_attributes, y_attributes, dims=("b", "a"), values=VALUES, x=X, y=Y, **attributes):
    coords = {dims[1]: (dims[1], x, x_attributes), dims[0]: (dims[0], y, y_attributes)}
    return xr.Dataset({"mag": (dims, values, attributes)}, coords=coords)


def read(tmp_path, dataset, **options):
    dataset.to_netcdf(tmp_path / "map.nc")
    return geomag.read_grid(tmp_path / "map.nc", **options)


@pytest.mark.parametrize(
    ("last", "first"),
    [
        ({"axis": "X", "units": "degrees"}, {"axis": "Y", "units": "degrees"}),
        ({"standard_name": "longitude"}, {"standard_name": "latitude"}),
        (EAST, NORTH),
        (EAST, {"units": "degrees"}),
        ({"long_name": "Longitude"}, {"long_name": "Latitude"}),
    ],
)
def test_axes_are_what_they_say(tmp_path, last, first):
    """Also where they stand the other way round than usual: the transpose is another map."""
    grid = read(tmp_path, array(last, first))
    assert (grid.shape, grid.geographic, grid.x[0], grid.y[0]) == ((3, 4), True, 8.0, 44.0)
    turned = read(tmp_path, array(first, last))
    assert (turned.shape, turned.x[0], turned.y[0]) == ((4, 3), 44.0, 8.0)
    np.testing.assert_array_equal(turned.values, VALUES.T)


@pytest.mark.parametrize(
    ("last", "first", "options", "words"),
    [
        ({}, {}, {"geographic": True}, "which of its dimensions"),
        ({"axis": "X"}, {"axis": "X"}, {"geographic": True}, "one dimension for x and one for y"),
        ({"standard_name": "latitude", "units": "degrees_east"}, {}, {}, "one meaning of coordinate 'a'"),
        ({"standard_name": "grid_longitude"}, {}, {}, "rotated coordinate"),
        (EAST, NORTH, {"geographic": False}, "needed geographic=True"),
        ({"units": "m", "axis": "X"}, {"units": "m"}, {"geographic": True}, "needed geographic=False"),
        ({"axis": "X"}, {"axis": "Y"}, {}, "geographic=True or geographic=False"),
        ({"axis": "X", "units": "degrees"}, {"units": "m"}, {}, "both in metres"),
        (EAST, NORTH, {"x": "c"}, "needed x= among b, a"),
    ],
)
def test_axes_that_do_not_say_or_contradict_are_refused_by_file(tmp_path, last, first, options, words):
    with pytest.raises(geomag.InvalidInputError, match=rf"map\.nc.*{words}"):
        read(tmp_path, array(last, first), **options)


def test_projected_axes_and_their_system(tmp_path):
    km = {"units": "km", "standard_name": "projection_x_coordinate"}
    dataset = array(km, {"units": "km", "standard_name": "projection_y_coordinate"}, grid_mapping="crs")
    dataset["crs"] = ((), 0, {"grid_mapping_name": "transverse_mercator", "longitude_of_central_meridian": 9.0, "latitude_of_projection_origin": 0.0,
                             "scale_factor_at_central_meridian": 0.9996, "false_easting": 500000.0, "false_northing": 0.0})  # fmt: skip
    grid = read(tmp_path, dataset)
    assert (grid.x[-1], grid.geographic) == (9500.0, False)
    assert rasterio.CRS.from_user_input(grid.crs).to_epsg() == 32632
    with pytest.raises(geomag.InvalidInputError, match="grid mapping 'crs'"):
        read(tmp_path, dataset.drop_vars("crs"))
    degrees = array(EAST, NORTH, grid_mapping="crs")
    degrees["crs"] = ((), 0, {"crs_wkt": rasterio.CRS.from_epsg(32632).to_wkt()})
    with pytest.raises(geomag.InvalidInputError, match="fit its coordinate reference system"):
        read(tmp_path, degrees)


def test_values_that_are_none(tmp_path):
    with pytest.warns(geomag.DataWarning, match="1 of 12 values are outside the valid range"):
        assert read(tmp_path, array(EAST, NORTH, valid_range=np.array([0.0, 10.0]))).holes == 1
    assert np.isnan(read(tmp_path, array(EAST, NORTH, missing_value=3.0)).sample(9.5, 44.0))
    packed = read(
        tmp_path,
        array(EAST, NORTH, values=VALUES.astype("i2"), scale_factor=0.5, add_offset=100.0, missing_value=np.int16(11)),
    )
    assert (packed.sample(9.0, 45.0), packed.holes) == (105.0, 1)
    with netCDF4.Dataset(tmp_path / "fill.nc", "w") as file:  # half of it never written
        for name, axis, attributes in (("lat", Y, NORTH), ("lon", X, EAST)):
            file.createDimension(name, len(axis))
            file.createVariable(name, "f8", (name,))[:] = axis
            file[name].setncatts(attributes)
        file.createVariable("mag", "f4", ("lat", "lon"))[:2] = VALUES[:2]
    assert geomag.read_grid(tmp_path / "fill.nc").holes == 4


def test_bounds_and_errors_are_no_fields(tmp_path):
    dataset = array(EAST | {"bounds": "edges"}, NORTH, ancillary_variables="mag_error")
    dataset["edges"] = (("a", "two"), np.column_stack([X - 0.25, X + 0.25]))
    dataset["mag_error"] = (("b", "a"), 0.5 + VALUES, {"standard_name": "magnetic_field standard_error"})
    grid = read(tmp_path, dataset)
    np.testing.assert_array_equal(grid.sigma, 0.5 + VALUES)


@pytest.mark.parametrize(
    "longitudes",
    [np.arange(0.0, 360, 2), np.arange(0.0, 361, 2), np.arange(-180.0, 180, 2), np.arange(-180.0, 181, 2), np.arange(1.0, 360, 2), np.arange(358.0, -1, -2)],
    ids=["0-358", "0-360", "-180-178", "-180-180", "pixels", "falling"],
)  # fmt: skip
def test_a_map_of_the_whole_circle_is_closed(tmp_path, longitudes):
    """Searches cross its seam wherever that lies, and take it for what it is."""
    values = (
        50 * np.cos(np.radians(longitudes))[None, :]
        + Y[:, None]
        - 44.5
        + 30 * np.sin(np.radians(40 * longitudes))[None, :]
    )
    grid = read(tmp_path, array(EAST, NORTH, values=values, x=longitudes))
    for seam in (0.0, 180.0):
        at = seam + np.arange(-9.5, 9.6, 0.5)
        found = grid.sample(at, 44.5)
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found, grid.sample(at + 360.0, 44.5))
    inner = array(EAST, NORTH, values=values[:, 1:-2], x=longitudes[1:-2])
    assert np.isnan(read(tmp_path, inner).sample(np.mean(longitudes[[0, -1]]) + 180.0, 44.5))


def test_a_search_crosses_the_seam(tmp_path):
    longitudes = np.arange(0.0, 360, 0.5)
    latitudes = np.arange(40.0, 50.1, 0.5)
    rng = np.random.default_rng(1)
    grid = read(
        tmp_path,
        array(EAST, NORTH, values=rng.normal(0, 50, (len(latitudes), len(longitudes))), x=longitudes, y=latitudes),
    )
    k = np.arange(30.0)
    x, y = (356.0 + 0.3 * k) % 360.0, 42.0 + 0.17 * k
    track = geomag.Track((x - 1.2) % 360.0, y + 0.7, grid.sample(x, y), geographic=True)
    fix = geomag.match_grid(grid, track, half_width=(2.0, 2.0), criterion="msd")
    assert fix.ok
    assert fix.offset == pytest.approx((1.2, -0.7), abs=0.05)  # a tenth of a cell


def old_gmt(path, units=("longitude", "latitude"), pixel=0):
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.createDimension("side", 2)
        file.createDimension("xysize", 12)
        for name, values, unit in (
            ("x_range", (10.0, 13.0), units[0]),
            ("y_range", (40.0, 42.0), units[1]),
            ("z_range", (0.0, 11.0), "nT"),
            ("spacing", (1.0, 1.0), ""),
        ):
            file.createVariable(name, "f8", ("side",))[:] = values
            file[name].units = unit
        file.createVariable("dimension", "i4", ("side",))[:] = (4, 3)
        z = file.createVariable("z", "f4", ("xysize",))
        z[:] = np.arange(12)
        z.node_offset = np.int32(pixel)
    return path


def test_old_grids_of_gmt(tmp_path):
    grid = geomag.read_grid(old_gmt(tmp_path / "old.grd"))
    assert (grid.geographic, grid.x.tolist(), grid.y.tolist()) == (True, [10, 11, 12, 13], [40, 41, 42])
    assert (grid.sample(10, 42), grid.sample(13, 40)) == (0.0, 11.0)  # rows come from the north
    pixels = geomag.read_grid(old_gmt(tmp_path / "pixels.grd", pixel=1))
    np.testing.assert_allclose(pixels.x, 10.375 + 0.75 * np.arange(4))
    with pytest.raises(geomag.InvalidInputError, match="geographic=True or geographic=False"):
        geomag.read_grid(old_gmt(tmp_path / "user.grd", ("user_x_unit", "user_y_unit")))


GXF = "#POINTS\n5\n#ROWS\n4\n#PTSEPARATION\n100\n#RWSEPARATION\n50\n#XORIGIN\n1000\n#YORIGIN\n2000\n"
BODY = "#GRID\n" + " ".join(map(str, range(20))) + "\n"


def gxf(tmp_path, header, body=BODY, **options):
    (tmp_path / "map.gxf").write_text(GXF + header + body)
    return geomag.read_grid(tmp_path / "map.gxf", **options)


#: By the sense: value at the lower left corner, at the next node to the east and at the next to the north.
SENSES = {
    1: (0, 1, 5),
    -1: (0, 5, 1),
    2: (4, 9, 3),
    -2: (15, 16, 10),
    3: (19, 18, 14),
    -3: (19, 14, 18),
    4: (15, 10, 16),
    -4: (4, 3, 9),
}


@pytest.mark.parametrize("sense", SENSES)
def test_senses_of_gxf(tmp_path, sense):
    grid = gxf(tmp_path, f"#SENSE\n{sense}\n", geographic=False)
    along_x = sense in (1, -2, 3, -4)
    dx, dy = (100, 50) if along_x else (50, 100)
    assert (grid.spacing, grid.x[0], grid.y[0]) == ((dx, dy), 1000, 2000)
    assert (grid.sample(1000, 2000), grid.sample(1000 + dx, 2000), grid.sample(1000, 2000 + dy)) == SENSES[sense]


def test_gxf_says_and_is_checked(tmp_path):
    feet = gxf(tmp_path, '#UNIT_LENGTH\n"ft",0.3048\n#TRANSFORM\n0.5,100\n#DUMMY\n3\n')
    assert (feet.geographic, feet.holes, feet.x[0]) == (False, 1, pytest.approx(304.8))
    assert feet.sample(feet.x[1], feet.y[0]) == 100.5
    degrees = GXF.replace("1000", "10").replace("2000", "20").replace("100", "1").replace("50", "1")
    (tmp_path / "map.gxf").write_text(degrees + "#MAP_PROJECTION\nWGS 84\nGeographic\n" + BODY)
    assert geomag.read_grid(tmp_path / "map.gxf").geographic
    for header, body, words in (
        ("#ZMAXIMUM\n500\n", BODY, "#ZMAX"),
        ("", "#GRID\n1 2 3\n", "20 values"),
        ("#GTYPE\n2\n", "#GRID\n%4%5\n", "20 values"),
        ("#ROTATION\n-12\n", BODY, "rotated by -12"),
        ("", BODY, "geographic=True or geographic=False"),
    ):
        with pytest.raises(geomag.GeomagError, match=rf"map\.gxf.*{words}"):
            gxf(tmp_path, header, body)
    repeated = gxf(tmp_path, "#GTYPE\n1\n", '#GRID\n"9(\n', geographic=False)
    assert set(repeated.values.ravel()) == {3.0}


def test_esri_and_icgem(tmp_path):
    (tmp_path / "map.asc").write_text("NCOLS 3\nNROWS 2\nXLLCENTER 10\nYLLCENTER 20\nCELLSIZE 5\n1 2 3\n4 5 -9999\n")
    with pytest.raises(geomag.InvalidInputError, match=r"\.prj"):
        geomag.read_grid(tmp_path / "map.asc")
    grid = geomag.read_grid(tmp_path / "map.asc", geographic=False)
    assert (grid.x.tolist(), grid.y.tolist(), grid.sample(10, 25), grid.holes) == ([10, 15, 20], [20, 25], 1.0, 1)
    (tmp_path / "map.prj").write_text(rasterio.CRS.from_epsg(2263).to_wkt())
    assert geomag.read_grid(tmp_path / "map.asc").x[0] == pytest.approx(10 * 1200 / 3937)
    head = "functional gravity_disturbance\nunit mgal\nlongitude_parallels 3\nlatitude_parallels 2\ngapvalue 99999.0\nlongitude latitude gravity_disturbance\n[deg.] [deg.] [mgal]\nend_of_head ====\n"
    rows = "10 46 1\n11 46 2\n12 46 99999.0\n10 45 4\n11 45 5\n12 45 6\n"
    (tmp_path / "map.gdf").write_text(head + rows)
    grid = geomag.read_grid(tmp_path / "map.gdf")
    assert (grid.geographic, grid.units, grid.name, grid.holes, grid.sample(10, 46)) == (
        True,
        "mGal",
        "gravity_disturbance",
        1,
        1.0,
    )
    (tmp_path / "map.gdf").write_text(head.replace("parallels 3", "parallels 4") + rows)
    with pytest.raises(geomag.ReadError, match="needed 4 longitude_parallels"):
        geomag.read_grid(tmp_path / "map.gdf")


def test_ermapper(tmp_path):
    profile = {"driver": "ERS", "height": 3, "width": 4, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
    with rasterio.open(
        tmp_path / "map.ers", "w", transform=rasterio.transform.from_origin(5e5, 5e6, 100, 100), **profile
    ) as out:
        out.write(VALUES.astype("f4"), 1)
    grid = geomag.read_grid(tmp_path / "map.ers")
    assert (grid.geographic, grid.x[0], grid.y[-1], grid.sample(500_050, 4_999_950)) == (False, 500_050, 4_999_950, 0.0)


def test_a_raster_is_not_told_otherwise(tmp_path):
    profile = {"driver": "GTiff", "height": 3, "width": 4, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
    with rasterio.open(
        tmp_path / "map.tif", "w", transform=rasterio.transform.from_origin(5e5, 5e6, 100, 100), **profile
    ) as out:
        out.write(np.where(VALUES == 5, -99999, VALUES).astype("f4"), 1)
    with pytest.raises(geomag.InvalidInputError, match="needed geographic=False"):
        geomag.read_grid(tmp_path / "map.tif", geographic=True)
    with pytest.warns(geomag.DataWarning, match="1 of 12 values are dummies"):
        assert geomag.read_grid(tmp_path / "map.tif", geographic=False).holes == 1
    with rasterio.open(
        tmp_path / "turned.tif", "w", transform=rasterio.Affine(80, 60, 5e5, 60, -80, 5e6), **profile
    ) as out:
        out.write(VALUES.astype("f4"), 1)
    with pytest.raises(geomag.InvalidInputError, match="rotated raster"):
        geomag.read_grid(tmp_path / "turned.tif")


@pytest.mark.parametrize("names", ["lon,lat,mag_nT", "LAT,LON,TMI", "easting,northing,z"])
def test_tables_of_nodes(tmp_path, names):
    first = names.lower().split(",")[0]
    rows = [(x, y, 10 * x + y) for y in (1, 2, 3) for x in (5, 6)]
    lines = [f"{y},{x},{v}" if first == "lat" else f"{x},{y},{v}" for x, y, v in rows]
    (tmp_path / "map.csv").write_text(names + "\n" + "\n".join(lines))
    grid = geomag.read_grid(tmp_path / "map.csv")
    assert (grid.shape, grid.sample(6, 3), grid.geographic) == ((3, 2), 63.0, first != "easting")


def test_tables_that_do_not_say(tmp_path):
    for text, words in (
        ("a,b,c\n1,2,3\n", "columns="),
        ("1 2 3 4\n5 6 7 8\n", "4 columns"),
        ("x,y,mag\n1,1,1\n2,1,1\n1,2,1\n2,2,1\n", "geographic="),
    ):
        (tmp_path / "map.txt").write_text(text)
        with pytest.raises(geomag.GeomagError, match=words):
            geomag.read_grid(tmp_path / "map.txt")
