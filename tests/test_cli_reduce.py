"""`geomag reduce`: raw readings of a log to what a map holds."""

from __future__ import annotations

import datetime
import json

import numpy as np
import pytest

for _module in ("typer", "pandas", "scipy", "ppigrf"):
    pytest.importorskip(_module)

import pandas as pd  # noqa: E402

from geomag import compensation, synthetic  # noqa: E402
from geomag.cli import run  # noqa: E402
from geomag.mainfield import load  # noqa: E402


def raw_log(path, **more):
    when = np.datetime64("2026-06-01T08:00:00") + np.arange(40) * np.timedelta64(30, "s")
    lon, lat = 10 + 0.002 * np.arange(40), 47 + 0.001 * np.arange(40)
    anomaly = 50 * np.sin(np.arange(40) / 5)
    raw = anomaly + load("igrf14").total(lon, lat, 900.0 + np.arange(40), when)
    log = pd.DataFrame(
        {"time": when, "longitude": lon, "latitude": lat, "total_field_nt": raw, "h": 900.0 + np.arange(40)} | more
    )
    log.to_csv(path, index=False)
    return log, anomaly


def call(capsys, *arguments):
    status = run([str(a) for a in arguments])
    out = capsys.readouterr()
    return status, out.out, out.err


def base_record(path):
    head = {"Format": "IAGA-2002", "Geodetic Latitude": "47.0", "Geodetic Longitude": "10.0", "Reported": "F"}
    text = "".join(f" {k:<23}{v:<45}|\n" for k, v in head.items()) + "DATE       TIME         DOY     SMWF   |\n"
    for k in range(24 * 60):
        when = datetime.datetime(2026, 6, 1) + datetime.timedelta(minutes=k)
        text += f"{when:%Y-%m-%d %H:%M:%S}.000 152   {48_000 + 0.05 * (k - 719.5):10.2f}\n"
    path.write_text(text)


def test_main_field_and_variation_in_one_command(tmp_path, capsys):
    log, anomaly = raw_log(tmp_path / "raw.csv")
    base_record(tmp_path / "base.min")
    minutes = 480 + 0.5 * np.arange(40)
    log["total_field_nt"] += 0.05 * (minutes - 719.5)
    log.to_csv(tmp_path / "raw.csv", index=False)
    status, out, err = call(
        capsys, "reduce", tmp_path / "raw.csv", tmp_path / "out.csv",
        *("--main-field", "igrf14", "--height-m", "h", "--base", tmp_path / "base.min"),
    )  # fmt: skip
    assert status == 0, err
    assert "by igrf14" in out
    assert "by base.min" in out
    written = pd.read_csv(tmp_path / "out.csv")
    assert list(written.columns) == [*log.columns, "anomaly_nt"]
    # 0.08 degrees further east the Sun is some twenty seconds earlier: 0.02 nT.
    np.testing.assert_allclose(written["anomaly_nt"], anomaly, atol=0.05)


def test_json_says_what_was_taken_off(tmp_path, capsys):
    raw_log(tmp_path / "raw.csv")
    status, out, _ = call(
        capsys, "reduce", tmp_path / "raw.csv", tmp_path / "out.csv", "--main-field", "igrf14", "--json"
    )
    told = json.loads(out)
    assert status == 0
    assert told["rows"] == 40
    assert 40_000 < told["main_field_nt"][0] < told["main_field_nt"][1] < 60_000


def test_dates_with_a_zone_are_heeded(tmp_path, capsys):
    log, anomaly = raw_log(tmp_path / "raw.csv")
    log["time"] = [f"{t:%Y-%m-%dT%H:%M:%S}+02:00" for t in log["time"] + pd.Timedelta(hours=2)]
    log.to_csv(tmp_path / "raw.csv", index=False)
    status, _, err = call(
        capsys, "reduce", tmp_path / "raw.csv", tmp_path / "out.csv", "--main-field", "igrf14", "--height-m", "h"
    )
    assert status == 0, err
    np.testing.assert_allclose(pd.read_csv(tmp_path / "out.csv")["anomaly_nt"], anomaly, atol=1e-6)


def test_the_vehicle_is_taken_off(tmp_path, capsys):
    flight = synthetic.calibration_box(300.0, seed=4)
    compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt).to_json(tmp_path / "vehicle.json")
    when = np.datetime64("2026-06-01T08:00:00") + (flight.time_s * 1000).round().astype("timedelta64[ms]")
    bx, by, bz = flight.field_nt.T
    log = pd.DataFrame({"time": when, "mag_nt": flight.reading_nt, "bx": bx, "by": by, "bz": bz})
    log.to_csv(tmp_path / "raw.csv", index=False)
    status, out, err = call(
        capsys,
        "reduce",
        tmp_path / "raw.csv",
        tmp_path / "out.csv",
        "--compensation",
        tmp_path / "vehicle.json",
        "--field",
        "bx,by,bz",
    )
    assert status == 0, err
    assert "by vehicle.json" in out
    assert pd.read_csv(tmp_path / "out.csv")["anomaly_nt"].std() < 0.02 * 300


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--main-field, --base or --compensation"),
        (["--main-field", "igrf99"], "igrf99"),
        (["--main-field", "igrf14", "--date", "2035-01-01"], "1900 to 2030"),
        (["--main-field", "igrf14", "--value", "nothing"], "needed a column 'nothing'"),
        (["--main-field", "igrf14", "--height-m", "nothing"], "needed a column 'nothing'"),
        (["--main-field", "igrf14", "--time", "h"], "got numbers"),
        (["--field", "a,b,c", "--main-field", "igrf14"], "--compensation"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, capsys, options, message):
    raw_log(tmp_path / "raw.csv")
    status, _, err = call(capsys, "reduce", tmp_path / "raw.csv", tmp_path / "out.csv", *options)
    assert status == 1
    assert message in err
    assert err.count("\n") == 1
