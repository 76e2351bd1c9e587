"""Many seeded trials: how often a matcher finds the truth, how far off it is, how often it is wrong unsaid.

A trial is a flight of `geomag.synthetic` and a match of it. Everything random in trial i follows from the campaign's
seed and i alone: any subset, order, number of threads or workers gives the same rows. On one machine the trials of
geomag's own matchers run in Rust on all cores; beyond it, on any `concurrent.futures` executor or Dask client.

>>> from geomag import campaign, synthetic
>>> grid = synthetic.Crust().draw((0, 0, 60_000, 60_000), seed=1).grid(500.0, units="nT")
>>> plan = campaign.Campaign(
...     grid,
...     tracks=campaign.RandomTracks(samples=30, spacing_m=(500.0, 1000.0)),
...     ins=synthetic.InsSpread(synthetic.Uniform((3000.0, 3000.0))),
...     sensor=synthetic.Sensor(sigma=1.0),
...     seed=7,
... )
>>> table = plan.run(campaign.grid_search("msd", half_width=3500.0, sigma=2.0), trials=200)
>>> len(table), table.summary(tolerance_m=500.0).wrong
(200, 0)
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
import time
import traceback
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, wait
from dataclasses import dataclass, field
from functools import partial
from operator import index
from pathlib import Path as FilePath
from types import CodeType, FunctionType
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geomag import _progress
from geomag._errors import GeomagError, InvalidInputError, ReadError, StateError
from geomag._geomag import Fix, GridMap, Path, SyntheticField, Track, __version__, campaign_flight, campaign_rows
from geomag._optional import require
from geomag._statistics import binomial_interval
from geomag.synthetic import Flight, InsSpread, Sensor, _as_dict, _seed

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

__all__ = ["Campaign", "Keyed", "Method", "RandomTracks", "Summary", "Table", "contour", "grid_search", "iema",
           "posterior"]  # fmt: skip

#: Greatest number of trials of one run.
MOST_TRIALS = 10_000_000

Matcher = Callable[[GridMap, Track], Fix]
"""A matcher of one's own: takes map and track, returns a `Fix`."""


@dataclass(frozen=True)
class RandomTracks:
    """True tracks drawn anew for every trial, straight or on one arc.

    Start and course are uniform over what keeps the whole track on the map (within `margin`) and off its holes.
    """

    samples: int = 30
    """Samples in a track."""
    spacing_m: tuple[float, float] = (1000.0, 1000.0)
    """Distance between samples (least, greatest); one value a track."""
    course_deg: tuple[float, float] = (0.0, 360.0)
    """Course at the start (least, greatest)."""
    turn_deg: float = 0.0
    """Greatest turn over the whole track to either side; one value a track."""
    speed_m_s: float = 100.0
    """With the spacing it gives the time between samples."""
    margin: tuple[float, float] = (0.0, 0.0)
    """How far from the border of the map the true track stays, map units (x, y)."""


@dataclass(frozen=True)
class Method:
    """One of geomag's matchers with its options, to be run in Rust. Made by `iema`, `grid_search` and their like."""

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {self.kind: dict(self.options)}


@dataclass(frozen=True)
class Keyed:
    """A matcher of one's own under a key that stands for it in a folder of results.

    For lambdas, closures and whatever else cannot be told from its like. The key is to change when the answers do.

    >>> from geomag import campaign, match_grid
    >>> method = campaign.Keyed("msd, 900 m", lambda grid, track: match_grid(grid, track, half_width=900.0))
    """

    key: str
    matcher: Matcher

    def __call__(self, grid: GridMap, track: Track) -> Fix:
        """Match, as the matcher does."""
        return self.matcher(grid, track)


def _pair(value: float | Sequence[float]) -> list[float]:
    try:
        pair = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        pair = np.empty(0)
    if pair.shape not in ((), (2,)) or not np.isfinite(pair).all():
        raise InvalidInputError(f"needed a finite number or a pair (x, y), got {value!r}")
    return [float(v) for v in np.broadcast_to(pair, 2)]


