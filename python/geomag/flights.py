"""Flights along real survey lines: hours of real readings at their real positions.

A survey's lines, chained in the order in which an aircraft would fly them, with straight transits between them, are flights whose readings
nobody made up: what a navigator is to be judged by, over a map of *other* lines (`geomag.calibration.calibrate_navigation`). There are
readings only where the survey has some: none in gaps of a line and none on transits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._metres import metres_per_unit
from geomag._ranges import above, at_least
from geomag.survey import Lines

Array = npt.NDArray[np.float64]

#: A transit, or a gap in a line, of more than so long is not flown: the chain ends there.
LONGEST_TRANSIT_S = 500.0
#: A vehicle does not turn on the spot: velocities are means over this long.
TURN_S = 10.0


@dataclass(frozen=True)
class LineFlight:
    """One flight along survey lines: positions in map units, and the readings there.

    Shapes (n,): `time_s`, `x`, `y`, `values` (NaN where the survey has no reading). `lines` has the labels of the lines in the order flown.
    """

    time_s: Array
    x: Array
    y: Array
    values: Array
    lines: tuple[object, ...]
    geographic: bool

    @property
    def reading_share(self) -> float:
        """Share of the steps that have a reading."""
        return float(np.mean(np.isfinite(self.values)))

    @property
    def longest_outage_s(self) -> float:
        """Longest time without a reading."""
        at = self.time_s[np.isfinite(self.values)]
        return float(np.max(np.diff(np.concatenate([self.time_s[:1], at, self.time_s[-1:]]))))

    @property
    def velocity_m_s(self) -> Array:
        """Velocity (east, north), shape (n, 2): the mean over 10 seconds about each step, so that turns take time."""
        return velocity_along(self.time_s, self.x, self.y, geographic=self.geographic)

    @property
    def heading_deg(self) -> Array:
        """Direction of that velocity, clockwise from north."""
        v = self.velocity_m_s
        return np.asarray(np.degrees(np.arctan2(v[:, 0], v[:, 1])), dtype=np.float64)

    def with_sensor(self, rng: np.random.Generator, sensor: FieldSensor) -> Array:
        """Readings as a sensor with errors of its own would give them; NaN stays NaN."""
        return self.values + sensor.draw(self.time_s, rng)


@dataclass(frozen=True)
class FieldSensor:
    """What the sensor of a flight and the field's own changes add to a survey's readings, value units.

    A constant uniform within `bias`, a sinusoid of an amplitude and a period within `swing` and `swing_h` (hours; diurnal change), white noise of `sigma`, and a
    share of `outlier_rate` with a further error of standard deviation `outlier_sigma`.
    """

    bias: float = 50.0
    swing: tuple[float, float] = (3.0, 10.0)
    swing_h: tuple[float, float] = (6.0, 12.0)
    sigma: float = 0.5
    outlier_rate: float = 0.01
    outlier_sigma: float = 100.0

    def draw(self, time_s: Array, rng: np.random.Generator) -> Array:
        """Draw one sensor's errors along a flight."""
        n = time_s.size
        level = rng.uniform(-self.bias, self.bias)
        height, period = rng.uniform(*self.swing), 3600.0 * rng.uniform(*self.swing_h)
        swing = height * np.sin(2 * np.pi * (time_s / period + rng.random()))
        spoilt = (rng.random(n) < self.outlier_rate) * self.outlier_sigma * rng.standard_normal(n)
        return np.asarray(level + swing + self.sigma * rng.standard_normal(n) + spoilt, dtype=np.float64)


def scales_m(y: Array, *, geographic: bool) -> Array:
    """Metres per map unit (east, north) at every y, shape (n, 2); tabulated every hundredth of a degree."""
    if not geographic:
        return np.ones((np.size(y), 2))
    place, inverse = np.unique(np.round(y, 2), return_inverse=True)
    return np.array([metres_per_unit(True, float(p)) for p in place])[inverse]


def steps_m(x: Array, y: Array, *, geographic: bool) -> Array:
    """Displacements (east, north) from each position to the next, metres, shape (n - 1, 2)."""
    return np.column_stack([np.diff(x), np.diff(y)]) * scales_m(0.5 * (y[1:] + y[:-1]), geographic=geographic)


