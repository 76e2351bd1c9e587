"""What is drawn in every trial, and the running of it."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from operator import index
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import Fix, GridMap, Path, SyntheticField, Track, __version__, campaign_flight, campaign_rows
from geomag._progress import reporter
from geomag.campaign._identity import _feed, _identity
from geomag.campaign._methods import Matcher, Method, _json_of
from geomag.campaign._store import _Store
from geomag.campaign._table import Table, _join, _Part
from geomag.campaign._workers import _distribute
from geomag.synthetic import Flight, InsSpread, Sensor, _as_dict, _seed

#: Greatest number of trials of one run.
MOST_TRIALS = 10_000_000


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
        report = reporter(progress)
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
