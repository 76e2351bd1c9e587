"""The loop of the gravity paper: fixes and readings fed back to a ship's INS, whose platform angles are estimated with its position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._geomag import GridMap, InsModel, Navigator
from geomag._inertial import Inertial, draw_inertial_error, indicate
from geomag.reduction import GravityReduction

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomag.reproduce.e6 import Leg

    Floats = NDArray[np.float64]

#: A ship's INS of about one nautical mile an hour.
SHIP = {
    "gyro_bias_deg_h": 0.012, "gyro_walk_deg_sqrt_h": 0.002, "accelerometer_bias_ug": 40.0, "velocity_walk_m_s_sqrt_h": 0.005,
    "velocity_sigma_m_s": 0.15, "tilt_sigma_mrad": 0.05, "heading_sigma_mrad": 1.0,
}  # fmt: skip
#: Hours of the leg after which errors are told.
HOURS = (1.0, 2.0, 3.0, 4.0, 4.9)
#: Constant error of the gravimeter, mGal, one standard deviation.
BIAS_MGAL = 3.0


@dataclass(frozen=True)
class Looped:
    """One leg: position error (m), tilt and heading error (arc minutes), of the INS and after the loop, one entry a sample; squared errors over variances."""

    alone_m: Floats
    after_m: Floats
    tilt_alone: Floats
    tilt_after: Floats
    heading_alone: Floats
    heading_after: Floats
    nees: Floats


def follow(grid: GridMap, leg: Leg, rng: np.random.Generator, start_m: float, sigma_mgal: float) -> Looped:
    """Sail a leg with an INS by its error equations; reduce each reading where the last step puts the ship; feed it back."""
    ins = InsModel(**SHIP)
    shown = indicate(
        leg.time_s,
        leg.truth[:, 0],
        leg.truth[:, 1],
        geographic=True,
        error=draw_inertial_error(ins, rng, start_m),
        ins=ins,
        seed=rng,
    )
    navigator = Navigator(
        grid, ins=ins, position_sigma_m=start_m, reading_sigma=sigma_mgal, bias_sigma=BIAS_MGAL, bias_walk=0.001
    )
    raw = leg.raw + rng.normal(0, BIAS_MGAL)
    n = leg.time_s.size
    after, tilt, heading, nees = np.empty((n, 2)), np.empty((n, 2)), np.empty(n), np.empty(n)
    velocity_error = np.zeros(2)
    offset = np.zeros(2)
    for k in range(n):
        place = np.array([shown.x[k], shown.y[k]]) + offset
        value = raw[k] + _correction(place, shown.velocity_m_s[k] - velocity_error)
        step: Any = navigator.step(
            float(leg.time_s[k]),
            float(shown.x[k]),
            float(shown.y[k]),
            tuple(shown.velocity_m_s[k]),
            float(shown.heading_deg[k]),
            value,
        )
        velocity_error = np.array(step.velocity_error_m_s)
        offset = np.array([step.x - shown.x[k], step.y - shown.y[k]])
        scale = np.array(grid.metres_per_unit(float(leg.truth[k, 1])))
        after[k] = (np.array([step.x, step.y]) - leg.truth[k]) * scale
        tilt[k] = shown.error[k, 4:6] - 1e-3 * np.array(step.tilt_error_mrad)
        heading[k] = -np.degrees(shown.error[k, 6]) - step.heading_error_deg
        nees[k] = after[k] @ np.linalg.solve(step.covariance_m2, after[k])
    return _told(shown, after, tilt, heading, nees)


def _told(shown: Inertial, after: Floats, tilt: Floats, heading: Floats, nees: Floats) -> Looped:
    minutes = np.degrees(1.0) * 60.0
    return Looped(
        np.hypot(*shown.error[:, :2].T), np.hypot(*after.T), minutes * np.hypot(*shown.error[:, 4:6].T), minutes * np.hypot(*tilt.T),
        minutes * np.abs(shown.error[:, 6]), 60.0 * np.abs(heading), nees,
    )  # fmt: skip


def _correction(place: Floats, velocity: Floats) -> float:
    """What a raw reading is reduced by at a place and a velocity (east, north)."""
    speed, course = float(np.hypot(*velocity)) * 3600.0 / 1852.0, float(np.degrees(np.arctan2(*velocity)))
    at = GravityReduction(speed_kn=speed, course_deg=course).correction(place[:1], place[1:], None)
    return float(at[0])


def table(
    grid: GridMap, legs: list[Leg], rng: np.random.Generator, start_m: float, sigma_mgal: float
) -> tuple[list[list[object]], float]:
    """Rows: hours, position of the INS and after, tilt and heading of the INS and after (medians over the legs); mean squared error over variance."""
    runs = [follow(grid, leg, rng, start_m, sigma_mgal) for leg in legs]
    rows: list[list[object]] = []
    for hour in HOURS:
        k = int(np.argmin(np.abs(legs[0].time_s / 3600 - hour)))

        def median(name: str, k: int = k) -> float:
            return float(np.median([getattr(run, name)[k] for run in runs]))

        angles = [round(median(name), 2) for name in ("tilt_alone", "tilt_after", "heading_alone", "heading_after")]
        rows.append([hour, round(median("alone_m")), round(median("after_m")), *angles])
    late = legs[0].time_s > 3600
    return rows, float(np.mean([run.nees[late] for run in runs]))
