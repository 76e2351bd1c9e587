"""What is known of a gridded map's errors: the numbers, and the sigma that they give."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from geomag.survey._learn_filter import FilterLaw
from geomag.survey._levels import Levels
from geomag.survey._lines import Array

#: Position error of the lines themselves, cells: what the data on a line may be displaced by.
LINE_ERROR_CELLS = 0.1
#: Tails of one sample, and spread of the error level from track to track: where little is known of the map, and where its errors are learnt from
#: windows. With 0.35 there the log loss of the risk was a tenth to a fifth higher on one survey and the same on another.
NU = 3.0
SCALE_SPREAD = 0.35
LEARNT_SPREAD = 0.25
#: Displacement common to a whole window, in distances to the data.
REGISTRATION = 0.05


def limit_of_mean(risks: npt.ArrayLike, mean_risk: float) -> float:
    """Largest limit of the single risk at which the mean of all risks within it is at most `mean_risk`.

    With `risks` of tracks like those to come, a fix declared up to that limit is wrong in `mean_risk` of the cases on the mean, though a single one
    may be several times as risky. 0 where even the least risk is too much.

    Examples
    --------
    >>> from geomag.survey import limit_of_mean
    >>> limit_of_mean([0.001, 0.002, 0.004, 0.02, 0.3], 0.01)
    0.02
    """
    ordered = np.sort(np.asarray(risks, dtype=float))
    ordered = ordered[np.isfinite(ordered)]
    means = np.cumsum(ordered) / np.arange(1, ordered.size + 1)
    within = np.flatnonzero(means <= mean_risk)
    return float(ordered[within[-1]]) if within.size else 0.0


@dataclass
class ErrorModel:
    """What was learnt of a map's errors.

    `noise` and `floor` (value units), `displacement` (share of the distance to the data) and `curvature` are n, a, b and c of
    the module's formula; `correlation` and `registration` are in distances to the data. `windows` counts the left-out windows that
    it rests on, `loss` is the mean log loss of the risks declared for them. `smoothing_m` is the length over which the map was smoothed
    (0: the lines are honoured). `filter` is what a navigator needs beside that, where the lines were enough to learn it.
    `share` is the sigma that windows ask for over that of single samples. `recalibration` (slope, intercept) is the line in
    log-odds from the computed risk to the declared one, `covariance_factor` leads from the computed covariance of a fix to the declared one, and `forecast`
    is level, spread and registration of what is foretold (see `GridMap.with_error_model`), None where they were not learnt. `misfit_threshold` is the log evidence that an effect which was not told must gain for a fix to be refused: three in a hundred right fixes of
    the windows left out gain as much. `risks` are those declared for the windows left out, and `settings` what they were flown with.
    `lapses` (share, length in metres) is how often shorter tracks are wrong whatever their risk says (see `GridMap.with_error_model`). `levels` says where the
    errors are larger or smaller than the formula's.
    `distance_m` is the distance to the data where it is one for the whole map (`learn_from_flights`), None where the lines say.
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
    share: float | None = None
    recalibration: tuple[float, float] | None = None
    forecast: tuple[float, float, float] | None = None
    misfit_threshold: float | None = None
    risks: list[float] = field(default_factory=list, repr=False)
    settings: dict[str, float] = field(default_factory=dict, repr=False)
    distance_m: float | None = None
    lapses: tuple[float, float] | None = None
    covariance_factor: float | None = None
    levels: Levels | None = field(default=None, repr=False)

    def limit_of_mean(self, mean_risk: float = 0.01) -> float:
        """Return the `max_risk` at which the *mean* risk of what is declared is `mean_risk`, on tracks like the windows left out.

        `max_risk` limits the risk of the single fix; with this limit more is declared, and `mean_risk` of it is wrong.
        """
        return limit_of_mean(self.risks, mean_risk)


@dataclass(frozen=True)
class Law:
    """The part of the sigma formula that is known before anything is fitted."""

    noise: float
    half_spacing: float
    cell: float


def sigma_of(gradient: Array, curvature: Array, distance: Array, law: Law, a: float, b: float, c: float) -> Array:
    """Sigma of a node from its gradient, second derivative and distance to the data."""
    line = LINE_ERROR_CELLS * law.cell
    return np.sqrt(
        law.noise**2
        + (a * distance / law.half_spacing) ** 2
        + (line * gradient) ** 2
        + (b * gradient * distance) ** 2
        + (c * curvature * distance**2) ** 2
    )
