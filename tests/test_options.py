"""An option's name, default and explanation stand in one place, and everything that lists them is made of it."""

from __future__ import annotations

import ast
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
    "rust/geomag-core/src/navigation/navigator/ins.rs": [geomag.InsModel],
    "rust/geomag-core/src/navigation/navigator/plan.rs": [geomag.MatcherPlan],
    "rust/geomag-core/src/navigation/navigator/options.rs": [geomag.Navigator],
    "rust/geomag-core/src/matching/grid_search/options.rs": [geomag.match_grid],
    "rust/geomag-core/src/matching/contour/options.rs": [geomag.match_contour, geomag.SlidingContour],
    "rust/geomag-core/src/matching/starts.rs": [geomag.match_contour, geomag.SlidingContour],
    "rust/geomag-core/src/matching/scene.rs": [geomag.match_contour, geomag.SlidingContour],
    "rust/geomag-core/src/matching/refine/options.rs": [geomag.match_contour, geomag.SlidingContour],
    "rust/geomag-core/src/matching/iema.rs": [geomag.Iema],
    "rust/geomag-core/src/navigation/ins_feedback.rs": [geomag.InsFeedback],
    "rust/geomag-core/src/navigation/field_navigator/options.rs": [geomag.FieldNavigator],
    "rust/geomag-core/src/kalman/unscented.rs": [geomag.UnscentedKalmanFilter, geomag.FieldNavigator],
    # Shared rows; those of extents and steps are not all there is of every call.
    "rust/geomag-core/src/table.rs": [geomag.match_grid],
}
#: Where else the calls of a table could write its defaults again: parts of paths.
FAMILIES = {"posterior": "posterior", "field_navigator": "field_navigator", "unscented": "kalman", "navigator/": "navigator/", "grid_search": "grid_search", "contour": "contour",
            "starts": "contour", "scene": "contour", "refine": "contour", "iema": "iema", "ins_feedback": "ins_feedback",
            "table": "grid_search"}  # fmt: skip
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
    assert len(found) > 2
    texts = list(sources())
    for name, _, lines in found:
        for line in (line for line in lines if len(line) > 25):  # the rest of a sentence may stand anywhere
            places = [str(path.relative_to(ROOT)) for path, text in texts if line in text]
            assert places == [table], f"{name}: its explanation stands in {places}"
    # Beside its name a default is written nowhere else where the same calls are made; the stub is made of the tables.
    family = next(part for name, part in FAMILIES.items() if name in table)
    for name, default, _ in found:
        if default == "None":
            continue
        again = re.compile(rf"\b{name}(?:: \w+)? ?[=:] ?{re.escape(default)}[,)]")
        for path, text in texts:
            if path.suffix == ".rs" and "tests" not in path.stem and family in str(path):
                code = re.sub(r"^ *///.*$", "", text, flags=re.M)  # examples state values
                assert not again.search(code), f"{name} has its default again in {path.relative_to(ROOT)}"


#: Names of options that mean something else in Python functions of their own: where, and what.
OTHERS = {
    "geographic": "whether coordinates are degrees, of maps, lines and pictures",
    "interpolation": "how `DataArray.geomag.sample` reads a map, which is no matching",
    "samples": "length of the tracks of a calibration",
    "method": "which filter `calibrate_navigation` flies",
    "position_sigma_m": "what a made-up INS starts off by",
    "latitude_deg": "where a made-up INS flies",
}
#: The errors that a made-up INS and a made-up sensor have, which are not what a matcher is told.
MADE_UP = {"InsSpread", "Sensor"}


