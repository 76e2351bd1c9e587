"""Raw readings of a log on their way to a map: heights, main field, daily variation. What `match` and `navigate` share."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap
from geomag.continuation._errors import rebuilt
from geomag.projection import DEGREES, transform

if TYPE_CHECKING:
    from geomag.mainfield import MainField
    from geomag.reduction import Reduction

Array = NDArray[np.float64]

#: Words on the options, the same in every command.
MAIN_FIELD = "The readings are raw total intensity: main field to take off, igrf14, wmm2025, wmmhr2025 or a file."
DATE = "One date for the whole log (ISO 8601); by default the log's own dates."
BASE = "Record of a base station (IAGA-2002), whose variation is taken off; what it leaves is a bias that walks."
HEIGHT = "Height of the readings, m: a number, or the name of a column. A map at another height is continued to it."
MAP_HEIGHT = "Height of a map that does not say its own, m above the same datum as the log's."


@dataclass(frozen=True)
class Raw:
    """What the command line says of the readings; None where it says nothing."""

    main_field: str | None = None
    date: str | None = None
    base: Path | None = None
    height_m: str | None = None
    map_height_m: float | None = None
    said: list[str] = field(default_factory=list)

    @property
    def dated(self) -> bool:
        """Whether dates are needed from the log."""
        return (self.main_field is not None or self.base is not None) and self.date is None

    @property
    def column(self) -> str | None:
        """The column of the heights, where it is one."""
        return None if self.height_m is None or self._number() is not None else self.height_m

    def _number(self) -> float | None:
        try:
            return float(self.height_m or "")
        except ValueError:
            return None

    def map(self, grid: GridMap) -> GridMap:
        """The map, at its height."""
        if self.date is not None and self.main_field is None and self.base is None:
            raise InvalidInputError("--date: needed together with --main-field or --base, got neither")
        if self.map_height_m is None:
            if self.height_m is not None and grid.height_m is None and self.main_field is None:
                raise InvalidInputError("--height-m: needed a map with a height, or --map-height-m, got neither")
            return grid
        if grid.height_m is not None:
            raise InvalidInputError(f"--map-height-m: needed a map without a height, got one at {grid.height_m} m")
        return rebuilt(grid, np.asarray(grid.values), grid.sigma, self.map_height_m)

    def heights(self, grid: GridMap, of_column: Array | None, rows: int) -> tuple[Array | None, Array]:
        """Heights over the map, None where the map has none, and heights for the main field."""
        number = self._number()
        told = of_column if number is None else np.full(rows, number)
        if told is None:
            return None, np.zeros(rows)
        if not np.isfinite(told).all():
            k = int(np.argmin(np.isfinite(told)))
            raise InvalidInputError(f"--height-m: needed a height in every row, got {told[k]} in row {k}")
        if grid.height_m is None:
            self.said.append("the map does not say its height: it is taken to be the log's (--map-height-m)")
            return None, told
        return told, told

    def reduction(self, dates: NDArray[np.datetime64] | None, height_m: Array) -> Reduction | None:
        """What is to be taken off, at these dates (the one of the command line else) and heights; None where nothing is."""
        from geomag.diurnal import DiurnalReduction, read_iaga2002
        from geomag.reduction import MagneticReduction, Reductions

        if self.main_field is None and self.base is None:
            return None
        when: Any = self.date if dates is None else dates
        if dates is not None and np.isnat(dates).any():
            raise InvalidInputError(
                f"dates: needed one in every row, got none in row {int(np.argmax(np.isnat(dates)))}"
            )
        parts: list[Reduction] = []
        if self.main_field is not None:
            parts.append(MagneticReduction(when, height_m, main_field_model(self.main_field)))
        if self.base is not None:
            many = np.broadcast_to(np.asarray(when, dtype="datetime64[us]"), height_m.shape)
            parts.append(DiurnalReduction(read_iaga2002(self.base).base(), many))
        return Reductions(*parts)

    def tell(self, reduction: Reduction, longitude: Array, latitude: Array, span_s: float | None) -> dict[str, float]:
        """Say what is taken off at these places; returns what it leaves: `drift_nt` over the track, `walk_nt_sqrt_s`."""
        from geomag.diurnal import DiurnalReduction
        from geomag.reduction import MagneticReduction

        left: dict[str, float] = {}
        for part in getattr(reduction, "parts", ()):
            off = -part.correction(longitude, latitude, None)
            if isinstance(part, MagneticReduction):
                name = part.model if isinstance(part.model, str) else part.model.name
                self.said.append(f"main field  {off.min():.1f} to {off.max():.1f} nT by {name}")
            if isinstance(part, DiurnalReduction):
                removed = part.base.remove(part.date, longitude, latitude, off)
                left = {"walk_nt_sqrt_s": removed.walk_nt_sqrt_s()}
                left["drift_nt"] = removed.sigma_nt if span_s is None else removed.drift_nt(span_s)
                self.said.append(
                    f"variation   {off.min():+.1f} to {off.max():+.1f} nT by {self.base and self.base.name}, left "
                    f"{removed.sigma_nt:.1f} nT for {removed.correlation_time_s:.0f} s"
                )
        return left


def main_field_model(text: str) -> MainField:
    """A main field by its name, or from a file of coefficients."""
    from geomag.mainfield import MODELS, load

    return load(text) if text in MODELS else load(Path(text).stem, text)


def in_degrees(grid: GridMap, x: Array, y: Array, geographic: bool | None) -> tuple[Array, Array]:
    """Places of a log in longitude and latitude, for what depends on them."""
    if geographic if geographic is not None else grid.geographic:
        return x, y
    if grid.crs is None:
        raise InvalidInputError("--main-field, --base: needed a log in degrees, or a map with a CRS, got neither")
    return transform(x, y, grid.crs, DEGREES)
