"""E4 and E5 share one procedure: ICCP on sequences of four kinds, on random tracks of one region [DM-ICCP]."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geomag._geomag import Fix, GridMap, SlidingContour, Track, energy_bandwidth, match_contour, tune_sequence
from geomag._optional import require
from geomag._sequence import delta_modulation
from geomag._statistics import normalised_squares
from geomag.io import read_grid
from geomag.reproduce import Context, Report, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: INS error at the correction point, metres, and how far contours are looked for: three times that.
OFFSET_M = 790.0
#: Standard deviation of each axis of an offset of that length and any direction.
OFFSET_SIGMA_M = OFFSET_M / np.sqrt(2.0)
SPEED_M_S = 35.0
EQUAL_S = 24.0
#: Samples that delta modulation sees: one a map cell of 250 m, rounded up to whole seconds (rule 2).
DENSE_S = 8.0
DENSE_M = SPEED_M_S * DENSE_S
#: Length of the random tracks: what lies behind the correction point.
DENSE_SAMPLES = 260
#: Sequences of more points get three times as many tracks: their median is asked for to some metres.
LONG = 100
DENSE: dict[str, Any] = {"samples": DENSE_SAMPLES, "spacing_m": DENSE_M}


@dataclass(frozen=True)
class Region:
    """One region of the paper."""

    key: str
    file: str
    quantum: float
    length: int
    quanta: tuple[float, ...]
    max_length: int
    noise_variance: float
    published: Table


@dataclass(frozen=True)
class InsError:
    """Standard deviations of heading and scale beside the offset of 790 m."""

    heading_deg: float = 0.0
    scale: float = 0.0

    @property
    def name(self) -> str:
        """What a table calls it."""
        parts = ["offset"]
        if self.heading_deg:
            parts.append(f"{self.heading_deg:g} deg")
        if self.scale:
            parts.append(f"{100 * self.scale:g} % speed")
        return " + ".join(parts)


def refined_map(context: Context, file: str, spacing_m: float = 250.0) -> GridMap:
    """The region's degree-790 anomaly on a plane in metres at 250 m, by cubic spline of the 0.01 degree grid."""
    interpolate = require("scipy.interpolate", "survey", "refining the map")
    coarse = read_grid(context.file(f"emm2017-crustal/{file}"), "total_field_anomaly_nt")
    east, north = coarse.metres_per_unit(float(coarse.y.mean()))
    spline = interpolate.RectBivariateSpline(coarse.y, coarse.x, np.asarray(coarse.values, dtype=float))
    x = np.arange(0.0, (coarse.x[-1] - coarse.x[0]) * east, spacing_m)
    y = np.arange(0.0, (coarse.y[-1] - coarse.y[0]) * north, spacing_m)
    return GridMap(spline(coarse.y[0] + y / north, coarse.x[0] + x / east), x, y, name="anomaly", units="nT")


@dataclass(frozen=True)
class Texture:
    """Field at short wavelengths that the map does not have: random plane waves of 3 to 15 km."""

    wave: Floats
    phase: Floats
    amplitude: float

    @classmethod
    def draw(cls, rng: np.random.Generator, sigma: float, waves: int = 60) -> Texture:
        """Waves of log-uniform length and any direction."""
        length = 3000.0 * 5.0 ** rng.random(waves)
        course = rng.uniform(0, 2 * np.pi, waves)
        wave = 2 * np.pi / length * np.stack([np.sin(course), np.cos(course)])
        return cls(wave, rng.uniform(0, 2 * np.pi, waves), sigma * np.sqrt(2.0 / waves))

    def at(self, points: Floats) -> Floats:
        """Value at (n, 2) points."""
        return np.asarray(self.amplitude * np.cos(points @ self.wave + self.phase).sum(axis=1))


