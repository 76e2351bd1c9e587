"""`geomag stress`: does what a fix declares hold, on right maps and under effects that nobody told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geomag.cli import app
from geomag.cli._checks import output, positive
from geomag.io import read_grid


@app.command(
    epilog="Example: geomag stress --short; geomag stress map.nc --half-width-m 1000 --tolerance-m 200 --spacing-m 200"
)
def stress(
    source: Annotated[
        Path | None,
        typer.Argument(help="Map over which heights and steps of the bias are flown; without one, right maps."),
    ] = None,
    half_width_m: Annotated[
        float, typer.Option(callback=positive, help="Bound of the INS error, m (with a map).")
    ] = 1000,
    tolerance_m: Annotated[float, typer.Option(callback=positive, help="Error beyond which a fix is wrong, m.")] = 200,
    spacing_m: Annotated[
        float, typer.Option(callback=positive, help="Distance between samples, m (with a map).")
    ] = 200,
    flights: Annotated[int, typer.Option(min=1, help="Flights a row.")] = 200,
    tell: Annotated[
        bool, typer.Option(help="Tell every row its own effect: height_sigma_m or leg_bias_sigma (with a map).")
    ] = False,
    short: Annotated[bool, typer.Option(help="A few rows only.")] = False,
    streaming: Annotated[bool, typer.Option(help="Sample by sample, up to the first fix (right maps).")] = False,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    out: Annotated[Path | None, typer.Option(callback=output, help="Write the table (Markdown) to this file.")] = None,
) -> int:
    """Fly where the truth is known: every row counts fixes, wrong ones beside the number declared, and normalised errors."""
    from geomag.stress import flights_with_effect, right_maps, table

    if source is not None:
        rows = flights_with_effect(
            read_grid(source, variable),
            half_width_m=half_width_m,
            tolerance_m=tolerance_m,
            spacing_m=spacing_m,
            flights=flights,
            tell=tell,
        )
    elif short:
        rows = right_maps(
            cells_m=[1000], shortest_cells=[4], sigmas=[0.3, 5], samples=[40, 100], flights=flights, streaming=streaming
        )
    else:
        rows = right_maps(flights=flights, streaming=streaming)
    text = table(rows, None if source is None else 0.01)
    if out is not None:
        out.write_text(text, encoding="utf-8")
    print(text, end="")
    return 0
