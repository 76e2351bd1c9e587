"""Grid search and IEMA side by side with what a user would write instead, in one run, answers asserted.

Peers: a parallel Numba loop, scipy.ndimage.map_coordinates, NumPy slices with constant weights, a vectorised NumPy
IEMA step. Times are the best of several; the table holds ratios as well, which carry over between machines.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.ndimage import map_coordinates

import geomag
from geomag.cli.bench import numpy_slices


def best_of(work, seconds=0.5):
    """Least time of at least two runs, repeated for `seconds`: the same patience with everyone."""
    took, answer, spent, runs = np.inf, None, 0.0, 0
    while runs < 2 or spent < seconds:
        start = time.perf_counter()
        answer = work()
        last = time.perf_counter() - start
        took, spent, runs = min(took, last), spent + last, runs + 1
    return took, answer


def rough(side, seed=0):
    return np.random.default_rng(seed).uniform(-100, 100, (side, side))


def numba_surface():
    import numba

    @numba.njit(parallel=True, fastmath=True, cache=False)
    def surface(values, xs, ys, measured, half):
        n = 2 * half + 1
        out = np.empty((n, n))
        for r in numba.prange(n):
            for c in range(n):
                total = 0.0
                for k in range(len(xs)):
                    px, py = xs[k] + (c - half), ys[k] + (r - half)
                    i, j = int(px), int(py)
                    tx, ty = px - i, py - j
                    a = values[j, i] * (1 - tx) + values[j, i + 1] * tx
                    b = values[j + 1, i] * (1 - tx) + values[j + 1, i + 1] * tx
                    d = a * (1 - ty) + b * ty - measured[k]
                    total += d * d
                out[r, c] = total / len(xs)
        return out

    return surface


def scipy_surface(values, xs, ys, measured, half):
    offsets = np.arange(-half, half + 1)
    out = np.zeros((len(offsets), len(offsets)))
    for x, y, v in zip(xs, ys, measured, strict=True):
        grid = np.meshgrid(y + offsets, x + offsets, indexing="ij")
        out += (map_coordinates(values, grid, order=1) - v) ** 2
    return out / len(xs)


def grid_search_table(smoke):
    rows = []
    cases = [(21, 10), (201, 50)] if smoke else [(21, 10), (201, 50), (1001, 100)]
    compiled = numba_surface()
    for side, samples in cases:
        half = side // 2
        values = rough(2 * half + 320)
        k = np.arange(samples)
        xs, ys = half + 10.3 + 2.1 * k, half + 20.7 + 1.3 * k
        for dtype in ("float64", "float32"):
            grid = geomag.GridMap(values.astype(dtype), np.arange(values.shape[1]), np.arange(values.shape[0]))
            measured = grid.sample(xs + 7, ys - 5)
            track = geomag.Track(xs, ys, measured)
            options = {"half_width": half, "surface": True, "refine": False, "min_overlap": 1.0}
            ours, fix = best_of(lambda g=grid, t=track, o=options: geomag.match_grid(g, t, "msd", **o))
            one, _ = best_of(lambda g=grid, t=track, o=options: geomag.match_grid(g, t, "msd", threads=1, **o))
            assert fix.offset == (7.0, -5.0)
            per = 1e9 / (side * side * samples)
            rows.append((f"{side}x{side}x{samples} {dtype}", "geomag", ours, ours * per, 1.0))
            rows.append((f"{side}x{side}x{samples} {dtype}", "geomag, one thread", one, one * per, one / ours))
            alone, best = best_of(
                lambda g=grid, t=track, o=options: geomag.match_grid(g, t, "msd", **o | {"surface": False})
            )
            assert (best.offset, best.score, best.runner_up) == (fix.offset, fix.score, fix.runner_up)
            rows.append((f"{side}x{side}x{samples} {dtype}", "geomag, best two only", alone, alone * per, alone / ours))
            if dtype == "float32":
                continue
            compiled(values, xs, ys, measured, min(half, 2))
            for name, work in (
                ("Numba loop, parallel", compiled),
                ("NumPy slices", numpy_slices),
                ("scipy map_coordinates", scipy_surface),
            ):
                slow = side > 500 and name.startswith("scipy")
                arguments = (
                    values,
                    xs[:10] if slow else xs,
                    ys[:10] if slow else ys,
                    measured[:10] if slow else measured,
                    half,
                )
                took, surface = best_of(lambda w=work, a=arguments: w(*a))
                if slow:  # linear in the samples; the whole takes a minute
                    took *= samples / 10
                else:
                    np.testing.assert_allclose(fix.surface, surface, rtol=1e-9, atol=1e-6)
                rows.append((f"{side}x{side}x{samples} {dtype}", name, took, took * per, took / ours))
    return rows


def iema_table():
    side, half, sigma = 21, 10, 5.0
    values = rough(200)
    grid = geomag.GridMap(values, np.arange(200), np.arange(200))
    k = np.arange(12)
    xs, ys = 80.3 + 1.3 * k, 70.2 + 1.1 * k
    measured = grid.sample(xs + 3, ys - 2)
    offsets = np.arange(-half, half + 1)

    def numpy_run():
        feasible, log_score = np.ones((side, side), bool), np.zeros((side, side))
        for x, y, v in zip(xs, ys, measured, strict=True):
            px, py = x + offsets, y + offsets
            i, j = np.floor(px).astype(int), np.floor(py).astype(int)
            tx, ty = px - i, (py - j)[:, None]
            j = j[:, None]
            lower = values[j, i] * (1 - tx) + values[j, i + 1] * tx
            upper = values[j + 1, i] * (1 - tx) + values[j + 1, i + 1] * tx
            r = lower * (1 - ty) + upper * ty - v
            feasible &= np.abs(r) <= 3 * sigma
            log_score -= 0.5 * (r / sigma) ** 2
            log_score[~feasible] = -np.inf
            rows, columns = np.nonzero(feasible)
            if len(rows) == 0:
                return None
            best = np.unravel_index(np.argmax(log_score), log_score.shape)
            extent = np.ptp(rows), np.ptp(columns)
        return offsets[best[1]], offsets[best[0]], extent

    samples = [(float(a), float(b), float(c)) for a, b, c in zip(xs, ys, measured, strict=True)]

    def our_run():
        iema = geomag.Iema(grid, sigma=sigma, half_width=half)
        for sample in samples:
            step = iema.update(*sample)
        return step

    ours, step = best_of(our_run)
    theirs, answer = best_of(numpy_run)
    assert step.best_offset == (3.0, -2.0) == tuple(map(float, answer[:2]))
    return [
        ("IEMA step 21x21", "geomag", ours / 12, np.nan, 1.0),
        ("IEMA step 21x21", "NumPy, vectorised", theirs / 12, np.nan, theirs / ours),
    ]


def table(smoke=False):
    """Rows of (case, what, seconds, ns per offset and sample, times as long as geomag)."""
    return grid_search_table(smoke) + iema_table()
