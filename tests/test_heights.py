"""Heights of tracks and maps: contracts, pickles, what a matcher makes of them."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import geomag


def test_a_track_keeps_its_heights():
    track = geomag.Track([0.0, 1.0, 2.0], [0.0, 0.0, 0.0], [5.0, 6.0, 7.0], height_m=[300.0, 310.0, 320.0])
    assert track.height_m.tolist() == [300.0, 310.0, 320.0]
    assert track[1:].height_m.tolist() == [310.0, 320.0]
    back = pickle.loads(pickle.dumps(track))
    assert back.height_m.tolist() == track.height_m.tolist()
    assert back.values.tolist() == track.values.tolist()
    assert geomag.Track([0.0, 1.0], [0.0, 0.0], [5.0, 6.0], height_m=250).height_m.tolist() == [250.0, 250.0]
    assert geomag.Track([0.0], [0.0], [5.0]).height_m is None


@pytest.mark.parametrize(
    ("height", "error", "match"),
    [
        ([1.0, 2.0, 3.0], geomag.ShapeError, r"track height_m: needed shape \(2,\)"),
        ([1.0, np.nan], geomag.NotFiniteError, r"track height_m\[1\]"),
        ("high", geomag.InvalidInputError, "track height_m"),
    ],
)
def test_bad_track_heights_are_named(height, error, match):
    with pytest.raises(error, match=match):
        geomag.Track([0.0, 1.0], [0.0, 0.0], [5.0, 6.0], height_m=height)


def test_a_map_keeps_its_level_or_drape():
    values = np.arange(12.0).reshape(3, 4)
    x, y = np.arange(4.0) * 100, np.arange(3.0) * 100
    level = geomag.GridMap(values, x, y, height_m=305)
    assert level.height_m == 305.0
    assert pickle.loads(pickle.dumps(level)).height_m == 305.0
    drape = 300.0 + values
    north_up = geomag.GridMap(values[::-1], x, y[::-1], height_m=drape[::-1])
    assert np.array_equal(north_up.height_m, drape)
    assert np.array_equal(north_up.values, values)
    assert np.array_equal(pickle.loads(pickle.dumps(north_up)).height_m, drape)
    assert geomag.GridMap(values, x, y).height_m is None


def test_bad_map_heights_are_named():
    values = np.arange(12.0).reshape(3, 4)
    x, y = np.arange(4.0) * 100, np.arange(3.0) * 100
    with pytest.raises(geomag.ShapeError, match="height_m"):
        geomag.GridMap(values, x, y, height_m=np.zeros((4, 3)))
    with pytest.raises(geomag.NotFiniteError, match="height_m"):
        geomag.GridMap(values, x, y, height_m=np.nan)
    drape = np.full((3, 4), 300.0)
    drape[1, 2] = np.nan
    with pytest.raises(geomag.NotFiniteError, match="height_m"):
        geomag.GridMap(values, x, y, height_m=drape)
    values[1, 2] = np.nan
    assert geomag.GridMap(values, x, y, height_m=drape).holes == 1


def climbing(seed=11):
    """A field that falls with height, its map at 100 m, and a flight 200 to 350 m above it."""
    rng = np.random.default_rng(seed)
    axis = np.arange(0.0, 16_001.0, 100.0)
    waves = [(rng.normal(0, 14), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(700, 8000, 40)]

    def field(x, y, height):
        x, y, height = np.broadcast_arrays(x, y, height)
        return sum(a * np.exp(-k * height) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)

    grid = geomag.GridMap(field(axis, axis[:, None], 0.0), axis, axis, sigma=0.5, height_m=100.0)
    return grid, field


def test_navigate_continues_a_map_to_the_heights_of_the_flight():
    grid, field = climbing()
    n = 400
    time = np.arange(n, dtype=float)
    x, y = 3000 + 25.0 * time, np.full(n, 8000.0)
    height = np.linspace(300.0, 450.0, n)
    readings = field(x, y, height - 100.0)
    options = {"velocity_m_s": np.tile([25.0, 0.0], (n, 1)), "heading_deg": np.full(n, 90.0), "readings": readings}
    told = geomag.navigate(grid, time, x + 120, y - 90, height_m=height, **options)
    untold = geomag.navigate(grid, time, x + 120, y - 90, **options)
    stack = grid.continue_to(geomag.continuation.levels(grid, 300.0, 450.0))
    given = geomag.navigate(stack, time, x + 120, y - 90, height_m=height, **options)
    error = [np.hypot(*flight.error_m(x, y).T)[100:].mean() for flight in (told, untold, given)]
    assert error[0] < 0.5 * error[1]
    assert error[2] == pytest.approx(error[0], rel=0.2)
    one = geomag.navigate(grid, time, x + 120, y - 90, height_m=100.0, **options)
    assert np.array_equal(one.x, untold.x)


def test_a_navigator_refuses_heights_that_its_map_does_not_know():
    grid, _ = climbing()
    bare = geomag.GridMap(np.asarray(grid.values), grid.x, grid.y)
    with pytest.raises(geomag.InvalidInputError, match="map height_m"):
        geomag.navigate(bare, [0.0, 1.0], [5e3, 5e3], [5e3, 5e3], height_m=300.0)
    for some, height, match in ((bare, 300.0, "map height_m"), (grid, 300.0, "stack of levels")):
        with pytest.raises(geomag.InvalidInputError, match=match):
            geomag.Navigator(some).step(0.0, 5e3, 5e3, value=1.0, height_m=height)
    assert geomag.Navigator(grid).step(0.0, 5e3, 5e3, value=1.0, height_m=100.0).x == 5e3
    stack = grid.continue_to([100.0, 300.0])
    with pytest.raises(geomag.InvalidInputError, match="heights of the track"):
        geomag.Navigator(stack).step(0.0, 5e3, 5e3, value=1.0)


@pytest.mark.parametrize("made", ["map", "stack"])
def test_contours_and_sensors_stand_at_the_height_that_they_are_told(made):
    grid, field = climbing()
    source = grid if made == "map" else grid.continue_to([100.0, 300.0, 400.0])
    window = geomag.SlidingContour(
        source, length=25, transform="translation", radius_m=800.0, height_m=300.0, sigma=0.5
    )
    x, y = 4000 + 180.0 * np.arange(40), 6000 + 120.0 * np.arange(40)
    track = geomag.Track(x - 300, y + 200, field(x, y, 200.0), height_m=np.full(40, 302.0))
    fix = window.run(track)[-1]
    assert np.hypot(fix.offset_m[0] - 300, fix.offset_m[1] + 200) < 120
    assert window.update(x[-1], y[-1], 1.0, 305.0).status is not None
    with pytest.raises(geomag.InvalidInputError, match="height_m"):
        window.update(x[-1], y[-1], 1.0, 400.0)
    again = pickle.loads(pickle.dumps(window))
    assert again.count == window.count
    sensor = geomag.FieldSensor(source, height_m=300.0)
    assert sensor.read(8000.0, 8000.0)[0] == pytest.approx(float(field(8000.0, 8000.0, 200.0)), abs=1.0)
    assert pickle.loads(pickle.dumps(sensor)).read(8000.0, 8000.0) == sensor.read(8000.0, 8000.0)
    navigator = geomag.FieldNavigator(source, start=(8e3, 8e3), covariance_m2=1e4, reading_sigma=1.0, height_m=300.0)
    assert navigator.step(1.0, 5.0, 90.0, float(field(8005.0, 8000.0, 200.0))).outcome == "updated"


def test_what_follows_one_level_refuses_a_stack_and_heights_that_are_none():
    grid, _ = climbing()
    stack = grid.continue_to([100.0, 300.0])
    for make in (
        lambda: geomag.SlidingContour(stack, length=20),
        lambda: geomag.FieldSensor(stack),
        lambda: geomag.FieldSensor(grid, height_m=np.nan),
        lambda: geomag.FieldSensor(stack, height_m=900.0),
    ):
        with pytest.raises(geomag.InvalidInputError):
            make()


def test_a_map_keeps_its_height_when_it_gets_its_errors():
    grid, _ = climbing()
    assert geomag.survey.with_line_spacing(grid, 300.0).height_m == 100.0
