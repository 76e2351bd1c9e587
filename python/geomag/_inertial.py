"""What an inertial navigation system indicates along a true path: by its error equations, and by integrating its own readings.

Two simulations of the same INS. `indicate` carries errors along the path by the linear error equations (a filter's own model, so that what is
tested is the rest); `strapdown` makes gyro and accelerometer readings of the path, spoils them, and integrates them as an INS does (pyins), which
owes nothing to any filter.

Source: the psi-angle error equations of a local-level INS, vertical channel slaved (Benson, IEEE Trans. AES-11, 1975; Titterton and Weston 2004,
chapter 12; Groves 2013, section 14.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._geomag import InsModel
from geomag._optional import require
from geomag._ranges import above, at_least
from geomag.flights import scales_m, steps_m, velocity_along

Array = npt.NDArray[np.float64]

EARTH_RATE_RAD_S = 7.292115e-5
EARTH_RADIUS_M = 6_371_000.0
GRAVITY_M_S2 = 9.80665
#: Longest step that the linear equations are carried on by.
LONGEST_STEP_S = 5.0
#: Errors carried: position and velocity (east, north), tilts (east, north), heading, gyro biases (body x, y, z), accelerometer biases (x, y).
STATES = 12
#: Sampling of the readings that are integrated.
STRAPDOWN_STEP_S = 0.2

_DEG_H = math.radians(1.0) / 3600.0
_DEG_SQRT_H = math.radians(1.0) / 60.0
_MICRO_G = 1e-6 * GRAVITY_M_S2


@dataclass(frozen=True)
class InertialError:
    """Errors of one INS at the start of a run, *indicated minus true*, and the biases of its sensors there.

    What the INS error equations carry on: unlike those of `InsError` they act on each other (a heading error tilts the platform by the Earth's
    rate, and so moves the position).
    """

    position_m: tuple[float, float] = (0.0, 0.0)
    """Position error (east, north)."""
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    """Velocity error (east, north)."""
    tilt_mrad: tuple[float, float] = (0.0, 0.0)
    """Rotation of the platform about the east and the north axis."""
    heading_deg: float = 0.0
    """Heading error, clockwise: an INS that indicates more than is true has a positive one."""
    gyro_bias_deg_h: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Biases of the gyros (forward, right, down)."""
    accelerometer_bias_ug: tuple[float, float] = (0.0, 0.0)
    """Biases of the accelerometers (forward, right), micro-g."""

    def _state(self) -> Array:
        parts = (
            *self.position_m,
            *self.velocity_m_s,
            *(1e-3 * t for t in self.tilt_mrad),
            -math.radians(self.heading_deg),
            *(_DEG_H * b for b in self.gyro_bias_deg_h),
            *(_MICRO_G * b for b in self.accelerometer_bias_ug),
        )
        state = np.array(parts, dtype=np.float64)
        if state.shape != (STATES,) or not np.isfinite(state).all():
            raise InvalidInputError(f"inertial error: needed {STATES} finite numbers, got {self}")
        return state


def draw_inertial_error(ins: InsModel, rng: np.random.Generator, position_sigma_m: float = 0.0) -> InertialError:
    """Draw the errors of one INS at the start of a run, normal about zero, as its model has them."""
    at_least(0, position_sigma_m=position_sigma_m)
    normal = rng.standard_normal(STATES)
    return InertialError(
        position_m=(position_sigma_m * normal[0], position_sigma_m * normal[1]),
        velocity_m_s=(ins.velocity_sigma_m_s * normal[2], ins.velocity_sigma_m_s * normal[3]),
        tilt_mrad=(ins.tilt_sigma_mrad * normal[4], ins.tilt_sigma_mrad * normal[5]),
        heading_deg=math.degrees(1e-3 * ins.heading_sigma_mrad) * normal[6],
        gyro_bias_deg_h=tuple(ins.gyro_bias_deg_h * normal[7:10]),
        accelerometer_bias_ug=tuple(ins.accelerometer_bias_ug * normal[10:12]),
    )


