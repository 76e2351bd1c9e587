"""Gravity read under way: what the INS's own errors put into the anomalies is part of the measurement."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import geomag
from geomag import synthetic

INS = geomag.InsModel.navigation()
OPTIONS = {
    "ins": INS, "position_sigma_m": 50.0, "bias_sigma": 1.0, "bias_walk_sqrt_s": 0.0, "batch_m": 0.0, "matcher": None,
}  # fmt: skip


@pytest.fixture(scope="module")
def sea():
    x, y = np.arange(0.0, 8.0, 0.05), np.arange(20.0, 26.0, 0.05)
    rng = np.random.default_rng(4)
    values = np.zeros((y.size, x.size))
    for _ in range(60):
        k, phase = rng.normal(0, 6.0, 2), rng.uniform(0, 2 * np.pi)
        values += 5.0 * np.sin(k[0] * x[None, :] + k[1] * y[:, None] + phase)
    return geomag.GridMap(values, x, y, geographic=True, units="mGal", sigma=0.0)


def voyages(sea, count=12):
    """Ships of 12 knots for six hours, after two without a reading: what the INS shows, anomalies as it reduces them, its errors."""
    reduction = pytest.importorskip("geomag.reduction").GravityReduction
    pytest.importorskip("boule")
    time_s = np.arange(-7200.0, 21600.0, 60.0)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        course = rng.uniform(0, 2 * np.pi)
        east, north = sea.metres_per_unit(23.0)
        x = 4.0 + 6.17 * np.sin(course) * (time_s - 7200) / east
        y = 23.0 + 6.17 * np.cos(course) * (time_s - 7200) / north
        shown = synthetic.indicate(
            time_s, x, y, geographic=True, error=synthetic.draw_inertial_error(INS, rng, 50.0), ins=INS, seed=rng
        )
        raw = sea.sample(x, y) + rng.normal(0, 1.0, x.size) - reduction().correction(x, y, time_s)
        speed_kn, course_deg = geomag.reduction.in_knots(*shown.velocity_m_s.T)
        anomaly = raw + reduction(speed_kn=speed_kn, course_deg=course_deg).correction(shown.x, shown.y, None)
        yield shown, np.where(time_s < 0, np.nan, anomaly), (x, y)


def navigated(sea, shown, anomaly, **options):
    return geomag.navigate(
        sea,
        shown.time_s,
        shown.x,
        shown.y,
        velocity_m_s=shown.velocity_m_s,
        heading_deg=shown.heading_deg,
        readings=anomaly,
        **OPTIONS,
        **options,
    )


def test_an_anomaly_that_the_ins_reduced_tells_of_its_velocity_too(sea):
    squares, before, after = {True: [], False: []}, [], []
    for shown, anomaly, truth in voyages(sea):
        for told in (True, False):
            flight = navigated(sea, shown, anomaly, gravity=told)
            last = slice(-60, None)
            scale = np.array(sea.metres_per_unit(float(truth[1][-1])))
            left = (np.column_stack([flight.x, flight.y]) - np.column_stack(truth))[last] * scale
            squares[told].append(
                np.mean(np.einsum("ni,nij,nj->n", left, np.linalg.inv(flight.covariance_filter_m2[last]), left))
            )
            if told:
                before.append(np.mean(shown.error[last, :2] ** 2) * 2)
                after.append(np.mean(left**2) * 2)
    assert 0.8 < np.mean(squares[True]) < 4.0
    assert np.mean(squares[False]) > 3 * np.mean(squares[True])
    assert np.sqrt(np.mean(after)) < 0.5 * np.sqrt(np.mean(before))


def test_streamed_saved_and_whole_are_the_same(sea):
    shown, anomaly, _ = next(iter(voyages(sea, 1)))
    whole = navigated(sea, shown, anomaly, gravity=True)
    navigator = geomag.Navigator(sea, **OPTIONS, gravity=True)
    for k, time_s in enumerate(shown.time_s):
        value = None if np.isnan(anomaly[k]) else float(anomaly[k])
        place = float(time_s), float(shown.x[k]), float(shown.y[k])
        step = navigator.step(*place, tuple(shown.velocity_m_s[k]), float(shown.heading_deg[k]), value)
        if k == 300:
            navigator = pickle.loads(pickle.dumps(navigator))
    assert (step.x, step.y) == (whole.x[-1], whole.y[-1])


def test_the_textbooks_particle_filter_knows_no_reduction(sea):
    shown, anomaly, _ = next(iter(voyages(sea, 1)))
    with pytest.raises(geomag.InvalidInputError, match="gravity"):
        navigated(sea, shown, anomaly, gravity=True, method="rbpf")
    with pytest.raises(geomag.InvalidInputError, match="gravity"):
        geomag.Navigator(sea, position_sigma_m=50.0, gravity="yes")
