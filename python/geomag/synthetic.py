"""Fields, paths, INS errors and sensors that are made up but realistic, from a seed.

The same seed gives the same bits on every machine (a `survey` but for the last bits of NumPy's sine). The order of things is
that of a real run: a `Crust` gives a field, the field is gridded, or surveyed line by line, into a map, a vehicle flies a
true `Path`, its INS indicates another one, its sensor reads the field where it truly is.

>>> import geomag
>>> from geomag import synthetic
>>> field = synthetic.Crust(texture_rms=80.0).draw((0, 0, 40_000, 30_000), seed=7)
>>> grid = field.grid(250.0, units="nT")
>>> path = synthetic.Path.straight((8_000, 6_000), course_deg=60, speed_m_s=60, interval_s=10, samples=41)
>>> ins = synthetic.InsError(position_m=(-700.0, 450.0))
>>> flight = synthetic.fly(field, path, ins=ins, sensor=synthetic.Sensor(sigma=0.5), seed=7)
>>> [round(v) for v in flight.offset_m]
[700, -450]
"""

from __future__ import annotations

import dataclasses
import json
import math
import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError, NotFiniteError
from geomag._geomag import Path, SyntheticField, Track
from geomag._geomag import draw_ins_error as _draw_ins_error
from geomag._geomag import fly as _fly
from geomag._inertial import Inertial, InertialError, draw_inertial_error, indicate, strapdown
from geomag._metres import metres_per_unit
from geomag._ranges import above, at_least
from geomag._vehicle import CalibrationFlight, VehicleField, attitude_along, calibration_box
from geomag.survey import Lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomag._geomag import GridMap

__all__ = [
    "CalibrationFlight",
    "Crust",
    "Flight",
    "Inertial",
    "InertialError",
    "InsError",
    "InsSpread",
    "Lattice",
    "Normal",
    "Path",
    "Ring",
    "Sensor",
    "SyntheticField",
    "Uniform",
    "VehicleField",
    "attitude_along",
    "calibration_box",
    "draw_inertial_error",
    "fly",
    "indicate",
    "strapdown",
    "survey",
]


def _plain(name: str, value: object) -> object:
    """A value as JSON can hold it; what is not finite is refused by name."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _as_dict(value)
    if isinstance(value, (tuple, list)):
        return [_plain(f"{name}[{i}]", v) for i, v in enumerate(value)]
    if isinstance(value, (bool, int, str)) or value is None:
        return value
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{name}: needed a number, got {value!r}") from error
    if not math.isfinite(number):
        raise NotFiniteError(f"{name}: needed a finite number, got {number}")
    return number


def _as_dict(settings: Any) -> dict[str, object]:  # noqa: ANN401 - any of the settings below
    kind = type(settings).__name__
    fields = {f.name: _plain(f"{kind}.{f.name}", getattr(settings, f.name)) for f in dataclasses.fields(settings)}
    return {_SPREADS[type(settings)]: fields} if type(settings) in _SPREADS else fields


def _seed(seed: object) -> int:
    try:
        number = operator.index(seed)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not 0 <= number < 2**64:
        raise InvalidInputError(f"seed: needed a whole number in [0, 2^64), got {seed!r}")
    return number


def _json(settings: object, kind: type) -> str:
    if not isinstance(settings, kind):
        raise InvalidInputError(f"needed a {kind.__name__}, got {type(settings).__name__}")
    return json.dumps(_as_dict(settings))


@dataclass(frozen=True)
class Crust:
    """What a synthetic crust is like: a fractal texture and buried dipoles, as in aeromagnetic maps.

    The texture is isotropic with the power spectrum k^-exponent exp(-2 k height_m), k in radians a metre, between the
    shortest and the longest wavelength (Maus and Dimri 1994, doi 10.1029/94GL00771; Spector and Grant 1970). Dipoles
    are induced by a main field of the given inclination and declination (Blakely 1995, section 4.3).

    Not for: fields that must be harmonic in three dimensions (the height is a constant here).
    """

    level: float = 0.0
    """Mean level, value units."""
    slope_per_m: tuple[float, float] = (0.0, 0.0)
    """Slope of the level, value units a metre (east, north)."""
    texture_rms: float = 80.0
    """Standard deviation of the texture at the sensor, value units."""
    exponent: float = 3.0
    """Exponent of the power spectrum."""
    height_m: float = 500.0
    """Height of the sensor over the sources."""
    longest_m: float = 60_000.0
    """Longest wavelength."""
    shortest_m: float = 1_500.0
    """Shortest wavelength."""
    waves: int = 384
    """Number of plane waves."""
    dipoles: int = 24
    """Number of dipoles."""
    dipole_peak: float = 120.0
    """Median size of a dipole's anomaly, value units."""
    dipole_depth_m: tuple[float, float] = (700.0, 2_500.0)
    """Depth of the dipoles under the sensor (least, greatest)."""
    inclination_deg: float = 60.0
    """Inclination of the main field, downwards."""
    declination_deg: float = 2.0
    """Declination of the main field, eastwards."""

    def draw(
        self, extent: tuple[float, float, float, float], *, geographic: bool = False, seed: int = 0
    ) -> SyntheticField:
        """Draw a field over (x least, y least, x greatest, y greatest), map units."""
        return SyntheticField(_json(self, Crust), tuple(float(v) for v in extent), geographic, _seed(seed))


