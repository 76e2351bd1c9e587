"""ArduPilot dataflash logs, through pymavlink."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np

from geomag._errors import ReadError
from geomag._optional import require
from geomag.io._log_tables import Array, Series, joined, magnitude_nt, one_of
from geomag.io._text import Table, existing

MAGIC = b"\xa3\x95\x80"
_NT_PER_MILLIGAUSS = 100.0


def _array(rows: list[list[float]], k: int) -> Array:
    return np.array([r[k] for r in rows], dtype=np.float64)


def dataflash_table(path: str | Path, position: str | None = None, reading: str | None = None) -> Table:
    """Readings of a dataflash log with the positions of their times.

    Positions are those of the estimator (`POS`), else of the receiver (`GPS`); readings the strength of a compass (`MAG[0]`, `MAG[1]`, ...),
    or a field of another message, as `MESSAGE.Field`.
    """
    path = existing(path)
    reader = require("pymavlink.DFReader", "mavlink", "ArduPilot logs")
    where = str(path)
    places: dict[str, list[list[float]]] = {}
    fields: dict[str, list[list[float]]] = {}
    other: list[list[float]] = []
    message, _, wanted = (reading or "").partition(".")
    types = {"POS", "GPS", "MAG", "MAG2", "MAG3"} | ({message} if wanted else set())
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            log = reader.DFReader_binary(where, zero_time_base=True)
            while (m := log.recv_match(type=list(types))) is not None:
                kind, seconds = m.get_type(), float(m.TimeUS) * 1e-6
                if kind == "POS" or (kind == "GPS" and m.Status >= 3 and getattr(m, "I", 0) == 0):
                    places.setdefault(kind, []).append([seconds, float(m.Lng), float(m.Lat)])
                elif kind.startswith("MAG") and not wanted:
                    name = f"MAG[{int(getattr(m, 'I', int(kind[3:] or 1) - 1))}]"
                    fields.setdefault(name, []).append([seconds, float(m.MagX), float(m.MagY), float(m.MagZ)])
                if wanted and kind == message:
                    other.append([seconds, float(getattr(m, wanted))])
    except AttributeError as error:
        raise ReadError(f"{where}: needed the field that a message of the log has, got: {error}") from error
    except Exception as error:  # the reader underneath trips in many ways over a broken log
        raise ReadError(f"{where}: needed a readable dataflash log, got: {type(error).__name__} {error}") from error
    found = {
        k: Series(k, _array(r, 0), {"longitude": _array(r, 1), "latitude": _array(r, 2)}) for k, r in places.items()
    }
    if position is None and "POS" in found:
        found = {"POS": found["POS"]}
    chosen = one_of(found, position, "position", where)
    if wanted:
        if not other:
            raise ReadError(f"{where}: needed messages '{message}' in the log, got none")
        return joined(chosen, Series(reading or "", _array(other, 0), {"value": _array(other, 1)}), where)
    compasses = {
        k: Series(
            k,
            _array(r, 0),
            {"magnetic_field_nt": magnitude_nt(_array(r, 1), _array(r, 2), _array(r, 3), _NT_PER_MILLIGAUSS)},
        )
        for k, r in fields.items()
    }
    return joined(chosen, one_of(compasses, reading, "reading", where), where)
