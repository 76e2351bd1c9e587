"""Does a declared risk hold? Calibration reports, and where on a map one can fix at all.

`calibrate_lines` takes survey lines, makes a map of two thirds of them with everything that `map_from_lines` learns from those alone,
and matches the third that the map has never seen; `calibrate_simulated` flies over a map that is right. Both return a
`Calibration`: declared risk in bins against the observed share of wrong answers with its binomial interval, fix rate, errors,
normalised error squared. `suitability` looks ahead: over the map and by heading, the expected position error and the
probability of a fix.
"""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap, Track, match_posterior_many, predict_many
from geomag._optional import require
from geomag._ranges import above, at_least
from geomag._statistics import wilson
from geomag.navigation_report import NavigationReport, calibrate_navigation
from geomag.survey import Lines, folds_of, map_from_lines
from geomag.survey._lines import windows_of

__all__ = [
    "RISK_BINS",
    "Calibration",
    "NavigationReport",
    "Suitability",
    "assess",
    "calibrate_lines",
    "calibrate_navigation",
    "calibrate_simulated",
    "one_sided_limit",
    "suitability",
]

Array = npt.NDArray[np.float64]
Progress = bool | Callable[[int, int], None] | None

#: Bounds of the risk bins of a report.
RISK_BINS = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 0.5)
#: Statuses whose risk is no statement on the answer: the truth may lie elsewhere altogether.
_NO_STATEMENT = ("at_edge", "lost", "rejected")


@dataclass(frozen=True)
class Calibration:
    """Answers of a matcher on tracks whose truth is known.

    Shapes (n,): `risk` declared, `error_m` of the newest position, `fixed` whether a fix was declared, `status`, `nees` the
    normalised error squared e^T P^-1 e (2 on average where the covariance is right), `samples` that the answer took.
    `independent` is the share of the tracks that have no sample in common: intervals are those of so many.
    """

    name: str
    tolerance_m: float
    max_risk: float
    risk: Array
    error_m: Array
    fixed: npt.NDArray[np.bool_]
    status: npt.NDArray[np.str_]
    nees: Array
    samples: npt.NDArray[np.int_]
    independent: float = 1.0

    def summary(self) -> dict[str, float]:
        """Fix rate, and of the fixes: share wrong, share beyond twice the tolerance, errors, mean declared risk, mean NEES."""
        ok = self.fixed
        error = self.error_m[ok]
        some = error.size > 0
        nan = float("nan")
        return {
            "tracks": float(ok.size),
            "fixed": float(ok.mean()),
            "wrong": float(np.mean(error > self.tolerance_m)) if some else nan,
            "gross": float(np.mean(error > 2 * self.tolerance_m)) if some else nan,
            "declared": float(self.risk[ok].mean()) if some else nan,
            "median_m": float(np.median(error)) if some else nan,
            "p95_m": float(np.quantile(error, 0.95)) if some else nan,
            "rms_m": float(np.sqrt(np.mean(error**2))) if some else nan,
            "nees": float(np.mean(self.nees[ok])) if some else nan,
            "samples_median": float(np.median(self.samples[ok])) if some else nan,
            "samples_p95": self.samples_for(0.95),
            "wrong_upper": one_sided_limit(float(np.sum(error > self.tolerance_m)), error.size, self.independent),
        }

    def samples_for(self, share: float) -> float:
        """Samples after which `share` of all tracks were fixed, infinite where they never were (streamed answers)."""
        needed = np.sort(np.where(self.fixed, self.samples, np.inf))
        return float(needed[min(int(np.ceil(share * needed.size)) - 1, needed.size - 1)])

    def reliability(self, bins: tuple[float, ...] = RISK_BINS) -> list[dict[str, float]]:
        """One row a risk bin: tracks, mean declared risk, observed wrong share, its 95 % Wilson interval."""
        stated = ~np.isin(self.status, _NO_STATEMENT)
        rows = []
        for low, high in itertools.pairwise(bins):
            inside = stated & (self.risk >= low) & (self.risk < high)
            n = int(inside.sum())
            wrong = int(np.sum(self.error_m[inside] > self.tolerance_m))
            below, above = wilson(wrong * self.independent, n * self.independent)
            rows.append(
                {
                    "low": low,
                    "high": high,
                    "n": n,
                    "wrong": wrong,
                    "declared": float(self.risk[inside].mean()) if n else float("nan"),
                    "observed": wrong / n if n else float("nan"),
                    "lower": below,
                    "upper": above,
                }
            )
        return rows

    def to_markdown(self) -> str:
        """Summary and reliability as Markdown tables."""
        s = self.summary()
        lines = [
            f"### {self.name}",
            "",
            f"Tolerance {self.tolerance_m:g} m, fixes declared at risk up to {100 * self.max_risk:g} %."
            + (
                f" Tracks overlap: {self.independent * s['tracks']:.0f} are independent, and the intervals are theirs."
                if self.independent < 1
                else ""
            ),
            "",
            "| tracks | fixed | wrong | beyond twice the tolerance | mean declared | median error | 95 % | NEES | samples |",
            "|---|---|---|---|---|---|---|---|---|",
            f"| {s['tracks']:.0f} | {100 * s['fixed']:.1f} % | {100 * s['wrong']:.2f} % | {100 * s['gross']:.2f} % | "
            f"{100 * s['declared']:.2f} % | {s['median_m']:.0f} m | {s['p95_m']:.0f} m | {s['nees']:.2f} | "
            f"{s['samples_median']:.0f} |",
            "",
            "| declared risk | tracks | mean declared | wrong | observed | 95 % interval |",
            "|---|---|---|---|---|---|",
        ]
        for row in self.reliability():
            if row["n"] == 0:
                continue
            lines.append(
                f"| {100 * row['low']:g} to {100 * row['high']:g} % | {row['n']:.0f} | {100 * row['declared']:.2f} % | "
                f"{row['wrong']:.0f} | {100 * row['observed']:.2f} % | "
                f"{100 * row['lower']:.2f} to {100 * row['upper']:.2f} % |"
            )
        return "\n".join([*lines, ""])

    def plot(self, path: str | Path) -> None:
        """Draw the reliability diagram; needs matplotlib (extra `plot`)."""
        from geomag.plot import reliability_points, save

        rows = [r for r in self.reliability() if r["n"]]
        points = [(r["declared"], r["observed"], r["lower"], r["upper"], int(r["n"])) for r in rows]
        ax = reliability_points(points, label="observed, 95 %")
        ax.set_title(textwrap.fill(self.name, 45), fontsize=9)
        save(ax.figure, path)  # type: ignore[arg-type]


