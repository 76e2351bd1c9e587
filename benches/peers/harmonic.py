"""Harmonic models and field navigation side by side with NumPy and filterpy, in one run, answers asserted.

Peers: the field term by term in NumPy over all points at once (the form that a script has), the same over a grid as
scattered points, and filterpy's unscented filter with all terms of the field at once for one point (NumPy at its best).
"""

from __future__ import annotations

import pickle
import time

import numpy as np
from oracles import harmonic_field, harmonic_field_at_once

import geomag
from geomag.cli.bench import best_of
from geomag.reproduce import e7

ORDER = 18


def model_of_order_18(half=2e5):
    rng = np.random.default_rng(18)
    period = 3 * half
    coefficients = [10.0, -20.0, 30.0]
    for t, r, _, _ in geomag.RectangularHarmonicModel.terms(ORDER):
        coefficients.append(10 * rng.normal() * period / (2 * np.pi * np.hypot(t, r)))
    region = [(-half, half), (-half, half), (-1e4, 7e3)]
    return geomag.RectangularHarmonicModel.from_coefficients(ORDER, period, coefficients, region=region)


def navigation(smoke):
    """A step of the filter on a harmonic model of order 10, three components."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    model = e7.wavy_field(np.random.default_rng(13), 3.0)
    numpy_field = harmonic_field_at_once(model)
    steps = 20 if smoke else 200
    move = e7.SPEED_M_S * e7.course_unit()
    truth = e7.TRUE_START + move * np.arange(1, steps + 1)[:, None]
    readings = list(model.field(truth[:, 1], truth[:, 0], 0.0, extrapolate=True))
    blank = pickle.dumps(
        geomag.FieldNavigator(model, start=(97.0, 48.0), covariance_m2=2.0, reading_sigma=3.0, gate=None)
    )

    def ours():
        navigator = pickle.loads(blank)
        start = time.perf_counter()
        for z in readings:
            navigator.step(1.0, e7.SPEED_M_S, e7.COURSE_DEG, z)
        return time.perf_counter() - start, np.array(navigator.position)

    def theirs():
        points = MerweScaledSigmaPoints(2, alpha=1.0, beta=2.0, kappa=0.0)
        ukf = UnscentedKalmanFilter(2, 3, 1.0, numpy_field, lambda x, _dt: x + move, points)
        ukf.x, ukf.P, ukf.Q, ukf.R = np.array([97.0, 48.0]), 2 * np.eye(2), 0.01 * np.eye(2), 9 * np.eye(3)
        start = time.perf_counter()
        for z in readings:
            ukf.predict()
            ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)
            ukf.update(z)
        return time.perf_counter() - start, ukf.x

    fast, slow = (
        min((ours() for _ in range(10)), key=lambda r: r[0]),
        min((theirs() for _ in range(2)), key=lambda r: r[0]),
    )
    np.testing.assert_allclose(fast[1], slow[1], atol=1e-6)
    return steps, fast[0], slow[0]


def table(smoke=False):
    """Rows (case, what, seconds, nanoseconds each, ratio to geomag)."""
    model = model_of_order_18()
    n = 500 if smoke else 20_000
    rng = np.random.default_rng(1)
    points = rng.uniform(-2e5, 2e5, n), rng.uniform(-2e5, 2e5, n), rng.uniform(-1e4, 7e3, n)
    ours, field = best_of(5, lambda: model.field(*points))
    numpy, wanted = best_of(1 if smoke else 2, lambda: harmonic_field(model, *points))
    np.testing.assert_allclose(field, wanted, atol=1e-7)
    case = f"order 18, {n} points"
    yield case, "geomag", ours, 1e9 * ours / n, 1.0
    yield case, "NumPy, term by term", numpy, 1e9 * numpy / n, numpy / ours

    side = 50 if smoke else 500
    axis = np.linspace(-2e5, 2e5, side)
    north, east = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    on_grid, grid = best_of(10, lambda: model.field_grid(axis, axis, -500.0))
    scattered, same = best_of(3, lambda: model.field(north, east, -500.0))
    np.testing.assert_allclose(grid.reshape(-1, 3), same, atol=1e-8)
    case = f"order 18, {side} x {side} grid"
    yield case, "geomag, field_grid", on_grid, 1e9 * on_grid / side**2, 1.0
    yield case, "geomag, as scattered points", scattered, 1e9 * scattered / side**2, scattered / on_grid

    if not smoke:
        fitting, fitted = best_of(1, lambda: geomag.RectangularHarmonicModel.fit(*points, field, order=ORDER))
        assert fitted.summary["residual_rms"] < 1.0
        yield f"fit order 18, {n} vectors", "geomag", fitting, 1e9 * fitting / n, 1.0

    steps, fast, slow = navigation(smoke)
    case = "UKF step, order 10, 3 components"
    yield case, "geomag.FieldNavigator", fast / steps, 1e9 * fast / steps, 1.0
    yield case, "filterpy, NumPy field", slow / steps, 1e9 * slow / steps, slow / fast
