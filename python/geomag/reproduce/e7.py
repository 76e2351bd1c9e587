"""E7: the paper's ship on a harmonic field [RHA-UKF], and where 2 m is possible, beside the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from geomag._defaults import default_of
from geomag._geomag import FieldNavigator, GridMap, RectangularHarmonicModel
from geomag._statistics import normalised_squares
from geomag.reproduce import Context, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPEED_M_S = 4 * 1853 / 3600
COURSE_DEG = 60.0
STEPS = 100
SETTLED = 20
# x east, y north; the paper's pairs are (theta, lambda), north first.
TRUE_START = np.array([100.0, 45.0])
FILTER_START = (97.0, 48.0)
P0 = 2.0
R = 10.0
SIGMA_NT = 3.0
GRADIENTS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 3.0, 10.0)
PAPER_Q, SANE_Q = 10.0, 0.01
PERIOD_M = 1000.0
ORDER = 10


def wavy_field(rng: np.random.Generator, gradient_nt_m: float) -> RectangularHarmonicModel:
    """Harmonic field of 100 to 500 m wavelengths with a given rms horizontal gradient of each component."""
    coefficients = [0.0, 0.0, 0.0]
    for t, r, _, _ in RectangularHarmonicModel.terms(ORDER):
        u = 2 * np.pi * np.hypot(t, r) / PERIOD_M
        long_enough = PERIOD_M / 500 <= np.hypot(t, r) <= PERIOD_M / 100
        coefficients.append(rng.normal() / u**2 if long_enough else 0.0)
    region = [(-600.0, 600.0), (-600.0, 600.0), (-10.0, 0.0)]
    north = np.linspace(-500.0, 500.0, 41)
    grid = np.stack(np.meshgrid(north, north, indexing="ij"), axis=-1).reshape(-1, 2)
    model = RectangularHarmonicModel.from_coefficients(ORDER, PERIOD_M, coefficients, region=region)
    gradient = model.gradient(grid[:, 0], grid[:, 1], 0.0)[:, :, :2]
    # Mean square over components and horizontal directions.
    scale = gradient_nt_m / np.sqrt(np.mean(gradient**2))
    return RectangularHarmonicModel.from_coefficients(ORDER, PERIOD_M, scale * np.array(coefficients), region=region)


@dataclass(frozen=True)
class Sail:
    """One run: estimated minus true (east, north), declared standard deviations, normalised errors, the path."""

    error_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    normalised: NDArray[np.float64]
    truth: NDArray[np.float64]
    estimated: NDArray[np.float64]

    @property
    def distance_m(self) -> NDArray[np.float64]:
        """Length of the error at every step."""
        return np.hypot(self.error_m[:, 0], self.error_m[:, 1])


def course_unit() -> NDArray[np.float64]:
    """East and north of a metre along the course."""
    course = np.radians(COURSE_DEG)
    return np.array([np.sin(course), np.cos(course)])


def sail(
    model: RectangularHarmonicModel,
    rng: np.random.Generator,
    *,
    q: float,
    true_q: float,
    sigma: float,
    start: tuple[float, float],
    alpha: float = default_of(FieldNavigator, "alpha"),
) -> Sail:
    """Sail 100 s; `q` is what the filter believes of the motion, `true_q` what the ship does (both m^2 a second)."""
    navigator = FieldNavigator(
        model,
        start=start,
        covariance_m2=P0,
        reading_sigma=sigma,
        position_noise_m2_s=q,
        gate=None,
        alpha=alpha,
    )
    moves = SPEED_M_S * course_unit() + np.sqrt(true_q) * rng.normal(size=(STEPS, 2))
    truth = TRUE_START + np.cumsum(moves, axis=0)
    readings = model.field(truth[:, 1], truth[:, 0], 0.0, extrapolate=True) + sigma * rng.normal(size=(STEPS, 3))
    steps = [navigator.step(1.0, SPEED_M_S, COURSE_DEG, reading) for reading in readings]
    estimated = np.array([(s.x, s.y) for s in steps])
    covariance = np.array([s.covariance_m2 for s in steps])
    error = estimated - truth
    normalised = normalised_squares(error, covariance)
    sigmas = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return Sail(error, sigmas, normalised, truth, estimated)


def bound_m(model: RectangularHarmonicModel, q: float, sigma: float) -> float:
    """Cramer-Rao bound of the rms error after settling, along the undisturbed path."""
    navigator = FieldNavigator(
        model, start=tuple(TRUE_START), covariance_m2=P0, reading_sigma=sigma, position_noise_m2_s=q, gate=None
    )
    path = TRUE_START + SPEED_M_S * course_unit() * np.arange(1, STEPS + 1)[:, None]
    bound = navigator.bound(path, 1.0, SPEED_M_S, COURSE_DEG)
    return float(np.sqrt(np.trace(bound, axis1=1, axis2=2)[SETTLED:].mean()))


def sweep(
    context: Context, q: float, true_q: float, alpha: float = default_of(FieldNavigator, "alpha")
) -> list[tuple[object, ...]]:
    """Error, bound and consistency over gradients."""
    rows: list[tuple[object, ...]] = []
    trials = context.trials(100)
    for gradient in GRADIENTS:
        errors, largest, normalised, bounds = [], [], [], []
        for trial in range(trials):
            rng = np.random.default_rng([context.seed, trial])
            model = wavy_field(rng, gradient)
            start = tuple(TRUE_START + np.sqrt(P0) * rng.normal(size=2))
            run = sail(model, rng, q=q, true_q=true_q, sigma=SIGMA_NT, start=start, alpha=alpha)
            errors.append(np.mean(run.distance_m[SETTLED:] ** 2))
            largest.append(run.distance_m[SETTLED:].max())
            normalised.append(run.normalised[SETTLED:].mean())
            bounds.append(bound_m(model, q, SIGMA_NT) ** 2)
        under = 100.0 * np.mean(np.array(largest) < 2.0)
        rows.append(
            (
                gradient,
                float(np.sqrt(np.mean(errors))),
                float(np.sqrt(np.mean(bounds))),
                float(under),
                float(np.mean(normalised)),
                float(np.median(normalised)),
            )
        )
    return rows


def _papers_run(context: Context) -> tuple[list[tuple[object, ...]], list[Path]]:
    """The paper's settings on a field steep enough for its claim, with pictures."""
    from geomag.plot import filter_errors

    rng = np.random.default_rng(context.seed)
    model = wavy_field(rng, 3.0)
    rows: list[tuple[object, ...]] = []
    pictures: list[Path] = []
    for label, q in (("Q = 10, as in the paper", PAPER_Q), ("Q = 0.01", SANE_Q)):
        run = sail(
            model, np.random.default_rng(context.seed + 1), q=q, true_q=0.0, sigma=float(np.sqrt(R)), start=FILTER_START
        )
        settled = run.distance_m[SETTLED:]
        rows.append((label, float(np.sqrt(np.mean(settled**2))), float(settled.max()), "not above 2 m"))
        name = "paper" if q == PAPER_Q else "sane"
        figure = filter_errors(
            np.arange(1.0, STEPS + 1),
            run.error_m[:, ::-1],
            run.sigma_m[:, ::-1],
            names=("north", "east"),
            title=f"3 nT/m, {label}",
        )
        pictures += [
            context.save(figure, f"e7_errors_{name}"),
            context.save(_track_figure(model, run, label), f"e7_track_{name}"),
        ]
    return rows, pictures


