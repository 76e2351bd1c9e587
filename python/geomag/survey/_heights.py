"""Lines at their own heights: the surface that they were flown on, and readings brought onto it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap
from geomag.continuation._waves import Waves
from geomag.survey._lines import Array, Lines
from geomag.survey._surface import Axes, grid_lines, weight_of

#: Length over which the heights are smoothed to a surface, line spacings: neighbouring lines lie on both sides of it.
SMOOTH = 1.0
#: Times that readings are brought onto the surface by the map of those that were.
PASSES = 2
#: Most of a height's change that one wave number is believed for: beyond, a straight line along the height says nothing.
STEEPEST = 1.0


@dataclass(frozen=True)
class Drape:
    """The smooth surface on which lines were flown, as near as may be; what a line is off it is made up for reading by reading.

    A map is a function of the place, so that lines which cross at two heights have to be brought to one before they are gridded. What
    a reading changes by over a height of some tens of metres is its vertical gradient times the height, and the gradient is that of
    the map of the other readings; a line that is left out is brought by the map it is not in.
    """

    axes: Axes
    height_m: Array
    method: str
    spacing_m: float

    @staticmethod
    def under(lines: Lines, axes: Axes, method: str) -> Drape:
        """The surface of the heights of `lines`, smooth over a line spacing."""
        if lines.height_m is None:
            raise InvalidInputError(
                "height_m: needed lines with heights, Lines(height_m=) or read_lines(height=), got none"
            )
        heights = lines._with(values=np.asarray(lines.height_m))
        spacing = lines.survey.spacing_m
        weight = weight_of(lines, axes, SMOOTH * spacing, spacing)
        surface, _ = grid_lines([heights], axes, "minimum_curvature", weight)
        low, high = float(np.min(heights.values)), float(np.max(heights.values))
        return Drape(axes, np.clip(surface, low, high), method, spacing)

    def off(self, lines: Lines) -> Array:
        """How far above the surface each reading was taken, metres."""
        # Places are looked up by their coordinates alone, whatever these are.
        return np.asarray(
            np.nan_to_num(np.asarray(lines.height_m) - self._surface.sample(lines.x, lines.y)), dtype=np.float64
        )

    @cached_property
    def _surface(self) -> GridMap:
        """The heights as a map, made once: a survey has thousands of lines."""
        return GridMap(self.height_m, *self.axes.coordinates())

    def brought(self, kept: Sequence[Lines], left: Sequence[Lines], weight: float) -> tuple[list[Lines], list[Lines]]:
        """`kept` and `left` with readings as on the surface, by the map of `kept` alone."""
        first, every = list(kept), list(left)
        off = [self.off(one) for one in (*first, *every)]
        moved = list(first)
        for _ in range(PASSES):
            slope = self._slope(moved, weight)
            moved = [self._down(one, o, slope) for one, o in zip(first, off, strict=False)]
        return moved, [self._down(one, o, slope) for one, o in zip(every, off[len(first) :], strict=True)]

    def _slope(self, lines: list[Lines], weight: float) -> GridMap:
        """Change of the field with height, upward, on the surface, of waves that a straight line may follow."""
        reach = 4.0 * self.spacing_m
        surface, distances = grid_lines(lines, self.axes, self.method, weight, reach)
        values = np.where(distances.nearest <= reach, surface, np.nan)
        waves = Waves(values, self.axes.cell_m, "mirrored")
        # Waves shorter than the gaps are made up between lines; they are let go.
        short = np.exp(-0.5 * (waves.k * self.spacing_m / np.pi) ** 2)
        slope = waves.through(-waves.k * short, plane=0.0)
        return GridMap(slope, *self.axes.coordinates(), geographic=lines[0].geographic)

    @staticmethod
    def _down(lines: Lines, off_m: Array, slope: GridMap) -> Lines:
        change = np.nan_to_num(slope.sample(lines.x, lines.y)) * off_m
        return lines._with(values=lines.values - change)
