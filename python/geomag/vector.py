"""Vector readings: three components turned by the attitude, or what needs no attitude, as channels of a match.

A vector magnetometer reads three components in the vehicle's axes. With attitude they are turned into north, east, down
(`in_ned`); without one, what no rotation changes is left: the length ``|B|``, and with an accelerometer the component along gravity B.g
(`invariants`). Each becomes a channel beside a map of the same quantity: `component_channels` and `invariant_channels` make them
of a rectangular harmonic model, or of three component maps, for `match_posterior(..., channels=)` and `match_contour(..., channels=)`;
`geomag.FieldNavigator` takes them with `FieldSensor(model, reading=...)`.

>>> import numpy as np
>>> from geomag.vector import in_ned, invariants
>>> down = in_ned([[0.0, -20_000.0, 40_000.0]], heading_deg=[90.0])
>>> down.round()
array([[20000.,    -0., 40000.]])
>>> [float(v.round()[0]) for v in invariants([[0.0, -20_000.0, 40_000.0]], [[0.0, 0.0, 9.81]])]
[44721.0, 40000.0]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomag._errors import InvalidInputError, ShapeError
from geomag._geomag import GridMap
from geomag.compensation._attitude import axes_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Channel = tuple[GridMap, NDArray[np.float64], float | None]

__all__ = ["component_channels", "in_ned", "invariant_channels", "invariant_maps", "invariants"]


def _vectors(what: str, value: ArrayLike) -> NDArray[np.float64]:
    found = np.asarray(value, dtype=float)
    if found.ndim != 2 or found.shape[1] != 3:
        raise ShapeError(f"{what}: needed shape (n, 3), got {found.shape}")
    return found


def in_ned(
    vector: ArrayLike,
    *,
    quaternion: ArrayLike | None = None,
    heading_deg: ArrayLike | None = None,
    pitch_deg: ArrayLike = 0.0,
    roll_deg: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """Vectors in the vehicle's axes as north, east, down: what `compensation.field_in_vehicle` undoes.

    An attitude error of a milliradian turns 50 nT of 50,000 nT of main field into another component: take the main field off
    only after turning, and tell the matcher a sigma that has the attitude in it.

    Parameters
    ----------
    vector : array of shape (n, 3)
        Forward, right, down.
    quaternion, heading_deg, pitch_deg, roll_deg
        Attitude, as of `geomag.compensation.field_in_vehicle`.

    Returns
    -------
    array of shape (n, 3)

    Raises
    ------
    InvalidInputError, ShapeError
    """
    axes = axes_of(quaternion, heading_deg, pitch_deg, roll_deg)
    vectors = _vectors("vector", vector)
    try:
        return np.asarray(np.einsum("...ij,...j->...i", axes, vectors))
    except ValueError as error:
        raise ShapeError(
            f"attitude: needed as many samples as vector {vectors.shape}, got {axes.shape[:-2]}"
        ) from error


def invariants(field_nt: ArrayLike, gravity: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What no attitude changes: total intensity and the component along gravity (down), nT, two arrays of shape (n,).

    Parameters
    ----------
    field_nt : array of shape (n, 3)
        Field in any axes of the vehicle.
    gravity : array of shape (n, 3)
        Direction of gravity in the same axes, of any length: for a vehicle that does not accelerate minus the specific force.

    Raises
    ------
    ShapeError, InvalidInputError
        For a gravity without direction, naming the first.
    """
    field, down = _vectors("field_nt", field_nt), _vectors("gravity", gravity)
    if field.shape != down.shape:
        raise ShapeError(f"gravity: needed shape {field.shape} as field_nt, got {down.shape}")
    length = np.linalg.norm(down, axis=1)
    if not (length > 0).all():
        k = int(np.argmin(length > 0))
        raise InvalidInputError(f"gravity[{k}]: needed a direction, got {down[k].tolist()}")
    return np.linalg.norm(field, axis=1), np.einsum("ij,ij->i", field, down) / length


def _same(maps: tuple[GridMap, GridMap, GridMap]) -> None:
    first = maps[0]
    for k, other in enumerate(maps[1:], 1):
        if other.shape != first.shape or not (np.allclose(other.x, first.x) and np.allclose(other.y, first.y)):
            raise ShapeError(f"maps[{k}]: needed the nodes of maps[0], {first.shape}, got others, {other.shape}")
        if other.geographic != first.geographic:
            raise InvalidInputError(
                f"maps[{k}]: needed coordinates of the kind of maps[0], got a mixture of degrees and metres"
            )


