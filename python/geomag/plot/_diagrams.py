"""Diagrams that are no maps: residuals, calibration, sequence choice, filter errors, distributions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._statistics import binomial_interval
from geomag.plot._style import COLOURS, new_axes, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from geomag._geomag import Fix, GridMap, Track


def _units(grid: GridMap) -> str:
    units = getattr(grid, "units", None)
    return f" ({units})" if units else " (map units)"


@styled
def residuals(grid: GridMap, track: Track, fix: Fix, ax: Axes | None = None, *, title: str | None = None) -> Axes:
    """Draw the readings and the map's values along the track, as indicated and as matched.

    A match that is right brings the map's profile onto the readings; the root mean square of what is left is given,
    with the constant taken out that the match estimated, if it did.
    """
    ax = new_axes(ax, 6.4, 2.8)
    along = np.asarray(track.distance_m(geographic=grid.geographic))
    unit, divisor = ("km", 1000.0) if along[-1] >= 3000.0 else ("m", 1.0)
    measured = np.asarray(track.values)
    profiles = [("indicated", grid.sample(track.x, track.y), 0.0)]
    corrected = np.asarray(fix.track).reshape(-1, 2)
    if len(corrected) == len(track):
        profiles.append(("matched", grid.sample(corrected[:, 0], corrected[:, 1]), fix.bias or 0.0))
    for name, values, bias in profiles:
        left = measured - values - bias
        rms = math.sqrt(float(np.nanmean(left**2))) if np.isfinite(left).any() else math.nan
        dash: Any = (0, (4, 2)) if name == "indicated" else "-"
        ax.plot(along / divisor, values + bias, color=COLOURS[name], ls=dash, lw=1.5,
                label=f"map at {name} positions (rms {rms:.3g})")  # fmt: skip
    ax.plot(along / divisor, measured, color=COLOURS["measured"], marker="x", ms=4, ls="none", label="measured")
    ax.set_xlabel(f"distance along the track ({unit})")
    ax.set_ylabel(f"field{_units(grid)}")
    ax.margins(x=0.01, y=0.12)
    ax.grid(True)
    ax.legend(loc="best", ncols=1)
    if title:
        ax.set_title(title)
    return ax


@styled
def calibration_diagram(
    risk: ArrayLike,
    wrong: ArrayLike,
    ax: Axes | None = None,
    *,
    edges: Sequence[float] = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
    label: str | None = None,
    colour: str | None = None,
) -> Axes:
    """Draw declared risk against the observed rate of wrong fixes, with 95 % binomial intervals.

    Points on or below the diagonal keep what was declared. Numbers of fixes stand beside the points.

    Parameters
    ----------
    risk : (n,) declared risks.
    wrong : (n,) whether each was wrong.
    ax : where to draw; call again on the same axes to compare methods.
    edges : of the bins of declared risk.
    label, colour : of this set.
    """
    declared, bad = np.asarray(risk, dtype=np.float64), np.asarray(wrong, dtype=bool)
    if declared.ndim != 1 or declared.shape != bad.shape:
        raise InvalidInputError(f"calibration: needed two (n,) arrays, got {declared.shape} and {bad.shape}")
    if not ((declared >= 0) & (declared <= 1)).all():
        raise InvalidInputError("calibration: needed risks in [0, 1], got some outside or NaN")
    points = []
    for low, high in pairwise(edges):
        inside = (declared >= low) & ((declared < high) | (high == edges[-1]) & (declared == high))
        n = int(inside.sum())
        if n:
            k = int(bad[inside].sum())
            points.append((float(declared[inside].mean()), k / n, *binomial_interval(k, n), n))
    return reliability_points(points, ax, label=label, colour=colour)


@styled
def reliability_points(
    points: Sequence[tuple[float, float, float, float, int]],
    ax: Axes | None = None,
    *,
    label: str | None = None,
    colour: str | None = None,
) -> Axes:
    """Draw bins of declared risk: (mean declared, observed rate, lower and upper end of its interval, number) of each."""
    fresh = ax is None
    ax = new_axes(ax, 4.6, 4.2)
    floor = 2e-4
    if fresh:
        ax.plot([floor, 1], [floor, 1], color=COLOURS["neutral"], lw=1.0, ls=":", label="as declared")
        # Named in the legend: error bars may stand anywhere in it.
        worse = "worse than declared"
        ax.fill_between([floor, 1], [floor, 1], [1, 1], fc=(COLOURS["bad"], 0.07), lw=0, label=worse)
    shift = 1.0 + 0.06 * len(ax.containers)
    if points:
        mean, rate, lower, upper, count = (np.array(c) for c in zip(*points, strict=True))
        at, shown = np.maximum(mean, floor) * shift, np.maximum(rate, floor)
        spread = np.stack([shown - np.clip(lower, floor, shown), np.maximum(upper, floor) - shown])
        colour = colour or COLOURS["matched"]
        ax.errorbar(at, shown, yerr=spread, fmt="o", color=colour, capsize=2.5, lw=1.2, label=label)
        for x, y, n in zip(at, upper, count, strict=True):
            ax.annotate(f"{int(n)}", (x, y), (0, 3), textcoords="offset points", fontsize=7, ha="center", color=colour)
    ax.set(xscale="log", yscale="log", xlim=(floor, 1.2), ylim=(floor, 1.2))
    ax.set_xlabel("declared risk (mean of the bin)")
    ax.set_ylabel("observed rate of wrong fixes")
    ax.grid(True)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, columnspacing=1.0)
    return ax


@styled
def sequence_choice(
    distance_m: ArrayLike,
    values: ArrayLike,
    chosen: ArrayLike,
    ax: Axes | None = None,
    *,
    staircase: ArrayLike | None = None,
    units: str = "nT",
    title: str | None = None,
) -> Axes:
    """Draw the field's profile with the samples that were chosen for matching, and the staircase that chose them.

    Parameters
    ----------
    distance_m : (n,) along-track distance.
    values : (n,) field values.
    chosen : indices of the chosen samples, as from `geomag.delta_modulation`.
    ax : where to draw; a new figure where not given.
    staircase : (n,) the delta modulator's staircase, value units.
    units : of the values.
    title : of the axes.
    """
    ax = new_axes(ax, 6.4, 2.8)
    along, field, keep = np.asarray(distance_m), np.asarray(values), np.asarray(chosen, dtype=np.intp)
    unit, divisor = ("km", 1000.0) if along[-1] >= 3000.0 else ("m", 1.0)
    ax.plot(along / divisor, field, color=COLOURS["neutral"], lw=1.2, label="field along the track")
    if staircase is not None:
        ax.step(
            along / divisor, np.asarray(staircase), where="post", color=COLOURS["accent"], lw=0.9, label="staircase"
        )
    ax.plot(along[keep] / divisor, field[keep], ls="none", marker="o", ms=5, mfc="white", mec=COLOURS["matched"],
            mew=1.5, label=f"chosen: {keep.size} of {field.size}")  # fmt: skip
    ax.set_xlabel(f"distance along the track ({unit})")
    ax.set_ylabel(f"field ({units})")
    ax.grid(True)
    ax.legend(loc="best")
    if title:
        ax.set_title(title)
    return ax


@styled
def filter_errors(
    time_s: ArrayLike,
    error_m: ArrayLike,
    sigma_m: ArrayLike | None = None,
    *,
    names: Sequence[str] = ("north", "east"),
    bands: float = 3.0,
    title: str | None = None,
) -> Figure:
    """Draw a filter's errors over time, one panel a component, with the bands of its own covariance.

    Parameters
    ----------
    time_s : (n,) times.
    error_m : (n, m) estimated minus true.
    sigma_m : (n, m) standard deviations that the filter declares.
    names : of the m components.
    bands : how many standard deviations the bands show.
    title : of the figure.
    """
    time, error = np.asarray(time_s, dtype=np.float64), np.asarray(error_m, dtype=np.float64)
    if error.shape != (time.size, len(names)):
        raise InvalidInputError(f"error_m: needed shape ({time.size}, {len(names)}), got {error.shape}")
    sigma = None if sigma_m is None else np.asarray(sigma_m, dtype=np.float64)
    if sigma is not None and sigma.shape != error.shape:
        raise InvalidInputError(f"sigma_m: needed shape {error.shape} as error_m, got {sigma.shape}")
    span = time[-1] - time[0]
    unit, divisor = ("h", 3600.0) if span >= 7200 else ("min", 60.0) if span >= 300 else ("s", 1.0)
    figure = new_figure(6.4, 1.9 * len(names) + 0.5)
    axes = np.atleast_1d(np.asarray(figure.subplots(len(names), 1, sharex=True), dtype=object))
    for i, (ax, name) in enumerate(zip(axes, names, strict=True)):
        if sigma is not None:
            band = bands * sigma[:, i]
            ax.fill_between(time / divisor, -band, band, color=COLOURS["matched"], alpha=0.16, lw=0)
            for sign in (-1, 1):
                ax.plot(time / divisor, sign * band, color=COLOURS["matched"], lw=0.8, ls="--",
                        label=f"declared {bands:g} sigma" if sign > 0 else None)  # fmt: skip
        ax.plot(time / divisor, error[:, i], color="black", lw=1.0, label="error")
        ax.axhline(0.0, color=COLOURS["neutral"], lw=0.6)
        # A divergent start must not flatten the rest.
        limit = 1.3 * float(np.nanpercentile(np.abs(error[:, i]), 99.5))
        if sigma is not None:
            limit = max(limit, 1.6 * float(np.nanmedian(bands * sigma[:, i])))
        if limit > 0:
            ax.set_ylim(-limit, limit)
        ax.set_ylabel(f"{name} error (m)")
        ax.grid(True)
    axes[0].legend(loc="upper right", ncols=2)
    axes[-1].set_xlabel(f"time ({unit})")
    if title:
        axes[0].set_title(title)
    return figure


@styled
def error_distribution(
    errors_m: Mapping[str, ArrayLike], ax: Axes | None = None, *, tolerance_m: float | None = None,
    title: str | None = None,
) -> Axes:  # fmt: skip
    """Draw the share of trials whose position error is below each size, one line a method.

    `errors_m` maps a method's name to its position errors; NaN counts as no fix, so a line ends at its fix rate.
    """
    ax = new_axes(ax, 5.2, 3.4)
    looks = (("matched", "-"), ("indicated", "--"), ("good", "-."), ("accent", ":"), ("true", "-"), ("neutral", "--"))
    for (name, errors), (colour, dash) in zip(
        errors_m.items(), looks * (1 + len(errors_m) // len(looks)), strict=False
    ):
        values = np.asarray(errors, dtype=np.float64)
        good = np.sort(values[np.isfinite(values)])
        if good.size:
            share = np.arange(1, good.size + 1) / values.size
            ax.step(np.maximum(good, 1e-3), share * 100, where="post", color=COLOURS[colour], ls=dash, label=name)
    if tolerance_m is not None:
        ax.axvline(tolerance_m, color=COLOURS["neutral"], lw=1.0)
        ax.text(tolerance_m, 2, " tolerance", fontsize=8, color=COLOURS["neutral"])
    ax.set(xscale="log", ylim=(0, 101))
    ax.set_xlabel("position error (m)")
    ax.set_ylabel("share of trials (%)")
    ax.grid(True)
    # Below the axes: a distribution may run through any corner.
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=min(2, len(errors_m)))
    if title:
        ax.set_title(title)
    return ax
