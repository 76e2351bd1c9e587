"""Maps of a part of the lines, the windows on the lines left out, and how smooth the map is to be."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from geomag._geomag import GridMap
from geomag.survey._fit import minimise, student
from geomag.survey._lines import Array, Lines, along_m
from geomag.survey._surface import Axes, features, grid_lines
from geomag.survey._survey import SHORTEST_WINDOW, Window

#: Lengths, in line spacings, over which a map may be smoothed, tried in turn for as long as they pay.
SMOOTHINGS = (0.25, 0.5, 1.0, 2.0)
#: A smoother map is taken where the windows left out like it better by more than so many standard errors.
CLEARLY = 2.0
#: Folds that decide about smoothing.
DECIDING = 2
#: Nodes further from a datum than so many line spacings are holes.
REACH = 4.0
#: Nodes of a map that is made here are holes where the distance to the data on either side is more than so many line spacings.
MAP_REACH = 2.5


@dataclass
class Fold:
    """The map of some lines, and the windows on what was left out that it covers."""

    lines: list[Lines]
    left: list[Lines]
    axes: Axes
    base: GridMap
    distance: Array
    windows: list[Window]
    #: Further ones: too many to try models on, not too many for the line of the model that is chosen.
    spare: list[Window] = field(default_factory=list)
    _features: tuple[Array, Array] | None = None

    @staticmethod
    def of(
        lines: list[Lines],
        left: list[Lines],
        windows: list[Window],
        axes: Axes,
        method: str,
        spacing_m: float,
        weight: float,
        progress: Callable[[int, int], None] | None = None,
    ) -> Fold:
        """Grid `lines`, and keep what of `windows` is on that map."""
        reach = REACH * spacing_m
        surface, distances = grid_lines(lines, axes, method, weight, reach, progress)
        surface = np.where(distances.within(MAP_REACH * spacing_m, axes), surface, np.nan)
        base = GridMap(surface, *axes.coordinates(), geographic=lines[0].geographic)
        fold = Fold(lines, left, axes, base, distances.either_side, [])
        fold.windows = fold.covered(windows)
        return fold

    def covered(self, windows: list[Window]) -> list[Window]:
        """Those of the windows of which the map covers nine tenths."""
        return [w for w in windows if np.mean(np.isfinite(self.base.sample(w[0], w[1]))) >= 0.9]

    def errors(self) -> Iterator[tuple[Array, Array, Array]]:
        """Of every window: places that the map has a value for, and the errors there about their median."""
        for x, y, v in self.windows:
            error = v - self.base.sample(x, y)
            ok = np.isfinite(error)
            if ok.sum() >= min(SHORTEST_WINDOW, len(v)) // 2:
                yield x[ok], y[ok], error[ok] - np.median(error[ok])

    def misses(self) -> Array:
        """How far the map is from its own lines."""
        out: Array = np.concatenate([one.values - self.base.sample(one.x, one.y) for one in self.lines])
        return out[np.isfinite(out)]

    @property
    def features(self) -> tuple[Array, Array]:
        """Gradient and second derivative of the map, worked out once (without the lock that `cached_property` may share among folds)."""
        if self._features is None:
            self._features = features(np.asarray(self.base.values, dtype=float), self.distance, self.axes)
        return self._features


def without_stretches(lines: list[Lines], every_m: float, length_m: float) -> list[Lines]:
    """The lines without stretches of `length_m` about every sample of their windows, which are `every_m` apart."""
    out = []
    for one in lines:
        along = along_m(one.x, one.y, one.scale_m())
        kept = np.abs((along + every_m / 2) % every_m - every_m / 2) > length_m / 2
        if kept.any():
            out.append(one._take(kept))
    return out


def _losses(parts: list[Fold]) -> Array:
    """How badly each window left out fits, as one Student-t law fits all of them."""
    errors = [error for part in parts for _, _, error in part.errors()]
    everything = np.concatenate(errors)
    start = np.log([float(np.median(np.abs(everything))) + 1e-9])
    logs = minimise(lambda logs: float(np.mean(student(everything, np.exp(2 * logs[0])))), start)
    return np.array([np.mean(student(error, np.exp(2 * logs[0]))) for error in errors])


def choose_smoothing(
    by_lines: list[Fold],
    by_stretches: list[Fold],
    smoothed: Callable[[float], tuple[list[Fold], list[Fold]]],
    spacing_m: float,
) -> float:
    """A length to smooth over, from none (`by_lines`, `by_stretches`) up as long as what is left out clearly fits the better.

    Noise that is honoured without need looks like field on the map. Lines left out show what smoothing does between the lines, stretches
    left out what it does on them; a track is as often near as far.
    """
    best, before = 0.0, (_losses(by_lines), _losses(by_stretches))
    for factor in SMOOTHINGS:
        lines, stretches = smoothed(factor * spacing_m)
        after = (_losses(lines), _losses(stretches))
        gains = [old - new for old, new in zip(before, after, strict=True)]
        error = np.sqrt(sum(gain.var() / gain.size for gain in gains))
        if sum(gain.mean() for gain in gains) <= CLEARLY * error:
            break
        best, before = factor * spacing_m, after
    return best
