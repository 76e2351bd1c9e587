"""Text as people have it, into rows and columns: encodings, compression, comments, separators, headers, lines of a survey.

A comment is a line that begins with `#`, `%` or `/` (Geosoft); the same character inside a line belongs to its field. The separator is the one
under which all lines have equally many fields. Nothing is guessed from the order of columns: that is for `_names`.
"""

from __future__ import annotations

import bz2
import csv
import gzip
import lzma
import re
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geomag._errors import ReadError
from geomag.io._names import Column, columns_of
from geomag.io._numbers import is_decimal_comma, is_missing, is_number, numbers
from geomag.io._times import looks_like_time
from geomag.io._units import DEGREES, FIELD, METRES, SECONDS, tidy

#: Lines that a separator is judged by.
_SAMPLE = 200
#: Lines of a title that may stand before a header.
_PREAMBLE = 40
_SEPARATORS = ("\t", ";", "|", ",", " ")
_LINE = re.compile(r"\s*(line|tie|base|random|special|trend|flight)(?:\s*[:=]\s*|\s+)(\S+)\s*$", re.IGNORECASE)


@dataclass
class Table:
    """Rows and columns of a text, with what the columns are; fields as they are written, without outer blanks."""

    where: str
    columns: list[Column]
    fields: list[Sequence[str]]
    lines: list[int]
    comma: bool = False
    named: bool = True
    labels: list[str] | None = None
    numbers_: dict[int, NDArray[np.float64]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.lines)

    def floats(self, column: Column) -> NDArray[np.float64]:
        """A column as numbers, NaN where there is none."""
        if column.index not in self.numbers_:
            where = f"{self.where}, column '{column.name}'"
            self.numbers_[column.index] = numbers(self.fields[column.index], self.comma, where, self.lines)
        return self.numbers_[column.index]


def plain_bytes(data: bytes, where: str) -> bytes:
    """Bytes without their compression (gzip, bzip2, xz, zip of one file)."""
    try:
        if data[:2] == b"\x1f\x8b":
            return gzip.decompress(data)
        if data[:3] == b"BZh":
            return bz2.decompress(data)
        if data[:6] == b"\xfd7zXZ\x00":
            return lzma.decompress(data)
        if data[:4] == b"PK\x03\x04":
            with zipfile.ZipFile(BytesIO(data)) as archive:
                names = [n for n in archive.namelist() if not n.endswith("/")]
                if len(names) != 1:
                    raise ReadError(f"{where}: needed an archive of one file, got {len(names)}: {', '.join(names[:5])}")
                return archive.read(names[0])
    except (
        OSError,
        EOFError,
        zlib.error,
        lzma.LZMAError,
        zipfile.BadZipFile,
        ValueError,
        NotImplementedError,
        RuntimeError,
    ) as error:
        if isinstance(error, ReadError):
            raise
        raise ReadError(f"{where}: needed a readable table, got: {error}") from error
    return data


def decoded(data: bytes, where: str) -> str:
    """Text of bytes: by its byte order mark, else UTF-8, else Windows-1252."""
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if data.startswith(mark):
            try:
                return data.decode(encoding)
            except UnicodeDecodeError as error:
                raise ReadError(f"{where}: needed text in {encoding}, as its first bytes say, got {error}") from error
    if b"\0" in data:
        zeros = [data[k::2].count(0) for k in (0, 1)]
        if (
            min(zeros) == 0 and max(zeros) > 0.8 * len(data) / 2
        ):  # every other byte of Latin text in UTF-16, here without its mark
            try:
                return data.decode("utf-16-le" if zeros[1] else "utf-16-be")
            except UnicodeDecodeError:
                pass
        raise ReadError(f"{where}: needed a readable table, got binary content")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def split_line(line: str, separator: str) -> list[str]:
    """Fields of a line without outer blanks; a field in double quotes may hold the separator."""
    if '"' in line:
        if separator == " ":
            line, separator = re.sub(r"\s+(?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)", "\t", line.strip()), "\t"
        try:
            row = next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True), [])
            return [f.strip() for f in row]
        except csv.Error:
            pass
    if separator == " ":
        return line.split()
    return [f.strip() for f in line.split(separator)]


def without_tail(row: list[str]) -> list[str]:
    """A row without the empty field that a separator at its end makes."""
    return row[:-1] if len(row) > 1 and row[-1] == "" else row


def _atomic(text: str, separator: str) -> bool:
    """Whether a field is one thing, and not several between other separators."""
    if is_number(text) or is_missing(text) or looks_like_time(text):
        return True
    if "," in text and separator != ",":
        return is_decimal_comma(text)
    if any(s in text for s in ";|\t"):
        return False
    words = text.split()
    return not (len(words) > 1 and all(is_number(w) for w in words))


