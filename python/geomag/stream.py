"""Samples from a pipe, fixes to a pipe: one line in, one line out, at once.

Input is CSV or NMEA 0183. CSV lines are `x,y,value` or `time,x,y,value`, or whatever a header line says; lines that start with #
are passed over. NMEA has positions in GGA or RMC sentences and values in sentences `$PGMAG,<value>*hh` after them. A line that cannot be
read is passed over and told. Output is one JSON object a sample. Nothing is buffered, so that a fix is there when its sample is.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Protocol, TextIO

from geomag._geomag import Fix
from geomag.io._serial import Sample, read_csv, read_nmea

__all__ = ["Matcher", "Sample", "Step", "read_csv", "read_nmea", "run"]

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
    "covariance_m2",
    "risk",
    "goodness",
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

    One that has `reset()` can begin anew; a sliding window need not.
    """

    def update(self, x: float, y: float, value: float, /) -> Step | Fix:
        """Take one sample."""
        ...


def run(matcher: Matcher, samples: Iterable[Sample], out: TextIO, *, restart: bool = True) -> Fix | None:
    """Feed samples to a streaming matcher and write one JSON line for each; return the last fix that it gave.

    A line has the fields of `Fix.to_dict()`, all but the status null where the matcher did not look for a fix.

    Parameters
    ----------
    matcher : a streaming matcher.
    samples : from `read_csv`, `read_nmea` or anything else.
    out : where the lines go; flushed after each.
    restart : whether a matcher that has `reset()` begins anew after a fix or when lost.
    """
    last: Fix | None = None
    reset = getattr(matcher, "reset", None) if restart else None
    for sample in samples:
        step = matcher.update(sample.x, sample.y, sample.value)
        fix = step if isinstance(step, Fix) else step.fix
        line = _nothing(step.status) if fix is None else {k: _plain(v) for k, v in fix.to_dict().items()}
        if sample.time_s is not None:
            line["time_s"] = sample.time_s
        out.write(json.dumps(line, allow_nan=False) + "\n")
        out.flush()
        if fix is None:
            continue
        last = fix
        if reset is not None and fix.status in ("fixed", "lost"):
            reset()
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
