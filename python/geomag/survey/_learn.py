"""What the errors of a gridded map are like, learnt from its own lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap
from geomag._ranges import above, at_least
from geomag.survey._fit import fit_lapses, fit_sigma, recalibrated
from geomag.survey._folds import DECIDING, Fold, choose_smoothing, without_stretches
from geomag.survey._heights import Drape
from geomag.survey._learn_filter import FilterLaw, learn_filter
from geomag.survey._levels import Levels
from geomag.survey._lines import Array, Lines
from geomag.survey._model import LEARNT_SPREAD, REGISTRATION, ErrorModel, Law, sigma_of
from geomag.survey._steps import Progress, Steps
from geomag.survey._surface import Axes, nearest, weight_of
from geomag.survey._survey import SHORTEST_WINDOW, WINDOW, windows_of
from geomag.survey._trials import CORRELATION_PRIOR, Settings, Trials, flown

#: Folds where nothing is said, and the fewest lines of each.
FOLDS = 6
LINES_A_FOLD = 4
#: Fewest windows that anything is learnt from.
FEWEST_WINDOWS = 20
#: About how many error models are tried.
USUAL_TRIALS = 9


def learn_errors(
    lines: Lines,
    *,
    spacing: float | tuple[float, float] | None = None,
    grid: GridMap | None = None,
    method: str = "minimum_curvature",
    smoothing_m: float | None = None,
    spacing_m: float | None = None,
    half_width_m: float | None = None,
    tolerance_m: float | None = None,
    samples: int = WINDOW,
    folds: int | None = None,
    seed: int = 0,
    own_heights: bool = False,
    progress: Progress = None,
) -> ErrorModel:
    """Learn the error model of a map from its own lines.

    A `folds`-th of the lines is left out at a time (neighbouring lines in different folds; six folds where there are lines enough), the others are
    gridded, and the left-out lines are compared with that map: sample by sample for the size of the errors and for where they are larger or smaller, window
    by window for the correlation and the line in log-odds by which risks are then to be read, those whose declared risks have the least log loss (models
    are tried on up to 800 windows, and on no more than those of half of the folds where they do worse there; the line of the chosen one is learnt from up to 4,000), and on
    growing parts of windows for how often short tracks are wrong whatever their risk says. Nothing is tuned by hand and nothing but the lines goes in.

    `spacing_m` (metres between samples), `half_width_m` (bound of the start error per axis), `tolerance_m` and `samples` are those that will be flown: what is learnt
    holds best where it was learnt. Where nothing is said windows have 40 samples 0.6 line spacings apart, start up to 4 spacings away, and are wrong
    beyond half a spacing.

    `spacing` (map units) is that of the map, `grid` a map whose axes are used instead. `smoothing_m` is the length over which the map
    is smoothed, 0 for one that honours its lines; by default as long as what is left out, lines and stretches of them, clearly fits the
    better for it (0 with `grid`, and by methods other than minimum curvature, which have none). With `own_heights` lines are compared with the map of the others
    at the heights that they were flown at, as `map_from_lines(height_m=)` does. `progress` is True for a bar, or a callable (done, total).
    Raises `TooFewSamplesError` where fewer than 20 windows can be made and `InvalidInputError` for options out of their range. Source: geomag's own; the line in
    log-odds is Platt's (1999).
    """
    told = {"spacing_m": spacing_m, "half_width_m": half_width_m, "tolerance_m": tolerance_m}
    above(0, **{name: value for name, value in told.items() if value is not None})
    at_least(2, samples=samples)
    if smoothing_m is not None:
        at_least(0, smoothing_m=smoothing_m)
    if smoothing_m and method != "minimum_curvature":
        raise InvalidInputError(f"smoothing_m: needed 0 with method '{method}', got {smoothing_m}")
    survey = lines.survey
    if folds is None:
        folds = max(2, min(FOLDS, survey.labels // LINES_A_FOLD))
    if folds < 2 or survey.labels < 2 * folds:
        raise TooFewSamplesError(
            f"survey lines: needed at least {2 * max(folds, 2)} lines for {folds} folds, got {survey.labels}"
        )
    steps = Steps(progress, folds + 4.0 + USUAL_TRIALS + 5.0)
    line_spacing = survey.spacing_m
    settings = Settings.of(line_spacing, spacing_m, half_width_m, tolerance_m, samples)
    axes = Axes.of(grid) if grid is not None else Axes.over(lines, spacing)
    step_m = 0.6 * line_spacing

    drape = Drape.under(lines, axes, method) if own_heights else None

    def gridded(parted: list[tuple[list[Lines], list[Lines], list[Lines]]], smoothing: float) -> list[Fold]:
        weight = weight_of(lines, axes, smoothing, line_spacing)

        def one_of(part: tuple[list[Lines], list[Lines], list[Lines]]) -> Fold:
            one, left, over = part
            kept, seen = (one, over) if drape is None else drape.brought(one, over, weight)
            windows = windows_of(seen, step_m, WINDOW)
            missing = seen if left else []
            fold = Fold.of(kept, missing, windows, axes, method, line_spacing, weight, steps.within(1.0))
            steps.add(1.0)
            return fold

        return steps.side_by_side(one_of, parted)

    whole = [(kept, left, left) for kept, left in survey.parted(folds)]
    found = sum(len(windows_of(left, settings.spacing_m, samples)) for _, left, _ in whole)
    if found < FEWEST_WINDOWS:
        fewest = min(SHORTEST_WINDOW, samples)
        raise TooFewSamplesError(
            f"survey lines: needed lines for at least {FEWEST_WINDOWS} windows of {fewest} samples, {settings.spacing_m:.0f} m apart, got {found}"
        )
    if smoothing_m is None and grid is None and method == "minimum_curvature":
        kept = without_stretches(survey.pieces, step_m, min(axes.cell, 0.5 * step_m))
        thinned: list[tuple[list[Lines], list[Lines], list[Lines]]] = [(kept, [], survey.pieces)]
        parts = gridded(whole + thinned, 0.0)
        stretches = [parts.pop()]

        def smoothed(length: float) -> tuple[list[Fold], list[Fold]]:
            found = gridded(whole[:DECIDING] + thinned, length)
            return found[:-1], found[-1:]

        if any(part.windows for part in parts[:DECIDING]):
            smoothing_m = choose_smoothing(parts[:DECIDING], stretches, smoothed, line_spacing)
        if smoothing_m:
            parts = gridded(whole, smoothing_m)
    else:
        parts = gridded(whole, smoothing_m or 0.0)
    rng = np.random.default_rng(seed)
    independent = flown(parts, settings, rng)
    count = sum(len(part.windows) for part in parts)
    if count < FEWEST_WINDOWS:
        raise TooFewSamplesError(
            f"survey lines: needed at least {FEWEST_WINDOWS} windows that the map of the other lines covers, got {count}"
        )
    law = Law(survey.noise, 0.5 * line_spacing, axes.cell)
    if smoothing_m:
        # Where lines are not honoured, what they are missed by is the least error there.
        missed = np.concatenate([part.misses() for part in parts])
        law = replace(law, noise=max(law.noise, 1.4826 * float(np.median(np.abs(missed)))))
    return settled(parts, law, settings, independent, rng, steps, smoothing_m or 0.0)


def settled(
    parts: list[Fold],
    law: Law,
    settings: Settings,
    independent: float,
    rng: np.random.Generator,
    steps: Steps,
    smoothing_m: float = 0.0,
    correlation_prior: tuple[float, float] = CORRELATION_PRIOR,
) -> ErrorModel:
    """The error model that windows on unseen readings ask for: sizes, correlation, spread, how risks are to be read, forecast."""
    steps.side_by_side(lambda part: part.features, parts)
    a, b, c = abc = _sizes(parts, law)
    levels = _levels(parts, law, abc)
    trials = Trials(parts, law, abc, settings, independent, rng, steps, correlation_prior, levels=levels[1:])
    point, correlation = trials.search()
    share = point.share
    length_m = settings.spacing_m * (settings.samples - 1)
    filter_seed = rng.integers(2**32)
    best = trials.chosen(point, correlation)
    line = best.line

    def for_filters() -> FilterLaw | None:
        maps, left = trials.maps(share), [part.left for part in parts]
        pieces = [piece for some in left for piece in some]
        return learn_filter(maps, left, pieces, correlation, law.noise, np.random.default_rng(filter_seed))

    # What the chosen model leaves to be learnt: four things that know nothing of each other, the longest first.
    learnt: dict[str, Callable[[], object]] = {
        "forecast": lambda: trials.forecast(best, point, correlation),
        "filter": for_filters,
        "lapses": lambda: (fit_lapses(*trials.first_answers(point, correlation, line)), length_m),
        "misfit_threshold": lambda: trials.misfit_threshold(point, correlation, line),
    }
    found: dict[str, Any] = dict(
        zip(learnt, steps.side_by_side(lambda learn: learn(), list(learnt.values())), strict=True)
    )
    steps.add(np.inf)
    return ErrorModel(
        noise=law.noise,
        floor=a * share,
        displacement=b * share,
        curvature=c * share,
        correlation=correlation,
        registration=REGISTRATION,
        line_spacing_m=2 * law.half_spacing,
        windows=sum(len(part.windows) for part in parts),
        loss=best.loss,
        smoothing_m=smoothing_m,
        scale_spread=LEARNT_SPREAD,
        filter=found["filter"],
        trials=[
            {
                "correlation": some.correlation,
                "share": some.share,
                "loss": one.loss,
                "total": one.total,
            }
            for some, one in trials.seen.items()
        ],
        share=share,
        recalibration=line,
        forecast=found["forecast"],
        lapses=found["lapses"],
        covariance_factor=trials.covariance_factor(best),
        levels=levels[0] if levels else None,
        misfit_threshold=found["misfit_threshold"],
        risks=sorted(float(r) for r in recalibrated(best.risk[best.stated], line)),
        settings={
            "spacing_m": settings.spacing_m,
            "half_width_m": settings.half_width_m,
            "tolerance_m": settings.tolerance_m,
            "samples": float(settings.samples),
        },
    )


def _sizes(parts: list[Fold], law: Law) -> tuple[float, float, float]:
    """a, b, c of the formula of sigma, from the errors of single samples."""
    axes = parts[0].axes
    samples: list[Array] = []
    for part in parts:
        for x, y, error in part.errors():
            layers = [nearest(layer, axes, x, y) for layer in (*part.features, part.distance)]
            samples.append(np.vstack([error, *layers]))
    together = np.hstack(samples)
    residuals, gradient, curvature, distance = together[:, np.all(np.isfinite(together), axis=0)]
    a, b, c = (float(v) for v in fit_sigma(residuals, gradient, curvature, distance, law))
    return a, b, c


def _levels(parts: list[Fold], law: Law, abc: tuple[float, float, float]) -> list[Levels]:
    """Where errors are larger or smaller than the formula's: of all folds, then of all but each, which knows nothing of the windows of that fold.

    Nothing for a single fold.
    """
    if len(parts) < 2:
        return []
    rows: list[Array] = []
    for k, part in enumerate(parts):
        sigma = sigma_of(*part.features, part.distance, law, *abc)
        for x, y, error in part.errors():
            rows.append(np.vstack([x, y, error, nearest(sigma, part.axes, x, y), np.full(x.size, float(k))]))
    x, y, errors, sigma, fold = np.hstack(rows)
    kept = [np.ones(x.size, dtype=bool), *(fold != k for k in range(len(parts)))]
    return [Levels.of(x[m], y[m], errors[m], sigma[m], 2 * law.half_spacing) for m in kept]