@dataclass(frozen=True)
class InsError:
    """One INS error, *indicated minus true*: a fix should find its negative at the newest sample.

    With w the Schuler rate (84.4 minutes), an initial velocity error v gives a position error of v sin(w t) / w, an
    accelerometer bias b gives b (1 - cos w t) / w^2, a gyro drift e gives R e (t - sin(w t) / w) (Groves 2013,
    section 5.7); without `schuler` they grow as t, t^2 and t^3. Heading and scale errors act on every travelled step: the law of an odometer, a log or
    an airspeed with a compass. In an INS a heading error acts through the Earth's rate and the turns instead (a tenth of a degree at 40 degrees of
    latitude, 100 m/s to the north: 2.7 km along and 450 m across after an hour, where an odometer is 630 m across): that, and everything else that couples, is
    `InertialError`, carried on by `indicate` or `strapdown`.
    """

    position: tuple[float, float] = (0.0, 0.0)
    """Constant position error, map units (x, y)."""
    position_m: tuple[float, float] = (0.0, 0.0)
    """Initial position error, metres (east, north); added to the one in map units."""
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    """Initial velocity error (east, north)."""
    heading_deg: float = 0.0
    """Heading error of dead reckoning, clockwise: turns every travelled step (an odometer's law, not an INS's)."""
    heading_rate_deg_h: float = 0.0
    """Growth of that heading error, degrees an hour."""
    scale: float = 0.0
    """Indicated over true distance, less one."""
    gyro_deg_h: tuple[float, float] = (0.0, 0.0)
    """Drift of the levelling gyros as it moves the position (east, north)."""
    accelerometer_m_s2: tuple[float, float] = (0.0, 0.0)
    """Accelerometer bias (east, north)."""
    walk_m_sqrt_s: float = 0.0
    """Random walk of the position on each axis, metres per square root of a second."""
    schuler: bool = True
    """Whether velocity, gyro and accelerometer errors oscillate with the Schuler period."""


@dataclass(frozen=True)
class Uniform:
    """Initial position error uniform within half widths (x, y), map units."""

    half_width: tuple[float, float]


@dataclass(frozen=True)
class Lattice:
    """Initial position error a whole multiple of `step` within half widths (x, y), map units."""

    half_width: tuple[float, float]
    step: tuple[float, float]


