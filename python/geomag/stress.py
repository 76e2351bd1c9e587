"""Does what a fix declares hold: right maps of any cell and noise, and effects that were not told.

Flights are made up over made-up fields, or over a map that is given, so that the truth is known; every row of a table counts
the fixes, the wrong ones among them beside the number that was declared, and the normalised errors squared beside their
expectation. `geomag stress` prints the tables of the calibration report.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geomag._geomag import Fix, GridMap, PosteriorMatcher, Track, match_posterior_many
from geomag._ranges import above, at_least
from geomag._statistics import normalised_squares

Array = NDArray[np.float64]
Reading = Callable[[Array, Array], Array]

__all__ = ["StressRow", "flights_with_effect", "right_maps", "table"]

#: Normalised error squared in two dimensions that one of a hundred exceeds.
LIMIT = 9.210
#: Nodes of a made-up map along either side.
NODES = 121


@dataclass(frozen=True)
class StressRow:
    """Flights under one setting, and what became of them.

    Attributes
    ----------
    name : str
        The setting.
    flights, fixed, wrong, refused : int
        Flights; those that were fixed; those of them further from the truth than the tolerance; those refused for an effect.
    declared : float
        Sum of the risks of the fixes: the number that may be wrong.
    mean_square, beyond : float
        Mean normalised error squared of the fixes (2 expected), and the share of them beyond 9.21 (0.01 expected).
    """

    name: str
    flights: int
    fixed: int
    wrong: int
    refused: int
    declared: float
    mean_square: float
    beyond: float

    @property
    def consistent(self) -> bool:
        """Whether so many wrong fixes are to be expected of what was declared, one-sided 97.5 %."""
        return bool(self.wrong <= self.declared + 1.96 * np.sqrt(self.declared) + 0.5)

    def within(self, limit: float) -> bool:
        """Whether so many wrong ones among the fixes are to be expected where each is wrong with probability `limit`, one-sided 95 %."""
        fewer = sum(
            math.comb(self.fixed, k) * limit**k * (1 - limit) ** (self.fixed - k)
            for k in range(min(self.wrong, self.fixed + 1))
        )
        return fewer < 0.95 or self.wrong == 0


def _row(name: str, fixes: Sequence[Fix], offsets: Array, tolerance_m: float) -> StressRow:
    fixed = [(fix, offset) for fix, offset in zip(fixes, offsets, strict=True) if fix.ok]
    errors = np.array([np.subtract(fix.offset_m, offset) for fix, offset in fixed]).reshape(-1, 2)
    squares = normalised_squares(errors, np.array([fix.covariance_m2 for fix, _ in fixed]).reshape(-1, 2, 2))
    return StressRow(
        name,
        len(fixes),
        len(fixed),
        int(np.sum(np.hypot(errors[:, 0], errors[:, 1]) > tolerance_m)),
        sum(fix.misfit is not None for fix in fixes),
        float(sum(fix.risk or 0.0 for fix, _ in fixed)),
        float(np.mean(squares)) if fixed else float("nan"),
        float(np.mean(squares > LIMIT)) if fixed else float("nan"),
    )


def table(rows: Iterable[StressRow], limit: float | None = None) -> str:
    """The rows as a table in Markdown; (!) where more are wrong than declared, or with a `limit` than that share of the fixes."""
    out = [
        "| setting | flights | fixed | wrong | declared | refused | mean square | beyond 99 % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    out += [
        f"| {r.name} | {r.flights} | {r.fixed} | {r.wrong}{'' if (r.consistent if limit is None else r.within(limit)) else ' (!)'} | {r.declared:.2f} | {r.refused}"
        f" | {r.mean_square:.2f} | {100 * r.beyond:.1f} % |"
        for r in rows
    ]
    return "\n".join(out) + "\n"


def _waves(shortest: float, rng: np.random.Generator) -> Reading:
    """A field of waves of many lengths from `shortest` on, some 80 in standard deviation, amplitude as the square of the length."""
    length = shortest * rng.uniform(1, 6, 60)
    course, phase = rng.uniform(0, 2 * np.pi, (2, 60))
    amplitude = length**1.5
    amplitude *= 80 / np.sqrt(np.sum(amplitude**2) / 2)
    k = 2 * np.pi / length
    kx, ky = k * np.cos(course), k * np.sin(course)

    def field(x: Array, y: Array) -> Array:
        arguments = np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase
        out: Array = np.cos(arguments) @ amplitude
        return out

    return field


def _second_derivatives(values: Array) -> Array:
    """Of the cubic spline through evenly spaced values along the first axis: M- + 4 M + M+ = 6 D; parabolas at the ends."""
    inner = values[:-2] - 2 * values[1:-1] + values[2:]
    right = 6 * inner
    right[0] -= inner[0]
    right[-1] -= inner[-1]
    n = len(inner)
    matrix = 4 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)
    return np.concatenate([inner[:1], np.linalg.solve(matrix, right), inner[-1:]])


def _spline(grid: GridMap) -> Reading:
    """The bicubic spline through the nodes of a map."""
    values = np.asarray(grid.values, float)
    along_y = _second_derivatives(values)
    planes = values, along_y, _second_derivatives(values.T).T, _second_derivatives(along_y.T).T
    (x0, y0), (dx, dy) = (grid.x[0], grid.y[0]), grid.spacing

    def weights(t: Array) -> tuple[Array, Array, Array, Array]:
        return 1 - t, t, ((1 - t) ** 3 - (1 - t)) / 6, (t**3 - t) / 6

    def read(x: Array, y: Array) -> Array:
        u, v = (x - x0) / dx, (y - y0) / dy
        column = np.clip(np.floor(u).astype(int), 0, values.shape[1] - 2)
        row = np.clip(np.floor(v).astype(int), 0, values.shape[0] - 2)
        wx, wy = weights(u - column), weights(v - row)
        out = np.zeros(np.shape(x))
        for i in (0, 1):
            for j in (0, 1):
                f, fyy, fxx, fxxyy = (plane[row + i, column + j] for plane in planes)
                out += wy[i] * (wx[j] * f + wx[2 + j] * fxx) + wy[2 + i] * (wx[j] * fyy + wx[2 + j] * fxxyy)
        return out

    return read


def _path(start: Array, course: float, spacing_m: float, samples: int, turn_deg: float) -> tuple[Array, Array]:
    """Positions of two straight legs, the first `samples // 2` long."""
    courses = course + np.radians(turn_deg) * (np.arange(samples - 1) >= samples // 2)
    steps = spacing_m * np.stack([np.sin(courses), np.cos(courses)])
    x, y = np.concatenate([[[0.0], [0.0]], np.cumsum(steps, axis=1)], axis=1)
    return start[0] + x - x.mean(), start[1] + y - y.mean()


def _match(grid: GridMap, tracks: list[Track], streaming: bool, options: dict[str, Any]) -> list[Fix]:
    if not streaming:
        return match_posterior_many(grid, tracks, **options)
    fixes = []
    for track in tracks:
        matcher = PosteriorMatcher(grid, max_samples=max(3, len(track)), **options)
        fixes.append(matcher.run(track))
    return fixes


def right_maps(
    *,
    cells_m: Sequence[float] = (100.0, 1000.0, 4000.0),
    shortest_cells: Sequence[float] = (4.0, 12.0),
    kinds: Sequence[str] = ("bilinear", "bicubic", "spline", "field"),
    sigmas: Sequence[float] = (0.05, 0.5, 5.0, 20.0),
    samples: Sequence[int] = (10, 40, 100, 400),
    flights: int = 200,
    streaming: bool = False,
    seed: int = 1,
) -> list[StressRow]:
    """Flights over maps whose nodes are exact, read in four ways between them.

    Parameters
    ----------
    cells_m : sequence of float
        Sides of the maps' cells, metres.
    shortest_cells : sequence of float
        Shortest wave of the fields, cells: 4 is rough, 12 smooth.
    kinds : sequence of str
        What the readings follow between the nodes: ``bilinear``, ``bicubic``, ``spline`` or ``field``.
    sigmas : sequence of float
        Standard deviation of the sensor; the field's is 80.
    samples : sequence of int
        Samples of a flight, half a cell apart, closer where the map would be left.
    flights : int
        Flights a row.
    streaming : bool
        Sample by sample up to the first fix.
    seed : int
        Of fields and flights.

    Returns
    -------
    list of StressRow

    Examples
    --------
    >>> from geomag.stress import right_maps
    >>> row, = right_maps(cells_m=[1000], shortest_cells=[6], kinds=["spline"], sigmas=[0.5], samples=[40], flights=10)
    >>> row.wrong, row.fixed > 5
    (0, True)
    """
    at_least(1, flights=flights)
    at_least(3, samples=min(samples))
    above(0, cells_m=min(cells_m), shortest_cells=min(shortest_cells), sigmas=min(sigmas))
    rows = []
    for cell in cells_m:
        axis = cell * np.arange(NODES)
        tolerance, half = 0.2 * cell, 5 * cell
        for shortest in shortest_cells:
            field = _waves(shortest * cell, np.random.default_rng(seed))
            grid = GridMap(field(*np.meshgrid(axis, axis)), axis, axis, sigma=0.0)
            readings: dict[str, Reading] = {
                "bilinear": lambda x, y, grid=grid: grid.sample(x, y),  # type: ignore[misc]
                "bicubic": lambda x, y, grid=grid: grid.sample(x, y, interpolation="bicubic"),  # type: ignore[misc]
                "spline": _spline(grid),
                "field": field,
            }
            for kind in kinds:
                for sigma in sigmas:
                    for n in samples:
                        rng = np.random.default_rng([seed, n])
                        tracks, offsets = [], []
                        spacing = min(0.5 * cell, 80 * cell / n)
                        for _ in range(flights):
                            middle = axis[-1] * rng.uniform(0.45, 0.55, 2)
                            x, y = _path(middle, rng.uniform(0, 2 * np.pi), spacing, n, 0.0)
                            offset = rng.uniform(-0.8, 0.8, 2) * half
                            noise = rng.normal(0, sigma, n) + rng.uniform(-30, 30)
                            tracks.append(Track(x - offset[0], y - offset[1], readings[kind](x, y) + noise))
                            offsets.append(offset)
                        options = {"half_width": half, "sigma": sigma, "tolerance_m": tolerance}
                        fixes = _match(grid, tracks, streaming, options)
                        name = f"{cell:g} m cells, waves from {shortest:g} cells, {kind}, sigma {sigma:g}, {n} samples"
                        rows.append(_row(name, fixes, np.array(offsets), tolerance))
    return rows


def _lifted(grid: GridMap, height_m: float) -> GridMap:
    """The map continued upward by `height_m` (spectrum times exp(-k h)), mirrored at its borders; for readings only."""
    values = np.asarray(grid.values, float)
    mean = np.nanmean(values)
    filled = np.where(np.isfinite(values), values - mean, 0.0)
    doubled = np.block([[filled, filled[:, ::-1]], [filled[::-1], filled[::-1, ::-1]]])
    dx, dy = grid.spacing_m
    k = np.hypot(
        2 * np.pi * np.fft.fftfreq(doubled.shape[0], dy)[:, None],
        2 * np.pi * np.fft.rfftfreq(doubled.shape[1], dx)[None, :],
    )
    up = np.fft.irfft2(np.fft.rfft2(doubled) * np.exp(-k * height_m), doubled.shape)
    up = np.where(np.isfinite(values), up[: values.shape[0], : values.shape[1]] + mean, np.nan)
    return GridMap(up, grid.x, grid.y, geographic=grid.geographic)


def flights_with_effect(
    grid: GridMap,
    *,
    half_width_m: float,
    tolerance_m: float,
    spacing_m: float,
    sigma: float = 1.0,
    heights_m: Sequence[float] = (0.0, 50.0, 100.0, 200.0, 300.0, 600.0, 1000.0),
    steps: Sequence[float] = (5.0, 10.0, 30.0, 100.0, 300.0),
    told: dict[str, Any] | None = None,
    tell: bool = False,
    samples: int = 40,
    flights: int = 1000,
    seed: int = 1,
) -> list[StressRow]:
    """Flights over a map that is given, from higher up or with a bias that steps at a turn.

    Parameters
    ----------
    grid : GridMap
        The map, with what is known of its errors.
    half_width_m, tolerance_m : float
        Bound of the INS error, and the error beyond which a fix is wrong, metres.
    spacing_m : float
        Distance between samples, metres.
    sigma : float
        Standard deviation of the readings about the map, value units.
    heights_m : sequence of float
        Heights above the map, metres; 0 for no effect.
    steps : sequence of float
        Steps of the bias at a turn by 90 degrees half way, value units.
    told : dict, optional
        Options that tell the matcher, such as ``{"leg_bias_sigma": 50.0}``.
    tell : bool
        Tell every row its own effect: its height as ``height_sigma_m`` (600 m at most), its step as ``leg_bias_sigma``.
    samples, flights : int
        Samples of a flight and flights a row.
    seed : int
        Of the flights.

    Returns
    -------
    list of StressRow
    """
    above(0, half_width_m=half_width_m, tolerance_m=tolerance_m, spacing_m=spacing_m)
    at_least(3, samples=samples)
    at_least(1, flights=flights)
    rows = []
    settings = [(h, 0.0) for h in heights_m] + [(0.0, s) for s in steps]
    for height, step in settings:
        source = _lifted(grid, height) if height else grid
        rng = np.random.default_rng(seed)
        tracks: list[Track] = []
        offsets: list[Array] = []
        while len(tracks) < flights:
            start = rng.uniform([grid.x[0], grid.y[0]], [grid.x[-1], grid.y[-1]])
            per_unit = np.array(grid.metres_per_unit(float(start[1])))
            x, y = _path(np.zeros(2), rng.uniform(0, 2 * np.pi), spacing_m, samples, 90.0)
            offset = rng.uniform(-0.9, 0.9, 2) * half_width_m
            x, y = start[0] + x / per_unit[0], start[1] + y / per_unit[1]
            values = source.sample(x, y) + rng.normal(0, sigma, samples)
            if not np.isfinite(values).all():
                continue
            values = values + step * (np.arange(samples) > samples // 2)
            tracks.append(Track(x - offset[0] / per_unit[0], y - offset[1] / per_unit[1], values))
            offsets.append(offset)
        middle = grid.metres_per_unit(float(np.mean([grid.y[0], grid.y[-1]])))
        half = half_width_m / middle[0], half_width_m / middle[1]
        options = dict(told or {})
        if tell and height:
            options["height_sigma_m"] = min(height, 600.0)
        if tell and step:
            options["leg_bias_sigma"] = step
        fixes = match_posterior_many(grid, tracks, half_width=half, sigma=sigma, tolerance_m=tolerance_m, **options)
        effect = f"{height:g} m higher" if height else f"a step of {step:g} at the turn" if step else "no effect"
        rows.append(_row(effect, fixes, np.array(offsets), tolerance_m))
    return rows
