"""What goes wrong with a sensor in flight: for `calibrate_navigation(..., disturb=)`.

Each function returns one that takes a flight, the INS's output, the readings and a generator, and returns the readings as they are to be; `together` joins several.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._ranges import above, at_least
from geomag.flights import LineFlight

Array = npt.NDArray[np.float64]
#: Flight, INS output, readings, generator to readings.
Disturbance = Callable[[LineFlight, Any, Array, np.random.Generator], Array]


def _during(flight: LineFlight, at_s: float, for_s: float) -> npt.NDArray[np.bool_]:
    since = flight.time_s - flight.time_s[0] - at_s
    return np.asarray((since >= 0) & (since < for_s))


def outage(at_s: float, for_s: float) -> Disturbance:
    """No readings from `at_s` after the start, for `for_s` seconds."""
    above(0, for_s=for_s)
    return lambda flight, _ins, readings, _rng: np.where(_during(flight, at_s, for_s), np.nan, readings)


def stuck(at_s: float, for_s: float) -> Disturbance:
    """The sensor repeats its last reading."""
    above(0, for_s=for_s)

    def disturb(flight: LineFlight, _ins: object, readings: Array, _rng: np.random.Generator) -> Array:
        inside = _during(flight, at_s, for_s)
        before = np.flatnonzero(np.isfinite(readings) & (flight.time_s - flight.time_s[0] < at_s))
        last = readings[before[-1]] if before.size else np.nan
        return np.where(inside & np.isfinite(readings), last, readings)

    return disturb


def jammed(at_s: float, for_s: float, sigma: float) -> Disturbance:
    """Readings that are noise of `sigma` about the right ones."""
    above(0, for_s=for_s, sigma=sigma)

    def disturb(flight: LineFlight, _ins: object, readings: Array, rng: np.random.Generator) -> Array:
        return readings + np.where(_during(flight, at_s, for_s), sigma * rng.standard_normal(readings.size), 0.0)

    return disturb


def jump(at_s: float, by: float) -> Disturbance:
    """The level of the readings jumps and stays there."""
    return lambda flight, _ins, readings, _rng: readings + np.where(_during(flight, at_s, np.inf), by, 0.0)


def outliers(share: float, sigma: float) -> Disturbance:
    """A share of the readings is wrong by a normal error of `sigma`."""
    at_least(0, share=share, sigma=sigma)
    return lambda _flight, _ins, readings, rng: (
        readings + np.where(rng.random(readings.size) < share, sigma, 0.0) * rng.standard_normal(readings.size)
    )


def together(*some: Disturbance) -> Disturbance:
    """All of them, one after the other.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.disturbances import jump, outage, together
    >>> from geomag.flights import LineFlight
    >>> t = np.arange(4.0)
    >>> flight = LineFlight(t, 70 * t, 0 * t, np.zeros(4), (1,), False)
    >>> together(outage(1.0, 1.0), jump(2.0, 50.0))(flight, None, np.zeros(4), np.random.default_rng(0))
    array([ 0., nan, 50., 50.])
    """

    def disturb(flight: LineFlight, ins: object, readings: Array, rng: np.random.Generator) -> Array:
        for one in some:
            readings = one(flight, ins, readings, rng)
        return readings

    return disturb
