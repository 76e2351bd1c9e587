"""What a map knows beyond its values, into a file and back to the last bit: axes, sigma, error model, height.

Layers on the map's grid are variables of their own (in netCDF the field's `ancillary_variables`); numbers are attributes. Axes are kept as
start and step, from which a map is rebuilt as it was.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import ReadError
from geomag._geomag import GridMap

if TYPE_CHECKING:
    import xarray as xr

#: The attribute that says what was kept, as JSON.
MARK = "geomag_map"
_FORMAT = 1


def _known(grid: GridMap) -> dict[str, Any]:
    """What there is to keep beside values, names and units: plain numbers, and layers as arrays."""
    known: dict[str, Any] = {}
    if grid.sigma is not None:
        known["sigma"] = grid.sigma
    if grid.correlation_m is not None:
        known["correlation_m"] = grid.correlation_m
    if grid.height_m is not None:
        known["height_m"] = grid.height_m
    if grid.line_spacing_m is not None:
        known["line_spacing_m"] = grid.line_spacing_m
    if grid.ground_scale is not None:
        known["ground_scale"] = grid.ground_scale
    model = grid.error_model
    for key, value in (model or {}).items():
        if value is not None:
            known[f"error_model.{key}"] = value
    return known


def _plain(value: Any) -> Any:  # noqa: ANN401 - a number, a list of numbers, a word
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return value


def put(grid: GridMap, array: xr.DataArray) -> xr.DataArray:
    """The array with all that the map knows as attributes and as coordinates on its grid."""
    known = _known(grid)
    axes = grid.__reduce__()[1][1]  # ((first, step), (first, step))
    numbers: dict[str, Any] = {}
    layers: dict[str, str] = {}
    coords = {}
    for key, value in known.items():
        if key != "ground_scale" and isinstance(value, np.ndarray) and value.shape == grid.shape:
            name = f"{array.name}_{key.replace('.', '_')}"
            layers[key] = name
            attributes = {"long_name": f"{key} of {array.name}"}
            if key == "sigma":
                attributes |= {"standard_name": "standard_error"} | ({"units": grid.units} if grid.units else {})
            elif key.endswith("_m"):
                attributes["units"] = "m"
            coords[name] = (array.dims, value, attributes)
        else:
            numbers[key] = _plain(value)
    if coords:
        array = array.assign_coords(coords)
    array.attrs[MARK] = json.dumps(
        {"format": _FORMAT, "axes": axes, "shape": grid.shape, "numbers": numbers, "layers": layers, "name": grid.name, "crs": grid.crs,
         "geographic": grid.geographic}
    )  # fmt: skip
    return array


def _read(text: object, where: str) -> dict[str, Any]:
    if text is None:
        return {}
    try:
        kept = json.loads(str(text))
        if kept["format"] > _FORMAT:
            raise ReadError(f"{where}: needed '{MARK}' of this or an older version, got format {kept['format']}")
        (x0, dx), (y0, dy) = kept["axes"]
        good = all(math.isfinite(v) for v in (x0, dx, y0, dy)) and isinstance(kept["numbers"], dict)
        if not good or not isinstance(kept["layers"], dict) or len(kept["shape"]) != 2:
            raise ReadError(f"{where}: needed what a map kept in '{MARK}', got {text!r}")
        return dict(kept)
    except (ValueError, KeyError, TypeError) as error:
        raise ReadError(f"{where}: needed what a map kept in '{MARK}', got {text!r} ({error})") from error


def of_array(array: xr.DataArray) -> dict[str, Any]:
    """What was kept in a DataArray; nothing where it is not as the map left it (cut, turned, thinned)."""
    kept = _read(array.attrs.get(MARK), f"data array '{array.name}'")
    return kept if kept and _same_axes(kept, array) else {}


def of_dataset(dataset: xr.Dataset, variable: str) -> dict[str, Any]:
    """What was kept in a file for a variable."""
    v = dataset[variable]
    kept = _read(v.attrs.get(MARK), f"variable '{variable}'")
    return kept if kept and _same_axes(kept, v) else {}


def layers_of(dataset: xr.Dataset, variable: str) -> list[str]:
    """Variables of a file that hold the layers of a map that was kept in it."""
    return list(_read(dataset[variable].attrs.get(MARK), f"variable '{variable}'").get("layers", {}).values())


def _same_axes(kept: dict[str, Any], array: xr.DataArray) -> bool:
    """Whether an array lies on the axes that were kept."""
    if array.ndim != 2 or list(array.shape) != list(kept["shape"]):
        return False
    for dim, (first, step) in zip(array.dims[::-1], kept["axes"], strict=True):
        if dim not in array.coords or not np.array_equal(
            np.asarray(array[dim], dtype=np.float64), first + step * np.arange(array.sizes[dim])
        ):
            return False
    return True


def restored_array(grid: GridMap, array: xr.DataArray, kept: dict[str, Any], *, override: bool) -> GridMap:
    """The map with what was kept in the coordinates of a DataArray."""
    return _rebuilt(grid, kept, lambda name: array.coords[name].values if name in array.coords else None, override)


def restored(grid: GridMap, dataset: xr.Dataset, variable: str, kept: dict[str, Any], *, override: bool) -> GridMap:
    """The map with what was kept in a file; a sigma that the caller gives goes before the kept one."""
    del variable
    return _rebuilt(grid, kept, lambda name: dataset[name].values if name in dataset.variables else None, override)


def _rebuilt(grid: GridMap, kept: dict[str, Any], layer: Any, override: bool) -> GridMap:  # noqa: ANN401 - a function
    known: dict[str, Any] = dict(kept["numbers"])
    for key, name in kept["layers"].items():
        values = layer(name)
        if values is None:
            raise ReadError(f"map '{grid.name}': needed the layer '{name}' that it was kept with, got none")
        known[key] = np.asarray(values)
    model = {k.partition(".")[2]: _tuple(v) for k, v in known.items() if k.startswith("error_model.")}
    # A sigma that the caller gives stands for all that is known of the errors.
    errors = (grid.sigma, grid.correlation_m) if override else (known.get("sigma"), known.get("correlation_m"))
    (x0, dx), (y0, dy) = kept["axes"]
    text = (kept.get("name", grid.name), grid.units, kept.get("crs", grid.crs))
    scale = known.get("ground_scale")
    restore: Any = GridMap._restore
    out: GridMap = restore(
        values=grid.values, axes=((x0, dx), (y0, dy)), geographic=grid.geographic, errors=errors, text=text, model=None,
        height_m=known.get("height_m"), ground_scale=None if scale is None else np.array(scale), line_spacing_m=known.get("line_spacing_m"),
    )  # fmt: skip
    return out.with_error_model(**model) if model and not override else out


def labelled(grid: GridMap, *, name: str | None, units: str | None, crs: str | None) -> GridMap:
    """The same map under a name, with the unit of its values and its coordinate reference system."""
    parts = list(grid.__reduce__()[1])
    parts[4] = (name, units, crs)
    restore: Any = GridMap._restore
    out: GridMap = restore(*parts)
    return out


def _tuple(value: Any) -> Any:  # noqa: ANN401 - a number or several
    return tuple(value) if isinstance(value, list) else value
