"""The matchers of the command line: one function each, all told the same settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from geomag._defaults import default_of
from geomag._errors import InvalidInputError
from geomag._geomag import Fix, GridMap, Iema, Track, match_contour, match_grid, match_posterior
from geomag._words import Criterion

#: Number of samples, feasible set, and the offsets of its columns and rows.
Feasible = tuple[int, NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]


class Method(StrEnum):
    """Matchers of the command line, the recommended one first."""

    posterior = "posterior"
    msd = "msd"
    mad = "mad"
    prod = "prod"
    ncc = "ncc"
    hausdorff = "hausdorff"
    contour = "contour"
    iema = "iema"


#: Methods that options are for; others have no use for them.
MEANT_FOR = {
    "max_misses": {"iema"},
    "letter": {"contour"},
    "max_risk": {"posterior"},
    "map_sigma": {"posterior", "contour"},
    "line_spacing_m": {"posterior", "contour"},
    "scale_sigma": {"posterior", "contour"},
    "tolerance_m": {"iema", "posterior", "contour"},
    "heading_deg": {*get_args(Criterion), "posterior", "contour"},
}
#: Options that plain ICCP has no use for.
NOT_TO_THE_LETTER = ("tolerance_m", "heading_deg", "scale_sigma")

#: Whose scores are good where they are large.
LARGEST_IS_BEST = ("prod", "ncc", "posterior")

#: Gate of IEMA where nothing is said of the sensor, value units.
IEMA_SIGMA = 10.0


@dataclass(frozen=True)
class Settings:
    """What a match was told, in the words of the command line; 0 and None leave it to the method."""

    half_width_m: float
    sigma: float | None = None
    remove_mean: bool = True
    tolerance_m: float = 0.0
    max_risk: float = default_of(match_posterior, "max_risk")
    max_misses: int = default_of(Iema, "max_misses")
    heading_deg: float = 0.0
    scale_sigma: float = default_of(match_posterior, "scale_sigma")
    letter: bool = False
    surface: bool = default_of(match_posterior, "surface")
    bias_drift_sigma: float = default_of(match_posterior, "bias_drift_sigma")

    def map_units(self, grid: GridMap, track: Track, metres: float) -> tuple[float, float]:
        """A length in map units, (x, y), at the newest sample."""
        east, north = grid.metres_per_unit(float(track.y[-1]))
        return metres / east, metres / north


Answer = tuple[Fix, list[Feasible]]


def _iema(grid: GridMap, track: Track, told: Settings) -> Answer:
    iema = Iema(
        grid,
        sigma=IEMA_SIGMA if told.sigma is None else told.sigma,
        half_width=told.map_units(grid, track, told.half_width_m),
        tolerance=told.map_units(grid, track, told.tolerance_m),
        max_misses=told.max_misses,
    )
    frames: list[Feasible] = []
    if told.surface:
        for px, py, v in zip(track.x, track.y, track.values, strict=True):
            step = iema.update(px, py, v)
            frames.append((step.n_samples, iema.feasible, *iema.offsets))
            if step.status != "searching":
                break
    return iema.run(track), frames


def _posterior(grid: GridMap, track: Track, told: Settings) -> Answer:
    fix = match_posterior(
        grid,
        track,
        half_width=told.map_units(grid, track, told.half_width_m),
        sigma=told.sigma,
        tolerance_m=told.tolerance_m or None,
        max_risk=told.max_risk,
        bias_sigma=None if told.remove_mean else 0.0,
        heading_sigma_deg=told.heading_deg,
        scale_sigma=told.scale_sigma,
        bias_drift_sigma=told.bias_drift_sigma,
        surface=told.surface,
    )
    return fix, []


def _contour(grid: GridMap, track: Track, told: Settings) -> Answer:
    if told.letter:
        return match_contour(grid, track, sigma=told.sigma, radius_m=told.half_width_m), []
    fix = match_contour(
        grid,
        track,
        transform="translation",
        starts="grid",
        refine=True,
        sigma=told.sigma,
        half_width_m=told.half_width_m,
        # The half width bounds the INS error: three standard deviations.
        offset_sigma_m=told.half_width_m / 3.0,
        heading_sigma_deg=told.heading_deg or None,
        scale_sigma=told.scale_sigma or None,
        bias_sigma=np.inf if told.remove_mean else None,
        tolerance_m=told.tolerance_m or None,
    )
    return fix, []


def _search(criterion: Criterion) -> Callable[[GridMap, Track, Settings], Answer]:
    def search(grid: GridMap, track: Track, told: Settings) -> Answer:
        fix = match_grid(
            grid,
            track,
            criterion,
            half_width=told.map_units(grid, track, told.half_width_m),
            sigma=told.sigma,
            remove_mean=told.remove_mean and criterion in ("msd", "mad"),
            heading_deg=np.linspace(-told.heading_deg, told.heading_deg, 11) if told.heading_deg else [0.0],
            surface=told.surface,
        )
        return fix, []

    return search


_RUN: dict[str, Callable[[GridMap, Track, Settings], Answer]] = {
    "posterior": _posterior,
    "contour": _contour,
    "iema": _iema,
    **{name: _search(name) for name in get_args(Criterion)},
}


def solve(grid: GridMap, track: Track, method: str, told: Settings) -> Answer:
    """Run one matcher; for IEMA with `surface` also the feasible set after every sample."""
    if not (np.isfinite(told.half_width_m) and told.half_width_m > 0):
        raise InvalidInputError(f"--half-width-m: needed a number > 0, got {told.half_width_m}")
    return _RUN[method](grid, track, told)


def risk_of(method: str, tolerance_m: float) -> str:
    """Of what the risk of a fix is, which differs from method to method."""
    if method == "contour":
        what = f"that the error is beyond {tolerance_m:g} m" if tolerance_m else "of another minimum of the misfit"
        return f"{what} (not calibrated)"
    return f"that the error is beyond {f'{tolerance_m:g} m' if tolerance_m else 'one cell of the map'}"
