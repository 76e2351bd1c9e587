"""`geomag stream`: samples from standard input, a fix a line on standard output."""

from __future__ import annotations

import itertools
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from geomag import stream as pipe
from geomag._geomag import Iema
from geomag.cli import NO_FIX, app
from geomag.cli._checks import not_negative, positive
from geomag.cli.match import default_half_width_m
from geomag.io import read_grid


class Input(StrEnum):
    """Formats of the samples."""

    csv = "csv"
    nmea = "nmea"


@app.command(
    epilog="Example: tail -n +1 -f log.csv | geomag stream survey.nc --sigma 15 --half-width-m 1500 --tolerance-m 300",
)
def stream(
    map: Annotated[Path, typer.Argument(help="Map file.")],
    sigma: Annotated[float, typer.Option(callback=positive, help="Standard deviation of a measured value.")] = 10.0,
    half_width_m: Annotated[float | None, typer.Option(callback=positive, help="Bound of the INS error, m.")] = None,
    tolerance_m: Annotated[
        float, typer.Option(callback=not_negative, help="Extent of the feasible set that is unique enough, m.")
    ] = 0.0,
    max_misses: Annotated[int, typer.Option(min=0, help="Gate violations that a candidate survives.")] = 0,
    input: Annotated[
        Input, typer.Option(help="csv: x,y,value or time,x,y,value, or as a header says. nmea: GGA or RMC, $PGMAG.")
    ] = Input.csv,
    restart: Annotated[bool, typer.Option(help="Begin anew after a fix, or when lost.")] = True,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    geographic: Annotated[bool | None, typer.Option(help="Map coordinates are degrees.")] = None,
) -> int:
    """Read samples from standard input, write one JSON object a sample to standard output, at once."""
    grid = read_grid(map, variable, geographic=geographic)
    if hasattr(sys.stdin, "reconfigure"):  # noise on a serial line is for the reader to refuse by its line
        sys.stdin.reconfigure(errors="replace")
    samples = (pipe.read_csv if input is Input.csv else pipe.read_nmea)(sys.stdin)
    first = next(samples, None)
    if first is None:
        return NO_FIX
    reach = default_half_width_m(grid) if half_width_m is None else half_width_m
    east, north = grid.metres_per_unit(first.y)
    matcher = Iema(
        grid,
        sigma=sigma,
        half_width=(reach / east, reach / north),
        tolerance=(tolerance_m / east, tolerance_m / north),
        max_misses=max_misses,
    )
    last = pipe.run(matcher, itertools.chain([first], samples), sys.stdout, restart=restart)
    return 0 if last is not None and last.ok else NO_FIX
