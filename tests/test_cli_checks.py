"""What the command line refuses: one line that names the option, before any work is done."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import geomag

for _module in ("typer", "pandas", "xarray"):
    pytest.importorskip(_module, reason="needs the extras 'cli' and 'io'")

from geomag.cli import run  # noqa: E402


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A map in metres, a track on it, a harmonic model, files that are no maps."""
    path = tmp_path_factory.mktemp("checks")
    x, y = 100.0 * np.arange(60), 100.0 * np.arange(80)
    values = 80 * np.sin(x / 500) * np.cos(y[:, None] / 700) + 40 * np.sin((x + 2 * y[:, None]) / 900)
    grid = geomag.GridMap(values, x, y, name="anomaly", units="nT")
    grid.to_xarray().to_netcdf(path / "map.nc")
    k = np.arange(25)
    east, north = 1500 + 90 * k, 3000 + 60 * k
    rows = [f"{a},{b},{v}" for a, b, v in zip(east - 200, north + 100, grid.sample(east, north), strict=True)]
    (path / "log.csv").write_text("x,y,value\n" + "\n".join(rows))
    (path / "gap.csv").write_text("x,y,value\n" + "\n".join([*rows, "1,2,"]))
    (path / "empty.nc").write_bytes(b"")
    (path / "junk.nc").write_text("not a map")
    (path / "bare.csv").write_text("a,b,c\n0,0,1\n1,0,2\n0,1,3\n1,1,4\n")
    (path / "plain.csv").write_text("x,y,value\n0,0,1\n1,0,2\n0,1,3\n1,1,4\n")
    frame = geomag.LocalFrame(45.0, 7.0)
    region = [(-5e4, 5e4), (-5e4, 5e4), (-1e4, 1e3)]
    model = geomag.RectangularHarmonicModel.from_coefficients(0, 1e5, [0, 0, 1], region=region, frame=frame)
    model.to_json(path / "model.json")
    return path


def call(capsys, folder, monkeypatch, line):
    monkeypatch.chdir(folder)
    status = run(line.split())
    told = capsys.readouterr()
    return status, told.out, told.err


SIMULATE = "calibrate map.nc --simulate --half-width-m 500 --tolerance-m 200"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("match map.nc log.csv --method iema --max-misses -1", "--max-misses"),
        ("match map.nc log.csv --heading-deg 500", "--heading-deg"),
        ("match map.nc log.csv --method mad --max-misses 3", "--method iema"),
        ("match map.nc log.csv --letter", "--method contour"),
        ("match map.nc log.csv --method msd --max-risk 0.1", "--method posterior"),
        ("match map.nc log.csv --method contour --letter --heading-deg 1", "without --letter"),
        ("match map.nc log.csv --report /proc/x.html", "--report"),
        ("match map.nc log.csv --geojson .", "folder"),
        ("match map.nc log.csv --plot fix.foo", ".png, .svg or .pdf"),
        ("match map.nc gap.csv", "--drop-missing"),
        ("match plain.csv log.csv", "--geographic"),
        ("match empty.nc log.csv", "netCDF"),
        ("match junk.nc log.csv", "netCDF"),
        ("--record . match map.nc log.csv", "--record"),
        ("stream map.nc --max-misses -1", "--max-misses"),
        ("stream map.nc --sigma 0", "--sigma"),
        ("demo --seed -1", "--seed"),
        ("demo --out x.foo", "--out"),
        ("suitability map.nc --speed 50 --flights -3", "--flights"),
        ("suitability map.nc --speed 50 --heading 9000", "--heading"),
        ("suitability map.nc --speed 0", "--speed"),
        ("suitability map.nc --speed 50 --route bare.csv", "--x"),
        ("match map.nc log.csv --plot nowhere/fix.png", "needed a folder that is there, got nowhere"),
        (f"{SIMULATE} --sigma -1", "--sigma"),
        (f"{SIMULATE} --bias -2", "--bias"),
        (f"{SIMULATE} --samples -1", "--samples"),
        (f"{SIMULATE} --samples 0", "--samples"),
        (f"{SIMULATE} --trials 0", "--trials"),
        (f"{SIMULATE} --outlier-share 2", "--outlier-share"),
        (f"{SIMULATE} --spacing-m -1", "--spacing-m"),
        ("info map.nc --sigma -1", "--sigma"),
        ("info map.nc --sigma nan", "--sigma"),
        ("info map.nc --sigma 0", "--sigma"),
        ("reproduce E2 --effort -1", "--effort"),
        ("field eval model.json --at=95,7,0", "--at"),
        ("field eval model.json --at=nan,7,0", "--at"),
        ("field eval model.json --grid=6.95,7.05,44.95,45.05,1e-9 --out m.nc", "nodes"),
        ("field eval model.json --grid=6.95,7.05,44.95,95,0.01 --out m.nc", "--grid"),
    ],
)
def test_nonsense_is_refused_in_one_line(folder, capsys, monkeypatch, line, words):
    status, out, err = call(capsys, folder, monkeypatch, line)
    assert status == 1
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    assert words in err
    assert not any(python in err for python in ("geographic=", "missing=", "variable=", "max_candidates"))


