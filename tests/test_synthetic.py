from __future__ import annotations

import pickle

import numpy as np
import pytest

import geomag
from geomag import synthetic

EXTENT = (0.0, 0.0, 40_000.0, 30_000.0)


@pytest.fixture(scope="module")
def field():
    return synthetic.Crust().draw(EXTENT, seed=7)


@pytest.fixture(scope="module")
def path():
    return synthetic.Path.straight((8_000, 6_000), course_deg=60, speed_m_s=60, interval_s=10, samples=41)


@pytest.mark.parametrize("seed", [-1, 2**64, 0.5, "one"])
def test_a_seed_that_is_none_is_refused(field, path, seed):
    for draw in (
        lambda: synthetic.Crust().draw(EXTENT, seed=seed),
        lambda: synthetic.InsSpread().draw(seed),
        lambda: synthetic.fly(field, path, seed=seed),
    ):
        with pytest.raises(geomag.InvalidInputError, match="seed"):
            draw()


def test_same_seed_same_bits(field, path):
    again = synthetic.Crust().draw(EXTENT, seed=7)
    other = synthetic.Crust().draw(EXTENT, seed=8)
    assert np.array_equal(field.grid(1000.0).values, again.grid(1000.0).values)
    assert not np.array_equal(field.grid(1000.0).values, other.grid(1000.0).values)
    noisy = {"ins": synthetic.InsError(walk_m_sqrt_s=1.0), "sensor": synthetic.Sensor(sigma=1.0, outlier_rate=0.1)}
    one, two = (synthetic.fly(field, path, seed=3, **noisy) for _ in range(2))
    assert np.array_equal(one.track.values, two.track.values)
    assert np.array_equal(one.track.x, two.track.x)
    assert not np.array_equal(one.track.values, synthetic.fly(field, path, seed=4, **noisy).track.values)


def test_values_are_pinned(field):
    # Made once on x86-64 with this version; bits must not move on another machine or in a later version.
    assert field.sample(12_345.6, 7_890.1).hex() == "0x1.f0eff4e19df55p+4"


def test_map_is_the_field_at_its_nodes(field):
    grid = field.grid(500.0, units="nT")
    assert grid.values.shape == (61, 81)
    x, y = np.meshgrid(grid.x, grid.y)
    np.testing.assert_allclose(grid.values, field.sample(x, y), atol=1e-9)
    same = field.grid(x=grid.x, y=grid.y)
    assert np.array_equal(same.values, grid.values)


def test_flight_holds_what_it_says(field, path):
    ins = synthetic.InsError(position_m=(-700.0, 450.0))
    flight = synthetic.fly(field, path, ins=ins, seed=1)
    np.testing.assert_allclose(flight.track.x, path.x - 700.0)
    np.testing.assert_allclose(flight.track.y, path.y + 450.0)
    np.testing.assert_array_equal(flight.truth, field.sample(path.x, path.y))
    np.testing.assert_array_equal(flight.track.values, flight.truth)
    assert flight.offset == pytest.approx((700.0, -450.0))
    assert flight.offset_m == pytest.approx((700.0, -450.0))


def test_geographic_flight_is_in_metres_where_it_says_so():
    field = synthetic.Crust().draw((-3.0, 54.0, -2.0, 54.5), geographic=True, seed=1)
    path = synthetic.Path.straight(
        (-2.6, 54.2), course_deg=90, speed_m_s=50, interval_s=10, samples=21, geographic=True
    )
    flight = synthetic.fly(field, path, ins=synthetic.InsError(position_m=(0.0, 1000.0)))
    assert flight.offset_m == pytest.approx((0.0, -1000.0), abs=0.1)
    assert flight.offset[1] == pytest.approx(-1000.0 / 111_300, rel=2e-3)
    assert (path.x[-1] - path.x[0]) * 111_320 * np.cos(np.radians(54.2)) == pytest.approx(10_000.0, rel=5e-3)


def test_spreads_draw_what_they_say():
    lattice = synthetic.InsSpread(synthetic.Lattice((0.1, 0.1), (0.01, 0.01)))
    draws = np.array([lattice.draw(s).position for s in range(300)])
    assert np.allclose(draws / 0.01, np.round(draws / 0.01))
    assert np.isclose(draws.min(), -0.1)
    assert np.isclose(draws.max(), 0.1)
    ring = synthetic.InsSpread(synthetic.Ring(790.0), heading_sigma_deg=0.5)
    errors = [ring.draw(s) for s in range(300)]
    np.testing.assert_allclose([np.hypot(*e.position_m) for e in errors], 790.0)
    assert np.std([e.heading_deg for e in errors]) == pytest.approx(0.5, rel=0.2)
    assert ring.draw(5) == ring.draw(5)


def test_ins_drift_of_a_navigation_grade_unit(field):
    # 0.01 degree an hour of gyro drift is about a nautical mile an hour: 0.01 deg of arc is 1112 m.
    path = synthetic.Path(np.full(61, 2e4), np.full(61, 1.5e4), np.arange(61) * 60.0)
    flight = synthetic.fly(field, path, ins=synthetic.InsError(gyro_deg_h=(0.01, 0.0)))
    error = flight.track.x - path.x
    omega, radius = np.sqrt(9.80665 / 6_371_000), 6_371_000
    t = path.time_s
    expected = radius * np.radians(0.01) / 3600 * (t - np.sin(omega * t) / omega)
    np.testing.assert_allclose(error, expected, atol=1e-3)


