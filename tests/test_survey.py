"""Survey lines: where the nodes of their grids lie, and what is refused of them."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import geomag
from geomag import survey, synthetic
from geomag._geomag import _minimum_curvature
from geomag.calibration import calibrate_lines, calibrate_simulated, suitability
from geomag.survey import ErrorModel, Lines, learn_errors, map_from_lines
from geomag.survey._surface import Axes, nodes

coordinate = st.floats(-1e7, 1e7, allow_subnormal=False)


@settings(deadline=None)
@given(coordinate, st.floats(0, 1e4), st.floats(1e-3, 1e3))
@example(0.9, 0.9, 1.0)
@example(0.3, 0.3, 0.1)
@example(-0.7, 1.4, 0.1)
def test_nodes_enclose_every_datum_and_no_more_than_that(low, extent, step):
    c = np.array([low + extent, low])
    first, count = nodes(c, step)
    last = first + step * (count - 1)
    assert first <= c.min()
    assert last >= c.max()
    slack = 1e-6 * step + 4 * np.spacing(abs(c).max())
    assert c.min() - first <= step + slack
    assert last - c.max() <= step + slack or count == 2
    assert count <= int(extent / step) + 3


def test_a_map_of_lines_has_a_value_at_every_datum():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0.9, 11.8, 60), np.linspace(0.6, 9.5, 12)))
    lines = Lines(x, y, np.sin(x / 3) + np.cos(y / 2), np.repeat(np.arange(12), 60))
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.15, 0.8, 0, 0.0)
    grid = map_from_lines(lines, spacing=1.0, model=model)
    assert (grid.x[-1], grid.y[-1]) == (12.0, 10.0)
    assert np.isfinite(grid.sample(x, y)).all()


@pytest.mark.parametrize("weight", [0.1, 1.0])
def test_a_surface_that_misses_its_data_is_the_thin_plate_smoothing_spline(weight):
    """SciPy's spline of r^2 log r, whose energy is 8 pi times its quadratic form, with the same penalty."""
    interpolate = pytest.importorskip("scipy.interpolate")
    rng, n = np.random.default_rng(1), 61
    where, axis = rng.uniform(0, n - 1, (900, 2)), np.arange(float(n))

    def truth(x, y):
        return 10 * np.sin(x / 9) * np.cos(y / 7) + 0.2 * x

    data = truth(*where.T) + rng.normal(0, 2, 900)
    nodes_xy = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    spline = interpolate.RBFInterpolator(where, data, kernel="thin_plate_spline", smoothing=8 * np.pi / weight)
    expected = spline(nodes_xy).reshape(n, n)
    got = _minimum_curvature(*where.T, data, (0.0, 1.0, n), (0.0, 1.0, n), aspect=1.0, weight=weight)
    inner = (slice(12, -12), slice(12, -12))
    # Nodes stand for the data of their cells, and the border is softer than the spline's.
    noise = np.std((expected - truth(*np.meshgrid(axis, axis)))[inner])
    assert np.std((got - expected)[inner]) < 0.2 * noise


@pytest.fixture(scope="module")
def noisy():
    """A flat and a strong field, each with lines of 1 nT of noise over it."""

    def over(height_m, rms):
        crust = synthetic.Crust(
            waves=256, longest_m=10_000.0, height_m=height_m, shortest_m=2 * height_m, dipoles=0, texture_rms=rms
        )
        field = crust.draw((0, 0, 12_000, 12_000), seed=3)
        return field, synthetic.survey(field, line_spacing_m=300.0, sample_spacing_m=25.0, sigma=1.0, seed=3)

    return {"flat": over(600.0, 6.0), "strong": over(150.0, 60.0)}


def test_the_same_is_learnt_by_one_thread_and_by_several(noisy, monkeypatch):
    monkeypatch.setattr("geomag.survey._trials.MOST_WINDOWS", 60)
    monkeypatch.setattr("geomag.survey._trials.FORECAST_WINDOWS", 20)
    learnt = []
    for threads in ("1", "3"):
        monkeypatch.setenv("RAYON_NUM_THREADS", threads)
        learnt.append(asdict(learn_errors(noisy["flat"][1], folds=2)))
    one, several = learnt
    assert one["smoothing_m"] > 0
    for name in one:
        np.testing.assert_equal(several[name], one[name], err_msg=name)