def defaults_in_python(text):
    """Every default that a Python text states in a signature or a class: who, name, value as text."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            a = node.args
            positional = [*a.posonlyargs, *a.args]
            stated = [*zip(positional[len(positional) - len(a.defaults) :], a.defaults, strict=True)]
            stated += zip(a.kwonlyargs, a.kw_defaults, strict=True)
            yield from ((node.name, arg.arg, ast.unparse(value)) for arg, value in stated if value is not None)
        elif isinstance(node, ast.ClassDef):
            for item in node.body:
                if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and item.value is not None:
                    yield node.name, item.target.id, ast.unparse(item.value)


def same_default(stated, row):
    """Whether a default in Python is that of a row of a table, however it is written."""
    try:
        return ast.literal_eval(stated) == eval(row, {"false": False, "true": True})
    except ValueError:  # asked of the call itself
        return False


def stated_again(text, options):
    for who, name, value in defaults_in_python(text):
        meant = name in options and name not in OTHERS and who not in MADE_UP and value != "None"
        if meant and any(same_default(value, row) for row in options[name]):
            yield who, name, value


def test_no_default_of_an_option_stands_in_python():
    options = {}
    for table in TABLES:
        for name, default, _ in rows(table):
            options.setdefault(name, set()).add(default)
    for path in sorted((ROOT / "python").rglob("*.py")):
        again = list(stated_again(path.read_text(encoding="utf-8"), options))
        assert not again, f"{path.relative_to(ROOT)} states defaults again; `default_of` asks for them: {again}"
    planted = "def f(x, min_overlap=.80, *, max_risk: float = 0.01, max_iterations=None, step=1): pass"
    assert [name for _, name, _ in stated_again(planted, options)] == ["min_overlap", "max_risk"]
    assert [name for _, name, _ in stated_again("class A:\n    max_risk: float = 1e-2", options)] == ["max_risk"]


@pytest.mark.parametrize("table", TABLES)
def test_every_call_has_every_option(table):
    for call in TABLES[table]:
        parameters, text = inspect.signature(call).parameters, inspect.cleandoc(call.__doc__)
        for name, default, lines in rows(table):
            if "options" not in parameters:  # those that hand their keywords on show them in the stub
                assert repr(parameters[name].default).replace("'", '"') == repr(
                    eval(default, {"false": False, "true": True})
                ).replace("'", '"'), name
            assert re.search(rf"^{name} : ", text, re.M), f"{call.__name__} does not explain {name}"
            assert all(line in text for line in lines)


def test_the_guide_states_the_defaults_that_there_are():
    page = (ROOT / "docs" / "guide" / "posterior.md").read_text(encoding="utf-8")
    stated = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| ([\d.]+|bilinear) \|", page, re.M)
    parameters = inspect.signature(geomag.match_posterior).parameters
    assert len(stated) > 6
    for names, default in stated:
        for name in re.findall(r"`(\w+)`", names):
            has = parameters[name].default
            assert default == has if isinstance(has, str) else float(default) == has, name


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


def test_extents_in_metres_serve_the_grid_search_too():
    scale = np.array([111_319.49, 110_574.3])
    grid = geomag.GridMap(GRID.values, X / scale[0], X / scale[1], geographic=True)
    track = geomag.Track(TRACK.x / scale[0], TRACK.y / scale[1], TRACK.values)
    unit = np.array(grid.metres_per_unit(float(np.mean(track.y))))
    metres = geomag.match_grid(grid, track, half_width_m=(300.0, 400.0), step_m=50.0)
    degrees = geomag.match_grid(grid, track, half_width=tuple([300.0, 400.0] / unit), step=tuple(50.0 / unit))
    assert metres.score == pytest.approx(degrees.score, rel=1e-9)
    assert metres.offset_m == pytest.approx(degrees.offset_m, abs=1e-6)
    with pytest.raises(geomag.InvalidInputError, match="half_width_m"):
        geomag.match_grid(grid, track)


def test_how_the_map_is_read_is_called_interpolation_everywhere():
    x, y = [1010.0, 1333.0], [1100.0, 1221.0]
    for new, old in (
        (lambda **k: GRID.sample(x, y, **k), "sample"),
        (lambda **k: GRID.gradient(x, y, **k), "gradient"),
        (lambda **k: geomag.match_grid(GRID, TRACK, half_width=300.0, **k).score, "match_grid"),
    ):
        with pytest.warns(DeprecationWarning, match="interpolation"):
            before = new(method="bicubic")
        assert repr(before) == repr(new(interpolation="bicubic")) != repr(new()), old


def test_a_keyword_that_there_is_not_names_the_one_that_was_meant():
    with pytest.raises(TypeError, match="did you mean 'reading_sigma'"):
        geomag.Navigator(GRID, reading_sigmas=1.0)
    with pytest.raises(TypeError, match=r"'zzz'$"):
        geomag.Navigator(GRID, zzz=1.0)


def test_a_random_walk_says_per_what():
    with pytest.warns(DeprecationWarning, match="position_walk_m_sqrt_s"):
        feedback = geomag.InsFeedback(position_walk_m=0.7)
    assert feedback.__reduce__()[1] == geomag.InsFeedback(position_walk_m_sqrt_s=0.7).__reduce__()[1]
    with pytest.warns(DeprecationWarning, match="bias_walk_sqrt_s"):
        old = geomag.Navigator(GRID, bias_walk=0.5)
    assert old.__reduce__()[1][-1] == geomag.Navigator(GRID, bias_walk_sqrt_s=0.5).__reduce__()[1][-1]
    assert old.__reduce__()[1][-1] != geomag.Navigator(GRID).__reduce__()[1][-1]
    default = geomag.Navigator(GRID, matcher="default").__reduce__()[1][-1]
    assert default == geomag.Navigator(GRID).__reduce__()[1][-1]
    assert default != geomag.Navigator(GRID, matcher=None).__reduce__()[1][-1]


def test_walks_of_a_field_navigator_and_limits_of_filters_have_old_names():
    given = {"start": (1000.0, 1000.0), "covariance_m2": 100.0, "reading_sigma": 1.0}
    sigmas = {"speed_sigma_m_s": 1.0, "heading_sigma_deg": 1.0, "bias_sigma": 1.0}
    new = {"speed_walk_m_s_sqrt_s": 0.1, "heading_walk_deg_sqrt_s": 0.2, "bias_walk_sqrt_s": 0.3}
    old = {"speed_walk": 0.1, "heading_walk_deg": 0.2, "bias_walk": 0.3}
    with pytest.warns(DeprecationWarning, match="is the old name of") as warned:
        before = geomag.FieldNavigator(GRID, **given, **sigmas, **old)
    assert [str(w.message).split()[-1] for w in warned] == [f"{name}=" for name in new]
    now = geomag.FieldNavigator(GRID, **given, **sigmas, **new)
    assert before.__reduce__()[1][-1] == now.__reduce__()[1][-1]
    assert now.__reduce__()[1][-1] != geomag.FieldNavigator(GRID, **given, **sigmas).__reduce__()[1][-1]
    ukf = geomag.UnscentedKalmanFilter([0.0], [[1.0]])
    with pytest.warns(DeprecationWarning, match="max_nis"):
        assert ukf.update([100.0], [[1.0]], 1.0, gate=9.0) is False
    ekf = geomag.ExtendedKalmanFilter([0.0], [[1.0]])
    with pytest.warns(DeprecationWarning, match="max_nis"):
        assert ekf.update([100.0], [0.0], [[1.0]], 1.0, gate=9.0) is False


def test_parts_serve_every_matcher():
    box = geomag.SearchBox(half_width_m=400.0, step_m=50.0)
    by_part, by_name = (
        geomag.match_grid(GRID, TRACK, **o) for o in ({"search": box}, {"half_width": 400.0, "step": 50.0})
    )
    assert (by_part.score, by_part.offset_m) == (by_name.score, by_name.offset_m)
    iema = [
        geomag.Iema(GRID, 1.0, tolerance_m=100.0, **o) for o in ({"search": box}, {"half_width": 400.0, "step": 50.0})
    ]
    assert iema[0].__reduce__()[1][1] == iema[1].__reduce__()[1][1]
    assert iema[0].n_feasible == 17 * 17
    parts = {
        "search": box,
        "prior": geomag.InsPrior(heading_sigma_deg=1.0, scale_sigma=0.01),
        "accept": geomag.Acceptance(tolerance_m=120.0, max_risk=0.05, min_overlap=0.7),
    }
    names = {"half_width_m": 400.0, "step_m": 50.0, "heading_sigma_deg": 1.0, "scale_sigma": 0.01, "tolerance_m": 120.0,
             "max_risk": 0.05, "min_overlap": 0.7}  # fmt: skip
    common = {"starts": "grid", "refine": True, "sigma": 0.5, "offset_sigma_m": 200.0}
    fixes = [geomag.match_contour(GRID, TRACK, **common, **o) for o in (parts, names)]
    assert fixes[0].risk == fixes[1].risk
    assert fixes[0].covariance_m2.tolist() == fixes[1].covariance_m2.tolist()
    windows = [geomag.SlidingContour(GRID, length=9, **common, **o) for o in (parts, names)]
    assert windows[0].__reduce__()[1][1] == windows[1].__reduce__()[1][1]
    with pytest.raises(geomag.InvalidInputError, match="not both"):
        geomag.match_contour(GRID, TRACK, heading_sigma_deg=2.0, **parts)
    for part in ({"prior": geomag.InsPrior(drift_sigma_m=5.0)}, {"accept": geomag.Acceptance(misfit_threshold=9.0)}):
        with pytest.raises(geomag.InvalidInputError, match="none with contours"):
            geomag.match_contour(GRID, TRACK, **part)


def test_a_tolerance_is_what_counts_as_wrong():
    common = {"starts": "grid", "half_width_m": 400.0, "refine": True, "sigma": 0.5}
    with pytest.warns(DeprecationWarning, match="tolerance_m"):
        old = geomag.match_contour(GRID, TRACK, fix_radius_m=120.0, **common)
    assert old.risk == geomag.match_contour(GRID, TRACK, tolerance_m=120.0, **common).risk
    with pytest.warns(DeprecationWarning, match="gate_sigmas"):
        old = geomag.Iema(GRID, 1.0, half_width=100.0, gate=2.0)
    assert old.__reduce__()[1][1] == geomag.Iema(GRID, 1.0, half_width=100.0, gate_sigmas=2.0).__reduce__()[1][1]


@pytest.mark.parametrize("name", ["max_iterations", "acceleration", "min_points", "keep_starts", "max_candidates"])
def test_counts_below_zero_are_named(name):
    with pytest.raises(geomag.InvalidInputError, match=rf"{name}: needed a whole number >= 0, got -3"):
        geomag.match_contour(GRID, TRACK, **{name: -3})