@dataclass(frozen=True)
class Flight:
    """A true straight track, dense, and how the INS shows it."""

    truth: Floats
    indicated: Floats
    values: Floats

    def track(self, picks: NDArray[np.int64]) -> Track:
        """The indicated track of the picked samples."""
        return Track(self.indicated[picks, 0], self.indicated[picks, 1], self.values[picks])


def fly(
    grid: GridMap,
    rng: np.random.Generator,
    *,
    samples: int,
    spacing_m: float,
    noise: float,
    ins: InsError,
    texture: float = 0.0,
    margin_m: float = 5000.0,
) -> Flight:
    """A random track that ends anywhere it fits, heading anywhere; the INS wrong by 790 m at its end."""
    length = spacing_m * (samples - 1)
    low = np.array([grid.x[0], grid.y[0]]) + margin_m
    high = np.array([grid.x[-1], grid.y[-1]]) - margin_m
    while True:
        course = rng.uniform(0, 2 * np.pi)
        ahead = np.array([np.sin(course), np.cos(course)])
        end = rng.uniform(low, high)
        start = end - length * ahead
        if ((start >= low) & (start <= high)).all():
            break
    lever = -spacing_m * np.arange(samples - 1, -1, -1.0)[:, None] * ahead
    truth = end + lever
    # True = indicated turned clockwise by the heading error and stretched: the indicated levers are turned back.
    angle, stretch = np.radians(ins.heading_deg * rng.normal()), 1.0 + ins.scale * rng.normal()
    c, s = np.cos(angle), np.sin(angle)
    back = np.column_stack([c * lever[:, 0] - s * lever[:, 1], c * lever[:, 1] + s * lever[:, 0]]) / stretch
    direction = rng.uniform(0, 2 * np.pi)
    offset = OFFSET_M * np.array([np.sin(direction), np.cos(direction)])
    values = grid.sample(truth[:, 0], truth[:, 1], interpolation="bicubic") + noise * rng.normal(size=samples)
    if texture:
        values = values + Texture.draw(rng, texture).at(truth)
    return Flight(truth, end - offset + back, values)


def sequences(flight: Flight, quantum: float, length: int) -> dict[str, NDArray[np.int64] | None]:
    """The four sequences that the paper's comparison amounts to; None where there are too few samples."""
    dense = len(flight.values)
    step = round(EQUAL_S / DENSE_S)
    newest = dense - 1
    equal_number = newest - step * np.arange(length - 1, -1, -1)
    chosen = delta_modulation(flight.values, quantum)
    out: dict[str, NDArray[np.int64] | None] = {
        "delta modulation": None,
        "equal spacing, same number": equal_number if equal_number[0] >= 0 else None,
        "equal spacing, same distance": None,
        "equal spacing, same number and distance": None,
    }
    if len(chosen) >= length:
        picks = np.asarray(chosen)[-length:]
        out["delta modulation"] = picks
        first, last = int(picks[0]), int(picks[-1])
        out["equal spacing, same distance"] = np.arange(last, first - 1, -step)[::-1]
        out["equal spacing, same number and distance"] = np.unique(
            np.round(np.linspace(first, last, length)).astype(int)
        )
    return out


@dataclass
class Tally:
    """Errors of one method in one case."""

    errors: list[float] = field(default_factory=list)
    failures: int = 0
    used: list[bool] = field(default_factory=list)
    normalised: list[float] = field(default_factory=list)
    bounds: list[float] = field(default_factory=list)
    points: list[int] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, fix: Fix | None, truth: Floats, seconds: float = 0.0) -> None:
        """Count one answer; none, or one without a position, leaves the INS where it was."""
        self.seconds += seconds
        if fix is None or not np.isfinite(fix.x):
            self.failures += 1
            self.errors.append(OFFSET_M)
            self.used.append(False)
            return
        error = np.array([fix.x, fix.y]) - truth
        self.errors.append(float(np.hypot(*error)))
        self.used.append(fix.ok)
        self.points.append(fix.n_samples)
        self.iterations.append(fix.iterations)
        if fix.covariance_m2 is not None:
            self.normalised.append(float(normalised_squares(error[None], fix.covariance_m2[None])[0]))

    def row(self) -> list[object]:
        """Median, 90 %, share improved, shares under 250 and 500 m, failures."""
        e = np.array(self.errors)
        shares = [f"{100 * np.mean(e < limit):.0f} %" for limit in (OFFSET_M * (1 - 1e-9), 250.0, 500.0)]
        return [
            round(float(np.median(e))),
            round(float(np.quantile(e, 0.9))),
            *shares,
            f"{100 * self.failures / e.size:.0f} %",
        ]


