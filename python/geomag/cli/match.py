"""`geomag match`: a fix from a map file and a track file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from geomag._defaults import default_of
from geomag._errors import InvalidInputError
from geomag._geomag import Fix, GridMap, Iema, Track, match_posterior
from geomag.cli import NO_FIX, _raw, app
from geomag.cli._checks import half_turn, not_negative, output, picture, positive, share
from geomag.cli._common import aligned, describe, fix_json, load_dated, three, with_told_errors
from geomag.cli._methods import (
    IEMA_SIGMA,
    LARGEST_IS_BEST,
    MEANT_FOR,
    NOT_TO_THE_LETTER,
    Feasible,
    Method,
    Settings,
    risk_of,
    solve,
)
from geomag.cli._settings import again
from geomag.io import read_grid

if TYPE_CHECKING:
    from geomag.reduction import Reduction


def default_half_width_m(grid: GridMap) -> float:
    """Two kilometres or ten cells, whichever is more."""
    return max(2000.0, 10.0 * max(grid.spacing_m))


@app.command(
    epilog="Example: geomag match survey.nc log.csv --half-width-m 1500 --sigma 2 --tolerance-m 200",
)
def match(
    context: typer.Context,
    map: Annotated[Path, typer.Argument(help="Map file: netCDF, GeoTIFF, Surfer, GXF, Oasis montaj, xyz text.")],
    track: Annotated[
        Path,
        typer.Argument(
            help="Track file: CSV, text or Parquet with position and value columns, or the log of a vehicle."
        ),
    ],
    method: Annotated[Method, typer.Option(help="Matcher.")] = Method.posterior,
    half_width_m: Annotated[
        float | None,
        typer.Option(
            callback=positive, help="Half size of the search, m: the bound of the INS error. Default 2000 or ten cells."
        ),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help=f"Standard deviation of a measured value. Needed by the IEMA gate: default {IEMA_SIGMA:g}; else estimated.",
        ),
    ] = None,
    remove_mean: Annotated[bool, typer.Option(help="Take a constant (base level, diurnal) out of msd and mad.")] = True,
    tolerance_m: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Posterior, contour: error within which a fix is right, m (by default the method's own). "
            "IEMA: extent of the feasible set that is unique enough, m.",
        ),
    ] = 0.0,
    max_risk: Annotated[
        float, typer.Option(callback=share, help="Posterior: declared risk up to which it is a fix.")
    ] = default_of(match_posterior, "max_risk"),
    map_sigma: Annotated[
        float | None,
        typer.Option(
            callback=not_negative,
            help="Posterior, contour: standard deviation of the map's own error, 0 for a map that is right. Not given: "
            "unknown, which costs the posterior fixes.",
        ),
    ] = None,
    line_spacing_m: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help="Posterior, contour: distance between the lines of the survey behind the map, instead of --map-sigma: the "
            "map's error is taken as typical of such a survey.",
        ),
    ] = None,
    max_misses: Annotated[
        int, typer.Option(min=0, help="IEMA: gate violations that a candidate survives.")
    ] = default_of(Iema, "max_misses"),
    heading_deg: Annotated[
        float,
        typer.Option(
            callback=half_turn,
            help="Search headings up to this, in five steps a side (not IEMA). Posterior, contour: standard deviation "
            "of the heading.",
        ),
    ] = 0.0,
    scale_sigma: Annotated[
        float,
        typer.Option(callback=not_negative, help="Posterior, contour: standard deviation of the speed error, a ratio."),
    ] = default_of(match_posterior, "scale_sigma"),
    letter: Annotated[
        bool,
        typer.Option(help="Contour: rigid ICCP to the letter, from the INS; otherwise a lattice of starts, refined."),
    ] = False,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns x,y,value of a text map: names, or numbers from 0 where it has no header."),
    ] = None,
    geographic: Annotated[bool | None, typer.Option(help="Map coordinates are degrees.")] = None,
    x: Annotated[str | None, typer.Option(help="Column of x or longitude.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of y or latitude.")] = None,
    value: Annotated[str | None, typer.Option(help="Column of the measured values.")] = None,
    xy_unit: Annotated[
        str | None, typer.Option(help="Unit of the log's coordinates (deg, m, km, ft), where it does not say one.")
    ] = None,
    value_unit: Annotated[
        str | None, typer.Option(help="Unit of the log's readings (nT, uT, mG, mGal), where it does not say one.")
    ] = None,
    position: Annotated[
        str | None,
        typer.Option(help="Stream of the positions of a log (PX4, ArduPilot, ROS, MagNav), where it has several."),
    ] = None,
    reading: Annotated[
        str | None, typer.Option(help="Stream of the readings of a log, or a number of any message as message.field.")
    ] = None,
    main_field: Annotated[str | None, typer.Option(help=_raw.MAIN_FIELD)] = None,
    date: Annotated[str | None, typer.Option(help=_raw.DATE)] = None,
    time: Annotated[str | None, typer.Option(help="Column of the times or dates.")] = None,
    base: Annotated[Path | None, typer.Option(help=_raw.BASE)] = None,
    height_m: Annotated[str | None, typer.Option(help=_raw.HEIGHT)] = None,
    map_height_m: Annotated[float | None, typer.Option(help=_raw.MAP_HEIGHT)] = None,
    drop_missing: Annotated[bool, typer.Option(help="Leave out rows with missing values instead of refusing.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object with the fields of the fix.")] = False,
    plot: Annotated[Path | None, typer.Option(callback=picture, help="Write a picture to this file.")] = None,
    report: Annotated[
        Path | None, typer.Option(callback=output, help="Write a self-contained HTML page to this file.")
    ] = None,
    geojson: Annotated[
        Path | None, typer.Option(callback=output, help="Write track and fix as GeoJSON to this file.")
    ] = None,
) -> int:
    """Find where a track truly ran, from a map and its measured values."""
    refuse_idle(context, method.value, letter)
    grid = read_grid(map, variable, geographic=geographic, columns=three(columns), sigma=map_sigma)
    if method.value in MEANT_FOR["line_spacing_m"]:
        grid = with_told_errors(grid, line_spacing_m, map_sigma)
    raw = _raw.Raw(main_field, date, base, height_m, map_height_m)
    grid = raw.map(grid)
    log, dates = load_dated(
        track,
        grid,
        (x, y, value),
        drop_missing,
        position=position,
        reading=reading,
        height=raw.column,
        time=time,
        dated=raw.dated,
        xy_unit=xy_unit,
        value_unit=value_unit,
    )
    heights, above = raw.heights(grid, log.height_m, len(log))
    samples = aligned(grid, log)
    samples = Track(
        samples.x, samples.y, samples.values, samples.time_s, height_m=heights, geographic=samples.geographic
    )
    reach = default_half_width_m(grid) if half_width_m is None else half_width_m
    told = Settings(
        half_width_m=reach,
        sigma=sigma,
        remove_mean=remove_mean,
        tolerance_m=tolerance_m,
        max_risk=max_risk,
        max_misses=max_misses,
        heading_deg=heading_deg,
        scale_sigma=scale_sigma,
        letter=letter,
        surface=plot is not None or report is not None,
    )
    reduction = raw.reduction(dates, above)
    if reduction is None:
        fix, steps = solve(grid, samples, method.value, told)
    else:
        fix, steps, samples = solve_raw(grid, log, samples, reduction, raw, method.value, told)
    if plot is not None:
        draw(grid, samples, fix, plot, method.value, steps)
    if report is not None:
        write_report(grid, samples, fix, report, method.value, steps, *again(context, {"half_width_m": reach}))
    if geojson is not None:
        from geomag.exchange import write_geojson

        crs = None if grid.geographic else grid.crs
        write_geojson(geojson, {"indicated": samples, "fix": fix}, crs=crs)
    if json_:
        typer.echo(fix_json(fix, method=method.value, half_width_m=reach))
    else:
        for line in raw.said:
            typer.echo(line)
        typer.echo("\n".join(describe(grid, samples, fix, risk_of(method.value, tolerance_m))))
    return 0 if fix.ok else NO_FIX


def solve_raw(
    grid: GridMap, log: Track, samples: Track, reduction: Reduction, raw: _raw.Raw, method: str, told: Settings
) -> tuple[Fix, list[Feasible], Track]:
    """A fix of raw readings, which are reduced where the log says, and again where they turn out to have been taken."""
    from geomag.reduction import match_with_reduction

    longitude, latitude = _raw.in_degrees(grid, log.x, log.y, log.geographic)
    span = None if samples.time_s is None else float(np.ptp(samples.time_s))
    left = raw.tell(reduction, longitude, latitude, span)
    told = replace(told, bias_drift_sigma=left.get("drift_nt", 0.0))
    frames: list[Feasible] = []

    def matcher(grid: GridMap, track: Track) -> Fix:
        nonlocal frames
        fix, frames = solve(grid, track, method, told)
        return fix

    found = match_with_reduction(
        grid,
        longitude,
        latitude,
        samples.values,
        reduction,
        time_s=samples.time_s,
        height_m=samples.height_m,
        matcher=matcher,
    )
    reduced = Track(
        samples.x,
        samples.y,
        found.values,
        samples.time_s,
        height_m=samples.height_m,
        geographic=samples.geographic,
    )
    return found.fix, frames, reduced


def refuse_idle(context: typer.Context, method: str, letter: bool) -> None:
    """Refuse options of the command line that the method would pass over; those of a settings file serve several."""
    for name, methods in MEANT_FOR.items():
        source = context.get_parameter_source(name)
        idle = method not in methods or (letter and name in NOT_TO_THE_LETTER)
        if source is not None and source.name == "COMMANDLINE" and idle:
            what = "contour without --letter" if method in methods else f"--method {' or '.join(sorted(methods))}"
            raise InvalidInputError(f"--{name.replace('_', '-')}: needed {what}, got {method}")


def draw(
    grid: GridMap,
    track: Track,
    fix: Fix,
    path: Path,
    method: str,
    steps: list[Feasible],
    truth: object | None = None,
    surface_fix: Fix | None = None,
) -> None:
    """Write the picture of a match."""
    from geomag._optional import require

    require("matplotlib", "plot", "pictures")
    from geomag.plot import Frame, match_figure, save

    figure = match_figure(
        grid,
        track,
        fix,
        truth=truth,
        steps=[Frame(*step) for step in steps] or None,
        surface_fix=surface_fix,
        surface_label=method,
        least_is_best=method not in LARGEST_IS_BEST,
    )
    save(figure, path)


def write_report(
    grid: GridMap,
    track: Track,
    fix: Fix,
    path: Path,
    method: str,
    steps: list[Feasible],
    settings: dict[str, object],
    command: str,
) -> None:
    """Write the HTML page of a match."""
    from geomag.plot import Frame
    from geomag.report import match_report

    match_report(
        path,
        grid,
        track,
        fix,
        steps=[Frame(*step) for step in steps] or None,
        surface_label=method,
        least_is_best=method not in LARGEST_IS_BEST,
        settings=settings,
        command=command,
        title=f"Match of {settings['track']} on {settings['map']}",
    )
