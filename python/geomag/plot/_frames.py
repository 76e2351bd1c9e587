"""The offset plane: score surfaces, and feasible sets and posteriors sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._metres import metres_per_unit
from geomag._optional import require
from geomag.plot._maps import _image, halo
from geomag.plot._style import COLOURS, new_axes, new_figure, style, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from geomag._geomag import Fix


@dataclass(frozen=True)
class Frame:
    """What a matcher believed after some samples, over the offset lattice.

    `values` is (rows, columns), row = y offset: booleans for a feasible set, probabilities for a posterior.
    `x` and `y` are the offsets of columns and rows, map units.
    """

    n_samples: int
    values: NDArray[Any]
    x: NDArray[np.float64]
    y: NDArray[np.float64]


def _offset_axes(ax: Axes, geographic: bool, latitude: float, span: float) -> None:
    """Label offsets in metres or kilometres, whatever the map's unit."""
    ticker = require("matplotlib.ticker", "plot", "plotting")
    east, north = metres_per_unit(geographic, latitude)
    unit, divisor = ("km", 1000.0) if span * east >= 3000.0 else ("m", 1.0)
    for axis, factor in ((ax.xaxis, east), (ax.yaxis, north)):
        # Round numbers of metres, whatever that is in degrees.
        low, high = sorted(float(v) * factor / divisor for v in axis.get_view_interval())
        ticks = [t for t in ticker.MaxNLocator(5).tick_values(low, high) if low <= t <= high]
        axis.set_ticks([t * divisor / factor for t in ticks], [f"{t:g}" for t in ticks])
    ax.set_xlabel(f"offset east ({unit})")
    ax.set_ylabel(f"offset north ({unit})")
    ax.set_aspect(north / east)


def mark_offset(ax: Axes, offset: tuple[float, float], name: str) -> None:
    """Mark an offset: the true one with a cross, the matched one with a ring."""
    if name == "true":
        ax.plot(*offset, marker="+", ms=12, mew=2.0, color="black", ls="none", label="true offset",
                path_effects=halo(4.5), zorder=6)  # fmt: skip
    else:
        ring: dict[str, Any] = {"marker": "o", "mfc": "none", "ls": "none", "zorder": 7}
        ax.plot(*offset, ms=11, mew=4.0, mec="white", **ring)
        ax.plot(*offset, ms=11, mew=2.0, mec=COLOURS["matched"], label="matched offset", **ring)


@styled
def score_surface(
    surface: ArrayLike | Fix,
    x: ArrayLike | None = None,
    y: ArrayLike | None = None,
    ax: Axes | None = None,
    *,
    geographic: bool = False,
    latitude_deg: float = 0.0,
    true_offset: tuple[float, float] | None = None,
    label: str = "score",
    least_is_best: bool = True,
    logarithmic: bool | None = None,
    title: str | None = None,
) -> Axes:
    """Draw the scores over the offset lattice; dark is good.

    Parameters
    ----------
    surface : a `Fix` that carries its surface, or (rows, columns) scores, row = y offset.
    x, y : offsets of columns and rows, map units; taken from the fix where one is given.
    ax : where to draw; a new figure where not given.
    geographic, latitude_deg : so that degrees are labelled in metres.
    true_offset : where the truth lies, where it is known.
    label : what the score is, with its unit.
    least_is_best : whether small scores are good (msd, mad, hausdorff) or large ones (prod, ncc, probabilities).
    logarithmic : colour scale; where not given, logarithmic for positive scores that span over two decades.
    title : of the axes.
    """
    matched: tuple[float, float] | None = None
    values: NDArray[np.float64]
    if hasattr(surface, "surface"):
        fix: Any = surface
        if fix.surface is None:
            raise InvalidInputError("fix: needed one with its surface (match_grid(..., surface=True)), got one without")
        values, (xs, ys), matched = np.asarray(fix.surface), fix.surface_axes, tuple(fix.offset)
    else:
        if x is None or y is None:
            raise InvalidInputError("score surface: needed the x and y offsets of its columns and rows, got none")
        values, xs, ys = np.asarray(surface, dtype=np.float64), np.asarray(x), np.asarray(y)
    if values.shape != (len(ys), len(xs)):
        raise InvalidInputError(f"score surface: needed shape ({len(ys)}, {len(xs)}), got {values.shape}")
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise InvalidInputError("score surface: needed at least one score that is not NaN")
    ax = new_axes(ax, 5.2, 4.4)
    colours = require("matplotlib.colors", "plot", "plotting")
    low, high = (float(v) for v in (finite.min(), finite.max()))
    if logarithmic is None:
        logarithmic = low > 0 and high > 100 * low
    norm = colours.LogNorm(low, high) if logarithmic and low > 0 and high > low else colours.Normalize(low, high)
    image = _image(ax, values, xs, ys, cmap="viridis" if least_is_best else "viridis_r", norm=norm)
    bar = ax.figure.colorbar(image, ax=ax, shrink=0.8, pad=0.02, aspect=26)
    bar.set_label(label)
    bar.outline.set_visible(False)
    _offset_axes(ax, geographic, latitude_deg, float(xs[-1] - xs[0]))
    if true_offset is not None:
        mark_offset(ax, true_offset, "true")
    if matched is not None and np.isfinite(matched).all():
        mark_offset(ax, matched, "matched")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper left")
    if title:
        ax.set_title(title)
    return ax