@dataclass(frozen=True)
class Inertial:
    """What an INS indicates along a true path: shapes (n,), `velocity_m_s` (n, 2) east-north, `error` (n, 12) in SI units.

    `error` is *indicated minus true*: position and velocity (east, north), tilts (east, north), the down component of the platform's rotation (minus the
    heading error, radians), gyro biases (forward, right, down, rad/s) and accelerometer biases (forward, right, m/s2).
    """

    time_s: Array
    x: Array
    y: Array
    velocity_m_s: Array
    heading_deg: Array
    error: Array


def _path(time_s: Any, x: Any, y: Any) -> tuple[Array, Array, Array]:  # noqa: ANN401 - anything that is an array
    columns = [np.asarray(c, dtype=np.float64) for c in (time_s, x, y)]
    if columns[0].ndim != 1 or len({c.shape for c in columns}) != 1:
        raise ShapeError(f"path: needed time_s, x and y of one length, got shapes {[c.shape for c in columns]}")
    if columns[0].size < 2:
        raise TooFewSamplesError(f"path: needed at least 2 positions, got {columns[0].size}")
    for name, c in zip(("time_s", "x", "y"), columns, strict=True):
        bad = np.flatnonzero(~np.isfinite(c))
        if bad.size:
            raise InvalidInputError(f"{name}[{bad[0]}]: needed a finite number, got {c[bad[0]]}")
    back = np.flatnonzero(np.diff(columns[0]) <= 0)
    if back.size:
        raise InvalidInputError(
            f"time_s[{back[0] + 1}]: needed a time after {columns[0][back[0]]}, got {columns[0][back[0] + 1]}"
        )
    return columns[0], columns[1], columns[2]


def dynamics(
    velocity: Array, acceleration: Array, latitude_rad: Array, heading_rad: Array, ins: InsModel | None
) -> Array:
    """Matrices F of the error equations, shape (n, 12, 12), in the order of `Inertial.error`.

    Velocity and acceleration (east, north). Without `ins` the biases of the sensors stay as they are; with it they are first-order Gauss-Markov.
    """
    n = velocity.shape[0]
    east, north = velocity.T
    fe, fn = acceleration.T
    sin, cos, tan = np.sin(latitude_rad), np.cos(latitude_rad), np.tan(latitude_rad)
    rate, radius = EARTH_RATE_RAD_S, EARTH_RADIUS_M
    f = np.zeros((n, STATES, STATES))
    f[:, 0, 2] = 1.0
    f[:, 0, 1] = east * tan / radius
    f[:, 0, 0] = -north * tan / radius
    f[:, 1, 3] = 1.0
    coriolis = 2 * rate * cos + east / (radius * cos**2)
    f[:, 2, 5], f[:, 2, 6] = -GRAVITY_M_S2, -fn
    f[:, 2, 3] = 2 * rate * sin + east * tan / radius
    f[:, 2, 2] = north * tan / radius
    f[:, 2, 1] = coriolis * north / radius
    f[:, 3, 6], f[:, 3, 4] = fe, GRAVITY_M_S2
    f[:, 3, 2] = -(2 * rate * sin + 2 * east * tan / radius)
    f[:, 3, 1] = -coriolis * east / radius
    # Rates of the local level against space (north, east, down) and what a wrong position and velocity change of them.
    wn, we, wd = rate * cos + east / radius, -north / radius, -rate * sin - east * tan / radius
    # psi' = -w x psi, components east, north, down.
    f[:, 4, 6], f[:, 4, 5] = wn, -wd
    f[:, 5, 6], f[:, 5, 4] = -we, wd
    f[:, 6, 4], f[:, 6, 5] = -wn, we
    f[:, 4, 3] = -1 / radius
    f[:, 5, 2], f[:, 5, 1] = 1 / radius, -rate * sin / radius
    f[:, 6, 2], f[:, 6, 1] = -tan / radius, -(rate * cos + east / (radius * cos**2)) / radius
    sh, ch = np.sin(heading_rad), np.cos(heading_rad)
    # Forward and right to east and north.
    f[:, 2, 10], f[:, 2, 11] = sh, ch
    f[:, 3, 10], f[:, 3, 11] = ch, -sh
    f[:, 4, 7], f[:, 4, 8] = -sh, -ch
    f[:, 5, 7], f[:, 5, 8] = -ch, sh
    f[:, 6, 9] = -1.0
    if ins is not None:
        for k in (7, 8, 9):
            f[:, k, k] = -1.0 / ins.gyro_time_constant_s
        for k in (10, 11):
            f[:, k, k] = -1.0 / ins.accelerometer_time_constant_s
    return f


