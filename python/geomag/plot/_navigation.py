"""A navigated flight on one sheet: map, log and bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomag.plot._maps import field_map, tracks
from geomag.plot._match import _bounds
from geomag.plot._style import COLOURS, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from geomag._geomag import GridMap
    from geomag._navigation import Navigation

#: Shades of the times in which the navigator does not track.
_SHADES = {"acquiring": "#c9d3df", "coasting": "#f3e3b3", "lost": "#f0b9a4"}


def _runs(status: NDArray[np.str_], name: str) -> list[tuple[int, int]]:
    """First and last index of every stretch of a status."""
    inside = np.concatenate([[False], status == name, [False]])
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@styled
def navigation_figure(
    grid: GridMap,
    flight: Navigation,
    indicated: tuple[NDArray[np.float64], NDArray[np.float64]],
    readings: NDArray[np.float64],
    *,
    truth: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw one flight: the map with indicated, corrected and (where it is known) true track; readings beside the map along it; error and bounds over time.

    Parameters
    ----------
    grid : the map.
    flight : what `navigate` answered.
    indicated : x and y of the INS, shape (n,) each, map units.
    readings : shape (n,), NaN where there was none.
    truth : true x and y, where they are known.
    title : of the figure; by default the flight in words.
    """
    figure = new_figure(12.0, 7.4)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.05))
    left, right = halves
    ax = left.subplots()
    shown = [np.column_stack(indicated), np.column_stack([flight.x, flight.y])]
    known = None if truth is None else np.column_stack(truth)
    bounds = _bounds(grid, shown if known is None else [*shown, known], 0.06)
    field_map(grid, ax, bounds=bounds)
    tracks(ax, indicated=shown[0], true=known, matched=shown[1], legend=False)
    lost = flight.status == "lost"
    if lost.any():
        ax.plot(flight.x[lost], flight.y[lost], ".", ms=2, color="#a84300", label="lost")
    ax.legend(loc="upper left")
    ax.set_xlim(bounds[0], bounds[2])
    ax.set_ylim(bounds[1], bounds[3])
    hours = (flight.time_s - flight.time_s[0]) / 3600
    above: Any
    below: Any
    above, below = right.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.3))
    expected = grid.sample(flight.x, flight.y)
    above.plot(hours, expected, color=COLOURS["matched"], lw=1.0, label="map at the corrected place")
    above.plot(
        hours,
        readings - flight.bias,
        ".",
        ms=2.0,
        color=COLOURS["neutral"],
        label="readings less the sensor's bias",
        zorder=1,
    )
    # Spikes are drawn where they are, but do not set the scale.
    low, high = np.nanquantile(np.concatenate([expected, readings - flight.bias]), [0.002, 0.998])
    above.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    above.set_ylabel(grid.units or "map's unit")
    above.legend(loc="upper left")
    for name, shade in _SHADES.items():
        for k, (a, b) in enumerate(_runs(flight.status, name)):
            below.axvspan(hours[a], hours[b], color=shade, lw=0, zorder=0, label=name if k == 0 else None)
    sigma = np.sqrt(np.linalg.eigvalsh(flight.covariance_m2)[:, -1])
    below.plot(hours, flight.protection_level_m, color=COLOURS["neutral"], ls="--", label="protection level")
    below.plot(hours, sigma, color=COLOURS["matched"], ls=":", label="standard deviation (greater axis)")
    if known is not None:
        x, y = known.T
        scale = np.array([grid.metres_per_unit(float(v)) for v in y[:: max(1, y.size // 200)]])
        east, north = (np.interp(np.arange(y.size), np.arange(y.size)[:: max(1, y.size // 200)], s) for s in scale.T)
        alone = np.hypot((indicated[0] - x) * east, (indicated[1] - y) * north)
        below.plot(hours, alone, color=COLOURS["indicated"], label="error of the INS alone")
        below.plot(hours, np.hypot((flight.x - x) * east, (flight.y - y) * north), color=COLOURS["true"], label="error")
    below.set_yscale("log")
    # Room for the legend above what is drawn.
    below.set_ylim(top=6.0 * below.get_ylim()[1])
    below.set_ylabel("m")
    below.set_xlabel("time (h)")
    below.grid(True)
    below.legend(loc="upper left", ncols=2)
    figure.suptitle(title or words(flight), x=0.01, ha="left", fontsize=11)
    return figure


def words(flight: Navigation) -> str:
    """The flight in words: how it ends, and how much of it was tracked."""
    sigma = float(np.sqrt(np.linalg.eigvalsh(flight.covariance_m2[-1])[-1]))
    share = float(np.mean(np.isin(flight.status, ("tracking", "coasting"))))
    hours = (flight.time_s[-1] - flight.time_s[0]) / 3600
    return (
        f"{flight.status[-1].capitalize()} at the end of {hours:.1f} h, to {sigma:.0f} m (standard deviation); protection level "
        f"{flight.protection_level_m[-1]:.0f} m; tracked {100 * share:.0f} % of the time"
    )
