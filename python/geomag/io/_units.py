"""Units as files name them: what they measure and how much they are in geomag's own (metres, degrees, nT, mGal, s)."""

from __future__ import annotations

import json
import math
import re
from typing import Any

from geomag._errors import InvalidInputError
from geomag._optional import require

#: Metres in a unit of length.
METRES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters", "mtr"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1000.0),
    **dict.fromkeys(("ft", "foot", "feet", "international_foot", "international_feet"), 0.3048),
    **dict.fromkeys(
        ("us-ft", "ftus", "us_ft", "usft", "ft_us", "us_survey_foot", "us_survey_feet", "survey_foot"), 1200.0 / 3937.0
    ),
    **dict.fromkeys(("nmi", "nautical_mile", "nautical_miles"), 1852.0),
}
DEGREES = ("deg", "degree", "degrees", "°", "dd", "decimal_degrees", "degrees_east", "degrees_north",
           "degree_east", "degree_north", "degrees_e", "degrees_n", "degree_e", "degree_n", "dec_deg", "decimal_deg")  # fmt: skip
#: Other angles, which are refused by name rather than taken for degrees.
OTHER_ANGLES = ("rad", "radian", "radians", "grad", "gon", "arcmin", "arcsec", "mrad")
#: What a value unit measures, and its size in nT or mGal.
FIELD = {
    **dict.fromkeys(("nt", "nanotesla", "nanoteslas", "gamma", "gammas"), ("nT", 1.0)),
    **dict.fromkeys(("ut", "µt", "μt", "microtesla", "microteslas"), ("nT", 1e3)),
    **dict.fromkeys(("mt_tesla", "millitesla"), ("nT", 1e6)),
    **dict.fromkeys(("tesla", "t"), ("nT", 1e9)),
    **dict.fromkeys(("gauss",), ("nT", 1e5)),
    **dict.fromkeys(("mgauss", "milligauss"), ("nT", 1e2)),
    **dict.fromkeys(("mgal", "mgals", "milligal", "milligals"), ("mGal", 1.0)),
    **dict.fromkeys(("ugal", "µgal", "μgal", "microgal"), ("mGal", 1e-3)),
    **dict.fromkeys(("gal",), ("mGal", 1e3)),
    **dict.fromkeys(("gu", "g.u.", "um/s2", "µm/s2", "um/s^2", "µm/s²", "um_s-2"), ("mGal", 0.1)),
    **dict.fromkeys(
        ("m/s2", "m/s^2", "m/s**2", "m/s²", "m_s-2", "m_s**-2", "m_s^-2", "meter/second**2"), ("mGal", 1e5)
    ),
}
#: Gauss in letters, whose case counts: `mg` and `g` may be other things.
GAUSS = {"G": ("nT", 1e5), "Gs": ("nT", 1e5), "mG": ("nT", 1e2), "uG": ("nT", 0.1)}
#: Seconds in a unit of time.
SECONDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
}


def tidy(unit: str) -> str:
    """A unit in lower case, blanks as underscores, without a full stop."""
    return re.sub(r"\s+", "_", unit.strip().strip(".").lower())


def is_degree(unit: str) -> bool:
    """Whether a unit is degrees of arc."""
    return tidy(unit).startswith(("deg", "°")) or tidy(unit) in DEGREES


def check_sense(unit: str, where: str) -> None:
    """Refuse degrees that are counted to the west or to the south."""
    if is_degree(unit) and re.search(r"(west|south|[_\s]w|[_\s]s)$", tidy(unit)):
        raise InvalidInputError(
            f"{where}: needed degrees to the east and to the north, got {unit!r}; turn their signs first"
        )


def metres_in(unit: str | None, where: str) -> float:
    """Metres in a coordinate's unit; without one it is metres."""
    if unit is None or not unit.strip():
        return 1.0
    try:
        return METRES[tidy(unit)]
    except KeyError:
        raise InvalidInputError(
            f"{where}: needed coordinates in metres, kilometres, feet, survey feet or nautical miles, got {unit!r}"
        ) from None


def field_unit(unit: str | None) -> tuple[str, float] | None:
    """Whether a unit is one of a magnetic field or of gravity: nT or mGal and how many of them; None for any other."""
    if unit is None:
        return None
    return GAUSS.get(unit.strip()) or FIELD.get(tidy(unit))


def crs_of(text: object) -> Any:  # noqa: ANN401 - rasterio's
    """A coordinate reference system from words (EPSG code, WKT, PROJ), as rasterio has it."""
    rasterio = require("rasterio", "io", "coordinate reference systems")
    try:
        return rasterio.CRS.from_user_input(text)
    except (rasterio.errors.CRSError, ValueError, TypeError) as error:
        raise InvalidInputError(f"crs: needed a coordinate reference system, got {text!r} ({error})") from error


def metric_crs(crs: Any) -> Any:  # noqa: ANN401 - rasterio's
    """The same coordinate reference system with coordinates in metres."""

    def turned(node: dict[str, Any]) -> dict[str, Any]:
        node = {k: v for k, v in node.items() if k != "id"} | {"name": f"{node.get('name', 'unnamed')}, in metres"}
        if "components" in node:
            node["components"] = [turned(node["components"][0]), *node["components"][1:]]
        if "source_crs" in node:
            node["source_crs"] = turned(node["source_crs"])
        if "coordinate_system" in node:
            system = {k: v for k, v in node["coordinate_system"].items() if k != "id"}
            axes = [{k: v for k, v in axis.items() if k != "id"} | {"unit": "metre"} for axis in system["axis"]]
            node["coordinate_system"] = system | {"axis": axes}
        return node

    return type(crs).from_string(json.dumps(turned(crs.to_dict(projjson=True))))


def metric_text(text: str) -> str:
    """`metric_crs` of a CRS in words; one in metres stays as it is written."""
    crs = crs_of(text)
    return text if crs.is_geographic or crs.units_factor[1] == 1.0 else str(metric_crs(crs).to_wkt())


def crs_metres(crs: Any, where: str) -> float:  # noqa: ANN401 - rasterio's
    """Metres in a map unit of a projected system."""
    name, factor = crs.units_factor
    if not (math.isfinite(factor) and factor > 0):
        raise InvalidInputError(f"{where}: needed a unit of length of its coordinates, got {name!r}")
    return float(factor)


def check_degrees(crs: Any, where: str) -> None:  # noqa: ANN401 - rasterio's
    """Refuse a geographic system whose angles are no degrees."""
    if not math.isclose(crs.units_factor[1], math.radians(1.0), rel_tol=1e-6):
        raise InvalidInputError(f"{where}: needed longitude and latitude in degrees, got {crs.units_factor[0]}")


def ask_kind(where: str) -> InvalidInputError:
    """The question for degrees or metres."""
    return InvalidInputError(
        f"{where}: needed to know whether its coordinates are degrees or metres, got neither units nor names that say "
        "so; pass geographic=True or geographic=False"
    )


def same_kind(told: bool | None, said: bool, where: str) -> bool:
    """What the file says of degrees or metres, which a caller may repeat but not contradict."""
    if told is not None and told != said:
        raise InvalidInputError(
            f"{where}: needed geographic={said}, as the file says that its coordinates are "
            f"{'degrees' if said else 'no degrees'}, got geographic={told}"
        )
    return said
