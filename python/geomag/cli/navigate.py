"""`geomag navigate`: a flight from a map file and a log, or live from a pipe."""

from __future__ import annotations

import json
import sys
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from geomag._errors import InvalidInputError, MissingFileError
from geomag._explained import explained
from geomag._geomag import GridMap, InsModel, Navigator
from geomag._navigation import Navigation
from geomag._navigation import navigate as navigate_log
from geomag.cli import NO_FIX, _raw, app
from geomag.cli._checks import not_negative, output, picture, positive, share
from geomag.cli._common import jsonable, telling, with_told_errors
from geomag.flight_log import FlightLog, LogRow, read_flight_log, read_rows
from geomag.io import read_grid
from geomag.projection import AlignedWarning

Array = npt.NDArray[np.float64]

GRADES = {"navigation": InsModel.navigation, "tactical": InsModel.tactical}
#: Statuses whose position may be used.
USABLE = ("tracking", "coasting")


def ins_model(text: str) -> InsModel:
    """A grade by its name, or the figures of an INS in a TOML file (names as of `InsModel`; those not given are the navigation grade's)."""
    if text in GRADES:
        return GRADES[text]()
    path = Path(text)
    if not path.is_file():
        raise MissingFileError(f"--ins: needed {', '.join(GRADES)} or a TOML file, got '{text}'")
    try:
        figures = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidInputError(f"{path}: needed TOML, got: {error}") from error
    figures = figures.get("ins", figures)
    usual = InsModel.navigation().to_dict()
    for name, value in figures.items():
        if name not in usual:
            raise InvalidInputError(f"{path}: needed figures among {', '.join(usual)}, got '{name}'")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InvalidInputError(f"{path}: {name}: needed a number, got {value!r}")
    return InsModel(**{**usual, **{k: float(v) for k, v in figures.items()}})


