"""Small files of the kinds in tests/cases with other details: each gives the value that is known to be right, or a refusal that says why.

The files are written here, so that what is right stands beside what is read.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import geomag
from geomag.stream import read_csv, read_nmea
from geomag.survey import read_lines

for module in ("xarray", "netCDF4", "rasterio"):
    pytest.importorskip(module, reason="needs the extra 'io'")

import rasterio  # noqa: E402 - after the question whether it is there
import xarray as xr  # noqa: E402

PLAIN = (10.0, 45.0, 30.0, [0.0, 1.0, 2.0])


def rows(header, *lines):
    return "\n".join((header, *lines)) + "\n"


def log(header, separator=",", times=("0", "1", "2"), first="10", latitude="45", value="30"):
    """Three samples eastwards: time, longitude, latitude, value."""
    return rows(
        header,
        *(separator.join((t, f"{first}.0{k}", f"{latitude}.00", f"{value}.0")) for k, t in enumerate(times)),
    )


HEAD = "time,lon,lat,value"
#: Text, and first x, y, value and all times, or the words of the refusal.
LOGS = {
    "decimal comma, tabs, UTF-16": (log("time_s\tlongitude\tlatitude\tvalue", "\t").replace(".", ",").encode("utf-16"), PLAIN),
    "UTF-16 without its mark": (log("time_s\tlongitude\tlatitude\tvalue", "\t").encode("utf-16-be"), PLAIN),
    "Windows-1252 in a name": (log("time,lon,lat,value").replace("value", "value (µT)").encode("cp1252"), (10, 45, 30e3, PLAIN[3])),
    "bars": (log(HEAD.replace(",", "|"), "|"), PLAIN),
    "columns of blanks": ("  time     lon     lat   value\n   0.0   10.00   45.00   30.0\n   1.0   10.01   45.00   30.0\n   2.0   10.02   45.00   30.0\n", PLAIN),
    "names in a comment": (log("# time lon lat value", " "), PLAIN),
    "names behind a hash": (log("#" + HEAD), PLAIN),
    "comments of MATLAB": ("% made by X\n% more\n" + log(HEAD), PLAIN),
    "Excel's sep=": ("sep=;\n" + log(HEAD.replace(",", ";"), ";"), PLAIN),
    "a title": ("My flight of June\n\n" + log(HEAD), PLAIN),
    "a title of several lines": ("Survey: A, 2026\nPilot: B\n" + log(HEAD), PLAIN),
    "line ends of old Macs": (log(HEAD).replace("\n", "\r"), PLAIN),
    "a row of units": (log(HEAD + "\ns,deg,deg,nT"), PLAIN),
    "a row of units in brackets": (log(HEAD + "\n[s],[deg],[deg],[nT]"), PLAIN),
    "a row of other units": (rows("time,easting,northing,mag", "ms,km,km,uT", "0,500.1,5100.2,48.1", "1000,500.2,5100.3,48.2", "2000,500.3,5100.4,48.3"), (500100, 5100200, 48100, PLAIN[3])),
    "units in the names": (log("Time (ms),Lon (deg),Lat (deg),TMI (nT)", times=("0", "1000", "2000")), PLAIN),
    "commas in quoted names": (log('"time","Lon, deg","Lat, deg","TMI, nT"'), PLAIN),
    "feet": (rows("time_s,x_ft,y_ft,mag_nT", "0,1000,2000,30", "1,1010,2000,31", "2,1020,2000,32"), (304.8, 609.6, 30, PLAIN[3])),
    "survey feet": (rows("time_s,Easting (US survey feet),Northing (US survey feet),mag_nT", "0,3937,7874,30", "1,3950,7874,31", "2,3960,7874,32"), (1200, 2400, 30, PLAIN[3])),
    "milligauss": (log("time,lon,lat,mag (mG)"), (10, 45, 3000, PLAIN[3])),
    "gauss": (log("time,lon,lat,mag_G"), (10, 45, 3e6, PLAIN[3])),
    "gammas": (log("time,lon,lat,mag_gamma"), PLAIN),
    "m/s2": (log("time,lon,lat,gravity (m/s2)"), (10, 45, 3e6, PLAIN[3])),
    "hemispheres": (rows(HEAD, "0,10.5W,45.2S,30", "1,10.51W,45.2S,31", "2,10.52W,45.2S,31"), (-10.5, -45.2, 30, PLAIN[3])),
    "nanoseconds since 1970": (log("timestamp,lon,lat,value", times=[f"{1_700_000_000 + k}000000000" for k in range(3)]), PLAIN),
    "milliseconds since 1970": (log("timestamp,lon,lat,value", times=[f"{1_700_000_000 + k}000" for k in range(3)]), PLAIN),
    "microseconds by their name": (log("TimeUS,Lng,Lat,Mag", times=("5000000", "6000000", "7000000")), PLAIN),
    "milliseconds without a name": (rows(HEAD, "5000,10,45,30", "6000,10.0001,45,31", "7000,10.0002,45,31"), "time_unit="),
    "hhmmss over midnight": (log("hhmmss,lon,lat,value", times=("235958", "235959", "000000")), PLAIN),
    "hhmmss without its name": (rows("utc,lon,lat,value", "115958,10,45,30", "115959,10.0001,45,31", "120000,10.0002,45,31", "120001,10.0003,45,31"), "hhmmss"),
    "a date beside the time": (rows("date,time,lon,lat,value", "2026-01-05,23:59:59,10,45,30", "2026-01-06,00:00:00,10.01,45,31", "2026-01-06,00:00:01,10.02,45,31"), PLAIN),
    "a date day first beside the time": (rows("Date,Time,lon,lat,value", "13/01/2026,23:59:59,10,45,30", "14/01/2026,00:00:00,10.01,45,31", "14/01/2026,00:00:01,10.02,45,31"), PLAIN),
    "zones": (log(HEAD, times=("2026-06-01T12:00:00+02:00", "2026-06-01T10:00:01Z", "2026-06-01T10:00:02+00:00")), PLAIN),
    "days of Excel": (rows(HEAD, "46023.500000000,10,45,30", "46023.500011574,10.001,45,31", "46023.500023148,10.002,45,31"), "time_unit="),
    "dates of two readings": (log(HEAD, times=("05/06/2026 10:00:00", "06/06/2026 10:00:01", "07/06/2026 10:00:02")), "one way"),
    "dummies": (rows("time,lon,lat,mag", "0,10,45,48000", "1,10.01,45.01,-99999", "2,10.02,45.02,48010", "3,10.03,45.03,1e32", "4,10.04,45.04,48012"), (10, 45, 48000, [0, 2, 4])),
    "blank rows": (log(HEAD).replace("\n1,", "\n\n,,,\n1,"), PLAIN),
    "a number of the row": (rows(",time,lon,lat,value", "0,0,10,45,30", "1,1,10.01,45,31", "2,2,10.02,45,32"), PLAIN),
    "a height called z": (rows("time,lon,lat,z,mag", "0,10,45,500,30", "1,10.01,45,501,31", "2,10.02,45,502,32"), PLAIN),
    "nothing but z": (rows("time,lon,lat,z", "0,10,45,500", "1,10.01,45,501"), "value="),
    "two magnetometers": (rows("time,lon,lat,mag1_nT,mag2_nT", "0,10,45,30,40", "1,10.01,45,31,41"), "mag1_nT, mag2_nT"),
    "two systems": (rows("time,lon,lat,easting,northing,TMI", "0,10,45,500000,5100000,30", "1,10.01,45,500000,5100000,31"), "lon, easting"),
    "degrees times 1e7": (rows(HEAD, "0,100000000,450000000,30", "1,100100000,450000000,31"), "1e7"),
    "degrees and minutes": (rows(HEAD, "0,10 30.5,45 12.25,30", "1,10 31.5,45 12.3,31"), "readable table"),
    "thousands": (rows("time;x;y;value", "0;500.100,5;5.100.200,5;48.000,5", "1;500.101,5;5.100.200,5;48.000,5"), "readable table"),
    "radians": (log("time,lon_rad,lat_rad,value"), "needed degrees"),
    "no header": (rows("45,10,30", "45.01,10.01,31"), "x="),
    "units that say north": (rows("time,x (deg N),y (deg E),value", "0,45,10,30", "1,45,10.01,31", "2,45,10.02,32"), PLAIN),
    "units against names": (rows("time,lon (deg N),lat (deg E),value", "0,45,10,30", "1,45,10.01,31"), "one kind of coordinate"),
    "degrees to the west": (rows("time,Lon (deg W),Lat (deg N),value", "0,10,45,30", "1,10.01,45,31"), "to the east"),
    "a time by its unit": (log("Sample time [s],Longitude WGS84 [deg],Latitude WGS84 [deg],Total field [nT]"), PLAIN),
    "dates with dots": (log(HEAD, times=("05.01.2026 23:59:58", "05.01.2026 23:59:59", "06.01.2026 00:00:00")), PLAIN),
    "month first, with AM and PM": (log(HEAD, times=("01/31/2026 11:59:58 PM", "01/31/2026 11:59:59 PM", "02/01/2026 12:00:00 AM")), PLAIN),
    "months by name": (log(HEAD, times=("05-Jan-2026 23:59:58", "05-Jan-2026 23:59:59", "06-Jan-2026 00:00:00")), PLAIN),
    "days of the year": (log(HEAD, times=("2026-152T10:00:00", "2026-152T10:00:01", "2026-152T10:00:02")), PLAIN),
    "decimal comma in times": (log(HEAD.replace(",", ";"), ";", times=("23:59:58,5", "23:59:59,5", "00:00:00,5")).replace(".0", ",0"), PLAIN),
    "seconds of the day over midnight": (log(HEAD, times=("86398", "86399", "0")), PLAIN),
    "exponents of Fortran": (rows(HEAD, "0,1.0D+01,4.5D+01,3.0D+01", "1,1.001D+01,4.5D+01,3.1D+01", "2,1.002D+01,4.5D+01,3.2D+01"), PLAIN),
    "components without a strength": (rows("time,lon,lat,Bx,By,Bz", "0,10,45,20000,100,43000"), "value="),
    "a total field and a residual": (rows("time,lon,lat,tmi_nT,residual_nT", "0,10,45,48000,30"), "tmi_nT, residual_nT"),
    "a model beside the reading": (rows("time,lon,lat,igrf_nT,tmi_nT", "0,10,45,48000,30", "1,10.01,45,48000,31", "2,10.02,45,48000,32"), PLAIN),
    "two separators at the end": (log(HEAD).replace("\n", ",,\n").replace(HEAD + ",,", HEAD), PLAIN),
    "half a quoted number": (log(HEAD).replace("1,10.01", '1,"10".01'), "numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.filterwarnings("ignore::geomag.DataWarning")
def test_a_log(tmp_path, name):
    data, right = LOGS[name]
    path = tmp_path / "log.csv"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    if isinstance(right, str):
        with pytest.raises(geomag.GeomagError, match=right):
            geomag.read_track(path, missing="drop")
        return
    track = geomag.read_track(path, missing="drop")
    assert (track.x[0], track.y[0], track.values[0]) == pytest.approx(right[:3])
    np.testing.assert_allclose(track.time_s - track.time_s[0], right[3], atol=1e-6)


LON, LAT = np.array([10.0, 10.5, 11.0, 11.5]), np.array([45.0, 45.5, 46.0])
VALUES = 1.0 + np.arange(12.0).reshape(3, 4)
CORNERS = [(10, 45, 1), (11.5, 45, 4), (10, 46, 9), (11, 45.5, 7)]


def netcdf(
    values=VALUES,
    x=LON,
    y=LAT,
    dims=("lat", "lon"),
    units=("degrees_north", "degrees_east"),
    field=None,
    change=None,
    **how,
):
    """A map of one variable whose dimensions are told by their units."""

    def write(path):
        axes = {d: x if "on" in d or d == "x" else y for d in dims}
        dataset = xr.Dataset({"mag": (dims, values, field or {})}, coords=axes)
        for d, unit in zip(dims, units if dims[0] in ("lat", "y") else units[::-1], strict=True):
            dataset[d].attrs["units"] = unit
        (change(dataset) if change else dataset).to_netcdf(path, **how)

    return write


def circle(x):
    return 50.0 * np.cos(np.radians(x))[None, :] + LAT[:, None]


def hole(value):
    return np.where(VALUES == 7, value, VALUES)


HOLED = [(10, 45, 1), (11, 45.5, np.nan)]
METRES = {"dims": ("y", "x"), "units": ("m", "m")}
GRIDS = {
    "rows fall": (netcdf(VALUES[::-1], y=LAT[::-1]), CORNERS),
    "columns fall": (netcdf(VALUES[:, ::-1], x=LON[::-1]), CORNERS),
    "longitude first": (netcdf(VALUES.T, dims=("lon", "lat")), CORNERS),
    "packed": (netcdf(encoding={"mag": {"dtype": "i2", "scale_factor": 0.1, "add_offset": 5.0, "_FillValue": -32768}}), CORNERS),
    "packed in bytes with a hole": (netcdf(hole(np.nan), encoding={"mag": {"dtype": "u1", "scale_factor": 0.5, "_FillValue": 255}}), HOLED),
    "missing value": (netcdf(hole(-999.0), field={"missing_value": -999.0}), HOLED),
    "two that are missing": (netcdf(np.where(VALUES == 1, np.nan, hole(-888.0)), field={"missing_value": -888.0}), [(10, 45, np.nan), HOLED[1]]),
    "valid range": (netcdf(field={"valid_min": 2.0, "valid_max": 11.0}), [(10, 45, np.nan), (11.5, 46, np.nan), (11, 45.5, 7)]),
    "one time": (netcdf(change=lambda d: d.expand_dims(time=[0.0])), CORNERS),
    "two times": (netcdf(change=lambda d: xr.concat([d, d + 1], "time")), "two dimensions"),
    "bounds": (netcdf(change=lambda d: d.assign(lon_bnds=(("lon", "nv"), np.stack([LON - 0.25, LON + 0.25], 1))).assign_coords(lon=d.lon.assign_attrs(bounds="lon_bnds"))), CORNERS),
    "pixels of GMT": (netcdf(change=lambda d: d.assign_attrs(node_offset=1)), CORNERS),
    "degrees with axes": (netcdf(units=("degree", "degree")), CORNERS),
    "kilometres": (netcdf(dims=("y", "x"), units=("km", "km")), [(10_000, 45_000, 1), (11_500, 46_000, 12)]),
    "thousands of metres": (netcdf(dims=("y", "x"), units=("1000 m", "1000 m")), "1000 m"),
    "no units": (netcdf(dims=("y", "x"), units=("", "")), "geographic="),
    "microtesla": (netcdf(field={"units": "uT"}), [(10, 45, 1000)]),
    "tesla": (netcdf(VALUES * 1e-9, field={"units": "T"}), [(10, 45, 1)]),
    "whole numbers": (netcdf(VALUES.astype("i4")), CORNERS),
    "uneven": (netcdf(x=np.array([10.0, 10.5, 11.0, 12.0])), "evenly spaced"),
    "axes in float32": (netcdf(np.arange(81 * 41.0).reshape(41, 81), x=np.linspace(10, 14, 81, dtype="f4"), y=np.linspace(45, 47, 41, dtype="f4")), [(14, 47, 81 * 41 - 1)]),
    "circle 0 to 360": (netcdf(circle(np.arange(0, 361, 5.0)), x=np.arange(0, 361, 5.0)), [(355, 45, 45 + 50 * np.cos(np.radians(5))), (-5, 45, 45 + 50 * np.cos(np.radians(5)))]),
    "circle of pixels": (netcdf(circle(np.arange(2.5, 360, 5.0)), x=np.arange(2.5, 360, 5.0)), [(0, 45, 45 + 50 * np.cos(np.radians(2.5)))]),
    "circle from -180": (netcdf(circle(np.arange(-180, 180, 5.0)), x=np.arange(-180, 180, 5.0)), [(177.5, 45, 45 + 25 * (np.cos(np.radians(175)) - 1))]),
    "two fields": (netcdf(change=lambda d: d.assign(other=2 * d.mag)), "mag, other"),
    "classic": (netcdf(format="NETCDF3_CLASSIC"), CORNERS),
    "classic of 64 bits": (netcdf(format="NETCDF3_64BIT"), CORNERS),
    "UTM by its mapping": (netcdf(x=5e5 + 100 * LON, y=5e6 + 100 * LAT, **METRES, field={"grid_mapping": "crs"}, change=lambda d: d.assign(crs=((), 0, {"crs_wkt": rasterio.CRS.from_epsg(32633).to_wkt()}))), [(501_000, 5_004_500, 1)]),
    "degrees by its mapping, metres by its units": (netcdf(**METRES, field={"grid_mapping": "crs"}, change=lambda d: d.assign(crs=((), 0, {"grid_mapping_name": "latitude_longitude"}))), "fit its coordinate reference system"),
}  # fmt: skip


def tiff(
    driver="GTiff",
    crs="EPSG:32633",
    kind="float32",
    point=False,
    origin=(5e5, 5.1e6, 100.0),
    values=VALUES[::-1],
    scale=None,
    **more,
):
    def write(path):
        transform = rasterio.transform.from_origin(*origin[:2], origin[2], origin[2])
        with rasterio.open(
            path,
            "w",
            driver=driver,
            height=3,
            width=4,
            count=1,
            dtype=kind,
            crs=crs,
            transform=more.pop("transform", transform),
            **more,
        ) as out:
            out.write(values.astype(kind), 1)
            if point:
                out.update_tags(AREA_OR_POINT="Point")
            if scale:
                out.scales, out.offsets = (scale[:1], scale[1:])

    return write


LOWEST = [(500_050, 5_099_750, 1), (500_350, 5_099_950, 12)]
RASTERS = {
    "areas.tif": (tiff(), {}, LOWEST),
    "points.tif": (tiff(point=True), {}, LOWEST),
    "nodata.tif": (tiff(values=hole(-9999.0)[::-1], nodata=-9999.0), {}, [(500_250, 5_099_850, np.nan)]),
    "scaled.tif": (tiff(kind="int16", scale=(0.5, 10.0)), {}, [(500_050, 5_099_750, 10.5)]),
    "degrees.tif": (tiff(crs="EPSG:4326", origin=(10, 46, 0.01)), {}, [(10.005, 45.975, 1)]),
    "feet.tif": (tiff(crs="EPSG:2263", origin=(1e6, 2e5, 100)), {}, [(1_000_050 * 1200 / 3937, 199_750 * 1200 / 3937, 1)]),
    "upwards.tif": (tiff(values=VALUES, transform=rasterio.Affine(100, 0, 5e5, 0, 100, 5.1e6)), {}, [(500_050, 5_100_050, 1)]),
    "without a system.tif": (tiff(crs=None), {}, "geographic="),
    "told.tif": (tiff(crs=None), {"geographic": False}, LOWEST),
    "six.grd": (tiff("GSBG", crs=None), {"geographic": False}, LOWEST),
    "seven.grd": (tiff("GS7BG", crs=None, kind="float64"), {"geographic": False}, LOWEST),
    "map.ers": (tiff("ERS"), {}, LOWEST),
}  # fmt: skip

ESRI = "ncols 4\nnrows 3\n{}NODATA_value -9999\n9 10 11 12\n5 6 7 8\n1 2 3 4\n"
FROM_CORNER = "xllcorner 0\nyllcorner 0\ncellsize 10\n"
GXF = "notes\n#TITLE\nT\n#POINTS\n4\n#ROWS\n3\n#PTSEPARATION\n100\n#RWSEPARATION\n200\n#XORIGIN\n1000\n#YORIGIN\n2000\n{}#GRID\n1 2 3 4\n5 6 7 8\n9 10 11 12\n"
GDF = ("modelname X\nfunctional gravity\nunit mgal\nlatitude_parallels 2\nlongitude_parallels 3\ngapvalue 99999.0\n\nlongitude latitude {}gravity\n"
       "[deg.] [deg.] [mgal]\nend_of_head ===\n")  # fmt: skip
NODES = [(10 + k, 45 + m, k + 10 * m) for m in range(3) for k in range(4)]
FLAT = {"geographic": False}
TEXTS = {
    "corner.asc": (ESRI.format(FROM_CORNER), FLAT, [(5, 5, 1), (35, 25, 12)]),
    "centre.asc": (ESRI.format("xllcenter 0\nyllcenter 0\ncellsize 10\n"), FLAT, [(0, 0, 1), (30, 20, 12)]),
    "two sizes.asc": (ESRI.format("xllcorner 0\nyllcorner 0\ndx 10\ndy 20\n"), FLAT, [(5, 10, 1), (35, 50, 12)]),
    "capitals.asc": (ESRI.format(FROM_CORNER).upper().replace("-9999", "7"), FLAT, [(5, 5, 1), (25, 15, np.nan)]),
    "commas.asc": (ESRI.format(FROM_CORNER.replace("cellsize 10", "cellsize 10,5")).replace(" 7 ", " 7,5 "), FLAT, [(5.25, 5.25, 1), (26.25, 15.75, 7.5)]),
    "asked.asc": (ESRI.format(FROM_CORNER), {}, r"\.prj"),
    "surfer.grd": ("DSAA\n4 3\n0 30\n0 20\n1 12\n1 2 3 4\n5 6 1.70141e+038 8\n9 10 11\n12\n", FLAT, [(0, 0, 1), (20, 10, np.nan), (30, 20, 12)]),
    "asked.grd": ("DSAA\n4 3\n0 30\n0 20\n1 12\n1 2 3 4\n5 6 7 8\n9 10 11 12\n", {}, "geographic="),
    "short.grd": ("DSAA\n4 3\n0 30\n0 20\n1 12\n1 2 3 4\n5 6 7 8\n9 10 11\n", FLAT, "needed 12 values, got 11"),
    "plain.gxf": (GXF.format(""), FLAT, [(1000, 2000, 1), (1300, 2400, 12)]),
    "dummy.gxf": (GXF.format("#DUMMY\n7\n"), FLAT, [(1200, 2200, np.nan)]),
    "star.gxf": (GXF.format("").replace("7", "*"), FLAT, [(1200, 2200, np.nan)]),
    "moved.gxf": (GXF.format("#DUMMY\n7\n#TRANSFORM\n2 10\n"), FLAT, [(1000, 2000, 12), (1200, 2200, np.nan)]),
    "feet.gxf": (GXF.format("#UNIT_LENGTH\nft,0.3048\n"), {}, [(304.8, 609.6, 1)]),
    "kilometres.gxf": (GXF.format("#UNIT_LENGTH\nkm,1000\n"), {}, [(1e6, 2e6, 1)]),
    "degrees.gxf": (GXF.format("#UNIT_LENGTH\ndega,0.0174532925199433\n").replace("000", "").replace("00", ""), {}, [(1, 2, 1)]),
    "turned.gxf": (GXF.format("#ROTATION\n90\n"), FLAT, "rotated by 90"),
    "datum.gxf": (GXF.format('#MAP_PROJECTION\n"WGS 84"\n"WGS 84",6378137,0.0818191908,0\n"Geographic"\n#MAP_DATUM_TRANSFORM\n"WGS 84",0,0,0\n').replace("000", "").replace("00", ""), {}, [(1, 2, 1)]),
    "twice.gxf": (GXF.format("#TRANSFORM\n2 10\n#TRANSFORM\n3 10\n"), FLAT, "TRAN' once"),
    "underscored.gxf": (GXF.format("").replace("10 11", "1_0 11"), FLAT, "numbers in the grid"),
    "plain.gdf": (GDF.format("") + "10 46 1\n11 46 2\n12 46 99999.0\n10 45 4\n11 45 5\n12 45 6\n", {}, [(10, 46, 1), (12, 45, 6), (12, 46, np.nan)]),
    "heights.gdf": (GDF.format("h_over_geoid ") + "10 46 9 1\n11 46 9 2\n12 46 9 3\n10 45 9 4\n11 45 9 5\n12 45 9 6\n", {}, [(10, 46, 1), (12, 45, 6)]),
    "si.gdf": (GDF.format("").replace("mgal", "m/s**2") + "10 46 1e-5\n11 46 2e-5\n12 46 3e-5\n10 45 4e-5\n11 45 5e-5\n12 45 6e-5\n", {}, [(10, 46, 1)]),
    "gap.gdf": (GDF.format("").replace("99999.0", "none of them") + "10 46 1\n11 46 2\n12 46 3\n10 45 4\n11 45 5\n12 45 6\n", {}, "gapvalue"),
    "emag2.csv": ("".join(f"{x},{y},{v},1\n" for x, y, v in NODES), {}, "4 columns"),
    "emag2 told.csv": ("".join(f"{x},{y},{v},1\n" for x, y, v in NODES), {"columns": (0, 1, 2), "geographic": True}, [(13, 47, 23)]),
    "wdmam.xyz": ("".join(f"{x:8.3f}{y:8.3f}{v:9.2f}\n" for x, y, v in NODES), {"geographic": True}, [(13, 47, 23)]),
    "latitude first.csv": ("Latitude;Longitude;Mag (nT)\n" + "".join(f"{y},0;{x},0;{v},25\n" for x, y, v in NODES), {}, [(13, 47, 23.25)]),
    "geosoft.xyz": ("/ X Y TMI\nLINE 0\n" + "".join(f"{x} {y} {'*' if v == 2 else v}\n" for x, y, v in NODES), FLAT, [(10, 45, 0), (12, 45, np.nan)]),
    "twice.csv": ("x_m,y_m,value\n0,0,1\n100,0,2\n0,100,3\n100,100,4\n100,100,5\n", {}, "one value a node"),
}  # fmt: skip
ALL = {f"{k}.nc": (make, {}, right) for k, (make, right) in GRIDS.items()} | RASTERS | TEXTS


@pytest.mark.parametrize("name", ALL)
@pytest.mark.filterwarnings("ignore::geomag.DataWarning", "ignore::PendingDeprecationWarning")
def test_a_grid(tmp_path, name):
    content, options, right = ALL[name]
    path = tmp_path / name
    path.write_text(content) if isinstance(content, str) else content(path)
    if isinstance(right, str):
        with pytest.raises(geomag.GeomagError, match=right):
            geomag.read_grid(path, **options)
        return
    grid = geomag.read_grid(path, **options)
    got = [float(grid.sample(x, y)) for x, y, _ in right]
    np.testing.assert_allclose(got, [v for *_, v in right], rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "options", "right"),
    [
        ("/ made\n/ LON LAT TMI\nLINE:100\n10 45 1\n10.1 45 2\nTIE:900\n10 45.1 3\n10 45.2 4\n", {}, {"100": 2, "900": 2}),
        ("/ X Y TMI\nLine 100\n500000 5100000 1\n500010 5100000 *\n500020 5100000 2\nTie 9000\n500010 5099990 1\n500010 5100010 2\n", FLAT, {"100": 2, "9000": 2}),
        ("LINE;FID;X_UTM;Y_UTM;MAG_nT\nL1;1;500000,5;5100000;1,5\nL1;2;500010,5;5100000;2,5\nT9;1;500005;5099990;3\n", {}, {"L1": 2, "T9": 1}),
        ("flight,line,longitude,latitude,mag\n1,10,10,45,1\n1,10,10.1,45,2\n1,20,10,45.1,3\n", {}, {"10": 2, "20": 1}),
        ("line,easting,northing,tmi\n10,0,0,1\n10,10,0,-99999\n10,20,0,2\n20,0,10,3\n20,10,10,99999\n20,20,10,4\n", {}, {"10": 2, "20": 2}),
        ("> -L100\n10 45 1\n10.1 45 2\n> -L101\n10 45.1 1\n", {"geographic": True}, "x="),
    ],
    ids=["colons", "star", "decimal comma", "flights", "dummies", "GMT without names"],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::geomag.DataWarning")
def test_lines(tmp_path, text, options, right):
    (tmp_path / "lines.xyz").write_text(text)
    if isinstance(right, str):
        with pytest.raises(geomag.GeomagError, match=right):
            read_lines(tmp_path / "lines.xyz", **options)
        return
    assert {str(one.line[0]): len(one.x) for one in read_lines(tmp_path / "lines.xyz", **options).split()} == right


STREAMS = [
    ("lat;lon;mag_uT\n45;10;48,1\n45,01;10,01;48,2\n", [(10, 45, 48100, None), (10.01, 45.01, 48200, None)], 0),
    ("45,5;10,5;30,5\n45,6;10,6;31\n", [(45.5, 10.5, 30.5, None), (45.6, 10.6, 31, None)], 0),
    ("time,lon,lat,value\n23:59:59,10,45,1\n00:00:01,10,45,3\n", [(10, 45, 1, 86399), (10, 45, 3, 86401)], 0),
    ("time,lon,lat,value\n2026-01-05T23:59:59Z,10,45,1\n2026-01-06T00:00:00Z,10,45,2\n", [(10, 45, 1, 0), (10, 45, 2, 1)], 0),
    ("time,x,y,value\n1,2,3,4\nxx\n2,2,3\n3,2,3,nan\n4,2,3,99999\n1_0,2,3,4\n5,2,3,5\n", [(2, 3, 4, 1), (2, 3, 5, 5)], 5),
    ("lon,lat,mag_G\n10,45,0.48\nlon,lat,mag_G\n11,45,0.5\n", [(10, 45, 48000, None), (11, 45, 50000, None)], 1),
    ("lon,lat,value\n10.5E,45.5S,2\n", [(10.5, -45.5, 2, None)], 0),
]  # fmt: skip


@pytest.mark.parametrize(("text", "right", "told"), STREAMS)
def test_a_stream(text, right, told):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        got = [(s.x, s.y, s.value, s.time_s) for s in read_csv(text.splitlines())]
    np.testing.assert_allclose(np.array(got, dtype=float), np.array(right, dtype=float), rtol=1e-12)
    assert len(caught) == told


def sentence(body):
    total = 0
    for byte in body.encode():
        total ^= byte
    return f"${body}*{total:02X}"


HERE = sentence("GNGGA,235959.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,")
THERE = sentence("GNRMC,000000.00,A,4807.048,N,01131.010,E,022.4,084.4,240394,,,A")
ONE, TWO = sentence("PGMAG,48650.1"), sentence("PGMAG,48651.1")


@pytest.mark.parametrize(
    ("lines", "right", "told"),
    [
        ([HERE, ONE, THERE, TWO], [(48650.1, 86399), (48651.1, 86400)], 0),
        ([HERE[:-2] + HERE[-2:].lower(), ONE + "\r"], [(48650.1, 86399)], 0),
        (["507.038,N,011*55", HERE, ONE, THERE[:30], TWO, THERE, TWO], [(48650.1, 86399), (48651.1, 86400)], 1),
        ([HERE + ONE, "38,N" + THERE, TWO], [(48650.1, 86399), (48651.1, 86400)], 0),
        (["\\s:A,c:1*77\\" + HERE, ONE], [(48650.1, 86399)], 0),
        ([HERE, "$PGMAG,486x1.1*00", ONE], [(48650.1, 86399)], 1),
        ([ONE, TWO, HERE, ONE], [(48650.1, 86399)], 1),
        ([sentence("GPGLL,4807.038,N,01131.000,E,235959.00,A,A"), ONE], [(48650.1, 86399)], 0),
        ([sentence("GNGNS,235959.00,4807.038,N,01131.000,E,AN,08,0.9,545.4,46.9,,"), ONE], [(48650.1, 86399)], 0),
        ([sentence("GNGNS,235959.00,4807.038,N,01131.000,E,NN,00,,,,,"), ONE, HERE, ONE], [(48650.1, 86399)], 1),
        ([sentence("GPGLL,4807.038,N,01131.000,E,235959.00,V"), ONE, HERE, ONE], [(48650.1, 86399)], 1),
    ],
    ids=["talkers", "lower case", "halves", "glued", "tag block", "garbled", "no position", "GLL", "GNS", "void GNS", "void GLL"],
)  # fmt: skip
def test_sentences(lines, right, told):
    """Positions from whatever sentence has them; a reading is never lost without a word, and every gap is told once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        got = list(read_nmea(lines))
    assert [(s.value, s.time_s) for s in got] == right
    assert [(round(s.x, 4), round(s.y, 4)) for s in got][:1] == [(11.5167, 48.1173)]
    assert len(caught) == told