def _json_of(name: str, options: Mapping[str, Any]) -> str:
    """Options as JSON; NumPy's numbers and arrays as plain ones."""

    def plain(value: object) -> object:
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        raise InvalidInputError(f"method {name!r}: needed options that are numbers, words or arrays, got {value!r}")

    return json.dumps(dict(options), default=plain)


def iema(
    *,
    sigma: float,
    half_width: float | Sequence[float],
    tolerance: float | Sequence[float] = 0.0,
    step: float | Sequence[float] | None = None,
    max_misses: int = 0,
    gate: float = 3.0,
    unknown: str = "keep",
) -> Method:
    """Return streaming IEMA, stopped at its first fix; options as in `geomag.Iema`."""
    options: dict[str, Any] = {
        "sigma": float(sigma), "half_width": _pair(half_width), "tolerance": _pair(tolerance),
        "step": None if step is None else _pair(step), "max_misses": int(max_misses), "gate": float(gate),
        "unknown": unknown.capitalize(),
    }  # fmt: skip
    return Method("iema", options)


def grid_search(
    criterion: str = "msd",
    *,
    half_width: float | Sequence[float],
    step: float | Sequence[float] | None = None,
    heading_deg: Sequence[float] = (0.0,),
    scale: Sequence[float] = (1.0,),
    remove_mean: bool = False,
    sigma: float | None = None,
    ambiguity: float = 0.01,
    min_overlap: float = 0.8,
    refine: bool = True,
    length_scale_m: float | None = None,
    value_scale: float | None = None,
    fraction: float = 1.0,
) -> Method:
    """Return a grid search over the whole track; options as in `geomag.match_grid`.

    The last three are of the Hausdorff measure; scales that are not given are those of each trial's own track.
    """
    names = ("msd", "mad", "prod", "ncc", "hausdorff")
    if criterion not in names:
        raise InvalidInputError(f"criterion: needed one of {', '.join(names)}, got {criterion!r}")
    options: dict[str, Any] = {
        "half_width": _pair(half_width),
        "step": None if step is None else _pair(step), "heading_deg": [float(h) for h in heading_deg],
        "scale": [float(s) for s in scale], "remove_mean": bool(remove_mean),
        "sigma": None if sigma is None else float(sigma), "ambiguity": float(ambiguity),
        "min_overlap": float(min_overlap), "refine": bool(refine),
    }  # fmt: skip
    if criterion == "hausdorff":
        scales = {"length_scale_m": length_scale_m, "value_scale": value_scale}
        told = {name: None if scale is None else float(scale) for name, scale in scales.items()}
        return Method("hausdorff", {**options, **told, "fraction": float(fraction)})
    if (length_scale_m, value_scale, fraction) != (None, None, 1.0):
        raise InvalidInputError(
            f"length_scale_m, value_scale, fraction: needed criterion 'hausdorff', got {criterion!r}"
        )
    return Method("grid", {"criterion": criterion.capitalize(), **options})


def posterior(
    *,
    half_width: float | Sequence[float],
    sigma: float | None = None,
    step: float | Sequence[float] | None = None,
    **options: float | None,
) -> Method:
    """Return calibrated matching over the whole track; options as in `geomag.match_posterior`."""
    told: dict[str, Any] = {
        "half_width": _pair(half_width), "sigma": sigma, "step": None if step is None else _pair(step), **options,
    }  # fmt: skip
    return Method("posterior", told)


def contour(**options: Any) -> Method:  # noqa: ANN401 - those of match_contour
    """Return contour matching (ICCP) over the whole track; options as in `geomag.match_contour`."""
    return Method("contour", options)


