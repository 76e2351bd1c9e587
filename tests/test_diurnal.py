"""A base station's record: read, taken off, and what is left of it told."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

import geomag
from geomag.diurnal import BaseRecord, DiurnalReduction, read_iaga2002

DAY = np.datetime64("2026-03-01T00:00") + np.arange(2880) * np.timedelta64(60, "s")
HOURS = np.arange(2880) / 60.0


def daily(longitude):
    """A regular variation, by local time, nT."""
    local = (HOURS + longitude / 15.0) % 24.0
    return 20.0 * np.cos(2 * np.pi * (local - 12.0) / 24.0) + 6.0 * np.cos(4 * np.pi * (local - 12.0) / 24.0)


def pulsations(seed=1):
    """What is everywhere at once: waves of ten to thirty minutes, nT."""
    random = np.random.default_rng(seed)
    periods, phases = random.uniform(10, 30, 5), random.uniform(0, 6.28, 5)
    return 2.0 * np.sin(2 * np.pi * np.arange(2880)[:, None] / periods + phases).sum(axis=1)


def base(longitude=10.0, **options):
    return BaseRecord(DAY, 48_000.0 + daily(longitude) + pulsations(), longitude, 47.0, level_nt=48_000.0, **options)


def test_local_time_and_universal_time():
    """At 25 E the regular part comes an hour earlier, what is everywhere at once does not."""
    log = DAY[300:1500:7]
    truth = (daily(25.0) + pulsations())[300:1500:7]
    found = base().variation(log, 25.0)
    assert np.std(found - truth) < 0.7
    assert np.std(base().variation(log, 10.0) - truth) > 3.0


def test_at_the_base_itself_nothing_is_left():
    off = base().remove(DAY[100:900], 10.0, 47.0, 30.0 + (daily(10.0) + pulsations())[100:900])
    np.testing.assert_allclose(off.values, 30.0, atol=1e-9)
    assert off.sigma_nt < 1e-9


def test_the_rest_grows_with_distance_and_is_of_the_right_size():
    far = BaseRecord(DAY, 48_500.0 + daily(22.0) + 0.6 * pulsations() + 0.8 * pulsations(5), 22.0, 47.0)
    near = base()
    sigma, tau = near.residual(far)
    assert 1.0 < sigma < 5.0
    assert 60.0 <= tau < 3600.0
    log = DAY[300:1500:7]
    little, much = (near.remove(log, lon, 47.0, np.zeros(log.size)).sigma_nt for lon in (10.5, 22.0))
    assert 0 < little < 1.0 < much
    assert 0.3 * sigma < much < 3 * sigma


def test_the_rest_as_drift_and_as_walk():
    off = base().remove(DAY[300:1500:7], 22.0, 47.0, np.zeros(len(DAY[300:1500:7])))
    # Over a short time both say the same, over a long one the drift ends at the difference of two independent values.
    assert off.drift_nt(1.0) == pytest.approx(off.walk_nt_sqrt_s(), rel=0.01)
    assert off.drift_nt(1e6) == pytest.approx(np.sqrt(2) * off.sigma_nt)


def test_gaps_and_ends_are_refused():
    values = 48_000.0 + daily(10.0)
    values[600:640] = np.nan
    record = BaseRecord(DAY, values, 10.0, 47.0)
    with pytest.raises(geomag.InvalidInputError, match="no gap of the base record over 600 s"):
        record.variation(DAY[[500, 620]], 10.0)
    assert np.isfinite(BaseRecord(DAY, values, 10.0, 47.0, max_gap_s=3600.0).variation(DAY[620], 10.0))
    with pytest.raises(geomag.InvalidInputError, match="within the base record, 2026-03-01T00:00:00 to"):
        record.variation(np.datetime64("2026-02-28T12:00"), 10.0)
    with pytest.raises(geomag.InvalidInputError, match="local time"):
        record.variation(DAY[-1], 40.0)
    with pytest.raises(geomag.InvalidInputError, match="plain numbers"):
        record.variation(2026.5, 10.0)


def test_bad_records_are_refused():
    for time, values in ((DAY[::-1], daily(0.0)), (DAY[:5], daily(0.0)), (DAY, np.full(2880, np.nan))):
        with pytest.raises(geomag.GeomagError, match="base record"):
            BaseRecord(time, values, 10.0, 47.0)
    with pytest.raises(geomag.InvalidInputError, match="place in degrees"):
        BaseRecord(DAY, daily(0.0), 10.0, 470.0)


def test_dates_with_a_zone():
    zone = datetime.timezone(datetime.timedelta(hours=3))
    aware = datetime.datetime(2026, 3, 1, 9, tzinfo=zone)
    assert base().variation(aware, 10.0) == base().variation(np.datetime64("2026-03-01T06:00"), 10.0)


def iaga(reported, rows, **head):
    lines = {
        "Format": "IAGA-2002",
        "Source of Data": "made up",
        "Station Name": "Somewhere",
        "IAGA CODE": "SMW",
        "Geodetic Latitude": "47.000",
        "Geodetic Longitude": "350.000",
        "Elevation": "546",
        "Reported": reported,
    } | head
    text = "".join(f" {k:<23}{v:<45}|\n" for k, v in lines.items())
    text += f" # {'a remark':<66}|\n"
    text += f"{'DATE       TIME         DOY     ' + ''.join(f'SMW{c:<7}' for c in reported):<69}|\n"
    return text + "".join(rows)


def rows(values, seconds=60):
    out = []
    for k, row in enumerate(values):
        when = datetime.datetime(2026, 3, 1) + datetime.timedelta(seconds=seconds * k)
        out.append(f"{when:%Y-%m-%d %H:%M:%S}.000 060   " + "".join(f"{v:10.2f}" for v in row) + "\n")
    return out


def test_iaga_2002(tmp_path):
    path = tmp_path / "smw20260301vmin.min"
    path.write_text(iaga("XYZF", rows([(3.0, 4.0, 12.0, 13.5), (99999.0, 4.0, 12.0, 13.4), (6.0, 8.0, 24.0, 88888.0)])))
    record = read_iaga2002(path)
    assert (record.longitude, record.latitude, record.height_m) == (-10.0, 47.0, 546.0)
    assert record.header["IAGA CODE"] == "SMW"
    np.testing.assert_allclose(record.total(), [13.0, 13.4, 26.0])
    assert record.time[1] == np.datetime64("2026-03-01T00:01")
    assert record.base().longitude == -10.0
    path.write_text(iaga("HDZF", rows([(3.0, 500.0, 4.0, 88888.0)] * 2)))
    np.testing.assert_allclose(read_iaga2002(path).total(), 5.0)
    path.write_text(iaga("DIF", rows([(1.0, 500.0, 48.5)] * 2)))
    np.testing.assert_allclose(read_iaga2002(path).total(), 48.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no head\n", "line 1"),
        (iaga("XYZF", []), "lines of values"),
        (iaga("XYZF", ["2026-03-01 00:00:00.000 060   1.0 2.0\n"]), "needed 4 values"),
        (iaga("XYZF", ["yesterday\n"]), "line 11"),
        (iaga("XYZF", rows([(1.0, 2.0, 3.0, 4.0)] * 2, seconds=0)), "times that rise"),
        (iaga("XYZF", rows([(1.0, 2.0, 3.0, 4.0)]), **{"Geodetic Latitude": "north"}), "Geodetic Latitude"),
    ],
)
def test_files_that_are_not_iaga_2002(tmp_path, text, message):
    path = tmp_path / "bad.min"
    path.write_text(text)
    with pytest.raises(geomag.ReadError, match=message):
        read_iaga2002(path)
    with pytest.raises(geomag.MissingFileError):
        read_iaga2002(tmp_path / "none.min")


def test_as_a_reduction():
    lon = np.full(5, 12.0)
    log = DAY[600:605]
    correction = DiurnalReduction(base(), log).correction(lon, lon, None)
    np.testing.assert_array_equal(correction, -base().variation(log, lon))
