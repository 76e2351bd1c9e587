"""Large grids block by block: chunks in, chunks out, within a bound of memory.

A local computation on a map (its value at a node needs the map only within some reach of it) is done block by block,
each block with a border (halo) as wide as that reach. The result is the same, bit for bit, for any cut into blocks.
With a chunked (Dask) array the result is lazy and runs wherever Dask runs; with a plain array the blocks are done one
after the other.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError, NotFiniteError, ShapeError
from geomag._geomag import bound_block, bound_reach
from geomag._optional import require
from geomag._progress import reporter

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

__all__ = ["blockwise", "evaluate", "position_bound"]

Local = Callable[["NDArray[Any]", "NDArray[np.float64]", "NDArray[np.float64]"], Mapping[str, "NDArray[Any]"]]
"""A local computation: (values, x, y) of a block with its halo -> named arrays of the same shape."""

_DEFAULT_BLOCK = 512


def _cuts(length: int, sizes: Sequence[int]) -> list[tuple[int, int]]:
    ends = np.cumsum(sizes)
    if ends[-1] != length:
        raise ShapeError(f"chunks: needed sizes that add up to {length}, got {list(sizes)}")
    return [(int(end - size), int(end)) for size, end in zip(sizes, ends, strict=True)]


def _sizes(length: int, block: int) -> list[int]:
    return [min(block, length - start) for start in range(0, length, block)]


def _block(
    function: Local, names: tuple[str, ...], values: NDArray[Any], x: NDArray[np.float64], y: NDArray[np.float64],
    trim: tuple[slice, slice], dtype: str,
) -> NDArray[Any]:  # fmt: skip
    """One block: run, check, trim the halo off; stacked in the order of the names."""
    found = function(values, x, y)
    out = np.empty((len(names), trim[0].stop - trim[0].start, trim[1].stop - trim[1].start), dtype=dtype)
    for k, name in enumerate(names):
        if name not in found:
            raise InvalidInputError(f"block function: needed an array named '{name}', got {', '.join(found)}")
        array = np.asarray(found[name])
        if array.shape != values.shape:
            raise ShapeError(f"block function, '{name}': needed shape {values.shape} as the block, got {array.shape}")
        out[k] = array[trim]
    return out


def blockwise(
    data: xr.DataArray,
    function: Local,
    names: Sequence[str],
    *,
    halo: tuple[int, int] = (0, 0),
    block: int | tuple[int, int] | None = None,
    dtype: str = "float32",
    attributes: Mapping[str, Mapping[str, Any]] | None = None,
    progress: bool | Callable[[int, int], object] | None = None,
) -> xr.Dataset:
    """Run a local computation over a map, block by block.

    Parameters
    ----------
    data : (y, x) map; its last two coordinates are taken as y and x. Plain or chunked with Dask.
    function : (values, x, y) of a block with its halo -> mapping of the names to arrays of the same shape. It must be
        local: a node's result may depend on nodes within `halo` of it and on nothing else.
    names : of the results.
    halo : reach of the computation (rows, columns).
    block : size of the blocks (rows, columns) for a plain array; a chunked array keeps its own chunks.
    dtype : of the results.
    attributes : of each result, such as `{"error_m": {"units": "m"}}`.
    progress : True for a bar, or a callable (done, total); for plain arrays.

    Returns
    -------
    xarray.Dataset
        One variable a name, on the map's own coordinates; lazy where `data` is chunked.
    """
    xarray = require("xarray", "io", "maps block by block")
    if data.ndim != 2:
        raise ShapeError(f"map: needed two dimensions (y, x), got {data.dims} of shape {data.shape}")
    if min(halo) < 0:
        raise InvalidInputError(f"halo: needed numbers of rows and columns >= 0, got {halo}")
    wanted = tuple(names)
    y_name, x_name = (str(d) for d in data.dims)
    y, x = (np.asarray(data[d], dtype=np.float64) for d in (y_name, x_name))
    rows, columns = data.shape
    chunks = data.chunks
    lazy = chunks is not None
    if chunks is not None:
        row_sizes, column_sizes = (list(c) for c in chunks)
    else:
        size = (_DEFAULT_BLOCK,) * 2 if block is None else (block, block) if isinstance(block, int) else block
        if min(size) < 1:
            raise InvalidInputError(f"block: needed sizes >= 1, got {size}")
        row_sizes, column_sizes = _sizes(rows, size[0]), _sizes(columns, size[1])
    row_cuts, column_cuts = _cuts(rows, row_sizes), _cuts(columns, column_sizes)

    def reach(cut: tuple[int, int], by: int, length: int) -> tuple[slice, slice]:
        """The cut with its halo, and where the cut lies in that."""
        low, high = max(0, cut[0] - by), min(length, cut[1] + by)
        return slice(low, high), slice(cut[0] - low, cut[1] - low)

    def arguments(r: tuple[int, int], c: tuple[int, int]) -> tuple[Any, ...]:
        (row_slice, row_trim), (column_slice, column_trim) = reach(r, halo[0], rows), reach(c, halo[1], columns)
        source = data.data[row_slice, column_slice]
        return source, x[column_slice], y[row_slice], (row_trim, column_trim)

    if lazy:
        dask, array = (
            require("dask", "distributed", "chunked maps"),
            require("dask.array", "distributed", "chunked maps"),
        )
        run = dask.delayed(_block, pure=True)
        stacked = array.block([[
            array.from_delayed(
                run(function, wanted, *arguments(r, c), dtype), (len(wanted), r[1] - r[0], c[1] - c[0]), dtype=dtype)
            for c in column_cuts] for r in row_cuts])  # fmt: skip
    else:
        report = reporter(progress)
        stacked = np.empty((len(wanted), rows, columns), dtype=dtype)
        total = len(row_cuts) * len(column_cuts)
        for i, r in enumerate(row_cuts):
            for j, c in enumerate(column_cuts):
                source, xs, ys, trim = arguments(r, c)
                stacked[:, r[0] : r[1], c[0] : c[1]] = _block(function, wanted, np.asarray(source), xs, ys, trim, dtype)
                report(i * len(column_cuts) + j + 1, total)
    noted = attributes or {}
    variables = {name: ((y_name, x_name), stacked[k], dict(noted.get(name, {}))) for k, name in enumerate(wanted)}
    coordinates = {y_name: data[y_name], x_name: data[x_name]}
    result: xr.Dataset = xarray.Dataset(variables, coords=coordinates, attrs=dict(data.attrs))
    return result


def evaluate(
    function: Callable[[NDArray[np.float64], NDArray[np.float64]], Mapping[str, NDArray[Any]]],
    x: Sequence[float] | NDArray[Any],
    y: Sequence[float] | NDArray[Any],
    names: Sequence[str],
    *,
    block: int = _DEFAULT_BLOCK,
    lazy: bool = False,
    dtype: str = "float64",
    dims: tuple[str, str] = ("y", "x"),
    attributes: Mapping[str, Mapping[str, Any]] | None = None,
) -> xr.Dataset:
    """Evaluate a field model on the nodes of a grid, block by block.

    Parameters
    ----------
    function : (x, y), both of the block's shape -> mapping of the names to arrays of that shape.
    x, y : axes of the grid.
    names : of the results.
    block : rows and columns a block.
    lazy : whether the result is a Dask array, computed when it is asked for.
    dtype : of the results.
    dims : names of the dimensions (y, x).
    attributes : of each result.
    """
    xarray = require("xarray", "io", "maps block by block")
    xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    # A view of one number with the grid's shape: the model needs the nodes, not values.
    shell: Any = np.broadcast_to(np.float32(0), (ys.size, xs.size))
    if lazy:
        array = require("dask.array", "distributed", "lazy evaluation")
        shell = array.zeros((ys.size, xs.size), chunks=block, dtype="float32")
    data = xarray.DataArray(shell, coords={dims[0]: ys, dims[1]: xs}, dims=dims)

    def at_nodes(values: NDArray[Any], bx: NDArray[np.float64], by: NDArray[np.float64]) -> Mapping[str, NDArray[Any]]:
        grid_x, grid_y = np.meshgrid(bx, by)
        return function(grid_x, grid_y)

    return blockwise(data, at_nodes, names, block=block, dtype=dtype, attributes=attributes)


class _Bound:
    """The position bound of one block; picklable, so that Dask can send it."""

    def __init__(self, options: str, headings: Sequence[float], spacing: tuple[float, float], geographic: bool) -> None:
        self.options, self.headings, self.spacing, self.geographic = options, list(headings), spacing, geographic

    @staticmethod
    def names(headings: Sequence[float]) -> list[str]:
        return [f"{kind}_{heading:03g}" for heading in headings for kind in ("error_m", "samples")]

    def __call__(
        self, values: NDArray[Any], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> Mapping[str, NDArray[Any]]:
        found = bound_block(values, y, self.spacing, self.geographic, self.options)
        flat = [array for pair in found for array in pair]
        return dict(zip(self.names(self.headings), flat, strict=True))


def position_bound(
    data: xr.DataArray,
    *,
    heading_deg: Sequence[float] = (0.0, 90.0),
    samples: int = 20,
    spacing_m: float = 500.0,
    sigma: float = 5.0,
    map_error_m: float = 30.0,
    free_level: bool = True,
    tolerance_m: float = 500.0,
    geographic: bool = False,
    ground_scale: tuple[float, float] = (1.0, 1.0),
    block: int | tuple[int, int] | None = None,
    progress: bool | Callable[[int, int], object] | None = None,
) -> xr.Dataset:
    """Where on a map a fix can be had, how good, how soon: the Cramer-Rao bound of a straight track to every node.

    For maps of any size: block by block, lazily where `data` is chunked, with the same bits for any cut. It is a bound:
    no unbiased matcher does better, and it does not know of other places that fit as well. For the probability of a fix
    along a planned route simulate it.

    Parameters
    ----------
    data : (y, x) map with ascending axes; NaN is unknown.
    heading_deg : headings, clockwise from north; one pair of results each.
    samples, spacing_m : of the track that ends at the node.
    sigma : standard deviation of a reading, value units.
    map_error_m : error of the map as a distance: its standard deviation is this times the gradient.
    free_level : whether a constant of the readings is unknown.
    tolerance_m : twice the standard deviation within this is a fix.
    geographic : whether coordinates are degrees.
    ground_scale : metres on the ground per map unit (east, north) of a projected map: `GridMap.metres_per_unit` at its middle.
    block, progress : as in `blockwise`.

    Returns
    -------
    xarray.Dataset
        For every heading `error_m_<heading>`, root of the trace of the bound in metres (infinite where nothing is told,
        NaN where over a fifth of the track is unknown), and `samples_<heading>`, samples needed for the tolerance.
    """
    if data.ndim != 2 or min(data.shape) < 2:
        raise ShapeError(f"map: needed two dimensions (y, x) of at least two nodes, got {data.dims} of {data.shape}")
    y, x = (np.asarray(data[d], dtype=np.float64) for d in data.dims)
    spacing = (float(x[-1] - x[0]) / (x.size - 1), float(y[-1] - y[0]) / (y.size - 1))
    if min(spacing) <= 0:
        raise InvalidInputError(f"map: needed ascending axes, got spacings {spacing}; sort the array first")
    if not (len(ground_scale) == 2 and all(np.isfinite(s) and s > 0 for s in ground_scale)):
        raise InvalidInputError(f"ground_scale: needed two finite numbers > 0, got {ground_scale}")
    if not geographic:
        spacing = (spacing[0] * ground_scale[0], spacing[1] * ground_scale[1])
    told = {"spacing_m": spacing_m, "sigma": sigma, "map_error_m": map_error_m, "tolerance_m": tolerance_m}
    for name, value in (*told.items(), *(("heading_deg", h) for h in heading_deg)):
        if not np.isfinite(value):
            raise NotFiniteError(f"{name}: needed a finite number, got {value}")
    if samples < 2:
        raise InvalidInputError(f"samples: needed at least 2, got {samples}")
    track = {"heading_deg": [float(h) for h in heading_deg], "samples": int(samples), "spacing_m": float(spacing_m)}
    errors = {"sigma": float(sigma), "map_error_m": float(map_error_m), "free_level": bool(free_level)}
    options = json.dumps({**track, **errors, "tolerance_m": float(tolerance_m)})
    halo = bound_reach(options, spacing, geographic, float(np.abs(y).max()) if geographic else 0.0)
    names = _Bound.names([float(h) for h in heading_deg])
    if len(set(names)) != len(names):
        raise InvalidInputError(f"heading_deg: needed headings that differ in six digits, got {list(heading_deg)}")
    units = {name: {"units": "m" if name.startswith("error") else "1"} for name in names}
    function = _Bound(options, [float(h) for h in heading_deg], spacing, geographic)
    return blockwise(data, function, names, halo=halo, block=block, attributes=units, progress=progress)
