"""Made-up vehicles that disturb their own magnetometer, and their calibration flights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._geomag import tolles_lawson_terms

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

#: Shares of permanent, induced and eddy terms in the variance of a made-up vehicle's field, as on light aircraft.
_SHARES = (0.6, 0.35, 0.05)
#: Main field of the middle latitudes of the north: inclination 60 degrees, 50,000 nT.
_MAIN_NED_NT = (24_600.0, 4_300.0, 43_300.0)
#: Time of a turn by a right angle.
_TURN_S = 30.0


@dataclass(frozen=True)
class VehicleField:
    """A vehicle's own field on its scalar magnetometer: coefficients of the 18 terms of Tolles and Lawson.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag import synthetic
    >>> vehicle = synthetic.VehicleField.draw(300.0, seed=5)
    >>> vehicle.coefficients.shape
    (18,)
    """

    coefficients: NDArray[np.float64]
    """nT, in the order of `geomag.compensation.TERM_NAMES`, rates in nT a second."""

    @staticmethod
    def draw(size_nt: float, seed: int) -> VehicleField:
        """A vehicle whose field has the standard deviation `size_nt` over the manoeuvres of `calibration_box`.

        Permanent, induced and eddy terms have 60, 35 and 5 per cent of the variance before they are added.
        """
        if not (np.isfinite(size_nt) and size_nt >= 0):
            raise InvalidInputError(f"size_nt: needed a finite number >= 0, got {size_nt}")
        random = np.random.default_rng(seed)
        box = _box(60.0, 10.0)
        rows = _terms(box.time, _body(_MAIN_NED_NT, box))
        rows -= rows.mean(axis=0)
        coefficients = random.normal(size=18)
        for part, share in zip((slice(0, 3), slice(3, 9), slice(9, 18)), _SHARES, strict=True):
            coefficients[part] *= np.sqrt(share) / np.std(rows[:, part] @ coefficients[part])
        return VehicleField(coefficients * size_nt / np.std(rows @ coefficients))

    def on(self, time_s: ArrayLike, field_nt: ArrayLike) -> NDArray[np.float64]:
        """The vehicle's field on the scalar magnetometer, nT, shape (n,), with the field in its axes (n, 3)."""
        return np.asarray(_terms(time_s, field_nt) @ self.coefficients)


@dataclass(frozen=True)
class CalibrationFlight:
    """A made-up calibration flight, and the truth of it. Arrays have shape (n,), `field_nt` (n, 3)."""

    time_s: NDArray[np.float64]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    heading_deg: NDArray[np.float64]
    pitch_deg: NDArray[np.float64]
    roll_deg: NDArray[np.float64]
    field_nt: NDArray[np.float64]
    """What the vector magnetometer reads, vehicle's axes."""
    reading_nt: NDArray[np.float64]
    """What the scalar magnetometer reads."""
    clean_nt: NDArray[np.float64]
    """What it would read without the vehicle and its noise: main field and crust."""
    interference_nt: NDArray[np.float64]
    """The vehicle's field."""
    vehicle: VehicleField
    manoeuvres: tuple[slice, ...]
    """Samples of the twelve manoeuvres: pitch, roll, yaw on four headings."""


def calibration_box(
    vehicle: VehicleField | float = 300.0,
    *,
    seed: int,
    crust: Callable[[NDArray[np.float64], NDArray[np.float64]], ArrayLike] | None = None,
    start_m: tuple[float, float] = (0.0, 0.0),
    speed_m_s: float = 60.0,
    leg_s: float = 60.0,
    rate_hz: float = 10.0,
    main_ned_nt: tuple[float, float, float] = _MAIN_NED_NT,
    noise_nt: float = 0.1,
    vector_noise_nt: float = 2.0,
) -> CalibrationFlight:
    """Fly a calibration box: four legs to north, east, south and west with pitch, roll and yaw on each.

    Between the legs are turns to the right of half a minute.

    Parameters
    ----------
    vehicle : VehicleField or float
        The vehicle, or the standard deviation of its field over the flight, nT: one is drawn then.
    seed : int
        For vehicle, noise and the phases of the manoeuvres.
    crust : callable, optional
        Anomaly (nT) at arrays of x and y, metres east and north; none by default. For a map `lambda x, y: grid.sample(x, y)`.
    start_m : pair of floats
        South-western corner of the box, metres.
    speed_m_s, leg_s, rate_hz : float
        Speed, time of a leg, samples a second.
    main_ned_nt : three floats
        Main field, north, east, down, nT.
    noise_nt, vector_noise_nt : float
        Noise of the scalar reading and of a component of the vector reading.

    Returns
    -------
    CalibrationFlight

    Raises
    ------
    InvalidInputError, ShapeError

    Examples
    --------
    >>> from geomag import synthetic
    >>> flight = synthetic.calibration_box(85.0, seed=2)
    >>> flight.reading_nt.shape, len(flight.manoeuvres)
    ((3300,), 12)
    """
    random = np.random.default_rng(seed)
    if not isinstance(vehicle, VehicleField):
        vehicle = VehicleField.draw(float(vehicle), seed)
    box = _box(leg_s, rate_hz, speed_m_s, random)
    time = box.time
    x = start_m[0] + np.cumsum(np.sin(box.course)) * speed_m_s / rate_hz
    y = start_m[1] + np.cumsum(np.cos(box.course)) * speed_m_s / rate_hz
    anomaly = np.zeros(len(time)) if crust is None else np.asarray(crust(x, y), dtype=float)
    if anomaly.shape != time.shape or not np.isfinite(anomaly).all():
        raise InvalidInputError(
            f"crust: needed a finite number at each of {len(time)} places from x {x.min():.0f} to {x.max():.0f}, "
            f"y {y.min():.0f} to {y.max():.0f} m, got {np.isfinite(anomaly).sum()} of shape {anomaly.shape}"
        )
    body = _body(main_ned_nt, box)
    own = vehicle.on(time, body)
    clean = float(np.linalg.norm(main_ned_nt)) + anomaly
    return CalibrationFlight(
        time_s=time,
        x_m=x,
        y_m=y,
        heading_deg=np.degrees(box.heading),
        pitch_deg=np.degrees(box.pitch),
        roll_deg=np.degrees(box.roll),
        field_nt=body + vector_noise_nt * random.normal(size=body.shape),
        reading_nt=clean + own + noise_nt * random.normal(size=len(time)),
        clean_nt=clean,
        interference_nt=own,
        vehicle=vehicle,
        manoeuvres=box.manoeuvres,
    )


