"""What a fit gives: coefficients with their covariance, applied to logs and streams."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geomag._errors import InvalidInputError, MissingFileError, NotFiniteError, ReadError, ShapeError
from geomag._geomag import Compensator, tolles_lawson_terms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

_AXES = "xyz"
#: Names of the terms in their order: permanent, induced, eddy (direction, then rate).
TERM_NAMES = (
    *(f"permanent {a}" for a in _AXES),
    *(f"induced {a}{b}" for i, a in enumerate(_AXES) for b in _AXES[i:]),
    *(f"eddy {a}{b}" for a in _AXES for b in _AXES),
)
_MARK = "geomag compensation 1"


def terms(
    field_nt: ArrayLike, time_s: ArrayLike | None = None, *, max_gap_s: float | None = None
) -> NDArray[np.float64]:
    """The 18 terms at every sample of a log, shape (n, 18), in the order of `TERM_NAMES`.

    With u the unit vector of the field b and r its rate, s = 50,000 nT: u_i; u_i b_j / s, i <= j; u_i r_j / s.

    Parameters
    ----------
    field_nt : array of shape (n, 3)
        The field in the vehicle's axes, nT. A sample with NaN has NaN terms.
    time_s : array of shape (n,), optional
        Times, rising; rates are nT a second then, else nT a sample. Central differences, one-sided beside gaps.
    max_gap_s : float, optional
        Longest step over which a rate is taken; 2.5 median steps by default.

    Raises
    ------
    ShapeError, InvalidInputError

    Examples
    --------
    >>> from geomag.compensation import terms
    >>> terms([[30_000.0, 0, 40_000], [30_500, 0, 39_600], [31_000, 0, 39_200]]).shape
    (3, 18)
    """
    if max_gap_s is None:
        step = 1.0
        if time_s is not None and np.size(time_s) > 1:
            step = float(np.median(np.diff(np.asarray(time_s, dtype=float))))
        max_gap_s = 2.5 * step if step > 0 else 1.0
    return np.asarray(tolles_lawson_terms(field_nt, time_s, max_gap_s))


class Leftover(NamedTuple):
    """What compensation leaves on readings, for matchers and filters."""

    sigma_nt: NDArray[np.float64]
    """Standard deviation of the leftover at every sample, nT, shape (n,)."""
    leg: NDArray[np.int64]
    """Number of the straight leg of every sample, from 0; -1 in turns, shape (n,)."""
    leg_sigma_nt: float
    """Standard deviation of the leftover's level from leg to leg, nT: a bias per leg."""
    within_sigma_nt: float
    """Standard deviation of the leftover about the level of its leg, nT."""


