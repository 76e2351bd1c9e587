"""What the errors of a gridded map are like, learnt from its own lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap, Track, match_posterior_many
from geomag._ranges import at_least
from geomag.survey._learn_filter import FilterLaw, learn_filter
from geomag.survey._lines import (
    SHORTEST_WINDOW,
    WINDOW,
    Array,
    Lines,
    Window,
    along_m,
    folds_of,
    line_spacing_m,
    noise_of,
    windows_of,
)
from geomag.survey._surface import Axes, features, grid_lines, nearest, weight_of

Progress = bool | Callable[[int, int], None] | None

#: Position error of the lines themselves, cells: what the data on a line may be displaced by.
LINE_ERROR_CELLS = 0.1
#: Tails of one sample, and spread of the error level from track to track.
NU = 3.0
SCALE_SPREAD = 0.35
#: Displacement common to a whole window, in distances to the data.
REGISTRATION = 0.05
#: Correlation lengths (in distances to the data) and shares of the single-sample sigma that are tried. One sample's law has the worst
#: tracks in it, which the spread of the level stands for already: most tracks need less.
CORRELATIONS = (0.8, 0.95, 1.1, 1.3, 1.6, 2.0)
SHARES = (0.5, 0.7, 1.0)
#: Where the longest of these is the best, longer ones by this factor are tried up to that limit.
LONGER = 1.25
MOST_CORRELATION = 20.0
#: What is believed of the two before a survey is seen: centre and standard deviation of the logarithm. A survey of a
#: few hundred windows moves them where it is clear, and only there.
CORRELATION_PRIOR = (1.1, 0.2)
SHARE_PRIOR = (0.5, 0.35)
#: Lengths, in line spacings, over which a map may be smoothed, tried in turn for as long as they pay.
SMOOTHINGS = (0.25, 0.5, 1.0, 2.0)
#: A smoother map is taken where the windows left out like it better by more than so many standard errors.
CLEARLY = 2.0
#: Learning windows; more cost time and change the numbers by less than their own error.
MOST_WINDOWS = 300


@dataclass
class ErrorModel:
    """What was learnt of a map's errors.

    `noise` and `floor` (value units), `displacement` (share of the distance to the data) and `curvature` are n, a, b and c of
    the module's formula; `correlation` and `registration` are in distances to the data. `windows` counts the left-out windows that
    it rests on, `loss` is the mean log loss of the risks declared for them. `smoothing_m` is the length over which the map was smoothed
    (0: the lines are honoured). `filter` is what a navigator needs beside that, where the lines were enough to learn it.
    """

    noise: float
    floor: float
    displacement: float
    curvature: float
    correlation: float
    registration: float
    line_spacing_m: float
    windows: int
    loss: float
    smoothing_m: float = 0.0
    nu: float = NU
    scale_spread: float = SCALE_SPREAD
    filter: FilterLaw | None = None
    trials: list[dict[str, float]] = field(default_factory=list, repr=False)


@dataclass(frozen=True)
class Law:
    """The part of the sigma formula that is known before anything is fitted."""

    noise: float
    half_spacing: float
    cell: float


def sigma_of(gradient: Array, curvature: Array, distance: Array, law: Law, a: float, b: float, c: float) -> Array:
    line = LINE_ERROR_CELLS * law.cell
    return np.sqrt(
        law.noise**2
        + (a * distance / law.half_spacing) ** 2
        + (line * gradient) ** 2
        + (b * gradient * distance) ** 2
        + (c * curvature * distance**2) ** 2
    )


def _minimise(loss: Callable[[Array], float], start: Array) -> Array:
    """Pattern search in the logarithms of positive parameters."""
    best, value, step = start.copy(), loss(start), 1.0
    while step > 0.02:
        moved = False
        for k in range(best.size):
            for sign in (1, -1):
                trial = best.copy()
                trial[k] += sign * step
                got = loss(trial)
                if got < value - 1e-9:
                    best, value, moved = trial, got, True
        if not moved:
            step /= 2
    return best


def _fit_sigma(residuals: Array, gradient: Array, curvature: Array, distance: Array, law: Law) -> Array:
    """a, b, c by maximum likelihood under the Student-t law."""

    def loss(logs: Array) -> float:
        a, b, c = np.exp(logs)
        return float(np.mean(_student(residuals, sigma_of(gradient, curvature, distance, law, a, b, c) ** 2)))

    scale = float(np.median(np.abs(residuals))) + 1e-9
    starts = [np.log([scale / 2, b, c]) for b, c in ((0.2, 0.1), (0.05, 0.3), (0.4, 0.02))]
    found = [_minimise(loss, s) for s in starts]
    return np.exp(min(found, key=loss))


@dataclass
class _Fold:
    """The map of some lines, and the windows on what was left out that it covers."""

    lines: list[Lines]
    axes: Axes
    base: GridMap
    distance: Array
    windows: list[Window]

    def errors(self) -> Iterator[tuple[Array, Array, Array]]:
        """Of every window: places that the map has a value for, and the errors there about their median."""
        for x, y, v in self.windows:
            error = v - self.base.sample(x, y)
            ok = np.isfinite(error)
            if ok.sum() >= SHORTEST_WINDOW // 2:
                yield x[ok], y[ok], error[ok] - np.median(error[ok])

    def misses(self) -> Array:
        """How far the map is from its own lines."""
        out: Array = np.concatenate([one.values - self.base.sample(one.x, one.y) for one in self.lines])
        return out[np.isfinite(out)]

    @cached_property
    def features(self) -> tuple[Array, Array]:
        """Gradient and second derivative of the map."""
        return features(np.asarray(self.base.values, dtype=float), self.distance, self.axes)

    def with_sigma(self, law: Law, abc: tuple[float, ...]) -> tuple[GridMap, Array]:
        """The map with the sigma of the formula, and its distances to the data."""
        a, b, c = abc
        sigma = sigma_of(*self.features, self.distance, law, a, b, c)
        return layered(self.base, np.asarray(self.base.values, dtype=float), sigma, self.distance)


def _fold(kept: list[Lines], left: list[Window], axes: Axes, method: str, spacing_m: float, weight: float) -> _Fold:
    surface, distance = grid_lines(kept, axes, method, weight)
    surface = np.where(distance <= 4 * spacing_m, surface, np.nan)
    base = GridMap(surface, *axes.coordinates(), geographic=kept[0].geographic)
    return _Fold(kept, axes, base, distance, [w for w in left if np.mean(np.isfinite(base.sample(w[0], w[1]))) >= 0.9])


def _without_stretches(lines: list[Lines], every_m: float, length_m: float) -> list[Lines]:
    """The lines without stretches of `length_m` about every sample of their windows, which are `every_m` apart."""
    out = []
    for one in lines:
        along = along_m(one.x, one.y, one.scale_m())
        kept = np.abs((along + every_m / 2) % every_m - every_m / 2) > length_m / 2
        if kept.any():
            out.append(one._take(kept))
    return out


def _student(residuals: Array, s2: Array | float) -> Array:
    """Minus the logarithm of the Student-t density, up to a constant."""
    return np.asarray(0.5 * np.log(s2) + 0.5 * (NU + 1) * np.log1p(residuals**2 / (NU * s2)))


def _losses(parts: list[_Fold]) -> Array:
    """How badly each window left out fits, as one Student-t law fits all of them."""
    errors = [error for part in parts for _, _, error in part.errors()]
    everything = np.concatenate(errors)
    start = np.log([float(np.median(np.abs(everything))) + 1e-9])
    logs = _minimise(lambda logs: float(np.mean(_student(everything, np.exp(2 * logs[0])))), start)
    return np.array([np.mean(_student(error, np.exp(2 * logs[0]))) for error in errors])


def _choose_smoothing(
    parts: list[_Fold],
    by_lines: Callable[[float], list[_Fold]],
    by_stretches: Callable[[float], list[_Fold]],
    spacing_m: float,
) -> tuple[float, list[_Fold]]:
    """A length to smooth over, from none (`parts`) up as long as what is left out clearly fits the better; the folds gridded so.

    Noise that is honoured without need looks like field on the map. Lines left out show what smoothing does between the lines, stretches
    left out what it does on them; a track is as often near as far.
    """
    best, before = 0.0, (_losses(parts), _losses(by_stretches(0.0)))
    for factor in SMOOTHINGS:
        smoother = by_lines(factor * spacing_m)
        after = (_losses(smoother), _losses(by_stretches(factor * spacing_m)))
        gains = [old - new for old, new in zip(before, after, strict=True)]
        error = np.sqrt(sum(gain.var() / gain.size for gain in gains))
        if sum(gain.mean() for gain in gains) <= CLEARLY * error:
            break
        best, parts, before = factor * spacing_m, smoother, after
    return best, parts


def learn_errors(
    lines: Lines,
    *,
    spacing: float | tuple[float, float] | None = None,
    grid: GridMap | None = None,
    method: str = "minimum_curvature",
    smoothing_m: float | None = None,
    folds: int = 3,
    seed: int = 0,
    progress: Progress = None,
) -> ErrorModel:
    """Learn the error model of a map from its own lines.

    A `folds`-th of the lines is left out at a time (neighbouring lines in different folds), the others are gridded, and the left-out
    lines are compared with that map: sample by sample for the size of the errors, window by window (40 samples 0.6 line
    spacings apart, started up to 4 spacings away) for the correlation, which is the one whose declared risks have the least
    log loss. Nothing is tuned by hand and nothing but the lines goes in.

    `spacing` (map units) is that of the map, `grid` a map whose axes are used instead. `smoothing_m` is the length over which the map
    is smoothed, 0 for one that honours its lines; by default as long as what is left out, lines and stretches of them, clearly fits the
    better for it (0 with `grid`, and by methods other than minimum curvature, which have none). Raises `TooFewSamplesError` where fewer than 20 windows can be made and
    `InvalidInputError` for a length that is no number from 0 up. Source: geomag's own.
    """
    if smoothing_m is not None:
        at_least(0, smoothing_m=smoothing_m)
    if smoothing_m and method != "minimum_curvature":
        raise InvalidInputError(f"smoothing_m: needed 0 with method '{method}', got {smoothing_m}")
    pieces = lines.split()
    if folds < 2 or len(pieces) < 2 * folds:
        raise TooFewSamplesError(
            f"survey lines: needed at least {2 * max(folds, 2)} lines for {folds} folds, got {len(pieces)}"
        )
    spacing_m = line_spacing_m(lines)
    axes = Axes.of(grid) if grid is not None else Axes.over(lines, spacing)
    fold = folds_of(pieces, folds)
    step_m = 0.6 * spacing_m

    def gridded(parted: list[tuple[list[Lines], list[Window]]], smoothing: float) -> list[_Fold]:
        weight = weight_of(lines, axes, smoothing, spacing_m)
        return [_fold(kept, left, axes, method, spacing_m, weight) for kept, left in parted]

    whole = []
    for k in range(folds):
        kept, left = ([p for p, f in zip(pieces, fold, strict=True) if (f == k) == out] for out in (False, True))
        whole.append((kept, windows_of(left, step_m, WINDOW)))
    parts = gridded(whole, smoothing_m or 0.0)
    count = sum(len(p.windows) for p in parts)
    if count < 20:
        raise TooFewSamplesError(
            f"survey lines: needed lines for at least 20 windows of {SHORTEST_WINDOW} samples, {step_m:.0f} m apart, got {count}"
        )
    if smoothing_m is None and grid is None and method == "minimum_curvature":
        kept = _without_stretches(pieces, step_m, min(axes.cell, 0.5 * step_m))
        thinned = [(kept, windows_of(pieces, step_m, WINDOW))]
        smoothing_m, parts = _choose_smoothing(
            parts, lambda length: gridded(whole, length), lambda length: gridded(thinned, length), spacing_m
        )
    rng = np.random.default_rng(seed)
    for part in parts:
        limit = MOST_WINDOWS // folds
        if len(part.windows) > limit:
            part.windows = [part.windows[i] for i in rng.choice(len(part.windows), limit, replace=False)]
    samples: list[Array] = []
    for part in parts:
        for x, y, error in part.errors():
            layers = [nearest(layer, axes, x, y) for layer in (*part.features, part.distance)]
            samples.append(np.vstack([error, *layers]))
    together = np.hstack(samples)
    residuals, gradient, curvature, distance = together[:, np.all(np.isfinite(together), axis=0)]
    law = Law(noise_of(pieces), 0.5 * spacing_m, axes.cell)
    if smoothing_m:
        # Where lines are not honoured, what they are missed by is the least error there.
        missed = np.concatenate([part.misses() for part in parts])
        law = replace(law, noise=max(law.noise, 1.4826 * float(np.median(np.abs(missed)))))
    a, b, c = (float(v) for v in _fit_sigma(residuals, gradient, curvature, distance, law))
    trials = _try_correlations(parts, law, (a, b, c), axes, spacing_m, rng, progress)
    best = min(trials, key=lambda t: t["total"])
    stored = [part.with_sigma(law, tuple(best["share"] * v for v in (a, b, c))) for part in parts]
    left = [[p for p, f in zip(pieces, fold, strict=True) if f == k] for k in range(folds)]
    for_filters = learn_filter(stored, left, pieces, best["correlation"], law.noise, np.random.default_rng(seed))
    return ErrorModel(
        noise=law.noise,
        floor=a * best["share"],
        displacement=b * best["share"],
        curvature=c * best["share"],
        correlation=best["correlation"],
        registration=REGISTRATION,
        line_spacing_m=spacing_m,
        windows=sum(len(p.windows) for p in parts),
        loss=best["loss"],
        smoothing_m=smoothing_m or 0.0,
        filter=for_filters,
        trials=trials,
    )


def layered(grid: GridMap, values: Array, sigma: Array, distance: Array) -> tuple[GridMap, Array]:
    """`grid` with other values and their sigma, and the distances; a node without any of them becomes a hole."""
    known = np.isfinite(values) & np.isfinite(sigma)
    out = GridMap(
        np.where(known, values, np.nan),
        grid.x,
        grid.y,
        geographic=grid.geographic,
        sigma=np.where(known, sigma, np.nan),
        name=grid.name,
        units=grid.units,
        crs=grid.crs,
    )
    return out, np.where(known, distance, np.nan)


def _try_correlations(
    parts: list[_Fold],
    law: Law,
    abc: tuple[float, float, float],
    axes: Axes,
    spacing_m: float,
    rng: np.random.Generator,
    progress: Progress,
) -> list[dict[str, float]]:
    scale = (axes.cell_m[0] / axes.x[1], axes.cell_m[1] / axes.y[1])
    half = (4 * spacing_m / scale[0], 4 * spacing_m / scale[1])
    tracks, truths = [], []
    for part in parts:
        offsets = rng.uniform(-1, 1, (len(part.windows), 2)) * half
        tracks.append([Track(x - o[0], y - o[1], v) for (x, y, v), o in zip(part.windows, offsets, strict=True)])
        truths.append(offsets)
    tolerance_m = 0.5 * spacing_m
    report = progress if callable(progress) else None
    trials: list[dict[str, float]] = []

    maps = {share: [part.with_sigma(law, tuple(share * v for v in abc)) for part in parts] for share in SHARES}

    def attempt(correlation: float, share: float, total: int) -> None:
        losses = []
        for (grid, distance), some, offsets in zip(maps[share], tracks, truths, strict=True):
            if not some:
                continue
            model = grid.with_error_model(
                nu=NU,
                scale_spread=SCALE_SPREAD,
                correlation=correlation,
                registration=REGISTRATION,
                distance_m=distance,
            )
            fixes = match_posterior_many(model, some, half_width=half, tolerance_m=tolerance_m)
            for fix, offset in zip(fixes, offsets, strict=True):
                if fix.risk is None:
                    continue
                wrong = float(np.hypot(*((np.array(fix.offset) - offset) * scale))) > tolerance_m
                # Some hundred windows tell nothing of risks below one in a hundred.
                risk = float(np.clip(fix.risk, 1e-2, 1 - 1e-2))
                losses.append(-np.log(risk if wrong else 1 - risk))
        unlikely = 0.5 * (np.log(correlation / CORRELATION_PRIOR[0]) / CORRELATION_PRIOR[1]) ** 2
        unlikely += 0.5 * (np.log(share / SHARE_PRIOR[0]) / SHARE_PRIOR[1]) ** 2
        trials.append(
            {
                "correlation": correlation,
                "share": share,
                "loss": float(np.mean(losses)),
                "total": float(np.sum(losses) + unlikely),
            }
        )
        if report is not None:
            report(len(trials), total)

    for share in SHARES:
        for correlation in CORRELATIONS:
            attempt(correlation, share, len(SHARES) * len(CORRELATIONS))
    # A survey whose errors go together further than the usual one's says so at the end of what was tried.
    longest = CORRELATIONS[-1]
    while longest < MOST_CORRELATION:
        best = min(trials, key=lambda t: t["total"])
        if best["correlation"] < longest:
            break
        longest *= LONGER
        attempt(longest, best["share"], len(trials) + 1)
    return trials
