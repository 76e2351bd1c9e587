"""FieldNavigator: consistency, the published run, speed against filterpy, maps, outages, state."""

import pickle

import numpy as np
import pytest
from oracles import harmonic_field_at_once

import geomag
from geomag.reproduce import e7


def sails(key, count):
    """Fields and runs of the published course, each of a seed of its own."""
    for seed in range(count):
        rng = np.random.default_rng([key, seed])
        model = e7.wavy_field(rng, 3.0)
        start = tuple(e7.TRUE_START + np.sqrt(e7.P0) * rng.normal(size=2))
        yield model, e7.sail(model, rng, q=0.01, true_q=0.01, sigma=3.0, start=start)


def test_normalised_errors_are_consistent_over_200_seeds():
    means, largest = [], []
    for _, run in sails(11, 200):
        means.append(run.normalised[20:].mean())
        largest.append(run.distance_m[20:].max())
    assert 1.7 < np.mean(means) < 2.4
    assert np.mean(np.array(largest) < 2.0) >= 0.95


def test_error_is_near_its_bound_where_the_field_is_steep():
    errors, bounds = [], []
    for model, run in sails(12, 40):
        errors.append(np.mean(run.distance_m[20:] ** 2))
        bounds.append(e7.bound_m(model, 0.01, 3.0) ** 2)
    assert 0.9 < np.sqrt(np.mean(errors) / np.mean(bounds)) < 1.25


def test_gradient_of_the_field_is_what_was_asked_for():
    model = e7.wavy_field(np.random.default_rng(1), 2.0)
    n, e = np.random.default_rng(2).uniform(-500, 500, (2, 4000))
    assert np.sqrt(np.mean(model.gradient(n, e, 0.0)[:, :, :2] ** 2)) == pytest.approx(2.0, rel=0.05)


def test_equals_the_generic_filter_step_by_step():
    model = e7.wavy_field(np.random.default_rng(3), 1.0)
    nav = geomag.FieldNavigator(
        model, start=(97.0, 48.0), covariance_m2=2.0, reading_sigma=3.0, position_noise_m2_s=0.5, gate=None
    )
    ukf = geomag.UnscentedKalmanFilter([97.0, 48.0], 2.0)
    by_name = geomag.UnscentedKalmanFilter([97.0, 48.0], 2.0)
    sensor = geomag.FieldSensor(model)
    move = e7.SPEED_M_S * e7.course_unit()
    truth = e7.TRUE_START.copy()
    for _ in range(30):
        truth = truth + move
        z = sensor(truth)
        np.testing.assert_allclose(z, model.field(truth[1], truth[0], 0.0))
        step = nav.step(1.0, e7.SPEED_M_S, e7.COURSE_DEG, z)
        ukf.predict(lambda x: x + move, 0.5)
        ukf.update(z, lambda x: model.field(x[1], x[0], 0.0, extrapolate=True), 9.0)
        by_name.predict(lambda x: x + move, 0.5)
        by_name.update(z, sensor, 9.0)
        np.testing.assert_allclose([step.x, step.y], ukf.x, atol=1e-9)
        np.testing.assert_allclose(by_name.x, ukf.x, atol=1e-9)
        np.testing.assert_allclose(step.covariance_m2, ukf.P, atol=1e-10)
        assert step.nis == pytest.approx(ukf.nis, abs=1e-9)


def test_works_on_maps_and_scalar_readings():
    main = [20000.0, 1000.0, 40000.0]
    model = e7.wavy_field(np.random.default_rng(4), 3.0)
    x = np.arange(-400.0, 401.0, 2.0)
    field = model.to_map("anomaly", main_field=main)
    grid = field.to_grid(x, x)
    ends = []
    for source, options in ((field, {}), (grid, {}), (model, {"reading": "anomaly", "main_field": main})):
        for method in ("unscented", "extended"):
            nav = geomag.FieldNavigator(
                source, start=(102.0, 44.0), covariance_m2=4.0, reading_sigma=2.0, method=method, **options
            )
            for k in range(1, 80):
                step = nav.step(1.0, 2.0, 90.0, field.sample(100.0 + 2 * k, 45.0))
            ends.append((step.x, step.y))
    assert np.abs(np.array(ends) - (258.0, 45.0)).max() < 2.0


