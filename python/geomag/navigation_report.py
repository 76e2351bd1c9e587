"""What a navigator is worth on one's own survey: whole flights along lines that are not in the map.

`calibrate_navigation` takes survey lines, makes a map of two thirds of them with all that is learnt from those alone, chains the third that the map has
never seen into flights of hours (`geomag.flights`), draws INS errors for them, and navigates. The `NavigationReport` says how large the errors were and
whether the covariances and protection levels held; the unaided INS, and other filters asked for by `method`, stand beside it on identical flights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, TooFewSamplesError
from geomag._geomag import GridMap, InsFeedback, InsModel, Navigator, Track, _radii_m, match_posterior
from geomag._inertial import Inertial, draw_inertial_error, indicate, strapdown
from geomag._navigation import DECLARED, SETTLING_S, Navigation, navigate
from geomag._ranges import above, at_least
from geomag._statistics import normalised_squares, wilson
from geomag.flights import FieldSensor, LineFlight, line_flights, scales_m, steps_m
from geomag.survey import Lines, map_from_lines

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None] | None
#: Readings (NaN: none) and INS output of a run, spoilt as a test asks for; the same arrays, changed or not.
Disturbance = Callable[[LineFlight, Inertial, Array, np.random.Generator], Array]

#: A flight that ends further off than this and than three standard deviations has diverged without a word.
DIVERGED_M = 1000.0
METHODS = ("navigator", "smoothed", "ekf", "rbpf", "windows")
#: Normalised errors squared from which tables give the size alone.
MOST_IN_FULL = 1e7


@dataclass(frozen=True)
class FlightRun:
    """One flight with one INS. Shapes (n,); errors are answer minus truth, metres (east, north), (n, 2)."""

    fold: int
    flight: int
    draw: int
    time_s: Array
    error_m: Array
    unaided_m: Array
    covariance_m2: Array
    protection_level_m: Array
    status: npt.NDArray[np.str_]
    bound_m2: Array | None = None

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Steps after the settling time."""
        return np.asarray(self.time_s >= self.time_s[0] + SETTLING_S)

    @property
    def diverged(self) -> bool:
        """Whether the flight ends over a kilometre and over three declared standard deviations off."""
        sigma = float(np.sqrt(np.linalg.eigvalsh(self.covariance_m2[-1])[-1]))
        return bool(np.hypot(*self.error_m[-1]) > max(DIVERGED_M, 3 * sigma))

    @property
    def acquired_s(self) -> float:
        """Time after the start at which it first tracks; infinite where it never does."""
        at = np.flatnonzero(np.isin(self.status, ("tracking", "coasting")))
        return float(self.time_s[at[0]] - self.time_s[0]) if at.size else float("inf")

    @property
    def acquired_error_m(self) -> float:
        """Position error when it first tracks; NaN where it never does."""
        at = np.flatnonzero(np.isin(self.status, ("tracking", "coasting")))
        return float(np.hypot(*self.error_m[at[0]])) if at.size else float("nan")

    @property
    def lost_share(self) -> float:
        """Share of the time after the first tracking, and after settling, in which it says that it is lost (or still acquiring)."""
        after = self.counted & (self.time_s - self.time_s[0] >= self.acquired_s)
        return float(np.mean(np.isin(self.status[after], ("lost", "acquiring")))) if after.any() else 1.0

    @property
    def kept(self) -> bool:
        """Whether lock was kept from the end of settling on: never lost, not diverged."""
        return not self.diverged and not np.any(self.status[self.counted] == "lost")


