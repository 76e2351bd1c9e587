"""INS errors: by the error equations, by integrating an INS's own readings, and an odometer's law beside them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.synthetic import InertialError, indicate

HOUR = np.arange(0.0, 3601.0, 5.0)
NAVIGATION = SimpleNamespace(
    gyro_bias_deg_h=0.02, gyro_time_constant_s=14_400.0, gyro_walk_deg_sqrt_h=0.003, accelerometer_bias_ug=50.0,
    accelerometer_time_constant_s=14_400.0, velocity_walk_m_s_sqrt_h=0.01, velocity_sigma_m_s=0.2, tilt_sigma_mrad=0.05, heading_sigma_mrad=1.0,
)  # fmt: skip
PERFECT = SimpleNamespace(**{k: 1e12 if "constant" in k else 0.0 for k in vars(NAVIGATION)})


def north_at(latitude, speed=100.0):
    return 10.0 + 0 * HOUR, latitude + speed * HOUR / 111_035.0


def test_a_heading_error_is_the_earth_s_rate_in_an_ins_and_a_turn_in_an_odometer():
    x, y = north_at(40.4)
    ins = indicate(HOUR, x, y, geographic=True, error=InertialError(heading_deg=-0.1))
    assert ins.error[-1, 1] == pytest.approx(2_700, abs=30)
    assert ins.error[-1, 0] == pytest.approx(-453, abs=5)
    road = synthetic.Path.straight((0, 0), course_deg=0, speed_m_s=100, interval_s=5.0, samples=721)
    field = synthetic.Crust().draw((-1e4, -1e4, 1e4, 4e5), seed=1)
    odometer = synthetic.fly(field, road, ins=synthetic.InsError(heading_deg=0.1))
    assert odometer.offset_m[0] == pytest.approx(-628, abs=1)
    assert odometer.offset_m[1] == pytest.approx(0.5, abs=0.2)


def test_textbook_errors_in_an_hour():
    still = {"time_s": HOUR, "x": 0 * HOUR, "y": 0 * HOUR, "geographic": False}
    w, t = np.sqrt(9.80665 / 6.371e6), 3600.0
    gone = indicate(**still, error=InertialError(position_m=(30.0, 0.0))).error[-1, :2]
    assert gone == pytest.approx([30, 0], abs=0.1)
    velocity = indicate(**still, error=InertialError(velocity_m_s=(1.0, 0.0))).error[-1]
    assert np.hypot(*velocity[:2]) == pytest.approx(abs(np.sin(w * t) / w), rel=0.02)  # turned by the Foucault pendulum
    bias = indicate(**still, error=InertialError(accelerometer_bias_ug=(0.0, 100.0))).error[-1]
    assert np.hypot(*bias[:2]) == pytest.approx(9.80665e-4 * (1 - np.cos(w * t)) / w**2, rel=0.02)
    gyro = indicate(**still, error=InertialError(gyro_bias_deg_h=(0.0, 0.01, 0.0))).error[-1]
    rate = np.radians(0.01) / 3600
    assert np.hypot(*gyro[:2]) == pytest.approx(6.371e6 * rate * (t - np.sin(w * t) / w), rel=0.02)


def test_long_steps_are_cut():
    fine = indicate(
        HOUR, 0 * HOUR, 100 * HOUR, geographic=False, error=InertialError(heading_deg=0.1, velocity_m_s=(0.3, 0))
    )
    some = slice(None, None, 24)
    t = HOUR[some]
    coarse = indicate(t, 0 * t, 100 * t, geographic=False, error=InertialError(heading_deg=0.1, velocity_m_s=(0.3, 0)))
    assert coarse.error[-1, :2] == pytest.approx(fine.error[-1, :2], abs=2.0)


def test_same_seed_same_errors_and_the_drift_of_the_grade():
    t = np.arange(0.0, 3601.0, 10.0)
    path = {"time_s": t, "x": 0 * t, "y": 70 * t, "geographic": False, "ins": NAVIGATION}
    ends = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        ends.append(indicate(**path, error=synthetic.draw_inertial_error(NAVIGATION, rng), seed=rng).error[-1, :2])
    again = np.random.default_rng(59)
    same = indicate(**path, error=synthetic.draw_inertial_error(NAVIGATION, again), seed=again)
    assert np.array_equal(same.error[-1, :2], ends[-1])
    nautical = np.median(np.hypot(*np.array(ends).T)) / 1852.0
    assert 0.6 < nautical < 2.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": [0.0, 1.0]}, "of one length"),
        ({"time_s": HOUR[::-1]}, "needed a time after"),
        ({"x": np.full(HOUR.size, np.nan)}, r"x\[0\]: needed a finite number"),
        ({"latitude_deg": 89.5}, "needed within 89 degrees"),
    ],
)
def test_paths_that_are_none(change, message):
    good = {"time_s": HOUR, "x": 0 * HOUR, "y": 0 * HOUR, "geographic": False}
    with pytest.raises(geomag.GeomagError, match=message):
        indicate(**(good | change))


@pytest.mark.parametrize(
    "error",
    [
        InertialError(heading_deg=0.1),
        InertialError(tilt_mrad=(0.1, -0.05)),
        InertialError(velocity_m_s=(0.5, -1.0)),
        InertialError(gyro_bias_deg_h=(0.01, -0.02, 0.05)),
        InertialError(accelerometer_bias_ug=(50.0, 20.0)),
    ],
    ids=["heading", "tilt", "velocity", "gyros", "accelerometers"],
)
def test_integrating_its_readings_an_ins_goes_wrong_as_the_equations_say(error):
    pytest.importorskip("pyins", reason="needs the extra 'ins'")
    t = np.arange(0.0, 2400.0, 2.0)
    # North, a turn to the east half way, and on.
    x, y = 10 + np.maximum(t - 1200, 0) * 80 / 82_000.0, 42 + np.minimum(t, 1200) * 80 / 111_050.0
    linear = indicate(t, x, y, geographic=True, error=error, ins=PERFECT)
    wrong, true_x, true_y = synthetic.strapdown(t, x, y, ins=PERFECT, error=error)
    right, _, _ = synthetic.strapdown(t, x, y, ins=PERFECT)
    assert np.abs(right.error[:, :2]).max() < 10.0  # what the integration itself leaves
    scale = np.hypot(*linear.error[:, :2].T).max()
    assert np.abs(wrong.error[:, :2] - right.error[:, :2] - linear.error[:, :2]).max() < 0.03 * scale + 1.0
    straight = np.abs(t - 1200) > 30
    np.testing.assert_allclose(true_x[straight], x[straight], atol=2e-5)
    np.testing.assert_allclose(true_y[straight], y[straight], atol=2e-5)
