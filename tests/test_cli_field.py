"""`geomag field fit|eval`: models from files, values and maps from models, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

import geomag

for _module in ("typer", "pandas", "xarray", "netCDF4"):
    pytest.importorskip(_module, reason="needs the extras 'cli' and 'io'")

from geomag.cli import run  # noqa: E402

MAIN = (31_000.0, 2_000.0, -42_000.0)


def truth():
    """A model of order 3 on the Earth, about 20 km wide."""
    rng = np.random.default_rng(4)
    wave = 2 * np.pi / 30e3
    coefficients = [1.0, -2.0, 5.0]
    coefficients += [
        20 * rng.normal() / (wave * np.hypot(t, r)) for t, r, _, _ in geomag.RectangularHarmonicModel.terms(3)
    ]
    return geomag.RectangularHarmonicModel.from_coefficients(
        3, 30e3, coefficients, region=[(-1e4, 1e4), (-1e4, 1e4), (-600.0, 0.0)],
        frame=geomag.LocalFrame(-22.0, 140.6, 500.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Seventeen lines at heights of their own: components, anomaly and intensity of a known field."""
    import pandas as pd

    folder = tmp_path_factory.mktemp("survey")
    model = truth()
    lat, lon = (
        a.ravel() for a in np.meshgrid(np.linspace(-22.08, -21.92, 17), np.linspace(140.52, 140.68, 40), indexing="ij")
    )
    height = 550.0 + 40.0 * np.sin(90 * lon)
    frame = model.frame
    inside = model.field(*frame.forward(lat, lon, height), extrapolate=True)
    own = frame.rotate_from_origin(lat, lon, inside)
    main = np.array(MAIN)
    pd.DataFrame(
        {
            "latitude": lat, "longitude": lon, "height_m": height, "line": np.repeat(np.arange(17), 40),
            "bn": own[:, 0], "be": own[:, 1], "bd": own[:, 2],
            "anomaly": inside @ main / np.linalg.norm(main), "intensity": np.linalg.norm(main + inside, axis=1),
        }
    ).to_csv(folder / "lines.csv", index=False)  # fmt: skip
    return folder, model


def call(capsys, *arguments):
    status = run([str(a) for a in arguments])
    out = capsys.readouterr()
    return status, out.out, out.err


def fit(capsys, folder, *arguments):
    return call(capsys, "field", "fit", folder / "lines.csv", "--height", "height_m", *arguments)


PLACE = (-22.01, 140.61, 540.0)


def test_components_come_back_at_a_place_and_on_a_map(survey, capsys):
    folder, model = survey
    out = folder / "vector.json"
    status, told, _ = fit(
        capsys, folder, "--components", "bn,be,bd", "--order", 12, "--ridge", "1e-12", "--out", out, "--json"
    )
    assert status == 0
    summary = json.loads(told)
    assert summary["order"] == 12
    assert summary["n_observations"] == 3 * 17 * 40
    assert summary["residual_rms"] < 0.05
    assert summary["out"] == str(out)

    place = ",".join(map(str, PLACE))
    status, told, _ = call(capsys, "field", "eval", out, f"--at={place}", "--json")
    found = json.loads(told)
    expected = model.field_geographic(*PLACE)
    assert status == 0
    np.testing.assert_allclose(found["field"], expected, atol=0.1)
    assert found["intensity"] == pytest.approx(np.linalg.norm(found["field"]))
    gradient = np.array(found["gradient"])
    assert abs(np.trace(gradient)) < 1e-9
    np.testing.assert_allclose(gradient, gradient.T, atol=1e-12)
    # Finite differences a hundred metres to the north, in the point's own axes.
    step = 100.0 / 110_700.0
    north = [model.field_geographic(PLACE[0] + s * step, *PLACE[1:]) for s in (1, -1)]
    np.testing.assert_allclose(gradient[:, 0], (north[0] - north[1]) / 200.0, atol=5e-4)
    assert all(s > 0 for s in found["sigma"])
    assert found["unit"] == "nT"

    chart = folder / "map.nc"
    status, told, _ = call(
        capsys, "field", "eval", out, "--grid=140.55,140.65,-22.05,-21.95,0.01", "--height", 700,
        "--quantity", "east", "--out", chart, "--json",
    )  # fmt: skip
    assert status == 0
    assert json.loads(told) == {"out": str(chart), "shape": [11, 11], "holes": 0}
    grid = geomag.read_grid(chart)
    np.testing.assert_allclose(
        grid.values, model.field_geographic(grid.y[:, None], grid.x[None, :], 700.0)[..., 1], atol=0.2
    )