@dataclass(frozen=True)
class NavigationReport:
    """Flights whose truth is known, and what was declared along them."""

    name: str
    method: str
    runs: list[FlightRun] = field(repr=False)

    def select(self, keep: Callable[[FlightRun], bool]) -> NavigationReport:
        """The report of some of the flights, such as those that kept lock."""
        return NavigationReport(self.name, self.method, [r for r in self.runs if keep(r)])

    def summary(self) -> dict[str, float]:
        """All figures of the report in one dictionary.

        Over the time of all flights, the first ten minutes of each left out: `drms_m`, `median_m`, `p95_m`, `max_m`; `nees` (mean of e^T P^-1 e, 2 where the
        covariance is right); `inside` (share within the Gaussian 99 % radius of the reported covariance), `inside_declared` (within 1.4 times it),
        `beyond_protection`; `declared_rms_m`, `protection_m` (median). Over flights: `runs`, `hours`, `diverged` (beyond 1 km and three sigma at the end, undeclared),
        `kept` (never lost), `beyond_protection_flights`; `lost_time` after the first tracking. `acquired`, `acquired_s` and `acquired_p90_s`, `acquired_error_m`.
        `unaided_drms_m`, `unaided_median_m`, `unaided_p95_m` of the INS alone, and `ratio`, root mean square error over the Cramer-Rao bound of the same model (NaN where
        it was not asked for).
        """
        if not self.runs:
            raise TooFewSamplesError("report: needed at least 1 flight, got 0")
        counted = [r.counted for r in self.runs]

        def all_of(get: Callable[[FlightRun], Array]) -> Array:
            return np.concatenate([get(r)[c] for r, c in zip(self.runs, counted, strict=True)])

        error = all_of(lambda r: r.error_m)
        distance = np.hypot(*error.T)
        alone = np.hypot(*all_of(lambda r: r.unaided_m).T)
        covariance = all_of(lambda r: r.covariance_m2)
        level = all_of(lambda r: r.protection_level_m)
        radius = _radii_m(covariance, 0.99)
        over = [
            bool(np.any((np.hypot(*r.error_m.T) > r.protection_level_m)[c]))
            for r, c in zip(self.runs, counted, strict=True)
        ]
        first = np.array([r.acquired_s for r in self.runs])
        got = np.isfinite(first)
        bounds = [r.bound_m2 for r in self.runs if r.bound_m2 is not None]
        trace = (
            np.concatenate([np.trace(b, axis1=1, axis2=2)[c] for b, c in zip(bounds, counted, strict=True)])
            if len(bounds) == len(self.runs)
            else np.full(1, np.nan)
        )
        drms = float(np.sqrt(np.mean(distance**2)))
        return {
            "runs": float(len(self.runs)),
            "flights": float(len({(r.fold, r.flight) for r in self.runs})),
            "hours": float(sum(r.time_s[-1] - r.time_s[0] for r in self.runs) / 3600),
            "drms_m": drms,
            "median_m": float(np.median(distance)),
            "p95_m": float(np.quantile(distance, 0.95)),
            "max_m": float(distance.max()),
            "nees": float(np.mean(normalised_squares(error, covariance))),
            "inside": float(np.mean(distance <= radius)),
            "inside_declared": float(np.mean(distance <= DECLARED * radius)),
            "beyond_protection": float(np.mean(distance > level)),
            "beyond_protection_flights": float(np.mean(over)),
            "declared_rms_m": float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))),
            "protection_m": float(np.median(level)),
            "diverged": float(np.mean([r.diverged for r in self.runs])),
            "kept": float(np.mean([r.kept for r in self.runs])),
            "lost_time": float(np.mean([r.lost_share for r in self.runs])),
            "acquired": float(got.mean()),
            "acquired_s": float(np.median(first)),
            "acquired_p90_s": float(np.sort(first)[min(int(np.ceil(0.9 * first.size)) - 1, first.size - 1)]),
            "acquired_error_m": float(np.median([r.acquired_error_m for r in self.runs if np.isfinite(r.acquired_s)]))
            if got.any()
            else float("nan"),
            "unaided_drms_m": float(np.sqrt(np.mean(alone**2))),
            "unaided_median_m": float(np.median(alone)),
            "unaided_p95_m": float(np.quantile(alone, 0.95)),
            "ratio": drms / float(np.sqrt(np.mean(trace))),
        }

    @staticmethod
    def table(reports: Sequence[NavigationReport]) -> str:
        """A Markdown table with a row a report, metres and shares of the time."""
        head = (
            "| | runs | DRMS | median | 95 % | NEES | in 99 % radius | in 1.4 r99 | beyond PL | flights beyond PL | diverged | kept lock | "
            "lost, of the time | unaided DRMS, median |"
        )
        rows = [head, "|" + "---|" * 14]
        for one in reports:
            s = one.summary()
            low, high = wilson(s["diverged"] * s["runs"], s["runs"])
            nees = f"{s['nees']:.1f}" if s["nees"] < MOST_IN_FULL else f"{s['nees']:.2g}"
            rows.append(
                f"| {one.name}, {one.method} | {s['runs']:.0f} | {s['drms_m']:.0f} | {s['median_m']:.0f} | {s['p95_m']:.0f} | {nees} | "
                f"{100 * s['inside']:.1f} % | {100 * s['inside_declared']:.1f} % | {100 * s['beyond_protection']:.2f} % | "
                f"{100 * s['beyond_protection_flights']:.0f} % | {100 * s['diverged']:.0f} % ({100 * low:.0f} to {100 * high:.0f}) | {100 * s['kept']:.0f} % | "
                f"{100 * s['lost_time']:.1f} % | {s['unaided_drms_m']:.0f}, {s['unaided_median_m']:.0f} |"
            )
        return "\n".join(rows)

    def to_markdown(self) -> str:
        """The figures of this report as a table with a line a figure."""
        rows = [f"### {self.name}, {self.method}", "", "| | |", "|---|---|"]
        return "\n".join([*rows, *(f"| {k.replace('_', ' ')} | {v:.4g} |" for k, v in self.summary().items()), ""])

    def plot(self, path: str | Path) -> None:
        """Draw error and protection level over time, a line a flight, and the share of errors within multiples of the 99 % radius; needs matplotlib (extra `plot`)."""
        from geomag.plot import COLOURS, save, style
        from geomag.plot._style import new_figure

        with style():
            figure = new_figure(11.0, 4.4)
            over, share = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
            for k, run in enumerate(self.runs):
                hours = (run.time_s - run.time_s[0]) / 3600
                label = k == 0
                over.plot(
                    hours,
                    np.hypot(*run.unaided_m.T),
                    color=COLOURS["indicated"],
                    lw=0.6,
                    alpha=0.5,
                    label="INS alone" if label else None,
                )
                over.plot(
                    hours,
                    run.protection_level_m,
                    color=COLOURS["neutral"],
                    lw=0.6,
                    alpha=0.6,
                    label="protection level" if label else None,
                )
                over.plot(
                    hours,
                    np.hypot(*run.error_m.T),
                    color=COLOURS["matched"],
                    lw=0.8,
                    alpha=0.8,
                    label="error" if label else None,
                )
            over.set_yscale("log")
            over.set_xlabel("time (h)")
            over.set_ylabel("m")
            over.legend(loc="upper left")
            over.set_title(f"{self.name}, {self.method}")
            ratio = np.sort(
                np.concatenate(
                    [(np.hypot(*r.error_m.T) / _radii_m(r.covariance_m2, 0.99))[r.counted] for r in self.runs]
                )
            )
            beyond = 1 - np.arange(ratio.size) / ratio.size
            share.plot(ratio, beyond, color=COLOURS["matched"])
            for level, name in ((1.0, "99 % radius"), (DECLARED, "declared"), (2.5, "protection level")):
                share.axvline(level, color=COLOURS["neutral"], ls="--", lw=0.8)
                share.text(level, 0.9, f" {name}", rotation=90, va="top", fontsize=8)
            share.set_yscale("log")
            share.set_ylim(1e-4, 1)
            share.set_xlim(0, 3.5)
            share.set_xlabel("error over the 99 % radius of the reported covariance")
            share.set_ylabel("share of the time beyond")
        save(figure, path)


