"""Points that lie on a regular lattice, laid into rows and columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomag._errors import InvalidInputError, ReadError

Array = NDArray[np.float64]


def _axis(c: Array, label: str, where: str) -> tuple[Array, NDArray[np.int64]]:
    levels = np.unique(c)
    gaps = np.diff(levels)
    # Printed coordinates scatter in their last digit: levels nearer than a hundredth of the widest gap are one.
    step = float(np.median(gaps[gaps > 0.01 * gaps.max()])) if len(gaps) else 0.0
    if step <= 0.0:
        raise ReadError(f"{where}: needed at least two different {label}, got one")
    if not (levels[-1] - levels[0]) / step < 1e7:
        raise InvalidInputError(
            f"{where}: needed {label} on a regular grid, got {levels[0]:g} to {levels[-1]:g} in steps of {step:g}"
        )
    index = np.rint((c - levels[0]) / step).astype(np.int64)
    step = (levels[-1] - levels[0]) / index.max()
    index = np.rint((c - levels[0]) / step).astype(np.int64)
    off = np.abs(levels[0] + index * step - c)
    if off.max() > 0.05 * step:
        k = int(off.argmax())
        raise InvalidInputError(
            f"{where}: needed {label} on a regular grid (step about {step:g}), got {c[k]!r} at point {k}; "
            "scattered data must be gridded first"
        )
    return levels[0] + step * np.arange(index.max() + 1), index


def lattice(x: Array, y: Array, values: Array, where: str) -> tuple[NDArray[Any], Array, Array]:
    """Values as rows (y) and columns (x), with the two axes; nodes without a point are holes."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y, values = x[known], y[known], values[known]
    if len(x) < 4:
        raise ReadError(f"{where}: needed at least four points on a grid, got {len(x)}")
    xs, column = _axis(x, "x", where)
    ys, row = _axis(y, "y", where)
    if len(xs) * len(ys) > 10 * len(x):
        raise InvalidInputError(
            f"{where}: needed points that fill a tenth of a grid at least, got {len(x)} points for {len(ys)} x {len(xs)} nodes; "
            "scattered data must be gridded first"
        )
    grid = np.full((len(ys), len(xs)), np.nan)
    order = row * len(xs) + column
    if len(np.unique(order)) != len(order):
        raise InvalidInputError(f"{where}: needed one value a node, got several points on the same node")
    grid[row, column] = values
    return grid, xs, ys
