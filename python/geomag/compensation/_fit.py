"""Coefficients from a calibration flight: band-passed least squares with a ridge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from geomag._errors import InvalidInputError, NotFiniteError, ShapeError, TooFewSamplesError
from geomag._geomag import GridMap, MapStack
from geomag._optional import require
from geomag.compensation._model import Compensation, terms
from geomag.continuation import _stack_for

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

#: Terms are of order one; below this their changes are rounding.
_STEADY = 1e-10
#: Penalties tried by cross-validation, shares of the greatest eigenvalue of the normal matrix.
_SHARES = 10.0 ** np.arange(-12.0, 0.5, 0.5)


def solve(rows: ArrayLike, signal_nt: ArrayLike, ridge: float) -> NDArray[np.float64]:
    """Coefficients of least squares with a ridge: (A'A + ridge I)^-1 A'y.

    Parameters
    ----------
    rows : array of shape (n, terms)
    signal_nt : array of shape (n,)
    ridge : float, >= 0

    Raises
    ------
    ShapeError, NotFiniteError, InvalidInputError

    Examples
    --------
    >>> from geomag.compensation import solve
    >>> solve([[1.0, 0.0], [0.0, 2.0]], [3.0, 4.0], 0.0)
    array([3., 2.])
    """
    a, y = np.asarray(rows, dtype=float), np.asarray(signal_nt, dtype=float)
    if a.ndim != 2 or y.shape != a.shape[:1]:
        raise ShapeError(f"solve: needed rows (n, terms) and signal (n,), got {a.shape} and {y.shape}")
    if not (np.isfinite(a).all() and np.isfinite(y).all()):
        raise NotFiniteError("solve: needed finite rows and signal, got NaN or infinity")
    if not (np.isfinite(ridge) and ridge >= 0):
        raise InvalidInputError(f"ridge: needed a finite number >= 0, got {ridge}")
    normal = a.T @ a
    normal[np.diag_indices_from(normal)] += ridge
    try:
        return np.asarray(np.linalg.solve(normal, a.T @ y))
    except np.linalg.LinAlgError as error:
        raise InvalidInputError(f"ridge: needed one > 0 where terms are not told apart, got {ridge}") from error


def fit(
    time_s: ArrayLike,
    reading_nt: ArrayLike,
    field_nt: ArrayLike,
    *,
    expected_nt: ArrayLike | None = None,
    crust: tuple[GridMap | MapStack, ArrayLike, ArrayLike]
    | tuple[GridMap | MapStack, ArrayLike, ArrayLike, ArrayLike]
    | None = None,
    band_hz: tuple[float, float] = (0.1, 0.9),
    ridge: float | Literal["cv"] = "cv",
    folds: int = 5,
    saturation_nt: tuple[float, float] | None = None,
    trim_s: float | None = None,
) -> Compensation:
    """Find the vehicle's own field on a calibration flight.

    Readings and terms are band-passed (Butterworth of order 4, to and fro), which leaves manoeuvres and takes out the main field,
    the diurnal variation and wide crust; what is left is fitted by least squares with a ridge. For flights with pitch, roll
    and yaw manoeuvres on several headings. Not for straight flight, which determines no term; and crust that is rough in the band
    has to be flown over high, or be told by `expected_nt`.

    Parameters
    ----------
    time_s : array of shape (n,)
        Times, seconds, rising. Missing rows are gaps: short ones (up to half a period of the upper edge of the band) are
        bridged for the filter and their samples left out, long ones part the log.
    reading_nt : array of shape (n,)
        Scalar readings, nT; NaN is left out.
    field_nt : array of shape (n, 3)
        Field in the vehicle's axes, nT: a vector magnetometer's, or `field_in_vehicle` of main field and attitude. NaN is left out.
    expected_nt : array of shape (n,), optional
        What is known of the field along the flight, the main field for one. It is taken off first.
    crust : tuple (map, x, y) or (map, x, y, height_m), optional
        A map of the crust and where the flight was, map units, by GNSS: what the map says there is taken off first, at the heights of the
        flight where these are given. Samples off the map are left out. For flights low over rough crust.
    band_hz : pair of floats
        Band in which is fitted, Hz.
    ridge : float or 'cv'
        Penalty, or the one with the least error on blocks left out.
    folds : int
        Blocks for 'cv', >= 2.
    saturation_nt : pair of floats, optional
        Readings at or beyond these are saturated and left out.
    trim_s : float, optional
        What is cut off at both ends of every piece after filtering; a fifth of the longest period in the band by default.

    Returns
    -------
    Compensation

    Raises
    ------
    ShapeError, InvalidInputError, TooFewSamplesError, MissingDependencyError

    References
    ----------
    Tolles and Lawson (1950), US patent 2692970; Leliak (1961), doi 10.1109/TANE3.1961.4201799; Gnadt et al. (2020), arXiv 2007.12158.

    Examples
    --------
    >>> from geomag import compensation, synthetic
    >>> flight = synthetic.calibration_box(seed=1)
    >>> compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt).samples > 2000
    True
    """
    time, reading, field = (np.asarray(a, dtype=float) for a in (time_s, reading_nt, field_nt))
    n = time.size
    for name, given, shape in (("time_s", time, (n,)), ("reading_nt", reading, (n,)), ("field_nt", field, (n, 3))):
        if given.shape != shape:
            raise ShapeError(f"compensation {name}: needed shape {shape}, got {given.shape}")
    if n < 2 or not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise InvalidInputError("compensation time_s: needed at least 2 finite times that rise, got others")
    if expected_nt is not None:
        expected = np.asarray(expected_nt, dtype=float)
        if expected.shape != (n,):
            raise ShapeError(f"compensation expected_nt: needed shape {(n,)}, got {expected.shape}")
        reading = reading - expected
    if crust is not None:
        reading = reading - crust_along(n, *crust)
    good = np.isfinite(reading) & np.isfinite(field).all(axis=1)
    if saturation_nt is not None:
        raw = np.asarray(reading_nt, dtype=float)
        with np.errstate(invalid="ignore"):
            good &= (raw > saturation_nt[0]) & (raw < saturation_nt[1])
    step = float(np.median(np.diff(time)))
    low, high = (float(f) for f in band_hz)
    if not 0 < low < high < 0.5 / step:
        raise InvalidInputError(f"band_hz: needed 0 < low < high < {0.5 / step:g}, half the sample rate, got {band_hz}")
    if ridge != "cv" and not (np.isfinite(ridge) and ridge >= 0):
        raise InvalidInputError(f"ridge: needed 'cv' or a finite number >= 0, got {ridge!r}")
    if folds < 2:
        raise InvalidInputError(f"folds: needed at least 2, got {folds}")
    trim = 0.2 / low if trim_s is None else float(trim_s)
    if not trim >= 0:
        raise InvalidInputError(f"trim_s: needed a number >= 0, got {trim_s}")
    rows, signal = _pieces(time, reading, field, good, step, (low, high), trim)
    if len(signal) < 4 * rows.shape[1]:
        raise TooFewSamplesError(
            f"compensation: needed at least {4 * rows.shape[1]} good samples in pieces longer than {2 * trim:g} s, "
            f"got {len(signal)}"
        )
    if not np.sqrt(np.mean(rows**2)) > _STEADY:
        raise InvalidInputError("compensation: needed a field that changes direction in the band, got a steady one")
    penalty = _cross_validated(rows, signal, folds) if ridge == "cv" else float(ridge)
    coefficients = solve(rows, signal, penalty)
    left = signal - rows @ coefficients
    covariance = _covariance(rows, left, coefficients, penalty, round(0.5 / (low * step)))
    after = float(np.std(left))
    ratio = float(np.std(signal)) / after if after > 0 else float("inf")
    return Compensation(coefficients, covariance, penalty, (low, high), 2.5 * step, ratio, after, len(signal))


def crust_along(
    n: int, grid: GridMap | MapStack, x: ArrayLike, y: ArrayLike, height_m: ArrayLike | None = None
) -> NDArray[np.float64]:
    """What a map says along a flight of n samples; NaN off the map."""
    px, py = (np.asarray(v, dtype=float) for v in (x, y))
    for name, given in (("x", px), ("y", py)):
        if given.shape != (n,):
            raise ShapeError(f"compensation crust {name}: needed shape {(n,)}, got {given.shape}")
    if height_m is None:
        if isinstance(grid, MapStack):
            raise InvalidInputError("compensation crust: needed (stack, x, y, height_m), got no heights")
        return np.asarray(grid.sample(px, py, interpolation="bicubic"), dtype=float)
    height = np.broadcast_to(np.asarray(height_m, dtype=float), (n,))
    if not np.isfinite(height).all():
        raise NotFiniteError("compensation crust height_m: needed finite heights, got NaN or infinity")
    stack = grid if isinstance(grid, MapStack) else _stack_for(grid, float(height.min()), float(height.max()), False)
    return np.asarray(stack.sample(px, py, height), dtype=float)


def _pieces(
    time: NDArray[np.float64],
    reading: NDArray[np.float64],
    field: NDArray[np.float64],
    good: NDArray[np.bool_],
    step: float,
    band: tuple[float, float],
    trim: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Band-passed terms and readings of all pieces, one below the other."""
    signal: Any = require("scipy.signal", "compensation", "band-passing a calibration flight")
    sections = signal.butter(4, band, btype="bandpass", fs=1.0 / step, output="sos")
    pad = 6 * len(sections)
    cut = round(trim / step)
    bridge = max(0.5 / band[1], 2.5 * step)
    at = np.flatnonzero(good)
    parts = np.split(at, np.flatnonzero(np.diff(time[at]) > bridge) + 1) if at.size else []
    found = []
    for part in parts:
        if part.size < 2:
            continue
        grid = time[part[0]] + step * np.arange(int((time[part[-1]] - time[part[0]]) / step + 1.5))
        if grid.size <= max(2 * cut, pad) + 1:
            continue
        values = np.interp(grid, time[part], reading[part])
        vectors = np.column_stack([np.interp(grid, time[part], field[part, i]) for i in range(3)])
        rows = terms(vectors, grid)
        filtered = signal.sosfiltfilt(sections, np.column_stack([rows, values]), axis=0, padlen=pad)
        nearest = np.clip(np.searchsorted(time[part], grid), 1, part.size - 1)
        away = np.minimum(np.abs(grid - time[part][nearest - 1]), np.abs(grid - time[part][nearest]))
        keep = away <= 0.75 * step
        keep[:cut] = False
        keep[keep.size - cut :] = False
        found.append(filtered[keep])
    whole = np.vstack(found) if found else np.empty((0, 19))
    return whole[:, :-1], whole[:, -1]


