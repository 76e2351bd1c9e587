"""Coordinates are bounded where they enter: blanks of old formats are finite, and no place."""

from __future__ import annotations

import numpy as np
import pytest
from fields import rough

import geomag

#: Blanks and slips: finite, far from anywhere.
FAR = [1e22, -1e32, 9.97e36, 1.7e38, 9e20, 1e300, 2e8]
X = np.arange(0.0, 4000.0, 50.0)


@pytest.fixture(scope="module")
def grid():
    return geomag.GridMap(rough(np.random.default_rng(0), 80, 80, smooth=4.0), X, X)


@pytest.fixture(scope="module")
def degrees():
    return geomag.GridMap(
        rough(np.random.default_rng(0), 80, 80, smooth=4.0), 10 + X * 1e-5, 50 + X * 1e-5, geographic=True
    )


#: name -> a stream at its start on a map.
STREAMS = {
    "Iema": lambda grid, half: geomag.Iema(grid, sigma=1.0, half_width=half),
    "PosteriorMatcher": lambda grid, half: geomag.PosteriorMatcher(grid, half_width=half, sigma=1.0),
    "SlidingContour": lambda grid, half: geomag.SlidingContour(grid, length=3, transform="translation"),
}


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_track_names_the_sample(far, axis):
    places = {"x": np.arange(5.0), "y": np.arange(5.0)}
    places[axis][3] = far
    with pytest.raises(geomag.InvalidInputError, match=rf"track {axis}\[3\]: needed a coordinate within \+-1"):
        geomag.Track(places["x"], places["y"], np.zeros(5))


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_refuses_it_and_goes_on(grid, name, far):
    stream, twin = (STREAMS[name](grid, 300.0) for _ in range(2))
    for k in range(6):
        x, y = 1000.0 + 60 * k, 1200.0 + 40 * k
        for bad in ((far, y), (x, far)):
            with pytest.raises(geomag.InvalidInputError, match="within"):
                stream.update(*bad, 1.0)
        value = float(grid.sample(x + 30, y - 20))
        assert repr(stream.update(x, y, value)) == repr(twin.update(x, y, value))


@pytest.mark.parametrize("latitude", [90.5, -4e18, 97.0])
def test_latitudes_end_at_the_poles(degrees, latitude):
    track = geomag.Track([10.01, 10.02], [50.01, min(max(latitude, -1e7), 1e7)], [1.0, 2.0])
    calls = [
        lambda: geomag.match_grid(degrees, track, half_width=0.01),
        lambda: geomag.match_posterior(degrees, track, half_width=0.01, sigma=1.0),
        lambda: geomag.match_contour(degrees, track),
        lambda: geomag.Iema(degrees, sigma=1.0, half_width=0.01).run(track),
    ]
    for call in calls:
        with pytest.raises(geomag.InvalidInputError, match=r"latitude.*within \+-90"):
            call()
    for make in STREAMS.values():
        stream = make(degrees, 0.01)
        with pytest.raises(geomag.InvalidInputError, match=r"latitude.*within \+-90"):
            stream.update(10.0, latitude, 1.0)


@pytest.mark.parametrize("far", FAR)
def test_axes_are_bounded(far):
    with pytest.raises(geomag.InvalidInputError, match="axis"):
        geomag.GridMap(np.zeros((2, 2)), [0.0, far], [0.0, 1.0])


def test_a_far_point_has_no_value(grid, degrees):
    for far in FAR:
        assert np.isnan(grid.sample(far, 100.0))
        assert np.isnan(degrees.sample(far, 50.01))
        assert np.isnan(degrees.gradient(10.01 + 360.0 * 1e6, 50.01)).all()
        with pytest.raises(geomag.InvalidInputError, match="within"):
            geomag.closest_contour_point(grid, far, 100.0, 1.0)


def test_searches_end_at_the_earth(grid):
    track = geomag.Track([1000.0, 1100.0], [1000.0, 1100.0], [1.0, 2.0])
    with pytest.raises(geomag.InvalidInputError, match="half_width x: needed an extent within"):
        geomag.match_grid(grid, track, half_width=1e12, step=1e11)


def test_a_navigator_stops_before_the_pole():
    x, y = np.arange(0.0, 3.0, 0.05), np.arange(87.0, 90.0, 0.05)
    polar = geomag.GridMap(rough(np.random.default_rng(1), len(y), len(x), smooth=4.0), x, y, geographic=True)
    nav = geomag.FieldNavigator(polar, start=(1.0, 89.0), covariance_m2=1e4, reading_sigma=5.0)
    steps = 0
    while nav.position[1] < 89.87:
        nav.step(60.0, 50.0, 0.0)
        steps += 1
    before = repr(nav)
    for _ in range(3):
        with pytest.raises(geomag.InvalidInputError, match="a latitude"):
            nav.step(600.0, 50.0, 0.0)
    assert repr(nav) == before
    assert nav.n_steps == steps > 10


def test_ins_feedback_is_bounded():
    feedback = geomag.InsFeedback(geographic=True)
    feedback.step(0.0, 10.0, 50.0)
    before = repr(feedback.state)
    with pytest.raises(geomag.InvalidInputError, match="latitude"):
        feedback.step(1.0, 10.0, 91.0)
    assert repr(feedback.state) == before


@pytest.mark.parametrize("level", [1e8, -1e300, np.nan, np.inf])
def test_levels_of_harmonic_models_are_bounded(level):
    north, east = (a.ravel() for a in np.meshgrid(*[np.linspace(-5e3, 5e3, 7)] * 2))
    vector = np.stack([-30 * np.sin(north / 1e3), 20 * np.cos(east / 700), 30 * np.cos(north / 1e3)], -1)
    frame = geomag.LocalFrame(50.0, 10.0)
    model = geomag.RectangularHarmonicModel.fit(north, east, 0.0, vector, order=2, frame=frame)
    for name in ("down_m", "height_m"):
        for make in (lambda **o: model.to_map("down", **o), lambda **o: geomag.FieldSensor(model, **o)):
            with pytest.raises(geomag.InvalidInputError, match=name):
                make(**{name: level})
