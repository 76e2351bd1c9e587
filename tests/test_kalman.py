"""Unscented and extended filters: against filterpy, against the Kalman filter, under adversity, pickled."""

import pickle

import numpy as np
import pytest

import geomag


def spd(rng, n, floor=0.1):
    a = rng.normal(size=(n, n))
    return a @ a.T + floor * np.eye(n)


def bent_motion(x):
    return np.array([x[0] + 0.1 * np.sin(x[1]), 0.9 * x[1] + 0.05 * np.cos(x[0]), 0.95 * x[2] + 0.01 * x[0] * x[1]])


def bent_sight(x):
    return np.array([np.hypot(x[0] - 5, x[1] + 3), x[2] + 0.1 * x[0] ** 2])


@pytest.mark.parametrize("alpha", [1.0, 0.5, 0.1])
@pytest.mark.parametrize(("beta", "kappa"), [(2.0, 0.0), (2.0, 1.0), (0.0, 0.5)])
def test_equals_filterpy_over_1000_random_steps(alpha, beta, kappa):
    filterpy = pytest.importorskip("filterpy.kalman")
    rng = np.random.default_rng(1)
    n, m = 3, 2
    points = filterpy.MerweScaledSigmaPoints(n, alpha=alpha, beta=beta, kappa=kappa)
    theirs = filterpy.UnscentedKalmanFilter(n, m, 1.0, bent_sight, lambda x, _dt: bent_motion(x), points)
    x, p = rng.normal(size=n), spd(rng, n)
    theirs.x, theirs.P = x.copy(), p.copy()
    ours = geomag.UnscentedKalmanFilter(x, p, alpha=alpha, beta=beta, kappa=kappa)
    truth = x.copy()
    worst = 0.0
    for _ in range(1000):
        q, r = 0.05 * spd(rng, n), spd(rng, m)
        theirs.Q, theirs.R = q, r
        truth = bent_motion(truth) + 0.1 * rng.normal(size=n)
        z = bent_sight(truth) + rng.normal(size=m)
        theirs.predict()
        # The specification draws sigma points anew after the prediction.
        theirs.sigmas_f = points.sigma_points(theirs.x, theirs.P)
        theirs.update(z)
        ours.predict(bent_motion, q)
        ours.update(z, bent_sight, r)
        size = max(1.0, np.abs(theirs.x).max())
        worst = max(
            worst, np.abs(ours.x - theirs.x).max() / size, np.abs(ours.P - theirs.P).max() / np.abs(theirs.P).max()
        )
    assert worst < 1e-9


def test_equals_the_kalman_filter_on_linear_models():
    rng = np.random.default_rng(2)
    n, m = 4, 2
    x, p = rng.normal(size=n), spd(rng, n)
    ukf, ekf = geomag.UnscentedKalmanFilter(x, p), geomag.ExtendedKalmanFilter(x, p)
    for _ in range(200):
        f, h = np.eye(n) + 0.1 * rng.normal(size=(n, n)), rng.normal(size=(m, n))
        q, r, z = spd(rng, n), spd(rng, m), rng.normal(size=m)
        x, p = f @ x, f @ p @ f.T + q
        ekf.predict(f @ ekf.x, f, q)
        ukf.predict(f, q)
        s = h @ p @ h.T + r
        k = p @ h.T @ np.linalg.inv(s)
        nu = z - h @ x
        x, p = x + k @ nu, p - k @ s @ k.T
        ekf.update(z, h @ ekf.x, h, r)
        ukf.update(z, h, r)
        for got in (ukf, ekf):
            np.testing.assert_allclose(got.x, x, atol=1e-9)
            np.testing.assert_allclose(got.P, p, atol=1e-9)
            np.testing.assert_allclose(got.nis, nu @ np.linalg.solve(s, nu), rtol=1e-7)
        np.testing.assert_allclose(ukf.S, s, atol=1e-9)
        np.testing.assert_allclose(ukf.K, k, atol=1e-9)


def test_stays_positive_definite_under_adversity():
    # 100,000 steps of this are in the crate's own tests; this goes through Python.
    rng = np.random.default_rng(3)
    for _ in range(60):
        n = int(rng.integers(1, 4))
        ukf = geomag.UnscentedKalmanFilter(rng.normal(size=n) * 1e3, 10 ** rng.uniform(-12, 12, n))
        for _ in range(20):
            r = 0.0 if rng.random() < 0.2 else 10 ** rng.uniform(-30, 2)
            mix = rng.normal(size=(2, n))
            try:
                ukf.predict(lambda x: 1.1 * x + np.sin(x), 10 ** rng.uniform(-15, 3))
                ukf.update(rng.normal(size=2) * 1e3, lambda x, mix=mix: mix @ x + np.cos(x[0]), r)
            except geomag.NotPositiveDefiniteError:
                continue
            p = ukf.P
            assert np.isfinite(p).all()
            np.testing.assert_array_equal(p, p.T)
            np.linalg.cholesky(p)


