"""E6: sliding-window ICCP for gravity [ICCP-G]: fix interval, error, what averaging and the second reduction gain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._geomag import GridMap, SlidingContour
from geomag._optional import require
from geomag.io import read_grid
from geomag.reduction import GravityReduction, match_with_reduction
from geomag.reproduce import Context, Report, Table, _gravity_loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPEED_KN = 12.0
INTERVAL_S = 300.0
WINDOW = 20
SAMPLES = 60
DRIFT_M_H = 1852.0
SIGMA_MGAL = 1.0
#: Hours since the INS was last right when the track begins: chosen, and varied.
HOURS = (1.0, 3.0, 6.0)


@dataclass(frozen=True)
class Leg:
    """A ship's leg: where it is, where its INS says, what its gravimeter reads."""

    truth: Floats
    indicated: Floats
    time_s: Floats
    raw: Floats
    anomaly: Floats


def gravity_map(context: Context) -> GridMap:
    """EIGEN-6C4 over the South China Sea at one arc minute, by cubic spline of the 10 minute grid."""
    interpolate = require("scipy.interpolate", "survey", "refining the map")
    coarse = read_grid(context.file("eigen6c4-gravity/eigen6c4_south_china_sea_105_125E_5_25N.nc"))
    spline = interpolate.RectBivariateSpline(coarse.y, coarse.x, np.asarray(coarse.values, dtype=float))
    x = np.linspace(coarse.x[0], coarse.x[-1], 10 * (len(coarse.x) - 1) + 1)
    y = np.linspace(coarse.y[0], coarse.y[-1], 10 * (len(coarse.y) - 1) + 1)
    return GridMap(spline(y, x), x, y, geographic=True, units="mGal")


def sail(grid: GridMap, rng: np.random.Generator, hours: float) -> Leg:
    """A straight leg anywhere on the map; the INS drifts one nautical mile an hour in one direction."""
    gravity = GravityReduction()
    course = rng.uniform(0, 2 * np.pi)
    start = np.array([rng.uniform(grid.x[0] + 2, grid.x[-1] - 2), rng.uniform(grid.y[0] + 2, grid.y[-1] - 2)])
    time_s = INTERVAL_S * np.arange(float(SAMPLES))
    scale = np.array(grid.metres_per_unit(start[1]))
    ahead = np.array([np.sin(course), np.cos(course)])
    truth = start + (SPEED_KN * 1852.0 / 3600.0 * time_s)[:, None] * ahead / scale
    away = rng.uniform(0, 2 * np.pi)
    drift = DRIFT_M_H * (hours + time_s / 3600.0)
    indicated = truth + drift[:, None] * np.array([np.sin(away), np.cos(away)]) / scale
    field = grid.sample(truth[:, 0], truth[:, 1], interpolation="bicubic") + SIGMA_MGAL * rng.normal(size=SAMPLES)
    raw = field - gravity.correction(truth[:, 0], truth[:, 1], time_s)
    return Leg(truth, indicated, time_s, raw, field)


def metres(grid: GridMap, a: Floats, b: Floats) -> float:
    """Distance between two points in degrees."""
    return float(np.hypot(*((a - b) * np.array(grid.metres_per_unit(float(b[1]))))))


def options(hours: float) -> dict[str, dict[str, Any]]:
    """ICCP to the letter, and the recommended settings for this INS."""
    error = DRIFT_M_H * (hours + SAMPLES * INTERVAL_S / 3600.0)
    sigma = error / np.sqrt(2.0)
    speed = DRIFT_M_H / (SPEED_KN * 1852.0)
    return {
        "rigid, to the letter": {"transform": "rigid", "radius_m": 3 * error},
        "translation": {"transform": "translation", "radius_m": 3 * error},
        # A drift of one knot in any direction turns and stretches a 12 knot track by up to 1 / 12, and its Eotvos
        # correction is wrong by up to 7.5 mGal: the bias.
        "recommended": {
            "transform": "translation", "radius_m": 3 * error, "refine": True, "sigma": SIGMA_MGAL,
            "offset_sigma_m": sigma, "heading_sigma_deg": float(np.degrees(speed / np.sqrt(2))),
            "scale_sigma": speed / np.sqrt(2), "bias_sigma": 5.0, "starts": "grid",
        },
    }  # fmt: skip


