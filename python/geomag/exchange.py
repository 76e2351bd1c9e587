"""Tracks and fixes to and from pandas, GeoJSON and GeoPackage, with their coordinate reference system.

Coordinates of a projected map travel with the map's CRS (`grid.crs`, anything that pyproj reads). GeoJSON is always
longitude and latitude (RFC 7946), so projected coordinates are turned into those.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geomag._errors import InvalidInputError, MissingFileError, ReadError, UnknownVariableError
from geomag._geomag import Fix, Track
from geomag._optional import require
from geomag.io import track_from_pandas, track_to_pandas

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

__all__ = ["fixes_to_pandas", "geojson", "read_geopackage_track", "track_from_pandas", "track_to_pandas",
           "write_geojson", "write_geopackage"]  # fmt: skip

_WGS84 = "EPSG:4326"


def _flat(fix: Fix) -> dict[str, Any]:
    """The numbers of a fix, one a column."""
    d: dict[str, Any] = fix.to_dict()
    covariance = d.pop("covariance_m2")
    offset, offset_m = d.pop("offset"), d.pop("offset_m")
    d["offset_x"], d["offset_y"] = offset
    d["offset_east_m"], d["offset_north_m"] = offset_m
    c = np.full((2, 2), np.nan) if covariance is None else np.asarray(covariance)
    d["covariance_ee_m2"], d["covariance_en_m2"], d["covariance_nn_m2"] = float(c[0, 0]), float(c[0, 1]), float(c[1, 1])
    return d


def fixes_to_pandas(fixes: Sequence[Fix]) -> pd.DataFrame:
    """Return a data frame with one row a fix, covariance and offsets in columns of their own."""
    pandas = require("pandas", "io", "fixes as data frames")
    return cast("pd.DataFrame", pandas.DataFrame([_flat(fix) for fix in fixes]))


def _to_degrees(x: NDArray[Any], y: NDArray[Any], crs: str | None) -> tuple[NDArray[Any], NDArray[Any]]:
    """Longitude and latitude of points in a CRS; None means that they are degrees already."""
    if crs is None:
        if x.size and (np.nanmax(np.abs(y)) > 90.0 or np.nanmax(np.abs(x)) > 720.0):
            raise InvalidInputError(
                "crs: needed the coordinate reference system of these coordinates, which are no degrees, got None"
            )
        return (x + 180.0) % 360.0 - 180.0, y
    pyproj = require("pyproj", "geo", "projected coordinates as longitude and latitude")
    try:
        transformer = pyproj.Transformer.from_crs(crs, _WGS84, always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise InvalidInputError(f"crs: needed one that pyproj knows, got {crs!r} ({error})") from error
    longitude, latitude = transformer.transform(x, y)
    return np.asarray(longitude), np.asarray(latitude)


def _cut(longitude: NDArray[Any], latitude: NDArray[Any]) -> list[list[list[float]]]:
    """A line in pieces that do not cross the date line (RFC 7946, 3.1.9): they end and begin on it."""

    def place(x: float, y: float) -> list[float]:
        return [round(float(x), 9), round(float(y), 9)]

    pieces = [[place(longitude[0], latitude[0])]]
    for k in range(1, len(longitude)):
        x0, x1, y0, y1 = (float(v) for v in (longitude[k - 1], longitude[k], latitude[k - 1], latitude[k]))
        if abs(x1 - x0) > 180.0:
            side = 180.0 if x0 > 0 else -180.0
            along = x1 + 2.0 * side - x0
            y = y0 if along == 0.0 else y0 + (y1 - y0) * (side - x0) / along
            pieces[-1].append(place(side, y))
            pieces.append([place(-side, y)])
        pieces[-1].append(place(x1, y1))
    return pieces


def _json_number(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def geojson(items: Mapping[str, object], *, crs: str | None = None) -> dict[str, Any]:
    """Return a GeoJSON feature collection of tracks, paths and fixes.

    Parameters
    ----------
    items : name -> `Track`, `Path`, `Fix` or (n, 2) array. A track becomes a line; a fix becomes a point with its
        numbers as properties, and a line where it has more than one corrected point. Lines over the date line are cut there.
    crs : of the coordinates, such as "EPSG:32616"; None for degrees of longitude and latitude.

    Raises
    ------
    InvalidInputError
        For coordinates that are no degrees and have no CRS.
    """
    features: list[dict[str, Any]] = []

    def feature(name: str, kind: str, x: NDArray[Any], y: NDArray[Any], properties: Mapping[str, object]) -> None:
        longitude, latitude = _to_degrees(np.atleast_1d(x), np.atleast_1d(y), crs)
        pieces = _cut(longitude, latitude)
        if kind == "Point":
            geometry: dict[str, Any] = {"type": kind, "coordinates": pieces[0][0]}
        elif len(pieces) == 1:
            geometry = {"type": kind, "coordinates": pieces[0]}
        else:
            geometry = {"type": "MultiLineString", "coordinates": pieces}
        plain = {k: _json_number(v) for k, v in properties.items()}
        features.append({"type": "Feature", "geometry": geometry, "properties": {"name": name, **plain}})

    def line(name: str, points: NDArray[Any], role: str) -> None:
        if len(points) == 1:
            feature(name, "Point", points[:, 0], points[:, 1], {"role": role})
        else:
            feature(name, "LineString", points[:, 0], points[:, 1], {"role": role})

    for name, item in items.items():
        if isinstance(item, Fix):
            if math.isfinite(item.x):
                feature(name, "Point", np.array(item.x), np.array(item.y), {"role": "fix", **_flat(item)})
                if len(item.track) > 1:
                    line(name, np.asarray(item.track), "corrected track")
            else:
                properties = {k: _json_number(v) for k, v in _flat(item).items()}
                features.append(
                    {"type": "Feature", "geometry": None, "properties": {"name": name, "role": "fix", **properties}}
                )
        elif hasattr(item, "x") and hasattr(item, "y"):
            line(name, np.column_stack([item.x, item.y]), "track")
        else:
            points = np.asarray(item, dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
                raise InvalidInputError(f"'{name}': needed a track, a fix or an (n, 2) array, got shape {points.shape}")
            line(name, points, "track")
    return {"type": "FeatureCollection", "features": features}


def write_geojson(path: str | PathLike[str], items: Mapping[str, object], *, crs: str | None = None) -> Path:
    """Write tracks, paths and fixes as a GeoJSON file; arguments as `geojson`."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(geojson(items, crs=crs), allow_nan=False) + "\n", encoding="utf-8")
    return target


