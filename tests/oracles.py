"""Slow, plain restatements of the specification in NumPy; they share no code with the package."""

from __future__ import annotations

import itertools
import math

import numpy as np


def bilinear(values, x, y, px, py):
    """Bilinear value at one point of a map with ascending axes; NaN off the map or where a needed node is NaN."""
    dx, dy = (x[-1] - x[0]) / (len(x) - 1), (y[-1] - y[0]) / (len(y) - 1)
    fx, fy = (px - x[0]) / dx, (py - y[0]) / dy
    if abs(fx - round(fx)) < 1e-9:
        fx = float(round(fx))
    if abs(fy - round(fy)) < 1e-9:
        fy = float(round(fy))
    if fx < 0 or fy < 0 or fx > len(x) - 1 or fy > len(y) - 1:
        return math.nan
    i, j = min(int(fx), len(x) - 2), min(int(fy), len(y) - 2)
    tx, ty = fx - i, fy - j
    total = 0.0
    for wy, row in ((1 - ty, j), (ty, j + 1)):
        for wx, col in ((1 - tx, i), (tx, i + 1)):
            if wx * wy != 0.0:
                total += wx * wy * float(values[row, col])
    return total


def lattice(half_width, step):
    """Offsets along one axis: 2 ceil(half/step) + 1 of them, with 0.1 / 0.01 being 10."""
    n = math.ceil(half_width / step - 1e-9 * max(1.0, half_width / step))
    return (np.arange(2 * n + 1) - n) * step


def shifted(values, x, y, xs, ys, ox, oy):
    """Map values under a track shifted by every offset: (rows, columns, samples)."""
    out = np.empty((len(oy), len(ox), len(xs)))
    for r, b in enumerate(oy):
        for c, a in enumerate(ox):
            for k in range(len(xs)):
                out[r, c, k] = bilinear(values, x, y, xs[k] + a, ys[k] + b)
    return out


