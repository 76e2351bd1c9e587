"""What is installed, and the record that a run leaves beside its result."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from geomag._geomag import __version__

_OPTIONAL = (
    "numpy", "xarray", "netCDF4", "rasterio", "pandas", "pyarrow", "matplotlib", "typer", "rich", "ppigrf", "boule",
    "verde", "scipy", "dask", "distributed", "geopandas", "pyogrio", "pyproj",
)  # fmt: skip


def versions() -> dict[str, str | None]:
    """Return the versions of geomag, Python, the system and the libraries that geomag can use; None where absent."""
    # Here, because this import alone takes longer than all of geomag's.
    from importlib.metadata import PackageNotFoundError, version

    found: dict[str, str | None] = {
        "geomag": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }
    for name in _OPTIONAL:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def clash() -> str | None:
    """Return a warning where the older package `geomag` stands in the same folder as this one, else None.

    The package index has had another package of that name (a world magnetic model, last released in 2015) since long before this
    one, which is therefore installed as `geomag-nav`. Both are imported as `geomag`: whichever was installed last has overwritten files
    of the other.
    """
    from importlib.metadata import PackageNotFoundError, version

    try:
        other = version("geomag")
    except PackageNotFoundError:
        return None
    return (
        f"the package 'geomag' {other} is installed too; it has the same import name as 'geomag-nav', and files of the two are mixed: "
        "pip uninstall geomag geomag-nav, then pip install geomag-nav"
    )


def show_versions() -> None:
    """Print what is installed: paste it into a bug report. Warns where the older package of the same import name is installed.

    >>> import geomag
    >>> geomag.show_versions()  # doctest: +ELLIPSIS
    geomag ...
    """
    found = versions()
    width = max(map(len, found))
    for name, value in found.items():
        sys.stdout.write(f"{name:<{width}}  {value or 'not installed'}\n")
    warning = clash()
    if warning is not None:
        sys.stdout.write(f"warning: {warning}\n")


def write_record(
    path: str | PathLike[str], settings: Mapping[str, Any], *, command: str | None = None, result: object = None
) -> Path:
    """Write a run's settings, versions and result as JSON, to be kept beside what the run made.

    Parameters
    ----------
    path : of the record, ending in .json.
    settings : what the run was told; plain values, paths become text.
    command : the command line, where there was one.
    result : what came out, for example `fix.to_dict()`.
    """
    record: dict[str, Any] = {"settings": dict(settings), "versions": {k: v for k, v in versions().items() if v}}
    if command is not None:
        record["command"] = command
    if result is not None:
        record["result"] = result
    target = Path(path)
    target.write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
    return target
