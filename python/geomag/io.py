"""Maps and tracks from files, through the libraries that read them well.

netCDF by xarray; GeoTIFF, Surfer and GXF grids by rasterio (GDAL); Oasis montaj grids by harmonica; text and tables by
pandas. `pip install 'geomag-nav[io]'` brings them.
"""

from __future__ import annotations

import csv
import json
import math
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geomag._errors import InvalidInputError, MissingFileError, ReadError, UnknownVariableError
from geomag._geomag import GridMap, Track
from geomag._optional import require

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["grid_from_xarray", "grid_to_xarray", "read_grid", "read_track", "track_from_pandas", "track_to_pandas"]

_X_NAMES = ("longitude", "lon", "lng", "x", "easting", "east", "x_m", "easting_m", "east_m")
_Y_NAMES = ("latitude", "lat", "y", "northing", "north", "y_m", "northing_m", "north_m")
_GEOGRAPHIC_NAMES = {"longitude", "lon", "lng", "latitude", "lat"}
_PROJECTED_NAMES = {"easting", "northing", "east", "north", "x_m", "y_m", "easting_m", "northing_m"}
_VALUE_NAMES = (
    "value",
    "values",
    "total_field_anomaly_nt",
    "magnetic_anomaly_nt",
    "anomaly_nt",
    "anomaly",
    "total_field_nt",
    "total_intensity_nt",
    "field_nt",
    "field",
    "tmi",
    "free_air_anomaly_mgal",
    "gravity_disturbance_mgal",
    "bouguer_anomaly_mgal",
    "anomaly_mgal",
)
#: Metres in a unit, as files name it (lower case, blanks as underscores).
_METRES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1000.0),
    **dict.fromkeys(("ft", "foot", "feet", "international_foot", "international_feet"), 0.3048),
    **dict.fromkeys(("us-ft", "ftus", "us_ft", "us_survey_foot", "us_survey_feet", "survey_foot"), 1200.0 / 3937.0),
    **dict.fromkeys(("nmi", "nautical_mile", "nautical_miles"), 1852.0),
}
_TIME_NAMES = ("time_s", "time", "t", "seconds", "datetime", "timestamp")


def _existing(path: str | Path) -> Path:
    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"file: needed an existing file, got nothing at {path}")
    if path.is_dir():
        raise ReadError(f"file: needed a file, got the folder {path}")
    return path


def _is_geographic(names: Sequence[str | None], units: Sequence[str | None], crs: object, where: str) -> bool:
    """Whether coordinates are degrees, from what the file says; never from their size alone."""
    if crs is not None:
        return bool(getattr(crs, "is_geographic", False))
    degrees = [_is_degree(u) for u in units if u]
    if degrees:
        if any(degrees) and not all(degrees):
            raise InvalidInputError(f"{where}: needed x and y in degrees, or both in metres, got units {units}")
        return all(degrees)
    lowered = {n.lower() for n in names if n}
    if lowered & _GEOGRAPHIC_NAMES:
        return True
    if lowered & _PROJECTED_NAMES:
        return False
    raise InvalidInputError(
        f"{where}: needed to know whether its coordinates are degrees or metres, got neither units nor names that say "
        "so; pass geographic=True or geographic=False"
    )


def _is_degree(unit: str) -> bool:
    return unit.strip().lower().startswith(("deg", "°"))


def _metres(unit: str | None, where: str) -> float:
    """Metres in a coordinate's unit; without one it is metres."""
    if unit is None or not unit.strip():
        return 1.0
    try:
        return _METRES[unit.strip().lower().replace(" ", "_")]
    except KeyError:
        raise InvalidInputError(
            f"{where}: needed coordinates in metres, kilometres, feet, survey feet or nautical miles, got {unit!r}"
        ) from None


def _metric_crs(crs: Any) -> Any:  # noqa: ANN401 - rasterio's
    """The same coordinate reference system with coordinates in metres."""

    def turned(node: dict[str, Any]) -> dict[str, Any]:
        node = {k: v for k, v in node.items() if k != "id"} | {"name": f"{node.get('name', 'unnamed')}, in metres"}
        if "components" in node:
            node["components"] = [turned(node["components"][0]), *node["components"][1:]]
        if "source_crs" in node:
            node["source_crs"] = turned(node["source_crs"])
        if "coordinate_system" in node:
            system = {k: v for k, v in node["coordinate_system"].items() if k != "id"}
            axes = [{k: v for k, v in axis.items() if k != "id"} | {"unit": "metre"} for axis in system["axis"]]
            node["coordinate_system"] = system | {"axis": axes}
        return node

    return type(crs).from_string(json.dumps(turned(crs.to_dict(projjson=True))))


