"""The command line: answers, exit status, one clear line on bad input."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from fields import rough

import geomag

for _module in ("typer", "pandas", "xarray"):
    pytest.importorskip(_module, reason="needs the extras 'cli' and 'io'")

from geomag.cli import run  # noqa: E402
from geomag.reproduce import EXPERIMENTS, Context, e8  # noqa: E402


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(3)
    x, y = 16 + 0.002 * np.arange(80), 47 + 0.0015 * np.arange(90)
    grid = geomag.GridMap(rough(rng, 90, 80, smooth=2.5), x, y, geographic=True, name="anomaly", units="nT")
    grid.to_xarray().to_netcdf(tmp_path / "map.nc")
    k = np.arange(30)
    lon, lat = 16.05 + 0.002 * k, 47.04 + 0.0013 * k
    readings = grid.sample(lon, lat) + rng.normal(0, 1, 30) + 30.0
    rows = "\n".join(f"{a},{b},{v}" for a, b, v in zip(lon - 0.0063, lat + 0.0041, readings, strict=True))
    (tmp_path / "log.csv").write_text("longitude,latitude,anomaly\n" + rows)
    return tmp_path


def call(capsys, *arguments):
    status = run([str(a) for a in arguments])
    out = capsys.readouterr()
    return status, out.out, out.err


@pytest.mark.parametrize("method", ["msd", "mad", "ncc"])
def test_match_prints_one_json_object(files, capsys, method):
    status, out, _ = call(
        capsys, "match", files / "map.nc", files / "log.csv", "--method", method, "--half-width-m", 1000, "--json"
    )
    fix = json.loads(out)
    assert status == 0
    assert fix["status"] == "fixed"
    assert fix["ok"] is True
    assert fix["offset"] == pytest.approx([0.0063, -0.0041], abs=3e-4)
    assert len(fix["track"]) == 30


def test_posterior_declares_its_risk(files, capsys):
    status, out, _ = call(
        capsys,
        *("match", files / "map.nc", files / "log.csv", "--method", "posterior"),
        *("--half-width-m", 1000, "--sigma", 1, "--tolerance-m", 200, "--json"),
    )
    fix = json.loads(out)
    assert status == (0 if fix["ok"] else 3)
    assert 0.0 <= fix["risk"] <= 1.0
    assert not fix["ok"] or fix["risk"] <= 0.01


@pytest.mark.parametrize("method", ["iema", "prod", "hausdorff"])
def test_other_methods_answer_or_say_no(files, capsys, method):
    status, out, _ = call(
        capsys, "match", files / "map.nc", files / "log.csv", "--method", method, "--half-width-m", 1000, "--json"
    )
    fix = json.loads(out)
    assert status == (0 if fix["ok"] else 3)
    assert fix["ok"] == (fix["status"] == "fixed")


@pytest.mark.parametrize("letter", [False, True])
def test_contour_method(files, capsys, letter):
    """Refined from a lattice it finds the place with its covariance; to the letter it has none to give."""
    more = ["--letter"] if letter else ["--heading-deg", 0.5, "--sigma", 6.0, "--tolerance-m", 150.0]
    status, out, _ = call(
        capsys,
        "match",
        files / "map.nc",
        files / "log.csv",
        "--method",
        "contour",
        "--half-width-m",
        1000,
        "--json",
        *more,
    )
    fix = json.loads(out)
    assert status == (0 if fix["ok"] else 3)
    assert (fix["covariance_m2"] is None) == letter
    if not letter:
        assert fix["ok"]
        assert fix["offset"] == pytest.approx([0.0063, -0.0041], abs=5e-4)
        assert fix["bias"] == pytest.approx(30.0, abs=1.0)
        assert fix["risk"] < 0.01


def test_match_in_words_with_a_picture(files, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    picture = files / "match.png"
    status, out, _ = call(
        capsys, "match", files / "map.nc", files / "log.csv", "--half-width-m", 1000, "--plot", picture
    )
    assert status == 0
    assert "correction" in out
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["match", "none.nc", "log.csv"], "none.nc"),
        (["match", "map.nc", "none.csv"], "none.csv"),
        (["match", "map.nc", "log.csv", "--value", "nothing"], "nothing"),
        (["match", "map.nc", "log.csv", "--variable", "nothing"], "nothing"),
        (["match", "map.nc", "log.csv", "--method", "guess"], "guess"),
        (["match", "map.nc", "log.csv", "--half-width-m", "-5"], "half-width"),
        (["match", "map.nc", "log.csv", "--method", "iema", "--sigma", "0"], "sigma"),
        (["match", "map.nc"], "track"),
        (["info", "log.csv"], "grid"),
        (["demo", "--lines", "log.csv"], "--map"),
        (["reproduce", "E99"], "E99"),
        (["sing"], "sing"),
    ],
)
def test_bad_input_is_one_line_and_status_1(files, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(files)
    status, out, err = call(capsys, *arguments)
    assert status == 1
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert words in err


@pytest.mark.parametrize(
    "command",
    [
        "calibrate {} --half-width-m 1000 --tolerance-m 200",
        "field fit {} --value a --order 2 --out {}.json",
        "match {} {} --method msd",
        "info {}",
        "demo --lines {} --map {}",
    ],
)
@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\0\0", b"# words\n\nof no table at all\n", None])
def test_a_file_that_is_none_of_ours_is_one_line_and_status_1(tmp_path, capsys, command, content):
    path = tmp_path / "lines.csv"
    if content is not None:
        path.write_bytes(content)
    code, out, err = call(capsys, *(part.format(path) for part in command.split()))
    assert (code, out) == (1, "")
    assert err.startswith("geomag: ")
    assert "needed" in err
    assert "Traceback" not in err


def test_a_map_of_nothing_useful_is_status_3(files, capsys):
    flat = geomag.GridMap(
        np.full((90, 80), 5.0), 16 + 0.002 * np.arange(80), 47 + 0.0015 * np.arange(90), geographic=True
    )
    flat.to_xarray().rename("anomaly").to_netcdf(files / "flat.nc")
    status, out, _ = call(capsys, "match", files / "flat.nc", files / "log.csv", "--half-width-m", 500, "--json")
    assert status == 3
    assert json.loads(out)["ok"] is False


def test_info(files, capsys):
    status, out, _ = call(capsys, "info", files / "map.nc", "--json")
    facts = json.loads(out)
    assert status == 0
    assert facts["shape"] == [90, 80]
    assert facts["geographic"] is True
    status, out, _ = call(capsys, "info", files / "map.nc")
    assert "gradient" in out


def test_demo_fixes_and_draws(tmp_path, capsys):
    for module in ("matplotlib", "ppigrf"):
        pytest.importorskip(module, reason="needs the extras 'plot' and 'field'")
    status, out, _ = call(capsys, "demo", "--seed", 5, "--out", tmp_path / "demo.png")
    assert status == 0
    assert (tmp_path / "demo.png").read_bytes()[:4] == b"\x89PNG"
    errors = [float(line.split()[1]) for line in out.splitlines() if line.startswith("error")]
    assert errors[-1] < 250


def test_demo_on_a_real_line(tmp_path, capsys, data_file):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    folder = data_file("osborne-aeromag")
    lines, grid = folder / "osborne_lines.csv.gz", folder / "osborne_grid_from_shared_lines.nc"
    status, out, _ = call(capsys, "demo", "--lines", lines, "--map", grid, "--out", tmp_path / "demo.png")
    assert status in (0, 3)
    assert "line" in out


def test_reproduce_quickly(tmp_path, capsys, data):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    status, _out, _ = call(capsys, "reproduce", "E1", "E2", "E3", "--data", data, "--out", tmp_path, "--effort", 0.04)
    assert status == 0
    assert "published" in (tmp_path / "report.md").read_text()
    tables = {r["key"]: r for r in json.loads((tmp_path / "report.json").read_text())}
    assert set(tables) == {"E1", "E2", "E3"}
    # On the lattice the paper's rule is nearly always right; off it, it is not.
    rows = {row[0]: row for row in tables["E2"]["tables"][1]["rows"]}
    on, off = rows["random tracks, INS error on the lattice"], rows["random tracks, INS error anywhere"]
    assert on[3] <= 0.1 * on[1]
    assert off[3] > 0.2 * off[1]


def test_a_word_on_the_map_lets_the_posterior_fix(files, capsys):
    match = ("match", files / "map.nc", files / "log.csv", "--method", "posterior", "--half-width-m", 1200, "--json")
    common = ("--sigma", 1, "--tolerance-m", 100)
    status, out, _ = call(capsys, *match, *common, "--map-sigma", 0, "--heading-deg", 0.2)
    fix = json.loads(out)
    assert status == 0
    assert fix["risk"] <= 0.01
    assert fix["offset"] == pytest.approx([0.0063, -0.0041], abs=0.0005)
    status, _, said = call(capsys, *match, *common, "--map-sigma", -1)
    assert status == 1
    assert "sigma" in said
    status, out, _ = call(capsys, *match, *common, "--line-spacing-m", 100)
    assert status in (0, 3)
    assert np.trace(json.loads(out)["covariance_m2"]) > np.trace(fix["covariance_m2"])
    status, _, said = call(capsys, *match, *common, "--line-spacing-m", 100, "--map-sigma", 0)
    assert status == 1
    assert "--line-spacing-m: needed without --map-sigma" in said


@pytest.mark.parametrize("key", EXPERIMENTS)
def test_every_experiment_can_be_run(key):
    assert callable(importlib.import_module(f"geomag.reproduce.{key.lower()}").run)


def test_ships_are_not_fixed_on_a_grid_that_knows_too_little(tmp_path, data):
    pytest.importorskip("pandas", reason="needs the extra 'survey'")
    pytest.importorskip("xarray", reason="needs the extra 'io'")
    rows = e8.ships(Context(data, tmp_path)).rows
    assert all(row[1] >= 40 for row in rows)
    # Declined, or right: none of the fixes is wrong.
    assert [row[3] for row in rows] == [0, 0]


@pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")
def test_reproduce_the_surveys(tmp_path, capsys, data):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    status, _out, _ = call(capsys, "reproduce", "E8", "--data", data, "--out", tmp_path)
    assert status == 0
    tables = json.loads((tmp_path / "report.json").read_text())[0]["tables"]
    share = {row[0]: [float(cell.split()[0]) for cell in row[2:5]] for row in tables[0]["rows"]}
    for name, (fixed, wrong, gross) in {"Osborne": (60, 2, 0.3), "Britain": (30, 3, 1)}.items():
        assert share[name][0] >= fixed
        assert share[name][1] <= wrong
        assert share[name][2] <= gross


def test_module_and_version():
    out = subprocess.run([sys.executable, "-m", "geomag", "--version"], capture_output=True, text=True, check=True)
    assert geomag.__version__ in out.stdout


def test_bench_compares_answers(capsys):
    status, out, _ = call(capsys, "bench", "--quick")
    assert status == 0
    assert "NumPy slices" in out