def _track_figure(model: RectangularHarmonicModel, run: Sail, label: str) -> Figure:
    from geomag.plot import COLOURS, field_map, style, tracks

    both = np.concatenate([run.truth, run.estimated])
    low, high = both.min(axis=0) - 20.0, both.max(axis=0) + 20.0
    east, north = np.linspace(low[0], high[0], 160), np.linspace(low[1], high[1], 160)
    down = model.field_grid(north, east, 0.0, extrapolate=True)[:, :, 2]
    field = GridMap(down, east, north, name="downward component", units="nT")
    axes = field_map(field, title=f"3 nT/m, {label}")
    tracks(axes, true=run.truth, matched=run.estimated, legend=False)
    with style():
        axes.plot(*FILTER_START, marker="s", color=COLOURS["accent"], ls="none", label="start", zorder=7)
        handles, _ = axes.get_legend_handles_labels()
        axes.legend(handles, ("true track", "filter", "filter's start"), loc="upper left")
    return cast("Figure", axes.figure)


def _gradient_figure(tables: dict[str, list[tuple[object, ...]]]) -> Figure:
    from geomag.plot import COLOURS, style
    from geomag.plot._style import new_figure

    with style():
        figure = new_figure(6.4, 4.2)
        axes = figure.add_subplot()
        for name, mark, (label, rows) in zip(("indicated", "matched"), "so", tables.items(), strict=True):
            values = np.array([[float(v) for v in row[:3]] for row in rows])  # type: ignore[arg-type]
            axes.loglog(values[:, 0], values[:, 1], color=COLOURS[name], marker=mark, label=f"{label}: filter")
            axes.loglog(
                values[:, 0], values[:, 2], color=COLOURS[name], ls="--", lw=1.0, label=f"{label}: Cramer-Rao bound"
            )
        axes.axhline(2.0, color=COLOURS["true"], lw=0.8, label="the paper's 2 m")
        axes.axvspan(0.01, 0.1, color=COLOURS["neutral"], alpha=0.15, lw=0, label="crustal gradients, 10 to 100 nT/km")
        axes.set_xlabel("rms horizontal gradient of a component (nT/m)")
        axes.set_ylabel("rms position error (m)")
        axes.grid(True)
        axes.legend()
    return figure