def one_sided_limit(wrong: float, n: int, independent: float = 1.0) -> float:
    """Upper 95 % limit of a binomial share (Wilson) of `n` trials of which `independent` is the share that counts."""
    return wilson(wrong * independent, n * independent, 1.645)[1]


def assess(
    grid: GridMap,
    tracks: list[Track],
    truth: Array,
    *,
    name: str,
    half_width_m: float,
    tolerance_m: float,
    max_risk: float = 0.01,
    **options: Any,  # noqa: ANN401 - options of match_posterior, as they are
) -> Calibration:
    """Match tracks whose true positions are known. Other options are those of `match_posterior`.

    `truth` has the newest position of every track, shape (n, 2), or those of all samples, (n, samples, 2): what a streamed answer
    needs where the offset changes along the track, because it comes before the last sample.
    """
    truth = np.asarray(truth, dtype=float)
    if truth.shape[:1] != (len(tracks),) or truth.ndim not in (2, 3) or truth.shape[-1] != 2:
        raise InvalidInputError(
            f"truth: needed shape ({len(tracks)}, 2) or ({len(tracks)}, samples, 2), got {truth.shape}"
        )
    if not tracks:
        raise TooFewSamplesError("tracks: needed at least 1, got 0")
    east, north = grid.metres_per_unit(float(np.mean(truth[..., 1])))
    fixes = match_posterior_many(
        grid,
        tracks,
        half_width=(half_width_m / east, half_width_m / north),
        tolerance_m=tolerance_m,
        max_risk=max_risk,
        **options,
    )
    n = len(fixes)
    risk, error, nees = np.ones(n), np.full(n, np.inf), np.full(n, np.nan)
    for i, (fix, track, place) in enumerate(zip(fixes, tracks, truth, strict=True)):
        if fix.risk is None:
            continue
        risk[i] = fix.risk
        # Judged by the offset at the newest sample that the answer rests on: a streamed fix may come before the last.
        newest = fix.n_samples - 1 if truth.ndim == 3 else -1
        x, y = place[newest] if truth.ndim == 3 else place
        here = grid.metres_per_unit(float(y))
        e = (np.array(fix.offset) - [x - track.x[newest], y - track.y[newest]]) * here
        error[i] = np.hypot(*e)
        covariance = fix.covariance_m2
        if covariance is not None and np.linalg.det(covariance) > 0:
            nees[i] = e @ np.linalg.solve(covariance, e)
    return Calibration(
        name,
        tolerance_m,
        max_risk,
        risk,
        error,
        np.array([f.ok for f in fixes]),
        np.array([f.status for f in fixes]),
        nees,
        np.array([f.n_samples for f in fixes]),
    )


