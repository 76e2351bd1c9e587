"""The filters against MagNav.jl: its extended Kalman filter of 18 states and its Cramer-Rao bound on its own simulated flight."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import geomag

DATA = Path(os.environ.get("GEOMAG_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "magnav-fixtures"
W, R = 7.2921151467e-5, 6378137.0


@pytest.fixture(scope="module")
def fixtures():
    scipy_io = pytest.importorskip("scipy.io")
    if not DATA.is_dir():
        pytest.skip(f"reference values of MagNav.jl are not at {DATA} (GEOMAG_DATA)")

    def load(name, key):
        return scipy_io.loadmat(DATA / f"test_data_{name}.mat")[key][0, 0]

    return {
        "map": load("map", "map_data"),
        "truth": load("traj", "traj"),
        "ins": load("ins", "ins_data"),
        "ekf": load("ekf", "ekf_data"),
        "grid": load("grid", "grid_data"),
    }


@pytest.fixture(scope="module")
def anomaly(fixtures):
    m = fixtures["map"]
    return geomag.GridMap(m["map"], m["xx"].ravel(), m["yy"].ravel(), geographic=True, sigma=0.0)


def rates(lat, vn, ve, fn, fe, fd, vd, cnb, slip):
    """Error rates of the INS (Titterton and Weston, ch. 12, spherical Earth) with a third-order baro loop.

    States: latitude, longitude, height; velocities north, east, down; tilts; two of the baro; accelerometer and gyro biases; a
    Gauss-Markov error of the map. `slip` is the element that the reference has wrong: -ve^2/r^2 for -ve/r^2.
    """
    tan, cos, sin = np.tan(lat), np.cos(lat), np.sin(lat)
    f = np.zeros((18, 18))
    f[0, 2], f[0, 3] = -vn / R**2, 1 / R
    f[1, 0], f[1, 2], f[1, 4] = ve * tan / (R * cos), -ve / (cos * R**2), 1 / (R * cos)
    f[2, 2], f[2, 5], f[2, 9] = -3e-2, -1, 3e-2
    f[3, 0] = -ve * (2 * W * cos + ve / (R * cos**2))
    f[3, 2:6] = (ve**2 * tan - vn * vd) / R**2, vd / R, -2 * (W * sin + ve * tan / R), vn / R
    f[3, 7:9] = -fd, fe
    f[4, 0] = 2 * W * (vn * cos - vd * sin) + vn * ve / (R * cos**2)
    f[4, 2:6] = -ve * (vn * tan + vd) / R**2, 2 * W * sin + ve * tan / R, (vn * tan + vd) / R, 2 * W * cos + ve / R
    f[4, 6], f[4, 8] = fd, -fn
    f[5, 0] = 2 * W * ve * sin
    f[5, 2:5] = (vn**2 + ve**2) / R**2 + 3e-4, -2 * vn / R, -2 * (W * cos + ve / R)
    f[5, 6], f[5, 7], f[5, 9], f[5, 10] = -fe, fn, -3e-4, 1
    f[6, 0], f[6, 2], f[6, 4] = -W * sin, (-(ve**2) if slip else -ve) / R**2, 1 / R
    f[6, 7], f[6, 8] = -W * sin - ve * tan / R, vn / R
    f[7, 2], f[7, 3] = vn / R**2, -1 / R
    f[7, 6], f[7, 8] = W * sin + ve * tan / R, W * cos + ve / R
    f[8, 0] = -W * cos - ve / (R * cos**2)
    f[8, 2], f[8, 4] = ve * tan / R**2, -tan / R
    f[8, 6], f[8, 7] = -vn / R, -W * cos - ve / R
    f[9, 9] = -1 / 3600
    f[10, 2], f[10, 9] = 1e-6, -1e-6
    f[3:6, 11:14], f[6:9, 14:17] = cnb, -cnb
    f[range(11, 17), range(11, 17)] = -1 / 3600
    f[17, 17] = -1 / 600
    return f


def exponential(f):
    out, term = np.eye(18), np.eye(18)
    for k in range(1, 30):
        term = term @ f / k
        out = out + term
    return out


def fly(anomaly, log, readings, ekf, slip=True):
    """States and covariances after every update; without readings those of the bound."""
    filter_ = geomag.ExtendedKalmanFilter(np.zeros(18), ekf["P0"])
    states, covariances = [], []
    columns = [log[k].ravel().astype(float) for k in ("lat", "lon", "vn", "ve", "fn", "fe", "fd", "vd")]
    for k, (latitude, longitude, vn, ve, fn, fe, fd, vd) in enumerate(np.transpose(columns)):
        x = np.asarray(filter_.x)
        if readings is None:
            x = np.zeros(18)
        lat, lon = np.radians([latitude, longitude])
        east, north = np.degrees(lon + x[1]), np.degrees(lat + x[0])
        per_degree = np.array(anomaly.metres_per_unit(north))
        slope = np.degrees(np.array(anomaly.gradient(east, north)) * per_degree)
        h = np.zeros((1, 18))
        h[0, :2], h[0, 17] = slope[::-1], 1.0
        expected = np.array([anomaly.sample(east, north) + x[17]])
        reading = expected if readings is None else np.array([readings[k]])
        filter_.update(reading, expected, h, np.array([[float(ekf["R"].item())]]))
        states.append(np.array(filter_.x))
        covariances.append(np.array(filter_.P))
        phi = exponential(rates(lat, vn, ve, fn, fe, fd, vd, log["Cnb"][:, :, k], slip))
        filter_.predict(phi @ states[-1], phi, ekf["Qd"])
    return states, covariances


def apart(found, wanted):
    """Greatest difference in units of the standard deviations that the reference has."""
    scale = np.sqrt(np.diag(wanted))
    return float(np.max(np.abs(found - wanted) / np.outer(scale, scale)))


def test_the_filter_of_magnav_is_met(fixtures, anomaly):
    ekf = fixtures["ekf"]
    states, covariances = fly(anomaly, fixtures["ins"], fixtures["truth"]["mag_1_c"].ravel(), ekf)
    for k, at in enumerate((0, -1)):
        wanted = ekf["P_out"][:, :, k]
        assert np.max(np.abs(states[at] - ekf["x_out"][:, k]) / np.sqrt(np.diag(wanted))) < 1e-6
        assert apart(covariances[at], wanted) < 1e-6


def test_its_bound_is_met(fixtures, anomaly):
    ekf = fixtures["ekf"]
    _, covariances = fly(anomaly, fixtures["truth"], None, ekf)
    for k, at in enumerate((0, -1)):
        assert apart(covariances[at], ekf["crlb_P"][:, :, k]) < 1e-6


def test_the_right_element_makes_the_difference_that_is_known(fixtures, anomaly):
    ekf = fixtures["ekf"]
    _, covariances = fly(anomaly, fixtures["ins"], fixtures["truth"]["mag_1_c"].ravel(), ekf, slip=False)
    assert 1e-6 < apart(covariances[-1], ekf["P_out"][:, :, 1]) < 0.1


def test_its_map_value_and_slope_are_met(fixtures, anomaly):
    truth, grid = fixtures["truth"], fixtures["grid"]
    east, north = truth["lon"].ravel()[0], truth["lat"].ravel()[0]
    assert abs(float(anomaly.sample(east, north)) - grid["itp_map"].item()) < 1e-7
    slope = np.degrees(np.array(anomaly.gradient(east, north)) * np.array(anomaly.metres_per_unit(north)))
    # Theirs is a difference over a finite step.
    np.testing.assert_allclose(slope, grid["grad"].ravel(), rtol=1e-8)
