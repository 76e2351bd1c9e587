"""The short form of benches/soak.py: some hours of everything that goes wrong, all at once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

SOAK = Path(__file__).resolve().parents[1] / "benches" / "soak.py"
STEPS = "604800" if "GEOMAG_LONG" in os.environ else "20000"


def test_a_flight_through_everything(tmp_path):
    """The bound holds as declared, memory is flat, and the same bits come with restarts and with another number of threads."""
    out = tmp_path / "soak.json"
    run = subprocess.run(
        [sys.executable, str(SOAK), "--steps", STEPS, "--json", str(out)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr[-2000:]
    got = json.loads(out.read_text())
    assert got["same_bits"]
    assert got["restarts"] >= 4
    assert got["refused"] > 0
    assert got["share"]["tracking"] > 0.5
    assert got["share"]["coasting"] > 0
    assert got["worst_m"] < got["unaided_worst_m"]