def find_separator(header: str | None, body: Sequence[str]) -> str | None:
    """The separator under which the lines have equally many fields, each one thing; None where there is none."""
    best, share = None, 0.0
    for separator in _SEPARATORS:
        rows = [split_line(line, separator) for line in body]
        counts = [len(without_tail(r)) for r in rows]
        usual = max(set(counts), key=counts.count)
        if usual < 2:
            continue
        if header is not None and separator != " " and separator not in header:
            continue
        good = [c == usual and all(_atomic(f, separator) for f in r) for r, c in zip(rows, counts, strict=True)]
        if sum(good) / len(good) > share + 1e-9:
            best, share = separator, sum(good) / len(good)
    return best


def is_datum(text: str) -> bool:
    """Whether a field is a value rather than a name."""
    return is_number(text) or is_missing(text) or looks_like_time(text) or is_decimal_comma(text)


def _header_row(first: Sequence[str], second: Sequence[str] | None) -> bool:
    """Whether a first row names the columns: it has words where the next has values, or words only."""
    words = [not is_datum(f) for f in first]
    if not any(words):
        return False
    if all(w or is_missing(f) for w, f in zip(words, first, strict=True)):
        return True
    return second is None or any(w and k < len(second) and is_datum(second[k]) for k, w in enumerate(words))


def _unit_row(row: Sequence[str]) -> bool:
    """Whether a row beneath the names gives units."""
    inner = [tidy(f.strip("()[]{}<>")) for f in row]
    known = sum(u in METRES or u in DEGREES or u in FIELD or u in SECONDS for u in inner)
    return not any(is_datum(f) and f not in ("", "-", "--") for f in row) and known >= 2


def _names_in(line: str, separator: str, count: int) -> list[str] | None:
    """Names of a header, which may have blanks before a unit in brackets; None where they are not as many as the columns."""
    names = [n.strip('"') for n in without_tail(split_line(line, separator))]
    if len(names) != count and separator == " ":
        names = re.sub(r"\s+(?=[(\[])", "", line.strip()).split()
    return names if len(names) == count else None


