"""`geomag demo`: the main job on data of its own, or on a real survey line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from geomag._errors import InvalidInputError
from geomag._geomag import GridMap, Track
from geomag._optional import require
from geomag.cli import NO_FIX, app
from geomag.cli._checks import MAX_SEED, picture
from geomag.cli._common import describe, fix_json, teller
from geomag.cli._methods import Settings, risk_of, solve
from geomag.cli.match import draw
from geomag.io import read_grid

if TYPE_CHECKING:
    import datetime
    from collections.abc import Callable

    from numpy.typing import NDArray


#: What counts as wrong in the demo.
TOLERANCE_M = 300.0


@dataclass(frozen=True)
class Scene:
    """A map, an indicated track with readings, and the truth."""

    title: str
    grid: GridMap
    track: Track
    truth: NDArray[np.float64]
    sigma: float
    half_width_m: float

    @property
    def offset_m(self) -> tuple[float, float]:
        """True minus indicated position of the newest sample, metres (east, north)."""
        east, north = self.grid.metres_per_unit(float(self.truth[-1, 1]))
        return (
            float((self.truth[-1, 0] - self.track.x[-1]) * east),
            float((self.truth[-1, 1] - self.track.y[-1]) * north),
        )


def main_field(when: datetime.datetime, height_m: float) -> Callable[..., NDArray[np.float64]]:
    """Return a function from longitude and latitude to the IGRF total intensity, nT."""
    ppigrf = require("ppigrf", "field", "the main field of the demo")

    def intensity(longitude: NDArray[np.float64], latitude: NDArray[np.float64]) -> NDArray[np.float64]:
        east, north, up = ppigrf.igrf(np.asarray(longitude), np.asarray(latitude), height_m / 1000.0, when)
        return np.asarray(np.sqrt(east**2 + north**2 + up**2)).reshape(np.shape(longitude))

    return intensity


def synthetic_scene(seed: int) -> Scene:
    """An aircraft over a fractal crust with dipole bodies under the IGRF main field.

    The INS has drifted for a while; the magnetometer reads the total intensity with noise, a base level error and a few
    outliers. As in life, the main field is taken away at the indicated positions, so part of it stays in the anomaly.
    """
    import datetime

    from geomag import synthetic

    when = datetime.datetime(2026, 6, 1, tzinfo=None)
    west, south, east, north = 16.0, 47.0, 16.6, 47.4
    crust = synthetic.Crust(texture_rms=90.0, height_m=600.0, longest_m=30_000.0, inclination_deg=64.0)
    field = crust.draw((west, south, east, north), geographic=True, seed=seed)
    drawn = field.grid(0.00125, name="total_field_anomaly", units="nT")
    # A map that is right at its nodes; a real one brings what is known of its errors (geomag map, --line-spacing-m).
    grid = GridMap(drawn.values, drawn.x, drawn.y, geographic=True, sigma=0.0, name=drawn.name, units=drawn.units)
    rng = np.random.default_rng(seed)
    course = float(rng.uniform(30, 80))
    path = synthetic.Path.straight(
        (16.12 + rng.uniform(0, 0.05), 47.08 + rng.uniform(0, 0.03)),
        course_deg=course,
        speed_m_s=70.0,
        interval_s=7.0,
        samples=40,
        geographic=True,
    )
    drift = rng.uniform(600, 1400) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a)])
    ins = synthetic.InsError(
        position_m=(float(drift[0]), float(drift[1])), velocity_m_s=(0.05, -0.04), walk_m_sqrt_s=0.3
    )
    sensor = synthetic.Sensor(sigma=1.0, outlier_rate=0.05, outlier_sigma=60.0, diurnal=4.0)
    flight = synthetic.fly(field, path, ins=ins, sensor=sensor, seed=seed)
    truth = np.column_stack([path.x, path.y])
    core = main_field(when, crust.height_m)
    reading = core(path.x, path.y) + flight.track.values
    anomaly = reading - core(flight.track.x, flight.track.y)
    track = Track(flight.track.x, flight.track.y, anomaly, time_s=flight.track.time_s)
    return Scene(f"synthetic crust, seed {seed}", grid, track, truth, 1.0, 2000.0)


def survey_scene(lines: Path, map_file: Path, seed: int, samples: int = 40, spacing_m: float = 200.0) -> Scene:
    """A stretch of a real survey line, its start displaced by up to a kilometre on each axis."""
    from geomag.survey import read_lines

    grid = read_grid(map_file)
    survey = read_lines(lines, geographic=grid.geographic).split()
    rng = np.random.default_rng(seed)
    for one in (survey[k] for k in rng.permutation(len(survey))):
        x, y, v = one.x, one.y, one.values
        along = Track(x, y, np.nan_to_num(v)).distance_m(geographic=grid.geographic)
        need = (samples - 1) * spacing_m
        if along[-1] < need:
            continue
        start = rng.uniform(0, along[-1] - need)
        at = start + spacing_m * np.arange(samples)
        px, py = np.interp(at, along, x), np.interp(at, along, y)
        readings = np.interp(at, along, v)
        if not np.isfinite(readings).all() or np.isnan(grid.sample(px, py)).any():
            continue
        east, north = grid.metres_per_unit(float(py[-1]))
        offset = rng.uniform(-1000, 1000, 2) / (east, north)
        track = Track(px - offset[0], py - offset[1], readings)
        title = f"line {one.line[0]} of {lines.name}, seed {seed}"
        return Scene(title, grid, track, np.column_stack([px, py]), 10.0, 1500.0)
    raise InvalidInputError(f"{lines}: needed a line of {need:.0f} m that lies on the map, got none")


@app.command(epilog="Example: geomag demo --seed 7 --out demo.png")
def demo(
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of everything that is drawn.")] = 1,
    out: Annotated[Path, typer.Option(callback=picture, help="Picture to write.")] = Path("demo.png"),
    lines: Annotated[Path | None, typer.Option(help="Survey lines (CSV) instead of made-up data.")] = None,
    map: Annotated[Path | None, typer.Option(help="Map that goes with the lines.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object (the fix and its error) instead of text.")
    ] = False,
) -> int:
    """Match a track with a declared risk, show what IEMA and grid search say of it, navigate a whole flight, and draw both."""
    if (lines is None) != (map is None):
        raise InvalidInputError("demo: needed --lines and --map together, got one of them")
    scene = synthetic_scene(seed) if lines is None or map is None else survey_scene(lines, map, seed)
    east, north = scene.offset_m
    say = teller(as_json)
    say(f"scene       {scene.title}: {len(scene.track)} samples on {scene.grid!r}")
    say(f"truth       the INS is wrong by {np.hypot(east, north):.0f} m ({-east:+.0f} m east, {-north:+.0f} m north)")
    told = Settings(half_width_m=scene.half_width_m, sigma=scene.sigma, tolerance_m=TOLERANCE_M, surface=True)
    fix, _ = solve(scene.grid, scene.track, "posterior", told)
    # IEMA's gate knows the sensor alone; off the lattice the map differs by gradient times part of a cell, so it is given that much
    # more here, a few outliers may pass, and a region is asked for instead of a single candidate.
    slope = float(np.nanmedian(np.hypot(*scene.grid.gradient(*scene.truth.T))))
    spread = 2.0 * scene.sigma + 0.3 * slope * max(scene.grid.spacing_m)
    iema, steps = solve(scene.grid, scene.track, "iema", replace(told, sigma=spread, max_misses=2, tolerance_m=300.0))
    search, _ = solve(scene.grid, scene.track, "mad", replace(told, sigma=None, tolerance_m=0.0))
    for name, answer, risk in (
        ("calibrated match: a fix with its risk", fix, risk_of("posterior", TOLERANCE_M)),
        ("the same flight by IEMA", iema, ""),
        ("the same flight by grid search, mean absolute difference about a free level", search, ""),
    ):
        say(f"\n{name}")
        say("\n".join(describe(scene.grid, scene.track, answer, risk)))
        if np.isfinite(answer.offset_m).all():
            say(f"error       {np.hypot(answer.offset_m[0] - east, answer.offset_m[1] - north):.0f} m")
    draw(scene.grid, scene.track, fix, out, "posterior", steps, truth=scene.truth)
    say(f"\npicture     {out}")
    more: dict[str, object] = {}
    if lines is None:
        from geomag.cli._demo_flight import fly

        beside = out.with_name(f"{out.stem}-flight{out.suffix}")
        figures, said = fly(scene.grid, seed, beside)
        say(f"\na flight of an INS over the same map, corrected by every reading\n{said}\npicture     {beside}")
        more = {"flight": figures, "flight_picture": str(beside)}
    if as_json:
        error = float(np.hypot(fix.offset_m[0] - east, fix.offset_m[1] - north))
        typer.echo(fix_json(fix, error_m=error, picture=str(out), **more))
    return 0 if fix.ok else NO_FIX