COLUMNS = ("median m", "90 % m", "improved", "< 250 m", "< 500 m", "failed")


def timed(work: Callable[[], Fix]) -> tuple[Fix, float]:
    """An answer and the seconds that it took."""
    start = time.perf_counter()
    fix = work()
    return fix, time.perf_counter() - start


def iccp(grid: GridMap, track: Track, **options: Any) -> Fix:  # noqa: ANN401 - passed on
    """ICCP to the letter: rigid, 300 iterations, 1 m, contours within three sigma of the INS drift."""
    return match_contour(grid, track, **{"radius_m": 3 * OFFSET_M, **options})


def recommended(grid: GridMap, track: Track, sigma: float, ins: InsError) -> Fix:
    """Lattice of starts, then Gauss-Newton with the INS's accuracy as priors."""
    return match_contour(
        grid,
        track,
        transform="translation",
        starts="grid",
        half_width_m=1500.0,
        step_m=250.0,
        refine=True,
        sigma=sigma,
        offset_sigma_m=OFFSET_SIGMA_M,
        heading_sigma_deg=ins.heading_deg or None,
        scale_sigma=ins.scale or None,
    )


def cramer_rao_m2(grid: GridMap, flight: Flight, variance: float, ins: InsError) -> float:
    """Least mean square position error with the same priors: trace of the inverse information at the truth."""
    east, north = grid.gradient(flight.truth[:, 0], flight.truth[:, 1], interpolation="bicubic")
    lever = flight.truth - flight.truth[-1]
    columns = [east, north]
    prior = [1 / OFFSET_SIGMA_M**2] * 2
    if ins.heading_deg:
        columns.append(east * lever[:, 1] - north * lever[:, 0])
        prior.append(1 / np.radians(ins.heading_deg) ** 2)
    if ins.scale:
        columns.append(east * lever[:, 0] + north * lever[:, 1])
        prior.append(1 / ins.scale**2)
    jacobian = np.column_stack(columns)
    bound = np.linalg.inv(jacobian.T @ jacobian / variance + np.diag(prior))
    return float(bound[0, 0] + bound[1, 1])


