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
from typing import Any, overload
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, MapStack

Array = npt.NDArray[np.float64]

#: Correlation length of a map's errors where the map says nothing of it, cells.
ERROR_CELLS = 2.0
#: Error of a map that states none, as a share of its spread: what goes down is held back by it.
UNSTATED_ERROR = 1e-3
#: Part of the field beyond an edge that what is known does not foretell, as a share of the map's own spread.
EDGE_SHARE = 0.15
#: Power of the wave number by which the power of crustal fields falls in the plane (Maus and Dimri 1994, doi 10.1029/94GL00771)
#: and its least share of the greatest,
#: steps in which it foretells the field beyond edges, a third of them on planes of more waves, and how close is close enough.
FALL, LEAST, STEPS, LARGE, CLOSE = 3.0, 1e-9, 30, 4_000_000, 1e-3
#: Share by which metres a degree of longitude may differ over rows that are continued together.
BAND = 0.02
#: Passes of successive corrections from a draped surface to a level, and the share of the error at which they end.
PASSES, ENOUGH = 40, 0.3


def _filled(values: Array) -> Array:
    """Holes filled by a smooth surface that meets what is known: Laplace's equation, from coarse grids to fine ones."""
    unknown = ~np.isfinite(values)
    if not unknown.any():
        return values
    if min(values.shape) >= 8:
        sums = np.where(unknown, 0.0, values)
        rows, columns = values.shape
        even = np.pad(sums, ((0, rows % 2), (0, columns % 2)))
        weight = np.pad((~unknown).astype(float), ((0, rows % 2), (0, columns % 2)))

        def fold(a: Array) -> Array:
            return np.asarray(a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2])

        count = fold(weight)
        with np.errstate(invalid="ignore"):
            coarse = _filled(np.where(count > 0, fold(even) / count, np.nan))
        guess = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[:rows, :columns]
    else:
        guess = np.full(values.shape, np.nanmean(values))
    out = np.where(unknown, guess, values)
    for _ in range(20):
        around = np.pad(out, 1, mode="edge")
        mean = 0.25 * (around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:])
        out = np.where(unknown, mean, values)
    return out


def _fast(n: int) -> int:
    """The least number from `n` on without a prime factor beyond 5: a length that transforms quickly."""
    while True:
        rest = n
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


def _reflected(values: Array, before: tuple[int, int], size: tuple[int, int]) -> Array:
    """The map, `before` (rows, columns) into a plane of that size: its reflection in the edge values, let down to zero."""
    after = tuple(n - v - b for n, v, b in zip(size, values.shape, before, strict=True))
    out = np.pad(values, list(zip(before, after, strict=True)), mode="reflect", reflect_type="odd")
    for axis in (0, 1):
        low, high, n = before[axis], after[axis], values.shape[axis]
        away = np.concatenate([np.arange(low, 0, -1) / (low + 1), np.zeros(n), np.arange(1, high + 1) / (high + 1)])
        taper = 0.5 * (1.0 + np.cos(np.pi * away))
        out = out * (taper[:, None] if axis == 0 else taper[None, :])
    return np.asarray(out)


