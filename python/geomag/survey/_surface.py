"""From lines to a surface over a grid, and what its steepness and its distance to the data are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, _distances_to_data, _minimum_curvature
from geomag._optional import require
from geomag.survey._lines import Array, Lines

#: Nodes of a map whose spacing is chosen here.
MOST_NODES = 1_500_000


def nodes(c: Array, step: float) -> tuple[float, int]:
    """First of the whole multiples of `step` that enclose every coordinate, and how many there are, at least 2."""
    low, high = float(c.min()), float(c.max())
    first = float(np.floor(low / step) * step)
    # A quotient may round up to a whole number that the coordinate does not reach, or down to one that it passes.
    first -= step * (first > low)
    count = max(int(np.ceil((high - first) / step)) + 1, 2)
    return first, count + (first + step * (count - 1) < high)


@dataclass(frozen=True)
class Axes:
    x: tuple[float, float, int]
    y: tuple[float, float, int]
    cell_m: tuple[float, float]

    @staticmethod
    def over(lines: Lines, spacing: float | tuple[float, float] | None) -> Axes:
        east, north = lines.scale_m()
        if spacing is None:
            # An eighth of the gap lets a feature be placed within it; a country is gridded more coarsely.
            area = np.ptp(lines.x) * east * np.ptp(lines.y) * north
            step = max(lines.survey.spacing_m / 8, float(np.sqrt(area / MOST_NODES)))
            sx, sy = step / east, step / north
        else:
            try:
                sx, sy = np.broadcast_to(np.asarray(spacing, dtype=float), 2)
            except (TypeError, ValueError) as error:
                raise InvalidInputError(f"spacing: needed a number or a pair (x, y), got {spacing!r}") from error
        if not (0 < sx < np.inf and 0 < sy < np.inf):
            raise InvalidInputError(f"spacing: needed finite numbers > 0, got {spacing}")
        (x0, nx), (y0, ny) = nodes(lines.x, float(sx)), nodes(lines.y, float(sy))
        if nx * ny > 50_000_000:
            raise InvalidInputError(f"spacing: needed a grid of at most 50,000,000 nodes, got {ny} x {nx}")
        return Axes((x0, float(sx), nx), (y0, float(sy), ny), (float(sx * east), float(sy * north)))

    @staticmethod
    def of(grid: GridMap) -> Axes:
        x, y = grid.x, grid.y
        return Axes((float(x[0]), grid.spacing[0], len(x)), (float(y[0]), grid.spacing[1], len(y)), grid.spacing_m)

    @property
    def cell(self) -> float:
        return float(np.sqrt(self.cell_m[0] * self.cell_m[1]))

    def coordinates(self) -> tuple[Array, Array]:
        x = np.asarray(self.x[0] + self.x[1] * np.arange(self.x[2]), dtype=np.float64)
        y = np.asarray(self.y[0] + self.y[1] * np.arange(self.y[2]), dtype=np.float64)
        return x, y


class Distances(NamedTuple):
    """From every node to the data, metres: to the nearest datum; to those on either side, the harmonic mean of that and of the distance to the nearest on the other side.

    The first says where a map has a meaning, the second by how much it errs: what is interpolated between two lines errs by less than what is carried on beyond
    one, and the lines that errors are learnt from lie in wider gaps than those that are flown.
    """

    nearest: Array
    either_side: Array

    @staticmethod
    def of(x: Array, y: Array, axes: Axes) -> Distances:
        """Those of the nodes of a map to some points."""
        return Distances(*_distances_to_data(x, y, axes.x, axes.y, cell_m=axes.cell_m))

    def within(self, reach_m: float, axes: Axes) -> npt.NDArray[np.bool_]:
        """The nodes whose distance to either side is at most `reach_m`; and those of every cell with a datum, on grids wider than that."""
        at_a_datum = self.nearest <= min(reach_m, float(np.hypot(*axes.cell_m)))
        return np.asarray((self.either_side <= reach_m) | at_a_datum)


def grid_lines(
    lines: list[Lines],
    axes: Axes,
    method: str,
    weight: float = np.inf,
    reach_m: float = np.inf,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Array, Distances]:
    """Values and distances to the data at the nodes; a finite `weight` of each datum lets the surface miss it.

    Nodes further than `reach_m` from any datum are not worked out: their values have no meaning.
    """
    x, y, values = (np.concatenate([getattr(one, name) for one in lines]) for name in ("x", "y", "values"))
    distances = Distances.of(x, y, axes)
    if method == "minimum_curvature":
        aspect = axes.cell_m[0] / axes.cell_m[1]
        reach = reach_m / axes.cell_m[1]
        surface = _minimum_curvature(
            x, y, values, axes.x, axes.y, aspect=aspect, weight=weight, reach=reach, progress=progress
        )
        return surface, distances
    if method not in ("linear", "cubic"):
        raise InvalidInputError(f"method: needed 'minimum_curvature', 'linear' or 'cubic', got '{method}'")
    interpolate = require("scipy.interpolate", "survey", f"gridding by method '{method}'")
    # Means over blocks of one cell keep the triangles from being needles along the lines.
    block = np.column_stack([np.floor((x - axes.x[0]) / axes.x[1]), np.floor((y - axes.y[0]) / axes.y[1])])
    _, inverse = np.unique(block, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    count = np.bincount(inverse)
    scale = np.array([axes.cell_m[0] / axes.x[1], axes.cell_m[1] / axes.y[1]])
    points = np.column_stack([np.bincount(inverse, x), np.bincount(inverse, y)]) / count[:, None] * scale
    means = np.bincount(inverse, values) / count
    kind = interpolate.LinearNDInterpolator if method == "linear" else interpolate.CloughTocher2DInterpolator
    xs, ys = axes.coordinates()
    return np.asarray(kind(points, means)(*np.meshgrid(xs * scale[0], ys * scale[1])), dtype=float), distances


def weight_of(lines: Lines, axes: Axes, smoothing_m: float, spacing_m: float) -> float:
    """Weight of a datum that damps waves of the length 2 pi `smoothing_m` to a half, where data lie everywhere as densely as on the mean."""
    if smoothing_m == 0:
        return np.inf
    density = lines.x.size / (lines.survey.length_m * spacing_m)
    return axes.cell_m[1] ** 3 / (axes.cell_m[0] * density * smoothing_m**4)


def smooth(values: Array, known: npt.NDArray[np.bool_], radius: float) -> Array:
    """Mean over about a normal law of standard deviation `radius` cells (three boxes), of the known nodes alone."""
    filled, weight = spread_out(np.where(known, values, 0.0), radius), spread_out(known.astype(float), radius)
    return np.where(known, filled / np.maximum(weight, 1e-12), np.nan)


def spread_out(values: Array, radius: float) -> Array:
    """Values spread over about a normal law of standard deviation `radius` cells (three boxes); what leaves the map is lost."""
    half = max(1, round(np.sqrt(1 + 4 * radius**2) / 2 - 0.5))
    for _ in range(3):
        for axis in (0, 1):
            n = values.shape[axis]
            total = np.moveaxis(np.cumsum(values, axis=axis), axis, 0)
            values = np.empty(values.shape)
            box, ahead = np.moveaxis(values, axis, 0), min(half, n)
            box[: n - ahead] = total[ahead:]
            box[n - ahead :] = total[-1]
            box[half + 1 :] -= total[: max(n - half - 1, 0)]
            values /= 2 * half + 1
    return values


def features(surface: Array, distance: Array, axes: Axes) -> tuple[Array, Array]:
    """Local root mean square gradient (per metre) and second derivative (per square metre)."""
    known = np.isfinite(surface)
    filled = np.where(known, surface, np.nan)
    gy, gx = np.gradient(filled, axes.cell_m[1], axes.cell_m[0])
    gxx = np.gradient(gx, axes.cell_m[0], axis=1)
    gyy = np.gradient(gy, axes.cell_m[1], axis=0)
    radius = max(2 * float(np.median(distance[known])) / axes.cell, 1.0)
    first, second = gx**2 + gy**2, gxx**2 + gyy**2
    gradient = np.sqrt(np.maximum(smooth(first, np.isfinite(first), radius), 0))
    curvature = np.sqrt(np.maximum(smooth(second, np.isfinite(second), radius), 0))
    # Next to a hole there is no difference to take; the largest nearby one stands in.
    worst_g, worst_c = np.nanquantile(gradient, 0.9), np.nanquantile(curvature, 0.9)
    gradient = np.where(known & ~np.isfinite(gradient), worst_g, gradient)
    curvature = np.where(known & ~np.isfinite(curvature), worst_c, curvature)
    return gradient, curvature


def nearest(layer: Array, axes: Axes, x: Array, y: Array) -> Array:
    i = np.clip(np.round((x - axes.x[0]) / axes.x[1]).astype(int), 0, axes.x[2] - 1)
    j = np.clip(np.round((y - axes.y[0]) / axes.y[1]).astype(int), 0, axes.y[2] - 1)
    return cast(Array, layer[j, i])