def compare_sequences(
    context: Context, grid: GridMap, region: Region, trials: int
) -> tuple[Table, Table, dict[str, list[float]]]:
    """The paper's comparison on random tracks, every INS error, without and with noise."""
    noise = float(np.sqrt(region.noise_variance))
    cases = [(s, i) for s in (0.0, noise) for i in (InsError(), InsError(0.5), InsError(1.0), InsError(0.5, 0.01))]
    rows: list[list[object]] = []
    work: dict[str, Tally] = {}
    curves: dict[str, list[float]] = {}
    for number, (sigma, ins) in enumerate(cases):
        rng = np.random.default_rng([context.seed, number])
        tallies: dict[str, Tally] = {}
        for _ in range(trials):
            flight = fly(grid, rng, **DENSE, noise=sigma, ins=ins)
            for name, picks in sequences(flight, region.quantum, region.length).items():
                tally = tallies.setdefault(name, Tally())
                if picks is None:
                    tally.add(None, flight.truth[-1])
                    continue
                fix, seconds = timed(lambda p=picks, f=flight: iccp(grid, f.track(p)))  # type: ignore[misc]
                tally.add(fix, flight.truth[picks[-1]], seconds)
        for name, tally in tallies.items():
            rows.append([f"{sigma**2:g}", ins.name, name, *tally.row()])
            total = work.setdefault(name, Tally())
            total.points += tally.points
            total.iterations += tally.iterations
            total.seconds += tally.seconds
            if sigma and ins.name == "offset":
                curves[name] = tally.errors
        context.say(f"  {region.key}: noise variance {sigma**2:g}, {ins.name}: done")
    title = f"ICCP to the letter (rigid), delta {region.quantum:g} nT, L {region.length}, {trials} tracks a case"
    table = Table(title, ("noise variance", "INS error", "sequence", *COLUMNS), rows)
    cost = [
        [
            name,
            round(float(np.mean(t.points)), 1) if t.points else "-",
            round(float(np.mean(t.iterations)), 1) if t.iterations else "-",
            f"{1e6 * t.seconds / max(1, sum(t.iterations)):.1f}",
        ]
        for name, t in work.items()
    ]
    return (
        table,
        Table("Work, all cases together", ("sequence", "points", "iterations", "us per iteration"), cost),
        curves,
    )


def compare_methods(context: Context, grid: GridMap, region: Region, trials: int) -> list[Table]:
    """22 equally spaced points: ICCP by its variants against the recommended pipeline, and what the latter claims."""
    noise = float(np.sqrt(region.noise_variance))
    exact = {"converged_m": 0.01, "max_iterations": 3000}
    plain = InsError()
    Row = tuple[str, float, InsError, float, int, float, Callable[[GridMap, Track], Fix]]
    half = InsError(0.5)
    whole = InsError(1.0)
    both = InsError(0.5, 0.01)

    def pipeline(sigma: float, ins: InsError) -> Callable[[GridMap, Track], Fix]:
        return lambda g, t: recommended(g, t, sigma, ins)

    cases: list[Row] = [
        ("rigid, to the letter", noise, plain, 0.0, 22, 840.0, iccp),
        ("rigid, to the letter", noise, half, 0.0, 22, 840.0, iccp),
        ("rigid, to the letter", 0.0, plain, 0.0, 22, 840.0, iccp),
        ("rigid, 0.01 m, 3000 iterations", 0.0, plain, 0.0, 22, 840.0, lambda g, t: iccp(g, t, **exact)),
        ("rigid, 0.01 m, accelerated", 0.0, plain, 0.0, 22, 840.0, lambda g, t: iccp(g, t, acceleration=4, **exact)),
        ("rigid, priors", noise, half, 0.0, 22, 840.0,
         lambda g, t: iccp(g, t, sigma=noise, offset_sigma_m=OFFSET_SIGMA_M, heading_sigma_deg=0.5)),
        ("translation, to the letter", noise, plain, 0.0, 22, 840.0, lambda g, t: iccp(g, t, transform="translation")),
        ("translation, to the letter", noise, half, 0.0, 22, 840.0, lambda g, t: iccp(g, t, transform="translation")),
        ("translation, 0.01 m, 3000 iterations", 0.0, plain, 0.0, 22, 840.0,
         lambda g, t: iccp(g, t, transform="translation", **exact)),
        ("recommended", noise, plain, 0.0, 22, 840.0, pipeline(noise, plain)),
        ("recommended", noise, half, 0.0, 22, 840.0, pipeline(noise, half)),
        ("recommended", noise, whole, 0.0, 22, 840.0, pipeline(noise, whole)),
        ("recommended, sigma 0.01 nT", 0.0, half, 0.0, 22, 840.0, pipeline(0.01, half)),
        ("recommended", noise, both, 0.0, 144, 40_000 / 143, pipeline(noise, both)),
        ("rigid, to the letter, texture 15 nT missing", noise, plain, 15.0, 22, 840.0, iccp),
        ("recommended, texture missing, map says so", noise, half, 15.0, 22, 840.0, pipeline(noise, half)),
        ("recommended, texture missing, map silent", noise, half, 15.0, 22, 840.0, pipeline(noise, half)),
        ("recommended, texture missing, map says so", noise, both, 15.0, 144, 40_000 / 143, pipeline(noise, both)),
    ]  # fmt: skip
    warned = GridMap(grid.values, grid.x, grid.y, sigma=15.0)
    accuracy: list[list[object]] = []
    honesty: list[list[object]] = []
    for number, (name, sigma, ins, texture, points, spacing, solve) in enumerate(cases):
        rng = np.random.default_rng([context.seed, 100, number])
        tally = Tally()
        for _ in range(trials * (3 if points > LONG else 1)):
            flight = fly(grid, rng, samples=points, spacing_m=spacing, noise=sigma, ins=ins, texture=texture)
            track = flight.track(np.arange(points))
            used = warned if "says so" in name else grid
            tally.add(solve(used, track), flight.truth[-1])
            variance = max(sigma, 0.01) ** 2 + texture**2
            tally.bounds.append(cramer_rao_m2(grid, flight, variance, ins))
        accuracy.append([name, f"{sigma**2:g}", ins.name, points, *tally.row()])
        if tally.normalised:
            e, used_mask = np.array(tally.errors), np.array(tally.used)
            nees = np.array(tally.normalised)
            good = nees[used_mask[: nees.size]] if nees.size == used_mask.size else nees
            honesty.append(
                [
                    name,
                    f"{sigma**2:g}",
                    ins.name,
                    points,
                    round(float(np.sqrt(np.mean(e**2) / np.mean(tally.bounds))), 2),
                    round(float(nees.mean()), 2),
                    f"{100 * used_mask.mean():.0f} %",
                    round(float(np.median(e[used_mask]))) if used_mask.any() else "-",
                    round(float(good.mean()), 2) if good.size else "-",
                    f"{100 * np.mean(good > 9.21):.1f} %" if good.size else "-",
                ]
            )
        context.say(f"  {region.key}: {name}, noise variance {sigma**2:g}, {ins.name}, {points} points: done")
    head = ("method", "noise variance", "INS error", "points")
    return [
        Table(
            f"Methods, equal spacing, {trials} tracks a case ({3 * trials} of 144 points)", (*head, *COLUMNS), accuracy
        ),
        Table(
            "What the recommended pipeline claims: rms error over the Cramer-Rao bound with the same priors; "
            "normalised error squared (2 is right) of all answers and of the ok ones; share of the ok ones beyond "
            "their 99 % ellipse",
            (*head, "rms / bound", "all", "ok", "median of ok m", "ok answers", "beyond 99 %"),
            honesty,
        ),
    ]


