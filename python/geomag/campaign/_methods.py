"""What is run in every trial: geomag's own matchers by name and options, or a matcher of one's own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import Fix, GridMap, Track

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


def iema(
    *,
    sigma: float,
    half_width: float | Sequence[float],
    tolerance: float | Sequence[float] = 0.0,
    step: float | Sequence[float] | None = None,
    max_misses: int = 0,
    gate: float = 3.0,
    unknown: str = "keep",
) -> Method:
    """Return streaming IEMA, stopped at its first fix; options as in `geomag.Iema`."""
    options: dict[str, Any] = {
        "sigma": float(sigma), "half_width": _pair(half_width), "tolerance": _pair(tolerance),
        "step": None if step is None else _pair(step), "max_misses": int(max_misses), "gate": float(gate),
        "unknown": unknown.capitalize(),
    }  # fmt: skip
    return Method("iema", options)


def grid_search(
    criterion: str = "msd",
    *,
    half_width: float | Sequence[float],
    step: float | Sequence[float] | None = None,
    heading_deg: Sequence[float] = (0.0,),
    scale: Sequence[float] = (1.0,),
    remove_mean: bool = False,
    sigma: float | None = None,
    ambiguity: float = 0.01,
    min_overlap: float = 0.8,
    refine: bool = True,
    length_scale_m: float | None = None,
    value_scale: float | None = None,
    fraction: float = 1.0,
) -> Method:
    """Return a grid search over the whole track; options as in `geomag.match_grid`.

    The last three are of the Hausdorff measure; scales that are not given are those of each trial's own track.
    """
    names = ("msd", "mad", "prod", "ncc", "hausdorff")
    if criterion not in names:
        raise InvalidInputError(f"criterion: needed one of {', '.join(names)}, got {criterion!r}")
    options: dict[str, Any] = {
        "half_width": _pair(half_width),
        "step": None if step is None else _pair(step), "heading_deg": [float(h) for h in heading_deg],
        "scale": [float(s) for s in scale], "remove_mean": bool(remove_mean),
        "sigma": None if sigma is None else float(sigma), "ambiguity": float(ambiguity),
        "min_overlap": float(min_overlap), "refine": bool(refine),
    }  # fmt: skip
    if criterion == "hausdorff":
        scales = {"length_scale_m": length_scale_m, "value_scale": value_scale}
        told = {name: None if scale is None else float(scale) for name, scale in scales.items()}
        return Method("hausdorff", {**options, **told, "fraction": float(fraction)})
    if (length_scale_m, value_scale, fraction) != (None, None, 1.0):
        raise InvalidInputError(
            f"length_scale_m, value_scale, fraction: needed criterion 'hausdorff', got {criterion!r}"
        )
    return Method("grid", {"criterion": criterion.capitalize(), **options})


def posterior(
    *,
    half_width: float | Sequence[float],
    sigma: float | None = None,
    step: float | Sequence[float] | None = None,
    **options: float | None,
) -> Method:
    """Return calibrated matching over the whole track; options as in `geomag.match_posterior`."""
    told: dict[str, Any] = {
        "half_width": _pair(half_width), "sigma": sigma, "step": None if step is None else _pair(step), **options,
    }  # fmt: skip
    return Method("posterior", told)


def contour(**options: Any) -> Method:  # noqa: ANN401 - those of match_contour
    """Return contour matching (ICCP) over the whole track; options as in `geomag.match_contour`."""
    return Method("contour", options)
