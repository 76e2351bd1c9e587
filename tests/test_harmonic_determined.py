"""Harmonic fits: what was fitted comes back, what nothing senses is left out by name, what is not determined is refused."""

from __future__ import annotations

import numpy as np
import pytest

import geomag

MAIN = np.array([31_000.0, 2_000.0, 38_000.0])


def sources(north, east, down):
    """Field (north, east, down) of three dipoles below the plane, nT."""
    field = np.zeros((len(north), 3))
    for place, moment in (((-2e3, 1e3, 3500.0), (4e12, 1e12, 9e12)), ((3e3, -2e3, 4500.0), (-9e12, 4e12, 1e13))):
        r = np.stack([north, east, down], -1) - place
        length = np.linalg.norm(r, axis=-1)[:, None]
        m = np.array(moment)
        field += 3 * r * (r @ m)[:, None] / length**5 - m / length**3
    return field


@pytest.fixture(scope="module")
def points():
    north, east = (a.ravel() for a in np.meshgrid(np.linspace(-8e3, 8e3, 33), np.linspace(-8e3, 8e3, 33)))
    return north, east, np.zeros_like(north)


def fit(observations, **options):
    return geomag.RectangularHarmonicModel.fit_observations(observations, order=10, **options)


@pytest.mark.parametrize("ridge", [1e-9, 1e-5])
def test_an_anomaly_comes_back_as_it_was_fitted(points, ridge):
    anomaly = sources(*points) @ (MAIN / np.linalg.norm(MAIN))
    model = fit(geomag.FieldObservations().add_anomaly(*points, anomaly, main_field=MAIN), ridge=ridge)
    back = model.to_map("anomaly", main_field=MAIN, down_m=0.0)
    assert back.quantity == "anomaly"
    got = back.sample(points[1], points[0])
    assert np.sqrt(np.mean((got - anomaly) ** 2)) < 1.5 * model.summary["residual_rms"] + 1e-9
    intensity = model.to_map("intensity", main_field=MAIN, down_m=0.0)
    assert np.allclose(intensity.sample(points[1], points[0]) - np.linalg.norm(MAIN), got, atol=1e-6)


def test_intensities_and_vectors_give_the_difference_of_lengths(points):
    field = sources(*points)
    model = geomag.RectangularHarmonicModel.fit(*points, field, order=10)
    got = model.to_map("anomaly", main_field=MAIN, down_m=0.0).sample(points[1], points[0])
    inside = model.field(*points)
    assert np.allclose(got, np.linalg.norm(inside + MAIN, axis=-1) - np.linalg.norm(MAIN), atol=1e-6)


@pytest.mark.parametrize("options", [{}, {"ridge": 0.0}, {"truncation": 1e-6}])
def test_the_vertical_component_alone_is_enough(points, options):
    down = sources(*points)[:, 2]
    field = np.full((down.size, 3), np.nan)
    field[:, 2] = down
    model = geomag.RectangularHarmonicModel.fit(*points, field, order=10, **options)
    got = model.to_map("down", down_m=0.0).sample(points[1], points[0])
    assert np.sqrt(np.mean((got - down) ** 2)) < 0.05 * down.std()
    assert sorted(model.summary["undetermined"]) == ["uniform field to the east", "uniform field to the north"]
    assert np.all(np.abs(model.coefficients[:2]) < 1e-9 * np.abs(model.coefficients[2:]).max())
    again = geomag.RectangularHarmonicModel.from_json(model.to_json())
    assert again.summary["undetermined"] == model.summary["undetermined"]


def test_constants_that_nothing_senses_have_no_sigma_and_no_map(points):
    down = sources(*points)[:, 2]
    field = np.full((down.size, 3), np.nan)
    field[:, 2] = down
    model = geomag.RectangularHarmonicModel.fit(*points, field, order=8)
    sigma = model.sigma(np.array([0.0]), np.array([0.0]), np.array([0.0]))
    assert np.isinf(sigma[0, :2]).all()
    assert np.isfinite(sigma[0, 2])
    with pytest.raises(geomag.InvalidInputError, match="north: nothing observed senses a uniform field to the north"):
        model.to_map("north", down_m=0.0)


def test_a_scalar_across_the_main_field_is_refused_after_a_fit_to_anomalies(points):
    anomaly = sources(*points) @ (MAIN / np.linalg.norm(MAIN))
    model = fit(geomag.FieldObservations().add_anomaly(*points, anomaly, main_field=MAIN))
    assert len(model.summary["undetermined"]) == 2
    with pytest.raises(geomag.InvalidInputError, match="observations determine"):
        model.to_map("east", down_m=0.0)
    sigma = model.sigma(np.array([0.0]), np.array([0.0]), np.array([0.0]))
    assert np.isinf(sigma).all()


def test_full_vectors_leave_nothing_out(points):
    model = geomag.RectangularHarmonicModel.fit(*points, sources(*points), order=8)
    assert model.summary["undetermined"] == []
    assert np.isfinite(model.sigma(np.array([0.0]), np.array([0.0]), np.array([0.0]))).all()


def test_gravity_disturbances_are_fitted_as_the_vertical_component(points):
    disturbance = sources(*points)[:, 2] / 10
    field = np.full((disturbance.size, 3), np.nan)
    field[:, 2] = disturbance
    model = geomag.RectangularHarmonicModel.fit(*points, field, order=10, unit="mGal")
    high = model.to_map("down", down_m=-1000.0)
    north, east = points[:2]
    inner = (np.abs(north) < 5e3) & (np.abs(east) < 5e3)
    truth = sources(north, east, points[2] - 1000.0)[:, 2] / 10
    miss = (high.sample(east, north) - truth)[inner]
    assert np.sqrt(np.mean(miss**2)) < 0.1 * truth[inner].std()
