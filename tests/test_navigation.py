"""`Navigator`, `navigate` and what they answer, from Python."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest

import geomag

STEPS = 900


def chart(sigma=0.0, geographic=False):
    rng = np.random.default_rng(1)
    axis = np.arange(0.0, 40e3, 100.0)
    field = np.zeros((axis.size, axis.size))
    for length in 1500 * np.exp(1.2 * rng.uniform(size=40)):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        k = 2 * np.pi / length * np.array([np.cos(angle), np.sin(angle)])
        field += length / 200 * np.cos(k[0] * axis[None, :] + k[1] * axis[:, None] + phase)
    if geographic:
        return geomag.GridMap(field, 10 + axis / 71e3, 50 + axis / 111e3, geographic=True, sigma=sigma)
    return geomag.GridMap(field, axis, axis, sigma=sigma)


@pytest.fixture(scope="module")
def grid():
    return chart()


def log(grid, seed=0, error=(80.0, -60.0), drift=(0.1, -0.05)):
    """A flight to and fro with a drifting INS: what `navigate` takes, and the truth."""
    rng = np.random.default_rng(seed)
    time_s = 2.0 * np.arange(STEPS)
    way = (70 * time_s) % 60e3
    along = np.where(way < 30e3, way, 60e3 - way)
    x, y = 5e3 + along, 20e3 + 3e3 * np.sin(time_s / 400)
    velocity = np.stack([np.gradient(x, time_s), np.gradient(y, time_s)], axis=1)
    if grid.geographic:
        x, y = 10 + x / 71e3, 50 + y / 111e3
    scale = grid.metres_per_unit(float(np.mean(y)))
    given = {
        "time_s": time_s,
        "x": x + (error[0] + drift[0] * time_s) / scale[0],
        "y": y + (error[1] + drift[1] * time_s) / scale[1],
        "velocity_m_s": velocity + drift,
        "heading_deg": np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1])),
        "readings": grid.sample(x, y) + 12.0 + rng.normal(size=STEPS),
    }
    return given, (x, y)


@pytest.mark.parametrize("geographic", [False, True])
def test_a_flight_is_corrected_within_its_bound(geographic):
    grid = chart(geographic=geographic)
    given, truth = log(grid)
    flight = geomag.navigate(grid, **given, ins=geomag.InsModel.navigation(), position_sigma_m=100.0)
    found = flight.summary(truth)
    assert found["drms_m"] < 40
    assert found["beyond_protection"] == 0
    assert found["share_tracking"] == 1
    assert flight.covariance_m2.shape == (STEPS, 2, 2)
    assert flight.protection_level_m.shape == (STEPS,)
    assert flight.inputs == "full"
    assert flight.geographic is geographic
    assert len(flight) == STEPS
    assert abs(flight.bias[-1] - 12) < 5
    unaided = geomag.navigate(grid, **(given | {"readings": None})).summary(truth)
    assert unaided["drms_m"] > 100
    assert unaided["share_tracking"] < 0.1


def test_step_by_step_is_the_whole_log(grid):
    given, _ = log(grid)
    flight = geomag.navigate(grid, **given)
    navigator = geomag.Navigator(grid)
    for k in range(300):
        if k == 150:
            navigator = pickle.loads(pickle.dumps(navigator))
        row = [given[name][k] for name in ("time_s", "x", "y", "velocity_m_s", "heading_deg", "readings")]
        step = navigator.step(*row)
        assert (step.x, step.y) == (flight.x[k], flight.y[k])
        assert step.protection_level_m == flight.protection_level_m[k]
        assert step.status == flight.status[k]
    assert navigator.steps == 300
    assert navigator.state.shape == (15,)
    assert navigator.covariance.shape == (15, 15)


def test_less_input_is_said_and_still_bounded(grid):
    given, truth = log(grid)
    without_heading = geomag.navigate(grid, **(given | {"heading_deg": None}))
    positions = geomag.navigate(grid, **(given | {"heading_deg": None, "velocity_m_s": None}))
    assert (without_heading.inputs, positions.inputs) == ("velocity", "positions")
    for flight in (without_heading, positions):
        found = flight.summary(truth)
        assert found["drms_m"] < 60
        assert found["beyond_protection"] < 1e-3


def test_smoothing_gains_and_leaves_the_causal_output(grid):
    given, truth = log(grid)
    plain = geomag.navigate(grid, **given)
    assert plain.smooth_x is None
    for smooth in (300.0, "flight"):
        flight = geomag.navigate(grid, **given, smooth=smooth)
        np.testing.assert_array_equal(flight.x, plain.x)
        assert flight.summary(truth, smoothed=True)["drms_m"] < plain.summary(truth)["drms_m"]
    with pytest.raises(geomag.InvalidInputError, match="smooth"):
        plain.summary(truth, smoothed=True)
    with pytest.raises(geomag.InvalidInputError, match="smooth"):
        geomag.navigate(grid, **given, smooth="backwards")


def test_the_textbook_filter_is_sure_of_the_wrong_place():
    right = chart()
    rng = np.random.default_rng(3)
    coarse = rng.normal(size=(80, 80)) * 6
    wrong = geomag.GridMap(
        np.asarray(right.values) + np.kron(coarse, np.ones((5, 5))), right.x, right.y, sigma=6.0
    ).with_error_model(nu=3, scale_spread=0.3, correlation=1.5, registration=0.05, distance_m=200.0)
    given, truth = log(right)
    ours = geomag.navigate(wrong, **given).summary(truth)
    textbook = geomag.navigate(wrong, **given, method="ekf").summary(truth)
    assert ours["nees"] < 4
    assert textbook["nees"] > 10


def test_corrections_resets_and_the_bound_ahead(grid):
    given, truth = log(grid)
    navigator = geomag.Navigator(grid, position_sigma_m=300.0)
    with pytest.raises(geomag.InvalidInputError, match="step before"):
        navigator.correct_position((0.0, 0.0), 1.0)
    for k in range(20):
        navigator.step(
            given["time_s"][k], given["x"][k], given["y"][k], given["velocity_m_s"][k], given["heading_deg"][k]
        )
    offset = truth[0][19] - given["x"][19], truth[1][19] - given["y"][19]
    nis, reset = navigator.correct_position(offset, [[25.0, 0.0], [0.0, 25.0]])
    assert nis < 13.8
    assert not reset
    before = pickle.dumps(navigator)
    bound = navigator.predict_bound(given["time_s"], *truth, velocity_m_s=given["velocity_m_s"])
    assert bound.shape == (STEPS, 2, 2)
    assert 0 < bound[-1, 0, 0] < 400
    assert pickle.dumps(navigator) == before
    nis, _ = navigator.correct_velocity(given["velocity_m_s"][19] - [0.1, -0.05], 0.05)
    assert nis < 13.8
    fix = geomag.match_posterior(
        grid,
        geomag.Track(given["x"][:40], given["y"][:40], given["readings"][:40]),
        half_width=500,
        sigma=1.0,
        tolerance_m=100.0,
    )
    assert fix.ok
    assert navigator.correct(fix)[0] >= 0
    navigator.reset(truth[0][19], truth[1][19], 100.0)
    assert abs(navigator.state[0] + offset[0]) < 1e-6


def test_bad_input_is_named(grid):
    given, _ = log(grid)
    for change, error, words in [
        ({"x": given["x"][:-1]}, geomag.ShapeError, "x"),
        ({"velocity_m_s": given["velocity_m_s"][:, :1]}, geomag.ShapeError, "velocity_m_s"),
        ({"time_s": given["time_s"][::-1]}, geomag.InvalidInputError, "step 1: time_s"),
        ({"readings": np.where(np.arange(STEPS) == 7, np.inf, 0.0)}, geomag.NotFiniteError, r"value\[7\]"),
        ({"position_sigma_m": -1.0}, geomag.InvalidInputError, "position_sigma_m"),
        ({"integrity_risk": 0.0}, geomag.InvalidInputError, "integrity_risk"),
        ({"ins": "good"}, geomag.InvalidInputError, "InsModel"),
        ({"method": "ukf"}, geomag.InvalidInputError, "method"),
        ({"matcher": 3}, geomag.InvalidInputError, "MatcherPlan"),
        ({"no_such": 1}, TypeError, "no_such"),
    ]:
        with pytest.raises(error, match=words):
            geomag.navigate(grid, **(given | change))
    with pytest.raises(geomag.InvalidInputError, match="gyro_bias_deg_h"):
        geomag.InsModel(gyro_bias_deg_h=-1.0)
    with pytest.raises(geomag.InvalidInputError, match="every_s"):
        geomag.MatcherPlan(every_s=0.0)


def test_models_pickle_and_compare():
    for thing in (geomag.InsModel.tactical(), geomag.MatcherPlan(every_s=30.0, tolerance_m=200.0)):
        assert pickle.loads(pickle.dumps(thing)) == thing
    assert geomag.InsModel(**geomag.InsModel.tactical().to_dict()) == geomag.InsModel.tactical()


def test_a_table_has_a_row_a_step(grid):
    pytest.importorskip("pandas")
    given, _ = log(grid)
    table = geomag.navigate(grid, **given, smooth="flight").to_dataframe()
    assert len(table) == STEPS
    assert {"time_s", "x", "y", "variance_east_m2", "status", "protection_level_m", "smooth_x"} <= set(table.columns)


def test_threads_share_a_navigator_and_none_waits_for_ever(grid):
    given, _ = log(grid)
    navigator = geomag.Navigator(grid)
    failures = []

    def run():
        try:
            for k in range(50):
                navigator.step(0.0, given["x"][k], given["y"][k], (70.0, 0.0), 90.0, given["readings"][k])
        except geomag.GeomagError as error:
            failures.append(error)

    threads = [threading.Thread(target=run) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join(timeout=60)
    assert not failures
    assert not any(one.is_alive() for one in threads)
    assert navigator.steps == 200


def test_the_vehicles_own_field_is_learnt_in_flight(grid):
    given, truth = log(grid)
    heading = np.radians(given["heading_deg"])
    terms = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    given["readings"] = given["readings"] + terms @ [40.0, -25.0]
    plain = geomag.navigate(grid, **given).summary(truth)
    flight = geomag.navigate(grid, **given, terms=terms, terms_covariance=2500.0 * np.eye(2))
    learnt = flight.summary(truth)
    assert learnt["drms_m"] < 40
    assert learnt["drms_m"] < plain["drms_m"]
    assert flight.state.shape == (17,)
    # Its two legs tell the one from the other, but the sine from the bias only as their difference.
    assert abs(flight.state[-1] + 25) < 10
    with pytest.raises(geomag.ShapeError, match="terms"):
        geomag.navigate(grid, **given, terms=terms)
    with pytest.raises(geomag.NotPositiveDefiniteError, match="terms_covariance"):
        geomag.navigate(grid, **given, terms=terms, terms_covariance=np.ones((2, 2)))


def test_the_particles_of_the_textbook_follow_a_right_map(grid):
    given, truth = log(grid)
    few = {name: values[:200] for name, values in given.items()}
    where = truth[0][:200], truth[1][:200]
    flight = geomag.navigate(grid, **few, method="rbpf")
    again = geomag.navigate(grid, **few, method="rbpf")
    np.testing.assert_array_equal(flight.x, again.x)
    assert flight.summary(where, after_s=200)["drms_m"] < 60
    with pytest.raises(geomag.InvalidInputError, match="whole flights"):
        geomag.Navigator(grid, method="rbpf")
    with pytest.raises(geomag.InvalidInputError, match="smooth"):
        geomag.navigate(grid, **few, method="rbpf", smooth="flight")