def compare_sliding(context: Context, grid: GridMap, region: Region, trials: int) -> Table:
    """A window of 22 points over a track of 43: one point seen in every place of the window, and averaged."""
    window, noise = 22, float(np.sqrt(region.noise_variance))
    kinds: dict[str, tuple[InsError, dict[str, Any]]] = {
        "rigid": (InsError(), {}),
        "rigid, 0.5 deg": (InsError(0.5), {}),
        "translation": (InsError(), {"transform": "translation"}),
        "recommended, 0.5 deg": (
            InsError(0.5),
            {
                "transform": "translation",
                "starts": "grid",
                "half_width_m": 1500.0,
                "refine": True,
                "offset_sigma_m": OFFSET_SIGMA_M,
                "heading_sigma_deg": 0.5,
            },
        ),
    }
    rows: list[list[object]] = []
    for number, (name, (ins, options)) in enumerate(kinds.items()):
        rng = np.random.default_rng([context.seed, 500, number])
        found: dict[str, list[float]] = {"single": [], "mean": [], "newest": [], "batch": []}
        seconds, updates = 0.0, 0
        for _ in range(trials):
            flight = fly(grid, rng, samples=2 * window - 1, spacing_m=840.0, noise=noise, ins=ins)
            slide = SlidingContour(grid, length=window, sigma=noise, radius_m=3 * OFFSET_M, **options)
            track = flight.track(np.arange(2 * window - 1))
            start = time.perf_counter()
            fixes = slide.run(track)
            seconds, updates = seconds + time.perf_counter() - start, updates + window
            middle = window - 1
            for k in range(middle, 2 * window - 1):
                if len(fixes[k].track):
                    away = fixes[k].track[2 * window - 2 - k] - flight.truth[middle]
                    found["single"].append(float(np.hypot(*away)))
            mean = slide.averaged[0]
            found["mean"].append(float(np.hypot(*(np.array([mean["x"], mean["y"]]) - flight.truth[middle]))))
            alone = match_contour(grid, track[window - 1 :], sigma=noise, radius_m=3 * OFFSET_M, **options)
            for key, fix in (("newest", fixes[-1]), ("batch", alone)):
                if np.isfinite(fix.x):
                    found[key].append(float(np.hypot(*(np.array([fix.x, fix.y]) - flight.truth[-1]))))
        medians = {k: round(float(np.median(v))) for k, v in found.items()}
        gain = 100 * (1 - np.median(found["mean"]) / np.median(found["single"]))
        rows.append([name, *medians.values(), f"{gain:.0f} %", f"{1000 * seconds / updates:.2f}"])
    context.say(f"  {region.key}: sliding window: done")
    return Table(
        f"Sliding window of 22 points, noise variance {region.noise_variance:g}, {trials} tracks: median error of a "
        "point in single windows (every place in it), of its weighted mean, and of the newest point",
        ("method", "single m", "weighted mean m", "newest m", "newest, batch m", "gain of the mean", "ms per update"),
        rows,
    )