def velocity_along(time_s: Array, x: Array, y: Array, *, geographic: bool, over_s: float = TURN_S) -> Array:
    """Velocity (east, north) along a path, m/s, shape (n, 2): the displacement over `over_s` about each time (less at the ends)."""
    if time_s.size < 2:
        raise TooFewSamplesError(f"path: needed at least 2 positions for a velocity, got {time_s.size}")
    way = np.vstack([[0.0, 0.0], np.cumsum(steps_m(x, y, geographic=geographic), axis=0)])
    least = 0.5 * np.minimum(
        *(np.concatenate([d[:1], d, d[-1:]])[s] for d in [np.diff(time_s)] for s in (np.s_[1:], np.s_[:-1]))
    )
    half = np.maximum(np.minimum(0.5 * over_s, np.minimum(time_s - time_s[0], time_s[-1] - time_s)), least)
    before, after = np.maximum(time_s - half, time_s[0]), np.minimum(time_s + half, time_s[-1])
    moved = np.column_stack([np.interp(after, time_s, w) - np.interp(before, time_s, w) for w in way.T])
    return np.asarray(moved / (after - before)[:, None], dtype=np.float64)


@dataclass(frozen=True)
class _Piece:
    """A stretch of a line without a long gap: positions in metres for distances, and rows of the lines."""

    rows: npt.NDArray[np.int_]
    ends_m: Array


def _pieces(lines: Lines, longest_m: float) -> tuple[list[_Piece], int]:
    """Stretches of the lines that run the way most of the survey does, cut at long gaps; the axis across them."""
    scale = np.array(lines.scale_m())
    place = np.column_stack([lines.x, lines.y]) * scale
    kinds: dict[bool, list[_Piece]] = {True: [], False: []}
    length = {True: 0.0, False: 0.0}
    for rows in lines._rows():
        here = place[rows]
        legs = np.hypot(*np.diff(here, axis=0).T)
        kind = bool(np.ptp(here[:, 0]) >= np.ptp(here[:, 1]))
        for some in np.split(np.arange(rows.size), np.flatnonzero(legs > longest_m) + 1):
            if some.size >= 2:
                kinds[kind].append(_Piece(rows[some], here[some[[0, -1]]]))
        length[kind] += float(legs[legs <= longest_m].sum())
    east = length[True] >= length[False]
    return kinds[east], 1 if east else 0


def _tour(pieces: list[_Piece], across: int, longest_m: float) -> list[list[npt.NDArray[np.int_]]]:
    """Chains of rows: from the outermost piece on always to the nearest end that is left; a chain ends where that is too far."""
    if not pieces:
        return []
    ends = np.array([p.ends_m for p in pieces])
    left = np.ones(len(pieces), dtype=bool)
    chains: list[list[npt.NDArray[np.int_]]] = []
    at: Array | None = None
    while left.any():
        if at is not None:
            away = np.where(left[:, None], np.hypot(*np.moveaxis(ends - at, 2, 0)), np.inf)
            number, side = (int(v) for v in np.unravel_index(np.argmin(away), away.shape))
            if away[number, side] > longest_m:
                at = None
        if at is None:
            outer = np.where(left, ends[:, :, across].min(axis=1), np.inf)
            number, side = int(np.argmin(outer)), 0
            chains.append([])
        rows = pieces[number].rows
        chains[-1].append(rows if side == 0 else rows[::-1])
        at = ends[number, 1 - side]
        left[number] = False
    return chains


