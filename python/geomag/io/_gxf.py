"""Geosoft's grid exchange format (GXF, revision 3): plain and base-90 numbers, scaling, dummies, the eight senses of storage.

A rotated grid is refused, and so is one whose numbers are not those that its header promises (count, least and greatest value).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geomag._errors import InvalidInputError, ReadError
from geomag._geomag import GridMap
from geomag.io._make import MOST, make_map
from geomag.io._numbers import plain
from geomag.io._units import METRES, crs_metres, crs_of, is_degree, metric_text, same_kind, tidy

#: Corner of the first point (right, top) and whether a row runs along x, by `#SENSE`.
_SENSES = {1: (0, 0, True), -1: (0, 0, False), 2: (0, 1, False), -2: (0, 1, True),
           3: (1, 1, True), -3: (1, 1, False), 4: (1, 0, False), -4: (1, 0, True)}  # fmt: skip


#: Keywords that say where and how large the numbers are: two of them say two things.
_ONCE = {"POIN", "ROWS", "PTSE", "RWSE", "XORI", "YORI", "ROTA", "SENS", "GTYP", "DUMM", "TRAN", "UNIT", "MAP_"}


def _sections(text: str) -> tuple[dict[str, list[str]], list[str]]:
    """What stands under each keyword (by its first four letters), and the lines of the grid."""
    found: dict[str, list[str]] = {}
    key: str | None = None
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for k, line in enumerate(lines):
        if line.startswith("##"):
            key = None
        elif line.startswith("#"):
            key = line[1:5].upper()
            if key == "GRID":
                return found, lines[k + 1 :]
            if key == "MAP_" and line[1:6].upper() != "MAP_P":
                key = line[1:].split()[0].upper()  # `#MAP_DATUM_TRANSFORM` is no projection
            if key in found and key in _ONCE:
                raise ReadError(f"needed '#{key}' once in the header, got it twice (line {k + 1})")
            rest = line.split(None, 1)
            found[key] = [rest[1]] if len(rest) > 1 else []
        elif key is not None and line.strip():
            found[key].append(line.strip())
    raise ReadError("needed a line '#GRID', got none")


def _numbers(found: dict[str, list[str]], key: str, default: str | None, count: int = 1) -> list[float]:
    text = found.get(key) or ([default] if default is not None else [])
    if not text:
        raise ReadError(f"needed '#{key}' in the header, got none")
    try:
        out = [plain(v) for v in re.split(r"[,\s]+", text[0].strip()) if v][:count]
    except ValueError:
        raise ReadError(f"needed numbers under '#{key}', got {text[0]!r}") from None
    if len(out) < count or not np.isfinite(out).all():
        raise ReadError(f"needed {count} number(s) under '#{key}', got {text[0]!r}")
    return out


def _base90(text: str) -> int:
    value = 0
    for character in text:
        digit = ord(character) - 37
        if not 0 <= digit < 90:
            raise ReadError(f"needed characters of base 90, got {text!r}")
        value = value * 90 + digit
    return value


def _compressed(lines: list[str], digits: int, total: int) -> NDArray[np.float64]:
    text = "".join(line.strip("\n\r ") for line in lines)
    out = np.full(total, np.nan)
    at, k = 0, 0
    while at < len(text):
        piece = text[at : at + digits]
        at += digits
        count = 1
        if piece[:1] == '"':
            count = _base90(text[at : at + digits])
            piece = text[at + digits : at + 2 * digits]
            at += 2 * digits
        if len(piece) < digits or k + count > total:
            raise ReadError(f"needed {total} values in the grid, got {'fewer' if len(piece) < digits else 'more'}")
        out[k : k + count] = np.nan if piece == "!" * digits else _base90(piece)
        k += count
    if k != total:
        raise ReadError(f"needed {total} values in the grid, got {k}")
    return out


def _plain(lines: list[str], total: int, dummy: float | None) -> NDArray[np.float64]:
    words = " ".join(line for line in lines if not line.startswith("#")).split()
    if len(words) != total:
        raise ReadError(f"needed {total} values in the grid, got {len(words)}")
    try:
        out = np.array([float("nan") if w == "*" else plain(w) for w in words])
    except ValueError as error:
        raise ReadError(f"needed numbers in the grid, got {error}") from error
    if dummy is not None:
        out[np.isclose(out, dummy, rtol=1e-9, atol=0.0)] = np.nan
    return out


def read_gxf(path: Path, text: str, geographic: bool | None, sigma: float | None) -> GridMap:
    """A map of a GXF file."""
    try:
        return _read(path, text, geographic, sigma)
    except InvalidInputError as error:
        raise type(error)(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    except ReadError as error:
        raise ReadError(f"{path}: {error}") from error


def _read(path: Path, text: str, geographic: bool | None, sigma: float | None) -> GridMap:
    found, lines = _sections(text)
    (points,), (rows,) = _numbers(found, "POIN", None), _numbers(found, "ROWS", None)
    if not (points == int(points) >= 2 and rows == int(rows) >= 2 and points * rows <= MOST):
        raise ReadError(f"needed 2 to {MOST} points in rows, got {points:g} x {rows:g}")
    columns_, rows_ = int(points), int(rows)
    if _numbers(found, "ROTA", "0")[0] != 0.0:
        raise InvalidInputError(
            f"needed rows along x and columns along y, got a grid rotated by {found['ROTA'][0]} degrees; resample it first"
        )
    sense = _numbers(found, "SENS", "1")[0]
    if sense not in _SENSES:
        raise ReadError(f"needed a #SENSE of -4 to 4, got {sense:g}")
    (digits,) = _numbers(found, "GTYP", "0")
    if digits not in range(16):
        raise ReadError(f"needed a #GTYPE of 0 to 15, got {digits:g}")
    total = columns_ * rows_
    dummy = _numbers(found, "DUMM", None)[0] if found.get("DUMM") else None
    scale, zero = _numbers(found, "TRAN", "1 0", 2)
    raw = _compressed(lines, int(digits), total) if digits else _plain(lines, total, dummy)
    values = raw * scale + zero if (scale, zero) != (1.0, 0.0) else raw
    for key, worst in (("ZMIN", "least"), ("ZMAX", "greatest")):
        if found.get(key) and np.isfinite(values).any():
            told = _numbers(found, key, None)[0]
            got = float(np.nanmin(values) if key == "ZMIN" else np.nanmax(values))
            if abs(told - got) > 1e-3 * max(float(np.nanmax(values) - np.nanmin(values)), abs(scale)):
                raise ReadError(f"needed a {worst} value of {told:g} as #{key} says, got {got:g}")
    right, top, along_x = _SENSES[int(sense)]
    values = values.reshape(rows_, columns_)
    (dp,), (dr,) = _numbers(found, "PTSE", "1"), _numbers(found, "RWSE", "1")
    if not (dp > 0 and dr > 0):
        raise ReadError(f"needed separations > 0, got {dp:g} and {dr:g}")
    if not along_x:
        values, dp, dr = values.T, dr, dp
    values = values[::-1] if top else values
    values = values[:, ::-1] if right else values
    x = _numbers(found, "XORI", "0")[0] + dp * np.arange(values.shape[1])
    y = _numbers(found, "YORI", "0")[0] + dr * np.arange(values.shape[0])
    said, factor, crs = _coordinates_of(found, str(path))
    if said is not None:
        geographic = same_kind(geographic, said, str(path))
    if geographic is None:
        raise InvalidInputError(
            "needed to know whether its coordinates are degrees or metres, got neither units nor projection; "
            "pass geographic=True or geographic=False"
        )
    if not geographic and factor != 1.0:
        x, y = x * factor, y * factor
    name = (found.get("TITL") or [path.stem])[0].strip(' "') or path.stem
    return make_map(values, x, y, geographic=geographic, sigma=sigma, name=name, crs=crs, where=str(path))


def _coordinates_of(found: dict[str, list[str]], where: str) -> tuple[bool | None, float, str | None]:
    """Degrees or not, metres in a unit, and the system by its code, of what the header says of its coordinates."""
    unit = found.get("UNIT")
    said: bool | None = None
    factor = 1.0
    if unit:
        name, _, size = unit[0].partition(",")
        name = name.strip().strip('"')
        if is_degree(name):
            said = True
        elif size.strip() or tidy(name) in METRES:
            said = False
            try:
                factor = plain(size.split(",")[0].strip()) if size.strip() else METRES[tidy(name)]
            except ValueError:
                raise ReadError(f"needed a size of the unit under '#UNIT_LENGTH', got {unit[0]!r}") from None
            if not (np.isfinite(factor) and factor > 0):
                raise ReadError(f"needed a size > 0 of the unit under '#UNIT_LENGTH', got {unit[0]!r}")
        else:
            raise InvalidInputError(f"{where}: needed a unit of length or degrees, got {name!r}")
    projection = " ".join(found.get("MAP_", []))
    crs = None
    code = re.search(r"EPSG[:\s]*(\d{4,6})", projection, re.IGNORECASE)
    if code:
        crs = f"EPSG:{code[1]}"
        system = crs_of(crs)
        if said is not None and said != system.is_geographic:
            raise InvalidInputError(f"{where}: needed one kind of coordinates, got unit {unit} and {crs}")
        said = bool(system.is_geographic)
        if not said:
            factor = factor if unit else crs_metres(system, where)
            crs = metric_text(crs)
    elif said is None and re.search(r"\bgeographic\b", projection, re.IGNORECASE):
        said = True
    return said, factor, crs
