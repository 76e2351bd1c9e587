"""What is run in every trial: geomag's own matchers by name and options, or a matcher of one's own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import Fix, GridMap, Track
from geomag._words import Criterion

Matcher = Callable[[GridMap, Track], Fix]
"""A matcher of one's own: takes map and track, returns a `Fix`."""


@dataclass(frozen=True)
class Method:
    """One of geomag's matchers with its options, to be run in Rust. Made by `iema`, `grid_search` and their like."""

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {self.kind: dict(self.options)}


@dataclass(frozen=True)
class Keyed:
    """A matcher of one's own under a key that stands for it in a folder of results.

    For lambdas, closures and whatever else cannot be told from its like. The key is to change when the answers do.

    >>> from geomag import campaign, match_grid
    >>> method = campaign.Keyed("msd, 900 m", lambda grid, track: match_grid(grid, track, half_width=900.0))
    """

    key: str
    matcher: Matcher

    def __call__(self, grid: GridMap, track: Track) -> Fix:
        """Match, as the matcher does."""
        return self.matcher(grid, track)


def _pair(value: float | Sequence[float]) -> list[float]:
    try:
        pair = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        pair = np.empty(0)
    if pair.shape not in ((), (2,)) or not np.isfinite(pair).all():
        raise InvalidInputError(f"needed a finite number or a pair (x, y), got {value!r}")
    return [float(v) for v in np.broadcast_to(pair, 2)]


def _json_of(name: str, options: Mapping[str, Any]) -> str:
    """Options as JSON; NumPy's numbers and arrays as plain ones."""

    def plain(value: object) -> object:
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        raise InvalidInputError(f"method {name!r}: needed options that are numbers, words or arrays, got {value!r}")

    return json.dumps(dict(options), default=plain)


#: Options that are a number or a pair (x, y), map units.
_PAIRS = ("half_width", "tolerance", "step")
#: Those of the Hausdorff measure alone.
_OF_HAUSDORFF = ("length_scale_m", "value_scale", "fraction")


def _plain(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options that were given, pairs as pairs; what is not given is the matcher's own default."""
    told = {name: value for name, value in options.items() if value is not None}
    return {name: _pair(value) if name in _PAIRS else value for name, value in told.items()}


def iema(*, sigma: float, half_width: float | Sequence[float], **options: Any) -> Method:  # noqa: ANN401 - those of Iema
    """Return streaming IEMA, stopped at its first fix; options as in `geomag.Iema`, extents in map units."""
    told = _plain({"sigma": float(sigma), "half_width": half_width, **options})
    if "unknown" in told:
        told["unknown"] = str(told["unknown"]).capitalize()
    return Method("iema", told)


def grid_search(
    criterion: str = "msd",
    *,
    half_width: float | Sequence[float],
    **options: Any,  # noqa: ANN401 - those of match_grid
) -> Method:
    """Return a grid search over the whole track; options as in `geomag.match_grid`, extents in map units.

    Scales of the Hausdorff measure that are not given are those of each trial's own track.
    """
    names = get_args(Criterion)
    if criterion not in names:
        raise InvalidInputError(f"criterion: needed one of {', '.join(names)}, got {criterion!r}")
    told = _plain({"half_width": half_width, **options})
    if criterion == "hausdorff":
        return Method("hausdorff", told)
    if given := [name for name in _OF_HAUSDORFF if name in told]:
        raise InvalidInputError(f"{given[0]}: needed criterion 'hausdorff', got {criterion!r}")
    return Method("grid", {"criterion": criterion.capitalize(), **told})


def posterior(*, half_width: float | Sequence[float], **options: Any) -> Method:  # noqa: ANN401 - those of match_posterior
    """Return calibrated matching over the whole track; options as in `geomag.match_posterior`, extents in map units."""
    return Method("posterior", _plain({"half_width": half_width, **options}))


def contour(**options: Any) -> Method:  # noqa: ANN401 - those of match_contour
    """Return contour matching (ICCP) over the whole track; options as in `geomag.match_contour`."""
    return Method("contour", options)
