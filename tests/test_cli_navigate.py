"""`geomag navigate`: a flight in one command, from a file or a pipe."""

from __future__ import annotations

import io
import json
import sys

import numpy as np
import pytest

import geomag
from geomag import synthetic
from geomag.flight_log import FlightLog, write_flight_log

for _module in ("typer", "xarray"):
    pytest.importorskip(_module, reason="needs the extras 'cli' and 'io'")

from geomag.cli import run  # noqa: E402

SECONDS = 1800


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    field = synthetic.Crust(height_m=400.0).draw((0, 0, 60_000, 60_000), seed=2)
    grid = field.grid(200.0, name="anomaly", units="nT")
    grid.to_xarray().to_netcdf(folder / "map.nc")
    t = np.arange(0.0, SECONDS, 2.0)
    x, y = 6_000 + 20 * t, 8_000 + 15 * t
    rng = np.random.default_rng(1)
    ins = geomag.InsModel.navigation()
    shown = synthetic.indicate(
        t, x, y, geographic=False, error=synthetic.draw_inertial_error(ins, rng, 200.0), ins=ins, seed=rng
    )
    readings = field.sample(x, y) + rng.normal(0, 1, t.size) + 12.0
    readings[::7] = np.nan
    truth = np.column_stack([x, y])
    log = FlightLog(t, shown.x, shown.y, readings, shown.velocity_m_s, shown.heading_deg, truth)
    write_flight_log(folder / "log.csv", log)
    return folder


def call(capsys, *arguments):
    status = run([str(a) for a in arguments])
    out = capsys.readouterr()
    return status, out.out, out.err


def test_one_json_object_and_a_track(files, capsys, tmp_path):
    status, out, _ = call(
        capsys,
        "navigate",
        files / "map.nc",
        files / "log.csv",
        "--map-sigma",
        1,
        "--position-sigma-m",
        200,
        "--json",
        "--out",
        tmp_path / "track.csv",
    )
    answer = json.loads(out)
    assert status == 0
    assert answer["status"] == "tracking"
    assert answer["ok"] is True
    assert answer["steps"] == SECONDS / 2
    assert answer["drms_m"] < 60
    assert answer["beyond_protection"] == 0.0
    rows = (tmp_path / "track.csv").read_text().splitlines()
    assert len(rows) == SECONDS / 2 + 1
    assert rows[-1].split(",")[1] == repr(answer["x"])


def test_words_picture_and_page(files, capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    status, out, _ = call(
        capsys,
        "navigate",
        files / "map.nc",
        files / "log.csv",
        "--map-sigma",
        1,
        "--plot",
        tmp_path / "f.png",
        "--report",
        tmp_path / "f.html",
    )
    assert status == 0
    assert "status      tracking" in out
    assert "within the 99 % radius" in out
    assert (tmp_path / "f.png").stat().st_size > 30_000
    page = (tmp_path / "f.html").read_text(encoding="utf-8")
    assert "Tracking: position and bound may be used." in page
    assert page.count("data:image/png;base64") == 1
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_a_pipe_is_answered_line_by_line_as_the_file_is(files, capsys, monkeypatch):
    text = (files / "log.csv").read_text()
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    status, out, _ = call(capsys, "navigate", files / "map.nc", "-", "--map-sigma", 1)
    lines = [json.loads(line) for line in out.splitlines()]
    assert status == 0
    assert len(lines) == SECONDS / 2
    _, whole, _ = call(capsys, "navigate", files / "map.nc", files / "log.csv", "--map-sigma", 1, "--json")
    assert (lines[-1]["x"], lines[-1]["protection_level_m"]) == (
        json.loads(whole)["x"],
        json.loads(whole)["protection_level_m"],
    )


def test_figures_of_an_ins_from_a_file(files, capsys, tmp_path):
    toml = tmp_path / "ins.toml"
    toml.write_text("[ins]\ngyro_bias_deg_h = 1.0\ngyro_walk_deg_sqrt_h = 0.05\nheading_sigma_mrad = 4\n")
    arguments = ("navigate", files / "map.nc", files / "log.csv", "--map-sigma", 1, "--json")
    _, own, _ = call(capsys, *arguments, "--ins", toml)
    _, usual, _ = call(capsys, *arguments)
    assert json.loads(own)["declared_rms_m"] > json.loads(usual)["declared_rms_m"]
    toml.write_text("gyro_bias = 1.0\n")
    status, _, err = call(capsys, *arguments, "--ins", toml)
    assert status == 1
    assert "needed figures among gyro_bias_deg_h" in err
    toml.write_text("gyro_bias_deg_h = 'much'\n")
    assert "needed a number, got 'much'" in call(capsys, *arguments, "--ins", toml)[2]


def test_lost_is_exit_status_three(files, capsys, tmp_path):
    text = (files / "log.csv").read_text().splitlines()
    blind = [text[0]] + [",".join([*r.split(",")[:3], "", *r.split(",")[4:]]) for r in text[1:]]
    (tmp_path / "blind.csv").write_text("\n".join(blind))
    status, out, _ = call(
        capsys,
        "navigate",
        files / "map.nc",
        tmp_path / "blind.csv",
        "--map-sigma",
        1,
        "--position-sigma-m",
        20_000,
        "--json",
    )
    assert status == 3
    assert json.loads(out)["ok"] is False


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--ins", "cheap"), "--ins: needed navigation, tactical or a TOML file, got 'cheap'"),
        (("--map-sigma", 1, "--line-spacing-m", 200), "needed without --map-sigma"),
        (("--position-sigma-m", 0), "--position-sigma-m"),
        (("--value", "gone"), "needed a column among"),
    ],
)
def test_refusals_are_one_line(files, capsys, arguments, message):
    status, _, err = call(capsys, "navigate", files / "map.nc", files / "log.csv", *arguments)
    assert status == 1
    assert message in err
    assert err.count("\n") == 1
