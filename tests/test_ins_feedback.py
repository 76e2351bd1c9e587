"""INS feedback from Python: wrong fixes, poor fixes, matcher's answers, saved state."""

import pickle

import numpy as np
import pytest

import geomag


def test_hours_of_drift():
    """Normalised error of the corrected track and what wrong fixes do, over 40 runs of four hours."""
    rng = np.random.default_rng(8)
    nees, wrong_used, plain, corrected = [], 0, [], []
    for _ in range(40):
        p, v = rng.normal(size=2) * 500, rng.normal(size=2) * 0.5
        heading = np.radians(rng.normal() * 0.1)
        feedback = geomag.InsFeedback()
        at = np.zeros(2)
        for k in range(240):
            if k:
                moved = 600 * np.array([np.sin(k / 60), np.cos(k / 60)])
                for _ in range(10):
                    turned = heading * np.array([moved[1], -moved[0]])
                    p = p + v * 6 + turned / 10 + 0.1 * np.sqrt(6) * rng.normal(size=2)
                    v = v + 0.001 * np.sqrt(6) * rng.normal(size=2)
                    heading += np.radians(0.0005) * np.sqrt(6) * rng.normal()
                at = at + moved
            arguments = {}
            wrong = False
            if k % 8 == 7:
                sigma = rng.choice([40.0, 200.0, 600.0])
                wrong = rng.random() < 0.15
                far = 7000 * np.array([np.sin(a := rng.uniform(0, 7)), np.cos(a)]) * wrong
                arguments = {"offset_m": p + sigma * rng.normal(size=2) + far, "covariance_m2": sigma**2 * np.eye(2)}
            step = feedback.step(60.0 * k, *at, **arguments)
            wrong_used += wrong and step.accepted
            if k in (80, 160, 239):
                error = np.array(step.after.offset_m) - p
                nees.append(error @ np.linalg.solve(step.after.covariance_m2, error))
                plain.append(np.hypot(*p))
                corrected.append(np.hypot(*error))
    assert wrong_used == 0
    assert abs(np.mean(nees) - 2) < 5 * 2 / np.sqrt(len(nees))
    assert np.median(corrected) < 0.1 * np.median(plain)


def test_takes_a_matchers_answer_only_where_it_may_be_used():
    x = np.arange(0.0, 12_000.0, 100.0)
    grid = geomag.GridMap(90 * np.sin(x / 900)[None, :] * np.cos(x / 1100)[:, None], x, x)
    k = np.arange(30.0)
    track = geomag.Track(3000 + 150 * k, 4000 + 90 * k, grid.sample(3210 + 150 * k, 3875 + 90 * k))
    good = geomag.match_contour(
        grid, track, starts="grid", refine=True, transform="translation", sigma=0.5, offset_sigma_m=300
    )
    assert good.ok
    feedback = geomag.InsFeedback()
    step = feedback.step(0.0, track.x[-1], track.y[-1], good)
    assert step.accepted
    np.testing.assert_allclose(step.after.offset_m, (210, -125), atol=20)
    assert step.before.offset_m == (0, 0)
    plain = geomag.match_contour(grid, track, transform="translation")
    assert plain.covariance_m2 is None
    assert geomag.InsFeedback().step(0.0, track.x[-1], track.y[-1], plain).nis is None
    assert (
        geomag.InsFeedback().step(0.0, track.x[-1], track.y[-1], plain, covariance_m2=100**2 * np.eye(2)).nis
        is not None
    )
    lost = geomag.match_contour(grid, geomag.Track(track.x, track.y, track.values + 1e6))
    assert geomag.InsFeedback().step(0.0, 0.0, 0.0, lost, covariance_m2=np.eye(2)).nis is None


def test_goes_on_from_a_pickle_bit_for_bit():
    one = geomag.InsFeedback(geographic=True, velocity_time_constant_s=4000.0)
    rng = np.random.default_rng(0)
    two = pickle.loads(pickle.dumps(one))
    for k in range(20):
        arguments = {"offset_m": rng.normal(size=2) * 300, "covariance_m2": 1e4 * np.eye(2)} if k % 3 == 0 else {}
        a = one.step(60.0 * k, 16 + 0.01 * k, 34.0, **arguments)
        two = pickle.loads(pickle.dumps(two))
        b = two.step(60.0 * k, 16 + 0.01 * k, 34.0, **arguments)
        assert a.after.offset_m == b.after.offset_m
        np.testing.assert_array_equal(a.after.covariance_m2, b.after.covariance_m2)
    np.testing.assert_array_equal(one.covariance, two.covariance)


def test_errors():
    feedback = geomag.InsFeedback()
    feedback.step(0.0, 0.0, 0.0)
    with pytest.raises(geomag.InvalidInputError, match="time_s"):
        feedback.step(0.0, 1.0, 0.0)
    with pytest.raises(geomag.InvalidInputError, match="covariance_m2"):
        feedback.step(1.0, 1.0, 0.0, offset_m=(1.0, 1.0))
    with pytest.raises(geomag.NotPositiveDefiniteError):
        feedback.step(1.0, 1.0, 0.0, offset_m=(1.0, 1.0), covariance_m2=np.ones((2, 2)))
    with pytest.raises(geomag.InvalidInputError):
        geomag.InsFeedback(gate_probability=1.5)
    assert repr(feedback) == "InsFeedback(0 fixes used, 0 refused)"
