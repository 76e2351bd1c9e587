"""Logs of vehicles, made with the writers of the libraries that read them, become tracks."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest

import geomag

#: A drone flies east for ten seconds; its compass reads this strength, nT.
T_S = np.arange(0.0, 10.01, 0.5)
LONGITUDE, LATITUDE = 16.0 + 1e-4 * T_S, 47.0 + 0.0 * T_S
FIELD_NT = 48_000.0 + 20.0 * T_S
READ_S = np.arange(1.25, 9.0, 0.5)


def is_the_flight(track, values_nt=None):
    assert len(track) == len(READ_S)
    np.testing.assert_allclose(track.x, 16.0 + 1e-4 * READ_S, atol=1e-7)
    np.testing.assert_allclose(track.y, 47.0, atol=1e-7)
    np.testing.assert_allclose(track.values, 48_000.0 + 20.0 * READ_S if values_nt is None else values_nt, rtol=2e-4)
    np.testing.assert_allclose(track.time_s, READ_S - READ_S[0], atol=1e-6)


def ulog_message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(path, magnetometers=1):
    """The messages of a log, written as it should be again by pyulog."""
    pyulog = pytest.importorskip("pyulog", reason="needs the extra 'logs'")
    formats = (
        "vehicle_global_position:uint64_t timestamp;double lat;double lon;",
        "vehicle_magnetometer:uint64_t timestamp;float[3] magnetometer_ga;",
    )
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + ulog_message("B", bytes(40))
    for f in formats:
        out += ulog_message("F", f.encode())
    for multi, number, name in (
        (0, 0, "vehicle_global_position"),
        *((k, 1 + k, "vehicle_magnetometer") for k in range(magnetometers)),
    ):
        out += ulog_message("A", struct.pack("<BH", multi, number) + name.encode())
    for t, x, y in zip(T_S, LONGITUDE, LATITUDE, strict=True):
        out += ulog_message("D", struct.pack("<HQdd", 0, round(1e6 * t) + 5_000_000, y, x))
    for k in range(magnetometers):
        for t in READ_S:
            strength = (48_000.0 + 20.0 * t) * 1e-5
            out += ulog_message(
                "D", struct.pack("<HQfff", 1 + k, round(1e6 * t) + 5_000_000, 0.6 * strength, 0.0, 0.8 * strength)
            )
    log = pyulog.ULog(io.BytesIO(out))
    log.write_ulog(str(path))
    return path


def test_ulog(tmp_path):
    is_the_flight(geomag.read_track(ulog(tmp_path / "flight.ulg")))
    two = ulog(tmp_path / "two.ulg", magnetometers=2)
    with pytest.raises(geomag.UnknownVariableError, match=r"vehicle_magnetometer\[1\].*reading="):
        geomag.read_track(two)
    is_the_flight(geomag.read_track(two, reading="vehicle_magnetometer[1]"))
    with pytest.raises(geomag.UnknownVariableError, match="position= among"):
        geomag.read_track(two, position="nothing", reading="vehicle_magnetometer")


def dataflash(path, compasses=1):
    """A log of the messages that pymavlink packs."""
    reader = pytest.importorskip("pymavlink.DFReader", reason="needs the extra 'mavlink'")
    made = {
        "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
        "POS": (130, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
        "MAG": (131, "QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    }
    formats = {}
    out = b""
    for name, (number, columns, names) in made.items():
        size = 3 + struct.calcsize(
            "<"
            + "".join(
                {"B": "B", "n": "4s", "N": "16s", "Z": "64s", "Q": "Q", "L": "i", "f": "f", "h": "h"}[c]
                for c in columns
            )
        )
        formats[name] = reader.DFFormat(number, name, size, columns, names)
        out += struct.pack(
            "<BBBBB4s16s64s", 0xA3, 0x95, 128, number, size, name.encode(), columns.encode(), names.encode()
        )

    def packed(name, *elements):
        return reader.DFMessage(formats[name], list(elements), True, None).get_msgbuf()

    rows = [
        (t, packed("POS", round(1e6 * t), round(1e7 * y), round(1e7 * x), 500.0, 0.0, 0.0))
        for t, x, y in zip(T_S, LONGITUDE, LATITUDE, strict=True)
    ]
    for k in range(compasses):
        rows += [(t, packed("MAG", round(1e6 * t), k, 0, round((48_000.0 + 20.0 * t) / 100.0), 0)) for t in READ_S]
    path.write_bytes(out + b"".join(b for _, b in sorted(rows)))
    return path


def test_dataflash(tmp_path):
    whole = np.round((48_000.0 + 20.0 * READ_S) / 100.0) * 100.0  # a compass of ArduPilot counts milligauss
    is_the_flight(geomag.read_track(dataflash(tmp_path / "log.bin")), whole)
    two = dataflash(tmp_path / "two.bin", compasses=2)
    with pytest.raises(geomag.UnknownVariableError, match=r"MAG\[0\], MAG\[1\].*reading="):
        geomag.read_track(two)
    is_the_flight(geomag.read_track(two, reading="MAG[1]"), whole)


def bag(path, version):
    pytest.importorskip("rosbags", reason="needs the extra 'logs'")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.LATEST)
    types = store.types
    time, header, vector = (
        types[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3")
    )
    place, status, field = (types[f"sensor_msgs/msg/{n}"] for n in ("NavSatFix", "NavSatStatus", "MagneticField"))

    def head(t):
        stamp = time(sec=1_700_000_000 + int(t), nanosec=round(1e9 * (t % 1.0)))
        return header(stamp=stamp, frame_id="", **({"seq": 0} if version == 1 else {}))

    nine = np.zeros(9)
    made = [
        (
            t,
            "/fix",
            place(
                header=head(t),
                status=status(status=0, service=1),
                latitude=y,
                longitude=x,
                altitude=500.0,
                position_covariance=nine,
                position_covariance_type=0,
            ),
        )
        for t, x, y in zip(T_S, LONGITUDE, LATITUDE, strict=True)
    ]
    for t in READ_S:
        strength = (48_000.0 + 20.0 * t) * 1e-9
        made.append(
            (
                t,
                "/mag",
                field(header=head(t), magnetic_field=vector(x=0.0, y=-strength, z=0.0), magnetic_field_covariance=nine),
            )
        )
    if version == 1:
        from rosbags.rosbag1 import Writer

        writer = Writer(path)
        pack = store.serialize_ros1
    else:
        from rosbags.rosbag2 import Writer

        writer = Writer(path, version=9)
        pack = store.serialize_cdr
    with writer:
        topics = {
            "/fix": writer.add_connection("/fix", place.__msgtype__, typestore=store),
            "/mag": writer.add_connection("/mag", field.__msgtype__, typestore=store),
        }
        for t, topic, message in sorted(made, key=lambda m: m[0]):
            writer.write(topics[topic], round(1e9 * (1_700_000_000 + t)), pack(message, message.__msgtype__))
    return path


@pytest.mark.parametrize("version", [1, 2])
def test_ros_bags(tmp_path, version):
    path = bag(tmp_path / ("flight.bag" if version == 1 else "flight"), version)
    is_the_flight(geomag.read_track(path))
    track = geomag.read_track(path, reading="/fix.altitude")
    assert set(track.values) == {500.0}
    with pytest.raises(geomag.UnknownVariableError, match="reading= among /mag"):
        geomag.read_track(path, reading="/other")


def test_readings_without_positions_are_told(tmp_path):
    from geomag.io._log_tables import Series, joined

    t = np.array([0.0, 1.0, 2.0, 60.0, 61.0])
    places = Series("p", t, {"longitude": np.array([179.9, 179.95, -180.0, -179.9, -179.8]), "latitude": np.zeros(5)})
    readings = Series("r", np.array([-1.0, 1.5, 30.0, 60.5, 99.0]), {"value": np.arange(5.0)})
    with pytest.warns(geomag.DataWarning, match="3 of 5 readings"):
        table = joined(places, readings, "log")
    columns = {c.name: table.floats(c) for c in table.columns}
    np.testing.assert_allclose(columns["longitude"], [179.975, -179.85])
    assert columns["value"].tolist() == [1.0, 3.0]


@pytest.mark.parametrize("head", [b"ULog\x01\x12\x35", b"\xa3\x95\x80", b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"])
def test_torn_logs_are_refused(tmp_path, head):
    for module in ("pyulog", "pymavlink", "rosbags"):
        pytest.importorskip(module, reason="needs the extras 'logs' and 'mavlink'")
    for tail in (b"", b"\0" * 100, bytes(range(256))):
        (tmp_path / "torn").write_bytes(head + tail)
        with pytest.raises(geomag.GeomagError, match="torn"):
            geomag.read_track(tmp_path / "torn")


def test_magnav_flight(tmp_path):
    h5py = pytest.importorskip("h5py", reason="needs the extra 'logs'")
    with h5py.File(tmp_path / "flight.h5", "w") as file:
        for name, values in {"tt": T_S, "lon": LONGITUDE, "lat": LATITUDE, "ins_lon": LONGITUDE + 0.01, "ins_lat": LATITUDE - 0.01,
                             "mag_1_c": FIELD_NT, "mag_1_uc": FIELD_NT + 7.0, "line": 0.0 * T_S}.items():  # fmt: skip
            file[name] = values
    track = geomag.read_track(tmp_path / "flight.h5")
    np.testing.assert_allclose((track.x, track.y, track.values), (LONGITUDE + 0.01, LATITUDE - 0.01, FIELD_NT))
    track = geomag.read_track(tmp_path / "flight.h5", position="true", reading="mag_1_uc")
    np.testing.assert_allclose((track.x, track.values), (LONGITUDE, FIELD_NT + 7.0))
    with h5py.File(tmp_path / "flight.h5", "a") as file:
        for name in ("ins_lon", "ins_lat"):
            file[name][:] = np.radians(file[name][:])
    with pytest.raises(geomag.InvalidInputError, match="radians"):
        geomag.read_track(tmp_path / "flight.h5")


def test_the_fixtures_of_magnav(data_file):
    pytest.importorskip("h5py", reason="needs the extra 'logs'")
    grid = geomag.read_grid(data_file("magnav-fixtures/simple_map.h5"))
    track = geomag.read_track(data_file("magnav-fixtures/simple_xyz.h5"), position="true")
    assert np.abs(grid.sample(track.x, track.y) - track.values).max() < 1e-10
    with pytest.raises(geomag.UnknownVariableError, match="lon, ins_lon"):
        geomag.read_track(data_file("magnav-fixtures/simple_xyz.csv"), value="mag_1_c")


def mgd77_row(minute, latitude, longitude, field, free_air):
    """One data record, its fields set column by column."""
    row = list(
        "5"
        + "TEST0001"
        + "  0"
        + "19850612"
        + "23"
        + f"{round(1000 * minute):05d}"
        + f"{round(1e5 * latitude):8d}"
        + f"{round(1e5 * longitude):9d}"
    )
    row += list(
        "1"
        + "999999"
        + "999999"
        + "99"
        + "9"
        + f"{round(10 * field):6d}"
        + "999999"
        + "999999"
        + "9"
        + "99999"
        + "999999"
        + "9999999"
        + "999999"
    )
    row += list(f"{round(10 * free_air):5d}" + "99999" + "999999" + "9")
    return "".join(row)


def test_mgd77_and_m77t(tmp_path):
    rows = [mgd77_row(59.5, 10.12345, -179.99999, 45123.4, -12.3), mgd77_row(59.75, 10.2, 179.9, 45124.5, 99.9)]
    assert {len(r) for r in rows} == {120}
    (tmp_path / "leg.mgd77").write_text("\n".join(rows) + "\n")
    track = geomag.read_track(tmp_path / "leg.mgd77", value="free_air_anomaly_mgal")
    assert (track.x.tolist(), track.y.tolist()) == ([-179.99999, 179.9], [10.12345, 10.2])
    assert (track.values.tolist(), track.time_s.tolist()) == ([-12.3, 99.9], [0.0, 15.0])
    assert geomag.read_track(tmp_path / "leg.mgd77", value="total_field_nt").values.tolist() == [45123.4, 45124.5]
    with pytest.raises(geomag.UnknownVariableError, match="free_air_anomaly_mgal"):
        geomag.read_track(tmp_path / "leg.mgd77")
    header = "SURVEY_ID TIMEZONE DATE TIME LAT LON MAG_TOT MAG_RES FREEAIR".replace(" ", "\t")
    body = ["A 0 19910812 2359.5 18.8489 -155.325 45123.4  -12.3", "A 0 19910813 0000.5 18.8496 -155.322 45124.4  "]
    (tmp_path / "leg.m77t").write_text("\n".join([header, *(b.replace(" ", "\t") for b in body)]) + "\n")
    track = geomag.read_track(tmp_path / "leg.m77t", value="total_field_nt")
    assert (track.values.tolist(), track.time_s.tolist()) == ([45123.4, 45124.4], [0.0, 60.0])
