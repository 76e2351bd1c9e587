"""`geomag bench`: the side-by-side table on this machine."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from geomag._geomag import GridMap, Track, instruction_set, match_grid
from geomag.cli import app

Array = NDArray[np.float64]


def best_of(repeats: int, work: Callable[[], Any]) -> tuple[float, Any]:
    """Least of several times, and the answer."""
    took, answer = float("inf"), None
    for _ in range(repeats):
        start = time.perf_counter()
        answer = work()
        took = min(took, time.perf_counter() - start)
    return took, answer


def numpy_slices(values: Array, xs: Array, ys: Array, measured: Array, half: int) -> Array:
    """The same surface in NumPy, with the same trick: constant weights over slices of the map."""
    n = 2 * half + 1
    out = np.zeros((n, n))
    for x, y, v in zip(xs, ys, measured, strict=True):
        i, j, tx, ty = int(x) - half, int(y) - half, x - int(x), y - int(y)
        block = values[j : j + n + 1, i : i + n + 1]
        rows = block[:, :-1] * (1 - tx) + block[:, 1:] * tx
        out += (rows[:-1] * (1 - ty) + rows[1:] * ty - v) ** 2
    return np.asarray(out / len(xs))


@app.command(epilog="Example: geomag bench --quick")
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="Small cases only.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")] = False,
) -> int:
    """Time grid search beside NumPy in one run, answers compared; `make bench` has the whole table."""
    if not as_json:
        typer.echo(f"{instruction_set}; best times; ratio = times as long as geomag on all cores")
        typer.echo(f"{'offsets x samples':<20} {'what':<22} {'ms':>10} {'ns each':>9} {'ratio':>7}")
    table: list[dict[str, object]] = []
    for side, samples in ((21, 10), (201, 50)) if quick else ((21, 10), (201, 50), (1001, 100)):
        half = side // 2
        values = np.random.default_rng(0).uniform(-100, 100, (2 * half + 320, 2 * half + 320))
        k = np.arange(samples)
        xs, ys = (np.asarray(half + a + b * k, dtype=np.float64) for a, b in ((10.3, 2.1), (20.7, 1.3)))
        rows: list[tuple[str, float]] = []
        for kind in ("float64", "float32"):
            grid = GridMap(values.astype(kind), np.arange(len(values)), np.arange(len(values)))
            measured = grid.sample(xs + 7, ys - 5)
            track = Track(xs, ys, measured)
            search = partial(match_grid, grid, track, half_width=half, surface=True, refine=False, min_overlap=1.0)
            took, fix = best_of(5, search)
            rows.append((f"geomag {kind}", took))
            rows.append((f"geomag {kind}, one thread", best_of(5, partial(search, threads=1))[0]))
            if kind == "float64":
                took, surface = best_of(2, partial(numpy_slices, values, xs, ys, np.asarray(measured), half))
                np.testing.assert_allclose(fix.surface, surface, rtol=1e-9, atol=1e-6)
                rows.append(("NumPy slices", took))
        for what, took in rows:
            each = 1e9 * took / (side * side * samples)
            size = f"{side}x{side} x {samples}"
            ratio = took / rows[0][1]
            table.append({"case": size, "what": what, "seconds": took, "nanoseconds_each": each, "ratio": ratio})
            if as_json:
                continue
            typer.echo(f"{size:<20} {what:<22} {1e3 * took:>10.3f} {each:>9.3f} {ratio:>7.1f}")
    if as_json:
        typer.echo(json.dumps({"instruction_set": instruction_set, "rows": table}))
    return 0