def noise_densities(ins: InsModel) -> Array:
    """Diagonal of Q, per second, in the order of `Inertial.error`."""
    walk, velocity = _DEG_SQRT_H * ins.gyro_walk_deg_sqrt_h, ins.velocity_walk_m_s_sqrt_h / 60.0
    gyro, accelerometer = _DEG_H * ins.gyro_bias_deg_h, _MICRO_G * ins.accelerometer_bias_ug
    q = [0.0, 0.0, velocity**2, velocity**2, *[walk**2] * 3]
    q += [2 * gyro**2 / ins.gyro_time_constant_s] * 3 + [2 * accelerometer**2 / ins.accelerometer_time_constant_s] * 2
    return np.array(q)


def indicate(
    time_s: npt.ArrayLike,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    geographic: bool,
    error: InertialError | None = None,
    ins: InsModel | None = None,
    seed: int | np.random.Generator = 0,
    latitude_deg: float = 45.0,
) -> Inertial:
    """What an INS indicates along a true path, by the INS error equations.

    The errors at the start are carried on along the path: Schuler, Foucault and Earth-rate terms, and the accelerations of turns; a heading error acts
    through the Earth's rate and the turns, as it does in an INS, and not on every step travelled, as in an odometer's dead reckoning (`InsError`).

    Parameters
    ----------
    time_s, x, y : the true path, shape (n,); map units.
    geographic : whether x and y are longitude and latitude.
    error : errors at the start; none where not given.
    ins : grade of the INS, for what is added along the way (random walks, changing biases); without it the errors at the start are all there is.
    seed : of the random walks, or a generator to draw from.
    latitude_deg : latitude of a map in metres.

    Raises `InvalidInputError` for a path that is no path, a latitude within a degree of a pole among it.

    Examples
    --------
    A tenth of a degree of heading, 100 m/s to the north for an hour, at 45 degrees of latitude, moves the position by kilometres, and mostly along the way:

    >>> import numpy as np
    >>> from geomag import synthetic
    >>> t = np.arange(0.0, 3601.0, 10.0)
    >>> flown = synthetic.indicate(t, 0 * t, 100 * t, geographic=False, error=synthetic.InertialError(heading_deg=0.1))
    >>> [round(float(v), -1) for v in flown.error[-1, :2]]
    [460.0, -2570.0]
    """
    time, px, py = _path(time_s, x, y)
    latitude = py if geographic else np.full(py.size, float(latitude_deg))
    if not np.all(np.abs(latitude) < 89.0):
        raise InvalidInputError(f"latitude: needed within 89 degrees, got {latitude[np.argmax(np.abs(latitude))]}")
    rng = np.random.default_rng(seed)
    velocity = velocity_along(time, px, py, geographic=geographic)
    state = np.zeros(STATES) if error is None else error._state()
    errors = np.empty((time.size, STATES))
    errors[0] = state
    density = None if ins is None else noise_densities(ins)
    heading = np.arctan2(velocity[:, 0], velocity[:, 1])
    steps = np.diff(time)
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    acceleration = np.diff(velocity, axis=0) / steps[:, None]
    middle = np.arctan2(mean[:, 0], mean[:, 1])
    across = np.radians(0.5 * (latitude[1:] + latitude[:-1]))
    for begin in range(0, steps.size, 4096):
        some = slice(begin, begin + 4096)
        matrices = dynamics(mean[some], acceleration[some], across[some], middle[some], ins)
        parts = np.ceil(steps[some] / LONGEST_STEP_S).astype(int)
        dt = steps[some] / parts
        first = matrices * dt[:, None, None]
        phi = np.eye(STATES) + first + 0.5 * first @ first
        spread = None if density is None else np.sqrt(density[None, :] * dt[:, None])
        for k in range(parts.size):
            for _ in range(parts[k]):
                state = phi[k] @ state
                if spread is not None:
                    state = state + spread[k] * rng.standard_normal(STATES)
            errors[begin + k + 1] = state
    shown = errors[:, :2] / scales_m(py, geographic=geographic)
    degrees = np.degrees(heading - errors[:, 6])
    return Inertial(time, px + shown[:, 0], py + shown[:, 1], velocity + errors[:, 2:4], degrees, errors)