def test_the_lines_say_whether_noise_is_taken_for_field(noisy, monkeypatch):
    monkeypatch.setattr("geomag.survey._trials.MOST_WINDOWS", 60)
    monkeypatch.setattr("geomag.survey._trials.FORECAST_WINDOWS", 20)
    field, lines = noisy["flat"]
    model = learn_errors(lines)
    assert model.smoothing_m > 50
    errors = []
    for smoothing_m in (0.0, None):
        grid = map_from_lines(lines, smoothing_m=smoothing_m)
        x, y = np.meshgrid(grid.x, grid.y)
        errors.append((np.asarray(grid.values) - field.sample(x.ravel(), y.ravel()).reshape(x.shape))[8:-8, 8:-8])
    # The slopes of the errors are what looks like field.
    slopes = [np.nanstd(np.diff(e, axis=1)) for e in errors]
    assert np.nanstd(errors[1]) < 0.7 * np.nanstd(errors[0])
    assert slopes[1] < 0.4 * slopes[0]
    # Lines over a strong field are honoured.
    field, lines = noisy["strong"]
    model = learn_errors(lines)
    assert model.smoothing_m == 0
    honoured = map_from_lines(lines, model=model)
    assert np.nanstd(honoured.sample(lines.x, lines.y) - lines.values) < 1.0


def test_smoothing_that_cannot_be_is_refused(noisy):
    _, lines = noisy["flat"]
    for value in (-1.0, np.nan, np.inf, "wide"):
        with pytest.raises(geomag.InvalidInputError, match="smoothing_m: needed a number"):
            learn_errors(lines, smoothing_m=value)
    with pytest.raises(geomag.InvalidInputError, match="'linear'"):
        map_from_lines(lines, method="linear", smoothing_m=100.0)
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.15, 300.0, 0, 0.0, smoothing_m=100.0)
    with pytest.raises(geomag.InvalidInputError, match="beside a model"):
        map_from_lines(lines, model=model, smoothing_m=100.0)
    with pytest.raises(geomag.InvalidInputError, match="'cubic'"):
        map_from_lines(lines, model=model, method="cubic")
    with pytest.raises(geomag.InvalidInputError, match="weight: needed"):
        _minimum_curvature([0.0], [0.0], [1.0], (0.0, 1.0, 3), (0.0, 1.0, 3), aspect=1.0, weight=0.0)


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf, (1.0, 2.0, 3.0), "wide", (1.0, 0.0)])
def test_a_spacing_that_is_none_is_refused(spacing):
    lines = Lines([0.0, 1, 2, 3], [0.0, 1, 0, 1], [1.0, 2, 3, 4], [0, 0, 1, 1])
    with pytest.raises(geomag.InvalidInputError, match="spacing"):
        Axes.over(lines, spacing)


def test_lines_that_cannot_be_are_refused():
    with pytest.raises(geomag.InvalidInputError, match="metres"):
        Lines([5e5, 6e5], [5e6, 5e6], [1.0, 2.0], [0, 0], geographic=True)
    with pytest.raises(geomag.InvalidInputError, match="lines values: needed numbers"):
        Lines([0.0, 1.0], [0.0, 1.0], ["a", "b"], [0, 0])


@pytest.mark.parametrize(
    ("name", "value"),
    [("sigma", -1.0), ("bias", -1.0), ("bias", np.nan), ("outlier", np.nan), ("outlier_share", 3.0), ("drift_m", np.nan),
     ("heading_deg", -4.0), ("samples", 0), ("trials", 0), ("half_width_m", np.nan), ("tolerance_m", -1.0)],
)  # fmt: skip
def test_a_simulation_of_nonsense_is_refused(name, value):
    grid = geomag.GridMap(np.random.default_rng(1).normal(size=(60, 60)), 100.0 * np.arange(60), 100.0 * np.arange(60))
    options = {"sigma": 1.0, "half_width_m": 500.0, "tolerance_m": 100.0, "samples": 10, "trials": 2, name: value}
    with pytest.raises(geomag.InvalidInputError, match=f"{name}: needed"):
        calibrate_simulated(grid, **options)