def component_channels(
    maps: tuple[GridMap, GridMap, GridMap],
    readings_ned: ArrayLike,
    sigma: float | tuple[float, float, float] | None = None,
) -> list[Channel]:
    """Three channels of a match: north, east and down, each with its map.

    Parameters
    ----------
    maps : three GridMap
        North, east, down on the same nodes; `RectangularHarmonicModel.to_map('north', ...).to_grid(x, y)` makes one.
    readings_ned : array of shape (n, 3)
        Readings as `in_ned` gives them, reduced as the maps are.
    sigma : float or three, optional
        Standard deviation of a reading, nT.

    Returns
    -------
    list of (map, values, sigma)
        The first one is the track's own, the others go into `channels=`.

    Raises
    ------
    ShapeError, InvalidInputError

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.vector import component_channels
    >>> axis = np.arange(0.0, 6000.0, 60.0)
    >>> east, north = np.meshgrid(axis, axis)
    >>> waves = (np.sin(east / 400), np.cos(north / 300), np.sin((east + north) / 500))
    >>> maps = tuple(geomag.GridMap(40 * w, axis, axis, sigma=0.0) for w in waves)
    >>> x, y = np.linspace(2000, 2600, 12), np.linspace(2500, 2900, 12)
    >>> read = np.column_stack([m.sample(x, y) for m in maps])
    >>> (first, values, sigma), *more = component_channels(maps, read, 1.0)
    >>> track = geomag.Track(x - 210, y + 160, values)
    >>> fix = geomag.match_contour(first, track, starts="grid", refine=True, sigma=sigma, offset_sigma_m=200.0, channels=more)
    >>> fix.status, [round(v, -1) for v in fix.offset_m]
    ('fixed', [210.0, -160.0])
    """
    if len(maps) != 3:
        raise InvalidInputError(f"maps: needed three, north, east and down, got {len(maps)}")
    _same(maps)
    readings = _vectors("readings_ned", readings_ned)
    sigmas = tuple(sigma) if isinstance(sigma, (tuple, list, np.ndarray)) else (sigma,) * 3
    if len(sigmas) != 3:
        raise InvalidInputError(f"sigma: needed one or three, got {len(sigmas)}")
    return [(m, readings[:, k].copy(), sigmas[k]) for k, m in enumerate(maps)]


def invariant_maps(
    maps: tuple[GridMap, GridMap, GridMap], main_ned_nt: ArrayLike | None = None
) -> tuple[GridMap, GridMap]:
    """Maps of total intensity and of the component along gravity from three component maps.

    Parameters
    ----------
    maps : three GridMap
        North, east, down on the same nodes.
    main_ned_nt : array of shape (3,), optional
        Main field to be added where the maps hold anomalies; that of the middle of the map serves one of some tens of
        kilometres. The intensity is then that of both less that of the main field.

    Returns
    -------
    intensity, down : GridMap
    """
    _same(maps)
    main = np.zeros(3) if main_ned_nt is None else np.asarray(main_ned_nt, dtype=float)
    if main.shape != (3,):
        raise ShapeError(f"main_ned_nt: needed shape (3,), got {main.shape}")
    parts = [np.asarray(m.values, dtype=float) + b for m, b in zip(maps, main, strict=True)]
    total = np.sqrt(sum(p * p for p in parts)) - float(np.linalg.norm(main))
    first = maps[0]
    made = GridMap(
        total, first.x, first.y, geographic=first.geographic, sigma=first.sigma, height_m=first.height_m, units="nT",
        crs=first.crs, ground_scale=first.ground_scale,
    )  # fmt: skip
    return made, maps[2]


def invariant_channels(
    maps: tuple[GridMap, GridMap, GridMap],
    field_nt: ArrayLike,
    gravity: ArrayLike,
    *,
    main_ned_nt: ArrayLike | None = None,
    sigma: tuple[float | None, float | None] = (None, None),
) -> list[Channel]:
    """Two channels of a match without attitude: total intensity and the component along gravity, each with its map.

    Parameters
    ----------
    maps : three GridMap
        Component maps, as of `invariant_maps`.
    field_nt, gravity : arrays of shape (n, 3)
        Readings in the vehicle's axes.
    main_ned_nt : array of shape (3,), optional
        Main field, where the maps hold anomalies: it is taken off the readings and put into the map of the intensity.
    sigma : pair, optional
        Standard deviations of intensity and down. A tilt error of t radians turns H t of the horizontal field into down.

    Returns
    -------
    list of (map, values, sigma)

    Raises
    ------
    ShapeError, InvalidInputError
    """
    intensity, down = invariant_maps(maps, main_ned_nt)
    total, along = invariants(field_nt, gravity)
    main = np.zeros(3) if main_ned_nt is None else np.asarray(main_ned_nt, dtype=float)
    return [(intensity, total - float(np.linalg.norm(main)), sigma[0]), (down, along - main[2], sigma[1])]
