from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import geomag
from geomag import synthetic

pytest.importorskip("matplotlib").use("Agg")
pytest.importorskip("xarray")
pytest.importorskip("typer")

from geomag import exchange, plot  # noqa: E402 - after the checks
from geomag.report import match_report  # noqa: E402


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    field = synthetic.Crust().draw((0, 0, 40_000, 30_000), seed=7)
    grid = field.grid(500.0, units="nT", name="anomaly", crs="EPSG:32616")
    path = synthetic.Path.straight((9_000, 7_000), course_deg=60, speed_m_s=60, interval_s=8, samples=40)
    flight = synthetic.fly(
        field, path, ins=synthetic.InsError(position_m=(-800.0, 500.0)), sensor=synthetic.Sensor(sigma=2.0)
    )
    grid.to_xarray().to_netcdf(folder / "map.nc")
    exchange.track_to_pandas(flight.track).to_csv(folder / "log.csv", index=False)
    return folder, grid, flight


class Page(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.external, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if tag not in ("meta", "img", "br", "link", "input"):
            self.open.append(tag)
        if tag == "img":
            self.images.append(values)
        self.external += [v for k, v in attributes if k in ("src", "href") and not v.startswith("data:")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_page_is_whole_and_self_contained(scene, tmp_path):
    _, grid, flight = scene
    fix = geomag.match_grid(grid, flight.track, half_width=2000.0, surface=True)
    offsets = np.linspace(-1000, 1000, 9)
    steps = [plot.Frame(k, np.arange(81).reshape(9, 9) > k, offsets, offsets) for k in (1, 20, 60)]
    path = match_report(
        tmp_path / "fix.html", grid, flight.track, fix, truth=flight.path, steps=steps,
        settings={"map": "<b>map & co</b>", "sigma": None}, command="geomag match 'a b.nc'",
    )  # fmt: skip
    page = Page(path.read_text(encoding="utf-8"))
    assert not page.open
    assert not page.external
    assert len(page.images) == 4
    assert all(image["alt"] for image in page.images)
    words = " ".join(page.words)
    assert "A fix: the position may be used." in words
    assert f"{fix.offset_m[0]:.1f} m east" in words
    assert "<b>map & co</b>" in words  # as text, not as markup
    assert geomag.__version__ in words
    assert "nan" not in words.lower().split()


def test_page_of_no_fix_says_so(scene, tmp_path):
    _, grid, flight = scene
    fix = geomag.Iema(grid, sigma=1e-6, half_width=600.0).run(flight.track)
    page = Page(match_report(tmp_path / "new" / "lost.html", grid, flight.track, fix).read_text(encoding="utf-8"))
    words = " ".join(page.words)
    assert "No fix: no candidate agrees with the readings." in words
    assert "is to be moved" not in words


@pytest.mark.parametrize("width", [1280, 400])
def test_page_fits_its_window(scene, tmp_path, width):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium to look at the page with")
    _, grid, flight = scene
    fix = geomag.match_grid(grid, flight.track, half_width=2000.0, surface=True)
    path = match_report(tmp_path / "fix.html", grid, flight.track, fix)
    probe = """<script>
    const all = [...document.images];
    const loaded = all.every((image) => image.naturalWidth > 0);
    document.title = [document.documentElement.scrollWidth, innerWidth, all.length, loaded].join(" ");
    </script>"""
    framed = tmp_path / "frame.html"
    framed.write_text(path.read_text(encoding="utf-8").replace("</body>", f"{probe}</body>"), encoding="utf-8")
    command = [browser, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
               f"--window-size={width},2000", "--virtual-time-budget=3000", "--dump-dom", framed.as_uri()]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    found = re.search(r"<title>(\d+) (\d+) (\d+) (true|false)</title>", done.stdout)
    assert found, done.stderr[-500:]
    wide, inner, images, loaded = found.groups()
    assert int(wide) <= int(inner), "the page is wider than its window"
    assert (int(images), loaded) == (3, "true")


def geomag_command(*arguments, folder, text=None):
    command = [sys.executable, "-m", "geomag", *arguments]
    return subprocess.run(command, cwd=folder, input=text, capture_output=True, text=True, timeout=120, check=False)


def test_match_writes_page_geojson_and_record(scene, tmp_path):
    folder, _, _ = scene
    settings = tmp_path / "settings.toml"
    settings.write_text('[match]\nmethod = "mad"\nhalf-width-m = 1500\n', encoding="utf-8")
    done = geomag_command(
        "--settings", str(settings), "--record", str(tmp_path / "run.json"), "match", "map.nc", "log.csv", "--value",
        "value", "--report", str(tmp_path / "r.html"), "--json", folder=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "fixed"
    assert (tmp_path / "r.html").stat().st_size > 50_000
    record = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert record["settings"]["match"]["method"] == "mad"
    assert record["settings"]["match"]["half_width_m"] == 1500
    assert record["versions"]["geomag"] == geomag.__version__
    assert "--report" in record["command"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[match]\nhalfwidth = 3\n", r"settings file .*\[match\]: needed one of .*half-width-m.*got 'halfwidth'"),
        ("[mach]\n", "got 'mach'"),
        ("[match\n", "needed TOML"),
    ],
)
def test_bad_settings_are_refused_by_name(scene, tmp_path, text, words):
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    done = geomag_command("--settings", str(tmp_path / "s.toml"), "match", "map.nc", "log.csv", folder=scene[0])
    assert done.returncode == 1
    assert re.search(words, done.stderr)
    assert len(done.stderr.strip().splitlines()) == 1


def test_usage_errors_are_one_line(scene):
    done = geomag_command("match", "--no-such-option", folder=scene[0])
    assert done.returncode == 1
    assert done.stderr.startswith("geomag: ")
    assert "Traceback" not in done.stderr


def test_versions_are_shown():
    done = geomag_command("--version", folder=".")
    assert done.stdout.strip() == f"geomag {geomag.__version__}"
    assert "numpy" in geomag_command("--versions", folder=".").stdout


def test_stream_answers_line_by_line(scene):
    folder, grid, flight = scene
    track = flight.track
    lines = [f"{t},{x},{y},{v}" for t, x, y, v in zip(track.time_s, track.x, track.y, track.values, strict=True)]
    options = [
        "--method",
        "iema",
        "--sigma",
        "15",
        "--half-width-m",
        "2000",
        "--tolerance-m",
        "800",
        "--max-misses",
        "3",
        "--no-restart",
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "geomag", "stream", "map.nc", *options],
        cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
    )  # fmt: skip
    iema = geomag.Iema(grid, sigma=15.0, half_width=2000.0, tolerance=800.0, max_misses=3)
    for line, x, y, v in zip(lines, track.x, track.y, track.values, strict=True):
        process.stdin.write(line + "\n")
        process.stdin.flush()
        answer = json.loads(process.stdout.readline())  # before the next sample is sent
        assert answer["status"] == iema.update(x, y, v).status
    process.stdin.close()
    assert process.wait(30) in (0, 3)


def test_geojson_is_longitude_and_latitude(scene, tmp_path):
    pytest.importorskip("pyproj")
    _, grid, flight = scene
    fix = geomag.match_grid(grid, flight.track, half_width=2000.0)
    with pytest.raises(geomag.InvalidInputError, match="crs"):
        exchange.geojson({"log": flight.track})
    found = exchange.geojson({"log": flight.track, "fix": fix}, crs=grid.crs)
    assert [f["geometry"]["type"] for f in found["features"]] == ["LineString", "Point", "LineString"]
    longitude, latitude = found["features"][1]["geometry"]["coordinates"]
    assert -180 <= longitude <= 180
    assert 0 <= latitude < 1
    assert found["features"][1]["properties"]["status"] == "fixed"
    json.loads(exchange.write_geojson(tmp_path / "new" / "a.geojson", {"fix": fix}, crs=grid.crs).read_text())
    lost = geomag.Iema(grid, sigma=1e-6, half_width=600.0).run(flight.track)
    assert exchange.geojson({"fix": lost}, crs=grid.crs)["features"][0]["geometry"] is None


def test_geopackage_round_trip(scene, tmp_path):
    pytest.importorskip("geopandas")
    _, grid, flight = scene
    other = flight.track[:5]
    path = exchange.write_geopackage(tmp_path / "a.gpkg", {"log": flight.track}, crs=grid.crs)
    back = exchange.read_geopackage_track(path, crs=grid.crs, time="time_s")
    np.testing.assert_allclose(back.x, flight.track.x, atol=1e-2)
    np.testing.assert_allclose(back.values, flight.track.values)
    assert np.array_equal(exchange.read_geopackage_track(path).time_s, flight.track.time_s)
    both = exchange.write_geopackage(tmp_path / "b.gpkg", {"log": flight.track, "more": other}, crs=grid.crs)
    assert len(exchange.read_geopackage_track(both, crs=grid.crs, track="log")) == len(flight.track)
    assert len(exchange.read_geopackage_track(both, crs=grid.crs, track="more")) == 5
    for wrong in (None, "less"):
        with pytest.raises(geomag.UnknownVariableError, match="log, more"):
            exchange.read_geopackage_track(both, crs=grid.crs, track=wrong)
    with pytest.raises(geomag.GeomagError, match="layer 'none'"):
        exchange.read_geopackage_track(path, layer="none")


def test_pandas_round_trip(scene):
    pandas = pytest.importorskip("pandas")
    track = scene[2].track
    frame = exchange.track_to_pandas(track)
    back = exchange.track_from_pandas(frame, time="time_s")
    for name in ("x", "y", "values", "time_s"):
        assert np.array_equal(getattr(back, name), getattr(track, name))
    stamped = frame.assign(when=pandas.Timestamp("2026-01-01", tz="UTC") + pandas.to_timedelta(frame.time_s, unit="s"))
    assert np.allclose(exchange.track_from_pandas(stamped, time="when").time_s, track.time_s)
    assert np.array_equal(exchange.track_from_pandas(frame).time_s, track.time_s)
    with pytest.raises(geomag.UnknownVariableError, match="'nt'"):
        exchange.track_from_pandas(frame, value="nt")
    with pytest.raises(geomag.TooFewSamplesError):
        exchange.track_from_pandas(stamped.iloc[:0], time="when")


def test_a_track_comes_from_pandas_in_one_way():
    from geomag import io

    assert exchange.track_from_pandas is io.track_from_pandas
    assert exchange.track_to_pandas is io.track_to_pandas


def test_accessor_does_what_the_functions_do(scene):
    import geomag.accessor

    _, grid, flight = scene
    data = grid.to_xarray()
    assert (
        data.geomag.match(flight.track, half_width=2000.0).to_dict()
        == geomag.match_grid(grid, flight.track, half_width=2000.0).to_dict()
    )
    assert data.geomag.iema(sigma=5.0, half_width=1000.0).n_feasible == 25


def test_suitability_writes_grid_and_picture(scene, tmp_path):
    xarray = pytest.importorskip("xarray")
    options = [
        "--speed",
        "60",
        "--interval",
        "8",
        "--samples",
        "9",
        "--sigma",
        "3",
        "--heading",
        "0",
        "--heading",
        "45",
    ]
    done = geomag_command(
        "suitability", "map.nc", *options, "--out", str(tmp_path / "s.nc"), "--plot", str(tmp_path / "s.png"),
        folder=scene[0],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(
        r"heading +45\.0  a fix on \d+% of the map \(\d+% of the nodes at which such a track can end\), there \d+ m",
        done.stdout,
    )
    with xarray.open_dataset(tmp_path / "s.nc") as found:
        assert {"error_m_000", "samples_045"} <= set(found)
        assert found["error_m_045"].attrs["units"] == "m"
    assert (tmp_path / "s.png").stat().st_size > 10_000
    bad = geomag_command("suitability", "map.nc", "--speed", "-1", folder=scene[0])
    assert bad.returncode == 1
    assert "--speed" in bad.stderr


def test_good_places_are_dark_for_every_method():
    """The page says that dark is good: a probability is good where it is large."""
    from geomag.cli.match import LARGEST_IS_BEST, Method

    grid = np.array([[0.1, 0.1], [0.1, 5.0]])
    dark = {}
    for least in (True, False):
        ax = plot.score_surface(grid, [0.0, 1.0], [0.0, 1.0], least_is_best=least, logarithmic=False)
        image = (ax.images or ax.collections)[0]
        colours = image.cmap(image.norm(np.array([0.1, 5.0])))[:, :3].sum(axis=1)
        dark[least] = "small" if colours[0] < colours[1] else "large"
    assert dark == {True: "small", False: "large"}
    assert set(LARGEST_IS_BEST) == {Method.prod, Method.ncc, Method.posterior}


def test_lines_are_cut_at_the_date_line():
    line = np.array([[179.5, 10.0], [-179.5, 11.0], [-179.0, 12.0], [179.0, 14.0]])
    (found,) = exchange.geojson({"log": line})["features"]
    assert found["geometry"] == {
        "type": "MultiLineString",
        "coordinates": [
            [[179.5, 10.0], [180.0, 10.5]],
            [[-180.0, 10.5], [-179.5, 11.0], [-179.0, 12.0], [-180.0, 13.0]],
            [[180.0, 13.0], [179.0, 14.0]],
        ],
    }
    whole = exchange.geojson({"log": line + np.array([180.0, 0.0])})["features"][0]["geometry"]
    assert whole["type"] == "LineString"


def test_a_geopackage_is_written_anew_where_asked(tmp_path):
    geopandas = pytest.importorskip("geopandas", reason="needs the extra 'geo'")
    path = tmp_path / "a.gpkg"
    exchange.write_geopackage(path, {"a": geomag.Track([16.0, 16.1], [47.0, 47.1], [1.0, 2.0])})
    line = {"b": np.array([[16.0, 47.0], [16.2, 47.0]])}
    exchange.write_geopackage(path, line)
    assert set(geopandas.list_layers(path).name) == {"tracks", "samples"}
    exchange.write_geopackage(path, line, overwrite=True)
    assert set(geopandas.list_layers(path).name) == {"tracks"}