def read_grid(
    path: str | Path,
    variable: str | None = None,
    *,
    geographic: bool | None = None,
    sigma: str | float | None = None,
    columns: tuple[str, str, str] | None = None,
) -> GridMap:
    r"""Read a map from a file.

    Parameters
    ----------
    path : netCDF, GeoTIFF, Surfer .grd (6 text, 6 and 7 binary), GXF, Oasis montaj .grd, or text with x, y, value.
        The kind is found from the file's first bytes, not from its name.
    variable : which variable of a netCDF file, or which band of a raster (its number or description); needed where
        there are several.
    geographic : whether coordinates are degrees of longitude and latitude. By default what the file says (coordinate
        reference system, units, names); where it says nothing, this must be given.
    sigma : standard deviation of the values: a number, or the name of a netCDF variable on the same grid.
    columns : names of the x, y and value columns of a text file.

    Returns
    -------
    GridMap
        Both axes ascending, holes as NaN, float32 or float64 as in the file; kilometres, feet and other units of
        length are turned to metres, and the coordinate reference system with them.

    Raises
    ------
    MissingFileError, ReadError, UnknownVariableError, InvalidInputError, MissingDependencyError

    Examples
    --------
    >>> import pathlib, tempfile, geomag
    >>> nodes = [f"{x},{y},{x + 2 * y}" for y in (0, 50, 100) for x in (0, 50, 100, 150)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "map.csv")
    ...     _ = path.write_text("easting,northing,anomaly\n" + "\n".join(nodes))
    ...     grid = geomag.read_grid(path)
    >>> grid.shape, grid.spacing, grid.geographic
    ((3, 4), (50.0, 50.0), False)
    """
    path = _existing(path)
    with path.open("rb") as file:
        head = file.read(512)
    if head[:3] == b"CDF" or head[:4] == b"\x89HDF":
        if columns is not None:
            raise InvalidInputError(f"columns: needed none for netCDF, which has variables, got {columns}")
        return _read_netcdf(path, variable, geographic, sigma)
    constant = None if sigma is None else _number("sigma", sigma)
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+") or head[:4] in (b"DSAA", b"DSBB", b"DSRB"):
        return _read_raster(path, variable, geographic, constant)
    if path.suffix.lower() == ".gxf" or b"#GRID" in head or b"#POINTS" in head:
        return _read_raster(path, variable, geographic, constant)
    if variable is not None:
        raise InvalidInputError(f"variable: needed none for this kind of file, which has one field, got '{variable}'")
    if _looks_like_oasis(head):
        return _read_oasis(path, geographic, constant)
    if path.suffix.lower() in (".nc", ".nc4", ".cdf", ".netcdf"):
        raise ReadError(
            f"{path}: needed a netCDF file, as its name says, got {'other content' if head else 'an empty file'}"
        )
    if b"\0" in head:
        raise ReadError(f"{path}: needed netCDF, GeoTIFF, Surfer, GXF, Oasis or text, got unknown binary content")
    return _read_xyz(path, geographic, constant, columns)


