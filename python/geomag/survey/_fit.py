"""Fits of a few numbers: sizes of errors by their likelihood, a line in log-odds from risks to what came of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from geomag._statistics import MEDIAN_NEES
from geomag.survey._lines import Array
from geomag.survey._model import NU, Law, sigma_of

#: What is believed of a recalibration before a survey is seen: centre and standard deviation of slope and intercept. Slopes of 0.85 to 1.09 were
#: found on six maps of two surveys; some hundred windows outweigh it.
SLOPE_PRIOR = (0.95, 0.3)
INTERCEPT_PRIOR = (0.0, 0.8)
#: The same of the logarithm of the share of lapses on short tracks: 2 to 3 % on one survey, none on another.
LAPSES_PRIOR = (float(np.log(0.01)), 1.0)
#: Standard deviation of the logarithm of the factor from computed covariances to declared ones: 0.6 to 1.3 on six maps of two surveys.
COVARIANCE_PRIOR = 0.3
#: Standard deviation of the logarithm of the median of many normalised errors squared, times the root of their number.
MEDIAN_NOISE = 1 / float(np.log(2))
#: Standard deviation of the logarithm of the spread of what is foretold. Without it a survey of even information, whose fixes are off by what its lines
#: leave open and little else, would promise the same where the field is flat.
SPREAD_PRIOR = 0.5
#: Shares of lapses beyond which a track is too short for any statement, as in the core.
MOST_LAPSES = 0.9


def student(residuals: Array, s2: Array | float) -> Array:
    """Minus the logarithm of the Student-t density, up to a constant."""
    return np.asarray(0.5 * np.log(s2) + 0.5 * (NU + 1) * np.log1p(residuals**2 / (NU * s2)))


def minimise(loss: Callable[[Array], float], start: Array) -> Array:
    """Pattern search in the logarithms of positive parameters."""
    best, value, step = start.copy(), loss(start), 1.0
    while step > 0.02:
        moved = False
        for k in range(best.size):
            for sign in (1, -1):
                trial = best.copy()
                trial[k] += sign * step
                got = loss(trial)
                if got < value - 1e-9:
                    best, value, moved = trial, got, True
        if not moved:
            step /= 2
    return best


def fit_sigma(residuals: Array, gradient: Array, curvature: Array, distance: Array, law: Law) -> Array:
    """a, b, c of the formula of sigma by maximum likelihood under the Student-t law."""

    def loss(logs: Array) -> float:
        a, b, c = np.exp(logs)
        return float(np.mean(student(residuals, sigma_of(gradient, curvature, distance, law, a, b, c) ** 2)))

    scale = float(np.median(np.abs(residuals))) + 1e-9
    starts = [np.log([scale / 2, b, c]) for b, c in ((0.2, 0.1), (0.05, 0.3), (0.4, 0.02))]
    found = [minimise(loss, s) for s in starts]
    return np.exp(min(found, key=loss))


def fit_recalibration(risk: Array, wrong: npt.NDArray[np.bool_], weight: float, least: float) -> tuple[float, float]:
    """Slope and intercept in log-odds from computed risks to the share that is wrong, each answer weighing `weight`.

    Risks are taken as at least `least` and at most one less that: so few answers tell nothing of what lies beyond. Newton's method on the penalised
    likelihood.
    """
    clipped = np.clip(risk, least, 1 - least)
    odds = np.log(clipped / (1 - clipped))
    design = np.column_stack([odds, np.ones(odds.size)])
    centre = np.array([SLOPE_PRIOR[0], INTERCEPT_PRIOR[0]])
    precision = np.array([SLOPE_PRIOR[1], INTERCEPT_PRIOR[1]]) ** -2.0
    solved = centre.copy()
    for _ in range(50):
        p = 1 / (1 + np.exp(-design @ solved))
        gradient = weight * design.T @ (p - wrong) + precision * (solved - centre)
        hessian = weight * design.T @ ((p * (1 - p))[:, None] * design) + np.diag(precision)
        step = np.linalg.solve(hessian, gradient)
        solved = solved - step
        if np.max(np.abs(step)) < 1e-9:
            break
    return max(float(solved[0]), 0.1), float(solved[1])


def recalibrated(risk: Array, line: tuple[float, float]) -> Array:
    """Risks to declare for computed ones; 0 and 1 stay what they are."""
    inside = np.clip(risk, 1e-300, 1 - 1e-16)
    odds = np.maximum(line[0] * (np.log(inside) - np.log1p(-inside)) + line[1], -700.0)
    return np.asarray(np.where((risk <= 0) | (risk >= 1), risk, 1 / (1 + np.exp(-odds))), dtype=np.float64)


def fit_covariance_factor(squares: Array, weight: float) -> float:
    """Factor on computed covariances from the normalised errors squared of fixes, shape (n,), each weighing `weight`.

    By their median, which the few answers that are wrong altogether do not move: those are what the risk is for.
    """
    median = max(float(np.median(squares)), 1e-3)
    noise = MEDIAN_NOISE**2 / (weight * squares.size)
    return float((median / MEDIAN_NEES) ** (COVARIANCE_PRIOR**2 / (COVARIANCE_PRIOR**2 + noise)))


def fit_forecast(trace_m2: Array, distance_m: Array, error_m: Array, weight: float) -> tuple[float, float]:
    """Spread and registration of what is foretold of fixes (`GridMap.with_error_model`), the most probable under a round normal law.

    `trace_m2` of the covariance that local information gives, mean distance to the data, and distance of the fix from the truth: shape (n,) each, each fix weighing `weight`. What a fix is
    off by has a part that grows with what the readings cannot tell, and one that is the map's: features that lie elsewhere between its lines.
    """

    def loss(logs: Array) -> float:
        spread, registration = np.exp(logs)
        variance = spread**2 * trace_m2 + 2 * (registration * distance_m) ** 2
        prior = 0.5 * (logs[0] / SPREAD_PRIOR) ** 2
        return float(np.mean(np.log(variance) + error_m**2 / variance) + prior / (weight * error_m.size))

    least = 1e-6  # a millimetre: data on the spot, or fixes without an error
    size, local, away = (max(float(np.mean(v)), least) for v in (error_m**2, trace_m2, 2 * distance_m**2))
    starts = [0.5 * np.log([share * size / local, (1 - share) * size / away]) for share in (0.1, 0.5, 0.9)]
    spread, registration = np.exp(min((minimise(loss, start) for start in starts), key=loss))
    return float(spread), float(registration)


def fit_lapses(risk: Array, ratio: Array, wrong: npt.NDArray[np.bool_], weight: Array) -> float:
    """Share of lapses on short tracks: of answers with a `risk` on tracks `ratio` times shorter than those that it holds for, share (ratio^2 - 1) are wrong besides.

    All arrays (n,), one an answer. The share of the greatest posterior probability on a fine ladder.
    """
    shares = np.geomspace(1e-4, 0.5, 200)
    totals = 0.5 * ((np.log(shares) - LAPSES_PRIOR[0]) / LAPSES_PRIOR[1]) ** 2
    for k, share in enumerate(shares):
        p = 1 - (1 - risk) * (1 - np.minimum(share * (ratio**2 - 1), MOST_LAPSES))
        p = np.clip(p, 1e-12, 1 - 1e-12)
        totals[k] -= float(np.sum(weight * np.log(np.where(wrong, p, 1 - p))))
    return float(shares[int(np.argmin(totals))])
