"""The main field against official values, and dates of every kind."""

from __future__ import annotations

import csv
import datetime
import gzip
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import geomag
from geomag import mainfield
from geomag.mainfield import MainFieldModel, decimal_year, load
from geomag.reduction import MagneticReduction, match_with_reduction

DATA = Path(os.environ.get("GEOMAG_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
REFERENCE = DATA / "main-field-reference"
UTC = datetime.UTC


def reference(name):
    path = REFERENCE / name
    if not path.exists():
        pytest.skip(f"reference values are not at {path}")
    return path


def table(name):
    path = reference(name)
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        rows = list(csv.DictReader(file))
    return {k: np.array([float(r[k]) for r in rows]) for k in rows[0] if k != "case"}


@pytest.mark.parametrize(
    ("values", "coefficients"),
    [("wmm2025_test_values.csv", "WMM2025.COF"), ("wmmhr2025_test_values.csv", "WMMHR2025.COF.gz")],
)
def test_official_values_of_the_world_magnetic_models(values, coefficients):
    t = table(values)
    model = load("theirs", reference(coefficients))
    north, east, down = model.field(t["longitude"], t["latitude"], 1000 * t["altitude_km"], t["decimal_year"]).T
    for got, wanted in ((north, t["x_nt"]), (east, t["y_nt"]), (down, t["z_nt"])):
        assert np.abs(got - wanted).max() < 0.1
    total = model.total(t["longitude"], t["latitude"], 1000 * t["altitude_km"], t["decimal_year"])
    assert np.abs(total - t["f_nt"]).max() < 0.1
    declination, inclination = model.declination_inclination_deg(
        t["longitude"], t["latitude"], 1000 * t["altitude_km"], t["decimal_year"]
    )
    assert np.abs(declination - t["declination_deg"]).max() < 0.006
    assert np.abs(inclination - t["inclination_deg"]).max() < 0.006


def test_igrf_against_the_calculator():
    t = table("igrf_ncei_calculator_grid.csv.gz")
    wanted = np.column_stack([t["x_north_nt"], t["y_east_nt"], t["z_down_nt"]])
    place = t["longitude"], t["latitude"], 1000 * t["height_km"], t["decimal_year"]
    # At other epochs its provisional coefficients were others than those published since.
    definitive = t["decimal_year"] == 2010.0
    assert definitive.sum() > 1000
    for file in ("IGRF13.shc", "igrf14coeffs.txt"):
        assert np.abs(load(file, reference(file)).field(*place) - wanted)[definitive].max() < 0.1


@pytest.mark.parametrize(
    ("name", "package", "file"),
    [
        ("igrf14", "ppigrf", "igrf14coeffs.txt"),
        ("wmm2025", "wmm", "WMM2025.COF"),
        ("wmmhr2025", "wmmhr", "WMMHR2025.COF.gz"),
    ],
)
def test_installed_coefficients_are_the_published_ones(name, package, file):
    pytest.importorskip(package)
    theirs = load(name, reference(file))
    ours = load(name)
    assert ours.years == theirs.years
    assert ours.degree == theirs.degree
    np.testing.assert_allclose(
        ours.field(10.0, 50.0, 0.0, [2025.0, 2029.5]), theirs.field(10.0, 50.0, 0.0, [2025.0, 2029.5]), atol=0.05
    )


def dipole(name="dipole"):
    g = np.array([[-29_000.0, -1500.0], [-28_900.0, -1400.0]])
    return mainfield.MainField(name, MainFieldModel([2025, 2030], g, np.array([[0, 4500.0], [0, 4400.0]]), degree=1))


DATES = [
    datetime.datetime(2026, 6, 1, tzinfo=UTC),
    datetime.datetime(2026, 6, 1),
    datetime.date(2026, 6, 1),
    datetime.datetime(2026, 6, 1, 2, tzinfo=datetime.timezone(datetime.timedelta(hours=2))),
    np.datetime64("2026-06-01"),
    np.array("2026-06-01T00:00", dtype="datetime64[s]"),
    "2026-06-01",
    "2026-06-01T00:00:00Z",
]


@pytest.mark.parametrize("date", DATES, ids=repr)
def test_every_kind_of_date_is_the_same_date(date):
    model = dipole()
    assert model.total(10, 45, 600, date) == model.total(10, 45, 600, datetime.datetime(2026, 6, 1))
    lon, lat = np.array([10.0, 11.0]), np.array([45.0, 46.0])
    one = MagneticReduction(date, 600.0, model=model).correction(lon, lat, None)
    np.testing.assert_array_equal(one, -model.total(lon, lat, 600.0, datetime.datetime(2026, 6, 1)))


def test_an_aware_date_is_right_in_igrf():
    pytest.importorskip("ppigrf")
    reduction = MagneticReduction(datetime.datetime(2026, 6, 1, tzinfo=UTC), 600.0)
    assert reduction.correction(np.array([10.0]), np.array([45.0]), None)[0] == pytest.approx(-47724.82, abs=0.006)


def test_pandas_dates_with_and_without_a_zone():
    pd = pytest.importorskip("pandas")
    days = pd.date_range("2026-05-01", periods=5, freq="D")
    model = dipole()
    plain = model.total(10, 45, 0, days.to_numpy())
    for given in (days, days.tz_localize("UTC"), pd.Series(days), days.tz_localize("UTC").tz_convert("Asia/Tokyo")):
        np.testing.assert_array_equal(model.total(10, 45, 0, given), plain)


def test_a_day_of_log_in_one_call_is_its_samples():
    model = dipole()
    seconds = np.arange(0, 86_400, 60)
    when = np.datetime64("2026-02-03T00:00:00") + seconds * np.timedelta64(1, "s")
    lon, lat, height = 10 + seconds * 1e-5, 45 - seconds * 1e-5, seconds * 0.01
    day = model.field(lon, lat, height, when)
    assert day.shape == (1440, 3)
    for k in (0, 777, 1439):
        np.testing.assert_array_equal(day[k], model.field(lon[k], lat[k], height[k], when[k]))
    assert np.ptp(model.total(10.0, 45.0, 0.0, when)) > 1e-3


@pytest.mark.parametrize(
    "date",
    [
        datetime.datetime(2031, 1, 1),
        datetime.datetime(2030, 1, 1, 0, 0, 1),
        datetime.datetime(2024, 12, 31, 23, 59, 59, tzinfo=UTC),
        2030.01,
        [2026.0, 2024.9],
        np.array(["2026-01-01", "2035-01-01"], dtype="datetime64[D]"),
    ],
    ids=repr,
)
def test_dates_beyond_the_years_are_refused(date):
    with pytest.raises(
        geomag.InvalidInputError, match=r"date.*needed a date within the years of dipole, 2025 to 2030, got"
    ):
        dipole().total(10.0, 45.0, 0.0, date)


@pytest.mark.parametrize(
    "date", ["yesterday", None, np.datetime64("NaT"), [datetime.datetime(2026, 1, 1), 3.5], np.nan, 1 + 2j], ids=repr
)
def test_what_is_no_date_is_refused(date):
    with pytest.raises(geomag.InvalidInputError, match="date"):
        dipole().total(10.0, 45.0, 0.0, date)


def test_decimal_years():
    assert decimal_year("2024-07-02") == pytest.approx(2024.5, abs=1e-12)
    assert decimal_year(2024.25) == 2024.25


def test_files_that_are_none(tmp_path):
    for name, text in (
        ("a.shc", "1 13 27 2 1 1900.0 2030.0\n1900.0 1905.0\n"),
        (
            "b.COF",
            "    2025.0            WMM-2025        11/13/2024\n  1  0  -29351.8       0.0       12.0        0.0\n",
        ),
        ("c.txt", "not coefficients"),
        ("d.txt", ""),
        ("e.gz", "\x1f\x8b"),
    ):
        path = tmp_path / name
        path.write_bytes(text.encode("latin-1"))
        with pytest.raises(geomag.ReadError, match=name):
            load("x", path)
    with pytest.raises(geomag.MissingFileError):
        load("x", tmp_path / "none.shc")
    with pytest.raises(geomag.InvalidInputError, match="igrf14, wmm2025, wmmhr2025"):
        load("igrf99")


def test_models_pickle_and_compare():
    model = dipole()
    back = pickle.loads(pickle.dumps(model))
    assert back == model
    np.testing.assert_array_equal(back.field(1, 2, 3, 2026.0), model.field(1, 2, 3, 2026.0))


def test_the_main_field_is_taken_off_again_at_matched_positions():
    model = dipole()
    lon, lat = np.linspace(10, 10.6, 121), np.linspace(45, 45.6, 121)
    anomaly = 60 * np.sin(40 * lon) * np.cos(50 * lat)[:, None] + 25 * np.sin(61 * lon + 23 * lat[:, None])
    grid = geomag.GridMap(anomaly, lon, lat, geographic=True)
    tx, ty = 10.2 + 0.006 * np.arange(30), 45.2 + 0.005 * np.arange(30)
    when = np.datetime64("2026-03-01T10:00") + 60 * np.arange(30) * np.timedelta64(1, "s")
    reduction = MagneticReduction(when, 800.0, model=model)
    raw = grid.sample(tx, ty) + model.total(tx, ty, 800.0, when)
    found = match_with_reduction(
        grid,
        tx - 0.006,
        ty + 0.005,
        raw,
        reduction,
        transform="translation",
        starts="grid",
        refine=True,
        sigma=2.0,
        offset_sigma_m=800.0,
        max_passes=60,
        tolerance_m=0.1,
    )
    assert found.converged
    once = np.hypot(found.first.x - tx[-1], found.first.y - ty[-1])
    again = np.hypot(found.fix.x - tx[-1], found.fix.y - ty[-1])
    assert again < 0.3 * once