def attitude_along(
    time_s: ArrayLike, x_m: ArrayLike, y_m: ArrayLike, *, seed: int, turbulence_deg: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Heading, pitch and roll in degrees of a vehicle on a path: coordinated turns, and a swaying of a few seconds.

    >>> import numpy as np
    >>> from geomag import synthetic
    >>> t = np.arange(0.0, 60.0, 1.0)
    >>> heading, pitch, roll = synthetic.attitude_along(t, 50 * t, 0 * t, seed=1, turbulence_deg=0.0)
    >>> round(float(heading[30])), abs(round(float(roll[30])))
    (90, 0)
    """
    time, x, y = (np.asarray(a, dtype=float) for a in (time_s, x_m, y_m))
    if not time.shape == x.shape == y.shape or time.ndim != 1:
        raise ShapeError(
            f"attitude_along: needed three arrays of one shape (n,), got {time.shape}, {x.shape}, {y.shape}"
        )
    if time.size < 3:
        raise TooFewSamplesError(f"attitude_along: needed at least 3 samples, got {time.size}")
    east, north = np.gradient(x, time), np.gradient(y, time)
    heading = np.unwrap(np.arctan2(east, north))
    roll = np.arctan(np.hypot(east, north) * np.gradient(heading, time) / 9.81)
    random = np.random.default_rng(seed)
    sway = []
    for _ in range(3):
        periods, phases = random.uniform(2.0, 9.0, 6), random.uniform(0.0, 2.0 * np.pi, 6)
        waves = np.sin(2.0 * np.pi * time[:, None] / periods + phases).sum(axis=1)
        sway.append(np.radians(turbulence_deg) * waves / np.sqrt(3.0))
    angles = (heading + 0.5 * sway[0], 0.5 * sway[1], roll + sway[2])
    return tuple(np.degrees(a) for a in angles)


def _terms(time_s: ArrayLike, field_nt: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(tolles_lawson_terms(field_nt, time_s, np.inf))


def _body(main: tuple[float, float, float], box: _Box) -> NDArray[np.float64]:
    from geomag.compensation import field_in_vehicle

    heading, pitch, roll = (np.degrees(a) for a in (box.heading, box.pitch, box.roll))
    return field_in_vehicle(main, heading_deg=heading, pitch_deg=pitch, roll_deg=roll)


@dataclass(frozen=True)
class _Box:
    """Times, angles in radians and the slices of the twelve manoeuvres."""

    time: NDArray[np.float64]
    course: NDArray[np.float64]
    heading: NDArray[np.float64]
    pitch: NDArray[np.float64]
    roll: NDArray[np.float64]
    manoeuvres: tuple[slice, ...]


def _box(leg_s: float, rate_hz: float, speed_m_s: float = 60.0, random: np.random.Generator | None = None) -> _Box:
    """Four legs of pitch, roll and yaw, with turns to the right of half a minute between them."""
    if not (leg_s >= 15 and rate_hz >= 2 and speed_m_s > 0):
        raise InvalidInputError(
            f"calibration box: needed legs of 15 s, 2 samples a second and a speed > 0, got {leg_s}, {rate_hz}, {speed_m_s}"
        )
    leg, turn = int(leg_s * rate_hz), int(_TURN_S * rate_hz)
    # The rate of a turn comes and goes as a raised cosine.
    into = np.arange(turn) / turn
    turned = 0.5 * np.pi * (into - np.sin(2.0 * np.pi * into) / (2.0 * np.pi))
    rate = 0.5 * np.pi * (1.0 - np.cos(2.0 * np.pi * into)) / _TURN_S
    course: list[NDArray[np.float64]] = []
    roll: list[NDArray[np.float64]] = []
    starts: list[int] = []
    for k in range(4):
        starts.append(sum(len(part) for part in course))
        course.append(np.full(leg, 0.5 * np.pi * k))
        roll.append(np.zeros(leg))
        if k < 3:
            course.append(0.5 * np.pi * k + turned)
            roll.append(np.arctan(speed_m_s * rate / 9.81))
    along = np.concatenate(course)
    angles = [along.copy(), np.zeros(len(along)), np.concatenate(roll)]
    third = leg // 3
    window = np.sin(np.pi * np.arange(third) / third) ** 2
    parts = []
    for start in starts:
        # Pitch of 5, roll of 10 and yaw of 5 degrees, five seconds to and fro.
        for k, (angle, size) in enumerate(((1, 5.0), (2, 10.0), (0, 5.0))):
            part = slice(start + k * third, start + (k + 1) * third)
            phase = 0.0 if random is None else random.uniform(0.0, 2.0 * np.pi)
            period = 5.0 if random is None else random.uniform(4.0, 6.0)
            angles[angle][part] += (
                np.radians(size) * window * np.sin(2.0 * np.pi * np.arange(third) / rate_hz / period + phase)
            )
            parts.append(part)
    return _Box(np.arange(len(along)) / rate_hz, along, angles[0], angles[1], angles[2], tuple(parts))