def calibrate_lines(
    lines: Lines,
    *,
    name: str = "survey",
    half_width_m: float,
    tolerance_m: float,
    spacing_m: float,
    samples: int = 40,
    folds: int = 3,
    max_risk: float = 0.01,
    most: int = 2000,
    overlap: float = 0.0,
    seed: int = 1,
    progress: Progress = None,
    **map_options: Any,  # noqa: ANN401 - options of map_from_lines, as they are
) -> Calibration:
    """Calibration on lines that are not in the map.

    A `folds`-th of the lines (neighbours in different folds) is taken away at a time; map and error model are made from the
    others alone; windows of `samples` samples `spacing_m` apart along the lines taken away, started anywhere within
    `half_width_m` per axis, are matched. At most `most` windows, drawn at random; a window shares `overlap` of its samples with
    the next, and the intervals of the answer are those of the windows that would not.
    """
    above(0, half_width_m=half_width_m, tolerance_m=tolerance_m, spacing_m=spacing_m)
    at_least(2, samples=samples, folds=folds)
    at_least(folds, most=most)
    if not 0 <= overlap < 1:
        raise InvalidInputError(f"overlap: needed a share in [0, 1), got {overlap}")
    pieces = lines.split()
    fold = folds_of(pieces, folds)
    rng = np.random.default_rng(seed)
    parts = []
    apart = 0
    for k in range(folds):
        kept = [one for one, f in zip(pieces, fold, strict=True) if f != k]
        training = Lines(
            np.concatenate([p.x for p in kept]),
            np.concatenate([p.y for p in kept]),
            np.concatenate([p.values for p in kept]),
            np.concatenate([p.line for p in kept]),
            lines.geographic,
        )
        grid = map_from_lines(training, progress=progress, **map_options)
        taken = [one for one, f in zip(pieces, fold, strict=True) if f == k]

        def usable(share: float, taken: list[Lines] = taken, grid: GridMap = grid) -> list[tuple[Array, Array, Array]]:
            some = windows_of(taken, spacing_m, samples, share)
            return [w for w in some if len(w[0]) == samples and np.mean(np.isfinite(grid.sample(w[0], w[1]))) >= 0.9]

        windows = usable(overlap)
        apart += len(usable(0.0))
        if len(windows) > most // folds:
            windows = [windows[i] for i in rng.choice(len(windows), most // folds, replace=False)]
        tracks, truth = [], []
        for x, y, v in windows:
            east, north = grid.metres_per_unit(float(y[-1]))
            offset = rng.uniform(-half_width_m, half_width_m, 2) / (east, north)
            tracks.append(Track(x - offset[0], y - offset[1], v))
            truth.append((x[-1], y[-1]))
        if tracks:
            parts.append(
                assess(
                    grid,
                    tracks,
                    np.array(truth),
                    name=name,
                    half_width_m=half_width_m,
                    tolerance_m=tolerance_m,
                    max_risk=max_risk,
                )
            )
    if not parts:
        raise TooFewSamplesError(f"lines: needed a line of {samples} samples, {spacing_m:g} m apart, got none")
    arrays = {
        key: np.concatenate([getattr(p, key) for p in parts])
        for key in ("risk", "error_m", "fixed", "status", "nees", "samples")
    }
    independent = 1.0 if overlap == 0 else min(1.0, apart / len(arrays["risk"]))
    return Calibration(name, tolerance_m, max_risk, independent=independent, **arrays)


def calibrate_simulated(
    grid: GridMap,
    *,
    sigma: float,
    name: str = "simulated",
    half_width_m: float,
    tolerance_m: float,
    samples: int = 40,
    trials: int = 1000,
    bias: float = 0.0,
    outlier_share: float = 0.0,
    outlier: float = 0.0,
    heading_deg: float = 0.0,
    drift_m: float = 0.0,
    seed: int = 0,
    streaming: bool = False,
    max_risk: float = 0.01,
    **options: Any,  # noqa: ANN401 - options of match_posterior, as they are
) -> Calibration:
    """Calibration on simulated flights over a map that is right (its sigma is taken as the map has it).

    Straight tracks at random places and headings, 1 to 3 cells a sample; normal noise of `sigma`; a bias uniform in
    +-`bias`; a share of outliers of +-`outlier`; a normal heading error; a drift of `drift_m` in a random direction over
    the sequence. Heading and drift are told to the matcher as an INS specification would: `heading_deg` as a standard
    deviation, `drift_m` as a bound on each component, which stands for a rectangular law with a standard deviation of
    `drift_m` / sqrt(3) per axis (JCGM 100:2008, 4.3.7), though every flight drifts by the whole of it.
    `heading_sigma_deg` and `drift_sigma_m` tell it something else.
    """
    above(0, half_width_m=half_width_m, tolerance_m=tolerance_m)
    at_least(1, samples=samples, trials=trials)
    at_least(0, sigma=sigma, bias=bias, outlier=outlier, heading_deg=heading_deg, drift_m=drift_m)
    if not 0 <= outlier_share <= 1:
        raise InvalidInputError(f"outlier_share: needed a share in [0, 1], got {outlier_share}")
    options = {"heading_sigma_deg": heading_deg, "drift_sigma_m": drift_m / np.sqrt(3)} | options
    rng = np.random.default_rng(seed)
    tracks: list[Track] = []
    truth: list[Any] = []
    cell = np.array(grid.spacing)
    low = np.array([grid.x[0], grid.y[0]])
    high = np.array([grid.x[-1], grid.y[-1]])
    refused = 0
    while len(tracks) < trials:
        place = rng.uniform(low, high)
        east, north = grid.metres_per_unit(float(place[1]))
        metres = np.array([east, north])
        course = rng.uniform(0, 2 * np.pi)
        step = rng.uniform(1, 3) * cell * [np.sin(course), np.cos(course)]
        path = place + step * np.arange(samples)[:, None]
        margin = 1.2 * half_width_m / metres
        clear = np.all(path > low + margin) and np.all(path < high - margin)
        if not clear or not np.all(np.isfinite(values := grid.sample(path[:, 0], path[:, 1]))):
            refused += 1
            if refused > 1000 * trials:
                raise InvalidInputError("map: needed room for the tracks, got a map too small or too full of holes")
            continue
        values = values + rng.normal(0, sigma, samples) + rng.uniform(-bias, bias)
        if outlier_share > 0:
            values = values + (rng.random(samples) < outlier_share) * rng.choice([-1, 1], samples) * outlier
        away = rng.uniform(0, 2 * np.pi)
        age = np.linspace(1, 0, samples)[:, None]
        # True = indicated + offset - age * drift at every sample; the heading error turns about the newest.
        turned = (path - path[-1]) * metres
        angle = np.radians(rng.normal(0, heading_deg))
        turned = turned @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).T
        moved = turned - (path - path[-1]) * metres + age * drift_m * np.array([np.sin(away), np.cos(away)])
        # The bound that the matcher is told holds all along the track.
        low_m, high_m = np.max(moved, axis=0) - half_width_m, np.min(moved, axis=0) + half_width_m
        if np.any(low_m >= high_m):
            refused += 1
            continue
        offset = rng.uniform(low_m, high_m)
        indicated = path + (moved - offset) / metres
        tracks.append(Track(indicated[:, 0], indicated[:, 1], values))
        truth.append(path)
    return assess(
        grid,
        tracks,
        np.array(truth),
        name=name,
        half_width_m=half_width_m,
        tolerance_m=tolerance_m,
        max_risk=max_risk,
        sigma=sigma,
        streaming=streaming,
        **options,
    )


@dataclass(frozen=True)
class Suitability:
    """Where one can fix: axes `x`, `y` (map units), `heading_deg`; layers of shape (heading, y, x), NaN where unknown.

    `sigma_m` is the expected standard deviation (both axes together), `samples` after how many samples twice that is within the
    tolerance (NaN: not within the sequence), `fix_probability` the share of simulated flights that were fixed.
    """

    x: Array
    y: Array
    heading_deg: Array
    sigma_m: Array
    samples: Array
    fix_probability: Array
    spacing_m: float
    geographic: bool

    def to_netcdf(self, path: str | Path) -> None:
        """Write the layers; needs xarray with a netCDF library (extra `io`)."""
        xarray = require("xarray", "io", "writing netCDF")
        dims = ("heading", "y", "x")
        data = xarray.Dataset(
            {
                "sigma": (dims, self.sigma_m, {"units": "m"}),
                "samples_to_fix": (dims, self.samples),
                "fix_probability": (dims, self.fix_probability),
            },
            coords={"heading": ("heading", self.heading_deg, {"units": "degrees"}), "y": self.y, "x": self.x},
            attrs={"sample_spacing_m": self.spacing_m, "geographic": int(self.geographic)},
        )
        data.to_netcdf(path)

    def plot(self, path: str | Path) -> None:
        """Draw expected error and the share of flights not fixed, means over the headings; needs matplotlib (extra `plot`)."""
        from geomag.plot import save, suitability_map
        from geomag.plot._style import new_figure

        layers = ((self.sigma_m, "expected standard deviation (m)"), (1 - self.fix_probability, "share not fixed"))
        figure = new_figure(11.0, 4.6)
        for k, (layer, label) in enumerate(layers):
            known = np.isfinite(layer)
            mean = np.where(known.any(axis=0), np.nansum(layer, axis=0) / np.maximum(known.sum(axis=0), 1), np.nan)
            ax = figure.add_subplot(1, 2, k + 1)
            suitability_map(mean, self.x, self.y, ax, geographic=self.geographic, label=label)
        save(figure, path)


def suitability(
    grid: GridMap,
    *,
    spacing_m: float,
    half_width_m: float,
    tolerance_m: float | None = None,
    sigma: float | None = None,
    samples: int = 40,
    headings_deg: tuple[float, ...] = (0.0, 45.0, 90.0, 135.0),
    places: int = 20,
    flights: int = 3,
    seed: int = 0,
    progress: Progress = None,
    **options: Any,  # noqa: ANN401 - options of predict_many, as they are
) -> Suitability:
    """Expected fixes over the map: `places` x `places` tracks a heading, centred on each place, `spacing_m` between samples."""
    if places < 1 or samples < 3:
        raise InvalidInputError(f"places, samples: needed at least 1 and 3, got {places} and {samples}")
    above(0, spacing_m=spacing_m, half_width_m=half_width_m)
    at_least(0, flights=flights)
    edges = [np.linspace(float(a[0]), float(a[-1]), places + 1) for a in (grid.x, grid.y)]
    x, y = (0.5 * (e[1:] + e[:-1]) for e in edges)
    tracks = []
    along = spacing_m * (np.arange(samples) - 0.5 * (samples - 1))
    for heading in np.radians(headings_deg):
        for north in y:
            scale = grid.metres_per_unit(float(north))
            for east in x:
                tracks.append(
                    Track(
                        east + along * np.sin(heading) / scale[0],
                        north + along * np.cos(heading) / scale[1],
                        np.zeros(samples),
                    )
                )
    scale = grid.metres_per_unit(float(np.mean(y)))
    found = predict_many(
        grid,
        tracks,
        half_width=(half_width_m / scale[0], half_width_m / scale[1]),
        sigma=sigma,
        tolerance_m=tolerance_m,
        flights=flights,
        seed=seed,
        progress=progress,
        **options,
    )
    shape = (len(headings_deg), places, places)

    def layer(get: Callable[[Any], float | None]) -> Array:
        values = [np.nan if p is None or (v := get(p)) is None else v for p in found]
        return np.array(values, dtype=float).reshape(shape)

    return Suitability(
        x,
        y,
        np.array(headings_deg, dtype=float),
        layer(lambda p: float(np.sqrt(np.trace(p.covariance_m2)))),
        layer(lambda p: p.samples_to_fix),
        layer(lambda p: p.fix_probability),
        spacing_m,
        grid.geographic,
    )
