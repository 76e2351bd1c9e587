"""Flights along survey lines: real readings where they were made, none anywhere else."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.flights import FieldSensor, line_flights, steps_m, velocity_along
from geomag.survey import Lines, folds_of

FIELD = synthetic.Crust().draw((0, 0, 30_000, 20_000), seed=4)


@pytest.fixture(scope="module")
def lines():
    return synthetic.survey(FIELD, line_spacing_m=500.0, tie_spacing_m=5_000.0, wander_m=20.0, seed=2)


def holed(lines, west, east):
    """The lines without their readings between two eastings."""
    keep = (lines.x < west) | (lines.x > east)
    return Lines(lines.x[keep], lines.y[keep], lines.values[keep], lines.line[keep], lines.geographic)


def test_readings_are_the_survey_s_own_at_their_own_places(lines):
    known = {(x, y): v for x, y, v in zip(lines.x, lines.y, lines.values, strict=True)}
    for flight in line_flights(lines, hours=0.5):
        read = np.isfinite(flight.values)
        assert all(
            known[x, y] == v for x, y, v in zip(flight.x[read], flight.y[read], flight.values[read], strict=True)
        )
        away = np.hypot(*steps_m(flight.x, flight.y, geographic=False).T)
        assert away.max() <= 151.0
        assert np.all(np.diff(flight.time_s) > 0)
        assert flight.time_s[-1] == pytest.approx(1800.0, abs=3.0)


def test_gaps_have_no_readings_and_are_flown_straight(lines):
    with_hole = holed(lines, 12_000, 15_000)
    flight = line_flights(with_hole, hours=0.5)[0]
    inside = (flight.x > 12_010) & (flight.x < 14_990)
    assert inside.sum() > 100
    assert np.isnan(flight.values[inside]).all()
    assert flight.longest_outage_s == pytest.approx(3_000 / 70, rel=0.1)


def test_a_gap_too_long_to_fly_ends_a_chain(lines):
    with_hole = holed(lines, 8_000, 22_000)
    flights = line_flights(with_hole, hours=0.4, longest_transit_s=60.0, most=50)
    for flight in flights:
        assert flight.x.max() <= 8_000 or flight.x.min() >= 22_000


def test_ties_are_not_flown_and_no_line_twice(lines):
    flights = line_flights(lines, hours=1.0, most=50)
    flown = [label for f in flights for label in f.lines]
    assert max(flown) < 41  # the ties come after the 41 lines
    whole = [label for f in flights for label in f.lines[1:-1]]
    assert len(whole) == len(set(whole))


def test_as_many_as_there_are_lines_for(lines):
    assert len(line_flights(lines, hours=1.0, most=2)) == 2
    with pytest.raises(geomag.TooFewSamplesError, match=r"needed a chain of lines of 40 h at 70 m/s, got 4\.\d+ h"):
        line_flights(lines, hours=40.0)
    with pytest.raises(geomag.InvalidInputError, match="hours: needed a number > 0"):
        line_flights(lines, hours=0.0)


def test_turns_take_time():
    t = np.arange(0.0, 101.0)
    east = np.minimum(t, 50) * 70.0
    north = np.maximum(t - 50, 0) * 70.0
    v = velocity_along(t, east, north, geographic=False)
    assert v[0] == pytest.approx([70, 0])
    assert v[50] == pytest.approx([35, 35])
    assert v[-1] == pytest.approx([0, 70])
    assert np.abs(np.diff(v, axis=0)).max() <= 7.0 + 1e-9


def test_a_sensor_adds_what_it_says(lines):
    flight = line_flights(lines, hours=1.0)[0]
    sensor = FieldSensor(outlier_rate=0.0)
    draws = np.array([sensor.draw(flight.time_s, np.random.default_rng(k)) for k in range(200)])
    assert np.ptp(draws.mean(axis=1)) < 2 * (50 + 10)
    assert np.abs(draws.mean(axis=1)).max() > 45
    # What is left beside a smooth change is white and of half a unit.
    assert np.std(np.diff(draws, 2)) / np.sqrt(6) == pytest.approx(0.5, rel=0.05)
    assert np.isnan(flight.with_sensor(np.random.default_rng(0), sensor)).sum() == np.isnan(flight.values).sum()


def test_the_lines_of_osborne_fly_as_they_were_specified(data_file):
    pytest.importorskip("pandas", reason="needs the extra 'io'")
    lines = geomag.survey.read_lines(data_file("osborne-aeromag/osborne_lines.csv.gz"))
    pieces = lines.split()
    left = [p for p, f in zip(pieces, folds_of(pieces, 3), strict=True) if f == 0]
    some = Lines(*(np.concatenate([getattr(p, a) for p in left]) for a in ("x", "y", "values", "line")), True)
    flights = line_flights(some)
    assert len(flights) == 3
    assert all(f.reading_share > 0.9 and f.longest_outage_s < 250 for f in flights)


def test_what_goes_wrong_does_so_when_and_as_asked(lines):
    from geomag.disturbances import jammed, outage, outliers, stuck

    flight = line_flights(lines, hours=0.5)[0]
    rng = np.random.default_rng(1)
    since = flight.time_s - flight.time_s[0]
    inside = (since >= 600) & (since < 700)
    silent = outage(600, 100)(flight, None, flight.values, rng)
    assert np.isnan(silent[inside]).all()
    np.testing.assert_array_equal(silent[~inside], flight.values[~inside])
    still = stuck(600, 100)(flight, None, flight.values, rng)
    assert np.unique(still[inside & np.isfinite(still)]).size == 1
    noisy = jammed(600, 100, 200.0)(flight, None, flight.values, rng) - flight.values
    assert np.nanstd(noisy[inside]) == pytest.approx(200.0, rel=0.3)
    assert np.nanmax(np.abs(noisy[~inside])) == 0.0
    wrong = outliers(0.05, 100.0)(flight, None, flight.values, rng) != flight.values
    assert np.mean(wrong[np.isfinite(flight.values)]) == pytest.approx(0.05, abs=0.03)