def _number(what: str, value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{what}: needed a number for this kind of file, got {value!r}") from error


def _read_netcdf(path: Path, variable: str | None, geographic: bool | None, sigma: str | float | None) -> GridMap:
    xarray = require("xarray", "io", "reading netCDF")
    try:
        dataset = xarray.open_dataset(path)
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        raise ReadError(f"{path}: needed a readable netCDF file, got: {error}") from error
    with dataset:
        fields = [str(n) for n, v in dataset.data_vars.items() if v.ndim >= 2 and np.issubdtype(v.dtype, np.number)]
        if variable is None:
            candidates = [n for n in fields if n != sigma]
            if len(candidates) != 1:
                raise UnknownVariableError(
                    f"{path}: needed variable= for one of its fields, got none; it has {', '.join(fields) or 'no field'}"
                )
            variable = candidates[0]
        if variable not in dataset:
            raise UnknownVariableError(f"{path}: needed a variable among {', '.join(fields)}, got '{variable}'")
        layer: Any = sigma
        if isinstance(sigma, str):
            if sigma not in dataset:
                raise UnknownVariableError(
                    f"{path}: needed a variable among {', '.join(fields)} for sigma, got '{sigma}'"
                )
            layer = dataset[sigma]
        return grid_from_xarray(dataset[variable], geographic=geographic, sigma=layer)


def grid_from_xarray(
    data_array: xr.DataArray, *, geographic: bool | None = None, sigma: xr.DataArray | float | None = None
) -> GridMap:
    """Make a map of a two-dimensional DataArray; its dimensions may be in either order.

    The x dimension is the one named longitude, lon, x, easting, east, ...; if no names match, the last one.
    """
    array = data_array.squeeze(drop=True)
    where = f"data array '{data_array.name}'"
    if array.ndim != 2:
        raise InvalidInputError(f"{where}: needed two dimensions, got {dict(data_array.sizes)}")
    dims = [str(d) for d in array.dims]
    xs = [d for d in dims if d.lower() in _X_NAMES]
    ys = [d for d in dims if d.lower() in _Y_NAMES]
    y_name, x_name = (ys[0], xs[0]) if len(xs) == 1 and len(ys) == 1 else (dims[0], dims[1])
    array = array.transpose(y_name, x_name)
    for dim in (x_name, y_name):
        if dim not in array.coords:
            raise InvalidInputError(f"{where}: needed coordinates along '{dim}', got none")
    x, y = np.asarray(array[x_name]), np.asarray(array[y_name])
    for dim, axis in ((x_name, x), (y_name, y)):
        if axis.dtype.kind not in "iuf":
            raise InvalidInputError(f"{where}: needed numbers as coordinates along '{dim}', got {axis.dtype}")
    units = [None if (u := array[d].attrs.get("units")) is None else str(u) for d in (x_name, y_name)]
    crs = data_array.attrs.get("crs")
    if geographic is None:
        geographic = _is_geographic((x_name, y_name), units, None, where)
    if not geographic:
        factors = [_metres(u, f"{where}, '{d}'") for d, u in zip((x_name, y_name), units, strict=True)]
        x, y = x * factors[0], y * factors[1]
        if crs is not None and factors != [1.0, 1.0]:
            crs = _metric_text(str(crs))
    values = np.asarray(array)
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    layer: Any = sigma
    if layer is not None and hasattr(layer, "dims"):
        layer = np.asarray(layer.squeeze(drop=True).transpose(y_name, x_name), dtype=np.float64)
    name = str(data_array.name) if data_array.name is not None else None
    unit = data_array.attrs.get("units")
    return GridMap(
        values,
        x,
        y,
        geographic=geographic,
        sigma=layer,
        name=name,
        units=str(unit) if unit is not None else None,
        crs=str(crs) if crs is not None else None,
    )


def _metric_text(text: str) -> str:
    """`_metric_crs` of a CRS in words; one in metres stays as it is written."""
    rasterio = require("rasterio", "io", "coordinate reference systems in other units than metres")
    try:
        crs = rasterio.CRS.from_string(text)
        return text if crs.units_factor[1] == 1.0 else str(_metric_crs(crs).to_wkt())
    except rasterio.errors.CRSError as error:
        raise InvalidInputError(f"crs: needed a coordinate reference system, got {text!r} ({error})") from error


def grid_to_xarray(grid: GridMap) -> xr.DataArray:
    """Return the map as a DataArray with coordinate units and, where known, name, units and coordinate system."""
    xarray = require("xarray", "io", "GridMap.to_xarray")
    x_name, y_name = ("longitude", "latitude") if grid.geographic else ("easting", "northing")
    array: xr.DataArray = xarray.DataArray(
        grid.values, coords={y_name: grid.y, x_name: grid.x}, dims=(y_name, x_name), name=grid.name or "field"
    )
    array[x_name].attrs["units"] = "degrees_east" if grid.geographic else "m"
    array[y_name].attrs["units"] = "degrees_north" if grid.geographic else "m"
    if grid.units:
        array.attrs["units"] = grid.units
    if grid.crs:
        array.attrs["crs"] = grid.crs
    return array


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


def _read_raster(path: Path, variable: str | None, geographic: bool | None, sigma: float | None) -> GridMap:
    rasterio = require("rasterio", "io", "reading GeoTIFF, Surfer and GXF grids")
    try:
        with rasterio.open(path) as source:
            number = _band(source, variable, path)
            band = source.read(number, masked=True)
            transform, crs = source.transform, source.crs
            scale, zero, unit = (of[number - 1] for of in (source.scales, source.offsets, source.units))
    except rasterio.errors.RasterioError as error:
        raise ReadError(f"{path}: needed a readable raster, got: {error}") from error
    if transform.b != 0.0 or transform.d != 0.0:
        raise InvalidInputError(
            f"{path}: needed rows along x and columns along y, got a rotated raster {tuple(transform)[:6]}"
        )
    kind = np.float32 if band.dtype == np.float32 else np.float64
    values = np.ma.filled(band.astype(kind), np.nan)
    # The two nodata values of Surfer; not all versions of the driver declare them.
    if path.suffix.lower() == ".grd":
        values = np.where(values >= 1.70141e38, np.nan, values).astype(kind)
    if (scale, zero) != (1.0, 0.0):
        values = values.astype(np.float64) * scale + zero
    rows, columns = values.shape
    x = transform.c + transform.a * (np.arange(columns) + 0.5)
    y = transform.f + transform.e * (np.arange(rows) + 0.5)
    if geographic is None:
        geographic = _is_geographic((), (), crs, str(path))
        if geographic and crs is not None and not math.isclose(crs.units_factor[1], math.radians(1.0), rel_tol=1e-6):
            raise InvalidInputError(f"{path}: needed longitude and latitude in degrees, got {crs.units_factor[0]}")
    if not geographic and crs is not None and not crs.is_geographic:
        name, factor = crs.units_factor
        if not (math.isfinite(factor) and factor > 0):
            raise InvalidInputError(f"{path}: needed a unit of length of its coordinates, got {name!r}")
        if factor != 1.0:
            x, y, crs = x * factor, y * factor, _metric_crs(crs)
    return GridMap(
        values, x, y, geographic=geographic, sigma=sigma, name=path.stem, units=unit or None,
        crs=crs.to_string() if crs else None,
    )  # fmt: skip


def _looks_like_oasis(head: bytes) -> bool:
    """Element size, sign, columns, rows and orientation as the first five integers of an Oasis montaj grid."""
    if len(head) < 20:
        return False
    size, sign, columns, rows, order = np.frombuffer(head[:20], "<i4")
    return bool(size % 1024 in (1, 2, 4, 8) and sign in (0, 1, 2, 3) and columns > 1 and rows > 1 and order in (1, -1))


def _read_oasis(path: Path, geographic: bool | None, sigma: float | None) -> GridMap:
    harmonica = require("harmonica", "survey", "reading Oasis montaj grids")
    try:
        array = harmonica.load_oasis_montaj_grid(str(path))
    except (OSError, ValueError, NotImplementedError) as error:
        raise ReadError(f"{path}: needed a readable Oasis montaj grid, got: {error}") from error
    return grid_from_xarray(array, geographic=geographic, sigma=sigma)


def _read_xyz(
    path: Path, geographic: bool | None, sigma: float | None, columns: tuple[str, str, str] | None
) -> GridMap:
    table = read_table(path)
    if columns is None:
        names = [str(c) for c in table.columns]
        if len(names) < 3:
            raise ReadError(f"{path}: needed columns x, y and value, got {len(names)} column(s): {', '.join(names)}")
        x_name = _pick(table, None, _X_NAMES, "x", path, fallback=names[0])
        y_name = _pick(table, None, _Y_NAMES, "y", path, fallback=names[1])
        value_name = _pick(table, None, _VALUE_NAMES, "value", path, fallback=names[2])
    else:
        x_name, y_name, value_name = (_pick(table, c, (), "column", path) for c in columns)
    numbers = [floats(table, c, path) for c in (x_name, y_name, value_name)]
    if geographic is None:
        geographic = _is_geographic((x_name, y_name), (), None, str(path))
    return _from_points(*numbers, geographic=geographic, sigma=sigma, name=value_name, path=path)


def _from_points(
    x: np.ndarray[Any, Any],
    y: np.ndarray[Any, Any],
    values: np.ndarray[Any, Any],
    *,
    geographic: bool,
    sigma: float | None,
    name: str,
    path: Path,
) -> GridMap:
    """Lay points that lie on a regular lattice into rows and columns; nodes without a point are holes."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y, values = x[known], y[known], values[known]
    if len(x) < 4:
        raise ReadError(f"{path}: needed at least four points on a grid, got {len(x)}")

    def axis(c: np.ndarray[Any, Any], label: str) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
        levels = np.unique(c)
        gaps = np.diff(levels)
        # Printed coordinates scatter in their last digit: levels nearer than a hundredth of the widest gap are one.
        step = float(np.median(gaps[gaps > 0.01 * gaps.max()])) if len(gaps) else 0.0
        if step <= 0.0:
            raise ReadError(f"{path}: needed at least two different {label}, got one")
        index = np.rint((c - levels[0]) / step).astype(np.int64)
        off = np.abs(levels[0] + index * step - c)
        step = (levels[-1] - levels[0]) / index.max()
        index = np.rint((c - levels[0]) / step).astype(np.int64)
        off = np.abs(levels[0] + index * step - c)
        if off.max() > 0.05 * step:
            k = int(off.argmax())
            raise InvalidInputError(
                f"{path}: needed {label} on a regular grid (step about {step:g}), got {c[k]!r} at point {k}; "
                "scattered data must be gridded first"
            )
        return levels[0] + step * np.arange(index.max() + 1), index

    xs, column = axis(x, "x")
    ys, row = axis(y, "y")
    if len(xs) * len(ys) > 10 * len(x):
        raise InvalidInputError(
            f"{path}: needed points that fill a tenth of a grid at least, got {len(x)} points for {len(ys)} x {len(xs)} nodes; "
            "scattered data must be gridded first"
        )
    grid = np.full((len(ys), len(xs)), np.nan)
    order = row * len(xs) + column
    if len(np.unique(order)) != len(order):
        raise InvalidInputError(f"{path}: needed one value a node, got several points on the same node")
    grid[row, column] = values
    return GridMap(grid, xs, ys, geographic=geographic, sigma=sigma, name=name)


def read_table(path: Path) -> pd.DataFrame:
    """Read csv (compressed or not), text with or without a header, or parquet."""
    path = _existing(path)
    pandas = require("pandas", "io", "reading tables")
    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            parquet: pd.DataFrame = pandas.read_parquet(path)
            return parquet
        # A header is a first line with a word that is no number.
        options = {"comment": "#", "skipinitialspace": True, "sep": None, "engine": "python"}
        if path.name.lower().endswith((".csv", ".csv.gz")):
            options = {"comment": "#", "skipinitialspace": True}
        first = pandas.read_csv(path, nrows=1, header=None, dtype=str, **options)
        numeric = all(_is_number(v) for v in first.iloc[0])
        table: pd.DataFrame = pandas.read_csv(path, header=None if numeric else 0, **options)
    except (pandas.errors.ParserError, csv.Error, zlib.error, EOFError, OSError, ValueError) as error:
        raise ReadError(f"{path}: needed a readable table, got: {error}") from error
    if not len(table):
        raise ReadError(f"{path}: needed at least one row, got none")
    return table


def _is_number(text: object) -> bool:
    try:
        float(str(text))
    except ValueError:
        return False
    return True


def _pick(
    table: pd.DataFrame,
    asked: str | None,
    known: Sequence[str],
    what: str,
    where: object,
    fallback: str | None = None,
) -> str:
    """Choose a column: the one asked for, else the first known name, else the fallback."""
    names = {str(c).lower(): str(c) for c in table.columns}
    if asked is not None:
        if asked.lower() not in names:
            raise UnknownVariableError(f"{where}: needed a column among {', '.join(names.values())}, got '{asked}'")
        return names[asked.lower()]
    for name in known:
        if name in names:
            return names[name]
    if fallback is not None:
        return fallback
    raise UnknownVariableError(
        f"{where}: needed a column for {what}, got {', '.join(names.values())}; name it with {what}="
    )


def floats(table: pd.DataFrame, column: str, where: object) -> np.ndarray[Any, Any]:
    columns = {str(c): c for c in table.columns}
    try:
        return np.asarray(table[columns[column]], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{where}: needed numbers in column '{column}', got: {error}") from error


def read_track(
    path: str | Path,
    x: str | None = None,
    y: str | None = None,
    value: str | None = None,
    *,
    time: str | None = None,
    missing: Literal["error", "drop"] = "error",
) -> Track:
    r"""Read an indicated track with measured values from CSV (also compressed), other text or Parquet.

    Parameters
    ----------
    path : the file.
    x, y, value, time : column names. By default the usual ones are looked for (longitude, lon, x, easting, ...;
        total_field_anomaly_nt, value, ...; time_s, time, ...); time is optional.
    missing : what to do with rows where position or value is missing: 'error' names the first, 'drop' leaves them out.

    Raises
    ------
    MissingFileError, ReadError, UnknownVariableError, InvalidInputError, MissingDependencyError

    Examples
    --------
    >>> import pathlib, tempfile, geomag
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "log.csv")
    ...     _ = path.write_text("time_s,longitude,latitude,anomaly\n0,16.10,47.2,31.5\n8,16.11,47.2,35.0\n")
    ...     track = geomag.read_track(path)
    >>> len(track), track.values.tolist(), track.time_s.tolist()
    (2, [31.5, 35.0], [0.0, 8.0])
    """
    return track_from_pandas(read_table(Path(path)), x, y, value, time=time, missing=missing, where=str(path))


def track_from_pandas(
    table: pd.DataFrame,
    x: str | None = None,
    y: str | None = None,
    value: str | None = None,
    *,
    time: str | None = None,
    missing: Literal["error", "drop"] = "error",
    where: str = "table",
) -> Track:
    """Make a track of the columns of a DataFrame; arguments as for `read_track`."""
    x_name = _pick(table, x, _X_NAMES, "x", where)
    y_name = _pick(table, y, _Y_NAMES, "y", where)
    value_name = _pick(table, value, _VALUE_NAMES, "value", where)
    if missing not in ("error", "drop"):
        raise InvalidInputError(f"missing: needed 'error' or 'drop', got '{missing}'")
    names = {str(c).lower(): str(c) for c in table.columns}
    time_name = (
        _pick(table, time, (), "time", where) if time else next((names[n] for n in _TIME_NAMES if n in names), None)
    )
    columns = [floats(table, c, where) for c in (x_name, y_name, value_name)]
    seconds = None if time_name is None else _seconds(table, time_name, where)
    bad = ~np.isfinite(np.column_stack(columns)).all(axis=1)
    if bad.any():
        if missing == "error":
            k = int(bad.argmax())
            raise InvalidInputError(
                f"{where}: needed a position and a value in every row, got x {columns[0][k]}, y {columns[1][k]}, value "
                f"{columns[2][k]} in data row {k} ({int(bad.sum())} such rows); missing='drop' leaves them out"
            )
        columns = [c[~bad] for c in columns]
        seconds = None if seconds is None else seconds[~bad]
    px, py, values = columns
    return Track(px, py, values, time_s=seconds)


def _seconds(table: pd.DataFrame, column: str, where: object) -> np.ndarray[Any, Any]:
    """Numbers are seconds as they stand; dates become seconds since the first."""
    pandas = require("pandas", "io", "reading times")
    series = table[{str(c): c for c in table.columns}[column]]
    if pandas.api.types.is_numeric_dtype(series):
        return np.asarray(series, dtype=np.float64)
    if not len(series):
        return np.empty(0)
    try:
        stamps = pandas.to_datetime(series, utc=True)
    except (ValueError, TypeError) as error:
        raise InvalidInputError(f"{where}: needed seconds or dates in column '{column}', got: {error}") from error
    return np.asarray((stamps - stamps.iloc[0]).dt.total_seconds(), dtype=np.float64)


def track_to_pandas(track: Track, *, geographic: bool = False) -> pd.DataFrame:
    """Return the samples as a DataFrame with columns x, y (or longitude, latitude), value and, where known, time_s."""
    pandas = require("pandas", "io", "track_to_pandas")
    x_name, y_name = ("longitude", "latitude") if geographic else ("x", "y")
    table: pd.DataFrame = pandas.DataFrame({x_name: track.x, y_name: track.y, "value": track.values})
    if track.time_s is not None:
        table["time_s"] = track.time_s
    return table
