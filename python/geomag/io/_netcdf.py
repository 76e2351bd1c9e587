"""netCDF as the CF conventions have it, GMT's old grids, and DataArrays of xarray."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geomag._errors import DataWarning, GeomagError, InvalidInputError, ReadError, UnknownVariableError
from geomag._geomag import GridMap
from geomag._optional import require
from geomag.io import _kept
from geomag.io._axes import find_axes, kind_of, mapping_crs
from geomag.io._make import MOST, make_map
from geomag.io._units import crs_metres, crs_of, metres_in, metric_text

if TYPE_CHECKING:
    import xarray as xr


def read_netcdf(
    path: Path, variable: str | None, geographic: bool | None, sigma: str | float | None, x: str | None, y: str | None
) -> GridMap:
    """A map of a netCDF file."""
    xarray = require("xarray", "io", "reading netCDF")
    netcdf = require("netCDF4", "io", "reading netCDF")
    try:
        with (
            warnings.catch_warnings(),
            xarray.open_dataset(
                path, engine="netcdf4", mask_and_scale=False, decode_times=False, decode_coords=False, cache=False
            ) as file,
        ):
            warnings.simplefilter("ignore")
            old = "x_range" in file and "dimension" in file and "z" in file
            variable = "z" if old else _asked(file, variable, sigma, path)
            dataset = _needed(file, variable, sigma, old, path)
    except GeomagError:
        raise
    except Exception as error:  # the libraries underneath raise their own kinds
        raise ReadError(f"{path}: needed a readable netCDF file, got: {error}") from error
    if old:
        return _old_gmt(dataset, path, geographic, sigma, netcdf.default_fillvals)
    array = _decoded(dataset, variable, netcdf.default_fillvals, str(path))
    kept = _kept.of_dataset(dataset, variable)
    layer: Any = sigma
    if isinstance(sigma, str):
        layer = _decoded(dataset, sigma, netcdf.default_fillvals, str(path))
    elif sigma is None and not kept:
        layer = _standard_error(dataset, variable, netcdf.default_fillvals, str(path))
    mapping = str(dataset[variable].attrs.get("grid_mapping", "")).split(":")[0].strip()
    crs = None
    if mapping:
        if mapping not in dataset.variables:
            raise InvalidInputError(f"{path}: needed the grid mapping '{mapping}' that '{variable}' names, got none")
        crs = mapping_crs(dataset[mapping].attrs, str(path))
    grid = _of_array(array, geographic, layer, x, y, crs, f"{path}, variable '{variable}'", ours=bool(kept))
    return _kept.restored(grid, dataset, variable, kept, override=sigma is not None) if kept else grid


def _asked(file: xr.Dataset, variable: str | None, sigma: str | float | None, path: Path) -> str:
    """The variable asked for, else the only field that there is."""
    if isinstance(sigma, str) and sigma not in file:
        raise UnknownVariableError(
            f"{path}: needed a variable among {', '.join(_fields(file))} for sigma, got '{sigma}'"
        )
    if variable is not None:
        if variable not in file:
            raise UnknownVariableError(f"{path}: needed a variable among {', '.join(_fields(file))}, got '{variable}'")
        return variable
    candidates = [n for n in _fields(file) if n != sigma]
    if len(candidates) != 1:
        raise UnknownVariableError(
            f"{path}: needed variable= for one of its fields, got none; it has {', '.join(_fields(file)) or 'no field'}"
        )
    return candidates[0]


def _needed(file: xr.Dataset, variable: str, sigma: str | float | None, old: bool, path: Path) -> xr.Dataset:
    """The variables that a field's map is made of, in memory; the rest of a file may be larger than that."""
    if old:
        names = ["x_range", "y_range", "dimension", "z"]
    else:
        attributes = file[variable].attrs
        names = [
            variable, *([sigma] if isinstance(sigma, str) else []), *str(attributes.get("ancillary_variables", "")).split(),
            str(attributes.get("grid_mapping", "")).split(":")[0].strip(), *_kept.layers_of(file, variable),
        ]  # fmt: skip
    names = [n for n in dict.fromkeys(names) if n in file.variables]
    for name in dict.fromkeys([*names, *(d for n in names for d in file[n].dims if d in file.variables)]):
        if file[name].size > MOST:
            raise ReadError(f"{path}: needed at most {MOST:,} numbers in '{name}', got {file[name].size:,}")
    return file[names].load()


