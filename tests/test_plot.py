"""Pictures: what is drawn (labels, units, data), that bad input is refused, and that two runs give the same pixels."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

from geomag import plot  # noqa: E402 - after the backend


@pytest.fixture(scope="module")
def scene():
    field = synthetic.Crust().draw((0, 0, 40_000, 30_000), seed=7)
    grid = field.grid(500.0, units="nT", name="anomaly")
    path = synthetic.Path.straight((9_000, 7_000), course_deg=60, speed_m_s=60, interval_s=8, samples=40)
    flight = synthetic.fly(
        field, path, ins=synthetic.InsError(position_m=(-800.0, 500.0)), sensor=synthetic.Sensor(sigma=2.0)
    )
    fix = geomag.match_grid(grid, flight.track, half_width=2000.0, surface=True)
    return grid, flight, fix


@pytest.fixture(autouse=True)
def _close():
    yield
    matplotlib.pyplot.close("all")


def frames_of(grid, track):
    iema = geomag.Iema(grid, sigma=15.0, half_width=2000.0, tolerance=500.0, max_misses=3)
    out = []
    for x, y, v in zip(track.x, track.y, track.values, strict=True):
        step = iema.update(x, y, v)
        out.append(plot.Frame(step.n_samples, iema.feasible, *iema.offsets))
        if step.status != "searching":
            break
    return out


def pixels(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())


def test_match_figure_has_every_panel(scene):
    grid, flight, fix = scene
    figure = plot.match_figure(
        grid, flight.track, fix, truth=flight.path, steps=frames_of(grid, flight.track), surface_label="msd (nT²)"
    )
    figure.canvas.draw()
    labels = [ax.get_xlabel() for ax in figure.axes] + [ax.get_ylabel() for ax in figure.axes]
    for needed in ("easting (km)", "northing (km)", "offset east (km)", "distance along the track (km)", "field (nT)"):
        assert needed in labels, needed
    assert "anomaly (nT)" in labels
    assert "msd (nT²)" in labels
    assert "Fixed after 40 samples" in figure.get_suptitle()
    assert "error" in figure.get_suptitle()


@pytest.mark.parametrize("status", ["lost", "at_edge"])
def test_match_figure_of_no_fix(scene, status):
    grid, flight, _ = scene
    if status == "lost":
        fix = geomag.Iema(grid, sigma=1e-6, half_width=600.0).run(flight.track)
        assert fix.status == "lost"
    else:
        fix = geomag.match_grid(grid, flight.track, half_width=500.0)
        assert fix.status == "at_edge"
    figure = plot.match_figure(grid, flight.track, fix)
    figure.canvas.draw()
    assert status.capitalize() in figure.get_suptitle()


def test_geographic_map_in_degrees_with_offsets_in_metres():
    field = synthetic.Crust().draw((-3.0, 60.0, -2.0, 60.4), geographic=True, seed=1)
    grid = field.grid(0.01, units="nT")
    path = synthetic.Path.straight(
        (-2.7, 60.15), course_deg=80, speed_m_s=50, interval_s=10, samples=30, geographic=True
    )
    flight = synthetic.fly(field, path, ins=synthetic.InsError(position_m=(900.0, 300.0)))
    fix = geomag.match_grid(grid, flight.track, half_width=(0.05, 0.03), surface=True)
    figure = plot.match_figure(grid, flight.track, fix, truth=path)
    figure.canvas.draw()
    labels = {ax.get_xlabel() for ax in figure.axes}
    assert {"longitude (degrees east)", "offset east (km)"} <= labels
    chart = next(ax for ax in figure.axes if ax.get_xlabel().startswith("longitude"))
    assert chart.get_aspect() == pytest.approx(2.0, rel=0.02)  # a degree of longitude at 60 degrees is half as long


def test_scale_bar_is_as_long_as_it_says(scene):
    grid, _, _ = scene
    ax = plot.field_map(grid)
    ax.figure.canvas.draw()
    text = next(t for t in ax.texts if t.get_text().endswith("km"))
    bar = next(line for line in ax.lines if line.get_transform() is ax.transAxes)
    share = np.ptp(bar.get_xdata())
    width_m = np.ptp(ax.get_xlim())
    assert share * width_m == pytest.approx(float(text.get_text().split()[0]) * 1000)
    assert any(t.get_text() == "N" for t in ax.texts)


def test_ellipse_holds_its_probability(scene):
    grid, _, _ = scene
    ax = plot.field_map(grid)
    covariance = np.array([[9e4, 4e4], [4e4, 6e4]])
    plot.ellipse(ax, 2e4, 1.5e4, covariance, probability=0.95)
    points = ax.lines[-1].get_xydata() - [2e4, 1.5e4]
    distance = np.einsum("ni,ij,nj->n", points, np.linalg.inv(covariance), points)
    np.testing.assert_allclose(distance, -2 * np.log(0.05), rtol=1e-9)
    with pytest.raises(geomag.InvalidInputError, match="eigenvalues"):
        plot.ellipse(ax, 0, 0, [[1, 5], [5, 1]])


def test_same_picture_twice(scene):
    grid, flight, fix = scene
    one, two = (pixels(plot.match_figure(grid, flight.track, fix, truth=flight.path)) for _ in range(2))
    assert np.array_equal(one, two)


def test_colours_differ_in_grey_and_to_the_colour_blind():
    def luminance(colour):
        r, g, b = (
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in matplotlib.colors.to_rgb(colour)
        )
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    grey = [luminance(plot.COLOURS[c]) for c in ("true", "matched", "indicated", "accent")]
    assert min(np.diff(grey)) > 0.05
    shades = [luminance(c) for c in matplotlib.colormaps["cividis"](np.linspace(0, 1, 64))[:, :3]]
    assert np.all(np.diff(shades) > 0)


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_files_are_written_without_a_date(scene, tmp_path, ending):
    _, _, fix = scene
    files = []
    for name in ("a", "b"):
        files.append(plot.save(plot.score_surface(fix).figure, tmp_path / "new" / f"{name}.{ending}"))
    assert files[0].stat().st_size > 2000
    assert files[0].read_bytes() == files[1].read_bytes()


def test_animation_has_a_frame_a_sample(scene, tmp_path):
    image = pytest.importorskip("PIL.Image")
    grid, flight, _ = scene
    steps = frames_of(grid, flight.track)[:5]
    path = plot.animate(steps, tmp_path / "feasible.gif", true_offset=flight.offset)
    with image.open(path) as movie:
        assert movie.n_frames == 5


def test_frames_of_a_posterior():
    x = np.linspace(-1000, 1000, 21)
    peak = np.exp(-((x[None, :] - 200) ** 2 + (x[:, None] + 300) ** 2) / 2e5)
    figure = plot.frames(
        [plot.Frame(k, peak**k / (peak**k).sum(), x, x) for k in range(1, 13)], true_offset=(200, -300)
    )
    figure.canvas.draw()
    assert len(figure.axes) == 8
    assert figure.axes[-1].get_title(loc="left").startswith("12 samples")


def test_reliability_points_have_the_intervals_that_they_came_with():
    # The first bin is so large and clean that its whole interval lies below the axis.
    ax = plot.reliability_points([(1e-5, 0.0, 0.0, 1e-4, 40_000), (0.02, 0.05, 0.01, 0.2, 60)], label="counted")
    (bars,) = (c for c in ax.containers if c.has_yerr)
    lower, upper = (segment[:, 1] for segment in bars[2][0].get_segments())
    assert lower[0] == lower[1]
    np.testing.assert_allclose(upper, [0.01, 0.2])


def test_calibration_diagram_shows_rates_with_intervals():
    rng = np.random.default_rng(0)
    risk = rng.uniform(0, 0.2, 4000)
    ax = plot.calibration_diagram(risk, rng.uniform(size=4000) < risk, label="honest")
    counts = [int(t.get_text()) for t in ax.texts if t.get_text().isdigit()]
    assert sum(counts) == 4000
    plot.calibration_diagram(risk, rng.uniform(size=4000) < 3 * risk, ax, label="bold", colour=plot.COLOURS["bad"])
    assert len(ax.containers) == 2


def test_other_diagrams_have_units(scene):
    grid, flight, _ = scene
    along = flight.track.distance_m()
    ax = plot.sequence_choice(along, flight.track.values, [0, 3, 9], staircase=np.round(flight.track.values))
    assert ax.get_xlabel() == "distance along the track (km)"
    assert ax.get_ylabel() == "field (nT)"
    time = np.arange(0, 900.0, 10)
    error = np.random.default_rng(0).normal(0, 5, (time.size, 2))
    figure = plot.filter_errors(time, error, np.full_like(error, 5.0))
    assert [a.get_ylabel() for a in figure.axes] == ["north error (m)", "east error (m)"]
    assert figure.axes[-1].get_xlabel() == "time (min)"
    ax = plot.error_distribution({"a": error[:, 0], "b": np.full(9, np.nan)}, tolerance_m=10.0)
    assert ax.get_xlabel() == "position error (m)"
    ax = plot.suitability_map(np.hypot(*np.meshgrid(grid.x, grid.y)) / 100, grid.x, grid.y, good_below=200.0)
    assert any("error (m)" in a.get_ylabel() for a in ax.figure.axes)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda g, t, f: plot.save(plot.field_map(g).figure, "map.bmp"), "ending"),
        (lambda g, t, f: plot.field_map(g, bounds=(1e9, 1e9, 2e9, 2e9)), "bounds"),
        (lambda g, t, f: plot.score_surface(geomag.match_grid(g, t, half_width=1000.0)), "surface"),
        (lambda g, t, f: plot.score_surface(np.zeros((3, 3)), [0, 1], [0, 1, 2]), "shape"),
        (lambda g, t, f: plot.score_surface(np.full((2, 2), np.nan), [0, 1], [0, 1]), "not NaN"),
        (lambda g, t, f: plot.frames([]), "frame"),
        (lambda g, t, f: plot.animate([], "a.gif"), "frame"),
        (lambda g, t, f: plot.calibration_diagram([0.5], [True, False]), "arrays"),
        (lambda g, t, f: plot.calibration_diagram([1.5], [True]), "risks"),
        (lambda g, t, f: plot.filter_errors([0, 1], np.zeros((3, 2))), "shape"),
        (lambda g, t, f: plot.suitability_map(np.zeros((2, 2)), [0, 1, 2], [0, 1]), "shape"),
        (lambda g, t, f: plot.tracks(plot.field_map(g), true=np.zeros(4)), "array"),
    ],
)
def test_bad_input_is_refused_by_name(scene, call, words):
    grid, flight, fix = scene
    with pytest.raises(geomag.InvalidInputError, match=words):
        call(grid, flight.track, fix)


def test_a_tall_map_fills_its_figure_and_names_its_hatching():
    y = np.arange(300) * 1000.0
    ax = plot.suitability_map(np.random.default_rng(1).uniform(10, 900, (300, 100)), y[:100], y, good_below=300.0)
    width, height = ax.figure.get_size_inches()
    assert width < 0.6 * height
    assert any("hatched" in text.get_text() for text in ax.texts)


def test_legends_stand_below_the_curves():
    errors = plot.error_distribution({"one": np.geomspace(1e-3, 1e3, 50)}, tolerance_m=10.0)
    risks = plot.reliability_points([(1e-3, 0.1, 0.0, 0.9, 9)], label="observed")
    for ax in (errors, risks):
        ax.figure.canvas.draw()
        assert ax.get_legend().get_window_extent().y1 < ax.get_window_extent().y0
    assert "worse than declared" in [t.get_text() for t in risks.get_legend().get_texts()]
