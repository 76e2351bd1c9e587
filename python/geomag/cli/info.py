"""`geomag info`: what is in a map and whether one can navigate on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from geomag._geomag import GridMap
from geomag.cli import app
from geomag.cli._checks import positive
from geomag.cli._common import jsonable, three
from geomag.io import read_grid


def summary(grid: GridMap) -> dict[str, object]:
    """Extent, spacing, statistics of values and gradient (per kilometre, at cell centres)."""
    x, y, values = grid.x, grid.y, np.asarray(grid.values, dtype=float)
    known = values[np.isfinite(values)]
    stride = max(1, int(np.sqrt(values.size / 250_000)))
    cx, cy = np.meshgrid(0.5 * (x[:-1] + x[1:])[::stride], 0.5 * (y[:-1] + y[1:])[::stride])
    east, north = grid.gradient(cx, cy)
    slope = 1000.0 * np.hypot(east, north)
    slope = slope[np.isfinite(slope)]
    quantiles = np.quantile(slope, [0.1, 0.5, 0.9]) if slope.size else np.full(3, np.nan)
    spacing = grid.spacing_m
    model = grid.error_model
    return {
        "name": grid.name,
        "units": grid.units,
        "crs": grid.crs,
        "geographic": grid.geographic,
        "shape": list(values.shape),
        "x": [float(x[0]), float(x[-1])],
        "y": [float(y[0]), float(y[-1])],
        "spacing": list(grid.spacing),
        "spacing_m": list(spacing),
        "dtype": str(grid.values.dtype),
        "holes": int(grid.holes),
        "holes_share": float(grid.holes / values.size),
        "minimum": float(known.min()),
        "maximum": float(known.max()),
        "mean": float(known.mean()),
        "std": float(known.std()),
        "gradient_per_km": {"p10": quantiles[0], "median": quantiles[1], "p90": quantiles[2]},
        "line_spacing_m": grid.line_spacing_m,
        "map_sigma": None if grid.sigma is None else float(np.nanmedian(grid.sigma)),
        "error_model": None
        if model is None
        else {k: v for k, v in model.items() if isinstance(v, (int, float, tuple))},
        "height_m": None
        if grid.height_m is None
        else [float(np.nanmin(grid.height_m)), float(np.nanmax(grid.height_m))],
    }


def known(grid: GridMap, facts: dict[str, object]) -> list[str]:
    """What the map knows beyond its values, a line each."""
    lines = []
    if facts["map_sigma"] is not None:
        learnt = "learnt with its error model" if grid.error_model is not None else "without an error model"
        lines.append(
            f"error     {facts['map_sigma']:.3g} {grid.units or 'value units'} in the median (one standard deviation), {learnt}"
        )
    else:
        lines.append("error     not known: matchers take it for one of unknown size")
    if grid.line_spacing_m is not None:
        lines.append(f"lines     {grid.line_spacing_m:.0f} m apart")
    if grid.height_m is not None:
        low, high = float(np.nanmin(grid.height_m)), float(np.nanmax(grid.height_m))
        lines.append(f"height    {low:.0f} m" if low == high else f"height    {low:.0f} .. {high:.0f} m (draped)")
    if grid.crs:
        lines.append(f"system    {grid.crs if len(grid.crs) < 60 else grid.crs[:57] + '...'}")
    return lines


@app.command(
    epilog="Example: geomag info survey.nc --sigma 5",
)
def info(
    map: Annotated[Path, typer.Argument(help="Map file: netCDF, GeoTIFF, Surfer, GXF, Oasis montaj, xyz text.")],
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF file.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns x,y,value of a text map: names, or numbers from 0 where it has no header."),
    ] = None,
    geographic: Annotated[bool | None, typer.Option(help="Coordinates are degrees.")] = None,
    sigma: Annotated[
        float, typer.Option(callback=positive, help="Standard deviation of a measured value, map error included.")
    ] = 5.0,
    json_: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """What is in a map, its statistics, and whether one can navigate on it."""
    grid = read_grid(map, variable, geographic=geographic, columns=three(columns))
    facts = summary(grid)
    slope = facts["gradient_per_km"]["median"]  # type: ignore[index]
    # n samples across a slope g of noise s give a position to s / (g sqrt(n)); 30 is an ordinary sequence.
    reach = float(1000.0 * sigma / slope / np.sqrt(30)) if slope > 0 else float("inf")
    facts["position_sigma_m_30_samples"] = reach
    if json_:
        typer.echo(json.dumps(jsonable(facts)))
        return 0
    unit = "deg" if grid.geographic else "m"
    shown = ".6g" if grid.geographic else ".0f" if min(grid.spacing) >= 1.0 else ".3f"
    value = grid.units or "value units"
    rows, width = grid.shape
    lines = [
        f"map       {grid.name or map.name}: {rows} x {width} nodes, {facts['dtype']}",
        f"x         {facts['x'][0]:{shown}} .. {facts['x'][1]:{shown}} {unit}, spacing {grid.spacing[0]:.6g} {unit} ({grid.spacing_m[0]:.0f} m)",  # type: ignore[index]
        f"y         {facts['y'][0]:{shown}} .. {facts['y'][1]:{shown}} {unit}, spacing {grid.spacing[1]:.6g} {unit} ({grid.spacing_m[1]:.0f} m)",  # type: ignore[index]
        f"holes     {facts['holes']} nodes ({100 * facts['holes_share']:.1f} %)",  # type: ignore[operator]
        f"values    {facts['minimum']:.1f} .. {facts['maximum']:.1f} {value}, mean {facts['mean']:.1f}, std {facts['std']:.1f}",
        f"gradient  {slope:.2f} {value}/km in the median, {facts['gradient_per_km']['p90']:.2f} at 90 %",  # type: ignore[index]
        *known(grid, facts),
        f"fix       about {reach:.0f} m from 30 samples of {sigma:g} {value} noise, where the samples cross the gradient",
    ]
    typer.echo("\n".join(lines))
    return 0
