"""The public flights: a small file of the same layout, made here."""

from __future__ import annotations

import numpy as np
import pytest

import geomag
from geomag import dafmit, synthetic

h5py = pytest.importorskip("h5py", reason="needs the extra 'dafmit'")

FIELD = synthetic.Crust(height_m=400.0).draw((-77.2, 45.0, -76.4, 45.6), geographic=True, seed=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Flight 1003 with two lines, flight 1007 with none of those that are looked for."""
    where = tmp_path_factory.mktemp("dafmit")
    rng = np.random.default_rng(2)
    n = 9_000
    t = 50_000.0 + 0.1 * np.arange(n)
    lon, lat = -77.1 + 0.6 * np.arange(n) / n, 45.2 + 0.25 * np.arange(n) / n
    ins = geomag.InsModel.navigation()
    shown = synthetic.indicate(
        t, lon, lat, geographic=True, error=synthetic.draw_inertial_error(ins, rng, 80.0), ins=ins, seed=rng
    )
    columns = {
        "tt": t, "line": np.where(np.arange(n) < 8_000, 1003.02, 1003.08), "lat": lat, "lon": lon, "ins_lat": np.radians(shown.y), "ins_lon": np.radians(shown.x),
        "ins_vn": shown.velocity_m_s[:, 1], "ins_vw": -shown.velocity_m_s[:, 0], "ins_yaw": shown.heading_deg, "mag_1_igrf": FIELD.sample(lon, lat) + rng.normal(0, 1, n) + 40,
    }  # fmt: skip
    order = rng.permutation(n)  # the files are not in order of time
    with h5py.File(where / "Flt1003_train.h5", "w") as out:
        for name, values in columns.items():
            out[name] = values[order]
    return where


def test_a_line_becomes_a_log(folder):
    log = dafmit.read_line(folder / "Flt1003_train.h5", 1003.02, every=10)
    assert log.time_s.size == 800
    assert np.all(np.diff(log.time_s) > 0)
    assert abs(log.x[0] - log.truth[0, 0]) < 0.01
    assert log.velocity_m_s[:, 0].mean() > 0
    assert np.abs(log.heading_deg - np.degrees(np.arctan2(*log.velocity_m_s.T))).max() < 2.0


def test_lines_are_navigated_beside_the_published_figures(folder):
    grid = FIELD.grid(0.0025)
    known = geomag.GridMap(np.asarray(grid.values), grid.x, grid.y, geographic=True, sigma=1.0)
    done = dafmit.navigate_lines(folder, known, lines=[1003.02])
    s = done[0].summary()
    assert s["drms_m"] < s["unaided_drms_m"]
    assert s["within_99"] > 0.9
    text = dafmit.table(done)
    assert "| 1003.02 |" in text
    assert "57 m" in text


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        ({"line": 1003.5}, r"needed rows of line 1003\.50, got lines 1003\.02, 1003\.08"),
        ({"line": 1003.02, "reading": "mag_9"}, "needed a column 'mag_9', got ins_lat"),
        ({"line": 1003.02, "every": 0}, "every: needed a whole number"),
    ],
)
def test_what_is_not_there_is_named(folder, ask, message):
    with pytest.raises(geomag.GeomagError, match=message):
        dafmit.read_line(folder / "Flt1003_train.h5", **ask)


def test_files_that_are_none(folder, tmp_path):
    (tmp_path / "Flt1003_train.h5").write_text("no")
    with pytest.raises(geomag.ReadError, match="needed an HDF5 file"):
        dafmit.read_line(tmp_path / "Flt1003_train.h5", 1003.02)
    with pytest.raises(geomag.MissingFileError, match=r"needed a file of flight 1007, such as Flt1007_train\.h5"):
        dafmit.navigate_lines(folder, FIELD.grid(0.01), lines=[1007.02])