@dataclass(frozen=True)
class Normal:
    """Initial position error normal on each axis, metres (east, north)."""

    sigma_m: tuple[float, float]


@dataclass(frozen=True)
class Ring:
    """Initial position error of one length in a random direction, metres."""

    radius_m: float


_SPREADS: dict[type, str] = {Uniform: "uniform", Lattice: "lattice", Normal: "normal", Ring: "ring"}


@dataclass(frozen=True)
class InsSpread:
    """What INS errors are drawn from: the initial position as told, everything else normal about zero."""

    position: Uniform | Lattice | Normal | Ring = Normal((1000.0, 1000.0))
    """Initial position error."""
    velocity_sigma_m_s: float = 0.0
    heading_sigma_deg: float = 0.0
    heading_rate_sigma_deg_h: float = 0.0
    scale_sigma: float = 0.0
    gyro_sigma_deg_h: float = 0.0
    accelerometer_sigma_m_s2: float = 0.0
    walk_m_sqrt_s: float = 0.0
    """Random walk of every draw."""
    schuler: bool = True

    def draw(self, seed: int) -> InsError:
        """Draw one error."""
        drawn = json.loads(_draw_ins_error(_json(self, InsSpread), _seed(seed)))
        settings: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in drawn.items()}
        return InsError(**settings)


@dataclass(frozen=True)
class Sensor:
    """What a magnetometer or gravimeter, and a field that changes with time, add to the true field.

    Noise of standard deviation `sigma` with `correlation` from one sample to the next; a share of `outlier_rate` of
    the samples spoilt by a further error of `outlier_sigma`; constants, a linear drift and a daily sinusoid.
    """

    sigma: float = 0.0
    correlation: float = 0.0
    outlier_rate: float = 0.0
    outlier_sigma: float = 0.0
    bias: float = 0.0
    bias_sigma: float = 0.0
    """Standard deviation of a further constant that is drawn anew for each run."""
    drift_per_h: float = 0.0
    diurnal: float = 0.0
    diurnal_period_s: float = 86_400.0
    diurnal_phase_deg: float = 0.0
    resolution: float = 0.0
    """Least count that readings are rounded to."""


@dataclass(frozen=True)
class Flight:
    """One run: the true path, what INS and sensor said along it, and the true field there."""

    path: Path
    track: Track
    truth: NDArray[np.float64]
    """Field along the true path, value units."""

    @property
    def offset(self) -> tuple[float, float]:
        """True minus indicated position of the newest sample, map units: what a fix should find."""
        return (float(self.path.x[-1] - self.track.x[-1]), float(self.path.y[-1] - self.track.y[-1]))

    @property
    def offset_m(self) -> tuple[float, float]:
        """The same in metres (east, north)."""
        return self.path.offset_m(self.track)


def fly(
    field: SyntheticField | GridMap,
    path: Path,
    *,
    ins: InsError | None = None,
    sensor: Sensor | None = None,
    seed: int = 0,
) -> Flight:
    """Fly a path through a field.

    Parameters
    ----------
    field : the true field: a `SyntheticField`, known everywhere, or a `GridMap`, read bilinearly.
    path : where the vehicle truly goes, in the field's coordinates.
    ins : what its INS gets wrong; perfect where not given.
    sensor : what its sensor gets wrong; perfect where not given.
    seed : of the INS's random walk and of the sensor's noise.

    Raises
    ------
    InvalidInputError
        Where the path meets a place where the field is unknown, naming the sample.
    """
    ins_json = _json(InsError() if ins is None else ins, InsError)
    sensor_json = _json(Sensor() if sensor is None else sensor, Sensor)
    track, truth = _fly(field, path, ins_json, sensor_json, _seed(seed))
    return Flight(path, track, truth)


#: Most readings of one survey.
MOST_READINGS = 50_000_000


