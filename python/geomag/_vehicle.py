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
        time, heading, pitch, roll, _ = _manoeuvres(60.0, 10.0)
        rows = _terms(time, _body(_MAIN_NED_NT, heading, pitch, roll))
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
    ((2400,), 12)
    """
    random = np.random.default_rng(seed)
    if not isinstance(vehicle, VehicleField):
        vehicle = VehicleField.draw(float(vehicle), seed)
    time, heading, pitch, roll, manoeuvres = _manoeuvres(leg_s, rate_hz, random)
    track = np.radians(np.repeat([0.0, 90.0, 180.0, 270.0], len(time) // 4))
    x = start_m[0] + np.cumsum(np.sin(track)) * speed_m_s / rate_hz
    y = start_m[1] + np.cumsum(np.cos(track)) * speed_m_s / rate_hz
    anomaly = np.zeros(len(time)) if crust is None else np.asarray(crust(x, y), dtype=float)
    if anomaly.shape != time.shape or not np.isfinite(anomaly).all():
        raise InvalidInputError(
            f"crust: needed a finite number at each of {len(time)} places from x {x.min():.0f} to {x.max():.0f}, "
            f"y {y.min():.0f} to {y.max():.0f} m, got {np.isfinite(anomaly).sum()} of shape {anomaly.shape}"
        )
    body = _body(main_ned_nt, heading, pitch, roll)
    own = vehicle.on(time, body)
    clean = float(np.linalg.norm(main_ned_nt)) + anomaly
    return CalibrationFlight(
        time_s=time,
        x_m=x,
        y_m=y,
        heading_deg=np.degrees(heading),
        pitch_deg=np.degrees(pitch),
        roll_deg=np.degrees(roll),
        field_nt=body + vector_noise_nt * random.normal(size=body.shape),
        reading_nt=clean + own + noise_nt * random.normal(size=len(time)),
        clean_nt=clean,
        interference_nt=own,
        vehicle=vehicle,
        manoeuvres=manoeuvres,
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


def _body(
    main: tuple[float, float, float],
    heading: NDArray[np.float64],
    pitch: NDArray[np.float64],
    roll: NDArray[np.float64],
) -> NDArray[np.float64]:
    from geomag.compensation import field_in_vehicle

    degrees = [np.degrees(a) for a in (heading, pitch, roll)]
    return field_in_vehicle(main, heading_deg=degrees[0], pitch_deg=degrees[1], roll_deg=degrees[2])


def _manoeuvres(
    leg_s: float, rate_hz: float, random: np.random.Generator | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], tuple[slice, ...]]:
    """Time, heading, pitch, roll (radians) and the slices of the twelve manoeuvres."""
    if not (leg_s >= 15 and rate_hz >= 2):
        raise InvalidInputError(
            f"calibration box: needed legs of 15 s and 2 samples a second at least, got {leg_s}, {rate_hz}"
        )
    each = int(leg_s * rate_hz)
    time = np.arange(4 * each) / rate_hz
    angles = np.radians([[0.0, 90.0, 180.0, 270.0], [0.0] * 4, [0.0] * 4]).repeat(each, axis=1)
    third = each // 3
    window = np.sin(np.pi * np.arange(third) / third) ** 2
    parts = []
    for leg in range(4):
        # Yaw of 5, pitch of 5 and roll of 10 degrees, five seconds to and fro.
        for k, (angle, size) in enumerate(((1, 5.0), (2, 10.0), (0, 5.0))):
            part = slice(leg * each + k * third, leg * each + (k + 1) * third)
            phase = 0.0 if random is None else random.uniform(0.0, 2.0 * np.pi)
            period = 5.0 if random is None else random.uniform(4.0, 6.0)
            angles[angle, part] += (
                np.radians(size) * window * np.sin(2.0 * np.pi * np.arange(third) / rate_hz / period + phase)
            )
            parts.append(part)
    return time, angles[0], angles[1], angles[2], tuple(parts)
