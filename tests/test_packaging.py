"""What a user installs: version in one place, light import, and (with GEOMAG_PACKAGING=1) wheel and sdist in empty environments."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import geomag

ROOT = Path(__file__).resolve().parents[1]
whole = pytest.mark.skipif(
    os.environ.get("GEOMAG_PACKAGING") != "1", reason="builds wheel, sdist and crate: set GEOMAG_PACKAGING=1"
)


def test_version_is_in_one_place():
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))
    assert cargo["workspace"]["package"]["version"] == geomag.__version__
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" in project["dynamic"]
    assert "version" not in project
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: {re.escape(geomag.__version__)}$", citation, re.M)


def run(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    return done.stdout


def test_import_needs_numpy_alone():
    code = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"xarray", "pandas", "matplotlib", "scipy", "typer", "rich", "dask", "verde", "ppigrf",
                                  "boule", "netCDF4", "rasterio", "pyproj", "geopandas", "distributed", "pyarrow"}:
            raise ImportError(f"{name} is not for import geomag")
sys.meta_path.insert(0, Refuse())
import geomag, geomag.synthetic, geomag.campaign, geomag.plot, geomag.report, geomag.blocks, geomag.exchange, geomag.stream
print("light")
"""
    assert run(code).strip() == "light"


@whole
def test_import_is_fast():
    """Under 100 ms over NumPy's own: the best of several, for other programs run on this machine too."""
    code = "import time, numpy; t = time.perf_counter(); import geomag; print(time.perf_counter() - t)"
    best = min(float(run(code)) for _ in range(5))
    assert best < 0.100, f"import geomag took {best * 1000:.0f} ms over NumPy"


def test_show_versions_names_what_is_there(capsys):
    geomag.show_versions()
    shown = capsys.readouterr().out
    assert re.search(rf"^geomag +{re.escape(geomag.__version__)}$", shown, re.M)
    assert re.search(r"^numpy +\d", shown, re.M)


def test_the_older_package_of_that_name_is_told(tmp_path, capsys, monkeypatch):
    folder = tmp_path / "geomag-0.9.2015.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: geomag\nVersion: 0.9.2015\n", encoding="utf-8")
    geomag.show_versions()
    assert "warning" not in capsys.readouterr().out
    monkeypatch.syspath_prepend(str(tmp_path))
    geomag.show_versions()
    assert "the package 'geomag' 0.9.2015 is installed too" in capsys.readouterr().out


def test_a_missing_extra_is_named():
    code = """
import sys
sys.modules["matplotlib"] = sys.modules["matplotlib.pyplot"] = None
from geomag import plot
try:
    plot.new = plot.frames([plot.Frame(1, [[True]], [0.0], [0.0])])
except ImportError as error:
    print(type(error).__name__, error)
"""
    shown = run(code)
    assert "MissingDependencyError" in shown
    assert "geomag-nav[plot]" in shown


