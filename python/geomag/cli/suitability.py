"""`geomag suitability`: where on a map a fix can be had, how good, how soon."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from geomag.cli import app
from geomag.cli._checks import direction, not_negative, output, picture, positive
from geomag.cli._common import jsonable, teller, three, with_told_errors
from geomag.cli._route import FLIGHTS, along_route, read_route
from geomag.io import read_grid


@app.command(
    epilog="Example: geomag suitability survey.nc --speed 60 --interval 8 --sigma 3 --out s.nc --plot s.png",
)
def suitability(
    map: Annotated[Path, typer.Argument(help="Map file.")],
    speed: Annotated[float, typer.Option(callback=positive, help="Speed of the vehicle, m/s.")],
    interval: Annotated[float, typer.Option(callback=positive, help="Seconds between samples.")] = 10.0,
    samples: Annotated[int, typer.Option(min=2, help="Samples of the track that ends at a node.")] = 20,
    heading: Annotated[
        list[float] | None,
        typer.Option(callback=direction, help="Heading, degrees; give it more than once for several. Default 0, 90."),
    ] = None,
    sigma: Annotated[
        float, typer.Option(callback=positive, help="Standard deviation of a reading, value units.")
    ] = 5.0,
    map_error_m: Annotated[
        float | None,
        typer.Option(
            callback=not_negative,
            help="Error of the map as a distance: its sigma is this times the gradient. By default the error that the map knows, else 30.",
        ),
    ] = None,
    tolerance_m: Annotated[
        float, typer.Option(callback=positive, help="Two standard deviations within this are a fix, m.")
    ] = 500.0,
    flights: Annotated[
        int,
        typer.Option(
            min=0, help="Also simulate this many calibrated flights at 12 x 12 places: the share that is fixed."
        ),
    ] = 0,
    half_width_m: Annotated[
        float, typer.Option(callback=positive, help="Bound of the INS error of those flights, m.")
    ] = 2000.0,
    route: Annotated[
        Path | None,
        typer.Option(
            help="Waypoints (a table, as a log without readings): what this route promises, instead of every node."
        ),
    ] = None,
    x: Annotated[str | None, typer.Option(help="Column of x or longitude of the waypoints.")] = None,
    y: Annotated[str | None, typer.Option(help="Column of y or latitude of the waypoints.")] = None,
    out: Annotated[
        Path | None, typer.Option(callback=output, help="Write the results to this file: netCDF, or CSV of a route.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(callback=picture, help="Write a picture of the worst heading to this file.")
    ] = None,
    variable: Annotated[str | None, typer.Option(help="Variable of a netCDF map.")] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns x,y,value of a text map: names, or numbers from 0 where it has no header."),
    ] = None,
    geographic: Annotated[bool | None, typer.Option(help="Map coordinates are degrees.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")] = False,
) -> int:
    """Bound the position error of a straight track to every node of a map: where a fix can be had, how soon."""
    from geomag.blocks import position_bound

    grid = with_told_errors(read_grid(map, variable, geographic=geographic, columns=three(columns)), None, None)
    if route is not None:
        rows = along_route(
            grid, *read_route(route, x, y, grid), spacing_m=speed * interval, samples=samples, half_width_m=half_width_m,
            tolerance_m=tolerance_m, sigma=sigma,
        )  # fmt: skip
        return tell_route(rows, speed, out, as_json)
    headings = heading or [0.0, 90.0]
    # What the map knows of its error adds to the sensor's; 30 m stand for a map that knows nothing.
    own = None if grid.sigma is None or map_error_m is not None else float(np.nanmedian(grid.sigma))
    spread = sigma if own is None else float(np.hypot(sigma, own))
    displaced = (30.0 if own is None else 0.0) if map_error_m is None else map_error_m
    found = position_bound(
        grid.to_xarray(),
        heading_deg=headings,
        samples=samples,
        spacing_m=speed * interval,
        sigma=spread,
        map_error_m=displaced,
        tolerance_m=tolerance_m,
        geographic=grid.geographic,
        ground_scale=(1.0, 1.0) if grid.geographic else grid.metres_per_unit(float(0.5 * (grid.y[0] + grid.y[-1]))),
        progress=not as_json,
    )
    say = teller(as_json)
    told: dict[float, dict[str, float | None]] = {h: {} for h in headings}
    errors = np.stack([found[name].values for name in found if str(name).startswith("error_m")])
    soon = np.stack([found[name].values for name in found if str(name).startswith("samples")])
    nodes = int(np.isfinite(grid.values).sum())
    for h, error, count in zip(headings, errors, soon, strict=True):
        known = ~np.isnan(error)
        told[h] |= {
            "share_with_fix": 0.0,
            "share_reached": float(known.sum() / nodes),
            "share_with_fix_of_reached": None,
        }
        if not known.any():
            say(f"heading {h:5.1f}  no track of {samples} samples lies on the map")
            continue
        good = (2.0 * error <= tolerance_m) & known
        told[h]["share_with_fix"] = float(good.sum() / nodes)
        told[h]["share_with_fix_of_reached"] = float(good.sum() / known.sum())
        text = (
            f"heading {h:5.1f}  a fix on {good.sum() / nodes:.0%} of the map"
            f" ({good.sum() / known.sum():.0%} of the nodes at which such a track can end)"
        )
        if good.any():
            median, soonest = float(np.median(error[good])), count[good][np.isfinite(count[good])]
            seconds = float(np.median(soonest)) * interval if soonest.size else None
            told[h] |= {"median_error_m": median, "median_time_s": seconds}
            text += f", there {median:.0f} m (median)"
            text += f" after {seconds / 60.0:.1f} min (median)" if seconds is not None else ""
        say(text)
    if flights:
        from geomag.calibration import suitability as simulate

        over = simulate(
            grid, spacing_m=speed * interval, half_width_m=half_width_m, tolerance_m=tolerance_m, sigma=sigma,
            samples=samples, headings_deg=tuple(headings), places=12, flights=flights, progress=not as_json,
        )  # fmt: skip
        for k, h in enumerate(over.heading_deg):
            share = over.fix_probability[k][np.isfinite(over.fix_probability[k])]
            told[h]["share_of_flights_fixed"] = float(share.mean()) if share.size else None
            text = (
                f"{share.mean():.0%} of simulated flights are fixed" if share.size else "no simulated flight on the map"
            )
            say(f"heading {h:5.1f}  {text}")
        if out is not None:
            over.to_netcdf(out.with_name(out.stem + "_flights" + out.suffix))
    if out is not None:
        found.attrs.update(speed_m_s=speed, interval_s=interval, sigma=sigma, tolerance_m=tolerance_m)
        found.to_netcdf(out)
    if plot is not None:
        from geomag.plot import save, suitability_map

        worst = np.where(np.isinf(errors), np.nan, errors).max(axis=0)
        ax = suitability_map(
            worst, grid.x, grid.y, geographic=grid.geographic, good_below=tolerance_m / 2.0,
            label="least standard deviation (m), worst heading", title=f"{samples} samples, {speed * interval:g} m apart",
        )  # fmt: skip
        save(ax.figure, plot)  # type: ignore[arg-type]
    if as_json:
        rows = [{"heading_deg": h, **facts} for h, facts in told.items()]
        typer.echo(json.dumps(jsonable({"headings": rows, "out": out and str(out), "plot": plot and str(plot)})))
    return 0


def tell_route(rows: list[dict[str, float | None]], speed: float, out: Path | None, as_json: bool) -> int:
    """Print, and write where asked, what a route promises."""
    if out is not None:
        names = list(rows[0])
        lines = [",".join(names), *(",".join("" if r[n] is None else f"{r[n]:.9g}" for n in names) for r in rows)]
        out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if as_json:
        typer.echo(json.dumps(jsonable({"route": rows, "out": out and str(out)})))
        return 0
    for row in rows:
        at = f"{float(row['distance_m'] or 0) / 1000:7.1f} km  {float(row['distance_m'] or 0) / speed / 60:6.1f} min"
        if row["fix_probability"] is None or row["sigma_m"] is None:
            typer.echo(f"{at}  off the known map")
        else:
            typer.echo(
                f"{at}  a fix in {100 * row['fix_probability']:.0f} % of {FLIGHTS} flights, {row['sigma_m']:.0f} m (one standard deviation)"
            )
    known = [row["fix_probability"] for row in rows if row["fix_probability"] is not None]
    typer.echo(
        f"{len(known)} of {len(rows)} windows on the map"
        + (f", a fix in {100 * sum(known) / len(known):.0f} % of their flights" if known else "")
    )
    return 0
