"""What several commands share."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

from geomag._errors import DataWarning, GeomagError, InvalidInputError, TimeError
from geomag._explain import reasons, status_in_words
from geomag._geomag import GridMap, Track
from geomag.io._tables import load_table
from geomag.io._text import Table
from geomag.io._tracks import dates_of, kept_rows, points_of, track_of

if TYPE_CHECKING:
    from geomag import Fix


def teller(quiet: bool) -> Callable[[str], None]:
    """Prints, or with `quiet` (for `--json`) does not."""

    def say(text: str) -> None:
        if not quiet:
            typer.echo(text)

    return say


def with_told_errors(grid: GridMap, line_spacing_m: float | None, map_sigma: float | None) -> GridMap:
    """The map with errors by the spacing of its survey's lines: as told, or as its file says where nothing else is known of its errors."""
    from geomag.survey import with_line_spacing

    if line_spacing_m is not None:
        if map_sigma is not None:
            raise InvalidInputError("--line-spacing-m: needed without --map-sigma, got both")
        return with_line_spacing(grid, line_spacing_m)
    if grid.line_spacing_m is not None and grid.sigma is None and grid.error_model is None:
        typer.echo(
            f"the map's errors are taken as typical of its survey, whose lines are {grid.line_spacing_m:.0f} m apart",
            err=True,
        )
        return with_line_spacing(grid, grid.line_spacing_m)
    return grid


