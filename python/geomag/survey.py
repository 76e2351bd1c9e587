"""Survey lines to a map that knows its own errors.

`map_from_lines` grids the lines, leaves a third of them out at a time, matches those against a map of the others, and
learns from what it sees how large the errors of a gridded map are, how far along a track they go together, and how far whole
features stand displaced. The `GridMap` that comes back carries all of it; `match_posterior` needs nothing else.

The model, in the distance D to the nearest datum, the local root mean square gradient G and the local root mean square
second derivative C of the map:

    sigma^2 = n^2 + (a D / L)^2 + (0.1 cell * G)^2 + (b G D)^2 + (c C D^2)^2

with L half the line spacing and n the noise of the lines themselves (from their second differences). `b G D` is a feature displaced
by a part of the gap, `c C D^2` one that no line has seen, `a` what is between the lines where the map is flat. All of them vanish on
a line: that is what keeps a track in a gap from being taken for the next line, which it resembles most. Samples follow a
Student-t law; their effective number follows from a correlation length in units of D. Source: geomag's own, from the statistics of
two aeromagnetic surveys (docs/calibration-report.md); the gridding is Briggs (1974), Smith and Wessel (1990).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError, UnknownVariableError
from geomag._geomag import GridMap, Track, _distance_to_data, _minimum_curvature, match_posterior_many
from geomag._metres import metres_per_unit
from geomag._optional import require
from geomag.io import floats, read_table

Array = npt.NDArray[np.float64]
Progress = bool | Callable[[int, int], None] | None

#: Samples of one learning window, and the fewest that still make one.
WINDOW = 40
SHORTEST_WINDOW = 20
#: Position error of the lines themselves, cells: what the data on a line may be displaced by.
LINE_ERROR_CELLS = 0.1
#: Tails of one sample, and spread of the error level from track to track.
NU = 3.0
SCALE_SPREAD = 0.35
#: Displacement common to a whole window, in distances to the data.
REGISTRATION = 0.05
#: Correlation lengths (in distances to the data) and shares of the single-sample sigma that are tried. One sample's law has the worst
#: tracks in it, which the spread of the level stands for already: most tracks need less.
CORRELATIONS = (0.8, 0.95, 1.1, 1.3, 1.6, 2.0)
SHARES = (0.5, 0.7, 1.0)
#: Where the longest of these is the best, longer ones by this factor are tried up to that limit.
LONGER = 1.25
MOST_CORRELATION = 20.0
#: What is believed of the two before a survey is seen: centre and standard deviation of the logarithm. A survey of a
#: few hundred windows moves them where it is clear, and only there.
CORRELATION_PRIOR = (1.1, 0.2)
SHARE_PRIOR = (0.5, 0.35)
#: Where the line spacing is all that is known (`with_line_spacing`): mean distance to the data in line spacings; displacement
#: (b of the formula), correlation length and registration in such distances. The same for every survey; from the two of
#: docs/calibration-report.md, for grids by linear interpolation, the worse of the common methods.
SPACING_DISTANCE = 0.25
SPACING_DISPLACEMENT = 0.75
SPACING_CORRELATION = 2.25
SPACING_REGISTRATION = 0.15
#: Nodes of a map whose spacing is chosen here.
MOST_NODES = 1_500_000
#: Learning windows; more cost time and change the numbers by less than their own error.
MOST_WINDOWS = 300


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


@dataclass
class ErrorModel:
    """What was learnt of a map's errors.

    `noise` and `floor` (value units), `displacement` (share of the distance to the data) and `curvature` are n, a, b and c of
    the module's formula; `correlation` and `registration` are in distances to the data. `windows` counts the left-out windows that
    it rests on, `loss` is the mean log loss of the risks declared for them.
    """

    noise: float
    floor: float
    displacement: float
    curvature: float
    correlation: float
    registration: float
    line_spacing_m: float
    windows: int
    loss: float
    nu: float = NU
    scale_spread: float = SCALE_SPREAD
    trials: list[dict[str, float]] = field(default_factory=list, repr=False)


def read_lines(
    path: str | Path,
    *,
    x: str = "longitude",
    y: str = "latitude",
    value: str = "total_field_anomaly_nt",
    line: str = "line",
    geographic: bool = True,
) -> Lines:
    """Read survey lines from a table (CSV, compressed or not) with one row a point; needs pandas (extra `survey`).

    Rows without a position or a value are left out.

    Raises `MissingFileError`, `ReadError` for a file that is no table, and `UnknownVariableError` naming the columns that
    there are.
    """
    table = read_table(Path(path))
    for name in (x, y, value, line):
        if name not in table.columns:
            raise UnknownVariableError(f"{path}: needed a column '{name}', got {', '.join(map(str, table.columns))}")
    table = table.dropna(subset=[x, y, value])
    columns = [floats(table, name, path) for name in (x, y, value)]
    return Lines(columns[0], columns[1], columns[2], table[line].to_numpy(), geographic)


def _legs_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance from every point of a line to the next, metres."""
    return np.asarray(np.hypot(np.diff(x) * scale_m[0], np.diff(y) * scale_m[1]), dtype=np.float64)