@pytest.mark.parametrize("kind", ["anomaly", "intensity"])
def test_a_scalar_with_the_main_field(survey, capsys, kind):
    folder, model = survey
    out = folder / f"{kind}.json"
    status, told, _ = fit(
        capsys, folder, "--value", kind, "--kind", kind, "--main-field", ",".join(map(str, MAIN)), "--order", "6,8",
        "--ridge", "1e-9,1e-3", "--group", "line", "--every", 2, "--no-covariance", "--out", out,
    )  # fmt: skip
    assert status == 0
    assert "RectangularHarmonicModel(order" in told
    assert "frame LocalFrame(" in told
    back = geomag.RectangularHarmonicModel.from_json(out)
    assert back.covariance is None
    lat, lon, height = PLACE

    def along(m):
        return m.field(*m.frame.forward(lat, lon, height)) @ np.array(MAIN) / np.linalg.norm(MAIN)

    assert along(back) == pytest.approx(along(model), abs=0.3)
    status, told, _ = call(capsys, "field", "eval", out, f"--at={lat},{lon},{height}")
    assert status == 0
    assert told.count("gradient") == 3
    assert "+-" not in told  # no covariance, no sigma


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fit", "none.csv", "--value", "anomaly", "--out", "m.json"], "none.csv"),
        (["fit", "lines.csv", "--out", "m.json"], "--components"),
        (["fit", "lines.csv", "--value", "anomaly", "--components", "bn,be,bd", "--out", "m.json"], "--components"),
        (["fit", "lines.csv", "--components", "bn,be", "--out", "m.json"], "three columns"),
        (["fit", "lines.csv", "--value", "weather", "--main-field", "1,2,3", "--out", "m.json"], "'weather'"),
        (["fit", "lines.csv", "--value", "anomaly", "--out", "m.json"], "--main-field"),
        (["fit", "lines.csv", "--value", "anomaly", "--main-field", "1,2", "--out", "m.json"], "3 numbers"),
        (["fit", "lines.csv", "--components", "bn,be,bd", "--order", "many", "--out", "m.json"], "--order"),
        (["fit", "lines.csv", "--components", "bn,be,bd", "--order", "40", "--out", "m.json"], "needed at least 3283"),
        (["fit", "lines.csv", "--components", "bn,be,bd", "--height", "tall", "--out", "m.json"], "--height"),
        (["fit", "lines.csv", "--components", "bn,be,bd", "--ridge", "-1", "--out", "m.json"], "ridge"),
        (["fit", "lines.csv", "--components", "bn,be,bd"], "out"),
        (["eval", "none.json", "--at=1,2,3"], "none.json"),
        (["eval", "lines.csv", "--at=1,2,3"], "harmonic model"),
        (["eval", "flat.json", "--at=1,2,3"], "frame"),
        (["eval", "model.json"], "--at"),
        (["eval", "model.json", "--at=1,2"], "3 numbers"),
        (["fit", "words.csv", "--value", "word", "--main-field", "1,2,3", "--out", "m.json"], "numbers in column 'word'"),
        (["fit", "words.csv", "--value", "latitude", "--latitude", "word", "--main-field", "1,2,3", "--out", "m.json"],
         "numbers in column 'word'"),
        (["fit", "words.csv", "--value", "latitude", "--height", "word", "--main-field", "1,2,3", "--out", "m.json"],
         "numbers in column 'word'"),
        (["eval", "model.json", "--grid=3,1,0,1,0.1", "--out", "m.nc"], "west < east"),
        (["eval", "model.json", "--grid=140.55,140.65,-22.05,-21.95,0.01"], "--out"),
        (["eval", "model.json", "--grid=140.5,140.6,-22,-21.9,0.1", "--quantity", "anomaly", "--out", "m.nc"], "--main-field"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_status_1(survey, capsys, monkeypatch, arguments, words):
    folder, model = survey
    model.to_json(folder / "model.json")
    flat = geomag.RectangularHarmonicModel.from_coefficients(
        0, 1e4, [0.0, 0.0, 1.0], region=[(-1.0, 1.0), (-1.0, 1.0), (0.0, 0.0)]
    )
    flat.to_json(folder / "flat.json")
    (folder / "words.csv").write_text("latitude,longitude,word\n1,2,a\n2,3,b\n")
    monkeypatch.chdir(folder)
    status, out, err = call(capsys, "field", *arguments)
    assert status == 1
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    assert words in err


def test_outside_the_region_there_is_no_value(survey, capsys):
    folder, model = survey
    model.to_json(folder / "model.json")
    status, told, _ = call(capsys, "field", "eval", folder / "model.json", "--at=-25,140.6,500", "--json")
    assert status == 0
    assert json.loads(told)["field"] == [None, None, None]


COMMANDS = [
    ["demo"], ["match"], ["stream"], ["info"], ["suitability"], ["field", "fit"], ["field", "eval"], ["calibrate"],
    ["reproduce"], ["bench"],
]  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_shows_an_example_and_tells_json(capsys, command):
    status, out, _ = call(capsys, *command, "--help")
    assert status == 0
    assert f"Example: {'tail' if command == ['stream'] else 'geomag'}" in out
    assert " ".join(["geomag", *command]) in " ".join(out.split())
    assert ("--json" in out) == (command[0] not in ("stream", "calibrate"))


def test_field_takes_settings_and_leaves_a_record(survey, capsys, tmp_path):
    folder, _ = survey
    settings, record = tmp_path / "s.toml", tmp_path / "run.json"
    settings.write_text('[field.fit]\norder = "5"\ncomponents = "bn,be,bd"\n', encoding="utf-8")
    status, out, _ = call(
        capsys, "--settings", settings, "--record", record, "field", "fit", folder / "lines.csv", "--out",
        tmp_path / "m.json", "--json",
    )  # fmt: skip
    assert status == 0
    assert json.loads(out)["order"] == 5
    kept = json.loads(record.read_text(encoding="utf-8"))
    assert kept["settings"]["fit"]["components"] == "bn,be,bd"
    assert kept["versions"]["geomag"] == geomag.__version__


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_offered(shell):
    import os
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, "-m", "geomag", "fi"], capture_output=True, text=True, check=False,
        env={
            **os.environ, "_GEOMAG_COMPLETE": f"complete_{shell}", "COMP_WORDS": "geomag fi", "COMP_CWORD": "1",
            "_TYPER_COMPLETE_ARGS": "geomag fi", "_TYPER_COMPLETE_FISH_ACTION": "get-args",
        },
    )  # fmt: skip
    assert "field" in done.stdout
    assert "match" not in done.stdout


def test_json_of_the_others(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="needs the extra 'plot'")
    status, out, _ = call(capsys, "bench", "--quick", "--json")
    rows = json.loads(out)["rows"]
    assert status == 0
    assert {"NumPy slices", "geomag float64"} <= {row["what"] for row in rows}
    pytest.importorskip("ppigrf", reason="needs the extra 'field'")
    status, out, _ = call(capsys, "demo", "--seed", 5, "--out", tmp_path / "d.png", "--json")
    fix = json.loads(out)
    assert status == (0 if fix["ok"] else 3)
    assert fix["error_m"] < 250
    from geomag import synthetic

    synthetic.Crust().draw((0, 0, 20_000, 20_000), seed=1).grid(500.0, units="nT").to_xarray().to_netcdf(
        tmp_path / "m.nc"
    )
    status, out, _ = call(capsys, "suitability", tmp_path / "m.nc", "--speed", 60, "--samples", 10, "--json")
    told = json.loads(out)["headings"]
    assert status == 0
    assert [row["heading_deg"] for row in told] == [0.0, 90.0]
    assert all(0 <= row["share_with_fix"] <= 1 for row in told)
