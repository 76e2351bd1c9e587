"""E2: how many samples IEMA needs, section 2.2 of the paper: 99 % of 500 trials need 11 or fewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomag.reproduce import Context, Report, Table
from geomag.reproduce._iema import Outcome, draw, load_map, run_iema, straight

SIGMA = 0.5
PUBLISHED = (1, 2, 11, 20, 49, 70, 63, 23, 50, 117, 89, 4, 0, 1, 0)


def run(context: Context) -> Report:
    """Distribution of the sequence length on one track and on random tracks, INS error on and off the lattice."""
    grid = load_map(context, 400)
    rng = np.random.default_rng(context.seed)
    n = context.trials(500)
    one = straight(rng, grid, 40)
    cases: dict[str, list[Outcome]] = {}
    for on_grid in (True, False):
        where = "on the lattice" if on_grid else "anywhere"
        for single in (True, False):
            truth = one if single else None
            label = f"{'one track' if single else 'random tracks'}, INS error {where}"
            cases[label] = [
                run_iema(grid, draw(rng, grid, 40, SIGMA, on_grid=on_grid, truth=truth), SIGMA) for _ in range(n)
            ]
    counts: list[tuple[object, ...]] = [("published (one track by its two humps)", *PUBLISHED, "")]
    summary: list[tuple[object, ...]] = [("published", 500, "", "not counted", "", "", "", 11)]
    for label, ends in cases.items():
        fixed = [e for e in ends if e.status == "fixed"]
        lengths = np.array([e.samples for e in fixed] or [0])
        counts.append((label, *(int((lengths == k).sum()) for k in range(1, 16)), int((lengths > 15).sum())))
        summary.append(
            (
                label,
                n,
                len(fixed),
                sum(e.error_cells > 1.0 for e in fixed),
                sum(e.status == "lost" for e in ends),
                sum(e.status == "searching" for e in ends),
                float(np.median(lengths)),
                float(np.quantile(lengths, 0.99)),
            )
        )
    return Report(
        "E2",
        {
            "map": "EMM2017 total intensity 116.0-119.99 E, 31.0-34.99 N, 0.01 degree",
            "sigma": "0.5 nT",
            "trials": n,
            "samples": "up to 40",
            "seed": context.seed,
        },
        [
            Table("Trials by sequence length", ("case", *(str(k) for k in range(1, 16)), "more"), counts),
            Table(
                "How they end",
                ("case", "trials", "fixed", "wrong by more than one cell", "lost", "open at 40", "median", "99 %"),
                summary,
            ),
        ],
        [_picture(context, cases)],
        [
            f"Right counts are not published. In this run {_wrong(cases, 'on the lattice')} fixes are wrong with the INS error on "
            f"the lattice, {_wrong(cases, 'anywhere')} with it anywhere; `match_posterior` declares such a risk (see the guide on "
            "calibrated matching)."
        ],
    )


def _wrong(cases: dict[str, list[Outcome]], where: str) -> str:
    """Share of the fixes more than one cell off, over the cases of one kind of INS error."""
    fixed = [e for label, ends in cases.items() if label.endswith(where) for e in ends if e.status == "fixed"]
    return f"{sum(e.error_cells > 1.0 for e in fixed) / len(fixed):.1%} of {len(fixed)}" if fixed else "none of 0"


def _picture(context: Context, cases: dict[str, list[Outcome]]) -> Path:
    from geomag.plot import COLOURS, style
    from geomag.plot._style import new_figure

    with style():
        figure = new_figure(9.0, 6.0)
        axes = figure.subplots(2, 2, sharex=True)
        for ax, (label, ends) in zip(axes.flat, cases.items(), strict=True):
            bins = np.arange(0.5, 41.5)
            right = [e.samples for e in ends if e.status == "fixed" and e.error_cells <= 1.0]
            wrong = [e.samples for e in ends if e.status == "fixed" and e.error_cells > 1.0]
            ax.hist(
                [right, wrong],
                bins,
                stacked=True,
                label=["right", "wrong"],
                color=[COLOURS["matched"], COLOURS["indicated"]],
            )
            ax.set_title(label, fontsize=9)
            ax.set_ylabel("trials")
        for ax in axes[-1]:
            ax.set_xlabel("samples until a single candidate is left")
        axes.flat[0].legend()
    return context.save(figure, "e2_lengths")
