"""`geomag stream`: samples from standard input, a fix a line on standard output."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from geomag import stream as pipe
from geomag._defaults import default_of
from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Iema, PosteriorMatcher, SlidingContour
from geomag.cli import NO_FIX, app
from geomag.cli._checks import not_negative, positive, share
from geomag.cli._common import three, with_told_errors
from geomag.cli.match import default_half_width_m
from geomag.io import read_grid


class Input(StrEnum):
    """Formats of the samples."""

    csv = "csv"
    nmea = "nmea"


class Output(StrEnum):
    """Formats of the fixes."""

    json = "json"
    mavlink = "mavlink"


class Method(StrEnum):
    """Streaming matchers, the calibrated one first."""

    posterior = "posterior"
    iema = "iema"
    contour = "contour"


#: Options that one matcher has and the others have not.
_MEANT_FOR = {"max_misses": "iema", "max_risk": "posterior", "length": "contour"}


@app.command(
    epilog="Example: tail -n +1 -f log.csv | geomag stream survey.nc --sigma 15 --half-width-m 1500 --tolerance-m 300",
)
def stream(
    context: typer.Context,
    map: Annotated[Path, typer.Argument(help="Map file.")],
    method: Annotated[
        Method, typer.Option(help="Matcher; the calibrated one declares the risk of its fixes.")
    ] = Method.posterior,
    sigma: Annotated[float, typer.Option(callback=positive, help="Standard deviation of a measured value.")] = 10.0,
    half_width_m: Annotated[float | None, typer.Option(callback=positive, help="Bound of the INS error, m.")] = None,
    tolerance_m: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Error within which a fix is right, m (0: the method's own). IEMA: extent of the feasible set that is unique enough.",
        ),
    ] = 0.0,
    max_risk: Annotated[
        float, typer.Option(callback=share, help="Posterior: declared risk up to which it is a fix.")
    ] = default_of(PosteriorMatcher, "max_risk"),
    max_misses: Annotated[
        int, typer.Option(min=0, help="IEMA: gate violations that a candidate survives.")
    ] = default_of(Iema, "max_misses"),
    length: Annotated[int, typer.Option(min=3, help="Contour: samples of the sliding window.")] = 20,
    input: Annotated[
        Input,
        typer.Option(
            help="csv: x,y,value or time,x,y,value, or as a header says. nmea: GGA, RMC, GLL or GNS, then $PGMAG."
        ),
    ] = Input.csv,
    output: Annotated[
        Output, typer.Option(help="json: a line a sample. mavlink: an external-position message for each fix.")
    ] = Output.json,
    restart: Annotated[bool, typer.Option(help="Begin anew after a fix, or when lost.")] = True,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns x,y,value of a text map: names, or numbers from 0 where it has no header."),
    ] = None,
    geographic: Annotated[bool | None, typer.Option(help="Map coordinates are degrees.")] = None,
) -> int:
    """Read samples from standard input, write one JSON object a sample to standard output, at once; lines that cannot be read are told."""
    for name, meant in _MEANT_FOR.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE" and meant != method.value:
            raise InvalidInputError(f"--{name.replace('_', '-')}: needed --method {meant}, got {method.value}")
    grid = read_grid(map, variable, geographic=geographic, columns=three(columns))
    if method is not Method.iema:
        grid = with_told_errors(grid, None, None)
    writer = pipe.json_lines(sys.stdout)
    if output is Output.mavlink:
        from geomag.mavlink import Encoder

        if not grid.geographic and grid.crs is None:
            raise InvalidInputError(
                "--output: needed a map in degrees or with a reference system for mavlink, got one in metres without"
            )
        writer = pipe.mavlink_messages(sys.stdout.buffer, Encoder(crs=None if grid.geographic else grid.crs))
    if hasattr(sys.stdin, "reconfigure"):  # noise on a serial line is for the reader to pass over by its line
        sys.stdin.reconfigure(errors="replace")
    samples = pipe.on_map(grid, (pipe.read_csv if input is Input.csv else pipe.read_nmea)(sys.stdin))
    first = next(samples, None)
    if first is None:
        typer.echo("geomag: no sample came that can be read", err=True)
        return NO_FIX
    reach = default_half_width_m(grid) if half_width_m is None else half_width_m
    east, north = grid.metres_per_unit(first.y)
    half_width = (reach / east, reach / north)
    make: dict[Method, Callable[[GridMap], pipe.Matcher]] = {
        Method.posterior: lambda grid: PosteriorMatcher(
            grid, half_width=half_width, sigma=sigma, tolerance_m=tolerance_m or None, max_risk=max_risk
        ),
        Method.iema: lambda grid: Iema(
            grid,
            sigma=sigma,
            half_width=half_width,
            tolerance=(tolerance_m / east, tolerance_m / north),
            max_misses=max_misses,
        ),
        Method.contour: lambda grid: SlidingContour(
            grid,
            length=length,
            sigma=sigma,
            starts="grid",
            refine=True,
            half_width_m=reach,
            offset_sigma_m=reach / 3.0,
            tolerance_m=tolerance_m or None,
        ),
    }
    last = pipe.run(make[method](grid), itertools.chain([first], samples), writer, restart=restart)
    return 0 if last is not None and last.ok else NO_FIX
