"""Small statistics that reports and pictures share; NumPy and the standard library only."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

#: Median of a chi-square of two degrees of freedom: of the normalised error squared of a position whose covariance is right.
MEDIAN_NEES = 2 * math.log(2)


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _binomial_cdf(k: int, n: int, p: float) -> float:
    """Probability of at most k successes; summed from the smaller side."""
    if p <= 0.0:
        return 1.0
    if p >= 1.0:
        return 1.0 if k >= n else 0.0

    def mass(terms: range) -> float:
        log_p, log_q = math.log(p), math.log1p(-p)
        return math.fsum(math.exp(_log_choose(n, i) + i * log_p + (n - i) * log_q) for i in terms)

    # Terms further than this from the mean add nothing in double precision.
    reach = int(12 * math.sqrt(n * p * (1 - p)) + 60)
    centre = int(n * p)
    if k <= centre:
        return min(1.0, mass(range(max(0, min(k, centre) - reach), k + 1)))
    return max(0.0, 1.0 - mass(range(k + 1, min(n, max(k, centre) + reach) + 1)))


def binomial_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact interval of a rate (Clopper and Pearson 1934), by bisection on the binomial distribution.

    >>> from geomag._statistics import binomial_interval
    >>> low, high = binomial_interval(0, 100)
    >>> round(low, 4), round(high, 4)
    (0.0, 0.0362)
    """
    if trials <= 0:
        return 0.0, 1.0
    tail = (1.0 - confidence) / 2.0

    def solve(k: int, target: float) -> float:
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2.0
            if _binomial_cdf(k, trials, middle) > target:
                low = middle
            else:
                high = middle
        return (low + high) / 2.0

    lower = 0.0 if successes == 0 else solve(successes - 1, 1.0 - tail)
    upper = 1.0 if successes == trials else solve(successes, tail)
    return lower, upper


def wilson(wrong: float, n: float, z: float = 1.96) -> tuple[float, float]:
    """Interval of a binomial share (Wilson, J. Am. Stat. Assoc. 22 (1927) 209); (0, 1) for no trials.

    Counts need not be whole: tracks that overlap count in part. For whole ones `binomial_interval` is exact.
    """
    if n == 0:
        return 0.0, 1.0
    p = wrong / n
    centre = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (centre - half) / (1 + z * z / n)), min(1.0, (centre + half) / (1 + z * z / n))


def normalised_squares(error: npt.NDArray[np.float64], covariance: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """e^T P^-1 e of errors (n, 2) and their covariances (n, 2, 2); infinite for an error along a direction that is declared known without any.

    A particle filter that has come down to one particle declares that.
    """
    (a, b), (_, d) = covariance[:, 0].T, covariance[:, 1].T
    x, y = error.T
    determinant = a * d - b * b
    declared = (a > 0) & (d > 0) & (determinant > 0)
    square = (d * x * x - 2 * b * x * y + a * y * y) / np.where(declared, determinant, 1.0)
    return np.where(declared, square, np.where((x == 0) & (y == 0), 0.0, np.inf))