@app.command(
    epilog="Example: geomag navigate survey.nc log.csv --ins navigation --plot flight.png --report flight.html",
)
def navigate(
    map: Annotated[Path, typer.Argument(help="Map file: netCDF, GeoTIFF, Surfer, GXF, Oasis montaj, xyz text.")],
    log: Annotated[
        Path,
        typer.Argument(
            help="Log: text with a header: time_s, position, reading (empty where there is none), and if there are velocity_east_m_s, "
            "velocity_north_m_s, heading_deg, true_x, true_y. '-' reads a pipe and answers a line at once."
        ),
    ],
    ins: Annotated[
        str, typer.Option(help="Grade of the INS, navigation or tactical, or a TOML file with its figures.")
    ] = "navigation",
    position_sigma_m: Annotated[
        float | None, typer.Option(callback=positive, help=explained(Navigator, "position_sigma_m"))
    ] = None,
    reading_sigma: Annotated[
        float | None, typer.Option(callback=not_negative, help=explained(Navigator, "reading_sigma"))
    ] = None,
    bias_sigma: Annotated[
        float | None, typer.Option(callback=not_negative, help=explained(Navigator, "bias_sigma"))
    ] = None,
    integrity_risk: Annotated[
        float | None, typer.Option(callback=share, help=explained(Navigator, "integrity_risk"))
    ] = None,
    gravity: Annotated[bool | None, typer.Option("--gravity", help=explained(Navigator, "gravity"))] = None,
    map_sigma: Annotated[
        float | None,
        typer.Option(
            callback=not_negative, help="Standard deviation of the map's own error, 0 for a map that is right."
        ),
    ] = None,
    line_spacing_m: Annotated[
        float | None,
        typer.Option(
            callback=positive, help="Distance between the lines of the survey behind the map, instead of --map-sigma."
        ),
    ] = None,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    geographic: Annotated[bool | None, typer.Option(help="Map coordinates are degrees.")] = None,
    time: Annotated[str | None, typer.Option(help="Column of the time, seconds.")] = None,
    x: Annotated[str | None, typer.Option(help="Column of x or longitude.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of y or latitude.")] = None,
    value: Annotated[str | None, typer.Option(help="Column of the readings.")] = None,
    main_field: Annotated[str | None, typer.Option(help=_raw.MAIN_FIELD)] = None,
    date: Annotated[str | None, typer.Option(help=_raw.DATE)] = None,
    base: Annotated[Path | None, typer.Option(help=_raw.BASE)] = None,
    height_m: Annotated[str | None, typer.Option(help=_raw.HEIGHT)] = None,
    map_height_m: Annotated[float | None, typer.Option(help=_raw.MAP_HEIGHT)] = None,
    json_: Annotated[
        bool, typer.Option("--json", help="Print one JSON object: how it ends, and the figures of the flight.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(callback=output, help="Write the navigated track, a row a step, to this CSV file.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(callback=picture, help="Write a picture to this file: map, log and bounds.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(callback=output, help="Write a self-contained HTML page to this file.")
    ] = None,
) -> int:
    """Navigate: correct what an INS indicates with readings of a field, and say how far it can be trusted."""
    grid = read_grid(map, variable, geographic=geographic, sigma=map_sigma)
    grid = with_told_errors(grid, line_spacing_m, map_sigma)
    model = ins_model(ins)
    # What is not told stands at the navigator's own defaults.
    options: dict[str, Any] = {
        "ins": model, "position_sigma_m": position_sigma_m, "reading_sigma": reading_sigma, "bias_sigma": bias_sigma,
        "integrity_risk": integrity_risk, "gravity": gravity,
    }  # fmt: skip
    columns = {"time_s": time, "x": x, "y": y, "value": value}
    raw = _raw.Raw(main_field, date, base, height_m, map_height_m)
    grid = raw.map(grid)
    if str(log) == "-":
        files = (("--plot", plot), ("--report", report), ("--out", out))
        for name, asked in (*files, ("--main-field", main_field), ("--base", base), ("--height-m", height_m)):
            if asked is not None:
                raise InvalidInputError(f"{name}: needed a log in a file, got a pipe")
        return live(Navigator(grid, **options), grid, columns)
    flown = read_flight_log(log, dated=raw.dated, height=raw.column, **columns)
    heights, above = raw.heights(grid, flown.height_m, flown.x.size)
    reduction = raw.reduction(flown.date, above)
    if reduction is not None:
        places = _raw.in_degrees(grid, flown.x, flown.y, flown.geographic)
        left = raw.tell(reduction, *places, float(np.ptp(flown.time_s)))
        if "walk_nt_sqrt_s" in left:
            options["bias_walk_sqrt_s"] = left["walk_nt_sqrt_s"]
        flown = replace(flown, readings=flown.readings + reduction.correction(*places, None))
    if flown.geographic and not grid.geographic:
        options["latitude_deg"] = float(np.mean(flown.y))
    with telling():
        flown = flown.on_map(grid)
    if not json_:
        for word in raw.said:
            typer.echo(word)
    flight = navigate_log(
        grid,
        flown.time_s,
        flown.x,
        flown.y,
        velocity_m_s=flown.velocity_m_s,
        heading_deg=flown.heading_deg,
        readings=flown.readings,
        height_m=heights,
        **options,
    )
    truth = None if flown.truth is None else (flown.truth[:, 0], flown.truth[:, 1])
    if out is not None:
        write_track(out, flight, flown)
    settings: dict[str, object] = {"map": map, "log": log, "ins": ins} | model.to_dict()
    told = {"position-sigma-m": position_sigma_m, "reading-sigma": reading_sigma, "integrity-risk": integrity_risk}
    settings |= {name: value for name, value in told.items() if value is not None}
    if plot is not None:
        from geomag.plot import navigation_figure, save

        save(navigation_figure(grid, flight, (flown.x, flown.y), flown.readings, truth=truth), plot)
    if report is not None:
        from geomag.report import navigation_page

        title = f"Flight of {log.name} over {map.name}"
        navigation_page(
            report, grid, flight, (flown.x, flown.y), flown.readings, truth=truth, settings=settings, title=title
        )
    tell(grid, flight, truth, as_json=json_)
    return 0 if flight.status[-1] in USABLE else NO_FIX


def tell(grid: GridMap, flight: Navigation, truth: tuple[Array, Array] | None, *, as_json: bool) -> None:
    """Print how the flight ends and its figures."""
    from geomag._navigation import Navigation

    assert isinstance(flight, Navigation)
    figures = flight.summary(truth)
    figures["protection_level_median_m"] = figures.pop("protection_level_m")
    if as_json:
        last = {
            "status": str(flight.status[-1]), "reason": str(flight.reason[-1]), "ok": bool(flight.status[-1] in USABLE), "time_s": flight.time_s[-1],
            "x": flight.x[-1], "y": flight.y[-1], "covariance_m2": flight.covariance_m2[-1], "protection_level_m": flight.protection_level_m[-1],
            "velocity_error_m_s": flight.velocity_error_m_s[-1], "heading_error_deg": flight.heading_error_deg[-1], "bias": flight.bias[-1],
            "steps": len(flight), "inputs": flight.inputs, **figures,
        }  # fmt: skip
        typer.echo(json.dumps(jsonable(last)))
        return
    sigma = np.sqrt(np.diag(flight.covariance_m2[-1]))
    unit = "degrees" if grid.geographic else "m"
    hours = (flight.time_s[-1] - flight.time_s[0]) / 3600
    typer.echo(f"status      {flight.status[-1]} ({flight.reason[-1]}) after {hours:.2f} h, {len(flight)} steps")
    typer.echo(
        f"position    {flight.x[-1]:.8g}, {flight.y[-1]:.8g} {unit}, standard deviation {sigma[0]:.0f} m east, {sigma[1]:.0f} m north"
    )
    typer.echo(f"bound       {flight.protection_level_m[-1]:.0f} m (protection level)")
    shares = ", ".join(
        f"{name} {100 * figures[f'share_{name}']:.0f} %" for name in ("tracking", "coasting", "acquiring", "lost")
    )
    typer.echo(f"time        {shares}")
    if "drms_m" in figures:
        typer.echo(
            f"error       {figures['drms_m']:.0f} m rms, median {figures['median_m']:.0f} m, 95 % below {figures['p95_m']:.0f} m; within the 99 % radius "
            f"{100 * figures['within_99']:.1f} %, beyond the bound {100 * figures['beyond_protection']:.2f} %"
        )


def write_track(path: Path, flight: Navigation, log: FlightLog) -> None:
    """Write the corrected track, a row a step."""
    from geomag._navigation import Navigation

    assert isinstance(flight, Navigation)
    names = (
        "time_s,x,y,variance_east_m2,covariance_m2,variance_north_m2,protection_level_m,status,indicated_x,indicated_y"
    )
    with path.open("w", encoding="utf-8") as file:
        file.write(names + "\n")
        for k in range(len(flight)):
            c = flight.covariance_m2[k]
            numbers = (
                flight.time_s[k],
                flight.x[k],
                flight.y[k],
                c[0, 0],
                c[0, 1],
                c[1, 1],
                flight.protection_level_m[k],
            )
            file.write(
                ",".join(
                    [
                        *(repr(float(v)) for v in numbers),
                        str(flight.status[k]),
                        repr(float(log.x[k])),
                        repr(float(log.y[k])),
                    ]
                )
                + "\n"
            )


def live(navigator: Navigator, grid: GridMap, columns: dict[str, str | None]) -> int:
    """Answer every row of standard input with a JSON line, at once."""
    if hasattr(sys.stdin, "reconfigure"):  # noise on a serial line is for the reader to refuse by its line
        sys.stdin.reconfigure(errors="replace")
    status = "acquiring"
    for row in read_rows(sys.stdin, where="standard input", **columns):
        status = answer(navigator, _on_map(row, grid))
    return 0 if status in USABLE else NO_FIX


def _on_map(row: LogRow, grid: GridMap) -> LogRow:
    """A row in the map's coordinates."""
    if row.geographic is None or row.geographic == grid.geographic:
        return row
    one = np.array([0.0])
    log = FlightLog(
        one,
        np.array([row.x]),
        np.array([row.y]),
        one,
        None if row.velocity_m_s is None else np.array([row.velocity_m_s]),
        None if row.heading_deg is None else np.array([row.heading_deg]),
        geographic=row.geographic,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AlignedWarning)
        there = log.on_map(grid)
    return replace(
        row,
        x=float(there.x[0]),
        y=float(there.y[0]),
        velocity_m_s=None
        if there.velocity_m_s is None
        else (float(there.velocity_m_s[0, 0]), float(there.velocity_m_s[0, 1])),
        heading_deg=None if there.heading_deg is None else float(there.heading_deg[0]),
        geographic=grid.geographic,
    )


def answer(navigator: Navigator, row: LogRow) -> str:
    """Take one row, print what it leads to, return the status."""
    reading = None if np.isnan(row.value) else row.value
    step = navigator.step(row.time_s, row.x, row.y, row.velocity_m_s, row.heading_deg, reading)
    line = {
        "time_s": row.time_s, "status": step.status, "ok": step.status in USABLE, "x": step.x, "y": step.y, "covariance_m2": step.covariance_m2,
        "protection_level_m": step.protection_level_m, "outcome": step.outcome, "running_nis": step.running_nis, "bias": step.bias,
    }  # fmt: skip
    typer.echo(json.dumps(jsonable(line)))
    sys.stdout.flush()
    return str(step.status)