def rows_of(text: str) -> list[tuple[int, str]]:
    """Numbered lines that are not blank, whatever ends them."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return [(k, line) for k, line in enumerate(lines, start=1) if line.strip()]


def parse(text: str, where: str) -> Table:
    """Rows and columns of a text; ReadError naming the line that has other fields than the rest."""
    content: list[tuple[int, str]] = []
    comments: list[str] = []
    labels: list[tuple[int, str]] = []
    for number, line in rows_of(text):
        bare = line.lstrip(" \ufeff")
        if not bare:
            continue
        if bare[0] in "#%/" or bare.startswith("!"):
            if not content:
                comments.append(bare.lstrip("#%/! \t"))
            continue
        found = _LINE.match(line) if bare[0].isalpha() else None
        if bare[0] == ">" or found:
            labels.append((len(content), found[2] if found else bare[1:].strip() or f"segment {len(labels) + 1}"))
            continue
        # A mark within a field is no blank that may be left out: `12\ufeff0` is no 120.
        content.append((number, line[: len(line) - len(bare)].replace("\ufeff", "") + bare))
    if not content:
        raise ReadError(f"{where}: needed a readable table with at least one row, got none")
    sample = [line for _, line in content[1 : _SAMPLE + 1]]
    separator = find_separator(content[0][1], sample) if sample else None
    if separator is None:
        separator = find_separator(None, [content[0][1]]) if not sample else find_separator(None, sample)
    if separator is None:
        raise ReadError(
            f"{where}: needed a readable table of several columns, got line {content[0][0]}: {content[0][1][:60]!r}"
        )
    skipped = _preamble(content, separator)
    labels = [(max(0, at - skipped), name) for at, name in labels]
    return _table(content[skipped:], comments, labels, separator, where)


def _preamble(content: list[tuple[int, str]], separator: str) -> int:
    """How many lines stand before a header that names coordinates, where the first line has other fields than the rows have."""
    sample = [without_tail(split_line(line, separator)) for _, line in content[: _SAMPLE + 1]]
    counts = [len(row) for row in sample]
    usual = max(set(counts), key=counts.count)
    if counts[0] in (usual, usual + 1, usual - 1):
        return 0
    for k, row in enumerate(sample[:_PREAMBLE]):
        if len(row) == usual and len(set(row)) == usual and not any(is_datum(f) for f in row):
            return k if {"x", "y"} <= {c.kind for c in columns_of([f.strip('"') for f in row])} else 0
    return 0


def _table(
    content: list[tuple[int, str]], comments: list[str], labels: list[tuple[int, str]], separator: str, where: str
) -> Table:
    fast = not any('"' in line for _, line in content) and separator != " "
    if fast:
        rows = [[f.strip() for f in line.split(separator)] for _, line in content]
    else:
        rows = [split_line(line, separator) for _, line in content]
    first = rows[0]
    second = rows[1] if len(rows) > 1 else None
    named = _header_row(without_tail(first), second)
    start = 1 if named else 0
    if len(rows) == start:
        raise ReadError(f"{where}: needed a readable table with at least one row, got none")
    units: list[str | None] | None = None
    if named and _unit_row(without_tail(rows[1])):
        start = 2
        if len(rows) == start:
            raise ReadError(f"{where}: needed a readable table with at least one row, got none")
    body = rows[start:]
    lines = [number for number, _ in content[start:]]
    # A separator at the end of every row makes an empty field there.
    if all(len(r) > 1 and r[-1] == "" for r in body) and (not named or len(body[0]) > len(without_tail(first))):
        body = [r[:-1] for r in body]
    count = len(body[0])
    if named:
        names = _names_in(content[0][1], separator, count) or _names_in(content[0][1], separator, len(first))
        if separator == " " and names is not None and len(names) != count:
            body = [_joined_times(r) for r in body]
            count = len(body[0])
        names = _names_in(content[0][1], separator, count) or without_tail(first)
        count = len(names)
    else:
        names = next((n for c in reversed(comments) if (n := _commented_names(c, separator, count))), None) or [
            str(k) for k in range(count)
        ]
        named = not names[0].isdigit()
    for number, row in zip(lines, body, strict=True):
        if len(row) != count:
            if len(row) == count + 1 and row[-1] == "":
                del row[-1]
                continue
            raise ReadError(
                f"{where}, line {number}: needed a readable table with {count} fields as {'named' if named else 'in the first row'} "
                f"({', '.join(names)}), got {len(row)}"
            )
    if start == 2:
        told = [u.strip("()[]{}<>") or None for u in rows[1]]
        units = [*told, *[None] * count][:count]
    columns = [list(c) for c in zip(*body, strict=True)]
    comma = _decimal_comma(columns, separator, where)
    table = Table(where, columns_of(names, units), columns, lines, comma, named)  # type: ignore[arg-type]
    if labels:
        if labels[0][0] > start:
            raise ReadError(
                f"{where}, line {lines[0]}: needed a line or segment that it belongs to, got a point before the first"
            )
        table.labels = _labelled(labels, start, len(body))
    return table


def _joined_times(row: list[str]) -> list[str]:
    """A row of words in which a date and the time of day after it are one field."""
    out: list[str] = []
    for f in row:
        if out and looks_like_time(f) and looks_like_time(out[-1]) and ":" in f and ":" not in out[-1]:
            out[-1] = f"{out[-1]} {f}"
        else:
            out.append(f)
    return out


def _commented_names(comment: str, separator: str, count: int) -> list[str] | None:
    """Names of columns in a comment, where a place among them is known."""
    for s in (separator, " ", ","):
        names = _names_in(comment, s, count)
        if names and len(set(names)) == count and not any(is_datum(n) for n in names):
            kinds = {c.kind for c in columns_of(names)}
            if {"x", "y"} <= kinds:
                return names
    return None


def _decimal_comma(columns: Sequence[Sequence[str]], separator: str, where: str) -> bool:
    """Whether numbers have decimal commas; commas and points in one file may be thousands, and are refused."""
    if separator == ",":
        return False
    commas = points = None
    for column in columns:
        for f in column:
            if "," in f and not looks_like_time(f):
                commas = commas or f
                if "." in f and is_number(f.replace(",", "").replace(".", "")):
                    raise ReadError(
                        f"{where}: needed numbers with a point or with a decimal comma, got {f!r}, which has both"
                    )
            elif "." in f and is_number(f):
                points = points or f
        if commas and points:
            break
    if commas and points and is_decimal_comma(commas):
        raise ReadError(
            f"{where}: needed numbers with a point or with a decimal comma throughout, got {commas!r} and {points!r} (thousands?)"
        )
    return commas is not None


def _labelled(labels: list[tuple[int, str]], start: int, count: int) -> list[str]:
    out: list[str] = []
    at = [max(k - start, 0) for k, _ in labels] + [count]
    for (_, name), first, last in zip(labels, at[:-1], at[1:], strict=True):
        out += [name] * (last - first)
    return out


def existing(path: str | Path) -> Path:
    """The path of a file that is there."""
    from geomag._errors import MissingFileError

    path = Path(path)
    if not path.exists():
        raise MissingFileError(f"file: needed an existing file, got nothing at {path}")
    if path.is_dir():
        raise ReadError(f"file: needed a file, got the folder {path}")
    return path
