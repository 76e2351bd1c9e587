"""The one style: colours that the colour-blind and a grey printer can tell apart, and how figures are written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from geomag._errors import InvalidInputError
from geomag._optional import require

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_P = ParamSpec("_P")
_R = TypeVar("_R")

COLOURS = {
    "true": "#000000",
    "indicated": "#D55E00",
    "matched": "#0072B2",
    "measured": "#000000",
    "good": "#009E73",
    "bad": "#D55E00",
    "neutral": "#777777",
    "accent": "#E69F00",
}
"""Colours by what they stand for (Okabe and Ito's palette, made for every kind of colour vision)."""

FIELD_COLOURS = "cividis"
"""Colour map of fields: even in lightness, so that it prints in grey, and the same to the colour-blind."""

_RC: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "grid.linewidth": 0.4,
    "grid.color": "#cccccc",
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "legend.fontsize": 8,
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "none",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "figure.dpi": 110,
    "savefig.dpi": 160,
    "savefig.facecolor": "white",
    "image.interpolation": "nearest",
    # Text stays text in vector files; a fixed salt keeps the same picture the same file.
    "svg.fonttype": "none",
    "svg.hashsalt": "geomag",
    "pdf.fonttype": 42,
}


@contextmanager
def style() -> Iterator[None]:
    """Have matplotlib draw in geomag's style within a `with` block."""
    parameters = require("matplotlib", "plot", "plotting").rcParams
    # Not matplotlib's own context: that would also undo what a notebook's display sets up when it is first used.
    held = {name: parameters[name] for name in _RC}
    parameters.update(_RC)
    try:
        yield
    finally:
        parameters.update(held)


def styled(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Draw in geomag's style."""

    @wraps(function)
    def inner(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with style():
            return function(*args, **kwargs)

    return inner


def new_axes(ax: Axes | None, width_in: float, height_in: float) -> Axes:
    """Return the axes given, or those of a new figure."""
    if ax is not None:
        return ax
    return new_figure(width_in, height_in).add_subplot()


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure that lays itself out."""
    pyplot = require("matplotlib.pyplot", "plot", "plotting")
    figure: Figure = pyplot.figure(figsize=(width_in, height_in), layout="constrained")
    return figure


def save(figure: Figure, path: str | PathLike[str]) -> Path:
    """Write a figure as PNG, SVG or PDF, by the name's ending, without a date in it.

    Raises
    ------
    InvalidInputError
        For another ending.
    """
    target = Path(path)
    kind = target.suffix.lower()
    metadata = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    if kind not in metadata:
        raise InvalidInputError(f"picture {target.name}: needed a name ending in .png, .svg or .pdf, got '{kind}'")
    target.parent.mkdir(parents=True, exist_ok=True)
    with style():
        figure.savefig(target, metadata=metadata[kind])
    return target
