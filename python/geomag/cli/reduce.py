"""`geomag reduce`: raw readings of a log to what a map holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from geomag._errors import InvalidInputError, MissingFileError, ReadError, UnknownVariableError
from geomag._optional import require
from geomag.cli import app
from geomag.cli._checks import output
from geomag.cli._common import jsonable

#: Names by which columns are known, lower case.
_KNOWN = {
    "x": ("longitude", "lon"),
    "y": ("latitude", "lat"),
    "value": ("total_field_nt", "total_intensity_nt", "tmi", "tmi_nt", "mag_nt", "field_nt", "value"),
    "time": ("time", "datetime", "timestamp", "date", "utc"),
}


@app.command(
    epilog="Example: geomag reduce raw.csv reduced.csv --main-field igrf14 --height-m 900 --base observatory.min",
)
def reduce(
    log: Annotated[Path, typer.Argument(help="Log: CSV with a header, longitude and latitude in degrees.")],
    out: Annotated[Path, typer.Argument(callback=output, help="CSV to write: the log with a column anomaly_nt.")],
    main_field: Annotated[
        str | None, typer.Option(help="Main field to take off: igrf14, wmm2025, wmmhr2025 or a file of coefficients.")
    ] = None,
    height_m: Annotated[
        str, typer.Option(help="Height above the ellipsoid, m: a number, or the name of a column.")
    ] = "0",
    date: Annotated[
        str | None, typer.Option(help="One date for the whole log (ISO 8601); by default the column of dates.")
    ] = None,
    base: Annotated[
        Path | None, typer.Option(help="Record of a base station (IAGA-2002), whose variation is taken off.")
    ] = None,
    compensation: Annotated[
        Path | None, typer.Option(help="Vehicle's own field, as geomag.compensation saved it; needs --field.")
    ] = None,
    field: Annotated[
        str | None, typer.Option(help="Columns of the field along the vehicle's axes, nT: three names with commas.")
    ] = None,
    x: Annotated[str | None, typer.Option(help="Column of the longitude.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of the latitude.")] = None,
    value: Annotated[str | None, typer.Option(help="Column of the raw readings, nT.")] = None,
    time: Annotated[str | None, typer.Option(help="Column of the dates.")] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object with what was taken off.")] = False,
) -> int:
    """Take main field, daily variation and the vehicle's own field off the readings of a log.

    What was taken off is told; each of the three is optional, and one at least is needed.
    """
    if main_field is None and base is None and compensation is None:
        raise InvalidInputError("geomag reduce: needed --main-field, --base or --compensation, got none of them")
    if (compensation is None) != (field is None):
        raise InvalidInputError("--field: needed together with --compensation, got one of them")
    table = _table(log)
    readings = _numbers(table, log, value, "value")
    said: list[str] = []
    told: dict[str, Any] = {"rows": len(table), "out": str(out)}
    dates: Any = date
    if date is None and (main_field is not None or base is not None or compensation is not None):
        dates = _dates(table, log, time)
    if compensation is not None and field is not None:
        from geomag.compensation import Compensation

        if date is not None and time is None:
            raise InvalidInputError("--compensation: needed a column of times, got one --date for the whole log")
        when = _dates(table, log, time)
        seconds = (when - when[0]) / np.timedelta64(1, "us") * 1e-6
        names = field.split(",")
        if len(names) != 3:
            raise InvalidInputError(f"--field: needed three columns with commas between them, got {field!r}")
        axes = np.column_stack([_numbers(table, log, name.strip(), "field") for name in names])
        own = Compensation.from_json(compensation).interference(seconds, axes)
        readings = readings - own
        told["vehicle_nt"] = float(np.nanstd(own))
        said.append(f"vehicle     {np.nanstd(own):.2f} nT (standard deviation) by {compensation.name}")
    if main_field is not None or base is not None:
        lon, lat = (_numbers(table, log, given, what) for given, what in ((x, "x"), (y, "y")))
        if main_field is not None:
            from geomag.mainfield import MODELS, load

            model = load(main_field) if main_field in MODELS else load(Path(main_field).stem, main_field)
            try:
                height: Any = float(height_m)
            except ValueError:
                height = _numbers(table, log, height_m, "height_m")
            main = model.total(lon, lat, height, dates)
            readings = readings - main
            told |= {"main_field": model.name, "main_field_nt": [float(main.min()), float(main.max())]}
            said.append(f"main field  {main.min():.1f} to {main.max():.1f} nT by {model.name}")
        if base is not None:
            from geomag.diurnal import read_iaga2002

            when = np.broadcast_to(np.asarray(dates), readings.shape) if date is not None else dates
            removed = read_iaga2002(base).base().remove(when, lon, lat, readings)
            readings = removed.values
            told["variation_nt"] = [float(removed.variation_nt.min()), float(removed.variation_nt.max())]
            told |= {"left_nt": removed.sigma_nt, "correlation_time_s": removed.correlation_time_s}
            said.append(
                f"variation   {removed.variation_nt.min():+.1f} to {removed.variation_nt.max():+.1f} nT by {base.name}, "
                f"left {removed.sigma_nt:.1f} nT for {removed.correlation_time_s:.0f} s"
            )
    table["anomaly_nt"] = readings
    table.to_csv(out, index=False)
    extent = f"{np.nanmin(readings):.1f} to {np.nanmax(readings):.1f}"
    said.append(f"written     {out}, {len(table)} rows, anomaly_nt {extent}")
    typer.echo(json.dumps(jsonable(told)) if json_ else "\n".join(said))
    return 0


def _table(path: Path) -> Any:  # noqa: ANN401 - pandas'
    pandas = require("pandas", "io", "reading a log")
    if not path.is_file():
        raise MissingFileError(f"log: needed an existing file, got nothing at {path}")
    try:
        table = pandas.read_csv(path, comment="#", skipinitialspace=True)
    except (ValueError, OSError) as error:
        raise ReadError(f"{path}: needed CSV with a header, got: {error}") from error
    if table.empty:
        raise ReadError(f"{path}: needed rows, got none")
    return table


def _column(table: Any, path: Path, given: str | None, what: str) -> str:  # noqa: ANN401 - pandas'
    columns = [str(c) for c in table.columns]
    if given is not None:
        if given in columns:
            return given
        raise UnknownVariableError(f"{path}: needed a column '{given}', got {', '.join(columns)}")
    found = [c for known in _KNOWN.get(what, ()) for c in columns if c.strip().lower() == known]
    if not found:
        raise UnknownVariableError(f"{path}: needed a column for --{what}, got {', '.join(columns)}")
    return found[0]


def _numbers(table: Any, path: Path, given: str | None, what: str) -> np.ndarray:  # noqa: ANN401 - pandas'
    name = _column(table, path, given, what)
    try:
        return np.asarray(table[name], dtype=float)
    except (TypeError, ValueError) as error:
        raise ReadError(f"{path}, column '{name}': needed numbers, got: {error}") from error


def _dates(table: Any, path: Path, given: str | None) -> np.ndarray:  # noqa: ANN401 - pandas'
    """Dates in UTC; a time zone in the text is heeded."""
    pandas = require("pandas", "io", "reading a log")
    name = _column(table, path, given, "time")
    if pandas.api.types.is_numeric_dtype(table[name]):
        raise InvalidInputError(
            f"{path}, column '{name}': needed dates (ISO 8601), got numbers; give --date, or --time"
        )
    try:
        stamps = pandas.to_datetime(table[name], format="ISO8601", utc=True)
    except (ValueError, TypeError) as error:
        raise ReadError(f"{path}, column '{name}': needed dates in ISO 8601, got: {error}") from error
    return np.asarray(stamps.dt.tz_localize(None).to_numpy(), dtype="datetime64[us]")