def test_estimates_speed_heading_and_bias():
    model = e7.wavy_field(np.random.default_rng(5), 3.0)
    nav = geomag.FieldNavigator(
        model,
        start=(101.0, 44.0),
        covariance_m2=4.0,
        reading_sigma=3.0,
        speed_sigma_m_s=0.3,
        heading_sigma_deg=5.0,
        bias_sigma=20.0,
    )
    rng = np.random.default_rng(6)
    course = np.radians(63.0)
    truth = np.array([100.0, 45.0])
    for _ in range(200):
        truth = truth + 2.2 * np.array([np.sin(course), np.cos(course)])
        reading = model.field(truth[1], truth[0], 0.0, extrapolate=True) + [12.0, -15.0, 8.0] + 3 * rng.normal(size=3)
        nav.step(1.0, 2.0, 60.0, reading)
    speed, heading = nav.speed_error_m_s, nav.heading_error_deg
    assert abs(speed[0] - 0.2) < 4 * speed[1]
    assert abs(heading[0] - 3.0) < 4 * heading[1]
    for (value, sigma), want in zip(nav.bias, (12.0, -15.0, 8.0), strict=True):
        assert abs(value - want) < 4 * sigma
    assert nav.P.shape == (7, 7)


def test_outages_gates_edges_and_divergence():
    model = e7.wavy_field(np.random.default_rng(7), 3.0)
    options = {"covariance_m2": 1.0, "reading_sigma": 3.0}
    nav = geomag.FieldNavigator(model, start=(100.0, 45.0), **options)
    assert nav.step(1.0, 2.0, 60.0).outcome == "predicted"
    assert nav.step(1.0, 2.0, 60.0, [np.nan] * 3).outcome == "predicted"
    for _ in range(10):
        step = nav.step(1.0, 2.0, 60.0, [9e3, 9e3, 9e3])
        assert step.outcome == "rejected"
    assert step.diverged
    away = geomag.FieldNavigator(model, start=(9000.0, 0.0), **options)
    assert away.step(1.0, 2.0, 60.0, [0.0, 0.0, 0.0]).outcome == "off_field"
    assert "FieldNavigatorStep(off_field" in repr(away.step(1.0, 2.0, 60.0, [0.0, 0.0, 0.0]))
    assert "FieldNavigator(2 steps" in repr(away)


def test_goes_on_bit_for_bit_after_pickling():
    model = e7.wavy_field(np.random.default_rng(8), 3.0)
    first = geomag.FieldNavigator(model, start=(101.0, 46.0), covariance_m2=2.0, reading_sigma=3.0, bias_sigma=2.0)
    sensor = geomag.FieldSensor(model)
    for k in range(20):
        first.step(1.0, 1.0, 90.0, sensor([100.0 + k, 45.0]))
    second = pickle.loads(pickle.dumps(first))
    for k in range(20, 40):
        for nav in (first, second):
            nav.step(1.0, 1.0, 90.0, sensor([100.0 + k, 45.0]))
        np.testing.assert_array_equal(first.P, second.P)
        assert first.position == second.position


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"reading_sigma": [1.0, 2.0]}, geomag.ShapeError),
        ({"reading_sigma": -1.0}, geomag.InvalidInputError),
        ({"covariance_m2": -1.0}, geomag.NotPositiveDefiniteError),
        ({"gate": 2.0}, geomag.InvalidInputError),
        ({"method": "guess"}, geomag.InvalidInputError),
        ({"reading": "smell"}, geomag.InvalidInputError),
        ({"height_m": 0.0}, geomag.InvalidInputError),
        ({"start": (np.nan, 0.0)}, geomag.NotFiniteError),
    ],
)
def test_refuses_bad_options(change, error):
    model = e7.wavy_field(np.random.default_rng(9), 1.0)
    good = {"start": (0.0, 0.0), "covariance_m2": 1.0, "reading_sigma": 1.0}
    with pytest.raises(error):
        geomag.FieldNavigator(model, **(good | change))


