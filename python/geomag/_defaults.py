"""Defaults of the options of the matchers, asked of the matchers themselves."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any


def default_of(call: Callable[..., Any], option: str) -> Any:  # noqa: ANN401 - options are of any type
    """Return the default that `option` has in the signature of `call`: whoever hands options on states none of its own."""
    return inspect.signature(call).parameters[option].default
