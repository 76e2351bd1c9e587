"""E1: IEMA's correctness, section 2.1 of the paper: a single feasible solution after six samples, on the true track."""

from __future__ import annotations

import numpy as np

from geomag._geomag import Iema
from geomag.reproduce import Context, Report, Table
from geomag.reproduce._iema import HALF_WIDTH, draw, load_map, run_iema

SIGMA = 1.0
PUBLISHED_SAMPLES = 6


def run(context: Context) -> Report:
    """One track drawn as the paper's with its picture, and the same over many tracks."""
    from geomag.plot import Frame, match_figure

    grid = load_map(context, 200)
    rng = np.random.default_rng(context.seed)
    trial = draw(rng, grid, 40, SIGMA, on_grid=True)
    iema = Iema(grid, sigma=SIGMA, half_width=HALF_WIDTH)
    frames, rows = [], []
    for k in range(len(trial.readings)):
        step = trial.feed(iema, k)
        frames.append(Frame(step.n_samples, iema.feasible, *iema.offsets))
        rows.append((step.n_samples, step.n_feasible, step.extent[0], step.extent[1]))
        if step.status != "searching":
            break
    used = step.n_samples
    track = trial.track(used)
    fix = iema.run(track)
    error = np.abs(np.asarray(fix.offset) - trial.offset).max() / 0.01
    picture = context.save(match_figure(grid, track, fix, truth=trial.truth[:used], steps=frames), "e1_iema")

    n = context.trials(500)
    table = []
    for label, on_grid in (
        ("INS error on the lattice, as in the paper", True),
        ("INS error anywhere, as in life", False),
    ):
        ends = [run_iema(grid, draw(rng, grid, 40, SIGMA, on_grid=on_grid), SIGMA) for _ in range(n)]
        fixed = [e for e in ends if e.status == "fixed"]
        wrong = sum(e.error_cells > 1.0 for e in fixed)
        lost = sum(e.status == "lost" for e in ends)
        lengths = [e.samples for e in fixed] or [0]
        table.append((label, n, len(fixed), wrong, lost, float(np.median(lengths)), float(np.quantile(lengths, 0.99))))
    return Report(
        "E1",
        {
            "map": "EMM2017 total intensity 116.0-117.99 E, 31.0-32.99 N, 0.01 degree",
            "sigma": "1 nT",
            "INS error": "uniform in +-0.1 degree, constant",
            "track": "straight, 1 to 3 cells a sample",
            "seed": context.seed,
        },
        [
            Table(
                "One track",
                ("", "samples to a single feasible solution", "error, cells"),
                (("published", PUBLISHED_SAMPLES, "on the true track"), ("here", used, float(error))),
            ),
            Table("Feasible set, sample by sample", ("samples", "feasible", "extent x, deg", "extent y, deg"), rows),
            Table(
                "Many random tracks",
                ("INS error", "trials", "fixed", "wrong by more than one cell", "lost", "length: median", "99 %"),
                table,
            ),
        ],
        [picture],
        [
            "The paper's claim holds where the INS error is a whole number of cells. Off the lattice the gate throws the "
            "right cell out: it knows the sensor's noise and not the map's change within half a cell."
        ],
    )
