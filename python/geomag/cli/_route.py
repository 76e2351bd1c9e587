"""What a planned route promises: windows along it, each with its expected error and its chance of a fix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Track, predict_many
from geomag.cli._common import aligned
from geomag.survey._lines import along_m

#: Simulated flights a window.
FLIGHTS = 30


def read_route(path: Path, x: str | None, y: str | None, grid: GridMap) -> tuple[np.ndarray, np.ndarray]:
    """Waypoints of a table, at least two, in the map's coordinates; what was done to bring them there is told."""
    from geomag.io._tracks import waypoints

    track = aligned(grid, waypoints(path, x, y, grid))
    return track.x, track.y


def along_route(
    grid: GridMap,
    x: np.ndarray,
    y: np.ndarray,
    *,
    spacing_m: float,
    samples: int,
    half_width_m: float,
    tolerance_m: float,
    sigma: float,
) -> list[dict[str, float | None]]:
    """Windows of `samples` readings `spacing_m` apart along the waypoints, half overlapping, in the order flown."""
    scale = grid.metres_per_unit(float(np.mean(y)))
    along = along_m(x, y, scale)
    at = np.arange(0.0, along[-1] + 1e-9, spacing_m)
    if at.size < samples:
        raise InvalidInputError(
            f"--route: needed {(samples - 1) * spacing_m:.0f} m for {samples} samples, got a route of {along[-1]:.0f} m"
        )
    px, py = np.interp(at, along, x), np.interp(at, along, y)
    ends = range(samples, at.size + 1, max(1, samples // 2))
    tracks = [Track(px[e - samples : e], py[e - samples : e], np.zeros(samples)) for e in ends]
    found = predict_many(
        grid, tracks, half_width=(half_width_m / scale[0], half_width_m / scale[1]), sigma=sigma, tolerance_m=tolerance_m,
        flights=FLIGHTS,
    )  # fmt: skip
    rows: list[dict[str, float | None]] = []
    for end, one in zip(ends, found, strict=True):
        row: dict[str, float | None] = {
            "distance_m": float(at[end - 1]),
            "x": float(px[end - 1]),
            "y": float(py[end - 1]),
        }
        row["sigma_m"] = None if one is None else float(np.sqrt(np.trace(one.covariance_m2)))
        row["fix_probability"] = None if one is None else one.fix_probability
        rows.append(row)
    return rows
