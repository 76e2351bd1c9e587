"""The loop of [ICCP-G]: fixes and readings of gravity fed into the filter of a ship's INS, position and platform angles before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag import synthetic
from geomag._geomag import GridMap, InsModel, Navigator, SlidingContour
from geomag._statistics import normalised_squares
from geomag.reduction import GravityReduction, in_knots
from geomag.reproduce import Table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomag.reproduce.e6 import Leg

    Floats = NDArray[np.float64]

#: Seconds between steps of the INS.
STEP_S = 60.0
#: Standard deviation of the place where the INS was last right, metres, and of the gravimeter's level, mGal.
RIGHT_M = 50.0
LEVEL_MGAL = 2.0
#: What is fed back, and whether the filter knows what the INS's errors do to the reduction: a fix of so many readings, each reading.
FEEDS: dict[str, tuple[bool, bool, bool]] = {
    "nothing": (False, False, False),
    "a fix every 20 readings": (True, False, True),
    "every reading, reduction taken as right": (False, True, False),
    "every reading": (False, True, True),
}


@dataclass
class Voyage:
    """A leg with what a ship's INS shows on it and on the way there, and the errors of that, *indicated minus true*."""

    time_s: Floats
    truth: Floats
    inertial: synthetic.Inertial
    raw: Floats

    @staticmethod
    def of(leg: Leg, hours: float, ins: InsModel, rng: np.random.Generator) -> Voyage:
        """The leg, and the same straight line for so many hours before it, at whose begin the INS was right."""
        first = -3600.0 * hours
        time_s = np.arange(first, leg.time_s[-1] + 0.5 * STEP_S, STEP_S)
        pace = (leg.truth[-1] - leg.truth[0]) / leg.time_s[-1]
        truth = leg.truth[0] + time_s[:, None] * pace
        error = synthetic.draw_inertial_error(ins, rng, RIGHT_M)
        inertial = synthetic.indicate(time_s, truth[:, 0], truth[:, 1], geographic=True, error=error, ins=ins, seed=rng)
        raw = np.full(time_s.size, np.nan)
        raw[np.searchsorted(time_s, leg.time_s - 0.5 * STEP_S)] = leg.raw
        return Voyage(time_s, truth, inertial, raw)


@dataclass
class Corrected:
    """What the filter makes of the INS on the steps of the leg: what is left of the errors, (n, 12) in the order of `Inertial.error`, and what it declares."""

    left: Floats
    covariance_m2: Floats
    protection_level_m: Floats
    fixes: int


def reduced(voyage: Voyage, k: int, error: Floats) -> float:
    """Anomaly of the reading of a step, by the place and the velocity that the INS shows less `error` (metres, metres per second, east-north)."""
    shown = voyage.inertial
    speed_kn, course_deg = in_knots(*(shown.velocity_m_s[k : k + 1] - error[2:]).T)
    gravity = GravityReduction(speed_kn=speed_kn, course_deg=course_deg)
    latitude = shown.y[k] - error[1] / 110_574.0
    return float(voyage.raw[k] + gravity.correction(shown.x[k : k + 1], np.array([latitude]), None)[0])


def sail_on(
    grid: GridMap, voyage: Voyage, ins: InsModel, feed: tuple[bool, bool, bool], window: int, settings: dict[str, Any]
) -> Corrected:
    """The voyage with what is fed back."""
    fixes, readings, told = feed
    navigator = Navigator(
        grid,
        ins=ins,
        position_sigma_m=RIGHT_M,
        reading_sigma=1.0,
        bias_sigma=LEVEL_MGAL,
        bias_walk_sqrt_s=0.0,
        batch_m=0.0,
        gravity=told,
        matcher=None,
    )
    contour = SlidingContour(grid, length=window, **settings)
    shown, estimate, seen, used = voyage.inertial, np.zeros(4), 0, 0
    left: list[Floats] = []
    covariance: list[Floats] = []
    protection: list[float] = []
    for k in range(voyage.time_s.size):
        read = np.isfinite(voyage.raw[k])
        place = (float(voyage.time_s[k]), float(shown.x[k]), float(shown.y[k]))
        velocity = (float(shown.velocity_m_s[k, 0]), float(shown.velocity_m_s[k, 1]))
        value = reduced(voyage, k, np.zeros(4)) if read and readings else None
        step = navigator.step(*place, velocity, float(shown.heading_deg[k]), value)
        if read and fixes:
            seen += 1
            fix = contour.update(place[1], place[2], reduced(voyage, k, estimate))
            if seen % window == 0 and fix.ok:
                used += navigator.correct(fix)[1]
        state = navigator.state
        estimate = np.array(state[:4])
        if voyage.time_s[k] >= 0:
            left.append(shown.error[k] - state[: shown.error.shape[1]])
            covariance.append(navigator.covariance[:2, :2])
            protection.append(step.protection_level_m)
    return Corrected(np.array(left), np.array(covariance), np.array(protection), used)


def sizes(error: Floats) -> tuple[float, float, float]:
    """Root mean square position error (metres), tilt (mrad) and heading error (degrees) of errors (n, 12)."""
    squares = np.mean(error**2, axis=0)
    return (
        float(np.sqrt(squares[0] + squares[1])),
        1e3 * float(np.sqrt(squares[4] + squares[5])),
        float(np.degrees(np.sqrt(squares[6]))),
    )


def table(
    grid: GridMap, legs: dict[float, list[Leg]], window: int, settings: dict[float, dict[str, Any]], seed: int
) -> Table:
    """Errors over the last hour of the legs, before and after, for hours of drift before them and for what is fed back."""
    ins = InsModel.navigation()
    exact = GridMap(np.asarray(grid.values), grid.x, grid.y, geographic=True, units="mGal", sigma=0.0)
    last = round(3600.0 / STEP_S)
    rows: list[list[object]] = []
    for hours, some in legs.items():
        draws = [Voyage.of(leg, hours, ins, np.random.default_rng([seed, 66, i])) for i, leg in enumerate(some)]
        for name, feed in FEEDS.items():
            found = [sail_on(exact, voyage, ins, feed, window, settings[hours]) for voyage in draws]
            before = np.median([sizes(voyage.inertial.error[-last:]) for voyage in draws], axis=0)
            after = np.median([sizes(one.left[-last:]) for one in found], axis=0)
            place = [one.left[:, :2] for one in found]
            squares = [np.mean(normalised_squares(e, one.covariance_m2)) for e, one in zip(place, found, strict=True)]
            beyond = [np.mean(np.hypot(*e.T) > one.protection_level_m) for e, one in zip(place, found, strict=True)]
            pairs = [
                round(float(v), digits) if digits else round(float(v))
                for two, digits in zip(zip(before, after, strict=True), (0, 3, 3), strict=True)
                for v in two
            ]
            rows.append(
                [
                    hours,
                    name,
                    *pairs,
                    round(float(np.mean(squares)), 2),
                    f"{100 * np.mean(beyond):.1f} %",
                    sum(one.fixes for one in found),
                ]
            )
    columns = (
        "hours of drift", "fed back", "position m", "after", "tilt mrad", "after", "heading deg", "after",
        "normalised error squared", "beyond the protection level", "fixes used",
    )  # fmt: skip
    return Table(
        "The loop: a ship's INS by its error equations (navigation grade, right to 50 m so many hours before the leg) on the same legs, with platform angles; "
        "medians over the legs of the root mean square over the last hour, the INS's and what the filter makes of it",
        columns,
        rows,
    )
