"""The page of benchmarks is what its command makes of the newest record."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def report():
    spec = importlib.util.spec_from_file_location("benchmark_report", ROOT / "benches" / "report.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_made_of_the_newest_record(report):
    record = json.loads(report.newest().read_text(encoding="utf-8"))
    assert report.page(record) == report.PAGE.read_text(encoding="utf-8"), "run `python benches/report.py`"
    assert {"processor", "cores", "python", "peers", "probe"} <= set(record)
    assert all(row["seconds"] > 0 for row in record["rows"])


def test_exponents_are_slopes_of_logarithms(report):
    sizes = [10, 100, 1000]
    assert report.exponent(sizes, [3e-6 * n**1.5 for n in sizes]) == pytest.approx(1.5)
