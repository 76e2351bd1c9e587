"""`geomag calibrate`: does the declared risk hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from geomag._defaults import default_of
from geomag._geomag import match_posterior
from geomag.cli import app
from geomag.cli._checks import half_turn, not_negative, output, picture, positive, share
from geomag.cli._common import with_told_errors
from geomag.io import read_grid


@app.command(
    epilog="Example: geomag calibrate lines.csv.gz --half-width-m 1000 --tolerance-m 200 --spacing-m 200 --plot out.png",
)
def calibrate(
    source: Annotated[Path, typer.Argument(help="Survey lines (CSV), or with --simulate a map file.")],
    half_width_m: Annotated[float, typer.Option(callback=positive, help="Bound of the INS error, m.")],
    tolerance_m: Annotated[float, typer.Option(callback=positive, help="Error beyond which a fix is wrong, m.")],
    spacing_m: Annotated[
        float, typer.Option(callback=positive, help="Distance between samples, m (lines only).")
    ] = 200.0,
    samples: Annotated[int, typer.Option(min=3, help="Samples of a track.")] = 40,
    simulate: Annotated[bool, typer.Option(help="Fly over the map instead of matching left-out lines.")] = False,
    sigma: Annotated[float, typer.Option(callback=positive, help="Sensor noise of the simulation, map units.")] = 1.0,
    map_sigma: Annotated[
        float | None,
        typer.Option(
            callback=not_negative,
            help="Error of the simulated map, map units; 0 for one that is right, not given for unknown.",
        ),
    ] = None,
    bias: Annotated[
        float,
        typer.Option(callback=not_negative, help="Greatest constant of the simulated readings; 0: known to be none."),
    ] = 0.0,
    outlier_share: Annotated[
        float, typer.Option(callback=share, help="Share of simulated readings that are outliers.")
    ] = 0.0,
    outlier: Annotated[float, typer.Option(callback=not_negative, help="Size of the outliers, map units.")] = 0.0,
    heading_deg: Annotated[
        float, typer.Option(callback=half_turn, help="Simulated heading error, one standard deviation.")
    ] = 0.0,
    drift_m: Annotated[
        float, typer.Option(callback=not_negative, help="Simulated drift over the track, told as a bound, m.")
    ] = 0.0,
    streaming: Annotated[bool, typer.Option(help="Stop every track at its first fix.")] = False,
    trials: Annotated[int, typer.Option(min=1, help="Most tracks.")] = 2000,
    overlap: Annotated[
        float, typer.Option(callback=share, help="Share of a window that the next one has too (lines only).")
    ] = 0.0,
    smooth_m: Annotated[
        float | None,
        typer.Option(callback=positive, help="Average the lines, map and readings, over this length (lines only)."),
    ] = None,
    max_risk: Annotated[float, typer.Option(callback=share, help="Risk up to which a fix is declared.")] = default_of(
        match_posterior, "max_risk"
    ),
    x: Annotated[str | None, typer.Option(help="Column of x or longitude.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of y or latitude.")] = None,
    value: Annotated[str | None, typer.Option(help="Column of the values.")] = None,
    line: Annotated[str | None, typer.Option(help="Column of the line labels.")] = None,
    geographic: Annotated[
        bool | None,
        typer.Option(help="Coordinates are degrees; by default what the file says."),
    ] = None,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    out: Annotated[Path | None, typer.Option(callback=output, help="Write the report (Markdown) to this file.")] = None,
    plot: Annotated[
        Path | None, typer.Option(callback=picture, help="Write the reliability diagram to this file.")
    ] = None,
) -> int:
    """Report declared risk against observed errors, on left-out lines of a survey or on simulated flights."""
    from geomag.calibration import calibrate_lines, calibrate_simulated
    from geomag.survey import read_lines, smooth_lines

    if simulate:
        grid = with_told_errors(read_grid(source, variable, geographic=geographic, sigma=map_sigma), None, map_sigma)
        result = calibrate_simulated(
            grid,
            sigma=sigma,
            name=f"{source.name}, simulated, sigma {sigma:g}",
            half_width_m=half_width_m,
            tolerance_m=tolerance_m,
            samples=samples,
            trials=trials,
            max_risk=max_risk,
            bias=bias,
            outlier_share=outlier_share,
            outlier=outlier,
            heading_deg=heading_deg,
            drift_m=drift_m,
            streaming=streaming,
            bias_sigma=None if bias else 0.0,
        )
    else:
        lines = read_lines(source, x=x, y=y, value=value, line=line, geographic=geographic)
        result = calibrate_lines(
            lines if smooth_m is None else smooth_lines(lines, smooth_m),
            name=source.name,
            half_width_m=half_width_m,
            tolerance_m=tolerance_m,
            spacing_m=spacing_m,
            samples=samples,
            most=trials,
            overlap=overlap,
            max_risk=max_risk,
            streaming=streaming,
        )
    text = result.to_markdown()
    typer.echo(text)
    if out is not None:
        out.write_text(text, encoding="utf-8")
    if plot is not None:
        result.plot(plot)
    return 0
