"""Every example in a docstring of the installed package runs as it stands, bindings too, and prints what it says."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import geomag

REFERENCE = Path(__file__).resolve().parents[1] / "docs" / "api" / "python.md"
#: What an example needs beyond NumPy, by a word that is in it.
LIBRARIES = {"GravityReduction": "boule", "MagneticReduction": "ppigrf", "xarray": "xarray", "read_": "pandas"}


def modules() -> Iterator[object]:
    yield geomag
    for found in pkgutil.walk_packages(geomag.__path__, "geomag."):
        if not found.name.startswith(("geomag.cli", "geomag.reproduce", "geomag.__main__")):
            try:
                yield importlib.import_module(found.name)
            except ImportError:  # an extra that is not installed
                continue


def documented() -> dict[str, str]:
    """Docstrings with examples by name: modules, their classes and functions, the members of those classes."""
    found: dict[str, str] = {}
    seen: set[int] = set()
    for module in modules():
        things = [(module.__name__, module)]
        for name, thing in vars(module).items():
            ours = str(getattr(thing, "__module__", "")).startswith("geomag")
            if not ours or not (inspect.isclass(thing) or inspect.isroutine(thing)) or id(thing) in seen:
                continue
            seen.add(id(thing))
            things.append((f"{module.__name__}.{name}", thing))
            if inspect.isclass(thing):
                things += [(f"{module.__name__}.{name}.{m}", getattr(thing, m, None)) for m in vars(thing)]
        for name, thing in things:
            text = getattr(thing, "__doc__", None)
            if isinstance(text, str) and ">>>" in text:
                found[name] = inspect.cleandoc(text)
    return found


DOCUMENTED = documented()


@pytest.mark.parametrize("name", sorted(DOCUMENTED))
def test_every_example_prints_what_it_says(name):
    text = DOCUMENTED[name]
    for word, library in LIBRARIES.items():
        if word in text:
            pytest.importorskip(library)
    # No names but the builtin ones: a reader has none either.
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    told: list[str] = []
    doctest.DocTestRunner(verbose=False).run(example, out=told.append)
    assert not told, "".join(told)


def test_the_examples_were_found_in_both_languages():
    assert {"geomag.GridMap", "geomag.RectangularHarmonicModel.fit", "geomag.read_grid"} <= set(DOCUMENTED)


def test_every_public_name_says_what_it_is():
    """By way of the class: a static method of the bindings without a docstring looks documented from `vars`."""
    silent = []
    for name in geomag.__all__:
        thing = getattr(geomag, name)
        if not (inspect.isclass(thing) or inspect.isroutine(thing)):
            continue
        members = vars(thing) if inspect.isclass(thing) and thing.__module__.startswith("geomag") else ()
        # A field of a dataclass that is None by default is told of among the attributes of its class.
        public = [m for m in members if not m.startswith("_") and getattr(thing, m) is not None]
        silent += [f"{name}.{m}" for m in public if not (getattr(thing, m).__doc__ or "").strip()]
        if not (thing.__doc__ or "").strip():
            silent.append(name)
    assert silent == []


def test_every_public_name_is_in_the_reference():
    text = REFERENCE.read_text(encoding="utf-8")
    listed = [line.split("::")[1].strip() for line in text.splitlines() if line.startswith(".. ")]
    missing = [
        name
        for name in geomag.__all__
        if f"geomag.{name}" not in listed and getattr(getattr(geomag, name), "__module__", None) not in listed
    ]
    public = [m.name for m in pkgutil.iter_modules(geomag.__path__) if not m.name.startswith("_")]
    # Commands have a page of their own; `io` is listed by its functions.
    missing += [m for m in public if m not in {"cli", "io", "reproduce"} and f"geomag.{m}" not in listed]
    assert missing == []
