"""Survey lines to a harmonic model that knows its own errors, and how that compares with a gridded map.

Lines are dense along and sparse across, so what lies between them is for the prior to say: variances that fall with a power
of the wave number and with the depth of the sources, by another measure along the strike than across it. `model_from_lines`
takes it as told, or chooses by leaving out whole lines, and learns from the same what sigma agrees with the errors. `compare_with_map`
leaves out lines once more, from choice and fit alike, and sets the errors beside those of a gridded map of the same lines.

Source: geomag's own; the prior is that of Maus and Dimri 1994, doi 10.1029/94GL00771.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._geomag import FieldObservations, GridMap, LocalFrame, RectangularHarmonicModel
from geomag.survey import Lines, folds_of
from geomag.survey._surface import Axes, grid_lines

Array = npt.NDArray[np.float64]

#: The prior of crustal anomalies at some 100 m above ground: power of the wave number by which variances fall, depth of the
#: sources, and ratio of noise to signal. Found on parts of one aeromagnetic survey, kept on others (docs/guide/harmonic.md).
SPECTRUM_POWER = 4.0
DAMPING_M = 120.0
RIDGE = 1e-5
PERIOD_RATIO = 1.6


@dataclass(frozen=True)
class _Placed:
    """Lines in the frame of a model: north, east, down (metres), values, number of the line."""

    points: Array
    values: Array
    line: npt.NDArray[np.int_]
    frame: LocalFrame | None

    @staticmethod
    def of(lines: Lines, height_m: npt.ArrayLike) -> _Placed:
        height = np.broadcast_to(np.asarray(height_m, dtype=np.float64), lines.x.shape)
        if not np.isfinite(height).all():
            raise InvalidInputError("height_m: needed finite heights, got some that are not")
        frame = None
        points = np.column_stack([lines.y, lines.x, -height])
        if lines.geographic:
            middle = [0.5 * (float(a.min()) + float(a.max())) for a in (lines.y, lines.x)]
            frame = LocalFrame(middle[0], middle[1], float(np.median(height)))
            points = np.column_stack(frame.forward(lines.y, lines.x, height))
        else:
            points -= [0.5 * (lines.y.min() + lines.y.max()), 0.5 * (lines.x.min() + lines.x.max()), np.median(-height)]
        _, number = np.unique(lines.line, return_inverse=True)
        return _Placed(points, lines.values, number.ravel(), frame)

    def observations(self, keep: npt.NDArray[np.bool_], main_field: Array) -> FieldObservations:
        north, east, down = self.points[keep].T
        return FieldObservations().add_anomaly(north, east, down, self.values[keep], main_field=main_field)


def _spread(placed: _Placed, lines: Lines, folds: int) -> npt.NDArray[np.int_]:
    """Part of every point: neighbouring lines in different ones."""
    pieces = lines.split()
    if len(pieces) < folds:
        raise TooFewSamplesError(f"lines: needed at least {folds}, one a part, got {len(pieces)}")
    of_line = dict(zip([one.line[0] for one in pieces], folds_of(pieces, folds), strict=True))
    return np.array([of_line[label] for label in lines.line])


def _fit(
    placed: _Placed,
    keep: npt.NDArray[np.bool_],
    part: npt.NDArray[np.int_],
    main_field: Array,
    options: dict[str, Any],
) -> tuple[RectangularHarmonicModel, dict[str, float]]:
    observations = placed.observations(keep, main_field)
    extent = np.ptp(placed.points[:, :2], axis=0)
    folds = np.unique(part[keep]).size
    if folds < 2:
        raise TooFewSamplesError("lines: needed lines in at least two parts to choose from, got one")
    told = {"spectrum_power": SPECTRUM_POWER, **options, "groups": part[keep], "folds": folds}
    ratio = float(told.pop("period_ratio", PERIOD_RATIO))
    names = ("order", "ridge", "damping_m", "spectrum_power", "anisotropy")
    if all(np.ndim(told[name]) == 0 for name in names):
        best = {name: told[name] for name in names}
    else:
        best, _ = RectangularHarmonicModel.select(observations, period_ratio=ratio, **told)
    chosen = {name: best[name] for name in names}
    model = RectangularHarmonicModel.fit_observations(
        observations, **{**told, **chosen}, periods_m=tuple(ratio * extent), misfit=True,
        frame=placed.frame,
    )  # fmt: skip
    return model, chosen


def _options(
    order: int | Sequence[int],
    ridge: float | Sequence[float],
    damping_m: float | Sequence[float],
    anisotropy: float | Sequence[float],
    more: dict[str, Any],
) -> dict[str, Any]:
    return {"order": order, "ridge": ridge, "damping_m": damping_m, "anisotropy": anisotropy, **more}


def _main(main_field: npt.ArrayLike) -> Array:
    main = np.asarray(main_field, dtype=np.float64)
    if main.shape != (3,):
        raise ShapeError(f"main_field: needed (3,): north, east, down, got {main.shape}")
    return main


def model_from_lines(
    lines: Lines,
    height_m: npt.ArrayLike,
    main_field: npt.ArrayLike,
    *,
    order: int | Sequence[int] = 22,
    ridge: float | Sequence[float] = RIDGE,
    damping_m: float | Sequence[float] = DAMPING_M,
    anisotropy: float | Sequence[float] = 1.0,
    folds: int = 5,
    **options: Any,  # noqa: ANN401 - those of fit_observations
) -> RectangularHarmonicModel:
    """Fit a harmonic model to the total-field anomaly on survey lines at their own heights.

    Parameters
    ----------
    lines : the survey: positions in metres or degrees, anomalies in nT.
    height_m : height of every point, shape (n,), or one for all, metres.
    main_field : main field (north, east, down) at the middle; its direction counts.
    order, ridge, damping_m, anisotropy : one each, or several that leaving out whole lines decides between. A few dozen
        lines decide poorly: where the strike is known, tell `anisotropy` (above 1 for features longer to the north).
    folds : parts that the lines are dealt to, neighbours to different ones.
    **options : of `RectangularHarmonicModel.fit_observations`, such as `huber` or `spectrum_power`.

    Returns
    -------
    RectangularHarmonicModel
        With its misfit learnt: `sigma` agrees with the errors on left-out lines. Geographic lines give it a frame with
        its origin in their middle at their median height; others have theirs there too, x to the east of it.

    Raises
    ------
    TooFewSamplesError
        For fewer lines than parts, or fewer points than coefficients.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.harmonic_survey import model_from_lines
    >>> from geomag.survey import Lines
    >>> x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 3000, 60), np.linspace(0, 3000, 13)))
    >>> field = 40 * np.sin(x / 400) * np.cos(y / 700)
    >>> lines = Lines(x, y, field, np.repeat(np.arange(13), 60))
    >>> model = model_from_lines(lines, 80.0, [20e3, 1e3, 40e3], order=10, anisotropy=1.0)
    >>> model.summary["residual_rms"] < 2.0
    True
    """
    placed = _Placed.of(lines, height_m)
    every = np.ones(lines.x.size, dtype=bool)
    told = _options(order, ridge, damping_m, anisotropy, options)
    return _fit(placed, every, _spread(placed, lines, folds), _main(main_field), told)[0]


@dataclass
class Comparison:
    """Errors (observed minus predicted, nT) on left-out lines of a harmonic model and of a gridded map, shape (n,).

    `sigma` is what the model believed of each observation; `chosen` what was chosen in every part.
    """

    model: Array
    grid: Array
    sigma: Array
    line: npt.NDArray[Any]
    chosen: list[dict[str, float]] = field(default_factory=list)

    @property
    def model_rms(self) -> float:
        """Root mean square error of the harmonic model, nT."""
        return float(np.sqrt(np.mean(self.model**2)))

    @property
    def grid_rms(self) -> float:
        """Root mean square error of the gridded map at the same points, nT."""
        return float(np.sqrt(np.mean(self.grid**2)))

    @property
    def normalised(self) -> float:
        """Mean squared error over variance of the harmonic model: 1 where sigma is consistent with the errors."""
        return float(np.mean((self.model / self.sigma) ** 2))

    def __str__(self) -> str:
        median = [float(np.median(np.abs(e))) for e in (self.model, self.grid)]
        return (
            f"{self.model.size} points on left-out lines: harmonic model {self.model_rms:.2f} nT rms, {median[0]:.2f} median; "
            f"gridded map {self.grid_rms:.2f}, {median[1]:.2f}; squared errors over variances {self.normalised:.2f}, "
            f"{np.mean(np.abs(self.model) < 2 * self.sigma):.0%} within two sigma"
        )


def compare_with_map(
    lines: Lines,
    height_m: npt.ArrayLike,
    main_field: npt.ArrayLike,
    *,
    order: int | Sequence[int] = 22,
    ridge: float | Sequence[float] = RIDGE,
    damping_m: float | Sequence[float] = DAMPING_M,
    anisotropy: float | Sequence[float] = 1.0,
    folds: int = 5,
    progress: Callable[[int, int], object] | None = None,
    **options: Any,  # noqa: ANN401 - those of fit_observations
) -> Comparison:
    """Compare, on lines that neither has seen, a harmonic model with the gridded map of the same lines.

    A part of the lines at a time is left out of everything: of the choice of ridge and prior, of the fit, of the learning of
    sigma, and of the map (minimum curvature, as in `map_from_lines`). Points that the map does not reach are left out of
    both. Arguments as in `model_from_lines`; `progress` is called with (parts done, parts).
    """
    placed, main = _Placed.of(lines, height_m), _main(main_field)
    part = _spread(placed, lines, folds)
    told = _options(order, ridge, damping_m, anisotropy, options)
    axes = Axes.over(lines, None)
    xs, ys = axes.coordinates()
    model_errors, grid_errors, sigmas = (np.full(lines.x.size, np.nan) for _ in range(3))
    chosen = []
    for k in range(folds):
        out = part == k
        model, choice = _fit(placed, ~out, part, main, told)
        chosen.append(choice)
        points = placed.points[out].T
        predicted = model.field(*points, extrapolate=True) @ (main / np.linalg.norm(main))
        model_errors[out] = lines.values[out] - predicted
        sigmas[out] = model.sigma(*points, direction=main / np.linalg.norm(main), extrapolate=True)
        surface, _ = grid_lines(lines._take(~out).split(), axes, "minimum_curvature")
        grid = GridMap(surface, xs, ys, geographic=lines.geographic)
        grid_errors[out] = lines.values[out] - grid.sample(lines.x[out], lines.y[out])
        if progress is not None:
            progress(k + 1, folds)
    both = np.isfinite(grid_errors)
    return Comparison(model_errors[both], grid_errors[both], sigmas[both], lines.line[both], chosen)
