"""Maps and tracks brought into one frame: coordinate reference systems, and metres that are metres on the ground.

A map in UTM and a log in degrees are one frame apart; `align` turns the log into the map's coordinates by pyproj. Matchers do so
by themselves where the track says that it is in degrees (`Track(..., geographic=True)`, as `read_track` does) and the map has a
CRS; without a CRS they refuse. On a Mercator map a metre on paper is less than one on the ground: `true_scale` gives a map the scale of
its projection, row by row, and every distance in metres is one on the ground then. `read_grid` does that by itself.

>>> import geomag
>>> from geomag.projection import align
>>> grid = geomag.GridMap([[0.0, 1], [2, 3]], [5e5, 5.1e5], [4.98e6, 4.99e6], crs="EPSG:32632")
>>> track = geomag.Track([9.01, 9.02], [45.0, 45.01], [1.0, 2.0], geographic=True)
>>> align(grid, track, quiet=True).x.round()
array([500788., 501576.])
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Track
from geomag._metres import metres_per_unit
from geomag._optional import require

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["AlignedWarning", "align", "convergence_deg", "transform", "true_scale"]

#: Scales nearer to one than this are left: UTM within its zone.
_NEAR_ONE = 1e-3
#: Degrees of longitude and latitude as logs have them.
DEGREES = "EPSG:4326"


class AlignedWarning(UserWarning):
    """A track has been brought to the coordinates of a map; the message says from which to which."""


@lru_cache(maxsize=32)
def _crs(crs: str) -> Any:  # noqa: ANN401 - pyproj's
    pyproj = require("pyproj", "geo", "coordinate reference systems")
    try:
        return pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise InvalidInputError(
            f"crs: needed a coordinate reference system (EPSG:..., WKT), got {crs[:60]!r}"
        ) from error


def _name(crs: str) -> str:
    found = _crs(crs)
    authority = found.to_authority(min_confidence=70)
    return f"{found.name} ({':'.join(authority)})" if authority else str(found.name)


@lru_cache(maxsize=32)
def _transformer(source: str, target: str) -> Any:  # noqa: ANN401 - pyproj's
    pyproj = require("pyproj", "geo", "coordinate reference systems")
    return pyproj.Transformer.from_crs(_crs(source), _crs(target), always_xy=True)


def transform(x: ArrayLike, y: ArrayLike, source: str, target: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates of one reference system in another; x is longitude or easting in both.

    Parameters
    ----------
    x, y : arrays of one shape
    source, target : str
        EPSG codes, WKT, or what else pyproj knows.

    Raises
    ------
    InvalidInputError
        For a system that is none, and for points that have no coordinates in the other one, naming the first.
    MissingDependencyError

    Examples
    --------
    >>> from geomag.projection import transform
    >>> [float(v.round(1)) for v in transform(9.0, 45.0, "EPSG:4326", "EPSG:32632")]
    [500000.0, 4982950.4]
    """
    px, py = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    out = [np.asarray(v, dtype=float) for v in _transformer(source, target).transform(px, py)]
    bad = ~(np.isfinite(out[0]) & np.isfinite(out[1])).ravel()
    if bad.any():
        k = int(np.argmax(bad))
        raise InvalidInputError(
            f"point [{k}]: needed one that {_name(target)} has coordinates for, got x {px.ravel()[k]}, y {py.ravel()[k]} in {_name(source)}"
        )
    return out[0], out[1]


def convergence_deg(crs: str, longitude: ArrayLike, latitude: ArrayLike) -> NDArray[np.float64]:
    """Bearing of a projection's north at places in degrees, clockwise from true north, degrees; 0 for a system in degrees.

    A course over the map is that over the ground less this.

    Examples
    --------
    >>> from geomag.projection import convergence_deg
    >>> convergence_deg("EPSG:32632", [10.5, 12.0], [45.0, 45.0]).round(3)
    array([1.061, 2.122])
    """
    lon, lat = np.broadcast_arrays(np.asarray(longitude, dtype=float), np.asarray(latitude, dtype=float))
    if _crs(crs).is_geographic:
        return np.zeros(lon.shape)
    pyproj = require("pyproj", "geo", "coordinate reference systems")
    return np.asarray(pyproj.Proj(_crs(crs)).get_factors(lon, lat).meridian_convergence, dtype=float)