class _Waves:
    """A map in wave numbers, once for all heights."""

    def __init__(self, values: Array, cell_m: tuple[float, float], edges: str) -> None:
        self.shape = (values.shape[0], values.shape[1])
        self.known = np.isfinite(values)
        if edges == "periodic":
            if not self.known.all():
                raise InvalidInputError(
                    f"edges='periodic': needed a map without holes, got {int((~self.known).sum())} of them"
                )
            self.before, self.size, self.plane = (0, 0), self.shape, np.zeros(self.shape)
        else:
            self.plane = np.full(self.shape, float(np.nanmean(values)))
            self.before = (self.shape[0] // 2, self.shape[1] // 2)
            self.size = (_fast(self.shape[0] + 2 * self.before[0]), _fast(self.shape[1] + 2 * self.before[1]))
            self.before = ((self.size[0] - self.shape[0]) // 2, (self.size[1] - self.shape[1]) // 2)
        ky = 2 * np.pi * np.fft.fftfreq(self.size[0], cell_m[1])
        kx = 2 * np.pi * np.fft.rfftfreq(self.size[1], cell_m[0])
        self.k = np.hypot(ky[:, None], kx[None, :])
        self.edges = edges
        # What is known, continued alike, says how much of a value comes from beyond.
        self.cover = None
        if edges == "periodic":
            self.waves = np.fft.rfft2(values)
            return
        self.cover = np.fft.rfft2(self._laid(self.known.astype(float)))
        self.waves = self._foretold(values - self.plane) if edges == "foretold" else self._mirrored(values - self.plane)

    def _laid(self, values: Array) -> Array:
        out = np.zeros(self.size)
        out[self._window] = values
        return out

    @property
    def _window(self) -> tuple[slice, slice]:
        return (
            slice(self.before[0], self.before[0] + self.shape[0]),
            slice(self.before[1], self.before[1] + self.shape[1]),
        )

    def _mirrored(self, values: Array) -> npt.NDArray[np.complex128]:
        if min(self.before) > min(self.shape) - 1:
            return np.asarray(np.fft.rfft2(self._laid(_filled(values))))
        return np.asarray(np.fft.rfft2(_reflected(_filled(values), self.before, self.size)))

    def _foretold(self, values: Array) -> npt.NDArray[np.complex128]:
        """What the known values foretell of the others, for a field whose power falls with the third power of its wave number.

        The least field, measured by that spectrum, that meets the values: conjugate gradients, each step some transforms. What
        the last of them leaves is continued as the reflection of itself.
        """
        known = np.where(self.known, values, 0.0)
        scale = float(np.sqrt((known**2).sum() / self.known.sum()))
        if scale == 0.0:
            return np.asarray(np.fft.rfft2(self._laid(known)))
        longest = float(self.k[self.k > 0].min())
        power = (self.k**2 + longest**2) ** (-0.5 * FALL)
        power = power / power.max() + LEAST

        def through(field: Array, transfer: Array) -> Array:
            return np.where(self.known, self._cut(np.fft.rfft2(self._laid(field)) * transfer), 0.0)

        steps = STEPS if self.k.size < LARGE else STEPS // 3
        solution, left = np.zeros(self.shape), known.copy()
        towards = step = through(left, 1.0 / power)
        product = float((left * towards).sum())
        for _ in range(steps):
            seen = through(step, power)
            length = product / float((step * seen).sum())
            solution += length * step
            left = left - length * seen
            if np.sqrt((left**2).sum() / self.known.sum()) < CLOSE * scale:
                break
            towards = through(left, 1.0 / power)
            before, product = product, float((left * towards).sum())
            step = towards + product / before * step
        waves = np.fft.rfft2(self._laid(solution)) * power
        return np.asarray(waves + self._mirrored(np.where(self.known, left, np.nan)))

    def _cut(self, waves: npt.NDArray[np.complex128]) -> Array:
        whole = np.fft.irfft2(waves, s=self.size)
        return np.asarray(whole[self._window])

    def through(self, transfer: Array, *, plane: float = 1.0) -> Array:
        """Values after a filter that multiplies every wave, and the plane taken away."""
        return self._cut(self.waves * transfer) + plane * self.plane

    def beyond(self, height_m: float) -> Array:
        """Share of a value `height_m` further up that comes from where nothing is known."""
        if self.cover is None:
            return np.zeros(self.shape)
        return np.clip(1.0 - self._cut(self.cover * np.exp(-self.k * abs(height_m))), 0.0, 1.0)

    def scale(self) -> float:
        """Integral scale of the map, metres: over which it is much the same."""
        rings, power = self.power()
        return float((power / rings).sum() / max(power.sum(), 1e-300))

    def power(self) -> tuple[Array, Array]:
        """Wave numbers of rings, and the variance of the map in each."""
        weight = np.full(self.k.shape, 2.0)
        weight[:, 0] = 1.0
        if self.size[1] % 2 == 0:
            weight[:, -1] = 1.0
        energy = weight * np.abs(self.waves) ** 2 / (self.size[0] * self.size[1]) ** 2
        energy[0, 0] = 0.0
        # As a variance over the map, not over the map and its reflection, which is let down.
        inside = self.through(np.ones(()), plane=0.0)[self.known]
        rings = np.linspace(0.0, float(self.k.max()) * 1.0001, max(16, min(self.size)) + 1)
        of_ring = np.bincount(np.digitize(self.k.ravel(), rings) - 1, energy.ravel(), minlength=rings.size - 1)
        total = of_ring.sum()
        share = float(inside.var()) / total if total > 0 else 0.0
        return 0.5 * (rings[1:] + rings[:-1]), of_ring[: rings.size - 1] * share


def _error_law(length_m: float, most: float) -> tuple[Array, Array]:
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


def _spread_of_errors(transfer: Array, k: Array, share: Array, length_m: float) -> tuple[float, float]:
    """Variance after a filter over that before, and the same of the correlation length (integral scale)."""
    after = share * transfer**2
    scale = (after / k).sum() / after.sum() if after.sum() > 0 else length_m
    return float(after.sum()), float(scale / (share / k).sum())


def _metres(grid: GridMap, row: float | None = None) -> tuple[float, float]:
    y = grid.y
    east, north = grid.metres_per_unit(float(0.5 * (y[0] + y[-1]) if row is None else row))
    return grid.spacing[0] * east, grid.spacing[1] * north


def _bands(grid: GridMap, reach_m: float) -> list[tuple[slice, slice, tuple[float, float]]]:
    """Rows that are continued together: what is kept, what is looked at, and the cell in metres."""
    rows = grid.shape[0]
    if not grid.geographic and grid.ground_scale is None:
        return [(slice(0, rows), slice(0, rows), _metres(grid))]
    east = np.array([grid.metres_per_unit(float(np.clip(y, -90, 90) if grid.geographic else y))[0] for y in grid.y])
    out = []
    start = 0
    while start < rows:
        within = np.abs(east[start:] / max(east[start], 1.0) - 1.0) <= 2 * BAND
        stop = start + (int(np.argmin(within)) if not within.all() else rows - start)
        stop = max(stop, min(start + 2, rows))
        stop = rows if rows - stop < 2 else stop
        cell = _metres(grid, float(grid.y[(start + stop - 1) // 2]))
        more = int(np.ceil(reach_m / cell[1])) + 8
        out.append((slice(start, stop), slice(max(0, start - more), min(rows, stop + more)), cell))
        start = stop
    return out


def _sigma_layer(grid: GridMap) -> Array | None:
    """Standard deviation at every node, or None where the map states none; holes bridged."""
    if grid.sigma is None:
        return None
    sigma = np.broadcast_to(np.asarray(grid.sigma, dtype=float), grid.shape)
    sigma = np.where(np.isfinite(np.asarray(grid.values)), sigma, np.nan)
    if not np.isfinite(sigma).any():
        return np.zeros(grid.shape)
    return _filled(np.array(sigma))


def _error_length(grid: GridMap) -> float:
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
    return ERROR_CELLS * float(np.sqrt(np.prod(_metres(grid))))


def _rebuilt(
    grid: GridMap,
    values: Array,
    sigma: Array | float | None,
    height_m: float | Array | None,
    longer: float = 1.0,
    **names: str | None,
) -> GridMap:
    """`grid` with other values, errors and height."""
    kept = np.asarray(grid.values).dtype
    words: dict[str, Any] = {"name": grid.name, "units": grid.units, "crs": grid.crs, **names}
    if isinstance(sigma, np.ndarray):
        sigma = np.where(np.isfinite(values), sigma, np.nan)
    out = GridMap(
        values.astype(kept), grid.x, grid.y, geographic=grid.geographic, sigma=sigma, height_m=height_m, **words
    )
    if grid.ground_scale is not None:
        out = out.with_ground_scale(grid.ground_scale)
    model = grid.error_model
    if model is None:
        return out
    return out.with_error_model(**{**model, "correlation": model["correlation"] * longer})


def _level_of(grid: GridMap, what: str) -> float | Array:
    height = grid.height_m
    if height is None:
        raise InvalidInputError(
            f"{what}: needed a map that knows its height, GridMap(..., height_m=...), got one that does not"
        )
    return height


def _going_down(k: Array, power: Array, noise: Array, down_m: float) -> tuple[Array, float]:
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


def _one_level(
    grid: GridMap, up_m: Sequence[float], edges: str, *, whole: bool = False
) -> list[tuple[Array, Array | None, float]]:
    """Values, sigma and growth of the correlation length of the errors, at heights above the map's level."""
    values = np.array(grid.values, dtype=float)
    stated = _sigma_layer(grid)
    length = _error_length(grid)
    shape = values.shape
    out = [(np.full(shape, np.nan), None if stated is None else np.full(shape, np.nan), 1.0) for _ in up_m]
    for kept, seen, cell in _bands(grid, 10.0 * max(abs(u) for u in up_m)):
        waves = _Waves(values[seen], cell, edges)
        inner = slice(kept.start - seen.start, kept.stop - seen.start)
        spread = float(np.std((values[seen] - waves.plane)[waves.known]))
        scale = waves.scale()
        own = stated[seen] if stated is not None else np.full(waves.shape, UNSTATED_ERROR * spread)
        # A variance that differs from place to place is averaged over the square of the kernel of continuation, which is about a
        # normal law of standard deviation h / sqrt(2).
        uneven = _Waves(own**2, cell, "mirrored") if np.ptp(own) > 0 else None
        k, share = _error_law(length, float(waves.k.max()))
        for i, up in enumerate(up_m):
            if up == 0.0:
                out[i][0][kept] = values[kept]
                if stated is not None:
                    out[i] = (out[i][0], np.where(np.arange(shape[0])[:, None] >= kept.start, stated, out[i][1]), 1.0)
                continue
            if up > 0 or edges == "periodic":
                transfer = np.exp(-np.clip(waves.k * up, -300.0, None))
                ratio, longer = _spread_of_errors(np.exp(-np.clip(k * up, -300.0, None)), k, share, length)
                missed = 0.0
            else:
                rings, power = waves.power()
                law = np.interp(rings, k, share / np.gradient(k), right=0.0) * np.gradient(rings)
                noise = float(np.mean(np.maximum(own, UNSTATED_ERROR * spread) ** 2)) * law / max(law.sum(), 1e-300)
                on_rings, missed = _going_down(rings, power, noise, -up)
                transfer = np.interp(waves.k, rings, on_rings)
                transfer.flat[0] = 1.0
                ratio, longer = 0.0, 1.0
            continued = waves.through(transfer)
            beyond = waves.beyond(up)
            smooth = own**2 if uneven is None else uneven.through(np.exp(-0.25 * (waves.k * up) ** 2))
            variance = ratio * np.clip(smooth, 0.0, None) + missed
            # A half plane at a distance d has a share h / (pi d); over such distances a field averages out as its own length over d.
            reach = np.pi * scale * beyond / max(abs(up), 1e-300)
            edge = EDGE_SHARE * spread * beyond * np.minimum(1.0, reach)
            if up < 0:
                edge = edge * float(np.sqrt(1.0 + missed / max(spread**2, 1e-300)))
            continued[~waves.known] = np.nan
            sigma = np.sqrt(variance + edge**2)
            if stated is None and not whole:
                # A map that states no error is taken to stand displaced by a cell: what is worse is unknown.
                slope = np.hypot(*np.gradient(np.where(waves.known, continued, np.nanmean(continued))))
                continued[edge > max(float(np.sqrt(np.mean(slope**2))), 1e-12)] = np.nan
            out[i][0][kept] = continued[inner]
            if stated is not None and out[i][1] is not None:
                layer = out[i][1]
                assert layer is not None
                layer[kept] = sigma[inner]
            out[i] = (out[i][0], out[i][1], longer)
    return out


def _to_level(grid: GridMap, drape: Array) -> tuple[GridMap, float]:
    """The map on the lowest height of a draped surface: successive corrections until it gives back what was draped."""
    values = np.array(grid.values, dtype=float)
    known = np.isfinite(values)
    low, high = float(drape[known].min()), float(drape[known].max())
    sigma = _sigma_layer(grid)
    spread = float(np.std(values[known]))
    close = ENOUGH * (
        float(np.sqrt(np.mean(sigma[known] ** 2))) if sigma is not None and sigma.any() else 0.01 * spread
    )
    cell = float(np.sqrt(np.prod(_metres(grid))))
    between = np.linspace(low, high, max(2, int(np.ceil((high - low) / (0.25 * cell))) + 1))
    step = between[1] - between[0] if high > low else 1.0
    place = np.nan_to_num((drape - low) / step)
    floor = np.clip(place.astype(int), 0, between.size - 2)
    share = np.clip(place - floor, 0.0, 1.0)
    at_low = values.copy()
    left = np.inf
    for _ in range(PASSES):
        level = _rebuilt(grid, at_low, None, low)
        stack = np.stack(
            [v for v, _, _ in _one_level(level, [float(b - low) for b in between], "mirrored", whole=True)]
        )
        back = np.take_along_axis(stack, floor[None], 0)[0] * (1.0 - share)
        back += np.take_along_axis(stack, floor[None] + 1, 0)[0] * share
        miss = values - back
        left, before = float(np.sqrt(np.nanmean(miss**2))), left
        if left <= close or left > 0.98 * before:
            break
        at_low = at_low + miss
    return _rebuilt(grid, at_low, sigma, low), left


def _on_level(grid: GridMap, what: str) -> GridMap:
    height = _level_of(grid, what)
    if not isinstance(height, np.ndarray):
        return grid
    level, left = _to_level(grid, height)
    if level.sigma is None:
        return level
    return _rebuilt(level, np.array(level.values, dtype=float), np.hypot(np.asarray(level.sigma), left), level.height_m)


def _edges(edges: str) -> str:
    if edges not in ("foretold", "mirrored", "periodic"):
        raise InvalidInputError(f"edges: needed 'foretold', 'mirrored' or 'periodic', got {edges!r}")
    return edges


@overload
def continue_to(grid: GridMap, height_m: float, *, edges: str = "foretold") -> GridMap: ...
@overload
def continue_to(grid: GridMap, height_m: Sequence[float] | Array, *, edges: str = "foretold") -> MapStack: ...
def continue_to(
    grid: GridMap, height_m: float | Sequence[float] | Array, *, edges: str = "foretold"
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
    error model where the errors are large, or two cells. Sigma also has what may come from beyond the edges: a seventh of the map's spread
    times the share of the value that does, less where that comes from further than the map is alike. A map without a sigma has none at
    other heights either; where the edge's part is more than a cell's worth of gradient, it has holes there. Downward, Wiener's filter; what it holds back, as foretold by
    an exponential fitted to the spectrum, is in sigma. Degrees of longitude are taken as constant over rows that differ by 2 %.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> axis = np.arange(0.0, 12800.0, 100.0)
    >>> wave = 2 * np.pi / 1280.0
    >>> grid = geomag.GridMap(80 * np.sin(wave * axis) * np.ones((128, 1)), axis, axis, sigma=2.0, height_m=100.0)
    >>> up = geomag.continuation.continue_to(grid, 300.0)
    >>> bool(abs(np.ptp(up.values[64]) / 160 - np.exp(-wave * 200)) < 0.01), up.height_m
    (True, 300.0)
    """
    edges = _edges(edges)
    heights = np.atleast_1d(np.asarray(height_m, dtype=float))
    if heights.ndim != 1 or heights.size == 0 or not np.isfinite(heights).all():
        raise InvalidInputError(f"height_m: needed a finite height or a sequence of them, got {height_m!r}")
    base = _on_level(grid, "continue_to")
    level = float(np.asarray(base.height_m))
    extent = min(n * c for n, c in zip(base.shape[::-1], _metres(base), strict=True))
    if np.abs(heights - level).max() > extent:
        far = float(heights[np.abs(heights - level).argmax()])
        raise InvalidInputError(
            f"height_m: needed heights within the width of the map ({extent:.0f} m) of its own ({level:.0f} m), got {far:.0f} m"
        )
    heights = np.unique(heights)
    done = _one_level(base, [float(h - level) for h in heights], edges)
    maps = []
    for h, (values, sigma, longer) in zip(heights, done, strict=True):
        if not np.isfinite(values).any():
            raise InvalidInputError(
                f"height_m: needed a height at which something of the map is known, got {h:.0f} m for a map at {level:.0f} m"
            )
        maps.append(_rebuilt(base, values, sigma, float(h), longer))
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
    >>> slope = geomag.continuation.vertical_gradient(grid)
    >>> bool(abs(np.ptp(slope.values[64]) / (160 * wave) - 1) < 0.02), slope.units
    (True, None)
    """
    edges = _edges(edges)
    if isinstance(grid.height_m, np.ndarray):
        raise InvalidInputError(
            "vertical_gradient: needed a map on a level, got one on a draped surface: continue_to(level) first"
        )
    values = np.array(grid.values, dtype=float)
    out = np.full(values.shape, np.nan)
    stated = _sigma_layer(grid)
    sigma = None if stated is None else np.full(values.shape, np.nan)
    length = _error_length(grid)
    longer = 1.0
    for kept, seen, cell in _bands(grid, 20.0 * max(_metres(grid))):
        waves = _Waves(values[seen], cell, edges)
        inner = slice(kept.start - seen.start, kept.stop - seen.start)
        slope = waves.through(-waves.k, plane=0.0)
        slope[~waves.known] = np.nan
        out[kept] = slope[inner]
        if stated is not None and sigma is not None:
            k, share = _error_law(length, float(waves.k.max()))
            ratio, longer = _spread_of_errors(k, k, share, length)
            # A map that ends tells its slope no better than its value a cell higher.
            edge = waves.beyond(max(cell)) * EDGE_SHARE * float(np.std(values[seen][waves.known])) / max(cell)
            sigma[kept] = np.sqrt(ratio * stated[seen] ** 2 + edge**2)[inner]
    units = None if grid.units is None else f"{grid.units}/m"
    name = None if grid.name is None else f"vertical gradient of {grid.name}"
    return _rebuilt(grid, out, sigma, grid.height_m, longer, units=units, name=name)


def _between(rings: Array, power: Array, low_m: float, high_m: float) -> float:
    """Root mean square of what a straight line between two heights misses half-way, value units."""
    below, above = np.exp(-rings * low_m), np.exp(-rings * high_m)
    miss = 0.5 * (below + above) - np.exp(-rings * 0.5 * (low_m + high_m))
    return float(np.sqrt((power * miss**2).sum()))


def levels(grid: GridMap, low_m: float, high_m: float) -> Array:
    """Return heights from `low_m` to `high_m` between which a straight line errs by a quarter of the map's own error.

    By the map's spectrum; for a map that states no error, or none at all, by half a percent of its spread. At most 64.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> axis = np.arange(0.0, 6400.0, 100.0)
    >>> grid = geomag.GridMap(80 * np.sin(axis / 400) * np.ones((64, 1)), axis, axis, sigma=2.0, height_m=100.0)
    >>> heights = geomag.continuation.levels(grid, 100.0, 300.0)
    >>> float(heights[0]), float(heights[-1]), len(heights) < 6
    (100.0, 300.0, True)
    """
    base = _on_level(grid, "levels")
    level = float(np.asarray(base.height_m))
    waves = _Waves(np.array(base.values, dtype=float), _metres(base), "mirrored")
    rings, power = waves.power()
    sigma = _sigma_layer(base)
    spread = float(np.sqrt(power.sum()))
    known = np.isfinite(np.asarray(base.values))
    own = 0.0 if sigma is None else float(np.sqrt(np.mean(sigma[known] ** 2)))
    length = _error_length(base)
    k, share = _error_law(length, float(waves.k.max()))
    out = [low_m]
    while out[-1] < high_m and len(out) < 64:
        at = max(out[-1] - level, 0.0)
        ratio, _ = _spread_of_errors(np.exp(-k * at), k, share, length)
        left = float(np.sqrt((power * np.exp(-2 * rings * at)).sum()))
        target = max(0.25 * own * np.sqrt(ratio), 0.005 * (left if own > 0 else spread), 1e-12)
        step, least = high_m - out[-1], 1e-3 * (high_m - low_m)
        while step > least and _between(rings, power, out[-1] - level, out[-1] + step - level) > target:
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
