"""Arrows go down only: which floor may use which, read from the sources."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "rust" / "geomag-core" / "src"

#: Lowest floor first; modules of one group may use each other.
FLOORS = [
    {"error", "constants"},
    {"monitor", "state", "statistics", "compensation"},
    {"frame", "field", "grid", "stack", "map_error", "gridding", "information", "track", "fix"},
    {"harmonic", "main_field", "kalman", "lattice"},
    {"matching"},
    {"navigation"},
    {"synthetic"},
    {"campaign"},
]
LEVEL = {name: level for level, floor in enumerate(FLOORS) for name in floor}


def sources():
    return sorted(CORE.rglob("*.rs"))


def module_of(path):
    relative = path.relative_to(CORE)
    return relative.parts[0].removesuffix(".rs")


def without_tests_and_comments(text):
    # A declared test module leaves the rest of its file to be read; one written out stands last.
    text = re.sub(r"#\[cfg\(test\)\]\s*mod \w+;", "", text).split("#[cfg(test)]")[0]
    return "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("//"))


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(CORE)))
def test_arrows_go_down(path):
    own = module_of(path)
    if own in ("lib", "tests"):
        return
    assert own in LEVEL, f"module {own} stands on no floor: name it in FLOORS and in docs/architecture.md"
    text = without_tests_and_comments(path.read_text(encoding="utf-8"))
    for used in set(re.findall(r"crate::(\w+)", text)):
        if used in LEVEL:
            assert LEVEL[used] <= LEVEL[own], f"{path.relative_to(ROOT)} uses {used}, which lies above {own}"


def test_kalman_knows_no_field():
    for path in (CORE / "kalman").rglob("*.rs"):
        text = without_tests_and_comments(path.read_text(encoding="utf-8"))
        used = set(re.findall(r"crate::(\w+)", text))
        assert not used & {"field", "grid", "harmonic", "track", "fix", "frame"}, path


def test_the_core_reads_no_file_no_clock_and_prints_nothing():
    forbidden = re.compile(r"std::fs|std::time|Instant::now|SystemTime|println!|eprintln!|print!\(|dbg!|\bunsafe\b")
    for path in sources():
        found = forbidden.search(without_tests_and_comments(path.read_text(encoding="utf-8")))
        assert not found, f"{path.relative_to(ROOT)}: {found.group()}"


def test_import_needs_numpy_alone():
    import subprocess

    code = (
        "import sys, geomag; "
        "heavy = {'xarray', 'pandas', 'matplotlib', 'scipy', 'typer', 'dask', 'rasterio', 'ppigrf', 'boule', 'verde'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_the_ellipsoid_is_the_cores_alone():
    constant = re.compile(r"6_?378_?137|0\.006_?694")
    for path in sorted((ROOT / "python").rglob("*.py")):
        assert not constant.search(path.read_text(encoding="utf-8")), f"{path.relative_to(ROOT)}: ask the map"
