"""`geomag field fit|eval`: rectangular harmonic models from a file of observations, and maps from a model."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from geomag._errors import CandidateLimitError, InvalidInputError, ReadError, UnknownVariableError
from geomag._geomag import FieldObservations, LocalFrame, RectangularHarmonicModel
from geomag._optional import require
from geomag.cli import app
from geomag.cli._checks import not_negative, output, positive
from geomag.cli._common import jsonable
from geomag.io import floats, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping

field_app = typer.Typer(help="Harmonic models of the field: fit and evaluate.", no_args_is_help=True)
app.add_typer(field_app, name="field")

Column = NDArray[np.float64]

#: Most nodes of a map, as in the core.
MAX_NODES = 1 << 28


class Kind(StrEnum):
    """What a scalar column holds."""

    anomaly = "anomaly"
    intensity = "intensity"


class Quantity(StrEnum):
    """What is computed of a model."""

    north = "north"
    east = "east"
    down = "down"
    projection = "projection"
    anomaly = "anomaly"
    intensity = "intensity"


def _numbers(text: str | None, count: int, option: str) -> list[float] | None:
    """Comma-separated numbers of an option."""
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise InvalidInputError(f"{option}: needed {count} numbers with commas between them, all finite, got '{text}'")
    return values


def _several(text: str, kind: type, option: str) -> Any:  # noqa: ANN401 - a number or a list of them
    """One number, or several to choose from."""
    try:
        values = [kind(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInputError(f"{option}: needed numbers with commas between them, got '{text}'") from None
    return values[0] if len(values) == 1 else values


def read_columns(path: Path, names: Mapping[str, str], height: str) -> dict[str, Column]:
    """Columns of a table (csv, csv.gz, parquet) or flattened variables of a netCDF grid.

    `height` is a column or a number of metres.
    """
    if path.suffix in {".nc", ".cdf", ".netcdf"} and path.exists():
        xarray = require("xarray", "io", "reading netCDF")
        try:
            with xarray.open_dataset(path) as dataset:
                frame = dataset.to_dataframe().reset_index()
        except (OSError, ValueError) as error:
            raise ReadError(f"{path}: needed a readable netCDF file, got: {error}") from error
    else:
        frame = read_table(path)
    out = {}
    for key, name in names.items():
        if name not in frame:
            raise UnknownVariableError(
                f"{path.name}: needed a column '{name}' for {key}, got {', '.join(frame.columns)}"
            )
        # Labels of groups may be words; all else is numbers.
        out[key] = frame[name].to_numpy() if key == "group" else floats(frame, name, path)
    if height in frame:
        out["height"] = floats(frame, height, path)
    else:
        constant = _numbers(height, 1, "--height (a column of the file or metres)")
        out["height"] = np.full(len(frame), (constant or [0.0])[0])
    return out


@field_app.command(
    "fit",
    epilog="Example: geomag field fit lines.csv --value anomaly --main-field 31000,2000,-42000 --order 8,12,16 "
    "--group line --out model.json",
)
def fit(
    data: Annotated[Path, typer.Argument(help="Table (csv, csv.gz, parquet) or netCDF grid of observations.")],
    out: Annotated[Path, typer.Option(callback=output, help="Where the model goes (JSON).")],
    components: Annotated[
        str | None, typer.Option(help="Columns of the north, east and down components (geodetic), e.g. bn,be,bd.")
    ] = None,
    value: Annotated[str | None, typer.Option(help="Column of a scalar: total-field anomaly or intensity.")] = None,
    kind: Annotated[Kind, typer.Option(help="What the scalar is.")] = Kind.anomaly,
    main_field: Annotated[
        str | None, typer.Option(help="Main field north,east,down at the centre of the region; with --value.")
    ] = None,
    latitude: Annotated[str, typer.Option(help="Column of latitudes.")] = "latitude",
    longitude: Annotated[str, typer.Option(help="Column of longitudes.")] = "longitude",
    height: Annotated[str, typer.Option(help="Column of heights, or a constant, metres.")] = "0",
    order: Annotated[str, typer.Option(help="Order; several (8,12,16) are compared by cross-validation.")] = "12",
    period_ratio: Annotated[str, typer.Option(help="Periods over the extent; several are compared.")] = "1.5",
    ridge: Annotated[str, typer.Option(help="Ridge for columns of unit norm; several are compared.")] = "1e-9",
    damping: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Damp short waves as if they came from so many metres below; line spacing for surveys.",
        ),
    ] = 0.0,
    huber: Annotated[
        float | None, typer.Option(callback=positive, help="Huber's bound in standard deviations, e.g. 1.345.")
    ] = None,
    group: Annotated[str | None, typer.Option(help="Column whose equal values are left out together.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every n-th observation.")] = 1,
    no_covariance: Annotated[bool, typer.Option("--no-covariance", help="A small file without sigma.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")] = False,
) -> None:
    """Fit a rectangular harmonic model to components, anomalies or intensities at their own heights."""
    names = {"latitude": latitude, "longitude": longitude}
    if (components is None) == (value is None):
        raise InvalidInputError("observations: needed one of --components and --value, got both or neither")
    if components is not None:
        parts = components.split(",")
        if len(parts) != 3:
            raise InvalidInputError(f"--components: needed three columns with commas between them, got '{components}'")
        names |= dict(zip(("north", "east", "down"), parts, strict=True))
    elif value is not None:
        names["value"] = value
    if group is not None:
        names["group"] = group
    columns = {k: v[::every] for k, v in read_columns(data, names, height).items()}
    lat, lon = columns["latitude"], columns["longitude"]
    level = columns["height"]
    known = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(level)
    if value is not None:
        known &= np.isfinite(columns["value"])
    if not known.any():
        raise InvalidInputError(f"{data.name}: needed observations with a place, a height and a value, got none")
    lat, lon, level = lat[known], lon[known], level[known]
    frame = LocalFrame(
        float(0.5 * (lat.min() + lat.max())), float(0.5 * (lon.min() + lon.max())), float(np.median(level))
    )
    points = frame.forward(lat, lon, level)
    observations = FieldObservations()
    if value is None:
        own = np.stack([columns[k][known] for k in ("north", "east", "down")], axis=-1)
        turned = frame.rotate_to_origin(lat, lon, own)
        observations.add_vector(*points, turned)
    else:
        main = _numbers(main_field, 3, "--main-field")
        if main is None:
            raise InvalidInputError("--main-field: needed north,east,down with --value, got nothing")
        add = observations.add_anomaly if kind is Kind.anomaly else observations.add_intensity
        add(*points, columns["value"][known], main_field=main)
    model = RectangularHarmonicModel.fit_observations(
        observations,
        order=_several(order, int, "--order"),
        period_ratio=_several(period_ratio, float, "--period-ratio"),
        ridge=_several(ridge, float, "--ridge"),
        damping_m=damping,
        huber=huber,
        groups=columns["group"][known] if group is not None else None,
        covariance=not no_covariance,
        frame=frame,
    )
    model.to_json(out)
    summary = {
        "order": model.order,
        "coefficients": int(model.coefficients.size),
        "periods_m": list(model.periods_m),
        "frame": [frame.latitude_deg, frame.longitude_deg, frame.height_m],
        **(model.summary or {}),
        "out": str(out),
    }
    if as_json:
        typer.echo(json.dumps(jsonable(summary)))
    else:
        typer.echo(repr(model))
        typer.echo(f"frame {frame!r}; written to {out}")


@field_app.command("eval", epilog="Example: geomag field eval model.json --at=-21.95,140.66,500 --json")
def evaluate(
    model: Annotated[Path, typer.Argument(help="Model made by `geomag field fit`.")],
    at: Annotated[str | None, typer.Option(help="One place: latitude,longitude,height_m.")] = None,
    grid: Annotated[str | None, typer.Option(help="A map: west,east,south,north,step in degrees.")] = None,
    height: Annotated[float, typer.Option(help="Height of the map, metres.")] = 0.0,
    quantity: Annotated[Quantity, typer.Option(help="What the map holds.")] = Quantity.down,
    main_field: Annotated[str | None, typer.Option(help="Main field north,east,down for the last three.")] = None,
    out: Annotated[Path | None, typer.Option(callback=output, help="netCDF file for the map.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object instead of text.")] = False,
) -> None:
    """Evaluate a model at a place (components, intensity of the anomaly, gradient, sigma), or continue it to a map."""
    loaded = RectangularHarmonicModel.from_json(model)
    frame = loaded.frame
    if frame is None:
        raise InvalidInputError(f"{model.name}: needed a model with a frame on the Earth, got one without")
    if (at is None) == (grid is None):
        raise InvalidInputError("places: needed one of --at and --grid, got both or neither")
    if at is not None:
        latitude, longitude, level = _numbers(at, 3, "--at") or [0.0, 0.0, 0.0]
        _on_earth("--at", latitude, longitude)
        _point(loaded, frame, (latitude, longitude, level), as_json)
        return
    west, east, south, north, step = _numbers(grid, 5, "--grid") or [0.0] * 5
    if not (east > west and north > south and step > 0):
        raise InvalidInputError(f"--grid: needed west < east, south < north and a step > 0, got '{grid}'")
    if out is None:
        raise InvalidInputError("--out: needed a netCDF file for the map, got nothing")
    _on_earth("--grid", south, west)
    _on_earth("--grid", north, east)
    needed = ((east - west) / step + 1.0) * ((north - south) / step + 1.0)
    if needed > MAX_NODES:
        raise CandidateLimitError(f"--grid: needed at most {MAX_NODES} nodes, got {needed:.3g}; take a larger step")
    x = west + step * np.arange(round((east - west) / step) + 1)
    y = south + step * np.arange(round((north - south) / step) + 1)
    made = loaded.sample_to_grid(
        x, y, quantity=quantity.value, main_field=_numbers(main_field, 3, "--main-field"), height_m=height
    )
    require("xarray", "io", "writing netCDF")
    made.to_xarray().to_netcdf(out)
    if as_json:
        typer.echo(json.dumps(jsonable({"out": str(out), "shape": list(made.shape), "holes": made.holes})))
    else:
        typer.echo(f"{made!r} written to {out}")


def _on_earth(option: str, latitude: float, longitude: float) -> None:
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
        raise InvalidInputError(
            f"{option}: needed a latitude within 90 and a longitude within 360 degrees, got {latitude:g} and {longitude:g}"
        )


def _point(
    model: RectangularHarmonicModel, frame: LocalFrame, place: tuple[float, float, float], as_json: bool
) -> None:
    latitude, longitude, _ = place
    field = model.field_geographic(*place)
    point = frame.forward(*place)
    axes = frame.rotate_to_origin(np.full(3, latitude), np.full(3, longitude), np.eye(3))
    # Rows of `axes` are the point's own north, east and down in the frame.
    tensor = axes @ model.gradient(*point) @ axes.T
    sigma = None
    if model.covariance is not None:
        sigma = [float(model.sigma(*point, direction=axis)) for axis in axes]
    if as_json:
        found = {"field": field, "intensity": float(np.linalg.norm(field)), "gradient": tensor, "sigma": sigma}
        typer.echo(json.dumps(jsonable({**found, "unit": model.unit})))
        return
    names = ("north", "east", "down")
    for k, name in enumerate(names):
        spread = f" +- {sigma[k]:.3g}" if sigma is not None else ""
        slopes = ", ".join(f"{1000 * s:.4g}" for s in tensor[k])
        typer.echo(f"{name:5s} {field[k]:.4f}{spread} {model.unit}; gradient {slopes} {model.unit}/km")