def _folds(lines: Lines, folds: int) -> list[tuple[Lines, Lines]]:
    """Lines that are kept and lines that are left out, for every fold."""
    if folds < 2 or lines.survey.labels < 2 * folds:
        raise TooFewSamplesError(
            f"survey lines: needed at least {2 * max(folds, 2)} lines for {folds} folds, got {lines.survey.labels}"
        )
    return [(Lines.joined(kept), Lines.joined(left)) for kept, left in lines.survey.parted(folds)]


def fold_maps(lines: Lines, *, folds: int = 3, **map_options: Any) -> list[GridMap]:  # noqa: ANN401 - options of map_from_lines
    """The maps that `calibrate_navigation` makes, one a fold, each of the lines that are kept: for several reports on the same maps."""
    return [map_from_lines(kept, **map_options) for kept, _ in _folds(lines, folds)]


def calibrate_navigation(
    lines: Lines,
    *,
    ins: InsModel | None = None,
    name: str = "survey",
    folds: int = 3,
    hours: float = 2.0,
    draws: int = 3,
    flights: int = 5,
    speed_m_s: float = 70.0,
    position_sigma_m: float = 100.0,
    sensor: FieldSensor | None = None,
    simulation: str = "equations",
    method: str = "navigator",
    maps: Sequence[GridMap] | None = None,
    disturb: Disturbance | None = None,
    bound: bool = False,
    seed: int = 0,
    progress: Progress = None,
    map_options: dict[str, Any] | None = None,
    **options: Any,  # noqa: ANN401 - options of navigate, as they are
) -> NavigationReport:
    """Navigate whole flights along lines that are not in the map, and report whether what was declared held.

    A `folds`-th of the lines (neighbours in different folds) is taken away at a time; map and error model are made from the others alone; the lines taken away are
    chained into flights, their readings real, where they were made. Every flight is flown with `draws` different INSs and sensors.

    Parameters
    ----------
    lines : the survey.
    ins : grade of the INS; `InsModel.navigation()` by default.
    name : of the survey, for the tables.
    folds, hours, draws, flights : folds; hours of a flight; INSs a flight; most flights a fold.
    speed_m_s : of the vehicle.
    position_sigma_m : position error at the start, a standard deviation on each axis, told to the filter; kilometres make it an acquisition.
    sensor : what is added to the readings; `FieldSensor()` by default (a bias of up to 50, a swing over hours, half a unit of noise, one outlier of 100 in a hundred).
    simulation : 'equations' draws the INS by its error equations, 'strapdown' by integrating its own readings (pyins, extra `ins`; maps in degrees).
    method : 'navigator'; 'smoothed', with what came after each step (the whole flight, or `smooth=` seconds); 'ekf', a textbook filter with the noise of the sensor alone
        (`reading_sigma=`); 'rbpf', a particle filter; 'windows', matched windows fed to `InsFeedback`.
    maps : maps of the lines that are kept, one a fold, instead of making them.
    disturb : called with the flight, the INS's output, the readings and a generator, returns readings as they are to be: outages, jumps, a stuck sensor.
    bound : whether to compute the Cramer-Rao bound along the true paths, for `ratio`.
    seed : of all that is drawn; the same for every method.
    progress : callable (done, total), told about the flights.
    map_options : options of `map_from_lines`.
    options : of `navigate`.

    Raises `TooFewSamplesError` for lines too few or too short for one flight, `InvalidInputError` for options that are none.

    Examples
    --------
    >>> from geomag import synthetic
    >>> from geomag.calibration import calibrate_navigation
    >>> field = synthetic.Crust(height_m=300.0).draw((0, 0, 40_000, 24_000), seed=4)
    >>> lines = synthetic.survey(field, line_spacing_m=400.0)
    >>> right = field.grid(100.0)  # not given, maps are made of the lines, which takes a while
    >>> report = calibrate_navigation(lines, maps=[right] * 3, hours=1.0, draws=1, flights=1)
    >>> s = report.summary()
    >>> s["runs"], s["drms_m"] < 0.5 * s["unaided_drms_m"]
    (3.0, True)
    """
    if method not in METHODS:
        raise InvalidInputError(f"method: needed one of {', '.join(METHODS)}, got '{method}'")
    if simulation not in ("equations", "strapdown"):
        raise InvalidInputError(f"simulation: needed 'equations' or 'strapdown', got '{simulation}'")
    if simulation == "strapdown" and not lines.geographic:
        raise InvalidInputError("simulation: needed lines in degrees for 'strapdown', got metres")
    above(0, hours=hours, speed_m_s=speed_m_s)
    at_least(1, draws=draws, flights=flights)
    at_least(0, position_sigma_m=position_sigma_m)
    if maps is not None and len(maps) != folds:
        raise InvalidInputError(f"maps: needed {folds}, one a fold, got {len(maps)}")
    ins = InsModel.navigation() if ins is None else ins
    sensor = FieldSensor() if sensor is None else sensor
    runs: list[FlightRun] = []
    parts = _folds(lines, folds)
    for fold, (kept, left) in enumerate(parts):
        flown = line_flights(left, hours=hours, speed_m_s=speed_m_s, most=flights)
        grid = map_from_lines(kept, **(map_options or {})) if maps is None else maps[fold]
        for number, flight in enumerate(flown):
            for draw in range(draws):
                rng = np.random.default_rng([seed, fold, number, draw])
                runs.append(
                    _run(
                        grid,
                        flight,
                        ins,
                        sensor,
                        (fold, number, draw),
                        rng,
                        position_sigma_m,
                        simulation,
                        method,
                        disturb,
                        bound,
                        options,
                    )
                )
                if progress is not None:
                    progress(len(runs), len(parts) * len(flown) * draws)
    return NavigationReport(name, method, runs)