def test_nothing_is_left_behind(folder, capsys, monkeypatch):
    status, _, _ = call(capsys, folder, monkeypatch, "--record run.json info map.nc")
    assert status == 0
    assert (folder / "run.json").exists()
    status, _, _ = call(capsys, folder, monkeypatch, "--record new/run.json info map.nc")
    assert status == 1
    assert not (folder / "new").exists()
    call(capsys, folder, monkeypatch, "match none.nc log.csv --report fix.html")
    assert not (folder / "fix.html").exists()


def test_calibrate_reads_whether_a_map_is_in_metres(folder, capsys, monkeypatch):
    status, out, err = call(capsys, folder, monkeypatch, f"{SIMULATE} --trials 5 --map-sigma 0 --out c.md")
    assert status == 0, err
    assert "5" in out
    assert (folder / "c.md").exists()


def test_the_risk_of_a_contour_match_is_named_for_what_it_is(folder, capsys, monkeypatch):
    line = "match map.nc log.csv --method contour --half-width-m 500 --sigma 1"
    _, out, _ = call(capsys, folder, monkeypatch, line)
    assert "of another minimum of the misfit (not calibrated)" in out
    _, out, _ = call(capsys, folder, monkeypatch, line + " --tolerance-m 150")
    assert "beyond 150 m (not calibrated)" in out
    _, out, _ = call(capsys, folder, monkeypatch, line.replace("contour", "posterior"))
    assert "beyond one cell of the map" in out


def test_suitability_counts_the_map_and_not_what_a_track_can_reach(folder, capsys, monkeypatch):
    """Tracks of 39 x 100 m end in the far half of 60 columns only."""
    line = "suitability map.nc --speed 10 --interval 10 --samples 40 --heading 90 --tolerance-m 1000 --json"
    status, out, _ = call(capsys, folder, monkeypatch, line)
    row = json.loads(out)["headings"][0]
    assert status == 0
    assert row["share_reached"] < 0.5
    assert row["share_with_fix"] <= row["share_reached"]
    assert row["share_with_fix"] == pytest.approx(row["share_with_fix_of_reached"] * row["share_reached"])


def test_a_mistyped_path_makes_no_folder(folder, capsys, monkeypatch):
    for option, name in (("--plot", "fix.png"), ("--report", "fix.html"), ("--geojson", "fix.json")):
        status, out, _ = call(capsys, folder, monkeypatch, f"match map.nc log.csv {option} nowhere/{name}")
        assert (status, out) == (1, "")
    assert not (folder / "nowhere").exists()


