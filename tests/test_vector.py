"""Three components as channels of a match, with attitude and without."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.compensation import field_in_vehicle
from geomag.vector import component_channels, in_ned, invariant_channels, invariant_maps, invariants

MAIN = np.array([21_000.0, 1_500.0, 43_000.0])


def component_maps():
    """North, east and down of the field of a few buried sources: a potential, so that they belong together."""
    axis = np.arange(0.0, 12_000.0, 100.0)
    x, y = np.meshgrid(axis, axis)
    random = np.random.default_rng(3)
    parts = np.zeros((3, *x.shape))
    for _ in range(40):
        sx, sy, depth, size = *random.uniform(-1000, 13_000, 2), random.uniform(500, 900), random.normal()
        r = np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + depth**2)
        for k, d in enumerate((y - sy, x - sx, np.full_like(x, -depth))):
            parts[k] += 6e7 * size * d / r**3
    return tuple(geomag.GridMap(p, axis, axis, units="nT", sigma=0.0) for p in parts)


def flight(maps):
    """Places, readings in the vehicle's axes with 1 nT of noise, gravity in them, and the attitude."""
    t = np.arange(0.0, 40.0)
    x, y = 3000 + 90 * t, 4000 + 55 * t
    heading, pitch, roll = synthetic.attitude_along(t, x, y, seed=2, turbulence_deg=3.0)
    attitude = {"heading_deg": heading, "pitch_deg": pitch, "roll_deg": roll}
    field = MAIN + np.column_stack([m.sample(x, y, interpolation="bicubic") for m in maps])
    body = field_in_vehicle(field, **attitude) + np.random.default_rng(4).normal(0, 1.0, field.shape)
    return x, y, body, field_in_vehicle([0.0, 0.0, 9.81], **attitude), attitude


def test_turning_there_and_back():
    _, _, body, _, attitude = flight(component_maps())
    np.testing.assert_allclose(field_in_vehicle(in_ned(body, **attitude), **attitude), body, atol=1e-9)
    total, down = invariants(body, -3.0 * field_in_vehicle([0.0, 0.0, -1.0], **attitude))
    np.testing.assert_allclose(total, np.linalg.norm(body, axis=1))
    np.testing.assert_allclose(down, in_ned(body, **attitude)[:, 2], atol=1e-9)


@pytest.mark.parametrize("with_attitude", [True, False])
def test_channels_fix_what_one_component_leaves_wider(with_attitude):
    maps = component_maps()
    x, y, body, gravity, attitude = flight(maps)
    if with_attitude:
        channels = component_channels(maps, in_ned(body, **attitude) - MAIN, 1.5)
    else:
        channels = invariant_channels(maps, body, gravity, main_ned_nt=MAIN, sigma=(1.5, 1.5))
        assert len(channels) == 2
    (first, values, sigma), *more = channels
    track = geomag.Track(x - 300, y + 250, values)
    options = {"starts": "grid", "refine": True, "sigma": sigma, "offset_sigma_m": 300.0, "bias_sigma": np.inf}
    fix = geomag.match_contour(first, track, channels=more, **options)
    alone = geomag.match_contour(first, track, **options)
    assert fix.status == "fixed"
    error = np.array([fix.x - x[-1], fix.y - y[-1]])
    assert error @ np.linalg.solve(fix.covariance_m2, error) < 14.0
    assert np.linalg.det(fix.covariance_m2) < np.linalg.det(alone.covariance_m2)


def test_the_map_of_the_intensity_is_its_projection_for_small_anomalies():
    maps = component_maps()
    intensity, down = invariant_maps(maps, MAIN)
    along = sum(m.values * b for m, b in zip(maps, MAIN / np.linalg.norm(MAIN), strict=True))
    assert np.abs(intensity.values - along).max() < 0.02 * np.abs(along).max()
    assert down is maps[2]


def test_what_does_not_fit_is_refused():
    maps = component_maps()
    other = geomag.GridMap(np.zeros((3, 3)), [0, 1, 2.0], [0, 1, 2.0])
    with pytest.raises(geomag.ShapeError, match=r"maps\[2\]"):
        component_channels((maps[0], maps[1], other), np.zeros((4, 3)))
    with pytest.raises(geomag.InvalidInputError, match="three"):
        component_channels(maps[:2], np.zeros((4, 3)))
    with pytest.raises(geomag.ShapeError, match="readings_ned"):
        component_channels(maps, np.zeros((4, 2)))
    with pytest.raises(geomag.InvalidInputError, match=r"gravity\[1\]"):
        invariants(np.ones((2, 3)), [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    with pytest.raises(geomag.ShapeError):
        in_ned(np.ones((2, 3)), heading_deg=[1.0, 2.0, 3.0])


@pytest.mark.parametrize("sensor", [0.0, 0.01, 1.0, None])
@pytest.mark.parametrize("own", [0.0, 1.0, None])
def test_component_channels_fix_without_noise_and_one_of_them_alone_is_never_a_wrong_fix(own, sensor):
    axis = np.arange(0.0, 6000.0, 60.0)
    east, north = np.meshgrid(axis, axis)
    waves = (np.sin(east / 400), np.cos(north / 300), np.sin((east + north) / 500))
    maps = tuple(geomag.GridMap(40 * w, axis, axis, sigma=own) for w in waves)
    x, y = np.linspace(2000, 2600, 12), np.linspace(2500, 2900, 12)
    read = np.column_stack([m.sample(x, y) for m in maps])
    channels = component_channels(maps, read, sensor)
    (first, values, sigma), *more = channels
    track = geomag.Track(x - 210, y + 160, values)
    fix = geomag.match_posterior(first, track, half_width=600, sigma=sigma, tolerance_m=60, more=more)
    assert fix.status == "fixed"
    assert np.hypot(fix.offset_m[0] - 210, fix.offset_m[1] + 160) < 10
    # One wave says nothing along its crests, however exactly it is read.
    for grid, seen, sigma in channels:
        alone = geomag.match_posterior(
            grid, geomag.Track(x - 210, y + 160, seen), half_width=600, sigma=sigma, tolerance_m=60
        )
        assert not alone.ok, alone