def _along_m(x: Array, y: Array, scale_m: tuple[float, float]) -> Array:
    """Distance flown from the first point of a line to every point, metres."""
    return np.concatenate([[0.0], np.cumsum(_legs_m(x, y, scale_m))])


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
    if not (np.isfinite(length_m) and length_m > 0):
        raise InvalidInputError(f"length_m: needed a number > 0, got {length_m}")
    scale = lines.scale_m()
    values = lines.values.copy()
    for rows in lines._rows():
        along = _along_m(lines.x[rows], lines.y[rows], scale)
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
        length += float(np.sum(_legs_m(one.x, one.y, (east, north))))
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


def _nodes(c: Array, step: float) -> tuple[float, int]:
    """First of the whole multiples of `step` that enclose every coordinate, and how many there are, at least 2."""
    low, high = float(c.min()), float(c.max())
    first = float(np.floor(low / step) * step)
    # A quotient may round up to a whole number that the coordinate does not reach, or down to one that it passes.
    first -= step * (first > low)
    count = max(int(np.ceil((high - first) / step)) + 1, 2)
    return first, count + (first + step * (count - 1) < high)


@dataclass(frozen=True)
class _Axes:
    x: tuple[float, float, int]
    y: tuple[float, float, int]
    cell_m: tuple[float, float]

    @staticmethod
    def over(lines: Lines, spacing: float | tuple[float, float] | None) -> _Axes:
        east, north = lines.scale_m()
        if spacing is None:
            # An eighth of the gap lets a feature be placed within it; a country is gridded more coarsely.
            area = np.ptp(lines.x) * east * np.ptp(lines.y) * north
            step = max(line_spacing_m(lines) / 8, float(np.sqrt(area / MOST_NODES)))
            sx, sy = step / east, step / north
        else:
            try:
                sx, sy = np.broadcast_to(np.asarray(spacing, dtype=float), 2)
            except (TypeError, ValueError) as error:
                raise InvalidInputError(f"spacing: needed a number or a pair (x, y), got {spacing!r}") from error
        if not (0 < sx < np.inf and 0 < sy < np.inf):
            raise InvalidInputError(f"spacing: needed finite numbers > 0, got {spacing}")
        (x0, nx), (y0, ny) = _nodes(lines.x, float(sx)), _nodes(lines.y, float(sy))
        if nx * ny > 50_000_000:
            raise InvalidInputError(f"spacing: needed a grid of at most 50,000,000 nodes, got {ny} x {nx}")
        return _Axes((x0, float(sx), nx), (y0, float(sy), ny), (float(sx * east), float(sy * north)))

    @staticmethod
    def of(grid: GridMap) -> _Axes:
        x, y = grid.x, grid.y
        return _Axes((float(x[0]), grid.spacing[0], len(x)), (float(y[0]), grid.spacing[1], len(y)), grid.spacing_m)

    @property
    def cell(self) -> float:
        return float(np.sqrt(self.cell_m[0] * self.cell_m[1]))

    def coordinates(self) -> tuple[Array, Array]:
        x = np.asarray(self.x[0] + self.x[1] * np.arange(self.x[2]), dtype=np.float64)
        y = np.asarray(self.y[0] + self.y[1] * np.arange(self.y[2]), dtype=np.float64)
        return x, y


