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
