"""What columns are, from their names alone."""

from __future__ import annotations

import pytest

import geomag
from geomag.io._names import understand

KNOWN = {
    "Lon(deg)": ("x", "geographic"), "lon_wgs84": ("x", "geographic"), "GPS Latitude": ("y", "geographic"), "ins_lon": ("x", "geographic"),
    "Latitude °": ("y", "geographic"), "LONG_DD": ("x", "geographic"), "Easting(m)": ("x", "projected"), "X_UTM": ("x", "projected"),
    "X (UTM)": ("x", "projected"), "North (m)": ("y", "projected"), "X_km": ("x", "projected"), "x": ("x", None), "Y coord": ("y", None),
    "Mag (nT) raw": ("value", None), "Total Field [nT]": ("value", None), "TMF_nT": ("value", None), "Btotal": ("value", None),
    "Free-air anomaly (mGal)": ("value", None), "tmi_1": ("value", None), "F_nT": ("value", None), "z": ("height", None),
    "Elevation (ft)": ("height", None), "Z_nT": ("value", None), "sigma_nt": ("sigma", None), "IGRF_nT": ("other", None),
    "diurnal_nT": ("other", None), "TimeUS": ("time", None), "Time (UTC)": ("time", None), "Date": ("date", None), "Line No.": ("line", None),
    "speed_m_s": ("other", None), "vel_north": ("other", None), "yaw": ("other", None), "magnetic_declination": ("other", None),
    "hdop": ("other", None), "sats#": ("other", None),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("turned", [str, str.upper, lambda name: f' "{name}" '])
def test_a_name_says_what_a_column_is(name, turned):
    column = understand(0, name if name == "TimeUS" else turned(name))
    assert (column.kind, column.system) == KNOWN[name]


@pytest.mark.parametrize(
    ("name", "unit"),
    [("X_km", "km"), ("mag_nT", "nT"), ("Lat (deg)", "deg"), ("TimeUS", "US"), ("B [uT]", "uT"), ("alt_m", "m")],
)
def test_a_name_carries_its_unit(name, unit):
    assert understand(0, name).unit == unit


@pytest.mark.parametrize("name", ["Longitude (deg W)", "Lon (W)", "Easting (deg)", "lat_m"])
def test_contradictions_are_refused(name):
    with pytest.raises(geomag.InvalidInputError, match="needed"):
        understand(0, name)
