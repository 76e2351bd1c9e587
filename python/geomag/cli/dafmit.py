"""`geomag dafmit`: the public flights, for those who have the data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geomag.cli import app
from geomag.cli._checks import not_negative, positive
from geomag.cli.navigate import ins_model
from geomag.io import read_grid


@app.command(epilog="Example: geomag dafmit flights/ Renfrew_395.nc --map-sigma 3")
def dafmit(
    folder: Annotated[Path, typer.Argument(help="Folder with Flt1003_train.h5, Flt1007_train.h5 and the like.")],
    map: Annotated[Path, typer.Argument(help="Anomaly map of the area in degrees, at the height flown.")],
    line: Annotated[list[float] | None, typer.Option(help="Lines; those that were published if not given.")] = None,
    ins: Annotated[str, typer.Option(help="Grade of the INS, or a TOML file with its figures.")] = "navigation",
    reading: Annotated[str, typer.Option(help="Column of the readings.")] = "mag_1_igrf",
    position_sigma_m: Annotated[
        float, typer.Option(callback=positive, help="Standard deviation of the start, m.")
    ] = 100.0,
    map_sigma: Annotated[
        float | None, typer.Option(callback=not_negative, help="Standard deviation of the map's own error.")
    ] = None,
) -> int:
    """Navigate lines of the DAF-MIT flights from a cold start, beside the published figures."""
    from geomag.dafmit import LINES, navigate_lines, table

    grid = read_grid(map, sigma=map_sigma)
    done = navigate_lines(
        folder, grid, lines=line or LINES, ins=ins_model(ins), reading=reading, position_sigma_m=position_sigma_m
    )
    typer.echo(table(done))
    return 0
