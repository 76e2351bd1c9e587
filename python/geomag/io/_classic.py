"""The header of a classic netCDF file, checked before the C library has it, which damaged ones send far outside of their memory.

The grammar is that of the netCDF classic format specification (CDF-1, CDF-2 and CDF-5): dimensions, global attributes, variables with
their attributes, all sizes big-endian and padded to four bytes.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

from geomag._errors import ReadError

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
_DIMENSIONS, _VARIABLES, _ATTRIBUTES = 10, 11, 12
#: Headers of maps have kilobytes; one that is still going on after this is none.
_MOST_BYTES = 16_000_000
_MOST_ITEMS = 100_000


class _Header:
    """Reads on from field to field and never beyond the end."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 4
        self.wide = data[3:4] == b"\x05"

    def take(self, count: int) -> bytes:
        if not 0 <= count <= len(self.data) - self.at:
            raise ValueError(f"a header of at least {self.at + count} bytes, got {len(self.data)}")
        piece = self.data[self.at : self.at + count]
        self.at += count
        return piece

    def number(self) -> int:
        return int(struct.unpack(">I", self.take(4))[0])

    def size(self) -> int:
        """A count, a length or an index."""
        return int(struct.unpack(">Q", self.take(8))[0]) if self.wide else self.number()

    def padded(self, count: int) -> bytes:
        return self.take(count + -count % 4)[:count]

    def items(self, tag: int) -> int:
        """How many elements a list has, which begins with its tag or two zeros."""
        got, count = self.number(), self.size()
        if count > _MOST_ITEMS or (got != tag and (got, count) != (0, 0)):
            raise ValueError(f"a list of kind {tag}, got kind {got} of {count} elements")
        return count

    def name(self) -> None:
        if not self.padded(self.size()):
            raise ValueError("a name, got none")

    def kind(self) -> int:
        kind = self.number()
        if kind not in _SIZES:
            raise ValueError(f"a type of 1 to 11, got {kind}")
        return kind

    def attributes(self) -> None:
        for _ in range(self.items(_ATTRIBUTES)):
            self.name()
            kind = self.kind()
            self.padded(self.size() * _SIZES[kind])


def check_classic(path: Path) -> None:
    """Raise ReadError for a header that does not follow the format, or promises more than the file holds."""
    total = path.stat().st_size
    with path.open("rb") as file:
        header = _Header(file.read(_MOST_BYTES))
    try:
        _check(header, total)
    except ValueError as error:
        raise ReadError(f"{path}: needed a readable netCDF file, got a damaged header: needed {error}") from None


def _check(header: _Header, total: int) -> None:
    if header.data[3:4] not in (b"\x01", b"\x02", b"\x05"):
        raise ValueError(f"version 1, 2 or 5 of the format, got {header.data[3:4]!r}")
    records = header.size()
    if records in (0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF):  # a file that was being streamed
        raise ValueError("a number of records, got a file that was not finished")
    lengths = []
    for _ in range(header.items(_DIMENSIONS)):
        header.name()
        lengths.append(header.size())
    if lengths.count(0) > 1:
        raise ValueError(f"one record dimension at most, got {lengths.count(0)}")
    header.attributes()
    rows, record = [], 0
    for _ in range(header.items(_VARIABLES)):
        header.name()
        dims = [header.size() for _ in range(_ranked(header.size()))]
        if any(d >= len(lengths) for d in dims) or any(lengths[d] == 0 for d in dims[1:]):
            raise ValueError(f"dimensions among {len(lengths)}, the record dimension first, got {dims}")
        header.attributes()
        kind = header.kind()
        header.size()  # the size of a variable is redundant, and not right beyond 4 GiB
        begin = header.number() if header.data[3:4] == b"\x01" else struct.unpack(">Q", header.take(8))[0]
        own = math.prod(lengths[d] for d in dims if lengths[d]) * _SIZES[kind]
        growing = bool(dims) and lengths[dims[0]] == 0
        rows.append((begin, own, growing))
        record += own + -own % 4 if growing else 0
    if sum(growing for *_, growing in rows) == 1:  # a record variable that is alone is not padded
        record = next(own for _, own, growing in rows if growing)
    for begin, own, growing in rows:
        end = begin + ((records - 1) * record + own if growing and records else 0 if growing else own)
        if end > total or begin < header.at:
            raise ValueError(f"values from byte {header.at} to {total}, got a variable from {begin} to {end}")


def _ranked(count: int) -> int:
    if count > 1024:
        raise ValueError(f"at most 1024 dimensions of a variable, got {count}")
    return count