def _fields(dataset: xr.Dataset) -> list[str]:
    """Variables that may be the field: two dimensions or more, numbers, and neither bounds, errors nor coordinates of another."""
    aside: set[str] = set()
    for v in dataset.variables.values():
        for key in (
            "bounds",
            "climatology",
            "ancillary_variables",
            "coordinates",
            "grid_mapping",
            "cell_measures",
            "formula_terms",
        ):
            aside |= set(str(v.attrs.get(key, "")).replace(":", " ").split())
    return [
        str(n)
        for n, v in dataset.variables.items()
        if sum(s > 1 for s in v.shape) >= 2
        and v.dtype.kind in "iuf"
        and str(n) not in aside
        and str(n) not in dataset.dims
    ]


def _raw_limits(v: Any) -> tuple[float | None, float | None]:  # noqa: ANN401 - a variable of xarray
    low = high = None
    if "valid_range" in v.attrs:
        limits = np.atleast_1d(np.asarray(v.attrs["valid_range"], dtype=np.float64))
        low, high = (float(limits[0]), float(limits[1])) if limits.size == 2 else (None, None)
    if "valid_min" in v.attrs:
        low = float(np.asarray(v.attrs["valid_min"]).flat[0])
    if "valid_max" in v.attrs:
        high = float(np.asarray(v.attrs["valid_max"]).flat[0])
    return low, high


