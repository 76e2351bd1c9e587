"""From one level to others, and from a draped surface to a level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomag._geomag import GridMap
from geomag.continuation._errors import (
    bands,
    degrees_of_freedom,
    error_law,
    error_length,
    level_of,
    metres,
    rebuilt,
    sigma_layer,
    spread_of_errors,
)
from geomag.continuation._waves import Array, Waves

#: Error of a map that states none, as a share of its spread: what goes down is held back by it.
UNSTATED_ERROR = 1e-3
#: Part of the field beyond an edge that what is known does not foretell, as a share of the map's own spread: what of it changes along a
#: track of some forty samples (Osborne and Britain, parts cut out of the whole, from the edge to ten kilometres inside: 0.07 to 0.09), and
#: with the level that is common to the track, which hardly fades inward (0.1 to 0.6 there, Kansas 0.1 to 0.2, gravity 0.1 to 0.4).
EDGE_SHARE, EDGE_SHARE_OF_VALUE = 0.08, 0.3
#: Passes of successive corrections from a draped surface to a level, the share of the error at which they end, and most levels
#: between.
PASSES, ENOUGH, MOST_BETWEEN = 40, 0.3, 16


def going_down(k: Array, power: Array, noise: Array, down_m: float) -> tuple[Array, float]:
    """Transfer of Wiener's filter downward on rings, and the variance of what it leaves wrong."""
    # Signal as an exponential law of the wave number (sources below a depth), fitted where it stands above the error.
    signal = np.clip(power - noise, 0.0, None)
    width = np.gradient(k)
    use = (power > 4.0 * noise) & (k > 0)
    if use.sum() >= 3:
        slope, level = np.polyfit(k[use], np.log(signal[use] / (k[use] * width[use])), 1)
        fitted = np.exp(np.clip(level + slope * k, -700, 700)) * k * width
        signal = np.where(use, signal, np.minimum(fitted, np.maximum(power, fitted)))
    share = signal / np.maximum(signal + noise, np.finfo(float).tiny)
    grown = np.exp(np.clip(k * down_m, 0.0, 300.0))
    left = grown**2 * signal * noise / np.maximum(signal + noise, np.finfo(float).tiny)
    return share * grown, float(left.sum())


def values_above(grid: GridMap, up_m: Sequence[float]) -> list[Array]:
    """Values alone at heights above the map's level."""
    values = np.array(grid.values, dtype=float)
    out = [values.copy() for _ in up_m]
    for kept, seen, cell in bands(grid, 10.0 * max(up_m)):
        waves = Waves(values[seen], cell, "mirrored")
        for one, up in zip(out, up_m, strict=True):
            if up > 0:
                above = waves.through(np.exp(-waves.k * up))[kept.start - seen.start : kept.stop - seen.start]
                one[kept] = np.where(np.isfinite(values[kept]), above, np.nan)
    return out


def _beyond_edges(waves: Waves, up_m: float, spread: float, about: str) -> Array:
    """Standard deviation of what comes from where nothing is known, of the value or of what changes of it along a track.

    A half plane at a distance d has a share h / (pi d) of a value; over such distances a field averages out as its own length over d.
    """
    beyond = waves.beyond(up_m)
    if about == "value":
        return np.asarray(EDGE_SHARE_OF_VALUE * spread * beyond)
    reach = np.pi * waves.scale() * beyond / max(abs(up_m), 1e-300)
    return np.asarray(EDGE_SHARE * spread * beyond * np.minimum(1.0, reach))


class _Band:
    """Rows that are continued together: their waves, and what is known of their errors."""

    def __init__(self, grid: GridMap, seen: slice, cell: tuple[float, float], stated: Array | None, edges: str) -> None:
        values = np.array(grid.values[seen], dtype=float)
        self.waves = Waves(values, cell, edges)
        self.spread = float(np.std((values - self.waves.plane)[self.waves.known]))
        self.own = stated[seen] if stated is not None else np.full(self.waves.shape, UNSTATED_ERROR * self.spread)
        self.length = error_length(grid)
        self.k, self.share = error_law(self.length, float(self.waves.k.max()))
        # A variance that differs from place to place is averaged over the square of the kernel of continuation, which is about a
        # normal law of standard deviation h / sqrt(2).
        self.uneven = Waves(self.own**2, cell, "mirrored") if np.ptp(self.own) > 0 else None

    def up(self, up_m: float) -> tuple[Array, Array, float]:
        """Values, variance of the map's error and growth of its correlation length."""
        transfer = np.exp(-np.clip(self.waves.k * up_m, -300.0, None))
        along = np.exp(-np.clip(self.k * up_m, -300.0, None))
        ratio, longer = spread_of_errors(along, self.k, self.share, self.length)
        variance = self.own**2
        if self.uneven is not None:
            variance = np.clip(self.uneven.through(np.exp(-0.25 * (self.waves.k * up_m) ** 2)), 0.0, None)
        return self.waves.through(transfer), ratio * variance, longer

    def down(self, down_m: float) -> tuple[Array, Array, float]:
        """The same through Wiener's filter, for a level below."""
        rings, power = self.waves.power()
        law = np.interp(rings, self.k, self.share / np.gradient(self.k), right=0.0) * np.gradient(rings)
        floor = np.maximum(self.own, UNSTATED_ERROR * self.spread)
        noise = float(np.mean(floor**2)) * law / max(law.sum(), 1e-300)
        on_rings, missed = going_down(rings, power, noise, down_m)
        transfer = np.interp(self.waves.k, rings, on_rings)
        transfer.flat[0] = 1.0
        return self.waves.through(transfer), np.full(self.waves.shape, missed), 1.0

    def at(self, up_m: float, edges: str, about: str) -> tuple[Array, Array, float, float]:
        """Values, sigma, growth of the correlation length and of the degrees of freedom at a height above the map's."""
        values, variance, longer = self.up(up_m) if up_m > 0 or edges == "periodic" else self.down(-up_m)
        edge = _beyond_edges(self.waves, up_m, self.spread, about)
        if up_m < 0:
            edge = edge * np.sqrt(1.0 + variance / max(self.spread**2, 1e-300))
        known = self.waves.known
        values[~known] = np.nan
        apart = degrees_of_freedom(longer, variance[known], edge[known] ** 2) if up_m > 0 else 1.0
        return values, np.sqrt(variance + edge**2), longer, apart

    def without_edges(self, values: Array, up_m: float, about: str) -> Array:
        """Values of a map that states no error: holes where the edge's part may be (two standard deviations) worse than a cell's displacement."""
        slope = np.hypot(*np.gradient(np.where(self.waves.known, values, np.nanmean(values))))
        worse = 2.0 * _beyond_edges(self.waves, up_m, self.spread, about) > max(
            float(np.sqrt(np.mean(slope**2))), 1e-12
        )
        return np.where(worse, np.nan, values)


