"""What follows from survey lines alone, made once and asked by everything."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from geomag._errors import TooFewSamplesError
from geomag.survey._lines import Array, Lines, along_m, legs_m

#: Places and values of the samples of one window: x, y, values.
Window = tuple[Array, Array, Array]

#: Samples of one learning window, and the fewest that still make one.
WINDOW = 40
SHORTEST_WINDOW = 20
#: A leg is a gap where it is longer than the line spacing and than so many times what nearly all legs keep to. Lines that were digitised
#: where they cross contours have long legs over quiet stretches, which say as much.
GAP_LEGS = 4.0
NEARLY_ALL = 0.95


@dataclass(frozen=True)
class Survey:
    """Survey lines made ready: stretches that were flown without a break, line spacing, scale, noise, folds.

    A label is cut where its readings stop for longer than `gap_m`, and where the line turns back on itself: so a label that was flown twice
    is two stretches, and no window has a reading in it that nobody made. Distances are in metres.
    """

    lines: Lines

    @cached_property
    def scale_m(self) -> tuple[float, float]:
        """Metres per map unit (east, north) at the middle of the survey."""
        return self.lines.scale_m()

    @cached_property
    def _labels(self) -> list[npt.NDArray[np.int_]]:
        """Rows of every label."""
        return self.lines._rows()

    @cached_property
    def _legs(self) -> list[Array]:
        """Legs of every label, metres."""
        lines = self.lines
        scales = [self._scale_of(rows) for rows in self._labels]
        return [legs_m(lines.x[r], lines.y[r], s) for r, s in zip(self._labels, scales, strict=True)]

    def _scale_of(self, rows: npt.NDArray[np.int_]) -> tuple[float, float]:
        return self.lines._take(rows).scale_m() if self.lines.geographic else (1.0, 1.0)

    @cached_property
    def _spacing_and_gap(self) -> tuple[float, float]:
        legs = np.concatenate(self._legs)
        if not np.any(legs > 0):
            raise TooFewSamplesError("lines: needed lines of at least 2 points each, got single points")
        usual = GAP_LEGS * float(np.quantile(legs[legs > 0], NEARLY_ALL))
        # Gaps count as flown at first, which makes the spacing and with it the least gap too small, not too large.
        gap = np.inf
        for _ in range(3):
            spacing = self._spacing(float(legs[legs <= gap].sum()))
            gap = max(spacing, usual)
        return spacing, gap

    @property
    def spacing_m(self) -> float:
        """Distance between neighbouring lines: the area that they cover over their length."""
        return self._spacing_and_gap[0]

    @property
    def gap_m(self) -> float:
        """Legs longer than this are gaps."""
        return self._spacing_and_gap[1]

    def _spacing(self, length_m: float) -> float:
        lines, (east, north) = self.lines, self.scale_m
        # The area is counted in boxes a few spacings wide, which a line crosses wherever there are lines at all, and which divide
        # the extent evenly, so that none lies half outside.
        position = np.column_stack([(lines.x - lines.x.min()) * east, (lines.y - lines.y.min()) * north])
        extent = np.maximum(position.max(axis=0), 1e-9 * position.max())
        spacing, box = 0.0, float(extent.max()) / 50
        for _ in range(3):
            count = np.ceil(extent / box).astype(int)
            inside = np.minimum((position / extent * count).astype(int), count - 1)
            boxes = np.unique(inside[:, 0] * count[1] + inside[:, 1]).size
            spacing = float(boxes * np.prod(extent / count) / length_m)
            # A single line covers no area of its own: it is taken to stand for boxes as wide as they are long.
            spacing = max(spacing, float(np.sqrt(np.prod(extent / count))) / 50) if np.all(count > 1) else box
            box = 4 * spacing
        return spacing

    @cached_property
    def rows(self) -> list[npt.NDArray[np.int_]]:
        """Rows of every stretch."""
        out = []
        for rows, legs in zip(self._labels, self._legs, strict=True):
            for some in np.split(rows, np.flatnonzero(legs > self.gap_m) + 1):
                out += np.split(some, self._turns(some)) if some.size > 2 else [some]
        return out

    def _turns(self, rows: npt.NDArray[np.int_]) -> list[int]:
        """Where a stretch turns back on itself by more than a gap."""
        scale = self._scale_of(rows)
        place = np.column_stack([self.lines.x[rows] * scale[0], self.lines.y[rows] * scale[1]])
        place -= place.mean(axis=0)
        _, axes = np.linalg.eigh(place.T @ place)
        along = place @ axes[:, 1]
        behind = [float(np.max(np.maximum.accumulate(a) - a)) for a in (along, -along)]
        if min(behind) <= self.gap_m:
            return []
        turns, sense, furthest = [], 0.0, 0
        low = high = 0
        for k, a in enumerate(along):
            if sense == 0.0:
                low, high = (k if a < along[low] else low), (k if a > along[high] else high)
                if along[high] - along[low] > self.gap_m:
                    sense, furthest = (1.0 if high > low else -1.0), k
            elif sense * (a - along[furthest]) >= 0:
                furthest = k
            elif sense * (along[furthest] - a) > self.gap_m:
                turns.append(furthest + 1)
                sense, furthest = -sense, k
        return turns

    @cached_property
    def pieces(self) -> list[Lines]:
        """Stretches that were flown without a break, in the order of their labels."""
        return [self.lines._take(rows) for rows in self.rows]

    @cached_property
    def length_m(self) -> float:
        """Length of all stretches."""
        return float(sum(legs_m(one.x, one.y, one.scale_m()).sum() for one in self.pieces))

    @cached_property
    def noise(self) -> float:
        """Noise of the readings along the lines, robustly: second differences hold little else."""
        second = np.concatenate([np.diff(one.values, 2) for one in self.pieces])
        rounding = np.abs(np.diff(np.unique(np.concatenate([one.values[:200] for one in self.pieces[:50]]))))
        floor = float(rounding[rounding > 0].min()) / np.sqrt(12) if np.any(rounding > 0) else 0.0
        middle = float(np.median(np.abs(second))) if second.size else 0.0
        return float(max(1.4826 * middle / np.sqrt(6), floor, 1e-9))

    def parted(self, folds: int) -> list[tuple[list[Lines], list[Lines]]]:
        """For every fold: the stretches of all other lines, and its own."""
        fold = folds_of(self.pieces, folds)
        sides = [([], []) for _ in range(folds)]  # type: list[tuple[list[Lines], list[Lines]]]
        for one, its in zip(self.pieces, fold, strict=True):
            for k, (kept, left) in enumerate(sides):
                (left if k == its else kept).append(one)
        return sides

    @property
    def labels(self) -> int:
        """Number of labels."""
        return len(self._labels)


def line_spacing_m(lines: Lines) -> float:
    """Distance between neighbouring lines, metres: the area that they cover over the length that was flown."""
    return lines.survey.spacing_m


def folds_of(lines: list[Lines], folds: int) -> npt.NDArray[np.int_]:
    """Fold of every line or stretch: neighbours get different ones, east-west and north-south lines apart.

    Stretches of one label have one fold: where it was flown twice, neither flight may speak for the other.
    """
    _, label = np.unique(np.array([str(one.line[0]) for one in lines]), return_inverse=True)
    first = {int(k): i for i, k in reversed(list(enumerate(label)))}
    groups = [[] for _ in first]  # type: list[list[Lines]]
    for one, k in zip(lines, label, strict=True):
        groups[k].append(one)
    order = sorted(first, key=lambda k: first[k])
    east, north = lines[0].scale_m()
    out = np.zeros(len(groups), dtype=int)

    def extent(k: int, axis: str) -> float:
        return max(float(np.ptp(getattr(one, axis))) for one in groups[k])

    across = np.array([extent(k, "x") * east >= extent(k, "y") * north for k in order])
    where = np.array(
        [
            np.median(np.concatenate([one.y if a else one.x for one in groups[k]]))
            for k, a in zip(order, across, strict=True)
        ]
    )
    for kind in (True, False):
        members = np.flatnonzero(across == kind)
        out[members[np.argsort(where[members], kind="stable")]] = np.arange(members.size) % folds
    of_label = dict(zip(order, out, strict=True))
    return np.array([of_label[int(k)] for k in label], dtype=int)


def windows_of(
    pieces: list[Lines], spacing_m: float, length: int, overlap: float = 0.0, shortest: int = SHORTEST_WINDOW
) -> list[Window]:
    """Equally spaced samples along every stretch: as many windows of `length` as fit, or one shorter of at least `shortest`.

    A window shares `overlap` of its samples with the one before it.
    """
    out = []
    for one in pieces:
        along = along_m(one.x, one.y, one.scale_m())
        total = int(along[-1] / spacing_m) + 1
        step = length if total >= length else total
        if step < min(shortest, length):
            continue
        for start in range(0, total - step + 1, max(1, round(step * (1 - overlap)))):
            at = spacing_m * (start + np.arange(step))
            out.append((np.interp(at, along, one.x), np.interp(at, along, one.y), np.interp(at, along, one.values)))
    return out
