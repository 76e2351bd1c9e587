"""PX4 flight logs (ULog), through pyulog."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from geomag._errors import DataWarning, ReadError
from geomag._optional import require
from geomag.io._log_tables import Array, Series, joined, magnitude_nt, one_of
from geomag.io._text import Table, existing

MAGIC = b"ULog\x01\x12\x35"
_NT_PER_GAUSS = 1e5
_POSITIONS = ("vehicle_global_position", "vehicle_gps_position", "sensor_gps")
_READINGS = ("vehicle_magnetometer", "sensor_mag")


def _positions(name: str, data: dict[str, Any], seconds: Array) -> Series | None:
    for latitude, longitude, factor in (("lat", "lon", None), ("latitude_deg", "longitude_deg", 1.0)):
        if latitude in data and longitude in data:
            lat, lon = (np.asarray(data[k], dtype=np.float64) for k in (latitude, longitude))
            # GPS topics of older firmware hold integers of 1e-7 degree.
            scale = factor or (1e-7 if np.asarray(data[latitude]).dtype.kind in "iu" else 1.0)
            return Series(name, seconds, {"longitude": lon * scale, "latitude": lat * scale})
    return None


def _readings(name: str, data: dict[str, Any], seconds: Array) -> Series | None:
    for axes in (tuple(f"magnetometer_ga[{k}]" for k in range(3)), ("x", "y", "z")):
        if all(a in data for a in axes):
            x, y, z = (np.asarray(data[a], dtype=np.float64) for a in axes)
            return Series(name, seconds, {"magnetic_field_nt": magnitude_nt(x, y, z, _NT_PER_GAUSS)})
    return None


def ulog_table(path: str | Path, position: str | None = None, reading: str | None = None) -> Table:
    """Readings of a ULog with the positions of their times; streams are named `topic` or `topic[instance]`."""
    path = existing(path)
    core = require("pyulog", "logs", "PX4 logs")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints what it finds wrong
            log = core.ULog(str(path), None)
    except Exception as error:  # the reader underneath trips in many ways over a broken log
        raise ReadError(f"{path}: needed a readable ULog, got: {type(error).__name__} {error}") from error
    if getattr(log, "file_corruption", False):
        warnings.warn(f"{path}: parts of the log cannot be read and are left out", DataWarning, stacklevel=4)
    series: dict[str, Series] = {}
    first: dict[str, dict[str, Series]] = {"position": {}, "reading": {}}
    for data in log.data_list:
        name = data.name if not data.multi_id else f"{data.name}[{data.multi_id}]"
        seconds = np.asarray(data.data["timestamp"], dtype=np.float64) * 1e-6
        for what, topics, made in (("position", _POSITIONS, _positions), ("reading", _READINGS, _readings)):
            found = made(name, data.data, seconds) if data.name in topics else None
            if found is not None:
                first[what][name] = found
        plain = {
            k: np.asarray(v, dtype=np.float64)
            for k, v in data.data.items()
            if k != "timestamp" and np.asarray(v).dtype.kind in "iuf"
        }
        for k, v in plain.items():
            series[f"{name}.{k}"] = Series(f"{name}.{k}", seconds, {k: v})
    where = str(path)
    chosen = one_of(
        _preferred(first["position"], _POSITIONS) if position is None else first["position"],
        position,
        "position",
        where,
    )
    if reading is not None and reading in series:
        own = series[reading]
        return joined(chosen, Series(own.name, own.time_s, {"value": next(iter(own.columns.values()))}), where)
    values = one_of(
        _preferred(first["reading"], _READINGS) if reading is None else first["reading"], reading, "reading", where
    )
    return joined(chosen, values, where)


def _preferred(found: dict[str, Series], topics: tuple[str, ...]) -> dict[str, Series]:
    """The streams of the first topic that the log has: estimated positions go before raw ones, calibrated readings before raw ones."""
    for topic in topics:
        same = {k: s for k, s in found.items() if k.split("[")[0] == topic}
        if same:
            return same
    return {}
