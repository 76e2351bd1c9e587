"""Maps at other heights: upward and downward continuation, stacks of levels, vertical gradients, with their errors.

Between its sources and space a field is harmonic: a wave of wave number k that is known on a level falls as exp(-k h) on its way up,
and grows as fast on its way down. Grids are continued wave by wave, after holes have been filled, the mean taken away and the
map extended over its edges by its own reflection. What no reflection can know, the field beyond the edges, is given its
standard deviation; the error of the map itself is continued like a field of its correlation length. Going down, waves are
held back where the map's error is as large as they are (Wiener's filter), and what is held back goes into sigma.

Sources: continuation, Blakely 1995, Potential Theory in Gravity and Magnetic Applications, chapter 12; draped surfaces by
successive corrections, Cordell 1985, doi 10.1190/1.1441849, and Xu, Yang, Zhao and Zhang 2007, doi 10.1093/gji/ggm023; errors, geomag's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload
from weakref import WeakKeyDictionary

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, MapStack
from geomag.continuation._errors import (
    bands,
    error_law,
    error_length,
    metres,
    rebuilt,
    sigma_layer,
    spread_of_errors,
)
from geomag.continuation._level import EDGE_SHARE_OF_VALUE, on_level, one_level
from geomag.continuation._waves import Array, Waves

__all__ = ["continue_to", "levels", "vertical_gradient"]


def _edges(edges: str) -> str:
    if edges not in ("foretold", "mirrored", "periodic"):
        raise InvalidInputError(f"edges: needed 'foretold', 'mirrored' or 'periodic', got {edges!r}")
    return edges


@overload
def continue_to(grid: GridMap, height_m: float, *, edges: str = "foretold", about: str = "track") -> GridMap: ...
@overload
def continue_to(
    grid: GridMap, height_m: Sequence[float] | Array, *, edges: str = "foretold", about: str = "track"
) -> MapStack: ...
def continue_to(
    grid: GridMap, height_m: float | Sequence[float] | Array, *, edges: str = "foretold", about: str = "track"
) -> GridMap | MapStack:
    """Return the map at another height, or a stack of it at several.

    For maps that know their height, on a level or draped; up, or down by a cell or so. Not for going down to the sources, where
    no map knows its field, nor up by more than a third of the map's width, where most of the answer comes from beyond it.

    Parameters
    ----------
    grid : GridMap
        A map with `height_m`.
    height_m : float or sequence of floats
        Height or heights wanted, metres above the map's datum.
    edges : {'foretold', 'mirrored', 'periodic'}
        What lies beyond the edges and in holes: what the known values foretell of a field with the spectrum of crustal fields
        (the default), their reflection in the value at the edge, or the map itself again, without a margin.
    about : {'track', 'value'}
        What sigma says of the part that comes from beyond the edges: how it changes along a track, beside a bias that the matcher
        or navigator finds (as learnt maps have it), or how far a value itself may be off, which is several times as much far
        inside.

    Returns
    -------
    GridMap or MapStack
        Values, sigma and error model at that height: a `MapStack` for a sequence, in ascending order. Holes stay holes.

    Raises
    ------
    InvalidInputError
        For a map without a height, heights that are not finite, a level where next to nothing is left of the map.

    Notes
    -----
    Every wave is multiplied by exp(-k h). The variance of an error whose correlation length is L falls to

        integral of k^3 (1 + (2 k L)^2)^(-5/2) exp(-2 k h) dk  over  the same with h = 0

    (a map is right at its data, so that its errors have no long waves), and its correlation length grows likewise; L is that of the
    error model where the errors are large, or two cells. An error at a height is a mean over as many as were apart below, so that the
    tails of a learnt error model are lighter there: degrees of freedom add up (Welch 1947, doi 10.1093/biomet/34.1-2.28). Sigma also has what may come from beyond the edges: of the map's spread times the
    share of the value that does, 8 %, less where that comes from further than the map is alike (`about="value"`: 30 % everywhere). A map without a sigma has none at
    other heights either; where the edge's part is more than a cell's worth of gradient, it has holes there. Downward, Wiener's filter; what it holds back, as foretold by
    an exponential fitted to the spectrum, is in sigma. Degrees of longitude are taken as constant over rows that differ by 2 %.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> axis = np.arange(0.0, 12800.0, 100.0)
    >>> wave = 2 * np.pi / 1280.0
    >>> grid = geomag.GridMap(80 * np.sin(wave * axis) * np.ones((128, 1)), axis, axis, sigma=2.0, height_m=100.0)
    >>> up = grid.continue_to(300.0)
    >>> bool(abs(np.ptp(up.values[64, 30:-30]) / 160 - np.exp(-wave * 200)) < 0.01), up.height_m
    (True, 300.0)
    """
    edges = _edges(edges)
    if about not in ("track", "value"):
        raise InvalidInputError(f"about: needed 'track' or 'value', got {about!r}")
    heights = np.atleast_1d(np.asarray(height_m, dtype=float))
    if heights.ndim != 1 or heights.size == 0 or not np.isfinite(heights).all():
        raise InvalidInputError(f"height_m: needed a finite height or a sequence of them, got {height_m!r}")
    base = on_level(grid, "continue_to")
    level = float(np.asarray(base.height_m))
    extent = min(n * c for n, c in zip(base.shape[::-1], metres(base), strict=True))
    if np.abs(heights - level).max() > extent:
        far = float(heights[np.abs(heights - level).argmax()])
        raise InvalidInputError(
            f"height_m: needed heights within the width of the map ({extent:.0f} m) of its own ({level:.0f} m), got {far:.0f} m"
        )
    heights = np.unique(heights)
    done = one_level(base, [float(h - level) for h in heights], edges, about)
    maps = []
    for h, (values, sigma, longer, apart) in zip(heights, done, strict=True):
        if not np.isfinite(values).any():
            raise InvalidInputError(
                f"height_m: needed a height at which something of the map is known, got {h:.0f} m for a map at {level:.0f} m"
            )
        maps.append(rebuilt(base, values, sigma, float(h), longer, apart))
    return maps[0] if np.ndim(height_m) == 0 else MapStack(maps)


def vertical_gradient(grid: GridMap, *, edges: str = "foretold") -> GridMap:
    """Return the change of a map's field with height, value units per metre, upward positive.

    A quantity to match with where a gradiometer reads it; sharper than the field itself, and noisier: every wave is multiplied by
    minus its wave number, and sigma grows with the shortest wave that the map can hold.

    Parameters
    ----------
    grid : GridMap
        On a level; with a height or without.
    edges : {'foretold', 'mirrored', 'periodic'}
        As in `continue_to`.

    Raises
    ------
    InvalidInputError
        For a draped map, which is to be continued to a level first.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> axis = np.arange(0.0, 12800.0, 100.0)
    >>> wave = 2 * np.pi / 1280.0
    >>> grid = geomag.GridMap(80 * np.sin(wave * axis) * np.ones((128, 1)), axis, axis)
    >>> slope = grid.vertical_gradient()
    >>> bool(abs(np.ptp(slope.values[64, 30:-30]) / (160 * wave) - 1) < 0.02), slope.units
    (True, None)
    """
    edges = _edges(edges)
    if isinstance(grid.height_m, np.ndarray):
        raise InvalidInputError(
            "vertical_gradient: needed a map on a level, got one on a draped surface: continue_to(level) first"
        )
    values = np.array(grid.values, dtype=float)
    out = np.full(values.shape, np.nan)
    stated = sigma_layer(grid)
    sigma = None if stated is None else np.full(values.shape, np.nan)
    length = error_length(grid)
    longer = 1.0
    for kept, seen, cell in bands(grid, 20.0 * max(metres(grid))):
        waves = Waves(values[seen], cell, edges)
        inner = slice(kept.start - seen.start, kept.stop - seen.start)
        slope = waves.through(-waves.k, plane=0.0)
        slope[~waves.known] = np.nan
        out[kept] = slope[inner]
        if stated is not None and sigma is not None:
            k, share = error_law(length, float(waves.k.max()))
            ratio, longer = spread_of_errors(k, k, share, length)
            # A map that ends tells its slope no better than its value a cell higher.
            edge = waves.beyond(max(cell)) * EDGE_SHARE_OF_VALUE * float(np.std(values[seen][waves.known])) / max(cell)
            sigma[kept] = np.sqrt(ratio * stated[seen] ** 2 + edge**2)[inner]
    units = None if grid.units is None else f"{grid.units}/m"
    name = None if grid.name is None else f"vertical gradient of {grid.name}"
    return rebuilt(grid, out, sigma, grid.height_m, longer, units=units, name=name)


#: Share of a field's slopes that a straight line between two levels may miss half-way: slopes are what tells a place.
SLOPES = 0.05


def _between(rings: Array, power: Array, low_m: float, high_m: float) -> tuple[float, float]:
    """Root mean square of what a straight line between two heights misses half-way, value units; of its slopes, as a share of them."""
    half_way = np.exp(-rings * 0.5 * (low_m + high_m))
    miss = 0.5 * (np.exp(-rings * low_m) + np.exp(-rings * high_m)) - half_way
    steep = power * rings**2
    slopes = (steep * miss**2).sum() / max((steep * half_way**2).sum(), np.finfo(float).tiny)
    return float(np.sqrt((power * miss**2).sum())), float(np.sqrt(slopes))


def levels(grid: GridMap, low_m: float, high_m: float) -> Array:
    """Return heights from `low_m` to `high_m` between which a straight line errs by a quarter of the map's own error, and by a twentieth of its slopes.

    By the map's spectrum; for a map that states no error, or none at all, by half a percent of its spread. At most 64.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag import continuation
    >>> axis = np.arange(0.0, 6400.0, 100.0)
    >>> grid = geomag.GridMap(80 * np.sin(axis / 400) * np.ones((64, 1)), axis, axis, sigma=2.0, height_m=100.0)
    >>> heights = continuation.levels(grid, 100.0, 300.0)
    >>> float(heights[0]), float(heights[-1]), len(heights) < 6
    (100.0, 300.0, True)
    """
    base = on_level(grid, "levels")
    level = float(np.asarray(base.height_m))
    waves = Waves(np.array(base.values, dtype=float), metres(base), "mirrored")
    rings, power = waves.power()
    sigma = sigma_layer(base)
    spread = float(np.sqrt(power.sum()))
    known = np.isfinite(np.asarray(base.values))
    own = 0.0 if sigma is None else float(np.sqrt(np.mean(sigma[known] ** 2)))
    length = error_length(base)
    k, share = error_law(length, float(waves.k.max()))
    out = [low_m]
    while out[-1] < high_m and len(out) < 64:
        at = max(out[-1] - level, 0.0)
        ratio, _ = spread_of_errors(np.exp(-k * at), k, share, length)
        left = float(np.sqrt((power * np.exp(-2 * rings * at)).sum()))
        target = max(0.25 * own * np.sqrt(ratio), 0.005 * (left if own > 0 else spread), 1e-12)
        step, least = high_m - out[-1], 1e-3 * (high_m - low_m)
        while step > least:
            miss, slopes = _between(rings, power, out[-1] - level, out[-1] + step - level)
            if miss <= target and slopes <= SLOPES:
                break
            step *= 0.8
        out.append(min(out[-1] + step, high_m))
    out[-1] = high_m
    return np.array(out)


#: Stacks that were made of maps for tracks at other heights, as long as the map is there.
_STACKS: WeakKeyDictionary[GridMap, MapStack] = WeakKeyDictionary()


def _stack_for(grid: GridMap, low_m: float, high_m: float, at_own: bool) -> MapStack:
    """The stack that serves tracks from `low_m` to `high_m`, and at the map's own height if asked for; kept with the map."""
    if at_own and not isinstance(grid.height_m, np.ndarray):
        own = float(np.asarray(grid.height_m))
        low_m, high_m = min(low_m, own), max(high_m, own)
    kept = _STACKS.get(grid)
    if kept is not None:
        heights = kept.heights_m
        if heights[0] <= low_m and high_m <= heights[-1]:
            return kept
        low_m, high_m = min(low_m, float(heights[0])), max(high_m, float(heights[-1]))
    heights = np.array([low_m]) if low_m == high_m else levels(grid, low_m, high_m)
    made = continue_to(grid, heights)
    _STACKS[grid] = made
    return made
