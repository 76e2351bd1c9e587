"""Survey lines: what they are, how they are read, averaged, cut into windows and shared out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._metres import metres_per_unit
from geomag._ranges import above
from geomag.io import line_points

Array = npt.NDArray[np.float64]
#: Places and values of the samples of one window: x, y, values.
Window = tuple[Array, Array, Array]

#: Samples of one learning window, and the fewest that still make one.
WINDOW = 40
SHORTEST_WINDOW = 20


@dataclass(frozen=True)
class Lines:
    """Survey lines: positions, values and line labels of all points, in the order of flight within each line.

    Shapes (n,); positions in map units (metres, or degrees with `geographic`), values in the map's unit.
    """

    x: Array
    y: Array
    values: Array
    line: npt.NDArray[Any]
    geographic: bool = False

    def __post_init__(self) -> None:
        """Convert, and refuse what does not fit together."""
        for name in ("x", "y", "values"):
            try:
                object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.float64))
            except (TypeError, ValueError) as error:
                raise InvalidInputError(f"lines {name}: needed numbers, got something else ({error})") from error
        object.__setattr__(self, "line", np.asarray(self.line))
        shapes = {name: getattr(self, name).shape for name in ("x", "y", "values", "line")}
        if len(set(shapes.values())) != 1 or len(self.x.shape) != 1:
            raise ShapeError(f"lines: needed x, y, values and line of one length, got {shapes}")
        for name in ("x", "y", "values"):
            bad = np.flatnonzero(~np.isfinite(getattr(self, name)))
            if bad.size:
                raise InvalidInputError(
                    f"lines {name}[{bad[0]}]: needed a finite number, got {getattr(self, name)[bad[0]]}"
                )
        if self.x.size == 0:
            raise TooFewSamplesError("lines: needed at least 1 point, got 0")
        if self.geographic and np.abs(self.y).max() > 90.0:
            worst = self.y[np.abs(self.y).argmax()]
            raise InvalidInputError(
                f"lines y: needed latitudes in [-90, 90] degrees (are the lines in metres?), got {worst:g}"
            )

    def split(self) -> list[Lines]:
        """One `Lines` for every label, in the order of first appearance."""
        return [self._take(rows) for rows in self._rows()]

    def _rows(self) -> list[npt.NDArray[np.int_]]:
        """Rows of every line, in the order of first appearance."""
        _, first, inverse = np.unique(self.line, return_index=True, return_inverse=True)
        order = np.argsort(inverse, kind="stable")
        pieces = np.split(order, np.cumsum(np.bincount(inverse))[:-1])
        return [pieces[k] for k in np.argsort(first)]

    def _take(self, keep: npt.NDArray[Any]) -> Lines:
        return Lines(self.x[keep], self.y[keep], self.values[keep], self.line[keep], self.geographic)

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
    geographic: bool | None = None,
) -> Lines:
    """Read survey lines from a table (CSV, compressed or not, Geosoft's text form, Parquet) with one row a point.

    Columns are known by their names and units as in `geomag.read_track`; what is not known is asked for. Lines are told apart by a column, or
    by `Line` and `Tie` before their points. Rows without a position or a value (`*`) are left out.

    Raises `MissingFileError`, `ReadError` for a file that is no table, `UnknownVariableError` naming the columns that
    there are, and `InvalidInputError` where nothing says whether coordinates are degrees or metres.
    """
    points, labels = line_points(path, x, y, value, line, geographic)
    return Lines(points.x, points.y, points.values, labels, bool(points.geographic))


def legs_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance from every point of a line to the next, metres."""
    return np.asarray(np.hypot(np.diff(x) * scale_m[0], np.diff(y) * scale_m[1]), dtype=np.float64)


def along_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance flown from the first point of a line to every point, metres."""
    return np.concatenate([[0.0], np.cumsum(legs_m(x, y, scale_m))])


def smooth_lines(lines: Lines, length_m: float) -> Lines:
    """Lines whose values are means over `length_m` along each line, taken twice, which narrows to its ends.

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
    for rows in lines._rows():
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
    return Lines(lines.x, lines.y, values, lines.line, lines.geographic)


def line_spacing_m(lines: Lines) -> float:
    """Distance between neighbouring lines, metres: the area that they cover over their length."""
    east, north = lines.scale_m()
    length = 0.0
    for one in lines.split():
        length += float(np.sum(legs_m(one.x, one.y, (east, north))))
    if length == 0.0:
        raise TooFewSamplesError("lines: needed lines of at least 2 points each, got single points")
    # The area is counted in boxes a few spacings wide, which a line crosses wherever there are lines at all, and which divide
    # the extent evenly, so that none lies half outside.
    position = np.column_stack([(lines.x - lines.x.min()) * east, (lines.y - lines.y.min()) * north])
    extent = np.maximum(position.max(axis=0), 1e-9 * position.max())
    spacing, box = 0.0, float(extent.max()) / 50
    for _ in range(3):
        count = np.ceil(extent / box).astype(int)
        boxes = np.unique(np.minimum((position / extent * count).astype(int), count - 1), axis=0)
        spacing = float(len(boxes) * np.prod(extent / count) / length)
        # A single line covers no area of its own: it is taken to stand for boxes as wide as they are long.
        spacing = max(spacing, float(np.sqrt(np.prod(extent / count))) / 50) if np.all(count > 1) else box
        box = 4 * spacing
    return spacing


def folds_of(lines: list[Lines], folds: int) -> npt.NDArray[np.int_]:
    """Fold of every line: neighbours get different ones, east-west and north-south lines apart."""
    out = np.zeros(len(lines), dtype=int)
    east, north = lines[0].scale_m()
    across = np.array([np.ptp(one.x) * east >= np.ptp(one.y) * north for one in lines])
    where = np.array([np.median(one.y) if a else np.median(one.x) for one, a in zip(lines, across, strict=True)])
    for kind in (True, False):
        members = np.flatnonzero(across == kind)
        out[members[np.argsort(where[members], kind="stable")]] = np.arange(members.size) % folds
    return out


def noise_of(lines: list[Lines]) -> float:
    """Noise of the data along the lines, robustly: second differences hold little else."""
    second = np.concatenate([np.diff(one.values, 2) for one in lines])
    rounding = np.abs(np.diff(np.unique(np.concatenate([one.values[:200] for one in lines[:50]]))))
    floor = float(rounding[rounding > 0].min()) / np.sqrt(12) if np.any(rounding > 0) else 0.0
    return float(max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6), floor, 1e-9))


def windows_of(lines: list[Lines], spacing_m: float, length: int, overlap: float = 0.0) -> list[Window]:
    """Equally spaced samples along every line: as many windows of `length` as fit, or one shorter.

    A window shares `overlap` of its samples with the one before it.
    """
    out = []
    for one in lines:
        along = along_m(one.x, one.y, one.scale_m())
        total = int(along[-1] / spacing_m) + 1
        step = length if total >= length else total
        if step < SHORTEST_WINDOW:
            continue
        for start in range(0, total - step + 1, max(1, round(step * (1 - overlap)))):
            at = spacing_m * (start + np.arange(step))
            out.append((np.interp(at, along, one.x), np.interp(at, along, one.y), np.interp(at, along, one.values)))
    return out
