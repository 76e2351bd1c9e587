"""Raw readings reduced anew where they turn out to have been taken: the second reduction of [ICCP-G].

A gravity or magnetic anomaly depends on where one believes to be: normal gravity on latitude, the Eotvos correction on
velocity, course and latitude, free-air and depth reductions on height; for magnetics the main field that is taken away.
So: reduce at the indicated positions, match, reduce at the matched positions, match again, until nothing moves.

Normal gravity comes from boule (closed form at any height), the main field from `geomag.mainfield`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from geomag._errors import InvalidInputError, ShapeError, TooFewSamplesError
from geomag._geomag import Track, match_contour
from geomag._optional import require
from geomag.mainfield import load
from geomag.projection import DEGREES, transform

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from geomag._geomag import Fix, GridMap, MapStack
    from geomag.mainfield import MainField

__all__ = [
    "GravityReduction",
    "MagneticReduction",
    "Reduced",
    "Reduction",
    "Reductions",
    "eotvos_mgal",
    "match_with_reduction",
]

#: Gradient of gravity in sea water of 1028 kg/m3, mGal/m: free-air gradient less twice the slab of water above.
SEA_WATER_GRADIENT_MGAL_M = 0.3086 - 2.0 * 0.04193 * 1.028
_KNOT_M_S = 1852.0 / 3600.0


class Reduction(Protocol):
    """What `match_with_reduction` needs: what to add to raw readings taken at given places."""

    def correction(
        self, longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Anomaly less raw reading at positions in degrees; times in seconds where they are known."""
        ...


def eotvos_mgal(speed_kn: ArrayLike, course_deg: ArrayLike, latitude_deg: ArrayLike) -> NDArray[np.float64]:
    """Eotvos correction, mGal, to be added to gravity read on a moving vehicle.

    7.503 v cos(latitude) sin(course) + 0.004154 v^2, v in knots, course clockwise from north [ICCP-G].

    >>> from geomag.reduction import eotvos_mgal
    >>> round(float(eotvos_mgal(12.0, 90.0, 0.0)), 3)
    90.634
    """
    v = np.asarray(speed_kn, dtype=float)
    east = np.cos(np.radians(latitude_deg)) * np.sin(np.radians(course_deg))
    return np.asarray(7.503 * v * east + 0.004154 * v**2)


