"""`geomag map`: a map of survey lines with what it knows of its errors, in a file that keeps it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from geomag._progress import bar
from geomag.cli import app
from geomag.cli._checks import output, positive
from geomag.cli._common import jsonable, teller
from geomag.cli.info import summary


@app.command(
    name="map",
    epilog="Example: geomag map lines.csv.gz --out map.nc",
)
def make_map(
    lines: Annotated[Path, typer.Argument(help="Survey lines: CSV, Geosoft text or Parquet, one row a point.")],
    out: Annotated[Path, typer.Option(callback=output, help="netCDF file to write.")],
    spacing_m: Annotated[
        float | None, typer.Option(callback=positive, help="Node spacing, m. Default an eighth of the line spacing.")
    ] = None,
    method: Annotated[str, typer.Option(help="minimum_curvature, linear or cubic.")] = "minimum_curvature",
    smooth_m: Annotated[
        float | None, typer.Option(callback=positive, help="Average the lines over this length before, m.")
    ] = None,
    folds: Annotated[
        int | None,
        typer.Option(
            min=2, help="Parts that the lines are left out in when errors are learnt; 6 where there are lines enough."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the learning.")] = 0,
    x: Annotated[str | None, typer.Option(help="Column of x or longitude.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of y or latitude.")] = None,
    value: Annotated[str | None, typer.Option(help="Column of the values.")] = None,
    line: Annotated[str | None, typer.Option(help="Column of the line labels.")] = None,
    geographic: Annotated[
        bool | None, typer.Option(help="Coordinates are degrees; by default what the columns say.")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(help="Coordinate reference system of the lines, such as EPSG:32631.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the map; by default the column's.")] = None,
    units: Annotated[str | None, typer.Option(help="Unit of the values; by default the column's.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")] = False,
) -> int:
    """Grid survey lines, learn the map's errors from lines left out, and write a map that keeps them."""
    from geomag.io import line_points, save_grid
    from geomag.io._kept import labelled
    from geomag.survey import Lines, line_spacing_m, map_from_lines, smooth_lines

    points, labels, _ = line_points(lines, x, y, value, line, geographic)
    survey = Lines(points.x, points.y, points.values, labels, bool(points.geographic))
    if smooth_m is not None:
        survey = smooth_lines(survey, smooth_m)
    east, north = survey.scale_m()
    grid = map_from_lines(
        survey,
        spacing=None if spacing_m is None else (spacing_m / east, spacing_m / north),
        method=method,
        folds=folds,
        seed=seed,
        progress=None if as_json else bar("errors of the map "),
    )
    column = points.columns[2]
    grid = labelled(grid, name=name or column.name, units=units or points.unit, crs=crs)
    save_grid(grid, out)
    facts = summary(grid) | {"out": str(out), "line_spacing_m": line_spacing_m(survey)}
    if as_json:
        typer.echo(json.dumps(jsonable(facts)))
        return 0
    say = teller(False)
    rows, columns = grid.shape
    say(f"map       {grid.name}: {rows} x {columns} nodes of {grid.spacing_m[0]:.0f} x {grid.spacing_m[1]:.0f} m")
    say(f"lines     {len(set(labels.tolist()))}, {facts['line_spacing_m']:.0f} m apart")
    say(f"error     {facts['map_sigma']:.3g} {grid.units or 'value units'} in the median (one standard deviation)")
    say(f"written   {out}")
    return 0
