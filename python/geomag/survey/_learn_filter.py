"""What a filter has to know of a map's errors, learnt from lines that are not in it.

A matcher judges windows of some forty samples; a filter adds up thousands of readings one after the other. So it needs the law of a single sample, that of the
mean over a batch (one and a half correlation lengths), the least error that there is anywhere (lines disagree where they cross), and how far and over which
length whole features of the map stand displaced. Source: geomag's own, from the statistics of aeromagnetic surveys (docs/guide/navigator.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from geomag._geomag import GridMap
from geomag.survey._crossings import crossings, misfit_of
from geomag.survey._lines import Array, Lines, along_m
from geomag.survey._surface import Axes, nearest

#: Tails of the errors of samples and of means.
NU = 3.0
#: Batches gather readings over so many correlation lengths; further off its median than this many scatters, a reading is a spike.
BATCH_CORRELATIONS = 1.5
SPIKE, SPIKE_SIGMA = 4.0, 0.6
#: Left-out lines of a fold that are looked at.
MOST_LINES = 150
#: Lengths of the stretches whose displacement is looked for, in distances to the data, and the fewest batches in one.
STRETCHES = (10.0, 20.0, 40.0, 80.0, 160.0)
FEWEST_BATCHES = 6
#: Stretches of one length that make a variance, and displacements that are too uncertain to add to one (distances to the data).
FEWEST_STRETCHES = 12
VAGUE = 2.0
#: Fewest batches that a law is learnt from.
FEWEST = 60
#: Ranges that are looked at: displacement, and the length over which it changes, in distances to the data.
DISPLACEMENTS = np.geomspace(0.02, 1.0, 60)
LENGTHS = np.geomspace(4.0, 120.0, 25)
#: What is believed of that length before a survey is seen: centre, standard deviation of the logarithm, and its weight beside the mean loss of
#: the stretches. Where displacements tell size and length apart they move it; where only the product of the two is seen it keeps to the middle.
LENGTH_PRIOR = (8.0, 0.5, 0.01)


@dataclass(frozen=True)
class FilterLaw:
    """The five numbers of the error model that filters need (`GridMap.with_error_model`)."""

    sample_factor: float
    batch_factor: float
    crossover: float
    registration_m_per_d: float
    registration_length: float


@dataclass(frozen=True)
class Batches:
    """Means over batches of the readings of one left-out line, one entry a batch: way along the line and distance to the data in metres, mean error, sigma and slopes."""

    along: Array
    distance: Array
    error: Array
    sigma: Array
    slope: Array


def _scale_of(residuals: Array, variance: Array, add: float = 0.0) -> float:
    """Factor f of greatest likelihood where residuals follow a Student-t law of variance f^2 `variance` + `add`."""
    start = float(np.log(np.median(np.abs(residuals) / np.sqrt(variance)) / 0.765 + 1e-9))
    trials = np.exp(2 * np.linspace(start - 2.0, start + 2.0, 161))
    loss = [_student(residuals**2, f * variance + add) for f in trials]
    return float(np.sqrt(trials[int(np.argmin(loss))]))


def _student(squares: Array, variance: Array) -> float:
    return float(np.mean(0.5 * np.log(variance) + 0.5 * (NU + 1) * np.log1p(squares / (NU * variance))))


@dataclass(frozen=True)
class _Layers:
    """A map, with its axes, sigma, distance to the data and the median of that, once."""

    grid: GridMap
    axes: Axes
    sigma: Array
    distance: Array
    usual_m: float

    @staticmethod
    def of(grid: GridMap, distance: Array) -> _Layers:
        sigma = np.asarray(grid.sigma, dtype=float)
        return _Layers(grid, Axes.of(grid), sigma, distance, float(np.nanmedian(distance)))


def _line(layers: _Layers, one: Lines, correlation: float, least: float) -> tuple[Array, Array, Batches] | None:
    """Errors of the samples of one line over their sigmas, and its batches."""
    axes, grid = layers.axes, layers.grid
    error = one.values - grid.sample(one.x, one.y)
    sigma = nearest(layers.sigma, axes, one.x, one.y)
    away = np.maximum(nearest(layers.distance, axes, one.x, one.y), 0.5 * axes.cell)
    east, north = grid.gradient(one.x, one.y)
    known = (
        np.isfinite(error)
        & np.isfinite(sigma)
        & np.isfinite(away)
        & np.isfinite(east)
        & np.isfinite(north)
        & (sigma > 0)
    )
    if known.sum() < 20:
        return None
    along = along_m(one.x, one.y, one.scale_m())[known]
    error, sigma, away = error[known], sigma[known], away[known]
    slope = np.column_stack([east[known], north[known]])
    # A sensor's constant is a state of the filter.
    error = error - np.median(error)
    rows, first = [], 0
    while first < error.size:
        # Where lines cross the distance is short and the errors are not: as the navigator does it.
        length = BATCH_CORRELATIONS * correlation * max(away[first], layers.usual_m)
        last = max(int(np.searchsorted(along, along[first] + length)), first + 1)
        some = slice(first, last)
        off = np.abs(error[some] - np.median(error[some]))
        weight = (off <= SPIKE * np.maximum(np.median(off), SPIKE_SIGMA * sigma[some])) / (sigma[some] ** 2 + least**2)
        weight = weight / weight.sum()
        columns = (along[some], away[some], error[some], sigma[some] ** 2, slope[some, 0], slope[some, 1])
        rows.append([float(weight @ c) for c in columns])
        first = last
    table = np.array(rows).T
    return error, sigma, Batches(table[0], table[1], table[2], np.sqrt(table[3]), table[4:6].T)


def _displacements(
    batches: list[Batches], stretch: float, typical_m: float, factor: float, least: float
) -> tuple[Array, Array]:
    """Displacements (east, north) that stretches of so many distances to the data prefer, in such distances, and their covariances were the batches' errors independent."""
    moved, spread = [], []
    length = stretch * typical_m
    for line in batches:
        count = int((line.along[-1] - line.along[0]) / length)
        part = ((line.along - line.along[0]) / length).astype(int)
        for k in range(count):
            inside = part == k
            if inside.sum() < FEWEST_BATCHES:
                continue
            unit = float(np.mean(line.distance[inside]))
            design = np.column_stack([line.slope[inside] * unit, np.ones(inside.sum())])
            variance = least**2 + (factor * line.sigma[inside]) ** 2
            weight, solved = 1 / variance, np.zeros(3)
            for _ in range(8):
                normal = design.T @ (weight[:, None] * design) + 1e-9 * np.eye(3)
                solved = np.linalg.solve(normal, design.T @ (weight * line.error[inside]))
                left = line.error[inside] - design @ solved
                weight = (NU + 1) / (NU + left**2 / variance) / variance
            covariance = np.linalg.inv(design.T @ (design / variance[:, None]) + 1e-9 * np.eye(3))[:2, :2]
            if np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < VAGUE:
                moved.append(solved[:2])
                spread.append(covariance)
    return np.array(moved).reshape(-1, 2), np.array(spread).reshape(-1, 2, 2)


