"""Optional libraries: imported where they are needed, with an error that names the extra."""

from __future__ import annotations

import importlib
from types import ModuleType

from geomag._errors import MissingDependencyError


def require(module: str, extra: str, purpose: str) -> ModuleType:
    """Import `module`, or say which extra of geomag-nav brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f"{purpose}: needed the library '{module}', which is not installed ({error}); "
            f"install it with: pip install 'geomag-nav[{extra}]'"
        ) from error
