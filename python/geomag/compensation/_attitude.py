"""The Earth's field in a vehicle's axes, from its attitude."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomag._errors import InvalidInputError, ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def field_in_vehicle(
    field_ned_nt: ArrayLike,
    *,
    quaternion: ArrayLike | None = None,
    heading_deg: ArrayLike | None = None,
    pitch_deg: ArrayLike = 0.0,
    roll_deg: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """A field in the vehicle's axes (forward, right, down) from north, east, down and the attitude.

    In place of a vector magnetometer: `geomag.mainfield` gives the field. Not for flights without attitude, whose headings
    alone leave the terms of pitch and roll undetermined.

    Parameters
    ----------
    field_ned_nt : array of shape (3,) or (n, 3)
        Field at the samples, nT, north, east, down.
    quaternion : array of shape (4,) or (n, 4), optional
        Attitude (w, x, y, z), from the vehicle's axes to north, east, down; its length does not matter.
    heading_deg, pitch_deg, roll_deg : arrays of shape (n,)
        Instead of it: heading clockwise from north, pitch nose up, roll right wing down; applied in this order.

    Returns
    -------
    array of shape (n, 3), or (3,) for one sample

    Raises
    ------
    InvalidInputError, ShapeError

    Examples
    --------
    >>> from geomag.compensation import field_in_vehicle
    >>> field_in_vehicle([20_000.0, 0.0, 40_000.0], heading_deg=90.0).round()
    array([     0., -20000.,  40000.])
    """
    field = np.asarray(field_ned_nt, dtype=float)
    if field.ndim == 0 or field.shape[-1] != 3:
        raise ShapeError(f"field_ned_nt: needed shape (3,) or (n, 3), got {field.shape}")
    axes = axes_of(quaternion, heading_deg, pitch_deg, roll_deg)
    try:
        return np.asarray(np.einsum("...ji,...j->...i", axes, field))
    except ValueError as error:
        raise ShapeError(
            f"attitude: needed as many samples as field_ned_nt {field.shape}, got {axes.shape[:-2]}"
        ) from error


def axes_of(
    quaternion: ArrayLike | None, heading_deg: ArrayLike | None, pitch_deg: ArrayLike, roll_deg: ArrayLike
) -> NDArray[np.float64]:
    """Rotations from the vehicle's axes to north, east, down, shape (..., 3, 3), from either kind of attitude."""
    if (quaternion is None) == (heading_deg is None):
        raise InvalidInputError(
            "attitude: needed a quaternion, or heading_deg (with pitch_deg and roll_deg), got both or none"
        )
    if quaternion is not None:
        return _of_quaternion(np.asarray(quaternion, dtype=float))
    return _of_angles(*(np.radians(np.asarray(a, dtype=float)) for a in (heading_deg, pitch_deg, roll_deg)))


def _of_quaternion(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation from the vehicle's axes to north, east, down."""
    if q.ndim == 0 or q.shape[-1] != 4:
        raise ShapeError(f"quaternion: needed shape (4,) or (n, 4), got {q.shape}")
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    if (length == 0).any():
        raise InvalidInputError("quaternion: needed a length > 0, got 0")
    w, x, y, z = np.moveaxis(q / length, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _of_angles(
    heading: NDArray[np.float64], pitch: NDArray[np.float64], roll: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The same from heading, pitch and roll in radians (Groves, eq. 2.22)."""
    heading, pitch, roll = np.broadcast_arrays(heading, pitch, roll)
    (sh, ch), (sp, cp), (sr, cr) = ((np.sin(a), np.cos(a)) for a in (heading, pitch, roll))
    rows = (
        (cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh),
        (cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch),
        (-sp, sr * cp, cr * cp),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
