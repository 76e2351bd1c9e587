"""Calibration on simulated flights over a map that is right."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomag._defaults import default_of
from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Track, match_posterior_many
from geomag._ranges import above, at_least
from geomag.calibration._answers import Calibration
from geomag.calibration._assess import assess


def calibrate_simulated(
    grid: GridMap,
    *,
    sigma: float,
    name: str = "simulated",
    half_width_m: float,
    tolerance_m: float,
    samples: int = 40,
    trials: int = 1000,
    bias: float = 0.0,
    outlier_share: float = 0.0,
    outlier: float = 0.0,
    heading_deg: float = 0.0,
    drift_m: float = 0.0,
    seed: int = 0,
    streaming: bool = False,
    max_risk: float = default_of(match_posterior_many, "max_risk"),
    **options: Any,  # noqa: ANN401 - options of match_posterior, as they are
) -> Calibration:
    """Calibration on simulated flights over a map that is right (its sigma is taken as the map has it).

    Straight tracks at random places and headings, 1 to 3 cells a sample; normal noise of `sigma`; a bias uniform in
    +-`bias`; a share of outliers of +-`outlier`; a normal heading error; a drift of `drift_m` in a random direction over
    the sequence. Heading and drift are told to the matcher as an INS specification would: `heading_deg` as a standard
    deviation, `drift_m` as a bound on each component, which stands for a rectangular law with a standard deviation of
    `drift_m` / sqrt(3) per axis (JCGM 100:2008, 4.3.7), though every flight drifts by the whole of it.
    `heading_sigma_deg` and `drift_sigma_m` tell it something else.
    """
    above(0, half_width_m=half_width_m, tolerance_m=tolerance_m)
    at_least(1, samples=samples, trials=trials)
    at_least(0, sigma=sigma, bias=bias, outlier=outlier, heading_deg=heading_deg, drift_m=drift_m)
    if not 0 <= outlier_share <= 1:
        raise InvalidInputError(f"outlier_share: needed a share in [0, 1], got {outlier_share}")
    options = {"heading_sigma_deg": heading_deg, "drift_sigma_m": drift_m / np.sqrt(3)} | options
    rng = np.random.default_rng(seed)
    tracks: list[Track] = []
    truth: list[Any] = []
    cell = np.array(grid.spacing)
    low = np.array([grid.x[0], grid.y[0]])
    high = np.array([grid.x[-1], grid.y[-1]])
    refused = 0
    while len(tracks) < trials:
        place = rng.uniform(low, high)
        east, north = grid.metres_per_unit(float(place[1]))
        metres = np.array([east, north])
        course = rng.uniform(0, 2 * np.pi)
        step = rng.uniform(1, 3) * cell * [np.sin(course), np.cos(course)]
        path = place + step * np.arange(samples)[:, None]
        margin = 1.2 * half_width_m / metres
        clear = np.all(path > low + margin) and np.all(path < high - margin)
        if not clear or not np.all(np.isfinite(values := grid.sample(path[:, 0], path[:, 1]))):
            refused += 1
            if refused > 1000 * trials:
                raise InvalidInputError("map: needed room for the tracks, got a map too small or too full of holes")
            continue
        values = values + rng.normal(0, sigma, samples) + rng.uniform(-bias, bias)
        if outlier_share > 0:
            values = values + (rng.random(samples) < outlier_share) * rng.choice([-1, 1], samples) * outlier
        away = rng.uniform(0, 2 * np.pi)
        age = np.linspace(1, 0, samples)[:, None]
        # True = indicated + offset - age * drift at every sample; the heading error turns about the newest.
        turned = (path - path[-1]) * metres
        angle = np.radians(rng.normal(0, heading_deg))
        turned = turned @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).T
        moved = turned - (path - path[-1]) * metres + age * drift_m * np.array([np.sin(away), np.cos(away)])
        # The bound that the matcher is told holds all along the track.
        low_m, high_m = np.max(moved, axis=0) - half_width_m, np.min(moved, axis=0) + half_width_m
        if np.any(low_m >= high_m):
            refused += 1
            continue
        offset = rng.uniform(low_m, high_m)
        indicated = path + (moved - offset) / metres
        tracks.append(Track(indicated[:, 0], indicated[:, 1], values))
        truth.append(path)
    return assess(
        grid,
        tracks,
        np.array(truth),
        name=name,
        half_width_m=half_width_m,
        tolerance_m=tolerance_m,
        max_risk=max_risk,
        sigma=sigma,
        streaming=streaming,
        **options,
    )