def reduced(leg: Leg, at: Floats) -> Floats:
    """Anomalies as one believes them to be at positions `at`."""
    return leg.raw + GravityReduction().correction(at[:, 0], at[:, 1], leg.time_s)


def follow(grid: GridMap, leg: Leg, values: Floats | None, settings: dict[str, Any]) -> dict[str, list[float]]:
    """Slide along a leg. Without `values` each reading is reduced where the last fix puts it."""
    window = SlidingContour(grid, length=WINDOW, **settings)
    gravity = GravityReduction()
    offset = np.zeros(2)
    out: dict[str, list[float]] = {"newest": [], "delayed": [], "single": [], "track": []}
    estimates: dict[int, list[float]] = {}
    for k in range(SAMPLES):
        x, y = leg.indicated[k]
        if values is None:
            behind = max(0, k - 1)
            pair = leg.indicated[behind : k + 1] + offset
            at = leg.time_s[behind : k + 1]
            correction = (
                gravity.correction(pair[:, 0], pair[:, 1], at)[-1] if k else reduced(leg, leg.indicated)[0] - leg.raw[0]
            )
            value = leg.raw[k] + correction
        else:
            value = values[k]
        fix = window.update(x, y, float(value))
        if np.isfinite(fix.x):
            offset = np.array(fix.offset)
            out["newest"].append(metres(grid, np.array([fix.x, fix.y]), leg.truth[k]))
            for i, point in enumerate(fix.track):
                number = k - WINDOW + 1 + i
                estimates.setdefault(number, []).append(metres(grid, point, leg.truth[number]))
        out["track"].append(metres(grid, leg.indicated[k] + offset, leg.truth[k]))
        settled = window.settled
        if settled is not None and settled["estimates"] == WINDOW:
            number = settled["number"]
            out["delayed"].append(metres(grid, np.array([settled["x"], settled["y"]]), leg.truth[number]))
            out["single"].append(float(np.median(estimates[number])))
    return out


def batches(grid: GridMap, leg: Leg, settings: dict[str, Any], passes: int) -> dict[str, list[float]]:
    """A fix every `WINDOW` samples, the INS carried on with its offset between them."""
    offset = np.zeros(2)
    out: dict[str, list[float]] = {"newest": [], "track": [], "first": []}
    for k in range(SAMPLES):
        if (k + 1) % WINDOW == 0:
            picks = slice(k + 1 - WINDOW, k + 1)
            found = match_with_reduction(
                grid,
                leg.indicated[picks, 0],
                leg.indicated[picks, 1],
                leg.raw[picks],
                GravityReduction(),
                time_s=leg.time_s[picks],
                max_passes=passes,
                converged_m=50.0,
                **settings,
            )
            if np.isfinite(found.fix.x):
                offset = np.array(found.fix.offset)
                out["newest"].append(metres(grid, np.array([found.fix.x, found.fix.y]), leg.truth[k]))
        out["track"].append(metres(grid, leg.indicated[k] + offset, leg.truth[k]))
    return out