def run(context: Context) -> Report:
    """The paper's run, then the error and its bound over gradients with the paper's Q and with a sane one."""
    papers, pictures = _papers_run(context)
    columns = (
        "gradient, nT/m",
        "error, m rms",
        "Cramer-Rao bound, m rms",
        "maximum under 2 m, % of seeds",
        "normalised error, mean (2 is right)",
        "median of seeds",
    )
    paper, sane = sweep(context, PAPER_Q, PAPER_Q), sweep(context, SANE_Q, SANE_Q)
    calm = sweep(context, PAPER_Q, 0.0)
    tight = sweep(context, PAPER_Q, PAPER_Q, alpha=1e-3)
    pictures.append(context.save(_gradient_figure({"Q = 10": paper, "Q = 0.01": sane}), "e7_gradients"))
    reaches = [row[0] for row in sane if float(row[3]) >= 95.0]  # type: ignore[arg-type]
    least = f"{min(reaches):g} nT/m" if reaches else "no gradient tried"  # type: ignore[type-var]
    return Report(
        "E7",
        {
            "field": "harmonic, wavelengths 100 to 500 m, the same rms gradient in every component",
            "run": "100 s, 1 s a step, 4 knots of 1853 m, course 60 degrees",
            "sensor": f"three components, {SIGMA_NT:g} nT each (the paper's R = 10 in its own run)",
            "start": "P0 = diag(2, 2); drawn from it in the sweeps",
            "errors": f"after {SETTLED} s",
            "trials": context.trials(100),
            "seed": context.seed,
        },
        [
            Table(
                "The paper's start, P0 and R on a field of 3 nT/m", ("", "rms, m", "maximum, m", "published"), papers
            ),
            Table("Q = 10 (m^2 a step) in ship and filter, as in the paper", columns, paper),
            Table("Q = 0.01 in ship and filter", columns, sane),
            Table("Q = 10 in the filter, a ship that keeps its course", columns, calm),
            Table("Q = 10 in ship and filter, alpha = 1e-3: sigma points next to each other", columns, tight),
        ],
        pictures,
        [
            f"A maximum under 2 m is had in at least 95 % of seeds from {least} on with Q = 0.01, and with the paper's "
            "Q = 10 at none of these gradients: the motion alone adds 4.5 m a second to what the field has to take back.",
            "alpha = 1e-3 samples the slope at one point: its declared covariance is too small where the field bends within "
            f"the error (normalised error {float(str(tight[-1][4])):.1f} against {float(str(paper[-1][4])):.1f} at "
            f"{GRADIENTS[-1]:g} nT/m).",
            "At crustal gradients, 0.01 to 0.1 nT/m, nothing can hold a ship to 2 m in 100 s with 3 nT of noise: that is "
            "the bound, not the filter. Only gradient over noise counts.",
        ],
    )
