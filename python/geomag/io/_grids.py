"""Maps from files of any kind, and to files that keep all that a map knows."""

from __future__ import annotations

import re
from pathlib import Path

from geomag._errors import InvalidInputError, ReadError, UnknownVariableError
from geomag._geomag import GridMap
from geomag._optional import require
from geomag.io._classic import check_classic
from geomag.io._gxf import read_gxf
from geomag.io._headed import looks_like_esri, looks_like_gdf, read_esri, read_gdf, read_surfer_text
from geomag.io._kept import MARK
from geomag.io._magnav import is_magnav_map, read_magnav_map
from geomag.io._make import make_map
from geomag.io._netcdf import grid_to_xarray, read_netcdf
from geomag.io._points import lattice
from geomag.io._raster import looks_like_oasis, read_oasis, read_raster
from geomag.io._tables import load_table
from geomag.io._text import Table, decoded, existing, parse, plain_bytes
from geomag.io._tracks import points_of
from geomag.io._units import ask_kind

_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_SURFER = (b"DSBB", b"DSRB")
_PACKED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00", b"PK\x03\x04")


def read_grid(
    path: str | Path,
    variable: str | None = None,
    *,
    geographic: bool | None = None,
    sigma: str | float | None = None,
    columns: tuple[str | int, str | int, str | int] | None = None,
    x: str | None = None,
    y: str | None = None,
) -> GridMap:
    r"""Read a map from a file.

    What the file says of its coordinates and values is believed: units, standard names, axis attributes, coordinate reference
    system, units in names. Where it does not say, an error asks, naming the keyword to give. A caller may repeat what the file says, but not
    contradict it.

    Parameters
    ----------
    path : netCDF (CF conventions, GMT old and new, `GridMap.save`), GeoTIFF, Surfer .grd (6 text, 6 and 7 binary), GXF, Oasis montaj
        .grd, ERMapper .ers, ESRI ASCII, ICGEM .gdf, MagNav .h5, or text with x, y, value, compressed or not (EMAG2 and WDMAM tables among
        them). The kind is found from the file's first bytes, not from its name.
    variable : which variable of a netCDF file, or which band of a raster (its number or description); needed where
        there are several.
    geographic : whether coordinates are degrees of longitude and latitude; needed where the file does not say.
    sigma : standard deviation of the values: a number, or the name of a netCDF variable on the same grid. A variable that the field
        names as its standard error is taken by itself.
    columns : names of the x, y and value columns of a text file, or their numbers from 0 where it has no header. A text of three columns
        without a header is x, y, value.
    x, y : names of the dimensions of a netCDF variable, where nothing says which is which.

    Returns
    -------
    GridMap
        Both axes ascending, holes as NaN, float32 or float64 as in the file; kilometres, feet and other units of
        length are turned to metres, and the coordinate reference system with them. Dummies of other programs (99999, -1e32, 1.70141e38, ...) are
        holes, and told by a `DataWarning`. A map of the whole circle of longitude goes on for ten degrees of itself beyond either end.

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
    path = existing(path)
    with path.open("rb") as file:
        head = file.read(512)
    if head[:3] == b"CDF" or head[:4] == b"\x89HDF":
        if columns is not None:
            raise InvalidInputError(f"columns: needed none for netCDF, which has variables, got {columns}")
        if head[:3] == b"CDF":
            check_classic(path)
        if head[:4] == b"\x89HDF" and is_magnav_map(path):
            return read_magnav_map(path, geographic, sigma)
        return read_netcdf(path, variable, geographic, sigma, x, y)
    if x is not None or y is not None:
        raise InvalidInputError(
            "x, y: needed none for this kind of file, which has no dimensions; a table has columns="
        )
    constant = None if sigma is None else _number("sigma", sigma)
    if head[:4] in _TIFF or head[:4] in _SURFER or head.lstrip()[:13] == b"DatasetHeader":
        return read_raster(path, variable, geographic, constant)
    if variable is not None:
        raise InvalidInputError(f"variable: needed none for this kind of file, which has one field, got '{variable}'")
    if looks_like_oasis(head):
        return read_oasis(path, geographic, constant)
    if path.suffix.lower() in (".nc", ".nc4", ".cdf", ".netcdf"):
        raise ReadError(
            f"{path}: needed a netCDF file, as its name says, got {'other content' if head else 'an empty file'}"
        )
    if path.suffix.lower() in (".parquet", ".pq"):
        return _of_points(load_table(path), geographic, constant, columns)
    if b"\0" in head and not head.startswith((*_PACKED, b"\xff\xfe", b"\xfe\xff")):
        raise ReadError(f"{path}: needed netCDF, GeoTIFF, Surfer, GXF, Oasis or text, got unknown binary content")
    text = decoded(plain_bytes(path.read_bytes(), str(path)), str(path))
    if path.suffix.lower() == ".gxf" or "#GRID" in text or "#POINTS" in text[:2000]:
        return read_gxf(path, text, geographic, constant)
    if text.lstrip()[:4] == "DSAA":
        return read_surfer_text(path, text, geographic, constant)
    if looks_like_esri(text):
        return read_esri(path, text, geographic, constant)
    if looks_like_gdf(text):
        return read_gdf(path, text, geographic, constant)
    return _of_points(parse(text, str(path)), geographic, constant, columns)


def _number(what: str, value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{what}: needed a number for this kind of file, got {value!r}") from error


def _of_points(
    table: Table,
    geographic: bool | None,
    sigma: float | None,
    columns: tuple[str | int, str | int, str | int] | None,
) -> GridMap:
    if len(table.columns) < 3:
        raise ReadError(
            f"{table.where}: needed columns x, y and value, got {len(table.columns)} column(s): {', '.join(c.name for c in table.columns)}"
        )
    chosen: tuple[str | int | None, str | int | None, str | int | None] = (None, None, None)
    if columns is not None:
        if len(columns) != 3:
            raise InvalidInputError(f"columns: needed three, of x, y and value, got {columns}")
        chosen = (columns[0], columns[1], columns[2])
    elif not table.named:
        if len(table.columns) != 3:
            raise InvalidInputError(
                f"{table.where}: needed to know which of its {len(table.columns)} columns are x, y and value, got no header; name them by "
                "their numbers from 0, such as columns=(2, 3, 5)"
            )
        chosen = (0, 1, 2)
    try:
        points = points_of(table, *chosen, geographic=geographic, height_too=True)
    except UnknownVariableError as error:
        told = re.sub(r"; name (it|one) with \w+=$", "", str(error))
        raise UnknownVariableError(
            f"{told}; give it a header of known names, or name them with columns=(x, y, value)"
        ) from error
    if points.geographic is None:
        raise ask_kind(table.where)
    grid, xs, ys = lattice(points.x, points.y, points.values, table.where)
    name = points.columns[2].name
    return make_map(
        grid, xs, ys, geographic=points.geographic, sigma=sigma, name=None if name.isdigit() else name, units=points.unit,
        where=table.where,
    )  # fmt: skip


def save_grid(grid: GridMap, path: str | Path) -> None:
    """Write a map to a netCDF file (CF conventions) with all that it knows; `open_grid` gives it back to the last bit.

    Standard deviation and layers of the error model are ancillary variables of the field; the coordinate reference system is its grid
    mapping.
    """
    array = grid_to_xarray(grid)
    xarray = require("xarray", "io", "GridMap.save")
    require("netCDF4", "io", "GridMap.save")
    name = str(array.name)
    layers = [str(c) for c in array.coords if c not in array.dims]
    dataset = xarray.Dataset({name: array.drop_vars(layers)})
    for layer in layers:
        dataset[layer] = (array.dims, array.coords[layer].values, array.coords[layer].attrs)
    dataset[name].attrs.pop("crs", None)
    if layers:
        dataset[name].attrs["ancillary_variables"] = " ".join(layers)
    if grid.crs:
        from geomag.io._units import crs_of

        dataset["crs"] = ((), 0, {"crs_wkt": crs_of(grid.crs).to_wkt(version="WKT2_2019")})
        dataset[name].attrs["grid_mapping"] = "crs"
    dataset.attrs["Conventions"] = "CF-1.11"
    encoding = {n: {"zlib": True, "_FillValue": np_nan(dataset[n].dtype)} for n in (name, *layers)}
    target = Path(path)
    part = target.with_name(target.name + ".part")
    try:
        dataset.to_netcdf(part, engine="netcdf4", encoding=encoding)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def np_nan(dtype: object) -> object:
    """NaN of a kind of floating-point number."""
    import numpy as np

    return np.asarray(np.nan, dtype=dtype).item()  # type: ignore[call-overload]


def open_grid(path: str | Path) -> GridMap:
    """The map that `save_grid` wrote; ReadError for any other file."""
    path = existing(path)
    xarray = require("xarray", "io", "GridMap.open")
    try:
        with xarray.open_dataset(path, engine="netcdf4", decode_times=False, mask_and_scale=False) as dataset:
            found = [str(n) for n, v in dataset.variables.items() if MARK in v.attrs]
    except Exception as error:  # the libraries underneath raise their own kinds
        raise ReadError(f"{path}: needed a map that geomag saved, got: {error}") from error
    if len(found) != 1:
        raise ReadError(f"{path}: needed a map that geomag saved, got none; read_grid reads other files")
    return read_grid(path, found[0])
