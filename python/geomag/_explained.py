"""What the compiled module says of its options, so that help texts need not say it again."""

from __future__ import annotations

import inspect
import re


def explained(thing: object, option: str) -> str:
    """Return the explanation of an option, one line, from the docstring of the call or class that takes it."""
    text = inspect.cleandoc(getattr(thing, "__doc__", None) or "")
    found = re.search(rf"^{option} : .+\n((?:    .+\n)+)", text + "\n", re.M)
    if found is None:
        raise KeyError(option)
    return " ".join(found.group(1).split())