@pytest.fixture(scope="session")
def dist(tmp_path_factory):
    maturin = shutil.which("maturin", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if maturin is None:
        pytest.skip("no maturin to build with")
    out = tmp_path_factory.mktemp("dist")
    subprocess.run([maturin, "build", "--release", "--locked", "--out", out], cwd=ROOT, check=True, capture_output=True)
    subprocess.run([maturin, "sdist", "--out", out], cwd=ROOT, check=True, capture_output=True)
    return out


def environment(folder, python=sys.executable):
    subprocess.run([python, "-m", "venv", folder], check=True)
    return folder / "bin" / "python"


@whole
def test_wheel_holds_what_it_should(dist):
    (wheel,) = dist.glob("*.whl")
    assert "-cp311-abi3-" in wheel.name
    with zipfile.ZipFile(wheel) as held:
        names = held.namelist()
    assert "geomag/py.typed" in names
    assert "geomag/_geomag.pyi" in names
    assert any(n.endswith("licenses/LICENSE-MIT") for n in names)
    assert not any("shared" in n or n.endswith(".nc") for n in names)


@whole
def test_wheel_is_fit_for_old_systems(dist):
    """Audited: symbols of an old enough C library, and no library beside the system's own."""
    auditwheel = Path(sys.executable).parent / "auditwheel"
    if not auditwheel.exists():
        pytest.skip("no auditwheel")
    (wheel,) = dist.glob("*.whl")
    shown = subprocess.run([auditwheel, "show", wheel], capture_output=True, text=True, check=True).stdout
    tags = [tuple(map(int, t)) for t in re.findall(r"manylinux_(\d+)_(\d+)", shown)]
    assert tags, shown
    assert min(tags) <= (2, 39)


@whole
def test_wheel_for_old_systems_is_cross_built(tmp_path):
    """Against the C library of 2012 (2.17), as the release workflow does it, with zig as the linker; imported here."""
    pytest.importorskip("ziglang", reason="the cross-build needs the package ziglang")
    maturin = shutil.which("maturin", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    auditwheel = Path(sys.executable).parent / "auditwheel"
    if maturin is None or not auditwheel.exists():
        pytest.skip("needs maturin and auditwheel")
    command = [
        maturin,
        "build",
        "--release",
        "--locked",
        "--zig",
        "--compatibility",
        "manylinux2014",
        "--out",
        tmp_path,
    ]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert "manylinux2014" in wheel.name or "manylinux_2_17" in wheel.name
    shown = subprocess.run([auditwheel, "show", wheel], capture_output=True, text=True, check=True).stdout
    tags = [tuple(map(int, t)) for t in re.findall(r"manylinux_(\d+)_(\d+)", shown)]
    assert tags, shown
    assert min(tags) <= (2, 17), shown
    python = environment(tmp_path / "env")
    subprocess.run([python, "-m", "pip", "install", "--quiet", wheel], check=True)
    subprocess.run([python, "-c", "import geomag"], check=True, cwd=tmp_path)


@whole
def test_wheel_in_an_empty_environment(dist, tmp_path):
    python = environment(tmp_path / "env")
    (wheel,) = dist.glob("*.whl")
    subprocess.run([python, "-m", "pip", "install", "--quiet", wheel], check=True)
    listed = subprocess.run(
        [python, "-m", "pip", "list", "--format=freeze"], capture_output=True, text=True, check=True
    )
    names = {line.split("==")[0].lower() for line in listed.stdout.split()}
    assert names <= {"geomag-nav", "numpy", "pip", "setuptools"}
    code = """
import numpy as np, geomag
x = np.arange(0.0, 6000.0, 50.0)
grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x)
k = np.arange(30.0)
track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k))
print(geomag.match_grid(grid, track, half_width=500).status)
"""
    shown = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert shown.stdout.strip() == "fixed"
    bare = subprocess.run(
        [python, "-m", "geomag", "--version"], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert bare.returncode == 1
    assert "geomag-nav[cli]" in bare.stderr


@whole
def test_tutorial_in_an_empty_environment(dist, tmp_path):
    python = environment(tmp_path / "env")
    (wheel,) = dist.glob("*.whl")
    subprocess.run([python, "-m", "pip", "install", "--quiet", f"{wheel}[all]", "pytest"], check=True)
    (tmp_path / "tests").mkdir()
    shutil.copy(ROOT / "tests" / "test_docs.py", tmp_path / "tests")
    shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("_*"))
    shutil.copy(ROOT / "README.md", tmp_path)
    done = subprocess.run(
        [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/test_docs.py", "-k", "tutorial or command-line"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
    assert "2 passed" in done.stdout
    version = subprocess.run([python.with_name("geomag"), "--version"], capture_output=True, text=True, check=True)
    assert version.stdout.strip() == f"geomag {geomag.__version__}"


@whole
def test_wheel_on_another_python(dist, tmp_path):
    """One wheel for every Python from 3.11 on: imported on another version than it was built with."""
    own = f"{sys.version_info[0]}.{sys.version_info[1]}"
    names = [f"3.{minor}" for minor in (14, 13, 12, 11)]
    found = [shutil.which(f"python{name}") for name in names]
    found += [str(p) for n in names for p in sorted(Path.home().glob(f".pyenv/versions/{n}*/bin/python"))]
    for other in filter(None, found):
        probe = [other, "-c", "import ensurepip, sys; print('%d.%d' % sys.version_info[:2])"]
        shown = subprocess.run(probe, capture_output=True, text=True, check=False)
        if shown.returncode == 0 and shown.stdout.strip() != own:
            break
    else:
        pytest.skip(f"no other Python than {own} from 3.11 on")
    python = environment(tmp_path / "env", other)
    (wheel,) = dist.glob("*.whl")
    subprocess.run([python, "-m", "pip", "install", "--quiet", wheel], check=True)
    shown = subprocess.run(
        [python, "-c", "import geomag; print(geomag.__version__)"], capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip() == geomag.__version__


@whole
def test_sdist_builds_and_installs(dist, tmp_path):
    python = environment(tmp_path / "env")
    (sdist,) = dist.glob("*.tar.gz")
    subprocess.run([python, "-m", "pip", "install", "--quiet", sdist], check=True)
    shown = subprocess.run(
        [python, "-c", "import geomag; print(geomag.__version__)"],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert shown.stdout.strip() == geomag.__version__


@whole
def test_crate_can_be_packaged():
    command = ["cargo", "package", "-p", "geomag-core", "--locked", "--allow-dirty"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