def _fly(
    lines: Lines, chain: list[npt.NDArray[np.int_]], step_m: float
) -> tuple[Array, Array, Array, Array, npt.NDArray[np.int_]]:
    """Positions at most a step apart along a chain, its readings about a step apart: x, y, value, distance, row (-1: none)."""
    rows = np.concatenate(chain)
    x, y = lines.x[rows], lines.y[rows]
    legs = np.hypot(*steps_m(x, y, geographic=lines.geographic).T)
    far = np.concatenate([[0.0], np.cumsum(legs)])
    keep = [0]
    for k, d in enumerate(far):
        if d - far[keep[-1]] >= 0.9 * step_m:
            keep.append(k)
    kept = np.array(keep)
    parts = np.maximum(np.ceil(np.diff(far[kept]) / (1.5 * step_m)), 1).astype(int)
    parts = np.where(parts > 1, np.ceil(np.diff(far[kept]) / step_m).astype(int), 1)
    # Where in the list of kept readings every step lies: whole numbers are readings.
    at = np.concatenate([k + np.arange(p) / p for k, p in enumerate(parts)] + [[kept.size - 1.0]])
    whole = at == np.floor(at)
    index = np.arange(kept.size)
    px, py, distance = (np.interp(at, index, c[kept]) for c in (x, y, far))
    row = np.full(at.size, -1)
    row[whole] = rows[kept[at[whole].astype(int)]]
    value = np.where(whole, lines.values[row], np.nan)
    return px, py, value, distance, row


def line_flights(
    lines: Lines,
    *,
    hours: float = 2.0,
    speed_m_s: float = 70.0,
    step_m: float = 100.0,
    most: int = 5,
    longest_transit_s: float = LONGEST_TRANSIT_S,
) -> list[LineFlight]:
    """Chain survey lines into flights of so many hours.

    Lines that run the way most of the survey does are flown one after the other, each from the end that is nearer, with straight transits of at
    most `longest_transit_s`; tie lines are not. As many flights as there are lines for, up to `most`, spread evenly over the survey; no line is
    in two of them. Readings about `step_m` apart are kept, at the positions where they were made; where they are sparser there are steps
    without a reading between them.

    Parameters
    ----------
    lines : the lines to fly, those that are *not* in the map.
    hours : duration of a flight.
    speed_m_s : speed over ground.
    step_m : distance between steps.
    most : greatest number of flights.
    longest_transit_s : longest transit, and longest gap in a line, that is flown.

    Raises `TooFewSamplesError` where no chain is long enough, saying how long the longest is.

    Examples
    --------
    >>> from geomag import synthetic
    >>> from geomag.flights import line_flights
    >>> field = synthetic.Crust().draw((0, 0, 30_000, 20_000), seed=4)
    >>> lines = synthetic.survey(field, line_spacing_m=500.0, tie_spacing_m=5_000.0)
    >>> flights = line_flights(lines, hours=1.0)
    >>> len(flights), len(flights[0].lines), round(flights[0].reading_share, 2)
    (4, 9, 0.99)
    """
    above(0, hours=hours, speed_m_s=speed_m_s, step_m=step_m, longest_transit_s=longest_transit_s)
    at_least(1, most=most)
    longest_m = longest_transit_s * speed_m_s
    if longest_m < step_m:
        raise InvalidInputError(
            f"longest_transit_s: needed at least a step, {step_m / speed_m_s:g} s, got {longest_transit_s:g}"
        )
    pieces, across = _pieces(lines, longest_m)
    need = hours * 3600.0 * speed_m_s
    candidates = []
    longest = 0.0
    for chain in _tour(pieces, across, longest_m):
        px, py, value, distance, row = _fly(lines, chain, step_m)
        longest = max(longest, float(distance[-1]))
        count = int(distance[-1] / need)
        for k in range(count):
            first = np.searchsorted(distance, k * distance[-1] / count)
            last = np.searchsorted(distance, distance[first] + need, side="right")
            some = slice(int(first), int(last))
            labels = lines.line[row[some][row[some] >= 0]]
            order = labels[np.concatenate([[True], labels[1:] != labels[:-1]])] if labels.size else labels
            time = (distance[some] - distance[first]) / speed_m_s
            candidates.append(
                LineFlight(time, px[some], py[some], value[some], tuple(order.tolist()), lines.geographic)
            )
    if not candidates:
        raise TooFewSamplesError(
            f"lines: needed a chain of lines of {hours:g} h at {speed_m_s:g} m/s, got {longest / speed_m_s / 3600:.2f} h"
        )
    picks = np.unique(np.linspace(0, len(candidates) - 1, min(most, len(candidates))).round().astype(int))
    return [candidates[k] for k in picks]
