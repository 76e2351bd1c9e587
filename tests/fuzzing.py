"""Mutated inputs for the readers, and what may come of them: an error of ours, or numbers that are in the file.

`python tests/fuzzing.py all --record fuzz.json` (`make fuzz-readers`) feeds 10^6 inputs to every text reader and 10^5 to every grid reader and
goes on where it was stopped; `python tests/fuzzing.py gxf 5000 [FIRST]` tries some seeds of one. What they find is a kind and a seed, which belong into
`FOUND` of test_fuzz.py.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

import geomag
from geomag.diurnal import read_iaga2002
from geomag.io import line_points, read_grid
from geomag.io._tables import load_table
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
NUMBERS = [re.compile(rf"[+-]?(?:\d+(?:{point}\d*)?|{point}\d+)(?:[eEdD][+-]?\d{{1,4}})?") for point in (r"\.", ",")]
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


def decimal_numbers(text: str) -> set[float]:
    """All numbers that a text may be read to hold, of either sign."""
    found = {0.0}
    for token in {t.lstrip("+-") for pattern in NUMBERS for t in pattern.findall(text)}:
        number = float(token.replace(",", ".").replace("d", "e").replace("D", "e"))
        found |= {number, -number}
    return found


def away_from(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Those of the values that are no known number."""
    known = np.sort(known)
    at = np.clip(np.searchsorted(known, values), 1, len(known) - 1)
    off = np.minimum(np.abs(known[at] - values), np.abs(known[at - 1] - values))
    return values[off > 1e-9 * np.maximum(np.abs(values), 1e-300)]


def strangers(
    values: np.ndarray, data: bytes, more: Callable[[bytes, np.ndarray], np.ndarray] | None = None
) -> np.ndarray:
    """Numbers that are not in the text, in any unit, encoding or, with `more`, further writing of its format."""
    values = np.unique(values[np.isfinite(values)])
    for encoding, errors in (("utf-8", "replace"), ("cp1252", "replace"), ("utf-16", "ignore")):
        if not len(values):
            return values
        known = decimal_numbers(data.decode(encoding, errors))
        values = np.array([v for v in values.tolist() if v not in known])
        if len(values):
            base = np.array(sorted(known))
            values = away_from(values, np.concatenate([base * f for f in FACTORS]))
            if more is not None and len(values):
                values = away_from(values, more(data, base))
    return values


def of_mgd77(data: bytes, base: np.ndarray) -> np.ndarray:
    """Numbers with the implied decimals of MGD77: what stands in its fields of hundred-thousandths and tenths."""
    found = list(base)
    plain = data.removeprefix(b"\xef\xbb\xbf")
    decoded_ = plain.decode("utf-8", "replace") + "\n" + plain.decode("cp1252", "replace")
    for line in decoded_.split("\n"):
        for first, length, digits in (
            (27, 8, 5), (35, 9, 5), (60, 6, 1), (66, 6, 1), (72, 6, 1), (90, 7, 1), (103, 5, 1),
        ):  # fmt: skip
            text = line[first : first + length].strip()
            if re.fullmatch(r"[+-]?\d+", text, re.ASCII):
                found.append(int(text) / 10**digits)
    return np.array([*found, 0.0])


def of_gxf(data: bytes, base: np.ndarray) -> np.ndarray:
    """Numbers of a GXF grid: plain or in base 90, scaled by its transform."""
    text = data.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n")
    if "#GRID" not in text.upper():
        return base
    number = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[edED][+-]?\d+)?)"
    told = re.search(rf"^#TRAN[^\n]*?\s[,\s]*{number}[,\s]+{number}", text, re.IGNORECASE | re.MULTILINE)
    scale, zero = (
        (float(g.replace("d", "e")) if g else d for g, d in zip(told.groups(), (1.0, 0.0), strict=True))
        if told
        else (1.0, 0.0)
    )
    body = "".join(line.strip() for line in re.split("#GRID", text, maxsplit=1, flags=re.IGNORECASE)[1].split("\n")[1:])
    coded = [
        sum((ord(c) - 37) * 90 ** (n - 1 - k) for k, c in enumerate(body[at : at + n]))
        for n in range(1, 5)
        for at in range(len(body) - n + 1)
    ]
    return np.concatenate([base, np.asarray([*base, *coded, 0.0], dtype=np.float64) * scale + zero])


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