def tune(context: Context, grid: GridMap, region: Region, trials: int) -> tuple[Table, dict[str, object]]:
    """Length and quantum tuned on some tracks, judged on others."""
    noise = float(np.sqrt(region.noise_variance))
    rng = np.random.default_rng([context.seed, 200])
    ins = InsError(0.5)
    objective: dict[tuple[int, float], list[float]] = {}
    seconds = []
    swarm_same = 0
    planned = max(4, trials // 10)
    for number in range(planned):
        flight = fly(grid, rng, **DENSE, noise=0.0, ins=ins)
        clean = Track(flight.truth[:, 0], flight.truth[:, 1], grid.sample(*flight.truth.T, interpolation="bicubic"))
        options: dict[str, Any] = {
            "sigma": noise, "offset_m": OFFSET_M, "heading_sigma_deg": ins.heading_deg, "quanta": region.quanta,
            "max_length": region.max_length, "error_range_m": (250.0, 1000.0), "seed": number, "draws": 10,
            "weights": (0.9, 0.1),
        }  # fmt: skip
        start = time.perf_counter()
        found = tune_sequence(grid, clean, **options)
        seconds.append(time.perf_counter() - start)
        swarm = tune_sequence(grid, clean, method="bpso", **options)
        swarm_same += swarm["objective"] <= 1.01 * found["objective"]
        for s in found["settings"]:
            objective.setdefault((s["length"], s["quantum"]), []).append(s["objective"])
    best = min(objective, key=lambda k: np.mean(objective[k]))
    rows: list[list[object]] = []
    for name, (length, quantum) in {"tuned": best, "paper": (region.length, region.quantum)}.items():
        judge = np.random.default_rng([context.seed, 201])
        tally = Tally()
        for _ in range(trials):
            flight = fly(grid, judge, **DENSE, noise=noise, ins=ins)
            picks = sequences(flight, quantum, length)["delta modulation"]
            tally.add(
                None if picks is None else iccp(grid, flight.track(picks)),
                flight.truth[-1 if picks is None else picks[-1]],
            )
        rows.append([name, length, quantum, *tally.row()])
    settings: dict[str, object] = {
        "tuning": f"{planned} planned tracks, 10 draws, weights 0.9 (error, 250 to 1000 m), 0.1 (work)",
        "seconds per exhaustive tuning": round(float(np.median(seconds)), 2),
        "swarm within 1 % of the exhaustive optimum": f"{swarm_same} of {planned}",
    }
    return Table(
        f"Sequences on {trials} tracks that were not tuned on", ("setting", "L", "delta nT", *COLUMNS), rows
    ), settings


def picture(context: Context, grid: GridMap, region: Region, curves: dict[str, list[float]]) -> list[Path]:
    """One track with its contours, and the distribution of errors by sequence."""
    from geomag.plot import COLOURS, error_distribution, field_map, style, tracks
    from geomag.plot._style import new_figure

    rng = np.random.default_rng([context.seed, 300])
    noise = float(np.sqrt(region.noise_variance))
    while True:
        flight = fly(grid, rng, **DENSE, noise=noise, ins=InsError())
        picks = sequences(flight, region.quantum, region.length)["delta modulation"]
        if picks is not None:
            break
    fix = iccp(grid, flight.track(picks))
    true, indicated = flight.truth[picks], flight.indicated[picks]
    off = np.hypot(*(np.array([fix.x, fix.y]) - true[-1]))
    low, high = true.min(axis=0) - 4000, true.max(axis=0) + 4000
    axes = field_map(
        grid,
        bounds=(low[0], low[1], high[0], high[1]),
        title=f"{region.key}: ICCP on a delta-modulation sequence, {off:.0f} m off",
    )
    tracks(axes, true=true, indicated=indicated, matched=fix, legend=False)
    with style():
        axes.legend(loc="best")
        shares = error_distribution(
            curves,
            new_figure(6.4, 4.2).add_subplot(),
            title=f"{region.key}: noise variance {region.noise_variance:g} nT$^2$, offset alone",
        )
        shares.axvline(OFFSET_M, color=COLOURS["neutral"], lw=1.0, label="INS error")
        shares.legend(loc="lower right")
    name = region.key.lower()
    return [
        context.save(cast("Figure", axes.figure), f"{name}-track"),
        context.save(cast("Figure", shares.figure), f"{name}-errors"),
    ]


def run(context: Context, region: Region) -> Report:
    """The whole experiment."""
    grid = refined_map(context, region.file)
    trials = context.trials(300)
    table, work, curves = compare_sequences(context, grid, region, trials)
    methods = compare_methods(context, grid, region, context.trials(1000))
    tuned, tuning = tune(context, grid, region, context.trials(300))
    along = fly(grid, np.random.default_rng([context.seed, 400]), **DENSE, noise=0.0, ins=InsError()).values
    period = 1.0 / max(energy_bandwidth(along, DENSE_M), 1e-12)
    settings: dict[str, object] = {
        "map": f"{region.file}, cubic spline at 250 m",
        "speed": "35 m/s",
        "samples for delta modulation": f"every {DENSE_S:g} s",
        "equal spacing": f"{EQUAL_S:g} s",
        "INS error at the end": f"{OFFSET_M:g} m in any direction",
        "contours within": f"{3 * OFFSET_M:g} m",
        "seed": context.seed,
        "96 % of the energy along a track at periods over": f"{period / 1000:.1f} km",
        **tuning,
    }
    sliding = compare_sliding(context, grid, region, context.trials(1000))
    report = Report(region.key, settings, [region.published, table, work, *methods, sliding, tuned])
    report.pictures = picture(context, grid, region, curves)
    report.notes = [
        "The paper's figures are one picked track each; ours are medians over random tracks, so they are not "
        "comparable line by line. Windows with too few samples count as failures and leave the INS where it was.",
        "The paper's times are MATLAB's on its machine: only ratios within one table mean anything.",
    ]
    return report
