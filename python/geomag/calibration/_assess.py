"""Tracks whose truth is known, matched and judged."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomag._defaults import default_of
from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap, Track, match_posterior_many
from geomag.calibration._answers import Array, Calibration


def assess(
    grid: GridMap,
    tracks: list[Track],
    truth: Array,
    *,
    name: str,
    half_width_m: float,
    tolerance_m: float,
    max_risk: float = default_of(match_posterior_many, "max_risk"),
    **options: Any,  # noqa: ANN401 - options of match_posterior, as they are
) -> Calibration:
    """Match tracks whose true positions are known. Other options are those of `match_posterior`.

    `truth` has the newest position of every track, shape (n, 2), or those of all samples, (n, samples, 2): what a streamed answer
    needs where the offset changes along the track, because it comes before the last sample.
    """
    truth = np.asarray(truth, dtype=float)
    if truth.shape[:1] != (len(tracks),) or truth.ndim not in (2, 3) or truth.shape[-1] != 2:
        raise InvalidInputError(
            f"truth: needed shape ({len(tracks)}, 2) or ({len(tracks)}, samples, 2), got {truth.shape}"
        )
    if not tracks:
        raise TooFewSamplesError("tracks: needed at least 1, got 0")
    east, north = grid.metres_per_unit(float(np.mean(truth[..., 1])))
    fixes = match_posterior_many(
        grid,
        tracks,
        half_width=(half_width_m / east, half_width_m / north),
        tolerance_m=tolerance_m,
        max_risk=max_risk,
        **options,
    )
    n = len(fixes)
    risk, error, nees = np.ones(n), np.full(n, np.inf), np.full(n, np.nan)
    for i, (fix, track, place) in enumerate(zip(fixes, tracks, truth, strict=True)):
        if fix.risk is None:
            continue
        risk[i] = fix.risk
        # Judged by the offset at the newest sample that the answer rests on: a streamed fix may come before the last.
        newest = fix.n_samples - 1 if truth.ndim == 3 else -1
        x, y = place[newest] if truth.ndim == 3 else place
        here = grid.metres_per_unit(float(y))
        e = (np.array(fix.offset) - [x - track.x[newest], y - track.y[newest]]) * here
        error[i] = np.hypot(*e)
        covariance = fix.covariance_m2
        if covariance is not None and np.linalg.det(covariance) > 0:
            nees[i] = e @ np.linalg.solve(covariance, e)
    return Calibration(
        name,
        tolerance_m,
        max_risk,
        risk,
        error,
        np.array([f.ok for f in fixes]),
        np.array([f.status for f in fixes]),
        nees,
        np.array([f.n_samples for f in fixes]),
    )
