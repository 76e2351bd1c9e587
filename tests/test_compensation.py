"""The vehicle's own field: terms and fit against MagNav.jl's fixtures, and over real crust."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import geomag
from geomag import compensation, synthetic

pytest.importorskip("scipy")

DATA = Path(os.environ.get("GEOMAG_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


@pytest.fixture(scope="module")
def fixture():
    path = DATA / "magnav-fixtures" / "test_data_TL.mat"
    if not path.exists():
        pytest.skip(f"reference values are not at {path}")
    import scipy.io

    data = scipy.io.loadmat(path)["TL_data"][0, 0]
    values = {name: data[name].squeeze() for name in data.dtype.names}
    return values | {"field": np.column_stack([values[f"flux_a_{a}"] for a in "xyz"])}


def test_terms_are_those_of_the_peer(fixture):
    np.testing.assert_allclose(compensation.terms(fixture["field"]), fixture["A_a"], rtol=0, atol=1e-12)


def test_coefficients_are_those_of_the_peer(fixture):
    found = compensation.solve(fixture["A_a_f_t"], fixture["mag_1_uc_f_t"], 1e-3)
    np.testing.assert_allclose(found, fixture["TL_a_1"], rtol=0, atol=1e-9)


def test_the_compensated_signal_is_the_peers_with_a_band_pass_of_ones_own(fixture):
    # The peer's unit of time is the sample.
    time = np.arange(1000.0)
    found = compensation.fit(time, fixture["mag_1_uc"], fixture["field"], band_hz=(0.01, 0.09), ridge=1e-3, trim_s=20)
    left = found.apply(time, fixture["mag_1_uc"], fixture["field"]) - fixture["mag_1_c"]
    # A constant is no part of the fit.
    assert np.abs(left - left.mean()).max() < 0.1
    chosen = compensation.fit(time, fixture["mag_1_uc"], fixture["field"], band_hz=(0.01, 0.09), trim_s=20)
    own = chosen.interference(time, fixture["field"])
    # The recipe that this replaces removed something with a correlation of -0.90.
    assert np.corrcoef(own, fixture["mag_1_comp"])[0, 1] > 0.999


def continued_upwards(grid, height_m):
    """A map without holes at a height above its own, mirrored at its edges."""
    values = grid.values.astype(float)
    (rows, columns), (east, north) = values.shape, grid.spacing_m
    padded = np.pad(values - values.mean(), ((rows, rows), (columns, columns)), mode="reflect")
    k = 2 * np.pi * np.hypot(np.fft.rfftfreq(3 * columns, east)[None, :], np.fft.fftfreq(3 * rows, north)[:, None])
    up = np.fft.irfft2(np.fft.rfft2(padded) * np.exp(-k * height_m), padded.shape)
    up = up[rows : 2 * rows, columns : 2 * columns] + values.mean()
    return geomag.GridMap(up, grid.x, grid.y, geographic=True)


def crust(survey):
    pytest.importorskip("netCDF4")
    if survey == "kansas":
        path, window, height = DATA / "namad-kansas" / "namad_kansas.nc", (slice(None), slice(None)), 0.0
    else:
        path = DATA / "osborne-aeromag" / "osborne_grid_from_shared_lines.nc"
        window, height = (slice(480, 700), slice(120, 360)), 300.0
    if not path.exists():
        pytest.skip(f"the map is not at {path}")
    grid = geomag.read_grid(path)
    part = geomag.GridMap(grid.values[window], grid.x[window[1]], grid.y[window[0]], geographic=True)
    assert not part.holes
    part = continued_upwards(part, height) if height else part
    east, north = part.metres_per_unit(float(part.y.mean()))
    return lambda x, y: part.sample(part.x[0] + x / east, part.y[0] + y / north, interpolation="bicubic")


@pytest.mark.parametrize("survey", ["osborne", "kansas"])
@pytest.mark.parametrize("size", [85.0, 300.0, 1000.0])
def test_a_calibration_box_over_real_crust(survey, size):
    anomaly = crust(survey)
    for seed in range(3):
        flight = synthetic.calibration_box(
            size, seed=seed, crust=anomaly, start_m=(1500.0 + 800.0 * seed, 2000.0 + 500.0 * seed)
        )
        found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
        quiet = found.apply(flight.time_s, flight.reading_nt, flight.field_nt)
        wrong = quiet - flight.clean_nt
        assert np.std(wrong) < 0.02 * np.std(flight.interference_nt)
        # What the crust makes it take away: against the same flight without a crust.
        calm = synthetic.calibration_box(size, seed=seed)
        other = compensation.fit(calm.time_s, calm.reading_nt, calm.field_nt)
        taken = np.std(quiet - other.apply(flight.time_s, flight.reading_nt, flight.field_nt))
        assert taken < 0.05 * np.std(flight.clean_nt)
        told = found.leftover(flight.time_s, flight.field_nt, flight.heading_deg)
        assert np.sqrt(np.mean(told.sigma_nt**2)) > 0.15 * np.std(wrong)


@pytest.mark.parametrize("turn_deg", [0.0, 60.0])
def test_tracks_fix_as_without_interference(turn_deg):
    """The vehicle calibrated over the same survey; tracks at its height, straight and with a turn."""
    anomaly = crust("osborne")
    axis = np.arange(0.0, 11_500.0, 60.0)
    x, y = np.meshgrid(axis, axis)
    grid = geomag.GridMap(anomaly(x, y), axis, axis, sigma=0.0)
    box = synthetic.calibration_box(300.0, seed=1, crust=anomaly, start_m=(3000.0, 3000.0))
    found = compensation.fit(box.time_s, box.reading_nt, box.field_nt)
    random = np.random.default_rng(8)
    t = np.arange(0.0, 80.0, 0.1)
    tracks: dict[str, list[geomag.Track]] = {"clean": [], "raw": [], "compensated": []}
    for k in range(10):
        course = random.uniform(0, 2 * np.pi) + np.radians(turn_deg) / (1 + np.exp(-(t - 40) / 3))
        px, py = np.cumsum(np.sin(course)) * 6.0, np.cumsum(np.cos(course)) * 6.0
        px, py = px - px.mean() + random.uniform(4000, 7500), py - py.mean() + random.uniform(4000, 7500)
        heading, pitch, roll = synthetic.attitude_along(t, px, py, seed=k)
        field = compensation.field_in_vehicle(
            [24_600.0, 4_300.0, 43_300.0], heading_deg=heading, pitch_deg=pitch, roll_deg=roll
        )
        clean = anomaly(px, py) + random.normal(0, 0.5, t.size)
        raw = clean + box.vehicle.on(t, field)
        quiet = found.apply(t, raw, field + random.normal(0, 2.0, field.shape))
        every = slice(0, None, 20)
        for name, readings in (("clean", clean), ("raw", raw), ("compensated", quiet)):
            tracks[name].append(geomag.Track(px[every] + 150, py[every] - 100, readings[every]))
    fixed = {
        name: np.array(
            [f.ok for f in geomag.match_posterior_many(grid, t, half_width=500.0, sigma=1.0, tolerance_m=60.0)]
        )
        for name, t in tracks.items()
    }
    assert fixed["clean"].sum() >= 9
    assert fixed["compensated"].sum() >= 0.9 * fixed["clean"].sum()
    assert fixed["raw"].sum() <= 2


def test_known_crust_is_no_interference():
    rough = synthetic.Crust(texture_rms=80.0, height_m=80.0, shortest_m=160.0).draw((0, 0, 12_000, 12_000), seed=4)
    grid = rough.grid(40.0, units="nT")
    flight = synthetic.calibration_box(85.0, seed=2, crust=grid.sample, start_m=(2000.0, 2000.0))
    left = []
    for expected in (None, flight.clean_nt):
        found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt, expected_nt=expected)
        left.append(np.std(found.interference(flight.time_s, flight.field_nt) - flight.interference_nt))
    assert left[1] < 0.3 * left[0]
    assert left[1] < 0.5


def test_the_covariance_is_honest():
    """Errors of the terms that the flight determines, against the covariance that is told."""
    vehicle = synthetic.VehicleField.draw(200.0, seed=9)
    scaled = []
    for seed in range(12):
        flight = synthetic.calibration_box(vehicle, seed=seed, noise_nt=2.0, vector_noise_nt=0.0)
        found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt, ridge=1e-6)
        scaled.append((found.coefficients - vehicle.coefficients)[:2] / np.sqrt(np.diag(found.covariance))[:2])
    assert 0.4 < np.sqrt(np.mean(np.square(scaled))) < 1.8


def test_bad_samples_gaps_and_saturation():
    flight = synthetic.calibration_box(300.0, seed=6)
    time, reading, field = flight.time_s, flight.reading_nt.copy(), flight.field_nt.copy()
    random = np.random.default_rng(1)
    reading[random.integers(0, 3300, 30)] = np.nan
    field[random.integers(0, 3300, 10), 1] = np.nan
    reading[700:704] = 100_000.0
    keep = np.ones(3300, dtype=bool)
    keep[random.integers(0, 3300, 40)] = False
    keep[1500:1600] = False
    time, reading, field = time[keep], reading[keep], field[keep]
    found = compensation.fit(time, reading, field, saturation_nt=(20_000.0, 99_999.0))
    quiet = found.apply(time, reading, field)
    bad = ~np.isfinite(reading) | ~np.isfinite(field).all(axis=1)
    assert np.array_equal(~np.isfinite(quiet), bad)
    good = ~bad & (reading < 99_999)
    wrong = (quiet - flight.clean_nt[keep])[good]
    assert np.std(wrong) < 0.02 * 300.0
    whole = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
    assert found.samples < whole.samples - 100


def test_attitude_instead_of_a_vector_magnetometer():
    flight = synthetic.calibration_box(300.0, seed=7, vector_noise_nt=0.0, main_ned_nt=(20_000.0, 1_000.0, 45_000.0))
    angles = {"heading_deg": flight.heading_deg, "pitch_deg": flight.pitch_deg, "roll_deg": flight.roll_deg}
    field = compensation.field_in_vehicle([20_000.0, 1_000.0, 45_000.0], **angles)
    np.testing.assert_allclose(field, flight.field_nt, atol=1e-6)
    h, p, r = (np.radians(a) / 2 for a in angles.values())
    w = np.cos(h) * np.cos(p) * np.cos(r) + np.sin(h) * np.sin(p) * np.sin(r)
    x = np.cos(h) * np.cos(p) * np.sin(r) - np.sin(h) * np.sin(p) * np.cos(r)
    y = np.cos(h) * np.sin(p) * np.cos(r) + np.sin(h) * np.cos(p) * np.sin(r)
    z = np.sin(h) * np.cos(p) * np.cos(r) - np.cos(h) * np.sin(p) * np.sin(r)
    turned = compensation.field_in_vehicle([20_000.0, 1_000.0, 45_000.0], quaternion=2 * np.column_stack([w, x, y, z]))
    np.testing.assert_allclose(turned, field, atol=1e-6)
    with pytest.raises(geomag.InvalidInputError, match="got both or none"):
        compensation.field_in_vehicle([1.0, 2.0, 3.0])
    with pytest.raises(geomag.ShapeError):
        compensation.field_in_vehicle([1.0, 2.0], heading_deg=0.0)


def test_a_stream_goes_on_after_a_pickle_and_is_near_the_log():
    flight = synthetic.calibration_box(300.0, seed=8, vector_noise_nt=0.0)
    found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
    log = found.apply(flight.time_s, flight.reading_nt, flight.field_nt)
    stream = found.stream()
    said = []
    for k, (t, b, z) in enumerate(zip(flight.time_s, flight.field_nt, flight.reading_nt, strict=True)):
        if k == 400:
            stream = pickle.loads(pickle.dumps(stream))
        said.append(stream.update(t, b, z))
    assert np.std(np.array(said)[1:] - log[1:]) < 0.02 * np.std(flight.interference_nt)
    with pytest.raises(geomag.InvalidInputError, match="a time after"):
        stream.update(0.0, flight.field_nt[0], 1.0)


def test_saved_and_read_back(tmp_path):
    flight = synthetic.calibration_box(85.0, seed=1)
    found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
    found.to_json(tmp_path / "vehicle.json")
    back = compensation.Compensation.from_json(tmp_path / "vehicle.json")
    np.testing.assert_array_equal(back.coefficients, found.coefficients)
    np.testing.assert_array_equal(back.covariance, found.covariance)
    assert back.ridge == found.ridge
    for text in ("{}", "no json", '{"format": "another"}'):
        (tmp_path / "bad.json").write_text(text)
        with pytest.raises(geomag.ReadError, match=r"bad\.json"):
            compensation.Compensation.from_json(tmp_path / "bad.json")
    with pytest.raises(geomag.MissingFileError):
        compensation.Compensation.from_json(tmp_path / "none.json")


def test_figure_of_merit_falls():
    flight = synthetic.calibration_box(300.0, seed=3)
    found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
    quiet = found.apply(flight.time_s, flight.reading_nt, flight.field_nt)
    before = compensation.figure_of_merit(flight.reading_nt, flight.manoeuvres)
    after = compensation.figure_of_merit(quiet, flight.manoeuvres)
    assert len(flight.manoeuvres) == 12
    assert after < 0.05 * before
    assert found.improvement_ratio > 50


def test_legs_are_told_apart():
    flight = synthetic.calibration_box(85.0, seed=1, leg_s=30.0)
    found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
    t = np.arange(0.0, 90.0, 0.5)
    heading = np.interp(t, [0, 40, 50, 90], [0.0, 0.0, 90.0, 90.0])
    field = compensation.field_in_vehicle([20_000.0, 1_000.0, 45_000.0], heading_deg=heading)
    told = found.leftover(t, field, heading)
    assert set(np.unique(told.leg)) == {-1, 0, 1}
    assert told.leg_sigma_nt > 3 * told.within_sigma_nt


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": np.zeros(3300)}, "times that rise"),
        ({"reading_nt": np.zeros(5)}, "reading_nt"),
        ({"field_nt": np.zeros((3300, 2))}, "field_nt"),
        ({"band_hz": (0.9, 0.1)}, "band_hz"),
        ({"band_hz": (0.1, 7.0)}, "band_hz"),
        ({"ridge": -1.0}, "ridge"),
        ({"folds": 1}, "folds"),
        ({"expected_nt": np.zeros(3)}, "expected_nt"),
        ({"reading_nt": np.full(3300, np.nan)}, "good samples"),
        ({"field_nt": np.tile([1.0, 2.0, 3.0], (3300, 1))}, "changes direction|good samples"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change, message):
    flight = synthetic.calibration_box(85.0, seed=1)
    arguments = {"time_s": flight.time_s, "reading_nt": flight.reading_nt, "field_nt": flight.field_nt} | change
    first = [arguments.pop(k) for k in ("time_s", "reading_nt", "field_nt")]
    with pytest.raises(geomag.GeomagError, match=message):
        compensation.fit(*first, **arguments)


def test_a_map_tells_the_crust_in_one_argument_at_the_heights_of_the_flight():
    rng = np.random.default_rng(4)
    waves = [(rng.normal(0, 25), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(400, 4000, 40)]

    def field(x, y, height):
        return sum(a * np.exp(-k * height) * np.cos(k * (np.cos(d) * x + np.sin(d) * y) + p) for a, k, d, p in waves)

    axis = np.arange(0.0, 12_000.0, 40.0)
    # The map is wrong by 2 nT from node to node, and lies 60 m under the flight.
    values = field(axis, axis[:, None], 0.0) + rng.normal(0, 2, (axis.size, axis.size))
    grid = geomag.GridMap(values, axis, axis, sigma=2.0, height_m=80.0)
    box = synthetic.calibration_box(85.0, seed=2, crust=lambda x, y: field(x, y, 60.0), start_m=(2000.0, 2000.0))
    left = []
    for crust in (None, (grid, box.x_m, box.y_m, 140.0), (grid.continue_to(140.0), box.x_m, box.y_m)):
        found = compensation.fit(box.time_s, box.reading_nt, box.field_nt, crust=crust)
        left.append(np.std(found.interference(box.time_s, box.field_nt) - box.interference_nt))
    assert left[1] < 0.02 * np.std(box.interference_nt)
    assert left[1] < 0.3 * left[0]
    assert left[2] == pytest.approx(left[1], rel=0.3)
    # What lies off the map is left out, not made up.
    part = geomag.GridMap(values[:, :150], axis[:150], axis, sigma=2.0)
    fewer = compensation.fit(box.time_s, box.reading_nt, box.field_nt, crust=(part, box.x_m, box.y_m))
    assert fewer.samples < found.samples
    with pytest.raises(geomag.ShapeError, match="crust x"):
        compensation.fit(box.time_s, box.reading_nt, box.field_nt, crust=(grid, box.x_m[:-1], box.y_m))
    with pytest.raises(geomag.InvalidInputError, match="no heights"):
        compensation.fit(
            box.time_s, box.reading_nt, box.field_nt, crust=(grid.continue_to([80.0, 140.0]), box.x_m, box.y_m)
        )