def _run(
    grid: GridMap,
    flight: LineFlight,
    ins: InsModel,
    sensor: FieldSensor,
    key: tuple[int, int, int],
    rng: np.random.Generator,
    position_sigma_m: float,
    simulation: str,
    method: str,
    disturb: Disturbance | None,
    bound: bool,
    options: dict[str, Any],
) -> FlightRun:
    start = draw_inertial_error(ins, rng, position_sigma_m)
    true_x, true_y = flight.x, flight.y
    if simulation == "equations":
        shown = indicate(
            flight.time_s, flight.x, flight.y, geographic=flight.geographic, error=start, ins=ins, seed=rng
        )
        alone = shown.error[:, :2]
    else:
        shown, flown_x, flown_y = strapdown(flight.time_s, flight.x, flight.y, error=start, ins=ins, seed=rng)
        # Readings are at their real places; what the INS gets wrong on its rounded path is added there.
        shown = Inertial(
            shown.time_s,
            true_x + shown.x - flown_x,
            true_y + shown.y - flown_y,
            shown.velocity_m_s,
            shown.heading_deg,
            shown.error,
        )
        alone = shown.error[:, :2]
    readings = flight.with_sensor(rng, sensor)
    if disturb is not None:
        readings = disturb(flight, shown, readings, rng)
    if method == "windows":
        error, covariance, level, status = _windows(grid, flight, shown, readings, ins, position_sigma_m)
    else:
        more = {
            "navigator": {},
            "smoothed": {"smooth": "flight"},
            "ekf": {"method": "ekf"},
            "rbpf": {"method": "rbpf"},
        }[method] | options
        flown: Navigation = navigate(
            grid, shown.time_s, shown.x, shown.y, velocity_m_s=shown.velocity_m_s, heading_deg=shown.heading_deg,
            readings=readings, ins=ins, position_sigma_m=max(position_sigma_m, 1.0), **more,
        )  # fmt: skip
        smoothed = method == "smoothed"
        error = flown.error_m(true_x, true_y, smoothed=smoothed)
        covariance = flown.covariance_m2
        if smoothed and flown.smooth_covariance_m2 is not None:
            covariance = flown.smooth_covariance_m2
        level, status = flown.protection_level_m, flown.status
    return FlightRun(
        *key,
        flight.time_s,
        error,
        alone,
        covariance,
        level,
        status,
        _bound(grid, flight, readings, ins, position_sigma_m, options) if bound else None,
    )