def lines(data: bytes, folder: Path) -> np.ndarray:
    """Positions and values of survey lines."""
    path = folder / "lines.txt"
    path.write_bytes(data)
    points, _, _ = line_points(path, None, None, None, None, False if b"Line" in data else None)
    return np.concatenate([points.values, points.y])  # longitudes are put on one turn


def iaga(data: bytes, folder: Path) -> np.ndarray:
    """All components of an observatory's record."""
    path = folder / "iaga.min"
    path.write_bytes(data)
    return np.concatenate([np.zeros(0), *read_iaga2002(path).components.values()])


def trackline(data: bytes, folder: Path) -> np.ndarray:
    """All columns of a marine trackline file but its times."""
    path = folder / "leg.txt"
    path.write_bytes(data)
    table = load_table(path)
    return np.concatenate([np.zeros(0), *(table.floats(c) for c in table.columns if c.kind in ("x", "y", "value"))])


def nmea_file(data: bytes, folder: Path) -> np.ndarray:
    """The readings of a file of NMEA sentences, as a track."""
    path = folder / "log.nmea"
    path.write_bytes(data)
    return np.asarray(geomag.read_track(path, missing="drop").values)


def grid(data: bytes, name: str, folder: Path) -> np.ndarray:
    """Values of a map."""
    path = folder / name
    path.write_bytes(data)
    found = read_grid(
        path,
        geographic=None if name.endswith((".nc", ".gdf")) else "emag2" in name or "degrees" in name,
        **({"columns": (2, 3, 5)} if "emag2" in name else {}),
    )
    return np.asarray(found.values, dtype=np.float64).ravel()


