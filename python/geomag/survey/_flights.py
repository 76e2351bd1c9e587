"""The error model of a grid whose lines are not at hand, learnt from flights over it whose positions are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomag._errors import TooFewSamplesError
from geomag._geomag import GridMap, Track
from geomag._ranges import above, at_least
from geomag.survey._fit import INTERCEPT_PRIOR, recalibrated
from geomag.survey._folds import Fold
from geomag.survey._learn import USUAL_TRIALS, settled
from geomag.survey._lines import Lines
from geomag.survey._model import ErrorModel, Law
from geomag.survey._steps import Progress, Steps
from geomag.survey._surface import Axes
from geomag.survey._survey import WINDOW, windows_of
from geomag.survey._trials import Settings, flown

#: Distance of the nodes to the data, cells: what lengths are measured in where nobody knows the lines. Sizes and lengths that are learnt make up for it.
DISTANCE_CELLS = 2.0
#: What is believed of the correlation length beforehand (centre, standard deviation of the logarithm): that of grids of which the lines are not known
#: (`with_line_spacing`). A few flights move it less than the lines of a whole survey would.
CORRELATION_PRIOR = (2.25, 0.35)
#: The line spacing over the mean distance to the data.
SPACINGS = 4.0
#: Fewest windows that anything is learnt from.
FEWEST_WINDOWS = 6
#: Greatest slope in log-odds from computed risks to declared ones that flights are believed to tell: without a bound 2.3 % of a survey's fixes at 1 % were wrong, with it 0.3 %.
MOST_SLOPE = 0.8


def learn_from_flights(
    grid: GridMap,
    flights: Sequence[Track] | Lines,
    *,
    line_spacing_m: float | None = None,
    spacing_m: float | None = None,
    half_width_m: float | None = None,
    tolerance_m: float | None = None,
    samples: int = WINDOW,
    seed: int = 0,
    progress: Progress = None,
) -> ErrorModel:
    """Learn the error model of a grid from flights with known positions: one calibration flight makes a published grid useful.

    The readings are compared with the grid sample by sample for the size of its errors, and matched window by window (several starts, overlapping windows) for
    how far they go together, how they spread from track to track and how risks are to be read: what `learn_errors` does with lines left out. The
    flights must not be in the grid.

    Returns an `ErrorModel`, for `with_errors` with None for the lines. Raises `TooFewSamplesError` where fewer than 6 windows can be made on the grid.
    The method is geomag's own.

    Parameters
    ----------
    grid : the map; its sigma and error model, if any, are not used.
    flights : true positions and readings, each flight a `Track` (map units and the map's unit), or `Lines`. Cut where readings stop or a flight turns back.
    line_spacing_m : distance between the lines behind the grid, where it is known; 8 cells otherwise, which only sets the unit of lengths.
    spacing_m, half_width_m, tolerance_m, samples : as they will be flown (see `learn_errors`).
    seed : of starts and choices of windows.
    progress : True for a bar, or a callable (done, total).

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag import survey, synthetic
    >>> field = synthetic.Crust(dipoles=0, texture_rms=80.0).draw((0, 0, 15_000, 15_000), seed=4)
    >>> axis = np.arange(0.0, 15_001.0, 250.0)
    >>> grid = geomag.GridMap(field.sample(*(a.ravel() for a in np.meshgrid(axis, axis))).reshape(61, 61), axis, axis)
    >>> along = np.arange(500.0, 14_500.0, 50.0)
    >>> flights = [geomag.Track(along, 0 * along + y, field.sample(along, 0 * along + y)) for y in (3030.0, 7720.0, 12_330.0)]
    >>> options = {"spacing_m": 200.0, "half_width_m": 1000.0, "tolerance_m": 250.0, "samples": 20}
    >>> model = survey.learn_from_flights(grid, flights, **options)
    >>> survey.with_errors(grid, None, model).sigma.shape
    (61, 61)
    """
    told = {
        "line_spacing_m": line_spacing_m,
        "spacing_m": spacing_m,
        "half_width_m": half_width_m,
        "tolerance_m": tolerance_m,
    }
    above(0, **{name: value for name, value in told.items() if value is not None})
    at_least(2, samples=samples)
    if not isinstance(flights, Lines):
        if not flights:
            raise TooFewSamplesError("flights: needed at least 1, got 0")
        columns = [np.concatenate([getattr(one, name) for one in flights]) for name in ("x", "y", "values")]
        label = np.repeat(np.arange(len(flights)), [len(one) for one in flights])
        flights = Lines(columns[0], columns[1], columns[2], label, grid.geographic)
    axes = Axes.of(grid)
    distance_m = DISTANCE_CELLS * axes.cell if line_spacing_m is None else line_spacing_m / SPACINGS
    settings = Settings.of(SPACINGS * distance_m, spacing_m, half_width_m, tolerance_m, samples)
    values = np.asarray(grid.values, dtype=float)
    distance = np.where(np.isfinite(values), distance_m, np.nan)
    base = GridMap(values, grid.x, grid.y, geographic=grid.geographic)
    part = Fold([], flights.survey.pieces, axes, base, distance, [])
    found = len(part.covered(windows_of(part.left, settings.spacing_m, samples)))
    if found < FEWEST_WINDOWS:
        raise TooFewSamplesError(
            f"flights: needed at least {FEWEST_WINDOWS} windows of {samples} samples, {settings.spacing_m:.0f} m apart, on the map, got {found}"
        )
    steps = Steps(progress, USUAL_TRIALS + 5.0)
    rng = np.random.default_rng(seed)
    independent = flown([part], settings, rng)
    law = Law(flights.survey.noise, 0.5 * SPACINGS * distance_m, axes.cell)
    model = settled([part], law, settings, independent, rng, steps, correlation_prior=CORRELATION_PRIOR)
    model.distance_m = distance_m
    if model.recalibration is not None:
        # The same few flights gave the sizes of the errors, so that what they say of the risks is too kind.
        slope, intercept = model.recalibration
        computed = recalibrated(np.array(model.risks), (1 / slope, -intercept / slope))
        model.recalibration = (min(slope, MOST_SLOPE), max(intercept, INTERCEPT_PRIOR[0]))
        model.risks = [float(r) for r in recalibrated(computed, model.recalibration)]
    return model