def run(context: Context) -> Report:
    """Reproduce E6."""
    grid = gravity_map(context)
    trials = context.trials(100)
    rows: list[list[object]] = []
    gains: list[list[object]] = []
    example: tuple[Leg, dict[str, list[float]], dict[str, list[float]]] | None = None

    def median(values: list[float]) -> object:
        return round(float(np.median(values))) if values else "-"

    legs: dict[float, list[Leg]] = {}
    for hours in HOURS:
        rng = np.random.default_rng([context.seed, 6, int(hours)])
        legs[hours] = [sail(grid, rng, hours) for _ in range(trials)]
        for name, settings in options(hours).items():
            single: dict[str, list[float]] = {"newest": [], "track": []}
            twice: dict[str, list[float]] = {"newest": [], "track": []}
            slides: dict[str, dict[str, list[float]]] = {}
            ins: list[float] = []
            for leg in legs[hours]:
                ins += [metres(grid, a, b) for a, b in zip(leg.indicated, leg.truth, strict=True)]
                one, two = batches(grid, leg, settings, 1), batches(grid, leg, settings, 8)
                for into, found in ((single, one), (twice, two)):
                    for key in into:
                        into[key] += found[key]
                runs = {
                    "at the INS": follow(grid, leg, reduced(leg, leg.indicated), settings),
                    "at the last fix": follow(grid, leg, None, settings),
                    "no reduction error": follow(grid, leg, leg.anomaly, settings),
                }
                for kind, found in runs.items():
                    into = slides.setdefault(kind, {"newest": [], "delayed": [], "single": [], "track": []})
                    for key in into:
                        into[key] += found[key]
                if name == "recommended" and hours == HOURS[1] and example is None:
                    example = (leg, two, runs["at the last fix"])
            rows += [
                [hours, median(ins), name, "batch", "100 min", passes, median(found["newest"]), median(found["track"])]
                for passes, found in (("once", single), ("until at rest", twice))
            ]
            for kind, found in slides.items():
                rows.append(
                    [
                        hours,
                        median(ins),
                        name,
                        "sliding",
                        "5 min",
                        kind,
                        median(found["newest"]),
                        median(found["track"]),
                    ]
                )
                gain = (
                    100 * (1 - np.median(found["delayed"]) / np.median(found["single"])) if found["delayed"] else np.nan
                )
                gains.append([hours, name, kind, median(found["single"]), median(found["delayed"]), f"{gain:.0f} %"])
            context.say(f"  E6: {hours:g} h of drift, {name}: done")
    settings_table: dict[str, object] = {
        "map": "EIGEN-6C4, South China Sea, cubic spline at 1 arc minute",
        "ship": f"{SPEED_KN:g} knots, a sample every {INTERVAL_S / 60:g} minutes, N = {WINDOW}",
        "INS drift": "1 nautical mile an hour in one direction",
        "gravimeter": f"{SIGMA_MGAL:g} mGal",
        "legs": f"{trials} a case, {SAMPLES} samples",
        "seed": context.seed,
    }
    recommended = {hours: options(hours)["recommended"] for hours in HOURS}
    loop = _gravity_loop.table(grid, legs, WINDOW, recommended, context.seed)
    context.say("  E6: the loop: done")
    head = ("hours of drift", "INS error m")
    report = Report(
        "E6",
        settings_table,
        [
            Table(
                "Batch against sliding window: error of the newest fix, and of the whole track with the last fix "
                "applied; where readings are reduced",
                (*head, "method", "window", "fix every", "reduced", "fix error m", "track error m"),
                rows,
            ),
            Table(
                "Averaging: a point's estimates in single windows against its weighted mean over all 20 (95 min late)",
                (head[0], "method", "reduced", "single window m", "weighted mean m", "gain"),
                gains,
            ),
            loop,
        ],
    )
    if example is not None:
        report.pictures = [picture(context, grid, *example)]
    report.notes = [
        "The source prints no legible figures. A drift of one knot turns and stretches a 12 knot track by up to a "
        "twelfth over the window: a method that holds heading and speed pays for it in the newest point.",
        "The loop: the velocity of an INS swings by half a metre a second and more in 84 minutes, which is up to 7 mGal in the Eotvos correction of "
        "a window of 100 minutes; fixes of such windows are refused, and readings taken as right mislead the filter. Once it knows that the "
        "correction is its own velocity's (`gravity=True`), each reading tells of position and velocity both.",
        "Reduced at the INS, readings carry an error of normal gravity of up to 0.8 mGal a kilometre of latitude.",
    ]
    return report


def picture(
    context: Context, grid: GridMap, leg: Leg, batch: dict[str, list[float]], slide: dict[str, list[float]]
) -> Path:
    """Error over time of one leg."""
    from geomag.plot import COLOURS, style
    from geomag.plot._style import new_figure

    hours = leg.time_s / 3600.0
    ins = [metres(grid, a, b) / 1000 for a, b in zip(leg.indicated, leg.truth, strict=True)]
    with style():
        figure = new_figure(6.4, 4.2)
        axes = figure.add_subplot()
        axes.plot(hours, ins, color=COLOURS["indicated"], ls="--", label="INS alone")
        for label, track, colour, dash in (
            ("batch, fix every 100 min", batch["track"], "neutral", "-."),
            ("sliding, fix every 5 min", slide["track"], "matched", "-"),
        ):
            axes.step(hours, np.array(track) / 1000, where="post", color=COLOURS[colour], ls=dash, label=label)
        axes.set(ylim=(0, None), title="E6: gravity, recommended settings, one leg")
        axes.set_xlabel("time (h)")
        axes.set_ylabel("position error (km)")
        axes.grid(True)
        axes.legend(loc="upper left")
    return context.save(figure, "e6-leg")
