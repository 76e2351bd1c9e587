"""Maps and flights in the HDF5 layout of MagNav.jl."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomag._errors import InvalidInputError, ReadError, UnknownVariableError
from geomag._geomag import GridMap
from geomag._optional import require
from geomag.io._log_tables import numbers_table
from geomag.io._make import make_map
from geomag.io._text import Table
from geomag.io._units import same_kind

_MAP = {"map", "xx", "yy"}


def datasets(path: Path, names: set[str] | None = None) -> dict[str, NDArray[Any]]:
    """Numbers of the top level of an HDF5 file, by name."""
    h5py = require("h5py", "logs", "HDF5 files of MagNav")
    try:
        with h5py.File(path) as file:
            return {
                k: np.asarray(v)
                for k, v in file.items()
                if isinstance(v, h5py.Dataset) and v.dtype.kind in "iuf" and (names is None or k in names)
            }
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise ReadError(f"{path}: needed a readable HDF5 file, got: {error}") from error


def is_magnav_map(path: Path) -> bool:
    """Whether an HDF5 file has a map of MagNav's layout; False where h5py is not there to look."""
    try:
        import h5py
    except ImportError:
        return False
    try:
        with h5py.File(path) as file:
            return set(file) >= _MAP and file["map"].ndim == 2
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError):
        return False


def read_magnav_map(path: Path, geographic: bool | None, sigma: str | float | None) -> GridMap:
    """A map of that layout: values `map` (rows y, columns x), axes `xx` and `yy` in degrees, `mask` of what is measured."""
    where = str(path)
    found = datasets(path)
    xx, yy, values = (np.asarray(found[k], dtype=np.float64) for k in ("xx", "yy", "map"))
    if xx.ndim != 1 or yy.ndim != 1:
        raise ReadError(f"{where}: needed axes xx and yy of one dimension, got {xx.shape} and {yy.shape}")
    # Julia stores columns first: the file may hold the transpose, which shows where the axes differ in length.
    if values.shape == (len(xx), len(yy)) and len(xx) != len(yy):
        values = values.T
    elif values.shape != (len(yy), len(xx)):
        raise ReadError(f"{where}: needed a map of {len(yy)} x {len(xx)}, got {values.shape}")
    elif len(xx) == len(yy):
        values = values.T
    if "mask" in found and found["mask"].shape in (values.shape, values.T.shape):
        mask = found["mask"].T
        values = np.where(mask.astype(bool), values, np.nan)
    degrees = bool(np.abs(xx).max() <= 360.0 and np.abs(yy).max() <= 90.0)
    if geographic is None and not degrees:
        raise InvalidInputError(
            f"{where}: needed axes in degrees, or geographic=False for metres, got x to {np.abs(xx).max():g}"
        )
    geographic = same_kind(geographic, True, where) if degrees else bool(geographic)
    if isinstance(sigma, str):
        raise InvalidInputError(f"{where}: needed a number for sigma, got '{sigma}'")
    return make_map(values, xx, yy, geographic=geographic, sigma=sigma, name=path.stem, units="nT", where=where)


def is_magnav_flight(path: Path) -> bool:
    """Whether an HDF5 file has a flight of that layout: positions and times, one number a sample."""
    try:
        import h5py
    except ImportError:
        return False
    try:
        with h5py.File(path) as file:
            return {"lat", "lon"} <= set(file) and bool({"tt", "ins_tt"} & set(file))
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError):
        return False


def magnav_table(path: Path, position: str | None = None, reading: str | None = None) -> Table:
    """A flight of that layout: indicated positions (`ins_lon`, `ins_lat`) where there are, else the true ones; `mag_1_c` by default.

    `position` is `ins` or `true`; `reading` the name of a data set. Positions are degrees.
    """
    where = str(path)
    found = {k: np.asarray(v, dtype=np.float64) for k, v in datasets(path).items() if v.ndim == 1}
    count = len(found["lat"])
    found = {k: v for k, v in found.items() if len(v) == count}
    if position not in (None, "ins", "true"):
        raise UnknownVariableError(f"{where}: needed position= 'ins' or 'true', got '{position}'")
    ins = {"ins_lon", "ins_lat"} <= set(found) and position != "true"
    if position == "ins" and not ins:
        raise UnknownVariableError(f"{where}: needed ins_lon and ins_lat for position='ins', got none")
    lon, lat = (found[("ins_" if ins else "") + k] for k in ("lon", "lat"))
    if count and np.abs(lon).max() <= np.pi and np.abs(lat).max() <= np.pi / 2:
        raise InvalidInputError(
            f"{where}: needed positions in degrees, got at most {np.abs(lon).max():.3g}, {np.abs(lat).max():.3g} (radians?)"
        )
    name = "mag_1_c" if reading is None else reading
    if name not in found:
        raise UnknownVariableError(f"{where}: needed reading= for one of {', '.join(sorted(found))}, got '{name}'")
    return numbers_table(
        {"time_s": found["tt" if "tt" in found else "ins_tt"], "longitude": lon, "latitude": lat, "value": found[name]},
        where,
    )
