"""The loop of [ICCP-G]: fixes and readings of gravity fed into the filter of a ship's INS, position and platform angles before and after."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag import synthetic
from geomag._geomag import GridMap, InsModel, Navigator, SlidingContour
from geomag.reduction import GravityReduction
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
class Errors:
    """Of every step of the leg, all legs one after another."""

    position_m: list[float] = field(default_factory=list)
    square: list[float] = field(default_factory=list)
    tilt_mrad: list[float] = field(default_factory=list)
    heading_deg: list[float] = field(default_factory=list)
    beyond: list[bool] = field(default_factory=list)
    fixes: int = 0


def reduced(voyage: Voyage, k: int, error: Floats) -> float:
    """Anomaly of the reading of a step, by the place and the velocity that the INS shows less `error` (metres, metres per second, east-north)."""
    shown = voyage.inertial
    east, north = shown.velocity_m_s[k] - error[2:]
    gravity = GravityReduction(
        speed_kn=np.array([np.hypot(east, north) * 3600 / 1852]), course_deg=np.degrees([np.arctan2(east, north)])
    )
    latitude = shown.y[k] - error[1] / 110_574.0
    return float(voyage.raw[k] + gravity.correction(shown.x[k : k + 1], np.array([latitude]), None)[0])


def sail_on(
    grid: GridMap, voyage: Voyage, ins: InsModel, feed: tuple[bool, bool, bool], window: int, settings: dict[str, Any]
) -> tuple[Errors, Errors]:
    """Errors of the INS and of what the filter makes of it over the leg."""
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
    shown, estimate, seen = voyage.inertial, np.zeros(4), 0
    before, after = Errors(), Errors()
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
                after.fixes += navigator.correct(fix)[1]
        state, covariance = navigator.state, navigator.covariance
        estimate = np.array(state[:4])
        if voyage.time_s[k] < 0:
            continue
        true = shown.error[k]
        for errors, left in ((before, true), (after, true - state[: true.size])):
            errors.position_m.append(float(np.hypot(left[0], left[1])))
            errors.tilt_mrad.append(1e3 * float(np.hypot(left[4], left[5])))
            errors.heading_deg.append(abs(float(np.degrees(left[6]))))
        left = (true - state[: true.size])[:2]
        after.square.append(float(left @ np.linalg.solve(covariance[:2, :2], left)))
        after.beyond.append(bool(np.hypot(*left) > step.protection_level_m))
    return before, after


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

            def pair(what: str, digits: int, found: list[tuple[Errors, Errors]] = found) -> list[object]:
                sizes = [[np.sqrt(np.mean(np.square(getattr(e, what)[-last:]))) for e in two] for two in found]
                return [round(float(v), digits) if digits else round(float(v)) for v in np.median(sizes, axis=0)]

            rows.append(
                [
                    hours,
                    name,
                    *pair("position_m", 0),
                    *pair("tilt_mrad", 3),
                    *pair("heading_deg", 3),
                    round(float(np.mean([np.mean(after.square) for _, after in found])), 2),
                    f"{100 * np.mean([np.mean(after.beyond) for _, after in found]):.1f} %",
                    sum(after.fixes for _, after in found),
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
