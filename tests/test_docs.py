"""Every code block of the documentation runs: Python in one namespace a page, commands in its folder.

A page goes on from the files that the pages named in NEEDS have written. `sh` blocks are set-up for people: not run.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(p for p in [*ROOT.glob("docs/**/*.md"), ROOT / "README.md"] if "_build" not in p.parts)
FENCE = re.compile(
    r"^(?P<tick>```+)(?P<kind>\{code-cell\}|python|console)[^\n]*\n(?P<body>.*?)^(?P=tick)\s*$", re.M | re.S
)
# What the short blocks of a guide take for granted: a map, a track, a log, of any kind.
SCENE = """
import geomag, numpy as np
from geomag import synthetic
grid = synthetic.Crust().draw((0, 0, 60_000, 60_000), seed=1).grid(250.0, units="nT")
path = synthetic.Path.straight((12_000, 12_000), course_deg=40, speed_m_s=60, interval_s=10, samples=60)
track = synthetic.fly(grid, path, ins=synthetic.InsError(position_m=(400.0, -300.0))).track
values, quantum, planned = track.values, 8.0, track
"""
SCENES = {
    "contour.md": SCENE,
    "sequence.md": SCENE,
    "filter.md": """
import geomag, numpy as np
north, east = (a.ravel() for a in np.meshgrid(np.linspace(-500, 500, 9), np.linspace(-500, 500, 9)))
field = np.column_stack([20 * np.cos(north / 300), 20 * np.sin(east / 300), 40_000 + north + east])
model = geomag.RectangularHarmonicModel.fit(north, east, np.zeros(81), field, order=2)
log = [(10.0, 45.0, None)] * 3
""",
    "harmonic.md": """
import geomag, numpy as np
latitude, longitude = (a.ravel() for a in np.meshgrid(np.linspace(32.5, 33.5, 30), np.linspace(117.5, 118.5, 30)))
height = np.zeros(latitude.size)
components = np.column_stack([np.cos(9 * latitude), np.sin(7 * longitude), np.cos(5 * latitude)]) * 50
""",
    "ins-feedback.md": """
import geomag
log = [(10.0 * k, 118.0 + 0.001 * k, 33.0, None) for k in range(5)]
""",
}
# Pages whose blocks share nothing, but for those that say that they go on.
APART = {"recipes.md": "Going on from the block"}
# Pages whose commands work on files that another page makes.
NEEDS = {"command-line.md": "tutorial.md"}


def blocks(page: Path) -> list[tuple[str, str, int, str]]:
    """Kind, text and line of every block that is to run, and the words before it."""
    text = page.read_text(encoding="utf-8")
    found = []
    end = 0
    for match in FENCE.finditer(text):
        words, end = text[end : match.start()], match.end()
        body = "".join(line for line in match["body"].splitlines(keepends=True) if not line.startswith(":"))
        kind = "console" if match["kind"] == "console" else "python"
        found.append((kind, body, text[: match.start()].count("\n") + 2, words))
    return found


def commands(body: str) -> list[str]:
    """Command lines of a console block: those after a dollar sign, continuations joined."""
    joined = re.sub(r"\\\n(> )?", "", body)
    return [line[2:] for line in joined.splitlines() if line.startswith("$ ")]


def run_page(page: Path) -> None:
    os.environ.setdefault("MPLBACKEND", "Agg")
    namespace: dict[str, object] = {"__name__": "__docs__"}
    exec(SCENES.get(page.name, ""), namespace)
    for kind, body, line, words in blocks(page):
        if page.name in APART and APART[page.name] not in words:
            namespace = {"__name__": "__docs__"}
        if kind == "python":
            code = compile("\n" * (line - 1) + body, str(page), "exec")
            exec(code, namespace)
            continue
        for command in commands(body):
            shell = re.sub(r"(^|\| )geomag\b", rf"\1{shlex.quote(sys.executable)} -m geomag", command)
            done = subprocess.run(shell, shell=True, capture_output=True, text=True, timeout=300, check=False)
            assert done.returncode in ((0, 3) if "stream" in command else (0,)), (
                f"{page.name}, line {line}: {command}\n{done.stdout}\n{done.stderr}"
            )


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda p: str(p.relative_to(ROOT)))
def test_every_block_runs(page, tmp_path, monkeypatch):
    text = page.read_text(encoding="utf-8")
    for library in (
        "matplotlib",
        "xarray",
        "pandas",
        "verde",
        "ppigrf",
        "boule",
        "geopandas",
        "distributed",
        "netCDF4",
        "pyins",
        "pyulog",
        "pymavlink",
        "rosbags",
    ):
        if library in text:
            pytest.importorskip(library)
    if "GEOMAG_DATA" in text or "shared/data" in text:
        data = Path(os.environ.get("GEOMAG_DATA", ROOT.parent / "shared" / "data"))
        if not data.is_dir():
            pytest.skip(f"{page.name} works on survey data, and there is none at {data}")
        monkeypatch.setenv("GEOMAG_DATA", str(data))
    monkeypatch.chdir(tmp_path)
    if page.name in NEEDS:
        run_page(page.with_name(NEEDS[page.name]))
    run_page(page)
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        pyplot.close("all")


def test_every_link_between_pages_leads_somewhere():
    broken = []
    for page in PAGES:
        prose = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", prose):
            if target.startswith("../geomag_core"):
                continue  # put there by make docs
            if not (page.parent / target).exists():
                broken.append(f"{page.relative_to(ROOT)} -> {target}")
    assert not broken, broken


def test_every_page_is_on_the_site():
    entries = []
    for page in PAGES:
        # A page may have a table of its own, with paths from where it stands.
        for toctree in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S):
            folder = "" if page.parent == ROOT / "docs" else f"{page.parent.relative_to(ROOT / 'docs')}/"
            entries += [folder + entry for entry in re.findall(r"^([\w\-/*]+)$", toctree, re.M)]
    for page in PAGES:
        built = any(part.startswith("_") for part in page.relative_to(ROOT).parts)
        if page.parent == ROOT or built or page.name == "index.md":
            continue
        name = str(page.relative_to(ROOT / "docs").with_suffix(""))
        assert any(name == e or (e.endswith("*") and name.startswith(e[:-1])) for e in entries), (
            f"{name} is on no toctree"
        )


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_every_example_runs(example, tmp_path):
    text = example.read_text(encoding="utf-8")
    for library in ("matplotlib", "xarray", "pandas", "verde", "ppigrf", "boule", "pyins"):
        if re.search(rf"^\s*(import|from) {library}\b", text, re.M):
            pytest.importorskip(library)
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(example)], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
        env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip(), "an example says what it found"


def test_the_first_block_of_the_readme_prints_what_it_says(capsys):
    body = next(body for kind, body, _, _ in blocks(ROOT / "README.md") if kind == "python")
    exec(compile(body, "README.md", "exec"), {})
    said = re.search(r"print\(.*?\)  +# (.*)", body)
    assert said
    assert capsys.readouterr().out.strip() == said[1]