def write_geopackage(
    path: str | PathLike[str], items: Mapping[str, object], *, crs: str | None = None, overwrite: bool = False
) -> Path:
    """Write tracks and fixes as layers `fixes` and `tracks` of a GeoPackage, in longitude and latitude (WGS84).

    Samples of a `Track` go to a layer `samples` with their values and times. With `overwrite` a file that is there is written anew; else its
    other layers stay. Needs geopandas (extra `geo`).
    """
    geopandas = require("geopandas", "geo", "GeoPackage files")
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    if overwrite:
        target.unlink(missing_ok=True)
    collection = geojson(items, crs=crs)["features"]
    for layer, chosen in (("fixes", {"fix"}), ("tracks", {"track", "corrected track"})):
        part = [f for f in collection if f["properties"]["role"] in chosen and f["geometry"] is not None]
        if part:
            frame = geopandas.GeoDataFrame.from_features(part, crs=_WGS84)
            frame.to_file(target, layer=layer, driver="GPKG")
    rows: list[Any] = []
    for name, item in items.items():
        if isinstance(item, Track):
            pandas = require("pandas", "geo", "GeoPackage files")
            longitude, latitude = _to_degrees(np.asarray(item.x), np.asarray(item.y), crs)
            frame = track_to_pandas(item).assign(track=name)
            geometry = geopandas.points_from_xy(longitude, latitude, crs=_WGS84)
            rows.append(geopandas.GeoDataFrame(frame, geometry=geometry))
            samples = pandas.concat(rows, ignore_index=True)
            samples.to_file(target, layer="samples", driver="GPKG")
    return target


def read_geopackage_track(
    path: str | PathLike[str],
    *,
    layer: str = "samples",
    track: str | None = None,
    value: str = "value",
    time: str | None = None,
    crs: str | None = None,
) -> Track:
    """Return a `Track` from a layer of points (GeoPackage, GeoJSON, anything that geopandas reads).

    Coordinates are turned into `crs`, the map's own, or into longitude and latitude where it is None. `track` is the name of
    one, needed where `write_geopackage` wrote several into the layer: end to end they are no track.
    """
    geopandas = require("geopandas", "geo", "vector files")
    source = Path(path)
    if not source.exists():
        raise MissingFileError(f"track file {source}: not found")
    try:
        frame = geopandas.read_file(source, layer=layer)
    except Exception as error:  # the drivers underneath raise their own kinds
        raise ReadError(f"{source}, layer '{layer}': needed a layer of points, got {error}") from error
    if frame.crs is not None:
        frame = frame.to_crs(crs or _WGS84)
    if not (frame.geometry.geom_type == "Point").all():
        kinds = ", ".join(sorted(set(frame.geometry.geom_type)))
        raise ReadError(f"{source}, layer '{layer}': needed points, got {kinds}")
    if track is not None or "track" in frame.columns:
        names = list(map(str, dict.fromkeys(frame["track"]))) if "track" in frame.columns else []
        if (track is None and len(names) > 1) or (track is not None and track not in names):
            raise UnknownVariableError(
                f"{source}, layer '{layer}': needed track= for one of its tracks {', '.join(names)}, got {track}"
            )
        frame = frame if track is None else frame[frame["track"].astype(str) == track]
    plain = frame.drop(columns=frame.geometry.name).assign(x=frame.geometry.x, y=frame.geometry.y)
    return track_from_pandas(plain, "x", "y", value, time=time, where=f"{source}, layer '{layer}'")
