"""What options may be: callbacks of typer, so that every refusal names the option and comes before any work."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Any

import typer

from geomag._errors import InvalidInputError

#: Largest seed that Rust and NumPy both take.
MAX_SEED = 2**63 - 1
_PICTURES = (".png", ".svg", ".pdf")


def _check(needed: str, good: Callable[[float], bool]) -> Callable[[typer.CallbackParam, Any], Any]:
    """A callback that wants every number of an option to be finite and good."""

    def check(param: typer.CallbackParam, value: Any) -> Any:  # noqa: ANN401 - a number or a list
        for number in value if isinstance(value, (list, tuple)) else [value]:
            if number is not None and not (math.isfinite(number) and good(number)):
                raise InvalidInputError(f"{param.opts[0]}: needed {needed}, got {number:g}")
        return value

    return check


positive = _check("a number > 0", lambda v: v > 0)
not_negative = _check("a number >= 0", lambda v: v >= 0)
share = _check("a share in [0, 1]", lambda v: 0 <= v <= 1)
half_turn = _check("degrees in [0, 180]", lambda v: 0 <= v <= 180)
direction = _check("degrees in [-360, 360]", lambda v: abs(v) <= 360)


def _writable(option: str, path: Path) -> None:
    if path.is_dir():
        raise InvalidInputError(f"{option}: needed a file, got the folder {path}")
    if path.exists() and not path.is_file():
        return  # a pipe or a device
    if not path.parent.is_dir():
        raise InvalidInputError(f"{option}: needed a folder that is there, got {path.parent} (for {path.name})")
    new = not path.exists()
    try:
        with path.open("ab"):
            pass
        if new:
            path.unlink()
    except OSError as error:
        raise InvalidInputError(f"{option}: needed a file that can be written, got {path}: {error.strerror}") from error


def output(param: typer.CallbackParam, value: Path | None) -> Path | None:
    """A file that can be written, in a folder that is there: a mistyped path makes none."""
    if value is not None:
        _writable(param.opts[0], value)
    return value


def picture(param: typer.CallbackParam, value: Path | None) -> Path | None:
    """The same for a picture, whose kind is its ending."""
    if value is not None and value.suffix.lower() not in _PICTURES:
        raise InvalidInputError(
            f"{param.opts[0]}: needed a name ending in .png, .svg or .pdf, got '{value.suffix}' ({value.name})"
        )
    return output(param, value)


#: How the library says it, and how one does it here.
_WORDS: Iterable[tuple[str, str]] = (
    (r"pass geographic=True or geographic=False", "give --geographic or --no-geographic"),
    (r"\bgeographic=True\b", "--geographic"),
    (r"\bgeographic=False\b", "--no-geographic"),
    (r"columns=\((\w+), (\w+), (\w+)\)", r"--columns \1,\2,\3"),
    (r"missing='drop' leaves them out", "--drop-missing leaves them out"),
    (
        r"max_candidates allows (\d+); raise it, enlarge the step or shrink the search",
        r"the limit is \1; shrink the search",
    ),
)
#: An argument named as such, or at the head of a message.
_ARGUMENT = re.compile(r"\b([a-z]+(?:_[a-z0-9]+)*)=(?=[\s,.;:)]|$)|^([a-z]+(?:_[a-z0-9]+)+)(?=[ :])")


def in_options(message: str, options: Collection[str]) -> str:
    """A message of the library in the words of the command line, which has these `options` (`--half-width-m`)."""
    for python, here in _WORDS:
        message = re.sub(python, here, message)

    def named(found: re.Match[str]) -> str:
        option = "--" + (found[1] or found[2]).replace("_", "-")
        return option if option in options else found[0]

    return _ARGUMENT.sub(named, message).replace("\n", " ")