def stored(values: np.ndarray, data: bytes) -> np.ndarray:
    """Values of a map that no stretch of a binary file spells, as a number of any width, either end first, in any unit."""
    left = np.unique(values[np.isfinite(values)])
    known: list[np.ndarray] = []
    for size, kinds in ((8, "fiu"), (4, "fiu"), (2, "fiu"), (1, "iu")):
        for at in range(size):
            whole = data[at : at + (len(data) - at) // size * size]
            with np.errstate(all="ignore"):
                known += [np.frombuffer(whole, f"{end}{k}{size}").astype(np.float64) for k in kinds for end in "<>"]
    base = np.unique(np.concatenate(known))
    base = base[np.isfinite(base)]
    left = left[~np.isin(left, base)]
    return away_from(left, np.concatenate([base * f for f in FACTORS])) if len(left) else left


def of_tiff(values: np.ndarray, data: bytes) -> np.ndarray:
    """The same for a GeoTIFF; one whose damaged header speaks of bits that are no whole bytes, or of a predictor, is let pass."""
    bits = re.search(rb"\x02\x01\x03\x00\x01\x00\x00\x00(.)\x00", data, re.DOTALL)
    return stored(values, data) if bits and bits[1][0] in (8, 16, 32, 64) else np.zeros(0)


def of_oasis(values: np.ndarray, data: bytes) -> np.ndarray:
    """The same for an Oasis montaj grid, whose numbers are scaled and moved as its header says."""
    zero, factor = np.frombuffer(data[60:76], "<f8")
    known = np.frombuffer(data[512 : 512 + (len(data) - 512) // 8 * 8], "<f8")
    with np.errstate(all="ignore"):
        known = np.concatenate([known / factor + zero, [zero]])
    left = np.unique(values[np.isfinite(values)])
    return away_from(left, known[np.isfinite(known)]) if len(left) else left


@cache
def made() -> dict[str, bytes]:
    """Small files of the formats that tests/cases has none of, written by their own libraries where there are such."""
    rows = "\n".join(f"{x} {y} {10 * x + y:.1f}" for y in (46, 45) for x in (10, 11, 12))
    out = {
        "plain.gdf": f"functional gravity_disturbance\nunit mgal\nlongitude_parallels 3\nlatitude_parallels 2\ngapvalue 99999.0\n"
        f"longitude latitude gravity_disturbance\n[deg.] [deg.] [mgal]\nend_of_head ====\n{rows}\n",
        "comma.csv": "Zeit;Easting (m);Northing (m);TMI (nT)\n0;500000,5;5100000,25;48000,1\n1;500010,5;5100001,25;48001,2\n2;500020,5;5100002,25;-7,5\n",
        "units.txt": "time X_km Y_km mag_uT\ns km km uT\n0 500.1 5100.2 48.001\n1 500.2 5100.3 48.002\n2 500.3 5100.4 *\n",
        "quoted.csv": '"Date","Time","Lat (deg)","Lon (deg)","TMI [nT]","Note"\n2026-01-05,23:59:58,45.5,10.25,48000.5,"a, b"\n'
        '2026-01-05,23:59:59,45.6,10.26,48001.5,""\n',
        "wide.csv": "\ufefflon\tlat\tvalue\n10.5\t45.5\t-12.25\n10.6\t45.6\t99999\n10.7\t45.7\t3.5\n",
        "rmc.nmea": "".join(f"{s}*{_sum(s):02X}\r\n" for s in (
            "$GPRMC,235959.50,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W", "$PGMAG,48650.1",
            "$GPRMC,000000.50,A,4807.048,N,01131.010,E,022.4,084.4,240394,003.1,W", "$PGMAG,48651.25",
            "$GPGSV,2,1,08,01,40,083,46,02,17,308,41", "$GPGGA,000001,4807.058,S,01131.020,W,1,08,0.9,545.4,M,46.9,M,,", "$PGMAG,-3.5")),
        "smw.min": "".join(f" {k:<23}{v:<45}|\n" for k, v in (("Format", "IAGA-2002"), ("Station Name", "Somewhere"), ("IAGA CODE", "SMW"),
                   ("Geodetic Latitude", "47.0"), ("Geodetic Longitude", "10.0"), ("Elevation", "500"), ("Reported", "XYZF")))
        + " # a note                                                             |\nDATE       TIME         DOY     SMWX      SMWY      SMWZ      SMWF   |\n"
        + "".join(f"2026-03-01 00:0{k}:00.000 060     2100{k}.25   100{k}.50  4300{k}.75  {'99999.00' if k == 2 else f'4786{k}.10'}\n" for k in (1, 2)),
        "leg.mgd77": "".join(f"5TEST0001  019850612235{k}500 101234{k}-1799999{k}199999999999999945123{k}99999999999999999999999999999999999  -12{k}99999999999{k}\n"
                             for k in (0, 1)),
        "leg.m77t": "SURVEY_ID TIMEZONE DATE TIME LAT LON MAG_TOT MAG_RES FREEAIR\nA 0 19910812 2359.5 18.8489 -155.325 45123.4  -12.3\n"
        "A 0 19910813 0000.5 18.8496 -155.322 45124.4  \n".replace(" ", "\t"),
        "dsaa.grd": "DSAA\n4 3\n0 300\n0 200\n0.5 11.5\n0.5 1.5 2.5 3.5\n4.5 5.5 1.70141e38 7.5\n8.5 9.5 10.5 11.5\n",
    }  # fmt: skip
    binary = {k: v.encode() for k, v in out.items()} | {"wide16.csv": out["wide.csv"].encode("utf-16")}
    values = 0.5 + np.arange(12.0).reshape(3, 4)
    with tempfile.TemporaryDirectory() as folder:
        _rasters(Path(folder), values)
        _netcdfs(Path(folder), values)
        binary |= {p.name: p.read_bytes() for p in sorted(Path(folder).iterdir()) if not p.name.endswith(".xml")}
    return binary


def _sum(sentence: str) -> int:
    total = 0
    for byte in sentence[1:].encode():
        total ^= byte
    return total


def _rasters(folder: Path, values: np.ndarray) -> None:
    rasterio = __import__("rasterio")
    profile = {"height": 3, "width": 4, "count": 1, "transform": rasterio.transform.from_origin(5e5, 5.1e6, 100, 100)}
    for name, driver, kind, more in (
        ("small.tif", "GTiff", "float32", {"crs": "EPSG:32632"}), ("small.ers", "ERS", "float32", {"crs": "EPSG:32632"}),
        ("six.grd", "GSBG", "float32", {}), ("seven.grd", "GS7BG", "float64", {}), ("whole.tif", "GTiff", "int16", {"crs": "EPSG:4326"}),
    ):  # fmt: skip
        if name == "whole.tif":
            profile["transform"] = rasterio.transform.from_origin(10.0, 47.0, 0.01, 0.01)
        with rasterio.open(folder / name, "w", driver=driver, dtype=kind, **profile | more) as out:
            out.write(values.astype(kind), 1)


def _netcdfs(folder: Path, values: np.ndarray) -> None:
    dataset = __import__("netCDF4").Dataset
    for name, form in (("classic.nc", "NETCDF3_CLASSIC"), ("four.nc", "NETCDF4")):
        with dataset(folder / name, "w", format=form) as out:
            for axis, numbers, unit in (
                ("lat", 44.0 + 0.5 * np.arange(3), "degrees_north"),
                ("lon", 8.0 + 0.5 * np.arange(4), "degrees_east"),
            ):
                out.createDimension(axis, len(numbers))
                out.createVariable(axis, "f8", (axis,))[:] = numbers
                out[axis].units = unit
            out.createVariable("mag", "f4", ("lat", "lon"), fill_value=np.float32(99999.0))[:] = values
            out["mag"].units = "nT"
    with dataset(folder / "gmt.nc", "w", format="NETCDF3_CLASSIC") as out:
        out.createDimension("side", 2)
        out.createDimension("xysize", 12)
        for name, kind, dim, numbers, unit in (
            ("x_range", "f8", "side", (8.0, 9.5), "longitude"), ("y_range", "f8", "side", (44.0, 45.0), "latitude"),
            ("z_range", "f8", "side", (0.5, 11.5), "nT"), ("spacing", "f8", "side", (0.5, 0.5), None),
            ("dimension", "i4", "side", (4, 3), None), ("z", "f4", "xysize", values.ravel(), None),
        ):  # fmt: skip
            out.createVariable(name, kind, (dim,))[:] = np.asarray(numbers)
            if unit:
                out[name].units = unit
        out["z"].node_offset = np.int32(0)


def _case(*names: str) -> dict[str, bytes]:
    return {n: (CASES / n).read_bytes() for n in names}


Source = dict[str, bytes]
Read = Callable[[bytes], np.ndarray]
Strange = Callable[[np.ndarray, bytes], np.ndarray]


@cache
def kinds(folder: Path) -> dict[str, tuple[Source, list[Read], Strange]]:
    """By name of a kind: files to mutate, readers (which are told apart where there are several), and what no value may be."""
    logs = {p.name: b"\n".join(p.read_bytes().split(b"\n")[:4]) for p in LOGS}
    lines_ = (CASES / "lines-date-line.csv").read_bytes().split(b"\n")
    at = partial(partial, folder=folder)
    text = _case(*(p.name for p in TEXT_GRIDS))
    found: dict[str, tuple[Source, list[Read], Strange]] = {
        "log": (logs | _case("stream-latitude-first.csv") | {k: made()[k] for k in ("comma.csv", "units.txt", "quoted.csv", "wide.csv", "wide16.csv")}, [track, csv], strangers),
        "nmea": (_case("nmea-noise.txt") | {"rmc.nmea": made()["rmc.nmea"]}, [nmea, at(nmea_file)], strangers),
        "lines": (_case("lines-geosoft.xyz") | {"date-line.csv": b"\n".join(lines_[:3] + lines_[200:202])}, [at(lines)], strangers),
        "iaga": ({"smw.min": made()["smw.min"]}, [at(iaga)], strangers),
        "mgd77": ({k: made()[k] for k in ("leg.mgd77", "leg.m77t")}, [at(trackline)], partial(strangers, more=of_mgd77)),
        "esri": ({"grid-esri.asc": text["grid-esri.asc"]}, [], strangers),
        "gxf": ({k: v for k, v in text.items() if k.endswith("gxf")}, [], partial(strangers, more=of_gxf)),
        "xyz": ({"grid-surfer-blanks.xyz": text["grid-surfer-blanks.xyz"]}, [], strangers),
        "columns": ({"grid-emag2-columns.csv": text["grid-emag2-columns.csv"]}, [], strangers),
        "gdf": ({"plain.gdf": made()["plain.gdf"]}, [], strangers),
        "netcdf": ({k: made()[k] for k in ("classic.nc", "four.nc")}, [], stored),
        "gmt": ({"gmt.nc": made()["gmt.nc"]}, [], stored),
        "tiff": ({k: made()[k] for k in ("small.tif", "whole.tif")}, [], of_tiff),
        "dsaa": ({"dsaa.grd": made()["dsaa.grd"]}, [], strangers),
        "surfer": ({k: made()[k] for k in ("six.grd", "seven.grd")}, [], stored),
        "ers": ({"small.ers": made()["small.ers"]}, [], lambda values, data: stored(values, made()["small"])),
        "oasis": (_case("grid-degrees-oasis.grd"), [], of_oasis),
    }  # fmt: skip
    # Three older kinds, by whose seeds the first findings are known.
    found["text"] = ({p.name: p.read_bytes() for p in STREAMS}, [track, csv], strangers)
    found["grid"] = (text, [], partial(strangers, more=of_gxf))
    found["binary"] = (_case(*(p.name for p in BINARY_GRIDS)), [], lambda values, data: np.zeros(0))
    return found


#: Readers of text, which are to stand 10^6 inputs each, and of grids, 10^5 each.
TEXT = ("log", "nmea", "lines", "iaga", "mgd77")
GRIDS = ("esri", "gxf", "xyz", "columns", "gdf", "netcdf", "gmt", "tiff", "dsaa", "surfer", "ers", "oasis")
#: Seconds that one input may take.
HANG_S = 30


def one(kind: str, seed: int, folder: Path) -> str | None:
    """What is wrong with the answer to one mutated input; None where nothing is."""
    rng = np.random.default_rng(seed)
    sources, readers, strange_to = kinds(folder)[kind]
    names = list(sources)
    name = names[int(rng.integers(0, len(names)))]
    data = mutated(sources[name], rng)
    if name == "small.ers":
        (folder / "small").write_bytes(made()["small"])
    if kind == "text" and name.endswith(".txt"):
        readers = [nmea]
    for read in readers or [partial(grid, name=name, folder=folder)]:

        def label(read: Read = read) -> str:
            return f"{name}, seed {seed}, {getattr(read, 'func', read).__name__}"

        try:
            values = read(data)
        except geomag.GeomagError:
            continue
        except Exception as error:
            return f"{label()}: {type(error).__name__}: {error}"
        strange = strange_to(values, data)
        if strange.size:
            return f"{label()}: {strange[:3]} not in {data[:300]!r}"
    return None


def _hung(*_: object) -> None:
    raise TimeoutError(f"needed an answer within {HANG_S} s")


def run(kind: str, first: int, count: int, told: Callable[[int], None] = lambda seed: None) -> list[str]:
    """What is wrong with `count` seeds from `first` on; every seed is told before it is tried."""
    wrong = []
    signal.signal(signal.SIGALRM, _hung)
    shared = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory(dir=shared) as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", geomag.DataWarning)
        for seed in range(first, first + count):
            told(seed)
            signal.alarm(HANG_S)
            if found := one(kind, seed, Path(folder)):
                wrong.append(found)
        signal.alarm(0)
    return wrong


def everything(record: Path, share: float, only: list[str], chunk: int) -> int:
    """Every reader to its full count (times `share`), a piece of each in turn, in processes that may crash or hang without ending the rest."""
    kept = json.loads(record.read_text()) if record.exists() else {}
    full = {k: math.ceil(share * n) for kinds, n in ((TEXT, 1_000_000), (GRIDS, 100_000)) for k in kinds}
    full = {k: n for k, n in full.items() if not only or k in only}
    for kind in full:
        kept.setdefault(kind, {"inputs": 0, "seconds": 0.0, "wrong": []})
    at = record.with_name(record.name + ".at")
    while left := {k: n - kept[k]["inputs"] for k, n in full.items() if kept[k]["inputs"] < n}:
        for kind, more in left.items():
            state = kept[kind]
            # Text is to be fed ten times as much, and costs a tenth.
            count = min(more, chunk if kind in TEXT else chunk // 10)
            before = os.times()
            done = subprocess.run(
                [sys.executable, __file__, kind, str(count), str(state["inputs"]), "--at", str(at)], capture_output=True, text=True, check=False,
            )  # fmt: skip
            after = os.times()
            state["seconds"] += (
                after.children_user - before.children_user + after.children_system - before.children_system
            )
            if done.returncode in (0, 1):
                state["wrong"] += done.stdout.splitlines()[:-1]
                state["inputs"] += count
            else:  # the process itself went down: the seed it was at is a finding, and it goes on after that
                seed = int(at.read_text())
                state["wrong"].append(f"seed {seed}: the process ended with {done.returncode}: {done.stderr[-300:]}")
                state["inputs"] = seed + 1
            part = record.with_name(record.name + ".part")
            part.write_text(json.dumps(kept, indent=1))
            part.replace(record)
    for kind, state in kept.items():
        sys.stdout.write(
            f"{kind:8} {state['inputs']:9,} inputs  {state['seconds']:7.0f} s  {len(state['wrong'])} wrong\n"
        )
    return sum(len(s["wrong"]) for s in kept.values())


def main() -> int:
    """Command line: a kind and a count, or everything."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("kind", choices=["all", *TEXT, *GRIDS, "text", "grid", "binary"])
    asked.add_argument("count", type=int, nargs="?", default=10_000, help="inputs")
    asked.add_argument("first", type=int, nargs="?", default=0, help="seed of the first")
    asked.add_argument(
        "--record", type=Path, default=Path("fuzz.json"), help="with 'all': counts and findings, gone on from"
    )
    asked.add_argument("--share", type=float, default=1.0, help="with 'all': part of the full counts")
    asked.add_argument("--only", nargs="+", default=[], help="with 'all': these readers")
    asked.add_argument("--chunk", type=int, default=50_000, help="with 'all': inputs of a text reader in one turn")
    asked.add_argument("--at", type=Path, help="file for the seed that is being tried")
    given = asked.parse_args()
    if given.kind == "all":
        return everything(given.record, given.share, given.only, given.chunk)
    file = None if given.at is None else os.open(given.at, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    wrong = run(
        given.kind,
        given.first,
        given.count,
        (lambda s: None) if file is None else lambda s: os.pwrite(file, b"%010d" % s, 0),
    )
    for found in wrong:
        sys.stdout.write(found.replace("\n", "\\n") + "\n")
    sys.stdout.write(f"{given.kind}: {given.count} inputs from seed {given.first}, {len(wrong)} wrong\n")
    return min(len(wrong), 1)


if __name__ == "__main__":
    raise SystemExit(main())
