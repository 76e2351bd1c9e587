"""Text grids with a header of their own: ESRI ASCII and ICGEM's gdf."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from geomag._errors import InvalidInputError, ReadError
from geomag._geomag import GridMap
from geomag.io._make import MOST, make_map
from geomag.io._numbers import number, plain, whole
from geomag.io._points import lattice
from geomag.io._units import ask_kind, check_degrees, crs_metres, crs_of, field_unit, metric_text, same_kind


def looks_like_esri(text: str) -> bool:
    """Whether a text begins with the header of an ESRI ASCII grid."""
    words = text[:400].split()
    return len(words) > 1 and words[0].lower() in ("ncols", "nrows")


def read_esri(path: Path, text: str, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of an ESRI ASCII grid; its nodes are the centres of its cells, its system that of a .prj file beside it."""
    where = str(path)
    words = text.split()
    header: dict[str, float] = {}
    at = 0
    while at + 1 < len(words) and words[at][:1].isalpha() and words[at].lower() not in ("nan", "inf", "null"):
        try:
            header[words[at].lower()] = number(words[at + 1], comma=True)
        except ValueError:
            raise ReadError(f"{where}: needed a number after '{words[at]}', got {words[at + 1]!r}") from None
        at += 2

    def told(key: str) -> float:
        if key not in header or not np.isfinite(header[key]):
            raise ReadError(f"{where}: needed '{key}' in the header of an ESRI ASCII grid, got {', '.join(header)}")
        return header[key]

    columns, rows = told("ncols"), told("nrows")
    if not (columns == int(columns) >= 2 and rows == int(rows) >= 2 and columns * rows <= MOST):
        raise ReadError(f"{where}: needed 2 to {MOST} nodes, got {rows:g} x {columns:g}")
    dx = header.get("dx") or told("cellsize")
    dy = header.get("dy") or told("cellsize")
    if not (np.isfinite([dx, dy]).all() and dx > 0 and dy > 0):
        raise ReadError(f"{where}: needed a cell size > 0, got {dx:g} by {dy:g}")
    x0 = told("xllcenter") if "xllcenter" in header else told("xllcorner") + 0.5 * dx
    y0 = told("yllcenter") if "yllcenter" in header else told("yllcorner") + 0.5 * dy
    body = words[at:]
    if len(body) != int(columns) * int(rows):
        raise ReadError(f"{where}: needed {int(columns) * int(rows)} values, got {len(body)}")
    try:
        values = np.array([number(w, comma=True) for w in body]).reshape(int(rows), int(columns))[::-1]
    except ValueError as error:
        raise ReadError(f"{where}: needed numbers, got {error}") from error
    values = np.where(values == header.get("nodata_value", -9999.0), np.nan, values)
    x, y = x0 + dx * np.arange(int(columns)), y0 + dy * np.arange(int(rows))
    crs, beside = None, path.with_suffix(".prj")
    if beside.is_file():
        system = crs_of(beside.read_text(encoding="utf-8", errors="replace").strip())
        geographic = same_kind(geographic, bool(system.is_geographic), where)
        crs = system.to_string()
        if geographic:
            check_degrees(system, where)
        else:
            factor = crs_metres(system, where)
            x, y, crs = x * factor, y * factor, metric_text(crs)
    if geographic is None:
        raise InvalidInputError(
            f"{where}: needed to know whether its coordinates are degrees or metres, got an ESRI ASCII grid without a .prj file; pass "
            "geographic=True or geographic=False"
        )
    return make_map(values, x, y, geographic=geographic, sigma=sigma, name=path.stem, crs=crs, where=where)


def read_surfer_text(path: Path, text: str, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of a text grid of Surfer 6: columns and rows, least and greatest x, y and value, then the nodes from the lowest row up."""
    where = str(path)
    words = text.split()[1:]
    try:
        columns, rows = whole(words[0]), whole(words[1])
        x0, x1, y0, y1 = (plain(w) for w in words[2:6])
        values = np.array([number(w) for w in words[8:]])
    except (ValueError, IndexError) as error:
        raise ReadError(f"{where}: needed the numbers of a text grid of Surfer, got {error}") from error
    if not (columns >= 2 and rows >= 2 and columns * rows <= MOST):
        raise ReadError(f"{where}: needed 2 to {MOST} nodes, got {rows} x {columns}")
    if len(values) != columns * rows:
        raise ReadError(f"{where}: needed {columns * rows} values, got {len(values)}")
    if not (x1 > x0 and y1 > y0):
        raise ReadError(f"{where}: needed x and y that rise, got {x0:g} to {x1:g} and {y0:g} to {y1:g}")
    if geographic is None:
        raise ask_kind(where)
    # Surfer writes 1.70141e+038 for what it leaves blank, and takes all beyond that for blank.
    values = np.where(values >= 1.70141e38, np.nan, values)
    if not np.isfinite(values).any():
        raise ReadError(f"{where}: needed one value at least, got none")
    x, y = np.linspace(x0, x1, columns), np.linspace(y0, y1, rows)
    return make_map(
        values.reshape(rows, columns), x, y, geographic=geographic, sigma=sigma, name=path.stem, where=where
    )


def looks_like_gdf(text: str) -> bool:
    """Whether a text has the header of an ICGEM grid."""
    return re.search(r"^end_of_head", text[:20_000], re.MULTILINE) is not None


def read_gdf(path: Path, text: str, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of a grid of the ICGEM service: longitude, latitude, perhaps height, and the functional that its header names."""
    where = str(path)
    same_kind(geographic, True, where)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    end = next(k for k, line in enumerate(lines) if line.startswith("end_of_head"))
    header = {w[0].lower(): w[1:] for line in lines[:end] if len(w := line.split()) > 1}
    names = next((line.split() for line in reversed(lines[:end]) if line.split()[:2] == ["longitude", "latitude"]), [])
    rows = [line.split() for line in lines[end + 1 :] if line.strip()]
    if not rows:
        raise ReadError(f"{where}: needed a row at least after its header, got none")
    count = len(rows[0])
    if count not in (3, 4) or any(len(r) != count for r in rows) or (names and len(names) != count):
        raise ReadError(
            f"{where}: needed rows of longitude, latitude, perhaps height, and value, got {' '.join(rows[0])!r}"
        )
    try:
        data = np.array([[number(w) for w in r] for r in rows])
    except ValueError as error:
        raise ReadError(f"{where}: needed numbers, got {error}") from error
    values = data[:, -1]
    if "gapvalue" in header:
        try:
            values = np.where(values == plain(header["gapvalue"][0]), np.nan, values)
        except ValueError:
            raise ReadError(f"{where}: needed a number as gapvalue, got {header['gapvalue'][0]!r}") from None
    grid, x, y = lattice(data[:, 0], data[:, 1], values, where)
    for key, got in (("longitude_parallels", len(x)), ("latitude_parallels", len(y))):
        if key in header and header[key][0].isdigit() and int(header[key][0]) != got:
            raise ReadError(f"{where}: needed {header[key][0]} {key} as its header says, got {got}")
    unit = " ".join(header.get("unit", [])) or None
    name = " ".join(header.get("functional", [])) or (names[-1] if names else path.stem)
    known = field_unit(unit)
    return make_map(grid, x, y, geographic=True, sigma=sigma, name=name, units=known[0] if known and known[1] == 1.0 else unit,
                    where=where)  # fmt: skip
