"""Write the argument lists of the stub from what the module says of itself: `python rust/geomag-py/stub.py [--check]`.

Names, defaults and types come from the signatures and docstrings of the compiled module, which come from the tables of options in the
core. What else stands in the stub is written by hand.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path
from typing import Any

import geomag._geomag as module

STUB = Path(__file__).resolve().parents[2] / "python" / "geomag" / "_geomag.pyi"
#: Calls and classes whose arguments are written by the tables.
CALLS = ["match_posterior", "match_posterior_many", "predict_many", "match_grid", "match_contour"]
CLASSES = ["PosteriorMatcher", "SlidingContour", "Iema", "InsFeedback", "FieldNavigator", "UnscentedKalmanFilter"]
#: Frozen objects that are nothing but their arguments.
PARTS = ["SearchBox", "InsPrior", "Acceptance", "InsModel", "MatcherPlan"]

#: Classes that hand on their keywords, and the dictionary that types these.
KEYWORDS = {"Navigator": "_NavigatorOptions"}

#: Types as docstrings name them, and as the stub does.
TYPES = {
    "GridMap, MapStack or HarmonicMap": "_Field",
    "float or (float, float)": "_Pair",
    "sequence of (GridMap, values, sigma)": "Sequence[_Channel]",
    "sequence of Track": "Sequence[Track]",
    "bool or callable": "_Progress",
    "array of shape (n,)": "ArrayLike",
    "sequence of float": "ArrayLike",
    "GridMap or MapStack": "GridMap | MapStack",
    "{'rigid', 'translation', 'similarity', 'affine'}": "_Transform",
    "{'indicated', 'grid'} or array of shape (n, 2)": 'Literal["indicated", "grid"] | ArrayLike',
    "array of shape (m, m)": "ArrayLike",
    "float or array of shape (2, 2)": "ArrayLike",
    "array of shape (n, n)": "ArrayLike",
    "float or array of shape (3,)": "ArrayLike",
    "float, array of shape (2,) or (2, 2)": "ArrayLike",
    "array of shape (3,)": "ArrayLike",
    "(float, float)": "Sequence[float] | _Floats",
    "RectangularHarmonicModel, GridMap, MapStack, HarmonicMap or FieldSensor": (
        "RectangularHarmonicModel | GridMap | MapStack | HarmonicMap | FieldSensor"
    ),
    "reading of FieldSensor": "_Reading",
    "MatcherPlan, 'default' or None": 'MatcherPlan | Literal["default"] | None',
}


def stub_type(documented: str, default: object) -> str:
    """Return the type of an argument that numpydoc describes so, with None where it is the default."""
    said = documented.removesuffix(", optional")
    kind = TYPES.get(said, f"Literal[{said[1:-1]}]" if said.startswith("{") else said).replace("'", '"')
    return kind if default is not None or kind == "_Progress" else f"{kind} | None"


def documented_types(text: str) -> dict[str, str]:
    """Return what the parameters section of a docstring says of every argument's type."""
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", text, re.M | re.S)
    found: dict[str, str] = {}
    for names, kind in re.findall(r"^(\w[\w, ]*) : (.+)$", section.group(1) if section else "", re.M):
        found |= dict.fromkeys(names.split(", "), kind)
    return found


def said(default: object) -> str:
    """Return a default as the stub writes it."""
    if isinstance(default, str):
        return f'"{default}"'
    if default is ...:  # a value that the signature cannot write
        return "..."
    return f"{default:_}" if isinstance(default, int) and not isinstance(default, bool) else repr(default)


def arguments(thing: Any, indent: str, first: str = "") -> str:  # noqa: ANN401 - a function or a class
    """Return the argument list of a call, one a line."""
    types = documented_types(inspect.cleandoc(thing.__doc__))
    lines, keyword = [first] if first else [], False
    for name, parameter in inspect.signature(thing).parameters.items():
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword:
            lines.append("*")
            keyword = True
        if name not in types:
            raise ValueError(f"{thing.__name__}: the docstring says nothing of {name}")
        required = parameter.default is parameter.empty
        unwritten = parameter.default is ... and types[name].endswith(", optional")
        kind = stub_type(types[name], ... if required else None if unwritten else parameter.default)
        lines.append(f"{name}: {kind}" + ("" if required else f" = {said(parameter.default)}"))
    return "".join(f"{indent}{line},\n" for line in lines)


def part(name: str) -> str:
    """Return the whole class of a part."""
    thing = getattr(module, name)
    types = documented_types(inspect.cleandoc(thing.__doc__))
    text = f"@final\nclass {name}:\n    def __new__(\n{arguments(thing, ' ' * 8, 'cls')}    ) -> {name}: ...\n"
    for made, how in vars(thing).items():
        if isinstance(how, staticmethod) and not made.startswith("_"):
            text += f"    @staticmethod\n    def {made}() -> {name}: ...\n"
    for field, parameter in inspect.signature(thing).parameters.items():
        kind = stub_type(types[field], parameter.default).replace("_Pair", "tuple[float, float]")
        text += f"    @property\n    def {field}(self) -> {kind}: ...\n"
    text += "    def to_dict(self) -> dict[str, Any]: ...\n    def __eq__(self, other: object, /) -> bool: ...\n"
    text += "    def __ne__(self, other: object, /) -> bool: ...\n"
    text += "    def __reduce__(self) -> tuple[Any, ...]: ...\n"
    return text + f"    @classmethod\n    def _restore(cls, values: dict[str, Any]) -> {name}: ...\n\n"


def keywords(name: str) -> str:
    """Return the typed dictionary of a class's keywords."""
    types = documented_types(inspect.cleandoc(getattr(module, name).__doc__))
    text = f"class {KEYWORDS[name]}(TypedDict, total=False):\n"
    for keyword, kind in types.items():
        if keyword != "grid":
            text += f"    {keyword}: {stub_type(kind, None if kind.endswith(', optional') else ...)}\n"
    return text + "\n"


def written(text: str) -> str:
    """Return the stub with the argument lists that the module has now."""
    for name in CALLS:
        now = f"def {name}(\n{arguments(getattr(module, name), '    ')}) ->"
        text = re.sub(rf"^def {name}\(.*?\) ->", lambda _, now=now: now, text, count=1, flags=re.M | re.S)
    for name in CLASSES:
        now = f"class {name}:\n    def __new__(\n{arguments(getattr(module, name), ' ' * 8, 'cls')}    ) ->"
        before = rf"^class {name}:\n    def __new__\(.*?\) ->"
        text = re.sub(before, lambda _, now=now: now, text, count=1, flags=re.M | re.S)
    for name in PARTS:
        now = part(name)
        text = re.sub(rf"^@final\nclass {name}:\n.*?(?=^\S)", lambda _, now=now: now, text, count=1, flags=re.M | re.S)
    for name, dictionary in KEYWORDS.items():
        now = keywords(name)
        before = rf"^class {dictionary}\(.*?(?=^\S)"
        text = re.sub(before, lambda _, now=now: now, text, count=1, flags=re.M | re.S)
    return text


if __name__ == "__main__":
    before = STUB.read_text(encoding="utf-8")
    after = written(before)
    if "--check" in sys.argv[1:]:
        sys.exit(0 if after == before else f"{STUB.name} is not what the module says: run {Path(__file__).name}")
    STUB.write_text(after, encoding="utf-8")
