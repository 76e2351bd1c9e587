"""Whole flights: an INS, readings of the field and a map of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np

from geomag._errors import InvalidInputError, ShapeError
from geomag._geomag import GridMap, HarmonicMap, MapStack, _displacements_m, _navigate, _radii_m
from geomag._optional import require
from geomag._statistics import normalised_squares

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike, NDArray

    from geomag._geomag import _NavigatorOptions
    from geomag.flight_log import FlightLog

Progress = bool | Callable[[int, int], object] | None

#: Start of a flight that a summary leaves out, seconds: the filter settles.
SETTLING_S = 600.0
#: Gaussian 99 % radii within which 99 % of the errors are declared to be.
DECLARED = 1.4


@dataclass(frozen=True, repr=False)
class Navigation:
    """A navigated flight, one entry a step.

    Attributes
    ----------
    time_s : array (n,)
        As given.
    x, y : array (n,)
        Corrected place, map units.
    covariance_m2 : array (n, 2, 2)
        Covariance of the place as it is to be believed, square metres, east-north.
    covariance_filter_m2 : array (n, 2, 2)
        The filter's own, before the running NIS widens it.
    protection_level_m : array (n,)
        Radius that the error exceeds with probability `integrity_risk`, metres.
    status, reason, outcome : array (n,) of str
        `acquiring`, `tracking`, `coasting` or `lost`; why; what became of the readings (`waiting`, `updated`, `downweighted`,
        `off_map`).
    velocity_error_m_s : array (n, 2)
        Indicated minus true velocity as estimated, m/s (east, north).
    heading_error_deg, bias : array (n,)
        Indicated minus true heading, degrees clockwise, and error of the sensor, map's unit.
    tilt_error_mrad : array (n, 2)
        Rotation of the platform about the east and the north axis, milliradians.
    nis, running_nis : array (n,)
        Normalised innovation squared (NaN where no measurement was taken) and its running mean, 1 where the covariance is right.
    last_fix, resets : array (n,)
        Time of the newest fix used (NaN before any), seconds; resets so far.
    inputs : str
        `full`, `velocity` (the heading is the course) or `positions` (a reduced model).
    geographic : bool
        Whether places are degrees of longitude and latitude.
    state : array (m,)
        The estimated errors at the end: see `Navigator.state`; with `method="rbpf"` without the displacement of the map.
    smooth_x, smooth_y, smooth_covariance_m2 : arrays (n,), (n,), (n, 2, 2), or None
        Places and covariances with what came after each step, where `smooth` asked for them.
    """

    time_s: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]
    covariance_filter_m2: NDArray[np.float64]
    protection_level_m: NDArray[np.float64]
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    outcome: NDArray[np.str_]
    velocity_error_m_s: NDArray[np.float64]
    heading_error_deg: NDArray[np.float64]
    tilt_error_mrad: NDArray[np.float64]
    bias: NDArray[np.float64]
    nis: NDArray[np.float64]
    running_nis: NDArray[np.float64]
    last_fix: NDArray[np.float64]
    resets: NDArray[np.int64]
    inputs: str
    geographic: bool
    state: NDArray[np.float64]
    smooth_x: NDArray[np.float64] | None = None
    smooth_y: NDArray[np.float64] | None = None
    smooth_covariance_m2: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return int(self.time_s.size)

    def __repr__(self) -> str:
        sigma = np.sqrt(np.trace(self.covariance_m2[-1]))
        shares = ", ".join(f"{name} {np.mean(self.status == name):.1%}" for name in np.unique(self.status))
        hours = (self.time_s[-1] - self.time_s[0]) / 3600
        return f"Navigation({len(self)} steps, {hours:.2f} h, {shares}, last sigma {sigma:.1f} m)"

    def to_dataframe(self) -> pd.DataFrame:
        """One row a step; covariances as `variance_east_m2`, `covariance_m2`, `variance_north_m2`. Needs pandas."""
        pandas = require("pandas", "io", "to_dataframe")
        columns: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if value is None or one.name in ("covariance_filter_m2", "smooth_covariance_m2"):
                continue
            if one.name == "covariance_m2":
                columns["variance_east_m2"] = value[:, 0, 0]
                columns["covariance_m2"] = value[:, 0, 1]
                columns["variance_north_m2"] = value[:, 1, 1]
            elif one.name == "velocity_error_m_s":
                columns["velocity_error_east_m_s"], columns["velocity_error_north_m_s"] = value.T
            elif one.name == "tilt_error_mrad":
                columns["tilt_error_east_mrad"], columns["tilt_error_north_mrad"] = value.T
            elif isinstance(value, np.ndarray) and value.ndim == 1 and one.name != "state":
                columns[one.name] = value
        frame: pd.DataFrame = pandas.DataFrame(columns)
        return frame

    def error_m(self, x: ArrayLike, y: ArrayLike, *, smoothed: bool = False) -> NDArray[np.float64]:
        """Corrected (or smoothed) minus true place, metres, (n, 2) east, north; `x`, `y` (n,) is the truth in map units."""
        true = [np.asarray(v, dtype=float) for v in (x, y)]
        for name, value in zip("xy", true, strict=True):
            if value.shape != self.x.shape:
                raise ShapeError(f"truth {name}: needed shape {self.x.shape} as the flight, got {value.shape}")
        place = (self.smooth_x, self.smooth_y) if smoothed else (self.x, self.y)
        if place[0] is None or place[1] is None:
            raise InvalidInputError("smoothed: needed a flight navigated with smooth=..., got one without")
        return _displacements_m(self.geographic, true[0], true[1], place[0], place[1])

    def summary(
        self,
        truth: tuple[ArrayLike, ArrayLike] | None = None,
        *,
        after_s: float = SETTLING_S,
        smoothed: bool = False,
    ) -> dict[str, float]:
        """What became of the flight, in a few numbers.

        Parameters
        ----------
        truth : (x, y), arrays of shape (n,)
            True places, map units; without them only what the flight says of itself.
        after_s : float
            Time after the start that is not counted, seconds.
        smoothed : bool
            Judge the smoothed places and covariances; the protection level is that of the causal ones.

        Returns
        -------
        dict
            Shares of the time in each status, median `protection_level_m`, `declared_rms_m`; with a truth `drms_m`, `median_m`, `p95_m`, `max_m`,
            `nees` (mean of e' P^-1 e, 2 is right), `within_99` (share inside the Gaussian 99 % radius of the reported covariance),
            `within_declared` (inside 1.4 times it), `beyond_protection` (share beyond the protection level).
        """
        kept = self.time_s >= self.time_s[0] + after_s
        if not kept.any():
            kept[:] = True
        whole = self.smooth_covariance_m2 if smoothed else self.covariance_m2
        if whole is None:
            raise InvalidInputError("smoothed: needed a flight navigated with smooth=..., got one without")
        covariance = whole[kept]
        out = {
            f"share_{name}": float(np.mean(self.status[kept] == name))
            for name in ("acquiring", "tracking", "coasting", "lost")
        }
        out["protection_level_m"] = float(np.median(self.protection_level_m[kept]))
        out["declared_rms_m"] = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
        if truth is None:
            return out
        error = self.error_m(*truth, smoothed=smoothed)[kept]
        distance = np.hypot(*error.T)
        radius = _radii_m(covariance, 0.99)
        out["drms_m"] = float(np.sqrt(np.mean(distance**2)))
        out["median_m"] = float(np.median(distance))
        out["p95_m"] = float(np.quantile(distance, 0.95))
        out["max_m"] = float(distance.max())
        out["nees"] = float(np.mean(normalised_squares(error, covariance)))
        out["within_99"] = float(np.mean(distance <= radius))
        out["within_declared"] = float(np.mean(distance <= DECLARED * radius))
        out["beyond_protection"] = float(np.mean(distance > self.protection_level_m[kept]))
        return out


def navigate(
    grid: GridMap | MapStack | HarmonicMap,
    time_s: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    *,
    velocity_m_s: ArrayLike | None = None,
    heading_deg: ArrayLike | None = None,
    readings: ArrayLike | None = None,
    height_m: ArrayLike | None = None,
    geographic: bool | None = None,
    terms: ArrayLike | None = None,
    smooth: float | Literal["flight"] | None = None,
    progress: Progress = None,
    **options: Unpack[_NavigatorOptions],
) -> Navigation:
    """Navigate through a whole log: what an INS indicated, corrected by readings of the field.

    For post-flight analysis and for trying a map, an INS or a route. The positions are those that a `Navigator` would have answered step
    by step. Not for a log without an INS: see `FieldNavigator`.

    Parameters
    ----------
    grid : GridMap, MapStack or HarmonicMap
        The map; its sigma and error model (see `geomag.survey`) are what the covariance rests on.
    time_s : array (n,)
        Seconds, not running backwards.
    x, y : array (n,)
        Indicated places, map units.
    velocity_m_s : array (n, 2), optional
        Indicated velocity east and north; the difference of positions without it.
    heading_deg : array (n,), optional
        Indicated heading, degrees clockwise from north; the course without it.
    readings : array (n,), optional
        Measured values, map's unit, NaN where there is none; the INS alone without it.
    height_m : float or array (n,), optional
        Metres above the map's height datum. A map at another height is continued to them; one without a height is refused.
    geographic : bool, optional
        Whether `x`, `y` are degrees, where they are not as the map's: places, velocities and headings are brought to the map by its
        CRS, and an `AlignedWarning` says so. The answer is in map units.
    terms : array (n, m), optional
        What the coefficients of the vehicle's own field are multiplied by, a row a step (`geomag.compensation`); with `terms_covariance` (m, m) they are states
        of the filter.
    smooth : float or "flight", optional
        Also answer each step with what came after it: until so many seconds later, or the rest of the flight. The causal output stays as it is.
    progress : bool or callable, optional
        True for a bar, or a callable ``(done, total)``.
    **options
        As for `Navigator`: `ins`, `position_sigma_m` and all others.

    Returns
    -------
    Navigation
        Arrays of corrected places, covariances, protection levels, statuses and more.

    Raises
    ------
    InvalidInputError, NotFiniteError, ShapeError, TooFewSamplesError

    Notes
    -----
    See `Navigator`. The interpreter is released; Ctrl-C is heard.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> x = y = np.arange(0.0, 20e3, 100.0)
    >>> grid = geomag.GridMap(90 * np.sin(x / 900)[None, :] + 80 * np.cos(y / 700)[:, None], x, y, sigma=0.0)
    >>> time_s = np.arange(200.0)
    >>> true_x, true_y = 2000 + 70 * time_s, np.full(200, 8000.0)
    >>> flight = geomag.navigate(
    ...     grid, time_s, true_x + 80, true_y - 60, velocity_m_s=np.tile([70.0, 0.0], (200, 1)),
    ...     heading_deg=np.full(200, 90.0), readings=grid.sample(true_x, true_y), ins=geomag.InsModel.navigation(),
    ... )
    >>> str(flight.status[-1]), flight.summary((true_x, true_y), after_s=60)["beyond_protection"]
    ('tracking', 0.0)
    """
    if isinstance(smooth, str) and smooth != "flight":
        raise InvalidInputError(f"smooth: needed seconds or 'flight', got {smooth!r}")
    if geographic is not None and geographic != grid.geographic:
        flown = _aligned(grid, time_s, x, y, velocity_m_s, heading_deg, geographic)
        options = {"latitude_deg": float(np.mean(np.asarray(y, dtype=float))), **options} if geographic else options
        x, y, velocity_m_s, heading_deg = flown.x, flown.y, flown.velocity_m_s, flown.heading_deg
    log = {
        "time_s": time_s, "x": x, "y": y, "velocity_m_s": velocity_m_s, "heading_deg": heading_deg, "readings": readings,
        "height_m": height_m, "terms": terms,
    }  # fmt: skip
    columns = _navigate(grid, log, lag_s=np.inf if smooth == "flight" else smooth, progress=progress, **options)
    for name in ("status", "reason", "outcome"):
        columns[name] = np.array(columns[name])
    columns["resets"] = columns["resets"].astype(np.int64)
    return Navigation(time_s=np.array(time_s, dtype=float).reshape(-1), **columns)


def _aligned(
    grid: GridMap | MapStack | HarmonicMap,
    time_s: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    velocity_m_s: ArrayLike | None,
    heading_deg: ArrayLike | None,
    geographic: bool,
) -> FlightLog:
    """A log in the map's coordinates."""
    from geomag.flight_log import FlightLog

    if isinstance(grid, MapStack):
        grid = grid.levels[0]
    if not isinstance(grid, GridMap):
        raise InvalidInputError("geographic: needed a map with a CRS, got a harmonic model, which has none")
    time, px, py = (np.asarray(v, dtype=float).reshape(-1) for v in (time_s, x, y))
    velocity, heading = (None if v is None else np.asarray(v, dtype=float) for v in (velocity_m_s, heading_deg))
    for name, value, shape in (
        ("x", px, time.shape),
        ("y", py, time.shape),
        ("velocity_m_s", velocity, (time.size, 2)),
        ("heading_deg", heading, time.shape),
    ):
        if value is not None and value.shape != shape:
            raise ShapeError(f"{name}: needed shape {shape} as time_s, got {value.shape}")
    log = FlightLog(time, px, py, np.zeros(time.size), velocity, heading, geographic=geographic)
    return log.on_map(grid)