@dataclass(frozen=True)
class Summary:
    """What a table of trials comes to. Errors are of the fixes declared, metres."""

    trials: int
    fixed: int
    wrong: int
    """Fixes whose error is beyond the tolerance."""
    tolerance_m: float
    fix_rate: float
    wrong_rate: float
    """Wrong fixes over fixes; NaN without a fix."""
    wrong_rate_interval: tuple[float, float]
    """Its exact 95 % binomial interval."""
    median_m: float
    """Median error: the circular error probable (CEP)."""
    drms_m: float
    """Root mean square error (DRMS)."""
    error_95_m: float
    """95 % of the fixes are better."""
    samples_median: float
    samples_99: float
    ins_median_m: float
    """Median error of the INS at the same samples."""
    nees: float
    """Mean normalised error squared of fixes with a covariance: 2 where it is honest; NaN where there is none."""
    statuses: Mapping[str, int]
    """Count of every status."""

    def __str__(self) -> str:
        low, high = self.wrong_rate_interval
        return (
            f"{self.fixed} of {self.trials} fixed ({self.fix_rate:.1%}), {self.wrong} wrong by over "
            f"{self.tolerance_m:g} m ({self.wrong_rate:.2%} of fixes, 95 % interval {low:.2%} to {high:.2%}); "
            f"error median {self.median_m:.1f} m, DRMS {self.drms_m:.1f} m, 95 % {self.error_95_m:.1f} m; "
            f"samples median {self.samples_median:.0f}, 99 % {self.samples_99:.0f}"
        )


class Table:
    """One row a trial, in the order of the trials: a mapping from column names to arrays.

    Columns: `trial, status, n_samples, iterations, true_x, true_y` (map units), `error_m, error_east_m, error_north_m`
    (fix minus truth), `ins_error_east_m, ins_error_north_m` (indicated minus truth), `risk, goodness,
    covariance_ee_m2, covariance_en_m2, covariance_nn_m2, score, runner_up`; NaN where a method gives none.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        order = np.argsort(columns["trial"], kind="stable")
        self.columns: dict[str, NDArray[Any]] = {name: np.asarray(values)[order] for name, values in columns.items()}

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self.columns[name]
        except KeyError:
            raise InvalidInputError(f"column: needed one of {', '.join(self.columns)}, got {name!r}") from None

    def __len__(self) -> int:
        return int(self.columns["trial"].size)

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def equals(self, other: Table) -> bool:
        """Whether every bit of every column is the same (NaN equals NaN)."""
        return list(self) == list(other) and all(
            self[c].dtype == other[c].dtype and self[c].tobytes() == other[c].tobytes() for c in self
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return the table as a pandas data frame with the trial as its index."""
        pandas = require("pandas", "io", "campaign tables as data frames")
        return cast("pd.DataFrame", pandas.DataFrame(self.columns).set_index("trial"))

    def summary(self, tolerance_m: float) -> Summary:
        """Summarise: fix rate, wrong fixes beyond `tolerance_m` with their interval, errors, samples needed."""
        if not tolerance_m > 0:
            raise InvalidInputError(f"tolerance_m: needed a number > 0, got {tolerance_m}")
        ok = self["status"] == "fixed"
        errors = self["error_m"][ok]
        fixed, wrong = int(ok.sum()), int((errors > tolerance_m).sum())
        none = fixed == 0

        def percentile(values: NDArray[Any], q: float) -> float:
            return float(np.percentile(values, q)) if values.size else math.nan

        names, counts = np.unique(self["status"], return_counts=True)
        return Summary(
            trials=len(self),
            fixed=fixed,
            wrong=wrong,
            tolerance_m=float(tolerance_m),
            fix_rate=fixed / len(self) if len(self) else math.nan,
            wrong_rate=math.nan if none else wrong / fixed,
            wrong_rate_interval=binomial_interval(wrong, fixed),
            median_m=percentile(errors, 50),
            drms_m=math.nan if none else float(np.sqrt(np.mean(errors**2))),
            error_95_m=percentile(errors, 95),
            samples_median=percentile(self["n_samples"][ok], 50),
            samples_99=percentile(self["n_samples"][ok], 99),
            ins_median_m=percentile(np.hypot(self["ins_error_east_m"], self["ins_error_north_m"]), 50),
            nees=self._nees(ok),
            statuses={str(n): int(c) for n, c in zip(names, counts, strict=True)},
        )

    def _nees(self, ok: NDArray[np.bool_]) -> float:
        e, n = self["error_east_m"][ok], self["error_north_m"][ok]
        ee, en, nn = (self[f"covariance_{c}_m2"][ok] for c in ("ee", "en", "nn"))
        determinant = ee * nn - en * en
        good = determinant > 0
        if not good.any():
            return math.nan
        squared = (nn * e * e - 2 * en * e * n + ee * n * n)[good] / determinant[good]
        return float(squared.mean())

    def __repr__(self) -> str:
        return f"Table({len(self)} trials, {int((self['status'] == 'fixed').sum())} fixed)"


