"""Which dimension of an array is x and which is y, and in what: from axis, standard_name, units, names and grid mapping (CF conventions)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from geomag._errors import InvalidInputError
from geomag.io._names import understand
from geomag.io._units import METRES, check_sense, crs_of, is_degree, tidy

_STANDARD = {"longitude": ("x", True), "latitude": ("y", True), "projection_x_coordinate": ("x", False),
             "projection_y_coordinate": ("y", False)}  # fmt: skip


def _role(name: str, attributes: Mapping[str, Any], where: str) -> tuple[str | None, bool | None]:
    """'x' or 'y' and whether in degrees, of what a coordinate says of itself; what it says must agree."""
    said: list[tuple[str, str]] = []
    geographic: bool | None = None
    standard = str(attributes.get("standard_name", "")).strip().lower()
    if standard.startswith("grid_l"):
        raise InvalidInputError(
            f"{where}: needed longitude and latitude, got the rotated coordinate '{name}' ({standard})"
        )
    if standard in _STANDARD:
        role, geographic = _STANDARD[standard]
        said.append((role, f"standard_name {standard}"))
    axis = str(attributes.get("axis", "")).strip().lower()
    if axis in ("x", "y"):
        said.append((axis, f"axis {axis.upper()}"))
    unit = tidy(str(attributes.get("units", "")))
    for ending, role in (("east", "x"), ("_e", "x"), ("north", "y"), ("_n", "y")):
        if unit.startswith("deg") and unit.endswith(ending):
            said.append((role, f"units {unit}"))
            geographic = True
    if not said:
        for text in (name, str(attributes.get("long_name", ""))):
            column = understand(0, text) if text else None
            if column is not None and column.kind in ("x", "y"):
                said.append((column.kind, f"name {text}"))
                geographic = None if column.system is None else column.system == "geographic"
                break
    if len({role for role, _ in said}) > 1:
        raise InvalidInputError(
            f"{where}: needed one meaning of coordinate '{name}', got {' but '.join(w for _, w in said)}"
        )
    if geographic is None and not said:
        return None, None
    return said[0][0], geographic


def find_axes(
    dims: tuple[str, str],
    attributes: Mapping[str, Mapping[str, Any]],
    where: str,
    x: str | None = None,
    y: str | None = None,
) -> tuple[str, str, bool | None]:
    """Names of the x and y dimensions, and whether names or standard names make them degrees (None: they do not say)."""
    for what, asked in (("x", x), ("y", y)):
        if asked is not None and asked not in dims:
            raise InvalidInputError(f"{where}: needed {what}= among {', '.join(dims)}, got '{asked}'")
    roles = {d: _role(d, attributes[d], where) for d in dims}
    told = {d: r for d, (r, _) in roles.items() if r is not None}
    if x is not None or y is not None:
        x = x if x is not None else next(d for d in dims if d != y)
        y = next(d for d in dims if d != x) if y is None else y
        if x == y:
            raise InvalidInputError(f"{where}: needed different dimensions for x and y, got '{x}' for both")
    elif not told:
        raise InvalidInputError(
            f"{where}: needed to know which of its dimensions {', '.join(dims)} is x, got neither axis, units, standard names nor "
            "names that say so; name it with x="
        )
    else:
        first = next(iter(told))
        other = next(d for d in dims if d != first)
        if told.get(other) == told[first]:
            raise InvalidInputError(
                f"{where}: needed one dimension for x and one for y, got {told[first]} for both {', '.join(dims)}"
            )
        x, y = (first, other) if told[first] == "x" else (other, first)
    kinds = {g for d in (x, y) if (g := roles[d][1]) is not None}
    if len(kinds) > 1:
        raise InvalidInputError(f"{where}: needed x and y in degrees, or both in metres, got '{x}' and '{y}'")
    return x, y, next(iter(kinds), None)


def kind_of(
    units: tuple[str | None, str | None],
    named: bool | None,
    crs: Any,  # noqa: ANN401 - rasterio's
    told: bool | None,
    where: str,
) -> bool:
    """Whether coordinates are degrees: units, then system, then names, then what the caller says; contradictions are refused."""
    for unit in units:
        check_sense(unit or "", where)
    degrees = [is_degree(u) for u in units if u and u.strip()]
    lengths = [tidy(u) in METRES for u in units if u and u.strip()]
    said: bool | None = None
    if degrees and any(degrees):
        if not all(degrees) or len(degrees) != 2:
            raise InvalidInputError(f"{where}: needed x and y in degrees, or both in metres, got units {units}")
        said = True
    elif lengths and all(lengths):
        said = False
    system = None if crs is None else bool(crs.is_geographic)
    words = {True: "degrees", False: "metres"}
    if said is not None and system is not None and said != system:
        raise InvalidInputError(
            f"{where}: needed units that fit its coordinate reference system, got {units} and {words[system]}"
        )
    if said is None:
        said = system
    if said is None and not (degrees or lengths):
        said = named
    elif said is not None and named is not None and said != named:
        raise InvalidInputError(f"{where}: needed units that fit the names of its coordinates, got {units}")
    if said is None and (degrees or lengths):
        # A unit that is neither degrees nor a length: refused by its name, whatever the caller says.
        unit = next(u for u in units if u and not is_degree(u) and tidy(u) not in METRES)
        raise InvalidInputError(
            f"{where}: needed coordinates in degrees, metres, kilometres, feet or nautical miles, got {unit!r}"
        )
    if said is not None and told is not None and said != told:
        raise InvalidInputError(
            f"{where}: needed geographic={said}, as the file says that its coordinates are {words[said]}, got geographic={told} "
            f"(units {units})"
        )
    if said is None and told is None:
        raise InvalidInputError(
            f"{where}: needed to know whether its coordinates are degrees or metres, got neither units nor names that say "
            "so; pass geographic=True or geographic=False"
        )
    return bool(told if said is None else said)


def mapping_crs(attributes: Mapping[str, Any], where: str) -> Any:  # noqa: ANN401 - rasterio's
    """The coordinate reference system of a grid mapping's attributes; None where they have none."""
    for key in ("crs_wkt", "spatial_ref", "wkt", "epsg_code", "epsg", "EPSG", "proj4", "proj4text", "proj4_params"):
        text = attributes.get(key)
        if text is None or not str(text).strip():
            continue
        plain = str(text).strip()
        return crs_of(f"EPSG:{plain}" if plain.isdigit() else plain)
    name = str(attributes.get("grid_mapping_name", "")).strip()
    if not name:
        return None
    if name == "latitude_longitude":
        return crs_of("EPSG:4326") if "semi_major_axis" not in attributes else _from_cf(attributes, where)
    if name == "rotated_latitude_longitude":
        raise InvalidInputError(f"{where}: needed longitude and latitude, got a rotated pole")
    return _from_cf(attributes, where)


def _from_cf(attributes: Mapping[str, Any], where: str) -> Any:  # noqa: ANN401 - rasterio's
    from geomag._optional import require

    pyproj = require("pyproj", "io", "grid mappings of the CF conventions")
    try:
        return crs_of(pyproj.CRS.from_cf(dict(attributes)).to_wkt())
    except (pyproj.exceptions.CRSError, KeyError, ValueError, TypeError) as error:
        raise InvalidInputError(
            f"{where}: needed a grid mapping of the CF conventions, got {dict(attributes)} ({error})"
        ) from error