def test_pickles(field, path):
    assert pickle.loads(pickle.dumps(field)).sample(1e4, 1e4) == field.sample(1e4, 1e4)
    assert np.array_equal(pickle.loads(pickle.dumps(path)).x, path.x)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: synthetic.Crust(texture_rms=-1).draw(EXTENT), "texture_rms"),
        (lambda: synthetic.Crust(texture_rms=float("nan")).draw(EXTENT), "texture_rms"),
        (lambda: synthetic.Crust(waves="many").draw(EXTENT), "waves|many"),
        (lambda: synthetic.Crust().draw((0, 0, 0, 1)), "extent"),
        (lambda: synthetic.Crust().draw((0, 80, 1, 95), geographic=True), "latitude"),
        (lambda: synthetic.Path.straight((0, 0), course_deg=0, speed_m_s=0, interval_s=1, samples=2), "speed_m_s"),
        (lambda: synthetic.Path([0.0], [0.0, 1.0], [0.0]), "path y"),
        (lambda: synthetic.InsSpread(synthetic.Ring(-1.0)).draw(0), "radius_m"),
    ],
)
def test_bad_settings_are_refused_by_name(make, words):
    with pytest.raises(geomag.InvalidInputError, match=words):
        make()


def test_bad_flights_are_refused_by_name(field, path):
    with pytest.raises(geomag.InvalidInputError, match="outlier_rate"):
        synthetic.fly(field, path, sensor=synthetic.Sensor(outlier_rate=2.0))
    with pytest.raises(geomag.InvalidInputError, match="InsError"):
        synthetic.fly(field, path, ins={"heading_deg": 1})
    outside = synthetic.Path.straight((0, 0), course_deg=225, speed_m_s=60, interval_s=10, samples=3)
    with pytest.raises(geomag.InvalidInputError, match="path sample 1"):
        synthetic.fly(field, outside)
    degrees = synthetic.Path.straight((0, 0), course_deg=0, speed_m_s=60, interval_s=1, samples=2, geographic=True)
    with pytest.raises(geomag.InvalidInputError, match="metres"):
        synthetic.fly(field, degrees)
    with pytest.raises(geomag.InvalidInputError, match="SyntheticField"):
        synthetic.fly(None, path)


def test_a_survey_reads_the_field_where_it_flies(field):
    lines = synthetic.survey(field, line_spacing_m=1000.0, tie_spacing_m=8000.0)
    assert np.array_equal(lines.values, field.sample(lines.x, lines.y))
    pieces = lines.split()
    along = [p for p in pieces if np.ptp(p.y) == 0]
    ties = [p for p in pieces if np.ptp(p.x) == 0]
    assert (len(along), len(ties)) == (31, 6)
    assert [p.y[0] for p in along] == [1000.0 * k for k in range(31)]
    assert all(np.allclose(np.diff(p.x), 100.0) for p in along)
    # What `map_from_lines` takes for the spacing: that of all lines, ties among them.
    assert geomag.survey.line_spacing_m(lines) == pytest.approx(1000 / (1 + 1 / 8), rel=0.05)


def test_a_survey_has_the_errors_that_were_asked_for(field):
    options = {"line_spacing_m": 500.0, "sigma": 1.5, "level_sigma": 4.0, "wander_m": 30.0}
    lines = synthetic.survey(field, **options, seed=1)
    error = lines.values - field.sample(lines.x, lines.y)
    pieces = [error[lines.line == k] for k in np.unique(lines.line)]
    assert np.sqrt(np.mean([np.var(p) for p in pieces])) == pytest.approx(1.5, rel=0.03)
    # 61 levels: four standard errors.
    assert np.std([np.mean(p) for p in pieces]) == pytest.approx(4.0, rel=4 / np.sqrt(2 * 61))
    inner = [p for p in lines.split() if 400 < np.mean(p.y) < 29_600]
    away = np.concatenate([p.y - 500 * np.round(np.mean(p.y) / 500) for p in inner])
    assert np.std(away) == pytest.approx(30, rel=0.1)
    again, other = (synthetic.survey(field, **options, seed=s) for s in (1, 2))
    assert np.array_equal(again.values, lines.values)
    assert not np.array_equal(other.values, lines.values)


def test_a_geographic_survey_is_spaced_in_metres():
    field = synthetic.Crust().draw((10.0, 60.0, 10.4, 60.2), geographic=True, seed=1)
    lines = synthetic.survey(field, line_spacing_m=1000.0)
    assert lines.geographic
    east, north = lines.scale_m()
    first, second = lines.split()[:2]
    assert (second.y[0] - first.y[0]) * north == pytest.approx(1000, rel=1e-3)
    assert (first.x[1] - first.x[0]) * east == pytest.approx(100, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"line_spacing_m": 0.0}, "line_spacing_m: needed a number > 0"),
        ({"line_spacing_m": 40_000.0}, "needed at most the 30000 m of the field"),
        ({"line_spacing_m": 500.0, "sample_spacing_m": 1e-3}, "at most 50000000 readings"),
        ({"line_spacing_m": 500.0, "tie_spacing_m": float("nan")}, "tie_spacing_m: needed a number > 0, got nan"),
        ({"line_spacing_m": 500.0, "wander_m": -1.0}, "wander_m: needed a number >= 0"),
    ],
)
def test_bad_surveys_are_refused_by_name(field, options, words):
    with pytest.raises(geomag.InvalidInputError, match=words):
        synthetic.survey(field, **options)
