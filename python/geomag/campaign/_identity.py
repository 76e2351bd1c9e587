"""By what a method is known again in a folder of results."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Mapping
from functools import partial
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag.campaign._methods import Keyed, Method, _json_of


def _feed(digest: Any, value: object) -> None:  # noqa: ANN401 - hashlib's type has no public name
    """Add a value to a digest, kinds and lengths included, so that no two values run together."""
    digest.update(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, (tuple, list)):
        digest.update(str(len(value)).encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(value, Mapping):
        _feed(digest, sorted(value.items()))
    elif isinstance(value, bytes):
        digest.update(f"{len(value)}:".encode())
        digest.update(value)
    elif isinstance(value, frozenset):  # of constants; its order changes from run to run
        _feed(digest, sorted(map(repr, value)))
    elif isinstance(value, CodeType):
        _feed(digest, (value.co_code, value.co_names, value.co_consts))
    else:
        digest.update(f"{value!r};".encode())


def _digest(value: object) -> str:
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _identity(name: str, matcher: object) -> object:
    """What a method is known by in a folder of results, plain values."""
    if isinstance(matcher, Method):
        return {matcher.kind: json.loads(_json_of(name, matcher.options))}
    if isinstance(matcher, Keyed):
        return {"key": matcher.key}
    if isinstance(matcher, partial):
        inner = _identity(name, matcher.func)
        return {"partial": inner, "arguments": _pickled(name, (matcher.args, sorted(matcher.keywords.items())))}
    if isinstance(matcher, FunctionType):
        if "<" in matcher.__qualname__ or matcher.__closure__:
            raise _unknown(name, matcher, "one of many that its name may stand for")
        code = _digest(matcher.__code__)
        defaults = _pickled(name, (matcher.__defaults__, matcher.__kwdefaults__))
        return {"function": f"{matcher.__module__}.{matcher.__qualname__}", "code": code, "defaults": defaults}
    call = getattr(matcher, "__func__", None) or vars(type(matcher)).get("__call__")
    code = _digest(call.__code__) if isinstance(call, FunctionType) else ""
    return {"object": type(matcher).__qualname__, "code": code, "state": _pickled(name, matcher)}


def _pickled(name: str, value: object) -> str:
    try:
        return hashlib.sha256(pickle.dumps(value, protocol=5)).hexdigest()
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise _unknown(name, value, str(error)) from error


def _unknown(name: str, matcher: object, why: str) -> InvalidInputError:
    return InvalidInputError(
        f"method {name!r}: needed, to be known again in a folder, a function of a module, a partial of one, a callable "
        f"object that pickles, or campaign.Keyed(key, matcher), got {matcher!r} ({why})"
    )
