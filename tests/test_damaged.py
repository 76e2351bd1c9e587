"""Files whose damage once crashed a library, or was read as numbers that the file does not hold: each is refused in words."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import geomag
from geomag.diurnal import read_iaga2002

netCDF4 = pytest.importorskip("netCDF4", reason="needs the extra 'io'")
pytest.importorskip("rasterio", reason="needs the extra 'io'")
pytest.importorskip("harmonica", reason="needs the extra 'survey'")

import fuzzing  # noqa: E402 - after the libraries that it needs
from test_logs import mgd77_row  # noqa: E402


def test_numbers_are_decimal_numbers(tmp_path):
    """Python takes `4_002.75` for 4002.75, dates without a day and zones of times; a format does not."""
    good = fuzzing.made()["smw.min"].decode()
    path = tmp_path / "smw.min"
    path.write_text(good)
    assert len(read_iaga2002(path).time) == 2
    for old, new in (
        ("43001.75", "4_001.75"),
        ("00:02:00.000", "00:02:00+01"),
        ("2026-03-01 00:02", "2026-03 00:02"),
        ("43001.75", "inf"),
    ):
        assert old in good
        path.write_text(good.replace(old, new))
        with pytest.raises(geomag.ReadError, match=r"line 1[01]"):
            read_iaga2002(path)


def test_implied_decimals_want_every_digit(tmp_path):
    """A field of MGD77 with a blank at its end is a digit short: all its decimals are implied."""
    row = mgd77_row(59.5, 10.12345, -179.99999, 45123.4, -12.3)
    assert row[35:44] == "-17999999"
    for spoilt in (row[:35] + "-1799999 " + row[44:], row[:27] + " 1_01234" + row[35:]):
        (tmp_path / "leg.mgd77").write_text(spoilt + "\n" + row + "\n")
        with pytest.raises(geomag.ReadError, match="line 1: needed a data record"):
            geomag.read_track(tmp_path / "leg.mgd77", value="total_field_nt")


def test_columns_that_a_format_needs(tmp_path):
    header = "SURVEY_ID TIMEZONE DATE TIME LAT LON MAG_TOT".replace(" ", "\t")
    (tmp_path / "leg.m77t").write_text(header + "\nA\t0\t19910812\t2359.5\t18.8\t-155.3\t45123.4\n")
    assert len(geomag.read_track(tmp_path / "leg.m77t")) == 1
    (tmp_path / "leg.m77t").write_text(
        '"x"\n' + header.replace("DATE", '"DA""TE"') + "\nA\t0\t19910812\t2359.5\t18.8\t-155.3\t45123.4\n"
    )
    with pytest.raises(geomag.GeomagError):
        geomag.read_track(tmp_path / "leg.m77t")


def test_a_mark_within_a_number_is_no_blank(tmp_path):
    (tmp_path / "log.csv").write_text("\ufefflon lat value\n \ufeff10 45 1\n12\ufeff0 45 2\n")
    with pytest.raises(geomag.InvalidInputError, match="line 3"):
        geomag.read_track(tmp_path / "log.csv")


def classic(**changed):
    """A classic netCDF file with some of its header's numbers replaced, by their places."""
    data = bytearray(fuzzing.made()["classic.nc"])
    for at, number in changed.items():
        struct.pack_into(">I", data, int(at[1:]), number)
    return bytes(data)


def test_a_damaged_header_does_not_reach_the_library(tmp_path):
    """Sizes of its own that a classic file cannot hold crashed the C library, or made it fill gigabytes."""
    path = tmp_path / "map.nc"
    whole = classic()
    path.write_bytes(whole)
    assert geomag.read_grid(path).shape == (3, 4)
    length = whole.index(b"lat\0") + 4
    assert struct.unpack_from(">I", whole, length) == (3,)
    for number in (2**30, 0xFFFFFFFF, 40):
        path.write_bytes(classic(**{f"_{length}": number}))
        with pytest.raises(geomag.ReadError, match="damaged header"):
            geomag.read_grid(path)
    path.write_bytes(classic(_12=2**31))  # how many dimensions there are
    with pytest.raises(geomag.ReadError, match="damaged header"):
        geomag.read_grid(path)


def test_every_torn_classic_file_is_refused(tmp_path):
    whole, path = classic(), tmp_path / "map.nc"
    for length in range(4, len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(geomag.ReadError):
            geomag.read_grid(path)


@pytest.mark.parametrize("form", ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"])
def test_whole_classic_files_pass(tmp_path, form):
    """Attributes of every type, a record dimension, padding, several variables."""
    with netCDF4.Dataset(tmp_path / "map.nc", "w", format=form) as file:
        file.title = "a"
        file.setncatts({"b": np.int8(1), "c": np.arange(3, dtype="i2"), "d": 1.5, "e": np.arange(2, dtype="f4")})
        file.createDimension("time", None)
        for name, axis, unit in (("lat", [45.0, 46.0, 47.0], "degrees_north"), ("lon", [9.0, 10.0], "degrees_east")):
            file.createDimension(name, len(axis))
            file.createVariable(name, "f8", (name,))[:] = axis
            file[name].units = unit
        file.createVariable("time", "f8", ("time",))[:] = [0.0]
        file.createVariable("count", "i1", ("time", "lat"))[:] = np.ones((1, 3))
        file.createVariable("mag", "f4", ("time", "lat", "lon"))[:] = np.arange(6.0).reshape(1, 3, 2)
    assert geomag.read_grid(tmp_path / "map.nc", "mag").sample(10.0, 47.0) == 5.0


def test_only_what_a_map_needs_is_read(tmp_path):
    """A field beside it may be larger than the memory; one that is asked for is refused for its size before it is read."""
    with netCDF4.Dataset(tmp_path / "map.nc", "w") as file:
        for name, count, unit in (
            ("lat", 30_000, "degrees_north"),
            ("lon", 30_000, "degrees_east"),
            ("a", 3, "degrees_north"),
            ("b", 4, "degrees_east"),
        ):
            file.createDimension(name, count)
            file.createVariable(name, "f8", (name,))[:] = 10.0 + 0.001 * np.arange(count)
            file[name].units = unit
        file.createVariable("huge", "f4", ("lat", "lon"), chunksizes=(100, 100))
        file.createVariable("mag", "f4", ("a", "b"))[:] = np.arange(12.0).reshape(3, 4)
    assert geomag.read_grid(tmp_path / "map.nc", "mag").shape == (3, 4)
    with pytest.raises(geomag.ReadError, match="needed at most 400,000,000 numbers in 'huge'"):
        geomag.read_grid(tmp_path / "map.nc", "huge")
