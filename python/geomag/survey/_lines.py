"""Survey lines: what they are, how they are read and averaged."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._metres import metres_per_unit
from geomag._ranges import above
from geomag.io import line_points

if TYPE_CHECKING:
    from geomag.survey._survey import Survey

Array = npt.NDArray[np.float64]


def on_one_turn(longitude: Array) -> Array:
    """Longitudes moved by whole turns so that their range is the shortest: lines over the date line stay in one piece.

    Longitudes whose range cannot be shortened come back as they are.
    """
    turned = np.unique(np.mod(longitude, 360.0))
    gaps = np.append(np.diff(turned), turned[0] + 360.0 - turned[-1])
    # The circle is cut at its widest empty stretch.
    after = (int(gaps.argmax()) + 1) % turned.size
    if float(np.ptp(longitude)) <= 360.0 - float(gaps.max()) + 1e-9:
        return longitude
    first = float(turned[after])
    first -= 360.0 * (first > 180.0)
    return np.asarray(longitude - 360.0 * np.floor((longitude - first + 1e-9) / 360.0), dtype=np.float64)


@dataclass(frozen=True)
class Lines:
    """Survey lines: positions, values and line labels of all points, in the order of flight within each line.

    Shapes (n,); positions in map units (metres, or degrees with `geographic`), values in the map's unit. `height_m` (a number or shape
    (n,), metres above the map's height datum) is what the readings were taken at, None where unknown; `unit` and `name` are those of the
    values and go on to the map. Longitudes on both sides of the date line are put on one turn: 179.9 and -179.9 become 179.9 and 180.1.
    `survey` has what follows from the lines: their stretches, spacing, scale and noise.

    Raises `InvalidInputError` for what is no finite number or no latitude, `ShapeError` for unequal lengths, `TooFewSamplesError` for none.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.survey import Lines
    >>> x, y = (a.ravel() for a in np.meshgrid(np.arange(0.0, 5000.0, 25.0), np.arange(0.0, 3000.0, 250.0)))
    >>> lines = Lines(x, y, np.sin(x / 300), np.repeat(np.arange(12), 200), height_m=80.0, unit="nT")
    >>> len(lines.survey.pieces), round(lines.survey.spacing_m)
    (12, 229)
    """

    x: Array
    y: Array
    values: Array
    line: npt.NDArray[Any]
    geographic: bool = False
    height_m: Array | float | None = None
    unit: str | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        """Convert, and refuse what does not fit together."""
        numbers = ("x", "y", "values") if self.height_m is None else ("x", "y", "values", "height_m")
        for name in numbers:
            try:
                array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InvalidInputError(f"lines {name}: needed numbers, got something else ({error})") from error
            object.__setattr__(self, name, array)
        if self.height_m is not None and np.size(self.height_m) == 1:
            object.__setattr__(self, "height_m", np.full(self.x.shape, float(np.ravel(self.height_m)[0])))
        object.__setattr__(self, "line", np.asarray(self.line))
        shapes = {name: getattr(self, name).shape for name in (*numbers, "line")}
        if len(set(shapes.values())) != 1 or len(self.x.shape) != 1:
            raise ShapeError(f"lines: needed {', '.join(numbers)} and line of one length, got {shapes}")
        for name in numbers:
            bad = np.flatnonzero(~np.isfinite(getattr(self, name)))
            if bad.size:
                raise InvalidInputError(
                    f"lines {name}[{bad[0]}]: needed a finite number, got {getattr(self, name)[bad[0]]}"
                )
        if self.x.size == 0:
            raise TooFewSamplesError("lines: needed at least 1 point, got 0")
        if self.geographic:
            if np.abs(self.y).max() > 90.0:
                worst = self.y[np.abs(self.y).argmax()]
                raise InvalidInputError(
                    f"lines y: needed latitudes in [-90, 90] degrees (are the lines in metres?), got {worst:g}"
                )
            if np.abs(self.x).max() > 720.0:
                worst = self.x[np.abs(self.x).argmax()]
                raise InvalidInputError(
                    f"lines x: needed longitudes in [-720, 720] degrees (are the lines in metres?), got {worst:g}"
                )
            object.__setattr__(self, "x", on_one_turn(self.x))

    @staticmethod
    def joined(parts: list[Lines]) -> Lines:
        """Parts of one survey as one `Lines`, in that order."""
        first = parts[0]
        columns = {name: np.concatenate([getattr(one, name) for one in parts]) for name in first._columns()}
        return first._with(**columns)

    def split(self) -> list[Lines]:
        """One `Lines` for every label, in the order of first appearance."""
        return [self._take(rows) for rows in self._rows()]

    @cached_property
    def survey(self) -> Survey:
        """What follows from the lines: made once, asked by everything."""
        from geomag.survey._survey import Survey

        return Survey(self)

    def _rows(self) -> list[npt.NDArray[np.int_]]:
        """Rows of every label, in the order of first appearance."""
        _, first, inverse = np.unique(self.line, return_index=True, return_inverse=True)
        order = np.argsort(inverse, kind="stable")
        pieces = np.split(order, np.cumsum(np.bincount(inverse))[:-1])
        return [pieces[k] for k in np.argsort(first)]

    def _columns(self) -> list[str]:
        return ["x", "y", "values", "line"] + ["height_m"] * (self.height_m is not None)

    def _take(self, keep: npt.NDArray[Any]) -> Lines:
        return self._with(**{name: getattr(self, name)[keep] for name in self._columns()})

    def _with(self, **columns: npt.NDArray[Any]) -> Lines:
        """The same survey with other columns, which were checked and lie on the same turn already."""
        out: Lines = object.__new__(Lines)
        for field in fields(Lines):
            object.__setattr__(out, field.name, columns.get(field.name, getattr(self, field.name)))
        return out

    def scale_m(self) -> tuple[float, float]:
        """Metres per map unit (east, north) at the middle of the lines."""
        return metres_per_unit(self.geographic, float(np.mean(self.y)))


def read_lines(
    path: str | Path,
    *,
    x: str | None = None,
    y: str | None = None,
    value: str | None = None,
    line: str | None = None,
    height: str | None = None,
    geographic: bool | None = None,
    unit: str | None = None,
    name: str | None = None,
) -> Lines:
    """Read survey lines from a table (CSV, compressed or not, Geosoft's text form, Parquet) with one row a point.

    Columns are known by their names and units as in `geomag.read_track`; what is not known is asked for. Lines are told apart by a column, or
    by `Line` and `Tie` before their points. `height` is the column of the heights, where they are to be read; `unit` and `name` are those of the values,
    the unit as the file says it where it does. Rows without a position, a value (`*`) or, if asked for, a height are left out.

    Raises `MissingFileError`, `ReadError` for a file that is no table, `UnknownVariableError` naming the columns that
    there are, and `InvalidInputError` where nothing says whether coordinates are degrees or metres.
    """
    points, labels, heights = line_points(path, x, y, value, line, geographic, height)
    unit = points.unit if unit is None else unit
    return Lines(
        points.x, points.y, points.values, labels, bool(points.geographic), height_m=heights, unit=unit, name=name
    )


def legs_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance from every point of a line to the next, metres."""
    return np.asarray(np.hypot(np.diff(x) * scale_m[0], np.diff(y) * scale_m[1]), dtype=np.float64)


def along_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance flown from the first point of a line to every point, metres."""
    return np.concatenate([[0.0], np.cumsum(legs_m(x, y, scale_m))])


def smooth_lines(lines: Lines, length_m: float) -> Lines:
    """Lines whose values are means over `length_m` along each line, taken twice, which narrows to its ends and to gaps.

    Every reading of a survey is honoured by its map. Where their noise makes slopes as steep as the field's own, the map has features
    that are none, and the risks declared on it are too small. A quarter to a whole of the line spacing takes the noise away and
    leaves what can be carried from line to line. Readings that are matched on such a map are best averaged over as long a stretch.

    Raises `InvalidInputError` for a length that is not a number above zero.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag import synthetic
    >>> from geomag.survey import smooth_lines
    >>> field = synthetic.Crust().draw((0, 0, 20_000, 10_000), seed=4)
    >>> lines = synthetic.survey(field, line_spacing_m=500.0, sample_spacing_m=10.0, sigma=2.0)
    >>> truth = field.sample(lines.x, lines.y)
    >>> round(float(np.std(lines.values - truth)), 1)
    2.0
    >>> round(float(np.std(smooth_lines(lines, 100.0).values - truth)), 1)
    0.5
    """
    above(0, length_m=length_m)
    scale = lines.scale_m()
    values = lines.values.copy()
    for rows in lines.survey.rows:
        along = along_m(lines.x[rows], lines.y[rows], scale)
        half = np.minimum(0.5 * length_m, np.minimum(along, along[-1] - along)) * (1 + 1e-9)
        first = np.searchsorted(along, along - half, side="left")
        last = np.searchsorted(along, along + half, side="right")
        # Sums of what is left without the mean keep their digits.
        mean = float(np.mean(values[rows]))
        some = values[rows] - mean
        for _ in range(2):
            total = np.concatenate([[0.0], np.cumsum(some)])
            some = (total[last] - total[first]) / (last - first)
        values[rows] = mean + some
    return lines._with(values=values)
