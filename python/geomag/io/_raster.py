"""Rasters that GDAL reads (through rasterio): GeoTIFF, Surfer, ERMapper; and Oasis montaj grids (through harmonica)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from geomag._errors import GeomagError, InvalidInputError, ReadError, UnknownVariableError
from geomag._geomag import GridMap
from geomag._optional import require
from geomag.io._make import MOST, make_map
from geomag.io._units import ask_kind, check_degrees, crs_metres, metric_crs, same_kind


def _band(source: Any, variable: str | None, path: Path) -> int:  # noqa: ANN401 - rasterio's
    """Number of the band asked for, by its number or its description."""
    names: dict[str | None, int] = {str(k): k for k in source.indexes} | {
        d: k for k, d in enumerate(source.descriptions, 1) if d
    }
    if variable is None and source.count == 1:
        return 1
    if variable not in names:
        got = "none" if variable is None else f"'{variable}'"
        raise UnknownVariableError(
            f"{path}: needed variable= for one of its bands {', '.join(map(str, names))}, got {got}"
        )
    return names[variable]


def read_raster(path: Path, variable: str | None, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of one band of a raster."""
    rasterio = require("rasterio", "io", "reading GeoTIFF, Surfer and ERMapper grids")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            source = rasterio.open(path)
        with source:
            number = _band(source, variable, path)
            if source.width * source.height > MOST:
                raise ReadError(f"{path}: needed at most {MOST:,} nodes, got {source.height:,} x {source.width:,}")
            band = source.read(number, masked=True)
            transform, crs = source.transform, source.crs
            scale, zero, unit = (of[number - 1] for of in (source.scales, source.offsets, source.units))
    except GeomagError:
        raise
    except Exception as error:  # besides its own kinds, what trips over the texts and sizes of a damaged file
        raise ReadError(f"{path}: needed a readable raster, got: {error}") from error
    if transform.is_identity:
        raise InvalidInputError(
            f"{path}: needed a raster that says where it lies (georeference), got {'only a system' if crs else 'none'}; its numbers of "
            "pixels are no coordinates"
        )
    if transform.b != 0.0 or transform.d != 0.0:
        raise InvalidInputError(
            f"{path}: needed rows along x and columns along y, got a rotated raster {tuple(transform)[:6]}"
        )
    kind = np.float32 if band.dtype == np.float32 else np.float64
    values = np.ma.filled(band.astype(kind), np.nan)
    values = np.where(np.abs(values) >= 1e30, np.nan, values).astype(kind)
    if (scale, zero) != (1.0, 0.0):
        values = values.astype(np.float64) * scale + zero
    rows, columns = values.shape
    x = transform.c + transform.a * (np.arange(columns) + 0.5)
    y = transform.f + transform.e * (np.arange(rows) + 0.5)
    if crs is not None:
        geographic = same_kind(geographic, bool(crs.is_geographic), str(path))
        if geographic:
            check_degrees(crs, str(path))
        else:
            factor = crs_metres(crs, str(path))
            if factor != 1.0:
                x, y, crs = x * factor, y * factor, metric_crs(crs)
    if geographic is None:
        raise ask_kind(str(path))
    if not np.isfinite(values).any():
        raise ReadError(f"{path}: needed one value at least, got none")
    return make_map(
        values, x, y, geographic=geographic, sigma=sigma, name=path.stem, units=unit or None,
        crs=crs.to_string() if crs else None, where=str(path),
    )  # fmt: skip


def looks_like_oasis(head: bytes) -> bool:
    """Element size, sign, columns, rows and orientation as the first five integers of an Oasis montaj grid."""
    if len(head) < 20:
        return False
    size, sign, columns, rows, order = np.frombuffer(head[:20], "<i4")
    return bool(size % 1024 in (1, 2, 4, 8) and sign in (0, 1, 2, 3) and columns > 1 and rows > 1 and order in (1, -1))


def read_oasis(path: Path, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of an Oasis montaj grid, whose file says neither degrees nor metres."""
    harmonica = require("harmonica", "survey", "reading Oasis montaj grids")
    if geographic is None:
        raise ask_kind(str(path))
    try:
        with np.errstate(all="ignore"):
            array = harmonica.load_oasis_montaj_grid(str(path))
    except Exception as error:  # the reader underneath trips in many ways over what is no grid
        raise ReadError(f"{path}: needed a readable Oasis montaj grid, got: {error}") from error
    if array.ndim != 2 or not {"easting", "northing"} <= set(array.dims):
        raise InvalidInputError(f"{path}: needed rows along x and columns along y, got a rotated Oasis montaj grid")
    array = array.transpose("northing", "easting")
    x, y = np.asarray(array["easting"], dtype=np.float64), np.asarray(array["northing"], dtype=np.float64)
    values = np.asarray(array, dtype=np.float64)
    return make_map(values, x, y, geographic=geographic, sigma=sigma, name=path.stem, where=str(path))
