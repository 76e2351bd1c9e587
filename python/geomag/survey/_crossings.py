"""Where lines cross: the same place read twice, which tells what levels and positions of a survey are worth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from geomag.survey._lines import Array, Lines, legs_m

#: Pairs of lines that are looked at; more change the median by less than its error.
MOST_PAIRS = 4000
#: A crossing in a stretch longer than so many typical legs lies in a gap.
GAP_LEGS = 4.0


def _ordered(one: Lines, east: bool) -> tuple[Array, Array, Array, float]:
    """Positions along and across the way a line runs, and its values, ascending; the longest leg that is no gap, map units."""
    along, across = (one.x, one.y) if east else (one.y, one.x)
    order = np.argsort(along, kind="stable")
    along, across, values = along[order], across[order], one.values[order]
    return along, across, values, GAP_LEGS * float(np.median(np.diff(along)))


def crossings(pieces: list[Lines], rng: np.random.Generator) -> tuple[Array, npt.NDArray[np.int_]]:
    """Differences of two lines' readings where they cross (value units), and the two lines, shape (n, 2): those that run east-west, and north-south."""
    scale = pieces[0].scale_m()
    kinds: npt.NDArray[np.bool_] = np.array([np.ptp(p.x) * scale[0] >= np.ptp(p.y) * scale[1] for p in pieces])
    long = np.array([p.x.size >= 3 and legs_m(p.x, p.y, scale).sum() > 0 for p in pieces])
    box = np.array([(p.x.min(), p.x.max(), p.y.min(), p.y.max()) for p in pieces])
    first, second = (np.flatnonzero((kinds == kind) & long) for kind in (True, False))
    if first.size == 0 or second.size == 0:
        return np.zeros(0), np.zeros((0, 2), dtype=int)
    meet = (
        (box[first, None, 0] <= box[None, second, 1])
        & (box[first, None, 1] >= box[None, second, 0])
        & (box[first, None, 2] <= box[None, second, 3])
        & (box[first, None, 3] >= box[None, second, 2])
    )
    pairs = np.argwhere(meet)
    if len(pairs) > MOST_PAIRS:
        pairs = pairs[np.sort(rng.choice(len(pairs), MOST_PAIRS, replace=False))]
    ordered = {int(k): _ordered(pieces[k], bool(kinds[k])) for k in np.unique(np.concatenate([first, second]))}
    out, who = [], []
    for i, j in pairs:
        ax, ay, av, a_gap = ordered[int(first[i])]
        by, bx, bv, b_gap = ordered[int(second[j])]
        y = float(np.median(ay))
        x = float(np.interp(y, by, bx))
        for _ in range(6):
            y = float(np.interp(x, ax, ay))
            x = float(np.interp(y, by, bx))
        if not (ax[0] <= x <= ax[-1] and by[0] <= y <= by[-1]):
            continue
        a, b = int(np.searchsorted(ax, x)), int(np.searchsorted(by, y))
        if a and b and ax[a] - ax[a - 1] <= a_gap and by[b] - by[b - 1] <= b_gap:
            out.append(float(np.interp(x, ax, av) - np.interp(y, by, bv)))
            who.append((int(first[i]), int(second[j])))
    return np.array(out), np.array(who, dtype=int).reshape(-1, 2)


def misfit_of(differences: Array, who: npt.NDArray[np.int_]) -> float:
    """Standard deviation of one reading at a crossing, robustly, once every line's own level is taken out; NaN for fewer than 20 crossings.

    Levels of lines are taken out by medians in turn (Tukey's polish): what a constant of the sensor takes is no misfit of the map.
    """
    if differences.size < 20:
        return float("nan")
    left = differences.copy()
    labels = [np.unique(column, return_inverse=True)[1] for column in who.T]
    spare = 0
    for turn in range(4):
        for label in labels:
            order = np.argsort(label, kind="stable")
            groups = np.split(order, np.cumsum(np.bincount(label))[:-1])
            for rows in groups:
                # A line with fewer crossings would be fitted, not levelled.
                if rows.size >= 4:
                    left[rows] -= np.median(left[rows])
                    spare += turn == 0
    lost = max(1.0 - spare / left.size, 0.25)
    return float(1.4826 * np.median(np.abs(left)) / np.sqrt(2 * lost))
