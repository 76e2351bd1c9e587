"""`da.geomag`: a map in xarray matches tracks as it is. Import this module once to have it.

>>> import numpy as np, xarray as xr
>>> import geomag, geomag.accessor
>>> x = y = np.arange(0.0, 6000.0, 50.0)
>>> field = 90 * np.sin(x / 400)[None, :] * np.cos(y / 500)[:, None]
>>> metres = {"units": "m"}
>>> coordinates = {"y": ("y", y, metres), "x": ("x", x, metres)}
>>> da = xr.DataArray(field, coords=coordinates, attrs={"units": "nT"}, name="anomaly")
>>> k = np.arange(30.0)
>>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, da.geomag.sample(1210 + 90 * k, 1875 + 40 * k))
>>> fix = da.geomag.match(track, "msd", half_width=500)
>>> fix.status, [round(v) for v in fix.offset_m]
('fixed', [210, -125])
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from geomag._geomag import Fix, GridMap, Iema, Track, match_grid
from geomag._optional import require
from geomag._words import Criterion

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

__all__ = ["GeomagAccessor"]


class GeomagAccessor:
    """What geomag can do with a (y, x) DataArray; options as in the functions of the same names."""

    def __init__(self, data_array: xr.DataArray) -> None:
        self._data = data_array

    @cached_property
    def grid(self) -> GridMap:
        """The array as a `GridMap`, made once."""
        return GridMap.from_xarray(self._data)

    def sample(
        self,
        x: ArrayLike,
        y: ArrayLike,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        *,
        method: Literal["bilinear", "bicubic"] | None = None,
    ) -> NDArray[np.float64]:
        """Values at points; NaN off the map. `method` is an old name of `interpolation`."""
        found: NDArray[np.float64] = self.grid.sample(x, y, interpolation=interpolation, method=method)
        return found

    def match(
        self,
        track: Track,
        criterion: Criterion = "msd",
        **options: Any,  # noqa: ANN401 - passed on
    ) -> Fix:
        """Match a track with a similarity measure (`geomag.match_grid`)."""
        return match_grid(self.grid, track, criterion, **options)

    def iema(self, **options: Any) -> Iema:  # noqa: ANN401 - passed on
        """Return a streaming matcher on this map (`geomag.Iema`)."""
        return Iema(self.grid, **options)

    def blockwise(
        self,
        function: Callable[..., Mapping[str, NDArray[Any]]],
        names: Sequence[str],
        **options: Any,  # noqa: ANN401 - passed on
    ) -> xr.Dataset:
        """Run a local computation block by block (`geomag.blocks.blockwise`)."""
        from geomag.blocks import blockwise

        return blockwise(self._data, function, names, **options)

    def plot(self, ax: Axes | None = None, **options: Any) -> Axes:  # noqa: ANN401 - passed on
        """Draw the map (`geomag.plot.field_map`)."""
        from geomag.plot import field_map

        return field_map(self.grid, ax, **options)


require("xarray", "io", "the xarray accessor").register_dataarray_accessor("geomag")(GeomagAccessor)