def unpacked(v: Any, fills: dict[str, Any], where: str) -> NDArray[Any]:  # noqa: ANN401 - a variable of xarray
    """Values of a variable: fill and missing values, values outside its valid range and default fills as NaN; packing undone."""
    raw = np.asarray(v.values)
    if raw.dtype.kind not in "iuf":
        raise InvalidInputError(f"{where}: needed numbers, got {raw.dtype}")
    if str(v.attrs.get("_Unsigned", "")).lower() == "true" and raw.dtype.kind == "i":
        raw = raw.view(f"u{raw.dtype.itemsize}")
    hole = np.isnan(raw) if raw.dtype.kind == "f" else np.zeros(raw.shape, dtype=bool)
    told = [np.atleast_1d(np.asarray(v.attrs[k])) for k in ("_FillValue", "missing_value") if k in v.attrs]
    for fill in told:
        if fill.dtype.kind in "iuf":
            same = fill.astype(raw.dtype) if raw.dtype.kind == "f" else fill
            hole |= np.isin(raw, same[~np.isnan(same)] if same.dtype.kind == "f" else same)
    key = raw.dtype.str[1:]
    if "_FillValue" not in v.attrs and key in fills and raw.dtype.itemsize > 1:
        hole |= raw == np.asarray(fills[key]).astype(raw.dtype)
    low, high = _raw_limits(v)
    beyond = np.zeros(raw.shape, dtype=bool)
    if low is not None:
        beyond |= raw < low
    if high is not None:
        beyond |= raw > high
    beyond &= ~hole
    if beyond.any():
        warnings.warn(
            f"{where}: {int(beyond.sum())} of {raw.size} values are outside the valid range that the file gives and are left out",
            DataWarning,
            stacklevel=6,
        )
    scale, zero = (
        float(np.asarray(v.attrs.get(k, d)).flat[0]) for k, d in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    out = raw if raw.dtype in (np.float32, np.float64) else raw.astype(np.float64)
    if (scale, zero) != (1.0, 0.0):
        out = out.astype(np.float64) * scale + zero
    hole |= beyond
    if hole.any():
        out = np.where(hole, np.asarray(np.nan, dtype=out.dtype), out)
    return out.astype(out.dtype.newbyteorder("="))


_PACKING = (
    "_FillValue",
    "missing_value",
    "valid_range",
    "valid_min",
    "valid_max",
    "scale_factor",
    "add_offset",
    "_Unsigned",
)


def _decoded(dataset: xr.Dataset, name: str, fills: dict[str, Any], where: str) -> xr.DataArray:
    """A variable with its own and its coordinates' packing undone."""
    xarray = require("xarray", "io", "reading netCDF")
    v = dataset[name].variable
    coords = {}
    for dim in v.dims:
        if dim in dataset.variables and dataset.variables[dim].dims == (dim,):
            axis = dataset.variables[dim]
            plain = {k: a for k, a in axis.attrs.items() if k not in _PACKING}
            numbers = unpacked(axis, fills, f"{where}, '{dim}'") if axis.dtype.kind in "iuf" else axis.values
            coords[dim] = (dim, numbers, plain)
    attributes = {k: a for k, a in v.attrs.items() if k not in (*_PACKING, _kept.MARK)}
    values = unpacked(v, fills, f"{where}, '{name}'")
    array: xr.DataArray = xarray.DataArray(values, coords=coords, dims=v.dims, name=name, attrs=attributes)
    return array


def _standard_error(dataset: xr.Dataset, variable: str, fills: dict[str, Any], where: str) -> xr.DataArray | None:
    """The variable that the field names as its standard error, where there is one."""
    for name in str(dataset[variable].attrs.get("ancillary_variables", "")).split():
        if name in dataset and str(dataset[name].attrs.get("standard_name", "")).split()[-1:] == ["standard_error"]:
            return _decoded(dataset, name, fills, where)
    return None


def _old_gmt(
    dataset: xr.Dataset, path: Path, geographic: bool | None, sigma: str | float | None, fills: dict[str, Any]
) -> GridMap:
    """A grid as GMT wrote it before version 4.1: one long vector from the top left, its region in variables of their own."""
    where = str(path)
    try:
        columns, rows = (int(n) for n in dataset["dimension"].values)
        (x0, x1), (y0, y1) = (np.asarray(dataset[k].values, dtype=np.float64) for k in ("x_range", "y_range"))
    except (KeyError, ValueError, TypeError) as error:
        raise ReadError(f"{where}: needed a grid of GMT, got: {error}") from error
    z = dataset["z"]
    values = unpacked(z.variable, fills, f"{where}, 'z'")
    if columns < 2 or rows < 2 or values.size != columns * rows:
        raise ReadError(f"{where}: needed {columns} x {rows} values, got {values.size}")
    pixel = bool(np.asarray(z.attrs.get("node_offset", 0)).flat[0])
    x, y = (
        a + (b - a) / n * (np.arange(n) + 0.5) if pixel else np.linspace(a, b, n)
        for a, b, n in ((x0, x1, columns), (y0, y1, rows))
    )
    units = tuple(str(dataset[k].attrs.get("units", "")).strip() for k in ("x_range", "y_range"))
    words = {u.lower() for u in units}
    named: bool | None = (
        True
        if words & {"longitude", "lon", "latitude", "lat"} or any(w.startswith("longitude") for w in words)
        else None
    )
    if named is not None:
        units = ("degrees_east", "degrees_north")
    elif words <= {"", "user_x_unit", "user_y_unit", "x", "y"}:
        units = ("", "")
    geographic = kind_of(units, named, None, geographic, where)  # type: ignore[arg-type]
    if not geographic:
        x, y = x * metres_in(units[0], where), y * metres_in(units[1], where)
    if isinstance(sigma, str):
        raise UnknownVariableError(f"{where}: needed a number for sigma, got '{sigma}'")
    return make_map(
        values.reshape(rows, columns)[::-1], x, y, geographic=geographic, sigma=sigma, name=path.stem, where=where
    )


def grid_from_xarray(
    data_array: xr.DataArray,
    *,
    geographic: bool | None = None,
    sigma: xr.DataArray | float | None = None,
    x: str | None = None,
    y: str | None = None,
    crs: object = None,
) -> GridMap:
    """Make a map of a two-dimensional DataArray; its dimensions may be in either order.

    Which dimension is x is read from the attributes `axis`, `standard_name` and `units` of its coordinates, then from their names;
    where nothing says so, `x=` names it. Units of length are turned to metres, and a `crs` (argument or attribute) with them. A map of the whole
    circle of longitude is carried on for ten degrees beyond its seam. What `GridMap.to_xarray` kept of sigma and error model comes back.
    """
    return _of_array(data_array, geographic, sigma, x, y, crs, f"data array '{data_array.name}'")


def _of_array(
    data_array: xr.DataArray,
    geographic: bool | None,
    sigma: xr.DataArray | float | None,
    x: str | None,
    y: str | None,
    crs: object,
    where: str,
    *,
    ours: bool = False,
) -> GridMap:
    """The map of an array; of one that geomag wrote (`ours`) nothing is taken for a dummy or turned into another unit."""
    kept = _kept.of_array(data_array)
    array = data_array.squeeze(drop=True)
    if array.ndim != 2:
        raise InvalidInputError(f"{where}: needed two dimensions, got {dict(data_array.sizes)}")
    dims = (str(array.dims[0]), str(array.dims[1]))
    for dim in dims:
        if dim not in array.coords:
            raise InvalidInputError(f"{where}: needed coordinates along '{dim}', got none")
        if np.asarray(array[dim]).dtype.kind not in "iuf":
            raise InvalidInputError(f"{where}: needed numbers as coordinates along '{dim}', got {array[dim].dtype}")
    x_name, y_name, named = find_axes(dims, {d: array[d].attrs for d in dims}, where, x, y)
    array = array.transpose(y_name, x_name)
    xs, ys = np.asarray(array[x_name]), np.asarray(array[y_name])
    units = tuple(None if (u := array[d].attrs.get("units")) is None else str(u) for d in (x_name, y_name))
    crs = data_array.attrs.get("crs") if crs is None else crs
    system: Any = None if crs is None else crs if hasattr(crs, "is_geographic") else crs_of(str(crs))
    text = crs if isinstance(crs, str) else None if system is None else system.to_string()
    geographic = kind_of(units, named, system, geographic, where)  # type: ignore[arg-type]
    if not geographic:
        plain = [u is None or not u.strip() for u in units]
        own = 1.0 if system is None else crs_metres(system, where)
        factors = [
            own if p else metres_in(u, f"{where}, '{d}'")
            for u, p, d in zip(units, plain, (x_name, y_name), strict=True)
        ]
        xs = xs if factors[0] == 1.0 else xs * factors[0]
        ys = ys if factors[1] == 1.0 else ys * factors[1]
        text = None if text is None else metric_text(text)
    values = np.asarray(array)
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    layer: Any = sigma
    if layer is not None and hasattr(layer, "dims"):
        layer = np.asarray(layer.squeeze(drop=True).transpose(y_name, x_name), dtype=np.float64)
    name = str(data_array.name) if data_array.name is not None else None
    unit = data_array.attrs.get("units")
    units_ = None if unit is None else str(unit)
    if ours or kept:
        grid = GridMap(values, xs, ys, geographic=geographic, sigma=layer, name=name, units=units_, crs=text)
    else:
        grid = make_map(
            values, xs, ys, geographic=geographic, sigma=layer, name=name, units=units_, crs=text, where=where
        )
    return _kept.restored_array(grid, data_array, kept, override=sigma is not None) if kept else grid


def grid_to_xarray(grid: GridMap) -> xr.DataArray:
    """Return the map as a DataArray with all that it knows: units, name, system, and its errors as further coordinates."""
    xarray = require("xarray", "io", "GridMap.to_xarray")
    x_name, y_name = ("longitude", "latitude") if grid.geographic else ("easting", "northing")
    array: xr.DataArray = xarray.DataArray(
        grid.values, coords={y_name: grid.y, x_name: grid.x}, dims=(y_name, x_name), name=grid.name or "field"
    )
    for name, axis, unit, standard in (
        (x_name, "X", "degrees_east", "longitude"), (y_name, "Y", "degrees_north", "latitude"),
    ):  # fmt: skip
        projected = f"projection_{axis.lower()}_coordinate"
        array[name].attrs.update(units=unit if grid.geographic else "m", axis=axis,
                                 standard_name=standard if grid.geographic else projected)  # fmt: skip
    if grid.units:
        array.attrs["units"] = grid.units
    if grid.crs:
        array.attrs["crs"] = grid.crs
    return _kept.put(grid, array)