def jsonable(value: Any) -> Any:  # noqa: ANN401 - anything that a report holds
    """Plain values for JSON: NaN becomes null, arrays become lists."""
    if isinstance(value, dict):
        return {k: jsonable(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(v) for v in value]
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def fix_json(fix: Fix, **more: object) -> str:
    """One JSON object with the fields of the fix, its track and surface, and more."""
    return json.dumps(jsonable({**fix.to_dict(), "track": fix.track, "surface": fix.surface, **more}))


def three(text: str | None) -> tuple[str, str, str] | None:
    """The columns of a text map, from `x,y,value`."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not all(parts):
        raise InvalidInputError(f"--columns: needed three, as x,y,value, got '{text}'")
    return parts[0], parts[1], parts[2]


def aligned(grid: GridMap, track: Track) -> Track:
    """A track in the map's coordinates; what was done for that is told on standard error."""
    from geomag.projection import align

    with telling():
        return align(grid, track)


@contextmanager
def telling() -> Iterator[None]:
    """What is done to bring a log to the map's coordinates, told on standard error."""
    from geomag.projection import AlignedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("always", AlignedWarning)
        plain = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:  # noqa: ANN401 - as warnings has it
            if issubclass(category, AlignedWarning):
                typer.echo(str(message), err=True)
            else:
                plain(message, category, *where, **more)

        warnings.showwarning = show
        yield


def load_dated(
    path: Path,
    grid: GridMap,
    columns: tuple[str | None, str | None, str | None],
    drop: bool,
    *,
    position: str | None = None,
    reading: str | None = None,
    height: str | None = None,
    time: str | None = None,
    dated: bool = False,
    **units: Any,  # noqa: ANN401 - `xy_unit` and `value_unit`
) -> tuple[Track, NDArray[np.datetime64] | None]:
    """A track as the log has it, in the log's own coordinates, with heights from a column, and the dates of its samples."""
    table = load_table(path, position, reading)
    x, y, value = columns
    track = _read(table, grid, x, y, value, drop, height, time, **units)
    if not dated:
        return track, None
    points = points_of(table, x, y, _value_of(table, grid, value), unit=grid.units, **units)
    return track, dates_of(table, time)[kept_rows(table, points, "drop" if drop else "error")]


def _value_of(table: Table, grid: GridMap, value: str | None) -> str | None:
    """The column of the readings: as asked, or that of the map's own name where several may be."""
    if value is None and grid.name:
        named = [
            c for c in table.columns if c.kind == "value" and grid.name.lower() in (c.name.lower(), c.base.lower())
        ]
        value = named[0].name if len(named) == 1 else None
    return value


def _read(
    table: Table,
    grid: GridMap,
    x: str | None,
    y: str | None,
    value: str | None,
    drop: bool,
    height: str | None = None,
    time: str | None = None,
    **units: Any,  # noqa: ANN401 - `xy_unit` and `value_unit`
) -> Track:
    """A track for a map: its readings by their unit, or by the name of the map's variable where several may be; times only if they are clear.

    No command that takes a track has a use for times that cannot be read, so that those are told and left.
    """
    missing: Literal["error", "drop"] = "drop" if drop else "error"
    value = _value_of(table, grid, value)
    try:
        return track_of(table, x, y, value, time=time, missing=missing, grid=grid, height=height, **units)
    except TimeError as error:
        if time is not None:
            raise
        warnings.warn(f"times are left out: {str(error).partition('; ')[0]}", DataWarning, stacklevel=2)
        return track_of(table, x, y, value, time=False, missing=missing, grid=grid, height=height, **units)


def describe(grid: GridMap, track: Track, fix: Fix, risk: str = "that the error is beyond the tolerance") -> list[str]:
    """What a navigator wants to know, in words; `risk` says of what the fix's risk is.

    Without a fix the best candidate is not given as a correction, so that nobody moves by it.
    """
    lines = [f"status      {fix.status}  {status_in_words(fix)}"]
    lines += [f"{'because' if k == 0 else '':<11} {reason}" for k, reason in enumerate(reasons(grid, track, fix))]
    if math.isfinite(fix.x):
        east, north = fix.offset_m
        place = f"x {fix.x:.6f}  y {fix.y:.6f}" if grid.geographic else f"x {fix.x:.1f} m  y {fix.y:.1f} m"
        if fix.ok:
            degrees = None if grid.geographic else _degrees(grid, fix)
            lines += [
                f"position    {place}",
                *([] if degrees is None else [f"            {degrees}"]),
                f"correction  {east:+.1f} m east  {north:+.1f} m north",
            ]
        else:
            lines.append(
                f"best guess  {place}, {math.hypot(east, north):.0f} m from where the INS says; not to be used"
            )
        if fix.heading_deg or fix.scale != 1.0:
            lines.append(f"            heading {fix.heading_deg:+.2f} deg  scale {fix.scale:.4f}")
    if fix.covariance_m2 is not None:
        s = np.sqrt(np.diag(fix.covariance_m2))
        lines.append(f"sigma       {s[0]:.1f} m east  {s[1]:.1f} m north (one standard deviation)")
    if fix.risk is not None:
        lines.append(f"risk        {percent(fix.risk)} {risk}")
    if not math.isfinite(fix.score):
        return lines
    scores = f"score       {fix.score:.4g}" + (
        f"  runner-up {fix.runner_up:.4g}" if math.isfinite(fix.runner_up) else ""
    )
    lines.append(f"{scores}  from {fix.n_samples} samples")
    return lines


def _degrees(grid: GridMap, fix: Fix) -> str | None:
    """The position in degrees (WGS 84), where the map says by which system it lies."""
    if grid.crs is None:
        return None
    try:
        from geomag.projection import transform

        longitude, latitude = (float(c[0]) for c in transform([fix.x], [fix.y], grid.crs, "EPSG:4326"))
    except GeomagError:  # without the extra 'geo', or a system of which nothing is known on the Earth
        return None
    if not (math.isfinite(longitude) and math.isfinite(latitude)):
        return None
    return f"latitude {latitude:.6f}  longitude {longitude:.6f} (WGS 84)"


def percent(share: float) -> str:
    """A probability with the digits that mean something."""
    return "under 0.01 %" if share < 1e-4 else f"{100.0 * share:.2g} %" if share < 0.995 else f"{100.0 * share:.4g} %"