def survey(
    field: SyntheticField,
    *,
    line_spacing_m: float,
    sample_spacing_m: float | None = None,
    tie_spacing_m: float | None = None,
    sigma: float = 0.0,
    level_sigma: float = 0.0,
    wander_m: float = 0.0,
    seed: int = 0,
) -> Lines:
    """Survey a field: lines from west to east, and ties from south to north, over the whole of its extent.

    What `geomag.map_from_lines` makes a map of, with the truth known between the lines.

    Parameters
    ----------
    field : the true field.
    line_spacing_m : distance between the lines.
    sample_spacing_m : distance between readings along a line; a tenth of the line spacing where not given.
    tie_spacing_m : distance between the tie lines; none where not given.
    sigma : standard deviation of the noise of a reading, value units.
    level_sigma : standard deviation of a line's own constant, what levelling has left, value units.
    wander_m : standard deviation of a line's distance from where it was planned, over wavelengths of some twenty line
        spacings; the positions that come back are those flown.
    seed : of noise, levels and wander.

    Raises `InvalidInputError` where fewer than two lines fit, or the readings would be more than 50,000,000.

    Examples
    --------
    >>> from geomag import synthetic
    >>> field = synthetic.Crust().draw((0, 0, 20_000, 10_000), seed=4)
    >>> lines = synthetic.survey(field, line_spacing_m=500.0, tie_spacing_m=5_000.0, sigma=1.0, wander_m=20.0)
    >>> len(lines.split()), lines.x.size
    (26, 9426)
    """
    sample_spacing_m = line_spacing_m / 10 if sample_spacing_m is None else sample_spacing_m
    above(0, line_spacing_m=line_spacing_m, sample_spacing_m=sample_spacing_m)
    above(0, tie_spacing_m=line_spacing_m if tie_spacing_m is None else tie_spacing_m)
    at_least(0, sigma=sigma, level_sigma=level_sigma, wander_m=wander_m)
    low, high = np.reshape(field.extent, (2, 2))
    scale = np.array(metres_per_unit(field.geographic, 0.5 * float(low[1] + high[1])))
    size = (high - low) * scale

    def count(length: float, spacing: float) -> int:
        return math.floor(length / spacing * (1 + 1e-12)) + 1

    runs = [(0, line_spacing_m)] if tie_spacing_m is None else [(0, line_spacing_m), (1, tie_spacing_m)]
    if count(size[1], line_spacing_m) < 2:
        raise InvalidInputError(f"line_spacing_m: needed at most the {size[1]:g} m of the field, got {line_spacing_m}")
    readings = sum(count(size[1 - axis], apart) * count(size[axis], sample_spacing_m) for axis, apart in runs)
    if readings > MOST_READINGS:
        raise InvalidInputError(f"survey: needed at most {MOST_READINGS} readings, got {readings}")
    random = np.random.default_rng(_seed(seed))
    parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for axis, apart in runs:
        along = sample_spacing_m * np.arange(count(size[axis], sample_spacing_m))
        for k in range(count(size[1 - axis], apart)):
            # Three waves of about that length, of random phase, whose squares add up to the variance.
            phase, length = random.uniform(0, 2 * np.pi, 3), line_spacing_m * random.uniform(15, 30, 3)
            waves = np.sin(2 * np.pi * along[:, None] / length + phase).sum(axis=1)
            across = np.clip(k * apart + wander_m * math.sqrt(2 / 3) * waves, 0, size[1 - axis])
            place = (along, across) if axis == 0 else (across, along)
            position = low + np.column_stack(place) / scale
            reading = field.sample(position[:, 0], position[:, 1]) + random.normal(0, level_sigma)
            parts.append((position, reading + random.normal(0, sigma, along.size)))
    position = np.concatenate([p for p, _ in parts])
    label = np.repeat(np.arange(len(parts)), [len(p) for p, _ in parts])
    values = np.concatenate([v for _, v in parts])
    return Lines(position[:, 0], position[:, 1], values, label, field.geographic)
