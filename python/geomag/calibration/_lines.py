"""Calibration on survey lines that are not in the map."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomag._defaults import default_of
from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap, Track, match_posterior_many
from geomag._ranges import above, at_least
from geomag.calibration._answers import Array, Calibration
from geomag.calibration._assess import assess
from geomag.survey import Lines, map_from_lines
from geomag.survey._steps import Progress
from geomag.survey._survey import windows_of


def calibrate_lines(
    lines: Lines,
    *,
    name: str = "survey",
    half_width_m: float,
    tolerance_m: float,
    spacing_m: float,
    samples: int = 40,
    folds: int = 3,
    max_risk: float = default_of(match_posterior_many, "max_risk"),
    most: int = 2000,
    overlap: float = 0.0,
    seed: int = 1,
    streaming: bool = False,
    progress: Progress = None,
    **map_options: Any,  # noqa: ANN401 - options of map_from_lines, as they are
) -> Calibration:
    """Calibration on lines that are not in the map.

    A `folds`-th of the lines (neighbours in different folds) is taken away at a time; map and error model are made from the
    others alone; windows of `samples` samples `spacing_m` apart along the lines taken away, started anywhere within
    `half_width_m` per axis, are matched. At most `most` windows, drawn at random; a window shares `overlap` of its samples with
    the next, and the intervals of the answer are those of the windows that would not. Errors are learnt for windows as they are flown, unless
    `map_options` say otherwise. `streaming` stops each window at its first fix.
    """
    above(0, half_width_m=half_width_m, tolerance_m=tolerance_m, spacing_m=spacing_m)
    at_least(2, samples=samples, folds=folds)
    at_least(folds, most=most)
    if not 0 <= overlap < 1:
        raise InvalidInputError(f"overlap: needed a share in [0, 1), got {overlap}")
    as_flown: dict[str, Any] = {
        "spacing_m": spacing_m,
        "half_width_m": half_width_m,
        "tolerance_m": tolerance_m,
        "samples": samples,
    }
    as_flown = {name: value for name, value in as_flown.items() if name not in map_options}
    rng = np.random.default_rng(seed)
    parts = []
    apart = 0
    for kept, left in lines.survey.parted(folds):
        grid = map_from_lines(Lines.joined(kept), progress=progress, **as_flown, **map_options)

        def usable(share: float, left: list[Lines] = left, grid: GridMap = grid) -> list[tuple[Array, Array, Array]]:
            some = windows_of(left, spacing_m, samples, share, shortest=samples)
            return [w for w in some if len(w[0]) == samples and np.mean(np.isfinite(grid.sample(w[0], w[1]))) >= 0.9]

        windows = usable(overlap)
        apart += len(usable(0.0))
        if len(windows) > most // folds:
            windows = [windows[i] for i in rng.choice(len(windows), most // folds, replace=False)]
        tracks, truth = [], []
        for x, y, v in windows:
            east, north = grid.metres_per_unit(float(y[-1]))
            offset = rng.uniform(-half_width_m, half_width_m, 2) / (east, north)
            tracks.append(Track(x - offset[0], y - offset[1], v))
            truth.append((x[-1], y[-1]))
        if tracks:
            parts.append(
                assess(
                    grid,
                    tracks,
                    np.array(truth),
                    name=name,
                    half_width_m=half_width_m,
                    tolerance_m=tolerance_m,
                    max_risk=max_risk,
                    streaming=streaming,
                )
            )
    if not parts:
        raise TooFewSamplesError(f"lines: needed a line of {samples} samples, {spacing_m:g} m apart, got none")
    arrays = {
        key: np.concatenate([getattr(p, key) for p in parts])
        for key in ("risk", "error_m", "fixed", "status", "nees", "samples")
    }
    independent = 1.0 if overlap == 0 else min(1.0, apart / len(arrays["risk"]))
    return Calibration(name, tolerance_m, max_risk, independent=independent, **arrays)