@pytest.mark.parametrize(
    ("name", "value"),
    [("half_width_m", -1.0), ("tolerance_m", 0.0), ("spacing_m", 0.0), ("spacing_m", np.nan), ("samples", -5),
     ("folds", 1), ("most", 0)],
)  # fmt: skip
def test_a_calibration_of_nonsense_is_refused(name, value):
    lines = Lines([0.0, 1, 2, 3], [0.0, 1, 0, 1], [1.0, 2, 3, 4], [0, 0, 1, 1])
    options = {"half_width_m": 500.0, "tolerance_m": 100.0, "spacing_m": 50.0, name: value}
    with pytest.raises(geomag.InvalidInputError, match=f"{name}: needed"):
        calibrate_lines(lines, **options)


def test_a_look_ahead_of_nonsense_is_refused():
    grid = geomag.GridMap(np.random.default_rng(1).normal(size=(60, 60)), 100.0 * np.arange(60), 100.0 * np.arange(60))
    for name, value in (("flights", -1), ("spacing_m", np.inf), ("half_width_m", 0.0)):
        options = {"spacing_m": 100.0, "half_width_m": 500.0, name: value}
        with pytest.raises(geomag.InvalidInputError, match=f"{name}: needed"):
            suitability(grid, **options)


def test_lines_at_their_own_heights_make_a_map_at_a_level_and_a_stack():
    rng = np.random.default_rng(3)
    waves = [(rng.normal(0, 14), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(1200, 9000, 40)]

    def field(x, y, h):
        return sum(a * np.exp(-k * h) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)

    along, across = np.arange(0.0, 8000.0, 50.0), np.arange(0.0, 8000.0, 250.0)
    x, y = (a.ravel() for a in np.meshgrid(along, across))
    line = np.repeat(np.arange(across.size), along.size)
    height = 120 + 40 * np.sin(x / 4000) * np.cos(y / 5000) + rng.normal(0, 20, across.size)[line]
    lines = survey.Lines(x, y, field(x, y, height), line, height_m=height, unit="nT")
    model = survey.ErrorModel(
        noise=0.1, floor=0.1, displacement=0.02, curvature=0.1, correlation=1.3, registration=0.05,
        line_spacing_m=250.0, windows=0, loss=0.0,
    )  # fmt: skip
    level = survey.map_from_lines(lines, height_m=200.0, model=model)
    assert level.height_m == 200.0
    assert level.units == "nT"
    truth = field(level.x, level.y[:, None], 200.0)
    inner = np.s_[40:-40, 40:-40]
    error = np.sqrt(np.nanmean((np.asarray(level.values) - truth)[inner] ** 2))
    # Heights passed over, and the map said to be at their mean.
    flat = survey.map_from_lines(survey.Lines(x, y, lines.values, line), model=model)
    flat = geomag.GridMap(flat.values, flat.x, flat.y, sigma=flat.sigma, height_m=120.0).continue_to(200.0)
    passed_over = np.sqrt(np.nanmean((np.asarray(flat.values) - truth)[inner] ** 2))
    assert error < 0.3 * passed_over
    stack = survey.map_from_lines(lines, height_m=[200.0, 300.0], model=model)
    assert stack.heights_m.tolist() == [200.0, 300.0]
    assert np.array_equal(stack.levels[0].values, level.values, equal_nan=True)


def test_a_map_at_a_height_needs_lines_that_say_theirs():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.0, 4000.0, 50.0), np.arange(0.0, 4000.0, 250.0)))
    line = np.repeat(np.arange(16), 80)
    bare = survey.Lines(x, y, np.sin(x / 300), line)
    with pytest.raises(geomag.InvalidInputError, match="lines with heights"):
        survey.map_from_lines(bare, height_m=200.0)
    high = survey.Lines(x, y, np.sin(x / 300), line, height_m=100.0)
    for bad in (np.nan, [], "up"):
        with pytest.raises(geomag.InvalidInputError, match="height_m"):
            survey.map_from_lines(high, height_m=bad)
    grid = geomag.GridMap(np.zeros((4, 4)), [0.0, 1, 2, 3], [0.0, 1, 2, 3])
    with pytest.raises(geomag.InvalidInputError, match="got a grid"):
        survey.map_from_lines(high, height_m=200.0, grid=grid)
