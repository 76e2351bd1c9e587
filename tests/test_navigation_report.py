"""The report of whole flights: figures from runs whose truth is known, methods on identical flights, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag._statistics import normalised_squares
from geomag.calibration import calibrate_navigation
from geomag.navigation_report import FlightRun, NavigationReport

FIELD = synthetic.Crust(height_m=300.0).draw((0, 0, 40_000, 24_000), seed=4)
RIGHT = FIELD.grid(75.0)


@pytest.fixture(scope="module")
def lines():
    return synthetic.survey(FIELD, line_spacing_m=400.0)


@pytest.fixture(scope="module")
def right():
    return geomag.GridMap(np.asarray(RIGHT.values), RIGHT.x, RIGHT.y, sigma=0.0)


def run(error, sigma=100.0, status="tracking", seconds=3600, level=400.0):
    n = 100
    errors = np.broadcast_to(np.asarray(error, dtype=float), (n, 2)).copy()
    return FlightRun(
        0, 0, 0, np.linspace(0, seconds, n), errors, 10 * errors, np.tile(sigma**2 * np.eye(2), (n, 1, 1)), np.full(n, level),
        np.full(n, status, dtype="<U9") if isinstance(status, str) else np.array(status),
    )  # fmt: skip


def test_figures_of_runs_that_are_known():
    s = NavigationReport("known", "navigator", [run((30.0, 40.0)), run((120.0, 160.0))]).summary()
    assert s["drms_m"] == pytest.approx(np.sqrt((50**2 + 200**2) / 2))
    assert s["nees"] == pytest.approx((0.25 + 4.0) / 2)
    assert s["inside"] == 1.0
    assert s["unaided_drms_m"] == pytest.approx(10 * s["drms_m"])
    assert (s["diverged"], s["kept"], s["beyond_protection"]) == (0.0, 1.0, 0.0)
    beyond = NavigationReport("far", "navigator", [run((0.0, 450.0))]).summary()
    assert (
        beyond["inside"],
        beyond["inside_declared"],
        beyond["beyond_protection"],
        beyond["beyond_protection_flights"],
    ) == (0.0, 0.0, 1.0, 1.0)
    nearly = NavigationReport("near", "navigator", [run((0.0, 350.0))]).summary()
    assert (nearly["inside"], nearly["inside_declared"]) == (0.0, 1.0)


def test_a_covariance_of_nothing_is_an_infinite_error_and_no_refusal():
    errors = np.random.default_rng(3).normal(0, 50, (40, 2))
    full = np.tile([[900.0, 200.0], [200.0, 400.0]], (40, 1, 1))
    wanted = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(full), errors)
    np.testing.assert_allclose(normalised_squares(errors, full), wanted, rtol=1e-12)
    # One particle left, or particles on a line.
    for bad in (np.zeros((2, 2)), np.array([[4.0, 2.0], [2.0, 1.0]])):
        assert np.isinf(normalised_squares(errors, np.tile(bad, (40, 1, 1)))).all()
    assert normalised_squares(np.zeros((1, 2)), np.zeros((1, 2, 2))) == 0.0
    collapsed = NavigationReport("one particle", "rbpf", [run((3.0, 4.0), sigma=0.0)])
    assert collapsed.summary()["nees"] == np.inf
    assert "| inf |" in NavigationReport.table([collapsed])
    near = NavigationReport("nearly", "rbpf", [run((3.0, 4.0), sigma=1e-12)])
    assert "| 2.5e+25 |" in NavigationReport.table([near])


def test_lost_is_not_diverged_where_it_is_declared():
    far = run((0.0, 2_000.0), sigma=100.0)
    assert far.diverged
    declared = run((0.0, 2_000.0), sigma=1_000.0, status="lost")
    assert not declared.diverged
    assert not declared.kept
    statuses = ["acquiring"] * 20 + ["tracking"] * 40 + ["lost"] * 40
    late = run((0.0, 50.0), status=statuses)
    assert late.acquired_s == pytest.approx(20 * 3600 / 99)
    assert late.lost_share == pytest.approx(0.5)
    never = run((0.0, 50.0), status="acquiring")
    assert np.isinf(never.acquired_s)
    assert never.lost_share == 1.0


def test_a_right_map_is_navigated_to_some_metres_and_methods_fly_the_same_flights(lines, right):
    asked = {"maps": [right] * 3, "hours": 0.5, "draws": 2, "flights": 1}
    report = calibrate_navigation(lines, **asked)
    s = report.summary()
    assert s["runs"] == 6
    assert s["drms_m"] < 40
    assert s["beyond_protection"] == 0.0
    windows = calibrate_navigation(lines, method="windows", **asked)
    for one, other in zip(report.runs, windows.runs, strict=True):
        np.testing.assert_array_equal(one.unaided_m, other.unaided_m)
    text = NavigationReport.table([report, windows])
    assert text.count("\n") == 3
    assert "| survey, windows | 6 |" in text
    again = calibrate_navigation(lines, **asked)
    np.testing.assert_equal(again.summary(), s)


def test_a_disturbance_reaches_the_navigator(lines, right):
    asked = {"maps": [right] * 3, "hours": 0.25, "draws": 1, "flights": 1}
    silent = calibrate_navigation(
        lines, disturb=lambda flight, shown, readings, rng: np.full_like(readings, np.nan), **asked
    )
    s = silent.summary()
    assert s["drms_m"] == pytest.approx(s["unaided_drms_m"], rel=1e-6)


def test_a_map_made_of_the_lines_holds_what_it_declares(lines):
    report = calibrate_navigation(lines, hours=0.5, draws=1, flights=1, folds=2, map_options={"spacing": 130.0})
    s = report.summary()
    assert s["runs"] == 2
    assert s["drms_m"] < 0.5 * s["unaided_drms_m"]
    assert s["beyond_protection"] < 0.05


def test_picture(lines, right, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    report = calibrate_navigation(lines, maps=[right] * 3, hours=0.25, draws=1, flights=1)
    report.plot(tmp_path / "report.png")
    assert (tmp_path / "report.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "guess"}, "method: needed one of navigator"),
        ({"simulation": "none"}, "simulation: needed 'equations' or 'strapdown'"),
        ({"simulation": "strapdown"}, "needed lines in degrees"),
        ({"draws": 0}, "draws: needed a number >= 1"),
        ({"maps": []}, "maps: needed 3, one a fold, got 0"),
        ({"hours": 50.0}, "needed a chain of lines of 50 h"),
        ({"folds": 1, "maps": None}, "needed at least 4 lines for 1 folds"),
    ],
)
def test_what_cannot_be_asked(lines, right, change, message):
    asked = {"maps": [right] * 3} | change
    with pytest.raises(geomag.GeomagError, match=message):
        calibrate_navigation(lines, **asked)