def _bound(
    grid: GridMap,
    flight: LineFlight,
    readings: Array,
    ins: InsModel,
    position_sigma_m: float,
    options: dict[str, Any],
) -> Array:
    """Cramer-Rao bound along the true path with its readings; between readings, and before the first, that of the nearest."""
    read = np.flatnonzero(np.isfinite(readings))
    path = (flight.time_s[read], flight.x[read], flight.y[read])
    known = {k: v for k, v in options.items() if k not in ("smooth", "progress")}
    navigator = Navigator(grid, ins=ins, position_sigma_m=max(position_sigma_m, 1.0), **known)
    bound = np.asarray(navigator.predict_bound(*path), dtype=np.float64)
    at = np.clip(np.searchsorted(flight.time_s[read], flight.time_s), 0, read.size - 1)
    return np.asarray(bound[at], dtype=np.float64)


#: Windows of the method 'windows': samples, time between two matches, what the covariance of a fix is multiplied by, walk of the velocity (m/s per square root of a second).
WINDOW_SAMPLES = 40
WINDOW_EVERY_S = 600.0
WINDOW_WIDENING = 2.5
WINDOW_WALK = 0.02


def _windows(
    grid: GridMap, flight: LineFlight, shown: Inertial, readings: Array, ins: InsModel, position_sigma_m: float
) -> tuple[Array, Array, Array, npt.NDArray[np.str_]]:
    """Windows matched by the posterior and fed to `InsFeedback`: what could be done before there was a navigator."""
    model = grid.error_model
    distance = 100.0 if model is None else float(np.nanmedian(np.asarray(model["distance_m"])))
    spacing_m = max(distance, float(np.median(np.hypot(*steps_m(flight.x, flight.y, geographic=flight.geographic).T))))
    tolerance_m = max(2 * max(grid.spacing_m), distance)
    feedback = InsFeedback(
        position_sigma_m=max(position_sigma_m, 1.0), velocity_sigma_m_s=ins.velocity_sigma_m_s, heading_sigma_deg=float(np.degrees(1e-3 * ins.heading_sigma_mrad)),
        velocity_walk_m_s_sqrt_s=WINDOW_WALK, geographic=flight.geographic,
    )  # fmt: skip
    n = flight.time_s.size
    error, covariance = np.empty((n, 2)), np.empty((n, 2, 2))
    status = np.full(n, "acquiring", dtype="<U9")
    scale = scales_m(flight.y, geographic=flight.geographic)
    picks: list[int] = []
    far, next_s, tracked = 0.0, WINDOW_EVERY_S / 2, False
    legs = np.concatenate([[0.0], np.cumsum(np.hypot(*steps_m(shown.x, shown.y, geographic=flight.geographic).T))])
    for k in range(n):
        if np.isfinite(readings[k]) and (not picks or legs[k] - far >= spacing_m):
            picks = [*picks[-(WINDOW_SAMPLES - 1) :], k]
            far = legs[k]
        fix = None
        if flight.time_s[k] >= next_s and len(picks) >= WINDOW_SAMPLES // 2:
            next_s = flight.time_s[k] + WINDOW_EVERY_S
            state, spread = feedback.state, feedback.covariance
            x, y = shown.x[picks] + state[0] / scale[k, 0], shown.y[picks] + state[1] / scale[k, 1]
            half = np.maximum(3.5 * np.sqrt(np.diag(spread)[:2]), 3 * tolerance_m) / scale[k]
            found = match_posterior(grid, Track(x, y, readings[picks]), half_width=tuple(half), tolerance_m=tolerance_m)
            if found.ok and found.covariance_m2 is not None:
                fix = (np.array(found.offset_m) + state[:2], WINDOW_WIDENING * found.covariance_m2)
        here = (float(flight.time_s[k]), float(shown.x[k]), float(shown.y[k]))
        step = feedback.step(*here) if fix is None else feedback.step(*here, offset_m=fix[0], covariance_m2=fix[1])
        tracked |= step.accepted
        error[k] = np.array([step.after.x - flight.x[k], step.after.y - flight.y[k]]) * scale[k]
        covariance[k] = step.after.covariance_m2
        if tracked:
            status[k] = "tracking"
    return error, covariance, 2.5 * _radii_m(covariance, 0.99), status
