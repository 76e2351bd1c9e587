"""What follows from survey lines: one turn of longitudes, stretches without gaps, spacing, folds, short windows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.calibration import calibrate_lines
from geomag.survey import ErrorModel, Lines, folds_of, line_spacing_m, map_from_lines, smooth_lines
from geomag.survey._lines import legs_m
from geomag.survey._survey import windows_of


def parallel(lines=12, spacing_m=500.0, length_m=12_000.0, step_m=50.0):
    """Lines from west to east in metres, as columns x, y, values, line."""
    along = np.arange(0.0, length_m + 1, step_m)
    x, y = np.tile(along, lines), np.repeat(spacing_m * np.arange(lines), along.size)
    return x, y, 40 * np.sin(x / 700) * np.cos(y / 900), np.repeat(np.arange(lines), along.size)


def over_longitude(middle_deg, low_deg=None):
    """The same lines in degrees at 10 N about a longitude, written from `low_deg` up."""
    x, y, values, line = parallel()
    longitude = middle_deg + (x - 6000) / 109_639.0
    if low_deg is not None:
        longitude = np.mod(longitude - low_deg, 360.0) + low_deg
    return Lines(longitude, 10 + y / 110_600.0, values, line, geographic=True)


@pytest.mark.parametrize(("middle", "low"), [(180.0, -180.0), (0.0, 0.0), (-180.0, -180.0), (360.0, 0.0)])
def test_lines_over_the_end_of_a_turn_are_those_within_it(middle, low):
    cut, whole = over_longitude(middle, low), over_longitude(middle)
    assert np.ptp(cut.x) == pytest.approx(np.ptp(whole.x), abs=1e-9)
    assert line_spacing_m(cut) == pytest.approx(line_spacing_m(whole), rel=1e-6)
    assert 400 < line_spacing_m(cut) < 550
    first = cut.split()[0]
    assert legs_m(first.x, first.y, first.scale_m()).sum() == pytest.approx(12_000, abs=10)
    assert [one.x.size for one in cut.survey.pieces] == [241] * 12
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.15, 500.0, 0, 0.0)
    maps = [map_from_lines(some, spacing=0.001, model=model) for some in (cut, whole)]
    turns = np.round((maps[0].x[0] - maps[1].x[0]) / 360)
    assert maps[0].shape == maps[1].shape
    np.testing.assert_allclose(maps[0].x, maps[1].x + 360 * turns, atol=1e-9)


def test_longitudes_on_several_turns_are_put_on_one():
    x = np.array([179.0, -179.5, 181.5, -541.0, 539.5])
    lines = Lines(x, np.zeros(5), np.zeros(5), np.zeros(5), geographic=True)
    np.testing.assert_allclose(lines.x, [179.0, 180.5, 181.5, 179.0, 179.5])
    assert np.array_equal(Lines(x, np.zeros(5), np.zeros(5), np.zeros(5)).x, x)
    whole = np.linspace(0.0, 359.0, 360)
    assert np.array_equal(Lines(whole, 0 * whole, 0 * whole, 0 * whole, geographic=True).x, whole)


def test_a_file_of_lines_over_the_date_line():
    pytest.importorskip("pandas")
    lines = geomag.survey.read_lines(Path(__file__).parent / "cases" / "lines-date-line.csv")
    first = lines.split()[0]
    assert legs_m(first.x, first.y, first.scale_m()).sum() == pytest.approx(12_000, abs=10)
    assert 400 < line_spacing_m(lines) < 550
    assert len(lines.survey.pieces) == 12


def test_longitudes_in_metres_are_refused():
    with pytest.raises(geomag.InvalidInputError, match="are the lines in metres"):
        Lines([5e5, 6e5], [1.0, 2.0], [1.0, 2.0], [0, 0], geographic=True)


def test_no_reading_is_made_up_in_a_gap():
    x, y, values, line = parallel()
    gap = (x > 5000) & (x < 8000) & (line % 3 == 0)
    lines = Lines(x[~gap], y[~gap], values[~gap], line[~gap])
    # The length that was flown counts, not what is between.
    assert line_spacing_m(lines) == pytest.approx(line_spacing_m(Lines(x, y, values, line)), rel=0.15)
    assert len(lines.survey.pieces) == 16
    for length, overlap in ((20, 0.0), (40, 0.5), (10, 0.9)):
        windows = windows_of(lines.survey.pieces, 100.0, length, overlap)
        assert windows
        for wx, wy, _ in windows:
            if round(wy[0] / 500) % 3 == 0:
                assert not np.any((wx > 5000) & (wx < 8000))


def test_a_label_flown_twice_is_two_stretches():
    x, y, values, line = parallel()
    again = line == 4
    # Once more in the same direction, with a level of its own, and once there and back.
    ahead = Lines(*(np.concatenate([a, a[again]]) for a in (x, y)), np.concatenate([values, values[again] + 30]),
                  np.concatenate([line, line[again]]))  # fmt: skip
    back = Lines(*(np.concatenate([a, a[again][::-1]]) for a in (x, y)), np.concatenate([values, values[again][::-1] + 30]),
                 np.concatenate([line, line[again]]))  # fmt: skip
    for lines in (ahead, back):
        pieces = lines.survey.pieces
        assert len(pieces) == 13
        assert max(np.ptp(one.values) for one in pieces) < 81
        for wx, _, _ in windows_of(pieces, 100.0, 40, 0.5):
            assert np.all(np.diff(wx) > 0) or np.all(np.diff(wx) < 0)
        # Both flights are left out together.
        fold = folds_of(pieces, 3)
        assert len({int(f) for f, one in zip(fold, pieces, strict=True) if one.line[0] == 4}) == 1


def test_lines_between_contours_keep_their_long_legs():
    rng = np.random.default_rng(2)
    x, y, values, line = parallel(length_m=60_000.0)
    # Points where contours are crossed: a tenth of them, at random.
    kept = rng.random(x.size) < 0.05
    lines = Lines(x[kept], y[kept], values[kept], line[kept])
    assert lines.survey.gap_m > 2000
    assert len(lines.survey.pieces) <= 16


def test_averages_do_not_reach_over_a_gap():
    x = np.concatenate([np.arange(0.0, 5000, 50), np.arange(20_000.0, 25_000, 50)])
    other = np.arange(0.0, 25_000, 50)
    lines = Lines(np.concatenate([x, other]), np.repeat([0.0, 500.0], [x.size, other.size]),
                  np.concatenate([np.repeat([0.0, 100.0], 100), 0 * other]), np.repeat([0, 1], [x.size, other.size]))  # fmt: skip
    assert set(np.unique(smooth_lines(lines, 40_000.0).values)) == {0.0, 100.0}


def test_heights_unit_and_name_go_with_the_lines(tmp_path):
    x, y, values, line = parallel()
    lines = Lines(x, y, values, line, False, height_m=80.0, unit="nT", name="anomaly")
    assert lines.height_m.shape == x.shape
    some = lines.split()[3]
    assert np.all(some.height_m == 80.0)
    assert (some.unit, some.name) == ("nT", "anomaly")
    joined = Lines.joined(lines.split())
    assert np.array_equal(joined.height_m, lines.height_m)
    model = ErrorModel(0.01, 0.1, 0.1, 0.1, 1.0, 0.15, 500.0, 0, 0.0)
    grid = map_from_lines(lines, spacing=100.0, model=model)
    assert (grid.units, grid.name) == ("nT", "anomaly")
    with pytest.raises(geomag.ShapeError, match="height_m"):
        Lines(x, y, values, line, height_m=[1.0, 2.0])
    with pytest.raises(geomag.InvalidInputError, match=r"height_m\[1\]"):
        Lines([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0, 0], height_m=[1.0, np.nan])
    pytest.importorskip("pandas")
    path = tmp_path / "lines.csv"
    path.write_text("line,longitude,latitude,f,h\n1,10.0,45.0,5,80\n1,10.1,45.0,6,\n1,10.2,45.0,7,82\n")
    read = geomag.survey.read_lines(path, value="f", height="h", unit="nT")
    assert list(read.height_m) == [80.0, 82.0]
    assert geomag.survey.read_lines(path, value="f").x.size == 3
    with pytest.raises(geomag.UnknownVariableError, match="'z'"):
        geomag.survey.read_lines(path, value="f", height="z")


@pytest.fixture(scope="module")
def rough():
    crust = synthetic.Crust(waves=128, longest_m=8000.0, height_m=150.0, shortest_m=300.0, dipoles=0, texture_rms=60)
    return synthetic.survey(crust.draw((0, 0, 12_000, 9000), seed=3), line_spacing_m=300.0, sigma=0.5, seed=3)


def test_windows_of_fewer_than_twenty_samples_are_calibrated(rough):
    options = {"half_width_m": 600.0, "tolerance_m": 150.0, "spacing_m": 150.0, "most": 60}
    options["model"] = ErrorModel(0.5, 1.0, 0.1, 0.1, 1.0, 0.05, 450.0, 0, 0.0)
    result = calibrate_lines(rough, samples=12, **options)
    assert result.risk.size == 60
    assert np.all(result.samples == 12)
    assert np.median(result.error_m) < 150
    with pytest.raises(geomag.TooFewSamplesError, match="200 samples"):
        calibrate_lines(rough, samples=200, **options)
