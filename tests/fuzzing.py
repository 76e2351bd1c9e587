"""Mutated inputs for the readers, and what may come of them: an error of ours, or numbers that are in the file.

`python tests/fuzzing.py text 1000000` and `python tests/fuzzing.py grid 100000` go on for as long as it takes; what they find is a seed
and a reader, which belong into `FOUND` of test_fuzz.py.
"""

from __future__ import annotations

import re
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import geomag
from geomag.io import read_grid
from geomag.io._text import decoded, parse, plain_bytes
from geomag.io._tracks import track_of
from geomag.io._units import FIELD, METRES
from geomag.stream import read_csv, read_nmea

CASES = Path(__file__).parent / "cases"
LOGS = sorted(p for p in CASES.glob("log-*.csv"))
STREAMS = [*LOGS, CASES / "stream-latitude-first.csv", CASES / "nmea-noise.txt"]
TEXT_GRIDS = [
    CASES / n
    for n in (
        "grid-esri.asc",
        "grid-base90-dummy.gxf",
        "grid-rotated.gxf",
        "grid-surfer-blanks.xyz",
        "grid-emag2-columns.csv",
    )
]
BINARY_GRIDS = [
    CASES / n
    for n in ("grid-longitude-first.nc", "grid-feet-grid-mapping.nc", "map-web-mercator.tif", "grid-degrees-oasis.grd")
]
#: What people and programs put into text.
WORDS = [b",", b";", b"\t", b" ", b"\n", b"\r\n", b"*", b"nan", b"-", b"99999", b"-1e32", b"1e400", b"#", b"/", b'"', b"\0", b"\xff", b"\xef\xbb\xbf",
         b"1_0", b"inf", b"0x10", b"1,5", b"12:00:00", b"2026-01-01", b"05/06/2026", b"lat", b"lon", b"x", b"time", b"(deg)", b"_km", b"mag_nT", b"Line 1", b"-0", b"1.7e15"]  # fmt: skip
NUMBERS = [re.compile(rf"[+-]?(?:\d+(?:{point}\d*)?|{point}\d+)(?:[eEdD][+-]?\d{{1,3}})?") for point in (r"\.", ",")]
FACTORS = sorted({1.0, *METRES.values(), *(f for _, f in FIELD.values())})


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The data with one to six changes: bytes, words, lines and pieces."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 7))):
        at = int(rng.integers(0, len(out) + 1))
        kind = int(rng.integers(0, 7))
        if kind == 0 and at < len(out):
            out[at] = int(rng.integers(0, 256))
        elif kind == 1:
            del out[at : at + int(rng.integers(1, 12))]
        elif kind in (2, 3):
            word = WORDS[int(rng.integers(0, len(WORDS)))]
            out[at : at + (len(word) if kind == 2 else 0)] = word
        elif kind == 4:
            lines = bytes(out).split(b"\n")
            k, m = (int(rng.integers(0, len(lines))) for _ in range(2))
            lines[k], lines[m] = lines[m], lines[k]
            out = bytearray(b"\n".join(lines))
        elif kind == 5:
            out[at:at] = out[at : at + int(rng.integers(1, 40))]
        else:
            out = out[: max(1, at)] if rng.random() < 0.2 else out
    return bytes(out)


def numbers_of(data: bytes) -> np.ndarray:
    """All numbers that a text may be read to hold, sorted."""
    text = (
        data.decode("utf-8", "replace")
        + "\n"
        + data.decode("utf-16", "ignore")
        + "\n"
        + data.decode("cp1252", "replace")
    )
    found = set()
    for token in (t for pattern in NUMBERS for t in pattern.findall(text)):
        for piece in {token, token.lstrip("+-")}:
            try:
                found.add(float(re.sub("[dD]", "e", piece).replace(",", ".")))
            except ValueError:
                continue
    base = np.array(sorted(found | {-f for f in found}) or [0.0])
    return np.sort(np.concatenate([base * f for f in FACTORS]))


def strangers(values: np.ndarray, data: bytes) -> np.ndarray:
    """Numbers that are not in the text, in any unit."""
    known = numbers_of(data)
    values = values[np.isfinite(values)]
    at = np.clip(np.searchsorted(known, values), 1, len(known) - 1)
    off = np.minimum(np.abs(known[at] - values), np.abs(known[at - 1] - values))
    return values[off > 1e-9 * np.maximum(np.abs(values), 1e-300)]


def track(data: bytes) -> np.ndarray:
    """All of a track: coordinates and values."""
    table = parse(decoded(plain_bytes(data, "fuzz"), "fuzz"), "fuzz")
    found = track_of(table, missing="drop")
    return np.concatenate([found.x, found.y, found.values])


def csv(data: bytes) -> np.ndarray:
    """All samples of a CSV stream."""
    return np.array([(s.x, s.y, s.value) for s in read_csv(data.decode("utf-8", "replace").split("\n"))]).ravel()


def nmea(data: bytes) -> np.ndarray:
    """The readings of an NMEA stream."""
    return np.array([s.value for s in read_nmea(data.decode("utf-8", "replace").split("\n"))])


def grid(data: bytes, name: str, folder: Path) -> np.ndarray:
    """Values of a map, which for text are to be in it."""
    path = folder / name
    path.write_bytes(data)
    found = read_grid(
        path,
        geographic=None if name.endswith("nc") else "emag2" in name or "degrees" in name,
        **({"columns": (2, 3, 5)} if "emag2" in name else {}),
    )
    return (
        np.asarray(found.values, dtype=np.float64).ravel() if name.endswith((".asc", ".xyz", ".csv")) else np.zeros(0)
    )


def one(kind: str, seed: int, folder: Path) -> str | None:
    """What is wrong with the answer to one mutated input; None where nothing is."""
    rng = np.random.default_rng(seed)
    sources = {"text": STREAMS, "grid": TEXT_GRIDS, "binary": BINARY_GRIDS}[kind]
    source = sources[int(rng.integers(0, len(sources)))]
    data = mutated(source.read_bytes(), rng)
    if kind == "text":
        readers = [nmea] if source.suffix == ".txt" else [track, csv]
    else:
        readers = [lambda data: grid(data, source.name, folder)]
    for read in readers:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", geomag.DataWarning)
            try:
                values = read(data)
            except geomag.GeomagError:
                continue
            except Exception as error:
                return f"{source.name}, seed {seed}: {type(error).__name__}: {error}"
        strange = strangers(values, data) if kind != "binary" else np.zeros(0)
        if strange.size:
            return f"{source.name}, seed {seed}, {read.__name__}: {strange[:3]} not in {data[:300]!r}"
    return None


def main(kind: str, count: int, first: int = 0) -> int:
    """Try `count` seeds from `first` on; returns how many went wrong, which are printed."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            found = one(kind, seed, Path(folder))
            if found:
                wrong += 1
                sys.stdout.write(found + "\n")
    sys.stdout.write(f"{kind}: {count} inputs from seed {first}, {wrong} wrong\n")
    return wrong


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1], *(int(a) for a in sys.argv[2:])) > 0)
