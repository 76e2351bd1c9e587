"""ROS bags, 1 and 2, through rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from geomag._errors import MissingFileError, ReadError, UnknownVariableError
from geomag._optional import require
from geomag.io._log_tables import Series, joined, magnitude_nt, one_of
from geomag.io._text import Table

MAGIC = (b"#ROSBAG V", b"\x89MCAP0\r\n")
_NT_PER_TESLA = 1e9
_KINDS = {"sensor_msgs/msg/NavSatFix": "place", "sensor_msgs/msg/MagneticField": "field"}


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a path is a bag: a folder with metadata, or a file by its first bytes."""
    return (path.is_dir() and (path / "metadata.yaml").exists()) or head.startswith(MAGIC)


def _stamp(message: Any, nanoseconds: int) -> float:  # noqa: ANN401 - any ROS message
    header = getattr(message, "header", None)
    if header is not None and (header.stamp.sec or header.stamp.nanosec):
        return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)
    return 1e-9 * nanoseconds


def _row(kind: str, message: Any, wanted: str) -> list[float] | None:  # noqa: ANN401 - any ROS message
    """Numbers of a message; None for a position that says that it is none."""
    if kind == "place":
        return [float(message.longitude), float(message.latitude)] if message.status.status >= 0 else None
    if kind == "field":
        v = message.magnetic_field
        return [float(v.x), float(v.y), float(v.z)]
    for part in wanted.split("."):
        message = getattr(message, part)
    return [float(message)]


def bag_table(path: str | Path, position: str | None = None, reading: str | None = None) -> Table:
    """Readings of a bag with the positions of their times.

    Positions are messages `NavSatFix`, readings the strength of `MagneticField` (tesla), or a number of another topic, as `/topic.field`.
    """
    path = Path(path)
    where = str(path)
    if not path.exists():
        raise MissingFileError(f"file: needed an existing bag, got nothing at {path}")
    highlevel = require("rosbags.highlevel", "logs", "ROS bags")
    typesys = require("rosbags.typesys", "logs", "ROS bags")
    topic, _, wanted = (reading or "").partition(".")
    rows: dict[str, dict[str, list[list[float]]]] = {"place": {}, "field": {}, "other": {}}
    try:
        with highlevel.AnyReader([path], default_typestore=typesys.get_typestore(typesys.Stores.LATEST)) as bag:
            for c in bag.connections:
                kinds = [k for k in (("other",) if wanted and c.topic == topic else ()) + (_KINDS.get(c.msgtype),) if k]
                for connection, stamp, raw in bag.messages(connections=[c]) if kinds else ():
                    message = bag.deserialize(raw, connection.msgtype)
                    for kind in kinds:
                        found = _row(kind, message, wanted)
                        if found is not None:
                            rows[kind].setdefault(c.topic, []).append([_stamp(message, stamp), *found])
    except AttributeError as error:
        raise UnknownVariableError(f"{where}: needed a field of the messages of '{topic}', got: {error}") from error
    except Exception as error:  # the readers underneath raise their own kinds
        raise ReadError(f"{where}: needed a readable bag, got: {type(error).__name__} {error}") from error

    def column(r: list[list[float]], k: int) -> Any:  # noqa: ANN401 - an array
        return np.array([row[k] for row in r], dtype=np.float64)

    places = {
        k: Series(k, column(r, 0), {"longitude": column(r, 1), "latitude": column(r, 2)})
        for k, r in rows["place"].items()
    }
    chosen = one_of(places, position, "position", where)
    if wanted:
        own = rows["other"].get(topic)
        if not own:
            raise UnknownVariableError(
                f"{where}: needed reading= among {', '.join(rows['field']) or 'none'}, or topic.field, got '{reading}'"
            )
        return joined(chosen, Series(topic, column(own, 0), {"value": column(own, 1)}), where)
    fields = {
        k: Series(
            k,
            column(r, 0),
            {"magnetic_field_nt": magnitude_nt(column(r, 1), column(r, 2), column(r, 3), _NT_PER_TESLA)},
        )
        for k, r in rows["field"].items()
    }
    return joined(chosen, one_of(fields, reading, "reading", where), where)
