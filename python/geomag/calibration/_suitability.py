"""Where on a map one can fix: expected error and the probability of a fix, by place and heading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Track, predict_many
from geomag._optional import require
from geomag._ranges import above, at_least
from geomag.calibration._answers import Array
from geomag.survey._steps import Progress


@dataclass(frozen=True)
class Suitability:
    """Where one can fix: axes `x`, `y` (map units), `heading_deg`; layers of shape (heading, y, x), NaN where unknown.

    `sigma_m` is the expected standard deviation (both axes together), `samples` after how many samples twice that is within the
    tolerance (NaN: not within the sequence), `fix_probability` the share of simulated flights that were fixed.
    """

    x: Array
    y: Array
    heading_deg: Array
    sigma_m: Array
    samples: Array
    fix_probability: Array
    spacing_m: float
    geographic: bool

    def to_netcdf(self, path: str | Path) -> None:
        """Write the layers; needs xarray with a netCDF library (extra `io`)."""
        xarray = require("xarray", "io", "writing netCDF")
        dims = ("heading", "y", "x")
        data = xarray.Dataset(
            {
                "sigma": (dims, self.sigma_m, {"units": "m"}),
                "samples_to_fix": (dims, self.samples),
                "fix_probability": (dims, self.fix_probability),
            },
            coords={"heading": ("heading", self.heading_deg, {"units": "degrees"}), "y": self.y, "x": self.x},
            attrs={"sample_spacing_m": self.spacing_m, "geographic": int(self.geographic)},
        )
        data.to_netcdf(path)

    def plot(self, path: str | Path) -> None:
        """Draw expected error and the share of flights not fixed, means over the headings; needs matplotlib (extra `plot`)."""
        from geomag.plot import save, suitability_map
        from geomag.plot._style import new_figure

        layers = ((self.sigma_m, "expected standard deviation (m)"), (1 - self.fix_probability, "share not fixed"))
        figure = new_figure(11.0, 4.6)
        for k, (layer, label) in enumerate(layers):
            known = np.isfinite(layer)
            mean = np.where(known.any(axis=0), np.nansum(layer, axis=0) / np.maximum(known.sum(axis=0), 1), np.nan)
            ax = figure.add_subplot(1, 2, k + 1)
            suitability_map(mean, self.x, self.y, ax, geographic=self.geographic, label=label)
        save(figure, path)


def suitability(
    grid: GridMap,
    *,
    spacing_m: float,
    half_width_m: float,
    tolerance_m: float | None = None,
    sigma: float | None = None,
    samples: int = 40,
    headings_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0),
    places: int = 20,
    flights: int = 3,
    seed: int = 0,
    progress: Progress = None,
    **options: Any,  # noqa: ANN401 - options of predict_many, as they are
) -> Suitability:
    """Expected fixes over the map: `places` x `places` tracks a heading, centred on each place, `spacing_m` between samples."""
    if places < 1 or samples < 3:
        raise InvalidInputError(f"places, samples: needed at least 1 and 3, got {places} and {samples}")
    above(0, spacing_m=spacing_m, half_width_m=half_width_m)
    at_least(0, flights=flights)
    edges = [np.linspace(float(a[0]), float(a[-1]), places + 1) for a in (grid.x, grid.y)]
    x, y = (0.5 * (e[1:] + e[:-1]) for e in edges)
    tracks = []
    along = spacing_m * (np.arange(samples) - 0.5 * (samples - 1))
    for heading in np.radians(headings_deg):
        for north in y:
            scale = grid.metres_per_unit(float(north))
            for east in x:
                tracks.append(
                    Track(
                        east + along * np.sin(heading) / scale[0],
                        north + along * np.cos(heading) / scale[1],
                        np.zeros(samples),
                    )
                )
    scale = grid.metres_per_unit(float(np.mean(y)))
    found = predict_many(
        grid,
        tracks,
        half_width=(half_width_m / scale[0], half_width_m / scale[1]),
        sigma=sigma,
        tolerance_m=tolerance_m,
        flights=flights,
        seed=seed,
        progress=progress,
        **options,
    )
    shape = (len(headings_deg), places, places)

    def layer(get: Callable[[Any], float | None]) -> Array:
        values = [np.nan if p is None or (v := get(p)) is None else v for p in found]
        return np.array(values, dtype=float).reshape(shape)

    return Suitability(
        x,
        y,
        np.array(headings_deg, dtype=float),
        layer(lambda p: float(np.sqrt(np.trace(p.covariance_m2)))),
        layer(lambda p: p.samples_to_fix),
        layer(lambda p: p.fix_probability),
        spacing_m,
        grid.geographic,
    )