def _motion(
    longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speed in knots and course in degrees from positions and times, by central differences."""
    if time_s is None:
        raise InvalidInputError("gravity reduction: needed speed_kn and course_deg, or time_s to derive them, got none")
    if len(longitude) < 2:
        raise TooFewSamplesError(
            f"gravity reduction: needed at least 2 samples to derive the motion, got {len(longitude)}"
        )
    radius = 6_371_008.8
    e = np.gradient(np.unwrap(np.radians(longitude)), time_s) * radius * np.cos(np.radians(latitude))
    n = np.gradient(np.radians(latitude), time_s) * radius
    return in_knots(e, n)


def in_knots(east: NDArray[np.float64], north: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speed in knots and course in degrees of velocities in metres per second.

    >>> from geomag.reduction import in_knots
    >>> [round(float(v), 3) for v in in_knots(6.173, 0.0)]
    [11.999, 90.0]
    """
    return np.hypot(east, north) / _KNOT_M_S, np.degrees(np.arctan2(east, north))


@dataclass(frozen=True)
class GravityReduction:
    """Raw gravity to gravity disturbance: reading + Eotvos - normal gravity at the height of the reading.

    Parameters
    ----------
    height_m : height above the ellipsoid; a negative one is a depth in sea water. One number, or one a sample.
    speed_kn, course_deg : motion of the vehicle. Left out they follow from the positions and times, and are then
        corrected with the positions.
    """

    height_m: float | NDArray[np.float64] = 0.0
    speed_kn: float | NDArray[np.float64] | None = None
    course_deg: float | NDArray[np.float64] | None = None

    def correction(
        self, longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Disturbance less raw reading, mGal."""
        boule = require("boule", "field", "normal gravity")
        if (self.speed_kn is None) != (self.course_deg is None):
            raise InvalidInputError("gravity reduction: needed speed_kn and course_deg together, got one of them")
        if self.speed_kn is None or self.course_deg is None:
            speed, course = _motion(longitude, latitude, time_s)
        else:
            speed, course = np.asarray(self.speed_kn, dtype=float), np.asarray(self.course_deg, dtype=float)
        height = np.broadcast_to(np.asarray(self.height_m, dtype=float), latitude.shape)
        normal = np.asarray(boule.WGS84.normal_gravity((None, latitude, np.maximum(height, 0.0))))
        depth = np.maximum(-height, 0.0)
        return np.asarray(eotvos_mgal(speed, course, latitude) - normal - SEA_WATER_GRADIENT_MGAL_M * depth)


@dataclass(frozen=True)
class MagneticReduction:
    """Total intensity to anomaly: reading less the main field at its place and date.

    Parameters
    ----------
    date : date, datetime, ISO text, numpy datetime64, pandas timestamps or decimal years
        Date of the readings: one, or one a sample. A time zone is heeded; without one a date is in UTC.
    height_m : height above the ellipsoid; one number, or one a sample.
    model : 'igrf14', 'wmm2025', 'wmmhr2025', or what `geomag.mainfield.load` gave
        The model that the map was reduced by, as a rule IGRF.

    Examples
    --------
    >>> import datetime, numpy as np
    >>> from geomag.reduction import MagneticReduction
    >>> when = datetime.datetime(2026, 6, 1, tzinfo=datetime.timezone.utc)
    >>> MagneticReduction(when, 600.0).correction(np.array([10.0]), np.array([45.0]), None).round(2)
    array([-47724.82])
    """

    date: Any
    height_m: float | NDArray[np.float64] = 0.0
    model: str | MainField = "igrf14"

    def correction(
        self, longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Anomaly less raw reading, nT."""
        del time_s
        model = load(self.model) if isinstance(self.model, str) else self.model
        return -model.total(longitude, latitude, self.height_m, self.date)


@dataclass(frozen=True)
class Reductions:
    """Several reductions as one: the main field and the daily variation, say.

    Parameters
    ----------
    parts : Reduction, ...
        What is taken off, in any order.

    Examples
    --------
    >>> import numpy as np
    >>> from geomag.reduction import MagneticReduction, Reductions
    >>> here = np.array([10.0]), np.array([45.0])
    >>> main = MagneticReduction("2026-06-01", 600.0)
    >>> twice = Reductions(main, main)
    >>> bool(np.all(twice.correction(*here, None) == 2 * main.correction(*here, None)))
    True
    """

    parts: tuple[Reduction, ...]

    def __init__(self, *parts: Reduction) -> None:
        object.__setattr__(self, "parts", parts)

    def correction(
        self, longitude: NDArray[np.float64], latitude: NDArray[np.float64], time_s: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        """Sum of the corrections of the parts."""
        total = np.zeros(np.shape(longitude))
        for part in self.parts:
            total = total + part.correction(longitude, latitude, time_s)
        return total


@dataclass(frozen=True)
class Reduced:
    """What repeated reduction found."""

    fix: Fix
    #: Readings reduced at the positions of `fix`, map units.
    values: NDArray[np.float64]
    #: Matches made, the first included.
    passes: int
    #: Greatest movement of a point in the last pass, metres; infinite after a single pass.
    moved_m: float
    #: Whether it is within the tolerance.
    converged: bool
    #: The answer of the first pass: what a single reduction gives.
    first: Fix


def match_with_reduction(
    grid: GridMap | MapStack,
    x: ArrayLike,
    y: ArrayLike,
    readings: ArrayLike,
    reduction: Reduction,
    *,
    time_s: ArrayLike | None = None,
    height_m: ArrayLike | None = None,
    matcher: Callable[..., Fix] = match_contour,
    max_passes: int = 10,
    converged_m: float = 10.0,
    **options: Any,  # noqa: ANN401 - passed on to the matcher
) -> Reduced:
    """Match raw readings, reducing them anew at the matched positions until these rest.

    For gravity with tens of kilometres of INS error (0.8 mGal a kilometre in latitude), and for total intensity. Not
    for readings that are anomalies already.

    Parameters
    ----------
    grid : GridMap or MapStack
        Map of the anomaly, in degrees or with a CRS by which degrees are turned into its coordinates.
    x, y : arrays of shape (n,)
        Indicated longitude and latitude, degrees.
    readings : array of shape (n,)
        Raw readings, map units.
    reduction : Reduction
        `GravityReduction`, `MagneticReduction`, or anything with their `correction`.
    time_s : array of shape (n,), optional
        Times, seconds.
    height_m : float or array of shape (n,), optional
        Heights above the map's height datum, for a map at another one: it is continued to them.
    matcher : callable
        `matcher(grid, track, **options) -> Fix`; `match_contour` by default, `match_posterior` for a declared risk.
    max_passes : int
        Greatest number of matches, >= 1.
    converged_m : float
        It rests when no point moves further between passes, metres.

    Returns
    -------
    Reduced

    Raises
    ------
    InvalidInputError, ShapeError, and what the matcher raises

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.reduction import GravityReduction, match_with_reduction
    >>> lon, lat = np.linspace(110, 111, 121), np.linspace(15, 16, 121)
    >>> anomaly = 40 * np.sin(20 * lon) * np.cos(25 * lat)[:, None] + 25 * np.sin(31 * lon + 13 * lat[:, None])
    >>> grid = geomag.GridMap(anomaly, lon, lat, geographic=True)
    >>> tx, ty = 110.4 + 0.012 * np.arange(20), 15.3 + 0.01 * np.arange(20)
    >>> gravity = GravityReduction(speed_kn=12.0, course_deg=50.0)
    >>> raw = grid.sample(tx, ty) - gravity.correction(tx, ty, None)
    >>> found = match_with_reduction(grid, tx - 0.04, ty + 0.03, raw, gravity, transform="translation", starts="grid",
    ...                              refine=True, sigma=0.5, offset_sigma_m=4000.0)
    >>> error = np.hypot(found.fix.x - tx[-1], found.fix.y - ty[-1])
    >>> found.fix.status, bool(error < 0.001), found.converged, found.passes > 1
    ('fixed', True, True, True)
    """
    crs = getattr(grid, "crs", None)
    if not grid.geographic and crs is None:
        raise InvalidInputError(
            "match_with_reduction: needed a geographic map (degrees) or one with a CRS, got a projected one without"
        )
    if max_passes < 1:
        raise InvalidInputError(f"max_passes: needed at least 1, got {max_passes}")
    if not converged_m > 0:
        raise InvalidInputError(f"converged_m: needed a number > 0, got {converged_m}")
    px, py, raw = (np.asarray(a, dtype=float) for a in (x, y, readings))
    times = None if time_s is None else np.asarray(time_s, dtype=float)
    for name, a in (("x", px), ("y", py), ("readings", raw), ("time_s", times)):
        if a is not None and a.shape != (px.size,):
            raise ShapeError(f"match_with_reduction {name}: needed shape ({px.size},), got {a.shape}")
    ix, iy = (px, py) if crs is None or grid.geographic else transform(px, py, DEGREES, crs)
    at = np.column_stack([ix, iy])

    def correction() -> NDArray[np.float64]:
        here = (at[:, 0], at[:, 1]) if crs is None or grid.geographic else transform(at[:, 0], at[:, 1], crs, DEGREES)
        return reduction.correction(here[0], here[1], times)

    def match() -> Fix:
        return matcher(grid, Track(ix, iy, raw + correction(), times, height_m=height_m), **options)

    moved = np.inf
    first = fix = match()
    for passes in range(1, max_passes + 1):
        fix = match() if passes > 1 else first
        if not np.isfinite(fix.track).all() or len(fix.track) != px.size:
            break
        metres = np.array([grid.metres_per_unit(float(v)) for v in fix.track[:, 1]])
        turn = fix.track[:, 0] - at[:, 0]
        turn = (turn + 180.0) % 360.0 - 180.0 if grid.geographic else turn
        step = np.column_stack([turn, fix.track[:, 1] - at[:, 1]]) * metres
        moved = float(np.hypot(*step.T).max()) if passes > 1 else np.inf
        at = np.asarray(fix.track)
        if moved <= converged_m:
            break
    final = raw + correction()
    return Reduced(fix, final, passes, moved, moved <= converged_m, first)
