"""A map of what a reader found: dummies become holes, a whole circle of longitude is closed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomag._geomag import GridMap
from geomag.io._numbers import without_dummies
from geomag.io._units import field_unit

#: Nodes that a map may have; a header that asks for more is damaged.
MOST = 400_000_000
#: Degrees of itself that a map of the whole circle goes on beyond either end, so that searches cross the seam.
SEAM_DEG = 10.0


def closed(x: NDArray[Any], layers: list[NDArray[Any] | None]) -> tuple[NDArray[np.float64], list[NDArray[Any] | None]]:
    """Longitudes and layers of a map of the whole circle, carried on over its seam; any other as it is."""
    x = np.asarray(x, dtype=np.float64)
    if len(x) < 3:
        return x, layers
    turned = np.unwrap(x, period=360.0)
    step = (turned[-1] - turned[0]) / (len(x) - 1)
    if not 300.0 < abs(step) * len(x) < 420.0 or np.abs(np.diff(turned) - step).max() > 0.02 * abs(step):
        return x, layers
    count = round(360.0 / abs(step))
    if abs(count * abs(step) - 360.0) > 0.02 * abs(step) or len(x) not in (count, count + 1):
        return x, layers
    more = min(max(int(SEAM_DEG / abs(step) + 1e-9), 1), count // 2)
    index = np.arange(-more, count + more)
    axis = turned[0] + step * index
    return axis, [layer if layer is None or layer.ndim < 2 else layer[:, index % count] for layer in layers]


def close_seam(grid: GridMap) -> GridMap:
    """A map of the whole circle of longitude, carried on for ten degrees of itself beyond either end; any other as it is.

    `read_grid` and `grid_from_xarray` do it by themselves. A map made of arrays stays as its arrays are, so that neither a sample between its
    last column and its first nor a search over its seam finds a value. All that the map knows is carried on: sigma, heights and the distances of
    its error model.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.io import close_seam
    >>> longitude, latitude = np.arange(0.0, 360.0, 2.0), np.arange(-10.0, 11.0, 2.0)
    >>> values = np.cos(np.radians(longitude)) + 0 * latitude[:, None]
    >>> grid = geomag.GridMap(values, longitude, latitude, geographic=True)
    >>> float(grid.sample(359.0, 0.0)), round(float(close_seam(grid).sample(359.0, 0.0)), 4)
    (nan, 0.9997)
    """
    if not grid.geographic:
        return grid
    model = grid.error_model
    told = (grid.values, grid.sigma, grid.height_m, None if model is None else model["distance_m"])
    x, layers = closed(grid.x, [a if isinstance(a, np.ndarray) else None for a in told])
    if len(x) == len(grid.x):
        return grid
    carried: list[Any] = [own if layer is None else layer for own, layer in zip(told, layers, strict=True)]
    values, sigma, height, distance = carried
    out = GridMap(
        values, x, grid.y, geographic=True, sigma=sigma, correlation_m=grid.correlation_m, height_m=height, name=grid.name, units=grid.units,
        crs=grid.crs, line_spacing_m=grid.line_spacing_m,
    )  # fmt: skip
    if model is None:
        return out
    return out.with_error_model(
        **{k: v for k, v in model.items() if k not in ("distance_m", "layout")}, distance_m=distance
    )


def make_map(
    values: NDArray[Any],
    x: NDArray[Any],
    y: NDArray[Any],
    *,
    geographic: bool,
    where: str,
    sigma: NDArray[Any] | float | None = None,
    name: str | None = None,
    units: str | None = None,
    crs: str | None = None,
) -> GridMap:
    """A map in nT or mGal where its unit is one of a field, with dummies left out and told, closed where it goes round the earth, with the scale of its projection."""
    values = without_dummies(values, where)
    known = field_unit(units)
    if known is not None:
        units, factor = known
        if factor != 1.0:
            values = np.asarray(values, dtype=np.float64) * factor
            sigma = None if sigma is None else np.asarray(sigma, dtype=np.float64) * factor
    if geographic:
        layer = sigma if isinstance(sigma, np.ndarray) else None
        own, (values, layer) = closed(x, [values, layer])  # type: ignore[assignment]
        if len(own) != len(x):
            x, sigma = own, layer if layer is not None else sigma
    grid = GridMap(values, x, y, geographic=geographic, sigma=sigma, name=name, units=units, crs=crs)
    if geographic or crs is None:
        return grid
    from geomag.projection import true_scale

    return true_scale(grid)