def utm(tmp_path, crs="EPSG:32633"):
    axis = np.arange(0.0, 12_000.0, 100.0)
    field = 90 * np.sin(axis / 700)[None, :] * np.cos(axis / 900)[:, None] + 40 * np.sin(axis / 400)[:, None]
    grid = geomag.GridMap(field, 500_000 + axis, 5_200_000 + axis, sigma=1.0, units="nT", crs=crs)
    grid.save(tmp_path / "map.nc")
    return grid


def in_degrees(x, y):
    pyproj = pytest.importorskip("pyproj", reason="needs the extra 'geo'")
    return pyproj.Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True).transform(x, y)


@pytest.mark.parametrize("command", ["match", "stream", "navigate", "navigate -"])
def test_degrees_on_a_map_in_metres(tmp_path, capsys, monkeypatch, command):
    """Every command that takes positions turns degrees by the map's system, and refuses them where it has none; a stream and a flight took them for metres."""
    pytest.importorskip("typer", reason="needs the extra 'cli'")
    import io

    from geomag.cli import run

    grid = utm(tmp_path)
    k = np.arange(60)
    x, y = 503_000 + 90.0 * k, 5_203_000 + 70.0 * k
    values = grid.sample(x, y)
    for header, px, py in (
        ("time_s,easting,northing,value", x - 150, y + 90),
        ("time_s,lon,lat,value", *in_degrees(x - 150, y + 90)),
    ):
        lines = [header, *(f"{2 * t},{a:.9f},{b:.9f},{v:.3f}" for t, a, b, v in zip(k, px, py, values, strict=True))]
        text = "\n".join(lines) + "\n"
        (tmp_path / "log.csv").write_text(text)
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        own = {
            "match": ["log.csv", "--half-width-m", "600"],
            "stream": ["--half-width-m", "600"],
            "navigate": ["log.csv"],
            "navigate -": ["-"],
        }
        name = command.split()[0]
        monkeypatch.chdir(tmp_path)
        code = run(
            [name, "map.nc", *own[command], "--json"]
            if command in ("match", "navigate")
            else [name, "map.nc", *own[command]]
        )
        out, err = capsys.readouterr()
        assert code in (0, 3), err
        if header.startswith("time_s,e"):
            right = out
        elif command in ("match", "navigate"):
            assert "EPSG:32633" in err
    import json

    one, other = ([json.loads(line) for line in t.strip().splitlines()] for t in (right, out))
    assert [r["status"] for r in one] == [r["status"] for r in other]
    one, other = ([(r["x"], r["y"]) for r in rows if r["ok"]] for rows in (one, other))
    np.testing.assert_allclose(one, other, atol=1.0)
    assert 500_000 < one[-1][0] < 512_000
    utm(tmp_path, crs=None)
    monkeypatch.setattr("sys.stdin", io.StringIO(text))
    assert run([name, "map.nc", *own[command]]) == 1
    assert "degrees" in capsys.readouterr().err