def test_refuses_bad_steps():
    model = e7.wavy_field(np.random.default_rng(10), 1.0)
    nav = geomag.FieldNavigator(model, start=(0.0, 0.0), covariance_m2=1.0, reading_sigma=1.0)
    with pytest.raises(geomag.InvalidInputError):
        nav.step(-1.0, 0.0, 0.0)
    with pytest.raises(geomag.ShapeError):
        nav.step(1.0, 0.0, 0.0, [1.0])
    with pytest.raises(geomag.NotFiniteError):
        nav.step(1.0, 0.0, 0.0, [np.inf, 0.0, 0.0])
    assert nav.n_steps == 0


def test_a_run_equals_filterpy_with_a_numpy_field():
    filterpy = pytest.importorskip("filterpy.kalman")
    model = e7.wavy_field(np.random.default_rng(13), 3.0)
    move = e7.SPEED_M_S * e7.course_unit()
    points = filterpy.MerweScaledSigmaPoints(2, alpha=1.0, beta=2.0, kappa=0.0)
    theirs = filterpy.UnscentedKalmanFilter(2, 3, 1.0, harmonic_field_at_once(model), lambda x, _dt: x + move, points)
    theirs.x, theirs.P, theirs.Q, theirs.R = np.array([97.0, 48.0]), 2 * np.eye(2), 0.01 * np.eye(2), 9 * np.eye(3)
    nav = geomag.FieldNavigator(
        model, start=(97.0, 48.0), covariance_m2=2.0, reading_sigma=3.0, position_noise_m2_s=0.01, gate=None
    )
    truth = e7.TRUE_START + move * np.arange(1, 101)[:, None]
    readings = list(model.field(truth[:, 1], truth[:, 0], 0.0))
    for z in readings:
        theirs.predict()
        theirs.sigmas_f = points.sigma_points(theirs.x, theirs.P)
        theirs.update(z)
        nav.step(1.0, e7.SPEED_M_S, e7.COURSE_DEG, z)
    np.testing.assert_allclose(nav.position, theirs.x, atol=1e-6)


def test_a_reading_is_refused_where_it_chooses_nothing():
    x = np.arange(0.0, 1000.0, 20.0)
    grid = geomag.GridMap(np.sin(x / 140)[None, :] + np.cos(x / 120)[:, None], x, x)
    options = {"start": (300.0, 500.0), "covariance_m2": 100.0, "reading_sigma": 1.0}
    for name in ("x", "north", "vector"):
        with pytest.raises(geomag.InvalidInputError, match="reading: needed none with a map"):
            geomag.FieldNavigator(grid, reading=name, **options)
        with pytest.raises(geomag.InvalidInputError, match="reading: needed none with a map"):
            geomag.FieldSensor(grid, reading=name)
        with pytest.raises(geomag.InvalidInputError, match="FieldSensor"):
            geomag.FieldNavigator(geomag.FieldSensor(grid), reading=name, **options)
    sensor = pickle.loads(pickle.dumps(geomag.FieldSensor(grid)))
    assert geomag.FieldNavigator(sensor, **options).position == (300.0, 500.0)


def test_a_reading_where_the_error_of_the_map_is_unknown_is_not_taken():
    axis = np.arange(0.0, 6000.0, 100.0)
    values = 90 * np.sin(axis / 400)[None, :] * np.cos(axis / 500)[:, None]
    sigma = np.full(values.shape, 2.0)
    sigma[:, 30:] = np.nan
    grid = geomag.GridMap(values, axis, axis, sigma=sigma)

    def step(x, **options):
        nav = geomag.FieldNavigator(
            grid, start=(x, 2000.0), covariance_m2=100.0, reading_sigma=1.0, gate=None, **options
        )
        return nav.step(1.0, 1.0, 90.0, 10.0).outcome

    assert step(1000.0) == "updated"
    assert step(4000.0) == "off_field"
    assert step(4000.0, field_sigma=False) == "updated"
