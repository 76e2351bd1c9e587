"""What the columns of a table are, from their names: longitude or easting, reading, height, time, and the unit that a name carries."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

from geomag._errors import InvalidInputError, UnknownVariableError
from geomag.io._units import (
    DEGREES,
    FIELD,
    GAUSS,
    METRES,
    OTHER_ANGLES,
    SECONDS,
    check_sense,
    field_unit,
    is_degree,
    tidy,
)

Kind = Literal["x", "y", "value", "sigma", "height", "time", "date", "line", "other"]
System = Literal["geographic", "projected", None]

_LONGITUDE = {"longitude", "lon", "lng", "long", "longi", "longit", "longitud", "longitudine", "gpslon", "gpslong",
              "gpslongitude", "lonwgs84", "longitudewgs84", "wgs84lon", "wgs84longitude", "lonx"}  # fmt: skip
_LATITUDE = {"latitude", "lat", "lati", "latit", "latitud", "latitudine", "gpslat", "gpslatitude", "latwgs84",
             "latitudewgs84", "wgs84lat", "wgs84latitude", "laty"}  # fmt: skip
_EASTING = {
    "easting",
    "eastings",
    "east",
    "utme",
    "utmx",
    "xutm",
    "eutm",
    "utmeasting",
    "eastutm",
    "projectionxcoordinate",
}
_NORTHING = {"northing", "northings", "north", "utmn", "utmy", "yutm", "nutm", "utmnorthing", "northutm",
             "projectionycoordinate"}  # fmt: skip
_X = {"x", "xcoord", "xcoordinate", "coordx", "xpos", "posx", "xposition"}
_Y = {"y", "ycoord", "ycoordinate", "coordy", "ypos", "posy", "yposition"}
_HEIGHT = {"z", "alt", "altitude", "height", "elev", "elevation", "h", "hae", "msl", "altmsl", "gpsalt", "gpsaltitude",
           "gpsheight", "ellipsoidalheight", "heightoverell", "depth", "radalt", "radar", "baro", "clearance",
           "heightm", "gpsz", "terrain", "dem", "dtm", "topo", "bathymetry"}  # fmt: skip
_TIME = {"time", "t", "seconds", "datetime", "timestamp", "utc", "utctime", "timeutc", "gpstime", "timestamputc", "datetimeutc",
         "unixtime", "epoch", "isotime", "hhmmss", "hhmm", "timeofday", "clock", "tow", "tt", "fidtime", "boottime",
         "timeboot", "secofday", "secondsofday", "posixtime", "timesincestart", "elapsed"}  # fmt: skip
_DATE = {"date", "utcdate", "gpsdate", "day", "dateutc"}
_LINE = {"line", "lineid", "lineno", "linenumber", "linename", "flightline", "flightlineid", "fltline", "leg", "track"}
_VALUE = re.compile(
    r"(value|values|reading|readings|measurement|measured|field|anomaly|anom|tmi|tmf|tfa|tma|mag|magnetic|magnetics|magnetometer|"
    r"totalfield|totalfieldanomaly|totalmagneticfield|totalmagneticintensity|totalintensity|totalmagneticanomaly|"
    r"magneticanomaly|magneticfield|magneticintensity|maganomaly|maganom|magneticintensityanomaly|btotal|bmag|fieldintensity|"
    r"residual|residualfield|gravity|grav|gravityanomaly|gravitydisturbance|freeair|freeairanomaly|faa|fag|bouguer|"
    r"bougueranomaly|disturbance|crustal|crustalfield|magc|magcomp|magcompensated|magraw|rawmag|tmicomp|magtotal|totalmag|magfield|fieldstrength|magneticfieldstrength|tmiraw|rawtmi)(\d{0,2})c?"
)
#: Words of a name that make it no reading although its unit is a field's.
_NO_READING = {"sigma", "error", "err", "std", "stdev", "uncertainty", "unc", "noise", "rms", "accuracy", "igrf", "wmm",
               "diurnal", "base", "basemag", "reference", "regional", "model", "core", "correction", "cor", "heading", "count",
               "lag", "gradient", "grad"}  # fmt: skip
_SPREAD = {"sigma", "error", "err", "std", "stdev", "uncertainty", "unc", "accuracy"}
_BRACKETED = re.compile(r"^(.*?)[\s_]*[(\[{<]\s*([^)\]}>]*?)\s*[)\]}>]\s*$")
_WITHIN = re.compile(r"^(\S.*?)\s*[(\[]\s*([^)\]]+?)\s*[)\]]\s*(\S.*)$")
#: Units that an underscore or blank may set off at the end of a name.
_ENDINGS = {u for table in (METRES, DEGREES, OTHER_ANGLES, FIELD, SECONDS) for u in table} - {
    "t",
    "d",
    "h",
    "gal",
    "mt_tesla",
}
_EASTWARD, _NORTHWARD = re.compile(r"(east|[_\s]e|°e)$"), re.compile(r"(north|[_\s]n|°n)$")
_CLOCK_ENDINGS = ("hhmmss", "hhmm")


@dataclass(frozen=True)
class Column:
    """A column: its name in the file, what it is, the unit that is known of it and for a coordinate its system."""

    index: int
    name: str
    kind: Kind
    system: System = None
    unit: str | None = None

    @property
    def base(self) -> str:
        """The name without its unit."""
        return _split_unit(self.name)[0]


def _compact(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


def _split_unit(name: str) -> tuple[str, str | None]:
    """A name without its unit, and the unit: `Lat (deg)`, `X_km`, `mag_nT`, `TimeUS`."""
    name = name.strip().strip('"').strip()
    found = _BRACKETED.match(name)
    if found and found[1]:
        return found[1], found[2] or None
    inner = _WITHIN.match(name)
    if inner and tidy(inner[2]) in _ENDINGS:
        return f"{inner[1]} {inner[3]}", inner[2]
    words = re.split(r"[\s_\-/,.:]+", name)
    for count in (3, 2, 1):
        if len(words) > count:
            ending = "_".join(words[-count:]).lower()
            if ending in _ENDINGS or ending in _CLOCK_ENDINGS or (count == 1 and words[-1] in GAUSS):
                return name[: len(name) - len("_".join(words[-count:]))].rstrip(" _-/,.:"), "_".join(words[-count:])
    camel = re.fullmatch(r"([Tt]ime(?:[Ss]tamp)?|TIME)(US|us|ms|MS|ns|NS)", name)
    return (camel[1], camel[2]) if camel else (name, None)


def understand(index: int, name: str, unit: str | None = None) -> Column:
    """What a column is, from its name and, where the file has a row of units, from its unit."""
    base, own = _split_unit(name)
    unit = unit or own
    compact = _compact(base)
    words = re.split(r"[^a-z0-9]+", base.lower())
    kind, system = _kind(compact, words, unit)
    if kind in ("x", "y") and unit is not None and "utm" in unit.lower():
        system, unit = "projected", None
    if kind in ("x", "y") and unit is not None:
        if tidy(unit) in ("w", "west", "s", "south"):
            check_sense(f"degrees {unit}", f"column '{name}'")
        if is_degree(unit):
            check_sense(unit, f"column '{name}'")
            # A unit that says which way it counts says what the column is, also where it is called x.
            way = "x" if _EASTWARD.search(tidy(unit)) else "y" if _NORTHWARD.search(tidy(unit)) else kind
            if way != kind and system is not None:
                raise InvalidInputError(f"column '{name}': needed one kind of coordinate, got {base!r} in {unit}")
            kind = cast("Kind", way)
            if system == "projected":
                raise InvalidInputError(f"column '{name}': needed one kind of coordinate, got {base!r} in {unit}")
            system = "geographic"
        elif tidy(unit) in METRES:
            if system == "geographic":
                raise InvalidInputError(f"column '{name}': needed one kind of coordinate, got {base!r} in {unit}")
            system = "projected"
    return Column(index, name, kind, system, unit)


def _kind(compact: str, words_in_order: list[str], unit: str | None) -> tuple[Kind, System]:
    words = set(words_in_order)
    for names, kind, system in (
        (_LONGITUDE, "x", "geographic"), (_LATITUDE, "y", "geographic"), (_EASTING, "x", "projected"),
        (_NORTHING, "y", "projected"), (_X, "x", None), (_Y, "y", None), (_TIME, "time", None), (_DATE, "date", None),
        (_LINE, "line", None),
    ):  # fmt: skip
        if compact in names:
            return kind, system  # type: ignore[return-value]
    # Whose longitude it is (`ins_lon`, `gps1_longitude`) does not make it another thing, but two of them are asked about.
    if words & {"true", "truth", "reference", "ref"}:
        return "other", None
    last = re.sub(r"[^a-z]", " ", " ".join(words_in_order)).split()[-1:] or [""]
    if last[0] in ("lon", "longitude", "lng", "lat", "latitude"):
        return ("x" if last[0] in _LONGITUDE else "y"), "geographic"
    field = field_unit(unit) if unit and tidy(unit) not in ("m/s2", "m/s^2", "m/s²") else None
    if compact in _HEIGHT and field is None:
        return "height", None
    if unit is not None and tidy(unit) in SECONDS and "time" in words and not words & _NO_READING:
        return "time", None
    if words & _SPREAD:
        return "sigma", None
    if words & _NO_READING:
        return "other", None
    if field is not None or _VALUE.fullmatch(compact):
        return "value", None
    return "other", None


def columns_of(names: Sequence[str], units: Sequence[str | None] | None = None) -> list[Column]:
    """Every column of a table; two of the very same name are refused."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InvalidInputError(f"header: needed columns of different names, got '{name}' twice")
        seen.add(name)
    return [understand(k, name, units[k] if units else None) for k, name in enumerate(names)]


