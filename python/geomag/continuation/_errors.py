"""What becomes of a map's errors under a filter, and maps rebuilt with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap
from geomag.continuation._waves import Array, filled

#: Correlation length of a map's errors where the map says nothing of it, cells.
ERROR_CELLS = 2.0
#: Share by which metres a degree of longitude may differ over rows that are continued together.
BAND = 0.02


def error_law(length_m: float, most: float) -> tuple[Array, Array]:
    """Wave numbers, and the share of an error's variance in each, for errors that go together over a length along a line.

    A map is right at its data: its errors have no waves much longer than the gaps, and fall off as those of any interpolation
    do. Their power in the plane is taken as (k l)^2 (1 + (k l)^2)^(-5/2), whose integral scale along a line is l / 2.
    """
    own = 2.0 * length_m
    k = np.geomspace(1e-3 / own, max(most, 10.0 / own), 400)
    density = k * (k * own) ** 2 * (1.0 + (k * own) ** 2) ** -2.5
    # What lies beyond the shortest wave of the map is in the map as well, folded: nothing is lost.
    weight = density * np.gradient(k)
    return k, weight / weight.sum()


def spread_of_errors(transfer: Array, k: Array, share: Array, length_m: float) -> tuple[float, float]:
    """Variance after a filter over that before, and the same of the correlation length (integral scale)."""
    after = share * transfer**2
    scale = (after / k).sum() / after.sum() if after.sum() > 0 else length_m
    return float(after.sum()), float(scale / (share / k).sum())


def degrees_of_freedom(longer: float, map_variance: Array, edge_variance: Array) -> float:
    """Factor on the degrees of freedom of a map's errors at a height (Welch 1947, doi 10.1093/biomet/34.1-2.28).

    An error of the map is a mean over as many as were apart below, the growth of the correlation length squared, whose degrees of
    freedom add up; what comes from beyond an edge is of one piece.
    """
    own, edge = float(np.median(map_variance)), float(np.median(edge_variance))
    if not own + edge > 0.0:
        return 1.0
    return float((own + edge) ** 2 / (own**2 / max(longer, 1.0) ** 2 + edge**2))


def metres(grid: GridMap, row: float | None = None) -> tuple[float, float]:
    y = grid.y
    east, north = grid.metres_per_unit(float(0.5 * (y[0] + y[-1]) if row is None else row))
    return grid.spacing[0] * east, grid.spacing[1] * north


def bands(grid: GridMap, reach_m: float) -> list[tuple[slice, slice, tuple[float, float]]]:
    """Rows that are continued together: what is kept, what is looked at, and the cell in metres."""
    rows = grid.shape[0]
    if not grid.geographic and grid.ground_scale is None:
        return [(slice(0, rows), slice(0, rows), metres(grid))]
    east = np.array([grid.metres_per_unit(float(np.clip(y, -90, 90) if grid.geographic else y))[0] for y in grid.y])
    out = []
    start = 0
    while start < rows:
        within = np.abs(east[start:] / max(east[start], 1.0) - 1.0) <= 2 * BAND
        stop = start + (int(np.argmin(within)) if not within.all() else rows - start)
        stop = max(stop, min(start + 2, rows))
        stop = rows if rows - stop < 2 else stop
        cell = metres(grid, float(grid.y[(start + stop - 1) // 2]))
        more = int(np.ceil(reach_m / cell[1])) + 8
        out.append((slice(start, stop), slice(max(0, start - more), min(rows, stop + more)), cell))
        start = stop
    return out


def sigma_layer(grid: GridMap) -> Array | None:
    """Standard deviation at every node, or None where the map states none; holes bridged."""
    if grid.sigma is None:
        return None
    sigma = np.broadcast_to(np.asarray(grid.sigma, dtype=float), grid.shape)
    sigma = np.where(np.isfinite(np.asarray(grid.values)), sigma, np.nan)
    if not np.isfinite(sigma).any():
        return np.zeros(grid.shape)
    return filled(np.array(sigma))


def error_length(grid: GridMap) -> float:
    """Correlation length of the map's errors, metres: where they are large, for that is what is continued."""
    model = grid.error_model
    if model is not None:
        distance = np.broadcast_to(np.asarray(model["distance_m"], dtype=float), grid.shape)
        weight = np.ones(grid.shape) if grid.sigma is None else np.broadcast_to(np.asarray(grid.sigma) ** 2, grid.shape)
        known = np.isfinite(distance) & np.isfinite(weight) & np.isfinite(np.asarray(grid.values))
        if weight[known].sum() > 0:
            length = float(model["correlation"]) * float((weight * distance)[known].sum() / weight[known].sum())
            if length > 0:
                return length
    return ERROR_CELLS * float(np.sqrt(np.prod(metres(grid))))


def rebuilt(
    grid: GridMap,
    values: Array,
    sigma: Array | float | None,
    height_m: float | Array | None,
    longer: float = 1.0,
    apart: float = 1.0,
    **names: str | None,
) -> GridMap:
    """`grid` with other values, errors and height; their correlation `longer`, their degrees of freedom `apart` times as many."""
    kept = np.asarray(grid.values).dtype
    words: dict[str, Any] = {"name": grid.name, "units": grid.units, "crs": grid.crs, **names}
    if isinstance(sigma, np.ndarray):
        sigma = np.where(np.isfinite(values), sigma, np.nan)
    out = GridMap(
        values.astype(kept),
        grid.x,
        grid.y,
        geographic=grid.geographic,
        sigma=sigma,
        height_m=height_m,
        line_spacing_m=grid.line_spacing_m,
        **words,
    )
    if grid.ground_scale is not None:
        out = out.with_ground_scale(grid.ground_scale)
    model = grid.error_model
    if model is None:
        return out
    return out.with_error_model(**{**model, "correlation": model["correlation"] * longer, "nu": model["nu"] * apart})


def level_of(grid: GridMap, what: str) -> float | Array:
    height = grid.height_m
    if height is None:
        raise InvalidInputError(
            f"{what}: needed a map that knows its height, GridMap(..., height_m=...), got one that does not"
        )
    return height