def align(grid: GridMap, track: Track, *, track_crs: str | None = None, quiet: bool = False) -> Track:
    """A track in the coordinates of a map.

    Parameters
    ----------
    grid : GridMap
        The map; its `crs` is asked where track and map are not in the same coordinates.
    track : Track
        The track; its `geographic` says whether it is in degrees (WGS84). Not said, it is taken to be as the map is, unless
        `track_crs` is given.
    track_crs : str, optional
        Reference system of the track, where it is another than WGS84 degrees.
    quiet : bool
        Not to say what was done; else an `AlignedWarning` does.

    Returns
    -------
    Track
        The same one where nothing had to be done.

    Raises
    ------
    InvalidInputError
        Degrees against metres without a CRS; MissingDependencyError.

    Examples
    --------
    >>> import geomag
    >>> from geomag.projection import align
    >>> local = geomag.GridMap([[0.0, 1], [2, 3]], [0, 100.0], [0, 100.0])
    >>> try:
    ...     align(local, geomag.Track([9.0], [45.0], [1.0], geographic=True))
    ... except geomag.InvalidInputError as error:
    ...     print(error)
    track: needed positions in metres as the map's, got degrees, and the map has no CRS by which to turn them
    """
    kinds = ("degrees", "metres")
    if track_crs is None:
        if track.geographic is None or track.geographic == grid.geographic:
            return track
        ours, theirs = kinds if grid.geographic else kinds[::-1]
        if not track.geographic:
            raise InvalidInputError(
                f"track: needed positions in {ours} as the map's, got {theirs}, and no track_crs by which to turn them"
            )
        if grid.crs is None:
            raise InvalidInputError(
                f"track: needed positions in {ours} as the map's, got {theirs}, and the map has no CRS by which to turn them"
            )
        track_crs = DEGREES
    target = grid.crs or (DEGREES if grid.geographic else None)
    if target is None:
        raise InvalidInputError(f"track_crs: needed a map with a CRS, got one in {kinds[not grid.geographic]} without")
    if _crs(track_crs) == _crs(target):
        return track
    x, y = transform(track.x, track.y, track_crs, target)
    if not quiet:
        warnings.warn(
            f"track: turned from {_name(track_crs)} to the map's {_name(target)}", AlignedWarning, stacklevel=2
        )
    return Track(x, y, track.values, track.time_s, height_m=track.height_m, geographic=grid.geographic)


def true_scale(grid: GridMap) -> GridMap:
    """A map with the scale of its projection, so that its metres are metres on the ground.

    The scale is taken along the middle column, row by row. A geographic map, one without a CRS, and one whose scale is
    within a thousandth of one (UTM within its zone) come back as they are.

    Parameters
    ----------
    grid : GridMap

    Returns
    -------
    GridMap

    Raises
    ------
    InvalidInputError, MissingDependencyError

    Examples
    --------
    >>> import geomag
    >>> from geomag.projection import true_scale
    >>> grid = geomag.GridMap([[0.0, 1], [2, 3]], [1.1e6, 1.11e6], [8.39e6, 8.40e6], crs="EPSG:3857")
    >>> [round(v, 2) for v in true_scale(grid).metres_per_unit(8.39e6)]
    [0.5, 0.5]
    """
    if grid.geographic or grid.crs is None or not _crs(grid.crs).is_projected:
        return grid
    y = np.asarray(grid.y)
    x = np.full(y.shape, 0.5 * (grid.x[0] + grid.x[-1]))
    degrees = _crs(grid.crs).geodetic_crs.to_wkt()
    step = 0.01 * min(grid.spacing)
    scale = np.empty((y.size, 2))
    # By the ellipsoid itself: the formulas of Web Mercator are those of a sphere, its latitudes are not.
    for axis, (dx, dy) in enumerate(((step, 0.0), (0.0, step))):
        ends = [transform(x + k * dx, y + k * dy, grid.crs, degrees) for k in (-1.0, 1.0)]
        turn = (ends[1][0] - ends[0][0] + 180.0) % 360.0 - 180.0
        ground = np.array([metres_per_unit(True, float(v)) for v in 0.5 * (ends[0][1] + ends[1][1])])
        scale[:, axis] = np.hypot(turn * ground[:, 0], (ends[1][1] - ends[0][1]) * ground[:, 1]) / (2.0 * step)
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise InvalidInputError(
            f"map: needed coordinates that {_name(grid.crs)} has a scale for, got y {y[0]} to {y[-1]}"
        )
    return grid if np.abs(scale - 1.0).max() < _NEAR_ONE else grid.with_ground_scale(scale)
