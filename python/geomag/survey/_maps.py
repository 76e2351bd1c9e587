"""Maps that know their errors: from lines, from a grid with its lines, from a grid and a word on its lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, TypedDict, Unpack, overload

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, MapStack
from geomag._ranges import above
from geomag.continuation import continue_to
from geomag.survey._folds import MAP_REACH, REACH
from geomag.survey._heights import Drape
from geomag.survey._learn import learn_errors
from geomag.survey._lines import Array, Lines
from geomag.survey._model import ErrorModel, Law, sigma_of
from geomag.survey._steps import Progress, Steps
from geomag.survey._surface import Axes, Distances, features, grid_lines, weight_of
from geomag.survey._survey import WINDOW
from geomag.survey._trials import layered

#: Where the line spacing is all that is known (`with_line_spacing`): mean distance to the data in line spacings; displacement
#: (b of the formula), correlation length and registration in such distances. The same for every survey; from the two of
#: docs/calibration-report.md, for grids by linear interpolation, the worse of the common methods.
SPACING_DISTANCE = 0.25
SPACING_DISPLACEMENT = 0.75
SPACING_CORRELATION = 2.25
SPACING_REGISTRATION = 0.15


def with_errors(grid: GridMap, lines: Lines | None, model: ErrorModel) -> GridMap:
    """Return the map with the sigma and the error model that its lines give it.

    `grid` is any map made from `lines`; nodes further than 4 line spacings from a datum become holes, because nothing was learnt
    about them. `lines` is None for a model that was learnt from flights over the grid (`learn_from_flights`), which has one distance
    for the whole map. Raises `InvalidInputError` where there are neither lines nor such a distance.
    """
    axes = Axes.of(grid)
    values = np.asarray(grid.values, dtype=float)
    if lines is not None:
        nearest, distance = Distances.of(lines.x, lines.y, axes)
        values = np.where(nearest <= REACH * model.line_spacing_m, values, np.nan)
    elif model.distance_m is not None:
        distance = np.where(np.isfinite(values), model.distance_m, np.nan)
    else:
        raise InvalidInputError("lines: needed those of the map, or a model learnt from flights, got neither")
    gradient, curvature = features(values, distance, axes)
    law = Law(model.noise, 0.5 * model.line_spacing_m, axes.cell)
    sigma = sigma_of(gradient, curvature, distance, law, model.floor, model.displacement, model.curvature)
    if model.levels is not None:
        sigma = sigma * model.levels.on(axes)
    return _carrying(grid, values, sigma, distance, model)


def _carrying(grid: GridMap, values: Array, sigma: Array, distance: Array, model: ErrorModel) -> GridMap:
    """`grid` with other values, their sigma and an error model."""
    out, distance = layered(grid, values, sigma, distance, model.line_spacing_m)
    return out.with_error_model(
        nu=model.nu,
        scale_spread=model.scale_spread,
        correlation=model.correlation,
        registration=model.registration,
        distance_m=distance,
        **_for_filters(model),
        recalibration=model.recalibration,
        forecast=model.forecast,
        lapses=model.lapses,
        covariance_factor=model.covariance_factor,
        misfit_threshold=model.misfit_threshold,
    )


def _for_filters(model: ErrorModel) -> dict[str, Any]:
    """What filters need: as learnt, or at least the law of a single sample."""
    if model.filter is not None:
        return asdict(model.filter)
    return {} if model.share is None else {"sample_factor": 1 / model.share}


def with_line_spacing(grid: GridMap, line_spacing_m: float) -> GridMap:
    """Return the map with errors that are typical of a survey with that distance between its lines.

    For a grid whose lines are not at hand: reports state the spacing. Its errors are taken as 0.75 G D at every node, with G the
    local root mean square gradient and D a quarter of the spacing, correlated over 2.25 D and displaced by 0.15 D: rougher than
    what `map_from_lines` learns, which knows where the lines ran. Raises `InvalidInputError` for a spacing that is not a
    number above zero, for a map of fewer than 3 x 3 nodes and for one without neighbouring values. Source: geomag's own, see docs/calibration-report.md.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.survey import with_line_spacing
    >>> axis = np.arange(0.0, 5000.0, 50.0)
    >>> grid = geomag.GridMap(np.sin(axis / 300) * 80 + np.cos(axis[:, None] / 400) * 60, axis, axis)
    >>> grid = with_line_spacing(grid, 200.0)
    >>> bool(np.nanmax(grid.sigma) < 15)
    True
    """
    above(0, line_spacing_m=line_spacing_m)
    values = np.asarray(grid.values, dtype=float)
    if min(values.shape) < 3:
        raise InvalidInputError(f"map: needed at least 3 x 3 nodes, got {values.shape[0]} x {values.shape[1]}")
    if not np.any(np.isfinite(np.add(*np.gradient(values)))):
        raise InvalidInputError("map: needed neighbouring nodes with values, to take a gradient from, got none")
    distance_m = SPACING_DISTANCE * float(line_spacing_m)
    distance = np.where(np.isfinite(values), distance_m, np.nan)
    gradient, _ = features(values, distance, Axes.of(grid))
    model = ErrorModel(
        noise=0.0,
        floor=0.0,
        displacement=SPACING_DISPLACEMENT,
        curvature=0.0,
        correlation=SPACING_CORRELATION,
        registration=SPACING_REGISTRATION,
        line_spacing_m=float(line_spacing_m),
        windows=0,
        loss=float("nan"),
    )
    return _carrying(grid, values, model.displacement * gradient * distance, distance, model)


class _Options(TypedDict, total=False):
    """Options of `map_from_lines` beside the height, which decides what is returned."""

    spacing: float | tuple[float, float] | None
    grid: GridMap | None
    method: str
    smoothing_m: float | None
    max_distance_m: float | None
    model: ErrorModel | None
    spacing_m: float | None
    half_width_m: float | None
    tolerance_m: float | None
    samples: int
    folds: int | None
    seed: int
    progress: Progress


def _require_heights(height_m: object) -> None:
    try:
        heights = np.asarray(height_m, dtype=float)
    except (TypeError, ValueError):
        heights = np.empty(0)
    if heights.size == 0 or not np.isfinite(heights).all():
        raise InvalidInputError(f"height_m: needed a finite height or a sequence of them, got {height_m!r}")


@overload
def map_from_lines(lines: Lines, *, height_m: None = None, **options: Unpack[_Options]) -> GridMap: ...
@overload
def map_from_lines(lines: Lines, *, height_m: float, **options: Unpack[_Options]) -> GridMap: ...
@overload
def map_from_lines(lines: Lines, *, height_m: Sequence[float] | Array, **options: Unpack[_Options]) -> MapStack: ...
def map_from_lines(
    lines: Lines,
    *,
    height_m: float | Sequence[float] | Array | None = None,
    spacing: float | tuple[float, float] | None = None,
    grid: GridMap | None = None,
    method: str = "minimum_curvature",
    smoothing_m: float | None = None,
    max_distance_m: float | None = None,
    model: ErrorModel | None = None,
    spacing_m: float | None = None,
    half_width_m: float | None = None,
    tolerance_m: float | None = None,
    samples: int = WINDOW,
    folds: int | None = None,
    seed: int = 0,
    progress: Progress = None,
) -> GridMap | MapStack:
    """Survey lines to a map with its sigma and error model, in one call.

    Parameters
    ----------
    lines : the survey (see `Lines`, `read_lines`).
    height_m : height of the map, or heights of a stack, metres above the datum of the lines' own heights: each reading is brought from its
        height to the surface that the lines lie about, errors are learnt from lines left out at theirs, and the map of that surface is continued. By
        default heights are passed over, and the map says none.
    spacing : node spacing in map units, one number or (x, y); an eighth of the line spacing by default, coarser for a
        map of over 1.5 million nodes.
    grid : a map already made from these lines; it is kept as it is and given its errors.
    method : 'minimum_curvature' (needs NumPy alone), 'linear' or 'cubic' on Delaunay triangles (needs SciPy).
    smoothing_m : length over which the map is smoothed, metres (minimum curvature; waves of 2 pi times that length are halved); 0 honours
        every reading. By default the lines say: 0 unless lines that are left out clearly fit a smoother map better.
    max_distance_m : nodes further from the data are holes; 2.5 line spacings by default. Counted is the harmonic mean of the distances to the nearest
        datum and to the nearest on the other side, so that a surface is carried on beyond the last line half as far as it is laid between two.
    model : errors learnt before (`learn_errors`), to be used instead of learning them.
    spacing_m, half_width_m, tolerance_m, samples : metres between samples, bound of the start error per axis, error beyond which a fix is wrong and samples of a
        track, as they will be flown; errors are learnt for them (see `learn_errors`).
    folds, seed : of the cross-validation.
    progress : True for a bar, or a callable (done, total); told from the first moment on.

    Raises `TooFewSamplesError` where the lines are too few to learn from, `InvalidInputError` for options that do not go together.
    """
    if model is not None and smoothing_m is not None:
        raise InvalidInputError(f"smoothing_m: needed none beside a model, which has its own, got {smoothing_m}")
    if model is not None and model.smoothing_m and grid is None and method != "minimum_curvature":
        raise InvalidInputError(
            f"model: needed one without smoothing for method '{method}', got {model.smoothing_m:g} m"
        )
    if height_m is not None and grid is not None:
        raise InvalidInputError("height_m: needed lines that are gridded here, got a grid beside them")
    if height_m is not None:
        _require_heights(height_m)
    if model is None:
        model = learn_errors(
            lines,
            spacing=spacing,
            grid=grid,
            method=method,
            smoothing_m=smoothing_m,
            spacing_m=spacing_m,
            half_width_m=half_width_m,
            tolerance_m=tolerance_m,
            samples=samples,
            folds=folds,
            seed=seed,
            own_heights=height_m is not None,
            progress=progress,
        )
        progress = None
    if grid is None:
        axes = Axes.over(lines, spacing)
        weight = weight_of(lines, axes, model.smoothing_m, model.line_spacing_m)
        reach = MAP_REACH * model.line_spacing_m if max_distance_m is None else max_distance_m
        steps = Steps(progress, 1.0)
        drape = None if height_m is None else Drape.under(lines, axes, method)
        flown = [lines] if drape is None else drape.brought([lines], [], weight)[0]
        surface, distances = grid_lines(
            flown, axes, method, weight, reach + 1.5 * model.line_spacing_m, steps.within(1.0)
        )
        xs, ys = axes.coordinates()
        grid = GridMap(
            np.where(distances.within(reach, axes), surface, np.nan),
            xs,
            ys,
            geographic=lines.geographic,
            height_m=None if drape is None else drape.height_m,
            name=lines.name,
            units=lines.unit,
        )
    out = with_errors(grid, lines, model)
    return out if height_m is None else continue_to(out, height_m)
