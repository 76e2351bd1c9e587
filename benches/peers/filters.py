"""An extended Kalman filter of 18 states with a scalar measurement, as MagNav.jl flies one, side by side with NumPy, answers compared."""

from __future__ import annotations

import numpy as np
from lattice import best_of

import geomag

STATES = 18


def table(smoke=False):
    """Rows of (case, what, seconds, ns per step, times as long as geomag)."""
    rng = np.random.default_rng(18)
    steps = 20 if smoke else 500
    move = np.eye(STATES) + 0.01 * rng.normal(size=(STATES, STATES))
    move /= max(1.0, float(np.max(np.abs(np.linalg.eigvals(move)))))
    noise, start = 1e-3 * np.eye(STATES), np.eye(STATES)
    slopes, readings = rng.normal(size=(steps, 1, STATES)), rng.normal(size=(steps, 1))

    def ours():
        ekf = geomag.ExtendedKalmanFilter(np.zeros(STATES), start)
        for h, z in zip(slopes, readings, strict=True):
            x = np.asarray(ekf.x)
            ekf.update(z, h @ x, h, np.array([[4.0]]))
            ekf.predict(move @ np.asarray(ekf.x), move, noise)
        return np.array(ekf.x), np.array(ekf.P)

    def numpy():
        x, p = np.zeros(STATES), start
        for h, z in zip(slopes, readings, strict=True):
            s = h @ p @ h.T + 4.0
            gain = p @ h.T / s
            x = x + gain @ (z - h @ x)
            left = np.eye(STATES) - gain @ h
            p = left @ p @ left.T + 4.0 * gain @ gain.T
            x, p = move @ x, move @ p @ move.T + noise
        return x, p

    fast, answer = best_of(ours, 0.2)
    slow, wanted = best_of(numpy, 0.2)
    for a, b in zip(answer, wanted, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    case = f"EKF of {STATES} states, one step"
    yield case, "geomag", fast / steps, 1e9 * fast / steps, 1.0
    yield case, "NumPy", slow / steps, 1e9 * slow / steps, slow / fast
