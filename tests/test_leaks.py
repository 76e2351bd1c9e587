"""No call keeps memory: the short form of tests/leaks.py."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("xarray", reason="maps as xarray are among the calls")
if not Path("/proc/self/status").exists():
    pytest.skip("resident memory is read from /proc", allow_module_level=True)

import leaks

COUNT, SECONDS = ("1000000", "20") if "GEOMAG_LONG" in os.environ else ("3000", "0.05")


def test_every_public_call_has_a_line():
    assert leaks.public() - set(leaks.CALLS) == set()


def test_no_call_keeps_memory():
    out = subprocess.run([sys.executable, leaks.__file__, COUNT, SECONDS], capture_output=True, text=True, check=False)
    assert out.returncode == 0, out.stdout[-500:] + out.stderr[-2000:]
    assert "no call keeps memory" in out.stdout


def test_a_leak_is_seen():
    kept = []
    grown, made = leaks.grown_kib(lambda: kept.append(b"x" * 4096 + bytes(len(kept) % 7)), 3000, 5.0)
    assert grown > 4 * 0.5 * made
