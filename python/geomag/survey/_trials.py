"""Windows left out matched with one error model after another: which correlation length, which share of sigma, how risks are to be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from geomag._geomag import GridMap, Prediction, Track, match_posterior_many, predict_many
from geomag._statistics import normalised_squares
from geomag.survey._fit import (
    INTERCEPT_PRIOR,
    SLOPE_PRIOR,
    fit_covariance_factor,
    fit_forecast,
    fit_recalibration,
    recalibrated,
)
from geomag.survey._folds import Fold
from geomag.survey._levels import Levels
from geomag.survey._lines import Array
from geomag.survey._model import LEARNT_SPREAD, NU, REGISTRATION, Law, sigma_of
from geomag.survey._steps import Steps
from geomag.survey._surface import nearest
from geomag.survey._survey import Window, windows_of

#: Windows that are learnt from, where the lines give them; overlaps of neighbours and starts of one window that make up for lines that do not.
MOST_WINDOWS = 800
MOST_OVERLAP = 0.75
MOST_STARTS = 3
#: Windows that the line in log-odds of the chosen model is learnt from, where the lines give so many: a slope from 800 is known to a tenth, which at a risk of
#: 1 % is a factor of one and a half.
MOST_LINE_WINDOWS = 4000
#: Windows, half of them in half of the folds, from which a model is tried on those folds first, and no further where it is worse there.
WINDOWS_TO_HALVE = 400
#: Risks are counted as at least this: so many windows tell nothing of lesser ones.
LEAST_RISK = 0.002
#: Correlation lengths (in distances to the data): the first that is tried, the factor from one to the next, and how far they go.
FIRST_CORRELATION = 1.25
CORRELATION_STEP = 1.25
CORRELATION_RANGE = (0.2, 20.0)
#: Shares of the single-sample sigma that are tried. One sample's law has the worst tracks in it, which the spread of the level stands for
#: already: most tracks need less.
SHARES = (0.35, 0.5, 0.7, 1.0)
FIRST_SHARE = 0.5
#: What is believed of the two before a survey is seen: centre and standard deviation of the logarithm. A survey of a
#: few hundred windows moves them.
CORRELATION_PRIOR = (1.1, 0.55)
SHARE_PRIOR = (0.5, 0.35)
#: Statuses whose risk is no statement on the answer: the truth may lie elsewhere altogether.
NO_STATEMENT = ("at_edge", "lost", "rejected")
#: Parts of a window that are answered to as well, how unlikely an answer on a longer part may be for the shorter ones to be looked at, and the risks of
#: which the first answer within them counts: what a stream stops at.
PARTS = (0.85, 0.7, 0.55, 0.4)
LIKELY = 0.5
FIRST_RISKS = (0.1, 0.03, 0.01, 0.003)
#: Parts of every so many windows are answered to: four matches each for one number.
EVERY_FIRST = 2
#: Levels of error that flights are simulated with for the forecast, and the most windows that it is learnt from.
FORECAST_LEVELS = (1.0, 2.0, 4.0, 8.0)
FORECAST_WINDOWS = 200
#: Risk at which the forecast counts a fix.
FORECAST_RISK = 0.01
#: The fewest fixes that a forecast and a factor on covariances are learnt from.
FEWEST_FORETOLD = 20
#: Share of right fixes that the tests of misfit may refuse, the log evidence from which gains are looked at, the range of the threshold, and the
#: fewest right fixes that it is learnt from.
FALSE_ALARMS = 0.03
LEAST_GAIN = 1.0
MISFIT_RANGE = (4.0, 15.0)
FEWEST_FIXES = 60
#: No more fixes are tested once there are so many, which tell three in a hundred to one or so: a fold's map is continued to other heights for the tests.
ENOUGH_FIXES = 200


@dataclass(frozen=True)
class Settings:
    """How windows are flown: distance between samples, bound of the start error, tolerance, samples."""

    spacing_m: float
    half_width_m: float
    tolerance_m: float
    samples: int

    @staticmethod
    def of(
        line_spacing_m: float,
        spacing_m: float | None,
        half_width_m: float | None,
        tolerance_m: float | None,
        samples: int,
    ) -> Settings:
        """As told; what is not told in proportion to the line spacing."""
        return Settings(
            0.6 * line_spacing_m if spacing_m is None else spacing_m,
            4 * line_spacing_m if half_width_m is None else half_width_m,
            0.5 * line_spacing_m if tolerance_m is None else tolerance_m,
            samples,
        )


@dataclass(frozen=True)
class Point:
    """An error model that is tried: place of its correlation length on the ladder, share of sigma."""

    step: int = 0
    share: float = FIRST_SHARE

    @property
    def correlation(self) -> float:
        """Correlation length, in distances to the data."""
        return correlation_at(self.step)

    def unlikely(self, correlation_prior: tuple[float, float]) -> float:
        """Minus the logarithm of its prior."""
        told = (
            (self.correlation, correlation_prior),
            (self.share, SHARE_PRIOR),
        )
        return float(sum(0.5 * (np.log(value / centre) / spread) ** 2 for value, (centre, spread) in told))

    def neighbour(self, name: str, way: int) -> Point | None:
        """The next one along a coordinate, None at its end."""
        if name == "step":
            there = replace(self, step=self.step + way)
            return there if CORRELATION_RANGE[0] <= there.correlation <= CORRELATION_RANGE[1] else None
        place = SHARES.index(self.share) + way
        return replace(self, share=SHARES[place]) if 0 <= place < len(SHARES) else None


#: What an outcome says of every window.
ANSWERS = ("risk", "error_m", "wrong", "stated", "squares")


@dataclass
class Outcome:
    """What came of the windows under one error model: computed risk, error, whether beyond the tolerance, whether the status states anything, normalised error squared.

    `line` is that in log-odds by which the risks are then to be read.
    """

    risk: Array
    error_m: Array
    wrong: npt.NDArray[np.bool_]
    stated: npt.NDArray[np.bool_]
    squares: Array
    line: tuple[float, float] = (1.0, 0.0)
    total: float = 0.0

    @property
    def fixed(self) -> npt.NDArray[np.bool_]:
        """Which would be declared."""
        return self.stated & (recalibrated(self.risk, self.line) <= FORECAST_RISK)

    @property
    def loss(self) -> float:
        """Mean log loss of the risks as they are declared."""
        risk = np.clip(recalibrated(self.risk, self.line), LEAST_RISK, 1 - LEAST_RISK)
        return float(np.mean(-np.log(np.where(self.wrong, risk, 1 - risk))))


def flown(parts: list[Fold], settings: Settings, rng: np.random.Generator) -> float:
    """Give every fold the windows to learn from; returns which share of them has nothing in common with another."""
    apart = [part.covered(windows_of(part.left, settings.spacing_m, settings.samples)) for part in parts]
    alone = sum(map(len, apart))
    if 0 < alone < MOST_WINDOWS:
        overlap = min(MOST_OVERLAP, 1 - alone / MOST_WINDOWS)
        apart = [part.covered(windows_of(part.left, settings.spacing_m, settings.samples, overlap)) for part in parts]
    count = sum(map(len, apart))
    starts = 1 if count == 0 else min(MOST_STARTS, max(1, round(MOST_WINDOWS / count)))
    share = min(1.0, MOST_WINDOWS / max(count, 1))
    for part, windows in zip(parts, apart, strict=True):
        limit = int(np.ceil(share * len(windows)))
        chosen = np.sort(rng.choice(len(windows), limit, replace=False)) if windows else np.empty(0, dtype=int)
        part.windows = [windows[i] for i in chosen] * starts
        rest = np.setdiff1d(np.arange(len(windows)), chosen)
        most = int(len(windows) * MOST_LINE_WINDOWS / count) - limit if count else 0
        part.spare = [windows[i] for i in rest[:: max(1, -(-rest.size // max(most, 1)))]]
    return min(1.0, alone / max(sum(len(part.windows) for part in parts), 1))


@dataclass
class Trials:
    """The windows of all folds with their start errors, matched with one error model after another."""

    parts: list[Fold]
    law: Law
    abc: tuple[float, float, float]
    settings: Settings
    independent: float
    rng: np.random.Generator
    steps: Steps
    correlation_prior: tuple[float, float] = CORRELATION_PRIOR
    #: One a fold, or none.
    levels: list[Levels] = field(default_factory=list)
    #: Of all windows, and of those of half of the folds.
    seen: dict[Point, Outcome] = field(default_factory=dict)
    half: dict[Point, Outcome] = field(default_factory=dict)
    #: Of every fold, with the model that was chosen.
    whole: list[Outcome] = field(default_factory=list)
    _maps: dict[tuple[float, int], tuple[GridMap, Array]] = field(default_factory=dict)
    _answers: dict[tuple[Point, int], Outcome] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Draw the start errors."""
        axes = self.parts[0].axes
        self._scale = (axes.cell_m[0] / axes.x[1], axes.cell_m[1] / axes.y[1])
        self._half = (self.settings.half_width_m / self._scale[0], self.settings.half_width_m / self._scale[1])
        self._tracks, self._offsets = self._flown([part.windows for part in self.parts])
        on_axes = self.steps.side_by_side(lambda some: some.on(axes), self.levels)
        self._factors: list[Array | float] = [*on_axes] or [1.0] * len(self.parts)

    def _flown(self, windows: list[list[Window]]) -> tuple[list[list[Track]], list[Array]]:
        """Windows of every fold as tracks with a start error, and these errors."""
        offsets = [self.rng.uniform(-1, 1, (len(some), 2)) * self._half for some in windows]
        tracks = [
            [Track(x - o[0], y - o[1], v) for (x, y, v), o in zip(some, away, strict=True)]
            for some, away in zip(windows, offsets, strict=True)
        ]
        return tracks, offsets

    def maps(self, share: float, folds: Sequence[int] | None = None) -> list[tuple[GridMap, Array]]:
        """The maps of all folds, or of some, with their sigma at a share of that of single samples, and the distances to the data."""
        folds = range(len(self.parts)) if folds is None else folds
        a, b, c = (share * v for v in self.abc)

        def one(k: int) -> tuple[GridMap, Array]:
            part = self.parts[k]
            values = np.asarray(part.base.values, dtype=float)
            sigma = sigma_of(*part.features, part.distance, self.law, a, b, c) * self._factors[k]
            return layered(part.base, values, sigma, part.distance)

        missing = [k for k in folds if (share, k) not in self._maps]
        made = self.steps.side_by_side(one, missing)
        self._maps.update(zip([(share, k) for k in missing], made, strict=True))
        return [self._maps[share, k] for k in folds]

    def at(self, point: Point) -> Outcome:
        """What comes of the windows with an error model."""
        if point not in self.seen:
            self.seen[point] = self._tried(point, range(len(self.parts)))
        return self.seen[point]

    def at_half(self, point: Point) -> Outcome:
        """What comes of the windows of half of the folds."""
        if point not in self.half:
            self.half[point] = self._tried(point, range(len(self.parts) // 2))
        return self.half[point]

    def better(self, there: Point, here: Point) -> bool:
        """Whether one error model has less loss than another, which half of the folds may be enough to deny."""
        in_half = sum(map(len, self._tracks[: len(self.parts) // 2]))
        halved = 2 * in_half >= WINDOWS_TO_HALVE and there not in self.seen
        if halved and self.at_half(there).total >= self.at_half(here).total:
            return False
        return self.at(there).total < self.at(here).total

    def _tried(self, point: Point, folds: range) -> Outcome:
        """What comes of the windows of some folds, each of which is matched once."""
        missing = [k for k in folds if (point, k) not in self._answers]
        if missing:
            tracks, offsets = [self._tracks[k] for k in missing], [self._offsets[k] for k in missing]
            rows = self._answered(point, point.correlation, tracks, offsets, missing)
            for k, answers in zip(missing, rows, strict=True):
                self._answers[point, k] = answers
            self.steps.add(len(missing) / len(self.parts))
        # What counts is the risk that is declared, so that every model is judged by its best line.
        outcome = self._lined([self._answers[point, k] for k in folds])
        outcome.total = self.independent * outcome.loss * outcome.risk.size + point.unlikely(self.correlation_prior)
        priors = zip(outcome.line, (SLOPE_PRIOR, INTERCEPT_PRIOR), strict=True)
        outcome.total += sum(0.5 * ((value - centre) / spread) ** 2 for value, (centre, spread) in priors)
        return outcome

    def chosen(self, point: Point, correlation: float) -> Outcome:
        """What comes of the windows, and of those kept aside, with the model as it will be flown: its line is that of its own correlation length."""
        self.whole = self._answered(point, correlation, self._tracks, self._offsets)
        outcomes = list(self.whole)
        if any(part.spare for part in self.parts):
            outcomes += self._answered(point, correlation, *self._flown([part.spare for part in self.parts]))
        self.steps.add(1.0)
        return self._lined(outcomes)

    def _within(self, limit: float, line: tuple[float, float]) -> list[list[int]]:
        """The windows of every fold to which the chosen model's answer is a statement at a risk of at most so much."""
        return [list(np.flatnonzero(one.stated & (recalibrated(one.risk, line) <= limit))) for one in self.whole]

    def _lined(self, outcomes: list[Outcome]) -> Outcome:
        """Outcomes as one, those without an answer left out, with their line in log-odds."""
        columns = [np.concatenate([getattr(one, name) for one in outcomes]) for name in ANSWERS]
        known = np.isfinite(columns[0])
        out = Outcome(*(column[known] for column in columns))
        out.line = fit_recalibration(out.risk[out.stated], out.wrong[out.stated], self.independent, LEAST_RISK)
        return out

    def _answered(
        self,
        point: Point,
        correlation: float,
        tracks: list[list[Track]],
        offsets: list[Array],
        folds: Sequence[int] | None = None,
    ) -> list[Outcome]:
        """What comes of tracks with an error model, a fold of all or of some each; risk NaN where there is no answer."""

        def answers(part: tuple[tuple[GridMap, Array], list[Track], Array]) -> Outcome:
            (grid, distance), some, true = part
            model = modelled(grid, distance, correlation)
            # What the tests of misfit refuse is learnt afterwards, from what they find under the model that is chosen.
            fixes = match_posterior_many(
                model,
                some,
                half_width=self._half,
                tolerance_m=self.settings.tolerance_m,
                misfit_threshold=np.inf,
                progress=self.steps.waited_for,
            )
            n = len(fixes)
            risk, error_m, squares, stated = (
                np.full(n, np.nan),
                np.full(n, np.inf),
                np.full(n, np.inf),
                np.zeros(n, bool),
            )
            known = [k for k, fix in enumerate(fixes) if fix.risk is not None and fix.covariance_m2 is not None]
            if known:
                answered = [fixes[k] for k in known]
                away = (np.array([fix.offset for fix in answered]) - true[known]) * self._scale
                risk[known] = [fix.risk for fix in answered]
                error_m[known] = np.hypot(*away.T)
                squares[known] = normalised_squares(away, np.array([fix.covariance_m2 for fix in answered]))
                stated[known] = [fix.status not in NO_STATEMENT for fix in answered]
            return Outcome(risk, error_m, error_m > self.settings.tolerance_m, stated, squares)

        return self.steps.side_by_side(answers, list(zip(self.maps(point.share, folds), tracks, offsets, strict=True)))

    def first_answers(
        self, point: Point, correlation: float, line: tuple[float, float]
    ) -> tuple[Array, Array, npt.NDArray[np.bool_], Array]:
        """Answers on growing parts of the windows that are the first within a risk: that risk, how many times shorter the part is, whether wrong, weight.

        A stream stops at its first answer within its limit, on a track as short as that takes; the answers of one window share its weight.
        """
        n = self.settings.samples
        likely = enumerate(self._within(LIKELY, line))
        whole = [(k, i) for k, some in likely for i in some if len(self._tracks[k][i]) == n]
        whole = whole[::EVERY_FIRST]
        seen: dict[tuple[int, int], list[tuple[float, float, bool]]] = {one: [] for one in whole}
        left = whole
        for size in sorted({max(3, round(part * n)) for part in PARTS}, reverse=True):
            if size >= n or not left:
                continue
            groups = [[i for k, i in left if k == fold] for fold in range(len(self.parts))]
            tracks = [
                [Track(t.x[:size], t.y[:size], t.values[:size]) for t in (some[i] for i in group)]
                for some, group in zip(self._tracks, groups, strict=True)
            ]
            offsets = [some[group] for some, group in zip(self._offsets, groups, strict=True)]
            ratio = (n - 1) / (size - 1)
            left = []
            for k, (group, found) in enumerate(
                zip(groups, self._answered(point, correlation, tracks, offsets), strict=True)
            ):
                declared = recalibrated(found.risk, line)
                for i, risk, wrong, stated in zip(group, declared, found.wrong, found.stated, strict=True):
                    if stated and risk <= LIKELY:
                        seen[k, i].append((float(risk), ratio, bool(wrong)))
                        left.append((k, i))
        rows = []
        for answers in seen.values():
            ordered = answers[::-1]
            first = {next((k for k, a in enumerate(ordered) if a[0] <= limit), None) for limit in FIRST_RISKS} - {None}
            rows += [(*ordered[k], EVERY_FIRST * self.independent / len(first)) for k in first if k is not None]
        columns = np.array(rows, dtype=float).reshape(-1, 4).T
        return columns[0], columns[1], columns[2].astype(bool), columns[3]

    def search(self) -> tuple[Point, float]:
        """The error model of the least loss of those that were tried, and the correlation length of the least loss about it."""
        best = Point()
        while True:
            before = best
            for name in ("step", "share"):
                best = self._descend(best, name)
            if best == before:
                return best, self._between(best)

    def _descend(self, point: Point, name: str) -> Point:
        """Along one coordinate as long as the loss falls."""
        for way in (1, -1):
            moved = False
            there = point.neighbour(name, way)
            while there is not None and self.better(there, point):
                point, moved = there, True
                there = point.neighbour(name, way)
            if moved:
                break
        return point

    def _between(self, best: Point) -> float:
        """The lowest point of the parabola through the best correlation length and its neighbours."""
        points = [replace(best, step=best.step + k) for k in (-1, 0, 1)]
        among = next((some for some in (self.seen, self.half) if all(one in some for one in points)), None)
        if among is None:
            return best.correlation
        low, middle, high = (among[one].total for one in points)
        bend = low - 2 * middle + high
        shift = 0.0 if bend <= 0 else float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))
        return correlation_at(best.step + shift)

    def covariance_factor(self, best: Outcome) -> float | None:
        """Factor from the computed covariance to the declared one, by what came of the windows that would be declared; None where these are too few to tell."""
        fixed = best.fixed
        return fit_covariance_factor(best.squares[fixed], self.independent) if fixed.sum() >= FEWEST_FORETOLD else None

    def forecast(self, best: Outcome, point: Point, correlation: float) -> tuple[float, float, float] | None:
        """Level of error of simulated flights, and what fixes are off by, that agree with what came of the windows."""
        law = self._foretold(point, correlation, best.line)
        if law is None:
            return None
        # Without the tests of misfit, as what was seen.
        observed = float(best.fixed.mean())
        total = sum(len(part.windows) for part in self.parts)
        keep = max(1, round(total / FORECAST_WINDOWS))
        tracks = [[Track(x, y, v) for x, y, v in part.windows[::keep]] for part in self.parts]
        shares: list[float] = []
        for level in FORECAST_LEVELS:
            fixes: list[bool] = []
            for k, (grid, distance) in enumerate(self.maps(point.share)):
                if not tracks[k]:
                    continue
                model = modelled(grid, distance, correlation, best.line, (level, 1.0))
                found = self._predicted(model, tracks[k], flights=1, seed=k)
                fixes += [one.fix_probability > 0 for one in found if one is not None]
            shares.append(float(np.mean(fixes)) if fixes else 0.0)
            self.steps.add(1.0)
            if shares[-1] <= observed:
                break
        logs = np.log(FORECAST_LEVELS[: len(shares)])
        order = np.argsort(shares)
        level = float(np.exp(np.interp(observed, np.array(shares)[order], logs[order])))
        return (level, *law)

    def _foretold(self, point: Point, correlation: float, line: tuple[float, float]) -> tuple[float, float] | None:
        """Spread and registration of the windows that would be declared; None where these are too few to tell."""
        fixed = self._within(FORECAST_RISK, line)
        rows: list[tuple[float, float, float]] = []
        for (grid, distance), part, some, outcome in zip(
            self.maps(point.share), self.parts, fixed, self.whole, strict=True
        ):
            windows = [part.windows[i] for i in some]
            if not windows:
                continue
            model = modelled(grid, distance, correlation, line)
            found = self._predicted(model, [Track(x, y, v) for x, y, v in windows], flights=0, seed=0)
            for one, error, (x, y, _) in zip(found, outcome.error_m[some], windows, strict=True):
                away = float(np.nanmean(nearest(part.distance, part.axes, x, y)))
                if one is not None:
                    rows.append(
                        (float(np.trace(one.covariance_m2)), away, min(float(error), self.settings.tolerance_m))
                    )
        if len(rows) < FEWEST_FORETOLD:
            return None
        trace, distance_m, error_m = np.array(rows).T
        return fit_forecast(trace, distance_m, error_m, self.independent)

    def _predicted(self, model: GridMap, tracks: list[Track], flights: int, seed: int) -> list[Prediction | None]:
        """What is foretold of planned windows on a map."""
        return predict_many(
            model,
            tracks,
            half_width=self._half,
            tolerance_m=self.settings.tolerance_m,
            max_risk=FORECAST_RISK,
            misfit_threshold=np.inf,
            flights=flights,
            seed=seed,
            progress=self.steps.waited_for,
        )

    def misfit_threshold(self, point: Point, correlation: float, line: tuple[float, float]) -> float | None:
        """Log evidence that an effect must gain so that a few percent of the right fixes are refused; None where these are too few to tell."""
        gains: list[float] = []
        # Only what would be declared is tested.
        fixed = self._within(2 * FORECAST_RISK, line)
        for (grid, distance), tracks, away, some in zip(
            self.maps(point.share), self._tracks, self._offsets, fixed, strict=True
        ):
            if not some or len(gains) >= ENOUGH_FIXES:
                continue
            model = modelled(grid, distance, correlation, line)
            fixes = match_posterior_many(
                model,
                [tracks[i] for i in some],
                half_width=self._half,
                tolerance_m=self.settings.tolerance_m,
                max_risk=FORECAST_RISK,
                misfit_threshold=LEAST_GAIN,
                progress=self.steps.waited_for,
            )
            for fix, offset in zip(fixes, away[some], strict=True):
                error = np.hypot(*((np.array(fix.offset) - offset) * self._scale))
                if (fix.ok or fix.misfit is not None) and error <= self.settings.tolerance_m:
                    gains.append(0.0 if fix.misfit is None else fix.misfit[2])
        self.steps.add(1.0)
        if len(gains) < FEWEST_FIXES:
            return None
        return float(np.clip(np.quantile(gains, 1 - FALSE_ALARMS), *MISFIT_RANGE))


def correlation_at(step: float) -> float:
    """Correlation length of a place on the ladder."""
    return float(FIRST_CORRELATION * CORRELATION_STEP**step)


def modelled(
    grid: GridMap,
    distance: Array,
    correlation: float,
    line: tuple[float, float] | None = None,
    forecast: tuple[float, float] | None = None,
) -> GridMap:
    """A map of some of the lines with the error model that is tried on it."""
    return grid.with_error_model(
        nu=NU,
        scale_spread=LEARNT_SPREAD,
        correlation=correlation,
        registration=REGISTRATION,
        distance_m=distance,
        recalibration=line,
        forecast=forecast,
    )


def layered(
    grid: GridMap, values: Array, sigma: Array, distance: Array, line_spacing_m: float | None = None
) -> tuple[GridMap, Array]:
    """`grid` with other values and their sigma, and the distances; a node without any of them becomes a hole."""
    known = np.isfinite(values) & np.isfinite(sigma)
    out = GridMap(
        np.where(known, values, np.nan),
        grid.x,
        grid.y,
        geographic=grid.geographic,
        sigma=np.where(known, sigma, np.nan),
        name=grid.name,
        units=grid.units,
        crs=grid.crs,
        height_m=grid.height_m,
        ground_scale=grid.ground_scale,
        line_spacing_m=grid.line_spacing_m if line_spacing_m is None else line_spacing_m,
    )
    return out, np.where(known, distance, np.nan)