def pick(steps: Sequence[Frame], most: int) -> list[Frame]:
    """At most `most` frames, first and last kept, closer together at the start, where most happens."""
    if len(steps) <= most:
        return list(steps)
    chosen: list[int] = []
    for k, wish in enumerate(np.round(np.geomspace(1, len(steps), most)).astype(int) - 1):
        # As wished, but none twice, and enough left for those to come.
        after = chosen[-1] + 1 if chosen else 0
        chosen.append(min(max(int(wish), after), len(steps) - most + k))
    return [steps[i] for i in chosen]


def _draw_frame(ax: Axes, frame: Frame, true_offset: tuple[float, float] | None) -> None:
    values = np.asarray(frame.values)
    colours = require("matplotlib.colors", "plot", "plotting")
    if values.dtype == bool:
        two = colours.ListedColormap(["#f2f2f2", COLOURS["matched"]])
        _image(ax, values, frame.x, frame.y, cmap=two, vmin=0, vmax=1)
        caption = f"{int(values.sum())} left"
    else:
        top = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
        norm = colours.LogNorm(max(top * 1e-4, 1e-300), max(top, 1e-299))
        _image(ax, np.where(values > 0, values, top * 1e-9), frame.x, frame.y, cmap="viridis_r", norm=norm)
        caption = f"peak {top:.2g}"
    if true_offset is not None:
        ax.plot(*true_offset, marker="+", ms=9, mew=1.6, color="black", path_effects=halo(3.6))
    ax.set_title(f"{frame.n_samples} sample{'s' if frame.n_samples != 1 else ''}: {caption}", fontsize=8)


def draw_frames(
    axes: Sequence[Axes],
    columns: int,
    steps: Sequence[Frame],
    *,
    true_offset: tuple[float, float] | None,
    geographic: bool,
    latitude: float,
) -> None:
    """Draw frames on a grid of axes; the first of the last row is labelled, the others are bare."""
    labelled = (len(steps) - 1) // columns * columns
    for i, (ax, frame) in enumerate(zip(axes, steps, strict=False)):
        _draw_frame(ax, frame, true_offset)
        _offset_axes(ax, geographic, latitude, float(frame.x[-1] - frame.x[0]))
        ax.tick_params(labelsize=7)
        if i != labelled:
            ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    for ax in axes[len(steps) :]:
        ax.set_axis_off()


@styled
def frames(
    steps: Sequence[Frame],
    *,
    most: int = 8,
    true_offset: tuple[float, float] | None = None,
    geographic: bool = False,
    latitude_deg: float = 0.0,
    title: str | None = None,
) -> Figure:
    """Draw a feasible set or a posterior after chosen samples, side by side.

    A feasible set is drawn in one colour; a posterior on a logarithmic scale over four decades. The truth is a cross.
    """
    if not steps:
        raise InvalidInputError("steps: needed at least one frame, got none")
    chosen = pick(steps, most)
    columns = min(4, len(chosen))
    rows = math.ceil(len(chosen) / columns)
    figure = new_figure(2.1 * columns + 0.4, 2.15 * rows + 0.3)
    axes = np.atleast_1d(np.asarray(figure.subplots(rows, columns), dtype=object)).ravel()
    draw_frames(list(axes), columns, chosen, true_offset=true_offset, geographic=geographic, latitude=latitude_deg)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    return figure


def animate(
    steps: Sequence[Frame],
    path: str | PathLike[str],
    *,
    frames_per_s: float = 3.0,
    true_offset: tuple[float, float] | None = None,
    geographic: bool = False,
    latitude_deg: float = 0.0,
    title: str | None = None,
) -> Path:
    """Write a feasible set or a posterior, one frame a sample, as an animated GIF.

    Raises
    ------
    InvalidInputError
        Without a frame, or for a name that does not end in .gif.
    """
    target = Path(path)
    if target.suffix.lower() != ".gif":
        raise InvalidInputError(f"animation {target.name}: needed a name ending in .gif, got '{target.suffix}'")
    if not steps:
        raise InvalidInputError("steps: needed at least one frame, got none")
    animation = require("matplotlib.animation", "plot", "animation")
    pyplot = require("matplotlib.pyplot", "plot", "animation")
    with style():
        figure = new_figure(4.4, 4.2)
        ax = figure.add_subplot()

        def draw(i: int) -> list[Any]:
            ax.clear()
            _draw_frame(ax, steps[i], true_offset)
            _offset_axes(ax, geographic, latitude_deg, float(steps[i].x[-1] - steps[i].x[0]))
            if title:
                ax.set_title(f"{title}, {ax.get_title(loc='left')}", fontsize=9)
            return []

        movie = animation.FuncAnimation(figure, draw, frames=len(steps), blit=False)
        movie.save(target, writer=animation.PillowWriter(fps=frames_per_s), dpi=100)
        pyplot.close(figure)
    return target
