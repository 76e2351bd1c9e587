"""Samples from a pipe, fixes to a pipe: one line in, one line out, at once.

Input is CSV or NMEA 0183. CSV lines are `x,y,value` or `time,x,y,value`, or whatever a header line says; lines that start with #
are passed over. NMEA has positions in GGA, RMC, GLL or GNS sentences and values in sentences `$PGMAG,<value>*hh` after them. A line that cannot be
read is passed over and told. Output is one JSON object a sample, or MAVLink messages of the fixes. Nothing is buffered, so that a fix is there when its sample is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, BinaryIO, Protocol, TextIO

from geomag._geomag import Fix, GridMap, Track
from geomag.io._serial import Sample, read_csv, read_nmea

if TYPE_CHECKING:
    from geomag.mavlink import Encoder

__all__ = [
    "Event",
    "Matcher",
    "Sample",
    "Step",
    "Writer",
    "feed",
    "json_lines",
    "mavlink_messages",
    "on_map",
    "read_csv",
    "read_nmea",
    "run",
]

#: Those of `Fix.to_dict()`.
_FIELDS = (
    "status",
    "ok",
    "x",
    "y",
    "offset",
    "offset_m",
    "heading_deg",
    "scale",
    "bias",
    "heights_m",
    "covariance_m2",
    "risk",
    "goodness",
    "misfit",
    "score",
    "runner_up",
    "n_samples",
    "iterations",
)


class Step(Protocol):
    """What a matcher says after a sample; no fix where it did not look for one at this sample."""

    @property
    def status(self) -> str:
        """Whether a fix may be declared, and why not."""
        ...

    @property
    def fix(self) -> Fix | None:
        """The answer, where there is one."""
        ...


class Matcher(Protocol):
    """A streaming matcher: `Iema`, `PosteriorMatcher`, `SlidingContour` and their like.

    One that has `reset()` can begin anew; one that gives a fix a sample, as a sliding window does, goes on by itself.
    """

    def update(self, x: float, y: float, value: float, /) -> Step | Fix:
        """Take one sample."""
        ...


@dataclass(frozen=True)
class Event:
    """What one sample did to a matcher: the status after it, the fix where it looked for one, and whether it begins anew."""

    sample: Sample
    status: str
    fix: Fix | None
    restarted: bool = False


#: What becomes of an event.
Writer = Callable[[Event], None]


def feed(matcher: Matcher, samples: Iterable[Sample], *, restart: bool = True) -> Iterator[Event]:
    """Feed samples to a streaming matcher, one event a sample, at once; begin anew after a fix or when it is lost.

    A matcher is lost when it says so, with a fix or without one: none of its candidates is left, and no further sample would
    bring one back. An event says where it was begun anew, and the next sample is the first of the new search.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    restart : whether a matcher that has `reset()` begins anew.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.stream import Sample, feed
    >>> x = np.arange(0.0, 3000.0, 50.0)
    >>> grid = geomag.GridMap(90 * np.sin(x / 140)[None, :] + 80 * np.cos(x / 120)[:, None], x, x)
    >>> samples = [Sample(700 + 40 * k, 900 + 30 * k, 1e4) for k in range(3)]
    >>> [(e.status, e.restarted) for e in feed(geomag.Iema(grid, 1.0, half_width=200.0), samples)]
    [('lost', True), ('lost', True), ('lost', True)]
    """
    reset = getattr(matcher, "reset", None) if restart else None
    for sample in samples:
        step = matcher.update(sample.x, sample.y, sample.value)
        if isinstance(step, Fix):
            yield Event(sample, step.status, step)
            continue
        status = step.status if step.fix is None else step.fix.status
        over = reset is not None and status in ("fixed", "lost")
        yield Event(sample, status, step.fix, over)
        if over and reset is not None:
            reset()


def on_map(grid: GridMap, samples: Iterable[Sample]) -> Iterator[Sample]:
    """Samples in the coordinates of a map: degrees on a map with a reference system are turned, at once.

    Samples that do not say what they are (`geographic` is None) are taken to be as the map is.

    Raises `InvalidInputError` for degrees on a map in metres without a system, and for metres on a map in degrees; `MissingDependencyError`.

    Examples
    --------
    >>> import geomag
    >>> from geomag.stream import on_map, read_csv
    >>> local = geomag.GridMap([[0.0, 1], [2, 3]], [0, 100.0], [0, 100.0])
    >>> next(on_map(local, read_csv(["lon,lat,value", "16.2,46.9,12.5"])))  # doctest: +IGNORE_EXCEPTION_DETAIL
    Traceback (most recent call last):
    ...
    geomag.InvalidInputError: track: needed positions in metres as the map's, got degrees, and the map has no CRS by which to turn them
    """
    from geomag.projection import align

    for sample in samples:
        if sample.geographic is None or sample.geographic == grid.geographic:
            yield sample
            continue
        there = align(grid, Track([sample.x], [sample.y], [sample.value], geographic=sample.geographic), quiet=True)
        yield replace(sample, x=float(there.x[0]), y=float(there.y[0]), geographic=grid.geographic)


def json_lines(out: TextIO) -> Writer:
    """A writer of one JSON line a sample, flushed at once.

    A line has the fields of `Fix.to_dict()`, all but the status null where the matcher did not look for a fix, and
    `restarted` where the matcher was lost and begins anew: see `feed`.
    """

    def write(event: Event) -> None:
        fix = event.fix
        line = _nothing(event.status) if fix is None else {k: _plain(v) for k, v in fix.to_dict().items()}
        if event.sample.time_s is not None:
            line["time_s"] = event.sample.time_s
        if event.restarted and event.status == "lost":
            line["restarted"] = True
        out.write(json.dumps(line, allow_nan=False) + "\n")
        out.flush()

    return write


def mavlink_messages(out: BinaryIO, encoder: Encoder) -> Writer:
    """A writer of MAVLink messages (see `geomag.mavlink`), flushed at once; only fixes that may be used are sent."""

    def write(event: Event) -> None:
        message = encoder.encode(event.fix, event.sample.time_s)
        if message:
            out.write(message)
            out.flush()

    return write


def run(matcher: Matcher, samples: Iterable[Sample], out: TextIO | Writer, *, restart: bool = True) -> Fix | None:
    """Feed samples to a streaming matcher and write what it says after each; return the last fix that it gave.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    out : where JSON lines go (`json_lines`), or another writer, such as `mavlink_messages`.
    restart : whether a matcher that has `reset()` begins anew after a fix or when lost.
    """
    last: Fix | None = None
    write = out if callable(out) else json_lines(out)
    for event in feed(matcher, samples, restart=restart):
        write(event)
        last = last if event.fix is None else event.fix
    return last


def _nothing(status: str) -> dict[str, object]:
    """The line of a sample without a fix."""
    return {**dict.fromkeys(_FIELDS), "status": status, "ok": False}


def _plain(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