def one_level(
    grid: GridMap, up_m: Sequence[float], edges: str, about: str
) -> list[tuple[Array, Array | None, float, float]]:
    """At heights above the map's level: values, sigma (None where the map states none), growth of the correlation length and of the degrees of freedom."""
    stated = sigma_layer(grid)
    values = [np.array(grid.values, dtype=float) for _ in up_m]
    sigma = [None if stated is None else stated.copy() for _ in up_m]
    longer, apart = [1.0 for _ in up_m], [1.0 for _ in up_m]
    for kept, seen, cell in bands(grid, 10.0 * max(abs(u) for u in up_m)):
        band = _Band(grid, seen, cell, stated, edges)
        inner = slice(kept.start - seen.start, kept.stop - seen.start)
        for i, up in enumerate(up_m):
            if up == 0.0:
                continue
            continued, spread, longer[i], apart[i] = band.at(up, edges, about)
            layer = sigma[i]
            if layer is None:
                continued = band.without_edges(continued, up, about)
            else:
                layer[kept] = spread[inner]
            values[i][kept] = continued[inner]
    return list(zip(values, sigma, longer, apart, strict=True))


def to_level(grid: GridMap, drape: Array) -> tuple[GridMap, float]:
    """The map on the lowest height of a draped surface: successive corrections until it gives back what was draped."""
    values = np.array(grid.values, dtype=float)
    known = np.isfinite(values)
    low, high = float(drape[known].min()), float(drape[known].max())
    sigma = sigma_layer(grid)
    spread = float(np.std(values[known]))
    close = ENOUGH * (
        float(np.sqrt(np.mean(sigma[known] ** 2))) if sigma is not None and sigma.any() else 0.01 * spread
    )
    cell = float(np.sqrt(np.prod(metres(grid))))
    between = np.linspace(low, high, max(2, int(min(np.ceil((high - low) / (0.5 * cell)), MOST_BETWEEN)) + 1))
    step = between[1] - between[0] if high > low else 1.0
    place = np.nan_to_num((drape - low) / step)
    floor = np.clip(place.astype(int), 0, between.size - 2)
    share = np.clip(place - floor, 0.0, 1.0)
    at_low = values.copy()
    left = np.inf
    for _ in range(PASSES):
        level = rebuilt(grid, at_low, None, low)
        stack = np.stack(values_above(level, [float(b - low) for b in between]))
        back = np.take_along_axis(stack, floor[None], 0)[0] * (1.0 - share)
        back += np.take_along_axis(stack, floor[None] + 1, 0)[0] * share
        miss = values - back
        left, before = float(np.sqrt(np.nanmean(miss**2))), left
        if left <= close or left > 0.98 * before:
            break
        at_low = at_low + miss
    # On the surface errors are what the map says of them: further down they are as much larger.
    length = error_length(grid)
    k, share = error_law(length, 4.0 / cell)
    above = np.linspace(0.0, high - low, 9)
    spread_there = [spread_of_errors(np.exp(-k * up), k, share, length) for up in above]
    up = np.clip(np.nan_to_num(drape - low), 0.0, high - low)
    if sigma is not None:
        sigma = sigma / np.sqrt(np.interp(up, above, [ratio for ratio, _ in spread_there]))
    longer = float(np.interp(np.mean(up[known]), above, [grown for _, grown in spread_there]))
    return rebuilt(grid, at_low, sigma, low, 1.0 / longer, 1.0 / longer**2), left


def on_level(grid: GridMap, what: str) -> GridMap:
    height = level_of(grid, what)
    if not isinstance(height, np.ndarray):
        return grid
    level, left = to_level(grid, height)
    if level.sigma is None:
        return level
    return rebuilt(level, np.array(level.values, dtype=float), np.hypot(np.asarray(level.sigma), left), level.height_m)
