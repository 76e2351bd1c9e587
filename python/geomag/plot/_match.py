"""All about one match on one sheet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag.plot._diagrams import residuals
from geomag.plot._frames import Frame, draw_frames, pick, score_surface
from geomag.plot._maps import _xy, ellipse, field_map, tracks
from geomag.plot._style import new_axes, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geomag._geomag import Fix, GridMap, Track


def _bounds(grid: GridMap, clouds: Sequence[np.ndarray[Any, Any]], margin: float) -> tuple[float, float, float, float]:
    """Box about all points, with a margin, within the map and nearly square on the ground."""
    points = np.concatenate(clouds)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    east, north = grid.metres_per_unit(float((low[1] + high[1]) / 2))
    scale = np.array([east, north])
    reach = np.maximum(np.max((high - low) * scale) * (0.5 + margin), (high - low) * scale * (0.5 + margin))
    cells = 12 * np.array([abs(grid.x[1] - grid.x[0]), abs(grid.y[1] - grid.y[0])])
    reach = np.maximum(reach / scale, cells)
    centre = (low + high) / 2
    least = np.maximum(centre - reach, [grid.x[0], grid.y[0]])
    most = np.minimum(centre + reach, [grid.x[-1], grid.y[-1]])
    return float(least[0]), float(least[1]), float(most[0]), float(most[1])


def _turn_onto(grid: GridMap, xy: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Bring longitudes onto the map's own turn."""
    if not grid.geographic:
        return xy
    middle = (grid.x[0] + grid.x[-1]) / 2
    return np.column_stack([xy[:, 0] - 360.0 * np.floor((xy[:, 0] - middle + 180.0) / 360.0), xy[:, 1]])


def true_offset(grid: GridMap, track: Track, truth: object | None) -> tuple[float, float] | None:
    """Offset of the newest sample, map units, where the truth is known."""
    if truth is None:
        return None
    newest, indicated = _turn_onto(grid, _xy(truth))[-1], _turn_onto(grid, _xy(track))[-1]
    return float(newest[0] - indicated[0]), float(newest[1] - indicated[1])


@styled
def match_map(
    grid: GridMap, track: Track, fix: Fix, ax: Axes | None = None, *, truth: object | None = None,
    title: str | None = None,
) -> Axes:  # fmt: skip
    """Draw the part of the map about a match with indicated, matched and (where it is known) true track."""
    ax = new_axes(ax, 6.8, 5.6)
    indicated = _turn_onto(grid, _xy(track))
    true_points = None if truth is None else _turn_onto(grid, _xy(truth))
    matched = _turn_onto(grid, _xy(fix))
    shown = matched if len(matched) and np.isfinite(matched).all() else None
    bounds = _bounds(grid, [c for c in (indicated, true_points, shown) if c is not None], 0.12)
    field_map(grid, ax, bounds=bounds, title=title)
    tracks(ax, indicated=indicated, true=true_points, matched=shown, legend=False)
    if fix.covariance_m2 is not None and np.isfinite(fix.covariance_m2).all():
        ellipse(ax, fix.x, fix.y, fix.covariance_m2, geographic=grid.geographic)
    ax.legend(loc="upper left")
    ax.set_xlim(bounds[0], bounds[2])
    ax.set_ylim(bounds[1], bounds[3])
    return ax


@styled
def match_figure(
    grid: GridMap,
    track: Track,
    fix: Fix,
    *,
    truth: object | None = None,
    steps: Sequence[Frame] | None = None,
    surface_fix: Fix | None = None,
    surface_label: str = "score",
    least_is_best: bool = True,
    title: str | None = None,
) -> Figure:
    """Draw one match: map with tracks, score surface, feasible set or posterior sample by sample, residuals.

    Parameters
    ----------
    grid : the map that was matched on.
    track : the indicated track with its readings.
    fix : the answer.
    truth : the true track, where it is known: a `Path`, a `Track` or an (n, 2) array.
    steps : what the matcher believed after each sample, for the shrinking feasible set or posterior.
    surface_fix : a fix that carries the score surface, where `fix` itself does not.
    surface_label : what the score is, with its unit.
    least_is_best : whether small scores are good.
    title : of the figure; by default the answer in words.
    """
    with_surface = surface_fix or fix
    has_surface = with_surface.surface is not None
    panels = [has_surface, bool(steps)]
    figure = new_figure(12.0 if any(panels) else 7.2, 8.2 if all(panels) or not any(panels) else 7.4)
    left: Any = figure
    right: Any = None
    if any(panels):
        halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 0.85))
        left, right = halves
    map_ax, profile_ax = left.subplots(2, 1, height_ratios=(2.6, 1.0))
    match_map(grid, track, fix, map_ax, truth=truth)
    residuals(grid, track, fix, profile_ax, title="Readings and the map along the track")
    offset = true_offset(grid, track, truth)
    latitude = float(track.y[-1]) if grid.geographic else 0.0
    if right is not None:
        parts: Any = right.subfigures(2, 1, height_ratios=(1.0, 1.15)) if all(panels) else [right]
        if has_surface:
            score_surface(
                with_surface, ax=parts[0].subplots(), geographic=grid.geographic, latitude_deg=latitude,
                true_offset=offset, label=surface_label, least_is_best=least_is_best,
                title="Score of every offset searched",
            )  # fmt: skip
        if steps:
            axes = list(np.ravel(parts[-1].subplots(2, 3)))
            draw_frames(axes, 3, pick(steps, 6), true_offset=offset, geographic=grid.geographic, latitude=latitude)
            kind = "Offsets still feasible" if np.asarray(steps[0].values).dtype == bool else "Posterior"
            parts[-1].suptitle(f"{kind}, sample by sample", x=0.02, ha="left", fontsize=10)
    figure.suptitle(title or _words(fix, offset, grid, latitude), x=0.01, ha="left", fontsize=11)
    return figure


def _words(fix: Fix, offset: tuple[float, float] | None, grid: GridMap, latitude: float) -> str:
    """Return the answer in words."""
    if not np.isfinite(fix.offset_m).all():
        return f"{fix.status.capitalize()} after {fix.n_samples} samples: no position"
    east, north = fix.offset_m
    words = (
        f"{fix.status.capitalize()} after {fix.n_samples} samples: the indicated position is to be moved by "
        f"{abs(east):.0f} m {'east' if east >= 0 else 'west'}, {abs(north):.0f} m {'north' if north >= 0 else 'south'}"
    )
    if offset is not None:
        scale = grid.metres_per_unit(latitude)
        error = np.hypot(*((np.asarray(fix.offset) - offset) * scale))
        words += f"; error {error:.0f} m"
    return words