def test_goes_on_bit_for_bit_after_pickling():
    rng = np.random.default_rng(4)
    for first in (geomag.UnscentedKalmanFilter([1.0, 2.0, 3.0], spd(rng, 3), alpha=0.3, kappa=1.0),):
        first.predict(bent_motion, 0.1)
        first.update([5.0, 3.0], bent_sight, 1.0)
        second = pickle.loads(pickle.dumps(first))
        for f in (first, second):
            f.predict(bent_motion, 0.1)
            f.update([5.1, 3.1], bent_sight, 1.0)
        np.testing.assert_array_equal(first.P, second.P)
        np.testing.assert_array_equal(first.x, second.x)
        assert second.alpha == 0.3
    ekf = geomag.ExtendedKalmanFilter([1.0], 2.0)
    again = pickle.loads(pickle.dumps(ekf))
    np.testing.assert_array_equal(ekf.P, again.P)
    with pytest.raises(geomag.StateError):
        geomag.UnscentedKalmanFilter._restore(b"nonsense")


def test_callables_may_look_at_the_filter_and_may_fail():
    ukf = geomag.UnscentedKalmanFilter([1.0, 2.0], 1.0)
    ukf.predict(lambda x: x + 0 * ukf.x, 0.1)
    before = ukf.P
    with pytest.raises(ZeroDivisionError):
        ukf.predict(lambda x: x / (1 // 0), 0.1)
    with pytest.raises(geomag.NotFiniteError):
        ukf.predict(lambda x: x * np.nan, 0.1)
    with pytest.raises(geomag.ShapeError):
        ukf.update([1.0, 2.0], lambda x: x[:1], 1.0)
    with pytest.raises(geomag.NotPositiveDefiniteError):
        ukf.update([1.0], lambda x: [0.0], 0.0)
    np.testing.assert_array_equal(before, ukf.P)


@pytest.mark.parametrize("gate", [np.nan, -1.0, 0.0])
def test_a_gate_that_no_reading_can_pass_is_refused(gate):
    ukf = geomag.UnscentedKalmanFilter([0.0], 1.0)
    ekf = geomag.ExtendedKalmanFilter([0.0], 1.0)
    with pytest.raises(geomag.InvalidInputError, match="max_nis"):
        ukf.update([1.0], [[1.0]], 1.0, max_nis=gate)
    with pytest.raises(geomag.InvalidInputError, match="max_nis"):
        ekf.update([1.0], [0.0], [[1.0]], 1.0, max_nis=gate)
    assert ukf.nis is ekf.nis is None
    assert ukf.update([1.0], [[1.0]], 1.0, max_nis=np.inf)


def test_gate_state_and_words():
    ukf = geomag.UnscentedKalmanFilter([0.0], 1.0)
    assert ukf.nis is None
    assert ukf.update([100.0], [[1.0]], 1.0, max_nis=9.0) is False
    assert ukf.x[0] == 0.0
    assert ukf.nis == pytest.approx(5000.0)
    ukf.x, ukf.P = [3.0], [[4.0]]
    assert (ukf.x[0], ukf.P[0, 0]) == (3.0, 4.0)
    assert ukf.sigma_points().shape == (3, 1)
    assert "alpha 1" in repr(ukf)
    with pytest.raises(geomag.ShapeError):
        ukf.x = [1.0, 2.0]


@pytest.mark.parametrize(
    ("x", "p", "options", "error"),
    [
        ([0.0], -1.0, {}, geomag.NotPositiveDefiniteError),
        ([np.nan], 1.0, {}, geomag.NotFiniteError),
        ([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]], {}, geomag.InvalidInputError),
        ([0.0, 0.0], np.eye(3), {}, geomag.ShapeError),
        ([0.0], 1.0, {"alpha": 0.0}, geomag.InvalidInputError),
        ([0.0], 1.0, {"kappa": -1.0}, geomag.InvalidInputError),
    ],
)
def test_refuses_bad_states(x, p, options, error):
    with pytest.raises(error):
        geomag.UnscentedKalmanFilter(x, p, **options)