@dataclass(frozen=True)
class Compensation:
    """Coefficients of a vehicle's own field, with what the fit knows of them.

    Made by `fit` or `from_json`. For the vehicle, sensor places and sensor axes of the calibration only.

    Attributes
    ----------
    coefficients : array of shape (18,), nT, in the order of `TERM_NAMES`
    covariance : array of shape (18, 18), nT^2
        Of the coefficients, correlation of the residuals heeded.
    ridge : float
        Penalty that was used.
    band_hz : pair of floats
        Band of the fit.
    max_gap_s : float
        Longest step over which a stream takes a rate: 2.5 steps of the calibration.
    improvement_ratio : float
        Standard deviation in the band before over after, on the calibration flight.
    residual_nt : float
        Standard deviation in the band after, on the calibration flight, nT.
    samples : int
        Samples behind the fit.
    """

    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    ridge: float
    band_hz: tuple[float, float]
    max_gap_s: float
    improvement_ratio: float
    residual_nt: float
    samples: int

    def __post_init__(self) -> None:
        for name, shape in (("coefficients", (18,)), ("covariance", (18, 18))):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise ShapeError(f"compensation {name}: needed shape {shape}, got {value.shape}")
            if not np.isfinite(value).all():
                raise NotFiniteError(f"compensation {name}: needed finite numbers, got NaN or infinity")
            value = value.copy()
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        if not self.max_gap_s > 0:
            raise InvalidInputError(f"compensation max_gap_s: needed a number > 0, got {self.max_gap_s}")

    def interference(self, time_s: ArrayLike, field_nt: ArrayLike) -> NDArray[np.float64]:
        """The vehicle's own field at every sample of a log, nT, shape (n,); NaN where the field is NaN.

        Rates are taken over the log's own steps: one that is logged more slowly than the vehicle sways has poor eddy terms. Where
        no rate can be had (a lone sample between gaps) they are left out.
        """
        rows = terms(field_nt, time_s)
        lone = np.isfinite(rows[:, :9]).all(axis=1) & ~np.isfinite(rows[:, 9:]).all(axis=1)
        rows[lone, 9:] = 0.0
        return np.asarray(rows @ self.coefficients)

    def apply(self, time_s: ArrayLike, reading_nt: ArrayLike, field_nt: ArrayLike) -> NDArray[np.float64]:
        """Readings without the vehicle's own field, nT, shape (n,).

        Parameters
        ----------
        time_s : array of shape (n,)
            Times, seconds, rising.
        reading_nt : array of shape (n,)
            Scalar readings; NaN stays NaN.
        field_nt : array of shape (n, 3)
            The field in the vehicle's axes.

        Raises
        ------
        ShapeError, InvalidInputError
        """
        reading = np.asarray(reading_nt, dtype=float)
        own = self.interference(time_s, field_nt)
        if reading.shape != own.shape:
            raise ShapeError(f"reading_nt: needed shape {own.shape} as field_nt, got {reading.shape}")
        return reading - own

    def stream(self) -> Compensator:
        """A compensator for readings as they come, in Rust; rates are half a sample late."""
        return Compensator(self.coefficients, max_gap_s=self.max_gap_s)

    def leftover(
        self, time_s: ArrayLike, field_nt: ArrayLike, heading_deg: ArrayLike, *, turn_deg_s: float = 1.0
    ) -> Leftover:
        """What these coefficients leave on a log, from their covariance.

        What a scalar matcher takes as a bias anyway (the mean over the whole log) is no part of it.

        Parameters
        ----------
        time_s, field_nt
            The log, as of `apply`.
        heading_deg : array of shape (n,)
            Heading of the samples, by which legs are told.
        turn_deg_s : float
            Rate from which it is a turn.

        Returns
        -------
        Leftover
            `leg_sigma_nt` is the bias per leg for matchers; `sigma_nt` goes with single readings.
        """
        time = np.asarray(time_s, dtype=float)
        rows = terms(field_nt, time)
        rows[~np.isfinite(rows)] = 0.0
        heading = np.asarray(heading_deg, dtype=float)
        if heading.shape != time.shape:
            raise ShapeError(f"heading_deg: needed shape {time.shape} as time_s, got {heading.shape}")
        if time.size < 2:
            raise InvalidInputError(f"leftover: needed at least 2 samples, got {time.size}")
        rate = np.gradient(np.unwrap(np.radians(heading)), time)
        straight = np.abs(np.degrees(rate)) < turn_deg_s
        start = straight & ~np.concatenate([[False], straight[:-1]])
        leg = np.where(straight, np.cumsum(start) - 1, -1)
        rows -= rows.mean(axis=0)
        variance = np.einsum("ij,jk,ik->i", rows, self.covariance, rows)
        level = np.zeros_like(rows)
        for k in range(int(leg.max()) + 1):
            level[leg == k] = rows[leg == k].mean(axis=0)
        between = np.einsum("ij,jk,ik->i", level[straight], self.covariance, level[straight])
        about = rows - level
        within = np.einsum("ij,jk,ik->i", about[straight], self.covariance, about[straight])
        mean = [float(np.sqrt(v.mean())) if v.size else 0.0 for v in (between, within)]
        return Leftover(np.sqrt(np.maximum(variance, 0.0)), leg, *mean)

    def to_json(self, path: str | Path) -> None:
        """Write it to a file that people can read; terms by name."""
        saved = {
            "format": _MARK,
            "terms": dict(zip(TERM_NAMES, self.coefficients.tolist(), strict=True)),
            "covariance": self.covariance.tolist(),
            "ridge": self.ridge,
            "band_hz": list(self.band_hz),
            "max_gap_s": self.max_gap_s,
            "improvement_ratio": self.improvement_ratio,
            "residual_nt": self.residual_nt,
            "samples": self.samples,
        }
        Path(path).write_text(json.dumps(saved, indent=1), encoding="utf-8")

    @classmethod
    def from_json(cls, path: str | Path) -> Compensation:
        """Read it back, to the last bit."""
        path = Path(path)
        if not path.exists():
            raise MissingFileError(f"compensation: needed an existing file, got nothing at {path}")
        try:
            saved: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            if saved["format"] != _MARK:
                raise ValueError(f"format {saved['format']!r}")
            return cls(
                coefficients=np.array([saved["terms"][name] for name in TERM_NAMES], dtype=float),
                covariance=np.array(saved["covariance"], dtype=float),
                ridge=float(saved["ridge"]),
                band_hz=(float(saved["band_hz"][0]), float(saved["band_hz"][1])),
                max_gap_s=float(saved["max_gap_s"]),
                improvement_ratio=float(saved["improvement_ratio"]),
                residual_nt=float(saved["residual_nt"]),
                samples=int(saved["samples"]),
            )
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            raise ReadError(f"{path}: needed a saved compensation ({_MARK}), got: {error!r}") from error


def figure_of_merit(reading_nt: ArrayLike, manoeuvres: Sequence[slice]) -> float:
    """Sum over manoeuvres of the peak-to-peak reading in each, nT: the survey industry's measure of a compensation.

    By custom twelve manoeuvres: pitch, roll and yaw on four headings, on band-passed or compensated readings over quiet crust.
    Each is freed of its straight line first. NaN samples are passed over.

    >>> import numpy as np
    >>> from geomag.compensation import figure_of_merit
    >>> k = np.arange(200)
    >>> round(figure_of_merit(np.sin(k / 5) + 0.01 * k, [slice(0, 100), slice(100, 200)]), 1)
    4.2
    """
    values = np.asarray(reading_nt, dtype=float)
    total = 0.0
    for k, part in enumerate(manoeuvres):
        piece = values[part]
        at = np.flatnonzero(np.isfinite(piece))
        if at.size < 3:
            raise InvalidInputError(f"manoeuvres[{k}]: needed at least 3 samples that are numbers, got {at.size}")
        total += float(np.ptp(piece[at] - np.polyval(np.polyfit(at, piece[at], 1), at)))
    return total
