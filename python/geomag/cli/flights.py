"""`geomag flights`: does what a navigator declares hold on one's own survey."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from geomag.cli import app
from geomag.cli._checks import MAX_SEED, output, picture, positive
from geomag.cli._common import jsonable, teller
from geomag.cli.navigate import ins_model


class Filter(StrEnum):
    """What navigates."""

    navigator = "navigator"
    smoothed = "smoothed"
    ekf = "ekf"
    rbpf = "rbpf"
    windows = "windows"


class Simulation(StrEnum):
    """How the INS is made up."""

    equations = "equations"
    strapdown = "strapdown"


@app.command(
    epilog="Example: geomag flights lines.csv.gz --hours 2 --ins navigation --out flights.md --plot flights.png",
)
def flights(
    lines: Annotated[Path, typer.Argument(help="Survey lines (CSV).")],
    hours: Annotated[float, typer.Option(callback=positive, help="Hours of a flight.")] = 2.0,
    ins: Annotated[
        str, typer.Option(help="Grade of the INS, navigation or tactical, or a TOML file with its figures.")
    ] = "navigation",
    draws: Annotated[int, typer.Option(min=1, help="INSs a flight.")] = 3,
    most: Annotated[int, typer.Option(min=1, help="Most flights a fold.")] = 5,
    folds: Annotated[int, typer.Option(min=2, help="Parts of the lines that are left out in turn.")] = 3,
    speed_m_s: Annotated[float, typer.Option(callback=positive, help="Speed, m/s.")] = 70.0,
    position_sigma_m: Annotated[
        float, typer.Option(callback=positive, help="Standard deviation of the start on each axis, m.")
    ] = 100.0,
    simulation: Annotated[
        Simulation, typer.Option(help="INS by its error equations, or by integrating its own readings (pyins).")
    ] = Simulation.equations,
    method: Annotated[
        list[Filter] | None, typer.Option(help="What navigates; more than one fly the same flights.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of all that is drawn.")] = 0,
    x: Annotated[str, typer.Option(help="Column of x or longitude.")] = "longitude",
    y: Annotated[str, typer.Option(help="Column of y or latitude.")] = "latitude",
    value: Annotated[str, typer.Option(help="Column of the values.")] = "total_field_anomaly_nt",
    line: Annotated[str, typer.Option(help="Column of the line labels.")] = "line",
    geographic: Annotated[bool, typer.Option(help="Coordinates are degrees.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of a table.")] = False,
    out: Annotated[Path | None, typer.Option(callback=output, help="Write the table (Markdown) to this file.")] = None,
    plot: Annotated[
        Path | None, typer.Option(callback=picture, help="Write error and bound over time to this file.")
    ] = None,
) -> int:
    """Fly whole flights along lines that are not in the map, and report errors against what was declared."""
    from geomag.navigation_report import NavigationReport, calibrate_navigation, fold_maps
    from geomag.survey import read_lines

    say = teller(as_json)
    survey = read_lines(lines, x=x, y=y, value=value, line=line, geographic=geographic)
    maps = fold_maps(survey, folds=folds)
    asked = {
        "ins": ins_model(ins), "name": f"{lines.name}, {ins}", "folds": folds, "hours": hours, "draws": draws, "flights": most,
        "speed_m_s": speed_m_s, "position_sigma_m": position_sigma_m, "simulation": simulation.value, "maps": maps, "seed": seed,
    }  # fmt: skip
    reports = [calibrate_navigation(survey, method=one.value, **asked) for one in method or [Filter.navigator]]  # type: ignore[arg-type]
    text = NavigationReport.table(reports)
    say(text)
    if as_json:
        typer.echo(json.dumps(jsonable({one.method: one.summary() for one in reports})))
    if out is not None:
        out.write_text(text + "\n", encoding="utf-8")
    if plot is not None:
        reports[0].plot(plot)
    return 0