def _cross_validated(rows: NDArray[np.float64], signal: NDArray[np.float64], folds: int) -> float:
    """The penalty whose fit without a block errs least on it, over contiguous blocks."""
    normal, right = rows.T @ rows, rows.T @ signal
    greatest = float(np.linalg.eigvalsh(normal)[-1])
    errors = np.zeros(_SHARES.size)
    for block in np.array_split(np.arange(len(signal)), folds):
        a, y = rows[block], signal[block]
        values, vectors = np.linalg.eigh(normal - a.T @ a)
        turned, seen = vectors.T @ (right - a.T @ y), a @ vectors
        for k, share in enumerate(_SHARES):
            errors[k] += float(np.sum((y - seen @ (turned / (np.maximum(values, 0.0) + share * greatest))) ** 2))
    return float(_SHARES[int(np.argmin(errors))] * greatest)


def _covariance(
    rows: NDArray[np.float64],
    left: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    ridge: float,
    lags: int,
) -> NDArray[np.float64]:
    """Covariance of the coefficients: correlated residuals (Newey and West 1987) and what the ridge holds back.

    Of a direction that the flight does not determine the fit says nothing; its share of the coefficients is taken to be as
    large as they are on the mean.
    """
    normal = rows.T @ rows
    inverse = np.linalg.pinv(normal + ridge * np.eye(len(normal)), hermitian=True)
    scores = rows * left[:, None]
    middle = scores.T @ scores
    for lag in range(1, min(lags, len(left) - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    held = ridge**2 * float(np.mean(coefficients**2)) * np.eye(len(normal))
    covariance = inverse @ (middle + held) @ inverse
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