def _listed(columns: Sequence[Column]) -> str:
    return ", ".join(c.name for c in columns)


def asked_column(columns: Sequence[Column], asked: str | int, where: object) -> Column:
    """The column of a name (in any case, with or without its unit) or of a number (from 0, of a file without a header)."""
    text = str(asked).strip()
    for same in (
        [c for c in columns if c.name == text],
        [c for c in columns if c.name.lower() == text.lower()],
        [c for c in columns if c.base.lower() == text.lower()],
        [columns[asked]] if isinstance(asked, int) and 0 <= asked < len(columns) else [],
    ):
        if len(same) == 1:
            return same[0]
        if same:
            raise UnknownVariableError(f"{where}: needed one column, got '{text}', which may be {_listed(same)}")
    raise UnknownVariableError(f"{where}: needed a column among {_listed(columns)}, got '{text}'")


def the_one(columns: Sequence[Column], what: str, candidates: Sequence[Column], where: object) -> Column:
    """The only candidate; none and several are asked about, naming the columns and the keyword."""
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        raise UnknownVariableError(f"{where}: needed a column for {what}, got {_listed(columns)}; name it with {what}=")
    raise UnknownVariableError(
        f"{where}: needed one column for {what}, got {len(candidates)}: {_listed(candidates)}; name one with {what}="
    )