def _join(parts: Sequence[Mapping[str, NDArray[Any]]]) -> Table:
    return Table({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


@dataclass(frozen=True)
class Campaign:
    """What is drawn in every trial.

    Parameters
    ----------
    grid : the stored map that matchers are given; random tracks stay on it.
    tracks : true tracks: a plan to draw them, or one `Path` for all trials.
    ins : what INS errors are drawn from.
    sensor : what the sensor gets wrong.
    seed : of the whole campaign.
    truth : the true field, where it is not the map itself: then the map's own errors count too.
    """

    grid: GridMap
    tracks: RandomTracks | Path = RandomTracks()
    ins: InsSpread = field(default_factory=InsSpread)
    sensor: Sensor = field(default_factory=Sensor)
    seed: int = 0
    truth: GridMap | SyntheticField | None = None

    def _json(self) -> str:
        if isinstance(self.tracks, Path):
            path = self.tracks
            points = {"x": path.x.tolist(), "y": path.y.tolist(), "time_s": path.time_s.tolist()}
            tracks: dict[str, Any] = {"fixed": {**points, "geographic": path.geographic}}
        else:
            tracks = {"random": _as_dict(self.tracks)}
        plan = {"seed": _seed(self.seed), "tracks": tracks, "ins": _as_dict(self.ins), "sensor": _as_dict(self.sensor)}
        return json.dumps(plan)

    def flight(self, trial: int) -> Flight:
        """Return the flight of one trial: true path, indicated track, true field."""
        (number,) = _numbers([trial])
        path, track, truth = campaign_flight(self.grid, self.truth, self._json(), number)
        return Flight(path, track, truth)

    def run(
        self,
        method: Method | Matcher,
        trials: int | Sequence[int],
        *,
        executor: Executor | object | None = None,
        chunk: int | None = None,
        folder: str | os.PathLike[str] | None = None,
        threads: int | None = None,
        progress: bool | Callable[[int, int], object] | None = None,
        retries: int = 3,
    ) -> Table:
        """Run trials and return one row for each.

        Parameters
        ----------
        method : one of geomag's matchers (`iema(...)`, `grid_search(...)`, ...), or a callable (grid, track) -> Fix.
        trials : how many (0, 1, ... n - 1), or their numbers; at most 10,000,000.
        executor : a `concurrent.futures.Executor` or a `distributed.Client`; this process where not given.
            Chunks whose worker dies are given out again.
        chunk : trials handed out at a time.
        folder : where finished chunks are kept; a run that was interrupted goes on from there. A matcher of one's own
            is known again by its name, code and arguments, but not by what it reads or calls elsewhere; lambdas and
            closures need a `Keyed`.
        threads : threads a process uses for geomag's own matchers; all cores by default, one a worker with an executor.
        progress : True for a bar with the time to go, or a callable (done, total).
        retries : how often a chunk whose worker died is given out again.

        Raises
        ------
        StateError
            Where `folder` holds another campaign.

        What a matcher raises ends the run at once, in a worker as here: it would raise again.
        """
        return self.compare({"method": method}, trials, executor=executor, chunk=chunk, folder=folder, threads=threads,
                            progress=progress, retries=retries)["method"]  # fmt: skip

    def compare(
        self,
        methods: Mapping[str, Method | Matcher],
        trials: int | Sequence[int],
        *,
        executor: Executor | object | None = None,
        chunk: int | None = None,
        folder: str | os.PathLike[str] | None = None,
        threads: int | None = None,
        progress: bool | Callable[[int, int], object] | None = None,
        retries: int = 3,
    ) -> dict[str, Table]:
        """Run every method on identical flights; one table a name. Arguments as in `run`."""
        numbers = _numbers(trials)
        if not methods:
            raise InvalidInputError("methods: needed at least one, got none")
        work = _Work(self, dict(methods))
        report = _reporter(progress)
        if chunk is None:
            chunk = max(1, min(10_000, math.ceil(len(numbers) / 100))) if executor or folder else max(1, len(numbers))
        if chunk < 1:
            raise InvalidInputError(f"chunk: needed at least 1, got {chunk}")
        chunks = [tuple(numbers[i : i + chunk]) for i in range(0, len(numbers), chunk)]
        store = None if folder is None else _Store(FilePath(folder), work.fingerprint())
        parts: dict[int, _Part] = {}
        if store is not None:
            parts = {i: part for i, c in enumerate(chunks) if (part := store.load(c)) is not None}
        left = [i for i in range(len(chunks)) if i not in parts]
        done = sum(len(chunks[i]) for i in parts)

        def finished(i: int, part: _Part) -> None:
            nonlocal done
            if i in parts:  # a worker that was thought dead came back: its rows are the same and count once
                return
            if store is not None:
                store.save(chunks[i], part)
            parts[i] = part
            done += len(chunks[i])
            report(done, len(numbers))

        if executor is None:
            for i in left:
                before = done

                def within(d: int, _: int, before: int = before) -> None:
                    report(before + d, len(numbers))

                finished(i, work(chunks[i], threads, within if progress else None))
        else:
            _distribute(executor, work, chunks, left, threads=threads or 1, retries=retries, finished=finished)
        ordered = [parts[i] for i in range(len(chunks))]
        return {name: _join([part[k] for part in ordered]) for k, name in enumerate(methods)}


_Part = list[dict[str, "NDArray[Any]"]]


def _numbers(trials: int | Sequence[int]) -> list[int]:
    try:
        several = trials if isinstance(trials, Sequence | np.ndarray) else range(index(trials))
        if len(several) > MOST_TRIALS:
            raise InvalidInputError(f"trials: needed at most {MOST_TRIALS}, got {len(several)}")
        numbers = [index(t) for t in several]
    except TypeError as error:
        raise InvalidInputError(f"trials: needed a whole number, or several, got {trials!r}") from error
    if not numbers:
        raise InvalidInputError("trials: needed at least one, got none")
    if min(numbers) < 0 or len(set(numbers)) != len(numbers):
        raise InvalidInputError("trials: needed distinct numbers >= 0, got some negative or twice")
    return numbers


def _reporter(progress: bool | Callable[[int, int], object] | None) -> Callable[[int, int], object]:
    if callable(progress):
        return progress
    return _progress.bar() if progress else lambda done, total: None


@dataclass(frozen=True)
class _Work:
    """Picklable: all that a worker needs to run any chunk."""

    campaign: Campaign
    methods: Mapping[str, Method | Matcher]

    def fingerprint(self) -> dict[str, Any]:
        """What a folder of results must have been made with."""
        digest = hashlib.sha256()
        for source in (self.campaign.grid, self.campaign.truth):
            # What a pickle is made of is all that answers can depend on: sigma, error model and coordinates too.
            _feed(digest, None if source is None else source.__reduce__()[1])
        plan = json.loads(self.campaign._json())
        # A list, because the rows of the methods are stored in this order.
        named = [[name, _identity(name, method)] for name, method in self.methods.items()]
        return {"geomag": __version__, "campaign": plan, "methods": named, "maps": digest.hexdigest()}

    def __call__(
        self, trials: Sequence[int], threads: int | None, progress: Callable[[int, int], object] | None = None
    ) -> _Part:
        plan = self.campaign
        ours = {name: m for name, m in self.methods.items() if isinstance(m, Method)}
        rows: dict[str, dict[str, Any]] = {}
        if ours:
            methods = [(m.kind, _json_of(name, m.options), dict(m.options)) for name, m in ours.items()]
            done = campaign_rows(plan.grid, plan.truth, plan._json(), methods, list(trials), threads, progress)
            rows.update(zip(ours, done, strict=True))
        theirs = {name: m for name, m in self.methods.items() if not isinstance(m, Method)}
        if theirs:
            rows.update(_run_in_python(plan, theirs, trials))
        return [rows[name] for name in self.methods]


def _feed(digest: Any, value: object) -> None:  # noqa: ANN401 - hashlib's type has no public name
    """Add a value to a digest, kinds and lengths included, so that no two values run together."""
    digest.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, (tuple, list)):
        digest.update(str(len(value)).encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, Mapping):
        _feed(digest, sorted(value.items()))
    elif isinstance(value, bytes):
        digest.update(f"{len(value)}:".encode())
        digest.update(value)
    elif isinstance(value, frozenset):  # of constants; its order changes from run to run
        _feed(digest, sorted(map(repr, value)))
    elif isinstance(value, CodeType):
        _feed(digest, (value.co_code, value.co_names, value.co_consts))
    else:
        digest.update(f"{value!r};".encode())


def _digest(value: object) -> str:
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _identity(name: str, matcher: object) -> object:
    """What a method is known by in a folder of results, plain values."""
    if isinstance(matcher, Method):
        return {matcher.kind: json.loads(_json_of(name, matcher.options))}
    if isinstance(matcher, Keyed):
        return {"key": matcher.key}
    if isinstance(matcher, partial):
        inner = _identity(name, matcher.func)
        return {"partial": inner, "arguments": _pickled(name, (matcher.args, sorted(matcher.keywords.items())))}
    if isinstance(matcher, FunctionType):
        if "<" in matcher.__qualname__ or matcher.__closure__:
            raise _unknown(name, matcher, "one of many that its name may stand for")
        code = _digest(matcher.__code__)
        defaults = _pickled(name, (matcher.__defaults__, matcher.__kwdefaults__))
        return {"function": f"{matcher.__module__}.{matcher.__qualname__}", "code": code, "defaults": defaults}
    call = getattr(matcher, "__func__", None) or vars(type(matcher)).get("__call__")
    code = _digest(call.__code__) if isinstance(call, FunctionType) else ""
    return {"object": type(matcher).__qualname__, "code": code, "state": _pickled(name, matcher)}


def _pickled(name: str, value: object) -> str:
    try:
        return hashlib.sha256(pickle.dumps(value, protocol=5)).hexdigest()
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise _unknown(name, value, str(error)) from error


def _unknown(name: str, matcher: object, why: str) -> InvalidInputError:
    return InvalidInputError(
        f"method {name!r}: needed, to be known again in a folder, a function of a module, a partial of one, a callable "
        f"object that pickles, or campaign.Keyed(key, matcher), got {matcher!r} ({why})"
    )


def _run_in_python(plan: Campaign, methods: Mapping[str, Matcher], trials: Sequence[int]) -> dict[str, dict[str, Any]]:
    """Run matchers that are Python callables, one trial after the other."""
    lists: dict[str, dict[str, list[Any]]] = {name: {c: [] for c in _COLUMNS} for name in methods}
    for trial in trials:
        flight = plan.flight(trial)
        for name, matcher in methods.items():
            fix: object = matcher(plan.grid, flight.track)
            if not isinstance(fix, Fix):
                got = type(fix).__name__
                raise InvalidInputError(f"method {name!r}: needed a callable that returns a Fix, got {got}")
            at = min(max(fix.n_samples, 1), len(flight.track)) - 1
            for column, value in _row(plan.grid, flight, fix, at, trial).items():
                lists[name][column].append(value)
    return {n: {c: np.array(v, dtype=_COLUMNS[c]) for c, v in columns.items()} for n, columns in lists.items()}


_COLUMNS: dict[str, str] = {
    "trial": "u8", "status": "U13", "n_samples": "u4", "iterations": "u4", "true_x": "f8", "true_y": "f8",
    "error_m": "f8", "error_east_m": "f8", "error_north_m": "f8", "ins_error_east_m": "f8", "ins_error_north_m": "f8",
    "risk": "f8", "goodness": "f8", "covariance_ee_m2": "f8", "covariance_en_m2": "f8", "covariance_nn_m2": "f8",
    "score": "f8", "runner_up": "f8",
}  # fmt: skip


def _row(grid: GridMap, flight: Flight, fix: Fix, at: int, trial: int) -> dict[str, Any]:
    path, track = flight.path, flight.track
    point = Path([path.x[at]], [path.y[at]], [path.time_s[at]], geographic=grid.geographic)

    def error(x: float, y: float) -> tuple[float, float]:
        if not (math.isfinite(x) and math.isfinite(y)):
            return math.nan, math.nan
        east, north = point.offset_m(Track([x], [y], [0.0]))
        return -east, -north

    (east, north), (ins_east, ins_north) = error(fix.x, fix.y), error(track.x[at], track.y[at])
    covariance = np.full((2, 2), np.nan) if fix.covariance_m2 is None else np.asarray(fix.covariance_m2)
    return {
        "trial": trial, "status": fix.status, "n_samples": fix.n_samples, "iterations": fix.iterations,
        "true_x": path.x[at], "true_y": path.y[at], "error_m": math.hypot(east, north), "error_east_m": east,
        "error_north_m": north, "ins_error_east_m": ins_east, "ins_error_north_m": ins_north,
        "risk": math.nan if fix.risk is None else fix.risk,
        "goodness": math.nan if fix.goodness is None else fix.goodness,
        "covariance_ee_m2": covariance[0, 0], "covariance_en_m2": covariance[0, 1],
        "covariance_nn_m2": covariance[1, 1], "score": fix.score, "runner_up": fix.runner_up,
    }  # fmt: skip


@dataclass(frozen=True)
class _Raised:
    """What the work itself raised in a worker: told apart from a worker's death, which another attempt may mend."""

    error: Exception


def _call(work: _Work, trials: Sequence[int], threads: int) -> _Part | _Raised:
    """Run in a worker."""
    try:
        return work(trials, threads)
    except Exception as error:
        error.add_note(f"in trials {trials[0]} to {trials[-1]} of a campaign:\n{traceback.format_exc()}")
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # an exception that does not travel: its words do
            return _Raised(GeomagError(f"campaign: trials {trials[0]} to {trials[-1]} failed ({error!r})"))
        return _Raised(error.with_traceback(None))


def _keep(work: _Work) -> _Work:
    """Hold the maps on a cluster as a task's result: unlike scattered data it is made anew when its worker dies."""
    return work


def _distribute(
    executor: object,
    work: _Work,
    chunks: Sequence[tuple[int, ...]],
    left: Sequence[int],
    *,
    threads: int,
    retries: int,
    finished: Callable[[int, _Part], None],
) -> None:
    """Give chunks out, take rows in; chunks that died with their worker are given out again."""
    on_dask = not isinstance(executor, Executor) and hasattr(executor, "get_executor")
    if not on_dask and not isinstance(executor, Executor):
        raise InvalidInputError(
            f"executor: needed a concurrent.futures.Executor or a distributed.Client, got {type(executor).__name__}"
        )
    pool: Any = executor
    payload: Any = pool.submit(_keep, work, pure=False) if on_dask else work
    options: dict[str, Any] = {"pure": False} if on_dask else {}

    def submit(i: int) -> Any:  # noqa: ANN401 - a future of either kind
        return pool.submit(_call, payload, chunks[i], threads, **options)

    attempts = dict.fromkeys(left, 0)
    waiting: dict[Any, int] = {submit(i): i for i in left}
    completed = _dask_completed(waiting) if on_dask else _completed(waiting)
    try:
        for future in completed:
            i = waiting.pop(future)
            try:
                part = future.result()
            except Exception as error:
                attempts[i] += 1
                if attempts[i] > retries:
                    raise GeomagError(
                        f"campaign: trials {chunks[i][0]} to {chunks[i][-1]} failed {attempts[i]} times ({error!r})"
                    ) from error
                try:
                    waiting[submit(i)] = i
                except RuntimeError as broken:
                    raise GeomagError(
                        f"campaign: the executor takes no more work ({broken}); finished chunks are kept where a folder "
                        "was given, and a new run with a new executor goes on from there"
                    ) from error
                continue
            if isinstance(part, _Raised):
                raise part.error
            finished(i, part)
    finally:
        for future in waiting:
            future.cancel()


def _completed(waiting: Mapping[Any, int]) -> Iterator[Any]:
    """Futures as they are done, those that are added meanwhile too."""
    while waiting:
        yield from wait(waiting, return_when=FIRST_COMPLETED).done


def _dask_completed(waiting: Mapping[Any, int]) -> Iterator[Any]:
    """`_completed` for the futures of a Dask client."""
    distributed = require("distributed", "distributed", "running on a Dask client")
    while waiting:
        yield from distributed.wait(list(waiting), return_when="FIRST_COMPLETED").done


class _Store:
    """Finished chunks in a folder, each written whole or not at all."""

    def __init__(self, folder: FilePath, fingerprint: dict[str, Any]) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        plan = folder / "campaign.json"
        if plan.exists():
            try:
                held = json.loads(plan.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise ReadError(f"{plan}: needed a campaign's settings, got something unreadable ({error})") from error
            if not isinstance(held, dict):
                raise ReadError(f"{plan}: needed a campaign's settings, got {type(held).__name__}")
            if held != fingerprint:
                changed = sorted(k for k in {*held, *fingerprint} if held.get(k) != fingerprint.get(k))
                raise StateError(
                    f"folder {folder}: holds another campaign (differs in {', '.join(changed)}); use another folder"
                )
        else:
            self._write(plan, lambda part: part.write_text(json.dumps(fingerprint, indent=1), encoding="utf-8"))

    @staticmethod
    def _write(target: FilePath, write: Callable[[FilePath], object]) -> None:
        part = target.with_name(f".{target.name}.{os.getpid()}.{time.monotonic_ns()}.part")
        write(part)
        part.replace(target)

    def _path(self, trials: tuple[int, ...]) -> FilePath:
        digest = hashlib.sha256(np.asarray(trials, dtype="<u8").tobytes()).hexdigest()[:12]
        return self.folder / f"trials-{trials[0]:09d}-{trials[-1]:09d}-{digest}.npz"

    def load(self, trials: tuple[int, ...]) -> _Part | None:
        path = self._path(trials)
        if not path.exists():
            return None
        try:
            with np.load(path) as held:
                count = 1 + max(int(name.split("/")[0]) for name in held.files)
                return [
                    {n.split("/", 1)[1]: held[n] for n in held.files if n.startswith(f"{k}/")} for k in range(count)
                ]
        except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise ReadError(f"{path}: needed rows of a campaign, got something unreadable ({error})") from error

    def save(self, trials: tuple[int, ...], part: _Part) -> None:
        arrays: dict[str, Any] = {f"{k}/{name}": v for k, columns in enumerate(part) for name, v in columns.items()}

        def write(path: FilePath) -> None:
            with path.open("wb") as out:
                np.savez(out, **arrays)

        self._write(self._path(trials), write)