def test_no_fix_gives_no_order_to_move_by(folder, capsys, monkeypatch):
    x, y = np.arange(0, 6000, 100.0), np.arange(0, 8000, 100.0)
    geomag.GridMap(0.001 * np.sin(x / 500) * np.ones((80, 1)), x, y, name="anomaly").to_xarray().to_netcdf(
        folder / "flat.nc"
    )
    line = "match flat.nc log.csv --map-sigma 0 --sigma 1 --half-width-m 500 --report flat.html"
    status, out, _ = call(capsys, folder, monkeypatch, line)
    assert status == 3
    assert "correction" not in out
    assert "because" in out
    page = (folder / "flat.html").read_text(encoding="utf-8")
    assert "is to be moved" not in page


def test_readings_with_the_main_field_in_them_are_told(folder, capsys, monkeypatch):
    rows = (folder / "log.csv").read_text().splitlines()
    high = [rows[0], *(",".join([*r.split(",")[:2], str(float(r.split(",")[2]) * 0.01 + 48_000)]) for r in rows[1:])]
    (folder / "high.csv").write_text("\n".join(high))
    line = "match map.nc high.csv --map-sigma 0 --sigma 1 --half-width-m 500"
    status, out, _ = call(capsys, folder, monkeypatch, line)
    assert status == 3
    assert "main field has not been taken out" in out


def test_the_report_says_how_to_make_the_fix_again(folder, capsys, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    line = "match map.nc log.csv --map-sigma 0 --sigma 0.5 --tolerance-m 150 --report first.html --json"
    status, first, _ = call(capsys, folder, monkeypatch, line)
    assert status == 0
    page = (folder / "first.html").read_text(encoding="utf-8")
    command = page.split("<p><code>")[1].split("</code>")[0]
    assert command.startswith("geomag match map.nc log.csv ")
    assert "--half-width-m 2000" in command  # chosen by itself, named all the same
    status, second, _ = call(capsys, folder, monkeypatch, command.removeprefix("geomag "))
    assert json.loads(second)["offset_m"] == json.loads(first)["offset_m"]


def test_a_route_says_where_fixes_can_be_had(folder, capsys, monkeypatch):
    (folder / "plan.csv").write_text("x,y\n1000,2000\n4500,3000\n4500,7000\n")
    line = "suitability map.nc --route plan.csv --speed 50 --interval 2 --samples 15 --sigma 1 --tolerance-m 150 --half-width-m 500"
    status, out, _ = call(capsys, folder, monkeypatch, f"{line} --json --out plan-out.csv")
    rows = json.loads(out)["route"]
    assert status == 0
    assert [r["distance_m"] for r in rows[:2]] == [1400.0, 2100.0]
    assert all(0 <= r["fix_probability"] <= 1 for r in rows)
    assert len((folder / "plan-out.csv").read_text().splitlines()) == len(rows) + 1
    status, out, _ = call(capsys, folder, monkeypatch, line)
    assert "windows on the map" in out
    assert "nan" not in out


def test_errors_speak_the_command_line(folder, capsys, monkeypatch):
    status, _, err = call(capsys, folder, monkeypatch, "match map.nc bare.csv --x a --y b")
    assert status == 1
    assert "--value" in err
    assert "value=" not in err


def test_what_remains_is_a_time(monkeypatch):
    """From the first call on there is a bar; a time to go is shown once there is one, never `nan`."""
    import io

    from geomag import _progress

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    clock = iter([0.0, 0.1, 1.0, 200.0, 20_000.0])
    monkeypatch.setattr(_progress.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr("sys.stderr", Terminal())
    bar = _progress.bar("gridding ")
    seen = []
    for done in (0, 1, 10, 50):
        bar(done, 100)
        seen.append(sys.stderr.getvalue().split("\r")[-1].strip())
    assert seen[0] == f"gridding [{'.' * 30}]   0.0%"
    assert [s.split("%")[1].strip() for s in seen[1:]] == [
        "2 min to go",
        "30 min to go",
        "5.6 h to go",
    ]


def test_an_interruption_is_told(monkeypatch, capsys):
    from geomag.cli import info, run

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(info, "read_grid", interrupted)
    assert run(["info", "map.nc"]) == 130
    assert capsys.readouterr().err == "geomag: interrupted\n"
