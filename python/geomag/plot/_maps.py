"""Maps: the field, tracks and ellipses on it, scale bar and north arrow, suitability."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._metres import metres_per_unit
from geomag._optional import require
from geomag.plot._style import COLOURS, FIELD_COLOURS, new_axes, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from geomag._geomag import Fix, GridMap, Track

_MOST_PIXELS = 1600


def halo(width: float = 3.2) -> list[Any]:
    """Return path effects that keep a line readable on any ground."""
    effects = require("matplotlib.patheffects", "plot", "plotting")
    return [effects.Stroke(linewidth=width, foreground="white", alpha=0.85), effects.Normal()]


def label_axes(ax: Axes, geographic: bool, extent_m: float) -> None:
    """Axis labels with units; metres are shown as kilometres where the map is large."""
    if geographic:
        ax.set_xlabel("longitude (degrees east)")
        ax.set_ylabel("latitude (degrees north)")
        return
    ticker = require("matplotlib.ticker", "plot", "plotting")
    unit, divisor = ("km", 1000.0) if extent_m >= 5000.0 else ("m", 1.0)
    shown = ticker.FuncFormatter(lambda value, _: f"{value / divisor:g}")
    ax.xaxis.set_major_formatter(shown)
    ax.yaxis.set_major_formatter(shown)
    ax.set_xlabel(f"easting ({unit})")
    ax.set_ylabel(f"northing ({unit})")


def _image(
    ax: Axes,
    values: NDArray[Any],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    **options: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401 - matplotlib's AxesImage
    """Draw a grid as cells centred on its nodes."""
    dx, dy = float(x[1] - x[0]), float(y[1] - y[0])
    extent = (float(x[0]) - dx / 2, float(x[-1]) + dx / 2, float(y[0]) - dy / 2, float(y[-1]) + dy / 2)
    ax.set_facecolor("#e6e6e6")
    return ax.imshow(np.ma.masked_invalid(values), origin="lower", extent=extent, aspect="auto", **options)


def view(
    grid: GridMap, bounds: tuple[float, float, float, float] | None
) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
    """Values and axes of the part of a map within bounds, thinned to what a picture can show."""
    values, x, y = np.asarray(grid.values), np.asarray(grid.x), np.asarray(grid.y)
    if bounds is not None:
        columns = np.flatnonzero((x >= bounds[0]) & (x <= bounds[2]))
        rows = np.flatnonzero((y >= bounds[1]) & (y <= bounds[3]))
        if columns.size < 2 or rows.size < 2:
            raise InvalidInputError(f"bounds: needed a box (x0, y0, x1, y1) with map nodes in it, got {bounds}")
        window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        values, x, y = values[window], x[window[1]], y[window[0]]
    thin_x, thin_y = (max(1, math.ceil(n / _MOST_PIXELS)) for n in (x.size, y.size))
    return values[::thin_y, ::thin_x], x[::thin_x], y[::thin_y]


@styled
def field_map(
    grid: GridMap,
    ax: Axes | None = None,
    *,
    bounds: tuple[float, float, float, float] | None = None,
    contours: bool = True,
    colour_bar: bool = True,
    title: str | None = None,
) -> Axes:
    """Draw a map of the field with colour bar, scale bar and north arrow.

    Parameters
    ----------
    grid : the map.
    ax : where to draw; a new figure where not given.
    bounds : part to show (x least, y least, x greatest, y greatest), map units.
    contours : whether to draw a few contour lines.
    colour_bar : whether to draw the colour bar, labelled with the map's unit.
    title : of the axes.
    """
    ax = new_axes(ax, 6.4, 5.2)
    values, x, y = view(grid, bounds)
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise InvalidInputError("map: needed at least one value within the bounds, got only holes")
    # The central 98 % sets the colours, so that one spike does not leave the rest grey.
    low, high = np.percentile(finite, [1.0, 99.0])
    if low == high:
        low, high = low - 1.0, high + 1.0
    image = _image(ax, values, x, y, cmap=FIELD_COLOURS, vmin=low, vmax=high)
    if contours:
        levels = np.linspace(low, high, 9)[1:-1]
        ax.contour(x, y, np.ma.masked_invalid(values), levels=levels, colors="white", linewidths=0.4, alpha=0.6)
    east, north = grid.metres_per_unit(float(np.mean(y)))
    ax.set_aspect(north / east)
    label_axes(ax, grid.geographic, float(x[-1] - x[0]) * east)
    if colour_bar:
        name = getattr(grid, "name", None) or "field"
        units = getattr(grid, "units", None)
        bar = ax.figure.colorbar(image, ax=ax, extend="both", shrink=0.75, pad=0.02, aspect=28)
        bar.set_label(f"{name} ({units})" if units else name)
        bar.outline.set_visible(False)
    scale_bar(ax, geographic=grid.geographic)
    north_arrow(ax)
    if title:
        ax.set_title(title)
    return ax


@styled
def scale_bar(ax: Axes, *, geographic: bool = False) -> None:
    """Draw a bar of a round length, about a quarter of the width, at the lower left."""
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    east, _ = metres_per_unit(geographic, (y0 + y1) / 2)
    width_m = abs(x1 - x0) * east
    exponent = math.floor(math.log10(width_m / 4))
    length_m = max(m * 10.0**exponent for m in (1, 2, 5) if m * 10.0**exponent <= width_m / 4)
    share = length_m / width_m
    text = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    options: dict[str, Any] = {"transform": ax.transAxes, "zorder": 8}
    ax.plot([0.04, 0.04 + share], [0.045, 0.045], color="white", lw=5.0, solid_capstyle="butt", **options)
    ax.plot([0.04, 0.04 + share], [0.045, 0.045], color="black", lw=2.5, solid_capstyle="butt", **options)
    box = {"boxstyle": "square,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
    ax.text(0.04 + share / 2, 0.062, text, ha="center", va="bottom", fontsize=8, bbox=box, **options)


@styled
def north_arrow(ax: Axes) -> None:
    """Draw an arrow to the north at the upper right."""
    arrow = {"arrowstyle": "-|>", "color": "black", "lw": 1.4, "path_effects": halo(3.6)}
    ends = {"xy": (0.955, 0.965), "xytext": (0.955, 0.875), "xycoords": "axes fraction", "textcoords": "axes fraction"}
    ax.annotate("", arrowprops=arrow, zorder=8, annotation_clip=False, **ends)  # type: ignore[arg-type]
    ax.text(0.955, 0.868, "N", transform=ax.transAxes, ha="center", va="top", fontsize=9, zorder=8,
            fontweight="bold", path_effects=halo(2.5))  # fmt: skip


def _xy(points: Any) -> NDArray[np.float64]:  # noqa: ANN401 - a track, a path, a fix or an (n, 2) array
    """Points as an (n, 2) array, whatever holds them."""
    if hasattr(points, "track") and hasattr(points, "status"):
        return np.asarray(points.track, dtype=np.float64).reshape(-1, 2)
    if hasattr(points, "x") and hasattr(points, "y"):
        return np.column_stack([points.x, points.y])
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise InvalidInputError(f"track to draw: needed x and y, or an (n, 2) array, got shape {array.shape}")
    return array


_TRACKS: Mapping[str, Mapping[str, Any]] = {
    "true": {"color": COLOURS["true"], "ls": "-", "marker": None, "lw": 3.6},
    "indicated": {"color": COLOURS["indicated"], "ls": (0, (4, 2)), "marker": "s", "lw": 1.4},
    "matched": {"color": COLOURS["matched"], "ls": "-", "marker": "o", "lw": 1.4, "mfc": "white"},
}


@styled
def tracks(
    ax: Axes,
    *,
    indicated: Track | ArrayLike | None = None,
    true: object | None = None,
    matched: Fix | ArrayLike | None = None,
    legend: bool = True,
) -> Axes:
    """Draw indicated, true and matched tracks, told apart by dash and mark as well as by colour.

    Each may be a `Track`, a `Path`, a `Fix` or an (n, 2) array of x and y; the newest point is marked larger.
    """
    for name, points in (("true", true), ("indicated", indicated), ("matched", matched)):
        if points is None:
            continue
        xy = _xy(points)
        if len(xy) == 0:
            continue
        look = dict(_TRACKS[name])
        every = max(1, len(xy) // 20)
        # The true track is broad and the matched one thin, so that both show where they agree.
        edge = [] if name == "matched" and true is not None else halo(look["lw"] + 1.8)
        ax.plot(*xy.T, label=f"{name} track", markevery=every, path_effects=edge, zorder=5, ms=3.6, **look)
        ax.plot(*xy[-1], marker=look["marker"] or "o", ms=7, color=look["color"], mec="white", mew=1.0, zorder=6)
    if legend:
        ax.legend(loc="upper left")
    return ax


@styled
def ellipse(
    ax: Axes,
    x: float,
    y: float,
    covariance_m2: ArrayLike,
    *,
    geographic: bool = False,
    probability: float = 0.95,
    label: str | None = None,
    colour: str | None = None,
) -> Axes:
    """Draw the ellipse that holds the given probability of a normal position error.

    Parameters
    ----------
    ax : a map's axes.
    x, y : centre, map units.
    covariance_m2 : (2, 2), east-north, square metres.
    geographic : whether the axes are in degrees.
    probability : in (0, 1).
    label : for the legend.
    colour : of the line.
    """
    covariance = np.asarray(covariance_m2, dtype=np.float64)
    if covariance.shape != (2, 2) or not np.isfinite(covariance).all():
        raise InvalidInputError(f"covariance: needed a finite (2, 2) array, got {covariance!r}")
    if not 0.0 < probability < 1.0:
        raise InvalidInputError(f"probability: needed a number in (0, 1), got {probability}")
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < -1e-9 * max(values[1], 1.0):
        raise InvalidInputError(f"covariance: needed one without negative eigenvalues, got {covariance.tolist()}")
    radius = math.sqrt(-2.0 * math.log(1.0 - probability))
    angle = np.linspace(0.0, 2.0 * math.pi, 181)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    points = vectors @ (radius * np.sqrt(np.clip(values, 0.0, None))[:, None] * circle)
    east, north = metres_per_unit(geographic, y)
    ax.plot(x + points[0] / east, y + points[1] / north, color=colour or COLOURS["accent"], lw=1.6, zorder=7,
            label=label or f"{probability:.0%} ellipse", path_effects=halo(3.0))  # fmt: skip
    return ax


@styled
def suitability_map(
    values: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    ax: Axes | None = None,
    *,
    geographic: bool = False,
    label: str = "expected fix error (m)",
    good_below: float | None = None,
    title: str | None = None,
) -> Axes:
    """Draw where on the map a fix can be had: dark is good, hatched is worse than `good_below`, grey is unknown.

    Parameters
    ----------
    values : (rows, columns), row = y; smaller is better.
    x, y : axes, ascending, map units.
    ax : where to draw; a new figure where not given.
    geographic : whether the axes are in degrees.
    label : what the values are, with their unit.
    good_below : the limit of use; its contour is drawn and what lies beyond is hatched.
    title : of the axes.
    """
    shown, xs, ys = np.asarray(values, dtype=np.float64), np.asarray(x), np.asarray(y)
    if shown.shape != (ys.size, xs.size):
        raise InvalidInputError(f"suitability: needed shape ({ys.size}, {xs.size}) from the axes, got {shown.shape}")
    finite = shown[np.isfinite(shown)]
    if finite.size == 0:
        raise InvalidInputError("suitability: needed at least one value that is not NaN")
    east, north = metres_per_unit(geographic, float(ys.mean()))
    tall = float((ys[-1] - ys[0]) * north / ((xs[-1] - xs[0]) * east))
    # As wide as the map is, besides the colour bar, so that neither a tall nor a wide one leaves a part blank.
    ax = new_axes(ax, max(3.4, min(5.0, 5.8 / tall) + 1.6), min(6.8, max(2.6, 5.0 * tall) + 0.9))
    image = _image(ax, shown, xs, ys, cmap="viridis", vmin=finite.min(), vmax=np.percentile(finite, 98))
    ax.set_aspect(north / east)
    label_axes(ax, geographic, float(xs[-1] - xs[0]) * east)
    bar = ax.figure.colorbar(image, ax=ax, extend="max", shrink=0.75, pad=0.02, aspect=28)
    bar.set_label(label)
    bar.outline.set_visible(False)
    if good_below is not None and finite.min() < good_below < finite.max():
        beyond = np.ma.masked_invalid(shown)
        ax.contourf(xs, ys, beyond, levels=[good_below, float(finite.max())], colors="none", hatches=["////"])
        ax.contour(xs, ys, beyond, levels=[good_below], colors="white", linewidths=0.4)
        bar.ax.axhline(good_below, color="white", lw=1.5)
        # Below the map: inside it would hide a part.
        ax.annotate(
            f"hatched: beyond {good_below:g} (white line)", (0.5, 0.0), (0, -38), xycoords="axes fraction",
            textcoords="offset points", ha="center", va="top", fontsize=8, annotation_clip=False,
        )  # fmt: skip
    scale_bar(ax, geographic=geographic)
    north_arrow(ax)
    if title:
        ax.set_title(title)
    return ax