def mean_variance(stretch: npt.ArrayLike, length: npt.ArrayLike) -> Array:
    """Variance of the mean of a first-order Gauss-Markov process of variance one and that correlation length over a stretch."""
    ratio = np.asarray(stretch, dtype=float) / np.asarray(length, dtype=float)
    return np.asarray(2 / ratio * (1 - (1 - np.exp(-ratio)) / ratio))


def _registration(found: list[tuple[float, Array, Array]]) -> tuple[float, float] | None:
    """Size and length of the displacement of features that is most likely, stretches of every length weighing alike."""
    if not found:
        return None
    centre, spread_of_log, weight = LENGTH_PRIOR
    unlikely = weight * 0.5 * (np.log(LENGTHS / centre) / spread_of_log) ** 2
    losses = np.repeat(unlikely[:, None], DISPLACEMENTS.size, axis=1)
    for stretch, moved, spread in found:
        common = mean_variance(stretch, LENGTHS)[:, None, None] * DISPLACEMENTS[None, :, None] ** 2
        a, b, c = spread[:, 0, 0] + common, spread[:, 0, 1], spread[:, 1, 1] + common
        det = a * c - b * b
        square = (c * moved[:, 0] ** 2 - 2 * b * moved[:, 0] * moved[:, 1] + a * moved[:, 1] ** 2) / det
        losses += np.mean(0.5 * np.log(det) + 0.5 * (NU + 2) * np.log1p(square / NU), axis=2)
    k, j = np.unravel_index(int(np.argmin(losses)), losses.shape)
    return float(DISPLACEMENTS[j]), float(LENGTHS[k])


def learn_filter(
    maps: list[tuple[GridMap, Array]],
    left: list[list[Lines]],
    pieces: list[Lines],
    correlation: float,
    noise: float,
    rng: np.random.Generator,
) -> FilterLaw | None:
    """Learn the law for filters: maps with sigma, each with the distance of its nodes to the data, and the lines that it has not seen.

    `pieces` are all lines, for where they cross; `noise` is that of their readings, the least that a misfit can be. `None` where there is too little to learn from.
    """
    misfit = misfit_of(*crossings(pieces, rng))
    least = max(noise, misfit) if np.isfinite(misfit) else noise
    errors, sigmas, batches = [], [], []
    for one_map, some in zip(maps, left, strict=True):
        layers = _Layers.of(*one_map)
        picks = (
            some
            if len(some) <= MOST_LINES
            else [some[k] for k in np.sort(rng.choice(len(some), MOST_LINES, replace=False))]
        )
        for one in picks:
            got = _line(layers, one, correlation, least)
            if got is not None:
                errors.append(got[0])
                sigmas.append(got[1])
                batches.append(got[2])
    if sum(b.error.size for b in batches) < FEWEST:
        return None
    sample = _scale_of(np.concatenate(errors), np.concatenate(sigmas) ** 2)
    mean, sigma = np.concatenate([b.error for b in batches]), np.concatenate([b.sigma for b in batches])
    # Where lines disagree by more than what is seen beside them, their levels do, which a constant takes: the least is then what is seen near lines.
    near = sigma <= np.quantile(sigma, 0.25)
    least = max(noise, min(least, _scale_of(mean[near], np.ones(int(near.sum())))))
    factor = _scale_of(mean, sigma**2, least**2)
    typical = float(np.median(np.concatenate([b.distance for b in batches])))
    found = []
    for stretch in STRETCHES:
        moved, spread = _displacements(batches, stretch, typical, factor, least)
        if len(moved) >= FEWEST_STRETCHES:
            found.append((stretch, moved, spread))
    registration = _registration(found)
    if registration is None:
        return None
    return FilterLaw(sample, max(factor, 0.05) / sample, least, *registration)