def coordinate_columns(
    columns: Sequence[Column],
    x: str | int | None,
    y: str | int | None,
    where: object,
    geographic: bool | None = None,
) -> tuple[Column, Column]:
    """The columns of x and y, both of one system; with one of them asked for, the other follows."""
    found: dict[str, Column] = {}
    for what, asked in (("x", x), ("y", y)):
        if asked is not None:
            found[what] = asked_column(columns, asked, where)
    system = next((c.system for c in found.values() if c.system), None)
    if system is None and geographic is not None:
        system = "geographic" if geographic else "projected"
    for what in ("x", "y"):
        if what not in found:
            usable = [c for c in columns if c.kind == what and c not in found.values()]
            same = [c for c in usable if system is not None and c.system == system]
            found[what] = the_one(columns, what, same or usable, where)
    px, py = found["x"], found["y"]
    if px.index == py.index:
        raise InvalidInputError(f"{where}: needed different columns for x and y, got '{px.name}' for both")
    if px.kind == "y" and py.kind != "y" and x is None:
        raise InvalidInputError(f"{where}: needed a column for x, got '{px.name}'")
    if px.system and py.system and px.system != py.system:
        raise InvalidInputError(
            f"{where}: needed x and y in degrees, or both in metres, got columns '{px.name}' and '{py.name}'"
        )
    return px, py
