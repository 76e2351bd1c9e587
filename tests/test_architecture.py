"""Arrows go down only: which floor may use which, read from the sources."""

from __future__ import annotations

import functools
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "rust" / "geomag-core" / "src"

#: Lowest floor first; modules of one group may use each other.
FLOORS = [
    {"error", "constants", "bounds", "table"},
    {"instructions", "monitor", "random", "state", "statistics", "compensation"},
    {"frame", "field", "grid", "map_error", "gridding", "information", "stack", "track", "fix"},
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
    # Test modules in files of their own may use what stands above.
    if own == "lib" or path.stem.startswith("tests"):
        return
    assert own in LEVEL, f"module {own} stands on no floor: name it in FLOORS and in docs/architecture.md"
    for used in {reached[0] for reached in arrows(path)}:
        if used in LEVEL:
            assert LEVEL[used] <= LEVEL[own], f"{path.relative_to(ROOT)} uses {used}, which lies above {own}"


#: Floors inside `matching`, lowest first.
MATCHING = [
    {"closest", "transform", "similarity", "stream", "sequence"},
    {"scene"},
    {"starts", "refine"},
    {"contour", "grid_search", "iema", "posterior"},
    {"sliding"},
    {"tuning"},
]


#: Floors inside `matching/posterior`, lowest first; on each, from left to right, the later may use the earlier.
POSTERIOR = [
    ["options", "lattice", "patch"],
    ["noise", "nuisance"],
    ["kernel", "goodness", "problem"],
    ["density", "reference", "search"],
    ["misfit", "decide", "streaming", "batch", "predict"],
]


#: The same of `navigation/navigator`.
NAVIGATOR = [
    ["ins", "motion", "owed", "states", "outcome", "integrity", "doubt"],
    ["plan", "options", "law", "batch", "filter", "smooth", "watch"],
    ["state"],
    ["carry", "judge", "measure", "correct", "matcher"],
    ["step", "bound", "particles", "flight"],
]
#: Folders whose own file only says what is in them, and the floors inside.
SPLIT = ("patch", "kernel", "problem", "streaming")
FLOORED = {"matching/posterior": POSTERIOR, "navigation/navigator": NAVIGATOR}


def paths(text):
    """Every path that a text names from `crate`, `super` or `self`, those in the braces of a `use` written out."""

    def tree(at, before):
        """Paths of the tree that begins at a place, and where it ends."""
        found = []
        while True:
            if text[at] == "{":
                at += 1
                while text[at] != "}":
                    inner, at = tree(at, before)
                    found += inner
                    at = re.compile(r"[\s,]*").match(text, at).end()
                return found, at + 1
            name = re.compile(r"\s*([\w*]+)(?:\s+as\s+\w+)?\s*(::)?\s*(?=([{\w*])?)").match(text, at)
            if name is None:
                return [*found, before], at
            before, at = (*before, name[1]), name.end()
            if not (name[2] and name[3]):
                return [*found, before], at

    found = []
    for start in re.finditer(r"(?<![\w:])(crate|super|self)::(?=[\s\w{*])", text):
        found += tree(start.end(), (start[1],))[0]
    return set(found)


def module(path):
    """The module that a file is, as a tuple of names."""
    relative = path.relative_to(CORE).with_suffix("")
    return tuple(part for part in relative.parts if part not in ("mod", "lib"))


def resolved(named, own):
    """A path from the crate's root, as seen from a module."""
    while named and named[0] in ("crate", "self", "super"):
        own = {"crate": (), "self": own, "super": own[:-1]}[named[0]]
        named = named[1:]
    return own + named


def through_what_is_handed_on(path):
    """A path with the names that a folder's own file hands on followed to the module that has them."""
    for depth in range(1, len(path)):
        owner = CORE.joinpath(*path[:depth]) / "mod.rs"
        target = handed_on(owner).get(path[depth], path) if owner.exists() else path
        if target[: depth + 1] != path[: depth + 1]:  # a module may bear the name of what it hands on
            return through_what_is_handed_on(target)
    return path


def arrows(file):
    """Paths from the crate's root of all that a file names."""
    text = without_tests_and_comments(file.read_text(encoding="utf-8"))
    found = {through_what_is_handed_on(resolved(named, module(file))) for named in paths(text)}
    return {path for path in found if path}


@functools.cache
def handed_on(file):
    """Name -> its path, of what a file hands on with `pub use` from the modules below it."""
    text, own = without_tests_and_comments(file.read_text(encoding="utf-8")), module(file)
    names = {}
    for use in re.finditer(r"\bpub(?:\([\w ]+\))? use ([^;]+);", text):
        start = use[1] if re.match(r"(?:crate|self|super)\b", use[1]) else f"self::{use[1]}"
        for named in paths(start):
            path = resolved(named, own)
            if len(path) > len(own) + 1 and path[: len(own)] == own:
                names[path[-1]] = path
    return names


def siblings(folder):
    """Which modules of a folder use which: module -> those that it names, through `super`, its own path or `use`."""
    inside = {path.stem: [path] for path in folder.glob("*.rs") if path.stem not in ("mod", "tests")}
    for path in folder.glob("*/**/*.rs"):
        inside.setdefault(path.relative_to(folder).parts[0], []).append(path)
    inside = {name: paths for name, paths in inside.items() if not name.startswith("tests")}
    at = folder.relative_to(CORE).parts
    uses = {}
    for name, files in inside.items():
        reached = {path[len(at)] for file in files for path in arrows(file) if path[: len(at)] == at and path != at}
        uses[name] = {other for other in reached if other in inside and other != name}
    return uses


@pytest.mark.parametrize(
    "name",
    [
        "matching",
        "matching/grid_search",
        "matching/contour",
        "matching/refine",
        "matching/posterior",
        "matching/posterior/patch",
        "matching/posterior/kernel",
        "matching/posterior/problem",
        "matching/posterior/streaming",
        "navigation",
        "navigation/navigator",
        "kalman",
        "lattice",
        "grid",
    ],
)
def test_no_circle_among_the_modules_of_a_folder(name):
    uses = siblings(CORE / name)
    assert any(uses.values()), "nothing was read"
    left = dict(uses)
    while left:
        free = [module for module, others in left.items() if not others & set(left)]
        assert free, f"a circle among {sorted(left)}: {left}"
        for module in free:
            del left[module]


def test_arrows_go_down_inside_matching():
    level = {name: k for k, floor in enumerate(MATCHING) for name in floor}
    uses = siblings(CORE / "matching")
    assert set(uses) == set(level), "name a new module in MATCHING and in docs/architecture.md"
    for name, others in uses.items():
        for other in others:
            assert level[other] < level[name], f"matching/{name} uses {other}, which does not lie below it"
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for floor in MATCHING:
        assert any(all(re.search(rf"\b{module}\b", line) for module in floor) for line in page.splitlines()), floor


@pytest.mark.parametrize("name", FLOORED)
def test_arrows_go_down_inside_a_folder_with_floors(name):
    order = {module: k for k, module in enumerate(module for floor in FLOORED[name] for module in floor)}
    uses = siblings(CORE / name)
    assert set(uses) == set(order), "name a new module in the floors above and in docs/architecture.md"
    for module, others in uses.items():
        for other in others:
            assert order[other] < order[module], f"{name}/{module} uses {other}, which does not lie below it"
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for floor in FLOORED[name]:
        assert re.search(rf"^{' '.join(floor)} ", page, re.M), f"docs/architecture.md does not show {floor}"


@pytest.mark.parametrize("name", [*FLOORED, *(f"matching/posterior/{n}" for n in SPLIT)])
def test_the_parts_of_a_folder_take_nothing_from_its_own_file(name):
    # It only says what is in it: what its parts share stands in one of them.
    text = without_tests_and_comments((CORE / name / "mod.rs").read_text(encoding="utf-8"))
    assert not re.search(r"^\s*(?:pub\S* )?(?:fn|struct|enum|impl|const|trait)\b", text, re.M)


@pytest.mark.parametrize(
    "use",
    [
        "use super::decide::answer;",
        "use super::{noise::Level, decide::{self, answer}};",
        "use super::super::posterior::decide::answer;",
        "use crate::{error::Error, matching::posterior::{decide::answer, noise}};",
        "use crate::{\n    error::Error,\n    matching::{\n        posterior::decide,\n    },\n};",
        "use crate::matching::posterior::decide as last;",
        "use super::decide::*;",
        "fn f() -> X { crate::matching::posterior::decide::answer() }",
        "fn f() -> X { self::super::decide::answer() }",
    ],
)
def test_an_upward_arrow_is_seen_however_it_is_written(use):
    own = ("matching", "posterior", "lattice")
    assert ("matching", "posterior", "decide") in {resolved(named, own)[:3] for named in paths(use)}
    assert not {resolved(named, own)[:3] for named in paths("use super::noise::decide; let x = y.decide;")} & {
        ("matching", "posterior", "decide")
    }


def test_a_name_that_a_folder_hands_on_is_an_arrow_to_who_has_it():
    assert through_what_is_handed_on(("matching", "posterior", "PosteriorMatcher")) == (
        *("matching", "posterior", "streaming", "matcher", "PosteriorMatcher"),
    )
    assert through_what_is_handed_on(("matching", "posterior", "match_many")) == (
        *("matching", "posterior", "batch", "match_many"),
    )


def test_kalman_knows_no_field():
    for path in (CORE / "kalman").rglob("*.rs"):
        used = {reached[0] for reached in arrows(path)}
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


def test_one_name_means_one_type():
    """Somebody who reads `State` or `Candidate` in one room is not to think of that in another."""
    declared = re.compile(
        r"^ *(?:pub(?:\([\w: ]+\))? )?(?:struct|enum|trait|union) (\w+)|^(?:pub(?:\([\w: ]+\))? )?type (\w+)", re.M
    )
    places: dict[str, list[str]] = {}
    for path in sorted((ROOT / "rust" / "geomag-core" / "src").rglob("*.rs")):
        if not path.stem.startswith("tests"):
            code = path.read_text(encoding="utf-8").split("\n#[cfg(test)]\nmod tests {")[0]
            code = re.sub(r"^ *//.*$", "", code, flags=re.M)
            for name in (a or b for a, b in declared.findall(code)):
                places.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert len(places) > 200
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