def _grid(lines: list[Lines], axes: _Axes, method: str) -> tuple[Array, Array]:
    """Values and distances to the data at the nodes."""
    x = np.concatenate([one.x for one in lines])
    y = np.concatenate([one.y for one in lines])
    values = np.concatenate([one.values for one in lines])
    distance = _distance_to_data(x, y, axes.x, axes.y, cell_m=axes.cell_m)
    if method == "minimum_curvature":
        surface = _minimum_curvature(x, y, values, axes.x, axes.y, aspect=axes.cell_m[0] / axes.cell_m[1])
        return surface, distance
    if method not in ("linear", "cubic"):
        raise InvalidInputError(f"method: needed 'minimum_curvature', 'linear' or 'cubic', got '{method}'")
    interpolate = require("scipy.interpolate", "survey", f"gridding by method '{method}'")
    # Means over blocks of one cell keep the triangles from being needles along the lines.
    block = np.column_stack([np.floor((x - axes.x[0]) / axes.x[1]), np.floor((y - axes.y[0]) / axes.y[1])])
    _, inverse = np.unique(block, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    count = np.bincount(inverse)
    scale = np.array([axes.cell_m[0] / axes.x[1], axes.cell_m[1] / axes.y[1]])
    points = np.column_stack([np.bincount(inverse, x), np.bincount(inverse, y)]) / count[:, None] * scale
    means = np.bincount(inverse, values) / count
    kind = interpolate.LinearNDInterpolator if method == "linear" else interpolate.CloughTocher2DInterpolator
    xs, ys = axes.coordinates()
    return np.asarray(kind(points, means)(*np.meshgrid(xs * scale[0], ys * scale[1])), dtype=float), distance


def _smooth(values: Array, known: npt.NDArray[np.bool_], radius: float) -> Array:
    """Mean over about a normal law of standard deviation `radius` cells (three boxes), of the known nodes alone."""
    half = max(1, round(np.sqrt(1 + 4 * radius**2) / 2 - 0.5))

    def box(a: Array) -> Array:
        for axis in (0, 1):
            padded = np.pad(a, [(half + 1, half) if d == axis else (0, 0) for d in (0, 1)])
            total = np.cumsum(padded, axis=axis)
            n = a.shape[axis]
            upper = np.take(total, np.arange(n) + 2 * half + 1, axis=axis)
            a = upper - np.take(total, np.arange(n), axis=axis)
        return np.asarray(a / (2 * half + 1) ** 2, dtype=np.float64)

    weight = known.astype(float)
    filled = np.where(known, values, 0.0)
    for _ in range(3):
        filled, weight = box(filled), box(weight)
    return np.where(known, filled / np.maximum(weight, 1e-12), np.nan)


def _features(surface: Array, distance: Array, axes: _Axes) -> tuple[Array, Array]:
    """Local root mean square gradient (per metre) and second derivative (per square metre)."""
    known = np.isfinite(surface)
    filled = np.where(known, surface, np.nan)
    gy, gx = np.gradient(filled, axes.cell_m[1], axes.cell_m[0])
    gxx = np.gradient(gx, axes.cell_m[0], axis=1)
    gyy = np.gradient(gy, axes.cell_m[1], axis=0)
    radius = max(2 * float(np.median(distance[known])) / axes.cell, 1.0)
    first, second = gx**2 + gy**2, gxx**2 + gyy**2
    gradient = np.sqrt(np.maximum(_smooth(first, np.isfinite(first), radius), 0))
    curvature = np.sqrt(np.maximum(_smooth(second, np.isfinite(second), radius), 0))
    # Next to a hole there is no difference to take; the largest nearby one stands in.
    worst_g, worst_c = np.nanquantile(gradient, 0.9), np.nanquantile(curvature, 0.9)
    gradient = np.where(known & ~np.isfinite(gradient), worst_g, gradient)
    curvature = np.where(known & ~np.isfinite(curvature), worst_c, curvature)
    return gradient, curvature


def _noise(lines: list[Lines]) -> float:
    """Noise of the data along the lines, robustly: second differences hold little else."""
    second = np.concatenate([np.diff(one.values, 2) for one in lines])
    rounding = np.abs(np.diff(np.unique(np.concatenate([one.values[:200] for one in lines[:50]]))))
    floor = float(rounding[rounding > 0].min()) / np.sqrt(12) if np.any(rounding > 0) else 0.0
    return float(max(1.4826 * float(np.median(np.abs(second))) / np.sqrt(6), floor, 1e-9))


@dataclass(frozen=True)
class _Law:
    """The part of the sigma formula that is known before anything is fitted."""

    noise: float
    half_spacing: float
    cell: float


def _sigma(gradient: Array, curvature: Array, distance: Array, law: _Law, a: float, b: float, c: float) -> Array:
    line = LINE_ERROR_CELLS * law.cell
    return np.sqrt(
        law.noise**2
        + (a * distance / law.half_spacing) ** 2
        + (line * gradient) ** 2
        + (b * gradient * distance) ** 2
        + (c * curvature * distance**2) ** 2
    )


def _windows(
    lines: list[Lines], spacing_m: float, length: int, overlap: float = 0.0
) -> list[tuple[Array, Array, Array]]:
    """Equally spaced samples along every line: as many windows of `length` as fit, or one shorter.

    A window shares `overlap` of its samples with the one before it.
    """
    out = []
    for one in lines:
        along = _along_m(one.x, one.y, one.scale_m())
        total = int(along[-1] / spacing_m) + 1
        step = length if total >= length else total
        if step < SHORTEST_WINDOW:
            continue
        for start in range(0, total - step + 1, max(1, round(step * (1 - overlap)))):
            at = spacing_m * (start + np.arange(step))
            out.append((np.interp(at, along, one.x), np.interp(at, along, one.y), np.interp(at, along, one.values)))
    return out


def _nearest(layer: Array, axes: _Axes, x: Array, y: Array) -> Array:
    i = np.clip(np.round((x - axes.x[0]) / axes.x[1]).astype(int), 0, axes.x[2] - 1)
    j = np.clip(np.round((y - axes.y[0]) / axes.y[1]).astype(int), 0, axes.y[2] - 1)
    return cast(Array, layer[j, i])


def _minimise(loss: Callable[[Array], float], start: Array) -> Array:
    """Pattern search in the logarithms of positive parameters."""
    best, value, step = start.copy(), loss(start), 1.0
    while step > 0.02:
        moved = False
        for k in range(best.size):
            for sign in (1, -1):
                trial = best.copy()
                trial[k] += sign * step
                got = loss(trial)
                if got < value - 1e-9:
                    best, value, moved = trial, got, True
        if not moved:
            step /= 2
    return best


def _fit_sigma(residuals: Array, gradient: Array, curvature: Array, distance: Array, law: _Law) -> Array:
    """a, b, c by maximum likelihood under the Student-t law."""

    def loss(logs: Array) -> float:
        a, b, c = np.exp(logs)
        s2 = _sigma(gradient, curvature, distance, law, a, b, c) ** 2
        return float(np.mean(0.5 * np.log(s2) + 0.5 * (NU + 1) * np.log1p(residuals**2 / (NU * s2))))

    scale = float(np.median(np.abs(residuals))) + 1e-9
    starts = [np.log([scale / 2, b, c]) for b, c in ((0.2, 0.1), (0.05, 0.3), (0.4, 0.02))]
    found = [_minimise(loss, s) for s in starts]
    return np.exp(min(found, key=loss))


@dataclass
class _Fold:
    base: GridMap
    distance: Array
    gradient: Array
    curvature: Array
    windows: list[tuple[Array, Array, Array]]


def _fold(
    lines: list[Lines], out: npt.NDArray[np.bool_], axes: _Axes, method: str, spacing_m: float, reach: float
) -> _Fold:
    kept = [one for one, left in zip(lines, out, strict=True) if not left]
    surface, distance = _grid(kept, axes, method)
    surface = np.where(distance <= reach, surface, np.nan)
    gradient, curvature = _features(surface, distance, axes)
    xs, ys = axes.coordinates()
    base = GridMap(surface, xs, ys, geographic=lines[0].geographic)
    left = [one for one, o in zip(lines, out, strict=True) if o]
    windows = []
    for x, y, v in _windows(left, 0.6 * spacing_m, WINDOW):
        if np.mean(np.isfinite(base.sample(x, y))) >= 0.9:
            windows.append((x, y, v))
    return _Fold(base, distance, gradient, curvature, windows)


def learn_errors(
    lines: Lines,
    *,
    spacing: float | tuple[float, float] | None = None,
    grid: GridMap | None = None,
    method: str = "minimum_curvature",
    folds: int = 3,
    seed: int = 0,
    progress: Progress = None,
) -> ErrorModel:
    """Learn the error model of a map from its own lines.

    A `folds`-th of the lines is left out at a time (neighbouring lines in different folds), the others are gridded, and the left-out
    lines are compared with that map: sample by sample for the size of the errors, window by window (40 samples 0.6 line
    spacings apart, started up to 4 spacings away) for the correlation, which is the one whose declared risks have the least
    log loss. Nothing is tuned by hand and nothing but the lines goes in.

    `spacing` (map units) is that of the map, `grid` a map whose axes are used instead. Raises `TooFewSamplesError` where
    fewer than 20 windows can be made. Source: geomag's own.
    """
    pieces = lines.split()
    if folds < 2 or len(pieces) < 2 * folds:
        raise TooFewSamplesError(
            f"survey lines: needed at least {2 * max(folds, 2)} lines for {folds} folds, got {len(pieces)}"
        )
    spacing_m = line_spacing_m(lines)
    axes = _Axes.of(grid) if grid is not None else _Axes.over(lines, spacing)
    reach = 4 * spacing_m
    fold = folds_of(pieces, folds)
    parts = [_fold(pieces, fold == k, axes, method, spacing_m, reach) for k in range(folds)]
    rng = np.random.default_rng(seed)
    count = sum(len(p.windows) for p in parts)
    if count < 20:
        raise TooFewSamplesError(
            f"survey lines: needed lines for at least 20 windows of {SHORTEST_WINDOW} samples, "
            f"{0.6 * spacing_m:.0f} m apart, got {count}"
        )
    for part in parts:
        limit = MOST_WINDOWS // folds
        if len(part.windows) > limit:
            part.windows = [part.windows[i] for i in rng.choice(len(part.windows), limit, replace=False)]
    samples: list[Array] = []
    for part in parts:
        for x, y, v in part.windows:
            error = v - part.base.sample(x, y)
            layers = [_nearest(layer, axes, x, y) for layer in (part.gradient, part.curvature, part.distance)]
            ok = np.isfinite(error) & np.all(np.isfinite(layers), axis=0)
            if ok.sum() >= SHORTEST_WINDOW // 2:
                samples.append(np.vstack([error[ok] - np.median(error[ok]), *[layer[ok] for layer in layers]]))
    residuals, gradient, curvature, distance = np.hstack(samples)
    law = _Law(_noise(pieces), 0.5 * spacing_m, axes.cell)
    a, b, c = (float(v) for v in _fit_sigma(residuals, gradient, curvature, distance, law))
    trials = _try_correlations(parts, law, (a, b, c), axes, spacing_m, rng, progress)
    best = min(trials, key=lambda t: t["total"])
    return ErrorModel(
        noise=law.noise,
        floor=a * best["share"],
        displacement=b * best["share"],
        curvature=c * best["share"],
        correlation=best["correlation"],
        registration=REGISTRATION,
        line_spacing_m=spacing_m,
        windows=sum(len(p.windows) for p in parts),
        loss=best["loss"],
        trials=trials,
    )


def _layered(part: _Fold, law: _Law, abc: list[float]) -> tuple[GridMap, Array]:
    """One fold's map with its sigma, and the distances where it is known."""
    sigma = _sigma(part.gradient, part.curvature, part.distance, law, *abc)
    known = np.isfinite(part.base.values) & np.isfinite(sigma)
    layered = GridMap(
        np.where(known, part.base.values, np.nan),
        part.base.x,
        part.base.y,
        geographic=part.base.geographic,
        sigma=np.where(known, sigma, np.nan),
    )
    return layered, np.where(known, part.distance, np.nan)


def _try_correlations(
    parts: list[_Fold],
    law: _Law,
    abc: tuple[float, float, float],
    axes: _Axes,
    spacing_m: float,
    rng: np.random.Generator,
    progress: Progress,
) -> list[dict[str, float]]:
    scale = (axes.cell_m[0] / axes.x[1], axes.cell_m[1] / axes.y[1])
    half = (4 * spacing_m / scale[0], 4 * spacing_m / scale[1])
    tracks, truths = [], []
    for part in parts:
        offsets = rng.uniform(-1, 1, (len(part.windows), 2)) * half
        tracks.append([Track(x - o[0], y - o[1], v) for (x, y, v), o in zip(part.windows, offsets, strict=True)])
        truths.append(offsets)
    tolerance_m = 0.5 * spacing_m
    report = progress if callable(progress) else None
    trials: list[dict[str, float]] = []
    maps = {share: [_layered(part, law, [share * v for v in abc]) for part in parts] for share in SHARES}

    def attempt(correlation: float, share: float, total: int) -> None:
        losses = []
        for (layered, distance), some, offsets in zip(maps[share], tracks, truths, strict=True):
            if not some:
                continue
            model = layered.with_error_model(
                nu=NU,
                scale_spread=SCALE_SPREAD,
                correlation=correlation,
                registration=REGISTRATION,
                distance_m=distance,
            )
            fixes = match_posterior_many(model, some, half_width=half, tolerance_m=tolerance_m)
            for fix, offset in zip(fixes, offsets, strict=True):
                if fix.risk is None:
                    continue
                wrong = float(np.hypot(*((np.array(fix.offset) - offset) * scale))) > tolerance_m
                # Some hundred windows tell nothing of risks below one in a hundred.
                risk = float(np.clip(fix.risk, 1e-2, 1 - 1e-2))
                losses.append(-np.log(risk if wrong else 1 - risk))
        unlikely = 0.5 * (np.log(correlation / CORRELATION_PRIOR[0]) / CORRELATION_PRIOR[1]) ** 2
        unlikely += 0.5 * (np.log(share / SHARE_PRIOR[0]) / SHARE_PRIOR[1]) ** 2
        trials.append(
            {
                "correlation": correlation,
                "share": share,
                "loss": float(np.mean(losses)),
                "total": float(np.sum(losses) + unlikely),
            }
        )
        if report is not None:
            report(len(trials), total)

    for share in SHARES:
        for correlation in CORRELATIONS:
            attempt(correlation, share, len(SHARES) * len(CORRELATIONS))
    # A survey whose errors go together further than the usual one's says so at the end of what was tried.
    longest = CORRELATIONS[-1]
    while longest < MOST_CORRELATION:
        best = min(trials, key=lambda t: t["total"])
        if best["correlation"] < longest:
            break
        longest *= LONGER
        attempt(longest, best["share"], len(trials) + 1)
    return trials


def with_errors(grid: GridMap, lines: Lines, model: ErrorModel) -> GridMap:
    """Return the map with the sigma and the error model that its lines give it.

    `grid` is any map made from `lines`; nodes further than 4 line spacings from a datum become holes, because nothing was learnt
    about them.
    """
    axes = _Axes.of(grid)
    distance = _distance_to_data(lines.x, lines.y, axes.x, axes.y, cell_m=axes.cell_m)
    values = np.where(distance <= 4 * model.line_spacing_m, np.asarray(grid.values, dtype=float), np.nan)
    gradient, curvature = _features(values, distance, axes)
    law = _Law(model.noise, 0.5 * model.line_spacing_m, axes.cell)
    sigma = _sigma(gradient, curvature, distance, law, model.floor, model.displacement, model.curvature)
    return _carrying(grid, values, sigma, distance, model)


def _carrying(grid: GridMap, values: Array, sigma: Array, distance: Array, model: ErrorModel) -> GridMap:
    """`grid` with other values, their sigma and an error model; a node without any of them becomes a hole."""
    known = np.isfinite(values) & np.isfinite(sigma)
    layered = GridMap(
        np.where(known, values, np.nan),
        grid.x,
        grid.y,
        geographic=grid.geographic,
        sigma=np.where(known, sigma, np.nan),
        name=grid.name,
        units=grid.units,
        crs=grid.crs,
    )
    return layered.with_error_model(
        nu=model.nu,
        scale_spread=model.scale_spread,
        correlation=model.correlation,
        registration=model.registration,
        distance_m=np.where(known, distance, np.nan),
    )


def with_line_spacing(grid: GridMap, line_spacing_m: float) -> GridMap:
    """Return the map with errors that are typical of a survey with that distance between its lines.

    For a grid whose lines are not at hand: reports state the spacing. Its errors are taken as 0.75 G D at every node, with G the
    local root mean square gradient and D a quarter of the spacing, correlated over 2.25 D and displaced by 0.15 D: rougher than
    what `map_from_lines` learns, which knows where the lines ran. Raises `InvalidInputError` for a spacing that is not a
    number above zero, for a map of fewer than 3 x 3 nodes and for one without neighbouring values. Source: geomag's own, see docs/calibration-report.md.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.survey import with_line_spacing
    >>> axis = np.arange(0.0, 5000.0, 50.0)
    >>> grid = geomag.GridMap(np.sin(axis / 300) * 80 + np.cos(axis[:, None] / 400) * 60, axis, axis)
    >>> grid = with_line_spacing(grid, 200.0)
    >>> bool(np.nanmax(grid.sigma) < 15)
    True
    """
    if not (np.isfinite(line_spacing_m) and line_spacing_m > 0):
        raise InvalidInputError(f"line_spacing_m: needed a number > 0, got {line_spacing_m}")
    values = np.asarray(grid.values, dtype=float)
    if min(values.shape) < 3:
        raise InvalidInputError(f"map: needed at least 3 x 3 nodes, got {values.shape[0]} x {values.shape[1]}")
    if not np.any(np.isfinite(np.add(*np.gradient(values)))):
        raise InvalidInputError("map: needed neighbouring nodes with values, to take a gradient from, got none")
    distance_m = SPACING_DISTANCE * float(line_spacing_m)
    distance = np.where(np.isfinite(values), distance_m, np.nan)
    gradient, _ = _features(values, distance, _Axes.of(grid))
    model = ErrorModel(
        noise=0.0,
        floor=0.0,
        displacement=SPACING_DISPLACEMENT,
        curvature=0.0,
        correlation=SPACING_CORRELATION,
        registration=SPACING_REGISTRATION,
        line_spacing_m=float(line_spacing_m),
        windows=0,
        loss=float("nan"),
    )
    return _carrying(grid, values, model.displacement * gradient * distance, distance, model)


def map_from_lines(
    lines: Lines,
    *,
    spacing: float | tuple[float, float] | None = None,
    grid: GridMap | None = None,
    method: str = "minimum_curvature",
    max_distance_m: float | None = None,
    model: ErrorModel | None = None,
    folds: int = 3,
    seed: int = 0,
    progress: Progress = None,
) -> GridMap:
    """Survey lines to a map with its sigma and error model, in one call.

    Parameters
    ----------
    lines : the survey (see `Lines`, `read_lines`).
    spacing : node spacing in map units, one number or (x, y); an eighth of the line spacing by default, coarser for a
        map of over 1.5 million nodes.
    grid : a map already made from these lines; it is kept as it is and given its errors.
    method : 'minimum_curvature' (needs NumPy alone), 'linear' or 'cubic' on Delaunay triangles (needs SciPy).
    max_distance_m : nodes further from any datum are holes; 2.5 line spacings by default.
    model : errors learnt before (`learn_errors`), to be used instead of learning them.
    folds, seed : of the cross-validation.
    progress : callable (done, total), told about the learning.

    Raises `TooFewSamplesError` where the lines are too few to learn from.
    """
    if model is None:
        model = learn_errors(
            lines, spacing=spacing, grid=grid, method=method, folds=folds, seed=seed, progress=progress
        )
    if grid is None:
        axes = _Axes.over(lines, spacing)
        surface, distance = _grid([lines], axes, method)
        reach = 2.5 * model.line_spacing_m if max_distance_m is None else max_distance_m
        xs, ys = axes.coordinates()
        grid = GridMap(np.where(distance <= reach, surface, np.nan), xs, ys, geographic=lines.geographic)
    return with_errors(grid, lines, model)