def posterior(
    values,
    x,
    y,
    track,
    sigma,
    half_width,
    step,
    tolerance,
    *,
    bias,
    headings=(0.0,),
    heading_sigma=1.0,
    drifts=((0.0, 0.0),),
    outliers=None,
):
    """The exact posterior over one fine lattice of offsets with the whole track on the map (metres): normal errors, the bias unknown
    without bound or none.

    `headings` (radians, clockwise about the newest sample) are summed over with a normal prior of `heading_sigma`, `drifts`
    (metres east and north from the first sample to the newest) with equal weights. `outliers`, a share and a size, adds
    errors of plus or minus that size; without bias only. Returns risk, centre (2,) of the mass within the tolerance, covariance
    about it, and the likeliest heading there.
    """
    offsets = lattice(half_width, step)
    east, north = np.meshgrid(offsets, offsets)
    away = np.column_stack([track.x - track.x[-1], track.y - track.y[-1]])
    dx, dy = x[1] - x[0], y[1] - y[0]
    age = np.linspace(1, 0, len(track.x))[:, None]
    logs = []
    for turn, drift in itertools.product(headings, drifts):
        c, s = math.cos(turn), math.sin(turn)
        at = np.column_stack(
            [track.x[-1] + c * away[:, 0] + s * away[:, 1], track.y[-1] + c * away[:, 1] - s * away[:, 0]]
        )
        at += age * np.array(drift)
        mixed, on_map = np.zeros(east.shape), np.ones(east.shape, dtype=bool)
        total, square = np.zeros(east.shape), np.zeros(east.shape)
        for (px, py), v in zip(at, track.values, strict=True):
            fx, fy = (px + east - x[0]) / dx, (py + north - y[0]) / dy
            on_map &= (fx >= 0) & (fx < len(x) - 1) & (fy >= 0) & (fy < len(y) - 1)
            i = np.clip(fx.astype(int), 0, len(x) - 2)
            j = np.clip(fy.astype(int), 0, len(y) - 2)
            u, w = fx - i, fy - j
            low = values[j, i] + u * (values[j, i + 1] - values[j, i])
            high = values[j + 1, i] + u * (values[j + 1, i + 1] - values[j + 1, i])
            error = low + w * (high - low) - v
            total += error
            square += error**2
            if outliers is not None:
                share, size = outliers
                mixed += np.logaddexp(
                    math.log(1 - share) - 0.5 * (error / sigma) ** 2,
                    math.log(share / 2) - 0.5 * ((np.abs(error) - size) / sigma) ** 2,
                )
        log = -0.5 * (square - (total**2 / len(track.x) if bias else 0.0)) / sigma**2
        log = np.where(on_map, log if outliers is None else mixed, -np.inf)
        logs.append(log - 0.5 * (turn / heading_sigma) ** 2)
    logs = np.array(logs)
    p = np.exp(logs - logs.max()).sum(axis=0)
    p /= p.sum()
    row, column = np.unravel_index(np.argmax(p), p.shape)
    centre = np.array([offsets[column], offsets[row]])
    for _ in range(3):
        near = p * (np.hypot(east - centre[0], north - centre[1]) <= tolerance)
        centre = np.array([(near * east).sum(), (near * north).sum()]) / near.sum()
    risk = 1 - p[np.hypot(east - centre[0], north - centre[1]) <= tolerance].sum()
    e = np.stack([east - centre[0], north - centre[1]])
    at = tuple(int(np.argmin(np.abs(offsets - c))) for c in centre[::-1])
    likeliest = headings[int(np.argmax(logs[:, at[0], at[1]])) // len(drifts)]
    return risk, centre, np.einsum("aij,bij,ij->ab", e, e, p), likeliest


def hausdorff(s, a, b, fraction):
    def directed(p, q):
        d = np.sqrt((s[:, None] - s[None, :]) ** 2 + (p[:, None] - q[None, :]) ** 2).min(axis=1)
        return np.sort(d)[max(math.ceil(fraction * len(d) - 1e-9), 1) - 1]

    return max(directed(a, b), directed(b, a))


def weighted_median(r, w):
    order = np.argsort(r, kind="stable")
    r, w = r[order], w[order]
    c = np.cumsum(w)
    half = 0.5 * w.sum()
    i = int(np.searchsorted(c, half))
    if c[i] == half and i + 1 < len(r):
        return 0.5 * (r[i] + r[i + 1])
    return r[i]


def score(criterion, v, m, map_mean, *, w=None, remove_mean=False, s=None, scales=(1.0, 1.0), fraction=1.0, loss=None):
    """One candidate's score from the measured values and the (known) map values."""
    w = np.ones_like(v) if w is None else w
    r = v - m
    if criterion == "msd" and loss is not None:
        if remove_mean:
            r = r - np.median(r)
        return np.average(loss(r), weights=w)
    if criterion == "msd":
        if remove_mean:
            r = r - np.average(r, weights=w)
        return np.average(r**2, weights=w)
    if criterion == "mad":
        if remove_mean:
            r = r - weighted_median(r, w)
        return np.average(np.abs(r), weights=w)
    if criterion == "prod":
        return np.average((v - map_mean) * (m - map_mean), weights=w)
    if criterion == "ncc":
        dv, dm = v - np.average(v, weights=w), m - np.average(m, weights=w)
        return np.sum(w * dv * dm) / np.sqrt(np.sum(w * dv**2) * np.sum(w * dm**2))
    if criterion == "hausdorff":
        return hausdorff(s / scales[0], v / scales[1], m / scales[1], fraction)
    raise AssertionError(criterion)


def harmonic_field(model, north, east, down):
    """Field of a rectangular harmonic model at points (n,) by the specification's formulas, one coefficient after the other."""
    v, w = 2 * np.pi / np.array(model.periods_m)
    c = model.coefficients
    field = np.tile(-c[:3], (len(north), 1))
    for value, (t, r, along_x, along_y) in zip(c[3:], model.terms(model.order), strict=True):
        tv, rw = t * v, r * w
        u = np.hypot(tv, rw)
        level = value * np.exp(u * down)
        sx, cx, sy, cy = np.sin(tv * north), np.cos(tv * north), np.sin(rw * east), np.cos(rw * east)
        x, dx = (sx, tv * cx) if along_x == "sin" else (cx, -tv * sx)
        y, dy = (sy, rw * cy) if along_y == "sin" else (cy, -rw * sy)
        field[:, 0] -= dx * y * level
        field[:, 1] -= x * dy * level
        field[:, 2] -= u * x * y * level
    return field


def harmonic_field_at_once(model):
    """The same at one point (east, north) of the level down = 0, all terms at once and the constants left out: NumPy at its best."""
    c, terms = model.coefficients[3:], model.terms(model.order)
    v, w = 2 * np.pi / np.array(model.periods_m)
    t, r = (np.array([term[k] for term in terms]) * wave for k, wave in ((0, v), (1, w)))
    sine_x, sine_y = (np.array([term[k] == "sin" for term in terms]) for k in (2, 3))
    u = np.hypot(t, r)

    def field(x):
        sx, cx, sy, cy = np.sin(t * x[1]), np.cos(t * x[1]), np.sin(r * x[0]), np.cos(r * x[0])
        fx, dx = np.where(sine_x, sx, cx), np.where(sine_x, t * cx, -t * sx)
        fy, dy = np.where(sine_y, sy, cy), np.where(sine_y, r * cy, -r * sy)
        return -np.array([c @ (dx * fy), c @ (fx * dy), c @ (u * fx * fy)])

    return field


class NaiveIema:
    """The paper's rule on whole matrices, candidate by candidate."""

    def __init__(self, values, x, y, sigma, half_width, step, tolerance=(0.0, 0.0), max_misses=0, drop=False):
        self.map = (values, x, y)
        self.sigma, self.tolerance, self.max_misses, self.drop = sigma, tolerance, max_misses, drop
        self.ox, self.oy = lattice(half_width[0], step[0]), lattice(half_width[1], step[1])
        self.step = step
        shape = (len(self.oy), len(self.ox))
        self.T = np.ones(shape, bool)
        self.logS = np.zeros(shape)
        self.misses = np.zeros(shape, int)
        self.tested = np.zeros(shape, bool)

    def update(self, px, py, value):
        norm = 0.5 * math.log(2 * math.pi)
        for r in range(len(self.oy)):
            for c in range(len(self.ox)):
                if not self.T[r, c]:
                    continue
                m = bilinear(*self.map, px + self.ox[c], py + self.oy[r])
                if math.isnan(m):
                    if self.drop:
                        self.T[r, c] = False
                    else:
                        self.logS[r, c] += -0.5 - norm
                    continue
                z = (m - value) / self.sigma
                if abs(m - value) <= 3 * self.sigma:
                    self.logS[r, c] += -0.5 * z * z - norm
                elif self.misses[r, c] < self.max_misses:
                    self.misses[r, c] += 1
                    self.logS[r, c] += -4.5 - norm
                else:
                    self.T[r, c] = False
                self.tested[r, c] = True
        if not self.T.any():
            return "lost", None, None
        rows, cols = np.nonzero(self.T)
        extent = (np.ptp(cols) * self.step[0], np.ptp(rows) * self.step[1])
        best = np.argmax(np.where(self.T, self.logS, -np.inf))
        r, c = divmod(int(best), len(self.ox))
        done = extent[0] <= self.tolerance[0] + 1e-12 and extent[1] <= self.tolerance[1] + 1e-12 and self.tested[r, c]
        offset = (self.ox[c], self.oy[r]) if self.tested[self.T].any() else (math.nan, math.nan)
        return ("fixed" if done else "searching"), extent, offset
