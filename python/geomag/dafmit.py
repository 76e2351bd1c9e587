"""The public flights of the DAF-MIT AI Accelerator: from its HDF5 files to navigated lines.

For those who have accepted the agreement of the data (Gnadt et al., *DAF-MIT AI Accelerator open flight data for magnetic navigation research*, Zenodo, doi
10.5281/zenodo.4271803). The files are flat: one data set a column, ten rows a second, named `Flt1003_train.h5` and the like; the package `dafmit-aeromag` (extra
`dafmit`) fetches them. Longitude and latitude of the truth are in degrees, those of the INS in radians; its axes are north, west, up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from geomag._errors import InvalidInputError, MissingFileError, ReadError, TooFewSamplesError, UnknownVariableError
from geomag._geomag import GridMap, InsModel
from geomag._navigation import Navigation, navigate
from geomag._optional import require
from geomag.flight_log import FlightLog

Array = npt.NDArray[np.float64]

#: Lines that are navigated in publications, and their flights.
LINES = (1003.02, 1003.08, 1007.02, 1007.06)
#: Position errors (DRMS, metres) that were published for lines of these flights, with what was used.
PUBLISHED = (
    ("38 states, online compensation, 2022", "57"),
    ("with a small network, 2026", "37 and 14"),
    ("fixed-lag smoothing, compensation as states, 2026, unreviewed", "24 and 12"),
)
#: Readings that are taken unless told otherwise: tail stinger, daily variation and main field taken off.
READING = "mag_1_igrf"
_NEEDED = ("tt", "line", "lat", "lon", "ins_lat", "ins_lon", "ins_vn", "ins_vw", "ins_yaw")


def read_line(path: str | Path, line: float, *, reading: str = READING, every: int = 5) -> FlightLog:
    """One line of a flight file as a log, every `every`-th row (ten a second); needs h5py (extra `dafmit`).

    Raises `MissingFileError`, `ReadError` for a file that is none of these, `UnknownVariableError` naming the columns that there are, `TooFewSamplesError` for a line that is
    not in it, naming those that are.
    """
    h5py = require("h5py", "dafmit", "reading DAF-MIT flights")
    file = Path(path)
    if not file.is_file():
        raise MissingFileError(f"{file}: needed a file, found none")
    if every < 1:
        raise InvalidInputError(f"every: needed a whole number >= 1, got {every}")
    try:
        with h5py.File(file, "r") as held:
            for name in (*_NEEDED, reading):
                if name not in held:
                    raise UnknownVariableError(f"{file}: needed a column '{name}', got {', '.join(sorted(held)[:40])}")
            columns = {name: np.asarray(held[name], dtype=np.float64).reshape(-1) for name in (*_NEEDED, reading)}
    except OSError as error:
        raise ReadError(f"{file}: needed an HDF5 file, got: {error}") from error
    numbers = np.round(columns["line"], 2)
    rows = np.flatnonzero(numbers == round(line, 2))
    if rows.size < 2:
        known = ", ".join(f"{v:.2f}" for v in np.unique(numbers))
        raise TooFewSamplesError(f"{file}: needed rows of line {line:.2f}, got lines {known}")
    rows = rows[np.argsort(columns["tt"][rows], kind="stable")][::every]
    at = {name: c[rows] for name, c in columns.items()}
    velocity = np.column_stack([-at["ins_vw"], at["ins_vn"]])
    truth = np.column_stack([at["lon"], at["lat"]])
    return FlightLog(
        at["tt"], np.degrees(at["ins_lon"]), np.degrees(at["ins_lat"]), at[reading], velocity, at["ins_yaw"], truth
    )


@dataclass(frozen=True)
class NavigatedLine:
    """One line: its number, its log, and what became of it."""

    line: float
    log: FlightLog
    flight: Navigation

    def summary(self) -> dict[str, float]:
        """Figures of the flight, with `unaided_drms_m` of the INS alone; all of it counts, the start too."""
        assert self.log.truth is not None
        x, y = self.log.truth.T
        out = self.flight.summary((x, y), after_s=0.0)
        away = np.column_stack([self.log.x - x, self.log.y - y])
        scale = np.array([111_320.0 * np.cos(np.radians(float(y.mean()))), 111_132.0])
        out["unaided_drms_m"] = float(np.sqrt(np.mean(np.sum((away * scale) ** 2, axis=1))))
        return out


def navigate_lines(
    folder: str | Path,
    grid: GridMap,
    *,
    lines: Sequence[float] = LINES,
    ins: InsModel | None = None,
    reading: str = READING,
    position_sigma_m: float = 100.0,
    **options: Any,  # noqa: ANN401 - options of navigate, as they are
) -> list[NavigatedLine]:
    """Navigate lines of the flights in a folder from a cold start: nothing is known of the sensor before the line begins.

    `grid` is an anomaly map of the area in degrees, at the height flown. Options are those of `navigate`.
    """
    out = []
    for line in lines:
        number = int(line)
        found = sorted(Path(folder).glob(f"*{number}*.h5"))
        if not found:
            raise MissingFileError(
                f"{folder}: needed a file of flight {number}, such as Flt{number}_train.h5, found none"
            )
        log = read_line(found[0], line, reading=reading)
        flight = navigate(
            grid, log.time_s, log.x, log.y, velocity_m_s=log.velocity_m_s, heading_deg=log.heading_deg, readings=log.readings, ins=ins,
            position_sigma_m=position_sigma_m, **options,
        )  # fmt: skip
        out.append(NavigatedLine(line, log, flight))
    return out


def table(lines: Sequence[NavigatedLine]) -> str:
    """A Markdown table of the lines, with the published figures below."""
    rows = [
        "| line | DRMS, m | median | 95 % | squared error over variance | within 99 % radius | INS alone, DRMS |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in lines:
        s = one.summary()
        rows.append(
            f"| {one.line:.2f} | {s['drms_m']:.1f} | {s['median_m']:.1f} | {s['p95_m']:.1f} | {s['nees']:.2f} | {100 * s['within_99']:.1f} % | {s['unaided_drms_m']:.0f} |"
        )
    return "\n".join(
        [
            *rows,
            "",
            "Published for lines of these flights:",
            "",
            *(f"- {name}: {figure} m" for name, figure in PUBLISHED),
        ]
    )
