"""An option's name, default and explanation stand in one place, and everything that lists them is made of it."""

from __future__ import annotations

import importlib.util
import inspect
import pickle
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from fields import rough

import geomag

ROOT = Path(__file__).resolve().parents[1]
X = np.arange(0.0, 4000.0, 50.0)
GRID = geomag.GridMap(rough(np.random.default_rng(5), 80, 80, smooth=4.0), X, X, sigma=0.5)
K = np.arange(30.0)
TRACK = geomag.Track(900.0 + 60 * K, 1200.0 + 40 * K, GRID.sample(1000.0 + 60 * K, 1100.0 + 40 * K))
#: Every table of options: the file that it stands in, and the calls that are made of it.
TABLES = {
    "rust/geomag-core/src/matching/posterior/options.rs": [
        geomag.match_posterior,
        geomag.match_posterior_many,
        geomag.predict_many,
        geomag.PosteriorMatcher,
    ],
}
ROW = re.compile(r"\((\w+): (\w+) = ([^;]+);\s*\"([^\"]+)\";\s*((?:\"[^\"]*\"\s*)+)\)")


def rows(table):
    """Name, default and lines of explanation of every option in a table."""
    found = ROW.findall((ROOT / table).read_text(encoding="utf-8"))
    return [(name, default, re.findall(r"\"([^\"]*)\"", lines)) for name, _, default, _, lines in found]


def sources():
    for folder, pattern in (("rust", "*.rs"), ("python", "*.py"), ("python", "*.pyi")):
        for path in sorted((ROOT / folder).rglob(pattern)):
            yield path, path.read_text(encoding="utf-8")


@pytest.mark.parametrize("table", TABLES)
def test_an_option_stands_in_one_place(table):
    found = rows(table)
    assert len(found) > 10
    texts = list(sources())
    for name, _, lines in found:
        for line in (line for line in lines if len(line) > 25):  # the rest of a sentence may stand anywhere
            places = [str(path.relative_to(ROOT)) for path, text in texts if line in text]
            assert places == [table], f"{name}: its explanation stands in {places}"
    # A signature with its default is written nowhere else; the stub is made of it.
    for name, default, _ in found:
        again = re.compile(rf"\b{name}(?:: \w+)?\s*[=:]\s*{re.escape(default)}[,)]")
        for path, text in texts:
            if path.suffix == ".rs" and "posterior" in str(path) and "tests" not in path.stem:
                assert not again.search(text), f"{name} has its default again in {path.relative_to(ROOT)}"


@pytest.mark.parametrize("table", TABLES)
def test_every_call_has_every_option(table):
    for call in TABLES[table]:
        parameters, text = inspect.signature(call).parameters, inspect.cleandoc(call.__doc__)
        for name, default, lines in rows(table):
            assert repr(parameters[name].default).replace("'", '"') == repr(eval(default)).replace("'", '"'), name
            assert re.search(rf"^{name} : ", text, re.M), f"{call.__name__} does not explain {name}"
            assert all(line in text for line in lines)


def test_the_stub_says_what_the_module_says():
    spec = importlib.util.spec_from_file_location("stub", ROOT / "rust" / "geomag-py" / "stub.py")
    stub = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stub)
    text = stub.STUB.read_text(encoding="utf-8")
    assert stub.written(text) == text, "run rust/geomag-py/stub.py"
    bent = text.replace("leg_bias_sigma: float = 0.0", "leg_bias_sigma: float = 0.5", 1)
    assert bent != text
    assert stub.written(bent) == text


def test_parts_are_the_keywords():
    search = geomag.SearchBox(half_width_m=400.0, step_m=25.0)
    prior = geomag.InsPrior(heading_sigma_deg=1.0)
    accept = geomag.Acceptance(tolerance_m=120.0, max_risk=0.05)
    by_parts = geomag.match_posterior(GRID, TRACK, sigma=0.5, search=search, prior=prior, accept=accept)
    options = {"tolerance_m": 120.0, "max_risk": 0.05, "heading_sigma_deg": 1.0}
    by_name = geomag.match_posterior(GRID, TRACK, sigma=0.5, half_width=400.0, step=25.0, **options)
    assert repr(by_parts) == repr(by_name)
    assert by_parts.risk == by_name.risk
    assert by_parts.covariance_m2.tolist() == by_name.covariance_m2.tolist()
    mixed = geomag.match_posterior(GRID, TRACK, sigma=0.5, half_width_m=400.0, step=25.0, prior=prior, accept=accept)
    assert mixed.risk == by_name.risk


def test_metres_are_metres_on_a_map_in_degrees():
    scale = np.array([111_319.49, 110_574.3])
    grid = geomag.GridMap(GRID.values, X / scale[0], X / scale[1], geographic=True, sigma=0.5)
    track = geomag.Track(TRACK.x / scale[0], TRACK.y / scale[1], TRACK.values)
    unit = np.array(grid.metres_per_unit(float(np.mean(track.y))))
    metres = geomag.match_posterior(grid, track, half_width_m=(300.0, 400.0), sigma=0.5)
    degrees = geomag.match_posterior(grid, track, half_width=tuple([300.0, 400.0] / unit), sigma=0.5)
    assert metres.risk == pytest.approx(degrees.risk, rel=1e-6)
    assert metres.x == pytest.approx(degrees.x, abs=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "half_width_m"),
        ({"half_width": 10.0, "half_width_m": 10.0}, "not both"),
        ({"half_width": 10.0, "step": 1.0, "step_m": 1.0}, "not both"),
        ({"half_width": 10.0, "search": geomag.SearchBox(half_width=20.0)}, "not both"),
        ({"half_width": 10.0, "max_risk": 0.1, "accept": geomag.Acceptance(max_risk=0.2)}, "not both"),
        ({"half_width_m": -5.0}, "half_width"),
        ({"half_width": 10.0, "interpolation": "cubic"}, "interpolation"),
    ],
)
def test_what_contradicts_itself_is_refused(options, words):
    for call, of in ((geomag.match_posterior, TRACK), (geomag.predict_many, [TRACK])):
        with pytest.raises(geomag.InvalidInputError, match=words):
            call(GRID, of, **options)
    with pytest.raises(geomag.InvalidInputError, match=words):
        geomag.PosteriorMatcher(GRID, **options)


def test_parts_are_values():
    for part in (
        geomag.SearchBox(half_width_m=(300.0, 400.0), step=2.0),
        geomag.InsPrior(scale_sigma=0.01),
        geomag.Acceptance(misfit_threshold=np.inf),
    ):
        assert pickle.loads(pickle.dumps(part)) == part
        assert type(part)(**part.to_dict()) == part
        assert eval(repr(part), {type(part).__name__: type(part), "inf": np.inf}) == part
        assert part != type(part)()
        with pytest.raises(AttributeError):
            part.max_risk = 1.0
    with pytest.raises(TypeError, match="half_wide"):
        geomag.SearchBox(half_wide=1.0)


def test_more_is_an_old_name_that_warns():
    other = [(GRID, TRACK.values, 0.5)]
    with pytest.warns(DeprecationWarning, match="channels"):
        old = geomag.match_posterior(GRID, TRACK, half_width=400.0, sigma=0.5, more=other)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        new = geomag.match_posterior(GRID, TRACK, half_width=400.0, sigma=0.5, channels=other)
    assert old.risk == new.risk