def _rounded(time: Array, place_m: Array, over_s: float) -> tuple[Array, Array]:
    """A path on an even grid of times whose turns take about `over_s`: two running means, as of a vehicle that cannot turn on the spot."""
    even = np.arange(time[0], time[-1] + 0.5 * STRAPDOWN_STEP_S, STRAPDOWN_STEP_S)
    way = np.column_stack([np.interp(even, time, c) for c in place_m.T])
    width = max(1, round(0.5 * over_s / STRAPDOWN_STEP_S)) | 1
    for _ in range(2):
        # Reflected about its ends, so that they stay where they are.
        half = width // 2
        head, tail = 2 * way[0] - way[half:0:-1], 2 * way[-1] - way[-2 : -half - 2 : -1]
        total = np.cumsum(np.vstack([np.zeros((1, 2)), head, way, tail]), axis=0)
        way = (total[width:] - total[:-width]) / width
    return even, way


def strapdown(
    time_s: npt.ArrayLike,
    longitude: npt.ArrayLike,
    latitude: npt.ArrayLike,
    *,
    ins: InsModel,
    error: InertialError | None = None,
    seed: int | np.random.Generator = 0,
    turn_s: float = 20.0,
) -> tuple[Inertial, Array, Array]:
    """What an INS indicates along a true path, by integrating the readings of its own gyros and accelerometers (pyins, extra `ins`).

    The path is rounded so that turns take about `turn_s`; specific force and rotation along it, on the turning Earth's ellipsoid, are what perfect sensors would
    read (five times a second); biases, first-order Gauss-Markov, and white noise of the model's size are added; the sum is integrated from a start that is
    wrong by `error`. The vehicle stays level, points along its way, and its vertical channel is slaved.

    Returns what is indicated at the given times and the *true* longitudes and latitudes there, which differ from the given ones by the rounding of the turns.

    Raises `MissingDependencyError` without pyins, `InvalidInputError` for a path that is none. Source: Savage, J. Guidance 21 (1998), as pyins has it.
    """
    require("pyins", "ins", "strapdown integration")
    import pandas as pd
    from pyins import sim, transform
    from pyins import strapdown as mechanisation

    above(0, turn_s=turn_s)
    time, lon, lat = _path(time_s, longitude, latitude)
    if not np.all(np.abs(lat) < 89.0):
        raise InvalidInputError(f"latitude: needed within 89 degrees, got {lat[np.argmax(np.abs(lat))]}")
    rng = np.random.default_rng(seed)
    start = InertialError() if error is None else error
    way = np.vstack([[0.0, 0.0], np.cumsum(steps_m(lon, lat, geographic=True), axis=0)])
    even, _ = _rounded(time, way, turn_s)
    _, degrees = _rounded(time, np.column_stack([lon, lat]), turn_s)
    lla = np.column_stack([degrees[:, 1], degrees[:, 0], np.zeros(even.size)])
    moved = np.gradient(degrees, STRAPDOWN_STEP_S, axis=0) * scales_m(degrees[:, 1], geographic=True)
    heading = np.unwrap(np.arctan2(moved[:, 0], moved[:, 1]))
    # A vehicle points along its way over some seconds, not along every stitch of it.
    width = max(1, round(0.25 * turn_s / STRAPDOWN_STEP_S)) | 1
    padded = np.pad(heading, width // 2, mode="edge")
    heading = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    attitude = np.column_stack([np.zeros((even.size, 2)), np.degrees(heading)])
    truth, imu = sim.generate_imu(even - even[0], lla, attitude, sensor_type="rate")
    gyro = _bias(even.size, start.gyro_bias_deg_h, _DEG_H, ins.gyro_bias_deg_h, ins.gyro_time_constant_s, rng)
    level = (*start.accelerometer_bias_ug, 0.0)
    force = _bias(even.size, level, _MICRO_G, ins.accelerometer_bias_ug, ins.accelerometer_time_constant_s, rng)
    spoilt = imu.to_numpy().copy()
    per = math.sqrt(STRAPDOWN_STEP_S)
    spoilt[:, :3] += gyro + _DEG_SQRT_H * ins.gyro_walk_deg_sqrt_h / per * rng.standard_normal((even.size, 3))
    spoilt[:, 3:] += force + ins.velocity_walk_m_s_sqrt_h / 60.0 / per * rng.standard_normal((even.size, 3))
    increments = mechanisation.compute_increments_from_imu(
        pd.DataFrame(spoilt, index=imu.index, columns=imu.columns), "rate"
    )
    first = truth.iloc[0].copy()
    here = scales_m(lla[:1, 0], geographic=True)[0]
    first["lon"] += start.position_m[0] / here[0]
    first["lat"] += start.position_m[1] / here[1]
    first["VE"] += start.velocity_m_s[0]
    first["VN"] += start.velocity_m_s[1]

    # The computed attitude is the true one turned by minus psi (north, east, down).
    east, north = (1e-3 * t for t in start.tilt_mrad)
    down = -math.radians(start.heading_deg)
    psi = np.array([[0.0, -down, east], [down, 0.0, -north], [-east, north, 0.0]])
    turned = (np.eye(3) - psi) @ transform.mat_from_rph(first[["roll", "pitch", "heading"]].to_numpy(dtype=float))
    u, _, v = np.linalg.svd(turned)
    first[["roll", "pitch", "heading"]] = transform.mat_to_rph(u @ v)
    shown = mechanisation.Integrator(first, with_altitude=False).integrate(increments)
    at = time - time[0]

    def column(frame: Any, name: str) -> Array:  # noqa: ANN401 - a table of pyins
        values = frame[name].to_numpy(dtype=float)
        if name == "heading":
            values = np.degrees(np.unwrap(np.radians(values)))
        return np.asarray(np.interp(at, frame.index.to_numpy(dtype=float), values), dtype=np.float64)

    true_x, true_y = column(truth, "lon"), column(truth, "lat")
    velocity = np.column_stack([column(shown, "VE"), column(shown, "VN")])
    errors = np.full((time.size, STATES), np.nan)
    errors[:, :2] = np.column_stack([column(shown, "lon") - true_x, column(shown, "lat") - true_y]) * scales_m(
        true_y, geographic=True
    )
    errors[:, 2:4] = velocity - np.column_stack([column(truth, "VE"), column(truth, "VN")])
    errors[:, 6] = -np.radians(column(shown, "heading") - column(truth, "heading"))
    for k in range(3):
        errors[:, 7 + k] = np.interp(at, even - even[0], gyro[:, k])
    for k in range(2):
        errors[:, 10 + k] = np.interp(at, even - even[0], force[:, k])
    out = Inertial(time, column(shown, "lon"), column(shown, "lat"), velocity, column(shown, "heading"), errors)
    return out, true_x, true_y


def _bias(
    n: int, start: tuple[float, ...], unit: float, sigma: float, constant_s: float, rng: np.random.Generator
) -> Array:
    """First-order Gauss-Markov biases from a start, shape (n, 3), in units of `unit`."""
    keep = math.exp(-STRAPDOWN_STEP_S / constant_s)
    shocks = sigma * math.sqrt(1 - keep**2) * rng.standard_normal((n, 3))
    shocks[0] = start
    # y_k = keep y_(k-1) + shock_k in blocks, so that powers of `keep` neither vanish nor overflow.
    out = np.empty((n, 3))
    state = np.zeros(3)
    power = keep ** np.arange(1, 1025)[:, None]
    for begin in range(0, n, 1024):
        some = shocks[begin : begin + 1024]
        out[begin : begin + 1024] = power[: len(some)] * (state + np.cumsum(some / power[: len(some)], axis=0))
        state = out[min(begin + 1023, n - 1)]
    return unit * out
